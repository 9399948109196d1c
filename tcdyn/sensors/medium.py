"""Medium around a sensor: its properties, and the surface coefficient in any stream or at rest.

``tcdyn.sensors.predict`` uses it before a sensor is bought, ``tcdyn.sensors.surface_h`` for the
lag in another stream than that of a dip. ``tests/sensors/test_predict.py`` compares it with the
package ``ht``. That is not needed at run time: of it, two closed formulas would be used, which are
here and in ``immersion.correlations``, and it has no properties of fluids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from immersion.correlations import CORRELATIONS, GRAVITY_M_S2
from immersion.fluids import FLUIDS, JET_OIL, WATER, ZERO_C, Fluid, FluidProperties, fluid
from tcdyn.chain.law import MIXED
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning

# Largest speed [m/s]; chosen by judgement, so that another unit is recognised.
MAX_SPEED_M_S = 200.0
# Temperatures that are possible for a medium [degC]; chosen by judgement.
TEMPERATURE_RANGE_DEGC = (-100.0, 1200.0)
# Temperatures of a liquid beyond the range of its properties that are still taken [K]; by
# judgement: the curves are smooth over it, and a warning says that they are extrapolated
EXTRAPOLATED_K = 150.0
# Density below which a fluid of a table is a gas [kg/m3]; by judgement: steam at 100 bar has 55.
GAS_KG_M3 = 60.0
# Stefan-Boltzmann constant [W/m2K4] (CODATA 2018).
STEFAN_BOLTZMANN = 5.670374e-8
# Emissivity of a sheath: lightly oxidised steel has 0.3, stably oxidised 0.9 (Incropera, table
# A.11).
EMISSIVITY = (0.3, 0.9)
# Difference of sensor and medium [K] that drives natural convection: median, and standard deviation
# of its logarithm. By judgement: 10 to 40 K in two of three cases; h goes with its fourth root.
DIFFERENCE_K = (20.0, 0.7)
# Standard deviation of the logarithm of the viscosity of an oil whose kind is not known: ISO VG 10
# to 100. By judgement; h goes with its sixth root.
OIL_VISCOSITY = 0.7


def _air_density(T: Array) -> Array:
    """Density of dry air at 101.325 kPa as an ideal gas [kg/m3]."""
    return 352.98 / (T + ZERO_C)


def _air_heat(T: Array) -> Array:
    """Specific heat of air [J/kgK] (Incropera, table A.4)."""
    kelvin = [200.0, 300.0, 400.0, 500.0, 600.0, 800.0, 1000.0, 1200.0, 1500.0]
    heat = [1007.0, 1007.0, 1014.0, 1030.0, 1051.0, 1099.0, 1141.0, 1175.0, 1230.0]
    return np.interp(T + ZERO_C, kelvin, heat)


def _air_conductivity(T: Array) -> Array:
    """Conductivity of air by Sutherland's law [W/mK] (White, Viscous Fluid Flow, table 1-3)."""
    x = (T + ZERO_C) / 273.0
    return 0.0241 * x**1.5 * (273.0 + 194.0) / (T + ZERO_C + 194.0)


def _air_viscosity(T: Array) -> Array:
    """Kinematic viscosity of air by Sutherland's law [m2/s] (White, table 1-2)."""
    x = (T + ZERO_C) / 273.0
    dynamic = 1.716e-5 * x**1.5 * (273.0 + 111.0) / (T + ZERO_C + 111.0)
    return dynamic / _air_density(T)


AIR = Fluid(
    "air",
    rho=_air_density,
    c=_air_heat,
    k=_air_conductivity,
    nu=_air_viscosity,
    range_degC=(-70.0, 1200.0),
    source="ideal gas at 101.325 kPa; Sutherland's law for viscosity and conductivity (White)",
    u_rho=0.01,
    u_c=0.005,
    u_k=0.02,
    u_nu=0.02,
    u_beta=0.0,
)
# Media by name; ``oil`` is an oil of unknown kind, with the curves of a thin synthetic one.
MEDIA = {"water": WATER, "air": AIR, "oil": JET_OIL}


