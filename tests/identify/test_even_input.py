"""An output that follows the square of a current is refused with the remedy; others are not."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identification import IOData, compare
from tcdyn.identification.even_input import check_even_inputs, has_both_signs
from tests.identify.identify_cases import PLAIN

DT_S = 1.0
TAU_S = 30.0


def current(seed: int, n: int = 900) -> Array:
    """Charge and discharge with pauses, each for 30 to 90 s."""
    rng = np.random.default_rng(seed)
    levels: list[Array] = []
    while sum(map(len, levels)) < n:
        levels.append(np.full(rng.integers(30, 90), rng.choice([-60.0, 0.0, 30.0, 60.0])))
    return np.concatenate(levels)[:n]


def one_lag(heat: Array, seed: int) -> Array:
    """One lag from rest by its exact recursion, with noise of 0.05."""
    y = np.zeros(len(heat))
    decay = np.exp(-DT_S / TAU_S)
    for k in range(1, len(heat)):
        y[k] = decay * y[k - 1] + (1 - decay) * heat[k - 1]
    return 25.0 + y + 0.05 * np.random.default_rng(100 + seed).normal(size=len(heat))


@pytest.mark.parametrize("seed", range(4))
def test_the_heat_of_a_current_names_its_square(seed: int) -> None:
    u = current(seed)
    data = IOData.from_arrays(u, one_lag(0.004 * u**2, seed), DT_S, input_names=["I_A"])
    with pytest.raises(InputError, match="follows the square of I_A") as caught:
        compare(data)
    assert "column with the square of I_A" in str(caught.value)
    heat = IOData.from_arrays(u**2, one_lag(0.004 * u**2, seed), DT_S)
    assert compare(heat, "P1", "P1D", **PLAIN).recommended == "P1"


@pytest.mark.e2e
@pytest.mark.parametrize("seed", range(4))
def test_linear_plants_and_cubes_are_not_named(seed: int) -> None:
    u = current(seed)
    for heat in (0.2 * u, 1e-4 * u**3, 0.0 * u):
        check_even_inputs(IOData.from_arrays(u, one_lag(heat, seed), DT_S), "table")


def test_an_input_of_one_sign_is_not_examined() -> None:
    u = np.abs(current(0))
    assert not has_both_signs(IOData.from_arrays(u, one_lag(u**2, 0), DT_S), 0)
    assert not has_both_signs(IOData.from_arrays(u - 1.0, one_lag(u**2, 0), DT_S), 0)


@pytest.mark.e2e
def test_one_of_several_inputs_is_named() -> None:
    u = np.column_stack([current(1), current(2)])
    y = one_lag(0.2 * u[:, 0] + 0.01 * u[:, 1] ** 2, 1)
    data = IOData.from_arrays(u, y, DT_S, input_names=["room", "I_A"])
    with pytest.raises(InputError, match="follows the square of I_A"):
        check_even_inputs(data, "table")
