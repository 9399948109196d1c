"""From what the logger wrote back to what the junction felt, with an uncertainty for every sample."""

from tcdyn.compensate.before_use import BeforeUse, before_use, live_before_use, widest_bandwidth_Hz
from tcdyn.compensate.grid import Burst, Intensity
from tcdyn.compensate.inverse import InverseFilter, Tradeoff, deconvolve, invert, proper_inverse
from tcdyn.compensate.live import LiveSmoother, LiveState
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth, window_covariance

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
