"""The modal engine against the factorised reference, its own fields, and conservation of heat."""

from dataclasses import replace

import numpy as np
import pytest
from reference_run import (
    boundary_shapes,
    heating_and_cooling,
    hertz_cells,
    respond,
    run_reference,
    simulate_rim,
)

from tcdyn.core.errors import InputError
from tcdyn.heat.engine import RimInputs, fields_at, temperature_map
from tcdyn.heat.modal import rim_gains
from tcdyn.heat.reference import scheme, steady_field
from tcdyn.heat.rim import InputJump, Mesh, Rim, basis_rates

DT = 1 / 75
B = 1.62e-3
MESH = Mesh(33, 53)


def test_isothermal_rim_stays_isothermal(rim, points):
    for profile in ("modal", "quadratic", "quartic"):
        gains = rim_gains(rim, 650.0, points, B, basis_rates(DT), profile=profile)
        # the scheme conserves heat; the condition of the eigenproblem leaves 1e-9
        np.testing.assert_allclose(gains.static[1:].sum(axis=0), 1.0, atol=1e-9)


def test_engine_matches_the_reference_on_the_same_mesh(rim, points):
    drive = heating_and_cooling(8.0, 1.0, 5.0, power=600.0)
    result = simulate_rim(rim, drive, 700.0, points, B, mesh=MESH)
    reference = run_reference(
        rim,
        scheme(rim, 700.0, MESH),
        drive,
        boundary_shapes(rim, MESH),
        hertz_cells(rim, B, 53),
        points,
        2,
        16,
    )
    assert np.ptp(reference[:, 2]) > 40  # the temperature range is not trivial
    # required: 2 mK; the reference with these steps has converged to about 0.3 mK
    assert np.abs(result - reference).max() < 1e-3


@pytest.mark.long
@pytest.mark.study
def test_engine_matches_the_reference_over_a_full_test(rim, points):
    """Load for 1000 s, then 200 s of cooling; every sample is compared. The reference is refined
    after the jumps."""
    drive = heating_and_cooling(1250.0, 50.0, 1050.0, power=600.0)
    result = simulate_rim(rim, drive, 700.0, points, B, mesh=MESH)
    reference = run_reference(
        rim,
        scheme(rim, 700.0, MESH),
        drive,
        boundary_shapes(rim, MESH),
        hertz_cells(rim, B, 53),
        points,
        1,
        32,
    )
    assert np.abs(result - reference).max() < 2e-3  # issue 3


def test_jump_inside_a_sample_matches_a_finer_record(rim, points):
    fine = heating_and_cooling(4.0, 1.0, 2.0 + 0.4 * DT, dt=DT / 10)
    every = slice(None, None, 10)
    index = 150
    heat = fine.power_W[every].copy()
    coarse = RimInputs(
        DT,
        heat,
        fine.d_degC[every],
        fine.b_degC[every],
        fine.f_degC[every],
        fine.ambient_degC[every],
        jumps=(InputJump(index, 0.4, 260.0, 0.0),),
    )
    result = simulate_rim(rim, coarse, 700.0, points, B, mesh=MESH)
    expected = simulate_rim(rim, fine, 700.0, points, B, mesh=MESH)[every]
    # remaining error: linear interpolation between 75 Hz samples at the kinks of the inner row, 34
    # K/8 s
    assert np.abs(result - expected).max() < 0.02
    without_jump = replace(coarse, jumps=())
    assert (
        np.abs(simulate_rim(rim, without_jump, 700.0, points, B, mesh=MESH) - expected).max()
        > 5 * np.abs(result - expected).max()
    )


def test_static_gain_matches_the_steady_state_of_the_scheme(rim, points):
    gains = rim_gains(rim, 450.0, points, B, basis_rates(DT), mesh=MESH)
    reference_scheme = scheme(rim, 450.0, MESH)
    field = steady_field(
        reference_scheme, reference_scheme.outer @ hertz_cells(rim, B, 53)
    ).reshape(32, 53)
    r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, 33)[1:]
    from scipy.interpolate import RectBivariateSpline

    spline = RectBivariateSpline(r, np.linspace(0, rim.width_m, 53), field, kx=5, ky=5)
    expected = [float(spline(rim.outer_radius_m - d, z)[0, 0]) for d, z in points]
    # accuracy of the numerical cell integrals: 1e-6
    np.testing.assert_allclose(gains.static[0], expected, rtol=2e-6)


