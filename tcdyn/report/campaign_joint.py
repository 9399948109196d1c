"""Sections of a campaign's report on the joint posterior of all its tests.

Used by :mod:`tcdyn.report.campaign` for two tests or more. ``SIGNIFICANCE`` and ``SCATTER_P``
choose between sentences and change no number. Tests: ``tests/report/test_campaign_page.py``.
"""

from __future__ import annotations

from functools import partial

import pandas as pd

from tcdyn.campaign import JoinedCampaign
from tcdyn.campaign.tables import paper_table, trend_rows
from tcdyn.campaign.trends import CurveTest
from tcdyn.core.estimate import rounded_texts
from tcdyn.plots import campaign as draw
from tcdyn.plots.style import panel_figure
from tcdyn.report.page import MainResult, Section, cells_with_u, typeset
from tcdyn.rig.disk import DISKS

# Text below the first table.
JOINT_TEXT = (
    "All tests of a rig share its errors of depth, steel, washer, friction gain and static lines. "
    "Two uncertainties follow: within the campaign, for a difference between two tests (their u "
    "add in squares) and for trends; and absolute, for a comparison with anything else. β is that "
    "of the joint fit of both disks, all tests in one posterior; each test alone determines it "
    "less well."
)
CONDITIONS = {  # label, unit of a slope, that unit in the unit of the column
    "delta_T_us_K_m_s": ("ΔT u_s", "1000 K m/s", 1e3),
    "load_N": ("load", "1000 N", 1e3),
    "sliding_speed_m_s": ("sliding speed", "m/s", 1.0),
    "entraining_speed_m_s": ("entraining speed", "m/s", 1.0),
}
# Words for the groups of nuisance parameters.
NUISANCE_LABELS = {
    "film": "the shape of h along the track",
    "washer": "the washers' conductance",
    "depth": "the junctions' depths",
    "model": "the model error of rim and mesh",
    "uneven": "the circumferential harmonic",
    "line": "the static lines",
    "lag": "the lags",
    "heat": "the heat capacity",
    "half-width": "the contact's half-width",
    "split": "how each chain's lag is split",
}
N_LIMITS = 3  # nuisance parameters that the text on the exponent names
SIGNIFICANCE = 0.05  # p-value below which a dependence is stated; the usual level
SCATTER_P = 1e-3  # p-value below which a scatter about the line is stated; chosen by judgement
MIN_P = 1e-12  # p-values below this are written as "below 1e-12"; chosen by judgement
# Caption of the figures of exponent and junctions.
N_CAPTION = (
    "a: bars of the tests against each other, band of all together; it may lie outside the "
    "points, since common errors shift some tests more than others, and the differences determine "
    "them. b: 95 % bars."
)


def joined_sections(joined: JoinedCampaign) -> list[Section]:
    """Return beta with both uncertainties, trend, models, exponent and junctions."""
    beta_figure = panel_figure(partial(draw.draw_joined_beta, joined), height_in=4.4)
    sections = [
        Section("β of each test, all tests as one measurement", JOINT_TEXT, beta_table(joined)),
        Section(
            "Does β depend on ΔT u_s?",
            f"{trend_sentence(joined)}\n\n{_model_paragraphs(joined)}",
            figure=beta_figure,
            caption="Compare figure 7.18. Thick bars and band: within the campaign; thin bars: "
            "absolute; all 95 %.",
        ),
    ]
    if joined.trends:
        text = (
            "Generalised least squares with the covariance of all tests. Scatter: of the tests "
            "about the line, beyond their uncertainties; where it is not zero, the line alone does "
            "not determine β."
        )
        sections.append(Section("Trends of β", text, trend_lines(joined)))
    exponent = partial(draw.draw_exponent, joined)
    junctions = partial(draw.draw_junctions, joined)
    sections.append(
        Section(
            "Exponent of the speed law, and the junctions",
            exponent_text(joined),
            figure=panel_figure(exponent, junctions, height_in=3.6),
            caption=N_CAPTION,
        )
    )
    return sections


def joined_result(joined: JoinedCampaign) -> MainResult:
    """Return the range of beta over the tests with both uncertainties, and the exponent n."""
    posterior = joined.posterior
    ranked = sorted(
        zip(posterior.estimates, posterior.test_names), key=lambda test: test[0]["beta"].value
    )
    lowest, lowest_name = ranked[0]
    highest, highest_name = ranked[-1]
    u_within = max(estimates["beta_within"].u for estimates in posterior.estimates)
    u_absolute = max(estimates["beta"].u for estimates in posterior.estimates)
    low, high = (
        rounded_texts(test["beta"].value, test["beta_within"].u)[0] for test in (lowest, highest)
    )
    names = f"{lowest_name.removeprefix('EHL_')} and {highest_name.removeprefix('EHL_')}"
    return MainResult(
        f"β = {low} to {high}",
        f"{names} of {len(posterior.tests)} tests; u {u_within:.4f} at most within the campaign, "
        f"{u_absolute:.4f} absolute; exponent of the speed law {joined.speed_law.text}",
    )


