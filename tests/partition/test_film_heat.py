"""Heat that leaves with the oil film (appendix B): closed forms, and the range of the thesis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from immersion.fluids import fluid
from tcdyn.partition.film_heat import film_heat_share, film_thickness_m

OIL = fluid("mobil-jet-ii").at(110.0)
TEST = (1460.0, 17.5, 13.0, 10.5)  # load, friction, sliding and entraining speed, as test B2


def test_film_thickness_follows_the_exponents_of_hamrock_and_dowson() -> None:
    thickness = film_thickness_m(1460.0, 10.5, 4e-3)
    assert 1e-7 < thickness < 2e-6  # a film of tenths of a micrometre
    assert film_thickness_m(1460.0, 21.0, 4e-3) == pytest.approx(2**0.67 * thickness)
    assert film_thickness_m(1460.0, 10.5, 8e-3) == pytest.approx(2**0.67 * thickness)
    # the shape of the contact does not depend on the load
    assert film_thickness_m(2920.0, 10.5, 4e-3) == pytest.approx(2**-0.067 * thickness)
    stiffer = film_thickness_m(1460.0, 10.5, 4e-3, pressure_coefficient_per_Pa=2.2e-8)
    assert stiffer == pytest.approx(2**0.53 * thickness)
    # all lengths of the rig doubled, the same pressure (load times four) and speed over radius
    larger = film_thickness_m(5840.0, 21.0, 4e-3, 0.0762, 0.6096)
    assert larger == pytest.approx(2 * thickness)


def test_carried_heat_is_that_of_the_flow_through_the_contact() -> None:
    """Appendix B by hand for B2: b from Hertz's equations solved here, then (1) and (2)."""
    load_N, friction_N, sliding, entraining = TEST
    density, capacity, viscosity_m2_s = 944.0, 2000.0, 5.1e-6
    oil = replace(
        OIL,
        rho_kg_m3=np.float64(density),
        c_J_kgK=np.float64(capacity),
        nu_m2_s=np.float64(viscosity_m2_s),
    )
    thickness = film_thickness_m(load_N, entraining, density * viscosity_m2_s)
    fast, slow = entraining + 0.5 * sliding, entraining - 0.5 * sliding
    half_width_m = 1.50e-3  # table 3.4
    film_W = half_width_m * thickness * (fast + slow) * density * capacity * 20.0
    friction_W = friction_N * (fast - slow)
    # the table has three digits
    assert film_heat_share(*TEST, oil) == pytest.approx(film_W / friction_W, rel=0.005)
    assert film_heat_share(*TEST, oil, rise_K=40.0) == pytest.approx(
        2 * film_heat_share(*TEST, oil)
    )
