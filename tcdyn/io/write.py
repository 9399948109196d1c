"""Atomic writing of files, and writing of logs as CSV, Parquet, .xlsx, netCDF or TDMS.

Used by every command that writes a file. A file is written under a temporary name and then renamed,
so that a stopped command leaves the previous file or none. A CSV file begins with its header; its
metadata are in a JSON file beside it (:mod:`tcdyn.io.metadata`). Guarded by
``tests/io/test_write.py`` (killed writers), ``tests/io/test_read_back.py`` (numbers survive) and
``tests/io/test_metadata.py`` (dialects, metadata).
"""

from __future__ import annotations

import errno
import io
import os
import secrets
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pacsv

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info
from tcdyn.io.csv_dialect import Dialect
from tcdyn.io.endings import LONG_TABLE, TABLE, check_ending
from tcdyn.io.metadata import check_metadata_file_is_ours, metadata_path, metadata_text
from tcdyn.io.netcdf import netcdf_appender
from tcdyn.io.read import CsvTable, Table, open_text, sha256_of_file
from tcdyn.io.xlsx import stored_metadata, xlsx_appender

# numbers of the errors that a full or read-only file system causes: they get a sentence for the
# user, any other error of the block is raised as it is
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}
# pyarrow writes larger numbers with an exponent; times in milliseconds since 1970 are larger
LARGEST_PLAIN_NUMBER = 1e10
# An output is searched for the checksum of its input in its first bytes and in its last ones, where
# Parquet has its metadata; pages, the largest outputs without metadata, have a few megabytes.
SEARCHED_BYTES = 1 << 25
FOOTER_BYTES = 1 << 16
CHECKSUM_DIGITS = 16  # hexadecimal digits of a checksum that pages state
FORMULA_STARTS = ("=", "+", "-", "@")  # first characters of a formula in spreadsheets
DialectName = Literal["standard", "input"]
DIALECTS: tuple[DialectName, ...] = get_args(DialectName)


@dataclass(frozen=True)
class OutputStyle:
    """How a file is written; CSV by default in UTF-8 with commas and decimal points.

    Attributes
    ----------
    separator, decimal, encoding, line_end
        Dialect of a CSV file.
    comments
        Whether the metadata of a CSV file are lines "# key: value" above the header, and not a file
        of their own.
    types
        Types in a Parquet file by column, where the cells are text, such as time stamps.
    time
        Column of the time [s], the coordinate of a netCDF file; empty: ``time_s``.
    units
        Units by column in a netCDF file, where the names do not state them.
    """

    separator: str = ","
    decimal: str = "."
    encoding: str = "utf-8"
    line_end: str = "\n"
    comments: bool = False
    types: Mapping[str, pa.DataType] = field(default_factory=dict)
    time: str = ""
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_standard(self) -> bool:
        """Whether the dialect of CSV is the default one, which pyarrow writes."""
        dialect = (self.separator, self.decimal, self.encoding, self.line_end)
        return dialect == (",", ".", "utf-8", "\n")


STANDARD_STYLE = OutputStyle()


def output_style(
    dialect: DialectName, comments: bool, table: Table | None, out: str | Path
) -> OutputStyle:
    """The style of an output.

    Parameters
    ----------
    dialect
        "standard", or "input": that of the table that was read.
    comments
        As in ``OutputStyle``.
    table
        The table that was read; None if it was no file.
    out
        The output.

    Returns
    -------
    OutputStyle
        How the output is written.

    Raises
    ------
    InputError
        For an unknown dialect, and for an option of CSV with another output or another input.

    Notes
    -----
    Columns that are separated by runs of spaces are written with tabs.
    ``tests/sensors/test_outputs.py`` guards it.
    """
    if dialect not in DIALECTS:
        raise InputError(f"dialect {dialect!r}", expected=" or ".join(DIALECTS))
    ending = Path(out).suffix.lower()
    types = {} if table is None else table.types
    if dialect == "standard" and not comments:
        return OutputStyle(types=types)
    if ending != ".csv":
        raise InputError(
            f"dialect and comments are of CSV, not of {ending!r}",
            where=str(out),
            expected="an output ending in .csv",
        )
    if dialect == "standard":
        return OutputStyle(comments=comments)
    if not isinstance(table, CsvTable):
        raise InputError(
            "has no dialect of CSV that the output could have",
            where="" if table is None else table.where,
            expected="a CSV file as input",
            remedy="use the dialect standard",
        )
    source = table.dialect
    line_end = _line_end(source)
    return OutputStyle(source.separator, source.decimal, source.encoding, line_end, comments)


