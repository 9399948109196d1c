"""Findings: observations about data or a fit, as values.

Their messages are in ``tcdyn/core/messages``. A computation makes findings with ``info``,
``warning`` and ``error``; summaries, reports and the command line word them. To add one, make it
with a new code and add a message for the code. Guarded by ``tests/core/test_findings.py``, which
fails for a code without a message and for a message that no code uses.
"""

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
from tcdyn.core.errors import DAMAGED, Spelling, as_argument
from tcdyn.core.messages import MESSAGES, message_text

# Name of a thermocouple of a disk: a letter, or letters with a number.
CHANNEL_NAME = re.compile("[A-Za-z]|[A-Za-z]+[0-9]+")
# values of the key "grade" in files of version 0.2
GRADES_OF_0_2 = {"note": "info", "look": "warning", "refuse": "error"}
# codes that files of earlier versions have
EARLIER_CODES = {"said": "from_file"}


class Severity(StrEnum):
    """How serious a finding is."""

    INFO = "info"  # corrected without loss: no action is needed
    WARNING = "warning"  # the user has to decide
    ERROR = "error"  # the result or the data must not be used


@dataclass(frozen=True)
class Finding:
    """An observation about data or a fit.

    Parameters
    ----------
    code
        Kind of the observation: a key of ``tcdyn.core.messages.MESSAGES``.
    severity
        Info, warning or error.
    where
        File or stage.
    subject
        The channel, column, disk or parameter concerned; several channels are separated by ", ".
    numbers
        Numbers, texts and lists of them for the message, by name with unit.
    text
        The message of a finding that was read from a file, as written there.

    Examples
    --------
    >>> finding = info("from_file", text="the clock stood still")
    >>> finding.sentence, finding.severity.value
    ('the clock stood still', 'info')
    >>> Finding.from_dict(finding.to_dict()) == finding
    True
    """

    code: str
    severity: Severity
    where: str = ""
    subject: str = ""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    text: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        """Check the code, and convert severity and numbers to what files store.

        Raises
        ------
        ValueError
            The code has no message, and the finding no text.
        TypeError
            A number cannot be stored.
        """
        if self.code not in MESSAGES and not self.text:
            raise ValueError(f"finding {self.code!r} has no message in tcdyn/core/messages")
        object.__setattr__(self, "severity", Severity(self.severity))
        object.__setattr__(self, "numbers", {k: _plain_value(v) for k, v in self.numbers.items()})

    def __hash__(self) -> int:
        """Hash by all that ``unique`` compares, with the names of the numbers only."""
        return hash((self.code, self.severity, self.where, self.subject, tuple(self.numbers)))

    def __str__(self) -> str:
        """The message."""
        return self.sentence

    @property
    def sentence(self) -> str:
        """The message, with parameters as a caller in Python writes them."""
        return self.message()

    def message(self, spelling: Spelling = as_argument) -> str:
        """The message, with parameters in the given spelling.

        The text of a finding from a file is not changed.

        Parameters
        ----------
        spelling
            Function of name and value that gives the text of a parameter.
        """
        return self.text or message_text(
            self.code, self.where, self.subject, dict(self.numbers), spelling
        )

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels concerned: of the subject, and of the numbers ``other`` and ``channels``.

        Returns
        -------
        Letters or names of the channels, each once.

        Examples
        --------
        >>> warning("from_file", subject="fast_e_degC, slow_b", text="").channels
        ('e', 'b')
        """
        names = (
            *self.subject.split(", "),
            self.numbers.get("other", ""),
            *self.numbers.get("channels", ()),
        )
        return tuple(dict.fromkeys(c for c in (channel_of(str(n)) for n in names) if c))

    def at(self, where: str) -> Finding:
        """The same finding with ``where`` put in front of its location."""
        text = f"{where}: {self.text}" if self.text else ""
        return replace(self, where=f"{where}: {self.where}" if self.where else where, text=text)

    def in_unit(self, unit: str) -> Finding:
        """The same finding about a quantity in another unit than those of temperatures.

        Parameters
        ----------
        unit
            Unit of the numbers that messages otherwise give in K and degC; a unit of temperature
            changes nothing.

        Examples
        --------
        >>> hum = info("noise.hum", subject="CO2", f_Hz=50.0, amplitude_K=2.0)
        >>> hum.in_unit("ppm").sentence, hum.in_unit("K") is hum
        ('CO2: hum of 2 ppm at 50.00 Hz', True)
        """
        if unit in ("degC", "K", "degF") or self.text:
            return self
        return replace(self, numbers={**self.numbers, "unit": unit})

    def to_dict(self) -> dict[str, Any]:
        """The finding as files store it; ``sentence`` is the message for readers."""
        return {
            "code": self.code,
            "grade": self.severity.value,
            "where": self.where,
            "subject": self.subject,
            "numbers": {k: list(v) if isinstance(v, tuple) else v for k, v in self.numbers.items()},
            "sentence": self.sentence,
        }

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any] | Finding) -> Finding:
        """The finding stored in a file; its message stays as written.

        Parameters
        ----------
        stored
            Content of the file, or a finding, which is returned as it is.

        Raises
        ------
        ValueError
            Other content.
        """
        if isinstance(stored, Finding):
            return stored
        try:
            code = str(stored["code"])
            grade = str(stored["grade"])
            return cls(
                EARLIER_CODES.get(code, code),
                Severity(GRADES_OF_0_2.get(grade, grade)),
                str(stored.get("where", "")),
                str(stored.get("subject", "")),
                dict(stored.get("numbers", {})),
                str(stored["sentence"]),
            )
        except DAMAGED as problem:
            raise ValueError(f"not a finding: {problem!r}") from None

    @classmethod
    def __get_pydantic_core_schema__(
        cls, _source: Any, _handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Schema for models of pydantic: read by ``from_dict``, stored by ``to_dict``."""
        return core_schema.no_info_plain_validator_function(
            cls.from_dict,
            serialization=core_schema.plain_serializer_function_ser_schema(cls.to_dict),
        )


