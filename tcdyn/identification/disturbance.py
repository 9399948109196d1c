"""Noise models of the disturbance: AR, ARMA, random walk, and averages over slow noise.

The model is given by name, or selected by BIC from the residuals. Restricted maximum likelihood
(REML) refines the coefficients. ``tcdyn.identification.fit`` uses it.
``tests/identify/test_identify_disturbance.py``, ``test_identify_mixed.py`` and
``test_identify_residuals.py`` in that folder guard it; ``tests/identify/disturbance_study.py``
measures the coverage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyfromroots
from scipy.ndimage import median_filter
from scipy.optimize import minimize

from tcdyn.chain.rational import realise, simulate_rows
from tcdyn.core import Array
from tcdyn.estimation import NoiseModel, Optimum, fit_ar, fit_arma
from tcdyn.estimation.arma import coefficients_from_partial, partial_correlations
from tcdyn.estimation.noise_average import (
    LinearisedProblem,
    MixturePart,
    NoiseGrid,
    full_box,
    wave_sizes,
)
from tcdyn.estimation.trace_noise import MAD_TO_SD
from tcdyn.identification.iodata import IOData
from tcdyn.identification.knowledge import measured_rows
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.search import Fit, residual_sd, search, sqrt_weights

# Names of the noise models that ``fit`` takes.
NoiseName = Literal["auto", "white", "slow", "ar", "arma"]
Baseline = Literal["auto", "none", "trend", "walk"]  # Names of the baselines that ``fit`` takes.

# The thresholds below are chosen by judgement.
ARMA_ORDERS = [(1, 1), (2, 1), (2, 2)]  # orders (p, q) of ARMA noise that are tried
# Orders (p, q) of the steps of a random walk, by the name of the noise; both for other names.
WALK_ORDERS = {"white": [(0, 1)], "ar": [(1, 1)]}
MAX_AR_ORDER = 8  # largest order of an autoregression
# Partial correlation of noise that is a random walk: no offset can be distinguished from it.
MAX_PARTIAL_CORRELATION = 0.999
MAX_REML_ROWS = 100_000  # above, REML moves a coefficient by less than 0.01 of its uncertainty
MAX_REML_COEFFICIENTS = 4  # coefficients that the restricted likelihood refines at most
MAX_ALTERNATIONS = 6  # of dynamics given the noise and noise given the dynamics
MAX_AVERAGE_ROUNDS = 3  # of the average over noise models and its linearisation
AVERAGE_TOLERANCE = 0.05  # last step of the average, in standard uncertainties
MAX_LINEAR_STEP = 0.3  # step of a logarithm up to which the problem is taken as linear
MAX_LINEAR_SDS = 5.0  # the same as an increase of the cost, in standard uncertainties
MEDIAN_WINDOW = 15  # samples of the running median of the residuals
SPIKE_SDS = 4.0  # distance from the running median above which a residual is a spike
MIN_PROBABILITY = 0.01  # of a drift, below which it is left out of the average
MIN_OUTPUT_NOISE_SHARE = 0.01  # of the residual variance, the least that is output noise
MIN_INPUT_NOISE_SHARE = 1e-6  # of the residual variance, below which input noise is ignored

# noise model from the problem, its x and its residuals (N,)
NoiseEstimator = Callable[[IdentificationProblem, Array, Array], NoiseModel]


def input_noise_model(problem: IdentificationProblem, x: Array, e: Array) -> NoiseModel:
    """Noise model of residuals that hold the input's noise, filtered by the model.

    Parameters
    ----------
    problem
        The identification problem.
    x
        Its vector.
    e
        Residuals (N,).

    Returns
    -------
    NoiseModel
        White where the input's noise is negligible.

    Notes
    -----
    The spectrum is (s_y^2 |D|^2 + s_u^2 |B|^2)/|D|^2, with D from the poles, |B|^2 from the
    autocovariance of the impulse response and the numerator C from the roots within the unit
    circle. s_y follows from the variance of the residuals less the input's share. All are at the
    instants of the measured outputs, which may be rarer than those of the input.
    """
    if not problem.input_sd:
        return NoiseModel()
    g = problem.model.rational(problem.theta(x))
    poles = [f.poles for f in g.factors] or [np.zeros(0, dtype=complex)]
    below = np.real(polyfromroots(np.exp(np.concatenate(poles) * problem.residual_dt_s)))[::-1]
    order = len(below) - 1
    pulse = np.zeros(max(len(s.u) for s in problem.segments))
    pulse[1] = problem.input_sd
    # a dead time does not change the spectrum
    system = realise(replace(g, delay_s=0.0), False)
    response = simulate_rows(system, pulse, problem.dt_s, 0.0, problem.hold, "zero")[0]
    autocovariance: list[float] = [
        float(response[: len(response) - lag] @ response[lag:])
        for lag in problem.residual_spacing * np.arange(2 * order + 1)
    ]
    input_variance = autocovariance[0]
    variance = float(e @ e) / max(len(e) - problem.size, 1)
    output_variance = max(variance - input_variance, MIN_OUTPUT_NOISE_SHARE * variance)
    below_squared = np.convolve(below, below[::-1])
    both_sides = [*autocovariance[:0:-1], *autocovariance]
    spectrum = np.asarray(np.convolve(both_sides, below_squared, mode="valid"), dtype=float)
    spectrum += output_variance * below_squared
    is_negligible = input_variance < MIN_INPUT_NOISE_SHARE * variance
    if order == 0 or is_negligible:
        return NoiseModel()
    above = spectral_factor(spectrum)
    if above is None:
        return NoiseModel()
    ar = tuple(below[1:].tolist())
    return NoiseModel(ar, tuple(above[1:].tolist()), starts_at_rest=True, n_fitted=0)


def spectral_factor(spectrum: Array) -> Array | None:
    """Return the invertible polynomial C with C(q) C(1/q) proportional to a spectrum.

    Parameters
    ----------
    spectrum
        Autocovariance (2n + 1,) of a moving average, from lag -n to n.

    Returns
    -------
    array or None
        Coefficients of C, the first is 1; None where the spectrum has zeros on the unit circle, is
        zero, or is not finite.

    Notes
    -----
    A pole much faster than the sampling interval makes the outer lags so small that a ratio of two
    coefficients overflows. They are left out where they are below the rounding of the largest.

    Examples
    --------
    >>> spectral_factor(np.array([1e-320, 0.5, 1.25, 0.5, 1e-320])).round(6).tolist()
    [1.0, 0.5]
    """
    size = np.abs(spectrum)
    largest = float(np.max(size))
    if not 0 < largest < np.inf:  # also false where it is not a number
        return None
    n_small = int(np.argmax(size > np.finfo(float).eps * largest))
    kept = spectrum[n_small : len(spectrum) - n_small] / largest
    roots = np.roots(kept)
    inside = roots[np.argsort(np.abs(roots))][: len(kept) // 2]
    if np.any(np.abs(inside) >= 1):
        return None
    return np.real(np.atleast_1d(np.poly(inside)))


def alternate(
    problem: IdentificationProblem, optimum: Optimum, estimator: NoiseEstimator
) -> tuple[IdentificationProblem, Optimum, NoiseModel]:
    """Alternate the dynamics given the noise, and the noise given the dynamics.

    Both decrease the same prediction error.

    Parameters
    ----------
    problem
        The identification problem.
    optimum
        Where to start; its robust weights stay. It is returned unchanged where it has robust
        weights and the noise is white.
    estimator
        Noise from the problem, its x and its residuals (N,).

    Returns
    -------
    problem
        The problem with the noise level of the optimum.
    optimum
        The optimum of the whitened residuals.
    noise
        The noise model of the last round.

    Notes
    -----
    It ends after ``MAX_ALTERNATIONS``, or where the cost changes by less than 1e-4 of itself.
    """
    first = optimum
    root = sqrt_weights(optimum.weights)
    noise = NoiseModel()
    cost = np.inf
    for _ in range(MAX_ALTERNATIONS):
        rows = problem.evaluate(optimum.theta, root)
        assert rows is not None
        noise = estimator(problem, optimum.theta, rows[0])
        noise = refine_by_reml(problem.residual_slices, *rows, noise)
        if noise.white and first.weights is not None:
            return problem, first, noise
        core = problem.least_squares_problem(noise, root)
        optimum = search(problem, core, optimum.theta)
        problem = replace(problem, noise_sd=residual_sd(optimum, problem))
        if abs(cost - optimum.cost) < 1e-4 * optimum.cost:
            break
        cost = optimum.cost
    return problem, optimum, noise


def without_spikes(data: IOData, result: Fit) -> IOData:
    """Return the data with outliers of the output moved to the running median of the residuals.

    Robust weights by the size of the residuals would treat the crests of slow noise as spikes.

    Parameters
    ----------
    data
        The record.
    result
        A fit to it.

    Returns
    -------
    IOData
        The record with the output changed at the outliers.

    Notes
    -----
    A wider ``MEDIAN_WINDOW`` takes crests of slow noise for spikes, a lower ``SPIKE_SDS`` takes
    noise. ``tests/identify/test_identify_residuals.py`` checks spikes and slow noise.
    """
    problem = result.problem
    medians = [
        median_filter(result.residual[s], MEDIAN_WINDOW, mode="nearest")
        for s in problem.residual_slices
    ]
    difference = result.residual - np.concatenate(medians)
    limit = SPIKE_SDS * MAD_TO_SD * np.median(np.abs(difference))
    is_spike = np.abs(difference) > limit
    samples = measured_rows(problem, data, np.arange(data.n_samples))
    y = data.outputs
    y[samples[is_spike], 0] -= difference[is_spike]
    return data.with_outputs(y)


def fit_random_walk(e: Array, slices: list[slice], p: int, q: int) -> NoiseModel:
    """Fit a random walk with ARMA(p, q) steps to residuals.

    Parameters
    ----------
    e
        Residuals (N,).
    slices
        Consecutive samples in ``e``; a walk begins anew in each.
    p, q
        Order. MA(1) steps are a random walk plus white noise.

    Returns
    -------
    NoiseModel
        The noise model of the residuals.
    """
    steps = np.concatenate([np.diff(e[s], prepend=e[s][:1]) for s in slices])
    noise = fit_arma(steps, slices, p, q)
    return NoiseModel(_integrate_noise(noise.ar), noise.ma, True, p + q)


def _integrate_noise(ar: Sequence[float]) -> tuple[float, ...]:
    """Return the coefficients after the first of (1 - q^-1) A(q)."""
    return tuple(np.convolve([1.0, -1.0], [1.0, *ar])[1:].tolist())


def refine_by_reml(slices: list[slice], e: Array, j: Array, noise: NoiseModel) -> NoiseModel:
    """Refine the coefficients of a noise model by restricted maximum likelihood (REML).

    Parameters
    ----------
    slices
        Consecutive samples in the residual vector.
    e, j
        Residuals (N,) and their Jacobian (N, P).
    noise
        Where to start; it is returned where the criterion does not decrease, where it has no
        coefficients or more than ``MAX_REML_COEFFICIENTS``, and for more than ``MAX_REML_ROWS``.

    Returns
    -------
    NoiseModel
        The refined model, of the same order.

    Notes
    -----
    Minimises (n - p) ln |w - WJ b|^2 + ln det (WJ)'(WJ) with w = W e and b its regression on WJ
    (Patterson and Thompson 1971). This corrects for the noise that the fit has absorbed; the
    residuals alone make slow noise look faster. The search variables are the inverse hyperbolic
    tangents of the partial correlations: every such noise is stable and invertible.
    """
    n_coefficients = sum(noise.order)
    if not 0 < n_coefficients <= MAX_REML_COEFFICIENTS or len(e) > MAX_REML_ROWS:
        return noise
    p = noise.order[0]
    ar = _without_walk(noise)

    def noise_at(z: Array) -> NoiseModel:
        """Return the noise model at the search variables z (p + q,)."""
        ar_at = coefficients_from_partial(MAX_PARTIAL_CORRELATION * np.tanh(z[:p]))
        ma_at = coefficients_from_partial(MAX_PARTIAL_CORRELATION * np.tanh(z[p:]))
        below = _integrate_noise(ar_at.tolist()) if noise.is_random_walk else tuple(ar_at.tolist())
        return NoiseModel(below, tuple(ma_at.tolist()), noise.starts_at_rest, noise.n_fitted)

    scaled = j / np.maximum(np.linalg.norm(j, axis=0), 1e-300)
    table = np.column_stack([scaled, e])
    dof = len(e) - j.shape[1]

    def criterion(z: Array) -> float:
        """Return minus twice the restricted log-likelihood at z, up to a constant."""
        candidate = noise_at(z)
        factor = np.abs(np.diag(np.linalg.qr(candidate.whiten(table, slices), mode="r")))
        determinant = np.sum(np.log(factor[:-1] + 1e-12))
        spread = candidate.log_determinant(slices)
        return float(2 * dof * np.log(factor[-1] + 1e-300) + 2 * determinant + spread)

    correlations = np.concatenate(
        [partial_correlations(ar), partial_correlations(np.array(noise.ma))]
    )
    start = np.arctanh(np.clip(correlations, -0.998, 0.998))
    optimum = minimize(
        criterion,
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 1e-3, "maxfev": 60 * n_coefficients},
    )
    return noise_at(optimum.x) if optimum.fun < criterion(start) else noise


def _without_walk(noise: NoiseModel) -> Array:
    """Return the AR coefficients (p,) without the factor of the random walk."""
    if noise.is_random_walk:
        return np.cumsum([1.0, *noise.ar])[1:-1]
    return np.array(noise.ar)


def noise_bic(e: Array, slices: list[slice], noise: NoiseModel) -> float:
    """Return the BIC of a noise model for residuals.

    Parameters
    ----------
    e
        Residuals (N,).
    slices
        Consecutive samples in ``e``.
    noise
        The noise model.

    Returns
    -------
    float
        -2 ln likelihood + k ln N. Samples that whiten to exactly zero do not count for the
        variance. Infinite for a random walk where most samples are the first after a gap, which
        only determine its level.
    """
    if noise.is_random_walk and 2 * len(slices) > len(e):
        return np.inf
    w = noise.whiten(e, slices)
    n = len(e)
    variance = float(w @ w) / max(int(np.count_nonzero(w)), 1)
    deviance = n * np.log(max(variance, 1e-300)) + noise.log_determinant(slices)
    return float(deviance + noise.n_parameters * np.log(n))


def noise_estimator(noise: NoiseName | tuple[int, int], is_walk: bool) -> NoiseEstimator:
    """Return a function that estimates the noise from residuals: the model of least BIC.

    Autoregressions go up to the order from the Yule-Walker equations, at most ``MAX_AR_ORDER``;
    random walks have few orders.

    Parameters
    ----------
    noise
        Name of the noise, or its order (p, q).
    is_walk
        Whether it is a random walk; else it is stationary.

    Returns
    -------
    callable
        Function of the problem, x and the residuals (N,) that returns the noise model.
    """

    def estimator(problem: IdentificationProblem, x: Array, e: Array) -> NoiseModel:
        """Return the noise model of least BIC for the residuals ``e`` (N,) at ``x``."""
        slices = problem.residual_slices
        if isinstance(noise, tuple):
            orders = [noise]
        elif is_walk:
            orders = WALK_ORDERS.get(noise, [(0, 1), (1, 1)])
        elif noise == "ar":
            max_order = max(1, min(MAX_AR_ORDER, len(fit_ar(e, slices).ar)))
            orders = [(p, 0) for p in range(1, max_order + 1)]
        else:
            orders = ARMA_ORDERS
        fit_order = fit_random_walk if is_walk else fit_arma
        candidates = [fit_order(e, slices, *order) for order in orders]
        return min(candidates, key=lambda candidate: noise_bic(e, slices, candidate))

    return estimator


@dataclass(frozen=True)
class NoiseAverage:
    """Bayesian average over noise models, in natural parameters: no logarithms.

    Small lags and the dead time add up in natural parameters, and not in logarithms.

    Parameters
    ----------
    problem
        The identification problem.
    optimum
        Its optimum given the likeliest noise.
    noise
        The likeliest noise.
    mean, covariance
        Mean (P,) and covariance (P, P) over the noise models.
    evidence
        Logarithm of the likelihood, averaged over all noise models.
    p_walk
        Probability that the memory of the disturbance is longer than the record.
    parts
        The averages under slow waves of one size each; their means are relative to ``mean``.
    """

    problem: IdentificationProblem
    optimum: Optimum
    noise: NoiseModel
    mean: Array
    covariance: Array
    evidence: float
    p_walk: float
    parts: tuple[MixturePart, ...]

    def point_estimate(
        self, weights: Array | None
    ) -> tuple[IdentificationProblem, Optimum, NoiseModel, Array, tuple[MixturePart, ...]]:
        """Return a single fit that stands for the average.

        Parameters
        ----------
        weights
            Robust weights (N,), or None.

        Returns
        -------
        problem
            The identification problem.
        optimum
            Its optimum, moved to the mean where the problem is linear so far. Its rows include the
            roots of the weights.
        noise
            The likeliest noise.
        covariance
            Covariance of x (size, size).
        parts
            As ``self.parts``; empty where x is not the mean.

        Notes
        -----
        Where the mean is too far from the optimum for a linear problem, as in a direction that
        the data do not determine, x stays the optimum given the likeliest noise. Its distance
        from the mean is then added to the covariance.

        ``MAX_LINEAR_STEP`` and ``MAX_LINEAR_SDS`` decide what "too far" is. Larger values trust the
        linearisation further. ``tests/identify/test_identify_disturbance.py`` checks the coverage
        of the lag.
        """
        problem = self.problem
        core = problem.least_squares_problem(self.noise, sqrt_weights(weights))
        x = self.optimum.theta
        scale = problem.natural_scale(x)
        is_log = problem.is_logarithm
        rows = core.evaluate(x)
        assert rows is not None
        covariance = self.covariance
        parts = self.parts
        difference = self.mean - natural_parameters(problem, x)
        relative = difference / scale
        log_step = np.log1p(np.clip(relative, -MAX_LINEAR_STEP, MAX_LINEAR_STEP))
        x_mean = np.clip(x + np.where(is_log, log_step, difference), core.lower, core.upper)
        rows_mean = None
        if np.all(np.abs(relative)[is_log] < MAX_LINEAR_STEP):
            rows_mean = core.evaluate(x_mean)
        max_cost = (1 + MAX_LINEAR_SDS**2 / problem.n_measured) * float(rows[0] @ rows[0])
        if rows_mean is not None and rows_mean[0] @ rows_mean[0] < max_cost:
            x = x_mean
            rows = rows_mean
            scale = problem.natural_scale(x)
        else:
            covariance = covariance + np.outer(difference, difference)
            parts = ()
        distance = x - core.prior_mean
        optimum = replace(
            self.optimum,
            problem=core,
            weights=None,
            theta=x,
            residual=rows[0],
            jacobian=rows[1],
            cost=float(rows[0] @ rows[0] + distance @ (core.precision * distance)),
            information=rows[1].T @ rows[1] + np.diag(core.precision),
        )
        return problem, optimum, self.noise, covariance / np.outer(scale, scale), parts


def natural_parameters(problem: IdentificationProblem, x: Array) -> Array:
    """Return x (P,) with its logarithms taken back."""
    return np.where(problem.is_logarithm, problem.natural_scale(x), x)


def linearise(problem: IdentificationProblem, x: Array, root: Array | float) -> LinearisedProblem:
    """Linearise the problem at x, in natural parameters.

    Parameters
    ----------
    problem
        The identification problem.
    x
        The vector (size,).
    root
        Factor of each row: roots of the robust weights (N,), or one.

    Returns
    -------
    LinearisedProblem
        Residuals, scaled Jacobian and prior. Parameters at a bound stay there.
    """
    rows = problem.evaluate(x, root)
    assert rows is not None
    lower, upper = problem.bounds()
    inside = (lower < x) & (x < upper)
    scale = problem.natural_scale(x)
    jacobian = rows[1] * inside / scale
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = np.inf
    wave = problem.wave_slice
    prior_root = np.sqrt(problem.prior_precision)
    prior_root[wave] = 0.0
    distance = prior_root * (x - problem.prior_mean)
    prior = np.column_stack([np.diag(prior_root / scale / size), distance])[prior_root > 0]
    linear = LinearisedProblem(rows[0], jacobian / size, size, prior, problem.residual_slices)
    if not problem.n_waves:
        return linear
    largest = float(np.ptp(problem.measured_output)) / problem.noise_sd
    sizes = wave_sizes(len(rows[0]), largest)
    return replace(linear, waves=x[wave], wave_shares=problem.wave_shares, wave_sds=sizes)


def average_over_noise(problem: IdentificationProblem, optimum: Optimum) -> NoiseAverage:
    """Average over first-order disturbances, and white noise or filtered noise of the input.

    Parameters
    ----------
    problem
        The identification problem.
    optimum
        Where the search starts; its robust weights stay.

    Returns
    -------
    NoiseAverage
        The average. It is linearised anew up to ``MAX_AVERAGE_ROUNDS`` times.
    """
    root = sqrt_weights(optimum.weights)
    box = full_box(problem.n_measured)
    rows = problem.evaluate(optimum.theta, root)
    assert rows is not None
    input_noise = input_noise_model(problem, optimum.theta, rows[0])
    # white noise, or what it is where the noise of the input is known
    other_noises = [replace(input_noise, averaged=True)]
    for _ in range(MAX_AVERAGE_ROUNDS):
        linear = linearise(problem, optimum.theta, root)
        grid = NoiseGrid.build(linear, box)
        mixture = grid.average(linear, other_noises)
        mean = natural_parameters(problem, optimum.theta) + mixture.step
        tolerance = AVERAGE_TOLERANCE * np.sqrt(np.diag(mixture.covariance))
        if box is grid.box or np.all(np.abs(mixture.step) <= tolerance):
            break
        if problem.n_waves:
            problem = replace(problem, wave_sd=mixture.wave_sd)
        core = problem.least_squares_problem(mixture.noise, root)
        optimum = search(problem, core, optimum.theta)
        problem = replace(problem, noise_sd=residual_sd(optimum, problem))
        box = grid.box
    return NoiseAverage(
        problem,
        optimum,
        mixture.noise,
        mean,
        mixture.covariance,
        mixture.evidence,
        mixture.walk_share,
        tuple(part._replace(mean=part.mean - mixture.step) for part in mixture.parts),
    )
