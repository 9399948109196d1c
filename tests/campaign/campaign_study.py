"""How well a campaign knows differences, n and trends, over rigs drawn from the stated uncertainties.

`python -m tests.campaign.campaign_study draw FOLDER 30` draws and fits (a minute or two a rig, kept in FOLDER; run it
again to go on); `python -m tests.campaign.campaign_study FOLDER` prints what the kept campaigns show.
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
from tests.campaign.rigs import EXPONENT, PER_M_S, PER_N, DrawnCampaign, drawn


def draw(folder: Path, count: int, first: int = 3000) -> None:
    """Write ``count`` drawn campaigns into ``folder``, those that are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(first, first + count):
        path = folder / f"{seed}.json"
        if not path.exists():
            path.write_text(json.dumps(drawn(seed).to_dict()), encoding="utf-8")


def told(made: DrawnCampaign) -> dict[str, float]:
    """Errors of one drawn campaign, in the uncertainties that it states."""
    p = solve_campaign(made.kept)
    true = np.array([made.truth[n]["beta"] for n in p.test_names])
    off = p.beta[0] - true
    alone = np.array([made.single_beta[n][0] for n in p.test_names]) - true
    pairs = np.triu_indices(len(off), 1)
    between = off[:, None] - off[None, :]
    variance = np.diag(p.beta[1])[:, None] + np.diag(p.beta[1])[None, :] - 2 * p.beta[1]
    z = (between / np.sqrt(np.where(variance > 0, variance, 1.0)))[pairs]
    law, both = speed_law(p), trend(p, "load_N", "sliding_speed_m_s")
    assert both is not None
    sound, low = (
        outlying_tests(p),
        outlying_tests(
            solve_campaign([made.low if k.name == made.low.name else k for k in made.kept])
        ),
    )
    within = np.array([e["beta_within"].u for e in p.estimates])
    u = np.sqrt(np.diag(p.beta[1]))
    return {
        "rms of differences, campaign": float(np.std(off)),
        "rms of differences, alone": float(np.std(alone)),
        "u within, mean": float(within.mean()),
        "u within, largest": float(within.max()),
        "differences covered by 95 %": float(np.mean(np.abs(z) < Z95)),
        "level error": float(off.mean()),
        "level error, alone": float(alone.mean()),
        "u absolute": float(u.mean()),
        "absolute covered by 95 %": float(np.mean(np.abs(off / u) < Z95)),
        "n error": law.exponent.value - EXPONENT,
        "u of n": law.exponent.u,
        "n covered by 95 %": float(law.exponent.low95 <= EXPONENT <= law.exponent.high95),
        "slope over load, z": (both.slopes[0].value - PER_N) / both.slopes[0].u,
        "slope over load, u / slope": both.slopes[0].u / abs(PER_N),
        "slope over speed, z": (both.slopes[1].value - PER_M_S) / both.slopes[1].u,
        "slope over speed, u / slope": both.slopes[1].u / abs(PER_M_S),
        "largest pull of a junction": max(
            abs(z) for own in junction_depths(p)[1].values() for z in own.values()
        ),
        "power law doubted": float((law.p_value or 1.0) < POWER_LAW_REJECTED_P),
        "sound campaigns that name a test": float(bool(sound)),
        "low friction named": float(
            [(s.name, s.cause) for s in low] == [(made.low.name, "friction")]
        ),
    }


def report(folder: Path) -> pd.DataFrame:
    """Mean, rms, least and largest over the drawn campaigns in ``folder``."""
    table = pd.DataFrame([told(DrawnCampaign.read(path)) for path in sorted(folder.glob("*.json"))])
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
