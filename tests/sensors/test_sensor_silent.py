"""Any table: gaps of days, units of time, drop-outs and impossible readings never give a wrong
number silently."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import from_csv, from_frame
from tcdyn.sensors import specified_sensor
from tcdyn.workflows.compensate_table import CompensatedTable, compensate_table
from tests.series.reading import read_columns

TAU_S = 25.0
U_S = 1.0


def kiln(rows: int = 1200, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The gas, a slow wave, and the reading of one lag behind it with noise of 0.3 K; rows every
    second."""
    t = np.arange(rows, dtype=float)
    gas = 800 + 40 * np.sin(2 * np.pi * t / 900)
    y = np.empty(rows)
    y[0] = gas[0]
    for k in range(1, rows):
        middle = 0.5 * (gas[k] + gas[k - 1])
        y[k] = middle + (y[k - 1] - middle) * np.exp(-1 / TAU_S)
    return gas, y + np.random.default_rng(seed).normal(0, 0.3, rows)


def table(path: Path, time: object, y: np.ndarray, name: str = "Time [s]") -> Path:
    pd.DataFrame({name: time, "TC1_degC": np.round(y, 2)}).to_csv(path, index=False)
    return path


def compensated(log: Path) -> tuple[CompensatedTable, pd.DataFrame]:
    done = compensate_table(
        log, [specified_sensor("s", ["TC*"], [(TAU_S, U_S)])], log.with_suffix(".out.csv")
    )
    return done, pd.read_csv(done.path)


def stamps(day: str, rows: int) -> list[str]:
    return [f"{day} {10 + k // 3600:02}:{k // 60 % 60:02}:{k % 60:02}" for k in range(rows)]


@pytest.mark.e2e
@pytest.mark.parametrize("second_day", ["2021-11-27", "2021-11-28"])
def test_days_of_one_log_are_compensated_apart_and_keep_their_stamps(
    tmp_path: Path, second_day: str
) -> None:
    """The days are 24 and 48 h apart; each is as it would be in a file of its own."""
    _, y = kiln(600)
    other = 20 + 0.2 * np.arange(600) + np.random.default_rng(7).normal(0, 0.3, 600)
    time = stamps("2021-11-26", 600) + stamps(second_day, 600)
    _, out = compensated(table(tmp_path / "log.csv", time, np.r_[y, other], "Time"))
    assert out["Time"].tolist() == time
    for rows, alone in ((slice(0, 600), y), (slice(600, 1200), other)):
        _, single = compensated(table(tmp_path / "day.csv", np.arange(600), alone))
        assert np.abs(out["TC1_degC"].to_numpy()[rows] - single["TC1_degC"]).max() < 0.01


def test_stamps_go_through_parquet_too(tmp_path: Path) -> None:
    _, y = kiln(300)
    time = stamps("2021-11-26", 300)
    log = table(tmp_path / "log.csv", time, y, "Time")
    done = compensate_table(
        log, [specified_sensor("s", ["TC*"], [(TAU_S, U_S)])], tmp_path / "out.parquet"
    )
    assert pd.read_parquet(done.path)["Time"].tolist() == time
    again = tmp_path / "log.parquet"
    pd.DataFrame({"Time": pd.to_datetime(time), "TC1_degC": y}).to_parquet(again)
    _, out = compensated(again)
    assert pd.to_datetime(out["Time"]).tolist() == pd.to_datetime(time).tolist()


def test_summary_has_the_rows_and_a_line_for_each_column(tmp_path: Path) -> None:
    _, y = kiln(300)
    done, _ = compensated(table(tmp_path / "log.csv", np.arange(300), y))
    first, line = done.summary().splitlines()
    assert first == f"300 rows, 1 column compensated: {done.path}"
    row = done.to_frame().loc["TC1_degC"]
    assert line.startswith("  TC1_degC: lag 25.0 +- 1.0 s")
    for value in (row["noise_sd_K"], row["sd_typical_K"], row["sd_max_K"]):
        assert f"{value:.3g} K" in line


def unplugged(y: np.ndarray) -> None:
    y[700:760] = 25 + np.random.default_rng(8).normal(0, 0.3, 60)


def alternating(y: np.ndarray) -> None:
    y[700:900:2] = 2300


def zeros(y: np.ndarray) -> None:
    y[np.random.default_rng(9).random(len(y)) < 0.3] = 0


def absolute_zero(y: np.ndarray) -> None:
    y[[100, 101, 102, 700]] = -385


def overload(y: np.ndarray) -> None:
    y[650] = 9.9e37


