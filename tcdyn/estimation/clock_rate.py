"""Rate at which a delay drifts along a record, as between two loggers whose clocks differ.

``tcdyn.identification.clock_drift`` regresses the residuals of a fit on the derivative with respect
to the rate; ``tcdyn.sensors.pair`` fits the rate with its own model and has the same limit.
``tests/identify/test_clock_drift.py`` checks rate, detection and false alarms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, ndtri

from tcdyn.core import Array
from tcdyn.estimation.arma import autocorrelation_factor
from tcdyn.estimation.problem import orthonormal_basis

# Probability of a warning on a record of one clock, of normal noise and a linear model.
CLOCK_ALARM_P = 1e-3
# Standard uncertainties by which such a rate differs from zero (two-sided).
CLOCK_LIMIT = float(-ndtri(CLOCK_ALARM_P / 2))
# p of what other departures explain beyond the rate, below which they may be the cause.
OTHER_CAUSE_P = 1e-3
# Share of the sum of squares of all departures that the rate explains alone, above which it is the
# cause even where the rest is significant: a large change of the delay is not linear in the rate.
# A time constant that changes by 2 to 30 % gave 0.02 to 0.54, a rate of 300 ppm in white noise 0.99
# (`python -m tests.identify.clock_study`); 0.9 between them is by judgement.
MIN_CLOCK_SHARE = 0.9
# Norm of a direction beyond the Jacobian over its own norm, below which the fit takes it up.
MIN_DIRECTION = 1e-6


@dataclass(frozen=True)
class ClockDrift:
    """Rate of the delay of the output behind the inputs.

    Parameters
    ----------
    rate
        Change of the delay over time [s/s]; above zero where the delay grows.
    u
        Its standard uncertainty.
    other_p
        p of the other departures beyond the rate.
    share
        Share of the sum of squares of all departures that the rate explains alone.
    is_best
        No other departure explains more of the residuals alone.
    """

    rate: float
    u: float
    other_p: float
    share: float
    is_best: bool

    @property
    def is_shown(self) -> bool:
        """Whether the residuals show a rate, and no other departure explains them better."""
        is_significant = abs(self.rate) > CLOCK_LIMIT * self.u
        is_the_cause = self.other_p >= OTHER_CAUSE_P or self.share >= MIN_CLOCK_SHARE
        return is_significant and self.is_best and is_the_cause


def clock_drift(e: Array, jacobian: Array, column: Array, others: Array) -> ClockDrift | None:
    """Estimate the rate of the delay from whitened residuals.

    Parameters
    ----------
    e, jacobian
        Whitened residuals (N,), measured less modelled, and their Jacobian (N, P).
    column
        Whitened derivative of the output with respect to the rate (N,).
    others
        Whitened changes of the output by other departures (N, M).

    Returns
    -------
    ClockDrift or None
        None where the fit takes up the rate.

    Notes
    -----
    With d the part of ``column`` that is orthogonal to the Jacobian, the rate is d'e/d'd. Its
    variance is s^2/d'd, with s^2 of the residuals without the rate, times the autocorrelation
    factor of the scores d e. So the uncertainty includes that of all parameters of the fit.
    """
    q = orthonormal_basis(jacobian)

    def beyond_fit(columns: Array) -> Array:
        """Return columns (N, M) without what the Jacobian explains, projected out twice."""
        once = columns - q @ (q.T @ columns)
        return np.asarray(once - q @ (q.T @ once))

    direction = beyond_fit(column[:, None])[:, 0]
    size = float(np.linalg.norm(direction))
    dof = len(e) - q.shape[1] - 1
    if size <= MIN_DIRECTION * float(np.linalg.norm(column)) or dof < 1:
        return None
    rate = float(direction @ e) / size**2
    rest = e - q @ (q.T @ e) - rate * direction
    variance = float(rest @ rest) / dof
    factor = autocorrelation_factor(direction * rest)
    u = float(np.sqrt(variance * factor)) / size
    by_rate = rate**2 * size**2
    unit = direction / size
    remaining = beyond_fit(others)
    lengths = np.maximum(np.linalg.norm(remaining, axis=0), 1e-300)
    is_free = lengths > MIN_DIRECTION * np.linalg.norm(others, axis=0)
    alone = np.where(is_free, (remaining.T @ e / lengths) ** 2, 0.0)
    is_best = bool(by_rate >= np.max(alone, initial=0.0))
    remaining = remaining - np.outer(unit, unit @ remaining)
    norms = np.linalg.norm(remaining, axis=0)
    basis = orthonormal_basis(remaining[:, norms > MIN_DIRECTION * np.linalg.norm(others, axis=0)])
    rank = basis.shape[1]
    by_others = float(np.sum((basis.T @ rest) ** 2))
    other_p = 1.0
    if rank and dof > rank:
        unexplained = max((dof * variance - by_others) / (dof - rank), 1e-300)
        other_p = float(fdtrc(rank, dof - rank, by_others / rank / unexplained))
    share = by_rate / max(by_rate + by_others, 1e-300)
    return ClockDrift(rate, u, other_p, share, is_best)
