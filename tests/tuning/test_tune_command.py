"""The command ``tcdyn tune`` from a file to settings, picture and exit code."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

import tcdyn as package
from tcdyn.chain import Chain
from tcdyn.plots import draw_tuning
from tcdyn.plots.tune import tuning_figure
from tests.cli.test_main_job import tcdyn
from tests.tuning.tuning_cases import HEATER, model


@pytest.fixture
def heater(tmp_path: Path) -> Path:
    """File of a model of a heater."""
    path = tmp_path / "heater.identified.json"
    path.write_text(model("P1D", HEATER).to_json(), encoding="utf-8")
    return path


@pytest.mark.usefixtures("few_draws")
def test_command_writes_settings_and_picture(
    heater: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, picture = heater.with_name("tune.json"), heater.with_name("tune.png")
    words = ["tune", heater, "--sample-s", 1, "--out", out, "--picture", picture]
    assert tcdyn(*words, "--controller", "pi") == 0
    text = capsys.readouterr().out
    assert "Kp " in text
    assert "I = I + " in text
    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["settings"]["sampled"]["sample_s"] == 1
    assert content["source"]["file"] == heater.name
    assert picture.stat().st_size > 10_000


@pytest.mark.usefixtures("few_draws")
def test_json_and_table(heater: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = heater.with_name("tune.csv")
    assert tcdyn("tune", heater, "--json", "--out", out) == 0
    content = json.loads(capsys.readouterr().out)
    table = pd.read_csv(out, comment="#").set_index("quantity")
    assert table.loc["Kp", "value"] == pytest.approx(content["settings"]["parallel"]["Kp"])
    assert table.loc["ms", "high95"] == pytest.approx(content["margins"]["ms"]["high95"])


@pytest.mark.usefixtures("few_draws")
def test_settings_that_are_unstable_give_exit_code_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "poor.identified.json"
    path.write_text(model("P1D", HEATER, 0.5).to_json(), encoding="utf-8")
    assert tcdyn("tune", path) == 1
    message = capsys.readouterr().err
    assert "error: " in message
    assert "--tau-c-s 30" in message


@pytest.mark.usefixtures("few_draws")
def test_warnings_give_exit_code_one_with_strict(heater: Path) -> None:
    assert tcdyn("tune", heater, "--tau-c-s", 3, "--quiet") == 0
    assert tcdyn("tune", heater, "--tau-c-s", 3, "--quiet", "--strict") == 1


@pytest.mark.usefixtures("few_draws")
def test_wrong_files_and_options_are_refused(
    heater: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sensor = tmp_path / "probe.sensor.json"
    tcdyn("sensor", "new", "--tau-s", "25", "--column", "T", "--out", sensor, "--quiet")
    other = tmp_path / "other.json"
    other.write_text("{}", encoding="utf-8")
    table = tmp_path / "log.csv"
    table.write_text("a,b\n1,2\n", encoding="utf-8")
    for path in (sensor, other, table, tmp_path / "absent.json"):
        assert tcdyn("tune", path) == 2
        assert "tcdyn identify" in capsys.readouterr().err
    assert tcdyn("tune", heater, "--rule", "robust", "--tau-c-s", 3) == 2
    assert "--tau-c-s belongs to the rule simc" in capsys.readouterr().err
    assert tcdyn("tune", heater, "--input", "fan") == 2
    assert "fan" in capsys.readouterr().err
    assert tcdyn("tune", heater, "--out", heater) == 2


@pytest.mark.usefixtures("few_draws")
def test_figure_shows_output_and_controller_output_with_bands() -> None:
    tuning = model("P1D", HEATER).tune()
    output, controlled = tuning_figure(tuning).axes
    assert "T1_degC" in output.get_ylabel()
    assert "heater_percent" in controlled.get_ylabel()
    for ax in (output, controlled):
        assert len(ax.get_lines()) >= 2
        assert len(ax.collections) == 2  # bands
    assert isinstance(draw_tuning(tuning), Axes)


@pytest.mark.e2e
def test_from_a_record_to_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Record, identify, tune: the loop of the true plant has the stated margins."""
    from tcdyn.tuning.margins import loop_margins

    t = np.arange(0, 600, 0.5)
    rng = np.random.default_rng(1)
    heater = np.repeat(rng.choice([20.0, 60.0, 90.0], 20), 60)
    truth = Chain([18.0, 4.0], delay_s=1.5)
    logged = 25 + 0.6 * truth.response(heater, 0.5, hold="zoh") + rng.normal(0, 0.1, len(t))
    table = pd.DataFrame({"time_s": t, "heater_percent": heater, "T1_degC": logged.round(3)})
    data = tmp_path / "heater.csv"
    table.to_csv(data, index=False)
    words = ["identify", data, "--input", "heater", "--output", "T1", "--model", "P2D"]
    assert tcdyn(*words, "--quiet") == 0
    result = data.with_suffix(".identified.json")
    capsys.readouterr()
    assert tcdyn("tune", result, "--json", "--sample-s", 0.5) == 0
    margins = json.loads(capsys.readouterr().out)["margins"]
    tuning = package.identification.tune(result, sample_s=0.5)
    plant = truth.rational
    true = loop_margins([type(plant)(0.6 * plant.num, plant.factors, 1.5)], tuning.controller)
    assert margins["ms"]["low95"] < true.ms[0] < margins["ms"]["high95"]
    assert margins["phase_margin_deg"]["low95"] < true.phase_margin_deg[0]


@pytest.mark.e2e
def test_the_verdict_of_identify_is_in_its_file_and_tune_repeats_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The output oscillates by itself, as much as it responds."""
    t_s = np.arange(400.0)
    heater = np.repeat([0.0, 50.0, 20.0, 70.0], 100)
    response = Chain([20.0]).response(heater, 1.0, hold="zoh")
    disturbance = 25.0 * np.sign(np.sin(2 * np.pi * t_s / 37.0))
    noise = np.random.default_rng(2).normal(0.0, 0.1, len(t_s))
    table = tmp_path / "kiln.csv"
    columns = {"time_s": t_s, "power": heater, "T_degC": response + disturbance + noise}
    pd.DataFrame(columns).to_csv(table, index=False)
    words = ["identify", table, "--input", "power", "--output", "T", "--hold", "zoh"]
    options = ["--model", "P1", "--noise", "white", "--no-check", "--quiet"]
    code = tcdyn(*words, *options)
    content = json.loads(table.with_suffix(".identified.json").read_text(encoding="utf-8"))
    assert code == 1
    assert "models.none" in [finding["code"] for finding in content["findings"]]
    capsys.readouterr()
    assert tcdyn("tune", table.with_suffix(".identified.json")) == 1
    assert "is not to be relied on" in capsys.readouterr().err
