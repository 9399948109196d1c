"""Channels of any table that are compensated: columns, units, static lines, chains; their readings.

Used with sensor files by ``tcdyn.workflows.compensate_table``, and with the records of a rig where
a log is compensated with a fixed delay or followed. Guarded by
``tests/sensors/test_sensor_file.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from tcdyn.chain import Chain
from tcdyn.chain.law import FlowLaw, LagLaw
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.checksum import ALTERED_CODE
from tcdyn.io.unit_names import unit_in
from tcdyn.rig.static_line import StaticLine, apply_static, reading_u
from tcdyn.sensors.accuracy import Accuracy, Stated, accuracy_by_column
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.readings import ChannelReadings
from tcdyn.sensors.segments import TableSegment
from tcdyn.series.reading import CODE, RANGE
from tcdyn.series.series import Context, Series, make_series, reading_rows
from tcdyn.series.units import Unit, check_declared, match_columns, unit_findings, units_of
from tcdyn.smoothing.pick_up import held, numbers_of
from tcdyn.smoothing.record import whole_mean_s

# Findings of a sensor that are repeated with each table: an altered file, and a lag without
# uncertainty, without which the intervals are too short.
OF_SENSOR = (ALTERED_CODE, "sensor.exact")
# Values smoothed at once, and columns: an event of one column is weighed in all of them. Chosen by
# judgement (memory).
MAX_VALUES = 400_000
MAX_COLUMNS = 8
# Rows of a segment, and readings of a column in it, from which it is compensated (the smoother
# needs as many).
MIN_ROWS = 10
# Interval in lags from which a warning is given that the rows are slow for the sensor; by
# judgement.
SLOW_ROWS_LAGS = 0.5
# In place of a column that lags follow: they do not follow any
NO_COLUMN = "none"


@dataclass(frozen=True)
class Channel:
    """A column of a source with its sensor.

    Attributes
    ----------
    column, unit
        The column and its unit.
    chain, lag_s
        Chain, and its lag [s].
    line
        Static line; None where readings stand as they are.
    sensor
        Name of the sensor.
    law
        How the lag follows a flow; None where it does not.
    """

    column: str
    unit: Unit
    chain: Chain
    lag_s: Estimate
    line: StaticLine | None
    sensor: str
    law: LagLaw | None = None


@dataclass(frozen=True)
class ChannelGroup:
    """Channels (M) that may be smoothed together.

    Attributes
    ----------
    channels
        The channels.
    lag_covariance_s2, split_u_s
        As in ``ChannelReadings``.
    disk
        Disk of the channels, in messages; empty for a table.
    """

    channels: tuple[Channel, ...]
    lag_covariance_s2: Array
    split_u_s: Array
    disk: str = ""


@dataclass(frozen=True)
class TableChannels:
    """Channels of any source of raw columns.

    Attributes
    ----------
    groups
        The channels, in groups.
    context
        Where the rows come from, and what is known of all of them.
    flow_column
        Column with the flow that lags follow; empty: no lag follows.
    flow_u
        Its standard uncertainty in its unit, and as a share of it: the larger one holds.
    accuracies
        Stated accuracy of the readings, by column.
    """

    groups: tuple[ChannelGroup, ...]
    context: Context
    flow_column: str = ""
    flow_u: tuple[float, float] = (0.0, 0.0)
    accuracies: Mapping[str, Accuracy] = field(default_factory=dict)

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """All channels."""
        return tuple(channel for group in self.groups for channel in group.channels)

    @property
    def units(self) -> dict[str, Unit]:
        """Their columns and units."""
        return {channel.column: channel.unit for channel in self.channels}

    @property
    def raw_columns(self) -> list[str]:
        """Columns that are read for the channels, with those of reference junctions."""
        references = [unit.reference_junction for unit in self.units.values()]
        return [*self.units, *(name for name in references if isinstance(name, str))]

    @property
    def mean_s(self) -> float:
        """Time [s] over which each row is a mean; zero: none, or the chains contain it.

        The records of the disks of a rig are made with the logger of the rig: their lags contain
        its means.
        """
        is_rig = any(group.disk for group in self.groups)
        return 0.0 if is_rig else self.context.options.averages_s or 0.0

    def without_removed(self, findings: Sequence[Finding], has_own_times: bool) -> list[Finding]:
        """Findings about rows without those whose effect is removed.

        Parameters
        ----------
        findings
            The findings.
        has_own_times
            Whether it is known when each row was read.

        Notes
        -----
        Each row is compensated at its own time.
        """
        is_removed = {
            "series.uneven": has_own_times,
            "series.averages": self.mean_s > 0,
        }
        return [f for f in findings if not is_removed.get(f.code, False)]

    @property
    def notes(self) -> dict[str, str]:
        """What an output states of laws and accuracies."""
        notes = {}
        for channel in self.channels:
            if channel.law is not None:
                notes[f"law of {channel.column}"] = channel.law.summary()
        if self.flow_column:
            notes["follows"] = self.flow_column
        absolute, share = self.flow_u
        if absolute or share:
            notes["follows_u"] = f"{100 * share:g}%" if share else f"{absolute:g}"
        for column, accuracy in self.accuracies.items():
            unit = self.units[column].base_difference
            text = f"{accuracy.limit:g} {unit} + {100 * accuracy.share:g} %"
            notes[f"accuracy of {column}"] = text
        return notes

    def with_accuracy(self, accuracy: Stated) -> TableChannels:
        """The channels with a stated accuracy of their readings.

        Parameters
        ----------
        accuracy
            See ``tcdyn.sensors.accuracy.accuracy_by_column``; an empty list: none is stated.
        """
        if accuracy in ((), []):
            return self
        stated = accuracy_by_column(accuracy, self.units, self.context.where)
        return replace(self, accuracies=stated)

    def following(
        self,
        follows: str,
        names: Sequence[str],
        flow_u: float | str = "",
        units: Mapping[str, str] = MappingProxyType({}),
    ) -> TableChannels:
        """The channels with the column of the flow that their lags follow.

        Parameters
        ----------
        follows
            The column, or ``quantity=column``; empty: the column with the name of the quantity;
            ``none``: the lags are those of their files, and do not follow.
        names
            Columns of the table.
        flow_u
            Standard uncertainty of the column, in its unit or with a % sign; empty: none.
        units
            Units that the table states of its columns, by name.

        Raises
        ------
        InputError
            Without such a column, for one in another unit than the quantity states, for sensors
            that follow several quantities, and for a column although no lag follows.
        """
        if follows == NO_COLUMN:
            return self._without_laws()
        quantities = {channel.law.quantity for channel in self.channels if channel.law}
        where = self.context.where
        if not quantities:
            if follows or flow_u:
                raise InputError(
                    f"no lag follows {follows or 'a column'!r}",
                    where=where,
                    expected="a sensor with the law of its lag",
                    remedy="state it with {at}",
                    parameters={"at": "speed_m_s=2"},
                )
            return self
        if len(quantities) > 1:
            listed = ", ".join(sorted(quantities))
            raise InputError(
                f"lags follow {listed}",
                where=where,
                expected="sensors whose lags follow one quantity",
                remedy="compensate them one after the other",
            )
        (quantity,) = quantities
        named, _, column = (part.strip() for part in follows.rpartition("="))
        if named and named != quantity:
            raise InputError(
                f"a column for {named}",
                where=where,
                expected=f"one for {quantity}: QUANTITY=COLUMN",
            )
        try:
            (column,) = match_columns(column or quantity, names, where)
        except InputError:
            raise InputError(
                f"no column {column or quantity!r} with the flow that the lag follows",
                where=where,
                expected=", ".join(names),
                parameters={"follows": f"{quantity}=COLUMN"},
                remedy="name it with {follows}; with the value none the lag stays that of the file",
            ) from None
        if column in self.units:
            raise InputError(
                f"lags follow column {column!r}, which is compensated itself",
                where=where,
                expected="the column of another sensor: this one lags behind what it measures",
            )
        _check_unit_of_flow(quantity, column, units.get(column, ""), where)
        return replace(self, flow_column=column, flow_u=_uncertainty_of(flow_u))

    def _without_laws(self) -> TableChannels:
        """The channels with lags that do not follow."""
        groups = [
            replace(group, channels=tuple(replace(each, law=None) for each in group.channels))
            for group in self.groups
        ]
        return replace(self, groups=tuple(groups))

    @property
    def lag_s(self) -> float:
        """The largest lag [s]."""
        return max((channel.chain.lag_s for channel in self.channels), default=0.0)

    def readings(self, segment: TableSegment) -> tuple[list[ChannelReadings], list[Finding]]:
        """Readings of the channels that have ``MIN_ROWS`` of them, on even times, and findings.

        A group of many channels is divided, so that one block holds at most ``MAX_VALUES``.
        """
        findings = []
        rows = reading_rows(self.units, segment.data, self.context.where)
        for column in rows:
            findings += unit_findings(column.name, self.units[column.name], column.raw)
        if len(segment.time_s) < MIN_ROWS:
            return [], [*findings, warning("sensor.short", count=len(segment.time_s))]
        series = make_series(segment.time_s, rows, self.context)
        if self.mean_s:
            whole_mean_s(self.mean_s, series.interval_s, series.late_s is not None)
            findings.append(info("sensor.means", averages_s=self.mean_s))
        findings += self.without_removed(series.findings, series.late_s is not None)
        others = _other_columns(segment, series, self.raw_columns)
        is_whole = segment.is_last and not segment.rows_before
        flow, of_flow = self._flow(others, series.interval_s, is_whole)
        findings += of_flow
        group_size = min(max(int(MAX_VALUES / series.clock.size), 1), MAX_COLUMNS)
        prepared = []
        for group in self.groups:
            alive = []
            for i, channel in enumerate(group.channels):
                if np.count_nonzero(np.isfinite(series.readings[channel.column])) < MIN_ROWS:
                    findings.append(warning("sensor.dead", subject=channel.column))
                    continue
                alive.append(i)
                lag_s = channel.chain.lag_s
                dt_s = series.interval_s
                if dt_s > SLOW_ROWS_LAGS * lag_s:
                    findings.append(
                        warning("sensor.slow", subject=channel.column, dt_s=dt_s, lag_s=lag_s)
                    )
            for first in range(0, len(alive), group_size):
                indices = alive[first : first + group_size]
                readings = _readings_of(group, indices, series, self.mean_s, self.accuracies)
                flow_u = None if flow is None else self._flow_u(flow)
                prepared.append(replace(readings, others=others, flow=flow, flow_u=flow_u))
        return prepared, findings

    def _flow(
        self, others: Mapping[str, Array], dt_s: float, is_whole: bool
    ) -> tuple[Array | None, list[Finding]]:
        """The flow at the samples (N,), held where it is missing; None: no lag follows.

        Parameters
        ----------
        others
            Other columns at the samples (N,).
        dt_s
            Time from sample to sample [s].
        is_whole
            Whether the samples are all of the table.

        Returns
        -------
        flow
            The flow. Of a part of a table without a number, that at which the lag of the file
            holds.
        findings
            How much is missing: a warning where it is missing for longer than a lag.

        Raises
        ------
        InputError
            For a column without a number, and a flow of zero where the law has no least one.
        """
        law = next((channel.law for channel in self.channels if channel.law), None)
        if not self.flow_column or law is None:
            return None, []
        values = others.get(self.flow_column, np.full(1, np.nan))
        if isinstance(law, FlowLaw):
            values = np.where(values < 0, np.nan, values)
            zeros = int(np.count_nonzero(values == 0))
            if zeros and not law.least:
                raise InputError(
                    f"{zeros} rows of column {self.flow_column!r} have a flow of zero, at which "
                    "the lag has no limit",
                    where=self.context.where,
                    expected="a sensor with a least flow, below which there is natural convection",
                    remedy="state it with {least_flow}",
                    parameters={"least_flow": "0.1"},
                )
        is_missing = ~np.isfinite(values)
        if is_missing.all():
            if is_whole:
                raise InputError(
                    f"column {self.flow_column!r} with the flow has no number",
                    where=self.context.where,
                )
            missing = warning("sensor.no_flow", subject=self.flow_column, at=law.at)
            return np.full(len(values), law.at), [missing]
        edges = np.flatnonzero(np.diff(is_missing, prepend=False, append=False))
        longest_s = dt_s * float(np.max(edges[1::2] - edges[::2], initial=0))
        if not longest_s:
            return held(values), []
        severity = warning if longest_s > self.lag_s else info
        finding = severity(
            "sensor.flow_held",
            subject=self.flow_column,
            percent=100 * float(is_missing.mean()),
            longest_s=longest_s,
        )
        return held(values), [finding]

    def _flow_u(self, flow: Array) -> Array:
        """Standard uncertainty of the flow at the samples (N,)."""
        absolute, share = self.flow_u
        return np.asarray(np.maximum(absolute, share * np.abs(flow)))


def _check_unit_of_flow(quantity: str, column: str, unit_of_table: str, where: str) -> None:
    """Raise InputError for a column in another unit than the quantity of a law states."""
    unit_of_law = unit_in(quantity).replace("_", "/")
    unit_of_column = (unit_in(column) or unit_of_table).replace("_", "/")
    if unit_of_law and unit_of_column and unit_of_law != unit_of_column:
        raise InputError(
            f"column {column!r} is in {unit_of_column}, the law of the lag in {unit_of_law}",
            where=where,
            expected=f"a column in {unit_of_law}",
            remedy="convert it, or state the law in its unit",
        )


def _uncertainty_of(stated: float | str) -> tuple[float, float]:
    """A standard uncertainty in a unit, or as a share where the text has a % sign.

    >>> _uncertainty_of("5%"), _uncertainty_of(0.1), _uncertainty_of("")
    ((0.0, 0.05), (0.1, 0.0), (0.0, 0.0))
    """
    text = str(stated)
    number = text.strip().removesuffix("%")
    try:
        value = float(number or 0.0)
    except ValueError:
        value = -1.0
    if not 0 <= value < np.inf:
        raise InputError(
            f"{{follows_u}} is {text!r}",
            expected="a number, or a number with %",
            parameters={"follows_u": None},
        )
    return (0.0, value / 100) if text.strip().endswith("%") else (value, 0.0)


def _other_columns(
    segment: TableSegment, series: Series, channels: Sequence[str]
) -> dict[str, Array]:
    """Columns of a segment that are no channels, at its samples (N,), as numbers.

    Parameters
    ----------
    segment
        The segment.
    series
        Its channels on the even grid.
    channels
        Columns of the channels.

    Notes
    -----
    Texts with two words are those of a switch, see ``tcdyn.smoothing.pick_up.numbers_of``; others
    are left out.
    """
    others = {}
    for name, values in segment.data.items():
        if name in channels:
            continue
        numbers = numbers_of(values)
        if numbers is None:
            continue
        at_samples = np.full(series.clock.size, np.nan)
        at_samples[series.clock.index] = numbers
        others[name] = at_samples
    return others


def _readings_of(
    group: ChannelGroup,
    indices: list[int],
    series: Series,
    mean_s: float,
    accuracies: Mapping[str, Accuracy],
) -> ChannelReadings:
    """Readings of some channels of a group with their units, chains and uncertainties.

    Parameters
    ----------
    group
        Channels that are smoothed together.
    indices
        Indices (M,) in the group of the channels that have readings.
    series
        Readings of all columns.
    mean_s
        Time [s] over which each row is a mean; zero: none.
    accuracies
        Stated accuracy by column.
    """
    channels = [group.channels[i] for i in indices]
    y = np.stack([_with_static_line(series, channel) for channel in channels], axis=1)
    static_u_K = np.zeros_like(y)
    shared_K = np.zeros(len(channels))
    gain_u_rel = np.zeros(len(channels))
    for k, channel in enumerate(channels):
        if channel.line:
            static_u_K[:, k] = reading_u(channel.line, y[:, k])
            shared_K[k] = channel.line.shared_u_K
            gain_u_rel[k] = channel.line.gain_u_rel
        accuracy = accuracies.get(channel.column)
        if accuracy:
            static_u_K[:, k] = np.hypot(static_u_K[:, k], accuracy.u(y[:, k]))
            gain_u_rel[k] = np.hypot(gain_u_rel[k], accuracy.gain_u_rel)
    reasons = np.stack([series.reasons[channel.column] for channel in channels], axis=1)
    return ChannelReadings(
        tuple(channel.column for channel in channels),
        tuple(channel.unit for channel in channels),
        y,
        series.clock.start_s,
        series.interval_s,
        series.clock.index,
        tuple(
            replace(channel.chain, mean_s=mean_s) if mean_s else channel.chain
            for channel in channels
        ),
        group.lag_covariance_s2[np.ix_(indices, indices)],
        group.split_u_s[indices],
        np.nan_to_num(static_u_K),
        shared_K,
        gain_u_rel,
        disk=group.disk,
        is_separable=True,
        is_left_out=(reasons == RANGE) | (reasons == CODE),
        late_s=series.late_on_grid(),
        laws=tuple(channel.law for channel in channels),
    )


def _with_static_line(series: Series, channel: Channel) -> Array:
    """Readings of a channel at the samples (N,) [degC], after its static line."""
    degC = series.at_own_times(channel.column)
    return np.asarray(apply_static(degC, channel.line) if channel.line else degC)


def sensor_channels(
    names: Sequence[str],
    where: str,
    sensors: Sequence[SensorFile],
    columns: Sequence[str] = (),
    unit: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    unit_row: Mapping[str, str] | None = None,
) -> tuple[TableChannels, list[Finding]]:
    """The columns of a table that sensors cover, in their order.

    The parameters are those of ``tcdyn.workflows.frames.compensate_frame``; ``names`` are
    the columns of the table, ``unit_row`` its row of units.

    Raises
    ------
    InputError
        Without a sensor, for a column that is missing or has two sensors, and for an unknown unit.
    """
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
    sensor_of_column: dict[str, tuple[int, int]] = {}
    for number, file in enumerate(sensors):
        for index, pattern in enumerate(file.columns):
            matched = [n for c in (columns or [pattern]) for n in match_columns(c, names, where)]
            if "*" in pattern and file.law is not None and not columns:
                # the flow that the lag follows is no temperature of this sensor
                matched = [n for n in matched if n != file.law.quantity]
            for name in matched:
                if name in sensor_of_column:
                    raise InputError(
                        f"two sensors for column {name!r}",
                        where=where,
                        expected="one sensor a column",
                    )
                sensor_of_column[name] = number, index
    covered = [n for n in names if n in sensor_of_column]
    check_declared(unit, names, where)
    units, findings = units_of(covered, unit, couple, cold, unit_row)
    findings += [f for file in sensors for f in file.findings if f.code in OF_SENSOR]
    channels = []
    covariance = np.zeros((len(covered), len(covered)))
    split_u_s = np.zeros(len(covered))
    for i, name in enumerate(covered):
        number, index = sensor_of_column[name]
        file = sensors[number]
        pattern = file.columns[index]
        if pattern in file.static and not units[name].is_temperature:
            raise InputError(
                f"column {name!r} is in {units[name].name}, but its static line is in degC",
                where=where,
                expected="a column of temperatures",
            )
        channels.append(
            Channel(
                name,
                units[name],
                file.chains[index],
                file.chain.channels[pattern].lag_s,
                file.static.get(pattern),
                file.sensor,
                file.law,
            )
        )
        split_u_s[i] = file.split_u_s[index]
        for j, other in enumerate(covered):
            other_number, other_index = sensor_of_column[other]
            if other_number == number:
                covariance[i, j] = file.lag_covariance_s2[index, other_index]
    group = ChannelGroup(tuple(channels), covariance, split_u_s)
    return TableChannels((group,), Context(where)), findings
