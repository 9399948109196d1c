"""Campaigns of random linear tests, drawn from the very priors that they state: quick, and solved another way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.campaign import SufficientStatistics
from tcdyn.campaign.posterior import LAG_TEST_SD_S
from tcdyn.campaign.sufficient_statistics import QUANTITIES, Loading
from tcdyn.core import Array
from tcdyn.rig.disk import DISKS

SHARED = (
    "depth e fast",
    "depth e slow",
    "conductivity",
    "friction",
    "ambient",
    "static a fast",
    "static a slow",
)
OWN = ("parting",)
UNITS = {
    "depth e fast": 1e-4,
    "depth e slow": 1e-4,
    "conductivity": 0.02,
    "friction": 0.01,
    "ambient": 0.5,
    "static a fast": 0.08,
    "static a slow": 0.08,
    "parting": 0.01,
}
LOADING = {
    "parting": Loading({}, 1.0),
    "friction": Loading({"friction": 0.995}, float(np.sqrt(1 - 0.995**2))),
    "static a fast": Loading({"line level a fast": 0.8, "line gain a fast": 0.5}, 0.2),
    "static a slow": Loading({"line level a slow": 0.8, "line gain a slow": 0.5}, 0.2),
}
LAG_S, LAG_U_S = 0.7, 0.05
LOADS_N, SPEEDS_m_s = (850.0, 1460.0, 1850.0, 2320.0), (10.0, 13.0, 16.0, 20.0)
PER_N, PER_M_S, EXPONENT, RATIO = -3e-5, -3e-3, 0.70, 4.24


@dataclass(frozen=True)
class Toy:
    """Kept tests, their true answers (N, 5), and the true shared quantities by name."""

    kept: tuple[SufficientStatistics, ...]
    answers: Array
    shared: dict[str, float]


def toy(seed: int, count: int = 16, rig: str = "toy", noise: float = 1.0) -> Toy:
    """``count`` tests of one rig; the same seed is the same rig."""
    rng = np.random.default_rng(seed)
    names = (*QUANTITIES, *SHARED, *OWN)
    rig_wide = dict.fromkeys(
        [*(n for q in SHARED for n in LOADING.get(q, Loading({q: 1.0})).shared)]
    )
    shared = {name: float(rng.standard_normal()) for name in rig_wide}
    lag = {d: LAG_S + np.sqrt(LAG_U_S**2 - LAG_TEST_SD_S**2) * rng.standard_normal() for d in DISKS}
    base = rng.standard_normal((40, len(names))) * np.array(
        [300, 30, 15, 60, 60, *[1.0] * (len(names) - 5)]
    )
    base[:, len(QUANTITIES)] = (
        0.004 * base[:, 0] + 0.02 * base[:, len(QUANTITIES)]
    )  # a depth that looks like beta
    kept, answers = [], []
    for k in range(count):
        load, speed = LOADS_N[k % 4], SPEEDS_m_s[k // 4 % 4]
        ln_h = np.log(700.0) + 0.05 * rng.standard_normal()
        truth = np.array(
            [
                0.70 + PER_N * (load - 1620.0) + PER_M_S * (speed - 15.0),
                ln_h,
                ln_h - EXPONENT * np.log(RATIO),
                *(lag[d] + LAG_TEST_SD_S * rng.standard_normal() for d in DISKS),
            ]
        )
        q = []
        for name in (*SHARED, *OWN):
            each = LOADING.get(name, Loading({name: 1.0}))
            q.append(
                sum(shared[n] * x for n, x in each.shared.items())
                + each.specific * rng.standard_normal()
            )
        x = np.concatenate([truth, q])
        rows = base * (1 + 0.05 * rng.standard_normal(base.shape)) * (0.6 + speed / 30)
        centre = x + rng.standard_normal(len(x)) * np.array(
            [0.01, 0.05, 0.1, 0.05, 0.05, *[1.0] * (len(x) - 5)]
        )
        right = rows @ (x - centre) + noise * rng.standard_normal(len(rows))
        conditions = {
            "load_N": load,
            "friction_N": 0.01 * load,
            "sliding_speed_m_s": speed,
            "entraining_speed_m_s": 0.8 * speed,
            "speed_ratio": RATIO,
            "power_W": 0.01 * load * speed,
            "speed_exponent": 0.667,
            "delta_T_us_K_m_s": 0.02 * load * speed,
        }
        kept.append(
            SufficientStatistics(
                f"EHL_{'ABCD'[k // 4 % 4]}{k % 4 + 1}" + ("" if count <= 16 else f"_{k}"),
                rig,
                names,
                centre,
                rows,
                right,
                LOADING,
                dict.fromkeys(DISKS, LAG_S),
                dict.fromkeys(DISKS, LAG_U_S),
                UNITS,
                conditions,
            )
        )
        answers.append(truth)
    return Toy(tuple(kept), np.array(answers), shared)


def answer_of(kept: SufficientStatistics) -> dict[str, object]:
    """A beta.json that holds no more than a campaign reads."""
    nothing = {"value": 0.7, "u": 0.004, "low95": 0.692, "high95": 0.708}
    lines = {
        f"{d}_line": {"intercept": {"value": a}, "slope": {"value": b}}
        for d, a, b in (("fast", 0.328, 4.18e-4), ("slow", 0.175, 2.55e-4))
    }
    heat = {"value": kept.conditions["delta_T_us_K_m_s"], "u": 1.0, "low95": 0.0, "high95": 1.0}
    return {
        "kept": kept.to_dict(),
        "status": "sound",
        "joint": {"both": {"beta": nothing}},
        "steady": lines,
        "surface": {"delta_T_us": heat},
        "findings": [],
    }
