"""The exponent of the speed law h ~ u^n from all tests at once, and whether a power law is enough."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration import Array
from calibration.estimate import Estimate
from tcdyn.campaign.lines import fit_line
from tcdyn.campaign.posterior import LN_H_FAST, LN_H_SLOW, A, Posterior, u_if_known, within
from tcdyn.campaign.trends import LEAST_TESTS, set_points


@dataclass(frozen=True)
class SpeedLaw:
    """h_fast / h_slow = (u_fast / u_slow)^n over all tests.

    ``exponent`` n, ``scatter`` of the tests' own beyond their uncertainties; ``each`` (N,) and ``u_within`` (N,): n of
    every test and its standard uncertainty against the others; ``by_speed``: how much n rises while the entraining
    speed doubles, zero for a power law, with the chance ``p_value`` of that if it were; None where speeds are alike.
    ``u_if_known``: u of n if one kind of the rig's shared quantities were known, what limits n most first.
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
        return {
            "scatter": self.scatter,
            "each": self.each.tolist(),
            "u_within": self.u_within.tolist(),
            "per_doubled_speed": None if self.by_speed is None else self.by_speed.model_dump(),
            "p_value": self.p_value,
            "u_if_known": dict(self.u_if_known),
        }


def speed_law(posterior: Posterior) -> SpeedLaw:
    """n by generalised least squares from ln(h_fast/h_slow)/ln(u_fast/u_slow) of every test."""
    log_ratio = np.log([t.conditions["speed_ratio"] for t in posterior.tests])
    n = len(log_ratio)
    toward = np.zeros((n, A * n))
    for i, size in enumerate(log_ratio):
        toward[i, A * i + LN_H_FAST], toward[i, A * i + LN_H_SLOW] = 1 / size, -1 / size
    each, covariance = toward @ posterior.answers.ravel(), toward @ posterior.covariance @ toward.T
    line = fit_line(np.ones((n, 1)), each, covariance)
    apart = within(covariance)
    speed = np.array([t.conditions["entraining_speed_m_s"] for t in posterior.tests])
    by_speed = p_value = None
    if n > LEAST_TESTS and set_points(speed) >= LEAST_TESTS:
        doubled = np.log2(speed)
        sloped = fit_line(np.column_stack([np.ones(n), doubled - doubled.mean()]), each, covariance)
        by_speed, p_value = sloped.estimate(1), sloped.no_slope(1)
    known = u_if_known(posterior, line.operator[0] @ toward)
    return SpeedLaw(line.estimate(0), line.scatter, each, apart, by_speed, p_value, known)


def share_by_speed_law(
    fast: tuple[float, float], slow: tuple[float, float], speed_ratio: float, exponent: float
) -> float:
    """beta where the steady lines of both disks meet h_fast/h_slow = ratio^n: (A D + x B (1 - C))/(D + x B).

    beta = A + B h_fast, 1 - beta = C + D h_slow, x = ratio^n. Source: eq. 4.7, corrected.

    >>> fast, slow = (0.37 - 100 * 0.46 / 1100, 0.46 / 1100), (0.20 - 100 * 0.28 / 1100, 0.28 / 1100)
    >>> round(share_by_speed_law(fast, slow, 4.24, 0.667), 2)
    0.73
    """
    (a, b), (c, d), x = fast, slow, speed_ratio**exponent
    return (a * d + x * b * (1 - c)) / (d + x * b)
