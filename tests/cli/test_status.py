"""What `tcdyn rig beta` ends with: exit code and one line, also where it is to be quiet."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from tcdyn.cli.app import app, run
from tcdyn.core.findings import FEW_SAMPLES_SHARE, Severity, info_or_warning
from tests.conftest import Campaign


def asked(*words: object) -> int:
    return run(lambda: app([str(w) for w in words], standalone_mode=False))


@pytest.mark.long
@pytest.mark.e2e
def test_a_sound_log_ends_with_0_and_the_headline(
    campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records = [w for r in campaign.record_paths.values() for w in ("--record", r)]
    out = tmp_path / "beta.json"
    code = asked(
        "rig", "beta", campaign.files.ehl["B3"], "--rig", campaign.files.rig, *records, "--out", out
    )
    said, kept = capsys.readouterr(), json.loads(out.read_text())
    assert (code, kept["status"]) == (0, "sound")
    assert said.out.startswith("beta = 0.")
    assert said.out.splitlines()[0] == kept["headline"]["sentence"]
    assert "warning:" not in said.err
    low, high = kept["headline"]["range95"]
    assert low < kept["headline"]["beta"]["value"] < high


@pytest.mark.long
@pytest.mark.e2e
def test_friction_in_pounds_ends_with_1_and_one_line_that_says_so_though_quiet(
    campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = pd.read_csv(campaign.files.ehl["B3"])
    log["friction_N"] /= 4.448
    log.to_csv(tmp_path / "B3.csv", index=False)
    records = [w for r in campaign.record_paths.values() for w in ("--record", r)]
    out = tmp_path / "beta.json"
    code = asked(
        "rig",
        "beta",
        tmp_path / "B3.csv",
        "--rig",
        campaign.files.rig,
        *records,
        "--out",
        out,
        "--quiet",
    )
    said, kept = capsys.readouterr(), json.loads(out.read_text())
    assert code == 1
    assert said.out == ""
    assert "error: B3.csv: " in said.err
    assert "info: " not in said.err
    assert kept["joint"]["fast"]["beta"]["value"] is None
    assert (kept["status"], kept["headline"]["beta"]["value"]) == ("withheld", None)
    scale = next(f for f in kept["findings"] if f["code"] == "power.scale")
    assert scale["numbers"]["units"][0] == "friction in pounds-force"


@pytest.mark.long
@pytest.mark.e2e
def test_a_channel_in_degrees_fahrenheit_is_left_out_by_name(
    campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = pd.read_csv(campaign.files.ehl["B3"])
    log["fast_e_degC"] = 1.8 * log["fast_e_degC"] + 32
    log.to_csv(tmp_path / "B3.csv", index=False)
    records = [w for r in campaign.record_paths.values() for w in ("--record", r)]
    out = tmp_path / "beta.json"
    assert (
        asked(
            "rig",
            "beta",
            tmp_path / "B3.csv",
            "--rig",
            campaign.files.rig,
            *records,
            "--out",
            out,
            "--quiet",
        )
        == 0
    )
    kept = json.loads(out.read_text())
    assert "fast_e is left out: fast disk: channel e reads +" in capsys.readouterr().err
    truth = json.loads(campaign.files.truth.read_text())["tests"]["B3"]["beta"]
    beta = kept["headline"]["beta"]
    assert abs(beta["value"] - truth) < 3 * beta["u"] < 0.03


@pytest.mark.parametrize(
    ("share", "grade"),
    [(0.5 * FEW_SAMPLES_SHARE, Severity.INFO), (2 * FEW_SAMPLES_SHARE, Severity.WARNING)],
)
def test_few_samples_that_were_mended_ask_nobody(share: float, grade: Severity) -> None:
    assert info_or_warning(share, "trace.bad", subject="e", percent=100 * share).severity is grade


def test_load_and_friction_exchanged_is_said(
    campaign: Campaign, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Before, the cooling fit ran away and the lag was blamed."""
    log = pd.read_csv(campaign.files.ehl["B3"]).rename(
        columns={"load_N": "friction_N", "friction_N": "load_N"}
    )
    log.to_csv(tmp_path / "B3.csv", index=False)
    records = [w for r in campaign.record_paths.values() for w in ("--record", r)]
    assert asked("rig", "beta", tmp_path / "B3.csv", "--rig", campaign.files.rig, *records) == 2
    assert "are load_N and friction_N exchanged?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("cause", "status"), [(KeyboardInterrupt(), 130), (ValueError("x"), 2), (None, 2)]
)
def test_an_interrupt_that_a_library_turned_into_another_error_is_one(
    cause: BaseException | None, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    def imports() -> None:
        raise ImportError("initialization failed") from cause

    assert run(imports) == status
    assert capsys.readouterr().err.startswith(
        "tcdyn: stopped" if status == 130 else "tcdyn: the system refused"
    )
