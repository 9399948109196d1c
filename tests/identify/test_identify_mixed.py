"""Spikes, drifts, coloured noise and gaps in one record: requested options are used, and stated
intervals cover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from disturbance_study import disturbance, fine
from identify_cases import CASE_A, PLAIN
from scipy.signal import lfilter

from tcdyn.core.findings import warning
from tcdyn.identification import IOData, fit
from tcdyn.identification.models import as_model, several
from tcdyn.identification.validation import confirm

TRUTH = {"Kp": 2.0, "Tp1": 0.8, "Td": 0.13}
DT_S = 0.1
N = 500


def delayed_response(u: np.ndarray) -> np.ndarray:
    """Exact response of gain 2, lag 0.8 s and dead time 0.13 s to ``u`` held.
    A sample sees the input before last through exp(-0.07/0.8) of an interval, and the one before it
    through the remainder."""
    a = np.exp(-DT_S / 0.8)
    fraction = np.exp(-0.07 / 0.8)
    padded = np.concatenate([np.full(3, u[0]), u])
    lag_input = (1 - fraction) * padded[1 : 1 + len(u)] + (fraction - a) * padded[: len(u)]
    return 2.0 * (lfilter([1.0], [1.0, -a], lag_input - u[0] * (1 - a)) + u[0])


def record(
    seed: int,
    drift: float = 0.0,
    spikes: int = 0,
    ar: float = 0.0,
    walk: float = 0.0,
    every: int = 0,
) -> IOData:
    """Held levels 0 and 1 with white noise of 0.02 or AR(1) noise with such steps.
    Optional: a drift over the record, a random walk, spikes of +0.6, and every ``every``-th output
    missing."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.integers(0, 2, N // 10), 10).astype(float)
    y = (
        delayed_response(u)
        + lfilter([1.0], [1.0, -ar], rng.normal(0, 0.02, N))
        + drift * np.arange(N) / N
    )
    y += np.cumsum(rng.normal(0, walk, N)) if walk else 0.0
    y[rng.choice(N, spikes, replace=False)] += 0.6
    if every:
        y[::every] = np.nan
    return IOData.from_arrays(u, y, DT_S, hold="zoh")


@pytest.mark.study
def test_robust_fit_with_a_drift_covers_the_true_values():
    """With the weights of the fit without the drift, 36 % of the intervals cover."""
    results = [
        fit(
            record(seed, 1.0, 15),
            "P1D",
            loss="huber",
            baseline="trend",
            noise="white",
            initial="equilibrium",
        )
        for seed in range(16)
    ]
    # of 48; fewer occur once in 250
    assert sum(f.estimates[n].contains(v) for f in results for n, v in TRUTH.items()) >= 41
    # the spikes, not the drift, get low weights
    assert all(f.weights is not None and np.sum(f.weights < 0.3) >= 15 for f in results)


@pytest.mark.e2e
def test_robust_fit_with_a_noise_model_passes_the_input_test():
    """The inputs of the test must be weighted as the residuals are; otherwise p is below 0.01 in
    all runs."""
    p = [
        fit(
            record(seed, 0.0, 15),
            "P1D",
            loss="huber",
            noise=(1, 0),
            baseline="none",
            initial="equilibrium",
        ).identified.statistics["p_input"]
        for seed in range(8)
    ]
    assert min(p) > 1e-3
    assert np.sum(np.array(p) < 0.05) <= 2


def test_options_requested_by_name_are_used_even_for_white_residuals():
    assert fit(
        record(1), "P1D", noise="auto", baseline="trend", initial="equilibrium"
    ).problem.trend
    result = fit(record(1), "P1D", noise="ar", baseline="auto", initial="equilibrium")
    assert result.noise.order == (1, 0)
    for noise in ("auto", "slow"):
        assert fit(
            record(1), "P1D", noise=noise, baseline="walk", initial="equilibrium"
        ).noise.is_random_walk


@pytest.mark.study
@pytest.mark.parametrize("drift", [5.0, -30.0])
@pytest.mark.parametrize("options", [{"baseline": "trend"}, {"noise": "auto", "baseline": "auto"}])
def test_drift_larger_than_the_response_is_separated_from_it(drift, options):
    """Started only at the optimum without a drift, a drift of 5 gives a gain of -84 +- 39."""
    for seed in range(3):
        result = fit(record(seed, drift), "P1D", **options)
        for name, value in TRUTH.items():
            assert result.estimates[name].value == pytest.approx(
                value, abs=4 * result.estimates[name].u
            )


def test_new_data_with_slow_noise_confirm_the_true_model():
    """With the covariance of white noise 5 of 40 would be rejected at the 1 % level."""
    n_shifted = 0
    for seed in range(30):
        result = fit(
            record(seed, ar=0.95), "P1D", start=TRUTH, check=False, intervals="quadratic", **PLAIN
        )
        n_shifted += any(
            f.code == "validation.moved"
            for f in confirm(result, record(500 + seed, ar=0.95)).findings
        )
    assert n_shifted <= 2  # of 30; three or more occur once in 300


def test_models_without_free_parameters_and_robust_models_can_be_confirmed():
    result = fit(record(1), replace(as_model("P1D"), fixed=TRUTH), **PLAIN)
    assert "does not contradict" in confirm(result, record(2)).sentence
    robust = fit(record(1, spikes=15), "P1D", loss="huber", **PLAIN)
    assert "robust loss" not in confirm(robust, record(2, spikes=5)).sentence


def test_missing_dynamics_warning_names_the_input():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.integers(0, 2, (N // 10, 2)), 10, axis=0).astype(float)
    u[0] = 0.0  # start at rest
    # two lags, of which one is fitted
    fan = lfilter([1 - np.exp(-0.05)], [1.0, -np.exp(-0.05)], delayed_response(u[:, 1]))
    data = IOData.from_arrays(
        u,
        delayed_response(u[:, 0]) + fan + 0.02 * rng.normal(size=N),
        DT_S,
        hold="zoh",
        input_names=["heat", "fan"],
    )
    sentence = fit(
        data, several(["P1D", "P1"], ["heat", "fan"]), check=False, **PLAIN
    ).identified.sentence
    assert "still follow the input fan (" in sentence
    single_input = warning(
        "residuals.follow_input", subject="P1", fit_percent=1.0, p_input=0.0, lag_s=1.0
    )
    assert "input (" in single_input.sentence


@pytest.mark.study
@pytest.mark.parametrize("baseline", [pytest.param("walk", marks=pytest.mark.long), "auto"])
def test_spikes_on_a_random_walk_are_distinguished_from_its_peaks(baseline):
    """With weights by the size of the residuals, peaks count as spikes, and 40 % of the intervals
    cover the lag."""
    covered = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        u, y = fine("PRBS", rng)
        noise = disturbance("walk", rng) + np.where(
            rng.random(800) < 0.03, 10 * rng.normal(size=800), 0.0
        )
        result = fit(
            IOData.from_arrays(u, y + noise, 0.05, hold="zoh"),
            "P2D",
            loss="huber",
            baseline=baseline,
            noise="white" if baseline == "walk" else "auto",
            start=CASE_A,
            check=False,
            intervals="quadratic",
            initial="equilibrium",
        )
        covered += [result.estimates["Kp"].contains(1.0), result.identified.lag_s.contains(2.87)]
        assert result.identified.lag_s.u < 0.07
    assert np.mean(covered) > 0.75  # of 16, nominal 0.95
