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


def test_half_space_starts_at_its_start_and_ends_at_its_surface():
    assert semi_infinite(3e-3, 1e-6, 20.0, 160.0, 1.1e-5) == pytest.approx(20.0)
    assert semi_infinite(3e-3, 1e9, 20.0, 160.0, 1.1e-5) == pytest.approx(160.0, abs=0.01)


def test_slab_root_is_the_tabulated_one():
    assert slab_root(1.0) == pytest.approx(
        0.8603, abs=5e-5
    )  # Carslaw and Jaeger, table I of appendix IV
    assert slab_root(0.01) == pytest.approx(0.0998, abs=5e-5)
    with pytest.raises(InputError):
        slab_root(0.0)


def test_roots_of_a_thin_ring_are_those_of_a_slab():
    """With R >> thickness the curvature drops out: mu L cot(mu L) = -Bi, first root for Bi = 1: 2.0288."""
    thin = ring_eigenvalues(1.0, 1.006, 1.0 / 0.006, 3) * 0.006
    np.testing.assert_allclose(
        thin, [2.0288, 4.9132, 7.9787], rtol=2e-3
    )  # curvature leaves 0.006/1


def test_series_starts_at_the_start_and_settles_on_the_logarithm(ring):
    r = np.linspace(0.0325, 0.0375, 6)
    # what 60 modes cannot carry after 1 ms is exp(-alpha mu_60^2 t)
    early, late = ring_transient_degC(ring, r, [1e-3, 60.0], 700.0, 1e5, 20.0, 10.0, 20.0)
    np.testing.assert_allclose(early[:4], 20.0, atol=1e-3)
    np.testing.assert_allclose(late, ring_steady_degC(ring, r, 700.0, 1e5, 20.0, 10.0), atol=1e-6)


def test_steady_surface_balances_its_heat(ring):
    out = surface_steady_degC(ring, 700.0, 1e5, 20.0, 10.0)
    through = 41.0 * (out - 20.0) / (0.0381 * np.log(0.0381 / 0.0321))
    assert through == pytest.approx(1e5 - 700.0 * (out - 10.0))  # energy at the surface, per area


def test_penetration_grows_with_the_root_of_time():
    assert penetration_depth_m(4.0, 1.1e-5) == pytest.approx(2 * penetration_depth_m(1.0, 1.1e-5))
