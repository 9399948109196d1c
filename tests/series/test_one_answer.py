"""One file, one answer: each command reads the same clock, gaps, readings and reasons from a file.

The corpus states what is true of each file. The frame is tested with reports that are made of this
truth, and with a small reader that uses the package's mechanisms; the commands themselves as soon
as they report what they read (``tcdyn.series.report``).
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.rig.log import read_log
from tcdyn.rig.rigfile import parse_rig
from tcdyn.sensors import compensation, measure, specified_sensor
from tcdyn.sensors.file import SensorFile
from tcdyn.series import clock as clock_module
from tcdyn.series import fit_clock, plausible, updates
from tcdyn.smoothing.inverse import invert
from tests.series.corpus import FILES, CorpusFile, as_rig_log
from tests.series.corpus_logs import START_DEGC, STEP_K
from tests.series.one_answer import (
    FLOWS,
    REFUSED,
    Report,
    answer,
    answers,
    columns_of,
    differences,
    errors,
    flows_for,
)

# Files of the default run: one or two of each kind. Every sixth of the others is an e2e test, the
# rest are long.
QUICK = (
    "samples stray by 10 %",
    "75 Hz in ms",
    "2 Hz in whole seconds",
    "80 rows of 0.1 s",
    "8.0% of the rows twice",
    "1% OVLD",
    "2% 9999.00",
    "readings beyond a thermocouple, each another",
    "a new value every 5 rows",
    "Fahrenheit in the names",
    "batches of twenty, stamps 2 ms apart",
)
MIN_FILES = 90
BY_NAME = {file.name: file for file in FILES}


def quick_or_e2e() -> list[Any]:
    """All files as parameters; those that are not quick are e2e tests, most of them long."""
    slow = [file for file in FILES if file.name not in QUICK]
    marks = {file.name: [pytest.mark.e2e, pytest.mark.long] for file in slow}
    marks |= {file.name: [pytest.mark.e2e] for file in slow[::6]}
    return [pytest.param(file, id=file.name, marks=marks.get(file.name, ())) for file in FILES]


def report_of_truth(file: CorpusFile) -> Report:
    """A report without an error."""
    if file.refused:
        return {REFUSED: file.refused}
    truth = deepcopy(file.truth)
    truth.pop("interval_rtol")
    truth.pop("instant_tolerance_s")
    truth.pop("has_equal_stamps")
    return {
        "samples": 0,
        "rows_lost": 0,
        "repeated_rows": 0,
        "gaps": [],
        **truth,
        "u_interval_s": 0.0,
    }


def read_plainly(file: CorpusFile, path: Path) -> Report:
    """A small reader of a plain table: pandas reads it, the package finds clock and reasons."""
    frame = pd.read_csv(path, na_values=["OVLD"])
    stamps_s = frame[file.time].to_numpy(float)
    clock = fit_clock(stamps_s)
    steps = np.diff(clock.index)
    gaps = [
        {"after_row": int(k) + 1, "start_s": float(stamps_s[k]), "rows": int(steps[k]) - 1}
        for k in np.flatnonzero(steps > 1)
    ]
    columns = {}
    for name in file.columns:
        values = frame[name].to_numpy(float)
        is_code = plausible.dropout_codes(values)
        found = updates.find_updates(np.where(is_code, np.nan, values))
        is_held = np.isfinite(values) & ~is_code & ~found.new
        left_out = {
            reason: {"count": int(flags.sum()), "first_row": int(np.argmax(flags)) + 1}
            for reason, flags in (("code", is_code), ("repeat", is_held))
            if flags.any()
        }
        n_empty = int(np.isnan(values).sum())
        n_readings = int(np.isfinite(values).sum() - is_code.sum() - is_held.sum())
        columns[name] = {
            "unit": "degC",
            "readings": n_readings,
            "empty": n_empty,
            "left_out": left_out,
        }
    return {
        "rows": len(frame),
        "samples": clock.size,
        "interval_s": clock.interval_s,
        "u_interval_s": clock.u_interval_s,
        "rows_lost": clock.n_lost,
        "repeated_rows": clock.n_repeated,
        "gaps": gaps,
        "columns": columns,
    }


def test_the_corpus_has_ninety_files_whose_names_differ() -> None:
    assert len(FILES) >= MIN_FILES
    assert len(BY_NAME) == len(FILES)
    assert set(QUICK) <= set(BY_NAME)


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_what_is_known_of_a_file_is_consistent(file: CorpusFile) -> None:
    truth = file.truth
    for column in truth["columns"].values():
        left_out = sum(reason["count"] for reason in column["left_out"].values())
        assert column["readings"] + column["empty"] + left_out == truth["rows"]
    assert set(truth["columns"]) == set(file.columns)
    if "samples" in truth:
        assert sum(gap["rows"] for gap in truth["gaps"]) == truth["rows_lost"]
        n_samples = truth["rows"] - truth["repeated_rows"] + truth["rows_lost"]
        assert n_samples == truth["samples"]


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_a_file_is_small_and_is_always_written_alike(file: CorpusFile, tmp_path: Path) -> None:
    first = file.write(tmp_path).read_bytes()
    assert file.write(tmp_path).read_bytes() == first
    assert 150 <= file.truth["rows"] <= 1500


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_reports_that_are_true_have_no_difference(file: CorpusFile) -> None:
    reports = {name: report_of_truth(file) for name in flows_for(file)}
    assert differences(reports) == []
    assert [text for name, report in reports.items() for text in errors(file, name, report)] == []


def one_reading_more(report: Report, column: str) -> None:
    report["columns"][column]["readings"] += 1


def another_interval(report: Report, column: str) -> None:
    report["interval_s"] *= 1 + 1e-8


def a_wrong_interval(report: Report, column: str) -> None:
    report["interval_s"] *= 1.01


def another_uncertainty(report: Report, column: str) -> None:
    report["u_interval_s"] += 1e-5 * report["interval_s"]


def one_row_lost_more(report: Report, column: str) -> None:
    report["rows_lost"] += 1


def one_repeated_row_more(report: Report, column: str) -> None:
    report["repeated_rows"] += 1


def a_gap_one_row_later(report: Report, column: str) -> None:
    report["gaps"][0]["after_row"] += 1


def a_gap_less(report: Report, column: str) -> None:
    del report["gaps"][0]


def a_gap_at_another_time(report: Report, column: str) -> None:
    report["gaps"][0]["start_s"] += 10 * report["interval_s"]


def another_reason(report: Report, column: str) -> None:
    left_out = report["columns"][column]["left_out"]
    left_out["range"] = left_out.pop("code")


def another_first_row(report: Report, column: str) -> None:
    report["columns"][column]["left_out"]["code"]["first_row"] += 1


def another_unit(report: Report, column: str) -> None:
    report["columns"][column]["unit"] = "K"


def a_refusal(report: Report, column: str) -> None:
    report.clear()
    report[REFUSED] = "no time column found"


ALTERATIONS: tuple[tuple[Callable[[Report, str], None], str], ...] = (
    (one_reading_more, "2% 9999.00"),
    (another_interval, "rows every 0.25 s"),
    (a_wrong_interval, "rows every 0.25 s"),
    (another_uncertainty, "rows every 0.25 s"),
    (one_row_lost_more, "80 rows of 0.1 s"),
    (one_repeated_row_more, "8.0% of the rows twice"),
    (a_gap_one_row_later, "80 rows of 0.1 s"),
    (a_gap_less, "3, 25 and 60 rows"),
    (a_gap_at_another_time, "80 rows of 0.1 s"),
    (another_reason, "2% 9999.00"),
    (another_first_row, "2% 9999.00"),
    (another_unit, "2% 9999.00"),
    (a_refusal, "75 Hz in ms"),
)
# Smaller than what the maker knows of the interval, or not known to the maker.
UNKNOWN_TO_THE_MAKER = (another_interval, another_uncertainty)


@pytest.mark.parametrize(("alter", "name"), ALTERATIONS, ids=[a.__name__ for a, _ in ALTERATIONS])
@pytest.mark.parametrize("flow", FLOWS)
def test_a_report_that_is_altered_is_a_difference(
    alter: Callable[[Report, str], None], name: str, flow: str
) -> None:
    file = BY_NAME[name]
    reports = {each: report_of_truth(file) for each in FLOWS}
    alter(reports[flow], file.columns[0])
    assert differences(reports)
    if alter not in UNKNOWN_TO_THE_MAKER:
        assert errors(file, flow, reports[flow])


def test_a_command_that_reads_a_file_without_a_clock_is_a_difference() -> None:
    file = BY_NAME["batches of twenty, stamps 2 ms apart"]
    reports = {flow: report_of_truth(file) for flow in FLOWS}
    reports["identify"] = report_of_truth(BY_NAME["rows every 0.25 s"])
    assert differences(reports)
    assert errors(file, "identify", reports["identify"])


def test_a_report_without_a_column_is_an_error() -> None:
    file = BY_NAME["rows every 0.25 s"]
    for flow in FLOWS:
        report = report_of_truth(file)
        del report["columns"][columns_of(file, flow)[-1]]
        assert errors(file, flow, report)


# A name of a mechanism, what disables it, and a file that needs the mechanism.
MECHANISMS = (
    (plausible, "MIN_DIFFERENT_READINGS", 10**9, "1% -127.00"),
    (updates, "MIN_REGULAR_CHANGES", 10**9, "a new value every 5 rows"),
    (clock_module, "fit_coarse", lambda *_: None, "2 Hz in whole seconds"),
)
MECHANISM_NAMES = [attribute for _, attribute, _, _ in MECHANISMS]


@pytest.mark.parametrize(("module", "attribute", "value", "name"), MECHANISMS, ids=MECHANISM_NAMES)
def test_a_mechanism_that_is_changed_for_one_reader_is_a_difference(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    module: Any,
    attribute: str,
    value: Any,
    name: str,
) -> None:
    file = BY_NAME[name]
    path = file.write(tmp_path)
    reports = {"compensate": read_plainly(file, path), "identify": read_plainly(file, path)}
    assert differences(reports) == []
    assert errors(file, "identify", reports["identify"]) == []
    with monkeypatch.context() as patched:
        patched.setattr(module, attribute, value)
        reports["identify"] = read_plainly(file, path)
    assert differences(reports)
    assert errors(file, "identify", reports["identify"])


RIG_NAMES = (
    "rows every 0.25 s",
    "75 Hz in ms",
    "commas in quoted names",
    "Campbell TOA5",
    "kelvin in the names",
    "Fahrenheit in the names",
    "TDMS with stamps, 1 % lost",
    "LVM, tabs",
)


@pytest.mark.parametrize("name", RIG_NAMES)
def test_the_reader_of_the_rig_reads_a_file_by_the_names_in_its_rig_file(
    name: str, tmp_path: Path
) -> None:
    file = BY_NAME[name]
    rig_log = as_rig_log(file, file.write(tmp_path))
    assert rig_log is not None
    rig = parse_rig(tomllib.loads(rig_log.rig), "rig.toml")
    log = read_log(rig_log.path, rig_log.kind, rig)  # type: ignore[arg-type]
    assert len(log.frame) == file.truth["samples"]
    for column in file.columns:
        readings = log.frame[rig_log.columns[column]]
        assert readings.iloc[0] == pytest.approx(START_DEGC, abs=1.0)
        assert readings.iloc[-1] == pytest.approx(START_DEGC + STEP_K, abs=1.0)


def test_the_rig_takes_no_file_that_its_rules_refuse() -> None:
    refused = (
        "80 rows of 0.1 s",
        "sixty in a row",
    )
    assert all(as_rig_log(BY_NAME[name], Path("log.csv")) is None for name in refused)


def inverse_instead_of_smoother(y: Any, dt_s: float, chains: Any, **options: Any) -> Any:
    """A quick method in place of the smoother."""
    names = ("noise_sd", "lag_covariance", "static_u", "names")
    return invert(y, dt_s, chains, 0.1 / dt_s, **{name: options[name] for name in names})


def stated_instead_of_fitted(*data: Any, sensor: str, **_: Any) -> SensorFile:
    """A stated lag in place of a fit; ``data`` ends with the name or names of the columns."""
    columns = [data[-1]] if isinstance(data[-1], str) else list(data[-1])
    return specified_sensor(sensor, columns, [(1.0, 0.1)])


@pytest.fixture
def quick_estimators(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands without their estimators, which begin after the readings are decided."""
    monkeypatch.setattr(compensation, "smooth", inverse_instead_of_smoother)
    monkeypatch.setattr(measure, "plunge_sensor", stated_instead_of_fitted)
    monkeypatch.setattr(measure, "pair_sensor", stated_instead_of_fitted)


