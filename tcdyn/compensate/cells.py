"""How restless the temperature is, and cells of time as fine as that asks for: a stretch as a linear model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from calibration import Array, Flags
from tcdyn.chain import Chain, Sensor
from tcdyn.compensate.stretch import Stretch

STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128])  # samples per cell
FINE = 0.5  # cell length times the local corner of the smoother [rad]: halving it moves nothing by 1 % of the sd
DIFFUSE = 10.0  # prior sd of level, slope and slope jumps, in ranges of the record (per lag): wide, yet well scaled


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

    def at(self, t_s: ArrayLike) -> Array:
        """q(t) [K2/s3], same shape as ``t_s``."""
        t = np.asarray(t_s, dtype=float)
        q: Array = np.asarray(self.levels)[np.clip(np.searchsorted(self.starts_s, t, side="right") - 1, 0, None)]
        for b in self.bursts:
            age = np.maximum(t - b.start_s, 0.0) / b.decay_s
            q = q + np.where(t >= b.start_s, b.height * (1.0 + age / b.power) ** -b.power, 0.0)
        return q

    def between(self, knots_s: ArrayLike) -> Array:
        """Integral of q over each cell of ``knots_s`` (J+1,), shape (J,) [K2/s2]."""
        t = np.asarray(knots_s, dtype=float)
        q = replace(self, bursts=()).at(t[:-1]) * np.diff(t)
        for b in self.bursts:
            age, p = np.maximum(t - b.start_s, 0.0) / b.decay_s, b.power
            q = q + np.diff(b.height * b.decay_s * p / (p - 1) * (1.0 - (1.0 + age / p) ** (1 - p)))
        return q

    def moved(self, was_s: float = np.nan, to_s: float = np.nan, shift_s: float = 0.0) -> Intensity:
        """With what begins at ``was_s`` begun at ``to_s`` instead, on a clock that starts ``shift_s`` later."""
        bursts = tuple(replace(b, start_s=(to_s if b.start_s == was_s else b.start_s) - shift_s) for b in self.bursts)
        return Intensity(tuple((to_s if s == was_s else s) - shift_s for s in self.starts_s), self.levels, bursts)


def corner_rad_s(chain: Chain, ratio: Array) -> Array:
    """Where the signal sinks into the noise: |G(w)|^2 q / w^4 = R, for ``ratio`` = q / R [1/s4]; same shape."""
    w = np.geomspace(1e-4, 1e4, 400)
    needed = np.maximum.accumulate(4 * np.log(w) - 2 * np.log(np.abs(chain.frequency_response(w / 2 / np.pi)) + 1e-30))
    return np.asarray(np.exp(np.interp(np.log(ratio), needed, np.log(w))))


@dataclass(frozen=True)
class Cells:
    """A linear Gaussian model on J cells of time for M channels times Q proposed intensities, with n states.

    Cell j lies between ``knots_s[j]`` and the next; ``kind (J,)``: which of K kinds it is, by its length and by where
    samples lie in it. ``mean0 (M, Q, n)``, ``cov0 (M, Q, n, n)``: prior at the first knot. ``transition (K, M, 1, n,
    n)``: how the state crosses a cell. ``information (J, M, 1, n, n)``, ``score (J, M, 1, n)``: sum over the samples
    of cell j of w o o' and w o y, o the row that reads the sample from the state at the knot. ``slope_var (J, M, Q)``:
    variance added to the slope at knot j [K2/s2]. ``rows``: for each channel and kind that reads samples, its cells
    (c,), those rows (count, n), and which samples they are (c, count), N where the record has none.
    """

    knots_s: Array
    kind: NDArray[np.intp]
    mean0: Array
    cov0: Array
    transition: Array
    information: Array
    score: Array
    slope_var: Array
    rows: tuple[tuple[tuple[NDArray[np.intp], Array, NDArray[np.intp]], ...], ...]


def cells_for(
    stretch: Stretch, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> Cells:
    """Cells fine enough for every intensity proposed for every channel (outer sequence; as many for each).

    The first knot lies before the first sample by the longest dead time, a multiple of dt.
    """
    dt, total = stretch.dt_s, len(stretch.y)
    end = (total - 1) * dt
    start = -float(np.ceil(max(s.delay_s for s in stretch.sensors) / dt - 1e-9)) * dt
    times = [np.linspace(start, end, max(int((end - start) / 1.0), 8))]
    for e in stretch.events_s:
        after = e + np.geomspace(0.1 * dt, max(end - e, dt), 60)
        times += [np.array([e - 1e-6 * dt, e]), after[after < end]]
    t = np.unique(np.concatenate(times))
    longest = np.full(len(t), np.inf)
    for chain, proposed, var in zip(stretch.chains, proposals, noise_var):
        most = np.max([q.at(t) for q in proposed], axis=0)
        longest = np.minimum(longest, fine / corner_rad_s(chain, most / (var * dt)))
    inside = [e for e in stretch.events_s if start < e < end]
    knots = _knots(start, end, dt, inside, lambda at: float(np.interp(at, t, longest)))
    keys = np.round(np.column_stack([np.diff(knots) / dt, (knots[:-1] / dt) % 1.0]), 6)
    keys[:, 1] %= 1.0
    _, example, kind = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    kind = kind.reshape(-1)
    event: Flags = np.isin(knots[:-1], inside)
    channels: list[tuple[Array, ...]] = []
    rows = []
    for c, s in enumerate(stretch.sensors):
        n, w, y = len(s.output), np.append(stretch.weight[:, c] / noise_var[c], 0.0), np.append(stretch.y[:, c], 0.0)
        info_c, score_c, rows_c = np.zeros((len(kind), n, n)), np.zeros((len(kind), n)), []
        first = np.ceil((knots + s.delay_s) / dt - 1e-6).astype(int)
        for k, j in enumerate(example):
            if first[j + 1] <= first[j]:
                continue
            ahead = first[j] * dt - s.delay_s - knots[j]
            o = [s.output @ flow(s.drift, ahead)]
            for _ in range(first[j] + 1, first[j + 1]):
                o.append(o[-1] @ flow(s.drift, dt))
            read, where = np.array(o), np.flatnonzero(kind == k)
            sample = first[where][:, None] + np.arange(len(read))
            sample = np.where((sample >= 0) & (sample < total), sample, total)
            info_c[where] = (w[sample] @ (read[:, :, None] * read[:, None, :]).reshape(len(read), -1)).reshape(-1, n, n)
            score_c[where] = (w[sample] * y[sample]) @ read
            rows_c.append((where, read, sample))
        seen = stretch.y[stretch.weight[:, c] > 0, c]
        level, span = (float(seen[0]), float(np.ptp(seen))) if len(seen) else (0.0, 1.0)
        added = np.stack([q.between(knots) for q in proposals[c]], axis=1)
        least = 10 * float(np.sqrt(noise_var[c]))
        mean, cov, jump_var = prior(s, level, max(span, least), dt, np.array([float(q.at(0.0)) for q in proposals[c]]))
        at_knot = 0.5 * (added + np.concatenate([np.zeros_like(added[:1]), added[:-1]]))
        at_knot[event] += jump_var
        channels.append((np.tile(mean, (len(cov), 1)), cov, info_c[:, None], score_c[:, None], at_knot))
        rows.append(tuple(rows_c))
    lengths = np.diff(knots)[example]
    across = np.stack([np.stack([flow(s.drift, float(h)) for s in stretch.sensors]) for h in lengths])[:, :, None]
    mean0, cov0, information, score, slope_var = zip(*channels)
    return Cells(
        knots, kind, np.stack(mean0), np.stack(cov0), across, np.stack(information, axis=1), np.stack(score, axis=1),
        np.stack(slope_var, axis=1), tuple(rows),
    )  # fmt: skip


def _knots(
    start_s: float, end_s: float, dt_s: float, events_s: Sequence[float], cell_s: Callable[[float], float]
) -> Array:
    """Knots from ``start_s`` (a multiple of dt) past ``end_s``: every event a knot, other knots on the sample times.

    ``cell_s(t)`` is the longest cell wanted at time t [s]; cells grow by at most a half from one to the next.
    """
    knots = [start_s]
    size = len(STEPS) - 1
    for number, stop in enumerate([*events_s, end_s + 0.5 * dt_s], start=1):
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
        if number <= len(events_s):
            while knots[-1] > stop - 1e-6 * dt_s:
                knots.pop()
            knots.append(stop)
    return np.array(knots)


def prior(s: Sensor, level: float, span: float, dt_s: float, intensity: Array) -> tuple[Array, Array, float]:
    """Mean (n,) and covariances (Q, n, n) of the state of a chain that has followed a ramp for ever.

    Its level [degC] is about ``level``, its slope about zero, as loosely as a record asks that covers ``span`` [K]; the
    stages scatter about the ramp as slope noise of ``intensity`` (Q,) [K2/s3] lets them. Last, the slope's variance.
    """
    wide = DIFFUSE * span * np.array([1.0, 1.0 / (s.lag_s + 4 * dt_s)])
    cov = s.ramp * wide**2 @ s.ramp.T + intensity[:, None, None] * s.scatter
    return level * s.ramp[:, 0], cov, float(wide[1] ** 2)


def flow(drift: Array, time_s: float) -> Array:
    """expm(drift time_s), remembered: channels and windows share their chains and their cells."""
    return _flow(drift.tobytes(), len(drift), round(time_s, 12))


@lru_cache(maxsize=20_000)
def _flow(drift: bytes, n: int, time_s: float) -> Array:
    result = np.asarray(expm(np.frombuffer(drift).reshape(n, n) * time_s))
    result.setflags(write=False)
    return result
