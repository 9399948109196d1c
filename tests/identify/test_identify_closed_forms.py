"""Frequency responses, records and model responses against closed forms, in any unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import (
    Identified,
    IOData,
    Response,
    bode_band,
    fit,
    fit_response,
    process,
    roots_of,
    several,
    transfer,
)
from tcdyn.identification.frequency import levy, longest_delay_s, starts, weighted_problem
from tcdyn.identification.heldout import split_held_out
from tcdyn.identification.iodata import check_wrap
from tcdyn.identification.models import Model, as_model
from tcdyn.identification.responses import slowest_time_constant_s, step_band, step_time_grid
from tcdyn.identification.search import make_problem
from tcdyn.identification.segments import clipped_samples, input_noise_sd, split_segments

F = np.geomspace(0.01, 1.0, 15)
S = 2j * np.pi * F


def model_with_uncertainty(
    model: Model, theta: dict[str, float], u: float = 0.1, **attributes: float
) -> Identified:
    """A model whose free parameters each have the uncertainty ``u``, independently."""
    return Identified(
        model, theta, u**2 * np.eye(len(model.free)), {}, **{"dt_s": 0.0, **attributes}
    )


def test_levy_regression_recovers_a_noise_free_response_for_any_weight() -> None:
    num = np.array([2.0, 0.6])
    den = np.array([1.0, 1.3, 0.9])
    h = (num[0] + num[1] * S) / (1 + den[1] * S + den[2] * S**2)
    result = levy(S, h, 1 / np.abs(h) ** 2, 1, 2)
    assert result[0] == pytest.approx(num)
    assert result[1] == pytest.approx(den)


@pytest.mark.parametrize("name", ["P1D", "P2UZ", "P1H", "P1I", "TF(1,2)D"])
def test_starts_from_a_response_do_not_depend_on_the_time_unit(name: str) -> None:
    model = as_model(name)
    h = 3.0 * np.exp(-0.3 * S) / (1 + 1.5 * S) / (S if model.integrators else 1.0)
    in_seconds = Response(F, h, 0.02 * np.abs(h))
    in_minutes = Response(60 * F, 7 * h, 0.14 * np.abs(h))
    for x, z in zip(starts(in_seconds, model), starts(in_minutes, model), strict=True):
        for n, v in model.theta(z).items():
            power = int(n[1:]) if n[0] in "ab" else 1 if n[0] == "T" else 0
            gain = 7 * (60 if model.integrators else 1) if n[0] in "Kb" else 1.0
            assert v == pytest.approx(gain * model.theta(x)[n] / 60**power, rel=1e-4, abs=1e-9), n
    problem = weighted_problem(in_seconds, model)
    scaled_problem = weighted_problem(in_minutes, model)
    for i, n in enumerate(model.free):
        for bound, scaled_bound in (
            (problem.lower[i], scaled_problem.lower[i]),
            (problem.upper[i], scaled_problem.upper[i]),
        ):
            if n == "Td":
                assert scaled_bound == pytest.approx(bound / 60)
            elif n[0] == "T" and n != "Tz":
                assert scaled_bound == pytest.approx(bound - np.log(60))
    assert longest_delay_s(in_seconds) == pytest.approx(0.5 / min(F[0], F[1] - F[0]))


def test_uncertainty_of_a_transfer_estimate_follows_bendat_and_piersol() -> None:
    """u = |H| sqrt((1 - g2)/(2 n g2)). Without stated uncertainties all parts share an equal value
    above a floor."""
    g2 = np.linspace(0.5, 0.9, 15)
    data = Response.of(
        F, magnitude=2 * np.ones(15), phase_deg=np.full(15, 90.0), coherence=g2, averages=8
    )
    assert data.response == pytest.approx(np.full(15, 2j))
    assert data.part_uncertainty() == pytest.approx(2 * np.sqrt((1 - g2) / (16 * g2)))
    assert data.part_uncertainty(np.full(15, 3.0 + 4.0j)) == pytest.approx(
        2.5 * data.part_uncertainty()
    )
    without_u = Response(F, np.full(15, 3.0 + 4.0j), floor=12.0)
    assert without_u.part_uncertainty() == pytest.approx(np.full(15, 13.0))
    for averages, message in ((0.5, "coherence"), (None, "coherence")):
        with pytest.raises(InputError, match=message):
            Response.of(
                F, magnitude=np.ones(15), phase_deg=np.zeros(15), coherence=g2, averages=averages
            )


def test_fitted_gain_has_the_statistics_of_a_weighted_mean() -> None:
    """Real parts of a gain K with u: K is their weighted mean; chi-squared and criteria are those
    of the textbook."""
    rng = np.random.default_rng(0)
    u = np.linspace(0.1, 0.3, 15)
    h = 2.0 / (1 + 1.5 * S) + u * (rng.normal(size=15) + 1j * rng.normal(size=15))
    result = fit_response(Response(F, h, u), process("P1", fixed={"Tp1": 1.5}))
    shape = 1 / (1 + 1.5 * S)
    precision = np.sum(np.abs(shape) ** 2 / u**2)
    gain = np.sum((np.conj(shape) * h).real / u**2) / precision
    assert result.theta["Kp"] == pytest.approx(gain)
    assert result.estimates["Kp"].u == pytest.approx(precision**-0.5)
    error = np.abs(h - gain * shape)
    chi2 = np.sum(error**2 / u**2)
    statistics = result.statistics
    assert statistics["bic"] == pytest.approx(chi2 + np.log(30))
    assert statistics["aicc"] == pytest.approx(chi2 + 2 + 4 / 28)
    assert statistics["rms"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert result.noise_sd == pytest.approx(statistics["rms"] / np.sqrt(2))
    assert statistics["fit_percent"] == pytest.approx(
        100 * (1 - np.linalg.norm(error) / np.linalg.norm(h - h.mean()))
    )
    misfit = fit_response(Response(F, h, u / 4), process("P1", fixed={"Tp1": 1.5}))
    # widened by the ratio of the residuals to the stated uncertainty
    expected_u = precision**-0.5 * np.sqrt(chi2 / 29)
    assert misfit.estimates["Kp"].u == pytest.approx(expected_u)
    assert [f.code for f in misfit.findings] == ["response.misfit"]
    assert misfit.findings[0].numbers["ratio"] == pytest.approx(4 * np.sqrt(chi2 / 29))


def test_lag_step_and_bode_bands_follow_from_the_derivatives() -> None:
    """K = 2 +- 0.1, tau = 0.5 +- 0.1 s, Td = 0.3 +- 0.1 s."""
    g = model_with_uncertainty(process("P1D"), {"Kp": 2.0, "Tp1": 0.5, "Td": 0.3})
    assert g.lag_s.value == pytest.approx(0.8)
    assert g.lag_s.u == pytest.approx(0.1 * np.sqrt(2))
    t = np.linspace(0, 3, 31)
    band = step_band(g, t)
    age = np.maximum(t - 0.3, 0.0)
    e = np.exp(-age / 0.5)
    slopes = np.stack([1 - e, -2 * age * e / 0.25, -2 * e / 0.5])
    after = t > 0.35
    assert band.value == pytest.approx(2 * (1 - e))
    assert band.u[after] == pytest.approx(0.1 * np.linalg.norm(slopes, axis=0)[after])
    assert band.high95 - band.low95 == pytest.approx(2 * 1.96 * band.u, rel=1e-4)
    f = np.array([0.1, 0.5])
    w = 2 * np.pi * f
    bode = bode_band(g, np.array([0.1, 0.5]))
    assert bode.magnitude_dB.value == pytest.approx(20 * np.log10(2 / np.sqrt(1 + (0.5 * w) ** 2)))
    assert bode.phase_deg.value == pytest.approx(-np.degrees(np.arctan(0.5 * w) + 0.3 * w))
    # d ln|G|/dtau, up to its sign; the phase has w/(1 + (w tau)^2)
    tau_sensitivity = 0.5 * w**2 / (1 + (0.5 * w) ** 2)
    assert bode.magnitude_dB.u == pytest.approx(
        20 / np.log(10) * 0.1 * np.hypot(0.5, tau_sensitivity)
    )
    assert bode.phase_deg.u == pytest.approx(
        np.degrees(0.1 * np.hypot(w / (1 + (0.5 * w) ** 2), w))
    )
    lead = model_with_uncertainty(process("P1Z"), {"Kp": 2.0, "Tp1": 0.5, "Tz": 0.2})
    assert lead.lag_s.value == pytest.approx(0.3)
    assert lead.lag_s.u == pytest.approx(0.1 * np.sqrt(2))
    tf = model_with_uncertainty(transfer(1, 1), {"b0": 2.0, "b1": 0.6, "a1": 0.5})
    assert tf.lag_s.u == pytest.approx(0.1 * np.sqrt(1 + 0.25 + (0.6 / 4) ** 2))


def test_default_ranges_cover_eight_slowest_lags_and_two_decades_about_the_corner() -> None:
    g = model_with_uncertainty(process("P2D"), {"Kp": 2.0, "Tp1": 0.5, "Tp2": 4.0, "Td": 0.3})
    assert slowest_time_constant_s(g.rational) == pytest.approx(4.0)
    assert step_time_grid(g, 10) == pytest.approx(np.linspace(0, 0.3 + 32.0, 11))
    corner = 1 / (2 * np.pi * 4.0)
    assert bode_band(g).magnitude_dB.x[[0, -1]] == pytest.approx([corner / 100, 100 * corner])
    sampled = replace(g, dt_s=0.5)
    corner = 1 / (2 * np.pi * 4.8)  # of the total lag
    assert bode_band(sampled).magnitude_dB.x[[0, -1]] == pytest.approx([corner / 100, 1.0])
    integrating = model_with_uncertainty(process("P1I"), {"Kp": 2.0, "Tp1": 0.5}, dt_s=0.5)
    assert bode_band(integrating).magnitude_dB.x[[0, -1]] == pytest.approx([0.002, 1.0])


def test_covariance_of_zeros_and_complex_pairs_follows_from_the_parameters() -> None:
    """For a zero -1/Tz it is u/Tz^2. A pair w (-z +- i sqrt(1 - z^2)) moves along its own
    direction if only w varies."""
    model = process("P2UZ", fixed={"Zeta": 0.6})
    roots = roots_of(model_with_uncertainty(model, {"Kp": 2.0, "Tz": 0.5, "Tw": 0.25, "Zeta": 0.6}))
    zero = next(r for r in roots if r.kind == "zero")
    assert zero.value == pytest.approx(-2.0)
    assert zero.covariance[0, 0] == pytest.approx((0.1 / 0.25) ** 2)
    for pole in (r for r in roots if r.kind == "pole"):
        assert abs(pole.value) == pytest.approx(4.0)
        assert pole.value.real == pytest.approx(-2.4)
        sd_direction = 0.1 * 16 * np.array([-0.6, np.sign(pole.value.imag) * 0.8])
        assert pole.covariance == pytest.approx(np.outer(sd_direction, sd_direction))


def test_record_is_sliced_by_time_and_the_held_out_part_is_its_end() -> None:
    data = IOData.from_arrays(np.arange(100.0), np.arange(100.0), 0.1, start_s=5.0)
    assert data.times_s()[[0, -1]] == pytest.approx([5.0, 14.9])
    section = data.between(6.0, 7.0)
    assert (section.runs[0].start_s, section.n_samples) == (pytest.approx(6.0), 11)
    assert section.runs[0].u[0, 0] == 10.0
    assert data.between(5.95, 7.05).n_samples == 11
    assert data.between(None, 5.0).n_samples == 1
    train, test, from_s = split_held_out(data, 0.25)
    assert train is not None
    assert test is data
    assert train.times_s()[-1] < from_s < train.times_s()[-1] + 0.1
    assert train.n_samples == 75  # three quarters of 99 intervals: 74.25
    assert data.duration_s == pytest.approx(10.0)
    two_runs = data.merge(
        IOData.from_arrays(np.arange(50.0), np.r_[np.full(5, np.nan), np.arange(45.0)], 0.1)
    )
    assert (two_runs.n_samples, two_runs.n_missing, two_runs.duration_s) == (
        150,
        5,
        pytest.approx(10.0),
    )
    first, last, _ = split_held_out(two_runs, 0.3)
    assert first is not None
    assert (first.n_samples, last.n_samples) == (100, 50)
    for share in (0.0, 1.0):
        with pytest.raises(InputError, match="held_out"):
            split_held_out(data, share)


def test_segments_keep_past_inputs_and_short_segments_are_skipped() -> None:
    y = np.arange(60.0)
    # the input moves by 100 within each gap: when it moved is not known
    u = y + 100.0 * np.searchsorted([20, 30, 38], y, side="right")
    u[[20, 21, 22, 30, 38]] = np.nan  # 0..19, 23..29 (seven samples), 31..37 (seven), 39..59
    segments = split_segments(IOData.from_arrays(u, y, 0.5, start_s=2.0))
    assert [(s.start_s, len(s.y), s.after_gap) for s in segments] == [
        (2.0, 20, False),
        (21.5, 21, True),
    ]
    # gaps are interpolated linearly
    assert segments[1].last_inputs(3).tolist() == [
        236.0,
        237.0,
        288.0,
    ]
    assert segments[1].last_inputs(41)[:3].tolist() == [0.0, 0.0, 0.0]
    assert segments[0].last_inputs(2).tolist() == [0.0, 0.0]
    u[[30, 38]] = (230.0, 338.0)
    merged = split_segments(IOData.from_arrays(u, y, 0.5))
    assert [len(s.y) for s in merged] == [20, 37]
    # a short gap over which the input does not move is interpolated; a long one is not
    held = np.ones(60)
    held[[20, 21]] = np.nan
    held[40:50] = np.nan
    bridged = split_segments(IOData.from_arrays(held, y, 0.5))
    assert [len(s.y) for s in bridged] == [40, 10]
    assert np.all(bridged[0].u == 1.0)


@pytest.mark.parametrize(("sd", "detected"), [(0.01, True), (1e-4, False), (0.3, False)])
def test_input_noise_is_estimated_from_fourth_differences_within_limits(
    sd: float, detected: bool
) -> None:
    """Fourth differences of white noise have 70 times its variance and remove a slow swing. Noise
    above a tenth of the swing counts as input."""
    t = np.arange(2000) * 0.01
    u = np.sin(t) + sd * np.random.default_rng(1).normal(size=2000) + (t > 10)
    segments = split_segments(IOData.from_arrays(u, u, 0.01))
    estimate = input_noise_sd(segments)
    assert estimate == (pytest.approx(sd, rel=0.08) if detected else 0.0)


@pytest.mark.parametrize(
    ("values", "bits"),
    [
        ([65000, 65500, 100], 16),
        ([32000, 32700, -32700], 16),
        ([4.29e9, 10.0], 32),
        ([40000, 100], 0),
        ([-70000, 65500, 100], 0),
        ([65000.5, 100], 0),
        ([0, 65536 + 100], 0),
    ],
)
def test_integer_overflow_is_distinguished_from_a_jump(values: list[float], bits: int) -> None:
    if bits:
        with pytest.raises(InputError, match=f"{bits}-bit integer"):
            check_wrap(np.array(values, dtype=float), "u", "here")
    else:
        check_wrap(np.array(values, dtype=float), "u", "here")


def test_sum_of_models_has_order_bounds_and_scale_per_input() -> None:
    """The order is that of the largest component. A lag is bounded by a hundredth of a sample and
    a hundred records."""
    rng = np.random.default_rng(2)
    u = rng.normal(size=(50, 2))
    y = rng.normal(size=50)
    model = several(["P2D", "P1"], ["u1", "u2"])
    assert model.order == 2
    problem = make_problem(IOData.from_arrays(u, y, 0.2), model, "equilibrium")
    lower, upper = problem.bounds()
    bounds = {n: (lower[i], upper[i]) for i, n in enumerate(model.free)}
    assert bounds["Tp1.u2"] == pytest.approx((np.log(0.002), np.log(1000.0)))
    assert bounds["Td.u1"] == pytest.approx((0.0, 5.0))
    assert bounds["Kp.u1"] == (-np.inf, np.inf)
    x = problem.vector(dict.fromkeys(model.names, 0.5))
    scale = dict(zip(model.free, problem.natural_scale(x)))
    assert (scale["Tp1.u1"], scale["Kp.u1"], scale["Td.u1"]) == pytest.approx((0.5, 1.0, 1.0))


def test_clipped_samples_are_those_that_an_output_enters_and_leaves_abruptly() -> None:
    t = np.arange(400) * 0.1
    noise = np.random.default_rng(2).normal(0, 0.05, len(t))
    wave = 10 * np.sin(0.5 * t) + noise
    clipped = np.minimum(wave, 8.0)
    assert np.array_equal(clipped_samples(clipped), wave >= 8.0)
    assert not clipped_samples(wave).any()
    resting = np.where(t < 10, 0.0, 5 * (1 - np.exp(-(t - 10))))  # at rest, then a step
    assert not clipped_samples(resting).any()
    coarse = np.round(10 * np.sin(0.5 * t))
    assert not clipped_samples(coarse).any()
    assert not clipped_samples(np.full(50, 3.0)).any()


@pytest.mark.e2e
def test_clipped_samples_do_not_reduce_the_gain() -> None:
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([0.0, 1.0], 40), 25)
    y = np.zeros(len(u))
    for k in range(1, len(u)):  # one lag of 20 samples, gain 10
        y[k] = y[k - 1] + (10 * u[k - 1] - y[k - 1]) * (1 - np.exp(-1 / 20))
    y = np.minimum(y + rng.normal(0, 0.1, len(u)), 6.0)
    result = fit(IOData.from_arrays(u, y, 1.0, hold="zoh"), "P1")
    assert result.estimates["Kp"].value == pytest.approx(10.0, abs=0.1)
    assert result.estimates["Tp1"].value == pytest.approx(20.0, abs=0.5)
    assert "clipped" in result.identified.sentence


def test_time_constant_of_the_length_of_the_record_is_reported() -> None:
    t = np.arange(200) * 0.1
    u = (t >= 1).astype(float)
    noise = np.random.default_rng(1).normal(0, 1e-4, len(t))
    for tau, is_slow in ((30.0, True), (3.0, False)):  # the record lasts 20 s
        y = np.where(t >= 1, 1 - np.exp(-(t - 1) / tau), 0.0) + noise
        result = fit(
            IOData.from_arrays(u, y, 0.1, hold="zoh"), "P1", noise="white", baseline="none"
        )
        assert ("fit.slow_pole" in {f.code for f in result.findings}) is is_slow


def test_units_of_parameters_are_powers_of_the_second() -> None:
    model = as_model("TF(1,2)")
    units = {name: model.unit(name) for name in model.names}
    assert units == {"b0": "", "b1": "s", "a1": "s", "a2": "s^2"}
    process = as_model("P2DZ")
    units = {name: process.unit(name) for name in process.names}
    assert units == {"Kp": "", "Tp1": "s", "Tp2": "s", "Tz": "s", "Td": "s"}
