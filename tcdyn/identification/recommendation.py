"""Recommendation of a model: the model of a comparison to use and why, and the comparison table.

``tcdyn.identification.comparison`` and ``tcdyn.report.dynamics`` use it. It reads the table only,
so each rule can be tested with a small table: ``tests/identify/test_identify_advice.py``, and
``tests/identify/test_identify_results.py`` on fits.
"""

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
from tcdyn.identification.identified import Identified
from tcdyn.identification.models import NO_MODEL
from tcdyn.identification.search import Fit
from tcdyn.identification.validation import ALARM_P
from tcdyn.rig.disk import Conditioning

# Thresholds of the selection, chosen by judgement.
DECISIVE_BIC = 10.0  # difference of BIC that no other criterion outweighs
TIE_BIC = 2.0  # difference of BIC that is a tie
HELD_OUT_GAIN_RATIO = 0.97  # held-out error over that of the best BIC, below which it decides
# The same for a model that the data do not determine over one that they do, and for common poles
# over a model that the residual tests accept; chosen by judgement.
CLEAR_GAIN_RATIO = 0.8
# Fit percent below which coloured residuals are more than a disturbance.
MIN_FIT_PERCENT = 50.0
# Fit percent, of the record and of its held-out part, from which a model is provisional, and not
# rejected, although its residuals follow the input.
CLOSE_FIT_PERCENT = 90.0
MAX_HELD_OUT_RATIO = 2.0  # held-out error over the rms of the fit, above which the model is wrong

# From fits to simulated closed loops (tests/identify/closed_loop_cases.py): the instant response
# was 0.3 to 1 of the largest gain, the static gain that integral control leaves at most 0.05.
# Instant: within one sampling interval. Both limits are relative to the largest gain.
MIN_INSTANT_RESPONSE = 0.2
MIN_STATIC_GAIN = 0.1


def responds_at_once(fit: Fit) -> bool:
    """Whether the model looks like minus the inverse of a controller, as in a closed loop.

    Parameters
    ----------
    fit
        The recommended model.

    Returns
    -------
    bool
        Whether, behind an input, the output responds within the sampling interval by more than
        ``MIN_INSTANT_RESPONSE`` of the largest gain up to half the sampling frequency, and that
        response is negative or the static gain is below ``MIN_STATIC_GAIN`` of the largest.

    Notes
    -----
    From u = C (r - y) a fit identifies y = r - u/C: with a proportional controller a negative gain
    without a lag, with an integrating one no static gain. The lead of a sensor is positive and has
    a static gain.

    ``tests/identify/test_identify_closed_loop.py`` checks that no wrong model of a noisy loop is
    recommended.
    """
    dt_s = fit.problem.dt_s
    frequencies_hz = np.append(0.0, np.geomspace(1e-4, 1.0, 200) * 0.5 / dt_s)
    for rational in fit.problem.rationals(fit.x):
        if rational.integrators:
            continue
        gains = np.abs(rational.frequency_response(frequencies_hz))
        largest = float(gains.max())
        step = np.array([0.0, 1.0])
        response = float(simulate(rational, step, dt_s, "foh", "zero")[1])
        no_static_gain = gains[0] < MIN_STATIC_GAIN * largest
        is_instant = abs(response) > MIN_INSTANT_RESPONSE * largest
        if is_instant and (response < 0 or no_static_gain):
            return True
    return False


def validation_error(table: pd.DataFrame) -> pd.Series[float]:
    """Return the error of each model on data that it has not used; NaN where it is not scored.

    It is the geometric mean of the errors on the held-out part and on blocks of the record that
    are left out in turn (:func:`tcdyn.identification.heldout.block_held_out_rms`). One part alone
    may resemble the rest of the record by chance.
    """
    return (table["held_out_rms"] * table["block_rms"]) ** 0.5


