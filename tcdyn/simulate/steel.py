"""Steel of the synthetic disk with temperature-dependent conductivity and specific heat.

``tcdyn.simulate.mesh`` and ``tcdyn.simulate.harmonics`` build it and ``tcdyn.simulate.implicit``
iterates it. Both properties are linear in temperature. ``tests/simulate/test_steel.py`` compares it
with Kirchhoff's transformation and checks that all heat is stored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.steel import SteelSlopes

MIN_CONDUCTIVITY_SHARE = 0.2  # least conductivity over that at reference; by judgement


@dataclass(frozen=True)
class Steel:
    """Temperature dependence of the conduction and the capacity of a disk.

    Parameters
    ----------
    slopes
        Relative slopes [1/K] and the reference temperature.
    conduction
        Conductances (n, n) between the disk's cells at the reference temperature [W/K].
    cells
        Indices (1 + H, m) of the disk's cells among the unknowns: the even part, then each
        circumferential harmonic.

    Notes
    -----
    Between two cells the conductivity is the mean of theirs:
    k_ij (T_i - T_j) = k_0 (T_i - T_j) (1 + a (T_i + T_j - 2 T_0)/2). What is conducted beyond k_0
    is therefore the conduction of a (T - T_0)^2/2. For a harmonic T_n cos(n psi) it is that of
    a (T - T_0) T_n.
    """

    slopes: SteelSlopes
    conduction: sparse.csc_matrix
    cells: NDArray[np.int64]

    @property
    def depends_on_temperature(self) -> bool:
        """Whether conductivity or specific heat depends on temperature."""
        return bool(self.slopes.conductivity_per_K or self.slopes.specific_heat_per_K)

    def extra_conduction_W(self, y: Array) -> Array:
        """Return the heat that reaches each unknown beyond that of the reference conductivity [W].

        Parameters
        ----------
        y
            State (n,) [degC].

        Returns
        -------
        array
            Heat (n,) [W].

        Raises
        ------
        InputError
            If the steel would hardly conduct at its highest temperature.
        """
        even, *harmonics = (y[rows] for rows in self.cells)
        above_reference = even - self.slopes.reference_degC
        lowest_slope = min(self.slopes.conductivity_per_K, 0.0)
        if 1 + lowest_slope * float(above_reference.max()) < MIN_CONDUCTIVITY_SHARE:
            raise InputError(
                f"at {float(even.max()):.3g} degC this steel would hardly conduct",
                expected=f"a slope that leaves {MIN_CONDUCTIVITY_SHARE:g} of the conductivity",
                remedy="look at conductivity_slope_per_K of [disk]",
            )
        potential = np.zeros_like(y)
        potential[self.cells[0]] = 0.5 * above_reference**2
        for rows, harmonic in zip(self.cells[1:], harmonics):
            potential[rows] = above_reference * harmonic
        return -self.slopes.conductivity_per_K * (self.conduction @ potential)

    def stage_correction_W(self, guess: Array, y: Array, rate: Array, capacity: Array) -> Array:
        """Return the heat by which a Runge-Kutta stage differs from the linear system.

        Parameters
        ----------
        guess
            State for which the heat was computed (n,) [degC].
        y
            State of the stage (n,) [degC].
        rate
            Rates of the stage (n,) [K/s].
        capacity
            Capacities at the reference temperature (n,) [J/K].

        Returns
        -------
        array
            Heat to be added (n,) [W].
        """
        extra_conduction_W = self.extra_conduction_W(y) - self.extra_conduction_W(guess)
        return extra_conduction_W - self._stored_W(y, rate, capacity)

    def _stored_W(self, y: Array, rate: Array, capacity: Array) -> Array:
        """Return the heat stored beyond that of the reference specific heat.

        Parameters
        ----------
        y
            State (n,) [degC].
        rate
            Rates (n,) [K/s].
        capacity
            Capacities at the reference temperature (n,) [J/K].

        Returns
        -------
        array
            Heat (n,) [W].
        """
        out = np.zeros_like(y)
        first = self.cells[0]
        above_reference = y[first] - self.slopes.reference_degC
        out[first] = above_reference * rate[first]
        for rows in self.cells[1:]:
            out[rows] = above_reference * rate[rows] + y[rows] * rate[first]
        return self.slopes.specific_heat_per_K * capacity * out

    def rate(self, heat_W: Array, y: Array, capacity: Array) -> Array:
        """Return the rates at which heat warms the unknowns.

        Parameters
        ----------
        heat_W
            Heat (n,) [W].
        y
            State (n,) [degC].
        capacity
            Capacities at the reference temperature (n,) [J/K].

        Returns
        -------
        array
            Rates (n,) [K/s].

        Notes
        -----
        ``_stored_W`` is the inverse relation; a change of one needs the same change of the other.
        ``tests/simulate/test_steel.py`` checks the stored heat.
        """
        out = heat_W / capacity
        slope = self.slopes.specific_heat_per_K
        if not slope:
            return out
        first = self.cells[0]
        above_reference = y[first] - self.slopes.reference_degC
        out[first] /= 1 + slope * above_reference
        for rows in self.cells[1:]:
            out[rows] -= slope * y[rows] * out[first]
            out[rows] /= 1 + slope * above_reference
        return out
