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


@dataclass(frozen=True)
class RunModel:
    """A run made ready: influence matrices on its grid, linear in ln K and depths about (ln_k, depth_shift_m)."""

    grid_s: Array
    own: Array  # (n, n) surface on surface
    own_k: Array  # its derivative with ln K
    junctions: Array  # (3, C, n, n) surface on junctions, its derivatives with ln K and with depth
    readings: Array  # (3, C, n, n) the same behind the conditioning filter
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
        np.ascontiguousarray(behind.transpose(1, 2, 0, 3)),
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
    own = theta[lay.run(r)]
    surface = solve_run(model, lay, theta, r)
    dt = np.diff(model.grid_s)
    c, kinds = len(lay.channels), len(RUN_KINDS)
    columns = np.empty((c, len(model.grid_s), kinds + 3))  # value, run derivatives, ln K, depth
    # the value follows K and depths exactly; its other derivatives take the matrices where they were built
    columns[:, :, 1 : kinds + 2] = model.readings[0] @ surface.flux_by
    columns[:, :, 0], by_k, columns[:, :, kinds + 2] = rise_of(model.readings, model, lay, theta, surface)
    columns[:, :, kinds + 1] += by_k
    times = model.blocks.time_s - own[ENTRY]
    out = np.empty((len(times), c))
    jac = np.zeros((len(times), c, lay.size))
    lags, logits = theta[lay.at("lag")], theta[lay.at("common_split")] + theta[lay.at("split")]
    for j in range(c):
        value, by_lag, by_logit, delay = chain_on_grid(columns[j], dt, float(lags[j]), float(logits[j]), lay.structure)
        reading = Reading.at(model.grid_s, times - delay[0])
        y = reading.value(np.column_stack([value, by_lag, by_logit]))
        rate = reading.slope(value[:, 0])
        gain = 1 + theta[lay.at("gain")][j]
        level = own[INITIAL] + y[:, 0]
        out[:, j] = gain * level + theta[lay.at("offset")][j] - (gain - 1) * model.pivot_degC[j]
        by_run = y[:, 1 : kinds + 1]
        by_run[:, ENTRY] = -rate
        by_run[:, INITIAL] += 1.0
        jac[:, j, lay.run(r)] = gain * by_run
        jac[:, j, lay.at("ln_conductivity")] = gain * y[:, [kinds + 1]]
        by_split = gain * (y[:, -1] - rate * delay[2])
        jac[:, j, lay.at("common_split")] = by_split[:, None]
        own_kinds = {
            "lag": gain * (y[:, -2] - rate * delay[1]),
            "split": by_split,
            "depth": gain * y[:, kinds + 2],
            "offset": 1.0,
            "gain": level - model.pivot_degC[j],
        }
        for kind, column in own_kinds.items():
            jac[:, j, lay.at(kind).start + j] = column
    return out, jac, surface


def junction_degC(model: RunModel, lay: PlungeParameters, theta: Array, r: int) -> pd.DataFrame:
    """Temperatures [degC] of the junctions without the chain: a column a channel, a row an instant after entry [s]."""
    own = theta[lay.run(r)]
    surface = solve_run(model, lay, theta, r)
    rise = rise_of(model.junctions, model, lay, theta, surface)[0]
    time_s = pd.Index(model.grid_s + own[ENTRY], name="time_s")
    return pd.DataFrame((own[INITIAL] + rise).T, index=time_s, columns=list(lay.channels))


def chain_on_grid(
    u: Array, dt_s: Array, lag_s: float, logit: float, structure: str
) -> tuple[Array, Array, Array, tuple[float, float, float]]:
    """Lags of a chain applied to all columns of ``u`` (n, M); derivatives of column 0 with lag and logit (n,).

    Last comes the dead time with its two derivatives, which the caller applies by shifting time.
    """

    def parts(lag: float, z: float) -> Array:
        return np.hstack(stages(structure, lag, z))

    step_lag, step_z = 1e-5, 1e-4
    shorter = max(lag_s - step_lag, 1e-9)
    by_lag = (parts(lag_s + step_lag, logit) - parts(shorter, logit)) / (lag_s + step_lag - shorter)
    by_z = (parts(lag_s, logit + step_z) - parts(lag_s, logit - step_z)) / (2 * step_z)
    *taus, delay, zero = parts(lag_s, logit)
    taus = [max(float(tau), SHORTEST_S) for tau in taus]
    steps = [lag_step(dt_s, 1 / tau) for tau in taus]
    for step in steps[1:]:
        u = stepped(u, step)
    lagged = stepped(u, steps[0])
    rate = (u[:, 0] - lagged[:, 0]) / taus[0]  # of the lagged column: what a zero adds per second
    y = lagged + zero / taus[0] * (u - lagged)
    d_lag, d_z = rate * by_lag[-1], rate * by_z[-1]
    for i, (tau, step) in enumerate(zip(taus, steps)):
        by_tau = (stepped(y[:, :1], step)[:, 0] - y[:, 0]) / tau
        d_lag += by_tau * by_lag[i]
        d_z += by_tau * by_z[i]
    return y, d_lag, d_z, (float(delay), float(by_lag[-2]), float(by_z[-2]))


def lag_on_grid(u: Array, dt_s: Array, rate: float | complex) -> NDArray[Any]:
    """Unit-gain lag of ``rate`` [1/s] of deviations ``u`` (n, M) from equilibrium, linear between knots.

    Exact for that input; y[0] = 0, as before the first knot nothing had changed.
    """
    return stepped(u, lag_step(dt_s, rate))


def stepped(u: Array, step: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]) -> NDArray[Any]:
    """``lag_on_grid`` by its steps between the knots."""
    decay, old, new = step
    drive = np.zeros(u.shape, dtype=np.result_type(u, decay), order="F")
    drive[1:] = old[:, None] * u[:-1] + new[:, None] * u[1:]
    bands = np.zeros((2, len(u)), dtype=decay.dtype)
    bands[1, :-1] = -decay
    solve = ztbtrs if np.iscomplexobj(bands) else dtbtrs  # unit diagonal; thrice as quick as solve_banded's checks
    return np.asarray(solve(bands, drive, uplo="L", diag="U", overwrite_b=True)[0])


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
        """For times after entry ``times_s`` (B,); earlier ones read the initial state."""
        interval = np.clip(np.searchsorted(grid_s, times_s, side="right") - 1, 0, len(grid_s) - 2)
        width = np.diff(grid_s)[interval]
        after = times_s > 0
        share = np.where(after, (times_s - grid_s[interval]) / width, 0.0)
        return cls(interval, share, width, after)

    def value(self, y: Array) -> Array:
        """Deviation ``y`` (n, ...) at the blocks: straight lines between knots, zero before entry."""
        w = (self.share * self.after).reshape(-1, *(1,) * (y.ndim - 1))
        keep = self.after.reshape(w.shape)
        return np.asarray(keep * y[self.interval] + w * (y[self.interval + 1] - y[self.interval]))

    def slope(self, y: Array) -> Array:
        """Time derivative at the blocks [1/s]."""
        keep = (self.after / self.width_s).reshape(-1, *(1,) * (y.ndim - 1))
        return np.asarray(keep * (y[self.interval + 1] - y[self.interval]))
