"""The solver of the complete disk against closed forms, heat balances and refined meshes."""

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
    """A constant function of time."""
    return lambda t: np.full_like(t, value)


def insulated_disk() -> DiskTruth:
    """A disk with ideal washers and no contact to the shaft."""
    disk = draw_truth(0).fast
    setup = replace(disk.setup, washer_conductivity_W_mK=0.0)
    return replace(disk, setup=setup, bore_conductance_W_m2K=1e-9, bearing_offset_K=(0.0, 0.0))


def test_heat_shares_of_the_track_sum_to_one_and_follow_the_parabola() -> None:
    edges = np.linspace(0, 9.53e-3, 401)
    shares = hertz_shares(edges, HALF_WIDTH_m)
    z = 0.5 * (edges[1:] + edges[:-1]) - 4.765e-3
    density = 0.75 / HALF_WIDTH_m * np.clip(1 - (z / HALF_WIDTH_m) ** 2, 0, None) * np.diff(edges)
    assert shares.sum() == pytest.approx(1.0, abs=1e-14)
    # midpoint rule over a kink, cell / b = 0.015
    assert np.abs(shares - density).max() < 2e-3 * shares.max()


def test_mesh_edges_fill_the_wall_and_grow_from_the_surface() -> None:
    edges = graded_edges(38.1e-3, 20.5e-3, 0.06e-3, 64)
    assert edges[0] == 38.1e-3
    assert edges[-1] == pytest.approx(20.5e-3, abs=1e-15)
    assert edges[0] - edges[1] == pytest.approx(0.06e-3, rel=1e-6)
    assert np.all(np.diff(np.abs(np.diff(edges))) > 0)


def test_steady_heat_input_equals_heat_output() -> None:
    system = build_system(draw_truth(1).slow, 280.0, HALF_WIDTH_m, DiskMesh())
    state = steady_state(system, 154.0, 61.0)
    out = system.conductance @ state - system.source_ambient * 61.0 - system.source_const
    heat_in = system.source_power.sum() * 154.0
    assert out.sum() == pytest.approx(heat_in, rel=1e-9)  # round-off of the solver


def test_losses_to_ambient_pass_half_a_cell_of_steel_and_the_washer_or_surface() -> None:
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
    surface_loss = 2 * np.pi * s.outer_radius_m * s.width_m / 30 / (1 / 280.0 + steel_m2K_W)
    assert loss[g.cells[-1, 1:-1]] == pytest.approx(np.full(28, surface_loss))
    outside = 2 * SHAFT_LENGTH_m * 2 * np.pi * s.bore_radius_m
    assert loss[g.shaft].sum() == pytest.approx(disk.shaft_W_m2K * outside)
    assert not loss[g.under].any()


def test_without_losses_all_heat_is_stored() -> None:
    system = build_system(insulated_disk(), 0.0, HALF_WIDTH_m, COARSE)
    start = np.full(len(system.capacity), 20.0)
    end = integrate(system, lambda t: 100 + 20 * t, constant(20.0), (0.0, 10.0), start).state
    stored = system.capacity @ (end - start)
    # integral of (100 + 20 t) dt; round-off and 1e-9 of leakage to the shaft
    assert stored == pytest.approx(2000.0, rel=1e-6)


def test_steady_disk_under_hertz_flux_matches_the_cosine_bessel_series() -> None:
    """Bore and faces insulated: T = T_A + sum a_n cos(n pi z / w) R_n(r), R_n of zero slope at the
    bore."""
    disk = insulated_disk()
    power = 200.0
    h = 700.0
    s = disk.setup
    system = build_system(disk, h, HALF_WIDTH_m, DiskMesh())
    # The insulated shaft is at ambient temperature by its own surface and does not affect the disk.
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
        # int q cos dz / flux
        integral = 1.5 * (np.sin(x) - x * np.cos(x)) / (x**3) * 2 * np.cos(n * np.pi / 2)

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
    # second-order error of the default mesh, against a temperature rise of 130 K
    assert np.abs(values - expected).max() < 4e-3


def test_cooling_disk_decays_with_its_slowest_radial_mode() -> None:
    """Uniform, insulated at bore and faces: rate alpha mu^2 with K C0'(mu R_o) = -h C0, a root of
    Bessel functions."""
    disk = insulated_disk()
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
    # second-order error of 64 radial cells
    assert rate == pytest.approx(s.diffusivity_m2_s * mu**2, rel=2e-4)


def integrate_with_step(step_s: float, system: DiskSystem, end_s: float = 8.0) -> Solution:
    """Temperatures for a smooth heat input, integrated with a constant step."""
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
    exact = integrate_with_step(0.0125, system).values[-1]
    coarse, fine = (
        np.abs(integrate_with_step(step, system).values[-1] - exact).max() for step in (0.8, 0.05)
    )
    # mean over four halvings; stiff modes reduce the order
    assert np.log2(coarse / fine) / 4 > 3.2


def test_step_sizes_fill_any_length_with_few_different_sizes() -> None:
    steps = step_sizes(1000.123, Stepping())
    assert steps.sum() == pytest.approx(1000.123, abs=1e-9)
    assert len(np.unique(steps)) <= 13
    assert len(steps) < 450


