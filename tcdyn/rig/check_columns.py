"""Check the columns of a log: missing, impossible and frozen values, spikes, and gaps.

A column is read in chunks: statistics are collected chunk by chunk and judged at the end.

Used by :mod:`tcdyn.rig.log` and :mod:`tcdyn.rig.oven_log`. Thresholds are chosen by judgement.
Tests: ``tests/rig/test_check_columns.py`` and ``tests/rig/test_long_log_chunks.py``.
"""

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
from tcdyn.estimation.trace_noise import MAX_MISSING_FRACTION
from tcdyn.rig.columns import SWITCHES, is_air
from tcdyn.series.plausible import out_of_range

# Longest run of missing values [s] that is bridged. Chosen by judgement.
MAX_MISSING_RUN_S = 0.5
# Longest time [s] that a temperature may stay exactly the same. Chosen by judgement.
MAX_CONSTANT_S = 10.0
# Rows in one run of the decimated log (neighbours stay neighbours), and its largest size in rows,
# enough for statistics of a column. Chosen by judgement.
RUN_ROWS = 64
MAX_SAMPLE_ROWS = 1 << 15


@dataclass
class RunStatistics:
    """Marked samples of a column that comes in chunks: count, first one, longest run.

    Parameters
    ----------
    count
        Number of marked samples.
    first, value
        Index and value of the first marked sample.
    start, length, start_value
        Index of the first sample, length and first value of the longest run.
    last_run
        Start, length and first value of the last run, which may continue in the next chunk.
    """

    count: int = 0
    first: int = -1
    value: float = np.nan
    start: int = -1
    length: int = 0
    start_value: float = np.nan
    last_run: tuple[int, int, float] = (-1, 0, np.nan)

    def add(self, mask: Flags, values: Array, offset: int) -> None:
        """Count the next chunk.

        Parameters
        ----------
        mask
            Which samples are marked, (N,).
        values
            The samples as in the file, (N,).
        offset
            Index of the first sample of the chunk in the column.

        Notes
        -----
        The result does not depend on how the column is divided into chunks:
        ``tests/rig/test_check_columns.py``.
        """
        edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
        local_starts = np.flatnonzero(edges == 1)
        if not len(local_starts):
            return
        lengths = np.flatnonzero(edges == -1) - local_starts
        starts = local_starts + offset
        start_values = values[local_starts]
        if self.count == 0:
            self.first = int(starts[0])
            self.value = float(start_values[0])
        self.count += int(lengths.sum())
        last_start, last_length, last_value = self.last_run
        if starts[0] == last_start + last_length:
            starts[0] = last_start
            lengths[0] += last_length
            start_values[0] = last_value
        longest = int(np.argmax(lengths))
        if lengths[longest] > self.length:
            self.start = int(starts[longest])
            self.length = int(lengths[longest])
            self.start_value = float(start_values[longest])
        self.last_run = int(starts[-1]), int(lengths[-1]), float(start_values[-1])


