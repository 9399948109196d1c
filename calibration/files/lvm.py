"""LabVIEW measurement files (.lvm): header blocks, comments, decimal commas, one, no or many X columns."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.errors import InputError
from calibration.files.csvtable import CsvTable
from calibration.files.dialect import LINE_END, Dialect
from calibration.files.table import PIECE_ROWS, Columns, Table, Track, align, read_whole

_END = "***End_of_Header***"
_MARKS = {"tab": "\t", "comma": ",", "semicolon": ";"}


@dataclass(frozen=True)
class LvmTable:
    """The numbers of a .lvm file, read at once."""

    metadata: dict[str, str]
    columns: Columns

    @property
    def names(self) -> tuple[str, ...]:
        """The channels, the time first where the file has none of its own."""
        return tuple(self.columns.data)

    def pieces(self, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The wanted columns piece by piece."""
        return replace(self.columns, data={name: self.columns.data[name] for name in wanted}).in_pieces(rows)


@dataclass(frozen=True)
class _Segment:
    head: dict[str, list[str]]
    names: list[str]
    columns: Columns


def read_lvm(path: Path, where: str, known: Collection[str] = ()) -> Table:
    """Read a .lvm file; one without LabVIEW's header is read as plain text.

    ``X_Value`` becomes ``time_s`` unless the file has a ``time_s`` of its own; where LabVIEW wrote no X column the
    time is X0 + i Delta_X. Comments and notes are left out. Several segments follow one another.
    """
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    lines = LINE_END.split(text)
    if not lines or not lines[0].startswith("LabVIEW Measurement"):
        return CsvTable.open(path, where, known)
    end = next((i for i, line in enumerate(lines) if line.startswith(_END)), None)
    if end is None:
        raise InputError("the header never ends", where=where, expected=f"a line {_END}")
    head = _file_head(lines[1:end])
    mark = head.get("Separator", "Tab")
    separator = _MARKS.get(mark.lower(), mark[:1] or "\t")
    decimal = "," if head.get("Decimal_Separator") == "," else "."
    segments, at = [], end + 1
    while (found := _segment(lines, at, separator, decimal, where)) is not None:
        segment, at = found
        segments.append(segment)
    if not segments:
        raise InputError("holds no rows of data", where=where, expected="numbers below the header")
    if any(s.names != segments[0].names for s in segments):
        raise InputError("its segments hold different channels", where=where, remedy="save one segment a file")
    metadata = {k: v for k, v in head.items() if k not in ("Separator", "Decimal_Separator")}
    return LvmTable(metadata, _timed(segments, where))


def _file_head(lines: list[str]) -> dict[str, str]:
    head: dict[str, str] = {}
    for line in lines:
        for mark in ("\t", ";", ","):
            key, found, value = line.partition(mark)
            if found:
                head[key.strip()] = value.strip("\t;").strip() if mark != "," else value.strip().rstrip(",") or ","
                break
    return head


def _segment(lines: list[str], at: int, separator: str, decimal: str, where: str) -> tuple[_Segment, int] | None:
    while at < len(lines) and not lines[at].replace(separator, "").strip():
        at += 1
    if at >= len(lines):
        return None
    head: dict[str, list[str]] = {}
    end = next((i for i in range(at, min(at + 60, len(lines))) if lines[i].startswith(_END)), None)
    if end is not None:
        for line in lines[at:end]:
            key, *values = line.split(separator)
            head[key.strip()] = [v.strip() for v in values]
        at = end + 1
    if at >= len(lines):
        return None
    names = [n.strip() for n in lines[at].split(separator)]
    width = len(names) - 1 if names[-1].lower() == "comment" else len(names)
    names = names[:width]
    first = at + 2
    body: list[str] = []
    for at in range(first - 1, len(lines) + 1):
        if at == len(lines) or not lines[at].replace(separator, "").strip() or lines[at].startswith("Channels"):
            break
        body.append(separator.join(lines[at].split(separator)[:width]))
    if not body:
        return None
    return _Segment(head, names, _numbers(body, separator, decimal, names, where, first)), at


def _numbers(body: list[str], separator: str, decimal: str, names: list[str], where: str, first: int) -> Columns:
    """The rows as a text table whose first line is number ``first``; a name that comes again gets its place added."""
    keys = tuple(n if names.index(n) == i else f"{n} {i + 1}" for i, n in enumerate(names))
    dialect = Dialect("utf-8", separator, decimal, keys, first - 1, len(keys), tuple(body[0].split(separator)))
    text = "\n" * (first - 1) + "\n".join(body) + "\n"
    return read_whole(CsvTable(Path(), where, dialect, keys, {}, text.encode()), keys)


def _timed(segments: list[_Segment], where: str) -> Columns:
    """The channels of all segments, one after another, with their time [s]."""
    first, names = segments[0], segments[0].names
    values = np.concatenate([np.column_stack([*s.columns.data.values()]) for s in segments])
    found = tuple(f for s in segments for f in s.columns.findings)
    x_at = [i for i, n in enumerate(names) if n == "X_Value"]
    own = {n: np.ascontiguousarray(values[:, i]) for i, n in enumerate(names) if n not in ("", "X_Value")}
    if "time_s" in own or "time" in own:
        return Columns(own, found, first.columns.rows)
    if len(x_at) == 1 and np.isfinite(values[:, x_at[0]]).any():
        return Columns({"time_s": values[:, x_at[0]].copy(), **own}, found, first.columns.rows)
    if len(x_at) <= 1 and len(segments) > 1:
        raise InputError("has several segments and no X column", where=where, remedy="write X values in LabVIEW")
    tracks = {}
    for k, (name, y) in enumerate(own.items()):
        if len(x_at) <= 1:
            start, step = (_float(first.head.get(key, []), k) for key in ("X0", "Delta_X"))
            tracks[name] = Track(y, start or 0.0, step)
            continue
        x = values[:, max(i for i in x_at if i < names.index(name))]
        good = np.isfinite(x) & np.isfinite(y)
        if good.sum() < 2:
            raise InputError(f"channel {name} has no X values", where=where)
        tracks[name] = Track(y[good], float(x[good][0]), float((x[good][-1] - x[good][0]) / (good.sum() - 1)))
    time, data, said = align(tracks, where)
    if time is None:
        raise InputError("no time: neither X values nor Delta_X", where=where, expected="Delta_X in the header")
    return Columns({"time_s": time, **data}, (*found, *said), first.columns.rows)


def _float(cells: list[str], index: int) -> float | None:
    try:
        return float(cells[index].replace(",", "."))
    except (IndexError, ValueError):
        return None
