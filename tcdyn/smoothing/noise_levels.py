"""Intensity of the slope noise in time: a level for each segment, and bursts that begin at events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array


@dataclass(frozen=True)
class Burst:
    """q(t) = height (1 + age/power)^-power, age = (t - start)/decay, after ``start_s`` [K2/s3].

    Height [K2/s3], ``decay_s`` [s]; below a step of flux the power is 3, of a relaxation large. ``level_sd`` [K] and
    ``slope_sd`` [K/s]: prior standard deviations of jumps at its start.
    """

    start_s: float
    height: float
    decay_s: float
    power: float = 3.0
    level_sd: float = 0.0
    slope_sd: float = 0.0


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
        return levels_at([self], t.ravel())[0].reshape(t.shape)

    def between(self, knots_s: ArrayLike) -> Array:
        """Integral of q over each cell of ``knots_s`` (J+1,), shape (J,) [K2/s2]."""
        return levels_between([self], np.asarray(knots_s, dtype=float))[0]

    def jumps(self, knots_s: Array) -> Array:
        """Variance (J, 2) added to level [K2] and slope [K2/s2] at each knot (J,)."""
        return jumps_at([self], knots_s)[:, 0]

    def moved(self, was_s: float = np.nan, to_s: float = np.nan, shift_s: float = 0.0) -> Intensity:
        """With what begins at ``was_s`` begun at ``to_s`` instead, on a clock that starts ``shift_s`` later."""
        bursts = tuple(
            replace(b, start_s=(to_s if b.start_s == was_s else b.start_s) - shift_s)
            for b in self.bursts
        )
        return Intensity(
            tuple((to_s if s == was_s else s) - shift_s for s in self.starts_s), self.levels, bursts
        )


def _bursts(some: Sequence[Intensity]) -> tuple[Array, Array]:
    """Of all bursts (B,) whose they are (Q, B), 1 or 0, and, (6, B, 1), their fields in order."""
    told = [(k, *vars(b).values()) for k, q in enumerate(some) for b in q.bursts]
    table = np.array(told, dtype=float).reshape(-1, 7)
    return (np.arange(len(some))[:, None] == table[:, 0]).astype(float), table[:, 1:].T[:, :, None]


def _steady(some: Sequence[Intensity], t_s: Array) -> Array:
    """Levels (Q, T) [K2/s3] without bursts."""
    alike = {(q.starts_s, q.levels) for q in some}
    rows = {
        (s, v): np.array(v, dtype=float)[np.maximum(np.searchsorted(s, t_s, "right") - 1, 0)]
        for s, v in alike
    }
    return np.stack([rows[q.starts_s, q.levels] for q in some])


def levels_at(some: Sequence[Intensity], t_s: Array) -> Array:
    """q(t) (Q, T) [K2/s3] of each of ``some`` at ``t_s`` (T,)."""
    own, (start, height, decay, power, *_) = _bursts(some)
    age = np.maximum(t_s - start, 0.0) / decay
    return _steady(some, t_s) + own @ np.where(
        t_s >= start, height * (1.0 + age / power) ** -power, 0.0
    )


def levels_between(some: Sequence[Intensity], knots_s: Array) -> Array:
    """Integrals (Q, J) [K2/s2] over the cells of ``knots_s`` (J+1,) of each of ``some``."""
    own, (start, height, decay, p, *_) = _bursts(some)
    age = np.maximum(knots_s - start, 0.0) / decay
    added = np.diff(height * decay * p / (p - 1) * (1.0 - (1.0 + age / p) ** (1 - p)), axis=1)
    return _steady(some, knots_s[:-1]) * np.diff(knots_s) + own @ added


def jumps_at(some: Sequence[Intensity], knots_s: Array) -> Array:
    """Variance (J, Q, 2) added to level [K2] and slope [K2/s2] at each knot (J,) by each of ``some``."""
    own, (start, *_, level_sd, slope_sd) = _bursts(some)
    at = knots_s == start
    return np.stack([(own @ (at * sd**2)).T for sd in (level_sd, slope_sd)], axis=-1)