@dataclass
class DecimatedLog:
    """At most ``MAX_SAMPLE_ROWS`` rows of a log in chunks: all, or every k-th run of rows.

    Switches have few different values and are stored completely.

    Notes
    -----
    When the limit is exceeded, every second run is dropped. Runs of ``RUN_ROWS`` rows keep
    neighbours together, which the noise estimate and the check of jitter need.
    """

    rows: int = 0
    every: int = 1
    chunks: list[pd.DataFrame] = field(default_factory=list)
    switches: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))

    def add(self, columns: Mapping[str, Array]) -> None:
        """Store the selected rows of the next chunk, (N,) of each column."""
        for name, values in columns.items():
            if name in SWITCHES:
                self.switches[name].append(pd.Categorical(values))
        chunk = pd.DataFrame({name: x for name, x in columns.items() if name not in SWITCHES})
        chunk.index += self.rows
        self.rows += len(chunk)
        self.chunks.append(self._thin_out(chunk))
        while sum(map(len, self.chunks)) > MAX_SAMPLE_ROWS:
            self.every *= 2
            self.chunks = [self._thin_out(chunk) for chunk in self.chunks]

    def _thin_out(self, chunk: pd.DataFrame) -> pd.DataFrame:
        """Every k-th run of rows."""
        return chunk[chunk.index // RUN_ROWS % self.every == 0]

    def frame(self) -> pd.DataFrame:
        """The stored rows; the index is the row in the log."""
        return pd.concat(self.chunks)

    def full_switches(self) -> dict[str, Array]:
        """All rows of the switches."""
        return {
            name: np.array(union_categoricals(chunks), float)
            for name, chunks in self.switches.items()
        }


@dataclass
class ColumnCheck:
    """Check one column of a log that comes in chunks: collect statistics, then judge.

    In a temperature, impossible values and spikes are counted; a dead channel and long gaps are
    errors. Room and bath temperatures may be constant, with a warning. Other columns have no limits
    of their own.
    """

    name: str
    location: SampleLocation
    statistics: dict[str, RunStatistics] = field(default_factory=lambda: defaultdict(RunStatistics))
    n_samples: int = 0
    last: float = np.nan
    low: float = np.inf
    high: float = -np.inf

    @property
    def _is_temperature(self) -> bool:
        """Whether the column is a temperature."""
        return self.name.endswith("_degC")

    def add(self, values: Array, cleaned: Array) -> None:
        """Count the next chunk.

        Parameters
        ----------
        values
            Values as in the file (N,).
        cleaned
            The same after the removal of impossible values and spikes, NaN there (N,).
        """
        offset = self.n_samples
        missing = np.isnan(cleaned)
        self.n_samples += len(values)
        self.statistics["missing"].add(missing, values, offset)
        if not self._is_temperature:
            return
        is_outside = out_of_range(values)
        absent = np.isnan(values)
        self.statistics["absent"].add(absent, values, offset)
        self.statistics["spikes"].add(missing & ~absent & ~is_outside, values, offset)
        possible = np.concatenate([[self.last], np.where(is_outside, np.nan, values)])
        self.statistics["constant"].add(np.diff(possible) == 0.0, possible[:-1], offset - 1)
        self.last = float(possible[-1])
        self.low = float(np.fmin.reduce(possible, initial=self.low))
        self.high = float(np.fmax.reduce(possible, initial=self.high))

    def judge(self) -> list[Finding]:
        """Findings about the column.

        Raises
        ------
        InputError
            A dead or frozen channel, too many spikes, and gaps that are too long or too many.
        """
        if not self._is_temperature:
            return self._check_missing()
        findings: list[Finding] = []
        dt_s = self.location.dt_s
        if dt_s is None:
            return findings
        findings += self._check_constant(dt_s)
        findings += self._check_spikes()
        findings += self._check_gaps(dt_s)
        return findings

    def _check_missing(self) -> list[Finding]:
        """Missing values of a column that is no temperature."""
        missing = self.statistics["missing"]
        share = missing.count / self.n_samples if self.n_samples else 0.0
        if missing.count > MAX_MISSING_FRACTION * self.n_samples:
            raise InputError(
                f"{self.location.at(self.name, missing.first)}: {missing.value:.4g}; "
                f"{100 * share:.0f} % of the column is missing or impossible",
                where=self.location.where,
            )
        if not missing.count:
            return []
        numbers = {"count": missing.count, **self.location.numbers_at(missing.first)}
        return [info_or_warning(share, "values.missing", subject=self.name, **numbers)]

    def _check_spikes(self) -> list[Finding]:
        """An info about removed spikes; InputError for too many."""
        spikes = self.statistics["spikes"]
        if spikes.count > MAX_MISSING_FRACTION * self.n_samples:
            percent = 100 * spikes.count / self.n_samples
            raise InputError(
                f"{self.location.at(self.name, spikes.first)}: {percent:.0f} % of the samples are "
                "spikes",
                where=self.location.where,
                remedy="check the slip ring and the wiring of this channel",
                column=self.name,
            )
        if not spikes.count:
            return []
        numbers = {"count": spikes.count, **self.location.numbers_at(spikes.first)}
        return [info("spikes.removed", subject=self.name, **numbers)]

    def _check_gaps(self, dt_s: float) -> list[Finding]:
        """A finding about missing values; InputError for a run that is too long, or for too many.

        Parameters
        ----------
        dt_s
            Sample interval [s].
        """
        missing = self.statistics["missing"]
        gap_s = missing.length * dt_s
        is_too_long = gap_s > max(MAX_MISSING_RUN_S, 3 * dt_s)
        if is_too_long or missing.count > MAX_MISSING_FRACTION * self.n_samples:
            percent = 100 * missing.count / self.n_samples
            raise InputError(
                f"{self.location.at(self.name, missing.start)}: {missing.length} values in a row "
                f"are missing ({gap_s:.3g} s), {percent:.2g} % of the channel",
                where=self.location.where,
                expected=f"runs of at most {MAX_MISSING_RUN_S} s and "
                f"{100 * MAX_MISSING_FRACTION:.0f} % in all",
                remedy="cut the log there, or repair the channel",
                column=self.name,
            )
        absent = self.statistics["absent"]
        if not absent.count:
            return []
        numbers = {
            "count": absent.count,
            "longest": absent.length,
            "longest_s": absent.length * dt_s,
            **self.location.numbers_at(absent.start),
        }
        share = absent.count / self.n_samples
        return [info_or_warning(share, "values.absent", subject=self.name, **numbers)]

    def _check_constant(self, dt_s: float) -> list[Finding]:
        """Error for a channel that is constant or frozen for a while; a warning if it measures air.

        Parameters
        ----------
        dt_s
            Sample interval [s].

        Notes
        -----
        A logger with coarse steps repeats values often; therefore a long run counts only if the
        other steps rarely repeat. Test: ``tests/rig/test_check_columns.py``.
        """
        constant = self.statistics["constant"]
        other_steps = self.n_samples - 1 - constant.length
        span_s = constant.length * dt_s
        few_other_repeats = constant.count - constant.length < 0.5 * max(other_steps, 1)
        if self.low == self.high:
            finding = warning("column.constant", subject=self.name, value=self.low)
            remedy = "check its wiring"
        elif span_s > MAX_CONSTANT_S and few_other_repeats:
            finding = warning(
                "column.frozen",
                subject=self.name,
                value=constant.start_value,
                span_s=span_s,
                **self.location.numbers_at(constant.start),
            )
            remedy = "check its wiring, or cut the log"
        else:
            return []
        if not is_air(self.name):
            raise InputError(
                f"{finding.sentence}: a dead channel",
                where=self.location.where,
                remedy=remedy,
                column=self.name,
            )
        return [finding]