def test_fields_contain_the_junction_temperatures(rim, points, setup):
    drive = heating_and_cooling(6.0, 1.0, 4.0)
    inner = [(setup.junctions[c].depth_m, setup.junctions[c].z_m) for c in "dbf"]
    traces = simulate_rim(rim, drive, 700.0, [*points, *inner], B, mesh=MESH)
    row = 250
    field = fields_at(rim, drive, 700.0, B, [row], mesh=MESH)[0]
    assert field[0, 26] == pytest.approx(drive.b_degC[row], abs=1e-9)
    np.testing.assert_allclose(traces[:, 4], drive.b_degC, atol=1e-6)
    position = (
        setup.junctions["a"].depth_m / rim.thickness_m,
        setup.junctions["a"].z_m / rim.width_m,
    )
    assert position == pytest.approx((0.5, 0.5))  # a lies on a node
    # accuracy of the lag basis, 5e-6 of a field of 60 K
    np.testing.assert_allclose(field[16, 26], traces[row, 0], atol=1e-4)


def test_temperature_map_matches_single_runs(rim, points):
    drive = heating_and_cooling(30.0, 1.0, 20.0)
    map_degC = temperature_map(rim, drive, [0.3, 0.8], [300.0, 900.0], points, B, mesh=MESH)
    rates = basis_rates(DT)
    bases = [drive.lag_responses(k, rates) for k in range(5)]
    inputs = drive.inputs * [0.3, 1, 1, 1, 1]
    bases[0] = 0.3 * bases[0]
    single_run = respond(rim_gains(rim, 900.0, points, B, rates, mesh=MESH), bases, inputs)
    np.testing.assert_allclose(map_degC[1, 0].T, single_run, atol=1e-9)


def test_warmer_air_on_one_side_warms_that_side_more(rim):
    sides = [(3e-3, 2e-3), (3e-3, rim.width_m - 2e-3)]
    gains = rim_gains(rim, 200.0, sides, B, basis_rates(DT), split_ambient=True)
    near, far = gains.static.T @ [0.0, 65.0, 65.0, 65.0, 65.0, 70.0, 60.0]
    assert near > 65.0 > far
    # figure 6.28: the difference is antisymmetric
    assert near - 65.0 == pytest.approx(65.0 - far, rel=1e-6)


def test_uniform_flux_matches_a_constant_flux_function(rim, points):
    rates = basis_rates(DT)

    def flat(z):
        return np.where(np.abs(z) < rim.width_m, 1.0, 0.0)

    uniform = rim_gains(rim, 700.0, points, rim.width_m / 2, rates, flux="uniform", mesh=MESH)
    from_function = rim_gains(rim, 700.0, points, rim.width_m / 2, rates, flux=flat, mesh=MESH)
    np.testing.assert_allclose(from_function.static, uniform.static, rtol=1e-12)


def test_unsupported_input_raises(rim, points):
    rates = basis_rates(DT)
    with pytest.raises(InputError, match="must not be negative"):
        rim_gains(rim, -1.0, points, B, rates)
    with pytest.raises(InputError, match="outside the rim"):
        rim_gains(rim, 700.0, [(7e-3, 4e-3)], B, rates)
    with pytest.raises(InputError, match="half-width"):
        rim_gains(rim, 700.0, points, 6e-3, rates)
    with pytest.raises(InputError, match="slowest mode"):
        rim_gains(replace(rim, inner_radius_m=0.0205), 700.0, points, B, rates)
    with pytest.raises(InputError, match="within the width"):
        replace(rim, boundary_z_m=(2e-3, 4e-3, 12e-3))
    with pytest.raises(InputError, match="inner radius"):
        Rim(0.05, 0.04, 0.01, 40.0, 7800.0, 470.0, 100.0, (2e-3, 4e-3, 6e-3))
    with pytest.raises(InputError, match="d_degC has shape"):
        RimInputs(DT, np.zeros(3), np.zeros(2), np.zeros(3), np.zeros(3), np.zeros(3))
    table = np.zeros((2, 3))
    with pytest.raises(InputError, match=r"b_degC has shape \(2, 3\)") as raised:
        RimInputs(DT, table, table, table, table, table)
    assert raised.value.expected == "one dimension, (N,)"
