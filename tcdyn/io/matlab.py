"""Variables of a MATLAB file (.mat up to version 7) as tables.

Used by :mod:`tcdyn.io.read`, which imports this module only for such files. Read by scipy, after
the sizes that the file states were checked. Guarded by ``tests/io/test_matlab_files.py``.

Notes
-----
What is a table:

- vectors of one length beside each other, at the top level or in a struct, named as they are;
- a matrix, whose columns are named by a cell array or character array of as many texts beside it
  (``colheaders`` of ``importdata``), or else by their number: "column 1". With fewer rows than
  columns, or names for its rows, each row is a channel;
- a matrix beside a vector of times with as many rows: its columns are ``T_1``, ``T_2``;
- an array of structs with a number in each field: one row for each of them.

Numbers and texts that stand alone are metadata. Tables, timetables, datetimes and other objects of
MATLAB are stored in a form that only MATLAB documents; they are refused with the line that converts
them. Days of ``datenum`` are numbers whose unit the user states (days).
"""

from __future__ import annotations

import io
import math
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatlabFunction, MatlabOpaque, matfile_version

from tcdyn.core import Array
from tcdyn.core.errors import InputError, printable
from tcdyn.core.findings import Finding, SampleLocation
from tcdyn.io.cells import TextColumn
from tcdyn.io.stamps import is_stamp
from tcdyn.io.table import Columns, Table, in_chunks
from tcdyn.io.times import is_time_name

# Bytes of a file, and of its unpacked content, against damaged and malicious files: compressed
# variables can unpack to a thousand times their size. 40 columns of a million rows have 0.3 GB.
MAX_BYTES = 1 << 30
MAX_DEPTH = 8  # of structs in structs; chosen by judgement
MAX_NAME = 1 << 12  # characters of the name of a field; MATLAB has 64
MAX_ARRAYS = 40  # of arrays in arrays: cells in structs in cells; chosen by judgement
LISTED = 8  # variables that a message names
LEAST_ROWS = 2  # of a table
_VERSION_4 = 0  # as scipy counts
_HEADER_BYTES = 128
_TAG_BYTES = 8
_COMPRESSED = 15  # types of data elements, see "MAT-File Format" of MathWorks
_MATRIX = 14
_FLAGS_TYPE = 6
_SIZE_TYPES = (5, 6)  # some programs write unsigned ones
_NAME_TYPES = (1, 2, 16)
_DATA_TYPES = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18)
_COMPLEX = 0x800  # flag of an array
_CELL, _STRUCT, _OBJECT, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 5, 16, 17  # classes of arrays
_TEXT_LENGTH = 2000  # characters of a value of metadata
# The line of MATLAB that converts an object, by its class
_CONVERSIONS = {
    "table": "writetable({name}, '{stem}.csv')",
    "timetable": "writetimetable({name}, '{stem}.csv')",
    "datetime": "{name} = posixtime({name}); save('{stem}_v7.mat', '-v7')",
    "duration": "{name} = seconds({name}); save('{stem}_v7.mat', '-v7')",
    "string": "{name} = cellstr({name}); save('{stem}_v7.mat', '-v7')",
    "categorical": "{name} = cellstr({name}); save('{stem}_v7.mat', '-v7')",
    "timeseries": "writetable(table({name}.Time, {name}.Data), '{stem}.csv')",
}
_OTHER_CONVERSION = "writetable(T, '{stem}.csv'), where T is a table of its columns"


# Type, content and all bytes of a data element
_Element = tuple[int, bytes, bytes]


@dataclass(frozen=True)
class _Candidate:
    """Columns of one length that stand together in a file.

    Attributes
    ----------
    path
        Variable that holds them, such as "log.data"; empty for the top level.
    members
        Variables that they are.
    columns
        Numbers, or texts (N,), by name.
    metadata
        Numbers and texts that stand beside them.
    objects
        Classes of the objects of MATLAB beside them, by variable.
    """

    path: str
    members: tuple[str, ...]
    columns: dict[str, NDArray[Any]]
    metadata: dict[str, str] = field(default_factory=dict)
    objects: dict[str, str] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values())))

    @property
    def has_time(self) -> bool:
        """Whether one of the columns is a time by its name, or holds clock stamps."""
        return any(
            is_time_name(name) or (cells.dtype == object and is_stamp(cells[0]))
            for name, cells in self.columns.items()
        )

    @property
    def text(self) -> str:
        """What it is, for messages: "log.data (100 x 3)"."""
        name = self.path or self.members[0]
        return f"{printable(name)!r} ({self.rows} x {len(self.columns)})"


