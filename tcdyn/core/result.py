"""What every result can do besides holding its numbers: say them, give them to other programs, show in a notebook."""

from __future__ import annotations

import dataclasses
import html
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from datetime import date
from os import PathLike, fspath
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from tcdyn.core.findings import Finding, messages

MOST_ROWS = 30  # of a table in a notebook; the rest stays in the result


class Result(ABC):
    """Base of results: a class gives :meth:`summary`, and :meth:`to_dict` and :meth:`card` where it has more to say.

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
        """The result in a few lines of words, units included."""

    @property
    def warnings(self) -> Sequence[str]:
        """What was noticed (``findings``) in words, each once; nothing where a result keeps none."""
        return messages(getattr(self, "findings", ()))

    def to_dict(self) -> dict[str, Any]:
        """The result as plain numbers, texts, lists and dicts, ready for ``json.dumps``; keys carry units."""
        plain = jsonable(self)
        assert isinstance(plain, dict)
        return plain

    def card(self) -> pd.DataFrame | None:
        """The table that a notebook shows under the words; None where the words are enough."""
        return None

    def _repr_html_(self) -> str:
        """The words and the table, for notebooks."""
        table = self.card()
        shown = "" if table is None else table.to_html(index=False, max_rows=MOST_ROWS, border=0)
        name = html.escape(type(self).__name__)
        return f'<div class="tcdyn-result"><b>{name}</b><pre>{html.escape(self.summary())}</pre>{shown}</div>'


def json_text(value: Any) -> str:
    """``value`` as the text of a JSON file: what is not a number is null."""
    return json.dumps(jsonable(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def jsonable(value: Any) -> Any:
    """``value`` as JSON can hold it: arrays as lists, tables as rows, paths as text; NaN and infinity become None.

    Raises TypeError for what has no such form.

    >>> jsonable({"u": np.array([0.1, np.nan]), "table": pd.DataFrame({"a": [1]}), "n": np.int64(2)})
    {'u': [0.1, None], 'table': [{'a': 1}], 'n': 2}
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
