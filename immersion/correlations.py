"""Natural-convection correlations for a plunged disk: Nusselt number, range of validity, heat transfer coefficient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calibration import Array
from calibration.errors import InputError
from calibration.finding import Finding, look
from immersion.fluids import Fluid, FluidProperties

GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Correlation:
    """A mean Nusselt number Nu(Ra, Pr), its characteristic length, range and source."""

    name: str
    title: str
    nusselt: Callable[[Array, Array], Array]
    length: Literal["width", "diameter"]
    ra_range: tuple[float, float]
    source: str


def nu_mcadams(ra: ArrayLike, pr: ArrayLike) -> Array:
    """Mean Nusselt number of a vertical plate or cylinder: Nu = 0.59 Ra^0.25 (thesis 5.2); 1e4 < Ra < 1e9.

    >>> round(float(nu_mcadams(1e6, 60.0)), 2)
    18.66
    """
    del pr  # hidden in Ra
    return np.asarray(0.59 * np.asarray(ra, dtype=float) ** 0.25)


def nu_similarity(ra: ArrayLike, pr: ArrayLike) -> Array:
    """Mean Nusselt number of a vertical plate, integral solution (thesis 5.3 times 4/3); laminar, Ra < 1e9.

    Nu = (4/3) 0.508 Pr^0.5 (0.952 + Pr)^-0.25 Gr^0.25, Gr = Ra/Pr.

    >>> round(float(nu_similarity(1e6, 60.0)), 2)
    21.34
    """
    ra, pr = np.asarray(ra, dtype=float), np.asarray(pr, dtype=float)
    return np.asarray(4 / 3 * 0.508 * (pr / (0.952 + pr)) ** 0.25 * ra**0.25)


def nu_churchill_chu_laminar(ra: ArrayLike, pr: ArrayLike) -> Array:
    """Mean Nusselt number of a vertical plate, Churchill and Chu, laminar (thesis 5.4); Ra < 1e9, any Pr.

    Nu = 0.68 + 0.670 Ra^0.25 / [1 + (0.492/Pr)^(9/16)]^(4/9)

    >>> round(float(nu_churchill_chu_laminar(1e6, 60.0)), 2)
    21.26
    """
    ra, pr = np.asarray(ra, dtype=float), np.asarray(pr, dtype=float)
    return np.asarray(0.68 + 0.670 * ra**0.25 / (1 + (0.492 / pr) ** (9 / 16)) ** (4 / 9))


def nu_churchill_chu(ra: ArrayLike, pr: ArrayLike) -> Array:
    """Mean Nusselt number of a vertical plate at any Ra up to 1e12, Churchill and Chu (1975).

    Nu = {0.825 + 0.387 Ra^(1/6) / [1 + (0.492/Pr)^(9/16)]^(8/27)}^2

    >>> round(float(nu_churchill_chu(1e6, 60.0)), 1)
    21.4
    """
    ra, pr = np.asarray(ra, dtype=float), np.asarray(pr, dtype=float)
    return np.asarray((0.825 + 0.387 * ra ** (1 / 6) / (1 + (0.492 / pr) ** (9 / 16)) ** (8 / 27)) ** 2)


def nu_horizontal_cylinder(ra: ArrayLike, pr: ArrayLike) -> Array:
    """Mean Nusselt number of a long horizontal cylinder, Ra on its diameter, Churchill and Chu (1975).

    Nu = {0.60 + 0.387 Ra_D^(1/6) / [1 + (0.559/Pr)^(9/16)]^(8/27)}^2; 1e-5 < Ra_D < 1e12.

    >>> round(float(nu_horizontal_cylinder(1e6, 60.0)), 1)
    19.3
    """
    ra, pr = np.asarray(ra, dtype=float), np.asarray(pr, dtype=float)
    return np.asarray((0.60 + 0.387 * ra ** (1 / 6) / (1 + (0.559 / pr) ** (9 / 16)) ** (8 / 27)) ** 2)


_HOLMAN = "Holman (2010), quoted by Al-Hamood (2015) section 5.7"
CORRELATIONS: dict[str, Correlation] = {
    c.name: c
    for c in (
        Correlation("mcadams", "(5.2)", nu_mcadams, "width", (1e4, 1e9), _HOLMAN),
        Correlation("similarity", "(5.3)", nu_similarity, "width", (1e4, 1e9), _HOLMAN),
        Correlation("churchill-chu-laminar", "(5.4)", nu_churchill_chu_laminar, "width", (1e-1, 1e9), _HOLMAN),
        Correlation(
            "churchill-chu",
            "all Ra",
            nu_churchill_chu,
            "width",
            (1e-1, 1e12),
            "Churchill and Chu (1975) eq. 9",
        ),
        Correlation(
            "horizontal-cylinder",
            "horizontal",
            nu_horizontal_cylinder,
            "diameter",
            (1e-5, 1e12),
            "Churchill and Chu (1975), horizontal cylinder; a long cylinder is assumed",
        ),
    )
}
THESIS_THREE = ("mcadams", "similarity", "churchill-chu-laminar")
_ALIASES = {"5.2": "mcadams", "5.3": "similarity", "5.4": "churchill-chu-laminar"}


def correlation(name: str | Correlation) -> Correlation:
    """A correlation by name, or by its equation number in the thesis ("5.2", "5.3", "5.4")."""
    if isinstance(name, Correlation):
        return name
    key = _ALIASES.get(name.strip("()"), name)
    if key not in CORRELATIONS:
        raise InputError(f"unknown correlation {name!r}", expected=", ".join(CORRELATIONS))
    return CORRELATIONS[key]


@dataclass(frozen=True)
class Bath:
    """A disk's running surface in a fluid: what is needed to turn two temperatures into a heat flux."""

    fluid: Fluid
    correlation: Correlation
    width_m: float
    diameter_m: float

    @property
    def length_m(self) -> float:
        """Characteristic length of the correlation [m]."""
        return self.width_m if self.correlation.length == "width" else self.diameter_m

    def properties(self, surface_degC: ArrayLike, fluid_degC: ArrayLike) -> FluidProperties:
        """Fluid properties at the film temperature, the mean of surface and fluid."""
        return self.fluid.at((np.asarray(surface_degC, dtype=float) + np.asarray(fluid_degC, dtype=float)) / 2)

    def _film(self, surface_degC: ArrayLike, fluid_degC: ArrayLike) -> tuple[FluidProperties, Array]:
        p = self.properties(surface_degC, fluid_degC)
        step = np.abs(np.asarray(fluid_degC, dtype=float) - surface_degC)
        return p, np.asarray(GRAVITY_M_S2 * np.abs(p.beta_1_K) * step * self.length_m**3 / p.nu_m2_s**2)

    def grashof(self, surface_degC: ArrayLike, fluid_degC: ArrayLike) -> Array:
        """Gr = g beta |dT| L^3 / nu^2 at the film temperature."""
        return self._film(surface_degC, fluid_degC)[1]

    def rayleigh(self, surface_degC: ArrayLike, fluid_degC: ArrayLike) -> Array:
        """Ra = Gr Pr."""
        p, gr = self._film(surface_degC, fluid_degC)
        return np.asarray(gr * p.prandtl)

    def h_W_m2K(self, surface_degC: ArrayLike, fluid_degC: ArrayLike) -> Array:
        """Mean heat transfer coefficient h = Nu k / L [W/m2K], properties at the film temperature."""
        p, gr = self._film(surface_degC, fluid_degC)
        pr = p.prandtl
        return np.asarray(self.correlation.nusselt(np.asarray(gr * pr), pr) * p.k_W_mK / self.length_m)

    def property_u_rel(self, surface_degC: float, fluid_degC: float) -> dict[str, float]:
        """Relative standard uncertainty of h from each fluid property, and their root sum of squares ("total").

        Each property is raised by its own standard uncertainty at the film temperature and h computed again.
        """
        base = float(self.h_W_m2K(surface_degC, fluid_degC))
        f, parts = self.fluid, {}
        scaled = {
            "rho": replace(f, rho=_scaled(f.rho, f.u_rho)),
            "c": replace(f, c=_scaled(f.c, f.u_c)),
            "k": replace(f, k=_scaled(f.k, f.u_k)),
            "nu": replace(f, nu=_scaled(f.nu, f.u_nu)),
        }
        for name, other in scaled.items():
            parts[name] = abs(float(replace(self, fluid=other).h_W_m2K(surface_degC, fluid_degC)) / base - 1)
        film = (surface_degC + fluid_degC) / 2
        steeper = replace(f, rho=_tilted(f.rho, film, f.u_beta))
        parts["beta"] = abs(float(replace(self, fluid=steeper).h_W_m2K(surface_degC, fluid_degC)) / base - 1)
        parts["total"] = float(np.sqrt(sum(v**2 for v in parts.values())))
        return parts


