"""A column that comes in pieces: cleaned piece by piece, counted on the way, judged at the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import Array, Flags
from calibration.columns import ROOM_AND_BATH
from calibration.errors import InputError
from calibration.files.table import RowNumbers
from calibration.finding import Finding, look, note
from calibration.noise import SPIKES, find_spikes, white_noise_sd

COLDEST_DEGC, HOTTEST_DEGC = -60.0, 760.0  # type J's range at the hot end
LONGEST_NAN_S = 0.5
MOST_MISSING = 0.05  # fraction of a channel
FROZEN_S = 10.0
SIDE = SPIKES["reading"].longest  # neighbours on either side by which a sample is judged
LEAST_TOLD = 15  # samples that tell the noise
Index = NDArray[np.int64]
RUN, MOST = 64, 1 << 17  # rows in a run, so that neighbours stay neighbours; rows kept at most (29 min at 75 Hz)


@dataclass(frozen=True)
class Place:
    """Where samples stand: file, rows and times (``time_s`` and ``dt_s`` are None in an oven log)."""

    where: str
    rows: RowNumbers
    time_s: Array | None = None
    dt_s: float | None = None

    def of(self, index: int) -> dict[str, Any]:
        """Row and, in a trace, time of a sample, as findings carry them."""
        time = {} if self.time_s is None else {"time_s": float(self.time_s[index])}
        return {"row": self.rows.of(index), **time}

    def at(self, column: str, index: int) -> str:
        """Column, row and time of a sample in words, as errors name them."""
        time = "" if self.time_s is None else f" ({self.time_s[index]:.6g} s)"
        return f"column {column}, row {self.rows.of(index)}{time}"


class Tally:
    """Marked samples of a column that comes in pieces: how many, the first one, the longest run of them."""

    def __init__(self) -> None:
        self.count, self.first, self.value = 0, -1, np.nan
        self.start, self.length, self.held = -1, 0, np.nan
        self._open_start, self._open_length, self._open_held = -1, 0, np.nan

    def see(self, mask: Flags, values: Array, at: int) -> None:
        """Count the True of ``mask (N,)``, whose first sample is number ``at``; ``values (N,)`` as in the file.

        ``value`` becomes that of the first one, ``held`` that at the start of the longest run.
        """
        edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
        starts = np.flatnonzero(edges == 1)
        if not len(starts):
            return
        long = np.flatnonzero(edges == -1) - starts
        if self.count == 0:
            self.first, self.value = at + int(starts[0]), float(values[starts[0]])
        self.count += int(long.sum())
        begin, held = starts + at, values[starts]
        if begin[0] == self._open_start + self._open_length:
            begin[0], held[0] = self._open_start, self._open_held
            long[0] += self._open_length
        k = int(np.argmax(long))
        if long[k] > self.length:
            self.start, self.length, self.held = int(begin[k]), int(long[k]), float(held[k])
        self._open_start, self._open_length, self._open_held = int(begin[-1]), int(long[-1]), float(held[-1])


class Thinned:
    """Every k-th run of 64 rows of columns that come piece by piece, k the power of two that keeps at most ``MOST``.

    What needs a column's whole course but not every row is judged on it: medians, quantiles, noise. A table of up to
    ``MOST`` rows is kept whole; whatever the pieces, the same rows are kept.

    >>> thin = Thinned()
    >>> for start in (0, 100_000):
    ...     thin.see({"t": np.arange(start, start + 100_000.0)})
    >>> thin.rows[[0, 63, 64]], len(thin.columns["t"])
    (array([  0,  63, 128]), 100032)
    """

    def __init__(self) -> None:
        self.every, self.seen = 1, 0
        self._parts: list[tuple[Index, dict[str, Array]]] = []

    def see(self, columns: Mapping[str, Array]) -> None:
        """Keep what is due of the next rows."""
        count = len(next(iter(columns.values())))
        self._parts.append(self._kept(np.arange(self.seen, self.seen + count), columns))
        self.seen += count
        while sum(len(rows) for rows, _ in self._parts) > MOST:
            self.every *= 2
            self._parts = [self._kept(*part) for part in self._parts]

    @property
    def rows(self) -> Index:
        """Which rows are kept, counted from 0."""
        return np.concatenate([rows for rows, _ in self._parts])

    @property
    def columns(self) -> dict[str, Array]:
        """The columns at these rows."""
        return {name: np.concatenate([part[name] for _, part in self._parts]) for name in self._parts[0][1]}

    def _kept(self, rows: Index, columns: Mapping[str, Array]) -> tuple[Index, dict[str, Array]]:
        keep = rows // RUN % self.every == 0
        return rows[keep], {name: values[keep] for name, values in columns.items()}


class TemperatureCheck:
    """A temperature column: impossible values and spikes go, a dead channel and long gaps are refused.

    ``noise_K`` tells a spike, see ``check_sample``. Room and bath may stand still, with a finding.
    """

    def __init__(self, name: str, place: Place, noise_K: float) -> None:
        self.name, self.place, self.noise_K = name, place, noise_K
        self.junction = name not in ROOM_AND_BATH
        self.wild, self.spikes, self.absent, self.missing, self.same = Tally(), Tally(), Tally(), Tally(), Tally()
        self.seen, self.last, self.low, self.high = 0, np.nan, np.inf, -np.inf

    def clean(self, values: Array) -> Array:
        """The samples (N,) with impossible values and spikes as NaN."""
        out = np.where(_wild(values), np.nan, values)
        out[find_spikes(out, SPIKES["reading"], self.noise_K)] = np.nan
        return out

    def see(self, values: Array, cleaned: Array) -> None:
        """Count what happened to the next samples (N,)."""
        at, wild, absent, missing = self.seen, _wild(values), np.isnan(values), np.isnan(cleaned)
        self.seen += len(values)
        self.wild.see(wild, values, at)
        self.absent.see(absent, values, at)
        self.missing.see(missing, values, at)
        self.spikes.see(missing & ~absent & ~wild, values, at)
        real = np.concatenate([[self.last], np.where(wild, np.nan, values)])
        self.same.see(np.diff(real) == 0.0, real[:-1], at - 1)
        self.last = float(real[-1])
        self.low = float(np.fmin.reduce(real, initial=self.low))
        self.high = float(np.fmax.reduce(real, initial=self.high))

    def judge(self) -> list[Finding]:
        """What was noticed. Raises InputError for a dead or frozen channel, many spikes, and long gaps."""
        name, place, wild, spikes = self.name, self.place, self.wild, self.spikes
        found: list[Finding] = []
        if wild.count:
            first = place.of(wild.first)
            found.append(look("values.impossible", subject=name, count=wild.count, value=wild.value, **first))
        if place.dt_s is None:
            return found
        found += self._frozen(place.dt_s)
        if spikes.count > MOST_MISSING * self.seen:
            raise InputError(
                f"{place.at(name, spikes.first)}: {100 * spikes.count / self.seen:.0f} % of the samples are spikes",
                where=place.where,
                remedy="check the slip ring and the wiring of this channel",
            )
        if spikes.count:
            found.append(note("spikes.removed", subject=name, count=spikes.count, **place.of(spikes.first)))
        return found + self._gaps(place.dt_s)

    def _frozen(self, dt_s: float) -> list[Finding]:
        same, name, place = self.same, self.name, self.place
        others, span_s = self.seen - 1 - same.length, same.length * dt_s
        if self.low == self.high:
            found, remedy = look("column.constant", subject=name, value=self.low), "check its wiring"
        elif span_s > FROZEN_S and same.count - same.length < 0.5 * max(others, 1):
            found = look("column.frozen", subject=name, value=same.held, span_s=span_s, **place.of(same.start))
            remedy = "check its wiring, or cut the log"
        else:
            return []
        if self.junction:
            raise InputError(f"{found.sentence}: a dead channel", where=place.where, remedy=remedy)
        return [found]

    def _gaps(self, dt_s: float) -> list[Finding]:
        gap, span_s = self.missing, self.missing.length * dt_s
        if span_s > max(LONGEST_NAN_S, 3 * dt_s) or gap.count > MOST_MISSING * self.seen:
            raise InputError(
                f"{self.place.at(self.name, gap.start)}: {gap.length} values in a row are missing "
                f"({span_s:.3g} s), {100 * gap.count / self.seen:.2g} % of the channel",
                where=self.place.where,
                expected=f"runs of at most {LONGEST_NAN_S} s and {100 * MOST_MISSING:.0f} % in all",
                remedy="cut the log there, or repair the channel",
            )
        run = self.absent
        if not run.count:
            return []
        first, span_s = self.place.of(run.start), run.length * dt_s
        longest = {"longest": run.length, "longest_s": span_s, **first}
        return [look("values.absent", subject=self.name, count=run.count, **longest)]


class PlainCheck:
    """A column of numbers without a limit of its own; same use as ``TemperatureCheck``."""

    def __init__(self, name: str, place: Place) -> None:
        self.name, self.place, self.seen, self.bad = name, place, 0, Tally()

    def clean(self, values: Array) -> Array:
        """The samples (N,) with those missing or beyond a million as NaN."""
        with np.errstate(invalid="ignore"):
            return np.where(np.abs(values) <= 1e6, values, np.nan)

    def see(self, values: Array, cleaned: Array) -> None:
        """Count what happened to the next samples (N,)."""
        self.bad.see(np.isnan(cleaned), values, self.seen)
        self.seen += len(values)

    def judge(self) -> list[Finding]:
        """What was noticed. Raises InputError when more than a twentieth is missing."""
        bad = self.bad
        if bad.count > MOST_MISSING * self.seen:
            raise InputError(
                f"{self.place.at(self.name, bad.first)}: {bad.value:.4g}; {100 * bad.count / self.seen:.0f} % of the "
                "column is missing or impossible",
                where=self.place.where,
            )
        if not bad.count:
            return []
        return [look("values.missing", subject=self.name, count=bad.count, **self.place.of(bad.first))]


def column_check(name: str, place: Place, noise_K: float) -> TemperatureCheck | PlainCheck:
    """What cleans, counts and judges this column of a trace."""
    return TemperatureCheck(name, place, noise_K) if name.endswith("_degC") else PlainCheck(name, place)


def check_sample(name: str, sample: Array, rows: Index, place: Place) -> float:
    """Noise [K] that a spike of this column must stand out of, from its course ``sample`` (M,), found in ``rows`` (M,).

    Infinite where no spikes are sought, or too few samples tell it. Raises InputError for a temperature without
    numbers, for kelvin and for values that no thermocouple gives.
    """
    if not name.endswith("_degC"):
        return np.inf
    finite = sample[np.isfinite(sample)]
    if not len(finite):
        raise InputError(f"column {name} holds no numbers", where=place.where, expected="degrees Celsius")
    low, high = np.quantile(finite, [0.02, 0.98])
    if low > 250.0 and high < 800.0:
        raise InputError(
            f"column {name} lies between {low:.4g} and {high:.4g}: this looks like kelvin",
            where=place.where,
            expected="degrees Celsius",
            remedy="subtract 273.15",
        )
    wild = _wild(sample)
    if wild.mean() > MOST_MISSING:
        i, more = int(np.argmax(wild)), int(wild.sum()) - 1
        raise InputError(
            f"{place.at(name, int(rows[i]))}: {sample[i]:.4g} and {more} more values that no junction has",
            where=place.where,
            expected=f"{COLDEST_DEGC:g} to {HOTTEST_DEGC:g} degC",
            remedy="check the unit and the wiring of this channel",
        )
    told = sample[np.isfinite(sample) & ~wild]
    return float(white_noise_sd(told, 1)) if place.dt_s is not None and len(told) >= LEAST_TOLD else np.inf


def _wild(x: Array) -> Flags:
    with np.errstate(invalid="ignore"):
        return np.asarray((x < COLDEST_DEGC) | (x > HOTTEST_DEGC))
