"""Process-noise intensity as a function of time: one level for each segment, and bursts that start
at
events.

The process noise drives the slope of the temperature; its intensity is q(t) [K2/s3].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array


@dataclass(frozen=True)
class Burst:
    """A burst of process noise after an event: q(t) = height (1 + age/power)^-power, age = (t -
    start_s)/decay_s.

    Parameters
    ----------
    start_s
        Start of the burst [s].
    height
        Intensity at the start [K2/s3].
    decay_s
        Decay time [s].
    power
        Exponent of the decay: 3 after a step of the heat flux, large after a relaxation (nearly
        exponential).
    level_sd, slope_sd
        Prior standard deviations of a jump of the temperature [K] and of its slope [K/s] at the
        start.
    """

    start_s: float
    height: float
    decay_s: float
    power: float = 3.0
    level_sd: float = 0.0
    slope_sd: float = 0.0


@dataclass(frozen=True)
class Intensity:
    """Process-noise intensity q(t): the increment of the slope over dt has variance q(t) dt.

    Parameters
    ----------
    starts_s
        Start times of the segments [s].
    levels
        Intensity of each segment [K2/s3], from its start on.
    bursts
        Bursts, added to the levels.

    Examples
    --------
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
        """Integral of q over each interval between ``knots_s`` (J+1,), shape (J,) [K2/s2]."""
        return levels_between([self], np.asarray(knots_s, dtype=float))[0]

    def jumps(self, knots_s: Array) -> Array:
        """Prior variance (J, 2) of a jump of level [K2] and slope [K2/s2] at each knot (J,)."""
        return jumps_at([self], knots_s)[:, 0]

    def shifted(
        self, was_s: float = np.nan, to_s: float = np.nan, shift_s: float = 0.0
    ) -> Intensity:
        """The same intensity with segments and bursts that start at ``was_s`` started at ``to_s``
        instead.

        ``shift_s`` is subtracted from all times: the zero of the new clock.
        """

        def new_time(time_s: float) -> float:
            if time_s == was_s:
                return to_s - shift_s
            return time_s - shift_s

        starts_s = tuple(new_time(start) for start in self.starts_s)
        bursts = tuple(replace(b, start_s=new_time(b.start_s)) for b in self.bursts)
        return Intensity(starts_s, self.levels, bursts)


def _bursts(intensities: Sequence[Intensity]) -> tuple[Array, Array]:
    """All bursts (B,) of several intensities as arrays.

    Returns the membership matrix (Q, B) of ones and zeros, and the fields of the bursts in order,
    (6, B, 1).
    """
    rows = [(k, *vars(b).values()) for k, q in enumerate(intensities) for b in q.bursts]
    table = np.array(rows, dtype=float).reshape(-1, 7)
    member = np.arange(len(intensities))[:, None] == table[:, 0]
    return member.astype(float), table[:, 1:].T[:, :, None]


def _steady(intensities: Sequence[Intensity], t_s: Array) -> Array:
    """Levels (Q, T) [K2/s3] of the segments at ``t_s`` (T,), without the bursts."""
    distinct = {(q.starts_s, q.levels) for q in intensities}
    levels = {}
    for starts_s, values in distinct:
        segment = np.maximum(np.searchsorted(starts_s, t_s, "right") - 1, 0)
        levels[starts_s, values] = np.array(values, dtype=float)[segment]
    return np.stack([levels[q.starts_s, q.levels] for q in intensities])


def levels_at(intensities: Sequence[Intensity], t_s: Array) -> Array:
    """q(t) (Q, T) [K2/s3] of each of ``intensities`` at ``t_s`` (T,)."""
    member, (start, height, decay, power, *_) = _bursts(intensities)
    age = np.maximum(t_s - start, 0.0) / decay
    decaying = height * (1.0 + age / power) ** -power
    return _steady(intensities, t_s) + member @ np.where(t_s >= start, decaying, 0.0)


def levels_between(intensities: Sequence[Intensity], knots_s: Array) -> Array:
    """Integrals (Q, J) [K2/s2] of each of ``intensities`` over the intervals between ``knots_s``
    (J+1,).
    """
    member, (start, height, decay, power, *_) = _bursts(intensities)
    age = np.maximum(knots_s - start, 0.0) / decay
    integral = height * decay * power / (power - 1) * (1.0 - (1.0 + age / power) ** (1 - power))
    burst_integral = np.diff(integral, axis=1)
    return _steady(intensities, knots_s[:-1]) * np.diff(knots_s) + member @ burst_integral


def jumps_at(intensities: Sequence[Intensity], knots_s: Array) -> Array:
    """Prior variance (J, Q, 2) of jumps of level [K2] and slope [K2/s2] at each knot (J,), for each
    intensity.
    """
    member, (start, *_, level_sd, slope_sd) = _bursts(intensities)
    at = knots_s == start
    return np.stack([(member @ (at * sd**2)).T for sd in (level_sd, slope_sd)], axis=-1)
