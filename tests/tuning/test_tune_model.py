"""Settings of identified models: the whole result, its ranges, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import Identified, from_control, process, several, tune
from tcdyn.tuning.tune import MAX_UNSTABLE_SHARE
from tests.tuning.tuning_cases import HEATER, model

PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("few_draws")
def test_simc_settings_of_a_model_have_units() -> None:
    tuning = tune(model("P1D", HEATER))
    assert tuning.controller.ideal.gain == pytest.approx(180 / (0.6 * 30))
    assert tuning.controller.ideal.integral_s == pytest.approx(120)
    assert tuning.gain_unit == "%/K"
    assert tuning.action == "reverse"
    frame = tuning.to_frame()
    assert frame.loc["Ki", "unit"] == "%/K/s"
    assert frame.loc["load_iae", "unit"] == "K/% s"
    text = tuning.summary()
    for part in ("parallel", "ideal", "series", "95 % of draws", "proportional band"):
        assert part in text


def test_json_of_the_result_has_every_form() -> None:
    tuning = tune(model("P2D", {**HEATER, "Tp2": 30.0}), controller="pid", sample_s=2.0)
    content = json.loads(json.dumps(tuning.to_dict(), allow_nan=False))
    assert content["schema"] == "tcdyn.tuning/1"
    settings = content["settings"]
    c = tuning.controller
    assert settings["parallel"] == {"Kp": c.kp, "Ki_per_s": c.ki, "Kd_s": c.kd, "Tf_s": c.filter_s}
    assert settings["ideal"]["Ti_s"] == pytest.approx(c.kp / c.ki)
    assert settings["series"]["Td_s"] == pytest.approx(30.0)
    assert settings["sampled"]["integral_factor"] == pytest.approx(2 * c.ki)
    assert content["reduced_model"]["dead_time_s"] == pytest.approx(16.0)  # half a sample more
    assert content["draws"] == 500


@pytest.mark.usefixtures("few_draws")
def test_every_key_is_documented() -> None:
    section = PAGE.partition("## `tune.json`")[2].partition("\n## ")[0]
    tuning = tune(model("P1D", HEATER), sample_s=1.0)

    def keys(data: Any) -> Iterator[str]:
        if isinstance(data, dict):
            for key, value in data.items():
                yield key
                if key != "findings":
                    yield from keys(value)

    assert [key for key in keys(tuning.to_dict()) if f"`{key}`" not in section] == []


@pytest.mark.usefixtures("few_draws")
def test_ranges_contain_the_model_and_grow_with_its_uncertainty() -> None:
    widths = []
    for u in (0.01, 0.05):
        ms = tune(model("P1D", HEATER, u)).margins["ms"]
        assert ms.low95 < ms.value < ms.high95 <= ms.worst
        widths.append(ms.high95 - ms.low95)
    assert widths[1] / widths[0] == pytest.approx(5, rel=0.5)


def test_range_of_the_gain_margin_is_that_of_the_gain() -> None:
    """Only the gain is uncertain: its quantiles turn into those of the margin."""
    structure = process("P1D", fixed={"Tp1": 180.0, "Td": 15.0})
    uncertain = Identified.of(structure, HEATER, np.array([[0.06**2]]))
    margin = tune(uncertain).margins["gain_margin"]
    low, high = (margin.value / (1 + sign * 1.96 * 0.1) for sign in (1, -1))
    assert (margin.low95, margin.high95) == pytest.approx((low, high), rel=0.05)


@pytest.mark.usefixtures("few_draws")
def test_a_negative_gain_gives_negative_settings() -> None:
    plus, minus = (tune(model("P1D", {**HEATER, "Kp": k})) for k in (0.6, -0.6))
    assert minus.controller.kp == -plus.controller.kp
    assert minus.action == "direct"
    assert "direct acting" in minus.summary()
    assert minus.margins["ms"].value == pytest.approx(plus.margins["ms"].value)


@pytest.mark.usefixtures("few_draws")
def test_an_integrating_model() -> None:
    tuning = tune(model("P0DI", {"Kp": 0.01, "Td": 5.0}))
    assert tuning.controller.ideal.integral_s == pytest.approx(40.0)
    assert tuning.margins["ms"].value == pytest.approx(1.70, abs=0.01)
    assert "integrator 0.01 K/%/s" in tuning.summary().replace("(", "").replace(")", "")


@pytest.mark.usefixtures("few_draws")
def test_several_inputs_need_the_name_of_one() -> None:
    structure = several(["P1D", "P1"], ["heater_percent", "fan_percent"])
    theta = {
        "Kp.heater_percent": 0.6,
        "Tp1.heater_percent": 180.0,
        "Td.heater_percent": 15.0,
        "Kp.fan_percent": -0.2,
        "Tp1.fan_percent": 90.0,
    }
    both = Identified.of(
        structure,
        theta,
        np.diag(np.square([0.01 * abs(theta[n]) for n in structure.free])),
        input_name="heater_percent, fan_percent",
        output_name="T1_degC",
    )
    with pytest.raises(InputError, match="heater_percent, fan_percent") as refused:
        both.tune()
    assert "input=heater_percent" in str(refused.value)
    assert both.tune("heater").controller.kp > 0
    assert both.tune("fan", tau_c_s=20.0).controller.kp < 0
    with pytest.raises(InputError, match="pump"):
        both.tune("pump")


@pytest.mark.usefixtures("few_draws")
def test_a_model_without_dead_time_gets_the_interval_of_its_record() -> None:
    tuning = tune(model("P1", {"Kp": 0.6, "Tp1": 180.0}, dt_s=4.0))
    assert tuning.tau_c_s == 4.0
    without_record = Identified.of(
        process("P1"), {"Kp": 0.6, "Tp1": 180.0}, np.diag([1e-4, 1.0]), dt_s=0.0
    )
    with pytest.raises(InputError, match="give tau_c_s=18"):
        tune(without_record)
    assert tune(without_record, tau_c_s=18.0).controller.ideal.gain == pytest.approx(10 / 0.6)


def test_a_control_system_without_uncertainty() -> None:
    import control

    tuning = tune(from_control(control.tf([2.0], [80.0, 1.0]), delay_s=10.0))
    assert tuning.controller.ideal.gain == pytest.approx(2.0)
    assert np.isnan(tuning.margins["ms"].low95)
    assert tuning.to_dict()["margins"]["ms"]["low95"] is None
    assert "draws" not in tuning.summary().split("model has no")[0].split("worst")[0]


@pytest.mark.usefixtures("few_draws")
def test_an_oscillating_model_is_refused_by_simc_and_tuned_by_the_other_rule() -> None:
    oscillating = model("P2U", {"Kp": 1.0, "Tw": 20.0, "Zeta": 0.2})
    with pytest.raises(InputError, match=r"oscillates.*rule=robust"):
        tune(oscillating)
    robust = tune(oscillating, rule="robust")
    assert robust.margins["ms"].value == pytest.approx(1.4, rel=2e-3)
    assert robust.reduced is None
    assert "at most 1.4" in robust.summary()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"max_ms": 1.3}, "max_ms belongs to the rule robust"),
        ({"rule": "robust", "tau_c_s": 3.0}, "tau_c_s belongs to the rule simc"),
        ({"rule": "ziegler"}, "simc or robust"),
        ({"tau_c_s": 0.0}, "tau_c_s is 0"),
        ({"sample_s": -1.0}, "sample_s is -1"),
    ],
)
def test_wrong_options_are_refused(options, text: str) -> None:
    with pytest.raises(InputError, match=text):
        tune(model("P1D", HEATER), **options)


def test_a_model_without_static_gain_is_refused() -> None:
    with pytest.raises(InputError, match="no lasting effect"):
        tune(model("P1D", {**HEATER, "Kp": 0.0}))


@pytest.mark.usefixtures("few_draws")
def test_a_file_and_a_fit_give_the_same_settings(tmp_path) -> None:
    identified = model("P1D", HEATER)
    path = tmp_path / "heater.identified.json"
    path.write_text(identified.to_json(), encoding="utf-8")
    pd.testing.assert_frame_equal(tune(path).to_frame(), tune(identified).to_frame())


def test_a_share_of_unstable_draws_is_counted() -> None:
    """Kp of the sign that is wrong in Phi(-1.5) of the draws."""
    structure = process("P1D", fixed={"Tp1": 180.0, "Td": 15.0})
    doubtful = Identified.of(structure, HEATER, np.array([[0.4**2]]))
    tuning = tune(doubtful, tau_c_s=100.0)
    assert tuning.unstable_share == pytest.approx(0.067, abs=5 * 0.25 / np.sqrt(500))
    assert tuning.unstable_share > MAX_UNSTABLE_SHARE
    assert tuning.findings[0].severity.value == "error"
    assert tuning.to_dict()["margins"]["ms"]["worst"] is None
