"""The ratio of two lags: its uncertainty, what is shared, and warnings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.sensors import SensorFile, compare_sensors, sensor_file
from tests.cli.test_main_job import tcdyn as run_cli


def of_noise(lag_s: float, u_s: float, **fit: Any) -> SensorFile:
    """A sensor file of one column."""
    covariance = np.array([[u_s**2]])
    return sensor_file("s", {"T1": Chain(lag_s)}, "noise", covariance, [0.0], fit=fit)


def test_the_ratio_has_the_uncertainty_of_both() -> None:
    ratio = compare_sensors([of_noise(2.0, 0.04), of_noise(2.2, 0.044)]).ratios[0]
    assert ratio.ratio.value == pytest.approx(1.1)
    assert ratio.ratio.u == pytest.approx(1.1 * np.hypot(0.02, 0.02), rel=0.01)
    assert ratio.differs
    assert not compare_sensors([of_noise(2.0, 0.04), of_noise(2.1, 0.04)]).ratios[0].differs


def test_intervals_hold_the_true_ratio() -> None:
    """400 pairs: a coverage of 95 % is below 92 % with a probability of 0.5 %."""
    rng = np.random.default_rng(1)
    held = 0
    for first, second in 1 + 0.05 * rng.standard_normal((400, 2)):
        pair = [of_noise(2 * first, 0.1), of_noise(3 * second, 0.15)]
        held += compare_sensors(pair).ratios[0].ratio.contains(1.5)
    assert 0.92 < held / 400 < 0.98


def test_what_is_shared_cancels_between_sensors_of_one_design() -> None:
    pair = [of_noise(2.0, 0.2, tail_u_s=0.19), of_noise(2.2, 0.22, tail_u_s=0.209)]
    apart = compare_sensors(pair).ratios[0]
    alike = compare_sensors(pair, same_design=True).ratios[0]
    assert apart.shared_share == pytest.approx(0.95**2)
    assert alike.shared_share == pytest.approx(0.0, abs=1e-9)
    assert alike.ratio.u == pytest.approx(1.1 * np.sqrt(2 * 0.1**2 * (1 - 0.95**2)), rel=0.01)
    assert alike.differs
    assert not apart.differs


def test_two_columns_of_one_file_have_its_covariance() -> None:
    covariance = 0.01 * np.array([[1.0, 0.99], [0.99, 1.0]])
    pair = sensor_file("p", {"T1": Chain(1.0), "T2": Chain(1.0)}, "pair", covariance, [0.0, 0.0])
    ratio = compare_sensors([pair]).ratios[0]
    assert ratio.name == "p T2"
    assert ratio.ratio.u == pytest.approx(0.1 * np.sqrt(2 * 0.01), rel=0.01)


def test_other_conditions_and_single_dips_are_warnings() -> None:
    dip = of_noise(2.0, 0.1).model_copy(update={"method": "plunge"})
    compared = compare_sensors([of_noise(2.0, 0.1), dip])
    assert [each.code for each in compared.findings] == ["ratio.conditions", "ratio.one_dip"]


def test_one_sensor_is_refused() -> None:
    with pytest.raises(InputError, match="1 sensors to compare; expected at least two"):
        compare_sensors([of_noise(2.0, 0.1)])


def test_the_command_prints_and_writes_the_ratio(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [of_noise(lag, 0.05).write(tmp_path / f"{lag}.json") for lag in (2.0, 3.0, 2.0)]
    assert run_cli("sensor", "compare", *files, "--out", tmp_path / "out.json") == 2
    assert "2.0.json: is given twice" in capsys.readouterr().err
    assert run_cli("sensor", "compare", *files[:2], "--out", tmp_path / "out.json") == 0
    assert "excludes 1" in capsys.readouterr().out
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["ratios"][0]["ratio"]["value"] == pytest.approx(1.5)
