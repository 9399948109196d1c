"""Page and figures of many tests: labels do not overlap, lines need three points, wording of
results."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy import stats

from tcdyn.campaign import JoinedCampaign, join_results
from tcdyn.campaign.stored_results import merge_findings
from tcdyn.campaign.summary_table import (
    QUANTITIES,
    comparison_table,
    read_compared,
    table_columns,
)
from tcdyn.campaign.trends import Curve, CurveTest
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import info, warning
from tcdyn.plots import campaign as draw
from tcdyn.plots.campaign import draw_joined_beta
from tcdyn.plots.style import figure
from tcdyn.report.campaign import (
    campaign_pictures,
    campaign_verdict,
    comparison_section,
    partition_table,
    trend_lines,
    write_campaign_report,
)
from tcdyn.report.campaign_joint import beta_table, exponent_text, joined_sections, trend_sentence
from tcdyn.report.campaign_joint import trend_lines as joined_trend_lines
from tcdyn.report.page import table_html
from tcdyn.workflows.campaign import CampaignRun
from tests.campaign.toy import beta_json, toy

NAMES = [f"{family}{k}" for family in "ABCD" for k in range(1, 5)]


def programme_table(spread: float = 1.0) -> pd.DataFrame:
    """The test programme of the thesis: four loads at four speeds. ``close`` scales the spread of
    dT u_s."""
    rows = []
    for k, name in enumerate(NAMES):
        row: dict[str, Any] = dict.fromkeys(table_columns(), 0.1)
        load = (850.0, 1460.0, 1850.0, 2320.0)[k % 4]
        speed = (10.0, 13.0, 16.0, 20.0)[k // 4]
        row |= {
            "test": name,
            "error": "",
            "agree": "yes",
            "load_N": load,
            "sliding_speed_m_s": speed,
        }
        row |= {"delta_T_us_K_m_s": 400 + spread * load * speed / 40, "u_delta_T_us_K_m_s": 3.0}
        row |= {
            "beta": 0.75 - 1e-4 * load * speed / 40,
            "u_beta": 0.01,
            "friction_N": 0.01 * load + 0.1 * speed,
        }
        rows.append(row)
    return pd.DataFrame(rows, columns=table_columns())


def test_labels_of_tests_do_not_overlap() -> None:
    for spread in (1.0, 0.05):
        fig, (ax,) = figure(height_in=4.4)
        draw.draw_beta(programme_table(spread), ax)
        canvas = FigureCanvasAgg(fig)
        canvas.draw()
        boxes = [t.get_window_extent(canvas.get_renderer()) for t in ax.texts]
        assert sorted(t.get_text() for t in ax.texts) == sorted(NAMES)
        assert not [1 for first, second in combinations(boxes, 2) if first.overlaps(second)]
        assert all(box.y1 <= fig.bbox.y1 for box in boxes)


def test_trend_line_needs_three_tests() -> None:
    for count, lines in ((2, 0), (3, 1)):
        _, (ax,) = figure()
        table = programme_table().head(count)
        draw.draw_quantity(table, "friction_N", ax)
        trends = [
            line
            for line in ax.lines
            if len(line.get_xdata()) == 2 and line.get_linestyle() != "None"
        ]
        assert len(trends) == lines
        assert " ".join(trend_lines(table).get("quantity", ())).count("traction force") == lines


def test_groups_are_distinguishable_without_colour() -> None:
    _, (ax,) = figure()
    draw.draw_quantity(programme_table(), "friction_N", ax)
    handles = ax.get_legend().legend_handles
    styles = {(h.get_marker(), str(h.get_linestyle())) for h in handles}
    assert len(styles) == 4


def test_tables_use_words_and_units_instead_of_column_names() -> None:
    table = programme_table()
    page_text = " ".join(
        table_html(table_) for table_ in (trend_lines(table), partition_table(table))
    )
    assert "_" not in page_text.replace("ΔT u_s", "")
    assert "bulk temperature, fast disk [°C]" in page_text
    assert partition_table(table).shape[1] <= 8  # more do not fit a printed page


@pytest.fixture(scope="module")
def campaign_fit() -> JoinedCampaign:
    joined_campaign = join_results({t.name: beta_json(t) for t in toy(1).tests})
    assert joined_campaign is not None
    return joined_campaign


def test_slope_is_claimed_only_if_its_interval_excludes_zero(campaign_fit: JoinedCampaign) -> None:
    assert "β changes with ΔT u_s" in trend_sentence(campaign_fit)
    flat = replace(campaign_fit.trends[0], p_value=(0.2,))
    assert "do not show" in trend_sentence(replace(campaign_fit, trends=(flat,)))
    assert "needs three set points" in trend_sentence(replace(campaign_fit, trends=()))


def test_slope_over_heat_is_given_per_thousand_units_and_scatter_only_if_significant(
    campaign_fit: JoinedCampaign,
) -> None:
    """2.00(10)e-5 for one K m/s is 0.0200(10) for a thousand. u has two digits; the ends of the
    interval match."""
    slope = Estimate(value=2e-5, u=1e-6, low95=1.8e-5, high95=2.2e-5)
    line = replace(
        campaign_fit.trends[0], slopes=(slope,), p_value=(1e-13,), scatter=0.003, line_p_value=1e-4
    )
    with_line = replace(campaign_fit, trends=(line,))
    row = joined_trend_lines(with_line).iloc[0]
    assert row["slope"] == "0.0200 ± 0.0010 per 1000 K m/s"
    assert row["95 % interval"] == "0.0180 to 0.0220"
    assert row["chance if zero"] == "below 1e-12"
    text = trend_sentence(with_line)
    assert "the slope 0.0200 +- 0.0010 per 1000 K m/s (95 % interval 0.0180 to 0.0220)" in text
    assert "the tests scatter by 0.0030 more" in text
    insignificant = replace(with_line, trends=(replace(line, p_value=(0.03,), line_p_value=0.3),))
    assert joined_trend_lines(insignificant).iloc[0]["chance if zero"] == "0.03"
    assert "scatter" not in trend_sentence(insignificant)


def test_single_speed_exponent_is_questioned_only_for_a_significant_change(
    campaign_fit: JoinedCampaign,
) -> None:
    for p_value, text in ((0.2, "one power is enough"), (0.01, "one power may not be enough")):
        assert text in exponent_text(
            replace(campaign_fit, speed_law=replace(campaign_fit.speed_law, p_value=p_value))
        )


def test_free_level_of_a_model_curve_costs_one_degree_of_freedom(
    campaign_fit: JoinedCampaign,
) -> None:
    curve = Curve("m.csv", "load_N", np.array([800.0, 2400.0]), np.array([0.7, 0.7]), np.zeros(2))
    test = CurveTest(
        curve, ("A1", "A2", "A3"), 12.0, 0.007, 5.0, 0.08, Estimate.normal(0.01, 0.002)
    )
    text = joined_sections(replace(campaign_fit, curves=(test,)))[1].text
    assert (
        "chi-squared 12.0 on 3 tests (chance 0.007); with its level free 5.0 on 2 (chance 0.08)"
        in text
    )
    assert "does not fit" not in text


def test_page_states_that_a_curve_does_not_fit_and_the_scatter_added(
    campaign_fit: JoinedCampaign,
) -> None:
    curve = Curve("m.csv", "load_N", np.array([800.0, 2400.0]), np.array([0.7, 0.7]), np.zeros(2))
    test = CurveTest(
        curve, ("A1", "A2", "A3"), 52.0, 1e-10, 45.0, 1e-9, Estimate.normal(0.01, 0.002), 0.0131
    )
    text = joined_sections(replace(campaign_fit, curves=(test,)))[1].text
    assert "the tests lying 0.0100 \u00b1 0.0020 above it." in text.replace("\u00a0", " ").replace(
        "+-", "\u00b1"
    )
    assert "The shape of the curve does not fit the tests" in text
    assert "an independent scatter of 0.013 was added to every test" in text


def test_campaign_summary_counts_the_tests_whose_estimates_agree(tmp_path: Path) -> None:
    table = programme_table().head(3)
    text = campaign_verdict(CampaignRun(tmp_path, (), table))
    assert "The estimates of β agree in 3 of 3 tests." in text
    assert (
        text.index(str(table["test"].iloc[-1]))
        < text.index("largest in")
        < text.index(str(table["test"].iloc[0]))
    )
    table = table.assign(agree=["yes", "no", "yes"])
    assert "agree in 2 of 3 tests, not in A2." in campaign_verdict(CampaignRun(tmp_path, (), table))


def test_campaign_of_one_test_is_worded_in_the_singular(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tcdyn.report.campaign.campaign_pictures", lambda *_: [])
    for count, title in ((1, "Campaign of 1 test<"), (2, "Campaign of 2 tests<")):
        run = CampaignRun(
            tmp_path,
            (),
            programme_table().head(count),
            join_results({"EHL_A1": beta_json(toy(1).tests[0])}),
        )
        page = write_campaign_report(tmp_path / "p.html", run).read_text(encoding="utf-8")
        assert title in page
        assert ("running surfaces" in page.split("<h2>Conditions")[1].split("<h2>")[0]) == (
            count == 1
        )
        assert ("no sliding speed has tests" in page) == (count == 2)
        assert "All tests of a rig share its errors" not in page


def test_page_shows_both_uncertainties_the_exponent_trends_and_junctions(
    campaign_fit: JoinedCampaign,
) -> None:
    sections = joined_sections(campaign_fit)
    assert sum(s.figure is not None for s in sections) == 2
    table = beta_table(campaign_fit)
    assert {"u within [1]", "u absolute [1]"} <= set(table.columns)
    within, absolute = (table[c].astype(float) for c in ("u within [1]", "u absolute [1]"))
    assert (within < absolute).all()
    page_text = " ".join(
        f"{s.text} {table_html(s.table) if s.table is not None else ''}" for s in sections
    )
    assert "n = " in page_text
    assert "with sliding speed" in page_text
    assert "_" not in page_text.replace("ΔT u_s", "").replace("speed_exponent", "")
    axes = [ax for s in sections if s.figure is not None for ax in s.figure.axes]
    assert all(ax.get_xlabel() and ax.get_ylabel() for ax in axes)


def test_error_bars_within_the_campaign_lie_inside_the_absolute_ones(
    campaign_fit: JoinedCampaign,
) -> None:
    _, (ax,) = figure()
    trends = draw_joined_beta(campaign_fit, ax)
    bar_heights = [
        np.ptp([seg[:, 1] for seg in c.lines[2][0].get_segments()], axis=1)
        for c in trends.containers
    ]
    assert len(bar_heights) == 2
    assert (bar_heights[1] < bar_heights[0]).all()


def test_repeated_finding_is_printed_once() -> None:
    repeated = [
        (f"EHL_A{k}", info("from_file", subject="fast_a", text=f"{k} spikes")) for k in (1, 2, 3)
    ]
    single = ("EHL_A2", warning("from_file", subject="slow_b", text="odd"))
    sentences = [f.sentence for f in merge_findings([*repeated, single])]
    assert sentences == ["1 spikes (in A1; so or nearly so in A2, A3)", "EHL_A2: odd"]


def test_campaign_has_the_figures_of_the_thesis() -> None:
    sections = campaign_pictures(programme_table().head(4))
    # figures 7.18, 7.20, 6.17, 6.33, and 6.34
    assert [s.figure is not None for s in sections] == [True] * 5
    assert "running surfaces" in sections[0].text  # explains dT u_s


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("against", ["load_N", "sliding_speed_m_s"])
def test_lines_of_a_quantity_are_those_of_least_squares(quantity: str, against: str) -> None:
    table = programme_table()
    table[quantity] = 40.0 + np.random.default_rng(3).normal(size=len(table))
    by = "sliding_speed_m_s" if against == "load_N" else "load_N"
    _, (ax,) = figure()
    draw.draw_quantity(table, quantity, ax, against)
    fitted = [line for line in ax.lines if len(line.get_xdata()) == 2]
    assert len(fitted) == 4
    for line, (_, group) in zip(fitted, table.groupby(by)):
        slope, intercept = np.polyfit(group[against], group[quantity], 1)
        x = np.asarray(line.get_xdata(), dtype=float)
        assert line.get_ydata() == pytest.approx(intercept + slope * x, rel=1e-9)


def test_other_tests_are_compared_at_the_same_load(tmp_path: Path) -> None:
    """Figure 6.35, against ordinary least squares with a dummy variable and Student's t."""
    table = programme_table()
    load = np.array([900.0, 1400.0, 1900.0, 2400.0, 2500.0])
    noise = 0.3 * np.random.default_rng(7).normal(size=5)
    path = tmp_path / "clarke.csv"
    columns = {"load_N": load, "sliding_speed_m_s": 13.2, "friction_N": 2.0 + 0.01 * load + noise}
    pd.DataFrame(columns).to_csv(path, index=False)
    compared = read_compared(path)
    rows = comparison_table(table, compared).set_index("quantity")
    assert list(rows.index) == ["friction_N", "friction_coefficient"]
    assert rows["sliding_speed_m_s"].to_list() == [13.0, 13.0]
    own = table[table["sliding_speed_m_s"] == 13.0]
    x = np.concatenate([own["load_N"], load])
    y = np.concatenate([own["friction_N"], columns["friction_N"]]).astype(float)
    design = np.column_stack([np.ones(9), x, np.arange(9) >= 4]).astype(float)
    coefficients, squares, *_ = np.linalg.lstsq(design, y)
    u = np.sqrt(squares[0] / 6 * np.linalg.inv(design.T @ design)[2, 2])
    difference = rows.loc["friction_N", "difference"]
    assert difference.value == pytest.approx(coefficients[2], rel=1e-9)
    assert difference.u == pytest.approx(u, rel=1e-9)
    assert difference.high95 - difference.value == pytest.approx(stats.t.ppf(0.975, 6) * u)
    section = comparison_section(table, compared)
    assert section.title == "Comparison with clarke.csv"
    assert section.table is not None
    assert len(section.table) == 2
    assert all(s.figure is not None for s in campaign_pictures(table, compared))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("load_N,friction_N\n800,2\n", "sliding_speed_m_s is missing"),
        ("load_N,sliding_speed_m_s,beta\n800,10,0.7\n", "no quantity to compare"),
        ("load_N,sliding_speed_m_s,friction_N\n800,10,\n", "friction_N, row 2: no number"),
    ],
)
def test_unusable_tests_to_compare_with_are_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "other.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_compared(path)
