"""Section 8.3's question in numbers: junctions closer together round the disk, or disk and shaft in one piece?

`python -m tests.campaign.layout_study` prints the designed uncertainties of four tests at the corners of the thesis's
programme for several places of the junctions; of one test alone, where a pattern round the bore costs most, and of all.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.campaign import SufficientStatistics, solve_campaign
from tcdyn.campaign.exponent import speed_law
from tcdyn.campaign.planned import Logging, planned_statistics
from tcdyn.campaign.sufficient_statistics import Loading
from tcdyn.rig.rigfile import parse_rig
from tests.campaign.test_planned import plan_of

CORNERS = ("A1", "A4", "D1", "D4")
ROWS = {
    "a": (3.0, 4.765),
    "c": (3.0, 2.0),
    "e": (1.25, 4.765),
    "d": (6.0, 2.0),
    "b": (6.0, 4.765),
    "f": (6.0, 7.53),
}


def placed(angles: dict[str, float], **depths: float) -> dict[str, Any]:
    """The thesis's junctions at other angles [deg], and other depths [mm] of some."""
    return {
        c: {
            "depth_mm": depths.get(c, depth),
            "z_mm": z,
            **({"angle_deg": angles[c]} if angles else {}),
        }
        for c, (depth, z) in ROWS.items()
    }


LAYOUTS: dict[str, dict[str, Any]] = {
    "the thesis's (table 6.2: a, e, f against b, c, d)": {"layout": "table 6.2"},
    "Voller's (table 6.3: a, c, d against b, e, f)": {"layout": "voller"},
    "one group, 15 degrees apart": placed({c: 15.0 * k for k, c in enumerate("daebcf")}),
    "one group, 8 degrees apart": placed({c: 8.0 * k for k, c in enumerate("daebcf")}),
    "thesis, e at 1.0 mm and a, c at 2.0 mm": placed({}, e=1.0, a=2.0, c=2.0),
    "thesis, a and c at 4.0 mm": placed({}, a=4.0, c=4.0),
}


def in_one_piece(kept: SufficientStatistics) -> SufficientStatistics:
    """The same test on a disk that is one with its shaft: nothing stands round the bore."""
    loading = {n: Loading({}, 0.0) for n in kept.names if n.startswith("uneven")}
    return replace(kept, loading={**kept.loading, **loading})


def row_of(name: str, kept: list[SufficientStatistics]) -> dict[str, Any]:
    """Mean u over the tests."""
    found = solve_campaign(kept)
    alone = [solve_campaign([k]).estimates[0] for k in kept]
    return {
        "junctions": name,
        "u(beta) alone": np.mean([e["beta"].u for e in alone]),
        "u(beta) of four": np.mean([e["beta"].u for e in found.estimates]),
        "within": np.mean([e["beta_within"].u for e in found.estimates]),
        "u(h_s)/h_s alone": np.mean([e["h_slow"].u / e["h_slow"].value for e in alone]),
        "u(n) of four": speed_law(found).exponent.u,
    }


def table() -> pd.DataFrame:
    """All layouts, each on a shaft and, the thesis's, in one piece with it."""
    rows = []
    for name, junctions in LAYOUTS.items():
        rig = parse_rig({"thermocouples": junctions}, "rig.toml")
        kept = [planned_statistics(p, rig, Logging()) for p in plan_of(CORNERS)]
        rows.append(row_of(name, kept))
        if len(rows) == 1:
            rows.append(
                row_of("the thesis's, disk and shaft in one piece", [in_one_piece(k) for k in kept])
            )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    print(table().round(5).to_string(index=False))
