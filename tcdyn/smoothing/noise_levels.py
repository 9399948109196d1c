"""Process-noise intensity q(t), a level for each segment, and changes at known times.

The process noise drives the slope of the temperature; its intensity is q(t) [K2/s3]. A rough
temperature also has noise that drives the temperature itself, of intensity p(t) [K2/s]. These are
the values that :mod:`tcdyn.smoothing.process_noise` and :mod:`tcdyn.smoothing.events` estimate,
that a caller of ``tcdyn.smoothing.smoother.smooth`` may give, and that
:mod:`tcdyn.smoothing.state_space` averages over the steps of the smoother. Guarded by
``tests/smoothing/test_any_unit.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array


@dataclass(frozen=True)
class Change:
    """A change of the temperature, of its slope or of the reading at a time.

    Parameters
    ----------
    start_s
        Its time [s].
    level_sd, slope_sd
        Prior standard deviations of a jump of the temperature [K] and of its slope [K/s].
    width_s
        Time [s] around ``start_s`` over which that jump of the temperature is spread, in any way.
    reading_sd
        Prior standard deviation [K] of a step of the reading itself, such as that of another range
        or sensor: it is passed on, not inverted.
    area_sd
        Prior standard deviation [K s] of an impulse of the temperature: that of a jump of an
        uncertain time is the size of the jump times the uncertainty of its time.

    Notes
    -----
    With all of them zero it is a point in time at which the temperature may change.
    """

    start_s: float
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
    changes
        Changes at some times.
    level_noise
        Intensity p [K2/s] of the noise that drives the temperature itself, of each segment; empty
        where there is none.

    Examples
    --------
    >>> q = Intensity((0.0, 10.0), (1.0, 4.0), (Change(10.0, slope_sd=3.0),))
    >>> q.at([5.0, 10.0, 16.0]).tolist()
    [1.0, 4.0, 4.0]
    >>> q.shifted(shift_s=2.0).changes[0].start_s
    8.0
    """

    starts_s: tuple[float, ...]
    levels: tuple[float, ...]
    changes: tuple[Change, ...] = ()
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

        Segments before the last one that has begun are left out, and all changes.
        """
        begun = [k for k, start in enumerate(self.starts_s) if start <= at_s]
        first = begun[-1] if begun else 0
        moved = self.shifted(shift_s=at_s)
        return replace(
            moved,
            starts_s=(0.0, *moved.starts_s[first + 1 :]),
            levels=self.levels[first:],
            level_noise=self.level_noise[first:],
            changes=(),
        )

    def within(self, start_s: float, end_s: float) -> Intensity:
        """The intensity on a clock that starts at ``start_s``, without changes outside a window.

        Parameters
        ----------
        start_s, end_s
            Start and end of the window [s].
        """
        inside = [
            change
            for change in self.changes
            if start_s - change.width_s < change.start_s < end_s + change.width_s
        ]
        return replace(self, changes=tuple(inside)).shifted(shift_s=start_s)

    def shifted(
        self, was_s: float = np.nan, to_s: float = np.nan, shift_s: float = 0.0
    ) -> Intensity:
        """The same intensity on another clock, or with what starts at one time moved to another.

        Parameters
        ----------
        was_s, to_s
            Segments and changes that start exactly at ``was_s`` start at ``to_s`` instead [s].
        shift_s
            Zero of the new clock [s]; it is subtracted from all times.
        """

        def new_time(time_s: float) -> float:
            """Time ``time_s`` on the new clock."""
            if time_s == was_s:
                return to_s - shift_s
            return time_s - shift_s

        starts_s = tuple(new_time(start) for start in self.starts_s)
        changes = tuple(replace(b, start_s=new_time(b.start_s)) for b in self.changes)
        return replace(self, starts_s=starts_s, changes=changes)


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
    """
    distinct = {(q.starts_s, q.levels) for q in intensities}
    levels = {}
    for starts_s, values in distinct:
        segment = np.maximum(np.searchsorted(starts_s, t_s, "right") - 1, 0)
        levels[starts_s, values] = np.array(values, dtype=float)[segment]
    return np.stack([levels[q.starts_s, q.levels] for q in intensities])


def jumps_at(intensities: Sequence[Intensity], knots_s: Array) -> Array:
    """Prior variances of jumps at knots.

    Parameters
    ----------
    intensities
        Q intensities.
    knots_s
        Knots (J,) [s]; a change without width jumps where its start equals a knot exactly.

    Returns
    -------
    Array
        Variances (J, Q, 4) of level [K2], slope [K2/s2], reading [K2] and area [K2 s2].
    """
    out = np.zeros((len(knots_s), len(intensities), 4))
    for k, q in enumerate(intensities):
        for change in q.changes:
            if change.width_s > 0:
                ends = [knots_s[:1], 0.5 * (knots_s[1:] + knots_s[:-1]), knots_s[-1:]]
                since_s = np.concatenate(ends) - change.start_s
                passed = np.clip(since_s / change.width_s + 0.5, 0.0, 1.0)
                out[:, k, 0] += np.diff(passed) * change.level_sd**2
            at = int(np.searchsorted(knots_s, change.start_s))
            if at == len(knots_s) or knots_s[at] != change.start_s:
                continue
            out[at, k, 1] += change.slope_sd**2
            out[at, k, 2] += change.reading_sd**2
            out[at, k, 3] += change.area_sd**2
            if change.width_s == 0:
                out[at, k, 0] += change.level_sd**2
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
        [sum(b.level_sd**2 for b in q.changes), sum(b.slope_sd**2 for b in q.changes)]
        for q in intensities
    ]
    return np.array(variances, dtype=float) / duration_s
