"""Every finding in words: code -> what is said, one section for each room; the only file that makes such sentences.

A template takes its blanks from the finding: ``{subject}``, any of its numbers by name, ``{where}`` (left out, it is
put in front, with a colon), and ``{place}``, which is "column X, row N (T s)" as far as the subject and the numbers
``row`` and ``time_s`` tell. Where a sentence has branches the entry is a function of the same names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from calibration.estimate import Estimate, rounded, with_u

Words = str | Callable[..., str]
# what sentences name as a caller in Python would write it; a command line puts its own options there
SPOKEN = ("structure=", "loss=huber", "initial=", "models=", "narx=True", "gain=", "records=", "noise=", "baseline=")


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
    "time.strays": "column {subject}: the stamps stray from even sampling at {rate_Hz:.5g} Hz by {stray_s:.2g} s "
    "(1 sd); {percent:.0f} % of it is when samples were taken, as far as the readings tell, and is put right",
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
    "columns.unused": lambda names, **_: f"{some(len(names), 'column')} of the file not used: {', '.join(names)}",
    "contact.not_logged": "column contact is not in the log: load and friction tell when the disks touch, the parting "
    "less sharply",
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
LINES: dict[str, Words] = {
    "line.lack_of_fit": "channel {subject}: the line does not fit within the scatter of the repeats (p = {p:.2g})",
    "line.curved": "channel {subject}: a quadratic term is significant (p = {p:.2g})",
    "line.repeats_shift": "channel {subject}: the repeats shift by {u_degC:.2g} degC (u of their mean, p = {p:.2g})",
    "line.outlying": "channel {subject}: repeat {repeat:g} at {setpoint_degC:g} degC lies {off_K:+.2f} degC off the "
    "line; it is kept",
    "line.extrapolated": "{subject} read {read_degC[0]:.0f} to {read_degC[1]:.0f} degC, calibrated from "
    "{range_degC[0]:.0f} to {range_degC[1]:.0f} degC: static lines extrapolate there",
    "transducer.slopes_differ": "the sessions have different slopes (p = {p:.2g}); the cell itself has changed, not "
    "its zero",
    "record.missing_channels": lambda channels, **_: f"static: channels {', '.join(channels)} are missing",
    "record.future": "created: {created} lies in the future",
    "record.ranges_apart": "channel {subject}: the calibrated ranges do not overlap",
    "record.changed": "{subject} was {was}, is {now}",
    "record.in_one_only": lambda channels, **_: f"channels {', '.join(channels)} stand in one record only",
    "record.no_chain": "chain: the record holds no chain; it can correct steady readings only",
    "record.gain": "static.{subject}.gain: {gain:.4f} is more than 5 % from 1",
    "record.range": "static.{subject}.range_degC: {range_degC} leaves part of 20..160 degC to extrapolation",
    "record.line_unsure": "static.{subject}: the line is known to {u_K:.2g} degC only",
    "record.lag_unsure": lambda subject, lag_s, u_s, **_: (
        f"chain.{subject}: the lag {with_u(lag_s, u_s)} s is hardly known"
    ),
    "record.lag_apart": lambda subject, apart_s, u_s, **_: (
        f"chain.{subject}: its lag is {with_u(apart_s, u_s)} s off the others'; badly cemented?"
    ),
}

# immersion
IMMERSION: dict[str, Words] = {
    "entry.bounced": "the entry switch bounced within a second; its first closing was taken",
    "entry.no_switch": "the entry switch never moved; the free thermocouple alone gives the entry time",
    "entry.by_junctions": "neither switch nor free thermocouple tells the entry: the junctions' own rise puts it to "
    "{u_s:.1f} s, and no better is the lag that they have in common known; an unloading tells it",
    "static.stated": "no oven log: readings are taken as logged, each with a standard uncertainty of {u_K:g} K",
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
        remedy = f"; calibrate with structure={structures[1]}"
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


def chance(p: float) -> str:
    """A p value as people read it.

    >>> chance(0.25), chance(3e-5), chance(0.0)
    ('p = 0.25', 'p = 3e-05', 'p < 1e-99')
    """
    return f"p = {p:.2f}" if p >= 0.01 else f"p = {p:.0e}" if p > 1e-99 else "p < 1e-99"


def _coloured_residuals(subject: str, p_white: float, p_input: float, noise_model: bool, **_: Any) -> str:
    remedy = "Intervals are the robust ones; try one lag more, and if the colour stays, noise=arma or baseline=walk."
    if noise_model:
        remedy = "Try a noise model of higher order, or one lag more."
    return (
        f"Residuals of {subject} are coloured (Ljung-Box {chance(p_white)}), by disturbances or by dynamics; whatever "
        f"of the input lies beneath that colour, the test cannot see ({chance(p_input)}). {remedy}"
    )


def _spikes(count: int, robust: bool, **_: Any) -> str:
    remedy = ", held down by the robust loss" if robust else "; fit with loss=huber"
    return f"{count} sample{'s stand' if count > 1 else ' stands'} out as spikes{remedy}."


def _why(subject: str, other: str, by: str, rms: float, other_rms: float, only: bool, least: bool, **more: Any) -> str:
    said = f"{subject} has the lowest {by}"
    if by == "parameters":
        said = f"{subject} has fewer parameters than {other} and a BIC within 2 of it"
    if by == "held out":
        said = (
            f"{subject} simulates the held-out part better ({rms:.4g} against {other_rms:.4g} rms) than {other}, which "
            "has the lower BIC"
        )
    elif not only:
        said += f" and simulates the held-out part to {rms:.4g} rms" + (", the least of all" if least else "")
    if more["ties"]:
        said += f"; {' and '.join(more['ties'])} within 2 of its BIC would do as well"
    for group, one, several, rest in (
        ("undetermined", "would score better but is", "would score better but are", "not determined by these data"),
        ("missing", "would score better but misses", "would score better but miss", "dynamics"),
        ("refused", "has", "have", "a lower one that is of the residuals' colour, or not seen in the held-out part"),
        ("pairs", "is", "are", "left out, for the pair does not oscillate and is two lags"),
    ):
        if names := more.get(group):
            said += f"; {', '.join(names)} {several if len(names) > 1 else one} {rest}"
    freed = " As a run starts off the equilibrium, the state at each start was estimated."
    return f"{said}." + (freed if more.get("freed") else "") + _disturbance(**more)


def _disturbance(
    order: Sequence[int] = (0, 0),
    baseline: str = "none",
    memory_s: float | None = None,
    p_walk: float | None = None,
    **_: Any,
) -> str:
    if p_walk is not None:
        likeliest = "a random walk" if memory_s is None else f"one of {memory_s:.2g} s" if memory_s else "none"
        return (
            " The answer is averaged over what may disturb the output beside white noise: a first-order disturbance "
            f"of any time constant up to a random walk, with a straight drift or without (likeliest {likeliest}; that "
            f"it outlasts the record has the probability {p_walk:.2g}, and makes the intervals as wide)."
        )
    drift = {"trend": "a straight drift", "walk": "a random walk"}.get(baseline)
    noise = f"ARMA({order[0]}, {order[1]}) noise" if any(order) else ""
    if baseline == "walk":
        noise = {(0, 1): "white noise", (0, 0): ""}.get((order[0], order[1]), f"ARMA({order[0]}, {order[1]}) steps")
    said = " with ".join(part for part in (drift, noise) if part)
    return f" What disturbs the output is modelled as {said}." if said else ""


REMEDIES = {  # of what is wrong with the record from which a model was to be identified
    "record.off_equilibrium": "let the runs start off equilibrium (initial=estimated)",
    "record.drift": "take the drift out of the output",
    "record.coarse": "log the output in finer steps",
    "record.feedback": "see whether the input answers the output (a closed loop)",
}
OBJECTIONS = {
    "dynamics": "the residuals of every one that the data determine still follow the input",
    "held out": "on data that it has not seen the best of them does worse than their mean",
    "colour": "the best of them repeats only {fit_percent:.0f} % of the output, and the rest is no white noise",
}


def _none(
    subject: str, why: str, against: str, fit_percent: float, untried: list[str], troubles: list[str], **more: Any
) -> str:
    first = [REMEDIES[code] for code in troubles]
    first.append(f"compare others (models={','.join(untried)})" if untried else "ask narx=True whether it is linear")
    repeats = (
        f" It repeats the held-out part to {more['held_out_percent']:.1f} %." if "held_out_percent" in more else ""
    )
    return (
        f"None of these models is good enough: {OBJECTIONS[against].format(fit_percent=fit_percent)}. Do not trust the "
        f"intervals below. The least bad is {subject}. {why}{repeats} Next, {', and '.join(first)}."
    )


def _but_first(troubles: list[str]) -> str:
    return f" But first {', and '.join(REMEDIES[code] for code in troubles)}." if troubles else ""


def _undetermined(subject: str, why: str, remark: str, troubles: list[str], **_: Any) -> str:
    return (
        f"Use {subject} with care. {why} But {remark}: excite the input more, or hold what is known (gain=K)."
        + _but_first(troubles)
    )


def _use(
    subject: str,
    why: str,
    coloured: bool,
    small: bool,
    worse_than_mean: bool,
    fit_percent: float,
    troubles: list[str],
    **more: Any,
) -> str:
    if coloured:
        said = (
            "Its residuals are coloured, by disturbances or dynamics; beneath that colour the test cannot see what is "
            "left of the input. The intervals are the robust, wider ones."
        )
    elif small:
        said = f"It explains {fit_percent:.0f} % of the output, the rest is white noise."
    else:
        said = "Its residuals hold nothing against it."
    if worse_than_mean:
        said += f" The held-out part does not confirm it: worse than the mean there ({more['held_out_percent']:.1f} %)."
    name = f"Provisionally {subject}" if troubles or worse_than_mean else f"Recommended: {subject}"
    return f"{name}. {why} {said}{_but_first(troubles)}"


IDENTIFY: dict[str, Words] = {
    "models.why": _why,
    "models.none": _none,
    "models.undetermined": _undetermined,
    "models.provisional": _use,
    "models.recommended": _use,
    "fit.bound": "{subject} ended on its {end} bound ({value:.3g}): the data do not ask for it",
    "fit.twin": "{subject} equals another lag: only their sum is determined; complex poles (U) may fit better",
    "fit.undetermined": "{subject} is hardly determined by these data (u = {u:.2g} for {value:.2g})",
    "fit.indistinct": "the data cannot tell all parameters of {subject} apart: some intervals are meaningless",
    "fit.stalled": "stopped after the allowed iterations; look at the intervals before using it",
    "fit.open_interval": "the interval of {subject} is open: it reaches the search bound ({low95:.3g}..{high95:.3g})",
    "residuals.rounding": "{subject} repeats every reading to within half a step of the output's rounding: no test can "
    "say more.",
    "residuals.follow_input": lambda subject, fit_percent, p_input, lag_s, **_: (
        f"{subject} misses dynamics although it fits {fit_percent:.1f} %: its residuals still follow the input "
        f"({chance(p_input)}, most at a lag of {lag_s:.3g} s); try another lag, a zero or a dead time."
    ),
    "residuals.coloured": _coloured_residuals,
    "residuals.white": lambda subject, p_white, p_input, **_: (
        f"Residuals of {subject} are white (Ljung-Box {chance(p_white)}) and unrelated to the input "
        f"({chance(p_input)}): this record holds nothing against the model."
    ),
    "residuals.spikes": _spikes,
    "validation.moved": "These data ask for other parameters of {subject} than those it was fitted to, by more than "
    "both uncertainties (p = {p:.2g}): the system, or its disturbance, is not the same.",
    "record.gaps": lambda count, **_: f"After {some(count, 'gap')} of the input the state was estimated anew.",
    "record.off_equilibrium": "A run starts {off:.3g} off the equilibrium that was assumed, {times_rms:.0f} times the "
    "rms: fit with initial=estimated.",
    "record.drift": "The residuals drift (correlation with time {correlation:.2f}): take the trend out of the output "
    "first.",
    "record.coarse": "The output moves in steps of {step:.3g}, the residuals' rms is {rms:.2g}: the intervals include "
    "the rounding, which the tests cannot tell from dynamics.",
    "record.feedback": lambda p, **_: (
        f"They tell of the input still to come ({chance(p)}) and not of the past one: the input answers the output "
        "(feedback, a closed loop, which biases the fit), or the two are not sampled at the same instants."
    ),
}

# tcdyn/compensate
COMPENSATE: dict[str, Words] = {
    "trace.stuck": "{subject}: stuck or saturated in {percent:.2g} % of the record, first at sample {first_sample}; "
    "those samples are treated as missing",
    "trace.bad": "{subject}: {percent:.2g} % of the samples are missing or spikes and carry no weight",
    "inverse.noisy": lambda bandwidth_Hz, noise_K, limit_K, best_Hz, **_: (
        f"a bandwidth of {bandwidth_Hz:.3g} Hz makes {noise_K:.3g} K of noise, more than the {limit_K:.3g} K allowed: "
        + (f"at most {best_Hz:.3g} Hz can be had" if best_Hz > 0 else "no bandwidth gives that")
        + " at this noise"
    ),
    "inverse.near_nyquist": "a bandwidth of {bandwidth_Hz:.3g} Hz is near half of the {rate_Hz:.3g} Hz sampling: "
    "between samples the answer is not what the formula says",
    "inverse.dead_time": "dead time and right-half-plane zeros cannot be inverted: they remain as a shift",
    "live.noisy": "the answer has {gain:.3g} times the trace's noise: a lower intensity or some lag behind makes it "
    "quieter",
}

# tcdyn/traces
TRACES: dict[str, Words] = {
    "spikes.gathered": "{count} spikes in {columns} channels were taken as missing, most in {subject} ({of_most})",
    "traces.gaps": "{subject}: {percent:.1f} % of the samples are spikes or missing",
    "noise.hum": "{subject}: hum of {amplitude_K:.2g} K at {f_Hz:.2f} Hz",
    "noise.folded": "{subject}: the sampling may lay harmonics of mains hum upon the temperature itself, where nothing "
    "tells them: {folded_K:.2g} K were added to its u; a rate that divides no multiple of the mains frequency "
    "avoids it",
    "noise.unexplained": "{subject}: in a part of its spectrum the noise is {ratio:.1f} times what white noise before "
    "and behind the conditioning filter explains; its level was taken no lower than where temperatures move",
    "noise.coloured": "{subject}: noise of {before_K:.2g} K comes through the conditioning filter, "
    "of {after_K:.2g} K from behind it; all that follows counts with both",
    "traces.coarse": lambda subject, step_K, channels, **_: (
        f"{subject} disk: the logger writes in steps of {step_K:.2g} K, coarser than the noise, in "
        f"{', '.join(channels)}: such rounding is no white noise, and lags and transient fits may be further off than "
        "they say"
    ),
}


# tcdyn/partition
def as_known(x: float | None, u: float) -> str:
    """``x`` with the decimals that two digits of the standard uncertainty ``u`` have; None is "open".

    >>> as_known(0.70151, 0.0042), as_known(None, 1.0)
    ('0.7015', 'open')
    """
    return "open" if x is None else f"{x:.{max(0, 1 - math.floor(math.log10(u)))}f}"


JOINT_NUMBERS = {
    "beta": ("beta", ""),
    "h": ("h", " W/m2K"),
    "lag_s": ("the lag", " s"),
    "h_fast": ("h of the fast disk", " W/m2K"),
    "h_slow": ("h of the slow disk", " W/m2K"),
    "exponent": ("the exponent", ""),
}


def _interval(subject: str, parameter: str, u: float, low95: float | None, high95: float | None, **n: Any) -> str:
    fit = "both disks" if subject == "both" else f"{subject} disk"
    what, unit = JOINT_NUMBERS[parameter]
    ends = ((low95, "below", n["low_seen"]), (high95, "above", n["high_seen"]))
    left = [f"from {word} (followed to {as_known(seen, u)}{unit})" for end, word, seen in ends if end is None]
    if left:
        return f"Joint fit, {fit}: the data do not bound {what} {' nor '.join(left)}."
    return (
        f"Joint fit, {fit}: 95 % of {what} reaches from {as_known(low95, u)} to {as_known(high95, u)}{unit} by its "
        f"profile, and from {as_known(n['normal_low95'], u)} to {as_known(n['normal_high95'], u)}{unit} by its "
        "standard uncertainty."
    )


def _other_disk(subject: str, keys: Sequence[str], record: Sequence[str], rig: Sequence[str], **_: Any) -> str:
    differs = [f"{key} = {now} (record: {was})" for key, was, now in zip(keys, record, rig)]
    more = f" and {len(differs) - 3} more" if len(differs) > 3 else ""
    return f"{subject} disk: rig.toml is used, and is not what the record was made with: {', '.join(differs[:3])}{more}"


FAULTS = {
    "dead": "channel {names} is dead: it rises by {rise_K:.1f} K under load and falls by {fall_K:.1f} K after "
    "unloading, the others by {usual_rise_K:.1f} K and {usual_fall_K:.1f} K",
    "swapped": "channels {names} look swapped",
    "misplaced": "junction {names} looks {mm:.1f} mm {way} than rig.toml says",
    "late": "channel {names} answers {s:.2f} s {when} than its record says: a bubble in its cement, or a column "
    "shifted in time",
    "offset": "channel {names} reads {size:+.1f} K off: its static line or reference junction",
    "unknown": "its six junctions do not read as the rim model says (chi-square {chi2:.0f} for {dof} data), and no "
    "single swap, misplacement or offset explains it",
}


def _suspected(subject: str, kind: str, channels: Sequence[str], log_odds: float | None = None, **n: Any) -> str:
    if subject == "both":
        one, other = (c.rpartition("_")[2] for c in channels)
        return (
            f"channels {one} of the fast disk and {other} of the slow disk look swapped (log-odds {log_odds:.0f} "
            "against the best fault of each disk by itself)"
        )
    size = n.get("size") or 0.0
    said = FAULTS[kind].format(
        names=" and ".join(channels),
        mm=abs(size) * 1e3,
        way="deeper" if size > 0 else "nearer the surface",
        s=abs(size),
        when="later" if size > 0 else "earlier",
        **n,
    )
    odds = "" if log_odds is None else f" (log-odds {log_odds:.0f} against a sound disk)"
    return f"{subject} disk: {said}{odds}" + ("; or " + ", ".join(n["rivals"]) if n.get("rivals") else "")


def _sound(subject: str, illogical: int, pairs: int, blind: Sequence[str], **_: Any) -> str:
    said = (
        f"{subject} disk: no swapped, dead, misplaced, late or offset channel found; {illogical} of {pairs} pairs "
        "illogical"
    )
    return said + (f"; a swap of {', '.join(blind)} could not have been told" if blind else "")


def _left_out(subject: str, why: str, stand_ins: Sequence[str], kept: Sequence[str], **_: Any) -> str:
    if stand_ins:
        cost = f"{' and '.join(stand_ins)} stand{'s' if len(stand_ins) == 1 else ''} in for it at the rim's inner edge"
    else:
        cost = f"of the outer row {' and '.join(kept)} {'is' if len(kept) == 1 else 'are'} left"
    return f"{subject} is left out: {why}; {cost}, and intervals are wider"


def _stated_depth(subject: str, channel: str, deeper_mm: float, u_mm: float, **_: Any) -> str:
    way = "deeper" if deeper_mm > 0 else "nearer the surface"
    size = Estimate.normal(abs(deeper_mm), u_mm)
    return f"the depth of junction {channel} of the {subject} disk (by this test {size} mm {way} than stated)"


def _stated_value(subject: str, name: str, **_: Any) -> str:
    if name == "parting":
        return "the instant of parting, or the chain's shape (a dead time, a third lag)"
    return f"{name} of the {subject} disk" if subject else name


def _blame(suspects: Sequence[str], suspects_z: Sequence[float]) -> str:
    return "; ".join(f"{what} ({z:.1f} standard deviations)" for what, z in zip(suspects, suspects_z))


def _ways_apart(one: str, other: str, apart: float, z: float, suspects: Any, suspects_z: Any, **n: Any) -> str:
    words = {one, other}
    if words == {"joint fast", "joint slow"}:
        usual = "a junction depth, a static line or the friction scale: the two disks' shares do not add to one"
    elif any(w.startswith("cooling") for w in words) and any(w.startswith("joint") for w in words):
        usual = "the chain's lag or the instant of parting: compensated and commuted forms should give the same"
    elif any(w.startswith("cooling") for w in words):
        usual = "the lag that was compensated, or the speed exponent"
    else:
        usual = "the speed exponent, or a junction depth"
    return (
        f"The ways to beta do NOT agree: {one} and {other} differ by {apart:.3f}, {z:.1f} standard deviations of their "
        f"difference; suspect {_blame(suspects, suspects_z) or usual}. {_holds(**n)}"
    )


def _holds(holds: bool, **n: Any) -> str:
    """Whether the headline may be used although something does not fit."""
    if not holds:
        return "Do NOT trust beta before that is cleared up."
    both = Estimate.normal(n["both"], n["both_u"])
    return (
        f"The joint fit of both disks holds all the same: beta = {both}, 95 % from {n['low95']:.3f} to "
        f"{n['high95']:.3f} over all other structures that were tried."
    )


def _ways_agree(one: str, other: str, apart: float, z: float, low: float, high: float, **n: Any) -> str:
    steady = Estimate.normal(n["steady"], n["steady_u"])
    said = (
        f"The ways to beta agree: {low:.3f} to {high:.3f}, speed law {steady}; the "
        f"largest difference, {one} against {other}, is {apart:.3f} or {z:.1f} standard deviations"
    )
    if "strained" not in n:
        return f"{said}."
    return (
        f"{said}. The stated value that the data pull most is {n['strained']}: {n['strained_z']:.1f} standard "
        f"deviations, no contradiction (one sound test in {1 / n['chance']:.0f} shows as much)."
    )


STRUCTURES = {  # of `tcdyn.partition.alternatives`: what it is, what to do about it
    "as assumed": ("as assumed", ""),
    "h_step": ("h changes at the parting", "the jets may hit the disks differently once they are apart"),
    "h_of_T": ("h follows the surface temperature", "a shorter cooling window is less touched by it"),
    "flux_shift": ("the contact runs beside the centre plane", "measure where the track lies"),
    "flux_wider": ("the heat enters over another width than Hertz's", "measure the track's width"),
    "faces": ("the side faces lose another amount of heat", "look at the washers"),
    "stem": ("the junctions lose heat along their wires", "calibrate the disk with its wires as in the test"),
    "elsewhere": ("part of the frictional heat goes elsewhere, or friction is off scale", "check the friction's gain"),
    "k_of_T": ("the conductivity changes with temperature", "state it for the temperature of the test"),
    "film_air": ("the running surface loses heat to oil or air of another temperature", "log the oil at the disks"),
}


def structure(name: str) -> str:
    """A structure in words.

    >>> structure("lag of fast_e"), structure("faces")
    ('junction e of the fast disk lags otherwise than its record says', 'the side faces lose another amount of heat')
    """
    if name in STRUCTURES:
        return STRUCTURES[name][0]
    disk, _, channel = name.removeprefix("lag of ").partition("_")
    return f"junction {channel} of the {disk} disk lags otherwise than its record says"


def _other_structure(name: str, log_odds: float, beta: float, u: float, **_: Any) -> str:
    remedy = STRUCTURES.get(name, ("", "a bubble in its cement, or its column is another's"))[1]
    return (
        f"the data ask for another structure than assumed: {structure(name)} (log-odds {log_odds:.0f}); with it beta "
        f"of both disks is {Estimate.normal(beta, u)}; {remedy}"
    )


def _power(scale: float, u: float, units: Sequence[str], **_: Any) -> str:
    likely = f"likeliest: {' or '.join(units)}" if units else "check load, friction, speeds and their units"
    size = Estimate.normal(scale, u)
    return f"the heat that both disks show is {size} times the logged frictional power F u_s; {likely}"


def _cables_exchanged(exponent: float, u: float, assumed: float, beta: float, at_rest: bool, **_: Any) -> str:
    alike = "before the load each disk has one temperature through the other's static lines only, and "
    return (
        f"the cables of the two disks look exchanged: {alike if at_rest else ''}the speed exponent comes out as "
        f"{Estimate.normal(exponent, u)} where the speed law has {assumed:.2f}, as if the fast disk were the slow one; "
        f"beta would then be near {1 - beta:.2f}: map the columns in rig.toml [columns]"
    )


def _headline(beta: float, u: float, count: int, low95: float, high95: float, z: float, **n: Any) -> str:
    implied = Estimate.normal(n["exponent"], n["exponent_u"])
    law = f"the exponent that it implies, {implied}, "
    law += "goes with the speed law's" if abs(z) < 2 else f"lies {abs(z):.1f} standard deviations off the speed law's"
    said = (
        f"beta = {Estimate.normal(beta, u)} by the joint fit of both disks: their shares add to one, what is wrong "
        f"with both alike cancels, and no speed law is assumed; {law} ({n['assumed']:g}). Over {count} other "
        f"structures 95 % of beta lie between {low95:.3f} and {high95:.3f}"
    )
    if "named" in n:
        said += f"; the data ask for one of them: {structure(n['named'])} (beta {n['named_beta']:.3f})"
    return f"{said}."


_PLACES = {"surface": "running surface", "faces": "side faces"}
PARTITION: dict[str, Words] = {
    "contact.dropout": "contact goes to 0 under load (first at time_s {first_s:.3f}, {count} time(s)): taken as a "
    "switch that fails, not as an unloading",
    "contact.bounced": "the contact switch bounced ({count} changes shorter than {shorter_s} s were bridged)",
    "contact.inverted": "the contact switch is inverted: it says 0 where load and friction say that the disks touch; "
    "it is read the other way round",
    "contact.again": "the disks touched again after the parting ({count} time(s), first {after_s:.2f} s after it, "
    "{length_s:.2f} s in all): the logged friction is taken as heat there",
    "loading.disagree": "contact switch and forces disagree on the loading by {late_s:+.2f} s; the forces are believed",
    "parting.switch_alone": "neither friction nor load shows a clear fall at unloading: the contact switch alone gives "
    "the instant",
    "parting.unclear": "neither friction nor load shows a clear fall at unloading: where they pass half their level "
    "gives the instant",
    "parting.no_friction": "the friction shows no clear fall at unloading: load cell and contact switch give the "
    "instant",
    "parting.disagree": "contact switch and {subject} disagree on the parting by {late_s:+.3f} s; the {subject} is "
    "used",
    "speeds.change": "the {subject} disk did not keep its speed after the parting ({percent:.0f} % of it after "
    "{after_s:.3g} s): its heat transfer coefficient follows, h ~ u^{exponent:.3g}",
    "speeds.missing": "the speed of the {subject} disk after the parting is not in the log: taken as unchanged",
    "speeds.ratio": "the logged speeds have ratio {ratio:.3f}, rig.toml says gear_ratio = {stated:.3f}: the log is "
    "used",
    "constant.used": "{subject} is not in the log: rig.toml [constants] states {value:g} +- {u:g}",
    "constant.logged": "{subject} is in the log: what rig.toml [constants] states of it is not used",
    "ambient.channels": lambda subject, at, mean_degC, drift_K, spread_K, count, **_: (
        f"air at the {_PLACES[at]} of the {subject} disk by {some(count, 'channel')}: {mean_degC:.1f} degC over the "
        f"last 150 s under load, drifting by {drift_K:+.2f} K"
        + (f", the channels differ by {spread_K:.2f} K (1 sd)" if count > 1 else "")
    ),
    "forces.one_zero": "the zeros of load cell and friction rest on the unloaded end alone: their drift is not seen",
    "one_disk.only": "a log of the {subject} disk alone: beta by its joint fit and by its cooling fit. The speed law "
    "and the fit of both disks need the other disk: with it, friction's scale, steel and depths would be checked by "
    "shares that add to one; here beta goes with them. Of the other disk nothing is seen: its share is the rest",
    "one_disk.fit_unused": "the press fit that rig.toml states for the {subject} disk is not used where one disk alone "
    "was logged: how uneven the disk is comes from its readings",
    "one_disk.ways": lambda subject, z, joint, joint_u, cooling, cooling_u, **_: (
        f"The {subject} disk's two ways to beta "
        + ("do NOT agree" if z > 3 else "agree")
        + f": {with_u(joint, joint_u)} by the joint fit, {with_u(cooling, cooling_u)} by the cooling fit, {z:.1f} "
        "standard deviations of their difference."
    ),
    "one_disk.headline": lambda subject, beta, u, **_: (
        f"beta = {with_u(beta, u)} of the fast disk, by the joint fit of the {subject} disk alone."
    ),
    "channel.left_out": _left_out,
    "friction.coefficient": "the friction coefficient {coefficient:.4f} is unlike an EHL contact: check units",
    "record.other_disk": _other_disk,
    "sensors.suspect": _suspected,
    "sensors.sound": _sound,
    "unevenness": lambda subject, amplitude_K, u_K, angle_deg, angle_u_deg, **_: (
        f"{subject} disk: its bore contact is uneven: {Estimate.normal(amplitude_K, u_K).text('K')} hotter at "
        f"{angle_deg:.0f} degrees of rig.toml's angles, and as much colder opposite, at the depth of b; the fit of "
        "both disks found it, and it was subtracted from the readings (section 6.4.3: look at press fit and keys)"
    ),
    "fit.contradicted": "{subject} disk: its readings are {seen_K:.1f} K hotter at {seen_deg:.0f} degrees than in the "
    "mean round the bore, while the press fit that rig.toml states would make it {told_K:.1f} K at {told_deg:.0f} "
    "({z:.1f} standard uncertainties apart): [fit] is not used for this disk; look at its keyways and patches, their "
    "angles and the angle_deg of the junctions",
    "stated.depth": _stated_depth,
    "stated.value": _stated_value,
    "stated.lag": "the lag of the {subject} disk: record {record_s:.3f} s, unloading {unloading_s:.3f} s",
    "stated.exponent": lambda assumed, implied, u, **_: (
        f"the speed exponent: {assumed:.3f} assumed, {Estimate.normal(implied, u)} implied by the two disks"
    ),
    "stated.sensors": lambda subject, kind, columns, **_: (
        f"{' and '.join(columns) or f'the junctions of the {subject} disk'} ({kind})"
    ),
    "ways.agree": _ways_agree,
    "ways.apart": _ways_apart,
    "ways.contradicted": lambda low, high, suspects, suspects_z, **n: (
        f"The ways to beta lie together ({low:.3f} to {high:.3f}), but the data contradict what was stated: suspect "
        f"{_blame(suspects, suspects_z)}. {_holds(**n)}"
    ),
    "cables.exchanged": _cables_exchanged,
    "headline.both": _headline,
    "headline.withheld": "No beta is given: what the joint fit of both disks finds is impossible.",
    "answers.impossible": lambda ways, **_: (
        f"impossible numbers (beta outside 0 to 1, h not above zero) by {', '.join(ways)}: withheld"
    ),
    "power.scale": _power,
    "structures.other": _other_structure,
    "joint.interval": _interval,
}

# tcdyn/pipeline
PIPELINE: dict[str, Words] = {
    "calibrate.other_disk": "{count} static lines do not fit the plunges: is the oven log of the disk that was plunged "
    "({subject}), and the wiring the same?",
    "bearing.extrapolated": "bearing friction at {load_N:.0f} N and {speed_rpm:.0f} rpm is extrapolated: {file} covers "
    "{loads_N[0]:.0f} to {loads_N[1]:.0f} N and {speeds_rpm[0]:.0f} to {speeds_rpm[1]:.0f} rpm",
    "verify.differs": "{source}: {subject}: {ours} for {published}",
    "compensate.one_disk": "no record of the {subject} disk was given: its columns are as logged, and the lag common "
    "to the {other} disk is the record's, which an unloading would tell better; add records={subject}.disk.json",
    "compensate.unrefined": "the common lags are the records': the unloading could not be used ({problem})",
    "follow.dead": "column {subject} shows nothing: it is left empty",
    "follow.spikes": "{count} samples stand in spikes or bursts",
    "follow.backward": "{count} rows whose time does not rise were left out",
    "follow.gaps": "{count} gaps in time_s, the longest of {longest_s:.3g} s: beside them the bands are wide",
    "follow.torn": "{count} lines without the right number of fields were left out",
}

# tcdyn/campaign


def _cause(cause: str, size: float, u: float) -> str:
    """What in one test alone would explain that it departs from all others.

    >>> _cause("friction", 0.05, 0.002), _cause("static e slow", -0.6, 0.1)
    ('its friction reads (5.00 +- 0.20) % low', 'slow_e reads (-0.60 +- 0.10) K otherwise')
    """
    kind, _, of = cause.partition(" ")
    if cause == "friction":
        value, spread = rounded(100 * abs(size), 100 * u)
        return f"its friction reads ({value} +- {spread}) % {'low' if size > 0 else 'high'}"
    value, spread = rounded(size, u)
    match kind:
        case "half-width":
            value, spread = rounded(100 * size, 100 * u)
            return f"the contact's half-width is ({value} +- {spread}) % off what the load says"
        case "ambient":
            return f"its ambient reads ({value} +- {spread}) K otherwise"
        case "parting":
            return f"its parting is ({value} +- {spread}) s off"
        case "lag":
            return f"the lag of the {of} disk is ({value} +- {spread}) s longer"
    channel, _, disk = of.partition(" ")
    return f"{disk}_{channel} reads ({value} +- {spread}) K otherwise"


CAMPAIGN: dict[str, Words] = {
    "campaign.stranger": lambda subject, cause, size, u, z, chi2, left, freedom, explained, **_: (
        f"{subject} does not belong to its campaign: against all other tests chi-squared is {chi2:.0f} on {freedom} "
        f"degrees of freedom; it would "
        + ("belong" if explained else f"belong better (chi-squared {left:.0f})")
        + f" if {_cause(cause, size, u)} ({abs(z):.0f} standard deviations); the others were solved "
        "without it"
    ),
    "campaign.exponent": "{tests} tests together give the exponent of the speed law n = {n:.3f} +- {u:.3f}; rig.toml "
    "assumes {assumed:.3f}: speed_exponent in its [contact] may be set to it",
    "campaign.power_law": "one power of the speed is not enough for h: n changes by {per_doubled:.3f} +- {u:.3f} while "
    "the speed doubles (chance {p:.2g})",
    "campaign.junction": "all tests together place {subject} {deeper_mm:.2f} +- {u_mm:.2f} mm deeper than stated "
    "({z:.1f} standard deviations): look at its depth_mm in rig.toml",
    "campaign.apart": "{subject} is not joined with the other tests: {why}",
    "campaign.altered": "{subject} in the results folder is not as it was written: its log was analysed again",
    "campaign.repeated": "{text} (in {first}; so or nearly so in {others})",
}

# tcdyn/sensor and tables compensated with it
SENSOR: dict[str, Words] = {
    "sensor.exact": "the lag of {lag_s:.4g} s was stated without an uncertainty: it is taken as exact, and the bands "
    "of what it compensates hold noise only; state one, such as 1.5+-0.1",
    "sensor.gain": "{subject}: the gain is {gain:.4g} +- {u:.2g}, not 1: the lag is removed, the gain is left in",
    "sensor.carried": lambda columns, **_: (
        f"{some(len(columns), 'column')} no sensor covers, carried over as logged: {', '.join(columns)}"
    ),
    "sensor.unit_assumed": "column {subject} states no unit: read as degrees Celsius",
    "sensor.unit_doubt": "column {subject} reads {value:.4g} {unit} in the middle; is that its unit?",
    "sensor.few_decimals": "the clock has few decimals: rows are taken as even, {rate_Hz:.5g} Hz",
    "sensor.uneven": "rows stray from even sampling at {rate_Hz:.5g} Hz by {stray_s:.2g} s (1 sd): answers are that "
    "uncertain in time",
    "sensor.short": "a stretch of {count} rows is too short to be compensated: its answers are empty",
    "sensor.dead": "column {subject} shows nothing in a stretch: its answers there are empty",
    "sensor.left": "column {subject} cannot be compensated in a stretch ({problem}): its answers there are empty",
    "sensor.coloured": "{subject}: what the fit leaves is not white; its colour is taken into account",
    "sensor.misfit": "{subject}: the fit leaves {rms_K:.2g} K rms where the noise is {noise_K:.2g} K: the surroundings "
    "did not make one clean step, or the sensor is no chain of lags",
    "sensor.cut_off": "{subject}: the record ends {after_s:.3g} s after the step, for a lag of {lag_s:.3g} s: its "
    "end is extrapolated",
    "sensor.pair_difference": "{subject}: the traces tell the difference of the lags, {difference_s:.3g} +- {u_s:.2g} "
    "s, but hardly the lags themselves: the fluid changed too slowly for their ratio",
    "sensor.pair_misfit": "{subject}: the two do not see one fluid through one lag each: what is left is {ratio:.2g} "
    "times the noise",
    "sensor.pair_flow": "{subject}: the lags change with the flow; the file holds those of {what}",
    "sensor.conversion_wide": "{subject}: the answer to the current does not tell the plunge's lag well: {low_s:.3g} "
    "to {high_s:.3g} s (95 %), for films, walls and heated wires that would answer alike; a plunge would tell",
    "sensor.conversion": "{subject}: the plunge's lag is converted from heating inside, to {percent:.2g} % (95 %): it "
    "holds for a round sensor that is heated about its axis and read there",
    "sensor.noise_driving": lambda subject, lags, **_: (
        f"{subject}: the lag is the sensor's if the fluid's own fluctuations are white; slower ones add their time"
        + ("; of the two lags found one may be the fluid's" if lags == 2 else "")
    ),
    "sensor.noise_unsteady": "{subject}: the fluctuations are {ratio:.2g} times as large in one quarter as in another: "
    "the process is not steady",
    "sensor.noise_misfit": "{subject}: the spectrum is not that of white fluctuations behind one or two lags (p = "
    "{p_value:.1g}): the lag is not to be trusted",
    "sensor.slow": "column {subject}: rows every {dt_s:.3g} s are slow for a lag of {lag_s:.3g} s",
}

WORDS: dict[str, Words] = {
    **OLD, **READER, **LINES, **IMMERSION, **PLUNGE, **IDENTIFY, **COMPENSATE, **TRACES, **PARTITION, **PIPELINE,
    **CAMPAIGN, **SENSOR,
}  # fmt: skip
