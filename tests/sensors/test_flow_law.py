"""A sensor whose lag follows the flow, from the command line and from Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.chain.law import FlowLaw, TableLaw, TemperatureLaw
from tcdyn.core.errors import InputError
from tcdyn.sensors import read_sensor, specified_sensor
from tests.cli.test_compensate_command import tcdyn as command
from tests.smoothing.flow_study import DT_S, FINE, ROWS, film_of, reading_of, steps

SHEATH_S = (8.0, 2.0)  # film at the reference flow, and inner lag


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log with the flow in the column v, and the true temperature."""
    rng = np.random.default_rng(3)
    t = DT_S / FINE * np.arange(ROWS * FINE)
    flow = steps(t, rng)
    truth = 60 + 10 * np.sin(t / 6) + 3 * np.sin(t / 2.5)
    reading = reading_of(truth, film_of(flow, 0.5), *SHEATH_S, DT_S / FINE)[::FINE]
    table = {
        "time_s": t[::FINE],
        "T_degC": reading + 0.05 * rng.standard_normal(ROWS),
        "v": flow[::FINE],
        "true": truth[::FINE],
    }
    path = tmp_path / "log.csv"
    pd.DataFrame(table).to_csv(path, index=False)
    return path


@pytest.fixture
def sensor(tmp_path: Path) -> Path:
    """Its sensor file."""
    out = tmp_path / "probe.sensor.json"
    lags = ("--tau-s", "8.9+-0.1", "--tau-s", "1.1+-0.1")
    law = ("--at", "speed_m_s=2", "--exponent", "0.5+-0.03", "--inner-share", "0.2+-0.03")
    words = ("sensor", "new", "--column", "T_degC", *lags, *law, "--least-flow", "0.1")
    assert command(*words, "--out", out) == 0
    return out


def test_a_file_holds_the_law(sensor: Path) -> None:
    law = read_sensor(sensor).law
    assert law == FlowLaw(2.0, 0.5, 0.03, 0.2, 0.03, 0.1, "speed_m_s")
    plain = specified_sensor("probe", ["T"], [(1.5, 0.1)])
    assert "law" not in plain.to_dict()


