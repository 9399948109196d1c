"""A machine that refuses call number k of a command, the commands it is tried on, and what may be
left behind then."""

from __future__ import annotations

import builtins
import errno
import io
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nptdms import TdmsFile
from pyarrow import csv as pacsv
from pyarrow import parquet as pq

Home = tuple[Any, str]
FILES: list[Home] = [
    *(
        (builtins, "open"),
        (io, "open"),
        (os, "open"),
        (os, "stat"),
        (os, "mkdir"),
        (os, "replace"),
        (os, "fsync"),
    ),
    *(
        (os, "chmod"),
        (TdmsFile, "open"),
        (pacsv, "open_csv"),
        (pacsv, "write_csv"),
    ),
    *((pq, "read_schema"), (pq, "ParquetFile"), (pq, "ParquetWriter"), (pq, "write_table")),
]
ARRAYS: list[Home] = [
    (np, name)
    for name in (
        "empty",
        "zeros",
        "ones",
        "full",
        "array",
        "asarray",
        "concatenate",
        "arange",
        "stack",
        "interp",
    )
]
WITH_PATH = ("open", "stat", "mkdir")
OWN = ("calibration", "immersion", "tcdyn")
PROBLEMS: dict[str, Callable[[], BaseException]] = {
    "EIO": lambda: OSError(errno.EIO, "Input/output error"),
    "ENOSPC": lambda: OSError(errno.ENOSPC, "No space left on device"),
    "EACCES": lambda: PermissionError(errno.EACCES, "Permission denied"),
    "memory": MemoryError,
}


@dataclass
class Machine:
    """Calls so far, by name; call number ``at`` raises ``problem``. ``folder``: only its files are
    refused."""

    folder: Path
    at: int = 0
    problem: Callable[[], BaseException] = MemoryError
    calls: list[str] = field(default_factory=list)

    def counted(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """``call``, counted, and refused when its turn has come."""

        def one(*args: Any, **settings: Any) -> Any:
            if name in WITH_PATH and not self._ours(args):
                return call(*args, **settings)
            self._turn(name)
            made = call(*args, **settings)
            return (
                Stream(made, self)
                if name == "open" and hasattr(made, "read") and hasattr(made, "fileno")
                else made
            )

        return one

    def array(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """``call``, counted where one of our own modules makes it."""

        def one(*args: Any, **settings: Any) -> Any:
            if str(sys._getframe(1).f_globals.get("__name__")).startswith(OWN):
                self._turn(name)
            return call(*args, **settings)

        return one

    def _turn(self, name: str) -> None:
        self.calls.append(name)
        if len(self.calls) == self.at:
            raise self.problem()

    def _ours(self, args: tuple[Any, ...]) -> bool:
        try:
            path = os.fspath(args[0])
        except (TypeError, IndexError):
            return False
        text = path.decode() if isinstance(path, bytes) else path
        return text.endswith(".j2") or Path(os.path.abspath(text)).is_relative_to(self.folder)


class Stream:
    """An open file whose reads and writes are counted, too."""

    def __init__(self, stream: Any, machine: Machine) -> None:
        self._stream, self._machine = stream, machine

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._stream, name)
        return (
            self._machine.counted(name, found)
            if name in ("read", "readline", "write", "flush")
            else found
        )

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def __iter__(self) -> Iterator[Any]:
        return iter(self._stream)


@contextmanager
def refusing(machine: Machine, homes: Sequence[Home] = FILES) -> Iterator[Machine]:
    """Everything that opens, makes, reads, writes, flushes or renames files goes through
    ``machine``."""
    wrap = machine.array if homes is ARRAYS else machine.counted
    real = [(home, name, getattr(home, name)) for home, name in homes]
    with pytest.MonkeyPatch.context() as patch:
        for home, name, call in real:
            patch.setattr(home, name, wrap(name, call))
        yield machine


STAMPS = re.compile(
    rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\+00:00)?|\b[0-9a-f]{16}(?:[0-9a-f]{48})?\b"
)


def content(folder: Path) -> dict[str, bytes]:
    """Every file below ``folder``, without moments and checksums."""
    return {
        str(p.relative_to(folder)): STAMPS.sub(b"", p.read_bytes())
        for p in folder.rglob("*")
        if p.is_file()
    }


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code, standard error, the files."""

    code: int
    err: str
    files: dict[str, bytes]


def torn(
    before: dict[str, bytes], sound: dict[str, bytes], now: dict[str, bytes], grows: str = ""
) -> list[str]:
    """Files that are neither as they were ``before`` nor as a ``sound`` run leaves them; ``grows``:
    one that may stop behind any whole line."""
    out = []
    for name, data in now.items():
        whole = sound.get(name, b"")
        has_whole_rows = name == grows and data[-1:] == b"\n" and data in whole
        # the state of a log that is followed is that of the rows which are written
        is_state = bool(grows) and name.endswith(".json") and data.rstrip().endswith(b"}")
        if data not in (before.get(name), whole) and not has_whole_rows and not is_state:
            out.append(f"{name} is {'changed' if name in before else 'left behind'}")
    return [*out, *(f"{name} is gone" for name in before if name not in now)]


def complaints(before: dict[str, bytes], sound: Ended, now: Ended, grows: str = "") -> list[str]:
    """What a run on a refusing machine did that it may not do.

    ``sound``: the same command on a machine that refuses nothing. A run that ends as that one did,
    files and all, has lost nothing; every other has to end with 2, one sentence, and each file as
    it was or as it should be.
    """
    told = [
        line
        for line in now.err.splitlines()
        if not line.startswith(("... ", "info: ", "warning: "))
    ]
    if (now.code, now.files) == (sound.code, sound.files):
        return []
    out = []
    if now.code != 2:
        out.append(f"ended with {now.code}")
    if len(told) != 1 or not told[0].startswith("tcdyn: "):
        out.append(f"said {told}")
    return [*out, *torn(before, sound.files, now.files, grows)]
