"""Covariance of identified parameters, and profile-likelihood intervals.

Profile likelihood replaces the quadratic interval where the log-likelihood is not quadratic.
``tcdyn.identification.fit`` and ``tcdyn.identification.level_lag`` use it.
``tests/identify/test_identify_fit.py`` checks that both intervals agree where they should,
``tests/identify/test_identify_results.py`` the rounding of the output,
``tests/identify/test_identify_studies.py`` the coverage.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.findings import warning
from tcdyn.estimation import (
    Loss,
    Optimum,
    inverse,
    minimise,
    robust_covariance,
    sandwich_covariance,
)
from tcdyn.estimation import profile as likelihood_profile
from tcdyn.identification.models import base_name, input_suffix
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.search import Fit, first_moment, sqrt_weights
from tcdyn.identification.validation import ALARM_P, whiteness

Covariance = Literal["auto", "classical", "robust"]  # kind of the covariance

MAX_RELATIVE_U = 0.2  # relative uncertainty of a positive parameter, above which it is profiled
MIN_ZERO_SHARE = 0.1  # zero over lag; below, zero and dead time have the same effect
MAX_LOG_STEP = 1.5  # first step of the profile in the logarithm of a parameter, at most
N_WHITENESS_LAGS = 20  # lags of the whiteness test that decides on the robust covariance


def replace_poor_intervals(fit: Fit, all_parameters: bool) -> Fit:
    """Replace poor quadratic intervals by profile intervals.

    Parameters
    ----------
    fit
        The fit.
    all_parameters
        Whether all intervals are replaced, poor or not.

    Returns
    -------
    Fit
        The fit with other estimates, and a warning for each interval with an open end.

    Notes
    -----
    Stricter limits (``MAX_RELATIVE_U``, ``MIN_ZERO_SHARE``) cost time; the values of the parameters
    do not change.
    """
    estimates = dict(fit.estimates)
    findings = list(fit.findings)
    for name in fit.problem.model.free:
        if not (all_parameters or has_poor_interval(fit, name)):
            continue
        estimate, is_closed = profile(fit, name)
        estimates[name] = estimate
        if not is_closed:
            findings.append(
                warning(
                    "fit.open_interval",
                    subject=name,
                    low95=estimate.low95,
                    high95=estimate.high95,
                )
            )
    identified = replace(fit.identified, estimates=estimates, findings=tuple(findings))
    return replace(fit, identified=identified)


@with_named_arguments
def profile(fit: Fit, name: str) -> tuple[Estimate, bool]:
    """Estimate of a parameter with its 95 % profile-likelihood interval.

    Parameters
    ----------
    fit
        The fit.
    name
        Name of a free parameter.

    Returns
    -------
    tuple
        The estimate, and whether both ends of the interval were reached.

    Notes
    -----
    The deviance is in units of the reported variance, sandwich covariance and rounding included.
    The limit is from Student's t. Of a fit that is averaged over noise the profile is that under
    the likeliest noise, moved to the mean.

    Examples
    --------
    >>> from tcdyn.identification import IOData, fit, process, simulate
    >>> u = np.repeat([20.0, 80.0, 20.0], 60)
    >>> truth = process("P1").rational({"Kp": 1.0, "Tp1": 0.75})
    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(0).normal(0, 0.2, len(u))
    >>> data = IOData.from_arrays(u, y, 0.05, hold="zoh")

    >>> estimate, is_closed = profile(fit(data, "P1"), "Tp1")
    >>> estimate.contains(0.75), is_closed
    (True, True)
    """
    problem = fit.problem
    e = fit.innovation
    index = problem.model.free.index(name)
    dof = problem.n_measured - problem.size
    positive = problem.model.is_positive(name)
    variance = float(e @ e) / dof
    u = float(np.sqrt(max(fit.covariance_x[index, index], 1e-30)))
    optimum = fit.optimum
    if fit.noise.averaged:
        # the mean over noise models is not the minimum under the likeliest one
        optimum = minimise(optimum.problem, optimum.theta, tolerance=0.0, relative=1e-9)
    shift = float(fit.x[index] - optimum.theta[index])
    inflation = 1.0
    if fit.identified.statistics["robust_covariance"]:
        classical = variance * optimum.covariance[index, index]
        reported = float(fit.covariance_x[index, index])
        if reported > 0 and classical > 0:  # not where the record says nothing of the parameter
            inflation = reported / classical
    t = float(stdtrit(dof, 0.975))
    curve = likelihood_profile(
        optimum,
        name,
        u=min(u, MAX_LOG_STEP) if positive else u,
        scale=variance * inflation,
        level=t**2,
        max_deviance=t**2,
        step=t,
        max_distance=1e3,
        refine=0.01,
        limit=25,
        tolerance=0.0,
        relative=1e-9,
    )
    low = shift + (curve.value[0] if curve.low95 is None else curve.low95)
    high = shift + (curve.value[-1] if curve.high95 is None else curve.high95)
    if positive:
        low, high = np.exp([low, high])
    quadratic = fit.estimates[name]
    interval = Estimate(
        value=quadratic.value,
        u=min(quadratic.u, float(high - low) / (2 * Z95)),
        low95=float(low),
        high95=float(high),
    )
    return interval, curve.low95 is not None and curve.high95 is not None


def has_poor_interval(fit: Fit, name: str) -> bool:
    """Whether the quadratic interval of a parameter is unreliable.

    Parameters
    ----------
    fit
        The fit.
    name
        Name of a free parameter.

    Returns
    -------
    bool
        True where a positive parameter has a large uncertainty, where a small zero and a dead time
        have the same effect, and where a dead time may be below zero.
    """
    estimate = fit.estimates[name]
    model = fit.problem.model
    if model.is_positive(name):
        return estimate.u > MAX_RELATIVE_U * estimate.value
    zero, delay = (n + input_suffix(name) for n in ("Tz", "Td"))
    if name in (zero, delay) and {zero, delay} <= set(model.free):
        lag = first_moment(fit.problem, fit.x)
        return abs(fit.estimates[zero].value) < MIN_ZERO_SHARE * lag
    return base_name(name) == "Td" and estimate.low95 < 0


def innovation_covariance(
    e: Array,
    j: Array,
    slices: list[slice],
    dt_s: float,
    precision: Array,
    kind: Covariance = "auto",
) -> tuple[Array, bool]:
    """Covariance (P, P) of the parameters from the innovations.

    Parameters
    ----------
    e, j
        Innovations (N,) and their Jacobian (N, P).
    slices
        Consecutive samples in ``e``.
    dt_s
        Sampling interval [s].
    precision
        Prior precision (P,), in units of the noise.
    kind
        "classical", "robust" (sandwich), or "auto": robust where the innovations are coloured.

    Returns
    -------
    tuple
        The covariance, and whether it is the robust one.
    """
    is_coloured = kind == "auto" and whiteness(e, j, slices, dt_s, N_WHITENESS_LAGS).p < ALARM_P
    if kind == "robust" or is_coloured:
        return sandwich_covariance(j, e, slices, precision), True
    variance = float(e @ e) / (len(e) - len(precision))
    return variance * inverse(j.T @ j + np.diag(precision)), False


def parameter_covariance(
    problem: IdentificationProblem,
    optimum: Optimum,
    residual: Array,
    kind: Covariance,
    loss: Loss,
) -> tuple[Array, bool]:
    """Covariance of x, with the contribution of a coarse logger (:func:`rounding_covariance`).

    Parameters
    ----------
    problem, optimum
        The identification problem and its optimum.
    residual
        Residuals (N,).
    kind
        As in :func:`innovation_covariance`.
    loss
        The loss function.

    Returns
    -------
    tuple
        The covariance (size, size), and whether it is wider than that of white noise.
    """
    slices = problem.residual_slices
    precision = problem.prior_precision
    root = sqrt_weights(optimum.weights)
    e = -optimum.residual * root
    j = (optimum.jacobian.T * root).T
    covariance, is_wider = innovation_covariance(
        e, j, slices, problem.residual_dt_s, precision, kind
    )
    if loss != "linear":
        covariance = robust_covariance(optimum.residual, optimum.jacobian, loss)
    rounding = rounding_covariance(problem, optimum, residual)
    return covariance + rounding, is_wider or bool(rounding.any())


def rounding_covariance(problem: IdentificationProblem, optimum: Optimum, residual: Array) -> Array:
    """Contribution of a coarse logger to the covariance of x.

    Parameters
    ----------
    problem, optimum
        The identification problem and its optimum.
    residual
        Residuals (N,).

    Returns
    -------
    array
        The contribution (size, size); zero where the noise exceeds the logger's resolution.

    Notes
    -----
    Where the noise is smaller than the logger's resolution, equal readings share one rounding
    error.

    The contribution of rounding is step^2/12 for each run of equal readings.
    ``tests/identify/test_identify_results.py`` checks that intervals include it.
    """
    step = problem.rounding_step
    if np.sqrt(np.mean(residual**2)) >= step:
        return np.zeros((problem.size, problem.size))
    j = (optimum.jacobian.T * sqrt_weights(optimum.weights)).T
    starts = [s.start for s in problem.residual_slices]
    changes = np.flatnonzero(np.abs(np.diff(problem.measured_output)) > 0.5 * step) + 1
    first_readings = np.union1d(starts, changes).astype(int)
    sums = np.add.reduceat(j, first_readings, axis=0)
    sensitivity = sums @ inverse(j.T @ j + np.diag(problem.prior_precision))
    return np.asarray(step**2 / 12 * sensitivity.T @ sensitivity)
