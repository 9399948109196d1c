"""Every finding in words: code -> what is said, one section for each room; the only file that makes such sentences.

A template takes its blanks from the finding: ``{subject}``, any of its numbers by name, ``{where}`` (left out, it is
put in front, with a colon), and ``{place}``, which is "column X, row N (T s)" as far as the subject and the numbers
``row`` and ``time_s`` tell. Where a sentence has branches the entry is a function of the same names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from calibration.estimate import rounded, with_u

Words = str | Callable[..., str]


def told(code: str, where: str, subject: str, numbers: dict[str, Any]) -> str:
    """The sentence of a finding. Raises KeyError for an unknown code and for a number that its words ask for.

    >>> told("said", "D4.csv", "", {"text": "the clock stood still"})
    'D4.csv: the clock stood still'
    """
    words = WORDS[code]
    blanks = {**numbers, "where": where, "subject": subject, "place": place(subject, **numbers)}
    if callable(words):
        text = words(**blanks)
    else:
        text = words.format_map(blanks)
        where = "" if "{where}" in words else where
    return f"{where}: {text}" if where else text


def place(subject: str = "", row: int | None = None, time_s: float | None = None, **_: Any) -> str:
    """Where in a log: column, row and, in a trace, time.

    >>> place("a_degC", 9, 0.04), place("a_degC", 9), place(row=9)
    ('column a_degC, row 9 (0.04 s)', 'column a_degC, row 9', 'row 9')
    """
    parts = [*([f"column {subject}"] if subject else []), *([f"row {row}"] if row is not None else [])]
    return ", ".join(parts) + (f" ({time_s:.6g} s)" if time_s is not None else "")


def some(count: int, noun: str) -> str:
    """A count with its noun.

    >>> some(1, "spike"), some(3, "spike")
    ('1 spike', '3 spikes')
    """
    return f"{count} {noun}" + ("" if count == 1 else "s")


# a file from before findings were kept: the sentence as it stood there
OLD: dict[str, Words] = {"said": "{text}"}


def _no_number(place: str, text: str, count: int, **_: Any) -> str:
    return f"{place}: {text!r} is no number{f' (and {count - 1} more)' if count > 1 else ''}; taken as missing"


def _aligned(subject: str, spread_s: float, rates_Hz: tuple[float, ...], **_: Any) -> str:
    rates = ", ".join(f"{r:g}" for r in rates_Hz)
    return (
        f"channels start up to {spread_s:.6g} s apart ({subject} last), rates {rates} Hz; all put on the fastest "
        "one's samples by straight lines"
    )


def _absent(place: str, longest: int, longest_s: float, count: int, **_: Any) -> str:
    run = "1 value is" if longest == 1 else f"{longest} values in a row are"
    more = f"; {count} in all, this run the longest" if count > longest else ""
    return f"{place}: {run} missing ({longest_s:.2g} s){more}"


# calibration: files, checks, log
READER: dict[str, Words] = {
    "text.no_line_end": "row {row}, the last, has no line end: its last value may be cut short",
    "text.midnight": "column {subject}: the clock passes midnight; the time runs on",
    "text.no_number": _no_number,
    "tracks.assumed": "channel {subject} has no time track; that of {of} is assumed",
    "tracks.aligned": _aligned,
    "time.filled": "{place}: {count} missing time(s) filled from the neighbours",
    "time.few_decimals": "column {subject}: the stamps have few decimals; they are taken as even, {rate_Hz:.5g} Hz",
    "time.jitter": "{place}: {count} time stamps jitter by up to half a sample",
    "time.lost": "{place}: {count} samples are missing in {places} place(s), first at {first_s:.6g} s; put in as NaN",
    "time.slow": "column {subject}: sampled at {rate_Hz:.3g} Hz; 75 Hz is the rig's rate, lags below {lost_s:.2g} s "
    "are lost",
    "values.impossible": "{place}: {count} impossible value(s) such as {value:.4g}; taken as missing",
    "values.missing": "{place}: {count} value(s) missing or impossible; taken as missing",
    "values.absent": _absent,
    "spikes.removed": "{place}: {count} spike(s); taken as missing",
    "column.constant": "column {subject} is {value:.6g} in every row",
    "column.frozen": "{place}: stays at {value:.6g} for {span_s:.3g} s",
    "column.not_there": "column {subject} is missing",
    "noise.high": "column {subject}: noise {noise_K:.2g} degC, the others' is {others_K:.2g}",
    "switch.filled": "{place}: {count} value(s) missing; state kept",
    "switch.levels": "column {subject}: levels {low:g} and {high:g} are read as 0 and 1",
    "switch.bounces": "{place}: the switch bounces ({count} changes)",
    "contact.from_start": "column contact: the log begins in contact; the loading is not in it",
    "contact.short_cooling": "column contact: only {cooling_s:.2g} s of cooling after the unloading",
    "friction.negative": "column friction_N is negative in contact; its sign may be turned round",
    "friction.high": "column friction_N is above 0.3 of the load in contact",
    "speed.slow": "column speed_slow_rpm: {speed_rpm:.3g} in contact; is it in revolutions per second?",
    "junctions.swapped": "columns {subject} and {other}: the junction {depth_mm:g} mm deep warms {behind_K:.2g} degC "
    "less than the one at {other_depth_mm:g} mm; are they swapped?",
    "oven.no_prt": "{place}: {count} row(s) without PRT left out",
    "oven.missing": "{place}: {count} value(s) missing",
    "oven.far": "{place}: {value_degC:.4g} degC where the PRT reads {prt_degC:.4g}",
    "oven.continuous": "a continuous log: {count} steady minutes were found in {span_h:.3g} h",
    "oven.no_setpoint": "column setpoint_degC is missing; the PRT to the nearest 5 degC stands in",
    "oven.no_repeat": "column repeat is missing; each return to a set point counts as the next repeat",
}

# calibration: lines, record
LINES: dict[str, Words] = {}

# immersion
IMMERSION: dict[str, Words] = {
    "entry.bounced": "the entry switch bounced within a second; its first closing was taken",
    "entry.no_switch": "the entry switch never moved; the free thermocouple alone gives the entry time",
    "entry.no_probe": "the free thermocouple shows no jump; the switch alone gives the entry time",
    "entry.apart": "switch and free thermocouple differ by {difference_s:.2f} s at entry; the uncertainty was widened "
    "to {u_s:.2f} s",
    "correlation.range": "correlation {subject} {title} holds for Ra of {holds[0]:.0e} to {holds[1]:.0e}; this plunge "
    "ran from {ran[0]:.1e} to {ran[1]:.1e}",
    "correlation.no_plate": "the disk may not be treated as a plate throughout: D/L = {ratio:.1f} is below "
    "35/Gr^0.25 = {least:.1f}",
    "fluid.extrapolated": "{subject}: film temperatures of {used_degC[0]:.0f} to {used_degC[1]:.0f} degC were used, "
    "but its properties are known from {known_degC[0]:.0f} to {known_degC[1]:.0f} degC: h is an extrapolation",
}

# tcdyn/plunge
PARAMETERS = {
    "ln_h": "scale of h",
    "h_exponent": "extra exponent of h",
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


def _lag(plunges: int, common_lag_s: float, u_s: float, known_burst_u_s: float, apart: bool, **_: Any) -> str:
    text = f"{'One plunge gives' if plunges == 1 else f'{plunges} plunges give'} a common lag of "
    text += with_u(common_lag_s, u_s, "s")
    known = (
        f"with the entry burst and the entry time known it would be +- {rounded(known_burst_u_s, known_burst_u_s)[1]} s"
    )
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
    kept: bool,
    u_before_s: float,
    u_after_s: float,
    **_: Any,
) -> str:
    named = [f"{s} ({m})" for s, m in zip(structures, meanings)]
    lags = [with_u(lag, u, "s") for lag, u in zip(lag_s, u_s)]
    judged = [f"{s} ({m}: {percent(p)}, {lag})" for s, m, p, lag in zip(structures, meanings, probability, lags)]
    remedy = ""
    if contradicted:
        ratio = probability[1] / max(probability[0], 1e-300)
        odds = "more than a million" if ratio > 1e6 else f"{float(f'{ratio:.2g}'):.0f}"
        text = (
            f"the plunges contradict chain {named[0]}: {named[1]} is {odds} times as probable "
            f"(chi-square lower by {chi_square[0] - chi_square[1]:.0f}) and gives a common lag of "
            f"{lags[1]} instead of {lags[0]}"
        )
        remedy = f"; calibrate with --structure {structures[1]}"
        if not kept:
            remedy = "; a record holds two lags: take the common lag from an unloading"
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


PLUNGE: dict[str, Words] = {
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

# tcdyn/identify
IDENTIFY: dict[str, Words] = {}

# tcdyn/compensate
COMPENSATE: dict[str, Words] = {}

# tcdyn/traces
TRACES: dict[str, Words] = {
    "traces.gaps": "{subject}: {percent:.1f} % of the samples are spikes or missing",
    "traces.coarse": lambda subject, step_K, channels, **_: (
        f"{subject} disk: the logger writes in steps of {step_K:.2g} K, coarser than the noise, in "
        f"{', '.join(channels)}: such rounding is no white noise, and lags and transient fits may be further off than "
        "they say"
    ),
}

# tcdyn/partition
PARTITION: dict[str, Words] = {}

# tcdyn/pipeline
PIPELINE: dict[str, Words] = {}

WORDS: dict[str, Words] = {
    **OLD, **READER, **LINES, **IMMERSION, **PLUNGE, **IDENTIFY, **COMPENSATE, **TRACES, **PARTITION, **PIPELINE,
}  # fmt: skip