def test_a_log_is_compensated_with_its_flow(log: Path, sensor: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    words = ("compensate", log, "--sensor", sensor, "--out", out)
    assert command(*words, "--follows", "speed_m_s=v") == 0
    done = pd.read_csv(out)
    error = done["T_degC"] - done["true"]
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert np.mean(np.abs(error) < 1.96 * done["T_u_K"]) > 0.9
    frame = tcdyn.compensate_frame(pd.read_csv(log), sensor, follows="v")
    assert np.abs(frame["T_degC"] - done["T_degC"]).max() < 0.01


def test_a_flow_that_is_missing_in_some_rows_is_held(log: Path, sensor: Path) -> None:
    table = pd.read_csv(log)
    whole = tcdyn.compensate_frame(table, sensor, follows="v")
    some = table["v"].where(np.arange(len(table)) % 3 == 0)
    holes = tcdyn.compensate_frame(table.assign(v=some), sensor, follows="v")
    difference = np.abs(holes["T_degC"] - whole["T_degC"]) / whole["T_u_K"]
    assert difference.quantile(0.9) < 0.5
    with pytest.raises(InputError, match="has no number"):
        tcdyn.compensate_frame(table.assign(v=np.nan), sensor, follows="v")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ((), "no column 'speed_m_s' with the flow"),
        (("--follows", "wind=v"), "a column for wind"),
        (("--follows", "w"), "no column 'w' with the flow"),
        (("--follows", "v", "--follows-u", "much"), "--follows-u is 'much'"),
    ],
)
def test_what_cannot_follow_is_said(
    more: tuple[str, ...],
    words: str,
    log: Path,
    sensor: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out.csv"
    assert command("compensate", log, "--sensor", sensor, "--out", out, *more) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_a_column_for_a_lag_that_does_not_follow_is_refused(log: Path) -> None:
    with pytest.raises(InputError, match="no lag follows 'v'"):
        tcdyn.compensate_frame(pd.read_csv(log), {"T_degC": (10.0, 0.1)}, follows="v")


@pytest.mark.parametrize("at", ["speed_m_s", "=2", "speed_m_s=0", "speed_m_s=fast"])
def test_a_reference_flow_is_a_quantity_and_its_value(
    at: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("sensor", "new", "--column", "T", "--tau-s", "5", "--at", at)
    assert command(*words, "--out", tmp_path / "p.sensor.json") == 2
    assert "at" in capsys.readouterr().err


def test_a_film_that_is_more_than_the_largest_lag_is_refused() -> None:
    with pytest.raises(InputError, match="an inner share of at least"):
        specified_sensor("p", ["T"], [(5.0, 0.1), (4.0, 0.1)], law=FlowLaw(2.0, 0.5))


@pytest.mark.e2e
def test_live_compensation_follows_the_flow(log: Path, sensor: Path, tmp_path: Path) -> None:
    out, live = tmp_path / "delayed.csv", tmp_path / "live.csv"
    more = ("--sensor", sensor, "--follows", "speed_m_s=v", "--delay-s", "20")
    assert command("compensate", log, *more, "--out", out) == 0
    assert command("follow", log, *more, "--out", live, "--idle-s", "0.5") == 0
    assert live.read_bytes() == out.read_bytes()
    done = pd.read_csv(out)
    error = done["T_degC"] - done["true"]
    one_lag = tmp_path / "one.csv"
    command("compensate", log, *more[:2], "--follows", "none", "--delay-s", "20", "--out", one_lag)
    of_one = pd.read_csv(one_lag)["T_degC"] - done["true"]
    assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean(of_one**2)) / 3
    assert np.mean(np.abs(error) < 1.96 * done["T_u_K"]) > 0.9


def test_an_uncertain_flow_widens_the_band(log: Path, sensor: Path) -> None:
    table = pd.read_csv(log)
    sharp = tcdyn.compensate_frame(table, sensor, follows="v")["T_u_K"]
    vague = tcdyn.compensate_frame(table, sensor, follows="v", follows_u="10%")["T_u_K"]
    assert vague.median() > 1.15 * sharp.median()
    other = tcdyn.compensate_frame(table, sensor, follows="v", follows_u="0.2")["T_u_K"]
    assert sharp.median() < other.median() < vague.median()
    with pytest.raises(InputError, match="no lag follows 'a column'"):
        tcdyn.compensate_frame(table, {"T_degC": (10.0, 0.1)}, follows_u="0.2")


@pytest.mark.parametrize(
    ("words", "law"),
    [
        (
            ("--at", "oil_degC=40", "--per-degree", "0.02+-0.005"),
            TemperatureLaw(40.0, 0.02, 0.005, quantity="oil_degC"),
        ),
        (
            ("--at", "rpm=2", "--lag-table", "1:30,2:20,4:15"),
            TableLaw(2.0, (1.0, 2.0, 4.0), (30.0, 20.0, 15.0), quantity="rpm"),
        ),
        (("--at", "v=2"), FlowLaw(2.0, 0.5, 0.1, 0.2, 0.1, quantity="v")),
    ],
)
def test_each_law_is_written_and_read(words: tuple[str, ...], law: object, tmp_path: Path) -> None:
    out = tmp_path / "p.sensor.json"
    assert command("sensor", "new", "--column", "T", "--tau-s", "20", *words, "--out", out) == 0
    assert read_sensor(out).law == law


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--exponent", "0.5"), "--exponent without --at"),
        (("--inner-share", "0.5"), "--inner-share without --at"),
        (("--at", "v=2", "--exponent", "0.5", "--per-degree", "1"), "one law of the lag"),
        (("--at", "v=2", "--lag-table", "1:30,2"), "values and lags in s"),
        (("--at", "v=9", "--lag-table", "1:30,2:20"), "a value in the table"),
    ],
)
def test_options_of_a_law_are_checked(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "p.sensor.json"
    assert command("sensor", "new", "--column", "T", "--tau-s", "20", *words, "--out", out) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not out.exists()


def test_a_lag_that_follows_a_temperature(tmp_path: Path) -> None:
    """A membrane whose lag falls by half in 23 degrees, in a bath that warms."""
    rng = np.random.default_rng(5)
    dt_s = 1.0
    t = dt_s * np.arange(900)
    bath = 10 + 25 * t / t[-1]
    truth = 200 + 20 * np.sin(t / 60) + 10 * np.sin(t / 25)
    law = TemperatureLaw(20.0, 0.03, 0.001, quantity="bath_degC")
    lag_s = 30.0 * law.factor(bath)
    reading = np.empty(len(t))
    reading[0] = truth[0]
    for k in range(1, len(t)):
        keep = np.exp(-dt_s / lag_s[k])
        reading[k] = keep * reading[k - 1] + (1 - keep) * 0.5 * (truth[k] + truth[k - 1])
    reading += rng.normal(0, 0.05, len(t))
    table = pd.DataFrame({"time_s": t, "O2_umol": reading, "bath_degC": bath})
    probe = specified_sensor("optode", ["O2_umol"], [(30.0, 0.3)], is_bare=True, law=law)
    done = tcdyn.compensate_frame(table, probe, unit={"O2_umol": "umol"})
    one_lag = tcdyn.compensate_frame(table, probe, unit={"O2_umol": "umol"}, follows="none")
    error, of_one = done["O2_umol"] - truth, one_lag["O2_umol"] - truth
    assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean(of_one**2)) / 3
    assert np.mean(np.abs(error) < 1.96 * done["O2_umol_u_umol"]) > 0.9


