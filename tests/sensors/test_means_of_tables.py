"""Means instead of rows: from files, frames and the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import tcdyn
from tcdyn import Chain
from tcdyn.core.errors import InputError
from tests.cli.test_compensate_command import tcdyn as command

SENSOR = {"T_degC": (60.0, 1.0)}


def table(rows: int = 3000) -> pd.DataFrame:
    """Rows of a second behind a lag of a minute: single rows are not determined."""
    rng = np.random.default_rng(7)
    fine = np.cumsum(rng.normal(0, 0.5, rows))
    return pd.DataFrame(
        {
            "time_s": np.arange(rows, dtype=float),
            "T_degC": 100 + Chain(60.0).response(fine, 1.0) + rng.normal(0, 0.05, rows),
            "true": 100 + fine,
            "note": [f"row {k}" for k in range(rows)],
        }
    )


def coverage(done: pd.DataFrame, truth: pd.Series, length: int) -> float:
    half = length // 2
    of_true = [truth.iloc[k - half : k + half + 1].mean() for k in done.index]
    return float(np.mean(np.abs(done["T_degC"] - of_true) < 1.96 * done["T_u_K"]))


def test_means_have_the_rows_in_their_middle_and_hold_the_truth() -> None:
    frame = table()
    done = tcdyn.compensate_frame(frame, SENSOR, means=20)
    assert done.index.tolist() == list(range(10, 2990, 20))
    assert done["note"].tolist()[:2] == ["row 10", "row 30"]
    assert float(done.attrs["means_s"]) == pytest.approx(20)
    assert coverage(done, frame["true"], 20) > 0.9
    rows = tcdyn.compensate_frame(frame, SENSOR)
    assert done["T_u_K"].median() < 0.7 * rows["T_u_K"].median()


def test_auto_takes_the_resolution_that_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, probe, out = (tmp_path / name for name in ("log.csv", "p.sensor.json", "out.csv"))
    table().to_csv(log, index=False)
    command("sensor", "new", "--tau-s", "60+-1", "--column", "T_degC", "--out", probe)
    capsys.readouterr()
    words = ("compensate", log, "--sensor", probe)
    assert command(*words, "--out", out, "--means", "auto", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    (column,) = told["columns"]
    assert 2 < column["resolution_s"] < 40
    assert column["resolution_s"] <= told["means_s"] < column["resolution_s"] + 2
    meta = json.loads((tmp_path / "out.csv.meta.json").read_text())
    assert float(meta["metadata"]["means_s"]) == pytest.approx(told["means_s"])
    done = pd.read_csv(out)
    assert len(done) == told["rows"]
    steps = np.diff(done["time_s"])
    assert np.allclose(steps, told["means_s"])
    xlsx = tmp_path / "out.xlsx"
    assert command(*words, "--out", xlsx, "--means", "30") == 0
    assert len(pd.read_excel(xlsx, engine="openpyxl")) == 99
    assert "99 means over 30 s" in capsys.readouterr().out


@pytest.mark.e2e
def test_parts_of_a_long_log_give_the_same_means() -> None:
    """In segments of at least some thousand rows each mean stands once, and none is left out."""
    frame = table(30_000).drop(columns="note")
    done = tcdyn.compensate_frame(frame, SENSOR, means=50)
    assert np.diff(done.index).tolist() == [50] * (len(done) - 1)
    assert len(done) == 599
    assert coverage(done, frame["true"], 50) > 0.9


def test_a_lost_row_in_the_middle_moves_one_stamp_only() -> None:
    frame = table(1000)
    some = frame.drop(index=[10, 50, 51, 52]).reset_index(drop=True)
    done = tcdyn.compensate_frame(some, SENSOR, means=20)
    assert done["time_s"].tolist()[:4] == [9.0, 30.0, 49.0, 70.0]


def test_several_columns_share_the_times() -> None:
    frame = table(1000)
    frame["U_degC"] = frame["T_degC"] + 5
    done = tcdyn.compensate_frame(frame, {**SENSOR, "U_degC": (60.0, 1.0)}, means=20)
    assert done["U_degC"].to_numpy() - done["T_degC"].to_numpy() == pytest.approx(5, abs=0.3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"means": "soon"}, "means over 'soon'"),
        ({"means": 0.1}, "means over 0.1 s, but rows are 1 s apart"),
        ({"means": 500}, "means over 500 s of a log of 199 s"),
        ({"means": 20, "rate": True}, "rate=True with means"),
    ],
)
def test_what_cannot_be_a_mean_is_said(options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        tcdyn.compensate_frame(table(200), SENSOR, **options)


def test_means_with_a_delay_or_a_record_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, probe, out = (tmp_path / name for name in ("log.csv", "p.sensor.json", "out.csv"))
    table(200).to_csv(log, index=False)
    command("sensor", "new", "--tau-s", "60+-1", "--column", "T_degC", "--out", probe)
    words = ("compensate", log, "--sensor", probe, "--out", out, "--means", "20")
    assert command(*words, "--delay-s", "5") == 2
    assert "--means with --delay-s" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.e2e
def test_rows_that_are_not_determined_name_the_time_that_is() -> None:
    rng = np.random.default_rng(9)
    rows = 2500
    keep = np.exp(-1 / 60)
    truth = lfilter([100 * np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=rows))
    reading = Chain(2000.0).response(truth, 1.0) + rng.normal(0, 0.1, rows)
    frame = pd.DataFrame({"time_s": np.arange(rows, dtype=float), "T_degC": reading})
    sensor = {"T_degC": (2000.0, 10.0)}
    with pytest.warns(UserWarning, match=r"means over [0-9.]+ s are determined \(means="):
        of_rows = tcdyn.compensate_frame(frame, sensor)
    assert of_rows["T_degC"].isna().mean() > 0.9
    done = tcdyn.compensate_frame(frame, sensor, means="auto")
    assert done["T_degC"].notna().mean() > 0.9
    half = round(float(done.attrs["means_s"]) / 2)
    of_true = np.array([truth[k - half : k + half + 1].mean() for k in done.index])
    error = done["T_degC"].to_numpy() - of_true
    held = np.abs(error) < 1.96 * done["T_u_K"].to_numpy()
    assert held[done["T_degC"].notna()].mean() > 0.9


@pytest.mark.e2e
def test_many_logs_state_the_time_of_their_means(tmp_path: Path) -> None:
    for k in range(2):
        table(400 + k).drop(columns="note").to_csv(tmp_path / f"log{k}.csv", index=False)
    probe, results = tmp_path / "p.sensor.json", tmp_path / "results.csv"
    command("sensor", "new", "--tau-s", "60+-1", "--column", "T_degC", "--out", probe)
    words = ("compensate", *sorted(tmp_path.glob("log*.csv")), "--each", "--sensor", probe)
    assert command(*words, "--means", "20", "--results", results) == 0
    assert pd.read_csv(results)["means_s"].tolist() == [20.0, 20.0]
