"""``tcdyn record show|diff|check``: what a disk record says, what drifted since another, whether it can be trusted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from calibration.compare import RecordDiff, check_record, diff_records
from calibration.estimate import Estimate, with_u
from calibration.finding import Grade, once, sentences
from calibration.lines.static import static_u
from calibration.record import DiskRecord, read_record
from tcdyn.cli.common import Json, Quiet, dump, say

app = typer.Typer(
    name="record",
    help="Show, compare and check the records of calibrated disks.",
    no_args_is_help=True,
    add_completion=False,
)

RecordPath = Annotated[Path, typer.Argument(help="*.disk.json")]


@app.command()
def show(record: RecordPath, json_: Json = False) -> None:
    """The record in one page: static lines, lags, what it was made from.

    Example: tcdyn record show fast.disk.json
    """
    console = Console()
    found = read_record(record)
    if json_:
        print(found.to_json(), end="")
        return
    console.print(f"disk {found.disk}, made {found.created}" + (f" by {found.created_by}" if found.created_by else ""))
    console.print(static_table(found))
    if found.chain is not None:
        console.print(chain_table(found))
    for item in found.inputs:
        console.print(f"from {item.file}  sha256 {item.sha256[:16]}...", markup=False, highlight=False)
    for noticed in once(found.findings):
        word = "note" if noticed.grade is Grade.NOTE else "warning"
        console.print(f"{word}: {noticed.sentence}", markup=False, highlight=False)


@app.command()
def diff(
    old: RecordPath,
    new: RecordPath,
    every: Annotated[bool, typer.Option("--all", help="list what did not drift, too")] = False,
    json_: Json = False,
) -> None:
    """What drifted between two calibrations of one disk, and whether it is significant (5 %, Holm).

    Example: tcdyn record diff fast.2026.disk.json fast.disk.json
    """
    console = Console()
    found = diff_records(read_record(old), read_record(new))
    if json_:
        print(dump(found.to_dict()), end="")
        return
    rows = found.table if every else found.significant
    if len(rows):
        console.print(diff_table(found, every))
    console.print(found.sentence())
    for note in found.notes:
        console.print(f"note: {note}", markup=False, highlight=False)


@app.command()
def check(record: RecordPath, json_: Json = False, quiet: Quiet = False) -> None:
    """Refuse a damaged record (exit 2); otherwise list what a careful reader would ask (exit 1 if anything).

    Example: tcdyn record check fast.disk.json
    """
    doubts = sentences(check_record(read_record(record)))
    if json_:
        print(dump({"sound": not doubts, "doubts": doubts}), end="")
    else:
        for doubt in doubts:
            say(f"- {doubt}", quiet)
        verdict = f"The record is readable; {len(doubts)} point(s) to look at." if doubts else "The record is sound."
        say(verdict, quiet)
    if doubts:
        raise typer.Exit(1)


def static_table(record: DiskRecord) -> Table:
    """The static lines, one row a channel."""
    table = Table(
        "ch", "gain", "offset degC", "range degC", "u mid K", "sd K", title="Static lines (u at mid-range, sd of rest)"
    )
    for name, line in sorted(record.static.items()):
        low, high = line.range_degC
        table.add_row(
            name,
            str(line.gain_estimate),
            str(line.offset_estimate),
            f"{low:.0f} to {high:.0f}",
            f"{float(static_u(line, 0.5 * (low + high))):.3f}",
            f"{line.residual_sd_degC:.3f}",
        )
    return table


def chain_table(record: DiskRecord) -> Table:
    """Lags, one row a channel, the common lag last."""
    assert record.chain is not None
    table = Table("channel", "lag s", "95 %", "minus common s", title=f"Chain ({record.chain.structure})")
    for name, channel in sorted(record.chain.channels.items()):
        lag = channel.lag_s
        table.add_row(
            name,
            _pm(lag),
            f"{lag.low95:.3f} to {lag.high95:.3f}",
            _pm(record.chain.differential_lag_s[name]),
        )
    common = record.chain.common_lag_s
    table.add_row("common", _pm(common), f"{common.low95:.3f} to {common.high95:.3f}", "")
    return table


def diff_table(found: RecordDiff, every: bool) -> Table:
    """Changes, one row a quantity."""
    table = Table("quantity", "old", "new", "change", "u", "z", "p", "")
    for row in (found.table if every else found.significant).itertuples():
        table.add_row(
            str(row.quantity),
            f"{row.old:.4g}",
            f"{row.new:.4g}",
            f"{row.change:+.3g}",
            f"{row.u:.2g}",
            f"{row.z:+.1f}",
            f"{row.p:.2g}",
            "drifted" if row.significant else "",
        )
    return table


def _pm(estimate: Estimate) -> str:
    return with_u(estimate.value, estimate.u)
