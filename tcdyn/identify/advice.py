"""Which model to use, or that none is good enough: the comparison in plain words, and its table for people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calibration.disk import Conditioning
from calibration.errors import InputError
from tcdyn.chain import NO_CONDITIONING
from tcdyn.identify.identified import Identified
from tcdyn.identify.validate import ALARM

HALF = 50.0  # per cent of fit below which coloured residuals are no longer a mere disturbance


def follows_input(row: pd.Series) -> bool:
    """Whether a model's residuals still follow the input (1 % level), so that it misses dynamics."""
    return bool(row.get("p_input", 1.0) < ALARM)


def advice(
    table: pd.DataFrame, recommended: str, why: str, untried: Sequence[str] = (), troubles: Sequence[str] = ()
) -> str:
    """What to use and why, or that none of the models is good enough and what to try.

    Args:
        table: that of ``compare``, a row for each model.
        recommended: the model that it recommends.
        why: its reason, one sentence or two.
        untried: models that were not among those compared.
        troubles: what to do about the record, as its residuals say (``Validation.troubles``).
    """
    row = table[table["model"] == recommended].iloc[0]
    coloured = bool(row.get("p_white", 1.0) < ALARM)
    against = objection(row, coloured)
    if against:
        more = [f"compare others (--models {','.join(untried[:3])})" if untried else "ask --narx whether it is linear"]
        repeats = f" It repeats the held-out part to {row['held_out_percent']:.1f} %." if known(row) else ""
        return (
            f"None of these models is good enough: {against}. Do not trust the intervals below. The least bad is "
            f"{recommended}. {why}{repeats} Next, {', and '.join([*troubles, *more])}."
        )
    first = f" But first {', and '.join(troubles)}." if troubles else ""
    if row["remark"]:
        return (
            f"Use {recommended} with care. {why} But {row['remark']}: excite the input more, or hold what is known "
            f"(--gain).{first}"
        )
    if coloured:
        said = (
            "Its residuals are coloured, by disturbances or dynamics; beneath that colour the test cannot see what is "
            "left of the input. The intervals are the robust, wider ones."
        )
    elif row["fit_percent"] < HALF:
        said = f"It explains {row['fit_percent']:.0f} % of the output, the rest is white noise."
    else:
        said = "Its residuals hold nothing against it."
    unconfirmed = coloured and known(row) and row["held_out_percent"] < 0
    if unconfirmed:
        said += f" The held-out part does not confirm it: worse than the mean there ({row['held_out_percent']:.1f} %)."
    name = f"Provisionally {recommended}" if troubles or unconfirmed else f"Recommended: {recommended}"
    return f"{name}. {why} {said}{first}"


def objection(row: pd.Series, coloured: bool) -> str:
    """Why a model is not good enough to be used, else ""; white noise may be as large as it likes."""
    if follows_input(row):
        return "the residuals of every one that the data determine still follow the input"
    if known(row) and row["held_out_percent"] < 0 and row["held_out_rms"] > 2 * row["rms"]:
        return "on data that it has not seen the best of them does worse than their mean"
    if coloured and row["fit_percent"] < HALF:
        return f"the best of them repeats only {row['fit_percent']:.0f} % of the output, and the rest is no white noise"
    return ""


def known(row: pd.Series) -> bool:
    """Whether there is a held-out score: none where the output of that part never moves."""
    return bool(np.isfinite(row["held_out_percent"]))


def order_table(table: pd.DataFrame, unit: str = "") -> pd.DataFrame:
    """The comparison as people read it: best BIC first, as its distance to the best; residual tests as p values.

    ``unit`` is the output's; models that could not be fitted are left out.
    """
    good = table[table["BIC"].notna()]
    return pd.DataFrame(
        {
            "model": good["model"].to_list(),
            "parameters": [f"{n:.0f}" for n in good["parameters"]],
            "fit [%]": [f"{v:.2f}" for v in good["fit_percent"]],
            f"rms{f' [{unit}]' if unit else ''}": [f"{v:.3g}" for v in good["rms"]],
            "held out [%]": [f"{v:.2f}" if np.isfinite(v) else "" for v in good["held_out_percent"]],
            "BIC above best": [f"{v:.1f}" for v in good["BIC"] - good["BIC"].min()],
            "white p": [_p(v) for v in good["p_white"]],
            "input p": [_p(v) for v in good["p_input"]],
        }
    )


COLUMNS = (
    "Models: P and the number of lags, D dead time, Z zero, U oscillating pair; TF(zeros, poles). Fit and held out: "
    "100 % is perfect, 0 % as bad as the mean; held out is simulation of data kept from the fit. BIC above best: below "
    "2 is a tie, above 10 is decisive. White p, input p: chance of such residuals from a true model, below "
    f"{ALARM:g} is an alarm; input p tells of missing dynamics."
)


def _p(p: float) -> str:
    return f"{p:.2f}" if p >= ALARM else "below 0.01"


def as_chain(model: Identified, conditioning: Conditioning = NO_CONDITIONING) -> str:
    """How to write the model as the chain that :func:`tcdyn.smooth` removes; empty where it is none.

    ``conditioning`` is the filter that was the known part.
    """
    try:
        chain = model.chain(conditioning)
    except InputError:
        return ""
    lags = "".join(f"{tau:.4g}, " for tau in chain.taus_s).rstrip(" " if len(chain.taus_s) == 1 else ", ")
    parts = [f"({lags})"]
    parts += [f"{name}={value:.4g}" for name in ("zero_s", "delay_s", "cement_s") if (value := getattr(chain, name))]
    if chain.pair is not None:
        parts.append(f"pair=({chain.pair[0]:.4g}, {chain.pair[1]:.4g})")
    parts.append(f"conditioning={_filter(conditioning)}")
    return f"To remove this lag from other traces: tcdyn.smooth(y, dt, Chain({', '.join(parts)})); the gain is left in."


def _filter(b: Conditioning) -> str:
    if not b.poles:
        return "Conditioning(poles=0)"
    shape = "" if b.shape == "cascade" else f", {b.shape!r}"
    return f"Conditioning({b.cutoff_Hz:g}, {b.poles}{shape})"
