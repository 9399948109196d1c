"""Command ``tcdyn follow``: live compensation of a log while it grows."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.cli.common import (
    OptionalRecordFiles,
    Reporter,
    RigFileOrRecords,
    check_choice,
    check_outputs,
    number_option,
    options_from_docstring,
)
from tcdyn.cli.stop_signals import stop_signals
from tcdyn.cli.tables import (
    CsvComments,
    CsvDialect,
    SensorFiles,
    TableReading,
    only_with_records,
)
from tcdyn.core.errors import InputError
from tcdyn.io.endings import CSV, JSON, PAGE

if TYPE_CHECKING:
    from tcdyn.workflows.raw_log import RawLog


@options_from_docstring
def follow(
    log: Path,
    out: Annotated[Path, typer.Option()],
    record: OptionalRecordFiles = None,
    sensor: SensorFiles = None,
    rig: RigFileOrRecords = None,
    delay_s: Annotated[float | None, number_option(0, 1e7)] = None,
    idle_s: Annotated[float, number_option(0, 1e6)] = 30.0,
    state: Path | None = None,
    report: Path | None = None,
    dialect: CsvDialect = "standard",
    comments: CsvComments = False,
    *,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Compensate a log while it grows, in bounded memory, with a fixed delay.

    The rows are those that tcdyn compensate LOG --delay-s gives for the finished log. Ctrl-C ends
    it; with --state a later run continues.

    Example: tcdyn follow D4.csv --record fast.disk.json --record slow.disk.json --out live.csv
    --delay-s 2

    It ends with an error, and keeps all rows written, if the log is replaced, rotated, truncated or
    rewritten (a copy with the same rows is accepted), or if another program renames, deletes or
    changes the output.

    Any other table: tcdyn follow kiln.csv --sensor probe.sensor.json --out live.csv

    Parameters
    ----------
    log
        EHL log or immersion log that grows line by line, or with --sensor any table (CSV)
    out
        output .csv; must be a new file, unless --state or --overwrite is given
    delay_s
        how long after a row it is compensated, with the rows that are there then, in seconds
        (default: two lags, at least 2 s)
    idle_s
        end after this time without new rows, in seconds
    state
        JSON file with the state: read if it exists, written at the end
    report
        HTML report: a channel as logged and compensated, noise and uncertainty
    """
    from tcdyn.io.write import DIALECTS
    from tcdyn.rig.opened_log import records_by_disk
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.sensors import read_sensor
    from tcdyn.workflows.follow import follow as run

    if bool(record) == bool(sensor):
        raise InputError(
            "needs either --record or --sensor",
            remedy="--sensor is for any table, without a rig",
        )
    read_files = [log, rig, *(record or []), *(sensor or [])]
    outputs = {"out": (out, CSV), "report": (report, PAGE), "state": (state, JSON)}
    check_outputs(read_files, True, **outputs)  # with --state it continues
    check_outputs(read_files, reporter.overwrite, report=(report, PAGE))
    records: Any
    if sensor:
        only_with_records({"--rig": rig, "--report": report})
        records = [read_sensor(path) for path in sensor]
    else:
        records = records_by_disk(record or [])
    check_choice("--dialect", dialect, DIALECTS)
    rig_table = load_rig(rig) if rig else None

    def announce(followed: RawLog, delay_s: float) -> None:
        """Print the log, the number of channels and the delay."""
        count = len(followed.channels.units)
        reporter.text(f"following {log}, {count} channels; Ctrl-C ends it")
        reporter.text(f"  rows are written at most {delay_s:.3g} s late")

    options: Any = reading.options()
    of_csv: dict[str, Any] = {"dialect": dialect, "comments": comments}
    with _watch_stop_signals() as stop:
        done = run(
            log,
            records,
            out,
            rig_table,
            delay_s=delay_s,
            options=options,
            state=state,
            overwrite=reporter.overwrite,
            **of_csv,
            idle_s=idle_s,
            asked_to_stop=stop,
            announce=announce,
        )
    reporter.text(f"{done.summary()} to {out}")
    reporter.json(lambda: {**done.to_dict(), "out": out})
    if report is not None and done.log is not None:
        from tcdyn.report.compensate import write_follow_report

        page = write_follow_report(report, done, out, records, record or (), rig_table, options)
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
