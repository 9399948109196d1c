"""Plants that are not linear: the result says so, and linear plants do not get this message.

``python -m tests.identify.test_identify_nonlinear 40`` prints how often it is found in each plant.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from tcdyn.core import Array
from tcdyn.core.findings import Severity
from tcdyn.identification import IOData, compare, fit, process, simulate, validate

STEP_S = 0.1  # of Euler's method
DT_S = 5.0
STEPS = round(DT_S / STEP_S)
CODE = "record.nonlinear"


def sampled(
    rng: np.random.Generator,
    levels: tuple[float, ...],
    rate: Callable[[Array, float], Array],
    state: Callable[[float], Array],
    noise_K: float,
) -> IOData:
    """A record of 20 levels of 200 s: the last state of dx/dt = ``rate(x, u)``."""
    u = np.repeat(rng.choice(levels, 20), 40)
    x = state(u[0])
    y = []
    for level in u.tolist():
        y.append(x[-1])
        for _ in range(STEPS):
            x = x + STEP_S * rate(x, level)
    return IOData.from_arrays(u, np.array(y) + noise_K * rng.normal(size=len(u)), DT_S, hold="zoh")


def asymmetric(seed: int) -> IOData:
    """A lag of 60 s upward and 180 s downward."""

    def rate(x: Array, u: float) -> Array:
        return (u - x) / np.where(u > x, 60.0, 180.0)

    return sampled(
        np.random.default_rng(seed), (0.0, 30.0, 60.0, 100.0), rate, lambda u: np.array([u]), 0.1
    )


def limited(seed: int, limit: float = 100.0) -> IOData:
    """The plant follows the command up to 100 % only; two lags of 80 and 10 s."""

    def rate(x: Array, u: float) -> Array:
        return np.array([(0.9 * min(u, limit) - x[0]) / 80, (x[0] - x[1]) / 10])

    def state(u: float) -> Array:
        return np.full(2, 0.9 * min(u, limit))

    return sampled(np.random.default_rng(seed), (0.0, 50.0, 100.0, 150.0), rate, state, 0.1)


def convecting(seed: int) -> IOData:
    """Natural convection: the loss is proportional to the power 1.25 of the excess temperature."""

    def rate(x: Array, u: float) -> Array:
        return (u - 0.4 * np.maximum(x, 0.0) ** 1.25) / 60

    def state(u: float) -> Array:
        return np.array([(u / 0.4) ** 0.8])

    return sampled(np.random.default_rng(seed), (10.0, 40.0, 70.0, 100.0), rate, state, 0.1)


def changing(seed: int) -> IOData:
    """A lag that doubles in the course of the record, from 60 to 120 s, as the flow slows down."""
    elapsed_s = np.zeros(1)

    def rate(x: Array, u: float) -> Array:
        elapsed_s[0] += STEP_S
        return (u - x) / (60.0 + 60.0 * elapsed_s[0] / (800 * DT_S))

    return sampled(
        np.random.default_rng(seed), (0.0, 30.0, 60.0, 100.0), rate, lambda u: np.array([u]), 0.1
    )


def linear(seed: int) -> IOData:
    """The same plant without the limit."""
    return limited(seed, np.inf)


@pytest.mark.e2e
@pytest.mark.parametrize("plant", [asymmetric, pytest.param(limited, marks=pytest.mark.long)])
def test_a_plant_that_is_not_linear_is_reported(plant: Callable[[int], IOData]) -> None:
    result = compare(plant(3))
    found = {f.code: f for f in result.validation.findings}
    assert CODE in found
    assert found[CODE].severity is Severity.WARNING
    assert result.conclusion.severity is not Severity.INFO
    assert "two neighbouring levels" in result.conclusion.sentence


@pytest.mark.e2e
def test_natural_convection_and_a_changing_flow_are_named() -> None:
    for plant, code in ((convecting, CODE), (changing, "record.changing")):
        result = compare(plant(3))
        found = {f.code: f for f in result.validation.findings}
        assert code in found, plant
        assert result.conclusion.severity is Severity.WARNING


@pytest.mark.parametrize("bend", [0.1, 0.3])
def test_a_gain_that_changes_with_the_output_has_the_stated_size(bend: float) -> None:
    """Gain from 1 - bend to 1 + bend times its mean over the range of the output."""
    u = np.repeat(np.random.default_rng(2).choice([0.0, 30.0, 60.0, 100.0], 20), 40)
    x = simulate(process("P1").rational({"Kp": 1.0, "Tp1": 60.0}), u, DT_S, "zoh")
    z = (x - x.min()) / np.ptp(x)
    y = x + bend * np.ptp(x) * (z**2 - z) + 0.1 * np.random.default_rng(3).normal(size=len(u))
    findings = validate(
        fit(IOData.from_arrays(u, y, DT_S, hold="zoh"), "P1", noise="white")
    ).findings
    (found,) = (f for f in findings if f.code == CODE)
    assert found.numbers["gain_percent"] == pytest.approx(200 * bend, rel=0.2)


@pytest.mark.e2e
def test_a_linear_plant_is_not_called_nonlinear() -> None:
    for seed in range(2):
        result = compare(linear(seed))
        assert CODE not in {f.code for f in result.validation.findings}
        assert result.conclusion.severity is Severity.INFO


if __name__ == "__main__":
    for plant_ in (linear, asymmetric, limited, convecting, changing):
        count_ = int(sys.argv[1])
        codes_ = [
            f.code for seed in range(count_) for f in compare(plant_(seed)).validation.findings
        ]
        print(
            f"{plant_.__name__}: not linear in {codes_.count(CODE)}, changing with time in "
            f"{codes_.count('record.changing')} of {count_}"
        )
