"""Tables as .xlsx, the format of spreadsheet programs, written row by row with xlsxwriter.

The first sheet holds the table, the second its metadata. Used by :mod:`tcdyn.io.write`. Guarded by
``tests/io/test_xlsx.py``, which reads the files with openpyxl and pandas.

References
----------
Microsoft, "Excel specifications and limits"; ECMA-376, part 1, section 18.17.4.1 (dates).
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.clock_cells import ClockCells
from tcdyn.io.endings import check_size
from tcdyn.io.metadata import METADATA_HEADER, METADATA_SHEET
from tcdyn.io.stamps import SECONDS_PER_DAY

TABLE_SHEET = "table"
# Text of a cell, "Excel specifications and limits": total number of characters that a cell can hold
MAX_CELL_TEXT = 32_767
# Day 0 of the date base 1900. It holds from 1 March 1900 on, day 61: the specification counts
# 29 February 1900, which did not exist.
EPOCH = pd.Timestamp("1899-12-30")
FIRST_DAY = 61.0
# Formats in the notation of the file, which each program shows in its own language.
INSTANT_FORMAT = "yyyy-mm-dd hh:mm:ss.000"
DATE_FORMAT = "yyyy-mm-dd"
CLOCK_FORMAT = "hh:mm:ss.000"
DURATION_FORMAT = "[h]:mm:ss.000"
# Time of creation in the properties of the file: one for all files, so that the same table gives
# the same bytes. It is the earliest that a zip archive can state.
CREATED = datetime(1980, 1, 1, tzinfo=UTC)
# Widths of columns [characters]: of an instant, of a number with all its digits, and at most; by
# judgement (looks).
INSTANT_WIDTH = 24
NUMBER_WIDTH = 12
LARGEST_WIDTH = 60


@contextmanager
def xlsx_appender(
    path: Path,
    target: Path,
    names: Sequence[str],
    metadata: Mapping[str, str],
    text: Collection[str],
    types: Mapping[str, pa.DataType],
) -> Iterator[Callable[[pd.DataFrame], None]]:
    """Yield a function that appends tables to a workbook, which is written when the block succeeds.

    Parameters
    ----------
    path
        File to write.
    target
        The name that messages give it.
    names, metadata, text
        As for ``tcdyn.io.write.log_writer``.
    types
        As in ``tcdyn.io.write.OutputStyle``.

    Raises
    ------
    InputError
        For more rows, columns or text than a workbook can hold.
    OSError
        If the file cannot be written.

    Notes
    -----
    Memory does not grow with the table: xlsxwriter writes each row to a temporary file in the
    folder of ``path``, and packs it at the end.
    """
    from xlsxwriter import Workbook
    from xlsxwriter.exceptions import FileCreateError, FileSizeError

    check_size(target, 0, len(names))
    with TemporaryDirectory(
        dir=path.parent, prefix=f"{path.stem}.", ignore_cleanup_errors=True
    ) as folder:
        workbook = Workbook(path, {"constant_memory": True, "tmpdir": folder})
        workbook.set_properties({"created": CREATED})
        try:
            table = _TableSheet(workbook, target, names, text, types)
            yield table.append
            table.finish()
            notes = {**metadata, **table.clock_notes()}
            _write_metadata(workbook, notes, target)
        except BaseException:
            for sheet in workbook.worksheets():  # otherwise they stay open
                with suppress(OSError):  # on a full disk, which is what failed
                    sheet.row_data_fh.close()
            raise
        try:
            workbook.close()
        except FileCreateError as problem:
            raise problem.args[0] from None  # the OSError
        except FileSizeError:
            raise InputError(
                "is larger than a file of .xlsx can be",
                where=str(target),
                remedy="write .csv or .parquet",
            ) from None


class _TableSheet:
    """The sheet with the table.

    Parameters
    ----------
    workbook
        The workbook.
    target
        Name of the file, for messages.
    names, text, types
        As for ``xlsx_appender``.
    """

    def __init__(
        self,
        workbook: Any,
        target: Path,
        names: Sequence[str],
        text: Collection[str],
        types: Mapping[str, pa.DataType],
    ) -> None:
        self.target = target
        self.names = list(names)
        self.text = set(text)
        self.types = types
        self.clocks: dict[str, ClockCells | None] = {}
        self.rows = 0
        self.sheet = workbook.add_worksheet(TABLE_SHEET)
        self.sheet.freeze_panes(1, 0)
        self.styles = {
            pattern: workbook.add_format({"num_format": pattern})
            for pattern in (INSTANT_FORMAT, DATE_FORMAT, CLOCK_FORMAT, DURATION_FORMAT)
        }
        self.formats: dict[str, str] = {}
        header = workbook.add_format({"bold": True})
        for column, name in enumerate(self.names):
            self.sheet.write_string(0, column, _cell_text(str(name), target), header)

    def append(self, frame: pd.DataFrame) -> None:
        """Append the rows of a table."""
        check_size(self.target, self.rows + len(frame), len(self.names))
        columns = [self._cells(name, frame[name].to_numpy()) for name in self.names]
        formats = [self.styles.get(self.formats.get(name, "")) for name in self.names]
        write_number = self.sheet.write_number
        write_string = self.sheet.write_string
        for row, cells in enumerate(zip(*columns), self.rows + 1):
            for column, cell in enumerate(cells):
                if cell is None:
                    continue
                if isinstance(cell, str):
                    write_string(row, column, cell)
                else:
                    write_number(row, column, cell, formats[column])
        self.rows += len(frame)

    def finish(self) -> None:
        """Set the widths of the columns."""
        for column, name in enumerate(self.names):
            usual = INSTANT_WIDTH if self.formats.get(name) == INSTANT_FORMAT else NUMBER_WIDTH
            width = min(max(len(str(name)) + 2, usual), LARGEST_WIDTH)
            self.sheet.set_column(column, column, width)

    def clock_notes(self) -> dict[str, str]:
        """By column of dates: of which zone its clock is, which a spreadsheet cannot state."""
        notes = {}
        for name, clock in self.clocks.items():
            if clock is not None and clock.first is not None and clock.has_clock:
                notes[f"dates of {name}"] = clock.zone_text()
        return notes

    def _cells(self, name: str, values: NDArray[Any]) -> list[float | str | None]:
        """Cells (N,) of a column: numbers, texts, and None for empty ones."""
        kind = self.types.get(name)
        if values.dtype.kind == "m" or (kind is not None and pa.types.is_duration(kind)):
            self.formats[name] = DURATION_FORMAT
            durations = pd.to_timedelta(pd.Series(values))
            return _numbers_or_text(_days(durations), values)
        if values.dtype.kind == "M":
            self.formats[name] = INSTANT_FORMAT
            return _numbers_or_text(_days(pd.Series(values) - EPOCH), values)
        if values.dtype.kind in "fiub" and name not in self.text:
            numbers = values.astype(float)
            return _numbers_or_text(np.where(np.isfinite(numbers), numbers, np.nan), numbers)
        texts = self._texts(values)
        if name not in self.clocks:
            self.clocks[name] = ClockCells.of(name, np.array(texts, dtype=object))
        clock = self.clocks[name]
        if clock is None:
            return [text or None for text in texts]
        days = clock.days_from(EPOCH, np.array(texts, dtype=object))
        if clock.first is not None:
            days[days < FIRST_DAY] = np.nan
        self.formats[name] = _clock_format(clock)
        return _numbers_or_text(days, np.array(texts, dtype=object))

    def _texts(self, values: NDArray[Any]) -> list[str]:
        """Texts (N,) of a column, empty for missing ones."""
        return [
            "" if value is None or value != value else _cell_text(str(value), self.target)
            for value in values
        ]


def _days(durations: pd.Series) -> Array:
    """Durations (N,) in days."""
    return np.asarray(durations.dt.total_seconds() / SECONDS_PER_DAY, dtype=float)


def _clock_format(clock: ClockCells) -> str:
    """Format of the cells of a column of clock stamps."""
    if clock.first is None:
        return CLOCK_FORMAT
    return INSTANT_FORMAT if clock.has_clock else DATE_FORMAT


def _numbers_or_text(numbers: Array, values: NDArray[Any]) -> list[float | str | None]:
    """The numbers (N,), and where they are NaN the values as text; None where both are missing.

    >>> values = np.array(["12:00", "", "inf"], dtype=object)
    >>> _numbers_or_text(np.array([0.5, np.nan, np.nan]), values)
    [0.5, None, 'inf']
    """
    cells: list[float | str | None] = numbers.tolist()
    for row in np.flatnonzero(np.isnan(numbers)):
        value = values[row]
        is_missing = value is None or value != value or value == ""
        cells[row] = None if is_missing else str(value)
    return cells


def _cell_text(text: str, target: Path) -> str:
    """A text that a cell can hold.

    Raises
    ------
    InputError
        If it is longer than ``MAX_CELL_TEXT``.
    """
    if len(text) > MAX_CELL_TEXT:
        raise InputError(
            f"a text of {len(text)} characters, {text[:20]!r}..., is longer than a cell of .xlsx "
            f"can hold ({MAX_CELL_TEXT})",
            where=str(target),
            remedy="write .csv or .parquet",
        )
    return text


def _write_metadata(workbook: Any, metadata: Mapping[str, str], target: Path) -> None:
    """Write the sheet with the metadata, a row each."""
    sheet = workbook.add_worksheet(METADATA_SHEET)
    sheet.freeze_panes(1, 0)
    sheet.set_column(0, 1, LARGEST_WIDTH)
    for row, entry in enumerate([METADATA_HEADER, *metadata.items()]):
        for column, content in enumerate(entry):
            sheet.write_string(row, column, _cell_text(content, target))


def stored_metadata(path: Path, max_bytes: int) -> bytes:
    """The parts of a workbook in which texts of its metadata are, unpacked.

    Parameters
    ----------
    path
        The workbook.
    max_bytes
        Largest number of bytes of each part.

    Returns
    -------
    bytes
        Empty for a file that is no workbook.
    """
    content = b""
    try:
        with zipfile.ZipFile(path) as archive:
            # other programs that save the workbook move texts to the shared ones
            for part in ("xl/worksheets/sheet2.xml", "xl/sharedStrings.xml"):
                if part in archive.namelist():
                    with archive.open(part) as stream:
                        content += stream.read(max_bytes)
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError):
        return b""
    return content
