"""Heat flux across the running track: the share of the heat that enters each cell of the mesh.

``tcdyn.partition.window`` makes the flux from the profile of the rig file (``track_flux``), and
``tcdyn.heat.modal.flux_density`` divides the shares by the widths of the cells. Only shares are
used: the total heat is an input of the rim. Guarded by ``tests/heat/test_rim_flux.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import BSpline, make_interp_spline

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.tables import FluxProfile

# Nodes of the numerical integrals of Barus's profile across the track and along rolling; chosen by
# judgement. More are more exact and slower.
NODES_ACROSS = 4001
NODES_ALONG = 96
# Smallest share of the heat that must enter the running surface: of the profile in the rig file,
# and of a shifted or stretched one that a fit tries. Chosen by judgement.
MIN_SHARE_ON_SURFACE = 0.99
MIN_SHARE_IN_FIT = 0.5
# Name of the default flux, the parabola (3.32).
HERTZ: Literal["hertz"] = "hertz"


@dataclass(frozen=True)
class TrackFlux:
    """A profile of the rig file on a contact.

    Parameters
    ----------
    profile
        The profile: its kind, shift, exponent or table.
    half_width_m
        Half-width of the contact [m].
    table_scale
        Factor for the positions of a table; without effect for the other kinds.
    least_on
        Smallest share of the heat that must enter the running surface.
    """

    profile: FluxProfile
    half_width_m: float
    table_scale: float = 1.0
    least_on: float = MIN_SHARE_ON_SURFACE

    def below(self, z_m: Array) -> Array:
        """Share of the heat that enters below each position ``z_m`` from the centre plane.

        Parameters
        ----------
        z_m
            Positions from the centre plane, (n,) [m].

        Returns
        -------
        Shares, (n,), from 0 to 1, ascending with ``z_m``.

        Notes
        -----
        The integral of the flux density over the track, with s = (z - shift)/b limited to -1 to 1:
        flat (1 + s)/2; the parabola (3.32) 1/2 + 3/4 (s - s^3/3); "barus" by ``_barus``; a table by
        straight lines through its points. Any other profile may be added here: it must rise from 0
        to 1, so that ``shares`` conserves the heat.

        Examples
        --------
        >>> flux = TrackFlux(FluxProfile("flat", shift_m=0.5e-3), 1e-3)
        >>> flux.below(np.array([-0.5e-3, 0.0, 1.5e-3]))
        array([0.  , 0.25, 1.  ])
        """
        profile = self.profile
        z = np.asarray(z_m, dtype=float) - profile.shift_m
        if profile.kind == "table":
            integral = _table_integral(profile.at_m, profile.weight)
            ends = np.array(profile.at_m)[[0, -1]]
            low, high = integral(ends)
            return (integral(np.clip(z / self.table_scale, *ends)) - low) / (high - low)
        s = np.clip(z / self.half_width_m, -1.0, 1.0)
        if profile.kind == "flat":
            return 0.5 + 0.5 * s
        if profile.kind == "barus":
            return np.interp(np.arcsin(s), *_barus(profile.exponent))
        return 0.5 + 0.75 * (s - s**3 / 3)

    def shares(self, edges_m: Array) -> Array:
        """Share of the heat that enters each cell.

        Parameters
        ----------
        edges_m
            Edges of the cells from the centre plane, (n + 1,) [m], ascending.

        Returns
        -------
        Shares, (n,); they sum to one.

        Raises
        ------
        InputError
            A share of at most ``least_on`` enters between the first and the last edge.

        Notes
        -----
        Heat that would fall beside the surface is distributed over the cells in proportion, so that
        the total is one.
        """
        below = self.below(edges_m)
        on_surface = float(below[-1] - below[0])
        if not on_surface > self.least_on:
            raise InputError(
                f"{100 * (1 - on_surface):.3g} % of the frictional heat falls beside a running "
                f"surface {1e3 * (edges_m[-1] - edges_m[0]):g} mm wide",
                expected="a track on the surface",
                remedy="look at flux_shift_mm and flux_table_mm of [contact]",
            )
        return np.diff(below) / on_surface


def track_flux(
    profile: FluxProfile, half_width_m: float, shift_m: float = 0.0, table_scale: float = 1.0
) -> TrackFlux | Literal["hertz"]:
    """The flux of a profile of the rig file, shifted and stretched.

    Parameters
    ----------
    profile
        Profile of the rig file.
    half_width_m
        Half-width of the contact [m].
    shift_m
        Shift in z that is added to that of the profile [m].
    table_scale
        Factor for the positions of a table.

    Returns
    -------
    The flux, or "hertz" where the result is the default profile, for which
    ``tcdyn.heat.modal.flux_density`` has a closed form.

    Notes
    -----
    A profile as it stands in the rig file must lie on the surface (``MIN_SHARE_ON_SURFACE``). A fit
    that shifts or stretches it may go beyond the edge (``MIN_SHARE_IN_FIT``), so that its steps
    near the edge do not raise.
    """
    shifted = replace(profile, shift_m=profile.shift_m + shift_m) if shift_m else profile
    if shifted == FluxProfile():
        return HERTZ
    is_as_stated = shifted == profile and table_scale == 1
    least = MIN_SHARE_ON_SURFACE if is_as_stated else MIN_SHARE_IN_FIT
    return TrackFlux(shifted, half_width_m, table_scale, least)


@lru_cache(maxsize=16)
def _table_integral(at_m: tuple[float, ...], weight: tuple[float, ...]) -> BSpline:
    """Integral of the straight lines through a table, as a spline of the position.

    Parameters
    ----------
    at_m
        Positions of the table [m], ascending.
    weight
        Relative flux at the positions.
    """
    return make_interp_spline(np.array(at_m), np.array(weight), k=1).antiderivative()


@lru_cache(maxsize=64)
def _barus(exponent: float) -> tuple[Array, Array]:
    """Share of the heat below z'/b = sin(phi), against phi.

    Parameters
    ----------
    exponent
        A = alpha p_0: pressure-viscosity coefficient times the maximum Hertz pressure.

    Returns
    -------
    phi
        Angles from -pi/2 to pi/2, (NODES_ACROSS,).
    below
        Share of the heat below each, from 0 to 1, same shape.

    Notes
    -----
    With A = alpha p_0, p = p_0 sqrt(1 - x^2 - z^2) in semi-axes and c = cos(phi) the chord at z,
    the sum along rolling is the integral of exp(A c cos(t)) c cos(t) over -pi/2 < t < pi/2. The
    factor exp(-A) in the code avoids overflow and cancels in the share.
    """
    t, weight = np.polynomial.legendre.leggauss(NODES_ALONG)
    along = np.cos(0.5 * np.pi * t)
    phi = np.linspace(-0.5 * np.pi, 0.5 * np.pi, NODES_ACROSS)
    chord = np.cos(phi)[:, None]
    density = (np.exp(exponent * (chord * along - 1)) * chord * along) @ weight * np.cos(phi)
    below = cumulative_trapezoid(density, phi, initial=0.0)
    return phi, below / below[-1]
