"""Why junctions of a heated disk are not in the order of their depths: swapped, an uneven start, an
uneven disk.

Closed forms for a plate: steady heating at the rate r gives a rise of r t - g depth; modes of an
uneven start decay.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.findings import Finding, SampleLocation
from tcdyn.rig.check_kind import check_kind
from tcdyn.rig.rigfile import load_rig

RATE_K_s = 2.0
GRADIENT_K_mm = 1.0
ENTRY_S = 20.0
OFFSETS_K = {"a": 0.3, "b": -0.2, "c": -0.3, "d": 0.25, "e": 0.1, "f": -0.1}
RIG = load_rig()
JUNCTIONS = RIG.tables("fast").thermocouples


def plunge(
    start_K_mm: float = 0.0,
    start_side_K: float = 0.0,
    side_share: float = 0.0,
    swapped: tuple[str, str] | None = None,
) -> pd.DataFrame:
    """A plunge log.

    At the start the surface is warmer by ``start_K_mm`` per mm, and one side by ``start_side_K``;
    that side warms more by ``side_share``.
    """
    t = np.arange(0.0, 80.0, 1 / 75)
    since = np.clip(t - ENTRY_S, 0.0, 40.0)
    noise = 0.1 * np.random.default_rng(0).standard_normal((6, len(t)))
    columns = {"time_s": t, "switch": (t >= ENTRY_S).astype(float)}
    columns["fluid_degC"] = np.full(len(t), 110.0)
    for k, (c, junction) in enumerate(JUNCTIONS.items()):
        depth = junction.depth_mm
        heating = RATE_K_s * since - GRADIENT_K_mm * depth * np.minimum(since / 2.0, 1.0)
        side = side_share * np.cos(np.deg2rad(junction.angle_deg))
        start = -start_K_mm * (depth - 3.0) * np.exp(-since / 8.0)
        start += start_side_K * np.cos(np.deg2rad(junction.angle_deg)) * np.exp(-since / 36.0)
        columns[f"{c}_degC"] = 25.0 + OFFSETS_K[c] + heating * (1 + side) + start + noise[k]
    if swapped is not None:
        first, second = (f"{c}_degC" for c in swapped)
        columns[first], columns[second] = columns[second], columns[first]
    return pd.DataFrame(columns)


def order_findings(frame: pd.DataFrame) -> list[Finding]:
    switch = frame["switch"].to_numpy()
    location = SampleLocation("plunge.csv", time_s=frame["time_s"].to_numpy(), dt_s=1 / 75)
    _, findings = check_kind("immersion", frame, {"switch": switch}, location, RIG, "fast")
    return [f for f in findings if f.code.startswith("junctions.")]


def test_sound_plunge_has_no_finding() -> None:
    assert order_findings(plunge()) == []


@pytest.mark.parametrize("pair", [("a", "f"), ("c", "f"), ("e", "b"), ("e", "f"), ("a", "b")])
def test_swapped_channels_are_reported_as_swapped(pair: tuple[str, str]) -> None:
    (finding,) = order_findings(plunge(swapped=pair))
    assert finding.code == "junctions.swapped"
    assert set(pair) & {finding.subject[0], finding.numbers["other"][0]}


def test_side_that_is_warmer_at_the_start_is_not_taken_for_an_uneven_disk() -> None:
    (finding,) = order_findings(plunge(start_side_K=8.0))
    assert finding.code == "junctions.uneven_start"


def test_disk_that_is_colder_inside_at_the_start_is_not_reported_as_swapped() -> None:
    (finding,) = order_findings(plunge(start_K_mm=2.5))
    assert finding.code == "junctions.uneven_start"
    # 2.5 K per mm, between 3 or 1.25 and 6 mm, and the static offsets
    assert 7.0 < finding.numbers["start_K"] < 12.5


@pytest.mark.parametrize("side_share", [0.03, -0.05, 0.15])
def test_disk_that_warms_more_on_one_side_is_reported_as_uneven(side_share: float) -> None:
    """3 % of the rise differ less than the depths do, and 15 % more."""
    (finding,) = order_findings(plunge(side_share=side_share))
    assert finding.code == "junctions.uneven_disk"
    first, second = (JUNCTIONS[column[0]] for column in (finding.subject, finding.numbers["other"]))
    assert first.depth_mm == second.depth_mm
    sides = [np.cos(np.deg2rad(junction.angle_deg)) for junction in (first, second)]
    assert np.sign(sides).tolist() == [-np.sign(side_share), np.sign(side_share)]


def test_channels_swapped_in_an_uneven_disk_are_reported_as_swapped() -> None:
    (finding,) = order_findings(plunge(side_share=0.05, swapped=("e", "f")))
    assert finding.code == "junctions.swapped"
