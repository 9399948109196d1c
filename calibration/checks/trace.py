"""A trace's clock and columns: even sampling, missing samples put back; columns counted in pieces, then judged."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calibration import Array, Flags
from calibration.columns import ROOM_AND_BATH
from calibration.errors import InputError
from calibration.finding import Finding, Place, look, note
from calibration.noise import MOST_MISSING, impossible

LONGEST_GAP_S = 0.5  # longer silence is refused: nobody knows what happened in it
SLOWEST_DT_S = 1.0  # a trace sampled more slowly says nothing about lags
LONGEST_NAN_S = 0.5
FROZEN_S = 10.0


@dataclass(frozen=True)
class Sampling:
    """Each row's time (N,) [s] and its place on the even grid (N,), the sample interval [s], and what was noticed."""

    time_s: Array
    dt_s: float
    grid: NDArray[np.int32]
    findings: tuple[Finding, ...]


def check_time(time: Array, place: Place) -> Sampling:
    """The time (N,) [s] as logged, with single missing values filled, and its sampling.

    Rounded stamps (0.013, 0.027, 0.040 at 75 Hz) are recognised as even and come back so. Raises InputError for time
    that repeats or runs backward (row, time), gaps above 0.5 s, uneven sampling, milliseconds, or too few rows.
    """
    where = place.where
    if len(time) < 10:
        raise InputError(f"only {len(time)} rows", where=where, expected="at least 10 samples in time")
    time, found = _filled(time, place)
    step = np.diff(time)
    if not (step > 0).all():
        i = int(np.argmax(step <= 0))
        verb = "repeats" if step[i] == 0 else "runs backward"
        many = int((step <= 0).sum())
        raise InputError(
            f"column time_s, row {place.row(i + 1)}: time {verb} ({time[i]:.6g} s, then {time[i + 1]:.6g} s)"
            + (f", and in {many - 1} more rows" if many > 1 else ""),
            where=where,
            expected="time that rises from row to row",
            remedy="sort the rows, or give the clock more decimals" if verb == "repeats" else "repair the rows",
        )
    usual = float(np.median(step))
    dt = _interval_s(time, _places(step, usual))
    if dt > SLOWEST_DT_S:
        ms = dt * 1e-3 < 0.2
        raise InputError(
            f"column time_s: samples stand {dt:.4g} s apart" + ("; this looks like milliseconds" if ms else ""),
            where=where,
            expected="seconds, sampled faster than 1 Hz (75 Hz on the rig)",
        )
    gap = int(np.argmax(step))
    if step[gap] > max(LONGEST_GAP_S, 3 * dt):
        raise InputError(
            f"column time_s, row {place.row(gap + 1)}: {step[gap]:.4g} s are missing at {time[gap]:.6g} s",
            where=where,
            expected=f"gaps of at most {LONGEST_GAP_S} s",
            remedy="cut the log there and use one part",
        )
    grid = _places(step, dt)
    lone = np.diff(grid) == 1
    odd = np.abs(step - dt) > 0.45 * dt
    jitter = odd & lone
    if jitter.sum() > 0.2 * lone.sum() or (~lone).mean() > 0.2:
        row = np.arange(len(time), dtype=np.int32)
        row_s = _interval_s(time, row)
        if _even(time, row, row_s)[1] >= 0.45 * row_s:  # a lost sample bends the line more than rounded stamps do
            i = int(np.argmax(odd))
            raise InputError(
                f"column time_s, row {place.row(i + 1)}: sampling is uneven ({step.min():.4g} to {step.max():.4g} s)",
                where=where,
                expected="one sampling rate",
                remedy="log at one rate, or resample first",
            )
        dt, grid = row_s, row
        found.append(look("time.few_decimals", subject="time_s", rate_Hz=1 / dt))
        lone, jitter = np.full(len(step), True), np.full(len(step), False)
    if jitter.any():
        i = int(np.argmax(jitter))
        found.append(note("time.jitter", subject="time_s", row=place.row(i + 1), count=int(jitter.sum())))
    lost = int(grid[-1]) - len(step)
    if lost:
        i = int(np.argmin(lone))
        line, places = place.row(i + 1), int((~lone).sum())
        found.append(look("time.lost", subject="time_s", row=line, count=lost, places=places, first_s=float(time[i])))
    if dt > 0.05:
        found.append(look("time.slow", subject="time_s", rate_Hz=1 / dt, lost_s=2 * dt))
    even, away_s = _even(time, grid, dt)
    # steps of 13 and 14 ms, neither of which is the interval of 75 Hz: the clock has too few decimals
    rounded = abs(usual - dt) >= 1e-3 * dt and away_s < dt
    return Sampling(even if rounded else time, dt, grid, tuple(found))


