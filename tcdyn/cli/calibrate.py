"""Commands ``tcdyn rig calibrate`` (disk record) and ``tcdyn rig holes`` (cemented junctions).

The calibration is :mod:`tcdyn.workflows.calibrate`, the comparison of holes :mod:`immersion.hole`.
Tests: ``tests/cli/test_calibrate_command.py`` and ``tests/cli/test_hole_command.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tcdyn.cli.common import (
    Disk,
    Reporter,
    RigFile,
    Verbose,
    check_outputs,
    number_option,
    options_from_docstring,
    source_entry,
    stage_progress,
    write_json,
)
from tcdyn.core.errors import InputError
from tcdyn.core.options import number_with_u
from tcdyn.io.endings import JSON, PAGE
from tcdyn.series.options import ReadingOptions


@options_from_docstring
def calibrate(
    disk: Disk,
    immersion: Annotated[list[Path], typer.Option()],
    oven: Path | None = None,
    reading_u_K: Annotated[float | None, number_option(0, 50)] = None,
    out: Path | None = None,
    rig: RigFile = None,
    fluid: list[str] | None = None,
    structure: str = "P2",
    correlation: str = "churchill-chu-laminar",
    report: Path | None = None,
    earlier: list[Path] | None = None,
    verbose: Verbose = False,
    *,
    reading: ReadingOptions,
    reporter: Reporter,
) -> None:
    """Calibrate a disk: static lines from its oven log, dynamics from its plunge logs.

    Example: tcdyn rig calibrate --rig rig.toml --disk fast --oven oven_fast.csv --immersion P1.csv
    --immersion P2.csv --fluid mobil-jet-ii --out fast.disk.json --report fast.html

    Parameters
    ----------
    immersion
        plunge log; repeat for each plunge
    oven
        oven log: one row per steady minute
    reading_u_K
        without an oven log: standard uncertainty of a logged reading [K], such as 0.9 for a
        tolerance of 1.5 K
    out
        record to write (default DISK.disk.json)
    fluid
        mobil-jet-ii, water or a table.csv; once for all plunges, or once for each
    structure
        chain structure: P1 (one lag), P2 (two), P3 (three), P1D or P2D (with a dead time), P2Z
        (with a zero: a slow tail); the others are fitted for comparison
    correlation
        natural convection: mcadams, similarity or churchill-chu-laminar
    report
        HTML certificate to write
    earlier
        earlier record of this disk; the certificate then states the drift
    """
    from tcdyn.rig.record import read_record, write_record
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows import calibrate_disk

    target = out or Path(f"{disk}.disk.json")
    fluids = fluid or ["mobil-jet-ii"]
    read_files = [rig, oven, *immersion, *fluids, *(earlier or [])]
    check_outputs(read_files, reporter.overwrite, out=(target, JSON), report=(report, PAGE))
    earlier_records = [read_record(path) for path in earlier or []]
    for path, record in zip(earlier or [], earlier_records):
        if record.disk != disk:
            raise InputError(
                f"--earlier is a record of another disk ({path}: {record.disk})",
                expected=f"records of the {disk} disk",
            )
    with stage_progress(reporter.is_silent, verbose) as progress:
        run = calibrate_disk(
            load_rig(rig).with_reading(reading),
            disk,
            oven,
            immersion,
            fluids,
            structure=structure,
            correlation=correlation,
            reading_u_K=reading_u_K,
            progress=progress,
        )
    write_record(run.record, target)
    if report is not None:
        from tcdyn.report.certificate import write_certificate

        write_certificate(report, run, earlier_records)
    reporter.json(run.record.to_dict)
    reporter.summary(run.summary())
    reporter.files(record=target, certificate=report)
    reporter.finish(f"{disk} disk", run.findings)


@options_from_docstring
def holes(
    log: Path,
    rig: RigFile = None,
    ideal: list[str] | None = None,
    limit_s: Annotated[float, number_option(0, 100)] = 0.20,
    depth_mm: str = "3+-0.05",
    out: Path | None = None,
    report: Path | None = None,
    *,
    reading: ReadingOptions,
    reporter: Reporter,
) -> None:
    """Compare hole sizes and cements: extra lag of each thermocouple against the clamped ones.

    Example: tcdyn simulate hole --out hole.csv && tcdyn rig holes hole.csv --report hole.html

    Parameters
    ----------
    log
        log of several thermocouples at one depth, some clamped as a reference
    ideal
        name of a clamped channel, without _degC (default: all named ideal_*)
    limit_s
        extra lag in seconds above which a hole is too slow
    depth_mm
        depth of all junctions in mm with its standard uncertainty
    out
        JSON to write
    report
        HTML report to write
    """
    from immersion.hole import compare_holes
    from immersion.plunge_data import with_filled_bath
    from tcdyn.core.findings import messages, unique
    from tcdyn.rig.log import read_log
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows.calibrate import log_findings

    check_outputs([log, rig], reporter.overwrite, out=(out, JSON), report=(report, PAGE))
    depth, depth_u = number_with_u(depth_mm, "depth_mm")
    if not (0 < depth < 100 and depth_u < 100):
        raise InputError(f"--depth-mm is {depth_mm}", expected="above 0 and below 100 mm")
    setup = load_rig(rig).with_reading(reading)
    table = read_log(log, "hole", setup)
    comparison = compare_holes(
        with_filled_bath(table),
        ideal=ideal,
        limit_s=limit_s,
        depth_m=depth * 1e-3,
        depth_u_m=depth_u * 1e-3,
        diffusivity_m2_s=setup.disk_setup("").diffusivity_m2_s,
        where=log.name,
    )
    findings = unique((*log_findings(table, comparison.entry), *comparison.findings))
    content = {**comparison.to_dict(), "warnings": list(messages(findings))}
    content["source"] = source_entry(log)
    if out is not None:
        write_json(out, content)
    if report is not None:
        from functools import partial

        from tcdyn.plots.plunge import draw_holes
        from tcdyn.plots.style import panel_figure
        from tcdyn.report.page import Section, write_page
        from tcdyn.report.sources import log_row
        from tcdyn.report.sources import to_table as made_of

        picture = panel_figure(partial(draw_holes, comparison), height_in=4.5)
        caption = (
            "Dots: readings; lines: the fit. All junctions have the same temperature around them, "
            "so "
            "a curve that lags the clamped ones (ideal) is delayed by its hole and cement."
        )
        sections = [
            Section("Extra lag of each hole", table=comparison.card()),
            Section("The plunge", figure=picture, caption=caption),
        ]
        write_page(
            report,
            f"Holes and cement: {log.name}",
            sections,
            verdict=comparison.summary().replace("\n", "\n\n"),
            findings=findings,
            sources=made_of([log_row(table)]),
            assumptions=[f"all junctions lie {depth:g} +- {depth_u:g} mm deep, at one temperature"],
        )
    reporter.json(lambda: content)
    reporter.summary(comparison.summary())
    reporter.files(numbers=out, report=report)
    reporter.finish(log.name, findings)
