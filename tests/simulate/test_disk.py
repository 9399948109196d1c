"""The whole-disk solver against closed forms, balances and its own refinement."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import i0e, i1e, j0, j1, k0e, k1e, y0, y1

from tcdyn.core.errors import InputError
from tcdyn.rig.contact import contact_conductance_W_m2K, interference_pressure_Pa
from tcdyn.rig.rigfile import parse_rig
from tcdyn.simulate.harmonics import HARMONICS, harmonic_system, unevenness_effects
from tcdyn.simulate.implicit import Solution, Stepping, integrate, steady_state, step_sizes
from tcdyn.simulate.mesh import (
    DiskMesh,
    DiskSystem,
    SHAFT_LENGTH_m,
    build_system,
    graded_edges,
    grid_of,
    hertz_shares,
    to_ambient_W_K,
)
from tcdyn.simulate.truth import BoreContact, DiskTruth, draw_truth

Array = NDArray[np.float64]
COARSE = DiskMesh(radial=24, axial=30, shaft_side=16)
HALF_WIDTH_m = 1.62e-3


def constant(value: float):  # type: ignore[no-untyped-def]
    return lambda t: np.full_like(t, value)


def lone_disk() -> DiskTruth:
    """A disk with ideal washers that touches no shaft."""
    disk = draw_truth(0).fast
    setup = replace(disk.setup, washer_conductivity_W_mK=0.0)
    return replace(disk, setup=setup, bore_conductance_W_m2K=1e-9, bearing_offset_K=(0.0, 0.0))


def test_heat_shares_of_the_track_sum_to_one_and_follow_the_parabola() -> None:
    edges = np.linspace(0, 9.53e-3, 401)
    shares = hertz_shares(edges, HALF_WIDTH_m)
    z = 0.5 * (edges[1:] + edges[:-1]) - 4.765e-3
    density = 0.75 / HALF_WIDTH_m * np.clip(1 - (z / HALF_WIDTH_m) ** 2, 0, None) * np.diff(edges)
    assert shares.sum() == pytest.approx(1.0, abs=1e-14)
    assert (
        np.abs(shares - density).max() < 2e-3 * shares.max()
    )  # midpoint rule over a kink, cell / b = 0.015


def test_mesh_edges_fill_the_wall_and_grow_from_the_surface() -> None:
    edges = graded_edges(38.1e-3, 20.5e-3, 0.06e-3, 64)
    assert edges[0] == 38.1e-3
    assert edges[-1] == pytest.approx(20.5e-3, abs=1e-15)
    assert edges[0] - edges[1] == pytest.approx(0.06e-3, rel=1e-6)
    assert np.all(np.diff(np.abs(np.diff(edges))) > 0)


def test_steady_heat_in_is_heat_out() -> None:
    system = build_system(draw_truth(1).slow, 280.0, HALF_WIDTH_m, DiskMesh())
    state = steady_state(system, 154.0, 61.0)
    out = system.conductance @ state - system.source_ambient * 61.0 - system.source_const
    assert out.sum() == pytest.approx(
        system.source_power.sum() * 154.0, rel=1e-9
    )  # solver round-off


def test_losses_to_ambient_go_through_half_a_cell_of_steel_and_then_washer_or_film() -> None:
    disk = draw_truth(1).slow
    s = disk.setup
    g = grid_of(disk, COARSE)
    loss = to_ambient_W_K(disk, g, 280.0)
    inside = loss[g.cells[:-1]]
    washer_m2K_W = (
        s.washer_thickness_m / s.washer_conductivity_W_mK
        + 0.5 * s.width_m / 30 / s.conductivity_W_mK
    )
    area = np.pi * np.diff(g.r_edges**2)[:-1]
    assert inside[:, [0, -1]] == pytest.approx(np.outer(area / washer_m2K_W, [1.0, 1.0]))
    assert not inside[:, 1:-1].any()
    steel_m2K_W = s.outer_radius_m * np.log(s.outer_radius_m / g.r[-1]) / s.conductivity_W_mK
    film = 2 * np.pi * s.outer_radius_m * s.width_m / 30 / (1 / 280.0 + steel_m2K_W)
    assert loss[g.cells[-1, 1:-1]] == pytest.approx(np.full(28, film))
    outside = 2 * SHAFT_LENGTH_m * 2 * np.pi * s.bore_radius_m
    assert loss[g.shaft].sum() == pytest.approx(disk.shaft_W_m2K * outside)
    assert not loss[g.under].any()


def test_without_losses_all_heat_is_stored() -> None:
    system = build_system(lone_disk(), 0.0, HALF_WIDTH_m, COARSE)
    start = np.full(len(system.capacity), 20.0)
    end = integrate(system, lambda t: 100 + 20 * t, constant(20.0), (0.0, 10.0), start).state
    stored = system.capacity @ (end - start)
    assert stored == pytest.approx(
        2000.0, rel=1e-6
    )  # int (100 + 20 t) dt, round-off and 1e-9 of leak to the shaft


def test_steady_disk_under_hertz_flux_is_its_cosine_and_bessel_series() -> None:
    """Bore and faces insulated: T = T_A + sum a_n cos(n pi z / w) R_n(r), R_n of zero slope at the bore."""
    disk = lone_disk()
    power = 200.0
    h = 700.0
    s = disk.setup
    system = build_system(disk, h, HALF_WIDTH_m, DiskMesh())
    # The insulated shaft hangs at ambient by its own surface; the disk does not see it.
    values = system.sample @ steady_state(system, power, 60.0)

    a = s.bore_radius_m
    b = s.outer_radius_m
    w = s.width_m
    k = s.conductivity_W_mK
    flux = power / (2 * np.pi * b)  # per unit width of a unit cosine integral
    expected = np.full(len(system.channels), 60.0 + flux / w / h)
    for n in range(1, 120):
        lam = n * np.pi / w
        x = lam * HALF_WIDTH_m
        integral = (
            1.5 * (np.sin(x) - x * np.cos(x)) / (x**3) * 2 * np.cos(n * np.pi / 2)
        )  # int q cos dz / flux

        def radial(r: float, lam: float = lam) -> float:  # R_n up to a factor exp(lam (b - a))
            grow = np.exp(lam * (r - b))
            fall = np.exp(lam * (2 * a - r - b))
            return float(i0e(lam * r) * k1e(lam * a) * grow + k0e(lam * r) * i1e(lam * a) * fall)

        fall = np.exp(2 * lam * (a - b))
        slope = lam * (i1e(lam * b) * k1e(lam * a) - k1e(lam * b) * i1e(lam * a) * fall) / radial(b)
        amplitude = flux * 2 / w * integral / (k * slope + h)
        for row, name in enumerate(system.channels):
            j = s.junctions[name]
            expected[row] += amplitude * radial(b - j.depth_m) / radial(b) * np.cos(lam * j.z_m)
    assert (
        np.abs(values - expected).max() < 4e-3
    )  # second-order error of the default mesh, against a rise of 130 K


def test_a_cooling_disk_ends_in_its_slowest_radial_mode() -> None:
    """Uniform, insulated at bore and faces: rate alpha mu^2 with K C0'(mu R_o) = -h C0, a root of Bessel functions."""
    disk = lone_disk()
    h = 700.0
    s = disk.setup
    a = s.bore_radius_m
    b = s.outer_radius_m

    def residual(mu: float) -> float:
        value = j0(mu * b) * y1(mu * a) - y0(mu * b) * j1(mu * a)
        slope = -mu * (j1(mu * b) * y1(mu * a) - y1(mu * b) * j1(mu * a))
        return float(s.conductivity_W_mK * slope + h * value)

    mu = brentq(residual, 1.0, 60.0)
    system = build_system(disk, h, HALF_WIDTH_m, DiskMesh(axial=8))
    hot = np.full(len(system.capacity), 1.0)
    solution = integrate(system, constant(0.0), constant(0.0), (0.0, 120.0), hot)
    v = solution.at(np.array([60.0, 110.0]))[:, 0]
    rate = np.log(v[0] / v[1]) / 50.0
    assert rate == pytest.approx(
        s.diffusivity_m2_s * mu**2, rel=2e-4
    )  # second-order error of 64 radial cells


