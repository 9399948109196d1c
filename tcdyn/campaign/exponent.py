"""Exponent n of the speed law h ~ u^n from all tests of a campaign, and a test of the power law.

``tcdyn.campaign.result`` and ``tcdyn.campaign.planned`` call ``speed_law``. Guarded by
``tests/campaign/test_posterior.py`` and ``tests/campaign/test_lines.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tcdyn.campaign.line_fit import fit_generalised_line
from tcdyn.campaign.posterior import (
    LN_H_FAST,
    LN_H_SLOW,
    N_QUANTITIES,
    Posterior,
    u_if_known,
    within_campaign_u,
)
from tcdyn.campaign.trends import MIN_TESTS, set_points
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import jsonable
from tcdyn.partition.model_forms import is_undetermined


@dataclass(frozen=True)
class SpeedLaw:
    """h_fast / h_slow = (u_fast / u_slow)^n over all tests.

    Parameters
    ----------
    exponent
        n of all tests.
    scatter
        Standard deviation of the scatter of n between tests, beyond their uncertainties.
    each
        n of every test, (N,).
    u_within
        Standard uncertainty of each against the others, (N,).
    by_speed
        How much n rises while the entraining speed doubles, zero for a power law; None where there
        are too few tests or speeds.
    p_value
        Probability of such a rise if the power law holds; None like ``by_speed``.
    u_if_known
        Standard uncertainty of n if one kind of shared quantity of the rig were known; what limits
        n most comes first.
    """

    exponent: Estimate
    scatter: float
    each: Array
    u_within: Array
    by_speed: Estimate | None
    p_value: float | None
    u_if_known: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_determined(self) -> bool:
        """Whether the tests say anything about n."""
        return not is_undetermined(self.exponent)

    @property
    def text(self) -> str:
        """The exponent with its standard uncertainty, or that it is not determined."""
        text = f"n = {self.exponent.text_without_interval()}"
        return text if self.is_determined else f"n is not determined ({text})"

    def to_dict(self) -> dict[str, Any]:
        """The entry "speed_law" of ``campaign.json``, without the exponent."""
        data = dict(jsonable(self))
        return {
            "per_doubled_speed": data.pop("by_speed"),
            **{k: v for k, v in data.items() if k != "exponent"},
        }


def speed_law(posterior: Posterior) -> SpeedLaw:
    """The exponent by generalised least squares.

    Parameters
    ----------
    posterior
        Posterior of the campaign.

    Notes
    -----
    n of a test is ln(h_fast/h_slow)/ln(u_fast/u_slow); its uncertainty follows from the posterior.
    The test of the power law is a straight line of n over log2 of the entraining speed; it needs
    more than ``MIN_TESTS`` tests and at least ``MIN_TESTS`` speeds.
    """
    log_ratio = np.log([t.conditions["speed_ratio"] for t in posterior.tests])
    n = len(log_ratio)
    gradient = np.zeros((n, N_QUANTITIES * n))
    for i, size in enumerate(log_ratio):
        gradient[i, N_QUANTITIES * i + LN_H_FAST] = 1 / size
        gradient[i, N_QUANTITIES * i + LN_H_SLOW] = -1 / size
    each = gradient @ posterior.values.ravel()
    covariance = gradient @ posterior.covariance @ gradient.T
    line = fit_generalised_line(np.ones((n, 1)), each, covariance)
    u_within = within_campaign_u(covariance)
    speed = np.array([t.conditions["entraining_speed_m_s"] for t in posterior.tests])
    by_speed = p_value = None
    if n > MIN_TESTS and set_points(speed) >= MIN_TESTS:
        doubled = np.log2(speed)
        sloped = fit_generalised_line(
            np.column_stack([np.ones(n), doubled - doubled.mean()]), each, covariance
        )
        by_speed = sloped.estimate(1)
        p_value = sloped.p_value_of_zero(1)
    u_known = u_if_known(posterior, line.operator[0] @ gradient)
    return SpeedLaw(line.estimate(0), line.scatter, each, u_within, by_speed, p_value, u_known)
