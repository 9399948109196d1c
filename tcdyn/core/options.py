"""Options of a flow as data: one dataclass, from which its command and its function are made.

A dataclass of options has a field for each option, with its type and default. The text of an option
is in the docstring of the class (section Attributes). What else is known of an option, such as its
limits, is stated once by :func:`option`. ``tcdyn.cli.common.options_from_docstring`` makes the
options of a command from it, and a function takes the same fields as keyword arguments with
:func:`options_of`. Tests: ``tests/core/test_options.py``.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from difflib import get_close_matches
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

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
_KINDS: dict[type, tuple[type, ...]] = {
    float: (Real,),
    int: (Integral,),
    str: (str,),
    bool: (bool,),
    Path: (str, Path),
}
_EXPECTED = {float: "a number", int: "a whole number", str: "a text", bool: "True or False"}

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
            if kind.takes is None:
                _check_type(each.name, value, types[each.name])
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


def _check_type(name: str, value: Any, annotation: Any) -> None:
    """Check a value against the type of its field, if that is simple.

    Raises
    ------
    InputError
        For a value of another type.
    """
    allowed = get_args(annotation) if _is_union(annotation) else (annotation,)
    simple = [each for each in allowed if each in _KINDS]
    if len(simple) < len([each for each in allowed if each is not NoneType]):
        return  # a sequence, a mapping or a type of its own
    if value is None and NoneType in allowed:
        return
    is_bool = isinstance(value, bool)
    for each in simple:
        if isinstance(value, _KINDS[each]) and (not is_bool or each is bool):
            return
    expected = " or ".join(_EXPECTED.get(each, "a path") for each in simple)
    raise InputError(
        f"{{{name}}} is {short_text(value)}", expected=expected, parameters={name: None}
    )


def _is_union(annotation: Any) -> bool:
    """Whether a type is a union, in either spelling."""
    return get_origin(annotation) in (Union, UnionType)


def short_text(value: Any) -> str:
    """A value of a wrong type for a message: itself if it is short, otherwise its type.

    >>> short_text("abc"), short_text([0] * 100)
    ("'abc'", 'a list')
    """
    if value is None or isinstance(value, bool | int | float | str):
        return f"{value!r:.60}"
    return f"a {type(value).__name__}"


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
    InputError
        For a name that is no option, with the most similar one, and for a value that is not
        allowed.

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
    tcdyn.core.errors.InputError: compensate_table: no option 'delay'; expected delay_s; did you \
mean 'delay_s'?
    """
    names = [each.name for each in fields(kind)]  # type: ignore[arg-type]
    check_names(given, names, function)
    return kind(**given)


def check_names(given: Collection[str], known: Sequence[str], function: str) -> None:
    """Check the names of keyword arguments.

    Parameters
    ----------
    given
        Names that were given.
    known
        Possible names.
    function
        Function that was called, for messages.

    Raises
    ------
    InputError
        For another name, with the most similar one.
    """
    for name in given:
        if name not in known:
            near = get_close_matches(name, known, n=1, cutoff=0.5)
            raise InputError(
                f"no option {name!r}",
                where=function,
                expected=", ".join(known),
                remedy=f"did you mean {near[0]!r}?" if near else "",
            )


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
        parts = value.replace("±", "+-").replace("+/-", "+-").split("+-", 1)
    else:
        parts = value if isinstance(value, list | tuple) else [value]
    try:
        numbers = [float(part) for part in parts if not isinstance(part, str) or part.strip()]
        number, u = [*numbers, 0.0][:2]
    except (TypeError, ValueError):
        raise InputError(
            f"{{{name}}} is {short_text(value)}",
            expected="a number, or a number with its uncertainty: 1.5+-0.1",
            parameters={name: None},
        ) from None
    if not (len(numbers) <= 2 and abs(number) <= limit and 0 <= u <= limit):
        raise InputError(
            f"{{{name}}} is {short_text(value)}",
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
    >>> sorted(split_docstring(short_text)[1])
    ['']
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
