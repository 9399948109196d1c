"""Surface heat transfer coefficient in steps across the track (figure 6.26)."""

import numpy as np
import pytest
from reference_run import boundary_shapes, heating_and_cooling, hertz_cells, respond, run_reference

from tcdyn.core.errors import InputError
from tcdyn.heat.modal import rim_gains
from tcdyn.heat.nonuniform import (
    SMALL_VARIATION_MODES,
    h_along,
    h_in_steps,
    rim_gains_nonuniform,
)
from tcdyn.heat.reference import scheme
from tcdyn.heat.rim import Mesh, basis_rates

DT = 1 / 75
B = 1.62e-3
MESH = Mesh(33, 53)


def test_equal_steps_match_the_uniform_coefficient(rim, points):
    rates = basis_rates(DT)
    flat = rim_gains_nonuniform(rim, np.full(53, 500.0), points, B, rates, mesh=MESH)
    np.testing.assert_allclose(
        flat.static, rim_gains(rim, 500.0, points, B, rates, mesh=MESH).static, atol=1e-12
    )


def test_stepped_coefficient_matches_the_reference(rim, points):
    h_steps = h_in_steps(rim.width_m, [rim.width_m / 2], [200.0, 1400.0], 53)
    drive = heating_and_cooling(4.0, 1.0, 3.0)
    rates = basis_rates(DT)
    gains = rim_gains_nonuniform(rim, h_steps, points, B, rates, mesh=MESH)
    result = respond(gains, [drive.lag_responses(k, rates) for k in range(5)], drive.inputs)
    expected = run_reference(
        rim,
        scheme(rim, h_steps, MESH),
        drive,
        boundary_shapes(rim, MESH),
        hertz_cells(rim, B, 53),
        points,
        2,
        16,
    )
    assert np.abs(result - expected).max() < 2e-3  # as for a uniform coefficient


def test_poorly_cooled_side_is_warmer_as_in_figure_6_26(rim, setup):
    h_steps = h_in_steps(rim.width_m, [rim.width_m / 2], [200.0, 400.0], 53)
    sides = [(3e-3, 2e-3), (3e-3, rim.width_m / 2), (3e-3, rim.width_m - 2e-3)]
    gains = rim_gains_nonuniform(rim, h_steps, sides, B, basis_rates(DT), mesh=MESH)
    left, centre, right = gains.static.T @ [150.0, 100.0, 102.0, 100.0, 65.0]
    assert right < left < centre  # still c is below a, as the thesis states


@pytest.mark.parametrize(
    ("edges", "values"),
    [([0.005, 0.002], [1.0, 2.0, 3.0]), ([0.02], [1.0, 2.0]), ([], [-1.0]), ([0.002], [1.0])],
)
def test_invalid_steps_raise(edges, values):
    with pytest.raises(InputError):
        h_in_steps(0.00953, edges, values, 53)


def test_coefficient_of_the_wrong_length_raises(rim, points):
    with pytest.raises(InputError, match="shape"):
        rim_gains_nonuniform(rim, np.ones(5), points, B, basis_rates(DT), mesh=MESH)


@pytest.mark.parametrize("variation", [(0.1, 0.0), (0.0, 0.1)])
def test_effect_of_a_smooth_variation_needs_few_modes(rim, points, variation):
    """Difference of variations of both signs; the truncation error of the uniform part cancels."""
    drive = heating_and_cooling(4.0, 1.0, 3.0)
    rates = basis_rates(DT)
    bases = [drive.lag_responses(k, rates) for k in range(5)]

    def temperature_change(basis):
        profiles = [h_along(300.0, (s * variation[0], s * variation[1]), MESH.nz) for s in (1, -1)]
        assert np.trapezoid(profiles[0], np.linspace(0, 1, MESH.nz)) == pytest.approx(
            300.0, rel=1e-3
        )
        gains = (
            rim_gains_nonuniform(rim, f, points, B, rates, mesh=MESH, basis=basis) for f in profiles
        )
        positive, negative = (respond(g, bases, drive.inputs) for g in gains)
        return positive - negative

    few = temperature_change(SMALL_VARIATION_MODES)
    many = temperature_change(600)
    assert np.abs(many).max() > 0.01
    # a small share of an uncertainty that is itself an estimate
    assert np.abs(few - many).max() < 0.05 * np.abs(many).max()
