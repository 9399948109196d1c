"""Functions that users of other identification packages expect: pickling, resampling, priors,
prediction, nonparametric estimates and test inputs."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid
from scipy.signal import lfilter
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identification import (
    IOData,
    compare,
    fit,
    fit_function,
    fit_response,
    from_control,
    impulse_response,
    prbs_input,
    predict,
    process,
    simulate,
    spectral_estimate,
    step_input,
    transfer,
)
from tcdyn.identification.identified import read_identified
from tcdyn.identification.models import as_model
from tcdyn.identification.nonparametric import hold_response
from tests.identify.identify_cases import static_gain

TRUTH = {"Kp": 2.0, "Tp1": 0.8, "Td": 0.13}
DT_S = 0.1


def switched_input(n: int, rng: np.random.Generator, held: int = 10) -> Array:
    """Random switching between 0 and 10 (N,)."""
    return np.repeat(rng.integers(0, 2, n // held + 1) * 10.0, held)[:n]


def record(n: int = 400, noise_sd: float = 0.2, seed: int = 0) -> IOData:
    """Record of the first-order system TRUTH with white noise."""
    rng = np.random.default_rng(seed)
    u = switched_input(n, rng)
    y = simulate(process("P1D").rational(TRUTH), u, DT_S, "zoh")
    return IOData.from_arrays(u, y + rng.normal(0, noise_sd, n), DT_S, hold="zoh")


@pytest.mark.parametrize(
    ("model", "options"),
    [
        (process("P1D"), {}),
        (process("P1D"), {"noise": (1, 0), "baseline": "trend"}),
        (process("P1D"), {"noise": "slow", "baseline": "none"}),
        (process("P1D"), {"loss": "bisquare"}),
        (transfer(1, 2, delay=True), {}),
    ],
)
def test_unpickled_fit_is_the_same_and_can_still_be_evaluated(model: Any, options: Any) -> None:
    data = record()
    result = fit(pickle.loads(pickle.dumps(data)), model, **options)
    copy = pickle.loads(pickle.dumps(result))
    assert copy.summary() == result.summary()
    rows = copy.optimum.problem.evaluate(copy.x)
    np.testing.assert_array_equal(rows[0], result.optimum.residual)


def test_unpickled_comparison_has_the_same_summary() -> None:
    comparison = compare(record(), "P1", "P1D")
    assert pickle.loads(pickle.dumps(comparison)).summary() == comparison.summary()


@pytest.mark.e2e
def test_resampled_record_has_the_same_dynamics_and_no_aliases() -> None:
    rng = np.random.default_rng(1)
    slow = {"Kp": 2.0, "Tp1": 8.0, "Td": 1.3}
    u = switched_input(4000, rng, held=40)
    y = simulate(process("P1D").rational(slow), u, DT_S, "zoh") + rng.normal(0, 0.2, 4000)
    coarse = IOData.from_arrays(u, y, DT_S, hold="zoh").resample(0.4)
    result = fit(coarse, "P1D")
    assert coarse.hold == "foh"
    for name, value in slow.items():
        estimate = result.estimates[name]
        assert abs(estimate.value - value) < 4 * estimate.u
        assert estimate.u < 0.01 * value
    t = np.arange(4000) * DT_S
    above_nyquist = IOData.from_arrays(np.sin(t), np.sin(2 * np.pi * 3.0 * t), DT_S).resample(0.25)
    assert np.abs(above_nyquist.runs[0].y[20:-20]).max() < 1e-3
    np.testing.assert_allclose(
        above_nyquist.runs[0].u[20:-20, 0], np.sin(above_nyquist.times_s()[20:-20]), atol=2e-3
    )


def test_resampling_to_a_shorter_interval_keeps_hold_and_gaps() -> None:
    y = np.array([0.0, 1.0, np.nan, 3.0, 4.0])
    data = IOData.from_arrays([0.0, 5.0, 5.0, 0.0, 1.0], y, 1.0, hold="zoh").resample(0.5)
    assert data.runs[0].u[:, 0].tolist() == [0, 0, 5, 5, 5, 5, 0, 0, 1]
    expected = [0, 0.5, 1, np.nan, np.nan, np.nan, 3, 3.5, 4]
    np.testing.assert_allclose(data.runs[0].y[:, 0], expected)


def test_resampling_leaves_no_value_near_a_gap() -> None:
    y = np.ones(100)
    y[50] = np.nan
    data = IOData.from_arrays(np.ones(100), y, 0.1).resample(0.4)
    assert np.flatnonzero(np.isnan(data.runs[0].y[:, 0])).tolist() == [12, 13]


def test_detrend_removes_a_line_from_each_run_and_leaves_gaps() -> None:
    t = np.arange(200.0)
    wave = np.sin(2 * np.pi * t / 10) - np.polyval(np.polyfit(t, np.sin(2 * np.pi * t / 10), 1), t)
    y = wave + 5 + 0.2 * t
    y[7] = np.nan
    first = IOData.from_arrays(t, y, 1.0)
    second = IOData.from_arrays(t, wave - 3, 1.0)
    flat = first.merge(second).detrend(1, "outputs")
    np.testing.assert_allclose(flat.runs[0].y[8:, 0], wave[8:], atol=0.02)
    np.testing.assert_allclose(flat.runs[1].y[:, 0], wave, atol=1e-9)
    assert np.isnan(flat.runs[0].y[7, 0])
    np.testing.assert_array_equal(flat.runs[0].u, first.runs[0].u)


def test_merge_of_unequal_intervals_names_the_remedy() -> None:
    fine = record()
    coarse = fine.resample(0.5)
    with pytest.raises(InputError, match="resample"):
        coarse.merge(fine)
    assert len(coarse.merge(fine.resample(0.5)).runs) == 2


@pytest.mark.e2e
def test_control_systems_are_compared_as_they_stand() -> None:
    data = record()
    system = control.tf([2.0], [0.8, 1.0])
    named = compare(data, system, "P1D").table["model"].tolist()
    assert sorted(named) == ["P1D", "TF(0,1) as given"]
    state_space = compare(data, [control.ss(system), "P1D"])
    row = state_space.table.set_index("model").loc["TF(0,1) as given"]
    reference = compare(data, from_control(system), "P1D").table.set_index("model")
    assert row["BIC"] == pytest.approx(reference.loc["TF(0,1) as given", "BIC"])


def test_prediction_error_has_the_variance_of_the_noise_so_many_samples_ahead() -> None:
    n = 4000
    pole = 0.9
    rng = np.random.default_rng(4)
    u = switched_input(n, rng)
    noise = lfilter([0.3], [1.0, -pole], rng.standard_normal(n))
    y = simulate(process("P1D").rational(TRUTH), u, DT_S, "zoh") + noise
    data = IOData.from_arrays(u, y, DT_S, hold="zoh")
    result = fit(data, "P1D", noise=(1, 0), baseline="none")
    for steps in (1, 2, 5, None):
        prediction = predict(result, data, steps)
        error = y - prediction.output[0]
        variance = 0.09 * (1 - pole ** (2 * (steps or n))) / (1 - pole**2)
        # the variance of a sample variance of AR(1) noise: 2/n (1 + pole^2)/(1 - pole^2)
        assert np.var(error) / variance == pytest.approx(1, abs=4 * np.sqrt(2 / n * 9.5))
        assert prediction.fit_percent == pytest.approx(100 * (1 - error.std() / y.std()), abs=0.1)


def test_prediction_of_a_function_is_refused() -> None:
    """A function of its parameters has no model of the noise."""
    u = np.repeat([0.0, 1.0], 50)
    data = IOData.from_arrays(u, 2.0 * u, 0.1, hold="zoh")
    fitted = fit_function(data, static_gain, {"gain": 1.0})
    with pytest.raises(InputError, match="FunctionFit"):
        predict(fitted, data)  # type: ignore[arg-type]


def test_prediction_uses_no_output_of_the_last_samples() -> None:
    data = record(n=200)
    result = fit(data, "P1D", noise=(1, 0), baseline="none", initial="zero")
    y = data.runs[0].y[:, 0].copy()
    y[150] += 1e-3
    changed = IOData.from_arrays(data.runs[0].u, y, DT_S, hold="zoh")
    before, after = (predict(result, d, 3).output[0] for d in (data, changed))
    change = np.abs(after - before)
    # the offset, which is fitted to all samples, changes by about 1e-3/200 everywhere
    assert change[150:153].max() < 2e-5
    assert change[153] > 5 * change[152]


def test_prediction_leaves_out_missing_inputs_and_simulates_missing_outputs() -> None:
    data = record(n=300)
    u, y = (a[:, 0].copy() for a in (data.runs[0].u, data.runs[0].y))
    y[100:110] = np.nan
    u[200:210] = np.nan
    gappy = IOData.from_arrays(u, y, DT_S, hold="zoh")
    result = fit(gappy, "P1D", noise=(1, 0), baseline="none")
    output = predict(result, gappy).output[0]
    assert np.flatnonzero(np.isnan(output)).tolist() == list(range(200, 210))
    simulated = predict(result, gappy, None).output[0]
    np.testing.assert_array_equal(output[100:110], simulated[100:110])


def test_impulse_response_is_that_of_a_first_order_lag_within_its_band() -> None:
    # held input: gain (1 - a) a^(i - 1) from the second sample on, a = exp(-dt/lag)
    n = 80
    decay = np.exp(-DT_S / 0.8)
    weights = 2.0 * (1 - decay) * decay ** np.arange(-1.0, n - 1)
    weights[0] = 0.0
    z = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        u = switched_input(800, rng, held=2)
        noise = lfilter([0.2], [1.0, -0.8], rng.standard_normal(800))
        y = np.convolve(u - u[0], weights)[:800] + noise + 30
        table = impulse_response(IOData.from_arrays(u, y, DT_S, hold="zoh"), n)
        z.append((table["value"] * DT_S - weights) / (table["u"] * DT_S))
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.25
    assert abs(np.mean(z)) < 0.3


def test_impulse_response_of_each_input_is_separated_over_gaps() -> None:
    rng = np.random.default_rng(5)
    u = rng.choice([0.0, 1.0], (400, 2))
    y = 10 + 2 * np.roll(u[:, 0], 1) - 3 * np.roll(u[:, 1], 3)
    y[100:120] = np.nan
    u[200:210, 0] = np.nan
    data = IOData.from_arrays(u, y, 1.0, input_names=["heater", "fan"])
    table = impulse_response(data, 5).set_index("input")["value"]
    np.testing.assert_allclose(table["heater"], [0, 2, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(table["fan"], [0, 0, 0, -3, 0], atol=1e-9)
    steady = IOData.from_arrays(np.repeat([0.0, 1.0], 50), np.repeat([0.0, 1.0], 50), 1.0)
    with pytest.raises(InputError, match="determine"):
        impulse_response(steady[:60], 20)


def test_spectral_estimate_scatters_as_its_uncertainty_says() -> None:
    z = []
    for seed in range(8):
        response = spectral_estimate(record(n=4000, noise_sd=1.0, seed=seed), window_s=40.0)
        s = 2j * np.pi * response.frequency_Hz
        true = 2.0 * np.exp(-0.13 * s) / (1 + 0.8 * s)
        error = (response.response - true) / response.part_uncertainty(true)
        z += [*error.real, *error.imag]
    assert 0.9 < np.sqrt(np.mean(np.square(z))) < 1.2
    fitted = fit_response(response, "P1D")
    for name, value in TRUTH.items():
        assert abs(fitted.theta[name] - value) < 4 * fitted.estimates[name].u


def test_hold_response_is_the_fourier_integral_of_the_hold_function() -> None:
    """One sample is held for one interval (zoh), or is a triangle of two intervals (foh)."""
    frequency_Hz = np.array([0.0, 0.7, 3.0, 5.0])
    t = np.linspace(-DT_S, DT_S, 20_001)
    for hold, shape in (("zoh", (t >= 0).astype(float)), ("foh", 1 - np.abs(t) / DT_S)):
        data = IOData.from_arrays(np.arange(20.0), np.arange(20.0), DT_S, hold=hold)
        kernel = np.exp(-2j * np.pi * frequency_Hz[:, None] * t)
        integral = trapezoid(shape * kernel, t, axis=1) / DT_S
        # the step of the zero-order hold lies within one of 10000 intervals
        np.testing.assert_allclose(hold_response(frequency_Hz, data), integral, atol=1e-4)


def test_spectral_estimate_of_a_held_and_of_a_linear_input_agree() -> None:
    rng = np.random.default_rng(6)
    ends = np.repeat(rng.normal(0, 1, 500), 8)
    u = lfilter([0.2], [1.0, -0.8], ends)
    for hold in ("zoh", "foh"):
        y = simulate(process("P1D").rational(TRUTH), u, DT_S, hold)
        response = spectral_estimate(IOData.from_arrays(u, y, DT_S, hold=hold), window_s=80.0)
        s = 2j * np.pi * response.frequency_Hz
        true = 2.0 * np.exp(-0.13 * s) / (1 + 0.8 * s)
        assert np.abs(response.response / true - 1).max() < 0.05


def test_binary_sequence_has_power_over_the_range_of_lags() -> None:
    table = prbs_input((1.0, 10.0), 0.1, (-1.0, 1.0))
    u = table["u"].to_numpy()
    clock = int(np.diff(np.flatnonzero(np.diff(u))).min())
    bits = u[::clock]
    # a sequence of maximum length is balanced to one bit, and its autocorrelation is -1/N
    spectrum = np.abs(np.fft.fft(bits)) ** 2
    assert abs(bits.sum()) == 1
    np.testing.assert_allclose(spectrum[1:], len(bits) + 1)
    assert table["time_s"].iloc[-1] >= 2 * np.pi * 3 * 10
    # half power, sinc^2, at twice the inverse of the shortest lag
    assert np.sinc(2 / (2 * np.pi * 1.0) * clock * 0.1) ** 2 >= 0.5
    with pytest.raises(InputError):
        prbs_input((0.1, 1.0), 0.5, (0, 1))


def test_steps_are_held_until_the_output_has_settled() -> None:
    table = step_input(2.0, 0.5, [0, 10, 0])
    y = simulate(process("P1").rational({"Kp": 1.0, "Tp1": 2.0}), table["u"], 0.5, "zoh")
    assert abs(y[39] - 10) < 0.1
    assert abs(y[59]) < 0.1


def test_prior_of_a_gain_gives_the_conjugate_posterior() -> None:
    rng = np.random.default_rng(7)
    u = rng.normal(0, 1, 200)
    y = 1.5 * u + 20 + rng.normal(0, 2.0, 200)
    data = IOData.from_arrays(u, y, 1.0, hold="zoh")
    options: Any = {"noise": "white", "baseline": "none", "initial": "equilibrium"}
    result = fit(data, "P0", prior={"Kp": (1.0, 0.1)}, input_noise=0.0, **options)
    centred = u - u.mean()
    free = centred @ y / (centred @ centred)
    residual = y - y.mean() - free * centred
    precision = centred @ centred / (residual @ residual / 198)
    posterior = (free * precision + 1.0 / 0.01) / (precision + 1 / 0.01)
    estimate = result.estimates["Kp"]
    # the noise is that of the residuals at the posterior, a little larger
    assert estimate.value == pytest.approx(posterior, abs=0.05 * estimate.u)
    assert estimate.u == pytest.approx((precision + 1 / 0.01) ** -0.5, rel=0.02)


def test_a_prior_that_the_data_contradict_is_reported() -> None:
    """A lag of 0.8 s with priors that are right, or wrong and narrow or wide."""
    data = record()
    options: Any = {"noise": "white", "baseline": "none"}
    for mean, u in ((0.8, 0.1), (0.8, 0.002), (0.6, 0.2), (0.6, 0.02), (0.6, 0.01)):
        codes = [f.code for f in fit(data, "P1D", prior={"Tp1": (mean, u)}, **options).findings]
        is_wrong = mean == 0.6 and u < 0.1
        assert ("fit.prior_conflict" in codes) == is_wrong, (mean, u)


def test_exact_prior_of_a_lag_is_as_good_as_fixing_it() -> None:
    data = record(n=150, noise_sd=0.5, seed=8)
    options: Any = {"noise": "white", "baseline": "none"}
    by_prior = fit(data, "P1D", prior={"Tp1": (0.8, 1e-5)}, **options).estimates
    fixed = fit(data, process("P1D", fixed={"Tp1": 0.8}), **options).estimates
    for name in ("Kp", "Td"):
        assert by_prior[name].value == pytest.approx(fixed[name].value, abs=1e-3 * fixed[name].u)
        assert by_prior[name].u == pytest.approx(fixed[name].u, rel=0.02)


def test_bounds_leave_an_optimum_inside_and_report_one_outside() -> None:
    data = record()
    free = fit(data, "P1D")
    inside = fit(data, "P1D", bounds={"Tp1": (0.5, 5.0), "Td": (0.0, 1.0)})
    assert inside.estimates["Tp1"].value == pytest.approx(free.estimates["Tp1"].value, rel=1e-5)
    outside = fit(data, "P1D", bounds={"Tp1": (1.0, 5.0)})
    assert outside.estimates["Tp1"].value == pytest.approx(1.0)
    assert [f.code for f in outside.findings] == ["fit.bound"]
    for wrong in ({"Tp2": (1.0, 2.0)}, {"Tp1": (2.0, 1.0)}):
        with pytest.raises(InputError):
            fit(data, "P1D", bounds=wrong)


def test_weights_use_the_quiet_half_of_a_record() -> None:
    n = 400
    sd = np.where(np.arange(n) < n // 2, 0.1, 3.0)
    errors = []
    z = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        u = switched_input(n, rng)
        y = simulate(process("P1D").rational(TRUTH), u, DT_S, "zoh") + sd * rng.normal(size=n)
        y[300] = 1e6  # a wrong value, of weight zero
        weights = sd**-2.0
        weights[300] = 0
        data = IOData.from_arrays(u, y, DT_S, hold="zoh")
        estimates = fit(data, "P1D", weights=weights, noise="white").estimates
        errors += [estimates[name].value - value for name, value in TRUTH.items()]
        z += [(estimates[n].value - value) / estimates[n].u for n, value in TRUTH.items()]
    assert np.max(np.abs(errors)) < 0.05
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.4


@pytest.mark.e2e
def test_weights_stay_with_a_disturbance_that_is_fitted() -> None:
    n = 400
    rng = np.random.default_rng(9)
    u = switched_input(n, rng)
    sd = np.where(np.arange(n) < n // 2, 0.05, 3.0)
    y = simulate(process("P1D").rational(TRUTH), u, DT_S, "zoh") + sd * rng.normal(size=n)
    data = IOData.from_arrays(u, y + 0.01 * np.arange(n), DT_S, hold="zoh")
    for options in ({"baseline": "trend"}, {"noise": "slow"}):
        estimates = fit(data, "P1D", weights=sd**-2.0, **options).estimates
        for name, value in TRUTH.items():
            assert abs(estimates[name].value - value) < 0.01 * value + 0.005
    for wrong in ({"baseline": "walk"}, {"loss": "huber"}):
        with pytest.raises(InputError, match="weights"):
            fit(data, "P1D", weights=sd**-2.0, **wrong)
    with pytest.raises(InputError, match="weights"):
        fit(data, "P1D", weights=np.ones(3))


def first_order(p: dict[str, float], data: IOData) -> list[Array]:
    """First-order lag from equilibrium with a held input, by its difference equation."""
    outputs = []
    for run in data.runs:
        u = run.u[:, 0]
        decay = np.exp(-data.dt_s / p["Tp1"])
        response = lfilter([0.0, 1 - decay], [1.0, -decay], u - u[0])
        outputs.append(p["offset"] + p["Kp"] * (u[0] + response))
    return outputs


def test_function_of_a_lag_is_fitted_as_the_process_model() -> None:
    rng = np.random.default_rng(10)
    u = switched_input(300, rng)
    y = first_order({"Kp": 2.0, "Tp1": 0.8, "offset": 20.0}, IOData.from_arrays(u, u, DT_S))[0]
    y = y + rng.normal(0, 0.3, 300)
    y[120:130] = np.nan
    data = IOData.from_arrays(u, y, DT_S, hold="zoh")
    data = data[:14.95].merge(data[15.0:])
    start = {"Kp": 1.0, "Tp1": 0.3, "offset": 0.0}
    result = fit_function(data, first_order, start)
    same = fit(data, "P1", noise="white", baseline="none", initial="equilibrium")
    for name in ("Kp", "Tp1"):
        estimate = result.estimates[name]
        expected = same.estimates[name]
        assert estimate.value == pytest.approx(expected.value, abs=1e-3 * expected.u)
        assert estimate.u == pytest.approx(expected.u, rel=0.02)
    assert result.rms == pytest.approx(same.identified.statistics["rms"], rel=1e-6)
    at_bound = fit_function(data, first_order, start, bounds={"Tp1": (0.1, 0.5)})
    assert at_bound.estimates["Tp1"].value == pytest.approx(0.5)
    assert [f.code for f in at_bound.findings] == ["fit.bound"]


def test_function_of_a_nonlinear_system_is_recovered_within_its_intervals() -> None:
    # a tank: dh/dt = k u - c sqrt(h); the record by an adaptive integrator, the model by Heun steps
    truth = {"k": 0.5, "c": 0.8}
    dt_s = 0.05
    rng = np.random.default_rng(11)
    u = 2 + switched_input(600, rng, held=40) / 5

    def rate(t: float, h: Array) -> Array:
        return truth["k"] * u[min(int(t / dt_s + 1e-9), 599)] - truth["c"] * np.sqrt(h)

    t = np.arange(600) * dt_s
    h0 = (0.5 * u[0] / 0.8) ** 2
    level = solve_ivp(rate, (0, t[-1]), [h0], t_eval=t, rtol=1e-8, max_step=dt_s).y[0]

    def tank(p: dict[str, float], data: IOData) -> list[Array]:
        h = np.empty(600)
        h[0] = p["h0"]
        for i, inflow in enumerate(data.runs[0].u[:-1, 0]):
            first = p["k"] * inflow - p["c"] * np.sqrt(max(h[i], 0.0))
            second = p["k"] * inflow - p["c"] * np.sqrt(max(h[i] + dt_s * first, 0.0))
            h[i + 1] = h[i] + 0.5 * dt_s * (first + second)
        return [h]

    data = IOData.from_arrays(u, level + rng.normal(0, 0.05, 600), dt_s, hold="zoh")
    result = fit_function(data, tank, {"k": 1.0, "c": 1.0, "h0": 1.0}, {"h0": (0.0, 100.0)})
    for name, value in {**truth, "h0": h0}.items():
        estimate = result.estimates[name]
        assert abs(estimate.value - value) < 4 * estimate.u
        assert estimate.u < 0.02 * value


def test_function_with_outputs_of_another_length_is_refused() -> None:
    data = record(n=100)
    with pytest.raises(InputError, match="shapes"):
        fit_function(data, lambda p, d: [np.ones(3)], {"a": 1.0})
    with pytest.raises(InputError, match="start"):
        fit_function(data, lambda p, d: [np.full(100, np.nan)], {"a": 1.0})
    with pytest.raises(InputError, match="bounds"):
        fit_function(data, first_order, {"Kp": 1.0}, {"Tp1": (0.0, 1.0)})


def test_model_of_sysidentpy_is_scored_by_free_simulation() -> None:
    decay = np.exp(-DT_S / 0.8)
    rng = np.random.default_rng(12)
    u = switched_input(400, rng)
    exact = first_order({"Kp": 2.0, "Tp1": 0.8, "offset": 0.0}, IOData.from_arrays(u, u, DT_S))[0]
    y = exact + rng.normal(0, 0.2, 400)
    data = IOData.from_arrays(u, y, DT_S, hold="zoh")
    narx = FROLS(
        ylag=1,
        xlag=1,
        n_terms=2,
        order_selection=False,
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=1),
    )
    narx.fit(X=u[:280, None], y=y[:280, None])
    comparison = compare(data, "P1", narx)
    assert comparison.recommended == "P1"
    row = comparison.table.set_index("model").loc["FROLS, 1"]
    # the recursion itself, from the terms that were selected: y(k-1), u(k-1)
    codes = narx.final_model.max(axis=1).tolist()
    weights = dict(zip(codes, np.ravel(narx.theta)))
    simulated = y.copy()
    for k in range(1, 400):
        simulated[k] = weights[1001] * simulated[k - 1] + weights[2001] * u[k - 1]
    error = (y - simulated)[280:]
    assert decay == pytest.approx(weights[1001], abs=0.05)
    assert row["held_out_rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.01)
    assert "FROLS, 1" in comparison.summary()


def test_resampling_to_a_shorter_interval_holds_the_held_input_only() -> None:
    u = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    data = IOData.from_arrays(u, u[:, 0], 1.0, hold=("zoh", "foh")).resample(0.5)
    assert data.runs[0].u.T.tolist() == [[0, 0, 1, 1, 2], [0, 0.5, 1, 1.5, 2]]
    assert data.holds == ("zoh", "foh")


def test_a_model_is_written_and_read_again(tmp_path: Path) -> None:
    model = from_control(control.tf([2.0], [0.75, 1.0]), delay_s=0.1)
    path = model.write(tmp_path / "heater.identified.json")
    assert read_identified(path).theta == model.theta
    with pytest.raises(InputError):
        model.write(tmp_path / "heater.csv")


def test_names_of_models_of_other_tools_are_refused_with_those_of_this_one() -> None:
    with pytest.raises(InputError, match=r"TF\(zeros,poles\)"):
        as_model("OE(2,2,1)")
