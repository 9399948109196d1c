"""Compensation of tables in memory: Series and DataFrames of pandas, DataArrays and Datasets of
xarray.

A frame is one more source of rows for :mod:`tcdyn.workflows.compensate_table`, so the numbers are
those of a file with the same columns. Guarded by ``tests/sensors/test_compensate_frame.py``.
"""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.core.findings import messages, warnings_and_errors
from tcdyn.sensors.compensation import CompensationMethod
from tcdyn.sensors.file import SensorFile, read_sensor
from tcdyn.series import ReadingOptions, open_source
from tcdyn.series.frame import UNITS_KEY, rows_with
from tcdyn.workflows.compensate_table import compensate_table

if TYPE_CHECKING:
    import xarray as xr

Sensors = SensorFile | str | Path | Sequence[SensorFile | str | Path]
WARNINGS_KEY = "warnings"  # entry of ``attrs`` with the warnings as sentences


def compensate_frame(
    data: pd.DataFrame | pd.Series,
    sensors: Sensors,
    *,
    columns: Sequence[str] = (),
    time: str | None = None,
    time_unit: str | None = None,
    unit: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    rate: bool = False,
    **reading: Any,
) -> pd.DataFrame:
    """Compensate the columns of a DataFrame, or a Series, that sensors cover.

    Parameters
    ----------
    data
        The table (N rows). A Series is compensated with a single sensor, whatever its name.
    sensors
        Sensors, or paths of sensor files; each column belongs to one.
    columns
        Columns that a single sensor covers here, instead of its own.
    time
        Column of the time; None: the index. An index of numbers is seconds unless its name or
        ``time_unit`` states another unit. An index of integers without a name is taken for the
        numbers of the rows, unless ``time_unit`` is given; a column with the name of a time is used
        then.
    time_unit
        Unit of the time (s, ms, us, ns, min, h or days), where its name does not say so.
    unit
        "degC", "K", "degF", "mV" or that of another quantity ("ppm", "%RH", "Pa", "V") for all
        columns, or by column; otherwise as the names say.
    couple, cold
        Of millivolts: the thermocouple's type ("none" if it is another voltage), and the reference
        junction [degC] or its column.
    rate
        Also the rate of change of each result and its standard uncertainty.
    reading
        ``dt_s``, ``where``, ``on_change`` and ``averages_s`` as in
        :class:`tcdyn.series.ReadingOptions`.

    Returns
    -------
    DataFrame
        The table with the same index and columns. Each column with a sensor is what the sensor
        measures, for a thermocouple the temperature at the junction, in its own unit (mV of a
        thermocouple: degrees Celsius). Before it stands the column as logged,
        ``<name>_logged_degC``; behind it its standard uncertainty, ``<name>_u_K`` (``_u_degF``,
        ``_u_ppm``), and with ``rate`` the rate of change and its standard uncertainty,
        ``<name>_rate_K_s`` and ``<name>_rate_u_K_s``. The numbers are not rounded. ``attrs`` holds
        those of ``data``, the metadata that a file would have, and the list ``warnings``.

    Raises
    ------
    InputError
        As ``compensate_table`` does; for names that occur twice, a column with a sensor that holds
        no numbers, and an index that is no time.

    Warns
    -----
    UserWarning
        For each finding that is a warning.

    Examples
    --------
    >>> import numpy as np
    >>> from tcdyn.sensors import sensor_file
    >>> from tcdyn.chain import Chain
    >>> probe = sensor_file("probe", {"T_degC": Chain(5.0)}, "stated", np.array([[0.01]]), [0.0])
    >>> reading = 20 + 80 * (1 - np.exp(-np.arange(60) / 5.0))
    >>> time = pd.date_range("2026-03-01 10:00", periods=60, freq="s")
    >>> done = compensate_frame(pd.Series(reading, time, name="T_degC"), probe)
    >>> list(done), done.index.equals(time), done.attrs["start_time"]
    (['T_logged_degC', 'T_degC', 'T_u_K'], True, '2026-03-01T10:00:00')
    """
    files = _sensor_files(sensors)
    if isinstance(data, pd.Series):
        name = data.name if data.name is not None else _single_column(files)
        data = data.to_frame(name)
        columns = columns or ([str(name)] if len(files) == 1 and len(files[0].columns) == 1 else ())
    options = {"columns": columns, "unit": unit, "couple": couple, "cold": cold, "rate": rate}
    rows = ReadingOptions(time, time_unit, **reading)
    return _compensate_frame(data, files, rows, {}, options)[0]


