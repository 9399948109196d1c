"""Every result of the workflow says itself in words, as JSON, in a notebook, and in a picture where one makes sense."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest

import tcdyn
from calibration.compare import compare_records
from tcdyn.core.errors import InputError
from tcdyn.core.result import Result
from tcdyn.rig.disk import Conditioning
from tcdyn.workflows import BetaRun
from tcdyn.workflows.calibrate import CalibrationRun
from tcdyn.workflows.campaign import CampaignRun
from tcdyn.workflows.campaign_log import steady_degC
from tcdyn.workflows.campaign_table import campaign_table, table_row
from tcdyn.workflows.demo import DemoRun, compare_with_truth
from tests.conftest import Campaign

matplotlib.use("Agg")

import tcdyn.plots

RIG_FILTER = Conditioning(cutoff_Hz=4.0, poles=2)

WITHOUT_PICTURE = {"Rig", "CampaignFiles", "RecordComparison"}


@pytest.fixture(scope="module")
def results(
    campaign: Campaign, calibrations: dict[str, CalibrationRun], beta_run: BetaRun
) -> dict[str, Any]:
    """What the names of ``import tcdyn`` return on a small campaign, by class name."""
    from immersion.hole import compare_holes
    from tcdyn.design.compare import compare_tests
    from tcdyn.design.plans import PlungePlan
    from tcdyn.simulate.plunge import simulate_hole
    from tcdyn.smoothing import proper_inverse, report_inverse

    rig, records, log = campaign.rig, campaign.records, campaign.files.ehl["B3"]
    chain = tcdyn.Chain((0.6, 0.1), conditioning=RIG_FILTER)
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([25.0, 75.0], 40), 20)
    y = chain.response(u, 0.1, "zoh") + rng.normal(0, 0.1, len(u))
    data = tcdyn.IOData.from_arrays(u, y, 0.1, hold="zoh")
    fitted = tcdyn.fit(data, "P1")
    compensated = tcdyn.compensate_log(log, records, rig)
    beta = beta_run
    comparison = compare_with_truth(campaign.files, calibrations, {"B3": beta}, {"B3": compensated})
    steady = steady_degC(beta.partition.test)
    more = {
        "friction_coefficient": 0.03,
        "bulk_degC": {d: s["d"] for d, s in steady.items()},
        "steady_degC": steady,
    }
    made = [
        rig,
        tcdyn.read_log(log, "ehl", rig),
        records["fast"],
        compare_records(records["fast"], records["fast"]),
        campaign.files,
        calibrations["fast"],
        calibrations["fast"].oven,
        compensated,
        beta,
        DemoRun(campaign.files, calibrations, {"B3": beta}, {"B3": compensated}, comparison),
        chain,
        tcdyn.smooth(y, 0.1, chain, lag_covariance=np.array([[0.01]])),
        report_inverse(proper_inverse(chain, 0.1, 1.0), 0.1),
        data,
        fitted,
        fitted.identified,
        tcdyn.compare(data, ["P1", "P1D"]),
        compare_holes(simulate_hole(2)[0]),
        compare_tests(rig.disk_setup("fast"), [PlungePlan("mobil-jet-ii", 110.0)], draws=2),
        CampaignRun(
            log.parent, (), campaign_table([table_row("B3", {**beta.to_dict(), "campaign": more})])
        ),
    ]
    return {type(one).__name__: one for one in made}


class Balanced(HTMLParser):
    """Whether every tag that opens is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.e2e
def test_the_demo_s_comparison_is_that_of_the_files(
    results: dict[str, Any], campaign: Campaign
) -> None:
    done, demo = results["CompensatedLog"], results["DemoRun"]
    unload_s = campaign.truth["tests"]["B3"]["unload_s"]
    true = pd.read_parquet(campaign.files.folder / "truth" / "EHL_B3_traces.parquet")
    t = true["time_s"]
    after = (t >= unload_s) & (t < unload_s + 5.0)
    told = demo.comparison.set_index("quantity")["estimate"]
    for disk in ("fast", "slow"):
        column = f"{disk}_e_degC"
        for frame, what in (
            (done.raw_log.frame, "raw, 5 s after unloading"),
            (done.frame, "compensated"),
        ):
            left = (frame[column] - true[column])[after]
            assert told[f"B3 {disk} e, rms error {what}"] == pytest.approx(
                np.sqrt(left.pow(2).mean())
            )


def test_every_result_speaks_words_json_and_html(results: dict[str, Any]) -> None:
    assert len(results) >= 20
    for name, one in results.items():
        assert isinstance(one, Result), name
        words = one.summary()
        assert len(words) > 20, name
        assert "nan" not in words.lower().split(), name
        plain = one.to_dict()
        assert plain
        assert json.loads(json.dumps(plain, allow_nan=False)) == plain, (
            name
        )  # no NaN, no tuple, no key but text
        page = one._repr_html_()
        parser = Balanced()
        parser.feed(page)
        assert not parser.open, name
        assert name in page


def test_every_result_has_its_picture_or_says_that_it_has_none(results: dict[str, Any]) -> None:
    from tcdyn.plots.style import figure

    for name, one in results.items():
        drawing, (ax,) = figure()
        more = {"logged": one.temperature} if name == "Compensated" else {}
        if name in WITHOUT_PICTURE:
            with pytest.raises(InputError, match="has no picture"):
                tcdyn.plots.draw(one, ax)
        else:
            assert tcdyn.plots.draw(one, ax, **more) is ax, name
            assert ax.has_data(), name
            assert ax.get_xlabel(), name
        del drawing


def test_a_notebook_shows_each_result_with_its_picture(results: dict[str, Any]) -> None:
    from tcdyn.report.page import card_html

    for name, one in results.items():
        assert card_html(one).count("<img") == (name not in WITHOUT_PICTURE), name


def test_every_exported_picture_exists_under_its_name() -> None:
    for name in tcdyn.plots.__all__:
        assert callable(getattr(tcdyn.plots, name)), name


def test_a_result_s_json_is_its_file_s(
    results: dict[str, Any], campaign: Campaign, calibrations: dict[str, CalibrationRun]
) -> None:
    written = json.loads(campaign.record_paths["fast"].read_text(encoding="utf-8"))
    assert results["DiskRecord"].to_dict() == written
    record = json.loads(calibrations["fast"].record.to_json())
    assert results["CalibrationRun"].to_dict()["static"] == record["static"]
    assert json.loads(results["Identified"].to_json()) == results["Identified"].to_dict()
