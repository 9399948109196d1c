"""Kinds of files that the commands write, and the endings that their names may have.

A file must not have a name that promises another kind, such as a page named ``x.png``.
``check_ending`` is called before any computation: by every command through
``tcdyn.cli.common.check_outputs``, and by the Python functions that write files. Guarded by
``tests/cli/test_endings.py``, which calls every command with every output that it has.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tcdyn.core.errors import InputError


@dataclass(frozen=True)
class FileKind:
    """A kind of file.

    Attributes
    ----------
    text
        What the file contains, for messages.
    endings
        Possible endings in lower case, the usual one first.
    needs_ending
        Whether a name without an ending is refused, as where the ending decides on the format. A
        name without an ending promises nothing, so any other kind may have it.
    """

    text: str
    endings: tuple[str, ...]
    needs_ending: bool = False

    def fits(self, path: str | Path) -> bool:
        """Whether the name of a file may belong to a file of this kind.

        >>> PAGE.fits("fast.html"), PAGE.fits("fast"), PAGE.fits("fast.png"), TABLE.fits("fast")
        (True, True, False, False)
        """
        ending = Path(path).suffix.lower()
        if not ending:
            return not self.needs_ending
        return ending in self.endings


PAGE = FileKind("an HTML page", (".html", ".htm"))
JSON = FileKind("JSON", (".json",))
CSV = FileKind("a CSV table", (".csv",), needs_ending=True)
TABLE = FileKind("a table", (".csv", ".parquet", ".tdms"), needs_ending=True)
# a table that is written part by part, which TDMS is not
LONG_TABLE = FileKind("a table", (".csv", ".parquet"), needs_ending=True)
CSV_OR_PAGE = FileKind("a CSV table or an HTML page", (".csv", ".html", ".htm"), needs_ending=True)
PICTURE = FileKind("a picture", (".png", ".svg", ".pdf"), needs_ending=True)


def check_ending(path: str | Path, kind: FileKind, option: str = "") -> None:
    """Check that the ending of a name is one of the kind that will be written.

    Parameters
    ----------
    path
        File to write.
    kind
        What it will contain.
    option
        Option of a command, with its dashes; empty for a function.

    Raises
    ------
    InputError
        For another ending, and without one where the kind needs one.

    Examples
    --------
    >>> check_ending("fast.html", PAGE)
    >>> check_ending("fast.png", PAGE, "--report")
    Traceback (most recent call last):
    ...
    tcdyn.core.errors.InputError: --report is fast.png, but an HTML page cannot have the ending \
'.png'; expected a name ending in .html or .htm; give another name, such as fast.html
    """
    if kind.fits(path):
        return
    file = Path(path)
    subject = f"{option} is {file}, but " if option else ""
    fault = f"cannot have the ending {file.suffix!r}" if file.suffix else "needs an ending"
    endings = " or ".join(filter(None, [", ".join(kind.endings[:-1]), kind.endings[-1]]))
    raise InputError(
        f"{subject}{kind.text} {fault}",
        where="" if option else str(file),
        expected=f"a name ending in {endings}",
        remedy=f"give another name, such as {file.with_suffix(kind.endings[0]).name}",
    )
