"""Does a second unloading separate the lag of one junction (a bubble in its cement) from the common
lag?

`python -m tests.campaign.repeat_study` prints results for a junction with an unknown lag (prior 0.3
s instead of that of the plunges): u of its lag after one to four unloadings, its correlation with
the common lag, and u of beta, h and lag. The unloadings are under the same or under other
conditions.
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


def with_unknown_lag(
    statistics: SufficientStatistics, name: str, common_u_s: float
) -> SufficientStatistics:
    """The same test with a wide prior of the lag of one junction and ``common_u_s`` for the common
    lags."""
    column = statistics.names.index(name)
    # a record contains each lag relative to the mean of six
    factor = BUBBLE_S / (CHANNEL_LAG_U_S * float(np.sqrt(5 / 6)))
    rows = statistics.rows.copy()
    centre = statistics.centre.copy()
    rows[:, column] *= factor
    centre[column] /= factor
    return replace(
        statistics, rows=rows, centre=centre, lag_u_s=dict.fromkeys(statistics.lag_u_s, common_u_s)
    )


def table() -> pd.DataFrame:
    """One row for each junction, prior of the common lag and number of unloadings."""
    rig = load_rig()
    rows = []
    plans = {
        "repeated": plan_of(("D4",)) * 4,
        "other conditions": plan_of(("D4", "A4", "D2", "B3")),
    }
    for conditions, plan in plans.items():
        if conditions == "repeated":
            statistics = [planned_statistics(plan[0], rig, Logging())] * 4
        else:
            statistics = [planned_statistics(p, rig, Logging()) for p in plan]
        for name in ("lag e fast", "lag c fast", "lag b fast"):
            for u_s in (COMMON_LAG_U_S, 0.5):
                for count in (1, 2, 4):
                    tests = [
                        replace(with_unknown_lag(k, name, u_s), name=f"D4.{i}")
                        for i, k in enumerate(statistics[:count])
                    ]
                    campaign = solve_campaign(tests)
                    k = campaign.shared.index(name)
                    common = campaign.shared.index("common lag fast")
                    covariance = campaign.shared_covariance
                    first = campaign.estimates[0]
                    rows.append(
                        {
                            "unloadings": f"{count}, {conditions}",
                            "junction": name,
                            "prior u of common lag [s]": u_s,
                            "u of its lag [s]": BUBBLE_S * np.sqrt(covariance[k, k]),
                            "correlation": covariance[k, common]
                            / np.sqrt(covariance[k, k] * covariance[common, common]),
                            "u(lag) [s]": first["lag_fast_s"].u,
                            "u(beta)": first["beta"].u,
                            "u(h)/h": first["h_fast"].u / first["h_fast"].value,
                        }
                    )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    print(table().round(4).to_string(index=False))
