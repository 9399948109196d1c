"""The column of a table that a name from the user means, with or without its unit.

Every command and function that takes the name of a column finds it here. Guarded by
``tests/cli/test_column_names.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from difflib import get_close_matches

from tcdyn.core.errors import InputError
from tcdyn.io.unit_names import is_same_name, without_unit

MIN_SIMILARITY = 0.6  # of a name that is proposed: the usual cut-off of ``difflib``


def column_named(
    name: str,
    columns: Collection[str],
    where: str,
    *,
    role: str = "column",
    stem: Callable[[str], str] = without_unit,
) -> str:
    """The column that a name means: exactly that one, else the one of that name without units.

    Parameters
    ----------
    name
        Name with or without a unit.
    columns
        Names of the columns of the table.
    where
        The table, for messages.
    role
        What the column is, at the start of the message.
    stem
        Returns the name of a column without its unit. Times and frequency responses have more units
        than other columns.

    Raises
    ------
    InputError
        For a name that no column or several columns have, and for one that is no text.

    Examples
    --------
    >>> column_named("T1", ["time_s", "T1_degC"], "log.csv")
    'T1_degC'
    >>> column_named("T1", ["T1 [°C]", "T1 [V]"], "log.csv")
    Traceback (most recent call last):
    tcdyn.core.errors.InputError: log.csv: column 'T1' may be 'T1 [°C]' or 'T1 [V]'; expected ...
    """
    if not isinstance(name, str):
        raise InputError(
            f"the {role} is given as {type(name).__name__}", where=where, expected="its name"
        )
    if name in columns:
        return name
    same = same_columns(name, columns, stem)
    if len(same) > 1:
        raise InputError(
            f"{role} {name!r} may be {' or '.join(map(repr, same))}",
            where=where,
            expected="one of them, with its unit",
        )
    if not same:
        raise missing_column_error(role, name, columns, where)
    return same[0]


def same_columns(
    name: str, columns: Collection[str], stem: Callable[[str], str] = without_unit
) -> list[str]:
    """The columns that have a name, with or without its unit; the parameters of ``column_named``.

    >>> same_columns("T1", ["T1_degC", "T1 [V]", "T10"]), same_columns("T1_K", ["T1_kW"])
    (['T1_degC', 'T1 [V]'], [])
    """
    same = [each for each in columns if is_same_name(name, each) or stem(each) == name.strip()]
    return list(dict.fromkeys(same))


def missing_column_error(role: str, name: str, names: Collection[str], where: str) -> InputError:
    """Error for a column that does not exist, with the most similar name.

    Parameters
    ----------
    role
        What the column is, at the start of the message.
    name
        Name of the column.
    names
        Names of the columns that exist.
    where
        The file, for messages.
    """
    near = get_close_matches(name, names, n=1, cutoff=MIN_SIMILARITY)
    if not near:  # a long unit makes names less similar
        by_stem = {without_unit(each): each for each in names}
        near = [by_stem[stem] for stem in get_close_matches(name, by_stem, 1, MIN_SIMILARITY)]
    return InputError(
        f"{role} {name!r} is missing",
        where=where,
        expected=f"one of {', '.join(map(repr, names))}",
        remedy=f"did you mean {near[0]!r}?" if near else "",
    )
