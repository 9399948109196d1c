"""Metadata of a table in CSV: a JSON file beside it; and how a compensated table is recognised.

A CSV file that tcdyn writes begins with its header, so that every program reads it. What the file
states about itself is in ``<name>.csv.meta.json``. Written by :mod:`tcdyn.io.write`, read by
:mod:`tcdyn.io.read`. Guarded by ``tests/io/test_metadata.py``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.io.unit_names import is_same_name, without_unit

METADATA_ENDING = ".meta.json"  # behind the name of the table
METADATA_SCHEMA = "tcdyn.table/2"
# Schemas that are read: in a compensated table of the first, no column has the readings as logged.
READ_SCHEMAS = (METADATA_SCHEMA, "tcdyn.table/1")
METADATA_SHEET = "metadata"  # of a workbook, with one entry in each row
METADATA_HEADER = ("key", "value")  # its first row
COMPENSATED = "compensated"  # value of the entry "tcdyn" of a compensated table
RESULTS = "results"  # value of the entry "tcdyn" of a table of results, which is no log
SIMULATED_KEY = "simulated"  # entry of a log that the simulator wrote
START_TIME_KEY = "start_time"  # entry with the date and time of the first row, ISO 8601
LOGGED = "_logged"  # in the name of a column as logged, beside its result
# columns of a standard uncertainty, and of that of a rate of change; and what may follow the stem
# of the former in the name of the temperature
_UNCERTAINTY = re.compile(r"(?P<stem>.+)_u_(?:K|degF)")
_RATE_UNCERTAINTY = re.compile(r"(?P<rate>.+_rate)_u(?P<unit>_.+_s)")
_UNIT_ENDING = r"(?:_degC|_K|_degF|_mV|\s*[\[(][^\])]*[\])])?"


def metadata_path(path: str | Path) -> Path:
    """The file with the metadata of a table.

    >>> metadata_path("lab/kiln.csv").name
    'kiln.csv.meta.json'
    """
    table = Path(path)
    return table.with_name(table.name + METADATA_ENDING)


def metadata_text(names: Sequence[str], metadata: Mapping[str, str]) -> str:
    """Content of the file with the metadata of a table.

    Parameters
    ----------
    names
        Names of the columns as they are in the header. They show later that the file belongs to the
        table.
    metadata
        Keys and values.
    """
    content = {"schema": METADATA_SCHEMA, "columns": list(names), "metadata": dict(metadata)}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def read_metadata(path: Path, names: Sequence[str]) -> tuple[dict[str, str], list[Finding]]:
    """Metadata in the file beside a table.

    Parameters
    ----------
    path
        The table.
    names
        Names of its columns.

    Returns
    -------
    metadata
        Keys and values; empty if there is no such file, or another program wrote it.
    findings
        A warning if the file is damaged, or of a table with other columns. It is not used then.

    Notes
    -----
    The columns are compared, and not the rows: rows of a table may be appended or cut off. Of a
    compensated table columns may be left out, too: it is one also without its uncertainties, and
    must not be compensated twice.
    """
    file = metadata_path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, ValueError):  # most tables have none
        return {}, []
    content = _content(text)
    if content is None:
        return {}, [warning("metadata.damaged", subject=file.name)]
    if content.get("schema") not in READ_SCHEMAS:
        return {}, []
    columns = content.get("columns")
    metadata = content.get("metadata")
    if not isinstance(columns, list) or not isinstance(metadata, dict):
        return {}, [warning("metadata.damaged", subject=file.name)]
    known = {_signature([name]) for name in columns}
    is_part = known.issuperset(_signature([name]) for name in names)
    is_part_of_compensated = is_part and metadata.get("tcdyn") == COMPENSATED
    if _signature(columns) != _signature(names) and not is_part_of_compensated:
        return {}, [warning("metadata.other_table", subject=file.name)]
    return {str(key): str(value) for key, value in metadata.items()}, []


def _signature(names: Sequence[object]) -> str:
    """The names without what readers change in them: spaces, quotation marks and separators."""
    return re.sub(r'[\s",;]', "", "".join(map(str, names)))


def check_metadata_file_is_ours(path: Path) -> None:
    """Check that the file of metadata of a table may be replaced or deleted.

    Parameters
    ----------
    path
        The table.

    Raises
    ------
    InputError
        If there is such a file, and another program wrote it.
    """
    file = metadata_path(path)
    if not file.exists():
        return
    content = None
    if file.is_file():
        content = _content(file.read_text(encoding="utf-8", errors="replace"))
    if content is None or content.get("schema") not in READ_SCHEMAS:
        raise InputError(
            "is no file of metadata of tcdyn, and would be replaced",
            where=str(file),
            expected=f"schema {METADATA_SCHEMA}",
            remedy="rename that file, or give another name of the output",
        )


def _content(text: str) -> dict[str, Any] | None:
    """The JSON object in a text; None for any other text."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def check_not_compensated(names: Collection[str], metadata: Mapping[str, str], where: str) -> None:
    """Check that a table is not the output of a compensation.

    Parameters
    ----------
    names
        Names of its columns.
    metadata
        Its metadata.
    where
        The table, for messages.

    Raises
    ------
    InputError
        With the reason: the metadata say so, or there are columns as only a compensation makes
        them.

    Notes
    -----
    The columns decide alone where the file of metadata was lost. Of one sensor two of them are
    enough, see ``compensated_pair``. A result alone looks like a raw column, and a logged column
    alone is one.
    """
    expected = "a table as the logger wrote it"
    remedy = "give the raw table: static lines and chain must not be applied twice"
    if metadata.get("tcdyn") == COMPENSATED:
        reason = "is compensated already: its metadata say so"
        raise InputError(reason, where=where, expected=expected, remedy=remedy)
    pair = compensated_pair(names)
    if pair is not None:
        name, other = pair
        raise InputError(
            f"is compensated already: it has columns {name!r} and {other!r}",
            where=where,
            expected=expected,
            remedy=f"{remedy}. If it is raw, rename column {other!r}",
        )


