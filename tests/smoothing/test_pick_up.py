"""Interference of a column that switches: found, named, removed with its uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.smoothing import smooth
from tcdyn.smoothing.pick_up import switching
from tcdyn.workflows.compensate_table import compensate_table
from tests.smoothing.event_fault_study import (
    DT_S,
    FINE,
    LAGS_S,
    ROWS_OF_TABLE,
    idle_relay,
    judge,
    pick_up,
    readings_of,
)

ROW = {row.name: row for row in ROWS_OF_TABLE}


def test_interference_is_removed_with_its_size_and_uncertainty() -> None:
    """2 K while a relay is on, behind a lag of 2 s."""
    z = []
    for seed in range(6):
        rng = np.random.default_rng([71, seed])
        world = pick_up(rng)
        size_K = world.reading.max()
        y = readings_of(world, LAGS_S[0], rng)
        result = smooth(y, DT_S, Chain(LAGS_S[0]), switched=world.columns)
        (finding,) = [f for f in result.findings if f.code == "trace.pick_up"]
        assert finding.numbers["column"] == "relay"
        z.append((finding.numbers["step_K"] - size_K) / finding.numbers["u_K"])
        assert 0 < finding.numbers["u_K"] < 0.1
        truth = world.temperature[::FINE]
        assert np.sqrt(np.mean((result.temperature[:, 0] - truth) ** 2)) < 0.4
    assert np.max(np.abs(z)) < 3.5


def test_a_relay_that_only_heats_is_no_interference() -> None:
    for seed in range(6):
        rng = np.random.default_rng([72, seed])
        world = idle_relay(rng)
        y = readings_of(world, LAGS_S[1], rng)
        result = smooth(y, DT_S, Chain(LAGS_S[1]), switched=world.columns)
        assert not any(f.code == "trace.pick_up" for f in result.findings)


def test_the_column_is_named_among_others_and_only_in_its_channel() -> None:
    rng = np.random.default_rng(73)
    worlds = [pick_up(rng), idle_relay(rng)]
    y = np.stack([readings_of(world, LAGS_S[0], rng) for world in worlds], axis=1)
    columns = {
        "pump": worlds[1].columns["relay"],
        "heater": worlds[0].columns["relay"],
        "load": rng.standard_normal(len(y)),
    }
    result = smooth(y, DT_S, Chain(LAGS_S[0]), names=["T1", "T2"], switched=columns)
    (finding,) = [f for f in result.findings if f.code == "trace.pick_up"]
    assert (finding.subject, finding.numbers["column"]) == ("T1", "heater")
    with pytest.raises(InputError, match="the column short of switched"):
        smooth(y, DT_S, Chain(2.0), switched={"short": [0.0, 1.0]})


def test_without_the_column_the_steps_are_counted_in_one_message() -> None:
    rng = np.random.default_rng([71, 3])
    world = pick_up(rng)
    y = readings_of(world, LAGS_S[0], rng)
    result = smooth(y, DT_S, Chain(LAGS_S[0]))
    steps = [f for f in result.findings if f.code == "trace.steps"]
    edges = np.count_nonzero(np.diff(world.reading))
    assert len(steps) == 1
    assert 0.6 * edges < steps[0].numbers["count"] <= edges
    assert "log what switches" in steps[0].sentence


@pytest.mark.parametrize("words", [(1, 0), ("on", "off"), ("Closed", "Open")])
def test_a_table_needs_no_option(words: tuple[object, object], tmp_path: Path) -> None:
    """All columns without a sensor are tried, also those of words."""
    rng = np.random.default_rng([71, 1])
    world = pick_up(rng)
    y = readings_of(world, LAGS_S[0], rng)
    is_on = world.columns["relay"] > 0
    path = tmp_path / "log.csv"
    table = {"time_s": DT_S * np.arange(len(y)), "T_degC": y, "ssr": np.where(is_on, *words)}
    pd.DataFrame(table).to_csv(path, index=False)
    with pytest.warns(UserWarning, match="interference"):
        done = tcdyn.compensate_frame(pd.read_csv(path), {"T_degC": (LAGS_S[0][0], 0.02)})
    truth = world.temperature[::FINE]
    assert np.sqrt(np.mean((done["T_degC"] - truth) ** 2)) < 0.4
    result = compensate_table(path, {"T_degC": (LAGS_S[0][0], 0.02)}, tmp_path / "out.csv")
    assert any("interference" in text and "'ssr'" in text for text in result.warnings)


def test_one_pulse_of_a_relay_is_enough() -> None:
    rng = np.random.default_rng(5)
    y = 60 + 5 * np.sin(0.01 * np.arange(600)) + 0.05 * rng.standard_normal(600)
    relay = np.where((np.arange(600) >= 200) & (np.arange(600) < 300), "Heating", "Idle")
    done = smooth(y + 2.0 * (relay == "Heating"), DT_S, Chain(2.0), switched={"relay": relay})
    assert [finding.code for finding in done.findings] == ["trace.pick_up"]
    assert done.findings[0].numbers["step_K"] == pytest.approx(2.0, abs=0.1)


def test_a_column_of_other_words_is_refused() -> None:
    words = np.array(["low", "mid", "high"] * 20)
    with pytest.raises(InputError, match="relay of switched has other words"):
        smooth(np.linspace(20, 30, 60), DT_S, Chain(2.0), switched={"relay": words})


def test_only_columns_that_switch_are_tried() -> None:
    assert switching(np.array([1.0, 1.0, 1.0])) is None
    assert switching(np.full(4, np.nan)) is None
    assert switching(np.arange(50.0)) is None
    held = switching(np.array([np.nan, 5, 5, 5, 7, 7, 7, 7, 5, 5, 5, 5, 7, 7, 7, 7]))
    assert held is not None
    assert held[:5].tolist() == [0, 0, 0, 0, 2]


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("name", list(ROW))
def test_faults_and_events_are_named_right(name: str, draws) -> None:
    """Of twenty records eighteen are named right, one has a false name, and the band holds."""
    count = draws(20)
    results = np.array([judge(ROW[name], index, 4242) for index in range(count)])
    right, false, cover = results[:, :3].T
    assert right.sum() >= 0.85 * count
    assert false.sum() <= 0.1 * count
    assert cover.mean() > 0.9
