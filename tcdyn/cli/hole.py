"""``tcdyn hole``: how much later cemented thermocouples answer than clamped ones (section 5.4)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calibration.files.write import write_text
from calibration.finding import once, sentences
from calibration.grade import findings_of
from calibration.log import read_log
from calibration.rig import load_rig
from tcdyn.cli.common import Json, Quiet, RigFile, dump, say, spare_inputs, warn, within


def hole(
    log: Annotated[Path, typer.Argument(help="log of several thermocouples at one depth, some clamped as ideal")],
    rig: RigFile = None,
    ideal: Annotated[
        list[str] | None, typer.Option(help="a clamped channel, name without _degC; default all called ideal_*")
    ] = None,
    limit_s: Annotated[
        float, typer.Option("--limit-s", help="extra lag from which a hole is too slow", callback=within(0, 100))
    ] = 0.20,
    depth_mm: Annotated[
        float, typer.Option("--depth-mm", help="depth of all junctions", callback=within(0, 100, ends=False))
    ] = 3.0,
    depth_u_mm: Annotated[
        float, typer.Option("--depth-u-mm", help="its standard uncertainty", callback=within(0, 100))
    ] = 0.05,
    out: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    report: Annotated[Path | None, typer.Option(help="HTML report to write")] = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare hole sizes and cements: extra lag of each thermocouple against the clamped ones, with a verdict.

    Example: tcdyn simulate hole --out hole.csv && tcdyn hole hole.csv --report hole.html
    """
    from tcdyn.pipeline.calibrate import untold
    from tcdyn.plunge.hole import compare_holes
    from tcdyn.plunge.run import bath_filled

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
    noticed = once((*untold(table, found.entry), *findings_of(found)))
    content = {**found.to_dict(), "warnings": list(sentences(noticed))}
    if out is not None:
        write_text(out, dump(content))
    if report is not None:
        from tcdyn.plots.plunge import draw_holes
        from tcdyn.plots.style import figure
        from tcdyn.report.page import Section, write_page

        picture, (ax,) = figure(height_in=4.5)
        draw_holes(found, ax)
        sections = [Section("Extra lag of each hole", table=found.table()), Section("The record", figure=picture)]
        write_page(report, f"Holes and cement: {log.name}", sections, verdict=found.summary(), findings=noticed)
    if json_:
        print(dump(content), end="")
        return
    warn(noticed, quiet)
    say(found.summary(), quiet)
    if out is not None:
        say(f"numbers: {out}", quiet)
    if report is not None:
        say(f"report: {report}", quiet)
