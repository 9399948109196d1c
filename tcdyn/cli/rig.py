"""``tcdyn rig``: show every key of a rig file with the value in force."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calibration.rigfile import load_rig, rig_toml


def rig(
    show: Annotated[bool, typer.Option("--show", help="print the rig file, every key with its value")] = True,
    file: Annotated[Path | None, typer.Option("--rig", help="rig.toml to check; without it the defaults")] = None,
) -> None:
    """Check a rig file and print every key with the value in force.

    `tcdyn rig --show > rig.toml` writes a file to start from.
    """
    text = rig_toml(load_rig(file))
    if show:
        print(text, end="")
