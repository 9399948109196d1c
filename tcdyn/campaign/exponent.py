"""Exponent n of the speed law h ~ u^n from all tests of a campaign, and a test of the power law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tcdyn.campaign.line_fit import fit_line
from tcdyn.campaign.posterior import (
    LN_H_FAST,
    LN_H_SLOW,
    N_QUANTITIES,
    Posterior,
    u_if_known,
    within,
)
from tcdyn.campaign.trends import MIN_TESTS, set_points
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import jsonable


@dataclass(frozen=True)
class SpeedLaw:
    """h_fast / h_slow = (u_fast / u_slow)^n over all tests.

    ``exponent`` n, ``scatter`` of the tests' own beyond their uncertainties; ``each`` (N,) and
    ``u_within`` (N,): n of every test and its standard uncertainty against the others;
    ``by_speed``: how much n rises while the entraining speed doubles, zero for a power law, with
    the chance ``p_value`` of that if it were; None where speeds are alike. ``u_if_known``: u of n
    if one kind of the rig's shared quantities were known, what limits n most first.
    """

    exponent: Estimate
    scatter: float
    each: Array
    u_within: Array
    by_speed: Estimate | None
    p_value: float | None
    u_if_known: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """As ``campaign.json`` keeps it beside the exponent."""
        data = dict(jsonable(self))
        return {
            "per_doubled_speed": data.pop("by_speed"),
            **{k: v for k, v in data.items() if k != "exponent"},
        }


def speed_law(posterior: Posterior) -> SpeedLaw:
    """n by generalised least squares from ln(h_fast/h_slow)/ln(u_fast/u_slow) of every test."""
    log_ratio = np.log([t.conditions["speed_ratio"] for t in posterior.tests])
    n = len(log_ratio)
    gradient = np.zeros((n, N_QUANTITIES * n))
    for i, size in enumerate(log_ratio):
        gradient[i, N_QUANTITIES * i + LN_H_FAST] = 1 / size
        gradient[i, N_QUANTITIES * i + LN_H_SLOW] = -1 / size
    each = gradient @ posterior.values.ravel()
    covariance = gradient @ posterior.covariance @ gradient.T
    line = fit_line(np.ones((n, 1)), each, covariance)
    u_within = within(covariance)
    speed = np.array([t.conditions["entraining_speed_m_s"] for t in posterior.tests])
    by_speed = p_value = None
    if n > MIN_TESTS and set_points(speed) >= MIN_TESTS:
        doubled = np.log2(speed)
        sloped = fit_line(np.column_stack([np.ones(n), doubled - doubled.mean()]), each, covariance)
        by_speed = sloped.estimate(1)
        p_value = sloped.p_value_of_zero(1)
    u_known = u_if_known(posterior, line.operator[0] @ gradient)
    return SpeedLaw(line.estimate(0), line.scatter, each, u_within, by_speed, p_value, u_known)