def recommend(
    table: pd.DataFrame, overdamped: Collection[str] = (), needless: Collection[str] = ()
) -> tuple[str, Finding]:
    """The model to use, and why.

    Parameters
    ----------
    table
        A row for each model (``Comparison.table``).
    overdamped
        Names that are not considered, because their pair of poles is two lags.
    needless
        Names that are not considered, because lags describe the record about as well.

    Returns
    -------
    tuple
        Name of the model, and the finding "models.why".

    Notes
    -----
    The lowest BIC; a smaller model within ``TIE_BIC`` of it is preferred. Models that the data do
    not determine, or whose residuals follow the input, are considered only where no other is within
    ``DECISIVE_BIC``. BIC holds where the residuals are white and do not follow the input. Where
    they are not, a model whose :func:`validation_error` is smaller by more than
    ``HELD_OUT_GAIN_RATIO`` replaces it; one that the data do not determine replaces one that they
    do where its error is below ``CLEAR_GAIN_RATIO`` of the other.

    ``tests/identify/test_identify_advice.py`` has a table for each rule.
    """
    is_needless = table["model"].isin(list(needless))
    out = table["model"].isin(list(overdamped)) | is_needless
    fitted = table[table["BIC"].notna() & ~out]
    follows_input = fitted["p_input"] < ALARM_P
    limit = fitted["BIC"].min() + DECISIVE_BIC
    groups = (
        fitted[fitted["determined"].astype(bool) & ~follows_input],
        fitted[~follows_input],
        fitted[fitted["determined"].astype(bool)],
        fitted,
    )
    pool = next(group for group in groups if len(group) and group["BIC"].min() <= limit)
    near = pool[pool["BIC"] < pool["BIC"].min() + TIE_BIC]
    lowest = near.iloc[0]
    best = near.sort_values("parameters", kind="stable").iloc[0]
    by = "BIC" if best["model"] == lowest["model"] else "parameters"
    other = lowest
    is_clean = best["p_white"] >= ALARM_P and best["p_input"] >= ALARM_P
    errors = validation_error(fitted)
    if not is_clean and errors.notna().any():
        is_handicapped = bool(best["determined"]) & ~fitted["determined"].astype(bool)
        limits = np.where(is_handicapped, CLEAR_GAIN_RATIO, HELD_OUT_GAIN_RATIO)
        relative = errors / (limits * errors[best.name])
        if relative.min() < 1:
            other = best
            best = fitted.loc[relative.idxmin()]
            by = "held out"
    is_better = table["BIC"] < best["BIC"]
    ties = pool[(abs(pool["BIC"] - best["BIC"]) < TIE_BIC) & (pool["model"] != best["model"])]
    undetermined = fitted[~fitted["determined"].astype(bool) & is_better[fitted.index]]
    missing = fitted[follows_input & is_better[fitted.index] & fitted["determined"].astype(bool)]
    near_and_out = table[out & (table["BIC"] < best["BIC"] + TIE_BIC)]
    lags_do = is_needless[near_and_out.index]
    why = info(
        "models.why",
        subject=str(best["model"]),
        other=str(other["model"]),
        by=by,
        rms=best["held_out_rms"],
        validation_rms=float(errors[best.name]),
        other_rms=float(errors[other.name]),
        only=len(fitted) == 1,
        least=not best["held_out_rms"] > pool["held_out_rms"].min(),
        ties=list(ties["model"]) if by == "BIC" else [],
        undetermined=list(undetermined["model"]),
        missing=list(missing["model"]),
        pairs=list(near_and_out["model"][~lags_do]),
        needless=list(near_and_out["model"][lags_do]),
    )
    return why.subject, why


def conclude(
    table: pd.DataFrame,
    recommended: str,
    why: Finding,
    untried: Sequence[str] = (),
    troubles: Sequence[str] = (),
    centred_percent: float | None = None,
) -> Finding:
    """The conclusion: which model to use and why, or that none is good enough and what to try.

    Parameters
    ----------
    table
        A row for each model (``Comparison.table``).
    recommended
        Name of the recommended model.
    why
        The reason (:func:`recommend`).
    untried
        Models that were not compared.
    troubles
        Codes of the problems of the record (``Validation.record_problems``).
    centred_percent
        Fit percent without the mean of the residuals, which a random walk leaves free; by default
        that of the table.

    Returns
    -------
    Finding
        An error where no model is good enough ("models.none") or a constant output is as good
        ("models.unrelated"), a warning where the model is
        provisional or not determined, else an info ("models.recommended").
    """
    row = table[table["model"] == recommended].iloc[0]
    if set(recommended.split(" + ")) == {NO_MODEL}:
        return error("models.unrelated")
    is_coloured = bool(row["p_white"] < ALARM_P)
    fit_percent = float(row["fit_percent"])
    # NaN where the held-out output is constant
    held_out_percent = float(row["held_out_percent"])
    # a constant output with noise is no argument against the model, so the F test must agree
    worse_than_mean = held_out_percent < 0 and row["p_held_out"] < ALARM_P
    is_small = fit_percent < MIN_FIT_PERCENT
    against = None
    follows_input = bool(row["p_input"] < ALARM_P)
    # in a long record with little noise, small departures from any model are significant
    is_close = fit_percent >= CLOSE_FIT_PERCENT and held_out_percent >= CLOSE_FIT_PERCENT
    if follows_input and not is_close:
        against = "dynamics"
    elif worse_than_mean and row["held_out_rms"] > MAX_HELD_OUT_RATIO * row["rms"]:
        against = "held out"
    elif is_coloured and is_small:
        against = "colour"
    numbers: dict[str, Any] = {
        "subject": recommended,
        "why": why.sentence,
        "troubles": list(troubles),
        "fit_percent": fit_percent,
    }
    if np.isfinite(held_out_percent):
        numbers["held_out_percent"] = held_out_percent
    if against:
        return error("models.none", against=against, untried=list(untried[:3]), **numbers)
    if not row["determined"]:
        return warning("models.undetermined", remark=row["remark"], **numbers)
    settling = _as_likely_settling(table, recommended)
    if settling:
        return warning("models.integrator", other=settling, **numbers)
    is_worse = is_coloured and worse_than_mean
    if centred_percent is None:
        centred_percent = fit_percent
    is_all_disturbance = centred_percent < 0
    numbers |= {
        "coloured": is_coloured,
        "worse_than_mean": is_worse,
        "small": is_small,
        "all_disturbance": is_all_disturbance,
        "centred_percent": centred_percent,
        "follows_input": follows_input,
    }
    if troubles or is_worse or is_all_disturbance or follows_input:
        return warning("models.provisional", **numbers)
    return info("models.recommended", **numbers)


