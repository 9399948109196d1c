"""Uncertainty of the smoother in gaps: against dense least squares, and by simulation.

The dense solution has the state at the first knot and all jumps as unknowns and is solved by an
orthogonal decomposition, which shares no recursion with the smoother.
"""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.smoothing import Burst, Intensity
from tcdyn.smoothing.intervals import knots_for
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.rts import IntervalModel, rts_smooth
from tcdyn.smoothing.state_space import interval_model

NOISE_K = 0.03
RANGE_K = np.array([200.0])  # of a record with a step elsewhere: ten times that is the prior
FLOOR_INTENSITY = Intensity.constant(1e-6 * NOISE_K**2)


def dense_posterior(model: IntervalModel) -> tuple[Array, Array]:
    """Mean and standard deviation (J,) of the level at the knots by least squares."""
    count = len(model.kind)
    n = model.mean0.shape[-1]
    unknowns = n + 2 * count
    values, vectors = np.linalg.eigh(model.cov0[0, 0])
    state = np.zeros((n, unknowns))
    state[:, :n] = vectors * np.sqrt(np.maximum(values, 0.0))
    mean = model.mean0[0, 0]
    levels, prior_levels, rows, right = [], [], [], []
    for j in range(count):
        for i in range(2):
            state[i, n + 2 * j + i] += np.sqrt(model.jump_var[j, 0, 0, i])
        levels.append(state[0].copy())
        prior_levels.append(mean[0])
        weights, directions = np.linalg.eigh(model.information[j, 0, 0])
        for weight, direction in zip(weights, directions.T):
            if weight > 1e-12 * max(weights.max(), 1e-300):
                row = np.sqrt(weight) * direction
                rows.append(row @ state)
                right.append(direction @ model.score[j, 0, 0] / np.sqrt(weight) - row @ mean)
        flow = model.transition[model.kind[j], 0, 0]
        state = flow @ state
        mean = flow @ mean
    orthogonal, triangle = np.linalg.qr(np.vstack([np.array(rows), np.eye(unknowns)]))
    solution = np.linalg.solve(triangle, orthogonal[: len(rows)].T @ np.array(right))
    spread = np.linalg.solve(triangle.T, np.array(levels).T)
    mean_levels = np.array(prior_levels) + np.array(levels) @ solution
    return mean_levels, np.sqrt((spread**2).sum(axis=0))


def sparse_readings(gaps: list[int], dense: int) -> Array:
    """Noise about 20 degC, at rows with these distances and then at ``dense`` rows."""
    rows = np.concatenate([[0], np.cumsum(gaps)])
    y = np.full(rows[-1] + dense, np.nan)
    y[rows] = 20.0
    y[rows[-1] :] = 20.0
    return y + NOISE_K * np.random.default_rng(0).standard_normal(len(y))


RISE = Burst(70.5, 1e3, 2.0, level_sd=60.0, slope_sd=30.0)


@pytest.mark.parametrize("lags_s", [(20.0,), (20.0, 3.0)])
@pytest.mark.parametrize("gaps", [[60], [120], [60] * 8, [10, 30, 90, 120, 40]])
@pytest.mark.parametrize(
    "intensity",
    [FLOOR_INTENSITY, Intensity.constant(1e-4), Intensity((0.0,), (1e-9,), (RISE,), (1e-8,))],
)
def test_u_in_gaps_equals_that_of_dense_least_squares(
    lags_s: tuple[float, ...], gaps: list[int], intensity: Intensity
) -> None:
    """Tolerances: rounding at the condition of the dense problem."""
    y = sparse_readings(gaps, 60)
    record = record_of(y, 1.0, Chain(lags_s, conditioning=NO_CONDITIONING), (), NOISE_K)
    noise_var = record.noise_sd**2
    knots = knots_for(record, noise_var, [[intensity]])
    model = interval_model(record, noise_var, [[intensity]], knots, RANGE_K)
    mean, sd = dense_posterior(model)
    smoothed = rts_smooth(model)
    ours = np.sqrt(smoothed.cov[:, 0, 0, 0])
    assert np.allclose(ours, sd, rtol=1e-3)
    assert np.abs(smoothed.mean[:, 0, 0] - mean).max() < 0.01 * sd.min()
