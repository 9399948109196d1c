"""Figures of results: functions ``draw_x(result, ax) -> ax``, and figures made of them.

``draw`` chooses the main figure of a result. Every other function takes the result, or the
component that its first argument names, and matplotlib axes. No function computes an estimate:
import contracts keep figures above the estimators. The style is in ``tcdyn/plots/style.py``.

>>> import tcdyn.plots
>>> sorted(name for name in tcdyn.plots.__all__ if "plunge" in name)
['draw_plunge', 'draw_plunge_residuals']
"""

from tcdyn.plots.calibration import (
    draw_bearing,
    draw_chain,
    draw_error_histogram,
    draw_lags,
    draw_log,
    draw_touches,
)
from tcdyn.plots.calibration import draw_residuals as draw_oven_residuals
from tcdyn.plots.campaign import draw_beta, draw_junction_map, draw_quantity
from tcdyn.plots.circumferential import draw_middle_plane, draw_running_surface
from tcdyn.plots.compensate import draw_compensated, draw_filter_report
from tcdyn.plots.conduction import (
    draw_comparison,
    draw_convergence,
    draw_mesh_errors,
)
from tcdyn.plots.history import draw_history
from tcdyn.plots.identify import (
    draw_band,
    draw_bode,
    draw_correlation,
    draw_data,
    draw_fit,
    draw_poles,
    draw_residuals,
    draw_step,
)
from tcdyn.plots.inspect import draw_inspected
from tcdyn.plots.partition import (
    draw_beta_by_exponent,
    draw_beta_estimates,
    draw_budget,
    draw_lines,
    draw_map,
    draw_temperatures,
    draw_unloading,
)
from tcdyn.plots.pick import draw
from tcdyn.plots.plunge import (
    draw_common_lag,
    draw_design,
    draw_holes,
    draw_plunge,
    draw_plunge_residuals,
)
from tcdyn.plots.transient import draw_inverse_check, draw_junctions, draw_window_study
from tcdyn.plots.tune import draw_tuning

__all__ = [
    "draw",
    "draw_band",
    "draw_bearing",
    "draw_beta",
    "draw_beta_by_exponent",
    "draw_beta_estimates",
    "draw_bode",
    "draw_budget",
    "draw_chain",
    "draw_common_lag",
    "draw_comparison",
    "draw_compensated",
    "draw_convergence",
    "draw_correlation",
    "draw_data",
    "draw_design",
    "draw_error_histogram",
    "draw_filter_report",
    "draw_fit",
    "draw_history",
    "draw_holes",
    "draw_inspected",
    "draw_inverse_check",
    "draw_junction_map",
    "draw_junctions",
    "draw_lags",
    "draw_lines",
    "draw_log",
    "draw_map",
    "draw_mesh_errors",
    "draw_middle_plane",
    "draw_oven_residuals",
    "draw_plunge",
    "draw_plunge_residuals",
    "draw_poles",
    "draw_quantity",
    "draw_residuals",
    "draw_running_surface",
    "draw_step",
    "draw_temperatures",
    "draw_touches",
    "draw_tuning",
    "draw_unloading",
    "draw_window_study",
]
