"""``tcdyn follow``: a log compensated row by row while it grows."""

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
    OwnRigFile,
    Told,
    bounded,
    end,
    grouped,
    spare_inputs,
    within,
)
from tcdyn.cli.tables import SensorFiles, TableReading, only_with_records
from tcdyn.core.errors import InputError

if TYPE_CHECKING:
    from tcdyn.workflows.live import Causal


@grouped
def follow(
    log: Annotated[
        Path, typer.Argument(help="EHL log, or immersion log, that grows line by line (CSV)")
    ],
    out: Annotated[
        Path,
        typer.Option(help="output: .csv, a new file unless --state continues it or --overwrite"),
    ],
    record: OptionalRecordFiles = None,
    sensor: SensorFiles = None,
    rig: OwnRigFile = None,
    behind_s: Annotated[
        float,
        typer.Option(
            "--behind-s",
            help="how far behind the smoother works, in seconds; 0.5 is far quieter than 0",
        ),
    ] = 0.0,
    noise_k: Annotated[
        float | None,
        bounded(
            "--noise-K", "noise of a sample [K]; default: measured in the first seconds", 1e-6, 1e3
        ),
    ] = None,
    intensity: Annotated[
        float | None,
        typer.Option(
            help="how suddenly slopes may change [K²/s³]; default 30 on the rig, 3000 for a plunge; lower is quieter, "
            "higher is quicker",
            callback=within(1e-9, 1e12),
        ),
    ] = None,
    learn_s: Annotated[
        float, typer.Option("--learn-s", help="seconds to learn noise and sampling from")
    ] = 5.0,
    idle_s: Annotated[
        float, bounded("--idle-s", "end after so many seconds without growth", 0, 1e6)
    ] = 30.0,
    state: Annotated[
        Path | None,
        typer.Option(help="JSON file to go on from if it exists, and to leave the state in"),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="replace an --out that exists; without it such a file is refused"
        ),
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="HTML page: numbers before use, raw against compensated")
    ] = None,
    *,
    reading: TableReading,
    tell: Told,
) -> None:
    """Compensate a log while it grows, row by row, in bounded memory; Ctrl-C ends it, --state goes on later.

    Example: tcdyn follow D4.csv --record fast.disk.json --record slow.disk.json --out live.csv --behind-s 0.5

    It ends with an error, and keeps all rows so far, when the log is replaced, rotated, truncated or rewritten (a copy
    with the same rows may take its place), and when the output is renamed, deleted or changed by another program.
    Readings outside -273.15 to 3000 degC, and those that no temperature can cause through the lag, count as missing.

    Any other table: tcdyn follow kiln.csv --sensor probe.sensor.json --out live.csv
    """
    from tcdyn.rig.opened_log import records_by_disk
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.sensors import read_sensor
    from tcdyn.workflows.follow import follow as run
    from tcdyn.workflows.live import Settings

    if bool(record) == bool(sensor):
        raise InputError(
            "needs --record or --sensor, one of them",
            remedy="--sensor is for any table, without a rig",
        )
    records: Any = (
        [read_sensor(path) for path in sensor] if sensor else records_by_disk(record or [])
    )
    if sensor:
        only_with_records(
            [option for option, value in (("--rig", rig), ("--report", report)) if value]
        )
    settings = Settings(behind_s, noise_k, intensity, learn_s)
    rig_table = load_rig(rig) if rig else None
    spare_inputs([log, rig, *(record or []), *(sensor or [])], out=out, report=report, state=state)

    def announce(plan: Causal) -> None:
        before = plan.before_use()
        tell.say(f"before use, noisiest channel, {plan.notes()['method']}:")
        tell.say("\n".join(f"  {line}" for line in before.lines()))
        if plan.rows_late:
            late = f"{plan.rows_late * plan.dt_s:.3g} s late"
            tell.say(f"  rows appear {late}, each with the temperatures of its own time_s")
        tell.warn(before.findings)
        tell.say(f"following {log}; Ctrl-C ends it")

    options: Any = reading.options()
    with asked_to_stop() as stop:
        done = run(
            log,
            records,
            out,
            rig_table,
            settings,
            options=options,
            state=state,
            overwrite=overwrite,
            idle_s=idle_s,
            asked_to_stop=stop,
            announce=announce,
        )
    tell.warn(done.findings)
    tell.say(f"{done.summary()} to {out}")
    tell.json(lambda: {**done.to_dict(), "out": out})
    if report is not None and done.plan is not None:
        from tcdyn.report.compensate import write_follow_report

        page = write_follow_report(
            report, done.plan, log, out, done.findings, records, record or ()
        )
        tell.files(report=page)
    end(log.name, done.findings)


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
