"""Loop current step response (LCSR): lag from heating by a current, converted to a plunge.

Internal heating and an external step share the poles of the sensor; internal heating adds zeros
(Kerlin, Hashemian). The weight of each pole in a plunge follows from a model of where heat is
generated and stored: an isothermal core, which is heated and read, in insulation, a gas gap, a
metal wall and a boundary layer.

``tcdyn sensor`` uses it. ``tests/sensors/test_sensor_in_place.py`` checks the modes against those
of separate code; ``python -m tests.sensors.layered_study current`` checks that the interval holds
the lag.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigh_tridiagonal
from scipy.signal import lfilter
from scipy.special import logsumexp, softmax
from scipy.stats import multivariate_t

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import NoiseModel
from tcdyn.sensors.file import SHARES, SensorFile, sensor_file, step_passes, undetermined_lag_error
from tcdyn.sensors.step import block_means
from tcdyn.sensors.step_fits import CurveFit, fit_curve, residual_noise, white_noise_K

RINGS = 40  # rings of the insulation; lag and modes are then within 0.1 %
MODES = 14  # modes of the cylinder that are summed; chosen by judgement
CORE_HEAT = 1.4  # heat capacity of the core, per volume, over that of the insulation (steel, MgO)
# Priors for sheathed sensors: Biot number of the boundary layer, heat stored in the wall over that
# in the insulation, radius of the core over that of the insulation, and resistance of the gap times
# conductivity over radius of the insulation; medians and standard deviations of the logarithm.
# They cover 0.5 to 8 mm in air to water, walls of 5 to 16 % of the diameter, and gaps up to 60 um.
PRIORS = {
    "log_biot": (np.log(0.5), 2.0),
    "log_wall": (np.log(0.7), 0.7),
    "log_heated": (np.log(0.2), 0.7),
    "log_gap": (np.log(0.3), 1.5),
}
# Starts of the fits: Biot number, wall, heated radius, gap; chosen by judgement.
STARTS = [
    (biot, wall, heated, gap)
    for biot in (0.2, 1.5, 8.0)
    for wall, heated, gap in ((0.5, 0.15, 0.1), (1.0, 0.3, 1.0))
]
# Standard uncertainty of the conversion for other constructions, over the part of the lag that the
# slowest mode does not carry; that part is taken as at least a tenth of the lag, since modes with a
# small share in the heated response cannot be excluded. From sensors with and without a metal core,
# read there or on the axis (`python -m tests.sensors.layered_study current`).
FAST_PART_REL = 0.55
MIN_FAST_SHARE = 0.1
# Half-width of the 95 % interval in percent, beyond which a warning says that the response to the
# current does not determine the response to a plunge; chosen by judgement.
WIDE_PERCENT = 20.0
MAX_ROWS = 4000  # rows that are fitted; longer records are averaged; chosen by judgement
# Least change of the power over the largest power: the current switches; chosen by judgement.
MIN_SWITCHED_SHARE = 0.3
MIN_READINGS = 40  # of the record; chosen by judgement
MIN_RISE_NOISES = 10.0  # least response over the noise; chosen by judgement
SAMPLES = 400  # samples of the posterior for each proposal; chosen by judgement
# Effective number of samples that is enough, and the least one from which a proposal and the result
# may be taken: mean and covariance of five parameters are 20 numbers.
ENOUGH_SAMPLES = SAMPLES / 4
MIN_EFFECTIVE_SAMPLES = 20.0
MAX_PROPOSALS = 3  # chosen by judgement
# Walkers of the Markov chain and their steps, of which about 30 are one independent sample: as many
# independent samples as are enough.
WALKERS = 24
WALK_STEPS = 250
TIMES_SAMPLES = 60  # samples for t50 to t90; chosen by judgement
# Logarithm below the largest weight at which a weight counts as zero, and halvings of the search
# for the power of the weights: to rounding error.
LEAST_LOG_WEIGHT = 700.0
BISECTIONS = 50
PROPOSAL_DOF = 5.0  # degrees of freedom of the Student's t proposals; chosen by judgement
# cost above the best beyond which a fit is no centre of a proposal; by judgement
MAX_EXCESS_COST = 20.0
# Largest modulus of a logarithm of lag, Biot number, wall, radius and gap; keeps their exponential
# finite.
MAX_LOG = 20.0
MAX_CORE = 0.9  # largest radius of the core over that of the insulation
# Parameters in which the response is linear, in the order of ``_HeatedRecord.regressors``.
LINEAR = ("level", "drift", "direct", "size")


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
    its largest value, and a_n, tau_n those of ``cylinder_modes``. Lag, Biot number, wall, heated
    radius and gap are sampled from their posterior, so that the interval is as wide, and as skew,
    as the response to the current leaves them undetermined.

    ``PRIORS`` decide the conversion from the heated response to a plunge where the data do not;
    ``FAST_PART_REL`` adds the error of the cylinder model. Narrower priors
    give intervals that are
    too short for other sensors. ``tests/sensors/test_sensor_in_place.py`` checks that the lag lies
    in its interval.
    """
    if not np.all(np.isfinite(current)):
        row = int(np.argmin(np.isfinite(current)))
        raise InputError(
            f"the current is missing in row {row + 1}",
            expected="a current in each row",
            remedy="fill the gaps of the current's column",
        )
    largest = float(np.abs(current).max())
    power = (current / largest) ** 2 if largest > 0 else np.zeros_like(current)
    if np.ptp(power) < MIN_SWITCHED_SHARE:
        raise InputError(
            "the current does not switch",
            expected="one that is switched on or off within the record",
        )
    y = np.where(power > 0.5, np.nan, y_degC) if off_only else y_degC
    count = int(np.isfinite(y).sum())
    if count < MIN_READINGS:
        raise InputError(f"only {count} readings", expected=f"at least {MIN_READINGS}")
    dt_s = float(time_s[1] - time_s[0])
    record = _HeatedRecord.from_rows(dt_s, y, power)
    rise_K = float(np.nanmax(record.y) - np.nanmin(record.y))
    if rise_K < MIN_RISE_NOISES * record.noise_K:
        raise InputError(
            f"the response of {rise_K:.2g} K is within ten times the noise",
            remedy="heat more, or average",
        )
    best, theta, weights = _posterior(record)
    # error of the conversion model; fast modes move lag and all times by the same time
    lags = np.exp(theta[:, 0])
    slowest_s = np.array([cylinder_modes(shape)[0][0] for shape in theta])
    model_u_s = FAST_PART_REL * np.maximum(lags - slowest_s, MIN_FAST_SHARE * lags)
    shift_s = model_u_s * np.random.default_rng(1).standard_normal(len(theta))
    lag = _weighted_estimate(lags + shift_s, weights)
    chosen = np.random.default_rng(2).choice(len(theta), TIMES_SAMPLES, p=weights)
    passes = np.array([step_passes(_chain_of_lags(theta[k])) + shift_s[k] for k in chosen])
    equal = np.full(TIMES_SAMPLES, 1 / TIMES_SAMPLES)
    times = [_weighted_estimate(t, equal) for t in passes.T]
    mean_theta = weights @ theta
    taus = _chain_of_lags(mean_theta).taus_s
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
        "model_u_s": float(weights @ model_u_s),
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
        lags={column: lag},
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
    """Modes of a layered cylinder whose core is heated and read.

    Parameters
    ----------
    theta
        Logarithms of lag [s], Biot number Bi = h R/k, heat of the wall, radius of the core and
        resistance of the gap (see ``PRIORS``), with R, k and the heat of the insulation.

    Returns
    -------
    taus_s, shares
        Time constants [s], and shares in the response of the core to its heating (MODES,).

    Notes
    -----
    Rings between nodes at their middle radius: C dT/dt = -K T + Q, K tridiagonal with resistances
    ln(r2/r1), that of the gap, and 1/Bi. With C^-1/2 K C^-1/2 = V diag(1/tau) V', the share of mode
    n is proportional to tau_n V_0n^2. The heat that reaches the core passes all rings in series, so
    that a plunge has these poles and no zeros, and its lag is the sum of all tau.

    ``tests/sensors/test_sensor_in_place.py`` compares modes, shares and lag with separate code.
    """
    lag, biot, wall, core, gap = np.exp(theta)
    core = min(core, MAX_CORE)
    edges = np.geomspace(core, 1.0, RINGS + 1)
    nodes = np.r_[core, np.sqrt(edges[1:] * edges[:-1]), 1.0]
    resistance = np.append(np.diff(np.log(nodes)), 1 / biot)
    resistance[-2] += gap
    rings = edges[1:] ** 2 - edges[:-1] ** 2
    heat = np.r_[CORE_HEAT * core**2, rings, wall] / 2
    flow = 1 / resistance
    diagonal = (flow + np.append(0.0, flow[:-1])) / heat
    beside = -flow[:-1] / np.sqrt(heat[1:] * heat[:-1])
    rates, vectors = eigh_tridiagonal(diagonal, beside)
    taus = 1 / rates
    shares = (taus * vectors[0] ** 2)[:MODES]
    return lag * taus[:MODES] / taus.sum(), shares / shares.sum()


