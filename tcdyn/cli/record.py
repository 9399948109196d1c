"""Commands ``tcdyn rig record``, ``rig check``, ``rig transducer`` and ``rig line``.

Records are :mod:`tcdyn.rig.record`, their comparison :mod:`calibration.compare`, transducers
:mod:`calibration.transducers`. Tests: ``tests/cli/test_records_and_rig.py`` and
``tests/rig/test_record.py``.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tcdyn.cli.common import (
    Disk,
    OutFile,
    Reporter,
    check_outputs,
    options_from_docstring,
    source_entry,
    write_json,
)
from tcdyn.core.errors import InputError, printable
from tcdyn.core.findings import messages, unique
from tcdyn.core.options import Options, option
from tcdyn.io.endings import JSON

app = typer.Typer(
    name="record",
    help="Show, compare and check the records of calibrated disks.",
    no_args_is_help=True,
    add_completion=False,
)

if TYPE_CHECKING:
    import pandas as pd

    from calibration.transducers import TransducerLine
    from tcdyn.rig.record import ChainRecord, DiskRecord

RecordPath = Annotated[Path, typer.Argument(help="*.disk.json")]


@app.command()
@options_from_docstring
def show(record: RecordPath, *, reporter: Reporter) -> None:
    """Print a record: static lines, lags, and the files it was made from.

    Example: tcdyn rig record show fast.disk.json
    """
    from tcdyn.rig.record import read_record

    content = read_record(record)
    reporter.json(content.to_dict)
    if not reporter.is_silent:
        _show(content)
    reporter.finish(record.name, content.findings)


def _show(record: DiskRecord) -> None:
    """Print a record as text."""
    from tcdyn.rig.static_line import lines_table

    console = Console()
    _print_line(console, f"disk {record.disk}, made {record.created_text}")
    lines = lines_table(record.static).set_axis(
        ["ch", "gain", "offset degC", "range degC", "u mid K", "sd K"], axis=1
    )
    console.print(rich_table(lines, "Static lines (u at mid-range, sd of residuals)"))
    if record.chain is not None:
        console.print(rich_table(_chain_rows(record.chain), f"Chain ({record.chain.structure})"))
    for item in record.inputs:
        _print_line(console, f"from {item.file}  sha256 {item.sha256[:16]}...")


def _print_line(console: Console, text: str) -> None:
    """Print a text from a file as it is, with control characters escaped."""
    console.print(printable(text), markup=False, highlight=False)


@app.command()
@options_from_docstring
def diff(
    old: RecordPath,
    new: RecordPath,
    every: Annotated[bool, typer.Option("--all", rich_help_panel="Output")] = False,
    *,
    reporter: Reporter,
) -> None:
    """List what drifted significantly between two calibrations of one disk (5 %, Holm).

    Example: tcdyn rig record diff fast.2026.disk.json fast.disk.json

    Parameters
    ----------
    every
        also list what did not drift
    """
    from calibration.compare import compare_records
    from tcdyn.rig.record import read_record

    console = Console()
    difference = compare_records(read_record(old), read_record(new))
    reporter.json(difference.to_dict)
    if reporter.is_silent:
        return
    rows = difference.table if every else difference.significant
    if len(rows):
        console.print(rich_table(_diff_rows(rows)))
    _print_line(console, difference.sentence())
    for note in difference.notes:
        _print_line(console, f"info: {note}")


@app.command()
@options_from_docstring
def check(record: RecordPath, *, reporter: Reporter) -> None:
    """Check a record: exit code 2 if it is damaged; warnings are listed.

    Example: tcdyn rig record check fast.disk.json
    """
    from calibration.compare import check_record
    from tcdyn.rig.record import read_record

    findings = unique(check_record(read_record(record)))
    reporter.json(lambda: {"sound": not findings, "doubts": messages(findings)})
    if findings:
        reporter.text(f"The record is readable; {len(findings)} warning(s).")
    else:
        reporter.text("The record is sound.")
    reporter.finish(record.name, findings)


@options_from_docstring
def check_rig(
    file: Annotated[Path | None, typer.Argument()] = None,
    *,
    reporter: Reporter,
) -> None:
    """Check a rig file and print every key with its value.

    Example: tcdyn rig check > rig.toml writes a file to start with; tcdyn rig check rig.toml
    checks it.

    Parameters
    ----------
    file
        rig.toml to check (default: the default values)
    """
    from tcdyn.rig.rigfile import load_rig, rig_toml

    settings = load_rig(file)
    reporter.json(settings.to_dict)
    reporter.text(rig_toml(settings).rstrip())


@dataclass(frozen=True)
class TransducerOptions(Options):
    """Options for the dead weights of a transducer.

    Attributes
    ----------
    quantity
        load or friction: print only the lines for the rig file
    weight_u_rel
        relative standard uncertainty common to all weights, and of the lever
    """

    quantity: str | None = option(None, "Output", choices=("load", "friction"))
    weight_u_rel: float = option(0.001, "Input", low=0, high=0.5)


@options_from_docstring
def transducer(
    table: Path,
    out: OutFile = None,
    *,
    options: TransducerOptions,
    reporter: Reporter,
) -> None:
    """Determine gain and zero of a load cell or friction transducer from dead weights.

    Both are printed with their 95 % intervals.

    --quantity friction prints the uncertainty as friction_rel, a key of table uncertainty of the
    rig file; beta of a single disk is proportional to the friction. --quantity load prints the
    relative uncertainty of the half width of the track, one third of that of the load (half width ~
    load^(1/3)). The zero is determined again in each test. A warning reports gains that differ
    between the sessions.

    Example: tcdyn rig transducer weights.csv --out cell.json; tcdyn rig transducer torque.csv
    --quantity friction

    Parameters
    ----------
    table
        table with the columns volts, force_N and, for several sessions, session (a number)
    out
        JSON to write
    """
    from calibration.transducers import fit_transducer
    from tcdyn.io.read import read_numbers

    check_outputs([table], reporter.overwrite, out=(out, JSON))
    points = read_numbers(table, ("volts", "force_N"), optional=("session",))
    sessions = [f"{number:g}" for number in points.get("session", [1.0] * len(points["volts"]))]
    line = fit_transducer(points["volts"], points["force_N"], sessions)
    if out is not None:
        write_json(out, line.to_dict() | {"source": source_entry(table)})
    if options.quantity is None:
        reporter.json(line.to_dict)
        reporter.summary(line.summary())
    else:
        keys, lines = _lines_for_rig_file(line, options.quantity, options.weight_u_rel)
        reporter.json(lambda: keys)
        reporter.text("\n".join(lines))
    reporter.finish(table.name, line.findings)


def _lines_for_rig_file(
    line: TransducerLine, quantity: str, weight_u_rel: float
) -> tuple[dict[str, float], list[str]]:
    """What the line of a transducer is in the rig file.

    Parameters
    ----------
    line
        Line of the transducer.
    quantity
        "load" or "friction".
    weight_u_rel
        Relative standard uncertainty common to all weights.

    Returns
    -------
    keys
        Numbers by name.
    lines
        Lines of text, comments first.
    """
    u = line.gain_u_rel(weight_u_rel)
    comments = line.summary().splitlines()
    if quantity == "friction":
        comments.append("under [uncertainty] of the rig file, instead of its friction_rel:")
        lines = [f"# {comment}" for comment in comments]
        return {"friction_rel": u}, [*lines, f"friction_rel = {u:.3g}"]
    comments.append(
        f"half width of the track by the load alone: u {u / 3:.2g} of it (half_width_rel)"
    )
    return {"half_width_rel_by_load": u / 3}, [f"# {comment}" for comment in comments]


@dataclass(frozen=True)
class FluxOptions(Options):
    """Options for the heated spot.

    Attributes
    ----------
    flux_u_rel
        relative uncertainty common to all fluxes: power of the heater, area of the spot
    """

    flux_u_rel: float = option(0.02, "Input", low=0, high=1)


@options_from_docstring
def line(
    table: Path,
    disk: Disk = "fast",
    *,
    options: FluxOptions,
    reporter: Reporter,
) -> None:
    """Fit a straight line of flux against temperature, printed as lines for the rig file.

    With these lines all estimates of beta use the measured heat loss of the running surface instead
    of h and the ambient temperature there.

    Example: tcdyn rig line spot_fast.csv --disk fast >> rig.toml

    Parameters
    ----------
    table
        table with the columns temperature_degC and flux_W_m2 of a heated spot (figure 8.1)
    """
    from tcdyn.io.read import read_numbers
    from tcdyn.rig.tables import fit_surface_flux

    points = read_numbers(table, ("temperature_degC", "flux_W_m2"))
    try:
        flux = fit_surface_flux(points["temperature_degC"], points["flux_W_m2"], options.flux_u_rel)
    except InputError as problem:
        raise problem.at(str(table)) from None
    keys = {name: float(f"{value:.6g}") for name, value in asdict(flux).items()}
    reporter.json(lambda: keys)
    lines = [f"{name} = {value}" for name, value in keys.items()]
    reporter.text("\n".join([f"[{disk}.surface]", *lines]))


def _chain_rows(chain: ChainRecord) -> pd.DataFrame:
    """Lags, one row for each channel, the common lag last."""
    table = chain.table()
    table.loc[len(table)] = [
        "common",
        chain.common_lag_s.text_without_interval(),
        chain.common_lag_s.interval_text,
        "",
    ]
    return table


def _diff_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """Changes as text, one row for each quantity."""
    formats = {"old": ".4g", "new": ".4g", "change": "+.3g", "u": ".2g", "z": "+.1f", "p": ".2g"}
    texts = rows.assign(
        **{name: [format(value, style) for value in rows[name]] for name, style in formats.items()}
    )
    texts["significant"] = ["drifted" if yes else "" for yes in rows["significant"]]
    return texts.rename(columns={"significant": ""})


def rich_table(rows: pd.DataFrame, title: str = "") -> Table:
    """Table for the terminal: the first column aligned left, the others right.

    Parameters
    ----------
    rows
        Table with texts or numbers.
    title
        Title above it.
    """
    table = Table(title=_cell(title), title_justify="left")
    for k, name in enumerate(rows.columns):
        table.add_column(_cell(name), justify="left" if k == 0 else "right")
    for row in rows.itertuples(index=False):
        table.add_row(*(_cell(value) for value in row))
    return table


def _cell(value: object) -> str:
    """A value as text of a table, without control characters and markup."""
    return escape(printable(str(value)))
