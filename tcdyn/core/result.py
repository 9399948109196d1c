"""Base class of results: summary, dictionary, table for notebooks; and conversion to JSON.

Results that users see derive from ``Result``; ``json_text`` makes the text of JSON files. Guarded by
``tests/core/test_results.py``.
"""

from __future__ import annotations

import dataclasses
import html
import json
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from datetime import date
from os import PathLike, fspath
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from tcdyn.core.findings import Finding, messages

# Characters that control a terminal, or the direction of its text, and that JSON allows as they are.
TERMINAL_CONTROL = re.compile("[\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")

# Most rows of a table in a notebook; chosen by judgement.
MOST_ROWS = 30


class Result(ABC):
    """Base class of results.

    A subclass implements :meth:`summary`, and :meth:`to_dict` and :meth:`card` if the defaults do
    not suffice.

    >>> @dataclasses.dataclass(frozen=True)
    ... class Lag(Result):
    ...     lag_s: float
    ...     def summary(self):
    ...         return f"a lag of {self.lag_s} s"
    >>> Lag(0.7).to_dict(), Lag(0.7)._repr_html_()
    ({'lag_s': 0.7}, '<div class="tcdyn-result"><b>Lag</b><pre>a lag of 0.7 s</pre></div>')
    """

    __slots__ = ()

    @abstractmethod
    def summary(self) -> str:
        """The result as a few lines of text, with units."""

    @property
    def warnings(self) -> Sequence[str]:
        """Messages of the findings, each once; empty if the result has no findings."""
        return messages(getattr(self, "findings", ()))

    def to_dict(self) -> dict[str, Any]:
        """The result as numbers, texts, lists and dicts for ``json.dumps``; keys state units."""
        plain = jsonable(self)
        assert isinstance(plain, dict)
        return plain

    def card(self) -> pd.DataFrame | None:
        """Table that a notebook shows below the summary; None if the summary suffices."""
        return None

    def _repr_html_(self) -> str:
        """Summary and table as HTML, for notebooks."""
        table = self.card()
        table_html = ""
        if table is not None:
            table_html = table.to_html(index=False, max_rows=MOST_ROWS, border=0)
        name = html.escape(type(self).__name__)
        summary = html.escape(self.summary())
        return f'<div class="tcdyn-result"><b>{name}</b><pre>{summary}</pre>{table_html}</div>'


def json_text(value: Any) -> str:
    """``value`` as the text of a JSON file; NaN and infinity are null.

    Characters that control a terminal are escaped.

    >>> json_text("\\x1b[31m \\x9b31m \\u202e")
    '"\\\\u001b[31m \\\\u009b31m \\\\u202e"\\n'
    """
    text = json.dumps(jsonable(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return TERMINAL_CONTROL.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def jsonable(value: Any) -> Any:
    """Convert to what JSON can hold.

    Arrays become lists, tables lists of rows, paths text; NaN and infinity become None.

    Raises
    ------
    TypeError
        For a type that has no form in JSON.

    Examples
    --------
    >>> jsonable({"u": np.array([0.1, np.nan]), "n": np.int64(2)})
    {'u': [0.1, None], 'n': 2}
    >>> jsonable(pd.DataFrame({"a": [1]}))
    [{'a': 1}]
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, np.generic | np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, pd.DataFrame):
        return [{str(k): jsonable(v) for k, v in row.items()} for row in value.to_dict("records")]
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True)
    if isinstance(value, Finding):
        return jsonable(value.to_dict())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: jsonable(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple | Set):
        return [jsonable(v) for v in value]
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, date):
        return value.isoformat()
    raise TypeError(f"a {type(value).__name__} has no form in JSON")
