"""The cooling fit: with the power gone, h is the one unknown of a disk on its steady line (sections 4.4 and 7.5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.heat.rim import Profile
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import StartPoints, disk_fit
from tcdyn.partition.nuisance import NuisanceEffects, nuisance_effects
from tcdyn.partition.steady import (
    LAST_S,
    MAX_COOLING_S,
    N_ITERATIONS,
    SURFACE_DEPTH_M,
    DiskLine,
    FitSensitivity,
    SpeedLawPoint,
    SteadyLine,
    surface_degC,
)
from tcdyn.partition.surface_flux import constant_speed_air_offset
from tcdyn.partition.window import DiskWindow, disk_window, lagged_window, stretch_of
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import smooth
from tcdyn.smoothing.traces import DiskTraces

H_RANGE_W_M2K = (5.0, 8000.0)
MATCH_S = 10.0  # the model is matched to the readings over this long before parting
LAG_STEP_S = 0.01
MIN_SPEED_RATIO = 0.01  # of that under load


def require_window_longer_than_lag(test: EhlTest, window_s: float) -> None:
    """Raise InputError for a cooling window that holds less than the lag of a disk."""
    if window_s < (lag := max(d.common_lag_s for d in test.disks.values())):
        raise InputError(
            f"the cooling window of {window_s:g} s is shorter than the lag of {lag:.2f} s",
            expected=f"at least {lag:.2f} s",
            remedy="ask for a longer window",
        )


def with_slowing_air_offset(test: EhlTest, at: Mapping[str, tuple[float, float]]) -> EhlTest:
    """The test with ``film`` set for the disks that did not keep their speed after the parting.

    The film's loss there is h (u/u_0)^n (T_s - T_A): that of the film under load with air at the running surface alone
    that is ((u/u_0)^n - 1)(T_s - T_A) colder. T_s is the mean temperature of the running surface by the model itself at
    the share and h [W/m2K] ``at`` of each disk, so air and surface are found in turn. The second column is what a
    standard uncertainty of n, even over its range, changes in it. A test whose speeds stay is left as it is.
    """
    if not test.slowing:
        return test
    rows = stretch_of(test, min(MAX_COOLING_S, float(test.time_s[-1] - test.events.unload_s)))
    for _ in range(N_ITERATIONS):
        film = {
            d: _film(test, test.disks[d], rows, *at[d]) for d in test.slowing if d in test.disks
        }
        test = replace(test, film={**test.film, **film})
    return test


def _film(test: EhlTest, disk: DiskTraces, rows: slice, share: float, h_W_m2K: float) -> Array:
    window = lagged_window(test, disk, rows)
    u = np.maximum(test.slowing[disk.name], MIN_SPEED_RATIO)
    known = constant_speed_air_offset(test, disk)
    warmer = (
        surface_degC(window, share, h_W_m2K)
        - window.rim.inputs[:, window.rim.ambient]
        - window.blocks @ known[rows, 0]
    )
    superheat = np.interp(test.time_s + disk.mean_chain.lag_s, window.at_s, warmer)
    film = u**test.speed_exponent
    sd = test.exponent_half_range / np.sqrt(3)
    return known + np.column_stack([(1 - film) * superheat, -sd * film * np.log(u) * superheat])


@dataclass(frozen=True)
class CompensatedDisk:
    """One disk's traces over some rows of a test with their lag removed, and the window of what was compensated.

    ``late``: that window had ``LAG_STEP_S`` more lag been removed; ``noise_K``: standard deviation of what compensation
    left in a trace of the outer row.
    """

    test: EhlTest
    disk: DiskTraces
    done: Compensated
    window: DiskWindow
    late: DiskWindow
    noise_K: float

    @property
    def shown(self) -> Compensated:
        """What was compensated, empty where a channel is left out."""
        own = np.where(self.disk.out, np.nan, 0.0)
        return replace(self.done, temperature=self.done.temperature + own, sd=self.done.sd + own)


@dataclass(frozen=True)
class CoolingFit:
    """h [W/m2K] and share of one disk from its cooling; ``misfit_K`` is the rms over the window.

    ``by_effect`` (R, P): change of the fitted h by what the model's prediction of each mean changes by [W/m2K per K];
    ``power`` (R, P): the model's answer to a share of one; ``h_noise``: standard uncertainty of h from the compensated
    traces' noise alone.
    """

    disk: str
    h_W_m2K: float
    share: float
    beta: float
    window_s: float
    misfit_K: float
    by_effect: Array
    power: Array
    h_noise: float


@dataclass(frozen=True)
class CoolingSensitivity(FitSensitivity):
    """Errors of (share, h); ``by_lag`` (2,): the same per second by which the compensated lag is too long."""

    by_lag: Array


def with_common_u(covariance_s2: Array, common_u_s: float) -> Array:
    """Covariance (M, M) of lags whose differences are known as ``covariance_s2`` says and their mean to ``common_u_s``.

    >>> with_common_u(np.full((2, 2), 0.25), 0.1).round(4)
    array([[0.01, 0.01],
           [0.01, 0.01]])
    """
    centre = np.eye(len(covariance_s2)) - 1.0 / len(covariance_s2)
    return np.asarray(centre @ covariance_s2 @ centre.T + common_u_s**2)


@dataclass(frozen=True)
class Alone:
    """What a disk's joint fit says of itself: its ``chain``, and ``estimates`` of beta, h [W/m2K] and lag_s."""

    chain: Chain
    estimates: Mapping[str, Estimate]


