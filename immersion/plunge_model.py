"""Forward model of a plunge with exact derivatives: flux, conduction, chain, static line.

Used by :mod:`immersion.plunge_posterior` (residuals and Jacobian) and by the design of plunges.
Surface heat balance by Newton's method, conduction by influence matrices, chain as exact
first-order lags. The derivatives follow from the implicit function theorem. Steps of differences
are chosen by judgement. Tests: ``tests/immersion/test_plunge_fit.py`` compares the derivatives with
differences and the chain on the grid with its transfer function.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.linalg import solve_triangular

from immersion.correlations import Bath, Correlation
from immersion.cylinder import (
    Cylinder,
    apply_conditioning,
    apply_lag_step,
    first_order_recursion,
    influence,
    lag_step,
)
from immersion.plunge_data import PlungeBlocks, PlungeRun
from immersion.plunge_parameters import RUN_KINDS, PlungeParameters, stages
from immersion.radial import GridInterpolation, identity_minus_product, plunge_grid, solve_surface
from tcdyn.core import Array
from tcdyn.rig.disk import DiskSetup

MIN_TAU_S = 1e-7  # least time constant [s] that is stepped; chosen by judgement: far below a sample
# Steps of central differences, chosen by judgement between truncation and rounding.
LN_K_STEP = 0.02  # of ln K, for the influence matrices
DEPTH_STEP_M = 5e-5  # of the junction's depth [m], one-sided
FLUID_STEP_K = 0.01  # of the bath's temperature [K]
LAG_STEP_S = 1e-5  # of a lag [s]
LOGIT_STEP = 1e-4  # of the logit of the split
# Positions of parameters within those of a run.
ENTRY = RUN_KINDS.index("entry")
INITIAL = RUN_KINDS.index("initial")
BATH = RUN_KINDS.index("bath")
# Parameters of a run on which the surface flux depends; the entry time only shifts the response.
FLUX_PARAMETERS = tuple(k for k in range(len(RUN_KINDS)) if k != ENTRY)


@dataclass(frozen=True)
class DiskInfluence:
    """Influence of the surface flux on a disk, on a grid, linearised in ln K and in the depths.

    The linearisation is about ``ln_k`` and ``depth_shift_m``. The influence for a shorter grid is
    the leading block.

    Attributes
    ----------
    grid_s
        Times after the entry (n,) [s].
    surface
        Surface on surface (n, n).
    surface_by_ln_k
        Its derivative with respect to ln K (n, n).
    junctions
        Surface on junctions, its derivatives with respect to ln K and to the depth (C, 3, n, n).
    readings
        The same after the conditioning filter (C, 3, n, n).
    ln_k
        ln of the conductivity over its nominal value.
    depth_shift_m
        Deviation of the depths from nominal (C,) [m].
    """

    grid_s: Array
    surface: Array
    surface_by_ln_k: Array
    junctions: Array
    readings: Array
    ln_k: float
    depth_shift_m: Array

    @classmethod
    def from_setup(
        cls, setup: DiskSetup, depth_m: Array, duration_s: float, ln_k: float, shift_m: Array
    ) -> DiskInfluence:
        """Influence matrices of a disk, linearised about a conductivity and depths.

        Parameters
        ----------
        setup
            The disk, with the conditioning filter.
        depth_m
            Nominal depths (C,) [m].
        duration_s
            Last time of the grid [s].
        ln_k
            ln of the conductivity over its nominal value.
        shift_m
            Deviations of the depths (C,) [m].

        Notes
        -----
        The grid is :func:`immersion.radial.plunge_grid` with its default steps. ``RunModel.grid_s``
        takes its leading knots, so that all runs must use the same steps.
        """
        grid = plunge_grid(duration_s)
        nominal = Cylinder.from_setup(setup)
        depth = depth_m + shift_m
        c = len(depth_m)
        radii = nominal.outer_radius_m - np.concatenate([[0.0], depth, depth + DEPTH_STEP_M])

        def matrices(log_factor: float, at_radii: Array) -> Array:
            """Influence (P, n, n) at radii (P,) with K times exp(``log_factor``) [K m2/W]."""
            conductivity = nominal.conductivity_W_mK * np.exp(log_factor)
            cylinder = replace(nominal, conductivity_W_mK=conductivity)
            return influence(cylinder, at_radii, grid)[0]

        low = matrices(ln_k - LN_K_STEP, radii[: c + 1])
        centre = matrices(ln_k, radii)
        high = matrices(ln_k + LN_K_STEP, radii[: c + 1])
        by_ln_k = (high - low) / (2 * LN_K_STEP)
        at_depth = centre[1 : c + 1]
        by_depth = (centre[c + 1 :] - at_depth) / DEPTH_STEP_M
        junctions = np.stack([at_depth, by_ln_k[1:], by_depth], axis=1)
        filter_matrix = apply_conditioning(np.eye(len(grid)), np.diff(grid), setup.conditioning)
        readings = filter_matrix @ junctions
        return cls(grid, centre[0], by_ln_k[0], junctions, readings, ln_k, shift_m)


@dataclass(frozen=True)
class SurfaceGuess:
    """A solved surface of a run and its tangent, from which other solutions start.

    Attributes
    ----------
    parameters
        Parameters of the run and ln K (10,).
    temperature_degC
        Surface temperature (n,).
    derivatives
        Its derivatives with respect to ``parameters`` (n, 10).
    """

    parameters: Array
    temperature_degC: Array
    derivatives: Array


@dataclass(frozen=True)
class RunModel:
    """Everything that the prediction of one run needs.

    Attributes
    ----------
    influence
        Influence of the disk; the run uses the leading n knots of its grid.
    bath
        Fluid, correlation and dimensions.
    bath_degC
        Bath temperature on the grid (n,).
    blocks
        Block means of the readings.
    step_K
        Reference difference dT_0 of the extra exponent of h.
    pivot_degC
        Temperature (C,) about which the slope of a static line errs.
    guess
        Start of the surface solver, None: none.
    """

    influence: DiskInfluence
    bath: Bath
    bath_degC: Array
    blocks: PlungeBlocks
    step_K: float
    pivot_degC: Array
    guess: SurfaceGuess | None = None

    @property
    def grid_s(self) -> Array:
        """Times after the entry (n,) [s]."""
        return self.influence.grid_s[: len(self.bath_degC)]

    def start_degC(self, parameters: Array) -> Array | None:
        """Start (n,) of the surface solver: the tangent, clipped to bath and disk.

        Parameters
        ----------
        parameters
            Parameters of the run and ln K (10,).

        Returns
        -------
        start
            (n,) [degC]; None without a guess.
        """
        if self.guess is None:
            return None
        surface = self.guess.temperature_degC
        disk_degC = np.full(len(surface), parameters[INITIAL])
        low, high = np.sort([disk_degC, self.bath_degC + parameters[BATH]], axis=0)
        shift = np.zeros_like(parameters)
        differs = parameters != self.guess.parameters  # "no burst" is minus infinity in both
        np.subtract(parameters, self.guess.parameters, out=shift, where=differs)
        return np.clip(surface + self.guess.derivatives @ shift, low, high)


def build_run_models(
    runs: Sequence[PlungeRun],
    blocks: Sequence[PlungeBlocks],
    setup: DiskSetup,
    layout: PlungeParameters,
    correlation: Correlation,
    about: Array,
) -> tuple[RunModel, ...]:
    """Models of all runs, linearised about conductivity and depths in ``about`` (P,).

    The surface solved at ``about`` and its tangent become the start of later solutions.

    Parameters
    ----------
    runs, blocks
        Runs and their block means, in the order of the layout.
    setup
        The disk, with the (whitened) conditioning filter.
    layout
        Layout of the parameter vector.
    correlation
        Correlation of natural convection.
    about
        Parameters (P,).

    Returns
    -------
    models
        One for each run.

    Notes
    -----
    The grid reaches 2 s beyond the last block, so that a shifted entry stays within it.
    """
    depth = np.array([setup.junctions[c].depth_m for c in layout.channels])
    durations_s = [b.duration_s + 2.0 for b in blocks]
    ln_k = float(about[layout.at("ln_conductivity")][0])
    shift_m = about[layout.at("depth")]
    disk = DiskInfluence.from_setup(setup, depth, max(durations_s), ln_k, shift_m)
    models = []
    for r, (run, run_blocks, duration_s) in enumerate(zip(runs, blocks, durations_s)):
        grid = plunge_grid(duration_s)
        bath_degC = np.interp(grid, run_blocks.bath_time_s, run_blocks.bath_degC)
        before_degC = float(np.mean(run_blocks.readings_degC[run_blocks.time_s < 0]))
        step_K = max(abs(float(bath_degC[0]) - before_degC), 1.0)
        bath = Bath(run.fluid, correlation, setup.width_m, 2 * setup.outer_radius_m)
        model = RunModel(disk, bath, bath_degC, run_blocks, step_K, run.pivot_degC)
        surface = solve_run(model, layout, about, r)
        parameters = np.append(about[layout.run(r)], ln_k)
        guess = SurfaceGuess(parameters, surface.temperature_degC, surface.temperature_derivatives)
        models.append(replace(model, guess=guess))
    return tuple(models)


@dataclass(frozen=True)
class RunSurface:
    """Solved surface of a run, and its derivatives with respect to the run's parameters.

    The derivatives are with respect to the run's parameters, then ln K.

    Attributes
    ----------
    temperature_degC, flux_W_m2, h_W_m2K
        Each (n,).
    temperature_derivatives, flux_derivatives
        Each (n, 10), by the nine parameters of the run in the order of ``RUN_KINDS``, then by ln K.
    """

    temperature_degC: Array
    flux_W_m2: Array
    h_W_m2K: Array
    temperature_derivatives: Array
    flux_derivatives: Array


def solve_run(model: RunModel, layout: PlungeParameters, theta: Array, r: int) -> RunSurface:
    """Solve the surface heat balance of run ``r`` at the parameters ``theta`` (P,).

    Parameters
    ----------
    model
        Model of the run.
    layout
        Layout of the parameter vector.
    theta
        Parameters (P,).
    r
        Index of the run.

    Returns
    -------
    surface
        Solved surface with its derivatives.

    Notes
    -----
    q = s (|dT|/dT_0)^m (nu_wall/nu_bath)^v h_correlation (1 + A exp(-(t/tau)^p)) (T_f - T_s), T_s =
    T_0 + M q. The derivatives follow from the implicit function theorem: (I - diag(dq/dT_s) M)
    dq/dx = partial q/partial x.

    ``partial`` lists the derivatives in the order of ``RUN_KINDS`` of
    :mod:`immersion.plunge_parameters`, then ln K. A new factor of h needs its entry there and a new
    kind in ``RUN_KINDS``. Test: ``tests/immersion/test_plunge_fit.py`` (derivatives).
    """
    parameters = np.append(theta[layout.run(r)], theta[layout.at("ln_conductivity")])
    ln_h, exponent, power, ln_a, ln_tau, ln_p, _, initial, bath_offset, ln_k = parameters
    t = model.grid_s
    n = len(t)
    nu = model.bath.fluid.nu
    tau = np.exp(ln_tau)
    p = np.exp(ln_p)
    reduced = (t / tau) ** p
    burst = np.exp(ln_a) * np.exp(-reduced)
    fluid = model.bath_degC + bath_offset
    nu_fluid = nu(fluid)

    def log_ratios(T: Array, F: Array, nu_F: Array) -> tuple[Array, Array]:
        """ln(|dT|/dT_0) and ln(nu_wall/nu_bath)."""
        size = np.maximum(np.abs(F - T), 1e-3 * model.step_K)
        return np.log(size / model.step_K), np.log(nu(T) / nu_F)

    def flux(T: Array, F: Array, nu_F: Array) -> Array:
        """Flux into the disk [W/m2] for surface and bath temperatures of shapes that broadcast."""
        log_step, log_viscosity = log_ratios(T, F, nu_F)
        factor = np.exp(ln_h + exponent * log_step + power * log_viscosity)
        return model.bath.h_W_m2K(T, F) * factor * (F - T) * (1 + burst)

    matrix_by_ln_k = model.influence.surface_by_ln_k[:n, :n]
    matrix = model.influence.surface[:n, :n] + (ln_k - model.influence.ln_k) * matrix_by_ln_k
    T, q, slope = solve_surface(
        matrix,
        np.full(n, initial),
        lambda x: flux(x, fluid, nu_fluid),
        start=model.start_degC(parameters),
    )
    log_step, log_viscosity = log_ratios(T, fluid, nu_fluid)
    by_ln_a = q * burst / (1 + burst)
    by_ln_tau = by_ln_a * reduced * p
    fluid_pair = fluid + np.array([[FLUID_STEP_K], [-FLUID_STEP_K]])
    up, down = flux(T, fluid_pair, nu(fluid_pair))
    rise_by_ln_k = matrix_by_ln_k @ q
    partial = [
        q,
        q * log_step,
        q * log_viscosity,
        by_ln_a,
        by_ln_tau,
        -by_ln_tau * np.log(np.maximum(t / tau, 1e-12)),
        np.zeros(n),  # the entry only shifts time
        slope,
        (up - down) / (2 * FLUID_STEP_K),
        slope * rise_by_ln_k,
    ]
    system = identity_minus_product(slope, matrix)
    flux_derivatives = solve_triangular(
        system, np.column_stack(partial), lower=True, check_finite=False
    )
    temperature_derivatives = matrix @ flux_derivatives
    temperature_derivatives[:, INITIAL] += 1.0
    temperature_derivatives[:, -1] += rise_by_ln_k
    h = q / np.where(np.abs(fluid - T) > 1e-6, fluid - T, np.nan)
    return RunSurface(T, q, h, temperature_derivatives, flux_derivatives)


def influence_at(
    matrices: Array, disk: DiskInfluence, layout: PlungeParameters, theta: Array
) -> Array:
    """Influence matrices (C, n, n) at the conductivity and the depths of ``theta``.

    Parameters
    ----------
    matrices
        ``junctions`` or ``readings`` of ``disk`` (C, 3, n, n).
    disk
        Influence of the disk, with the point of linearisation.
    layout
        Layout of the parameter vector.
    theta
        Parameters (P,).

    Returns
    -------
    matrices
        (C, n, n) [K m2/W].
    """
    c, _, n, _ = matrices.shape
    ln_k_shift = np.full(c, theta[layout.at("ln_conductivity")][0] - disk.ln_k)
    depth_shift = theta[layout.at("depth")] - disk.depth_shift_m
    weights = np.column_stack([np.ones(c), ln_k_shift, depth_shift])
    return (weights[:, None] @ matrices.reshape(c, 3, n * n)).reshape(c, n, n)


def predict(
    models: Sequence[RunModel], layout: PlungeParameters, theta: Array
) -> tuple[list[Array], list[Array], list[RunSurface]]:
    """Predict all runs.

    Parameters
    ----------
    models
        One model for each run; all have the same ``influence``.
    layout
        Layout of the parameter vector.
    theta
        Parameters (P,).

    Returns
    -------
    readings, jacobians, surfaces
        For each run: block readings (B, C), their derivatives (B, C, P) with respect to every
        parameter of the fit, and the solved surface.

    Notes
    -----
    All runs pass conduction and chain in one product, which is why the influence is common. The
    Jacobian must stay that of the readings: ``tests/immersion/test_plunge_fit.py``.
    """
    disk = models[0].influence
    n_runs = len(models)
    surfaces = [solve_run(model, layout, theta, r) for r, model in enumerate(models)]
    n = len(disk.grid_s)
    c = len(layout.channels)
    # rows: flux, then its derivatives with respect to the run's parameters and to ln K
    fluxes = np.zeros((len(FLUX_PARAMETERS) + 2, n_runs, n))
    for r, surface in enumerate(surfaces):
        derivatives = surface.flux_derivatives[:, [*FLUX_PARAMETERS, -1]].T
        fluxes[:, r, : len(surface.flux_W_m2)] = np.vstack([surface.flux_W_m2, derivatives])
    # the same rows after conduction and conditioning filter, then the derivative with respect to
    # the depth
    rises = np.empty((len(fluxes) + 1, n_runs, c, n))
    matrix = influence_at(disk.readings, disk, layout, theta).reshape(c * n, n)
    rises[:-1] = (fluxes.reshape(-1, n) @ matrix.T).reshape(-1, n_runs, c, n)
    explicit = (disk.readings[:, 1:] @ fluxes[0].T).transpose(1, 3, 0, 2)
    rises[-2] += explicit[0]
    rises[-1] = explicit[1]
    logit = theta[layout.at("common_split")] + theta[layout.at("split")]
    dt = np.diff(disk.grid_s)
    lag = theta[layout.at("lag")]
    y, delay = chain_on_grid(
        rises.reshape(-1, c, n), dt, lag, logit, layout.structure, values=n_runs
    )
    y = y.reshape(-1, n_runs, c, n)
    readings = []
    jacobians = []
    for r, model in enumerate(models):
        reading, jacobian = _at_blocks(model, layout, theta, r, y[:, r], delay)
        readings.append(reading)
        jacobians.append(jacobian)
    return readings, jacobians, surfaces


def _at_blocks(
    model: RunModel, layout: PlungeParameters, theta: Array, r: int, y: Array, delay: Array
) -> tuple[Array, Array]:
    """Block readings (B, C) and derivatives (B, C, P) of run ``r``.

    Parameters
    ----------
    model
        Model of the run.
    layout
        Layout of the parameter vector.
    theta
        Parameters (P,).
    r
        Index of the run.
    y
        Temperature rises after the chain on the grid with their derivatives, (Q, C, n).
    delay
        Dead times with their derivatives by lag and split (3, C).

    Returns
    -------
    readings
        (B, C) [degC].
    jacobian
        (B, C, P).
    """
    run = theta[layout.run(r)]
    gain = 1 + theta[layout.at("gain")][:, None]
    channel = range(len(layout.channels))
    times_s = model.blocks.time_s - run[ENTRY] - delay[0][:, None]
    reading = GridInterpolation.at(model.influence.grid_s, times_s)
    rate = reading.slope(y[0])
    rise, *by_flux, by_ln_k, by_depth, by_lag, by_split = reading.value(y)
    by_lag = by_lag - rate * delay[1][:, None]
    by_split = by_split - rate * delay[2][:, None]
    level = run[INITIAL] + rise
    pivot = model.pivot_degC[:, None]
    jacobian = np.zeros((layout.size, *level.shape))
    by_run = jacobian[layout.run(r)]
    by_run[list(FLUX_PARAMETERS)] = by_flux
    by_run[ENTRY] = -rate
    by_run[INITIAL] += 1.0
    jacobian[layout.at("ln_conductivity")] = by_ln_k
    jacobian[layout.at("common_split")] = by_split
    jacobian[layout.at("lag")][channel, channel] = by_lag
    jacobian[layout.at("split")][channel, channel] = by_split
    jacobian[layout.at("depth")][channel, channel] = by_depth
    jacobian *= gain
    jacobian[layout.at("offset")][channel, channel] = 1.0
    jacobian[layout.at("gain")][channel, channel] = level - pivot
    readings = gain * level + theta[layout.at("offset")][:, None] - (gain - 1) * pivot
    return readings.T, jacobian.transpose(2, 1, 0)


def chain_on_grid(
    u: Array, dt_s: Array, lag_s: Array, logit: Array, structure: str, values: int = 1
) -> tuple[Array, Array]:
    """Apply each channel's chain to all rows of ``u``, with derivatives by lag and split.

    Parameters
    ----------
    u
        Inputs on the grid (Q, C, n).
    dt_s
        Steps of the grid (n - 1,) [s].
    lag_s, logit
        Lag [s] and logit of the split of each channel (C,).
    structure
        Chain structure.
    values
        V: the derivatives are those of the first V rows.

    Returns
    -------
    y
        Outputs, then the derivatives of the first V with respect to lag (V rows) and logit (V
        rows): (Q + 2 V, C, n).
    delay
        Dead time with its two derivatives (3, C). The caller applies it by shifting time.

    Notes
    -----
    A lag acts on straight lines between knots. Its derivatives do so, too: they are those of the
    response at the knots.

    The chain must be that of ``tcdyn.chain.Chain`` with the time constants of
    :func:`immersion.plunge_parameters.stages`: ``tests/immersion/test_plunge_fit.py``.
    """

    def components(lag: Array, z: Array) -> Array:
        """Time constants, dead time and zero in one array (S, C)."""
        taus, delay, zero = stages(structure, lag, z)
        return np.stack([*taus, delay + 0 * lag, zero + 0 * lag])

    longer = lag_s + LAG_STEP_S
    shorter = np.maximum(lag_s - LAG_STEP_S, 1e-9)
    by_lag = (components(longer, logit) - components(shorter, logit)) / (longer - shorter)
    upper = components(lag_s, logit + LOGIT_STEP)
    lower = components(lag_s, logit - LOGIT_STEP)
    by_logit = (upper - lower) / (2 * LOGIT_STEP)
    *taus, delay, zero = components(lag_s, logit)
    count = len(u)
    before = u
    for tau in [*taus[1:], taus[0]]:  # each stage appends rows: the derivatives by its own tau
        tau = np.maximum(tau, MIN_TAU_S)[:, None]
        step = lag_step(dt_s, 1 / tau)
        decay, old, _ = step
        before = u
        u = apply_lag_step(u, step)
        drive = np.zeros((values, *u.shape[1:]))
        drive[..., 1:] = decay * dt_s / tau**2 * (u - before[: len(u)])[:values, :, :-1]
        drive[..., 1:] -= old / tau * np.diff(before[:values])
        u = np.concatenate([u, first_order_recursion(drive, decay)])
    share = (zero / tau[:, 0])[:, None]
    by_zero = (before - u[:-values])[:values] / tau
    u[:-values] += share * (before - u[:-values])
    u[-values:] -= share * (u[-values:] + by_zero)
    by_tau = u[count:].reshape(len(taus), values, *u.shape[1:])
    by_tau = np.roll(by_tau, 1, axis=0)  # the largest time constant, stepped last, comes first
    along = np.stack([by_lag, by_logit])
    rows = np.einsum("akc,kvcn->avcn", along[:, :-2], by_tau)
    rows += along[:, None, -1, :, None] * by_zero
    return np.concatenate([u[:count], *rows]), np.stack([delay, by_lag[-2], by_logit[-2]])


def junction_degC(model: RunModel, layout: PlungeParameters, theta: Array, r: int) -> pd.DataFrame:
    """Temperatures of the junctions without the chain [degC], by channel and ``time_s``.

    Parameters
    ----------
    model
        Model of the run.
    layout
        Layout of the parameter vector.
    theta
        Parameters (P,).
    r
        Index of the run.

    Returns
    -------
    table
        One row for each knot of the grid; ``time_s`` is after the nominal entry.
    """
    run = theta[layout.run(r)]
    n = len(model.grid_s)
    flux = solve_run(model, layout, theta, r).flux_W_m2
    disk = model.influence
    rise = influence_at(disk.junctions, disk, layout, theta)[:, :n, :n] @ flux
    time_s = pd.Index(model.grid_s + run[ENTRY], name="time_s")
    return pd.DataFrame((run[INITIAL] + rise).T, index=time_s, columns=list(layout.channels))