def _as_likely_settling(table: pd.DataFrame, recommended: str) -> str:
    """Name of a model without integrator that is as likely as the recommended one with integrator.

    Empty where there is none, or where the recommended model has no integrator.
    """
    integrates = table["model"].str.contains("I", regex=False)
    if not integrates[table["model"] == recommended].any():
        return ""
    bic = table["BIC"]
    is_tie = bic < float(bic[table["model"] == recommended].iloc[0]) + TIE_BIC
    settling = table[is_tie & ~integrates & (table["model"] != NO_MODEL)]
    return str(settling["model"].iloc[0]) if len(settling) else ""


def comparison_table(table: pd.DataFrame, unit: str = "") -> pd.DataFrame:
    """The comparison as a table of texts: best BIC first, residual tests as p values.

    BIC is relative to the best. Models that could not be fitted are left out; models that are only
    scored have neither BIC nor tests.

    Parameters
    ----------
    table
        A row for each model (``Comparison.table``).
    unit
        Unit of the output.

    Returns
    -------
    DataFrame
        Texts, one row for each model that could be fitted.
    """
    fitted = table[table["fit_percent"].notna()]

    def p_values(column: str) -> list[str]:
        """Return p values as text, small ones as "below 0.01"."""
        texts = [f"{p:.2f}" if p >= ALARM_P else "below 0.01" for p in fitted[column]]
        return [t if np.isfinite(p) else "" for t, p in zip(texts, fitted[column])]

    rms = f"rms [{unit}]" if unit else "rms"
    held_out = [f"{v:.2f}" if np.isfinite(v) else "" for v in fitted["held_out_percent"]]
    return pd.DataFrame(
        {
            "model": fitted["model"].to_list(),
            "parameters": [f"{n:.0f}" for n in fitted["parameters"]],
            "fit [%]": [f"{v:.2f}" for v in fitted["fit_percent"]],
            rms: [f"{v:#.3g}".rstrip(".") for v in fitted["rms"]],
            "held out [%]": held_out,
            "BIC above best": [
                f"{v:.1f}" if np.isfinite(v) else "" for v in fitted["BIC"] - fitted["BIC"].min()
            ],
            "white p": p_values("p_white"),
            "input p": p_values("p_input"),
        }
    )


# Explanation of the columns of ``comparison_table``.
TABLE_LEGEND = (
    "Models: P and the number of lags, D dead time, Z zero, U oscillating pair, I integrator, "
    "H half-order element; TF(zeros, poles), ARX the same where disturbances come in before the "
    "poles; - no effect. Fit and held out: 100 % is perfect, 0 % as bad as the mean; held out is "
    "simulation of data kept from the fit. BIC above best: "
    "below 2 is a tie, above 10 is decisive. White p, input p: chance of such residuals from a "
    f"true model, below {ALARM_P:g} is an alarm; input p shows missing dynamics."
)


def chain_advice(model: Identified, conditioning: Conditioning = NO_CONDITIONING) -> str:
    """How to remove the lag with :func:`tcdyn.smooth`; empty where the model is not a chain.

    Parameters
    ----------
    model
        The identified model.
    conditioning
        The filter that was the known factor of the identification.

    Returns
    -------
    str
        One sentence with a line of Python that can be pasted.
    """
    try:
        chain = model.chain(conditioning)
    except InputError:
        return ""
    arguments = [
        f"{f.name}={_source_text(getattr(chain, f.name))}"
        for f in fields(chain)
        if f.init and getattr(chain, f.name)
    ]
    call = f"tcdyn.smooth(y, dt, tcdyn.Chain({', '.join(arguments)}))"
    return f"To remove this lag from other traces: {call}; the gain is left in."


def _source_text(value: Any) -> str:
    """Python source of a value: numbers with four digits, tuples, conditioning filters."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_source_text, value))},)"
    if isinstance(value, Conditioning):
        return f"tcdyn.{value!r}" if value.poles else "tcdyn.Conditioning(poles=0)"
    return f"{value:.4g}" if isinstance(value, float) else repr(value)
