"""Mutated inputs and absurd options: exit code 0, 1 or 2, and no traceback."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tcdyn.sensors import read_sensor, specified_sensor
from tcdyn.workflows.compensate_table import compensate_table
from tests.cli.fault_commands import small_files
from tests.cli.fuzz import COMMANDS, WORDS, World, absurd_options, fuzzed_input
from tests.cli.test_main_job import tcdyn

NUMBER = st.integers(0, 1 << 30)
# About 15 s each; `python -m tests.cli.fuzz inputs 2000 SEED` runs more.
BUDGET = settings(
    max_examples=20,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    return World.made(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("command", WORDS)
def test_sound_inputs_give_a_result(world: World, command: str) -> None:
    """A mutation of an input that is refused anyway would test nothing behind the first checks."""
    done = world.run(WORDS[command].split(), {})
    assert done.code in (0, 1), (done.words, done.error)


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@given(
    st.sampled_from(list(WORDS)), NUMBER, st.lists(st.tuples(NUMBER, NUMBER, NUMBER), max_size=3)
)
@BUDGET
def test_a_mutated_input_ends_with_0_1_or_2(
    world: World, command: str, which: int, edits: list[tuple[int, int, int]]
) -> None:
    done = fuzzed_input(world, command, which, edits)
    assert done.is_sound, (done.words, done.error)


@pytest.mark.e2e
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@given(st.sampled_from(COMMANDS), st.lists(st.tuples(NUMBER, NUMBER), max_size=3))
@BUDGET
def test_absurd_options_end_with_0_1_or_2(
    world: World, command: str, choices: list[tuple[int, int]]
) -> None:
    done = absurd_options(world, command, choices)
    assert done.is_sound, (done.words, done.error)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return small_files(tmp_path_factory.mktemp("small"))


@pytest.mark.e2e
@pytest.mark.parametrize("where", ["log", "out", "folder", "sensor"])
def test_links_in_a_circle_are_told(
    small: dict[str, Path], tmp_path: Path, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").symlink_to("b.csv")
    (tmp_path / "b.csv").symlink_to("a.csv")
    circle = tmp_path / "a.csv"
    log = circle if where == "log" else small["table"]
    out = {"out": circle, "folder": circle / "o.csv"}.get(where, tmp_path / "o.csv")
    sensor = circle if where == "sensor" else small["sensor"]
    assert tcdyn("compensate", log, "--sensor", sensor, "--out", out, "-q") == 2
    assert "a.csv" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names of files are Unicode")
def test_a_name_that_is_not_utf8_is_read_and_told_with_escapes(
    small: dict[str, Path], tmp_path: Path
) -> None:
    log = Path(os.fsdecode(os.fsencode(tmp_path) + b"/lo\xffg.csv"))
    rows = small["table"].read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(rows[:80]))
    out = tmp_path / "o.csv"
    state = tmp_path / "s.json"
    words = ("--sensor", small["sensor"], "--out", out, "--state", state, "--idle-s", "0", "-q")
    assert tcdyn("follow", log, *words) == 0
    assert "lo\\udcffg.csv" in state.read_text(encoding="utf-8").replace("\\\\", "\\")
    assert tcdyn("follow", log, *words) == 0
    probe = Path(os.fsdecode(os.fsencode(tmp_path) + b"/p\xff.sensor.json"))
    assert tcdyn("sensor", "new", "--tau-s", "1+-0.1", "--column", "T1", "--out", probe, "-q") == 0
    assert read_sensor(probe).sensor == "p\\udcff"
    assert tcdyn("sensor", "new", "--tau-s", "1+-0.1", "--column", "T\udcff", "--out", out) == 2


def test_names_of_a_sensor_have_a_limit(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("sensor", "new", "--tau-s", "1+-0.1", "--column", "T1", "--name")
    assert tcdyn(*words, "x" * 81) == 2
    assert "1 to 80" in capsys.readouterr().err
    assert tcdyn(*words, "x" * 80) == 0


def test_an_output_without_a_name_is_refused_before_any_work(
    small: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--input", "u", "--output", "T1_degC", "--model", "P1")
    assert tcdyn("identify", small["table"], *words, "--out", "/") == 2
    assert "/ is a folder" in capsys.readouterr().err


@pytest.mark.parametrize("cell", [[1.0, 2.0], {"a": 1}])
def test_a_nested_column_of_parquet_is_refused(
    tmp_path: Path, cell: object, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "nested.parquet"
    pd.DataFrame({"time_s": np.arange(50.0), "T1_degC": [cell] * 50}).to_parquet(log)
    assert tcdyn("sensor", "noise", log, "--column", "T1_degC") == 2
    assert "column T1_degC holds" in capsys.readouterr().err


@pytest.mark.parametrize("factor", [1e6, 1e7])
def test_rows_far_beyond_the_lag_take_no_memory_and_are_told(tmp_path: Path, factor: float) -> None:
    """Stamps in microseconds called seconds: 1,200 rows, the lag is 1.5 s."""
    t = 0.1 * np.arange(1200)
    log = tmp_path / "us.csv"
    pd.DataFrame({"time_s": t * factor, "T1_degC": 20 + 5 * np.sin(t / 7)}).to_csv(log, index=False)
    done = compensate_table(log, [specified_sensor("s", ["T1"], [(1.5, 0.1)])], tmp_path / "o.csv")
    assert {"sensor.slow", "sensor.left"} <= {f.code for f in done.findings}
    assert "too slow for a lag of 1.5 s" in " ".join(f.sentence for f in done.findings)
    assert pd.read_csv(tmp_path / "o.csv")["T1_degC"].isna().all()


def test_a_grid_that_is_nearly_empty_is_refused(
    small: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A microsecond or a second between rows, at random: in turn they would be bursts."""
    t = np.cumsum(np.where(np.random.default_rng(0).random(1200) < 0.5, 1e-6, 1.0))
    log = tmp_path / "pairs.csv"
    pd.DataFrame({"time_s": t, "T1_degC": 20 + np.sin(t)}).to_csv(log, index=False)
    out = tmp_path / "o.csv"
    assert tcdyn("compensate", log, "--sensor", small["sensor"], "--out", out, "-q") == 2
    assert "most rows are missing" in capsys.readouterr().err


