"""The scheme's fields without any error in time: every mode's exponential, for studies of mesh and order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError
from tcdyn.conduction.modal import INPUTS, forcing, spectrum
from tcdyn.conduction.rim import MESH_IV, Flux, Mesh, Profile, Rim

Array = NDArray[np.float64]


def step_fields(
    rim: Rim,
    h_W_m2K: float,
    half_width_m: float,
    before: Sequence[float],
    after: Sequence[float],
    time_s: ArrayLike,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> Array:
    """Fields (times, nr, nz) [degC] after the inputs (power_W, d, b, f, ambient) step from ``before`` to ``after``.

    T(t) = T_after + sum over modes of (X_before - X_after) exp(-lambda t), from the steady state of ``before``.
    """
    if len(before) != len(INPUTS) or len(after) != len(INPUTS):
        raise InputError(f"step_fields: five inputs are needed, in the order {', '.join(INPUTS)}")
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    unit = forcing(s)
    old, new = (np.tensordot(np.asarray(u, dtype=float), unit, axes=1) for u in (before, after))
    t = np.atleast_1d(np.asarray(time_s, dtype=float))
    lam = s.lam_r[:, None] + s.lam_z
    amplitude = new + (old - new) * np.exp(-t[:, None, None] * lam)
    fields = s.shape_r @ amplitude @ s.shape_z.T
    shapes = np.concatenate([s.profile[:3], s.profile[3:].sum(axis=0)[None]])
    inner = np.broadcast_to(np.asarray(after[1:], dtype=float) @ shapes, (len(t), 1, mesh.nz))
    return np.concatenate([inner, fields], axis=1)


def free_decay(
    rim: Rim, h_W_m2K: float, start: Array, time_s: float, mesh: Mesh = MESH_IV, profile: Profile = "modal"
) -> Array:
    """What is left after ``time_s`` of a field (nr, nz) [K] whose boundary and ambient are held at zero."""
    s = spectrum(rim, h_W_m2K, rim.width_m / 4, profile, "uniform", mesh)
    amplitude = modal_amplitudes(s.shape_r, s.shape_z, start[1:])
    decay = np.exp(-time_s * (s.lam_r[:, None] + s.lam_z))
    return np.concatenate([np.zeros((1, mesh.nz)), s.shape_r @ (amplitude * decay) @ s.shape_z.T])


def modal_amplitudes(shape_r: Array, shape_z: Array, field: Array) -> Array:
    """Amplitudes (m, n) of a field (nr-1, nz) in the scheme's modes: V^-1 field U^-T."""
    if field.shape != (len(shape_r), len(shape_z)):
        raise InputError(
            f"the field has shape {field.shape}", expected=f"{(len(shape_r), len(shape_z))}: all nodes outside R_i"
        )
    return np.asarray(np.linalg.solve(shape_r, np.linalg.solve(shape_z, field.T).T))
