"""Advice of a model comparison: a model whose residuals contradict it is never recommended without
a warning."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from identify_cases import PLAIN, case_a

import tcdyn
from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core.findings import info
from tcdyn.identification import CANDIDATES, IOData, compare, simulate
from tcdyn.identification.models import process
from tcdyn.identification.recommendation import chain_advice, comparison_table, conclude, recommend
from tcdyn.rig.disk import Conditioning


def row(model: str, bic: float, **overrides: Any) -> dict[str, Any]:
    """A row of the comparison table; keywords override the defaults."""
    scores = {
        "parameters": 3,
        "fit_percent": 90.0,
        "rms": 0.1,
        "BIC": bic,
        "held_out_rms": 0.1,
        "block_rms": 0.1,
    }
    checks = {
        "p_white": 0.5,
        "p_input": 0.5,
        "remark": "",
        "determined": "remark" not in overrides,
    }
    return {
        "model": model,
        **scores,
        "held_out_percent": 88.0,
        "p_held_out": 0.0,
        **checks,
        **overrides,
    }


def advice_text(*rows: dict[str, Any], untried: tuple[str, ...] = ()) -> str:
    """The advice given for these rows."""
    table = pd.DataFrame(rows)
    return conclude(table, *recommend(table), untried).sentence


def test_model_that_misses_dynamics_is_replaced_by_one_that_does_not() -> None:
    table = pd.DataFrame([row("P1", 0.0, p_input=1e-6), row("P2", 5.0)])
    name, why = recommend(table)
    assert name == "P2"
    assert "P1 would score better but misses dynamics" in why.sentence
    assert why.numbers["missing"] == ("P1",)


def test_known_response_with_undetermined_parameters_beats_a_model_that_misses_dynamics() -> None:
    """Two coinciding lags cannot be determined separately; one well determined lag does not follow
    the data."""
    table = pd.DataFrame(
        [row("P2", 0.0, remark="T1, T2 are hardly determined"), row("P1", 900.0, p_input=1e-40)]
    )
    assert recommend(table)[0] == "P2"
    assert advice_text(*table.to_dict("records")).startswith("Use P2 with care.")


def test_an_integrator_is_doubtful_where_a_long_lag_describes_the_record_as_well() -> None:
    long_lag = row("P1D", 1.5, remark="Tp1 is hardly determined")
    advice = advice_text(row("P1I", 0.0), long_lag)
    assert advice.startswith("Use P1I with care.")
    assert "P1D, whose output settles, describes the record as well" in advice
    assert advice_text(row("P1I", 0.0), row("P1D", 6.0)).startswith("Recommended: P1I")
    assert advice_text(row("P1DI", 0.0), row("P1I", 1.0)).startswith("Recommended: P1DI")


def test_small_residuals_that_follow_the_input_are_a_warning_and_large_ones_an_error() -> None:
    close = row("P2D", 0.0, p_input=1e-6, fit_percent=97.0, held_out_percent=96.0)
    advice = advice_text(close)
    assert advice.startswith("Provisionally P2D")
    assert "97.0 % of the output, but the residuals still follow the input" in advice
    for name in ("fit_percent", "held_out_percent"):
        assert advice_text(close | {name: 80.0}).startswith("None of these models")


def test_a_model_that_is_farther_from_the_record_than_a_constant_is_provisional() -> None:
    advice = advice_text(row("P2D", 0.0, fit_percent=-32.0))
    assert advice.startswith("Provisionally P2D")
    assert "a constant is (-32 %): the disturbance may replace dynamics" in advice
    assert advice_text(row("P2D", 0.0, fit_percent=2.0)).startswith("Recommended: P2D")


def test_no_model_is_recommended_if_all_miss_dynamics() -> None:
    advice = advice_text(
        row("P1", 0.0, p_input=1e-6), row("P2", 5.0, p_input=1e-3), untried=("P3", "P3D")
    )
    assert advice.startswith("None of these models is good enough")
    assert "Recommended" not in advice
    assert "models=['P3', 'P3D']" in advice
    # no linear model is left to try
    assert "narx=True" in advice_text(row("P1", 0.0, p_input=1e-6))


def test_advice_names_coloured_residuals_and_undetermined_parameters() -> None:
    assert "do not contradict it" in advice_text(row("P1", 0.0))
    advice = advice_text(row("P1", 0.0, p_white=1e-5))
    assert "coloured" in advice
    assert "cannot detect a response to the input" in advice
    assert advice_text(row("P1", 0.0, remark="Td is hardly determined")).startswith(
        "Use P1 with care."
    )


def test_one_lag_is_rejected_for_data_of_two_lags_and_two_are_recommended() -> None:
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([0.0, 1.0], 60), 20)
    y = Chain((0.8, 0.3), conditioning=NO_CONDITIONING).response(u, 0.05, hold="zoh") + rng.normal(
        0, 0.01, len(u)
    )
    data = IOData.from_arrays(u, np.ravel(y), 0.05, hold="zoh")
    assert compare(data, ["P1"], **PLAIN).advice.startswith("None of these models")
    comparison = compare(data, ["P1", "P2"], **PLAIN)
    assert comparison.recommended == "P2"
    assert comparison.summary().startswith("Recommended: P2.")


def test_comparison_table_fits_an_80_column_terminal() -> None:
    table = pd.DataFrame([row("P2DZ", 0.0), row("P1", 1234.5, p_input=1e-40, p_white=0.0)])
    text = comparison_table(table).to_string(index=False)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "e-" not in text  # a p of 1e-40 is printed as "below 0.01"


def test_advice_names_models_with_a_bic_within_2_of_the_best() -> None:
    assert "P2Z within 2 of its BIC would do as well" in advice_text(
        row("P2D", 0.0), row("P2Z", 0.5), row("P3", 9.0)
    )
    assert "would do as well" not in advice_text(row("P2D", 0.0), row("P3", 9.0))


def test_advice_first_suggests_an_estimated_initial_state() -> None:
    table = pd.DataFrame([row("P1", 0.0, p_input=1e-6)])
    conclusion = conclude(table, *recommend(table), troubles=("record.off_equilibrium",))
    assert conclusion.code == "models.none"
    assert conclusion.numbers["against"] == "dynamics"
    assert "Next, let the runs start off equilibrium" in conclusion.sentence


def test_chain_advice_evaluates_to_the_identified_chain_without_the_known_filter() -> None:
    """The printed text is Python: evaluated, it gives the chain to the digits shown."""
    conditioning = Conditioning(4.0, 2)
    u = np.repeat([0.0, 1.0, 0.0, 1.0], 200)
    y = Chain((0.8, 0.3), conditioning=conditioning).response(u, 0.05, hold="zoh")
    data = IOData.from_arrays(
        u, np.ravel(y) + np.random.default_rng(1).normal(0, 1e-3, len(u)), 0.05, hold="zoh"
    )
    best = compare(data, [process("P2", known=conditioning)], **PLAIN).best.identified
    match = re.search(
        r"tcdyn\.smooth\(y, dt, (tcdyn\.Chain\(.*\))\);", chain_advice(best, conditioning)
    )
    chain = eval(match[1], {"tcdyn": tcdyn}) if match else None
    assert chain.conditioning == conditioning
    # tolerance: noise of 0.1 % over four steps
    assert np.allclose(chain.taus_s, (0.8, 0.3), rtol=0.01)
    # identified with a filter: without it, it is another chain
    assert chain_advice(best, NO_CONDITIONING) == ""
    plain = compare(data, [process("P2")], **PLAIN).best.identified
    # a chain without a filter has no cut-off
    assert "conditioning=tcdyn.Conditioning(poles=0)" in chain_advice(plain)


def test_two_forms_of_one_model_differ_by_rounding_and_the_first_is_recommended() -> None:
    table = pd.DataFrame([row("P2D", 0.0), row("TF(0,2)D", -1e-9)])
    name, why = recommend(table)
    assert name == "P2D"
    assert why.numbers["by"] == "BIC"


@pytest.mark.parametrize("contradicted", ["p_white", "p_input"])
def test_held_out_error_decides_only_where_the_residuals_contradict_the_lowest_bic(
    contradicted: str,
) -> None:
    rival = row("P1", 30.0, held_out_rms=0.05)
    assert recommend(pd.DataFrame([row("P1D", 0.0), rival]))[0] == "P1D"
    table = pd.DataFrame([row("P1D", 0.0, **{contradicted: 1e-4}), rival | {contradicted: 1e-4}])
    name, why = recommend(table)
    assert name == "P1"
    assert why.numbers["by"] == "held out"
    # an error that is smaller by less than 3 % does not decide
    assert recommend(table.assign(held_out_rms=[0.1, 0.098]))[0] == "P1D"
    # the blocks of the record count as much as the held-out part
    assert recommend(table.assign(block_rms=[0.1, 0.3]))[0] == "P1D"


def test_model_that_is_not_determined_replaces_one_that_is_only_by_a_fifth_of_the_error() -> None:
    coloured = {"p_white": 1e-4}
    determined = row("P1D", 0.0, **coloured)
    for error, expected in ((0.07, "P1D"), (0.03, "P3")):
        rival = row("P3", 30.0, held_out_rms=error, **coloured) | {"determined": False}
        assert recommend(pd.DataFrame([determined, rival]))[0] == expected


def test_input_test_passed_for_lack_of_power_does_not_overrule_a_decisive_bic() -> None:
    """A model that explains decisively less has larger residuals, in which the test cannot detect
    the input."""
    for extra in ({}, {"remark": "Tp1 equals another lag"}):
        table = pd.DataFrame([row("P2U", 0.0, p_input=1e-4), row("P2D", 200.0, **extra)])
        assert recommend(table)[0] == "P2U"
        assert advice_text(*table.to_dict("records")).startswith("None of these models")


def test_model_worse_than_the_mean_is_recommended_only_if_the_held_out_data_are_noise() -> None:
    worse = row("P1", 0.0, held_out_percent=-64.0, held_out_rms=0.5)
    assert advice_text(worse).startswith("None of these models")
    # 0.1 rms, as in the fit: all noise
    assert advice_text(row("P1", 0.0, held_out_percent=-1.0)).startswith("Recommended")
    assert advice_text(row("P1", 0.0, held_out_percent=-8.0, p_white=1e-9)).startswith(
        "Provisionally P1."
    )
    assert "nan" not in advice_text(row("P1", 0.0, held_out_percent=np.nan, p_input=1e-6))
    table = pd.DataFrame([row("P1", 0.0, held_out_percent=np.nan)])
    assert "nan" not in comparison_table(table).to_string()
    assert advice_text(row("P1", 0.0, fit_percent=30.0, p_white=1e-9)).startswith(
        "None of these models"
    )
    # white noise may be large
    assert "30 % of the output" in advice_text(row("P1", 0.0, fit_percent=30.0))


def test_problems_of_the_record_come_before_any_recommendation() -> None:
    for overrides in ({}, {"p_white": 1e-5}, {"remark": "Td is hardly determined"}):
        table = pd.DataFrame([row("P1", 0.0, **overrides)])
        conclusion = conclude(table, *recommend(table), troubles=("record.drift",))
        assert "But first fit with baseline=trend." in conclusion.sentence
        assert conclusion.code in ("models.provisional", "models.undetermined")


def off_equilibrium() -> IOData:
    """One lag of 3 s that begins 5 units above its equilibrium."""
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([0.0, 1.0], 24), 25)
    y = simulate(process("P1").rational({"Kp": 4.0, "Tp1": 3.0}), u, 0.2, "zoh") + 10
    y = y + 5 * np.exp(-0.2 * np.arange(len(u)) / 3) + 0.05 * rng.normal(size=len(u))
    return IOData.from_arrays(u, y, 0.2, hold="zoh")


@pytest.mark.long
@pytest.mark.study
def test_runs_off_equilibrium_are_refitted_with_estimated_initial_state() -> None:
    comparison = compare(off_equilibrium(), ["P1", "P2", "P2Z"])
    assert comparison.advice.startswith("Recommended: P1.")
    assert "the state at each start was estimated" in comparison.reason_text
    assert comparison.best.estimates["Tp1"].value == pytest.approx(
        3.0, abs=4 * comparison.best.estimates["Tp1"].u
    )
    at_equilibrium = compare(off_equilibrium(), ["P1", "P2", "P2Z"], **PLAIN)
    assert "Recommended" not in at_equilibrium.advice
    assert "initial=estimated" in at_equilibrium.advice
    assert "spikes" not in at_equilibrium.best.identified.sentence


def test_two_real_lags_are_not_reported_as_an_oscillating_pair() -> None:
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([0.0, 10.0], 20), 60)
    y = Chain((50.0, 5.0), conditioning=NO_CONDITIONING).response(u, 1.0, hold="zoh")
    data = IOData.from_arrays(u, np.ravel(y) + 0.05 * rng.normal(size=len(u)), 1.0, hold="zoh")
    comparison = compare(data, ["P2U", "P2"], **PLAIN)
    assert comparison.recommended == "P2"
    assert "P2U is left out" in comparison.reason_text


@pytest.mark.long
@pytest.mark.study
def test_candidates_include_oscillators_with_dead_time_and_integrators_are_suggested() -> None:
    assert "P2DU" in CANDIDATES
    rng = np.random.default_rng(9)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 20)
    y = simulate(
        process("P1I").rational({"Kp": 0.05, "Tp1": 2.0}), u, 0.5, "zoh"
    ) + 0.01 * rng.normal(size=len(u))
    data = IOData.from_arrays(u, y, 0.5, hold="zoh")
    advice = compare(data, CANDIDATES[:2]).advice
    assert advice.startswith("None of these models")
    table = pd.DataFrame([row(name, 0.0, p_input=1e-9) for name in CANDIDATES])
    assert "models=['P1I', 'P1DI']" in replace(compare(data, ["P1"]), table=table).advice


def test_progress_callback_is_called_before_each_fit() -> None:
    progress_calls: list[tuple[str, int, int]] = []
    compare(
        off_equilibrium(),
        ["P1", "P1D"],
        initial="estimated",
        progress=lambda *arguments: progress_calls.append(arguments),
        noise="white",
        baseline="none",
    )
    assert progress_calls == [("P1", 1, 2), ("P1D", 2, 2)]


def test_prediction_finding_states_the_error_ratio() -> None:
    sentence = info(
        "models.foresees", subject="TF(2,2)", other="P1D", ratio=0.83, white=True
    ).sentence
    assert sentence == (
        "TF(2,2) simulates data kept from the fit to 83 % of the error of P1D, and leaves "
        "white residuals."
    )


def test_general_transfer_function_is_recommended_provisionally_only() -> None:
    comparison = compare(case_a("PRBS", 3), "P2D", **PLAIN)
    assert comparison.conclusion.code == "models.recommended"
    reason = replace(
        comparison.reason,
        code="models.foresees",
        numbers={"white": True, "other": "P2D", "ratio": 0.9},
    )
    general = replace(comparison, reason=reason)
    assert general.conclusion.code == "models.provisional"
    assert "depend on its order" in general.conclusion.sentence
