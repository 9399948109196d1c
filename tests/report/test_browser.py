"""The report opened by a real browser: it draws, and the page's scripts and styles complain of nothing."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.cli.test_main_job import tcdyn
from tests.conftest import Campaign

BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_report_opens_in_a_browser_without_console_errors(campaign: Campaign, tmp_path: Path) -> None:
    page, picture = tmp_path / "beta.html", tmp_path / "beta.png"
    words = [w for path in campaign.record_paths.values() for w in ("--record", path)]
    assert tcdyn("beta", campaign.files.ehl["B3"], *words, "--report", page, "-q") == 0
    done = subprocess.run(
        [
            str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--enable-logging=stderr", f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1100,3000",
            f"--screenshot={picture}", page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert "CONSOLE" not in done.stderr
    assert picture.stat().st_size > 100_000  # a page of pictures; an empty one is some kilobytes
