"""``tcdyn rig circumference`` and ``tcdyn rig line``: pictures, a measured surface, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tcdyn.rig.rigfile import load_rig
from tests.cli.test_main_job import tcdyn


@pytest.mark.long
@pytest.mark.e2e
def test_the_synthetic_disks_are_drawn_with_the_uneven_one_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "disks.png"
    assert (
        tcdyn(
            "rig",
            "circumference",
            "simulate",
            "--picture",
            out,
            "--uneven",
            "slow:0.5@30",
            "--json",
        )
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert out.stat().st_size > 20_000
    apart = {d: told[d]["surface_degC"][1] - told[d]["surface_degC"][0] for d in ("fast", "slow")}
    assert apart["fast"] < 1e-6
    assert apart["slow"] > 1.0
    assert set(told["slow"]["seen_degC"]) == set("abcdef")


def test_what_is_no_picture_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tcdyn("rig", "circumference", "simulate", "--picture", tmp_path / "disks.csv") == 2
    assert "a name ending in .png, .svg or .pdf" in capsys.readouterr().err


def test_a_heated_spot_becomes_lines_of_the_rig_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, rig = tmp_path / "spot.csv", tmp_path / "rig.toml"
    table.write_text(
        "temperature_degC,flux_W_m2\n"
        + "".join(f"{t},{300 * (t - 58)}\n" for t in (80, 100, 120, 150))
    )
    assert tcdyn("rig", "line", table, "--disk", "slow") == 0
    rig.write_text(capsys.readouterr().out)
    found = load_rig(rig).disk_setup("slow").surface
    assert (found.heat_transfer_W_m2K, found.air_degC) == pytest.approx((300.0, 58.0))
    assert found.heat_transfer_u_W_m2K == pytest.approx(6.0)
    assert not load_rig(rig).disk_setup("fast").surface.is_measured


def test_a_spot_that_cools_what_is_hot_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "spot.csv"
    table.write_text("temperature_degC,flux_W_m2\n80,4\n90,3\n100,2\n110,1\n")
    assert tcdyn("rig", "line", table) == 2
    assert "the flux falls with temperature" in capsys.readouterr().err


FIT = """
[slow.fit]
interference_um = 20
keyways = [{ angle_deg = 40, width_mm = 6, share = 0.1 }]
patches = [{ from_deg = 300, to_deg = 10, share = 0.2 }]
"""


def test_a_stated_press_fit_is_told_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, out = tmp_path / "rig.toml", tmp_path / "fit.png"
    rig.write_text(FIT)
    assert tcdyn("rig", "circumference", "fit", "--rig", rig, "--picture", out, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert out.stat().st_size > 10_000
    assert set(told) == {"picture", "slow"}
    slow = told["slow"]
    assert slow["pressure_MPa"] == pytest.approx(
        27.3 * 20 / 15.2, rel=0.002
    )  # section 6.4.3: 27.3 MPa at 15.2 um
    key = 6 / 20.5 * 180 / 3.141592654
    assert slow["mean_W_m2K"] / slow["bearing_W_m2K"] == pytest.approx(
        1 - (0.9 * key + 0.8 * 70) / 360
    )
    assert 150 < slow["first"]["angle_deg"] < 200  # away from both
    assert tcdyn("rig", "circumference", "fit", "--rig", rig) == 0
    words = capsys.readouterr().out
    assert "slow disk: pressure 35.9 MPa" in words
    bears, mean = (slow[k] / 1000 for k in ("bearing_W_m2K", "mean_W_m2K"))
    assert f"conductance {bears:.2f} kW/m2K where the fit bears, {mean:.2f} in the mean" in words
    shown = tmp_path / "shown.toml"
    assert tcdyn("rig", "check", rig) == 0
    shown.write_text(capsys.readouterr().out)
    assert load_rig(shown) == load_rig(rig)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "patches = [{ from_deg = 10, to_deg = 400 }]",
            "slow.fit.patches.0.to_deg: Input should be less than or equal",
        ),
        ("patches = [{ from_deg = 10, to_deg = 40, share = 1.2 }]", "slow.fit.patches.0.share"),
        ("patches = [{ from_deg = 40, to_deg = 40 }]", "has no width"),
        (
            "patches = [{ from_deg = 10, to_deg = 40 }, { from_deg = 30, to_deg = 5 }]",
            "overlap from 30 to 40 degrees",
        ),
        (
            "keyways = [{ angle_deg = 5, width_deg = 20 }]\npatches = [{ from_deg = 350, "
            "to_deg = 356 }]",
            "overlap",
        ),
        ("keyways = [{ angle_deg = 5 }]", "one of width_deg and width_mm"),
        ("keyways = [{ angle_deg = 5, width_mm = 200 }]", "more than the bore's circumference"),
        (
            "patches = [{ from_deg = 0, to_deg = 180 }, { from_deg = 180, to_deg = 360 }]",
            "leave nothing",
        ),
        (
            "interference_um = 0\nkeyways = [{ angle_deg = 5, width_deg = 5 }]",
            "need an interference_um",
        ),
    ],
)
def test_a_fit_that_cannot_be_is_refused(
    line: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f"[slow.fit]\n{line if 'interference' in line else 'interference_um = 20'}\n"
        f"{'' if 'interference' in line else line}\n"
    )
    assert tcdyn("rig", "circumference", "fit", "--rig", rig) == 2
    assert said in capsys.readouterr().err


def test_without_a_stated_fit_there_is_nothing_to_tell(capsys: pytest.CaptureFixture[str]) -> None:
    assert tcdyn("rig", "circumference", "fit", "--disk", "slow") == 2
    assert "states no press fit of the slow disk" in capsys.readouterr().err