def mat_table(path: Path, where: str, variable: str | None = None) -> Table:
    """The table in a MATLAB file; messages count its rows from 1.

    Parameters
    ----------
    path
        The file.
    where
        The file, for messages.
    variable
        Variable that holds the table, such as "log" or "log.data", or one of its vectors. None: the
        only table, or the only one with a time.

    Raises
    ------
    InputError
        If the file is damaged, holds no table or several, or holds its table or time as objects of
        MATLAB.
    """
    variables, objects = _read_variables(path, where)
    candidates = list(_candidates("", variables, objects, 0))
    all_objects = dict(objects)
    for candidate in candidates:
        all_objects |= candidate.objects
    for name, content in variables.items():
        all_objects |= _objects_in(name, content, 0)
    if variable is None:
        chosen = _only_table(candidates, all_objects, path.stem, where)
    else:
        chosen = _named_table(candidates, variable, all_objects, path.stem, where)
    if len(candidates) > 1 and chosen.path:
        where = f"{where}, variable {printable(chosen.path)}"
    return _as_table(chosen, where)


def version_7_3_error(path: Path, where: str) -> InputError:
    """The error for a MATLAB file of version 7.3, which is an HDF5 file."""
    stem = _quoted_stem(path.stem)
    return InputError(
        "this is a MATLAB file of version 7.3 (HDF5)",
        where=where,
        expected="a MATLAB file of version 7",
        remedy=f"in MATLAB: s = load('{stem}.mat'); save('{stem}_v7.mat', '-struct', 's', '-v7')",
    )


def _only_table(
    candidates: Sequence[_Candidate], objects: Mapping[str, str], stem: str, where: str
) -> _Candidate:
    """The only table of a file, or the only one with a time.

    Parameters
    ----------
    candidates
        Tables of the file.
    objects
        Classes of the objects of MATLAB in it, by variable.
    stem
        Name of the file without its ending.
    where
        The file, for messages.
    """
    with_time = [each for each in candidates if each.has_time]
    if len(with_time) == 1:
        return with_time[0]
    chosen = candidates[0] if len(candidates) == 1 else None
    if not with_time and objects and (chosen is None or chosen.objects):
        name = _likely_object(objects)
        raise _object_error(name, objects[name], stem, where)
    if chosen is not None:
        return chosen
    if not candidates:
        raise InputError(
            "holds no table",
            where=where,
            expected="vectors of one length, a struct of them, or a matrix",
        )
    listed = with_time or candidates
    kind = "tables with a time" if with_time else "tables, of which none has a time by its name"
    raise _choice_error(f"holds {len(listed)} {kind}", listed, where)


def _named_table(
    candidates: Sequence[_Candidate],
    variable: str,
    objects: Mapping[str, str],
    stem: str,
    where: str,
) -> _Candidate:
    """The table in a variable; the other parameters are those of ``_only_table``."""
    found = [each for each in candidates if each.path == variable]
    found = found or [each for each in candidates if variable in each.members]
    if len(found) > 1:
        found = [each for each in found if each.has_time] or found
    if len(found) == 1:
        return found[0]
    if variable in objects:
        raise _object_error(variable, objects[variable], stem, where)
    if found:
        raise _choice_error(f"variable {variable!r} holds {len(found)} tables", found, where)
    raise _choice_error(f"has no table in a variable {variable!r}", candidates, where)


def _choice_error(problem: str, candidates: Sequence[_Candidate], where: str) -> InputError:
    """The error that names the tables of a file, so that the user chooses one."""
    texts = [each.text for each in candidates[:LISTED]]
    more = len(candidates) - len(texts)
    listed = ", ".join(texts) + (f" and {more} more" if more else "")
    first = next((each.path or each.members[0] for each in candidates), "NAME")
    return InputError(
        problem,
        where=where,
        expected=f"one of {listed}" if texts else "a variable with a table",
        remedy="name its variable, {variable}",
        parameters={"variable": printable(first)},
    )


def _likely_object(objects: Mapping[str, str]) -> str:
    """Name of the object that most probably holds the table or its time."""
    order = [*_CONVERSIONS]
    ranks = {name: order.index(c) if c in order else len(order) for name, c in objects.items()}
    return min(ranks, key=lambda name: ranks[name])


