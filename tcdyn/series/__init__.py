"""The rows, times and readings of a log, decided once for every command."""

from tcdyn.series.clock import MIN_STRAY, Clock, fit_clock
from tcdyn.series.real_share import RealShare, at_grid_times, real_share

__all__ = ["MIN_STRAY", "Clock", "RealShare", "at_grid_times", "fit_clock", "real_share"]
