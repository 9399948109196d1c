"""Campaigns of random linear tests, drawn from their own priors: fast, and solvable by other
means."""

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
SPECIFIC = ("parting",)
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
LAG_S = 0.7
LAG_U_S = 0.05
LOADS_N = (850.0, 1460.0, 1850.0, 2320.0)
SPEEDS_m_s = (10.0, 13.0, 16.0, 20.0)
PER_N = -3e-5
PER_M_S = -3e-3
EXPONENT = 0.70
RATIO = 4.24


@dataclass(frozen=True)
class Toy:
    """Compressed tests, their true values (N, 5), and the true shared parameters by name."""

    tests: tuple[SufficientStatistics, ...]
    true_values: Array
    shared: dict[str, float]


def toy(
    seed: int, count: int = 16, rig: str = "toy", noise: float = 1.0, departure: float = 1.0
) -> Toy:
    """``count`` tests of one rig; the same seed gives the same rig.

    The shared parameters depart from what is stated by ``departure`` times as much as is stated.
    """
    rng = np.random.default_rng(seed)
    names = (*QUANTITIES, *SHARED, *SPECIFIC)
    shared_names = dict.fromkeys(
        [
            *(
                n
                for nuisance_values in SHARED
                for n in LOADING.get(nuisance_values, Loading({nuisance_values: 1.0})).shared
            )
        ]
    )
    shared = {name: departure * float(rng.standard_normal()) for name in shared_names}
    common_lag_s = {
        d: LAG_S + np.sqrt(LAG_U_S**2 - LAG_TEST_SD_S**2) * rng.standard_normal() for d in DISKS
    }
    base = rng.standard_normal((40, len(names))) * np.array(
        [300, 30, 15, 60, 60, *[1.0] * (len(names) - 5)]
    )
    # the effect of a depth resembles that of beta
    base[:, len(QUANTITIES)] = 0.004 * base[:, 0] + 0.02 * base[:, len(QUANTITIES)]
    tests = []
    true_values = []
    for k in range(count):
        load = LOADS_N[k % 4]
        speed = SPEEDS_m_s[k // 4 % 4]
        ln_h = np.log(700.0) + 0.05 * rng.standard_normal()
        truth = np.array(
            [
                0.70 + PER_N * (load - 1620.0) + PER_M_S * (speed - 15.0),
                ln_h,
                ln_h - EXPONENT * np.log(RATIO),
                *(common_lag_s[d] + LAG_TEST_SD_S * rng.standard_normal() for d in DISKS),
            ]
        )
        nuisance_values = []
        for name in (*SHARED, *SPECIFIC):
            loading = LOADING.get(name, Loading({name: 1.0}))
            nuisance_values.append(
                sum(shared[n] * x for n, x in loading.shared.items())
                + loading.specific * rng.standard_normal()
            )
        x = np.concatenate([truth, nuisance_values])
        rows = base * (1 + 0.05 * rng.standard_normal(base.shape)) * (0.6 + speed / 30)
        centre = x + rng.standard_normal(len(x)) * np.array(
            [0.01, 0.05, 0.1, 0.05, 0.05, *[1.0] * (len(x) - 5)]
        )
        rhs = rows @ (x - centre) + noise * rng.standard_normal(len(rows))
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
        tests.append(
            SufficientStatistics(
                f"EHL_{'ABCD'[k // 4 % 4]}{k % 4 + 1}" + ("" if count <= 16 else f"_{k}"),
                rig,
                names,
                centre,
                rows,
                rhs,
                LOADING,
                dict.fromkeys(DISKS, LAG_S),
                dict.fromkeys(DISKS, LAG_U_S),
                UNITS,
                conditions,
            )
        )
        true_values.append(truth)
    return Toy(tuple(tests), np.array(true_values), shared)


def beta_json(statistics: SufficientStatistics) -> dict[str, object]:
    """The part of a beta.json that a campaign reads."""
    beta = {"value": 0.7, "u": 0.004, "low95": 0.692, "high95": 0.708}
    lines = {
        f"{d}_line": {"intercept": {"value": a}, "slope": {"value": b}}
        for d, a, b in (("fast", 0.328, 4.18e-4), ("slow", 0.175, 2.55e-4))
    }
    heat = {
        "value": statistics.conditions["delta_T_us_K_m_s"],
        "u": 1.0,
        "low95": 0.0,
        "high95": 1.0,
    }
    return {
        "kept": statistics.to_dict(),
        "status": "sound",
        "joint": {"both": {"beta": beta}},
        "steady": lines,
        "surface": {"delta_T_us": heat},
        "findings": [],
    }
