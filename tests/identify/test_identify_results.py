"""Residual tests, order selection, uncertainty bands, NARX, the command line, and real data."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import typer
from identify_cases import CASE_A, PLAIN, case_a, case_a_input, data_dir

from tcdyn.core.errors import InputError
from tcdyn.identification import (
    Identified,
    IOData,
    bode_band,
    compare,
    confirm,
    fit,
    from_frame,
    percent_times,
    process,
    simulate,
    step_band,
    validate,
)
from tcdyn.identification.narx import temperature_dependence
from tcdyn.identification.recommendation import recommend


def test_residual_tests_reject_one_lag_despite_a_high_fit_percentage():
    # high fit percentages, 94 to 99 %, yet errors of 4 to 21 degC when such a model recovers a
    # faster record
    one_lag, delayed, correct = (fit(case_a("plunge", 0), m, **PLAIN) for m in ("P1", "P1D", "P2D"))
    assert one_lag.identified.statistics["fit_percent"] > 90
    assert delayed.identified.statistics["fit_percent"] > 98
    for wrong in (one_lag, delayed):
        v = validate(wrong)
        assert v.whiteness.p < 1e-4
        assert "coloured" in v.sentence or "misses dynamics" in v.sentence
    assert validate(one_lag).dynamics_missing
    v = validate(correct)
    assert v.whiteness.p > 0.01
    assert v.input.p > 0.01
    assert "does not contradict" in v.sentence


def test_bounds_of_the_input_correlation_account_for_fitted_parameters():
    # lagged copies of a smooth input lie almost in the span of the sensitivities, where residuals
    # cannot follow them: with the textbook bound 1.96/sqrt(N) a wrong model would pass there
    v = validate(fit(case_a("plunge", 0), "P2D", **PLAIN))
    assert np.max(v.input.bound95) < 0.3 * 1.96 / np.sqrt(800)
    assert np.mean(np.abs(v.input.value) < v.input.bound95) > 0.7


@pytest.mark.study
def test_false_alarm_rates_of_both_residual_tests_are_near_nominal():
    p = []
    for seed in range(100):
        data = case_a("PRBS", 5000 + seed)
        s = fit(
            data, "P2D", start=CASE_A, intervals="quadratic", check=False, **PLAIN
        ).identified.statistics
        p.append((s["p_white"], s["p_input"]))
    alarms = np.mean(np.array(p) < 0.05, axis=0)
    # nominal 5 %, standard error 2.2 % over 100 runs: within three; the 2000-run study is marked
    # slow
    assert np.all(alarms < 0.115)


@pytest.mark.study
def test_comparison_recommends_the_true_structure_by_bic():
    c = compare(case_a("PRBS", 3), ["P1", "P1D", "P2", "P2D", "P2Z"])
    assert c.recommended == "P2D"
    assert list(c.table["BIC"]) == sorted(c.table["BIC"])
    assert "BIC" in c.reason_text
    assert c.best.problem.model.name == "P2D"
    # the noise; the standard deviation of its estimate is 0.02
    assert c.table["held_out_rms"].iloc[0] == pytest.approx(0.5, abs=0.06)


def test_smaller_model_with_nearly_the_same_bic_is_preferred():
    table = pd.DataFrame(
        {
            "model": ["P2D", "P1D"],
            "parameters": [5, 4],
            "BIC": [100.0, 101.0],
            "held_out_rms": [1.0, 1.0],
            "block_rms": [1.0, 1.0],
            "determined": [True, True],
            "p_input": [0.5, 0.5],
            "p_white": [0.5, 0.5],
        }
    )
    assert recommend(table)[0] == "P1D"
    # held-out errors decide only where the residuals show that no model is complete
    smaller_error = table.assign(held_out_rms=[0.8, 1.0], block_rms=[0.8, 1.0])
    assert recommend(smaller_error)[0] == "P1D"
    assert recommend(smaller_error.assign(p_white=0.001))[0] == "P2D"


def test_held_out_run_may_be_another_recording():
    data = case_a("PRBS", 1).merge(case_a("PRBS", 2))
    c = compare(data, ["P1D", "P2D"], held_out=case_a("PRBS", 9), **PLAIN)
    assert c.recommended == "P2D"


def test_percent_times_of_one_lag_equal_the_closed_form():
    model = fit(case_a("PRBS", 0), "P1D", **PLAIN).identified
    times = percent_times(model)
    tau = model.theta["Tp1"]
    delay = model.theta["Td"]
    for name, share in (("t50", 0.5), ("t63.2", 1 - np.exp(-1)), ("t90", 0.9)):
        k = -np.log(1 - share)
        # tolerance: linear interpolation on a grid of 1/500 of the lag
        assert times[name].value == pytest.approx(delay + k * tau, rel=2e-4)
        gradient = np.array([0.0, k, 1.0])
        assert times[name].u == pytest.approx(
            model.standard_uncertainty(gradient[:, None])[0], rel=1e-2
        )


@pytest.mark.study
def test_uncertainty_bands_have_their_nominal_coverage():
    true_model = process("P2D").rational(CASE_A)
    f = np.geomspace(0.01, 1.0, 12)
    t = np.arange(200) * 0.05
    step = simulate(true_model, np.ones(200), 0.05, "zoh", "zero")
    g = 20 * np.log10(np.abs(true_model.frequency_response(f)))
    covered = []
    for seed in range(60):
        model = fit(
            case_a("PRBS", 300 + seed),
            "P2D",
            start=CASE_A,
            intervals="quadratic",
            check=False,
            **PLAIN,
        ).identified
        b = bode_band(model, f).magnitude_dB
        s = step_band(model, t)
        times = percent_times(model)["t90"]
        covered.append(
            [
                np.mean((b.low95 <= g) & (g <= b.high95)),
                np.mean((s.low95 <= step + 1e-9) & (step - 1e-9 <= s.high95)),
                times.contains(float(np.interp(0.9, step, t))),
            ]
        )
    # pointwise 95 %; neighbouring points are correlated, so the error of each mean is that of 60
    # samples: 2.8 %
    assert np.all(np.mean(covered, axis=0) > 0.95 - 3 * 0.028)


def test_frequency_sensitivity_equals_central_differences():
    model = process("P2DZ")
    delay = {**CASE_A, "Tz": 0.2}
    f = np.array([0.02, 0.2, 1.0])
    rows = model.chain_rule(delay).T @ model.rational(delay).frequency_sensitivity(f)
    for i, name in enumerate(model.names):
        h = 1e-6
        up, down = ({**delay, name: delay[name] + s * h} for s in (1, -1))
        difference = (
            model.rational(up).frequency_response(f) - model.rational(down).frequency_response(f)
        ) / (2 * h)
        assert np.allclose(rows[i], difference, atol=1e-8)


def quantised(seed: int) -> IOData:
    """A step of 6 K through one lag and a dead time, logged in steps of 0.1 K with almost no
    noise."""
    rng = np.random.default_rng(seed)
    u = (np.arange(240) >= 20) * 1.0
    y = 20 + 0.1 * rng.random() + simulate(process("P1D").rational(QUANTISED), u, 0.5, "zoh")
    return IOData.from_arrays(
        u, 0.1 * np.round(10 * (y + 0.01 * rng.normal(size=240))), 0.5, hold="zoh"
    )


QUANTISED = {"Kp": 6.0, "Tp1": 4.0, "Td": 1.2}


@pytest.mark.study
def test_intervals_of_a_rounded_output_include_its_rounding():
    fits = [fit(quantised(seed), "P1D", **PLAIN) for seed in range(40)]
    covered = [[f.estimates[n].contains(v) for n, v in QUANTISED.items()] for f in fits]
    # 95 % less two standard errors over 40 records; the intervals must also be narrow enough to be
    # useful
    assert np.all(np.mean(covered, axis=0) > 0.95 - 2 * 0.035)
    assert np.mean([f.estimates["Tp1"].u for f in fits]) < 0.1
    assert all("steps of 0.1" in f.identified.sentence for f in fits)
    assert "steps" not in fit(case_a("PRBS", 0), "P2D", **PLAIN).identified.sentence


def test_drift_of_the_output_is_reported():
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([0.0, 10.0], 25), 60)
    plant = process("P1D").rational({"Kp": 1.0, "Tp1": 15.0, "Td": 4.0})
    y = simulate(plant, u, 1.0, "zoh") + 0.1 * rng.normal(size=1500)
    for slope in (0.0, 0.004):
        data = IOData.from_arrays(u, y + slope * np.arange(1500), 1.0, hold="zoh")
        v = validate(fit(data, "P1D", intervals="quadratic", **PLAIN))
        assert ("fit with baseline=trend" in v.sentence) == (slope > 0)
        assert v.record_problems == (("record.drift",) if slope else ())


def test_feedback_is_distinguished_from_missing_dynamics():
    """In closed loop the controller responds to the noise, so the input follows it. In open loop
    the same plant gives no warning."""
    rng = np.random.default_rng(3)
    n = 2000
    lag = np.exp(-1 / 20)
    gain = 2.0
    setpoint = np.repeat(rng.choice([0.0, 5.0, 10.0], n // 100), 100)
    for closed in (True, False):
        u = np.zeros(n)
        y = np.zeros(n)
        x = 0.0
        noise = 0.0
        total = 0.0
        for k in range(n):
            noise = 0.97 * noise + 0.12 * rng.normal()
            y[k] = x + noise
            error = setpoint[k] - (y[k] if closed else x)
            total += error / 15
            u[k] = 1.5 * (error + total)
            x = lag * x + (1 - lag) * gain * u[max(k - 3, 0)]
        data = IOData.from_arrays(u, y, 1.0, hold="zoh")
        result = fit(
            data, "P1D", initial="estimated", check=not closed, noise="white", baseline="none"
        )
        sentence = result.identified.sentence
        assert ("feedback" in sentence) == closed


def test_undetermined_gain_gives_a_warning():
    """The record ends after a tenth of the lag, so only the ratio of gain and lag is observed."""
    t = np.arange(200) * 0.05
    y = 5 * (1 - np.exp(-np.clip(t - 1, 0, None) / 100)) + 0.1 * np.random.default_rng(0).normal(
        size=200
    )
    result = fit(IOData.from_arrays((t > 1) * 1.0, y, 0.05, hold="zoh"), "P1", **PLAIN)
    assert any(w.startswith("Kp is hardly determined") for w in result.warnings)


@pytest.mark.study
def test_new_data_confirm_the_model_and_a_changed_system_is_reported():
    """On 40 pairs of records from one system the three tests each alarm in 1 %. A lag 10 % longer
    is detected."""
    alarms = np.zeros(3)
    for seed in range(40):
        result = fit(
            case_a("PRBS", seed), "P2D", start=CASE_A, check=False, intervals="quadratic", **PLAIN
        )
        confirmation = confirm(result, case_a("PRBS", 1000 + seed))
        shifted = any(f.code == "validation.moved" for f in confirmation.findings)
        alarms += [confirmation.whiteness.p < 0.01, confirmation.input.p < 0.01, shifted]
    assert np.all(alarms <= 3)  # of 40; four or more occur once in 700 studies
    u, hold = case_a_input("PRBS", np.random.default_rng(5))
    y = simulate(process("P2D").rational({**CASE_A, "Tp1": 2.2}), u, 0.05, hold)
    noise = 0.5 * np.random.default_rng(6).normal(size=len(u))
    changed_system = confirm(result, IOData.from_arrays(u, y + noise, 0.05, hold=hold))
    assert "give other parameters" in changed_system.sentence
    coarse = fit(case_a("PRBS", 0), "P1D", check=False, intervals="quadratic", **PLAIN)
    assert confirm(coarse, case_a("PRBS", 1)).dynamics_missing


def test_summary_gives_the_correlations_of_the_parameters():
    model = fit(case_a("PRBS", 0), "P2D", start=CASE_A, check=False, **PLAIN).identified
    sd = np.sqrt(np.diag(model.covariance))
    assert model.correlation.at["Tp2", "Td"] == pytest.approx(
        model.covariance[2, 3] / sd[2] / sd[3]
    )
    assert f"Tp2-Td {model.correlation.at['Tp2', 'Td']:.2f}" in model.summary()


def test_narx_rejects_gaps_and_names_the_alternative():
    data = case_a("PRBS", 0)
    y = data.runs[0].y.copy()
    y[5] = np.nan
    with pytest.raises(InputError, match="fit\\(\\)"):
        temperature_dependence(IOData.from_arrays(data.runs[0].u, y, 0.05))


@pytest.mark.long
@pytest.mark.study
@pytest.mark.filterwarnings("ignore")
def test_narx_reports_whether_the_lag_depends_on_temperature():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(20, 180, 60), 30)
    results = []
    for slope in (0.0, 0.5):
        y = np.empty(len(u))
        y[0] = u[0]
        for k in range(len(u) - 1):
            tau = 0.5 + slope * (y[k] - 20) / 160
            y[k + 1] = y[k] + 0.05 / tau * (u[k] - y[k])
        noisy = y + 0.1 * rng.normal(size=len(u))
        results.append(
            temperature_dependence(IOData.from_arrays(u, noisy, 0.05, hold="zoh"), lags=2)
        )
    constant, varying = results
    assert not constant.depends
    assert "No sign" in constant.sentence
    assert varying.depends
    # true lag at the levels used: 0.5 + 0.5 (level - 20)/160
    for level, lag in zip(varying.lag.levels, (varying.lag.low.value, varying.lag.high.value)):
        # tolerance: the model is quadratic, 1/tau(T) is not
        assert lag == pytest.approx(0.5 + 0.5 * (level - 20) / 160, rel=0.08)
    # one step ahead both models look perfect, which is why scores are of simulation
    assert constant.linear.one_step_percent > 97


@pytest.mark.e2e
def test_identify_command_writes_model_and_page(tmp_path, capsys):
    from tcdyn.cli.identify import identify

    data = case_a("PRBS", 3)
    path = tmp_path / "data.csv"
    pd.DataFrame(
        {"time_s": data.times_s(), "u": data.runs[0].u[:, 0], "y": data.runs[0].y[:, 0]}
    ).to_csv(path, index=False)
    identify([path], ["u"], ["y"], hold=["zoh"], model=["P1D", "P2D", "TF(0,2)D"])
    printed = capsys.readouterr().out
    assert "Recommended: P2D" in printed
    assert "Tp2" in printed
    model = Identified.from_json((tmp_path / "data.identified.json").read_text(encoding="utf-8"))
    assert model.theta["Td"] == pytest.approx(0.37, abs=0.03)
    page = (tmp_path / "data.identified.html").read_text(encoding="utf-8")
    assert "Residuals" in page
    assert page.count("data:image/png") == 3
    swapped = {"input": ["y"], "output": ["u"], "hold": ["zoh"], "model": ["P1D"], "quiet": True}
    with pytest.raises(InputError, match="check=False"):
        identify([path], **swapped)
    with pytest.raises(typer.Exit) as exit_info:
        identify([path], **swapped, check=False)
    assert exit_info.value.exit_code == 1
    assert "error: data.csv: None of these models is good enough" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"hold is .linear."):
        identify([path], ["u"], ["y"], hold=["linear"])


needs_data = pytest.mark.skipif(
    data_dir() is None, reason="reference data not present: set TCDYN_DATA"
)


@pytest.mark.study
@needs_data
def test_daisy_heating_system_is_better_described_by_squared_voltage():
    a = np.loadtxt(data_dir() / "daisy" / "heating_system.dat")
    scores = {}
    for name, power in (("voltage", 1), ("voltage squared", 2)):
        data = IOData.from_arrays(
            a[:, 1] ** power, a[:, 2], 2.0, hold="zoh", name="DaISy heating system"
        )
        scores[name] = compare(
            data, ["P1", "P1D", "P2Z", "P2DZ"], initial="estimated", noise="white", baseline="none"
        )
    volts, squared = (scores[n].best for n in ("voltage", "voltage squared"))
    assert volts.identified.statistics["fit_percent"] > 85
    # the power of a lamp goes with the square of its voltage: the same linear dynamics simulate the
    # held-out part better
    rms_held_out = {n: float(c.table["held_out_rms"].min()) for n, c in scores.items()}
    assert rms_held_out["voltage squared"] < 0.6 * rms_held_out["voltage"]
    assert squared.identified.statistics["fit_percent"] > volts.identified.statistics["fit_percent"]
    # the residuals show that a linear model of this order is still incomplete
    assert "misses dynamics" in volts.identified.sentence or "coloured" in volts.identified.sentence


@pytest.mark.study
@needs_data
def test_tclab_step_record_needs_two_lags_and_a_noise_model():
    frame = pd.read_csv(
        data_dir() / "tclab" / "data_step_test.csv", header=None, names=["time_s", "heater", "T_K"]
    )
    uneven = from_frame(frame, input="heater", output="T_K")
    assert uneven.dt_s == pytest.approx(1.0, abs=0.02)
    data = from_frame(frame, input="heater", output="T_K", hold="zoh", resample_s=1.0, name="TCLab")
    c = compare(data, ["P1", "P1D", "P2D"], held_out=0.4)
    percent_held_out = c.table.set_index("model")["held_out_percent"]
    # a single step: the disturbance may take part of the response, 13 % of the range
    assert percent_held_out["P2D"] > 80
    assert percent_held_out["P1"] < percent_held_out["P1D"] < percent_held_out["P2D"] - 20
    assert c.recommended == "P2D"
    # the sensor is quantised in steps of 0.32 K: its residuals cannot be white; the noise model
    # accounts for it
    assert c.best.noise.averaged
    assert c.best.identified.statistics["p_white"] > 0.01
