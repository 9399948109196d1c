"""Stages of a dip: a film that settles, a bath that relaxes, a stem that conducts; few readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.sensors import sensor_from_dip
from tcdyn.sensors.file import percent_times
from tcdyn.sensors.plunge import plunge_sensor
from tcdyn.sensors.step_stages import STAGES, Fin, RelaxingBath, SettlingFilm
from tcdyn.sensors.step_structures import StepStructure
from tests.sensors.fin_world import exposed_junction
from tests.sensors.hand_study import KINDS, judge

OTHERS = Chain((0.3,), delay_s=1.0, conditioning=NO_CONDITIONING)
EVEN = {"log_bead": -9.0, "log_bead_lag": 0.4, "log_free": 3.0, "log_ratio": 0.0}
LONG = EVEN | {"log_depth": 3.0, "log_outside": -2.0}


def by_steps(change: float, settling_s: float, t: Array) -> Array:
    """Two lags of 2 and 0.3 s after 1 s, the first one of a film that settles, by small steps."""
    finer = 400
    dt_s = float(t[1] - t[0]) / finer
    first, second = 0.0, 0.0
    out = []
    for k in range((len(t) - 1) * finer + 1):
        if k % finer == 0:
            out.append(second)
        since_s = (k + 0.5) * dt_s - OTHERS.delay_s
        if since_s > 0:
            film = 1 + change * np.exp(-since_s / settling_s)
            before = first
            first += dt_s * film / 2.0 * (1 - first)
            second += dt_s / OTHERS.taus_s[0] * (0.5 * (before + first) - second)
    return np.array(out)


@pytest.mark.parametrize("change", [-0.5, 1.0])
def test_response_is_that_of_a_lag_that_changes(change: float) -> None:
    t = 0.1 * np.arange(100)
    values = {"tau1_s": 2.0, "film_change": change, "settling_s": 0.4}
    structure = StepStructure(1, NO_CONDITIONING, stage="film")
    found = structure.response(OTHERS, values, t)
    assert found == pytest.approx(by_steps(change, 0.4, t), abs=2e-3)


def test_a_relaxing_bath_is_followed_by_a_lag() -> None:
    t = 0.01 * np.arange(2000)
    values = {"bath_share": 0.05, "log_bath": float(np.log(2.0))}
    bath = 1 - 0.05 * -np.expm1(-t / 3.0)
    chain = Chain((1.5,), conditioning=NO_CONDITIONING)
    expected = chain.response(bath, 0.01, "foh", "zero")
    found = RelaxingBath().response(values, 1.5, t)
    assert found == pytest.approx(expected, abs=5e-5)
    alone = RelaxingBath().sensor_response(values, 1.5, t)
    assert alone == pytest.approx(1 - np.exp(-t / 1.5), abs=1e-12)


@pytest.mark.parametrize("stage", [SettlingFilm(), RelaxingBath()])
def test_without_a_change_it_is_a_lag(stage: SettlingFilm | RelaxingBath) -> None:
    t = np.linspace(0.0, 10.0, 50)
    assert stage.response(stage.means(), 2.0, t) == pytest.approx(1 - np.exp(-t / 2), abs=1e-12)
    assert stage.sensor_lag_s(stage.means(), 2.0) == 2.0


def test_a_long_even_wire_is_a_lag() -> None:
    t = np.linspace(0.0, 20.0, 300)
    assert Fin().gain(LONG) == pytest.approx(1.0, abs=1e-6)
    assert Fin().response(LONG, 2.0, t) == pytest.approx(1 - np.exp(-t / 2), abs=1e-4)


@pytest.mark.parametrize(("ratio", "depth_m"), [(1.0, 0.012), (3.0, 0.02)])
def test_a_stem_that_conducts_is_that_of_finite_volumes(ratio: float, depth_m: float) -> None:
    wire_m, bead_m, free_m = 0.5e-3, 0.9e-3, 5e-3
    h, h_bead, h_outside, conductivity, capacity = 150.0, 110.0, 20.0, 25.0, 4e6
    inside = np.linspace(0, depth_m, 201)
    edges = np.r_[inside, depth_m + np.linspace(0, 0.4, 801)[1:]]
    width = np.diff(edges)
    middle = edges[1:] - width / 2
    diameter_m = np.where(middle < free_m, wire_m, ratio * wire_m)
    is_immersed = middle < depth_m
    surface_h = np.where(middle < free_m, h, h / np.sqrt(ratio))
    surface_h = np.where(is_immersed, surface_h, h_outside)
    sensor, gain = exposed_junction(
        bead_m, width, diameter_m, surface_h, is_immersed, h_bead, conductivity, capacity
    )
    lag_s = capacity * wire_m / (4 * h)
    decay_m = np.sqrt(conductivity * wire_m / (4 * h))
    stem_decay_m = decay_m * ratio**0.75
    bead = h_bead * bead_m**2 * decay_m / (conductivity * wire_m**2 / 2)
    values = {
        "log_bead": np.log(bead),
        "log_bead_lag": np.log(capacity * bead_m / (6 * h_bead) / lag_s),
        "log_free": np.log(free_m / decay_m),
        "log_ratio": np.log(ratio),
        "log_depth": np.log((depth_m - free_m) / stem_decay_m),
        "log_outside": np.log(h_outside / (ratio * h)),
    }
    fin = Fin()
    assert fin.gain(values) == pytest.approx(gain, abs=2e-3)
    t = np.linspace(0.05, 20, 200) * lag_s
    assert fin.response(values, lag_s, t) == pytest.approx(sensor.step(t), abs=3e-3)
    assert fin.sensor_lag_s(values, lag_s) == pytest.approx(sensor.lag_s, rel=0.01)
    lags_s, zero_s = fin.lags_and_zero(values, lag_s)
    assert sum(lags_s) - zero_s == pytest.approx(fin.sensor_lag_s(values, lag_s))


def test_percent_times_are_those_of_a_lag() -> None:
    t = np.linspace(0, 30, 3001)
    expected = [2 * np.log(2), 2.0, 2 * np.log(10)]
    assert percent_times(t, 1 - np.exp(-t / 2)) == pytest.approx(expected, abs=1e-4)


def dip(stage: str, values: dict[str, float], seed: int) -> tuple[Array, Array, list[float]]:
    """Rows of a dip of 3 s whose only lag a stage replaces, with noise of 0.05 K; its times."""
    t = 0.1 * np.arange(500)
    at_once = Chain((), conditioning=NO_CONDITIONING)
    structure = StepStructure(1, NO_CONDITIONING, stage=stage)
    later = Chain((), delay_s=6.0, conditioning=NO_CONDITIONING)
    response = structure.response(later, values, t)
    noise_K = 0.05 * np.random.default_rng(seed).standard_normal(len(t))
    fine = np.linspace(0, 40, 8001)
    exact = structure.response(at_once, values, fine, of_dip=False)
    return t, 20 + 60 * response + noise_K, percent_times(fine, exact)


@pytest.mark.e2e
@pytest.mark.parametrize("change", [-0.5, 1.0])
def test_a_dip_by_hand_gives_the_lag_of_the_settled_flow(change: float) -> None:
    values = {"tau1_s": 3.0, "film_change": change, "settling_s": 0.5}
    t, y, times = dip("film", values, 4)
    found = plunge_sensor(t, y, "T")
    lag = found.chain.channels["T"].lag_s
    assert abs(lag.value - 3.0) < 2.5 * lag.u
    assert lag.u < 0.3
    for estimate, true_s in zip(found.times["T"].values(), times):
        assert abs(estimate.value - true_s) < 3 * estimate.u
    (finding,) = [f for f in found.findings if f.code == "sensor.settles"]
    assert finding.numbers["ratio"] == pytest.approx(1 + change, rel=0.4)
    assert found.fit["film_ratio"] == pytest.approx(1 + change, rel=0.4)


@pytest.mark.e2e
def test_a_bath_that_falls_is_named_and_not_in_the_lag() -> None:
    values = {"tau1_s": 3.0, "bath_share": 0.06, "log_bath": 1.0}
    t, y, _ = dip("bath", values, 5)
    found = plunge_sensor(t, y, "T")
    lag = found.chain.channels["T"].lag_s
    assert abs(lag.value - 3.0) < 2.5 * lag.u
    assert lag.u < 0.4
    assert found.fit["bath_share"] == pytest.approx(-0.06, abs=0.02)
    assert "sensor.bath" in {f.code for f in found.findings}


def test_a_stem_that_conducts_is_named_with_its_share() -> None:
    values = EVEN | {"tau1_s": 2.0, "log_bead": -1.0, "log_free": 0.3, "log_ratio": 1.0}
    values |= {"log_depth": 0.3, "log_outside": -2.5}
    t, y, times = dip("fin", values, 6)
    found = plunge_sensor(t, y, "T")
    lag = found.chain.channels["T"].lag_s
    assert abs(lag.value - STAGES["fin"].sensor_lag_s(values, 2.0)) < 3 * lag.u
    for estimate, true_s in zip(found.times["T"].values(), times):
        assert abs(estimate.value - true_s) < 3 * estimate.u
    share = found.fit["reached_share"]
    assert abs(share["value"] - Fin().gain(values)) < 3 * share["u"]
    assert "sensor.fin" in {f.code for f in found.findings}


@pytest.mark.e2e
def test_a_stopwatch_table_gives_a_lag(tmp_path: Path) -> None:
    seconds = np.array([0, 5, 10, 15, 20, 30, 40, 50, 60, 80, 100, 120, 150])
    readings = np.round(21.5 + 64.4 * -np.expm1(-seconds / 16.8), 1)
    lines = ["time_s,T_degC", *(f"{t},{y}" for t, y in zip(seconds, readings))]
    table = tmp_path / "stopwatch.csv"
    table.write_text("\n".join(lines), encoding="utf-8")
    lag = sensor_from_dip(table, entry_s=(0.0, 0.3)).chain.channels["T_degC"].lag_s
    assert abs(lag.value - 16.8) < 2.5 * lag.u
    assert lag.u < 0.6


@pytest.mark.study
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_dips_as_people_make_them_are_covered(kind: str) -> None:
    """Few draws; 40 of each are in `python -m tests.sensors.hand_study`."""
    results = [judge(kind, k, 1700) for k in range(5)]
    table = np.array([result[0] for result in results if not isinstance(result, str)])
    assert len(table) >= 4
    assert np.mean(np.abs(table[:, :4]) < 1.96) >= 0.7
    assert np.abs(table[:, 1:4]).max() < 4


@pytest.mark.long
@pytest.mark.e2e
def test_the_mean_of_a_logger_is_not_part_of_the_lag() -> None:
    dt_s, mean_s = 0.5, 2.0
    t = dt_s * np.arange(200)
    chain = Chain((4.0,), delay_s=10.3, mean_s=mean_s, conditioning=NO_CONDITIONING)
    noise_K = 0.02 * np.random.default_rng(8).standard_normal(len(t))
    y = 20 + 60 * chain.response(np.ones(len(t)), dt_s, "zoh", "zero") + noise_K
    alone = sensor_from_dip((t, y), "T_Avg", averages_s=mean_s)
    lag = alone.chain.channels["T_Avg"].lag_s
    assert abs(lag.value - 4.0) < 2.5 * lag.u
    assert lag.u < 0.4
    assert {"sensor.dip_means", "series.averages"} & {f.code for f in alone.findings} == {
        "sensor.dip_means"
    }
    unstated = sensor_from_dip((t, y), "T_Avg")
    assert "series.named_mean" in {f.code for f in unstated.findings}
    assert unstated.chain.channels["T_Avg"].lag_s.value > lag.value + 0.25 * mean_s


def test_the_spline_of_a_stem_is_that_of_many_times(monkeypatch: pytest.MonkeyPatch) -> None:
    fin = Fin()
    coarse: list[Array] = []
    fine: list[Array] = []
    for responses, times, nodes in ((coarse, 80, 12), (fine, 800, 18)):
        monkeypatch.setattr("tcdyn.sensors.step_stages.SPLINE_TIMES", times)
        monkeypatch.setattr("tcdyn.sensors.step_stages.TALBOT_NODES", nodes)
        rng = np.random.default_rng(0)
        for _ in range(30):
            values = {p.name: float(rng.normal(p.mean, p.sd)) for p in fin.parameters}
            values = {p.name: float(np.clip(values[p.name], p.low, p.high)) for p in fin.parameters}
            responses.append(fin.response(values, 1.0, np.linspace(0, 30, 400)))
    errors = np.abs(np.array(coarse) - np.array(fine)).max(axis=1)
    assert np.median(errors) < 1e-5
    assert errors.max() < 2e-4


@pytest.mark.e2e
@pytest.mark.parametrize(
    "seconds",
    [
        (0, 17, 34, 57, 80, 115, 161, 207, 264, 344, 459, 574, 746),
        (0, 5, 11, 15, 21, 30, 41, 50, 59, 80, 101, 120, 149),
        (0, 0.4, 0.93, 1.6, 2.2, 3.1, 4.05, 5.3, 7.7, 9.9, 13.4),
    ],
)
def test_readings_by_eye_are_taken_at_their_own_times(seconds: tuple[float, ...]) -> None:
    """Of these stamps a clock would be taken for one that wanders."""
    lag_s = seconds[-1] / 7
    readings = np.round(21.5 + 64.4 * -np.expm1(-np.array(seconds) / lag_s), 1)
    found = sensor_from_dip((seconds, readings), entry_s=(0.0, 0.02 * lag_s), unit="degC")
    lag = found.chain.channels["reading"].lag_s
    assert abs(lag.value - lag_s) < 2.5 * lag.u
    assert lag.u < 0.06 * lag_s
