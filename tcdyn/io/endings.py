"""Kinds of files that the commands write, and the endings that their names may have.

A file must not have a name that promises another kind, such as a page named ``x.png``.
``check_ending`` is called before any computation: by every command through
``tcdyn.cli.common.check_outputs``, and by the Python functions that write files. Guarded by
``tests/cli/test_endings.py``, which calls every command with every output that it has.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
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
TABLE = FileKind("a table", (".csv", ".parquet", ".xlsx", ".nc", ".tdms"), needs_ending=True)
# a table whose rows come part by part, which TDMS is not written from
LONG_TABLE = FileKind("a table", (".csv", ".parquet", ".xlsx", ".nc"), needs_ending=True)
CSV_OR_PAGE = FileKind("a CSV table or an HTML page", (".csv", ".html", ".htm"), needs_ending=True)
CSV_OR_JSON = FileKind("a CSV table or JSON", (".csv", ".json"), needs_ending=True)
PICTURE = FileKind("a picture", (".png", ".svg", ".pdf"), needs_ending=True)

# Rows, with the header, and columns of a sheet: Microsoft, "Excel specifications and limits";
# LibreOffice has the same number of rows.
MAX_SHEET_ROWS = 1_048_576
MAX_SHEET_COLUMNS = 16_384
# Cells of a sheet: a number takes up to 60 bytes before it is packed, and a part of a zip archive
# without its extension to 64 bits, which spreadsheet programs offer to repair, 2 GiB.
MAX_SHEET_CELLS = 2**31 // 60
# Values of a netCDF file, which is written in one piece: 0.8 GB of doubles, and three times as much
# in memory.
MAX_NETCDF_VALUES = 100_000_000


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
        For another ending, and without one where the kind needs one; for .nc without xarray.

    Examples
    --------
    >>> check_ending("fast.html", PAGE)
    >>> check_ending("fast.png", PAGE, "--report")
    Traceback (most recent call last):
    ...
    tcdyn.core.errors.InputError: --report is fast.png, but an HTML page cannot have the ending \
'.png'; expected a name ending in .html or .htm; give another name, such as fast.html
    """
    file = Path(path)
    if kind.fits(path):
        if file.suffix.lower() == ".nc" and find_spec("xarray") is None:
            raise InputError(
                "netCDF needs xarray, which is not installed",
                where=str(file),
                remedy="pip install 'tcdyn[xarray]', or write .csv or .parquet",
            )
        return
    subject = f"{option} is {file}, but " if option else ""
    fault = f"cannot have the ending {file.suffix!r}" if file.suffix else "needs an ending"
    endings = " or ".join(filter(None, [", ".join(kind.endings[:-1]), kind.endings[-1]]))
    raise InputError(
        f"{subject}{kind.text} {fault}",
        where="" if option else str(file),
        expected=f"a name ending in {endings}",
        remedy=f"give another name, such as {file.with_suffix(kind.endings[0]).name}",
    )


def check_size(path: str | Path, rows: int, columns: int) -> None:
    """Check that a file can hold a table, by its ending.

    Call it before the work where the number of rows is known. The writers check it again.

    Parameters
    ----------
    path
        File to write.
    rows, columns
        Rows without the header, and columns.

    Raises
    ------
    InputError
        For .xlsx and .nc, if the table is too large.

    Examples
    --------
    >>> check_size("done.xlsx", 1_048_575, 8)
    >>> check_size("done.csv", 10**9, 8)
    >>> check_size("done.xlsx", 1_048_576, 8)
    Traceback (most recent call last):
    ...
    tcdyn.core.errors.InputError: done.xlsx: 1048576 rows and 8 columns are too many for .xlsx; \
expected at most 1048575 rows below the header, 16384 columns and 35791394 cells; write .csv or \
.parquet
    """
    ending = Path(path).suffix.lower()
    is_too_large = False
    limit = ""
    if ending == ".xlsx":
        is_too_large = rows + 1 > MAX_SHEET_ROWS or columns > MAX_SHEET_COLUMNS
        is_too_large |= (rows + 1) * columns > MAX_SHEET_CELLS
        limit = (
            f"at most {MAX_SHEET_ROWS - 1} rows below the header, {MAX_SHEET_COLUMNS} columns and "
            f"{MAX_SHEET_CELLS} cells"
        )
    elif ending == ".nc":
        is_too_large = rows * columns > MAX_NETCDF_VALUES
        limit = f"at most {MAX_NETCDF_VALUES} values, since it is written in one piece"
    if is_too_large:
        raise InputError(
            f"{rows} rows and {columns} columns are too many for {ending}",
            where=str(path),
            expected=limit,
            remedy="write .csv or .parquet",
        )