def march(step_s: float, system: DiskSystem, end_s: float = 8.0) -> Solution:
    start = steady_state(system, 0.0, 60.0)
    return integrate(
        system,
        lambda t: 200 * np.sin(0.7 * t) ** 2,
        constant(60.0),
        (0.0, end_s),
        start,
        Stepping(step_s, step_s, 0.0),
    )


def test_time_steps_converge_with_order_four() -> None:
    system = build_system(draw_truth(0).fast, 700.0, HALF_WIDTH_m, COARSE)
    exact = march(0.0125, system).values[-1]
    coarse, fine = (np.abs(march(step, system).values[-1] - exact).max() for step in (0.8, 0.05))
    assert (
        np.log2(coarse / fine) / 4 > 3.2
    )  # mean over four halvings; stiff modes cost part of an order


def test_steps_fill_any_length_with_few_sizes() -> None:
    steps = step_sizes(1000.123, Stepping())
    assert steps.sum() == pytest.approx(1000.123, abs=1e-9)
    assert len(np.unique(steps)) <= 13
    assert len(steps) < 450


def loaded_test(stepping: Stepping, mesh: DiskMesh) -> Array:
    system = build_system(draw_truth(0).fast, 720.0, HALF_WIDTH_m, mesh)
    edges = (0.0, 5.0, 5.3, 64.99, 65.01, 90.0)

    def power(t: Array) -> Array:
        rise = np.clip((t - 5.0) / 0.3, 0, 1) * (1 - np.clip((t - 64.99) / 0.02, 0, 1))
        return 286 * rise * (1 + 0.05 * np.exp(-np.clip(t - 5, 0, None) / 150))

    solution = integrate(
        system,
        power,
        lambda t: 60 + 0.5 * np.sin(t / 60),
        edges,
        steady_state(system, 0, 60),
        stepping,
    )
    return solution.at(np.arange(0, 90, 1 / 75))


