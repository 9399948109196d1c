"""Simulated campaign folder: files, formats, true values, and reproducibility by seed."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tcdyn.cli.app import run
from tcdyn.cli.simulate import app
from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table
from tcdyn.rig.rigfile import load_rig, parse_rig
from tcdyn.simulate.campaign import PlannedPlunge, simulate_campaign
from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions
from tcdyn.simulate.plunge import PlungeOptions

EHL = EhlOptions(load_on_s=3.0, unload_s=8.0, duration_s=12.0, mesh=STUDY_MESH)
PLUNGE = PlungeOptions(after_s=5.0)


def campaign(folder: Path, **changes):  # type: ignore[no-untyped-def]
    """A short campaign with seed 7; keywords override the options."""
    options = {"ehl_options": EHL, "plunge_options": PLUNGE} | changes
    return simulate_campaign(folder, 7, options.pop("tests", ("B3",)), **options)


def test_campaign_folder_holds_the_documented_files(tmp_path: Path) -> None:
    files = campaign(tmp_path)
    logs = {
        "oven_fast.csv",
        "oven_slow.csv",
        "plunge_fast_1.csv",
        "plunge_fast_2.csv",
        "plunge_slow_1.csv",
        "plunge_slow_2.csv",
        "EHL_B3.csv",
    }
    marks = {f"{name}.meta.json" for name in logs}
    assert {p.name for p in tmp_path.iterdir() if p.is_file()} == {"rig.toml", *logs, *marks}
    for name in logs:
        assert open_table(tmp_path / name).metadata["simulated"] == "by tcdyn"
    assert files.traces["EHL_B3"] == tmp_path / "truth" / "EHL_B3_traces.parquet"
    assert load_rig(files.rig) == load_rig()
    true_values = json.loads(files.truth.read_text())
    assert {"beta", "h_fast", "h_slow", "load_on_s", "unload_s", "steady_degC"} <= set(
        true_values["tests"]["B3"]
    )
    assert set(true_values["fast"]["channels"]) == set("abcdef")
    assert true_values["fast"]["channels"]["e"]["lag_s"] == pytest.approx(
        true_values["fast"]["common_lag_s"]
        + true_values["fast"]["channels"]["e"]["differential_lag_s"],
        abs=1e-12,
    )


def test_logs_read_back_with_the_columns_of_the_true_traces(tmp_path: Path) -> None:
    files = campaign(tmp_path)
    log = pd.read_csv(files.ehl["B3"])
    true_traces = pd.read_parquet(files.traces["EHL_B3"])
    assert list(log.columns) == list(true_traces.columns)
    assert len(log) == len(true_traces) == 12 * 75 + 1
    assert np.diff(log["time_s"]) == pytest.approx(1 / 75, abs=2e-6)  # written to a microsecond
    # Before loading, all temperatures are steady: the log differs at most by offsets (0.5), gains
    # (0.3) and noise (5 sigma).
    before_load = log["time_s"] < 2.5
    error = (log["fast_b_degC"] - true_traces["fast_b_degC"])[before_load]
    assert error.abs().median() < 0.9


@pytest.mark.study
def test_a_full_disk_leaves_nothing_of_a_campaign_or_of_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The disk is full at the second log, and in a single log behind its true values."""
    sync = os.fsync
    calls = []

    def full(handle: int) -> None:
        calls.append(handle)
        if len(calls) == full_at:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(handle)

    monkeypatch.setattr(os, "fsync", full)
    full_at = 6
    with pytest.raises(InputError, match="No space left"):
        campaign(tmp_path / "lab")
    assert [p for p in (tmp_path / "lab").rglob("*") if p.is_file()] == []
    calls.clear()
    full_at = 3
    assert run(lambda: app(["oven", "--out", str(tmp_path / "lab" / "o.csv")])) == 2
    said = capsys.readouterr()
    assert "No space left" in said.err
    assert "wrote" not in said.out
    assert [p for p in (tmp_path / "lab").rglob("*") if p.is_file()] == []