def compensate_dataset(
    data: xr.Dataset | xr.DataArray,
    sensors: Sensors,
    *,
    columns: Sequence[str] = (),
    time_unit: str | None = None,
    unit: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    rate: bool = False,
) -> xr.Dataset:
    """Compensate the variables of an xarray Dataset, or a DataArray, that sensors cover.

    Parameters
    ----------
    data
        Variables along one dimension, whose coordinate is the time. Units are read from the
        attribute ``units`` of variables and coordinate where they have one.
    sensors, columns, time_unit, unit, couple, cold, rate
        As for ``compensate_frame``.

    Returns
    -------
    Dataset
        The dataset with the logged readings, the temperatures at the junctions and their standard
        uncertainties, as for ``compensate_frame``; coordinates and other variables as they were.

    Raises
    ------
    InputError
        As ``compensate_frame`` does; for data with several dimensions.

    Examples
    --------
    >>> kiln = xr.open_dataset("kiln.nc")  # doctest: +SKIP
    >>> compensate_dataset(kiln["T1_degC"], "probe.sensor.json")  # doctest: +SKIP
    """
    files = _sensor_files(sensors)
    if not hasattr(data, "data_vars"):
        name = str(data.name) if data.name is not None else _single_column(files)
        data = data.to_dataset(name=name)
        columns = columns or ([name] if len(files) == 1 and len(files[0].columns) == 1 else ())
    if len(data.dims) != 1:
        raise InputError(
            f"the data have dimensions {', '.join(map(repr, data.dims)) or 'none'}",
            expected="one dimension, the time",
            remedy="select the data along the other dimensions",
        )
    dimension = next(iter(data.dims))
    index = data.get_index(dimension)
    if dimension not in data.coords:
        index = index.rename(None)
    frame = pd.DataFrame({str(n): v.values for n, v in data.data_vars.items()}, index)
    frame.attrs = dict(data.attrs)
    units = {str(n): str(v.attrs["units"]) for n, v in data.variables.items() if "units" in v.attrs}
    options = {"columns": columns, "unit": unit, "couple": couple, "cold": cold, "rate": rate}
    rows = ReadingOptions(time_unit=time_unit)
    done, logged_names = _compensate_frame(frame, files, rows, units, options)
    result = data.drop_vars(list(data.data_vars))
    result = result.assign({name: (dimension, done[name].to_numpy()) for name in done.columns})
    for label, variable in data.data_vars.items():
        for new_name in (str(label), logged_names.get(str(label))):
            if new_name in done.columns:
                result[new_name].attrs = dict(variable.attrs)
    return result.assign_attrs(done.attrs)


def _sensor_files(sensors: Sensors) -> list[SensorFile]:
    """The sensors as a list; paths are read."""
    listed = [sensors] if isinstance(sensors, SensorFile | str | Path) else list(sensors)
    return [s if isinstance(s, SensorFile) else read_sensor(s) for s in listed]


def _single_column(files: Sequence[SensorFile]) -> str:
    """Name for data without one: that of the sensor's column."""
    return files[0].columns[0].replace("*", "") if files else "temperature"


def _compensate_frame(
    frame: pd.DataFrame,
    files: Sequence[SensorFile],
    reading: ReadingOptions,
    units: Mapping[str, str],
    options: Mapping[str, Any],
) -> tuple[pd.DataFrame, dict[str, str]]:
    """The frame with compensated columns, warnings and attributes; see ``compensate_frame``.

    Also the new name of each logged column.

    Parameters
    ----------
    frame
        The table.
    files
        The sensors.
    reading
        How its rows are read.
    units
        Units by column, from attributes of xarray.
    options
        Further arguments of ``compensate_table``.
    """
    names = [str(label) for label in frame.columns]
    if not len(frame):
        raise InputError("no rows", where="the DataFrame", expected="a table with readings")
    if reading.where is not None:
        frame = rows_with(frame, *reading.condition)
        reading = replace(reading, where=None)
    table = frame.copy(deep=False)
    table.attrs = {**frame.attrs, UNITS_KEY: {**frame.attrs.get(UNITS_KEY, {}), **units}}
    source = open_source(table, options=reading)
    parts: list[pd.DataFrame] = []
    done = compensate_table(source, files, parts.append, **options)
    serious = messages(warnings_and_errors(done.findings))
    for message in serious:
        warnings.warn(message, UserWarning, stacklevel=3)
    made = pd.concat(parts, ignore_index=True)
    method = CompensationMethod(rate=bool(options.get("rate")))
    units_of_channels = {channel.column: channel.unit for channel in done.columns}
    columns: dict[Hashable, pd.Series] = {}
    logged_names = {}
    for name, label in zip(names, frame.columns):
        if name not in units_of_channels:
            columns[label] = frame[label]
            continue
        logged, *results = method.output_names(units_of_channels[name], name)
        logged_names[name] = logged
        columns[logged] = frame[label]
        for result_name in results:
            new_label: Hashable = label if result_name == name else result_name
            columns[new_label] = pd.Series(made[result_name].to_numpy(), frame.index)
    metadata = {key: value for key, value in done.metadata.items() if key != "source"}
    result = pd.DataFrame(columns, frame.index)
    result.columns.name = frame.columns.name
    result.attrs = dict(frame.attrs)
    result.attrs.update(metadata)
    result.attrs[WARNINGS_KEY] = list(serious)
    return result, logged_names
