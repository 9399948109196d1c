"""Least-squares fits of a sensor's response with whitened noise; averages by BIC.

``tcdyn.sensors.plunge`` and ``tcdyn.sensors.current`` fit with it; ``tcdyn.sensors.noise`` and
``pair`` use parts. ``tests/sensors/test_sensor_plunge.py`` guards it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, mixture
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation import NoiseModel, Optimum, Problem, Status, fit_ar, minimise
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.sensors.file import undetermined_lag_error

# curve (N,) at the parameters; None where it cannot be computed
Model = Callable[[Array], Array | None]
# derivatives (N,) of a curve (N,) by some parameters, by their names
Columns = Callable[[Array, Array], Mapping[str, Array]]
PARAMETER_STEP = 1e-5  # step in differences, over a parameter's scale; chosen by judgement
QUANTITY_STEP = 1e-3  # the same for quantities of the parameters; chosen by judgement
NOISE_ORDER = 3  # order of differences that the white noise is estimated from; by judgement
MAX_AR_ORDER = 8  # of the autoregression of the residuals; chosen by judgement
MAX_STEPS = 40  # of the search, at most; chosen by judgement
# Fall of the sum of squares, in squared noises, that the last step of a search promises; it is
# still taken. Larger ones change results of a heating current by 0.4 u.
TOLERANCE = 1e-6
MIN_DIFFERENCES = 20  # without a gap, for an estimate of the noise to 20 %
# Share of a column that the fitted parameters do not make, below which it is an error of rounding
LEAST_OWN = 1e-5
# Readings below which their differences contain the step, and their noise is first taken as this
# share of their range; by judgement, a thermometer of 0.1 K in a step of 50 K
FEW_READINGS = 30
FEW_SHARE = 0.003
MIN_NOISE_K = 1e-9  # least noise [K], so that data without noise can be fitted
# Residual rms over the noise, beyond which a warning about a misfit is given; chosen by judgement.
MISFIT_RATIO = 3.0
# Relative standard uncertainty below which a parameter is distinguished from zero; by judgement.
RESOLVED_REL = 0.4


@dataclass(frozen=True)
class CurveFit:
    """One fitted structure.

    Attributes
    ----------
    optimum
        Optimum of the least-squares problem.
    bic
        Bayesian information criterion.
    noise_K
        Level of the white noise [K].
    colour
        Autoregression of the residuals.
    residual
        Residuals, model minus readings [K].
    scale
        Scale of each parameter (P,).
    """

    optimum: Optimum
    bic: float
    noise_K: float
    colour: NoiseModel
    residual: Array = field(repr=False)
    scale: Array = field(repr=False)

    @property
    def theta(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.optimum.problem.names, self.optimum.theta.tolist()))

    def u(self, name: str) -> float:
        """Standard uncertainty of a parameter."""
        k = self.optimum.problem.names.index(name)
        return float(np.sqrt(self.optimum.covariance[k, k]))

    @property
    def student_factor(self) -> float:
        """Factor of standard uncertainties whose noise is estimated from the residuals.

        The 95 % range of Student's distribution over that of the normal one; the degrees of freedom
        are the readings less the parameters without a prior.
        """
        free = int(np.count_nonzero(np.isinf(self.optimum.problem.prior_sd)))
        return float(student.ppf(0.975, max(len(self.residual) - free, 1)) / norm.ppf(0.975))

    def is_resolved(self, names: Sequence[str]) -> bool:
        """Whether the data distinguish all these parameters from zero."""
        return all(self.u(name) <= RESOLVED_REL * self.theta[name] for name in names)

    def is_near(self, other: CurveFit, symmetric: Sequence[str] = ()) -> bool:
        """Whether another fit of the same structure has the same parameters within their u.

        Parameters
        ----------
        other
            The other fit.
        symmetric
            Names of parameters that may change places without changing the curve; they are compared
            in the order of their values.
        """
        names = self.optimum.problem.names
        places = [names.index(name) for name in symmetric]
        theta = self.optimum.theta.copy()
        other_theta = other.optimum.theta.copy()
        u = np.sqrt(np.diag(self.optimum.covariance))
        by_size = [places[k] for k in np.argsort(theta[places])]
        u[places] = u[by_size]
        theta[places] = theta[by_size]
        other_theta[places] = np.sort(other_theta[places])
        return bool(np.all(np.abs(theta - other_theta) <= u))

    def score(self, direction: Array) -> tuple[float, float]:
        """Return the multiple of a further column that the residuals ask for, and its gain.

        Parameters
        ----------
        direction
            Change of the curve with the further parameter (N,) at the rows of ``residual``.

        Returns
        -------
        multiple
            The parameter after one linear step from zero.
        gain
            Reduction of the sum of squares by this step: the score statistic (Rao 1948, Proc. Camb.
            Phil. Soc. 44, 50). Zero for a column that the fitted parameters can make.
        """
        full = [slice(0, len(direction))]
        column = self.colour.whiten(direction, full) / self.noise_K
        projected = self.optimum.jacobian.T @ column
        problem = self.optimum.problem
        # what the search has left to the fitted parameters is not the column's
        gradient = self.optimum.jacobian.T @ self.optimum.residual
        gradient += (self.optimum.theta - problem.prior_mean) / problem.prior_sd**2
        left = float(projected @ self.optimum.covariance @ gradient)
        slope = float(column @ self.optimum.residual) - left
        own = float(column @ column)
        if own == 0:
            return 0.0, 0.0
        shared = float(projected @ self.optimum.covariance @ projected)
        curvature = own - shared
        if curvature < LEAST_OWN * own:
            return 0.0, 0.0
        return -slope / curvature, slope**2 / curvature

    def propagate(self, quantity: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Return quantities of the parameters, and their covariance by first-order propagation.

        Parameters
        ----------
        quantity
            Function of theta (P,) that returns the quantities (K,).

        Returns
        -------
        value
            Quantities (K,).
        covariance
            Their covariance (K, K).
        """
        theta = self.optimum.theta
        lower = self.optimum.problem.lower
        slopes = []
        for k, step in enumerate(QUANTITY_STEP * self.scale):
            up = theta.copy()
            up[k] += step
            down = theta.copy()
            down[k] = max(down[k] - step, float(lower[k]))
            slopes.append((quantity(up) - quantity(down)) / (up[k] - down[k]))
        jacobian = np.array(slopes)
        return quantity(theta), jacobian.T @ self.optimum.covariance @ jacobian

    def residual_findings(self, column: str, noise_K: float, least_K: float) -> list[Finding]:
        """Return findings about residuals: coloured, or clearly above the noise.

        Parameters
        ----------
        column
            The sensor's column.
        noise_K
            White noise of the readings [K].
        least_K
            Rms residual that is always acceptable [K].

        Returns
        -------
        list of Finding
            An info for colour, a warning for a misfit.
        """
        findings = [] if self.colour.white else [info("sensor.coloured", subject=column)]
        rms_K = float(np.sqrt(np.mean(self.residual**2)))
        if rms_K > max(MISFIT_RATIO * noise_K, least_K):
            findings.append(warning("sensor.misfit", subject=column, rms_K=rms_K, noise_K=noise_K))
        return findings


