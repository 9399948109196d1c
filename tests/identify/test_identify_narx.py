"""NARX refined by free simulation, where one-step least squares is biased by noise of the
output."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.identification import IOData
from tcdyn.identification import narx as module
from tcdyn.identification.level_lag import LevelLag
from tcdyn.identification.narx import Narx, narx, refine_weights

TERMS = ((("y", 1),), (("u", 1),), (("u", 1), ("y", 1)))
TRUTH = (0.8, 0.25, -0.05)  # y_t = 0.8 y + 0.25 u - 0.05 u y: slow where the input is low


def record(seed: int, colour: float, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Input and output of the recursion, with output noise: AR(1) of ``colour``, sd 0.1."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, n // 8), 8)
    y = np.zeros(n)
    for t in range(1, n):
        y[t] = 0.8 * y[t - 1] + 0.25 * u[t - 1] - 0.05 * u[t - 1] * y[t - 1]
    e = lfilter([0.1 * np.sqrt(1 - colour**2)], [1.0, -colour], rng.normal(size=n + 100))[100:]
    return u, y + e


@pytest.mark.study
@pytest.mark.parametrize("colour", [0.0, 0.7])
def test_refined_weights_are_unbiased(colour):
    first_weights = []
    for seed in range(20):
        u, y = record(seed, colour)
        table = np.column_stack([y[:-1], u[:-1], u[:-1] * y[:-1]])
        one_step_weights = np.linalg.lstsq(table, y[1:], rcond=None)[0]  # shrunk by the noise
        result = refine_weights(
            Narx(TERMS, tuple(one_step_weights.tolist()), (0.0, 1.0), (0.0, 1.0)), u, y
        )
        first_weights.append((one_step_weights[0], result.theta[0]))
    one_step, simulated = np.mean(first_weights, axis=0)
    assert abs(simulated - 0.8) < 0.01
    assert colour > 0 or one_step < 0.77


def test_terms_selected_by_one_step_prediction_are_refined():
    u, y = record(1, 0.0)
    result = narx(IOData.from_arrays(u, y, 0.1, hold="zoh"), degree=2, lags=2)
    assert result.simulated_percent > 75


@pytest.mark.parametrize(
    ("quadratic", "message"), [(98.1, "Held out, a quadratic"), (98.3, "look at the static line")]
)
def test_quadratic_model_is_better_if_it_reduces_the_error_by_a_tenth(
    quadratic: float, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The linear model leaves 2 % of the held-out part unexplained; the lag does not depend on the
    level."""
    level = LevelLag(
        "P1", (20.0, 180.0), *[Estimate.normal(1.0, 0.1)] * 2, Estimate.normal(0.0, 0.1)
    )
    centre_and_scale = (0.0, 1.0)

    def scored(data: IOData, *, degree: int, **_: object) -> Narx:
        percent = {1: 98.0, 2: quadratic}[degree]
        return Narx(
            TERMS,
            TRUTH,
            centre_and_scale,
            centre_and_scale,
            one_step_percent=99.9,
            held_out_percent=percent,
        )

    monkeypatch.setattr(module, "narx", scored)
    monkeypatch.setattr(module, "level_lag", lambda data: level)
    result = module.temperature_dependence(IOData.from_arrays(*record(0, 0.0), 0.1))
    assert message in result.sentence
    assert result.sentence.startswith("No sign that the lag depends")
    assert f"{quadratic:.1f} %" in result.sentence


def test_free_simulation_and_one_step_prediction_equal_the_recursion_in_original_units() -> None:
    model = Narx(TERMS, TRUTH, (3.0, 2.0), (1.0, 4.0))
    rng = np.random.default_rng(0)
    u = 3 + 2 * rng.normal(size=30)
    y = np.full(30, 2.0)
    for t in range(1, 30):
        v = (u[t - 1] - 3) / 2
        x = (y[t - 1] - 1) / 4
        y[t] = 1 + 4 * (0.8 * x + 0.25 * v - 0.05 * v * x)
    assert model.simulate(u, y[:1]) == pytest.approx(y, rel=1e-12)
    assert 1 + 4 * model.one_step((u - 3) / 2, (y - 1) / 4)[1:] == pytest.approx(y[1:], rel=1e-12)
    unstable = Narx(TERMS[:1], (-2.0,), (0.0, 1.0), (0.0, 1.0))
    simulated = unstable.simulate(np.zeros(20), np.ones(1))
    assert simulated[:10] == pytest.approx((-2.0) ** np.arange(10))  # up to a thousand spreads
    assert np.isnan(simulated[10:]).all()


def test_scores_ignore_up_to_a_tenth_of_missing_values() -> None:
    y = np.arange(20.0)
    assert module.finite_percent(y, y + np.tile([1.0, -1.0], 10)) == pytest.approx(
        100 * (1 - np.sqrt(20 / 665))
    )
    assert module.finite_percent(y, np.r_[np.nan, y[1:]]) == 100.0
    assert module.finite_percent(y, np.r_[np.full(3, np.nan), y[3:]]) == -np.inf


def test_too_short_a_record_raises() -> None:
    u, y = record(2, 0.0)
    shortest = IOData.from_arrays(u[:58], y[:58], 0.1, hold="zoh")
    assert narx(shortest, degree=1, lags=2).order <= 2  # 40 training samples
    with pytest.raises(InputError, match="39 training samples"):
        narx(IOData.from_arrays(u[:57], y[:57], 0.1, hold="zoh"), degree=1, lags=2)
