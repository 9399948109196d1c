"""``tcdyn view``: a page with every trace of a log, as logged and compensated."""

from __future__ import annotations

import json
import re
import webbrowser
from base64 import b64decode
from gzip import decompress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import tcdyn
from tcdyn.core.errors import InputError
from tests.cli.test_main_job import tcdyn as command

TAU_S = 25.0


def charts_of(page: Path) -> dict[str, Any]:
    """Content of the charts of a page."""
    found = re.search(r'id="charts">([^<]*)<', page.read_text(encoding="utf-8"))
    assert found
    content: dict[str, Any] = json.loads(decompress(b64decode(found[1])))
    return content


def lagged(truth: np.ndarray, dt_s: float) -> np.ndarray:
    """First-order lag of an input that is linear between samples."""
    half = (1 - np.exp(-dt_s / TAU_S)) / 2
    return np.asarray(
        lfilter([half, half], [1, 2 * half - 1], truth, zi=[(1 - half) * truth[0]])[0]
    )


@pytest.fixture(name="kiln")
def fixture_kiln(tmp_path: Path) -> Path:
    """A kiln logged for 3000 s, its door opened at 1000 s, in kelvin, with a second column."""
    t = np.arange(0.0, 3000.0, 2.0)
    truth = 1100.0 - np.where(t > 1000, 120 * (1 - np.exp(-(t - 1000) / 60)), 0.0)
    noise = np.random.default_rng(4).normal(0, 0.2, len(t))
    logged = lagged(truth, 2.0) + noise
    table = pd.DataFrame({"t [min]": t / 60, "probe [K]": logged, "gas_kW": 50.0, "truth": truth})
    table.to_csv(tmp_path / "kiln.csv", index=False)
    sensor = tmp_path / "probe.sensor.json"
    options = ("--tau-s", f"{TAU_S:g}+-0.2", "--column", "probe [K]", "--out", sensor, "-q")
    command("sensor", "new", *options)
    return tmp_path / "kiln.csv"


@pytest.mark.e2e
def test_page_shows_the_junction_temperature_over_seconds_in_the_unit_of_the_column(
    kiln: Path,
) -> None:
    page = kiln.with_name("page.html")
    sensor = kiln.with_name("probe.sensor.json")
    command("view", kiln, "--sensor", sensor, "--no-open", "--out", page, "-q")
    (figure,) = charts_of(page).values()
    (chart,) = figure["charts"]
    assert chart["layout"]["yaxis"]["title"]["text"] == "temperature [K]"
    lines = {trace["name"]: trace for trace in chart["data"] if trace["showlegend"]}
    assert set(lines) == {"probe as logged", "probe compensated"}
    table = pd.read_csv(kiln)
    logged, compensated = lines.values()
    assert logged["x"] == pytest.approx(60 * table["t [min]"], abs=1e-2)
    assert logged["y"] == pytest.approx(table["probe [K]"], abs=1e-3)
    error = np.interp(compensated["x"], logged["x"], table["truth"]) - compensated["y"]
    assert np.sqrt(np.mean(error**2)) < 1.0  # the lag makes errors of up to 30 K
    assert np.abs(table["truth"] - table["probe [K]"]).max() > 20


def test_log_without_a_calibration_is_shown_as_logged(
    kiln: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From Python; the browser gets the address of the page."""
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    page, findings = tcdyn.view(kiln)
    assert page == kiln.with_name("kiln.view.html")
    assert opened == [page.as_uri()]
    assert findings == ()
    charts = [chart for figure in charts_of(page).values() for chart in figure["charts"]]
    assert [[t["name"] for t in chart["data"]] for chart in charts] == [
        ["probe"],
        ["gas"],
        ["truth"],
    ]


@pytest.mark.e2e
def test_trace_of_many_rows_is_decimated_and_keeps_its_spike(tmp_path: Path) -> None:
    n = 200_000
    values = np.sin(np.arange(n) / 3000)
    values[123_456] = 40.0
    table = pd.DataFrame({"time_s": np.arange(n) / 10, "T_degC": values})
    table.to_parquet(tmp_path / "log.parquet")
    page, _ = tcdyn.view(tmp_path / "log.parquet", open_browser=False)
    (figure,) = charts_of(page).values()
    (line,) = figure["charts"][0]["data"]
    assert len(line["x"]) == 50_000
    assert line["x"][int(np.argmax(line["y"]))] == 12_345.6
    assert max(figure["charts"][0]["layout"]["yaxis"]["range"]) < 2.0
    assert page.stat().st_size < 6_000_000


def test_a_missing_column_is_an_error_that_names_the_columns(kiln: Path) -> None:
    with pytest.raises(InputError, match="column 'P9' is missing; expected one of 'probe "):
        tcdyn.view(kiln, columns=["P9"], open_browser=False)
    with pytest.raises(
        TypeError, match="unexpected keyword argument 'column'; did you mean 'columns'"
    ):
        tcdyn.view(kiln, column=["P9"], open_browser=False)


@pytest.mark.e2e
def test_options_that_exclude_each_other_are_an_error(kiln: Path) -> None:
    sensor = kiln.with_name("probe.sensor.json")
    assert command("view", kiln, "--sensor", sensor, "--record", sensor, "--no-open") == 2
    out = kiln.with_name("done.csv")
    command("compensate", kiln, "--sensor", sensor, "--out", out, "-q")
    with pytest.raises(InputError, match="compensated"):
        tcdyn.view(out, open_browser=False)
