"""Which model of a comparison to use and why, or that none is good enough; its table for people."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.chain import NO_CONDITIONING
from tcdyn.chain.rational import simulate
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, error, info, warning
from tcdyn.identify.identified import Identified
from tcdyn.identify.search import Fit
from tcdyn.identify.validate import ALARM
from tcdyn.rig.disk import Conditioning

DECISIVE = 10.0  # difference of BIC from which nothing else makes up for it
# From fits to simulated closed loops (tests/identify/closed_loop_cases.py): the answer at once was 0.3 to 1 of the
# largest gain, the static gain that integral control leaves at most 0.05.
AT_ONCE = 0.2  # of the largest gain: the answer within one sampling interval that is one at once
NO_STATIC_GAIN = 0.1  # of the largest gain: the static gain below which there is none
HALF = 50.0  # per cent of fit below which coloured residuals are no longer a mere disturbance


def answers_at_once(fit: Fit) -> bool:
    """Whether the model looks like minus the inverse of a controller, which is what a closed loop shows.

    Parameters
    ----------
    fit : Fit
        The recommended model.

    Returns
    -------
    bool
        Whether, behind an input, the output answers within the sampling interval, by more than ``AT_ONCE`` of the
        largest gain up to half the sampling frequency, and that answer is negative or the static gain is below
        ``NO_STATIC_GAIN`` of the largest.

    Notes
    -----
    Of u = C (r - y) a fit finds y = r - u/C: of a proportional controller a negative gain without a lag, of one with
    an integral no static gain. The lead of a sensor is positive and has a static gain.
    """
    dt_s = fit.problem.dt_s
    frequencies_hz = np.append(0.0, np.geomspace(1e-4, 1.0, 200) * 0.5 / dt_s)
    for rational in fit.problem.rationals(fit.x):
        if rational.integrators:
            continue
        sizes = np.abs(rational.frequency_response(frequencies_hz))
        largest = float(sizes.max())
        answer = float(simulate(rational, np.array([0.0, 1.0]), dt_s, "foh", "zero")[1])
        no_static_gain = sizes[0] < NO_STATIC_GAIN * largest
        if abs(answer) > AT_ONCE * largest and (answer < 0 or no_static_gain):
            return True
    return False


def recommend(table: pd.DataFrame, left_out: Collection[str] = ()) -> tuple[str, Finding]:
    """The row to use, and why.

    The lowest BIC among models without complaint (no parameter on a bound or undetermined) whose residuals do not
    follow the input; failing that, among those that the data do not determine but whose residuals do not follow the
    input; then among those without complaint. A model is passed over for another kind only where that one's BIC is
    less than 10 above it: what explains decisively less of the output passes the tests for want of power. Within a
    kind the best gives way to a smaller model whose BIC is within 2, and to one whose BIC is within 10 and whose
    held-out error is better by more than 5 %. ``left_out`` are names that are not considered, nor are rows that a
    growing search has refused.
    """
    refused = table["refused"].eq(True)
    out = table["model"].isin(list(left_out))
    good = table[table["BIC"].notna() & ~out & ~refused]
    sound = good[good["determined"]]
    following = good["p_input"] < ALARM
    passing = sound[~following[sound.index]]
    explaining = good[~following]
    known = (
        sound if len(sound) and not refused.any() else good
    )  # a search's steps are held against colour already
    limit = known["BIC"].min() + DECISIVE
    pool = next(p for p in (passing, explaining, sound, good) if len(p) and p["BIC"].min() <= limit)
    best = other = pool.iloc[0]
    near = pool[(pool["BIC"] < best["BIC"] + 2) & (pool["parameters"] < best["parameters"])]
    by = "BIC" if best["BIC"] == good["BIC"].min() else "BIC of those that qualify"
    if len(near):
        best = near.sort_values("parameters").iloc[0]
        by = "parameters"
    rival = pool[pool["BIC"] < pool["BIC"].min() + DECISIVE].sort_values("held_out_rms").iloc[0]
    if rival["held_out_rms"] < 0.95 * best["held_out_rms"]:
        best, other, by = rival, best, "held out"
    better = table["BIC"] < best["BIC"]
    ties = pool[(abs(pool["BIC"] - best["BIC"]) < 2) & (pool["model"] != best["model"])]
    groups = {
        "ties": ties[:0] if len(near) else ties,
        "undetermined": good[~good["determined"].astype(bool) & better[good.index]],
        "missing": sound[~sound["model"].isin(pool["model"]) & better[sound.index]],
        "pairs": table[out & ~refused & (table["BIC"] < best["BIC"] + 2)],
        "refused": table[refused & better],
    }
    told: dict[str, Any] = {group: list(rows["model"]) for group, rows in groups.items()}
    why = info(
        "models.why",
        subject=str(best["model"]),
        other=str(other["model"]),
        by=by,
        rms=best["held_out_rms"],
        other_rms=other["held_out_rms"],
        only=len(pool) == 1,
        least=not best["held_out_rms"] > pool["held_out_rms"].min(),
        **told,
    )
    return why.subject, why


def verdict(
    table: pd.DataFrame,
    recommended: str,
    why: Finding,
    untried: Sequence[str] = (),
    troubles: Sequence[str] = (),
) -> Finding:
    """What to use and why, or that none of the models is good enough and what to try.

    Args:
        table: that of ``compare``, a row for each model.
        recommended: the model that it recommends.
        why: its reason (:func:`recommend`).
        untried: models that were not among those compared.
        troubles: codes of what to do about the record, as its residuals say (``Validation.troubles``).
    """
    row = table[table["model"] == recommended].iloc[0]
    coloured = bool(row["p_white"] < ALARM)
    percent = float(row["fit_percent"])
    held_out = float(
        row["held_out_percent"]
    )  # not a number where the output of that part never moves
    held_out_against = (
        held_out < 0 and row["p_held_out"] < ALARM
    )  # a plateau of noise is no reproach
    against = None
    if row["p_input"] < ALARM:
        against = "dynamics"
    elif held_out_against and row["held_out_rms"] > 2 * row["rms"]:
        against = "held out"
    elif coloured and percent < HALF:
        against = "colour"
    numbers: dict[str, Any] = {
        "subject": recommended,
        "why": why.sentence,
        "troubles": list(troubles),
        "fit_percent": percent,
    }
    if np.isfinite(held_out):
        numbers["held_out_percent"] = held_out
    if against:
        return error("models.none", against=against, untried=list(untried[:3]), **numbers)
    if not row["determined"]:
        return warning("models.undetermined", remark=row["remark"], **numbers)
    worse = coloured and held_out_against
    numbers |= {"coloured": coloured, "worse_than_mean": worse, "small": percent < HALF}
    return (
        warning("models.provisional", **numbers)
        if troubles or worse
        else info("models.recommended", **numbers)
    )


def order_table(table: pd.DataFrame, unit: str = "") -> pd.DataFrame:
    """The comparison as people read it: best BIC first, as its distance to the best; residual tests as p values.

    ``unit`` is the output's; models that could not be fitted are left out.
    """
    good = table[table["BIC"].notna()]
    white, following = (
        [f"{p:.2f}" if p >= ALARM else "below 0.01" for p in good[c]]
        for c in ("p_white", "p_input")
    )
    return pd.DataFrame(
        {
            "model": good["model"].to_list(),
            "parameters": [f"{n:.0f}" for n in good["parameters"]],
            "fit [%]": [f"{v:.2f}" for v in good["fit_percent"]],
            f"rms{f' [{unit}]' if unit else ''}": [f"{v:#.3g}".rstrip(".") for v in good["rms"]],
            "held out [%]": [
                f"{v:.2f}" if np.isfinite(v) else "" for v in good["held_out_percent"]
            ],
            "BIC above best": [f"{v:.1f}" for v in good["BIC"] - good["BIC"].min()],
            "white p": white,
            "input p": following,
        }
    )


COLUMNS = (
    "Models: P and the number of lags, D dead time, Z zero, U oscillating pair; TF(zeros, poles), ARX the same where "
    "disturbances come in before the poles. Fit and held out: 100 % is perfect, 0 % as bad as the mean; held out is "
    "simulation of data kept from the fit. BIC above best: below "
    "2 is a tie, above 10 is decisive. White p, input p: chance of such residuals from a true model, below "
    f"{ALARM:g} is an alarm; input p tells of missing dynamics."
)


def as_chain(model: Identified, conditioning: Conditioning = NO_CONDITIONING) -> str:
    """How to write the model as the chain that :func:`tcdyn.smooth` removes; empty where it is none.

    ``conditioning`` is the filter that was the known part.
    """
    try:
        chain = model.chain(conditioning)
    except InputError:
        return ""
    parts = [
        f"{f.name}={_digits(getattr(chain, f.name))}"
        for f in fields(chain)
        if f.init and getattr(chain, f.name)
    ]
    made = f"tcdyn.smooth(y, dt, tcdyn.Chain({', '.join(parts)}))"
    return f"To remove this lag from other traces: {made}; the gain is left in."


def _digits(value: Any) -> str:
    """A number, or those of a tuple, with four digits; anything else as Python writes it."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_digits, value))},)"
    if isinstance(value, Conditioning) and not value.poles:
        return "tcdyn.Conditioning(poles=0)"
    if isinstance(value, Conditioning):
        return f"tcdyn.{value!r}"
    return f"{value:.4g}" if isinstance(value, float) else repr(value)
