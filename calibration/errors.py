"""The one error that people see: what is wrong, where, what was expected, what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError


def printable(text: str) -> str:
    """The text on one line, signs that steer a terminal spelt out.

    >>> printable("a\\nb.csv")
    'a\\\\nb.csv'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class InputError(ValueError):
    """Input that cannot be used, said in one sentence that names the place and the remedy.

    ``parameters``: what the sentence names as a caller in Python would write it ("window_s=4.2"); a command line
    puts its own options there. ``column``: the one column that it is about, where the rest could go on without it.

    >>> str(InputError("speed_fast_rpm is missing", where="D4.csv", expected="an EHL log",
    ...                remedy="map the column in rig.toml [columns]"))
    'D4.csv: speed_fast_rpm is missing; expected an EHL log; map the column in rig.toml [columns]'
    """

    def __init__(
        self, what: str, *, where: str = "", expected: str = "", remedy: str = "", parameters: tuple[str, ...] = (),
        column: str = "",
    ) -> None:  # fmt: skip
        self.what, self.where, self.expected, self.remedy = what, where, expected, remedy
        self.parameters, self.column = parameters, column
        parts = [what]
        if expected:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__((f"{where}: " if where else "") + "; ".join(parts))

    def at(self, where: str) -> InputError:
        """The same, at a place that was not known where it was raised."""
        return InputError(
            self.what, where=self.where or where, expected=self.expected, remedy=self.remedy,
            parameters=self.parameters, column=self.column,
        )  # fmt: skip


def first_wrong(problem: ValidationError, table: str = "common") -> str:
    """The first thing that is wrong in a file of known keys, its key in front, behind that of its ``table``."""
    first = problem.errors()[0]
    place = ".".join([*([] if table == "common" else [table]), *map(str, first["loc"])])
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        said = "there is no such key"
    elif first["type"] == "value_error":  # a sentence of the tables themselves, value and all
        said = str(first["ctx"]["error"])
    else:
        said = first["msg"] + ("" if first["type"] == "missing" else f" (got {first['input']!r:.60})")
    return f"{place}: {said}" if place else said
