"""The order of the stages: what each command does, as functions with result objects."""

from tcdyn.pipeline.beta import BetaRun, estimate_beta
from tcdyn.pipeline.calibrate import CalibrationRun, calibrate_disk
from tcdyn.pipeline.compensate import CompensatedLog, compensate_log
from tcdyn.pipeline.demo import DemoRun, run_demo

__all__ = [
    "BetaRun",
    "CalibrationRun",
    "CompensatedLog",
    "DemoRun",
    "calibrate_disk",
    "compensate_log",
    "estimate_beta",
    "run_demo",
]
