"""Compensation of tables in memory: Series and DataFrames of pandas, DataArrays and Datasets of
xarray.

A frame is one more source of rows for :mod:`tcdyn.workflows.compensate_table`, so the numbers are
those of a file with the same columns. Guarded by ``tests/sensors/test_compensate_frame.py``.
"""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import pandas as pd

from tcdyn.core.arguments import check_type, described, with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import messages, warnings_and_errors
from tcdyn.core.options import options_of
from tcdyn.io.netcdf import variable_attributes
from tcdyn.sensors.compensation import CompensationMethod
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.given import Sensors, sensor_files
from tcdyn.series import ReadingOptions, open_source
from tcdyn.series.frame import UNITS_KEY, rows_with
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.options import MeansOptions

if TYPE_CHECKING:
    import xarray as xr

WARNINGS_KEY = "warnings"  # entry of ``attrs`` with the warnings as sentences


@with_named_arguments
def compensate_frame(
    data: pd.DataFrame | pd.Series, sensors: Sensors, **options: Any
) -> pd.DataFrame:
    """Compensate the columns of a DataFrame, or a Series, that sensors cover.

    Parameters
    ----------
    data
        The table (N rows). A Series is compensated with a single sensor, whatever its name.
    sensors
        Sensor files, or their paths; each column belongs to one. Or a lag [s] that is stated: 25,
        or (25, 1) and "25+-1" with its standard uncertainty; or a :class:`tcdyn.Chain` that is
        known. These are for ``columns``, or for the only column of numbers; without an uncertainty
        they are taken as exact, with a warning. Or a dict of any of these by column.
    options
        How the table is read and compensated: the fields of
        :class:`tcdyn.workflows.options.MeansOptions`, such as ``columns=["T1"]``, ``time="t"``,
        ``unit="degF"`` and ``rate=True``. Without ``time``, the time is the index. An index of
        numbers is seconds unless its name or ``time_unit`` states another unit. An index of
        integers without a name is taken for the numbers of the rows, unless ``time_unit`` is given;
        a column with the name of a time is used then.

    Returns
    -------
    DataFrame
        The table with the same index and columns. Each column with a sensor is what the sensor
        measures, for a thermocouple the temperature at the junction, in its own unit (mV of a
        thermocouple: degrees Celsius). Before it stands the column as logged,
        ``<name>_logged_degC``; behind it its standard uncertainty, ``<name>_u_K`` (``_u_degF``,
        ``_u_ppm``), and with ``rate`` the rate of change and its standard uncertainty,
        ``<name>_rate_K_s`` and ``<name>_rate_u_K_s``. With ``means`` the table has the rows in the
        middle of each mean. The numbers are not rounded. ``attrs`` holds
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
    >>> done = compensate_frame(pd.Series(reading, time, name="T_degC"), (5.0, 0.1))
    >>> list(done)
    ['T_logged_degC', 'T_degC', 'T_u_K']
    """
    settings = options_of(MeansOptions, options, "compensate_frame")
    check_type("data", data, (pd.DataFrame, pd.Series), "a DataFrame or a Series")
    files = sensor_files(sensors)
    if isinstance(data, pd.Series):
        name = data.name if data.name is not None else _single_column(files)
        data = data.to_frame(name)
        settings = _for_one_column(settings, str(name), files)
    return _compensate_frame(data, files, settings, {}).frame