@pytest.mark.parametrize("unit", ["km/h", "knots"])
def test_a_column_in_another_unit_than_the_law_is_refused(
    unit: str, log: Path, sensor: Path
) -> None:
    table = pd.read_csv(log).rename(columns={"v": f"wind [{unit}]"})
    with pytest.raises(InputError, match="the law of the lag in m/s"):
        tcdyn.compensate_frame(table, sensor, follows="wind")
    same = table.rename(columns={f"wind [{unit}]": "wind [m/s]"})
    done = tcdyn.compensate_frame(same, sensor, follows="wind")
    assert done.attrs["follows"] == "wind [m/s]"
    assert "exponent 0.500" in done.attrs["law of T_degC"]


def test_a_flow_of_zero_needs_a_least_flow(log: Path) -> None:
    law = FlowLaw(2.0, 0.5, 0.03, 0.2, 0.03, quantity="v")
    probe = specified_sensor("p", ["T_degC"], [(8.9, 0.1), (1.1, 0.1)], law=law)
    table = pd.read_csv(log)
    still = table.assign(v=table["v"].where(table["time_s"] > 20, 0.0))
    with pytest.raises(InputError, match=r"41 rows of column 'v' have a flow of zero.*least_flow"):
        tcdyn.compensate_frame(still, probe)


@pytest.mark.e2e
def test_a_flow_that_is_missing_for_long_is_said(log: Path, sensor: Path, tmp_path: Path) -> None:
    table = pd.read_csv(log)
    table["v"] = table["v"].where((table["time_s"] < 100) | (table["time_s"] > 220))
    table.loc[3, "v"] = -9999
    with pytest.warns(UserWarning, match=r"the flow is missing in 40 % of the rows, up to 120.5 s"):
        tcdyn.compensate_frame(table, sensor, follows="v")
    gap = tmp_path / "gap.csv"
    table.drop(columns="true").to_csv(gap, index=False)
    out = tmp_path / "live.csv"
    more = ("--follows", "v", "--delay-s", "5", "--idle-s", "0.5", "--components")
    assert command("follow", gap, "--sensor", sensor, "--out", out, *more) == 0
    done = pd.read_csv(out)
    assert len(done) == len(table)
    assert "T_record_u_K" in done


def test_the_lag_of_a_table_is_that_of_the_sensor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "p.sensor.json"
    words = ("sensor", "new", "--column", "T", "--at", "rpm=1000", "--out", out)
    lags = ("--lag-table", "500:30,1000:25,2000:16")
    assert command(*words, *lags) == 0
    assert read_sensor(out).chain.channels["T"].lag_s.value == pytest.approx(25)
    assert command(*words, *lags, "--tau-s", "22", "--overwrite") == 2
    assert "25 s in the table" in " ".join(capsys.readouterr().err.split())