@dataclass(frozen=True)
class SampleLocation:
    """Location of samples in a file.

    Parameters
    ----------
    where
        Name of the file.
    first
        Line of the first sample.
    blank
        Lines below it without a sample.
    time_s
        Time (N,) of the samples [s]; None without a time column.
    dt_s
        Sampling interval [s]; None without even sampling.
    """

    where: str
    first: int = 1
    blank: tuple[int, ...] = ()
    time_s: Array | None = None
    dt_s: float | None = None

    def row(self, index: int) -> int:
        """Line of a sample, counted from 1."""
        line = self.first + int(index)
        for gap in self.blank:
            line += gap <= line
        return line

    def numbers_at(self, index: int) -> dict[str, Any]:
        """Row and, where known, time of a sample, for the numbers of a finding."""
        time = {} if self.time_s is None else {"time_s": float(self.time_s[index])}
        return {"row": self.row(index), **time}

    def at(self, column: str, index: int) -> str:
        """Column, row and time of a sample as text for an error message.

        Parameters
        ----------
        column
            Name of the column.
        index
            Index of the sample, from 0.
        """
        time = "" if self.time_s is None else f" ({self.time_s[index]:.6g} s)"
        return f"column {column}, row {self.row(index)}{time}"


def info(code: str, /, *, where: str = "", subject: str = "", **numbers: Any) -> Finding:
    """A finding without need for action: something was corrected without loss.

    Parameters
    ----------
    code
        Kind of the observation, a key of ``tcdyn.core.messages.MESSAGES``.
    where
        File or stage.
    subject
        The channel, column, disk or parameter concerned.
    **numbers
        Fields of the message, by name with unit.
    """
    return Finding(code, Severity.INFO, where, subject, numbers)


def warning(code: str, /, *, where: str = "", subject: str = "", **numbers: Any) -> Finding:
    """A finding on which the user has to decide.

    Parameters
    ----------
    code
        Kind of the observation, a key of ``tcdyn.core.messages.MESSAGES``.
    where
        File or stage.
    subject
        The channel, column, disk or parameter concerned.
    **numbers
        Fields of the message, by name with unit.
    """
    return Finding(code, Severity.WARNING, where, subject, numbers)


