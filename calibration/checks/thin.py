"""A sample of a long table for what needs its whole course but not every row: medians, quantiles, noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.files.table import FloatArray

RUN, MOST = 64, 1 << 17  # rows in a run, so that neighbours stay neighbours; rows kept at most (29 min at 75 Hz)


class Thinned:
    """Every k-th run of 64 rows of columns that come piece by piece, k the power of two that keeps at most ``MOST``.

    A table of up to ``MOST`` rows is kept whole; whatever the pieces, the same rows are kept.

    >>> thin = Thinned()
    >>> for start in (0, 100_000):
    ...     thin.see({"t": np.arange(start, start + 100_000.0)})
    >>> thin.rows[[0, 63, 64]], len(thin.columns["t"])
    (array([  0,  63, 128]), 100032)
    """

    def __init__(self) -> None:
        self.every, self.seen = 1, 0
        self._parts: list[tuple[NDArray[np.int64], dict[str, FloatArray]]] = []

    def see(self, columns: Mapping[str, FloatArray]) -> None:
        """Take notice of the next rows."""
        count = len(next(iter(columns.values())))
        self._parts.append(self._kept(np.arange(self.seen, self.seen + count), columns))
        self.seen += count
        while sum(len(rows) for rows, _ in self._parts) > MOST:
            self.every *= 2
            self._parts = [self._kept(*part) for part in self._parts]

    @property
    def rows(self) -> NDArray[np.int64]:
        """Which rows are kept, counted from 0."""
        return np.concatenate([rows for rows, _ in self._parts])

    @property
    def columns(self) -> dict[str, FloatArray]:
        """The columns at these rows."""
        return {name: np.concatenate([part[name] for _, part in self._parts]) for name in self._parts[0][1]}

    def _kept(
        self, rows: NDArray[np.int64], columns: Mapping[str, FloatArray]
    ) -> tuple[NDArray[np.int64], dict[str, FloatArray]]:
        keep = rows // RUN % self.every == 0
        return rows[keep], {name: values[keep] for name, values in columns.items()}


def thinned(values: FloatArray) -> FloatArray:
    """One column (N,) thinned; see ``Thinned``."""
    if len(values) <= MOST:
        return values
    thin = Thinned()
    thin.see({"": values})
    return thin.columns[""]
