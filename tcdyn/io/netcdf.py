"""Tables as netCDF with the attributes of the CF conventions, written through xarray.

The file is netCDF-3 (64-bit offset), which every library for netCDF reads, and which xarray writes
with scipy. The attributes of variables are also those of ``tcdyn.compensate_dataset``. Used by
:mod:`tcdyn.io.write`. Guarded by ``tests/io/test_netcdf.py``, which reads the files with xarray and
with scipy.

References
----------
NetCDF Climate and Forecast (CF) Metadata Conventions, version 1.11, sections 2.3 (names), 3.1
(units, ``units_metadata``), 3.4 (ancillary data) and 4.4 (time).
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.io.endings import check_size
from tcdyn.io.metadata import COMPENSATED, START_TIME_KEY
from tcdyn.io.unit_names import TEMPERATURES, unit_in, without_unit
from tcdyn.version import __version__

CONVENTIONS = "CF-1.11"  # the first version with ``units_metadata``
METADATA_ATTRIBUTE = "tcdyn_metadata"  # all metadata as JSON, keys as they are
TIME = "time"  # name of the dimension and of its coordinate
ROW = "row"  # name of the dimension of a table without a time
REFERENCES = (
    f"tcdyn {__version__}; JCGM 100:2008 (standard uncertainty); Rauch, Tung and Striebel (1965), "
    "AIAA Journal 3, 1445 (smoother)"
)
# Units as UDUNITS spells them, where it differs. CF 3.1 advises against ppm, a factor is clear.
UDUNITS = {
    "%RH": "percent",
    "%": "percent",
    "ppm": "1e-6",
    "ppb": "1e-9",
    "Ohm": "ohm",
    "counts": "count",
}
# A standard uncertainty and its components, as ``tcdyn.series.units.Unit`` names them.
_UNCERTAINTY = re.compile(r"(?P<stem>.+?)(?:_(?P<component>noise|common))?_u_(?P<unit>.+)")


def udunits(unit: str) -> str:
    """The spelling of a unit in UDUNITS; a unit that is not known stays as it is.

    >>> udunits("degC"), udunits("ppm"), udunits("µV"), udunits("W/m²")
    ('degC', '1e-6', 'uV', 'W/m2')
    """
    known = UDUNITS.get(unit)
    if known is not None:
        return known
    return unicodedata.normalize("NFKC", unit).replace("μ", "u").replace("·", " ")


def variable_names(names: Sequence[str]) -> dict[str, str]:
    """Name of the variable of each column: letters, digits and underscores, a letter first.

    >>> variable_names(["T1 [°C]", "t1_c", "2nd Öldruck", "power_kW", "µ"])
    {'T1 [°C]': 'T1_C', 't1_c': 't1_c_2', '2nd Öldruck': 'v_2nd_Oldruck', 'power_kW': 'power_kW', \
'µ': 'u'}

    Notes
    -----
    CF 2.3: no two names are equal where case is ignored.
    """
    result: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        plain = unicodedata.normalize("NFKD", str(name)).replace("μ", "u")
        plain = re.sub(r"[^A-Za-z0-9_]+", "_", plain.encode("ascii", "ignore").decode())
        if plain != name:
            plain = plain.strip("_")
        if not re.match(r"[A-Za-z]", plain):
            plain = f"v_{plain}".removesuffix("_")
        candidate = plain
        number = 1
        while candidate.lower() in taken:
            number += 1
            candidate = f"{plain}_{number}"
        taken.add(candidate.lower())
        result[name] = candidate
    return result


def variable_attributes(
    names: Sequence[str],
    units: Mapping[str, str] | None = None,
    variables: Mapping[str, str] | None = None,
) -> dict[str, dict[str, str]]:
    """CF attributes of the columns of a table, and which uncertainty belongs to which value.

    Parameters
    ----------
    names
        Names of the columns.
    units
        Units by column, where the names do not state them.
    variables
        Name of the variable of each column, where it is not the same.

    Returns
    -------
    dict
        By column: ``long_name``, with the name of the column if that of the variable differs;
        ``units`` and ``units_metadata`` where the unit is known; ``ancillary_variables``, the
        standard uncertainty and its components, of a value that has them.

    Notes
    -----
    CF has no standard name for a temperature that is neither that of air nor of water, so that
    there is no ``standard_name``. A list of variables is separated by blanks, so that a variable
    with a blank in its name cannot be in it.

    Examples
    --------
    >>> attributes = variable_attributes(["T1", "T1_u_K"], {"T1": "degC"})
    >>> attributes["T1"]["units"], attributes["T1"]["ancillary_variables"]
    ('degC', 'T1_u_K')
    >>> attributes["T1_u_K"]["units"], attributes["T1_u_K"]["long_name"]
    ('K', 'standard uncertainty of T1')
    """
    stated = units or {}
    new_names = variables or {}
    value_of_stem = {without_unit(name): name for name in names if "_u_" not in name}
    result: dict[str, dict[str, str]] = {}
    ancillary: dict[str, list[str]] = {}
    for name in names:
        match = _UNCERTAINTY.fullmatch(name)
        value = None if match is None else value_of_stem.get(match["stem"])
        if match is None or value is None:
            unit = stated.get(name) or unit_in(name)
            result[name] = {"long_name": name, **_unit_attributes(unit)}
            continue
        component = f"{match['component']} component of the " if match["component"] else ""
        long_name = f"{component}standard uncertainty of {value}"
        if new_names.get(name, name) != name:
            long_name = f"{name}, {long_name}"
        result[name] = {"long_name": long_name}
        result[name] |= _unit_attributes(match["unit"], is_difference=True)
        variable = new_names.get(name, name)
        if " " not in variable:
            ancillary.setdefault(value, []).append(variable)
    for value, uncertainties in ancillary.items():
        result[value]["ancillary_variables"] = " ".join(uncertainties)
    return result


def _unit_attributes(unit: str, is_difference: bool = False) -> dict[str, str]:
    """Attributes for a unit; none for an unknown one."""
    if not unit:
        return {}
    attributes = {"units": udunits(unit)}
    if unit in TEMPERATURES:
        kind = "difference" if is_difference else "on_scale"
        attributes["units_metadata"] = f"temperature: {kind}"
    return attributes


@contextmanager
def netcdf_appender(
    path: Path,
    target: Path,
    names: Sequence[str],
    metadata: Mapping[str, str],
    text: Collection[str],
    time: str,
    units: Mapping[str, str],
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """Yield a function that collects tables; they are written when the block succeeds.

    Parameters
    ----------
    path
        File to write.
    target
        The name that messages give it.
    names, metadata, text
        As for ``tcdyn.io.write.log_writer``.
    time, units
        As in ``tcdyn.io.write.OutputStyle``.

    Raises
    ------
    InputError
        For a table that is too large to be written in one piece.

    Notes
    -----
    xarray does not append to a file, so memory grows with the table;
    ``tcdyn.io.endings.MAX_NETCDF_VALUES`` limits it.
    """
    check_size(target, 0, len(names))
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    rows = 0

    def append(frame: pd.DataFrame) -> None:
        """Keep the rows of a table."""
        nonlocal rows
        rows += len(frame)
        check_size(target, rows, len(names))
        for name in names:
            parts[name].append(_values(frame[name].to_numpy(), name in text))

    yield append
    columns = {}
    for name in names:
        empty = np.empty(0, dtype=object if name in text else float)
        columns[name] = np.concatenate([empty, *parts.pop(name)])
    _write(path, columns, metadata, time, units)


def _values(cells: NDArray[Any], is_text: bool) -> NDArray[Any]:
    """Cells (N,) of a column as numbers or as texts, empty where they are missing."""
    if cells.dtype.kind in "fiub" and not is_text:
        return cells.astype(float)
    texts = ["" if cell is None or cell != cell else str(cell) for cell in cells]
    return np.array(texts, dtype=object)


def _write(
    path: Path,
    columns: Mapping[str, NDArray[Any]],
    metadata: Mapping[str, str],
    time: str,
    units: Mapping[str, str],
) -> None:
    """Write the columns of a table as one dataset.

    Parameters
    ----------
    path
        File to write.
    columns
        Columns (N,) by name.
    metadata
        Metadata of the table.
    time
        Column of the time [s]; the rows of a table without it have no coordinate.
    units
        Units by column.
    """
    import xarray as xr

    has_time = time in columns and columns[time].dtype.kind == "f"
    dimension = TIME if has_time else ROW
    names = [name for name in columns if not (has_time and name == time)]
    new_names = variable_names([dimension, *names])
    attributes = variable_attributes(names, units, new_names)
    dataset = xr.Dataset(
        {new_names[name]: (dimension, columns[name], attributes[name]) for name in names},
        attrs=_global_attributes(metadata),
    )
    if has_time:
        attributes_of_time = {"long_name": time, "standard_name": "time", "axis": "T"}
        attributes_of_time |= _time_attributes(columns[time], metadata)
        dataset = dataset.assign_coords({TIME: (TIME, columns[time], attributes_of_time)})
        dataset[TIME].encoding["_FillValue"] = None  # CF 2.5.1: a coordinate has no missing values
    dataset.to_netcdf(path, engine="scipy", format="NETCDF3_64BIT")


def _time_attributes(time_s: Array, metadata: Mapping[str, str]) -> dict[str, str]:
    """Units of the time, and for a dated table the calendar and a note on the time zone.

    Parameters
    ----------
    time_s
        Times (N,) [s].
    metadata
        Metadata, which may state the date and time of the first row.
    """
    start = pd.to_datetime(metadata.get(START_TIME_KEY, ""), errors="coerce")
    if pd.isna(start) or not len(time_s):  # no date, or a key of that name from another program
        return {"units": "s"}
    origin = start - pd.Timedelta(seconds=float(time_s[0]))
    comment = "local clock of the logger, which states no time zone"
    if origin.tzinfo is not None:
        origin = origin.tz_convert("UTC").tz_localize(None)
        comment = "UTC"
    return {
        "units": f"seconds since {origin.isoformat(sep=' ')}",
        "calendar": "standard",
        "comment": comment,
    }


def _global_attributes(metadata: Mapping[str, str]) -> dict[str, str]:
    """Attributes of the file: those of CF, and the metadata as JSON."""
    log = metadata.get("source", "")
    attributes = {"Conventions": CONVENTIONS}
    if log:
        attributes["source"] = f"readings of sensors in {log}"
    action = "compensated" if metadata.get("tcdyn") == COMPENSATED else "written"
    origin = f" from {log}" if log else ""
    checksum = metadata.get("source_sha256")
    origin += f" (SHA-256 {checksum})" if checksum else ""
    attributes["history"] = f"{action} by tcdyn {__version__}{origin}"
    attributes["references"] = REFERENCES
    attributes[METADATA_ATTRIBUTE] = json.dumps(dict(metadata), ensure_ascii=False)
    return attributes