def _object_error(name: str, class_name: str, stem: str, where: str) -> InputError:
    """The error for an object that only MATLAB can read, with the line that converts it."""
    line = _CONVERSIONS.get(class_name, _OTHER_CONVERSION)
    line = line.format(name=printable(name), stem=_quoted_stem(stem))
    return InputError(
        f"variable {printable(name)!r} is a {printable(class_name)} of MATLAB, which only MATLAB "
        "can read",
        where=where,
        expected="vectors, structs or matrices of numbers",
        remedy=f"in MATLAB: {line}",
    )


def _quoted_stem(stem: str) -> str:
    """The name of a file without its ending, for a text of MATLAB in single quotes."""
    return printable(stem).replace("'", "''")


def _as_table(candidate: _Candidate, where: str) -> Table:
    """The open table of the columns; texts are read as those of a text file."""
    location = SampleLocation(where)
    data: dict[str, Array] = {}
    texts: dict[str, NDArray[Any]] = {}
    clocks: list[str] = []
    findings: list[Finding] = []
    raw_cells: dict[str, NDArray[Any]] = {}
    for name, values in candidate.columns.items():
        if values.dtype != object:
            data[name] = values
            continue
        cells = [str(cell).strip() for cell in values]
        raw_cells[name] = np.array(cells, dtype=object)
        column = TextColumn(name, ".", location)
        data[name] = column.numbers(cells, 0)
        findings += column.findings(len(cells), is_complete=False)
        if column.clock or column.words:
            texts[name] = raw_cells[name]
        if column.clock:
            clocks.append(name)
    stored = Columns(data, location, tuple(findings), texts)
    return Table(
        where,
        tuple(data),
        candidate.metadata,
        partial(in_chunks, stored),
        clock_columns=tuple(clocks),
        cells=raw_cells,
    )


def _candidates(
    path: str, variables: Mapping[str, Any], objects: Mapping[str, str], depth: int
) -> Iterator[_Candidate]:
    """Yield the tables among variables that stand together, and those in their structs.

    Parameters
    ----------
    path
        The struct that holds them; empty for the top level.
    variables
        The variables by name.
    objects
        Classes of objects of MATLAB among them that were left out, by name.
    depth
        Number of structs around them.
    """
    vectors: dict[str, NDArray[Any]] = {}
    matrices: dict[str, Array] = {}
    metadata: dict[str, str] = {}
    inner: dict[str, Any] = {}
    beside = {_joined(path, name): kind for name, kind in objects.items()}
    for name, value in variables.items():
        vector = _vector(value)
        matrix = None if vector is not None else _matrix(value)
        if vector is not None:
            vectors[name] = vector
        elif matrix is not None:
            matrices[name] = matrix
        elif isinstance(value, MatlabOpaque):
            beside[_joined(path, name)] = _class_of(value)
        elif isinstance(value, dict | list | np.ndarray):
            inner[name] = value
        elif isinstance(value, str | bool | int | float):
            metadata[printable(name)] = str(value)[:_TEXT_LENGTH]
    used = set()
    names_of = {name: _column_names(matrix, vectors) for name, matrix in matrices.items()}
    titles = {id(texts) for texts in names_of.values() if texts is not None}
    for length in dict.fromkeys(len(vector) for vector in vectors.values()):
        group = {n: v for n, v in vectors.items() if len(v) == length and id(v) not in titles}
        if not group:
            continue
        members = [_joined(path, name) for name in group]
        if any(is_time_name(name) for name in group):
            for name, matrix in matrices.items():
                joined = _split_matrix(name, matrix, length, names_of[name])
                if joined and not joined.keys() & group.keys():
                    group |= joined
                    used.add(name)
                    members.append(_joined(path, name))
        if any(vector.dtype != object for vector in group.values()):
            yield _Candidate(path, tuple(members), group, metadata, beside)
    for name, matrix in matrices.items():
        if name not in used:
            columns = _columns_of_matrix(matrix, names_of[name])
            where = _joined(path, name)
            yield _Candidate(where, (where,), columns, metadata, beside)
    if depth == MAX_DEPTH:
        return
    for name, value in inner.items():
        where = _joined(path, name)
        if isinstance(value, dict):
            yield from _candidates(where, value, {}, depth + 1)
        elif records := _columns_of_records(value):
            yield _Candidate(where, (where,), records, metadata, beside)


def _joined(path: str, name: str) -> str:
    """Name of a field of a struct."""
    return f"{path}.{name}" if path else name


