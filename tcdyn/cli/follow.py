"""Command ``tcdyn follow``: live compensation of a log while it grows."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.cli.common import Reporter, check_outputs, options_from_docstring
from tcdyn.cli.stop_signals import stop_signals
from tcdyn.cli.tables import CalibrationFiles, refuse_with_sensor
from tcdyn.io.endings import CSV, JSON, PAGE
from tcdyn.workflows.options import FollowOptions

if TYPE_CHECKING:
    from tcdyn.workflows.raw_log import RawLog

BEHIND = (
    "  the log grows faster than its rows are compensated: {rows} rows wait; a longer delay or "
    "fewer columns need less time"
)
OptionalOutput = Annotated[Path | None, typer.Option(rich_help_panel="Output")]


@options_from_docstring
def follow(
    log: Path,
    out: Annotated[Path, typer.Option(rich_help_panel="Output")],
    state: OptionalOutput = None,
    report: OptionalOutput = None,
    *,
    files: CalibrationFiles,
    options: FollowOptions,
    reporter: Reporter,
) -> None:
    """Compensate a log while it grows, in bounded memory, with a fixed delay.

    The rows are those that tcdyn compensate LOG --delay-s gives for the finished log. Ctrl-C ends
    it; with --state a later run continues.

    Example: tcdyn follow kiln.csv --sensor probe.sensor.json --out live.csv --delay-s 20

    It ends with an error, and keeps all rows written, if the log is replaced, rotated, truncated or
    rewritten (a copy with the same rows is accepted), or if another program renames, deletes or
    changes the output.

    A log of the rig: tcdyn follow D4.csv --record fast.disk.json --record slow.disk.json --out
    live.csv

    Parameters
    ----------
    log
        table (CSV) with a column of time, or log of the rig, that grows line by line
    out
        output .csv; must be a new file, unless --state or --overwrite is given
    state
        JSON file with the state: read if it exists, written at the end
    report
        HTML report of a log of the rig: a channel as logged and compensated, noise and uncertainty
    """
    from tcdyn.workflows.follow import follow as run

    files.check_given()
    outputs = {"out": (out, CSV), "report": (report, PAGE), "state": (state, JSON)}
    check_outputs([log, *files.files], True, **outputs)  # with --state it continues
    check_outputs([log, *files.files], reporter.overwrite, report=(report, PAGE))
    calibrations: Any
    if files.sensor:
        refuse_with_sensor(["report"] if report else [])
        calibrations = files.sensors()
    else:
        calibrations = files.records()
    rig = files.rig_settings() if files.rig else None

    def announce(followed: RawLog, delay_s: float) -> None:
        """Print the log, the number of channels and the delay."""
        count = len(followed.channels.units)
        reporter.text(f"following {log}, {count} channels; Ctrl-C ends it")
        reporter.text(f"  rows are written at most {delay_s:.3g} s late")

    with _watch_stop_signals() as stop:
        done = run(
            log,
            calibrations,
            out,
            rig,
            state=state,
            overwrite=reporter.overwrite,
            asked_to_stop=stop,
            announce=announce,
            falls_behind=lambda rows: reporter.text(BEHIND.format(rows=rows)),
            **options.stated,
        )
    reporter.text(f"{done.summary()} to {out}")
    reporter.json(lambda: {**done.to_dict(), "out": out})
    if report is not None and done.log is not None:
        from tcdyn.report.compensate import write_follow_report

        page = write_follow_report(report, done, out, calibrations, files.record, rig, options)
        reporter.files(report=page)
    reporter.finish(log.name, done.findings)


@contextmanager
def _watch_stop_signals() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether a signal to stop was received.

    The signal does not interrupt at once, so that no line is written in part. One that is ignored,
    as SIGHUP under ``nohup``, stays ignored.
    """
    requested = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield requested.is_set
        return
    previous = {}
    for number in stop_signals():
        if signal.getsignal(number) is not signal.SIG_IGN:
            previous[number] = signal.signal(number, lambda *_: requested.set())
    try:
        yield requested.is_set
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
