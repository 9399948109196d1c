"""Several inputs and outputs, the growing search, models from python-control: against simulations of another make."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy.signal import cont2discrete, lfilter

from tcdyn.core.errors import InputError
from tcdyn.identify import (
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
from tcdyn.identify.forward_selection import successors, warm_start
from tcdyn.identify.models import as_model
from tcdyn.identify.search import make_problem
from tcdyn.plots import draw, draw_poles
from tests.cli.test_main_job import tcdyn

DT = 0.5
TRUTH = {"Kp.heat": 2.0, "Tp1.heat": 8.0, "Td.heat": 1.5, "Kp.fan": -1.0, "Tp1.fan": 3.0}


def zoh(num: list[float], den: list[float], u: np.ndarray, dead: int = 0) -> np.ndarray:
    """What scipy's discretisation of num/den makes of held ``u``, ``dead`` samples late."""
    b, a, _ = cont2discrete((num, den), DT, "zoh")
    late = np.concatenate([np.full(dead, u[0]), u[: len(u) - dead]])
    return lfilter(b.ravel(), a, late - u[0]) + u[0] * num[-1] / den[-1]


def plant(seed: int, n: int = 500, noise: float = 0.05) -> IOData:
    """A heater behind a dead time of three samples and a quicker fan that cools, moved apart; white noise."""
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
    """The heater alone."""
    data = plant(seed)
    fan = zoh([-1.0], [3.0, 1.0], data.runs[0].u[:, 1])[:, None]
    return replace(data, runs=(replace(data.runs[0], y=data.runs[0].y - fan),)).select("heat")


def test_two_inputs_each_with_its_dead_time_are_recovered_within_their_intervals():
    covered = []
    for seed in range(30):
        found = fit(
            plant(seed),
            several(["P1D", "P1"], ["heat", "fan"]),
            start=TRUTH,
            intervals="quadratic",
            check=False,
        )
        covered.append([found.estimates[n].contains(v) for n, v in TRUTH.items()])
    assert np.mean(covered) > 0.9  # of 150, nominal 0.95; standard error 0.018
    cold = fit(plant(0), several(["P1D", "P1"], ["heat", "fan"]))
    for name, value in TRUTH.items():
        assert cold.estimates[name].value == pytest.approx(value, abs=4 * cold.estimates[name].u)
    assert cold.identified.statistics["p_input"] > 0.01


@pytest.mark.parametrize("common", [False, True])
@pytest.mark.parametrize("initial", ["equilibrium", "estimated"])
def test_slopes_are_those_of_the_residuals(common, initial):
    model = several(["P2D", "P2Z"], ["heat", "fan"], common=common)
    posed = replace(make_problem(plant(1, 120), model, initial, 0.03), time_scale_s=5.0)
    theta = {"Kp": 1.3, "Tp1": 6.0, "Tp2": 1.7, "Td": 0.8, "Tz": 0.9}
    x = posed.vector({n: theta[n.partition(".")[0]] for n in model.names})
    x[posed.n_model :] = 0.1 * np.arange(1, posed.size - posed.n_model + 1)
    _, slopes = posed.evaluate(x)
    for k in range(posed.size):
        step = np.eye(posed.size)[k] * 1e-6
        difference = (posed.evaluate(x + step)[0] - posed.evaluate(x - step)[0]) / 2e-6
        assert np.allclose(
            difference, slopes[:, k], atol=1e-6 * max(1.0, np.abs(difference).max())
        )  # of the difference


@pytest.mark.study
def test_the_search_grows_to_the_truth_and_leaves_out_an_input_that_does_nothing():
    data = plant(3)
    idle = np.random.default_rng(9).choice([0.0, 1.0], data.n_samples)
    wide = IOData.from_arrays(
        np.column_stack([data.runs[0].u, idle]),
        data.runs[0].y,
        DT,
        hold="zoh",
        input_names=["heat", "fan", "idle"],
    )
    found = compare(wide)
    assert found.recommended == "P1D + P1 + -"
    assert found.table["refused"].sum() >= 1  # the way's end is shown
    assert found.best_row["held_out_rms"] == pytest.approx(0.05, rel=0.2)  # the noise, 150 samples
    assert "lag.idle" not in found.summary()
    assert found.conclusion.code == "models.recommended"


