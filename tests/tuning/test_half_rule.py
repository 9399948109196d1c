"""The half rule gives the reduced models of the examples in Skogestad (2003)."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain.rational import Rational
from tcdyn.core.errors import InputError
from tcdyn.tuning.reduction import MIN_DAMPING, reduce_model
from tests.tuning.tuning_cases import plant

# Plant, (gain, tau1, dead time) of first order, (gain, tau1, tau2, dead time) of second order. E12
# has two self-consistent reductions of first order; only that of second order is in the table.
EXAMPLES = {
    "E1": (plant(1, [1, 0.2]), (1, 1.1, 0.1), (1, 1, 0.2, 0)),
    "E2": (
        plant(1, [2, 1, 0.4, 0.2, 0.05, 0.05, 0.05], zeros=[-0.3, 0.08]),
        (1, 2.5, 1.47),
        (1, 2, 1.2, 0.77),
    ),
    "E3": (plant(2, [20, 1, 0.1, 0.1], zeros=[15]), (1.5, 1.05, 0.15), (1.5, 1, 0.15, 0.05)),
    "E4": (plant(1, [1, 1, 1, 1]), (1, 1.5, 2.5), (1, 1.5, 1, 1.5)),
    "E5": (plant(1, [1, 0.2, 0.04, 0.008]), (1, 1.1, 0.148), (1, 1, 0.22, 0.028)),
    "E7": (plant(1, [1, 1, 1], zeros=[-2]), (1, 1.5, 3.5), (1, 1.5, 1, 2.5)),
    "E8": (plant(1, [1, 1], integrators=1), (1, float("inf"), 1.5), (1, float("inf"), 1.5, 0.5)),
    "E9": (plant(1, [1, 1], 1), (1, 1.5, 1.5), (1, 1, 1, 1)),
    "E10": (plant(1, [20, 2], 1), (1, 21, 2), (1, 20, 2, 1)),
    "E11": (plant(1, [6, 2, 2], 1, zeros=[-1]), (1, 7, 5), (1, 6, 3, 3)),
    "E12": (plant(1, [10, 8, 1], 0.3, zeros=[6, 3]), None, (0.225, 1, 0, 0.3)),
    "E13": (plant(1, [10, 0.5], 1, zeros=[2]), (0.625, 4.5, 1.25), None),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_of_the_paper(name: str) -> None:
    g, first, second = EXAMPLES[name]
    if first is not None:
        reduced = reduce_model(g, 1)
        assert (reduced.gain, reduced.tau1_s, reduced.dead_time_s) == pytest.approx(first)
        assert reduced.tau2_s == 0
    if second is not None:
        reduced = reduce_model(g, 2)
        found = (reduced.gain, reduced.tau1_s, reduced.tau2_s, reduced.dead_time_s)
        assert found == pytest.approx(second)


def test_half_a_sample_is_dead_time() -> None:
    assert reduce_model(plant(1, [8], 1.0), 1, 0.25).dead_time_s == 1.25


def test_the_first_moment_of_a_pair_is_kept() -> None:
    """Damped pairs become two lags; so does a quick pair that oscillates."""
    reduced = reduce_model(plant(1, pair=(10.0, 0.8)), 2)
    assert reduced.tau1_s + reduced.tau2_s + reduced.dead_time_s == pytest.approx(16.0)
    quick = reduce_model(plant(1, [100.0], 5.0, pair=(1.0, 0.3)), 1)
    assert quick.tau1_s + quick.dead_time_s == pytest.approx(105.6)


def test_complex_zeros_are_cancelled_as_two_real_ones() -> None:
    """1 + 2 zeta T s + T^2 s^2 with zeta = 0.5, T = 6: two zeros of 3 s."""
    g = plant(1, [10.0, 8.0, 1.0], 0.3)
    complex_zeros = Rational(np.array([1.0, 6.0, 36.0]), g.factors, 0.3)
    real_zeros = plant(1, [10.0, 8.0, 1.0], 0.3, zeros=[3.0, 3.0])
    first, second = reduce_model(complex_zeros, 2), reduce_model(real_zeros, 2)
    assert first.gain == pytest.approx(second.gain)
    assert first.tau1_s == pytest.approx(second.tau1_s)


@pytest.mark.parametrize(
    ("g", "text"),
    [
        (plant(1, [1.0], 0.5, pair=(10.0, 0.9 * MIN_DAMPING)), "oscillates"),
        (plant(1, [], 2.0), "no lag"),
        (plant(1, [1.0], 1.0, zeros=[3.0, 2.0]), "as many slow zeros"),
    ],
)
def test_plants_without_simc_settings_are_refused_with_the_other_rule(g, text: str) -> None:
    with pytest.raises(InputError, match=text) as refused:
        reduce_model(g, 1)
    assert "rule=robust" in str(refused.value)
