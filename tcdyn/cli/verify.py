"""``tcdyn verify``: every published number the thesis lets us check, side by side with ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from tcdyn.cli.common import Reporter, check_outputs, option_groups

if TYPE_CHECKING:
    import pandas as pd

    from tcdyn.verify import VerifyRow

COLOURS = {
    "differs": "bold red",
    "misprint": "magenta",
    "not checkable": "yellow",
    "same trend": "cyan",
    "agrees": "green",
}


@option_groups
def verify(
    report: Annotated[
        Path | None, typer.Option("--report", help="HTML page with the table and its pictures")
    ] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="the table as CSV")] = None,
    why: Annotated[bool, typer.Option("--why", help="print the reason of every row")] = False,
    *,
    reporter: Reporter,
) -> None:
    """Compute every published number that can be checked; exit code 1 when one differs.

    Each row says of what class it is: physics against a published figure; trend; rule, found from the table that it is
    compared with; arithmetic of printed numbers. Only the first two tell a right model from a wrong one.

    Example: tcdyn verify --why --report verify.html
    """
    from tcdyn.verify import verify_rows

    check_outputs([], report=report, csv=csv)
    rows = verify_rows()
    reporter.json(lambda: {"sentence": sentence(rows), "classes": by_kind(rows), "rows": rows})
    if not reporter.is_silent:
        _print(rows, why)
    if csv is not None:
        from tcdyn.io.write import write_text

        write_text(csv, _frame(rows).to_csv(index=False))
    if report is not None:
        _report(rows, report)
    if any(row.failed for row in rows):
        raise typer.Exit(1)


def by_kind(rows: Sequence[VerifyRow]) -> dict[str, int]:
    """How many rows there are of each class."""
    from tcdyn.verify import KINDS

    return {kind: sum(row.kind == kind for row in rows) for kind in KINDS}


def sentence(rows: Sequence[VerifyRow]) -> str:
    """The verdict in two sentences: what was found, and what it is evidence of."""
    from tcdyn.verify import KINDS

    count = {v: sum(row.verdict == v for row in rows) for v in COLOURS}
    classes = "; ".join(f"{n} {KINDS[kind]}" for kind, n in by_kind(rows).items())  # type: ignore[index]
    return (
        f"{len(rows)} published numbers checked: {count['agrees']} agree, {count['same trend']} show the same "
        f"trend, {count['misprint']} are misprints there, {count['differs']} differ, {count['not checkable']} cannot "
        f"be checked in size. By class: {classes}."
    )


def _print(rows: Sequence[VerifyRow], why: bool) -> None:
    """The verdict, then the rows under their verdicts, what needs reading first; legible on 80 columns."""
    console = Console()
    console.print(sentence(rows), markup=False, highlight=False)
    for verdict in COLOURS:
        own = [row for row in rows if row.verdict == verdict]
        if own:
            console.print(f"\n[{COLOURS[verdict]}]{verdict}[/] (class, source: ours | published)")
        told: list[str] = []
        for row in own:
            reason = row.why if (why or verdict != "agrees") and row.why not in told else ""
            told.append(row.why)
            for line in listed(row, reason, console.width):
                console.print(line, markup=False, highlight=False, soft_wrap=True)


def listed(row: VerifyRow, reason: str, width: int) -> list[str]:
    """A row as lines of at most ``width`` columns: class, source, quantity, both numbers, the reason if there is one.

    >>> from tcdyn.verify import VerifyRow
    >>> listed(VerifyRow("its worked example", "(4.7)", "0.73", "0.732", "agrees", "", "arithmetic"), "because", 60)
    ['  arithmetic, (4.7): its worked example: 0.732 | 0.73', '      because']
    """
    text = f"{row.kind}, {row.source}: {row.quantity}: {row.ours} | {row.published}"
    lines = wrap(
        text, max(width, 40), initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
    )
    return [
        *lines,
        *wrap(reason, max(width, 40), initial_indent="      ", subsequent_indent="      "),
    ]


def _frame(rows: Sequence[VerifyRow]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame([vars(row) for row in rows])


SHOWN = (
    "quantity",
    "source",
    "published",
    "ours",
    "verdict",
    "kind",
    "why",
)  # the sentences last, where there is room


def _report(rows: Sequence[VerifyRow], path: Path) -> None:
    from tcdyn.core.findings import warning
    from tcdyn.plots.conduction import verify_figures
    from tcdyn.report.page import Section, write_page

    head = (
        "A row that differs would stop a release. Same trend: the size cannot be compared, the behaviour can. "
        "Misprint: the thesis's own other numbers contradict the printed one as well."
    )
    sections = [Section("Published and ours", text=head, table=_frame(rows)[[*SHOWN]])]
    sections += [
        Section(caption[0].upper() + caption[1:], figure=f)
        for caption, f in verify_figures().items()
    ]
    differing = [
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
        path, "Published numbers and ours", sections, verdict=sentence(rows), findings=differing
    )
