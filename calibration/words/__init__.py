"""Every finding in words: code -> what is said, one file for each room; nowhere else such sentences are made.

A template takes its blanks from the finding: ``{subject}``, any of its numbers by name, ``{where}`` (left out, it is
put in front, with a colon), and ``{place}``, which is "column X, row N (T s)" as far as the subject and the numbers
``row`` and ``time_s`` tell. Where a sentence has branches, or names a parameter, the entry is a function of the same
names, and of ``option``, which spells a parameter (`calibration/spelling.py`).
"""

from __future__ import annotations

from typing import Any

from calibration.spelling import Spelling, as_argument
from calibration.words.base import Words, place
from calibration.words.campaign import CAMPAIGN
from calibration.words.identify import IDENTIFY
from calibration.words.logs import IMMERSION, LINES, READER
from calibration.words.partition import PARTITION
from calibration.words.plunge import PLUNGE
from calibration.words.sensor import SENSOR
from calibration.words.traces import COMPENSATE, PIPELINE, TRACES

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
