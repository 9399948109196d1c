"""The plunge, from parameters to block readings, with exact derivatives: flux, conduction, chain, statics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.linalg import solve_triangular

from immersion.correlations import Bath, Correlation
from immersion.cylinder import Cylinder, conditioned, driven, influence, lag_step, stepped
from immersion.plunge_data import PlungeBlocks, PlungeRun
from immersion.plunge_parameters import RUN_KINDS, PlungeParameters, stages
from immersion.radial import Reading, plunge_grid, solve_surface, unit_less
from tcdyn.core import Array
from tcdyn.rig.disk import DiskSetup

SHORTEST_S = 1e-7  # of a lag
_DK = 0.02  # step of ln K in the central difference of the influence matrices
ENTRY, INITIAL, BATH = (RUN_KINDS.index(kind) for kind in ("entry", "initial", "bath"))
FLOWS = tuple(
    k for k in range(len(RUN_KINDS)) if k != ENTRY
)  # of a run's parameters, those on which the flux depends


@dataclass(frozen=True)
class DiskInfluence:
    """Influence of the surface's flux on a disk's temperatures, on a grid, linear in ln K and depths about (ln_k,
    depth_shift_m); the one for a shorter grid is its leading block."""

    grid_s: Array
    own: Array  # (n, n) surface on surface
    own_k: Array  # its derivative with ln K
    junctions: Array  # (C, 3, n, n) surface on junctions, its derivatives with ln K and with depth
    readings: Array  # (C, 3, n, n) the same behind the conditioning filter
    ln_k: float
    depth_shift_m: Array

    @classmethod
    def of(
        cls, setup: DiskSetup, depth_m: Array, duration_s: float, ln_k: float, shift_m: Array
    ) -> DiskInfluence:
        """Of junctions ``depth_m`` + ``shift_m`` (C,) deep, and the setup's conductivity times exp(ln_k)."""
        grid = plunge_grid(duration_s)
        nominal = Cylinder.from_setup(setup)
        depth = depth_m + shift_m
        extra = 5e-5
        c = len(depth_m)
        radii = nominal.outer_radius_m - np.concatenate([[0.0], depth, depth + extra])
        low, centre, high = (
            influence(
                replace(nominal, conductivity_W_mK=nominal.conductivity_W_mK * np.exp(ln_k + step)),
                r,
                grid,
            )[0]
            for step, r in ((-_DK, radii[: c + 1]), (0.0, radii), (_DK, radii[: c + 1]))
        )
        by_k = (high - low) / (2 * _DK)
        there = centre[1 : c + 1]
        junctions = np.stack([there, by_k[1:], (centre[c + 1 :] - there) / extra], axis=1)
        filtered = conditioned(np.eye(len(grid)), np.diff(grid), setup.conditioning)
        return cls(grid, centre[0], by_k[0], junctions, filtered @ junctions, ln_k, shift_m)


@dataclass(frozen=True)
class RunModel:
    """A run made ready; n is the count of the leading knots of the grid of its disk's ``steel`` that it takes."""

    steel: DiskInfluence
    bath: Bath
    bath_degC: Array  # (n,)
    blocks: PlungeBlocks
    step_K: float  # reference difference of the extra exponent
    pivot_degC: Array  # (C,) about which a static line's slope errs
    guess: tuple[Array, Array, Array] | None = (
        None  # run's parameters and ln K, the surface there, and its derivatives
    )

    @property
    def grid_s(self) -> Array:
        """Times after the entry [s], (n,)."""
        return self.steel.grid_s[: len(self.bath_degC)]

    def start_degC(self, at: Array) -> Array | None:
        """Where a solution for a run's parameters and ln K (10,) begins: on the tangent, between bath and disk."""
        if self.guess is None:
            return None
        about, surface, by = self.guess
        ends = np.sort([np.full(len(surface), at[INITIAL]), self.bath_degC + at[BATH]], axis=0)
        moved = np.subtract(
            at, about, out=np.zeros_like(at), where=at != about
        )  # no burst is minus infinity
        return np.asarray(np.clip(surface + by @ moved, *ends))


