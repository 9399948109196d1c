"""Pictures of the rim model: fields, boundary profiles, maps of beta and h, and the checks of section 3.6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tcdyn.heat.modal import spectrum
from tcdyn.heat.rim import MESH_IV, Mesh, Point, Profile, Rim
from tcdyn.plots.style import DARK, FAST, SLOW, TRUTH, dressed, pictured
from tcdyn.verify.studies import IDEAL_TIMES_S, ClosedForm, Convergence, MeshErrors


def draw_field(
    field_degC: ArrayLike, rim: Rim, ax: Axes, *, points: Mapping[str, Point] | None = None
) -> Axes:
    """Isotherms of a field (nr, nz) [degC] over z and depth, the running surface on top; junctions by name."""
    field = np.asarray(field_degC, dtype=float)
    depth = np.linspace(rim.thickness_m, 0.0, field.shape[0]) * 1e3
    z = np.linspace(0.0, rim.width_m, field.shape[1]) * 1e3
    filled = ax.contourf(z, depth, field, levels=14, cmap="inferno")
    ax.figure.colorbar(filled, ax=ax, label="temperature [°C]")
    for name, (d, at) in (points or {}).items():
        ax.plot(at * 1e3, d * 1e3, "o", color="white", markeredgecolor=TRUTH, markersize=5)
        ax.annotate(
            name, (at * 1e3, d * 1e3), xytext=(5, 3), textcoords="offset points", color="white"
        )
    ax.invert_yaxis()
    return dressed(ax, "z [mm]", "depth [mm]")


def draw_profiles(
    rim: Rim, readings_degC: Sequence[float], ambient_degC: float, ax: Axes, mesh: Mesh = MESH_IV
) -> Axes:
    """Figure 3.8: the three boundary profiles through readings of the inner row along r = R_i."""
    z = np.linspace(0.0, rim.width_m, mesh.nz)
    k = len(readings_degC)
    kinds: tuple[Profile, ...] = ("quadratic", "quartic", "modal")
    for kind, style in zip(kinds, ("-", "--", ":")):
        basis = spectrum(rim, 0.0, rim.width_m / 4, kind, "uniform", mesh).profile
        line = np.asarray(readings_degC) @ basis[:k] + ambient_degC * basis[k:].sum(axis=0)
        ax.plot(z * 1e3, line, style, label=kind)
    ax.plot(np.array(rim.boundary_z_m) * 1e3, readings_degC, "ko", label="inner row")
    return dressed(ax, "z [mm]", "temperature at R_i [°C]", legend=True)


def draw_comparison(check: ClosedForm, ax: Axes) -> Axes:
    """A closed form (line) and the scheme (dots), with the error in percent on the right."""
    ax.plot(check.x, check.exact, color=SLOW, label="closed form")
    step = max(len(check.x) // 25, 1)
    ax.plot(check.x[::step], check.scheme[::step], "o", color=FAST, markersize=4, label="scheme")
    right = ax.twinx()
    right.plot(check.x, check.error_percent, ":", color=DARK, linewidth=1.0)
    right.set_ylabel("error [%] (dotted)", color=DARK)
    return dressed(ax, check.x_label, "temperature [°C]", head=check.title, loc="center right")


def draw_convergence(checks: Sequence[Convergence], ax: Axes) -> Axes:
    """Largest error against the number of nodes, log-log, with the fitted orders."""
    for check, style in zip(checks, ("o-", "s--", "^:")):
        ax.loglog(
            check.nodes, check.error_K, style, label=f"{check.title}: order {check.order:.2f}"
        )
        ax.set_xticks(check.nodes, [f"{n}" for n in check.nodes])
    ax.minorticks_off()
    return dressed(ax, "nodes in r", "largest error [K]", legend=True)


def draw_mesh_errors(
    ours: Mapping[str, MeshErrors],
    published: Mapping[str, Sequence[float]],
    ax: Axes,
    part: str = "maximum",
) -> Axes:
    """Tables 3.2 or 3.3: errors against mesh IV in time, ours (lines) and published (crosses)."""
    for k, (name, errors) in enumerate(ours.items()):
        colour = (TRUTH, FAST, SLOW)[k % 3]
        marker = "os^"[k % 3]
        line = ("-", "--", "-.")[k % 3]
        ax.semilogy(
            IDEAL_TIMES_S,
            getattr(errors, part),
            marker,
            color=colour,
            linestyle=line,
            label=f"mesh {name}",
        )
        ax.semilogy(IDEAL_TIMES_S, published[name], "x", color=colour)
    return dressed(ax, "time [s]", f"{part} error against mesh IV [%]", title="crosses: published")


def draw_map(error_K: ArrayLike, h_W_m2K: ArrayLike, share: ArrayLike, ax: Axes) -> Axes:
    """The steady map of chapter 4: misfit (H, B) [K] over film coefficient and share of the heat."""
    filled = ax.contourf(
        np.asarray(h_W_m2K), np.asarray(share), np.asarray(error_K).T, levels=20, cmap="viridis"
    )
    ax.figure.colorbar(filled, ax=ax, label="misfit [K]")
    return dressed(ax, "h [W/m²K]", "share of the heat")


def verify_figures() -> dict[str, Figure]:
    """The pictures of the verification report, by caption."""
    from tcdyn.verify import studies
    from tcdyn.verify.rim_rows import TABLE_3_2

    draws = {
        c.title: partial(draw_comparison, c)
        for c in (studies.transient_check(), studies.steady_check())
    }
    orders = [studies.series_convergence(), studies.product_convergence()]
    ours = studies.ideal_study(late_steps=1)
    draws |= {
        "order of convergence against two closed forms": partial(draw_convergence, orders),
        "table 3.2: ours with the heat one step late (lines), published (crosses)": partial(
            draw_mesh_errors, ours, TABLE_3_2
        ),
    }
    return {caption: pictured(draw, width_in=6.4, height_in=3.6) for caption, draw in draws.items()}