def test_traces_between_steps_are_good_to_a_millikelvin() -> None:
    usual = loaded_test(Stepping(), COARSE)
    fine = loaded_test(Stepping(1 / 1200, 0.5, 0.02), COARSE)
    assert (
        np.abs(usual - fine).max() < 1e-3
    )  # the work order allows 5 mK for time and space together


@pytest.mark.study
def test_default_mesh_is_within_five_millikelvin_of_a_refined_one() -> None:
    usual = loaded_test(Stepping(), DiskMesh())
    fine = loaded_test(Stepping(1 / 600, 1.0, 0.04), DiskMesh(140, 180, 0.03e-3, 160))
    assert np.abs(usual - fine).max() < 5e-3


def test_a_disk_without_a_bore_is_refused() -> None:
    disk = draw_truth(0).fast
    with pytest.raises(InputError, match="bore_radius_mm"):
        build_system(
            replace(disk, setup=replace(disk.setup, bore_radius_m=0.0)), 700.0, HALF_WIDTH_m, COARSE
        )


def uneven(amplitude: float, angle_deg: float = 0.0) -> DiskTruth:
    disk = draw_truth(0).fast
    return replace(disk, uneven=BoreContact(amplitude, angle_deg))


def test_a_contact_that_hardly_differs_round_the_bore_is_the_even_disk() -> None:
    even = build_system(uneven(0.0), 700.0, HALF_WIDTH_m, COARSE)
    slightly = harmonic_system(uneven(1e-6), 700.0, HALF_WIDTH_m, COARSE)
    was, now = (s.sample @ steady_state(s, 300.0, 60.0) for s in (even, slightly))
    np.testing.assert_allclose(now[: len(was)], was, atol=1e-4)  # a hundred kelvin times 1e-6
    assert (
        harmonic_system(uneven(0.0), 700.0, HALF_WIDTH_m, COARSE).capacity.shape
        == even.capacity.shape
    )


