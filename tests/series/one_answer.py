"""What each command reads from a file, and where two of them differ.

A report is the dictionary of a ``tcdyn.series.report.SeriesReport``, as it stands under "reading"
with ``--json``; see ``tests.series.corpus_logs.truth_of`` for its entries. A command that refuses a
file has the report ``{"refused": message}``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.identification import from_csv
from tcdyn.rig.log import read_log
from tcdyn.rig.rigfile import parse_rig
from tcdyn.sensors import sensor_from_dip, sensor_from_pair, specified_sensor
from tcdyn.sensors.file import SensorFile
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.series.corpus import CorpusFile, RigLog, as_rig_log
from tests.series.corpus_logs import COARSE_ROWS, COARSE_S, FINE_ROWS, FINE_S

Report = dict[str, Any]
Flow = Callable[[CorpusFile, Path], Report]

REFUSED = "refused"
# What the policy of a flow does not tolerate, although its readings are those of the others: rows
# that were taken too unevenly for an estimator of even samples.
POLICY = {"identify": "is not evenly spaced"}
# Relative difference of two intervals that are the same: rounding of the sums.
SAME_INTERVAL = 1e-9
# Difference of two instants, and of two uncertainties, that are the same, in intervals.
SAME_INSTANT = 1e-6
# Relative standard uncertainty of the stated lags; no reading depends on it.
LAG_U = 0.02
# Delay of ``follow``, in rows: a file is read in several blocks, but not in many, which is slow.
DELAY_ROWS = 200
EXACT = ("rows", "samples", "rows_lost", "repeated_rows")


def sensors_of(file: CorpusFile) -> list[SensorFile]:
    """Sensors with the true lags of both columns."""
    interval_s = file.truth["interval_s"]
    lags_s = (
        max(FINE_S, FINE_ROWS * interval_s),
        max(COARSE_S, COARSE_ROWS * interval_s),
    )
    return [
        specified_sensor(column, [column], [(lag_s, LAG_U * lag_s)])
        for column, lag_s in zip(file.columns, lags_s)
    ]


def comparable(report: Any) -> Report:
    """The entries of a report that are compared; ``report`` is one, its dictionary, or a list."""
    if isinstance(report, list | tuple):
        (report,) = report
    data: Report = report if isinstance(report, dict) else report.to_dict()
    columns = {}
    for name, column in data["columns"].items():
        left_out = {
            reason: {"count": each["count"], "first_row": each["first_row"]}
            for reason, each in column["left_out"].items()
        }
        columns[name] = {
            "unit": column["unit"],
            "readings": column["readings"],
            "empty": column["empty"],
            "left_out": left_out,
        }
    return {**data, "columns": columns}


def read_compensate(file: CorpusFile, path: Path) -> Report:
    """The report of ``tcdyn compensate``."""
    parts: list[pd.DataFrame] = []
    done: Any = compensate_table(path, sensors_of(file), parts.append, **file.options)
    return comparable(done.reading)


def read_follow(file: CorpusFile, path: Path) -> Report:
    """The report of ``tcdyn follow``."""
    out = path.with_name("live.csv")
    options: Any = dict(file.options)
    delay_s = DELAY_ROWS * file.truth["interval_s"]
    done: Any = follow(
        path, sensors_of(file), out, delay_s=delay_s, idle_s=0.0, poll_s=0.0, **options
    )
    return comparable(done.reading)


def read_plunge(file: CorpusFile, path: Path) -> Report:
    """The report of ``tcdyn sensor plunge``, on the fine sensor."""
    done: Any = sensor_from_dip(path, file.columns[0], **file.options)
    return comparable(done.reading)


def read_pair(file: CorpusFile, path: Path) -> Report:
    """The report of ``tcdyn sensor pair``."""
    done: Any = sensor_from_pair(path, list(file.columns), bare=True, **file.options)
    return comparable(done.reading)


def read_identify(file: CorpusFile, path: Path) -> Report:
    """The report of ``tcdyn identify``, with both sensors as outputs."""
    options: Any = file.options
    data: Any = from_csv(path, input=file.input, output=list(file.columns), **options)
    return comparable(data.reading)


def read_rig(file: CorpusFile, path: Path) -> Report:
    """The report of the reader of logs of the rig, with the names of the columns in the file."""
    log = as_rig_log(file, path)
    if log is None:
        raise ValueError(f"the rig refuses such files: {file.name}")
    return report_of_rig_log(log)


def report_of_rig_log(log: RigLog) -> Report:
    """The report of a log of the rig, with the names of its columns in the file."""
    rig = parse_rig(tomllib.loads(log.rig), "rig.toml")
    checked: Any = read_log(log.path, log.kind, rig)  # type: ignore[arg-type]
    return comparable(checked.reading)


FLOWS: dict[str, Flow] = {
    "compensate": read_compensate,
    "follow": read_follow,
    "sensor plunge": read_plunge,
    "sensor pair": read_pair,
    "identify": read_identify,
    "rig": read_rig,
}


def flows_for(file: CorpusFile, flows: Mapping[str, Flow] = FLOWS) -> dict[str, Flow]:
    """The flows that take a file: it grows for ``follow``, and the rig's rules allow its like."""
    chosen = dict(flows)
    if not file.grows:
        chosen.pop("follow", None)
    if as_rig_log(file, Path()) is None:
        chosen.pop("rig", None)
    return chosen