def _chain_of_lags(theta: Array) -> Chain:
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
    def from_rows(cls, dt_s: float, y: Array, power: Array) -> _HeatedRecord:
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
            The means of the rows that are not missing.
        """
        size = -(-len(y) // MAX_ROWS)
        n = len(y) // size * size
        mean = block_means(y, size)
        heating = power[:n].reshape(-1, size).mean(axis=1)
        noise_K = white_noise_K(mean)
        return cls(dt_s * size, mean, heating, np.linspace(0, 1, len(mean)), noise_K)

    def response(self, shape: Array) -> Array:
        """Return the response to the heating, one in the steady state.

        It is steady before the first row.

        Parameters
        ----------
        shape
            Logarithms as ``theta`` of :func:`cylinder_modes` (5,).

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

    def regressors(self, shape: Array) -> Array:
        """Return the regressors (N, 4) of level, drift, direct and size."""
        ones = np.ones_like(self.t)
        return np.stack([ones, self.t, self.power, self.response(shape)], axis=1)


def _posterior(record: _HeatedRecord) -> tuple[CurveFit, Array, Array]:
    """Sample the posterior of the shape.

    Parameters
    ----------
    record
        The data.

    Returns
    -------
    best
        The best fit.
    samples
        Log lag, Biot number, wall, heated radius and gap (K, 5).
    weights
        Weights of the samples (K,), of sum one.

    Notes
    -----
    Several starts are needed, since a thick boundary layer with a thin wall and the reverse may
    both be minima. The samples are proposed about all of them, with level, drift, direct and size
    profiled out. The seeds are fixed, so that the same data give the same file.
    """
    fits = _fit_from_all_starts(record)
    best = min(fits, key=lambda f: f.optimum.cost)
    density = _LogPosterior(record, best)
    near = [f for f in fits if f.optimum.cost < best.optimum.cost + MAX_EXCESS_COST]
    centres = np.array([f.optimum.theta[4:] for f in near])
    covariances = np.array([f.optimum.covariance[4:, 4:] for f in near])
    log_determinants = np.linalg.slogdet(covariances)[1]
    costs = np.array([f.optimum.cost for f in near])
    chances = softmax(-0.5 * costs + 0.5 * log_determinants)
    samples, weights = sample_density(density, _Mixture(centres, covariances, chances))
    return best, samples, weights


