"""``tcdyn round``: a picture of the synthetic disks, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.test_main_job import tcdyn


def test_the_synthetic_disks_are_drawn_with_the_uneven_one_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "disks.png"
    assert tcdyn("round", "simulate", "--out", out, "--uneven", "slow:0.5@30", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert out.stat().st_size > 20_000
    apart = {d: told[d]["surface_degC"][1] - told[d]["surface_degC"][0] for d in ("fast", "slow")}
    assert apart["fast"] < 1e-6
    assert apart["slow"] > 1.0
    assert set(told["slow"]["seen_degC"]) == set("abcdef")


def test_what_is_no_picture_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tcdyn("round", "simulate", "--out", tmp_path / "disks.csv") == 2
    assert "a name ending in .png, .svg, .pdf" in capsys.readouterr().err
