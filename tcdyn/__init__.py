"""Thermocouple dynamics and heat partition: calibrate disks, compensate logged traces, estimate beta.

The names below read as the workflow; each is imported when it is first used, so that ``import tcdyn`` is quick.

>>> import tcdyn
>>> round(tcdyn.Chain([0.6, 0.1], conditioning=tcdyn.Conditioning(cutoff_Hz=4.0, poles=2)).lag_s, 3)
0.78
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.disk import Conditioning
    from calibration.errors import InputError
    from calibration.log import iter_log, read_log, write_log
    from calibration.record import read_record, write_record
    from calibration.rig import load_rig
    from tcdyn.chain import Chain
    from tcdyn.compensate import smooth
    from tcdyn.identify import IOData, compare, fit
    from tcdyn.pipeline import (
        calibrate_disk,
        compensate_log,
        estimate_beta,
        estimate_one_disk,
        run_demo,
    )
    from tcdyn.simulate.campaign import simulate_campaign
    from tcdyn.version import __version__

__all__ = [
    "Chain",
    "Conditioning",
    "IOData",
    "InputError",
    "__version__",
    "calibrate_disk",
    "compare",
    "compensate_log",
    "estimate_beta",
    "estimate_one_disk",
    "fit",
    "iter_log",
    "load_rig",
    "read_log",
    "read_record",
    "run_demo",
    "simulate_campaign",
    "smooth",
    "write_log",
    "write_record",
]

_MODULES = {  # public name: where it is defined
    "__version__": "tcdyn.version",
    "Conditioning": "calibration.disk",
    "InputError": "calibration.errors",
    "load_rig": "calibration.rig",
    "iter_log": "calibration.log",
    "read_log": "calibration.log",
    "write_log": "calibration.log",
    "simulate_campaign": "tcdyn.simulate.campaign",
    "calibrate_disk": "tcdyn.pipeline",
    "read_record": "calibration.record",
    "write_record": "calibration.record",
    "compensate_log": "tcdyn.pipeline",
    "estimate_beta": "tcdyn.pipeline",
    "estimate_one_disk": "tcdyn.pipeline",
    "run_demo": "tcdyn.pipeline",
    "Chain": "tcdyn.chain",
    "smooth": "tcdyn.compensate",
    "IOData": "tcdyn.identify",
    "fit": "tcdyn.identify",
    "compare": "tcdyn.identify",
}

_SUBPACKAGES = (
    "campaign",
    "chain",
    "compensate",
    "conduction",
    "contact",
    "design",
    "identify",
    "partition",
    "pipeline",
    "plots",
    "plunge",
    "sensor",
    "simulate",
    "verify",
)


def __getattr__(name: str) -> Any:
    """Import a public name, or a subpackage, when it is first used."""
    if name in _SUBPACKAGES:
        return import_module(f"tcdyn.{name}")
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'tcdyn' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Public names and subpackages, imported already or not."""
    return sorted([*__all__, *_SUBPACKAGES])


def _card(result: Any) -> Any:
    """A result as a notebook shows it, with its picture."""
    return import_module("tcdyn.report.page").card_html(result)


_get_shell = getattr(sys.modules.get("IPython"), "get_ipython", None)
_shell = None if _get_shell is None else _get_shell()
if _shell is not None:
    _shell.display_formatter.formatters["text/html"].for_type_by_name(
        "calibration.result", "Result", _card
    )
