"""Profiles of the heat across the track: closed forms, the whole heat, and the sums of the synthetic rig."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.heat.flux import TrackFlux, track_flux
from tcdyn.heat.modal import flux_density
from tcdyn.rig.tables import FluxProfile
from tcdyn.simulate.mesh import track_shares

B, WIDTH = 1.63e-3, 9.53e-3
EDGES = np.linspace(0.0, WIDTH, 54)
BARUS = FluxProfile("barus", viscosity_per_Pa=11e-9).at_pressure(1.3e9)
TABLE = FluxProfile("table", at_m=(-2e-3, -0.5e-3, 0.0, 1e-3), weight=(0.0, 2.0, 1.0, 0.5))


@pytest.mark.parametrize(
    "flux",
    [
        FluxProfile("hertz", 0.7e-3),
        FluxProfile("flat", -0.3e-3),
        BARUS,
        TABLE,
        FluxProfile("barus", 1e-3, 0.0),
    ],
    ids=["hertz beside", "flat beside", "barus", "table", "no viscosity"],
)
def test_shares_are_those_of_a_sum_over_small_cells(flux: FluxProfile) -> None:
    """The synthetic rig adds up strips (Barus: cells of the ellipse), 2001 across: a strip is 0.0005 of the heat."""
    ours = TrackFlux(flux, B).shares(EDGES - WIDTH / 2)
    assert ours.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(ours, track_shares(EDGES, B, flux), atol=5e-4)


def test_the_parabola_is_the_thesis_s_own_by_either_way() -> None:
    mine = flux_density(TrackFlux(FluxProfile(), B), B, WIDTH, 53)
    np.testing.assert_allclose(mine, flux_density("hertz", B, WIDTH, 53), rtol=1e-12)
    assert track_flux(FluxProfile(), B) == "hertz"


def test_without_pressure_the_viscosity_s_profile_is_the_ellipse_s_chord() -> None:
    z = np.array([-1.0, -0.5, 0.0, 0.3])
    chord = 0.5 + (np.arcsin(z) + z * np.sqrt(1 - z**2)) / np.pi
    np.testing.assert_allclose(TrackFlux(FluxProfile("barus"), B).below(z * B), chord, atol=1e-6)


def test_the_more_viscous_the_narrower() -> None:
    inside = []
    for alpha in (0.0, 5e-9, 11e-9, 20e-9):
        low, high = TrackFlux(
            FluxProfile("barus", viscosity_per_Pa=alpha).at_pressure(1.3e9), B
        ).below(np.array([-0.3, 0.3]) * B)
        inside.append(high - low)
    assert all(b > a + 0.1 for a, b in pairwise(inside))
    # far above one, exp(A sqrt(1 - x^2 - z^2)) is a Gaussian of variance 1/A in z: A = 26
    assert inside[-1] == pytest.approx(0.874, abs=0.02)


def test_a_table_is_straight_between_its_places_and_stretches() -> None:
    below = TrackFlux(TABLE, B, table_scale=2.0).below(np.array([-4e-3, -1e-3, 0.0, 2e-3]))
    whole = 1.5 + 0.75 + 0.75
    np.testing.assert_allclose(below, np.array([0.0, 1.5, 2.25, 3.0]) / whole, rtol=1e-12)


def test_a_track_beside_the_surface_is_refused() -> None:
    with pytest.raises(InputError, match=r"falls beside a running surface 9.53 mm wide"):
        flux_density(TrackFlux(FluxProfile("hertz", 4.5e-3), B), B, WIDTH, 53)


def test_a_stated_table_as_wide_as_the_surface_may_be_tried_wider_and_beside() -> None:
    """What is stated is held to the surface; the alternatives about it are not, or a sound table would be refused."""
    wide, edges = (
        FluxProfile("table", at_m=(-4.5e-3, 4.5e-3), weight=(1.0, 1.0)),
        np.linspace(-WIDTH / 2, WIDTH / 2, 54),
    )
    for shift_m, wider in ((0.0, 1.5), (0.25e-3, 1.0)):
        tried = track_flux(wide, B, shift_m, wider)
        assert isinstance(tried, TrackFlux)
        assert tried.shares(edges).sum() == pytest.approx(1.0)
    with pytest.raises(InputError, match="beside a running surface"):
        track_flux(replace(wide, shift_m=0.5e-3), B).shares(edges)  # type: ignore[union-attr]
