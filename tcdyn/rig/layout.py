"""Where the thesis's three rigs have their junctions."""

from __future__ import annotations

from collections.abc import Mapping

_PLACES = {
    "a": (3.0, 4.765),
    "b": (6.0, 4.765),
    "c": (3.0, 2.0),
    "d": (6.0, 2.0),
    "e": (1.25, 4.765),
    "f": (6.0, 7.53),
}
LAYOUTS = {  # angle_deg of the junctions; two groups opposite each other, 15 degrees between neighbours (assumed)
    "table 6.2": {"a": 0.0, "e": 15.0, "f": 345.0, "b": 180.0, "c": 195.0, "d": 165.0},
    "clarke": (opposite := {"a": 0.0, "c": 15.0, "d": 345.0, "b": 180.0, "e": 195.0, "f": 165.0}),
    "voller": opposite,
}
CHANNELS = tuple(_PLACES)  # of the thesis's disks; what a disk has is its ``DiskSetup.channels``
DEFAULT_LAYOUT = "table 6.2"  # of this rig's disks; tables 6.3 and 6.4 are Clarke's and Voller's
OWN_LAYOUT = "own"  # nothing but what the table lists
ROW_M = 1e-3  # junctions this much nearer the surface than the deepest are of its row no more
ELSEWHERE = {"clarke": {"e": {"depth_mm": 3.0, "z_mm": 7.53}}}


def layout_junctions(layout: str) -> dict[str, dict[str, float]]:
    """Where the junctions a..f of a layout sit: depth_mm, z_mm, angle_deg of each; of one's own nothing is known.

    >>> layout_junctions("voller")["c"]
    {'depth_mm': 3.0, 'z_mm': 2.0, 'angle_deg': 15.0}
    """
    if layout == OWN_LAYOUT:
        return {}
    if not isinstance(layout, str) or layout not in LAYOUTS:
        raise ValueError(
            f"thermocouples.layout is {layout!r}; expected one of {', '.join((*LAYOUTS, OWN_LAYOUT))}"
        )
    places = {
        c: {"depth_mm": depth, "z_mm": z, "angle_deg": LAYOUTS[layout][c]}
        for c, (depth, z) in _PLACES.items()
    }
    return {c: place | ELSEWHERE.get(layout, {}).get(c, {}) for c, place in places.items()}


def inner_row(depth_m: Mapping[str, float], z_m: Mapping[str, float]) -> tuple[str, ...]:
    """The junctions that lie about as deep as the deepest, in the order of z: they drive the rim model.

    >>> inner_row({"a": 3e-3, "b": 6e-3, "d": 5.8e-3, "e": 1e-3}, {"a": 5e-3, "b": 5e-3, "d": 2e-3, "e": 5e-3})
    ('d', 'b')
    """
    deepest = max(depth_m.values())
    return tuple(
        sorted(
            (c for c in sorted(depth_m) if round(deepest - depth_m[c], 9) < ROW_M),
            key=lambda c: z_m[c],
        )
    )
