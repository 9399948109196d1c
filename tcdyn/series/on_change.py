"""Rows that are written on change: a missing row means that the reading is within a dead band.

Loggers and home-automation systems poll a sensor, and write a row only when the reading has moved
by a dead band since the last row; some also write a row ("heartbeat") after a long time without
one. :func:`find_dead_band` recognises such a column, and :func:`unchanged_values` gives the values
at the polls that were not written, with their uncertainty.

Tests: ``tests/series/test_on_change.py``; study: ``python -m tests.series.on_change_study``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.stats import binom, norm, rankdata

from tcdyn.core import Array, Flags
from tcdyn.series.clock import Clock, fit_clock
from tcdyn.series.descriptions import find_resolution_s

# Largest probability of an ordinary log that looks like a report on change, by each of the two
# tests; one table in a million, as for channels in one column (`tcdyn.series.value_channels`).
CHANCE = 1e-6
# A change of up to so many dead bands is near the dead band. Study: `on_change_study`.
NEAR = 1.5
# Largest probability that waits which have no part in the rate of change agree with it so well. It
# is a second condition, beside ``CHANCE``. Study: `on_change_study`.
WAIT_CHANCE = 1e-3
# Prior probability of a row whose change is below the dead band, after a restart for example.
STRAY_ROWS = 1e-3
MAX_STRAYS = 0.01  # largest share of such rows; by judgement
# Steps of the clock from which a row waited for a change: after one, any change is possible.
WAITED = 1.5
# Least share of the rows that waited whose change is near the dead band, and where some change is
# below it: such a log can be one with a faster rate in events. Study: `on_change_study`.
NEAR_SHARE = 0.25
NEAR_SHARE_WITH_STRAYS = 0.5
# Dead bands of up to so many steps of the readings are one step.
ONE_STEP = 1.5
# A row is a heartbeat from this share of the longest wait, if that is so many usual waits. By
# judgement: an ordinary log has few rows that are so late, so that they decide nothing.
HEARTBEAT_SHARE = 0.9
HEARTBEAT_WAITS = 3.0
# Levels of an input that is held: more are readings. By judgement: stages of a heater.
MAX_LEVELS = 5
# Readings from which an input of two levels without a repeated one is held, whatever its levels;
# an input of 0 and one other level is a switch, of which two are enough. By judgement: nothing
# lies between the two levels, so that no other value could be meant.
MIN_SWITCHES = 4
# Share of the rows of the table without a reading, from which an input can be held. By judgement.
HELD_BLANKS = 0.5
# Chance of an input of more levels whose readings, at times that have no part in it, never repeat.
HELD_CHANCE = 1e-3
# The numbers below describe means and standard deviations of readings between two rows, in dead
# bands, of random walks, ramps, dips, rest, sines and smooth random signals with noise of 0 to 0.4
# dead bands. `unchanged_values` uses them; `python -m tests.series.on_change_study fill` checks
# them with other seeds.
NEARBY = 6  # changes on each side that tell how noisy the readings are
EXPECTED_TURNS = 0.1  # share of reversals where nothing is known
STEADY_ROUGHNESS = 0.5  # mean excess of a steady change, whose excess is anything up to one poll's
MIN_POLLS = 3  # polls of a wait from which its excess tells the noise
MAX_EXCESS = 0.5  # a larger excess is a step, not noise
MAX_ROUGHNESS = 5.0
ROUNDING_D = 1e-6  # of the dead band: rounding errors of the values
# Rise of the rate to the next change from which the change came late: a change that starts from
# rest with a constant acceleration has 2.4.
MIN_RISE = 3.0
SUDDEN_RISE = 8.0  # from which it is a rest and then the next rate
LATE = 1.5  # excess over that of a steady change from which a change came late
TURN = 0.6  # height of the arc after a change in the other direction
TURN_SD = 0.8  # standard deviation of its bridge
BRIDGE_SD = 0.3  # that of a change that goes on
MAX_POWER = 2.3  # largest factor on it where the change came late
OFFSET = 0.11  # for each unit of roughness
MAX_OFFSET = 0.22
NOISE_SD = 0.16  # for each unit of roughness above NO_NOISE
NO_NOISE = 0.1
MIN_NOISE_SD = 0.05
MAX_NOISE_SD = 0.25
TURN_LEVEL = 0.44  # level of noise between two rows on its two sides
SAME_LEVEL = 0.1  # between two rows on the same side
LEVEL_SD = 0.34
# Changes beyond so many dead bands are jumps: the value was at rest until the last polls. A steady
# change is at most one dead band and that of one poll. Samples of such a wait are few, by
# judgement, so that their common error weighs little. Both are checked by the lags of dips,
# ``python -m tests.series.on_change_study lags``.
JUMP = 1.5
REST_SAMPLES = 9
BEYOND_U = 3**-0.5  # after the last row: anything within the dead band
# Shortest wait, in steps of the stamps, up to which the step is the poll. A longer one is more
# likely a clock with finer decimals than the polls. By judgement.
LONGEST_WAIT = 50.0
# Search for polls whose stamps stray: relative error of the shortest wait (two stamps that stray by
# a twentieth of an interval each, 3 sd); first rows; steps; least coherence of all stamps, which is
# that of stamps with a scatter of 0.19 intervals, exp(-2 (pi 0.19)^2).
SHORTEST_WAIT_ERROR = 0.2
COHERENT_ROWS = 24
SEARCH_STEPS = 201
LEAST_COHERENCE = 0.5
# Places in the shortest wait where the stamps fit no interval: a row is then at most a tenth of the
# shortest wait off its stamp.
FINE_PLACES = 5
# Readings, and dead bands to choose from, that the search uses at most: more take long.
MAX_READINGS = 20000
MAX_CANDIDATES = 400
SMALLEST_CHANGE = 1e-9  # of the largest change: smaller ones are rounding errors
FINER = 0.75  # of the interval: polls that are as long as it need no other clock
MAX_PLACES = 1e6  # of a grid: days at one second; more takes long and tells no more


@dataclass(frozen=True)
class DeadBand:
    """How a column is reported on change.

    Attributes
    ----------
    value
        Dead band, in the unit of the column; 0 for an input that is held.
    is_held
        Whether the column is an input of few levels: between two rows it has the first one's.
    n_readings
        Readings of the column.
    n_changes
        Readings that differ from the one before by the dead band or more.
    n_heartbeats
        Readings that do not, since they were written after a long time.
    """

    value: float
    is_held: bool = False
    n_readings: int = 0
    n_changes: int = 0
    n_heartbeats: int = 0


def find_dead_band(values: Array, clock: Clock) -> DeadBand | None:
    """Recognise a column that is reported on change.

    Parameters
    ----------
    values
        The column at the rows of the table (R,), in any unit; NaN where the cell is blank.
    clock
        The clock of these rows.

    Returns
    -------
    DeadBand or None
        The dead band; None for an ordinary column, and where there are too few changes to tell.

    Notes
    -----
    Two kinds of ordinary logs could look like it, and both have to be excluded.

    The changes of a log whose times have no part in its values have their largest density at zero.
    Of those up to ``NEAR`` D, at least the share 1 / ``NEAR`` is then below D, whatever D is. Their
    number is binomial, and its lower tail is the chance of so few. Heartbeats are left out.

    The changes of a smooth signal need not pass zero, but are its rate times the wait. Rate and
    wait are independent where rows were lost. A report on change waits until the rate has made up
    the dead band: the ranks of rates and waits are opposite.

    A log that is faster in events has the second sign, too. Its changes are not near any dead band,
    and some are below it: the shares are limited.

    A column of two or a few levels without a repeated one, in a table whose other rows are blank,
    is an input that was written when it was switched. Heartbeats are allowed.

    Examples
    --------
    >>> from tcdyn.series.clock import fit_clock
    >>> temperature = 20 + 60 * (1 - np.exp(-np.arange(600) / 120))
    >>> rows = [0]
    >>> for k in range(600):
    ...     if abs(temperature[k] - temperature[rows[-1]]) >= 0.5:
    ...         rows.append(k)
    >>> found = find_dead_band(temperature[rows], fit_clock(np.array(rows, dtype=float)))
    >>> round(found.value, 2)
    0.5
    """
    stamps_s = clock.even_s + clock.deviation_s
    is_reading = np.isfinite(values)
    y = values[is_reading]
    wait_s = np.diff(stamps_s[is_reading])
    is_last = np.append(wait_s > 0, True)[: len(y)]  # of the readings with one stamp
    y = y[is_last]
    wait_s = np.diff(stamps_s[is_reading][is_last])
    if len(y) < 2 or is_counter(y):
        return None
    held = _held_input(y, wait_s, len(values))
    if held is not None:
        return held
    change = np.abs(np.diff(y))[:MAX_READINGS]
    found = _dead_band_of(change, wait_s[:MAX_READINGS], find_resolution_s(y))
    if found is None or len(y) <= MAX_READINGS:
        return found
    return stated_dead_band(values, clock, found.value)


def is_counter(y: Array) -> bool:
    """Whether values (M,) count their rows: whole numbers that rise by one, from row to row.

    >>> is_counter(np.array([7.0, 8.0, 9.0])), is_counter(np.array([7.0, 8.0, 8.0]))
    (True, False)
    """
    return bool(np.all(np.diff(y) == 1.0) and np.all(y == np.rint(y)))


def stated_dead_band(values: Array, clock: Clock, value: float) -> DeadBand:
    """The dead band that the user states, with the numbers of changes and of other readings.

    Parameters
    ----------
    values
        The column at the rows of the table (R,), in any unit; NaN where the cell is blank.
    clock
        The clock of these rows.
    value
        The dead band; 0 for an input that is held.

    Returns
    -------
    DeadBand
        Readings that differ by less than the dead band count as heartbeats.
    """
    y = values[np.isfinite(values)]
    least = value * (1 - ROUNDING_D)
    change = np.abs(np.diff(y))
    n_changes = int(np.count_nonzero((change >= least) & (change > 0)))
    return DeadBand(value, value == 0.0, len(y), n_changes, max(len(y) - 1 - n_changes, 0))


def _held_input(y: Array, wait_s: Array, n_rows: int) -> DeadBand | None:
    """An input of few levels: readings (M,) after waits (M - 1,) in a table of ``n_rows`` rows."""
    levels = np.unique(y)
    if not 2 <= len(levels) <= MAX_LEVELS or len(y) > (1 - HELD_BLANKS) * n_rows:
        return None
    is_repeat = np.diff(y) == 0
    n_repeats = int(np.count_nonzero(is_repeat))
    if np.any(is_repeat & ~_are_heartbeats(wait_s, is_repeat)):
        return None
    n_changes = len(y) - 1 - n_repeats
    is_switch = len(levels) == 2 and (len(y) >= MIN_SWITCHES or 0.0 in levels)
    by_chance = (1 - 1 / len(levels)) ** n_changes
    if is_switch or by_chance < HELD_CHANCE:
        return DeadBand(0.0, True, len(y), n_changes, n_repeats)
    return None


def _dead_band_of(change: Array, wait_s: Array, resolution: float) -> DeadBand | None:
    """The dead band of changes (Q,) after waits (Q,) [s] of readings with this resolution."""
    rounding = max(ROUNDING_D * resolution, SMALLEST_CHANGE * float(change.max()))
    is_changed = change > rounding
    candidates = np.unique(change[is_changed])
    if len(candidates) > MAX_CANDIDATES:
        shares = np.linspace(0, 1, MAX_CANDIDATES)
        candidates = np.unique(np.quantile(change[is_changed], shares, method="lower"))
    n_below, n_near = np.zeros((2, len(candidates)), dtype=int)
    for k, dead_band in enumerate(candidates):
        is_below = change < dead_band - rounding
        is_near = ~is_below & (change <= NEAR * dead_band + rounding)
        if dead_band > ONE_STEP * resolution:
            is_below &= ~_are_heartbeats(wait_s, is_below)
        n_below[k] = np.count_nonzero(is_below)
        n_near[k] = np.count_nonzero(is_near)
    least_below = np.array([_least_below(dead_band, resolution) for dead_band in candidates])
    log_chances = binom.logcdf(n_below, n_below + n_near, least_below)
    is_significant = log_chances + np.log(max(len(candidates), 1)) < np.log(CHANCE)
    if not is_significant.any():
        return None
    if _chance_of_waits(change[is_changed], wait_s[is_changed]) > WAIT_CHANCE:
        return None
    largest = NEAR * float(candidates[int(np.argmin(log_chances))]) + rounding
    dead_band = _likeliest(candidates[is_significant], change, wait_s, largest, resolution)
    is_below = change < dead_band - rounding
    is_heartbeat = is_below & _are_heartbeats(wait_s, is_below)
    n_heartbeats = int(np.count_nonzero(is_heartbeat))
    n_strays = int(np.count_nonzero(is_below)) - n_heartbeats
    if binom.sf(n_strays - 1, len(change), MAX_STRAYS) < WAIT_CHANCE:
        return None
    has_waited = (wait_s > WAITED * wait_s.min()) & ~is_heartbeat
    is_near = ~is_below & (change <= NEAR * dead_band + rounding)
    least_share = NEAR_SHARE_WITH_STRAYS if n_strays else NEAR_SHARE
    if np.count_nonzero(is_near & has_waited) < least_share * np.count_nonzero(has_waited):
        return None
    n_changes = len(change) - n_heartbeats - n_strays
    return DeadBand(dead_band, False, len(change) + 1, n_changes, n_heartbeats)


def _likeliest(
    candidates: Array, change: Array, wait_s: Array, largest: float, resolution: float
) -> float:
    """The dead band of greatest likelihood.

    Parameters
    ----------
    candidates
        Dead bands to choose from (K,).
    change, wait_s
        Changes (Q,) and the waits before them (Q,) [s].
    largest
        Changes up to this one have an exponential distribution above the dead band.
    resolution
        Step of the readings; 0 where there is none.

    Returns
    -------
    float
        One of the candidates.

    Notes
    -----
    A change below the dead band that is no heartbeat has the prior probability ``STRAY_ROWS``.
    """
    log_likelihoods = np.full(len(candidates), -np.inf)
    rounding = max(ROUNDING_D * resolution, SMALLEST_CHANGE * largest)
    for k, dead_band in enumerate(candidates):
        is_below = change < dead_band - rounding
        n_below = int(np.count_nonzero(is_below & ~_are_heartbeats(wait_s, is_below)))
        excess = change[~is_below & (change <= largest)] - dead_band
        if len(excess):
            mean = float(np.mean(excess)) + 0.5 * resolution + rounding
            log_likelihoods[k] = -len(excess) * (1 + np.log(mean / largest))
            log_likelihoods[k] += n_below * np.log(STRAY_ROWS)
    return float(candidates[int(np.argmax(log_likelihoods))])


def _are_heartbeats(wait_s: Array, is_below: Flags) -> Flags:
    """Which waits (Q,) end with a heartbeat, if the changes ``is_below`` (Q,) are below D."""
    longest_s = float(wait_s.max())
    if longest_s < HEARTBEAT_WAITS * float(wait_s.min()):  # no median is below the shortest
        return np.zeros(len(wait_s), dtype=bool)
    others_s = wait_s[~is_below]
    if not len(others_s) or longest_s < HEARTBEAT_WAITS * float(np.median(others_s)):
        return np.zeros(len(wait_s), dtype=bool)
    return wait_s >= HEARTBEAT_SHARE * longest_s


def _least_below(dead_band: float, resolution: float) -> float:
    """Least share of changes below D, of those up to ``NEAR`` D, for a density highest at zero.

    Readings with a resolution have changes that are multiples of it, zero included.
    """
    if dead_band * ROUNDING_D > resolution:
        return 1 / NEAR
    first = round(dead_band / resolution)
    last = int(NEAR * first + ROUNDING_D)
    return (2 * first - 1) / (2 * last + 1)


def _chance_of_waits(change: Array, wait_s: Array) -> float:
    """Chance that rates and waits (Q,), if independent, have ranks as opposite as these."""
    rate_rank = rankdata(change / wait_s)
    wait_rank = rankdata(np.round(wait_s / wait_s.min(), 2))
    if np.ptp(wait_rank) == 0 or np.ptp(rate_rank) == 0:
        return 1.0
    correlation = float(np.corrcoef(rate_rank, wait_rank)[0, 1])
    return float(norm.cdf(correlation * np.sqrt(len(change) - 1)))


@dataclass(frozen=True)
class FilledValues:
    """A column at every place of its grid.

    Attributes
    ----------
    values
        Readings, and estimates between them (clock.size,), in the unit of the column; NaN before
        the first reading.
    u
        Standard uncertainty of the estimates, and 0 at the readings (clock.size,).
    is_filled
        Whether a place has no reading, and an estimate (clock.size,).
    """

    values: Array
    u: Array
    is_filled: Flags


def unchanged_values(values: Array, clock: Clock, dead_band: DeadBand) -> FilledValues:
    """Estimate a column that is reported on change at the places of the grid without a row.

    Parameters
    ----------
    values
        The column at the rows of the table (R,), in any unit; NaN where the cell is blank.
    clock
        The clock of these rows; its interval should be that of the polls (``poll_clock``).
    dead_band
        What :func:`find_dead_band` found, or the dead band that the user states.

    Returns
    -------
    FilledValues
        Values, standard uncertainties, and where they are estimates.

    Notes
    -----
    Between a row with the value v and the next one, with the value v + g a after n polls (g = +-1,
    a >= D), the readings at the polls are within D of v. In units of D, and in the direction of g,
    the estimate at the share t of the wait is the mean of two descriptions.

    *Motion.* A steady change passes D within the last poll: its excess e = a - 1 is at most
    1 / (n - 1). The value then runs on a line to the new row, a cubic that keeps the shape of the
    changes around it, limited to 1. The variance is that of a bridge, c^2 t(1 - t). A larger
    excess, x = e (n - 1) > 1, is a late change, and one within the last poll for a large x: end t^m
    with m = sqrt(x / 1.5) and the end 1 - e, since the limit lies on average in the middle of the
    last change. Where the next change has a much higher rate, the value rested and then had this
    rate. After a change in the other direction the value first went on: an arc ``TURN`` 4 t(1 - t)
    is taken off. Where changes are noisy, which their excess shows, a row stands at an excursion of
    the noise: an offset is taken off.

    *Noise about a level.* Rows are then written at the largest excursions, to alternate sides; the
    others have their level in the middle.

    The share of reversals among the changes nearby is the probability of the second description.
    The variance includes the difference of the two means. ``python -m tests.series.on_change_study
    fill`` compares errors and standard uncertainties. Errors nearby are not independent: those of
    one wait have mostly one sign.
    """
    n_places = clock.size
    grid = np.full(n_places, np.nan)
    u = np.full(n_places, np.nan)
    rows = np.flatnonzero(np.isfinite(values))
    grid[clock.index[rows]] = values[rows]
    places = np.flatnonzero(np.isfinite(grid))
    if not len(places):
        return FilledValues(grid, u, np.zeros(n_places, dtype=bool))
    u[places] = 0.0
    written = grid[places]
    empty = np.flatnonzero(~np.isfinite(grid))
    empty = empty[empty > places[0]]
    before = np.searchsorted(places, empty) - 1
    grid[empty] = written[before]
    u[empty] = 0.0 if dead_band.is_held else BEYOND_U * dead_band.value
    inside = before < len(places) - 1
    if not dead_band.is_held and inside.any():
        waits = _waits_of(written, places, dead_band.value)
        q = before[inside]
        share = (empty[inside] - places[q]) / waits.n_polls[q]
        steady = PchipInterpolator(places, written)(empty[inside]) - written[q]
        steady *= waits.direction[q] / dead_band.value
        mean, sd = _within_wait(waits, q, share, steady)
        grid[empty[inside]] += dead_band.value * waits.direction[q] * mean
        u[empty[inside]] = dead_band.value * sd
    is_filled = np.zeros(n_places, dtype=bool)
    is_filled[empty] = True
    return FilledValues(grid, u, is_filled)


def samples_at_rest(values: Array, clock: Clock, dead_band: DeadBand) -> Array:
    """Readings, and some samples of the waits that end with a jump.

    Parameters
    ----------
    values, clock, dead_band
        As for :func:`unchanged_values`.

    Returns
    -------
    array
        Readings at the samples (clock.size,), NaN where nothing was read; in each wait that ends
        with a change of more than ``JUMP`` dead bands also ``REST_SAMPLES`` estimates, evenly
        spaced. An input that is held has its level at all samples.

    Notes
    -----
    Before a jump the reading did not move, and no row says so. Nearly all other estimates stay out:
    their errors have one sign within a wait, and an estimator that takes them as readings with
    white noise finds lags that are wrong by more than it states. The last estimate is a tenth of
    the wait before the row, since the jump may have begun before its last poll. ``python -m
    tests.series.on_change_study lags`` shows the lags with these samples.
    """
    filled = unchanged_values(values, clock, dead_band)
    if dead_band.is_held:
        return filled.values
    keep = ~filled.is_filled
    places = np.flatnonzero(keep)
    written = filled.values[places]
    n_polls = np.diff(places)
    is_jump = np.abs(np.diff(written)) > JUMP * dead_band.value
    for k in np.flatnonzero(is_jump & (n_polls > REST_SAMPLES)).tolist():
        step = int(n_polls[k]) // (REST_SAMPLES + 1)
        keep[places[k + 1] - step * np.arange(1, REST_SAMPLES + 1)] = True
    return np.where(keep, filled.values, np.nan)


@dataclass(frozen=True)
class _Waits:
    """Times between two rows, (Q,) each; changes in units of the dead band.

    Attributes
    ----------
    n_polls
        Polls from one row to the next.
    direction
        Sign of the change.
    change
        Its size.
    is_heartbeat
        Whether it is below one.
    is_turn
        Whether the change before had the other direction.
    turn_share
        Share of reversals among the changes nearby.
    roughness
        Mean excess of the changes nearby, over the change from poll to poll.
    rise
        Rate of the next change, if it has the same direction, over that of this one; else 1.
    """

    n_polls: Array
    direction: Array
    change: Array
    is_heartbeat: Flags
    is_turn: Flags
    turn_share: Array
    roughness: Array
    rise: Array


def _waits_of(written: Array, places: NDArray[np.intp], dead_band: float) -> _Waits:
    """The waits between rows with these values (M,) at these places (M,)."""
    n_polls = np.diff(places).astype(float)
    signed = np.diff(written) / dead_band
    change = np.abs(signed)
    is_heartbeat = change < 1 - ROUNDING_D
    is_turn = np.append(False, signed[1:] * signed[:-1] < 0)
    is_turn[1:] &= ~(is_heartbeat[1:] | is_heartbeat[:-1])
    turn_share = _mean_nearby(is_turn.astype(float), ~is_heartbeat, EXPECTED_TURNS)
    rate = change / n_polls
    rise = np.ones(len(rate))
    goes_on = ~is_heartbeat[:-1] & (signed[1:] * signed[:-1] > 0)
    rise[:-1][goes_on] = rate[1:][goes_on] / rate[:-1][goes_on]
    excess = np.maximum(change - 1, 0.0)
    is_telling = ~is_heartbeat & (n_polls >= MIN_POLLS) & (excess < MAX_EXCESS)
    roughness = np.minimum(excess * n_polls / np.maximum(change, 1.0), MAX_ROUGHNESS)
    roughness = _mean_nearby(roughness, is_telling, STEADY_ROUGHNESS)
    return _Waits(
        n_polls, np.sign(signed), change, is_heartbeat, is_turn, turn_share, roughness, rise
    )


def _mean_nearby(quantity: Array, counts: Flags, expected: float) -> Array:
    """Means of a quantity (Q,) over the neighbours that count, and one of the expected value."""
    kernel = np.ones(2 * NEARBY + 1)
    inside = slice(NEARBY, NEARBY + len(quantity))
    total = np.convolve(np.where(counts, quantity, 0.0), kernel)[inside]
    number = np.convolve(counts.astype(float), kernel)[inside]
    return np.asarray((total + expected) / (number + 1))


def _within_wait(
    waits: _Waits, q: NDArray[np.intp], share: Array, steady: Array
) -> tuple[Array, Array]:
    """Mean and standard deviation of the readings after a share (P,) of their waits ``q`` (P,).

    Both in units of the dead band, the mean from the last row in the direction of the change.
    """
    n_polls = waits.n_polls[q]
    change = waits.change[q]
    is_heartbeat = waits.is_heartbeat[q]
    is_turn = waits.is_turn[q]
    excess = np.maximum(change - 1, 0.0)
    lateness = excess * (n_polls - 1)
    power = np.sqrt(np.maximum(lateness / LATE, 1.0))
    steady = np.where(is_turn, change * share, steady)
    rises_next = waits.rise[q]
    is_late = lateness > LATE
    end = np.where(rises_next > MIN_RISE, change, np.maximum(1 - excess, 0.0))
    power = np.where(rises_next > MIN_RISE, np.maximum(power, rises_next), power)
    is_late |= rises_next > MIN_RISE
    late = end * share**power
    kink = np.maximum(change * (1 - rises_next * (1 - share)), 0.0)
    late = np.where(rises_next > SUDDEN_RISE, kink, late)
    mean = np.minimum(np.where(is_late, late, steady), 1.0)
    arch = 4 * share * (1 - share)
    mean -= np.where(is_turn, TURN * arch / power, 0.0)
    offset = np.clip(OFFSET * (waits.roughness[q] - STEADY_ROUGHNESS), 0.0, MAX_OFFSET)
    mean -= np.where(is_heartbeat, 0.0, offset)
    bridge_sd = np.where(is_turn, TURN_SD, BRIDGE_SD * np.minimum(power, MAX_POWER))
    noise_sd = np.clip(NOISE_SD * (waits.roughness[q] - NO_NOISE), MIN_NOISE_SD, MAX_NOISE_SD)
    variance = 0.25 * bridge_sd**2 * arch + noise_sd**2
    level = np.where(is_turn, TURN_LEVEL, SAME_LEVEL)
    weight = waits.turn_share[q]
    total = (1 - weight) * mean + weight * level
    variance = (1 - weight) * variance + weight * LEVEL_SD**2
    variance += weight * (1 - weight) * (level - mean) ** 2
    return total, np.sqrt(variance)


def _coherent_interval_s(stamps_s: Array, shortest_s: float) -> float:
    """Interval of polls near the shortest wait, whose stamps stray; 0 where there is none.

    Parameters
    ----------
    stamps_s
        Stamps (R,) [s].
    shortest_s
        Shortest wait between two of them [s].

    Notes
    -----
    The coherence, the size of the mean of exp(2 pi i t / dt), is one for stamps on a grid of dt. It
    is searched with the first rows, near the shortest wait, and then with ever more rows near the
    last value.
    """
    half_width = SHORTEST_WAIT_ERROR * shortest_s
    interval_s = shortest_s
    n_rows = min(COHERENT_ROWS, len(stamps_s))
    while True:
        t = stamps_s[:n_rows] - stamps_s[0]
        candidates = np.linspace(interval_s - half_width, interval_s + half_width, SEARCH_STEPS)
        phases = np.exp(2j * np.pi * t[None, :] / candidates[:, None])
        coherence = np.abs(phases.mean(axis=1))
        best = int(np.argmax(coherence))
        interval_s = float(candidates[best])
        if n_rows == len(stamps_s):
            return interval_s if coherence[best] > LEAST_COHERENCE else 0.0
        half_width *= 4 / SEARCH_STEPS
        # the last row may then be at most about one interval off
        slip_s = half_width * t[-1] / interval_s
        growth = max(int(n_rows * min(2.0, max(interval_s / max(slip_s, 1e-12), 1.2))), n_rows + 1)
        n_rows = min(growth, len(stamps_s))


def poll_clock(clock: Clock) -> Clock:
    """The clock of the polls, for a table whose rows were all written on change.

    Parameters
    ----------
    clock
        The clock of the rows, as :func:`tcdyn.series.clock.fit_clock` finds it.

    Returns
    -------
    Clock
        The same one where its interval is that of the polls.

    Notes
    -----
    Where hardly any row follows another one at the next poll, the typical wait looks like the
    interval. The polls are then the step of which all stamps are multiples; where the stamps have
    finer decimals than the polls, they are near the shortest wait (``_coherent_interval_s``). Where
    the stamps fit no such interval, as those of rows at equal steps of a temperature, they are
    exact, and the places are finer than the shortest wait.
    """
    stamps_s = clock.even_s + clock.deviation_s
    waits_s = np.diff(stamps_s)
    shortest_s = float(np.min(waits_s[waits_s > ROUNDING_D * clock.interval_s]))
    has_polls = clock.resolution_s > 0 and shortest_s <= LONGEST_WAIT * clock.resolution_s
    interval_s = clock.resolution_s
    if not has_polls:
        fractions_s = [shortest_s / k for k in (1, 2, 3)]  # no wait may be one poll
        found_s = [_coherent_interval_s(stamps_s, start_s) for start_s in fractions_s]
        fine_s = shortest_s / FINE_PLACES
        has_polls = any(found_s)
        interval_s = next((each_s for each_s in found_s if each_s), fine_s)
    n_places = (stamps_s[-1] - stamps_s[0]) / interval_s
    if interval_s > FINER * clock.interval_s or n_places > MAX_PLACES:
        return clock
    if has_polls:
        return fit_clock(stamps_s, interval_s=interval_s)
    start_s = float(stamps_s[0])
    index = np.rint((stamps_s - start_s) / interval_s).astype(np.intp)
    deviation_s = stamps_s - (start_s + interval_s * index)
    return Clock(interval_s, 0.0, index, start_s, deviation_s, clock.resolution_s, clock.n_repeated)
