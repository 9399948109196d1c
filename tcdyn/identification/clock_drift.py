"""Test for a delay of the output that grows or shrinks along the record: two clocks of other rates.

Input and output of two loggers are joined by their time stamps. If one clock is faster by a rate r,
the output is y(t) = x(t - r (t - t_mean)) of the modelled output x, so that its derivative with
respect to r is t - t_mean times that with respect to the dead time.
``tcdyn.identification.validation`` regresses the residuals on this direction.
``tests/identify/test_clock_drift.py`` checks rate, detection and false alarms; ``python -m
tests.identify.clock_study`` prints them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tcdyn.core import Array
from tcdyn.core.findings import Finding, warning
from tcdyn.estimation.clock_rate import clock_drift
from tcdyn.identification.models import base_name
from tcdyn.identification.search import Fit


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
    uncertainties. Of other departures (``others``, and parameters that change with time), none
    explains more alone, and all explain nothing beyond it, or little (``MIN_CLOCK_SHARE``).

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
