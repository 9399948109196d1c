"""Check for an output that follows the square of an input, as the heat of a current does.

``tcdyn.identification.comparison.compare`` calls it. ``tests/identify/test_even_input.py`` checks
currents of both signs and linear plants.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.identification.fitting import fit
from tcdyn.identification.iodata import IOData
from tcdyn.identification.models import Model, as_model, several

# Smaller over larger end of an input, from which it has both signs; below, its square is nearly
# linear in it. By judgement.
MIN_BOTH_SIGNS = 0.1
# Sum of squares of the residuals with the square over that with the input, below which the square
# is the cause; and the least fit with it [%]. Of 60 records like those of the test, of currents and
# of linear plants, the right one of the two had a share below 0.001 and a fit above 98 %, the wrong
# one a fit of up to 62 %, so that the share decides. Both limits by judgement, between them.
MAX_SQUARE_SHARE = 0.25
MIN_FIT_PERCENT = 50.0


def check_even_inputs(data: IOData, where: str) -> None:
    """Raise an error where the output follows the square of an input of both signs.

    Parameters
    ----------
    data
        The record.
    where
        Record that the error names.

    Raises
    ------
    InputError
        With the input.

    Notes
    -----
    One lag and a dead time behind each input are fitted with white noise, with the input and with
    its square.
    """
    squares = [k for k in range(len(data.input_names)) if has_both_signs(data, k)]
    if not squares:
        return
    linear_percent, linear_sse = explained(data)
    for k in squares:
        percent, sse = explained(squared(data, k))
        if percent < MIN_FIT_PERCENT or sse > MAX_SQUARE_SHARE * linear_sse:
            continue
        name = data.input_names[k]
        raise InputError(
            f"the output {data.output_names[0]} follows the square of {name}: one lag behind the "
            f"square explains {percent:.0f} % of it, behind {name} itself "
            f"{max(linear_percent, 0.0):.0f} %",
            where=where,
            expected="an input that the output follows linearly",
            remedy=f"add a column with the square of {name}, as of the heat of a current, and "
            "give it as the input; with {check} the models are compared all the same",
            parameters={"check": False},
        )


def has_both_signs(data: IOData, k: int) -> bool:
    """Whether input ``k`` is as far below zero as above it, within a factor of ten."""
    u = np.concatenate([run.u[:, k] for run in data.runs])
    low, high = float(-np.nanmin(u)), float(np.nanmax(u))
    return min(low, high) > MIN_BOTH_SIGNS * max(low, high)


def squared(data: IOData, k: int) -> IOData:
    """Return the record with the square of input ``k`` in its place."""
    runs = []
    for run in data.runs:
        u = run.u.copy()
        u[:, k] = u[:, k] ** 2
        runs.append(replace(run, u=u))
    return replace(data, runs=tuple(runs))


def explained(data: IOData) -> tuple[float, float]:
    """Fit [%] and sum of squares of the residuals of one lag and a dead time behind each input."""
    model: Model = as_model("P1D")
    if len(data.input_names) > 1:
        model = several([model] * len(data.input_names), data.input_names)
    options: dict[str, Any] = {
        "noise": "white",
        "baseline": "none",
        "initial": "estimated",
        "intervals": "quadratic",
        "check": False,
    }
    try:
        result = fit(replace(data, findings=()), model, **options)
    except InputError:
        return 0.0, np.inf
    return result.identified.statistics["fit_percent"], float(result.residual @ result.residual)
