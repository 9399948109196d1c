"""Two grades of what is said about data: warnings ask for a decision, notes tell of what was mended on the way."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from calibration.finding import Finding, look, note

MENDED = re.compile(
    r"spikes (in \d+ channels )?were taken as missing"
    r"|spikes?(\(s\))?; taken as missing"
    r"|spikes? (was|were) left out"
    r"|time stamps jitter by up to half a sample"
    r"|the clock passes midnight"
    r"|levels .* are read as 0 and 1"
    r"|a continuous log: \d+ steady minutes were found"
    r"|each return to a set point counts as the next repeat"
)


def is_note(sentence: str) -> bool:
    """Whether ``sentence`` tells of something mended in full, which nobody needs to act upon.

    Whatever is not known to be harmless is a warning.

    >>> is_note("651 spikes in 12 channels were taken as missing, most in fast_c_degC (122)")
    True
    >>> is_note("fast_c: 8.1 % of the samples are spikes or missing")
    False
    """
    return MENDED.search(sentence) is not None


def as_findings(sentences: Iterable[str]) -> tuple[Finding, ...]:
    """What rooms that speak in sentences have noticed, as findings that carry them."""
    return tuple(note("said", text=s) if is_note(s) else look("said", text=s) for s in sentences)


def findings_of(result: Any) -> tuple[Finding, ...]:
    """The findings of a result, whether its room makes findings or still speaks in sentences."""
    found = getattr(result, "findings", None)
    return as_findings(result.warnings) if found is None else tuple(found)
