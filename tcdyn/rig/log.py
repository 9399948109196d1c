"""Read and check logs: a full log (``read_log``), or a log in chunks (``iter_log``).

Bad data is an error, or a finding, with file, column, row and time.

Used by all workflows. The order: open and match columns (:mod:`tcdyn.rig.opened_log`), walk once
for time, switches and a decimated sample, check the clock, the noise and the kind of log, then read
the chunks. ``read_log`` joins the chunks, so both give the same numbers. Tests:
``tests/rig/test_long_log_chunks.py``, ``tests/rig/test_uneven_logs.py`` and
``tests/rig/test_logger_conventions.py``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array, Flags
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import (
    Finding,
    SampleLocation,
    info,
    labelled_messages,
    unique_by_subject,
    warning,
)
from tcdyn.core.result import Result, jsonable
from tcdyn.estimation.trace_noise import SPIKES
from tcdyn.io.metadata import COMPENSATED, SIMULATED_KEY, START_TIME_KEY
from tcdyn.io.read import Table, display_path, read_all_rows, sha256_of_file
from tcdyn.io.start_time import start_time
from tcdyn.io.table import CHUNK_ROWS, Columns, SourceFile, concatenate_columns, in_chunks
from tcdyn.io.unit_names import names_temperature, unit_in, written_unit
from tcdyn.io.write import write_log
from tcdyn.rig.check_columns import MAX_MISSING_RUN_S, ColumnCheck, DecimatedLog
from tcdyn.rig.check_kind import check_kind
from tcdyn.rig.clean_columns import cleaned_column, kind_of_column, spike_noise_K
from tcdyn.rig.columns import LAYOUTS, SWITCHES, Kind, junction_columns_in
from tcdyn.rig.opened_log import (
    check_records_used,
    column_names,
    columns_to_skip,
    log_kind,
    missing_and_unused,
    open_log,
)
from tcdyn.rig.oven_log import oven_frame
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.series.clock import MIN_STRAY
from tcdyn.series.joined import files_of_log
from tcdyn.series.reading import Codes
from tcdyn.series.real_share import at_grid_times
from tcdyn.series.report import SeriesReport
from tcdyn.series.series import ColumnRows, Context, Policy, check_gaps, clock_of
from tcdyn.series.source import Source
from tcdyn.series.survey import Survey

# Longest gap [s] that is bridged, and sampling from which lags of the rig cannot be determined [s].
# Share of steps that are not one grid interval long above which there is no common rate: half a log
# at a third of the rate of the other half has more. By judgement: the log is refused, and the user
# cuts it.
RIG_POLICY = Policy(longest_gap_s=0.5, longest_interval_s=1.0, max_uneven_share=0.2)
# Slowest sampling [s] that gives no warning (20 Hz): a quarter of the lag of a rig's thermocouple.
SLOW_INTERVAL_S = 0.05
# Largest file, in rows, whose checked frame is kept in memory: 29 min at 75 Hz. Chosen by
# judgement.
MAX_ROWS_IN_MEMORY = 1 << 17
# Largest file, in values, whose columns are kept in memory, so that it is read only once: 160 MB.
# Chosen by judgement.
MAX_VALUES_IN_MEMORY = 20_000_000
__all__ = ["COMPENSATED", "Log", "LogChunk", "LogChunks", "iter_log", "read_log", "write_log"]


@dataclass(frozen=True, repr=False)
class Log(Result):
    """A checked log in canonical columns, and where it comes from.

    Parameters
    ----------
    frame
        Canonical columns at even times; temperatures as logged, before the static lines. Samples
        that were missing, impossible or spikes are NaN. Needs 8 bytes a sample and column.
    kind
        Kind of log.
    path, sha256
        The file and its checksum.
    dt_s
        Sample interval [s]; None for an oven log.
    metadata
        Entries of the header of the file.
    findings
        Findings about the data.
    reading
        What was understood of the rows; None for an oven log.
    """

    frame: pd.DataFrame
    kind: Kind
    path: Path
    sha256: str
    dt_s: float | None
    metadata: dict[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    reading: SeriesReport | None = None

    @property
    def channels(self) -> tuple[str, ...]:
        """Columns of the junctions."""
        return tuple(junction_columns_in(self.frame))

    def summary(self) -> str:
        """File, kind, length, sampling and findings."""
        text = f"{self.path.name}: {LAYOUTS[self.kind].name}, {len(self.frame)} rows"
        if self.dt_s is not None:
            text += f" at {1 / self.dt_s:.4g} Hz, {len(self.frame) * self.dt_s:.4g} s"
        text += f", {len(self.channels)} thermocouples"
        return "\n".join([text, *labelled_messages(self.findings)])

    def to_dict(self) -> dict[str, Any]:
        """Origin of the log and range of every column; the samples are in ``frame``."""
        return {
            "file": self.path.name,
            "sha256": self.sha256,
            "kind": self.kind,
            "rows": len(self.frame),
            "dt_s": self.dt_s,
            "metadata": dict(self.metadata),
            "columns": {row.pop("column"): row for row in jsonable(self.card())},
            "warnings": list(self.warnings),
        }

    def to_frame(self) -> pd.DataFrame:
        """The samples, over the time where the log has one."""
        return self.frame.set_index("time_s") if "time_s" in self.frame else self.frame

    def card(self) -> pd.DataFrame:
        """Minimum, median, maximum and number of missing values of every column."""
        frame = self.frame
        return pd.DataFrame(
            {
                "column": frame.columns,
                "min": frame.min().to_numpy(),
                "median": frame.median().to_numpy(),
                "max": frame.max().to_numpy(),
                "missing": frame.isna().sum().to_numpy(),
            }
        )

    def interpolate_missing(self) -> pd.DataFrame:
        """The frame with missing samples linearly interpolated."""
        if not self.frame.isna().to_numpy().any():
            return self.frame
        return self.frame.interpolate(method="linear", limit_direction="both")


def simulated_findings(log: Log) -> list[Finding]:
    """An info if the metadata of the log say that it is simulated."""
    if SIMULATED_KEY in log.metadata:
        return [info("log.simulated", subject=log.path.name)]
    return []


@dataclass(frozen=True)
class Sampling:
    """Times of a log and their even grid.

    Parameters
    ----------
    time_s
        Time of each row, (N,) [s].
    dt_s
        Sample interval [s].
    grid
        Index of each row on the even grid, (N,). Several rows may share one.
    late_s
        How much later than its grid time each sample was taken, (N,) [s]; None where the stamps do
        not stray.
    """

    time_s: Array
    dt_s: float
    grid: NDArray[np.int32]
    late_s: Array | None = None

    def at_even_times(self, name: str, values: Array, rows: slice) -> Array:
        """Temperatures at the even times; other columns come back unchanged.

        Parameters
        ----------
        name
            Name of the column.
        values
            Samples of the column at ``rows``, (N,).
        rows
            Rows of the file that ``values`` hold.
        """
        if self.late_s is None or not name.endswith("_degC"):
            return values
        return at_grid_times(values, self.time_s[rows], self.late_s[rows])


def _context(source: Source) -> Context:
    """Where the rows of a log come from, and what is tolerated in them."""
    table = source.table
    return Context(table.where, source.time, source.options, policy=RIG_POLICY, table=table)


def _column_rows(
    names: Mapping[str, str], units: Mapping[str, str], raw: Mapping[str, Any]
) -> list[ColumnRows]:
    """The columns of some rows of a log, by their names in the file; switches are left out.

    ``units`` is the row of units of the file. Temperatures are in degrees Celsius already.
    """
    columns: dict[str, ColumnRows] = {}  # one column of the file may have several names
    for name, column in names.items():
        if name == "time_s" or name in SWITCHES or column in columns:
            continue
        kind = kind_of_column(name)
        unit = unit_in(column) or written_unit(units.get(column, ""))
        if not unit and names_temperature(column):
            unit = "degC"
        columns[column] = ColumnRows(column, unit, kind, raw[column])
    return list(columns.values())


def _sampling(
    stamps_s: Array, context: Context, report: SeriesReport | None
) -> tuple[Sampling, list[Finding]]:
    """Times of a log and their even grid, and findings about them.

    Stamps that stray by more than ``MIN_STRAY``, or are rounded (0.013, 0.027, 0.040 at 75 Hz), are
    replaced by the times of the grid.

    Raises
    ------
    InputError
        Time runs backward, a gap above 0.5 s, uneven sampling, or too few rows.
    """
    time_s, clock, findings = clock_of(stamps_s, context)
    check_gaps(time_s, clock, context)
    dt_s = clock.interval_s
    if dt_s > SLOW_INTERVAL_S:
        findings.append(
            warning("time.slow", subject=context.time, rate_Hz=1 / dt_s, lost_s=2 * dt_s)
        )
    late_s = None
    if clock.strays and report is not None:
        late_s = report.real_share * clock.jitter_s
    if clock.stray_s > MIN_STRAY * dt_s:
        time_s = clock.even_s
    return Sampling(time_s, dt_s, clock.index.astype(np.int32), late_s), findings


@dataclass(frozen=True)
class LogChunk:
    """A chunk of a log.

    Parameters
    ----------
    frame
        Canonical columns of the chunk.
    first
        Row of the full log at which the chunk starts.
    findings
        Of the complete walk, with the last chunk only; ``LogChunks.findings`` holds the others.
    """

    frame: pd.DataFrame
    first: int
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class LogChunks:
    """A log that is read in chunks, as often as needed, in memory that does not grow with the log.

    ``iter_log`` has read the file once: ``switches`` (N,) hold all rows of the file, ``findings``
    what that first walk showed. Each further walk checks the chunks. Errors that depend on the
    complete column (a frozen channel, too many missing samples or spikes) are raised before the
    last chunk,
    so results made from the other chunks are valid only after the last one. ::

        log = iter_log("B3.csv", "ehl", rig)
        for piece in log:                     # piece.frame holds these rows of read_log's frame
            compensated.append(state.advance(piece.frame))

    Notes
    -----
    Iteration must give the same rows for any size of chunk; ``tests/rig/test_long_log_chunks.py``.
    """

    path: Path
    sha256: str
    kind: Kind
    metadata: dict[str, str]
    sampling: Sampling
    switches: Mapping[str, Flags]
    findings: tuple[Finding, ...]
    _table: Table = field(repr=False)
    _names: Mapping[str, str] = field(repr=False)
    _noise_K: Mapping[str, float] = field(repr=False)
    _location: SampleLocation = field(repr=False)
    _chunk_rows: int = field(repr=False)
    _log: Log | None = field(repr=False, default=None)  # of a file that is kept in memory
    reading: SeriesReport | None = None
    _codes: Mapping[str, Codes] = field(repr=False, default_factory=dict)

    @property
    def dt_s(self) -> float:
        """Sample interval [s]."""
        return self.sampling.dt_s

    @property
    def sources(self) -> tuple[SourceFile, ...]:
        """The files, where the log has several."""
        return self._table.sources

    @property
    def rows(self) -> int:
        """Number of rows of all chunks together."""
        return int(self.sampling.grid[-1]) + 1

    def __iter__(self) -> Iterator[LogChunk]:
        """Yield the chunks in time order; InputError before the last one for a column that fails.

        Notes
        -----
        A chunk ends ``margin`` rows before the last row that was read. The margin is the longest
        spike times the longest gap, because a spike is judged by its neighbours, each of which may
        lie behind a gap. Neighbouring rows stay in one chunk where they share an index of the grid.
        """
        where = self._location.where
        grid = self.sampling.grid
        total = len(grid)
        checks = {name: ColumnCheck(name, self._location) for name in self._noise_K}
        # spikes are judged by their neighbours, each of which may lie behind a gap
        max_spike = SPIKES["reading"].longest
        max_gap = int(max(MAX_MISSING_RUN_S / self.dt_s, max_spike) + 1)
        margin = max_spike * (max_gap + 1)
        stored: dict[str, Array] = {}
        start = 0  # row of the file of the first stored sample
        done = 0  # rows of the file that were returned
        file_columns = list(dict.fromkeys(self._names.values()))
        for raw in self._table.chunks(file_columns, self._chunk_rows):
            new = {name: raw.data[self._names[name]] for name in checks}
            if stored:
                new = {name: np.concatenate([stored[name], x]) for name, x in new.items()}
            stored = new
            end = start + len(next(iter(stored.values())))
            if end > total:
                break
            stop = end
            if end < total:
                stop = int(np.searchsorted(grid, grid[max(end - margin, 0)]))
            if stop == done or (stop - done < margin and end < total):
                continue
            inside = slice(done - start, stop - start)
            columns: dict[str, Array] = {}
            for name, check in checks.items():
                codes = self._codes.get(self._names[name])
                cleaned = cleaned_column(name, stored[name], self._noise_K[name], codes)
                check.add(stored[name][inside], cleaned[inside])
                resampled = self.sampling.at_even_times(name, cleaned, slice(start, end))
                columns[name] = resampled[inside]
            findings: list[Finding] = []
            if stop == total:
                for check in checks.values():
                    findings += check.judge()
            frame = self._on_even_grid(columns, done, stop)
            yield LogChunk(frame, int(grid[done]), tuple(f.at(where) for f in findings))
            done = stop
            first_needed = max(stop - margin - start, 0)
            stored = {name: values[first_needed:].copy() for name, values in stored.items()}
            start += first_needed
        if done != total:
            raise InputError("the file changed while it was read", where=where)

    def _on_even_grid(self, columns: dict[str, Array], start: int, stop: int) -> pd.DataFrame:
        """Rows ``start`` to ``stop`` of the file on the even grid, up to the next row of the file.

        Inserted samples are NaN; a switch keeps its state in them.

        Parameters
        ----------
        columns
            Cleaned columns of these rows (N,).
        start, stop
            Rows of the file.

        Returns
        -------
        frame
            One row for each index of the grid.
        """
        grid = self.sampling.grid
        switches = {name: on[start:stop].astype(np.float64) for name, on in self.switches.items()}
        indices = grid[start : stop + 1]
        end_index = grid[stop] if stop < len(grid) else self.rows
        even = np.arange(indices[0], end_index)
        names = [name for name in self._names if name != "time_s"]
        frame = pd.DataFrame(columns | switches, indices[: stop - start], names)
        if not frame.index.is_unique:
            frame = frame.groupby(level=0).mean()
        frame = frame.reindex(even)
        frame = frame.assign(**frame[[*switches]].ffill()).reset_index(drop=True)
        time_s = np.interp(even, indices, self.sampling.time_s[start : stop + 1])
        frame.insert(0, "time_s", time_s)
        return frame

    def time_stamps(self) -> tuple[str, NDArray[Any]] | None:
        """The column of clock stamps as it is in the file.

        Returns
        -------
        name
            Name of the column in the file.
        cells
            Text (N,) for each row of the even grid, empty where the file has no row. Where several
            rows of the file are one of the grid, that of the first.
        None
            If the time is numbers.
        """
        name = self._names["time_s"]
        cells: list[NDArray[Any]] = []
        for chunk in self._table.chunks([name], self._chunk_rows):
            if not len(chunk.data[name]):  # findings only
                continue
            if name not in chunk.stamps:
                return None
            cells.append(chunk.stamps[name])
        on_grid = np.full(self.rows, "", dtype=object)
        on_grid[self.sampling.grid[::-1]] = np.concatenate(cells)[::-1]
        return name, on_grid

    def to_log(
        self, rows: NDArray[np.intp] | None = None, columns: Collection[str] | None = None
    ) -> Log:
        """Join the chunks to one log. All rows are checked; needs 8 bytes a value that is kept.

        Parameters
        ----------
        rows
            Rows to keep, ascending; all by default.
        columns
            Columns to keep; all by default.

        Returns
        -------
        log
            The joined log with its checksum.

        Raises
        ------
        InputError
            As iteration does.
        """
        if self._log is not None and rows is None and columns is None:
            return replace(self._log, frame=self._log.frame.copy(deep=False))
        source = self if columns is None else self._with_columns(columns)
        selected = np.arange(self.rows) if rows is None else rows
        frame: dict[str, Array] = {}
        findings = self.findings
        for chunk in source:
            end = chunk.first + len(chunk.frame)
            first, stop = np.searchsorted(selected, [chunk.first, end])
            for name in map(str, chunk.frame):
                column = frame.setdefault(name, np.empty(len(selected)))
                values = chunk.frame[name].to_numpy()
                column[first:stop] = values[selected[first:stop] - chunk.first]
            findings += chunk.findings
        return Log(
            pd.DataFrame(frame, copy=False),
            self.kind,
            self.path,
            self.sha256,
            self.dt_s,
            self.metadata,
            findings,
            self.reading,
        )

    def _with_columns(self, columns: Collection[str]) -> LogChunks:
        """The log with some columns, and the two that are needed to divide it into chunks."""
        names = {"time_s", next(iter(self._noise_K)), *columns}
        return replace(
            self,
            _names={k: x for k, x in self._names.items() if k in names},
            _noise_K={k: x for k, x in self._noise_K.items() if k in names},
            switches={k: x for k, x in self.switches.items() if k in names},
        )


@with_named_arguments
def iter_log(
    path: str | Path | Sequence[str | Path],
    kind: Kind,
    rig: Rig | None = None,
    disk: str | None = None,
    *,
    rows: int = CHUNK_ROWS,
    allow_compensated: bool = False,
    needs_unloading: bool = True,
    without: Collection[str] = (),
) -> LogChunks:
    """Open a log that is read in chunks, in time order; joined, they are the frame of ``read_log``.

    The file is read once here. This first walk stores its time and switches, and of the other
    columns a sample of at most 32768 rows, every k-th run of 64 rows. Sampling, switches, entry or
    unloading, units, loads, swapped and dead channels are checked with them. A file of more than
    ``MAX_VALUES_IN_MEMORY`` values is read again with each walk over the chunks.

    Parameters
    ----------
    path
        The file, or several files of one log in any order.
    kind
        "immersion", "ehl" or "hole".
    rig
        The rig, by default the one of the thesis.
    disk
        Disk whose ``[columns]`` are used.
    rows
        Approximate rows of a chunk.
    allow_compensated
        Accept a log that was compensated already.
    needs_unloading
        Whether an EHL log must contain the unloading.
    without
        Columns that are not read.

    Returns
    -------
    chunks
        The log; iterate it for the chunks.

    Raises
    ------
    InputError
        As ``read_log`` does; for an oven log, which is always short.

    Notes
    -----
    CSV (chunks of at most 2 MB of text), Parquet and TDMS need memory for some chunks and 45 bytes
    for each row of the file, 280 MB for a gigabyte. LVM, UTF-16 text and TDMS channels that differ
    in start or rate are read at once.

    ``MAX_ROWS_IN_MEMORY`` decides whether a file is read once or twice; no result depends on it.

    Examples
    --------
    >>> from tcdyn import load_rig  # doctest: +SKIP
    >>> log = iter_log("EHL_B3.csv", "ehl", load_rig("rig.toml"))  # doctest: +SKIP
    >>> sum(len(chunk.frame) for chunk in log) == log.rows  # doctest: +SKIP
    True
    """
    if kind == "oven":
        raise InputError(
            "oven logs are read whole", expected="immersion, ehl or hole", remedy="use read_log"
        )
    rig_or_default = rig or load_rig()
    files = files_of_log(path)
    source, names = open_log(
        files, kind, rig, disk, allow_compensated=allow_compensated, without=without
    )
    table = source.table
    chunks: list[Columns] = []  # of a short file, which is then read only once
    stamps = bytearray()  # grows in place; a list of arrays would need all of it twice
    findings: list[Finding] = []
    decimated = DecimatedLog()
    location = SampleLocation(table.where)
    metadata = dict(table.metadata)
    survey = Survey(partial(_column_rows, names, table.units), _context(source))
    for time_s, chunk in source.timed_chunks(list(dict.fromkeys(names.values())), rows):
        if not stamps:
            start = start_time(chunk.stamps, names["time_s"], chunk.data[names["time_s"]])
            metadata |= {START_TIME_KEY: start} if start else {}
        location = chunk.location
        findings += chunk.findings
        stamps += time_s.tobytes()
        raw = {column: chunk.data[column] for column in names.values()}
        survey.add(time_s, raw, chunk.findings)
        decimated.add({n: chunk.data[names[n]] for n in names if n != "time_s"})
        chunks.append(chunk)
        if decimated.rows * len(names) > MAX_VALUES_IN_MEMORY:
            chunks.clear()
    if not decimated.rows:
        raise InputError("no rows", where=table.where)
    report = survey.report()
    sampling, clock_findings = _sampling(np.frombuffer(stamps), survey.context, report)
    del stamps
    location = replace(location, time_s=sampling.time_s, dt_s=sampling.dt_s)
    sample = decimated.frame()
    sample_rows = sample.index.to_numpy()
    noise_K: dict[str, float] = {}
    for name in names:
        if name == "time_s" or name in SWITCHES:
            continue
        values = sample[name].to_numpy()
        noise_K[name] = spike_noise_K(name, values, sample_rows, location)
        codes = survey.codes.get(names[name])
        sample[name] = cleaned_column(name, values, noise_K[name], codes)
    switches, kind_findings = check_kind(
        kind,
        sample,
        decimated.full_switches(),
        location,
        rig_or_default,
        disk,
        needs_unloading=needs_unloading,
    )
    row_findings = unique_by_subject([*clock_findings, *survey.findings])
    findings = [*row_findings, *findings, *kind_findings]
    findings += missing_and_unused(kind, table, names, without)
    if chunks:
        stored = concatenate_columns(chunks, [*chunks[0].data], location)
        table = replace(table, chunks=partial(in_chunks, stored))
        chunks.clear()
    log = LogChunks(
        files[0],
        _checksum(files),
        kind,
        metadata,
        sampling,
        switches,
        tuple(finding.at(table.where) for finding in findings),
        table,
        names,
        noise_K,
        location,
        rows,
        reading=report,
        _codes=survey.codes,
    )
    if decimated.rows <= MAX_ROWS_IN_MEMORY:
        with suppress(InputError):  # raised again when the caller iterates
            log = replace(log, _log=log.to_log())
    return log


def _checksum(files: Sequence[Path]) -> str:
    """SHA-256 of a file; of several files that of their checksums in hexadecimal digits."""
    checksums = [sha256_of_file(file) for file in files]
    if len(checksums) == 1:
        return checksums[0]
    return hashlib.sha256("".join(checksums).encode()).hexdigest()


def open_log_for_records(
    log: str | Path | Sequence[str | Path], rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[LogChunks, list[str]]:
    """Open the EHL or immersion log that ``records`` are for.

    Parameters
    ----------
    log
        The file, or several files of one log.
    rig
        The rig.
    records
        Records by disk.

    Returns
    -------
    The log, and the missing columns that only the fit of the unloading would use.

    Raises
    ------
    InputError
        As ``iter_log`` does, and for records of a disk that the log does not hold.
    """
    where = display_path(files_of_log(log)[0])
    names = column_names(log, rig, next(iter(records)))
    kind, disk = log_kind(names, rig, records, where)
    skipped: list[str] = []
    unused: list[str] = []
    if kind == "ehl":
        check_records_used(names, rig, records, where)
        skipped, unused = columns_to_skip(names, rig, records)
    return iter_log(log, kind, rig, disk, needs_unloading=False, without=skipped), unused


@with_named_arguments
def read_log(
    path: str | Path,
    kind: Kind,
    rig: Rig | None = None,
    disk: str | None = None,
    *,
    allow_compensated: bool = False,
    needs_unloading: bool = True,
    without: Collection[str] = (),
) -> Log:
    """Read a log and check it.

    The format follows from the file: CSV in its dialects, LVM, TDMS, Parquet, .xlsx and .mat. Row
    numbers in messages are lines of the file.

    Parameters
    ----------
    path
        The file.
    kind
        "oven", "immersion", "ehl" or "hole".
    rig
        The rig; its ``[columns]`` map the names of columns, those of ``disk`` where it is given.
    disk
        Disk whose ``[columns]`` are used.
    allow_compensated
        Accept a log that was compensated already.
    needs_unloading
        Whether an EHL log must contain the unloading.
    without
        Columns that are not read.

    Returns
    -------
    log
        The checked log.

    Raises
    ------
    InputError
        Bad input (section 8 of the design) that cannot be reported as a finding.

    Examples
    --------
    >>> import tempfile
    >>> from tcdyn.io.write import write_log
    >>> rows = pd.DataFrame({"repeat": 1, "setpoint_degC": [40.0] * 3 + [80.0] * 3})
    >>> rows["prt_degC"] = rows["setpoint_degC"]
    >>> for c in "abcdef":
    ...     rows[f"{c}_degC"] = rows["prt_degC"] + 0.2
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = read_log(write_log(rows, Path(folder) / "oven.csv"), "oven")
    >>> log.frame.shape
    (6, 9)
    """
    file = Path(path)
    if kind != "oven":
        log = iter_log(
            file,
            kind,
            rig,
            disk,
            allow_compensated=allow_compensated,
            needs_unloading=needs_unloading,
            without=without,
        )
        return log.to_log()
    source, names = open_log(file, kind, rig, disk, allow_compensated=allow_compensated)
    table = source.table
    raw = read_all_rows(table, list(dict.fromkeys(names.values())))
    columns = {canonical: raw.data[name] for canonical, name in names.items()}
    if "time_s" in columns:
        is_clock = names["time_s"] in raw.stamps
        columns["time_s"] = source.clock.in_seconds(columns["time_s"], is_clock)
    frame, findings = oven_frame(columns, raw.location)
    findings = [*raw.findings, *findings, *missing_and_unused(kind, table, names)]
    located = tuple(finding.at(table.where) for finding in findings)
    return Log(frame, kind, file, sha256_of_file(file), None, dict(table.metadata), located)
