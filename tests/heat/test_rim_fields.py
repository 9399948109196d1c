"""Whole fields: the heat they hold is the heat that came in."""

from itertools import pairwise

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.heat.engine import free_decay, step_fields
from tcdyn.heat.modal import flux_density
from tcdyn.heat.rim import Mesh

MESH, B = Mesh(33, 53), 1.62e-3


@pytest.mark.parametrize("flux", ["hertz", "uniform", lambda z: np.exp(-((z / 1e-3) ** 2))])
@pytest.mark.parametrize("half_width", [0.9e-3, 1.62e-3, 2.7e-3])
def test_no_heat_is_lost_to_the_mesh_whatever_the_track(rim, flux, half_width):
    for nz in (13, 27, 53, 105):
        cells = np.full(nz, rim.width_m / (nz - 1))
        cells[[0, -1]] /= 2
        assert flux_density(flux, half_width, rim.width_m, nz) @ cells == pytest.approx(
            1.0, abs=1e-12
        )


def test_heat_flows_through_the_boundary_at_the_rate_it_enters_when_nothing_else_cools(rim):
    """No film and almost no washer: all 100 W leave through r = R_i."""
    from dataclasses import replace

    insulated = replace(rim, washer_W_m2K=1e-9)
    inputs = [100.0, 50.0, 50.0, 50.0, 50.0]
    field = step_fields(insulated, 0.0, B, inputs, inputs, [0.0], mesh=MESH)[0]
    dr, dz = rim.thickness_m / 32, rim.width_m / 52
    weight = np.ones(53)
    weight[[0, -1]] = 0.5
    through = rim.conductivity_W_mK * (field[1] - field[0]) / dr @ weight * dz
    through *= 2 * np.pi * (rim.inner_radius_m + dr / 2)
    # the scheme's outer node takes in 1 - (dr/2R)^2 of the heat: 6e-6 here
    assert through == pytest.approx(100.0, rel=1e-5)


def test_a_step_starts_from_the_old_steady_state_and_ends_in_the_new(rim):
    before, after = [0.0, 60, 60, 60, 60], [200.0, 70, 72, 70, 55]
    start, end = step_fields(rim, 700.0, B, before, after, [0.0, 60.0], mesh=MESH)
    np.testing.assert_allclose(start[1:], 60.0, atol=1e-8)
    steady = step_fields(rim, 700.0, B, after, after, [0.0], mesh=MESH)[0]
    np.testing.assert_allclose(end, steady, atol=1e-8)


def test_a_free_field_only_falls(rim):
    start = np.zeros((33, 53))
    start[16:, 10:40] = 1.0
    tops = [free_decay(rim, 700.0, start, t, MESH).max() for t in (0.05, 0.2, 0.8, 3.0)]
    assert all(a > b for a, b in pairwise(tops))


def test_wrong_shapes_are_refused(rim):
    with pytest.raises(InputError, match="needed are"):
        step_fields(rim, 700.0, B, [1.0], [1.0], [0.0], mesh=MESH)
    with pytest.raises(InputError, match="all nodes"):
        free_decay(rim, 700.0, np.zeros((3, 3)), 1.0, MESH)
    with pytest.raises(InputError, match="at least 7 nodes"):
        Mesh(3, 3)
