"""Dependence of the lag on the level. Records are simulated by Euler steps of a twentieth of a
sample, independently of the fit."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from identify_cases import PLAIN

from tcdyn.identification import IOData
from tcdyn.identification.level_lag import LevelLagProblem, level_lag

LOW = 25.0
HIGH = 180.0
DT_S = 0.05
FINER = 20


def record(kind: str, seed: int, low_s: float = 0.73, high_s: float = 0.95, n: int = 800) -> IOData:
    """A sensor whose lag rises from ``low_s`` at 25 to ``high_s`` at 180 degC; noise 0.2 K."""
    rng = np.random.default_rng(seed)
    h = DT_S / FINER
    t = np.arange(n * FINER) * h
    if kind == "plunge":
        u = LOW + (HIGH - LOW) * (1 - np.exp(-np.clip(t - 2, 0, None) / 3))
    else:
        u = np.repeat(rng.choice([LOW, HIGH], n // 50), 50 * FINER)
    y = np.empty(len(u))
    level = float(u[0])
    for k, input_value in enumerate(u.tolist()):
        y[k] = level
        level += (
            h / (low_s + (high_s - low_s) * (level - LOW) / (HIGH - LOW)) * (input_value - level)
        )
    hold = "foh" if kind == "plunge" else "zoh"
    return IOData.from_arrays(u[::FINER], y[::FINER] + 0.2 * rng.normal(size=n), DT_S, hold=hold)


def study(kind: str, seeds: range, high_s: float) -> dict[str, float]:
    """Share of runs with the wrong sign, share that claim a dependence, and coverage of the lag at
    both levels."""
    wrong = []
    claimed = []
    covered = []
    for seed in seeds:
        result = level_lag(record(kind, seed, high_s=high_s))
        true_lags = [
            0.73 + (high_s - 0.73) * (level - LOW) / (HIGH - LOW) for level in result.levels
        ]
        wrong.append(result.bend.value < 0)
        claimed.append(result.depends)
        covered += [
            abs(e.value - v) < 1.96 * e.u + 0.01
            for e, v in zip((result.low, result.high), true_lags)
        ]
    return {
        "wrong": float(np.mean(wrong)),
        "claimed": float(np.mean(claimed)),
        "covered": float(np.mean(covered)),
    }


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("kind", ["plunge", pytest.param("square", marks=pytest.mark.study)])
def test_rising_lag_is_detected_and_a_constant_lag_is_not(kind):
    rising = study(kind, range(8), 0.95)
    constant = study(kind, range(8), 0.73)
    assert rising["wrong"] == 0
    assert rising["claimed"] == 1
    assert rising["covered"] >= 0.9  # to 0.01 s: tau is not exactly exponential in the level
    assert constant["claimed"] <= 0.125  # 1 % of 8; two or more occur once in 400


def test_zero_level_dependence_reduces_to_the_linear_model_and_sensitivities_equal_differences():
    from tcdyn.identification import fit

    base = fit(record("square", 0), "P2D", intervals="quadratic", **PLAIN)
    level_lag_problem = LevelLagProblem(base, 100.0, 80.0)
    residual, slopes = level_lag_problem.problem.evaluate(np.append(base.x, 0.0))
    assert np.allclose(residual, -base.residual)
    assert np.allclose(slopes[:, :-1], base.jacobian, atol=1e-9 * np.abs(base.jacobian).max())
    assert np.abs(slopes[:, -1]).max() > 1.0
    x = np.append(base.x, 0.3)
    h = 1e-3
    # Td lies at its bound
    free = [k for k, name in enumerate(level_lag_problem.problem.names) if name != "Td"]
    _, slopes = level_lag_problem.problem.evaluate(x)
    for k in free:
        up, down = (
            level_lag_problem.problem.evaluate(x + sign * h * np.eye(len(x))[k])[0]
            for sign in (1, -1)
        )
        error = np.abs(slopes[:, k] - (up - down) / (2 * h)).max()
        assert error < 1e-4 * np.abs(slopes[:, k]).max(), k


if __name__ == "__main__":  # python -m test_identify_level 100
    for kind in ("plunge", "square"):
        for high_s in (0.95, 0.73):
            print(kind, high_s, study(kind, range(int(sys.argv[1])), high_s), flush=True)
