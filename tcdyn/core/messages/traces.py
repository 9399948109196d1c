"""Messages about traces, noise, compensated logs, live compensation and workflows.

A function here makes the text of one finding whose wording depends on its numbers; its arguments
are the fields of the finding (see ``tcdyn.core.messages``). Wording may be changed freely; codes,
names of fields and what a message advises must fit the place that makes the finding.
``tests/core/test_findings.py`` checks that each code is made somewhere and each code that is made
has a message.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tcdyn.core.errors import Spelling
from tcdyn.core.messages.phrases import Message


def _noisy_inverse(
    bandwidth_Hz: float, noise_K: float, limit_K: float, best_Hz: float, **_: Any
) -> str:
    """Message of ``inverse.noisy``.

    ``limit_K`` is the noise that is allowed, ``best_Hz`` the largest bandwidth with no more; 0 if
    there is none.
    """
    text = (
        f"a bandwidth of {bandwidth_Hz:.3g} Hz makes {noise_K:.3g} K of noise, more than the "
        f"{limit_K:.3g} K allowed: "
    )
    if best_Hz > 0:
        return f"{text}at most {best_Hz:.3g} Hz can be had at this noise"
    return f"{text}no bandwidth satisfies this limit at this noise"


def _coloured_noise(
    subject: str, before_K: float, after_K: float, unit: str, lag_s: float = 0.0, **_: Any
) -> str:
    """Message of ``noise.coloured``.

    ``before_K`` is the noise from before the filter, ``after_K`` that from after it, ``lag_s`` the
    lag that colours the former; 0 for the conditioning filter.
    """
    if lag_s:
        return (
            f"{subject}: noise of {before_K:.2g} {unit} is coloured as by a lag of "
            f"{lag_s:.2g} s, noise of {after_K:.2g} {unit} is white; all later steps use both"
        )
    return (
        f"{subject}: noise of {before_K:.2g} {unit} comes through the conditioning filter, "
        f"noise of {after_K:.2g} {unit} arises after it; all later steps use both"
    )


def _coarse_logger(subject: str, step_K: float, channels: Sequence[str], **_: Any) -> str:
    """Message of ``traces.coarse``.

    ``step_K`` is the resolution of the logger.
    """
    return (
        f"{subject} disk: the logger writes in steps of {step_K:.2g} K, coarser than the noise, in "
        f"{', '.join(channels)}: such rounding is not white noise, and the uncertainties of lags "
        "and transient fits may be too small"
    )


def _one_disk(subject: str, other: str, option: Spelling, **_: Any) -> str:
    """Message of ``compensate.one_disk``.

    ``subject`` is the disk without a record, ``other`` the one with a record.
    """
    return (
        f"no record of the {subject} disk was given: its columns are copied as logged, and the "
        f"common lag of the {other} disk comes from its record; with both records the unloading "
        f"would determine it better. Add {option('records', f'{subject}.disk.json')}"
    )


def _steps(
    subject: str,
    count: int,
    step_K: float,
    first_sample: int,
    at_s: float,
    period_s: float,
    unit: str,
    **_: Any,
) -> str:
    """Message of ``trace.steps``; ``period_s`` is zero where the steps are not periodic."""
    how_often = f"about every {period_s:.3g} s" if period_s else "at no regular times"
    return (
        f"{subject}: the reading itself steps {count} times, {how_often}, by about {step_K:.3g} "
        f"{unit}, the first time at sample {first_sample} ({at_s:.4g} s), faster than the sensor "
        "could follow: interference of something that switches, a bad contact, or another sensor, "
        "plug or range for a time. The steps are left as they are in the result; log what switches "
        "as a column of the table, and they are removed with it"
    )


def _undetermined(
    subject: str,
    percent: float,
    first_sample: int,
    range_K: float,
    unit: str,
    option: Spelling,
    resolution_s: float | None = None,
    **_: Any,
) -> str:
    """Message of ``trace.undetermined``.

    ``resolution_s`` is the shortest time whose means are determined; None where too few readings
    are the cause.
    """
    text = (
        f"{subject}: {percent:.3g} % of the record, first at sample {first_sample}, is not "
        "determined by it: there is no reading near, the standard uncertainty exceeds the range "
        f"of the readings ({range_K:.3g} {unit}), or the result is not possible; not reported there"
    )
    if resolution_s is None:
        return text
    if math.isinf(resolution_s):
        return f"{text}. No mean over a third of the record or less is determined, either"
    means = option("means", f"{resolution_s:.4g}")
    return (
        f"{text}. Single rows are faster than the sensor lets through: means over "
        f"{resolution_s:.4g} s are determined ({means})"
    )


def _law(subject: str, quantity: str, strength: float, log_ratio: float, **_: Any) -> str:
    """Message of ``trace.law``.

    ``strength`` is the factor of the logarithm of the law with which the readings are likeliest.
    """
    times = f"exp({log_ratio:.0f}) times likelier"
    if strength == 0:
        text = f"if the lag does not follow {quantity} at all"
    else:
        text = f"if the exponent of the law of {quantity} is {strength:g} times as large"
    return (
        f"{subject}: the readings do not fit the law of the lag: they are {times} {text}. Either "
        f"the law is wrong: check the column of {quantity}, its unit and how often it is read, the "
        "exponent and the inner share; the result is then more uncertain than it says. Or the "
        f"temperature itself moves more where {quantity} is high, or where it is low: the readings "
        "do not tell which"
    )


# tcdyn/smoothing
COMPENSATE: dict[str, Message] = {
    "trace.stuck": "{subject}: stuck or saturated in {percent:.2g} % of the record, first at "
    "sample {first_sample}; those samples are treated as missing",
    "trace.outside": "{subject}: {count} reading(s) such as {value:.4g} degC at sample "
    "{first_sample} are outside the physical range of a thermocouple (-273 to 3000 degC); taken as "
    "missing",
    "trace.overload": "{subject}: {count} reading(s) such as {value:.4g} {reading_unit} at sample "
    "{first_sample} are a million times as large as the others: overload codes; taken as missing",
    "trace.codes": "{subject}: {count} reading(s) of {value:.4g} {reading_unit}, the first at "
    "sample {first_sample}, are drop-outs; taken as missing: check the wiring",
    "trace.unreachable": "{subject}: {count} reading(s), the first {value:.4g} degC at sample "
    "{first_sample}, change faster than any temperature could make this sensor change; taken as "
    "missing: check the wiring, or the lag of the sensor",
    "trace.events": "the readings show no change at the listed event(s) at {listed_s} s, but at "
    "{detected_s} s: check the times of the events, and the clock of the log",
    "trace.event_outside": "the listed event(s) at {listed_s} s are outside the record of "
    "{duration_s:.4g} s and not used: events are in seconds from the first row",
    "trace.step": "{subject}: the reading itself steps by {step_K:.3g} +- {u_K:.2g} K at sample "
    "{first_sample} ({at_s:.4g} s), faster than the sensor could follow any temperature: another "
    "sensor, plug, range or offset. The step is left as it is in the result; one side of it is "
    "wrong, and the readings do not tell which",
    "trace.steps": _steps,
    "trace.pick_up": "{subject}: the readings step by {step_K:.3g} +- {u_K:.2g} K with the {edges} "
    "edges of {column!r}, at once and not through the sensor: interference (pick-up), which was "
    "removed. Rows in which the column is off, or smallest, are taken as right: if it is the other "
    "state, all rows are off by the step. Lay the wires of the sensor apart from those of the "
    "load, or shield them",
    "trace.alone": "{subject}: {count} reading(s) at an end of the record, first at sample "
    "{first_sample}, stand alone behind a gap and contradict all others: the temperature changed "
    "in the gap or beyond it, and nothing tells when and how far; it is not reported there: log "
    "more readings, or give the time of the change as an event",
    "trace.undetermined": _undetermined,
    "trace.law": _law,
    "trace.bad": "{subject}: {percent:.2g} % of the readings are spikes or implausible and are not "
    "used",
    "inverse.noisy": _noisy_inverse,
    "inverse.near_nyquist": "a bandwidth of {bandwidth_Hz:.3g} Hz is near half of the "
    "{rate_Hz:.3g} Hz sampling rate: between samples the response differs from the formula",
    "inverse.dead_time": "dead time and right-half-plane zeros cannot be inverted: they remain as "
    "a time shift",
}

# tcdyn/smoothing: traces of a rig log; tcdyn/chain: noise of the logger
TRACES: dict[str, Message] = {
    "spikes.gathered": "{count} spikes in {columns} channels were taken as missing, most in "
    "{subject} ({of_most})",
    "traces.gaps": "{subject}: {percent:.1f} % of the samples are spikes or missing",
    "noise.hum": "{subject}: hum of {amplitude_K:.2g} {unit} at {f_Hz:.2f} Hz",
    "noise.wave": "{subject}: a wave of {amplitude_K:.2g} {unit} at {f_Hz:.3g} Hz is taken for one "
    "of the temperature, of {temperature_K:.2g} {unit} before the lag; the record does not "
    "distinguish it from interference. If the temperature has no such wave, remove it from the "
    "readings first (a notch filter), or shield the cables",
    "noise.folded": "{subject}: the sampling may alias harmonics of the mains hum to frequencies "
    "of the temperature itself, where they cannot be detected: {folded_K:.2g} {unit} were added to "
    "the standard uncertainty. Use a sampling rate that divides no multiple of the mains frequency",
    "noise.unexplained": "{subject}: a part of its spectrum has {ratio:.1f} times the power that "
    "white noise and a temperature of any roughness explain: interference, or a temperature that "
    "swings at few frequencies; the noise level used is not lower than that at the frequencies of "
    "the temperature",
    "noise.coloured": _coloured_noise,
    "traces.coarse": _coarse_logger,
}

# tcdyn/workflows
PIPELINE: dict[str, Message] = {
    "calibrate.other_disk": "{count} static lines do not fit the plunges: is the oven log of the "
    "disk that was plunged ({subject}), and the wiring the same?",
    "bearing.extrapolated": "bearing friction at {load_N:.0f} N and {speed_rpm:.0f} rpm is "
    "extrapolated: {file} covers {loads_N[0]:.0f} to {loads_N[1]:.0f} N and {speeds_rpm[0]:.0f} to "
    "{speeds_rpm[1]:.0f} rpm",
    "verify.differs": "{source}: {subject}: {ours} here, {published} published",
    "compensate.one_disk": _one_disk,
    "compensate.unrefined": "the common lags are those of the records: the unloading could not be "
    "used ({problem})",
    "rows.not_used": "{count} of {rows} readings of {subject} are spikes, stuck, or not possible "
    "for this sensor, the first at {first_s:.6g} s: taken as missing",
    "delay.backward": "{count} rows whose time is missing or runs backward were not used",
    "follow.behind": "the log grew faster than its rows were compensated: up to {rows} rows "
    "waited; a longer delay or fewer columns need less time",
    "follow.torn": "{count} lines with a wrong number of fields were not used",
}

# The same about another quantity than temperature, where a message above speaks of one.
OTHER_TRACE: dict[str, Message] = {
    "trace.alone": "{subject}: {count} reading(s) at an end of the record, first at sample "
    "{first_sample}, stand alone behind a gap and contradict all others: the quantity changed "
    "in the gap or beyond it, and nothing tells when and how far; it is not reported there: log "
    "more readings, or give the time of the change as an event",
    "trace.step": "{subject}: the reading itself steps by {step_K:.3g} +- {u_K:.2g} {unit} at "
    "sample {first_sample} ({at_s:.4g} s), faster than the sensor could follow: another sensor, "
    "plug, range or offset. The step is left as it is in the result; one side of it is wrong, and "
    "the readings do not tell which",
    "trace.steps": _steps,
    "trace.pick_up": "{subject}: the readings step by {step_K:.3g} +- {u_K:.2g} {unit} with the "
    "{edges} edges of {column!r}, at once and not through the sensor: interference (pick-up), "
    "which was removed. Rows in which the column is off, or smallest, are taken as right: if it is "
    "the other state, all rows are off by the step. Lay the wires of the sensor apart from those "
    "of the load, or shield them",
    "trace.undetermined": _undetermined,
    "noise.wave": "{subject}: a wave of {amplitude_K:.2g} {unit} at {f_Hz:.3g} Hz is taken for one "
    "of the quantity itself, of {temperature_K:.2g} {unit} before the lag; the record does not "
    "distinguish it from interference. If the quantity has no such wave, remove it from the "
    "readings first (a notch filter), or shield the cables",
    "noise.folded": "{subject}: the sampling may alias harmonics of the mains hum to frequencies "
    "of the quantity itself, where they cannot be detected: {folded_K:.2g} {unit} were added to "
    "the standard uncertainty. Use a sampling rate that divides no multiple of the mains frequency",
}
