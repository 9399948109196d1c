"""Effect of the layout of the junctions (section 8.3), and of a disk in one piece with its shaft.

`python -m tests.campaign.layout_study` prints the designed uncertainties of four tests at the
corners of the programme of the thesis for several layouts: of a single test, where a
circumferential pattern matters most, and of all tests.
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
JUNCTIONS = {
    "a": (3.0, 4.765),
    "c": (3.0, 2.0),
    "e": (1.25, 4.765),
    "d": (6.0, 2.0),
    "b": (6.0, 4.765),
    "f": (6.0, 7.53),
}


def layout_with(angles: dict[str, float], **depths: float) -> dict[str, Any]:
    """Junctions of the thesis at other angles [deg], and some at other depths [mm]."""
    return {
        c: {
            "depth_mm": depths.get(c, depth),
            "z_mm": z,
            **({"angle_deg": angles[c]} if angles else {}),
        }
        for c, (depth, z) in JUNCTIONS.items()
    }


LAYOUTS: dict[str, dict[str, Any]] = {
    "the thesis's (table 6.2: a, e, f against b, c, d)": {"layout": "table 6.2"},
    "Voller's (table 6.3: a, c, d against b, e, f)": {"layout": "voller"},
    "one group, 15 degrees apart": layout_with({c: 15.0 * k for k, c in enumerate("daebcf")}),
    "one group, 8 degrees apart": layout_with({c: 8.0 * k for k, c in enumerate("daebcf")}),
    "thesis, e at 1.0 mm and a, c at 2.0 mm": layout_with({}, e=1.0, a=2.0, c=2.0),
    "thesis, a and c at 4.0 mm": layout_with({}, a=4.0, c=4.0),
}


def on_one_piece_shaft(statistics: SufficientStatistics) -> SufficientStatistics:
    """The same test on a disk in one piece with its shaft: no uneven bore contact."""
    loading = {n: Loading({}, 0.0) for n in statistics.names if n.startswith("uneven")}
    return replace(statistics, loading={**statistics.loading, **loading})


def uncertainties_row(name: str, tests: list[SufficientStatistics]) -> dict[str, Any]:
    """Mean u over the tests."""
    campaign = solve_campaign(tests)
    single_tests = [solve_campaign([test]).estimates[0] for test in tests]
    return {
        "junctions": name,
        "u(beta) alone": np.mean([e["beta"].u for e in single_tests]),
        "u(beta) of four": np.mean([e["beta"].u for e in campaign.estimates]),
        "within": np.mean([e["beta_within"].u for e in campaign.estimates]),
        "u(h_s)/h_s alone": np.mean([e["h_slow"].u / e["h_slow"].value for e in single_tests]),
        "u(n) of four": speed_law(campaign).exponent.u,
    }


def table() -> pd.DataFrame:
    """All layouts on a shaft, and that of the thesis in one piece with it."""
    rows = []
    for name, junctions in LAYOUTS.items():
        rig = parse_rig({"thermocouples": junctions}, "rig.toml")
        tests = [planned_statistics(p, rig, Logging()) for p in plan_of(CORNERS)]
        rows.append(uncertainties_row(name, tests))
        if len(rows) == 1:
            rows.append(
                uncertainties_row(
                    "the thesis's, disk and shaft in one piece",
                    [on_one_piece_shaft(k) for k in tests],
                )
            )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    print(table().round(5).to_string(index=False))
