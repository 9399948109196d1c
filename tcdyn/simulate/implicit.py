"""Integration in time for the synthetic disk: an L-stable method of order four with few step sizes."""

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
FILM_TOLERANCE = 1e-9  # of a stage's rates: each round with another film than the factors' leaves a tenth or less
FILM_ROUNDS = 30

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
    """Steps grow in octaves from ``first_s`` after each break, never above ``growth`` times the time since it."""

    first_s: float = 1 / 300
    largest_s: float = 7.0
    growth: float = 0.15


@dataclass(frozen=True)
class Solution:
    """Readings at the solver's own steps: times (N,), values and rates (N, channels); the last state (n,)."""

    time_s: Array
    values: Array
    rates: Array
    pieces: tuple[slice, ...]  # the steps between two breaks
    state: Array

    def at(self, time_s: Array) -> Array:
        """Readings at any times (M,) -> (M, channels): cubic Hermite between steps, never across a break."""
        out = np.empty((len(time_s), self.values.shape[1]))
        starts = [self.time_s[piece.start] for piece in self.pieces]
        which = np.clip(np.searchsorted(starts, time_s, side="right") - 1, 0, len(starts) - 1)
        for number, piece in enumerate(self.pieces):
            here = which == number
            if here.any():
                spline = CubicHermiteSpline(
                    self.time_s[piece], self.values[piece], self.rates[piece]
                )
                out[here] = spline(time_s[here])
        return out


def steady_state(system: DiskSystem, power_W: float, ambient_degC: float) -> Array:
    """The state that no longer changes under constant power and ambient temperature."""
    load = _load(system, power_W, ambient_degC)
    factor = _factorise(system.conductance)
    state = factor.solve(load)
    for _ in range(FILM_ROUNDS if system.steel.follows else 0):
        before = state
        state = np.asarray(factor.solve(load + system.steel.conducted_W(state)))
        if np.abs(state - before).max() <= FILM_TOLERANCE * np.abs(state).max():
            break
    return state


def integrate(
    system: DiskSystem,
    power_W: Signal,
    ambient_degC: Signal,
    edges_s: tuple[float, ...],
    start: Array,
    stepping: Stepping | None = None,
    film_share: Signal = np.ones_like,
) -> Solution:
    """March C dT/dt = -S T + sources from ``edges_s[0]`` to ``edges_s[-1]``; h is ``film_share`` of the system's.

    ``edges_s`` (ascending) are the ends and the instants between at which power or ambient may jump or kink;
    inside each piece the signals are read strictly within it. The stage equations
    (C + h gamma S) k = load - S (y + h sum a k) share one factorisation per step size; what another film changes in
    S and what steel that follows temperature conducts and holds otherwise, stands on their right side and is iterated.
    """
    stepping = stepping or Stepping()
    factors: dict[float, SuperLU] = {}
    times: list[float] = []
    values = []
    rates = []
    pieces = []
    y = start
    for begin, end in pairwise(edges_s):
        steps = step_sizes(end - begin, stepping)
        t_steps = begin + np.concatenate([[0.0], np.cumsum(steps)])
        t_steps[-1] = end
        pieces.append(slice(len(times), len(times) + len(t_steps)))
        stage_t = np.clip(t_steps[:-1, None] + _C * steps[:, None], begin, end)
        nudge = 1e-9 * (end - begin)
        inside = np.clip(stage_t.ravel(), begin + nudge, end - nudge)
        edge_t = np.clip(t_steps, begin + nudge, end - nudge)
        signals = power_W, ambient_degC, lambda x: system.film_change(film_share(x))
        stages = np.stack(
            [s(inside).reshape(stage_t.shape) for s in signals], axis=-1
        )  # (steps, 5, 3)
        edges = np.stack([s(edge_t) for s in signals], axis=-1)
        for i in range(len(t_steps)):
            rate = system.steel.rate(_heat(system, y, *edges[i]), y, system.capacity)
            times.append(t_steps[i])
            values.append(system.sample @ y)
            rates.append(system.sample @ rate)
            if i == len(steps):
                break
            h = float(steps[i])
            if h not in factors:
                factors[h] = _factorise(diags(system.capacity) + h * _GAMMA * system.conductance)
            y = _step(system, factors[h], y, h, stages[i])
    return Solution(np.array(times), np.array(values), np.array(rates), tuple(pieces), y)


def step_sizes(length_s: float, stepping: Stepping) -> Array:
    """Octave steps that fill ``length_s`` exactly: growing, then falling to the remainder, which comes last."""
    steps: list[float] = []
    elapsed = 0.0
    while (left := length_s - elapsed) > 1e-9:
        allowed = min(max(stepping.first_s, stepping.growth * elapsed), stepping.largest_s)
        size = stepping.first_s * 2.0 ** np.floor(np.log2(allowed / stepping.first_s) + 1e-9)
        while size > left * (1 + 1e-12) and size > stepping.first_s:
            size *= 0.5
        steps.append(min(size, left))
        elapsed += steps[-1]
    return np.array(steps)


def _step(system: DiskSystem, factor: SuperLU, y: Array, h: float, signals: Array) -> Array:
    """One step of ``h`` [s]; ``signals`` (5, 3): power, ambient and change of the film at the stages."""
    stages = np.zeros((5, len(y)))
    for i, (power, ambient, film) in enumerate(signals):
        guess = y + h * (_A[i, :i] @ stages[:i]) if i else y
        heat = _heat(system, guess, power, ambient, film)
        rate = factor.solve(heat)
        for _ in range(FILM_ROUNDS if film or system.steel.follows else 0):
            left = heat - h * _GAMMA * film * system.surface_m2 * rate
            if system.steel.follows:
                left += system.steel.more_W(guess, guess + h * _GAMMA * rate, rate, system.capacity)
            before = rate
            rate = factor.solve(left)
            if np.abs(rate - before).max() <= FILM_TOLERANCE * np.abs(rate).max():
                break
        stages[i] = rate
    return y + h * (_A[4] @ stages)


def _heat(system: DiskSystem, y: Array, power: float, ambient: float, film: float) -> Array:
    """Heat [W] that warms each cell at the state ``y``, of which the ``film`` [W/m2K] beyond the system's takes part.

    The half cell of steel under the surface lets the film have its share of the power, too.
    """
    heat = _load(system, power, ambient) - system.conductance @ y
    if film:
        heat += film * (
            system.surface_air_m2 * (ambient + system.film_air_K)
            - system.surface_m2 * y
            - system.skin_m2K_W * power * system.track
        )
    return np.asarray(heat + system.steel.conducted_W(y) if system.steel.follows else heat)


def _load(system: DiskSystem, power: float, ambient: float) -> Array:
    return system.source_power * power + system.source_ambient * ambient + system.source_const


def _factorise(matrix: csc_matrix) -> SuperLU:
    return splu(
        csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