def sample_density(density: Callable[[Array], float], proposal: _Mixture) -> tuple[Array, Array]:
    """Sample a density by importance sampling, and where that fails by a Markov chain.

    Parameters
    ----------
    density
        Logarithm of the density at a point (D,), up to a constant.
    proposal
        The first proposal.

    Returns
    -------
    samples
        Samples (K, D).
    weights
        Their weights (K,), of sum one.

    Raises
    ------
    InputError
        Where the density is zero at all samples.

    Notes
    -----
    The samples of all proposals together are weighted by the mixture of these (Owen and Zhou 2000,
    J. Am. Stat. Assoc. 95, 135). A narrow, curved density leaves all weight on a few samples; there
    the walkers of the chain start at samples that are chosen with tempered weights.
    ``tests/sensors/test_sensor_in_place.py`` samples a curved density.
    """
    proposals = list[_Mixture]()
    samples = np.empty((0, proposal.centres.shape[1]))
    log_p = np.empty(0)
    weights = np.empty(0)
    tempered = np.empty(0)
    for seed in range(MAX_PROPOSALS):
        proposals.append(proposal)
        new = proposal.sample(np.random.default_rng(seed))
        samples = np.concatenate([samples, new])
        log_p = np.r_[log_p, [density(shape) for shape in new]]
        log_q = logsumexp([p.log_density(samples) for p in proposals], axis=0)
        if not np.isfinite(log_p).any():
            raise InputError(
                "the reading does not determine the lag: no sensor responds to this current as "
                "it does",
                expected="the reading and the current of a sensor that was heated by a step",
                remedy="check the column of the current for single wrong values",
            )
        weights = softmax(log_p - log_q)
        if _effective_size(weights) > ENOUGH_SAMPLES:
            break
        # too few effective samples: propose from the weighted mean and covariance
        tempered = _tempered_weights(log_p - log_q)
        scatter: Array = np.asarray(np.cov(samples.T, ddof=0, aweights=tempered), dtype=np.float64)
        covariance = scatter + 1e-6 * np.eye(samples.shape[1])
        mean = tempered @ samples
        proposal = _Mixture(mean[None], covariance[None], np.ones(1))
    if _effective_size(weights) >= MIN_EFFECTIVE_SAMPLES:
        return samples, weights
    rng = np.random.default_rng(MAX_PROPOSALS)
    possible = np.where(np.isfinite(log_p), tempered, 0.0)
    walkers = rng.choice(samples, WALKERS, p=possible / possible.sum())
    chain = _walk(density, walkers, rng)
    return chain, np.full(len(chain), 1 / len(chain))


