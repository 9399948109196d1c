"""How a fitted pair of numbers moves with what nobody measured: the linear half of every budget."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FitShift:
    """Change of two fitted numbers by one standard uncertainty of each nuisance, and their noise.

    ``names`` (Q,); ``shared`` (Q,) marks nuisances that both disks have in common; ``per_sd`` (Q, 2) in the units of
    the pair: (share, h [W/m2K]) of a transient fit, (intercept, slope) of a steady line; ``noise`` (2, 2) covariance.
    """

    names: tuple[str, ...]
    shared: tuple[bool, ...]
    per_sd: NDArray[np.float64]
    noise: NDArray[np.float64]
