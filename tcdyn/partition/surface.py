"""Hottest running-surface temperatures at the end of loading, from the speed-law point (section 7.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.steady import SpeedLawPoint
from tcdyn.partition.window import NOMINAL, DiskWindow, perturbed_gains

SURFACE_DEPTH_M = 0.0
LAST_S = 10.0


@dataclass(frozen=True)
class Surface:
    """Maximum of the running track's mean temperature [degC] and (T_fast - T_slow) u_s [K m/s] (figure 7.18).

    ``slopes``: of each disk's maximum by share [K] and by h [K per W/m2K], for the budget.
    """

    fast_max_degC: float
    slow_max_degC: float
    delta_T_us: float
    slopes: Mapping[str, tuple[float, float]]

    def draws(
        self, speed: SpeedLawPoint, drawn: Mapping[str, NDArray[np.float64]], sliding_m_s: float
    ) -> dict[str, NDArray[np.float64]]:
        """Monte Carlo draws of the three numbers, from those of beta, h_fast and h_slow."""
        move = drawn["speed law"] - speed.beta
        fast = (
            self.fast_max_degC
            + self.slopes["fast"][0] * move
            + self.slopes["fast"][1] * (drawn["h_fast"] - speed.h_fast)
        )
        slow = (
            self.slow_max_degC
            - self.slopes["slow"][0] * move
            + self.slopes["slow"][1] * (drawn["h_slow"] - speed.h_slow)
        )
        return {"surface fast": fast, "surface slow": slow, "delta_T_us": (fast - slow) * sliding_m_s}


def surface_temperatures(test: EhlTest, speed: SpeedLawPoint, windows: Mapping[str, DiskWindow]) -> Surface:
    """Surface maxima over the last seconds under load; the centre of the track is the hottest place."""
    found, slopes = {}, {}
    for disk, h, share in (("fast", speed.h_fast, speed.beta), ("slow", speed.h_slow, 1 - speed.beta)):
        last = windows[disk].between(test.events.unload_s - LAST_S, test.events.unload_s - 0.2)
        rest, power = _track(windows[disk], max(h, 0.0), last)
        hottest = int(np.argmax(rest + share * power))
        step = 0.01 * max(h, 10.0)
        rest_up, power_up = _track(windows[disk], max(h, 0.0) + step, last)
        found[disk] = float(rest[hottest] + share * power[hottest])
        moved = float(rest_up[hottest] + share * power_up[hottest])
        slopes[disk] = (float(power[hottest]), (moved - found[disk]) / step)
    return Surface(found["fast"], found["slow"], (found["fast"] - found["slow"]) * test.sliding_speed_m_s, slopes)


def _track(window: DiskWindow, h: float, last: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean surface temperature without heat and per share at nine places across the track."""
    extra = tuple((SURFACE_DEPTH_M, float(x)) for x in np.linspace(0.3, 0.7, 9) * window.setup.width_m)
    gains = perturbed_gains(window.setup, h, window.half_width_m, window.rates_1_s, NOMINAL, window.profile, extra)
    rest, power = window.answer(gains)
    return rest[last, 3:].mean(axis=0), power[last, 3:].mean(axis=0)
