"""The thesis's meshing test (section 3.6.1) done again: errors of meshes I to III against mesh IV, in percent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.conduction.modal import forcing, spectrum
from tcdyn.conduction.reference import scheme, steady_field
from tcdyn.conduction.rim import Mesh, Rim, correction_factor
from tcdyn.verify.checks import POWER_W, default_rim

Array = NDArray[np.float64]
# mesh I has 14 nodes in z here, so that its nodes are nodes of the others, as section 3.6.1 did
SETS = {"I": Mesh(9, 14), "II": Mesh(17, 27), "III": Mesh(33, 53), "IV": Mesh(65, 105)}
STEP_S = {"I": 0.04, "II": 0.01, "III": 0.005, "IV": 0.001}  # table 3.1
IDEAL_TIMES_S = (2.0, 4.0, 8.0, 15.0)
HALF_WIDTH_D4_m = 1.75e-3


@dataclass(frozen=True)
class MeshErrors:
    """Largest and mean error of a mesh against mesh IV, in percent, at the compared times."""

    mesh: str
    maximum: tuple[float, ...]
    mean: tuple[float, ...]


def crank_nicolson_field(rim: Rim, mesh: Mesh, dt_s: float, time_s: float, late_steps: int = 0) -> Array:
    """Field (nr, nz) that Crank-Nicolson gives at ``time_s`` after a uniform flux starts, from 20 degC throughout.

    Mode by mode a step multiplies by (1 - lambda dt/2)/(1 + lambda dt/2), so no stepping is needed; ``late_steps``
    starts the heat so many steps late.
    """
    s = spectrum(rim, 0.0, rim.width_m / 2, "modal", "uniform", mesh)
    unit = forcing(s)
    old, new = (np.tensordot([p, 20.0, 20.0, 20.0, 20.0], unit, axes=1) for p in (0.0, POWER_W))
    half = (s.lam_r[:, None] + s.lam_z) * dt_s / 2
    ratio = (1 - half) / (1 + half)
    amplitude = new + (old - new) * ratio ** (round(time_s / dt_s) - late_steps)
    return np.vstack([np.full(mesh.nz, 20.0), s.shape_r @ amplitude @ s.shape_z.T])


def ideal_study(late_steps: int = 0) -> dict[str, MeshErrors]:
    """Tables 3.2 and 3.3: constant flux on the whole track, ideal washers, 20 degC inside, steps of table 3.1."""
    rim = default_rim(washer=False)
    fields = {
        k: [_common(crank_nicolson_field(rim, m, STEP_S[k], t, late_steps), m) for t in IDEAL_TIMES_S]
        for k, m in SETS.items()
    }
    return {k: _errors(k, fields[k], fields["IV"]) for k in ("I", "II", "III")}


def time_step_error_percent() -> dict[str, float]:
    """Largest change [%] at 2 s when table 3.1's step is made ten times smaller; "I at 1 s": that of figure 3.10."""
    rim = default_rim(washer=False)
    out = {}
    for key, name, dt in [*((k, k, STEP_S[k]) for k in SETS), ("I at 1 s", "I", 1.0)]:
        coarse, fine = (crank_nicolson_field(rim, SETS[name], d, 2.0) for d in (dt, STEP_S[name] / 10))
        out[key] = float((np.abs(coarse - fine) / fine).max() * 100)
    return out


def real_study(inner_degC: float, ambient_degC: float) -> dict[str, MeshErrors]:
    """Tables 3.5 and 3.6 by quasi-steady fields of test D4: nodal parabola times table 3.4's factor, as the thesis."""
    rim = default_rim()
    power = 0.65 * 22.0 * 20.0  # beta F u_s of test D4 (tables 6.1, 7.1 and 7.2)
    fields = {}
    for k, mesh in SETS.items():
        s = scheme(rim, 721.0, mesh)
        across = np.linspace(-1, 1, mesh.nz) * rim.width_m / 2
        inner = inner_degC - 3.0 * (across / 2.765e-3) ** 2  # d and f about 3 K below b, as figure 3.8
        heat = power * nodal_parabola(rim, mesh, k)
        air = (s.film + s.face_d + s.face_f) * ambient_degC
        field = steady_field(s, s.outer @ heat + s.inner @ inner + air).reshape(mesh.nr - 1, mesh.nz)
        fields[k] = [_common(np.vstack([inner, field]), mesh)]
    return {k: _errors(k, fields[k], fields["IV"]) for k in ("I", "II", "III")}


def nodal_parabola(rim: Rim, mesh: Mesh, name: str) -> Array:
    """Point values of (3.32) for one watt [1/m2], raised by the factor of table 3.4 (mesh I: for 13 nodes)."""
    b = HALF_WIDTH_D4_m
    z = np.linspace(-1, 1, mesh.nz) * rim.width_m / 2
    density = np.where(np.abs(z) <= b, 0.75 / b * (1 - (z / b) ** 2), 0.0)
    factor = correction_factor(b, 13 if name == "I" else mesh.nz, rim.width_m)
    return np.asarray(density * factor / (2 * np.pi * rim.outer_radius_m))


def _common(field: Array, mesh: Mesh) -> Array:
    """The nodes that all four meshes share (9, 14)."""
    return field[:: (mesh.nr - 1) // 8, :: (mesh.nz - 1) // 13]


def _errors(name: str, fields: list[Array], finest: list[Array]) -> MeshErrors:
    gaps = [np.abs(a - b) for a, b in zip(fields, finest, strict=True)]
    return MeshErrors(
        name,
        tuple(float((g / f).max() * 100) for g, f in zip(gaps, finest, strict=True)),
        tuple(float(g.sum() / f.sum() * 100) for g, f in zip(gaps, finest, strict=True)),
    )
