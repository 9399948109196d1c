"""Workflows: the order of the stages of each command, as functions that return result objects.

They contain no estimator: each step is a function of a lower layer. The commands of ``tcdyn.cli``
call them, ``tcdyn.plots`` and ``tcdyn.report`` show their results.
"""

from tcdyn.workflows.beta import BetaRun, estimate_beta
from tcdyn.workflows.calibrate import CalibrationRun, calibrate_disk
from tcdyn.workflows.compensate import CompensatedLog, compensate_log
from tcdyn.workflows.demo import DemoRun, run_demo
from tcdyn.workflows.frames import compensate_dataset, compensate_frame
from tcdyn.workflows.history import history_of_logs
from tcdyn.workflows.inspect import Inspection, inspect

__all__ = [
    "BetaRun",
    "CalibrationRun",
    "CompensatedLog",
    "DemoRun",
    "Inspection",
    "calibrate_disk",
    "compensate_dataset",
    "compensate_frame",
    "compensate_log",
    "estimate_beta",
    "history_of_logs",
    "inspect",
    "run_demo",
]