def _places(step: Array, dt_s: float) -> NDArray[np.int32]:
    """Where each sample stands on the grid of ``dt_s``, from the steps between them."""
    return np.concatenate([[0], np.cumsum(np.maximum(np.rint(step / dt_s), 1.0))]).astype(np.int32)


def _interval_s(time: Array, place: NDArray[np.int32]) -> float:
    """Slope of the straight line through the stamps, by least squares."""
    grid = place - place.mean()
    return float(grid @ (time - time.mean()) / (grid @ grid))


def _even(time: Array, place: NDArray[np.int32], dt_s: float) -> tuple[Array, float]:
    """Stamps on the even grid, and how far [s] the farthest of those logged lies from its own."""
    even = np.asarray((place - place.mean()) * dt_s + time.mean())
    return even, float(np.max(np.abs(even - time)))


def _filled(time: Array, place: Place) -> tuple[Array, list[Finding]]:
    bad = ~np.isfinite(time)
    if not bad.any():
        return time, []
    i = int(np.argmax(bad))
    if bad.sum() > 3 or bad[0] or bad[-1] or (bad[1:] & bad[:-1]).any():
        raise InputError(
            f"{place.at('time_s', i)}: {int(bad.sum())} times are missing",
            where=place.where,
            expected="a time in each row",
        )
    index = np.arange(len(time))
    time = np.interp(index, index[~bad], time[~bad])
    return time, [look("time.filled", subject="time_s", row=place.row(i), count=int(bad.sum()))]


@dataclass
class Tally:
    """Marked samples of a column that comes in pieces: how many, the first one, the longest run of them.

    ``value`` is that of the first one, ``held`` that at the start of the longest run, ``open`` the last run (start,
    length, value), which may go on in the next piece.
    """

    count: int = 0
    first: int = -1
    value: float = np.nan
    start: int = -1
    length: int = 0
    held: float = np.nan
    open: tuple[int, int, float] = (-1, 0, np.nan)

    def see(self, mask: Flags, values: Array, at: int) -> None:
        """Count the True of ``mask (N,)``, whose first sample is number ``at``; ``values (N,)`` as in the file."""
        edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
        starts = np.flatnonzero(edges == 1)
        if not len(starts):
            return
        long = np.flatnonzero(edges == -1) - starts
        if self.count == 0:
            self.first, self.value = at + int(starts[0]), float(values[starts[0]])
        self.count += int(long.sum())
        begin, held = starts + at, values[starts]
        if begin[0] == self.open[0] + self.open[1]:
            begin[0], held[0] = self.open[0], self.open[2]
            long[0] += self.open[1]
        k = int(np.argmax(long))
        if long[k] > self.length:
            self.start, self.length, self.held = int(begin[k]), int(long[k]), float(held[k])
        self.open = int(begin[-1]), int(long[-1]), float(held[-1])


