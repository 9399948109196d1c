"""Command ``tcdyn inspect``: what is understood of a table.

The answers are :mod:`tcdyn.workflows.inspect`. Test: ``tests/cli/test_inspect_command.py``.
"""

from __future__ import annotations

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
from tcdyn.cli.tables import TableFiles, files_of_tables
from tcdyn.series.options import TableOptions


@options_from_docstring
def inspect(
    files: TableFiles,
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
    column
        column to look at, or a pattern such as T*; repeat for several (default: all columns of
        numbers)
    """
    from tcdyn.workflows.inspect import inspect as inspect_table

    paths, left_out = files_of_tables(files)
    check_picture(picture, paths, reporter.overwrite)
    found = inspect_table(paths[0] if len(paths) == 1 else paths, column or (), **options.stated)
    if picture is not None:
        from tcdyn.plots.inspect import inspection_figure

        save_picture(inspection_figure(found), picture)
    reporter.json(lambda: {**found.to_dict(), "source": source_entry(paths[0]), "picture": picture})
    reporter.summary(found.summary())
    reporter.files(picture=picture)
    reporter.finish(paths[0].name, [*left_out, *found.findings])
