"""How restless the temperature is: intensity of its slope noise, a level per segment and bursts at events."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


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

    def at(self, t_s: ArrayLike) -> Array:
        """q(t) [K2/s3], same shape as ``t_s``."""
        t = np.asarray(t_s, dtype=float)
        segment = np.clip(np.searchsorted(self.starts_s, t, side="right") - 1, 0, None)
        total = np.asarray(self.levels)[segment]
        for burst in self.bursts:
            total = total + burst.at(t)
        return np.asarray(total)

    def between(self, knots_s: ArrayLike) -> Array:
        """Integral of q over each cell of ``knots_s`` (J+1,), shape (J,) [K2/s2]."""
        t = np.asarray(knots_s, dtype=float)
        segment = np.clip(np.searchsorted(self.starts_s, t[:-1], side="right") - 1, 0, None)
        total = np.asarray(self.levels)[segment] * np.diff(t)
        for burst in self.bursts:
            total = total + np.diff(burst.before(t))
        return np.asarray(total)


def shifted(q: Intensity, by_s: float) -> Intensity:
    """The same intensity on a clock that starts ``by_s`` later."""
    bursts = tuple(replace(b, start_s=b.start_s - by_s) for b in q.bursts)
    return Intensity(tuple(s - by_s for s in q.starts_s), q.levels, bursts)
