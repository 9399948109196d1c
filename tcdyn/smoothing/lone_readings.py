"""Few readings at an end of a record, alone behind a gap, that contradict all the others.

Something changed in the gap. When, and how far the temperature went, one reading behind a lag
cannot tell: a small change early in the gap and a large one just before the reading give the same
value. A prior that is smooth enough for the rest of the record would then give a smooth and precise
temperature that is wrong, and the likelihood would take the few readings as a sign of roughness.

Used by :mod:`tcdyn.smoothing.smoother`. Guarded by ``tests/smoothing/test_gaps.py``;
``python -m tests.smoothing.sparse_study`` prints coverage and what is left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Flags
from tcdyn.estimation.trace_noise import interpolate_gaps
from tcdyn.smoothing.process_noise import segment_levels, smearing_time_s
from tcdyn.smoothing.record import MIN_GOOD_SAMPLES
from tcdyn.smoothing.roughness import select_channels
from tcdyn.smoothing.state_space import Smoothed, smooth_record

# A gap is as long as a lag: exp(-1) of a change in it is still on its way when the next reading is
# taken, so that one reading does not show its size
GAP_LAGS = 1.0
# Standard deviations of the prediction by all other readings, from which readings contradict them.
# The prediction has an estimated intensity, so that its errors have longer tails than a normal
# distribution; `python -m tests.smoothing.sparse_study` prints how many readings are left out
CONTRADICTION_SD = 5.0


def contradicting_readings(fit: Smoothed) -> Flags:
    """Readings (N, M) at either end, alone behind a gap, that the other readings exclude.

    Parameters
    ----------
    fit
        The smoothed record, with its events and intensities.

    Returns
    -------
    Flags
        The readings of one group at each end of a channel at most: without them, another may stand
        alone.

    Notes
    -----
    The readings are predicted from all others, with the intensities that these give and the events
    outside the gap. Behind a gap at the start, the intensity is that of the readings after the
    sensor has settled from what may have happened in the gap. A gap with a listed event may contain
    a change: it is left as it is.
    """
    record = fit.record
    out = np.zeros(record.y.shape, dtype=bool)
    gap_rows = GAP_LAGS * smearing_time_s(record) / record.dt_s
    for c in range(record.y.shape[1]):
        rows = np.flatnonzero(record.weight[:, c] > 0)
        for lone, neighbour in _lone_groups(rows, gap_rows):
            if _largest_error_sd(fit, c, lone, neighbour) > CONTRADICTION_SD:
                out[lone, c] = True
    return out


def _lone_groups(rows: NDArray[np.intp], gap_rows: float) -> list[tuple[NDArray[np.intp], int]]:
    """The rows of the readings alone at either end, and the nearest row of all others.

    Parameters
    ----------
    rows
        Rows of all readings.
    gap_rows
        Length of a gap beyond which readings stand alone. Fewer than ``MIN_GOOD_SAMPLES`` do.
    """
    gaps = np.flatnonzero(np.diff(rows) > gap_rows)
    fewest = MIN_GOOD_SAMPLES
    groups: list[tuple[NDArray[np.intp], int]] = []
    if len(gaps) and gaps[0] + 1 < fewest and len(rows) - gaps[0] - 1 >= fewest:
        groups.append((rows[: gaps[0] + 1], int(rows[gaps[0] + 1])))
    if len(gaps) and len(rows) - gaps[-1] - 1 < fewest and gaps[-1] + 1 >= fewest:
        groups.append((rows[gaps[-1] + 1 :], int(rows[gaps[-1]])))
    return groups


def _largest_error_sd(fit: Smoothed, channel: int, lone: NDArray[np.intp], neighbour: int) -> float:
    """Largest error of the prediction of lone readings, in its standard deviations.

    Parameters
    ----------
    fit
        The smoothed record.
    channel
        Index of the channel.
    lone
        Rows of the readings.
    neighbour
        The row of all others that is nearest to them. With a listed event between, the result is 0.
    """
    is_channel = np.arange(fit.record.y.shape[1]) == channel
    record = select_channels(fit.record, is_channel)
    is_first = bool(lone[0] < neighbour)
    low_s = min(int(lone[0]), neighbour) * record.dt_s
    high_s = max(int(lone[-1]), neighbour) * record.dt_s
    if any(low_s <= event <= high_s for event in record.events_s):
        return 0.0
    weight = record.weight.copy()
    weight[lone] = 0.0
    filled = interpolate_gaps(record.y[:, 0], weight[:, 0] > 0)[:, None]
    changes = [b for b in fit.intensities[channel].changes if not low_s <= b.start_s <= high_s]
    events_s = {*record.events_s, *(change.start_s for change in changes)}
    if is_first:
        events_s.add(high_s)
    divided = replace(record, y=filled, weight=weight, events_s=tuple(sorted(events_s)))
    noise_var = fit.noise_var[is_channel]
    (intensity,), _ = segment_levels(divided, noise_var, True)
    levels = intensity.levels
    if is_first:  # the gap has no reading, and gets the intensity of what follows
        levels = (levels[1], *levels[1:])
    intensity = replace(intensity, levels=levels, changes=tuple(changes))
    rest = replace(divided, events_s=record.events_s)
    predicted = smooth_record(rest, noise_var, [intensity])
    sd = np.sqrt(predicted.predicted_var[lone, 0] + noise_var[0])
    return float(np.max(np.abs(record.y[lone, 0] - predicted.predicted[lone, 0]) / sd))
