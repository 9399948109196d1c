"""Loop current step response (LCSR): lag from heating by a current, converted to a plunge.

Internal heating and an external step share the poles of the sensor; internal heating adds zeros
(Kerlin, Hashemian). The weight of each pole in a plunge follows from a model of where heat is
generated and stored: a round core, heated about its axis and read there, surrounded by a metal wall
and a boundary layer.

``tcdyn sensor`` uses it. ``tests/sensors/test_sensor_in_place.py`` checks the modes against those
of a cylinder of rings, and that the interval holds the lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import j0, j1, jn_zeros, logsumexp, softmax
from scipy.stats import multivariate_t

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import NoiseModel
from tcdyn.sensors.file import SHARES, SensorFile, sensor_file, step_passes, undetermined
from tcdyn.sensors.step_fits import CurveFit, fit_curve, residual_noise, white_noise_K

MODES = 14  # modes of the cylinder that are summed; chosen by judgement
# Priors for sheathed sensors: Biot number of the boundary layer, heat stored in the wall over that
# in the core, radius of the heated part over that of the core; medians and standard deviations of
# the logarithm. Chosen by judgement.
PRIORS = {
    "log_biot": (np.log(2.0), 1.5),
    "log_wall": (np.log(0.5), 0.8),
    "log_heated": (np.log(0.15), 0.7),
}
# Starts of the fits: Biot number, wall, heated radius; chosen by judgement.
STARTS = [
    (biot, wall, heated) for biot in (0.6, 2.5, 9.0) for wall, heated in ((0.3, 0.1), (1.0, 0.25))
]
# Relative standard uncertainty of the lag for a sensor that is no such cylinder (plants report 10 %
# at 95 %).
CONVERSION_REL = 0.05
# Half-width of the 95 % interval in percent, beyond which a warning says that the response to the
# current does not determine the response to a plunge; chosen by judgement.
WIDE_PERCENT = 20.0
MAX_ROWS = 4000  # rows that are fitted; longer records are averaged; chosen by judgement
MIN_READINGS = 40  # of the record; chosen by judgement
MIN_RISE_NOISES = 10.0  # least response over the noise; chosen by judgement
SAMPLES = 400  # samples of the posterior for each proposal; chosen by judgement
TIMES_SAMPLES = 60  # samples for t50 to t90; chosen by judgement
PROPOSAL_DOF = 5.0  # degrees of freedom of the Student's t proposals; chosen by judgement
# cost above the best beyond which a fit is no centre of a proposal; by judgement
MAX_EXCESS_COST = 20.0
# Largest modulus of a logarithm of lag, Biot number, wall and radius; keeps their exponential
# finite.
MAX_LOG = 25.0
# Parameters in which the response is linear, in the order of ``_HeatedRecord.table``.
LINEAR = ("level", "drift", "direct", "size")
# Zeros of J0, between which each root of the characteristic equation lies.
ROOT_BOUNDS = np.r_[0.0, jn_zeros(0, MODES)]


@one_blas_thread
def current_sensor(
    time_s: Array,
    y_degC: Array,
    current: Array,
    column: str,
    *,
    sensor: str = "sensor",
    off_only: bool = False,
    **more: Any,
) -> SensorFile:
    """The chain for a plunge from the response to a switched current through the sensor.

    Parameters
    ----------
    time_s
        Even times (N,) [s].
    y_degC
        Readings (N,) [degC], NaN where missing.
    current
        Current (N,), in any unit; the heating is proportional to its square.
    column
        The sensor's column.
    sensor
        Name of the sensor.
    off_only
        Use only rows without current (a thermocouple cannot be read while it is heated).
    more
        Other fields of the file.

    Returns
    -------
    SensorFile
        The file with the chain for a plunge, of up to three lags.

    Raises
    ------
    InputError
        A current that never changes, a response within the noise, a record too short after the
        step.

    Notes
    -----
    y = level + drift t + direct P + size sum_n a_n (P after a lag tau_n), with P = current^2 over
    its largest value, and a_n, tau_n those of ``cylinder``. Lag, Biot number, wall and heated
    radius are sampled from their posterior, so that the interval is as wide, and as skew, as the
    response to the current leaves them undetermined.

    ``PRIORS`` decide the conversion from the heated response to a plunge where the data do not;
    ``CONVERSION_REL`` adds the error of the cylinder model. Narrower priors give intervals that are
    too short for other sensors. ``tests/sensors/test_sensor_in_place.py`` checks that the lag lies
    in its interval.
    """
    power = np.nan_to_num(current) ** 2
    largest = float(power.max())
    if largest <= 0 or np.ptp(power) < 0.3 * largest:
        raise InputError(
            "the current does not switch",
            expected="one that is switched on or off within the record",
        )
    power = power / largest
    y = np.where(power > 0.5, np.nan, y_degC) if off_only else y_degC
    count = int(np.isfinite(y).sum())
    if count < MIN_READINGS:
        raise InputError(f"only {count} readings", expected=f"at least {MIN_READINGS}")
    dt_s = float(time_s[1] - time_s[0])
    record = _HeatedRecord.averaged(dt_s, y, power)
    rise_K = float(np.nanmax(record.y) - np.nanmin(record.y))
    if rise_K < MIN_RISE_NOISES * record.noise_K:
        raise InputError(
            f"the response of {rise_K:.2g} K is within ten times the noise",
            remedy="heat more, or average",
        )
    best, theta, weights = _posterior(record)
    # error of the conversion model; it moves lag and all times alike
    factor = np.exp(CONVERSION_REL * np.random.default_rng(1).standard_normal(len(theta)))
    lag = _weighted_estimate(np.exp(theta[:, 0]) * factor, weights)
    chosen = np.random.default_rng(2).choice(len(theta), TIMES_SAMPLES, p=weights)
    passes = np.array([step_passes(_chain(theta[k])) * factor[k] for k in chosen])
    equal = np.full(TIMES_SAMPLES, 1 / TIMES_SAMPLES)
    times = [_weighted_estimate(t, equal) for t in passes.T]
    mean_theta = weights @ theta
    taus = _chain(mean_theta).taus_s
    chain = Chain([tau * lag.value / sum(taus) for tau in taus])
    switches = np.flatnonzero(np.diff(power > 0.5))
    rows_after = np.diff(np.r_[switches, len(power) - 1])
    longest_s = float(rows_after.max() * (time_s[1] - time_s[0]))
    findings: list[Finding] = []
    if longest_s < 4 * lag.value:
        findings.append(
            warning("sensor.cut_off", subject=column, after_s=longest_s, lag_s=lag.value)
        )
    findings += best.residual_findings(column, record.noise_K, 0.01 * rise_K)
    findings.append(_conversion_finding(column, lag))
    fit = {
        "modes_s": cylinder_modes(mean_theta)[0][:3].tolist(),
        "noise_K": best.noise_K,
        "lag_s": lag.model_dump(),
        "heating_K": rise_K,
        "switches": len(switches),
        "model_u_s": CONVERSION_REL * lag.value,
    }
    for name, values in zip(PRIORS, theta.T[1:]):
        estimate = _weighted_estimate(np.exp(values), weights)
        fit[name.removeprefix("log_")] = estimate.model_dump()
    return sensor_file(
        sensor,
        {column: chain},
        "current",
        np.array([[lag.u**2]]),
        [lag.value - chain.taus_s[0]],
        times={column: dict(zip(SHARES, times))},
        fit=fit,
        findings=findings,
        **more,
    )


def _conversion_finding(column: str, lag: Estimate) -> Finding:
    """Return how well the response to the current determines that to a plunge."""
    percent = 50 * (lag.high95 - lag.low95) / lag.value
    if percent > WIDE_PERCENT:
        return warning("sensor.conversion_wide", subject=column, low_s=lag.low95, high_s=lag.high95)
    return info("sensor.conversion", subject=column, percent=percent)


def cylinder_modes(theta: Array) -> tuple[Array, Array]:
    """Modes of a cylinder that is heated about its axis and read there.

    Parameters
    ----------
    theta
        Logarithms of lag [s], Biot number Bi = h R/k, wall g and heated radius e (over R).

    Returns
    -------
    taus_s, shares
        Time constants [s], and shares of the response on the axis (MODES,).

    Notes
    -----
    z J1(z) = (Bi - g z^2/2) J0(z), tau = R^2/(a z^2), share ~ tau J1(z e)/(z e)/(J0(z)^2 + J1(z)^2
    + g J0(z)^2). There is one root z between neighbouring zeros of J0. A plunge has the poles only,
    T/T_fluid = 1/(I0(q) + (q/Bi) I1(q) + (g q^2/(2 Bi)) I0(q)), q^2 = s R^2/a, so lag = R^2/a (1/4
    + (1 + g)/(2 Bi)).

    The characteristic equation, the shares and the lag belong to one model: a change of one needs
    the others. ``tests/sensors/test_sensor_in_place.py`` compares the modes with those of a
    cylinder of rings, and their sum with the lag.

    Examples
    --------
    A bare cylinder at constant surface temperature: z are the zeros of J0.

    >>> tau, _ = cylinder_modes(np.log([0.25, 1e6, 1e-6, 0.1]))
    >>> (tau * jn_zeros(0, MODES) ** 2).round(3).tolist() == [1.0] * MODES
    True
    """
    lag, biot, wall, heated = np.exp(theta)
    low = ROOT_BOUNDS[:-1] + 1e-12
    high = ROOT_BOUNDS[1:]

    def characteristic(z: Array) -> Array:
        """Return the characteristic function of each mode; zero at its root."""
        return z * j1(z) - (biot - 0.5 * wall * z**2) * j0(z)

    sign = np.sign(characteristic(low))
    for _ in range(48):  # bisection of all roots
        middle = 0.5 * (low + high)
        below_root = np.sign(characteristic(middle)) == sign
        low = np.where(below_root, middle, low)
        high = np.where(below_root, high, middle)
    z = 0.5 * (low + high)
    share = j1(z * heated) / (z * heated) / ((1 + wall) * j0(z) ** 2 + j1(z) ** 2) / z**2
    return lag / (0.25 + 0.5 * (1 + wall) / biot) / z**2, share / share.sum()


def _chain(theta: Array) -> Chain:
    """Return the chain of a plunge: the two largest lags, and the sum of all others as one."""
    first, second = cylinder_modes(theta)[0][:2]
    others = max(float(np.exp(theta[0])) - first - second, 0.0)
    return Chain(sorted([first, second, others], reverse=True))


@dataclass(frozen=True)
class _HeatedRecord:
    """Data of the fit.

    Attributes
    ----------
    dt_s
        Interval [s].
    y
        Readings (N,) [degC], NaN where missing.
    power
        Heating over its largest value (N,).
    t
        Times from 0 to 1 (N,), for the drift.
    noise_K
        White noise of the readings [K].
    """

    dt_s: float
    y: Array
    power: Array
    t: Array
    noise_K: float

    @classmethod
    def averaged(cls, dt_s: float, y: Array, power: Array) -> _HeatedRecord:
        """Build a record of at most ``MAX_ROWS`` means of neighbouring rows.

        Parameters
        ----------
        dt_s
            Interval [s].
        y
            Readings (N,) [degC], NaN where missing.
        power
            Heating (N,).

        Returns
        -------
        _HeatedRecord
            The means; NaN where one of the rows is missing.
        """
        size = -(-len(y) // MAX_ROWS)
        n = len(y) // size * size
        mean = y[:n].reshape(-1, size).mean(axis=1)
        heating = power[:n].reshape(-1, size).mean(axis=1)
        noise_K = white_noise_K(mean)
        return cls(dt_s * size, mean, heating, np.linspace(0, 1, len(mean)), noise_K)

    def response(self, shape: Array) -> Array:
        """Return the response to the heating, one in the steady state.

        It is steady before the first row.

        Parameters
        ----------
        shape
            Logarithms as ``theta`` of :func:`cylinder_modes` (4,).

        Returns
        -------
        array
            Response (N,).
        """
        total = np.zeros_like(self.power)
        for tau, share in zip(*cylinder_modes(shape)):
            decay = float(np.exp(-self.dt_s / tau))
            initial = [self.power[0]]
            lagged, _ = lfilter([0.0, 1 - decay], [1.0, -decay], self.power, zi=initial)
            total += share * lagged
        return total

    def table(self, shape: Array) -> Array:
        """Return the regressors (N, 4) of level, drift, direct and size."""
        ones = np.ones_like(self.t)
        return np.stack([ones, self.t, self.power, self.response(shape)], axis=1)


def _posterior(record: _HeatedRecord) -> tuple[CurveFit, Array, Array]:
    """Sample the posterior of the shape by importance sampling.

    Parameters
    ----------
    record
        The data.

    Returns
    -------
    best
        The best fit.
    samples
        Log lag, Biot number, wall and heated radius (K, 4).
    weights
        Weights of the samples (K,), of sum one.

    Notes
    -----
    Several starts are needed, since a thick boundary layer with a thin wall and the reverse may
    both be minima. The samples are proposed about all of them, with level, drift, direct and size
    profiled out. Up to three proposals are mixed until a quarter of ``SAMPLES`` is effective. The
    seeds are fixed, so that the same data give the same file.
    """
    fits = _fit_all(record)
    best = min(fits, key=lambda f: f.optimum.cost)
    density = _LogPosterior(record, best)
    near = [f for f in fits if f.optimum.cost < best.optimum.cost + MAX_EXCESS_COST]
    centres = np.array([f.optimum.theta[4:] for f in near])
    covariances = np.array([f.optimum.covariance[4:, 4:] for f in near])
    log_determinants = np.linalg.slogdet(covariances)[1]
    costs = np.array([f.optimum.cost for f in near])
    chances = softmax(-0.5 * costs + 0.5 * log_determinants)
    proposal = _Mixture(centres, covariances, chances)
    proposals = list[_Mixture]()
    samples = np.empty((0, 4))
    log_p = np.empty(0)
    for seed in range(3):
        proposals.append(proposal)
        new = proposal.sample(np.random.default_rng(seed))
        samples = np.concatenate([samples, new])
        log_p = np.r_[log_p, [density(shape) for shape in new]]
        log_q = logsumexp([p.log_density(samples) for p in proposals], axis=0)
        weights = softmax(log_p - log_q)
        effective_size = 1 / np.sum(weights**2)
        if effective_size > SAMPLES / 4:
            break
        # too few effective samples: propose from the weighted mean and covariance
        covariance = np.cov(samples.T, ddof=0, aweights=weights) + 1e-6 * np.eye(4)
        mean = weights @ samples
        proposal = _Mixture(mean[None], covariance[None], np.ones(1))
    return best, samples, weights


def _fit_all(record: _HeatedRecord) -> list[CurveFit]:
    """Return fits from all starts, with the noise of the residuals of the best."""
    finite = np.isfinite(record.y)
    y = record.y[finite]
    names = [*LINEAR, "log_lag", *PRIORS]
    range_K = max(float(np.ptp(y)), 1e-9)
    scale = np.array([range_K] * 4 + [0.5] * 4)
    duration_s = len(record.y) * record.dt_s

    def model(theta: Array) -> Array | None:
        """Return the readings of the model (N,), or None beyond ``MAX_LOG``."""
        if np.any(np.abs(theta[4:]) > MAX_LOG):
            return None
        return record.table(theta[4:]) @ theta[:4]

    def start(biot: float, wall: float, heated: float) -> Array:
        """Best of ten lags, with level, drift, direct and size by linear least squares.

        Parameters
        ----------
        biot, wall, heated
            Biot number, wall and heated radius of the start.

        Returns
        -------
        array
            Start (8,) of all parameters.
        """
        candidates = []
        for lag in np.geomspace(3 * record.dt_s, duration_s / 3, 10):
            shape = np.log([lag, biot, wall, heated])
            table = record.table(shape)[finite]
            linear = np.linalg.lstsq(table, y, rcond=None)[0]
            square_sum = float(np.sum((table @ linear - y) ** 2))
            candidates.append((square_sum, np.r_[linear, shape]))
        return min(candidates, key=lambda pair: pair[0])[1]

    def fits(starts: list[Array], noise: tuple[NoiseModel, float]) -> list[CurveFit]:
        """Return the fits from several starts with one noise."""
        return [
            fit_curve("LCSR", model, record.y, names, theta, scale, prior=PRIORS, noise=noise)
            for theta in starts
        ]

    first = fits([start(*values) for values in STARTS], (NoiseModel(), record.noise_K))
    best = min(first, key=lambda f: f.optimum.cost)
    noise = residual_noise(best.residual, len(names))
    return fits([f.optimum.theta for f in first], noise)


class _LogPosterior:
    """Log posterior density of the shape (4,), profiled over level, drift, direct and size."""

    def __init__(self, record: _HeatedRecord, fit: CurveFit) -> None:
        """Prepare the posterior of a record, with the noise of a fit."""
        self.record = record
        self.finite = np.isfinite(record.y)
        self.fit = fit
        self.full = [slice(0, int(self.finite.sum()))]
        self.white_y = self._whiten(record.y[self.finite])

    def __call__(self, shape: Array) -> float:
        """Return the log density at a shape, up to a constant."""
        if np.any(np.abs(shape) > MAX_LOG):
            return -np.inf
        table = self._whiten(self.record.table(shape)[self.finite])
        linear = np.linalg.lstsq(table, self.white_y, rcond=None)[0]
        deviations = [(v - mean) / sd for v, (mean, sd) in zip(shape[1:], PRIORS.values())]
        square_sum = np.sum((self.white_y - table @ linear) ** 2)
        return -0.5 * float(square_sum + np.sum(np.square(deviations)))

    def _whiten(self, values: Array) -> Array:
        """Return values (N,) or (N, 4) whitened by the noise of the fit."""
        return self.fit.colour.whiten(values, self.full) / self.fit.noise_K


@dataclass(frozen=True)
class _Mixture:
    """Mixture of multivariate Student's t with C components in four dimensions.

    Attributes
    ----------
    centres
        Centres (C, 4).
    covariances
        Scale matrices (C, 4, 4).
    chances
        Probabilities of the components (C,).
    """

    centres: Array
    covariances: Array
    chances: Array

    def sample(self, rng: np.random.Generator) -> Array:
        """Return ``SAMPLES`` samples (SAMPLES, 4)."""
        component = rng.choice(len(self.centres), SAMPLES, p=self.chances)
        tails = np.sqrt(PROPOSAL_DOF / rng.chisquare(PROPOSAL_DOF, (SAMPLES, 1)))
        roots = np.linalg.cholesky(self.covariances)[component]
        normal = np.einsum("kij,kj->ki", roots, rng.standard_normal((SAMPLES, 4)))
        return self.centres[component] + normal * tails

    def log_density(self, x: Array) -> Array:
        """Return the log density (K,) at ``x`` (K, 4)."""
        components = [
            multivariate_t.logpdf(x, centre, covariance, PROPOSAL_DOF)
            for centre, covariance in zip(self.centres, self.covariances)
        ]
        return logsumexp(components, axis=0, b=self.chances[:, None])


def _weighted_estimate(values: Array, weights: Array) -> Estimate:
    """Return mean, standard deviation and 95 % range of weighted samples.

    Parameters
    ----------
    values
        Samples (K,).
    weights
        Their weights (K,), of sum one.

    Returns
    -------
    Estimate
        The estimate.

    Raises
    ------
    InputError
        Where all weight is on one sample.
    """
    mean = float(weights @ values)
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order]) - 0.5 * weights[order]
    low, high = np.interp([0.025, 0.975], cumulative, values[order])
    sd = float(np.sqrt(weights @ (values - mean) ** 2))
    if not 0 < sd < np.inf:  # all weight on one sample
        raise undetermined()
    return Estimate(value=mean, u=sd, low95=float(low), high95=float(high))
