"""Two crowned disks in contact: Hertz's ellipse, their speeds, and the press fit that holds each on its shaft."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from calibration.errors import InputError

YOUNG_Pa = 207e9
POISSON = 0.3


@dataclass(frozen=True)
class HertzContact:
    """Semi-axes of the contact ellipse [m] and its greatest pressure [Pa].

    ``minor_m`` (a) lies along rolling, ``major_m`` (b) across the running track: the half width of the heat flux.
    """

    minor_m: float
    major_m: float
    pressure_Pa: float

    @property
    def yield_depth_m(self) -> float:
        """Depth of the greatest shear stress, z = a (0.7929 - 0.3207 a/b) [m] (5.1)."""
        return self.minor_m * (0.7929 - 0.3207 * self.minor_m / self.major_m)


def hertz_contact(
    load_N: float,
    radius_m: float = 0.0381,
    crown_radius_m: float = 0.3048,
    young_Pa: float = YOUNG_Pa,
    poisson: float = POISSON,
) -> HertzContact:
    """Contact of two equal crowned disks under ``load_N``.

    With E* = E / (2 (1 - nu^2)), relative curvatures 1/R + 1/R (rolling) and 1/R_c + 1/R_c (axial),
    e^2 = 1 - (a/b)^2 and complete elliptic integrals K, E of e::

        R_c / R = ((b/a)^2 E - K) / (K - E)
        1 / R_c = (p0 / E*) (a / (b^2 e^2)) (K - E),   p0 = 3 W / (2 pi a b)

    Valid for crown radius > rolling radius, elastic contact. Raises InputError for a load that is not positive.
    Source: Johnson, Contact Mechanics (1985), eqs. 4.26; table 6.1 gives the pressures, table 3.4 the half widths.

    >>> c = hertz_contact(2320.0)
    >>> round(c.minor_m * 1e3, 2), round(c.major_m * 1e3, 2), round(c.pressure_Pa / 1e9, 1)
    (0.45, 1.76, 1.4)
    """
    if not load_N > 0:
        raise InputError(f"hertz_contact: load_N must be positive; got {load_N} N")
    if not crown_radius_m > radius_m > 0:
        raise InputError("hertz_contact: needs crown_radius_m > radius_m > 0")
    ratio = _axis_ratio(crown_radius_m / radius_m)
    m = 1.0 - ratio**-2
    modulus = young_Pa / (2.0 * (1.0 - poisson**2))
    # p0 put into the second equation: b^3 = 3 W R_c (K - E) / (2 pi E* e^2)
    major = (1.5 * load_N * crown_radius_m * (ellipk(m) - ellipe(m)) / (np.pi * modulus * m)) ** (1 / 3)
    minor = major / ratio
    return HertzContact(float(minor), float(major), float(1.5 * load_N / (np.pi * minor * major)))


def equal_radius_m(one_m: float, other_m: float) -> float:
    """Radius of two equal disks whose relative curvature is that of two unequal ones, 2 / (1/R1 + 1/R2) [m].

    >>> round(equal_radius_m(0.03, 0.06), 3)
    0.04
    """
    return 2.0 / (1.0 / one_m + 1.0 / other_m)


def half_width_m(load_N: float, radius_m: float = 0.0381, crown_radius_m: float = 0.3048) -> float:
    """Half width b of the running track [m], the major semi-axis of the contact.

    >>> [round(half_width_m(load) * 1e3, 2) for load in (850, 1460, 1850, 2320)]  # table 3.4: 1.25 1.50 1.62 1.75
    [1.26, 1.5, 1.63, 1.76]
    """
    return hertz_contact(load_N, radius_m, crown_radius_m).major_m


def _axis_ratio(curvature_ratio: float) -> float:
    """b/a for a ratio of relative curvatures above one."""

    def excess(log_ratio: float) -> float:
        squared = np.exp(2 * log_ratio)
        m = 1 - 1 / squared
        return float((squared * ellipe(m) - ellipk(m)) / (ellipk(m) - ellipe(m)) - curvature_ratio)

    return float(np.exp(brentq(excess, 0.3 * np.log(curvature_ratio), np.log(curvature_ratio) + 1.0, xtol=1e-13)))


def surface_speed_m_s(speed_rpm: float, radius_m: float = 0.0381) -> float:
    """Speed of the running surface, u = 2 pi n R / 60 [m/s]."""
    return 2.0 * np.pi * speed_rpm / 60.0 * radius_m


def sliding_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Sliding speed u_s = u_fast - u_slow [m/s] (table 6.1).

    >>> round(sliding_speed_m_s(6555, 1546), 1)
    20.0
    """
    return surface_speed_m_s(fast_rpm, radius_m) - surface_speed_m_s(slow_rpm, radius_m)


def entraining_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Entraining (mean) speed u_m = (u_fast + u_slow) / 2 [m/s] (table 6.1).

    >>> round(entraining_speed_m_s(3282, 774), 2)
    8.09
    """
    return 0.5 * (surface_speed_m_s(fast_rpm, radius_m) + surface_speed_m_s(slow_rpm, radius_m))


def interference_pressure_Pa(
    radial_interference_m: float,
    fit_radius_m: float = 0.0205,
    outer_radius_m: float = 0.0381,
    inner_radius_m: float = 0.0,
    young_Pa: float = YOUNG_Pa,
) -> float:
    """Pressure of a press fit of equal materials [Pa] (6.1).

    ``P = (E delta / R) (r_o^2 - R^2) (R^2 - r_i^2) / (2 R^2 (r_o^2 - r_i^2))``

    >>> [round(interference_pressure_Pa(d / 2) / 1e6, 1) for d in (15.2e-6, 25.4e-6)]  # section 6.4.3: 27.3, 45.6
    [27.3, 45.6]
    """
    square, outer, inner = fit_radius_m**2, outer_radius_m**2, inner_radius_m**2
    shape = (outer - square) * (square - inner) / (2 * square * (outer - inner))
    return young_Pa * radial_interference_m / fit_radius_m * shape


def contact_conductance_W_m2K(
    pressure_Pa: float, hardness_Pa: float, roughness_m: float, slope: float, conductivity_W_mK: float
) -> float:
    """Conductance of a pressed joint, h = 0.170 (P/H)^0.693 m k / sigma [W/m2K] (6.2).

    ``hardness_Pa`` is the micro-hardness H, ``roughness_m`` the standard deviation sigma of the roughness,
    ``slope`` the asperity slope m [-]. Source: Leung et al. (1998) as quoted by the thesis; measured in vacuum.

    >>> low, high = (contact_conductance_W_m2K(p, 2.7e9, 1e-6, 0.1, 16) for p in (1e6, 45.6e6))
    >>> round(high / low, 1)  # table 6.6: about 14
    14.1
    """
    return 0.170 * (pressure_Pa / hardness_Pa) ** 0.693 * slope * conductivity_W_mK / roughness_m
