"""A film in steps across the track (figure 6.26)."""

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

DT, B, MESH = 1 / 75, 1.62e-3, Mesh(33, 53)


def test_equal_steps_are_the_uniform_film(rim, points):
    rates = basis_rates(DT)
    flat = rim_gains_nonuniform(rim, np.full(53, 500.0), points, B, rates, mesh=MESH)
    np.testing.assert_allclose(
        flat.static, rim_gains(rim, 500.0, points, B, rates, mesh=MESH).static, atol=1e-12
    )


def test_a_film_in_steps_follows_the_reference(rim, points):
    film = h_in_steps(rim.width_m, [rim.width_m / 2], [200.0, 1400.0], 53)
    drive = heating_and_cooling(4.0, 1.0, 3.0)
    rates = basis_rates(DT)
    gains = rim_gains_nonuniform(rim, film, points, B, rates, mesh=MESH)
    ours = respond(gains, [drive.lag_responses(k, rates) for k in range(5)], drive.inputs)
    theirs = run_reference(
        rim,
        scheme(rim, film, MESH),
        drive,
        boundary_shapes(rim, MESH),
        hertz_cells(rim, B, 53),
        points,
        2,
        16,
    )
    assert np.abs(ours - theirs).max() < 2e-3  # as for the uniform film


def test_the_poorly_cooled_side_is_warmer_as_in_figure_6_26(rim, setup):
    film = h_in_steps(rim.width_m, [rim.width_m / 2], [200.0, 400.0], 53)
    sides = [(3e-3, 2e-3), (3e-3, rim.width_m / 2), (3e-3, rim.width_m - 2e-3)]
    gains = rim_gains_nonuniform(rim, film, sides, B, basis_rates(DT), mesh=MESH)
    left, centre, right = gains.static.T @ [150.0, 100.0, 102.0, 100.0, 65.0]
    assert right < left < centre  # and even so c stays below a, which is the thesis's point


@pytest.mark.parametrize(
    ("edges", "values"),
    [([0.005, 0.002], [1.0, 2.0, 3.0]), ([0.02], [1.0, 2.0]), ([], [-1.0]), ([0.002], [1.0])],
)
def test_steps_that_make_no_sense_are_refused(edges, values):
    with pytest.raises(InputError):
        h_in_steps(0.00953, edges, values, 53)


def test_a_film_of_the_wrong_length_is_refused(rim, points):
    with pytest.raises(InputError, match="shape"):
        rim_gains_nonuniform(rim, np.ones(5), points, B, basis_rates(DT), mesh=MESH)


@pytest.mark.parametrize("along", [(0.1, 0.0), (0.0, 0.1)])
def test_what_a_film_of_smooth_shape_changes_needs_few_modes(rim, points, along):
    """The difference of both signs: what few modes leave out of the uniform film's answer is the same in both."""
    drive, rates = heating_and_cooling(4.0, 1.0, 3.0), basis_rates(DT)
    banks = [drive.lag_responses(k, rates) for k in range(5)]

    def changed(basis):
        films = [h_along(300.0, (s * along[0], s * along[1]), MESH.nz) for s in (1, -1)]
        assert np.trapezoid(films[0], np.linspace(0, 1, MESH.nz)) == pytest.approx(300.0, rel=1e-3)
        gains = (
            rim_gains_nonuniform(rim, f, points, B, rates, mesh=MESH, basis=basis) for f in films
        )
        one, other = (respond(g, banks, drive.inputs) for g in gains)
        return one - other

    few, many = changed(SMALL_VARIATION_MODES), changed(600)
    assert np.abs(many).max() > 0.01
    assert (
        np.abs(few - many).max() < 0.05 * np.abs(many).max()
    )  # a share of an uncertainty that is a guess itself
