"""What is kept of the rig: ``tcdyn record`` for disks, ``tcdyn rig`` for its file, ``tcdyn transducer`` for cells."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from tcdyn.cli.common import (
    Disk,
    Json,
    Reporter,
    check_choice,
    check_outputs,
    dump,
    exit_status,
    number_option,
    option_groups,
)
from tcdyn.core.errors import InputError

app = typer.Typer(
    name="record",
    help="Show, compare and check the records of calibrated disks.",
    no_args_is_help=True,
    add_completion=False,
)

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table

    from calibration.compare import RecordDiff
    from tcdyn.rig.record import ChainRecord, DiskRecord

RecordPath = Annotated[Path, typer.Argument(help="*.disk.json")]


@app.command()
def show(record: RecordPath, json_: Json = False) -> None:
    """The record in one page: static lines, lags, what it was made from.

    Example: tcdyn record show fast.disk.json
    """
    from tcdyn.rig.record import read_record

    found = read_record(record)
    if json_:
        print(found.to_json(), end="")
    else:
        _show(found)
    exit_status(str(record), found.findings)


def _show(found: DiskRecord) -> None:
    """The record in words."""
    from tcdyn.core.findings import unique
    from tcdyn.rig.static_line import lines_table

    console = Console()
    console.print(f"disk {found.disk}, made {found.made}")
    lines = lines_table(found.static).set_axis(
        ["ch", "gain", "offset degC", "range degC", "u mid K", "sd K"], axis=1
    )
    console.print(rich_table(lines, "Static lines (u at mid-range, sd of rest)"))
    if found.chain is not None:
        console.print(rich_table(chain_rows(found.chain), f"Chain ({found.chain.structure})"))
    for item in found.inputs:
        console.print(
            f"from {item.file}  sha256 {item.sha256[:16]}...", markup=False, highlight=False
        )
    for noticed in unique(found.findings):
        console.print(
            f"{noticed.severity.value}: {noticed.sentence}", markup=False, highlight=False
        )


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
    from calibration.compare import diff_records
    from tcdyn.rig.record import read_record

    console = Console()
    found = diff_records(read_record(old), read_record(new))
    if json_:
        print(dump(found.to_dict()), end="")
        return
    rows = found.table if every else found.significant
    if len(rows):
        console.print(rich_table(diff_rows(found, every)))
    console.print(found.sentence())
    for note in found.notes:
        console.print(f"info: {note}", markup=False, highlight=False)


@app.command()
@option_groups
def check(record: RecordPath, *, reporter: Reporter) -> None:
    """Refuse a damaged record (exit 2); otherwise list what a careful reader would ask (exit 1 if anything).

    Example: tcdyn record check fast.disk.json
    """
    from calibration.compare import check_record
    from tcdyn.core.findings import messages
    from tcdyn.rig.record import read_record

    doubts = messages(check_record(read_record(record)))
    reporter.json(lambda: {"sound": not doubts, "doubts": doubts})
    verdict = (
        f"The record is readable; {len(doubts)} point(s) to look at."
        if doubts
        else "The record is sound."
    )
    reporter.text("\n".join([*(f"- {doubt}" for doubt in doubts), verdict]))
    if doubts:
        raise typer.Exit(1)


@option_groups
def rig(
    show: Annotated[
        bool, typer.Option("--show", help="print the rig file, every key with its value")
    ] = True,
    file: Annotated[
        Path | None, typer.Option("--rig", help="rig.toml to check; without it the defaults")
    ] = None,
    *,
    reporter: Reporter,
) -> None:
    """Check a rig file and print every key with the value in force.

    Example: tcdyn rig --show > rig.toml writes a file to start from; tcdyn rig --rig rig.toml checks it.
    """
    from tcdyn.rig.rigfile import load_rig, rig_toml

    found = load_rig(file)
    if show and not reporter.quiet:
        reporter.json(found.to_dict)
        reporter.text(rig_toml(found).rstrip())


@option_groups
def transducer(
    table: Annotated[
        Path,
        typer.Argument(help="columns volts, force_N and, of several occasions, session (a number)"),
    ],
    out: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    of: Annotated[
        str | None, typer.Option(help="load or friction: print only what the rig file takes")
    ] = None,
    weights_rel: Annotated[
        float,
        number_option(
            "--weights-rel",
            "relative standard uncertainty of all weights and the lever in common",
            0,
            0.5,
        ),
    ] = 0.001,
    *,
    reporter: Reporter,
) -> None:
    """Gain and zero of a load cell or friction transducer from dead weights, with their 95 % intervals.

    With --of friction its uncertainty as friction_rel, a key of table uncertainty of the rig file, to which beta of a
    single disk is proportional; with --of load what the load makes of the track's half width, its cube root. The zero
    is taken anew in each test. Exit code 1 where the sessions' gains differ.

    Example: tcdyn transducer weights.csv --out cell.json; tcdyn transducer torque.csv --of friction
    """
    from calibration.transducers import fit_transducer
    from tcdyn.io.read import read_numbers
    from tcdyn.io.write import write_text

    if of is not None:
        check_choice("--of", of, ("load", "friction"))
    check_outputs([table], out=out)
    points = read_numbers(table, ("volts", "force_N"), optional=("session",))
    sessions = [f"{number:g}" for number in points.get("session", [1.0] * len(points["volts"]))]
    line = fit_transducer(points["volts"], points["force_N"], sessions)
    if out is not None:
        write_text(out, dump(line.to_dict()))
    if of is None:
        reporter.json(line.to_dict)
        reporter.text(line.summary())
    else:
        u = line.gain_u_rel(weights_rel)
        said = line.summary().splitlines()
        keys = {"friction_rel": u} if of == "friction" else {"half_width_rel_by_load": u / 3}
        if of == "friction":
            said += [
                "under [uncertainty] of the rig file, in place of the friction_rel that stands there:"
            ]
            lines = [*(f"# {each}" for each in said), f"friction_rel = {u:.3g}"]
        else:
            said += [
                f"half width of the track by the load alone: u {u / 3:.2g} of it (half_width_rel)"
            ]
            lines = [f"# {each}" for each in said]
        reporter.json(lambda: keys)
        reporter.text("\n".join(lines))
    exit_status(table.name, line.findings)


def spot(
    table: Annotated[
        Path,
        typer.Argument(help="columns temperature_degC and flux_W_m2 of a heated spot (figure 8.1)"),
    ],
    disk: Disk = "fast",
    power_rel: Annotated[
        float,
        number_option(
            "--power-rel", "relative uncertainty of all fluxes: heater's power, spot's area", 0, 1
        ),
    ] = 0.02,
    json_: Json = False,
) -> None:
    """The straight line of flux against temperature, as lines for the rig file.

    With them every way to beta takes the running surface's loss as measured, in place of h and the ambient there.

    Example: tcdyn spot spot_fast.csv --disk fast >> rig.toml
    """
    from tcdyn.io.read import read_numbers
    from tcdyn.rig.surface_flux import fit_surface_flux

    points = read_numbers(table, ("temperature_degC", "flux_W_m2"))
    try:
        found = fit_surface_flux(points["temperature_degC"], points["flux_W_m2"], power_rel)
    except InputError as problem:
        raise problem.at(str(table)) from None
    keys = {name: float(f"{value:.6g}") for name, value in asdict(found).items()}
    if json_:
        print(dump(keys), end="")
        return
    print("\n".join([f"[{disk}.surface]", *(f"{name} = {value}" for name, value in keys.items())]))


def chain_rows(chain: ChainRecord) -> pd.DataFrame:
    """Lags, one row a channel, the common lag last."""
    table = chain.table()
    table.loc[len(table)] = ["common", chain.common_lag_s.plain(), chain.common_lag_s.interval, ""]
    return table


def diff_rows(found: RecordDiff, every: bool) -> pd.DataFrame:
    """Changes, one row a quantity."""
    table = found.table if every else found.significant
    formats = {"old": ".4g", "new": ".4g", "change": "+.3g", "u": ".2g", "z": "+.1f", "p": ".2g"}
    shown = table.assign(
        **{name: [format(v, how) for v in table[name]] for name, how in formats.items()}
    )
    shown["significant"] = ["drifted" if yes else "" for yes in table["significant"]]
    return shown.rename(columns={"significant": ""})


def rich_table(rows: pd.DataFrame, title: str = "") -> Table:
    """A table for the terminal: words left, numbers right."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for k, name in enumerate(rows.columns):
        table.add_column(escape(str(name)), justify="left" if k == 0 else "right")
    for row in rows.itertuples(index=False):
        table.add_row(*(escape(str(v)) for v in row))
    return table
