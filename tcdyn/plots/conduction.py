"""Figures of the rim model: fields, profiles, maps of beta and h, checks of section 3.6.

Used by the verification report (:func:`verify_figures`, called by ``tcdyn verify``) and by the
gallery of the manual. Test: ``tests/heat/test_rim_plots.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tcdyn.heat.modal import spectrum
from tcdyn.heat.rim import MESH_IV, Mesh, Point, Profile, Rim
from tcdyn.plots.style import (
    DARK,
    FAST,
    SLOW,
    TRUTH,
    axes_of,
    log_axis,
    panel_figure,
    style_axes,
)
from tcdyn.verify import studies
from tcdyn.verify.rim_rows import TABLE_3_2
from tcdyn.verify.studies import IDEAL_TIMES_S, ClosedForm, Convergence, MeshErrors


def draw_field(
    field_degC: ArrayLike,
    rim: Rim,
    ax: Axes | None = None,
    *,
    points: Mapping[str, Point] | None = None,
) -> Axes:
    """Plot the isotherms of a temperature field over z and depth, the running surface on top.

    Parameters
    ----------
    field_degC
        Temperatures (nr, nz) from the bore to the running surface [degC].
    rim
        The rim, for its dimensions.
    ax
        Axes to plot into; None: those of a new figure.
    points
        Junctions by name: (depth, z) [m].

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    field = np.asarray(field_degC, dtype=float)
    depth_mm = np.linspace(rim.thickness_m, 0.0, field.shape[0]) * 1e3
    z_mm = np.linspace(0.0, rim.width_m, field.shape[1]) * 1e3
    filled = ax.contourf(z_mm, depth_mm, field, levels=14, cmap="inferno")
    ax.figure.colorbar(filled, ax=ax, label="temperature [°C]")
    for name, (depth_m, z_m) in (points or {}).items():
        position = (z_m * 1e3, depth_m * 1e3)
        ax.plot(*position, "o", color="white", markeredgecolor=TRUTH, markersize=5)
        ax.annotate(name, position, xytext=(5, 3), textcoords="offset points", color="white")
    ax.invert_yaxis()
    return style_axes(ax, "z [mm]", "depth [mm]")


def draw_profiles(
    rim: Rim,
    readings_degC: Sequence[float],
    ambient_degC: float,
    ax: Axes | None = None,
    mesh: Mesh = MESH_IV,
) -> Axes:
    """Plot three boundary profiles through readings of the inner row along r = R_i (figure 3.8).

    Parameters
    ----------
    rim
        The rim.
    readings_degC
        Readings of the inner row, in the order of ``rim.boundary_z_m``.
    ambient_degC
        Temperature of the air.
    ax
        Axes to plot into; None: those of a new figure.
    mesh
        Mesh of the profiles.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    z = np.linspace(0.0, rim.width_m, mesh.nz)
    n_readings = len(readings_degC)
    kinds: tuple[Profile, ...] = ("quadratic", "quartic", "modal")
    for kind, style in zip(kinds, ("-", "--", ":")):
        basis = spectrum(rim, 0.0, rim.width_m / 4, kind, "uniform", mesh).profile
        from_readings = np.asarray(readings_degC) @ basis[:n_readings]
        from_ambient = ambient_degC * basis[n_readings:].sum(axis=0)
        ax.plot(z * 1e3, from_readings + from_ambient, style, label=kind)
    ax.plot(np.array(rim.boundary_z_m) * 1e3, readings_degC, "ko", label="inner row")
    return style_axes(ax, "z [mm]", "temperature at R_i [°C]", legend=True)


def draw_comparison(check: ClosedForm, ax: Axes | None = None) -> Axes:
    """Plot a closed form (line), the scheme (dots) and the error in percent (right axis).

    Parameters
    ----------
    check
        A closed form and the scheme at the same positions.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    ax.plot(check.x, check.exact, color=SLOW, label="closed form")
    step = max(len(check.x) // 25, 1)
    ax.plot(check.x[::step], check.scheme[::step], "o", color=FAST, markersize=4, label="scheme")
    error_axis = ax.twinx()
    error_axis.plot(check.x, check.error_percent, ":", color=DARK, linewidth=1.0)
    error_axis.set_ylabel("error [%] (dotted)", color=DARK)
    return style_axes(ax, check.x_label, "temperature [°C]", title=check.title, loc="center right")


def draw_convergence(checks: Sequence[Convergence], ax: Axes | None = None) -> Axes:
    """Plot the largest error against the number of nodes, log-log, with the fitted orders.

    Parameters
    ----------
    checks
        At most three studies of the order of convergence.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    for check, style in zip(checks, ("o-", "s--", "^:")):
        label = f"{check.title}: order {check.order:.2f}"
        ax.plot(check.nodes, check.error_K, style, label=label)
    log_axis(ax, "x")
    log_axis(ax, "y")
    for check in checks:
        ax.set_xticks(check.nodes, [f"{n}" for n in check.nodes])
    ax.minorticks_off()
    return style_axes(ax, "nodes in r", "largest error [K]", legend=True)


def draw_mesh_errors(
    computed: Mapping[str, MeshErrors],
    published: Mapping[str, Sequence[float]],
    ax: Axes | None = None,
    statistic: str = "maximum",
) -> Axes:
    """Plot the errors against mesh IV in time: computed (lines) and of table 3.2 or 3.3 (crosses).

    Parameters
    ----------
    computed, published
        Errors by name of the mesh.
    ax
        Axes to plot into; None: those of a new figure.
    statistic
        "maximum" or "mean".

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    styles = ((TRUTH, "o", "-"), (FAST, "s", "--"), (SLOW, "^", "-."))
    for k, (name, errors) in enumerate(computed.items()):
        colour, marker, line = styles[k % 3]
        values = getattr(errors, statistic)
        style: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": line}
        ax.plot(IDEAL_TIMES_S, values, label=f"mesh {name}", **style)
        ax.plot(IDEAL_TIMES_S, published[name], "x", color=colour)
    log_axis(ax, "y")
    y = f"{statistic} error against mesh IV [%]"
    return style_axes(ax, "time [s]", y, legend_title="crosses: published")


def verify_figures() -> dict[str, Figure]:
    """Return the figures of the verification report by caption."""
    checks = (studies.transient_check(), studies.steady_check())
    orders = [studies.series_convergence(), studies.product_convergence()]
    mesh_errors = studies.ideal_study(late_steps=1)
    panels: dict[str, Callable[[Axes], Axes]] = {
        check.title: partial(draw_comparison, check) for check in checks
    }
    panels["order of convergence against two closed forms"] = partial(draw_convergence, orders)
    panels["table 3.2: ours with the heat one step late (lines), published (crosses)"] = partial(
        draw_mesh_errors, mesh_errors, TABLE_3_2
    )
    return {
        caption: panel_figure(draw, width_in=6.4, height_in=3.6) for caption, draw in panels.items()
    }
