"""Every finding in words: code -> what is said, one file for each room; nowhere else such sentences are made.

A template takes its blanks from the finding: ``{subject}``, any of its numbers by name, ``{where}`` (left out, it is
put in front, with a colon), and ``{place}``, which is "column X, row N (T s)" as far as the subject and the numbers
``row`` and ``time_s`` tell. Where a sentence has branches, or names a parameter, the entry is a function of the same
names, and of ``option``, which spells a parameter (`tcdyn/core/spelling.py`).
"""

from __future__ import annotations

from typing import Any

from tcdyn.core.messages.campaign import CAMPAIGN
from tcdyn.core.messages.identify import IDENTIFY
from tcdyn.core.messages.logs import IMMERSION, LINES, READER
from tcdyn.core.messages.partition import PARTITION
from tcdyn.core.messages.phrases import Words, place
from tcdyn.core.messages.plunge import PLUNGE
from tcdyn.core.messages.sensors import SENSOR
from tcdyn.core.messages.traces import COMPENSATE, PIPELINE, TRACES
from tcdyn.core.spelling import Spelling, as_argument

# a file from before findings were kept: the sentence as it stood there
OLD: dict[str, Words] = {"said": "{text}"}


WORDS: dict[str, Words] = {
    **OLD,
    **READER,
    **LINES,
    **IMMERSION,
    **PLUNGE,
    **IDENTIFY,
    **COMPENSATE,
    **TRACES,
    **PARTITION,
    **PIPELINE,
    **CAMPAIGN,
    **SENSOR,
}


def told(
    code: str, where: str, subject: str, numbers: dict[str, Any], spelling: Spelling = as_argument
) -> str:
    """The sentence of a finding. Raises KeyError for an unknown code and for a number that its words ask for.

    >>> told("said", "D4.csv", "", {"text": "the clock stood still"})
    'D4.csv: the clock stood still'
    """
    words = WORDS[code]
    blanks = {**numbers, "where": where, "subject": subject, "place": place(subject, **numbers)}
    if callable(words):
        text = words(**blanks, option=spelling)
    else:
        text = words.format_map(blanks)
        where = "" if "{where}" in words else where
    return f"{where}: {text}" if where else text
