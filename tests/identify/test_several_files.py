"""Runs of a model in several files."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import fit, from_csv


def run(seed: int, rows: int = 300) -> pd.DataFrame:
    """A first-order system of 0.5 K/% and 30 s from 20 degC, one row a second."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(10.0 * rng.integers(0, 2, rows // 20), 20)
    heater[:20] = 0.0
    level = np.zeros(rows)
    pole = np.exp(-1 / 30)
    for k in range(1, rows):
        level[k] = pole * level[k - 1] + (1 - pole) * 0.5 * heater[k - 1]
    reading = 20 + level + rng.normal(0, 0.02, rows)
    return pd.DataFrame({"time_s": np.arange(rows), "heater": heater, "T1_degC": reading})


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Three runs, in degC, degF and K, the second with decimal commas and other columns first."""
    first, second, third = run(0), run(1, 400), run(2)
    first.to_csv(tmp_path / "a.csv", index=False)
    second["T1 [°F]"] = 1.8 * second.pop("T1_degC") + 32
    second[["T1 [°F]", "time_s", "heater"]].to_csv(
        tmp_path / "b.csv", index=False, sep=";", decimal=","
    )
    third["T1_K"] = third.pop("T1_degC") + 273.15
    third.to_csv(tmp_path / "c.csv", index=False)
    return [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]


def test_each_file_is_a_run_in_the_unit_of_the_first(files):
    data = from_csv(files, input="heater", output="T1")
    assert [each.name for each in data.runs] == ["a.csv", "b.csv", "c.csv"]
    assert data.output_names == ("T1_degC",)
    for seed, rows, each in zip(range(3), (300, 400, 300), data.runs):
        np.testing.assert_allclose(each.y[:, 0], run(seed, rows)["T1_degC"], atol=1e-9)
        np.testing.assert_array_equal(each.u[:, 0], run(seed, rows)["heater"])
    assert len(data.reading) == 3
    table = fit(data, "P1").to_frame()
    assert abs(table.loc["Tp1", "value"] - 30) < 0.5


def test_one_file_in_a_list_is_that_file(files):
    one = from_csv(files[:1], input="heater", output="T1")
    alone = from_csv(files[0], input="heater", output="T1")
    assert one.name == alone.name == "a.csv"
    np.testing.assert_array_equal(one.runs[0].y, alone.runs[0].y)


def test_runs_of_a_column_have_the_name_of_their_file(files):
    for path in files:
        table = pd.read_csv(path, sep=None, engine="python", decimal=",")
        if path.name == "b.csv":
            continue
        table = pd.read_csv(path)
        table.assign(test=["x"] * 100 + ["y"] * 200).to_csv(path, index=False)
    data = from_csv([files[0], files[2]], input="heater", output="T1", run="test")
    assert [each.name for each in data.runs] == ["a.csv, x", "a.csv, y", "c.csv, x", "c.csv, y"]


def test_what_cannot_be_one_record_is_refused_by_name(files, tmp_path):
    with pytest.raises(InputError, match="same content"):
        from_csv([files[0], files[0]], input="heater", output="T1")
    run(5).rename(columns={"heater": "heater_kW"}).to_csv(tmp_path / "kW.csv", index=False)
    with pytest.raises(InputError, match=r"in kW, and 'heater' of a\.csv in no unit"):
        from_csv([files[0], tmp_path / "kW.csv"], input="heater", output="T1")
    slow = run(6)
    slow.assign(time_s=1.1 * slow["time_s"]).to_csv(tmp_path / "slow.csv", index=False)
    with pytest.raises(InputError, match=r"sampling intervals of 1 to 1\.1 s"):
        from_csv([files[0], tmp_path / "slow.csv"], input="heater", output="T1")
    run(7).drop(columns="T1_degC").to_csv(tmp_path / "without.csv", index=False)
    with pytest.raises(InputError, match=r"without\.csv"):
        from_csv([files[0], tmp_path / "without.csv"], input="heater", output="T1")
