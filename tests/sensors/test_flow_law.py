"""A sensor whose lag follows the flow, from the command line and from Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.chain.law import FlowLaw
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
        (("--follows", "v", "--delay-s", "5"), "while the log is recorded or with a delay"),
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
