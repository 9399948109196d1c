"""Heat that the oil film carries out of the contact (appendix B of the thesis).

The fits share all frictional heat between the disks. This function says how much of it leaves with
the oil; ``tcdyn.workflows.beta_tables`` has it as a line of the budget, ``tcdyn verify`` compares
it with the thesis. Guarded by ``tests/partition/test_film_heat.py``.
"""

from __future__ import annotations

import numpy as np

from immersion.fluids import FluidProperties
from tcdyn.rig.contact import POISSON, YOUNG_Pa, hertz_contact

# Mean rise of the oil in crossing the contact [K], assumed; with it the 16 tests of the thesis give
# ratios of the range that it states (``tcdyn verify``).
RISE_K = 20.0
# Pressure coefficient of the viscosity of Mobil Jet Oil II [1/Pa]. It is assumed, without a source:
# ``immersion.fluids`` has no such property. The thickness grows with its power 0.53.
PRESSURE_COEFFICIENT_PER_Pa = 1.1e-8


def film_thickness_m(
    load_N: float,
    entraining_speed_m_s: float,
    viscosity_Pa_s: float,
    radius_m: float = 0.0381,
    crown_radius_m: float = 0.3048,
    pressure_coefficient_per_Pa: float = PRESSURE_COEFFICIENT_PER_Pa,
) -> float:
    """Central thickness of the oil film of two equal crowned disks [m].

    Parameters
    ----------
    load_N
        Normal load.
    entraining_speed_m_s
        Mean speed of the two surfaces.
    viscosity_Pa_s
        Dynamic viscosity of the oil at the inlet.
    radius_m, crown_radius_m
        Radius of rolling, and of the crown across the running surface. The defaults are those of
        the disks of the thesis.
    pressure_coefficient_per_Pa
        Pressure coefficient of the viscosity; the default is assumed.

    Returns
    -------
    thickness_m
        Thickness [m].

    Notes
    -----
    H/R = 2.69 U^0.67 G^0.53 W^-0.067 (1 - 0.61 exp(-0.73 k)) with k = b/a, R half of ``radius_m``
    (Hamrock and Dowson 1977).
    """
    contact = hertz_contact(load_N, radius_m, crown_radius_m)
    radius = 0.5 * radius_m
    modulus_Pa = YOUNG_Pa / (1.0 - POISSON**2)
    speed = viscosity_Pa_s * entraining_speed_m_s / (modulus_Pa * radius)
    material = pressure_coefficient_per_Pa * modulus_Pa
    load = load_N / (modulus_Pa * radius**2)
    side_flow = 1.0 - 0.61 * np.exp(-0.73 * contact.major_m / contact.minor_m)
    return float(2.69 * speed**0.67 * material**0.53 * load**-0.067 * side_flow * radius)


def film_heat_share(
    load_N: float,
    friction_N: float,
    sliding_speed_m_s: float,
    entraining_speed_m_s: float,
    oil: FluidProperties,
    radius_m: float = 0.0381,
    crown_radius_m: float = 0.3048,
    rise_K: float = RISE_K,
) -> float:
    """Share of the frictional heat that the oil film carries out of the contact [1].

    Parameters
    ----------
    load_N, friction_N
        Normal load and friction.
    sliding_speed_m_s, entraining_speed_m_s
        Difference and mean of the speeds of the two surfaces.
    oil
        Properties of the oil at the temperature of the surfaces.
    radius_m, crown_radius_m
        Radius of rolling, and of the crown across the running surface. The defaults are those of
        the disks of the thesis.
    rise_K
        Mean rise of the oil in crossing the contact; the share is proportional to it.

    Returns
    -------
    share
        Heat that the oil carries out over the frictional heat.

    Notes
    -----
    b H (u_f + u_s) rho c dT / (F (u_f - u_s)), equations (1) and (2) of appendix B, which states
    1/500 to 1/1200.

    Examples
    --------
    >>> from immersion.fluids import fluid
    >>> share = film_heat_share(1850.0, 21.2, 13.0, 10.5, fluid("mobil-jet-ii").at(120.0))
    >>> 1 / 1200 < share < 1 / 500
    True
    """
    density_kg_m3 = float(oil.rho_kg_m3)
    viscosity_Pa_s = density_kg_m3 * float(oil.nu_m2_s)
    thickness_m = film_thickness_m(
        load_N, entraining_speed_m_s, viscosity_Pa_s, radius_m, crown_radius_m
    )
    half_width_m = hertz_contact(load_N, radius_m, crown_radius_m).major_m
    flow_m3_s = half_width_m * thickness_m * 2.0 * entraining_speed_m_s
    carried_W = flow_m3_s * density_kg_m3 * float(oil.c_J_kgK) * rise_K
    return carried_W / (friction_N * sliding_speed_m_s)
