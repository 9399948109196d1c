"""One test through the modal rim: temperatures at junctions, whole fields at chosen times, and (beta, h) maps.

For users of the rim model, in Python; the benchmarks time its map, that of section 3.5. The fits of
``tcdyn.partition`` need neither fields nor maps and call ``modal`` and ``bank`` themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError
from tcdyn.conduction.bank import Switch, cardinal, lag_bank, node_rates
from tcdyn.conduction.exact import modal_amplitudes
from tcdyn.conduction.modal import forcing, readings, rim_gains, rim_gains_batch, spectrum
from tcdyn.conduction.rim import MESH_IV, Flux, Mesh, Point, Profile, Rim

Array = NDArray[np.float64]
CHUNK = 8192  # samples filtered at a time: bounds the memory of a map


@dataclass(frozen=True)
class Drive:
    """What drives a rim, sampled every dt_s: heat into this disk at share one [W], temperatures [degC], (N,) each.

    Between samples ``power_W`` is held and ``switches`` say when it jumps inside one; temperatures are straight
    lines. ``ambient_d_side`` and ``ambient_f_side`` default to ``ambient_degC``.
    """

    dt_s: float
    power_W: Array
    d_degC: Array
    b_degC: Array
    f_degC: Array
    ambient_degC: Array
    switches: tuple[Switch, ...] = ()
    ambient_d_side_degC: Array | None = None
    ambient_f_side_degC: Array | None = None

    def __post_init__(self) -> None:
        n = np.shape(self.b_degC)
        for name in ("power_W", "d_degC", "f_degC", "ambient_degC"):
            if np.shape(getattr(self, name)) != n or len(n) != 1:
                raise InputError(f"Drive: {name} has shape {np.shape(getattr(self, name))}", expected=f"{n}")

    @property
    def split(self) -> bool:
        """Whether the two sides of the disk have their own ambient."""
        return self.ambient_d_side_degC is not None or self.ambient_f_side_degC is not None

    @property
    def inputs(self) -> Array:
        """All inputs (N, 5), or (N, 7) with split ambient, in the order of ``RimGains.inputs``."""
        rows = [self.power_W, self.d_degC, self.b_degC, self.f_degC, self.ambient_degC]
        if self.split:
            for side in (self.ambient_d_side_degC, self.ambient_f_side_degC):
                rows.append(self.ambient_degC if side is None else side)
        return np.stack([np.asarray(r, dtype=float) for r in rows], axis=1)

    def banks(self, rates: Array, initial: Literal["equilibrium", "zero"] = "equilibrium") -> list[Array]:
        """The bank (N, K) of every input."""
        u = self.inputs
        power = lag_bank(u[:, 0], self.dt_s, rates, "zoh", self.switches, initial)
        return [power, *(lag_bank(u[:, i], self.dt_s, rates, "foh", (), initial) for i in range(1, u.shape[1]))]


def simulate_rim(
    rim: Rim,
    drive: Drive,
    h_W_m2K: float,
    points: Sequence[Point],
    half_width_m: float,
    *,
    share: float = 1.0,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
    start_field: Array | None = None,
) -> Array:
    """Temperatures (N, P) [degC] at ``points`` when this disk takes ``share`` (beta, or 1 - beta) of the power.

    Starts in steady state with the first sample, or from ``start_field`` (nr-1, nz): the nodes outside R_i.
    """
    rates = node_rates(drive.dt_s)
    gains = rim_gains(rim, h_W_m2K, points, half_width_m, rates, profile, flux, mesh, drive.split)
    scale = np.ones(len(gains.inputs))
    scale[0] = share
    banks = drive.banks(rates)
    banks[0] = banks[0] * share
    out = gains.respond(banks, drive.inputs * scale)
    if start_field is not None:
        out += _memory(rim, drive, scale, h_W_m2K, points, half_width_m, profile, flux, mesh, start_field, rates)
    return np.asarray(out)


def _memory(
    rim: Rim,
    drive: Drive,
    scale: Array,
    h: float,
    points: Sequence[Point],
    half_width: float,
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    field: Array,
    rates: Array,
) -> Array:
    """How the departure of ``field`` from the first sample's steady state dies out at the points (N, P)."""
    s = spectrum(rim, h, half_width, profile, flux, mesh)
    steady = np.tensordot(drive.inputs[0] * scale, forcing(s, drive.split), axes=1)
    gap = modal_amplitudes(s.shape_r, s.shape_z, np.asarray(field, dtype=float)) - steady
    read_r, read_z = readings(rim, points, mesh, rim.inner_radius_m)
    seen = gap * ((read_r[:, 1:] @ s.shape_r)[:, :, None] * (read_z @ s.shape_z)[:, None, :])
    lam = s.lam_r[:, None] + s.lam_z
    slow = lam < rates[-1]
    weights = seen[:, slow] @ cardinal(rates, np.log(lam[slow]))
    weights[:, -1] += seen[:, ~slow].sum(axis=1)
    t = np.arange(len(drive.b_degC)) * drive.dt_s
    return np.asarray(np.exp(-np.outer(t, rates)) @ weights.T)


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
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    scale = np.ones(7 if drive.split else 5)
    scale[0] = share
    at = np.asarray(samples, dtype=int)
    banks = np.stack([b[at] for b in drive.banks(rates)]) * scale[:, None, None]  # (I, S, K)
    lam = s.lam_r[:, None] + s.lam_z
    weights = cardinal(rates, np.log(np.minimum(lam, rates[-1])).ravel())
    amplitude = np.einsum("ix,isx->sx", forcing(s, drive.split).reshape(len(scale), -1), banks @ weights.T)
    fields = s.shape_r @ amplitude.reshape(len(at), *lam.shape) @ s.shape_z.T
    rest = s.profile[3:] if drive.split else s.profile[3:].sum(axis=0)[None]
    shapes = np.concatenate([s.profile[:3], rest])
    used = [1, 2, 3, 5, 6] if drive.split else [1, 2, 3, 4]
    inner = (drive.inputs[at] * scale)[:, used] @ shapes
    return np.concatenate([inner[:, None, :], fields], axis=1)


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
    """Temperatures (H, B, P, N) [degC] for every h and share of the power: the thesis's map (section 3.5).

    Linear in the share, so each h costs two weighted sums of a bank that all of them have in common.
    """
    shares, hs = np.atleast_1d(np.asarray(share, dtype=float)), np.atleast_1d(np.asarray(h_W_m2K, dtype=float))
    rates = node_rates(drive.dt_s)
    all_gains = rim_gains_batch(rim, hs, points, half_width_m, rates, profile, flux, mesh, drive.split)
    u = drive.inputs
    gains = np.stack([g.gains for g in all_gains])  # (H, I, P, K)
    direct = np.stack([g.direct for g in all_gains])
    i, rows = gains.shape[1], len(hs) * gains.shape[2]
    weights = np.moveaxis(gains, 1, 0).reshape(i, rows, -1)
    still = np.moveaxis(direct, 1, 0).reshape(i, rows)
    n = len(u)
    out = np.empty((len(hs), len(shares), gains.shape[2], n))
    state: list[Array] | None = None
    for start in range(0, max(n - 1, 1), CHUNK):
        stop = min(start + CHUNK + 1, n)
        banks, state = _chunk(drive, u, rates, start, stop, state)
        base = still[1:].T @ u[start:stop, 1:].T
        for k in range(1, i):
            base += weights[k] @ banks[k].T
        heat = (weights[0] @ banks[0].T + np.outer(still[0], u[start:stop, 0])).reshape(len(hs), -1, stop - start)
        base = base.reshape(len(hs), -1, stop - start)
        for b, s in enumerate(shares):
            np.multiply(heat, s, out=out[:, b, :, start:stop])
            out[:, b, :, start:stop] += base
    return out


def _chunk(
    drive: Drive, u: Array, rates: Array, start: int, stop: int, state: list[Array] | None
) -> tuple[list[Array], list[Array]]:
    """The banks of samples start..stop-1 and the states at the last of them."""
    inside = [
        Switch(s.index - start, s.fraction, s.before, s.after) for s in drive.switches if start <= s.index < stop - 1
    ]
    banks = []
    for k in range(u.shape[1]):
        hold: Literal["foh", "zoh"] = "zoh" if k == 0 else "foh"
        first: Array | Literal["equilibrium"] = "equilibrium" if state is None else state[k]
        banks.append(lag_bank(u[start:stop, k], drive.dt_s, rates, hold, inside if k == 0 else (), first))
    return banks, [b[-1].copy() for b in banks]
