"""LabVIEW measurement files (.lvm): header blocks, comments, decimal commas, one, no or many X columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.io.csv_dialect import LINE_END, Dialect
from tcdyn.io.table import Columns, Table, Track, align, in_pieces, read_whole

MARK = b"LabVIEW Measurement"
_END = "***End_of_Header***"
_MARKS = {"tab": "\t", "comma": ",", "semicolon": ";"}


Pieces = Callable[[Dialect, Sequence[str]], Iterator[Columns]]


@dataclass(frozen=True)
class _Segment:
    head: dict[str, list[str]]
    names: list[str]
    columns: Columns


def lvm_table(path: Path, where: str, pieces: Pieces) -> Table:
    """Read a .lvm file, which begins with LabVIEW's mark, at once; ``pieces`` reads the rows of text below a header.

    ``X_Value`` becomes ``time_s`` unless the file has a ``time_s`` of its own; where LabVIEW wrote no X column the
    time is X0 + i Delta_X. Comments and notes are left out. Several segments follow one another.
    """
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    lines = LINE_END.split(text)
    end = next((i for i, line in enumerate(lines) if line.startswith(_END)), None)
    if end is None:
        raise InputError("the header never ends", where=where, expected=f"a line {_END}")
    head = _file_head(lines[1:end])
    mark = head.pop("Separator", "Tab")
    separator = _MARKS.get(mark.lower(), mark[:1] or "\t")
    decimal = "," if head.pop("Decimal_Separator", ".") == "," else "."
    segments = []
    at = end + 1
    while (found := _segment(lines, at, separator, decimal, where, pieces)) is not None:
        segment, at = found
        segments.append(segment)
    if not segments:
        raise InputError("holds no rows of data", where=where, expected="numbers below the header")
    if any(s.names != segments[0].names for s in segments):
        raise InputError(
            "its segments hold different channels", where=where, remedy="save one segment a file"
        )
    whole = _timed(segments)
    return Table(where, tuple(whole.data), head, partial(in_pieces, whole))


def _file_head(lines: list[str]) -> dict[str, str]:
    head: dict[str, str] = {}
    for line in lines:
        for mark in ("\t", ";", ","):
            key, found, value = line.partition(mark)
            if found:
                head[key.strip()] = (
                    value.strip("\t;").strip() if mark != "," else value.strip().rstrip(",") or ","
                )
                break
    return head


def _segment(
    lines: list[str], at: int, separator: str, decimal: str, where: str, pieces: Pieces
) -> tuple[_Segment, int] | None:
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
        if (
            at == len(lines)
            or not lines[at].replace(separator, "").strip()
            or lines[at].startswith("Channels")
        ):
            break
        body.append(separator.join(lines[at].split(separator)[:width]))
    if not body:
        return None
    # the rows as a text whose first line is number first; a name that comes again gets its place added
    keys = tuple(n if names.index(n) == i else f"{n} {i + 1}" for i, n in enumerate(names))
    lined = "\n" * (first - 1) + "\n".join(body) + "\n"
    row = tuple(body[0].split(separator))
    dialect = Dialect(where, "utf-8", separator, decimal, keys, first - 1, row, body=lined.encode())
    return _Segment(
        head, names, read_whole(Table(where, keys, {}, partial(pieces, dialect)), keys)
    ), at


def _timed(segments: list[_Segment]) -> Columns:
    """The channels of all segments, one after another, with their time [s]."""
    first = segments[0]
    names = segments[0].names
    place = segments[0].columns.place
    where = place.where
    values = np.concatenate([np.column_stack([*s.columns.data.values()]) for s in segments])
    found = tuple(f for s in segments for f in s.columns.findings)
    x_at = [i for i, n in enumerate(names) if n == "X_Value"]
    own = {
        n: np.ascontiguousarray(values[:, i])
        for i, n in enumerate(names)
        if n not in ("", "X_Value")
    }
    if "time_s" in own or "time" in own:
        return Columns(own, place, found)
    if len(x_at) == 1 and np.isfinite(values[:, x_at[0]]).any():
        return Columns({"time_s": values[:, x_at[0]].copy(), **own}, place, found)
    if len(x_at) <= 1 and len(segments) > 1:
        raise InputError(
            "has several segments and no X column", where=where, remedy="write X values in LabVIEW"
        )
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
        tracks[name] = Track(
            y[good], float(x[good][0]), float((x[good][-1] - x[good][0]) / (good.sum() - 1))
        )
    time, data, said = align(tracks, where)
    if time is None:
        raise InputError(
            "no time: neither X values nor Delta_X", where=where, expected="Delta_X in the header"
        )
    return Columns({"time_s": time, **data}, place, (*found, *said))


def _float(cells: list[str], index: int) -> float | None:
    try:
        return float(cells[index].replace(",", "."))
    except (IndexError, ValueError):
        return None
