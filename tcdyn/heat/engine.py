"""One test through the modal rim: temperatures at junctions, (beta, h) maps, and whole fields.

For ``tcdyn verify`` and for users of the rim model; the benchmarks time its map. The fits of ``tcdyn.partition`` need
neither fields nor maps and call ``modal`` and the bank themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.modal import Spectrum, forcing, inputs_of, rim_gains, spectrum
from tcdyn.heat.rim import (
    MESH_IV,
    Flux,
    Mesh,
    Point,
    Profile,
    Rim,
    Switch,
    cardinal,
    lag_bank,
    node_rates,
)


@dataclass(frozen=True)
class Drive:
    """What drives a rim, sampled every dt_s: heat into this disk at share one [W], temperatures [degC], (N,) each.

    Between samples ``power_W`` is held and ``switches`` say when it jumps inside one; temperatures are straight
    lines.
    """

    dt_s: float
    power_W: Array
    d_degC: Array
    b_degC: Array
    f_degC: Array
    ambient_degC: Array
    switches: tuple[Switch, ...] = ()

    def __post_init__(self) -> None:
        n = np.shape(self.b_degC)
        for name in ("power_W", "d_degC", "f_degC", "ambient_degC"):
            if np.shape(getattr(self, name)) != n or len(n) != 1:
                raise InputError(
                    f"Drive: {name} has shape {np.shape(getattr(self, name))}", expected=f"{n}"
                )

    @property
    def inputs(self) -> Array:
        """All inputs (N, 5) in the order of ``RimGains.inputs``."""
        rows = (self.power_W, self.d_degC, self.b_degC, self.f_degC, self.ambient_degC)
        return np.stack([np.asarray(row, dtype=float) for row in rows], axis=1)

    def bank(self, k: int, rates: Array) -> Array:
        """The bank (N, K) of input ``k``, in equilibrium with its first sample."""
        u = self.inputs[:, k]
        return (
            lag_bank(u, self.dt_s, rates)
            if k
            else lag_bank(u, self.dt_s, rates, "zoh", self.switches)
        )


def map_beta_h(
    rim: Rim,
    drive: Drive,
    share: ArrayLike,
    h_W_m2K: ArrayLike,
    points: Sequence[Point],
    half_width_m: float,
    *,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> Array:
    """Temperatures (H, B, P, N) [degC] for every h and share (beta, or 1 - beta) of the power: the map of section 3.5.

    Starts in steady state with the first sample. Linear in the share, so each h costs two weighted sums of a bank
    that all of them have in common.
    """
    shares = np.atleast_1d(np.asarray(share, dtype=float))
    hs = np.atleast_1d(np.asarray(h_W_m2K, dtype=float))
    rates = node_rates(drive.dt_s)
    u = drive.inputs
    films = [rim_gains(rim, float(h), points, half_width_m, rates, profile, flux, mesh) for h in hs]
    weights = np.concatenate([g.gains for g in films], axis=1)  # (I, H P, K)
    still = np.concatenate([g.direct for g in films], axis=1)
    out = np.empty((len(hs), len(shares), len(points), len(u)))
    base = out[:, -1]  # what the share does not change stands where its last value will
    base[:] = (still.T @ u.T).reshape(base.shape)
    for k in range(1, len(weights)):
        base += (weights[k] @ drive.bank(k, rates).T).reshape(base.shape)
    heat = (weights[0] @ drive.bank(0, rates).T).reshape(
        base.shape
    )  # the power moves no point at once
    for b, s in enumerate(shares[:-1]):
        np.multiply(heat, s, out=out[:, b])
        out[:, b] += base
    base += shares[-1] * heat
    return out


def fields_at(
    rim: Rim,
    drive: Drive,
    h_W_m2K: float,
    half_width_m: float,
    samples: Sequence[int],
    *,
    share: float = 1.0,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> Array:
    """Whole fields (len(samples), nr, nz) [degC] at the given samples, node 0 in r being the imposed profile."""
    rates = node_rates(drive.dt_s)
    at = np.asarray(samples, dtype=int)
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    banks = np.stack([drive.bank(k, rates)[at] for k in range(drive.inputs.shape[1])])  # (I, S, K)
    banks[0] *= share
    weights = cardinal(rates, np.log(np.minimum(s.rates, rates[-1])).ravel())
    amplitude = np.einsum("ix,isx->sx", forcing(s).reshape(len(banks), -1), banks @ weights.T)
    inner = drive.inputs[at] @ s.boundary
    return _nodal(s, amplitude.reshape(len(at), *s.rates.shape), inner)


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

    T(t) = T_after + sum over modes of (X_before - X_after) exp(-lambda t), from the steady state of ``before``:
    the scheme without any error in time, for studies of mesh and order.
    """
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    if len(before) != len(s.boundary) or len(after) != len(s.boundary):
        raise InputError(
            f"step_fields: needed are, in this order, {', '.join(inputs_of(len(rim.boundary_z_m)))}"
        )
    old, new = (
        np.tensordot(np.asarray(u, dtype=float), forcing(s), axes=1) for u in (before, after)
    )
    t = np.atleast_1d(np.asarray(time_s, dtype=float))
    amplitude = new + (old - new) * np.exp(-t[:, None, None] * s.rates)
    return _nodal(s, amplitude, np.asarray(after, dtype=float) @ s.boundary)


def free_decay(
    rim: Rim,
    h_W_m2K: float,
    start: Array,
    time_s: float,
    mesh: Mesh = MESH_IV,
    profile: Profile = "modal",
) -> Array:
    """What is left after ``time_s`` of a field (nr, nz) [K] whose boundary and ambient are held at zero."""
    if start.shape != (mesh.nr, mesh.nz):
        raise InputError(
            f"the field has shape {start.shape}", expected=f"{(mesh.nr, mesh.nz)}: all nodes"
        )
    s = spectrum(rim, h_W_m2K, rim.width_m / 4, profile, "uniform", mesh)
    amplitude = np.linalg.solve(s.shape_r, np.linalg.solve(s.shape_z, start[1:].T).T)
    return _nodal(s, amplitude * np.exp(-time_s * s.rates), np.zeros(mesh.nz))


def _nodal(s: Spectrum, amplitude: Array, inner: Array) -> Array:
    """Fields (..., nr, nz) of modal amplitudes (..., m, n) under the imposed profile ``inner`` (..., nz)."""
    outside = s.shape_r @ amplitude @ s.shape_z.T
    rim_row = np.broadcast_to(inner[..., None, :], (*outside.shape[:-2], 1, inner.shape[-1]))
    return np.concatenate([rim_row, outside], axis=-2)