def loaded_test(stepping: Stepping, mesh: DiskMesh) -> Array:
    """Readings of a loaded test with ramps of power."""
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


def test_interpolated_traces_are_accurate_to_a_millikelvin() -> None:
    default = loaded_test(Stepping(), COARSE)
    fine = loaded_test(Stepping(1 / 1200, 0.5, 0.02), COARSE)
    # the specification allows 5 mK for time and space together
    assert np.abs(default - fine).max() < 1e-3


@pytest.mark.long
@pytest.mark.study
def test_default_mesh_is_within_five_millikelvin_of_a_refined_one() -> None:
    default = loaded_test(Stepping(), DiskMesh())
    fine = loaded_test(Stepping(1 / 600, 1.0, 0.04), DiskMesh(140, 180, 0.03e-3, 160))
    assert np.abs(default - fine).max() < 5e-3


def test_disk_without_bore_raises() -> None:
    disk = draw_truth(0).fast
    with pytest.raises(InputError, match="bore_radius_mm"):
        build_system(
            replace(disk, setup=replace(disk.setup, bore_radius_m=0.0)), 700.0, HALF_WIDTH_m, COARSE
        )


def disk_with_bore_contact(amplitude: float, angle_deg: float = 0.0) -> DiskTruth:
    """The fast disk with a first circumferential harmonic of the bore contact."""
    disk = draw_truth(0).fast
    return replace(disk, uneven=BoreContact(amplitude, angle_deg))


def test_nearly_uniform_bore_contact_reduces_to_the_axisymmetric_disk() -> None:
    axisymmetric = build_system(disk_with_bore_contact(0.0), 700.0, HALF_WIDTH_m, COARSE)
    nearly_axisymmetric = harmonic_system(disk_with_bore_contact(1e-6), 700.0, HALF_WIDTH_m, COARSE)
    expected, readings = (
        s.sample @ steady_state(s, 300.0, 60.0) for s in (axisymmetric, nearly_axisymmetric)
    )
    # a hundred kelvin times 1e-6
    np.testing.assert_allclose(readings[: len(expected)], expected, atol=1e-4)
    assert (
        harmonic_system(disk_with_bore_contact(0.0), 700.0, HALF_WIDTH_m, COARSE).capacity.shape
        == axisymmetric.capacity.shape
    )


def test_harmonics_store_no_net_heat_and_the_balance_closes() -> None:
    """Whatever flows around the disk, heat input equals heat output of harmonic 0, and the full
    matrix is symmetric."""
    system = harmonic_system(disk_with_bore_contact(0.7, 25.0), 700.0, HALF_WIDTH_m, COARSE)
    assert (
        abs(system.conductance - system.conductance.T).max() < 1e-9 * abs(system.conductance).max()
    )
    state = steady_state(system, 300.0, 60.0)
    size = len(build_system(disk_with_bore_contact(0.0), 700.0, HALF_WIDTH_m, COARSE).capacity)
    assert size < len(state)
    out = (system.conductance @ state - system.source_ambient * 60.0 - system.source_const)[
        :size
    ].sum()
    assert out == pytest.approx(system.source_power.sum() * 300.0, rel=1e-9)


def test_harmonic_amplitudes_scale_with_powers_of_the_contact_amplitude() -> None:
    """The first harmonic is linear in the amplitude of the contact, the second quadratic; the next
    order is 2 % at 0.1."""

    def harmonic_amplitudes(amplitude: float) -> Array:
        disk = disk_with_bore_contact(amplitude)
        system = harmonic_system(disk, 700.0, HALF_WIDTH_m, COARSE)
        effects = unevenness_effects(disk, system.sample @ steady_state(system, 300.0, 60.0))
        return np.array([effects["amplitude_K"], *effects["second_K"].values()])

    ratio = harmonic_amplitudes(0.1) / harmonic_amplitudes(0.05)
    assert ratio[0] == pytest.approx(2.0, rel=0.02)
    np.testing.assert_allclose(ratio[1:], 4.0, rtol=0.02)


def test_rotated_contact_rotates_the_temperature_pattern() -> None:
    """Junctions rotated with the contact have the same readings."""
    disk = disk_with_bore_contact(0.6, 30.0)
    setup = disk.setup
    junctions = {c: replace(j, angle_deg=j.angle_deg - 30.0) for c, j in setup.junctions.items()}
    rotated_disk = replace(
        disk, setup=replace(setup, junctions=junctions), uneven=BoreContact(0.6, 0.0)
    )
    system, rotated_system = (
        harmonic_system(d, 700.0, HALF_WIDTH_m, COARSE) for d in (disk, rotated_disk)
    )
    readings = system.sample @ steady_state(system, 300.0, 60.0)
    np.testing.assert_allclose(
        readings, rotated_system.sample @ steady_state(rotated_system, 300.0, 60.0), atol=1e-9
    )
    # hottest where the fit conducts least
    effects = unevenness_effects(disk, readings)
    assert effects["angle_deg"] == pytest.approx(210.0)


