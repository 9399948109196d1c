"""How fitted numbers move with what nobody measured: the linear half of every budget."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FitShift:
    """Error of fitted numbers by one standard uncertainty of each nuisance, and their noise.

    ``names`` (Q,); ``shared`` (Q,) marks nuisances that both disks have in common; ``per_sd`` (Q, k): how far the fit
    is off when the true disk departs by one standard uncertainty from the stated one, in the units of the fitted
    numbers: (intercept, slope) of a steady line, (share, h [W/m2K]) of a cooling fit, (share, h, lag [s]) of a joint
    fit; ``noise`` (k, k) covariance.
    """

    names: tuple[str, ...]
    shared: tuple[bool, ...]
    per_sd: NDArray[np.float64]
    noise: NDArray[np.float64]
