"""Speeds of two disks of equal radius on parallel shafts."""

from __future__ import annotations

import numpy as np


def surface_speed_m_s(speed_rpm: float, radius_m: float = 0.0381) -> float:
    """Speed of the running surface, u = 2 pi n R / 60 [m/s]."""
    return 2.0 * np.pi * speed_rpm / 60.0 * radius_m


def sliding_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Sliding speed u_s = u_fast - u_slow [m/s] (table 6.1).

    >>> round(sliding_speed_m_s(6555, 1546), 1)
    20.0
    """
    return surface_speed_m_s(fast_rpm, radius_m) - surface_speed_m_s(slow_rpm, radius_m)


def entraining_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Entraining (mean) speed u_m = (u_fast + u_slow) / 2 [m/s] (table 6.1).

    >>> round(entraining_speed_m_s(3282, 774), 2)
    8.09
    """
    return 0.5 * (surface_speed_m_s(fast_rpm, radius_m) + surface_speed_m_s(slow_rpm, radius_m))