def dialect_findings(
    table: Table | None, out: str | Path, style: OutputStyle, *, grows: bool = False
) -> list[Finding]:
    """Information that a spreadsheet program, set as for the input, opens the output wrongly.

    Parameters
    ----------
    table
        The table that was read; None if it was no file.
    out
        The output.
    style
        How it is written.
    grows
        Whether rows are appended to the output, so that it must be CSV.

    Returns
    -------
    list of Finding
        One for a CSV file in the standard dialect if the input has semicolons or decimal commas.
    """
    is_plain_csv = Path(out).suffix.lower() == ".csv" and style.is_standard
    if not is_plain_csv or not isinstance(table, CsvTable):
        return []
    source = table.dialect
    if source.separator != ";" and source.decimal != ",":
        return []
    return [info("table.dialect", subject=Path(out).name, grows=grows)]


def _line_end(dialect: Dialect) -> str:
    """Line end of the first line of a text log."""
    with open_text(dialect) as stream:
        return "\r\n" if stream.readline().endswith(b"\r\n") else "\n"


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; it replaces ``path`` if the block succeeds.

    Parameters
    ----------
    path
        File to write. A link is followed.

    Raises
    ------
    InputError
        If the file cannot be written, for example on a full disk, is read-only, or is not a file
        (/dev/null).

    Notes
    -----
    A file that is replaced keeps its permissions; a new one has those of the umask. On Windows, a
    file that another program has open cannot be replaced: that is an error with this advice.

    Stopped at any moment, the block leaves the previous file or none. The temporary name starts
    with a dot and keeps the ending, for writers that depend on endings.

    What must stay: the temporary file is in the same folder (a rename across file systems is not
    atomic) and is written to the disk before the rename. ``tests/io/test_write.py`` kills the
    writer.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> target = pathlib.Path(tempfile.mkdtemp()) / "out.txt"
    >>> with atomic_path(target) as temporary:
    ...     _ = temporary.write_text("done", encoding="utf-8")
    >>> target.read_text(encoding="utf-8")
    'done'
    """
    try:
        target = Path(path).resolve()
        if target.is_symlink():  # from Python 3.13 on, a circle of links is left as it is
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
        target.parent.mkdir(parents=True, exist_ok=True)
        check_writable(target)
        temporary = _new_file_beside(target, is_private=target.exists())
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as problem:
        raise _write_error(problem, path, "give a folder that you may write into") from None
    try:
        yield temporary
        with open(temporary, "r+b") as written:  # Windows can only flush what is open for writing
            os.fsync(written.fileno())
        if target.exists():
            os.chmod(temporary, stat.S_IMODE(target.stat().st_mode))
        _replace(temporary, target, path)
    except OSError as problem:
        if problem.errno not in FULL:  # it may come from reading in the block
            raise
        raise _write_error(
            problem, path, "make room, or write elsewhere; nothing half-written was kept"
        ) from None
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def _new_file_beside(target: Path, is_private: bool) -> Path:
    """A new empty file in the folder of ``target``.

    Parameters
    ----------
    target
        The file that it will replace.
    is_private
        Whether only its owner may read it, until it gets the permissions of ``target``. Otherwise
        it has those of the umask, which cannot be read without changing it for all threads.
    """
    mode = 0o600 if is_private else 0o666
    while True:
        name = f".{target.stem[:40]}.{secrets.token_hex(4)}{target.suffix}"
        file = target.with_name(name)
        try:
            handle = os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode)
        except FileExistsError:
            continue
        os.close(handle)
        return file


def _replace(temporary: Path, target: Path, path: str | Path) -> None:
    """Rename ``temporary`` to ``target``, which messages call ``path``.

    Raises
    ------
    InputError
        If the file cannot be replaced, as on Windows while another program has it open.
    """
    try:
        os.replace(temporary, target)
    except PermissionError as problem:
        remedy = "close it in other programs, or give another name; the file was not changed"
        raise _write_error(problem, path, remedy) from None


@contextmanager
def removed_on_failure(*paths: Path) -> Iterator[None]:
    """Delete those of the files that the block made, if it fails.

    For files that are of use only together. Files that existed before are not deleted.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> first = pathlib.Path(tempfile.mkdtemp()) / "first.txt"
    >>> with suppress(RuntimeError), removed_on_failure(first):
    ...     _ = write_text(first, "x")
    ...     raise RuntimeError
    >>> first.exists()
    False
    """
    new = [path for path in paths if not path.exists()]
    try:
        yield
    except BaseException:
        for path in new:
            with suppress(OSError):
                path.unlink()
        raise


def check_writable(path: Path) -> None:
    """Check that a path is free, or a file that its owner may write.

    Parameters
    ----------
    path
        File to write.

    Raises
    ------
    InputError
        For a folder, a device, a name that no file can have, and a read-only file. A rename would
        replace the last one, too.
    """
    try:
        if not path.exists():
            return
        mode = path.stat().st_mode
    except (OSError, ValueError, RuntimeError) as problem:
        raise _write_error(problem, path, "give another name") from None
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "no file but a device"
        raise InputError(f"is {kind}", where=str(path), expected="a file to write")
    if not mode & stat.S_IWUSR:
        raise InputError(
            "is read-only", where=str(path), remedy="make it writable, or give another name"
        )


def check_may_replace(path: Path, inputs: Iterable[Path | str], overwrite: bool = False) -> None:
    """Check that an output is new, was made from one of the inputs, or is to be overwritten.

    Parameters
    ----------
    path
        File to write.
    inputs
        Files that it will be made from.
    overwrite
        Whether any file may be replaced that is not read-only.

    Raises
    ------
    InputError
        If the file may not be replaced.

    Notes
    -----
    An output that states the checksum of an input was made from it: records, results and pages do,
    tables of sensors in their metadata; pictures do not. An empty file may be replaced.
    """
    check_writable(path)
    if overwrite or not path.exists() or path.stat().st_size == 0:
        return
    sources = list(inputs)
    if not sources:
        raise InputError(
            "exists already",
            where=str(path),
            remedy="replace it with {overwrite}",
            parameters={"overwrite": True},
        )
    if not contains_checksum_of(path, sources):
        raise InputError(
            "exists already, and does not state that it was made from this input",
            where=str(path),
            remedy="give another name, or replace it with {overwrite}",
            parameters={"overwrite": True},
        )


def contains_checksum_of(path: Path, inputs: Iterable[Path | str]) -> bool:
    """Whether a file, or its file of metadata, contains the checksum of one of the inputs.

    The checksum is the first ``CHECKSUM_DIGITS`` digits of the SHA-256. The metadata of a workbook,
    which is packed, are unpacked for it. ``tests/cli/test_replaced_outputs.py`` guards it.

    Parameters
    ----------
    path
        The file. Its first ``SEARCHED_BYTES`` and last ``FOOTER_BYTES`` bytes are searched.
    inputs
        The inputs; those that are no files are left out.

    Returns
    -------
    bool

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> log = write_text(folder / "log.csv", "t,T")
    >>> result = write_text(folder / "result.json", sha256_of_file(log))
    >>> contains_checksum_of(result, [log]), contains_checksum_of(log, [result])
    (True, False)
    """
    content = b""
    for file in (path, metadata_path(path)):
        if file.is_file():
            with open(file, "rb") as stream:
                content += stream.read(SEARCHED_BYTES)
                stream.seek(max(0, file.stat().st_size - FOOTER_BYTES))
                content += stream.read()
    if path.suffix.lower() == ".xlsx" and path.is_file():
        content += stored_metadata(path, SEARCHED_BYTES)
    checksums = (sha256_of_file(file) for file in inputs if Path(file).is_file())
    return any(checksum[:CHECKSUM_DIGITS].encode() in content for checksum in checksums)


def file_identity(path: Path | str) -> tuple[object, ...]:
    """What two names of one file have in common, links of both kinds included.

    Parameters
    ----------
    path
        The file; it need not exist.

    Returns
    -------
    identity
        Device and number of a file that exists; otherwise its path without links, or as it is if
        no file can have it.
    """
    try:
        file = Path(path).resolve()
        if not file.exists():
            return (file,)
        status = file.stat()
    except (OSError, ValueError, RuntimeError):
        return (path,)
    return status.st_dev, status.st_ino


def check_not_input(path: str | Path, source: str | Path) -> None:
    """Check that an output is not the file that it is made from, under any name.

    Parameters
    ----------
    path
        File to write.
    source
        File that is read.

    Raises
    ------
    InputError
        If they are one file.
    """
    if file_identity(path) == file_identity(source):
        raise InputError(
            "is the file that is read", where=str(path), expected="another name for the output"
        )


def write_text(path: str | Path, text: str) -> Path:
    """Write ``text`` as UTF-8 to ``path`` atomically; return the path."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def _write_error(problem: Exception, path: str | Path, remedy: str) -> InputError:
    """Error for a file that cannot be written.

    Parameters
    ----------
    problem
        The error of the system.
    path
        The file.
    remedy
        What the user may do.
    """
    reason = " ".join(str(getattr(problem, "strerror", None) or problem).split())
    return InputError(f"cannot be written ({reason})", where=str(path), remedy=remedy)


