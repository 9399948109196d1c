"""The lag of one sensor against date: table, change with time, and its test.

``tcdyn sensor history`` uses it. Tests: ``tests/sensors/test_history.py``; rates of false alarms
and coverage: ``python -m tests.sensors.history_study``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, labelled_messages, warning
from tcdyn.core.options import options_of
from tcdyn.core.result import Result, json_text
from tcdyn.io.column_names import column_named
from tcdyn.io.endings import CSV_OR_JSON, check_ending
from tcdyn.io.metadata import RESULTS
from tcdyn.io.unit_names import is_same_name
from tcdyn.io.write import write_log, write_text
from tcdyn.rig.record import parse_time
from tcdyn.sensors.change import Change, find_change
from tcdyn.sensors.file import MEASURED, SensorFile, read_sensor
from tcdyn.sensors.history_options import HistoryOptions
from tcdyn.sensors.spread import MIN_WITHIN_U

# Share of steady sensors that get a warning; checked by `python -m tests.sensors.history_study`.
FALSE_ALARM_RATE = 0.05
# Entries of ``fit`` with an uncertainty that all measurements of one method share [s].
SHARED = ("tail_u_s", "model_u_s")
DAY_S = 86400.0
ISO = "%Y-%m-%d %H:%M"
OF_LOG, GIVEN = "log", "given"  # sources of a date


@dataclass(frozen=True)
class LagMeasurement:
    """One measurement of a lag.

    Attributes
    ----------
    date
        When it was measured.
    date_source
        "log" (time of the first row) or "given".
    lag_s
        The lag without the filter [s]; of several dips the mean of many.
    shared_u_s
        Part of its standard uncertainty that all measurements of the group share [s].
    group
        Method, medium and law.
    file
        Name of the sensor file, or of the log.
    """

    date: datetime
    date_source: str
    lag_s: Estimate
    shared_u_s: float
    group: str
    file: str

    @property
    def own_u_s(self) -> float:
        """Standard uncertainty that differs from measurement to measurement [s]."""
        variance = self.lag_s.u**2 - self.shared_u_s**2
        return float(max(variance, (MIN_WITHIN_U * self.lag_s.value) ** 2) ** 0.5)


@dataclass(frozen=True)
class GroupHistory:
    """Measurements under one condition, and their change.

    Attributes
    ----------
    name
        Method, medium and law.
    measurements
        The measurements, by date.
    change
        How the lag changed; None where there are not two dates.
    is_significant
        Whether its p value is below the rate of false alarms.
    """

    name: str
    measurements: tuple[LagMeasurement, ...]
    change: Change | None
    is_significant: bool

    @property
    def first(self) -> datetime:
        """Date of the first measurement."""
        return self.measurements[0].date

    def date_at(self, days: float) -> datetime:
        """Date at a time of the change [d]."""
        return self.first + timedelta(days=days)

    def summary_lines(self) -> list[str]:
        """Number of measurements, change, and its test."""
        change = self.change
        count = len(self.measurements)
        if change is None:
            return [f"  {self.name}: {count} measured, no two dates: no change is estimated"]
        days = (self.measurements[-1].date - self.first).total_seconds() / DAY_S
        share_of_u = max(each.shared_u_s / each.lag_s.value for each in self.measurements)
        steady = change.per_year.scaled(100)
        lines = [
            f"  {self.name}: {count} measured in {days:.0f} days, spread between them "
            f"{100 * change.model.median_spread:.2g} %",
            f"    change {change.total.scaled(100).text_without_interval('%')} (95 %: "
            f"{100 * change.total.low95:+.2g} to {100 * change.total.high95:+.2g} %), p = "
            f"{change.p_value:.2g}; if steady, {steady.text_without_interval('% a year')}",
        ]
        if self.is_significant:
            low, high = (f"{self.date_at(d):%Y-%m-%d}" for d in change.step_range_days)
            step = change.step.scaled(100).text_without_interval("%")
            lines.append(
                f"    probability of a step rather than a steady change "
                f"{change.step_probability:.2g}: {step} between {low} and {high}"
            )
        if share_of_u > 0:
            lines.append(
                f"    up to {100 * share_of_u:.2g} % of each lag is an uncertainty that all share: "
                "it is not part of the change"
            )
        return lines


@dataclass(frozen=True, repr=False)
class SensorHistory(Result):
    """Lag of one sensor against date.

    Attributes
    ----------
    column
        Column of the sensor.
    groups
        Measurements under one condition each, and their change.
    findings
        Warnings and infos.
    """

    column: str
    groups: tuple[GroupHistory, ...]
    findings: tuple[Finding, ...] = field(default=())

    @property
    def measurements(self) -> list[LagMeasurement]:
        """All measurements by date."""
        listed = [each for group in self.groups for each in group.measurements]
        return sorted(listed, key=lambda each: each.date)

    def summary(self) -> str:
        """Dates, table, change of each group, and findings."""
        listed = self.measurements
        sources = {each.date_source for each in listed}
        source = "as given" if sources == {GIVEN} else "of the first row of each log"
        lines = [
            f"{self.column}: {len(listed)} measurements from {listed[0].date:%Y-%m-%d} to "
            f"{listed[-1].date:%Y-%m-%d}; dates {source}"
        ]
        for group in self.groups:
            lines += group.summary_lines()
        if len(self.groups) > 1:
            lines.append("  groups are not compared: a lag depends on method, medium and flow")
        table = self.to_frame().reset_index()[["date", "lag_s", "lag_u_s", "group", "file"]]
        lines.append(table.to_string(index=False, float_format="{:.4g}".format))
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def to_frame(self) -> pd.DataFrame:
        """One row a measurement, by date."""
        rows = [
            {
                "date": each.date.strftime(ISO),
                "lag_s": each.lag_s.value,
                "lag_u_s": each.lag_s.u,
                "own_u_s": each.own_u_s,
                "group": each.group,
                "file": each.file,
                "date_source": each.date_source,
            }
            for each in self.measurements
        ]
        return pd.DataFrame(rows).set_index("date")

    def to_dict(self) -> dict[str, Any]:
        """Measurements, and the change of each group."""
        groups = []
        for group in self.groups:
            entry: dict[str, Any] = {
                "group": group.name,
                "measurements": len(group.measurements),
                "significant": group.is_significant,
            }
            change = group.change
            if change is not None:
                entry |= {
                    "change": change.total.model_dump(),
                    "change_per_year": change.per_year.model_dump(),
                    "p_value": change.p_value,
                    "spread": change.model.median_spread,
                    "step_probability": change.step_probability,
                    "step": change.step.model_dump(),
                    "step_dates": [group.date_at(d).strftime(ISO) for d in change.step_days],
                    "step_dates95": [
                        group.date_at(d).strftime(ISO) for d in change.step_range_days
                    ],
                }
            groups.append(entry)
        return {
            "column": self.column,
            "groups": groups,
            "measurements": self.to_frame().reset_index().to_dict("records"),
            "findings": [finding.to_dict() for finding in self.findings],
        }

    def write(self, path: str | Path) -> Path:
        """Write the table (.csv), or all of the result (.json).

        Parameters
        ----------
        path
            File to write.

        Raises
        ------
        InputError
            For another ending.
        """
        target = Path(path)
        check_ending(target, CSV_OR_JSON)
        if target.suffix.lower() == ".json":
            return write_text(target, json_text(self.to_dict()))
        return write_log(self.to_frame().reset_index(), target, {"tcdyn": RESULTS})


@with_named_arguments
def sensor_history(
    sensors: Sequence[str | Path | SensorFile], *, files: Sequence[str] = (), **options: Any
) -> SensorHistory:
    """Lag of one sensor against date, and whether it changed.

    Parameters
    ----------
    sensors
        Sensor files, or results of ``sensor_from_noise`` and the other methods: at least two.
    files
        Names of the measurements; empty: those of the files, or of their logs.
    **options
        The fields of :class:`tcdyn.sensors.history_options.HistoryOptions`: ``column`` and
        ``dates``.

    Returns
    -------
    SensorHistory
        The result. Measurements are compared with others of the same method, medium, speed and law
        only, since a lag depends on them.

    Raises
    ------
    InputError
        For fewer than two measurements, a lag that was not measured, files of different columns, a
        measurement that is given twice, and dates that are missing or all equal.

    Notes
    -----
    A standard uncertainty that all measurements of one method share, such as ``tail_u_s`` of dips
    and ``model_u_s`` of noise, is the same error in each of them: it is left out of a change. The
    rate of false alarms is that of the whole history; with G groups each has a G-th of it.

    Examples
    --------
    >>> from tcdyn.sensors import specified_sensor
    >>> lags = [(2.0, 0.03), (2.1, 0.03), (2.2, 0.03), (2.3, 0.03), (2.4, 0.03), (2.5, 0.03)]
    >>> files = [specified_sensor("pipe", ["T1"], [lag]) for lag in lags]
    >>> files = [each.model_copy(update={"method": "noise"}) for each in files]
    >>> dates = [f"2025-{month}-01" for month in ("01", "03", "05", "07", "09", "11")]
    >>> history = sensor_history(files, dates=dates)
    >>> history.groups[0].is_significant, len(history.to_frame())
    (True, 6)
    """
    settings = options_of(HistoryOptions, options, "sensor_history")
    read = [each if isinstance(each, SensorFile) else read_sensor(each) for each in sensors]
    names = list(files)
    if not names:
        names = [_name(each, sensor) for each, sensor in zip(sensors, read)]
    if len(read) < 2:
        raise InputError(
            f"{len(read)} measurements of a lag",
            expected="at least two, measured at different dates",
            remedy="measure again later",
        )
    column = _common_column(read, names, settings.column)
    _check_different(read, names)
    measurements = _measurements(read, names, column, settings)
    if len({each.date for each in measurements}) == 1:
        raise InputError(
            f"all measurements have the date {measurements[0].date:{ISO}}",
            expected="at least two dates",
            remedy="measure again later; to compare sensors: tcdyn sensor compare",
        )
    groups = _groups(measurements)
    return SensorHistory(column, groups, tuple(_findings(column, groups)))


def shared_u_s(sensor: SensorFile) -> float:
    """Part of the standard uncertainty of the lag that other measurements by its method share [s].

    >>> from tcdyn.sensors import specified_sensor
    >>> shared_u_s(specified_sensor("probe", ["T1"], [(1.5, 0.1)], fit={"tail_u_s": 0.05}))
    0.05
    """
    return float(np.hypot(*(sensor.fit.get(key, 0.0) for key in SHARED)))


def measured_lag_s(sensor: SensorFile, column: str) -> Estimate:
    """Lag of a column without the filter [s]; of several dips the mean of many.

    Parameters
    ----------
    sensor
        The sensor.
    column
        Its column.
    """
    if "mean_lag_s" in sensor.fit:
        return Estimate(**sensor.fit["mean_lag_s"])
    return sensor[column].lag_s.shifted(-sensor.conditioning.lag_s)


def condition(sensor: SensorFile) -> str:
    """Method, medium, speed and law, on which a lag depends.

    >>> from tcdyn.sensors import specified_sensor
    >>> fit = {"medium": "water", "speed_m_s": 0.4}
    >>> condition(specified_sensor("probe", ["T1"], [(1.5, 0.1)], fit=fit))
    'stated in water at 0.4 m/s'
    """
    text: str = sensor.method
    if "medium" in sensor.fit:
        text += f" in {sensor.fit['medium']} at {sensor.fit['speed_m_s']:.3g} m/s"
    if sensor.law is not None:
        text += f" at {sensor.law.quantity} = {sensor.law.at:.3g}"
    return text


def _name(given: str | Path | SensorFile, sensor: SensorFile) -> str:
    """Name of a measurement: that of its file, of its logs, or of the sensor."""
    if not isinstance(given, SensorFile):
        return utf8(Path(given).name)
    return ", ".join(source.file for source in sensor.inputs) or sensor.sensor


def _common_column(sensors: Sequence[SensorFile], names: Sequence[str], column: str | None) -> str:
    """The column that all files have.

    Parameters
    ----------
    sensors, names
        The files and their names.
    column
        The column that is stated; None: the only one.

    Raises
    ------
    InputError
        For files of several or different columns.
    """
    for sensor, name in zip(sensors, names):
        if column is not None:
            column_named(column, sensor.columns, name)
        elif len(sensor.columns) > 1:
            raise InputError(
                f"has the columns {', '.join(sensor.columns)}",
                where=name,
                expected="the name of one",
                remedy="give {column}",
                parameters={"column": sensor.columns[0]},
            )
        elif not is_same_name(sensors[0].columns[0], sensor.columns[0]):
            raise InputError(
                f"the column is {sensor.columns[0]}, that of {names[0]} is {sensors[0].columns[0]}",
                where=name,
                expected="measurements of one sensor",
                remedy="to compare sensors: tcdyn sensor compare",
            )
    return column or sensors[0].columns[0]


def _check_different(sensors: Sequence[SensorFile], names: Sequence[str]) -> None:
    """Raise InputError for a lag that was not measured, and for one log that is used twice."""
    seen: dict[str, str] = {}
    for sensor, name in zip(sensors, names):
        if sensor.method not in MEASURED:
            raise InputError(
                f"its lag is {sensor.method}, not measured",
                where=name,
                expected=" or ".join(MEASURED),
                remedy="leave it out",
            )
        for source in sensor.inputs:
            first = seen.setdefault(source.sha256, name)
            if first != name:
                raise InputError(
                    f"was made from {source.file}, as was {first}",
                    where=name,
                    expected="different measurements",
                    remedy="give each once",
                )


def _measurements(
    sensors: Sequence[SensorFile], names: Sequence[str], column: str, settings: HistoryOptions
) -> list[LagMeasurement]:
    """The measurements of the files; parameters as of ``sensor_history``."""
    given = settings.given_dates
    if given and len(given) != len(sensors):
        raise InputError(
            f"{{dates}} is given {len(given)} times for {len(sensors)} measurements",
            expected="once for each, in their order, or not at all",
            parameters={"dates": None},
        )
    dates: Sequence[datetime | None] = given or [_date_of_log(sensor) for sensor in sensors]
    missing = [name for name, date in zip(names, dates) if date is None]
    if missing:
        raise InputError(
            f"{len(missing)} of {len(names)} measurements have no date, the first is {missing[0]}: "
            "their logs state none",
            expected="a date for each",
            remedy="give {dates} once for each measurement, in their order",
            parameters={"dates": "2025-03-01"},
        )
    return [
        LagMeasurement(
            date,
            GIVEN if given else OF_LOG,
            measured_lag_s(sensor, column),
            shared_u_s(sensor),
            condition(sensor),
            name,
        )
        for sensor, name, date in zip(sensors, names, dates)
        if date is not None
    ]


def _date_of_log(sensor: SensorFile) -> datetime | None:
    """Time of the first row of the first log; None where no log states it."""
    starts = [str(each.get("start_time") or "") for each in sensor.reading]
    return min((parse_time(text) for text in starts if text), default=None)


def _groups(measurements: Sequence[LagMeasurement]) -> tuple[GroupHistory, ...]:
    """The measurements under each condition, and their change."""
    by_name: dict[str, list[LagMeasurement]] = {}
    for each in sorted(measurements, key=lambda each: each.date):
        by_name.setdefault(each.group, []).append(each)
    changes = {}
    for name, listed in by_name.items():
        days = np.array([(each.date - listed[0].date).total_seconds() / DAY_S for each in listed])
        value = np.array([each.lag_s.value for each in listed])
        own_u = np.array([each.own_u_s for each in listed])
        if days[-1] > 0:
            changes[name] = find_change(days, np.log(value), (own_u / value) ** 2)
    groups = []
    for name, listed in by_name.items():
        change = changes.get(name)
        is_significant = change is not None and change.p_value <= FALSE_ALARM_RATE / len(changes)
        groups.append(GroupHistory(name, tuple(listed), change, is_significant))
    return tuple(groups)


def _findings(column: str, groups: Sequence[GroupHistory]) -> list[Finding]:
    """A warning for each change, and an info where measurements are not comparable."""
    findings = []
    if len(groups) > 1:
        names = [group.name for group in groups]
        findings.append(info("history.groups", subject=column, names=names))
    for group in groups:
        change = group.change
        if change is None or not group.is_significant:
            continue
        days = (group.measurements[-1].date - group.first).total_seconds() / DAY_S
        findings.append(
            warning(
                "history.changed",
                subject=column,
                group=group.name,
                percent=100 * change.total.value,
                u_percent=100 * change.total.u,
                low_percent=100 * change.total.low95,
                high_percent=100 * change.total.high95,
                days=days,
                p_value=change.p_value,
                rate_percent=100 * FALSE_ALARM_RATE,
                step_probability=change.step_probability,
                step_percent=100 * change.step.value,
                step_dates=[f"{group.date_at(d):%Y-%m-%d}" for d in change.step_range_days],
            )
        )
    return findings
