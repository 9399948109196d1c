"""The sections of a campaign's page that tell of all tests as one measurement."""

from __future__ import annotations

from functools import partial

import pandas as pd

from tcdyn.campaign import JoinedCampaign
from tcdyn.campaign.tables import paper_table, trend_rows
from tcdyn.campaign.trends import CurveTest
from tcdyn.core.estimate import rounded
from tcdyn.plots import campaign as draw
from tcdyn.plots.style import pictured
from tcdyn.report.page import Answer, Section, pm, typeset

BOTH = (
    "All tests of a rig share its errors of depth, steel, washer, friction gain and static lines. Two uncertainties "
    "follow: within the campaign, for a difference between two tests (their u add in squares) and for trends; and "
    "absolute, for a comparison with anything else. β is that of the joint fit of both disks, all tests in one "
    "posterior, each of them in turn less sure alone."
)
WORDS = {
    "delta_T_us_K_m_s": ("ΔT u_s", "1000 K m/s", 1e3),
    "load_N": ("load", "1000 N", 1e3),
    "sliding_speed_m_s": ("sliding speed", "m/s", 1.0),
    "entraining_speed_m_s": ("entraining speed", "m/s", 1.0),
}
KNOWN = {
    "film": "the film's shape along the track",
    "washer": "the washers' conductance",
    "depth": "the junctions' depths",
    "model": "what rim and mesh leave unexplained",
    "uneven": "the pattern round the bore",
    "line": "the static lines",
    "lag": "the lags",
    "heat": "the heat capacity",
    "half-width": "the contact's half-width",
    "split": "how each chain's lag is split",
}
LIMITS = 3
SURE = 0.05
COMMON = 1e-3
LEAST = 1e-12
N_CAPTION = (
    "Left: bars of the tests against each other, band of all together; it may lie beside the points, since errors that "
    "all share move some tests more than others, and their differences tell them. Right: 95 % bars."
)


def joined_sections(joined: JoinedCampaign) -> list[Section]:
    """Table of beta with both uncertainties, trend, exponent, models and junctions, of two tests or more."""
    shown = pictured(partial(draw.draw_joined_beta, joined), height_in=4.4)
    caption = "Compare figure 7.18. Thick bars and band: within the campaign; thin bars: absolute; all 95 %."
    sections = [
        Section("β of each test, all tests as one measurement", BOTH, beta_table(joined)),
        Section(
            "Does β depend on ΔT u_s?",
            f"{trend_sentence(joined)}\n\n{_models(joined)}",
            figure=shown,
            caption=caption,
        ),
    ]
    if joined.trends:
        told = (
            "Generalised least squares with the covariance of all tests. Scatter: of the tests about the line, beyond "
            "their uncertainties; where it is not zero, the line alone does not tell β."
        )
        sections.append(Section("Trends of β", told, trend_words(joined)))
    both = pictured(
        partial(draw.draw_exponent, joined), partial(draw.draw_junctions, joined), height_in=3.6
    )
    last = Section(
        "Exponent of the speed law, and the junctions",
        exponent_words(joined),
        figure=both,
        caption=N_CAPTION,
    )
    return [*sections, last]


def joined_answer(joined: JoinedCampaign) -> Answer:
    """Range of beta over the tests with both uncertainties, and n."""
    p = joined.posterior
    order = sorted(zip(p.estimates, p.order), key=lambda one: one[0]["beta"].value)
    (low, first) = order[0]
    (high, last) = order[-1]
    inside, whole = (max(e[k].u for e in p.estimates) for k in ("beta_within", "beta"))
    ends = [rounded(e["beta"].value, e["beta_within"].u)[0] for e in (low, high)]
    n = joined.law.exponent
    return Answer(
        f"β = {ends[0]} to {ends[1]}",
        f"{first.removeprefix('EHL_')} and {last.removeprefix('EHL_')} of {len(p.tests)} tests; u {inside:.4f} at most "
        f"within the campaign, {whole:.4f} absolute; exponent of the speed law n = {n.plain()}",
    )


