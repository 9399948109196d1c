"""Invalid readings of a followed log: outside the physical range, and faster than the lag of the sensor allows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.sensors import specified_sensor
from tcdyn.workflows.follow import FollowRun, follow
from tcdyn.workflows.live import LiveSettings
from tcdyn.workflows.reachable import Reach, ReadingTrack
from tests.cli.test_main_job import tcdyn
from tests.sensors.sensor_world import Array, lagged, write, written

TAU_S = 25.0
DT_S = 1.0
N = 600
FAULT = slice(300, 360)


def kiln() -> tuple[Array, Array, Array]:
    """Time [s], gas and readings [degC] of a kiln whose door opens at 200 s; the sensor has one lag of 25 s."""
    t = np.arange(N) * DT_S
    open_s = np.clip(t - 200.0, 0.0, None)
    gas = 850.0 - 80.0 * (1.0 - np.exp(-open_s / 60.0))
    noise = 0.3 * np.random.default_rng(3).standard_normal(N)
    return t, gas, np.round(lagged(gas, (TAU_S,), DT_S) + noise, 2)


def followed(
    folder: Path, y: Array, name: str = "TC1_degC", **options: object
) -> tuple[FollowRun, pd.DataFrame]:
    """The run with a sensor of 25 s, and what it wrote."""
    t, _, _ = kiln()
    log = write(folder / "log.csv", **{"time_s": t, name: y})
    sensors = [specified_sensor("s", [name], [(TAU_S, 1.0)])]
    settings = LiveSettings(learn_s=60.0)
    done = follow(
        log,
        sensors,
        folder / "out.csv",
        settings=settings,
        idle_s=0.0,
        sleep=lambda _: None,
        **options,
    )
    return done, written(folder / "out.csv")


def alternating(bad: float, part: slice) -> Array:
    y = kiln()[2]
    y[part][::2] = bad
    return y


def constant(bad: float, part: slice) -> Array:
    y = kiln()[2]
    y[part] = bad
    return y


def at_random(bad: float, share: float) -> Array:
    y = kiln()[2]
    y[np.random.default_rng(5).random(N) < share] = bad
    return y


FAULTS = {
    "every second reading 2300": (alternating(2300.0, FAULT), "follow.unreachable"),
    "open circuit at 2300": (constant(2300.0, FAULT), "follow.unreachable"),
    "unplugged: reads the cold junction": (constant(24.0, FAULT), "follow.unreachable"),
    "30 % zeros": (at_random(0.0, 0.3), "follow.unreachable"),
    "40 % at 2300": (at_random(2300.0, 0.4), "follow.unreachable"),
    "the first readings 0": (constant(0.0, slice(0, 5)), "follow.unreachable"),
    "2 % overload 9.9E37": (at_random(9.9e37, 0.02), "follow.impossible"),
    "overload 9E9 in between": (alternating(9e9, FAULT), "follow.impossible"),
    "overload -9E9 in between": (alternating(-9e9, FAULT), "follow.impossible"),
    "infinite": (at_random(np.inf, 0.02), "follow.impossible"),
    "colder than absolute zero": (alternating(-300.0, FAULT), "follow.impossible"),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_invalid_readings_count_as_missing_and_are_told(tmp_path: Path, kind: str) -> None:
    y, code = FAULTS[kind]
    _, gas, clean = kiln()
    run, out = followed(tmp_path, y)
    assert [
        f.code for f in run.findings if f.code in ("follow.impossible", "follow.unreachable")
    ] == [code]
    told = next(f for f in run.findings if f.code == code)
    bad = y != clean
    assert told.numbers["count"] == np.count_nonzero(bad)
    assert told.numbers["first_s"] == np.flatnonzero(bad)[0] * DT_S
    assert told.subject == "TC1_degC"
    x, u = out["TC1_degC"].to_numpy(), out["TC1_u_K"].to_numpy()
    # The answer stays in the range of the true gas temperature, within five of its own typical standard uncertainties.
    margin_K = 5 * np.median(u)
    assert margin_K < 25.0
    assert np.min(x) > np.min(gas) - margin_K
    assert np.max(x) < np.max(gas) + margin_K
    # 95 % bands, of which 90 % must hold: the rows right after the door opens are answered late by design.
    assert np.mean(np.abs(x - gas) < 1.96 * u) > 0.9


def test_valid_readings_are_left_alone(tmp_path: Path) -> None:
    run, _ = followed(tmp_path, kiln()[2])
    assert {f.code for f in run.findings} <= {"follow.spikes"}


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_levels_in_turn_one_is_told(tmp_path: Path, first: int) -> None:
    """Which of them is valid nobody can know; the answer is not made of both."""
    run, out = followed(tmp_path, alternating(2300.0, slice(first, N)))
    assert "follow.unreachable" in {f.code for f in run.findings}
    x = out["TC1_degC"].to_numpy()
    assert np.all((x > 700.0) & (x < 2400.0))


def test_a_lone_spike_of_some_noises_is_left_to_the_smoother(tmp_path: Path) -> None:
    y = kiln()[2]
    y[300] += 8.0
    run, _ = followed(tmp_path, y)
    assert {f.code for f in run.findings} == {"follow.spikes"}


def test_the_range_is_that_of_the_temperature_in_any_unit(tmp_path: Path) -> None:
    """-40 in kelvin is colder than absolute zero; 4000 degF is 2204 degC, which a thermocouple can read."""
    y = kiln()[2] + 273.15
    y[300] = -40.0
    run, _ = followed(tmp_path, y, "TC1_K")
    assert [f.code for f in run.findings if f.code != "follow.spikes"] == ["follow.impossible"]


def test_a_sensor_that_is_plugged_in_later_starts_anew(tmp_path: Path) -> None:
    """It read its cold junction for 100 s. More readings at the new level make that the valid one."""
    y = kiln()[2]
    y[:100] = 24.0 + 0.3 * np.random.default_rng(4).standard_normal(100)
    run, out = followed(tmp_path, y)
    assert {"follow.unreachable", "follow.restarted"} <= {f.code for f in run.findings}
    x = out["TC1_degC"].to_numpy()
    assert np.all((x > 0.0) & (x < 900.0))
    gas = kiln()[1]
    assert np.max(np.abs(x - gas)[300:]) < 25.0


def test_a_run_that_is_stopped_while_readings_are_invalid_goes_on_the_same(tmp_path: Path) -> None:
    y, _ = FAULTS["unplugged: reads the cold junction"]
    t, _, _ = kiln()
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir()
    parts.mkdir()
    _, expected = followed(whole, y)
    sensors = [specified_sensor("s", ["TC1_degC"], [(TAU_S, 1.0)])]
    for last in (330, N):
        log = write(parts / "log.csv", time_s=t[:last], TC1_degC=y[:last])
        run = follow(
            log,
            sensors,
            parts / "out.csv",
            settings=LiveSettings(learn_s=60.0),
            idle_s=0.0,
            sleep=lambda _: None,
            state=parts / "s.json",
        )
    pd.testing.assert_frame_equal(written(parts / "out.csv"), expected, rtol=0, atol=1e-9)
    assert next(f for f in run.findings if f.code == "follow.unreachable").numbers["count"] == 60


def test_the_command_ends_with_1_and_names_the_readings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t, _, _ = kiln()
    log = write(tmp_path / "log.csv", time_s=t, TC1=constant(24.0, FAULT))
    sensor = tmp_path / "s.json"
    assert tcdyn("sensor", "new", "--tau-s", "25+-1", "--column", "TC*", "--out", sensor, "-q") == 0
    words = [
        "follow",
        log,
        "--sensor",
        sensor,
        "--out",
        tmp_path / "out.csv",
        "--learn-s",
        "60",
        "--idle-s",
        "0",
    ]
    assert tcdyn(*words) == 1
    error = capsys.readouterr().err
    assert "60 readings of TC1 changed faster than any temperature can through the lag" in error
    assert "the first at 300 s" in error


@pytest.mark.parametrize(
    "chain",
    [
        Chain(2.0),
        Chain((2.0, 0.5, 0.1)),
        Chain((2.0, 2.0)),
        Chain((0.6,), cement_s=4.0),
        Chain((2.0,), delay_s=0.3),
        Chain((2.0,), zero_s=0.5),
        Chain((0.1,), pair=(2.0, 0.2)),
    ],
    ids=["one lag", "three lags", "equal lags", "cement", "dead time", "zero", "complex pair"],
)
def test_no_input_in_the_physical_range_makes_a_reading_that_is_rejected(chain: Chain) -> None:
    """The worst case: temperatures that jump between the ends of the range, 0 to 40 samples apart."""
    dt_s = 0.1
    levels = np.random.default_rng(1).choice([-273.15, 3000.0], 200)
    x = np.repeat(levels, np.random.default_rng(2).integers(1, 40, len(levels)))
    y = chain.response(x, dt_s, hold="zoh")
    reach = Reach.create([chain], np.zeros(1), np.zeros(1), np.zeros(1), dt_s)
    _, rejected, anew = reach.examine(ReadingTrack.begin(y[:1], 1.0), y[:, None])
    assert not rejected.any()
    assert not anew.any()


def test_an_overshooting_filter_rejects_nothing_that_it_can_make() -> None:
    from tcdyn.rig.disk import Conditioning

    chain = Chain((2.0,), conditioning=Conditioning(cutoff_Hz=0.5, poles=6, shape="butterworth"))
    test_no_input_in_the_physical_range_makes_a_reading_that_is_rejected(chain)


def test_a_chain_without_lags_sets_no_bound() -> None:
    chain = Chain((), conditioning=NO_CONDITIONING)
    reach = Reach.create([chain], np.zeros(1), np.zeros(1), np.ones(1), 0.1)
    _, rejected, _ = reach.examine(
        ReadingTrack.begin(np.array([20.0])), np.array([[20.0], [2900.0], [-270.0]])
    )
    assert not rejected.any()


def test_readings_examined_in_pieces_give_the_same_as_in_one() -> None:
    y = at_random(0.0, 0.3)[:, None]
    reach = Reach.create([Chain(TAU_S)], np.ones(1), np.zeros(1), np.full(1, 0.3), DT_S)
    begin = ReadingTrack.begin(np.array([850.0]), 16.0)
    _, expected, _ = reach.examine(begin, y)
    track = begin
    found = []
    for piece in np.split(y, [1, 2, 7, 100, 101, 350]):
        track, rejected, _ = reach.examine(track, piece)
        found.append(rejected)
    assert np.array_equal(np.concatenate(found), expected)
