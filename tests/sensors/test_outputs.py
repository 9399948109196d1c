"""Outputs in the forms that people expect: plain CSV, the dialect of the input, Parquet with its
types."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from pyarrow import parquet as pq
from typer.testing import CliRunner

from tcdyn.chain import Chain
from tcdyn.cli.app import app
from tcdyn.core.errors import InputError
from tcdyn.io.metadata import metadata_path
from tcdyn.io.read import open_table, read_all_rows
from tcdyn.sensors import sensor_file
from tcdyn.sensors.file import write_sensor
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.sensors.sensor_world import logged

DT_S = 0.5
N = 200
TIME_S, _, READING = logged((4.0,), DT_S, N, 0.05, 23, rise_K=0.0)
READING = READING.round(3)
START = pd.Timestamp("2026-02-28 23:59:00")
STAMPS = START + pd.to_timedelta(TIME_S, "s")
PROBE = sensor_file("probe", {"T*": Chain(4.0)}, "stated", np.array([[0.01]]), [0.0])


def text_of(time: list[str], separator: str, decimal: str, line_end: str, names: list[str]) -> str:
    lines = [separator.join(names)]
    for k in range(N):
        cells = [time[k], f"{READING[k]:.3f}".replace(".", decimal), f"12{decimal}5"]
        lines.append(separator.join(cells))
    return line_end.join(lines) + line_end


GERMAN = [s.strftime("%d.%m.%Y %H:%M:%S,%f")[:-3] for s in STAMPS]
FRENCH = [s.strftime("%d/%m/%Y %H:%M:%S.%f")[:-3] for s in STAMPS]
US = [s.strftime("%m/%d/%Y %I:%M:%S.%f")[:-3] + s.strftime(" %p") for s in STAMPS]
DIALECTS: dict[str, dict[str, Any]] = {
    "German": {
        "text": text_of(GERMAN, ";", ",", "\r\n", ["Zeit", "T1 [°C]", "Öldruck"]),
        "encoding": "latin-1",
        "read": {"sep": ";", "decimal": ",", "encoding": "latin-1"},
        "time": GERMAN,
    },
    "French": {
        "text": text_of(FRENCH, "\t", ",", "\r\n", ["Date/Time", "T1 (°C)", "pièce"]),
        "encoding": "utf-8-sig",
        "read": {"sep": "\t", "decimal": ",", "encoding": "utf-8-sig"},
        "time": FRENCH,
    },
    "US": {
        "text": text_of(US, ",", ".", "\n", ["Timestamp", "T1 (°C)", "psi"]),
        "encoding": "utf-8",
        "read": {},
        "time": US,
    },
    "UTF-16": {
        "text": text_of(GERMAN, "\t", ",", "\r\n", ["Time", "T1 [°C]", "p"]),
        "encoding": "utf-16",
        "read": {"sep": "\t", "decimal": ",", "encoding": "utf-16"},
        "time": GERMAN,
    },
}


def log_of(folder: Path, name: str) -> Path:
    log = folder / "log.csv"
    log.write_bytes(DIALECTS[name]["text"].encode(DIALECTS[name]["encoding"]))
    return log


@pytest.mark.parametrize("name", DIALECTS)
def test_the_dialect_of_the_input_is_written_on_request(tmp_path, name):
    log = log_of(tmp_path, name)
    options = {"time": "Zeit"} if name == "German" else {}
    plain = compensate_table(log, [PROBE], tmp_path / "plain.csv", **options)
    same = compensate_table(log, [PROBE], tmp_path / "same.csv", dialect="input", **options)
    raw = pd.read_csv(log, **DIALECTS[name]["read"])
    back = pd.read_csv(same.path, **DIALECTS[name]["read"])  # as the user's tool reads the log
    usual = pd.read_csv(plain.path)
    time, reading, *others = raw
    logged = reading.replace("T1", "T1_logged")
    assert list(back) == [time, logged, reading, "T1_u_K", *others] == list(usual)
    assert np.array_equal(back[logged], raw[reading], equal_nan=True)
    for frame in (back, usual):
        assert frame.iloc[:, 0].tolist() == DIALECTS[name]["time"]  # to the letter
        assert frame.iloc[:, 4].tolist() == [12.5] * N
    for column in (1, 2, 3):
        assert back.iloc[:, column].dtype == float
        assert np.array_equal(back.iloc[:, column], usual.iloc[:, column], equal_nan=True)
    text = same.path.read_bytes().decode(DIALECTS[name]["encoding"])
    assert ("\r\n" in text) == ("\r\n" in DIALECTS[name]["text"])
    table = open_table(same.path)
    assert table.metadata == same.metadata == plain.metadata
    assert table.metadata["start_time"] == START.isoformat()


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-16"])
def test_text_of_other_columns_survives_in_any_encoding(tmp_path, encoding):
    log = tmp_path / "log.csv"
    texts = ["Öl; heiß", "kühl"] * (N // 2)
    frame = pd.DataFrame({"Time [s]": TIME_S, "T1 [°C]": READING, "Zustand": texts})
    form = {"sep": ";", "decimal": ",", "encoding": encoding}
    frame.to_csv(log, index=False, **form)
    same = compensate_table(log, [PROBE], tmp_path / "same.csv", dialect="input")
    plain = compensate_table(log, [PROBE], tmp_path / "plain.csv")
    assert pd.read_csv(same.path, **form)["Zustand"].tolist() == texts
    assert pd.read_csv(plain.path)["Zustand"].tolist() == texts


def test_a_dialect_that_does_not_exist_is_an_error(tmp_path):
    log = log_of(tmp_path, "US")
    with pytest.raises(InputError, match="dialect is 'french'"):
        compensate_table(log, [PROBE], tmp_path / "out.csv", dialect="french")  # type: ignore[arg-type]
    for options in ({"dialect": "input"}, {"comments": True}):
        with pytest.raises(InputError, match=r"not of '\.parquet'"):
            compensate_table(log, [PROBE], tmp_path / "out.parquet", **options)
    table = tmp_path / "log.parquet"
    pd.DataFrame({"time_s": TIME_S, "T1_degC": READING}).to_parquet(table)
    with pytest.raises(InputError, match="no dialect of CSV"):
        compensate_table(table, [PROBE], tmp_path / "out.csv", dialect="input")
    assert not (tmp_path / "out.csv").exists()


def test_comments_on_request(tmp_path):
    done = compensate_table(log_of(tmp_path, "US"), [PROBE], tmp_path / "out.csv", comments=True)
    assert not metadata_path(done.path).exists()
    assert done.path.read_text(encoding="utf-8").startswith("# tcdyn: compensated\n")
    assert open_table(done.path).metadata == done.metadata


@pytest.mark.parametrize(
    "times",
    [STAMPS, STAMPS.tz_localize("Europe/Berlin"), pd.to_timedelta(TIME_S, "s")],
    ids=["instants", "instants with a zone", "durations"],
)
def test_parquet_keeps_the_type_of_its_time(tmp_path, times):
    log = tmp_path / "log.parquet"
    frame = pd.DataFrame({"time": times, "T1_degC": READING, "n": np.arange(N)})
    frame.to_parquet(log, index=False)
    done = compensate_table(log, [PROBE], tmp_path / "out.parquet")
    assert pq.read_schema(done.path).field("time").type == pq.read_schema(log).field("time").type
    back = pd.read_parquet(done.path)
    pd.testing.assert_series_equal(back["time"], frame["time"])
    if isinstance(times, pd.DatetimeIndex):
        assert done.metadata["start_time"] == times[0].isoformat()
        usual = pd.read_csv(compensate_table(log, [PROBE], tmp_path / "out.csv").path)
        assert list(pd.to_datetime(usual["time"], format="ISO8601")) == list(times)


def test_times_since_1970_in_milliseconds_are_written_as_they_were(tmp_path):
    log = tmp_path / "log.csv"
    stamps = [str(int(1772323200000 + 1000 * t)) for t in TIME_S]
    pd.DataFrame({"Time [ms]": stamps, "T1": READING}).to_csv(log, index=False)
    done = compensate_table(log, [PROBE], tmp_path / "out.csv")
    rows = done.path.read_text(encoding="utf-8").splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == stamps
    assert "start_time" not in done.metadata  # a table of numbers states none


def test_tdms_has_its_start_in_utc(tmp_path):
    log = tmp_path / "log.tdms"
    properties = {
        "wf_start_time": START.to_pydatetime(),
        "wf_increment": DT_S,
        "wf_start_offset": 0.25,
    }
    with TdmsWriter(log) as writer:
        writer.write_segment([ChannelObject("log", "T1_degC", READING, properties=properties)])
    done = compensate_table(log, [PROBE], tmp_path / "out.csv")
    assert done.metadata["start_time"] == "2026-02-28T23:59:00.250000+00:00"
    assert np.allclose(pd.read_csv(done.path)["time_s"], TIME_S, rtol=0, atol=1e-9)


def test_metadata_survive_every_form(tmp_path):
    log = log_of(tmp_path, "US")
    log.write_text("# operator: A: B\n" + log.read_text(encoding="utf-8"), encoding="utf-8")
    for ending in ("csv", "parquet"):
        done = compensate_table(log, [PROBE], tmp_path / f"out.{ending}")
        metadata = open_table(done.path).metadata
        assert metadata == done.metadata
        assert metadata["operator"] == "A: B"
        assert metadata["source"] == log.name


def test_a_compensated_table_is_refused_with_and_without_its_metadata(tmp_path):
    done = compensate_table(log_of(tmp_path, "US"), [PROBE], tmp_path / "out.csv")
    with pytest.raises(InputError, match="compensated already: its metadata say so"):
        compensate_table(done.path, [PROBE], tmp_path / "again.csv")
    metadata_path(done.path).unlink()
    with pytest.raises(InputError, match=r"it has columns 'T1 \(°C\)' and 'T1_logged \(°C\)'"):
        compensate_table(done.path, [PROBE], tmp_path / "again.csv")
    with pytest.raises(InputError, match="compensated already: it has columns"):
        follow(done.path, [PROBE], tmp_path / "live.csv", idle_s=0.01, poll_s=0.01)


@pytest.mark.e2e
def test_follow_writes_plain_csv_its_metadata_and_the_dialect_of_the_log(tmp_path):
    log = tmp_path / "log.csv"
    names = ["Time [s]", "T1 [°C]", "Öldruck"]
    german = text_of([f"{t:.1f}".replace(".", ",") for t in TIME_S], ";", ",", "\r\n", names)
    log.write_bytes(german.encode("latin-1"))
    quiet: dict[str, Any] = {"idle_s": 0.01, "poll_s": 0.01, "delay_s": 100.0}
    plain, same, above = (tmp_path / name for name in ("plain.csv", "same.csv", "above.csv"))
    follow(log, [PROBE], plain, **quiet)
    follow(log, [PROBE], same, dialect="input", **quiet)
    follow(log, [PROBE], above, comments=True, **quiet)
    usual = pd.read_csv(plain)
    assert set(usual.dtypes) <= {np.dtype(float), np.dtype(int)}
    back = pd.read_csv(same, sep=";", decimal=",", encoding="latin-1")
    pd.testing.assert_frame_equal(back, usual)
    pd.testing.assert_frame_equal(pd.read_csv(above, comment="#"), usual)
    metadata = open_table(plain).metadata
    assert metadata["tcdyn"] == "compensated"
    assert metadata["source"] == log.name
    assert open_table(same).metadata == open_table(above).metadata == metadata
    state = {"state": tmp_path / "live.json", **quiet}
    follow(log, [PROBE], tmp_path / "live.csv", dialect="input", **state)
    assert (tmp_path / "live.csv").read_bytes() == same.read_bytes()
    with pytest.raises(InputError, match="another dialect"):  # rows of two dialects in one file
        follow(log, [PROBE], tmp_path / "live.csv", **state)


def test_the_commands_have_the_options(tmp_path):
    log = log_of(tmp_path, "French")
    sensor = write_sensor(PROBE, tmp_path / "probe.sensor.json")
    out = tmp_path / "out.csv"
    command = ["compensate", str(log), "--sensor", str(sensor), "--out", str(out), "--json"]
    shown = CliRunner().invoke(app, [*command, "--dialect", "input", "--comments"])
    assert shown.exit_code in (0, 1), shown.output
    assert json.loads(shown.stdout)["metadata"]["start_time"] == START.isoformat()
    back = pd.read_csv(out, comment="#", **DIALECTS["French"]["read"])
    assert back["T1_u_K"].dtype == float
    wrong = CliRunner().invoke(app, [*command, "--dialect", "french"])
    assert isinstance(wrong.exception, InputError)


def test_large_numbers_and_texts_are_written_as_they_were(tmp_path):
    from tcdyn.io.write import write_log

    values = [1772323200000.0, 1772323200000.125, -1e300, 5e15, np.nan, 12345678901.5]
    texts = ["a,b", 'say "x"', "", "ä", "1", "2"]
    plain = pd.DataFrame({"t": range(6), "big": values})
    for frame in (plain, plain.assign(text=texts)):
        path = write_log(frame, tmp_path / "a.csv")
        back = pd.read_csv(path)
        assert np.array_equal(back["big"], values, equal_nan=True)
        stored = write_log(frame, tmp_path / "a.parquet")
        pd.testing.assert_frame_equal(pd.read_parquet(stored), frame, check_dtype=False)
    assert back["text"].fillna("").tolist() == texts
    path = write_log(plain, tmp_path / "a.csv")
    assert "0,1772323200000\n1,1772323200000.125\n" in path.read_text(encoding="utf-8")
    assert read_all_rows(open_table(path), ["big"]).data["big"][0] == values[0]
