"""How restless the temperature is in time, and knots as fine as that asks for, known events exactly on a knot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from calibration import Array, Flags
from tcdyn.chain import Chain, Sensor

STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128])  # samples per cell
FINE = 0.5  # cell length times the local corner of the smoother [rad]: halving it moves nothing by 1 % of the sd


@dataclass(frozen=True)
class Burst:
    """q(t) = height (1 + age/power)^-power, age = (t - start)/decay, after ``start_s`` [K2/s3].

    A step of flux on a surface decays with power 3 below it; a relaxation with one time constant, exponentially:
    a large power.
    """

    start_s: float
    height: float
    decay_s: float
    power: float = 3.0

    def before(self, t: Array) -> Array:
        """Integral of the burst up to time t [K2/s2]."""
        p = self.power
        age = np.maximum(t - self.start_s, 0.0) / self.decay_s
        return np.asarray(self.height * self.decay_s * p / (p - 1) * (1.0 - (1.0 + age / p) ** (1 - p)))

    def at(self, t: Array) -> Array:
        """The burst at time t (N,) [s], zero before it starts."""
        age = np.maximum(t - self.start_s, 0.0) / self.decay_s
        return np.where(t >= self.start_s, self.height * (1.0 + age / self.power) ** -self.power, 0.0)


@dataclass(frozen=True)
class Intensity:
    """d(slope) has variance q(t) dt; ``levels`` [K2/s3] hold from each of ``starts_s`` on, ``bursts`` add to them.

    >>> q = Intensity((0.0, 10.0), (1.0, 4.0), (Burst(10.0, 8.0, 2.0),))
    >>> q.at([5.0, 10.0, 16.0]).tolist()
    [1.0, 12.0, 5.0]
    >>> float(q.between([0.0, 10.0, 16.0])[1])
    42.0
    """

    starts_s: tuple[float, ...]
    levels: tuple[float, ...]
    bursts: tuple[Burst, ...] = ()

    @classmethod
    def constant(cls, level: float) -> Intensity:
        """The same ``level`` [K2/s3] at all times."""
        return cls((0.0,), (float(level),))

    def _level(self, t: Array) -> Array:
        return np.asarray(self.levels)[np.clip(np.searchsorted(self.starts_s, t, side="right") - 1, 0, None)]

    def at(self, t_s: ArrayLike) -> Array:
        """q(t) [K2/s3], same shape as ``t_s``."""
        t = np.asarray(t_s, dtype=float)
        return np.asarray(sum((burst.at(t) for burst in self.bursts), self._level(t)))

    def between(self, knots_s: ArrayLike) -> Array:
        """Integral of q over each cell of ``knots_s`` (J+1,), shape (J,) [K2/s2]."""
        t = np.asarray(knots_s, dtype=float)
        return np.asarray(sum((np.diff(b.before(t)) for b in self.bursts), self._level(t[:-1]) * np.diff(t)))

    def moved(self, was_s: float, to_s: float, shift_s: float = 0.0) -> Intensity:
        """With what begins at ``was_s`` begun at ``to_s`` instead, on a clock that starts ``shift_s`` later."""

        def new(start: float) -> float:
            return (to_s if start == was_s else start) - shift_s

        bursts = tuple(replace(b, start_s=new(b.start_s)) for b in self.bursts)
        return Intensity(tuple(new(s) for s in self.starts_s), self.levels, bursts)

    def shifted(self, by_s: float) -> Intensity:
        """The same on a clock that starts ``by_s`` later."""
        return self.moved(np.inf, np.inf, by_s)


@dataclass(frozen=True)
class Grid:
    """``knots_s (J+1,)``; ``kind (J,)``, an ``example`` cell of each; ``event (J,)``: whether a knot is an event."""

    knots_s: Array
    kind: NDArray[np.intp]
    example: NDArray[np.intp]
    event: Flags

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.kind)

    def cell_at(self, t: NDArray[np.floating[Any]], dt_s: float) -> NDArray[np.intp]:
        """The cell that each time of ``t`` (N,) [s] lies in; a sample on a knot belongs to the cell after it."""
        return np.clip(np.searchsorted(self.knots_s, t + 1e-6 * dt_s, side="right") - 1, 0, self.cells - 1)


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
    knots = [start_s]
    size = len(STEPS) - 1
    for number, stop in enumerate([*inside, end_s + 0.5 * dt_s], start=1):
        index = int(np.floor(knots[-1] / dt_s + 1 + 1e-6))
        if number > 1:
            knots.append(index * dt_s)
            size = 0
        else:
            index -= 1
        while index * dt_s < stop - 1e-6 * dt_s:
            most = int(np.searchsorted(STEPS, max(cell_s(index * dt_s) / dt_s, 1.0) + 1e-9, side="right")) - 1
            size = min(size + 1, most)
            index += int(STEPS[size])
            knots.append(index * dt_s)
        if number <= len(inside):
            while knots[-1] > stop - 1e-6 * dt_s:
                knots.pop()
            knots.append(stop)
    t = np.array(knots)
    keys = np.round(np.column_stack([np.diff(t) / dt_s, (t[:-1] / dt_s) % 1.0]), 6)
    keys[:, 1] %= 1.0
    _, example, kind = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return Grid(t, kind.reshape(-1), example, np.isin(t[:-1], inside))


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
    for where, rows, index, inside in _samples(grid, s, total, dt_s):
        index = np.where(inside, index, total)
        w = padded_w[index]
        information[where] = (w @ (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), n * n)).reshape(-1, n, n)
        score[where] = (w * padded_y[index]) @ rows
    return information, score


def readings(grid: Grid, s: Sensor, mean: Array, samples: int, dt_s: float) -> Array:
    """What the logger would have written without noise (samples,), from the states at the knots ``mean (J, n)``."""
    out = np.zeros(samples)
    for where, rows, index, inside in _samples(grid, s, samples, dt_s):
        out[index[inside]] = (mean[where] @ rows.T)[inside]
    return out


def read_variance(grid: Grid, s: Sensor, cov: Array, samples: int, dt_s: float) -> Array:
    """Variance (samples,) of those readings, from the covariances at the knots ``cov (J, n, n)``."""
    out = np.zeros(samples)
    for where, rows, index, inside in _samples(grid, s, samples, dt_s):
        out[index[inside]] = np.einsum("ri,jik,rk->jr", rows, cov[where], rows, optimize=True)[inside]
    return out


def _samples(
    grid: Grid, s: Sensor, samples: int, dt_s: float
) -> Iterator[tuple[NDArray[np.intp], Array, NDArray[np.intp], NDArray[np.bool_]]]:
    """For every kind of cell that reads samples: its cells (c,), the rows (count, n) that read a sample from the state

    at the knot, which samples those are (c, count), and whether the record holds them.
    """
    first = np.ceil((grid.knots_s + s.delay_s) / dt_s - 1e-6).astype(int)
    step = flow(s.drift, dt_s)
    for k, j in enumerate(grid.example):
        rows = np.empty((max(first[j + 1] - first[j], 0), s.size))
        if len(rows) == 0:
            continue
        rows[0] = s.output @ flow(s.drift, first[j] * dt_s - s.delay_s - grid.knots_s[j])
        for i in range(1, len(rows)):
            rows[i] = rows[i - 1] @ step
        where = np.flatnonzero(grid.kind == k)
        index = first[where][:, None] + np.arange(len(rows))
        yield where, rows, index, (index >= 0) & (index < samples)
