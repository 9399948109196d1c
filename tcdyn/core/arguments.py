"""Checks of the arguments of public functions: an error in one line, with what was given.

Guarded by ``tests/core/test_wrong_arguments.py``, which calls the public functions with arguments
of other types.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, Signature, signature
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core.errors import InputError

MAX_TEXT = 40  # characters of a value in a message; by judgement
MIN_SIMILARITY = 0.6  # of a keyword that is proposed: the usual cut-off of ``difflib``


class UnknownKeywordError(TypeError):
    """A keyword argument that a function does not have."""


def described(value: object) -> str:
    """A value in a message: texts and numbers as they are, arrays with their shape, else the type.

    >>> described(None), described(3), described("a" * 60), described(np.zeros((2, 3)))
    ('None', '3', "'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa...'", 'an array of the shape (2, 3)')
    >>> described([1, 2]), described({"T1": 25})
    ('a list', 'a dict')
    """
    if value is None or isinstance(value, bool | int | float | np.number):
        return str(value)
    if isinstance(value, str):
        return repr(value if len(value) <= MAX_TEXT else value[:MAX_TEXT] + "...")
    if isinstance(value, np.ndarray):
        return f"an array of the shape {value.shape}"
    name = type(value).__name__
    return f"an {name}" if name[0] in "aeiouAEIOU" else f"a {name}"


def check_type(
    name: str, value: object, types: type | tuple[type, ...], expected: str, where: str = ""
) -> None:
    """Check the type of an argument.

    Parameters
    ----------
    name
        Name of the argument.
    value
        Its value.
    types
        Types that it may have; a bool is no number.
    expected
        What is expected, in words.
    where
        Function or table, for messages.

    Raises
    ------
    InputError
        For another type.

    Examples
    --------
    >>> check_type("log", 3, str, "the path of a file")
    Traceback (most recent call last):
    tcdyn.core.errors.InputError: log is 3; expected the path of a file
    """
    listed = types if isinstance(types, tuple) else (types,)
    is_bool = isinstance(value, bool) and bool not in listed
    if is_bool or not isinstance(value, types):
        raise InputError(f"{name} is {described(value)}", where=where, expected=expected)


def check_keywords(function: str, given: Collection[str], known: Collection[str]) -> None:
    """Check the names of keyword arguments of a function that passes them on.

    Parameters
    ----------
    function
        Name of the function.
    given
        Names of the arguments.
    known
        Names that there are.

    Raises
    ------
    UnknownKeywordError
        For another name, with the most similar one; it is a TypeError.

    Examples
    --------
    >>> check_keywords("follow", ["untit"], ["unit", "time"])
    Traceback (most recent call last):
    tcdyn.core.arguments.UnknownKeywordError: follow() got an ... 'untit'; did you mean 'unit'?
    """
    for name in given:
        if name in known:
            continue
        near = get_close_matches(name, known, n=1, cutoff=MIN_SIMILARITY)
        hint = f"did you mean {near[0]!r}?" if near else f"they are {', '.join(sorted(known))}"
        raise UnknownKeywordError(
            f"{function}() got an unexpected keyword argument {name!r}; {hint}"
        )


def as_names(name: str, value: object, where: str = "") -> list[str]:
    """Names of columns from one name or several.

    Parameters
    ----------
    name
        Name of the argument.
    value
        One name or several.
    where
        Table, for messages.

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> as_names("columns", "T1"), as_names("columns", ("T1", "T2"))
    (['T1'], ['T1', 'T2'])
    """
    expected = "the name of a column, or a list of names"
    if isinstance(value, str):
        return [value]
    if isinstance(value, Mapping) or not isinstance(value, Collection):
        raise InputError(f"{name} is {described(value)}", where=where, expected=expected)
    names = list(value)
    for each in names:
        if not isinstance(each, str):
            raise InputError(f"{name} holds {described(each)}", where=where, expected=expected)
    return names


Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")
# Errors of Python where an object is not what the code takes it for.
OF_WRONG_TYPES = (TypeError, AttributeError, LookupError, ValueError)


def with_named_arguments(
    function: Callable[Parameters, Returned],
) -> Callable[Parameters, Returned]:
    """A public function whose errors about a wrong type name the argument.

    Where the function fails with an error of Python, its arguments are compared with their type
    hints; of the first that does not agree, there is an InputError. Calls that succeed cost nothing
    and are not restricted to the hints.

    >>> @with_named_arguments
    ... def first_letter(text: str, case: Literal["upper", "lower"] = "upper") -> str:
    ...     return getattr(text[0], case)()
    >>> first_letter("a"), first_letter(["b"])
    ('A', 'B')
    >>> first_letter(None)
    Traceback (most recent call last):
    tcdyn.core.errors.InputError: first_letter: text is None; expected str
    >>> first_letter("a", cse="lower")
    Traceback (most recent call last):
    tcdyn.core.arguments.UnknownKeywordError: first_letter() got ... 'cse'; did you mean 'case'?
    """

    @wraps(function)
    def named(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Returned:
        """Call the function."""
        try:
            return function(*args, **kwargs)
        except (InputError, UnknownKeywordError):
            raise
        except OF_WRONG_TYPES as problem:
            explanation = _explanation(function, args, kwargs)
            if explanation is None:
                raise
            raise explanation from problem

    return named


def _explanation(
    function: Callable[..., Any], args: tuple[Any, ...], kwargs: Mapping[str, Any]
) -> Exception | None:
    """The error that names a wrong argument of a call; None where all agree with their hints."""
    expected_arguments = signature(function)
    name = function.__name__
    try:
        bound = expected_arguments.bind(*args, **kwargs)
    except TypeError as problem:
        parameters = expected_arguments.parameters.values()
        if not any(each.kind is Parameter.VAR_KEYWORD for each in parameters):
            try:
                check_keywords(name, kwargs, expected_arguments.parameters)
            except UnknownKeywordError as misspelt:
                return misspelt
        return TypeError(f"{name}() {problem}")
    hints = _hints(function, expected_arguments)
    for argument, value in bound.arguments.items():
        kind = expected_arguments.parameters[argument].kind
        is_packed = kind in (Parameter.VAR_KEYWORD, Parameter.VAR_POSITIONAL)
        if is_packed or argument not in hints or agrees(value, hints[argument]):
            continue
        hint = hint_text(hints[argument])
        return InputError(f"{argument} is {described(value)}", where=name, expected=hint)
    return None


def _hints(function: Callable[..., Any], of: Signature) -> dict[str, Any]:
    """The type hints of a function; those that only type checkers know as texts."""
    try:
        return get_type_hints(function)
    except NameError:
        known = {}
        for name, parameter in of.parameters.items():
            annotation = str(parameter.annotation)
            try:
                known[name] = eval(annotation, function.__globals__)
            except NameError:
                known[name] = annotation
        return known


def agrees(value: Any, hint: Any) -> bool:
    """Whether a value may be of a type hint; of a hint of another form it is not known: True.

    >>> agrees(3, float | None), agrees([1], list[str]), agrees({"T1": 2.0}, Mapping[str, float])
    (True, False, True)
    >>> agrees("P1", Literal["P1", "P2"]), agrees("T1", list[str]), agrees((1.0,), tuple[str, ...])
    (True, False, False)
    """
    if hint == ArrayLike:
        return _is_array(value)
    if isinstance(hint, str):  # a class that only type checkers import
        names = {each.__name__ for each in type(value).__mro__}
        return not hint.isidentifier() or hint in names
    origin = get_origin(hint)
    if origin in (Union, UnionType):
        return any(agrees(value, each) for each in get_args(hint))
    if origin is Literal:
        return isinstance(value, str | int) and value in get_args(hint)
    if hint is None or hint is type(None):
        return value is None
    if hint in (float, int):
        kind = Real if hint is float else Integral
        return isinstance(value, kind) and not isinstance(value, bool)
    if hint is Path:
        return isinstance(value, str | Path)
    if origin is None:
        try:
            return isinstance(value, hint)
        except TypeError:  # a protocol, a type variable or Any
            return True
    if origin is Callable or not isinstance(origin, type):
        return callable(value) or not isinstance(origin, type)
    if not isinstance(value, origin):
        return False
    parts = [each for each in get_args(hint) if each is not Ellipsis]
    if isinstance(value, Mapping) and len(parts) == 2:
        return all(agrees(k, parts[0]) and agrees(v, parts[1]) for k, v in value.items())
    if len(parts) == 1 and isinstance(value, str):
        return False  # a text is no sequence of names
    if len(parts) == 1 and isinstance(value, list | tuple):
        return all(agrees(each, parts[0]) for each in value)
    return True


def _is_array(value: Any) -> bool:
    """Whether a value is an array of numbers."""
    try:
        return np.asarray(value, dtype=float).ndim > 0
    except (TypeError, ValueError):
        return False


def hint_text(hint: Any) -> str:
    """A type hint as it is read: names of classes, without their modules.

    >>> hint_text(float | None), hint_text(list[str]), hint_text(Literal["a", "b"])
    ('float or None', 'list of str', "'a' or 'b'")
    """
    if hint == ArrayLike:
        return "array of numbers"
    origin = get_origin(hint)
    arguments = [each for each in get_args(hint) if each is not Ellipsis]
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(hint_text(each) for each in arguments))
    if origin is Literal:
        return " or ".join(map(repr, arguments))
    if hint is type(None):
        return "None"
    name = str(getattr(origin or hint, "__name__", hint))
    if not isinstance(origin, type) or not arguments or issubclass(origin, np.ndarray):
        return "array" if name == "ndarray" else name
    if len(arguments) == 2 and issubclass(origin, Mapping):
        return f"{name} of {hint_text(arguments[0])}: {hint_text(arguments[1])}"
    if issubclass(origin, Iterable):
        return f"{name} of {', '.join(hint_text(each) for each in arguments)}"
    return name
