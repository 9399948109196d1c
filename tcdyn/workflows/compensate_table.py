"""Any table through sensor files: compensated stretch by stretch, in memory that does not grow with the table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.chain import Chain
from tcdyn.chain import sensors as sensors_of
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.checksum import ALTERED
from tcdyn.io.read import sha256, shown
from tcdyn.io.write import log_writer
from tcdyn.rig.log import COMPENSATED
from tcdyn.rig.static_line import StaticLine, apply_static, whole_u
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.table import EvenTimes, Part, on_grid, once_each, open_source, parts, places
from tcdyn.sensors.units import Unit, cold_column, doubtful, matching, units_of
from tcdyn.smoothing.intervals import settled_s
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import smooth

# smoothed at once: an event of one column is weighed in all of them
MOST_VALUES = 400_000
MOST_COLUMNS = 8
TOLD_ROWS = 200_000  # after so many progress is told again, then after twice as many
DECIMALS = 5


@dataclass(frozen=True)
class Worn:
    """A column of a table with the sensor that stands behind it."""

    column: str
    file: SensorFile
    at: int  # of the sensor file's columns
    unit: Unit

    @property
    def chain(self) -> Chain:
        """The chain of this column."""
        return self.file.chains[self.at]

    @property
    def lag_s(self) -> Estimate:
        """The lag of this column [s]."""
        return self.file.chain.channels[self.file.columns[self.at]].lag_s

    @property
    def line(self) -> StaticLine | None:
        """Its static line, None where readings stand as they are."""
        return self.file.static.get(self.file.columns[self.at])


@dataclass(frozen=True)
class CompensatedTable(Result):
    """What was written: rows, columns with their sensors, typical and largest standard deviation, what was noticed."""

    path: Path
    rows: int
    columns: tuple[Worn, ...]
    carried: tuple[str, ...]
    numbers: pd.DataFrame
    metadata: dict[str, str]
    findings: tuple[Finding, ...]

    def summary(self) -> str:
        """A line a column."""
        s = "s" if len(self.columns) > 1 else ""
        lines = [f"{self.rows} rows, {len(self.columns)} column{s} compensated: {self.path}"]
        for worn, row in zip(self.columns, self.numbers.itertuples(index=False)):
            lines.append(
                f"  {worn.column}: lag {worn.lag_s.text('s')}; noise {row.noise_sd_K:.3g} K, standard deviation "
                f"{row.sd_typical_K:.3g} K typical, {row.sd_max_K:.3g} K at most"
            )
        return "\n".join(lines)

    def card(self) -> pd.DataFrame:
        """Noise and standard deviation of each column."""
        return self.numbers

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain data."""
        return {
            "out": str(self.path),
            "rows": self.rows,
            "columns": self.numbers.to_dict("records"),
            "carried": list(self.carried),
            "metadata": self.metadata,
            "warnings": list(self.warnings),
            "findings": [f.to_dict() for f in self.findings],
        }


