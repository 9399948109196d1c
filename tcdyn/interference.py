"""The disk's press fit on its shaft: contact pressure (6.1) and the thermal conductance it makes (6.2)."""

from __future__ import annotations

from tcdyn.contact import YOUNG_Pa


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
