"""The sensor file of a thermocouple outside the rig: chain with uncertainty, columns, method.

All methods of ``tcdyn.sensors`` write it, and the compensation of tables (``tcdyn.workflows``)
reads it. A file of ``tcdyn identify`` is converted. ``tests/sensors/test_sensor_file.py`` and
``test_long_lags.py`` in that folder check that it is read back and that a damaged file is refused
by its key.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import pandas as pd
from pydantic import Field, computed_field, model_validator

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.chain import STATED_SPLIT_SHARE
from tcdyn.chain.law import AnyLaw, TableLaw
from tcdyn.core import Array
from tcdyn.core.arguments import check_keywords, with_named_arguments
from tcdyn.core.errors import DAMAGED, InputError, utf8
from tcdyn.core.estimate import Estimate, rounded_texts
from tcdyn.core.findings import Finding, labelled_messages, messages, warning
from tcdyn.core.result import Result, estimate_columns
from tcdyn.io.checksum import checksum_findings, with_checksum
from tcdyn.io.column_names import column_named
from tcdyn.io.endings import JSON, check_ending
from tcdyn.io.stored import IDENTIFIED, SENSOR, check_schema, read_json
from tcdyn.io.write import write_text
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.record import (
    MAX_LAG_S,
    ChannelChain,
    InputFile,
    StrictModel,
    now_utc,
    parse_time,
    square_matrix,
    validate_model,
)
from tcdyn.rig.static_line import StaticLine
from tcdyn.series.units import is_match

if TYPE_CHECKING:
    from tcdyn.identification import Identified

COVERAGE_FACTOR = 2  # of U, for about 95 % (GUM, 6.3.3)
# Version of the file; a change of its keys needs another number.
SCHEMA: Final[Literal["tcdyn.sensor/1"]] = "tcdyn.sensor/1"
# Shares of the step whose times are reported (VDI/VDE 3522).
SHARES = {"t50_s": 0.5, "t632_s": 1 - float(np.exp(-1)), "t90_s": 0.9}
# Methods whose lag always has an uncertainty above zero.
MEASURED = ("plunge", "pair", "current", "noise")
# Doublings of the 12 lags in which the response must reach the last share: a zero of 0.999 of the
# lags leaves a lag that is 1000 times shorter than they are.
MAX_GRID_DOUBLINGS = 10
MAX_NAME = 80  # characters of a sensor's name; chosen by judgement
MIN_LAG_S = 1e-6  # least lag that can be specified [s], if it is not zero; chosen by judgement
# Relative difference of two standard uncertainties that must agree in a file; chosen by judgement.
MAX_U_DIFFERENCE_REL = 0.5
# Deviation of the static gain from one, above which a warning is given: 3 u, and at least this;
# chosen by judgement.
MIN_GAIN_DEVIATION = 1e-3
# Relative standard uncertainty of the lag, the first moment, that is taken from the time of 63.2 %:
# rms difference of the two for two-lag sensors with the ratios t90/t50 of ``STATED_SPLIT_SHARE``.
T63_LAG_U = 0.032
# What limits the lag, for methods whose ``fit`` does not say it.
LIMITED_BY = {
    "plunge": "noise and model of this dip; the spread between dips is not known: repeat it",
    "current": "the conversion from heating inside to a plunge",
}
# Keys of ``fit`` in kelvins; of another quantity they have no ``_K``, and its unit is ``unit``.
LEVEL_KEYS = ("step", "noise", "fluctuation", "logger")
# Methods that give a lag; the words are in the files.
Method = Literal["stated", "plunge", "pair", "current", "noise", "identify"]

# Share by which a stated lag may differ from that of a table of lags: both are rounded
TABLE_REL = 0.02


class SensorChains(StrictModel):
    """The chains of a sensor, with the covariance of their lags.

    Attributes
    ----------
    structure
        Name of the chain structure.
    channels
        Chain of each column.
    covariance
        Covariance of the lags of the chains (M, M), in the order of ``columns`` [s2]. Where a chain
        is that of the best of several structures, it includes the distance of its lag from
        ``lag_s``, which is the average.
    """

    structure: str = Field(min_length=1, max_length=40)
    channels: dict[str, ChannelChain] = Field(min_length=1)
    covariance: list[list[float]]

    @model_validator(mode="after")
    def _check_covariance(self) -> SensorChains:
        """Check that the covariance is a covariance matrix of the size of the channels."""
        square_matrix(self.covariance, len(self.channels))
        return self


class SensorFile(Result, StrictModel):
    """A thermocouple, or several that were determined together, for the ``columns`` of any table.

    Attributes
    ----------
    sensor
        Name of the sensor.
    created
        Time of creation.
    method
        Method that gave the lags.
    inputs
        Files that were used.
    columns
        Names in a table, ``*`` matches any text; each has its ``chain``.
    chain
        Chain of each column.
    conditioning
        Filter that was specified; none by default.
    times
        By column: when the response to a step passes 50, 63.2 and 90 %.
    static
        By column, where there is a static line.
    law
        How the lags follow a flow; None: they do not.
    fit
        Further results of the method.
    reading
        What was understood of each table: rows, interval, gaps, readings, and what was left out.
    findings
        Warnings and infos.

    Notes
    -----
    The fields are the keys of the file; the page on columns and keys lists them, and a test
    compares both.
    """

    schema_: Literal["tcdyn.sensor/1"] = Field(default=SCHEMA, alias="schema")
    sensor: str = Field(min_length=1, max_length=MAX_NAME)
    created: str = Field(default_factory=now_utc)
    method: Method
    inputs: list[InputFile] = Field(default_factory=list)
    columns: list[str] = Field(min_length=1)
    chain: SensorChains
    conditioning: Conditioning = NO_CONDITIONING
    times: dict[str, dict[str, Estimate]] = Field(default_factory=dict)
    static: dict[str, StaticLine] = Field(default_factory=dict)
    law: AnyLaw | None = None
    fit: dict[str, Any] = Field(default_factory=dict)
    reading: list[dict[str, Any]] = Field(default_factory=list)
    findings: list[Finding] = Field(default_factory=list)

    @model_validator(mode="before")
    @classmethod
    def _drop_warnings(cls, data: Any) -> Any:
        """``warnings`` in a file are the text of its findings."""
        if not isinstance(data, dict):
            return data
        return {key: value for key, value in data.items() if key != "warnings"}

    @model_validator(mode="after")
    def _check_lags(self) -> SensorFile:
        """Check the time of creation, the columns, and that chain, lag and covariance agree.

        Raises
        ------
        ValueError
            Where they do not.
        """
        parse_time(self.created)
        if list(self.chain.channels) != self.columns:
            raise ValueError("columns: must be those of chain.channels, in their order")
        sds = np.sqrt(np.maximum(np.diag(self.lag_covariance_s2), 0.0))
        for name, chain, sd in zip(self.columns, self.chains, sds):
            lag_s = self.chain.channels[name].lag_s
            distance_s = abs(chain.lag_s - lag_s.value)
            largest_u = float(np.hypot(lag_s.u, distance_s))
            is_too_small = sd < (1 - MAX_U_DIFFERENCE_REL) * lag_s.u - 1e-6
            is_too_large = (1 - MAX_U_DIFFERENCE_REL) * sd > largest_u + 1e-6
            if is_too_small or is_too_large:
                raise ValueError(
                    f"covariance: its diagonal gives {sd:.4g} s for {name}, lag_s.u is "
                    f"{lag_s.u:.4g} s"
                )
            if distance_s > max(3 * sd, 0.01 * chain.lag_s + 1e-4):
                raise ValueError(
                    f"chain.channels.{name}.lag_s: {lag_s.value:.4g} s, but its lags add to "
                    f"{chain.lag_s:.4g} s"
                )
        return self

    @computed_field  # type: ignore[prop-decorator]
    @property
    def warnings(self) -> list[str]:
        """The findings as sentences."""
        return list(messages(self.findings))

    @property
    def chains(self) -> tuple[Chain, ...]:
        """One chain for each column, with the filter."""
        parameters = [
            channel.model_dump(exclude={"lag_s", "split_u_s"})
            for channel in self.chain.channels.values()
        ]
        return tuple(Chain(**p, conditioning=self.conditioning) for p in parameters)

    @property
    def lag_covariance_s2(self) -> Array:
        """Covariance (M, M) of the lags of the columns [s2]."""
        return np.array(self.chain.covariance, dtype=float)

    @property
    def split_u_s(self) -> Array:
        """Standard uncertainty (M,) of the largest time constant at fixed lag [s]."""
        return np.array([c.split_u_s for c in self.chain.channels.values()])

    def __getitem__(self, column: str) -> ChannelChain:
        """The chain of a column, named with or without its unit, with its lag.

        >>> specified_sensor("probe", ["TE5 (°C)"], [(1.5, 0.1)])["TE5"].lag_s.text("s")
        '1.50 +- 0.10 s'

        Raises
        ------
        InputError
            For a column that the sensor does not cover.
        """
        covers = [
            each
            for each in self.columns
            if isinstance(column, str) and "*" in each and is_match(each, column)
        ]
        if len(covers) == 1 and column not in self.columns:
            return self.chain.channels[covers[0]]
        return self.chain.channels[column_named(column, self.columns, self.sensor)]

    @property
    def lag_s(self) -> Estimate:
        """The lag of a sensor of one column [s].

        >>> specified_sensor("probe", ["T1"], [(1.5, 0.1)]).lag_s.value
        1.5

        Raises
        ------
        InputError
            For a sensor of several columns, each of which has its lag.
        """
        if len(self.columns) > 1:
            raise InputError(
                f"{len(self.columns)} columns",
                where=self.sensor,
                expected="the lag of one of them",
                remedy=f"for example sensor[{self.columns[0]!r}].lag_s",
            )
        return self.chain.channels[self.columns[0]].lag_s

    def summary(self) -> str:
        """Method, lag and what limits it, times of the step response, dips, and findings.

        Notes
        -----
        The lag is the recommended estimate: that of ``fit`` where the method has one, which is that
        of ``chain`` without the filter. The chain itself may have another lag within the
        uncertainty, and ``covariance`` includes this distance.
        """
        dips = self.fit.get("dips", [])
        count = f" {len(dips)} dips," if dips else ""
        lines = [f"{self.sensor}: {self.method},{count} {self.chain.structure}"]
        limited_by = self.fit.get("limited_by") or LIMITED_BY.get(self.method)
        for name, chain in zip(self.columns, self.chains):
            lag = self.chain.channels[name].lag_s
            if "lag_s" in self.fit:
                lag = Estimate(**self.fit["lag_s"])
            use = ", for one further dip or use" if dips else ""
            times_of_chain = chain.summary().partition("; lag in all")[0]
            lines.append(f"  {name}: {_expanded('lag', lag)}{use} ({times_of_chain})")
            if limited_by:
                lines.append(f"    limited by {limited_by}")
            for key, estimate in self.times.get(name, {}).items():
                share = key.removesuffix("_s").replace("632", "63.2")
                lines.append(f"    {_expanded(share, estimate)}")
        if self.law is not None:
            lines.append(f"  {self.law.summary()}")
        for dip in dips:
            lag_text = Estimate(**dip["lag_s"]).text("s")
            flow_text = f" at {dip['flow']:g}" if "flow" in dip else ""
            lines.append(f"  {dip['file'] or 'dip'}: {dip['direction']}, lag {lag_text}{flow_text}")
        unit_text = f" {self.fit['unit']}" if "unit" in self.fit else ""
        for key, value in self.fit.items():
            if key == "lag_s":
                continue
            if isinstance(value, dict) and set(value) == set(Estimate.model_fields):
                lines.append(f"  {key}: {Estimate(**value)}")
            elif isinstance(value, float):
                lines.append(f"  {key}: {value:.4g}{unit_text if key in LEVEL_KEYS else ''}")
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def to_frame(self) -> pd.DataFrame:
        """Numbers of lag and times of the step response, one row a column."""
        rows = {}
        for name, channel in self.chain.channels.items():
            rows[name] = estimate_columns("lag", "s", channel.lag_s)
            for key, estimate in self.times.get(name, {}).items():
                rows[name] |= estimate_columns(key.removesuffix("_s"), "s", estimate)
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("column")

    def in_unit(self, unit: str) -> SensorFile:
        """The sensor of a quantity that is measured in ``unit``; K changes nothing.

        Keys of ``fit`` that state kelvins do not then, and ``fit["unit"]`` is the unit.
        """
        findings = [finding.in_unit(unit) for finding in self.findings]
        if unit == "K":
            return self
        fit = {
            key.removesuffix("_K") if key.removesuffix("_K") in LEVEL_KEYS else key: value
            for key, value in self.fit.items()
        }
        if set(fit) & set(LEVEL_KEYS):
            fit["unit"] = unit
        return self.model_copy(update={"fit": fit, "findings": findings})

    def write(self, path: str | Path) -> Path:
        """Write the file, see :func:`tcdyn.sensors.write_sensor`."""
        return write_sensor(self, path)

    def card(self) -> pd.DataFrame:
        """Lag and times of each column, formatted for display."""
        rows = []
        for name, channel in self.chain.channels.items():
            times = {key: str(estimate) for key, estimate in self.times.get(name, {}).items()}
            rows.append({"column": name, "lag [s]": str(channel.lag_s), **times})
        return pd.DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """The content of the file, with its checksum; ``law`` only where there is one."""
        left_out = {"law"} if self.law is None else set()
        return with_checksum(self.model_dump(mode="json", by_alias=True, exclude=left_out))


@with_named_arguments
def sensor_file(
    sensor: str,
    chains: Mapping[str, Chain],
    method: Method,
    lag_covariance: Array,
    split_u_s: Sequence[float],
    *,
    structure: str = "",
    lags: Mapping[str, Estimate] | None = None,
    times: Mapping[str, Mapping[str, Estimate]] | None = None,
    **more: Any,
) -> SensorFile:
    """Build the file of a sensor.

    Parameters
    ----------
    sensor
        Name of the sensor.
    chains
        Chain of each column (M).
    method
        Method that gave them.
    lag_covariance
        Covariance of the lags (M, M) [s2].
    split_u_s
        Standard uncertainty of the largest time constant at fixed lag (M,) [s].
    structure
        Name of the chain structure; empty: from the number of lags.
    lags
        Lag of each column without the filter, with the 95 % interval that the method determined;
        None: that of the chain, normally distributed.
    times
        Times of the step response that the method determined; None: from the chain, by first order.
    more
        Other fields.

    Returns
    -------
    SensorFile
        The file.

    Raises
    ------
    InputError
        For a lag whose uncertainty is not finite, or is zero although it was measured, and for a
        lag or a name that a file cannot hold.

    Examples
    --------
    >>> probe = sensor_file("probe", {"T1": Chain(1.5)}, "stated", np.array([[0.01]]), [0.0])
    >>> probe.to_frame()[["lag_s", "lag_u_s"]].round(3).values.tolist()
    [[1.5, 0.1]]
    """
    check_keywords("sensor_file", more, SensorFile.model_fields)
    if not 0 < len(sensor) <= MAX_NAME:
        raise InputError(
            f"a sensor's name of {len(sensor)} characters", expected=f"1 to {MAX_NAME}"
        )
    for name in (sensor, *chains):
        if name != utf8(name):
            raise InputError(f"the name {utf8(name)} is not UTF-8", expected="another name")
    variances = np.diag(lag_covariance)
    for (name, chain), variance in zip(chains.items(), variances):
        if not np.isfinite(variance) or (variance <= 0 and method in MEASURED):
            raise undetermined_lag_error(name)
        _check_longest(name, chain)
        if chain.mean_s:
            raise InputError(
                f"{name or 'sensor'}: the chain has rows that are means over {chain.mean_s:g} s, "
                "which are the logger's, not the sensor's",
                remedy="leave mean_s out, and state {averages_s} where the rows are read",
                parameters={"averages_s": f"{chain.mean_s:g}"},
            )
    lag_u_s = np.sqrt(np.maximum(variances, 0.0))
    channels = {}
    step_response = {name: dict(values) for name, values in (times or {}).items()}
    for (name, chain), u, split_u in zip(chains.items(), lag_u_s, split_u_s):
        lag_s = Estimate.normal(chain.lag_s, u)
        if lags is not None:
            lag_s = lags[name].shifted(chain.conditioning.lag_s)
        channels[name] = ChannelChain(**chain.parameters, lag_s=lag_s, split_u_s=float(split_u))
        if not times:
            step_response[name] = step_times(chain, float(u), float(split_u))
    first = next(iter(chains.values()))
    sensor_chains = SensorChains(
        structure=structure or f"P{len(first.taus_s)}",
        channels=channels,
        covariance=np.asarray(lag_covariance).tolist(),
    )
    return SensorFile(
        sensor=sensor,
        method=method,
        columns=list(chains),
        chain=sensor_chains,
        conditioning=first.conditioning,
        times=step_response,
        **more,
    )


def _expanded(name: str, time: Estimate) -> str:
    """Text of a time with its standard uncertainty and its expanded uncertainty U = 2 u."""
    expanded = rounded_texts(time.value, COVERAGE_FACTOR * time.u)[1]
    return f"{name} {time.text('s')}, U = {expanded} s (k = {COVERAGE_FACTOR})"


def step_size(fit: Mapping[str, Any]) -> float:
    """Size of the step in the ``fit`` of a plunge, in K or the unit of another quantity.

    >>> step_size({"step_K": -50.0}), step_size({"step": 400.0, "unit": "ppm"})
    (-50.0, 400.0)
    """
    return float(fit["step_K"] if "step_K" in fit else fit["step"])


def undetermined_lag_error(column: str = "") -> InputError:
    """Return the error for a lag whose uncertainty is zero or undefined."""
    lag = f"the lag of {column}" if column else "the lag"
    return InputError(
        f"the record does not determine {lag}: its standard uncertainty is zero or undefined",
        expected="noise and a changing reading in enough rows",
        remedy="log a longer record, at full resolution",
    )


def _check_longest(name: str, chain: Chain) -> None:
    """Raise InputError for a chain with a time that a file cannot hold.

    Raises
    ------
    InputError
        For a time of ``MAX_LAG_S`` or more.
    """
    pair = chain.pair or (0.0, 0.0)
    longest_s = max(*chain.taus_s, abs(chain.zero_s), chain.delay_s, chain.cement_s, *pair, 0.0)
    if not longest_s < MAX_LAG_S:
        expected = f"times below {MAX_LAG_S:g} s, about four months"
        raise InputError(f"{name}: a time of {longest_s:.4g} s in its chain", expected=expected)


@with_named_arguments
def step_times(chain: Chain, lag_u_s: float = 0.0, split_u_s: float = 0.0) -> dict[str, Estimate]:
    """Return when the unit step response first passes 50, 63.2 and 90 % [s].

    Parameters
    ----------
    chain
        The chain.
    lag_u_s, split_u_s
        Standard uncertainties of the lag, and of the largest time constant at fixed lag [s].

    Returns
    -------
    dict
        Time with its first-order uncertainty by the keys of ``SHARES``; empty for a chain without a
        lag.

    Examples
    --------
    >>> round(step_times(Chain(2.0))["t90_s"].value, 3)
    4.605
    """
    if chain.lag_s <= 0:
        return {}
    times = step_passes(chain)
    step_s = max(lag_u_s, 1e-3 * chain.lag_s)
    by_lag = (step_passes(chain.with_lag_shift(step_s)) - times) * lag_u_s / step_s
    by_split = step_passes(chain.with_split_shift(split_u_s)) - times
    us = np.hypot(by_lag, by_split)
    return {key: Estimate.normal(t, u) for key, t, u in zip(SHARES, times, us)}


def lag_and_times(chain: Chain) -> Array:
    """Return the lag, and when the step response passes each of ``SHARES`` (4,) [s]."""
    return np.array([chain.lag_s, *step_passes(chain)])


def step_passes(chain: Chain) -> Array:
    """Return when the step response passes each of ``SHARES``.

    Parameters
    ----------
    chain
        The chain.

    Returns
    -------
    array
        Times (3,) [s]; zero where the response begins above the share.

    Notes
    -----
    The grid has 400 points in each lag and ends after 12 lags, or when all shares are reached. The
    lag of the grid is the sum of all times where a zero cancels that of the chain. The times are
    interpolated linearly.
    """
    grid_lag_s = chain.lag_s
    if grid_lag_s <= 0:
        grid_lag_s = sum(chain.taus_s) + chain.delay_s
    if grid_lag_s <= 0:
        return np.zeros(len(SHARES))  # the reading follows at once
    last_share = max(SHARES.values())
    t = grid_lag_s * np.linspace(0, 12, 4801)
    response = chain.response(np.ones_like(t), float(t[1]), "zoh", "zero")
    for _ in range(MAX_GRID_DOUBLINGS):
        if response.max() >= last_share:
            break
        t = 2 * t
        response = chain.response(np.ones_like(t), float(t[1]), "zoh", "zero")
    return np.array(percent_times(t, response))


def percent_times(t: Array, response: Array) -> list[float]:
    """Times (3,) [s] at which a response (N,) at ``t`` (N,) first passes each of ``SHARES``.

    The first time where the response begins above the share.

    >>> percent_times(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.8, 1.0]))[0]
    0.625
    """
    times = []
    for share in SHARES.values():
        k = int(np.argmax(response >= share))
        if k == 0:
            times.append(float(t[0]))
            continue
        times.append(float(np.interp(share, response[k - 1 : k + 1], t[k - 1 : k + 1])))
    return times


@with_named_arguments
def specified_sensor(
    sensor: str,
    columns: Sequence[str],
    taus_s: Sequence[tuple[float, float]],
    conditioning: Conditioning = NO_CONDITIONING,
    delay_s: tuple[float, float] = (0.0, 0.0),
    *,
    t63_s: tuple[float, float] | None = None,
    is_bare: bool = False,
    law: AnyLaw | None = None,
    **more: Any,
) -> SensorFile:
    """Build a sensor whose lags the user specifies: one chain for all ``columns``.

    Parameters
    ----------
    sensor
        Name of the sensor.
    columns
        Its columns.
    taus_s
        Time constants and their standard uncertainties [s].
    conditioning
        Filter after the sensor.
    delay_s
        Dead time and its standard uncertainty [s].
    t63_s
        In place of ``taus_s``, the time at which the step response passes 63.2 %, and its standard
        uncertainty [s].
    is_bare
        Whether the sensor is a bare wire, which has one lag and no dead time.
    law
        How the lag follows a flow; ``taus_s`` then hold at ``FlowLaw.at``.
    more
        Other fields of the file.

    Returns
    -------
    SensorFile
        The file. The lags of all columns are fully correlated.

    Notes
    -----
    One number states a lag, the first moment, and not how it is divided: of a sheathed sensor,
    ``tcdyn.chain.chain.DIVISIONS`` tells what may be a second lag or a dead time. With several
    lags, or with a dead time, the structure is stated, too.

    Raises
    ------
    InputError
        Without a lag or a column, and for a lag that is not possible.

    Examples
    --------
    >>> specified_sensor("probe", ["T1"], [(1.5, 0.1), (0.2, 0.0)]).chain.channels["T1"].lag_s.u
    0.1
    """
    if t63_s is not None and taus_s:
        raise InputError(
            "a sensor has both a lag and a time of 63.2 %",
            expected="{taus_s} or {t63_s}",
            parameters={"taus_s": f"{taus_s[0][0]:g}", "t63_s": f"{t63_s[0]:g}"},
        )
    taus = sorted(taus_s, reverse=True)
    if not columns or not (taus or t63_s):
        raise InputError(
            "a sensor needs a lag and a column",
            expected="{taus_s}, {column}",
            parameters={"taus_s": "1.5", "column": "T1"},
        )
    is_divided = len(taus) > 1 or delay_s[0] > 0
    if is_divided and (is_bare or t63_s):
        raise InputError(
            "a bare wire, and a time of 63.2 %, have one lag and no dead time",
            expected="one lag",
            parameters={"taus_s": "1.5"},
        )
    if t63_s is not None:
        taus = [_lag_of_t63(t63_s, is_bare)]
    for value, u in (*taus, delay_s):
        possible = value == 0 or MIN_LAG_S <= value < MAX_LAG_S
        if not possible or not 0 <= u < MAX_LAG_S:
            raise InputError(
                f"a lag of {value:g} +- {u:g} s",
                expected=f"0, or a microsecond to {MAX_LAG_S:g} s, its uncertainty not negative "
                "and less than that",
            )
    is_stated = not is_bare and not is_divided
    chain = Chain(
        [t for t, _ in taus],
        delay_s=delay_s[0],
        conditioning=conditioning,
        is_stated=is_stated,
    )
    if law is not None:
        law.first_lag_s(chain, np.ones(1))
    if isinstance(law, TableLaw) and abs(chain.lag_s - law.lag_s) > TABLE_REL * law.lag_s:
        raise InputError(
            f"a lag of {chain.lag_s:.4g} s, but {law.lag_s:.4g} s in the table of lags at "
            f"{law.quantity} = {law.at:g}",
            expected="one lag",
        )
    lag_variance = sum(u * u for _, u in (*taus, delay_s))
    split_variance = sum(u * u for _, u in (*taus[1:], delay_s))
    if is_stated:
        split_variance += (STATED_SPLIT_SHARE * taus[0][0]) ** 2
    findings = [] if lag_variance > 0 else [warning("sensor.exact", lag_s=chain.lag_s)]
    m = len(columns)
    return sensor_file(
        sensor,
        dict.fromkeys(columns, chain),
        "stated",
        np.full((m, m), lag_variance),
        [split_variance**0.5] * m,
        findings=findings,
        law=law,
        **more,
    )


def _lag_of_t63(t63_s: tuple[float, float], is_bare: bool) -> tuple[float, float]:
    """Lag and its standard uncertainty [s] of a sensor with a time of 63.2 %.

    Parameters
    ----------
    t63_s
        The time and its standard uncertainty [s].
    is_bare
        Whether the sensor has one lag, which then is that time.
    """
    value, u = t63_s
    if is_bare:
        return value, u
    return value, float(np.hypot(u, T63_LAG_U * value))


@with_named_arguments
def read_sensor(path: str | Path) -> SensorFile:
    """Read a file of ``tcdyn sensor``, or the chain in a file of ``tcdyn identify``.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    SensorFile
        The sensor.

    Raises
    ------
    InputError
        For another file; it names the key.

    Examples
    --------
    >>> import tempfile
    >>> probe = specified_sensor("probe", ["T1"], [(1.5, 0.1)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = probe.write(Path(folder) / "probe.sensor.json")
    ...     print(read_sensor(path).chain.channels["T1"].lag_s)
    1.50 +- 0.10
    """
    where = str(path)
    data = read_json(path, SENSOR)
    if check_schema(data, where, SENSOR, IDENTIFIED) is IDENTIFIED:
        from tcdyn.identification import Identified  # only these files need the identification

        try:
            return from_identified(Identified.from_dict(data), Path(path).name)
        except InputError as problem:
            raise problem.at(where) from None
        except DAMAGED as problem:
            raise InputError(
                f"is damaged ({problem!r})", where=where, expected=IDENTIFIED.expected
            ) from None
    expected = "a sensor as `tcdyn sensor` writes it"
    remedy = "do not edit it by hand; write it again with `tcdyn sensor`"
    sensor = validate_model(SensorFile, data, where, expected, remedy)
    sensor.findings.extend(checksum_findings(data, where))
    return sensor


@with_named_arguments
def write_sensor(sensor: SensorFile, path: str | Path) -> Path:
    """Write the file atomically: all of it or nothing.

    Parameters
    ----------
    sensor
        The file.
    path
        Where to write it.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For an ending other than .json.

    Examples
    --------
    >>> import tempfile
    >>> probe = specified_sensor("probe", ["T1"], [(1.5, 0.1)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_sensor(probe, Path(folder) / "probe.sensor.json").name
    'probe.sensor.json'
    """
    check_ending(path, JSON)
    return write_text(path, json.dumps(sensor.to_dict(), indent=2, ensure_ascii=False) + "\n")


@with_named_arguments
def from_identified(model: Identified, sensor: str = "") -> SensorFile:
    """Build the sensor whose chain ``tcdyn identify`` estimated.

    Parameters
    ----------
    model
        The identified model. Uncertainties follow from its covariance; a fixed filter is recognised
        by its polynomial.
    sensor
        Name of the sensor; empty: that of the model.

    Returns
    -------
    SensorFile
        The sensor, for the column that was the output of the identification.

    Raises
    ------
    InputError
        For a model that is no chain (a zero and pole form, an integrator).

    Examples
    --------
    >>> from tcdyn.identification import Identified, process
    >>> model = Identified.of(process("P1"), {"Kp": 1.0, "Tp1": 0.8}, np.diag([1e-6, 1e-4]))
    >>> from_identified(model).method
    'identify'
    """
    column = model.output_name
    chain = model.chain(_fixed_filter(model))
    gain = model.estimates.get("Kp")
    findings = list(model.findings)
    if gain is not None and abs(gain.value - 1) > max(3 * gain.u, MIN_GAIN_DEVIATION):
        findings.append(warning("sensor.gain", subject=column, gain=gain.value, u=gain.u))
    return sensor_file(
        sensor or model.model.name,
        {column: chain},
        "identify",
        np.array([[model.lag_s.u**2]]),
        [_identified_split_u_s(model)],
        structure=model.model.name,
        findings=findings,
    )


def _identified_split_u_s(model: Identified) -> float:
    """Return the standard uncertainty of the sum of all lags but the largest [s]."""
    signs = {"Tp2": 1.0, "Tp3": 1.0, "Tz": -1.0, "Td": 1.0, "Tc": 0.5}
    free = list(model.model.free)
    names = [name for name in signs if name in free]
    index = [free.index(name) for name in names]
    weights = np.array([signs[name] for name in names])
    variance = float(weights @ model.covariance[np.ix_(index, index)] @ weights) if names else 0.0
    return float(np.sqrt(max(variance, 0.0)))


def _fixed_filter(model: Identified) -> Conditioning:
    """Return the conditioning filter whose polynomial is the fixed part of the model.

    Raises
    ------
    InputError
        Where no filter has that polynomial.
    """
    from tcdyn.identification import KnownDynamics  # only these files need the identification

    den = np.trim_zeros(np.asarray(model.model.known.den, dtype=float), "b")
    order = len(den) - 1
    if order == 0:
        return NO_CONDITIONING
    cutoff_Hz = float((den[0] / den[order]) ** (1 / order) / (2 * np.pi))
    for shape in ("cascade", "butterworth"):
        candidate = Conditioning(cutoff_Hz, order, shape)
        if np.allclose(KnownDynamics.of(candidate).den, den / den[0], rtol=1e-9, atol=0.0):
            return candidate
    raise InputError("its fixed part is not a filter that a chain can have", where=model.model.name)
