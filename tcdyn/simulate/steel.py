"""Steel of the synthetic disk that conducts and holds heat otherwise where it is hot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.steel import SteelSlopes

LEAST = 0.2


@dataclass(frozen=True)
class Steel:
    """``conduction`` (n, n) between the disk's own cells at the reference temperature [W/K]; ``cells`` (1 + H, m): the
    disk's cells among the unknowns, those of its even part and then of each harmonic round it.

    Between two cells the conductivity is the mean of theirs: k_ij (T_i - T_j) = k_0 (T_i - T_j) (1 + a (T_i + T_j - 2
    T_0)/2), so what is conducted beyond k_0 is the conduction of a (T - T_0)^2/2. To a harmonic T_n cos(n psi) of it
    belongs a (T - T_0) T_n.
    """

    slopes: SteelSlopes
    conduction: sparse.csc_matrix
    cells: NDArray[np.int64]

    @property
    def follows(self) -> bool:
        """Whether anything depends on temperature."""
        return bool(self.slopes.conductivity_per_K or self.slopes.specific_heat_per_K)

    def conducted_W(self, y: Array) -> Array:
        """Heat that reaches each unknown beyond what the reference conductivity brings, (n,) [W]."""
        even, *harmonics = (y[rows] for rows in self.cells)
        hotter = even - self.slopes.reference_degC
        more = np.zeros_like(y)
        if 1 + min(self.slopes.conductivity_per_K, 0.0) * float(hotter.max()) < LEAST:
            raise InputError(
                f"at {float(even.max()):.3g} degC this steel would hardly conduct",
                expected=f"a slope that leaves {LEAST:g} of the conductivity",
                remedy="look at conductivity_slope_per_K of [disk]",
            )
        more[self.cells[0]] = 0.5 * hotter**2
        for rows, own in zip(self.cells[1:], harmonics):
            more[rows] = hotter * own
        return -self.slopes.conductivity_per_K * (self.conduction @ more)

    def more_W(self, guess: Array, y: Array, rate: Array, capacity: Array) -> Array:
        """What a stage's right side has beyond that of the state ``guess``, if it stands at ``y`` and ``rate`` (n,)."""
        return self.conducted_W(y) - self.conducted_W(guess) - self._held_W(y, rate, capacity)

    def _held_W(self, y: Array, rate: Array, capacity: Array) -> Array:
        """Heat beyond that of the reference's specific heat that warms each unknown at ``rate`` [K/s], (n,) [W]."""
        out = np.zeros_like(y)
        hotter = y[self.cells[0]] - self.slopes.reference_degC
        for n, rows in enumerate(self.cells):
            out[rows] = hotter * rate[rows] + (y[rows] * rate[self.cells[0]] if n else 0.0)
        return self.slopes.specific_heat_per_K * capacity * out

    def rate(self, heat_W: Array, y: Array, capacity: Array) -> Array:
        """Rates (n,) [K/s] at which ``heat_W`` (n,) warms the unknowns at ``y``."""
        out = heat_W / capacity
        slope = self.slopes.specific_heat_per_K
        if slope:
            hotter = y[self.cells[0]] - self.slopes.reference_degC
            for n, rows in enumerate(self.cells):  # the even part first, which the others ask for
                out[rows] -= slope * y[rows] * out[self.cells[0]] if n else 0.0
                out[rows] /= 1 + slope * hotter
        return np.asarray(out)
