"""The steady line of one disk from its window, and its error by what nobody measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.partition.nuisance import Nuisances
from tcdyn.partition.shift import FitShift
from tcdyn.partition.steady import H_GRID_W_M2K, Line, SteadyMap, steady_map
from tcdyn.partition.window import DiskWindow

END_GAP_S = 0.2  # the last fraction of a second may already hold the parting


@dataclass(frozen=True)
class DiskLine:
    """Map and line of one disk, and the error of (intercept, slope) per standard uncertainty of each nuisance."""

    map: SteadyMap
    shift: FitShift

    @property
    def line(self) -> Line:
        """The line of least misfit."""
        return self.map.line


def disk_line(
    window: DiskWindow, unload_s: float, weights: NDArray[np.float64], at: Callable[[float, float], Nuisances]
) -> DiskLine:
    """Line of least misfit over the steady blocks of ``window``.

    ``weights`` (3,) of a, c, e: (7.1) or (7.2); ``at(share, h)`` gives the nuisances about a point of the plane.
    """
    steady = window.blocks.time_s < unload_s - END_GAP_S
    answers = [window.answer(window.gains(float(h))) for h in H_GRID_W_M2K]
    rest = np.stack([a[0][steady] for a in answers])
    power = np.stack([a[1][steady] for a in answers])
    found = steady_map(window.y[steady], rest, power, weights=weights)
    low, high = 2, len(H_GRID_W_M2K) - 3
    moved = []
    for k in (low, high):
        h = float(H_GRID_W_M2K[k])
        nuis = at(found.line.at(h), h)
        p, w = power[k], weights / weights.sum()
        effect = nuis.effect[:, steady] * nuis.sd[:, None, None]
        moved.append(np.einsum("qrp,rp,p->q", effect, p, w) / np.einsum("rp,rp,p->", p, p, w))
    h_low, h_high = float(H_GRID_W_M2K[low]), float(H_GRID_W_M2K[high])
    slope = (moved[1] - moved[0]) / (h_high - h_low)
    per_sd = np.column_stack([moved[0] - slope * h_low, slope])
    shift = FitShift(nuis.names, nuis.shared, per_sd, np.diag([_noise(window, steady, power[low], weights) ** 2, 0.0]))
    return DiskLine(found, shift)


def _noise(
    window: DiskWindow, steady: NDArray[np.bool_], power: NDArray[np.float64], weights: NDArray[np.float64]
) -> float:
    """Standard uncertainty of the share at a given h from the white noise of the readings, boundary included."""
    w = weights / weights.sum()
    s = power * w
    per = 1 / window.weight[steady]
    return float(np.sqrt(2.0 * ((s * per) ** 2).sum()) / (s * power).sum())
