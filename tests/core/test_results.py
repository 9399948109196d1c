"""Every result of the workflow has a summary, JSON, a notebook view and, if useful, a plot."""

from __future__ import annotations

import json
import pickle
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest

import tcdyn
from calibration.compare import compare_records
from tcdyn.campaign.steady_maps import steady_degC
from tcdyn.campaign.summary_table import campaign_table, table_row
from tcdyn.core.result import Result
from tcdyn.rig.record import read_record, write_record
from tcdyn.workflows import BetaRun
from tcdyn.workflows.calibrate import CalibrationRun
from tcdyn.workflows.campaign import CampaignRun
from tcdyn.workflows.demo import DemoRun, compare_with_truth
from tests.conftest import Campaign
from tests.core.conftest import by_class

matplotlib.use("Agg")

import tcdyn.plots

MAX_REPR = 300  # characters of a representation: a few lines of a terminal


@pytest.fixture(scope="module")
def campaign_results(
    campaign: Campaign, calibrations: dict[str, CalibrationRun], beta_run: BetaRun
) -> dict[str, Any]:
    """Results of the functions of ``import tcdyn`` on a small campaign, by class name."""
    from immersion.hole import compare_holes
    from tcdyn.design.compare import compare_tests
    from tcdyn.design.plans import PlungePlan
    from tcdyn.simulate.plunge import simulate_hole

    rig = campaign.rig
    records = campaign.records
    log = campaign.files.ehl["B3"]
    compensated = tcdyn.compensate_log(log, records, rig)
    beta = beta_run
    comparison = compare_with_truth(campaign.files, calibrations, {"B3": beta}, {"B3": compensated})
    steady = steady_degC(beta.partition.test)
    campaign_data = {
        "friction_coefficient": 0.03,
        "bulk_degC": {d: s["d"] for d, s in steady.items()},
        "steady_degC": steady,
    }
    return by_class(
        [
            rig,
            tcdyn.read_log(log, "ehl", rig),
            records["fast"],
            compare_records(records["fast"], records["fast"]),
            campaign.files,
            calibrations["fast"],
            calibrations["fast"].oven,
            calibrations["fast"].fit,
            compensated,
            beta,
            DemoRun(campaign.files, calibrations, {"B3": beta}, {"B3": compensated}, comparison),
            compare_holes(simulate_hole(2)[0]),
            compare_tests(rig.disk_setup("fast"), [PlungePlan("mobil-jet-ii", 110.0)], draws=2),
            CampaignRun(
                log.parent,
                (),
                campaign_table([table_row("B3", {**beta.to_dict(), "campaign": campaign_data})]),
            ),
        ]
    )


@pytest.fixture(params=["quick_results", pytest.param("campaign_results", marks=pytest.mark.e2e)])
def results(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Both groups of results."""
    return request.getfixturevalue(request.param)


class TagChecker(HTMLParser):
    """Check that every opened tag is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.long
@pytest.mark.e2e
def test_demo_comparison_matches_the_files(
    campaign_results: dict[str, Any], campaign: Campaign
) -> None:
    compensated = campaign_results["CompensatedLog"]
    demo = campaign_results["DemoRun"]
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


@pytest.mark.e2e
def test_every_result_has_a_summary_json_and_html(results: dict[str, Any]) -> None:
    assert len(results) >= 14
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


def test_representation_is_short_and_is_what_print_shows(results: dict[str, Any]) -> None:
    for name, result in results.items():
        assert len(repr(result)) <= MAX_REPR, name
        assert "\n" not in repr(result), name
        assert str(result) == repr(result), name
        assert name in repr(result)


def test_every_result_is_a_table_with_an_index_and_units(results: dict[str, Any]) -> None:
    for name, result in results.items():
        frame = result.to_frame()
        assert isinstance(frame, pd.DataFrame), name
        assert len(frame), name
        assert frame.index.is_unique, name
        assert all(frame.index.names), name
        assert frame.columns.is_unique, name


def test_every_result_is_a_dataset_of_xarray(results: dict[str, Any]) -> None:
    pytest.importorskip("xarray")
    for name, result in results.items():
        frame = result.to_frame()
        dataset = result.to_xarray()
        assert set(dataset.data_vars) == set(frame.columns), name
        assert list(dataset.sizes.values()) == [len(frame)], name


def test_without_xarray_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install .tcdyn\[xarray\]"):
        tcdyn.Chain(0.7).to_xarray()


def test_every_result_has_a_plot_with_and_without_axes(results: dict[str, Any]) -> None:
    from matplotlib.figure import Figure

    from tcdyn.plots.style import figure

    for name, result in results.items():
        drawing, (ax,) = figure()
        assert result.plot(ax) is drawing, name
        own = result.plot()
        assert isinstance(own, Figure), name
        assert own is not drawing, name
        for axes in (ax, own.axes[0]):
            assert axes.has_data(), name


def test_every_result_survives_pickling(results: dict[str, Any]) -> None:
    for name, result in results.items():
        again = pickle.loads(pickle.dumps(result))
        assert again.to_dict() == result.to_dict(), name
        pd.testing.assert_frame_equal(again.to_frame(), result.to_frame())


@pytest.mark.e2e
def test_notebook_view_of_each_result_contains_its_plot(results: dict[str, Any]) -> None:
    from tcdyn.report.page import card_html

    for name, result in results.items():
        assert card_html(result).count("<img") == 1, name


def test_every_exported_plot_function_exists() -> None:
    for name in tcdyn.plots.__all__:
        assert callable(getattr(tcdyn.plots, name)), name


def test_json_of_a_result_equals_its_file(
    campaign_results: dict[str, Any],
    quick_results: dict[str, Any],
    calibrations: dict[str, CalibrationRun],
    tmp_path: Path,
) -> None:
    path = write_record(calibrations["fast"].record, tmp_path / "fast.disk.json")
    written = json.loads(path.read_text(encoding="utf-8"))
    assert read_record(path).to_dict() == written
    record = json.loads(calibrations["fast"].record.to_json())
    assert campaign_results["CalibrationRun"].to_dict()["static"] == record["static"]
    assert (
        json.loads(quick_results["Identified"].to_json()) == quick_results["Identified"].to_dict()
    )
