"""Commands ``tcdyn rig calibrate`` (disk record) and ``tcdyn rig holes`` (cemented junctions).

The calibration is :mod:`tcdyn.workflows.calibrate`, the comparison of holes :mod:`immersion.hole`.
Tests: ``tests/cli/test_calibrate_command.py`` and ``tests/cli/test_hole_command.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tcdyn.cli.common import (
    Disk,
    OutFile,
    Reporter,
    RigFile,
    Verbose,
    check_outputs,
    options_from_docstring,
    source_entry,
    stage_progress,
    write_json,
)
from tcdyn.core.errors import InputError
from tcdyn.core.options import NumberWithU, Options, number_with_u, option
from tcdyn.io.endings import JSON, PAGE
from tcdyn.series.options import ReadingOptions
from tcdyn.workflows.rig_options import CalibrateOptions

if TYPE_CHECKING:
    from tcdyn.rig.record import DiskRecord

# Depths [mm] below this are no mistake: a disk is some 10 mm wide.
DEEPEST_MM = 100.0


@options_from_docstring
def calibrate(
    disk: Disk,
    immersion: Annotated[list[Path], typer.Option(rich_help_panel="Input")],
    oven: Annotated[Path | None, typer.Option(rich_help_panel="Input")] = None,
    fluid: Annotated[list[str] | None, typer.Option(rich_help_panel="Input")] = None,
    rig: RigFile = None,
    out: OutFile = None,
    report: OutFile = None,
    earlier: Annotated[list[Path] | None, typer.Option(rich_help_panel="Output")] = None,
    verbose: Verbose = False,
    *,
    options: CalibrateOptions,
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
    fluid
        mobil-jet-ii (default), water or a table.csv; once for all plunges, or once for each
    out
        record to write (default DISK.disk.json)
    report
        HTML certificate to write
    earlier
        earlier record of this disk; the certificate then states the drift
    """
    from tcdyn.rig.record import write_record
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows import calibrate_disk

    target = out or Path(f"{disk}.disk.json")
    fluids = fluid or ["mobil-jet-ii"]
    read_files = [rig, oven, *immersion, *fluids, *(earlier or [])]
    check_outputs(read_files, reporter.overwrite, out=(target, JSON), report=(report, PAGE))
    earlier_records = _earlier_records(earlier or [], disk)
    rig_settings = load_rig(rig).with_reading(reading)
    with stage_progress(reporter.is_silent, verbose) as progress:
        run = calibrate_disk(
            rig_settings, disk, oven, immersion, fluids, progress=progress, **options.stated
        )
    write_record(run.record, target)
    if report is not None:
        from tcdyn.report.certificate import write_certificate

        write_certificate(report, run, earlier_records)
    reporter.json(run.record.to_dict)
    reporter.summary(run.summary())
    reporter.files(record=target, certificate=report)
    reporter.finish(f"{disk} disk", run.findings)


def _earlier_records(files: Sequence[Path], disk: str) -> list[DiskRecord]:
    """Read earlier records of a disk.

    Raises
    ------
    InputError
        For a record of another disk.
    """
    from tcdyn.rig.record import read_record

    records = [read_record(path) for path in files]
    for path, record in zip(files, records):
        if record.disk != disk:
            raise InputError(
                f"--earlier is a record of another disk ({path}: {record.disk})",
                expected=f"records of the {disk} disk",
            )
    return records


@dataclass(frozen=True)
class HoleOptions(Options):
    """How holes and cements are compared.

    Attributes
    ----------
    ideal
        name of a clamped channel, without _degC (default: all named ideal_*)
    limit_s
        extra lag in seconds above which a hole is too slow
    depth_mm
        depth of all junctions in mm with its standard uncertainty
    """

    ideal: Sequence[str] = option((), "Input", takes=list[str])
    limit_s: float = option(0.20, "Advanced", low=0, high=100)
    depth_mm: NumberWithU = option("3+-0.05", "Advanced", takes=str)

    @property
    def depth_and_u_mm(self) -> tuple[float, float]:
        """Depth of all junctions and its standard uncertainty [mm].

        Raises
        ------
        InputError
            For a depth that is not positive or that no disk has.
        """
        depth, u = number_with_u(self.depth_mm, "depth_mm")
        if not (0 < depth < DEEPEST_MM and u < DEEPEST_MM):
            raise InputError(
                f"{{depth_mm}} is {self.depth_mm}",
                expected=f"above 0 and below {DEEPEST_MM:g} mm",
                parameters={"depth_mm": None},
            )
        return depth, u


@options_from_docstring
def holes(
    log: Path,
    rig: RigFile = None,
    out: OutFile = None,
    report: OutFile = None,
    *,
    options: HoleOptions,
    reading: ReadingOptions,
    reporter: Reporter,
) -> None:
    """Compare hole sizes and cements: extra lag of each thermocouple against the clamped ones.

    Example: tcdyn simulate hole --out hole.csv && tcdyn rig holes hole.csv --report hole.html

    Parameters
    ----------
    log
        log of several thermocouples at one depth, some clamped as a reference
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
    depth_mm, depth_u_mm = options.depth_and_u_mm
    setup = load_rig(rig).with_reading(reading)
    table = read_log(log, "hole", setup)
    comparison = compare_holes(
        with_filled_bath(table),
        ideal=options.ideal or None,
        limit_s=options.limit_s,
        depth_m=depth_mm * 1e-3,
        depth_u_m=depth_u_mm * 1e-3,
        diffusivity_m2_s=setup.disk_setup("").diffusivity_m2_s,
        where=log.name,
    )
    findings = unique((*log_findings(table, comparison.entry), *comparison.findings))
    content = {**comparison.to_dict(), "warnings": list(messages(findings))}
    content["source"] = source_entry(log)
    if out is not None:
        write_json(out, content)
    if report is not None:
        from tcdyn.report.holes import write_holes_report

        write_holes_report(report, comparison, table, (depth_mm, depth_u_mm), findings)
    reporter.json(lambda: content)
    reporter.summary(comparison.summary())
    reporter.files(numbers=out, report=report)
    reporter.finish(log.name, findings)
