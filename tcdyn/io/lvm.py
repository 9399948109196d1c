"""LabVIEW measurement files (.lvm), with no, one or many X columns.

Used by :mod:`tcdyn.io.read`, which gives its reader of text: the rows below a header are a text log
of known dialect. The format is that of National Instruments: a header of the file, then segments
with their own headers. Guarded by ``tests/io/test_file_formats.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.csv_dialect import LINE_END, Dialect
from tcdyn.io.metadata import START_TIME_KEY
from tcdyn.io.table import Columns, Table, Track, align, in_chunks, read_all_rows

# a file of this format begins with these bytes
FIRST_BYTES = b"LabVIEW Measurement"
# lines and words of the format
_HEADER_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}
_LVM_DATE = re.compile(r"\d{4}/\d{1,2}/\d{1,2}")
_HEADER_LINES = 60  # a header of a segment ends within them; chosen by judgement

# reader of the rows of text below a header: ``tcdyn.io.read.text_chunks``
ChunkReader = Callable[[Dialect, Sequence[str]], Iterator[Columns]]


@dataclass(frozen=True)
class _Segment:
    """One segment: its header, the names in the file, and its columns with unique names."""

    header: dict[str, list[str]]
    names: list[str]
    columns: Columns


@dataclass(frozen=True)
class _LvmText:
    """Lines of a file with its separator and decimal mark."""

    lines: list[str]
    separator: str
    decimal: str
    where: str

    def is_blank(self, number: int) -> bool:
        """Whether a line has no text besides separators."""
        return not self.lines[number].replace(self.separator, "").strip()

    def find_header_end(self, first: int, last: int) -> int | None:
        """Number of the line that ends a header; None if there is none.

        Parameters
        ----------
        first, last
            First line searched, and one past the last.
        """
        for number in range(first, min(last, len(self.lines))):
            if self.lines[number].startswith(_HEADER_END):
                return number
        return None


def lvm_table(path: Path, where: str, read_chunks: ChunkReader) -> Table:
    """Read a .lvm file at once.

    Parameters
    ----------
    path
        A file that begins with ``FIRST_BYTES``.
    where
        The file, for messages.
    read_chunks
        Reader of the rows of text below a header.

    Raises
    ------
    InputError
        If the file has no end of the header, no data, no time, or segments with different channels.

    Notes
    -----
    ``X_Value`` becomes ``time_s`` unless the file has a column ``time_s``. Where LabVIEW wrote no X
    column the time is X0 + i Delta_X. Comments and notes are ignored. Segments are joined.
    """
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    lines = LINE_END.split(text)
    end = _LvmText(lines, "", "", where).find_header_end(0, len(lines))
    if end is None:
        raise InputError("the header never ends", where=where, expected=f"a line {_HEADER_END}")
    metadata = _parse_file_header(lines[1:end])
    separator_name = metadata.pop("Separator", "Tab")
    separator = _SEPARATORS.get(separator_name.lower(), separator_name[:1] or "\t")
    decimal = "," if metadata.pop("Decimal_Separator", ".") == "," else "."
    lvm_text = _LvmText(lines, separator, decimal, where)
    segments = _segments(lvm_text, end + 1, read_chunks)
    if not segments:
        raise InputError("holds no rows of data", where=where, expected="numbers below the header")
    if any(segment.names != segments[0].names for segment in segments):
        raise InputError(
            "its segments hold different channels",
            where=where,
            remedy="save each segment in its own file",
        )
    columns = _with_time(segments)
    start = _start_time(metadata)
    if start:
        metadata.setdefault(START_TIME_KEY, start)
    return Table(where, tuple(columns.data), metadata, partial(in_chunks, columns))


def _start_time(header: Mapping[str, str]) -> str:
    """Date and time in the header of the file, in ISO 8601; empty for another form of date."""
    date = header.get("Date", "")
    time = header.get("Time", "")
    if not time or _LVM_DATE.fullmatch(date) is None:
        return ""
    try:
        return pd.Timestamp(f"{date} {time.replace(',', '.')}").isoformat()
    except ValueError:
        return ""


def _parse_file_header(lines: list[str]) -> dict[str, str]:
    """Keys and values of the header of the file."""
    header: dict[str, str] = {}
    for line in lines:
        for separator in ("\t", ";", ","):
            key, separator_found, value = line.partition(separator)
            if not separator_found:
                continue
            if separator == ",":
                header[key.strip()] = value.strip().rstrip(",") or ","
            else:
                header[key.strip()] = value.strip("\t;").strip()
            break
    return header


def _segments(text: _LvmText, start: int, read_chunks: ChunkReader) -> list[_Segment]:
    """All segments from one line on; blank lines and lines "Channels ..." separate them.

    Parameters
    ----------
    text
        Lines of the file.
    start
        First line.
    read_chunks
        Reader of the rows of text below a header.
    """
    segments: list[_Segment] = []
    while True:
        result = _segment(text, start, read_chunks)
        if result is None:
            return segments
        segment, start = result
        segments.append(segment)


def _segment(text: _LvmText, start: int, read_chunks: ChunkReader) -> tuple[_Segment, int] | None:
    """The segment from one line on; None if there is none.

    Parameters
    ----------
    text
        Lines of the file.
    start
        First line.
    read_chunks
        Reader of the rows of text below a header.

    Returns
    -------
    segment
        The segment.
    end
        The line after it.
    """
    lines = text.lines
    separator = text.separator
    while start < len(lines) and text.is_blank(start):
        start += 1
    if start >= len(lines):
        return None
    header: dict[str, list[str]] = {}
    header_end = text.find_header_end(start, start + _HEADER_LINES)
    if header_end is not None:
        for line in lines[start:header_end]:
            key, *values = line.split(separator)
            header[key.strip()] = [value.strip() for value in values]
        start = header_end + 1
    if start >= len(lines):
        return None
    names = [name.strip() for name in lines[start].split(separator)]
    if names[-1].lower() == "comment":
        names.pop()
    first = start + 1
    end = first
    while end < len(lines) and not text.is_blank(end) and not lines[end].startswith("Channels"):
        end += 1
    if end == first:
        return None
    rows = [separator.join(line.split(separator)[: len(names)]) for line in lines[first:end]]
    # blank lines in front, so that messages state the line of the file
    body = "\n" * first + "\n".join(rows) + "\n"
    unique_names = tuple(
        name if names.index(name) == i else f"{name} {i + 1}" for i, name in enumerate(names)
    )
    dialect = Dialect(
        text.where,
        "utf-8",
        separator,
        text.decimal,
        unique_names,
        first,
        tuple(rows[0].split(separator)),
        body=body.encode(),
    )
    table = Table(text.where, unique_names, {}, partial(read_chunks, dialect))
    return _Segment(header, names, read_all_rows(table, unique_names)), end


def _with_time(segments: list[_Segment]) -> Columns:
    """The channels of all segments, one after another, with their time [s].

    Raises
    ------
    InputError
        If there is no time, or several segments have no X column.

    Notes
    -----
    The time is, in this order: a column ``time_s`` or ``time``; the one X column; X0 and Delta_X of
    each channel; an X column for each channel, the last one before it. The last two go through
    ``tcdyn.io.table.align``.
    """
    first = segments[0]
    names = first.names
    location = first.columns.location
    where = location.where
    values = np.concatenate(
        [np.column_stack([*segment.columns.data.values()]) for segment in segments]
    )
    findings = tuple(f for segment in segments for f in segment.columns.findings)
    x_columns = [i for i, name in enumerate(names) if name == "X_Value"]
    channels = {
        name: np.ascontiguousarray(values[:, i])
        for i, name in enumerate(names)
        if name not in ("", "X_Value")
    }
    if "time_s" in channels or "time" in channels:
        return Columns(channels, location, findings)
    if len(x_columns) == 1:
        x = values[:, x_columns[0]]
        if np.isfinite(x).any():
            return Columns({"time_s": x.copy(), **channels}, location, findings)
    if len(x_columns) <= 1 and len(segments) > 1:
        raise InputError(
            "has several segments and no X column", where=where, remedy="write X values in LabVIEW"
        )
    tracks = {}
    for k, (name, y) in enumerate(channels.items()):
        if len(x_columns) <= 1:
            start_s = _number_at(first.header.get("X0", []), k)
            step_s = _number_at(first.header.get("Delta_X", []), k)
            tracks[name] = Track(y, start_s or 0.0, step_s)
        else:
            x_column = max(i for i in x_columns if i < names.index(name))
            tracks[name] = _track(name, values[:, x_column], y, where)
    time_s, data, align_findings = align(tracks, where)
    if time_s is None:
        raise InputError(
            "no time: neither X values nor Delta_X", where=where, expected="Delta_X in the header"
        )
    return Columns({"time_s": time_s, **data}, location, (*findings, *align_findings))


def _track(name: str, x: Array, y: Array, where: str) -> Track:
    """One channel with the start and the mean interval of its X column.

    Parameters
    ----------
    name
        Name of the channel.
    x, y
        X values [s] and samples (N,); rows where one is missing are left out.
    where
        The file, for messages.

    Raises
    ------
    InputError
        For a channel with fewer than two X values.
    """
    good = np.isfinite(x) & np.isfinite(y)
    count = int(good.sum())
    if count < 2:
        raise InputError(f"channel {name} has no X values", where=where)
    x = x[good]
    return Track(y[good], float(x[0]), float((x[-1] - x[0]) / (count - 1)))


def _number_at(cells: list[str], index: int) -> float | None:
    """Number in cell ``index``; None if there is no such cell or no number in it."""
    try:
        return float(cells[index].replace(",", "."))
    except (IndexError, ValueError):
        return None
