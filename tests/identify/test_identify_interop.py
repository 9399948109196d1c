"""Functions that users of other identification packages expect: pickling, resampling, priors,
prediction, nonparametric estimates and test inputs."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from tcdyn.core import Array
from tcdyn.identify import IOData, compare, fit, process, simulate, transfer

TRUTH = {"Kp": 2.0, "Tp1": 0.8, "Td": 0.13}
DT_S = 0.1


def switched_input(n: int, rng: np.random.Generator, held: int = 10) -> Array:
    """Random switching between 0 and 10 (N,)."""
    return np.repeat(rng.integers(0, 2, n // held + 1) * 10.0, held)[:n]


def record(n: int = 400, noise_sd: float = 0.2, seed: int = 0) -> IOData:
    """Record of the first-order system TRUTH with white noise."""
    rng = np.random.default_rng(seed)
    u = switched_input(n, rng)
    y = simulate(process("P1D").rational(TRUTH), u, DT_S, "zoh")
    return IOData.from_arrays(u, y + rng.normal(0, noise_sd, n), DT_S, hold="zoh")


@pytest.mark.parametrize(
    ("model", "options"),
    [
        (process("P1D"), {}),
        (process("P1D"), {"noise": (1, 0), "baseline": "trend"}),
        (process("P1D"), {"noise": "slow", "baseline": "none"}),
        (process("P1D"), {"loss": "bisquare"}),
        (transfer(1, 2, delay=True), {}),
    ],
)
def test_unpickled_fit_is_the_same_and_can_still_be_evaluated(model: Any, options: Any) -> None:
    data = record()
    result = fit(pickle.loads(pickle.dumps(data)), model, **options)
    copy = pickle.loads(pickle.dumps(result))
    assert copy.summary() == result.summary()
    rows = copy.optimum.problem.evaluate(copy.x)
    np.testing.assert_array_equal(rows[0], result.optimum.residual)


def test_unpickled_comparison_has_the_same_summary() -> None:
    comparison = compare(record(), "P1", "P1D")
    assert pickle.loads(pickle.dumps(comparison)).summary() == comparison.summary()
