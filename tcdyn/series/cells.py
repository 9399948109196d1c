"""Rows of a table that hold one cell in a column: a channel of a table of several.

Tests: ``tests/series/test_source.py``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Flags
from tcdyn.core.errors import InputError
from tcdyn.io.cells import is_number, to_number

LISTED_CELLS = 8  # cells that a message names


def has_cell(cells: NDArray[Any], cell: str) -> Flags:
    """Whether cells (N,), text or numbers, are ``cell``.

    >>> has_cell(np.array(["CH 1", " CH 2", None], dtype=object), "CH 2").tolist()
    [False, True, False]
    >>> has_cell(np.array([1.0, 2.0]), "2").tolist()
    [False, True]
    """
    if cells.dtype.kind in "fiub":
        if not is_number(cell):
            return np.zeros(len(cells), dtype=bool)
        return np.asarray(cells == to_number(cell), dtype=bool)
    codes, values = pd.factorize(cells)
    is_value = np.array([*(str(value).strip() == cell for value in values), False], dtype=bool)
    return np.asarray(is_value[codes], dtype=bool)


def missing_cell_error(label: str, cell: str, cells: Iterable[Any], where: str) -> InputError:
    """Error for a cell that no row of a column has, with those that it has.

    Parameters
    ----------
    label
        Name of the column.
    cell
        The cell.
    cells
        Cells of the column.
    where
        The table.
    """
    seen = list(dict.fromkeys(_as_text(each) for each in cells))
    listed = ", ".join(map(repr, seen[:LISTED_CELLS]))
    more = len(seen) - LISTED_CELLS
    return InputError(
        f"no row has {cell!r} in column {label!r}",
        where=where,
        expected=listed + (f" or {more} more" if more > 0 else ""),
        remedy="write the cell as it is in the table, {where}",
        parameters={"where": f"{label}={seen[0] if seen else 'VALUE'}"},
    )


def _as_text(cell: Any) -> str:
    """A cell as text; whole numbers without a point."""
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return str(cell)
