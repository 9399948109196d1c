"""Which model to use, or that none is good enough: the comparison in plain words, and its table for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from calibration.disk import Conditioning
from calibration.errors import InputError
from calibration.finding import Finding, look, note, refuse
from tcdyn.chain import NO_CONDITIONING
from tcdyn.identify.identified import Identified
from tcdyn.identify.validate import ALARM

HALF = 50.0  # per cent of fit below which coloured residuals are no longer a mere disturbance


def follows_input(row: pd.Series) -> bool:
    """Whether a model's residuals still follow the input (1 % level), so that it misses dynamics."""
    return bool(row.get("p_input", 1.0) < ALARM)


def verdict(
    table: pd.DataFrame, recommended: str, why: str, untried: Sequence[str] = (), troubles: Sequence[str] = ()
) -> Finding:
    """What to use and why, or that none of the models is good enough and what to try.

    Args:
        table: that of ``compare``, a row for each model.
        recommended: the model that it recommends.
        why: its reason, one sentence or two.
        untried: models that were not among those compared.
        troubles: codes of what to do about the record, as its residuals say (``Validation.troubles``).
    """
    row = table[table["model"] == recommended].iloc[0]
    coloured = bool(row.get("p_white", 1.0) < ALARM)
    known = bool(np.isfinite(row["held_out_percent"]))  # there is none where the output of that part never moves
    common: dict[str, Any] = {"subject": recommended, "why": why, "troubles": list(troubles)}
    if known:
        common["held_out_percent"] = float(row["held_out_percent"])
    percent = float(row["fit_percent"])
    against = None
    if follows_input(row):
        against = "dynamics"
    elif known and row["held_out_percent"] < 0 and row["held_out_rms"] > 2 * row["rms"]:
        against = "held out"
    elif coloured and percent < HALF:
        against = "colour"
    if against:
        return refuse("models.none", against=against, fit_percent=percent, untried=list(untried[:3]), **common)
    if not row["determined"]:
        return look("models.undetermined", remark=row["remark"], **common)
    worse = coloured and known and bool(row["held_out_percent"] < 0)
    common |= {"coloured": coloured, "worse_than_mean": worse, "small": percent < HALF, "fit_percent": percent}
    return look("models.provisional", **common) if troubles or worse else note("models.recommended", **common)


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
