"""Options of a flow as data: one dataclass, from which its command and its function are made.

A dataclass of options has a field for each option, with its type and default. The text of an option
is in the docstring of the class (section Attributes). What else is known of an option, such as its
limits, is stated once by :func:`option`. ``tcdyn.cli.common.options_from_docstring`` makes the
options of a command from it, and a function takes the same fields as keyword arguments with
:func:`options_of`. Tests: ``tests/core/test_option_classes.py``.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from math import isinf
from numbers import Real
from typing import Any, Literal, TypeVar, get_args, get_type_hints

from tcdyn.core.arguments import agrees, check_keywords, described, hint_text
from tcdyn.core.errors import InputError

Panel = Literal["Input", "Sensor", "Model", "Output", "Advanced", "Two-disk rig"]
# In the order of the help.
PANELS: tuple[Panel, ...] = get_args(Panel)
# A number, a number with its standard uncertainty, or both as a text such as "1.5+-0.1".
NumberWithU = float | tuple[float, float] | str
# Largest absolute value of a number with its uncertainty, if nothing else is stated: beyond it a
# number is a mistake.
LARGEST_NUMBER = 1e9
_KEY = "option"  # of the metadata of a field

Group = TypeVar("Group")


@dataclass(frozen=True)
class OptionKind:
    """What is known of an option beside its type, its default and its text.

    Attributes
    ----------
    panel
        Group of options in which the help shows it.
    low, high
        Limits of a number.
    ends
        Whether the limits themselves are allowed.
    choices
        Possible values of a text; empty: any.
    name
        Name of the option, if it is not that of the field; without dashes.
    short
        Short name of the option with its dash, such as "-u".
    takes
        Type on the command line, if the field accepts more than a word can state.
    """

    panel: Panel = "Input"
    low: float | None = None
    high: float | None = None
    ends: bool = True
    choices: tuple[str, ...] = ()
    name: str = ""
    short: str = ""
    takes: Any = None

    def check(self, name: str, value: Any) -> None:
        """Check a value, or each value of a sequence.

        Parameters
        ----------
        name
            Name of the field.
        value
            Its value; None is not checked.

        Raises
        ------
        InputError
            For a number beyond the limits, and a text that is no choice.
        """
        values = value if isinstance(value, list | tuple) else [value]
        for each in values:
            if each is None:
                continue
            if self.choices and each not in self.choices:
                raise InputError(
                    f"{{{name}}} is {each!r}",
                    expected=" or ".join(self.choices),
                    parameters={name: None},
                )
            if self.low is not None and self.high is not None and isinstance(each, Real):
                self._check_number(name, float(each), self.low, self.high)

    def _check_number(self, name: str, number: float, low: float, high: float) -> None:
        """Raise InputError for a number beyond the limits, or NaN."""
        if low < number < high or (self.ends and low <= number <= high):
            return
        expected = f"{low:g} to {high:g}" if self.ends else f"above {low:g} and below {high:g}"
        if isinf(high):
            expected = f"at least {low:g}"
        raise InputError(f"{{{name}}} is {number:g}", expected=expected, parameters={name: None})


def option(default: Any = None, panel: Panel = "Input", **known: Any) -> Any:
    """A field of a dataclass of options.

    Parameters
    ----------
    default
        Its default.
    panel
        Group of options in which the help shows it.
    known
        Further attributes of :class:`OptionKind`.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Delay(Options):
    ...     delay_s: float | None = option(None, "Advanced", low=0, high=1e7)
    >>> Delay(2.0).delay_s
    2.0
    >>> Delay(-1.0)
    Traceback (most recent call last):
    ...
    tcdyn.core.errors.InputError: delay_s is -1; expected 0 to 1e+07
    """
    return field(default=default, metadata={_KEY: OptionKind(panel, **known)})


def option_kind(of: Field[Any]) -> OptionKind:
    """What is known of the option of a field of a dataclass."""
    kind = of.metadata.get(_KEY, OptionKind())
    assert isinstance(kind, OptionKind)
    return kind


@dataclass(frozen=True)
class Options:
    """Base class of options: types, limits and choices are checked when they are made."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises
        ------
        InputError
            For a value of another type, beyond the limits, or that is no choice.
        """
        types = get_type_hints(type(self))
        for each in fields(self):
            kind = option_kind(each)
            value = getattr(self, each.name)
            if kind.takes is None and not agrees(value, types[each.name]):
                raise InputError(
                    f"{{{each.name}}} is {described(value)}",
                    expected=hint_text(types[each.name]),
                    parameters={each.name: None},
                )
            kind.check(each.name, value)

    @property
    def stated(self) -> dict[str, Any]:
        """The options that differ from their defaults, by name."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        defaults = {each.name: default_of(each) for each in fields(self)}
        return {name: value for name, value in values.items() if value != defaults[name]}


