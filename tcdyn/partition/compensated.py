"""The stretch of a test with its lag removed, and what that does to the cooling fit's errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth
from tcdyn.conduction.rim import Profile
from tcdyn.partition.cooling import CoolingFit
from tcdyn.partition.lines import DiskLine
from tcdyn.partition.nuisance import Nuisances, with_common_u
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.shift import FitShift
from tcdyn.partition.window import DiskWindow, disk_window
from tcdyn.traces import DiskTraces

LAG_STEP_S = 0.01


def compensate_stretch(
    test: EhlTest, disk: DiskTraces, rows: slice, chains: tuple[Chain, ...], lag_u_s: float
) -> Compensated:
    """The six traces of one disk over ``rows``, smoothed with the parting as a known kink, a slow one as two."""
    y = disk.measured_degC[rows]
    start = test.time_s[rows][0]
    return smooth(
        y,
        test.dt_s,
        chains,
        noise_sd=disk.noise_K,
        events_s=tuple(float(kink - start) for kink in test.events.kinks_s),
        event_u_s=test.events.unload_u_s,
        lag_covariance=with_common_u(disk.lag_covariance_s2, lag_u_s),
        static_u=disk.static_u_K,
    )


def compensated_window(test: EhlTest, disk: DiskTraces, rows: slice, done: Compensated, profile: Profile) -> DiskWindow:
    """The window of the compensated traces, frictional power unlagged."""
    return disk_window(test, disk, done.temperature, rows, disk.noise_K, profile)


def cooling_shift(nuis: Nuisances, line: DiskLine, fit: CoolingFit) -> FitShift:
    """Errors of (share, h) of the cooling fit by the nuisances, through the traces and through the line."""
    slope = line.line.slope
    per_sd = []
    for q, name in enumerate(nuis.names):
        k = line.shift.names.index(name)
        share_off = float(line.shift.per_sd[k] @ np.array([1.0, fit.h_W_m2K]))
        h_off = -fit.pull(nuis.effect[q] * nuis.sd[q] - share_off * fit.power)
        per_sd.append((share_off + slope * h_off, h_off))
    toward = np.array([slope, 1.0])
    noise = fit.h_noise**2 * np.outer(toward, toward)
    noise[0, 0] += line.shift.noise[0, 0]
    return FitShift(nuis.names, nuis.shared, np.array(per_sd), noise)


def lag_effect(
    test: EhlTest, disk: DiskTraces, rows: slice, done: Compensated, window: DiskWindow, h_W_m2K: float
) -> NDArray[np.float64]:
    """Predicted less compensated outer row per second by which the compensated lag is too long, (R, 3) [K/s]."""
    longer = replace(done, temperature=done.temperature + LAG_STEP_S * done.lag_sensitivity)
    moved = compensated_window(test, disk, rows, longer, window.profile)
    gains = window.gains(h_W_m2K)
    change = (moved.answer(gains)[0] - window.answer(gains)[0]) - (moved.y - window.y)
    return np.asarray(change / LAG_STEP_S)


def cooling_by_lag(effect: NDArray[np.float64], line: DiskLine, fit: CoolingFit) -> NDArray[np.float64]:
    """Error of (share, h) of the cooling fit per second of lag too long, from its ``effect`` (R, 3) [K/s]."""
    change = fit.pull(effect)
    return np.array([line.line.slope * change, change])