def nusselt_cross_flow(reynolds: ArrayLike, prandtl: ArrayLike) -> Array:
    """Mean Nusselt number of a cylinder in cross flow (Churchill and Bernstein 1977).

    Parameters
    ----------
    reynolds, prandtl
        Reynolds number with the diameter, and Prandtl number, of one shape.

    Returns
    -------
    array
        Nusselt number; valid for Re Pr above 0.2.

    Notes
    -----
    Nu = 0.3 + 0.62 Re^1/2 Pr^1/3 [1 + (0.4/Pr)^2/3]^-1/4 [1 + (Re/282000)^5/8]^4/5

    Its authors call it a lower bound: turbulence of the stream raises h.

    Examples
    --------
    >>> nusselt_cross_flow([120.0, 25000.0], [0.71, 4.0]).round(1).tolist()
    [5.7, 174.1]
    """
    re = np.asarray(reynolds, dtype=float)
    pr = np.asarray(prandtl, dtype=float)
    laminar = 0.62 * re**0.5 * pr ** (1 / 3) / (1 + (0.4 / pr) ** (2 / 3)) ** 0.25
    return np.asarray(0.3 + laminar * (1 + (re / 282e3) ** 0.625) ** 0.8)


@dataclass(frozen=True)
class FilmPriors:
    """What is not known of the surface coefficient: a value, or an array of one shape each.

    Attributes
    ----------
    difference_K
        Difference of sensor and medium.
    viscosity
        Factor of the viscosity.
    emissivity
        Emissivity of the sheath, which counts in a gas.
    """

    difference_K: ArrayLike = DIFFERENCE_K[0]
    viscosity: ArrayLike = 1.0
    emissivity: ArrayLike = sum(EMISSIVITY) / 2


