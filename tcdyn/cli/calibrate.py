"""Plunge logs: ``tcdyn calibrate`` to a disk record, ``tcdyn hole`` to how much later cemented junctions answer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tcdyn.cli.common import (
    Disk,
    RigFile,
    Told,
    Verbose,
    bounded,
    dump,
    end,
    grouped,
    spare_inputs,
    stages,
)
from tcdyn.core.errors import InputError


@grouped
def calibrate(
    disk: Disk,
    immersion: Annotated[list[Path], typer.Option(help="plunge log; give it once for each plunge")],
    oven: Annotated[Path | None, typer.Option(help="oven log: one row per steady minute")] = None,
    line_u_k: Annotated[
        float | None,
        bounded(
            "--line-u-K",
            "without an oven log: standard uncertainty of a reading as it was logged, such as 0.9 for a tolerance "
            "of 1.5 K",
            0,
            50,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="record to write (default DISK.disk.json)")
    ] = None,
    rig: RigFile = None,
    fluid: Annotated[
        list[str] | None,
        typer.Option(
            help="mobil-jet-ii, water or a table.csv; once for all plunges or once for each"
        ),
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
    earlier: Annotated[
        list[Path] | None,
        typer.Option(help="earlier record of this disk, for its drift on the certificate"),
    ] = None,
    verbose: Verbose = False,
    *,
    tell: Told,
) -> None:
    """Calibrate a disk: static lines from its oven log, measurement chain from its plunges.

    Example: tcdyn calibrate --rig rig.toml --disk fast --oven oven_fast.csv --immersion P1.csv --immersion P2.csv
    --fluid mobil-jet-ii --out fast.disk.json --report fast.html
    """
    from tcdyn.rig.record import read_record, write_record
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows import calibrate_disk

    target = out or Path(f"{disk}.disk.json")
    fluids = fluid or ["mobil-jet-ii"]
    spare_inputs([rig, oven, *immersion, *fluids, *(earlier or [])], out=target, report=report)
    before = [read_record(path) for path in earlier or []]
    if other := [f"{path}: {r.disk}" for path, r in zip(earlier or [], before) if r.disk != disk]:
        raise InputError(
            f"--earlier is a record of another disk ({other[0]})",
            expected=f"records of the {disk} disk",
        )
    with stages(tell.silent, verbose) as progress:
        run = calibrate_disk(
            load_rig(rig),
            disk,
            oven,
            immersion,
            fluids,
            structure=structure,
            correlation=correlation,
            line_u_K=line_u_k,
            progress=progress,
        )
    write_record(run.record, target)
    if report is not None:
        from tcdyn.report.certificate import write_certificate

        write_certificate(report, run, before)
    tell.json(run.record.to_dict)
    tell.warn(run.findings)
    tell.say(run.summary())
    tell.files(record=target, certificate=report)
    end(f"the {disk} disk", run.findings)


@grouped
def hole(
    log: Annotated[
        Path,
        typer.Argument(help="log of several thermocouples at one depth, some clamped as ideal"),
    ],
    rig: RigFile = None,
    ideal: Annotated[
        list[str] | None,
        typer.Option(help="a clamped channel, name without _degC; default all called ideal_*"),
    ] = None,
    limit_s: Annotated[
        float, bounded("--limit-s", "extra lag from which a hole is too slow", 0, 100)
    ] = 0.20,
    depth_mm: Annotated[
        float, bounded("--depth-mm", "depth of all junctions", 0, 100, ends=False)
    ] = 3.0,
    depth_u_mm: Annotated[
        float, bounded("--depth-u-mm", "its standard uncertainty", 0, 100)
    ] = 0.05,
    out: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    report: Annotated[Path | None, typer.Option(help="HTML report to write")] = None,
    *,
    tell: Told,
) -> None:
    """Compare hole sizes and cements: extra lag of each thermocouple against the clamped ones, with a verdict.

    Example: tcdyn simulate hole --out hole.csv && tcdyn hole hole.csv --report hole.html
    """
    from immersion.hole import compare_holes
    from immersion.plunge_data import bath_filled
    from tcdyn.core.findings import messages, unique
    from tcdyn.io.write import write_text
    from tcdyn.rig.log import read_log
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows.calibrate import untold

    spare_inputs([log, rig], out=out, report=report)
    setup = load_rig(rig)
    table = read_log(log, "hole", setup)
    found = compare_holes(
        bath_filled(table),
        ideal=ideal,
        limit_s=limit_s,
        depth_m=depth_mm * 1e-3,
        depth_u_m=depth_u_mm * 1e-3,
        diffusivity_m2_s=setup.disk_setup("").diffusivity_m2_s,
        where=log.name,
    )
    noticed = unique((*untold(table, found.entry), *found.findings))
    content = {**found.to_dict(), "warnings": list(messages(noticed))}
    if out is not None:
        write_text(out, dump(content))
    if report is not None:
        from functools import partial

        from tcdyn.plots.plunge import draw_holes
        from tcdyn.plots.style import pictured
        from tcdyn.report.page import Section, write_page
        from tcdyn.report.sources import log_row
        from tcdyn.report.sources import table as made_of

        picture = pictured(partial(draw_holes, found), height_in=4.5)
        told = (
            "Dots: readings; lines: the fit. Every junction sees one temperature, so a curve that runs behind the "
            "clamped ones (ideal) is late by its hole and cement."
        )
        sections = [
            Section("Extra lag of each hole", table=found.card()),
            Section("The plunge: whose curve is late?", figure=picture, caption=told),
        ]
        write_page(
            report,
            f"Holes and cement: {log.name}",
            sections,
            verdict=found.summary().replace("\n", "\n\n"),
            findings=noticed,
            sources=made_of([log_row(table)]),
            assumptions=[
                f"all junctions lie {depth_mm:g} +- {depth_u_mm:g} mm deep and see one temperature"
            ],
        )
    tell.json(lambda: content)
    tell.warn(noticed)
    tell.say(found.summary())
    tell.files(numbers=out, report=report)
    end(log.name, noticed)
