"""Plots are drawn from results and return their axes."""

import numpy as np
from matplotlib.figure import Figure

from tcdyn.heat.rim import Mesh
from tcdyn.plots import conduction as plots
from tcdyn.verify.studies import ClosedForm, Convergence, MeshErrors


def axes():
    return Figure().subplots()


def test_every_plot_returns_the_given_axes(rim, points):
    x = np.linspace(1.0, 2.0, 5)
    comparison = ClosedForm("t", "x", x, x, x + 0.01)
    errors = {"I": MeshErrors((1.0, 0.5, 0.2, 0.1), (1.0, 0.5, 0.2, 0.1))}
    field = np.add.outer(np.arange(9.0), np.arange(14.0))
    for draw, args in (
        (plots.draw_field, (field, rim)),
        (plots.draw_profiles, (rim, [80.0, 83.0, 81.0], 55.0)),
        (plots.draw_comparison, (comparison,)),
        (plots.draw_convergence, ([Convergence("c", (9, 17), (0.4, 0.1))],)),
        (plots.draw_mesh_errors, (errors, {"I": (1.0, 0.5, 0.2, 0.1)})),
    ):
        ax = axes()
        assert draw(*args, ax) is ax


def test_field_plot_labels_the_junctions_and_has_the_running_surface_on_top(rim, points):
    ax = axes()
    plots.draw_field(
        np.add.outer(np.arange(9.0), np.zeros(14)),
        rim,
        ax,
        points=dict(zip("ace", points, strict=True)),
    )
    assert [t.get_text() for t in ax.texts] == ["a", "c", "e"]
    np.testing.assert_allclose(
        [t.xy for t in ax.texts], [(1e3 * z, 1e3 * depth) for depth, z in points]
    )
    assert ax.yaxis_inverted()


def test_profile_plot_passes_through_the_readings(rim):
    ax = axes()
    plots.draw_profiles(rim, [80.0, 83.0, 81.0], 55.0, ax, Mesh(9, 105))
    for line in ax.lines[:3]:
        # tolerance: linear interpolation between nodes
        np.testing.assert_allclose(
            np.interp(np.array(rim.boundary_z_m) * 1e3, *line.get_data()),
            [80.0, 83.0, 81.0],
            atol=5e-3,
        )