@pytest.mark.parametrize("fault", [unplugged, alternating, zeros, absolute_zero, overload])
def test_readings_that_no_input_could_produce_are_not_inverted(tmp_path: Path, fault) -> None:
    """95 % of the samples lie within 2 standard uncertainties; the lag is exact here, so 90 % is a
    safe limit."""
    gas, y = kiln()
    fault(y)
    done, out = compensated(table(tmp_path / "log.csv", np.arange(len(y)), y))
    error = np.abs(out["TC1_degC"] - gas)
    assert (error < 2 * out["TC1_u_K"]).mean() > 0.9
    assert error.max() < 10  # the gas moves by 18 K in the longest gap
    codes = {f.code for f in done.findings}
    assert codes & {"trace.unreachable", "series.range", "series.codes"}


def test_what_a_record_does_not_determine_is_left_empty(tmp_path: Path) -> None:
    gas, y = kiln(2600)
    y[1400:] = 25 + np.random.default_rng(8).normal(0, 0.3, 1200)
    done, out = compensated(table(tmp_path / "log.csv", np.arange(len(y)), y))
    assert "trace.undetermined" in {f.code for f in done.findings}
    assert out["TC1_degC"][2400:].isna().all()
    reported = out["TC1_degC"].notna()
    assert (out["TC1_u_K"][reported] < np.ptp(y[:1400])).all()
    assert (np.abs(out["TC1_degC"] - gas)[reported] < 4 * out["TC1_u_K"][reported]).mean() > 0.98


@pytest.mark.study
def test_a_sound_record_has_no_such_finding(tmp_path: Path) -> None:
    """Steps of the gas by 600 K within one row are fast, but the sensor can follow them."""
    y = np.empty(1200)
    x = np.where(np.arange(1200) % 400 < 200, 200.0, 800.0)
    y[0] = x[0]
    for k in range(1, len(x)):
        y[k] = x[k - 1] + (y[k - 1] - x[k - 1]) * np.exp(-1 / TAU_S)
    y += np.random.default_rng(10).normal(0, 0.3, len(y))
    done, _ = compensated(table(tmp_path / "log.csv", np.arange(len(y)), y))
    assert not {f.code for f in done.findings} & {
        "trace.unreachable",
        "trace.outside",
        "trace.undetermined",
    }


def test_every_command_asks_for_the_same_unit(tmp_path: Path) -> None:
    _, y = kiln(300)
    log = table(tmp_path / "log.csv", 1000 * np.arange(300), y, "Time")
    pd.read_csv(log).assign(u=np.repeat(np.arange(30) % 2, 10)).to_csv(log, index=False)
    for call in (
        lambda: compensated(log),
        lambda: read_columns(log, ["TC1_degC"]),
        lambda: from_csv(log, input="u", output="TC1_degC"),
    ):
        with pytest.raises(InputError, match=r"no unit is stated.*time_unit=UNIT"):
            call()
    assert from_csv(log, input="u", output="TC1_degC", time_unit="ms").dt_s == pytest.approx(1.0)
    t, _, _ = read_columns(log, ["TC1_degC"], time_unit="ms")
    assert t[-1] == pytest.approx(299.0)


@pytest.mark.parametrize(("unit", "per_s"), [("ms", 1000.0), ("min", 1 / 60), ("hr", 1 / 3600)])
def test_identify_reads_units_of_header_and_unit_row(
    tmp_path: Path, unit: str, per_s: float
) -> None:
    u = np.repeat(np.arange(30) % 2, 10)
    log = tmp_path / "log.csv"
    frame = pd.DataFrame(
        {f"Time [{unit}]": np.arange(300) * per_s, "u": u, "y": np.sqrt(np.arange(300))}
    )
    frame.to_csv(log, index=False)
    assert from_csv(log, input="u", output="y").dt_s == pytest.approx(1.0)
    head, *rows = log.read_text(encoding="utf-8").splitlines()
    log.write_text(
        "\n".join([head.replace(f" [{unit}]", ""), f"{unit},-,degC", *rows]) + "\n",
        encoding="utf-8",
    )
    assert from_csv(log, input="u", output="y").dt_s == pytest.approx(1.0)


def test_a_unit_row_tells_the_unit_of_a_temperature(tmp_path: Path) -> None:
    _, y = kiln(300)
    log = tmp_path / "log.csv"
    rows = "".join(f"{k},{1.8 * v + 32:.2f}\n" for k, v in enumerate(y))
    log.write_text("Time,TC1\ns,degF\n" + rows, encoding="utf-8")
    done, _ = compensated(log)
    assert done.columns[0].unit.name == "degF"