def _walk(density: Callable[[Array], float], walkers: Array, rng: np.random.Generator) -> Array:
    """Sample a density by an ensemble of walkers.

    Parameters
    ----------
    density
        Logarithm of the density at a point (D,), up to a constant.
    walkers
        Starts (W, D).
    rng
        Random numbers.

    Returns
    -------
    array
        Samples (K, D) after the first fifth of the steps.

    Notes
    -----
    Stretch moves of half of the walkers along lines to the other half, which do not depend on the
    scales of the density (Goodman and Weare 2010, Comm. App. Math. Comp. Sci. 5, 65); the factor z
    has a density proportional to 1/sqrt(z) from 1/2 to 2.
    """
    walkers = walkers.copy()
    count, size = walkers.shape
    log_p = np.array([density(point) for point in walkers])
    halves = (np.arange(0, count, 2), np.arange(1, count, 2))
    kept = []
    for step in range(WALK_STEPS):
        for half, others in (halves, halves[::-1]):
            root = rng.uniform(np.sqrt(0.5), np.sqrt(2.0), len(half))
            z = root**2
            centres = walkers[rng.choice(others, len(half))]
            trial = centres + z[:, None] * (walkers[half] - centres)
            trial_log_p = np.array([density(point) for point in trial])
            gain = (size - 1) * np.log(z) + trial_log_p - log_p[half]
            accepted = np.log(rng.random(len(half))) < gain
            walkers[half[accepted]] = trial[accepted]
            log_p[half[accepted]] = trial_log_p[accepted]
        if step >= WALK_STEPS // 5:
            kept.append(walkers.copy())
    return np.concatenate(kept)


def _effective_size(weights: Array) -> float:
    """Return the effective number of samples with weights (K,) of sum one (Kish 1965)."""
    return float(1 / np.sum(weights**2))


def _tempered_weights(log_weights: Array) -> Array:
    """Return weights of which at least ``MIN_EFFECTIVE_SAMPLES`` count.

    Parameters
    ----------
    log_weights
        Logarithms of the weights of importance sampling (K,).

    Returns
    -------
    array
        The weights (K,), of sum one, to the largest power up to one that leaves so many.

    Notes
    -----
    Where nearly all weight is on one sample, its covariance is zero, and the next proposal would
    be a point. A power below one widens it (tempering: Neal 2001, Stat. Comput. 11, 125).
    """
    lowest = 0.0
    highest = 1.0
    if _effective_size(softmax(log_weights)) >= MIN_EFFECTIVE_SAMPLES:
        return np.asarray(softmax(log_weights))
    possible = np.maximum(log_weights, np.max(log_weights) - LEAST_LOG_WEIGHT)
    for _ in range(BISECTIONS):
        power = 0.5 * (lowest + highest)
        if _effective_size(softmax(power * possible)) >= MIN_EFFECTIVE_SAMPLES:
            lowest = power
        else:
            highest = power
    return np.asarray(softmax(lowest * possible))


