"""Files that appear whole or not at all: written beside, then renamed into place."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from calibration.errors import InputError


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; renamed onto it when the block ends well, removed when it does not.

    Killed at any moment, the block leaves the previous ``path`` or none. The temporary name starts with a dot and
    keeps the ending, so that writers which look at endings work.

    >>> import tempfile, pathlib
    >>> target = pathlib.Path(tempfile.mkdtemp()) / "out.txt"
    >>> with atomic_path(target) as beside:
    ...     _ = beside.write_text("done", encoding="utf-8")
    >>> target.read_text(encoding="utf-8")
    'done'
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            raise InputError("is a folder", where=str(target), expected="a file to write")
        handle, name = tempfile.mkstemp(prefix=f".{target.stem[:40]}.", suffix=target.suffix, dir=target.parent)
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        remedy = "give a folder that you may write into"
        raise InputError(f"cannot be written ({reason})", where=str(target), remedy=remedy) from None
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        with open(beside, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(beside, 0o666 & ~_umask())
        os.replace(beside, target)
    finally:
        with suppress(FileNotFoundError):
            beside.unlink()


def write_text(path: str | Path, text: str) -> Path:
    """Write ``text`` as UTF-8 to ``path``, whole or not at all; returns the path."""
    with atomic_path(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def sha256(path: str | Path) -> str:
    """SHA-256 of the file's bytes as 64 hexadecimal digits, read in bounded memory."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(f"not readable ({problem.strerror})", where=str(path)) from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
