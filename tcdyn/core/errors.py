"""The one error that people see: what is wrong, where, what was expected, what to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from tcdyn.core.spelling import Spelling, Value, as_argument

if TYPE_CHECKING:
    from pydantic import ValidationError


def printable(text: str) -> str:
    """The text on one line, signs that steer a terminal spelt out.

    >>> printable("a\\nb.csv")
    'a\\\\nb.csv'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class InputError(ValueError):
    """Input that cannot be used. The message names what is wrong, the place and the remedy in one sentence.

    Parameters
    ----------
    what, where, expected, remedy : str
        The parts of the message. ``{name}`` in ``what``, ``expected`` and ``remedy`` stands for a parameter.
    parameters : mapping of str to str, bool or None
        The parameters that the message names, each with the value to give, or None for the name alone.
    column : str
        The one column that the error is about, where the rest could go on without it.

    Examples
    --------
    >>> problem = InputError("no time column found", where="D4.csv", expected="one of 't', 'u'",
    ...                      remedy="name it, {time}", parameters={"time": "COLUMN"})
    >>> str(problem)
    "D4.csv: no time column found; expected one of 't', 'u'; name it, time=COLUMN"
    >>> problem.message(lambda name, value: f"--{name} {value}")
    "D4.csv: no time column found; expected one of 't', 'u'; name it, --time COLUMN"
    """

    def __init__(
        self,
        what: str,
        *,
        where: str = "",
        expected: str = "",
        remedy: str = "",
        parameters: Mapping[str, Value] | None = None,
        column: str = "",
    ) -> None:
        self.what = what
        self.where = where
        self.expected = expected
        self.remedy = remedy
        self.parameters = dict(parameters or {})
        self.column = column
        super().__init__(self.message())

    def message(self, spelling: Spelling = as_argument) -> str:
        """The whole sentence, its parameters in the given spelling."""
        parts = [self.what]
        if self.expected:
            parts.append(f"expected {self.expected}")
        if self.remedy:
            parts.append(self.remedy)
        text = "; ".join(parts)
        for name, value in self.parameters.items():
            text = text.replace(f"{{{name}}}", spelling(name, value))
        return f"{self.where}: {text}" if self.where else text

    def at(self, where: str) -> InputError:
        """The same, at a place that was not known where it was raised."""
        return InputError(
            self.what,
            where=self.where or where,
            expected=self.expected,
            remedy=self.remedy,
            parameters=self.parameters,
            column=self.column,
        )


def first_wrong(problem: ValidationError, table: str = "common") -> str:
    """The first thing that is wrong in a file of known keys, its key in front, behind that of its ``table``."""
    first = problem.errors()[0]
    place = ".".join([*([] if table == "common" else [table]), *map(str, first["loc"])])
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        said = "there is no such key"
    elif first["type"] == "value_error":  # a sentence of the tables themselves, value and all
        said = str(first["ctx"]["error"])
    else:
        said = first["msg"] + (
            "" if first["type"] == "missing" else f" (got {first['input']!r:.60})"
        )
    return f"{place}: {said}" if place else said
