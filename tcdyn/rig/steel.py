"""Temperature-dependent conductivity and specific heat of steel, and the Kirchhoff transform.

Used by ``DiskSetup`` and the simulator's steel; :mod:`tcdyn.partition.specified` applies the
transform. With k = k(T), Kirchhoff's temperature obeys the linear equation with a constant
conductivity. Test: ``tests/simulate/test_steel.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tcdyn.core import Array


@dataclass(frozen=True)
class SteelSlopes:
    """Steel with k = k_0 (1 + a (T - T_0)) and c = c_0 (1 + b (T - T_0)).

    Parameters
    ----------
    conductivity_per_K, specific_heat_per_K
        a and b [1/K].
    reference_degC
        T_0.
    air_degC, surface_degC
        Temperatures of air and running surface of a test, about which the rim model is linearised.
    """

    conductivity_per_K: float = 0.0
    specific_heat_per_K: float = 0.0
    reference_degC: float = 20.0
    air_degC: float = 0.0
    surface_degC: float = 0.0

    @property
    def mean_degC(self) -> float:
        """Mean of air and surface; with the conductivity there h does not change."""
        return 0.5 * (self.air_degC + self.surface_degC)

    def relative_conductivity(self, temperature_degC: float) -> float:
        """k(T)/k_0 = 1 + a (T - T_0), dimensionless."""
        return 1 + self.conductivity_per_K * (temperature_degC - self.reference_degC)

    def relative_specific_heat(self, temperature_degC: float) -> float:
        """c(T)/c_0 = 1 + b (T - T_0), dimensionless."""
        return 1 + self.specific_heat_per_K * (temperature_degC - self.reference_degC)

    def kirchhoff_curvature(self, temperature_degC: Array) -> Array:
        """(T - T_A) (T - T_s) / 2 [K2], the shape of Kirchhoff's correction.

        Kirchhoff's temperature is T plus a' times this.

        Parameters
        ----------
        temperature_degC
            Temperatures of any shape.

        Returns
        -------
        curvature
            Of the same shape.
        """
        t = np.asarray(temperature_degC, dtype=float)
        return np.asarray(0.5 * (t - self.air_degC) * (t - self.surface_degC))

    def kirchhoff_temperature(self, temperature_degC: Array) -> Array:
        """Kirchhoff's temperature [degC]: T_A + integral of k / k_m from T_A to T.

        k_m is the conductivity at ``mean_degC``.

        The heat flux is its gradient times the constant k_m, and air and surface keep their
        temperatures: theta = T + a' (T - T_A) (T - T_s) / 2 with a' = a k_0 / k_m.

        Parameters
        ----------
        temperature_degC
            Temperatures of any shape.

        Returns
        -------
        theta
            Of the same shape; unchanged for a constant conductivity.

        Examples
        --------
        >>> steel = SteelSlopes(-5e-4, air_degC=60.0, surface_degC=160.0)
        >>> steel.kirchhoff_temperature(np.array([60.0, 110.0, 160.0])).round(3)
        array([ 60.   , 110.654, 160.   ])
        """
        if not self.conductivity_per_K:
            return temperature_degC
        slope_per_K = self.conductivity_per_K / self.relative_conductivity(self.mean_degC)
        return np.asarray(
            temperature_degC + slope_per_K * self.kirchhoff_curvature(temperature_degC)
        )

    def linearised_about(self, air_degC: float, surface_degC: float) -> SteelSlopes:
        """The same steel, linearised about these temperatures of air and surface.

        Parameters
        ----------
        air_degC
            Temperature of the air.
        surface_degC
            Temperature of the running surface.
        """
        return replace(self, air_degC=air_degC, surface_degC=surface_degC)


# Steel whose properties do not depend on temperature.
EVEN_STEEL = SteelSlopes()
