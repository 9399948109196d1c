"""``tcdyn round`` and ``tcdyn spot``: a picture of the synthetic disks, a measured surface, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calibration.rig import load_rig
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


def test_a_heated_spot_becomes_lines_of_the_rig_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, rig = tmp_path / "spot.csv", tmp_path / "rig.toml"
    table.write_text("temperature_degC,flux_W_m2\n" + "".join(f"{t},{300 * (t - 58)}\n" for t in (80, 100, 120, 150)))
    assert tcdyn("spot", table, "--disk", "slow") == 0
    rig.write_text(capsys.readouterr().out)
    found = load_rig(rig).disk_setup("slow").surface
    assert (found.heat_transfer_W_m2K, found.air_degC) == pytest.approx((300.0, 58.0))
    assert found.heat_transfer_u_W_m2K == pytest.approx(6.0)
    assert not load_rig(rig).disk_setup("fast").surface.measured


def test_a_spot_that_cools_what_is_hot_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "spot.csv"
    table.write_text("temperature_degC,flux_W_m2\n80,4\n90,3\n100,2\n110,1\n")
    assert tcdyn("spot", table) == 2
    assert "the flux falls with temperature" in capsys.readouterr().err
