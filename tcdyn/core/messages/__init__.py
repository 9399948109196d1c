"""Messages of findings, by code. Each file holds those of one part of the library.

A template takes its fields from the finding: ``{subject}``, any of its numbers by name, ``{where}`` (otherwise put in
front, with a colon), and ``{place}``, which is "column X, row N (T s)" as far as the subject and the numbers ``row``
and ``time_s`` are given. Where a message has branches or names a parameter, the entry is a function with these names
as arguments and ``option``, which spells a parameter (``tcdyn/core/spelling.py``).
"""

from __future__ import annotations

from typing import Any

from tcdyn.core.messages.campaign import CAMPAIGN
from tcdyn.core.messages.identify import IDENTIFY
from tcdyn.core.messages.logs import IMMERSION, LINES, READER
from tcdyn.core.messages.partition import PARTITION
from tcdyn.core.messages.phrases import Message, location_text
from tcdyn.core.messages.plunge import PLUNGE
from tcdyn.core.messages.sensors import SENSOR
from tcdyn.core.messages.traces import COMPENSATE, PIPELINE, TRACES
from tcdyn.core.spelling import Spelling, as_argument

# a message that was read from a file without codes
FROM_FILES: dict[str, Message] = {"said": "{text}"}

MESSAGES: dict[str, Message] = {
    **FROM_FILES,
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


def message_text(
    code: str, where: str, subject: str, numbers: dict[str, Any], spelling: Spelling = as_argument
) -> str:
    """Message of a finding. Raises KeyError for an unknown code or a missing number.

    >>> message_text("said", "D4.csv", "", {"text": "the clock stood still"})
    'D4.csv: the clock stood still'
    """
    template = MESSAGES[code]
    fields = {
        **numbers,
        "where": where,
        "subject": subject,
        "place": location_text(subject, **numbers),
    }
    if callable(template):
        text = template(**fields, option=spelling)
    else:
        text = template.format_map(fields)
        where = "" if "{where}" in template else where
    return f"{where}: {text}" if where else text
