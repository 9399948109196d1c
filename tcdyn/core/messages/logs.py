"""Messages about log files, clocks, columns, static lines, calibration records and plunge logs.

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
from tcdyn.core.estimate import text_with_u
from tcdyn.core.messages.phrases import Message, count_with_noun

LISTED_FILES = 5  # files that a message names


def _no_number(place: str, text: str, count: int, **_: Any) -> str:
    """Message of ``text.no_number``.

    ``place`` is the first of ``count`` such cells, ``text`` its content.
    """
    others = f" (and {count - 1} more)" if count > 1 else ""
    return f"{place}: {text!r} is no number{others}; taken as missing"


def _error_word(place: str, count: int, words: Sequence[str] = (), **_: Any) -> str:
    """Message of ``text.error_word``.

    ``place`` is the first of ``count`` such cells, ``words`` the texts, each with its own count.
    """
    texts = ", ".join(words)
    return f"{place}: {count} cell(s) hold a word instead of a reading: {texts}; taken as missing"


def _aligned(subject: str, spread_s: float, rates_Hz: tuple[float, ...], **_: Any) -> str:
    """Message of ``tracks.aligned``.

    ``subject`` is the channel that starts last, ``spread_s`` after the first.
    """
    rates = ", ".join(f"{rate:g}" for rate in rates_Hz)
    return (
        f"channels start up to {spread_s:.6g} s apart ({subject} last), rates {rates} Hz; "
        "all are interpolated linearly at the samples of the fastest channel"
    )


def _absent(place: str, longest: int, longest_s: float, count: int, **_: Any) -> str:
    """Message of ``values.absent``.

    ``longest`` is the number of rows of the longest run without a value, which begins at ``place``;
    ``count`` is that of all rows without one.
    """
    run = "1 value is" if longest == 1 else f"{longest} values in a row are"
    text = f"{place}: {run} missing ({longest_s:.2g} s)"
    if count > longest:
        text += f"; {count} in all, this run is the longest"
    return text


def _unused_columns(names: Sequence[str], **_: Any) -> str:
    """Message of ``columns.unused``.

    ``names`` are the columns.
    """
    columns = count_with_noun(len(names), "column")
    return f"{columns} of the file not used: {', '.join(names)}"


def _dialect(subject: str, grows: bool, option: Spelling, **_: Any) -> str:
    """Message of ``table.dialect``.

    ``subject`` is the output. ``grows``: rows are appended to it, so that it must be CSV.
    """
    remedy = f"write it with {option('dialect', 'input')}"
    if not grows:
        remedy += ", or to a file ending in .xlsx"
    return (
        f"{subject} has commas and decimal points, but the log has semicolons or decimal commas: "
        f"a spreadsheet program that opens the log rightly opens it wrongly; {remedy}"
    )


def _left_out(files: Sequence[str], **_: Any) -> str:
    """Message of ``files.left_out``; ``files`` are their names."""
    names = ", ".join(files[:LISTED_FILES])
    if len(files) > LISTED_FILES:
        names += f" and {len(files) - LISTED_FILES} more"
    return (
        f"{count_with_noun(len(files), 'file')} that tcdyn wrote, or that hold no log, are not "
        f"used: {names}"
    )


# rig: files, clocks, columns
READER: dict[str, Message] = {
    "files.left_out": _left_out,
    "files.counted": "column {subject}: no date is stated; its times go on from one file to the "
    "next, and are taken as those of one clock",
    "files.no_numbers": "column {subject} holds text and no numbers in this file; its values are "
    "taken as missing there",
    "files.stamps": "column {subject}: the files write their time stamps in different forms; all "
    "are given as year-month-dayThours:minutes:seconds",
    "text.no_line_end": "row {row}, the last, has no line end: its last value may be cut short",
    "table.dialect": _dialect,
    "metadata.damaged": "{subject}, the metadata of the table, is damaged and not used",
    "metadata.other_table": "{subject} holds the metadata of a table with other columns; it is not "
    "used",
    "text.midnight": "column {subject}: the clock passes midnight; the time continues on the next "
    "day",
    "text.no_number": _no_number,
    "text.error_word": _error_word,
    "text.clock_change": "column {subject}: the clock changes by one hour ({dates}), as to or from "
    "daylight saving time; the time continues without the change",
    "text.date_order": "column {subject}: dates such as {date} are read as {order}; nothing in the "
    "file decides this, and another order has other times",
    "text.section_below": "the table ends above row {row} ({text!r}); the rest of the file is not "
    "read",
    "tracks.assumed": "channel {subject} has no time track; that of {of} is assumed",
    "tracks.aligned": _aligned,
    "log.long": "of {count} rows, only those from {begin_s:.7g} to {end_s:.7g} s, around one "
    "unloading, are analysed",
    "log.simulated": "{subject} is simulated: its metadata say so",
    "time.taken": "column {subject} is taken as the time; if it is not, name the time column",
    "time.slow": "column {subject}: sampled at {rate_Hz:.3g} Hz, the rate of the rig is 75 Hz; "
    "lags below {lost_s:.2g} s cannot be determined",
    "values.missing": "{place}: {count} value(s) missing or impossible; taken as missing",
    "values.absent": _absent,
    "spikes.removed": "{place}: {count} spike(s); taken as missing",
    "column.constant": "column {subject} is {value:.6g} in every row",
    "column.frozen": "{place}: stays at {value:.6g} for {span_s:.3g} s",
    "file.altered": "the file was changed after tcdyn wrote it (the checksum does not fit): create "
    "it again; if the change was intended, delete the key sha256",
    "column.not_there": "column {subject} is missing",
    "columns.unused": _unused_columns,
    "contact.not_logged": "column contact is not in the log: load and friction show when the disks "
    "touch, but give the instant of unloading with a larger uncertainty",
    "noise.high": "column {subject}: the noise is {noise_K:.2g} degC, that of the other columns "
    "{others_K:.2g} degC",
    "switch.filled": "{place}: {count} value(s) missing; the state before them is used",
    "switch.levels": "column {subject}: levels {low:g} and {high:g} are read as 0 and 1",
    "switch.bounces": "{place}: the switch bounces ({count} changes)",
    "contact.stuck": "column contact is {level} in every row: the switch is not used, load and "
    "friction show when the disks touch",
    "contact.from_start": "column contact: the log begins in contact; it does not contain the "
    "loading",
    "contact.short_cooling": "column contact: the log ends {cooling_s:.2g} s after the unloading; "
    "the cooling is short",
    "friction.negative": "column friction_N is negative in contact; check its sign",
    "friction.high": "column friction_N is above 0.3 of the load in contact; check the units",
    "speed.slow": "column speed_slow_rpm: {speed_rpm:.3g} in contact; is it in revolutions per "
    "second?",
    "junctions.swapped": "columns {subject} and {other}: the junction {depth_mm:g} mm deep warms "
    "by {behind_K:.2g} degC less than the one {other_depth_mm:g} mm deep; are they swapped?",
    "junctions.uneven_start": "columns {subject} and {other}: the disk is not at one temperature "
    "at the start; the junction {depth_mm:g} mm deep reads {start_K:.2g} degC more than the one "
    "{other_depth_mm:g} mm deep",
    "junctions.uneven_disk": "columns {subject} and {other}: the disk warms unevenly around its "
    "circumference; both junctions are {depth_mm:g} mm deep, and the first warms by "
    "{behind_K:.2g} degC less",
    "oven.no_prt": "{place}: {count} row(s) without a PRT reading are not used",
    "oven.missing": "{place}: {count} value(s) missing",
    "oven.far": "{place}: {value_degC:.4g} degC, but the PRT reads {prt_degC:.4g} degC",
    "oven.continuous": "a continuous log: {count} steady minutes were found in {span_h:.3g} h",
    "oven.no_setpoint": "column setpoint_degC is missing; the PRT reading, rounded to 5 degC, is "
    "used instead",
    "oven.no_repeat": "column repeat is missing; each return to a set point counts as the next "
    "repeat",
}

# calibration: static lines; rig: calibration records
LINES: dict[str, Message] = {
    "line.lack_of_fit": "channel {subject}: the line does not fit within the scatter of the "
    "repeats (p = {p:.2g})",
    "line.curved": "channel {subject}: a quadratic term is significant (p = {p:.2g}); the straight "
    "line is used",
    "line.repeats_shift": "channel {subject}: the repeats shift by {u_degC:.2g} degC (standard "
    "uncertainty of their mean, p = {p:.2g})",
    "line.outlying": "channel {subject}: repeat {repeat:g} at {setpoint_degC:g} degC lies "
    "{off_K:+.2f} degC off the line (an outlier); it is used in the fit",
    "line.extrapolated": "{subject} read {read_degC[0]:.0f} to {read_degC[1]:.0f} degC, calibrated "
    "from {range_degC[0]:.0f} to {range_degC[1]:.0f} degC: static lines extrapolate there",
    "transducer.slopes_differ": "the sessions have different slopes (p = {p:.2g}); the sensitivity "
    "of the cell has changed, not only its zero",
    "record.missing_channels": lambda channels, **_: (
        f"static: channels {', '.join(channels)} are missing"
    ),
    "record.future": "created: {created} lies in the future",
    "record.ranges_apart": "channel {subject}: the calibrated ranges do not overlap",
    "record.changed": "{subject} was {was}, is {now}",
    "record.in_one_only": lambda channels, **_: (
        f"channels {', '.join(channels)} are in one of the records only"
    ),
    "record.no_chain": "chain: the record holds no chain; it can correct steady readings only",
    "record.gain": "static.{subject}.gain: {gain:.4f} is more than 5 % from 1",
    "record.range": "static.{subject}.range_degC: {range_degC} does not cover 20..160 degC; static "
    "lines extrapolate outside it",
    "record.line_unsure": "static.{subject}: the standard uncertainty of the line is "
    "{u_K:.2g} degC",
    "record.lag_unsure": lambda subject, lag_s, u_s, **_: (
        f"chain.{subject}: the lag, {text_with_u(lag_s, u_s)} s, has a large uncertainty"
    ),
    "record.lag_apart": lambda subject, apart_s, u_s, **_: (
        f"chain.{subject}: the lag differs from that of the other channels by "
        f"{text_with_u(apart_s, u_s)} s; is the junction badly cemented?"
    ),
}

# immersion
IMMERSION: dict[str, Message] = {
    "entry.bounced": "the entry switch bounced within a second; its first closing was taken",
    "entry.no_switch": "the entry switch never changed; the entry time comes from the free "
    "thermocouple alone",
    "entry.by_junctions": "neither the entry switch nor the free thermocouple gives the entry "
    "time: it was taken from the rise of the junctions themselves, with a standard uncertainty of "
    "{u_s:.1f} s. The common lag has at least this uncertainty; an unloading determines it better",
    "static.stated": "no oven log: readings are taken as logged, each with a standard uncertainty "
    "of {u_K:g} K",
    "entry.no_probe": "the free thermocouple shows no jump; the entry time comes from the switch "
    "alone",
    "entry.apart": "entry switch and free thermocouple differ by {difference_s:.2f} s; the "
    "uncertainty of the entry time was increased to {u_s:.2f} s",
    "correlation.range": "correlation {subject} {title} is valid for Ra of {holds[0]:.0e} to "
    "{holds[1]:.0e}; in this plunge Ra was {ran[0]:.1e} to {ran[1]:.1e}",
    "correlation.no_plate": "the disk cannot be treated as a plate throughout: D/L = {ratio:.1f} "
    "is below 35/Gr^0.25 = {least:.1f}",
    "fluid.extrapolated": "{subject}: film temperatures were {used_degC[0]:.0f} to "
    "{used_degC[1]:.0f} degC, but the properties are known from {known_degC[0]:.0f} to "
    "{known_degC[1]:.0f} degC only: h is extrapolated",
}
