"""Tables as netCDF, read back with xarray and with scipy: time, units, links, metadata, limits."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import netcdf_file

from tcdyn.core.errors import InputError
from tcdyn.io import endings
from tcdyn.io.endings import MAX_NETCDF_VALUES, TABLE, check_ending, check_size
from tcdyn.io.netcdf import variable_attributes, variable_names
from tcdyn.io.write import OutputStyle, contains_checksum_of, log_writer, write_log, write_text

N = 50
FRAME = pd.DataFrame(
    {
        "time_s": np.arange(N) / 4 + 10,
        "T1 [°C]": np.arange(N) / 7,
        "note": ["Öl", ""] * (N // 2),
        "T1_u_K": np.arange(N) / 9,
        "T1_noise_u_K": np.where(np.arange(N) == 3, np.nan, 0.1),
        "CO2_ppm": 400.0,
        "CO2_u_ppm": 2.0,
    }
)
METADATA = {"tcdyn": "compensated", "source": "ofen.csv", "lag_s of T1": "4 +- 1 s", "ort": "Köln"}


def written(folder: Path, **metadata: str) -> Path:
    return write_log(FRAME, folder / "a.nc", METADATA | metadata)


def test_xarray_reads_the_numbers_texts_and_links(tmp_path):
    with xr.open_dataset(written(tmp_path)) as data:
        assert list(data.dims) == ["time"]
        assert np.array_equal(data["time"], FRAME["time_s"])
        assert data["time"].attrs["units"] == "s"
        for name, column in {"T1_C": "T1 [°C]", "T1_noise_u_K": "T1_noise_u_K"}.items():
            assert np.array_equal(data[name], FRAME[column], equal_nan=True)
        assert data["note"].values.tolist() == FRAME["note"].tolist()
        value = data["T1_C"].attrs
        assert value["long_name"] == "T1 [°C]"
        assert value["units"] == "degC"
        assert value["units_metadata"] == "temperature: on_scale"
        assert value["ancillary_variables"] == "T1_u_K T1_noise_u_K"
        assert all(name in data for name in value["ancillary_variables"].split())
        assert data["T1_u_K"].attrs == {
            "long_name": "standard uncertainty of T1 [°C]",
            "units": "K",
            "units_metadata": "temperature: difference",
        }
        assert data["CO2_ppm"].attrs["units"] == data["CO2_u_ppm"].attrs["units"] == "1e-6"
        assert data["CO2_ppm"].attrs["ancillary_variables"] == "CO2_u_ppm"


def test_scipy_reads_the_same_file_and_all_metadata(tmp_path):
    with netcdf_file(written(tmp_path), mmap=False) as data:
        assert data.Conventions == b"CF-1.11"
        assert data.source == b"readings of sensors in ofen.csv"
        assert data.history.startswith(b"compensated by tcdyn")
        assert json.loads(data.tcdyn_metadata.decode("utf-8")) == METADATA
        assert np.array_equal(data.variables["T1_C"][:], FRAME["T1 [°C]"])
        time = data.variables["time"]
        assert (time.standard_name, time.axis) == (b"time", b"T")
        assert not hasattr(time, "_FillValue")
        assert data.version_byte == 2  # 64-bit offsets


@pytest.mark.parametrize(
    ("start", "first"),
    [
        ("2026-03-01T10:00:00.250000", "2026-03-01T10:00:00.250"),
        ("2026-03-01T10:00:00+01:00", "2026-03-01T09:00:00"),  # CF counts in UTC
    ],
)
def test_a_dated_log_has_dates(tmp_path, start, first):
    path = written(tmp_path, start_time=start)
    with xr.open_dataset(path) as data:
        expected = np.datetime64(first, "ns") + (np.arange(N) * 250).astype("timedelta64[ms]")
        assert np.array_equal(data["time"].values, expected)
    with xr.open_dataset(path, decode_times=False) as data:
        attributes = data["time"].attrs
        assert attributes["units"].startswith("seconds since 2026-03-01 ")
        assert attributes["calendar"] == "standard"
        assert (attributes["comment"] == "UTC") == ("+" in start)


def test_a_start_time_of_another_program_is_no_date(tmp_path):
    with xr.open_dataset(written(tmp_path, start_time="this morning")) as data:
        assert data["time"].attrs["units"] == "s"


def test_a_table_without_a_time_has_numbered_rows(tmp_path):
    frame = pd.DataFrame({"setpoint_degC": [50.0, 60.0], "row": [1.0, 2.0]})
    with xr.open_dataset(write_log(frame, tmp_path / "a.nc")) as data:
        assert dict(data.sizes) == {"row": 2}
        assert not data.coords
        assert data["row_2"].attrs["long_name"] == "row"


def test_units_that_the_names_do_not_state_are_those_of_the_style(tmp_path):
    style = OutputStyle(time="t", units={"T1": "degF"})
    frame = pd.DataFrame({"t": [0.0, 1.0], "T1": [70.0, 71.0], "T1_u_degF": [1.0, 1.0]})
    with xr.open_dataset(write_log(frame, tmp_path / "a.nc", style=style)) as data:
        assert data["T1"].attrs["units"] == "degF"
        assert data["T1_u_degF"].attrs["units_metadata"] == "temperature: difference"
        assert data["T1"].attrs["ancillary_variables"] == "T1_u_degF"


def test_parts_and_the_whole_give_the_same_bytes(tmp_path):
    whole = written(tmp_path)
    parts = tmp_path / "b.nc"
    with log_writer(parts, list(FRAME), METADATA, ["note"]) as write:
        for start in range(0, N, 7):
            write(FRAME.iloc[start : start + 7])
    assert parts.read_bytes() == whole.read_bytes()
    empty = tmp_path / "c.nc"
    with log_writer(empty, list(FRAME), METADATA, ["note"]):
        pass
    with xr.open_dataset(empty) as data:
        assert data.sizes["time"] == 0


def test_names_are_different_and_without_signs():
    names = ["T [°C]", "t (c)", "1. Öl", "a/b", "", "Δp"]
    new = variable_names(names)
    assert len({name.lower() for name in new.values()}) == len(names)
    assert all(name.isidentifier() and name.isascii() for name in new.values())
    attributes = variable_attributes(names, variables=new)
    assert [attributes[name]["long_name"] for name in names] == names
    changed = variable_attributes(["T a", "T a_u_K"], variables=variable_names(["T a", "T a_u_K"]))
    assert changed["T a_u_K"]["long_name"] == "T a_u_K, standard uncertainty of T a"
    assert changed["T a"]["ancillary_variables"] == "T_a_u_K"


def test_without_xarray_there_is_one_line_before_any_work(monkeypatch):
    check_ending("a.nc", TABLE)
    monkeypatch.setattr(endings, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'tcdyn\[xarray\]'"):
        check_ending("a.nc", TABLE)
    check_ending("a.csv", TABLE)


def test_a_table_too_large_for_one_piece_leaves_the_previous_file(tmp_path, monkeypatch):
    check_size("a.nc", MAX_NETCDF_VALUES, 1)
    with pytest.raises(InputError, match="in one piece"):
        check_size("a.nc", MAX_NETCDF_VALUES, 2)
    monkeypatch.setattr(endings, "MAX_NETCDF_VALUES", 100)
    target = write_text(tmp_path / "a.nc", "old")
    with pytest.raises(InputError, match=r"write \.csv or \.parquet"):
        write_log(FRAME, target)
    assert target.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_the_checksum_of_the_input_is_found(tmp_path):
    log = write_text(tmp_path / "log.csv", "t,T")
    from tcdyn.io.read import sha256_of_file

    path = written(tmp_path, source_sha256=sha256_of_file(log))
    assert contains_checksum_of(path, [log])
