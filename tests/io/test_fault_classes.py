"""Further members of each class of fault in tables: times, units, codes, quotes, text, names,
millivolts, groups."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter

from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table, read_all_rows
from tcdyn.sensors import specified_sensor
from tcdyn.series.thermocouple_types import emf_mV
from tcdyn.series.units import cold_column, units_of
from tcdyn.workflows.compensate_table import compensate_table
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source

ROWS = 60
K = np.arange(ROWS)
T_DEGC = np.round(300 + 5 * np.sin(K / 7), 2)


def table(folder: Path, header: str, rows: list[str], encoding: str = "utf-8") -> Path:
    path = folder / "log.csv"
    path.write_text(header + "\n" + "\n".join(rows) + "\n", encoding=encoding)
    return path


def read(path: Path, column: str, **options: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Time since the first row [s], the column [degC], and the codes of the findings."""
    source = open_source(path, None, [column], options.get("time_unit"))
    cold = cold_column(options.get("cold_junction", 0.0), source.table.names, "log.csv")
    units, found = units_of(
        [column], "", options.get("couple", ""), cold, unit_row=source.table.units
    )
    time_s, values, more = read_columns(
        path, [column], units, source.time, options.get("time_unit")
    )
    return time_s - time_s[0], values[column], [f.code for f in [*found, *more]]


# times


@pytest.mark.parametrize(
    ("start", "zone", "form"),
    [
        ("2021-10-31 02:50", "Europe/Berlin", "%d.%m.%Y %H:%M:%S"),  # back, the hour comes twice
        ("2021-03-14 01:50", "America/New_York", "%m/%d/%Y %I:%M:%S %p"),  # forward
    ],
)
def test_a_local_clock_goes_on_through_a_change_of_daylight_saving_time(
    tmp_path: Path, start: str, zone: str, form: str
) -> None:
    first = pd.Timestamp(start).tz_localize(zone, ambiguous=True)
    moments = pd.date_range(first, periods=ROWS, freq="20s")
    rows = [f"{m.strftime(form)},{t}" for m, t in zip(moments, T_DEGC)]
    path = table(tmp_path, "Time,T1", rows)
    time_s, values, codes = read(path, "T1")
    assert time_s == pytest.approx(20.0 * K)
    assert values == pytest.approx(T_DEGC)
    assert "text.clock_change" in codes


@pytest.mark.parametrize("day", ["2021-10-30", "2021-10-31"])
def test_an_hour_lost_by_day_is_no_change_of_the_clock(tmp_path: Path, day: str) -> None:
    hours = np.where(K < 30, 12, 13)
    rows = [f"{day} {h}:{k // 60:02}:{k % 60:02},{t}" for k, h, t in zip(K, hours, T_DEGC)]
    columns = read_all_rows(open_table(table(tmp_path, "Time,T1", rows)), ["Time"])
    assert columns.data["Time"][[29, 30]].tolist() == [29.0, 3630.0]
    assert columns.findings == ()


@pytest.mark.parametrize(
    ("header", "cells", "unit", "step_s"),
    [
        ("Laufzeit [Stunden]", [f"{k / 7200:.8f}" for k in K], None, 0.5),
        ("Tiempo (minutos)", [f"{k / 120:.8f}" for k in K], None, 0.5),
        ("epoch", [str(1637920790000000 + 500_000 * k) for k in K], "us", 0.5),
        ("Time", [f"{44526.4 + k / 86400:.9f}" for k in K], "days", 1.0),
    ],
)
def test_units_of_time_are_read_or_stated(
    tmp_path: Path, header: str, cells: list[str], unit: str | None, step_s: float
) -> None:
    path = table(tmp_path, f"{header},T1", [f"{c},{t}" for c, t in zip(cells, T_DEGC)])
    time = "epoch" if header == "epoch" else None
    time_s, _, _ = read_columns(path, ["T1"], time=time, time_unit=unit)
    assert time_s - time_s[0] == pytest.approx(step_s * K, abs=2e-4)


@pytest.mark.parametrize("last", ["00:59", "23:59"])
def test_two_fields_that_may_be_minutes_or_hours_are_asked_about(tmp_path: Path, last: str) -> None:
    rows = [f"00:{k:02},{t}" for k, t in zip(K, T_DEGC)] + [f"{last},300"]
    with pytest.raises(InputError, match="hours and minutes or minutes and seconds"):
        read(table(tmp_path, "Time,T1", rows), "T1")