def build_run_models(
    runs: Sequence[PlungeRun],
    blocks: Sequence[PlungeBlocks],
    setup: DiskSetup,
    layout: PlungeParameters,
    correlation: Correlation,
    about: Array,
) -> tuple[RunModel, ...]:
    """Models of all runs of a disk about the conductivity and the junction depths in ``about`` (P,).

    The surface solved there, and its tangent, are where other solutions begin.
    """
    depth = np.array([setup.junctions[c].depth_m for c in layout.channels])
    ends = [b.duration_s + 2.0 for b in blocks]
    ln_k = float(about[layout.at("ln_conductivity")][0])
    steel = DiskInfluence.of(setup, depth, max(ends), ln_k, about[layout.at("depth")])
    models = []
    for r, (run, b, end) in enumerate(zip(runs, blocks, ends)):
        bath_degC = np.interp(plunge_grid(end), b.bath_time_s, b.bath_degC)
        step = max(abs(float(bath_degC[0]) - float(np.mean(b.readings_degC[b.time_s < 0]))), 1.0)
        bath = Bath(run.fluid, correlation, setup.width_m, 2 * setup.outer_radius_m)
        model = RunModel(steel, bath, bath_degC, b, step, run.pivot_degC)
        surface = solve_run(model, layout, about, r)
        at = np.append(about[layout.run(r)], ln_k)
        models.append(replace(model, guess=(at, surface.temperature_degC, surface.temperature_by)))
    return tuple(models)


@dataclass(frozen=True)
class RunSurface:
    """Solved surface of a run: temperature, flux, h, and the derivatives of the first two (n, 9 + 1).

    They are those with the run's parameters, then ln K.
    """

    temperature_degC: Array
    flux_W_m2: Array
    h_W_m2K: Array
    temperature_by: Array
    flux_by: Array


def solve_run(model: RunModel, lay: PlungeParameters, theta: Array, r: int) -> RunSurface:
    """Surface balance of run ``r`` for all parameters ``theta``, with derivatives by the implicit theorem."""
    at = np.append(theta[lay.run(r)], theta[lay.at("ln_conductivity")])
    ln_h, exponent, power, ln_a, ln_tau, ln_p, _, initial, bath_offset, ln_k = at
    t = model.grid_s
    n = len(model.grid_s)
    nu = model.bath.fluid.nu
    tau = np.exp(ln_tau)
    p = np.exp(ln_p)
    reduced = (t / tau) ** p
    burst = np.exp(ln_a) * np.exp(-reduced)
    fluid = model.bath_degC + bath_offset
    nu_fluid = nu(fluid)

    def shapes(T: Array, F: Array, nu_F: Array) -> tuple[Array, Array]:
        size = np.maximum(np.abs(F - T), 1e-3 * model.step_K)
        return np.log(size / model.step_K), np.log(nu(T) / nu_F)

    def law(T: Array, F: Array, nu_F: Array) -> Array:
        gap, viscosity = shapes(T, F, nu_F)
        form = np.exp(ln_h + exponent * gap + power * viscosity)
        return np.asarray(model.bath.h_W_m2K(T, F) * form * (F - T) * (1 + burst))

    own_k = model.steel.own_k[:n, :n]
    matrix = model.steel.own[:n, :n] + (ln_k - model.steel.ln_k) * own_k
    start = model.start_degC(at)
    T, q, slope = solve_surface(
        matrix, np.full(n, initial), lambda x: law(x, fluid, nu_fluid), start=start
    )
    gap, viscosity = shapes(T, fluid, nu_fluid)
    by_burst = q * burst / (1 + burst)
    by_shape = by_burst * reduced * p
    moved = fluid + np.array([[0.01], [-0.01]])
    rise_by_k = own_k @ q
    up, down = law(T, moved, nu(moved))
    explicit = [
        q,
        q * gap,
        q * viscosity,
        by_burst,
        by_shape,
        -by_shape * np.log(np.maximum(t / tau, 1e-12)),
        np.zeros(n),  # the entry only shifts time
        slope,
        (up - down) / 0.02,
        slope * rise_by_k,
    ]
    system = unit_less(slope, matrix)
    flux_by = solve_triangular(system, np.column_stack(explicit), lower=True, check_finite=False)
    temperature_by = matrix @ flux_by
    temperature_by[:, INITIAL] += 1.0
    temperature_by[:, -1] += rise_by_k
    h = q / np.where(np.abs(fluid - T) > 1e-6, fluid - T, np.nan)
    return RunSurface(T, q, h, temperature_by, np.asarray(flux_by))


