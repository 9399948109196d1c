"""The fast radial model against exact solutions."""

from dataclasses import replace

import numpy as np
import pytest
from plunge_series import lumped_plunge, series_plunge

from immersion.correlations import Bath, correlation
from immersion.cylinder import Cylinder, influence
from immersion.fluids import fluid
from immersion.radial import plunge_grid, simulate_plunge_model
from tcdyn.rig.rigfile import load_rig

SETUP = load_rig().disk_setup("fast")
DISK = Cylinder.from_setup(SETUP)
DEPTHS = np.array([1.25e-3, 3e-3, 6e-3])


def constant(h):  # type: ignore[no-untyped-def]
    """A constant heat transfer coefficient."""
    return lambda T, F, t: np.full_like(T, h)


@pytest.mark.parametrize("h", [300.0, 2000.0])
@pytest.mark.parametrize("face", [0.0, 20.0])
def test_constant_h_matches_the_exact_series(h: float, face: float) -> None:
    disk = Cylinder.from_setup(SETUP, face)
    out = simulate_plunge_model(disk, DEPTHS, constant(h), 26.0, 110.0, 200.0)
    t = np.array([0.2, 0.5, 1.0, 3.0, 10.0, 50.0, 190.0])
    exact = series_plunge(disk, disk.outer_radius_m - DEPTHS, t, h, 26.0, 110.0)
    # linear between knots 1.2 s apart at 50 s: (dt/tau)^2/8 of 84 K with tau = 25 s is 0.02 K at h
    # = 2000, and the Volterra solution itself is closer; 2e-3 observed
    np.testing.assert_allclose(out.at(t, 0.0), exact, atol=5e-3)


def test_grid_refinement_converges_at_second_order() -> None:
    errors = []
    for n in (101, 201, 401):
        grid = 20.0 * np.linspace(0, 1, n) ** 2  # quadratic: the square-root start is smooth on it
        out = simulate_plunge_model(
            DISK, DEPTHS, constant(500.0), 26.0, 110.0, 20.0, grid_s=grid, modes=120
        )
        late_rows = [n // 2, 3 * n // 4, n - 1]
        exact = series_plunge(
            DISK, DISK.outer_radius_m - DEPTHS, grid[late_rows], 500.0, 26.0, 110.0
        )
        errors.append(np.max(np.abs(out.junction_degC[late_rows] - exact)))
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(order > 1.8)


def test_plunge_at_small_biot_number_is_a_single_exponential() -> None:
    copper = replace(DISK, conductivity_W_mK=4e5)  # Biot 1e-5: gradients of 1e-5 of the step
    out = simulate_plunge_model(copper, DEPTHS, constant(300.0), 20.0, 80.0, 300.0)
    t = np.array([1.0, 30.0, 100.0, 299.0])
    lumped = lumped_plunge(copper, t, 300.0, 20.0, 80.0)
    np.testing.assert_allclose(out.at(t, 0.0), np.repeat(lumped[:, None], 3, axis=1), atol=5e-3)


def test_modes_add_up_to_the_static_profile() -> None:
    r = DISK.outer_radius_m - np.array([0.0, *DEPTHS])
    _, gains = DISK.modes(r, 600)
    # the modes of the surface fall as 1/k^2: the tail after 600 is 1/600 of the leading one
    np.testing.assert_allclose(gains.sum(axis=1), DISK.static_profile(r), atol=2e-7)


def test_solid_disk_is_the_limit_of_a_small_bore() -> None:
    t = plunge_grid(60.0)
    solid = replace(DISK, inner_radius_m=0.0)
    small_bore = replace(DISK, inner_radius_m=1e-4)
    r = DISK.outer_radius_m - DEPTHS
    solid_response = influence(solid, r, t)[0]
    small_bore_response = influence(small_bore, r, t)[0]
    np.testing.assert_allclose(
        solid_response, small_bore_response, atol=2e-4 * np.max(solid_response)
    )


def test_stored_energy_equals_the_integrated_flux() -> None:
    bath = Bath(fluid("mobil-jet-ii"), correlation("5.4"), SETUP.width_m, 2 * SETUP.outer_radius_m)
    radii = np.linspace(DISK.inner_radius_m, DISK.outer_radius_m, 81)
    out = simulate_plunge_model(
        DISK, DISK.outer_radius_m - radii, lambda T, F, t: bath.h_W_m2K(T, F), 26.0, 110.0, 100.0
    )
    end = out.junction_degC[-1] - 26.0
    stored = DISK.heat_capacity_J_m3K * np.trapezoid(end * radii, radii)
    entered = DISK.outer_radius_m * np.trapezoid(out.flux_W_m2, out.t_s)
    assert stored == pytest.approx(entered, rel=2e-4)  # trapezoidal rule with 80 cells


def test_disk_lags_a_drifting_bath_by_its_time_constant() -> None:
    # after the initial transient a disk in a steadily warming bath lags it by rate times its time
    # constant
    rate = 0.01
    out = simulate_plunge_model(
        DISK, DEPTHS, constant(2000.0), 50.0, lambda t: 50.0 + rate * t, 400.0
    )
    tau = 1 / (DISK.mean_rate_K_m2_J * 2000.0)
    mean_lag = 50.0 + rate * out.t_s[-1] - out.surface_degC[-1]
    assert mean_lag == pytest.approx(rate * tau, rel=1e-3)
