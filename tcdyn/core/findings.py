"""What was noticed, as a value: code branches on its code, subject and numbers; `tcdyn/core/messages` says it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from tcdyn.core import Array
from tcdyn.core.messages import WORDS, told
from tcdyn.core.spelling import Spelling, as_argument

CHANNEL_NAME = re.compile("[A-Za-z]|[A-Za-z]+[0-9]+")  # of a thermocouple of a disk


class Grade(StrEnum):
    """What a finding asks of its reader."""

    NOTE = "note"  # mended in full on the way: nobody needs to act
    LOOK = "look"  # asks for a decision
    REFUSE = "refuse"  # what it speaks of is not to be used


@dataclass(frozen=True)
class Finding:
    """Something noticed about data or a fit.

    ``code``: what, from `tcdyn/core/messages`; ``grade``; ``where``: the file or stage; ``subject``: the channel,
    column, disk or parameter that it is about; ``numbers``: numbers, texts and lists of them, by name with unit.
    ``text`` is the sentence of a finding that was read from a file, as it stood there.

    >>> found = note("said", text="the clock stood still")
    >>> found.sentence, found.grade.value
    ('the clock stood still', 'note')
    >>> Finding.from_dict(found.to_dict()) == found
    True
    """

    code: str
    grade: Grade
    where: str = ""
    subject: str = ""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    text: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.code not in WORDS and not self.text:
            raise ValueError(f"finding {self.code!r} has no words in tcdyn/core/messages")
        object.__setattr__(self, "grade", Grade(self.grade))
        object.__setattr__(self, "numbers", {k: _plain(v) for k, v in self.numbers.items()})

    def __hash__(self) -> int:
        return hash((self.code, self.grade, self.where, self.subject, tuple(self.numbers)))

    def __str__(self) -> str:
        return self.sentence

    @property
    def sentence(self) -> str:
        """The finding in words, parameters as a caller in Python writes them."""
        return self.message()

    def message(self, spelling: Spelling = as_argument) -> str:
        """The finding in words, its parameters in the given spelling; the text of one from a file stays as it is."""
        return self.text or told(self.code, self.where, self.subject, dict(self.numbers), spelling)

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that it is about: in its subject (several stand with commas), its ``other``, its ``channels``.

        >>> look("said", subject="fast_e_degC", text="").channels, look("said", subject="a, b", text="").channels
        (('e',), ('a', 'b'))
        """
        names = (
            *self.subject.split(", "),
            self.numbers.get("other", ""),
            *self.numbers.get("channels", ()),
        )
        return tuple(dict.fromkeys(c for c in (channel_of(str(n)) for n in names) if c))

    def at(self, where: str) -> Finding:
        """The same, with ``where`` in front of where it was."""
        text = f"{where}: {self.text}" if self.text else ""
        return replace(self, where=f"{where}: {self.where}" if self.where else where, text=text)

    def to_dict(self) -> dict[str, Any]:
        """As files keep it; ``sentence`` is there to be read by people."""
        return {
            "code": self.code,
            "grade": self.grade.value,
            "where": self.where,
            "subject": self.subject,
            "numbers": {k: list(v) if isinstance(v, tuple) else v for k, v in self.numbers.items()},
            "sentence": self.sentence,
        }

    @classmethod
    def from_dict(cls, kept: Mapping[str, Any] | Finding) -> Finding:
        """Back from a file; its sentence stays as it was written. Raises ValueError for anything else."""
        if isinstance(kept, Finding):
            return kept
        try:
            return cls(
                str(kept["code"]),
                kept["grade"],
                str(kept.get("where", "")),
                str(kept.get("subject", "")),
                dict(kept.get("numbers", {})),
                str(kept["sentence"]),
            )
        except (KeyError, TypeError, AttributeError) as problem:
            raise ValueError(f"is no finding: {problem!r}") from None

    @classmethod
    def __get_pydantic_core_schema__(
        cls, _source: Any, _handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            cls.from_dict,
            serialization=core_schema.plain_serializer_function_ser_schema(cls.to_dict),
        )


@dataclass(frozen=True)
class Place:
    """Where samples stand: file, rows, and their times (``time_s`` (N,), ``dt_s``; None where there is no even time).

    ``first`` is the line of the first sample, ``blank`` are the lines below it that hold nothing.
    """

    where: str
    first: int = 1
    blank: tuple[int, ...] = ()
    time_s: Array | None = None
    dt_s: float | None = None

    def row(self, index: int) -> int:
        """The line of a sample, as an editor numbers it."""
        line = self.first + int(index)
        for gap in self.blank:
            line += gap <= line
        return line

    def of(self, index: int) -> dict[str, Any]:
        """Row and, in a trace, time of a sample, as findings carry them."""
        time = {} if self.time_s is None else {"time_s": float(self.time_s[index])}
        return {"row": self.row(index), **time}

    def at(self, column: str, index: int) -> str:
        """Column, row and time of a sample in words, as errors name them."""
        time = "" if self.time_s is None else f" ({self.time_s[index]:.6g} s)"
        return f"column {column}, row {self.row(index)}{time}"


def note(code: str, /, *, where: str = "", subject: str = "", **numbers: Any) -> Finding:
    """A finding that needs no act: something was mended in full."""
    return Finding(code, Grade.NOTE, where, subject, numbers)


def look(code: str, /, *, where: str = "", subject: str = "", **numbers: Any) -> Finding:
    """A finding that asks for a decision."""
    return Finding(code, Grade.LOOK, where, subject, numbers)


FEW = 0.02  # share of the samples that may be mended without asking anybody


def by_share(
    share: float, code: str, /, *, where: str = "", subject: str = "", **numbers: Any
) -> Finding:
    """A note where what was mended is few of the samples, ``share`` of all; else it asks for a decision."""
    return (look if share > FEW else note)(code, where=where, subject=subject, **numbers)


def refuse(code: str, /, *, where: str = "", subject: str = "", **numbers: Any) -> Finding:
    """A finding that says what must not be used."""
    return Finding(code, Grade.REFUSE, where, subject, numbers)


def once(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Each finding once, in order."""
    return tuple(dict.fromkeys(findings))


def sentences(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The findings in words, in order, each sentence once."""
    return tuple(dict.fromkeys(f.sentence for f in findings))


def graded(findings: Iterable[Finding], spelling: Spelling = as_argument) -> tuple[str, ...]:
    """The findings in words, each once, with its grade in front, as a summary ends with them.

    >>> graded([note("said", text="one spike was taken out")])
    ('note: one spike was taken out',)
    """
    return tuple(dict.fromkeys(f"{f.grade.value}: {f.message(spelling)}" for f in findings))


def doubts(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Those above a note."""
    return tuple(f for f in findings if f.grade is not Grade.NOTE)


def notes(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Those that only tell of something mended."""
    return tuple(f for f in findings if f.grade is Grade.NOTE)


def channel_of(subject: str) -> str:
    """The channel that a subject means, however it is called; empty where it is no channel.

    >>> [channel_of(s) for s in ("e", "e_degC", "fast_e_degC", "slow_e", "switch", "load_on_s", "fast")]
    ['e', 'e', 'e', 'e', '', '', '']
    """
    stem = subject.removesuffix("_degC")
    column = stem != subject or stem.startswith(("fast_", "slow_"))
    name = stem.rpartition("_")[2] if column else stem
    return name if CHANNEL_NAME.fullmatch(name) else ""


def _plain(value: Any) -> Any:
    """A number, text, truth, None, or a tuple of them: what JSON can hold."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(_plain(v) for v in value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a {type(value).__name__} is no number of a finding")
