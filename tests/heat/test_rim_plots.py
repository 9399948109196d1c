"""Plots are drawn from results and return their axes."""

import numpy as np
from matplotlib.figure import Figure

from tcdyn.plots import conduction as plots
from tcdyn.verify.studies import ClosedForm, Convergence, MeshErrors


def axes():
    return Figure().subplots()


def test_every_plot_returns_the_given_axes():
    x = np.linspace(1.0, 2.0, 5)
    comparison = ClosedForm("t", "x", x, x, x + 0.01)
    errors = {"I": MeshErrors((1.0, 0.5, 0.2, 0.1), (1.0, 0.5, 0.2, 0.1))}
    for draw, args in (
        (plots.draw_comparison, (comparison,)),
        (plots.draw_convergence, ([Convergence("c", (9, 17), (0.4, 0.1))],)),
        (plots.draw_mesh_errors, (errors, {"I": (1.0, 0.5, 0.2, 0.1)})),
    ):
        ax = axes()
        assert draw(*args, ax) is ax
