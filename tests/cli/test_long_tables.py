"""Tables with several channels in one column of values, and readings in another unit.

Each command that reads a table refuses them, and what its message offers makes it work.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tcdyn as package
from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identification import from_csv, from_frame
from tcdyn.sensors import sensor_file, sensor_from_dip, sensor_from_pair
from tests.cli.test_main_job import tcdyn as exit_code

pytestmark = pytest.mark.e2e


@dataclass(frozen=True)
class Done:
    """Exit code and standard error of a command."""

    returncode: int
    stderr: str


def tcdyn(*arguments: str) -> Done:
    """Run a command."""
    stderr = StringIO()
    with redirect_stderr(stderr):
        code = exit_code(*arguments)
    return Done(code, stderr.getvalue())


SHARED = Path(__file__).parents[2].parent / "shared" / "cases" / "files2"
TIME_S = np.arange(300.0)


def dip(lag_s: float, seed: int) -> Array:
    """Readings of a step by 63 K after 60 s behind a lag."""
    since = np.maximum(TIME_S - 60, 0)
    noise = np.random.default_rng(seed).normal(0, 0.03, len(TIME_S))
    return np.asarray(np.round(21 + 63 * -np.expm1(-since / lag_s) + noise, 2))


def long_table(order: str = "cycle") -> pd.DataFrame:
    """Three channels with lags of 3, 3 and 12 s in one column of temperatures."""
    lags_s = {"CH1": 3.0, "CH2": 3.0, "CH3": 12.0}
    parts = [
        pd.DataFrame({"time_s": TIME_S, "Channel": name, "Temp": dip(lag_s, k)})
        for k, (name, lag_s) in enumerate(lags_s.items())
    ]
    table = pd.concat(parts, ignore_index=True)
    if order == "cycle":
        table = table.sort_values("time_s", kind="stable", ignore_index=True)
    return table


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a long table in each order, a sensor file, and scaled readings."""
    for order in ("cycle", "blocks"):
        long_table(order).to_csv(tmp_path / f"{order}.csv", index=False)
    long_table().to_csv(tmp_path / "german.csv", index=False, sep=";", decimal=",")
    long_table().to_parquet(tmp_path / "long.parquet", index=False)
    scaled = pd.DataFrame({"time_s": TIME_S, "Temp": np.rint(1000 * dip(12, 1)).astype(int)})
    scaled["T2"] = np.rint(1000 * dip(3, 2)).astype(int)
    scaled["u"] = (TIME_S > 60).astype(int)
    scaled.to_csv(tmp_path / "scaled.csv", index=False)
    arguments = ["--tau-s", "3+-0.1", "--column", "Temp", "--out", str(tmp_path / "s.json")]
    assert tcdyn("sensor", "new", *arguments).returncode == 0
    return tmp_path


def commands(file: Path) -> list[list[str]]:
    """The commands that read a table, with this one."""
    sensor = str(file.parent / "s.json")
    out = str(file.parent / "out.csv")
    return [
        ["sensor", "plunge", str(file), "--column", "Temp"],
        ["sensor", "noise", str(file), "--column", "Temp"],
        ["compensate", str(file), "--sensor", sensor, "--out", out],
        ["compensate", str(file), "--sensor", sensor, "--out", out, "--delay-s", "20"],
        ["view", str(file), "--sensor", sensor, "--out", f"{out}.html", "--no-open"],
    ]


def remedy(message: str) -> str:
    """The line of Python in a message."""
    found = re.search(r'python -c "([^"]+)"', message)
    assert found, message
    return found[1]


@pytest.mark.parametrize("name", ["cycle.csv", "blocks.csv", "german.csv", "long.parquet"])
def test_every_command_names_the_channels_of_a_long_table(folder: Path, name: str) -> None:
    file = folder / name
    calls = [*commands(file), ["view", str(file), "--out", f"{file}.html", "--no-open"]]
    for call in calls:
        result = tcdyn(*call)
        assert result.returncode == 2, (call, result.stderr)
        for channel in ("CH1", "CH2", "CH3"):
            assert f"'{channel}' (300 rows)" in result.stderr


