"""An input computed from the output raises; an input of an open loop never does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_loop_cases import OPEN_LOOPS, closed_loop_record, open_loop_record
from identify_cases import PLAIN

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.identification import IOData, compare, fit
from tcdyn.identification.closed_loop import closed_loop

CONTROLLERS = ("PI", "PID", "filtered PI")


def is_recognised(data: IOData) -> bool:
    """Whether the record gives the closed-loop finding and no other."""
    return [f.code for f in closed_loop(data)] == ["record.closed_loop"]


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("set_point", ["constant", "steps", "ramp"])
def test_controllers_with_integral_action_are_recognised(controller: str, set_point: str) -> None:
    for seed in range(3):
        for dither in (
            0.0,
            1e-4,
            5e-3,
        ):  # the last is 1 % of the output variation of the controller
            data = closed_loop_record(controller, seed=seed, dither=dither, set_point=set_point)
            assert is_recognised(data), (seed, dither)


@pytest.mark.parametrize("controller", ["P", "PI", "PID", "filtered PI", "clipped PI", "cascade"])
def test_control_laws_of_past_outputs_are_recognised(controller: str) -> None:
    for seed in range(3):
        for dither in (0.0, 5e-3):
            assert is_recognised(
                closed_loop_record(controller, seed=seed, dither=dither, delayed=True)
            ), (seed, dither)


def test_cooler_and_saturated_controller_are_recognised() -> None:
    assert is_recognised(closed_loop_record("PI", heating=False))
    assert is_recognised(closed_loop_record("clipped PI", noise=0.3))


def test_coarsely_quantised_input_is_recognised() -> None:
    """Steps of 0.3 % of an input that moves by 3 %."""
    assert is_recognised(closed_loop_record("PI", samples=1000, step=0.3, disturbance=3.0))


def test_noise_on_the_input_is_recognised_in_a_long_record() -> None:
    """Noise of 0.01 % is 2 % of the controller's output variation."""
    for seed in range(3):
        assert is_recognised(closed_loop_record("PI", samples=1000, seed=seed, dither=0.01)), seed


@pytest.mark.parametrize("kind", OPEN_LOOPS)
def test_open_loops_are_not_taken_for_closed_ones(kind: str) -> None:
    for samples in (100, 600):
        for seed in range(4):
            data = open_loop_record(kind, samples=samples, seed=seed)
            assert not is_recognised(data), (samples, seed)


def test_closed_loop_error_says_what_to_do() -> None:
    data = closed_loop_record("PI")
    for call in (fit, compare):
        with pytest.raises(
            InputError, match="the input heater follows the output T1: it is computed from it"
        ) as caught:
            call(data)
        assert "manual" in str(caught.value)
        assert "check=False" in str(caught.value)


def test_disabled_check_gives_a_warning() -> None:
    comparison = compare(closed_loop_record("PI"), "P1Z", check=False, **PLAIN)
    assert "record.closed_loop" in {f.code for f in comparison.best.findings}
    assert comparison.conclusion.severity is Severity.WARNING
    assert not comparison.conclusion.sentence.startswith("Recommended")


@pytest.mark.parametrize(("controller", "dither"), [("PI", 0.05), ("PID", 0.05), ("PI", 0.5)])
def test_wrong_model_of_a_noisy_loop_is_not_recommended(controller: str, dither: float) -> None:
    """Too noisy for the check: the plant has a gain of 2 K/%, the model a negative one or none."""
    data = closed_loop_record(controller, samples=300, seed=1, dither=dither, noise=0.3)
    comparison = compare(data, "P1", "P1Z", check=False, **PLAIN)
    assert comparison.best.identified.gain < 0.1
    assert comparison.conclusion.severity is not Severity.INFO


def test_closed_loop_input_is_named_among_several() -> None:
    loop = closed_loop_record("PI").runs[0]
    open_loop_input = open_loop_record("binary").runs[0].u[:, 0]
    data = IOData.from_arrays(
        np.column_stack([open_loop_input, loop.u[:, 0]]), loop.y, 1.0, input_names=["fan", "heater"]
    )
    assert [f.subject for f in closed_loop(data)] == ["heater"]


def test_runs_and_gaps_do_not_change_the_decision() -> None:
    loops = [closed_loop_record("PI", samples=200, seed=seed) for seed in range(3)]
    assert is_recognised(loops[0].merge(*loops[1:]))
    run = closed_loop_record("PI").runs[0]
    y = run.y.copy()
    y[200:215] = np.nan
    assert is_recognised(replace(loops[0], runs=(replace(run, y=y),)))
    assert not is_recognised(open_loop_record("random").merge(open_loop_record("random", seed=1)))


def test_short_or_constant_records_are_not_decided() -> None:
    data = closed_loop_record("PI", samples=30)
    assert not is_recognised(data)
    constant = IOData.from_arrays(np.ones(200), data.runs[0].y[:1, 0] + np.zeros(200), 1.0)
    assert closed_loop(constant) == ()
