"""Loop current step response (LCSR): heat made in the sensor by a current, converted to the response to a plunge.

Heating inside and a step outside share the poles of the sensor; inside, zeros stand beside them (Kerlin, Hashemian), so
how much each pole counts for the plunge is told by a model of where heat is made and stored: a round core, heated about
its axis and read there, a wall of metal round it, a film outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # scipy.signal and scipy.stats with their first use: they are slow to import
from scipy.special import j0, j1, jn_zeros, logsumexp, softmax

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import Noise
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.sensors.file import SHARES, SensorFile, passes, sensor_file, undetermined
from tcdyn.sensors.step_fits import Fitted, colour_of, fit_curve

MODES = 14
# what is known of sheathed sensors: Biot number of the film, heat stored in the wall over the core's, radius that is
# heated over the core's; medians and standard deviations of the logarithm
KNOWN = {
    "log_biot": (np.log(2.0), 1.5),
    "log_wall": (np.log(0.5), 0.8),
    "log_heated": (np.log(0.15), 0.7),
}
STARTS = [
    (biot, wall, heated) for biot in (0.6, 2.5, 9.0) for wall, heated in ((0.3, 0.1), (1.0, 0.25))
]
CONVERSION_REL = (
    0.05  # of the lag, 1 sd: of a sensor that is no such cylinder (plants report 10 % at 95 %)
)
WIDE = (
    20.0  # percent, 95 %: beyond, the answer to the current does not tell the plunge, which is said
)
ROWS = 4000  # that are fitted: means of neighbours, where there are more
# of the posterior; of them for t50 to t90; of the t they are proposed by
DRAWS = 400
TIMES_OF = 60
DEGREES = 5.0
LINEAR = ("level", "drift", "direct", "size")
EDGES = np.r_[0.0, jn_zeros(0, MODES)]


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
    """The chain of a plunge from the sensor's answer to a current through it, switched on, off, or both.

    y = level + drift t + direct P + size sum_n a_n (P behind a lag tau_n), P = current^2 over its largest, a_n and
    tau_n those of ``cylinder``. Its lag, Biot number, wall and heated radius are sampled from their posterior, so that
    an interval is as wide, and as skew, as what the answer to the current leaves open.

    Args:
        time_s: (N,) even times [s].
        y_degC: (N,) readings [degC], NaN where missing.
        current: (N,) the current, any unit; heating goes as its square.
        column: the sensor's column.
        off_only: only rows without current are read (a thermocouple cannot be read while it is heated).

    Raises:
        InputError: a current that never changes, an answer within the noise, a record too short after the step.
    """
    power = np.nan_to_num(current) ** 2
    top = float(power.max())
    if top <= 0 or np.ptp(power) < 0.3 * top:
        raise InputError(
            "the current does not switch",
            expected="one that is switched on or off within the record",
        )
    power = power / top
    y = np.where(power > 0.5, np.nan, y_degC) if off_only else y_degC
    if (count := int(np.isfinite(y).sum())) < 40:
        raise InputError(f"only {count} readings", expected="at least 40")
    told = _Heated.of(float(time_s[1] - time_s[0]), y, power)
    span = float(np.nanmax(told.y) - np.nanmin(told.y))
    noise = told.noise_K
    if span < 10 * noise:
        raise InputError(
            f"the answer of {span:.2g} K is within ten times the noise",
            remedy="heat more, or average",
        )
    best, theta, weights = _posterior(told)
    model = np.exp(
        CONVERSION_REL * np.random.default_rng(1).standard_normal(len(theta))
    )  # moves all times alike
    lag = _of(np.exp(theta[:, 0]) * model, weights)
    some = np.random.default_rng(2).choice(len(theta), TIMES_OF, p=weights)
    times = np.array([passes(_chain(theta[k])) * model[k] for k in some])
    taus = _chain(weights @ theta).taus_s
    chain = Chain([tau * lag.value / sum(taus) for tau in taus])
    switches = np.flatnonzero(np.diff(power > 0.5))
    longest = float(np.diff(np.r_[switches, len(power) - 1]).max() * (time_s[1] - time_s[0]))
    found: list[Finding] = []
    if longest < 4 * lag.value:
        found.append(warning("sensor.cut_off", subject=column, after_s=longest, lag_s=lag.value))
    found += best.doubts(column, noise, 0.01 * span)
    percent = 50 * (lag.high95 - lag.low95) / lag.value
    if percent > WIDE:
        found.append(
            warning("sensor.conversion_wide", subject=column, low_s=lag.low95, high_s=lag.high95)
        )
    else:
        found.append(info("sensor.conversion", subject=column, percent=percent))
    shape = {
        k.removeprefix("log_"): _of(np.exp(v), weights).model_dump()
        for k, v in zip(KNOWN, theta.T[1:])
    }
    fit = {
        "modes_s": cylinder(weights @ theta)[0][:3].tolist(),
        "noise_K": best.noise_K,
        "lag_s": lag.model_dump(),
        "heating_K": span,
        "switches": len(switches),
        "model_u_s": CONVERSION_REL * lag.value,
        **shape,
    }
    return sensor_file(
        sensor,
        {column: chain},
        "current",
        np.array([[lag.u**2]]),
        [lag.value - chain.taus_s[0]],
        times={
            column: dict(zip(SHARES, (_of(t, np.full(TIMES_OF, 1 / TIMES_OF)) for t in times.T)))
        },
        fit=fit,
        findings=found,
        **more,
    )


def cylinder(theta: Array) -> tuple[Array, Array]:
    """Time constants (MODES,) [s] and shares (MODES,) of the answer on the axis to heat made about it.

    theta = logarithms of lag [s], Bi = h R/k, wall g and heated radius e (of R). z J1(z) = (Bi - g z^2/2) J0(z),
    tau = R^2/(a z^2), share ~ tau J1(z e)/(z e)/(J0(z)^2 + J1(z)^2 + g J0(z)^2). A plunge has the poles alone,
    T/T_fluid = 1/(I0(q) + (q/Bi) I1(q) + (g q^2/(2 Bi)) I0(q)), q^2 = s R^2/a, so lag = R^2/a (1/4 + (1 + g)/(2 Bi)).

    >>> tau, _ = cylinder(np.log([0.25, 1e6, 1e-6, 0.1]))  # a bare one whose surface is held: z are the zeros of J0
    >>> (tau * jn_zeros(0, MODES) ** 2).round(3).tolist() == [1.0] * MODES
    True
    """
    lag, biot, wall, heated = np.exp(theta)
    low = EDGES[:-1] + 1e-12
    high = EDGES[1:]

    def miss(z: Array) -> Array:
        return z * j1(z) - (biot - 0.5 * wall * z**2) * j0(z)

    begun = np.sign(miss(low))  # one root between neighbouring zeros of J0
    for _ in range(48):
        middle = 0.5 * (low + high)
        before = np.sign(miss(middle)) == begun
        low = np.where(before, middle, low)
        high = np.where(before, high, middle)
    z = 0.5 * (low + high)
    share = j1(z * heated) / (z * heated) / ((1 + wall) * j0(z) ** 2 + j1(z) ** 2) / z**2
    return lag / (0.25 + 0.5 * (1 + wall) / biot) / z**2, share / share.sum()


def _chain(theta: Array) -> Chain:
    """The plunge: the two largest lags, and what all others add as one."""
    first, second = cylinder(theta)[0][:2]
    return Chain(
        sorted([first, second, max(float(np.exp(theta[0])) - first - second, 0.0)], reverse=True)
    )


@dataclass(frozen=True)
class _Heated:
    """What is fitted: interval [s], readings (N,), heating (N,), times (N,) from 0 to 1, a first guess of noise [K]."""

    dt_s: float
    y: Array
    power: Array
    t: Array
    noise_K: float

    @classmethod
    def of(cls, dt_s: float, y: Array, power: Array) -> _Heated:
        """Means of as many neighbours as leave ``ROWS``."""
        every = -(-len(y) // ROWS)
        n = len(y) // every * every
        blocks = y[:n].reshape(-1, every)
        heat = power[:n].reshape(-1, every).mean(axis=1)
        seen = np.isfinite(blocks).all(axis=1)
        mean = np.where(seen, np.nan_to_num(blocks).mean(axis=1), np.nan)
        noise = max(float(white_noise_sd(mean[seen], 3)), 1e-9)
        return cls(dt_s * every, mean, heat, np.linspace(0, 1, len(mean)), noise)

    def risen(self, shape: Array) -> Array:
        """The answer (N,) to the heating, one where it stays on; before the first row heating was as then."""
        total = np.zeros_like(self.power)
        for tau, share in zip(*cylinder(shape)):
            keep = float(np.exp(-self.dt_s / tau))
            first = self.power[0]
            total += (
                share
                * scipy.signal.lfilter([0.0, 1 - keep], [1.0, -keep], self.power, zi=[first])[0]
            )
        return total

    def table(self, shape: Array) -> Array:
        """What level, drift, direct and size multiply (N, 4)."""
        return np.stack([np.ones_like(self.t), self.t, self.power, self.risen(shape)], axis=1)


def _posterior(told: _Heated) -> tuple[Fitted, Array, Array]:
    """The best fit, draws (K, 4) of logarithms of lag, Bi, wall and heated radius, and their weights (K,).

    Fits from several starts, since a thick film with a thin wall and the reverse may both be minima; then importance
    sampling about all of them, level, drift, direct and size integrated out.
    """
    ok = np.isfinite(told.y)
    y, big = told.y[ok], max(float(np.ptp(told.y[ok])), 1e-9)
    names = [*LINEAR, "log_lag", *KNOWN]
    scale = np.array([big] * 4 + [0.5] * 4)
    span = len(told.y) * told.dt_s

    def model(theta: Array) -> Array | None:
        return (
            None
            if np.any(np.abs(theta[4:]) > 25)
            else np.asarray(told.table(theta[4:]) @ theta[:4])
        )

    def begun(biot: float, wall: float, heated: float) -> Array:
        tried = []
        for lag in np.geomspace(3 * told.dt_s, span / 3, 10):
            shape = np.log([lag, biot, wall, heated])
            table = told.table(shape)[ok]
            linear = np.linalg.lstsq(table, y, rcond=None)[0]
            tried.append((float(np.sum((table @ linear - y) ** 2)), np.r_[linear, shape]))
        return min(tried, key=lambda pair: pair[0])[1]

    starts = [begun(*start) for start in STARTS]
    noise = (Noise(), told.noise_K)
    for turn in range(2):  # noise is what the best of them leaves
        fits = [
            fit_curve("LCSR", model, told.y, names, s, scale, prior=KNOWN, noise=noise)
            for s in starts
        ]
        best = min(fits, key=lambda f: f.optimum.cost)
        if turn == 0:
            noise = colour_of(best.residual, len(names))
            starts = [f.optimum.theta for f in fits]
    whole = [slice(0, len(y))]
    (colour, noise_K) = noise
    white_y = colour.whiten(y, whole) / noise_K

    def log_posterior(shape: Array) -> float:
        if np.any(np.abs(shape) > 25):
            return -np.inf
        table = colour.whiten(told.table(shape)[ok], whole) / noise_K
        linear = np.linalg.lstsq(table, white_y, rcond=None)[0]
        pulls = [(v - mean) / sd for v, (mean, sd) in zip(shape[1:], KNOWN.values())]
        return -0.5 * float(np.sum((white_y - table @ linear) ** 2) + np.sum(np.square(pulls)))

    kept = [f for f in fits if f.optimum.cost < best.optimum.cost + 20]
    centres = np.array([f.optimum.theta[4:] for f in kept])
    spreads = np.array([f.optimum.covariance[4:, 4:] for f in kept])
    height = np.array(
        [-0.5 * f.optimum.cost + 0.5 * np.linalg.slogdet(c)[1] for f, c in zip(kept, spreads)]
    )
    by = _Mixture(centres, spreads, softmax(height))
    used = list[_Mixture]()
    draws = np.empty((0, 4))
    log_p = np.empty(0)
    for turn in range(3):
        used.append(by)
        more = by.drawn(np.random.default_rng(turn))
        draws = np.concatenate([draws, more])
        log_p = np.r_[log_p, [log_posterior(shape) for shape in more]]
        weights = softmax(log_p - logsumexp([one.log_density(draws) for one in used], axis=0))
        if 1 / np.sum(weights**2) > DRAWS / 4:
            break
        spread = np.cov(draws.T, ddof=0, aweights=weights) + 1e-6 * np.eye(4)
        by = _Mixture(
            (weights @ draws)[None], spread[None], np.ones(1)
        )  # too few count: anew by what they say
    return best, draws, weights


@dataclass(frozen=True)
class _Mixture:
    """Of Student's t about ``centres`` (C, 4) with ``spreads`` (C, 4, 4), each by its ``chances`` (C,)."""

    centres: Array
    spreads: Array
    chances: Array

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draws (DRAWS, 4)."""
        which = rng.choice(len(self.centres), DRAWS, p=self.chances)
        tails = np.sqrt(DEGREES / rng.chisquare(DEGREES, (DRAWS, 1)))
        roots = np.linalg.cholesky(self.spreads)[which]
        return (
            self.centres[which]
            + np.einsum("kij,kj->ki", roots, rng.standard_normal((DRAWS, 4))) * tails
        )

    def log_density(self, x: Array) -> Array:
        """At ``x`` (K, 4), (K,)."""
        each = [
            scipy.stats.multivariate_t.logpdf(x, *one, DEGREES)
            for one in zip(self.centres, self.spreads)
        ]
        return logsumexp(each, axis=0, b=self.chances[:, None])


def _of(values: Array, weights: Array) -> Estimate:
    """Mean, standard deviation and 95 % range of weighted draws (K,)."""
    mean = float(weights @ values)
    order = np.argsort(values)
    low, high = np.interp(
        [0.025, 0.975], np.cumsum(weights[order]) - 0.5 * weights[order], values[order]
    )
    sd = float(np.sqrt(weights @ (values - mean) ** 2))
    if not 0 < sd < np.inf:  # all weight on one draw
        raise undetermined()
    return Estimate(value=mean, u=sd, low95=float(low), high95=float(high))
