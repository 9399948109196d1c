"""Loop current step response (LCSR): heat made in the sensor by a current, converted to the response to a plunge.

Heating inside and a step outside share the poles of the sensor; inside, zeros stand beside them. For a sensor whose
heat flows radially, and is read where no heat is stored farther in, the plunge has the poles alone (Kerlin, Hashemian):
its lag is the sum of all modes' time constants, of which a record tells the first two.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.special import j0, j1, jn_zeros

from calibration import Array
from calibration.errors import InputError
from calibration.finding import Finding, look, note
from calibration.noise import white_noise_sd
from tcdyn.chain import Chain
from tcdyn.fitting import Noise
from tcdyn.sensor.file import SHARES, SensorFile, passes, sensor_file
from tcdyn.sensor.fits import Fitted, averaged, colour_of, fit_curve, weights_of

CONVERSION_REL = 0.05  # of the lag, 1 sd: of a sensor that is no homogeneous cylinder (plants report 10 % at 95 %)
TAIL_REL = 0.4  # of the second mode and those that the record does not tell, 1 sd
ALONE = (0.15, 0.12)  # the same over the first mode where no second is told: between a slender film and none
RESOLVED = 0.35  # standard uncertainty of the logarithm of the first two time constants
COARSE = 1500  # rows for the first guesses


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

    y = level + drift t + direct P + sum_i a_i (P behind a lag tau_i), P = current^2 over its largest, one to three
    lags; then lag = sum tau_i + tail, the tail as of a homogeneous cylinder whose second mode is as far from the first.

    Args:
        time_s: (N,) even times [s].
        y_degC: (N,) readings [degC], NaN where missing.
        current: (N,) the current, any unit; heating goes as its square.
        column: the sensor's column.
        off_only: only rows without current are read (a thermocouple cannot be read while it is heated).

    Raises:
        InputError: a current that never changes, an answer within the noise, a record too short after the step.
    """
    dt = float(time_s[1] - time_s[0])
    power = np.nan_to_num(current) ** 2
    top = float(power.max())
    if top <= 0 or np.ptp(power) < 0.3 * top:
        raise InputError("the current does not switch", expected="one that is switched on or off within the record")
    power = power / top
    on = power > 0.5
    y = np.where(on, np.nan, y_degC) if off_only else y_degC
    seen = np.isfinite(y)
    if seen.sum() < 40:
        raise InputError(f"only {int(seen.sum())} readings", expected="at least 40")
    noise = max(float(white_noise_sd(y[seen], 3)), 1e-9)
    t = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    switches = np.flatnonzero(np.diff(on.astype(int)))
    told = (Noise(), noise)
    for turn in range(3):  # noise is what the best of them leaves: white as long as it is
        fits = [f for f in (_fitted(k, t, y, power, dt, told) for k in (1, 2, 3, 4)) if f is not None]
        if not fits:
            raise InputError("no time constant is told by the answer", remedy="log longer, or heat more")
        weights = weights_of(fits)
        best = fits[int(np.argmax(weights))]
        left = colour_of(best.residual, len(best.optimum.theta))
        if turn == 2 or (left[0].white and told[0].white and 0.8 < left[1] / told[1] < 1.25):
            break
        told = left
    rows = [(f, *f.of(_quantities)) for f in fits]
    model_u = [CONVERSION_REL * r[1][0] for r in rows]
    tails = [_tail_u(f.optimum.theta) for f in fits]
    every = []
    for i in range(4):
        # the model's own doubt moves the lag and the percent times alike
        u = [
            float(np.sqrt(max(r[2][i, i], 0.0) + m**2 * (r[1][i] / r[1][0]) ** 2 + tail**2))
            for r, m, tail in zip(rows, model_u, tails)
        ]
        every.append(averaged([r[1][i] for r in rows], u, weights))
    lag, *times = every
    taus = modes(best.optimum.theta)[:2]
    chain = Chain([*taus, lag.value - sum(taus)] if lag.value > sum(taus) else taus)
    span = float(np.nanmax(y) - np.nanmin(y))
    if span < 10 * noise:
        raise InputError(f"the answer of {span:.2g} K is within ten times the noise", remedy="heat more, or average")
    after = (len(time_s) - 1 - switches[-1]) * dt if len(switches) else 0.0
    found: list[Finding] = []
    if max(after, float(np.diff(np.r_[0, switches, len(time_s) - 1]).max() * dt)) < 4 * lag.value:
        found.append(look("sensor.cut_off", subject=column, after_s=after, lag_s=lag.value))
    if len(taus) == 1:
        found.append(look("sensor.one_mode", subject=column))
    if not best.colour.white:
        found.append(note("sensor.coloured", subject=column))
    rest = float(np.sqrt(np.mean(best.residual**2)))
    if rest > 3 * noise and rest > 0.01 * span:
        found.append(look("sensor.misfit", subject=column, rms_K=rest, noise_K=noise))
    found.append(note("sensor.conversion", subject=column, percent=100 * 1.96 * lag.u / lag.value))
    fit = {
        "modes_s": modes(best.optimum.theta), "noise_K": best.noise_K, "lag_s": lag.model_dump(), "heating_K": span,
        "switches": len(switches),
        "model_u_s": float(np.hypot(CONVERSION_REL * lag.value, tails[int(np.argmax(weights))])),
    }  # fmt: skip
    return sensor_file(
        sensor, {column: chain}, "current", np.array([[lag.u**2]]), [min(0.5 * (lag.value - taus[0]), lag.value)],
        times={column: dict(zip(SHARES, times))}, fit=fit, findings=found, **more,
    )  # fmt: skip


