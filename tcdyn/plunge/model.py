"""The plunge, from parameters to block readings, with exact derivatives: flux, conduction, chain, statics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtbtrs, ztbtrs

from calibration import Array
from calibration.disk import Conditioning, DiskSetup
from immersion.correlations import Bath, Correlation
from immersion.cylinder import Cylinder, influence, lag_step
from immersion.radial import plunge_grid, solve_surface
from tcdyn.plunge import RUN_KINDS, PlungeParameters, stages
from tcdyn.plunge.run import PlungeBlocks, PlungeRun

_DK = 0.02  # step of ln K in the central difference of the influence matrices
ONE = 1e-5  # imaginary over absolute part of a pole below which two are taken as real: their halves would cancel
SHORTEST_S = 1e-7  # of a lag
ENTRY, INITIAL = RUN_KINDS.index("entry"), RUN_KINDS.index("initial")
FLOWS = tuple(k for k in range(len(RUN_KINDS)) if k != ENTRY)  # of a run's parameters, those on which the flux depends


@dataclass(frozen=True)
class RunModel:
    """A run made ready: influence matrices on its grid, linear in ln K and depths about (ln_k, depth_shift_m)."""

    grid_s: Array
    own: Array  # (n, n) surface on surface
    own_k: Array  # its derivative with ln K
    junctions: Array  # (3, C, n, n) surface on junctions, its derivatives with ln K and with depth
    readings: Array  # (C, 3, n, n) the same behind the conditioning filter
    ln_k: float
    depth_shift_m: Array
    bath: Bath
    bath_degC: Array  # (n,)
    blocks: PlungeBlocks
    setup: DiskSetup
    step_K: float  # reference difference of the extra exponent
    pivot_degC: Array  # (C,) about which a static line's slope errs
    guess_degC: Array | None = None  # of the surface, where a solution begins


def build_run_model(
    run: PlungeRun,
    blocks: PlungeBlocks,
    setup: DiskSetup,
    layout: PlungeParameters,
    correlation: Correlation,
    about: Array,
    r: int = 0,
) -> RunModel:
    """Influence matrices of run ``r`` about the conductivity and the junction depths in ``about`` (P,).

    The surface solved there is the guess with which others begin.
    """
    ln_k, shift = float(about[layout.at("ln_conductivity")][0]), about[layout.at("depth")]
    grid = plunge_grid(blocks.duration_s + 2.0)
    nominal = Cylinder.from_setup(setup)
    depth = np.array([setup.junctions[c].depth_m for c in run.channels]) + shift
    c, extra = len(depth), 5e-5
    radii = nominal.outer_radius_m - np.concatenate([[0.0], depth, depth + extra])
    low, centre, high = (
        influence(replace(nominal, conductivity_W_mK=nominal.conductivity_W_mK * np.exp(ln_k + step)), radii, grid)[0]
        for step in (-_DK, 0.0, _DK)
    )
    slope = (high - low) / (2 * _DK)
    bath_degC = np.interp(grid, blocks.bath_time_s, blocks.bath_degC)
    initial = float(np.mean(blocks.readings_degC[blocks.time_s < 0]))
    junctions = np.stack([centre[1 : c + 1], slope[1 : c + 1], (centre[c + 1 :] - centre[1 : c + 1]) / extra])
    by_time = junctions.transpose(2, 0, 1, 3)
    behind = conditioned(by_time.reshape(len(grid), -1), np.diff(grid), setup.conditioning).reshape(by_time.shape)
    model = RunModel(
        grid,
        centre[0],
        slope[0],
        junctions,
        np.ascontiguousarray(behind.transpose(2, 1, 0, 3)),
        ln_k,
        shift,
        Bath(run.fluid, correlation, setup.width_m, 2 * setup.outer_radius_m),
        bath_degC,
        blocks,
        setup,
        max(abs(float(bath_degC[0]) - initial), 1.0),
        run.pivot_degC,
    )
    return replace(model, guess_degC=solve_run(model, layout, about, r).temperature_degC)


@dataclass(frozen=True)
class RunSurface:
    """Solved surface of a run: temperature, flux, h, and dq/d(parameter) (n, Q)."""

    temperature_degC: Array
    flux_W_m2: Array
    h_W_m2K: Array
    flux_by: Array  # (n, 9 + 1): run parameters, then ln K


def solve_run(model: RunModel, lay: PlungeParameters, theta: Array, r: int) -> RunSurface:
    """Surface balance of run ``r`` for all parameters ``theta``, with derivatives by the implicit theorem."""
    ln_h, exponent, power, ln_a, ln_tau, ln_p, _, initial, bath_offset = theta[lay.run(r)]
    ln_k = float(theta[lay.at("ln_conductivity")][0])
    t, n = model.grid_s, len(model.grid_s)
    tau, p = np.exp(ln_tau), np.exp(ln_p)
    reduced = (t / tau) ** p
    burst = np.exp(ln_a) * np.exp(-reduced)
    fluid = model.bath_degC + bath_offset

    def shapes(T: Array, F: Array) -> tuple[Array, Array]:
        size = np.maximum(np.abs(F - T), 1e-3 * model.step_K)
        return np.log(size / model.step_K), np.log(model.bath.fluid.nu(T) / model.bath.fluid.nu(F))

    def law(T: Array, F: Array) -> Array:
        gap, viscosity = shapes(T, F)
        form = np.exp(ln_h + exponent * gap + power * viscosity)
        return np.asarray(model.bath.h_W_m2K(T, F) * form * (F - T) * (1 + burst))

    matrix = model.own + (ln_k - model.ln_k) * model.own_k
    T, q, slope = solve_surface(matrix, np.full(n, initial), lambda x: law(x, fluid), start=model.guess_degC)
    gap, viscosity = shapes(T, fluid)
    by_burst = q * burst / (1 + burst)
    by_shape = by_burst * reduced * p
    explicit = [
        q,
        q * gap,
        q * viscosity,
        by_burst,
        by_shape,
        -by_shape * np.log(np.maximum(t / tau, 1e-12)),
        np.zeros(n),  # the entry only shifts time
        slope,
        (law(T, fluid + 0.01) - law(T, fluid - 0.01)) / 0.02,
        slope * (model.own_k @ q),
    ]
    system = np.eye(n) - slope[:, None] * matrix
    flux_by = solve_triangular(system, np.column_stack(explicit), lower=True, check_finite=False)
    h = q / np.where(np.abs(fluid - T) > 1e-6, fluid - T, np.nan)
    return RunSurface(T, q, h, np.asarray(flux_by))


def rise_of(
    parts: Array, model: RunModel, lay: PlungeParameters, theta: Array, surface: RunSurface
) -> tuple[Array, Array, Array]:
    """Rise (C, n) [K] of what ``parts`` (3, C, n, n) see, and its derivatives with ln K and depth."""
    rise, by_k, by_depth = parts @ surface.flux_W_m2
    rise = rise + (theta[lay.at("ln_conductivity")] - model.ln_k) * by_k
    return rise + (theta[lay.at("depth")] - model.depth_shift_m)[:, None] * by_depth, by_k, by_depth


def predict_run(model: RunModel, lay: PlungeParameters, theta: Array, r: int) -> tuple[Array, Array, RunSurface]:
    """Block readings (B, C) and their derivatives (B, C, P) with every parameter of the fit, for run ``r``."""
    surface = solve_run(model, lay, theta, r)
    off_k, off_depth = theta[lay.at("ln_conductivity")][0] - model.ln_k, theta[lay.at("depth")] - model.depth_shift_m
    (c, _, n, _), dt = model.readings.shape, np.diff(model.grid_s)
    weights = np.column_stack([np.ones(c), np.full(c, off_k), off_depth])
    seen = (weights[:, None] @ model.readings.reshape(c, 3, n * n)).reshape(c * n, n)
    columns = np.empty((len(FLOWS) + 3, c, n))  # value, what the flux depends on, ln K, depth
    columns[:-1] = (np.vstack([surface.flux_W_m2, surface.flux_by[:, [*FLOWS, -1]].T]) @ seen.T).reshape(-1, c, n)
    by_k, columns[-1] = np.moveaxis(model.readings[:, 1:] @ surface.flux_W_m2, 1, 0)
    columns[-2] += by_k
    own, gain, lag = theta[lay.run(r)], 1 + theta[lay.at("gain")], theta[lay.at("lag")]
    logit = theta[lay.at("common_split")] + theta[lay.at("split")]
    y, delay = chain_on_grid(columns, dt, lag, logit, lay.structure)
    reading = Reading.at(model.grid_s, model.blocks.time_s - own[ENTRY] - delay[0][:, None])
    rate = reading.slope(y[0])
    y = reading.value(y)
    level = own[INITIAL] + y[0]
    jac = np.zeros((lay.size, *level.shape))
    by_run, by_channel = jac[lay.run(r)], jac[lay.at("lag").start : lay.at("gain").stop].reshape(-1, c, *level.shape)
    by_run[list(FLOWS)] = y[1:-4]
    by_run[ENTRY] = -rate
    by_run[INITIAL] += 1.0
    jac[lay.at("ln_conductivity")], by_depth, by_lag, by_split = y[-4:]
    by_lag, by_split = by_lag - rate * delay[1][:, None], by_split - rate * delay[2][:, None]
    jac[lay.at("common_split")] = by_split
    each = range(c)
    for k, column in enumerate((by_lag, by_split, by_depth)):
        by_channel[k, each, each] = column
    jac *= gain[:, None]
    by_channel[3, each, each], by_channel[4, each, each] = 1.0, level - model.pivot_degC[:, None]
    out = gain[:, None] * level + (theta[lay.at("offset")] - (gain - 1) * model.pivot_degC)[:, None]
    return out.T, jac.transpose(2, 1, 0), surface


def junction_degC(model: RunModel, lay: PlungeParameters, theta: Array, r: int) -> pd.DataFrame:
    """Temperatures [degC] of the junctions without the chain: a column a channel, a row an instant after entry [s]."""
    own = theta[lay.run(r)]
    surface = solve_run(model, lay, theta, r)
    rise = rise_of(model.junctions, model, lay, theta, surface)[0]
    time_s = pd.Index(model.grid_s + own[ENTRY], name="time_s")
    return pd.DataFrame((own[INITIAL] + rise).T, index=time_s, columns=list(lay.channels))


def chain_on_grid(u: Array, dt_s: Array, lag_s: Array, logit: Array, structure: str) -> tuple[Array, Array]:
    """The chain of each channel applied to all rows of ``u`` (Q, C, n), and two rows more: the derivatives of the first
    with lag and logit (C,), (Q + 2, C, n).

    Then comes the dead time with its two derivatives (3, C), which the caller applies by shifting time. Where lags
    act on straight lines between knots, so do their derivatives: they are those of the answer at the knots.
    """

    def parts(lag: Array, z: Array) -> Array:
        taus, delay, zero = stages(structure, lag, z)
        return np.stack([*taus, delay + 0 * lag, zero + 0 * lag])

    step_lag, step_z = 1e-5, 1e-4
    shorter = np.maximum(lag_s - step_lag, 1e-9)
    by_lag = (parts(lag_s + step_lag, logit) - parts(shorter, logit)) / (lag_s + step_lag - shorter)
    by_z = (parts(lag_s, logit + step_z) - parts(lag_s, logit - step_z)) / (2 * step_z)
    *taus, delay, zero = parts(lag_s, logit)
    count, before = len(u), u
    for tau in [*taus[1:], taus[0]]:  # each adds a row, its own derivative of the first
        tau = np.maximum(tau, SHORTEST_S)[:, None]
        decay, old, _ = step = lag_step(dt_s, 1 / tau)
        before, u = u, stepped(u, step)
        drive = np.zeros((1, *u.shape[1:]))
        drive[0, :, 1:] = decay * dt_s / tau * (u[0, :, :-1] - before[0, :, :-1])
        drive[0, :, 1:] -= old * (before[0, :, 1:] - before[0, :, :-1])
        u = np.concatenate([u, driven(drive / tau, decay)])
    share = (zero / tau[:, 0])[:, None]
    by_zero = (before[0] - u[0]) / tau
    u[:-1] += share * (before - u[:-1])
    u[-1] -= share * (u[-1] + by_zero)
    by_tau = np.roll(u[count:], 1, axis=0)  # the largest lag comes first
    along = np.stack([by_lag, by_z])
    rows = np.einsum("akc,kcn->acn", along[:, :-2], by_tau) + along[:, -1, :, None] * by_zero
    return np.concatenate([u[:count], rows]), np.stack([delay, by_lag[-2], by_z[-2]])


def lag_on_grid(u: Array, dt_s: Array, rate: float | complex) -> NDArray[Any]:
    """Unit-gain lag of ``rate`` [1/s] of deviations ``u`` (n, M) from equilibrium, linear between knots.

    Exact for that input; y[0] = 0, as before the first knot nothing had changed.
    """
    return stepped(u.T, lag_step(dt_s, rate)).T


def stepped(u: Array, step: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]) -> NDArray[Any]:
    """Lags of ``u`` (Q, ..., n) by their steps (..., n - 1) between the knots."""
    decay, old, new = step
    drive = np.zeros(u.shape, dtype=np.result_type(u, decay))
    drive[..., 1:] = old * u[..., :-1] + new * u[..., 1:]
    return driven(drive, decay)


def driven(drive: NDArray[Any], decay: NDArray[Any]) -> NDArray[Any]:
    """y[k] = ``decay``[k - 1] y[k - 1] + ``drive``[k] along the last axis of (Q, ..., n), overwriting ``drive``."""
    bands = np.zeros((2, *drive.shape[1:]), dtype=decay.dtype)
    bands[1, ..., :-1] = -decay
    solve = ztbtrs if np.iscomplexobj(bands) else dtbtrs  # unit diagonal; thrice as quick as solve_banded's checks
    rows = drive.reshape(len(drive), -1).T
    return np.asarray(solve(bands.reshape(2, -1), rows, uplo="L", diag="U", overwrite_b=True)[0].T).reshape(drive.shape)


def conditioned(u: Array, dt_s: Array, filter_: Conditioning) -> Array:
    """The conditioning filter B applied to deviations ``u`` (n, M) on the grid: real poles one after the other, of a
    complex pair twice the real part of the first partial fraction of p1 p2/((s - p1)(s - p2)). A zero it may have is
    taken with the last pole, which then is real."""
    for factor in filter_.factors:
        before = u
        for p in np.roots(factor[::-1]).astype(complex):
            if abs(p.imag) < ONE * abs(p):
                u = np.asarray(lag_on_grid(u, dt_s, -p.real))
            elif p.imag > 0:
                u = np.asarray(np.real(p.conjugate() / (1j * p.imag) * -lag_on_grid(u, dt_s, -p)))
    if len(filter_.numerator) > 1:
        u = u + filter_.numerator[1] / filter_.factors[-1][1] * (before - u)
    return u


@dataclass(frozen=True)
class Reading:
    """Where block times fall on the grid: interval, share of the way through it, and whether after the entry."""

    interval: NDArray[np.intp]
    share: Array
    width_s: Array
    after: NDArray[np.bool_]

    @classmethod
    def at(cls, grid_s: Array, times_s: Array) -> Reading:
        """For times after entry ``times_s`` (..., B); earlier ones read the initial state."""
        interval = np.clip(np.searchsorted(grid_s, times_s, side="right") - 1, 0, len(grid_s) - 2)
        width = np.diff(grid_s)[interval]
        after = times_s > 0
        share = np.where(after, (times_s - grid_s[interval]) / width, 0.0)
        return cls(interval, share, width, after)

    def value(self, y: Array) -> Array:
        """Deviations ``y`` (..., n) at the blocks (..., B): straight lines between knots, zero before entry."""
        low, high = self._ends(y)
        return np.asarray(self.after * low + self.share * (high - low))

    def slope(self, y: Array) -> Array:
        """Time derivative at the blocks [1/s]."""
        low, high = self._ends(y)
        return np.asarray(self.after / self.width_s * (high - low))

    def _ends(self, y: Array) -> tuple[Array, Array]:
        """Of the intervals; times of several rows (C, B) are those of the rows (..., C, n) of y."""
        if self.interval.ndim == 1:
            return y[..., self.interval], y[..., self.interval + 1]
        at = self.interval + y.shape[-1] * np.arange(len(self.interval))[:, None]
        flat = y.reshape(*y.shape[:-2], -1)
        return np.take(flat, at, axis=-1), np.take(flat, at + 1, axis=-1)
