"""What a comparison says to do: a model that its own residuals accuse is never just recommended."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core.findings import info
from tcdyn.identify import CANDIDATES, IOData, compare, simulate
from tcdyn.identify.models import process
from tcdyn.identify.recommendation import chain_advice, comparison_table, conclude, recommend
from tcdyn.rig.disk import Conditioning


def row(model: str, bic: float, **other: Any) -> dict[str, Any]:
    plain = {"parameters": 3, "fit_percent": 90.0, "rms": 0.1, "BIC": bic, "held_out_rms": 0.1}
    said = {
        "p_white": 0.5,
        "p_input": 0.5,
        "remark": "",
        "determined": "remark" not in other,
        "refused": False,
    }
    return {"model": model, **plain, "held_out_percent": 88.0, "p_held_out": 0.0, **said, **other}


def told(*rows: dict[str, Any], untried: tuple[str, ...] = ()) -> str:
    table = pd.DataFrame(rows)
    return conclude(table, *recommend(table), untried).sentence


def test_a_model_that_misses_dynamics_gives_way_to_one_that_does_not() -> None:
    table = pd.DataFrame([row("P1", 0.0, p_input=1e-6), row("P2", 5.0)])
    name, why = recommend(table)
    assert name == "P2"
    assert "P1 would score better but misses dynamics" in why.sentence
    assert why.numbers["missing"] == ("P1",)


def test_a_response_that_is_known_beats_parameters_that_are() -> None:
    """Two lags that coincide cannot be told one by one; one lag, well told, does not follow the data at all."""
    table = pd.DataFrame(
        [row("P2", 0.0, remark="T1, T2 are hardly determined"), row("P1", 900.0, p_input=1e-40)]
    )
    assert recommend(table)[0] == "P2"
    assert told(*table.to_dict("records")).startswith("Use P2 with care.")


def test_none_is_recommended_where_all_miss_dynamics() -> None:
    said = told(row("P1", 0.0, p_input=1e-6), row("P2", 5.0, p_input=1e-3), untried=("P3", "P3D"))
    assert said.startswith("None of these models is good enough")
    assert "Recommended" not in said
    assert "models=P3,P3D" in said
    assert "narx=True" in told(
        row("P1", 0.0, p_input=1e-6)
    )  # nothing left to try among the linear ones


def test_colour_and_doubt_are_said_with_the_recommendation() -> None:
    assert "do not contradict it" in told(row("P1", 0.0))
    said = told(row("P1", 0.0, p_white=1e-5))
    assert "coloured" in said
    assert "cannot detect a response to the input" in said
    assert told(row("P1", 0.0, remark="Td is hardly determined")).startswith("Use P1 with care.")


def test_one_lag_is_refused_on_data_of_two_and_two_are_recommended() -> None:
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([0.0, 1.0], 60), 20)
    y = Chain((0.8, 0.3), conditioning=NO_CONDITIONING).response(u, 0.05, hold="zoh") + rng.normal(
        0, 0.01, len(u)
    )
    data = IOData.from_arrays(u, np.ravel(y), 0.05, hold="zoh")
    assert compare(data, ["P1"]).advice.startswith("None of these models")
    both = compare(data, ["P1", "P2"])
    assert both.recommended == "P2"
    assert both.summary().startswith("Recommended: P2.")


def test_the_order_table_fits_a_terminal() -> None:
    table = pd.DataFrame([row("P2DZ", 0.0), row("P1", 1234.5, p_input=1e-40, p_white=0.0)])
    text = comparison_table(table).to_string(index=False)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "e-" not in text  # a p of 1e-40 says no more than "below 0.01"


def test_models_as_good_as_the_recommended_one_are_named() -> None:
    assert "P2Z within 2 of its BIC would do as well" in told(
        row("P2D", 0.0), row("P2Z", 0.5), row("P3", 9.0)
    )
    assert "would do as well" not in told(row("P2D", 0.0), row("P3", 9.0))


def test_a_start_off_equilibrium_is_the_first_thing_to_try() -> None:
    table = pd.DataFrame([row("P1", 0.0, p_input=1e-6)])
    found = conclude(table, *recommend(table), troubles=("record.off_equilibrium",))
    assert found.code == "models.none"
    assert found.numbers["against"] == "dynamics"
    assert "Next, let the runs start off equilibrium" in found.sentence


def test_the_model_is_handed_on_as_the_chain_to_remove_and_a_known_filter_is_no_part_of_its_lags() -> (
    None
):
    """What is printed is Python: evaluated, it gives the chain back to the digits shown."""
    b = Conditioning(4.0, 2)
    u = np.repeat([0.0, 1.0, 0.0, 1.0], 200)
    y = Chain((0.8, 0.3), conditioning=b).response(u, 0.05, hold="zoh")
    data = IOData.from_arrays(
        u, np.ravel(y) + np.random.default_rng(1).normal(0, 1e-3, len(u)), 0.05, hold="zoh"
    )
    best = compare(data, [process("P2", known=b)]).best.identified
    words = re.search(r"tcdyn\.smooth\(y, dt, (tcdyn\.Chain\(.*\))\);", chain_advice(best, b))
    chain = eval(words[1], {"tcdyn": tcdyn}) if words else None
    assert chain.conditioning == b
    assert np.allclose(chain.taus_s, (0.8, 0.3), rtol=0.01)  # noise of 0.1 % over four steps
    assert (
        chain_advice(best, NO_CONDITIONING) == ""
    )  # identified with a filter: without it, it is another chain
    plain = compare(data, [process("P2")]).best.identified
    assert "conditioning=tcdyn.Conditioning(poles=0)" in chain_advice(
        plain
    )  # and no cut-off of a filter that is not there


def test_a_held_out_part_in_which_nothing_happens_does_not_overrule_a_decisive_bic() -> None:
    assert (
        recommend(pd.DataFrame([row("P1D", 0.0), row("P1", 30.0, held_out_rms=0.05)]))[0] == "P1D"
    )
    assert recommend(pd.DataFrame([row("P1D", 0.0), row("P1", 8.0, held_out_rms=0.05)]))[0] == "P1"


def test_a_test_passed_for_want_of_power_does_not_overrule_a_decisive_bic() -> None:
    """What explains decisively less has coarser residuals, beneath which the test sees no input."""
    for more in ({}, {"remark": "Tp1 equals another lag"}):
        table = pd.DataFrame([row("P2U", 0.0, p_input=1e-4), row("P2D", 200.0, **more)])
        assert recommend(table)[0] == "P2U"
        assert told(*table.to_dict("records")).startswith("None of these models")


def test_a_model_worse_than_the_mean_is_not_recommended_unless_nothing_moves_there() -> None:
    bad = row("P1", 0.0, held_out_percent=-64.0, held_out_rms=0.5)
    assert told(bad).startswith("None of these models")
    assert told(row("P1", 0.0, held_out_percent=-1.0)).startswith(
        "Recommended"
    )  # 0.1 rms, as in the fit: all noise
    assert told(row("P1", 0.0, held_out_percent=-8.0, p_white=1e-9)).startswith("Provisionally P1.")
    assert "nan" not in told(row("P1", 0.0, held_out_percent=np.nan, p_input=1e-6))
    assert (
        "nan"
        not in comparison_table(pd.DataFrame([row("P1", 0.0, held_out_percent=np.nan)])).to_string()
    )
    assert told(row("P1", 0.0, fit_percent=30.0, p_white=1e-9)).startswith("None of these models")
    assert "30 % of the output" in told(
        row("P1", 0.0, fit_percent=30.0)
    )  # white noise may be large


def test_troubles_of_the_record_come_before_any_recommendation() -> None:
    for other in ({}, {"p_white": 1e-5}, {"remark": "Td is hardly determined"}):
        table = pd.DataFrame([row("P1", 0.0, **other)])
        found = conclude(table, *recommend(table), troubles=("record.drift",))
        assert "But first fit with baseline=trend." in found.sentence
        assert found.code in ("models.provisional", "models.undetermined")


def off_equilibrium() -> IOData:
    """One lag of 3 s that begins 5 units above its equilibrium."""
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([0.0, 1.0], 24), 25)
    y = simulate(process("P1").rational({"Kp": 4.0, "Tp1": 3.0}), u, 0.2, "zoh") + 10
    y = y + 5 * np.exp(-0.2 * np.arange(len(u)) / 3) + 0.05 * rng.normal(size=len(u))
    return IOData.from_arrays(u, y, 0.2, hold="zoh")


@pytest.mark.study
def test_runs_that_start_off_equilibrium_are_refitted_with_their_state_estimated() -> None:
    found = compare(off_equilibrium(), ["P1", "P2", "P2Z"])
    assert found.advice.startswith("Recommended: P1.")
    assert "the state at each start was estimated" in found.reason_text
    assert found.best.estimates["Tp1"].value == pytest.approx(
        3.0, abs=4 * found.best.estimates["Tp1"].u
    )
    asked = compare(off_equilibrium(), ["P1", "P2", "P2Z"], initial="equilibrium")
    assert "Recommended" not in asked.advice
    assert "initial=estimated" in asked.advice
    assert "spikes" not in asked.best.identified.sentence


def test_two_real_lags_are_not_stated_as_an_oscillating_pair() -> None:
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([0.0, 10.0], 20), 60)
    y = Chain((50.0, 5.0), conditioning=NO_CONDITIONING).response(u, 1.0, hold="zoh")
    data = IOData.from_arrays(u, np.ravel(y) + 0.05 * rng.normal(size=len(u)), 1.0, hold="zoh")
    found = compare(data, ["P2U", "P2"])
    assert found.recommended == "P2"
    assert "P2U is left out" in found.reason_text


@pytest.mark.study
def test_oscillators_with_dead_time_are_among_the_candidates_and_integrators_are_offered() -> None:
    assert "P2DU" in CANDIDATES
    rng = np.random.default_rng(9)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 20)
    y = simulate(
        process("P1I").rational({"Kp": 0.05, "Tp1": 2.0}), u, 0.5, "zoh"
    ) + 0.01 * rng.normal(size=len(u))
    data = IOData.from_arrays(u, y, 0.5, hold="zoh")
    said = compare(data, CANDIDATES[:2]).advice
    assert said.startswith("None of these models")
    table = pd.DataFrame([row(name, 0.0, p_input=1e-9) for name in CANDIDATES])
    assert "models=P1I" in replace(compare(data, ["P1"]), table=table).advice


def test_each_model_is_told_before_it_is_fitted() -> None:
    told_of: list[tuple[str, int, int]] = []
    compare(
        off_equilibrium(),
        ["P1", "P1D"],
        initial="estimated",
        progress=lambda *what: told_of.append(what),
    )
    assert told_of == [("P1", 1, 2), ("P1D", 2, 2)]


def test_a_rival_that_foresees_better_says_by_how_much() -> None:
    said = info(
        "models.foresees", subject="TF(2,2)", other="P1D", ratio=0.83, white=True, freed=False
    ).sentence
    assert said == (
        "TF(2,2) simulates data kept from the fit to 83 % of the error of P1D, and leaves white residuals."
    )
