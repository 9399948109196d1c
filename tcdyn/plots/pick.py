"""The function :func:`draw`, which chooses the figure of a result by its class.

Used by :mod:`tcdyn.report.page` and, as ``tcdyn.plots.draw``, by users of the library. A new result
needs an entry in ``PICTURES``, and in ``PARTS`` if its figure takes an attribute of it. The first
class of which the result is an instance decides. Test: ``tests/core/test_results.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter, methodcaller
from typing import Any

from matplotlib.axes import Axes

from calibration.static_lines import OvenFit
from calibration.transducers import BearingFriction
from immersion.hole import HoleComparison
from immersion.plunge_result import PlungeFit
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.design.compare import Design
from tcdyn.identification.comparison import Comparison
from tcdyn.identification.identified import Identified
from tcdyn.identification.iodata import IOData
from tcdyn.identification.search import Fit
from tcdyn.partition.analyse import Partition
from tcdyn.plots.calibration import draw_bearing, draw_chain, draw_lags, draw_log
from tcdyn.plots.calibration import draw_residuals as draw_oven_residuals
from tcdyn.plots.campaign import draw_beta
from tcdyn.plots.compensate import draw_compensated, draw_filter_report
from tcdyn.plots.identify import draw_data, draw_fit, draw_step
from tcdyn.plots.partition import draw_beta_estimates
from tcdyn.plots.plunge import draw_common_lag, draw_design, draw_holes
from tcdyn.rig.log import Log
from tcdyn.rig.record import DiskRecord
from tcdyn.sensors import SensorFile
from tcdyn.smoothing.inverse import FilterReport
from tcdyn.smoothing.record import Compensated
from tcdyn.workflows import BetaRun, CalibrationRun, CompensatedLog, DemoRun
from tcdyn.workflows.campaign import CampaignRun

# The figure of each class of result; the first class that fits is used.
PICTURES: dict[type, Callable[..., Axes]] = {
    Log: draw_log,
    Chain: draw_chain,
    DiskRecord: draw_lags,
    OvenFit: draw_oven_residuals,
    BearingFriction: draw_bearing,
    PlungeFit: draw_common_lag,
    CalibrationRun: draw_lags,
    Compensated: draw_compensated,
    CompensatedLog: draw_log,
    FilterReport: draw_filter_report,
    BetaRun: draw_beta_estimates,
    Partition: draw_beta_estimates,
    SensorFile: draw_chain,
    CampaignRun: draw_beta,
    DemoRun: draw_beta_estimates,
    IOData: draw_data,
    Comparison: draw_fit,
    Fit: draw_fit,
    Identified: draw_step,
    HoleComparison: draw_holes,
    Design: draw_design,
}
# The attribute of a result that its figure takes, where that is not the result itself.
PARTS: dict[type, Callable[[Any], Any]] = {
    DiskRecord: attrgetter("chain"),
    CalibrationRun: attrgetter("record.chain"),
    CompensatedLog: methodcaller("as_log"),
    BetaRun: attrgetter("partition"),
    CampaignRun: attrgetter("table"),
    Comparison: attrgetter("best"),
    SensorFile: lambda sensor: sensor.chains[0],
    DemoRun: lambda demo: next(iter(demo.tests.values())).partition,
}


def draw(result: Any, ax: Axes, *arguments: Any, **options: Any) -> Axes:
    """Plot the main figure of ``result`` into ``ax``.

    Parameters
    ----------
    result
        A result of one of the classes in ``PICTURES``.
    ax
        Axes to plot into.
    *arguments, **options
        Further arguments of the function that plots it. A ``Compensated`` also needs the logged
        trace: ``draw(compensated, ax, logged=y)``.

    Returns
    -------
    ax
        The same axes.

    Raises
    ------
    InputError
        If no figure exists for the result, or if a record has no chain.
    """
    for kind, picture in PICTURES.items():
        if not isinstance(result, kind):
            continue
        plotted = PARTS[kind](result) if kind in PARTS else result
        if plotted is None:
            raise InputError(f"this {type(result).__name__} holds no chain to draw")
        return picture(plotted, *arguments, ax=ax, **options)
    raise InputError(
        f"a {type(result).__name__} has no picture",
        expected=", ".join(kind.__name__ for kind in PICTURES),
    )
