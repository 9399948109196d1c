"""Events: sudden changes of slope that nobody announced are found, timed, and given an uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tcdyn.compensate.grid import Grid
from tcdyn.compensate.intensity import around
from tcdyn.compensate.model import Stretch, likelihood
from tcdyn.compensate.profile import Intensity

Array = NDArray[np.float64]
SURE = 5.5  # standard deviations: one false event in a thousand logs of 150 000 samples
SHARP = 0.1  # an event whose time stays looser than this many lags is a bend: no knot is needed for it
MOST = 6  # events sought in one record


def candidate(grid: Grid, jump_z: Array, events_s: Sequence[float], guard_s: float) -> float | None:
    """The knot [s] with the most significant jump of slope in any channel, if it is sure and not a known event."""
    z = np.max(np.abs(jump_z), axis=1)
    t = grid.knots_s[:-1]
    for event in events_s:
        z = np.where((t > event - guard_s) & (t < event + 3 * guard_s), 0.0, z)
    z[:3] = z[-3:] = 0.0
    best = int(np.argmax(z))
    return float(t[best]) if z[best] > SURE else None


def timed(
    stretch: Stretch, event_s: float, reach_s: float, noise_var: Array, chosen: Sequence[Intensity]
) -> tuple[float, float]:
    """The likeliest time of an event near ``event_s`` [s] (within ``reach_s``) and its standard uncertainty [s].

    The curvature of the log likelihood, all channels together, with the burst that ``chosen`` has there.
    """
    window, shift = around(stretch, event_s)
    centre, reach = event_s, reach_s
    u = reach_s
    for _ in range(4):
        offsets = np.linspace(-reach, reach, 7)
        values = np.array([_value(window, shift, centre + d, event_s, noise_var, chosen) for d in offsets])
        best = int(np.argmax(values))
        if 0 < best < 6:
            a, b, _ = np.polyfit(offsets[best - 1 : best + 2], values[best - 1 : best + 2], 2)
            if a < 0:
                u = float(np.sqrt(-0.5 / a))
                centre += float(-0.5 * b / a)
                reach = min(3.0 * u, 0.5 * reach)
                continue
        centre += float(offsets[best])
        reach *= 0.6
    return centre, u


def _value(
    window: Stretch, shift: float, at: float, was: float, noise_var: Array, chosen: Sequence[Intensity]
) -> float:
    moved = replace(window, events_s=(at - shift,))
    proposed = [[moved_event(q, was, at, shift)] for q in chosen]
    return float(likelihood(moved, noise_var, proposed)[0].sum())


def moved_event(q: Intensity, was_s: float, to_s: float, shift_s: float = 0.0) -> Intensity:
    """The intensity with the event at ``was_s`` moved to ``to_s``, on a clock that starts ``shift_s`` later."""
    starts = tuple((to_s if s == was_s else s) - shift_s for s in q.starts_s)
    bursts = tuple(replace(b, start_s=(to_s if b.start_s == was_s else b.start_s) - shift_s) for b in q.bursts)
    return Intensity(starts, q.levels, bursts)
