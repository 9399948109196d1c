"""Each finding about settings of a controller: when it is made, and that its message is made."""

from __future__ import annotations

from typing import Any

import pytest

from tcdyn.core.findings import Severity, error, info, warning
from tcdyn.core.messages.tune import TUNE
from tcdyn.identification import tune
from tests.tuning.tuning_cases import HEATER, model

WARNING, INFO, ERROR = Severity.WARNING, Severity.INFO, Severity.ERROR
TROUBLE = warning("from_file", text="The record is nothing")

CASES: dict[str, tuple[Any, dict[str, Any], Severity, str]] = {
    "tune.unstable_model": (model("P1D", HEATER), {"sample_s": 300.0, "tau_c_s": 1.0}, ERROR, ""),
    "tune.unstable": (model("P1D", HEATER, 0.5), {}, ERROR, "tau_c_s=30"),
    "tune.not_robust": (model("P1D", HEATER), {"tau_c_s": 3.0}, WARNING, "tau_c_s=6"),
    "tune.undetermined": (model("P1D", HEATER, 0.15), {}, WARNING, "tau_c_s=30"),
    "tune.model": (
        model("P1D", HEATER, findings=(TROUBLE,)),
        {},
        WARNING,
        "The record is nothing",
    ),
    "tune.slow_sampling": (
        model("P1D", HEATER),
        {"sample_s": 60.0, "tau_c_s": 80.0},
        WARNING,
        "sample every",
    ),
    "tune.no_dead_time": (model("P1", {"Kp": 1.0, "Tp1": 60.0}), {}, INFO, "60 times shorter"),
    "tune.derivative": (
        model("P2D", {**HEATER, "Tp2": 60.0}),
        {},
        INFO,
        "controller=pid",
    ),
    "tune.no_distribution": (model("P1D", HEATER, 0.0), {}, INFO, "no uncertainty"),
    "tune.reading": (model("P1D", HEATER), {}, INFO, "the sensor of T1_degC"),
}


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("code", CASES)
def test_finding_is_made_with_its_remedy(code: str) -> None:
    identified, options, severity, text = CASES[code]
    found = {finding.code: finding for finding in tune(identified, **options).findings}
    assert code in found
    assert found[code].severity is severity
    assert text in found[code].sentence


def test_every_code_is_tested() -> None:
    assert set(CASES) == set(TUNE)


@pytest.mark.usefixtures("few_draws")
def test_a_model_that_was_rejected_is_an_error() -> None:
    rejected = model("P1D", HEATER, findings=(error("from_file", text="None is good enough"),))
    found = {finding.code: finding for finding in tune(rejected).findings}
    assert found["tune.model"].severity is ERROR


@pytest.mark.usefixtures("few_draws")
def test_good_settings_have_no_warning() -> None:
    findings = tune(model("P1D", HEATER)).findings
    assert [each for each in findings if each.severity is not INFO] == []


@pytest.mark.usefixtures("few_draws")
def test_robust_rule_is_told_a_smaller_limit() -> None:
    found = tune(model("P1D", HEATER, 0.3), rule="robust", max_ms=1.9).findings[0]
    assert "max_ms=1.2" in found.sentence


@pytest.mark.usefixtures("few_draws")
def test_residuals_that_follow_the_input_are_a_trouble_of_the_model() -> None:
    sentence = "Residuals follow the input"
    doubtful = model("P1D", HEATER, statistics={"p_input": 1e-6}, sentence=sentence)
    assert sentence in doubtful.plant().troubles
    clean = model("P1D", HEATER, statistics={"p_input": 0.5}, sentence="Residuals are white")
    assert clean.plant().troubles == ()
    unsure = warning("fit.undetermined", subject="Tp2", u=3.0, value=4.0)
    assert model("P1D", HEATER, findings=(unsure,)).plant().troubles == ()
    noted = model("P1D", HEATER, findings=(info("from_file", text="a note"),))
    assert noted.plant().troubles == ()


@pytest.mark.usefixtures("few_draws")
def test_other_quantities_than_temperatures_have_no_note_about_a_sensor() -> None:
    findings = tune(model("P1D", HEATER, output_name="p_bar")).findings
    assert "tune.reading" not in [each.code for each in findings]
