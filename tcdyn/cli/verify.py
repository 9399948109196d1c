"""Command ``tcdyn verify``: compare computed numbers with the published ones of the thesis.

The rows are :mod:`tcdyn.verify`, the figures :func:`tcdyn.plots.conduction.verify_figures`. Tests:
``tests/cli/test_verify.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from tcdyn.cli.common import NOT_TRUSTED, OutFile, Reporter, check_outputs, options_from_docstring
from tcdyn.core.findings import warning
from tcdyn.io.endings import CSV, PAGE

if TYPE_CHECKING:
    import pandas as pd

    from tcdyn.verify import VerifyRow

# Colour of each verdict; the order is that of the printed list.
COLOURS = {
    "differs": "bold red",
    "misprint": "magenta",
    "not checkable": "yellow",
    "same trend": "cyan",
    "agrees": "green",
}


@options_from_docstring
def verify(
    report: OutFile = None,
    out: OutFile = None,
    why: Annotated[bool, typer.Option(rich_help_panel="Output")] = False,
    *,
    reporter: Reporter,
) -> None:
    """Compute every published number that can be checked; exit code 1 if one differs.

    Each row has a class: physics, compared with a published number; trend; rule, derived from the
    table that it is compared with; arithmetic of printed numbers. Only the first two can detect a
    wrong model.

    Example: tcdyn verify --why --report verify.html

    Parameters
    ----------
    report
        HTML report with the table and figures
    out
        table (.csv) to write
    why
        print the reason for every row
    """
    from tcdyn.verify import count_by_kind, summary_text, verify_rows

    check_outputs([], reporter.overwrite, report=(report, PAGE), out=(out, CSV))
    rows = verify_rows()
    summary = summary_text(rows)
    reporter.json(lambda: {"sentence": summary, "classes": count_by_kind(rows), "rows": rows})
    if not reporter.is_silent:
        _print(summary, rows, why)
    if out is not None:
        from tcdyn.io.write import table_csv, write_text

        write_text(out, table_csv(_frame(rows)))
    if report is not None:
        _report(summary, rows, report)
    if any(row.failed for row in rows):
        raise typer.Exit(NOT_TRUSTED)


def _print(summary: str, rows: Sequence[VerifyRow], why: bool) -> None:
    """Print the summary, then the rows by result, the most important first.

    Parameters
    ----------
    summary
        Summary of the rows.
    rows
        All rows.
    why
        Print the reason of rows that agree, too.
    """
    console = Console()
    console.print(summary, markup=False, highlight=False)
    for verdict in COLOURS:
        selected = [row for row in rows if row.verdict == verdict]
        if selected:
            console.print(f"\n[{COLOURS[verdict]}]{verdict}[/] (class, source: ours | published)")
        printed_reasons: set[str] = set()
        for row in selected:
            reason = ""
            if (why or verdict != "agrees") and row.why not in printed_reasons:
                reason = row.why
            printed_reasons.add(row.why)
            for line in row_lines(row, reason, console.width):
                console.print(line, markup=False, highlight=False, soft_wrap=True)


def row_lines(row: VerifyRow, reason: str, width: int) -> list[str]:
    """A row as lines of text: class, source, quantity, both numbers, reason.

    Parameters
    ----------
    row
        The row.
    reason
        Text of the reason; empty: none.
    width
        Largest length of a line; at least 40 is used.

    Examples
    --------
    >>> from tcdyn.verify import VerifyRow
    >>> row = VerifyRow("its worked example", "(4.7)", "0.73", "0.732", "agrees", "", "arithmetic")
    >>> row_lines(row, "because", 60)
    ['  arithmetic, (4.7): its worked example: 0.732 | 0.73', '      because']
    """
    text = f"{row.kind}, {row.source}: {row.quantity}: {row.ours} | {row.published}"
    width = max(width, 40)
    lines = wrap(text, width, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False)
    indent = "      "
    return [*lines, *wrap(reason, width, initial_indent=indent, subsequent_indent=indent)]


def _frame(rows: Sequence[VerifyRow]) -> pd.DataFrame:
    """The rows as a table."""
    import pandas as pd

    return pd.DataFrame([vars(row) for row in rows])


# columns of the report, long texts last
REPORT_COLUMNS = ["quantity", "source", "published", "ours", "verdict", "kind", "why"]


def _report(summary: str, rows: Sequence[VerifyRow], path: Path) -> None:
    """Write the page with all rows and the figures.

    Parameters
    ----------
    summary
        Summary of the rows.
    rows
        All rows.
    path
        File to write.
    """
    from tcdyn.plots.conduction import verify_figures
    from tcdyn.report.page import Section, write_page

    head = (
        "Same trend: only the behaviour can be compared, not the size. Misprint: other numbers of "
        "the "
        "thesis also contradict the printed one."
    )
    sections = [Section("Published and ours", text=head, table=_frame(rows)[REPORT_COLUMNS])]
    for caption, figure in verify_figures().items():
        sections.append(Section(caption[0].upper() + caption[1:], figure=figure))
    differences = [
        warning(
            "verify.differs",
            subject=row.quantity,
            source=row.source,
            ours=row.ours,
            published=row.published,
        )
        for row in rows
        if row.failed
    ]
    write_page(
        path,
        "Published numbers and ours",
        sections,
        verdict=summary,
        findings=differences,
    )
