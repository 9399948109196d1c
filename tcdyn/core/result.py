"""Base class of results: summary, dictionary, table, figure; and conversion to JSON.

Results that users see derive from ``Result``; ``json_text`` makes the text of JSON files. Guarded
by ``tests/core/test_results.py``.
"""

from __future__ import annotations

import dataclasses
import html
import json
import math
import re
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from datetime import date
from importlib import import_module
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from tcdyn.core.errors import utf8
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, messages

if TYPE_CHECKING:
    import xarray as xr

# Characters that control a terminal, or the direction of its text, and that JSON allows as they
# are.
TERMINAL_CONTROL = re.compile("[\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
# Chosen by judgement.
MOST_ROWS = 30  # of a table in a notebook
HEADLINE_LENGTH = 200  # characters of the headline in the representation of a result


class Result(ABC):
    """Base class of results.

    A subclass implements :meth:`summary`, and the other methods if the defaults do not suffice. Its
    figure is an entry in ``tcdyn/plots/pick.py``.

    >>> @dataclasses.dataclass(frozen=True, repr=False)
    ... class Lag(Result):
    ...     lag_s: float
    ...     def summary(self):
    ...         return f"a lag of {self.lag_s} s"
    >>> Lag(0.7)
    <Lag: a lag of 0.7 s>
    >>> Lag(0.7).to_dict()
    {'lag_s': 0.7}
    >>> Lag(0.7).to_frame()["value"].to_dict()
    {'lag_s': 0.7}
    """

    __slots__ = ()

    def __repr__(self) -> str:
        """Name of the class and headline."""
        headline = textwrap.shorten(self.headline(), HEADLINE_LENGTH, placeholder=" ...")
        return f"<{type(self).__name__}: {headline}>"

    def __str__(self) -> str:
        """As the representation; ``summary`` is the long form."""
        return repr(self)

    def headline(self) -> str:
        """The most important in one line; by default the first line of the summary."""
        return self.summary().partition("\n")[0]

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

    def to_frame(self) -> pd.DataFrame:
        """The result as a table of numbers.

        Returns
        -------
        DataFrame
            Units are in the names of the columns, in a column ``unit``, or by column in
            ``attrs["units"]``. By default one row for each entry of :meth:`to_dict`.
        """
        entries = pd.json_normalize(self.to_dict()).iloc[0]
        return entries.rename_axis("key").to_frame("value")

    def to_xarray(self) -> xr.Dataset:
        """The table of :meth:`to_frame` as a Dataset of xarray, with units as attributes.

        Raises
        ------
        ImportError
            Without xarray.
        """
        try:
            import_module("xarray")
        except ImportError:
            hint = 'to_xarray needs xarray; install it with: pip install "tcdyn[xarray]"'
            raise ImportError(hint) from None
        frame = self.to_frame()
        dataset: xr.Dataset = frame.to_xarray()
        attributes = dict(frame.attrs)
        for name, unit in attributes.pop("units", {}).items():
            dataset[name].attrs["units"] = unit
        return dataset.assign_attrs(attributes)

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Plot the main figure of the result.

        Parameters
        ----------
        ax
            Axes of matplotlib to plot into; None: those of a new figure.
        **options
            As for the function of ``tcdyn.plots`` that plots it.

        Returns
        -------
        Figure
            The figure of the axes.
        """
        # Figures are a layer above. pandas, too, loads its plotting backend by name.
        return import_module("tcdyn.plots").draw(self, ax, **options).figure

    def card(self) -> pd.DataFrame:
        """Table that a notebook shows below the summary."""
        return self.to_frame().reset_index()

    def _repr_html_(self) -> str:
        """Summary and table as HTML, for notebooks."""
        table_html = self.card().to_html(
            index=False, max_rows=MOST_ROWS, border=0, float_format="{:.6g}".format
        )
        name = html.escape(type(self).__name__)
        summary = html.escape(self.summary())
        return f'<div class="tcdyn-result"><b>{name}</b><pre>{summary}</pre>{table_html}</div>'


def estimates_frame(
    estimates: Mapping[str, Estimate], units: str | Sequence[str] = ""
) -> pd.DataFrame:
    """Table of estimates, one row each.

    Parameters
    ----------
    estimates
        Estimates by name.
    units
        Unit of all, or of each.

    Examples
    --------
    >>> print(estimates_frame({"lag": Estimate.normal(0.7, 0.1)}, "s").round(3).to_csv())
    quantity,value,u,low95,high95,unit
    lag,0.7,0.1,0.504,0.896,s
    <BLANKLINE>
    """
    rows = [(e.value, e.u, e.low95, e.high95) for e in estimates.values()]
    index = pd.Index([*estimates], name="quantity")
    frame = pd.DataFrame(rows, index, ["value", "u", "low95", "high95"])
    return frame.assign(unit=units)


def estimate_columns(name: str, unit: str, estimate: Estimate | None) -> dict[str, float]:
    """Columns of one estimate in a table with several of them.

    Parameters
    ----------
    name, unit
        Name and unit of the quantity; empty without a unit.
    estimate
        The estimate; None: NaN.

    Examples
    --------
    >>> list(estimate_columns("lag", "s", None))
    ['lag_s', 'lag_u_s', 'lag_low95_s', 'lag_high95_s']
    """
    ending = f"_{unit}" if unit else ""
    parts = {"value": "", "u": "_u", "low95": "_low95", "high95": "_high95"}
    return {
        f"{name}{part}{ending}": math.nan if estimate is None else getattr(estimate, field)
        for field, part in parts.items()
    }


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

    Arrays become lists, tables lists of rows, paths text; NaN and infinity become None. Bytes of a
    name that are not UTF-8 become escapes.

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
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return utf8(value)
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
        return {jsonable(str(k)): jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple | Set):
        return [jsonable(v) for v in value]
    if isinstance(value, PathLike):
        return jsonable(fspath(value))
    if isinstance(value, date):
        return value.isoformat()
    raise TypeError(f"a {type(value).__name__} has no form in JSON")
