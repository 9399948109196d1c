"""LabVIEW measurement files (.lvm): header blocks, comments, decimal commas, one, no or many X columns."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv as pacsv

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.files.csvtable import CsvTable
from calibration.files.dialect import ABSENT, LINE_END, is_number
from calibration.files.table import PIECE_ROWS, Columns, RowNumbers, Table, Track, align
from calibration.finding import Finding

_END = "***End_of_Header***"
_MARKS = {"tab": "\t", "comma": ",", "semicolon": ";"}


@dataclass
class LvmTable:
    """The numbers of a .lvm file, read at once."""

    names: tuple[str, ...]
    metadata: dict[str, str]
    data: dict[str, Array]
    findings: tuple[Finding, ...] = ()
    rows: RowNumbers = field(default_factory=RowNumbers)

    def pieces(self, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The wanted columns piece by piece (the file itself was read at once)."""
        return Columns({name: self.data[name] for name in wanted}, self.findings, self.rows).in_pieces(rows)


@dataclass(frozen=True)
class _Segment:
    head: dict[str, list[str]]
    names: list[str]
    values: Array
    first_row: int


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
    separator = _MARKS.get(head.get("Separator", "Tab").lower(), head.get("Separator", "\t") or "\t")
    decimal = head.get("Decimal_Separator", ".") or "."
    segments, at = [], end + 1
    while (found := _segment(lines, at, separator, decimal, where)) is not None:
        segment, at = found
        segments.append(segment)
    if not segments:
        raise InputError("holds no rows of data", where=where, expected="numbers below the header")
    if any(s.names != segments[0].names for s in segments):
        raise InputError("its segments hold different channels", where=where, remedy="save one segment a file")
    metadata = {k: v for k, v in head.items() if k not in ("Separator", "Decimal_Separator")}
    return _with_time(segments, head, metadata, where)


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
        parts = lines[at].split(separator)
        if len(parts) < width:
            last = at == len(lines) - 1
            raise InputError(
                f"row {at + 1} has {len(parts)} of {width} fields" + (": the file is truncated" if last else ""),
                where=where,
            )
        body.append(separator.join(parts[:width]))
    if not body:
        return None
    return _Segment(head, names, _numbers(body, separator, decimal, names, where, first), first), at


def _numbers(body: list[str], separator: str, decimal: str, names: list[str], where: str, first: int) -> Array:
    keys = [f"c{i}" for i in range(len(names))]
    try:
        table = pacsv.read_csv(
            io.BytesIO(("\n".join(body) + "\n").encode()),
            read_options=pacsv.ReadOptions(column_names=keys),
            parse_options=pacsv.ParseOptions(delimiter=separator, ignore_empty_lines=False),
            convert_options=pacsv.ConvertOptions(column_types={k: pa.float64() for k in keys}, decimal_point=decimal),
        )
    except (pa.ArrowInvalid, ValueError) as problem:
        for i, line in enumerate(body):
            for name, cell in zip(names, line.split(separator)):
                if not is_number(cell, decimal) and cell.strip().lower() not in ABSENT:
                    raise InputError(
                        f"column {name}, row {first + i}: {cell[:40]!r} is no number",
                        where=where,
                        expected=f"numbers with decimal {decimal!r} as the header says",
                    ) from None
        raise InputError(f"not readable ({str(problem)[:120]})", where=where) from None
    return np.column_stack([np.asarray(table.column(k).to_numpy(), dtype=np.float64) for k in keys])


def _with_time(segments: list[_Segment], head: dict[str, str], metadata: dict[str, str], where: str) -> LvmTable:
    names = segments[0].names
    values = np.concatenate([s.values for s in segments])
    rows = RowNumbers(segments[0].first_row)
    x_at = [i for i, n in enumerate(names) if n == "X_Value"]
    channels = [i for i, n in enumerate(names) if n != "X_Value" and n]
    own = {names[i]: np.ascontiguousarray(values[:, i]) for i in channels}
    labels = tuple(names[i] for i in channels)
    if "time_s" in own or "time" in own:
        return LvmTable(labels, metadata, own, (), rows)
    if len(x_at) > 1:
        tracks = {}
        for i in channels:
            x = values[:, max(k for k in x_at if k < i)]
            good = np.isfinite(x) & np.isfinite(values[:, i])
            if good.sum() < 2:
                raise InputError(f"channel {names[i]} has no X values", where=where)
            step = float((x[good][-1] - x[good][0]) / (good.sum() - 1))
            tracks[names[i]] = Track(np.ascontiguousarray(values[good, i]), float(x[good][0]), step)
        return _aligned(labels, tracks, metadata, where, rows)
    if x_at and np.isfinite(values[:, x_at[0]]).any():
        return LvmTable(("time_s", *labels), metadata, {"time_s": values[:, x_at[0]].copy(), **own}, (), rows)
    if len(segments) > 1:
        raise InputError("has several segments and no X column", where=where, remedy="write X values in LabVIEW")
    starts, steps = (segments[0].head.get(key, []) for key in ("X0", "Delta_X"))
    tracks = {}
    for k, i in enumerate(channels):
        tracks[names[i]] = Track(own[names[i]], _float(starts, k) or 0.0, _float(steps, k))
    return _aligned(labels, tracks, metadata, where, rows)


def _aligned(
    labels: tuple[str, ...], tracks: dict[str, Track], metadata: dict[str, str], where: str, rows: RowNumbers
) -> LvmTable:
    time, data, found = align(tracks, where)
    if time is None:
        raise InputError("no time: neither X values nor Delta_X", where=where, expected="Delta_X in the header")
    return LvmTable(("time_s", *labels), metadata, {"time_s": time, **data}, tuple(found), rows)


def _float(cells: list[str], index: int) -> float | None:
    try:
        return float(cells[index].replace(",", "."))
    except (IndexError, ValueError):
        return None
