"""A lead is causal, an output before its input is not; advice never contradicts the causality
check."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from disturbance_study import record
from identify_cases import PLAIN, case_a, case_a_input
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.identification import IOData, compare, fit
from tcdyn.identification.causality import check_causality
from tcdyn.identification.models import process
from tcdyn.identification.search import make_problem

FINER = 10
DT_S = 0.05


def lead(test_kind: str, tau_s: float, ratio: float, tau2_s: float, noise: float) -> IOData:
    """(1 + ratio tau s) / ((1 + tau s)(1 + tau2 s)) by first-order recursions on a grid ten times
    finer."""
    rng = np.random.default_rng(0)
    h = DT_S / FINER
    t = np.arange(800 * FINER) * h
    u = {
        "plunge": 25 + 155 * (1 - np.exp(-np.clip(t - 2, 0, None) / 3)),
        "PRBS": np.repeat(case_a_input("PRBS", rng)[0], FINER),
        "sines": 50 + 20 * np.sin(0.7 * t) + 10 * np.sin(1.9 * t + 1) + 5 * np.sin(4.1 * t),
    }[test_kind]

    def lag(x: np.ndarray, tau: float) -> np.ndarray:
        a = np.exp(-h / tau)
        return lfilter([1 - a], [1, -a], np.concatenate([x[:1], x[:-1]]), zi=[a * x[0]])[0]

    y = ratio * u + (1 - ratio) * lag(u, tau_s)
    y = lag(y, tau2_s) if tau2_s else y
    hold = "zoh" if test_kind == "PRBS" else "foh"
    return IOData.from_arrays(
        u[::FINER], y[::FINER] + noise * rng.normal(size=800), DT_S, hold=hold
    )


def is_rejected(data: IOData) -> bool:
    """Whether the causality check raises."""
    try:
        check_causality(make_problem(data, process("P2DZ"), "equilibrium"), "record")
    except InputError:
        return True
    return False


@pytest.mark.e2e
@pytest.mark.parametrize("test_kind", ["plunge", "PRBS", "sines"])
def test_causal_leads_are_accepted(test_kind):
    """48 leads. One lag shifted forward in time repeats some of them better than one lag without a
    shift."""
    for case in product((0.2, 1.0), (2.0, 5.0), (0.0, 0.3), (0.05, 0.5)):
        assert not is_rejected(lead(test_kind, *case)), case


@pytest.mark.parametrize("test_kind", ["plunge", "PRBS"])
def test_shifted_and_exchanged_columns_raise(test_kind):
    for noise in (0.05, 0.5):
        data = case_a(test_kind, 0, noise=noise)
        u = data.runs[0].u[:, 0]
        y = data.runs[0].y[:, 0]
        for shift_samples in (
            60,
            100,
        ):  # more than the lag of 57 samples, so that the output moves first
            shifted = IOData.from_arrays(
                np.concatenate([np.full(shift_samples, u[0]), u[:-shift_samples]]),
                y,
                0.05,
                hold=data.hold,
            )
            assert is_rejected(shifted), (noise, shift_samples)
        assert is_rejected(IOData.from_arrays(y, u, 0.05)), noise


def test_lead_is_recovered():
    result = fit(lead("plunge", 1.0, 2.0, 0.3, 0.05), "P2Z", **PLAIN)
    for name, true_value in (("Tp1", 1.0), ("Tp2", 0.3), ("Tz", 2.0)):
        # the recursion holds each fine sample: 2.5 ms for each lag
        assert result.estimates[name].value == pytest.approx(
            true_value, abs=4 * result.estimates[name].u + 0.01
        ), name


def test_advice_offers_no_chain_of_a_model_that_misses_dynamics():
    data = record("PRBS", 1)
    too_small = compare(data, ["P1"], **PLAIN)
    assert too_small.conclusion.severity is Severity.ERROR
    assert "Do not trust" in too_small.advice
    assert too_small.lag_removal_advice() == ""
    assert "Chain(" in compare(data, ["P2D"], **PLAIN).lag_removal_advice()


@pytest.mark.e2e
def test_robust_loss_gives_no_false_alarms():
    """The lagged inputs must be weighted as the residuals are; otherwise 20 of 30 runs warn of
    missing dynamics."""
    alarms = 0
    for seed in range(30):
        data = record("PRBS", seed)
        rng = np.random.default_rng(1000 + seed)
        y = data.runs[0].y[:, 0] + np.where(rng.random(800) < 0.03, 10 * rng.normal(size=800), 0.0)
        robust = fit(
            IOData.from_arrays(data.runs[0].u, y, 0.05, hold="zoh"),
            "P2D",
            loss="huber",
            check=False,
            start={"Kp": 1.0, "Tp1": 2.0, "Tp2": 0.5, "Td": 0.37},
            **PLAIN,
        )
        alarms += robust.identified.statistics["p_input"] < 0.01
    assert alarms <= 2  # 1 % of 30; three or more occur once in 300


def test_a_sine_from_a_cold_start_is_no_output_that_moves_first() -> None:
    """Two periods; the output rises through the first, as in a laboratory heater."""
    t_s = np.arange(0.0, 1260.0, 1.0)
    heater = 20.0 + 20.0 * np.sin(2 * np.pi * t_s / 525.0)
    decay = np.exp(-1.0 / 170.0)
    rise = lfilter([1 - decay], [1.0, -decay], np.concatenate([np.zeros(20), heater[:-20]]))
    slow = np.exp(-1.0 / 500.0)
    block = lfilter([1 - slow], [1.0, -slow], rise)
    noise = np.random.default_rng(0).normal(0.0, 0.2, len(t_s))
    data = IOData.from_arrays(heater, 26.0 + 0.5 * rise + 0.6 * block + noise, 1.0, hold="zoh")
    check_causality(make_problem(data, process("P1D"), "equilibrium"), "record")
