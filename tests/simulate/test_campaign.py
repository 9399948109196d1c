"""A campaign's folder: its files, their formats, their truth, and that seeds reproduce them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tcdyn.cli.simulate import app
from tcdyn.core.errors import InputError
from tcdyn.rig.rigfile import load_rig, parse_rig
from tcdyn.simulate.campaign import PlannedPlunge, simulate_campaign
from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions
from tcdyn.simulate.plunge import PlungeOptions

EHL = EhlOptions(load_on_s=3.0, unload_s=8.0, duration_s=12.0, mesh=STUDY_MESH)
PLUNGE = PlungeOptions(after_s=5.0)


def campaign(folder: Path, **changes):  # type: ignore[no-untyped-def]
    options = {"ehl_options": EHL, "plunge_options": PLUNGE} | changes
    return simulate_campaign(folder, 7, options.pop("tests", ("B3",)), **options)


def test_folder_holds_the_promised_files(tmp_path: Path) -> None:
    files = campaign(tmp_path)
    logs = {p.name for p in tmp_path.iterdir() if p.is_file()}
    assert logs == {
        "rig.toml",
        "oven_fast.csv",
        "oven_slow.csv",
        "plunge_fast_1.csv",
        "plunge_fast_2.csv",
        "plunge_slow_1.csv",
        "plunge_slow_2.csv",
        "EHL_B3.csv",
    }
    assert files.traces["EHL_B3"] == tmp_path / "truth" / "EHL_B3_traces.parquet"
    assert load_rig(files.rig) == load_rig()
    truth = json.loads(files.truth.read_text())
    assert {"beta", "h_fast", "h_slow", "load_on_s", "unload_s", "steady_degC"} <= set(
        truth["tests"]["B3"]
    )
    assert set(truth["fast"]["channels"]) == set("abcdef")
    assert truth["fast"]["channels"]["e"]["lag_s"] == pytest.approx(
        truth["fast"]["common_lag_s"] + truth["fast"]["channels"]["e"]["differential_lag_s"],
        abs=1e-12,
    )


def test_logs_read_back_and_stand_beside_their_truth(tmp_path: Path) -> None:
    files = campaign(tmp_path)
    log = pd.read_csv(files.ehl["B3"])
    true = pd.read_parquet(files.traces["EHL_B3"])
    assert list(log.columns) == list(true.columns)
    assert len(log) == len(true) == 12 * 75 + 1
    assert np.diff(log["time_s"]) == pytest.approx(1 / 75, abs=2e-6)  # written to a microsecond
    # Warm and apart, everything is at rest: the log is off by offsets (0.5), gains (0.3), noise (5 sigma) at most.
    quiet = log["time_s"] < 2.5
    apart = (log["fast_b_degC"] - true["fast_b_degC"])[quiet]
    assert apart.abs().median() < 0.9


@pytest.mark.study
def test_a_file_depends_on_the_seed_and_its_own_name_only(tmp_path: Path) -> None:
    alone = campaign(tmp_path / "a")
    among = campaign(tmp_path / "b", tests=("A1", "B3"), plunges=(PlannedPlunge(110.0),), n_jobs=2)
    assert alone.ehl["B3"].read_bytes() == among.ehl["B3"].read_bytes()
    assert alone.ovens["fast"].read_bytes() == among.ovens["fast"].read_bytes()
    assert alone.plunges["fast"][0].read_bytes() == among.plunges["fast"][0].read_bytes()
    assert len(among.plunges["slow"]) == 1


@pytest.mark.study
def test_a_folder_used_again_gives_this_campaign_s_files_only(tmp_path: Path) -> None:
    first = campaign(tmp_path, tests=("A1", "B3"))
    again = campaign(tmp_path, tests=("b3", "B3"), plunges=(PlannedPlunge(110.0),))
    assert first.ehl["A1"].exists()  # left alone, and in nobody's way
    assert set(again.ehl) == {"B3"}
    assert [p.name for p in again.plunges["fast"]] == ["plunge_fast_1.csv"]
    assert set(json.loads(again.truth.read_text())["tests"]) == {"B3"}
    assert "EHL_A1" not in again.traces


def test_a_rig_file_of_a_simulation_may_be_written_over_and_one_s_own_may_not(
    tmp_path: Path,
) -> None:
    none = {"tests": (), "plunges": ()}
    file = campaign(tmp_path, **none).rig
    other = parse_rig({"disk": {"width_mm": 9.6}}, "other")
    campaign(tmp_path, rig=other, **none)
    assert load_rig(file) == other
    own = "# mine\n" + file.read_text()
    file.write_text(own)
    campaign(tmp_path, rig=other, **none)
    assert file.read_text() == own  # it says the same: left as it is
    with pytest.raises(InputError, match=r"rig\.toml that no simulation wrote"):
        campaign(tmp_path, **none)
    assert file.read_text() == own


def test_a_log_that_no_simulation_wrote_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "EHL_B3.csv").write_text("measured")
    with pytest.raises(InputError, match=r"EHL_B3\.csv that no simulation wrote"):
        campaign(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["EHL_B3.csv"]


def test_progress_counts_every_job(tmp_path: Path) -> None:
    seen: list[tuple[str, int, int]] = []
    campaign(tmp_path, progress=lambda *step: seen.append(step))
    assert [done for _, done, _ in seen] == list(range(1, 8))
    assert {total for _, _, total in seen} == {7}


def test_an_unknown_test_stops_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="A1 to D4"):
        simulate_campaign(tmp_path / "x", 0, ("B3", "Z9"))
    assert not (tmp_path / "x").exists()


def test_commands_write_logs_and_truth(tmp_path: Path) -> None:
    runner = CliRunner()
    for arguments in (
        ["oven", "--disk", "slow"],
        ["immersion", "--bath-degC", "80", "--fluid", "water", "--duration-s", "10", "--clean"],
        ["hole"],
    ):
        out = tmp_path / "made" / f"{arguments[0]}.csv"
        result = runner.invoke(app, [*arguments, "--out", str(out)])
        assert result.exit_code == 0, result.output
        assert out.with_suffix(".truth.json").exists()
        assert len(pd.read_csv(out)) == len(pd.read_parquet(out.with_suffix(".truth.parquet")))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["oven", "--disk", "middle", "--out", "o.csv"], "fast or slow"),
        (["immersion", "--fluid", "mercury", "--out", "o.csv"], "mobil-jet-ii or water"),
        (["ehl", "--test", "E9", "--out", "o.csv"], "A1 to D4"),
        (["oven", "--out", "/dev/null/o.csv"], "cannot be written"),
        (["campaign", "--out", "/dev/null/lab"], "cannot be written"),
        (["oven", "--out", "o.csv", "--rig", "o.csv"], "which is read"),
        (["oven", "--out", "o.xlsx"], "writes CSV"),
    ],
)
def test_commands_refuse_what_they_cannot_do(
    arguments: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, InputError)
    assert sentence in str(result.exception)
    assert list(tmp_path.iterdir()) == []