@pytest.mark.e2e
def test_file_depends_only_on_the_seed_and_its_own_name(tmp_path: Path) -> None:
    single_test = campaign(tmp_path / "a")
    with_more_tests = campaign(
        tmp_path / "b", tests=("A1", "B3"), plunges=(PlannedPlunge(110.0),), n_jobs=2
    )
    assert single_test.ehl["B3"].read_bytes() == with_more_tests.ehl["B3"].read_bytes()
    assert single_test.ovens["fast"].read_bytes() == with_more_tests.ovens["fast"].read_bytes()
    assert (
        single_test.plunges["fast"][0].read_bytes()
        == with_more_tests.plunges["fast"][0].read_bytes()
    )
    assert len(with_more_tests.plunges["slow"]) == 1


@pytest.mark.study
def test_rerun_in_a_folder_returns_only_files_of_the_new_campaign(tmp_path: Path) -> None:
    first = campaign(tmp_path, tests=("A1", "B3"))
    second = campaign(tmp_path, tests=("b3", "B3"), plunges=(PlannedPlunge(110.0),))
    assert first.ehl["A1"].exists()  # files of the first campaign stay
    assert set(second.ehl) == {"B3"}
    assert [p.name for p in second.plunges["fast"]] == ["plunge_fast_1.csv"]
    assert set(json.loads(second.truth.read_text())["tests"]) == {"B3"}
    assert "EHL_A1" not in second.traces


def test_simulated_rig_file_is_overwritten_and_an_edited_one_is_not(
    tmp_path: Path,
) -> None:
    no_records = {"tests": (), "plunges": ()}
    rig_file = campaign(tmp_path, **no_records).rig
    other_rig = parse_rig({"disk": {"width_mm": 9.6}}, "other")
    campaign(tmp_path, rig=other_rig, **no_records)
    assert load_rig(rig_file) == other_rig
    edited = "# mine\n" + rig_file.read_text()
    rig_file.write_text(edited)
    campaign(tmp_path, rig=other_rig, **no_records)
    assert rig_file.read_text() == edited  # equal values: not written
    with pytest.raises(InputError, match=r"rig\.toml that no simulation wrote"):
        campaign(tmp_path, **no_records)
    assert rig_file.read_text() == edited


def test_log_not_written_by_a_simulation_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "EHL_B3.csv").write_text("measured")
    with pytest.raises(InputError, match=r"EHL_B3\.csv that no simulation wrote"):
        campaign(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["EHL_B3.csv"]


def test_progress_counts_every_job(tmp_path: Path) -> None:
    progress_calls: list[tuple[str, int, int]] = []
    campaign(tmp_path, progress=lambda *step: progress_calls.append(step))
    assert [done for _, done, _ in progress_calls] == list(range(1, 8))
    assert {total for _, _, total in progress_calls} == {7}


def test_unknown_test_raises_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="A1 to D4"):
        simulate_campaign(tmp_path / "x", 0, ("B3", "Z9"))
    assert not (tmp_path / "x").exists()


def test_simulate_commands_write_logs_and_true_traces(tmp_path: Path) -> None:
    runner = CliRunner()
    for arguments in (
        ["oven", "--disk", "slow"],
        ["immersion", "--bath-degC", "80", "--fluid", "water", "--duration-s", "10", "--clean"],
        ["hole"],
    ):
        out = tmp_path / "out" / f"{arguments[0]}.csv"
        result = runner.invoke(app, [*arguments, "--out", str(out)])
        assert result.exit_code == 0, result.output
        assert out.with_suffix(".truth.json").exists()
        assert len(pd.read_csv(out)) == len(pd.read_parquet(out.with_suffix(".truth.parquet")))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["oven", "--disk", "middle", "--out", "o.csv"], "fast or slow"),
        (["immersion", "--fluid", "mercury", "--out", "o.csv"], "mobil-jet-ii or water"),
        (["ehl", "--test", "E9", "--out", "o.csv"], "A1 to D4"),
        (["oven", "--out", "/dev/null/o.csv"], "cannot be written"),
        (["campaign", "--out", "/dev/null/lab"], "cannot be written"),
        (["oven", "--out", "o.csv", "--rig", "o.csv"], "which is read"),
        (["oven", "--out", "o.xlsx"], "ending in .csv"),
    ],
)
def test_commands_reject_invalid_arguments_and_write_nothing(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
    assert list(tmp_path.iterdir()) == []
