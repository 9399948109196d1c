"""The plants and loops of the study agree with those of the library where both have them."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.tuning import Controller
from tcdyn.tuning.margins import loop_margins
from tests.tuning.tuning_cases import plant
from tests.tuning.tuning_study import drawn_plant, lags, rod, settles, true_margins


def test_margins_of_lags_are_those_of_the_library() -> None:
    controller = Controller.from_series(2.0, 12.0, 4.0, 0.4)
    truth = lags("two lags", 2.0, [20.0, 4.0], 1.5)
    found = loop_margins([plant(2, [20, 4], 1.5)], controller)
    expected = (found.gain_margin[0], found.phase_margin_deg[0], found.ms[0])
    assert true_margins(truth, controller) == pytest.approx(expected, rel=0.01)
    assert truth.lag_s == pytest.approx(25.5)


@pytest.mark.parametrize(("share", "is_stable"), [(0.9, True), (1.1, False)])
def test_a_loop_settles_up_to_its_gain_margin(share: float, is_stable: bool) -> None:
    """L = K exp(-s)/s is stable up to K = pi/2."""
    controller = Controller.from_ideal(8 * share * np.pi / 2, 8)
    assert settles(lags("lag", 1.0, [8.0], 1.0), controller, 1.0) == is_stable


def test_rod_has_the_gain_that_is_asked_for() -> None:
    truth = rod("rod", -0.7, 100.0, 1.5, 2.0)
    assert truth.response(np.array([1e-6]))[0].real == pytest.approx(-0.7, rel=1e-3)
    for kind in ("rod and sensor", "three lags"):
        drawn = drawn_plant(kind, np.random.default_rng(1))
        assert drawn.lag_s > 0
        assert np.linalg.eigvals(drawn.A).real.max() < 0
