"""Steady lines and speed law against the numbers of the thesis and against exact lines."""

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.partition.steady import (
    SteadyLine,
    speed_law,
    speed_law_beta,
    speed_ratio_power,
    steady_map,
)


def line_through(h1: float, s1: float, h2: float, s2: float) -> SteadyLine:
    slope = (s2 - s1) / (h2 - h1)
    return SteadyLine(s1 - slope * h1, slope)


def test_worked_example_of_figures_4_13_to_4_16_gives_the_thesis_beta() -> None:
    fast = line_through(100, 0.37, 1200, 0.83)
    slow = line_through(100, 0.20, 1200, 0.48)
    point = speed_law(fast, slow, 4.24, 0.667)
    assert round(point.beta, 2) == 0.73  # the thesis prints two digits
    assert round(point.chi, 2) == 2.62  # table 7.1's h_f/h_s
    assert point.h_fast / point.h_slow == pytest.approx(point.chi, rel=1e-12)


def test_speed_law_point_lies_on_both_lines() -> None:
    fast = SteadyLine(0.36, 4e-4)
    slow = SteadyLine(0.26, 2.9e-4)
    point = speed_law(fast, slow, 4.24, 0.7)
    assert fast.at(point.h_fast) == pytest.approx(point.beta, abs=1e-12)
    assert slow.at(point.h_slow) == pytest.approx(1 - point.beta, abs=1e-12)


@pytest.mark.parametrize("power_scale", [0.1, 4.0])
def test_starts_of_the_transient_fits_keep_h_in_range_and_lie_on_the_lines(
    power_scale: float,
) -> None:
    fast = SteadyLine(0.36 / power_scale, 4e-4 / power_scale)
    slow = SteadyLine(0.26 / power_scale, 2.9e-4 / power_scale)
    point = speed_law(fast, slow, 4.24, 0.7)
    assert not 50.0 <= point.h_fast <= 2000.0
    share, h = point.starts["fast"]
    assert 50.0 <= h <= 2000.0
    assert share == pytest.approx(fast.at(h), abs=1e-12)


def test_printed_equation_4_7_does_not_give_the_thesis_number() -> None:
    B = 0.46 / 1100
    D = 0.28 / 1100
    A = 0.37 - 100 * B
    C = 0.20 - 100 * D
    chi = speed_ratio_power(4.24, 0.667)
    printed = (chi * B * C - A * D) / (chi * B - D)
    assert abs(printed - 0.73) > 0.3
    assert speed_law_beta(A, B, C, D, chi) == pytest.approx(0.73, abs=0.005)


def test_falling_line_raises_with_a_remedy() -> None:
    with pytest.raises(InputError, match="swapped"):
        speed_law(SteadyLine(0.9, -1e-4), SteadyLine(0.2, 3e-4), 4.24, 0.667)


def test_steady_map_recovers_an_exact_line() -> None:
    h = np.arange(100.0, 1201.0, 100.0)
    rng = np.random.default_rng(0)
    power = 20.0 + rng.normal(0, 0.5, (1, 40, 3)) * np.ones((len(h), 1, 1))
    true = 0.3 + 4e-4 * h
    y = 80.0 * np.ones((40, 3))
    base = y[None] - true[:, None, None] * power
    result = steady_map(y, base, power)
    assert result.line.intercept == pytest.approx(0.3, abs=1e-10)
    assert result.line.slope == pytest.approx(4e-4, rel=1e-10)
    assert result.mean_abs_K.min() < 1.5  # grid step 0.1 of 20 K, half of it at most


def test_double_weight_of_a_shifts_the_line_towards_junction_a() -> None:
    h = np.array([100.0, 600.0, 1200.0])
    power = np.full((3, 10, 3), 20.0)
    y = np.zeros((10, 3))
    y[:, 0] = 1.0  # the best share of a is 0.05 above that of c and e
    base = np.zeros((3, 10, 3))
    equal = steady_map(y, base, power, h)
    doubled = steady_map(y, base, power, h, weights=np.array([2.0, 1.0, 1.0]))
    assert equal.best_share == pytest.approx(np.full(3, 0.05 / 3))
    assert doubled.best_share == pytest.approx(np.full(3, 0.05 / 2))
