"""Uncertainty of the smoother in gaps: against dense least squares, and by simulation.

The dense solution has the state at the first knot and all jumps as unknowns and is solved by an
orthogonal decomposition, which shares no recursion with the smoother.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.estimation.kalman import PointModel, smooth_points
from tcdyn.smoothing import Change, Intensity, smooth
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.state_space import point_models
from tests.smoothing.sparse_study import Verdict, judge, simulate

NOISE_K = 0.03
RANGE_K = 200.0  # of a record with a step elsewhere: ten times that is the prior
FLOOR_INTENSITY = Intensity.constant(1e-6 * NOISE_K**2)


def dense_posterior(model: PointModel) -> tuple[Array, Array]:
    """Mean and standard deviation (P,) of the level at the points by least squares."""
    count = len(model.kind)
    n = len(model.mean)
    state = np.zeros((n, n * count))
    state[:, :n] = model.factor
    mean = model.mean
    levels, prior_levels, rows, right = [], [], [], []
    for p in range(count):
        levels.append(state[0].copy())
        prior_levels.append(mean[0])
        if model.variance[p] > 0:
            rows.append(model.row @ state / np.sqrt(model.variance[p]))
            right.append((model.reading[p] - model.row @ mean) / np.sqrt(model.variance[p]))
        if p == count - 1:
            break
        kind = model.kind[p]
        noise = model.level[p] * model.level_noise[kind] + model.slope[p] * model.slope_noise[kind]
        noise = noise + np.diag([*model.jump[p, :2], *[0.0] * (n - 2)])
        values, vectors = np.linalg.eigh(noise)
        state = model.transition[kind] @ state
        state[:, n * (p + 1) : n * (p + 2)] = vectors * np.sqrt(np.maximum(values, 0.0))
        mean = model.transition[kind] @ mean
    orthogonal, triangle = np.linalg.qr(np.vstack([np.array(rows), np.eye(n * count)]))
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


RISE = Change(70.5, level_sd=60.0, slope_sd=30.0)


@pytest.mark.e2e
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
    _, (model,) = point_models(record, 0, float(noise_var[0]), [intensity], RANGE_K)
    mean, sd = dense_posterior(model)
    smoothed = smooth_points(model)
    ours = np.sqrt(smoothed.covariance[:, 0])
    assert np.allclose(ours, sd, rtol=1e-3)
    assert np.abs(smoothed.mean[:, 0] - mean).max() < 0.01 * sd.min()


def settled_then_stepped(rows: Array, at: float, lag_rows: float = 25.0) -> Array:
    """Readings at ``rows`` behind a lag of a step by 50 K at the row ``at``, NaN elsewhere."""
    y = np.full(int(rows[-1]) + 1, np.nan)
    y[rows] = 200.0 - 50.0 * np.expm1(-np.maximum(rows - at, 0.0) / lag_rows)
    return y + 0.05 * np.random.default_rng(3).standard_normal(len(y))


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("at", [255.0, 330.0, 390.0])
def test_last_readings_behind_a_gap_with_a_step_give_no_temperature(count: int, at: float) -> None:
    """The one reading fits any step, small and early or large and late: the value was 6 u off."""
    rows = np.concatenate([np.arange(250), np.arange(400, 400 + count)])
    result = smooth(settled_then_stepped(rows, at), 1.0, Chain(25.0))
    temperature, u = result.determined_estimates()
    assert np.isnan(temperature[250:]).all()
    assert np.isnan(u[250:]).all()
    assert np.isfinite(temperature[:250]).all()
    assert "trace.alone" in [f.code for f in result.findings]


def test_a_first_reading_before_a_gap_with_a_step_gives_no_temperature() -> None:
    rows = np.concatenate([[0], np.arange(150, 400)])
    result = smooth(settled_then_stepped(rows, 100.0), 1.0, Chain(25.0))
    temperature = result.determined_estimates()[0][:, 0]
    assert np.isnan(temperature[:150]).all()
    assert np.abs(temperature[200:] - 250.0).max() < 1.0


@pytest.mark.parametrize("lone", [[0], [400], [0, 400]])
def test_a_reading_alone_that_agrees_with_the_others_is_used(lone: list[int]) -> None:
    rows = np.unique([*lone, *range(150, 300)])
    result = smooth(settled_then_stepped(rows, 1000.0), 1.0, Chain(25.0))
    assert "trace.alone" not in [f.code for f in result.findings]
    assert np.isfinite(result.determined_estimates()[1][rows[0] :]).all()
    assert np.abs(result.temperature - 200.0).max() < 0.5


def test_a_lone_reading_of_one_channel_leaves_the_others_alone() -> None:
    rows = np.concatenate([np.arange(250), [400]])
    stepped = settled_then_stepped(rows, 330.0)
    other = settled_then_stepped(np.arange(401), 1000.0)
    result = smooth(np.column_stack([stepped, other]), 1.0, Chain(25.0))
    temperature = result.determined_estimates()[0]
    assert np.isnan(temperature[250:, 0]).all()
    assert np.isfinite(temperature[:, 1]).all()


def test_a_change_in_the_gap_that_is_listed_leaves_the_lone_reading_in() -> None:
    rows = np.concatenate([np.arange(250), [400]])
    result = smooth(settled_then_stepped(rows, 330.0), 1.0, Chain(25.0), events_s=[330.0])
    assert "trace.alone" not in [f.code for f in result.findings]


def test_a_slow_sensor_that_settles_after_a_step_does_not_look_rough() -> None:
    """The band after the step was as wide as the noise, 8 times as wide as before it."""
    y = settled_then_stepped(np.arange(400), 100.5)
    result = smooth(y, 1.0, Chain(25.0, conditioning=NO_CONDITIONING))
    before, after = np.median(result.sd[20:80]), np.median(result.sd[250:380])
    assert after < 4 * before
    assert np.mean(np.abs(result.temperature[250:380] - 250.0) < 1.96 * result.sd[250:380]) > 0.86


SOME_RECORDS = range(0, 30, 2)  # each layout with each temperature once in thirty


@cache
def verdict_of(index: int) -> Verdict:
    """The verdict on a sparse record of a seed that is used for nothing else."""
    return judge(simulate(index, 4711))


@pytest.mark.e2e
@pytest.mark.parametrize("index", SOME_RECORDS)
def test_no_u_collapses_and_the_band_of_a_sparse_record_holds(index: int) -> None:
    """Few independent errors in one record. Without rounding errors, the smallest u is that of a
    long quiet part beside one in which a change widens the band."""
    assert verdict_of(index).coverage > 0.6
    assert verdict_of(index).least_u > 0.05


def test_the_mean_coverage_of_sparse_records_is_that_of_the_band() -> None:
    assert np.mean([verdict_of(index).coverage for index in SOME_RECORDS]) > 0.93
