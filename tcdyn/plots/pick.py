"""One door to the pictures: the one that tells most of a result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib.axes import Axes

from calibration.errors import InputError
from calibration.lines.static import OvenFit
from calibration.lines.transducers import BearingFriction
from calibration.log import Log
from calibration.record import DiskRecord
from tcdyn import plots
from tcdyn.chain import Chain
from tcdyn.compensate.inverse import BeforeUse
from tcdyn.compensate.record import Compensated
from tcdyn.design.compare import Design
from tcdyn.identify.choose import Comparison
from tcdyn.identify.data import IOData
from tcdyn.identify.identified import Identified
from tcdyn.identify.search import Fit
from tcdyn.partition.analyse import Partition
from tcdyn.partition.one_disk import OneDisk
from tcdyn.pipeline import BetaRun, CalibrationRun, CompensatedLog, DemoRun
from tcdyn.pipeline.campaign.run import CampaignRun
from tcdyn.pipeline.one_disk import OneDiskRun
from tcdyn.plunge.hole import HoleComparison
from tcdyn.plunge.result import PlungeFit
from tcdyn.sensor import SensorFile

# what is drawn, and the part of the result that it takes
PICTURES: dict[type, tuple[str, Callable[[Any], Any]]] = {
    Log: ("draw_log", lambda r: r),
    Chain: ("draw_chain", lambda r: r),
    DiskRecord: ("draw_lags", lambda r: r.chain),
    OvenFit: ("draw_oven_residuals", lambda r: r),
    BearingFriction: ("draw_bearing", lambda r: r),
    PlungeFit: ("draw_common_lag", lambda r: r),
    CalibrationRun: ("draw_lags", lambda r: r.record.chain),
    Compensated: ("draw_compensated", lambda r: r),
    CompensatedLog: ("draw_log", lambda r: r.as_log()),
    BeforeUse: ("draw_before_use", lambda r: r),
    BetaRun: ("draw_ways", lambda r: r.partition),
    Partition: ("draw_ways", lambda r: r),
    OneDiskRun: ("draw_ways", lambda r: r.partition),
    OneDisk: ("draw_ways", lambda r: r),
    SensorFile: ("draw_chain", lambda r: r.chains[0]),
    CampaignRun: ("draw_beta", lambda r: r.table),
    DemoRun: ("draw_ways", lambda r: next(iter(r.tests.values())).partition),
    IOData: ("draw_data", lambda r: r),
    Comparison: ("draw_fit", lambda r: r.best),
    Fit: ("draw_fit", lambda r: r),
    Identified: ("draw_step", lambda r: r),
    HoleComparison: ("draw_holes", lambda r: r),
    Design: ("draw_design", lambda r: r),
}


def draw(result: Any, ax: Axes, *arguments: Any, **options: Any) -> Axes:
    """Draw ``result`` into ``ax`` by the picture that tells most of it; further arguments go to that picture.

    A ``Compensated`` needs the logged trace as well: ``draw(done, ax, logged=y)``. Raises InputError for a result
    without a picture, or a record without a chain.
    """
    for kind, (name, part) in PICTURES.items():
        if isinstance(result, kind):
            shown = part(result)
            if shown is None:
                raise InputError(f"this {type(result).__name__} holds no chain to draw")
            drawn: Axes = getattr(plots, name)(shown, *arguments, ax=ax, **options)
            return drawn
    raise InputError(
        f"a {type(result).__name__} has no picture", expected=", ".join(kind.__name__ for kind in PICTURES)
    )
