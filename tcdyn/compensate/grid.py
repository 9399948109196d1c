"""Knots in time: known events exactly on a knot, cells as long as the local smoothing allows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tcdyn.chain import Chain, Sensor

Array = NDArray[np.float64]
STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128])  # samples per cell
FINE = 0.5  # cell length times the local corner of the smoother [rad]: halving it moves nothing by 1 % of the sd


@dataclass(frozen=True)
class Grid:
    """``knots_s (J+1,)``; ``kind (J,)``, an ``example`` cell of each; ``event (J,)``: number of the event at a knot."""

    knots_s: Array
    kind: NDArray[np.intp]
    example: NDArray[np.intp]
    event: NDArray[np.intp]

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.kind)


def corner_rad_s(chain: Chain, ratio: Array) -> Array:
    """Where the signal sinks into the noise: |G(w)|^2 q / w^4 = R, for ``ratio`` = q / R [1/s4]; same shape."""
    w = np.geomspace(1e-4, 1e4, 400)
    needed = np.maximum.accumulate(4 * np.log(w) - 2 * np.log(np.abs(chain.frequency_response(w / 2 / np.pi)) + 1e-30))
    return np.asarray(np.exp(np.interp(np.log(ratio), needed, np.log(w))))


def make_grid(
    start_s: float, end_s: float, dt_s: float, events_s: Sequence[float], cell_s: Callable[[float], float]
) -> Grid:
    """Knots from ``start_s`` (a multiple of dt) past ``end_s``: every event a knot, other knots on the sample times.

    ``cell_s(t)`` is the longest cell wanted at time t [s]; cells grow by at most a half from one to the next.
    """
    inside = sorted(t for t in set(events_s) if start_s < t < end_s)
    stops = [*inside, end_s + 0.5 * dt_s]
    knots, events = [start_s], [0]
    size = len(STEPS) - 1
    for number, stop in enumerate(stops, start=1):
        index = int(np.floor(knots[-1] / dt_s + 1 + 1e-6))
        if number > 1:
            knots.append(index * dt_s)
            events.append(0)
            size = 0
        else:
            index -= 1
        while index * dt_s < stop - 1e-6 * dt_s:
            most = int(np.searchsorted(STEPS, max(cell_s(index * dt_s) / dt_s, 1.0) + 1e-9, side="right")) - 1
            size = min(size + 1, most)
            index += int(STEPS[size])
            knots.append(index * dt_s)
            events.append(0)
        if number <= len(inside):
            while knots[-1] > stop - 1e-6 * dt_s:
                knots.pop()
                events.pop()
            knots.append(stop)
            events.append(number)
    t = np.array(knots)
    keys = np.round(np.column_stack([np.diff(t) / dt_s, (t[:-1] / dt_s) % 1.0]), 6)
    keys[:, 1] %= 1.0
    _, example, kind = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return Grid(t, kind.reshape(-1), example, np.array(events[:-1]))


def transitions(grid: Grid, sensors: Sequence[Sensor]) -> Array:
    """expm(drift h) for every kind of cell and sensor, (K, B, n, n)."""
    lengths = np.diff(grid.knots_s)[grid.example]
    return np.stack([np.stack([flow(s.drift, float(h)) for s in sensors]) for h in lengths])


def flow(drift: Array, time_s: float) -> Array:
    """expm(drift time_s), remembered: channels and windows share their chains and their cells."""
    return _flow(drift.tobytes(), len(drift), round(time_s, 12))


@lru_cache(maxsize=20_000)
def _flow(drift: bytes, n: int, time_s: float) -> Array:
    result = np.asarray(expm(np.frombuffer(drift).reshape(n, n) * time_s))
    result.setflags(write=False)
    return result


def gather(grid: Grid, s: Sensor, y: Array, weight: Array, dt_s: float) -> tuple[Array, Array]:
    """Information (J, n, n) and score (J, n) that the samples ``y (N,)`` with weights (N,) give to each cell."""
    n, total = s.size, len(y)
    information, score = np.zeros((grid.cells, n, n)), np.zeros((grid.cells, n))
    padded_y, padded_w = np.append(y, 0.0), np.append(weight, 0.0)
    for k in range(len(grid.example)):
        first, rows = _rows(grid, s, k, dt_s)
        count = len(rows)
        if count == 0:
            continue
        where = np.flatnonzero(grid.kind == k)
        index = first[where][:, None] + np.arange(count)
        index = np.where((index >= 0) & (index < total), index, total)
        w = padded_w[index]
        information[where] = (w @ (rows[:, :, None] * rows[:, None, :]).reshape(count, n * n)).reshape(-1, n, n)
        score[where] = (w * padded_y[index]) @ rows
    return information, score


def readings(grid: Grid, s: Sensor, mean: Array, samples: int, dt_s: float) -> Array:
    """What the logger would have written without noise (samples,), from the states at the knots ``mean (J, n)``."""
    out = np.zeros(samples)
    for k in range(len(grid.example)):
        where = np.flatnonzero(grid.kind == k)
        first, rows = _rows(grid, s, k, dt_s)
        index = first[where][:, None] + np.arange(len(rows))
        values = mean[where] @ rows.T
        inside = (index >= 0) & (index < samples)
        out[index[inside]] = values[inside]
    return out


def read_variance(grid: Grid, s: Sensor, cov: Array, samples: int, dt_s: float) -> Array:
    """Variance (samples,) of those readings, from the covariances at the knots ``cov (J, n, n)``."""
    out = np.zeros(samples)
    for k in range(len(grid.example)):
        where = np.flatnonzero(grid.kind == k)
        first, rows = _rows(grid, s, k, dt_s)
        index = first[where][:, None] + np.arange(len(rows))
        values = np.einsum("ri,jik,rk->jr", rows, cov[where], rows, optimize=True)
        inside = (index >= 0) & (index < samples)
        out[index[inside]] = values[inside]
    return out


def _rows(grid: Grid, s: Sensor, k: int, dt_s: float) -> tuple[NDArray[np.intp], Array]:
    """First sample of every cell (J+1,), and the rows (count, n) that read the samples of a cell of kind ``k``."""
    first = np.ceil((grid.knots_s + s.delay_s) / dt_s - 1e-6).astype(int)
    j = grid.example[k]
    rows = np.empty((max(first[j + 1] - first[j], 0), s.size))
    if len(rows):
        step = flow(s.drift, dt_s)
        row = s.output @ flow(s.drift, first[j] * dt_s - s.delay_s - grid.knots_s[j])
        for i in range(len(rows)):
            rows[i] = row
            row = row @ step
    return first, rows
