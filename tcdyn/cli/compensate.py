"""``tcdyn compensate``: a logged trace in, the temperature at the junctions out; of a growing log as it grows."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.errors import InputError
from calibration.grade import findings_of
from calibration.log import write_log
from calibration.rig import load_rig
from tcdyn.cli.common import (
    Json,
    OwnRigFile,
    Quiet,
    RecordFiles,
    Verbose,
    counted,
    dump,
    say,
    spare_inputs,
    stages,
    warn,
    within,
)

if TYPE_CHECKING:
    from tcdyn.pipeline.causal import Causal

WITH_FOLLOW = "with --follow: "


def compensate(
    log: Annotated[Path, typer.Argument(help="EHL log, or immersion log (CSV, TDMS, LVM or Parquet)")],
    record: RecordFiles,
    out: Annotated[
        Path | None, typer.Option(help="output: .csv, .parquet or .tdms (default LOG.compensated.csv)")
    ] = None,
    rig: OwnRigFile = None,
    refine: Annotated[
        bool, typer.Option(help="take the lag common to a disk from the log's unloading, the record's as prior")
    ] = True,
    report: Annotated[Path | None, typer.Option(help="HTML page: numbers before use, raw against compensated")] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="follow a growing CSV log and append to --out as it grows; Ctrl-C ends it")
    ] = False,
    method: Annotated[
        str | None,
        typer.Option(help=f"{WITH_FOLLOW}live (a smoother, the default) or inverse (one over the chain, rolled off)"),
    ] = None,
    behind_s: Annotated[
        float | None,
        typer.Option(
            "--behind-s",
            help=f"{WITH_FOLLOW}how far behind the live smoother works, in seconds; default 0, 0.5 is far quieter",
        ),
    ] = None,
    bandwidth_hz: Annotated[
        float | None, typer.Option("--bandwidth-Hz", help=f"{WITH_FOLLOW}bandwidth of the inverse [Hz], default 0.5")
    ] = None,
    noise_k: Annotated[
        float | None,
        typer.Option("--noise-K", help=f"{WITH_FOLLOW}noise of a sample [K]; default: measured in the first seconds"),
    ] = None,
    intensity: Annotated[
        float | None,
        typer.Option(
            help=f"{WITH_FOLLOW}how suddenly slopes may change [K²/s³]; default 30 on the rig, 3000 for a plunge; "
            "lower is quieter, higher is quicker"
        ),
    ] = None,
    learn_s: Annotated[
        float | None,
        typer.Option("--learn-s", help=f"{WITH_FOLLOW}seconds to learn noise and sampling from, default 5"),
    ] = None,
    idle_s: Annotated[
        float | None,
        typer.Option(
            "--idle-s",
            help=f"{WITH_FOLLOW}end after so many seconds without growth, default 30",
            callback=within(0, 1e6),
        ),
    ] = None,
    state: Annotated[
        Path | None, typer.Option(help=f"{WITH_FOLLOW}JSON file to go on from if it exists, and to leave the state in")
    ] = None,
    noise_only: Annotated[
        bool,
        typer.Option(
            "--noise-only",
            help="only smooth curves through each stretch between events (thesis, section 4.2); the lag stays in",
        ),
    ] = False,
    json_: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Undo static errors and lag of every logged thermocouple; a standard deviation stands beside each sample.

    Example: tcdyn compensate D4.csv --record fast.disk.json --record slow.disk.json --out D4.compensated.csv
    Live:    tcdyn compensate D4.csv --record fast.disk.json --record slow.disk.json --out live.csv --follow
    """
    from tcdyn.pipeline import compensate_log
    from tcdyn.pipeline.records import records_by_disk

    only_following = {
        "--method": method, "--behind-s": behind_s, "--bandwidth-Hz": bandwidth_hz, "--noise-K": noise_k,
        "--intensity": intensity, "--learn-s": learn_s, "--idle-s": idle_s, "--state": state,
    }  # fmt: skip
    given = [name for name, value in only_following.items() if value is not None]
    if given and not follow:
        raise InputError(f"{', '.join(given)} without --follow", remedy="add --follow, or leave it out")
    if noise_only and (follow or report is not None):
        raise InputError("--noise-only with --follow or --report", remedy="give one of them")
    if json_ and follow:
        raise InputError("--json with --follow", remedy="the state is in --state FILE, the numbers in --out FILE")
    records = records_by_disk(record)
    rig_table = load_rig(rig) if rig else None
    target = out or log.with_name(f"{log.stem}.compensated.csv")
    spare_inputs([log, rig, *record], out=target, report=report, state=state)
    if follow:
        named = {
            "method": method, "behind_s": behind_s, "bandwidth_Hz": bandwidth_hz, "noise_K": noise_k,
            "intensity_K2_s3": intensity, "learn_s": learn_s,
        }  # fmt: skip
        _follow(log, records, target, rig_table, named, state, 30.0 if idle_s is None else idle_s, report, quiet)
        return
    if noise_only:
        _noise_only(log, records, target, rig_table, json_, quiet)
        return
    with stages(quiet or json_, verbose) as progress:
        done = compensate_log(log, records, rig_table, refine=refine, progress=progress)
        progress("writing")
        written = write_log(done.frame, target, done.metadata)
        if report is not None:
            from tcdyn.report.compensate import write_compensation_report

            progress("report")
            write_compensation_report(report, done, records)
    if json_:
        print(dump({**done.to_dict(), "out": written, "report": report}), end="")
        return
    warn(findings_of(done), quiet)
    for disk in done.disks:
        say(f"{disk}: common lag {done.metadata[f'{disk}_common_lag_s']}", quiet)
    say(f"compensated: {written}", quiet)
    if report is not None:
        say(f"report: {report}", quiet)


