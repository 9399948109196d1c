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
from tcdyn.identification.narx import Narx, bootstrap_estimate, narx, refine_weights

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
def test_refined_weights_are_unbiased_and_bootstrap_intervals_cover(colour):
    covered = []
    first_weights = []
    for seed in range(20):
        u, y = record(seed, colour)
        table = np.column_stack([y[:-1], u[:-1], u[:-1] * y[:-1]])
        one_step_weights = np.linalg.lstsq(table, y[1:], rcond=None)[0]  # shrunk by the noise
        result = refine_weights(
            Narx(TERMS, tuple(one_step_weights.tolist()), (0.0, 1.0), (0.0, 1.0), 0.1), u, y
        )
        covered.append([e.contains(v) for e, v in zip(result.intervals, TRUTH)])
        first_weights.append((one_step_weights[0], result.theta[0]))
    one_step, simulated = np.mean(first_weights, axis=0)
    assert abs(simulated - 0.8) < 0.01
    assert colour > 0 or one_step < 0.77
    assert np.mean(covered) > 0.85  # of 60, nominal 0.95; standard error 0.03


def test_terms_selected_by_one_step_prediction_are_refined_and_the_lag_has_an_interval():
    u, y = record(1, 0.0)
    result = narx(IOData.from_arrays(u, y, 0.1, hold="zoh"), degree=2, lags=2)
    assert result.simulated_percent > 75
    lag = result.lag_s(0.0)
    # at rest it is five samples
    assert lag.value == pytest.approx(0.1 * (1 + 0.8 / 0.2), abs=4 * lag.u)
    assert 0 < lag.u < 0.1
    assert Narx(TERMS, TRUTH, (0.0, 1.0), (0.0, 1.0), 0.1).intervals == (None, None, None)


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
            0.1,
            one_step_percent=99.9,
            held_out_percent=percent,
        )

    monkeypatch.setattr(module, "narx", scored)
    monkeypatch.setattr(module, "level_lag", lambda data: level)
    result = module.temperature_dependence(IOData.from_arrays(*record(0, 0.0), 0.1))
    assert message in result.sentence
    assert result.sentence.startswith("No sign that the lag depends")
    assert f"{quadratic:.1f} %" in result.sentence


def test_local_lag_is_that_of_the_recursion_linearised_at_its_level() -> None:
    """y_t = a y + b u_(t-2) has the first moment 2 + a/(1 - a) samples; u y adds c y to b and c u
    to a."""
    plain = Narx(((("y", 1),), (("u", 2),)), (0.8, 0.5), (3.0, 2.0), (1.0, 4.0), 0.1)
    assert plain.local_lag_s(7.0) == pytest.approx(0.1 * (2 + 0.8 / 0.2), rel=1e-9)
    bilinear = Narx(TERMS, TRUTH, (3.0, 2.0), (1.0, 4.0), 0.1)
    y = (5.0 - 1.0) / 4.0
    u = 0.2 * y / (0.25 - 0.05 * y)  # at rest
    a = 0.8 - 0.05 * u
    assert bilinear.local_lag_s(5.0) == pytest.approx(0.1 * (1 + a / (1 - a)), rel=1e-9)
    unstable = Narx(TERMS[:2], (1.1, 0.5), (0.0, 1.0), (0.0, 1.0), 0.1)
    assert np.isnan(unstable.local_lag_s(0.0))
    constant = Narx(((), (("u", 1),)), (0.5, 1.0), (0.0, 1.0), (0.0, 1.0), 0.1)
    assert constant.local_lag_s(2.0) == pytest.approx(0.1, rel=1e-9)


def test_free_simulation_and_one_step_prediction_equal_the_recursion_in_original_units() -> None:
    model = Narx(TERMS, TRUTH, (3.0, 2.0), (1.0, 4.0), 0.1)
    rng = np.random.default_rng(0)
    u = 3 + 2 * rng.normal(size=30)
    y = np.full(30, 2.0)
    for t in range(1, 30):
        v = (u[t - 1] - 3) / 2
        x = (y[t - 1] - 1) / 4
        y[t] = 1 + 4 * (0.8 * x + 0.25 * v - 0.05 * v * x)
    assert model.simulate(u, y[:1]) == pytest.approx(y, rel=1e-12)
    assert 1 + 4 * model.one_step((u - 3) / 2, (y - 1) / 4)[1:] == pytest.approx(y[1:], rel=1e-12)
    unstable = Narx(TERMS[:1], (-2.0,), (0.0, 1.0), (0.0, 1.0), 0.1)
    simulated = unstable.simulate(np.zeros(20), np.ones(1))
    assert simulated[:10] == pytest.approx((-2.0) ** np.arange(10))  # up to a thousand spreads
    assert np.isnan(simulated[10:]).all()


def test_scores_and_bootstrap_estimates_ignore_up_to_a_tenth_of_missing_values() -> None:
    y = np.arange(20.0)
    assert module.nrmse_percent(y, y + np.tile([1.0, -1.0], 10)) == pytest.approx(
        100 * (1 - np.sqrt(20 / 665))
    )
    assert module.nrmse_percent(y, np.r_[np.nan, y[1:]]) == 100.0
    assert module.nrmse_percent(y, np.r_[np.full(3, np.nan), y[3:]]) == -np.inf
    draws = [1.0, 2.0, 3.0, 4.0] * 25
    estimate = bootstrap_estimate(2.5, draws)
    assert estimate is not None
    assert estimate.u == pytest.approx(np.sqrt(1.25))
    assert (estimate.low95, estimate.high95) == (1.0, 4.0)
    assert bootstrap_estimate(2.5, [*draws[:89], *[np.nan] * 11]) is None
    assert bootstrap_estimate(2.5, [*draws[:91], *[np.nan] * 9]) is not None
    assert bootstrap_estimate(2.5, []) is None


def test_dead_time_is_removed_from_the_input_and_too_short_a_record_raises() -> None:
    u, y = record(2, 0.0)
    delayed = IOData.from_arrays(u, np.r_[np.full(5, y[0]), y[:-5]], 0.1, hold="zoh")
    result = narx(delayed, degree=1, lags=1, dead_samples=5, held_out=0.3)
    assert result.simulated_percent > 75
    assert result.held_out_percent > 75
    shortest = IOData.from_arrays(u[:58], y[:58], 0.1, hold="zoh")
    assert narx(shortest, degree=1, lags=2).order <= 2  # 40 training samples
    with pytest.raises(InputError, match="39 training samples"):
        narx(IOData.from_arrays(u[:57], y[:57], 0.1, hold="zoh"), degree=1, lags=2)
