"""``tcdyn demo``: the main job from simulated logs to the report, with the truth beside every answer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from tcdyn.cli.common import Json, Quiet, Verbose, dump, stages


def demo(
    out: Annotated[Path, typer.Option(help="folder to write into")] = Path("demo"),
    seed: Annotated[int, typer.Option(min=0, help="another seed is another rig")] = 1,
    test: Annotated[list[str] | None, typer.Option(help="tests of table 6.1 to run (default B3)")] = None,
    json_: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Simulate a campaign, run every stage on its logs and write the report.

    Writes logs, records, compensated traces, beta.json and report.html into a folder; because the campaign is
    simulated, the truth is printed beside every answer. No stage reads it.

    Example: tcdyn demo --out demo --seed 4 --test A1 --test D4
    """
    from tcdyn.pipeline import run_demo
    from tcdyn.report.beta import write_beta_report

    with stages(quiet or json_, verbose) as progress:
        run = run_demo(out, seed, tuple(test or ("B3",)), progress=progress)
        progress("writing the report")
        truths = {
            name: float(run.comparison.query(f"quantity == '{name} beta, speed law'")["truth"].iloc[0])
            for name in run.tests
        }
        report = write_beta_report(out / "report.html", {n: b.partition for n, b in run.tests.items()}, truths)
    if json_:
        print(dump({**run.to_dict(), "report": report}), end="")
    if quiet or json_:
        return
    console = Console()
    table = Table(title=f"simulated campaign, seed {seed}", title_justify="left")
    for column in ("quantity", "estimate", "u", "truth", "unit"):
        table.add_column(column, justify="left" if column in ("quantity", "unit") else "right")
    for row in run.card().itertuples(index=False):
        table.add_row(*row)
    console.print(table)
    for name, beta in run.tests.items():
        console.print(f"{name}: {beta.partition.crosscheck.sentence}", highlight=False)
    console.print(f"report: {report}", highlight=False, soft_wrap=True)