@dataclass
class ColumnCheck:
    """A column of a trace (or of an oven log) that comes in pieces: counted on the way, judged at the end.

    In a temperature, impossible values and spikes are counted, a dead channel and long gaps are refused; room and bath
    may stand still, with a finding. Other columns have no limits of their own.
    """

    name: str
    place: Place
    tallies: dict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    seen: int = 0
    last: float = np.nan
    low: float = np.inf
    high: float = -np.inf

    def see(self, values: Array, cleaned: Array) -> None:
        """Count what happened to the next samples (N,), as in the file and as ``clean`` left them."""
        at, missing = self.seen, np.isnan(cleaned)
        self.seen += len(values)
        self.tallies["missing"].see(missing, values, at)
        if not self.name.endswith("_degC"):
            return
        wild, absent = impossible(values), np.isnan(values)
        self.tallies["wild"].see(wild, values, at)
        self.tallies["absent"].see(absent, values, at)
        self.tallies["spikes"].see(missing & ~absent & ~wild, values, at)
        real = np.concatenate([[self.last], np.where(wild, np.nan, values)])
        self.tallies["same"].see(np.diff(real) == 0.0, real[:-1], at - 1)
        self.last = float(real[-1])
        self.low = float(np.fmin.reduce(real, initial=self.low))
        self.high = float(np.fmax.reduce(real, initial=self.high))

    def judge(self) -> list[Finding]:
        """What was noticed. Raises InputError for a dead or frozen channel, many spikes, and gaps long or many."""
        name, place, seen, found = self.name, self.place, self.seen, list[Finding]()
        wild, spikes, absent, gap = (self.tallies[key] for key in ("wild", "spikes", "absent", "missing"))
        if not name.endswith("_degC"):
            if gap.count > MOST_MISSING * seen:
                raise InputError(
                    f"{place.at(name, gap.first)}: {gap.value:.4g}; {100 * gap.count / seen:.0f} % of the column is "
                    "missing or impossible",
                    where=place.where,
                )
            return [look("values.missing", subject=name, count=gap.count, **place.of(gap.first))] if gap.count else []
        if wild.count:
            first = place.of(wild.first)
            found.append(look("values.impossible", subject=name, count=wild.count, value=wild.value, **first))
        if place.dt_s is None:
            return found
        found += self._frozen(place.dt_s)
        if spikes.count > MOST_MISSING * seen:
            raise InputError(
                f"{place.at(name, spikes.first)}: {100 * spikes.count / seen:.0f} % of the samples are spikes",
                where=place.where,
                remedy="check the slip ring and the wiring of this channel",
            )
        if spikes.count:
            found.append(note("spikes.removed", subject=name, count=spikes.count, **place.of(spikes.first)))
        span_s = gap.length * place.dt_s
        if span_s > max(LONGEST_NAN_S, 3 * place.dt_s) or gap.count > MOST_MISSING * seen:
            raise InputError(
                f"{place.at(name, gap.start)}: {gap.length} values in a row are missing "
                f"({span_s:.3g} s), {100 * gap.count / seen:.2g} % of the channel",
                where=place.where,
                expected=f"runs of at most {LONGEST_NAN_S} s and {100 * MOST_MISSING:.0f} % in all",
                remedy="cut the log there, or repair the channel",
            )
        if absent.count:
            longest = {"longest": absent.length, "longest_s": absent.length * place.dt_s, **place.of(absent.start)}
            found.append(look("values.absent", subject=name, count=absent.count, **longest))
        return found

    def _frozen(self, dt_s: float) -> list[Finding]:
        same, name, place = self.tallies["same"], self.name, self.place
        others, span_s = self.seen - 1 - same.length, same.length * dt_s
        if self.low == self.high:
            found, remedy = look("column.constant", subject=name, value=self.low), "check its wiring"
        elif span_s > FROZEN_S and same.count - same.length < 0.5 * max(others, 1):
            found = look("column.frozen", subject=name, value=same.held, span_s=span_s, **place.of(same.start))
            remedy = "check its wiring, or cut the log"
        else:
            return []
        if name not in ROOM_AND_BATH:
            raise InputError(f"{found.sentence}: a dead channel", where=place.where, remedy=remedy)
        return [found]
