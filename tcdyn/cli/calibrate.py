"""``tcdyn calibrate``: oven and plunge logs to a disk record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calibration.record import write_record
from calibration.rig import load_rig
from tcdyn.cli.common import Json, Quiet, RigFile, Verbose, say, spare_inputs, stages, warn


def calibrate(
    disk: Annotated[str, typer.Option(help="fast or slow")],
    oven: Annotated[Path, typer.Option(help="oven log: one row per steady minute")],
    immersion: Annotated[list[Path], typer.Option(help="plunge log; give it once for each plunge")],
    out: Annotated[Path | None, typer.Option(help="record to write (default DISK.disk.json)")] = None,
    rig: RigFile = None,
    fluid: Annotated[
        list[str] | None,
        typer.Option(help="mobil-jet-ii, water or a table.csv; once for all plunges or once for each"),
    ] = None,
    structure: Annotated[
        str,
        typer.Option(
            help="P1 (one lag), P2 (two), P3 (three), P1D or P2D (and a dead time) or P2Z (and a zero: a slow tail); "
            "the others are tried, too"
        ),
    ] = "P2",
    correlation: Annotated[
        str, typer.Option(help="natural convection: mcadams, similarity or churchill-chu-laminar")
    ] = "churchill-chu-laminar",
    report: Annotated[Path | None, typer.Option(help="HTML certificate to write")] = None,
    json_: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Calibrate a disk: static lines from its oven log, measurement chain from its plunges.

    Example: tcdyn calibrate --rig rig.toml --disk fast --oven oven_fast.csv --immersion P1.csv --immersion P2.csv
    --fluid mobil-jet-ii --out fast.disk.json --report fast.html
    """
    from tcdyn.pipeline import calibrate_disk

    target, fluids = out or Path(f"{disk}.disk.json"), fluid or ["mobil-jet-ii"]
    spare_inputs([rig, oven, *immersion, *fluids], out=target, report=report)
    with stages(quiet or json_, verbose) as progress:
        run = calibrate_disk(
            load_rig(rig), disk, oven, immersion, fluids, structure=structure,
            correlation=correlation, progress=progress,
        )  # fmt: skip
    write_record(run.record, target)
    if report is not None:
        from tcdyn.report.certificate import write_certificate

        write_certificate(report, run)
    if json_:
        print(run.record.to_json(), end="")
        return
    warn(run.findings, quiet)
    say(run.summary(), quiet)
    say(f"record: {target}" + (f"\ncertificate: {report}" if report else ""), quiet)
