"""What a comparison says to do: a model that its own residuals accuse is never just recommended."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd

from calibration.disk import Conditioning
from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.identify import IOData, compare
from tcdyn.identify.advice import advice, as_chain, order_table
from tcdyn.identify.choose import recommend
from tcdyn.identify.models import process


def row(model: str, bic: float, **other: Any) -> dict[str, Any]:
    plain = {"parameters": 3, "fit_percent": 90.0, "rms": 0.1, "BIC": bic, "held_out_rms": 0.1}
    return {"model": model, **plain, "held_out_percent": 88.0, "p_white": 0.5, "p_input": 0.5, "remark": "", **other}


def told(*rows: dict[str, Any], untried: tuple[str, ...] = ()) -> str:
    table = pd.DataFrame(rows)
    return advice(table, *recommend(table), untried)


def test_a_model_that_misses_dynamics_gives_way_to_one_that_does_not() -> None:
    table = pd.DataFrame([row("P1", 0.0, p_input=1e-6), row("P2", 5.0)])
    name, why = recommend(table)
    assert name == "P2"
    assert "P1 would score better but misses dynamics" in why


def test_a_response_that_is_known_beats_parameters_that_are() -> None:
    """Two lags that coincide cannot be told one by one; one lag, well told, does not follow the data at all."""
    table = pd.DataFrame([row("P2", 0.0, remark="T1, T2 are hardly determined"), row("P1", 900.0, p_input=1e-40)])
    assert recommend(table)[0] == "P2"
    assert told(*table.to_dict("records")).startswith("Use P2 with care.")


def test_none_is_recommended_where_all_miss_dynamics() -> None:
    said = told(row("P1", 0.0, p_input=1e-6), row("P2", 5.0, p_input=1e-3), untried=("P3", "P3D"))
    assert said.startswith("None of these models is good enough")
    assert "Recommended" not in said
    assert "--models P3,P3D" in said
    assert "--narx" in told(row("P1", 0.0, p_input=1e-6))  # nothing left to try among the linear ones


def test_colour_and_doubt_are_said_with_the_recommendation() -> None:
    assert "hold nothing against it" in told(row("P1", 0.0))
    assert "coloured" in told(row("P1", 0.0, p_white=1e-5))
    assert told(row("P1", 0.0, remark="Td is hardly determined")).startswith("Use P1 with care.")


def test_one_lag_is_refused_on_data_of_two_and_two_are_recommended() -> None:
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([0.0, 1.0], 60), 20)
    y = Chain((0.8, 0.3), conditioning=NO_CONDITIONING).response(u, 0.05, hold="zoh") + rng.normal(0, 0.01, len(u))
    data = IOData.from_arrays(u, np.ravel(y), 0.05, hold="zoh")
    assert compare(data, ["P1"]).advice.startswith("None of these models")
    both = compare(data, ["P1", "P2"])
    assert both.recommended == "P2"
    assert both.summary().startswith("Recommended: P2.")


def test_the_order_table_fits_a_terminal() -> None:
    table = pd.DataFrame([row("P2DZ", 0.0), row("P1", 1234.5, p_input=1e-40, p_white=0.0)])
    text = order_table(table).to_string(index=False)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "e-" not in text  # a p of 1e-40 says no more than "below 0.01"


def test_models_as_good_as_the_recommended_one_are_named() -> None:
    assert "P2Z within 2 of its BIC would do as well" in told(row("P2D", 0.0), row("P2Z", 0.5), row("P3", 9.0))
    assert "would do as well" not in told(row("P2D", 0.0), row("P3", 9.0))


def test_a_start_off_equilibrium_is_the_first_thing_to_try() -> None:
    table = pd.DataFrame([row("P1", 0.0, p_input=1e-6)])
    troubles = ("let the runs start off equilibrium (--initial estimated)",)
    assert "Next, let the runs start off equilibrium" in advice(table, *recommend(table), troubles=troubles)


def test_the_model_is_handed_on_as_the_chain_to_remove_and_a_known_filter_is_no_part_of_its_lags() -> None:
    """What is printed is Python: evaluated, it gives the chain back to the digits shown."""
    b = Conditioning(4.0, 2)
    u = np.repeat([0.0, 1.0, 0.0, 1.0], 200)
    y = Chain((0.8, 0.3), conditioning=b).response(u, 0.05, hold="zoh")
    data = IOData.from_arrays(u, np.ravel(y) + np.random.default_rng(1).normal(0, 1e-3, len(u)), 0.05, hold="zoh")
    best = compare(data, [process("P2", known=b)]).best.identified
    words = re.search(r"tcdyn\.smooth\(y, dt, (Chain\(.*\))\);", as_chain(best, b))
    chain = eval(words[1], {"Chain": Chain, "Conditioning": Conditioning}) if words else None
    assert chain.conditioning == b
    assert np.allclose(chain.taus_s, (0.8, 0.3), rtol=0.01)  # noise of 0.1 % over four steps
    assert as_chain(best, NO_CONDITIONING) == ""  # identified with a filter: without it, it is another chain