def test_a_constant_frequency_response_is_no_internal_error(tmp_path: Path) -> None:
    f = np.geomspace(0.01, 10, 40)
    table = tmp_path / "bode.csv"
    pd.DataFrame({"frequency_Hz": f, "gain": 1 + 0 * f, "phase": 0 * f}).to_csv(table, index=False)
    words = ("--column", "gain", "--column", "phase", "--model", "P1", "--model", "P2")
    assert tcdyn("response", table, *words, "--out", tmp_path / "r.json") == 0


@pytest.mark.long
@pytest.mark.e2e
def test_a_log_with_an_odd_name_does_not_end_a_campaign(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three logs that cannot be analysed: a short one, one whose name is not UTF-8, a link in a
    circle."""
    rows = world.files["ehl"].read_bytes()
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/lo\xffg.csv"))
    for path in (tmp_path / "short.csv", odd):
        path.write_bytes(rows)
    circle = tmp_path / "circle.csv"
    circle.symlink_to("circle.csv")
    records = ("--record", world.files["fast"], "--record", world.files["slow"])
    words = ("--rig", world.files["rig"], *records, "--out", tmp_path / "out", "--workers", "1")
    assert tcdyn("rig", "campaign", tmp_path / "short.csv", odd, circle, *words) in (1, 2)
    table = pd.read_csv(tmp_path / "out" / "campaign.csv")
    assert len(table) == 3


@pytest.mark.parametrize("command", ["compensate", "follow"])
@pytest.mark.parametrize("is_junction", [False, True])
def test_a_channel_or_a_reference_junction_that_holds_only_text_is_refused(
    tmp_path: Path, command: str, is_junction: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    t = 0.1 * np.arange(100)
    table = pd.DataFrame({"time_s": t, "T1_mV": 1 + 0.1 * np.sin(t), "CJ_degC": 20.0})
    table["CJ_degC" if is_junction else "T1_mV"] = "abc"
    table.to_csv(tmp_path / "log.csv", index=False)
    sensor = tmp_path / "s.sensor.json"
    new = ("sensor", "new", "--tau-s", "1.5+-0.1", "--column", "T1", "--out", sensor, "-q")
    assert tcdyn(*new) == 0
    out = tmp_path / "o.csv"
    words = (command, tmp_path / "log.csv", "--sensor", sensor, "--out", out)
    of_unit = ("--unit", "T1_mV=mV", "--couple", "K", "--cold-junction", "CJ_degC", "-q")
    waits = ("--idle-s", "0") if command == "follow" else ()
    assert tcdyn(*words, *of_unit, *waits) == 2
    assert "holds text, such as 'abc' in row 1" in capsys.readouterr().err
    assert not out.exists()


def test_a_followed_channel_that_turns_into_text_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The word may be its word for no reading, so that the rows before it are used."""
    t = 0.1 * np.arange(200)
    rows = [f"{x:.1f},{20 + np.sin(x):.3f}" for x in t[:100]] + [f"{x:.1f},abc" for x in t[100:]]
    (tmp_path / "log.csv").write_text("\n".join(["time_s,T1_degC", *rows, ""]), encoding="utf-8")
    sensor = tmp_path / "s.sensor.json"
    new = ("sensor", "new", "--tau-s", "1.5+-0.1", "--column", "T1", "--out", sensor, "-q")
    assert tcdyn(*new) == 0
    words = ("--sensor", sensor, "--out", tmp_path / "o.csv", "--idle-s", "0", "-q")
    assert tcdyn("follow", tmp_path / "log.csv", *words) == 0
    assert "100 cell(s) hold a word instead of a reading: 'abc' (100)" in capsys.readouterr().err


def test_one_wrong_value_of_a_current_is_no_internal_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The step of the current is lost in it, so that no lag explains the reading."""
    t = 0.05 * np.arange(600)
    late = np.clip(t - 5.0, 0, None)
    noise = 0.05 * np.random.default_rng(0).standard_normal(600)
    table = pd.DataFrame({"time_s": t, "T1_degC": 20 + 60 * (1 - np.exp(-late / 0.5)) + noise})
    table["I_mA"] = np.where(t > 5.0, 1.0, 0.0)
    table.loc[167, "I_mA"] = 100.0
    table[:250].to_csv(tmp_path / "lcsr.csv", index=False)
    words = ("sensor", "current", tmp_path / "lcsr.csv", "--column", "T1_degC")
    assert tcdyn(*words, "--current", "I_mA", "-q") == 2
    assert "does not determine the lag" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--couple", "--cold-junction"])
def test_options_of_millivolts_need_a_column_in_millivolts(
    small: dict[str, Path], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    value = "K" if option == "--couple" else "20"
    assert tcdyn("sensor", "noise", small["table"], "--column", "T1_degC", option, value) == 2
    assert "no column is in mV" in capsys.readouterr().err
