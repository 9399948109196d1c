"""The finite-volume sensors against closed forms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import j0, j1, jn_zeros

from tests.sensors.layered_world import (
    AIR_K,
    CAPACITY,
    CORE_K,
    MEDIA,
    SHEATH_K,
    drawn,
    layered,
    plunge_record,
    surface_h,
)


def test_a_homogeneous_sensor_is_the_closed_form_of_a_cylinder() -> None:
    """Eigenvalues z J1(z) = Bi J0(z); mean over the core 2 J1(z c)/(z c) (Carslaw and Jaeger,
    7.7)."""
    d, k, stored, core, biot = 3e-3, 3.0, 3e6, 0.3, 2.0
    radius = d / 2
    made = [
        layered(
            d,
            core,
            0.12,
            k,
            biot * k / radius,
            k_core=k,
            k_sheath=k,
            capacity=(stored,) * 3,
            refine=refine,
        )
        for refine in (1, 2)
    ]
    bounds = np.r_[1e-9, jn_zeros(0, 40)]
    z = np.array([brentq(lambda x: x * j1(x) - biot * j0(x), a, b) for a, b in pairwise(bounds)])
    fourier_s = radius**2 * stored / k
    share = 2 * j1(z) / (z * (j0(z) ** 2 + j1(z) ** 2)) * 2 * j1(z * core) / (z * core)
    t = np.array([0.02, 0.1, 0.3, 1.0, 2.0]) * fourier_s
    closed = 1 - np.exp(-np.outer(t, z**2) / fourier_s) @ share
    errors = [np.abs(one.step(t) - closed).max() for one in made]
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 3.5  # second order
    assert made[1].taus_s.max() == pytest.approx(fourier_s / z[0] ** 2, rel=1e-4)


def test_the_lag_is_stored_heat_times_resistance_and_the_grid_is_fine_enough() -> None:
    """Lag = integral of q/(k r) from each radius, q the heat stored within (Laplace at s = 0)."""
    d, core, wall, k, h, gap = 4e-3, 0.25, 0.13, 2.0, 3000.0, 30e-6
    limits = d / 2 * np.array([0, core, 1 - 2 * wall, 1])
    r = np.concatenate([np.linspace(a, b, 20001)[1:] for a, b in pairwise(limits)])
    r = np.r_[0.0, r]
    middle = (r[1:] + r[:-1]) / 2
    zone = np.repeat(range(3), 20000)
    stored = np.cumsum(np.array(CAPACITY)[zone] * np.diff(r**2) / 2)
    within = stored - np.array(CAPACITY)[zone] * (r[1:] ** 2 - middle**2) / 2
    drop = within / np.array([CORE_K, k, SHEATH_K])[zone] / middle * np.diff(r)
    at_axis = drop.sum() + stored[39999] * gap / AIR_K / limits[2] + stored[-1] / (h * d / 2)
    mean_core = at_axis - CAPACITY[0] / CORE_K * limits[1] ** 2 / 8
    lags = [layered(d, core, wall, k, h, gap, refine=n).lag_s for n in (1, 2, 4)]
    errors = np.array(lags) / mean_core - 1
    assert abs(errors[0]) < 2e-4
    assert abs(errors[2]) < abs(errors[0]) / 8
    assert layered(d, core, wall, k, h, gap).shares.sum() == pytest.approx(1)


def test_the_response_to_a_ramp_lags_by_the_lag_and_a_step_agrees_with_the_modes() -> None:
    made = drawn(np.random.default_rng(1), "water").with_stem(0.1, 5.0)
    dt = made.lag_s / 200
    t = np.arange(9000) * dt
    assert (t - made.follow(t, dt))[-1] == pytest.approx(made.lag_s, rel=1e-6)
    assert made.follow(1 - np.exp(-t / 0.3), dt) == pytest.approx(made.step(t, 0.3), abs=2e-4)
    assert made.step(made.times_s()[2])[0] == pytest.approx(0.9)
    on = np.r_[0.0, np.ones(8999)]
    assert made.heat(on, dt)[-1] == pytest.approx(1.0)
    assert np.all(made.heat(on, dt)[2:1500] > made.follow(on, dt)[2:1500])


@pytest.mark.parametrize(
    ("medium", "low", "high"), [("water", 500, 4e4), ("oil", 60, 4e3), ("air", 10, 500)]
)
def test_drawn_sensors_have_surface_coefficients_of_their_medium(
    medium: str, low: float, high: float
) -> None:
    rng = np.random.default_rng(2)
    made = [drawn(rng, medium) for _ in range(40)]
    h = [surface_h(medium, s.diameter_m, s.speed_m_s) for s in made]
    assert low < min(h) < max(h) < high
    assert 8 < sum(s.gap_m > 0 for s in made) < 32
    for s in made:
        t50, t63, t90 = s.times_s()
        assert t50 < t63 < t90
        assert s.lag_s > 0
    assert set(MEDIA) == {"water", "oil", "air"}


@pytest.mark.parametrize("known", [True, False])
def test_a_record_has_the_sensor_s_response_after_the_entry(known: bool) -> None:
    rng = np.random.default_rng(3)
    sensor = drawn(rng, "water", diameter_m=3e-3)
    made = plunge_record(sensor, rng, entry_known=known, noise_K=0.05)
    after = made.time_s - made.true_entry_s
    model = made.y_degC[0] + made.step_K * sensor.step(after, made.true_medium_s)
    assert np.std(made.y_degC - model) == pytest.approx(0.05, rel=0.2)
    assert (made.entry_s is not None) == known
