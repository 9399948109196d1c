"""What is said of identified models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tcdyn.core.messages.phrases import Message, count_with_noun
from tcdyn.core.spelling import Spelling

# tcdyn/identify


def chance(p: float) -> str:
    """A p value as people read it.

    >>> chance(0.25), chance(3e-5), chance(0.0)
    ('p = 0.25', 'p = 3e-05', 'p < 1e-99')
    """
    return f"p = {p:.2f}" if p >= 0.01 else f"p = {p:.0e}" if p > 1e-99 else "p < 1e-99"


def _coloured_residuals(
    subject: str, p_white: float, p_input: float, noise_model: bool, option: Spelling, **_: Any
) -> str:
    remedy = (
        "Intervals are the robust ones; try one lag more, and if the colour stays, "
        f"{option('noise', 'arma')} or {option('baseline', 'walk')}."
    )
    if noise_model:
        remedy = "Try a noise model of higher order, or one lag more."
    return (
        f"Residuals of {subject} are coloured (Ljung-Box {chance(p_white)}), by disturbances or by dynamics; whatever "
        f"of the input lies beneath that colour, the test cannot see ({chance(p_input)}). {remedy}"
    )


def _spikes(count: int, robust: bool, option: Spelling, **_: Any) -> str:
    remedy = ", held down by the robust loss" if robust else f"; fit with {option('loss', 'huber')}"
    return f"{count} sample{'s stand' if count > 1 else ' stands'} out as spikes{remedy}."


FREED = " As a run starts off the equilibrium, the state at each start was estimated."


def _why(
    subject: str,
    other: str,
    by: str,
    rms: float,
    other_rms: float,
    only: bool,
    least: bool,
    **more: Any,
) -> str:
    said = f"{subject} has the lowest {by}"
    if by == "parameters":
        said = f"{subject} has fewer parameters than {other} and a BIC within 2 of it"
    if by == "held out":
        said = (
            f"{subject} simulates the held-out part better ({rms:.4g} against {other_rms:.4g} rms) than {other}, which "
            "has the lower BIC"
        )
    elif not only:
        said += f" and simulates the held-out part to {rms:.4g} rms" + (
            ", the least of all" if least else ""
        )
    if more["ties"]:
        said += f"; {' and '.join(more['ties'])} within 2 of its BIC would do as well"
    for group, one, several, rest in (
        (
            "undetermined",
            "would score better but is",
            "would score better but are",
            "not determined by these data",
        ),
        ("missing", "would score better but misses", "would score better but miss", "dynamics"),
        (
            "refused",
            "has",
            "have",
            "a lower one that is of the residuals' colour, or not seen in the held-out part",
        ),
        ("pairs", "is", "are", "left out, for the pair does not oscillate and is two lags"),
    ):
        if names := more.get(group):
            said += f"; {', '.join(names)} {several if len(names) > 1 else one} {rest}"
    return f"{said}." + (FREED if more.get("freed") else "") + _disturbance(**more)


def _foresees(subject: str, other: str, ratio: float, white: bool, freed: bool, **_: Any) -> str:
    said = (
        f"{subject} simulates data kept from the fit to {100 * ratio:.0f} % of the error of {other}"
    )
    said += ", and leaves white residuals" if white else ""
    return f"{said}." + (FREED if freed else "")


def _disturbance(
    order: Sequence[int] = (0, 0),
    baseline: str = "none",
    memory_s: float | None = None,
    p_walk: float | None = None,
    **_: Any,
) -> str:
    if p_walk is not None:
        likeliest = (
            "a random walk"
            if memory_s is None
            else f"one of {memory_s:.2g} s"
            if memory_s
            else "none"
        )
        return (
            " The answer is averaged over what may disturb the output beside white noise: a first-order disturbance "
            f"of any time constant up to a random walk, with a straight drift or without (likeliest {likeliest}; that "
            f"it outlasts the record has the probability {p_walk:.2g}, and makes the intervals as wide)."
        )
    drift = {"trend": "a straight drift", "walk": "a random walk"}.get(baseline)
    noise = f"ARMA({order[0]}, {order[1]}) noise" if any(order) else ""
    if baseline == "walk":
        noise = {(0, 1): "white noise", (0, 0): ""}.get(
            (order[0], order[1]), f"ARMA({order[0]}, {order[1]}) steps"
        )
    said = " with ".join(part for part in (drift, noise) if part)
    return f" What disturbs the output is modelled as {said}." if said else ""


def _remedies(troubles: Sequence[str], option: Spelling) -> list[str]:
    """What to do about the record from which a model was to be identified, for each code in ``troubles``."""
    remedies = {
        "record.off_equilibrium": f"let the runs start off equilibrium ({option('initial', 'estimated')})",
        "record.drift": f"fit with {option('baseline', 'trend')}",
        "record.coarse": "log the output in finer steps",
        "record.closed_loop": "record with the loop open, for the input is computed from the output",
        "model.at_once": "see whether the input is computed from the output (a closed loop): this model answers its "
        "input at once, and with the opposite sign or without a static gain, as minus the inverse of a controller does",
        "record.feedback": "see whether the input answers the output (a closed loop)",
    }
    return [remedies[code] for code in troubles]


OBJECTIONS = {
    "dynamics": "the residuals of every one that the data determine still follow the input",
    "held out": "on data that it has not seen the best of them does worse than their mean",
    "colour": "the best of them repeats only {fit_percent:.0f} % of the output, and the rest is no white noise",
}


def _none(
    subject: str,
    why: str,
    against: str,
    fit_percent: float,
    untried: list[str],
    troubles: list[str],
    option: Spelling,
    **more: Any,
) -> str:
    first = _remedies(troubles, option)
    if untried:
        first.append(f"compare others ({option('models', ','.join(untried))})")
    else:
        first.append(f"ask {option('narx', True)} whether it is linear")
    repeats = (
        f" It repeats the held-out part to {more['held_out_percent']:.1f} %."
        if "held_out_percent" in more
        else ""
    )
    return (
        f"None of these models is good enough: {OBJECTIONS[against].format(fit_percent=fit_percent)}. Do not trust the "
        f"intervals below. The least bad is {subject}. {why}{repeats} Next, {', and '.join(first)}."
    )


def _but_first(troubles: list[str], option: Spelling) -> str:
    return f" But first {', and '.join(_remedies(troubles, option))}." if troubles else ""


def _undetermined(
    subject: str, why: str, remark: str, troubles: list[str], option: Spelling, **_: Any
) -> str:
    return (
        f"Use {subject} with care. {why} But {remark}: excite the input more, or hold what is known "
        f"({option('gain', 'K')}).{_but_first(troubles, option)}"
    )


def _use(
    subject: str,
    why: str,
    coloured: bool,
    small: bool,
    worse_than_mean: bool,
    fit_percent: float,
    troubles: list[str],
    option: Spelling,
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
    return f"{name}. {why} {said}{_but_first(troubles, option)}"


IDENTIFY: dict[str, Message] = {
    "models.why": _why,
    "models.foresees": _foresees,
    "models.none": _none,
    "models.undetermined": _undetermined,
    "models.provisional": _use,
    "models.recommended": _use,
    "fit.bound": "{subject} ended on its {end} bound ({value:.3g}): the data do not ask for it",
    "fit.twin": "{subject} equals another lag: only their sum is determined; complex poles (U) may fit better",
    "fit.undetermined": "{subject} is hardly determined by these data (u = {u:.2g} for {value:.2g})",
    "fit.lag_unbounded": "{subject} has a standard uncertainty of {u:.2g} s, more than the record lasts "
    "({longest_s:.3g} s): the record does not determine it",
    "fit.indistinct": "the data cannot tell all parameters of {subject} apart: some intervals are meaningless",
    "fit.stalled": "stopped after the allowed iterations; look at the intervals before using it",
    "fit.open_interval": "the interval of {subject} is open: it reaches the search bound ({low95:.3g}..{high95:.3g})",
    "residuals.rounding": "{subject} repeats every reading to within half a step of the output's rounding: no test can "
    "say more.",
    "residuals.follow_input": lambda subject, fit_percent, p_input, lag_s, input="", **_: (
        f"{subject} misses dynamics although it fits {fit_percent:.1f} %: its residuals still follow the input "
        f"{input and input + ' '}({chance(p_input)}, most at a lag of {lag_s:.3g} s); try another lag, a zero or a "
        "dead time."
    ),
    "residuals.coloured": _coloured_residuals,
    "residuals.white": lambda subject, p_white, p_input, **_: (
        f"Residuals of {subject} are white (Ljung-Box {chance(p_white)}) and unrelated to the input "
        f"({chance(p_input)}): this record holds nothing against the model."
    ),
    "residuals.spikes": _spikes,
    "validation.moved": "These data ask for other parameters of {subject} than those it was fitted to, by more than "
    "both uncertainties (p = {p:.2g}): the system, or its disturbance, is not the same.",
    "response.unstated": lambda share, floor, **_: (
        f"No uncertainty was stated: as the residuals are, {100 * share:.2g} % of the magnitude"
        f"{f' above a floor of {floor:.2g}' if floor else ''}."
    ),
    "response.misfit": "{subject} leaves {ratio:.2g} times the stated uncertainty (p = {p:.1g}): dynamics are missing, "
    "or it was stated too small; the intervals are as much wider.",
    "record.codes": "Column {subject}: {count} reading(s) are overload or drop-out codes; taken as missing: check the "
    "wiring.",
    "record.hold": lambda subject, step, hold, half_s, option, **_: (
        f"Input {subject} moves by its least step of {step:.3g} only: set in equal steps, or measured and rounded to "
        f"them, which look alike. It is taken as {hold}, and the other way round the dead time is wrong by half a "
        f"sample, {half_s:.3g} s: give {option('hold', 'zoh')} if it was set, {option('hold', 'foh')} if it was "
        "measured."
    ),
    "record.gaps": lambda count, **_: (
        f"After {count_with_noun(count, 'gap')} of the input the state was estimated anew."
    ),
    "record.off_equilibrium": lambda off, times_rms, option, **_: (
        f"A run starts {off:.3g} off the equilibrium that was assumed, {times_rms:.0f} times the rms: fit with "
        f"{option('initial', 'estimated')}."
    ),
    "record.drift": lambda correlation, option, **_: (
        f"The residuals drift (correlation with time {correlation:.2f}): fit with {option('baseline', 'trend')}."
    ),
    "record.coarse": "The output moves in steps of {step:.3g}, the residuals' rms is {rms:.2g}: the intervals include "
    "the rounding, which the tests cannot tell from dynamics.",
    "record.closed_loop": "The input {subject} follows the output {output}: it is computed from it (closed loop). The "
    "model may be minus the inverse of the controller: record with the loop open, or add a larger test signal to the "
    "input.",
    "record.feedback": lambda p, **_: (
        f"They tell of the input still to come ({chance(p)}) and not of the past one: the input answers the output "
        "(feedback, a closed loop, which biases the fit), or the two are not sampled at the same instants."
    ),
}
