"""The order of the stages: what each command does, as functions with result objects."""

from tcdyn.pipeline.beta import BetaRun, estimate_beta
from tcdyn.pipeline.calibrate import CalibrationRun, calibrate_disk
from tcdyn.pipeline.compensate import CompensatedLog, compensate_log
from tcdyn.pipeline.demo import DemoRun, run_demo
from tcdyn.pipeline.one_disk import OneDiskRun, estimate_one_disk

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