def _noise_only(log: Path, records: Any, out: Path, rig: Any, json_: bool, quiet: bool) -> None:
    from tcdyn.pipeline.denoise import denoise_log

    with counted(None, quiet or json_) as progress:
        done = denoise_log(log, records, rig, progress=progress)
    written = write_log(done.frame, out, done.metadata)
    if json_:
        print(dump({**done.to_dict(), "out": written}), end="")
        return
    warn(findings_of(done), quiet)
    say("\n".join(line for line in done.summary().splitlines() if not line.startswith("warning: ")), quiet)
    say(f"without noise, lag left in: {written}", quiet)


def _follow(
    log: Path,
    records: Any,
    out: Path,
    rig: Any,
    named: dict[str, Any],
    state: Path | None,
    idle_s: float,
    report: Path | None,
    quiet: bool,
) -> None:
    from tcdyn.pipeline.causal import Settings
    from tcdyn.pipeline.follow import follow

    settings = Settings(**{k: v for k, v in named.items() if v is not None})

    def announce(plan: Causal) -> None:
        if quiet:
            return
        before = plan.before_use()
        say(f"before use, noisiest channel, {plan.notes()['method']}:")
        say("\n".join(f"  {line}" for line in before.summary().splitlines() if line not in before.warnings))
        if plan.rows_late:
            say(f"  rows appear {plan.rows_late * plan.dt_s:.3g} s late, each with the temperatures of its own time_s")
        warn(findings_of(before))
        say(f"following {log}; Ctrl-C ends it")

    with asked_to_stop() as stop:
        done = follow(
            log, records, out, rig, settings, state=state, idle_s=idle_s, asked_to_stop=stop, announce=announce
        )
    warn(findings_of(done), quiet)
    say(f"{done.ended}: {done.rows_read} rows read, {done.rows_written} written to {out}", quiet)
    if report is not None and done.plan is not None:
        from tcdyn.report.compensate import write_follow_report

        say(f"report: {write_follow_report(report, done.plan, log, out, findings_of(done))}", quiet)


@contextmanager
def asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C (or SIGTERM) has come: it is noted, not obeyed at once, so that no line is cut in two."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return
    before = {s: signal.signal(s, lambda *_: asked.set()) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