# Share of the samples up to which a correction is an info, above it a warning; chosen by judgement.
FEW_SAMPLES_SHARE = 0.02


def info_or_warning(
    share: float, code: str, /, *, where: str = "", subject: str = "", **numbers: Any
) -> Finding:
    """An info where few samples are concerned, otherwise a warning.

    Parameters
    ----------
    share
        Share of the samples that is concerned; up to ``FEW_SAMPLES_SHARE`` it is an info.
    code
        Kind of the observation, a key of ``tcdyn.core.messages.MESSAGES``.
    where
        File or stage.
    subject
        The channel, column, disk or parameter concerned.
    **numbers
        Fields of the message, by name with unit.
    """
    severity = Severity.WARNING if share > FEW_SAMPLES_SHARE else Severity.INFO
    return Finding(code, severity, where, subject, numbers)


def error(code: str, /, *, where: str = "", subject: str = "", **numbers: Any) -> Finding:
    """A finding about a result or data that must not be used.

    Parameters
    ----------
    code
        Kind of the observation, a key of ``tcdyn.core.messages.MESSAGES``.
    where
        File or stage.
    subject
        The channel, column, disk or parameter concerned.
    **numbers
        Fields of the message, by name with unit.
    """
    return Finding(code, Severity.ERROR, where, subject, numbers)


def unique(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings without repetitions, in order."""
    return tuple(dict.fromkeys(findings))


def unique_by_subject(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the first finding of each code about each subject.

    The parts of one table repeat them.
    """
    first: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        first.setdefault((finding.code, finding.subject), finding)
    return tuple(first.values())


def messages(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The messages of the findings without repetitions, in order."""
    return tuple(dict.fromkeys(f.sentence for f in findings))


def labelled_messages(
    findings: Iterable[Finding], spelling: Spelling = as_argument
) -> tuple[str, ...]:
    """The messages of the findings without repetitions, each with its severity in front.

    Parameters
    ----------
    findings
        The findings.
    spelling
        Function of name and value that gives the text of a parameter.

    Returns
    -------
    Messages such as "info: one spike was removed".

    Examples
    --------
    >>> labelled_messages([info("from_file", text="one spike was removed")])
    ('info: one spike was removed',)
    """
    return tuple(dict.fromkeys(f"{f.severity.value}: {f.message(spelling)}" for f in findings))


def warnings_and_errors(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings more serious than an info."""
    return tuple(f for f in findings if f.severity is not Severity.INFO)


def infos(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings that are an info."""
    return tuple(f for f in findings if f.severity is Severity.INFO)


def channel_of(subject: str) -> str:
    """Name of the junction in the name of a channel or column.

    Parameters
    ----------
    subject
        A channel or column such as ``e``, ``e_degC`` or ``fast_e_degC``, or any other text.

    Returns
    -------
    name
        A name as in ``CHANNEL_NAME``; empty for any other text, also for a column of an
        uncertainty such as ``fast_b_u_K``.

    Notes
    -----
    It is in ``core`` because :attr:`Finding.channels` uses it, and ``core`` imports no other
    package.

    Examples
    --------
    >>> [channel_of(subject) for subject in ("e", "e_degC", "fast_e_degC", "slow_e")]
    ['e', 'e', 'e', 'e']
    >>> [channel_of(subject) for subject in ("switch", "load_on_s", "fast", "fast_b_u_K")]
    ['', '', '', '']
    """
    stem = subject.removesuffix("_degC")
    prefix, _, rest = stem.partition("_")
    if prefix in ("fast", "slow"):
        name = rest
    elif stem != subject:
        name = stem.rpartition("_")[2]
    else:
        name = stem
    return name if CHANNEL_NAME.fullmatch(name) else ""


def _plain_value(value: Any) -> Any:
    """A number, text, Boolean, None, or a tuple of them: what JSON can store.

    Raises
    ------
    TypeError
        Any other type.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(_plain_value(v) for v in value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a {type(value).__name__} cannot be stored in a finding")
