"""An input switched by a thermostat is named as such; an open-loop on/off input is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_loop_cases import OPEN_LOOPS, closed_loop_record, open_loop_record
from identify_cases import PLAIN
from thermostat_cases import OPEN_KINDS, Noise, as_record, on_off_record, thermostat_record

from tcdyn.core.findings import Severity
from tcdyn.identification import IOData, compare, fit
from tcdyn.identification.closed_loop import closed_loop
from tcdyn.identification.thermostat import find_thermostat

N_RECORDS = 3  # of each kind; thermostat_study.py has 40 and 200
EXACT = Noise(noise_K=0.0, rounding_K=0.0, own_sensor=False)


def codes(data: IOData) -> list[str]:
    """Codes of the findings about closed loops."""
    return [f.code for f in closed_loop(data)]


def evidence(u: np.ndarray, y: np.ndarray) -> float:
    """Log likelihood ratio of a thermostat to an open loop."""
    found = find_thermostat([(u, y)])
    return 0.0 if found is None else found.evidence


@pytest.mark.parametrize("load", ["steps", "wave", "random"])
@pytest.mark.parametrize("hysteresis_K", [0.5, 5.0])
def test_thermostats_under_changing_load_are_named(load: str, hysteresis_K: float) -> None:
    for seed in range(N_RECORDS):
        data = thermostat_record(seed, load=load, hysteresis_K=hysteresis_K)
        assert codes(data) == ["record.thermostat"], seed


@pytest.mark.parametrize(
    "options",
    [
        {"cooler": True},
        {"input_noise": 3.0},
        {"noise": Noise(noise_K=0.1, rounding_K=0.1, own_sensor=True)},
        {"delay_rows": 4},
        {"n_cycles": 5},
    ],
    ids=lambda options: next(iter(options)),
)
def test_thermostats_of_other_kinds_are_named(options: dict[str, object]) -> None:
    for seed in range(N_RECORDS):
        assert codes(thermostat_record(seed, **options)) == ["record.thermostat"], seed


def test_heating_from_cold_shows_a_thermostat_under_constant_load() -> None:
    for seed in range(N_RECORDS):
        data = thermostat_record(seed, load="constant", from_cold=True)
        assert codes(data) == ["record.thermostat"], seed


def test_equal_phases_of_an_exact_thermostat_are_those_of_a_timer() -> None:
    data = thermostat_record(0, load="constant", from_cold=False, noise=EXACT)
    assert codes(data) == []


@pytest.mark.parametrize("kind", OPEN_KINDS)
def test_open_loop_on_off_inputs_are_not_named(kind: str) -> None:
    for seed in range(N_RECORDS):
        assert codes(on_off_record(kind, seed)) == [], seed


@pytest.mark.parametrize("kind", OPEN_LOOPS)
def test_inputs_of_other_open_loops_are_not_named(kind: str) -> None:
    for seed in range(N_RECORDS):
        assert codes(open_loop_record(kind, seed=seed)) == [], seed


@pytest.mark.parametrize("lag_rows", [0.5, 5.0])
def test_fast_plant_at_rest_at_each_switch_gives_no_evidence(lag_rows: float) -> None:
    """The levels at the switches are equal and the durations differ, but the output is there long
    before the switch. Without noise the output is at its limit at the last row of each phase."""
    rng = np.random.default_rng(0)
    rows = rng.integers(30, 150, 40)
    on = np.repeat(np.arange(40) % 2, rows)
    y = np.zeros(len(on))
    for k in range(1, len(on)):
        y[k] = y[k - 1] + (1 - np.exp(-1 / lag_rows)) * (10.0 * on[k - 1] - y[k - 1])
    assert evidence(on.astype(float), y) < 1.0


def test_decision_does_not_depend_on_units_offset_or_sign() -> None:
    run = thermostat_record(1).runs[0]
    u = run.u[:, 0]
    y = run.y[:, 0]
    expected = evidence(u, y)
    assert expected > 10
    assert evidence(0.3 * u - 7.0, 1.8 * y + 32.0) == pytest.approx(expected)
    assert evidence(u, -y) == pytest.approx(expected)
    assert evidence(-u, y) == pytest.approx(expected)


def test_limits_are_the_readings_at_which_the_relay_switches() -> None:
    """A triangle between 40 and 50 whose slopes change: the relay acts in the row of the reading.
    The step of a row is 0.2 at most."""
    rng = np.random.default_rng(2)
    y = np.empty(2000)
    on = np.empty(2000, dtype=bool)
    level = 45.0
    state = True
    rate = 0.1
    for k in range(len(y)):
        y[k] = level
        changed = (level >= 50.0) if state else (level <= 40.0)
        if changed:
            state = not state
            rate = rng.uniform(0.05, 0.2)
        on[k] = state
        level += rate if state else -rate
    found = find_thermostat([(on.astype(float), y)])
    assert found is not None
    assert found.is_named
    assert found.delay == 0
    assert found.off_at == pytest.approx(50.1, abs=0.1)
    assert found.on_at == pytest.approx(39.9, abs=0.1)


def test_runs_and_gaps_of_the_output_do_not_change_the_decision() -> None:
    data = thermostat_record(1)
    run = data.runs[0]
    middle = run.n // 2
    first = as_record(run.u[:middle, 0], run.y[:middle, 0], "first half")
    second = as_record(run.u[middle:, 0], run.y[middle:, 0], "second half")
    assert codes(first.merge(second)) == ["record.thermostat"]
    y = run.y.copy()
    y[40:45] = np.nan
    y[middle : middle + 30] = np.nan
    assert codes(replace(data, runs=(replace(run, y=y),))) == ["record.thermostat"]


def test_thermostat_input_is_named_among_several() -> None:
    run = thermostat_record(0).runs[0]
    fan = np.random.default_rng(0).normal(size=run.n)
    data = IOData.from_arrays(
        np.column_stack([fan, run.u[:, 0]]), run.y, 1.0, input_names=["fan", "heater"]
    )
    assert [(f.code, f.subject) for f in closed_loop(data)] == [("record.thermostat", "heater")]


def test_few_switches_and_constant_input_are_not_decided() -> None:
    run = thermostat_record(0).runs[0]
    u = run.u[:, 0]
    third = int(np.flatnonzero(np.diff(u))[2]) + 2
    assert find_thermostat([(u[:third], run.y[:third, 0])]) is None
    assert find_thermostat([(np.ones(100), run.y[:100, 0])]) is None
    assert find_thermostat([]) is None


def test_warning_says_limits_and_remedy() -> None:
    data = thermostat_record(0)
    result = fit(data, "P1D", **PLAIN)
    (finding,) = [f for f in result.findings if f.code == "record.thermostat"]
    assert "heater is switched by the output T1" in finding.sentence
    assert "off near" in finding.sentence
    assert "timer" in finding.sentence


@pytest.mark.parametrize("check", [True, False])
def test_a_comparison_warns_with_and_without_the_check(check: bool) -> None:
    data = thermostat_record(2, n_cycles=6)
    comparison = compare(data, "P1", "P1D", check=check, **PLAIN)
    assert "record.thermostat" in {f.code for f in comparison.best.findings}
    assert comparison.conclusion.severity is not Severity.INFO


def test_noisy_relay_loop_of_the_other_simulator_is_named() -> None:
    for seed in range(N_RECORDS):
        data = closed_loop_record("thermostat", seed=seed)
        assert codes(data) in (["record.thermostat"], ["record.closed_loop"]), seed
