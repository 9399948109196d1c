"""What is said of files, logs, lines, records and plunge logs."""

from __future__ import annotations

from typing import Any

from tcdyn.core.estimate import with_u
from tcdyn.core.messages.phrases import Message, count_with_noun


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
READER: dict[str, Message] = {
    "text.no_line_end": "row {row}, the last, has no line end: its last value may be cut short",
    "text.midnight": "column {subject}: the clock passes midnight; the time runs on",
    "text.no_number": _no_number,
    "tracks.assumed": "channel {subject} has no time track; that of {of} is assumed",
    "tracks.aligned": _aligned,
    "log.long": "of {count} rows those from {begin_s:.7g} to {end_s:.7g} s, about one parting, were looked at",
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
    "file.altered": "its content is not what tcdyn wrote (the checksum does not fit): make it again, or take its key "
    "sha256 out if that was meant",
    "column.not_there": "column {subject} is missing",
    "columns.unused": lambda names, **_: (
        f"{count_with_noun(len(names), 'column')} of the file not used: {', '.join(names)}"
    ),
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
LINES: dict[str, Message] = {
    "line.lack_of_fit": "channel {subject}: the line does not fit within the scatter of the repeats (p = {p:.2g})",
    "line.curved": "channel {subject}: a quadratic term is significant (p = {p:.2g})",
    "line.repeats_shift": "channel {subject}: the repeats shift by {u_degC:.2g} degC (u of their mean, p = {p:.2g})",
    "line.outlying": "channel {subject}: repeat {repeat:g} at {setpoint_degC:g} degC lies {off_K:+.2f} degC off the "
    "line; it is kept",
    "line.extrapolated": "{subject} read {read_degC[0]:.0f} to {read_degC[1]:.0f} degC, calibrated from "
    "{range_degC[0]:.0f} to {range_degC[1]:.0f} degC: static lines extrapolate there",
    "transducer.slopes_differ": "the sessions have different slopes (p = {p:.2g}); the cell itself has changed, not "
    "its zero",
    "record.missing_channels": lambda channels, **_: (
        f"static: channels {', '.join(channels)} are missing"
    ),
    "record.future": "created: {created} lies in the future",
    "record.ranges_apart": "channel {subject}: the calibrated ranges do not overlap",
    "record.changed": "{subject} was {was}, is {now}",
    "record.in_one_only": lambda channels, **_: (
        f"channels {', '.join(channels)} stand in one record only"
    ),
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
IMMERSION: dict[str, Message] = {
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
