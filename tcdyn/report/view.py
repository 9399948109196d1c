"""The page of ``tcdyn view``: every trace of a log, as logged and compensated.

Traces are decimated for the screen (:func:`tcdyn.plots.style.screen_rows`). Test:
``tests/report/test_view.py``.
"""

from __future__ import annotations

import webbrowser
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tcdyn.core.arguments import as_names, check_type, described, with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding
from tcdyn.core.options import options_of
from tcdyn.core.progress import Progress, no_progress
from tcdyn.io.endings import PAGE, check_ending
from tcdyn.io.read import sha256_of_file
from tcdyn.io.unit_names import TEMPERATURES, unit_in, written_unit
from tcdyn.plots.compensate import axis_label, draw_traces
from tcdyn.plots.style import panel_figure
from tcdyn.report.page import Section, write_page
from tcdyn.report.sources import to_table
from tcdyn.rig.opened_log import rig_from_records
from tcdyn.rig.rigfile import Rig
from tcdyn.series import open_source
from tcdyn.series.joined import files_of_log
from tcdyn.series.long_tables import check_one_channel
from tcdyn.series.read import read_all
from tcdyn.series.units import match_columns
from tcdyn.workflows.compensate import compensate_log
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.options import LogOptions
from tcdyn.workflows.raw_log import Given, calibrations_of, open_log_table, raw_log
from tcdyn.workflows.traces import Trace, compensated_traces

MAX_POINTS = 150_000  # of all lines of a page: about 2 MB of it; measured


@with_named_arguments
def view(
    log: str | Path | Sequence[str | Path],
    calibrations: Given = (),
    *,
    rig: Rig | None = None,
    out: str | Path | None = None,
    open_browser: bool = True,
    progress: Progress = no_progress,
    **reading: Any,
) -> tuple[Path, tuple[Finding, ...]]:
    """Write a page with the traces of a log, raw and compensated, and open it in the browser.

    Parameters
    ----------
    log
        A log of the rig, or any table with a column of time; several files of one log in any order.
    calibrations
        Records by disk, or sensors as for :func:`tcdyn.compensate_frame`; without them all columns
        are shown as logged.
    rig
        The rig; None: that of the records.
    out
        Page to write; by default ``<log>.view.html`` beside the log.
    open_browser
        Whether to open the page in the browser.
    progress
        Called with the name of each stage.
    **reading
        How the table is read: the fields of :class:`tcdyn.workflows.options.LogOptions`.

    Returns
    -------
    page, findings
        The page, and the findings of the compensation.

    Raises
    ------
    InputError
        For a log that cannot be read or compensated, and for an output that is no page by its name.

    Examples
    --------
    >>> import tcdyn, tempfile
    >>> from tcdyn.sensors import SensorFile
    >>> folder = Path(tempfile.mkdtemp())
    >>> t = np.arange(0.0, 60.0, 0.5)
    >>> rows = np.column_stack([t, 20 + 5 * np.sin(0.2 * t)])
    >>> np.savetxt(folder / "kiln.csv", rows, delimiter=",", header="time_s,T_degC", comments="")
    >>> page, findings = tcdyn.view(folder / "kiln.csv", open_browser=False)
    >>> page.name
    'kiln.view.html'
    """
    options = options_of(LogOptions, reading, "view")
    check_type("out", out, (str, Path, type(None)), "the path of the page, .html")
    used = calibrations_of(calibrations)
    files = files_of_log(log)
    if not files:
        raise InputError(f"log is {described(log)}", expected="a file, or several files of one log")
    path = files[0]
    page = Path(out) if out is not None else path.with_name(f"{path.stem}.view.html")
    check_ending(page, PAGE)
    findings: tuple[Finding, ...] = ()
    if used:
        with TemporaryDirectory() as folder:
            compensated = Path(folder) / "compensated.parquet"
            if isinstance(used, Mapping):
                rig = rig or rig_from_records(used)
                if options.rows.stated:
                    rig = rig.with_reading(options.rows)
                done = compensate_log(files, used, rig, progress=progress)
                _, findings = done.write(compensated, progress)
            else:
                table = compensate_table(files, used, compensated, progress=progress, **reading)
                findings = table.findings
            opened = open_log_table(files, used, rig, options)
            raw = raw_log(path, opened, used, rig, options)
            traces = compensated_traces(raw, compensated)
    else:
        traces = _logged_traces(files, options)
    progress("writing the page")
    limit = MAX_POINTS // (3 * max(len(traces), 1))
    panels: dict[str, list[Trace]] = {}
    for trace in traces:
        panels.setdefault(_panel_key(trace), []).append(trace)
    sections = [_traces_section(traces_of_panel, limit) for traces_of_panel in panels.values()]
    content = "as logged and compensated" if used else "as logged"
    title = path.name if len(files) == 1 else f"{path.name} and {len(files) - 1} more"
    rows = max((len(trace.time_s) for trace in traces), default=0)
    content_of_file = f"{rows} rows" if len(files) == 1 else f"one of {len(files)} files"
    write_page(
        page,
        f"{title}: {content}",
        sections,
        verdict=f"{rows:,} rows. A line has at most {limit:,} points here; its extremes are kept. "
        "A click on an entry of the legend hides it, a double click shows it alone.",
        findings=findings,
        sources=to_table(
            [("log", file.name, content_of_file, sha256_of_file(file)) for file in files]
        ),
    )
    if open_browser:
        webbrowser.open(page.resolve().as_uri())
    return page, findings


def _logged_traces(files: Sequence[Path], options: LogOptions) -> list[Trace]:
    """Return all columns of numbers of a table in one file or several."""
    source = open_source(files, (), options.rows)
    names = source.value_columns
    asked = as_names("columns", options.columns, source.table.where)
    if asked:
        matches = [match_columns(each, names, source.table.where) for each in asked]
        names = list(dict.fromkeys(name for columns in matches for name in columns))
    check_one_channel(source.table, source.time, names if asked else None)
    time_s, columns, _ = read_all(source, names)
    none = np.empty(0)
    traces = []
    for name in names:
        values = columns[name]
        if values.dtype != object:
            below_header = source.table.units.get(name, "")
            unit = unit_in(name) or written_unit(below_header) or below_header
            traces.append(Trace(name, unit, "", time_s, values, none, none, none))
    return traces


def _panel_key(trace: Trace) -> str:
    """Return what the traces of one figure share: disk and unit, or the end of the name."""
    return f"{trace.group} {trace.unit or trace.name.rpartition('_')[2]}"


def _traces_section(traces: Sequence[Trace], limit: int) -> Section:
    """Return the section of traces of one disk and unit."""
    names = ", ".join(trace.name for trace in traces)
    first = traces[0]
    title = names
    y = names
    if first.unit:
        y = axis_label(first)
    if first.unit in TEMPERATURES:
        title = f"{first.group} disk" if first.group else "Temperatures"
    draw = partial(draw_traces, traces, y, limit=limit)
    return Section(title, figure=panel_figure(draw, height_in=5.0))
