"""Residual tests of a fit: whiteness (Ljung-Box) and residual-input correlation (F test).

The bounds are corrected for the part of the noise that the fit absorbs. The residuals of a fit are
(I - H) times the noise, H = J (J'J)^-1 J'. Whiteness: the fit itself adds -s^2 tr(H S_k) to the
expectation of the k-th autocovariance; this is subtracted before Ljung and Box's sum. Input
correlation: the vector of correlations with lagged inputs U has exactly the covariance s^2 U'(I -
H)U, so the test is an F test in the directions of U that the fit has not absorbed.

``tcdyn.identification.fit``, ``comparison`` and ``tcdyn.plots.identify`` use it.
``tests/identify/test_identify_residuals.py`` checks both tests against their definitions;
``tests/identify/test_identify_results.py`` and ``test_identify_studies.py`` in that folder check
the rate of false alarms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc, ndtri

from tcdyn.chain.rational import simulate
from tcdyn.core import Array, Flags
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError, Spelling, as_argument
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import Result
from tcdyn.estimation import (
    NoiseModel,
    autocovariance,
    fit_ar,
    inverse,
    orthonormal_basis,
    sandwich_covariance,
)
from tcdyn.estimation.trace_noise import MAD_TO_SD
from tcdyn.identification.clock_drift import clock_column, clock_findings
from tcdyn.identification.identified import DRIVEN_P
from tcdyn.identification.iodata import IOData
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.search import Fit, make_problem
from tcdyn.identification.segments import Segment

# Thresholds, chosen by judgement.
# Correlation of residuals with time that is a drift: a quarter of their variance is a line.
MIN_DRIFT_CORRELATION = 0.5
# Fit of the output without the disturbance [%] below which the disturbance may replace dynamics.
LITTLE_FIT_PERCENT = 25.0
# p of the test with future inputs below which no model is recommended.
FEEDBACK_P = 1e-3
# p below which there is a finding; the pointwise bounds are at 5 %.
ALARM_P = 0.01
# Probability of one outlier in a record of normal noise at which a residual is a spike.
SPIKE_P = 0.005
# Relative difference of two sampling intervals that is rounding of the time stamps.
DT_TOLERANCE = 1e-6
# Residuals over the largest output, up to which they are numerical errors.
NUMERICAL_ERROR = 1e-9
# Sampling interval over the sum of the lags, above which several structures fit the samples equally
# well, with other lags. Of the 95 % intervals of the lag 1 of 70 missed the truth below 0.6, 1 of
# 30 between 0.6 and 0.75, and 11 of 42 at 0.75 to 1 (case A and four other systems of one to three
# lags).
MAX_SAMPLING_SHARE = 0.6
# p of a departure from a linear model. It is reported where it changes the gain over the range or
# the lag between rise and fall by so much [%], or where the residuals exceed this share of the
# range of the output [%].
NONLINEAR_P = 1e-3
MIN_GAIN_CHANGE = 5.0
MIN_LAG_CHANGE = 20.0
MIN_UNEXPLAINED = 3.0
# One jump or spike of the output is left out there: the samples on either side of the largest
# innovation, where it is so many times as large as all others (chosen by judgement).
ROWS_OF_ONE_EVENT = 5
SINGLE_EVENT_RATIO = 4.0
# First residuals of a run over the rms residual, above which it does not start in equilibrium.
MAX_START_RMS = 4.0


@dataclass(frozen=True)
class ResidualTest:
    """Normalised correlations and their joint test.

    Parameters
    ----------
    lags_s
        Lags (L,) [s].
    value
        Correlation at each lag (L,).
    bound95
        Pointwise 95 % bound of each (L,).
    p
        p value of the joint test.
    """

    lags_s: Array
    value: Array
    bound95: Array
    p: float


@dataclass(frozen=True, repr=False)
class Validation(Result):
    """Residual tests of a model; the first finding is the conclusion.

    Parameters
    ----------
    whiteness
        Whiteness test of the innovations.
    input
        Correlation of the innovations with past inputs.
    fit_percent
        NRMSE fit percent of the simulation.
    rms
        Rms residual, in the output's unit.
    findings
        The conclusion, then findings about the record.
    """

    whiteness: ResidualTest
    input: ResidualTest
    fit_percent: float
    rms: float
    findings: tuple[Finding, ...]

    @property
    def sentence(self) -> str:
        """The findings as text."""
        return self.message()

    def summary(self) -> str:
        """Fit percent, rms, p values of the tests, and the findings."""
        return (
            f"fit {self.fit_percent:.2f} %, rms {self.rms:.4g}, p of whiteness "
            f"{self.whiteness.p:.3g}, of the input {self.input.p:.3g}\n{self.sentence}"
        )

    def to_frame(self) -> pd.DataFrame:
        """Correlations of both tests with their 95 % bounds, over the lag [s]."""
        columns = {}
        for name, test in (("whiteness", self.whiteness), ("input", self.input)):
            index = pd.Index(test.lags_s, name="lag_s")
            columns[name] = pd.Series(test.value, index)
            columns[f"{name}_bound95"] = pd.Series(test.bound95, index)
        return pd.DataFrame(columns)

    def message(self, spelling: Spelling = as_argument) -> str:
        """The findings as text, parameters in the given spelling."""
        return " ".join(f.message(spelling) for f in self.findings)

    @property
    def dynamics_missing(self) -> bool:
        """Whether the residuals still follow the input (1 % level)."""
        return self.input.p < ALARM_P

    @property
    def record_problems(self) -> tuple[str, ...]:
        """Codes of the findings about the record that count against it.

        Coarse readings and weak feedback count only where the residuals follow the input.
        """
        codes = [
            "record.off_equilibrium",
            "record.drift",
            "record.clipped",
            "record.slow_sampling",
            "record.nonlinear",
            "record.changing",
            "record.clock_drift",
        ]
        if self.dynamics_missing:
            codes.append("record.coarse")
        feedback_p = [f.numbers["p"] for f in self.findings if f.code == "record.feedback"]
        if self.dynamics_missing or any(p < FEEDBACK_P for p in feedback_p):
            codes.append("record.feedback")
        return tuple(f.code for f in self.findings if f.code in codes)


@with_named_arguments
def validate(fit: Fit, lags: int = 20) -> Validation:
    """Test the residuals of a fit, or its innovations where it has a noise model.

    Parameters
    ----------
    fit
        The fit.
    lags
        Number of lags of each test.

    Returns
    -------
    Validation
        The tests and their findings.

    Notes
    -----
    Of a robust loss the scores psi = w r are tested. At its optimum they are orthogonal to the
    Jacobian, so that the test keeps its level whatever the outliers.

    Coloured innovations are whitened by an autoregression before the input test, or its p would be
    wrong. Lags and shifts may be changed; ``tests/identify/test_identify_results.py`` fails where
    the false alarms are no longer near nominal.

    Examples
    --------
    >>> from tcdyn.identification import IOData, fit, process, simulate
    >>> u = np.repeat([20.0, 80.0, 20.0], 60)
    >>> truth = process("P1").rational({"Kp": 1.0, "Tp1": 0.75})
    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(0).normal(0, 0.2, len(u))
    >>> data = IOData.from_arrays(u, y, 0.05, hold="zoh")

    >>> validate(fit(data, "P1")).dynamics_missing
    False
    """
    problem = fit.problem
    slices = problem.residual_slices
    is_robust = fit.optimum.weights is not None
    e = fit.innovation
    j = fit.jacobian
    if fit.optimum.weights is not None:
        e = -fit.optimum.weights * fit.optimum.residual
        j = fit.optimum.jacobian
    white = whiteness(e, j, slices, problem.residual_dt_s, lags)
    is_coloured = white.p < ALARM_P
    prewhitening = fit_ar(e, slices) if is_coloured else NoiseModel()
    root = 1.0 if is_robust else fit.sqrt_weights[:, None]

    def whitened(columns: Array) -> Array:
        """Return columns (N, M) of an output, whitened as the innovations are."""
        return prewhitening.whiten(fit.noise.whiten(columns * root, slices), slices)

    delays = shifts(problem, fit.identified.longest_lag_s, lags)
    u = whitened(shifted_inputs(problem, delays))
    future = whitened(shifted_inputs(problem, -np.arange(lags // 2)))
    e_white = prewhitening.whiten(e, slices)
    j_white = prewhitening.whiten(j, slices)
    n_inputs = len(problem.branches)
    lags_s = np.tile(problem.dt_s * delays, n_inputs).astype(float)
    cross = input_correlation(e_white, j_white, u, lags_s)
    # residuals within half a step may be rounding errors only
    largest_output = float(np.max(np.abs(problem.measured_output)))
    rounding = max(0.5 * problem.rounding_step, NUMERICAL_ERROR * largest_output)
    is_rounding = bool(np.max(np.abs(fit.residual)) <= rounding)
    if is_rounding:
        white = replace(white, p=1.0)
        cross = replace(cross, p=1.0)
        is_coloured = False
    percent = fit_percent(problem, fit.residual)
    unsettled = off_equilibrium(fit)
    findings = [_first_finding(fit, white, cross, is_coloured, is_rounding, percent)]
    n_spikes = _count_spikes(fit.residual if fit.noise.white else e)
    if n_spikes and cross.p >= ALARM_P and not is_rounding and not unsettled:
        findings.append(warning("residuals.spikes", count=n_spikes, robust=fit.loss != "linear"))
    findings += clipped_output(problem)
    findings += slow_sampling(problem, fit.x)
    n_gaps = sum(s.after_gap for s in problem.segments)
    if n_gaps:
        findings.append(info("record.gaps", count=n_gaps))
    findings += unsettled
    if is_coloured:
        findings += drift(problem, fit.residual)
    rms = float(np.sqrt(np.mean(fit.residual**2)))
    if rms < problem.rounding_step:
        findings.append(warning("record.coarse", step=problem.rounding_step, rms=rms))
    past = np.delete(u, np.arange(n_inputs) * len(delays), axis=1)
    findings += feedback(e_white, j_white, future, past)
    if not is_rounding:
        others = np.column_stack([u, whitened(level_columns(fit))])
        clock = clock_findings(fit, e_white, j_white, others, whitened)
        findings += clock
        if clock:
            # what a drifting delay explains is no change of the response
            j_white = np.column_stack([j_white, whitened(clock_column(fit)[:, None])])
    if cross.p >= ALARM_P and not is_rounding and not problem.model.integrators:
        findings += departures(fit, e_white, j_white, whitened)
    return Validation(
        whiteness=white,
        input=cross,
        fit_percent=percent,
        rms=rms,
        findings=tuple(findings),
    )


def _count_spikes(e: Array) -> int:
    """Number of outliers among the residuals ``e`` (N,)."""
    scale = MAD_TO_SD * float(np.median(np.abs(e - np.median(e)))) or 1.0
    limit = float(-ndtri(SPIKE_P / len(e)))
    return int(np.sum(np.abs(e) > scale * limit))


@with_named_arguments
def confirm(fit: Fit, data: IOData, lags: int = 20) -> Validation:
    """Validate a fit on other data: residual tests, and whether the parameters agree.

    Parameters
    ----------
    fit
        The fit.
    data
        Data that the fit has not used.
    lags
        Number of lags of each test.

    Returns
    -------
    Validation
        The tests on the new data; a last warning where the parameters differ.

    Raises
    ------
    InputError
        For data that cannot be used, or whose sampling differs from that of a noise model.

    Notes
    -----
    Offsets and initial states are fitted to the new data; the parameters stay. The input test is
    beyond what errors of the parameters explain. In addition, the step d by which the new data
    would change the parameters, of covariance C, is compared with the covariance C_0 of the fit:
    d'(C + C_0)^-1 d is chi-squared with one degree of freedom for each parameter. C is robust
    where residuals are coloured. An averaged noise model holds for its own sampling interval; at
    another one the noise counts as white until its residuals are coloured.

    Examples
    --------
    >>> from tcdyn.identification import IOData, fit, process, simulate
    >>> u = np.repeat([20.0, 80.0, 20.0], 60)
    >>> truth = process("P1").rational({"Kp": 1.0, "Tp1": 0.75})
    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(0).normal(0, 0.2, len(u))
    >>> data = IOData.from_arrays(u, y, 0.05, hold="zoh")

    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(1).normal(0, 0.2, len(u))
    >>> confirm(fit(data, "P1"), IOData.from_arrays(u, y, 0.05, hold="zoh")).dynamics_missing
    False
    """
    is_other_interval = abs(data.dt_s / fit.problem.dt_s - 1) > DT_TOLERANCE
    if fit.noise.averaged and is_other_interval:
        fit = replace(fit, noise=NoiseModel())
    problem, x = fit_nuisance_parameters(fit, data)
    k = problem.n_model
    core = problem.least_squares_problem(fit.noise)
    evaluated = core.evaluate(x)
    assert evaluated is not None  # the model is stable, it was fitted
    e, j = evaluated
    unweighted = problem.evaluate(x)
    assert unweighted is not None
    applied = replace(
        fit,
        problem=problem,
        optimum=replace(fit.optimum, theta=x, residual=e, jacobian=j, weights=None),
        residual=-unweighted[0],
        loss="linear",
        weights=None,
    )
    validation = validate(applied, lags)
    if k == 0:
        return validation
    inverse_information = inverse(j.T @ j)
    if validation.whiteness.p >= ALARM_P:
        covariance = float(e @ e) / (len(e) - problem.size) * inverse_information
    else:
        covariance = sandwich_covariance(j, e, problem.residual_slices)
    step = (inverse_information @ (j.T @ e))[:k]
    total = covariance[:k, :k] + fit.covariance_x[:k, :k]
    p = float(chdtrc(k, step @ inverse(total) @ step))
    if p >= ALARM_P:
        return validation
    differs = warning("validation.moved", subject=problem.model.name, p=p)
    return replace(validation, findings=(*validation.findings, differs))


def fit_nuisance_parameters(fit: Fit, data: IOData) -> tuple[IdentificationProblem, Array]:
    """Fit offsets, drifts and initial states to other data; the model's parameters stay.

    Parameters
    ----------
    fit
        The fit.
    data
        Other data.

    Returns
    -------
    problem
        The problem of these data.
    x
        Its vector (size,): the parameters of the fit, then the fitted offsets, drifts and states.

    Raises
    ------
    InputError
        For data that cannot be used, or whose sampling differs from that of a noise model.

    Notes
    -----
    The residual is linear in what is fitted, so one step of least squares is exact.
    """
    old = fit.problem
    if not fit.noise.white and abs(data.dt_s / old.dt_s - 1) > DT_TOLERANCE:
        raise InputError(
            f"sampled every {data.dt_s:g} s, and the noise model every {old.dt_s:g} s",
            where=data.name or "identify",
        )
    problem = replace(
        make_problem(data, old.model, old.initial),
        input_sds=old.input_sds,
        time_scale_s=old.time_scale_s,
        noise_sd=old.noise_sd,
        trend=old.trend,
        wave_sd=old.wave_sd,
    )
    k = problem.n_model
    x = np.concatenate([fit.x[: old.n_model], np.zeros(problem.size - old.n_model)])
    rows = problem.least_squares_problem(fit.noise).evaluate(x)
    assert rows is not None  # the model is stable, it was fitted
    prior = np.diag(np.sqrt(problem.prior_precision))
    jacobian = np.vstack([rows[1], prior])[:, k:]
    residual = np.append(rows[0], prior @ (x - problem.prior_mean))
    x[k:] -= np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    return problem, x


def _first_finding(
    fit: Fit,
    white: ResidualTest,
    cross: ResidualTest,
    is_coloured: bool,
    is_rounding: bool,
    percent: float,
) -> Finding:
    """Return the first finding: what is wrong with the model, or that the tests pass.

    Parameters
    ----------
    fit
        The fit.
    white, cross
        Whiteness test and input test.
    is_coloured
        Whether the innovations are coloured.
    is_rounding
        Whether the residuals may be rounding errors only.
    percent
        Fit percent.

    Returns
    -------
    Finding
        An info where the tests pass, else a warning.
    """
    name = fit.problem.model.name
    if is_rounding:
        return info("residuals.rounding", subject=name)
    if cross.p < ALARM_P:
        worst = int(np.argmax(np.abs(cross.value) / np.maximum(cross.bound95, 1e-300)))
        inputs = fit.problem.model.inputs
        input_name = ""
        if inputs:
            input_name = inputs[worst * len(inputs) // len(cross.value)]
        return warning(
            "residuals.follow_input",
            subject=name,
            fit_percent=percent,
            p_input=cross.p,
            lag_s=float(cross.lags_s[worst]),
            input=input_name,
        )
    if is_coloured:
        return warning(
            "residuals.coloured",
            subject=name,
            noise_model=not fit.noise.white,
            p_white=white.p,
            p_input=cross.p,
        )
    return info("residuals.white", subject=name, p_white=white.p, p_input=cross.p)


def whiteness(
    e: Array, jacobian: Array, slices: list[slice], dt_s: float, lags: int
) -> ResidualTest:
    """Ljung-Box test, corrected for the fit's contribution to the autocovariance.

    Parameters
    ----------
    e, jacobian
        Innovations (N,) and their Jacobian (N, P).
    slices
        Consecutive samples in ``e``.
    dt_s
        Sampling interval [s].
    lags
        Number of lags; less for short records.

    Returns
    -------
    ResidualTest
        Autocorrelations with pointwise bounds, and p from chi-squared.
    """
    n = len(e)
    longest = max(s.stop - s.start for s in slices)
    lags = max(1, min(lags, n // 4, longest - 1))
    q = orthonormal_basis(jacobian)
    variance = max(float(e @ e), 1e-300) / (n - q.shape[1])
    total, pairs = autocovariance(e, slices, lags)
    absorbed = np.zeros(lags + 1)
    for s in slices:
        for k in range(1, min(lags, s.stop - s.start - 1) + 1):
            absorbed[k] += float(np.sum(q[s][k:] * q[s][:-k]))
    z = (total[1:] / variance + absorbed[1:]) / np.sqrt(np.maximum(pairs[1:], 1.0))
    value = total[1:] / max(total[0], 1e-300)
    bound = 1.96 * np.sqrt(pairs[1:]) / n
    lags_s = np.asarray(dt_s * np.arange(1.0, lags + 1))
    return ResidualTest(lags_s, value, bound, float(chdtrc(lags, np.sum(z**2))))


def shifts(problem: IdentificationProblem, lag_s: float, lags: int) -> NDArray[np.int_]:
    """Return the shifts of the input at which residuals are correlated with it.

    Parameters
    ----------
    problem
        The identification problem.
    lag_s
        Lag of the model [s].
    lags
        Number of shifts.

    Returns
    -------
    array
        Shifts in samples, at most ``lags`` of them: 0, 1, 2 .., then with increasing spacing up to
        three times the lag.
    """
    longest = max(len(s.u) for s in problem.segments)
    lags = max(2, min(lags, longest // 8))
    max_shift = min(max(3 * lag_s / problem.dt_s, lags), longest // 3)
    max_shift = max(int(max_shift), lags)
    near = np.arange(lags // 2)
    far = np.geomspace(lags // 2, max_shift, lags - lags // 2)
    return np.unique(np.round(np.unique(np.concatenate([near, far]))).astype(int))


def shifted_inputs(problem: IdentificationProblem, delays: NDArray[np.int_]) -> Array:
    """Return the inputs at shifted times, relative to their level at the segment's start.

    The level is that at the start of the segment. A negative delay gives future inputs; after the
    end of a segment its input stays constant. The columns of one input are adjacent.

    Parameters
    ----------
    problem
        The identification problem.
    delays
        Shifts in samples (L,); negative ones give future inputs.

    Returns
    -------
    array
        Values at the measured samples (N, inputs * L). The columns of one input are adjacent.
    """
    n_past = max(int(delays.max()), 0)
    n_future = max(-int(delays.min()), 0)

    def delayed(segment: Segment) -> Array:
        """Return the shifted first input of a segment (N, L)."""
        past = segment.last_inputs(n_past + 1)
        level = past[0]
        if problem.initial == "zero" and not segment.after_gap:
            level = 0.0
        before = past[1:] if segment.after_gap else np.full(n_past, level)
        after = np.full(n_future, segment.u[-1])
        padded = np.concatenate([before, segment.u, after]) - level
        columns = [padded[n_past - k : n_past - k + len(segment.u)] for k in delays]
        return np.array(columns).T[segment.measured]

    n_inputs = len(problem.branches)
    return np.block([[delayed(s.with_input(k)) for k in range(n_inputs)] for s in problem.segments])


def input_correlation(e: Array, jacobian: Array, u: Array, lags_s: Array) -> ResidualTest:
    """F test of residuals against inputs, beyond what the Jacobian explains.

    Parameters
    ----------
    e, jacobian
        Innovations (N,) and their Jacobian (N, P).
    u
        Shifted inputs (N, M).
    lags_s
        Their lags (M,) [s].

    Returns
    -------
    ResidualTest
        Normalised correlations with pointwise bounds, and p from the F test.
    """
    q = orthonormal_basis(jacobian)
    size = np.linalg.norm(u, axis=0)
    size = np.where(size > 0, size, 1.0)
    remaining = u / size
    # projected out twice, against rounding errors
    remaining = remaining - q @ (q.T @ remaining)
    remaining = remaining - q @ (q.T @ remaining)
    norms = np.linalg.norm(remaining, axis=0)
    dof = len(e) - q.shape[1]
    total = max(float(e @ e), 1e-300)
    basis = orthonormal_basis(remaining[:, norms > 1e-6])
    rank = basis.shape[1]
    explained = float(np.sum((basis.T @ e) ** 2))
    dof_residual = dof - rank
    p = 1.0
    if rank and dof_residual > 0:
        unexplained = max((total - explained) / dof_residual, 1e-300)
        p = float(fdtrc(rank, dof_residual, (explained / rank) / unexplained))
    value = (remaining.T @ e) / np.sqrt(total)
    bound = 1.96 * norms / np.sqrt(dof)
    return ResidualTest(lags_s, value, bound, p)


def nrmse_percent(errors: Sequence[Array], outputs: Sequence[Array]) -> float:
    """Return the NRMSE fit percent of one or several records.

    Parameters
    ----------
    errors
        Measured minus modelled output of each record (N,).
    outputs
        Measured output of each record (N,).

    Returns
    -------
    float
        100 (1 - |error|/|y - mean|), with the mean of each record: 100 is perfect, 0 as bad as the
        mean; NaN for constant outputs.

    Examples
    --------
    >>> nrmse_percent([np.array([1.0, -1.0])], [np.array([0.0, 20.0])])
    90.0
    """
    departures = np.concatenate([y - y.mean() for y in outputs])
    spread = float(np.linalg.norm(departures))
    error = float(np.linalg.norm(np.concatenate(errors)))
    return 100 * (1 - error / spread) if spread > 0 else np.nan


def fit_percent(problem: IdentificationProblem, residual: Array) -> float:
    """Return the NRMSE fit percent, segments pooled; that of one run is MATLAB's ``compare``.

    Parameters
    ----------
    problem
        The identification problem.
    residual
        Residuals (N,).

    Returns
    -------
    float
        As :func:`nrmse_percent`, with the mean of each segment; 0 for a constant output.
    """
    percent = nrmse_percent([residual], problem.by_segment(problem.measured_output))
    return percent if np.isfinite(percent) else 0.0


def off_equilibrium(fit: Fit) -> tuple[Finding, ...]:
    """Return a warning where a run starts off the assumed equilibrium.

    The start is the median of the first 3 samples.

    Parameters
    ----------
    fit
        The fit.

    Returns
    -------
    tuple of Finding
        Empty, or one warning.

    Notes
    -----
    The start is the median of the first three residuals, so that one spike does not count.
    ``tests/identify/test_identify_residuals.py`` checks the limit ``MAX_START_RMS``.
    """
    problem = fit.problem
    if problem.initial != "equilibrium":
        return ()
    rms = float(np.sqrt(np.mean(fit.residual**2)))
    largest = 0.0
    for residual, free_state in zip(problem.by_segment(fit.residual), problem.has_free_state):
        if not free_state:
            largest = max(largest, abs(float(np.median(residual[:3]))))
    if not largest > MAX_START_RMS * rms:
        return ()
    return (warning("record.off_equilibrium", off=largest, times_rms=largest / rms),)


def clipped_output(problem: IdentificationProblem) -> tuple[Finding, ...]:
    """Return a warning where samples of the output were left out because they are at a limit."""
    n_clipped = sum(int(np.sum(np.isfinite(s.y) & ~s.measured)) for s in problem.segments)
    return (warning("record.clipped", count=n_clipped),) if n_clipped else ()


def slow_sampling(problem: IdentificationProblem, x: Array) -> tuple[Finding, ...]:
    """Return warnings for inputs whose response is fast compared with the sampling interval.

    Parameters
    ----------
    problem
        The identification problem.
    x
        Its vector (size,).

    Returns
    -------
    tuple of Finding
        A warning for each input whose lags together are shorter than the sampling interval divided
        by ``MAX_SAMPLING_SHARE``.
    """
    findings = []
    names = problem.model.inputs or ("the input",)
    for name, rational in zip(names, problem.rationals(x)):
        lag_s = float(sum(abs(f.coefs[1]) for f in rational.factors if f.free))
        if lag_s and problem.dt_s > MAX_SAMPLING_SHARE * lag_s:
            findings.append(
                warning(
                    "record.slow_sampling",
                    subject=name,
                    dt_s=problem.dt_s,
                    lag_s=lag_s,
                    needed_s=MAX_SAMPLING_SHARE * lag_s,
                )
            )
    return tuple(findings)


def drift(problem: IdentificationProblem, residual: Array) -> tuple[Finding, ...]:
    """Return a warning where the residuals contain a straight line in time.

    Parameters
    ----------
    problem
        The identification problem.
    residual
        Residuals (N,).

    Returns
    -------
    tuple of Finding
        Empty, or one warning where more than a quarter of the variance is a line.
    """
    pairs = []
    for s, r in zip(problem.segments, problem.by_segment(residual)):
        t = np.flatnonzero(s.measured).astype(float)
        pairs.append(np.stack([t - t.mean(), r - r.mean()]))
    t, r = np.hstack(pairs)
    correlation = float(r @ t) / float(np.sqrt(max((r @ r) * (t @ t), 1e-300)))
    if abs(correlation) <= MIN_DRIFT_CORRELATION:
        return ()
    return (warning("record.drift", correlation=correlation),)


def feedback(e: Array, jacobian: Array, future: Array, past: Array) -> tuple[Finding, ...]:
    """Return a warning where residuals correlate with future inputs and not with past ones.

    Parameters
    ----------
    e, jacobian
        Whitened innovations (N,) and their Jacobian (N, P).
    future, past
        Future and past inputs (N, M).

    Returns
    -------
    tuple of Finding
        Empty, or one warning.
    """
    p_future = input_correlation(e, jacobian, future, np.zeros(future.shape[1])).p
    p_past = input_correlation(e, jacobian, past, np.zeros(past.shape[1])).p
    if p_past >= ALARM_P > p_future:
        return (warning("record.feedback", p=p_future),)
    return ()


def level_columns(fit: Fit) -> Array:
    """Changes of the output (N, 3 + inputs) by departures from a linear model.

    Parameters
    ----------
    fit
        The fit.

    Returns
    -------
    array
        At the measured samples: by a gain that changes with the output, by a lag that differs
        between rise and fall [s], by a lag that changes with the output [s], and by a gain that
        changes with each input. With a coefficient a of the first or the last, the gain is 1 - a
        times its mean at the lower end of the range and 1 + a times at the upper end; with one of
        the others, the lag of the rise, or of the lower end, is a shorter than the other.

    Notes
    -----
    With z from 0 to 1 over the range R of the simulated output x, the columns are R (z^2 - z),
    max(dx/dt, 0) and -(z - 1/2) dx/dt; for an input v they are the response of its branch to
    v_range (z^2 - z) with z of the input.
    """
    problem = fit.problem
    outputs = fit.simulate_segments()
    lowest = min(float(x.min()) for x in outputs)
    highest = max(float(x.max()) for x in outputs)
    size = max(highest - lowest, 1e-300)
    inputs = np.concatenate([s.inputs for s in problem.segments])
    input_limits = list(zip(inputs.min(axis=0).tolist(), inputs.max(axis=0).tolist()))
    rationals = problem.rationals(fit.x)
    rows = []
    for segment, x in zip(problem.segments, outputs):
        slope = np.gradient(x, problem.dt_s)
        z = (x - lowest) / size
        columns = [_curved(x, lowest, highest), np.maximum(slope, 0.0), (0.5 - z) * slope]
        for k, (rational, hold) in enumerate(zip(rationals, problem.holds)):
            curved_input = _curved(segment.inputs[:, k], *input_limits[k])
            columns.append(simulate(rational, curved_input, problem.dt_s, hold))
        rows.append(np.stack(columns, axis=1)[segment.measured])
    return np.concatenate(rows)


def time_columns(fit: Fit) -> Array:
    """Changes of the output (N, 2) by a gain and by a lag that change in the course of the record.

    Parameters
    ----------
    fit
        The fit.

    Returns
    -------
    array
        At the measured samples. With a coefficient a of the first, the gain rises from its start to
        its end by a times its mean; with one of the second, the lag rises by a [s].
    """
    outputs = fit.simulate_segments()
    mean = float(np.mean(np.concatenate(outputs)))
    length = sum(len(x) for x in outputs)
    rows = []
    first = 0
    for segment, x in zip(fit.problem.segments, outputs):
        share = (first + np.arange(len(x))) / length - 0.5
        first += len(x)
        slope = np.gradient(x, fit.problem.dt_s)
        rows.append(np.stack([share * (x - mean), -share * slope], axis=1)[segment.measured])
    return np.concatenate(rows)


def _curved(x: Array, lowest: float, highest: float) -> Array:
    """R (z^2 - z), with z from 0 to 1 over the range R from ``lowest`` to ``highest``."""
    size = max(highest - lowest, 1e-300)
    z = (x - lowest) / size
    return size * (z**2 - z)


def _without_one_event(e: Array) -> Flags:
    """Samples (N,) other than those about the largest innovation, where it dwarfs all others."""
    size = np.abs(e)
    others = np.abs(np.arange(len(e)) - np.argmax(size)) > ROWS_OF_ONE_EVENT
    is_single = size.max() > SINGLE_EVENT_RATIO * size.max(initial=0.0, where=others)
    return others if is_single else np.ones(len(e), dtype=bool)


def departures(
    fit: Fit, e: Array, jacobian: Array, whitened: Callable[[Array], Array]
) -> tuple[Finding, ...]:
    """Return a warning where the output does not follow the input by one linear model.

    Parameters
    ----------
    fit
        The fit.
    e, jacobian
        Whitened innovations (N,) and their Jacobian (N, P).
    whitened
        Function that whitens columns (N, M) of an output.

    Returns
    -------
    tuple of Finding
        Empty, or one warning: "record.nonlinear", or "record.changing" where a change with time is
        more likely.

    Notes
    -----
    Each of ``level_columns`` and ``time_columns`` has an F test beyond what the parameters explain,
    at ``NONLINEAR_P`` over their number, without one jump or spike of the output. A disturbance
    model with a random walk would hide departures from the other tests. It also takes up most of
    them, so that their sizes come from the residuals and not from the innovations. A departure that
    is clear but small
    (``MIN_GAIN_CHANGE`` and the limits after it) is not reported.
    """
    by_level = level_columns(fit)
    by_time = time_columns(fit)
    n_level = by_level.shape[1]
    kept = _without_one_event(e)
    columns = whitened(np.column_stack([by_level, by_time]))[kept]
    p_values = [
        input_correlation(e[kept], jacobian[kept], column[:, None], np.zeros(1)).p
        for column in columns.T
    ]
    limit = NONLINEAR_P / len(p_values)
    p_level = min(p_values[:n_level])
    p_time = min(p_values[n_level:])
    evaluated = fit.problem.evaluate(fit.x)
    if min(p_level, p_time) >= limit or evaluated is None:
        return ()
    residual, residual_jacobian = evaluated

    def sizes_of(table: Array) -> Array:
        """Return the sizes of departures (M,) in the residuals, from their columns (N, M)."""
        both = np.column_stack([residual_jacobian, table])
        return np.abs(np.linalg.lstsq(both, residual, rcond=None)[0][-table.shape[1] :])

    if p_time < p_level:
        gain_change, lag_change_s = sizes_of(by_time)
        code = "record.changing"
    else:
        separate = [float(sizes_of(column[:, None])[0]) for column in by_level.T]
        # a random walk takes up what is slow, so that the tests show only a part of it
        is_clear = (np.array(p_values[:n_level]) < limit) | (not fit.noise.white)
        by_output, rise_lag_s, level_lag_s, *by_input = np.where(is_clear, separate, 0.0)
        gain_change = 2 * max(by_output, *by_input)  # from 1 - a to 1 + a
        lag_change_s = max(rise_lag_s, level_lag_s)
        code = "record.nonlinear"
    gain_percent = 100 * float(gain_change)
    lag_percent = 100 * float(lag_change_s) / max(abs(fit.identified.longest_lag_s), 1e-300)
    range_of_output = max(float(np.ptp(fit.problem.measured_output)), 1e-300)
    unexplained_percent = 100 * float(np.std(fit.residual)) / range_of_output
    is_small = (
        gain_percent < MIN_GAIN_CHANGE
        and lag_percent < MIN_LAG_CHANGE
        and unexplained_percent < MIN_UNEXPLAINED
    )
    if is_small:
        return ()
    return (
        warning(
            code,
            p=min(p_level, p_time),
            gain_percent=gain_percent if gain_percent >= MIN_GAIN_CHANGE else 0.0,
            lag_percent=lag_percent if lag_percent >= MIN_LAG_CHANGE else 0.0,
            unexplained_percent=unexplained_percent,
        ),
    )


def has_coloured_residuals(fit: Fit) -> bool:
    """Whether the test of whiteness rejects the residuals, at ``ALARM_P``."""
    return fit.identified.statistics["p_white"] < ALARM_P


def has_clean_residuals(fit: Fit) -> bool:
    """Whether neither residual test, whiteness or input correlation, rejects at ``ALARM_P``."""
    return not has_coloured_residuals(fit) and fit.identified.statistics["p_input"] >= ALARM_P


def is_adequate(fit: Fit) -> bool:
    """Whether the tests of the residuals do not clearly reject the model, at ``DRIVEN_P``."""
    statistics = fit.identified.statistics
    return min(statistics["p_white"], statistics["p_input"]) >= DRIVEN_P


def centred_fit_percent(fit: Fit) -> float:
    """Return the fit percent without the mean of the residuals of each segment."""
    residuals = fit.problem.by_segment(fit.residual)
    outputs = fit.problem.by_segment(fit.problem.measured_output)
    return nrmse_percent([e - e.mean() for e in residuals], outputs)


def explains_little(fit: Fit) -> bool:
    """Whether the output without the disturbance is hardly reproduced.

    A disturbance as flexible as ARMA noise with a random walk can replace dynamics that the model
    lacks, and its residuals are white all the same.
    """
    return fit.identified.statistics["fit_percent"] < LITTLE_FIT_PERCENT


def is_undriven(fit: Fit) -> bool:
    """Whether the residuals do not clearly follow the input.

    Slow disturbances correlate a little with it by chance.
    """
    return fit.identified.statistics["p_input"] >= DRIVEN_P
