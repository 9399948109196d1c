"""The messages of all findings, by code. Each file holds those of one area of the library.

A template is formatted with the fields of the finding: ``{subject}``, each of its numbers by name,
``{where}`` (a template without it gets the location in front, with a colon), and ``{place}``, which
is "column X, row N (T s)" as far as the subject and the numbers ``row`` and ``time_s`` are given.
``{unit}`` of a difference and ``{reading_unit}`` of a reading are K and degC, unless the finding
has a number ``unit``: that of another quantity, for which ``OTHER_QUANTITY`` has some messages.
A message that depends on its numbers, or that names a parameter of a function or command, is a
function with the same fields as keyword arguments, and ``option``, which spells a parameter
(``tcdyn/core/errors.py``).
"""

from __future__ import annotations

from typing import Any

from tcdyn.core.errors import Spelling, as_argument
from tcdyn.core.messages.campaign import CAMPAIGN
from tcdyn.core.messages.identify import IDENTIFY
from tcdyn.core.messages.logs import IMMERSION, LINES, READER
from tcdyn.core.messages.partition import PARTITION
from tcdyn.core.messages.phrases import Message, location_text
from tcdyn.core.messages.plunge import PLUNGE
from tcdyn.core.messages.sensors import OTHER_SENSOR, SENSOR
from tcdyn.core.messages.series import SERIES
from tcdyn.core.messages.traces import COMPENSATE, OTHER_TRACE, PIPELINE, TRACES
from tcdyn.core.messages.tune import TUNE

# a message read from a file that has no codes
FROM_FILES: dict[str, Message] = {"from_file": "{text}"}

# All messages by code; each code stands in one of these dictionaries.
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
    **SERIES,
    **TUNE,
}
# Messages about another quantity than temperature, where that about one speaks of heat.
OTHER_QUANTITY: dict[str, Message] = {**OTHER_SENSOR, **OTHER_TRACE}


def message_text(
    code: str, where: str, subject: str, numbers: dict[str, Any], spelling: Spelling = as_argument
) -> str:
    """Text of a finding.

    Parameters
    ----------
    code : str
        Key of ``MESSAGES``.
    where : str
        Location, for example the name of a file; empty where there is none.
    subject : str
        What the finding is about: a column, a channel, a disk or a model.
    numbers : dict
        Fields of the message.
    spelling : callable
        How a parameter is written.

    Raises
    ------
    KeyError
        For an unknown code or a missing number.

    Examples
    --------
    >>> message_text("from_file", "D4.csv", "", {"text": "the clock stood still"})
    'D4.csv: the clock stood still'
    """
    unit = numbers.get("unit")
    template = MESSAGES[code] if unit is None else OTHER_QUANTITY.get(code, MESSAGES[code])
    fields = {
        "unit": unit or "K",
        "reading_unit": unit or "degC",
        **numbers,
        "where": where,
        "subject": subject,
        "place": location_text(subject, **numbers),
    }
    if callable(template):
        text = template(**fields, option=spelling)
    else:
        text = template.format_map(fields)
        if "{where}" in template:
            return text
    return f"{where}: {text}" if where else text
