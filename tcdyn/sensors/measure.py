"""The lag of a sensor from a table: a dip, a pair, a current step, or the noise of the process.

A table is a file, a DataFrame, a Series or arrays. ``tcdyn sensor`` calls the same functions. The
estimators are in the other modules of the package. Tests: ``tests/sensors/test_measure.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.arguments import as_names, with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, unique_by_subject, warning
from tcdyn.core.options import options_of
from tcdyn.io.read import sha256_of_file
from tcdyn.rig.record import InputFile
from tcdyn.sensors.current import current_sensor
from tcdyn.sensors.dips import dip_with_law, pool_dips
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.medium import Surroundings
from tcdyn.sensors.noise import noise_sensor
from tcdyn.sensors.options import CurrentOptions, DipOptions, PairOptions
from tcdyn.sensors.pair import OFFSET_SD_K, pair_sensor
from tcdyn.sensors.plunge import plunge_sensor
from tcdyn.sensors.surface_h import BoundaryLayer
from tcdyn.series import SeriesReport, open_source
from tcdyn.series.joined import files_of_log
from tcdyn.series.options import TableOptions
from tcdyn.series.read import read_series
from tcdyn.series.series import DIP, ONE_PIECE, Policy
from tcdyn.series.units import (
    Unit,
    check_declared,
    check_millivolts,
    cold_column,
    match_columns,
    unit_findings,
    units_of,
)

# Standard uncertainty of a lag in another stream over the lag, from which there is a warning; by
# judgement.
UNKNOWN_SHARE = 0.5
ABOUT_MEANS = ("series.averages",)  # findings about rows that are means
# A file, files of one log, a DataFrame with a time, a Series over time, or a tuple of times [s] and
# arrays.
TableLike = str | Path | Sequence[str | Path] | pd.DataFrame | pd.Series | tuple[ArrayLike, ...]


@dataclass(frozen=True)
class Readings:
    """Columns of a table on even times.

    Attributes
    ----------
    time_s
        Even times (N,) [s].
    values
        Temperatures (N,) [degC] or other quantities in their unit, then other columns (N,) as they
        are; NaN without a reading.
    names
        Names of these columns.
    report
        What was understood of the table.
    findings
        Findings of the reader.
    inputs
        The file; empty for data in memory.
    units
        Units of the columns before the others.
    """

    time_s: Array
    values: tuple[Array, ...]
    names: tuple[str, ...]
    report: SeriesReport
    findings: tuple[Finding, ...]
    inputs: tuple[InputFile, ...]
    units: tuple[Unit, ...] = ()

    @property
    def unit(self) -> str:
        """Unit of differences of the first column: K for all temperatures."""
        return self.units[0].base_difference if self.units else "K"

    def without_means(self) -> Readings:
        """The same, of which a fit removes the means of the rows: nothing is to be said of them."""
        findings = tuple(f for f in self.findings if f.code not in ABOUT_MEANS)
        has_means = len(findings) < len(self.findings) and self.report.averages_s
        if has_means:
            finding = info("sensor.dip_means", averages_s=self.report.averages_s)
            findings = (*findings, finding)
        return replace(self, findings=findings)

    def repeats_values(self, name: str) -> bool:
        """Whether a column was repeated between its new values."""
        of_column = [column for column in self.report.columns if column.name == name]
        return any(each.reason == "repeat" for column in of_column for each in column.left_out)


def read_readings(
    data: TableLike,
    columns: Sequence[str],
    others: Sequence[str] = (),
    options: TableOptions | None = None,
    *,
    several: bool = False,
    needs_millivolts: bool = True,
    policy: Policy = ONE_PIECE,
) -> Readings:
    """Read columns of a table of any kind.

    Parameters
    ----------
    data
        A file, several files of one log, a DataFrame, a Series, or a tuple of times [s] and arrays
        (N,) that ``columns`` and ``others`` name.
    columns
        Columns of readings, or patterns that match one each; none: the only column.
    others
        Other columns, such as a speed or a current.
    options
        How the table is read.
    several
        Whether a pattern may match several columns.
    needs_millivolts
        Whether ``couple`` or ``cold_junction`` without a column in mV is an error.
    policy
        What is tolerated in the rows.

    Raises
    ------
    InputError
        For columns that are missing or not clear, and times that cannot be used.
    """
    files = files_of_log(data)
    table_data: Any = files or data
    if isinstance(data, tuple) and not files:
        table_data = _frame_of_arrays(data, [*columns, *others])
    options = options or TableOptions()
    source = open_source(table_data, [*columns, *others], options.rows)
    inputs = tuple(InputFile.of_path(path, sha256_of_file(path)) for path in files)
    table = source.table
    candidates = source.value_columns
    if not columns:
        columns = [name for name in candidates if name not in others and not table.is_time(name)]
        if len(columns) != 1:
            raise InputError(
                f"{len(columns)} columns",
                where=table.where,
                expected="the name of one",
                remedy="give {column}",
                parameters={"column": columns[0] if columns else "NAME"},
            )
    names: list[str] = []
    for pattern in (*columns, *others):
        matches = match_columns(pattern, candidates, table.where)
        if len(matches) > 1 and not several:
            raise InputError(
                f"{pattern!r} matches {len(matches)} columns",
                where=table.where,
                expected="one",
                remedy=f"for example name {matches[0]!r}",
            )
        names += matches
    if several:
        names = list(dict.fromkeys(names))
    temperatures = names[: len(names) - len(others)]
    is_needed = needs_millivolts
    if needs_millivolts:
        check_declared(options.units, table.names, table.where)
    else:
        stated, _ = units_of(
            temperatures,
            options.units,
            options.couple,
            unit_row=table.units,
            needs_millivolts=False,
        )
        is_needed = any(each.name == "mV" for each in stated.values())
    reference: float | str = 0.0
    if is_needed:
        reference = cold_column(options.cold, table.names, table.where)
    units, findings = units_of(
        temperatures,
        options.units,
        options.couple,
        reference,
        table.units,
        needs_millivolts=needs_millivolts,
    )
    series = read_series(source, units, names[len(temperatures) :], policy)
    for name in temperatures:
        logged = units[name].from_base(series.readings[name])
        findings += unit_findings(name, units[name], logged)
    return Readings(
        series.time_s,
        tuple(series.on_grid(name) for name in names),
        tuple(names),
        series.report,
        (*findings, *series.findings),
        inputs,
        tuple(units[name] for name in temperatures),
    )


def _frame_of_arrays(data: tuple[ArrayLike, ...], names: Sequence[str]) -> pd.DataFrame:
    """Times [s] and arrays as a table.

    Raises
    ------
    InputError
        For another number of arrays than of names, or unequal lengths.
    """
    arrays = [np.asarray(values, dtype=float) for values in data]
    names = names or ["reading"]
    if len(arrays) != len(names) + 1 or len({np.shape(a) for a in arrays}) != 1:
        shapes = ", ".join(str(np.shape(a)) for a in arrays)
        raise InputError(
            f"{len(arrays)} arrays of the shapes {shapes}",
            expected=f"times in seconds and {len(names)} more of the same length (N,)",
        )
    return pd.DataFrame(dict(zip(names, arrays[1:])), pd.Index(arrays[0], name="time_s"))


@with_named_arguments
def sensor_from_dip(
    data: TableLike | list[Any],
    column: str | None = None,
    *,
    name: str = "sensor",
    **options: Any,
) -> SensorFile:
    """Lag, t50, t63.2 and t90 of a sensor from one temperature step (a dip), or from several.

    Parameters
    ----------
    data
        The dip: a file, a DataFrame, a Series over time, or a tuple of times [s] and readings
        [degC]; or a list of several dips of one sensor, each in its own unit. The uncertainty then
        includes the spread between dips.
    column
        Column of the sensor; None: the only one.
    name
        Name of the sensor.
    options
        How the dip is read and evaluated: the fields of :class:`tcdyn.sensors.options.DipOptions`,
        such as ``entry_s=(12.3, 0.02)``, ``medium="water"``, ``diameter_mm=3`` and ``unit="degF"``.
        With ``at=["speed_m_s=1", "speed_m_s=4"]``, the flow of each dip, the sensor has the law of
        its lag.

    Returns
    -------
    SensorFile
        The result; ``write(path)`` makes the sensor file.

    Raises
    ------
    InputError
        For a table without a step that can be used.

    Examples
    --------
    >>> t = 0.05 * np.arange(600)
    >>> rise = np.where(t > 5, 1 - np.exp(-(t - 5) / 1.5), 0.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.05, len(t))
    >>> dip = pd.Series(20 + 60 * rise + noise, pd.Index(t, name="time_s"), name="T1_degC")
    >>> probe = sensor_from_dip(dip, name="probe", entry_s=5.0)
    >>> probe.sensor, probe.columns
    ('probe', ['T1_degC'])
    >>> abs(probe.chain.channels["T1_degC"].lag_s.value - 1.5) < 0.1
    True
    """
    settings = options_of(DipOptions, options, "sensor_from_dip")
    film = settings.boundary_layer
    flows = settings.flows
    other = settings.other_stream
    tables = data if isinstance(data, list) else [data]
    entries: Sequence[tuple[float, float] | None] = settings.entries_s or [None] * len(tables)
    if len(entries) != len(tables):
        raise InputError(
            f"{{entry_s}} is given {len(entries)} times for {len(tables)} dips",
            expected="once for each dip, or not at all",
            parameters={"entry_s": None},
        )
    if flows is not None and len(flows.values) != len(tables):
        raise InputError(
            f"{{at}} is given {len(flows.values)} times for {len(tables)} dips",
            expected="once for each dip, or not at all",
            parameters={"at": None},
        )
    dips = []
    units: list[Unit] = []
    for table, entry in zip(tables, entries):
        # of several dips only some may be in mV
        dip = read_readings(
            table,
            _as_list(column),
            options=settings,
            needs_millivolts=len(tables) == 1,
            policy=DIP,
        )
        units += dip.units
        if film is not None or settings.junction != "insulated":
            check_temperatures(dip, "{medium} or {junction}")

        fit = partial(
            plunge_sensor,
            dip.time_s,
            dip.values[0],
            dip.names[0],
            sensor=name,
            conditioning=settings.conditioning,
            entry_s=entry,
            medium_s=settings.lag_of_medium_s,
            film=film,
            junction=settings.junction,
            mean_s=settings.averages_s or 0.0,
            unit=dip.unit,
            inputs=list(dip.inputs),
        )
        dips.append(_with_reader_findings(dip.without_means(), fit))
    if len(dips) == 1:
        one = dips[0] if flows is None else dip_with_law(dips[0], flows)
        return _with_other_stream(one, film, other)
    if settings.couple or settings.cold:
        check_millivolts(units)
    pooled = _with_other_stream(pool_dips(dips, name, film, flows), film, other)
    return pooled.model_copy(update={"reading": [each for dip in dips for each in dip.reading]})


def _with_other_stream(
    sensor: SensorFile, film: BoundaryLayer | None, other: tuple[Surroundings, float] | None
) -> SensorFile:
    """The sensor with its lag and times in another stream in ``fit``; as it is without one."""
    if film is None or other is None:
        return sensor
    column = sensor.columns[0]
    lag = Estimate(**sensor.fit["lag_s"])
    there = film.in_other(lag, sensor.times[column], *other)
    found = list(other[0].findings())
    to_lag = Estimate(**cast("dict[str, float]", there["to_lag_s"]))
    if to_lag.u > UNKNOWN_SHARE * to_lag.value:
        found.append(warning("sensor.other_stream", subject=column, lag_s=to_lag.value, u=to_lag.u))
    else:
        finding = info(
            "sensor.in_other",
            subject=column,
            medium=other[0].medium,
            speed_m_s=other[0].speed_m_s,
            lag_s=to_lag.value,
            u=to_lag.u,
        )
        found.append(finding)
    update = {"fit": sensor.fit | there, "findings": [*sensor.findings, *found]}
    return sensor.model_copy(update=update)


@with_named_arguments
def sensor_from_pair(
    data: TableLike,
    columns: tuple[str, str] | Sequence[str] = (),
    *,
    name: str = "pair",
    **options: Any,
) -> SensorFile:
    """Lags of two thermocouples of different size in one fluid, without a reference.

    Parameters
    ----------
    data
        A file, several files of one log, a DataFrame, or a tuple of times [s], both readings [degC]
        and the speed if any.
    columns
        The two columns; of a DataFrame with two columns they need not be named.
    name
        Name of the pair.
    options
        How the table is read and evaluated: the fields of
        :class:`tcdyn.sensors.options.PairOptions`.

    Returns
    -------
    SensorFile
        The result for both columns.

    Raises
    ------
    InputError
        For a table from which the lags cannot be determined.

    Examples
    --------
    >>> from tcdyn.chain import Chain
    >>> t = 0.02 * np.arange(1500)
    >>> rng = np.random.default_rng(0)
    >>> gas = 400 + np.cumsum(rng.normal(0.0, 4.0, len(t)))
    >>> wires = {f"T{k}": Chain(lag).response(gas, 0.02) for k, lag in ((1, 0.1), (2, 0.3))}
    >>> table = pd.DataFrame(wires, pd.Index(t, name="time_s")) + rng.normal(0, 0.1, (len(t), 2))
    >>> pair = sensor_from_pair(table, bare=True, unit="degC")
    >>> [round(pair.chain.channels[name].lag_s.value, 1) for name in pair.columns]
    [0.1, 0.3]
    """
    settings = options_of(PairOptions, options, "sensor_from_pair")
    exponent = settings.prior_of_exponent
    others = [] if settings.speed is None else [settings.speed]
    named = as_names("columns", columns)
    if not named and isinstance(data, pd.DataFrame):
        named = [
            str(label)
            for label in data.columns
            if str(label) not in (settings.speed, settings.time)
        ]
    elif not named and isinstance(data, tuple):
        named = ["first", "second"]
    if len(named) != 2 or named[0] == named[1]:
        raise InputError(
            f"the columns are {' and '.join(named) or 'not named'}", expected="two columns"
        )
    table = read_readings(data, named, others, settings)

    fit = partial(
        pair_sensor,
        table.time_s,
        table.values[0],
        table.values[1],
        (table.names[0], table.names[1]),
        sensor=name,
        speed=table.values[2] if settings.speed else None,
        changes_s=settings.flow_steps_s,
        exponent=exponent,
        inner_share=settings.prior_of_inner_share,
        quantity=settings.speed or "speed",
        bare=settings.bare,
        repeats_values=any(table.repeats_values(name) for name in table.names),
        offset_sd=OFFSET_SD_K if table.units[0].is_temperature else None,
        inputs=list(table.inputs),
    )
    return _with_reader_findings(table, fit)


@with_named_arguments
def sensor_from_current(
    data: TableLike,
    column: str | None = None,
    current: str = "current",
    *,
    name: str = "sensor",
    **options: Any,
) -> SensorFile:
    """Lag in place from a loop current step (LCSR), converted to that of a plunge.

    Parameters
    ----------
    data
        A file, several files of one log, a DataFrame, or a tuple of times [s], readings [degC] and
        current.
    column
        Column of the sensor; None: the only one beside the current.
    current
        Column of the heating current, in any unit.
    name
        Name of the sensor.
    options
        How the table is read and evaluated: the fields of
        :class:`tcdyn.sensors.options.CurrentOptions`.

    Returns
    -------
    SensorFile
        The result.

    Raises
    ------
    InputError
        For a table without a response to the current that can be used.

    Examples
    --------
    >>> from tcdyn.chain import Chain
    >>> t = 0.4 * np.arange(120)
    >>> on = ((t > 3) & (t < 25)).astype(float)
    >>> heat = 8 * Chain([3.0, 0.4]).response(on, 0.4, "zoh")
    >>> noise = np.random.default_rng(0).normal(0.0, 0.02, len(t))
    >>> sensor = sensor_from_current((t, 200 + heat + noise, on))  # doctest: +SKIP
    >>> sensor.chain.channels["reading"].lag_s.contains(3.4)  # doctest: +SKIP
    True
    """
    settings = options_of(CurrentOptions, options, "sensor_from_current")
    columns = _as_list(column) or (["reading"] if isinstance(data, tuple) else [])
    table = read_readings(data, columns, [current], settings)
    check_temperatures(table, "a loop current step")

    fit = partial(
        current_sensor,
        table.time_s,
        table.values[0],
        table.values[1],
        table.names[0],
        sensor=name,
        off_only=settings.off_only,
        inputs=list(table.inputs),
    )
    return _with_reader_findings(table, fit)


@with_named_arguments
def sensor_from_noise(
    data: TableLike, column: str | None = None, *, name: str = "sensor", **options: Any
) -> SensorFile:
    """Lag in place from the noise of the process at constant conditions.

    Parameters
    ----------
    data
        A file, several files of one log, a DataFrame, a Series over time, or a tuple of times [s]
        and readings [degC].
    column
        Column of the sensor; None: the only one.
    name
        Name of the sensor.
    options
        How the table is read: the fields of :class:`tcdyn.series.options.TableOptions`.

    Returns
    -------
    SensorFile
        The result; warnings report conditions that are not constant.

    Raises
    ------
    InputError
        For a record that is too short.

    Examples
    --------
    >>> from tcdyn.chain import Chain
    >>> rng = np.random.default_rng(0)
    >>> reading = Chain(1.0).response(rng.normal(300.0, 5.0, 20000), 0.02)[::5]
    >>> reading += rng.normal(0.0, 0.01, len(reading))
    >>> sensor = sensor_from_noise((0.1 * np.arange(len(reading)), reading), "T1")
    >>> abs(sensor.chain.channels["T1"].lag_s.value - 1.0) < 0.3
    True
    """
    settings = options_of(TableOptions, options, "sensor_from_noise")
    table = read_readings(data, _as_list(column), options=settings)

    fit = partial(
        noise_sensor,
        table.time_s,
        table.values[0],
        table.names[0],
        sensor=name,
        inputs=list(table.inputs),
    )
    return _with_reader_findings(table, fit)


def _as_list(column: str | None) -> list[str]:
    """The column as a list; empty for None."""
    return [] if column is None else [column]


def check_temperatures(table: Readings, what: str) -> None:
    """Check that columns are temperatures where a thermocouple is modelled.

    Parameters
    ----------
    table
        The columns.
    what
        What is modelled, for the message.

    Raises
    ------
    InputError
        For another quantity.
    """
    for name, unit in zip(table.names, table.units):
        if not unit.is_temperature:
            raise InputError(
                f"{what} for column {name!r}, which is in {unit.name}",
                expected="a temperature: heat transfer says nothing about another quantity",
                remedy="leave it out",
                parameters={"medium": None, "junction": None},
            )


def _with_reader_findings(table: Readings, fit: Callable[[], SensorFile]) -> SensorFile:
    """The result of a fit, with the findings of the reader in front.

    A warning is added for each lag whose standard uncertainty exceeds the length of the record.

    Parameters
    ----------
    table
        The columns that are fitted.
    fit
        The fit.

    Raises
    ------
    InputError
        That of the fit, with the name of the file.
    """
    try:
        sensor = fit()
    except InputError as problem:
        raise problem.at(table.inputs[0].file if table.inputs else "") from None
    findings = list(table.findings)
    duration_s = float(table.time_s[-1] - table.time_s[0])
    for column, channel in sensor.chain.channels.items():
        u_s = channel.lag_s.u
        if u_s > duration_s:
            findings.append(
                warning("sensor.undetermined", subject=column, u_s=u_s, duration_s=duration_s)
            )
    all_findings = [*unique_by_subject(findings), *sensor.findings]
    result = sensor.model_copy(
        update={"findings": all_findings, "reading": [table.report.to_dict()]}
    )
    return result.in_unit(table.unit)