def fit_curve(
    name: str,
    model: Model,
    y: Array,
    names: Sequence[str],
    start: Array,
    scale: Array,
    *,
    noise: tuple[NoiseModel, float],
    linear: Columns | None = None,
    bends: bool = False,
    steps: int = MAX_STEPS,
    tolerance: float = TOLERANCE,
    prior: Mapping[str, tuple[float, float]] | None = None,
    lower: Mapping[str, float] | None = None,
    upper: Mapping[str, float] | None = None,
) -> CurveFit:
    """Fit a curve by least squares, with the residuals whitened by an autoregression.

    Parameters
    ----------
    name
        Name of the structure, for messages.
    model
        The curve (N,) as a function of theta; None where it cannot be computed.
    y
        Data (N,); NaN is left out.
    names
        Names of the parameters (P,).
    start
        Start (P,).
    scale
        Scale of each parameter (P,), for differences and steps.
    noise
        Autoregression and level [K] of the residuals (:func:`residual_noise`).
    linear
        Derivatives of the curve that need no further curve, by the names of their parameters.
    bends
        Whether the search follows curved valleys to second order (:func:`minimise`).
    steps
        Largest number of steps of the search.
    tolerance
        Fall of the sum of squares at which the search ends.
    prior
        Mean and standard deviation of normal priors, by name.
    lower, upper
        Bounds, by name.

    Returns
    -------
    CurveFit
        The fit.

    Raises
    ------
    InputError
        Where the model cannot be computed at its start.

    Notes
    -----
    ``PARAMETER_STEP`` is for one-sided differences: smaller steps lose digits, larger ones bias the
    derivatives. The BIC compares fits with one noise only. A parameter with a normal prior adds
    log(prior variance/posterior variance) instead of log N: its part of the Laplace approximation
    (Kass and Raftery 1995, J. Am. Stat. Assoc. 90, 773).
    """
    finite = np.isfinite(y)
    priors = prior or {}
    prior_mean = np.array([priors.get(n, (0.0, np.inf))[0] for n in names])
    prior_sd = np.array([priors.get(n, (0.0, np.inf))[1] for n in names])
    low = np.array([(lower or {}).get(n, -np.inf) for n in names])
    high = np.array([(upper or {}).get(n, np.inf) for n in names])
    full = [slice(0, int(finite.sum()))]
    colour, noise_K = noise

    def evaluate(theta: Array) -> tuple[Array, Array] | None:
        """Return whitened residuals and Jacobian at theta; None where there is no curve."""
        curve = model(theta)
        if curve is None:
            return None
        known = {} if linear is None else linear(theta, curve)
        slopes = []
        for k, size in enumerate(scale):
            if names[k] in known:
                slopes.append(known[names[k]][finite])
                continue
            shifted = theta.copy()
            shifted[k] += PARAMETER_STEP * size
            other = model(shifted)
            if other is None:
                return None
            slopes.append((other - curve)[finite] / (PARAMETER_STEP * size))
        residual = (curve - y)[finite]
        jacobian = np.stack(slopes, axis=1)
        return colour.whiten(residual, full) / noise_K, colour.whiten(jacobian, full) / noise_K

    def whitened_residual(theta: Array) -> Array | None:
        """Return whitened residuals at theta; None where there is no curve."""
        curve = model(theta)
        if curve is None:
            return None
        return np.asarray(colour.whiten((curve - y)[finite], full) / noise_K)

    problem = Problem(
        tuple(names),
        evaluate,
        residual=whitened_residual if bends else None,
        prior_mean=prior_mean,
        prior_sd=prior_sd,
        lower=low,
        upper=high,
        max_step=3 * scale,
    )
    optimum = minimise(problem, start, limit=steps, tolerance=tolerance)
    if optimum.status is Status.NOWHERE:
        raise InputError(f"{name} cannot be fitted: the model cannot be computed")
    residual = (np.asarray(model(optimum.theta)) - y)[finite]
    variance = np.diag(optimum.covariance)
    has_prior = np.isfinite(prior_sd)
    learned = np.log(prior_sd[has_prior] ** 2 / variance[has_prior])
    free = int(np.sum(~has_prior))
    bic = optimum.cost + free * np.log(int(finite.sum())) + float(learned.sum())
    return CurveFit(optimum, bic, noise_K, colour, residual, scale)


