"""Test for a delay of the output that grows or shrinks along the record: two clocks of other rates.

Input and output of two loggers are joined by their time stamps. If one clock is faster by a rate r,
the output is y(t) = x(t - r (t - t_mean)) of the modelled output x, so that its derivative with
respect to r is t - t_mean times that with respect to the dead time. ``tcdyn.identification.validation`` regresses the residuals on
this direction. ``tests/identify/test_clock_drift.py`` checks rate, detection and false alarms;
``python -m tests.identify.clock_study`` prints them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, ndtri

from tcdyn.core import Array
from tcdyn.core.findings import Finding, warning
from tcdyn.estimation import autocorrelation_factor, orthonormal_basis
from tcdyn.identification.models import base_name
from tcdyn.identification.search import Fit

# Probability of a warning on a record of one clock, of normal noise and a linear model.
CLOCK_ALARM_P = 1e-3
# Standard uncertainties by which such a rate differs from zero (two-sided).
CLOCK_LIMIT = float(-ndtri(CLOCK_ALARM_P / 2))
# p of what other departures explain beyond the rate, below which they may be the cause.
OTHER_CAUSE_P = 1e-3
# Share of the sum of squares of all departures that the rate explains alone, above which it is the
# cause even where the rest is significant: a large change of the delay is not linear in the rate.
# A time constant that changes steadily gives 0.2 to 0.7 (`python -m tests.identify.clock_study`).
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
    """

    rate: float
    u: float
    other_p: float
    share: float

    @property
    def is_shown(self) -> bool:
        """Whether the residuals show a rate, and no other departure explains them better."""
        is_significant = abs(self.rate) > CLOCK_LIMIT * self.u
        is_the_cause = self.other_p >= OTHER_CAUSE_P or self.share >= MIN_CLOCK_SHARE
        return is_significant and is_the_cause


def centred_time_s(fit: Fit) -> Array:
    """Time of each measured sample (N,) since the start of its run, less the mean of all [s]."""
    problem = fit.problem
    times_s = []
    for segment in problem.segments:
        start_s = segment.start_s - problem.run_start_s[segment.run]
        times_s.append((start_s + problem.dt_s * np.arange(len(segment.y)))[segment.measured])
    time_s = np.concatenate(times_s)
    return np.asarray(time_s - time_s.mean())


def clock_column(fit: Fit) -> Array:
    """Derivative of the output (N,) with respect to the rate of its delay [output unit]."""
    problem = fit.problem
    slopes = problem.delay_slopes(fit.x)
    assert slopes is not None  # the model is stable, it was fitted
    measured = [slope[segment.measured] for segment, slope in zip(problem.segments, slopes)]
    return np.asarray(centred_time_s(fit) * np.concatenate(measured))


def parameter_columns(fit: Fit) -> Array:
    """Changes of the output (N, M) by parameters of the model that change steadily with time.

    The dead time is left out: its change is that of the clock.
    """
    evaluated = fit.problem.evaluate(fit.x)
    assert evaluated is not None  # the model is stable, it was fitted
    names = fit.problem.model.free
    kept = [k for k, name in enumerate(names) if base_name(name) != "Td"]
    return np.asarray(centred_time_s(fit)[:, None] * evaluated[1][:, kept])


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
    return ClockDrift(rate, u, other_p, share)


def clock_findings(
    fit: Fit, e: Array, jacobian: Array, others: Array, whitened: Callable[[Array], Array]
) -> tuple[Finding, ...]:
    """Return a warning where the delay of the output drifts along the record.

    Parameters
    ----------
    fit
        The fit.
    e, jacobian
        Whitened innovations (N,) and their Jacobian (N, P).
    others
        Whitened changes of the output by what else the model may lack (N, M).
    whitened
        Function that whitens columns (N, M) of an output.

    Returns
    -------
    tuple of Finding
        Empty, or "record.clock_drift".

    Notes
    -----
    A warning needs two conditions. The rate differs from zero by ``CLOCK_LIMIT`` standard
    uncertainties. Other departures (``others``, and parameters that change with time) explain
    nothing beyond it, or little (``MIN_CLOCK_SHARE``).

    Not distinguished: a dead time of the plant that itself changes at a constant rate, such as that
    of a pipe whose flow falls steadily; and lags that are short compared with the sampling interval
    or with the changes of the input, since they act as a dead time. All inputs are taken as of one
    clock. With several runs the delay is equal at their starts. A rate that is not constant gives
    its mean, or no warning.
    """
    columns = np.column_stack([clock_column(fit), parameter_columns(fit)])
    column, *by_parameter = whitened(columns).T
    result = clock_drift(e, jacobian, column, np.column_stack([*by_parameter, others]))
    if result is None or not result.is_shown:
        return ()
    finding = warning(
        "record.clock_drift",
        subject=fit.identified.output_name,
        input=fit.identified.input_name,
        rate_ppm=1e6 * result.rate,
        u_ppm=1e6 * result.u,
        change_s=result.rate * float(np.ptp(centred_time_s(fit))),
        factor=1 + result.rate,
    )
    return (finding,)