def columns_of(file: CorpusFile, flow: str) -> tuple[str, ...]:
    """The columns that a flow reports on."""
    return file.columns[:1] if flow == "sensor plunge" else file.columns


def answer(flow: Flow, file: CorpusFile, path: Path) -> Report:
    """The report of one flow, or its refusal."""
    try:
        return flow(file, path)
    except InputError as problem:
        return {REFUSED: str(problem)}


def answers(file: CorpusFile, folder: Path, flows: Mapping[str, Flow] = FLOWS) -> dict[str, Report]:
    """The reports of all flows that take a file, which is written into a folder."""
    path = file.write(folder)
    return {name: answer(flow, file, path) for name, flow in flows_for(file, flows).items()}


def differences(reports: Mapping[str, Report]) -> list[str]:
    """Where reports of one file differ.

    Parameters
    ----------
    reports
        Report of each flow, by its name.

    Returns
    -------
    list of str
        One sentence for each difference from the first flow that reads the file; columns that only
        one of two flows reports on are not compared. Empty: one answer.
    """
    read = {name: report for name, report in reports.items() if REFUSED not in report}
    found = []
    if read:
        readers = ", ".join(read)
        found += [
            f"{name} refuses what {readers} read: {report[REFUSED]}"
            for name, report in reports.items()
            if REFUSED in report and not is_policy(name, report)
        ]
    names = list(read)
    for other in names[1:]:
        first = names[0]
        found += _difference(first, read[first], other, read[other])
    return found


def is_policy(flow: str, report: Report) -> bool:
    """Whether a flow refuses what only its policy does not tolerate."""
    return flow in POLICY and POLICY[flow] in report.get(REFUSED, "")


def _difference(first: str, a: Report, second: str, b: Report) -> list[str]:
    """Where two reports differ; ``first`` and ``second`` are the names of their flows."""
    scale_s = a["interval_s"]
    tolerances = {"interval_s": SAME_INTERVAL, "u_interval_s": SAME_INSTANT}
    found = []
    for key in EXACT:
        if a[key] != b[key]:
            found.append(f"{key}: {first} {a[key]}, {second} {b[key]}")
    for key, tolerance in tolerances.items():
        if abs(a[key] - b[key]) > tolerance * scale_s:
            found.append(f"{key}: {first} {a[key]:.10g}, {second} {b[key]:.10g}")
    if not _same_gaps(a["gaps"], b["gaps"], SAME_INSTANT * scale_s):
        found.append(f"gaps: {first} {a['gaps']}, {second} {b['gaps']}")
    for name in a["columns"]:
        if name in b["columns"] and a["columns"][name] != b["columns"][name]:
            one, other = a["columns"][name], b["columns"][name]
            found.append(f"column {name}: {first} {one}, {second} {other}")
    return found


def _same_gaps(a: list[Any], b: list[Any], tolerance_s: float) -> bool:
    """Whether gaps are at the same rows, of the same length, and at the same instants."""
    if [(g["after_row"], g["rows"]) for g in a] != [(g["after_row"], g["rows"]) for g in b]:
        return False
    return all(abs(g["start_s"] - h["start_s"]) <= tolerance_s for g, h in zip(a, b))


def errors(file: CorpusFile, flow: str, report: Report) -> list[str]:
    """Where the report of a flow differs from what the maker of the file knows."""
    truth = file.truth
    if file.refused:
        return [] if REFUSED in report else [f"{flow} reads the file, but {file.refused}"]
    if is_policy(flow, report):
        return []
    if REFUSED in report:
        return [f"{flow} refuses the file: {report[REFUSED]}"]
    found = []
    for key in EXACT:
        if key in truth and report[key] != truth[key]:
            found.append(f"{flow}, {key}: {report[key]}, expected {truth[key]}")
    interval_s = truth["interval_s"]
    if abs(report["interval_s"] - interval_s) > truth["interval_rtol"] * interval_s:
        found.append(f"{flow}, interval_s: {report['interval_s']:.10g}, expected {interval_s:.10g}")
    tolerance_s = truth["instant_tolerance_s"]
    if "gaps" in truth and not _same_gaps(report["gaps"], truth["gaps"], tolerance_s):
        found.append(f"{flow}, gaps: {report['gaps']}, expected {truth['gaps']}")
    for name in columns_of(file, flow):
        given = report["columns"].get(name)
        if given is not None and not given["unit"]:  # the file states none
            given = {**given, "unit": truth["columns"][name]["unit"]}
        if given != truth["columns"][name]:
            found.append(f"{flow}, column {name}: {given}, expected {truth['columns'][name]}")
    return found
