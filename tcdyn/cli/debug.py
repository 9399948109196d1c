"""The file that ``--debug`` writes for the report of an internal error.

Used by :mod:`tcdyn.cli.app`. Test: ``tests/cli/test_internal_error.py``.
"""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
import traceback
from contextvars import ContextVar
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from tcdyn.core.errors import utf8
from tcdyn.version import __version__

# Whether the command that runs has the option --debug.
is_on = ContextVar("debug", default=False)


def write_error_file(problem: BaseException) -> Path:
    """Write the traceback, the command and the versions to a new file in the temporary folder.

    Parameters
    ----------
    problem
        The internal error.

    Returns
    -------
    path
        The file. It is in the folder for temporary files, as the present folder may be one of
        measured data, or not writable.

    Raises
    ------
    OSError
        If it cannot be written.

    Examples
    --------
    >>> path = write_error_file(ZeroDivisionError("of an example"))
    >>> path.read_text(encoding="utf-8").splitlines()[-1]
    'ZeroDivisionError: of an example'
    >>> path.unlink()
    """
    lines = [
        f"command: {shlex.join(sys.argv)}",
        f"tcdyn {__version__}, Python {platform.python_version()}, {platform.platform()}",
        _versions(),
        "",
        *traceback.format_exception(problem),
    ]
    with tempfile.NamedTemporaryFile(
        "w",
        encoding="utf-8",
        newline="\n",
        prefix="tcdyn-error-",
        suffix=".txt",
        delete=False,
    ) as stream:
        stream.write(utf8("\n".join(line.rstrip("\n") for line in lines)) + "\n")
    return Path(stream.name)


def _versions() -> str:
    """The packages that tcdyn needs, with their installed versions."""
    try:
        needed = requires("tcdyn") or []
    except PackageNotFoundError:  # run from its source, not installed
        needed = []
    texts = []
    for requirement in needed:
        if ";" in requirement:  # of an extra
            continue
        name = requirement.partition(">")[0].partition("<")[0].strip()
        try:
            texts.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            texts.append(f"{name} missing")
    return ", ".join(texts)
