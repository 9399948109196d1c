"""``tcdyn verify``: every published number the thesis lets us check, side by side with ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich.console import Console
from rich.table import Table

from tcdyn.verify import VerifyRow, verify_rows

COLOURS = {"agrees": "green", "same trend": "cyan", "differs": "bold red", "not checkable": "yellow"}


def verify(
    report: Annotated[Path | None, typer.Option("--report", help="HTML page with the table and its pictures")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="the table as CSV")] = None,
    why: Annotated[bool, typer.Option("--why", help="print the reason of every row")] = False,
) -> None:
    """Compute every published number that can be checked; exit code 1 when one differs."""
    rows = verify_rows()
    _print(rows, why)
    if csv is not None:
        from calibration.write import write_text

        write_text(csv, _frame(rows).to_csv(index=False))
    if report is not None:
        _report(rows, report)
    if any(row.failed for row in rows):
        raise typer.Exit(1)


def sentence(rows: Sequence[VerifyRow]) -> str:
    """The verdict in one sentence."""
    count = {v: sum(row.verdict == v for row in rows) for v in COLOURS}
    return (
        f"{len(rows)} published numbers checked: {count['agrees']} agree, {count['same trend']} show the same "
        f"trend, {count['differs']} differ, {count['not checkable']} cannot be checked in size."
    )


def _print(rows: Sequence[VerifyRow], why: bool) -> None:
    console = Console()
    columns = ["quantity", "source", "published", "ours", "verdict", *(["why"] if why else [])]
    table = Table(*columns, show_lines=why)
    for row in rows:
        cells = [row.quantity, row.source, row.published, row.ours, f"[{COLOURS[row.verdict]}]{row.verdict}[/]"]
        table.add_row(*cells, *([row.why] if why else []))
    console.print(table)
    for row in rows:
        if row.verdict != "agrees" and not why:
            console.print(f"{row.source}, {row.quantity}: {row.why}", markup=False)
    console.print(sentence(rows), markup=False)


def _frame(rows: Sequence[VerifyRow]) -> pd.DataFrame:
    return pd.DataFrame([vars(row) for row in rows])


def _report(rows: Sequence[VerifyRow], path: Path) -> None:
    from tcdyn.plots.conduction import verify_figures
    from tcdyn.report.page import Section, write_page

    sections = [Section("Published and ours", text=sentence(rows), table=_frame(rows))]
    sections += [Section(caption[0].upper() + caption[1:], figure=f) for caption, f in verify_figures().items()]
    differing = [f"{row.source}: {row.quantity}: {row.ours} for {row.published}" for row in rows if row.failed]
    write_page(path, "tcdyn verify", sections, warnings=differing)