def beta_table(joined: JoinedCampaign) -> pd.DataFrame:
    """Return beta, both uncertainties, h, lags, and beta by the speed law with the campaign's n."""
    rows = []
    for r in paper_table(joined).to_dict("records"):
        beta, u_within = rounded_texts(r["beta"], r["u_beta_within"])
        _, u_absolute = rounded_texts(r["beta"], r["u_beta"])
        row = {
            "test": r["test"],
            "β [1]": beta,
            "u within [1]": u_within,
            "u absolute [1]": u_absolute,
        }
        for disk in DISKS:
            row[f"h {disk} [W/m²K]"] = cells_with_u(
                [r[f"h_{disk}_W_m2K"]], [r[f"u_h_{disk}_W_m2K"]]
            )[0]
        for disk in DISKS:
            row[f"lag {disk} [s]"] = cells_with_u([r[f"lag_{disk}_s"]], [r[f"u_lag_{disk}_s"]])[0]
        row["β by the speed law at this n [1]"] = f"{r['beta_by_speed_law']:.4f}"
        rows.append(row)
    return pd.DataFrame(rows)


def trend_sentence(joined: JoinedCampaign) -> str:
    """Return whether beta changes with delta T u_s (full covariance), or what is missing."""
    trend = joined.trend
    if trend is None or trend.against != ("delta_T_us_K_m_s",):
        return "A line over ΔT u_s needs three set points."
    label, unit, scale = CONDITIONS[trend.against[0]]
    slope = trend.slopes[0].scaled(scale)
    if trend.p_value[0] < SIGNIFICANCE:
        conclusion = f"β changes with {label}"
    else:
        conclusion = f"these tests do not show that β depends on {label}"
    text = (
        f"The line over {len(joined.posterior.tests)} tests has the slope "
        f"{slope.text_without_interval()} per {unit} (95 % interval {slope.interval_text}): "
        f"{conclusion}."
    )
    if trend.line_p_value < SCATTER_P:
        text += (
            f" About the line the tests scatter by {trend.scatter:.4f} more than their "
            f"uncertainties: {label} is not the only cause."
        )
    return text


def trend_lines(joined: JoinedCampaign) -> pd.DataFrame:
    """Return the slopes of beta with full names and units."""
    rows = []
    for r in trend_rows(joined).to_dict("records"):
        label, unit, scale = CONDITIONS[r["over"]]
        slope = r["slope"].scaled(scale)
        conditions = [CONDITIONS[name][0] for name in str(r["with"]).split(", ") if name]
        if conditions:
            label += f" (with {', '.join(conditions)})"
        p = f"{r['p_value']:.2g}" if r["p_value"] > MIN_P else f"below {MIN_P:g}"
        rows.append(
            {
                "β over": label,
                "slope": f"{typeset(slope.text_without_interval())} per {unit}",
                "95 % interval": slope.interval_text,
                "chance if zero": p,
                "scatter [1]": f"{r['scatter']:.4f}",
            }
        )
    return pd.DataFrame(rows)


def exponent_text(joined: JoinedCampaign) -> str:
    """Return n of all tests, whether one power is enough, and what limits n."""
    law = joined.speed_law
    tests = joined.posterior.tests
    nominal = tests[0].conditions["speed_exponent"]
    text = f"{law.text} from {len(tests)} tests; rig.toml assumes {nominal:g}."
    if law.is_determined and law.by_speed is not None and law.p_value is not None:
        one_power = law.p_value > SIGNIFICANCE
        conclusion = "one power is enough" if one_power else "one power may not be enough"
        change = law.by_speed.text_without_interval()
        text += (
            f" While the speed doubles n changes by {change} (chance {law.p_value:.2g} if it did "
            f"not): {conclusion}."
        )
    limits = []
    for name, u in list(law.u_if_known.items())[:N_LIMITS]:
        limits.append(f"{u:.3f} if {NUISANCE_LABELS.get(name, f'the {name}')}")
    if limits:
        text += f" What limits it most: its u would be {', '.join(limits)} were known exactly."
    return text


def _model_paragraphs(joined: JoinedCampaign) -> str:
    """Return a paragraph on each compared model."""
    return "\n\n".join(_model_paragraph(test) for test in joined.curves)


def _model_paragraph(test: CurveTest) -> str:
    """Return how well a model's curve fits the tests."""
    n_tests = len(test.inside)
    text = (
        f"{test.curve.file}: chi-squared {test.chi2:.1f} on {n_tests} tests (chance "
        f"{test.p_value:.2g}); with its level free {test.shape_chi2:.1f} on {n_tests - 1} (chance "
        f"{test.shape_p_value:.2g}), the tests lying {test.offset.text_without_interval()} "
        "above it."
    )
    if test.shape_rejected:
        text += (
            " The shape of the curve does not fit the tests: for this offset an independent "
            f"scatter of {test.scatter:.2g} was added to every test."
        )
    return text
