"""Command ``tcdyn follow``: live compensation of a log while it grows.

The loop is :mod:`tcdyn.workflows.follow`, the filter :mod:`tcdyn.workflows.live`. Tests:
``tests/smoothing/test_follow.py``.
"""

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
    exit_status,
    in_range,
    number_option,
    option_groups,
)
from tcdyn.cli.tables import (
    CsvComments,
    CsvDialect,
    SensorFiles,
    TableReading,
    only_with_records,
)
from tcdyn.core.errors import InputError

if TYPE_CHECKING:
    from tcdyn.workflows.live import LiveCompensator


@option_groups
def follow(
    log: Annotated[
        Path,
        typer.Argument(
            help="EHL log or immersion log that grows line by line, or with --sensor any table "
            "(CSV)"
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="output .csv; must be a new file, unless --state or --overwrite is given"
        ),
    ],
    record: OptionalRecordFiles = None,
    sensor: SensorFiles = None,
    rig: RigFileOrRecords = None,
    behind_s: Annotated[
        float,
        typer.Option(
            "--behind-s",
            help="delay of the fixed-lag smoother in seconds; 0.5 gives much less noise than 0",
        ),
    ] = 0.0,
    noise_k: Annotated[
        float | None,
        number_option(
            "--noise-K", "noise of a sample [K] (default: measured in the first seconds)", 1e-6, 1e3
        ),
    ] = None,
    intensity: Annotated[
        float | None,
        typer.Option(
            help="process-noise intensity of the slope [K²/s³] (default 30 on the rig, 3000 for a "
            "plunge); lower gives less noise, higher responds faster",
            callback=in_range(1e-9, 1e12),
        ),
    ] = None,
    learn_s: Annotated[
        float,
        typer.Option(
            "--learn-s",
            help="length of the first part, from which noise and sampling interval are estimated, "
            "in seconds",
        ),
    ] = 5.0,
    idle_s: Annotated[
        float, number_option("--idle-s", "end after this time without new rows, in seconds", 0, 1e6)
    ] = 30.0,
    state: Annotated[
        Path | None,
        typer.Option(help="JSON file with the state: read if it exists, written at the end"),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="replace --out if it exists; otherwise this is an error"),
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(help="HTML report: properties of the filter, raw and compensated traces"),
    ] = None,
    dialect: CsvDialect = "standard",
    comments: CsvComments = False,
    *,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Compensate a log while it grows, row by row, in bounded memory.

    Ctrl-C ends it; with --state a later run continues.

    Example: tcdyn follow D4.csv --record fast.disk.json --record slow.disk.json --out live.csv
    --behind-s 0.5

    It ends with an error, and keeps all rows written, if the log is replaced, rotated, truncated or
    rewritten (a copy with the same rows is accepted), or if another program renames, deletes or
    changes the output. Readings outside -273.15 to 3000 degC, and readings that no temperature can
    cause through the lag, are treated as missing.

    Any other table: tcdyn follow kiln.csv --sensor probe.sensor.json --out live.csv
    """
    from tcdyn.io.write import DIALECTS
    from tcdyn.rig.opened_log import records_by_disk
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.sensors import read_sensor
    from tcdyn.workflows.follow import follow as run
    from tcdyn.workflows.live import LiveSettings

    if bool(record) == bool(sensor):
        raise InputError(
            "needs either --record or --sensor",
            remedy="--sensor is for any table, without a rig",
        )
    records: Any
    if sensor:
        rig_options = {"--rig": rig, "--report": report}
        only_with_records([option for option, value in rig_options.items() if value])
        records = [read_sensor(path) for path in sensor]
    else:
        records = records_by_disk(record or [])
    check_choice("--dialect", dialect, DIALECTS)
    settings = LiveSettings(behind_s, noise_k, intensity, learn_s)
    rig_table = load_rig(rig) if rig else None
    check_outputs([log, rig, *(record or []), *(sensor or [])], out=out, report=report, state=state)

    def announce(plan: LiveCompensator) -> None:
        """Print the properties of the filter before the first row is written."""
        filter_report = plan.filter_report()
        reporter.text(f"before use, noisiest channel, {plan.notes()['method']}:")
        reporter.text("\n".join(f"  {line}" for line in filter_report.lines()))
        if plan.delay_rows:
            delay_s = plan.delay_rows * plan.dt_s
            reporter.text(
                f"  rows are written {delay_s:.3g} s late, each with the temperatures at its time_s"
            )
        reporter.findings(filter_report.findings)
        reporter.text(f"following {log}; Ctrl-C ends it")

    options: Any = reading.options()
    of_csv: dict[str, Any] = {"dialect": dialect, "comments": comments}
    with _stop_request() as stop:
        done = run(
            log,
            records,
            out,
            rig_table,
            settings,
            options=options,
            state=state,
            overwrite=overwrite,
            **of_csv,
            idle_s=idle_s,
            asked_to_stop=stop,
            announce=announce,
        )
    reporter.findings(done.findings)
    reporter.text(f"{done.summary()} to {out}")
    reporter.json(lambda: {**done.to_dict(), "out": out})
    if report is not None and done.plan is not None:
        from tcdyn.report.compensate import write_follow_report

        page = write_follow_report(
            report, done.plan, log, out, done.findings, records, record or ()
        )
        reporter.files(report=page)
    exit_status(log.name, done.findings)


@contextmanager
def _stop_request() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C or SIGTERM was received.

    The signal does not interrupt at once, so that no line is written in part.
    """
    requested = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield requested.is_set
        return
    signals = (signal.SIGINT, signal.SIGTERM)
    previous = {s: signal.signal(s, lambda *_: requested.set()) for s in signals}
    try:
        yield requested.is_set
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