@with_named_arguments
def compensate_dataset(
    data: xr.Dataset | xr.DataArray, sensors: Sensors, **options: Any
) -> xr.Dataset:
    """Compensate the variables of an xarray Dataset, or a DataArray, that sensors cover.

    Parameters
    ----------
    data
        Variables along one dimension, whose coordinate is the time. Units are read from the
        attribute ``units`` of variables and coordinate where they have one.
    sensors, options
        As for ``compensate_frame``.

    Returns
    -------
    Dataset
        The dataset with the logged readings, the temperatures at the junctions and their standard
        uncertainties, as for ``compensate_frame``; coordinates and other variables as they were.
        Values and uncertainties have the attributes ``units`` and ``long_name``, and a value the
        attribute ``ancillary_variables`` (CF conventions); attributes that a variable had stay.

    Raises
    ------
    InputError
        As ``compensate_frame`` does; for data with several dimensions.

    Examples
    --------
    >>> kiln = xr.open_dataset("kiln.nc")  # doctest: +SKIP
    >>> compensate_dataset(kiln["T1_degC"], "probe.sensor.json")  # doctest: +SKIP
    """
    settings = options_of(MeansOptions, options, "compensate_dataset")
    if not hasattr(data, "dims"):
        raise InputError(
            f"data is {described(data)}", expected="a Dataset or a DataArray of xarray"
        )
    files = sensor_files(sensors)
    if not hasattr(data, "data_vars"):
        name = str(data.name) if data.name is not None else _single_column(files)
        data = data.to_dataset(name=name)
        settings = _for_one_column(settings, name, files)
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
    done = _compensate_frame(frame, files, settings, units)
    names = [str(name) for name in done.frame.columns]
    result = data.drop_vars(list(data.data_vars))
    result = result.assign({name: (dimension, done.frame[name].to_numpy()) for name in names})
    for label, variable in data.data_vars.items():
        for new_name in (str(label), done.logged_names.get(str(label), "")):
            if new_name in names:
                result[new_name].attrs = dict(variable.attrs)
    for name, entry in variable_attributes(names, done.units).items():
        if name in done.units or name not in data.data_vars:
            result[name].attrs = {**entry, **result[name].attrs}
    return result.assign_attrs(done.frame.attrs)


def _for_one_column(settings: MeansOptions, name: str, files: Sequence[SensorFile]) -> MeansOptions:
    """The options with the only column of the data as that of a single sensor."""
    if settings.columns or len(files) != 1 or len(files[0].columns) != 1:
        return settings
    return replace(settings, columns=[name])


def _single_column(files: Sequence[SensorFile]) -> str:
    """Name for data without one: that of the sensor's column."""
    name = files[0].columns[0].replace("*", "") if files else ""
    return name or "temperature"


@dataclass(frozen=True)
class _Compensated:
    """A compensated frame.

    Attributes
    ----------
    frame
        The frame.
    logged_names
        New name of each logged column, by its old one.
    units
        Units of the results, by their names in the frame.
    """

    frame: pd.DataFrame
    logged_names: dict[str, str]
    units: dict[str, str]


def _compensate_frame(
    frame: pd.DataFrame,
    files: Sequence[SensorFile],
    settings: MeansOptions,
    units: Mapping[str, str],
) -> _Compensated:
    """The frame with compensated columns, warnings and attributes; see ``compensate_frame``.

    Parameters
    ----------
    frame
        The table.
    files
        The sensors.
    settings
        How it is read and compensated.
    units
        Units by column, from attributes of xarray.
    """
    names = [str(label) for label in frame.columns]
    if not len(frame):
        raise InputError("no rows", where="the DataFrame", expected="a table with readings")
    reading = settings.rows
    if reading.where is not None:
        frame = rows_with(frame, *reading.condition)
        reading = replace(reading, where=None)
    table = frame.copy(deep=False)
    table.attrs = {**frame.attrs, UNITS_KEY: {**frame.attrs.get(UNITS_KEY, {}), **units}}
    source = open_source(table, options=reading)
    of_rows = [each.name for each in fields(ReadingOptions)]
    others = {name: value for name, value in settings.stated.items() if name not in of_rows}
    parts: list[pd.DataFrame] = []
    done = compensate_table(source, files, parts.append, **others)
    serious = messages(warnings_and_errors(done.findings))
    for message in serious:
        warnings.warn(message, UserWarning, stacklevel=4)  # the caller of the public function
    made = pd.concat(parts)
    method = CompensationMethod(rate=settings.rate, components=settings.components)
    frame = frame.iloc[made.index.to_numpy()]
    units_of_channels = {channel.column: channel.unit for channel in done.columns}
    columns: dict[Hashable, pd.Series] = {}
    logged_names = {}
    output_units = {}
    for name, label in zip(names, frame.columns):
        if name not in units_of_channels:
            columns[label] = frame[label]
            continue
        unit = units_of_channels[name]
        logged, *results = method.output_names(unit, name)
        logged_names[name] = logged
        output_units[results[0]] = unit.output
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
    return _Compensated(result, logged_names, output_units)