def _fit_from_all_starts(record: _HeatedRecord) -> list[CurveFit]:
    """Fit the record from all ``STARTS`` with white noise, then again with the residuals' noise.

    The second fits start at the optima of the first. Their noise is that of the residuals of the
    best of these.
    """
    finite = np.isfinite(record.y)
    y = record.y[finite]
    names = [*LINEAR, "log_lag", *PRIORS]
    range_K = max(float(np.ptp(y)), 1e-9)
    scale = np.array([range_K] * 4 + [0.5] * (1 + len(PRIORS)))
    duration_s = len(record.y) * record.dt_s

    def model(theta: Array) -> Array | None:
        """Return the readings of the model (N,), or None beyond ``MAX_LOG``."""
        if not np.all(np.abs(theta[4:]) <= MAX_LOG):
            return None
        return record.regressors(theta[4:]) @ theta[:4]

    def start(biot: float, wall: float, heated: float, gap: float) -> Array:
        """Best of ten lags, with level, drift, direct and size by linear least squares.

        Parameters
        ----------
        biot, wall, heated, gap
            Biot number, wall, heated radius and gap of the start.

        Returns
        -------
        array
            Start (9,) of all parameters.
        """
        candidates = []
        for lag in np.geomspace(3 * record.dt_s, duration_s / 3, 10):
            shape = np.log([lag, biot, wall, heated, gap])
            table = record.regressors(shape)[finite]
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
    """Log posterior density of the shape (5,), profiled over level, drift, direct and size."""

    def __init__(self, record: _HeatedRecord, fit: CurveFit) -> None:
        """Prepare the posterior of a record, with the noise of a fit."""
        self.record = record
        self.finite = np.isfinite(record.y)
        self.fit = fit
        self.full = [slice(0, int(self.finite.sum()))]
        self.white_y = self._whiten(record.y[self.finite])

    def __call__(self, shape: Array) -> float:
        """Return the log density at a shape, up to a constant."""
        if not np.all(np.abs(shape) <= MAX_LOG):
            return -np.inf
        table = self._whiten(self.record.regressors(shape)[self.finite])
        linear = np.linalg.lstsq(table, self.white_y, rcond=None)[0]
        deviations = [(v - mean) / sd for v, (mean, sd) in zip(shape[1:], PRIORS.values())]
        square_sum = np.sum((self.white_y - table @ linear) ** 2)
        return -0.5 * float(square_sum + np.sum(np.square(deviations)))

    def _whiten(self, values: Array) -> Array:
        """Return values (N,) or (N, 4) whitened by the noise of the fit."""
        return self.fit.colour.whiten(values, self.full) / self.fit.noise_K


@dataclass(frozen=True)
class _Mixture:
    """Mixture of multivariate Student's t with C components in D dimensions.

    Attributes
    ----------
    centres
        Centres (C, D).
    covariances
        Scale matrices (C, D, D).
    chances
        Probabilities of the components (C,).
    """

    centres: Array
    covariances: Array
    chances: Array

    def sample(self, rng: np.random.Generator) -> Array:
        """Draw ``SAMPLES`` samples (SAMPLES, D) from the mixture of Student's t distributions."""
        component = rng.choice(len(self.centres), SAMPLES, p=self.chances)
        tails = np.sqrt(PROPOSAL_DOF / rng.chisquare(PROPOSAL_DOF, (SAMPLES, 1)))
        roots = np.linalg.cholesky(self.covariances)[component]
        normal = np.einsum(
            "kij,kj->ki", roots, rng.standard_normal((SAMPLES, self.centres.shape[1]))
        )
        return self.centres[component] + normal * tails

    def log_density(self, x: Array) -> Array:
        """Return the log density (K,) at ``x`` (K, D)."""
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
        raise undetermined_lag_error()
    return Estimate(value=mean, u=sd, low95=float(low), high95=float(high))
