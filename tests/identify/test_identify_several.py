"""Several inputs and outputs, stepwise search, and models from python-control, against independent
simulations."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pandas as pd
import pytest
from identify_cases import PLAIN
from matplotlib.figure import Figure
from scipy.signal import cont2discrete, lfilter

from tcdyn.core.errors import InputError
from tcdyn.identification import (
    Identified,
    IOData,
    bode_band,
    compare,
    fit,
    from_control,
    from_csv,
    from_frame,
    roots_of,
    several,
)
from tcdyn.identification.models import as_model
from tcdyn.identification.search import make_problem
from tcdyn.plots import draw, draw_poles
from tests.cli.test_main_job import tcdyn

DT = 0.5
TRUE_THETA = {"Kp.heat": 2.0, "Tp1.heat": 8.0, "Td.heat": 1.5, "Kp.fan": -1.0, "Tp1.fan": 3.0}


def zoh(num: list[float], den: list[float], u: np.ndarray, delay_samples: int = 0) -> np.ndarray:
    """Scipy's discretisation of num/den with held ``u``, ``dead`` samples delayed."""
    b, a, _ = cont2discrete((num, den), DT, "zoh")
    delayed = np.concatenate([np.full(delay_samples, u[0]), u[: len(u) - delay_samples]])
    return lfilter(b.ravel(), a, delayed - u[0]) + u[0] * num[-1] / den[-1]


