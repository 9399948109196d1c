"""The boundary profile, judged by a whole-disk model that shares nothing with the rim."""

import pytest
from profile_study import bias, cases

from tcdyn.conduction.rim import Mesh


@pytest.mark.slow
def test_modal_profile_has_the_smallest_bias():
    for case in cases():
        found = {p: bias(case, p, Mesh(33, 53)) for p in ("quadratic", "quartic", "modal")}
        assert found["modal"].rms_K < 0.3 * min(found["quadratic"].rms_K, found["quartic"].rms_K)
        assert abs(found["modal"].beta_rel) < 1e-3  # the quadratic's is 2.3e-3
        assert abs(found["modal"].h_rel) < 2e-3  # the quartic's is up to 2e-2
