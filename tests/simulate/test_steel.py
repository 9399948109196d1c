"""Synthetic disk with temperature-dependent steel: Kirchhoff's closed form, stored heat and
harmonics."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.partition.specified import linear_about
from tcdyn.rig.steel import SteelSlopes
from tcdyn.rig.tables import FluxProfile
from tcdyn.simulate.harmonics import harmonic_system
from tcdyn.simulate.implicit import integrate, steady_state
from tcdyn.simulate.mesh import DiskMesh, build_system, grid_of
from tcdyn.simulate.truth import BoreContact, DiskTruth, draw_truth

COARSE = DiskMesh(radial=40, axial=24, shaft_side=16)
SLOPES = SteelSlopes(-8e-4, 7e-4)
B = 1.62e-3


def disk_of(
    steel: SteelSlopes, washers: bool = True, amplitude: float = 0.0, **changes: float
) -> DiskTruth:
    """The fast disk with this steel; ``changes`` replace its other fields."""
    disk = draw_truth(0).fast
    setup = replace(
        disk.setup, steel=steel, **({} if washers else {"washer_conductivity_W_mK": 0.0})
    )
    return replace(disk, setup=setup, uneven=BoreContact(amplitude, 20.0), **changes)


def readings(disk: DiskTruth, power_W: float = 120.0, h_W_m2K: float = 700.0) -> dict[str, float]:
    """Steady readings by channel."""
    system = harmonic_system(disk, h_W_m2K, B, COARSE)
    return dict(zip(system.channels, system.sample @ steady_state(system, power_W, 60.0)))


def test_ring_between_hot_and_cold_obeys_kirchhoff_transform() -> None:
    """Uniform flux over the width, no washers: the integral of k dT between radii is Q ln(r2/r1) /
    (2 pi w)."""
    disk = disk_of(SLOPES, washers=False, bore_conductance_W_m2K=1e5, shaft_W_m2K=500.0)
    setup = replace(disk.setup, flux=FluxProfile("flat"))
    disk = replace(disk, setup=setup)
    system = build_system(disk, 0.0, setup.width_m / 2, COARSE)
    readings_by_channel = dict(
        zip(system.channels, system.sample @ steady_state(system, 500.0, 60.0))
    )
    assert readings_by_channel["e"] - readings_by_channel["b"] > 20

    def conducted(inner: str, outer: str) -> float:
        integral = quad(
            lambda t: setup.conductivity_W_mK * SLOPES.relative_conductivity(t),
            readings_by_channel[outer],
            readings_by_channel[inner],
        )[0]
        radii = [setup.outer_radius_m - setup.junctions[c].depth_m for c in (inner, outer)]
        return float(2 * np.pi * setup.width_m * integral / np.log(radii[0] / radii[1]))

    # the shaft cools the edges of the bore more than its middle: the flow is displaced there, by
    # half a per cent
    assert conducted("e", "a") == pytest.approx(500.0, rel=2e-3)
    assert conducted("a", "b") == pytest.approx(500.0, rel=5e-3)
    # a constant conductivity would give another flow
    of_constant_k = conducted("a", "b") / SLOPES.relative_conductivity(readings_by_channel["a"])
    assert conducted("a", "b") * 1.05 < of_constant_k


def test_all_heat_is_stored_with_the_temperature_dependent_specific_heat() -> None:
    disk = disk_of(SLOPES, washers=False, bore_conductance_W_m2K=1e-9)
    system = build_system(disk, 0.0, B, COARSE)
    start = np.full(len(system.capacity), 20.0)
    end = integrate(system, lambda t: 300 + 0 * t, lambda t: 20 + 0 * t, (0.0, 60.0), start).state
    cells = system.steel.cells[0]
    rise = end[cells] - 20.0
    stored = system.capacity[cells] @ (rise + 0.5 * SLOPES.specific_heat_per_K * rise**2)
    assert rise.mean() > 40
    assert stored == pytest.approx(300.0 * 60.0, rel=2e-4)  # time steps of some seconds


def test_linearised_disk_reproduces_the_transformed_temperatures() -> None:
    """Steady state without shaft: within 0.05 K of a rise of some 45 K, where the steel changes it
    by 0.2 K."""
    nonlinear_disk = disk_of(SLOPES, bore_conductance_W_m2K=1e-9, shaft_W_m2K=0.0)
    nonlinear = readings(nonlinear_disk)
    system = harmonic_system(nonlinear_disk, 700.0, B, COARSE)
    state = steady_state(system, 120.0, 60.0)
    surface = float(system.surface_m2 @ state / system.surface_m2.sum())
    setup = linear_about(
        nonlinear_disk.setup, 60.0, surface, float(np.mean([nonlinear[c] for c in "dbf"]))
    )
    linearised = readings(replace(nonlinear_disk, setup=replace(setup, steel=SteelSlopes())))
    constant_steel = readings(disk_of(SteelSlopes(), bore_conductance_W_m2K=1e-9, shaft_W_m2K=0.0))
    transformed: Array = setup.steel.kirchhoff_temperature(np.array(list(nonlinear.values())))
    difference = np.abs(transformed - np.array(list(linearised.values())))
    assert difference.max() < 0.05
    assert (
        np.abs(np.array(list(nonlinear.values())) - np.array(list(constant_steel.values()))).max()
        > 0.15
    )


def test_conduction_of_a_harmonic_equals_the_derivative_of_the_uniform_part() -> None:
    """To first order in T_1 cos(psi): half of the change of the uniform conduction by T_1, plus
    the circumferential flow.
    The sum over r is taken as a sum of dr/r."""
    disk = disk_of(SLOPES, amplitude=0.6)
    system = harmonic_system(disk, 700.0, B, COARSE)
    steel = system.steel
    y = np.full(len(system.capacity), 20.0)
    g = grid_of(disk, COARSE)
    rng = np.random.default_rng(1)
    uniform, first = steel.cells[:2]
    y[uniform] = 100.0 + 20.0 * rng.random(len(uniform))
    profile = rng.random(len(uniform))

    def extra_conduction(uniform_change: float, harmonic: float) -> Array:
        state = y.copy()
        state[uniform] += uniform_change * profile
        state[first] = harmonic * profile
        return steel.extra_conduction_W(state)

    by_uniform = (extra_conduction(1e-3, 0.0) - extra_conduction(-1e-3, 0.0))[uniform] / 2e-3
    dr_over_r = np.array(
        [np.trapezoid(1 / x, x) for x in (np.linspace(a, b, 99) for a, b in pairwise(g.r_edges))]
    )
    ring = (
        2 * np.pi * disk.setup.conductivity_W_mK * np.outer(dr_over_r, np.diff(g.z_edges)).ravel()
    )
    circumferential = -SLOPES.conductivity_per_K * ring * (y[uniform] - 20.0) * profile
    np.testing.assert_allclose(
        2 * extra_conduction(0.0, 1.0)[first], by_uniform + circumferential, rtol=1e-5, atol=1e-9
    )


def test_steel_with_vanishing_conductivity_raises() -> None:
    with pytest.raises(InputError, match="this steel would hardly conduct"):
        readings(disk_of(SteelSlopes(-1.9e-3)), power_W=2000.0)
