"""Dates whose fields stand between dots, in each order; clocks that are not the time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table
from tcdyn.io.stamps import Stamps
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source

FORMS = ["%y.%m.%d %H:%M:%S", "%m.%d.%y %H:%M:%S", "%d.%m.%y %H:%M:%S", "%d.%m.%Y %H:%M:%S"]
ACROSS_MIDNIGHT = pd.date_range("2023-03-07 22:00:00", periods=24, freq="600s")


def seconds_of(texts: list[str]) -> list[float]:
    return [float(x) for x in Stamps("time", "log.csv").seconds(texts)]


def codes_of(texts: list[str], folder: Path) -> set[str]:
    path = folder / "log.csv"
    rows = [f"{text};{20 + 0.1 * k}" for k, text in enumerate(texts)]
    path.write_text("\n".join(["Date Time;T1", *rows, ""]), encoding="utf-8")
    _, _, findings = read_columns(open_source(path), ["T1"])
    return {finding.code for finding in findings}


@pytest.mark.parametrize("form", [*FORMS, "%y/%m/%d %H:%M", "%y.%m.%d %I:%M:%S %p"])
@pytest.mark.parametrize("rows_of_chunk", [1, 5, 24])
def test_the_step_over_midnight_decides_the_order(form: str, rows_of_chunk: int) -> None:
    texts = [when.strftime(form) for when in ACROSS_MIDNIGHT]
    stamps = Stamps("time", "log.csv")
    parts = [
        stamps.seconds(texts[k : k + rows_of_chunk]) for k in range(0, len(texts), rows_of_chunk)
    ]
    assert np.concatenate(parts) == pytest.approx(600.0 * np.arange(24))
    assert stamps.assumed == ("", "")


@pytest.mark.parametrize("form", FORMS)
def test_one_midnight_decides_also_if_days_are_missing(form: str) -> None:
    first = pd.date_range("2023-03-07 22:00:00", periods=24, freq="600s")
    moments = [*first, *(first + pd.Timedelta(days=4))]
    expected = [(when - moments[0]).total_seconds() for when in moments]
    assert seconds_of([when.strftime(form) for when in moments]) == expected


def test_a_field_above_twelve_decides() -> None:
    assert seconds_of(["04.13.21 10:00:00", "04.15.21 10:00:00"]) == [0.0, 2 * 86400.0]


def test_rows_of_one_day_each_are_consecutive_days() -> None:
    assert seconds_of(["23.03.07 10:00", "23.03.08 10:00", "23.03.09 10:00"]) == [
        0.0,
        86400.0,
        2 * 86400.0,
    ]


def test_a_row_on_the_first_of_each_month_has_the_day_first(tmp_path: Path) -> None:
    texts = [f"01.{month:02}.2021 10:00:00" for month in range(1, 13)]
    assert seconds_of(texts)[1] == 31 * 86400.0
    assert "text.date_order" in codes_of(texts, tmp_path)


def test_a_clear_order_has_no_finding(tmp_path: Path) -> None:
    texts = [when.strftime("%d.%m.%Y %H:%M:%S") for when in ACROSS_MIDNIGHT]
    assert "text.date_order" not in codes_of(texts, tmp_path)


@pytest.mark.parametrize("marks", [("dop.", "odp."), ("przed poł.", "po poł."), ("de.", "du.")])
def test_am_and_pm_of_other_languages(marks: tuple[str, str]) -> None:
    before, after = marks
    texts = [f"2021-04-08 11:59:30 {before}", f"2021-04-08 12:00:00 {after}"]
    texts += [f"2021-04-08 11:00:00 {after}", f"2021-04-09 12:00:00 {before}"]
    assert seconds_of(texts) == [0.0, 30.0, 39630.0, 43230.0]


def test_am_and_pm_with_a_damaged_letter() -> None:
    assert seconds_of(["08.04.2021 11:00:00 przed po³.", "08.04.2021 11:00:00 po po³."])[1] == 43200


@pytest.mark.parametrize("form", ["%Y-%m-%d-%H-%M-%S", "%Y-%m-%d_%H-%M-%S", "%Y-%m-%d-%H-%M"])
def test_dashes_between_all_fields(form: str) -> None:
    texts = [when.strftime(form) for when in ACROSS_MIDNIGHT]
    assert seconds_of(texts) == pytest.approx(600.0 * np.arange(24))


def hourly(folder: Path, names: list[str]) -> Path:
    """A table with a stamp, and a time of day that may be hours or minutes, in this order."""
    path = folder / "log.csv"
    rows = []
    for k, when in enumerate(pd.date_range("2023-03-07 00:00", periods=20, freq="1h")):
        cells = {
            "Date/Time": when.strftime("%Y-%m-%d %H:%M"),
            "Time": when.strftime("%H:%M"),
            "T1": f"{20 + 0.1 * k:.1f}",
        }
        rows.append(",".join(cells[name] for name in names))
    path.write_text("\n".join([",".join(names), *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize("names", [["Date/Time", "Time", "T1"], ["Time", "Date/Time", "T1"]])
@pytest.mark.parametrize("requested", [None, "Date/Time"])
def test_a_column_that_is_not_the_time_does_not_decide(
    tmp_path: Path, names: list[str], requested: str | None
) -> None:
    path = hourly(tmp_path, names)
    options = {} if requested is None else {"time": requested}
    source = open_source(path, **options)
    assert source.time == "Date/Time"
    time_s, columns, _ = next(source.read_chunks(["Time", "T1"]))
    assert np.diff(time_s) == pytest.approx(3600.0)
    assert columns["T1"][:2] == pytest.approx([20.0, 20.1])
    assert columns["Time"][:2].tolist() == ["00:00", "01:00"]


def test_the_message_names_the_option_of_the_time(tmp_path: Path) -> None:
    path = hourly(tmp_path, ["Time", "Date/Time", "T1"])
    with pytest.raises(InputError, match="time=COLUMN"):
        read_columns(open_source(path, time="Time"), ["T1"])


def test_a_column_of_units_states_the_unit_of_the_only_values(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"07/13/23 10:{k:02}:00 PM,F,{68 + k}" for k in range(20)]
    path.write_text("\n".join(["Date/Time,Unit,Value", *rows, ""]), encoding="utf-8")
    assert open_table(path).units == {"Value": "F"}
    rows[7] = rows[7].replace("F", "C")
    path.write_text("\n".join(["Date/Time,Unit,Value", *rows, ""]), encoding="utf-8")
    assert open_table(path).units == {}