def default_of(of: Field[Any]) -> Any:
    """Default of a field."""
    if of.default_factory is not MISSING:
        return of.default_factory()
    return of.default


def options_of(kind: type[Group], given: Mapping[str, Any], function: str = "") -> Group:
    """Options from keyword arguments.

    Parameters
    ----------
    kind
        Dataclass of the options.
    given
        Keyword arguments: its fields by name.
    function
        Function that was called, for messages.

    Returns
    -------
    options
        The options.

    Raises
    ------
    UnknownKeywordError
        For a name that is no option, with the most similar one.
    InputError
        For a value that is not allowed.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Delay(Options):
    ...     delay_s: float | None = None
    >>> options_of(Delay, {"delay_s": 2}, "compensate_table").delay_s
    2
    >>> options_of(Delay, {"delay": 2}, "compensate_table")
    Traceback (most recent call last):
    ...
    tcdyn.core.arguments.UnknownKeywordError: compensate_table() got ... did you mean 'delay_s'?
    """
    names = [each.name for each in fields(kind)]  # type: ignore[arg-type]
    check_keywords(function, given, names)
    return kind(**given)


def parse_number_with_u(text: str) -> tuple[float, float] | None:
    """A number and its standard uncertainty as they are written; None for any other text.

    >>> parse_number_with_u("1.5 ± 0.1"), parse_number_with_u("2"), parse_number_with_u("a.json")
    ((1.5, 0.1), (2.0, 0.0), None)
    """
    number, _, u = text.replace("±", "+-").replace("+/-", "+-").partition("+-")
    try:
        return float(number), float(u) if u.strip() else 0.0
    except ValueError:
        return None


def number_with_u(
    value: NumberWithU, name: str, limit: float = LARGEST_NUMBER
) -> tuple[float, float]:
    """A number and its standard uncertainty.

    Parameters
    ----------
    value
        A number, a number with its standard uncertainty, or a text such as "1.5+-0.1", "1.5 ± 0.1"
        or "1.5".
    name
        Name of the option, for the message.
    limit
        Largest absolute value.

    Returns
    -------
    number, u
        u is zero if none is given.

    Raises
    ------
    InputError
        Another text, or numbers beyond the limit.

    Examples
    --------
    >>> number_with_u("1.5+-0.1", "tau_s"), number_with_u("2", "tau_s"), number_with_u(2, "tau_s")
    ((1.5, 0.1), (2.0, 0.0), (2.0, 0.0))
    """
    parts: Sequence[Any]
    if isinstance(value, str):
        parts = parse_number_with_u(value) or (value,)
    else:
        parts = value if isinstance(value, list | tuple) else [value]
    try:
        numbers = [float(part) for part in parts if not isinstance(part, str) or part.strip()]
        number, u = [*numbers, 0.0][:2]
    except (TypeError, ValueError):
        raise InputError(
            f"{{{name}}} is {described(value)}",
            expected="a number, or a number with its uncertainty: 1.5+-0.1",
            parameters={name: None},
        ) from None
    if not (len(numbers) <= 2 and abs(number) <= limit and 0 <= u <= limit):
        raise InputError(
            f"{{{name}}} is {described(value)}",
            expected=f"a number within {limit:g}, its uncertainty not negative",
            parameters={name: None},
        )
    return number, u


def split_docstring(documented: Any) -> tuple[str, dict[str, str]]:
    """The text of a docstring above its first section, and its parameters with their texts.

    Parameters
    ----------
    documented
        A function or a class with a docstring as of numpydoc.

    Returns
    -------
    text, texts
        The text, and one line of text for each parameter or attribute.

    Examples
    --------
    >>> split_docstring(OptionKind)[1]["low, high"]
    'Limits of a number.'
    """
    text, *sections = re.split(r"\n\n(.+)\n-+\n", inspect.getdoc(documented) or "")
    titles = dict(zip(sections[::2], sections[1::2]))
    entries = titles.get("Parameters", titles.get("Attributes", ""))
    texts = {}
    for entry in re.split(r"\n(?=\S)", entries):
        name, _, lines = entry.partition("\n")
        texts[name] = " ".join(lines.split())
    return text, texts


def texts_of(group: type[Any]) -> dict[str, str]:
    """Text of each field of a dataclass, by the docstrings of the class and its base classes."""
    texts: dict[str, str] = {}
    for each in reversed(group.__mro__):
        if is_dataclass(each):
            texts |= split_docstring(each)[1]
    return texts
