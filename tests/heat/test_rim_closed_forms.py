"""Closed forms against limits, tabulated roots and each other."""

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.heat.reference import (
    penetration_depth_m,
    ring_eigenvalues,
    ring_steady_degC,
    ring_transient_degC,
    semi_infinite,
    slab_root,
    surface_steady_degC,
)


@pytest.fixture
def ring(rim):
    assert (rim.inner_radius_m, rim.outer_radius_m, rim.conductivity_W_mK) == (0.0321, 0.0381, 41.0)
    return rim


def test_half_space_has_the_initial_and_the_surface_temperature_as_limits():
    assert semi_infinite(3e-3, 1e-6, 20.0, 160.0, 1.1e-5) == pytest.approx(20.0)
    assert semi_infinite(3e-3, 1e9, 20.0, 160.0, 1.1e-5) == pytest.approx(160.0, abs=0.01)


def test_slab_root_matches_the_tabulated_one():
    # Carslaw and Jaeger, table I of appendix IV
    assert slab_root(1.0) == pytest.approx(0.8603, abs=5e-5)
    assert slab_root(0.01) == pytest.approx(0.0998, abs=5e-5)
    with pytest.raises(InputError):
        slab_root(0.0)


def test_eigenvalues_of_a_thin_ring_match_those_of_a_slab():
    """For R >> thickness the curvature vanishes: mu L cot(mu L) = -Bi, with the first root 2.0288
    for Bi = 1."""
    thin = ring_eigenvalues(1.0, 1.006, 1.0 / 0.006, 3) * 0.006
    # the remaining effect of curvature is 0.006/1
    np.testing.assert_allclose(thin, [2.0288, 4.9132, 7.9787], rtol=2e-3)


def test_series_starts_at_the_initial_and_settles_at_the_steady_temperature(ring):
    r = np.linspace(0.0325, 0.0375, 6)
    # the error of 60 modes after 1 ms is of the order of exp(-alpha mu_60^2 t)
    early, late = ring_transient_degC(ring, r, [1e-3, 60.0], 700.0, 1e5, 20.0, 10.0, 20.0)
    np.testing.assert_allclose(early[:4], 20.0, atol=1e-3)
    np.testing.assert_allclose(late, ring_steady_degC(ring, r, 700.0, 1e5, 20.0, 10.0), atol=1e-6)


def test_steady_surface_satisfies_the_heat_balance(ring):
    surface_degC = surface_steady_degC(ring, 700.0, 1e5, 20.0, 10.0)
    conducted_W_m2 = 41.0 * (surface_degC - 20.0) / (0.0381 * np.log(0.0381 / 0.0321))
    # heat balance at the surface, per area
    assert conducted_W_m2 == pytest.approx(1e5 - 700.0 * (surface_degC - 10.0))


def test_penetration_depth_grows_with_the_square_root_of_time():
    assert penetration_depth_m(4.0, 1.1e-5) == pytest.approx(2 * penetration_depth_m(1.0, 1.1e-5))
