"""The reference scheme: order in time, damped start, and stability limit of the explicit scheme."""

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.heat.reference import CrankNicolson, explicit_growth, explicit_limit_s, scheme
from tcdyn.heat.rim import MESHES, Mesh, correction_factor

MESH = Mesh(17, 27)


def field_after_jump(rim, steps, damped):
    """Field 0.5 s after a unit jump of the boundary temperature, in ``steps`` steps."""
    s = scheme(rim, 700.0, MESH)
    stepper = CrankNicolson.prepare(s, 0.5 / steps)
    g = np.asarray(s.inner @ np.ones(27))
    field = np.zeros(len(g))
    for k in range(steps):
        field = stepper.step(field, g, g, damped=k < damped)
    return field


def test_scheme_is_second_order_in_time_after_a_damped_start(rim):
    best = field_after_jump(rim, 2048, 2)
    errors = [np.abs(field_after_jump(rim, n, 2) - best).max() for n in (16, 32, 64, 128)]
    assert -np.polyfit(range(4), np.log2(errors), 1)[0] > 1.9


def test_undamped_start_oscillates_and_a_damped_one_does_not(rim):
    """With long steps, Crank-Nicolson multiplies the stiff part of a jump by -1 in each step
    (Rannacher 1984)."""
    best = field_after_jump(rim, 2048, 2)
    assert (
        np.abs(field_after_jump(rim, 4, 0) - best).max()
        > 5 * np.abs(field_after_jump(rim, 4, 2) - best).max()
    )


def test_explicit_scheme_is_stable_below_its_limit_only(rim):
    limit = explicit_limit_s(rim, MESH)
    assert explicit_growth(rim, MESH, 0.98 * limit) < 1.0
    # surface cooling and washers stiffen the edge only slightly
    assert explicit_growth(rim, MESH, 1.05 * limit) > 10.0
    with pytest.raises(InputError):
        explicit_growth(rim, MESH, 0.0)


PUBLISHED = {
    "I": (1.0667, 1.0667, 1.0667, 1.0667),
    "II": (1.0286, 1.0159, 1.0159, 1.0101),
    "III": (1.0051, 1.0039, 1.0031, 1.0025),
    "IV": (1.0013, 1.0010, 1.0008, 1.0007),
}


@pytest.mark.parametrize("name", MESHES)
def test_correction_factors_match_table_3_4(name):
    factors = [
        correction_factor(b, MESHES[name].nz, 9.53e-3) for b in (1.25e-3, 1.50e-3, 1.62e-3, 1.75e-3)
    ]
    assert [round(x, 4) for x in factors] == list(PUBLISHED[name])