def test_harmonics_hold_no_heat_and_the_balance_closes() -> None:
    """Whatever goes round the disk, heat in is heat out of harmonic 0, and the whole matrix is symmetric."""
    system = harmonic_system(uneven(0.7, 25.0), 700.0, HALF_WIDTH_m, COARSE)
    assert (
        abs(system.conductance - system.conductance.T).max() < 1e-9 * abs(system.conductance).max()
    )
    state = steady_state(system, 300.0, 60.0)
    size = len(build_system(uneven(0.0), 700.0, HALF_WIDTH_m, COARSE).capacity)
    assert size < len(state)
    out = (system.conductance @ state - system.source_ambient * 60.0 - system.source_const)[
        :size
    ].sum()
    assert out == pytest.approx(system.source_power.sum() * 300.0, rel=1e-9)


def test_amplitudes_go_with_the_power_of_the_contact_s_that_makes_them() -> None:
    """The first harmonic as the contact's amplitude, the second as its square, to the next power: 2 % at 0.1."""

    def parts(amplitude: float) -> Array:
        disk = uneven(amplitude)
        system = harmonic_system(disk, 700.0, HALF_WIDTH_m, COARSE)
        told = unevenness_effects(disk, system.sample @ steady_state(system, 300.0, 60.0))
        return np.array([told["amplitude_K"], *told["second_K"].values()])

    ratio = parts(0.1) / parts(0.05)
    assert ratio[0] == pytest.approx(2.0, rel=0.02)
    np.testing.assert_allclose(ratio[1:], 4.0, rtol=0.02)


def test_a_turned_contact_turns_the_pattern() -> None:
    """Junctions turned by as much as the contact read the same."""
    disk = uneven(0.6, 30.0)
    setup = disk.setup
    turned = {c: replace(j, angle_deg=j.angle_deg - 30.0) for c, j in setup.junctions.items()}
    other = replace(disk, setup=replace(setup, junctions=turned), uneven=BoreContact(0.6, 0.0))
    one, two = (harmonic_system(d, 700.0, HALF_WIDTH_m, COARSE) for d in (disk, other))
    reads = one.sample @ steady_state(one, 300.0, 60.0)
    np.testing.assert_allclose(reads, two.sample @ steady_state(two, 300.0, 60.0), atol=1e-9)
    assert unevenness_effects(disk, reads)["angle_deg"] == pytest.approx(
        210.0
    )  # hottest where the fit conducts least


@pytest.mark.parametrize("n", HARMONICS)
def test_harmonics_of_a_disk_that_loses_nothing_obey_the_radial_equation(n: int) -> None:
    """Without washers and film T_n ~ r^n + R_o^2n r^-n; to 1 % at the junctions of the middle plane: the shaft beside
    the disk cools the bore's edges more than its middle, and the mesh is coarse."""
    disk = uneven(0.5, 10.0)
    setup = replace(disk.setup, washer_conductivity_W_mK=0.0)
    disk = replace(disk, setup=setup)
    system = harmonic_system(disk, 0.0, HALF_WIDTH_m, DiskMesh(radial=48, axial=40, shaft_side=16))
    told = unevenness_effects(disk, system.sample @ steady_state(system, 300.0, 60.0))
    reads = told[("first_K", "second_K")[n - 1]]
    shape = {}
    for c in "abe":
        r = setup.outer_radius_m - setup.junctions[c].depth_m
        angle = n * np.deg2rad(setup.junctions[c].angle_deg - 10.0)
        shape[c] = (r**n + setup.outer_radius_m ** (2 * n) / r**n) * np.cos(angle)
    for c in "ae":
        assert reads[c] / reads["b"] == pytest.approx(shape[c] / shape["b"], rel=0.01)