@pytest.mark.study
def test_the_search_grows_beyond_three_poles():
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([0.0, 1.0], 40), 12)
    den = np.polymul(np.polymul([1.0, 0.4, 1.0], [1 / 9.0, 0.1, 1.0]), [2.0, 1.0])
    y = zoh([1.0], den.tolist(), u) + 0.005 * rng.normal(size=len(u))
    found = compare(IOData.from_arrays(u, y, DT, hold="zoh"))
    assert found.recommended.startswith("TF(")
    assert (
        found.best_row["held_out_percent"] > 96
    )  # noise alone leaves 98.5; a complex pair and a lag 90


def test_a_step_begins_where_the_smaller_model_ended():
    f = np.geomspace(0.01, 1, 9)
    for name, have, larger in (
        ("P2DZ", {"Kp": 2.0, "Tp1": 5.0, "Tp2": 1.0, "Tz": 0.5, "Td": 0.3}, "TF(2,2)D"),
        ("P1D", {"Kp": 2.0, "Tp1": 5.0, "Td": 0.3}, "P2DZ"),
        ("TF(1,3)", {"b0": 2.0, "b1": 1.0, "a1": 3.0, "a2": 3.0, "a3": 1.0}, "TF(2,4)"),
    ):
        was = as_model(name)
        part = as_model(larger)
        assert larger in [m.name for m in successors(was)]
        now = part.rational(warm_start(was, have, part, 0.7)).frequency_response(f)
        assert np.allclose(now, was.rational(have).frequency_response(f), rtol=1e-9)


def test_state_space_and_file_repeat_the_simulation(tmp_path):
    data = plant(5)
    found = fit(data, several(["P1", "P2Z"], ["heat", "fan"]), intervals="quadratic").identified
    u = data.runs[0].u
    again = Identified.from_json(found.to_json())
    assert np.allclose(again.simulate(u), found.simulate(u), atol=1e-12)
    assert again.by_input["fan"].lag_s.value == pytest.approx(found.by_input["fan"].lag_s.value)
    t = DT * np.arange(len(u))
    response = control.forced_response(
        control.sample_system(found.state_space(), DT, "zoh"), t, (u - u[0]).T
    )
    gains = np.array([p.gain for p in found.by_input.values()])
    assert np.allclose(response.outputs + gains @ u[0] + found.offset, found.simulate(u), atol=1e-6)
    with pytest.raises(InputError, match=r"has 2 inputs.*parts\['heat'\]"):
        _ = found.rational


def test_a_control_system_is_compared_as_it_stands_and_begun_at():
    data = heated(6)
    given = from_control(control.tf([2.0], [8.0, 1.0]), delay_s=1.5)
    assert given.lag_s.value == pytest.approx(9.5)
    c = compare(data, given, "P1D")
    row = c.table[c.table["model"] == "TF(0,1)D as given"].iloc[0]
    assert row["parameters"] == 1  # the offset
    begun = fit(data, given.model, start=given.theta)
    assert begun.identified.theta["a1"] == pytest.approx(8.0, abs=4 * begun.estimates["a1"].u)
    joined = several(["P1D", "TF(1,2)"], ["heat", "fan"])
    u = plant(6).runs[0].u
    two = fit(plant(6), joined, intervals="quadratic", check=False).identified
    again = from_control(two.state_space(0), delay_s=[two.theta["Td.heat"], 0.0])
    assert np.allclose(again.simulate(u, DT, "zoh"), two.simulate(u) - two.offset, atol=1e-6)
    unnamed = control.combine_tf([[control.tf([2.0], [8.0, 1.0]), control.tf([-1.0], [3.0, 1.0])]])
    placed = compare(
        plant(6), from_control(unnamed, delay_s=[1.5, 0.0])
    ).best.identified  # u[0], u[1]
    assert placed.model.inputs == ("heat", "fan")
    assert placed.theta["a1.fan"] == 3.0
    assert "correlations" not in given.summary()
    assert bode_band(from_control(control.tf([1.0], [1e-3, 1.0]))).magnitude_dB.x[
        -1
    ] == pytest.approx(1e5 / 2 / np.pi)
    for system, words in (
        (control.tf([1.0, 0.0], [1.0, 2.0, 1.0]), "static gain of zero"),
        (control.tf([1.0], [1.0, -0.5], DT), "discrete"),
        (control.tf([1.0], [1.0, -1.0]), "left half plane"),
        (control.tf([[[1.0]], [[1.0]]], [[[1.0, 1.0]], [[1.0, 1.0]]]), "2 outputs"),
        ([1.0], "list"),
    ):
        with pytest.raises(InputError, match=words):
            from_control(system)