def modes(theta: Array) -> list[float]:
    """Time constants of a theta, largest first: level, drift, direct, then sizes, then logarithms of them."""
    count = (len(theta) - 3) // 2
    return sorted(np.exp(theta[3 + count :]).tolist(), reverse=True)


def tail_s(taus: Sequence[float]) -> float:
    """Sum of the time constants of a homogeneous cylinder's further modes, whose first ones are ``taus`` [s].

    1/(I0(q) + (q/Bi) I1(q)), q^2 = s R^2/a, has the modes tau_n = R^2/(a z_n^2), z J1(z) = Bi J0(z); they add to
    R^2/a (1/4 + 1/(2 Bi)). Bi is that for which tau_2/tau_1 is as found.

    >>> z = jn_zeros(0, 3)
    >>> round(float(tail_s((1 / z[:2] ** 2).tolist()) / (0.25 - sum(1 / z[:2] ** 2))), 3)
    1.0
    """
    if len(taus) < 2:
        return ALONE[0] * taus[0]
    taus = taus[:2]  # what looks like a third mode stands for all that follow
    roots = _roots(round(float(np.log(np.clip(taus[1] / taus[0], 1e-4, 0.5))), 2))
    bi = float(roots[0] * j1(roots[0]) / max(j0(roots[0]), 1e-6))
    whole = 0.25 + 0.5 / bi
    share = (whole - float(np.sum(roots[: len(taus)] ** -2.0))) / float(roots[len(taus) - 1] ** -2.0)
    return max(share, 0.0) * taus[-1]


@lru_cache(maxsize=256)
def _roots(log_ratio: float) -> Array:
    """The first four z_n of the cylinder whose (z_1/z_2)^2 has this logarithm; of a bare one where none has."""

    def at(log_bi: float) -> Array:
        bi, edges = np.exp(log_bi), np.r_[0.0, jn_zeros(1, 4)]
        tops = jn_zeros(0, 4)
        return np.array([brentq(lambda z: z * j1(z) - bi * j0(z), a + 1e-12, b) for a, b in zip(edges, tops)])

    def miss(log_bi: float) -> float:
        z = at(log_bi)
        return float(2 * np.log(z[0] / z[1]) - log_ratio)

    low, high = np.log(1e-4), np.log(1e4)
    if miss(high) < 0:
        return at(high)
    return at(float(brentq(miss, low, high)))


def _tail_u(theta: Array) -> float:
    taus = modes(theta)
    return ALONE[1] * taus[0] if len(taus) == 1 else TAIL_REL * (taus[1] + tail_s(taus))


def _quantities(theta: Array) -> Array:
    """Lag of the plunge and its t50, t63.2, t90 (4,) [s]."""
    taus = modes(theta)
    chain = Chain([*taus[:2], tail_s(taus)])
    return np.array([chain.lag_s, *passes(chain)])


def _behind(power: Array, tau_s: float, dt_s: float) -> Array:
    """The heating (N,) behind one lag; held between rows, and before the first as it was then."""
    keep = float(np.exp(-dt_s / tau_s))
    return np.asarray(lfilter([0.0, 1 - keep], [1.0, -keep], power, zi=[keep * power[0] + (1 - keep) * power[0]])[0])


def _fitted(
    count: int, t: Array, y: Array, power: Array, dt: float, noise: tuple[Noise, float]
) -> Fitted | None:  # fmt: skip
    """``count`` modes fitted; None where one of them is not told from none."""
    ok = np.isfinite(y)
    span = len(y) * dt
    every = max(len(y) // COARSE, 1)
    grid = np.geomspace(max(3 * dt, span / 3000), span / 2, 14)
    columns = [_behind(power, tau, dt) for tau in grid]
    rows = np.flatnonzero(ok)[::every]
    base = np.stack([np.ones_like(t), t, power], axis=1)[rows]
    best, start = np.inf, np.zeros(3 + 2 * count)
    for chosen in combinations(range(len(grid)), count):
        table = np.column_stack([base, *(columns[k][rows] for k in chosen)])
        linear, *_ = np.linalg.lstsq(table, y[rows], rcond=None)
        cost = float(np.sum((table @ linear - y[rows]) ** 2))
        if cost < best:
            best, start = cost, np.r_[linear, np.log(grid[list(chosen)])]
    big = max(float(np.nanmax(y) - np.nanmin(y)), 1e-9)

    def model(theta: Array) -> Array | None:
        logs = theta[3 + count :]
        if np.any(np.abs(logs) > 20):
            return None
        sizes = theta[3 : 3 + count]
        lagged = sum(a * _behind(power, float(np.exp(g)), dt) for a, g in zip(sizes, logs))
        return np.asarray(theta[0] + theta[1] * t + theta[2] * power + lagged)

    names = [
        "level",
        "drift",
        "direct",
        *(f"a{k + 1}" for k in range(count)),
        *(f"log_tau{k + 1}" for k in range(count)),
    ]
    scale = np.array([big, big, big, *[big] * count, *[0.5] * count])
    try:
        found = fit_curve(f"{count} modes", model, y, names, start, scale, noise=noise)
    except InputError:
        return None
    slowest = 3 + count + np.argsort(found.optimum.theta[3 + count :])[::-1][:2]
    return found if np.all(np.diag(found.covariance)[slowest] < RESOLVED**2) else None
