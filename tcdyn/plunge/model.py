"""The plunge, from parameters to block readings, with exact derivatives: flux, conduction, chain, statics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from calibration.disk import DiskSetup
from immersion.correlations import Bath, Correlation
from immersion.cylinder import Cylinder, influence
from immersion.radial import plunge_grid, solve_surface
from tcdyn.plunge.grid import Reading, conditioned, lag_on_grid
from tcdyn.plunge.layout import RUN_NAMES, Layout, stages
from tcdyn.plunge.run import Blocks, PlungeRun

Array = NDArray[np.float64]
_DK = 0.02  # step of ln K in the central difference of the influence matrices


@dataclass(frozen=True)
class RunModel:
    """A run made ready: influence matrices on its grid, linear in ln K and depths about (ln_k, depth_shift_m)."""

    grid_s: Array
    own: Array  # (n, n) surface on surface
    own_k: Array  # its derivative with ln K
    junction: Array  # (C, n, n)
    junction_k: Array
    junction_depth: Array
    leak: Array
    ln_k: float
    depth_shift_m: Array
    bath: Bath
    bath_degC: Array  # (n,)
    blocks: Blocks
    setup: DiskSetup
    layout: Layout
    step_K: float  # reference difference of the extra exponent


def build_run_model(
    run: PlungeRun,
    blocks: Blocks,
    setup: DiskSetup,
    layout: Layout,
    correlation: Correlation,
    ln_k: float = 0.0,
    depth_shift_m: Array | None = None,
    face_W_m2K: float = 0.0,
) -> RunModel:
    """Influence matrices of one run about a conductivity and junction depths."""
    shift = np.zeros(len(run.channels)) if depth_shift_m is None else np.asarray(depth_shift_m, dtype=float)
    grid = plunge_grid(blocks.duration_s + 2.0)
    depth = np.array([setup.junctions[c].depth_m for c in run.channels]) + shift
    nominal = Cylinder.from_setup(setup, face_W_m2K)

    def matrices(ln: float, extra_m: float) -> tuple[Array, Array]:
        k = nominal.conductivity_W_mK * np.exp(ln)
        steel = Cylinder(
            nominal.inner_radius_m, nominal.outer_radius_m, k, nominal.heat_capacity_J_m3K, nominal.leak_1_s
        )
        radii = nominal.outer_radius_m - np.concatenate([[0.0], depth, depth + extra_m])
        inf = influence(steel, radii, grid)
        return inf.matrix, inf.leak

    c = len(depth)
    extra = 5e-5
    centre, leak = matrices(ln_k, extra)
    up, down = matrices(ln_k + _DK, 0.0)[0], matrices(ln_k - _DK, 0.0)[0]
    slope = (up - down) / (2 * _DK)
    bath = Bath(run.fluid, correlation, setup.width_m, 2 * setup.outer_radius_m)
    bath_degC = np.interp(grid, blocks.bath_time_s, blocks.bath_degC)
    before = blocks.time_s < 0
    initial = float(np.mean(blocks.readings_degC[before]))
    return RunModel(
        grid,
        centre[0],
        slope[0],
        centre[1 : c + 1],
        slope[1 : c + 1],
        (centre[c + 1 :] - centre[1 : c + 1]) / extra,
        leak,
        ln_k,
        shift,
        bath,
        bath_degC,
        blocks,
        setup,
        layout,
        max(abs(float(bath_degC[0]) - initial), 1.0),
    )


@dataclass(frozen=True)
class Surface:
    """Solved surface of a run: temperature, flux, h, and dq/d(parameter) (n, Q), offset and its derivatives."""

    temperature_degC: Array
    flux_W_m2: Array
    h_W_m2K: Array
    flux_by: Array  # (n, 8 + 1): run parameters, then ln K
    offset_K: Array  # rise of the disk without flux (leak)
    offset_by: Array  # (n, 8 + 1)


def solve_run(model: RunModel, own: Array, ln_k: float, start: Array | None = None) -> Surface:
    """Surface balance of a run for its 8 parameters ``own`` and ``ln_k``, with derivatives by the implicit theorem."""
    ln_h, exponent, ln_a, ln_tau, ln_p, _, initial, bath_offset = own
    t, n = model.grid_s, len(model.grid_s)
    tau, p = np.exp(ln_tau), np.exp(ln_p)
    reduced = (t / tau) ** p
    burst = np.exp(ln_a) * np.exp(-reduced)
    fluid = model.bath_degC + bath_offset

    def law(T: Array, F: Array) -> Array:
        gap = F - T
        size = np.maximum(np.abs(gap), 1e-3 * model.step_K)
        return np.asarray(
            model.bath.h_W_m2K(T, F) * (size / model.step_K) ** exponent * gap * (1 + burst) * np.exp(ln_h)
        )

    matrix = model.own + (ln_k - model.ln_k) * model.own_k
    leak_one = model.leak.sum(axis=1)
    rise = model.leak @ (fluid - initial)
    T, q, slope = solve_surface(matrix, initial + rise, lambda x: law(x, fluid), start=start)
    size = np.maximum(np.abs(fluid - T), 1e-3 * model.step_K)
    by_burst = q * burst / (1 + burst)
    log_reduced = np.log(np.maximum(t / tau, 1e-12))
    explicit = np.column_stack(
        [
            q,
            q * np.log(size / model.step_K),
            by_burst,
            by_burst * reduced * p,
            -by_burst * reduced * p * log_reduced,
            np.zeros(n),
            np.zeros(n),
            (law(T, fluid + 0.01) - law(T, fluid - 0.01)) / 0.02,
            np.zeros(n),
        ]
    )
    offset_by = np.zeros((n, len(RUN_NAMES) + 1))
    offset_by[:, 6] = -leak_one
    offset_by[:, 7] = leak_one
    surface_by = offset_by.copy()
    surface_by[:, 6] += 1.0
    surface_by[:, 8] = model.own_k @ q
    system = np.eye(n) - slope[:, None] * matrix
    flux_by = solve_triangular(system, explicit + slope[:, None] * surface_by, lower=True, check_finite=False)
    h = q / np.where(np.abs(fluid - T) > 1e-6, fluid - T, np.nan)
    return Surface(T, q, h, np.asarray(flux_by), rise, offset_by)


def predict_run(
    model: RunModel, theta: Array, r: int, start: Array | None = None
) -> tuple[Array, NDArray[np.float64], Surface]:
    """Block readings (B, C) and their derivatives (B, C, P) with every parameter of the fit, for run ``r``."""
    lay = model.layout
    own, ln_k = theta[lay.run(r)], float(theta[lay.ln_k])
    surface = solve_run(model, own, ln_k, start)
    dt = np.diff(model.grid_s)
    c = len(lay.channels)
    n = len(model.grid_s)
    depth = theta[lay.depth] - model.depth_shift_m
    dk = ln_k - model.ln_k
    q = surface.flux_W_m2
    by_k, by_depth = model.junction_k @ q, model.junction_depth @ q  # (C, n)
    columns = np.empty((c, n, len(RUN_NAMES) + 3))  # value, 8 run derivatives, ln K, depth
    both = np.column_stack([q, surface.flux_by])
    # the value follows K and depths exactly; its other derivatives take the matrices where they were built
    columns[:, :, :10] = model.junction @ both
    columns[:, :, 0] += dk * by_k + depth[:, None] * by_depth
    columns[:, :, 0] += surface.offset_K
    columns[:, :, 1:10] += surface.offset_by
    columns[:, :, 9] += by_k
    columns[:, :, 10] = by_depth
    flat = columns.transpose(1, 0, 2).reshape(n, -1)
    filtered = conditioned(flat, dt, model.setup.conditioning).reshape(n, c, -1)
    times = model.blocks.time_s - own[5]
    out = np.empty((len(times), c))
    jac = np.zeros((len(times), c, lay.size))
    one = np.ones(len(times))
    for j in range(c):
        lag, logit = float(theta[lay.lag][j]), float(theta[lay.common_split] + theta[lay.split][j])
        value, by_lag, by_logit, delay = chain_on_grid(filtered[:, j], dt, lag, logit, lay.structure)
        reading = Reading.at(model.grid_s, times - delay[0])
        y = reading.value(value)
        rate = reading.slope(value[:, 0])
        gain = 1 + theta[lay.gain][j]
        level = own[6] + y[:, 0]
        out[:, j] = gain * level + theta[lay.offset][j]
        jac[:, j, lay.run(r)] = gain * y[:, 1:9]
        jac[:, j, lay.run(r).start + 5] = -gain * rate
        jac[:, j, lay.run(r).start + 6] += gain
        jac[:, j, lay.ln_k] = gain * y[:, 9]
        jac[:, j, lay.depth.start + j] = gain * y[:, 10]
        jac[:, j, lay.lag.start + j] = gain * (reading.value(by_lag) - rate * delay[1])
        by_split = gain * (reading.value(by_logit) - rate * delay[2])
        jac[:, j, lay.split.start + j] = by_split
        jac[:, j, lay.common_split] = by_split
        jac[:, j, lay.gain.start + j] = level
        jac[:, j, lay.offset.start + j] = one
    return out, jac, surface


def chain_on_grid(
    u: Array, dt_s: Array, lag_s: float, logit: float, structure: str
) -> tuple[Array, Array, Array, tuple[float, float, float]]:
    """Lags of a chain applied to all columns of ``u`` (n, M); derivatives of column 0 with lag and logit (n,).

    Last comes the dead time with its two derivatives, which the caller applies by shifting time.
    """

    def parts(lag: float, z: float) -> Array:
        taus, delay, zero = stages(structure, lag, z)  # type: ignore[arg-type]
        return np.array([*taus, delay, zero])

    step_lag, step_z = 1e-5, 1e-4
    shorter = max(lag_s - step_lag, 1e-9)
    by_lag = (parts(lag_s + step_lag, logit) - parts(shorter, logit)) / (lag_s + step_lag - shorter)
    by_z = (parts(lag_s, logit + step_z) - parts(lag_s, logit - step_z)) / (2 * step_z)
    *taus, delay, zero = parts(lag_s, logit)
    y = u
    for tau in taus[1:]:
        if tau > 1e-7:
            y = np.asarray(lag_on_grid(y, dt_s, 1 / tau))
    first = max(float(taus[0]), 1e-7)
    lagged = np.asarray(lag_on_grid(y, dt_s, 1 / first))
    rate = (y[:, 0] - lagged[:, 0]) / first  # of the lagged column: what a zero adds per second
    y = lagged + zero / first * (y - lagged)
    d_lag, d_z = rate * by_lag[-1], rate * by_z[-1]
    for i, tau in enumerate(taus):
        floor = max(float(tau), 1e-4)
        again = np.asarray(lag_on_grid(y[:, :1], dt_s, 1 / floor))[:, 0]
        by_tau = (again - y[:, 0]) / floor
        d_lag += by_tau * by_lag[i]
        d_z += by_tau * by_z[i]
    return y, d_lag, d_z, (float(delay), float(by_lag[-2]), float(by_z[-2]))
