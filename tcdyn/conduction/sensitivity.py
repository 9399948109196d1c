"""Exact derivatives of the rim's gains by its parameters: the modal form differentiated, not its noisy results.

For users of the rim model, in Python; the budget of beta takes its shifts from ``tcdyn.partition``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.conduction.dual import Dual
from tcdyn.conduction.modal import INPUTS, RimGains, assemble, readings, spectrum
from tcdyn.conduction.rim import MESH_IV, Flux, Mesh, Point, Profile, Rim

Array = NDArray[np.float64]
PARAMETERS = (
    "h_W_m2K",
    "conductivity_W_mK",
    "heat_capacity_J_m3K",
    "inner_depth_m",
    "point_depth_m",
    "washer_W_m2K",
    "half_width_m",
)


@dataclass(frozen=True)
class RimSensitivity:
    """Gains, and for every parameter of ``PARAMETERS`` their derivative, in the shape of gains again.

    inner_depth_m moves the boundary (junction b and its row), point_depth_m moves each outer point by itself.
    """

    gains: RimGains
    slopes: Mapping[str, RimGains]


def rim_sensitivities(
    rim: Rim,
    h_W_m2K: float,
    points: Sequence[Point],
    half_width_m: float,
    rates: Array,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> RimSensitivity:
    """``rim_gains`` and their exact derivatives by h, K, rho c, depths, washer and half-width.

    Eigenvalues and eigenvectors of the two tridiagonals are differentiated in closed form and carried through the
    weights by the chain rule (``dual``). ``slopes[name].respond(banks, inputs)`` is dT/d(name) over a record.

    >>> from calibration.rig import load_rig
    >>> from tcdyn.conduction.bank import node_rates
    >>> rim = Rim.from_setup(load_rig().disk_setup("fast"))
    >>> s = rim_sensitivities(rim, 700.0, [(3e-3, 4.765e-3)], 1.62e-3, node_rates(1 / 75), mesh=Mesh(17, 27))
    >>> bool(s.slopes["h_W_m2K"].static[0, 0] < 0)   # a better cooled rim answers the power less
    True
    """
    q = len(PARAMETERS)
    eye = np.eye(q)
    volume_heat = rim.density_kg_m3 * rim.specific_heat_J_kgK
    values = (h_W_m2K, rim.conductivity_W_mK, volume_heat, 0.0, 0.0, rim.washer_W_m2K, half_width_m)
    h, k, capacity, inner_depth, shift, washer, b = (Dual(np.asarray(float(v)), eye[i]) for i, v in enumerate(values))
    inner = rim.inner_radius_m - inner_depth
    given = {"conductivity": k, "heat_capacity": capacity, "washer": washer, "inner_radius": inner}
    s = spectrum(rim, h, b, profile, flux, mesh, given)
    read_r, read_z = readings(rim, points, mesh, inner, shift)
    gains, direct = assemble(s, read_r, read_z, rates)
    at = tuple(points)

    def pack(g: Array, d: Array) -> RimGains:
        return RimGains(INPUTS, at, rates, g, d)

    slopes = {name: pack(gains.slope[i], direct.slope[i]) for i, name in enumerate(PARAMETERS)}
    return RimSensitivity(pack(gains.value, direct.value), slopes)