def residual_noise(residual: Array, parameters: int) -> tuple[NoiseModel, float]:
    """Return the autoregression of residuals and its noise level.

    Parameters
    ----------
    residual
        Residuals (N,) [K].
    parameters
        Number of fitted parameters.

    Returns
    -------
    colour
        The autoregression; white where BIC prefers none, and of few readings.
    level_K
        Standard deviation of the whitened residuals [K].
    """
    n = len(residual)
    full = [slice(0, n)]
    colour = NoiseModel()
    if n >= FEW_READINGS:
        colour = fit_ar(residual, full, max_order=MAX_AR_ORDER)
    square_sum = float(residual @ residual)
    whitened_sum = float(np.sum(colour.whiten(residual, full) ** 2))
    gain = n * np.log(max(square_sum, 1e-300) / max(whitened_sum, 1e-300))
    if gain < len(colour.ar) * np.log(n):
        colour = NoiseModel()
    white_sum = square_sum if colour.white else whitened_sum
    level_K = float(np.sqrt(white_sum / max(n - parameters, 1)))
    return colour, max(level_K, MIN_NOISE_K)


def white_noise_K(y: Array) -> float:
    """Return the standard deviation of the white noise of readings [K], above zero.

    Differences across a gap contain the signal, and are used only where there are too few others.
    Of few readings all differences contain the signal: their noise is ``FEW_SHARE`` of their range,
    with which a fit starts, until its residuals tell. Without any difference it is the least noise.

    Parameters
    ----------
    y
        Readings (N,) [degC], NaN where missing.
    """
    if np.count_nonzero(np.isfinite(np.diff(y, NOISE_ORDER))) < MIN_DIFFERENCES:
        y = y[np.isfinite(y)]
        if 0 < len(y) < FEW_READINGS:
            return max(FEW_SHARE * float(np.ptp(y)), MIN_NOISE_K)
    if len(y) <= NOISE_ORDER:
        return MIN_NOISE_K
    return max(float(white_noise_sd(y, NOISE_ORDER)), MIN_NOISE_K)


def bic_weights(bic: Array, prior: Array | float = 1.0) -> Array:
    """Return the probability of each structure from its BIC, for one noise.

    Parameters
    ----------
    bic
        BIC of each structure (K,).
    prior
        Prior probability of each (K,), not normalised.

    Returns
    -------
    array
        Probabilities (K,).
    """
    w = np.exp(-0.5 * (bic - bic.min())) * prior
    return w / w.sum()


def model_average(values: Sequence[float], us: Sequence[float], weights: Array) -> Estimate:
    """Average a quantity over structures: mean, u and 95 % range of the mixture.

    Parameters
    ----------
    values, us
        Value and standard uncertainty for each structure (K,).
    weights
        Probability of each structure (K,).

    Returns
    -------
    Estimate
        The average; its variance includes the spread between structures.

    Raises
    ------
    InputError
        Where a value or an uncertainty is not finite.
    """
    v = np.asarray(values, dtype=float)
    u = np.asarray(us, dtype=float)
    if not (np.all(np.isfinite(v)) and np.all(np.isfinite(u))):
        raise undetermined_lag_error()
    return mixture([Estimate.normal(*pair) for pair in zip(v, u)], weights.tolist())
