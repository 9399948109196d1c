"""Signs of what the readings show more than predicted, on a rim that is a straight line in depth."""

from __future__ import annotations

import numpy as np

from tcdyn.partition.nuisance import nominal_effects, nominal_parameters
from tcdyn.rig.rigfile import load_rig

GRADIENT_K_m = 2000.0  # rise with radius: hotter towards the running surface


def test_a_deeper_junction_of_the_inner_row_shows_more_in_the_outer_row_and_one_that_reads_high_shows_less() -> (
    None
):
    """The inner row is taken to lie at its radius; deeper it reads too low, and so does all that is predicted from it.

    Of d, b and f a third each drives each of a, c, e; the rim is in steady state.
    """
    blocks = 2
    moved = np.zeros((10, blocks, 3))
    driven = np.zeros((10, blocks, 3))
    driven[:3] = 1 / 3  # a, c, e answer a third of a kelvin to a kelvin of d, b or f
    driven[3:6] = GRADIENT_K_m / 3  # and as much of what a metre of depth takes away
    driven[6:9] = 0.5 / 3  # all warm by half a kelvin a second
    moved[:3] = -GRADIENT_K_m * np.eye(3)[:, None]  # a, c or e itself, deeper, reads less
    found = nominal_effects(moved, driven, np.ones(blocks), np.full((blocks, 3), 0.5), np.eye(3))
    shows = {
        u.name: change[0]
        for u, change in zip(nominal_parameters(load_rig().disk_setup("fast")), found, strict=True)
    }
    for inner in "dbf":
        np.testing.assert_allclose(shows[f"depth {inner}"], GRADIENT_K_m / 3)
        np.testing.assert_allclose(shows[f"static {inner}"], -1 / 3)
        np.testing.assert_allclose(
            shows[f"lag {inner}"], 0.5 / 3
        )  # late, it reads too low while all warm
    np.testing.assert_allclose(shows["depth a"], [-GRADIENT_K_m, 0.0, 0.0])
    np.testing.assert_allclose(shows["static a"], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(shows["lag a"], [-0.5, 0.0, 0.0])
