"""Signs of the effects of nuisance parameters, on a rim whose temperature is linear in depth."""

from __future__ import annotations

import numpy as np

from tcdyn.partition.nuisance import nominal_effects, nominal_parameters
from tcdyn.rig.rigfile import load_rig

GRADIENT_K_m = 2000.0  # rise with radius: hotter towards the running surface


def test_signs_of_depth_static_and_lag_effects_of_both_rows() -> None:
    """A deeper junction of the inner row raises the readings of the outer row; one that reads high
    lowers them.

    The inner row is assumed at its radius; a deeper junction reads too low, and so is everything
    predicted from it. d, b and f each drive a third of each of a, c, e; the rim is in steady state.
    """
    blocks = 2
    outer_row_change = np.zeros((10, blocks, 3))
    inner_row_change = np.zeros((10, blocks, 3))
    inner_row_change[:3] = 1 / 3  # a, c, e respond by a third of a kelvin to a kelvin of d, b or f
    inner_row_change[3:6] = GRADIENT_K_m / 3  # and by a third of the change with depth
    inner_row_change[6:9] = 0.5 / 3  # all warm up by half a kelvin per second
    # a deeper junction a, c or e reads less
    outer_row_change[:3] = -GRADIENT_K_m * np.eye(3)[:, None]
    effects = nominal_effects(
        outer_row_change, inner_row_change, np.ones(blocks), np.full((blocks, 3), 0.5), np.eye(3)
    )
    effect_of = {
        parameter.name: change[0]
        for parameter, change in zip(
            nominal_parameters(load_rig().disk_setup("fast")), effects, strict=True
        )
    }
    for inner in "dbf":
        np.testing.assert_allclose(effect_of[f"depth {inner}"], GRADIENT_K_m / 3)
        np.testing.assert_allclose(effect_of[f"static {inner}"], -1 / 3)
        # a late channel reads too low while all warm up
        np.testing.assert_allclose(effect_of[f"lag {inner}"], 0.5 / 3)
    np.testing.assert_allclose(effect_of["depth a"], [-GRADIENT_K_m, 0.0, 0.0])
    np.testing.assert_allclose(effect_of["static a"], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(effect_of["lag a"], [-0.5, 0.0, 0.0])
