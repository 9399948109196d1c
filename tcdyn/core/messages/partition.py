"""What is said of heat partition."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tcdyn.core.estimate import Estimate, with_u
from tcdyn.core.messages.phrases import Message, count_with_noun, rounded_to_u

JOINT_NUMBERS = {
    "beta": ("beta", ""),
    "h": ("h", " W/m2K"),
    "lag_s": ("the lag", " s"),
    "h_fast": ("h of the fast disk", " W/m2K"),
    "h_slow": ("h of the slow disk", " W/m2K"),
    "exponent": ("the exponent", ""),
}


def _interval(
    subject: str, parameter: str, u: float, low95: float | None, high95: float | None, **n: Any
) -> str:
    fit = "both disks" if subject == "both" else f"{subject} disk"
    what, unit = JOINT_NUMBERS[parameter]
    ends = ((low95, "below", n["low_seen"]), (high95, "above", n["high_seen"]))
    left = [
        f"from {word} (followed to {rounded_to_u(seen, u)}{unit})"
        for end, word, seen in ends
        if end is None
    ]
    if left:
        return f"Joint fit, {fit}: the data do not bound {what} {' nor '.join(left)}."
    return (
        f"Joint fit, {fit}: 95 % of {what} reaches from {rounded_to_u(low95, u)} to {rounded_to_u(high95, u)}{unit} "
        f"by its profile, and from {rounded_to_u(n['normal_low95'], u)} to {rounded_to_u(n['normal_high95'], u)}{unit} "
        "by its standard uncertainty."
    )


def _other_disk(
    subject: str, keys: Sequence[str], record: Sequence[str], rig: Sequence[str], **_: Any
) -> str:
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
    "offset": "channel {names} reads {size:+.1f} K off: its unit, static line or reference junction",
    "unknown": "its junctions do not read as the rim model says (chi-square {chi2:.0f} for {dof} data), and no "
    "single swap, misplacement or offset explains it",
}


def _suspected(
    subject: str, kind: str, channels: Sequence[str], log_odds: float | None = None, **n: Any
) -> str:
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
    return f"{subject} disk: {said}{odds}" + (
        "; or " + ", ".join(n["rivals"]) if n.get("rivals") else ""
    )


def _sound(subject: str, illogical: int, pairs: int, blind: Sequence[str], **_: Any) -> str:
    said = (
        f"{subject} disk: no swapped, dead, misplaced, late or offset channel found; {illogical} of {pairs} pairs "
        "illogical"
    )
    return said + (f"; a swap of {', '.join(blind)} could not have been told" if blind else "")


def _left_out(
    subject: str, why: str, stand_ins: Sequence[str], kept: Sequence[str], **_: Any
) -> str:
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
    return "; ".join(
        f"{what} ({z:.1f} standard deviations)" for what, z in zip(suspects, suspects_z)
    )


def _ways_apart(
    one: str, other: str, apart: float, z: float, suspects: Any, suspects_z: Any, **n: Any
) -> str:
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


def _ways_agree(
    one: str, other: str, apart: float, z: float, low: float, high: float, **n: Any
) -> str:
    steady = Estimate.normal(n["steady"], n["steady_u"])
    said = (
        f"The ways to beta agree: {low:.3f} to {high:.3f}, speed law {steady}; the "
        f"most significant difference, {one} against {other}, is {apart:.3f} or {z:.1f} standard deviations"
    )
    if "strained" not in n:
        return f"{said}."
    return (
        f"{said}. The stated value that the data pull most is {n['strained']}: {n['strained_z']:.1f} standard "
        f"deviations, no contradiction (one sound test in {1 / n['chance']:.0f} shows as much)."
    )


STRUCTURES = {  # of `tcdyn.partition.model_forms`: what it is, what to do about it
    "as assumed": ("as assumed", ""),
    "h_step": (
        "h changes at the parting",
        "the jets may hit the disks differently once they are apart",
    ),
    "h_of_T": (
        "h follows the surface temperature",
        "a shorter cooling window is less touched by it",
    ),
    "flux_shift": ("the contact runs beside the centre plane", "measure where the track lies"),
    "flux_wider": ("the heat enters over another width than Hertz's", "measure the track's width"),
    "faces": ("the side faces lose another amount of heat", "look at the washers"),
    "stem": (
        "the junctions lose heat along their wires",
        "calibrate the disk with its wires as in the test",
    ),
    "elsewhere": (
        "part of the frictional heat goes elsewhere, or friction is off scale",
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
    likely = (
        f"likeliest: {' or '.join(units)}"
        if units
        else "check load, friction, speeds and their units"
    )
    size = Estimate.normal(scale, u)
    return (
        f"the heat that both disks show is {size} times the logged frictional power F u_s; {likely}"
    )


def _cables_exchanged(
    exponent: float, u: float, assumed: float, beta: float, at_rest: bool, **_: Any
) -> str:
    alike = (
        "before the load each disk has one temperature through the other's static lines only, and "
    )
    return (
        f"the cables of the two disks look exchanged: {alike if at_rest else ''}the speed exponent comes out as "
        f"{Estimate.normal(exponent, u)} where the speed law has {assumed:.2f}, as if the fast disk were the slow one; "
        f"beta would then be near {1 - beta:.2f}: map the columns in rig.toml [columns]"
    )


def _headline(
    beta: float, u: float, count: int, low95: float, high95: float, z: float, **n: Any
) -> str:
    implied = Estimate.normal(n["exponent"], n["exponent_u"])
    law = f"the exponent that it implies, {implied}, "
    law += (
        "goes with the speed law's"
        if abs(z) < 2
        else f"lies {abs(z):.1f} standard deviations off the speed law's"
    )
    said = (
        f"beta = {Estimate.normal(beta, u)} by the joint fit of both disks: their shares add to one, what is wrong "
        f"with both alike cancels, and no speed law is assumed; {law} ({n['assumed']:g}). Over {count} other "
        f"structures 95 % of beta lie between {low95:.3f} and {high95:.3f}"
    )
    if "named" in n:
        said += (
            f"; the data ask for one of them: {structure(n['named'])} (beta {n['named_beta']:.3f})"
        )
    return f"{said}."


_PLACES = {"surface": "running surface", "faces": "side faces"}
PARTITION: dict[str, Message] = {
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
        f"air at the {_PLACES[at]} of the {subject} disk by {count_with_noun(count, 'channel')}: {mean_degC:.1f} degC "
        f"over the last 150 s under load, drifting by {drift_K:+.2f} K"
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
        f"{angle_deg:.0f} degrees of rig.toml's angles, as much colder opposite, at the depth of the inner row; the "
        "joint fit found it, and it was subtracted from the readings (section 6.4.3: look at press fit and keys)"
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
    "headline.withheld": lambda subject, **_: (
        f"No beta is given: what the joint fit of {f'the {subject} disk' if subject else 'both disks'} finds is "
        f"impossible{'' if subject else ', or the frictional power that they share is off by far'}."
    ),
    "answers.impossible": lambda ways, **_: (
        f"impossible numbers (beta outside 0 to 1, h not above zero, a power off by far): {', '.join(ways)} withheld"
    ),
    "power.scale": _power,
    "structures.other": _other_structure,
    "joint.interval": _interval,
}
