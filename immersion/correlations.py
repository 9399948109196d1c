"""Natural-convection correlations of a plunged disk: Nusselt number, range, h.

Used by :mod:`immersion.plunge_model`, by the design of plunges and by ``tcdyn verify``. All
correlations have one algebraic form, and :class:`Correlation` holds its constants. Sources: Holman
(2010) as quoted by the thesis (section 5.7), Churchill and Chu (1975). Tests:
``tests/immersion/test_immersion_correlations.py``, also against the package ``ht``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from immersion.fluids import Curve, Fluid, FluidProperties
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning

# Standard acceleration of gravity (CGPM 1901).
GRAVITY_M_S2 = 9.80665
# Share of the largest temperature difference above which the validity of a correlation is tested;
# chosen by judgement.
MIN_DIFFERENCE_SHARE = 0.1
PLATE_FACTOR = 35.0  # D/L >= 35/Gr^0.25: Holman (2010), section 5.7 of the thesis


@dataclass(frozen=True)
class Correlation:
    """Mean Nusselt number of natural convection, with characteristic length, range and source.

    Attributes
    ----------
    name
        Key in ``CORRELATIONS``.
    title
        Equation number of the thesis, or a short name; for messages.
    length
        Characteristic length: width or diameter of the disk.
    ra_range
        Range of the Rayleigh number for which the source states it.
    source
        Reference, for reports.
    factor, exponent, floor, prandtl, inner, outer, power
        Constants of the equation below.

    Notes
    -----
    Nu = {floor + factor Ra^exponent / [1 + (prandtl/Pr)^inner]^outer}^power

    With ``prandtl = 0``, Pr enters through Ra only. Every correlation here has this form.

    To add a correlation, add an entry to ``CORRELATIONS``. A changed constant changes h, and with
    it the plunge fits; the scale of h is free there, so lags change little.
    """

    name: str
    title: str
    length: Literal["width", "diameter"]
    ra_range: tuple[float, float]
    source: str
    factor: float
    exponent: float
    floor: float = 0.0
    prandtl: float = 0.0
    inner: float = 1.0
    outer: float = 1.0
    power: float = 1.0

    def nusselt(self, ra: ArrayLike, pr: ArrayLike) -> Array:
        """Nusselt number for Rayleigh and Prandtl numbers (arrays of one shape).

        Parameters
        ----------
        ra, pr
            Rayleigh and Prandtl numbers, arrays of one shape.

        Returns
        -------
        nu
            Mean Nusselt number, of the same shape.

        Examples
        --------
        >>> [round(float(c.nusselt(1e6, 60.0)), 1) for c in CORRELATIONS.values()]
        [18.7, 21.3, 21.3, 21.4, 19.3]
        """
        ra = np.asarray(ra, dtype=float)
        pr = np.asarray(pr, dtype=float)
        shape = (1 + (self.prandtl / pr) ** self.inner) ** self.outer
        return (self.floor + self.factor * ra**self.exponent / shape) ** self.power


# Sources, as reports state them.
_HOLMAN = "Holman (2010), quoted by Al-Hamood (2015) section 5.7"
_PLATE = "Churchill and Chu (1975) eq. 9"
_CYLINDER = "Churchill and Chu (1975), horizontal cylinder; a long cylinder is assumed"
CORRELATIONS: dict[str, Correlation] = {
    c.name: c
    for c in (
        # vertical plate or cylinder: 0.59 Ra^0.25
        Correlation("mcadams", "(5.2)", "width", (1e4, 1e9), _HOLMAN, 0.59, 1 / 4),
        # vertical plate, integral solution (thesis 5.3 times 4/3): 0.508 Pr^0.5 (0.952 + Pr)^-0.25
        # Gr^0.25, Gr = Ra/Pr
        Correlation(
            "similarity",
            "(5.3)",
            "width",
            (1e4, 1e9),
            _HOLMAN,
            4 / 3 * 0.508,
            1 / 4,
            prandtl=0.952,
            outer=1 / 4,
        ),
        # vertical plate, laminar: 0.68 + 0.670 Ra^0.25 / [1 + (0.492/Pr)^(9/16)]^(4/9)
        Correlation(
            "churchill-chu-laminar",
            "(5.4)",
            "width",
            (1e-1, 1e9),
            _HOLMAN,
            0.670,
            1 / 4,
            floor=0.68,
            prandtl=0.492,
            inner=9 / 16,
            outer=4 / 9,
        ),
        # vertical plate, any Ra: {0.825 + 0.387 Ra^(1/6) / [1 + (0.492/Pr)^(9/16)]^(8/27)}^2
        Correlation(
            "churchill-chu",
            "all Ra",
            "width",
            (1e-1, 1e12),
            _PLATE,
            0.387,
            1 / 6,
            floor=0.825,
            prandtl=0.492,
            inner=9 / 16,
            outer=8 / 27,
            power=2,
        ),
        # long horizontal cylinder, Ra on its diameter: {0.60 + 0.387 Ra^(1/6) / [1 +
        # (0.559/Pr)^(9/16)]^(8/27)}^2
        Correlation(
            "horizontal-cylinder",
            "horizontal",
            "diameter",
            (1e-5, 1e12),
            _CYLINDER,
            0.387,
            1 / 6,
            floor=0.60,
            prandtl=0.559,
            inner=9 / 16,
            outer=8 / 27,
            power=2,
        ),
    )
}
# The correlations that the thesis compares, (5.2) to (5.4).
THESIS_THREE = ("mcadams", "similarity", "churchill-chu-laminar")
# Equation numbers of the thesis as names.
_ALIASES = {"5.2": "mcadams", "5.3": "similarity", "5.4": "churchill-chu-laminar"}


def correlation(name: str | Correlation) -> Correlation:
    """A correlation by name, or by its equation number in the thesis ("5.2", "5.3", "5.4").

    Parameters
    ----------
    name
        Name, equation number, or a correlation, which is returned unchanged.

    Raises
    ------
    InputError
        For an unknown name.
    """
    if isinstance(name, Correlation):
        return name
    key = _ALIASES.get(name.strip("()"), name)
    if key not in CORRELATIONS:
        raise InputError(f"unknown correlation {name!r}", expected=", ".join(CORRELATIONS))
    return CORRELATIONS[key]


@dataclass(frozen=True)
class Bath:
    """A disk's running surface in a fluid: everything that h needs besides the two temperatures.

    Attributes
    ----------
    fluid, correlation
        Fluid of the bath, and correlation of natural convection.
    width_m, diameter_m
        Width and outer diameter of the disk [m].
    """

    fluid: Fluid
    correlation: Correlation
    width_m: float
    diameter_m: float

    def film_properties(
        self, surface_degC: ArrayLike, fluid_degC: ArrayLike
    ) -> tuple[FluidProperties, float, Array]:
        """Fluid properties at the film temperature, characteristic length [m], and Grashof number.

        Parameters
        ----------
        surface_degC, fluid_degC
            Temperatures of the running surface and of the bath [degC]; shapes that broadcast.

        Returns
        -------
        properties
            At the film temperature, the mean of both.
        length_m
            Characteristic length of the correlation.
        grashof
            Grashof number.

        Notes
        -----
        Gr = g beta |dT| L^3 / nu^2; Ra = Gr Pr.

        :meth:`h_W_m2K` and :func:`check_validity` both use this, so the range is checked for the
        numbers that enter h.
        """
        surface = np.asarray(surface_degC, dtype=float)
        fluid = np.asarray(fluid_degC, dtype=float)
        p = self.fluid.at((surface + fluid) / 2)
        length = self.width_m if self.correlation.length == "width" else self.diameter_m
        buoyancy = GRAVITY_M_S2 * np.abs(p.beta_1_K) * np.abs(fluid - surface)
        return p, length, buoyancy * length**3 / p.nu_m2_s**2

    def h_W_m2K(self, surface_degC: ArrayLike, fluid_degC: ArrayLike) -> Array:
        """Mean heat transfer coefficient h = Nu k / L [W/m2K], properties at the film temperature.

        Parameters
        ----------
        surface_degC, fluid_degC
            Temperatures of the running surface and of the bath [degC]; shapes that broadcast.

        Returns
        -------
        h
            [W/m2K]; zero where the temperatures are equal, except for the ``floor`` of a
            correlation.
        """
        p, length, gr = self.film_properties(surface_degC, fluid_degC)
        return self.correlation.nusselt(gr * p.prandtl, p.prandtl) * p.k_W_mK / length

    def property_u_rel(self, surface_degC: float, fluid_degC: float) -> dict[str, float]:
        """Relative standard uncertainty of h from each fluid property, and their "total".

        Parameters
        ----------
        surface_degC, fluid_degC
            Temperatures of the running surface and of the bath [degC].

        Returns
        -------
        u_rel
            By property (rho, c, k, nu, beta), and "total", the root sum of squares [1].

        Notes
        -----
        Each property is raised by its own standard uncertainty at the film temperature, and h is
        computed again. For the expansion coefficient the density curve is tilted about that
        temperature.

        The properties are taken as independent. :func:`immersion.plunge_fit.full_prior` adds
        "total" to the prior of the scale of h. Test:
        ``tests/immersion/test_immersion_correlations.py``.
        """
        f = self.fluid
        film = np.asarray((surface_degC + fluid_degC) / 2)
        perturbed = {
            "rho": replace(f, rho=_scale_differences(f.rho, 0.0, f.u_rho)),
            "c": replace(f, c=_scale_differences(f.c, 0.0, f.u_c)),
            "k": replace(f, k=_scale_differences(f.k, 0.0, f.u_k)),
            "nu": replace(f, nu=_scale_differences(f.nu, 0.0, f.u_nu)),
            "beta": replace(f, rho=_scale_differences(f.rho, float(f.rho(film)), f.u_beta)),
        }
        base = float(self.h_W_m2K(surface_degC, fluid_degC))
        components = {}
        for name, fluid in perturbed.items():
            h = float(replace(self, fluid=fluid).h_W_m2K(surface_degC, fluid_degC))
            components[name] = abs(h / base - 1)
        return {**components, "total": float(np.hypot.reduce([*components.values()]))}


def check_validity(
    bath: Bath, surface_degC: ArrayLike, fluid_degC: ArrayLike
) -> tuple[Finding, ...]:
    """Warnings where a plunge leaves the range of Ra, of the fluid data, or of a plate.

    Parameters
    ----------
    bath
        Bath with its correlation.
    surface_degC, fluid_degC
        Temperatures of running surface and bath [degC]; shapes that broadcast.

    Returns
    -------
    findings
        At most one for the range of Ra, those of the fluid, and one for the plate.

    Notes
    -----
    A disk can be taken as a plate where D/L >= 35/Gr^0.25. The test uses the times with a
    difference above a tenth of its largest value: as the disk approaches the bath temperature, Gr
    goes to zero and no disk would pass. Source: Holman (2010), section 5.7 of the thesis.

    ``MIN_DIFFERENCE_SHARE`` may be changed: it decides warnings only, no result. Test:
    ``tests/immersion/test_immersion_correlations.py``.
    """
    surface, bulk = np.broadcast_arrays(
        np.asarray(surface_degC, float), np.asarray(fluid_degC, float)
    )
    difference = np.abs(bulk - surface)
    if np.max(difference) > 0:
        tested = difference >= MIN_DIFFERENCE_SHARE * float(np.max(difference))
        surface = surface[tested]
        bulk = bulk[tested]
    c = bath.correlation
    p, _, gr = bath.film_properties(surface, bulk)
    findings = []
    low = float(np.min(gr * p.prandtl))
    high = float(np.max(gr * p.prandtl))
    if low < c.ra_range[0] or high > c.ra_range[1]:
        out_of_range = warning(
            "correlation.range",
            subject=c.name,
            title=c.title,
            holds=c.ra_range,
            ran=(low, high),
        )
        findings.append(out_of_range)
    film = (surface + bulk) / 2
    findings += bath.fluid.check_range(float(np.min(film)), float(np.max(film)))
    ratio = bath.diameter_m / bath.width_m
    least = float(PLATE_FACTOR / np.min(gr) ** 0.25)
    if c.length == "width" and ratio < least:
        findings.append(warning("correlation.no_plate", subject=c.name, ratio=ratio, least=least))
    return tuple(findings)


def _scale_differences(curve: Curve, centre: float, u: float) -> Curve:
    """The curve with its differences from the value ``centre`` multiplied by 1 + ``u``.

    Parameters
    ----------
    curve
        Property as a function of temperature.
    centre
        Value that stays unchanged; 0 scales the whole curve.
    u
        Relative change.
    """
    return lambda T: centre + (curve(T) - centre) * (1 + u)