def beta_table(joined: JoinedCampaign) -> pd.DataFrame:
    """beta, u within the campaign, u absolute, h, lags, and beta by the speed law with the campaign's n."""
    rows = []
    for r in paper_table(joined).to_dict("records"):
        beta, inside = rounded(r["beta"], r["u_beta_within"])
        rows.append(
            {
                "test": r["test"],
                "β [1]": beta,
                "u within [1]": inside,
                "u absolute [1]": rounded(r["beta"], r["u_beta"])[1],
                **{
                    f"h {d} [W/m²K]": pm([r[f"h_{d}_W_m2K"]], [r[f"u_h_{d}_W_m2K"]])[0]
                    for d in ("fast", "slow")
                },
                **{
                    f"lag {d} [s]": pm([r[f"lag_{d}_s"]], [r[f"u_lag_{d}_s"]])[0]
                    for d in ("fast", "slow")
                },
                "β by the speed law at this n [1]": f"{r['beta_by_speed_law']:.4f}",
            }
        )
    return pd.DataFrame(rows)


def trend_sentence(joined: JoinedCampaign) -> str:
    """Whether beta changes with delta T u_s, with the full covariance; what is missing where that is not told."""
    t = joined.trend
    if t is None or t.against != ("delta_T_us_K_m_s",):
        return "A line over ΔT u_s asks for three set points."
    word, unit, size = WORDS[t.against[0]]
    slope = t.slopes[0].times(size)
    verdict = (
        f"β changes with {word}"
        if t.p_value[0] < SURE
        else f"these tests do not show that β depends on {word}"
    )
    about = (
        f" About the line the tests scatter by {t.scatter:.4f} more than they are uncertain: {word} is not all."
        if t.enough < COMMON
        else ""
    )
    return (
        f"The line over {len(joined.posterior.tests)} tests has the slope {slope.plain()} per "
        f"{unit} (95 % interval {slope.interval}): {verdict}.{about}"
    )


def trend_words(joined: JoinedCampaign) -> pd.DataFrame:
    """Slopes with names and units that people read."""
    rows = []
    for r in trend_rows(joined).to_dict("records"):
        word, unit, size = WORDS[r["over"]]
        slope = r["slope"].times(size)
        beside = ", ".join(WORDS[x][0] for x in str(r["with"]).split(", ") if x)
        rows.append(
            {
                "β over": word + (f" (beside {beside})" if beside else ""),
                "slope": f"{typeset(slope.plain())} per {unit}",
                "95 % interval": slope.interval,
                "chance if zero": f"{r['p_value']:.2g}"
                if r["p_value"] > LEAST
                else f"below {LEAST:g}",
                "scatter [1]": f"{r['scatter']:.4f}",
            }
        )
    return pd.DataFrame(rows)


def exponent_words(joined: JoinedCampaign) -> str:
    """n of all tests, whether one power is enough, and what it was taken for."""
    law = joined.law
    tests = len(joined.posterior.tests)
    assumed = joined.posterior.tests[0].conditions["speed_exponent"]
    said = f"n = {law.exponent.plain()} from {tests} tests; rig.toml assumes {assumed:g}."
    if law.by_speed is not None and law.p_value is not None:
        enough = "one power is enough" if law.p_value > SURE else "one power may not be enough"
        change = law.by_speed.plain()
        said += f" While the speed doubles n changes by {change} (chance {law.p_value:.2g} if it did not): {enough}."
    known = [
        f"{u:.3f} if {KNOWN.get(k, f'the {k}')}" for k, u in list(law.u_if_known.items())[:LIMITS]
    ]
    return (
        f"{said} What limits it most: its u would be {', '.join(known)} were known exactly."
        if known
        else said
    )


def _models(joined: JoinedCampaign) -> str:
    return "\n\n".join(_model(c) for c in joined.curves)


def _model(c: CurveTest) -> str:
    sentence = (
        f"{c.curve.file}: chi-squared {c.chi2:.1f} on {len(c.inside)} tests (chance {c.p_value:.2g}); with its level "
        f"free {c.shape_chi2:.1f} on {len(c.inside) - 1} (chance {c.shape_p_value:.2g}), the tests lying "
        f"{c.offset.plain()} above it."
    )
    if not c.shape_rejected:
        return sentence
    return (
        f"{sentence} The shape of the curve does not fit the tests: for this offset an independent scatter of "
        f"{c.scatter:.2g} was added to every test."
    )
