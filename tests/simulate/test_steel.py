"""The synthetic disk whose steel follows temperature: Kirchhoff's closed form, stored heat, and its harmonics."""

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
    disk = draw_truth(0).fast
    setup = replace(
        disk.setup, steel=steel, **({} if washers else {"washer_conductivity_W_mK": 0.0})
    )
    return replace(disk, setup=setup, uneven=BoreContact(amplitude, 20.0), **changes)


def readings(disk: DiskTruth, power_W: float = 120.0, h_W_m2K: float = 700.0) -> dict[str, float]:
    system = harmonic_system(disk, h_W_m2K, B, COARSE)
    return dict(zip(system.channels, system.sample @ steady_state(system, power_W, 60.0)))


def test_a_ring_between_hot_and_cold_obeys_kirchhoff_s_law() -> None:
    """Even heat all across, no washers: the integral of k dT between radii is Q ln(r2/r1) / (2 pi w)."""
    disk = disk_of(SLOPES, washers=False, bore_conductance_W_m2K=1e5, shaft_W_m2K=500.0)
    setup = replace(disk.setup, flux=FluxProfile("flat"))
    disk = replace(disk, setup=setup)
    system = build_system(disk, 0.0, setup.width_m / 2, COARSE)
    reads = dict(zip(system.channels, system.sample @ steady_state(system, 500.0, 60.0)))
    assert reads["e"] - reads["b"] > 20

    def conducted(one: str, other: str) -> float:
        integral = quad(
            lambda t: setup.conductivity_W_mK * SLOPES.conductivity(t), reads[other], reads[one]
        )[0]
        radii = [setup.outer_radius_m - setup.junctions[c].depth_m for c in (one, other)]
        return float(2 * np.pi * setup.width_m * integral / np.log(radii[0] / radii[1]))

    # the shaft beside the disk cools the bore's edges more than its middle: the flow leans there, by half a per cent
    assert conducted("e", "a") == pytest.approx(500.0, rel=2e-3)
    assert conducted("a", "b") == pytest.approx(500.0, rel=5e-3)
    assert conducted("a", "b") * 1.05 < conducted("a", "b") / SLOPES.conductivity(
        reads["a"]
    )  # what a constant k tells


def test_all_heat_is_stored_with_the_specific_heat_of_its_temperature() -> None:
    disk = disk_of(SLOPES, washers=False, bore_conductance_W_m2K=1e-9)
    system = build_system(disk, 0.0, B, COARSE)
    start = np.full(len(system.capacity), 20.0)
    end = integrate(system, lambda t: 300 + 0 * t, lambda t: 20 + 0 * t, (0.0, 60.0), start).state
    own = system.steel.cells[0]
    above = end[own] - 20.0
    stored = system.capacity[own] @ (above + 0.5 * SLOPES.specific_heat_per_K * above**2)
    assert above.mean() > 40
    assert stored == pytest.approx(300.0 * 60.0, rel=2e-4)  # the method's steps of some seconds


def test_the_linear_disk_that_stands_for_it_reads_kirchhoff_s_temperatures() -> None:
    """Steady, without a shaft: 0.05 K of some 45 above the air, where the steel makes 0.2."""
    true = disk_of(SLOPES, bore_conductance_W_m2K=1e-9, shaft_W_m2K=0.0)
    hot = readings(true)
    system = harmonic_system(true, 700.0, B, COARSE)
    state = steady_state(system, 120.0, 60.0)
    surface = float(system.surface_m2 @ state / system.surface_m2.sum())
    setup = linear_about(true.setup, 60.0, surface, float(np.mean([hot[c] for c in "dbf"])))
    plain = readings(replace(true, setup=replace(setup, steel=SteelSlopes())))
    own = readings(disk_of(SteelSlopes(), bore_conductance_W_m2K=1e-9, shaft_W_m2K=0.0))
    bent: Array = setup.steel.kirchhoff_temperature(np.array(list(hot.values())))
    apart = np.abs(bent - np.array(list(plain.values())))
    assert apart.max() < 0.05
    assert np.abs(np.array(list(hot.values())) - np.array(list(own.values()))).max() > 0.15


def test_a_harmonic_conducts_as_a_small_change_of_the_even_part_does() -> None:
    """To first order in T_1 cos(psi): half of what the even part's conduction changes by T_1, and what flows round the
    ring, by the sum over r as a sum of dr/r."""
    disk = disk_of(SLOPES, amplitude=0.6)
    system = harmonic_system(disk, 700.0, B, COARSE)
    steel = system.steel
    y = np.full(len(system.capacity), 20.0)
    g = grid_of(disk, COARSE)
    rng = np.random.default_rng(1)
    even, first = steel.cells[:2]
    y[even] = 100.0 + 20.0 * rng.random(len(even))
    change = rng.random(len(even))

    def brought(more: float, harmonic: float) -> Array:
        state = y.copy()
        state[even] += more * change
        state[first] = harmonic * change
        return steel.extra_conduction_W(state)

    by_even = (brought(1e-3, 0.0) - brought(-1e-3, 0.0))[even] / 2e-3
    dr_over_r = np.array(
        [np.trapezoid(1 / x, x) for x in (np.linspace(a, b, 99) for a, b in pairwise(g.r_edges))]
    )
    ring = (
        2 * np.pi * disk.setup.conductivity_W_mK * np.outer(dr_over_r, np.diff(g.z_edges)).ravel()
    )
    round_ring = -SLOPES.conductivity_per_K * ring * (y[even] - 20.0) * change
    np.testing.assert_allclose(
        2 * brought(0.0, 1.0)[first], by_even + round_ring, rtol=1e-5, atol=1e-9
    )


def test_steel_that_would_not_conduct_is_refused() -> None:
    with pytest.raises(InputError, match="this steel would hardly conduct"):
        readings(disk_of(SteelSlopes(-1.9e-3)), power_W=2000.0)
