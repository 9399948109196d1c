"""Error for unusable input: what is wrong, where, what was expected, what to do.

Checks of input raise ``InputError``. The command line prints its message without a traceback
and spells parameters as options. Guarded by ``tests/cli/test_refused_calls.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

from collections.abc import Callable

# Value of a parameter in a message, or several; None where the name alone is meant.
Value = str | bool | list[str] | None
# How a message writes a parameter: function of name and value.
Spelling = Callable[[str, Value], str]


def as_argument(name: str, value: Value = None) -> str:
    """A parameter as a Python argument; without a value its name alone.

    Parameters
    ----------
    name
        Name of the parameter.
    value
        Value to give; None for the name alone.

    Examples
    --------
    >>> as_argument("window_s", "4.2"), as_argument("sensor_check", False), as_argument("delay_s")
    ('window_s=4.2', 'sensor_check=False', 'delay_s')
    >>> as_argument("where", "Channel=CH 1")
    "where='Channel=CH 1'"
    """
    if isinstance(value, str) and re.search(r"[\s=]", value):
        return f"{name}={value!r}"
    return name if value is None else f"{name}={value}"


def printable(text: str) -> str:
    """The text on one line, with control characters escaped.

    >>> printable("a\\nb.csv")
    'a\\\\nb.csv'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


# Exceptions of code that takes the content of a file apart, where it is not what it should be.
DAMAGED = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError)


def utf8(text: str) -> str:
    """The text with escapes for what is not UTF-8, such as single bytes in the name of a file.

    >>> utf8("caf\\udce9.csv"), utf8("café.csv")
    ('caf\\\\udce9.csv', 'café.csv')
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


class InputError(ValueError):
    """Input that cannot be used.

    Parameters
    ----------
    what : str
        What is wrong.
    where : str
        Location, for example the name of a file.
    expected : str
        What was expected.
    remedy : str
        What to do.
    parameters : mapping of str to str, bool or None
        Parameters that the message names as ``{name}``, each with the value to give, or None for
        the name alone.
    column : str
        The column that the error is about, if the others can be used without it.

    Examples
    --------
    >>> problem = InputError(
    ...     "no time column found",
    ...     where="D4.csv",
    ...     expected="one of 't', 'u'",
    ...     remedy="name it, {time}",
    ...     parameters={"time": "COLUMN"},
    ... )
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
        """Store the parts, and make the message with parameters spelled as Python arguments."""
        self.what = what
        self.where = where
        self.expected = expected
        self.remedy = remedy
        self.parameters = dict(parameters or {})
        self.column = column
        super().__init__(self.message())

    def message(self, spelling: Spelling = as_argument) -> str:
        """The message, with its parameters in the given spelling.

        Parameters
        ----------
        spelling
            Function of name and value that gives the text of a parameter.
        """
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
        """A copy with the location ``where``, unless the error has one."""
        return InputError(
            self.what,
            where=self.where or where,
            expected=self.expected,
            remedy=self.remedy,
            parameters=self.parameters,
            column=self.column,
        )


def first_validation_error(problem: ValidationError, table: str = "common") -> str:
    """Message for the first error of a validation, with the key in front.

    Parameters
    ----------
    problem
        Error of pydantic.
    table
        Table of the file that the key belongs to.

    Notes
    -----
    Further errors of the same file are not reported; the user meets them after the first is
    corrected.
    """
    first = problem.errors()[0]
    keys = [str(key) for key in first["loc"]]
    if table != "common":
        keys.insert(0, table)
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        text = "there is no such key"
    elif first["type"] == "value_error":  # a message of the model itself, with the value
        text = str(first["ctx"]["error"])
    elif first["type"] == "missing":
        text = first["msg"]
    else:
        text = f"{first['msg']} (got {first['input']!r:.60})"
    location = ".".join(keys)
    return f"{location}: {text}" if location else text
