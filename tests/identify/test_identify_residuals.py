"""Residual tests against textbook regressions; noise models against their spectra."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from tcdyn.estimation import NoiseModel, Optimum, Status, minimise
from tcdyn.identification import IOData, process
from tcdyn.identification.causality import output_is_setpoint
from tcdyn.identification.disturbance import (
    fit_random_walk,
    input_noise_model,
    noise_bic,
    without_spikes,
)
from tcdyn.identification.level_lag import LevelLagProblem
from tcdyn.identification.models import as_model, several
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.search import make_problem, residual_sd, sort_lags
from tcdyn.identification.validation import (
    MAX_SAMPLING_SHARE,
    drift,
    fit_percent,
    input_correlation,
    off_equilibrium,
    shifted_inputs,
    shifts,
    slow_sampling,
    whiteness,
)

DT = 0.05
N = 240


def random_walk_record(gap: slice | None = None) -> IOData:
    """A record of random walks. The output is missing in ``gap``."""
    rng = np.random.default_rng(4)
    u = rng.normal(size=N).cumsum()
    y = rng.normal(size=N).cumsum()
    if gap:
        y[gap] = np.nan
    return IOData.from_arrays(u, y, DT, hold="foh")


def random_walk_problem(
    name: str = "P1D", gap: slice | None = None, **options: Any
) -> IdentificationProblem:
    """The identification problem of a random-walk record."""
    return make_problem(random_walk_record(gap), process(name, **options), "equilibrium")


def test_whiteness_is_the_ljung_box_statistic_corrected_for_fitted_parameters() -> None:
    """Residuals about their mean have autocovariances -s^2 (n - k)/n from centring alone."""
    e = np.random.default_rng(0).normal(size=100)
    result = whiteness(e, np.zeros((100, 0)), [slice(0, 100)], 0.5, 8)
    sums = np.array([e[k:] @ e[:-k] for k in range(1, 9)])
    z = sums / (e @ e / 100) / np.sqrt(100 - np.arange(1, 9))
    assert result.p == pytest.approx(stats.chi2.sf(z @ z, 8))
    assert result.value == pytest.approx(sums / (e @ e))
    assert result.bound95 == pytest.approx(1.96 * np.sqrt(100 - np.arange(1, 9)) / 100)
    assert result.lags_s == pytest.approx(0.5 * np.arange(1, 9))
    e -= e.mean()
    centred = whiteness(e, np.ones((100, 1)), [slice(0, 100)], 0.5, 8)
    sums = np.array([e[k:] @ e[:-k] for k in range(1, 9)])
    z = (sums / (e @ e / 99) + (100 - np.arange(1, 9)) / 100) / np.sqrt(100 - np.arange(1, 9))
    assert centred.p == pytest.approx(stats.chi2.sf(z @ z, 8))
    by_quarter = whiteness(e, np.ones((100, 1)), [slice(0, 100)], 0.5, 60)
    assert len(by_quarter.value) == 25  # a quarter of the record
    tens = [slice(k, k + 10) for k in range(0, 100, 10)]
    by_segment = whiteness(e, np.ones((100, 1)), tens, 0.5, 60)
    assert len(by_segment.value) == 9  # the largest distance of two samples of a segment


def test_input_test_is_the_f_test_of_regressors_added_to_the_fit() -> None:
    rng = np.random.default_rng(1)
    j = rng.normal(size=(80, 3))
    u = rng.normal(size=(80, 4))
    y = rng.normal(size=80)
    u[:, 0] += 2 * j[:, 1]
    y += 0.3 * u[:, 2]
    e = y - j @ np.linalg.lstsq(j, y, rcond=None)[0]
    regressors = np.column_stack([j, u])
    residual = y - regressors @ np.linalg.lstsq(regressors, y, rcond=None)[0]
    f = ((e @ e - residual @ residual) / 4) / ((residual @ residual) / (80 - 3 - 4))
    result = input_correlation(e, j, u, np.arange(4.0))
    assert result.p == pytest.approx(stats.f.sf(f, 4, 73))
    remaining = u - j @ np.linalg.lstsq(j, u, rcond=None)[0]
    size = np.linalg.norm(u, axis=0)
    assert result.value == pytest.approx(remaining.T @ e / size / np.sqrt(e @ e))
    assert result.bound95 == pytest.approx(
        1.96 * np.linalg.norm(remaining, axis=0) / size / np.sqrt(77)
    )
    # columns that the fit has used already explain nothing more
    assert input_correlation(e, j, j[:, :2], np.arange(2.0)).p == 1.0


def test_input_shifts_cover_up_to_three_lags_before_and_after_each_sample() -> None:
    problem = random_walk_problem()
    lags = shifts(problem, 1.0, 20)
    assert lags[:10].tolist() == list(range(10))
    assert lags[-1] == 60  # 3 s of 0.05 s
    assert np.all(np.diff(lags) > 0)
    assert len(lags) <= 20
    assert shifts(problem, 10.0, 20)[-1] == N // 3
    assert shifts(problem, 0.01, 20)[-1] == 20
    u = problem.segments[0].u
    table = shifted_inputs(problem, np.array([0, 3, -2]))
    assert table[:, 0] == pytest.approx(u - u[0])
    assert table[:, 1] == pytest.approx(np.r_[np.zeros(3), u[:-3] - u[0]])
    assert table[:, 2] == pytest.approx(np.r_[u[2:], u[-1], u[-1]] - u[0])
    zero = shifted_inputs(replace(problem, initial="zero"), np.array([0, 3]))
    assert zero[:, 1] == pytest.approx(np.r_[np.zeros(3), u[:-3]])


@pytest.mark.parametrize(
    ("slope", "flagged"), [(0.6, True), (0.55, False)]
)  # a/sqrt(1 + a^2) = 0.51 and 0.48
def test_drift_is_reported_above_a_quarter_of_the_variance(slope: float, flagged: bool) -> None:
    problem = random_walk_problem(gap=slice(50, 60))
    t = np.flatnonzero(problem.segments[0].measured).astype(float)
    t -= t.mean()
    w = np.random.default_rng(2).normal(size=len(t))
    w -= w.mean()
    w -= t * (t @ w) / (t @ t)
    residual = slope * t / np.linalg.norm(t) + w / np.linalg.norm(w)
    findings = drift(problem, residual)
    assert bool(findings) is flagged
    assert not flagged or findings[0].numbers["correlation"] == pytest.approx(
        slope / np.sqrt(1 + slope**2)
    )


def test_sampling_that_is_slow_for_one_of_two_inputs_is_reported_with_the_interval_needed() -> None:
    u = np.random.default_rng(1).normal(size=(N, 2)).cumsum(axis=0)
    data = IOData.from_arrays(u, u[:, 0], DT, hold="foh", input_names=["heater", "fan"])
    problem = make_problem(data, several(["P2", "P1D"], data.input_names), "equilibrium")
    theta = {"Kp.heater": 1.0, "Tp1.heater": DT, "Tp2.heater": 0.8 * DT}
    theta |= {"Kp.fan": 1.0, "Tp1.fan": 1.2 * DT, "Td.fan": 5.0}
    (finding,) = slow_sampling(problem, problem.vector(theta))
    assert (finding.code, finding.subject) == ("record.slow_sampling", "fan")
    assert finding.numbers["needed_s"] == pytest.approx(MAX_SAMPLING_SHARE * 1.2 * DT)
    theta["Tp1.fan"] = 1.1 * DT / MAX_SAMPLING_SHARE
    assert slow_sampling(problem, problem.vector(theta)) == ()


@pytest.mark.parametrize(("offset", "flagged"), [(-4.5, True), (3.7, False)])
def test_start_off_equilibrium_is_reported_above_four_rms(offset: float, flagged: bool) -> None:
    problem = random_walk_problem()
    residual = np.where(np.arange(N) < 3, offset, np.where(np.arange(N) % 2, 1.0, -1.0))
    findings = off_equilibrium(cast(Any, SimpleNamespace(problem=problem, residual=residual)))
    rms = np.sqrt((3 * offset**2 + N - 3) / N)
    assert bool(findings) is flagged
    if flagged:
        assert findings[0].numbers["times_rms"] == pytest.approx(abs(offset) / rms)
    free = replace(problem, initial="estimated")
    assert off_equilibrium(cast(Any, SimpleNamespace(problem=free, residual=residual))) == ()


def test_fit_percent_uses_the_spread_about_the_mean_and_noise_uses_the_degrees_of_freedom() -> None:
    problem = random_walk_problem()
    y = problem.segments[0].y
    residual = 0.25 * (y - y.mean())
    assert fit_percent(problem, residual) == pytest.approx(75.0)
    optimum = cast(Any, SimpleNamespace(residual=residual, weights=None))
    assert residual_sd(optimum, problem) == pytest.approx(
        np.sqrt(residual @ residual / (N - problem.size))
    )
    weighted = cast(Any, SimpleNamespace(residual=residual, weights=np.full(N, 0.25)))
    assert residual_sd(weighted, problem) == pytest.approx(0.5 * residual_sd(optimum, problem))


def test_noise_of_a_measured_input_has_the_sum_of_both_spectra() -> None:
    """s_y^2 + s_u^2 |H|^2, with H of the lag for first-order hold: (1 - e^-a) and so on, by FFT."""
    tau = 0.4
    gain = 3.0
    sd = 0.5
    output_sd = 0.2
    problem = replace(random_walk_problem("P1"), input_sds=(sd,), noise_sd=output_sd)
    x = problem.vector({"Kp": gain, "Tp1": tau})
    a = np.exp(-DT / tau)
    b0 = 1 - (1 - a) * tau / DT  # first-order hold
    b1 = (1 - a) * tau / DT - a
    share = sd**2 * gain**2 * (b0**2 + (b1 + a * b0) ** 2 / (1 - a**2))
    e = np.full(N, np.sqrt((output_sd**2 + share) * (N - problem.size) / N))
    noise = input_noise_model(problem, x, e)
    w = np.linspace(0.05, 3.1, 40)
    z = np.exp(-1j * w)
    exact = output_sd**2 + sd**2 * gain**2 * np.abs((b0 + b1 * z) / (1 - a * z)) ** 2
    spectrum = (
        np.abs(np.polyval([1.0, *noise.ma][::-1], z) / np.polyval([1.0, *noise.ar][::-1], z)) ** 2
    )
    assert spectrum / spectrum.mean() == pytest.approx(exact / exact.mean(), rel=1e-6)
    assert (noise.starts_at_rest, noise.n_parameters) == (True, 0)
    assert input_noise_model(replace(problem, input_sds=(1e-6,)), x, np.full(N, output_sd)).white


def test_spikes_are_moved_to_the_running_median_and_slow_noise_stays() -> None:
    data = random_walk_record(slice(100, 104))
    problem = make_problem(data, process("P1D"), "equilibrium")
    slow = np.sin(np.arange(N) / 60)  # changes by a sixth of the noise from sample to sample
    residual = (slow + 0.1 * np.random.default_rng(3).normal(size=N))[problem.segments[0].measured]
    residual[[40, 150]] += [3.0, -3.0]
    measured = problem.segments[0].measured
    result = cast(Any, SimpleNamespace(problem=problem, residual=residual))
    shift = (data.runs[0].y - without_spikes(data, result).runs[0].y)[measured, 0]
    assert np.flatnonzero(np.abs(shift) > 1.0).tolist() == [40, 150]
    # tolerance: 4 standard deviations of the noise
    assert shift[[40, 150]] == pytest.approx([3.0, -3.0], abs=0.4)
    other_shifts = np.delete(np.abs(shift), [40, 150])
    assert np.count_nonzero(other_shifts) <= 2


def test_random_walk_plus_white_noise_has_moving_average_steps() -> None:
    """Steps of variance q and white noise r give the MA(1) whose correlation is -r/(q + 2 r)."""
    rng = np.random.default_rng(5)
    q = 0.25
    r = 1.0
    e = np.sqrt(q) * rng.normal(size=6000).cumsum() + np.sqrt(r) * rng.normal(size=6000)
    walk = fit_random_walk(e, [slice(0, 6000)], 0, 1)
    rho = -r / (q + 2 * r)
    c = (1 - np.sqrt(1 - 4 * rho**2)) / (2 * rho)
    assert walk.ar == (-1.0,)
    assert walk.ma[0] == pytest.approx(c, abs=4 * np.sqrt((1 - c**2) / 6000))
    assert (walk.starts_at_rest, walk.n_parameters, walk.is_random_walk) == (True, 1, True)
    white = rng.normal(size=200)
    assert noise_bic(white, [slice(0, 200)], NoiseModel()) == pytest.approx(
        200 * np.log(white @ white / 200)
    )
    ar1 = NoiseModel(ar=(-0.5,))
    w = ar1.whiten(white, [slice(0, 200)])
    assert noise_bic(white, [slice(0, 200)], ar1) == pytest.approx(
        200 * np.log(w @ w / 200) - np.log(1 - 0.25) + np.log(200)
    )


def test_setpoint_columns_are_recognised_by_repeated_values() -> None:
    rng = np.random.default_rng(6)
    constant_steps = np.repeat(rng.normal(size=24), 10)
    moving = rng.normal(size=N)
    for u, y, flagged in (
        (moving, constant_steps, True),
        (constant_steps, moving, False),
        (moving, moving + 1, False),
        (constant_steps, constant_steps + 1, False),
    ):
        data = IOData.from_arrays(u, y, DT, hold="foh")
        assert output_is_setpoint(make_problem(data, process("P1D"), "equilibrium")) is flagged


def test_level_dependent_lag_follows_the_level_and_reduces_to_the_exponential() -> None:
    """tau(y) = tau exp(a (y - middle)/half): half a range above the middle the lag is e^a times as
    long."""
    problem = random_walk_problem("P2")
    level_lag = LevelLagProblem(cast(Any, SimpleNamespace(problem=problem)), 10.0, 4.0)
    drive = np.full(50, 12.0)
    assert level_lag.simulate_lag(2.0, drive, 0.1, 0.0) == pytest.approx(
        12.0 - 10.0 * np.exp(-0.1 * np.arange(51))
    )
    y = level_lag.simulate_lag(14.0, np.full(1, 0.0), 0.1, 0.3)
    assert y[1] == pytest.approx(14.0 * np.exp(-0.1 * np.exp(-0.3)))
    far = level_lag.simulate_lag(1e6, np.full(1, 0.0), 0.1, 0.3)
    assert far[1] == pytest.approx(1e6 * np.exp(-0.1 * np.exp(-5.0)))
    x = np.append(problem.vector({"Kp": 1.0, "Tp1": 2.0, "Tp2": 0.5}), 0.3)
    assert [level_lag.lag_s(x, level) for level in (-1.0, 0.0, 1.0)] == pytest.approx(
        [2 * np.exp(-0.3) + 0.5, 2.5, 2 * np.exp(0.3) + 0.5]
    )


def test_problem_gives_the_longest_dead_time_and_the_noise_colour_of_an_equation_error() -> None:
    problem = random_walk_problem("P1D")
    assert problem.longest_segment_s == pytest.approx(N * DT)
    assert problem.delay_max_s == pytest.approx(0.5 * N * DT)
    assert problem.max_delay_samples == N // 2 + 1
    assert random_walk_problem("P1").max_delay_samples == 0
    fixed = replace(problem, model=process("P1D", fixed={"Td": 0.22}))
    assert fixed.max_delay_samples == 6  # 4.4 samples
    assert replace(problem, model=process("P1D", delay_max_s=1.0)).delay_max_s == 1.0
    arx = replace(problem, model=as_model("ARX(1,2)"))
    a1 = 0.8 + 0.3
    a2 = 0.8 * 0.3
    x = arx.vector({"b0": 1.0, "b1": 0.0, "a1": a1, "a2": a2})
    p = np.exp(-DT / 0.8)
    q = np.exp(-DT / 0.3)
    assert arx.pole_polynomial(x) == pytest.approx([-(p + q), p * q])
    measured = replace(problem, input_sds=(0.5,), noise_sd=2.0)
    assert measured.prior_precision[measured.prior_precision > 0] == pytest.approx([16.0])


def test_sort_lags_orders_lags_from_the_longest_with_their_slopes() -> None:
    problem = random_walk_problem("P3")
    x = problem.vector({"Kp": 1.0, "Tp1": 0.1, "Tp2": 0.9, "Tp3": 0.4})
    core = problem.least_squares_problem()
    size = problem.size
    j = np.arange(2.0 * size).reshape(2, size)
    unsorted = Optimum(core, x, np.zeros(2), j, 0.0, j.T @ j, np.eye(size), Status.CONVERGED, 1)
    result = sort_lags(problem, unsorted)
    theta = problem.theta(result.theta)
    assert [theta[n] for n in ("Tp1", "Tp2", "Tp3")] == pytest.approx([0.9, 0.4, 0.1])
    assert result.jacobian[0, :4].tolist() == [0.0, 2.0, 3.0, 1.0]
    assert result.information == pytest.approx(result.jacobian.T @ result.jacobian)
    bounded = replace(problem, limits={"Tp1": (0.05, 0.2)})
    assert sort_lags(bounded, unsorted) is unsorted


def test_search_is_free_in_every_direction_so_that_sort_lags_need_not_reorder_them() -> None:
    problem = random_walk_problem("P1")
    optimum = minimise(problem.least_squares_problem(), problem.vector({"Kp": 1.0, "Tp1": 0.5}))
    np.testing.assert_array_equal(optimum.directions, np.eye(problem.size))
