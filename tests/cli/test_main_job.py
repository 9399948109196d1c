"""The main job from files: the commands give what the functions give, and bad input gets one
sentence and exit 2."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.cli.app import app, run
from tcdyn.workflows import BetaRun
from tcdyn.workflows.calibrate import CalibrationRun
from tests.conftest import Campaign


def tcdyn(*words: object) -> int:
    """Run the command in this process, as the entry point does; its exit code."""
    return run(lambda: app([str(w) for w in words]))


@pytest.fixture(scope="module")
def beta_json(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("beta") / "beta.json"
    code = tcdyn(
        "rig",
        "beta",
        campaign.files.ehl["B3"],
        "--rig",
        campaign.files.rig,
        *records(campaign),
        "--out",
        out,
        "--report",
        out.with_suffix(".html"),
        "--quiet",
    )
    assert code == 0
    return out


def records(campaign: Campaign) -> list[object]:
    return [word for path in campaign.record_paths.values() for word in ("--record", path)]


@pytest.mark.e2e
def test_beta_json_has_the_contract_s_keys(beta_json: Path) -> None:
    data = json.loads(beta_json.read_text(encoding="utf-8"))
    estimate = {"value", "u", "low95", "high95"}
    assert set(data) >= {"test", "steady", "transient", "joint", "crosscheck", "budget", "surface"}
    assert set(data["test"]) == {
        "load_N",
        "friction_N",
        "sliding_speed_m_s",
        "entraining_speed_m_s",
        "half_width_m",
        "load_on_s",
        "unload_s",
    }
    assert set(data["steady"]) == {"beta", "h_fast", "h_slow", "fast_line", "slow_line", "exponent"}
    assert set(data["steady"]["fast_line"]) == {"intercept", "slope"}
    for disk in ("fast", "slow"):
        assert set(data["transient"][disk]) == {"beta", "h", "window_s"}
        assert set(data["joint"][disk]) == {"beta", "h", "lag_s"}
        assert set(data["joint"][disk]["lag_s"]) == estimate
    assert set(data["joint"]["both"]) == {"beta", "h_fast", "h_slow", "exponent"}
    assert set(data["steady"]["beta"]) == estimate
    assert set(data["crosscheck"]) >= {"z", "agree", "sentence"}
    assert all(
        set(row) == {"source", "u_beta_steady", "u_beta_transient"} for row in data["budget"]
    )
    assert set(data["surface"]) == {"fast_max_degC", "slow_max_degC", "delta_T_us"}


def test_every_way_to_beta_holds_the_truth_of_the_simulation(
    beta_json: Path, campaign: Campaign
) -> None:
    data = json.loads(beta_json.read_text(encoding="utf-8"))
    truth = campaign.truth["tests"]["B3"]
    # limits of the first issue: 0.02 by the speed law, 0.03 by the cooling fits
    assert data["steady"]["beta"]["value"] == pytest.approx(truth["beta"], abs=0.02)
    for disk in ("fast", "slow"):
        assert data["transient"][disk]["beta"]["value"] == pytest.approx(truth["beta"], abs=0.03)
        lag = data["joint"][disk]["lag_s"]
        assert (
            abs(lag["value"] - campaign.truth[disk]["common_lag_s"]) < 4 * lag["u"]
        )  # one in 16000 by chance
    assert data["crosscheck"]["agree"]


@pytest.mark.e2e
def test_command_and_function_give_the_same_numbers(beta_json: Path, beta_run: BetaRun) -> None:
    assert json.loads(beta_json.read_text(encoding="utf-8")) == json.loads(
        json.dumps(beta_run.to_dict())
    )


def test_report_is_one_file_with_verdict_and_pictures(beta_json: Path) -> None:
    html = beta_json.with_suffix(".html").read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") >= 6
    words = re.sub(r"base64,[^\"']+", "", html)  # a picture's letters may spell anything
    assert "http" not in words.replace("http-equiv", "")
    assert "The estimates of beta agree" in html


@pytest.mark.e2e
def test_compensated_e_is_ten_times_closer_than_raw(campaign: Campaign, tmp_path: Path) -> None:
    out = tmp_path / "B3.compensated.csv"
    assert (
        tcdyn("compensate", campaign.files.ehl["B3"], *records(campaign), "--out", out, "--quiet")
        == 0
    )
    done = pd.read_csv(out)
    raw = pd.read_csv(campaign.files.ehl["B3"])
    true = pd.read_parquet(campaign.files.folder / "truth" / "EHL_B3_traces.parquet")
    off = campaign.truth["tests"]["B3"]["unload_s"]
    after = ((raw["time_s"] >= off) & (raw["time_s"] < off + 5)).to_numpy()
    for disk in ("fast", "slow"):
        column = f"{disk}_e_degC"
        before = np.sqrt(np.nanmean((raw[column] - true[column])[after] ** 2))
        now = np.sqrt(np.mean((done[column] - true[column])[after] ** 2))
        assert now < before / 10
        z = ((done[column] - true[column]) / done[f"{disk}_e_u_K"])[after]
        assert (
            np.sqrt(np.mean(z**2)) < 3
        )  # errors are correlated over a second: a mean square, loosely judged
    assert tcdyn("compensate", out, *records(campaign), "--out", tmp_path / "twice.csv") == 2
    assert not (tmp_path / "twice.csv").exists()


@pytest.mark.e2e
def test_calibrate_writes_the_record_that_the_function_makes(
    campaign: Campaign, calibrations: dict[str, CalibrationRun], tmp_path: Path
) -> None:
    out = tmp_path / "fast.disk.json"
    f = campaign.files
    words = [w for p in f.plunges["fast"] for w in ("--immersion", p)]
    code = tcdyn(
        "rig",
        "calibrate",
        "--rig",
        f.rig,
        "--disk",
        "fast",
        "--oven",
        f.ovens["fast"],
        *words,
        "--fluid",
        "mobil-jet-ii",
        "--out",
        out,
        "--report",
        tmp_path / "fast.html",
        "--quiet",
    )
    assert code == 0
    made = json.loads(out.read_text(encoding="utf-8"))
    inside = json.loads(calibrations["fast"].record.to_json())
    for one in (made, inside):
        del one["created"], one["sha256"]
    assert made == inside
    assert "data:image/png" in (tmp_path / "fast.html").read_text(encoding="utf-8")


def rewritten(campaign: Campaign, path: Path, change: object) -> Path:
    frame = pd.read_csv(campaign.files.ehl["B3"])
    change(frame).to_csv(path, index=False)  # type: ignore[operator]
    return path


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.drop(columns="friction_N"), ("friction_N", "missing")),
        (lambda f: f.assign(contact=1, load_N=0.0, friction_N=0.0), ("loaded stretch",)),
        (lambda f: f.assign(fast_a_degC=f["fast_a_degC"] + 273.15), ("fast_a_degC", "kelvin")),
        (lambda f: f.iloc[: int(len(f) * 0.5)], ("unload",)),
        (
            lambda f: f.rename(
                columns={"fast_a_degC": "fast_e_degC", "fast_e_degC": "fast_a_degC"}
            ),
            ("fast disk", "a and e", "swapped"),
        ),
    ],
    ids=[
        "missing column",
        "never loaded",
        "kelvin",
        "truncated before unloading",
        "swapped channels",
    ],
)
def test_a_bad_log_gets_one_sentence_and_exit_2(
    campaign: Campaign,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: object,
    words: tuple[str, ...],
) -> None:
    log = rewritten(campaign, tmp_path / "bad.csv", change)
    out = tmp_path / "beta.json"
    assert (
        tcdyn(
            "rig", "beta", log, "--rig", campaign.files.rig, *records(campaign), "--out", out, "-q"
        )
        == 2
    )
    said = capsys.readouterr().err.strip()
    assert said.startswith("tcdyn: ")
    assert "\n" not in said
    for word in words:
        assert word in said
    assert not out.exists()


def test_the_wrong_file_to_the_wrong_command_is_named(
    campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    f = campaign.files
    assert tcdyn("rig", "beta", f.ovens["fast"], *records(campaign), "-q") == 2
    assert "oven" in capsys.readouterr().err
    code = tcdyn(
        "rig",
        "calibrate",
        "--disk",
        "fast",
        "--oven",
        f.ehl["B3"],
        "--immersion",
        f.plunges["fast"][0],
        "--out",
        tmp_path / "r.json",
        "-q",
    )
    assert code == 2
    assert "EHL" in capsys.readouterr().err
    fast = campaign.record_paths["fast"]
    assert tcdyn("rig", "beta", f.ehl["B3"], "--record", fast, "--record", fast, "-q") == 2
    assert "second record" in capsys.readouterr().err
    assert tcdyn("rig", "beta", f.ehl["B3"], "--record", fast, "-q") == 2
    assert "slow" in capsys.readouterr().err
    assert tcdyn("rig", "beta", f.ehl["B3"], "--record", f.rig, "-q") == 2


def test_a_window_shorter_than_the_lag_is_refused(
    campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        tcdyn(
            "rig", "beta", campaign.files.ehl["B3"], *records(campaign), "--window-s", "0.3", "-q"
        )
        == 2
    )
    assert "shorter than the lag" in capsys.readouterr().err


def test_rig_show_can_be_read_back(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert tcdyn("rig", "check") == 0
    text = capsys.readouterr().out
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    assert tcdyn("rig", "check", path) == 0
    assert capsys.readouterr().out == text
    path.write_text(text.replace("gear_ratio", "gear_ration"), encoding="utf-8")
    assert tcdyn("rig", "check", path) == 2
    assert "gear_ration" in capsys.readouterr().err
