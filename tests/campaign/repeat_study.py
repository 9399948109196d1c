"""Does a second unloading tell a bubble in one junction's cement from a lag common to all?

`python -m tests.campaign.repeat_study` prints, for a junction whose lag nobody knows (prior 0.3 s instead of what the
plunges tell), how well one to four unloadings tell it, its correlation with the disk's common lag, and u of beta, h and
lag beside it; for a disk that is rolled (unloadings under other conditions) and one that is unloaded again as before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from tcdyn.campaign import SufficientStatistics, solve_campaign
from tcdyn.campaign.planned import CHANNEL_LAG_U_S, COMMON_LAG_U_S, Logging, planned_statistics
from tcdyn.rig.rigfile import load_rig
from tests.campaign.test_planned import plan_of

BUBBLE_S = 0.3


def unknown_lag(kept: SufficientStatistics, name: str, common_u_s: float) -> SufficientStatistics:
    """The same test, the lag of one junction all but unknown, and the disks' common lags known to ``common_u_s``."""
    at = kept.names.index(name)
    factor = BUBBLE_S / (
        CHANNEL_LAG_U_S * float(np.sqrt(5 / 6))
    )  # a record tells each lag from the mean of six
    rows, centre = kept.rows.copy(), kept.centre.copy()
    rows[:, at] *= factor
    centre[at] /= factor
    return replace(kept, rows=rows, centre=centre, lag_u_s=dict.fromkeys(kept.lag_u_s, common_u_s))


def table() -> pd.DataFrame:
    """One row a junction, a prior of the common lag, and a number of unloadings."""
    rig, rows = load_rig(), []
    plans = {
        "repeated": plan_of(("D4",)) * 4,
        "other conditions": plan_of(("D4", "A4", "D2", "B3")),
    }
    for how, plan in plans.items():
        kept = [
            planned_statistics(p, rig, Logging()) for p in (plan if how != "repeated" else plan[:1])
        ]
        kept = kept * 4 if how == "repeated" else kept
        for name in ("lag e fast", "lag c fast", "lag b fast"):
            for u_s in (COMMON_LAG_U_S, 0.5):
                for count in (1, 2, 4):
                    tests = [
                        replace(unknown_lag(k, name, u_s), name=f"D4.{i}")
                        for i, k in enumerate(kept[:count])
                    ]
                    found = solve_campaign(tests)
                    k, common = (found.shared.index(n) for n in (name, "common lag fast"))
                    c = found.shared_covariance
                    one = found.estimates[0]
                    rows.append(
                        {
                            "unloadings": f"{count}, {how}",
                            "junction": name,
                            "u of common lag known before [s]": u_s,
                            "u of its lag [s]": BUBBLE_S * np.sqrt(c[k, k]),
                            "correlation": c[k, common] / np.sqrt(c[k, k] * c[common, common]),
                            "u(lag) [s]": one["lag_fast_s"].u,
                            "u(beta)": one["beta"].u,
                            "u(h)/h": one["h_fast"].u / one["h_fast"].value,
                        }
                    )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    print(table().round(4).to_string(index=False))
