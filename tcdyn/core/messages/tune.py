"""Messages about settings of controllers.

A function here makes the text of one finding whose wording depends on its numbers; its arguments
are the fields of the finding (see ``tcdyn.core.messages``). Tests:
``tests/tuning/test_tune_findings.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tcdyn.core.errors import Spelling
from tcdyn.core.messages.phrases import Message


def _slower(rule: str, slower_s: float | None, option: Spelling) -> str:
    """What makes a loop more robust, by its rule.

    Parameters
    ----------
    rule
        "simc" or "robust".
    slower_s
        A longer time constant of the closed loop [s], of SIMC.
    option
        Spelling of a parameter.
    """
    if rule == "robust" or slower_s is None:
        return f"a smaller limit, such as {option('max_ms', '1.2')}"
    return f"a slower loop, such as {option('tau_c_s', f'{slower_s:.3g}')}"


def _unstable_model(
    subject: str, rule: str, slower_s: float | None, option: Spelling, **_: Any
) -> str:
    """Message of ``tune.unstable_model``."""
    return (
        f"the loop of {subject} is unstable with the model itself: do not use these settings. Use "
        f"{_slower(rule, slower_s, option)}, or a shorter sampling interval of the controller."
    )


def _unstable(
    subject: str, rule: str, percent: float, slower_s: float | None, option: Spelling, **_: Any
) -> str:
    """Message of ``tune.unstable``; ``percent`` is the share of unstable draws."""
    return (
        f"the loop of {subject} is unstable in {percent:.2g} % of the models that the record "
        "permits: do not use these settings. Identify the model from a record that determines it "
        f"better (larger or more steps of the input), or use {_slower(rule, slower_s, option)}."
    )


def _not_robust(
    subject: str, rule: str, ms: float, slower_s: float | None, option: Spelling, **_: Any
) -> str:
    """Message of ``tune.not_robust``."""
    return (
        f"the loop of {subject} has a largest sensitivity of {ms:.2g} with the model itself (usual "
        f"are 1.2 to 2): a small change of the plant makes it oscillate. Use "
        f"{_slower(rule, slower_s, option)}."
    )


def _undetermined(
    subject: str,
    rule: str,
    high_ms: float,
    percent: float,
    slower_s: float | None,
    option: Spelling,
    **_: Any,
) -> str:
    """Message of ``tune.undetermined``; ``high_ms`` is the 97.5 % quantile of Ms."""
    found = f"reaches a largest sensitivity of {high_ms:.2g} (usual are 1.2 to 2)"
    if percent > 0:
        found = f"is unstable in {percent:.2g} %"
    return (
        f"the record does not determine the settings: over the models that it permits, the loop of "
        f"{subject} {found}. Use {_slower(rule, slower_s, option)}, or identify the model from a "
        "record that determines it better (larger or more steps of the input)."
    )


def _model(subject: str, troubles: Sequence[str], **_: Any) -> str:
    """Message of ``tune.model``; ``troubles`` are the messages of the model's findings."""
    listed = "; ".join(text.rstrip(".") for text in troubles)
    return (
        f"the model {subject} is not to be relied on, and the ranges do not include its error: "
        f"{listed}."
    )


def _no_dead_time(
    subject: str, dead_time_s: float, dt_s: float, ratio: float, option: Spelling, **_: Any
) -> str:
    """Message of ``tune.no_dead_time``; ``ratio`` is the lag over ``dt_s``."""
    return (
        f"{subject} has an effective dead time of {dead_time_s:.3g} s, which its record, with a "
        f"sample every {dt_s:.3g} s, does not show: the time constant of the closed loop is set to "
        f"{dt_s:.3g} s, which is {ratio:.3g} times shorter than the lag of the model. Give a "
        f"longer one with {option('tau_c_s', None)} unless the actuator is strong enough for that."
    )


def _derivative(subject: str, tau2_s: float, dead_time_s: float, option: Spelling, **_: Any) -> str:
    """Message of ``tune.derivative``."""
    return (
        f"the second lag of {subject}, {tau2_s:.3g} s, exceeds its dead time, {dead_time_s:.3g} s: "
        f"a derivative permits a faster loop ({option('controller', 'pid')})"
    )


# tcdyn/tuning
TUNE: dict[str, Message] = {
    "tune.unstable_model": _unstable_model,
    "tune.unstable": _unstable,
    "tune.not_robust": _not_robust,
    "tune.undetermined": _undetermined,
    "tune.model": _model,
    "tune.slow_sampling": "the controller of {subject} samples every {sample_s:.3g} s, and the "
    "output rises within {rise_s:.3g} s: sample every {needed_s:.2g} s or faster, or make the loop "
    "slower",
    "tune.no_dead_time": _no_dead_time,
    "tune.derivative": _derivative,
    "tune.no_distribution": "{subject} has no uncertainty: margins are those of the model alone",
    "tune.reading": "the model contains the sensor of {subject}: the loop controls the reading, "
    "and a change of what is measured shows in it with the lag of the sensor",
}
