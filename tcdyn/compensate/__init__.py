"""From what the logger wrote back to what the junction felt, with an uncertainty for every sample."""

from tcdyn.compensate.before_use import BeforeUse, before_use, widest_bandwidth_Hz
from tcdyn.compensate.covariance import window_covariance
from tcdyn.compensate.deconvolve import Tradeoff, deconvolve
from tcdyn.compensate.denoise import Denoised, remove_noise
from tcdyn.compensate.inverse import InverseFilter, proper_inverse
from tcdyn.compensate.invert import invert
from tcdyn.compensate.live import LiveSmoother, LiveState
from tcdyn.compensate.profile import Burst, Intensity
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth
from tcdyn.compensate.stream import InverseState, InverseStream

__all__ = [
    "BeforeUse",
    "Burst",
    "Compensated",
    "Denoised",
    "Intensity",
    "InverseFilter",
    "InverseState",
    "InverseStream",
    "LiveSmoother",
    "LiveState",
    "Tradeoff",
    "before_use",
    "deconvolve",
    "invert",
    "proper_inverse",
    "remove_noise",
    "smooth",
    "widest_bandwidth_Hz",
    "window_covariance",
]
