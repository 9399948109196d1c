"""Construction of a sheathed thermocouple before it is bought: priors, and a designed sample.

Each prior has its source beside it. ``tcdyn.sensors.predict`` propagates them;
``python -m tests.sensors.predict_study`` compares the result with the tables of makers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy.stats import norm
from scipy.stats.qmc import Sobol

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.sensors.layers import Layer, Responses, layered_responses
from tcdyn.sensors.medium import AIR, DIFFERENCE_K, EMISSIVITY, FilmPriors, Surroundings
from tcdyn.sensors.surface_h import U_REL

# Place of the junction: in the axis, insulated from the sheath; welded to the sheath; or outside of
# the sheath, bare.
JunctionWord = Literal["insulated", "grounded", "exposed"]
JUNCTION_WORDS: tuple[JunctionWord, ...] = get_args(JunctionWord)
Filling = Literal["air", "oil", "paste"]
FILLINGS: tuple[Filling, ...] = get_args(Filling)

SAMPLES = 512  # a power of two (Sobol); with 4096 the u of a lag changes by less than 3 %
SEED = 3522  # of the scrambled sequence: results repeat

# Wall of the sheath over the diameter: makers state 0.12 (electronic-sensor.de, "Sheathing
# thermocouple") and 0.13 to 0.15 (temprelthermocouple.blogspot.com, 2012/04); IEC 61515 asks for
# 0.10 or more.
WALL = (0.10, 0.15)
# Wire over the diameter: 0.15 and 0.20 (the same makers); IEC 61515 asks for 0.15 or more.
WIRE = (0.15, 0.21)
# Diameter of the core that is read, over that of a wire: two wires of one area have 1.41, a bead
# that spans both has 2. By judgement between them.
CORE_WIRES = (1.41, 2.0)
# Conductivity of the powder around the junction [W/mK], equally likely on a scale of logarithms.
# Dense magnesia has 30 (Slifka, Filla and Phelps, J. Res. NIST 103, 357, 1998); swaged powder of 80
# to 90 % density has a few; at the tip it is filled again by hand, and looser. By judgement.
POWDER_W_MK = (0.7, 5.0)
# The same of a junction that is welded to the sheath: swaged powder is left beside it, and some of
# it is replaced by weld metal, up to all (alloy 600: 15). By judgement, after a look at the tables
# of the study.
WELDED_W_MK = (1.5, 16.0)
# Gap between powder and sheath over the diameter, filled with air; 10 um at 3 mm. By judgement: a
# swaged cable is tight, a repacked tip and a heated sheath less so.
GAP = (0.0, 1 / 300)
# Conductivities [W/mK] of the wires (type K 19 and 30, type J iron 70, constantan 20) and of the
# sheath (316L 14, alloy 600 15), at room temperature. Data sheets of the alloys.
CORE_W_MK = (19.0, 40.0)
SHEATH_W_MK = (13.0, 16.0)
# Heat capacities at room temperature [J/m3K]: wires of nickel alloys, iron and constantan 3.5e6 to
# 3.9e6; powder of 60 to 90 % of dense magnesia, 3.3e6; 316L 4.0e6, alloy 600 3.75e6 (data sheets).
CORE_J_M3K = (3.5e6, 3.9e6)
POWDER_J_M3K = (2.0e6, 3.0e6)
SHEATH_J_M3K = (3.75e6, 4.0e6)
# Rise of the heat capacities with the temperature over that at 25 degC [1/K]: alloy 600 has 444
# J/kgK at 21 degC and 611 at 870 degC (data sheet), 316L a little less.
HEAT_PER_K = 4e-4
# Share of the core in the reading of a junction that is welded to the sheath, whose wires lead heat
# to the colder core; by judgement, after a look at the tables of the study.
GROUNDED_CORE = (0.0, 0.45)
# Diameter of the bead of an exposed junction over that of its wires, and its volume over area, over
# that of a cylinder: 2/3 is a sphere. By judgement.
BEAD_WIRES = (1.3, 2.0)
BEAD_SHAPE = (2 / 3, 1.0)
# Tolerance of the diameter: 0.025 mm, or 1 % (IEC 61515, table of dimensions).
TOLERANCE_MM = 0.025
TOLERANCE_REL = 0.01
# Relative standard uncertainty of a speed that is given without one: the tolerance of 0.05 m/s of
# the test at 0.4 m/s (IEC 60751), as a rectangular distribution.
SPEED_U_REL = 0.07
# Standard deviation of the logarithm of the lag by what a radial model leaves out: conduction
# through the tip and along the stem. By judgement.
MODEL_U_REL = 0.08
# Bore of a well over the diameter of the sensor: DIN 43772 has 7 mm for inserts of 6 mm. Where it
# is not stated, with the range of drilled wells; by judgement.
BORE = (1.08, 1.2)
# Distance of the axes over the clearance: from centred to touching; by judgement.
ECCENTRICITY = (0.0, 0.97)
# Conductivity of what fills the gap of a well [W/mK]: air at its temperature, mineral oils, filled
# silicone pastes (data sheets).
FILLING_W_MK: dict[str, tuple[float, float]] = {"oil": (0.11, 0.15), "paste": (0.6, 2.5)}
# Elements of core, powder, sheath and well: half of them change a lag by less than 0.1 %.
ELEMENTS = (3, 8, 3, 6)


@dataclass(frozen=True)
class Well:
    """A well around the sensor.

    Attributes
    ----------
    outer_mm
        Outer diameter [mm].
    bore_mm
        Diameter of the bore [mm]; None: that of usual wells.
    filling
        What is between sensor and well.
    """

    outer_mm: float
    bore_mm: float | None = None
    filling: Filling = "air"

    def check(self, diameter_mm: float) -> None:
        """Raise InputError for a well into which the sensor does not fit.

        Raises
        ------
        InputError
            With the sizes that fit.
        """
        bore_mm = BORE[1] * diameter_mm if self.bore_mm is None else self.bore_mm
        if bore_mm < diameter_mm:
            raise InputError(
                f"{{well_bore_mm}} is {bore_mm:g}",
                expected=f"at least the diameter of the sensor, {diameter_mm:g} mm",
                parameters={"well_bore_mm": None},
            )
        if not 1.05 * bore_mm <= self.outer_mm <= 200:
            raise InputError(
                f"{{well_mm}} is {self.outer_mm:g}",
                expected=f"more than its bore, {1.05 * bore_mm:.3g} to 200 mm",
                parameters={"well_mm": None},
            )


class Draws:
    """Columns of a designed sample, one prior after the other.

    The points of a scrambled Sobol sequence fill the unit cube evenly, so that few of them give the
    moments of the result (Sobol 1967; Owen 1998).
    """

    def __init__(self, dimensions: int) -> None:
        """The sample of so many priors."""
        points = Sobol(dimensions, rng=np.random.default_rng(SEED)).random(SAMPLES)
        self._columns = iter(points.T)

    def uniform(self, limits: tuple[float, float]) -> Array:
        """A rectangular prior."""
        return limits[0] + (limits[1] - limits[0]) * next(self._columns)

    def log_uniform(self, limits: tuple[float, float]) -> Array:
        """A prior that is rectangular on a scale of logarithms."""
        return np.exp(self.uniform((float(np.log(limits[0])), float(np.log(limits[1])))))

    def normal(self, sd: float) -> Array:
        """A normal prior of mean zero."""
        return np.asarray(sd * norm.ppf(next(self._columns)))


DIMENSIONS = 23  # of a sample: the priors below


@dataclass(frozen=True)
class DrawnSensors:
    """Sensors that a description may mean, in their medium.

    Attributes
    ----------
    responses
        Their responses to a step of the medium.
    h_W_m2K
        Coefficient (B,) at their surfaces [W/m2K].
    surface_m
        Diameter (B,) of the surface in the medium [m].
    """

    responses: Responses
    h_W_m2K: Array
    surface_m: Array


def drawn_sensors(
    diameter_mm: float,
    junction: JunctionWord,
    surroundings: Surroundings,
    speed_u_m_s: float,
    well: Well | None = None,
) -> DrawnSensors:
    """Sensors that a description may mean.

    Parameters
    ----------
    diameter_mm
        Diameter of the sheath [mm].
    junction
        Place of the junction.
    surroundings
        The medium.
    speed_u_m_s
        Standard uncertainty of its speed [m/s].
    well
        A well around the sensor, or None.

    Examples
    --------
    >>> drawn = drawn_sensors(3.0, "insulated", Surroundings("water", 0.4), 0.03)
    >>> len(drawn.responses.lags_s)
    512
    """
    draws = Draws(DIMENSIONS)
    tolerance_mm = max(TOLERANCE_MM, TOLERANCE_REL * diameter_mm)
    diameter_m = 1e-3 * (diameter_mm + draws.uniform((-tolerance_mm, tolerance_mm)))
    wire_m = diameter_m * draws.uniform(WIRE)
    heat = 1 + HEAT_PER_K * (surroundings.T_degC - 25.0)
    powder_W_mK = WELDED_W_MK if junction == "grounded" else POWDER_W_MK
    layers = _sheathed(draws, diameter_m, wire_m, heat, surroundings.T_degC, powder_W_mK)
    core_share = draws.uniform(GROUNDED_CORE) if junction == "grounded" else draws.uniform((1, 1))
    bead_m = wire_m * draws.uniform(BEAD_WIRES)
    bead_shape = draws.uniform(BEAD_SHAPE)
    bore_m = diameter_m * draws.uniform(BORE)
    eccentricity = draws.uniform(ECCENTRICITY)
    filling = "air" if well is None else well.filling
    air_W_mK = float(AIR.k(np.asarray(surroundings.T_degC)))
    filling_W_mK = draws.uniform(FILLING_W_MK.get(filling, (air_W_mK, air_W_mK)))
    priors = FilmPriors(
        DIFFERENCE_K[0] * np.exp(draws.normal(DIFFERENCE_K[1])),
        np.exp(draws.normal(surroundings.viscosity_u)),
        draws.uniform(EMISSIVITY),
    )
    correlation = np.exp(draws.normal(U_REL))
    model = np.exp(draws.normal(MODEL_U_REL))
    speed_m_s = np.abs(surroundings.speed_m_s + draws.normal(speed_u_m_s))
    surface_m = diameter_m
    if junction == "exposed":
        surface_m = bead_m
        core_J_m3K = layers[0].heat_J_m3K * bead_shape
        layers = [Layer(0.5 * bead_m, layers[0].k_W_mK, core_J_m3K, ELEMENTS[0])]
    elif well is not None:
        if well.bore_mm is not None:
            bore_m = np.maximum(1e-3 * well.bore_mm, 1.001 * diameter_m)
        surface_m = np.full(SAMPLES, 1e-3 * well.outer_mm)
        gap = eccentric_m2K_W(0.5 * diameter_m, 0.5 * bore_m, eccentricity, filling_W_mK)
        sheath = layers[-1]
        layers[-1] = replace(sheath, contact_m2K_W=gap)
        wall = replace(sheath, outer_m=0.5 * surface_m, elements=ELEMENTS[3], inner_m=0.5 * bore_m)
        layers.append(wall)
    h_W_m2K = correlation * surroundings.h_W_m2K(surface_m, speed_m_s, priors)
    responses = layered_responses(layers, h_W_m2K, core_share)
    of_model = replace(
        responses, taus_s=responses.taus_s * model[:, None], film_s=responses.film_s * model
    )
    return DrawnSensors(of_model, h_W_m2K, surface_m)


def _sheathed(
    draws: Draws,
    diameter_m: Array,
    wire_m: Array,
    heat: float,
    T_degC: float,
    powder_W_mK: tuple[float, float],
) -> list[Layer]:
    """Core, powder and sheath."""
    radius_m = 0.5 * diameter_m
    core = Layer(
        0.5 * wire_m * draws.uniform(CORE_WIRES),
        draws.uniform(CORE_W_MK),
        heat * draws.uniform(CORE_J_M3K),
        ELEMENTS[0],
    )
    powder = Layer(
        radius_m * (1 - 2 * draws.uniform(WALL)),
        draws.log_uniform(powder_W_mK),
        heat * draws.uniform(POWDER_J_M3K),
        ELEMENTS[1],
        diameter_m * draws.uniform(GAP) / float(AIR.k(np.asarray(T_degC))),
    )
    sheath = Layer(
        radius_m, draws.uniform(SHEATH_W_MK), heat * draws.uniform(SHEATH_J_M3K), ELEMENTS[2]
    )
    return [core, powder, sheath]


def eccentric_m2K_W(inner_m: Array, bore_m: Array, eccentricity: Array, k_W_mK: Array) -> Array:
    """Resistance of the gap between two cylinders whose axes differ, per area of the inner one.

    Parameters
    ----------
    inner_m, bore_m
        Radii [m].
    eccentricity
        Distance of the axes over the clearance, 0 to below 1.
    k_W_mK
        Conductivity of the filling [W/mK].

    Notes
    -----
    R = r arcosh((r1^2 + r2^2 - z^2) / (2 r1 r2)) / k with the distance z (Incropera, table 4.1).

    Examples
    --------
    >>> one = np.ones(1)  # centred: r ln(r2/r1)/k
    >>> eccentric_m2K_W(3e-3 * one, 3.5e-3 * one, 0 * one, 0.026 * one).round(5)
    array([0.01779])
    """
    distance = eccentricity * (bore_m - inner_m)
    ratio = (inner_m**2 + bore_m**2 - distance**2) / (2 * inner_m * bore_m)
    return np.asarray(inner_m * np.arccosh(ratio) / k_W_mK)