def single_disk_fits(
    test: EhlTest, start: StartPoints, window_s: float, profile: Profile = "modal"
) -> dict[str, Alone]:
    """Joint fit of each disk that has a ``start``, independent of the other disk."""
    alone = {}
    for disk, values in start.items():
        fit = disk_fit(test, test.disks[disk], *values, window_s, profile)
        alone[disk] = Alone(fit.chain, fit.estimates)
    return alone


def refined_chains(chains: Sequence[Chain], common: Chain) -> tuple[Chain, ...]:
    """``common`` for every channel, its largest lag shifted by the channel's difference from the mean of ``chains``."""
    mean = float(np.mean([c.lag_s for c in chains]))
    taus = sorted(common.taus_s, reverse=True)
    return tuple(
        replace(common, taus_s=(max(taus[0] + c.lag_s - mean, 1e-3), *taus[1:])) for c in chains
    )


def smoothed(
    test: EhlTest,
    disk: DiskTraces,
    rows: slice,
    chains: tuple[Chain, ...],
    lag_u_s: float,
    like: Compensated | None = None,
) -> Compensated:
    """The traces of one disk over ``rows``, smoothed with the parting as a known kink, a slow one as two, and as freely
    as they were in ``like``, from the same row on: without it by their likelihood."""
    start, end = test.time_s[rows][[0, -1]]
    return smooth(
        disk.measured_degC[rows],
        test.dt_s,
        chains,
        noise_sd=disk.noise_K,
        intensity=None if like is None else like.intensities,
        events_s=tuple(float(kink - start) for kink in test.events.kinks_s if kink < end),
        event_u_s=test.events.unload_u_s,
        lag_covariance=with_common_u(disk.lag_covariance_s2, lag_u_s),
        static_u=disk.static_u_K,
    )


def compensated(
    test: EhlTest, disk: DiskTraces, rows: slice, done: Compensated, profile: Profile = "modal"
) -> CompensatedDisk:
    """The traces of one disk over ``rows``, ``done`` by :func:`smoothed`, and the windows made of them."""
    window, late = (
        disk_window(
            test,
            disk,
            done.temperature + longer_s * done.lag_sensitivity,
            rows,
            disk.noise_K,
            profile,
        )
        for longer_s in (0.0, LAG_STEP_S)
    )
    return CompensatedDisk(
        test,
        disk,
        done,
        window,
        late,
        float(np.median(done.sd_noise[:, disk.setup.places(disk.setup.outer)])),
    )


def cooling_errors(cooled: CompensatedDisk, share: float, h_W_m2K: float) -> tuple[NuisanceEffects, Array]:
    """What may be wrong with the window about a point of the plane: effects of what nobody measured, and predicted
    less compensated outer row per second of compensated lag too long, (R, P)."""
    late_rim = cooled.late.rim
    rim = cooled.window.rim
    predicted = late_rim.through(rim.rest, h_W_m2K) - rim.through(rim.rest, h_W_m2K)
    late = (predicted - (cooled.late.y - cooled.window.y)) / LAG_STEP_S
    return nuisance_effects(cooled.test, cooled.disk, cooled.window, share, h_W_m2K), late


def cooling_shift(fit: CoolingFit, known: NuisanceEffects, late: Array, line: DiskLine) -> CoolingSensitivity:
    """Errors of (share, h), through the traces and through the line; ``known`` and ``late`` of ``cooling_errors``."""
    share_off = line.shift.per_sd @ np.array([1.0, fit.h_W_m2K])
    h_off = np.einsum(
        "rp,qrp->q", fit.by_effect, share_off[:, None, None] * fit.power - known.change
    )
    toward = np.array([line.line.slope, 1.0])
    noise = fit.h_noise**2 * np.outer(toward, toward)
    noise[0, 0] += line.shift.noise[0, 0]
    per_sd = np.column_stack([share_off + line.line.slope * h_off, h_off])
    return CoolingSensitivity(known.of, per_sd, noise, toward * float((fit.by_effect * late).sum()))


