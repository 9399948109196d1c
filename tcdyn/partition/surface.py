"""Hottest running-surface temperatures at the end of loading, from the speed-law point (section 7.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.steady import SpeedLawPoint
from tcdyn.partition.window import NOMINAL, DiskWindow, perturbed_gains

SURFACE_DEPTH_M = 0.0
LAST_S = 10.0


@dataclass(frozen=True)
class Surface:
    """Maximum of the running track's mean temperature [degC] and (T_fast - T_slow) u_s [K m/s] (figure 7.18)."""

    fast_max_degC: float
    slow_max_degC: float
    delta_T_us: float


def surface_temperatures(
    test: EhlTest, rows: slice, speed: SpeedLawPoint, windows: Mapping[str, DiskWindow]
) -> Surface:
    """Surface maxima over the last seconds under load; the centre of the track is the hottest place."""
    found = {}
    for disk, h, share in (("fast", speed.h_fast, speed.beta), ("slow", speed.h_slow, 1 - speed.beta)):
        window = windows[disk]
        z = np.linspace(0.3, 0.7, 9) * window.setup.width_m
        extra = tuple((SURFACE_DEPTH_M, float(x)) for x in z)
        gains = perturbed_gains(
            window.setup, max(h, 0.0), window.half_width_m, window.rates_1_s, NOMINAL, window.profile, extra
        )
        rest, power = window.answer(gains)
        last = window.between(test.events.unload_s - LAST_S, test.events.unload_s - 0.2)
        found[disk] = float((rest + share * power)[last, 3:].mean(axis=0).max())
    return Surface(found["fast"], found["slow"], (found["fast"] - found["slow"]) * test.sliding_speed_m_s)
