"""Sampled input-output data: as values, out of tables and files, and in stretches as the fits take them."""

from tcdyn.identify.data.feedback import check_closed_loop, closed_loop
from tcdyn.identify.data.record import Hold, IOData, Run
from tcdyn.identify.data.segments import REPEATED, SHORTEST, Segment, cut, input_noise_sd

__all__ = [
    "REPEATED",
    "SHORTEST",
    "Hold",
    "IOData",
    "Run",
    "Segment",
    "check_closed_loop",
    "closed_loop",
    "cut",
    "input_noise_sd",
]
