"""How the frictional heat of the synthetic rig falls across the running track, summed over its own fine cells."""

from __future__ import annotations

import numpy as np

from calibration import Array
from calibration.stated.flux import FluxProfile

FINE = 2001  # cells across the track and along rolling


def hertz_shares(edges: Array, half_width_m: float) -> Array:
    """Share of a parabolic track's heat that falls into each cell, by its exact integral; sums to one."""
    x = np.clip((edges - 0.5 * (edges[0] + edges[-1])) / half_width_m, -1.0, 1.0)
    return np.diff(0.75 * (x - x**3 / 3.0))


def track_shares(edges: Array, half_width_m: float, flux: FluxProfile) -> Array:
    """Share of the heat of a track like ``flux`` that falls into each cell between ``edges`` (n + 1,) [m].

    All but the centred parabola are added up from ``FINE`` strips across the track, each whole in one cell or parted
    between two: a viscosity by Barus's law is added up over the ellipse, cell by cell.
    """
    if flux == FluxProfile():
        return hertz_shares(edges, half_width_m)
    reach = half_width_m if flux.kind != "table" else max(abs(x) for x in flux.at_m)
    strips = np.linspace(-reach, reach, FINE + 1)
    middle = 0.5 * (strips[1:] + strips[:-1])
    x = middle / half_width_m
    if flux.kind == "table":
        heat = np.interp(middle, flux.at_m, flux.weight, left=0.0, right=0.0)
    elif flux.kind == "flat":
        heat = np.ones(FINE)
    elif flux.kind == "hertz":
        heat = 1 - x**2
    else:
        left = 1 - x[:, None] ** 2 - x[None, :] ** 2  # of the squared pressure, along rolling in the second axis
        inside = left > 0
        heat = np.where(inside, np.exp(flux.exponent * (np.sqrt(np.where(inside, left, 0.0)) - 1)), 0.0).sum(axis=1)
    below = np.concatenate([[0.0], np.cumsum(heat)]) / heat.sum()
    centre = 0.5 * (edges[0] + edges[-1]) + flux.shift_m
    return np.diff(np.interp(edges - centre, strips, below))
