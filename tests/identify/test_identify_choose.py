"""Which models and which hold are compared: names, starts, inputs set in small steps."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pandas as pd
import pytest
from disturbance_study import record
from scipy.signal import cont2discrete, lfilter

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.estimation import correlation_length
from tcdyn.identify import (
    IOData,
    compare,
    fit,
    from_control,
    from_frame,
    process,
    several,
    simulate,
)
from tcdyn.identify import forward_selection as grow
from tcdyn.identify.forward_selection import refit_from_simpler
from tcdyn.identify.validate import validate
from tcdyn.report.dynamics import input_noise_text, interval_text
from tests.identify.test_identify_several import plant

LOOK = Severity.WARNING
NOTE = Severity.INFO


def test_an_input_set_in_small_steps_is_held_and_where_rounding_looks_alike_the_user_is_asked():
    rng = np.random.default_rng(0)
    t = np.arange(800.0)
    u = np.repeat(np.cumsum(rng.choice([-1, 1, 0.5], 80)), 10)
    y = simulate(process("P1D").rational({"Kp": 1.0, "Tp1": 0.8, "Td": 0.13}), u, 0.1, "zoh")
    each = {
        "small": u,
        "levels": np.repeat(rng.normal(size=80), 10),
        "noisy": np.round(t / 40 + 0.2 * rng.normal(size=800)),
    }
    each |= {
        "lagged": np.round(100 * lfilter([0.1], [1, -0.9], t % 200 > 99)),
        "stairs": t // 10,
        "ramp": np.round(t / 10),
    }
    frame = pd.DataFrame(
        {"t": t / 10, "y": y + 0.01 * rng.normal(size=800), **each, "few": t // 200}
    )
    found = {name: from_frame(frame, input=name, output="y") for name in (*each, "few")}
    assert [d.hold for d in found.values()] == ["zoh", "zoh", "foh", "foh", "foh", "foh", "zoh"]
    asked = {name: [f.severity for f in d.findings] for name, d in found.items()}
    assert asked == {**{name: [] for name in each}, "stairs": [LOOK], "ramp": [LOOK], "few": [NOTE]}
    td = fit(found["small"], "P1D", intervals="quadratic").estimates["Td"]
    assert td.value == pytest.approx(0.13, abs=4 * td.u)
    told = compare(found["stairs"], "P1").summary()
    assert "Input stairs moves by its least step of 1 only" in told
    assert not from_frame(frame, input="stairs", output="y", hold="zoh").findings
    both = from_frame(frame, input=["stairs", "ramp"], output="y")
    assert [f.subject for f in both.select("ramp").findings] == ["ramp"]


def test_models_of_one_name_are_told_apart_and_one_that_stands_twice_is_compared_once():
    u = np.repeat(np.random.default_rng(1).choice([0.0, 1.0], 30), 20)
    y = simulate(process("P1D").rational({"Kp": 2.0, "Tp1": 0.8, "Td": 0.13}), u, 0.1, "zoh")
    data = IOData.from_arrays(
        u, y + 0.01 * np.random.default_rng(2).normal(size=600), 0.1, hold="zoh"
    )
    right = from_control(control.tf([2], [0.8, 1]), 0.13)
    found = compare(data, right, from_control(control.tf([5], [3, 1]), 0.5), right)
    assert (
        set(found.fits)
        == set(found.table["model"])
        == {"TF(0,1)D as given", "TF(0,1)D as given, 2"}
    )
    assert found.recommended == "TF(0,1)D as given"
    assert found.best.identified.theta["a1"] == 0.8
    with pytest.raises(InputError, match=r"start is given.*fit\(data, model, start"):
        compare(data, "P1", start={"Kp": 1.0, "Tp1": 1.0})


def test_a_larger_sum_that_ended_worse_is_begun_at_the_smaller_one():
    data = plant(3)
    small = several(["P1D", "P1"], ["heat", "fan"])
    others = {"small": fit(data, small, intervals="quadratic", check=False)}
    options = {"intervals": "quadratic", "check": False}
    large = fit(data, several(["P1D", "P2"], ["heat", "fan"]), **options)
    worse = replace(
        large,
        identified=replace(
            large.identified, statistics={**large.identified.statistics, "rms": 9.0}
        ),
    )
    again = refit_from_simpler(worse, others, data, options)
    assert again.identified.statistics["rms"] <= others["small"].identified.statistics["rms"] * (
        1 + 1e-6
    )


def test_the_page_says_where_intervals_come_from_and_what_was_taken_for_the_input_s_noise():
    data = replace(plant(5, 200).select("heat"), input_units=("degC",))
    plain, spiked, slow = (
        fit(data, "P1D", intervals="quadratic", check=False, **how)
        for how in (
            {"input_noise": 0.0},
            {"loss": "huber", "input_noise": 0.02},
            {"noise": "slow", "input_noise": 0.0},
        )
    )
    assert "profile likelihood" in interval_text(plain)
    assert input_noise_text(plain, data) == "is known without error"
    assert "robust loss (huber)" in interval_text(spiked)
    assert input_noise_text(spiked, data) == "is measured with noise (heat of sd 0.02 degC)"
    assert "first-order disturbances averaged" in interval_text(slow)


def test_a_drift_that_was_asked_for_is_no_reproach_where_it_goes_on():
    """Held out is a plateau of noise 0.5 K, on which the drift of 3 K goes on: it was counted as an error of 0.7 K."""
    found = compare(record("plunge", 0, "drift"), ["P2D"], noise="white", baseline="trend")
    assert found.best_row["held_out_rms"] == pytest.approx(0.5, rel=0.1)
    assert found.conclusion.severity is NOTE
    assert "Chain(" in found.lag_removal_advice()


def ringing(seed: int, n: int = 500) -> IOData:
    """(1 + 0.15 s)/(1 + 2 0.03 0.5 s + (0.5 s)^2) by its state equations, cut from the midst of a test; AR(1) noise."""
    rng = np.random.default_rng(seed)
    dt = 0.1
    a, b, *_ = cont2discrete(
        (np.array([[0.0, 1.0], [-4.0, -0.12]]), np.array([[0.0], [4.0]]), np.eye(2), 0), dt
    )
    u = np.repeat(rng.choice([-1.0, 1.0], (n + 300) // 6 + 1), 6)[: n + 300]
    x = np.zeros(2)
    y = []
    for held in u.tolist():
        y.append(x[0] + 0.15 * x[1])
        x = a @ x + b[:, 0] * held
    noise = 0.25 * lfilter([1.0], [1.0, -0.7], rng.normal(size=n + 300))
    return IOData.from_arrays(u[300:], (np.array(y) + noise)[300:], dt, hold="zoh")


@pytest.mark.study
def test_a_record_that_rings_when_it_begins_is_told_by_all_of_its_residuals():
    """Its first residuals are within 4 rms, and the gain came out as 0.83, the fit as 43 %."""
    data = ringing(1)
    assert "record.off_equilibrium" not in {
        f.code for f in validate(fit(data, "P2UZ", check=False)).findings
    }
    found = compare(data, ["P2UZ"])
    assert found.best.problem.initial == "estimated"
    assert "state at each start was estimated" in found.advice
    for name, truth in (("Kp", 1.0), ("Tw", 0.5), ("Zeta", 0.03), ("Tz", 0.15)):
        assert found.best.estimates[name].value == pytest.approx(
            truth, abs=3 * found.best.estimates[name].u
        ), name


def test_a_larger_sum_that_is_as_good_to_a_millionth_is_not_begun_anew(
    monkeypatch: pytest.MonkeyPatch,
):
    begun: list[object] = []
    data = plant(3, 200).select("heat")
    quick = {"intervals": "quadratic", "check": False, "input_noise": 0.0}
    small, large = (
        fit(data, p, **quick, start={"Kp": 2.0, "Tp1": 8.0, "Td": 1.5}) for p in ("P1", "P1D")
    )
    monkeypatch.setattr(grow, "fit", lambda data, model, **how: begun.append(model) or large)
    for rms, often in ((1 - 5e-7, 0), (1 - 5e-6, 1)):
        told = {**large.identified.statistics, "rms": rms * large.identified.statistics["rms"]}
        other = replace(small, identified=replace(small.identified, statistics=told))
        assert refit_from_simpler(large, {"small": other}, data, quick) is large
        assert len(begun) == often


def test_what_a_larger_model_gains_is_counted_by_independent_samples():
    """White residuals: N ln(S/S') - ln N for one parameter more; of each repeated r times there are N/r."""
    rng = np.random.default_rng(3)
    e = rng.normal(size=100)
    data = plant(3, 200)
    begun = {"Kp": 2.0, "Tp1": 8.0}
    made = fit(
        data.select("heat"), "P1", intervals="quadratic", check=False, input_noise=0.0, start=begun
    )
    for times in (1, 4):
        larger = np.repeat(e, times)
        more = replace(
            made.identified, statistics={**made.identified.statistics, "parameters": 5.0}
        )
        less = replace(
            made.identified, statistics={**made.identified.statistics, "parameters": 3.0}
        )
        before = replace(made, innovation=1.2 * larger, identified=less)
        count = len(larger) / correlation_length(larger)
        assert count == pytest.approx(
            100, rel=0.25
        )  # correlations of 100 samples are known to a tenth
        found = grow.bic_gain(before, replace(made, innovation=larger, identified=more))
        assert found == pytest.approx(2 * count * np.log(1.2) - 2 * np.log(count))
