"""Correlations against published numbers, the package ht, and their own limits."""

from collections.abc import Callable

import ht
import numpy as np
import pytest
from forms_study import BATHS, DIAMETER, FORMS
from plunge_simulator import WIDTH

from immersion.correlations import CORRELATIONS, Bath, check_validity, correlation
from immersion.fluids import fluid
from immersion.plunge_parameters import PlungePriors
from tcdyn.core.errors import InputError


def nusselt(name: str, ra: float, pr: float) -> float:
    """Nusselt number of a correlation."""
    return float(CORRELATIONS[name].nusselt(ra, pr))


OIL = Bath(fluid("mobil-jet-ii"), correlation("5.4"), 0.00953, 0.0762)


def test_correlations_of_the_thesis_at_oil_conditions() -> None:
    # ANCHORS: Pr = 60, Ra = 1e6; two decimals are given
    assert nusselt("mcadams", 1e6, 60) == pytest.approx(18.66, abs=0.005)
    assert nusselt("similarity", 1e6, 60) == pytest.approx(21.34, abs=0.005)
    assert nusselt("churchill-chu-laminar", 1e6, 60) == pytest.approx(21.26, abs=0.005)


@pytest.mark.parametrize("pr", [0.7, 6.0, 60.0, 300.0])
@pytest.mark.parametrize("ra", [1e4, 1e6, 1e8])
def test_correlations_agree_with_the_package_ht(ra: float, pr: float) -> None:
    gr = ra / pr
    assert nusselt("churchill-chu", ra, pr) == pytest.approx(
        ht.Nu_vertical_plate_Churchill(Pr=pr, Gr=gr), rel=1e-9
    )
    assert nusselt("horizontal-cylinder", ra, pr) == pytest.approx(
        ht.Nu_horizontal_cylinder_Churchill_Chu(Pr=pr, Gr=gr), rel=1e-9
    )
    assert nusselt("mcadams", ra, pr) == pytest.approx(
        ht.Nu_vertical_cylinder_McAdams_Weiss_Saunders(Pr=pr, Gr=gr, turbulent=False), rel=1e-9
    )


def test_boundary_layer_solution_is_approached_at_high_prandtl_number() -> None:
    # exact similarity solution, Pr -> infinity: mean Nu = 0.670 Ra^0.25; the integral solution lies
    # 1.1 % above it
    assert nusselt("similarity", 1e6, 1e9) / (0.670 * 1e6**0.25) == pytest.approx(1.0, abs=0.015)
    # the additive 0.68 remains
    ratio = nusselt("churchill-chu-laminar", 1e8, 1e9) / 100.0
    assert ratio == pytest.approx(0.670, abs=0.007)


def test_h_vanishes_with_the_temperature_difference_and_grows_with_its_fourth_root() -> None:
    plain = Bath(fluid("water"), correlation("mcadams"), 0.01, 0.08)
    assert float(plain.h_W_m2K(50.0, 50.0)) == 0.0
    # same film temperature, sixteen times the difference: twice h
    assert float(plain.h_W_m2K(34.0, 66.0) / plain.h_W_m2K(49.0, 51.0)) == pytest.approx(
        2.0, rel=1e-9
    )


def test_property_uncertainties_propagate_to_h_by_the_quarter_power_law() -> None:
    oil_bath = Bath(fluid("mobil-jet-ii"), correlation("mcadams"), 0.00953, 0.0762)
    components = oil_bath.property_u_rel(30.0, 110.0)
    f = oil_bath.fluid
    # h ~ nu^-1/4; one-sided step of 5 %
    assert components["nu"] == pytest.approx(f.u_nu / 4, rel=0.05)
    assert components["k"] == pytest.approx(0.75 * f.u_k, rel=0.05)
    assert components["beta"] == pytest.approx(f.u_beta / 4, rel=0.10)
    for name in ("rho", "c"):
        assert components[name] == pytest.approx(getattr(f, f"u_{name}") / 4, rel=0.05)
    assert components["total"] == pytest.approx(
        np.sqrt(sum(v**2 for k, v in components.items() if k != "total"))
    )


def test_ranges_of_validity_are_checked_and_reported() -> None:
    valid = check_validity(OIL, np.linspace(26, 100, 30), 110.0)
    assert {f.code for f in valid} <= {"correlation.no_plate"}
    small_plate = check_validity(
        Bath(fluid("mobil-jet-ii"), correlation("5.2"), 0.001, 0.0762), 26.0, 110.0
    )
    range_finding = next(f for f in small_plate if f.code == "correlation.range")
    assert range_finding.numbers["ran"][0] < range_finding.numbers["holds"][0] == 1e4
    slender = check_validity(Bath(fluid("water"), correlation("5.4"), 0.3, 0.005), 20.0, 80.0)
    (thin,) = [f for f in slender if f.code == "correlation.no_plate"]
    assert thin.numbers["ratio"] < thin.numbers["least"]


def test_surface_near_the_bath_temperature_is_not_checked_for_the_range() -> None:
    """Below a tenth of the largest difference Gr vanishes; the range reported is that of the
    larger differences."""

    def range_finding(surface: np.ndarray) -> tuple[float, ...]:
        thin = Bath(fluid("mobil-jet-ii"), correlation("5.2"), 0.001, 0.0762)
        (finding,) = [
            f for f in check_validity(thin, surface, 110.0) if f.code == "correlation.range"
        ]
        return tuple(finding.numbers["ran"])

    full_range = range_finding(np.array([30.0, 101.9]))  # a difference of 80 K, and of 8.1
    assert range_finding(np.array([30.0, 101.9, 102.1, 109.9])) == full_range
    assert set(range_finding(np.array([30.0]))) < set(full_range)
    assert full_range[0] < full_range[1]


def test_disk_of_the_thesis_may_be_treated_as_a_plate() -> None:
    # "This condition is satisfied in the immersion tests experiments", section 5.7; oil at 110
    # degC, disk at 26 degC
    assert check_validity(OIL, 26.0, 110.0) == ()


def test_names_and_equation_numbers_select_the_same_correlation() -> None:
    assert correlation("(5.3)") is CORRELATIONS["similarity"]
    with pytest.raises(InputError, match="unknown correlation"):
        correlation("5.9")


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
@pytest.mark.parametrize("case", BATHS)
def test_published_forms_of_h_lie_within_the_priors(case: str, form: Callable) -> None:
    """ln(h / h of 5.4) is linear in ln|dT| and in ln nu, with slopes that the priors cover."""
    law, name, start_degC, baths_degC, _ = BATHS[case]
    substance = fluid(name)
    base = Bath(substance, correlation("5.4"), WIDTH, DIAMETER)
    priors = PlungePriors()
    for bath_degC in baths_degC:
        log_share = np.linspace(0, np.log(0.05), 60)  # equal steps of time, about
        wall = bath_degC + (start_degC - bath_degC) * np.exp(log_share)
        bulk = np.full_like(wall, bath_degC)
        log_viscosity = np.log(substance.nu(wall) / substance.nu(bulk))
        ratio = np.log(form(law, wall, bulk) / base.h_W_m2K(wall, bulk))
        columns = np.column_stack([np.ones_like(wall), log_share, log_viscosity])
        slopes = np.linalg.lstsq(columns, ratio)[0]
        _, exponent, viscosity = slopes
        residual = ratio - columns @ slopes
        assert np.std(residual) < 0.008  # Morgan's power changes within a run
        assert abs(exponent) < 2 * priors.h_exponent
        assert abs(viscosity) < 2 * priors.h_viscosity
