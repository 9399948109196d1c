"""Messages about campaigns: outlying tests, the speed law, junction depths, model curves.

A function here makes the text of one finding whose wording depends on its numbers; its arguments
are the fields of the finding (see ``tcdyn.core.messages``). Wording may be changed freely; codes,
names of fields and what a message advises must fit the place that makes the finding.
``tests/core/test_findings.py`` checks that each code is made somewhere and each code that is made
has a message.
"""

from __future__ import annotations

from collections.abc import Sequence

from tcdyn.core.estimate import rounded_texts, text_with_u
from tcdyn.core.messages.phrases import Message, count_with_noun

# p-values below it are not printed: the normal distribution of the errors is not known to hold
# that far out (chosen by judgement)
LEAST_P = 1e-12


def _cause(cause: str, size: float, u: float) -> str:
    """Condition under which a test would agree with all others: one departure with its size.

    Parameters
    ----------
    cause
        Name of the cause, of ``tcdyn.campaign.outliers.CAUSES`` or "static CHANNEL DISK".
    size
        Size of the departure (relative for friction and half-width, else K or s).
    u
        Its standard uncertainty.

    Examples
    --------
    >>> _cause("friction", 0.05, 0.002), _cause("static e slow", -0.6, 0.1)
    ('its friction reads (5.00 +- 0.20) % low', 'slow_e is offset by (-0.60 +- 0.10) K')
    """
    kind, _, target = cause.partition(" ")
    if kind == "friction":
        value, spread = rounded_texts(100 * abs(size), 100 * u)
        direction = "low" if size > 0 else "high"
        return f"its friction reads ({value} +- {spread}) % {direction}"
    if kind == "half-width":
        value, spread = rounded_texts(100 * size, 100 * u)
        return f"the half-width of the contact differs by ({value} +- {spread}) % from Hertz's"
    value, spread = rounded_texts(size, u)
    if kind == "ambient":
        return f"its ambient temperature is offset by ({value} +- {spread}) K"
    if kind == "parting":
        return f"its instant of unloading is ({value} +- {spread}) s off"
    if kind == "lag":
        return f"the lag of the {target} disk is ({value} +- {spread}) s longer"
    channel, _, disk = target.partition(" ")
    return f"{disk}_{channel} is offset by ({value} +- {spread}) K"


def _p_value(p: float) -> str:
    """Text of a p-value; a tiny one by its bound.

    >>> _p_value(0.0234), _p_value(0.0)
    ('p = 0.023', 'p below 1e-12')
    """
    return f"p = {p:.2g}" if p > LEAST_P else f"p below {LEAST_P:g}"


def _outlying_test(
    subject: str,
    cause: str,
    size: float,
    u: float,
    z: float,
    chi2: float,
    left: float,
    freedom: int,
    explained: bool,
    **_: object,
) -> str:
    """Message of ``campaign.stranger``.

    ``cause`` is the departure that explains most, with its ``size``, standard uncertainty ``u`` and
    ``z = size / u``. ``chi2`` is that of the test against all others on ``freedom`` degrees of
    freedom, ``left`` what remains of it with the cause.
    """
    effect = "agree" if explained else f"agree better (chi-squared {left:.0f})"
    return (
        f"{subject} does not agree with the other tests of its campaign: chi-squared is "
        f"{chi2:.0f} on {freedom} degrees of freedom; it would {effect} if "
        f"{_cause(cause, size, u)} ({abs(z):.0f} standard deviations). The results of the campaign "
        "do not include it"
    )


def _curve_shape(
    subject: str,
    chi2: float,
    freedom: int,
    p: float,
    scatter: float,
    offset: float,
    u: float,
    **_: object,
) -> str:
    """Message of ``campaign.curve_shape``.

    ``offset`` is the mean difference of the tests from the curve, with ``u``; ``scatter`` is the
    standard deviation that was added to every test.
    """
    return (
        f"the shape of the curve in {subject} does not fit the tests: with its level free "
        f"chi-squared is {chi2:.1f} on {count_with_noun(freedom, 'degree')} of freedom "
        f"({_p_value(p)}). For the offset of the tests from it, {text_with_u(offset, u)}, an "
        f"independent scatter of {scatter:.2g} was added to every test: check the curve, and do "
        "not use one offset for all tests"
    )


def _contradicted(
    chi2: float,
    freedom: float,
    p: float,
    factor: float,
    names: Sequence[str],
    sizes: Sequence[float],
    **_: object,
) -> str:
    """Message of ``campaign.contradicted``.

    ``factor`` multiplies the shared uncertainties (the root of Birge's ratio). ``names`` are the
    stated values that depart most, ``sizes`` their departures in stated standard uncertainties.
    """
    departures = ", ".join(f"{name} ({size:+.1f})" for name, size in zip(names, sizes))
    return (
        f"the tests together contradict what is stated about the rig: chi-squared is {chi2:.0f} on "
        f"{freedom:.0f} degrees of freedom ({_p_value(p)}). The uncertainties of what the tests "
        f"share are {factor:.2f} times as large for it, so that a result may be less certain than "
        f"that of its test alone. Largest departures in stated standard uncertainties: {departures}"
    )


def _simulated(names: Sequence[str], tests: int, **_: object) -> str:
    """Message of ``campaign.simulated``.

    ``names`` are those of the ``tests`` logs whose metadata say that they are simulated.
    """
    if len(names) == tests == 1:
        return "the log is simulated: its metadata say so"
    if len(names) == tests:
        return f"all {tests} logs are simulated: their metadata say so"
    return f"{len(names)} of {tests} logs are simulated: their metadata say so ({', '.join(names)})"


# tcdyn/campaign
CAMPAIGN: dict[str, Message] = {
    "campaign.stranger": _outlying_test,
    "campaign.exponent": "{tests} tests together give the exponent of the speed law n = {n:.3f} +- "
    "{u:.3f}; rig.toml assumes {assumed:.3f}: you may set speed_exponent in its [contact] to the "
    "new value",
    "campaign.power_law": "one power of the speed does not describe h: n changes by "
    "{per_doubled:.3f} +- {u:.3f} when the speed doubles (p = {p:.2g})",
    "campaign.junction": "by all tests together {subject} is {deeper_mm:.2f} +- {u_mm:.2f} mm "
    "deeper than stated ({z:.1f} standard deviations): check its depth_mm in rig.toml",
    "campaign.curve_shape": _curve_shape,
    "campaign.contradicted": _contradicted,
    "campaign.apart": "{subject} is not solved together with the other tests: {why}",
    "campaign.simulated": _simulated,
    "campaign.withheld": "{subject}: {why}",
    "campaign.altered": "{subject} in the results folder was changed after tcdyn wrote it: its log "
    "was analysed again",
    "campaign.version_0_2": "version 0.2 analysed this test, without {keys} of rig.toml: that "
    "uncertainty is not in its result. To include it, analyse its log again.",
    "campaign.repeated": "{text} (in {first}; so or nearly so in {others})",
}
