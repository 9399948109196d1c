"""Inputs that do not determine gain and lag: a sine in the steady state, inputs that move
together."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.identification import IOData, compare, fit
from tcdyn.identification.excitation import excitation
from tests.identify.bare_cases import response

DT_S = 0.05
PERIOD_S = 6.0
N = 800


def sine_record(rest_s: float, noise: float = 0.05) -> IOData:
    """A sine of which the record begins ``rest_s`` before its start; the system is that of case
    A."""
    t = DT_S * np.arange(-2000, N)
    started = t >= rest_s if rest_s > 0 else np.ones(len(t), dtype=bool)
    u = np.where(started, 50 + 20 * np.sin(2 * np.pi * (t - rest_s) / PERIOD_S), 50.0)
    y = response(u) + noise * np.random.default_rng(1).standard_normal(len(t))
    return IOData.from_arrays(u[-N:], y[-N:], DT_S)


@pytest.mark.e2e
def test_a_sine_in_the_steady_state_is_accepted_with_a_warning() -> None:
    """It was refused as an output that moves before its input."""
    result = compare(sine_record(-1.0))
    assert result.conclusion.severity is Severity.WARNING
    assert "one sine determines neither gain nor lag" in result.conclusion.sentence
    (found,) = (f for f in result.best.findings if f.code == "record.one_frequency")
    assert found.numbers["period_s"] == pytest.approx(PERIOD_S, rel=0.02)


def test_the_transient_at_the_start_of_a_sine_determines_gain_and_lag() -> None:
    data = sine_record(5.0)
    assert excitation(data) == ()
    result = fit(data, "P2D", noise="white")
    assert result.estimates["Kp"].contains(1.0)


def test_square_waves_and_single_steps_are_not_one_frequency() -> None:
    t = DT_S * np.arange(N)
    for u in (np.sign(np.sin(2 * np.pi * t / PERIOD_S)), np.where(t > 10, 1.0, 0.0)):
        assert excitation(IOData.from_arrays(u, response(u), DT_S)) == ()


def test_a_shifted_output_is_still_refused_where_the_input_is_not_periodic() -> None:
    u = np.repeat(np.random.default_rng(2).choice([0.0, 1.0, 3.0], 40), 20)
    y = np.roll(response(u), -60)
    with pytest.raises(InputError, match="before the input"):
        fit(IOData.from_arrays(u, y, DT_S), "P1D")


@pytest.mark.e2e
@pytest.mark.parametrize(("other", "is_reported"), [(0.0, True), (0.5, False)])
def test_inputs_that_move_together_are_reported(other: float, is_reported: bool) -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([0.0, 1.0, 3.0], 40), 20)
    v = 0.1 * u + other * np.repeat(rng.choice([0.0, 1.0], 50), 16)
    y = response(u) + 0.01 * rng.standard_normal(N)
    data = IOData.from_arrays(np.column_stack([u, v]), y, DT_S, hold="zoh")
    codes = [f.code for f in excitation(data)]
    assert codes == (["record.inseparable"] * 2 if is_reported else [])
    if is_reported:
        result = compare(data, "P2D")
        assert result.conclusion.severity is Severity.WARNING
        assert "move each input alone" in result.conclusion.sentence