@pytest.mark.parametrize("n", HARMONICS)
def test_harmonics_of_an_insulated_disk_obey_the_radial_equation(n: int) -> None:
    """Without washers and surface losses T_n ~ r^n + R_o^2n r^-n. It holds to 1 % at the junctions
    of the middle plane, because the shaft cools the edges of the bore more than its middle and
    the mesh is coarse."""
    disk = disk_with_bore_contact(0.5, 10.0)
    setup = replace(disk.setup, washer_conductivity_W_mK=0.0)
    disk = replace(disk, setup=setup)
    system = harmonic_system(disk, 0.0, HALF_WIDTH_m, DiskMesh(radial=48, axial=40, shaft_side=16))
    effects = unevenness_effects(disk, system.sample @ steady_state(system, 300.0, 60.0))
    readings = effects[("first_K", "second_K")[n - 1]]
    shape = {}
    for c in "abe":
        r = setup.outer_radius_m - setup.junctions[c].depth_m
        angle = n * np.deg2rad(setup.junctions[c].angle_deg - 10.0)
        shape[c] = (r**n + setup.outer_radius_m ** (2 * n) / r**n) * np.cos(angle)
    for c in "ae":
        assert readings[c] / readings["b"] == pytest.approx(shape[c] / shape["b"], rel=0.01)


def cosine_as_sectors(amplitude: float, angle_deg: float, steps: int = 360) -> BoreContact:
    """The contact 1 + amplitude cos(angle - angle_deg) as ``steps`` sectors, as shares of its
    maximum."""
    ends = np.linspace(0.0, 360.0, steps + 1)
    middle = np.deg2rad(0.5 * (ends[1:] + ends[:-1]) - angle_deg)
    shares = (1 + amplitude * np.cos(middle)) / (1 + amplitude)
    return BoreContact(amplitude, 0.0, tuple(zip(ends[:-1], ends[1:], shares)))


def test_sectors_following_a_cosine_conduct_as_the_cosine_at_any_angle() -> None:
    """Sines and cosines about another angle against cosines about the contact's angle: the fields
    agree to 1e-3 of the amplitude."""
    disk = disk_with_bore_contact(0.5, 70.0)
    setup = disk.setup
    by_sectors = replace(disk, uneven=cosine_as_sectors(0.5, 70.0))
    effects = []
    for d in (disk, by_sectors):
        system = harmonic_system(d, 700.0, HALF_WIDTH_m, COARSE)
        effects.append(unevenness_effects(d, system.sample @ steady_state(system, 300.0, 60.0)))
    of_cosine, of_sectors = effects
    assert of_sectors["amplitude_K"] == pytest.approx(of_cosine["amplitude_K"], rel=1e-3)
    assert of_sectors["angle_deg"] == pytest.approx(of_cosine["angle_deg"], abs=0.1)
    for key in ("first_K", "second_K"):
        np.testing.assert_allclose(
            [of_sectors[key][c] for c in setup.junctions],
            [of_cosine[key][c] for c in setup.junctions],
            atol=1e-3 * of_cosine["amplitude_K"],
        )


def test_two_opposite_keyways_create_only_a_second_harmonic() -> None:
    contact = BoreContact(0.0, 0.0, ((50.0, 110.0, 0.0), (230.0, 290.0, 0.0)))
    disk = replace(disk_with_bore_contact(0.0, 0.0), uneven=contact)
    system = harmonic_system(disk, 300.0, HALF_WIDTH_m, COARSE)
    effects = unevenness_effects(disk, system.sample @ steady_state(system, 300.0, 60.0))
    assert effects["amplitude_K"] < 1e-9
    # at 0 and 180 degrees, away from the keyways
    second = np.array([effects["second_K"][c] for c in "ab"])
    assert (second < -0.05).all()


def test_synthetic_rig_uses_the_fit_of_the_rig_file() -> None:
    patch = {"from_deg": 100.0, "to_deg": 200.0, "share": 0.2}
    rig = parse_rig({"slow": {"fit": {"interference_um": 20.0, "patches": [patch]}}}, "rig.toml")
    default = draw_truth(3)
    with_fit = draw_truth(3, rig)
    assert with_fit.fast == default.fast
    share = 1 - 0.8 * 100 / 360
    pressure = interference_pressure_Pa(10e-6)
    assert with_fit.slow.bore_conductance_W_m2K == pytest.approx(
        share * contact_conductance_W_m2K(pressure, 4.66e9, 1e-6, 0.1, 16.0)
    )
    angle = 2 * np.pi * (np.arange(720) + 0.5) / 720
    relative = with_fit.slow.uneven.relative_conductance(angle)
    assert relative.mean() == pytest.approx(1.0)
    first = 2 * np.mean(relative * np.exp(-1j * angle))  # about its angle of maximum: a cosine
    assert with_fit.slow.uneven.amplitude == pytest.approx(first.real, rel=1e-4)
    assert abs(first.imag) < 1e-4
    # opposite the middle of the patch
    assert with_fit.slow.uneven.angle_deg == pytest.approx(330.0)
