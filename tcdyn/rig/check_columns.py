"""A trace's columns, counted in pieces, then judged."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import union_categoricals

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, info_or_warning, warning
from tcdyn.estimation.trace_noise import MOST_MISSING, impossible
from tcdyn.rig.columns import SWITCHES, is_air

LONGEST_NAN_S = 0.5
FROZEN_S = 10.0
# rows in a run: neighbours stay neighbours; rows that tell what a whole column is like
RUN = 64
SAMPLE = 1 << 15


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
        begin = starts + at
        held = values[starts]
        if begin[0] == self.open[0] + self.open[1]:
            begin[0], held[0] = self.open[0], self.open[2]
            long[0] += self.open[1]
        k = int(np.argmax(long))
        if long[k] > self.length:
            self.start, self.length, self.held = int(begin[k]), int(long[k]), float(held[k])
        self.open = int(begin[-1]), int(long[-1]), float(held[-1])


@dataclass
class Course:
    """Columns that come in pieces, of which ``SAMPLE`` rows at most are kept: all, or every k-th run of ``RUN``.

    Of switches, which have few values, all rows are.
    """

    rows: int = 0
    every: int = 1
    parts: list[pd.DataFrame] = field(default_factory=list)
    switches: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))

    def see(self, columns: Mapping[str, Array]) -> None:
        """Keep what belongs to it of the next rows, (N,) of each column."""
        for name in filter(SWITCHES.__contains__, columns):
            self.switches[name].append(pd.Categorical(columns[name]))
        new = pd.DataFrame({name: x for name, x in columns.items() if name not in SWITCHES})
        new.index += self.rows
        self.rows += len(new)
        self.parts.append(new[new.index // RUN % self.every == 0])
        while sum(map(len, self.parts)) > SAMPLE:
            self.every *= 2
            self.parts = [part[part.index // RUN % self.every == 0] for part in self.parts]

    def frame(self) -> pd.DataFrame:
        """What was kept, by its place in the whole."""
        return pd.concat(self.parts)

    def whole(self) -> dict[str, Array]:
        """All rows of the switches."""
        return {
            name: np.array(union_categoricals(parts), float)
            for name, parts in self.switches.items()
        }


@dataclass
class ColumnCheck:
    """A column of a trace (or of an oven log) that comes in pieces: counted on the way, judged at the end.

    In a temperature, impossible values and spikes are counted, a dead channel and long gaps are refused; room and bath
    may stand still, with a finding. Other columns have no limits of their own.
    """

    name: str
    place: SampleLocation
    tallies: dict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    seen: int = 0
    last: float = np.nan
    low: float = np.inf
    high: float = -np.inf

    def see(self, values: Array, cleaned: Array) -> None:
        """Count what happened to the next samples (N,), as in the file and as ``clean`` left them."""
        at = self.seen
        missing = np.isnan(cleaned)
        self.seen += len(values)
        self.tallies["missing"].see(missing, values, at)
        if not self.name.endswith("_degC"):
            return
        wild = impossible(values)
        absent = np.isnan(values)
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
        name = self.name
        place = self.place
        seen = self.seen
        found = list[Finding]()
        wild, spikes, absent, gap = (
            self.tallies[key] for key in ("wild", "spikes", "absent", "missing")
        )
        if not name.endswith("_degC"):
            if gap.count > MOST_MISSING * seen:
                raise InputError(
                    f"{place.at(name, gap.first)}: {gap.value:.4g}; {100 * gap.count / seen:.0f} % of the column is "
                    "missing or impossible",
                    where=place.where,
                )
            numbers = {"count": gap.count, **place.of(gap.first)} if gap.count else {}
            return (
                [info_or_warning(gap.count / seen, "values.missing", subject=name, **numbers)]
                if gap.count
                else []
            )
        if wild.count:
            numbers = {"count": wild.count, "value": wild.value, **place.of(wild.first)}
            found.append(
                info_or_warning(wild.count / seen, "values.impossible", subject=name, **numbers)
            )
        if place.dt_s is None:
            return found
        found += self._frozen(place.dt_s)
        if spikes.count > MOST_MISSING * seen:
            raise InputError(
                f"{place.at(name, spikes.first)}: {100 * spikes.count / seen:.0f} % of the samples are spikes",
                where=place.where,
                remedy="check the slip ring and the wiring of this channel",
                column=name,
            )
        if spikes.count:
            found.append(
                info("spikes.removed", subject=name, count=spikes.count, **place.of(spikes.first))
            )
        span_s = gap.length * place.dt_s
        if span_s > max(LONGEST_NAN_S, 3 * place.dt_s) or gap.count > MOST_MISSING * seen:
            raise InputError(
                f"{place.at(name, gap.start)}: {gap.length} values in a row are missing "
                f"({span_s:.3g} s), {100 * gap.count / seen:.2g} % of the channel",
                where=place.where,
                expected=f"runs of at most {LONGEST_NAN_S} s and {100 * MOST_MISSING:.0f} % in all",
                remedy="cut the log there, or repair the channel",
                column=name,
            )
        if absent.count:
            longest = {
                "longest": absent.length,
                "longest_s": absent.length * place.dt_s,
                **place.of(absent.start),
            }
            found.append(
                info_or_warning(
                    absent.count / seen,
                    "values.absent",
                    subject=name,
                    count=absent.count,
                    **longest,
                )
            )
        return found

    def _frozen(self, dt_s: float) -> list[Finding]:
        same = self.tallies["same"]
        name = self.name
        place = self.place
        others = self.seen - 1 - same.length
        span_s = same.length * dt_s
        if self.low == self.high:
            found = warning("column.constant", subject=name, value=self.low)
            remedy = "check its wiring"
        elif span_s > FROZEN_S and same.count - same.length < 0.5 * max(others, 1):
            found = warning(
                "column.frozen",
                subject=name,
                value=same.held,
                span_s=span_s,
                **place.of(same.start),
            )
            remedy = "check its wiring, or cut the log"
        else:
            return []
        if not is_air(name):
            raise InputError(
                f"{found.sentence}: a dead channel", where=place.where, remedy=remedy, column=name
            )
        return [found]
