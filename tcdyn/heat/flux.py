"""Heat flux across the running track: which part of the heat enters on one side of a place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy  # scipy.integrate with its first use
from scipy.interpolate import BSpline, make_interp_spline

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.flux_profile import FluxProfile

# nodes across the track and along rolling, where no closed form is at hand
ROUND = 4001
ALONG = 96
LEAST_ON_SURFACE = 0.99
LEAST_TRIED = 0.5
HERTZ: Literal["hertz"] = "hertz"


@dataclass(frozen=True)
class TrackFlux:
    """A stated profile on a contact of half-width ``half_width_m`` [m], a table's places ``wider`` times as far out.

    ``least_on``: share of the heat that must enter the surface; what is stated is held to more than what is tried.
    """

    profile: FluxProfile
    half_width_m: float
    wider: float = 1.0
    least_on: float = LEAST_ON_SURFACE

    def below(self, z_m: Array) -> Array:
        """Share of the heat that enters below each place ``z_m`` from the centre plane, same shape.

        >>> TrackFlux(FluxProfile("flat", shift_m=0.5e-3), 1e-3).below(np.array([-0.5e-3, 0.0, 1.5e-3]))
        array([0.  , 0.25, 1.  ])
        """
        p = self.profile
        z = np.asarray(z_m, dtype=float) - self.profile.shift_m
        if p.kind == "table":
            line = _table(p.at_m, p.weight)
            ends = np.array(p.at_m)[[0, -1]]
            low, high = line(ends)
            return np.asarray((line(np.clip(z / self.wider, *ends)) - low) / (high - low))
        s = np.clip(z / self.half_width_m, -1.0, 1.0)
        if p.kind == "flat":
            return np.asarray(0.5 + 0.5 * s)
        if p.kind == "barus":
            return np.asarray(np.interp(np.arcsin(s), *_barus(p.exponent)))
        return np.asarray(0.5 + 0.75 * (s - s**3 / 3))

    def shares(self, edges_m: Array) -> Array:
        """Share of the heat that enters each cell between ``edges_m`` (n + 1,) from the centre plane, (n,).

        Raises InputError where the track runs beyond the faces.
        """
        below = self.below(edges_m)
        on = float(below[-1] - below[0])
        if not on > self.least_on:
            raise InputError(
                f"{100 * (1 - on):.3g} % of the frictional heat falls beside a running surface "
                f"{1e3 * (edges_m[-1] - edges_m[0]):g} mm wide",
                expected="a track on the surface",
                remedy="look at flux_shift_mm and flux_table_mm of [contact]",
            )
        return np.asarray(np.diff(below) / on)


def track(
    stated: FluxProfile, half_width_m: float, shift_m: float = 0.0, wider: float = 1.0
) -> TrackFlux | Literal["hertz"]:
    """The flux of a stated profile moved by ``shift_m``: "hertz" where that is the thesis's own."""
    moved = replace(stated, shift_m=stated.shift_m + shift_m) if shift_m else stated
    least = LEAST_ON_SURFACE if moved == stated and wider == 1 else LEAST_TRIED
    return HERTZ if moved == FluxProfile() else TrackFlux(moved, half_width_m, wider, least)


@lru_cache(maxsize=16)
def _table(at_m: tuple[float, ...], weight: tuple[float, ...]) -> BSpline:
    """Integral of the straight lines through a table."""
    return make_interp_spline(np.array(at_m), np.array(weight), k=1).antiderivative()


@lru_cache(maxsize=64)
def _barus(exponent: float) -> tuple[Array, Array]:
    """Share of the heat below z'/b = sin(phi), against phi.

    With A = alpha p_0, p = p_0 sqrt(1 - x^2 - z^2) in semi-axes and c = cos(phi) the chord at z, the sum along rolling
    is the integral of exp(A c cos(t)) c cos(t) over -pi/2 < t < pi/2.
    """
    t, weight = np.polynomial.legendre.leggauss(ALONG)
    along = np.cos(0.5 * np.pi * t)
    phi = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ROUND)
    chord = np.cos(phi)[:, None]
    density = (np.exp(exponent * (chord * along - 1)) * chord * along) @ weight * np.cos(phi)
    below = scipy.integrate.cumulative_trapezoid(density, phi, initial=0.0)
    return phi, below / below[-1]
