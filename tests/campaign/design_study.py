"""Designed against fitted u of beta, over drawn rigs and three layouts of the junctions.

`python -m tests.campaign.design_study COUNT FOLDER` draws COUNT rigs with four tests each for the
layout of Clarke and for a row nearer to the surface. For the layout of the thesis it uses the
campaigns of sixteen tests in FOLDER.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.campaign import solve_campaign
from tcdyn.campaign.planned import predict_campaign
from tcdyn.rig.rigfile import Rig, load_rig
from tests.campaign.rigs import DrawnCampaign, draw_campaign
from tests.campaign.test_planned import TOLERANCE_REL, layout, plan_of

CORNERS = ("A1", "A4", "D1", "D4")


def ratios(campaigns: Iterable[DrawnCampaign], rig: Rig) -> pd.DataFrame:
    """Designed over fitted u of each drawn rig, as the median of its tests."""
    rows = []
    designed = {}
    for campaign in campaigns:
        fitted = solve_campaign(campaign.tests)
        if fitted.test_names not in designed:
            designed[fitted.test_names] = predict_campaign(plan_of(fitted.test_names), rig).table()
        table = designed[fitted.test_names]
        u_alone = np.array([campaign.single_beta[n][1] for n in fitted.test_names])
        beta, within = (
            np.array([e[k].u for e in fitted.estimates]) for k in ("beta", "beta_within")
        )
        rows.append(
            {
                "alone": np.median(table.u_beta_alone / u_alone),
                "absolute": np.median(table.u_beta / beta),
                "within": np.median(table.u_beta_within / within),
                "inflation": fitted.inflation,
            }
        )
    return pd.DataFrame(rows)


def report(name: str, table: pd.DataFrame) -> None:
    """Number of rigs within the tolerance, and range of the ratio."""
    print(f"{name}: {len(table)} rigs")
    summary = table.describe().loc[["mean", "min", "max"]]
    summary.loc["within 20 %"] = [float(np.mean(abs(table[c] - 1) < TOLERANCE_REL)) for c in table]
    print(summary.round(3).to_string(), flush=True)


if __name__ == "__main__":
    count = int(sys.argv[1])
    report(
        "thesis",
        ratios(map(DrawnCampaign.read, sorted(Path(sys.argv[2]).glob("*.json"))), load_rig()),
    )
    for name in ("clarke", "nearer"):
        rig = layout(name)
        report(
            name,
            ratios(
                (draw_campaign(seed, CORNERS, rig=rig) for seed in range(5000, 5000 + count)), rig
            ),
        )
