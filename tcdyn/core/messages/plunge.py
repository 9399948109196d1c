"""What is said of plunges and the chains found from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tcdyn.core.estimate import rounded, with_u
from tcdyn.core.messages.phrases import Message
from tcdyn.core.spelling import Spelling

# immersion
PARAMETERS = {
    "ln_h": "scale of h",
    "h_exponent": "extra exponent of h",
    "h_viscosity": "power of the viscosity in h",
    "ln_burst": "size of the entry burst",
    "ln_burst_time": "duration of the entry burst",
    "ln_burst_shape": "shape of the entry burst",
    "entry": "entry time",
    "initial": "temperature before the entry",
    "bath": "bath temperature",
    "split": "split of the lag over two stages",
    "depth": "junction depth",
    "offset": "offset left over by the static line",
    "gain": "gain left over by the static line",
    "ln_conductivity": "conductivity",
    "common_split": "split of the lags over two stages",
}


def percent(probability: float) -> str:
    """A probability as people say it.

    >>> percent(1e-5), percent(0.0042), percent(0.28)
    ('below 0.1 %', '0.4 %', '28 %')
    """
    share = 100 * probability
    if share < 0.1 or share > 99.9:
        return "below 0.1 %" if share < 50 else "above 99.9 %"
    return f"{share:.1f} %" if share < 1 or share > 99 else f"{share:.0f} %"


def _pull(subject: str, kind: str, sds: float, **_: Any) -> str:
    which = f"channel {subject}: the" if subject else "the"
    return f"{which} {PARAMETERS[kind]} lies {sds:.1f} prior standard deviations from what was expected"


def _coloured(common: float, differential: float, apart: bool, **_: Any) -> str:
    text = f"residuals are coloured (variance factors {common:.1f} common, {differential:.1f} differential); the "
    doubt = (
        "; the channels do not move together as they should: is a plunge of another disk among them, or a channel "
        "swapped?"
    )
    return text + "uncertainties were widened for it" + (doubt if apart else "")


def _lag(
    plunges: int, common_lag_s: float, u_s: float, known_burst_u_s: float, apart: bool, **_: Any
) -> str:
    text = f"{'One plunge gives' if plunges == 1 else f'{plunges} plunges give'} a common lag of "
    text += with_u(common_lag_s, u_s, "s")
    u_known = rounded(known_burst_u_s, known_burst_u_s)[1]
    known = f"with the entry burst and the entry time known it would be +- {u_known} s"
    if apart:
        return f"{text}; the entry burst is told apart from it ({known})."
    return (
        f"{text}; {known}, so these data cannot separate the lag from the burst: take the differences between channels "
        "from here and the common lag from an unloading."
    )


def _structure(
    structures: Sequence[str],
    meanings: Sequence[str],
    probability: Sequence[float],
    chi_square: Sequence[float],
    lag_s: Sequence[float],
    u_s: Sequence[float],
    second_s: Sequence[float] | None,
    candidates: int,
    contradicted: bool,
    u_before_s: float,
    u_after_s: float,
    option: Spelling,
    **_: Any,
) -> str:
    named = [f"{s} ({m})" for s, m in zip(structures, meanings)]
    lags = [with_u(lag, u, "s") for lag, u in zip(lag_s, u_s)]
    judged = [
        f"{s} ({m}: {percent(p)}, {lag})"
        for s, m, p, lag in zip(structures, meanings, probability, lags)
    ]
    remedy = ""
    if contradicted:
        ratio = probability[1] / max(probability[0], 1e-300)
        odds = "more than a million" if ratio > 1e6 else f"{float(f'{ratio:.2g}'):.0f}"
        text = (
            f"the plunges contradict chain {named[0]}: {named[1]} is {odds} times as probable "
            f"(chi-square lower by {chi_square[0] - chi_square[1]:.0f}) and gives a common lag of "
            f"{lags[1]} instead of {lags[0]}"
        )
        remedy = f"; calibrate with {option('structure', structures[1])}"
    elif len(structures) == 1:
        text = f"of {candidates} chain structures the plunges speak for {named[0]} ({percent(probability[0])})"
    else:
        text = f"the plunges cannot tell chain {judged[0]} from {' or '.join(judged[1:])}"
    if second_s is not None:
        text += f", and a lag of {with_u(second_s[0], second_s[1], 's')} under another entry burst is possible too"
    before, after = (rounded(u, u)[1] for u in (u_before_s, u_after_s))
    widened = "the common lag hardly depends on it"
    if before != after:
        widened = f"the standard uncertainty of the common lag was widened from {before} s to {after} s for it"
    return f"{text}; {widened}{remedy}"


PLUNGE: dict[str, Message] = {
    "plunge.lag": _lag,
    "plunge.structure": _structure,
    "plunge.pull": _pull,
    "plunge.coloured": _coloured,
    "plunge.unconverged": "the plunge fit stopped before it converged",
    "plunge.rival": "a second solution, with a common lag of {lag_s:.1f} s and a stronger entry burst, fits about as "
    "well (chi-square differs by {chi_square:.1f})",
    "plunge.fluid": "h comes out {ratio:.2g} times what the correlation gives for {fluid} ({sds:.1f} prior standard "
    "deviations off): is the fluid the right one?",
    "plunge.spikes": "{count} spikes were left out",
    "plunge.no_lag": "channel {subject}: the lag ran into zero; its interval is not to be trusted",
    "hole.ideal": "the two ideal thermocouples differ by {apart_s:.3f} s: one may not be clamped",
}