def check_validity(bath: Bath, surface_degC: ArrayLike, fluid_degC: ArrayLike) -> tuple[Finding, ...]:
    """What leaves its range over the temperatures of one plunge: Ra, the fluid's data, the disk taken as a plate.

    A disk passes for a plate where D/L >= 35/Gr^0.25. The test is made while the difference is above a tenth of its
    largest value: as the disk reaches the bath Gr falls to nothing and no disk passes. Source: Holman (2010),
    section 5.7 of the thesis.
    """
    surface, bulk = np.broadcast_arrays(np.asarray(surface_degC, float), np.asarray(fluid_degC, float))
    step = np.abs(bulk - surface)
    matters = step >= 0.1 * float(np.max(step)) if np.max(step) > 0 else np.ones(step.shape, dtype=bool)
    surface, bulk = surface[matters], bulk[matters]
    c, ra, found = bath.correlation, bath.rayleigh(surface, bulk), []
    low, high = float(np.min(ra)), float(np.max(ra))
    if low < c.ra_range[0] or high > c.ra_range[1]:
        found.append(look("correlation.range", subject=c.name, title=c.title, holds=c.ra_range, ran=(low, high)))
    film = (surface + bulk) / 2
    found += bath.fluid.outside(float(np.min(film)), float(np.max(film)))
    gr = replace(bath, correlation=CORRELATIONS["mcadams"]).grashof(surface, bulk)  # on the plate's length
    ratio, least = bath.diameter_m / bath.width_m, float(35 / np.min(gr) ** 0.25)
    if ratio < least and c.length == "width":
        found.append(look("correlation.no_plate", subject=c.name, ratio=ratio, least=least))
    return tuple(found)


def _scaled(curve: Callable[[Array], Array], u: float) -> Callable[[Array], Array]:
    return lambda T: np.asarray(curve(T) * (1 + u))


def _tilted(curve: Callable[[Array], Array], centre: float, u: float) -> Callable[[Array], Array]:
    at = float(curve(np.asarray(centre, dtype=float)))
    return lambda T: np.asarray(at + (curve(T) - at) * (1 + u))
