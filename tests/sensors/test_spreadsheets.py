"""Compensated tables for spreadsheet programs and as netCDF; what a German spreadsheet opens."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest
import xarray as xr

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.io import endings
from tcdyn.io.metadata import check_not_compensated
from tcdyn.sensors import sensor_file
from tcdyn.workflows import compensate_table as module
from tcdyn.workflows.compensate_table import CompensatedTable, compensate_table
from tcdyn.workflows.follow import follow
from tcdyn.workflows.frames import compensate_dataset
from tests.sensors.sensor_world import logged

DT_S = 0.5
N = 200
TIME_S, _, READING = logged((4.0,), DT_S, N, 0.05, 23, rise_K=0.0)
READING = READING.round(3)
STAMPS = pd.Timestamp("2026-02-28 23:59:00") + pd.to_timedelta(TIME_S, "s")
PROBE = sensor_file("probe", {"T*": Chain(4.0)}, "stated", np.array([[0.01]]), [0.0])
GERMAN = {"sep": ";", "decimal": ",", "encoding": "cp1252"}


def german_log(folder: Path) -> Path:
    log = folder / "ofen.csv"
    frame = pd.DataFrame({"Zeit": STAMPS, "T1 [°C]": READING, "Öldruck": 12.5, "Nr": "=SUM(A1)"})
    frame["Zeit"] = STAMPS.strftime("%d.%m.%Y %H:%M:%S")
    frame.iloc[::2].to_csv(log, index=False, **GERMAN)
    return log


def seconds_log(folder: Path, time: str = "time_s", scale: float = 1.0) -> Path:
    log = folder / "log.csv"
    pd.DataFrame({time: TIME_S * scale, "T1_degC": READING}).to_csv(log, index=False)
    return log


def codes(done: Any) -> list[str]:
    return [finding.code for finding in done.findings]


def table_of(done: CompensatedTable) -> pd.DataFrame:
    return pd.read_excel(done.path, sheet_name="table", engine="openpyxl")


def test_a_workbook_holds_the_rows_of_the_csv_file_with_dates(tmp_path):
    log = german_log(tmp_path)
    done = compensate_table(log, [PROBE], tmp_path / "a.xlsx")
    usual = pd.read_csv(compensate_table(log, [PROBE], tmp_path / "a.csv").path)
    back = table_of(done)
    assert list(back) == list(usual)
    for name in ("T1 [°C]", "Öldruck", "T1_u_K"):
        assert back[name].dtype == float
        assert np.array_equal(back[name], usual[name])
    assert back["Zeit"].tolist() == list(STAMPS[::2])
    assert back["Nr"].tolist() == ["=SUM(A1)"] * (N // 2)
    sheet = openpyxl.load_workbook(done.path)["metadata"]
    stored = dict(sheet.iter_rows(min_row=2, values_only=True))
    assert done.metadata.items() <= stored.items()
    with pytest.raises(InputError, match="its metadata say so"):
        check_not_compensated(list(back), stored, "a.xlsx")
    again = compensate_table(log, [PROBE], tmp_path / "b.xlsx")
    assert again.path.read_bytes() == done.path.read_bytes()


@pytest.mark.parametrize("kind", ["instants", "zone", "durations"])
def test_a_workbook_has_the_times_of_a_parquet_file(tmp_path, kind):
    times = {
        "instants": STAMPS,
        "zone": STAMPS.tz_localize("Europe/Berlin"),
        "durations": pd.to_timedelta(TIME_S, "s"),
    }[kind]
    log = tmp_path / "log.parquet"
    pd.DataFrame({"time": times, "T1_degC": READING}).to_parquet(log, index=False)
    done = compensate_table(log, [PROBE], tmp_path / "a.xlsx")
    sheet = openpyxl.load_workbook(done.path)["table"]
    cells = [row[0] for row in sheet.iter_rows(min_row=2, max_col=1)]
    if kind == "durations":
        assert [cell.value.total_seconds() for cell in cells[1:]] == TIME_S[1:].tolist()
        assert {cell.number_format for cell in cells} == {"[h]:mm:ss.000"}
    else:
        assert [cell.value for cell in cells] == list(STAMPS)
        assert "dates of time" not in done.metadata


def test_a_netcdf_file_has_the_values_of_the_csv_file_on_its_time(tmp_path):
    log = german_log(tmp_path)
    usual = pd.read_csv(compensate_table(log, [PROBE], tmp_path / "a.csv").path)
    done = compensate_table(log, [PROBE], tmp_path / "a.nc")
    with xr.open_dataset(done.path) as data:
        assert np.array_equal(data["time"].values, STAMPS[::2].to_numpy().astype("M8[ns]"))
        value = data["T1_C"]
        assert np.allclose(value, usual["T1 [°C]"], rtol=0, atol=6e-3)  # decimals of the CSV file
        assert value.attrs["units"] == "degC"
        u = data[value.attrs["ancillary_variables"]]
        assert np.allclose(u, usual["T1_u_K"], rtol=0, atol=6e-3)
        assert u.attrs["units"] == "K"
        assert data["Nr"].values.tolist() == ["=SUM(A1)"] * (N // 2)


@pytest.mark.parametrize(("time", "scale"), [("Time [ms]", 1e3), ("t [min]", 1 / 60)])
def test_the_time_of_a_netcdf_file_is_in_seconds(tmp_path, time, scale):
    log = seconds_log(tmp_path, time, scale)
    done = compensate_table(log, [PROBE], tmp_path / "a.nc")
    with xr.open_dataset(done.path) as data:
        assert data["time"].attrs["units"] == "s"
        assert np.allclose(data["time"], TIME_S, rtol=0, atol=1e-9)


def test_a_netcdf_file_has_the_units_that_were_declared(tmp_path):
    log = tmp_path / "log.csv"
    pd.DataFrame({"time_s": TIME_S, "T1": READING + 273.15}).to_csv(log, index=False)
    done = compensate_table(log, [PROBE], tmp_path / "a.nc", unit="K")
    with xr.open_dataset(done.path) as data:
        assert data["T1"].attrs["units"] == "K"
        assert data["T1"].attrs["units_metadata"] == "temperature: on_scale"
        # the result of a delayed run has the same form
        same = compensate_table(log, [PROBE], tmp_path / "b.nc", unit="K", delay_s=30.0)
        with xr.open_dataset(same.path) as delayed:
            assert np.array_equal(delayed["time"], data["time"])
            assert delayed["T1"].attrs == data["T1"].attrs


@pytest.mark.parametrize(
    ("ending", "limit"), [(".xlsx", "MAX_SHEET_ROWS"), (".nc", "MAX_NETCDF_VALUES")]
)
def test_too_many_rows_are_refused_before_the_first_is_computed(
    tmp_path, monkeypatch, ending, limit
):
    monkeypatch.setattr(endings, limit, N)
    log = seconds_log(tmp_path)
    refusal = r"rows and 4 columns are too many .* write \.csv or \.parquet"
    with pytest.raises(InputError, match=refusal):  # of a log with a delay at the row
        compensate_table(log, [PROBE], tmp_path / f"a{ending}", delay_s=30.0)
    monkeypatch.setattr(module, "compensated_segments", lambda *_, **__: pytest.fail("computed"))
    with pytest.raises(InputError, match=f"200 {refusal}"):
        compensate_table(log, [PROBE], tmp_path / f"a{ending}")
    assert list(tmp_path.iterdir()) == [log]


def test_a_german_spreadsheet_opens_what_the_finding_names(tmp_path):
    log = german_log(tmp_path)
    plain = compensate_table(log, [PROBE], tmp_path / "plain.csv")
    (finding,) = [f for f in plain.findings if f.code == "table.dialect"]
    assert finding.severity == "info"
    assert "--dialect input" in finding.message(lambda name, value: f"--{name} {value}")
    assert ".xlsx" in finding.sentence
    wrong = pd.read_csv(plain.path, **{**GERMAN, "encoding": "utf-8"})
    assert len(wrong.columns) == 1  # all cells of a row in one
    same = compensate_table(log, [PROBE], tmp_path / "same.csv", dialect="input")
    book = compensate_table(log, [PROBE], tmp_path / "book.xlsx")
    for done in (same, book, compensate_table(log, [PROBE], tmp_path / "a.parquet")):
        assert "table.dialect" not in codes(done)
    right = pd.read_csv(same.path, **GERMAN)
    for name in ("T1 [°C]", "T1_u_K"):
        assert np.array_equal(right[name], table_of(book)[name])


def test_the_finding_is_about_files_in_other_dialects_only(tmp_path):
    comma = compensate_table(seconds_log(tmp_path), [PROBE], tmp_path / "a.csv")
    assert "table.dialect" not in codes(comma)
    parquet = tmp_path / "log.parquet"
    pd.DataFrame({"time_s": TIME_S, "T1_degC": READING}).to_parquet(parquet)
    assert "table.dialect" not in codes(compensate_table(parquet, [PROBE], tmp_path / "b.csv"))
    rows: list[pd.DataFrame] = []
    german = compensate_table(german_log(tmp_path), [PROBE], rows.append)
    assert "table.dialect" not in codes(german)


def test_follow_names_the_dialect_and_no_other_format(tmp_path):
    log = german_log(tmp_path)
    quiet: dict[str, Any] = {"idle_s": 0.01, "poll_s": 0.01, "delay_s": 100.0}
    done = follow(log, [PROBE], tmp_path / "live.csv", **quiet)
    (finding,) = [f for f in done.findings if f.code == "table.dialect"]
    assert "dialect" in finding.sentence
    assert ".xlsx" not in finding.sentence
    same = follow(log, [PROBE], tmp_path / "same.csv", dialect="input", **quiet)
    assert "table.dialect" not in codes(same)


def test_a_dataset_of_xarray_has_units_and_links(tmp_path):
    array = xr.DataArray(
        READING + 273.15, {"time": STAMPS}, dims="time", name="gas", attrs={"units": "K"}
    )
    data = array.to_dataset().assign(power=("time", np.ones(N), {"units": "kW"}))
    done = compensate_dataset(data, PROBE, columns=["gas"])
    assert done["gas"].attrs["units"] == "K"
    assert done["gas"].attrs["ancillary_variables"] == "gas_u_K"
    assert done["gas_u_K"].attrs["units"] == "K"
    assert done["gas_u_K"].attrs["units_metadata"] == "temperature: difference"
    assert done["power"].attrs == {"units": "kW"}
    assert array.attrs == {"units": "K"}  # the input is not changed
    done.attrs.pop("warnings")
    path = tmp_path / "a.nc"
    done.to_netcdf(path, engine="scipy")
    with xr.open_dataset(path) as back:
        assert back["gas_u_K"].attrs == done["gas_u_K"].attrs
    millivolts = xr.DataArray(
        0.04 * READING, {"time": STAMPS}, dims="time", name="T1", attrs={"units": "mV"}
    )
    converted = compensate_dataset(millivolts, PROBE, couple="K")
    assert converted["T1_degC"].attrs["units"] == "degC"


def test_a_compensated_table_is_recognised_by_its_metadata_alone(tmp_path: Path) -> None:
    """Without the logged column and the uncertainty only the metadata tell."""
    log = german_log(tmp_path)
    book_path = tmp_path / "done.xlsx"
    compensate_table(log, [PROBE], book_path)
    book = openpyxl.load_workbook(book_path)
    sheet = book["table"]
    for column in range(sheet.max_column, 0, -1):
        if "_logged" in str(sheet.cell(1, column).value) or "_u_" in str(
            sheet.cell(1, column).value
        ):
            sheet.delete_cols(column)
    book.save(book_path)
    csv_path = tmp_path / "done.csv"
    compensate_table(log, [PROBE], csv_path)
    frame = pd.read_csv(csv_path)
    kept = [name for name in frame if "_logged" not in name and "_u_" not in name]
    frame[kept].to_csv(csv_path, index=False)  # beside its metadata
    for path in (book_path, csv_path):
        with pytest.raises(InputError, match="compensated already: its metadata say so"):
            compensate_table(path, [PROBE], tmp_path / "again.csv")


def test_the_hint_for_a_spreadsheet_program_comes_with_several_files_too(tmp_path: Path) -> None:
    log = german_log(tmp_path)
    lines = log.read_text("cp1252").splitlines()
    first, second = tmp_path / "day1.csv", tmp_path / "day2.csv"
    first.write_text("\n".join(lines[:50]) + "\n", "cp1252")
    second.write_text("\n".join([lines[0], *lines[50:]]) + "\n", "cp1252")
    done = compensate_table([second, first], [PROBE], tmp_path / "both.csv")
    assert "table.dialect" in [finding.code for finding in done.findings]
    assert [source.path.name for source in done.sources] == ["day1.csv", "day2.csv"]