@with_named_arguments
def write_log(
    frame: pd.DataFrame,
    path: str | Path,
    metadata: Mapping[str, str] | None = None,
    *,
    style: OutputStyle = STANDARD_STYLE,
) -> Path:
    """Write a table to a file; numbers keep all their digits.

    Parameters
    ----------
    frame
        The table.
    path
        File to write: .csv, .parquet, .xlsx, .nc or .tdms.
    metadata
        Keys and values, which ``read_log`` returns: a file ``<name>.csv.meta.json``, or with
        ``style`` lines "# key: value" above the header (CSV); key-value pairs of the file
        (Parquet); a second sheet (.xlsx); an attribute of the file as JSON (netCDF); properties of
        the root (TDMS).
    style
        How the file is written.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For another ending, a file that cannot be written, and a table that is too large for .xlsx
        or netCDF.

    Examples
    --------
    >>> import tempfile
    >>> table = pd.DataFrame({"time_s": [0.0, 0.1], "T1_degC": [20.0, 20.1]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     print(write_log(table, Path(folder) / "log.csv").read_text(encoding="utf-8"))
    time_s,T1_degC
    0,20
    0.1,20.1
    <BLANKLINE>
    """
    target = Path(path)
    check_ending(target, TABLE)
    plain = _plain_metadata(metadata or {})
    ending = target.suffix.lower()
    if ending in (".csv", ".xlsx", ".nc"):
        text = [name for name in frame.columns if frame[name].dtype.kind not in "fiub"]
        with log_writer(target, list(frame.columns), plain, text, style=style) as write:
            write(frame)
        return target
    writer = _write_tdms if ending == ".tdms" else _write_parquet
    with atomic_path(target) as temporary:
        writer(frame, temporary, plain)
    return target


