"""``tcdyn compensate``: a logged trace in, the temperature at the junctions out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calibration.logs import write_log
from calibration.rigfile import load_rig
from tcdyn.cli.common import Quiet, RecordFiles, RigFile, say, stages, warn


def compensate(
    log: Annotated[Path, typer.Argument(help="EHL log (CSV, TDMS, LVM or Parquet)")],
    record: RecordFiles,
    out: Annotated[Path | None, typer.Option(help="output (default LOG.compensated.csv)")] = None,
    rig: RigFile = None,
    refine: Annotated[
        bool, typer.Option(help="take the lag common to a disk from the log's unloading, the record's as prior")
    ] = True,
    quiet: Quiet = False,
) -> None:
    """Undo static errors and lag of every logged thermocouple; a standard deviation stands beside each sample.

    Example: tcdyn compensate D4.csv --record fast.disk.json --record slow.disk.json --out D4.compensated.csv
    """
    from tcdyn.pipeline import compensate_log
    from tcdyn.pipeline.records import records_by_disk

    records = records_by_disk(record)
    with stages(quiet) as progress:
        done = compensate_log(log, records, load_rig(rig) if rig else None, refine=refine, progress=progress)
        progress("writing")
        target = write_log(done.frame, out or log.with_name(f"{log.stem}.compensated.csv"), done.metadata)
    warn(done.warnings, quiet)
    for disk in done.disks:
        say(f"{disk}: common lag {done.metadata[f'{disk}_common_lag_s']}", quiet)
    say(f"compensated: {target}", quiet)
