"""Exact derivatives against differences of the gains they are derivatives of."""

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.conduction.bank import node_rates
from tcdyn.conduction.modal import rim_gains
from tcdyn.conduction.rim import Mesh
from tcdyn.conduction.sensitivity import PARAMETERS, rim_sensitivities

MESH, B, H = Mesh(33, 53), 1.62e-3, 700.0
STEPS = dict(zip(PARAMETERS, (0.7, 0.01, 1e3, 1e-6, 1e-6, 0.1, 1e-6), strict=True))


def moved(rim, points, rates, profile, **by):
    shift = by.get("point_depth_m", 0.0)
    other = replace(
        rim,
        conductivity_W_mK=rim.conductivity_W_mK + by.get("conductivity_W_mK", 0.0),
        specific_heat_J_kgK=rim.specific_heat_J_kgK + by.get("heat_capacity_J_m3K", 0.0) / rim.density_kg_m3,
        inner_radius_m=rim.inner_radius_m - by.get("inner_depth_m", 0.0),
        washer_W_m2K=rim.washer_W_m2K + by.get("washer_W_m2K", 0.0),
    )
    at = [(d + shift, z) for d, z in points]
    h, b = H + by.get("h_W_m2K", 0.0), B + by.get("half_width_m", 0.0)
    return rim_gains(other, h, at, b, rates, profile=profile, mesh=MESH)


@pytest.mark.parametrize("profile", ["modal", "quadratic"])
@pytest.mark.parametrize("name", PARAMETERS)
def test_slope_is_the_limit_of_differences(rim, points, profile, name):
    rates = node_rates(1 / 75)
    exact = rim_sensitivities(rim, H, points, B, rates, profile=profile, mesh=MESH).slopes[name]
    step = STEPS[name]
    up, down = (moved(rim, points, rates, profile, **{name: sign * step}) for sign in (1, -1))
    difference = (up.gains - down.gains) / (2 * step)
    # central differences of steps about 1e-3 of the value: second-order error near 1e-4 of the largest slope
    assert np.abs(difference - exact.gains).max() < 3e-4 * np.abs(exact.gains).max()


def test_steady_temperature_does_not_know_the_heat_capacity(rim, points):
    s = rim_sensitivities(rim, H, points, B, node_rates(1 / 75), mesh=MESH)
    slope = s.slopes["heat_capacity_J_m3K"]
    assert np.abs(slope.static).max() < 1e-7 * np.abs(slope.gains).max()


def test_values_are_those_of_the_gains(rim, points):
    rates = node_rates(1 / 75)
    s = rim_sensitivities(rim, H, points, B, rates, mesh=MESH)
    np.testing.assert_allclose(s.gains.gains, rim_gains(rim, H, points, B, rates, mesh=MESH).gains, atol=1e-12)
