"""The cross-check counts correlations, speaks when ways disagree, and is quiet when they do not."""

import numpy as np
import pytest

from calibration.estimate import Estimate
from tcdyn.partition.crosscheck import cross_check


def known(**values: float) -> dict[str, Estimate]:
    return {name.replace("_", " "): Estimate.normal(value, 0.01) for name, value in values.items()}


def draws(common: float, own: float, names: tuple[str, ...], seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    shared = rng.normal(0, common, 20000)
    return {n: 0.66 + shared + rng.normal(0, own, 20000) for n in names}


def test_common_errors_do_not_hide_a_disagreement() -> None:
    d = draws(0.02, 0.002, ("speed law", "joint fast"))
    found = cross_check(known(speed_law=0.66, joint_fast=0.672), d)
    assert found.z == pytest.approx(0.012 / (0.002 * np.sqrt(2)), rel=0.03)  # 1 % sampling of 20000 draws, thrice
    assert not found.agree
    assert "NOT" in found.sentence


def test_sound_ways_agree_at_the_stated_rate() -> None:
    names = ("speed law", "cooling fast", "cooling slow", "joint fast", "joint slow")
    d = draws(0.01, 0.005, names)
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(300):
        ways = {n: Estimate.normal(0.66 + rng.normal(0, 0.005), 0.01) for n in names}
        alarms += not cross_check(ways, d).agree
    assert alarms <= 21  # 7 %: ten pairs beyond three standard deviations happen in about 2 %


def test_shares_that_do_not_add_to_one_name_the_suspect() -> None:
    d = draws(0.0, 0.002, ("joint fast", "joint slow"))
    found = cross_check(known(joint_fast=0.70, joint_slow=0.62), d)
    assert "do not add to one" in found.sentence
