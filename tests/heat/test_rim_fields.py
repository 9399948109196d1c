"""Temperature fields: heat balance, initial and final states."""

from itertools import pairwise

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.heat.engine import free_decay, step_fields
from tcdyn.heat.modal import flux_density
from tcdyn.heat.rim import Mesh

MESH = Mesh(33, 53)
B = 1.62e-3


@pytest.mark.parametrize("flux", ["hertz", "uniform", lambda z: np.exp(-((z / 1e-3) ** 2))])
@pytest.mark.parametrize("half_width", [0.9e-3, 1.62e-3, 2.7e-3])
def test_flux_density_integrates_to_one_on_every_mesh(rim, flux, half_width):
    for nz in (13, 27, 53, 105):
        cells = np.full(nz, rim.width_m / (nz - 1))
        cells[[0, -1]] /= 2
        assert flux_density(flux, half_width, rim.width_m, nz) @ cells == pytest.approx(
            1.0, abs=1e-12
        )


def test_heat_leaves_through_the_inner_boundary_at_the_rate_it_enters(rim):
    """No surface cooling and nearly no washer conduction: all 100 W leave through r = R_i."""
    from dataclasses import replace

    insulated = replace(rim, washer_W_m2K=1e-9)
    inputs = [100.0, 50.0, 50.0, 50.0, 50.0]
    field = step_fields(insulated, 0.0, B, inputs, inputs, [0.0], mesh=MESH)[0]
    dr = rim.thickness_m / 32
    dz = rim.width_m / 52
    weight = np.ones(53)
    weight[[0, -1]] = 0.5
    conducted_W = rim.conductivity_W_mK * (field[1] - field[0]) / dr @ weight * dz
    conducted_W *= 2 * np.pi * (rim.inner_radius_m + dr / 2)
    # the outer node of the scheme receives 1 - (dr/2R)^2 of the heat: 6e-6 less
    assert conducted_W == pytest.approx(100.0, rel=1e-5)


def test_step_starts_and_ends_in_the_steady_states(rim):
    before = [0.0, 60, 60, 60, 60]
    after = [200.0, 70, 72, 70, 55]
    start, end = step_fields(rim, 700.0, B, before, after, [0.0, 60.0], mesh=MESH)
    np.testing.assert_allclose(start[1:], 60.0, atol=1e-8)
    steady = step_fields(rim, 700.0, B, after, after, [0.0], mesh=MESH)[0]
    np.testing.assert_allclose(end, steady, atol=1e-8)


def test_free_decay_has_a_decreasing_maximum(rim):
    start = np.zeros((33, 53))
    start[16:, 10:40] = 1.0
    maxima = [free_decay(rim, 700.0, start, t, MESH).max() for t in (0.05, 0.2, 0.8, 3.0)]
    assert all(a > b for a, b in pairwise(maxima))


def test_invalid_shapes_raise(rim):
    with pytest.raises(InputError, match="needed are"):
        step_fields(rim, 700.0, B, [1.0], [1.0], [0.0], mesh=MESH)
    with pytest.raises(InputError, match="all nodes"):
        free_decay(rim, 700.0, np.zeros((3, 3)), 1.0, MESH)
    with pytest.raises(InputError, match="at least 7 nodes"):
        Mesh(3, 3)
