"""Files that appear whole or not at all: written beside, then renamed into place; logs in the form of their ending."""

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

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; renamed onto it when the block ends well, removed when it does not.

    Killed at any moment, the block leaves the previous ``path`` or none. A link is written through. The temporary name
    starts with a dot and keeps the ending, so that writers which look at endings work. Raises InputError for what
    cannot be written, a full disk among it, and for what is no file (/dev/null).

    >>> import tempfile, pathlib
    >>> target = pathlib.Path(tempfile.mkdtemp()) / "out.txt"
    >>> with atomic_path(target) as beside:
    ...     _ = beside.write_text("done", encoding="utf-8")
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
    beside = Path(name)
    try:
        yield beside
        with open(beside, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(beside, 0o666 & ~_umask())
        os.replace(beside, target)
    except OSError as problem:
        if problem.errno not in FULL:  # what was read, perhaps
            raise
        raise _unwritable(
            problem, path, "make room, or write elsewhere; nothing half-written was kept"
        ) from None
    finally:
        with suppress(FileNotFoundError):
            beside.unlink()


def write_text(path: str | Path, text: str) -> Path:
    """Write ``text`` as UTF-8 to ``path``, whole or not at all; returns the path."""
    with atomic_path(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def _unwritable(problem: Exception, path: str | Path, remedy: str) -> InputError:
    reason = " ".join(str(getattr(problem, "strerror", None) or problem).split())
    return InputError(f"cannot be written ({reason})", where=str(path), remedy=remedy)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_log(
    frame: pd.DataFrame, path: str | Path, metadata: Mapping[str, str] | None = None
) -> Path:
    """Write the columns of ``frame`` to ``path``: .csv, .parquet or .tdms; numbers keep all their digits.

    ``metadata`` goes to ``# key: value`` lines above the header (CSV), the file's key-value pairs (Parquet) or the
    root properties (TDMS); ``read_log`` gives it back. Raises InputError for another ending or an unwritable
    place.
    """
    target = Path(path)
    notes = {_one_line(k).replace(":", " "): _one_line(v) for k, v in (metadata or {}).items()}
    writers = {".csv": _csv, ".parquet": _parquet, ".tdms": _tdms}
    writer = writers.get(target.suffix.lower())
    if writer is None:
        raise InputError(
            f"ending {target.suffix!r}",
            where=str(target),
            expected="an output ending in .csv, .parquet or .tdms",
        )
    with atomic_path(target) as beside:
        writer(frame, beside, notes)
    return target


@contextmanager
def log_writer(
    path: str | Path, names: Sequence[str], metadata: Mapping[str, str], text: Collection[str] = ()
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """A function that appends frames of the columns ``names`` to ``path``, .csv or .parquet: whole at the end, or not.

    As ``write_log``, in memory that does not grow. The columns ``text`` hold text, the others numbers.
    Raises InputError for another ending or an unwritable place.
    """
    target = Path(path)
    notes = {_one_line(k).replace(":", " "): _one_line(v) for k, v in metadata.items()}
    ending = target.suffix.lower()
    if ending not in (".csv", ".parquet"):
        expected = "an output ending in .csv or .parquet"
        raise InputError(f"ending {target.suffix!r}", where=str(target), expected=expected)
    with atomic_path(target) as beside:
        if ending == ".parquet":
            from pyarrow import parquet as pq

            kinds = {n: pa.string() if n in text else pa.float64() for n in names}
            fields = pa.schema(list(kinds.items()), metadata=dict(notes))
            with pq.ParquetWriter(beside, fields) as parquet:
                yield lambda frame: parquet.write_table(
                    _arrow(frame).replace_schema_metadata(dict(notes))
                )
            return
        with open(beside, "wb") as stream:
            stream.write(
                "".join(f"# {key}: {value}\n" for key, value in notes.items()).encode("utf-8")
            )
            stream.write(header_line(names).encode("utf-8"))

            def append(frame: pd.DataFrame) -> None:
                # pyarrow puts quotes around all text or none; not in threads: each keeps memory of its own
                quotes = any(frame[n].astype(str).str.contains('[",\r\n]').any() for n in text)
                style = "needed" if quotes else "none"
                options = pacsv.WriteOptions(include_header=False, quoting_style=style)
                pacsv.write_csv(_arrow(frame), stream, options)

            yield append


def header_line(names: Sequence[str]) -> str:
    """The line of column names of a CSV file; a name with a comma or a quotation mark is quoted (RFC 4180).

    >>> header_line(["time_s", "oven, left"])
    'time_s,"oven, left"\\n'
    """
    return ",".join(_cell(str(name)) for name in names) + "\n"


def _cell(name: str) -> str:
    name = _one_line(name)
    return '"' + name.replace('"', '""') + '"' if "," in name or '"' in name else name


def _one_line(text: object) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())


def _arrow(frame: pd.DataFrame) -> pa.Table:
    return pa.table(
        {str(n): pa.array(frame[n].to_numpy(), from_pandas=True) for n in frame.columns}
    )


def _csv(frame: pd.DataFrame, path: Path, notes: Mapping[str, str]) -> None:
    head = "".join(f"# {key}: {value}\n" for key, value in notes.items())
    head += header_line(list(frame.columns))
    with open(path, "wb") as stream:
        stream.write(head.encode("utf-8"))
        pacsv.write_csv(_arrow(frame), stream, pacsv.WriteOptions(include_header=False))


def _parquet(frame: pd.DataFrame, path: Path, notes: Mapping[str, str]) -> None:
    from pyarrow import parquet as pq

    pq.write_table(_arrow(frame).replace_schema_metadata(dict(notes)), path)


def _tdms(frame: pd.DataFrame, path: Path, notes: Mapping[str, str]) -> None:
    from nptdms import ChannelObject, RootObject, TdmsWriter

    channels = [
        ChannelObject("log", str(n), np.ascontiguousarray(frame[n].to_numpy(dtype=float)))
        for n in frame.columns
    ]
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject(properties=dict(notes)), *channels])
