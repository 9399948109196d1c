"""The cooling fit: with the power gone, h is the one unknown of a disk on its steady line (sections 4.4 and 7.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from calibration import Array
from calibration.errors import InputError
from tcdyn.chain import Chain
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth
from tcdyn.conduction.rim import Profile
from tcdyn.partition.effects import Effects, FitShift, effects, with_common_u
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.steady import DiskLine, SteadyLine
from tcdyn.partition.window import OUTER, DiskWindow, disk_window
from tcdyn.traces import DiskTraces

H_RANGE_W_M2K = (5.0, 8000.0)
MATCH_S = 10.0  # the model is matched to the readings over this long before parting
LAG_STEP_S = 0.01


@dataclass(frozen=True)
class Cooled:
    """One disk's traces over ``rows`` of a test with their lag removed, and the window of what was compensated."""

    test: EhlTest
    disk: DiskTraces
    rows: slice
    done: Compensated
    window: DiskWindow

    @property
    def noise_K(self) -> float:
        """Standard deviation of what compensation left in a trace of the outer row [K]."""
        return float(np.median(self.done.sd_noise[:, OUTER]))

    def errors(self, share: float, h_W_m2K: float) -> CoolingErrors:
        """What may be wrong with the window about a point of the plane, the compensated lag included."""
        done = self.done
        longer = done.temperature + LAG_STEP_S * done.lag_sensitivity
        moved = disk_window(self.test, self.disk, longer, self.rows, self.disk.noise_K, self.window.rim.profile)
        predicted = moved.rim.answer(h_W_m2K)[0] - self.window.rim.answer(h_W_m2K)[0]
        late = (predicted - (moved.y - self.window.y)) / LAG_STEP_S
        return CoolingErrors(effects(self.test, self.disk, self.window, share, h_W_m2K), late)


@dataclass(frozen=True)
class CoolingErrors:
    """Effects of what nobody measured, and predicted less compensated outer row per second of lag too long, (R, 3)."""

    known: Effects
    late: Array


@dataclass(frozen=True)
class CoolingShift(FitShift):
    """Errors of (share, h); ``by_lag`` (2,): the same per second by which the compensated lag is too long."""

    by_lag: Array


@dataclass(frozen=True)
class CoolingFit:
    """h [W/m2K] and share of one disk from its cooling; ``misfit_K`` is the rms over the window.

    ``slope`` (R, 3): change of the matched model per unit of h along the line; ``inside`` (R,): blocks of the window,
    ``weight`` (inside,) their samples; ``h_noise`` its standard uncertainty from the compensated traces' noise alone.
    """

    disk: str
    h_W_m2K: float
    share: float
    window_s: float
    misfit_K: float
    slope: Array
    power: Array
    inside: NDArray[np.bool_]
    weight: Array
    before: NDArray[np.bool_]
    h_noise: float

    @property
    def beta(self) -> float:
        """Heat partition of the fast disk."""
        return self.share if self.disk == "fast" else 1.0 - self.share

    def matched(self, x: Array) -> Array:
        """``x`` (R, 3) less its mean just before parting."""
        return np.asarray(x - x[self.before].mean(axis=0))

    def pull(self, effect: Array) -> float:
        """Change of the fitted h when the model's prediction changes by ``effect`` (R, 3) [K]."""
        s, w = self.slope[self.inside], self.weight[:, None]
        return -float((w * s * self.matched(effect)[self.inside]).sum() / (w * s * s).sum())

    def shift(self, errors: CoolingErrors, line: DiskLine) -> CoolingShift:
        """Errors of (share, h), through the traces and through the line."""
        slope = line.line.slope
        share_off = line.shift.per_sd @ np.array([1.0, self.h_W_m2K])
        h_off = np.array([-self.pull(c - off * self.power) for c, off in zip(errors.known.change, share_off)])
        toward = np.array([slope, 1.0])
        noise = self.h_noise**2 * np.outer(toward, toward)
        noise[0, 0] += line.shift.noise[0, 0]
        per_sd = np.column_stack([share_off + slope * h_off, h_off])
        return CoolingShift(errors.known.of, per_sd, noise, toward * self.pull(errors.late))


def compensated(
    test: EhlTest, disk: DiskTraces, rows: slice, chains: tuple[Chain, ...], lag_u_s: float, profile: Profile = "modal"
) -> Cooled:
    """The six traces of one disk over ``rows``, smoothed with the parting as a known kink, a slow one as two."""
    start = test.time_s[rows][0]
    done = smooth(
        disk.measured_degC[rows],
        test.dt_s,
        chains,
        noise_sd=disk.noise_K,
        events_s=tuple(float(kink - start) for kink in test.events.kinks_s),
        event_u_s=test.events.unload_u_s,
        lag_covariance=with_common_u(disk.lag_covariance_s2, lag_u_s),
        static_u=disk.static_u_K,
    )
    return Cooled(test, disk, rows, done, disk_window(test, disk, done.temperature, rows, disk.noise_K, profile))


def cooling_fit(window: DiskWindow, line: SteadyLine, unload_s: float, window_s: float, noise_K: float) -> CoolingFit:
    """Fit h alone to compensated traces over ``window_s`` seconds after ``unload_s``; the share follows the line.

    Each outer junction is compared with the model after both are matched over the last ``MATCH_S`` seconds under
    load, so that static errors, which the steady line already holds, do not enter twice. ``noise_K`` is the standard
    deviation of what compensation left in a trace. Raises InputError when no h in 5..8000 W/m2K fits best inside.
    """
    since = window.at_s - unload_s
    inside, before = (since >= 0) & (since < window_s), (since >= -MATCH_S) & (since < -0.1)
    weight = window.counts[inside][:, None].astype(float)

    def model(h: float) -> tuple[Array, Array]:
        rest, power = window.rim.answer(h)
        return rest + line.at(h) * power, power

    def matched(x: Array) -> Array:
        return np.asarray(x - x[before].mean(axis=0))

    target = matched(window.y)

    def cost(log_h: float) -> float:
        gap = (target - matched(model(float(np.exp(log_h)))[0]))[inside]
        return float((weight * gap**2).sum())

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
    slope = matched((model(h + step)[0] - model(h - step)[0]) / (2 * step))
    residual = target - matched(predicted)
    s = slope[inside]
    scatter = np.sqrt(((s * weight) ** 2 / weight * noise_K**2).sum()) / (weight * s * s).sum()
    misfit = float(np.sqrt((weight * residual[inside] ** 2).sum() / (3 * weight.sum())))
    at = (window.disk, h, line.at(h), window_s, misfit)
    return CoolingFit(*at, slope, power, inside, weight[:, 0], before, float(scatter))
