"""Columns are named without their units on the command line and in Python; two of a name: refused.

Each command gets a table whose columns have units in different notations.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import tcdyn as package
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.identification import Response, from_frame
from tcdyn.rig.columns import find_column
from tcdyn.sensors import specified_sensor, write_sensor
from tcdyn.series import ReadingOptions
from tests.cli.test_main_job import tcdyn

DT_S = 0.1
N = 600


def table() -> pd.DataFrame:
    """A heated pipe: two thermocouples of different size, a flow, a current and a heater."""
    rng = np.random.default_rng(4)
    t = DT_S * np.arange(N)
    heater = np.where((t > 5) & (t < 35), 50.0, 0.0)
    gas = 300 + np.cumsum(rng.normal(0.0, 4.0, N))
    step = np.where(t > 10, 80.0, 20.0)
    heated = 200 + 8 * Chain([3.0, 0.4]).response(np.sign(heater), DT_S, "zoh")

    def noisy(values: Any) -> Any:
        return values + rng.normal(0.0, 0.05, N)

    return pd.DataFrame(
        {
            "Zeit [s]": t,
            "TE5 (°C)": noisy(Chain(1.5).response(step, DT_S)),
            "TE6 in °C": noisy(20 + Chain(2.0).response(heater, DT_S, "zoh")),
            "fine [K]": noisy(Chain(0.3).response(gas, DT_S)),
            "coarse [K]": noisy(Chain(0.9).response(gas, DT_S)),
            "flow [m/s]": 2.0,
            "I [A]": np.sign(heater),
            "LCSR/°C": noisy(heated),
            "Heizung [%]": heater,
            "U [mV]": 1.0 + 0.001 * t,
            "CJ [°C]": 23.0,
            "Gruppe [Nr]": 7,
        }
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the log, a response and a sensor file whose column has no unit."""
    path = tmp_path_factory.mktemp("names")
    table().to_csv(path / "log.csv", index=False)
    f_mHz = np.array([10.0, 20, 50, 100, 200, 500, 1000])
    h = 1 / (1 + 2j * np.pi * 1e-3 * f_mHz * 1.5)
    response = {
        "f (mHz)": f_mHz,
        "gain [dB]": 20 * np.log10(np.abs(h)),
        "phase_deg": np.angle(h, deg=True),
        "u": 0.001,
    }
    pd.DataFrame(response).to_csv(path / "bode.csv", index=False)
    write_sensor(specified_sensor("TE5", ["TE5"], [(1.5, 0.1)]), path / "s.sensor.json")
    return path


COMMANDS = {
    "inspect": "inspect log.csv --column TE5 --column flow",
    "time": "inspect log.csv --column TE5 --time Zeit",
    "where": "inspect log.csv --column TE5 --where Gruppe=7",
    "cold junction": "inspect log.csv --column U --couple K --cold-junction CJ",
    "unit of a column": "inspect log.csv --column TE5 --unit TE5=degC",
    "plunge": "sensor plunge log.csv --column TE5 --out plunge.sensor.json",
    "pair": "sensor pair log.csv --column fine --column coarse --speed flow --out p.sensor.json",
    "current": "sensor current log.csv --column LCSR --current I --out c.sensor.json",
    "identify": "identify log.csv --input Heizung --output TE6 --model P1 --out m.json",
    "run": "identify log.csv --input Heizung --output TE6 --model P1 --run Gruppe --out r.json",
    "response": "response bode.csv --frequency f --column gain --column phase --model P1 "
    "--out b.json",
    "compensate": "compensate log.csv --sensor s.sensor.json --out done.csv",
    "compensate a column": "compensate log.csv --sensor s.sensor.json --column TE6 --out other.csv",
}


