"""Pictures of results: ``draw_x(result, ax) -> ax``, and figures made of them.

``draw`` picks the picture that tells most of a result; every other name below takes the result, or the part of it that
its first argument names, and a matplotlib axes. Each is imported when it is first used.

>>> import tcdyn.plots
>>> sorted(name for name in tcdyn.plots.__all__ if "plunge" in name)
['draw_plunge', 'draw_plunge_residuals']
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_ROOMS = {
    "pick": ("draw",),
    "calibration": (
        "draw_bearing", "draw_chain", "draw_error_histogram", "draw_lags", "draw_log", "draw_transducer",
    ),
    "plunge": (
        "draw_plunge", "draw_plunge_residuals",
        "draw_common_lag", "draw_design", "draw_differential_lags", "draw_entry", "draw_heat_transfer", "draw_holes",
        "draw_record",
    ),
    "identify": (
        "draw_band", "draw_bode", "draw_correlation", "draw_data", "draw_fit", "draw_poles",
        "draw_residuals", "draw_step",
    ),
    "compensate": ("draw_before_use", "draw_compensated", "draw_tradeoff"),
    "partition": (
        "draw_budget", "draw_exponent", "draw_lines", "draw_map", "draw_temperatures", "draw_unloading", "draw_ways",
    ),
    "around": ("draw_round", "draw_round_surface"),
    "transient": ("draw_junctions", "draw_referee", "draw_window_study"),
    "campaign": ("draw_beta", "draw_friction_coefficient", "draw_temperature", "draw_traction"),
    "conduction": ("draw_comparison", "draw_convergence", "draw_field", "draw_mesh_errors", "draw_profiles"),
}  # fmt: skip
_HOMES = {name: (room, name) for room, names in _ROOMS.items() for name in names}
_HOMES["draw_oven_residuals"] = ("calibration", "draw_residuals")
_HOMES["draw_map_errors"] = ("conduction", "draw_map")

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tcdyn.plots' has no attribute {name!r}")
    room, original = _HOMES[name]
    return getattr(import_module(f"tcdyn.plots.{room}"), original)


def __dir__() -> list[str]:
    return list(__all__)
