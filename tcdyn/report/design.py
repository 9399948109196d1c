"""The page of a test design: what to do, and what each planned test would tell of the lags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from tcdyn.design import compare
from tcdyn.design.compare import Design
from tcdyn.plots.plunge import draw_design
from tcdyn.plots.style import figure
from tcdyn.report.page import Section, write_page

MEANS = (
    "The common lag is the mean over the channels of a disk: an error in it shifts every compensated trace alike, and "
    "with them h and β by the cooling fit. The differences are what is left of each channel: an error in them bends "
    "the gradient between junctions."
)


def write_design_report(path: str | Path, design: Design, assumptions: Sequence[str]) -> Path:
    """Write the page of ``design``; ``assumptions`` are the plan's own numbers."""
    picture, (ax,) = figure(height_in=3.8)
    draw_design(design, ax)
    return write_page(
        path,
        "Test design: what to do before the campaign",
        [
            Section(
                "What each test would tell",
                f"{MEANS}\n\n{compare.MEANING}",
                design_table(design),
                picture,
                "Expected standard uncertainties. Bars of the common lag: from the 10 to the 90 % point over entry "
                "bursts and scales of h, which nobody can plan.",
            )
        ],
        verdict=compare.headline(design.predictions, design.lag_s),
        assumptions=assumptions,
    )


def design_table(design: Design) -> pd.DataFrame:
    """One row a test: expected standard uncertainties, in seconds and percent of the lag, and how good that is."""
    lag = design.lag_s
    return pd.DataFrame(
        [
            {
                "test": p.name,
                "common lag, u [s]": f"{p.u_common_s:.3f}",
                "10 to 90 % of bursts [s]": f"{p.low_s:.3f} to {p.high_s:.3f}" if p.high_s > p.low_s else "",
                "u over lag [%]": f"{100 * p.u_common_s / lag:.2g}",
                "told": compare.common(p, lag),
                "differences, u [s]": f"{p.u_differential_s:.3f}",
                "u over lag [%] ": f"{100 * p.u_differential_s / lag:.2g}",
                "told ": compare.differences(p, lag),
            }
            for p in design.predictions
        ]
    )