def _vector(value: Any) -> NDArray[Any] | None:
    """Numbers or texts (N,) as a column, of at least ``LEAST_ROWS`` rows; None for other values."""
    if isinstance(value, MatlabOpaque | MatlabFunction):
        return None
    if isinstance(value, list) and value and all(isinstance(cell, str) for cell in value):
        value = np.array(value, dtype=object)
    if not isinstance(value, np.ndarray) or value.ndim != 1 or len(value) < LEAST_ROWS:
        return None
    if value.dtype.kind in "fiub":
        return np.asarray(value, dtype=np.float64)
    if value.dtype.kind == "U":
        return value.astype(object)
    if value.dtype == object:
        # an empty cell comes as an empty array
        cells = [_text_or_none(cell) for cell in value]
        if all(cell is not None for cell in cells):
            return np.array(cells, dtype=object)
    return None


def _text_or_none(cell: Any) -> str | None:
    """The text of a cell of a cell array; None if it holds something else."""
    if isinstance(cell, str):
        return cell
    return "" if isinstance(cell, np.ndarray) and cell.size == 0 else None


def _matrix(value: Any) -> Array | None:
    """A matrix of numbers as floats; None for other values."""
    if isinstance(value, MatlabOpaque | MatlabFunction) or not isinstance(value, np.ndarray):
        return None
    is_matrix = value.ndim == 2 and max(value.shape) >= LEAST_ROWS and value.size > 0
    if not is_matrix or value.dtype.kind not in "fiub":
        return None
    return np.asarray(value, dtype=np.float64)


