"""Atomic writing of files, and writing of logs as CSV, Parquet or TDMS.

Used by every command that writes a file. A file is written under a temporary name and then renamed,
so that a stopped command leaves the previous file or none. Guarded by ``tests/io/test_write.py``
(killed writers) and ``tests/io/test_read_back.py`` (numbers survive).
"""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv as pacsv

from tcdyn.core.errors import InputError

# numbers of the errors that a full or read-only file system causes: they get a sentence for the
# user, any other error of the block is raised as it is
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}


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
        If the file cannot be written, for example on a full disk, or is not a file (/dev/null).

    Notes
    -----
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
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and not target.is_file():
            kind = "a folder" if target.is_dir() else "no file but a device"
            raise InputError(f"is {kind}", where=str(path), expected="a file to write")
        handle, name = tempfile.mkstemp(
            prefix=f".{target.stem[:40]}.", suffix=target.suffix, dir=target.parent
        )
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as problem:
        raise _unwritable(problem, path, "give a folder that you may write into") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, target)
    except OSError as problem:
        if problem.errno not in FULL:  # it may come from reading in the block
            raise
        raise _unwritable(
            problem, path, "make room, or write elsewhere; nothing half-written was kept"
        ) from None
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def write_text(path: str | Path, text: str) -> Path:
    """Write ``text`` as UTF-8 to ``path`` atomically; return the path."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def _unwritable(problem: Exception, path: str | Path, remedy: str) -> InputError:
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


def _umask() -> int:
    """The mask of permissions of this process, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_log(
    frame: pd.DataFrame, path: str | Path, metadata: Mapping[str, str] | None = None
) -> Path:
    """Write a table to a file; numbers keep all their digits.

    Parameters
    ----------
    frame
        The table.
    path
        File to write: .csv, .parquet or .tdms.
    metadata
        Keys and values, which ``read_log`` returns: lines "# key: value" above the header (CSV),
        key-value pairs of the file (Parquet), properties of the root (TDMS).

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For another ending, or a file that cannot be written.
    """
    target = Path(path)
    writers = {".csv": _write_csv, ".parquet": _write_parquet, ".tdms": _write_tdms}
    writer = writers.get(target.suffix.lower())
    if writer is None:
        raise InputError(
            f"ending {target.suffix!r}",
            where=str(target),
            expected="an output ending in .csv, .parquet or .tdms",
        )
    with atomic_path(target) as temporary:
        writer(frame, temporary, _plain_metadata(metadata or {}))
    return target


@contextmanager
def log_writer(
    path: str | Path, names: Sequence[str], metadata: Mapping[str, str], text: Collection[str] = ()
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """Yield a function that appends tables to a file, which appears when the block succeeds.

    Memory does not grow with the file.

    Parameters
    ----------
    path
        File to write: .csv or .parquet.
    names
        Names of the columns.
    metadata
        As for ``write_log``.
    text
        Columns that hold text; the others hold numbers.

    Raises
    ------
    InputError
        For another ending, or a file that cannot be written.
    """
    target = Path(path)
    ending = target.suffix.lower()
    if ending not in (".csv", ".parquet"):
        raise InputError(
            f"ending {target.suffix!r}",
            where=str(target),
            expected="an output ending in .csv or .parquet",
        )
    plain = _plain_metadata(metadata)
    with atomic_path(target) as temporary:
        if ending == ".parquet":
            with _parquet_appender(temporary, names, plain, text) as append:
                yield append
        else:
            with _csv_appender(temporary, names, plain, text) as append:
                yield append


@contextmanager
def _parquet_appender(
    path: Path, names: Sequence[str], metadata: Mapping[str, str], text: Collection[str]
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """Yield a function that appends tables to a Parquet file; parameters as for ``log_writer``."""
    from pyarrow import parquet as pq

    types = [(name, pa.string() if name in text else pa.float64()) for name in names]
    schema = pa.schema(types, metadata=dict(metadata))
    with pq.ParquetWriter(path, schema) as writer:

        def append(frame: pd.DataFrame) -> None:
            """Append the rows of a table."""
            writer.write_table(_arrow(frame).replace_schema_metadata(dict(metadata)))

        yield append


@contextmanager
def _csv_appender(
    path: Path, names: Sequence[str], metadata: Mapping[str, str], text: Collection[str]
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """Yield a function that appends tables to a CSV file; parameters as for ``log_writer``."""
    with open(path, "wb") as stream:
        stream.write(_csv_head(names, metadata))

        def append(frame: pd.DataFrame) -> None:
            """Append the rows of a table, with quotes where a text needs them."""
            # pyarrow puts quotes around all text or none
            needs_quotes = any(
                frame[name].astype(str).str.contains('[",\r\n]').any() for name in text
            )
            options = pacsv.WriteOptions(
                include_header=False, quoting_style="needed" if needs_quotes else "none"
            )
            pacsv.write_csv(_arrow(frame), stream, options)

        yield append


def header_line(names: Sequence[str]) -> str:
    """Header line of a CSV file; names with a comma or a quotation mark are quoted (RFC 4180).

    >>> header_line(["time_s", "oven, left"])
    'time_s,"oven, left"\\n'
    """
    return ",".join(_quoted(_one_line(name)) for name in names) + "\n"


def _quoted(name: str) -> str:
    """The name in quotation marks if it needs them."""
    if "," not in name and '"' not in name:
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


def _arrow(frame: pd.DataFrame) -> pa.Table:
    """The table for pyarrow; NaN becomes an empty value."""
    return pa.table(
        {str(n): pa.array(frame[n].to_numpy(), from_pandas=True) for n in frame.columns}
    )


def _csv_head(names: Sequence[str], metadata: Mapping[str, str]) -> bytes:
    """The lines above the first row: metadata and header."""
    lines = [f"# {key}: {value}\n" for key, value in metadata.items()]
    return "".join([*lines, header_line(names)]).encode("utf-8")


def _write_csv(frame: pd.DataFrame, path: Path, metadata: Mapping[str, str]) -> None:
    """Write a table as CSV with its metadata above the header."""
    with open(path, "wb") as stream:
        stream.write(_csv_head(list(frame.columns), metadata))
        pacsv.write_csv(_arrow(frame), stream, pacsv.WriteOptions(include_header=False))


def _write_parquet(frame: pd.DataFrame, path: Path, metadata: Mapping[str, str]) -> None:
    """Write a table as Parquet with its metadata as key-value pairs of the file."""
    from pyarrow import parquet as pq

    pq.write_table(_arrow(frame).replace_schema_metadata(dict(metadata)), path)


def _write_tdms(frame: pd.DataFrame, path: Path, metadata: Mapping[str, str]) -> None:
    """Write a table as TDMS in the group "log", with its metadata as properties of the root."""
    from nptdms import ChannelObject, RootObject, TdmsWriter

    root = RootObject(properties=dict(metadata))
    channels = [
        ChannelObject("log", str(name), np.ascontiguousarray(frame[name].to_numpy(dtype=float)))
        for name in frame.columns
    ]
    with TdmsWriter(path) as writer:
        writer.write_segment([root, *channels])
