"""How a message names a parameter: as an argument in Python, or in the spelling that another interface uses."""

from __future__ import annotations

from collections.abc import Callable

Value = str | bool | None
Spelling = Callable[[str, Value], str]


def as_argument(name: str, value: Value = None) -> str:
    """A parameter as a caller in Python writes it; without a value its name alone.

    >>> as_argument("window_s", "4.2"), as_argument("sensor_check", False), as_argument("learn_s")
    ('window_s=4.2', 'sensor_check=False', 'learn_s')
    """
    return name if value is None else f"{name}={value}"