@pytest.mark.e2e
@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_a_command_takes_names_without_units(
    words: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert tcdyn(*words.split(), "--overwrite") in (0, 3)  # 3: done, with a finding to look at


WRONG = {
    "inspect": "inspect two.csv --column T1",
    "cold junction": "inspect two.csv --column U --couple K --cold-junction T1",
    "plunge": "sensor plunge two.csv --column T1 --out x.sensor.json",
    "pair": "sensor pair two.csv --column a --column T1 --out x.sensor.json",
    "speed": "sensor pair two.csv --column a --column U --speed T1 --out x.sensor.json",
    "current": "sensor current two.csv --column a --current T1 --out x.sensor.json",
    "noise": "sensor noise two.csv --column T1 --out x.sensor.json",
    "input": "identify two.csv --input T1 --output a",
    "output": "identify two.csv --input a --output T1",
    "where": "inspect two.csv --column a --where T1=2",
    "time": "inspect two.csv --column a --time T1",
    "frequency": "response two.csv --frequency T1 --column a --column U",
    "compensate": "compensate two.csv --sensor T1.sensor.json --out x.csv",
    "view": "view two.csv --column T1 --no-open",
}


@pytest.mark.parametrize("words", WRONG.values(), ids=WRONG)
def test_a_name_of_two_columns_is_refused_with_both(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    two = {"time_s": DT_S * np.arange(60), "T1 [°C]": 20.0, "T1 [V]": 2.0, "a": 1.0, "U [mV]": 1.0}
    pd.DataFrame(two).to_csv("two.csv", index=False)
    write_sensor(specified_sensor("T1", ["T1"], [(1.5, 0.1)]), "T1.sensor.json")
    assert tcdyn(*words.split()) == 2
    assert "'T1' may be 'T1 [°C]' or 'T1 [V]'" in " ".join(capsys.readouterr().err.split())


def test_python_takes_the_same_names(folder: Path) -> None:
    log = table().set_index("Zeit [s]")
    found = package.inspect(log, "TE5", where="Gruppe=7")
    assert [each.name for each in found.reading.columns] == ["TE5 (°C)"]
    data = from_frame(log, input="Heizung", output=["TE6", "TE5"], run="Gruppe")
    assert data.select(output="TE5").output_names == ("TE5 (°C)",)
    response = Response.read(folder / "bode.csv", "f", ("gain", "phase"), u="u")
    assert response.to_frame().index[0] == pytest.approx(0.01)
    page, _ = package.view(folder / "log.csv", columns="TE5", open_browser=False)
    assert "TE5" in page.read_text(encoding="utf-8")


def test_columns_of_a_rig_file_have_no_unit_either() -> None:
    names = ["Zeit [ms]", "Kraft [N]", "TC1 (°C)", "T2 [°C]", "T2 [V]"]
    mapping = {"time_s": "Zeit", "load_N": "Kraft", "fast_a_degC": "TC1", "fast_b_degC": "T2"}
    assert find_column("time_s", mapping, names) == ("Zeit [ms]", "s")
    assert find_column("load_N", mapping, names) == ("Kraft [N]", "N")
    assert find_column("fast_a_degC", mapping, names) == ("TC1 (°C)", "degC")
    with pytest.raises(InputError, match=r"'T2' may be 'T2 \[°C\]' or 'T2 \[V\]'"):
        find_column("fast_b_degC", mapping, names)


@pytest.mark.e2e
def test_results_are_read_without_units(folder: Path) -> None:
    log = table()
    fit = package.identify(log, "P1", input="Heizung", output="TE6")
    assert fit.lag_s.contains(2.0) or abs(fit.lag_s.value - 2.0) < 0.1
    assert fit.lag_s == fit.best.lag_s == fit.best.identified.lag_s
    integrating = package.identify(log, "P1I", input="Heizung", output="TE6")
    with pytest.raises(InputError, match=r"P1I has no lag: its output rises"):
        integrating.lag_s  # noqa: B018
    probe = package.read_sensor(folder / "s.sensor.json")
    assert probe.lag_s.value == probe["TE5 (°C)"].lag_s.value == 1.5
    content = json.loads((folder / "s.sensor.json").read_text(encoding="utf-8"))
    assert content["columns"] == ["TE5"]
    assert ReadingOptions(where="Gruppe=7").condition == ("Gruppe", "7")
