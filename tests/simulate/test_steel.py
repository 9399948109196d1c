"""The synthetic disk whose steel follows temperature: Kirchhoff's closed form, stored heat, and its harmonics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from calibration import Array
from calibration.stated.flux import FluxProfile
from calibration.stated.steel import SteelSlopes
from tcdyn.partition.statement.steel import linear_about
from tcdyn.simulate.implicit import integrate, steady_state
from tcdyn.simulate.mesh import DiskMesh, build_system
from tcdyn.simulate.round import uneven_system
from tcdyn.simulate.truth import BoreContact, DiskTruth, draw_truth

COARSE = DiskMesh(radial=40, axial=24, shaft_side=16)
SLOPES = SteelSlopes(-8e-4, 7e-4)
B = 1.62e-3


def disk_of(steel: SteelSlopes, washers: bool = True, amplitude: float = 0.0, **changes: float) -> DiskTruth:
    disk = draw_truth(0).fast
    setup = replace(disk.setup, steel=steel, **({} if washers else {"washer_conductivity_W_mK": 0.0}))
    return replace(disk, setup=setup, uneven=BoreContact(amplitude, 20.0), **changes)


def readings(disk: DiskTruth, power_W: float = 120.0, h_W_m2K: float = 700.0) -> dict[str, float]:
    system = uneven_system(disk, h_W_m2K, B, COARSE)
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
        integral = quad(lambda t: setup.conductivity_W_mK * SLOPES.conductivity(t), reads[other], reads[one])[0]
        radii = [setup.outer_radius_m - setup.junctions[c].depth_m for c in (one, other)]
        return float(2 * np.pi * setup.width_m * integral / np.log(radii[0] / radii[1]))

    # the shaft beside the disk cools the bore's edges more than its middle: the flow leans there, by half a per cent
    assert conducted("e", "a") == pytest.approx(500.0, rel=2e-3)
    assert conducted("a", "b") == pytest.approx(500.0, rel=5e-3)
    assert conducted("a", "b") * 1.05 < conducted("a", "b") / SLOPES.conductivity(reads["a"])  # what a constant k tells


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
    """Steady, everything that surrounds the disk in place: 0.05 K of some 45 above the air, where the steel makes 0.2."""
    true = disk_of(SLOPES, bore_conductance_W_m2K=1e-9, shaft_W_m2K=0.0)
    hot = readings(true)
    system = uneven_system(true, 700.0, B, COARSE)
    state = steady_state(system, 120.0, 60.0)
    surface = float(system.surface_m2 @ state / system.surface_m2.sum())
    setup = linear_about(true.setup, 60.0, surface, float(np.mean([hot[c] for c in "dbf"])))
    plain = readings(replace(true, setup=replace(setup, steel=SteelSlopes())))
    own = readings(disk_of(SteelSlopes(), bore_conductance_W_m2K=1e-9, shaft_W_m2K=0.0))
    bent: Array = setup.steel.straight(np.array(list(hot.values())))
    apart = np.abs(bent - np.array(list(plain.values())))
    assert apart.max() < 0.05
    assert np.abs(np.array(list(hot.values())) - np.array(list(own.values()))).max() > 0.15


def test_harmonics_conduct_as_the_even_part_s_temperature_has_it() -> None:
    """With a steel that is the same at every temperature that occurs, by another reference, nothing changes; and a
    hotter reference of the same straight line is the same steel."""
    line = SteelSlopes(-6e-4, 5e-4, 20.0)
    disk = disk_of(line, amplitude=0.6)
    k, c = line.conductivity(120.0), line.specific_heat(120.0)
    moved = SteelSlopes(-6e-4 / k, 5e-4 / c, 120.0)
    setup = replace(
        disk.setup, steel=moved, conductivity_W_mK=disk.setup.conductivity_W_mK * k,
        specific_heat_J_kgK=disk.setup.specific_heat_J_kgK * c,
    )  # fmt: skip
    one, other = readings(disk), readings(replace(disk, setup=setup))
    # the shaft's steel and half cells at the borders keep the reference's conductivity
    assert max(abs(one[ch] - other[ch]) for ch in "abcdef") < 0.15
    constant = readings(disk_of(SteelSlopes(), amplitude=0.6))
    assert max(abs(one[ch] - constant[ch]) for ch in "abcdef") > 0.3
