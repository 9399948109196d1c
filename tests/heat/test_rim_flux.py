"""Flux profiles across the track: closed forms, total heat, and the sums of the synthetic rig."""

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

B = 1.63e-3
WIDTH = 9.53e-3
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
    ids=["hertz shifted", "flat shifted", "barus", "table", "no viscosity"],
)
def test_cell_shares_match_a_sum_over_small_strips(flux: FluxProfile) -> None:
    """The synthetic rig sums 2001 strips (Barus: cells of the ellipse); one strip is 0.0005 of the
    heat."""
    shares = TrackFlux(flux, B).shares(EDGES - WIDTH / 2)
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(shares, track_shares(EDGES, B, flux), atol=5e-4)


def test_hertz_profile_matches_the_parabola_of_the_thesis() -> None:
    density = flux_density(TrackFlux(FluxProfile(), B), B, WIDTH, 53)
    np.testing.assert_allclose(density, flux_density("hertz", B, WIDTH, 53), rtol=1e-12)
    assert track_flux(FluxProfile(), B) == "hertz"


def test_barus_profile_without_pressure_is_the_chord_of_the_ellipse() -> None:
    z = np.array([-1.0, -0.5, 0.0, 0.3])
    chord = 0.5 + (np.arcsin(z) + z * np.sqrt(1 - z**2)) / np.pi
    np.testing.assert_allclose(TrackFlux(FluxProfile("barus"), B).below(z * B), chord, atol=1e-6)


def test_barus_profile_is_narrower_for_a_more_viscous_oil() -> None:
    inside = []
    for alpha in (0.0, 5e-9, 11e-9, 20e-9):
        low, high = TrackFlux(
            FluxProfile("barus", viscosity_per_Pa=alpha).at_pressure(1.3e9), B
        ).below(np.array([-0.3, 0.3]) * B)
        inside.append(high - low)
    assert all(b > a + 0.1 for a, b in pairwise(inside))
    # for large A, exp(A sqrt(1 - x^2 - z^2)) is a Gaussian of variance 1/A in z: A = 26
    assert inside[-1] == pytest.approx(0.874, abs=0.02)


def test_table_profile_is_piecewise_linear_and_scales_in_width() -> None:
    below = TrackFlux(TABLE, B, table_scale=2.0).below(np.array([-4e-3, -1e-3, 0.0, 2e-3]))
    total = 1.5 + 0.75 + 0.75
    np.testing.assert_allclose(below, np.array([0.0, 1.5, 2.25, 3.0]) / total, rtol=1e-12)


def test_track_outside_the_surface_raises() -> None:
    with pytest.raises(InputError, match=r"falls beside a running surface 9.53 mm wide"):
        flux_density(TrackFlux(FluxProfile("hertz", 4.5e-3), B), B, WIDTH, 53)


def test_modified_profiles_may_extend_beyond_the_surface() -> None:
    """The nominal profile must be within the surface.

    Its shifted and widened variants need not be, so that a valid table can be as wide as the
    surface.
    """
    wide = FluxProfile("table", at_m=(-4.5e-3, 4.5e-3), weight=(1.0, 1.0))
    edges = np.linspace(-WIDTH / 2, WIDTH / 2, 54)
    for shift_m, wider in ((0.0, 1.5), (0.25e-3, 1.0)):
        modified = track_flux(wide, B, shift_m, wider)
        assert isinstance(modified, TrackFlux)
        assert modified.shares(edges).sum() == pytest.approx(1.0)
    with pytest.raises(InputError, match="beside a running surface"):
        track_flux(replace(wide, shift_m=0.5e-3), B).shares(edges)  # type: ignore[union-attr]