@pytest.mark.e2e
@pytest.mark.usefixtures("quick_estimators")
@pytest.mark.parametrize("file", quick_or_e2e())
def test_each_command_reads_the_same_from_a_file(file: CorpusFile, tmp_path: Path) -> None:
    reports = answers(file, tmp_path)
    assert differences(reports) == []
    assert [text for name, report in reports.items() for text in errors(file, name, report)] == []


@pytest.mark.e2e
@pytest.mark.usefixtures("quick_estimators")
@pytest.mark.parametrize(("module", "attribute", "value", "name"), MECHANISMS, ids=MECHANISM_NAMES)
@pytest.mark.parametrize("flow", FLOWS)
def test_a_mechanism_that_is_changed_for_one_command_is_a_difference(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    module: Any,
    attribute: str,
    value: Any,
    name: str,
    flow: str,
) -> None:
    file = BY_NAME[name]
    flows = flows_for(file)
    if flow not in flows:
        pytest.skip("the rig refuses such files")
    reports = answers(file, tmp_path)
    again = tmp_path / "again"
    again.mkdir()
    with monkeypatch.context() as patched:
        patched.setattr(module, attribute, value)
        reports[flow] = answer(flows[flow], file, file.write(again))
    assert errors(file, flow, reports[flow])
    assert differences(reports)
