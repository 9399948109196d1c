"""The lag common to a disk's channels, from the unloading, with the record's as prior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.disk import DISKS
from tcdyn.chain import Chain, equalised
from tcdyn.conduction.bank import lag_bank
from tcdyn.conduction.rim import Profile
from tcdyn.partition.joint import DiskFit, joint_fits
from tcdyn.partition.lines import DiskLine, disk_line
from tcdyn.partition.nuisance import Nuisances, nuisances
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.steady import SpeedLawPoint, speed_law
from tcdyn.partition.window import DiskWindow, chained_power, disk_window, stretch_of
from tcdyn.traces import DiskTraces

JOINT_WINDOW_S = 10.0
EQUAL_WEIGHTS = np.ones(3)  # (7.1); (7.2) doubles the first
LEAST_H_W_M2K = 50.0


def steady_lines(
    test: EhlTest,
    rows: slice,
    profile: Profile = "modal",
    weights: NDArray[np.float64] = EQUAL_WEIGHTS,
) -> tuple[dict[str, DiskLine], SpeedLawPoint]:
    """Steady line of each disk from the lagged readings, and the speed law's point on both."""
    lines = {d: _line(test, test.disks[d], rows, profile, weights) for d in DISKS}
    return lines, speed_law(lines["fast"].line, lines["slow"].line, test.speed_ratio, test.speed_exponent)


def joint_start(speed: SpeedLawPoint) -> dict[str, tuple[float, float]]:
    """Where the joint fits begin: share and h of each disk by the speed law."""
    return {
        "fast": (speed.beta, max(speed.h_fast, LEAST_H_W_M2K)),
        "slow": (1 - speed.beta, max(speed.h_slow, LEAST_H_W_M2K)),
    }


def joint_length_s(test: EhlTest) -> float:
    """Cooling that the joint fits use [s]: ten seconds, or what the log holds."""
    return float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))


def refine_lags(test: EhlTest) -> Mapping[str, DiskFit]:
    """Joint fits of both disks, for their chains."""
    length = joint_length_s(test)
    _, speed = steady_lines(test, stretch_of(test, length))
    return joint_fits(test, joint_start(speed), length)[0]


def refined_chains(chains: Sequence[Chain], common: Chain) -> tuple[Chain, ...]:
    """``common`` for every channel, its largest lag shifted by the channel's difference from the mean of ``chains``."""
    mean = float(np.mean([c.lag_s for c in chains]))
    taus = sorted(common.taus_s, reverse=True)
    return tuple(replace(common, taus_s=(max(taus[0] + c.lag_s - mean, 1e-3), *taus[1:])) for c in chains)


def _line(
    test: EhlTest,
    disk: DiskTraces,
    rows: slice,
    profile: Profile,
    weights: NDArray[np.float64],
) -> DiskLine:
    readings = equalised(disk.readings_degC[rows], test.dt_s, disk.chains, disk.mean_chain)
    window = lagged_window(test, disk, rows, readings, profile)

    def at(share: float, h: float) -> Nuisances:
        return nuisances(window, disk, readings, test.dt_s, share, h, test.events.unload_u_s)

    return disk_line(window, test.events.unload_s, weights, at)


def lagged_window(
    test: EhlTest, disk: DiskTraces, rows: slice, readings: NDArray[np.float64], profile: Profile
) -> DiskWindow:
    """Window of the equalised, still lagged readings, with the power seen through the same chain."""
    window = disk_window(test, disk, readings, rows, disk.noise_K, profile)
    power = chained_power(test, rows, disk.mean_chain)
    return window.with_power(power, lag_bank(power, test.dt_s, window.rates_1_s))