def compensated_pair(names: Collection[str]) -> tuple[str, str] | None:
    """Two columns of one sensor as only a compensation names them, if there are such.

    Parameters
    ----------
    names
        Names of the columns.

    Returns
    -------
    pair
        A temperature and its standard uncertainty; a result and the column as logged; that column
        and a standard uncertainty or a rate of change; or a rate of change and its standard
        uncertainty.

    Examples
    --------
    >>> compensated_pair(["time", "T1 [K]", "T1_u_K"]), compensated_pair(["T1", "u_K", "T2_u_K"])
    (('T1 [K]', 'T1_u_K'), None)
    >>> compensated_pair(["T1_logged_mV", "T1_degC"]), compensated_pair(["x_logged_V", "y_V"])
    (('T1_degC', 'T1_logged_mV'), None)
    >>> compensated_pair(["x_logged_ppm", "x_u_ppm"])
    ('x_logged_ppm', 'x_u_ppm')
    """
    for name in names:
        stem = without_unit(name)
        if not stem.endswith(LOGGED):
            continue
        of_sensor = stem.removesuffix(LOGGED)
        before_compensation = of_sensor + name.removeprefix(stem)
        for other in names:
            if is_same_name(before_compensation, other):
                return other, name
        for other in names:
            if other.startswith((f"{of_sensor}_u_", f"{of_sensor}_rate_")):
                return name, other
    for u_name in names:
        match = _RATE_UNCERTAINTY.fullmatch(u_name)
        if match is not None and match["rate"] + match["unit"] in names:
            return match["rate"] + match["unit"], u_name
    for u_name in names:
        match = _UNCERTAINTY.fullmatch(u_name)
        if match is None:
            continue
        temperature = re.compile(re.escape(match["stem"]) + _UNIT_ENDING)
        for name in names:
            if name != u_name and temperature.fullmatch(name):
                return name, u_name
    return None
