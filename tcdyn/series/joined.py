"""Several files of one log as one table, in the order of their times and in bounded memory.

Loggers begin a file each day, or each so many rows. :func:`open_files` is where a log of one file
or several is opened; each file is read by its own reader, so that separators, decimal marks and
units may differ. The time between two files is a gap as any other. Tests:
``tests/series/test_joined.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.findings import Finding, SampleLocation, info, warning
from tcdyn.io.clock_numbers import DATED_UNITS
from tcdyn.io.metadata import SIMULATED_KEY, START_TIME_KEY, check_not_compensated
from tcdyn.io.read import Part, Table, display_path, open_table, sha256_of_file
from tcdyn.io.stamps import SECONDS_PER_HOUR, instants, is_time_of_day
from tcdyn.io.table import CHUNK_ROWS, Columns, SourceFile, concatenate_columns
from tcdyn.io.times import EARLIEST_EPOCH_S, TimeColumn, find_time_column, split_unit
from tcdyn.io.unit_names import TEMPERATURES, is_same_name, unit_in, written_unit
from tcdyn.series.options import ReadingOptions
from tcdyn.series.units import convert_temperature

# Rows in which the columns of text of a file are found; the reader decides by all rows. Memory.
FIRST_ROWS = 1000
# Difference of two times [s] below which a file begins at the last row of the one before, as some
# loggers repeat it. Stamps have microseconds.
SAME_INSTANT_S = 1e-6

# What tells the order of the files, and the time between them.
ClockKind = Literal["dates", "dates with zone", "epoch", "start time", "counter", "times of day"]
KIND_TEXTS: dict[ClockKind, str] = {
    "dates": "time stamps with a date",
    "dates with zone": "time stamps with a date and a zone",
    "epoch": "times since a fixed date",
    "start time": "times with a start time in the metadata",
    "counter": "times without a date",
    "times of day": "times of the day without a date",
}
Conversion = Callable[[Array], Array]


@dataclass(frozen=True)
class _File:
    """What is known of one file before the rows are read.

    Attributes
    ----------
    path, part_of_file
        The file, and which part of it is the table.
    names, units, metadata
        Of its table.
    clock
        Its time column.
    date_column
        Column with the dates of its times of day; empty where there is none.
    kind
        What its times tell.
    first, last
        First and last time, as in the file or in seconds since its first stamp.
    cells
        First and last stamp, with its date; empty where times are numbers.
    text
        Columns of text.
    filled
        Columns with numbers in the first rows.
    rows
        Number of rows.
    """

    path: Path
    part_of_file: Part
    names: tuple[str, ...]
    units: Mapping[str, str]
    metadata: Mapping[str, str]
    clock: TimeColumn
    date_column: str
    kind: ClockKind
    first: float
    last: float
    cells: tuple[str, str]
    text: frozenset[str]
    filled: frozenset[str]
    rows: int

    @property
    def name(self) -> str:
        """Its name for messages."""
        return utf8(self.path.name)

    @property
    def unit_s(self) -> float:
        """Seconds per unit of its times; 1 for stamps, which are read as seconds."""
        is_numeric = not self.cells[0] and not self.clock.clock_unit
        return (self.clock.seconds or 1.0) if is_numeric else 1.0

    def unit(self, column: str) -> str:
        """Unit of a column, by its name or the row of units."""
        of_row = self.units.get(column, "")
        return unit_in(column) or written_unit(of_row) or of_row


@dataclass(frozen=True)
class _Part:
    """A file in its place in the log.

    Attributes
    ----------
    file
        The file.
    start_s, end_s
        First and last time on the clock of all files [s].
    offset, scale
        What its times are multiplied with, and what is added then.
    columns
        Its column by column of the log.
    conversions
        Conversions of its columns to the units of the log, by column of the log.
    """

    file: _File
    start_s: float
    end_s: float
    offset: float = 0.0
    scale: float = 1.0
    columns: Mapping[str, str] | None = None
    conversions: Mapping[str, Conversion] | None = None


@dataclass(frozen=True)
class JoinedLocation(SampleLocation):
    """Location of samples in several files.

    Attributes
    ----------
    files
        Location in each file.
    first_samples
        Index of the first sample of each.
    """

    files: tuple[SampleLocation, ...] = ()
    first_samples: tuple[int, ...] = ()

    def _place(self, index: int) -> tuple[SampleLocation, int]:
        """The file of a sample, and the index of the sample in it."""
        k = int(np.searchsorted(self.first_samples, index, "right")) - 1
        return self.files[k], int(index) - self.first_samples[k]

    def row(self, index: int) -> int:
        """Line of a sample in its file, counted from 1."""
        location, index_in_file = self._place(index)
        return location.row(index_in_file)

    def numbers_at(self, index: int) -> dict[str, Any]:
        """File, row in it and, where known, time of a sample, for the numbers of a finding."""
        return {**super().numbers_at(index), "file": self._place(index)[0].where}

    def at(self, column: str, index: int) -> str:
        """Column, file, row in it and time of a sample as text for an error message."""
        return f"{self._place(index)[0].where}: {super().at(column, index)}"


def files_of_log(data: object) -> list[Path]:
    """The files of a log that is given as one path or a sequence of them; none for other data.

    >>> files_of_log("a.csv"), files_of_log(["a.csv", "b.csv"])[1:], files_of_log((1.0, 2.0))
    ([PosixPath('a.csv')], [PosixPath('b.csv')], [])
    """
    if isinstance(data, str | Path):
        return [Path(data)]
    if not isinstance(data, Sequence) or not all(isinstance(each, str | Path) for each in data):
        return []
    return [Path(each) for each in data]


def open_files(
    paths: str | Path | Sequence[str | Path],
    known: Collection[str] = (),
    options: ReadingOptions | None = None,
    *,
    allow_compensated: bool = False,
) -> Table:
    """Open one file, or several files of one log as one table.

    Parameters
    ----------
    paths
        The file or files, in any order.
    known
        Column names that the header may contain.
    options
        How the rows are read.
    allow_compensated
        Accept tables that are compensated already.

    Returns
    -------
    Table
        That of the file; or one with the rows of all files in the order of their times. ``sources``
        are the files. Columns have the names and units of the first one. Numbers of time go on from
        its clock, time stamps are as each file writes them.

    Raises
    ------
    InputError
        For files with other columns or units, another kind of clock, times that do not tell the
        order of the files, and files that overlap in time.

    Notes
    -----
    Columns are found by their names, whatever their order. Temperatures in degC, K and degF are
    converted to the unit of the first file; other units must be the same. The order of the files is
    told by dates, by a start time in the metadata, or by times that go on from one file to the
    next. Before the first row is returned, the times of all files are read once.
    """
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    if not files:
        raise InputError("no files", expected="at least one")
    options = options or ReadingOptions()
    part = Part(options.sheet, options.variable)
    if len(files) == 1:
        return open_table(files[0], known, part)
    if options.dt_s is not None and options.time is None:
        raise InputError(
            "{dt_s} with several files: the time between them is not known",
            expected="files with times",
            remedy="join the files yourself, or treat each on its own ({each})",
            parameters={"dt_s": None, "each": True},
        )
    looks = [_look_at(Path(path), known, options, allow_compensated) for path in files]
    where = _name_of(looks)
    parts, first_day = _in_order(looks, where)
    first = parts[0].file
    parts = [_with_columns(part, first) for part in parts]
    rows = np.cumsum([0, *(part.file.rows for part in parts)]).tolist()
    sources = tuple(
        SourceFile(part.file.path, sha256_of_file(part.file.path), 1 + row, part.file.rows)
        for part, row in zip(parts, rows)
    )
    text = _text_columns(parts)
    findings = _findings(parts, text)
    iso = _iso_stamps(parts, first_day) if _have_several_forms(parts) else None
    if iso is not None:
        findings[0].append(info("files.stamps", subject=first.clock.name))
    sample = open_table(first.path, known, part)
    metadata = {
        key: value
        for key, value in first.metadata.items()
        if all(look.metadata.get(key) == value for look in looks)
    }
    for look in looks:
        if SIMULATED_KEY in look.metadata:
            metadata.setdefault(SIMULATED_KEY, look.metadata[SIMULATED_KEY])
    if START_TIME_KEY in first.metadata:
        metadata[START_TIME_KEY] = first.metadata[START_TIME_KEY]
    # a plain table: the reader of labels of a text file would see the rows of the first file only
    return Table(
        where,
        first.names,
        metadata,
        partial(_chunks, parts, tuple(known), text, findings, iso, where),
        units=sample.units,
        clock_columns=sample.clock_columns,
        types={} if iso else sample.types,
        date_columns=sample.date_columns,
        sources=sources,
    )


def _name_of(looks: Sequence[_File]) -> str:
    """Name of the log for messages."""
    return f"{looks[0].name} and {len(looks) - 1} more file{'s' if len(looks) > 2 else ''}"


def _look_at(
    path: Path, known: Collection[str], options: ReadingOptions, allow_compensated: bool
) -> _File:
    """Read the times of a file, and its first rows; parameters as for ``open_files``."""
    part_of_file = Part(options.sheet, options.variable)
    table = open_table(path, known, part_of_file)
    if not allow_compensated:
        check_not_compensated(table.names, table.metadata, table.where)
    clock = find_time_column(
        table.names,
        table.where,
        requested=_requested_time(table, options.time),
        unit=options.time_unit,
        unit_row=table.units,
        clock_columns=table.clock_columns,
    )
    head = _first_chunk(table, list(dict.fromkeys(table.names)))
    text = frozenset(name for name in head.stamps if name != clock.name)
    filled = frozenset(name for name, x in head.data.items() if np.isfinite(x).any())
    is_clock = clock.name in head.stamps
    date_column = ""
    if is_clock and is_time_of_day(str(head.stamps[clock.name][0])):
        in_file = [name for name in table.date_columns if name != clock.name]
        date_column = in_file[0] if len(in_file) == 1 else ""
    if not is_clock:
        clock = clock.recognised(head.data[clock.name], is_clock)
    names = [clock.name, *filter(None, [date_column])]
    rows = 0
    ends: list[float] = []
    cells: list[str] = []
    for chunk in table.chunks(names, CHUNK_ROWS):
        values = chunk.data[clock.name]
        rows += len(values)
        finite = np.flatnonzero(np.isfinite(values))
        if not len(finite):
            continue
        for k in (finite[0], finite[-1]):
            ends.append(float(values[k]))
            if is_clock:
                cells.append(_dated_cell(chunk, clock.name, date_column, int(k)))
    if not ends:
        raise InputError(f"column {clock.name}: no times", where=table.where)
    outer = (cells[0], cells[-1]) if is_clock else ("", "")
    start = table.metadata.get(START_TIME_KEY, "")
    kind = _kind_of(clock, ends[0], outer[0], start, table.where)
    return _File(
        path,
        part_of_file,
        table.names,
        table.units,
        table.metadata,
        clock,
        date_column,
        kind,
        ends[0],
        ends[-1],
        outer,
        text,
        filled,
        rows,
    )


def _requested_time(table: Table, time: str | None) -> str | None:
    """The time column that is named, or the one of this name with another unit."""
    if time is None or time in table.names:
        return time
    stem = split_unit(time)[0]
    same = [name for name in table.names if split_unit(name)[0] == stem]
    return same[0] if len(same) == 1 else time


def _first_chunk(table: Table, names: Sequence[str]) -> Columns:
    """The first rows of a table."""
    chunks = table.chunks(names, FIRST_ROWS)
    try:
        return next(iter(chunks))
    except StopIteration:
        raise InputError("no rows below the header", where=table.where) from None
    finally:
        if isinstance(chunks, Generator):
            chunks.close()


def _dated_cell(chunk: Columns, time: str, date_column: str, row: int) -> str:
    """The stamp of a row of a chunk, with the date of another column."""
    cell = str(chunk.stamps[time][row]).strip()
    if not date_column:
        return cell
    days = [str(day) for day in chunk.stamps[date_column][: row + 1] if str(day)]
    return f"{days[-1]} {cell}" if days else cell


def _kind_of(clock: TimeColumn, first: float, cell: str, start: str, where: str) -> ClockKind:
    """What the times of a file tell of their place in the log.

    Parameters
    ----------
    clock
        The time column.
    first
        Its first number.
    cell
        Its first stamp; empty where times are numbers.
    start
        Start time in the metadata; empty where there is none.
    where
        The file, for messages.
    """
    if cell:
        if not is_time_of_day(cell):
            return "dates with zone" if instants([cell], clock.name, where)[2][0] else "dates"
        return "start time" if start else "times of day"
    if clock.clock_unit:
        return "epoch" if clock.clock_unit.lower() in DATED_UNITS else "times of day"
    first_s = float(clock.in_seconds(np.array([first]), False)[0])
    if first_s >= EARLIEST_EPOCH_S:
        return "epoch"
    return "start time" if start else "counter"


def _in_order(looks: Sequence[_File], where: str) -> tuple[list[_Part], date | None]:
    """The files in the order of their times, and the date of the first stamp of the first given.

    Raises
    ------
    InputError
        For clocks of several kinds, times that do not tell the order, and files that overlap.
    """
    first = looks[0]
    for look in looks[1:]:
        if look.kind != first.kind or look.clock.clock_unit != first.clock.clock_unit:
            raise InputError(
                f"{first.name} has {KIND_TEXTS[first.kind]}, and {look.name} has "
                f"{KIND_TEXTS[look.kind]}",
                where=where,
                expected="one kind of clock in all files of a log",
                remedy=EACH,
                parameters={"each": True},
            )
    if first.kind == "times of day":
        raise InputError(
            f"{first.name} and the others have times of the day without a date, as "
            f"{first.cells[0] or first.clock.clock_unit}: nothing states the day of each file",
            where=where,
            expected="dates in the files, or start_time in the metadata of each",
            remedy=f"log the date too; or {EACH}",
            parameters={"each": True},
        )
    day = None
    if first.kind in ("dates", "dates with zone"):
        day, parts = _by_dates(looks, where)
    elif first.kind == "start time":
        parts = _by_start_times(looks, where)
    else:
        parts = [_Part(x, x.first * x.unit_s, x.last * x.unit_s) for x in looks]
        parts = sorted(parts, key=lambda part: (part.start_s, part.end_s))
    for before, after in pairwise(parts):
        if after.start_s < before.end_s - SAME_INSTANT_S:
            raise _overlap(before, after, where)
    unit_s = parts[0].file.unit_s
    origin = parts[0].file.first
    placed = []
    for part in parts:
        scale = part.file.unit_s / unit_s
        offset = 0.0
        if first.kind not in ("epoch", "counter"):
            since_first_s = round(part.start_s - parts[0].start_s, 9)
            offset = origin - scale * part.file.first + since_first_s / unit_s
        placed.append(replace(part, scale=scale, offset=offset))
    return placed, day


EACH = "treat each file on its own ({each}) if they are no parts of one log"


def _by_dates(looks: Sequence[_File], where: str) -> tuple[date, list[_Part]]:
    """The files by the dates of their stamps; the date of the first stamp of the first given.

    A local clock that changed within a file, to or from daylight saving time, goes on without the
    change in the files after it.
    """
    cells = [cell for look in looks for cell in look.cells]
    day, instants_s, _ = instants(cells, looks[0].clock.name, where)
    ends = sorted(
        zip(instants_s[::2].tolist(), instants_s[1::2].tolist(), looks), key=lambda end: end[:2]
    )
    change_s = 0.0
    parts = []
    for first_s, last_s, look in ends:
        zero_s = first_s + change_s
        parts.append(_Part(look, zero_s + look.first, zero_s + look.last))
        if look.kind == "dates":
            # in hours: milliseconds may stand in another column than the stamps
            change_s = SECONDS_PER_HOUR * round((zero_s + look.last - last_s) / SECONDS_PER_HOUR)
    return day, parts


def _by_start_times(looks: Sequence[_File], where: str) -> list[_Part]:
    """The files by the start times in their metadata, which are those of their first rows."""
    starts = []
    for look in looks:
        text = look.metadata[START_TIME_KEY]
        start = pd.to_datetime(text, errors="coerce")
        if pd.isna(start):
            raise InputError(
                f"{START_TIME_KEY} in the metadata is {text!r}",
                where=look.name,
                expected="a date and time such as 2026-03-01T10:00:00",
            )
        starts.append(start)
    if len({start.tzinfo is None for start in starts}) > 1:
        raise InputError(
            f"some files state a zone in {START_TIME_KEY}, and some none",
            where=where,
            expected="the same form in all files",
        )
    origin = min(starts)
    parts = []
    for look, start in zip(looks, starts):
        start_s = (start - origin).total_seconds()
        parts.append(_Part(look, start_s, start_s + (look.last - look.first) * look.unit_s))
    return sorted(parts, key=lambda part: (part.start_s, part.end_s))


def _overlap(before: _Part, after: _Part, where: str) -> InputError:
    """The error for two files that overlap in time, with the names and times of both."""
    is_counter = before.file.kind in ("counter", "epoch")
    texts = []
    for part in (before, after):
        ends = part.file.cells
        if is_counter or not ends[0]:
            ends = (f"{part.file.first:.15g}", f"{part.file.last:.15g}")
        if before.file.kind == "start time":
            start = part.file.metadata[START_TIME_KEY]
            ends = (start, f"{part.end_s - part.start_s:.6g} s later")
        texts.append(f"{part.file.name} ({ends[0]} to {ends[1]})")
    if before.file.kind == "counter":
        return InputError(
            f"the times of {texts[1]} do not follow those of {texts[0]}: nothing states when each "
            "file was logged",
            where=where,
            expected="time stamps with a date, start_time in the metadata of each file, or times "
            "that go on from file to file",
            remedy=EACH,
            parameters={"each": True},
        )
    return InputError(
        f"{texts[0]} and {texts[1]} overlap in time",
        where=where,
        expected="files of one log, one after another",
        remedy=f"leave one of them out; or {EACH}",
        parameters={"each": True},
    )


def _with_columns(part: _Part, first: _File) -> _Part:
    """The part with its column, and the conversion of its unit, for each column of the log.

    Raises
    ------
    InputError
        For other columns, or units that cannot be converted.
    """
    file = part.file
    free = list(file.names)
    columns: dict[str, str] = {}
    missing = []
    # equal names first, so that a similar one does not take their place
    for name in first.names:
        if name in free:
            columns[name] = name
            free.remove(name)
    for name in first.names:
        if name in columns:
            continue
        if name == first.clock.name:
            same = [x for x in free if x == file.clock.name and _has_stem(x, name)]
        else:
            same = [x for x in free if _is_same_temperature(x, name)]
        if len(same) == 1:
            columns[name] = same[0]
            free.remove(same[0])
        else:
            missing.append(name)
    if missing or free or columns[first.clock.name] != file.clock.name:
        differences = []
        if missing:
            differences.append(f"without {', '.join(map(repr, missing))}")
        if free:
            differences.append(f"with {', '.join(map(repr, free))}")
        if not differences:
            differences.append(f"the time in {file.clock.name!r}")
        raise InputError(
            f"has not the columns of {first.name}: {', and '.join(differences)}",
            where=display_path(file.path),
            expected="the same columns in all files of a log",
            remedy=EACH,
            parameters={"each": True},
        )
    conversions: dict[str, Conversion] = {}
    for name, column in columns.items():
        units = [file.unit(column), first.unit(name)]
        if name == first.clock.name or units[0] == units[1]:
            continue
        if not all(unit in TEMPERATURES for unit in units):
            stated = [unit or "no unit" for unit in units]
            raise InputError(
                f"column {column!r} is in {stated[0]}, and {name!r} of {first.name} in {stated[1]}",
                where=display_path(file.path),
                expected="one unit in all files of a log; degC, K and degF are converted",
            )
        conversions[name] = partial(convert_temperature, units[0], units[1])
    return replace(part, columns=columns, conversions=conversions)


def _has_stem(first: str, second: str) -> bool:
    """Whether two names of time columns are one without their units."""
    return split_unit(first)[0] == split_unit(second)[0]


def _is_same_temperature(first: str, second: str) -> bool:
    """Whether two names are one temperature in two units."""
    units = [unit_in(first), unit_in(second)]
    return is_same_name(first, second) and all(unit in TEMPERATURES for unit in units)


def _text_columns(parts: Sequence[_Part]) -> frozenset[str]:
    """Columns of the log that hold text: in one file at least, and numbers in none."""
    text: set[str] = set()
    numbers: set[str] = set()
    for part in parts:
        columns = part.columns or {}
        text |= {name for name, column in columns.items() if column in part.file.text}
        numbers |= {
            name
            for name, column in columns.items()
            if column in part.file.filled and column not in part.file.text
        }
    return frozenset(text - numbers)


def _findings(parts: Sequence[_Part], text: Collection[str]) -> list[list[Finding]]:
    """Findings about each file before its rows are read."""
    findings: list[list[Finding]] = [[] for _ in parts]
    first = parts[0].file
    if first.kind == "counter":
        findings[0].append(info("files.counted", subject=first.clock.name))
    for part, of_file in zip(parts, findings):
        for name, column in (part.columns or {}).items():
            if column in part.file.text and name not in text:
                of_file.append(warning("files.no_numbers", subject=name, where=part.file.name))
    return findings


def _have_several_forms(parts: Sequence[_Part]) -> bool:
    """Whether the files write their stamps in different forms.

    Raises
    ------
    InputError
        Where the date is in another column, whose cells are not changed.
    """
    forms = {_form_of(part.file.cells[0]) for part in parts}
    if len(forms) < 2:
        return False
    for part in parts:
        if part.file.date_column:
            raise InputError(
                f"the dates and times of {parts[0].file.name} and {part.file.name} have different "
                "forms",
                where=part.file.name,
                expected="one form of date and time in all files",
            )
    return True


def _form_of(cell: str) -> str:
    """The form of a stamp: its marks, with Y for a year, 0 for other digits and a for letters.

    >>> _form_of("26-Nov-2021 10:00:00.5"), _form_of("2021-11-26T10:00:00Z")
    ('0-a-Y 0:0:0', 'Y-0-0a0:0:0a')
    """
    without_fraction = re.sub(r"(:\d+)[.,]\d+", r"\1", cell)
    letters = re.sub(r"[^\W\d_]+", "a", without_fraction)
    return re.sub(r"\d+", lambda match: "Y" if len(match[0]) == 4 else "0", letters)


def _iso_stamps(parts: Sequence[_Part], day: date | None) -> Callable[[Array], NDArray[Any]]:
    """Function that writes seconds since the first stamp (N,) as ISO 8601.

    The clock is that of the first file; with zones it is UTC.
    """
    zone = "Z" if parts[0].file.kind == "dates with zone" else ""
    zero_s = parts[0].start_s - parts[0].file.first
    zero = np.datetime64(day or date.min, "us") + np.timedelta64(round(1e6 * zero_s), "us")

    def stamps(times_s: Array) -> NDArray[Any]:
        """The stamps (N,) as text; empty where there is no time."""
        is_known = np.isfinite(times_s)
        micros = np.rint(1e6 * np.where(is_known, times_s, 0.0)).astype("timedelta64[us]")
        texts = np.datetime_as_string(zero + micros).tolist()
        plain = [text.removesuffix(".000000") + zone for text in texts]
        return np.where(is_known, np.array(plain, dtype=object), "")

    return stamps


def _chunks(
    parts: Sequence[_Part],
    known: Collection[str],
    text: Collection[str],
    findings: Sequence[Sequence[Finding]],
    iso: Callable[[Array], NDArray[Any]] | None,
    where: str,
    requested: Sequence[str],
    rows: int = CHUNK_ROWS,
) -> Iterator[Columns]:
    """Yield the columns of all files in chunks of about so many rows.

    Parameters
    ----------
    parts
        The files in their order.
    known
        Column names that a header may contain.
    text
        Columns of text.
    findings
        Findings about each file.
    iso
        Function that writes stamps of seconds; None: stamps are as in the files.
    where
        Name of the log, for messages.
    requested, rows
        As in ``Table``.
    """
    waiting: list[Columns] = []
    n_waiting = 0
    locations: list[SampleLocation] = []
    first_samples: list[int] = []
    n_read = 0

    def merged() -> Columns:
        """The chunks that are waiting as one."""
        location = JoinedLocation(where, files=tuple(locations), first_samples=tuple(first_samples))
        return concatenate_columns(waiting, requested, location)

    for part, of_file in zip(parts, findings):
        first_samples.append(n_read)
        locations.append(SampleLocation(part.file.name))
        ahead = [each for each in of_file if each.subject in requested]
        # opened here, not before: some readers hold the text of their file
        table = open_table(part.file.path, known, part.file.part_of_file)
        for chunk in _chunks_of_part(table, part, text, iso, requested, rows):
            locations[-1] = replace(chunk.location, where=part.file.name)
            found = [each if each.where else each.at(part.file.name) for each in chunk.findings]
            count = len(next(iter(chunk.data.values())))
            waiting.append(replace(chunk, findings=(*ahead, *found)))
            ahead = []
            n_waiting += count
            n_read += count
            if n_waiting >= rows:
                yield merged()
                waiting = []
                n_waiting = 0
    if waiting:
        yield merged()


def _chunks_of_part(
    table: Table,
    part: _Part,
    text: Collection[str],
    iso: Callable[[Array], NDArray[Any]] | None,
    requested: Sequence[str],
    rows: int,
) -> Iterator[Columns]:
    """Yield the chunks of one file as columns of the log; parameters as for ``_chunks``."""
    columns = part.columns or {}
    conversions = part.conversions or {}
    time = part.file.clock.name
    in_file = list(dict.fromkeys(columns[name] for name in requested))
    for chunk in table.chunks(in_file, rows):
        data: dict[str, Array] = {}
        stamps: dict[str, NDArray[Any]] = {}
        for name in requested:
            column = columns[name]
            values = chunk.data[column]
            cells = chunk.stamps.get(column)
            if column == time:
                values = _on_clock(values, part)
                if cells is not None and iso is not None:
                    cells = iso(values)
            elif name in conversions:
                values = conversions[name](values)
            if name in text and cells is None:
                cells = np.full(len(values), "", dtype=object)
            data[name] = values
            if cells is not None and (name in text or column == time):
                stamps[name] = cells
        yield replace(chunk, data=data, stamps=stamps)


def _on_clock(values: Array, part: _Part) -> Array:
    """Times (N,) of a file on the clock of the log, in the unit of its first file."""
    if part.scale == 1.0 and part.offset == 0.0:
        return values
    return np.round(part.scale * values + part.offset, 9)
