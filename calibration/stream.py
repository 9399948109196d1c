"""Logs too long for memory: the same checks and the same numbers as ``read_log``, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import union_categoricals

from calibration.checks.kind import two_level
from calibration.checks.sampling import Sampling, check_time
from calibration.checks.temperature import LONGEST_NAN_S, Place, PlainCheck, TemperatureCheck
from calibration.checks.thin import Thinned
from calibration.columns import Kind
from calibration.errors import InputError
from calibration.files.table import FloatArray, RowNumbers, Table, shown
from calibration.log import (
    SWITCHES,
    check_course,
    check_edges,
    check_places,
    column_check,
    even_frame,
    not_there,
    open_log,
)
from calibration.rig import Rig


@dataclass(frozen=True)
class LogPiece:
    """A stretch of a log: canonical frame, sample interval [s] of the whole log, what was noticed.

    What the whole log shows is told with the first piece, what was counted while reading with the last.
    """

    frame: pd.DataFrame
    dt_s: float
    warnings: tuple[str, ...]


def iter_log(
    path: str | Path, kind: Kind, rig: Rig | None = None, disk: str | None = None, *, rows: int = 50_000
) -> Iterator[LogPiece]:
    """Pieces of a log in time order; put together they are ``read_log``'s frame, to the last digit.

    The file is read twice. The first time keeps its time and switches, and of the other columns a sample of at most
    131072 rows: sampling, two-level columns, entry or unloading, units, loads, swapped and dead channels are judged
    there, before any piece is given. Channels that freeze, and too many missing samples or spikes, are refused before
    the last piece is given: what the others were used for must wait for it.

    CSV (2 MB of text at most in a piece), Parquet and TDMS need memory for some pieces and 40 bytes for each row of
    the file, 250 MB for a gigabyte; LVM and UTF-16 text are read at once. ``rows``: of a piece, roughly.

    Raises InputError as ``read_log`` does; for an oven log, which is always short; for TDMS channels that differ in
    start or rate, which ``read_log`` aligns.
    """
    if kind == "oven":
        raise InputError("oven logs are read whole", expected="immersion, ehl or hole", remedy="use read_log")
    file = Path(path)
    table, chosen = open_log(file, kind, rig, disk)
    trace = _first_look(table, chosen, kind, rig, disk, shown(file), rows)
    margin = 3 * int(max(LONGEST_NAN_S / trace.dt_s, 3.0) + 1) + 3  # three neighbours, each behind a gap
    kept: dict[str, FloatArray] = {}
    at = done = 0
    notes = trace.notes
    for raw in table.chunks(list(dict.fromkeys(chosen.values())), rows):
        data = {name: raw.data[chosen[name]] for name in trace.checks}
        kept = {name: np.concatenate([kept[name], data[name]]) for name in data} if kept else data
        end = at + len(next(iter(kept.values())))
        stop = end - margin if end < trace.rows else end
        if end > trace.rows:
            break
        if stop == done or (stop - done < margin and end < trace.rows):
            continue
        columns = trace.see(kept, at, done, stop)
        frame = even_frame(trace.time, columns, trace.sampling, done, stop)
        done = stop
        if done == trace.rows:
            notes = [*notes, *(note for check in trace.checks.values() for note in check.judge())]
        yield LogPiece(frame, trace.dt_s, tuple(f"{shown(file)}: {n}" for n in notes))
        notes = []
        kept = {name: values[max(stop - margin - at, 0) :].copy() for name, values in kept.items()}
        at = max(stop - margin, at)
    if done != trace.rows:
        raise InputError("the file changed while it was read", where=shown(file))


@dataclass(frozen=True)
class _Trace:
    """What the first look at a log leaves: its whole time (N,) [s] and switches, and a check for each other column."""

    time: FloatArray
    sampling: Sampling
    order: tuple[str, ...]
    switches: dict[str, NDArray[np.bool_]]
    checks: dict[str, TemperatureCheck | PlainCheck]
    notes: list[str]

    @property
    def rows(self) -> int:
        return len(self.time)

    @property
    def dt_s(self) -> float:
        return self.sampling.dt_s

    def see(self, kept: dict[str, FloatArray], at: int, first: int, stop: int) -> dict[str, FloatArray]:
        """Rows ``first`` to ``stop``, cleaned and counted, from ``kept``, which begins with row ``at``."""
        inside = slice(first - at, stop - at)
        out: dict[str, FloatArray] = {}
        for name in self.order:
            if name in self.switches:
                out[name] = self.switches[name][first:stop].astype(np.float64)
            else:
                out[name] = self.checks[name].clean(kept[name])[inside]
                self.checks[name].see(kept[name][inside], out[name])
        return out


def _first_look(
    table: Table, chosen: dict[str, str], kind: Kind, rig: Rig | None, disk: str | None, where: str, rows: int
) -> _Trace:
    clock = bytearray()  # grows in place, where a list of arrays would need all of it twice
    levels: dict[str, list[Any]] = {name: [] for name in SWITCHES if name in chosen}
    others = [name for name in chosen if name not in ("time_s", *levels)]
    thin = Thinned()
    notes: list[str] = []
    number: RowNumbers | None = None
    for raw in table.chunks(list(dict.fromkeys(chosen.values())), rows):
        number = number or raw.rows
        notes.extend(raw.notes)
        clock += raw.data[chosen["time_s"]].tobytes()
        for name, parts in levels.items():
            parts.append(pd.Categorical(raw.data[chosen[name]]))
        thin.see({name: raw.data[chosen[name]] for name in others})
    if number is None:
        raise InputError("no rows", where=where)
    time, sampling = check_time(np.frombuffer(clock), number, where)
    del clock
    notes.extend(sampling.notes)
    place = Place(where, number, time, sampling.dt_s)
    switches: dict[str, NDArray[np.bool_]] = {}
    for name, parts in levels.items():
        values, said = two_level(np.array(union_categoricals(parts), dtype=np.float64), name, place)
        notes += [*said, *check_edges(values, name, kind, place)]
        switches[name] = values > 0.5
    sample = thin.columns
    checks = {name: column_check(name, values, place) for name, values in sample.items()}
    checked = {name: check.clean(sample[name]) for name, check in checks.items()}
    checked |= {name: values[thin.rows].astype(np.float64) for name, values in switches.items()}
    notes += check_course(checked, kind, place)
    notes += check_places(pd.DataFrame(checked, copy=False), kind, rig, disk)
    notes += not_there(chosen, kind)
    order = tuple(name for name in chosen if name != "time_s")
    return _Trace(time, sampling, order, switches, checks, notes)