def _column_names(matrix: Array, vectors: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
    """The names of the channels of a matrix, if one set of texts beside it has their number."""
    found: list[NDArray[Any]] = []
    for texts in vectors.values():
        is_set = texts.dtype == object and len(set(texts)) == len(texts)
        if is_set and len(texts) in matrix.shape and not is_stamp(texts[0]):
            found.append(texts)
    if not found or any(list(texts) != list(found[0]) for texts in found):
        return None
    return found[0]


def _split_matrix(
    name: str, matrix: Array, rows: int, names: NDArray[Any] | None
) -> dict[str, NDArray[Any]]:
    """The channels of a matrix beside a vector of times; empty if it has another length."""
    if rows not in matrix.shape:
        return {}
    columns = matrix if matrix.shape[0] == rows else matrix.T
    if names is not None and len(names) == columns.shape[1]:
        return {str(text).strip(): columns[:, k] for k, text in enumerate(names)}
    return {f"{name}_{k + 1}": columns[:, k] for k in range(columns.shape[1])}


def _columns_of_matrix(matrix: Array, names: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
    """The channels of a matrix that stands alone, by their names or numbers."""
    if names is not None:
        columns = matrix if matrix.shape[1] == len(names) else matrix.T
        return {str(text).strip(): columns[:, k] for k, text in enumerate(names)}
    columns = matrix if matrix.shape[0] >= matrix.shape[1] else matrix.T
    return {f"column {k + 1}": columns[:, k] for k in range(columns.shape[1])}


def _columns_of_records(value: Any) -> dict[str, NDArray[Any]]:
    """The fields of an array of structs with a number or text in each; empty for other values."""
    records = list(value) if isinstance(value, list) or getattr(value, "ndim", 0) == 1 else []
    if len(records) < LEAST_ROWS or not all(isinstance(record, dict) for record in records):
        return {}
    columns: dict[str, NDArray[Any]] = {}
    for name in records[0]:
        cells = [record.get(name) for record in records]
        if all(isinstance(cell, bool | int | float) for cell in cells):
            columns[name] = np.array(cells, dtype=np.float64)
        elif all(isinstance(cell, str) for cell in cells):
            columns[name] = np.array(cells, dtype=object)
    return columns if any(each.dtype != object for each in columns.values()) else {}


def _objects_in(path: str, value: Any, depth: int) -> dict[str, str]:
    """Classes of the objects of MATLAB in a variable, by variable."""
    if isinstance(value, MatlabOpaque):
        return {path: _class_of(value)}
    found: dict[str, str] = {}
    if isinstance(value, dict) and depth < MAX_DEPTH:
        for name, content in value.items():
            found |= _objects_in(_joined(path, name), content, depth + 1)
    return found


def _class_of(value: MatlabOpaque) -> str:
    """Class of an object of MATLAB that scipy returns unread."""
    names = value.dtype.names or ()
    key = "_Class" if "_Class" in names else "s2"  # since scipy 1.18, before
    text = np.atleast_1d(value)[0][key] if key in names else "object"
    return text.decode("latin-1") if isinstance(text, bytes) else str(text)


def _read_variables(path: Path, where: str) -> tuple[dict[str, Any], dict[str, str]]:
    """The variables of a file by name, and the classes of the objects of MATLAB, by name.

    Parameters
    ----------
    path
        The file.
    where
        The file, for messages.

    Raises
    ------
    InputError
        If the file is damaged, truncated, or unpacks to more than ``MAX_BYTES``.
    """
    if path.stat().st_size > MAX_BYTES:
        raise _size_error(where)
    content = path.read_bytes()
    objects: dict[str, str] = {}
    try:
        # the first bytes of version 4 are numbers, those of later ones any text
        if matfile_version(io.BytesIO(content))[0] != _VERSION_4:
            content, objects = _checked_content(content, where)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # variables that stand twice
            variables = loadmat(io.BytesIO(content), simplify_cells=True)
    except InputError:
        raise
    except Exception as problem:  # scipy raises many kinds on damaged files
        text = str(problem).splitlines()[0][:120] if str(problem) else type(problem).__name__
        raise InputError(
            f"not readable as a MATLAB file ({printable(text)})",
            where=where,
            expected="a complete .mat file of version 7 or older",
            remedy="copy the file again",
        ) from None
    return {name: x for name, x in variables.items() if not name.startswith("__")}, objects


def _checked_content(content: bytes, where: str) -> tuple[bytes, dict[str, str]]:
    """The content of a file of version 5 to 7, unpacked, without objects and functions.

    Parameters
    ----------
    content
        Bytes of the file.
    where
        The file, for messages.

    Returns
    -------
    content
        The header, and the variables that scipy can read.
    objects
        Classes of the objects of MATLAB that were left out, by name.

    Raises
    ------
    InputError
        If the file is truncated, unpacks to more than ``MAX_BYTES``, or has an array with more
        elements than bytes.
    """
    mark = content[126:_HEADER_BYTES]
    if mark not in (b"IM", b"MI"):
        raise _structure_error(where)
    order = "<" if mark == b"IM" else ">"
    parts = [content[:_HEADER_BYTES]]
    objects: dict[str, str] = {}
    position = _HEADER_BYTES
    remaining = MAX_BYTES
    while position < len(content):
        if position + _TAG_BYTES > len(content):
            raise _truncated_error(where)
        kind, size = struct.unpack_from(f"{order}II", content, position)
        end = position + _TAG_BYTES + size
        if end > len(content):
            raise _truncated_error(where)
        element = content[position:end]
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj()
            element = unpacked.decompress(element[_TAG_BYTES:], remaining)
            if unpacked.unconsumed_tail:
                raise _size_error(where)
            if not unpacked.eof:
                raise _truncated_error(where)
        remaining -= len(element)
        class_number, name, rest = _check_array(element, order, where, 0)
        if class_number == _OPAQUE:
            objects[name] = rest
        elif name and class_number not in (_OBJECT, _FUNCTION, _SPARSE):
            parts.append(element)
        position = end
    return b"".join(parts), objects


def _check_array(element: bytes, order: str, where: str, depth: int) -> tuple[int, str, str]:
    """Check that an array is complete, with those in its cells and fields.

    Parameters
    ----------
    element
        A data element, with its tag.
    order
        Byte order.
    where
        The file, for messages.
    depth
        Number of arrays around it.

    Returns
    -------
    class_number
        Class of the array; 0 for an empty element, and for one that is no array.
    name
        Its name.
    class_name
        Class of an object of MATLAB; empty for other arrays.

    Raises
    ------
    InputError
        For a type of data that does not exist, a missing part, and an array with more elements than
        bytes.

    Notes
    -----
    scipy 1.17 does not check the types, and a wrong one ends the interpreter.
    """
    kind, size = struct.unpack_from(f"{order}II", element)
    if kind != _MATRIX or size == 0:
        return 0, "", ""
    parts = list(_elements(element[_TAG_BYTES : _TAG_BYTES + size], order, where))
    kinds = [part[0] for part in parts]
    known = {_MATRIX, *_DATA_TYPES}
    if len(parts) < 3 or kinds[0] != _FLAGS_TYPE or len(parts[0][1]) < 8 or not known >= {*kinds}:
        raise _structure_error(where)
    flags = struct.unpack_from(f"{order}I", parts[0][1])[0]
    class_number = flags & 0xFF
    if class_number == _OPAQUE:
        if len(parts) < 4 or _MATRIX in kinds[1:4]:
            raise _structure_error(where)
        texts = [content.decode("latin-1") for _, content, _ in parts[1:4]]
        return class_number, texts[0], texts[-1]
    if kinds[1] not in _SIZE_TYPES or len(parts[1][1]) % 4 or kinds[2] not in _NAME_TYPES:
        raise _structure_error(where)
    sizes = struct.unpack(f"{order}{len(parts[1][1]) // 4}i", parts[1][1])
    name = parts[2][1].decode("utf-8", "replace")
    count = math.prod(sizes)
    is_nested = class_number in (_CELL, _STRUCT, _OBJECT)
    bytes_of_one = _TAG_BYTES if is_nested else 1
    if min(sizes, default=-1) < 0 or (
        class_number != _SPARSE and count * bytes_of_one > len(element)
    ):
        raise InputError(
            f"variable {printable(name)!r} promises {count} elements in {len(element)} bytes",
            where=where,
            expected="a complete .mat file",
            remedy="copy the file again",
        )
    _check_parts(class_number, count, bool(flags & _COMPLEX), parts, order, where)
    if depth == MAX_ARRAYS:
        raise _structure_error(where)
    for inner_kind, _, inner in parts[3:]:
        if inner_kind == _MATRIX:
            _check_array(inner, order, where, depth + 1)
    return class_number, name, ""


def _check_parts(
    class_number: int,
    count: int,
    is_complex: bool,
    parts: Sequence[_Element],
    order: str,
    where: str,
) -> None:
    """Check that an array has the parts of its class.

    Parameters
    ----------
    class_number
        Class of the array.
    count
        Number of its elements.
    is_complex
        Whether it has an imaginary part.
    parts
        Its parts: flags, sizes, name, and what follows.
    order
        Byte order.
    where
        The file, for messages.
    """
    kinds = [kind for kind, _, _ in parts[3:]]
    if class_number == _CELL:
        expected = [_MATRIX] * count
    elif class_number in (_STRUCT, _OBJECT):
        # length of the names of fields, the names, and an array for each field of each element
        n_texts = 3 if class_number == _OBJECT else 2
        head = parts[3 : 3 + n_texts]
        if len(head) < n_texts or _MATRIX in kinds[:n_texts] or len(head[-2][1]) != 4:
            raise _structure_error(where)
        length = struct.unpack(f"{order}i", head[-2][1])[0]
        if not 0 < length <= MAX_NAME:
            raise _structure_error(where)
        n_fields = len(head[-1][1]) // length
        expected = [*kinds[:n_texts], *[_MATRIX] * (n_fields * count)]
    elif class_number == _FUNCTION:
        expected = [_MATRIX]
    elif class_number == _SPARSE:
        expected = kinds[: 3 + is_complex]
        if len(expected) < 3 + is_complex:
            raise _structure_error(where)
    else:
        expected = kinds[: 1 + is_complex]
        if len(expected) < 1 + is_complex or _MATRIX in expected:
            raise _structure_error(where)
    if kinds != expected:
        raise _structure_error(where)


def _elements(content: bytes, order: str, where: str) -> Iterator[_Element]:
    """Yield type, content and all bytes of each data element; those of up to 4 bytes are short.

    Raises
    ------
    InputError
        For an element that ends beyond the content.
    """
    position = 0
    while position < len(content):
        if position + _TAG_BYTES > len(content):
            raise _structure_error(where)
        kind, size = struct.unpack_from(f"{order}II", content, position)
        if kind >> 16:
            start, size, kind = position + 4, kind >> 16, kind & 0xFFFF
            end = position + _TAG_BYTES
            if size > 4:
                raise _structure_error(where)
        else:
            start = position + _TAG_BYTES
            end = start + size + -size % _TAG_BYTES
        if start + size > len(content):
            raise _structure_error(where)
        yield kind, content[start : start + size], content[position:end]
        position = end


def _structure_error(where: str) -> InputError:
    """The error for a file whose parts do not fit together."""
    return InputError(
        "not readable as a MATLAB file (a variable is damaged)",
        where=where,
        expected="a complete .mat file",
        remedy="copy the file again",
    )


def _truncated_error(where: str) -> InputError:
    """The error for a file that ends within a variable."""
    return InputError(
        "ends within a variable: the file is truncated",
        where=where,
        expected="a complete .mat file",
        remedy="copy the file again",
    )


def _size_error(where: str) -> InputError:
    """The error for a file that is too large to be read at once."""
    return InputError(
        f"has more than {MAX_BYTES / 1e9:.2g} GB",
        where=where,
        remedy="save its table as CSV or Parquet",
    )