def test_poles_move_as_their_covariance_says():
    g = fit(heated(7), "P2D", intervals="quadratic", check=False).identified
    poles = sorted((r for r in roots_of(g)), key=lambda r: -r.value.real)
    for r, name in zip(poles, ("Tp1", "Tp2")):
        tau = g.estimates[name].value
        u = g.estimates[name].u
        assert r.value == pytest.approx(-1 / tau)
        assert np.sqrt(r.covariance[0, 0]) == pytest.approx(u / tau**2)  # d(1/T) = dT/T^2
    # an oscillating pair: against fits' own spread of w = 1/Tw and damping
    data = IOData.from_arrays(
        u_ := np.repeat([0.0, 1.0, 0.0, 1.0], 60), zoh([1.0], [4.0, 1.2, 1.0], u_), DT, hold="zoh"
    )
    noisy = [
        fit(
            replace_y(data, 0.05, seed),
            "P2U",
            start={"Kp": 1.0, "Tw": 2.0, "Zeta": 0.3},
            check=False,
        ).identified
        for seed in range(40)
    ]
    top = [max(roots_of(m), key=lambda r: r.value.imag) for m in noisy]
    spread = np.cov([[r.value.real, r.value.imag] for r in top], rowvar=False)
    claimed = np.mean([r.covariance for r in top], axis=0)
    assert np.diag(spread) == pytest.approx(np.diag(claimed), rel=0.7)  # of 40: standard error 0.23


def replace_y(data: IOData, sd: float, seed: int) -> IOData:
    """The same with white noise on its output."""
    run = data.runs[0]
    y = run.y + sd * np.random.default_rng(seed).normal(size=run.y.shape)
    return replace(data, runs=(replace(run, y=y),))


def test_data_and_poles_are_drawn():
    axes = Figure().subplots(1, 2)
    data = plant(8)
    assert {line.get_label() for line in draw(data, axes[0]).lines} >= {
        "heat, right axis",
        "fan, right axis",
        "y",
    }
    found = fit(data, several(["P1", "P1Z"], ["heat", "fan"]), intervals="quadratic").identified
    marks = [line.get_marker() for line in draw_poles(found, axes[1]).lines]
    assert marks.count("o") == 1
    assert marks.count("x") == 4  # two poles, two names


def test_clock_stamps_are_seconds_also_past_midnight(tmp_path):
    frame = pd.DataFrame({"u": [0.0, 0, 1, 1, 1, 1], "y": [0.0, 0, 0.2, 0.5, 0.6, 0.7]})
    stamps = pd.date_range("2026-01-02 23:59:58", periods=6, freq="500ms")
    for written in (
        stamps.strftime("%H:%M:%S.%f"),
        stamps.strftime("%Y-%m-%d %H:%M:%S.%f"),
        stamps,
    ):
        data = from_frame(frame.assign(time=written), input="u", output="y")
        assert data.dt_s == pytest.approx(0.5)
    frame.assign(time=stamps.strftime("%H:%M:%S.%f")).to_csv(tmp_path / "c.csv", index=False)
    assert from_csv(tmp_path / "c.csv", input="u", output="y").dt_s == pytest.approx(0.5)