def seen_through(parts: Array, steel: DiskInfluence, lay: PlungeParameters, theta: Array) -> Array:
    """What ``parts`` (C, 3, n, n) of a steel are at the conductivity and the depths of ``theta``: (C, n, n)."""
    c, _, n, _ = parts.shape
    off_k = np.full(c, theta[lay.at("ln_conductivity")][0] - steel.ln_k)
    weights = np.column_stack([np.ones(c), off_k, theta[lay.at("depth")] - steel.depth_shift_m])
    return (weights[:, None] @ parts.reshape(c, 3, n * n)).reshape(c, n, n)


def predict(
    models: Sequence[RunModel], lay: PlungeParameters, theta: Array
) -> tuple[list[Array], list[Array], list[RunSurface]]:
    """Of each run block readings (B, C), their derivatives (B, C, P) with every parameter of the fit, and surface."""
    steel = models[0].steel
    runs = len(models)
    surfaces = [solve_run(model, lay, theta, r) for r, model in enumerate(models)]
    n = len(steel.grid_s)
    c = len(lay.channels)
    flows = np.zeros(
        (len(FLOWS) + 2, runs, n)
    )  # flux, its derivatives with the run's parameters and ln K
    for r, s in enumerate(surfaces):
        flows[:, r, : len(s.flux_W_m2)] = np.vstack([s.flux_W_m2, s.flux_by[:, [*FLOWS, -1]].T])
    columns = np.empty(
        (len(flows) + 1, runs, c, n)
    )  # as they are read, and the derivative with depth
    through = seen_through(steel.readings, steel, lay, theta).reshape(c * n, n)
    columns[:-1] = (flows.reshape(-1, n) @ through.T).reshape(-1, runs, c, n)
    by_k, columns[-1] = (steel.readings[:, 1:] @ flows[0].T).transpose(1, 3, 0, 2)
    columns[-2] += by_k
    logit = theta[lay.at("common_split")] + theta[lay.at("split")]
    dt = np.diff(steel.grid_s)
    lag = theta[lay.at("lag")]
    y, delay = chain_on_grid(columns.reshape(-1, c, n), dt, lag, logit, lay.structure, runs)
    y = y.reshape(-1, runs, c, n)
    blocks = [_at_blocks(model, lay, theta, r, y[:, r], delay) for r, model in enumerate(models)]
    return [out for out, _ in blocks], [jacobian for _, jacobian in blocks], surfaces


def _at_blocks(
    model: RunModel, lay: PlungeParameters, theta: Array, r: int, y: Array, delay: Array
) -> tuple[Array, Array]:
    """Readings (B, C) and derivatives (B, C, P) from rises behind the chain, and their derivatives, on the grid."""
    own = theta[lay.run(r)]
    gain = 1 + theta[lay.at("gain")][:, None]
    each = range(len(lay.channels))
    reading = Reading.at(model.steel.grid_s, model.blocks.time_s - own[ENTRY] - delay[0][:, None])
    rate = reading.slope(y[0])
    rise, *by_flow, by_k, by_depth, by_lag, by_split = reading.value(y)
    by_lag = by_lag - rate * delay[1][:, None]
    by_split = by_split - rate * delay[2][:, None]
    level = own[INITIAL] + rise
    pivot = model.pivot_degC[:, None]
    jac = np.zeros((lay.size, *level.shape))
    by_run = jac[lay.run(r)]
    by_run[list(FLOWS)] = by_flow
    by_run[ENTRY] = -rate
    by_run[INITIAL] += 1.0
    jac[lay.at("ln_conductivity")] = by_k
    jac[lay.at("common_split")] = by_split
    for kind, column in {"lag": by_lag, "split": by_split, "depth": by_depth}.items():
        jac[lay.at(kind)][each, each] = column
    jac *= gain
    jac[lay.at("offset")][each, each] = 1.0
    jac[lay.at("gain")][each, each] = level - pivot
    out = gain * level + theta[lay.at("offset")][:, None] - (gain - 1) * pivot
    return out.T, jac.transpose(2, 1, 0)


