"""Thermostat check: whether an on/off input is switched by the level of the output.

``tcdyn.identification.closed_loop.closed_loop`` calls it. ``tests/identify/thermostat_study.py``
measures how often thermostats and timers are named; ``tests/identify/test_thermostat.py`` checks
both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, xlogy

from tcdyn.core import Array, Flags

# Rows from the reading that the relay acts on to the row in which the input has its new value. The
# study has delays of 0 to 4 rows.
DELAYS = tuple(range(6))
# Switches of a record below which nothing is decided: the level at one switch of a direction says
# nothing, so that each direction needs two.
MIN_SWITCHES = 4
MIN_PHASES = 2
# Phases of a direction that are used, so that long records cost no more.
MAX_PHASES = 100
# Distance from a level, over the distance between the two levels, up to which a value of the input
# belongs to the level; and share of such values in an on/off input. A logger that averages has
# values in between (chosen by judgement).
MAX_LEVEL_DISTANCE = 0.1
MIN_LEVEL_SHARE = 0.8
# Log likelihood ratio of the two descriptions of the switches, from which a thermostat is named:
# 100 to 1. ``python -m tests.identify.thermostat_study 200``: false names in less than 1 % of the
# open loops of each kind.
MIN_EVIDENCE = float(np.log(100.0))
# Share of the time of the phases that the output spends beyond the limit. An output that starts its
# phases beyond it does not switch the input. Most thermostats of the study have at most 0.25; a
# few, with noise and phases of few rows, have more than 0.5 and are lost.
MAX_SHARE_BEYOND = 0.5
# Difference in rows up to which two durations of a timer are equal.
TIMER_TOLERANCE = 1
# Kernel widths in rows: equal counts only, then doubled up to the longest phase.
EXACT_WIDTH = 0.1
FIRST_WIDTH = 0.5
# Rounding error of the output over its largest absolute value.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Phase:
    """An interval of constant state of the input that ends with a switch.

    Parameters
    ----------
    y
        Output of the segment (N,), NaN where it was not measured.
    start, stop
        First row of the phase, and row of the switch that ends it.
    on
        Whether the input is at its upper level.
    is_first
        Whether it is the first of its segment, whose start may not be a switch.
    """

    y: Array
    start: int
    stop: int
    on: bool
    is_first: bool

    @property
    def n_rows(self) -> int:
        """Duration in rows."""
        return self.stop - self.start

    def readings(self, delay: int) -> Array:
        """Readings at which a relay with this delay could end the phase; it did at the last."""
        first = max(self.start + 1 - delay, 0)
        return self.y[first : max(self.stop + 1 - delay, first + 1)]

    @property
    def is_measured(self) -> bool:
        """Whether all readings are measured on which a relay could have acted at the end."""
        first = max(self.stop - max(DELAYS), 0)
        return bool(np.isfinite(self.y[first : self.stop + 1]).all())


@dataclass(frozen=True)
class Direction:
    """The phases of one state, and how well a limit of the output describes their ends.

    Parameters
    ----------
    evidence
        Log likelihood ratio of a limit of the output to an open loop.
    limit
        Reading at the switches, their median.
    share_beyond
        Share of the time of the phases after the output first reached the limit.
    """

    evidence: float
    limit: float
    share_beyond: float


@dataclass(frozen=True)
class Thermostat:
    """A relay with hysteresis that describes the switches of an input.

    Parameters
    ----------
    evidence
        Log likelihood ratio to an open loop.
    off_at, on_at
        Median readings at which the input is switched off and on.
    delay
        Rows from the reading to the switch.
    """

    evidence: float
    off_at: float
    on_at: float
    delay: int

    @property
    def is_named(self) -> bool:
        """Whether the evidence reaches ``MIN_EVIDENCE``."""
        return self.evidence >= MIN_EVIDENCE


def find_thermostat(segments: Sequence[tuple[Array, Array]]) -> Thermostat | None:
    """Return the relay that describes the switches of an on/off input best.

    Parameters
    ----------
    segments
        Input (N,) and output (N,) of each segment; NaN where the output was not measured.

    Returns
    -------
    Thermostat or None
        None for an input that is not on/off, for fewer than ``MIN_SWITCHES`` switches, and where
        the output is beyond the limits for most of the time.

    Notes
    -----
    A timer determines the time T from the start of a phase to the switch. A thermostat determines
    the time a from the row in which the output first reaches a limit to the switch: a few rows,
    however long the phase lasts. Both times are described by the same kind of distribution, and
    the likelihood of all a is compared with that of all T.

    - The probability of one time is a kernel estimate from the times of the other phases, with the
      width that gives the largest likelihood, and a part 1 / (2 T) for a time unlike all others.
      Where the limit is reached at a fixed time after the start (a fast plant that is at rest at
      each switch) both have the same distribution but for a shift, and the ratio is 1.
    - The times a must also be those of a constant rate of switching beyond the limit (a geometric
      distribution).
    - A sequence of durations that repeats counts once.
    - A first phase that is longer than all others, as the heating from cold, may have any duration
      in an open loop, so its T has the probability 1 / (2 T).

    Phases of equal duration, as of a thermostat under constant load, are those of a timer too.
    Without a long first phase the ratio is then about 1, and nothing can be decided.
    """
    phases = phases_of(segments)
    if len(phases) < MIN_SWITCHES:
        return None
    best: Thermostat | None = None
    for on_is_rising in (True, False):
        for delay in DELAYS:
            found = relay(phases, on_is_rising, delay)
            if found is not None and (best is None or found.evidence > best.evidence):
                best = found
    return best


def relay(phases: Sequence[Phase], on_is_rising: bool, delay: int) -> Thermostat | None:
    """Return the relay with this sign and delay; None where it cannot be one.

    Parameters
    ----------
    phases
        All phases.
    on_is_rising
        Whether the input is switched off at the upper limit (a heater), or at the lower one.
    delay
        Rows from the reading to the switch.

    Returns
    -------
    Thermostat or None
        The relay.
    """
    directions = []
    for on in (True, False):
        sign = 1.0 if on == on_is_rising else -1.0
        direction = limit_evidence([p for p in phases if p.on == on], sign, delay)
        if direction is None or direction.share_beyond > MAX_SHARE_BEYOND:
            return None
        directions.append(direction)
    off, on_again = directions
    return Thermostat(off.evidence + on_again.evidence, off.limit, on_again.limit, delay)


def limit_evidence(phases: Sequence[Phase], sign: float, delay: int) -> Direction | None:
    """Compare a limit of the output with an open loop, for the phases of one state.

    Parameters
    ----------
    phases
        Phases of one state.
    sign
        1 where the output rises to the limit, -1 where it falls.
    delay
        Rows from the reading to the switch.

    Returns
    -------
    Direction or None
        None for fewer than ``MIN_PHASES`` phases besides the first ones.
    """
    inner = [p for p in phases if not p.is_first][:MAX_PHASES]
    if len(inner) < MIN_PHASES:
        return None
    readings = [sign * p.readings(delay) for p in inner]
    levels = np.array([r[-1] for r in readings])
    limit = float(levels.min()) - ROUNDING * float(np.abs(levels).max())
    beyond = np.array([rows_beyond(r, limit) for r in readings])
    duration = np.array([p.n_rows for p in inner])
    n = len(inner)
    open_loop, _ = best_log_probability(duration, duration)
    law, width = best_log_probability(beyond, duration)
    gain = min(law, geometric_log_likelihood(beyond)) - open_loop
    # each time is predicted from the others: n predictions of n - 1 independent ones
    n_independent = min(period_of(duration), n - 1)
    evidence = max(gain, 0.0) * n_independent / n
    for p in phases:
        if p.is_first and p.n_rows > duration.max():
            evidence += first_evidence(p, sign * p.readings(delay), limit, beyond, width)
    share = float(beyond.sum() / duration.sum())
    return Direction(evidence, sign * float(np.median(levels)), share)


def first_evidence(
    phase: Phase, readings: Array, limit: float, beyond: NDArray[np.int_], width: float
) -> float:
    """Log likelihood ratio of the first phase, which is longer than all others.

    Parameters
    ----------
    phase
        The phase.
    readings
        Its readings, with the sign of the limit.
    limit
        The limit of the other phases.
    beyond
        Rows beyond the limit of the other phases (N,).
    width
        Kernel width of their distribution.

    Returns
    -------
    float
        0 where the phase did not end beyond the limit: the relay was not in use then.
    """
    if readings[-1] < limit:
        return 0.0
    distance = np.abs(beyond - rows_beyond(readings, limit))
    base = 1 / (2 * phase.n_rows)
    probability = (kernel(distance, width).sum() + base) / (len(beyond) + 1)
    return max(float(np.log(probability / base)), 0.0)


def rows_beyond(readings: Array, limit: float) -> int:
    """Rows from the first reading that reaches the limit to the last reading, both counted."""
    return len(readings) - int(np.argmax(readings >= limit))


def best_log_probability(
    times: NDArray[np.int_], durations: NDArray[np.int_]
) -> tuple[float, float]:
    """Log probability of times, each predicted from the others by a kernel estimate.

    Parameters
    ----------
    times
        Times in rows (N,).
    durations
        Durations T of the phases (N,); a time unlike all others has the probability 1 / (2 T).

    Returns
    -------
    log_probability
        Sum of the logarithms, the largest of all kernel widths.
    width
        The kernel width.
    """
    distance = np.abs(times[:, None] - times[None, :])
    counts = np.arange(int(distance.max()) + 1)
    widths = [EXACT_WIDTH]
    width = FIRST_WIDTH
    while width < 2 * durations.max():
        widths.append(width)
        width *= 2
    found = []
    for width in widths:
        table = kernel(counts, width)
        of_others = table[distance].sum(axis=1) - table[0]
        probability = (of_others + 1 / (2 * durations)) / len(times)
        found.append((float(np.sum(np.log(probability))), width))
    return max(found)


def kernel(distance: NDArray[np.int_], sd: float) -> Array:
    """Probability of whole distances under a normal distribution of standard deviation ``sd``.

    >>> round(float(kernel(np.arange(-50, 51), 3.0).sum()), 6)
    1.0
    """
    return np.asarray(ndtr((distance + 0.5) / sd) - ndtr((distance - 0.5) / sd))


def geometric_log_likelihood(times: NDArray[np.int_]) -> float:
    """Largest log likelihood of times of 1, 2, ... rows under a geometric distribution.

    >>> geometric_log_likelihood(np.array([1, 1, 1])), geometric_log_likelihood(np.array([2, 2]))
    (0.0, -2.772588722239781)
    """
    n = len(times)
    total = int(times.sum())
    return float(xlogy(n, n / total) + xlogy(total - n, 1 - n / total))


def period_of(durations: NDArray[np.int_]) -> int:
    """Number of durations after which the sequence repeats, as that of a timer; N if it does not.

    >>> period_of(np.array([10, 30, 11, 30, 10, 29])), period_of(np.array([10, 30, 50]))
    (2, 3)
    """
    n = len(durations)
    for period in range(1, n // 2 + 1):
        if np.all(np.abs(durations[period:] - durations[:-period]) <= TIMER_TOLERANCE):
            return period
    return n


def phases_of(segments: Sequence[tuple[Array, Array]]) -> list[Phase]:
    """Return the phases of an on/off input, each up to its switch.

    Parameters
    ----------
    segments
        Input (N,) and output (N,) of each segment.

    Returns
    -------
    list of Phase
        Phases whose last readings are measured; empty for an input that is not on/off.
    """
    if not segments:
        return []
    states = on_off_states(np.concatenate([u for u, _ in segments]))
    if states is None:
        return []
    ends = np.cumsum([len(u) for u, _ in segments])[:-1]
    phases = []
    for on, (_, y) in zip(np.split(states, ends), segments):
        switches = np.flatnonzero(on[1:] != on[:-1]) + 1
        for start, stop in pairwise([0, *switches.tolist()]):
            phase = Phase(y, start, stop, bool(on[start]), is_first=start == 0)
            if phase.is_measured:
                phases.append(phase)
    return phases


def on_off_states(u: Array) -> Flags | None:
    """Return whether an input is on (N,); None where it does not have two levels.

    >>> on_off_states(np.array([0.0, 0.1, 9.9, 10.0, 0.0]))
    array([False, False,  True,  True, False])
    >>> on_off_states(np.array([0.0, 5.0, 10.0])) is None
    True
    """
    span = float(np.ptp(u))
    if span == 0:
        return None
    is_on = u > u.min() + span / 2
    low = float(np.median(u[~is_on]))
    high = float(np.median(u[is_on]))
    distance = np.abs(u - np.where(is_on, high, low))
    share = float(np.mean(distance <= MAX_LEVEL_DISTANCE * (high - low)))
    return is_on if share >= MIN_LEVEL_SHARE else None