@one_blas_thread
def compensate_table(
    log: str | Path,
    sensors: Sequence[SensorFile],
    out: str | Path,
    *,
    columns: Sequence[str] = (),
    time: str | None = None,
    time_unit: str | None = None,
    unit: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    progress: Callable[[str], None] = lambda _: None,
) -> CompensatedTable:
    """Compensate the columns of any table that the ``sensors`` cover, and write the table with its answers to ``out``.

    Each column of temperature is replaced by what the junction did, in its own unit (mV: degrees Celsius), and a
    column ``<name>_u_K`` (``_u_degF``) is put beside the last one: the standard deviation, noise, smoothing, lag and
    static line in it. Other columns pass through as numbers and are named in a note.

    Args:
        log: CSV, LVM, TDMS or Parquet with a column of time, rows at any rate.
        sensors: of one or several files; each column belongs to one.
        out: .csv or .parquet.
        columns: those that a single sensor covers here, instead of its own.
        time: the time column, where its name does not say so.
        time_unit: its unit (s, ms, us, ns, min, h or days), where neither its name nor a row of units says so.
        unit: "degC", "K", "degF" or "mV" for all columns, or by column; otherwise as the names say.
        couple, cold: of millivolts: the thermocouple's type, and the reference junction [degC] or its column.

    Raises:
        InputError: no such column, two sensors for one, a table that is compensated, time that does not rise.
    """
    source = open_source(log, time, time_unit=time_unit)
    cold = cold_column(cold, source.table.names, source.table.where)
    names = source.table.names
    own = [n for n in names if n != source.time]
    worn, told = worn_in(
        own, source.table.where, sensors, columns, unit, couple, cold, source.table.units
    )
    others = [n for n in own if n not in {w.column for w in worn}]
    kept: list[str] = [str(cold)] if isinstance(cold, str) else []
    if others:
        told.append(info("sensor.carried", columns=others))
    notes = {**source.table.metadata, "tcdyn": COMPENSATED, "source": source.path.name}
    notes |= {"source_sha256": sha256(log)} if source.path.is_file() else {}
    for w in worn:
        notes[f"lag_s of {w.column}"] = f"{w.lag_s.text('s')}, sensor {w.file.sensor}"
    renamed = {w.column: w.unit.names(w.column) for w in worn}
    header = [renamed[n][0] if n in renamed else n for n in names] + [
        renamed[w.column][1] for w in worn
    ]
    clash = [n for n in header if header.count(n) > 1]
    if clash:
        raise InputError(
            f"the output would hold column {clash[0]!r} twice",
            where=shown(source.path),
            remedy="rename it",
        )
    gathered: dict[str, list[Array]] = {w.column: [] for w in worn}
    rows = 0
    found = list(told)
    tell_at = 0
    ends_s = list[float]()
    stretches = parts(source, [*names, *kept], max((w.chain.lag_s for w in worn), default=0.0))
    stretch = next(stretches, None)
    text = [n for n in names if stretch is not None and stretch.data[n].dtype == object]
    with log_writer(out, header, notes, text) as write:
        while stretch is not None:
            if rows >= tell_at:
                progress(f"from row {rows + 1}")
                tell_at = rows + max(rows, TOLD_ROWS)
            answer, numbers, said, memory = _answered(stretch, worn, shown(source.path))
            if (
                memory > stretch.beside
            ):  # too little beside it for both sweeps to settle: again, with more
                stretch = stretches.send(memory)
                continue
            write(pd.DataFrame({new: answer[new] for new in header}))
            rows = rows + len(next(iter(answer.values())))
            found = [*once_each([*found, *said])]
            ends_s += stretch.time_s[[0, -1]].tolist() if len(stretch.time_s) else []
            stretch = next(stretches, None)
            for name, row in numbers.items():
                gathered[name].append(row)
    table = []
    for w in worn:
        of = np.array(gathered[w.column]) if gathered[w.column] else np.full((1, 3), np.nan)
        of = of[np.isfinite(of[:, 1])] if np.isfinite(of[:, 1]).any() else of
        noise = np.median(of[:, 0])
        typical = np.median(of[:, 1])
        most = np.max(of[:, 2])
        lasts = max(ends_s, default=0.0) - min(ends_s, default=0.0)
        lag_s = w.chain.lag_s
        if lasts < lag_s:
            found.append(warning("sensor.brief", subject=w.column, duration_s=lasts, lag_s=lag_s))
        table.append(
            {"column": w.column, "noise_sd_K": noise, "sd_typical_K": typical, "sd_max_K": most}
        )
    return CompensatedTable(
        Path(out), rows, tuple(worn), tuple(others), pd.DataFrame(table), notes, once_each(found)
    )


def worn_in(
    names: Sequence[str],
    where: str,
    sensors: Sequence[SensorFile],
    columns: Sequence[str],
    unit: Mapping[str, str] | str,
    couple: str,
    cold: float | str,
    unit_row: Mapping[str, str] | None = None,
) -> tuple[list[Worn], list[Finding]]:
    """Those of a table's columns ``names`` that sensors cover, in their order. Raises InputError as
    ``compensate_table``."""
    if not sensors:
        raise InputError(
            "no sensor was given",
            remedy="add {sensors}",
            parameters={"sensors": "FILE.sensor.json"},
        )
    if columns and (len(sensors) > 1 or len(sensors[0].columns) > 1):
        raise InputError(
            "columns were named for several sensors", expected="one sensor of one column"
        )
    taken: dict[str, tuple[SensorFile, int]] = {}
    for file in sensors:
        for at, pattern in enumerate(file.columns):
            for name in [n for c in (columns or [pattern]) for n in matching(c, names, where)]:
                if name in taken:
                    raise InputError(
                        f"two sensors for column {name!r}",
                        where=where,
                        expected="one sensor a column",
                    )
                taken[name] = file, at
    own = [n for n in names if n in taken]
    units, told = units_of(own, unit, couple, cold, unit_row)
    told += [f for file in sensors for f in file.findings if f.code == ALTERED]
    return [Worn(n, *taken[n], units[n]) for n in own], told


