"""The smoother of :mod:`tcdyn.estimation.kalman` against dense algebra in extended precision."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
import pytest

from tcdyn.chain import Chain, sensors
from tcdyn.estimation import compiled as compilation
from tcdyn.estimation.kalman import (
    BLOCK,
    PointModel,
    _filter_to,
    _level_covariance,
    _smooth,
    compile_functions,
    level_covariance,
    log_likelihood,
    root_of_sum,
    smooth_points,
)
from tcdyn.smoothing.state_space import steps_of

DIGITS = 50
RANGE_K = 200.0


def model_of(
    lags_s: tuple[float, ...],
    steps_s: np.ndarray,
    *,
    slope: float,
    level: float = 0.0,
    noise_K: float = 0.1,
    swing_K: float = 5.0,
    missing: tuple[int, ...] = (),
    period: int = 1,
) -> PointModel:
    """A chain that reads a swing at points that are ``steps_s`` apart, with a diffuse start."""
    (sensor,) = sensors([Chain(lags_s)])
    n = len(sensor.drift)
    lengths, kind = np.unique(steps_s, return_inverse=True)
    matrices = [steps_of(sensor, float(length)) for length in lengths]
    transition, level_noise, slope_noise = (np.array(kinds) for kinds in zip(*matrices))
    count = len(steps_s) + 1
    rng = np.random.default_rng(3)
    time_s = np.concatenate([[0.0], np.cumsum(steps_s)])
    reading = 20 + swing_K * np.sin(time_s / time_s[-1] * 7) + noise_K * rng.standard_normal(count)
    variance = np.full(count, noise_K**2)
    variance[list(missing)] = 0.0
    variance[2] *= 4
    jump = np.zeros((count, 4))
    jump[count // 2] = [9.0, 4.0, 0.0, 0.0]
    jump[count // 3, 2] = 2.0
    jump[count // 4, 3] = 3.0
    wide = RANGE_K * np.array([1.0, 1.0 / (sensor.lag_s + float(np.median(steps_s)))])
    return PointModel(
        transition,
        level_noise,
        slope_noise,
        np.append(kind, 0).astype(np.int64),
        np.full(count, level),
        np.full(count, slope),
        jump,
        np.ascontiguousarray(sensor.ramp[:, 0]),
        np.ascontiguousarray(sensor.drift[:, 0]),
        sensor.output,
        reading,
        variance,
        20.0 * sensor.ramp[:, 0],
        root_of_sum(sensor.ramp * wide, 1e-3 * np.eye(n)),
        np.arange(count) % period == 0,
        period,
    )


@dataclass
class Dense:
    """Means, covariance of all states (P n), log likelihood and chi-square, as mpmath matrices."""

    mean: Any
    covariance: Any
    value: float
    chi2: float

    def variance(self, row: Any) -> float:
        """Variance of a linear function of all states."""
        return float((row * self.covariance * row.T)[0])


def dense(model: PointModel) -> Dense:
    """All states as one normal vector, given the readings."""
    n, count = len(model.mean), len(model.kind)

    def exact(values: np.ndarray) -> Any:
        return mpmath.matrix(np.atleast_2d(values).tolist())

    prior = mpmath.zeros(n * count)
    means = [exact(model.mean).T]
    factor = exact(model.factor)
    covariance = factor * factor.T
    prior[:n, :n] = covariance
    for p in range(count - 1):
        kind = model.kind[p]
        flow = exact(model.transition[kind])
        noise = mpmath.mpf(model.level[p]) * exact(model.level_noise[kind])
        noise += mpmath.mpf(model.slope[p]) * exact(model.slope_noise[kind])
        for i in (0, 1):
            noise[i, i] += mpmath.mpf(model.jump[p, i])
        direction = exact(model.direction).T
        noise += mpmath.mpf(model.jump[p, 2]) * direction * direction.T
        impulse = exact(model.impulse).T
        noise += mpmath.mpf(model.jump[p, 3]) * impulse * impulse.T
        old, new = slice(0, (p + 1) * n), slice((p + 1) * n, (p + 2) * n)
        cross = flow * prior[p * n : (p + 1) * n, old]
        prior[new, old] = cross
        prior[old, new] = cross.T
        covariance = flow * covariance * flow.T + noise
        prior[new, new] = covariance
        means.append(flow * means[-1])
    read = [p for p in range(count) if model.variance[p] > 0]
    rows = mpmath.zeros(len(read), n * count)
    rest = mpmath.zeros(len(read), 1)
    row = exact(model.row)
    noise_var = mpmath.zeros(len(read))
    for k, p in enumerate(read):
        rows[k, p * n : (p + 1) * n] = row
        rest[k] = mpmath.mpf(model.reading[p]) - (row * means[p])[0]
        noise_var[k, k] = mpmath.mpf(model.variance[p])
    spread = rows * prior * rows.T + noise_var
    solved = mpmath.lu_solve(spread, rest)
    gain = prior * rows.T * spread**-1
    mean = gain * rest
    for p in range(count):
        for i in range(n):
            mean[p * n + i] += means[p][i]
    chi2 = (rest.T * solved)[0]
    value = -0.5 * (mpmath.log(mpmath.det(spread)) + chi2)
    return Dense(mean, prior - gain * rows * prior, float(value), float(chi2))


STEPS = 15
CASES = {
    "lag of a tenth of a step": model_of((1.0,), np.full(STEPS, 10.0), slope=1e-4, level=1e-2),
    "lag of 50 steps": model_of((0.5,), np.full(STEPS, 0.01), slope=10.0),
    "two lags, level noise": model_of((0.75, 0.12), np.full(STEPS, 1 / 75), slope=10.0, level=2.0),
    "lag of 100,000 steps": model_of((1.0,), np.full(STEPS, 1e-5), slope=10.0, level=1.0),
    "no lag": model_of((), np.full(STEPS, 0.02), slope=10.0),
    "hardly any noise": model_of(
        (0.5, 0.3), np.full(STEPS, 0.02), slope=1e-4, noise_K=1e-5, swing_K=1e-4
    ),
    "every other point": model_of(
        (0.5,), np.tile([0.007, 0.013], 8), slope=10.0, level=1.0, period=2, missing=range(0, 16, 2)
    ),
    "missing readings": model_of(
        (0.5,), np.full(STEPS, 0.02), slope=10.0, missing=(0, 3, 4, 5, 6, 14)
    ),
    **{
        f"gap of {lags:g} lags": model_of(
            (0.5,), np.array([*[0.02] * 7, 0.5 * lags, *[0.03] * 7]), slope=1.0, level=0.1
        )
        for lags in (1.0, 30.0, 1000.0)
    },
}


@pytest.mark.e2e
@pytest.mark.parametrize("name", CASES)
def test_smoother_and_likelihood_equal_dense_algebra(name: str) -> None:
    model = CASES[name]
    n, count = len(model.mean), len(model.kind)
    with mpmath.workdps(DIGITS):
        exact = dense(model)
        ours = smooth_points(model, np.eye(n))
        rel = 1e-6
        for p in range(count):
            unit = mpmath.zeros(3, n * count)
            unit[0, p * n] = 1
            unit[1, p * n + 1] = 1
            unit[2, p * n : (p + 1) * n] = mpmath.matrix([model.row.tolist()])
            found = [*ours.covariance[p, [0, 2]], ours.predicted_var[p]]
            expected = [exact.variance(unit[i, :]) for i in range(3)]
            assert found == pytest.approx(expected, rel=rel)
            for i in range(n):
                each = mpmath.zeros(1, n * count)
                each[0, p * n + i] = 1
                error = ours.extra[p, i] - float(exact.mean[p * n + i])
                assert abs(error) < 1e-5 * np.sqrt(exact.variance(each))
            for k, later in enumerate((p + model.period, p + 2 * model.period)):
                if not model.is_mark[p] or later >= count:
                    continue
                change = mpmath.zeros(1, n * count)
                change[0, p * n] = -1
                change[0, later * n] = 1
                assert ours.change_var[p, k] == pytest.approx(exact.variance(change), rel=rel)
        value, chi2 = log_likelihood(model)
        assert (value, chi2) == pytest.approx((exact.value, exact.chi2), rel=1e-6)
        window = level_covariance(model, 3, 9)
        levels = [[float(exact.covariance[p * n, q * n]) for q in range(3, 9)] for p in range(3, 9)]
        assert window == pytest.approx(np.array(levels), rel=1e-5, abs=1e-5 * np.max(levels))


def test_scores_are_derivatives_of_the_filter_to() -> None:
    """By central differences of the variances of jumps, and of the intensities of one step."""
    model = CASES["two lags, level noise"]
    ours = smooth_points(model)

    def value(**changed: np.ndarray) -> float:
        return log_likelihood(model._replace(**changed))[0]

    for p in (5, 9):
        for i, var in (
            (0, ours.score_var[p, 0]),
            (1, ours.score_var[p, 2]),
            (2, ours.score_var[p, 3]),
        ):
            step = 1e-5 / var
            jump = np.zeros_like(model.jump)
            jump[p - 1, i] = step
            # of the stages alone no variance can be taken away
            before = model.jump - jump if i < 2 else model.jump
            slope = (value(jump=model.jump + jump) - value(jump=before)) / (
                2 * step if i < 2 else step
            )
            assert slope == pytest.approx(0.5 * (ours.score[p, i] ** 2 - var), rel=1e-4, abs=1e-6)
        for i, name in enumerate(("level", "slope")):
            base = getattr(model, name)
            step = np.zeros_like(base)
            step[p - 1] = 1e-3 * base[p - 1]
            slope = value(**{name: base + step}) - value(**{name: base - step})
            expected = 0.5 * (ours.gradient[p, i] - ours.expected[p, i]) * 2 * step[p - 1]
            assert slope == pytest.approx(expected, rel=1e-3)


def long_model(count: int, period: int = 1) -> PointModel:
    """A long record with missing readings: two, and with a period of two every other one."""
    missing = {count // 3, count // 3 + 1}
    steps_s = np.full(count - 1, 0.02)
    if period == 2:
        steps_s = np.resize([0.007, 0.013], count - 1)
        missing |= {*range(0, count, 2)}
    return model_of((0.5,), steps_s, slope=10.0, missing=(*missing,), period=period)


@pytest.mark.parametrize("period", [1, 2])
def test_settled_covariances_change_no_result(period: int) -> None:
    model = long_model(3000, period)
    settled = smooth_points(model)
    each = smooth_points(model, tolerance=0.0)
    sd = np.sqrt(each.covariance[:, 0])
    assert np.abs(settled.mean[:, 0] - each.mean[:, 0]).max() < 1e-7 * sd.min()
    assert settled.covariance[:, 0] == pytest.approx(each.covariance[:, 0], rel=1e-7)
    assert settled.change_var[:-2] == pytest.approx(each.change_var[:-2], rel=1e-6, abs=1e-300)
    assert settled.predicted_var == pytest.approx(each.predicted_var, rel=1e-7)
    score_sd = np.sqrt(each.score_var[1:-1, [0, 2, 3]])
    assert (np.abs(settled.score - each.score)[1:-1] / score_sd).max() < 1e-6


def test_blocks_change_no_result() -> None:
    """A part of the record that is one block, against the same points in two blocks."""
    model = long_model(BLOCK + 2000)
    whole = smooth_points(model)
    first, last = BLOCK - 2000, BLOCK + 2000
    per_point = ("kind", "level", "slope", "jump", "reading", "variance")
    part = model._replace(**{name: getattr(model, name)[first:last] for name in per_point})
    alone = smooth_points(part)
    inner = slice(1000, -1000)
    difference = np.abs(whole.mean[first:last] - alone.mean)[inner]
    sd = np.sqrt(alone.covariance[inner][:, [0, 2]])
    assert (difference / sd).max() < 1e-7
    assert whole.covariance[first:last][inner] == pytest.approx(alone.covariance[inner], rel=1e-7)


PROGRAM = """
import numpy as np
{before}
from tcdyn.estimation import kalman
from tests.estimation.test_kalman import model_of
model = model_of((0.5,), np.full(40, 0.02), slope=10.0, missing=(7,))
result = kalman.smooth_points(model)
print(repr(float(result.mean[20, 0])), repr(float(result.covariance[20, 0])))
"""


@pytest.mark.parametrize(
    ("before", "said"),
    [
        ("import os; os.environ['NUMBA_DISABLE_JIT'] = '1'", ""),
        ("import sys; sys.modules['numba'] = None", "computes slowly"),
    ],
    ids=["not compiled", "without Numba"],
)
def test_the_same_source_runs_as_it_is(before: str, said: str) -> None:
    model = model_of((0.5,), np.full(40, 0.02), slope=10.0, missing=(7,))
    compiled = smooth_points(model)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(before=before)],
        capture_output=True,
        text=True,
        check=True,
    )
    mean, variance = map(float, done.stdout.split())
    assert mean == pytest.approx(compiled.mean[20, 0], rel=1e-12)
    assert variance == pytest.approx(compiled.covariance[20, 0], rel=1e-9)
    assert said in done.stderr
    assert bool(done.stderr) == bool(said)


def test_without_a_writable_cache_each_process_compiles(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = compilation.njit
    assert real is not None

    def njit(function: Any, cache: bool = False, **options: Any) -> Any:
        """Numba on a machine where no folder for a cache can be written to."""
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return real(function, **options)

    monkeypatch.setattr(compilation, "njit", njit)
    add = compilation.compiled(lambda a, b: a + b)
    assert add(1.0, 2.0) == 3.0
    compilation.compiled(lambda a: -a)
    assert capsys.readouterr().err.count("NUMBA_CACHE_DIR") == 1  # once in a process


def test_what_workers_need_is_compiled_before_they_start() -> None:
    compile_functions()
    for function in (_smooth, _filter_to, _level_covariance):
        assert len(function.signatures) == 1  # no second one for arrays of other kinds
