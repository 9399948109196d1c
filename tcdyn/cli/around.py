"""``tcdyn round``: the temperature round the disks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.rig import load_rig
from tcdyn.cli.common import Json, Quiet, dump, say, spare_inputs, within
from tcdyn.cli.simulate import RigPath, Seed, Uneven, contacts
from tcdyn.simulate.ehl import EhlOptions
from tcdyn.simulate.truth import draw_truth

PICTURES = (".png", ".svg", ".pdf")

app = typer.Typer(
    name="round",
    help="The temperature round the disks.",
    no_args_is_help=True,
    add_completion=False,
)


@app.callback()
def round_() -> None:
    """The temperature round the disks."""


@app.command("simulate")
def simulate_round(
    out: Annotated[Path, typer.Option(help="picture to write: .png, .svg or .pdf")],
    test: Annotated[str, typer.Option(help="A1 to D4 (table 6.1)")] = "B3",
    seed: Seed = 0,
    beta: Annotated[float | None, typer.Option(help="heat partition; drawn without it", callback=within(0, 1))] = None,
    uneven: Uneven = None,
    rig: RigPath = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """The synthetic disks in (r, z, angle) at the end of the load, drawn from bore to running surface.

    `tcdyn beta --report` draws the same of a measured test.

    Example: tcdyn round simulate --out disks.png --test D4 --uneven slow:0.5@30
    """
    from tcdyn.plots.around import draw_round, draw_round_surface
    from tcdyn.plots.style import figure
    from tcdyn.simulate.field import around_disks

    if out.suffix.lower() not in PICTURES:
        raise InputError(f"--out is {out}", expected=f"a name ending in {', '.join(PICTURES)}")
    spare_inputs([rig], out=out)
    truth = draw_truth(seed, load_rig(rig)).with_uneven(contacts(uneven))
    disks = around_disks(test, seed, truth, EhlOptions(beta=beta))
    picture, axes = figure(2, 2, width_in=10.0, height_in=6.4)
    for d, whole, surface in zip(DISKS, axes[:2], axes[2:]):
        draw_round(disks[d], whole)
        draw_round_surface(disks[d], surface)
    picture.savefig(out, dpi=150)
    told = {d: {"surface_degC": _ends(disks[d].surface_degC), "seen_degC": disks[d].seen_degC} for d in DISKS}
    if json_:
        print(dump({"picture": out, **told}), end="")
        return
    for d in DISKS:
        low, high = told[d]["surface_degC"]
        say(f"{d} disk: running surface {low:.1f} to {high:.1f} degC round the shaft", quiet)
    say(f"picture: {out}", quiet)


def _ends(x: np.ndarray) -> tuple[float, float]:
    return float(x.min()), float(x.max())
