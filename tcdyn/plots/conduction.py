"""Figures of the rim model's numerical scheme against closed forms and tables of section 3.6.

Used by the verification report (:func:`verify_figures`, called by ``tcdyn verify``) and by the
gallery of the manual. Test: ``tests/heat/test_rim_plots.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
) -> Axes:
    """Plot the largest errors against mesh IV in time: computed, and of table 3.2 or 3.3 (crosses).

    Parameters
    ----------
    computed, published
        Errors by name of the mesh.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    styles = ((TRUTH, "o", "-"), (FAST, "s", "--"), (SLOW, "^", "-."))
    for k, (name, errors) in enumerate(computed.items()):
        colour, marker, line = styles[k % 3]
        ax.plot(
            IDEAL_TIMES_S,
            errors.maximum,
            label=f"mesh {name}",
            color=colour,
            marker=marker,
            linestyle=line,
        )
        ax.plot(IDEAL_TIMES_S, published[name], "x", color=colour)
    log_axis(ax, "y")
    y = "maximum error against mesh IV [%]"
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
