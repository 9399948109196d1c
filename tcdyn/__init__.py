"""Thermocouple dynamics and heat partition.

Calibrate disks, compensate logged traces, estimate the heat partition beta.

The public names are imported at their first use (module ``__getattr__``, PEP 562), so that the
command line does not load libraries that it does not need.

>>> import tcdyn
>>> round(tcdyn.Chain([0.6, 0.1], conditioning=tcdyn.Conditioning(cutoff_Hz=4.0, poles=2)).lag_s, 3)
0.78
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tcdyn.chain import Chain
    from tcdyn.core.errors import InputError
    from tcdyn.identification import IOData, compare, fit, identify
    from tcdyn.report.view import view
    from tcdyn.rig.disk import Conditioning
    from tcdyn.rig.log import iter_log, read_log, write_log
    from tcdyn.rig.record import read_record, write_record
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.sensors import (
        predict_sensor,
        read_sensor,
        sensor_from_current,
        sensor_from_dip,
        sensor_from_noise,
        sensor_from_pair,
        sensor_history,
    )
    from tcdyn.simulate.campaign import simulate_campaign
    from tcdyn.smoothing import smooth
    from tcdyn.version import __version__
    from tcdyn.workflows import (
        calibrate_disk,
        compensate_dataset,
        compensate_frame,
        compensate_log,
        estimate_beta,
        run_demo,
    )
    from tcdyn.workflows.inspect import inspect

__all__ = [
    "Chain",
    "Conditioning",
    "IOData",
    "InputError",
    "__version__",
    "calibrate_disk",
    "compare",
    "compensate_dataset",
    "compensate_frame",
    "compensate_log",
    "estimate_beta",
    "fit",
    "identify",
    "inspect",
    "iter_log",
    "load_rig",
    "predict_sensor",
    "read_log",
    "read_record",
    "read_sensor",
    "run_demo",
    "sensor_from_current",
    "sensor_from_dip",
    "sensor_from_noise",
    "sensor_from_pair",
    "sensor_history",
    "simulate_campaign",
    "smooth",
    "view",
    "write_log",
    "write_record",
]

_MODULES = {  # public name: where it is defined
    "__version__": "tcdyn.version",
    "Conditioning": "tcdyn.rig.disk",
    "InputError": "tcdyn.core.errors",
    "load_rig": "tcdyn.rig.rigfile",
    "iter_log": "tcdyn.rig.log",
    "read_log": "tcdyn.rig.log",
    "write_log": "tcdyn.rig.log",
    "simulate_campaign": "tcdyn.simulate.campaign",
    "calibrate_disk": "tcdyn.workflows",
    "read_record": "tcdyn.rig.record",
    "write_record": "tcdyn.rig.record",
    "compensate_dataset": "tcdyn.workflows",
    "compensate_frame": "tcdyn.workflows",
    "compensate_log": "tcdyn.workflows",
    "estimate_beta": "tcdyn.workflows",
    "inspect": "tcdyn.workflows.inspect",
    "run_demo": "tcdyn.workflows",
    "Chain": "tcdyn.chain",
    "smooth": "tcdyn.smoothing",
    "view": "tcdyn.report.view",
    "IOData": "tcdyn.identification",
    "fit": "tcdyn.identification",
    "compare": "tcdyn.identification",
    "identify": "tcdyn.identification",
    "predict_sensor": "tcdyn.sensors",
    "read_sensor": "tcdyn.sensors",
    "sensor_from_current": "tcdyn.sensors",
    "sensor_from_dip": "tcdyn.sensors",
    "sensor_from_noise": "tcdyn.sensors",
    "sensor_from_pair": "tcdyn.sensors",
    "sensor_history": "tcdyn.sensors",
}

_SUBPACKAGES = (
    "campaign",
    "chain",
    "core",
    "design",
    "estimation",
    "heat",
    "identification",
    "io",
    "partition",
    "plots",
    "report",
    "rig",
    "sensors",
    "simulate",
    "smoothing",
    "tuning",
    "verify",
    "workflows",
)


def __getattr__(name: str) -> Any:
    """Import a public name, or a subpackage, at its first use."""
    if name in _SUBPACKAGES:
        return import_module(f"tcdyn.{name}")
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'tcdyn' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Public names and subpackages, whether imported or not."""
    return sorted([*__all__, *_SUBPACKAGES])


def _result_html(result: Any) -> Any:
    """A result as HTML for a notebook, with its figure."""
    return import_module("tcdyn.report.page").card_html(result)


# register the HTML of results where IPython runs
_get_shell = getattr(sys.modules.get("IPython"), "get_ipython", None)
_shell = None if _get_shell is None else _get_shell()
if _shell is not None:
    _shell.display_formatter.formatters["text/html"].for_type_by_name(
        "tcdyn.core.result", "Result", _result_html
    )
