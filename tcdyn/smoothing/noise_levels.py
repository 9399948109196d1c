"""Process-noise intensity q(t): a level for each segment, and bursts that start at events.

The process noise drives the slope of the temperature; its intensity is q(t) [K2/s3]. A rough
temperature also has noise that drives the temperature itself, of intensity p(t) [K2/s]. These are
the values that :mod:`tcdyn.smoothing.process_noise` and :mod:`tcdyn.smoothing.possible_events`
estimate, that a caller of ``tcdyn.smoothing.smoother.smooth`` may give, and that
:mod:`tcdyn.smoothing.state_space` averages over the steps of the smoother. Guarded by
``tests/smoothing/test_any_unit.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array

# Share of the level below which a burst of an earlier event no longer counts: the band changes
# with a root of the intensity, at most by half of this.
BURST_IS_OVER = 0.1


@dataclass(frozen=True)
class Burst:
    """A burst of process noise after an event, which decays with the time since its start.

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
    width_s
        Time [s] around the start over which that jump of the temperature is spread, in any way.
    reading_sd
        Prior standard deviation [K] of a step of the reading itself at the start, such as that of
        another range or sensor: it is passed on, not inverted.
    area_sd
        Prior standard deviation [K s] of an impulse of the temperature at the start: that of a jump
        of an uncertain time is the size of the jump times the uncertainty of its time.

    Notes
    -----
    q(t) = height (1 + age/power)^-power with age = (t - start_s)/decay_s. ``power`` must not be 1,
    where the integral of ``mean_levels`` is not defined. The order of the fields is that in
    which ``levels_at``, ``mean_levels`` and ``jumps_at`` unpack them: change them together.
    """

    start_s: float
    height: float
    decay_s: float
    power: float = 3.0
    level_sd: float = 0.0
    slope_sd: float = 0.0
    width_s: float = 0.0
    reading_sd: float = 0.0
    area_sd: float = 0.0


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
    level_noise
        Intensity p [K2/s] of the noise that drives the temperature itself, of each segment; empty
        where there is none.

    Examples
    --------
    >>> q = Intensity((0.0, 10.0), (1.0, 4.0), (Burst(10.0, 8.0, 2.0),))
    >>> q.at([5.0, 10.0, 16.0]).tolist()
    [1.0, 12.0, 5.0]
    >>> float(mean_levels([q], np.array([0.0, 10.0, 16.0]))[0, 1])
    7.0
    """

    starts_s: tuple[float, ...]
    levels: tuple[float, ...]
    bursts: tuple[Burst, ...] = ()
    level_noise: tuple[float, ...] = ()

    @classmethod
    def constant(cls, level: float) -> Intensity:
        """The same ``level`` [K2/s3] at all times."""
        return cls((0.0,), (float(level),))

    @property
    def is_rough(self) -> bool:
        """Whether any noise drives the temperature itself."""
        return bool(self.level_noise)

    def at(self, t_s: ArrayLike) -> Array:
        """q(t) [K2/s3], same shape as ``t_s``."""
        t = np.asarray(t_s, dtype=float)
        return levels_at([self], t.ravel())[0].reshape(t.shape)

    def continued(self, at_s: float) -> Intensity:
        """The intensity on a clock that starts at ``at_s`` [s], without what is over by then.

        Segments before the last one that has begun are left out, and bursts that start later.
        Bursts that have begun are left out where they add less than ``BURST_IS_OVER`` of the level.
        """
        begun = [k for k, start in enumerate(self.starts_s) if start <= at_s]
        first = begun[-1] if begun else 0
        moved = self.shifted(shift_s=at_s)
        level = self.levels[first]
        bursts = [
            b
            for b in moved.bursts
            if b.start_s <= 0 and replace(moved, bursts=(b,)).at(0.0) > (1 + BURST_IS_OVER) * level
        ]
        return replace(
            moved,
            starts_s=(0.0, *moved.starts_s[first + 1 :]),
            levels=self.levels[first:],
            level_noise=self.level_noise[first:],
            bursts=tuple(Burst(b.start_s, b.height, b.decay_s, b.power) for b in bursts),
        )

    def within(self, start_s: float, end_s: float) -> Intensity:
        """The intensity on a clock that starts at ``start_s``, without bursts outside a window.

        Parameters
        ----------
        start_s, end_s
            Start and end of the window [s]. A burst before it stays where it has a height.
        """
        inside = [
            burst
            for burst in self.bursts
            if burst.start_s - burst.width_s < end_s
            and (burst.height or burst.start_s + burst.width_s > start_s)
        ]
        return replace(self, bursts=tuple(inside)).shifted(shift_s=start_s)

    def shifted(
        self, was_s: float = np.nan, to_s: float = np.nan, shift_s: float = 0.0
    ) -> Intensity:
        """The same intensity on another clock, or with what starts at one time moved to another.

        Parameters
        ----------
        was_s, to_s
            Segments and bursts that start exactly at ``was_s`` start at ``to_s`` instead [s].
        shift_s
            Zero of the new clock [s]; it is subtracted from all times.
        """

        def new_time(time_s: float) -> float:
            """Time ``time_s`` on the new clock."""
            if time_s == was_s:
                return to_s - shift_s
            return time_s - shift_s

        starts_s = tuple(new_time(start) for start in self.starts_s)
        bursts = tuple(replace(b, start_s=new_time(b.start_s)) for b in self.bursts)
        return replace(self, starts_s=starts_s, bursts=bursts)


