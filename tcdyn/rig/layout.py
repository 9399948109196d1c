"""Positions of the junctions of the three rigs of the thesis, and the inner row of a disk."""

from __future__ import annotations

from collections.abc import Mapping

# (depth_mm, z_mm) of the junctions
_POSITIONS_MM = {
    "a": (3.0, 4.765),
    "b": (6.0, 4.765),
    "c": (3.0, 2.0),
    "d": (6.0, 2.0),
    "e": (1.25, 4.765),
    "f": (6.0, 7.53),
}
# angle_deg of the junctions: two opposite groups, 15 degrees between neighbours (assumed)
_CLARKE_AND_VOLLER = {"a": 0.0, "c": 15.0, "d": 345.0, "b": 180.0, "e": 195.0, "f": 165.0}
ANGLES_DEG = {
    "table 6.2": {"a": 0.0, "e": 15.0, "f": 345.0, "b": 180.0, "c": 195.0, "d": 165.0},
    "clarke": _CLARKE_AND_VOLLER,
    "voller": _CLARKE_AND_VOLLER,
}
# junctions of a layout whose positions differ from the table above
_OTHER_POSITIONS_MM = {"clarke": {"e": (3.0, 7.53)}}
# Channels of the thesis's disks; those of any disk are ``DiskSetup.channels``.
CHANNELS = tuple(_POSITIONS_MM)
DEFAULT_LAYOUT = "table 6.2"  # of this rig's disks; tables 6.3 and 6.4 are Clarke's and Voller's
OWN_LAYOUT = "own"  # only the junctions that the rig file lists
# Junctions nearer the surface than the deepest one by this [m] are not in its row. By judgement.
ROW_DEPTH_M = 1e-3


def layout_junctions(layout: str) -> dict[str, dict[str, float]]:
    """Positions of the junctions a..f of a layout; empty for the layout "own".

    >>> layout_junctions("voller")["c"]
    {'depth_mm': 3.0, 'z_mm': 2.0, 'angle_deg': 15.0}
    """
    if layout == OWN_LAYOUT:
        return {}
    if not isinstance(layout, str) or layout not in ANGLES_DEG:
        raise ValueError(
            f"thermocouples.layout is {layout!r}; expected one of "
            f"{', '.join((*ANGLES_DEG, OWN_LAYOUT))}"
        )
    positions = _POSITIONS_MM | _OTHER_POSITIONS_MM.get(layout, {})
    return {
        name: {"depth_mm": depth_mm, "z_mm": z_mm, "angle_deg": ANGLES_DEG[layout][name]}
        for name, (depth_mm, z_mm) in positions.items()
    }


def inner_row(depth_m: Mapping[str, float], z_m: Mapping[str, float]) -> tuple[str, ...]:
    """The junctions about as deep as the deepest, in the order of z: the boundary of the rim model.

    >>> depth_m = {"a": 3e-3, "b": 6e-3, "d": 5.8e-3, "e": 1e-3}
    >>> inner_row(depth_m, {"a": 5e-3, "b": 5e-3, "d": 2e-3, "e": 5e-3})
    ('d', 'b')
    """
    deepest = max(depth_m.values())
    row = [name for name in sorted(depth_m) if round(deepest - depth_m[name], 9) < ROW_DEPTH_M]
    return tuple(sorted(row, key=lambda name: z_m[name]))
