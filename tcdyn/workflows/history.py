"""The history of a lag from logs: each is measured on its own.

Used by ``tcdyn sensor history --method``. Tests: ``tests/sensors/test_history.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError, Spelling, as_argument
from tcdyn.core.findings import Finding, warning
from tcdyn.sensors.file import read_sensor
from tcdyn.sensors.history import SensorHistory, sensor_history
from tcdyn.sensors.history_options import HistoryOptions
from tcdyn.workflows.each import SENSOR_ENDING, EachRun, FileProgress, outputs_of, sensor_each


@with_named_arguments
def history_of_logs(
    files: Sequence[str | Path],
    method: Literal["plunge", "noise"],
    column: str | None = None,
    *,
    dates: Sequence[str] = (),
    workers: int = 1,
    spelling: Spelling = as_argument,
    progress: FileProgress = lambda *_: None,
    **options: Any,
) -> SensorHistory:
    """Measure the lag of one sensor from each of several logs, and compare by date.

    Parameters
    ----------
    files
        The logs, at least two.
    method
        "plunge": each holds one dip; "noise": each was logged at constant conditions.
    column
        Column of the sensor; None: the only one.
    dates
        Date of each log; none: that of its first row.
    workers, spelling, progress
        As for :func:`tcdyn.workflows.each.each_file`.
    **options
        As of :func:`tcdyn.sensor_from_dip` or :func:`tcdyn.sensor_from_noise`.

    Returns
    -------
    SensorHistory
        A log that cannot be used is left out with a warning.

    Raises
    ------
    InputError
        As ``sensor_history``, and for fewer than two logs that can be used.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from tcdyn.chain import Chain
    >>> fluid, t = np.random.default_rng(1).normal(0, 5, 10000), 0.1 * np.arange(10000)
    >>> dates = ["2025-01-01", "2025-06-01", "2025-12-01"]
    >>> with TemporaryDirectory() as folder:
    ...     files = [Path(folder, f"{lag_s}.csv") for lag_s in (1.0, 1.2, 1.4)]
    ...     for file in files:
    ...         logged = Chain(float(file.stem)).response(fluid, 0.1)
    ...         pd.DataFrame({"time_s": t, "T1": logged}).to_csv(file, index=False)
    ...     history = history_of_logs(files, "noise", dates=dates)
    >>> history.groups[0].change.total.value > 0.2
    True
    """
    _check_dates(files, HistoryOptions(column=column, dates=dates))
    with TemporaryDirectory() as folder:
        run = sensor_each(
            files,
            method,
            column,
            folder,
            workers=workers,
            spelling=spelling,
            progress=progress,
            **options,
        )
        paths = outputs_of(files, SENSOR_ENDING, folder)
        used = [index for index, outcome in enumerate(run.outcomes) if not outcome.error]
        sensors = [read_sensor(paths[index]) for index in used]
    failed = _findings_of(run)
    if len(used) < 2:
        problem = f"; {run.failed[0].error}" if run.failed else ""
        raise InputError(f"{len(used)} of {len(files)} logs can be used{problem}")
    history = sensor_history(
        sensors,
        files=[run.outcomes[index].file.name for index in used],
        column=sensors[0].columns[0],
        dates=[dates[index] for index in used] if dates else (),
    )
    return replace(history, findings=(*failed, *history.findings))


def _check_dates(files: Sequence[str | Path], chosen: HistoryOptions) -> None:
    """Raise InputError for fewer than two logs, and for another number of dates, before any work.

    Parameters
    ----------
    files
        The logs.
    chosen
        The dates that are given.
    """
    if len(files) < 2:
        raise InputError(
            f"{len(files)} logs", expected="at least two, one for each date", remedy="add others"
        )
    count = len(chosen.given_dates)
    if count and count != len(files):
        raise InputError(
            f"{{dates}} is given {count} times for {len(files)} logs",
            expected="once for each, in their order, or not at all",
            parameters={"dates": None},
        )


def _findings_of(run: EachRun) -> list[Finding]:
    """A warning for each log that could not be used."""
    return [
        warning("history.failed", subject=each.file.name, problem=each.error) for each in run.failed
    ]