@contextmanager
def log_writer(
    path: str | Path,
    names: Sequence[str],
    metadata: Mapping[str, str],
    text: Collection[str] = (),
    *,
    style: OutputStyle = STANDARD_STYLE,
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """Yield a function that appends tables to a file, which appears when the block succeeds.

    Memory does not grow with the file, except for netCDF, which is written in one piece.

    Parameters
    ----------
    path
        File to write: .csv, .parquet, .xlsx or .nc.
    names
        Names of the columns.
    metadata, style
        As for ``write_log``.
    text
        Columns that hold text; the others hold numbers.

    Raises
    ------
    InputError
        For another ending, a file that cannot be written, and a table that is too large for .xlsx
        or netCDF.
    """
    target = Path(path)
    check_ending(target, LONG_TABLE)
    ending = target.suffix.lower()
    plain = _plain_metadata(metadata)
    if ending == ".parquet":
        with (
            atomic_path(target) as temporary,
            _parquet_appender(temporary, names, plain, text, style.types) as append,
        ):
            yield append
        return
    if ending == ".xlsx":
        with (
            atomic_path(target) as temporary,
            xlsx_appender(temporary, target, names, plain, text, style.types) as append,
        ):
            yield append
        return
    if ending == ".nc":
        time = style.time or "time_s"
        with (
            atomic_path(target) as temporary,
            netcdf_appender(temporary, target, names, plain, text, time, style.units) as append,
        ):
            yield append
        return
    with (
        _csv_with_metadata(target, names, plain, style) as temporary,
        open(temporary, "ab") as stream,
    ):

        def append(frame: pd.DataFrame) -> None:
            """Append the rows of a table."""
            stream.write(csv_rows(frame, text, style))

        yield append


def start_csv(
    path: str | Path,
    names: Sequence[str],
    metadata: Mapping[str, str],
    *,
    style: OutputStyle = STANDARD_STYLE,
) -> int:
    """Write a CSV file without rows, to which rows will be appended, and its metadata.

    Parameters
    ----------
    path
        File to write.
    names
        Names of the columns.
    metadata, style
        As for ``write_log``.

    Returns
    -------
    int
        Size of the file [bytes].
    """
    with _csv_with_metadata(Path(path), names, _plain_metadata(metadata), style) as temporary:
        return temporary.stat().st_size


@contextmanager
def _csv_with_metadata(
    target: Path, names: Sequence[str], metadata: Mapping[str, str], style: OutputStyle
) -> Iterator[Path]:
    """Yield a temporary CSV file with its header; it and its metadata appear if the block succeeds.

    Parameters
    ----------
    target
        The file.
    names
        Names of the columns.
    metadata
        Keys and values on one line each.
    style
        How the file is written.

    Raises
    ------
    InputError
        If a file cannot be written, or the file of metadata is of another program.

    Notes
    -----
    The metadata of a previous table are deleted first, and those of the new one appear last: a
    command that is stopped leaves a table without metadata, never one with those of another.
    """
    check_metadata_file_is_ours(target)
    file = metadata_path(target)
    header = header_line(names, style.separator).removesuffix("\n") + style.line_end
    if style.comments or not metadata:
        lines = [f"# {key}: {value}{style.line_end}" for key, value in metadata.items()]
        with atomic_path(target) as temporary:
            temporary.write_bytes(_encode("".join([*lines, header]), style))
            yield temporary
            file.unlink(missing_ok=True)
        return
    with atomic_path(file) as temporary_metadata, atomic_path(target) as temporary:
        temporary.write_bytes(_encode(header, style))
        yield temporary
        written_names = [_header_name(name) for name in names]
        content = metadata_text(written_names, metadata)
        temporary_metadata.write_text(content, encoding="utf-8", newline="\n")
        file.unlink(missing_ok=True)


def _encode(text: str, style: OutputStyle, is_first: bool = True) -> bytes:
    """The text as bytes; a byte order mark only at the start of a file."""
    encoding = style.encoding
    if not is_first:
        encoding = {"utf-16": "utf-16-le", "utf-8-sig": "utf-8"}.get(encoding, encoding)
    elif encoding == "utf-16":
        text = "\ufeff" + text
        encoding = "utf-16-le"
    return text.encode(encoding, errors="replace")


@contextmanager
def _parquet_appender(
    path: Path,
    names: Sequence[str],
    metadata: Mapping[str, str],
    text: Collection[str],
    types: Mapping[str, pa.DataType],
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """Yield a function that appends tables to a Parquet file.

    Parameters
    ----------
    path, names, metadata, text
        As for ``log_writer``.
    types
        As in ``OutputStyle``.
    """
    from pyarrow import parquet as pq

    types_of_all: list[tuple[str, pa.DataType]] = []
    for name in names:
        default = pa.string() if name in text else pa.float64()
        types_of_all.append((name, types.get(name, default)))
    schema = pa.schema(types_of_all, metadata=dict(metadata))
    with pq.ParquetWriter(path, schema, write_page_checksum=True) as writer:

        def append(frame: pd.DataFrame) -> None:
            """Append the rows of a table."""
            columns = [_typed_cells(frame[name].to_numpy(), kind) for name, kind in types_of_all]
            writer.write_table(pa.table(columns, schema=schema))

        yield append


def _typed_cells(values: NDArray[Any], kind: pa.DataType) -> pa.Array:
    """Cells of a column in a type of pyarrow, NaN as an empty one; text becomes instants."""
    if pa.types.is_timestamp(kind):
        instants = pd.to_datetime(pd.Series(values), utc=kind.tz is not None, format="ISO8601")
        return pa.array(instants, kind)
    if pa.types.is_duration(kind):
        return pa.array(pd.to_timedelta(pd.Series(values)), kind)
    return pa.array(values, kind, from_pandas=True)


def csv_rows(
    frame: pd.DataFrame, text: Collection[str] = (), style: OutputStyle = STANDARD_STYLE
) -> bytes:
    """Rows of a table as lines of a CSV file, with quotes where a text needs them.

    Parameters
    ----------
    frame
        The table.
    text
        Its columns that hold text.
    style
        How the file is written.
    """
    if not style.is_standard:  # pyarrow writes neither decimal commas nor other encodings
        rows = frame.to_csv(
            index=False,
            header=False,
            sep=style.separator,
            decimal=style.decimal,
            lineterminator=style.line_end,
        )
        return _encode(str(rows), style, is_first=False)
    # pyarrow puts quotes around all text or none
    needs_quotes = any(frame[name].astype(str).str.contains('[",\r\n]').any() for name in text)
    options = pacsv.WriteOptions(
        include_header=False, quoting_style="needed" if needs_quotes else "none"
    )
    columns = {str(name): _csv_cells(frame[name].to_numpy()) for name in frame.columns}
    stream = io.BytesIO()
    pacsv.write_csv(pa.table(columns), stream, options)
    return stream.getvalue()


def _csv_cells(values: NDArray[Any]) -> pa.Array:
    """Cells of a column for pyarrow, NaN as an empty one.

    Numbers that pyarrow would write with an exponent become text.
    """
    is_large = values.dtype.kind == "f" and np.fmax.reduce(np.abs(values), initial=0.0) >= (
        LARGEST_PLAIN_NUMBER
    )
    if not is_large:
        return pa.array(values, from_pandas=True)
    texts = [None if x != x else repr(x).removesuffix(".0") for x in values.tolist()]
    return pa.array(texts, pa.string())


def header_line(names: Sequence[str], separator: str = ",") -> str:
    """Header line of a CSV file.

    Names with a separator or a quotation mark are quoted (RFC 4180); one that a spreadsheet would
    calculate is neutralised.

    >>> print(header_line(["time_s", "oven, left", "=1+1"]), end="")
    time_s,"oven, left",'=1+1
    """
    return separator.join(_quote(_header_name(name), separator) for name in names) + "\n"


def _header_name(name: object) -> str:
    """The name of a column as it is in the header of a CSV file."""
    return without_formula(_one_line(name))


def without_formula(text: str) -> str:
    """A text that a spreadsheet does not take for a formula: an apostrophe before =, +, - and @.

    >>> without_formula("=1+1"), without_formula("T1")
    ("'=1+1", 'T1')
    """
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text


def table_csv(table: pd.DataFrame, float_format: str | None = None) -> str:
    """A table of results as CSV text, without formulas in headers and texts.

    Parameters
    ----------
    table
        The table.
    float_format
        Format of its numbers, as for ``DataFrame.to_csv``.

    Examples
    --------
    >>> table_csv(pd.DataFrame({"log": ["@a.csv"], "beta": [-0.5]}))
    "log,beta\\n'@a.csv,-0.5\\n"
    """
    safe = table.map(lambda cell: without_formula(cell) if isinstance(cell, str) else cell)
    safe.columns = [without_formula(str(name)) for name in table.columns]
    return str(safe.to_csv(index=False, float_format=float_format, lineterminator="\n"))


def _quote(name: str, separator: str) -> str:
    """The name in quotation marks if it needs them."""
    if separator not in name and '"' not in name:
        return name
    doubled = name.replace('"', '""')
    return f'"{doubled}"'


def _one_line(text: object) -> str:
    """The text on one line, without characters that cannot be printed."""
    printable = "".join(c if c.isprintable() else " " for c in str(text))
    return " ".join(printable.split())


def _plain_metadata(metadata: Mapping[str, str]) -> dict[str, str]:
    """Keys and values on one line each, keys without colons."""
    return {_one_line(k).replace(":", " "): _one_line(v) for k, v in metadata.items()}


def _arrow_table(frame: pd.DataFrame) -> pa.Table:
    """The data frame as an Arrow table, without its index.

    Parameters
    ----------
    frame
        Columns of any names; the names become text.

    Returns
    -------
    table
        The columns in order; NaN becomes an empty value (null).
    """
    return pa.table(
        {str(n): pa.array(frame[n].to_numpy(), from_pandas=True) for n in frame.columns}
    )


def _write_parquet(frame: pd.DataFrame, path: Path, metadata: Mapping[str, str]) -> None:
    """Write a table as Parquet with its metadata as key-value pairs of the file."""
    from pyarrow import parquet as pq

    table = _arrow_table(frame).replace_schema_metadata(dict(metadata))
    pq.write_table(table, path, write_page_checksum=True)


def _write_tdms(frame: pd.DataFrame, path: Path, metadata: Mapping[str, str]) -> None:
    """Write a table as TDMS in the group "log", with its metadata as properties of the root."""
    from nptdms import ChannelObject, RootObject, TdmsWriter

    root = RootObject(properties=dict(metadata))
    channels = []
    for name in frame.columns:
        is_number = frame[name].dtype.kind in "fiub"
        cells = frame[name].to_numpy(dtype=float if is_number else str)
        channels.append(ChannelObject("log", str(name), np.ascontiguousarray(cells)))
    with TdmsWriter(path) as writer:
        writer.write_segment([root, *channels])
