"""Campaigns of drawn rigs: sixteen tests each, off by what rig.toml states, beta falling with load and speed."""

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
PER_N, PER_M_S = -3.0e-5, -3.0e-3  # slopes of beta


def true_beta(name: str) -> float:
    """Falls by a straight line with load and sliding speed."""
    at = ehl_test(name)
    return 0.70 + PER_N * (at.load_N - 1620.0) + PER_M_S * (at.sliding_speed_m_s - 15.0)


@dataclass(frozen=True)
class DrawnCampaign:
    """What was kept of each test of one drawn rig, what was true, and one test again with its friction read low."""

    seed: int
    kept: tuple[SufficientStatistics, ...]
    single: Mapping[str, tuple[float, float]]  # beta of both disks and its u, each test alone
    truth: Mapping[str, Mapping[str, float]]
    low: SufficientStatistics

    def to_dict(self) -> dict[str, Any]:
        return {
            "seed": self.seed,
            "kept": {k.name: k.to_dict() for k in self.kept},
            "single": dict(self.single_beta),
            "truth": dict(self.truth),
            "low": {self.low.name: self.low.to_dict()},
        }

    @classmethod
    def read(cls, path: Path) -> DrawnCampaign:
        data = json.loads(path.read_text(encoding="utf-8"))
        kept = tuple(SufficientStatistics.from_dict(k, v) for k, v in data["kept"].items())
        [(name, low)] = data["low"].items()
        return cls(
            data["seed"],
            kept,
            data["single"],
            data["truth"],
            SufficientStatistics.from_dict(name, low),
        )


def kept_of(
    name: str, test: EhlTest, rig: str = "drawn"
) -> tuple[SufficientStatistics, tuple[float, float]]:
    """The joint fit of both disks alone, compressed; its beta with u."""
    at = with_inner_row_at_one_radius(test)
    joint, both = joint_fits(at, steady_lines(at, fit_rows(at, 10.0))[1].starts)
    beta = both.estimates["beta"]
    sides = [joint[d].block for d in DISKS]
    return compress_likelihood(name, rig, at, sides, both.optimum, both.harmonics), (
        beta.value,
        beta.u,
    )


def drawn(
    seed: int,
    names: tuple[str, ...] = tuple(PROGRAMME),
    options: EhlOptions = QUICK,
    rig: Rig | None = None,
) -> DrawnCampaign:
    """Draw rig ``seed`` from what ``rig`` states, run its tests and fit each."""
    warnings.simplefilter("ignore")
    rig = rig or load_rig()
    truth = draw_truth(seed, rig, uncertain=True, exponent=EXPONENT)
    odd = names[int(np.random.default_rng(seed).integers(len(names)))]
    kept, single, told, low = [], {}, {}, None
    for name in names:
        made = study_rig(
            seed, name, truth=truth, rig=rig, options=replace(options, beta=true_beta(name))
        )
        try:
            one, single[name] = kept_of(name, made.test)
        except InputError as problem:
            print(seed, name, problem)
            continue
        kept.append(one)
        told[name] = {k: float(made.told[k]) for k in ("beta", "h_fast", "h_slow")}
        told[name] |= {f"lag_{d}_s": made.truth.disk(d).common_lag_s for d in ("fast", "slow")}
        if name == odd:
            scaled = replace(
                made.test,
                power_W=LOW_FRICTION * made.test.power_W,
                friction_N=LOW_FRICTION * made.test.friction_N,
            )
            low = kept_of(name, scaled)[0]
    assert low is not None
    return DrawnCampaign(seed, tuple(kept), single, told, low)
