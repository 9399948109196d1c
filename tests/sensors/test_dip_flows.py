"""Dips with one spread of all their times, compared with each other, and at several flows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.chain.law import FlowLaw
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors import SensorFile, read_sensor, sensor_from_dip
from tcdyn.sensors.dip_flows import DipFlows, chain_at, flow_effects, law_of_chain
from tcdyn.sensors.dips import dip_with_law, pool_dips
from tcdyn.sensors.file import step_times
from tcdyn.sensors.random_effects import random_effects, with_one_spread
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.dips_study import as_file, contradictions, coverage_of_dips
from tests.sensors.sensor_world import write
from tests.sensors.test_dips import plunge_file
from tests.sensors.test_sensor_plunge import plunged

LAW = FlowLaw(at=2.0, exponent=0.5, inner_share=0.2)


def lag_at(flow: float, u: float = 0.005) -> Estimate:
    """The lag of a sensor of 1.5 s at a flow of 2."""
    lag = 1.5 * float(LAW.factor(flow))
    return Estimate.normal(lag, u * lag)


def dip_at(flow: float, factor: float = 1.0, u: float = 0.005) -> SensorFile:
    """A dip of this sensor, all of whose times have a factor."""
    lag = lag_at(flow, u)
    return plunge_file(factor * lag.value, lag.u)


def test_lag_and_percent_times_have_one_spread_and_their_intervals_hold() -> None:
    """Eighty draws: a coverage of 95 % is below 88 % with a probability of 0.5 %."""
    assert coverage_of_dips(80, 3, 4).mean(axis=1).min() > 0.87


def test_the_spread_is_that_of_the_best_determined_time() -> None:
    lags = [Estimate.normal(lag, 0.2) for lag in (1.2, 1.5, 1.8)]
    times = [Estimate.normal(time, 0.001) for time in (1.00, 1.01, 1.02)]
    lag, time = with_one_spread([lags, times], [0.0, 0.0])
    assert lag.median_spread == time.median_spread
    assert time.median_spread == random_effects(times).median_spread


def test_a_dip_that_departs_is_named_with_the_lag_without_it() -> None:
    dips = [
        as_file([Estimate.normal(v, 0.01 * v) for v in (lag, lag, lag, 2 * lag)])
        for lag in (4.0, 4.1, 4.05, 4.12, 5.6)
    ]
    pooled = pool_dips(dips)
    named = [finding for finding in pooled.findings if finding.code == "sensor.dip_departs"]
    assert len(named) == 1
    assert named[0].numbers["dip"] == "dip 5"
    assert named[0].numbers["without_s"] == pytest.approx(4.07, abs=0.01)
    without = [Estimate(**row["without_s"]) for row in pooled.fit["dips"]]
    assert without[4].value == pytest.approx(4.07, abs=0.01)
    assert without[4].u < 0.5 * without[0].u
    like = pool_dips(dips[:4])
    assert not like.findings
    assert all("without_s" in row for row in like.fit["dips"])
    assert "without_s" not in pool_dips(dips[:2]).fit["dips"][0]


def test_a_known_law_is_a_random_effects_estimate_of_the_lags_moved_to_one_flow() -> None:
    flows = DipFlows("v", (1.0, 2.0, 4.0), exponent=(0.5, 0.0), inner_share=(0.2, 0.0))
    lags = [lag_at(v).scaled(f) for v, f in zip(flows.values, (1.02, 0.97, 1.01))]
    moved = [lag.scaled(1 / float(LAW.factor(v))) for lag, v in zip(lags, flows.values)]
    found = flow_effects(lags, flows, 0.0).lag_at(2.0).next_estimate()
    expected = random_effects(moved).next_estimate()
    assert found.value == pytest.approx(expected.value, rel=1e-9)
    assert found.u == pytest.approx(expected.u, rel=1e-9)


def test_many_dips_at_many_flows_determine_the_law_and_two_flows_leave_the_prior() -> None:
    values = tuple(np.geomspace(0.5, 8.0, 5).repeat(6).tolist())
    rng = np.random.default_rng(3)
    noise = np.exp(0.005 * rng.standard_normal(len(values)))
    lags = [lag_at(v).scaled(f) for v, f in zip(values, noise)]
    found = flow_effects(lags, DipFlows("v", values, exponent=(0.6, 0.3)), 0.0)
    assert abs(found.exponent.value - 0.5) < 2 * found.exponent.u < 0.2
    assert abs(found.inner_share.value - 0.2) < 2 * found.inner_share.u < 0.3
    film, inner = found.parts_s()
    assert film.value == pytest.approx(1.2, abs=2 * film.u)
    assert inner.value == pytest.approx(0.3, abs=2 * inner.u)
    two = flow_effects([lag_at(1.0), lag_at(4.0)], DipFlows("v", (1.0, 4.0)), 0.0)
    assert two.exponent.u > 0.08  # of a prior of 0.1
    assert two.law.correlation > 0.3
    assert two.lag_at(2.0).median_spread > 0.02  # the prior has a median of 0.05


def test_the_law_of_the_file_gives_the_lags_of_the_dips() -> None:
    flows = DipFlows("speed_m_s", (1.0, 1.0, 4.0, 4.0))
    pooled = pool_dips([dip_at(v) for v in flows.values], flows=flows)
    assert pooled.law is not None
    assert pooled.law.at == flows.at == 2.0
    assert pooled.fit["mean_lag_s"]["value"] == pytest.approx(1.5, rel=0.02)
    assert pooled.fit["film_s"]["value"] == pytest.approx(1.2, abs=2 * pooled.fit["film_s"]["u"])
    chain = pooled.chains[0]
    for flow in (1.0, 4.0):
        factor = pooled.law.factor([flow])
        others_s = chain.lag_s - max(chain.taus_s)
        lag = float(pooled.law.first_lag_s(chain, factor)[0]) + others_s
        assert lag == pytest.approx(lag_at(flow).value, rel=0.03)
    # all dips have lags of 0.9 and 0.1, whatever the film: their t90 over lag differ after the move
    t90_s = step_times(Chain([1.35, 0.15]))["t90_s"].value
    assert pooled.times["T"]["t90_s"].value == pytest.approx(t90_s, rel=0.05)


def test_a_film_that_is_longer_than_the_largest_lag_is_made_part_of_it() -> None:
    chain = Chain([0.8, 0.5], delay_s=0.2)
    moved = chain_at(chain, 2.0, 0.1)
    assert moved is not None
    assert moved.lag_s == pytest.approx(3.0)
    assert max(moved.taus_s) == pytest.approx(2.7)
    assert chain_at(Chain([0.8, 0.5], zero_s=0.6), 2.0, 0.1) is None  # a slow path
    law = law_of_chain(FlowLaw(2.0, 0.5, 0.1, 0.1, 0.05), moved)
    lag_s = float(law.first_lag_s(moved, law.factor([8.0]))[0]) + moved.lag_s - max(moved.taus_s)
    assert lag_s == pytest.approx(3.0 * (0.1 + 0.9 * 0.5))


def test_dips_that_follow_the_law_rarely_contradict_it() -> None:
    assert contradictions(40, 4, 0.03, 0.5, 2) <= 0.05
    assert contradictions(20, 4, 0.03, -0.5, 2) > 0.5


def test_the_correlation_of_a_law_is_part_of_the_uncertainty_of_its_factor() -> None:
    law = FlowLaw(2.0, 0.5, 0.08, 0.3, 0.1, correlation=0.8)
    draws = np.random.default_rng(1).multivariate_normal(
        [0.5, 0.3], [[0.08**2, 0.8 * 0.08 * 0.1], [0.8 * 0.08 * 0.1, 0.1**2]], 4000
    )
    factors = [s + (1 - s) * 3.0**-n for n, s in draws]
    u = np.sqrt(np.sum(law.factor_u(6.0) ** 2))
    assert u == pytest.approx(np.std(factors), rel=0.05)  # three standard errors of 4000 draws
    with pytest.raises(InputError, match="correlation"):
        FlowLaw(2.0, 0.5, correlation=1.2)


@pytest.mark.e2e
def test_one_dip_with_its_flow_has_the_law_of_the_prior() -> None:
    t, y, _ = plunged((1.4, 0.2), 0.1, 200, 0.1, 1)
    dip = sensor_from_dip((t, y), at="speed_m_s=3", entry_s=None)
    assert isinstance(dip.law, FlowLaw)
    assert (dip.law.at, dip.law.exponent, dip.law.exponent_u) == (3.0, 0.5, 0.1)
    dip.law.first_lag_s(dip.chains[0], np.ones(1))
    short = plunge_file(1.0, 0.02)
    stated = dip_with_law(short, DipFlows("v", (3.0,), inner_share=(0.02, 0.01)))
    assert [finding.code for finding in stated.findings] == ["sensor.dip_film"]
    assert stated.law is not None
    assert stated.law.inner_share == pytest.approx(0.1)


@pytest.mark.long
@pytest.mark.e2e
def test_the_command_with_flows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = []
    for seed, taus in enumerate([(1.6, 0.2), (0.8, 0.2)]):
        t, y, _ = plunged(taus, 0.1, 200, 0.1, seed)
        logs.append(write(tmp_path / f"d{seed}.csv", time_s=np.round(t, 3), T1_degC=y))
    out = tmp_path / "p.sensor.json"
    words = ("sensor", "plunge", *logs, "--column", "T1")
    at = ("--at", "speed_m_s=1", "--at", "speed_m_s=4")
    assert run_cli(*words, *at, "--exponent", "0.5+-0.05", "--out", out) == 0
    printed = capsys.readouterr().out
    assert "U = " in printed
    assert "lag at speed_m_s = 2" in printed
    law = read_sensor(out).law
    assert isinstance(law, FlowLaw)
    assert law.exponent == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--at", "v=1"), "--at is given 1 times for 2 dips"),
        (("--at", "v=1", "--at", "w=4"), "v and w; expected one quantity"),
        (("--at", "v=1", "--at", "v=1"), "all dips are at v = 1"),
        (("--at", "v=1", "--at", "v=0"), "--at is 0; expected a flow above 0"),
        (("--at", "v=1", "--at", "v"), "--at is 'v'; expected a quantity and its value"),
        (
            ("--at", "v=1", "--at", "v=4", "--medium", "water", "--diameter-mm", "3"),
            "--at with --medium",
        ),
        (("--exponent", "0.5"), "--exponent without --at"),
        (("--inner-share", "0.5"), "--inner-share without --at"),
        (("--at", "v=1", "--at", "v=4", "--exponent", "2"), "--exponent is 2; expected 0 to 1"),
        (("--at", "v=1", "--at", "v=4", "--inner-share", "1"), "--inner-share is 1"),
    ],
)
def test_options_of_flows_are_checked(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [write(tmp_path / f"d{k}.csv", time_s=[0, 1], T1_degC=[k, 1]) for k in range(2)]
    assert run_cli("sensor", "plunge", *logs, "--column", "T1", *words) == 2
    assert said in " ".join(capsys.readouterr().err.split())
