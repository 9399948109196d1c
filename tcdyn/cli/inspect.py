"""Command ``tcdyn inspect``: what is understood of a table.

The answers are :mod:`tcdyn.workflows.inspect`. Test: ``tests/cli/test_inspect_command.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tcdyn.cli.common import (
    OptionalPicture,
    Reporter,
    check_picture,
    options_from_docstring,
    save_picture,
    source_entry,
)
from tcdyn.series.options import TableOptions


@options_from_docstring
def inspect(
    file: Path,
    column: Annotated[list[str] | None, typer.Option(rich_help_panel="Input")] = None,
    picture: OptionalPicture = None,
    *,
    options: TableOptions,
    reporter: Reporter,
) -> None:
    """Show what is understood of a table: rows, clock, gaps, units, and what is no reading.

    Every other command reads the table in the same way.

    Example: tcdyn inspect kiln.csv --picture kiln.png

    Parameters
    ----------
    file
        any table with a column of time: CSV, LVM, TDMS or Parquet
    column
        column to look at, or a pattern such as T*; repeat for several (default: all columns of
        numbers)
    """
    from tcdyn.workflows.inspect import inspect as inspect_table

    check_picture(picture, [file], reporter.overwrite)
    found = inspect_table(file, column or (), **options.stated)
    if picture is not None:
        from tcdyn.plots.inspect import inspection_figure

        save_picture(inspection_figure(found), picture)
    reporter.json(lambda: {**found.to_dict(), "source": source_entry(file), "picture": picture})
    reporter.summary(found.summary())
    reporter.files(picture=picture)
    reporter.finish(file.name, found.findings)
