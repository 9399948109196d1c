"""The reference: Crank-Nicolson of section 3.4.3 on the same nodes, factorised once; and the explicit scheme.

Written from the thesis's coefficients (3.30)-(3.31) in their own form, not from ``operators``, so that the engine
has something independent to agree with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu

from calibration.errors import InputError
from tcdyn.conduction.rim import MESH_IV, Mesh, Rim

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scheme:
    """dT/dt = -A T + G_in T_inner + g_q q + g_a T_A + g_faces: unknowns (nr-1) x nz in rows of r, node 0 imposed.

    matrix A (n, n) [1/s]; inner (n, nz) from the imposed profile; outer (n, nz) from the flux q_i [K/s per W/m2];
    film (n,), face_d (n,), face_f (n,) from the air at the surface and behind each washer [1/s].
    """

    mesh: Mesh
    matrix: sp.csc_matrix
    inner: sp.csr_matrix
    outer: sp.csr_matrix
    film: Array
    face_d: Array
    face_f: Array


def scheme(rim: Rim, h_W_m2K: float | Array, mesh: Mesh = MESH_IV) -> Scheme:
    """The semi-discrete rim; ``h_W_m2K`` is one number, or one for each z node (nz,)."""
    m, n = mesh.nr - 1, mesh.nz
    dr, dz = rim.thickness_m / m, rim.width_m / (n - 1)
    alpha, k = rim.diffusivity_m2_s, rim.conductivity_W_mK
    s, gamma = rim.inner_radius_m / dr, (dr / dz) ** 2
    j = np.arange(1, m + 1)
    up, down = (s + j + 0.5) / (s + j), (s + j - 0.5) / (s + j)  # (3.30): A and B times 2 (phi + gamma + 1)
    down_in = down.copy()
    down[-1] = up[-1] + down[-1]  # (3.31): the node outside the surface is eliminated
    rim_h = np.broadcast_to(np.asarray(h_W_m2K, dtype=float), (n,))
    film = up[-1] * 2 * dr / k * rim_h  # what the film adds to the diagonal
    face = gamma * 2 * dz * rim.washer_W_m2K / k
    side = np.full(n - 1, gamma)
    left, right = side.copy(), side.copy()
    right[0] = left[-1] = 2 * gamma  # washers: the nodes outside the faces are eliminated
    in_r = sp.diags([-down[1:], np.full(m, 2.0), -up[:-1]], [-1, 0, 1])
    in_z = sp.diags([-left, np.full(n, 2 * gamma), -right], [-1, 0, 1]).tolil()
    in_z[0, 0] += face
    in_z[n - 1, n - 1] += face
    last = sp.csr_matrix(([1.0], ([m - 1], [m - 1])), shape=(m, m))
    a = sp.kron(in_r, sp.eye(n)) + sp.kron(sp.eye(m), in_z) + sp.kron(last, sp.diags(film))
    scale = alpha / dr**2
    first_r, last_r, ones_r = np.zeros(m), np.zeros(m), np.ones(m)
    first_r[0], last_r[-1] = down_in[0], up[-1] * 2 * dr / k
    e_d, e_f = np.eye(n)[0] * face, np.eye(n)[-1] * face
    return Scheme(
        mesh=mesh,
        matrix=sp.csc_matrix(a * scale),
        inner=sp.csr_matrix(sp.kron(first_r[:, None], sp.eye(n)) * scale),
        outer=sp.csr_matrix(sp.kron(last_r[:, None], sp.eye(n)) * scale),
        film=np.asarray(np.kron(np.eye(m)[-1], film) * scale),
        face_d=np.kron(ones_r, e_d) * scale,
        face_f=np.kron(ones_r, e_f) * scale,
    )


@dataclass(frozen=True)
class CrankNicolson:
    """(I + dt/2 A) T+ = (I - dt/2 A) T + dt/2 (g + g+), with its matrix factorised once.

    ``damped``: the step is replaced by two implicit Euler steps of half its length, which share the factor
    (Rannacher 1984); wanted for the two steps after a jump, because Crank-Nicolson does not damp what is stiff.
    """

    scheme: Scheme
    dt_s: float
    factor: SuperLU
    forward: sp.csr_matrix

    @classmethod
    def prepare(cls, s: Scheme, dt_s: float) -> CrankNicolson:
        """Factorise (SuperLU, minimum degree on A + A', symmetric mode)."""
        eye = sp.eye(s.matrix.shape[0], format="csc")
        half = (dt_s / 2) * s.matrix
        factor = splu((eye + half).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return cls(s, dt_s, factor, sp.csr_matrix(eye - half))

    def step(self, field: Array, g_now: Array, g_next: Array, damped: bool = False) -> Array:
        """One step of fields (n,) or (n, columns); g are the forcings [K/s] at its two ends."""
        half = self.dt_s / 2
        if damped:
            middle = self.factor.solve(field + half * (g_now + g_next) / 2)
            return np.asarray(self.factor.solve(middle + half * g_next))
        return np.asarray(self.factor.solve(self.forward @ field + half * (g_now + g_next)))


def steady_field(s: Scheme, forcing: Array) -> Array:
    """The field (n,) that no longer changes: A T = g."""
    return np.asarray(splu(s.matrix.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(forcing))


def explicit_limit_s(rim: Rim, mesh: Mesh) -> float:
    """Largest stable step of the explicit scheme, dt <= dr^2 dz^2 / (2 alpha (dr^2 + dz^2)) [s] (section 3.4.2).

    The thesis quotes the one-dimensional form alpha dt / dx^2 <= 1/2; in two dimensions the sum over both counts.

    >>> from calibration.rig import load_rig
    >>> round(explicit_limit_s(Rim.from_setup(load_rig().disk_setup("fast")), Mesh()) * 1e3, 3)   # mesh IV: [ms]
    0.193
    """
    dr, dz = rim.thickness_m / (mesh.nr - 1), rim.width_m / (mesh.nz - 1)
    return 0.5 / (rim.diffusivity_m2_s * (dr**-2 + dz**-2))


def explicit_growth(rim: Rim, mesh: Mesh, dt_s: float, steps: int = 200) -> float:
    """Largest |T| after ``steps`` explicit steps from a +-1 checkerboard, unforced: below one when stable."""
    if not dt_s > 0:
        raise InputError(f"explicit_growth: dt_s must be positive; got {dt_s}")
    s = scheme(rim, 0.0, mesh)
    i, j = np.indices((mesh.nr - 1, mesh.nz))
    t = (1.0 - 2.0 * ((i + j) % 2)).ravel()
    for _ in range(steps):
        t = t - dt_s * (s.matrix @ t)
    return float(np.abs(t).max())
