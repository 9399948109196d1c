"""One hold for each input: a held heater and a ramped room temperature in one record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.identification import (
    Comparison,
    Identified,
    IOData,
    compare,
    fit,
    from_csv,
    from_frame,
    several,
)
from tests.cli.test_main_job import tcdyn
from tests.identify.bare_cases import CASES, fine_response

FINE_S = 0.005  # step of the simulator
DT_S = 0.05
N = 800
DEAD_S = {"heater": 0.37, "room": 0.21}
NOISE_K = 0.1
WHITE = {"noise": "white", "initial": "equilibrium", "intervals": "quadratic", "check": False}
# two lags behind each input, as a product of first-order factors
DENOMINATORS = {"heater": (0.4, 1.4, 1.0), "room": (0.15, 0.8, 1.0)}


def held_and_ramped(seed: int) -> pd.DataFrame:
    """A heater that is held for 20 samples, and a room temperature that is straight in between.

    The simulator steps through each sampling interval in ten steps of constant input. For the ramp
    it takes the mean of each step, whose error is of second order: 2e-5 of a change within a
    sample.
    """
    rng = np.random.default_rng(seed)
    factor = round(DT_S / FINE_S)
    heater = np.repeat(25.0 + 50.0 * (rng.random(N // 20) < 0.5), 20)
    room = np.cumsum(rng.normal(size=N))
    middles = np.arange((N - 1) * factor) / factor + 0.5 / factor
    fine = {
        "heater": np.repeat(heater, factor),
        "room": np.append(np.interp(middles, np.arange(N), room), np.full(factor, room[-1])),
    }
    y = sum(
        fine_response(fine[name], (1.0,), DENOMINATORS[name], DEAD_S[name], start=fine[name][0])
        for name in fine
    )
    noisy = y[::factor] + NOISE_K * rng.normal(size=N)
    return pd.DataFrame({"time_s": DT_S * np.arange(N), "heater": heater, "room": room, "T": noisy})


def record(seed: int, hold: object = "auto") -> IOData:
    return from_frame(held_and_ramped(seed), input=["heater", "room"], output="T", hold=hold)


def test_dead_times_are_within_their_intervals_where_each_input_has_its_own_hold():
    data = record(41)
    assert data.hold == ("zoh", "foh")
    assert data.timing_u_s == pytest.approx(DT_S / np.sqrt(12))  # the holds are not stated
    data = replace(data, timing_u_s=0.0)
    assert data.select(input="room").hold == "foh"
    model = several(["P2D", "P2D"], data.input_names)
    result = fit(data, model, **WHITE)
    # a held input is half a sample later than a straight line through the same samples
    for hold, shifts in (("zoh", (0.0, -0.5)), ("foh", (0.5, 0.0))):
        wrong = fit(
            replace(data, hold=hold),
            model,
            **WHITE,
            start=result.identified.theta,
        )
        for name, shift in zip(data.input_names, shifts):
            estimate = wrong.estimates[f"Td.{name}"]
            expected_s = DEAD_S[name] + shift * DT_S
            assert abs(estimate.value - expected_s) < 3 * estimate.u + 0.1 * DT_S
    for name, dead_s in DEAD_S.items():
        estimate = result.estimates[f"Td.{name}"]
        assert estimate.u < 0.2 * DT_S
        assert abs(estimate.value - dead_s) < 3 * estimate.u


def test_holds_stay_in_files_and_in_the_model_of_each_input():
    data = record(42)
    result = fit(data, several(["P1D", "P1D"], data.input_names), **WHITE).identified
    assert [part.hold for part in result.by_input.values()] == ["zoh", "foh"]
    again = Identified.from_json(result.to_json())
    assert again.hold == ("zoh", "foh")
    u = data.runs[0].u
    np.testing.assert_array_equal(again.simulate(u), result.simulate(u))
    np.testing.assert_array_equal(
        again.simulate(u, hold="zoh"), replace(result, hold="zoh").simulate(u)
    )


def test_the_hold_of_several_inputs_is_checked(tmp_path, capsys):
    frame = held_and_ramped(43)
    u = frame[["heater", "room"]].to_numpy()
    assert IOData.from_arrays(u, frame["T"], DT_S, hold=("foh", "foh")).hold == "foh"
    for hold, message in ((("zoh",), "1 values"), (("zoh", "linear"), "linear")):
        with pytest.raises(InputError, match=message):
            IOData.from_arrays(u, frame["T"], DT_S, hold=hold)
    path = tmp_path / "room.csv"
    frame.to_csv(path, index=False)
    columns = {"input": ["heater", "room"], "output": "T"}
    assert from_csv(path, **columns, hold=("foh", "zoh")).hold == ("foh", "zoh")
    words = (
        "identify",
        path,
        "--input",
        "heater",
        "--input",
        "room",
        "--output",
        "T",
        "--model",
        "P1D",
    )
    assert tcdyn(*words, "--hold", "zoh", "--hold", "linear") == 2
    assert "--hold is 'linear'" in capsys.readouterr().err


def other_holds(comparison: Comparison) -> list[dict[str, object]]:
    """Numbers of the warnings about the hold."""
    return [f.numbers for f in comparison.best.findings if f.code == "record.other_hold"]


def test_a_held_input_that_is_taken_as_a_straight_line_is_reported():
    data = CASES["wrong hold"].record(44)
    assert data.hold == "foh"
    wrong = compare(data, "P2D", initial="equilibrium")
    assert [numbers["holds"] for numbers in other_holds(wrong)] == [("zoh",)]
    assert wrong.conclusion.severity is Severity.WARNING
    right = compare(replace(data, hold="zoh"), "P2D", initial="equilibrium")
    assert not other_holds(right)
    assert right.conclusion.severity is Severity.INFO


def test_the_hold_is_reported_where_the_other_one_fits_decisively_better():
    frame = held_and_ramped(45)
    room = frame["room"].to_numpy()
    # one lag of 0.2 s behind a straight line from sample to sample, in closed form
    a = np.exp(-DT_S / 0.2)
    first_weight = (1 - a) * 0.2 / DT_S - a
    y = np.full(N, room[0])
    for k in range(1, N):
        y[k] = a * y[k - 1] + first_weight * room[k - 1] + (1 - a - first_weight) * room[k]
    noisy = y + NOISE_K * np.random.default_rng(45).normal(size=N)
    data = IOData.from_arrays(room, noisy, DT_S, hold="foh")
    options = {"initial": "equilibrium", "noise": "white", "input_noise": 0.0}
    assert not other_holds(compare(data, "P1", **options))
    (numbers,) = other_holds(compare(replace(data, hold="zoh"), "P1", **options))
    assert numbers["holds"] == ("foh",)
    assert numbers["bic"] > 10
