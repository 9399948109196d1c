"""Pictures of all tests as one measurement: beta with both uncertainties, the exponent, the junctions."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from calibration.estimate import Z95
from tcdyn.campaign import JoinedCampaign
from tcdyn.plots.campaign import name_points
from tcdyn.plots.style import DISK_COLOUR, GREY, PALE, SERIES_LINES, TRUTH, dressed
from tcdyn.plots.transient import draw_deeper

OVER = {
    "delta_T_us_K_m_s": "temperature difference of the surfaces times sliding speed, ΔT u_s [K m/s]",
    "load_N": "load [N]",
    "sliding_speed_m_s": "sliding speed [m/s]",
    "entraining_speed_m_s": "entraining speed [m/s]",
}


def draw_joined_beta(joined: JoinedCampaign, ax: Axes, against: str = "delta_T_us_K_m_s") -> Axes:
    """beta of every test, 95 % bars within the campaign (thick) and absolute (thin); trend with band; models."""
    p = joined.posterior
    x = np.array([t.conditions[against] for t in p.tests])
    y = p.beta[0]
    inside, whole = (np.array([e[k].u for e in p.estimates]) for k in ("beta_within", "beta"))
    ax.errorbar(x, y, yerr=Z95 * whole, fmt="none", ecolor=GREY, elinewidth=0.8, capsize=2, label="95 %, absolute")
    ax.errorbar(
        x, y, yerr=Z95 * inside, fmt="o", color=TRUTH, markersize=3, elinewidth=2.2, label="95 %, within the campaign"
    )
    trend = next((t for t in joined.trends if t.against == (against,)), None)
    if trend is not None:
        at = np.linspace(x.min(), x.max(), 50)
        line, u = trend.at(at)
        ax.fill_between(at, line - Z95 * u, line + Z95 * u, color=PALE, zorder=0)
        ax.plot(at, line, ":", color=TRUTH, linewidth=1, label="line, generalised least squares")
    for k, test in enumerate(c for c in joined.curves if c.curve.against == against):
        style = SERIES_LINES[k % len(SERIES_LINES)]
        ax.plot(test.curve.x, test.curve.beta, style, color=DISK_COLOUR["fast"], linewidth=1.2, label=test.curve.file)
    name_points(ax, x, [name.removeprefix("EHL_") for name in p.order])
    return dressed(ax, OVER[against], "heat partition β [1]", legend=True)


def draw_exponent(joined: JoinedCampaign, ax: Axes) -> Axes:
    """n of every test over the entraining speed, 95 % bars against each other, and n of all with its 95 % band."""
    law = joined.law
    x, n = np.array([t.conditions["entraining_speed_m_s"] for t in joined.posterior.tests]), law.exponent
    ax.axhspan(n.low95, n.high95, color=PALE, zorder=0, label="all tests, 95 %")
    ax.axhline(n.value, color=TRUTH, linestyle="--", linewidth=1)
    ax.errorbar(
        x, law.each, yerr=Z95 * law.u_within, fmt="o", color=TRUTH, markersize=3, capsize=2, linewidth=0.9,
        label="each test, against the others",
    )  # fmt: skip
    return dressed(ax, "entraining speed [m/s]", "exponent n of h ~ u^n [1]", loc="lower left")


def draw_junctions(joined: JoinedCampaign, ax: Axes) -> Axes:
    """How much deeper than stated all tests together place each junction, 95 % bars."""
    draw_deeper(joined.deeper_mm, ax, "{} disk")
    return dressed(ax, "junction", "deeper than stated [mm]", legend=True)
