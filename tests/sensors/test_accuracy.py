"""Stated accuracy of readings, and the components of an uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn import Chain
from tcdyn.core.errors import InputError
from tcdyn.sensors.accuracy import Accuracy, accuracy_by_column
from tcdyn.series.units import Unit
from tests.cli.test_compensate_command import tcdyn as command

DEG = Unit("degC")


@pytest.mark.parametrize(
    ("text", "unit", "limit", "share"),
    [
        ("0.5 K", DEG, 0.5, 0.0),
        ("±0.5", DEG, 0.5, 0.0),
        ("+-0.5 °C", DEG, 0.5, 0.0),
        ("1.8 degF", DEG, 1.0, 0.0),
        ("0.9", Unit("degF"), 0.5, 0.0),
        ("1.5%", DEG, 0.0, 0.015),
        ("0.5 K + 0.1 %", DEG, 0.5, 0.001),
        ("2 ppm + 3 %", Unit("ppm"), 2.0, 0.03),
        ("1e-3", Unit("V"), 1e-3, 0.0),
        ("0.5K+0.1%", DEG, 0.5, 0.001),
        ("0,5 K", DEG, 0.5, 0.0),
        ("500 mK", DEG, 0.5, 0.0),
    ],
)
def test_accuracies_that_makers_state(text: str, unit: Unit, limit: float, share: float) -> None:
    accuracy = Accuracy.of(text, unit)
    assert (accuracy.limit, accuracy.share) == pytest.approx((limit, share))


@pytest.mark.parametrize(
    "text", ["", "K", "good", "0.5 ppm", "0.5 K - 1 %", "0.5 0.1", "1 % FS", "-1 K"]
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="accuracy"):
        Accuracy.of(text, DEG)


def test_limits_are_a_rectangular_distribution() -> None:
    readings = np.array([0.0, 100.0, -50.0])
    accuracy = Accuracy.of("0.5 K + 1 %", DEG)
    assert accuracy.u(readings) == pytest.approx(np.array([0.5, 1.5, 1.0]) / np.sqrt(3))


def test_one_column_may_have_another_accuracy() -> None:
    units = {"a": DEG, "b": DEG, "c": DEG}
    by_column = accuracy_by_column(["1 K", "b=2 K"], units, "log")
    assert [by_column[name].limit for name in units] == [1.0, 2.0, 1.0]
    assert list(accuracy_by_column("b=2 K", units, "log")) == ["b"]
    assert accuracy_by_column(0.5, units, "log")["a"].limit == 0.5
    assert accuracy_by_column({"c": "2 K"}, units, "log")["c"].limit == 2.0
    mixed = {"T1_degC": DEG, "gas_ppm": Unit("ppm")}
    assert accuracy_by_column(["T1=1 K", "gas_ppm=2 ppm"], mixed, "log")["T1_degC"].limit == 1.0
    assert accuracy_by_column(["gas=2 ppm", "0.5 K"], mixed, "log")["gas_ppm"].limit == 2.0
    with pytest.raises(InputError, match="column gas_ppm: an accuracy in K"):
        accuracy_by_column("0.5 K", mixed, "log")
    for wrong in (["1 K", "2 K"], ["a=1 K", "a=2 K"], ""):
        with pytest.raises(InputError, match="accurac"):
            accuracy_by_column(wrong, units, "log")


def table(rows: int = 400) -> pd.DataFrame:
    rng = np.random.default_rng(4)
    t = 0.5 * np.arange(rows)
    truth = 60 + 10 * np.sin(t / 8)
    columns = {
        name: Chain(5.0).response(truth, 0.5) + rng.normal(0, 0.05, rows) for name in ("T1", "T2")
    }
    return pd.DataFrame({"time_s": t, **columns})


def test_components_add_up_and_have_their_classes() -> None:
    sensors = {"T1": (5.0, 0.2), "T2": (5.0, 0.2)}
    plain = tcdyn.compensate_frame(table(), sensors)
    done = tcdyn.compensate_frame(table(), sensors, accuracy=["0.3 K", "T2=2 %"], components=True)
    for name in ("T1", "T2"):
        parts = [done[f"{name}_{part}_u_K"] for part in ("noise", "record", "common")]
        of_parts = np.sqrt(np.sum(np.square(parts), axis=0))
        assert of_parts == pytest.approx(done[f"{name}_u_K"].to_numpy())
        assert (done[f"{name}_u_K"] > plain[f"{name}_u_K"]).all()
    least = done["T1_record_u_K"].min()
    assert least >= 0.3 / np.sqrt(3) * 0.999
    assert "record_u" in done.attrs["components"]
    # the noise of a row does not depend on what is one error of the record
    fine = tcdyn.compensate_frame(table(), {"T1": (5.0, 1e-6), "T2": (5.0, 1e-6)}, components=True)
    assert fine["T1_noise_u_K"].to_numpy() == pytest.approx(done["T1_noise_u_K"].to_numpy())


@pytest.mark.e2e
def test_an_error_within_the_accuracy_is_inside_the_interval() -> None:
    rng = np.random.default_rng(8)
    t = 0.5 * np.arange(300)
    truth = 60 + 10 * np.sin(t / 8)
    held = []
    for _ in range(12):
        reading = Chain(5.0).response(truth, 0.5) + rng.normal(0, 0.02, 300)
        reading += rng.uniform(-1, 1) + 0.01 * rng.uniform(-1, 1) * reading
        frame = pd.DataFrame({"time_s": t, "T": reading})
        done = tcdyn.compensate_frame(frame, {"T": (5.0, 0.05)}, accuracy="1 K + 1 %")
        held.append(np.mean(np.abs(done["T"] - truth) < 1.96 * done["T_u_K"]))
    assert np.mean(held) > 0.9


def test_the_command_line_states_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, probe, out = (tmp_path / name for name in ("log.csv", "p.sensor.json", "out.csv"))
    table().to_csv(log, index=False)
    tau = ("--tau-s", "5+-0.2", "--column", "T1", "--column", "T2")
    assert command("sensor", "new", *tau, "--out", probe) == 0
    words = ("compensate", log, "--sensor", probe, "--out", out)
    assert command(*words, "--accuracy", "0.5 K", "--components") == 0
    done = pd.read_csv(out)
    assert (done["T1_u_K"] > 0.28).all()
    assert {"T2_noise_u_K", "T2_record_u_K", "T2_common_u_K"} <= set(done)
    capsys.readouterr()
    assert command(*words, "--overwrite", "--accuracy", "T3=0.5 K") == 2
    assert "T3" in capsys.readouterr().err
