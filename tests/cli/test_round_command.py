"""``tcdyn round``: a picture of the synthetic disks, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

from tests.cli.test_main_job import tcdyn


def test_the_synthetic_disks_are_drawn_with_the_uneven_one_told(tmp_path: Path) -> None:
    out = tmp_path / "disks.png"
    done = tcdyn("round", "simulate", "--out", str(out), "--uneven", "slow:0.5@30", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert out.stat().st_size > 20_000
    apart = {d: told[d]["surface_degC"][1] - told[d]["surface_degC"][0] for d in ("fast", "slow")}
    assert apart["fast"] < 1e-6
    assert apart["slow"] > 1.0
    assert set(told["slow"]["seen_degC"]) == set("abcdef")


def test_what_is_no_picture_is_refused(tmp_path: Path) -> None:
    done = tcdyn("round", "simulate", "--out", str(tmp_path / "disks.csv"))
    assert done.returncode == 2
    assert "a name ending in .png, .svg, .pdf" in done.stderr
