"""Order of convergence in the mesh, against closed forms: second order, as section 3.3.2 states."""

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.heat.engine import free_decay, step_fields
from tcdyn.heat.modal import rim_gains
from tcdyn.heat.reference import product_decay_K, ring_steady_degC, ring_transient_degC
from tcdyn.heat.rim import Mesh, basis_rates

H = 700.0


def order(errors):
    """Fitted slope of log error against log mesh size, for meshes that double."""
    return -np.polyfit(np.arange(len(errors)), np.log2(errors), 1)[0]


def test_convergence_is_second_order_for_a_hollow_cylinder(rim):
    """Fixed inner surface, uniform flux and surface cooling, from one temperature (sections 3.6.2
    and 3.6.3)."""
    rim = replace(rim, washer_W_m2K=0.0)
    ri = rim.inner_radius_m
    ro = rim.outer_radius_m
    w = rim.width_m
    power = 300.0
    errors = []
    flux = power / (2 * np.pi * ro * w)
    for n in (9, 17, 33, 65):
        r = np.linspace(ri, ro, n)
        field = step_fields(
            rim,
            H,
            w / 2,
            [0, 20, 20, 20, 20],
            [power, 20, 20, 20, 10],
            [0.3, 2.0],
            flux="uniform",
            mesh=Mesh(n, 9),
        )
        exact = ring_transient_degC(rim, r, [0.3, 2.0], H, flux, 20, 10, 20)
        errors.append(np.abs(field[:, :, 4] - exact).max())
    assert order(errors) > 1.9  # issue 3
    assert errors[-1] < 1e-3  # of a rise of 30 K


@pytest.mark.parametrize("washer", [182.5, 5000.0])
def test_convergence_is_second_order_for_a_field_that_varies_in_z(rim, washer):
    """The product solution, a case that the thesis does not test (section 3.6.3)."""
    rim = replace(rim, washer_W_m2K=washer)
    ri = rim.inner_radius_m
    ro = rim.outer_radius_m
    w = rim.width_m
    errors = []
    for n in (9, 17, 33, 65):
        mesh = Mesh(n, int(1.625 * (n - 1)) + 1)
        r = np.linspace(ri, ro, mesh.nr)
        z = np.linspace(0, w, mesh.nz)
        start, later = (product_decay_K(rim, r, z, t, H) for t in (0.0, 1.0))
        errors.append(np.abs(free_decay(rim, H, start, 1.0, mesh) - later).max())
    assert order(errors) > 1.9  # issue 3


def test_steady_ring_matches_the_logarithmic_solution(rim):
    """Equations (3.36), corrected, and (3.37); the error of the scheme with 65 nodes is below a
    millikelvin."""
    rim = replace(rim, washer_W_m2K=0.0)
    ri = rim.inner_radius_m
    ro = rim.outer_radius_m
    w = rim.width_m
    inputs = [300.0, 20, 20, 20, 15]
    field = step_fields(rim, H, w / 2, inputs, inputs, [0.0], flux="uniform", mesh=Mesh(65, 9))[0]
    exact = ring_steady_degC(
        rim, np.linspace(ri, ro, 65), H, 300.0 / (2 * np.pi * ro * w), 20.0, 15.0
    )
    assert np.abs(field[:, 4] - exact).max() < 1e-3


def test_convergence_at_the_junctions_is_second_order_for_a_hertz_track(rim, points):
    """The kinks of the parabola do not reduce the order, because each cell uses the exact integral
    of the flux."""
    inputs = np.array([230.0, 121.0, 124.0, 122.0, 70.0])
    meshes = [Mesh(17, 27), Mesh(33, 53), Mesh(65, 105), Mesh(257, 417)]
    *results, finest = (
        rim_gains(rim, H, points, 1.63e-3, basis_rates(1 / 75), mesh=mesh).static.T @ inputs
        for mesh in meshes
    )
    errors = [np.abs(result - finest).max() for result in results]
    assert order(errors) > 1.9
    assert errors[1] < 3e-3  # mesh III is used for fits with 0.1 K noise
    assert errors[2] < 1e-3
