"""``tcdyn rig`` and ``tcdyn transducer``: the rig file, and the load cells that it is used with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calibration.files import read_numbers
from calibration.files.write import write_text
from calibration.lines.transducers import fit_transducer
from calibration.rig import load_rig, rig_toml
from tcdyn.cli.common import Json, Quiet, dump, say, spare_inputs


def rig(
    show: Annotated[bool, typer.Option("--show", help="print the rig file, every key with its value")] = True,
    file: Annotated[Path | None, typer.Option("--rig", help="rig.toml to check; without it the defaults")] = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check a rig file and print every key with the value in force.

    Example: tcdyn rig --show > rig.toml writes a file to start from; tcdyn rig --rig rig.toml checks it.
    """
    found = load_rig(file)
    text = dump(found.to_dict()) if json_ else rig_toml(found)
    if show and not quiet:
        print(text, end="")


def transducer(
    table: Annotated[Path, typer.Argument(help="columns volts, force_N and, of several occasions, session (a number)")],
    out: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Gain and zero of a load cell or friction transducer from dead weights, with their uncertainties.

    Example: tcdyn transducer weights.csv --out cell.json
    """
    spare_inputs([table], out=out)
    points = read_numbers(table, ("volts", "force_N"), optional=("session",))
    sessions = [f"{number:g}" for number in points.get("session", [1.0] * len(points["volts"]))]
    line = fit_transducer(points["volts"], points["force_N"], sessions)
    if out is not None:
        write_text(out, dump(line.to_dict()))
    say(dump(line.to_dict()).rstrip() if json_ else line.summary(), quiet)
