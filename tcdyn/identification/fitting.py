"""Fit a continuous-time model to sampled data: output-error or prediction-error estimate.

The result has parameters with uncertainty, a noise model and validated residuals. ``fit`` is the
public function; the other modules of the package use it too. The order of its stages: checks, white
noise, robust loss or input noise, average over slow noise and waves, initial state
(``tcdyn.identification.setting``), intervals. ``tests/identify/test_identify_fit.py``
and ``test_identify_studies.py`` in that folder check recovery and coverage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import (
    Loss,
    NoiseModel,
    Optimum,
    minimise,
)
from tcdyn.estimation.noise_average import MixturePart
from tcdyn.identification.causality import check_causality
from tcdyn.identification.closed_loop import check_closed_loop
from tcdyn.identification.disturbance import (
    Baseline,
    NoiseName,
    alternate,
    average_over_noise,
    input_noise_model,
    noise_estimator,
    without_spikes,
)
from tcdyn.identification.identified import Identified
from tcdyn.identification.intervals import (
    Covariance,
    parameter_covariance,
    replace_poor_intervals,
    rounding_covariance,
)
from tcdyn.identification.iodata import IOData, as_iodata
from tcdyn.identification.knowledge import (
    check_knowledge,
    checked_weights,
    measured_rows,
    prior_conflicts,
)
from tcdyn.identification.models import Model, as_model, base_name, input_suffix, same_input
from tcdyn.identification.problem import IdentificationProblem, Initial
from tcdyn.identification.responses import slowest_time_constant_s
from tcdyn.identification.search import (
    Fit,
    criteria,
    distinct_starts,
    first_moment,
    make_problem,
    residual_sd,
    search,
    search_findings,
    sort_lags,
    sqrt_weights,
)
from tcdyn.identification.segments import MIN_SEGMENT_SAMPLES
from tcdyn.identification.setting import LikelyNoise, Setting, with_likely_start
from tcdyn.identification.starting_values import (
    single_input_problems,
    solve_linear_parameters,
    starts,
)
from tcdyn.identification.validation import has_coloured_residuals, validate

Intervals = Literal["auto", "quadratic", "profile"]  # kind of the intervals

# Limits of the findings about parameters, chosen by judgement.
MAX_RELATIVE_U = 0.5  # standard uncertainty over value, above which a parameter is undetermined
MAX_SLOW_SHARE = 0.5  # slowest time constant over the record's length; above, gain is extrapolated
MIN_LAG_DIFFERENCE = 1e-2  # relative difference of two lags, below which they are equal


@with_named_arguments
@one_blas_thread
def fit(
    data: IOData | tuple[Any, ...],
    model: Model | str = "P1D",
    *,
    initial: Initial | Literal["auto"] = "auto",
    noise: tuple[int, int] | NoiseName = "auto",
    baseline: Baseline = "auto",
    loss: Loss = "linear",
    covariance: Covariance = "auto",
    intervals: Intervals = "auto",
    start: Mapping[str, float] | Sequence[Mapping[str, float]] | None = None,
    check: bool = True,
    input_noise: float | Literal["auto"] = "auto",
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
    weights: ArrayLike | None = None,
) -> Fit:
    """Least-squares simulation fit of a model to data, with uncertainties.

    Starting values are not needed.

    Parameters
    ----------
    data
        One output, and as many inputs as the model has; or a tuple (u, y, dt_s).
    model
        Model or its name.
    initial
        The record starts in "equilibrium" with its first input, or with another "level" of the
        input, which is estimated (as where it begins when a heater is switched); from "zero"; or
        from any state, which is "estimated". "auto" selects it
        (:func:`tcdyn.identification.setting.with_likely_start`).
    noise
        "white"; (p, q), an ARMA model of the disturbance (then the prediction error is
        minimised); "ar" or "arma", with the order from the data; "slow" or "auto", an average over
        white and slow first-order noise.
    baseline
        "none", a linear drift ("trend"), a random walk ("walk") added to the output, or "auto":
        with slow noise an average over slow waves of any size, else none.
    loss
        "linear", or "huber" or "bisquare" against outliers.
    covariance
        "classical", "robust" (sandwich) or "auto": robust where residuals are coloured.
    intervals
        "quadratic", "profile" (profile likelihood) or "auto": profile where the quadratic
        interval is poor.
    start
        Parameters to start from, or several sets, of which the most promising is used.
    check
        Whether to check that the output does not move before the input, and that the input is not
        computed from the output (closed loop).
    input_noise
        Standard deviation of a measured input's noise, 0 for an exact input; "auto" estimates it
        from the samples. With noise, the input's level before a run in equilibrium is estimated:
        its first sample is one reading of it.
    bounds
        Lower and upper bound of parameters, ``{"Tp1": (1, 5)}``.
    prior
        Mean and standard uncertainty of parameters from elsewhere, ``{"Kp": (1.0, 0.01)}``: a
        normal distribution; of the logarithm where the parameter is positive.
    weights
        Weights (N,) of all samples of the data: the variance of the noise is inversely proportional
        to them. Samples of weight zero are left out.

    Returns
    -------
    Fit
        The identified model, its problem, residuals and covariance.

    Raises
    ------
    InputError
        For data from which the model cannot be identified.

    Notes
    -----
    Minimises sum (y - offset - G u)^2, with G exact under the data's hold and a continuous dead
    time.

    Every stage starts from the result of the one before, so the order cannot be changed freely. The
    checks come first because a closed loop fits well.
    ``tests/identify/test_identify_closed_loop.py`` and ``tests/identify/test_identify_mixed.py``
    fail otherwise.

    Examples
    --------
    >>> u = np.repeat([0.0, 1.0, 0.0, 1.0], 25)
    >>> from tcdyn.chain.rational import simulate
    >>> truth = as_model("P1D").rational({"Kp": 2.0, "Tp1": 0.8, "Td": 0.13})
    >>> data = IOData.from_arrays(u, simulate(truth, u, 0.1, "zoh"), 0.1, hold="zoh")
    >>> round(fit(data, "P1D").identified.theta["Td"], 6)
    0.13
    """
    structure = as_model(model)
    prior = prior or {}
    bounds = bounds or {}
    check_knowledge(structure, bounds, prior)
    data, weights = weighted_record(as_iodata(data), weights)
    options: dict[str, Any] = {
        "loss": loss,
        "covariance": covariance,
        "input_noise": input_noise,
        "bounds": bounds,
        "prior": prior,
        "weights": weights,
    }
    selectable = {"initial": initial, "noise": noise, "baseline": baseline}
    given = {name: value for name, value in selectable.items() if value != "auto"}
    if structure.arx:
        # its noise is that of its poles
        given = {"noise": "white", "baseline": "none", **given}
    setting = Setting.of(given)
    given_starts = [start] if isinstance(start, Mapping) else start or []
    loops = check_closed_loop(data, data.name or "identify") if check else ()
    # the output of a thermostat moves before its input
    has_causal_input = check and not loops
    result, data, options = _fit_outliers(
        data, structure, setting, given_starts, has_causal_input, options
    )

    def fit_model(
        model: Model, changed: Setting, start_sets: Sequence[Mapping[str, float]]
    ) -> Fit | None:
        """Return the fit under another setting, or None where there is none."""
        try:
            return fit_setting(data, model, changed, start_sets or given_starts, **options)
        except InputError:
            return None

    result = with_likely_start(result, setting, given, fit_model)
    result = replace(result, loss=loss)
    is_weighted = result.optimum.weights is not None
    if intervals != "quadratic" and not is_weighted:
        result = replace_poor_intervals(result, intervals == "profile")
    result = replace(result, identified=result.identified.with_timing(data.timing_u_s))
    conflicts = prior_conflicts(structure, result.estimates, prior)
    return add_findings(result, (*conflicts, *data.findings, *loops))


def fit_under(
    data: IOData,
    model: Model,
    setting: Setting,
    start_sets: Sequence[Mapping[str, float]] = (),
    *,
    loss: Loss = "linear",
    covariance: Covariance = "auto",
    check: bool = False,
    input_noise: float | Literal["auto"] = "auto",
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
) -> Fit:
    """Return the fit under one setting for a comparison, with quadratic intervals.

    Parameters
    ----------
    data, model, setting
        Data, model, and the setting that the compared models share.
    start_sets
        Sets of parameters to start from; none for the starting values of the package.
    loss, covariance, check, input_noise, bounds, prior
        As in :func:`fit`.

    Returns
    -------
    Fit
        The fit.

    Raises
    ------
    InputError
        For data from which the model cannot be identified.
    """
    check_knowledge(model, bounds or {}, prior or {})
    options: dict[str, Any] = {
        "loss": loss,
        "covariance": covariance,
        "input_noise": input_noise,
        "bounds": bounds or {},
        "prior": prior or {},
    }
    result = _fit_outliers(data, model, setting, start_sets, check, options)[0]
    result = replace(result, loss=loss)
    result = replace(result, identified=result.identified.with_timing(data.timing_u_s))
    conflicts = prior_conflicts(model, result.estimates, options["prior"])
    return add_findings(result, (*conflicts, *data.findings))


def weighted_record(data: IOData, weights: ArrayLike | None) -> tuple[IOData, Array | None]:
    """Return the record without the outputs of weight zero, and the checked weights (N,)."""
    if weights is None:
        return data, None
    checked = checked_weights(data, weights)
    is_left_out = checked[:, None] == 0
    return data.with_outputs(np.where(is_left_out, np.nan, data.outputs)), checked


def _fit_outliers(
    data: IOData,
    model: Model,
    setting: Setting,
    start_sets: Sequence[Mapping[str, float]],
    check: bool,
    options: dict[str, Any],
) -> tuple[Fit, IOData, dict[str, Any]]:
    """Fit under a setting, with outliers moved where the noise is slow.

    Parameters
    ----------
    data, model, setting, start_sets, check
        As in :func:`fit_setting`.
    options
        Its further options.

    Returns
    -------
    result
        The fit.
    data
        The record that was fitted.
    options
        The options of that fit.

    Notes
    -----
    A robust loss would treat the crests of slow noise as outliers. Where the residuals of white
    noise are coloured, the outliers are moved and the loss is linear.
    """
    if options["loss"] == "linear" or setting.noise == "white":
        return fit_setting(data, model, setting, start_sets, check=check, **options), data, options
    white = setting.with_white_noise
    result = fit_setting(data, model, white, start_sets, check=check, **options)
    is_walk = setting.baseline == "walk"
    if is_walk or has_coloured_residuals(result):
        data = without_spikes(data, result)
        options = {**options, "loss": "linear"}
    return fit_setting(data, model, setting, start_sets, **options), data, options


def fit_setting(
    data: IOData,
    model: Model,
    setting: Setting,
    start_sets: Sequence[Mapping[str, float]] = (),
    *,
    loss: Loss,
    covariance: Covariance,
    input_noise: float | Literal["auto"],
    bounds: Mapping[str, tuple[float, float]],
    prior: Mapping[str, tuple[float, float]],
    weights: Array | None = None,
    check: bool = False,
) -> Fit:
    """Return the fit under one setting, with quadratic intervals.

    Parameters
    ----------
    data, model
        Data and model.
    setting
        Initial state, noise and baseline.
    start_sets
        Sets of parameters to start from; none for the starting values of the package.
    loss, covariance, input_noise, bounds, prior, weights, check
        As in :func:`fit`.

    Returns
    -------
    Fit
        The fit.

    Raises
    ------
    InputError
        For data from which the model cannot be identified.
    """
    where = data.name or "identify"
    is_walk = setting.baseline == "walk"
    if weights is not None and (loss != "linear" or model.arx or is_walk):
        raise InputError(
            "weights are given",
            where=where,
            expected="the linear loss, no random walk, and no ARX model",
        )
    has_disturbance = setting.noise != "white" or setting.baseline != "none"
    if model.arx and has_disturbance:
        raise InputError(
            f"{model.name} has the noise of its own poles",
            remedy="leave noise and baseline out",
        )
    problem = make_problem(data, model, setting.initial, input_noise)
    problem = replace(problem, trend=setting.baseline == "trend", limits=bounds, priors=prior)
    if check:
        singles = single_input_problems(problem)
        for single in singles:
            check_causality(single, where, has_other_inputs=len(singles) > 1)
    likely = setting.likely
    if likely is not None and loss == "linear" and weights is None:
        problem = replace(problem, wave_sd=likely.wave_sd)
        problem, optimum = _fit_given_noise(problem, start_sets, likely.noise)
        problem = replace(problem, noise_sd=residual_sd(optimum, problem))
        return make_fit(data, problem, optimum, likely.noise, loss, covariance)
    problem, optimum = _fit_given_noise(problem, start_sets)
    if weights is not None:
        optimum = _fit_weighted(problem, optimum, measured_rows(problem, data, weights))
    elif loss != "linear":
        optimum = sort_lags(
            problem, minimise(optimum.problem, optimum.theta, loss=loss, tolerance=0.0)
        )
    row_weights = optimum.weights
    noise = NoiseModel()
    if model.arx:
        noise = NoiseModel(tuple(problem.pole_polynomial(optimum.theta).tolist()), n_fitted=0)
    elif likely is not None:
        return _fit_robust(data, problem, optimum, likely, covariance)
    elif setting.noise == "slow" and not is_walk:
        return _fit_average(data, problem, optimum, setting.baseline == "auto", covariance)
    elif setting.noise != "white" or is_walk:
        estimator = noise_estimator(setting.noise, is_walk)
        problem, optimum, noise = alternate(problem, optimum, estimator)
    elif problem.input_sd and loss == "linear":
        problem, optimum, noise = alternate(problem, optimum, input_noise_model)
    return make_fit(data, problem, optimum, noise, loss, covariance, weights=row_weights)


def _fit_given_noise(
    problem: IdentificationProblem,
    start_sets: Sequence[Mapping[str, float]],
    noise: NoiseModel | None = None,
) -> tuple[IdentificationProblem, Optimum]:
    """Fit with white noise, which is the output-error estimate, or with another given noise.

    Parameters
    ----------
    problem
        The identification problem.
    start_sets
        Parameters by name to start from; none for the starting values of the package.
    noise
        The noise; none for white noise.

    Returns
    -------
    problem
        The problem with the time scale of its initial states and the noise of the output.
    optimum
        Its optimum.
    """
    zeros = dict.fromkeys(problem.model.names, 0.0)
    given = [solve_linear_parameters(problem, {**zeros, **s})[1] for s in start_sets]
    optimum = search(problem, problem.least_squares_problem(noise), given)
    if any(problem.has_free_state):
        # initial states are searched best in the time scale of the model; linear parameters anew
        time_scale_s = first_moment(problem, optimum.theta)
        problem = replace(problem, time_scale_s=time_scale_s)
        x = solve_linear_parameters(problem, problem.theta(optimum.theta))[1]
        optimum = search(problem, problem.least_squares_problem(noise), x)
    prior_of_levels = problem.prior_precision.copy()
    prior_of_levels[problem.wave_slice] = 0.0
    if prior_of_levels.any():
        # the weight of an input's first sample needs the output's noise
        problem = replace(problem, noise_sd=residual_sd(optimum, problem))
        optimum = search(problem, problem.least_squares_problem(noise), optimum.theta)
    return problem, optimum


def _fit_weighted(problem: IdentificationProblem, optimum: Optimum, weights: Array) -> Optimum:
    """Return the optimum with weights (N,) of the residuals, from that without."""
    core = problem.least_squares_problem(root=np.sqrt(weights))
    weighted = search(problem, core, optimum.theta)
    rows = optimum.problem.evaluate(weighted.theta)
    assert rows is not None
    return replace(
        weighted, problem=optimum.problem, residual=rows[0], jacobian=rows[1], weights=weights
    )


def add_findings(result: Fit, findings: tuple[Finding, ...]) -> Fit:
    """Return the fit with more findings; those that it has stay once."""
    new = tuple(f for f in findings if f not in result.identified.findings)
    if not new:
        return result
    identified = replace(result.identified, findings=(*result.identified.findings, *new))
    return replace(result, identified=identified)


def _fit_average(
    data: IOData,
    problem: IdentificationProblem,
    optimum: Optimum,
    has_waves: bool,
    covariance: Covariance,
) -> Fit:
    """Fit by averaging over slow disturbances (:mod:`tcdyn.estimation.noise_average`).

    Parameters
    ----------
    data
        The record.
    problem, optimum
        The identification problem and its optimum with white noise.
    has_waves
        Whether each run has slow waves, over whose size the fit is averaged.
    covariance
        As in :func:`fit`.

    Returns
    -------
    Fit
        The fit. Its statistic ``p_walk`` is the probability of a random walk, and ``wave`` the
        range of the estimated waves over that of the output.

    Notes
    -----
    The search starts with waves whose size lies, on a logarithmic scale, halfway between the noise
    and the range of the output.
    """
    weights = optimum.weights
    if has_waves:
        ratio = float(np.ptp(problem.measured_output)) / problem.noise_sd
        problem, optimum = _with_waves(problem, optimum, max(np.sqrt(ratio), 1.0))
        optimum = replace(optimum, weights=weights)
    average = average_over_noise(problem, optimum)
    problem, best, noise, cov_x, parts = average.point_estimate(weights)
    result = make_fit(data, problem, best, noise, "linear", covariance, cov_x, weights, parts)
    statistics = {**result.identified.statistics, "p_walk": average.p_walk}
    if has_waves:
        statistics["wave"] = wave_range(problem, best.theta)
    return replace(result, identified=replace(result.identified, statistics=statistics))


def _with_waves(
    problem: IdentificationProblem,
    optimum: Optimum,
    wave_sd: float,
    noise: NoiseModel | None = None,
) -> tuple[IdentificationProblem, Optimum]:
    """Add slow waves to a problem, and search it from its optimum and its starting values.

    Parameters
    ----------
    problem, optimum
        The problem without waves, and its optimum with white noise.
    wave_sd
        Prior standard deviation of the first wave over that of the noise.
    noise
        Noise of the search; none for white noise.

    Returns
    -------
    problem, optimum
        The problem with waves, and its optimum, whose rows include the roots of robust weights.
    """
    problem = replace(problem, wave_sd=wave_sd)
    no_waves = np.append(optimum.theta, np.zeros(problem.size - len(optimum.theta)))
    core = problem.least_squares_problem(noise, sqrt_weights(optimum.weights))
    start_sets = [no_waves, *distinct_starts(problem, starts(problem))]
    return problem, search(problem, core, start_sets)


def _fit_robust(
    data: IOData,
    problem: IdentificationProblem,
    optimum: Optimum,
    likely: LikelyNoise,
    covariance: Covariance,
) -> Fit:
    """Fit under one disturbance with the robust weights of white noise.

    Parameters
    ----------
    data
        The record.
    problem, optimum
        The identification problem and its robust optimum with white noise.
    likely
        The disturbance.
    covariance
        As in :func:`fit`.

    Returns
    -------
    Fit
        The fit.
    """
    weights = optimum.weights
    if likely.wave_sd:
        problem, optimum = _with_waves(problem, optimum, likely.wave_sd, likely.noise)
    else:
        core = problem.least_squares_problem(likely.noise, sqrt_weights(weights))
        optimum = search(problem, core, optimum.theta)
    problem = replace(problem, noise_sd=residual_sd(optimum, problem))
    return make_fit(data, problem, optimum, likely.noise, "linear", covariance, weights=weights)


def wave_range(problem: IdentificationProblem, x: Array) -> float:
    """Range of the slow waves within a run, the largest over the runs, over that of the output."""
    wave = problem.wave_slice
    ranges = []
    for s in problem.segments:
        first_s = s.start_s - problem.run_start_s[s.run]
        since_s = first_s + problem.dt_s * np.arange(len(s.y), dtype=np.float64)
        ranges.append(np.ptp(problem.baseline(s.run, since_s)[:, wave] @ x[wave]))
    return float(max(ranges) / np.ptp(problem.measured_output))


def make_fit(
    data: IOData,
    problem: IdentificationProblem,
    optimum: Optimum,
    noise: NoiseModel,
    loss: Loss,
    covariance: Covariance,
    cov_x: Array | None = None,
    weights: Array | None = None,
    parts: Sequence[MixturePart] = (),
) -> Fit:
    """The finished fit at an optimum: covariance, estimates, validation, statistics, findings.

    Parameters
    ----------
    data, problem, optimum, noise, loss
        The record, the identification problem, its optimum, noise model and loss.
    covariance
        As in :func:`fit`.
    cov_x
        Covariance of x (size, size) without the contribution of rounding, if it is known already.
    weights
        Robust weights (N,) whose roots the rows of ``optimum`` include already, if it has none
        of its own.
    parts
        Distributions of x in natural parameters, relative to the optimum, whose mixture has the
        covariance ``cov_x``; none for one normal distribution.

    Returns
    -------
    Fit
        The fit with its statistics and findings.

    Notes
    -----
    The keys of ``statistics`` are read by ``tcdyn.identification.comparison``,
    ``tcdyn.identification.ladder`` and the JSON file. ``tests/identify/test_identify_fit.py``
    checks the criteria against the textbook.
    """
    n = problem.n_measured
    x = optimum.theta
    rows = problem.evaluate(x)
    assert rows is not None
    residual = -rows[0]
    is_robust = cov_x is not None
    if cov_x is None:
        effective_loss = loss if optimum.weights is not None else "linear"
        cov_x, is_robust = parameter_covariance(
            problem, optimum, residual, covariance, effective_loss
        )
    else:
        rounding = rounding_covariance(problem, optimum, residual)
        cov_x = cov_x + rounding
        in_natural = rounding * np.outer(problem.natural_scale(x), problem.natural_scale(x))
        parts = [part._replace(covariance=part.covariance + in_natural) for part in parts]
    scale = problem.natural_scale(x)
    n_model = problem.n_model
    cov_theta = (cov_x * np.outer(scale, scale))[:n_model, :n_model]
    root = sqrt_weights(optimum.weights)
    sse = float(np.sum((optimum.residual * root) ** 2))
    identified = Identified.of(
        problem.model,
        problem.theta(x),
        cov_theta,
        parts=tuple(
            MixturePart(w, mean[:n_model], cov[:n_model, :n_model]) for w, mean, cov in parts
        ),
        offset=final_offset(problem, x, residual, noise),
        noise_sd=float(np.sqrt(sse / (n - problem.size))),
        hold=data.hold,
        dt_s=problem.dt_s,
        input_name=", ".join(data.input_names),
        output_name=data.output_names[0],
        input_unit=", ".join(filter(None, dict.fromkeys(data.input_units))),
        output_unit=data.output_units[0],
    )
    effective_weights = weights if optimum.weights is None else optimum.weights
    result = Fit(identified, problem, optimum, residual, cov_x, noise, loss, effective_weights)
    validation = validate(result)
    # slow waves have a prior: their cost counts instead of their number
    waves = x[problem.wave_slice]
    wave_cost = float(np.sum(waves**2 * problem.prior_precision[problem.wave_slice]))
    count = problem.size - len(waves) + 1 + noise.n_parameters
    # with a random walk, one sample after each gap determines its level
    n_levels = len(problem.residual_slices) - 1 if noise.is_random_walk else 0
    dof = max(n - n_levels, 1)
    deviance = n * np.log(max(sse + wave_cost, 1e-300) / dof) + noise.log_determinant(
        problem.residual_slices
    )
    statistics = {
        "n": float(n),
        "parameters": float(count - 1),
        "fit_percent": validation.fit_percent,
        "rms": validation.rms,
        **criteria(deviance, count, n),
        "p_white": validation.whiteness.p,
        "p_input": validation.input.p,
        "robust_covariance": float(is_robust),
    }
    findings = (
        *parameter_findings(optimum, identified),
        *slow_responses(identified, problem.longest_segment_s),
    )
    identified = replace(
        identified, statistics=statistics, sentence=validation.sentence, findings=findings
    )
    return replace(result, identified=identified)


def final_offset(
    problem: IdentificationProblem, x: Array, residual: Array, noise: NoiseModel
) -> float:
    """Return the offset of the model at the end of the data, in the output's unit.

    Drift and waves are not extrapolated.

    Parameters
    ----------
    problem
        The identification problem.
    x
        The vector (size,).
    residual
        Measured minus model (N,).
    noise
        The noise model.

    Returns
    -------
    float
        The mean offset of the runs, plus the means of drift and waves at their ends, plus the last
        level of a random walk.
    """
    offsets = x[problem.n_model : problem.offset_and_state_slices[0][1].start]
    level = float(np.mean(offsets)) if len(offsets) else 0.0
    first = problem.drift_slice.start
    if first < problem.size:
        ends = {s.run: s.start_s + len(s.y) * problem.dt_s for s in problem.segments}
        for run, end_s in ends.items():
            since_s = np.array([end_s - problem.run_start_s[run]])
            at_end = problem.baseline(run, since_s)[0, first:] @ x[first:]
            level += float(at_end) / len(ends)
    if noise.is_random_walk:
        level += float(np.mean(residual[-MIN_SEGMENT_SAMPLES:]))
    return level


def slow_responses(identified: Identified, longest_s: float) -> list[Finding]:
    """Return warnings for inputs whose response is slower than the record can show.

    Parameters
    ----------
    identified
        The identified model.
    longest_s
        Length of the longest segment [s].

    Returns
    -------
    list of Finding
        A warning for each lag whose uncertainty is larger than the record is long, and one for each
        slowest time constant above ``MAX_SLOW_SHARE`` of the record: the final value, and with it
        the gain, is then an extrapolation.
    """
    if identified.model.integrators:
        return []
    findings = []
    for name, model in identified.by_input.items():
        lag_u = model.lag_s.u
        slowest_s = slowest_time_constant_s(model.rational)
        subject = "the lag" if len(identified.by_input) == 1 else f"the lag behind {name}"
        if lag_u > longest_s:
            findings.append(
                warning("fit.lag_unbounded", subject=subject, u=lag_u, longest_s=longest_s)
            )
        if model.gain and slowest_s > MAX_SLOW_SHARE * longest_s:
            findings.append(
                warning("fit.slow_pole", subject=name, slowest_s=slowest_s, longest_s=longest_s)
            )
    return findings


def parameter_findings(optimum: Optimum, identified: Identified) -> tuple[Finding, ...]:
    """Return warnings about parameters: at a bound, equal lags, undetermined, indistinct.

    Parameters
    ----------
    optimum
        The optimum.
    identified
        The model with its estimates.

    Returns
    -------
    tuple of Finding
        At most one warning for each parameter, and those of the complete model.

    Notes
    -----
    A model with any finding counts as not determined in
    ``tcdyn.identification.recommendation.recommend``, so stricter limits recommend smaller models.
    ``tests/identify/test_identify_fit.py`` checks each warning.
    """

    def judge(name: str, estimate: Estimate) -> Finding | None:
        """Return a warning about equal lags or an undetermined parameter."""
        if _has_equal_lag(name, identified):
            return warning("fit.twin", subject=name)
        if _is_undetermined(name, estimate, identified):
            return warning("fit.undetermined", subject=name, u=estimate.u, value=estimate.value)
        return None

    return search_findings(optimum, identified.estimates, identified.model.name, judge)


def _has_equal_lag(name: str, identified: Identified) -> bool:
    """Whether another lag of the same input is equal.

    The cost then hardly depends on their difference.
    """
    lags = [n for n in identified.model.free if n[:2] == "Tp"]
    if name not in lags:
        return False
    value = identified.estimates[name].value
    others = [n for n in lags if n != name and input_suffix(n) == input_suffix(name)]
    return any(abs(identified.theta[n] / value - 1) < MIN_LAG_DIFFERENCE for n in others)


def _is_undetermined(name: str, estimate: Estimate, identified: Identified) -> bool:
    """Whether the uncertainty of a parameter is large against its size.

    A zero is compared with the lags of its input, because it may be small itself.

    Parameters
    ----------
    name
        Name of the parameter.
    estimate
        Its estimate.
    identified
        The model.

    Returns
    -------
    bool
        False for parameters that may be zero or negative, such as a dead time.
    """
    is_zero = base_name(name) == "Tz"
    if not (is_zero or base_name(name) == "Kp" or identified.model.is_positive(name)):
        return False
    size = abs(estimate.value)
    if is_zero:
        lags = [
            value
            for n, value in identified.theta.items()
            if n[:2] in ("Tp", "Tw", "Tc") and same_input(n, name)
        ]
        size = max(size, sum(lags))
    return estimate.u > MAX_RELATIVE_U * size
