"""A delay that drifts along the record, as between two loggers: rate, detection, false alarms.

The records of ``clock_study`` are sums of exponentials at exact times.
"""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.estimation.clock_rate import CLOCK_LIMIT, clock_drift
from tcdyn.identification import Fit, IOData, compare, fit, several, validate
from tests.identify.clock_study import (
    changing_lag,
    has_warning,
    held,
    noise_of,
    response,
    switching_times,
    two_loggers,
)

N = 2000


def rate_and_u(result: Fit) -> tuple[float, float]:
    """Rate of the warning and its standard uncertainty."""
    (found,) = (f for f in validate(result).findings if f.code == "record.clock_drift")
    return 1e-6 * found.numbers["rate_ppm"], 1e-6 * found.numbers["u_ppm"]


@pytest.mark.e2e
@pytest.mark.parametrize(("rate", "model"), [(3e-4, "P1D"), (1e-4, "P1D"), (-3e-4, "P2D")])
def test_the_rate_of_two_clocks_is_found_within_its_uncertainty(rate: float, model: str) -> None:
    noise = noise_of("white", N, 0.2, 1)
    found, u = rate_and_u(fit(two_loggers(rate, N, 1.0, noise, 1), model))
    assert abs(found - rate) < 3 * u
    assert u < 3e-5


def test_the_factor_brings_the_time_of_the_input_to_that_of_the_output() -> None:
    result = fit(two_loggers(-2e-4, N, 1.0, noise_of("white", N, 0.2, 4), 4), "P1D")
    (found,) = (f for f in validate(result).findings if f.code == "record.clock_drift")
    # an event at 1000 s of the input's clock is stamped 999.8 s by that of the output
    assert found.numbers["factor"] * 1000.0 == pytest.approx(999.8, abs=0.05)
    assert found.numbers["change_s"] == pytest.approx(-2e-4 * N, abs=0.1)


def test_a_drift_is_found_below_slow_noise() -> None:
    found, u = rate_and_u(fit(two_loggers(3e-4, N, 1.0, noise_of("ar", N, 0.2, 2), 2), "P1D"))
    assert abs(found - 3e-4) < 3 * u


@pytest.mark.e2e
@pytest.mark.parametrize("kind", ["white", "ar", "drift"])
def test_one_clock_gives_no_warning(kind: str) -> None:
    data = two_loggers(0.0, N, 1.0, noise_of(kind, N, 0.2, 0), 0)
    assert not has_warning(fit(data, "P1D"))


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("kind", ["white", "ar", "drift"])
def test_false_alarms_are_rare(kind: str) -> None:
    count = 60
    alarms = 0
    for seed in range(count):
        data = two_loggers(0.0, N, 1.0, noise_of(kind, N, 0.2, seed), seed)
        alarms += has_warning(fit(data, "P1D"))
    # at 1e-3, two of 60 have a probability of 0.2 %
    assert alarms <= 1


@pytest.mark.e2e
@pytest.mark.parametrize("change", [0.1, 0.3])
def test_a_lag_that_changes_is_no_clock(change: float) -> None:
    noise = noise_of("white", N, 0.2, 0)
    assert not has_warning(fit(changing_lag(N, 1.0, noise, 0, change), "P1D"))


@pytest.mark.e2e
def test_missing_dynamics_are_no_clock() -> None:
    switches_s, levels = switching_times(N, 1.0, 3)
    times_s = np.arange(N, dtype=float)
    slow = response(times_s - 5.0, switches_s, levels, 20.0)
    fast = response(times_s - 5.0, switches_s, levels, 3.0)
    y = (20.0 * slow - 3.0 * fast) / 17.0  # two lags by partial fractions
    data = IOData.from_arrays(held(times_s, switches_s, levels), y, 1.0, hold="zoh")
    noisy = data.with_outputs(data.outputs + noise_of("white", N, 0.2, 3)[:, None])
    result = fit(noisy, "P1")
    assert validate(result).dynamics_missing
    assert not has_warning(result)


@pytest.mark.e2e
def test_a_saturating_gain_is_no_clock() -> None:
    switches_s, levels = switching_times(N, 1.0, 0)
    times_s = np.arange(N, dtype=float)
    y = response(times_s - 5.0, switches_s, levels, 20.0)
    y = y * (1 - 0.002 * y) + noise_of("white", N, 0.2, 0)
    data = IOData.from_arrays(held(times_s, switches_s, levels), y, 1.0, hold="zoh")
    assert not has_warning(fit(data, "P1D"))


@pytest.mark.e2e
def test_the_drift_counts_against_the_recommendation() -> None:
    data = two_loggers(3e-4, N, 1.0, noise_of("white", N, 0.2, 5), 5)
    result = compare(data, "P1D", "P2D")
    assert result.conclusion.code == "models.provisional"
    assert "record.clock_drift" in result.validation.record_problems
    assert "clocks" in result.summary()


@pytest.mark.e2e
def test_two_inputs_of_one_logger_give_one_rate() -> None:
    rate = 3e-4
    stamps_s = np.arange(N, dtype=float)
    inputs = []
    y = noise_of("white", N, 0.2, 6)
    for seed, lag_s in ((6, 20.0), (7, 8.0)):
        switches_s, levels = switching_times(N, 1.0, seed)
        inputs.append(held(stamps_s, switches_s, levels))
        y = y + response(stamps_s / (1 + rate) - 5.0, switches_s, levels, lag_s)
    data = IOData.from_arrays(np.column_stack(inputs), y, 1.0, hold="zoh", input_names=("u1", "u2"))
    found, u = rate_and_u(fit(data, several(["P1D", "P1D"], ("u1", "u2"))))
    assert abs(found - rate) < 3 * u


def test_the_score_has_the_uncertainty_of_regression() -> None:
    rng = np.random.default_rng(0)
    n = 400
    jacobian = rng.normal(size=(n, 3))
    column = rng.normal(size=n) + jacobian[:, 0]
    z = []
    for _ in range(400):
        e = rng.normal(size=n) + 0.5 * jacobian[:, 1]
        found = clock_drift(e, jacobian, column, rng.normal(size=(n, 2)))
        assert found is not None
        z.append(found.rate / found.u)
    # the standard deviation of 400 normal numbers scatters by 3.5 %
    assert abs(np.std(z) - 1) < 4 * 0.035
    assert np.max(np.abs(z)) < CLOCK_LIMIT + 1


def test_a_rate_that_the_fit_takes_up_is_not_estimated() -> None:
    jacobian = np.random.default_rng(1).normal(size=(50, 2))
    assert clock_drift(jacobian[:, 0], jacobian, jacobian @ [1.0, 2.0], jacobian) is None
