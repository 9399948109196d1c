"""The boundary profile, compared with a full-disk model that is independent of the rim."""

from dataclasses import replace

import numpy as np
import pytest
from profile_study import bias, cases

from tcdyn.heat.modal import spectrum
from tcdyn.heat.rim import Mesh

READINGS = 82.0, 85.0, 80.0  # of d, b, f


def along_inner_row(rim, kind, readings, air, nz=105):
    """z (nz,) and the imposed temperature there, with air at ``air`` behind the washers."""
    shapes = spectrum(rim, 0.0, 1.62e-3, kind, "hertz", Mesh(17, nz), split=True).boundary
    return np.linspace(0.0, rim.width_m, nz), shapes.T @ [0.0, *readings, 0.0, *air]


def test_quadratic_and_quartic_profiles_pass_through_the_readings(rim):
    """The quartic also has zero slope at both faces."""
    z, parabola = along_inner_row(rim, "quadratic", READINGS, (0.0, 0.0))
    np.testing.assert_allclose(
        parabola, np.polyval(np.polyfit(rim.boundary_z_m, READINGS, 2), z), atol=1e-8
    )
    z, quartic = along_inner_row(rim, "quartic", READINGS, (0.0, 0.0))
    coefficients = np.polyfit(z / rim.width_m, quartic, 4)
    np.testing.assert_allclose(
        np.polyval(coefficients, np.array(rim.boundary_z_m) / rim.width_m), READINGS, atol=1e-8
    )
    np.testing.assert_allclose(np.polyval(np.polyder(coefficients), [0.0, 1.0]), 0.0, atol=1e-6)


def test_modal_profile_of_a_slab_between_two_airs_is_exact(rim):
    """Steady state with heat through the washers only: T = T_d side + (T_f side - T_d side)(1/Bi +
    z/w)/(1 + 2/Bi)."""
    conducting_rim = replace(rim, washer_W_m2K=20000.0)
    air = (90.0, 60.0)
    biot = conducting_rim.washer_W_m2K * conducting_rim.width_m / conducting_rim.conductivity_W_mK

    def slab(z):
        return air[0] + (air[1] - air[0]) * (1 / biot + np.asarray(z) / conducting_rim.width_m) / (
            1 + 2 / biot
        )

    z, profile = along_inner_row(conducting_rim, "modal", slab(conducting_rim.boundary_z_m), air)
    # 30 K across; with half the Biot number the error would be kelvins
    np.testing.assert_allclose(profile, slab(z), atol=1e-6)


@pytest.mark.study
def test_modal_profile_has_the_smallest_bias():
    for case in cases():
        biases = {p: bias(case, p, Mesh(33, 53)) for p in ("quadratic", "quartic", "modal")}
        assert biases["modal"].rms_K < 0.3 * min(biases["quadratic"].rms_K, biases["quartic"].rms_K)
        assert abs(biases["modal"].beta_rel) < 1e-3  # the quadratic's is 2.3e-3
        assert abs(biases["modal"].h_rel) < 2e-3  # the quartic's is up to 2e-2