@dataclass(frozen=True)
class Surroundings:
    """A medium of a temperature that moves past a sensor, or is at rest.

    Attributes
    ----------
    medium
        water, air, oil, another fluid of ``immersion.fluids``, or a table of properties (.csv).
    speed_m_s
        Speed [m/s]; zero: natural convection.
    T_degC
        Temperature [degC].

    Raises
    ------
    InputError
        For an unknown medium, or a speed or temperature that is not possible.

    Examples
    --------
    >>> [round(float(Surroundings(*each).h_W_m2K(3e-3))) for each in (("water", 0.4), ("air", 3.0))]
    [8402, 110]
    """

    medium: str
    speed_m_s: float
    T_degC: float = 25.0

    def __post_init__(self) -> None:
        """Check medium, speed and temperature."""
        _ = self.fluid  # raises for an unknown medium
        if not 0 <= self.speed_m_s < MAX_SPEED_M_S:
            raise InputError(
                f"{{speed_m_s}} is {self.speed_m_s:g}",
                expected=f"0 to {MAX_SPEED_M_S:g} m/s",
                parameters={"speed_m_s": None},
            )
        low, high = TEMPERATURE_RANGE_DEGC
        if not low <= self.T_degC <= high:
            raise InputError(
                f"{{T_degC}} is {self.T_degC:g}",
                expected=f"{low:g} to {high:g} degC",
                parameters={"T_degC": None},
            )
        low, high = self.fluid.range_degC
        margin = EXTRAPOLATED_K
        if not self.is_gas and not low - margin <= self.T_degC <= high + margin:
            raise InputError(
                f"{{T_degC}} is {self.T_degC:g}",
                expected=f"{low - margin:g} to {high + margin:g} degC in {self.medium}",
                parameters={"T_degC": None},
            )

    @property
    def _name(self) -> str:
        """Name of the medium in lower case."""
        return self.medium.strip().lower()

    @property
    def fluid(self) -> Fluid:
        """The fluid.

        Raises
        ------
        InputError
            For an unknown name.
        """
        name = self._name
        if name in MEDIA:
            return MEDIA[name]
        if name in FLUIDS or name.endswith((".csv", ".txt")):
            return fluid(self.medium)
        raise InputError(
            f"{{medium}} is {self.medium!r}",
            expected=f"{', '.join(MEDIA)}, or a table of properties (.csv)",
            remedy="a table has the columns T_degC, rho_kg_m3, c_J_kgK, k_W_mK, nu_m2_s",
            parameters={"medium": None},
        )

    @property
    def is_gas(self) -> bool:
        """Whether the medium is a gas, through which a sheath radiates."""
        inside = np.clip(self.T_degC, *self.fluid.range_degC)
        return float(self.fluid.rho(np.asarray(inside))) < GAS_KG_M3

    @property
    def viscosity_u(self) -> float:
        """Standard deviation of the logarithm of the viscosity."""
        return OIL_VISCOSITY if self._name == "oil" else self.fluid.u_nu

    def findings(self) -> tuple[Finding, ...]:
        """A warning where the properties are extrapolated, or a liquid is above 100 degC."""
        found = self.fluid.check_range(self.T_degC, self.T_degC)
        if self.fluid is WATER and not 0 < self.T_degC < 100:
            return (warning("predict.no_liquid", T_degC=self.T_degC),)
        return found

    def _flow_properties(
        self, T_degC: float, of: FilmPriors
    ) -> tuple[FluidProperties, Array, Array]:
        """Properties at a temperature, and viscosity [m2/s] and Prandtl number with its prior."""
        properties = self.fluid.at(T_degC)
        factor = np.asarray(of.viscosity)
        return properties, properties.nu_m2_s * factor, properties.prandtl * factor

    def natural_W_m2K(self, diameter_m: ArrayLike, priors: FilmPriors | None = None) -> Array:
        """Coefficient of natural convection about a cylinder that lies at rest [W/m2K].

        Parameters
        ----------
        diameter_m
            Diameter [m], one or many.
        priors
            Values of what is not known.
        """
        of = priors or FilmPriors()
        d = np.asarray(diameter_m, dtype=float)
        # in the film; water of 4 degC expands neither way, but its film does
        properties, nu, prandtl = self._flow_properties(self.T_degC + 0.5 * DIFFERENCE_K[0], of)
        lift = GRAVITY_M_S2 * np.abs(properties.beta_1_K) * np.asarray(of.difference_K)
        rayleigh = lift * d**3 / nu**2 * prandtl
        nusselt = CORRELATIONS["horizontal-cylinder"].nusselt(rayleigh, prandtl)
        return np.asarray(nusselt * properties.k_W_mK / d)

    def radiation_W_m2K(self, priors: FilmPriors | None = None) -> Array:
        """Coefficient of radiation to walls of the temperature of a gas [W/m2K]; in a liquid 0."""
        if not self.is_gas:
            return np.zeros(())
        emissivity = np.asarray((priors or FilmPriors()).emissivity)
        return np.asarray(4 * emissivity * STEFAN_BOLTZMANN * (self.T_degC + ZERO_C) ** 3)

    def forced_W_m2K(
        self,
        diameter_m: ArrayLike,
        speed_m_s: ArrayLike | None = None,
        priors: FilmPriors | None = None,
    ) -> Array:
        """Coefficient of the cross flow alone [W/m2K].

        Parameters
        ----------
        diameter_m
            Diameter [m], one or many.
        speed_m_s
            Speed [m/s]; None: that of the surroundings.
        priors
            Values of what is not known.
        """
        of = priors or FilmPriors()
        d = np.asarray(diameter_m, dtype=float)
        speed = np.asarray(self.speed_m_s if speed_m_s is None else speed_m_s, dtype=float)
        properties, nu, prandtl = self._flow_properties(self.T_degC, of)
        nusselt = nusselt_cross_flow(speed * d / nu, prandtl)
        return np.where(speed > 0, nusselt * properties.k_W_mK / d, 0.0)

    def h_W_m2K(
        self,
        diameter_m: ArrayLike,
        speed_m_s: ArrayLike | None = None,
        priors: FilmPriors | None = None,
    ) -> Array:
        """Surface coefficient of a cylinder across the flow, or lying at rest [W/m2K].

        Parameters
        ----------
        diameter_m
            Diameter [m], one or many.
        speed_m_s
            Speed [m/s]; None: that of the surroundings.
        priors
            Values of what is not known.

        Notes
        -----
        Forced and natural convection combine as h^3 = h_f^3 + h_n^3 (``tcdyn.chain.law.MIXED``);
        radiation adds.
        """
        forced = self.forced_W_m2K(diameter_m, speed_m_s, priors)
        natural = self.natural_W_m2K(diameter_m, priors)
        mixed = (forced**MIXED + natural**MIXED) ** (1 / MIXED)
        return np.asarray(mixed + self.radiation_W_m2K(priors))
