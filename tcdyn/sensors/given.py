"""Sensors as a caller gives them: files, lags in seconds, chains, or any of these by column.

Every function that compensates takes them and converts them here. Guarded by
``tests/sensors/test_given_sensors.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core.arguments import described
from tcdyn.core.errors import InputError
from tcdyn.core.findings import warning
from tcdyn.core.options import parse_number_with_u
from tcdyn.io.column_names import column_named
from tcdyn.sensors.file import (
    SensorChains,
    SensorFile,
    read_sensor,
    sensor_file,
    specified_sensor,
)
from tcdyn.series.source import Source

# A lag [s]: a number, (number, standard uncertainty), or the text "25+-1".
Lag = float | tuple[float, float]
OneSensor = SensorFile | Chain | Lag | str | Path
Sensors = OneSensor | Sequence[OneSensor] | Mapping[str, OneSensor]
# Column of a lag that was given without one: the only column of numbers of the table.
UNNAMED = ""
STATED = "stated"  # name of a sensor whose lag is given as a number or a chain
EXPECTED = (
    "a sensor file or its path, a lag in seconds (25, (25, 1) or '25+-1'), a Chain, a list of "
    "sensor files, or a dict {column: one of these}"
)


def sensor_files(sensors: Sensors) -> list[SensorFile]:
    """The sensors as sensor files.

    Parameters
    ----------
    sensors
        A sensor file or its path; a lag [s] that is stated, with or without its standard
        uncertainty; a chain that is known; a list of sensor files; or any of these by column.

    Returns
    -------
    list of SensorFile
        A lag or a chain without a column has ``UNNAMED``, see :func:`with_column`.

    Raises
    ------
    InputError
        For anything else, and for a lag or a chain beside other sensors without its column.

    Notes
    -----
    A lag without an uncertainty and a chain are taken as exact, with a warning, as
    ``tcdyn sensor new`` does.

    Examples
    --------
    >>> [file.lag_s.text("s") for file in sensor_files({"T1": (25, 1), "T2": "8+-0.5"})]
    ['25.0 +- 1.0 s', '8.00 +- 0.50 s']
    """
    if isinstance(sensors, Mapping):
        for column in sensors:
            if not isinstance(column, str) or not column:
                raise InputError(
                    f"sensors has the key {described(column)}", expected="the name of a column"
                )
        return [_for_column(_one(given), column) for column, given in sensors.items()]
    if _is_one(sensors):
        return [_one(sensors)]
    if not isinstance(sensors, list | tuple):
        raise InputError(f"sensors is {described(sensors)}", expected=EXPECTED)
    files = [_one(given) for given in sensors]
    if len(files) > 1 and any(file.columns == [UNNAMED] for file in files):
        raise InputError(
            "a lag or a chain stands in a list of several sensors without its column",
            expected="a dict {column: sensor}",
        )
    return files


def with_column(files: Sequence[SensorFile], source: Source) -> list[SensorFile]:
    """The sensors, of which one without a column gets the only column of numbers.

    Parameters
    ----------
    files
        Sensors.
    source
        The table.

    Raises
    ------
    InputError
        For a table of several columns of numbers, or of none.
    """
    if not any(file.columns == [UNNAMED] for file in files):
        return list(files)
    names = number_columns(source)
    if len(names) != 1:
        listed = ", ".join(map(repr, names)) or "none"
        raise InputError(
            f"the sensor is given without its column, and the columns of numbers are {listed}",
            where=source.table.where,
            expected="{columns}",
            remedy="or a dict {column: sensor}" if len(names) > 1 else "",
            parameters={"columns": names[:1] or ["NAME"]},
        )
    return [_for_column(file, names[0]) for file in files]


def number_columns(source: Source) -> list[str]:
    """The columns of a table that hold numbers in its first rows, without times."""
    names = [name for name in source.value_columns if not source.table.is_time(name)]
    for _, columns, _ in source.read_chunks(names):
        return [
            name
            for name in names
            if columns[name].dtype != object and np.isfinite(columns[name]).any()
        ]
    return []


def _is_one(given: Any) -> bool:
    """Whether a value is one sensor: no list of them."""
    if isinstance(given, SensorFile | Chain | str | Path):
        return True
    if isinstance(given, tuple) and len(given) == 2 and all(map(_is_number, given)):
        return True
    return _is_number(given)


def _is_number(value: Any) -> bool:
    """Whether a value is a number."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _one(given: Any) -> SensorFile:
    """One sensor as a sensor file; a lag or a chain has the column ``UNNAMED``."""
    if isinstance(given, SensorFile):
        return given
    if isinstance(given, Chain):
        return sensor_file(
            STATED,
            {UNNAMED: given},
            "stated",
            np.zeros((1, 1)),
            [0.0],
            findings=[warning("sensor.exact", lag_s=given.lag_s)],
        )
    if not _is_one(given):
        raise InputError(f"a sensor is {described(given)}", expected=EXPECTED)
    if isinstance(given, str):
        lag = _lag_of_text(given)
        if lag is None:
            return read_sensor(given)
        given = lag
    if isinstance(given, Path):
        return read_sensor(given)
    value, u = given if isinstance(given, tuple) else (given, 0.0)
    return specified_sensor(STATED, [UNNAMED], [(float(value), float(u))])


def _lag_of_text(text: str) -> tuple[float, float] | None:
    """Lag and standard uncertainty [s] of a text; None where it is a path.

    >>> _lag_of_text("25+-1"), _lag_of_text("25 s"), _lag_of_text("probe.sensor.json")
    ((25.0, 1.0), (25.0, 0.0), None)
    """
    return parse_number_with_u(text.removesuffix(" s"))


def _for_column(file: SensorFile, column: str) -> SensorFile:
    """The sensor of a file for one column of a table.

    Parameters
    ----------
    file
        A file of one column, or of several of which one has that name.
    column
        The column.
    """
    own = file.columns[0]
    if len(file.columns) > 1:
        own = column_named(column, file.columns, f"the sensor {file.sensor}")
    index = file.columns.index(own)
    variance = float(file.lag_covariance_s2[index, index])
    chain = SensorChains(
        structure=file.chain.structure,
        channels={column: file.chain.channels[own]},
        covariance=[[variance]],
    )
    times = {column: file.times[own]} if own in file.times else {}
    static = {column: file.static[own]} if own in file.static else {}
    changes = {"columns": [column], "chain": chain, "times": times, "static": static}
    return file.model_copy(update=changes)
