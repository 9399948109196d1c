"""NARX refined by free simulation: where one-step least squares is biased by noise of the output."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.identify import IOData
from tcdyn.identify.narx import Narx, narx, refined

TERMS = ((("y", 1),), (("u", 1),), (("u", 1), ("y", 1)))
TRUTH = (0.8, 0.25, -0.05)  # y_t = 0.8 y + 0.25 u - 0.05 u y: slow where the input is low


def record(seed: int, colour: float, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Input and output of the recursion, with noise of the output: AR(1) of ``colour``, sd 0.1."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, n // 8), 8)
    y = np.zeros(n)
    for t in range(1, n):
        y[t] = 0.8 * y[t - 1] + 0.25 * u[t - 1] - 0.05 * u[t - 1] * y[t - 1]
    e = lfilter([0.1 * np.sqrt(1 - colour**2)], [1.0, -colour], rng.normal(size=n + 100))[100:]
    return u, y + e


@pytest.mark.parametrize("colour", [0.0, 0.7])
def test_weights_are_unbiased_and_bootstrap_intervals_hold_them(colour):
    held, ends = [], []
    for seed in range(20):
        u, y = record(seed, colour)
        table = np.column_stack([y[:-1], u[:-1], u[:-1] * y[:-1]])
        begun = np.linalg.lstsq(table, y[1:], rcond=None)[0]  # one step: shrunk by the noise
        found = refined(Narx(TERMS, tuple(begun.tolist()), (0.0, 1.0), (0.0, 1.0), 0.1, 2), u, y)
        held.append([e.covers(v) for e, v in zip(found.intervals, TRUTH)])
        ends.append((begun[0], found.theta[0]))
    one_step, simulated = np.mean(ends, axis=0)
    assert abs(simulated - 0.8) < 0.01
    assert colour > 0 or one_step < 0.77
    assert np.mean(held) > 0.85  # of 60, nominal 0.95; standard error 0.03


def test_terms_found_by_one_step_are_refined_and_the_lag_has_an_interval():
    u, y = record(1, 0.0)
    found = narx(IOData.from_arrays(u, y, 0.1, hold="zoh"), degree=2, lags=2)
    assert found.simulated_percent > 75
    lag = found.lag_s(0.0)
    assert lag.value == pytest.approx(0.1 * (1 + 0.8 / 0.2), abs=4 * lag.u)  # at rest five samples
    assert 0 < lag.u < 0.1
    assert Narx(TERMS, TRUTH, (0.0, 1.0), (0.0, 1.0), 0.1, 2).intervals == (None, None, None)
