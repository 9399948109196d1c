"""Several dips of one sensor. The dips are drawn by code of their own: log-normal between dips,
normal within one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors import SensorFile, read_sensor, sensor_file, sensor_from_dip
from tcdyn.sensors.dips import pool_dips
from tcdyn.sensors.random_effects import random_effects
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.sensor_world import write
from tests.sensors.test_sensor_plunge import plunged


def drawn(
    rng: np.random.Generator, count: int, spread: float, u: float
) -> tuple[list[Estimate], float]:
    """Estimates of dips of a sensor whose median lag is 1 s, and the lag of one further dip."""
    lags = np.exp(spread * rng.standard_normal(count + 1))
    us = u * rng.uniform(0.5, 2.0, count)
    values = lags[:-1] * (1 + us * rng.standard_normal(count))
    return [Estimate.normal(v, v * s) for v, s in zip(values, us)], float(lags[-1])


def coverage(draws: int, spreads: tuple[float, float], counts: tuple[int, ...]) -> list[float]:
    """Share of the intervals of a further dip, and of the mean, that hold the truth."""
    rng = np.random.default_rng(8)
    held = []
    for number in range(draws):
        spread = np.exp(rng.uniform(*np.log(spreads)))
        u = np.exp(rng.uniform(np.log(0.004), np.log(0.04)))
        dips, further = drawn(rng, counts[number % len(counts)], spread, u)
        pooled = random_effects(dips)
        held.append([pooled.next_estimate().contains(further), pooled.mean_estimate().contains(1)])
    return np.mean(held, axis=0).tolist()


def test_intervals_hold_a_further_dip_and_the_mean() -> None:
    """Sixty draws: a coverage of 95 % is below 87 % with a probability of 0.1 %."""
    assert min(coverage(60, (0.01, 0.2), (2, 3, 5))) > 0.85


@pytest.mark.study
@pytest.mark.parametrize("count", range(2, 9))
def test_coverage_for_each_number_of_dips(count: int) -> None:
    further, mean = coverage(400, (0.01, 0.2), (count,))
    print(f"{count} dips: further dip {100 * further:.1f} %, mean {100 * mean:.1f} %")
    assert min(further, mean) > 0.92


@pytest.mark.study
@pytest.mark.parametrize("count", [2, 3, 4])
def test_a_difference_of_heating_and_cooling_is_rarely_reported_where_there_is_none(
    count: int,
) -> None:
    rng = np.random.default_rng(77 + count)
    group = [0] * count + [1] * count
    reported = 0
    for _ in range(300):
        spread = np.exp(rng.uniform(*np.log((0.01, 0.2))))
        dips, _ = drawn(rng, 2 * count, spread, np.exp(rng.uniform(*np.log((0.004, 0.04)))))
        reported += random_effects(dips, group).groups_differ()
    print(f"{count} heated and {count} cooled: reported in {reported / 3:.1f} %")
    assert reported / 300 < 0.1


def test_many_dips_give_the_sample_s_spread_and_equal_dips_the_uncertainty_of_one() -> None:
    rng = np.random.default_rng(1)
    dips, _ = drawn(rng, 60, 0.1, 1e-4)
    log_lag = np.log([dip.value for dip in dips])
    pooled = random_effects(dips)
    assert np.log(pooled.mean_estimate().value) == pytest.approx(log_lag.mean(), abs=1e-3)
    assert pooled.median_spread == pytest.approx(log_lag.std(ddof=1), rel=0.05)
    assert pooled.next_estimate().u == pytest.approx(log_lag.std(ddof=1), rel=0.1)
    equal = random_effects([Estimate.normal(2.0, 0.02)] * 8, common_u=0.01)
    assert 0.02 <= equal.mean_estimate().u < 0.03  # errors that all dips share do not average out
    alone = random_effects([Estimate.normal(2.0, 0.02)] * 8)
    assert alone.mean_estimate().u < 0.012


def plunge_file(lag_s: float, u_s: float, up: bool = True, column: str = "T") -> SensorFile:
    """The file of one dip, as a plunge makes it."""
    return sensor_file(
        "s",
        {column: Chain([0.9 * lag_s, 0.1 * lag_s])},
        "plunge",
        np.array([[u_s**2]]),
        [0.1 * u_s],
        fit={
            "lag_s": Estimate.normal(lag_s, u_s).model_dump(),
            "step_K": 50.0 if up else -50.0,
        },
    )


def test_heating_and_cooling_are_reported_apart_where_they_differ() -> None:
    up = [plunge_file(lag, 0.02) for lag in (1.50, 1.55, 1.52)]
    alike = pool_dips([*up, *(plunge_file(lag, 0.02, False) for lag in (1.56, 1.49, 1.53))])
    assert "heating_lag_s" not in alike.fit
    assert not alike.findings
    slower = pool_dips([*up, *(plunge_file(lag, 0.02, False) for lag in (2.05, 2.00, 2.08))])
    assert [finding.code for finding in slower.findings] == ["sensor.directions"]
    assert slower.fit["heating_lag_s"]["value"] == pytest.approx(1.523, abs=0.01)
    assert slower.fit["cooling_lag_s"]["value"] == pytest.approx(2.043, abs=0.01)
    both = Estimate(**slower.fit["lag_s"])
    assert both.low95 < 1.50
    assert both.high95 > 2.08


def test_the_file_is_for_one_further_dip_and_says_what_limits_it() -> None:
    apart = pool_dips([plunge_file(lag, 0.01) for lag in (1.4, 1.5, 1.6)])
    channel = apart.chain.channels["T"]
    assert channel.lag_s.u == pytest.approx(apart.fit["lag_s"]["u"])
    assert channel.lag_s.value == pytest.approx(apart.fit["lag_s"]["value"])
    assert apart.fit["mean_lag_s"]["u"] < 0.6 * channel.lag_s.u
    assert channel.lag_s.u > 0.1  # the sample's standard deviation
    assert channel.taus_s[1] / channel.taus_s[0] == pytest.approx(1 / 9)
    assert "limited by the spread between dips" in apart.summary()
    noisy = pool_dips([plunge_file(lag, 0.3) for lag in (1.49, 1.5, 1.51)])
    assert "limited by noise" in noisy.summary()


def test_dips_that_are_not_of_one_sensor_are_refused() -> None:
    dip = plunge_file(1.5, 0.02)
    with pytest.raises(InputError, match="1 dips"):
        pool_dips([dip])
    with pytest.raises(InputError, match="columns T, T2"):
        pool_dips([dip, plunge_file(1.5, 0.02, column="T2")])
    stated = sensor_file("s", {"T": Chain(1.0)}, "stated", np.array([[0.01]]), [0.0])
    with pytest.raises(InputError, match="plunge"):
        pool_dips([dip, stated])


@pytest.mark.e2e
def test_the_command_with_two_dips(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = []
    for seed, taus in enumerate([(1.4,), (1.6,)]):
        t, y, _ = plunged(taus, 0.2, 100, 0.1, seed)
        logs.append(write(tmp_path / f"d{seed}.csv", time_s=np.round(t, 3), T1_degC=y))
    out = tmp_path / "p.sensor.json"
    words = ("sensor", "plunge", *logs, "--column", "T1")
    assert run_cli(*words, "--out", out, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    sensor = read_sensor(out)
    assert [source.file for source in sensor.inputs] == ["d0.csv", "d1.csv"]
    assert [dip["direction"] for dip in sensor.fit["dips"]] == ["heating", "heating"]
    assert sensor.chain.channels["T1_degC"].lag_s.u == printed["fit"]["lag_s"]["u"]
    assert sensor.chain.channels["T1_degC"].lag_s.u > 0.1
    assert run_cli("sensor", "plunge", logs[0], logs[0], "--column", "T1") == 2
    assert "names of one file" in capsys.readouterr().err
    assert run_cli(*words, "--entry-s", "3") == 2
    assert "2 dips" in capsys.readouterr().err


def test_a_result_is_printed_without_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_cli("sensor", "new", "--tau-s", "1.5+-0.1", "--column", "T1") == 0
    assert "lag 1.50 +- 0.10 s" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


@pytest.mark.e2e
def test_arrays_of_one_dip_that_are_given_twice_are_refused() -> None:
    t = 0.05 * np.arange(400)
    noise_K = 0.05 * np.random.default_rng(0).standard_normal(len(t))
    dip = (t, 20 + 60 * -np.expm1(-np.maximum(t - 4, 0) / 1.5) + noise_K)
    with pytest.raises(InputError, match="same content"):
        sensor_from_dip([dip, dip])
