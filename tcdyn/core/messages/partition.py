"""Messages about the heat partition: events, channels, estimates of beta and their cross-check.

A function here makes the text of one finding whose wording depends on its numbers; its arguments
are the fields of the finding (see ``tcdyn.core.messages``). Wording may be changed freely; codes,
names of fields and what a message advises must fit the place that makes the finding.
``tests/core/test_findings.py`` checks that each code is made somewhere and each code that is made
has a message.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tcdyn.core.estimate import Estimate, text_with_u
from tcdyn.core.messages.phrases import Message, count_with_noun, text_rounded_to_u

# ---- channels, junctions and the rig file

# Text of each kind of wiring or sensor fault, of ``tcdyn.partition.sensor_check``.
SENSOR_FAULTS = {
    "dead": "channel {names} is dead: it rises by {rise_K:.1f} K under load and falls by "
    "{fall_K:.1f} K after unloading, the others by {usual_rise_K:.1f} K and {usual_fall_K:.1f} K",
    "swapped": "channels {names} look swapped",
    "misplaced": "junction {names} looks {mm:.1f} mm {direction} than rig.toml says",
    "late": "channel {names} responds {s:.2f} s {when} than its record says: a bubble in its "
    "cement, or a column shifted in time",
    "offset": "channel {names} reads {size:+.1f} K off: check its unit, static line and reference "
    "junction",
    "unknown": "its junctions do not agree with the rim model (chi-square {chi2:.0f} for {dof} "
    "data), and no single swap, misplacement or offset explains it",
}
# Keys of rig.toml in which it differs from a record that a message lists; the others are counted.
MAX_LISTED_KEYS = 3
# exponent of the speed law: the two disks' difference is significant from this number of standard
# deviations (about 95 %)
EXPONENT_AGREES_Z = 2
# estimates of one disk disagree from this number of standard deviations (99.7 %)
ESTIMATES_DISAGREE_Z = 3


def _rig_differs_from_record(
    subject: str, keys: Sequence[str], record: Sequence[str], rig: Sequence[str], **_: Any
) -> str:
    """Message of ``record.other_disk``.

    ``keys`` are the keys of ``rig.toml`` that differ, ``record`` and ``rig`` their values when the
    record was made and now.
    """
    changes = [f"{key} = {new} (record: {old})" for key, old, new in zip(keys, record, rig)]
    text = (
        f"{subject} disk: rig.toml is used, and is not what the record was made with: "
        f"{', '.join(changes[:MAX_LISTED_KEYS])}"
    )
    if len(changes) > MAX_LISTED_KEYS:
        text += f" and {len(changes) - MAX_LISTED_KEYS} more"
    return text


def _suspected_fault(
    subject: str, kind: str, channels: Sequence[str], log_odds: float | None = None, **n: Any
) -> str:
    """Message of ``sensors.suspect``.

    ``kind`` is a key of ``SENSOR_FAULTS``. ``size`` is that of the fault in metres (deeper),
    seconds (later) or kelvins. ``log_odds`` compares the fault with a sound disk; None where no
    such comparison was made. ``rivals`` are other faults that explain the data about as well.
    """
    if subject == "both":
        fast, slow = (channel.rpartition("_")[2] for channel in channels)
        return (
            f"channels {fast} of the fast disk and {slow} of the slow disk look swapped (log-odds "
            f"{log_odds:.0f} against the best fault of each disk separately)"
        )
    size = n.get("size") or 0.0
    fault = SENSOR_FAULTS[kind].format(
        names=" and ".join(channels),
        mm=abs(size) * 1e3,
        direction=_direction(size),
        s=abs(size),
        when="later" if size > 0 else "earlier",
        **n,
    )
    text = f"{subject} disk: {fault}"
    if log_odds is not None:
        text += f" (log-odds {log_odds:.0f} against a disk without a fault)"
    if n.get("rivals"):
        text += f"; or {', '.join(n['rivals'])}"
    return text


def _direction(deeper: float) -> str:
    """Word for the sign of a depth error."""
    return "deeper" if deeper > 0 else "nearer the surface"


def _no_fault(subject: str, illogical: int, pairs: int, blind: Sequence[str], **_: Any) -> str:
    """Message of ``sensors.sound``.

    ``illogical`` of ``pairs`` pairs of junctions have temperatures in the wrong order for their
    depths. ``blind`` are the pairs whose swap the data cannot show.
    """
    text = (
        f"{subject} disk: no swapped, dead, misplaced, late or offset channel found; the order of "
        f"temperatures is wrong in {illogical} of {pairs} pairs"
    )
    if blind:
        text += f"; a swap of {', '.join(blind)} could not be detected"
    return text


def _channel_left_out(
    subject: str, why: str, stand_ins: Sequence[str], kept: Sequence[str], **_: Any
) -> str:
    """Message of ``channel.left_out``.

    ``stand_ins`` are the channels that replace one of the inner row; ``kept`` are the remaining
    channels of the outer row.
    """
    if stand_ins:
        verb = "replaces" if len(stand_ins) == 1 else "replace"
        effect = f"{' and '.join(stand_ins)} {verb} it at the inner edge of the rim"
    else:
        verb = "remains" if len(kept) == 1 else "remain"
        effect = f"of the outer row {' and '.join(kept)} {verb}"
    return f"{subject} is left out: {why}; {effect}, and intervals are wider"


def _angular_harmonic(
    subject: str,
    amplitude_K: float,
    u_K: float,
    angle_deg: float,
    **_: Any,
) -> str:
    """Message of ``unevenness``.

    ``amplitude_K`` is the first circumferential harmonic at the depth of the inner row,
    ``angle_deg`` where it is hottest.
    """
    amplitude = Estimate.normal(amplitude_K, u_K).text("K")
    return (
        f"{subject} disk: its bore contact is uneven: at the depth of the inner row the disk is "
        f"{amplitude} hotter at {angle_deg:.0f} degrees (angles of rig.toml) than on average, and "
        "as much colder on the opposite side; the joint fit estimated this, and it was subtracted "
        "from the readings (section 6.4.3: check press fit and keys)"
    )


# ---- conditions of the test

# Where the air is measured, by the field ``at``.
_AMBIENT_LOCATIONS = {"surface": "running surface", "faces": "side faces"}


def _ambient(
    subject: str,
    at: str,
    mean_degC: float,
    drift_K: float,
    spread_K: float,
    count: int,
    **_: Any,
) -> str:
    """Message of ``ambient.channels``.

    ``at`` is a key of ``_AMBIENT_LOCATIONS``, ``drift_K`` the change of the mean over the 150 s,
    ``spread_K`` the standard deviation between ``count`` channels.
    """
    text = (
        f"air at the {_AMBIENT_LOCATIONS[at]} of the {subject} disk by "
        f"{count_with_noun(count, 'channel')}: {mean_degC:.1f} degC over the last 150 s under "
        f"load, drifting by {drift_K:+.2f} K"
    )
    if count > 1:
        text += f", the channels differ by {spread_K:.2f} K (1 sd)"
    return text


def _power(scale: float, u: float, units: Sequence[str], **_: Any) -> str:
    """Message of ``power.scale``.

    ``scale`` is the power that the disks show over the logged one; ``units`` are the mistaken units
    that would explain it.
    """
    cause = "check load, friction, speeds and their units, and the heat capacity of the steel"
    if units:
        cause = f"most likely: {' or '.join(units)}"
    size = Estimate.normal(scale, u)
    return (
        f"the heat that both disks show is {size} times the logged frictional power F u_s; {cause}"
    )


def _cables_exchanged(
    exponent: float, u: float, assumed: float, beta: float, at_rest: bool, **_: Any
) -> str:
    """Message of ``cables.exchanged``.

    ``exponent`` is the one that the log implies as it is, ``assumed`` that of the speed law.
    ``at_rest``: the readings before the load show the exchange, too.
    """
    text = "the cables of the two disks look exchanged: "
    if at_rest:
        text += (
            "before the load the junctions of each disk agree only with the static lines of the "
            "other disk, and "
        )
    return text + (
        f"the speed exponent is {Estimate.normal(exponent, u)}, but the speed law has "
        f"{assumed:.2f}, as if the fast disk were the slow one; beta would then be near "
        f"{1 - beta:.2f}: map the columns in rig.toml [columns]"
    )


# ---- estimates of beta and their cross-check

JOINT_PARAMETERS = {  # parameter of the joint fit: text and unit
    "beta": ("beta", ""),
    "h": ("h", " W/m2K"),
    "lag_s": ("the lag", " s"),
    "h_fast": ("h of the fast disk", " W/m2K"),
    "h_slow": ("h of the slow disk", " W/m2K"),
    "exponent": ("the exponent", ""),
}


def _profile_interval(
    subject: str, parameter: str, u: float, low95: float | None, high95: float | None, **n: Any
) -> str:
    """Message of ``joint.interval``.

    ``low95`` and ``high95`` are the ends by the profile, None where the data do not bound the
    parameter; it was then examined to ``low_seen`` and ``high_seen``. ``normal_low95`` and
    ``normal_high95`` are the ends by the standard uncertainty ``u``.
    """
    fit = "both disks" if subject == "both" else f"{subject} disk"
    name, unit = JOINT_PARAMETERS[parameter]
    unbounded = []
    if low95 is None:
        unbounded.append(f"from below (examined to {text_rounded_to_u(n['low_seen'], u)}{unit})")
    if high95 is None:
        unbounded.append(f"from above (examined to {text_rounded_to_u(n['high_seen'], u)}{unit})")
    if unbounded:
        return f"Joint fit, {fit}: the data do not bound {name} {' nor '.join(unbounded)}."
    return (
        f"Joint fit, {fit}: the 95 % interval of {name} is {text_rounded_to_u(low95, u)} to "
        f"{text_rounded_to_u(high95, u)}{unit} by its profile, and "
        f"{text_rounded_to_u(n['normal_low95'], u)} to "
        f"{text_rounded_to_u(n['normal_high95'], u)}{unit} by its standard uncertainty."
    )


def _stated_depth(subject: str, channel: str, deeper_mm: float, u_mm: float, **_: Any) -> str:
    """Message of ``stated.depth``.

    ``deeper_mm`` is the estimated depth less the stated one, with ``u_mm``.
    """
    size = Estimate.normal(abs(deeper_mm), u_mm)
    return (
        f"the depth of junction {channel} of the {subject} disk (by this test {size} mm "
        f"{_direction(deeper_mm)} than stated)"
    )


def _stated_value(subject: str, name: str, **_: Any) -> str:
    """Message of ``stated.value``.

    ``name`` is the nuisance parameter, "parting" for the instant of unloading.
    """
    if name == "parting":
        return "the instant of unloading, or the chain's shape (a dead time, a third lag)"
    if name == "heat capacity":  # its product with the rate of change enters the heat equation
        return "heat capacity, or the clock of the log"
    return f"{name} of the {subject} disk" if subject else name


def _stated_exponent(assumed: float, implied: float, u: float, **_: Any) -> str:
    """Message of ``stated.exponent``.

    ``implied`` is the exponent that the two disks give, with its standard uncertainty ``u``.
    """
    estimate = Estimate.normal(implied, u)
    return f"the speed exponent: {assumed:.3f} assumed, {estimate} implied by the two disks"


def _stated_sensors(subject: str, kind: str, columns: Sequence[str], **_: Any) -> str:
    """Message of ``stated.sensors``.

    ``kind`` is the fault, ``columns`` are the channels that it concerns; none for an unknown fault.
    """
    channels = " and ".join(columns) or f"the junctions of the {subject} disk"
    return f"{channels} ({kind})"


def _suspects(suspects: Sequence[str], suspects_z: Sequence[float]) -> str:
    """The suspected stated values with their pulls, as text."""
    return "; ".join(
        f"{suspect} ({z:.1f} standard deviations)" for suspect, z in zip(suspects, suspects_z)
    )


def _usual_suspect(first: str, second: str) -> str:
    """What most often causes a disagreement between two estimates of beta.

    Parameters
    ----------
    first, second
        Names of the estimates, such as "joint fast" or "cooling slow".
    """
    names = {first, second}
    if names == {"joint fast", "joint slow"}:
        return (
            "a junction depth, a static line or the friction scale: the two disks' shares do not "
            "add to one"
        )
    has_cooling = any(name.startswith("cooling") for name in names)
    has_joint = any(name.startswith("joint") for name in names)
    if has_cooling and has_joint:
        return (
            "the chain's lag or the instant of unloading: the fit to compensated temperatures and "
            "the fit to logged ones should give the same"
        )
    if has_cooling:
        return "the lag that was compensated, or the speed exponent"
    return "the speed exponent, or a junction depth"


def _estimates_differ(
    one: str, other: str, apart: float, z: float, suspects: Any, suspects_z: Any, **n: Any
) -> str:
    """Message of ``ways.apart``.

    ``one`` and ``other`` are the estimators that differ most significantly, by ``apart`` and ``z``
    standard deviations. ``suspects`` are the stated values that the data contradict, ``suspects_z``
    their tensions. ``n`` holds the fields of ``_usable``.
    """
    suspected = _suspects(suspects, suspects_z) or _usual_suspect(one, other)
    return (
        f"The estimates of beta do NOT agree: {one} and {other} differ by {apart:.3f}, {z:.1f} "
        f"standard deviations of their difference; suspect {suspected}. {_usable(**n)}"
    )


def _estimates_contradicted(
    low: float, high: float, suspects: Sequence[str], suspects_z: Sequence[float], **n: Any
) -> str:
    """Message of ``ways.contradicted``.

    ``low`` and ``high`` are the smallest and largest estimate of beta; the other fields are those
    of ``_estimates_differ``.
    """
    return (
        f"The estimates of beta agree ({low:.3f} to {high:.3f}), but the data contradict stated "
        f"values: suspect {_suspects(suspects, suspects_z)}. {_usable(**n)}"
    )


def _usable(holds: bool, **n: Any) -> str:
    """Whether the recommended estimate may be used although something does not fit.

    ``holds``: it may. ``n`` holds it as ``both`` with ``both_u``, and its range over all model
    forms, ``low95`` and ``high95``.
    """
    if not holds:
        return "Do NOT trust beta before the cause is found."
    both = Estimate.normal(n["both"], n["both_u"])
    return (
        f"The joint fit of both disks can still be used: beta = {both}, 95 % from "
        f"{n['low95']:.3f} to {n['high95']:.3f} over all other model forms that were tried."
    )


def _estimates_agree(
    one: str, other: str, apart: float, z: float, low: float, high: float, **n: Any
) -> str:
    """Message of ``ways.agree``.

    ``one``, ``other``, ``apart`` and ``z`` are the most significant difference. ``steady`` is beta
    by the speed law. ``strained`` is the stated value with the largest tension ``strained_z``,
    which a share ``chance`` of sound tests exceeds.
    """
    speed_law = ""
    if "steady" in n:
        speed_law = f", speed law {Estimate.normal(n['steady'], n['steady_u'])}"
    text = (
        f"The estimates of beta agree: {low:.3f} to {high:.3f}{speed_law}; the most "
        f"significant difference, {one} against {other}, is {apart:.3f} or {z:.1f} standard "
        "deviations."
    )
    if "strained" in n:
        text += (
            f" The stated value that the data would change most is {n['strained']}: "
            f"{n['strained_z']:.1f} standard deviations, no contradiction (one sound test in "
            f"{1 / n['chance']:.0f} shows as much)."
        )
    return text


ROUND_REASONS = {  # of `tcdyn.partition.fit_rounds`
    "slowing": "the air of the slowing disks follows their speed, at the fitted share and h",
    "harmonic": "the temperature around a disk varies, or rig.toml states its press fit",
}


def _repeated_fits(reason: str, **_: Any) -> str:
    """Message of ``fits.repeated``.

    ``reason`` is a key of ``ROUND_REASONS``.
    """
    return f"the joint fits were repeated: {ROUND_REASONS[reason]}"


def _recommended(
    beta: float, u: float, count: int, low95: float, high95: float, z: float, **n: Any
) -> str:
    """Message of ``headline.both``.

    ``exponent`` is the one that the fit implies, ``z`` its distance from the ``assumed`` one in
    standard deviations; it is missing where the data do not determine it. ``low95`` and ``high95``
    hold over ``count`` other model forms; ``named`` is the one that the data support, with
    ``named_beta``.
    """
    text = (
        f"beta = {Estimate.normal(beta, u)} by the joint fit of both disks: their shares add to "
        "one, errors common to both disks cancel, and no speed law is assumed; "
        f"{_implied_exponent(z, **n)}. Over {count} other model forms "
        f"95 % of beta lie between {low95:.3f} and {high95:.3f}"
    )
    if "named" in n:
        form = model_form_text(n["named"])
        text += f"; the data support one of them: {form} (beta {n['named_beta']:.3f})"
    return f"{text}."


def _implied_exponent(
    z: float,
    assumed: float,
    exponent: float | None = None,
    exponent_u: float | None = None,
    **_: Any,
) -> str:
    """Whether the exponent that the joint fit implies is that of the speed law.

    Parameters
    ----------
    z, assumed, exponent, exponent_u
        As of ``_recommended``.
    """
    if exponent is None or exponent_u is None:
        return (
            "it does not determine the exponent, so that of the speed law "
            f"({assumed:g}) is not checked"
        )
    implied = Estimate.normal(exponent, exponent_u)
    if abs(z) < EXPONENT_AGREES_Z:
        comparison = "agrees with that of the speed law"
    else:
        comparison = f"is {abs(z):.1f} standard deviations from that of the speed law"
    return f"the exponent that it implies, {implied}, {comparison} ({assumed:g})"


def _recommended_one_disk(subject: str, beta: float, u: float, **_: Any) -> str:
    """Message of ``one_disk.headline``.

    ``subject`` is the disk, ``beta`` the share of the fast disk.
    """
    return (
        f"beta = {text_with_u(beta, u)} of the fast disk, by the joint fit of the {subject} disk "
        "alone."
    )


def _withheld(subject: str, **n: Any) -> str:
    """Message of ``headline.withheld``.

    ``subject`` is the disk of a log of one disk, else empty. ``low95`` and ``high95`` are the
    interval of a beta that the data do not determine. ``determined`` is the estimator whose beta,
    ``beta`` with ``u``, is the most certain of those that are reported.
    """
    fit = f"the joint fit of the {subject} disk" if subject else "the joint fit of both disks"
    if "low95" in n:
        text = (
            f"No beta is given: {fit} does not determine it (95 % interval {n['low95']:.2g} to "
            f"{n['high95']:.2g}, which contains 0 and 1)."
        )
    elif subject:
        text = f"No beta is given: what {fit} finds is impossible."
    else:
        text = (
            f"No beta is given: what {fit} finds is impossible, or the frictional power that they "
            "share is far from the logged one."
        )
    if "determined" in n:
        text += (
            f" What this test still determines is beta by {_estimator_text(n['determined'])}, "
            f"{Estimate.normal(n['beta'], n['u'])}: use it only if you know why the joint fit "
            "fails."
        )
    return text


def _impossible(ways: Sequence[str], **_: Any) -> str:
    """Message of ``answers.impossible``.

    ``ways`` are the estimators whose results are impossible.
    """
    return (
        "impossible numbers (beta outside 0 to 1, h not above zero, a power far from the logged "
        f"one): {', '.join(ways)} not reported"
    )


def _undetermined(
    ways: Sequence[str], low95: Sequence[float], high95: Sequence[float], **_: Any
) -> str:
    """Message of ``answers.undetermined``.

    ``ways`` are the estimators that do not determine beta, ``low95`` and ``high95`` the ends of
    their 95 % intervals.
    """
    intervals = ", ".join(
        f"{way} ({low:.2g} to {high:.2g})" for way, low, high in zip(ways, low95, high95)
    )
    return (
        "the data do not determine beta, whose 95 % interval contains 0 and 1, by these estimators "
        f"(not reported): {intervals}; look for waves and steps in the readings, a frictional "
        "power that is too small, a cooling that is too short, and large uncertainties in rig.toml"
    )


def _not_compared(determined: Sequence[str], **_: Any) -> str:
    """Message of ``ways.undetermined``.

    ``determined`` are the estimators that determine beta, at most one.
    """
    if not determined:
        return "No estimate of beta is determined by this test. Do NOT trust beta."
    return (
        f"Beta is determined by {_estimator_text(determined[0])} only: no other estimate can be "
        "compared with it."
    )


def _estimator_text(name: str) -> str:
    """The name of an estimator in a sentence.

    >>> _estimator_text("speed law"), _estimator_text("cooling fast")
    ('the speed law', 'the cooling fit of the fast disk')
    """
    kind, _, disk = name.partition(" ")
    return f"the {name}" if name == "speed law" else f"the {kind} fit of the {disk} disk"


# ---- model forms

MODEL_FORMS = {  # of `tcdyn.partition.model_forms`: description, and what to do about it
    "as assumed": ("as assumed", ""),
    "h_step": (
        "h changes at the unloading",
        "the jets may hit the disks differently once they are apart",
    ),
    "h_of_T": (
        "h follows the surface temperature",
        "a shorter cooling window is less affected by it",
    ),
    "flux_shift": ("the contact is not on the centre plane", "measure where the track lies"),
    "flux_wider": ("the heat enters over another width than Hertz's", "measure the track's width"),
    "faces": ("the side faces lose another amount of heat", "check the washers"),
    "stem": (
        "the junctions lose heat along their wires",
        "calibrate the disk with its wires as in the test",
    ),
    "elsewhere": (
        "part of the frictional heat does not enter the disks, or the friction scale is wrong",
        "check the friction's gain",
    ),
    "k_of_T": (
        "the conductivity changes with temperature",
        "state it for the temperature of the test",
    ),
    "film_air": (
        "the running surface loses heat to oil or air of another temperature",
        "log the oil at the disks",
    ),
}
# What to do about a lag that is not that of its record.
LAG_REMEDY = "there may be a bubble in its cement, or its column may be that of another junction"


def model_form_text(name: str) -> str:
    """Description of a model form.

    >>> model_form_text("lag of fast_e"), model_form_text("faces")
    ('the lag of junction e of the fast disk is not that of its record', \
'the side faces lose another amount of heat')
    """
    if name in MODEL_FORMS:
        return MODEL_FORMS[name][0]
    disk, _, channel = name.removeprefix("lag of ").partition("_")
    return f"the lag of junction {channel} of the {disk} disk is not that of its record"


def _other_model_form(name: str, log_odds: float, beta: float, u: float, **_: Any) -> str:
    """Message of ``structures.other``.

    ``name`` is a key of ``MODEL_FORMS`` or a junction's lag, ``log_odds`` its evidence against the
    assumed form; ``beta`` and ``u`` are the estimate with it.
    """
    remedy = MODEL_FORMS[name][1] if name in MODEL_FORMS else LAG_REMEDY
    return (
        f"the data support another model form than the assumed one: {model_form_text(name)} "
        f"(log-odds {log_odds:.0f}); with it beta of both disks is {Estimate.normal(beta, u)}; "
        f"{remedy}"
    )


def _undecided_model_form(name: str, beta: float, u: float, **_: Any) -> str:
    """Message of ``structures.undecided``.

    ``name`` is a key of ``MODEL_FORMS`` or a junction's lag; ``beta`` and ``u`` are the estimate
    with it.
    """
    return (
        f"this test cannot show whether {model_form_text(name)}; if it is so, beta of both disks "
        f"is {Estimate.normal(beta, u)}"
    )


# tcdyn/partition
PARTITION: dict[str, Message] = {
    "contact.dropout": "contact goes to 0 under load (first at time_s {first_s:.3f}, {count} "
    "time(s)): taken as a fault of the switch, not as an unloading",
    "contact.bounced": "the contact switch bounced ({count} changes shorter than {shorter_s} s "
    "were ignored)",
    "contact.inverted": "the contact switch is inverted: it is 0 when load and friction show that "
    "the disks touch; its readings are inverted",
    "contact.again": "the disks touched again after the unloading ({count} time(s), first "
    "{after_s:.2f} s after it, {length_s:.2f} s in all): the logged friction is taken as heat "
    "there",
    "loading.disagree": "contact switch and forces differ by {late_s:+.2f} s at the loading; the "
    "forces are used",
    "parting.switch_alone": "neither friction nor load shows a clear fall within 4 s at unloading: "
    "the instant comes from the contact switch alone; after a slower unloading, the fits are wrong",
    "parting.unclear": "neither friction nor load shows a clear fall at unloading: the instant is "
    "taken where they pass half their level",
    "parting.no_friction": "the friction shows no clear fall at unloading: the instant comes from "
    "load cell and contact switch",
    "parting.disagree": "contact switch and {subject} disagree on the unloading by "
    "{late_s:+.3f} s; the {subject} is used",
    "speeds.change": "the {subject} disk changed its speed after the unloading (to {percent:.0f} % "
    "after {after_s:.3g} s): its heat transfer coefficient follows the speed, h ~ "
    "u^{exponent:.3g}",
    "speeds.missing": "the speed of the {subject} disk after the unloading is not in the log: "
    "taken as unchanged",
    "speeds.ratio": "the ratio of the logged speeds is {ratio:.3f}, but rig.toml says gear_ratio = "
    "{stated:.3f}: the log is used",
    "constant.used": "{subject} is not in the log: the value of rig.toml [constants], {value:g} +- "
    "{u:g}, is used",
    "constant.logged": "{subject} is in the log: its value in rig.toml [constants] is not used",
    "ambient.channels": _ambient,
    "forces.one_zero": "the zeros of load cell and friction come from one unloaded end of the log "
    "only: their drift is not known",
    "one_disk.only": "the log holds the {subject} disk only: beta comes from its joint fit and its "
    "cooling fit. The speed law and the fit of both disks need the other disk; with it, the "
    "condition that the shares add to one would check the friction scale, the steel and the "
    "depths. Here their errors are errors of beta. The share of the other disk is not measured: it "
    "is one minus this share",
    "one_disk.headline": _recommended_one_disk,
    "channel.left_out": _channel_left_out,
    "friction.coefficient": "the friction coefficient {coefficient:.4f} is unlike an EHL contact: "
    "check units",
    "record.other_disk": _rig_differs_from_record,
    "sensors.suspect": _suspected_fault,
    "sensors.sound": _no_fault,
    "unevenness": _angular_harmonic,
    "fit.contradicted": "{subject} disk: its readings are {seen_K:.1f} K hotter at {seen_deg:.0f} "
    "degrees than on average around the bore, but the press fit that rig.toml states would make it "
    "{told_K:.1f} K at {told_deg:.0f} degrees ({z:.1f} standard uncertainties of the difference): "
    "[fit] is not used for this disk; check its keyways and patches, their angles and the "
    "angle_deg of the junctions",
    "stated.depth": _stated_depth,
    "stated.value": _stated_value,
    "stated.lag": "the lag of the {subject} disk: record {record_s:.3f} s, unloading "
    "{unloading_s:.3f} s",
    "stated.exponent": _stated_exponent,
    "stated.sensors": _stated_sensors,
    "ways.agree": _estimates_agree,
    "ways.apart": _estimates_differ,
    "ways.undetermined": _not_compared,
    "ways.contradicted": _estimates_contradicted,
    "cables.exchanged": _cables_exchanged,
    "rest.disks_differ": "before the loading all junctions of the {higher} disk read "
    "{difference_K:.1f} +- {u_K:.1f} K more than those of the {lower} disk: if the disks had one "
    "temperature, the sensitivity or the cold junction of one disk has changed since its "
    "calibration; beta is then wrong, and no fit shows it; calibrate again, or compare both disks "
    "with a thermometer",
    "headline.both": _recommended,
    "headline.withheld": _withheld,
    "answers.impossible": _impossible,
    "answers.undetermined": _undetermined,
    "power.scale": _power,
    "structures.other": _other_model_form,
    "structures.undecided": _undecided_model_form,
    "joint.interval": _profile_interval,
    "fits.repeated": _repeated_fits,
}
