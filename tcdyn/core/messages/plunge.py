"""Messages about plunges: the fit of the common lag, the entry burst, the chain structures.

A function here makes the text of one finding whose wording depends on its numbers; its arguments
are the fields of the finding (see ``tcdyn.core.messages``). Wording may be changed freely; codes,
names of fields and what a message advises must fit the place that makes the finding.
``tests/core/test_findings.py`` checks that each code is made somewhere and each code that is made
has a message.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tcdyn.core.errors import Spelling
from tcdyn.core.estimate import rounded_texts, text_with_u
from tcdyn.core.messages.phrases import Message

# nuisance parameters of the plunge fit, by the kind that a finding stores
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
    "offset": "offset not covered by the static line",
    "gain": "gain error not covered by the static line",
    "ln_conductivity": "conductivity",
    "common_split": "split of the lags over two stages",
}


def probability_text(probability: float) -> str:
    """Text of a probability in percent; bounds instead of figures near 0 and 1.

    >>> probability_text(1e-5), probability_text(0.0042), probability_text(0.28)
    ('below 0.1 %', '0.4 %', '28 %')
    """
    share = 100 * probability
    if share < 0.1:
        return "below 0.1 %"
    if share > 99.9:
        return "above 99.9 %"
    if share < 1 or share > 99:
        return f"{share:.1f} %"
    return f"{share:.0f} %"


def _far_from_prior(subject: str, kind: str, sds: float, **_: Any) -> str:
    """Message of ``plunge.pull``.

    ``kind`` is a key of ``PARAMETERS``, ``subject`` the channel of a parameter of one channel.
    """
    which = f"channel {subject}: the" if subject else "the"
    return f"{which} {PARAMETERS[kind]} is {sds:.1f} prior standard deviations from its prior mean"


def _coloured(common: float, differential: float, apart: bool, **_: Any) -> str:
    """Message of ``plunge.coloured``.

    ``common`` and ``differential`` are the factors of the variance of the mean over all channels
    and of differences between channels. ``apart``: that of differences is implausibly large.
    """
    text = (
        f"residuals are coloured (variance factors {common:.1f} common, {differential:.1f} "
        "differential); the uncertainties were increased accordingly"
    )
    if apart:
        text += (
            "; the channels do not move together as they should: is a plunge of another disk among "
            "them, are channels swapped, or did a disk start or warm unevenly?"
        )
    return text


def _lag(
    plunges: int, common_lag_s: float, u_s: float, known_burst_u_s: float, apart: bool, **_: Any
) -> str:
    """Message of ``plunge.lag``.

    ``known_burst_u_s`` is the standard uncertainty of the common lag for a known entry burst and
    entry time. ``apart``: the data separate lag and burst.
    """
    source = "One plunge gives" if plunges == 1 else f"{plunges} plunges give"
    text = f"{source} a common lag of {text_with_u(common_lag_s, u_s, 's')}"
    u_known = rounded_texts(known_burst_u_s, known_burst_u_s)[1]
    known = f"if entry burst and entry time were known exactly, it would be +- {u_known} s"
    if apart:
        return f"{text}; the data separate it from the entry burst ({known})."
    return (
        f"{text}; {known}, so these data cannot separate the lag from the burst: use the "
        "differences between channels from these plunges, and take the common lag from an "
        "unloading."
    )


def _chain_structure(
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
    """Message of ``plunge.structure``.

    The lists have the chosen structure first, then those that are also probable, or the more
    probable one that contradicts it (``contradicted``). ``second_s`` is a second lag and its
    standard uncertainty, possible with another entry burst. ``u_before_s`` and ``u_after_s`` are
    the standard uncertainty of the common lag without and with the choice of the structure.
    """
    named = [f"{s} ({m})" for s, m in zip(structures, meanings)]
    lags = [text_with_u(lag, u, "s") for lag, u in zip(lag_s, u_s)]
    remedy = ""
    if contradicted:
        text = (
            f"the plunges contradict chain {named[0]}: {named[1]} is {_odds(probability)} times as "
            f"probable (chi-square lower by {chi_square[0] - chi_square[1]:.0f}) and gives a "
            f"common lag of {lags[1]} instead of {lags[0]}"
        )
        remedy = f"; calibrate with {option('structure', structures[1])}"
    elif len(structures) == 1:
        text = (
            f"of {candidates} chain structures the plunges support {named[0]} "
            f"({probability_text(probability[0])})"
        )
    else:
        judged = [
            f"{s} ({m}: {probability_text(p)}, {lag})"
            for s, m, p, lag in zip(structures, meanings, probability, lags)
        ]
        text = f"the plunges cannot tell chain {judged[0]} from {' or '.join(judged[1:])}"
    if second_s is not None:
        second_lag = text_with_u(second_s[0], second_s[1], "s")
        text += f", and with another entry burst a lag of {second_lag} is also possible"
    before = rounded_texts(u_before_s, u_before_s)[1]
    after = rounded_texts(u_after_s, u_after_s)[1]
    if before == after:
        effect = "the common lag hardly depends on it"
    else:
        effect = (
            "the standard uncertainty of the common lag was therefore increased from "
            f"{before} s to {after} s"
        )
    return f"{text}; {effect}{remedy}"


def _odds(probability: Sequence[float]) -> str:
    """Text of the ratio of the second probability to the first, two significant digits."""
    ratio = probability[1] / max(probability[0], 1e-300)
    if ratio > 1e6:
        return "more than a million"
    return f"{float(f'{ratio:.2g}'):.0f}"


# immersion
PLUNGE: dict[str, Message] = {
    "plunge.lag": _lag,
    "plunge.structure": _chain_structure,
    "plunge.pull": _far_from_prior,
    "plunge.coloured": _coloured,
    "plunge.unconverged": "the plunge fit stopped before it converged",
    "plunge.rival": "a second solution, with a common lag of {lag_s:.1f} s and a stronger entry "
    "burst, fits about as well (chi-square differs by {chi_square:.1f})",
    "plunge.fluid": "h comes out {ratio:.2g} times what the correlation gives for {fluid} "
    "({sds:.1f} prior standard deviations off): is the fluid the right one?",
    "plunge.spikes": "{count} spikes were not used",
    "plunge.no_lag": "channel {subject}: the fitted lag reached zero; do not use its interval",
    "hole.ideal": "the two ideal thermocouples differ by {apart_s:.3f} s: one may not be clamped",
}
