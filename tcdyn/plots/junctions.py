"""Where a test places the junctions against where they are stated to be."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes

from calibration.estimate import Z95
from tcdyn.partition.sensors.faults import DepthTest
from tcdyn.plots.style import DISK_COLOUR, DISK_MARKER


def draw_junctions(tests: Mapping[str, DepthTest], ax: Axes) -> Axes:
    """How much deeper than stated the test alone places each junction, with 95 % bars; grey: the stated 95 %."""
    stated_mm = max(t.stated_u_m for t in tests.values()) * 1e3
    ax.axhspan(-Z95 * stated_mm, Z95 * stated_mm, color="#e6e6e6", zorder=0, label="as stated, 95 %")
    for k, (disk, test) in enumerate(tests.items()):
        at = [i + 0.24 * (k - 0.5) for i in range(len(test.deeper_m))]  # side by side
        mm = [1e3 * e.value for e in test.deeper_m.values()]
        bars = [Z95 * 1e3 * e.u for e in test.deeper_m.values()]
        ax.errorbar(
            at, mm, yerr=bars, fmt=DISK_MARKER[disk], color=DISK_COLOUR[disk], capsize=2, linewidth=0.9,
            label=f"{disk} disk, by this test alone, 95 %",
        )  # fmt: skip
    ax.set_xticks(range(len(test.deeper_m)), list(test.deeper_m))
    ax.axhline(0, color="black", linewidth=0.8)
    ax.set_xlabel("junction")
    ax.set_ylabel("deeper than stated [mm]")
    ax.legend(frameon=False, fontsize=8, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return ax
