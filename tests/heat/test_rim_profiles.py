"""The boundary profile, judged by a whole-disk model that shares nothing with the rim."""

from dataclasses import replace

import numpy as np
import pytest
from profile_study import bias, cases

from tcdyn.heat.modal import spectrum
from tcdyn.heat.rim import Mesh

READINGS = 82.0, 85.0, 80.0  # of d, b, f


def along_inner_row(rim, kind, readings, air, nz=105):
    """z (nz,) and the imposed temperature there, with the air behind either washer at ``air``."""
    shapes = spectrum(rim, 0.0, 1.62e-3, kind, "hertz", Mesh(17, nz), split=True).boundary
    return np.linspace(0.0, rim.width_m, nz), shapes.T @ [0.0, *readings, 0.0, *air]


def test_the_parabola_goes_through_the_readings_and_the_quartic_also_lies_level_at_both_faces(rim):
    z, parabola = along_inner_row(rim, "quadratic", READINGS, (0.0, 0.0))
    np.testing.assert_allclose(
        parabola, np.polyval(np.polyfit(rim.boundary_z_m, READINGS, 2), z), atol=1e-8
    )
    z, quartic = along_inner_row(rim, "quartic", READINGS, (0.0, 0.0))
    found = np.polyfit(z / rim.width_m, quartic, 4)
    np.testing.assert_allclose(
        np.polyval(found, np.array(rim.boundary_z_m) / rim.width_m), READINGS, atol=1e-8
    )
    np.testing.assert_allclose(np.polyval(np.polyder(found), [0.0, 1.0]), 0.0, atol=1e-6)


def test_the_modal_profile_of_a_slab_between_two_airs_is_that_slab(rim):
    """Steady, no heat but through the washers: T = T_d side + (T_f side - T_d side)(1/Bi + z/w)/(1 + 2/Bi)."""
    strong, air = replace(rim, washer_W_m2K=20000.0), (90.0, 60.0)
    biot = strong.washer_W_m2K * strong.width_m / strong.conductivity_W_mK

    def slab(z):
        return air[0] + (air[1] - air[0]) * (1 / biot + np.asarray(z) / strong.width_m) / (
            1 + 2 / biot
        )

    z, ours = along_inner_row(strong, "modal", slab(strong.boundary_z_m), air)
    np.testing.assert_allclose(
        ours, slab(z), atol=1e-6
    )  # 30 K across; half the Biot number would be off by kelvins


@pytest.mark.study
def test_modal_profile_has_the_smallest_bias():
    for case in cases():
        found = {p: bias(case, p, Mesh(33, 53)) for p in ("quadratic", "quartic", "modal")}
        assert found["modal"].rms_K < 0.3 * min(found["quadratic"].rms_K, found["quartic"].rms_K)
        assert abs(found["modal"].beta_rel) < 1e-3  # the quadratic's is 2.3e-3
        assert abs(found["modal"].h_rel) < 2e-3  # the quartic's is up to 2e-2