def _answered(
    stretch: Part, worn: Sequence[Worn], where: str
) -> tuple[dict[str, Array], dict[str, Array], list[Finding], int]:
    """Columns of the output for the rows to keep; noise, typical and largest deviation of each sensor column [K].

    Last, how many rows beside the stretch the smoother needs to settle.
    """
    keep = stretch.keep
    found = list(stretch.findings)
    out = {n: v[keep] for n, v in stretch.data.items()}
    numbers: dict[str, Array] = {}
    read = {w.column: _read(w, stretch) for w in worn}
    for w in worn:
        found += doubtful(w.column, w.unit, stretch.data[w.column])
        name, u_name = w.unit.names(w.column)
        out[name] = out[u_name] = np.full(len(out[w.column]), np.nan)
    if len(stretch.time_s) < 10:
        return out, numbers, [*found, warning("sensor.short", count=len(stretch.time_s))], 0
    grid, told = places(stretch.time_s, where)
    found += told
    size = int(grid.place[-1]) + 1
    group = min(max(int(MOST_VALUES / size), 1), MOST_COLUMNS)
    memory = 0.0
    alive = [w for w in worn if np.count_nonzero(np.isfinite(read[w.column])) >= 10]
    found += [warning("sensor.dead", subject=w.column) for w in worn if w not in alive]
    for first in range(0, len(alive), group):
        for done_for, done in _smoothed(alive[first : first + group], read, grid, size, found):
            temperature, sd_all = done.answers()
            for k, w in enumerate(done_for):
                at = grid.place[keep]
                x = temperature[at, k]
                sd = sd_all[at, k]
                memory = max(
                    memory,
                    settled_s(
                        sensors_of([w.chain]),
                        done.noise_sd[k : k + 1],
                        grid.dt_s,
                        done.intensities[k : k + 1],
                    ),
                )
                if x.size and np.median(grid.dt_s / max(w.chain.lag_s, 1e-12)) > 0.5:
                    found.append(
                        warning(
                            "sensor.slow", subject=w.column, dt_s=grid.dt_s, lag_s=w.chain.lag_s
                        )
                    )
                name, u_name = w.unit.names(w.column)
                out[name] = np.round(w.unit.back(x), DECIMALS)
                out[u_name] = np.round(w.unit.per_K * sd, DECIMALS)
                numbers[w.column] = (
                    np.array([done.noise_sd[k], np.nanmedian(sd), np.nanmax(sd)])
                    if np.isfinite(sd).any()
                    else np.full(3, np.nan)
                )
            found += list(done.findings)
    return out, numbers, found, int(np.ceil(memory / grid.dt_s))


def _smoothed(
    worn: Sequence[Worn],
    read: Mapping[str, Array],
    grid: EvenTimes,
    size: int,
    found: list[Finding],
) -> Iterator[tuple[Sequence[Worn], Compensated]]:
    """The smoother for columns together; one by one where one of them cannot be smoothed, which is told."""
    y = np.stack([on_grid(read[w.column], grid, size) for w in worn], axis=1)
    covariance = np.zeros((len(worn), len(worn)))
    for i, a in enumerate(worn):
        for j, b in enumerate(worn):
            if a.file is b.file:
                covariance[i, j] = a.file.lag_covariance_s2[a.at, b.at]
    line_u = np.zeros_like(y)
    for k, w in enumerate(worn):
        if w.line:
            line_u[:, k] = whole_u(w.line, y[:, k])
    try:
        done = smooth(
            y,
            grid.dt_s,
            [w.chain for w in worn],
            lag_covariance=covariance,
            split_u_s=[float(w.file.split_u_s[w.at]) for w in worn],
            static_u=np.nan_to_num(line_u),
            names=[w.column for w in worn],
        )
    except InputError as problem:
        if len(worn) == 1:
            found.append(warning("sensor.left", subject=worn[0].column, problem=problem.what))
            return
        for w in worn:
            yield from _smoothed([w], read, grid, size, found)
        return
    yield worn, done


def _read(w: Worn, stretch: Part) -> Array:
    """What a column reads (N,) [degC], after its static line."""
    cold = stretch.data[w.unit.cold] if isinstance(w.unit.cold, str) else w.unit.cold
    degC = w.unit.in_degC(stretch.data[w.column], cold)
    return np.asarray(apply_static(degC, w.line) if w.line else degC)
