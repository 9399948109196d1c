"""From what the logger wrote back to what the junction felt, with an uncertainty for every sample."""

from tcdyn.compensate.intensity import Tradeoff
from tcdyn.compensate.inverse import BeforeUse, InverseFilter, before_use, invert, proper_inverse, widest_bandwidth_Hz
from tcdyn.compensate.live import LiveSmoother, LiveState, live_before_use
from tcdyn.compensate.record import Burst, Compensated, Intensity
from tcdyn.compensate.smoother import deconvolve, smooth, window_covariance

__all__ = [
    "BeforeUse",
    "Burst",
    "Compensated",
    "Intensity",
    "InverseFilter",
    "LiveSmoother",
    "LiveState",
    "Tradeoff",
    "before_use",
    "deconvolve",
    "invert",
    "live_before_use",
    "proper_inverse",
    "smooth",
    "widest_bandwidth_Hz",
    "window_covariance",
]