def test_an_input_that_was_set_is_held_and_one_that_was_measured_is_not():
    t = np.arange(200.0)
    u = {
        "set": np.repeat([0.0, 5, 2, 5], 50),
        "measured": np.sin(t / 9),
        "rounded": np.round(20 * np.sin(t / 90)) / 2,
    }
    frame = pd.DataFrame({"t": t, "y": t, **u})
    for name, hold in (("set", "zoh"), ("measured", "foh"), ("rounded", "foh")):
        assert from_frame(frame, input=name, output="y").hold == hold
    assert from_frame(frame, input=["set", "measured"], output="y").hold == "foh"


BAD = {
    "two inputs, one model": (lambda d: fit(d, "P1"), "2 inputs.*heat, fan"),
    "other inputs": (lambda d: fit(d, several(["P1", "P1"], ["a", "b"])), "2 inputs.*a, b"),
    "too few models": (lambda d: several(["P1"], d.input_names), "1 models for 2 inputs"),
    "integrator": (lambda d: several(["P1I", "P1"], d.input_names), "integrates"),
    "poles that differ": (
        lambda d: several(["P1", "P2"], d.input_names, common=True),
        "differ in their poles",
    ),
    "no such input": (lambda d: d.select("cold"), "no input named 'cold'"),
    "shape of inputs": (
        lambda d: fit(d, several(["P1", "P1"], d.input_names)).identified.simulate(d.runs[0].y),
        "1 input",
    ),
    "part of a TF": (lambda d: as_model("TF(3,2)"), "3 zeros over 2 poles"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_told_in_one_sentence(case):
    call, words = BAD[case]
    with pytest.raises(InputError, match=words):
        call(plant(0, 200))


@pytest.mark.e2e
def test_the_command_takes_several_inputs_and_outputs(
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
    asked = ("identify", table, "--input", "heat,fan", "--output", "T1,T2")
    assert tcdyn(*asked, "--models", "P1D+P1,P1") == 0
    said = capsys.readouterr().out
    assert "Recommended: P1D + P1." in said
    assert "Kp.heat" in said
    for name in ("T1", "T2"):
        kept = json.loads((tmp_path / f"two.{name}.identified.json").read_text(encoding="utf-8"))
        assert abs(kept["theta"]["Td.heat"] - 1.5) < 4 * kept["estimates"]["Td.heat"]["u"]
        assert (tmp_path / f"two.{name}.identified.html").exists()
    for words, told in (
        (("--input", "heat,", "--output", "T1"), "--input"),
        (("--input", "heat,heat", "--output", "T1"), "--input"),
        (("--input", "heat,T1", "--output", "T1"), "named twice"),
        (("--input", "heat,cold", "--output", "T1"), "'cold' is missing"),
        (("--input", "heat,fan", "--output", "T1", "--narx"), "--narx with 2 inputs"),
        (("--input", "heat,fan", "--output", "T1", "--gain", "2"), "--gain with 2 inputs"),
        (("--input", "heat", "--output", "T1", "--models", "P1+P1"), "names 2 parts"),
        (
            ("--input", "heat,fan", "--output", "T1", "--models", "P1+P1+P1"),
            "3 models for 2 inputs",
        ),
        (("--input", "heat,fan", "--output", "T1", "--hold", "auto2"), "--hold"),
    ):
        assert tcdyn("identify", table, *words) == 2
        assert told in capsys.readouterr().err


def test_the_line_to_paste_runs():
    data = heated(4)
    found = compare(data, "P1D")
    line = found.lag_removal_advice().partition("other traces: ")[2].partition(";")[0]
    y = data.runs[0].y[:, 0]
    assert line.startswith("tcdyn.smooth(y, dt, tcdyn.Chain(")
    space: dict[str, object] = {"y": y, "dt": data.dt_s}
    exec(f"import tcdyn\ndone = {line}", space)
    assert np.shape(space["done"].temperature) == (len(y), 1)
