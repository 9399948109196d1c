"""``tcdyn inspect``: what is understood of a table, with the refusals of all other commands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

import tcdyn as package
from tcdyn.core.errors import InputError
from tcdyn.plots.inspect import MAX_PANELS, inspection_figure
from tcdyn.series.reading import CODE, EMPTY, READING
from tests.cli.test_main_job import tcdyn

N = 400


def table() -> pd.DataFrame:
    """A log with codes, words, empty cells, repeated values, lost and repeated rows, and notes."""
    k = np.arange(N)
    noise = np.random.default_rng(3).normal(0, 0.05, (5, N))
    frame = pd.DataFrame({"time_s": 0.5 * k})
    frame["T1_degC"] = np.round(40 + 0.05 * k + noise[0], 2)
    frame["T2 [degF]"] = np.round(100 + 0.05 * k + noise[1], 2)
    frame["T3"] = np.round(40 + 0.05 * k + noise[2], 2)
    frame["flow [l/min]"] = np.round(3 + noise[3], 3)
    slow = np.round(40 + 0.05 * k + noise[4], 2)
    frame["T5_degC"] = slow[k - k % 8]
    frame.loc[[50, 90, 130], "T1_degC"] = 9.9e37
    frame["T2 [degF]"] = frame["T2 [degF]"].astype(object)
    frame.loc[200:219, "T2 [degF]"] = "OVLD"
    frame.loc[300:309, "T3"] = np.nan
    frame["note"] = np.where(k < 100, "warm-up", "run")
    return frame.drop(index=[*range(240, 260), 350])


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    table().to_csv(path, index=False)
    return path


def inspected(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    """The JSON of the command."""
    capsys.readouterr()
    assert tcdyn("inspect", *words, "--json") == 0
    content: dict[str, Any] = json.loads(capsys.readouterr().out)
    return content


def test_rows_clock_and_gaps_are_those_of_the_table(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = inspected(capsys, log)
    reading = content["reading"]
    assert reading["rows"] == N - 21
    assert reading["samples"] == N
    assert reading["interval_s"] == pytest.approx(0.5)
    assert content["rate_Hz"] == pytest.approx(2.0)
    assert reading["duration_s"] == pytest.approx(0.5 * (N - 1))
    assert reading["rows_lost"] == 21
    gaps = [(gap["after_row"], gap["rows"]) for gap in reading["gaps"]]
    assert gaps == [(240, 20), (330, 1)]
    assert content["source"]["file"] == "log.csv"


def test_each_column_says_what_was_left_out_and_why(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = inspected(capsys, log)
    columns = content["reading"]["columns"]
    assert list(columns) == ["T1_degC", "T2 [degF]", "T3", "flow [l/min]", "T5_degC"]
    codes = columns["T1_degC"]["left_out"]["code"]
    assert codes == {"count": 3, "first_row": 51, "example": 9.9e37}
    words = columns["T2 [degF]"]["left_out"]["word"]
    assert (words["count"], words["example"]) == (20, "OVLD")
    assert columns["T3"]["empty"] == 10
    assert columns["T5_degC"]["left_out"]["repeat"]["count"] > 0.8 * N
    assert columns["T5_degC"]["interval_s"] == pytest.approx(4.0, rel=0.1)
    units = {name: column["unit"] for name, column in columns.items()}
    assert units["T2 [degF]"] == "degF"
    assert units["flow [l/min]"] == "l/min"
    kinds = {name: column["kind"] for name, column in columns.items()}
    assert kinds["T3"] == "temperature"
    assert kinds["flow [l/min]"] == "quantity"
    assert content["unit_assumed"] == ["T3"]
    assert content["other_columns"] == {"note": {"content": "text", "example": "warm-up"}}


def test_the_summary_says_it_in_words(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tcdyn("inspect", log) == 0
    printed = capsys.readouterr()
    for text in (
        "379 rows in 199.5 s, one every 0.5 s (2 Hz)",
        "gaps: 21 sample(s) have no row, at 2 place(s)",
        "after row 240 (119.5 s): 20 sample(s), 10 s",
        "T1_degC: 3 overload or drop-out codes, first in row 51: 9.9e+37",
        "degC (assumed)",
        "other columns: note (text)",
    ):
        assert text in printed.out
    assert "info: log.csv: column T3 states no unit: read as degrees Celsius" in printed.err


def test_columns_can_be_chosen_by_patterns(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = inspected(capsys, log, "--column", "T?", "--column", "flow*")
    assert "T3" in content["reading"]["columns"]
    assert content["other_columns"] == {}
    assert tcdyn("inspect", log, "--column", "T9") == 2
    assert tcdyn("inspect", log, "--column", "note") == 2
    assert "holds text" in capsys.readouterr().err


def test_units_and_millivolts_are_declared_as_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    k = np.arange(N)
    frame = pd.DataFrame({"time_s": 0.5 * k, "A_mV": 4.0 + 0.001 * k, "p [bar]": 2.0 + 0.01 * k})
    path = tmp_path / "mv.csv"
    frame.to_csv(path, index=False)
    columns = inspected(capsys, path)["reading"]["columns"]
    assert columns["A_mV"]["kind"] == "quantity"
    columns = inspected(capsys, path, "--couple", "K")["reading"]["columns"]
    assert columns["A_mV"]["kind"] == "temperature"
    assert tcdyn("inspect", path, "--unit", "A=mV") == 2
    assert "--couple K" in capsys.readouterr().err


def test_a_row_of_units_that_are_no_temperatures_is_no_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "units.csv"
    rows = [f"{0.5 * k},{40 + 0.01 * k:.2f},{3 + 0.01 * (k % 7):.2f}" for k in range(N)]
    path.write_text("\n".join(["time,T1,I", "s,°F,A", *rows, ""]), encoding="utf-8")
    columns = inspected(capsys, path)["reading"]["columns"]
    assert columns["T1"]["unit"] == "degF"
    assert (columns["I"]["unit"], columns["I"]["kind"]) == ("A", "quantity")


def refused() -> dict[str, pd.DataFrame]:
    """Tables that the other commands refuse."""
    k = np.arange(N)
    y = 20 + 40 * -np.expm1(-np.maximum(k - 50, 0) / 20) + 0.01 * (k % 7)
    parts = [
        pd.DataFrame({"time_s": k, "Channel": name, "T_degC": shift + y})
        for name, shift in (("CH1", 0.0), ("CH2", 7.0))
    ]
    return {
        "long": pd.concat(parts).sort_values("time_s", kind="stable"),
        "scaled": pd.DataFrame({"time_s": k, "T_degC": np.rint(1000 * y).astype(int)}),
        "no time": pd.DataFrame({"T_degC": y, "T2_degC": y[::-1]}),
        "backward": pd.DataFrame({"time_s": np.where(k == 200, 0, k), "T_degC": y}),
    }


@pytest.mark.parametrize("name", refused())
def test_a_table_that_others_refuse_gets_the_same_message(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.csv"
    refused()[name].to_csv(path, index=False)
    said = {}
    for command in (["inspect"], ["sensor", "plunge"]):
        assert tcdyn(*command, path, "--column", "T_degC") == 2
        said[command[0]] = capsys.readouterr().err
    assert said["inspect"] == said["sensor"]
    assert tcdyn("inspect", path) == 2
    with pytest.raises(InputError):
        package.inspect(path)


def test_frames_and_files_give_the_same(log: Path) -> None:
    of_file = package.inspect(log)
    frame = pd.read_csv(log)
    frame["T2 [degF]"] = pd.to_numeric(frame["T2 [degF]"], errors="coerce")
    of_frame = package.inspect(frame)
    assert of_frame.reading.interval_s == of_file.reading.interval_s
    assert of_frame.reading.rows_lost == of_file.reading.rows_lost
    by_name = {column.name: column for column in of_file.columns}
    reasons = by_name["T1_degC"].reasons
    assert np.flatnonzero(reasons == CODE).tolist() == [50, 90, 130]
    assert np.count_nonzero(by_name["T3"].reasons == EMPTY) == 10
    assert np.count_nonzero(reasons == READING) == of_file.reading.columns[0].readings
    assert all(len(each.values) == of_file.reading.rows for each in of_file.columns)
    counts = of_file.to_frame()
    assert counts.loc["T1_degC", "code"] == 3
    assert counts.loc["T2 [degF]", "word"] == 20


def test_a_long_table_is_looked_at_part_by_part_and_kept_whole() -> None:
    rows = 300_000
    k = np.arange(rows)
    y = np.round(20 + np.sin(1e-4 * k) + np.random.default_rng(1).normal(0, 0.05, rows), 3)
    y[[10, 150_000, 299_000]] = 9.9e37
    found = package.inspect(pd.Series(y, pd.Index(0.1 * k, name="time_s"), name="T1_degC"))
    assert found.reading.rows == rows == len(found.columns[0].reasons)
    assert found.reading.columns[0].left_out[0].count == 3
    assert np.flatnonzero(found.columns[0].reasons == CODE).tolist() == [10, 150_000, 299_000]


def test_one_row_is_refused_by_its_number(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("time_s,T_degC\n0,20\n", encoding="utf-8")
    with pytest.raises(InputError, match="only 1 row"):
        package.inspect(tmp_path / "one.csv")


@pytest.mark.parametrize("count", [1, 12, MAX_PANELS + 3])
def test_the_picture_has_a_panel_for_each_column_with_gaps_and_marks(count: int) -> None:
    source = table()
    frame = source[["time_s"]].copy()
    for n in range(count):
        frame[f"T{n}_degC"] = source["T1_degC"] + n
    figure = inspection_figure(package.inspect(frame))
    panels: list[Axes] = figure.axes
    assert len(panels) == min(count, MAX_PANELS)
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert set(entries) == {"readings", "code of the logger", "no rows"}
    low, high = panels[0].get_ylim()
    assert high - low < 100  # codes do not set the limits
    marks = next(line for line in panels[0].lines if line.get_label() == "code of the logger")
    assert len(marks.get_xdata()) == 3  # type: ignore[arg-type]


def test_the_command_writes_the_picture(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = log.with_suffix(".png")
    assert tcdyn("inspect", log, "--picture", picture) == 0
    assert f"picture: {picture}" in capsys.readouterr().out
    assert picture.stat().st_size > 10_000
    assert tcdyn("inspect", log, "--picture", log) == 2