def offered(message: str) -> list[str]:
    """The option that a message offers, as the words that a shell makes of it."""
    found = re.search(r"--where .*", message)
    assert found, message
    return shlex.split(found[0])[:2]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "label"), [("cycle.csv", "CH1"), ("german.csv", "CH 1"), ("long.parquet", "CH 1")]
)
def test_the_option_of_the_message_keeps_one_channel(
    folder: Path, name: str, label: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = folder / name
    if label != "CH1":
        cells = long_table()
        cells["Channel"] = cells["Channel"].replace("CH1", label)
        file = folder / "blanks.csv"
        cells.to_csv(file, index=False)
    calls = [*commands(file), ["view", str(file), "--out", f"{file}.html", "--no-open"]]
    for call in calls:
        option = offered(tcdyn(*call).stderr)
        assert option == ["--where", f"Channel={label}"]
        selected = tcdyn(*call, *option, "--overwrite")
        assert "channels" not in selected.stderr, call
        assert selected.returncode == (2 if "noise" in call else 0), call  # too few rows for noise
    capsys.readouterr()
    plunge = ["sensor", "plunge", str(file), "--column", "Temp", *option, "--json"]
    assert tcdyn(*plunge).returncode == 0
    sensor = json.loads(capsys.readouterr().out)
    lag_s = sensor["chain"]["channels"]["Temp"]["lag_s"]
    assert lag_s["low95"] < 3.0 < lag_s["high95"]
    assert sensor["reading"][0]["rows"] == 300


def test_channels_of_two_columns_are_kept_by_a_line_of_python(folder: Path) -> None:
    parts = []
    for k, (device, place) in enumerate(
        [("a", "left"), ("a", "right"), ("b", "left"), ("b", "right")]
    ):
        cells = {"device": device, "place": place, "Temp": dip(3.0, k)}
        parts.append(pd.DataFrame({"time_s": TIME_S, **cells}))
    table = pd.concat(parts).sort_values("time_s", kind="stable")
    table.to_csv(folder / "two.csv", index=False)
    refused = tcdyn("sensor", "plunge", str(folder / "two.csv"), "--column", "Temp")
    assert refused.returncode == 2
    subprocess.run([sys.executable, "-c", remedy(refused.stderr)], check=True)
    made = next(folder.glob("two_*.csv"))
    assert sensor_from_dip(made, "Temp").chain.channels["Temp"].lag_s.contains(3.0)


def test_follow_refuses_the_rows_that_are_there(folder: Path) -> None:
    arguments = ["--sensor", str(folder / "s.json"), "--out", str(folder / "f.csv")]
    result = tcdyn("follow", str(folder / "cycle.csv"), *arguments, "--idle-s", "1")
    assert result.returncode == 2
    assert "'CH3' (300 rows)" in result.stderr
    assert not (folder / "f.csv").exists()


def test_identify_refuses_channels_in_its_output_and_not_runs(folder: Path) -> None:
    table = long_table()
    table["heater"] = (table["time_s"] > 60).astype(int)
    table.to_csv(folder / "long.csv", index=False)
    result = tcdyn("identify", str(folder / "long.csv"), "-u", "heater", "-y", "Temp")
    assert result.returncode == 2
    assert "'CH3' (300 rows)" in result.stderr
    as_runs = from_csv(folder / "long.csv", input="heater", output="Temp", run="Channel")
    assert len(as_runs.runs) == 3
    with pytest.raises(InputError):
        from_frame(table, input="heater", output="Temp")
    assert len(from_frame(table, input="heater", output="Temp", run="Channel").runs) == 3


def test_frames_are_refused_as_files_are() -> None:
    table = long_table()
    probe = sensor_file("probe", {"Temp": Chain(3.0)}, "stated", np.array([[0.01]]), [0.0])
    with pytest.raises(InputError):
        package.compensate_frame(table, probe)
    with pytest.raises(InputError):
        package.compensate_frame(table.astype({"Channel": "category"}), probe)
    with pytest.raises(InputError):
        sensor_from_dip(table, "Temp")
    numbered = table.assign(Channel=table["Channel"].str[2:].astype(int))
    with pytest.raises(InputError):
        package.compensate_frame(numbered, probe)
    one = package.compensate_frame(table[table["Channel"] == "CH1"], probe)
    assert len(one) == 300
    modes = table[table["Channel"] == "CH1"].assign(Channel=["heat", "hold", "cool"] * 100)
    assert len(package.compensate_frame(modes, probe)) == 300


def test_readings_in_another_unit_are_refused_by_every_command(folder: Path) -> None:
    file = folder / "scaled.csv"
    calls = [call for call in commands(file) if call[0] != "view"]
    calls += [
        ["sensor", "pair", str(file), "--column", "Temp", "--column", "T2"],
        ["identify", str(file), "-u", "u", "-y", "Temp"],
    ]
    for call in calls:
        result = tcdyn(*call)
        assert result.returncode == 2, (call, result.stderr)
        assert "0.001 degC" in result.stderr
    assert not (folder / "out.csv").exists()
    subprocess.run([sys.executable, "-c", remedy(result.stderr)], check=True)
    sensor = sensor_from_dip(folder / "scaled_degC.csv", "Temp")
    assert sensor.chain.channels["Temp"].lag_s.contains(12.0)


def test_readings_in_another_unit_are_refused_in_frames() -> None:
    probe = sensor_file("probe", {"Temp": Chain(12.0)}, "stated", np.array([[0.01]]), [0.0])
    table = pd.DataFrame({"time_s": TIME_S, "Temp": 1000 * dip(12, 1), "T2": 1000 * dip(3, 2)})
    table["u"] = (TIME_S > 60).astype(int)
    with pytest.raises(InputError):
        package.compensate_frame(table[["time_s", "Temp"]], probe)
    with pytest.raises(InputError):
        sensor_from_dip(table, "Temp")
    with pytest.raises(InputError):
        sensor_from_pair(table, ("Temp", "T2"))
    with pytest.raises(InputError):
        from_frame(table, input="u", output="Temp")
    other = table.rename(columns={"Temp": "CO2_ppm"})
    assert from_frame(other, input="u", output="CO2_ppm").dt_s == 1.0


@pytest.mark.long
def test_a_few_drop_outs_in_a_sound_dip_remain_drop_outs(folder: Path) -> None:
    y = dip(12, 1)
    y[[80, 81, 120, 200, 260]] = (3276.7, 3276.7, 9999.0, 1e30, 2999.0)
    pd.DataFrame({"time_s": TIME_S, "Temp": y}).to_csv(folder / "codes.csv", index=False)
    sensor = sensor_from_dip(folder / "codes.csv", "Temp")
    assert sensor.chain.channels["Temp"].lag_s.contains(12.0)
    assert "series.codes" in {finding.code for finding in sensor.findings}


@pytest.mark.skipif(not SHARED.exists(), reason="the shared cases are not here")
@pytest.mark.parametrize(
    ("name", "column", "refused"),
    [
        ("42.csv", "value", True),
        ("42c.csv", "state", True),
        ("42d.csv", "value", True),
        ("41.csv", "temp", True),
        ("41c.csv", "temp", True),
        ("61c.csv", "T1_degC", False),
        ("51b.csv", "T1_degC", False),
    ],
)
def test_shared_cases(name: str, column: str, refused: bool, tmp_path: Path) -> None:
    sensor = str(tmp_path / "s.json")
    tcdyn("sensor", "new", "--tau-s", "3+-0.1", "--column", column, "--out", sensor)
    out = str(tmp_path / "o.csv")
    result = tcdyn("compensate", str(SHARED / name), "--sensor", sensor, "--out", out)
    assert result.returncode == (2 if refused else 0), result.stderr
