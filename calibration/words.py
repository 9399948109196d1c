"""Every finding in words: code -> what is said, one section for each room; the only file that makes such sentences.

A template takes its blanks from the finding: ``{subject}``, any of its numbers by name, ``{where}`` (left out, it is
put in front, with a colon), and ``{place}``, which is "column X, row N (T s)" as far as the subject and the numbers
``row`` and ``time_s`` tell. Where a sentence has branches the entry is a function of the same names.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Words = str | Callable[..., str]


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

# calibration: files, checks, log
READER: dict[str, Words] = {}

# calibration: lines, record
LINES: dict[str, Words] = {}

# immersion
IMMERSION: dict[str, Words] = {
    "entry.bounced": "the entry switch bounced within a second; its first closing was taken",
    "entry.no_switch": "the entry switch never moved; the free thermocouple alone gives the entry time",
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
PLUNGE: dict[str, Words] = {}

# tcdyn/identify
IDENTIFY: dict[str, Words] = {}

# tcdyn/compensate
COMPENSATE: dict[str, Words] = {}

# tcdyn/traces
TRACES: dict[str, Words] = {
    "traces.gaps": "{subject}: {percent:.1f} % of the samples are spikes or missing",
    "traces.coarse": lambda subject, step_K, channels, **_: (
        f"{subject} disk: the logger writes in steps of {step_K:.2g} K, coarser than the noise, in "
        f"{', '.join(channels)}: such rounding is no white noise, and lags and transient fits may be further off than "
        "they say"
    ),
}

# tcdyn/partition
PARTITION: dict[str, Words] = {}

# tcdyn/pipeline
PIPELINE: dict[str, Words] = {}

WORDS: dict[str, Words] = {
    **OLD, **READER, **LINES, **IMMERSION, **PLUNGE, **IDENTIFY, **COMPENSATE, **TRACES, **PARTITION, **PIPELINE,
}  # fmt: skip
