"""Converted files of Sea-Bird instruments (.cnv), as SBE Data Processing writes them.

The names of the columns are in lines ``# name k = short: long [unit]`` above a line ``*END*``; the
rows below have no header of their own. Used by :mod:`tcdyn.io.read`, which gives its reader of
text. The format is that of the manual of Seasoft V2 SBE Data Processing, section "Converted data
file (.cnv) format". Guarded by ``tests/io/test_sea_bird.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.io.csv_dialect import LINE_END, Dialect, split, tabs_for_spaces
from tcdyn.io.metadata import START_TIME_KEY
from tcdyn.io.stamps import instant_of
from tcdyn.io.table import Columns, Table, in_chunks, read_all_rows
from tcdyn.io.times import is_time_name

# a file of this format begins with these bytes
FIRST_BYTES = b"* Sea-Bird"
_HEADER_END = "*END*"
_NAME = re.compile(r"#\s*name\s+(?P<index>\d+)\s*=\s*(?P<short>[^:]*?)\s*(?::\s*(?P<long>.*?))?\s*")
_ENTRY = re.compile(r"#\s*(?P<key>\w+)\s*=\s*(?P<value>.*?)\s*")
_UNIT = re.compile(r"\[(?:I?P?TS-\d+,\s*)?(?P<unit>[^\[\]]+)\]$")
# Units of times whose name states none.
_UNIT_OF_TIME = {"timej": "days"}
# Flag of a value that is none, unless the header states another one.
_BAD_FLAG = "-9.990e-29"
TIME = "time_s"

# reader of the rows of text below a header: ``tcdyn.io.read.text_chunks``
ChunkReader = Callable[[Dialect, Sequence[str]], Iterator[Columns]]


def cnv_table(path: Path, where: str, read_chunks: ChunkReader) -> Table:
    """Read a .cnv file at once.

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
        If the header does not end or names no columns, or the rows are binary or absent.

    Notes
    -----
    A column has its short name and its unit: ``t090C [deg C]``. Without a column of time, that of
    the rows is the sampling interval of the header times their number; a file whose interval is one
    of pressure or depth has no time. Values that are the bad flag are missing.
    """
    text = path.read_bytes().decode("cp1252", errors="replace")
    lines = LINE_END.split(text)
    ends = [k for k, line in enumerate(lines) if line.strip() == _HEADER_END]
    if not ends:
        raise InputError(
            "a Sea-Bird file whose header never ends", where=where, expected=f"a line {_HEADER_END}"
        )
    header = lines[: ends[0]]
    entries = _entries(header)
    names = _names(header, where)
    if entries.get("file_type", "ascii") != "ascii":
        raise InputError(
            "a Sea-Bird CNV file with binary rows",
            where=where,
            remedy="convert it with the output format ASCII",
        )
    rows = [k for k, line in enumerate(lines) if k > ends[0] and line.strip()]
    if not rows:
        raise InputError("a Sea-Bird CNV file without rows", where=where)
    first_row = split(lines[rows[0]], " ")
    if len(first_row) != len(names):
        raise InputError(
            f"a Sea-Bird CNV file: its header names {len(names)} columns, but row {rows[0] + 1} "
            f"has {len(first_row)}",
            where=where,
            expected="one name for each column",
        )
    body = tabs_for_spaces(text.encode("utf-8"))
    dialect = Dialect(where, "utf-8", "\t", ".", names, rows[0], tuple(first_row), {}, path, body)
    read = read_all_rows(Table(where, names, {}, partial(read_chunks, dialect)), names)
    bad_flag = float(entries.get("bad_flag", _BAD_FLAG))
    data = {
        name: np.where(values == bad_flag, np.nan, values) for name, values in read.data.items()
    }
    metadata = {}
    interval_s = _interval_s(entries)
    if interval_s is not None and not any(is_time_name(name) for name in names):
        count = len(data[names[0]])
        data = {TIME: interval_s * np.arange(count), **data}
        start = instant_of(entries.get("start_time", ""), "dmy")
        if start is not None:
            metadata[START_TIME_KEY] = start.isoformat()
    columns = Columns(data, read.location, read.findings, read.stamps)
    return Table(where, tuple(data), metadata, partial(in_chunks, columns))


def _entries(header: Sequence[str]) -> dict[str, str]:
    """Values of the lines ``# key = value``, the first one of each key."""
    entries: dict[str, str] = {}
    for line in header:
        match = _ENTRY.fullmatch(line)
        if match is not None:
            entries.setdefault(match["key"], match["value"])
    return entries


def _names(header: Sequence[str], where: str) -> tuple[str, ...]:
    """Names of the columns with their units.

    Raises
    ------
    InputError
        If the header names no columns, or not each of them once.
    """
    names: list[str] = []
    for line in header:
        match = _NAME.fullmatch(line)
        if match is None:
            continue
        if int(match["index"]) != len(names):
            break
        unit = _UNIT.search(match["long"] or "")
        text = unit["unit"] if unit else _UNIT_OF_TIME.get(match["short"].lower(), "")
        names.append(f"{match['short']} [{text}]" if text else match["short"])
    if not names or len(set(names)) != len(names):
        raise InputError(
            "a Sea-Bird file whose header does not name its columns",
            where=where,
            expected="a line '# name k = ...' for each column",
            remedy="convert the raw file (.hex, .dat) to CNV with SBE Data Processing",
        )
    return tuple(names)


def _interval_s(entries: Mapping[str, str]) -> float | None:
    """The sampling interval [s]; None where the rows are those of even pressures or depths."""
    unit, _, number = entries.get("interval", "").partition(":")
    if unit.strip() != "seconds":
        return None
    try:
        interval_s = float(number)
    except ValueError:
        return None
    return interval_s if interval_s > 0 else None