# units


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("T1/°F", [f"{1.8 * t + 32:.3f}" for t in T_DEGC]),
        ("T1 in K", [f"{t + 273.15:.2f} K" for t in T_DEGC]),
        ("T1", [f"{1.8 * t + 32:.3f} deg. F" for t in T_DEGC]),
        ("T1\nTime unit: s,Deg F", [f"{1.8 * t + 32:.3f}" for t in T_DEGC]),
    ],
)
def test_a_unit_of_temperature_is_read_wherever_it_stands(
    tmp_path: Path, header: str, cells: list[str]
) -> None:
    path = table(tmp_path, f"Time [s],{header}", [f"{k},{c}" for k, c in zip(K, cells)])
    _, values, codes = read(path, header.split("\n")[0])
    assert values == pytest.approx(T_DEGC, abs=1e-9)
    assert "sensor.unit_assumed" not in codes


# codes and drop-outs


@pytest.mark.parametrize(
    ("word", "code"),
    [
        ("OVLD", "text.error_word"),
        ("Off", "text.error_word"),  # not 0 degC
        ("+++++", "text.error_word"),
        ("9.91E+37", "series.codes"),
        ("-200", "series.codes"),
        ("9999", "series.codes"),
    ],
)
def test_a_code_instead_of_a_reading_is_missing(tmp_path: Path, word: str, code: str) -> None:
    lost = [5, 20, 21, 40, 50]
    rows = [f"{k},{word if k in lost else t}" for k, t in zip(K, T_DEGC)]
    _, values, codes = read(table(tmp_path, "Time [s],T1", rows), "T1")
    assert np.flatnonzero(np.isnan(values)).tolist() == lost
    assert np.delete(values, lost) == pytest.approx(np.delete(T_DEGC, lost))
    assert code in codes


# quotes


@pytest.mark.parametrize(
    ("header", "column", "rows"),
    [
        (
            'Time [s],"T ""A"", inner",Note',
            'T "A", inner',
            [f'{k},{t},"said ""yes, {k}"""' for k, t in zip(K, T_DEGC)],
        ),
        (
            "Time [s],T1,Note",
            "T1",
            [
                f'{k},{t},"two\nlines, {k}"' if k in (3, 9) else f"{k},{t},"
                for k, t in zip(K, T_DEGC)
            ],
        ),
        ('Time [s];"T\n1";Pipe', "T 1", [f'{k};{t};6" pipe' for k, t in zip(K, T_DEGC)]),
    ],
)
def test_quotes_separators_and_line_breaks_inside_them(
    tmp_path: Path, header: str, column: str, rows: list[str]
) -> None:
    time_s, values, _ = read(table(tmp_path, header, rows), column)
    assert time_s.tolist() == list(range(ROWS))
    assert values == pytest.approx(T_DEGC)


def test_a_row_with_an_open_quote_is_refused(tmp_path: Path) -> None:
    rows = [f'{k},{t},"note"' for k, t in zip(K, T_DEGC)]
    rows[30] = '30,"305.0'
    with pytest.raises(InputError, match="row 32 has"):
        read(table(tmp_path, "Time [s],T1,Note", rows), "T1")


def test_thousands_that_may_be_decimals_are_asked_about(tmp_path: Path) -> None:
    rows = [f'{k},"1,{int(t):03}"' for k, t in zip(K, T_DEGC)]
    with pytest.raises(InputError, match="'1,300' may have a decimal comma"):
        read(table(tmp_path, "Time [s],T1", rows), "T1")


