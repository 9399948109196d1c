"""The order of the stages: what each command does, as functions with result objects.

The demonstration stands in ``tcdyn.pipeline.demo``: it alone needs the synthetic rig.
"""

from tcdyn.pipeline.beta import BetaRun, estimate_beta
from tcdyn.pipeline.calibrate import CalibrationRun, calibrate_disk
from tcdyn.pipeline.compensate import CompensatedLog, compensate_log
from tcdyn.pipeline.one_disk import OneDiskRun, estimate_one_disk

__all__ = [
    "BetaRun",
    "CalibrationRun",
    "CompensatedLog",
    "OneDiskRun",
    "calibrate_disk",
    "compensate_log",
    "estimate_beta",
    "estimate_one_disk",
]
