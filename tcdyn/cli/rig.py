"""``tcdyn rig``: show every key of a rig file with the value in force."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calibration.rig import load_rig, rig_toml
from tcdyn.cli.common import Json, Quiet, dump


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
