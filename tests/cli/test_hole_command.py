"""`tcdyn rig holes` on the synthetic comparison: verdicts of the thesis, a page, JSON, and a clear
refusal."""

import json
from pathlib import Path

import pytest

from tests.cli.test_main_job import tcdyn


def test_hole_command_gives_the_thesis_verdicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, page = tmp_path / "hole.csv", tmp_path / "hole.html"
    assert tcdyn("simulate", "hole", "--out", log, "--seed", 2) == 0
    capsys.readouterr()
    assert tcdyn("rig", "holes", log, "--report", page, "--json") == 0
    holes = {h["hole"]: h for h in json.loads(capsys.readouterr().out)["holes"]}
    assert holes["d1p3"]["verdict"] == "acceptable"
    assert holes["d3p0"]["verdict"] == "too slow"
    assert (
        holes["d1p3"]["extra_lag_s"] < holes["d2p2"]["extra_lag_s"] < holes["d3p0"]["extra_lag_s"]
    )
    assert "data:image/png" in page.read_text(encoding="utf-8")


def test_hole_command_refuses_a_log_without_clamped_channels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "hole.csv"
    assert tcdyn("simulate", "hole", "--out", log, "--seed", 2) == 0
    log.write_text(log.read_text(encoding="utf-8").replace("ideal_", "other_"), encoding="utf-8")
    capsys.readouterr()
    assert tcdyn("rig", "holes", log) == 2
    assert "ideal" in capsys.readouterr().err


def test_hole_command_takes_the_steel_of_the_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, rig = tmp_path / "hole.csv", tmp_path / "rig.toml"
    assert tcdyn("simulate", "hole", "--out", log, "--seed", 2) == 0
    rig.write_text(
        "[disk]\nconductivity_W_mK = 4.1\n", encoding="utf-8"
    )  # a tenth: depth counts ten times as much
    capsys.readouterr()
    u = []
    for words in ((), ("--rig", rig)):
        assert tcdyn("rig", "holes", log, "--json", *words) == 0
        u.append(json.loads(capsys.readouterr().out)["holes"][0]["u_s"])
    assert u[1] > 5 * u[0]
