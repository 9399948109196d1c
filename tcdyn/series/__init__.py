"""The rows, times and readings of a table, decided once for every command."""

from tcdyn.series.clock import MIN_STRAY, Clock, fit_clock
from tcdyn.series.options import ReadingOptions, TableOptions
from tcdyn.series.real_share import RealShare, at_grid_times, real_share
from tcdyn.series.report import SeriesReport
from tcdyn.series.series import Context, Policy, Series, make_series
from tcdyn.series.source import Source, open_source

__all__ = [
    "MIN_STRAY",
    "Clock",
    "Context",
    "Policy",
    "ReadingOptions",
    "RealShare",
    "Series",
    "SeriesReport",
    "Source",
    "TableOptions",
    "at_grid_times",
    "fit_clock",
    "make_series",
    "open_source",
    "real_share",
]
