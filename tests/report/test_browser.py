"""Pages of every kind in a real browser: charts zoom and switch, narrow screens, dark mode, print.

Chromium is controlled by Selenium, offline.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

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
DRIVER = shutil.which("chromedriver")
MAX_BYTES = 6_000_000  # of a page, so that it can be sent by mail
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


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


def campaign_page(page: Path) -> int:
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


def design(page: Path) -> int:
    return tcdyn("rig", "design", "--bath-degC", "110", "--duration-s", "40", "--out", page, "-q")


def identify(page: Path) -> int:
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


def verify(page: Path) -> int:
    return tcdyn("verify", "--report", page, "-q")


def view(campaign: Campaign, _: Partition, page: Path) -> int:
    log = campaign.files.ehl["B3"]
    return tcdyn("view", log, *record_options(campaign), "--no-open", "--out", page, "-q")


RIG_PAGES = (beta, certificate, compensate, demo, view)
PAGES = [
    *(pytest.param(make, marks=pytest.mark.long) for make in RIG_PAGES),
    *(campaign_page, design, identify, verify),
]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless browser without a network."""
    if BROWSER is None or DRIVER is None:
        pytest.skip("no Chromium with chromedriver on this machine")
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs the extra 'test'")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(DRIVER))
    driver.execute_cdp_cmd("Network.enable", {})
    offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
    yield driver
    driver.quit()


def show(
    browser: Any, page: Path, width: int = 1100, scheme: str = "light", *, all_figures: bool = False
) -> None:
    """Open a page and wait until its first figure, or each one, is drawn as a chart."""
    from selenium.webdriver.support.wait import WebDriverWait

    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": features})
    size = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get("about:blank")
    browser.get_log("browser")
    browser.get(page.as_uri())
    browser.execute_script("document.querySelectorAll('details').forEach(e => { e.open = true })")
    of_interest = "figure:not(.interactive)" if all_figures else "figure:first-of-type"

    def is_drawn(driver: Any) -> bool:
        """Scroll to the next figure that is not drawn yet."""
        script = """const figure = document.querySelector(arguments[0]);
            if (!figure || figure.classList.contains('interactive')) return true;
            figure.scrollIntoView(); return false"""
        return bool(driver.execute_script(script, of_interest))

    WebDriverWait(browser, 120, poll_frequency=0.3).until(is_drawn)


@pytest.fixture(scope="module", params=PAGES, ids=lambda make: make.__name__)
def page(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    make: Callable[..., int] = request.param
    path = tmp_path_factory.mktemp(make.__name__) / "page.html"
    inputs: list[Any] = []
    if make in RIG_PAGES:
        inputs = [request.getfixturevalue(name) for name in ("campaign", "partition")]
    assert make(*inputs, path) == 0
    return path


@pytest.mark.e2e
def test_zoom_changes_the_range_of_an_axis(browser: Any, page: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    show(browser, page)
    chart = browser.find_element("css selector", ".chart")
    area = chart.find_element("css selector", ".nsewdrag")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
    axis_range = "return arguments[0].layout.xaxis.range.map(Number)"
    before = browser.execute_script(axis_range, chart)
    drag = ActionChains(browser).move_to_element_with_offset(area, -60, -30).click_and_hold()
    drag.move_by_offset(120, 60).release().perform()
    zoomed = browser.execute_script(axis_range, chart)
    assert abs(zoomed[1] - zoomed[0]) < 0.5 * abs(before[1] - before[0])


@pytest.mark.e2e
def test_entry_of_the_legend_hides_its_trace(browser: Any, page: Path) -> None:
    from selenium.webdriver.support.wait import WebDriverWait

    show(browser, page)
    entries = browser.find_elements("css selector", ".chart .legendtoggle")
    hidden = """return [...document.querySelectorAll('.chart')].reduce((n, chart) => n
        + [...chart.data, ...(chart.layout.shapes || [])].filter(
            item => item.visible === 'legendonly').length, 0)"""
    assert entries
    assert browser.execute_script(hidden) == 0
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", entries[0])
    entries[0].click()
    # the click counts when no second one has followed
    WebDriverWait(browser, 20).until(lambda driver: driver.execute_script(hidden) >= 1)


@pytest.mark.e2e
def test_narrow_screen_has_no_horizontal_overflow(browser: Any, page: Path) -> None:
    show(browser, page, width=400, all_figures=True)
    widths = "return [document.documentElement.scrollWidth, document.body.scrollWidth, innerWidth]"
    full, body, window = browser.execute_script(widths)
    assert max(full, body) <= window == 400
    ends = """return [...document.querySelectorAll('.chart .main-svg')].map(
        e => e.getBoundingClientRect().right)"""
    assert max(browser.execute_script(ends)) <= 400


@pytest.mark.e2e
def test_dark_mode_changes_background_and_text(browser: Any, page: Path) -> None:
    colours = "const s = getComputedStyle(document.body); return [s.backgroundColor, s.color]"
    show(browser, page)
    light = browser.execute_script(colours)
    show(browser, page, scheme="dark")
    dark = browser.execute_script(colours)

    def brightness(colour: str) -> float:
        """Mean of the three colours."""
        return sum(map(int, re.findall(r"\d+", colour)[:3])) / 3

    assert brightness(light[0]) > 200 > 60 > brightness(dark[0])
    assert brightness(light[1]) < 60 < 200 < brightness(dark[1])


@pytest.mark.e2e
def test_print_shows_the_pictures_and_not_the_charts(browser: Any, page: Path) -> None:
    displays = """return ['.interactive .picture', '.charts'].map(name => [...new Set(
        [...document.querySelectorAll(name)].map(e => getComputedStyle(e).display))])"""
    show(browser, page)
    assert browser.execute_script(displays) == [["none"], ["grid"]]
    media = {"media": "print", "features": []}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    assert browser.execute_script(displays) == [["block"], ["none"]]


@pytest.mark.e2e
def test_page_has_no_console_messages_and_no_figure_without_charts(
    browser: Any, page: Path
) -> None:
    show(browser, page, all_figures=True)
    assert browser.get_log("browser") == []
    assert "A picture only" not in page.read_text(encoding="utf-8")


@pytest.mark.e2e
def test_page_is_one_file_with_result_and_assumptions_first(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    assert page.stat().st_size < MAX_BYTES
    assert html.count('id="plotly"') == 1
    assert not re.search(r'(src|href)="(?!data:)', html)
    assert "url(" not in html
    first = html.index("<h2>")
    assert html.index('class="verdict"') < first
    # a page computed from published figures of the thesis states its assumptions in each row, and
    # one that only shows traces has none
    if "Published numbers" not in html and "as logged and compensated</title>" not in html:
        assert html.index('class="assumptions"') < first
    body = html[html.index("<body>") :]
    assert "+-" not in body.partition('<script type="text/plain"')[0]
    # raw column names
    assert not re.search(r"<th[^>]*>(u_)?[a-z]+(_[a-z]+)*_(s|degC|percent|rms)</th>", body)
