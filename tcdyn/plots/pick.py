"""The function :func:`draw`, which chooses the figure of a result by its class.

Used by :mod:`tcdyn.report.page` and, as ``tcdyn.plots.draw``, by users of the library. A new result
needs an entry in ``PICTURES``, and in ``PARTS`` if its figure takes an attribute of it. The first
class of which the result is an instance decides. Test: ``tests/core/test_results.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter, methodcaller
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from calibration.compare import RecordComparison
from calibration.static_lines import OvenFit
from calibration.transducers import BearingFriction
from immersion.hole import HoleComparison
from immersion.plunge_result import PlungeFit
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95
from tcdyn.core.result import Result
from tcdyn.design.compare import Design
from tcdyn.identification.comparison import Comparison
from tcdyn.identification.identified import Identified
from tcdyn.identification.iodata import IOData
from tcdyn.identification.responses import Band, BodeBand
from tcdyn.identification.search import Fit
from tcdyn.identification.validation import Validation
from tcdyn.partition.analyse import Partition
from tcdyn.plots.calibration import draw_bearing, draw_chain, draw_lags, draw_log
from tcdyn.plots.calibration import draw_residuals as draw_oven_residuals
from tcdyn.plots.campaign import draw_beta
from tcdyn.plots.compensate import draw_compensated, draw_filter_report
from tcdyn.plots.history import draw_history
from tcdyn.plots.identify import draw_band, draw_correlation, draw_data, draw_fit, draw_step
from tcdyn.plots.inspect import draw_inspected
from tcdyn.plots.partition import draw_beta_estimates
from tcdyn.plots.plunge import draw_common_lag, draw_design, draw_holes
from tcdyn.plots.style import DARK, axes_of, screen_rows, style_axes
from tcdyn.plots.tune import draw_tuning
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import Log, read_log
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.sensors import SensorComparison, SensorFile, SensorHistory
from tcdyn.sensors.touch import TouchLog
from tcdyn.simulate.campaign import CampaignFiles
from tcdyn.smoothing.inverse import FilterReport
from tcdyn.smoothing.record import Compensated
from tcdyn.tuning import Tuning
from tcdyn.workflows import BetaRun, CalibrationRun, CompensatedLog, DemoRun, Inspection
from tcdyn.workflows.campaign import CampaignRun


def _first_test(files: CampaignFiles) -> Log | None:
    """The first log of a campaign with a contact; None without one."""
    for path in files.ehl.values():
        return read_log(path, "ehl", load_rig(files.rig))
    return None


def _depths_of_junctions(rig: Rig) -> pd.DataFrame:
    """Depth of each junction of both disks."""
    depths = {
        f"{disk} depth_mm": {name: t.depth_mm for name, t in rig.tables(disk).thermocouples.items()}
        for disk in DISKS
    }
    return pd.DataFrame(depths).rename_axis("junction")


def draw_table(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Plot a table: relative intervals of estimates, or numbers over the index.

    Parameters
    ----------
    table
        As ``Result.to_frame`` returns it. If it is no table of estimates, the columns of numbers
        are plotted whose name has the same ending, the unit, as the first of them.
    ax
        Axes to plot into; None: those of a new figure.

    Raises
    ------
    InputError
        For a table without numbers.
    """
    ax = axes_of(ax)
    if {"value", "u"} <= set(table.columns):
        below = Z95 * table["u"]
        above = below
        if {"low95", "high95"} <= set(table.columns):
            below = table["value"] - table["low95"]
            above = table["high95"] - table["value"]
        half_widths = np.maximum([below, above], 0.0)
        shares = 100 * half_widths / table["value"].abs().to_numpy()
        names = [f"{row.Index}: {row.value:.4g} {row.unit}".strip() for row in table.itertuples()]
        ax.errorbar(np.zeros(len(table)), names, xerr=shares, fmt="o", color=DARK, capsize=3)
        ax.invert_yaxis()
        return style_axes(ax, "95 % interval of the estimate [%]", "")
    numbers = table.select_dtypes("number")
    if numbers.empty:
        raise InputError("the result has no picture", expected="a result with numbers")
    unit = str(numbers.columns[0]).rpartition("_")[2]
    numbers = numbers[[c for c in numbers.columns if str(c).rpartition("_")[2] == unit]]
    is_series = numbers.index.dtype.kind in "fM"
    x = numbers.index if is_series else np.array([str(label) for label in numbers.index])
    for name in numbers.columns:
        values = numbers[name].to_numpy(dtype=float)
        rows = screen_rows(values)
        ax.plot(x[rows], values[rows], "-" if is_series else "o", label=name)
    y = str(numbers.columns[0]) if numbers.shape[1] == 1 else ""
    return style_axes(ax, str(numbers.index.name or "row"), y, legend=numbers.shape[1] > 1)


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
    Inspection: draw_inspected,
    IOData: draw_data,
    Comparison: draw_fit,
    Fit: draw_fit,
    Identified: draw_step,
    HoleComparison: draw_holes,
    Design: draw_design,
    Band: draw_band,
    BodeBand: draw_band,
    Validation: draw_correlation,
    CampaignFiles: draw_log,
    Rig: draw_table,
    SensorHistory: draw_history,
    Tuning: draw_tuning,
    SensorComparison: draw_table,
    TouchLog: draw_table,
    RecordComparison: draw_table,
    Result: draw_table,
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
    BodeBand: attrgetter("magnitude_dB"),
    Validation: attrgetter("whiteness"),
    CampaignFiles: _first_test,
    Rig: _depths_of_junctions,
    TouchLog: lambda touches: touches.to_frame()[["rise_K"]],
    SensorComparison: lambda compared: compared.to_frame()[["ratio"]],
    RecordComparison: lambda changes: changes.to_frame()[["z"]],
    Result: methodcaller("to_frame"),
}


def draw(result: Any, ax: Axes | None = None, *arguments: Any, **options: Any) -> Axes:
    """Plot the main figure of ``result``.

    Parameters
    ----------
    result
        Any result of the package.
    ax
        Axes to plot into; None: those of a new figure, ``draw(result).figure``.
    *arguments, **options
        Further arguments of the function that plots it, such as the logged trace of a
        ``Compensated``: ``draw(compensated, logged=y)``.

    Returns
    -------
    ax
        The axes.

    Raises
    ------
    InputError
        If the result has nothing to plot, such as a record without a chain.

    Examples
    --------
    >>> draw(Chain([0.6, 0.1])).get_xlabel()
    'time after the step [s]'
    """
    for kind, picture in PICTURES.items():
        if isinstance(result, kind):
            plotted = PARTS[kind](result) if kind in PARTS else result
            if plotted is None:
                raise InputError(f"this {type(result).__name__} holds nothing to draw")
            return picture(plotted, *arguments, ax=ax, **options)
    raise InputError(
        f"a {type(result).__name__} has no picture", expected="a result of the package"
    )