def _burst_arrays(intensities: Sequence[Intensity]) -> tuple[Array, Array]:
    """All bursts (B,) with a height, of several intensities, as arrays.

    Returns
    -------
    member
        Membership matrix (Q, B) of ones and zeros.
    fields
        The fields of the bursts in their order, (9, B, 1).
    """
    rows = [(k, *vars(b).values()) for k, q in enumerate(intensities) for b in q.bursts if b.height]
    table = np.array(rows, dtype=float).reshape(-1, 10)
    member = np.arange(len(intensities))[:, None] == table[:, 0]
    return member.astype(float), table[:, 1:].T[:, :, None]


def _segment_levels_at(intensities: Sequence[Intensity], t_s: Array) -> Array:
    """Levels (Q, T) [K2/s3] of the segments at ``t_s`` (T,), without the bursts."""
    distinct = {(q.starts_s, q.levels) for q in intensities}
    levels = {}
    for starts_s, values in distinct:
        segment = np.maximum(np.searchsorted(starts_s, t_s, "right") - 1, 0)
        levels[starts_s, values] = np.array(values, dtype=float)[segment]
    return np.stack([levels[q.starts_s, q.levels] for q in intensities])


def level_noise_at(intensities: Sequence[Intensity], t_s: Array) -> Array:
    """p(t) (Q, T) [K2/s] of each of ``intensities`` at ``t_s`` (T,)."""
    out = np.zeros((len(intensities), len(t_s)))
    for row, q in zip(out, intensities):
        if q.level_noise:
            segment = np.maximum(np.searchsorted(q.starts_s, t_s, "right") - 1, 0)
            row[:] = np.array(q.level_noise, dtype=float)[segment]
    return out


def levels_at(intensities: Sequence[Intensity], t_s: Array) -> Array:
    """Intensities q(t) [K2/s3] at times.

    Parameters
    ----------
    intensities
        Q intensities.
    t_s
        Times (T,) [s].

    Returns
    -------
    Array
        q (Q, T). Before the first segment its level applies.

    Notes
    -----
    ``mean_levels`` is the mean of the same function: change both together
    (``tests/smoothing/test_any_unit.py`` integrates one numerically).
    """
    of_segments = _segment_levels_at(intensities, t_s)
    if not any(burst.height for q in intensities for burst in q.bursts):
        return of_segments
    member, (start, height, decay, power, *_) = _burst_arrays(intensities)
    age = np.maximum(t_s - start, 0.0) / decay
    decaying = height * (1.0 + age / power) ** -power
    return of_segments + member @ np.where(t_s >= start, decaying, 0.0)


def mean_levels(intensities: Sequence[Intensity], times_s: Array) -> Array:
    """Means of intensities over steps.

    Parameters
    ----------
    intensities
        Q intensities.
    times_s
        Ends (J + 1,) of the steps [s].

    Returns
    -------
    Array
        Means (Q, J) [K2/s3].

    Notes
    -----
    Exact for the bursts. The level of a segment at the start of a step is taken for all of it. This
    is exact where segments start at points, as those at listed events and bursts do; see
    ``tcdyn.smoothing.state_space.points_of``. Without bursts, steps in one segment have the very
    same number, so that the smoother finds them equal.
    """
    of_segments = _segment_levels_at(intensities, times_s[:-1])
    if not any(burst.height for q in intensities for burst in q.bursts):
        return of_segments
    member, (start, height, decay, power, *_) = _burst_arrays(intensities)
    age = np.maximum(times_s - start, 0.0) / decay
    integral = height * decay * power / (power - 1) * (1.0 - (1.0 + age / power) ** (1 - power))
    of_bursts = member @ (np.diff(integral, axis=1) / np.diff(times_s))
    return of_segments + of_bursts


def jumps_at(intensities: Sequence[Intensity], knots_s: Array) -> Array:
    """Prior variances of jumps at knots.

    Parameters
    ----------
    intensities
        Q intensities.
    knots_s
        Knots (J,) [s]; a burst without width jumps where its start equals a knot exactly.

    Returns
    -------
    Array
        Variances (J, Q, 4) of level [K2], slope [K2/s2], reading [K2] and area [K2 s2].
    """
    out = np.zeros((len(knots_s), len(intensities), 4))
    for k, q in enumerate(intensities):
        for burst in q.bursts:
            if burst.width_s > 0:
                ends = [knots_s[:1], 0.5 * (knots_s[1:] + knots_s[:-1]), knots_s[-1:]]
                since_s = np.concatenate(ends) - burst.start_s
                passed = np.clip(since_s / burst.width_s + 0.5, 0.0, 1.0)
                out[:, k, 0] += np.diff(passed) * burst.level_sd**2
            at = int(np.searchsorted(knots_s, burst.start_s))
            if at == len(knots_s) or knots_s[at] != burst.start_s:
                continue
            out[at, k, 1] += burst.slope_sd**2
            out[at, k, 2] += burst.reading_sd**2
            out[at, k, 3] += burst.area_sd**2
            if burst.width_s == 0:
                out[at, k, 0] += burst.level_sd**2
    return out


def jumps_per_second(intensities: Sequence[Intensity], duration_s: float) -> Array:
    """Prior variance of all jumps, as if they could be at any time.

    Parameters
    ----------
    intensities
        Q intensities.
    duration_s
        Duration of the record [s].

    Returns
    -------
    Array
        Variances (Q, 2) of level [K2/s] and slope [K2/s3] per second.
    """
    variances = [
        [sum(b.level_sd**2 for b in q.bursts), sum(b.slope_sd**2 for b in q.bursts)]
        for q in intensities
    ]
    return np.array(variances, dtype=float) / duration_s