def test_identify_keeps_the_gap_between_days(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    time = stamps("2021-11-26", 100) + stamps("2021-11-27", 100)
    pd.DataFrame({"time": time, "u": np.arange(200) % 7, "y": np.arange(200.0)}).to_csv(
        log, index=False
    )
    data = from_csv(log, input="u", output="y")
    assert data.dt_s == pytest.approx(1.0)
    assert data.runs[0].n == 86400 + 100


def test_identify_takes_overload_and_drop_outs_as_missing() -> None:
    y = np.random.default_rng(11).normal(50, 5, 300)
    y[[20, 90, 91, 200]] = 0.0
    y[150] = 9.9e37
    data = from_frame(
        pd.DataFrame({"t": np.arange(300.0), "u": np.arange(300) % 9, "y": y}),
        input="u",
        output="y",
    )
    assert np.flatnonzero(np.isnan(data.runs[0].y[:, 0])).tolist() == [20, 90, 91, 150, 200]
    about_y = [f for f in data.select(output="y").findings if f.subject == "y"]
    assert [(f.code, f.numbers["count"]) for f in about_y] == [("series.codes", 5)]


def test_a_column_named_twice_is_refused_by_identify() -> None:
    frame = pd.DataFrame(np.zeros((20, 3)), columns=["t", "t", "y"])
    with pytest.raises(InputError, match="'t' stands twice"):
        from_frame(frame, input="y", output="t")


def test_a_record_with_a_gap_longer_than_itself_is_not_fitted_as_one(tmp_path: Path) -> None:
    time = stamps("2021-11-26", 300) + stamps("2021-11-27", 300)
    log = table(tmp_path / "log.csv", time, kiln(600)[1], "Time")
    with pytest.raises(InputError, match=r"missing after row 300 .* cut the table there"):
        read_columns(log, ["TC1_degC"])


def test_drop_outs_in_a_sensor_record_are_missing_and_reported(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    y = 21 + 63 * np.clip((np.arange(600) - 100) / 100, 0, 1) + rng.normal(0, 0.05, 600)
    y[rng.random(600) < 0.05] = 2300
    _, columns, findings = read_columns(
        table(tmp_path / "log.csv", 0.05 * np.arange(600), y), ["TC1_degC"], None
    )
    assert np.nanmax(columns["TC1_degC"]) > 2000  # without a unit the column may hold anything
    from tcdyn.series.units import Unit

    _, columns, findings = read_columns(tmp_path / "log.csv", ["TC1_degC"], {"TC1_degC": Unit()})
    assert np.nanmax(columns["TC1_degC"]) < 90
    assert "series.codes" in {f.code for f in findings}


def test_identify_reads_channels_of_different_start_from_one_tdms_file(tmp_path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    start = np.datetime64("2021-11-26T10:00:00", "us")
    channels = []
    for name, late_s, values in (
        ("u", 0, np.repeat(np.arange(30) % 2, 10)),
        ("y", 30, np.arange(300.0)),
    ):
        properties = {
            "wf_increment": 1.0,
            "wf_start_time": start + np.timedelta64(late_s, "s"),
            "wf_start_offset": 0.0,
        }
        channels.append(ChannelObject("log", name, values.astype(float), properties=properties))
    with TdmsWriter(tmp_path / "log.tdms") as writer:
        writer.write_segment(channels)
    data = from_csv(tmp_path / "log.tdms", input="u", output="y")
    assert data.dt_s == pytest.approx(1.0)
    assert data.runs[0].n == 270


def test_a_steady_record_of_a_coarse_logger_is_determined(tmp_path: Path) -> None:
    """A logger of 1 K shows 25 nearly always; the few 26 are outliers, and the range of the others
    is zero."""
    y = np.round(25.2 + np.random.default_rng(15).normal(0, 0.13, 3000))
    _, out = compensated(table(tmp_path / "log.csv", np.arange(3000), y))
    assert out["TC1_degC"].notna().all()
    assert (np.abs(out["TC1_degC"] - 25.2) < 3 * out["TC1_u_K"]).mean() > 0.9


def test_a_blank_stamp_is_interpolated_and_two_are_an_error(tmp_path: Path) -> None:
    _, y = kiln(300)
    time = stamps("2021-11-26", 300)
    time[50] = ""
    done, _ = compensated(table(tmp_path / "log.csv", time, y, "Time"))
    assert "series.filled_time" in {f.code for f in done.findings}
    time[51] = ""
    with pytest.raises(InputError, match="no time in row 51"):
        compensated(table(tmp_path / "log.csv", time, y, "Time"))


def test_an_unknown_unit_of_a_temperature_in_the_row_of_units_is_requested(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(
        "Time,TC1\ns,Rankine\n" + "".join(f"{k},{600 + k}\n" for k in range(100)), encoding="utf-8"
    )
    with pytest.raises(InputError, match="unit 'Rankine' in the row below the header is not known"):
        compensated(log)