def stepped(amplitude: float, angle_deg: float, steps: int = 360) -> BoreContact:
    """1 + amplitude cos(angle - angle_deg) as that many sectors, of shares of its greatest."""
    ends = np.linspace(0.0, 360.0, steps + 1)
    middle = np.deg2rad(0.5 * (ends[1:] + ends[:-1]) - angle_deg)
    shares = (1 + amplitude * np.cos(middle)) / (1 + amplitude)
    return BoreContact(amplitude, 0.0, tuple(zip(ends[:-1], ends[1:], shares)))


def test_sectors_that_follow_a_cosine_conduct_as_it_does_about_any_angle() -> None:
    """Sines and cosines about another angle against cosines about its own: one field, told to 1e-3 of its amplitude."""
    disk = uneven(0.5, 70.0)
    setup = disk.setup
    by_sectors = replace(disk, uneven=stepped(0.5, 70.0))
    told = []
    for d in (disk, by_sectors):
        system = harmonic_system(d, 700.0, HALF_WIDTH_m, COARSE)
        told.append(unevenness_effects(d, system.sample @ steady_state(system, 300.0, 60.0)))
    one, other = told
    assert other["amplitude_K"] == pytest.approx(one["amplitude_K"], rel=1e-3)
    assert other["angle_deg"] == pytest.approx(one["angle_deg"], abs=0.1)
    for key in ("first_K", "second_K"):
        np.testing.assert_allclose(
            [other[key][c] for c in setup.junctions],
            [one[key][c] for c in setup.junctions],
            atol=1e-3 * one["amplitude_K"],
        )


def test_two_keyways_opposite_each_other_make_a_second_harmonic_alone() -> None:
    contact = BoreContact(0.0, 0.0, ((50.0, 110.0, 0.0), (230.0, 290.0, 0.0)))
    disk = replace(uneven(0.0, 0.0), uneven=contact)
    system = harmonic_system(disk, 300.0, HALF_WIDTH_m, COARSE)
    told = unevenness_effects(disk, system.sample @ steady_state(system, 300.0, 60.0))
    assert told["amplitude_K"] < 1e-9
    second = np.array(
        [told["second_K"][c] for c in "ab"]
    )  # at 0 and 180 degrees, away from the keyways
    assert (second < -0.05).all()


def test_the_rig_file_s_fit_is_what_the_synthetic_rig_has() -> None:
    patch = {"from_deg": 100.0, "to_deg": 200.0, "share": 0.2}
    rig = parse_rig({"slow": {"fit": {"interference_um": 20.0, "patches": [patch]}}}, "rig.toml")
    plain = draw_truth(3)
    true = draw_truth(3, rig)
    assert true.fast == plain.fast
    share = 1 - 0.8 * 100 / 360
    pressure = interference_pressure_Pa(10e-6)
    assert true.slow.bore_conductance_W_m2K == pytest.approx(
        share * contact_conductance_W_m2K(pressure, 4.66e9, 1e-6, 0.1, 16.0)
    )
    turn = 2 * np.pi * (np.arange(720) + 0.5) / 720
    relative = true.slow.uneven.relative(turn)
    assert relative.mean() == pytest.approx(1.0)
    first = 2 * np.mean(relative * np.exp(-1j * turn))  # about the best angle: a cosine
    assert true.slow.uneven.amplitude == pytest.approx(first.real, rel=1e-4)
    assert abs(first.imag) < 1e-4
    assert true.slow.uneven.angle_deg == pytest.approx(330.0)  # opposite the patch's middle