def cooling_fit(
    window: DiskWindow,
    line: SteadyLine,
    unload_s: float,
    window_s: float,
    noise_K: float,
    log_h: tuple[float, float] = (0.0, np.inf),
) -> CoolingFit:
    """Fit h alone to compensated traces over ``window_s`` seconds after ``unload_s``; the share follows the line.

    Each outer junction is compared with the model after both are matched over the last ``MATCH_S`` seconds under
    load, so that static errors, which the steady line already holds, do not enter twice. ``noise_K`` is the standard
    deviation of what compensation left in a trace, ``log_h`` mean and deviation of what is known of h beforehand.
    Raises InputError when no h in 5..8000 W/m2K fits best inside.
    """
    since = window.at_s - unload_s
    inside = (since >= 0) & (since < window_s)
    before = (since >= -MATCH_S) & (since < -0.1)
    weight = window.counts[inside][:, None].astype(float) * window.used

    def model(h: float) -> tuple[Array, Array]:
        rest, power = window.rim.answer(h)
        return rest + line.at(h) * power, power

    def matched(x: Array) -> Array:
        return np.asarray(x - x[before].mean(axis=0))

    target = matched(window.y)

    stated, stated_u = log_h

    def cost(log_h: float) -> float:
        gap = (target - matched(model(float(np.exp(log_h)))[0]))[inside]
        return float((weight * gap**2).sum()) + (noise_K * (log_h - stated) / stated_u) ** 2

    low, high = np.log(H_RANGE_W_M2K)
    best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
    if min(best.x - low, high - best.x) < 1e-2:
        raise InputError(
            f"the cooling fit of the {window.disk} disk runs to h = {np.exp(best.x):.3g} W/m2K",
            expected="an h between 5 and 8000 W/m2K",
            remedy="the lag or the instant of parting may be wrong; compare with the joint fit",
        )
    h = float(np.exp(best.x))
    predicted, power = model(h)
    step = 1e-3 * h
    s = matched((model(h + step)[0] - model(h - step)[0]) / (2 * step))[
        inside
    ]  # by h, along the line
    residual = (target - matched(predicted))[inside]
    curvature = (weight * s * s).sum() + (noise_K / (h * stated_u)) ** 2
    by_effect = np.zeros_like(power)
    by_effect[inside] = -weight * s / curvature
    by_effect[before] -= by_effect[inside].sum(axis=0) / before.sum()
    return CoolingFit(
        disk=window.disk,
        h_W_m2K=h,
        share=line.at(h),
        beta=line.at(h) if window.disk == "fast" else 1.0 - line.at(h),
        window_s=window_s,
        misfit_K=float(np.sqrt((weight * residual**2).sum() / weight.sum())),
        by_effect=by_effect,
        power=power,
        h_noise=float(
            np.sqrt((weight * s * s).sum() + (noise_K / (h * stated_u)) ** 2) * noise_K / curvature
        ),
    )


def surface_temperatures(
    test: EhlTest,
    speed: SpeedLawPoint,
    windows: Mapping[str, DiskWindow],
    draws: Mapping[str, Array],
) -> tuple[dict[str, float], dict[str, Array]]:
    """Maxima of the running tracks' mean temperature over the last seconds under load, and their Monte Carlo draws.

    "surface fast" and "surface slow" [degC], and (T_fast - T_slow) u_s [K m/s] as "delta_T_us" (figure 7.18); nine
    places across the track are looked at. ``draws`` of beta, h_fast and h_slow move them by their slopes.
    """
    values = dict[str, float]()
    drawn = dict[str, Array]()
    for d, h, share, sign in (
        ("fast", speed.h_fast, speed.beta, 1),
        ("slow", speed.h_slow, 1 - speed.beta, -1),
    ):
        rim = windows[d].rim
        to_parting = windows[d].at_s - test.events.unload_s
        last = (to_parting >= -LAST_S) & (to_parting < -0.2)
        places = tuple(
            (SURFACE_DEPTH_M, float(x)) for x in np.linspace(0.3, 0.7, 9) * rim.setup.width_m
        )
        step = 0.01 * max(h, 10.0)
        both = rim.answer(max(h, 0.0) + np.array([0.0, step]), extra=places)
        rest, power = (x[:, last, len(rim.setup.outer) :].mean(axis=1) for x in both)
        track = rest + share * power  # (2, 9)
        track -= (
            rim.setup.steel.straight(track) - track
        )  # back from Kirchhoff's temperature, to first order
        by_h = (track[1, k := int(np.argmax(track[0]))] - track[0, k]) / step
        more = sign * power[0, k] * (draws["speed law"] - speed.beta) + by_h * (draws[f"h_{d}"] - h)
        values[f"surface {d}"], drawn[f"surface {d}"] = float(track[0, k]), track[0, k] + more
    values["delta_T_us"] = (
        values["surface fast"] - values["surface slow"]
    ) * test.sliding_speed_m_s
    drawn["delta_T_us"] = (drawn["surface fast"] - drawn["surface slow"]) * test.sliding_speed_m_s
    return values, drawn
