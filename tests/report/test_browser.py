"""Pages of every kind in a real browser: they are drawn, need no network, and log no console
message."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.partition.analyse import Partition
from tcdyn.report.beta import write_beta_report
from tcdyn.report.campaign import write_campaign_report
from tcdyn.workflows.campaign import CampaignRun
from tests.cli.test_main_job import tcdyn
from tests.conftest import Campaign
from tests.report.test_campaign_page import programme_table

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


def record_options(campaign: Campaign) -> list[object]:
    """Command-line options that name the calibration records."""
    return [w for path in campaign.record_paths.values() for w in ("--record", path)]


def beta(_: Campaign, partition: Partition, page: Path) -> int:
    write_beta_report(page, {"B3": partition})
    return 0


def demo(campaign: Campaign, partition: Partition, page: Path) -> int:
    """The page of ``tcdyn demo``, with the true value of the simulation."""
    write_beta_report(page, {"B3": partition}, {"B3": campaign.truth["tests"]["B3"]["beta"]})
    return 0


def campaign_page(_: Campaign, __: Partition, page: Path) -> int:
    """The page of sixteen tests. The command that analyses the logs first has its own tests."""
    write_campaign_report(page, CampaignRun(page.parent, (), programme_table()))
    return 0


def certificate(campaign: Campaign, _: Partition, page: Path) -> int:
    plunges = [w for plunge in campaign.files.plunges["fast"] for w in ("--immersion", plunge)]
    return tcdyn(
        "rig",
        "calibrate",
        "--rig",
        campaign.files.rig,
        "--disk",
        "fast",
        "--oven",
        campaign.files.ovens["fast"],
        *plunges,
        "--fluid",
        "mobil-jet-ii",
        "--out",
        page.with_suffix(".json"),
        "--report",
        page,
        "-q",
    )


def compensate(campaign: Campaign, _: Partition, page: Path) -> int:
    out = page.with_suffix(".csv")
    return tcdyn(
        "compensate",
        campaign.files.ehl["B3"],
        *record_options(campaign),
        "--out",
        out,
        "--report",
        page,
        "-q",
    )


def design(_: Campaign, __: Partition, page: Path) -> int:
    return tcdyn("rig", "design", "--bath-degC", "110", "--duration-s", "40", "--out", page, "-q")


def identify(_: Campaign, __: Partition, page: Path) -> int:
    u = np.repeat([0.0, 1.0, 0.2, 0.8, 0.0], 40)
    y = np.ravel(Chain((0.8,), conditioning=NO_CONDITIONING).response(u, 0.1, hold="zoh"))
    table = pd.DataFrame(
        {
            "time_s": 0.1 * np.arange(200),
            "u": u,
            "y": y + np.random.default_rng(2).normal(0, 0.01, 200),
        }
    )
    table.to_csv(page.with_suffix(".csv"), index=False)
    data = page.with_suffix(".csv")
    options = ("--hold", "zoh", "--model", "P1")
    return tcdyn(
        "identify", data, "--input", "u", "--output", "y", *options, "--report", page, "-q"
    )


def verify(_: Campaign, __: Partition, page: Path) -> int:
    return tcdyn("verify", "--report", page, "-q")


PAGES = (beta, campaign_page, certificate, compensate, design, identify, demo, verify)


def chromium(*arguments: object) -> str:
    """Standard error of the browser."""
    flags = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--enable-logging=stderr",
    ]
    process = subprocess.run(
        [str(BROWSER), *flags, *(str(w) for w in arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return process.stderr


@pytest.fixture(scope="module", params=PAGES, ids=lambda make: make.__name__)
def page(
    request: pytest.FixtureRequest,
    campaign: Campaign,
    partition: Partition,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    make: Callable[[Campaign, Partition, Path], int] = request.param
    path = tmp_path_factory.mktemp(make.__name__) / "page.html"
    assert make(campaign, partition, path) == 0
    return path


@needs_browser
def test_page_opens_in_a_browser_without_console_messages(page: Path, tmp_path: Path) -> None:
    picture = tmp_path / "page.png"
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    log = chromium(profile, "--window-size=1100,3000", f"--screenshot={picture}", page.as_uri())
    assert "CONSOLE" not in log
    assert picture.stat().st_size > 60_000  # an empty page has a few kilobytes


@pytest.mark.e2e
def test_page_is_one_file_with_result_and_assumptions_first(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    assert "<script" not in html
    assert not re.search(r'(src|href)="(?!data:)', html)
    assert "url(" not in html
    first = html.index("<h2>")
    assert html.index('class="verdict"') < first
    # a page computed from published figures of the thesis states its assumptions in each row
    if "Published numbers" not in html:
        assert html.index('class="assumptions"') < first
    body = html[html.index("<body>") :]
    assert "+-" not in body
    # raw column names
    assert not re.search(r"<th[^>]*>(u_)?[a-z]+(_[a-z]+)*_(s|degC|percent|rms)</th>", body)
