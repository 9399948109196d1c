"""Tables of a page: numbers right and unbroken, words left, a value and its uncertainty rounded alike."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from numbers import Real

import pandas as pd

from calibration.estimate import Estimate, with_u

SIGNS = (("+-", "±"), (" degC", " °C"), ("W/m2K", "W/m²K"), ("W/mK", "W/m K"), ("kg/m3", "kg/m³"), ("mm2/s", "mm²/s"))
UNIT = re.compile(r"\[[^\]]*\]")
SHORT = 20  # rows; a table of so many stays on one printed page
LONG = 28  # characters; beyond it a cell is a sentence, or a word to be broken


def typeset(text: str) -> str:
    """Plain words as a page shows them.

    >>> typeset("0.681 +- 0.009 at 110 degC in fast_a_degC")
    '0.681 ± 0.009 at 110 °C in fast_a_degC'
    """
    for plain, sign in SIGNS:
        text = text.replace(plain, sign)
    return text


def pm(values: Iterable[float], uncertainties: Iterable[float]) -> list[str]:
    """Cells "value ± u": the standard uncertainty to two digits, the value rounded to match; empty for nan.

    >>> pm([0.68149, float("nan")], [0.0093, 0.1])
    ['0.6815 ± 0.0093', '']
    """
    return ["" if v != v else typeset(with_u(float(v), float(u))) for v, u in zip(values, uncertainties)]


def table_html(table: pd.DataFrame) -> str:
    """The table as HTML: numbers right and unbroken, words left, long sentences in a column wide enough to read."""
    columns = [[cell(v) for v in table.iloc[:, k]] for k in range(table.shape[1])]
    kinds = [_kind(cells) for cells in columns]
    head = "".join(f'<th class="{k}">{_heading(str(name))}</th>' for name, k in zip(table.columns, kinds))
    rows = (
        "<tr>" + "".join(f'<td class="{k}">{html.escape(c)}</td>' for c, k in zip(row, kinds)) + "</tr>"
        for row in zip(*columns)
    )
    short = ' class="short"' if len(table) <= SHORT else ""
    return f"<table{short}><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def cell(value: object) -> str:
    """A cell's text; a bare number, whose uncertainty nobody stated, with four digits.

    >>> cell(Estimate.normal(0.6543, 0.0123)), cell(745.88532), cell(True), cell(None)
    ('0.654 ± 0.012', '745.9', 'yes', '')
    """
    if value is None or value != value:
        return ""
    if isinstance(value, Estimate):
        return typeset(value.text())
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Real) and not isinstance(value, int):
        return f"{float(value):.4g}"
    return typeset(str(value))


def _heading(name: str) -> str:
    """A column's name, its unit kept in one piece."""
    return UNIT.sub(lambda unit: f'<span class="unit">{unit[0]}</span>', html.escape(typeset(name)))


def _kind(cells: list[str]) -> str:
    """ "prose" for sentences, "long" for unbroken words, "words" for short text, "number" for all else."""
    if any(len(c) > LONG and " " in c for c in cells):
        return "prose"
    if any(len(c) > LONG for c in cells):
        return "long"
    filled = [c for c in cells if c]
    return "words" if filled and not any(c[0] in "0123456789+-.<" for c in filled) else "number"
