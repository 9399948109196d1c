"""Where a command prints numbers, --json prints them for scripts; --narx answers in a sentence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.rig.disk import Conditioning
from tests.cli.test_main_job import tcdyn
from tests.conftest import Campaign


@pytest.fixture
def table(tmp_path: Path) -> Path:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([25.0, 75.0], 40), 20)
    y = Chain((2.0,), conditioning=Conditioning(poles=0)).response(u, 0.1, "zoh") + rng.normal(
        0, 0.2, len(u)
    )
    path = tmp_path / "data.csv"
    pd.DataFrame({"time_s": 0.1 * np.arange(len(u)), "u": u, "y": y}).to_csv(path, index=False)
    return path


@pytest.mark.e2e
def test_identify_prints_the_model_as_json(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("identify", table, "--input", "u", "--output", "y", "--hold", "zoh", "--model", "P1")
    assert tcdyn(*words, "--json") == 0
    found = json.loads(capsys.readouterr().out)["estimates"]["Tp1"]
    assert (
        abs(found["value"] - 2.0) < 4 * found["u"] < 0.02
    )  # 0.2 K of noise on steps of 50 K, 800 samples
    assert tcdyn(*words, "--narx") == 0
    said = capsys.readouterr().out
    assert "No sign that the lag depends on the level" in said


@pytest.mark.long
@pytest.mark.e2e
def test_what_narx_says_is_in_file_and_page_even_where_nothing_is_printed(
    table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = pd.read_csv(table).assign(plunge=lambda f: np.where(f["time_s"] < 40, "P1", "P2"))
    frame.to_csv(table, index=False)
    words = (
        "identify",
        table,
        "--input",
        "u",
        "--output",
        "y",
        "--hold",
        "zoh",
        "--model",
        "P1",
        "--run",
        "plunge",
    )
    assert tcdyn(*words, "--narx", "--json") == 0
    found = json.loads(capsys.readouterr().out)["narx"]
    assert found["run"] == "P1"
    assert found["sentence"].startswith("Run P1, the first of 2: No sign that the lag depends")
    assert found["lag_low_s"] == pytest.approx(found["lag_high_s"], rel=0.1)
    kept = table.with_suffix(".identified.json")
    assert json.loads(kept.read_text(encoding="utf-8"))["narx"] == found
    assert found["sentence"] in kept.with_suffix(".html").read_text(encoding="utf-8").replace(
        "\u00a0", " "
    )
    kept.unlink()
    assert tcdyn(*words, "--narx", "--quiet") == 0
    assert json.loads(kept.read_text(encoding="utf-8"))["narx"] == found


def test_record_show_prints_json(campaign: Campaign, capsys: pytest.CaptureFixture[str]) -> None:
    assert tcdyn("rig", "record", "show", campaign.record_paths["slow"], "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["disk"] == "slow"
    assert set(shown["static"]) == set("abcdef")