def plant(seed: int, n: int = 500, noise: float = 0.05) -> IOData:
    """A heater with a dead time of three samples and a faster cooling fan, moved independently;
    white noise."""
    rng = np.random.default_rng(seed)
    heat, fan = (np.repeat(rng.choice([0.0, 1.0], -(-n // k)), k)[:n] for k in (20, 11))
    y = (
        20
        + zoh([2.0], [8.0, 1.0], heat, 3)
        + zoh([-1.0], [3.0, 1.0], fan)
        + noise * rng.normal(size=n)
    )
    return IOData.from_arrays(
        np.stack([heat, fan], 1), y, DT, hold="zoh", input_names=["heat", "fan"]
    )


def heated(seed: int) -> IOData:
    """The output of the heater without that of the fan."""
    data = plant(seed)
    fan = zoh([-1.0], [3.0, 1.0], data.runs[0].u[:, 1])[:, None]
    return replace(data, runs=(replace(data.runs[0], y=data.runs[0].y - fan),)).select("heat")


def test_two_inputs_with_dead_times_are_recovered_within_their_intervals():
    covered = []
    for seed in range(30):
        result = fit(
            plant(seed),
            several(["P1D", "P1"], ["heat", "fan"]),
            start=TRUE_THETA,
            intervals="quadratic",
            check=False,
            **PLAIN,
        )
        covered.append([result.estimates[n].contains(v) for n, v in TRUE_THETA.items()])
    assert np.mean(covered) > 0.9  # of 150, nominal 0.95; standard error 0.018
    without_start = fit(plant(0), several(["P1D", "P1"], ["heat", "fan"]), **PLAIN)
    for name, value in TRUE_THETA.items():
        assert without_start.estimates[name].value == pytest.approx(
            value, abs=4 * without_start.estimates[name].u
        )
    assert without_start.identified.statistics["p_input"] > 0.01


@pytest.mark.parametrize("common", [False, True])
@pytest.mark.parametrize("initial", ["equilibrium", "level", "estimated"])
def test_sensitivities_equal_central_differences_of_the_residuals(common, initial):
    model = several(["P2D", "P2Z"], ["heat", "fan"], common=common)
    problem = replace(make_problem(plant(1, 120), model, initial, 0.03), time_scale_s=5.0)
    theta = {"Kp": 1.3, "Tp1": 6.0, "Tp2": 1.7, "Td": 0.8, "Tz": 0.9}
    x = problem.vector({n: theta[n.partition(".")[0]] for n in model.names})
    x[problem.n_model :] = 0.1 * np.arange(1, problem.size - problem.n_model + 1)
    _, slopes = problem.evaluate(x)
    for k in range(problem.size):
        step = np.eye(problem.size)[k] * 1e-6
        difference = (problem.evaluate(x + step)[0] - problem.evaluate(x - step)[0]) / 2e-6
        # relative to the largest difference of the column
        tolerance = 1e-6 * max(1.0, np.abs(difference).max())
        assert np.allclose(difference, slopes[:, k], atol=tolerance)


@pytest.mark.study
def test_search_finds_the_true_structure_and_drops_an_input_without_effect():
    data = plant(3)
    idle = np.random.default_rng(9).choice([0.0, 1.0], data.n_samples)
    wide = IOData.from_arrays(
        np.column_stack([data.runs[0].u, idle]),
        data.runs[0].y,
        DT,
        hold="zoh",
        input_names=["heat", "fan", "idle"],
    )
    comparison = compare(wide)
    assert comparison.recommended == "P1D + P1 + -"
    # the noise, 150 samples
    assert comparison.best_row["held_out_rms"] == pytest.approx(0.05, rel=0.2)
    assert "lag.idle" not in comparison.summary()
    assert comparison.conclusion.code == "models.recommended"


@pytest.mark.long
@pytest.mark.study
def test_transfer_function_replaces_process_models_of_too_few_poles():
    """A complex pair and a lag leave residuals that follow the input."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([0.0, 1.0], 40), 12)
    den = np.polymul(np.polymul([1.0, 0.4, 1.0], [1 / 9.0, 0.1, 1.0]), [2.0, 1.0])
    y = zoh([1.0], den.tolist(), u) + 0.005 * rng.normal(size=len(u))
    comparison = compare(IOData.from_arrays(u, y, DT, hold="zoh"))
    assert comparison.recommended.startswith("TF(")
    # noise alone leaves 98.5 %, a complex pair and a lag 90 %
    assert comparison.best_row["held_out_percent"] > 96


def test_state_space_and_json_forms_repeat_the_simulation(tmp_path):
    data = plant(5)
    model = fit(
        data, several(["P1", "P2Z"], ["heat", "fan"]), intervals="quadratic", **PLAIN
    ).identified
    u = data.runs[0].u
    restored = Identified.from_json(model.to_json())
    assert np.allclose(restored.simulate(u), model.simulate(u), atol=1e-12)
    assert restored.by_input["fan"].lag_s.value == pytest.approx(model.by_input["fan"].lag_s.value)
    t = DT * np.arange(len(u))
    response = control.forced_response(
        control.sample_system(model.state_space(), DT, "zoh"), t, (u - u[0]).T
    )
    gains = np.array([p.gain for p in model.by_input.values()])
    assert np.allclose(response.outputs + gains @ u[0] + model.offset, model.simulate(u), atol=1e-6)
    with pytest.raises(InputError, match=r"has 2 inputs.*by_input\['heat'\]"):
        _ = model.rational


def test_control_system_can_be_compared_as_given_and_used_as_start():
    data = heated(6)
    from_tf = from_control(control.tf([2.0], [8.0, 1.0]), delay_s=1.5)
    assert from_tf.lag_s.value == pytest.approx(9.5)
    comparison = compare(data, from_tf, "P1D", **PLAIN)
    row = comparison.table[comparison.table["model"] == "TF(0,1)D as given"].iloc[0]
    assert row["parameters"] == 1  # the offset
    result = fit(data, from_tf.model, start=from_tf.theta, **PLAIN)
    assert result.identified.theta["a1"] == pytest.approx(8.0, abs=4 * result.estimates["a1"].u)
    joined = several(["P1D", "TF(1,2)"], ["heat", "fan"])
    u = plant(6).runs[0].u
    two_inputs = fit(plant(6), joined, intervals="quadratic", check=False, **PLAIN).identified
    restored = from_control(two_inputs.state_space(0), delay_s=[two_inputs.theta["Td.heat"], 0.0])
    assert np.allclose(
        restored.simulate(u, DT, "zoh"), two_inputs.simulate(u) - two_inputs.offset, atol=1e-6
    )
    unnamed = control.combine_tf([[control.tf([2.0], [8.0, 1.0]), control.tf([-1.0], [3.0, 1.0])]])
    # without names the inputs are matched by position: u[0], u[1]
    by_position = compare(
        plant(6), from_control(unnamed, delay_s=[1.5, 0.0]), **PLAIN
    ).best.identified
    assert by_position.model.inputs == ("heat", "fan")
    assert by_position.theta["a1.fan"] == 3.0
    assert "correlations" not in from_tf.summary()
    high_corner = from_control(control.tf([1.0], [1e-3, 1.0]))
    assert bode_band(high_corner).magnitude_dB.x[-1] == pytest.approx(1e5 / 2 / np.pi)
    for system, message in (
        (control.tf([1.0, 0.0], [1.0, 2.0, 1.0]), "static gain of zero"),
        (control.tf([1.0], [1.0, -0.5], DT), "discrete"),
        (control.tf([1.0], [1.0, -1.0]), "left half plane"),
        (control.tf([[[1.0]], [[1.0]]], [[[1.0, 1.0]], [[1.0, 1.0]]]), "2 outputs"),
        ([1.0], "list"),
    ):
        with pytest.raises(InputError, match=message):
            from_control(system)


def test_covariance_of_poles_matches_closed_form_and_spread_of_repeated_fits():
    g = fit(heated(7), "P2D", intervals="quadratic", check=False, **PLAIN).identified
    poles = sorted((r for r in roots_of(g)), key=lambda r: -r.value.real)
    for r, name in zip(poles, ("Tp1", "Tp2")):
        tau = g.estimates[name].value
        u = g.estimates[name].u
        assert r.value == pytest.approx(-1 / tau)
        assert np.sqrt(r.covariance[0, 0]) == pytest.approx(u / tau**2)  # d(1/T) = dT/T^2
    # an oscillating pair: against the spread of w = 1/Tw and damping over repeated fits
    steps = np.repeat([0.0, 1.0, 0.0, 1.0], 60)
    data = IOData.from_arrays(steps, zoh([1.0], [4.0, 1.2, 1.0], steps), DT, hold="zoh")
    fits = [
        fit(
            replace_y(data, 0.05, seed),
            "P2U",
            start={"Kp": 1.0, "Tw": 2.0, "Zeta": 0.3},
            check=False,
            **PLAIN,
        ).identified
        for seed in range(40)
    ]
    top = [max(roots_of(m), key=lambda r: r.value.imag) for m in fits]
    spread = np.cov([[r.value.real, r.value.imag] for r in top], rowvar=False)
    stated = np.mean([r.covariance for r in top], axis=0)
    # 40 fits: standard error 0.23
    assert np.diag(spread) == pytest.approx(np.diag(stated), rel=0.7)


def replace_y(data: IOData, sd: float, seed: int) -> IOData:
    """The same record with white noise added to its output."""
    run = data.runs[0]
    y = run.y + sd * np.random.default_rng(seed).normal(size=run.y.shape)
    return replace(data, runs=(replace(run, y=y),))


def test_data_and_poles_are_plotted():
    axes = Figure().subplots(1, 2)
    data = plant(8)
    assert {line.get_label() for line in draw(data, axes[0]).lines} >= {
        "heat, right axis",
        "fan, right axis",
        "y",
    }
    model = fit(
        data, several(["P1", "P1Z"], ["heat", "fan"]), intervals="quadratic", **PLAIN
    ).identified
    marks = [line.get_marker() for line in draw_poles(model, axes[1]).lines]
    assert marks.count("o") == 1
    assert marks.count("x") == 4  # two poles, each plotted and named


def test_clock_stamps_become_seconds_across_midnight(tmp_path):
    frame = pd.DataFrame({"u": [0.0, 0, 1, 1, 1, 1], "y": [0.0, 0, 0.2, 0.5, 0.6, 0.7]})
    stamps = pd.date_range("2026-01-02 23:59:58", periods=6, freq="500ms")
    for time_column in (
        stamps.strftime("%H:%M:%S.%f"),
        stamps.strftime("%Y-%m-%d %H:%M:%S.%f"),
        stamps,
    ):
        data = from_frame(frame.assign(time=time_column), input="u", output="y")
        assert data.dt_s == pytest.approx(0.5)
    frame.assign(time=stamps.strftime("%H:%M:%S.%f")).to_csv(tmp_path / "c.csv", index=False)
    assert from_csv(tmp_path / "c.csv", input="u", output="y").dt_s == pytest.approx(0.5)


def test_hold_is_zoh_for_a_set_input_and_foh_for_a_measured_one():
    t = np.arange(200.0)
    u = {
        "set": np.repeat([0.0, 5, 2, 5], 50),
        "measured": np.sin(t / 9),
        "rounded": np.round(20 * np.sin(t / 90)) / 2,
    }
    frame = pd.DataFrame({"t": t, "y": t, **u})
    for name, hold in (("set", "zoh"), ("measured", "foh"), ("rounded", "foh")):
        assert from_frame(frame, input=name, output="y").hold == hold
    both = from_frame(frame, input=["set", "measured"], output="y")
    assert both.hold == ("zoh", "foh")


BAD = {
    "two inputs, one model": (lambda d: fit(d, "P1"), "2 inputs.*heat, fan"),
    "other inputs": (lambda d: fit(d, several(["P1", "P1"], ["a", "b"])), "2 inputs.*a, b"),
    "too few models": (lambda d: several(["P1"], d.input_names), "1 models for 2 inputs"),
    "integrator": (lambda d: several(["P1I", "P1"], d.input_names), "integrates"),
    "poles that differ": (
        lambda d: several(["P1", "P2"], d.input_names, common=True),
        "differ in their poles",
    ),
    "no such input": (lambda d: d.select("cold"), "input 'cold' is missing"),
    "shape of inputs": (
        lambda d: fit(d, several(["P1", "P1"], d.input_names)).identified.simulate(d.runs[0].y),
        "1 input",
    ),
    "part of a TF": (lambda d: as_model("TF(3,2)"), "3 zeros over 2 poles"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_raises_one_clear_message(case):
    call, message = BAD[case]
    with pytest.raises(InputError, match=message):
        call(plant(0, 200))


@pytest.mark.e2e
def test_identify_command_accepts_several_inputs_and_outputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    data = plant(2)
    u = data.runs[0].u
    y = data.runs[0].y[:, 0]
    table = tmp_path / "two.csv"
    frame = pd.DataFrame(
        {
            "time_s": DT * np.arange(len(y)),
            "heat": u[:, 0],
            "fan": u[:, 1],
            "T1": y,
            "T2": 2 * y + 3,
        }
    )
    frame.to_csv(table, index=False)
    arguments = (
        "identify",
        table,
        "--input",
        "heat",
        "--input",
        "fan",
        "--output",
        "T1",
        "--output",
        "T2",
    )
    assert tcdyn(*arguments, "--model", "P1D+P1", "--model", "P1") == 0
    printed = capsys.readouterr().out
    assert "Recommended: P1D + P1." in printed
    assert "Kp.heat" in printed
    for name in ("T1", "T2"):
        stored = json.loads((tmp_path / f"two.{name}.identified.json").read_text(encoding="utf-8"))
        assert abs(stored["theta"]["Td.heat"] - 1.5) < 4 * stored["estimates"]["Td.heat"]["u"]
        assert (tmp_path / f"two.{name}.identified.html").exists()
    for options, message in (
        (("--input", "heat", "--input", "", "--output", "T1"), "--input"),
        (("--input", "heat", "--input", "heat", "--output", "T1"), "--input"),
        (("--input", "heat", "--input", "T1", "--output", "T1"), "named twice"),
        (("--input", "heat", "--input", "cold", "--output", "T1"), "'cold' is missing"),
        (("--input", "heat", "--input", "fan", "--output", "T1", "--narx"), "--narx with 2 inputs"),
        (
            ("--input", "heat", "--input", "fan", "--output", "T1", "--gain", "2"),
            "--gain with 2 inputs",
        ),
        (("--input", "heat", "--output", "T1", "--model", "P1+P1"), "names 2 parts"),
        (
            ("--input", "heat", "--input", "fan", "--output", "T1", "--model", "P1+P1+P1"),
            "3 models for 2 inputs",
        ),
        (("--input", "heat", "--input", "fan", "--output", "T1", "--hold", "auto2"), "--hold"),
    ):
        assert tcdyn("identify", table, *options) == 2
        assert message in capsys.readouterr().err


def test_lag_removal_advice_runs_as_python():
    data = heated(4)
    comparison = compare(data, "P1D", **PLAIN)
    line = comparison.lag_removal_advice().partition("other traces: ")[2].partition(";")[0]
    y = data.runs[0].y[:, 0]
    assert line.startswith("tcdyn.smooth(y, dt, tcdyn.Chain(")
    namespace: dict[str, object] = {"y": y, "dt": data.dt_s}
    exec(f"import tcdyn\ndone = {line}", namespace)
    assert np.shape(namespace["done"].temperature) == (len(y), 1)
