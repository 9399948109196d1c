"""The order of the stages: what each command does, as functions with result objects, imported when asked for."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tcdyn.pipeline.beta import BetaRun, estimate_beta
    from tcdyn.pipeline.calibrate import CalibrationRun, calibrate_disk
    from tcdyn.pipeline.compensate import CompensatedLog, compensate_log
    from tcdyn.pipeline.demo import DemoRun, run_demo
    from tcdyn.pipeline.one_disk import OneDiskRun, estimate_one_disk

STAGES = {
    "beta": ("BetaRun", "estimate_beta"),
    "calibrate": ("CalibrationRun", "calibrate_disk"),
    "compensate": ("CompensatedLog", "compensate_log"),
    "demo": ("DemoRun", "run_demo"),
    "one_disk": ("OneDiskRun", "estimate_one_disk"),
}
__all__ = [
    "BetaRun",
    "CalibrationRun",
    "CompensatedLog",
    "DemoRun",
    "OneDiskRun",
    "calibrate_disk",
    "compensate_log",
    "estimate_beta",
    "estimate_one_disk",
    "run_demo",
]


def __getattr__(name: str) -> Any:
    module = next((stage for stage, names in STAGES.items() if name in names), None)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{module}"), name)
