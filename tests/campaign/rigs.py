"""Campaigns of drawn rigs: sixteen tests each, errors from the rig file, beta decreasing with load
and speed."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.campaign import SufficientStatistics, compress_likelihood
from tcdyn.core.errors import InputError
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import joint_fits
from tcdyn.partition.steady import steady_lines, with_inner_row_at_one_radius
from tcdyn.partition.window import fit_rows
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.simulate.ehl import EhlOptions
from tcdyn.simulate.programme import PROGRAMME, ehl_test
from tcdyn.simulate.truth import draw_truth
from tests.partition.study_rigs import QUICK, study_rig

EXPONENT = 0.70
LOW_FRICTION = 0.95
# slopes of beta
PER_N = -3.0e-5
PER_M_S = -3.0e-3


def true_beta(name: str) -> float:
    """Decreases linearly with load and sliding speed."""
    at = ehl_test(name)
    return 0.70 + PER_N * (at.load_N - 1620.0) + PER_M_S * (at.sliding_speed_m_s - 15.0)


@dataclass(frozen=True)
class DrawnCampaign:
    """Compressed tests of one drawn rig, their true values, and one test with friction that reads
    low."""

    seed: int
    tests: tuple[SufficientStatistics, ...]
    # beta of the joint fit of both disks and its u, each test alone
    single_beta: Mapping[str, tuple[float, float]]
    truth: Mapping[str, Mapping[str, float]]
    low: SufficientStatistics

    def to_dict(self) -> dict[str, Any]:
        return {
            "seed": self.seed,
            "kept": {k.name: k.to_dict() for k in self.tests},
            "single": dict(self.single_beta),
            "truth": dict(self.truth),
            "low": {self.low.name: self.low.to_dict()},
        }

    @classmethod
    def read(cls, path: Path) -> DrawnCampaign:
        data = json.loads(path.read_text(encoding="utf-8"))
        tests = tuple(SufficientStatistics.from_dict(k, v) for k, v in data["kept"].items())
        [(name, low)] = data["low"].items()
        return cls(
            data["seed"],
            tests,
            data["single"],
            data["truth"],
            SufficientStatistics.from_dict(name, low),
        )


def compressed_joint_fit(
    name: str, test: EhlTest, rig: str = "drawn"
) -> tuple[SufficientStatistics, tuple[float, float]]:
    """Joint fit of both disks of one test, compressed, and its beta with u."""
    level_test = with_inner_row_at_one_radius(test)
    joint, both = joint_fits(
        level_test, steady_lines(level_test, fit_rows(level_test, 10.0))[1].starts
    )
    beta = both.estimates["beta"]
    blocks = [joint[d].block for d in DISKS]
    return compress_likelihood(name, rig, level_test, blocks, both.optimum, both.harmonics), (
        beta.value,
        beta.u,
    )


def draw_campaign(
    seed: int,
    names: tuple[str, ...] = tuple(PROGRAMME),
    options: EhlOptions = QUICK,
    rig: Rig | None = None,
) -> DrawnCampaign:
    """Draw rig ``seed`` from the uncertainties of ``rig``, run its tests and fit each."""
    warnings.simplefilter("ignore")
    rig = rig or load_rig()
    truth = draw_truth(seed, rig, uncertain=True, exponent=EXPONENT)
    low_friction_name = names[int(np.random.default_rng(seed).integers(len(names)))]
    tests = []
    single_beta = {}
    truth_by_test = {}
    low = None
    for name in names:
        study = study_rig(
            seed, name, truth=truth, rig=rig, options=replace(options, beta=true_beta(name))
        )
        try:
            statistics, single_beta[name] = compressed_joint_fit(name, study.test)
        except InputError as problem:
            print(seed, name, problem)
            continue
        tests.append(statistics)
        truth_by_test[name] = {k: float(study.true_values[k]) for k in ("beta", "h_fast", "h_slow")}
        truth_by_test[name] |= {
            f"lag_{d}_s": study.truth.disk(d).common_lag_s for d in ("fast", "slow")
        }
        if name == low_friction_name:
            scaled = replace(
                study.test,
                power_W=LOW_FRICTION * study.test.power_W,
                friction_N=LOW_FRICTION * study.test.friction_N,
            )
            low = compressed_joint_fit(name, scaled)[0]
    assert low is not None
    return DrawnCampaign(seed, tuple(tests), single_beta, truth_by_test, low)
