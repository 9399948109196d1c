"""Tables of a campaign for a paper, as data, CSV and LaTeX: beta with both uncertainties, h, lags.

``tcdyn.workflows.campaign`` writes the files, ``tcdyn.report.campaign_joint`` shows the rows.
Guarded by ``tests/campaign/test_posterior.py``.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from tcdyn.campaign.result import JoinedCampaign
from tcdyn.core.errors import printable
from tcdyn.core.estimate import rounded_texts
from tcdyn.io.write import table_csv
from tcdyn.rig.disk import DISKS

# Headings of the LaTeX table, by column.
LATEX_HEADINGS = {
    "test": "test",
    "load_N": r"load [N]",
    "sliding_speed_m_s": r"$u_s$ [m/s]",
    "delta_T_us_K_m_s": r"$\Delta T\,u_s$ [K m/s]",
    "beta": r"$\beta$",
    "u_beta_within": r"$u_\mathrm{within}$",
    "u_beta": r"$u(\beta)$",
    "h_fast_W_m2K": r"$h_f$ [W/m$^2$K]",
    "h_slow_W_m2K": r"$h_s$ [W/m$^2$K]",
    "exponent": r"$n$",
}

# Characters that LaTeX writes as a text symbol, and all that need escaping.
LATEX_SYMBOLS = {
    "\\": "backslash",
    "^": "asciicircum",
    "~": "asciitilde",
    "<": "less",
    ">": "greater",
}
TEX = {ord(c): rf"\{c}" for c in "&%$#_{}"} | {
    ord(c): rf"\text{name}{{}}" for c, name in LATEX_SYMBOLS.items()
}


def paper_table(joined: JoinedCampaign) -> pd.DataFrame:
    """Table of a campaign for a paper, one row a test.

    Conditions, beta with its standard uncertainty within the campaign and absolute, h, lags and n.

    Parameters
    ----------
    joined
        Result of the campaign.
    """
    rows = []
    p = joined.posterior
    law = joined.speed_law
    for i, (statistics, estimates) in enumerate(zip(p.tests, p.estimates)):
        row: dict[str, object] = {"test": statistics.name.removeprefix("EHL_")}
        row |= {
            k: statistics.conditions[k]
            for k in ("load_N", "friction_N", "sliding_speed_m_s", "entraining_speed_m_s")
        }
        heat = joined.delta_T_us[statistics.name]
        row |= {"delta_T_us_K_m_s": heat.value, "u_delta_T_us_K_m_s": heat.u}
        row |= {
            "beta": estimates["beta"].value,
            "u_beta_within": estimates["beta_within"].u,
            "u_beta": estimates["beta"].u,
        }
        law_beta = joined.speed_law_beta[statistics.name]
        row["beta_by_speed_law"] = np.nan if law_beta is None else law_beta
        for d in DISKS:
            row |= {
                f"h_{d}_W_m2K": estimates[f"h_{d}"].value,
                f"u_h_{d}_W_m2K": estimates[f"h_{d}"].u,
            }
            row |= {
                f"lag_{d}_s": estimates[f"lag_{d}_s"].value,
                f"u_lag_{d}_s": estimates[f"lag_{d}_s"].u,
            }
        row |= {
            "exponent": law.each[i],
            "u_exponent_within": law.u_within[i],
            "status": joined.status[statistics.name],
        }
        rows.append(row)
    return pd.DataFrame(rows)


def paper_csv(joined: JoinedCampaign) -> str:
    """The table ``paper_table`` as CSV text, numbers with eight digits."""
    return table_csv(paper_table(joined), "%.8g")


def paper_latex(joined: JoinedCampaign) -> str:
    """The table as LaTeX (booktabs).

    Each number is rounded by its uncertainty; beta by that within the campaign. The last row has n
    of all tests.

    Parameters
    ----------
    joined
        Result of the campaign.

    Notes
    -----
    The cells must be in the order of ``LATEX_HEADINGS``.
    """
    rows = []
    for r in paper_table(joined).to_dict("records"):
        beta, inside = rounded_texts(r["beta"], r["u_beta_within"])
        cells = [
            printable(str(r["test"])).translate(TEX),
            f"{r['load_N']:.0f}",
            f"{r['sliding_speed_m_s']:.1f}",
            rounded_texts(r["delta_T_us_K_m_s"], r["u_delta_T_us_K_m_s"])[0],
            beta,
            inside,
            rounded_texts(r["beta"], r["u_beta"])[1],
            *(_latex_with_u(r[f"h_{d}_W_m2K"], r[f"u_h_{d}_W_m2K"]) for d in DISKS),
            _latex_with_u(r["exponent"], r["u_exponent_within"]),
        ]
        rows.append(" & ".join(cells) + r" \\")
    n = joined.speed_law.exponent
    return "\n".join(
        [
            r"\begin{tabular}{l" + "r" * (len(LATEX_HEADINGS) - 1) + "}",
            r"\toprule",
            " & ".join(LATEX_HEADINGS.values()) + r" \\",
            r"\midrule",
            *rows,
            r"\midrule",
            rf"\multicolumn{{{len(LATEX_HEADINGS) - 1}}}{{l}}{{all tests}} & "
            rf"{_latex_with_u(n.value, n.u)} \\",
            r"\bottomrule",
            r"\end{tabular}",
            "",
        ]
    )


def _latex_with_u(value: float, u: float) -> str:
    """Value and standard uncertainty as LaTeX, rounded by the uncertainty."""
    text, spread = rounded_texts(value, u)
    return rf"${text} \pm {spread}$"


def trend_rows(joined: JoinedCampaign) -> pd.DataFrame:
    """Table of the trends, one row a slope.

    Over what, with what else, the slope with its interval, its p value, the scatter of the tests,
    and the p value of the line.

    Parameters
    ----------
    joined
        Result of the campaign.
    """
    rows = []
    for t in joined.trends:
        for name, slope, p in zip(t.against, t.slopes, t.p_value):
            rows.append(
                {
                    "over": name,
                    "with": ", ".join(x for x in t.against if x != name),
                    "slope": slope,
                    "p_value": p,
                    "scatter": t.scatter,
                    "p_value_of_line": t.line_p_value,
                }
            )
    return pd.DataFrame(
        rows, columns=["over", "with", "slope", "p_value", "scatter", "p_value_of_line"]
    )
