"""Uncertainties of differences, n and trends in a campaign, over rigs drawn from the specified
uncertainties.

`python -m tests.campaign.campaign_study draw FOLDER 30` draws and fits campaigns (one or two
minutes a rig, stored in FOLDER; a second run continues). `python -m tests.campaign.campaign_study
FOLDER` prints the figures of the stored campaigns.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.campaign import solve_campaign
from tcdyn.campaign.exponent import speed_law
from tcdyn.campaign.outliers import outlying_tests
from tcdyn.campaign.result import POWER_LAW_REJECTED_P, junction_depths
from tcdyn.campaign.trends import trend
from tcdyn.core.estimate import Z95
from tests.campaign.rigs import EXPONENT, PER_M_S, PER_N, DrawnCampaign, draw_campaign


def draw(folder: Path, count: int, first: int = 3000) -> None:
    """Write ``count`` drawn campaigns into ``folder`` unless they exist."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(first, first + count):
        path = folder / f"{seed}.json"
        if not path.exists():
            path.write_text(json.dumps(draw_campaign(seed).to_dict()), encoding="utf-8")


def study_errors(campaign: DrawnCampaign) -> dict[str, float]:
    """Errors of one drawn campaign in its standard uncertainties."""
    posterior = solve_campaign(campaign.tests)
    true_beta = np.array([campaign.truth[n]["beta"] for n in posterior.test_names])
    error = posterior.beta[0] - true_beta
    single_test_error = (
        np.array([campaign.single_beta[n][0] for n in posterior.test_names]) - true_beta
    )
    pairs = np.triu_indices(len(error), 1)
    differences = error[:, None] - error[None, :]
    variance = (
        np.diag(posterior.beta[1])[:, None]
        + np.diag(posterior.beta[1])[None, :]
        - 2 * posterior.beta[1]
    )
    z = (differences / np.sqrt(np.where(variance > 0, variance, 1.0)))[pairs]
    law = speed_law(posterior)
    trend_fit = trend(posterior, "load_N", "sliding_speed_m_s")
    assert trend_fit is not None
    outliers = outlying_tests(posterior)
    outliers_low_friction = outlying_tests(
        solve_campaign([campaign.low if k.name == campaign.low.name else k for k in campaign.tests])
    )
    within = np.array([e["beta_within"].u for e in posterior.estimates])
    u = np.sqrt(np.diag(posterior.beta[1]))
    return {
        "rms of differences, campaign": float(np.std(error)),
        "rms of differences, alone": float(np.std(single_test_error)),
        "u within, mean": float(within.mean()),
        "u within, largest": float(within.max()),
        "differences covered by 95 %": float(np.mean(np.abs(z) < Z95)),
        "level error": float(error.mean()),
        "level error, alone": float(single_test_error.mean()),
        "u absolute": float(u.mean()),
        "absolute covered by 95 %": float(np.mean(np.abs(error / u) < Z95)),
        "n error": law.exponent.value - EXPONENT,
        "u of n": law.exponent.u,
        "n covered by 95 %": float(law.exponent.low95 <= EXPONENT <= law.exponent.high95),
        "slope over load, z": (trend_fit.slopes[0].value - PER_N) / trend_fit.slopes[0].u,
        "slope over load, u / slope": trend_fit.slopes[0].u / abs(PER_N),
        "slope over speed, z": (trend_fit.slopes[1].value - PER_M_S) / trend_fit.slopes[1].u,
        "slope over speed, u / slope": trend_fit.slopes[1].u / abs(PER_M_S),
        "largest pull of a junction": max(
            abs(z) for pulls in junction_depths(posterior)[1].values() for z in pulls.values()
        ),
        "power law rejected": float((law.p_value or 1.0) < POWER_LAW_REJECTED_P),
        "campaigns without a fault with an outlier": float(bool(outliers)),
        "low friction identified": float(
            [(s.name, s.cause) for s in outliers_low_friction] == [(campaign.low.name, "friction")]
        ),
    }


def report(folder: Path) -> pd.DataFrame:
    """Mean, rms, least and largest over the drawn campaigns in ``folder``."""
    table = pd.DataFrame(
        [study_errors(DrawnCampaign.read(path)) for path in sorted(folder.glob("*.json"))]
    )
    rms = np.sqrt((table**2).mean())
    return pd.DataFrame(
        {"mean": table.mean(), "rms": rms, "least": table.min(), "largest": table.max()}
    )


if __name__ == "__main__":
    if sys.argv[1] == "draw":
        draw(Path(sys.argv[2]), int(sys.argv[3]), *(int(x) for x in sys.argv[4:5]))
    else:
        print(len(list(Path(sys.argv[1]).glob("*.json"))), "campaigns of 16 tests")
        print(report(Path(sys.argv[1])).round(5).to_string())