# columns of text


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_text_that_nobody_needs_is_carried_over(tmp_path: Path, ending: str) -> None:
    rows = 300
    frame = pd.DataFrame(
        {
            "time_s": np.arange(rows),
            "TC1_degC": np.round(300 + 5 * np.sin(np.arange(rows) / 40), 2),
            "Operator": "anna",
            "Note": ["" if k != 200 else "door opened, hot" for k in range(rows)],
        }
    )
    path = tmp_path / f"log.{ending}"
    if ending == "csv":
        frame.to_csv(path, index=False)
    else:
        frame["Note"] = "hot"
        frame.to_parquet(path)
    sensor = specified_sensor("s", ["TC*"], [(2.0, 0.1)])
    done = compensate_table(path, [sensor], tmp_path / "out.csv")
    out = pd.read_csv(done.path, comment="#", keep_default_na=False)
    assert out["Operator"].tolist() == ["anna"] * rows
    assert out["Note"].tolist() == frame["Note"].tolist()
    assert not [f for f in done.findings if f.code == "text.no_number"]


def test_text_where_numbers_are_needed_is_refused(tmp_path: Path) -> None:
    path = table(tmp_path, "Time [s],T1,Status", [f"{k},{t},OK" for k, t in zip(K, T_DEGC)])
    with pytest.raises(InputError, match="'Status' holds text, such as 'OK' in row 1"):
        read_columns(path, ["Status"])


def test_words_in_a_channel_of_a_tdms_file_do_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "log.tdms"
    track = {"wf_increment": 1.0}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("Log", "T1", T_DEGC, properties=track),
                ChannelObject("Log", "Note", ["ok"] * ROWS, properties=track),
            ]
        )
    _, values, _ = read(path, "T1")
    assert values == pytest.approx(T_DEGC)
    assert read_all_rows(open_table(path), ["T1", "Note"]).stamps["Note"].tolist() == ["ok"] * ROWS


# names that stand twice


@pytest.mark.parametrize("names", ["Alarm,Alarm", "T2,T2"])
def test_a_name_that_stands_twice_matters_only_where_it_is_needed(
    tmp_path: Path, names: str
) -> None:
    rows = [f"{k},{t},0,1" for k, t in zip(K, T_DEGC)]
    path = table(tmp_path, f"Time [s],T1,{names}", rows)
    assert read(path, "T1")[1] == pytest.approx(T_DEGC)
    with pytest.raises(InputError, match="stands twice"):
        open_source(path, None, [names.split(",")[0][0] + "*"])
    with pytest.raises(InputError, match="stands twice"):
        open_source(path)


@pytest.mark.parametrize("header", ["Time [s],T1,Time [s],T2", "t,T1,T2,t"])
def test_two_columns_of_time_of_one_name_are_refused(tmp_path: Path, header: str) -> None:
    path = table(tmp_path, header, [f"{k},{t},{k},{k}" for k, t in zip(K, T_DEGC)])
    with pytest.raises(InputError, match="stands twice"):
        open_source(path, None, ["T1"])


# millivolts


@pytest.mark.parametrize(
    ("header", "column"),
    [("Time [s],TC1/mV,CJ", "TC1/mV"), ("Time [s],TC1,CJ\n,mV,°C", "TC1")],
)
def test_millivolts_with_a_cold_junction_named_without_its_unit(
    tmp_path: Path, header: str, column: str
) -> None:
    cold_degC = 23.0
    emf = emf_mV(T_DEGC, "K") - emf_mV(np.array([cold_degC]), "K")
    rows = [f"{k},{e:.6f},{cold_degC}" for k, e in zip(K, emf)]
    _, values, _ = read(table(tmp_path, header, rows), column, couple="K", cold_junction="CJ")
    # the emf is rounded to 1e-6 mV, and type K has 0.04 mV/K; the inverse polynomial is within 0.05
    # K
    assert values == pytest.approx(T_DEGC, abs=0.06)


# groups of TDMS files


@pytest.mark.parametrize("groups", [["A", "B", "C"], ["Run 1", "Run 2"]])
def test_channels_of_one_name_are_called_by_their_group(tmp_path: Path, groups: list[str]) -> None:
    path = tmp_path / "log.tdms"
    with TdmsWriter(path) as writer:
        for number, group in enumerate(groups):
            track = {"wf_increment": 0.5}
            writer.write_segment([ChannelObject(group, "T1", T_DEGC + number, properties=track)])
    for number, group in enumerate(groups):
        _, values, _ = read(path, f"{group}/T1")
        assert values == pytest.approx(T_DEGC + number)
    with pytest.raises(InputError, match=f"did you mean '{groups[0]}/T1'|'{groups[0]}/T1'"):
        read(path, "T1")
