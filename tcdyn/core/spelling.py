"""Spelling of parameters in messages: as Python arguments, or as command-line options."""

from __future__ import annotations

from collections.abc import Callable

Value = str | bool | None
Spelling = Callable[[str, Value], str]


def as_argument(name: str, value: Value = None) -> str:
    """A parameter as a Python argument; without a value its name alone.

    >>> as_argument("window_s", "4.2"), as_argument("sensor_check", False), as_argument("learn_s")
    ('window_s=4.2', 'sensor_check=False', 'learn_s')
    """
    return name if value is None else f"{name}={value}"
