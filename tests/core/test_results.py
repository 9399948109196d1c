"""Every result of the workflow has a summary, JSON, a notebook view and, if useful, a plot."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path
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
from tcdyn.rig.record import read_record, write_record
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

WITHOUT_PLOT = {"Rig", "CampaignFiles", "RecordComparison"}


@pytest.fixture(scope="module")
def results(
    campaign: Campaign, calibrations: dict[str, CalibrationRun], beta_run: BetaRun
) -> dict[str, Any]:
    """Results of the functions of ``import tcdyn`` on a small campaign, by class name."""
    from immersion.hole import compare_holes
    from tcdyn.design.compare import compare_tests
    from tcdyn.design.plans import PlungePlan
    from tcdyn.simulate.plunge import simulate_hole
    from tcdyn.smoothing import proper_inverse, report_inverse

    rig = campaign.rig
    records = campaign.records
    log = campaign.files.ehl["B3"]
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
    campaign_data = {
        "friction_coefficient": 0.03,
        "bulk_degC": {d: s["d"] for d, s in steady.items()},
        "steady_degC": steady,
    }
    instances = [
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
            log.parent,
            (),
            campaign_table([table_row("B3", {**beta.to_dict(), "campaign": campaign_data})]),
        ),
    ]
    return {type(result).__name__: result for result in instances}


class TagChecker(HTMLParser):
    """Check that every opened tag is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.e2e
def test_demo_comparison_matches_the_files(results: dict[str, Any], campaign: Campaign) -> None:
    compensated = results["CompensatedLog"]
    demo = results["DemoRun"]
    unload_s = campaign.truth["tests"]["B3"]["unload_s"]
    true = pd.read_parquet(campaign.files.folder / "truth" / "EHL_B3_traces.parquet")
    t = true["time_s"]
    after_unloading = (t >= unload_s) & (t < unload_s + 5.0)
    estimates = demo.comparison.set_index("quantity")["estimate"]
    for disk in ("fast", "slow"):
        column = f"{disk}_e_degC"
        for frame, quantity in (
            (compensated.raw_log.frame, "raw, 5 s after unloading"),
            (compensated.frame, "compensated"),
        ):
            residual = (frame[column] - true[column])[after_unloading]
            assert estimates[f"B3 {disk} e, rms error {quantity}"] == pytest.approx(
                np.sqrt(residual.pow(2).mean())
            )


def test_every_result_has_a_summary_json_and_html(results: dict[str, Any]) -> None:
    assert len(results) >= 20
    for name, result in results.items():
        assert isinstance(result, Result), name
        summary = result.summary()
        assert len(summary) > 20, name
        assert "nan" not in summary.lower().split(), name
        data = result.to_dict()
        assert data
        # no NaN, no tuples, string keys only
        assert json.loads(json.dumps(data, allow_nan=False)) == data, name
        html = result._repr_html_()
        parser = TagChecker()
        parser.feed(html)
        assert not parser.open, name
        assert name in html


def test_every_result_has_a_plot_or_raises(results: dict[str, Any]) -> None:
    from tcdyn.plots.style import figure

    for name, result in results.items():
        drawing, (ax,) = figure()
        options = {"logged": result.temperature} if name == "Compensated" else {}
        if name in WITHOUT_PLOT:
            with pytest.raises(InputError, match="has no picture"):
                tcdyn.plots.draw(result, ax)
        else:
            assert tcdyn.plots.draw(result, ax, **options) is ax, name
            assert ax.has_data(), name
            assert ax.get_xlabel(), name
        del drawing


def test_notebook_view_of_each_result_contains_its_plot(results: dict[str, Any]) -> None:
    from tcdyn.report.page import card_html

    for name, result in results.items():
        assert card_html(result).count("<img") == (name not in WITHOUT_PLOT), name


def test_every_exported_plot_function_exists() -> None:
    for name in tcdyn.plots.__all__:
        assert callable(getattr(tcdyn.plots, name)), name


def test_json_of_a_result_equals_its_file(
    results: dict[str, Any], calibrations: dict[str, CalibrationRun], tmp_path: Path
) -> None:
    path = write_record(calibrations["fast"].record, tmp_path / "fast.disk.json")
    written = json.loads(path.read_text(encoding="utf-8"))
    assert read_record(path).to_dict() == written
    record = json.loads(calibrations["fast"].record.to_json())
    assert results["CalibrationRun"].to_dict()["static"] == record["static"]
    assert json.loads(results["Identified"].to_json()) == results["Identified"].to_dict()
