"""Time integration of the synthetic disk: L-stable SDIRK (Runge-Kutta) of order four.

``tcdyn.simulate.ehl.disk_run`` uses it on the equations of ``tcdyn.simulate.mesh.build_system``. It
is written for the simulator only: the fits use ``tcdyn.heat``, so that an error of one solver shows
as a difference. ``tests/simulate/test_disk.py`` checks the order of convergence, the steps and the
interpolation; ``tests/simulate/test_steel.py`` the iteration for steel that depends on temperature.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import SuperLU, splu

from tcdyn.core import Array
from tcdyn.simulate.mesh import DiskSystem

Signal = Callable[[Array], Array]  # time [s] -> value, smooth between breaks
# Change of state or rates between two iterations, over their largest value, at which the
# fixed-point iteration stops; chosen by judgement.
H_TOLERANCE = (
    1e-9  # relative change of the rates at which the fixed-point iteration stops; judgement
)
MAX_ITERATIONS = 30  # limit of the fixed-point iteration; chosen by judgement
NUDGE = 1e-9  # signals are read this far (share of a segment) inside its ends; by judgement

# Singly diagonally implicit Runge-Kutta, five stages, order four, stiffly accurate
# (Hairer & Wanner, Solving ODEs II, table 6.5).
_GAMMA = 0.25
_A = np.array(
    [
        [1 / 4, 0, 0, 0, 0],
        [1 / 2, 1 / 4, 0, 0, 0],
        [17 / 50, -1 / 25, 1 / 4, 0, 0],
        [371 / 1360, -137 / 2720, 15 / 544, 1 / 4, 0],
        [25 / 24, -49 / 48, 125 / 16, -85 / 12, 1 / 4],
    ]
)
_C = np.array([1 / 4, 3 / 4, 11 / 20, 1 / 2, 1])


@dataclass(frozen=True)
class Stepping:
    """Step sizes of the time integration: they grow in octaves after each break.

    Parameters
    ----------
    first_s
        Smallest step, and the first one after each break [s].
    largest_s
        Upper limit of a step [s].
    growth
        Upper limit of a step over the time since the break.

    Notes
    -----
    Chosen by judgement. Smaller steps cost time only. Larger ones fail the millikelvin test of the
    traces in ``tests/simulate/test_disk.py``.
    """

    first_s: float = 1 / 300
    largest_s: float = 7.0
    growth: float = 0.15


@dataclass(frozen=True)
class Solution:
    """Readings at the solver's steps.

    Parameters
    ----------
    time_s
        Times (N,) [s].
    values, rates
        Readings [degC] and their rates [K/s], (N, channels).
    segments
        The steps between two breaks, as slices of ``time_s``.
    state
        The last state of all unknowns (n,) [degC].
    """

    time_s: Array
    values: Array
    rates: Array
    segments: tuple[slice, ...]
    state: Array

    def at(self, time_s: Array) -> Array:
        """Return the readings at any times.

        The interpolation is cubic Hermite between steps, never across a break.

        Before the first and after the last step the nearest segment is extrapolated.

        Parameters
        ----------
        time_s
            Times (M,) [s].

        Returns
        -------
        array
            Readings (M, channels) [degC].
        """
        out = np.empty((len(time_s), self.values.shape[1]))
        starts = [self.time_s[segment.start] for segment in self.segments]
        index = np.clip(np.searchsorted(starts, time_s, side="right") - 1, 0, len(starts) - 1)
        for k, segment in enumerate(self.segments):
            in_segment = index == k
            if in_segment.any():
                spline = CubicHermiteSpline(
                    self.time_s[segment], self.values[segment], self.rates[segment]
                )
                out[in_segment] = spline(time_s[in_segment])
        return out


def steady_state(system: DiskSystem, power_W: float, ambient_degC: float) -> Array:
    """Return the steady state (n,) under constant power and ambient temperature.

    Parameters
    ----------
    system
        Equations of the disk.
    power_W
        Heat into the track [W].
    ambient_degC
        Ambient temperature [degC].

    Returns
    -------
    array
        State of all unknowns (n,) [degC].

    Notes
    -----
    h is that of ``system``. Steel that depends on temperature is iterated; the last iterate is
    returned where ``MAX_ITERATIONS`` do not suffice.
    """
    load = _source_heat_W(system, power_W, ambient_degC)
    factors = _factorise(system.conductance)
    state = factors.solve(load)
    if not system.steel.depends_on_temperature:
        return state
    for _ in range(MAX_ITERATIONS):
        previous = state
        state = np.asarray(factors.solve(load + system.steel.extra_conduction_W(state)))
        if _has_converged(state, previous):
            break
    return state


def _has_converged(values: Array, previous: Array) -> bool:
    """Whether the fixed-point iteration has converged."""
    return bool(np.abs(values - previous).max() <= H_TOLERANCE * np.abs(values).max())


def integrate(
    system: DiskSystem,
    power_W: Signal,
    ambient_degC: Signal,
    edges_s: tuple[float, ...],
    start: Array,
    stepping: Stepping | None = None,
    h_share: Signal = np.ones_like,
) -> Solution:
    """Integrate C dT/dt = -S T + sources from ``edges_s[0]`` to ``edges_s[-1]``.

    Parameters
    ----------
    system
        Equations of the disk.
    power_W, ambient_degC
        Heat into the track [W] and ambient temperature [degC] over time.
    edges_s
        Ascending times: start, breaks at which power or ambient may jump or kink, and end. Signals
        are read strictly inside each segment.
    start
        Initial state (n,).
    stepping
        Step sizes; None for the default ones.
    h_share
        Relative heat transfer coefficient of the surface over time: h over that of ``system``.

    Returns
    -------
    Solution
        Readings and their rates at all steps, and the last state.

    Notes
    -----
    The stage equations (C + h gamma S) k = load - S (y + h sum a k) share one factorisation for
    each step size. What another h changes in S, and what steel with temperature-dependent
    properties conducts and stores differently, is on their right side and is iterated.

    A new time-dependent term goes to the right side as the change of h does
    (``tcdyn.simulate.implicit._cell_heat_W`` and ``_iterate_stage``); a kink of any signal must be
    in ``edges_s``. ``tests/simulate/test_disk.py`` fails where the order is no longer four,
    ``tests/simulate/test_ehl.py`` where another h gives another system.
    """
    stepping = stepping or Stepping()
    factors: dict[float, SuperLU] = {}
    times: list[float] = []
    values = []
    rates = []
    segments = []
    y = start

    def signals_at(t: Array) -> Array:
        """Return power, ambient and change of the surface conductance, (..., 3)."""
        change = system.surface_conductance_change(h_share(t))
        return np.stack([power_W(t), ambient_degC(t), change], axis=-1)

    for begin, end in pairwise(edges_s):
        steps = step_sizes(end - begin, stepping)
        t_steps = begin + np.concatenate([[0.0], np.cumsum(steps)])
        t_steps[-1] = end
        segments.append(slice(len(times), len(times) + len(t_steps)))
        nudge = NUDGE * (end - begin)
        stage_t = np.clip(t_steps[:-1, None] + _C * steps[:, None], begin, end)
        inside = np.clip(stage_t.ravel(), begin + nudge, end - nudge)
        stage_signals = signals_at(inside).reshape(*stage_t.shape, 3)
        edge_signals = signals_at(np.clip(t_steps, begin + nudge, end - nudge))
        for i in range(len(t_steps)):
            heat = _cell_heat_W(system, y, *edge_signals[i])
            rate = system.steel.rate(heat, y, system.capacity)
            times.append(t_steps[i])
            values.append(system.sample @ y)
            rates.append(system.sample @ rate)
            if i == len(steps):
                break
            h = float(steps[i])
            if h not in factors:
                factors[h] = _factorise(diags(system.capacity) + h * _GAMMA * system.conductance)
            y = _step(system, factors[h], y, h, stage_signals[i])
    return Solution(np.array(times), np.array(values), np.array(rates), tuple(segments), y)


def step_sizes(length_s: float, stepping: Stepping) -> Array:
    """Return octave steps [s] that fill a segment exactly.

    They grow, then fall to the remainder, which comes last.

    Parameters
    ----------
    length_s
        Length of the segment [s].
    stepping
        Limits of the steps.

    Returns
    -------
    array
        Steps [s]. Their sum is ``length_s``.

    Notes
    -----
    All steps but the last are ``first_s`` times a power of two, so that few factorisations are
    needed. ``tests/simulate/test_disk.py`` checks the sum and the number of sizes.
    """
    steps: list[float] = []
    elapsed = 0.0
    remaining = length_s
    while remaining > 1e-9:
        allowed = min(max(stepping.first_s, stepping.growth * elapsed), stepping.largest_s)
        size = stepping.first_s * 2.0 ** np.floor(np.log2(allowed / stepping.first_s) + 1e-9)
        while size > remaining * (1 + 1e-12) and size > stepping.first_s:
            size *= 0.5
        steps.append(min(size, remaining))
        elapsed += steps[-1]
        remaining = length_s - elapsed
    return np.array(steps)


def _step(system: DiskSystem, factors: SuperLU, y: Array, h: float, signals: Array) -> Array:
    """Advance the state by one step.

    Parameters
    ----------
    system
        Equations of the disk.
    factors
        LU factors of C + h gamma S for this step size.
    y
        State at the start of the step (n,) [degC].
    h
        Step size [s].
    signals
        Power [W], ambient [degC] and change of the surface conductance [W/m2K] at the stages (5,
        3).

    Returns
    -------
    array
        State at the end of the step (n,).

    Notes
    -----
    The method is stiffly accurate: the last row of ``_A`` gives the result. Nodes and weights
    (``_A``, ``_C``, ``_GAMMA``) belong together.
    """
    stages = np.zeros((5, len(y)))
    for i, (power, ambient, change) in enumerate(signals):
        guess = y + h * (_A[i, :i] @ stages[:i]) if i else y
        heat = _cell_heat_W(system, guess, power, ambient, change)
        rate = factors.solve(heat)
        if change or system.steel.depends_on_temperature:
            rate = _iterate_stage(system, factors, guess, h, heat, change, rate)
        stages[i] = rate
    return y + h * (_A[4] @ stages)


def _iterate_stage(
    system: DiskSystem,
    factors: SuperLU,
    guess: Array,
    h: float,
    heat: Array,
    change: float,
    rate: Array,
) -> Array:
    """Return the rates of a stage with the terms outside the factorisation, by iteration.

    Parameters
    ----------
    system
        Equations of the disk.
    factors
        LU factors of C + h gamma S.
    guess
        State of the stage without its own rate (n,) [degC].
    h
        Step size [s].
    heat
        Heat at ``guess`` (n,) [W].
    change
        Change of the surface conductance [W/m2K].
    rate
        Rates without those terms, the start of the iteration (n,) [K/s].

    Returns
    -------
    array
        Rates (n,) [K/s].
    """
    for _ in range(MAX_ITERATIONS):
        right_side = heat - h * _GAMMA * change * system.surface_m2 * rate
        if system.steel.depends_on_temperature:
            state = guess + h * _GAMMA * rate
            right_side += system.steel.stage_correction_W(guess, state, rate, system.capacity)
        previous = rate
        rate = factors.solve(right_side)
        if _has_converged(rate, previous):
            break
    return rate


def _cell_heat_W(
    system: DiskSystem, y: Array, power: float, ambient: float, change: float
) -> Array:
    """Return the heat [W] that warms each cell at a state.

    Parameters
    ----------
    system
        Equations of the disk.
    y
        State (n,) [degC].
    power
        Heat into the track [W].
    ambient
        Ambient temperature [degC].
    change
        Surface conductance beyond that of ``system`` [W/m2K].

    Returns
    -------
    array
        Heat (n,) [W].

    Notes
    -----
    The heat of the track enters at the surface. The half cell of steel below it divides that heat
    between the surface conductance and the cell. So the change of the conductance takes a share of
    the power, too.
    """
    heat = _source_heat_W(system, power, ambient) - system.conductance @ y
    if change:
        heat += change * (
            system.surface_air_m2 * (ambient + system.film_air_K)
            - system.surface_m2 * y
            - system.skin_m2K_W * power * system.track
        )
    if system.steel.depends_on_temperature:
        heat = heat + system.steel.extra_conduction_W(y)
    return np.asarray(heat)


def _source_heat_W(system: DiskSystem, power: float, ambient: float) -> Array:
    """Return the heat [W] that power, ambient and constant sources bring to each cell."""
    return system.source_power * power + system.source_ambient * ambient + system.source_const


def _factorise(matrix: csc_matrix) -> SuperLU:
    """Return the LU factors of a symmetric matrix."""
    return splu(
        csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
