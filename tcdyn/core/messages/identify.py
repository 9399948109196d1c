"""Messages about system identification: model choice, residual tests, records, responses.

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
from tcdyn.core.messages.phrases import Message, count_with_noun

# What was estimated of the initial state, after the sentence of the selection.
INITIAL_STATE = {
    "estimated": " As a run starts off the equilibrium, the state at each start was estimated.",
    "level": " As a run starts in equilibrium with another level of the input than its first, this "
    "level was estimated.",
}


def _p_value(p: float) -> str:
    """Text of a p-value.

    >>> _p_value(0.25), _p_value(3e-5), _p_value(0.0)
    ('p = 0.25', 'p = 3e-05', 'p < 1e-99')
    """
    if p >= 0.01:
        return f"p = {p:.2f}"
    if p > 1e-99:
        return f"p = {p:.0e}"
    return "p < 1e-99"


# ---- choice of the model


# why models were rejected: the number of the finding that lists them, text for one and for several
_UNDETERMINED = "not determined by these data"
_NO_PAIR = "left out, because the pair of poles does not oscillate and is two lags"
_NEEDLESS = "left out, because lags describe the record about as well"
# Reasons for which models were rejected: field of the finding, and predicate for one and for
# several.
REJECTED = (
    (
        "undetermined",
        f"would score better but is {_UNDETERMINED}",
        f"would score better but are {_UNDETERMINED}",
    ),
    (
        "missing",
        "would score better but misses dynamics",
        "would score better but miss dynamics",
    ),
    ("pairs", f"is {_NO_PAIR}", f"are {_NO_PAIR}"),
    ("needless", f"is {_NEEDLESS}", f"are {_NEEDLESS}"),
)


MAX_LISTED = 3  # names of rejected models in a message


def _reason(
    subject: str,
    other: str,
    by: str,
    rms: float,
    validation_rms: float,
    other_rms: float,
    only: bool,
    least: bool,
    **more: Any,
) -> str:
    """Message of ``models.why``.

    ``subject`` is the recommended model. ``by`` is the criterion: "BIC", "parameters" or "held
    out"; by the last two it replaces ``other``, which has a lower BIC. ``rms`` is the error on the
    held-out data; ``least``: no model has a smaller one; ``validation_rms`` and ``other_rms`` are
    the errors of both on all data that were left out of a fit; ``only``: it is the only model.
    ``ties`` are models within 2 of its BIC. The keys of ``REJECTED`` list rejected models.
    ``initial`` is the selected initial state.
    """
    if by == "parameters":
        text = f"{subject} has fewer parameters than {other} and a BIC within 2 of it"
    elif by == "held out":
        text = (
            f"{subject} simulates data left out of the fit better ({validation_rms:.4g} against "
            f"{other_rms:.4g} rms) than {other}, which has the lower BIC"
        )
    else:
        text = f"{subject} has the lowest {by}"
    if by != "held out" and not only:
        text += f" and simulates the held-out part to {rms:.4g} rms"
        if least:
            text += ", the least of all"
    if more["ties"]:
        text += f"; {' and '.join(more['ties'])} within 2 of its BIC would do as well"
    for group, singular, plural in REJECTED:
        names = more.get(group)
        if names:
            predicate = plural if len(names) > 1 else singular
            listed = ", ".join(names[:MAX_LISTED])
            if len(names) > MAX_LISTED:
                listed += f" and {len(names) - MAX_LISTED} more"
            text += f"; {listed} {predicate}"
    text += "."
    text += INITIAL_STATE.get(more.get("initial", ""), "")
    return text + _disturbance(**more) + _part_of_record(**more)


def _better_prediction(
    subject: str, other: str, ratio: float, white: bool, initial: str = "", **more: Any
) -> str:
    """Message of ``models.foresees``.

    ``ratio`` is the held-out error of ``subject`` over that of ``other``, which BIC recommends.
    ``initial`` is the selected initial state.
    """
    text = (
        f"{subject} simulates data kept from the fit to {100 * ratio:.0f} % of the error of {other}"
    )
    if white:
        text += ", and leaves white residuals"
    text += "."
    text += INITIAL_STATE.get(initial, "")
    return text + _disturbance(**more) + _part_of_record(**more)


# Probability of one of two disturbances, below which the data exclude it.
MIN_DOUBT = 0.05
EVEN_ODDS = 0.5


def _part_of_record(block: int = 0, share: float = 1.0, **_: Any) -> str:
    """Sentence on the rows of a large record that were compared; empty for all rows."""
    if not block:
        return ""
    rows = "rows" if block == 1 else f"means of {block} rows"
    return (
        f" The models were compared on {rows} of {100 * share:.3g} % of the record; the model "
        "above is fitted to all rows, and the intervals do not include the choice of the "
        "structure."
    )


def _disturbance(
    order: Sequence[int] = (0, 0),
    baseline: str = "none",
    memory_s: float | None = None,
    p_walk: float | None = None,
    wave: float | None = None,
    **_: Any,
) -> str:
    """Sentence on the model of the disturbance, with a space in front; empty for white noise.

    Parameters
    ----------
    order
        Numbers of AR and MA coefficients.
    baseline
        Model of the baseline: "none", "trend" or "walk".
    memory_s
        Time constant of the most probable disturbance [s]; None for a random walk, 0 for none.
    p_walk
        Probability of a random walk where the result is averaged over noise models; otherwise None.
    wave
        Range of the slow waves over that of the output, where there are any.
    **_
        Other numbers of the finding, which are not used.
    """
    if p_walk is not None:
        text = " The result is averaged over what may disturb the output besides white noise: "
        if wave is not None:
            text += f"a drift or slow wave (here {100 * wave:.2g} % of the output's range), and "
        text += (
            "a first-order disturbance, whose time constant exceeds the length of the record with "
            f"probability {p_walk:.2g}"
        )
        if memory_s and p_walk < EVEN_ODDS:
            text += f" and is most probably {memory_s:.2g} s"
        text += "."
        return text
    is_white = not any(order)
    noise = f"ARMA({order[0]}, {order[1]}) noise"
    parts: list[str] = []
    if baseline == "trend":
        parts = ["a linear drift"] if is_white else ["a linear drift", noise]
    elif baseline == "walk":
        parts = ["a random walk"]
        if tuple(order) == (0, 1):
            parts.append("white noise")
        elif not is_white:
            parts.append(f"ARMA({order[0]}, {order[1]}) steps")
    elif not is_white:
        parts = [noise]
    if not parts:
        return ""
    return f" The disturbance of the output is modelled as {' with '.join(parts)}."


def _remedies(troubles: Sequence[str], option: Spelling) -> list[str]:
    """What to do about each problem of the record.

    Parameters
    ----------
    troubles
        Codes of the problems.
    option
        Spelling of a parameter.
    """
    remedies = {
        "record.off_equilibrium": "let the runs start off equilibrium "
        f"({option('initial', 'estimated')})",
        "record.drift": f"fit with {option('baseline', 'trend')}",
        "fit.prior_conflict": "check the prior, and fit without it",
        "record.coarse": "log the output in finer steps",
        "record.clipped": "record again with the output below the limit of its range, for the "
        "output is clipped and these samples were left out",
        "record.slow_sampling": "log faster, because the samples do not show the response between "
        "them, and the lag then depends on the assumed structure",
        "record.nonlinear": "identify each level on its own, with steps between two neighbouring "
        "levels, because the output does not follow the input linearly",
        "record.rise_and_fall": "identify rise and fall each on its own, as records of one switch "
        "until the output has settled, because the output does not follow the input linearly",
        "record.changing": "identify each part of the record on its own, because the response "
        "changes with time, as that of a sensor in a flow that changes",
        "record.clock_drift": "correct the time of one logger and join the tables anew, because "
        "the delay between input and output drifts along the record",
        "record.closed_loop": "record with the loop open, because the input is computed from the "
        "output",
        "record.thermostat": "record with the thermostat out of action, and switch by hand or by a "
        "timer with unequal on and off times",
        "record.one_frequency": "use an input of several frequencies, such as steps, or record its "
        "start from rest, because one sine determines neither gain nor lag without the structure",
        "record.inseparable": "move each input alone, because the record does not separate their "
        "effects",
        "model.wave": "record steps of the input that are faster than the drift, because a drift "
        "or slow wave may cause as much of the output as the input does",
        "model.at_once": "check whether the input is computed from the output (a closed loop): "
        "this model responds to its input without delay, and with the opposite sign or without a "
        "static gain, like minus the inverse of a controller",
        "model.general": "check its step response, because no process model describes the record: "
        "gain and lag of a general transfer function depend on its order, which their intervals do "
        "not include",
        "record.feedback": "check whether the input depends on the output (a closed loop)",
        "record.other_hold": f"check the hold of the inputs ({option('hold', None)}), because "
        "another one is more likely",
    }
    return [remedies[code] for code in troubles]


def _but_first(troubles: list[str], option: Spelling) -> str:
    """Sentence on what to do about the problems first; empty if there are none."""
    return f" But first {', and '.join(_remedies(troubles, option))}." if troubles else ""


# Why no model is good enough, by the field ``against``.
OBJECTIONS = {
    "dynamics": "the residuals of every model that the data determine are still correlated with "
    "the input",
    "held out": "on the held-out data the best of them is worse than their mean",
    "colour": "the best of them explains only {fit_percent:.0f} % of the output, and the residuals "
    "are not white noise",
}


def _no_model(
    subject: str,
    why: str,
    against: str,
    fit_percent: float,
    untried: list[str],
    troubles: list[str],
    option: Spelling,
    **more: Any,
) -> str:
    """Message of ``models.none``.

    ``subject`` is the least bad model and ``why`` the sentence of its selection. ``against`` is a
    key of ``OBJECTIONS``; ``untried`` are models that were not compared, ``troubles`` the codes of
    the record's problems.
    """
    objection = OBJECTIONS[against].format(fit_percent=fit_percent)
    steps = _remedies(troubles, option)
    if untried:
        steps.append(f"compare others ({option('models', list(untried))})")
    else:
        steps.append(f"test with {option('narx', True)} whether it is linear")
    text = (
        f"None of these models is good enough: {objection}. Do not trust the intervals below. The "
        f"least bad is {subject}. {why}"
    )
    if "held_out_percent" in more:
        text += f" It explains {more['held_out_percent']:.1f} % of the held-out part."
    return f"{text} Next, {', and '.join(steps)}."


def _undetermined(
    subject: str, why: str, remark: str, troubles: list[str], option: Spelling, **_: Any
) -> str:
    """Message of ``models.undetermined``.

    ``why`` is the sentence of the selection, ``remark`` what the data do not determine,
    ``troubles`` the codes of the record's problems.
    """
    return (
        f"Use {subject} with care. {why} But {remark}: use an input that excites the system more, "
        f"or fix what is known ({option('gain', 'K')}).{_but_first(troubles, option)}"
    )


def _integrator_or_lag(
    subject: str, why: str, other: str, troubles: list[str], option: Spelling, **_: Any
) -> str:
    """Message of ``models.integrator``.

    ``why`` is the sentence of the selection, ``other`` a model without integrator that is as
    likely, ``troubles`` the codes of the record's problems.
    """
    return (
        f"Use {subject} with care. {why} But {other}, whose output settles, describes the record "
        "as well: it does not show whether the output would settle. Record until it does, with "
        f"longer constant levels of the input.{_but_first(troubles, option)}"
    )


def _recommendation(
    subject: str,
    why: str,
    coloured: bool,
    small: bool,
    worse_than_mean: bool,
    all_disturbance: bool,
    follows_input: bool,
    fit_percent: float,
    troubles: list[str],
    option: Spelling,
    **more: Any,
) -> str:
    """Message of ``models.provisional`` and ``models.recommended``.

    ``why`` is the sentence of the selection. ``coloured``: the residuals are not white; ``small``:
    the model explains little of the output; ``worse_than_mean``: on the held-out data it is worse
    than a constant; ``all_disturbance``: so it is on all data, without the disturbance;
    ``follows_input``: the residuals still follow the input, although they are small.
    ``troubles`` are the codes of the record's problems.
    """
    if follows_input:
        text = (
            f"It explains {fit_percent:.1f} % of the output, but the residuals still follow the "
            "input: small dynamics or nonlinearity are missing, which the intervals do not include."
        )
    elif coloured:
        text = (
            "Its residuals are coloured, by disturbances or by dynamics; below their level the "
            "test cannot detect a response to the input. The intervals are the robust, wider ones."
        )
    elif all_disturbance:
        text = (
            "The residual tests do not contradict it, but without the disturbance its output is "
            f"farther from the record than a constant is ({more['centred_percent']:.0f} %): the "
            "disturbance may replace dynamics. Record with larger changes of the inputs, or "
            "measure what disturbs the output as a further input."
        )
    elif small:
        text = f"It explains {fit_percent:.0f} % of the output, the rest is noise or disturbance."
    else:
        text = "The residual tests do not contradict it."
    if worse_than_mean:
        text += (
            " The held-out part does not confirm it: worse than the mean there "
            f"({more['held_out_percent']:.1f} %)."
        )
    name = f"Recommended: {subject}"
    if troubles or worse_than_mean or all_disturbance or follows_input:
        name = f"Provisionally {subject}"
    return f"{name}. {why} {text}{_but_first(troubles, option)}"


# ---- residuals and validation


def _coloured_residuals(
    subject: str, p_white: float, p_input: float, noise_model: bool, option: Spelling, **_: Any
) -> str:
    """Message of ``residuals.coloured``.

    ``p_white`` is the p-value of the Ljung-Box test, ``p_input`` that of the correlation with the
    input. ``noise_model``: the fit has coloured noise already.
    """
    if noise_model:
        remedy = "Try a noise model of higher order, or one more lag."
    else:
        remedy = (
            "Intervals are the robust ones; try one more lag, and if the residuals stay coloured, "
            f"{option('noise', 'arma')} or {option('baseline', 'walk')}."
        )
    return (
        f"Residuals of {subject} are coloured (Ljung-Box {_p_value(p_white)}), by disturbances or "
        "by dynamics; below their level the test cannot detect a response to the input "
        f"({_p_value(p_input)}). {remedy}"
    )


def _residuals_follow_input(
    subject: str, fit_percent: float, p_input: float, lag_s: float, input: str = "", **_: Any
) -> str:
    """Message of ``residuals.follow_input``.

    ``p_input`` is the p-value of the correlation with the input, which is largest at ``lag_s``;
    ``input`` is named where there are several.
    """
    which = f"input {input}" if input else "input"
    return (
        f"{subject} misses dynamics although it explains {fit_percent:.1f} % of the output: its "
        f"residuals still follow the {which} ({_p_value(p_input)}, most at a lag of {lag_s:.3g} "
        "s); try another lag, a zero or a dead time."
    )


def _white_residuals(subject: str, p_white: float, p_input: float, **_: Any) -> str:
    """Message of ``residuals.white``.

    ``p_white`` is the p-value of the Ljung-Box test, ``p_input`` that of the correlation with the
    input.
    """
    return (
        f"Residuals of {subject} are white (Ljung-Box {_p_value(p_white)}) and not correlated with "
        f"the input ({_p_value(p_input)}): this record does not contradict the model."
    )


def _spikes(count: int, robust: bool, option: Spelling, **_: Any) -> str:
    """Message of ``residuals.spikes``.

    ``robust``: the fit used a robust loss.
    """
    text = "1 sample is an outlier" if count == 1 else f"{count} samples are outliers"
    if robust:
        return f"{text}, down-weighted by the robust loss."
    return f"{text} (spikes); fit with {option('loss', 'huber')}."


def _uncertainty_not_given(share: float, floor: float, **_: Any) -> str:
    """Message of ``response.unstated``.

    ``share`` is the estimated standard uncertainty over the magnitude of the response, ``floor`` a
    constant one that is added in squares; 0 without one.
    """
    text = (
        "No uncertainty was given: the residuals correspond to "
        f"{100 * share:.2g} % of the magnitude"
    )
    if floor:
        text += f" above a floor of {floor:.2g}"
    return f"{text}."


# ---- records


def _hold(subject: str, step: float, hold: str, half_s: float, option: Spelling, **_: Any) -> str:
    """Message of ``record.hold``.

    ``step`` is the least step of the input, ``half_s`` half a sampling interval.
    """
    return (
        f"Input {subject} moves by its least step of {step:.3g} only: either it was set in equal "
        "steps, or it was measured and rounded to them; the data look the same in both cases. It "
        f"is taken as {hold}; if that is wrong, the dead time is wrong by half a sample, "
        f"{half_s:.3g} s: give {option('hold', 'zoh')} if it was set, {option('hold', 'foh')} if "
        "it was measured."
    )


def _noisy_levels(subject: str, dt_s: float, option: Spelling, **_: Any) -> str:
    """Message of ``record.noisy_levels``."""
    return (
        f"Input {subject} has constant levels with noise, and changes from row to row, like the "
        "measured power of a heater that was set. It is taken as held (zoh), and its changes as "
        "made at the rows that show them first. If they were made between the rows, the dead time "
        f"is too short by up to a sampling interval, {dt_s:.3g} s; give {option('hold', 'foh')} if "
        "the input changed gradually."
    )


def _slow_pole(subject: str, slowest_s: float, longest_s: float, option: Spelling, **_: Any) -> str:
    """Message of ``fit.slow_pole``.

    ``slowest_s`` is the largest time constant, ``longest_s`` the length of the record.
    """
    text = (
        f"the response to {subject} has a time constant of {slowest_s:.3g} s, in a record of "
        f"{longest_s:.3g} s: gain and lag are extrapolated; record longer constant levels of the "
        "input"
    )
    if slowest_s > longest_s:
        text += (
            f"; or, if the plant integrates, fit {option('model', 'P1I')} with "
            f"{option('baseline', 'trend')}"
        )
    return text


def _slow_input(subject: str, interval_s: float, option: Spelling, **_: Any) -> str:
    """Message of ``record.slow_input``; ``interval_s`` is that of new values."""
    return (
        f"Input {subject} changes every {interval_s:.3g} s, by small steps: either it was set so, "
        "or it was measured and repeated until the next value; the data look the same in both "
        f"cases. It is taken as set; if it was measured, the dead time is wrong by half of that "
        f"interval, {interval_s / 2:.3g} s: give {option('hold', 'foh')}, and "
        f"{option('hold', 'zoh')} if it was set."
    )


def _other_hold(
    subject: str,
    hold: str,
    holds: Sequence[str],
    bic: float | None,
    half_s: float,
    option: Spelling,
    **_: Any,
) -> str:
    """Message of ``record.other_hold``.

    ``hold`` is the one that was used, ``holds`` those of all inputs to try instead. ``bic`` is the
    decrease of BIC with the other hold, None where the samples alone show it.
    """
    kinds = {"zoh": "held between its samples (zoh)", "foh": "a straight line (foh)"}
    if bic is None:
        evidence = "but it stays constant and jumps, as if a computer had set it"
    else:
        evidence = f"but the other hold fits decisively better (BIC lower by {bic:.0f})"
    return (
        f"Input {subject} is taken as {kinds[hold]}, {evidence}. A wrong hold shifts the dead time "
        f"by half a sample, {half_s:.3g} s: check how the input was logged, or give "
        f"{option('hold', ','.join(holds))}."
    )


def _gaps(count: int, **_: Any) -> str:
    """Message of ``record.gaps``.

    ``count`` is the number of gaps.
    """
    gaps = count_with_noun(count, "gap")
    return f"After {gaps} of the input the state was estimated again."


def _off_equilibrium(off: float, times_rms: float, option: Spelling, **_: Any) -> str:
    """Message of ``record.off_equilibrium``.

    ``off`` is the distance of the first output from its equilibrium, ``times_rms`` that over the
    rms of the residuals.
    """
    return (
        f"A run starts {off:.3g} off the equilibrium that was assumed, {times_rms:.0f} times the "
        f"rms: fit with {option('initial', 'estimated')}."
    )


def _drift(correlation: float, option: Spelling, **_: Any) -> str:
    """Message of ``record.drift``.

    ``correlation`` is that of the residuals with time.
    """
    return (
        f"The residuals drift (correlation with time {correlation:.2f}): fit with "
        f"{option('baseline', 'trend')}."
    )


def _feedback(p: float, **_: Any) -> str:
    """Message of ``record.feedback``.

    ``p`` is the p-value of the correlation with the future input.
    """
    return (
        f"The residuals are correlated with the future input ({_p_value(p)}) and not with the past "
        "input: the input depends on the output (feedback, a closed loop, which biases the fit), "
        "or the two are not sampled at the same instants."
    )


def _nonlinear(
    p: float, gain_percent: float, lag_percent: float, unexplained_percent: float, **_: Any
) -> str:
    """Message of ``record.nonlinear``.

    Parameters
    ----------
    p
        Chance of such residuals from a linear plant.
    gain_percent, lag_percent
        Changes of the gain over the range of the output, and of the lag over it or between rise and
        fall [%]; 0 where small.
    unexplained_percent
        Residuals over the range of the output [%].
    """
    changes = []
    if gain_percent:
        changes.append(f"the gain changes by about {gain_percent:.2g} % over the range")
    if lag_percent:
        changes.append(f"the lags of rise and fall, or of both ends, differ by {lag_percent:.2g} %")
    if not changes:
        changes.append("gain or lag change with the level")
    return (
        f"The output does not follow the input linearly (p = {p:.1g}): {' and '.join(changes)}, "
        f"and {unexplained_percent:.2g} % of the range is left unexplained. Gain and lag are "
        "averages over the levels of this record, and their intervals are those of the averages."
    )


def _changing(
    p: float, gain_percent: float, lag_percent: float, unexplained_percent: float, **_: Any
) -> str:
    """Message of ``record.changing``.

    Parameters
    ----------
    p
        Chance of such residuals from a plant that stays the same.
    gain_percent, lag_percent
        Changes of gain and lag in the course of the record [%]; 0 where small.
    unexplained_percent
        Residuals over the range of the output [%].
    """
    names = (("gain", gain_percent), ("lag", lag_percent))
    changes = [f"the {name} by about {percent:.2g} %" for name, percent in names if percent]
    text = f": {' and '.join(changes)}" if changes else ""
    return (
        f"The response changes in the course of the record (p = {p:.1g}){text}, and "
        f"{unexplained_percent:.2g} % of the range is left unexplained. Gain and lag are averages "
        "over this record, and their intervals are those of the averages."
    )


def _clock_drift(
    subject: str,
    input: str,
    rate_ppm: float,
    u_ppm: float,
    change_s: float,
    factor: float,
    **_: Any,
) -> str:
    """Message of ``record.clock_drift``.

    Parameters
    ----------
    subject, input
        Names of the output and of the inputs.
    rate_ppm, u_ppm
        Rate of the delay and its standard uncertainty [ppm].
    change_s
        Change of the delay over the record [s].
    factor
        One plus the rate.
    """
    return (
        f"The delay of {subject} behind {input} changes by {change_s:+.3g} s over the record "
        f"({rate_ppm:+.4g} +- {u_ppm:.2g} ppm), as where two loggers have clocks of different "
        "rate: the dead time is its mean, and the intervals do not include its change. If the "
        f"columns come from two clocks, multiply the time of the logger of {input} by "
        f"{factor:.7g} and join the tables anew. A dead time of the plant that drifts looks the "
        "same."
    )


# tcdyn/identification
IDENTIFY: dict[str, Message] = {
    "models.why": _reason,
    "models.foresees": _better_prediction,
    "models.none": _no_model,
    "models.unrelated": "The output is unrelated to the input: no model describes it better than a "
    "constant output. Check that the right columns were taken, and that the input moves enough to "
    "be seen above the noise of the output.",
    "models.undetermined": _undetermined,
    "models.integrator": _integrator_or_lag,
    "models.provisional": _recommendation,
    "models.recommended": _recommendation,
    "record.one_frequency": "The input {subject} is a sine of {period_s:.3g} s in the steady "
    "state: the record determines amplitude and phase at this period only.",
    "record.inseparable": "The input {subject} is a combination of the other inputs ({percent:.2g} "
    "% of its variance is its own): the record does not separate their effects.",
    "record.clipped": "{count} samples of the output are clipped (equal to its largest or smallest "
    "value) and were left out.",
    "model.without_sensor": "The model is the plant without the sensor of {subject}, whose lag is "
    "{lag_s:.4g} +- {u_s:.2g} s.",
    "fit.bound": "{subject} ended on its {end} bound ({value:.3g}): the data do not determine it",
    "fit.twin": "{subject} equals another lag: only their sum is determined; complex poles (U) may "
    "fit better",
    "fit.undetermined": "{subject} is hardly determined by these data (u = {u:.2g} for "
    "{value:.2g})",
    "fit.lag_unbounded": "{subject} has a standard uncertainty of {u:.2g} s, more than the length "
    "of the record ({longest_s:.3g} s): the record does not determine it",
    "fit.prior_conflict": "the prior of {subject}, {mean:.4g} +- {u:.2g}, contradicts the data (by "
    "{ratio:.2g} standard uncertainties): the estimate, {value:.4g}, lies between them, and its "
    "interval is too short",
    "fit.slow_pole": _slow_pole,
    "fit.indistinct": "the data cannot separate all parameters of {subject}: some intervals are "
    "meaningless",
    "fit.stalled": "the fit stopped after the allowed number of iterations; check the intervals "
    "before using it",
    "fit.open_interval": "the interval of {subject} is open: it reaches the search bound "
    "({low95:.3g}..{high95:.3g})",
    "residuals.rounding": "{subject} reproduces every reading to within the rounding of the "
    "output: no residual test is possible.",
    "residuals.follow_input": _residuals_follow_input,
    "residuals.coloured": _coloured_residuals,
    "residuals.white": _white_residuals,
    "residuals.spikes": _spikes,
    "validation.moved": "These data give other parameters of {subject} than those of the fit, by "
    "more than both uncertainties (p = {p:.2g}): the system, or its disturbance, is not the same.",
    "response.unit_assumed": "The header does not state all units: {subject} assumed.",
    "response.unstated": _uncertainty_not_given,
    "response.systematic": "{subject} leaves residuals that run systematically over the frequency "
    "(p = {p:.1g}): dynamics are missing, a unit is wrong, or neighbouring frequencies have errors "
    "in common; the intervals are too short.",
    "response.poor_fit": "{subject} describes the response badly (fit {fit_percent:.2g} %, 100 % "
    "is perfect and 0 % as bad as a constant): check the units of frequency, phase and magnitude, "
    "and the columns; do not use the estimates otherwise.",
    "response.misfit": "{subject} leaves {ratio:.2g} times the stated uncertainty (p = {p:.1g}): "
    "dynamics are missing, or the uncertainty was stated too small; the intervals were widened by "
    "this factor.",
    "record.hold": _hold,
    "record.noisy_levels": _noisy_levels,
    "record.slow_input": _slow_input,
    "record.other_hold": _other_hold,
    "record.nonlinear": _nonlinear,
    "record.changing": _changing,
    "record.clock_drift": _clock_drift,
    "record.slow_sampling": "The sampling interval of {dt_s:.3g} s is long compared with the "
    "lag of {lag_s:.3g} s behind {subject}: other structures fit the samples as well and have "
    "other lags, which the intervals of lag and dead time do not include; log every "
    "{needed_s:.2g} s or faster.",
    "record.gaps": _gaps,
    "record.off_equilibrium": _off_equilibrium,
    "record.drift": _drift,
    "record.coarse": "The output changes in steps of {step:.3g}, the residuals' rms is {rms:.2g}: "
    "the intervals include the rounding, which the tests cannot separate from dynamics.",
    "record.closed_loop": "The input {subject} follows the output {output}: it is computed from it "
    "(closed loop). The model may be minus the inverse of the controller: record with the loop "
    "open, or add a larger test signal to the input.",
    "record.thermostat": "The input {subject} is switched by the output {output}, as by a "
    "thermostat (closed loop): off near {off_at:.4g} and on near {on_at:.4g}, however long that "
    "takes. Noise and disturbances of the output then move the input, and the model may be biased: "
    "switch by hand or by a timer with unequal on and off times.",
    "record.feedback": _feedback,
}