def chain_on_grid(
    u: Array, dt_s: Array, lag_s: Array, logit: Array, structure: str, values: int = 1
) -> tuple[Array, Array]:
    """The chain of each channel applied to all rows of ``u`` (Q, C, n); then come the derivatives of the first V
    ``values`` with lag (V rows) and with logit (V rows), lags and logits being (C,): (Q + 2 V, C, n).

    Beside it the dead time with its two derivatives (3, C), which the caller applies by shifting time. Where lags act
    on straight lines between knots, so do their derivatives: they are those of the answer at the knots.
    """

    def parts(lag: Array, z: Array) -> Array:
        taus, delay, zero = stages(structure, lag, z)
        return np.stack([*taus, delay + 0 * lag, zero + 0 * lag])

    step_lag = 1e-5
    step_z = 1e-4
    shorter = np.maximum(lag_s - step_lag, 1e-9)
    by_lag = (parts(lag_s + step_lag, logit) - parts(shorter, logit)) / (lag_s + step_lag - shorter)
    by_z = (parts(lag_s, logit + step_z) - parts(lag_s, logit - step_z)) / (2 * step_z)
    *taus, delay, zero = parts(lag_s, logit)
    count = len(u)
    before = u
    for tau in [*taus[1:], taus[0]]:  # each adds rows, its own derivatives of the values
        tau = np.maximum(tau, SHORTEST_S)[:, None]
        decay, old, _ = step = lag_step(dt_s, 1 / tau)
        before = u
        u = stepped(u, step)
        drive = np.zeros((values, *u.shape[1:]))
        drive[..., 1:] = decay * dt_s / tau**2 * (u - before[: len(u)])[:values, :, :-1]
        drive[..., 1:] -= old / tau * np.diff(before[:values])
        u = np.concatenate([u, driven(drive, decay)])
    share = (zero / tau[:, 0])[:, None]
    by_zero = (before - u[:-values])[:values] / tau
    u[:-values] += share * (before - u[:-values])
    u[-values:] -= share * (u[-values:] + by_zero)
    by_tau = np.roll(
        u[count:].reshape(len(taus), values, *u.shape[1:]), 1, axis=0
    )  # the largest lag comes first
    along = np.stack([by_lag, by_z])
    rows = (
        np.einsum("akc,kvcn->avcn", along[:, :-2], by_tau) + along[:, None, -1, :, None] * by_zero
    )
    return np.concatenate([u[:count], *rows]), np.stack([delay, by_lag[-2], by_z[-2]])


def junction_degC(model: RunModel, lay: PlungeParameters, theta: Array, r: int) -> pd.DataFrame:
    """Temperatures [degC] of the junctions without the chain: a column a channel, a row an instant after entry [s]."""
    own = theta[lay.run(r)]
    n = len(model.grid_s)
    flux = solve_run(model, lay, theta, r).flux_W_m2
    rise = seen_through(model.steel.junctions, model.steel, lay, theta)[:, :n, :n] @ flux
    time_s = pd.Index(model.grid_s + own[ENTRY], name="time_s")
    return pd.DataFrame((own[INITIAL] + rise).T, index=time_s, columns=list(lay.channels))
