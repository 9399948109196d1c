"""Identification of the plant without its sensor, whose lag is known with its uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import tcdyn
from tcdyn.chain import Chain
from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tcdyn.identification import IOData, compare, read_identified
from tcdyn.identification.plant import KnownSensor
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors.file import specified_sensor, write_sensor
from tcdyn.workflows.identify import identify

OPTIONS = {"noise": "white", "baseline": "none", "initial": "equilibrium", "check": False}
LAG_S, SENSOR_S, DEAD_S = 20.0, 6.0, 3


def one_lag(u: np.ndarray, lag_s: float) -> np.ndarray:
    """Exact response of a lag to values held for 0.1 s."""
    a = np.exp(-0.1 / lag_s)
    return lfilter([0.0, 1 - a], [1.0, -a], u)


def levels() -> np.ndarray:
    """A heater in levels, rows of 1 s."""
    return np.repeat([0.0, 50.0, 10.0, 80.0, 30.0], 80)


def record(noise: float = 0.1) -> IOData:
    """Gain 1.5, a lag of 20 s and a dead time of 3 s, behind a sensor of 6 s."""
    u = levels()
    fine = np.repeat(u, 10)
    delayed = np.concatenate([np.zeros(10 * DEAD_S), fine])[: len(fine)]
    slow, fast = (one_lag(delayed, lag_s)[::10] for lag_s in (LAG_S, SENSOR_S))
    # partial fractions: exact for two different lags
    reading = 1.5 * (LAG_S * slow - SENSOR_S * fast) / (LAG_S - SENSOR_S)
    reading = reading + noise * np.random.default_rng(5).normal(size=len(u))
    return IOData.from_arrays(u, reading, 1.0, hold="zoh")


def test_the_plant_is_that_without_the_sensor() -> None:
    comparison = compare(record(), "P1D", sensor=Chain(SENSOR_S), **OPTIONS)
    best = comparison.best.identified
    for name, value in {"Kp": 1.5, "Tp1": LAG_S, "Td": DEAD_S}.items():
        # 4 standard uncertainties: 1 in 16 000
        assert best.theta[name] == pytest.approx(value, abs=4 * best.estimates[name].u), name
    assert best.lag_s.value == pytest.approx(LAG_S + DEAD_S, abs=4 * best.lag_s.u)
    assert [f.code for f in best.findings] == ["model.without_sensor"]
    # the simulated output is that of the plant, not the reading
    step = best.simulate(np.repeat([0.0, 1.0], [1, 60]), 1.0, "zoh")
    expected = 1.5 * (1 - np.exp(-(60 - 1 - best.theta["Td"]) / best.theta["Tp1"]))
    assert step[-1] - best.offset == pytest.approx(expected, rel=0.01)


def test_the_uncertainty_of_the_sensor_is_in_that_of_the_plant() -> None:
    exact, uncertain = (
        compare(record(), "P1D", sensor=KnownSensor(Chain(SENSOR_S), u_s), **OPTIONS).best
        for u_s in (0.0, 0.5)
    )
    assert uncertain.identified.theta == exact.identified.theta
    # the sum of both lags is known well, so the plant has about the error of the sensor; a one-lag
    # plant behind a wrong sensor takes a little of it into its dead time
    expected = np.hypot(exact.lag_s.u, 0.5)
    assert uncertain.lag_s.u == pytest.approx(expected, rel=0.3)
    assert uncertain.identified.covariance[0, 0] >= exact.identified.covariance[0, 0]


def test_a_lag_that_is_only_stated_may_be_divided() -> None:
    known, stated = (
        compare(record(), "P1D", sensor=given, **OPTIONS).best
        for given in (Chain(SENSOR_S), SENSOR_S)
    )
    assert stated.estimates["Td"].u > 1.5 * known.estimates["Td"].u


def test_a_dead_time_and_a_filter_of_the_sensor_are_no_part_of_the_plant() -> None:
    sensor = Chain(SENSOR_S - 1.0, delay_s=1.0)
    with_delay = compare(record(), "P1D", sensor=sensor, **OPTIONS).best.identified
    without = compare(record(), "P1D", sensor=Chain(SENSOR_S - 1.0), **OPTIONS).best.identified
    assert without.theta["Td"] - with_delay.theta["Td"] == pytest.approx(1.0, abs=1e-3)
    filtered = Chain(SENSOR_S, conditioning=Conditioning(0.2, 2))
    plant = compare(record(), "P1D", sensor=filtered, **OPTIONS).best.identified
    assert plant.model.known.den == (1.0,)


@pytest.mark.parametrize("given", ["probe.sensor.json", object(), -1.0, (1.0, -1.0), (12.0,)])
def test_a_sensor_that_is_none_is_refused(given: object) -> None:
    with pytest.raises(InputError):
        compare(record(), "P1D", sensor=given, **OPTIONS)


def table(folder: Path) -> Path:
    """The record as a file."""
    data = record()
    path = folder / "heater.csv"
    columns = {"time_s": np.arange(400.0), "heater": levels(), "T_degC": data.outputs[:, 0]}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def test_the_sensor_of_a_file_is_that_of_its_column(tmp_path: Path) -> None:
    file = specified_sensor("probe", ["T_degC"], [(SENSOR_S, 0.3)])
    path = write_sensor(file, tmp_path / "probe.sensor.json")
    options = {"model": "P1D", "noise": "white", "baseline": "none", "hold": "zoh", "sensor": path}
    found = identify(table(tmp_path), "heater", "T", **options)["T"]
    lag = found.comparison.best.lag_s
    assert abs(lag.value - LAG_S - DEAD_S) < 3 * lag.u
    of_column = tcdyn.identify(record(), "P1D", sensor=file["T_degC"], **OPTIONS).best.lag_s
    assert of_column.value == pytest.approx(lag.value, rel=1e-6)
    other = specified_sensor("probe", ["T2_degC"], [(SENSOR_S, 0.3)])
    wrong = write_sensor(other, tmp_path / "other.sensor.json")
    with pytest.raises(InputError, match="has no sensor for T"):
        identify(table(tmp_path), "heater", "T", **{**options, "sensor": wrong})


def test_the_command_writes_the_plant(tmp_path: Path) -> None:
    out = tmp_path / "plant.identified.json"
    words = ["identify", table(tmp_path), "-u", "heater", "-y", "T", "--model", "P1D"]
    options = ["--noise", "white", "--hold", "zoh", "--sensor", "6+-0.3", "--out", out, "--quiet"]
    assert run(lambda: app([str(word) for word in (*words, *options)])) == 0
    model = read_identified(out)
    assert abs(model.lag_s.value - LAG_S - DEAD_S) < 3 * model.lag_s.u
    assert any(f.code == "model.without_sensor" for f in model.findings)


def test_a_filter_is_given_once(tmp_path: Path) -> None:
    file = specified_sensor("probe", ["T_degC"], [(SENSOR_S, 0.3)])
    filtered = file.model_copy(update={"conditioning": Conditioning(0.5, 2)})
    with pytest.raises(InputError, match="cutoff_Hz"):
        identify(table(tmp_path), "heater", "T", model="P1D", sensor=filtered, cutoff_Hz=1.0)


def test_settings_for_a_plant_without_its_sensor_come_with_a_warning() -> None:
    comparison = compare(record(), "P1D", sensor=Chain(SENSOR_S), **OPTIONS)
    codes = [finding.code for finding in comparison.best.tune().findings]
    assert "tune.model" in codes
    assert "tune.reading" not in codes
