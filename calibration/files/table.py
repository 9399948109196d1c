"""What every reader of a form of file gives: named columns of numbers, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from calibration.arrays import Array
from calibration.finding import Finding

PIECE_ROWS = 50_000


@dataclass(frozen=True)
class RowNumbers:
    """What people see in an editor: a sample's line is ``first`` plus the samples and blank lines before it.

    ``before``: samples of earlier pieces.
    """

    first: int = 1
    blank: tuple[int, ...] = ()
    before: int = 0

    def of(self, index: int) -> int:
        """Line number of sample ``index`` of this piece."""
        line = self.first + self.before + int(index)
        for gap in self.blank:
            line += gap <= line
        return line

    def after(self, samples: int) -> RowNumbers:
        """The numbers of what follows ``samples`` samples."""
        return RowNumbers(self.first, self.blank, self.before + samples)


@dataclass(frozen=True)
class Columns:
    """The wanted columns, float64 of shape (N,), NaN where the file has no number; findings say what was done."""

    data: dict[str, Array]
    findings: tuple[Finding, ...] = ()
    rows: RowNumbers = field(default_factory=RowNumbers)

    def in_pieces(self, rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The same columns, ``rows`` rows at a time; the findings come with the first."""
        for start in range(0, len(next(iter(self.data.values()))), rows):
            part = {name: values[start : start + rows] for name, values in self.data.items()}
            yield Columns(part, () if start else self.findings, self.rows.after(start))


class Table(Protocol):
    """What every reader offers."""

    @property
    def names(self) -> tuple[str, ...]:
        """The columns' names as the file has them."""
        ...

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says about itself."""
        ...

    def pieces(self, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The wanted columns by their names in the file, about ``rows`` rows at a time; may be asked for again."""
        ...


def read_whole(table: Table, wanted: Sequence[str]) -> Columns:
    """The wanted columns of the whole file: its pieces joined."""
    parts = list(table.pieces(wanted))
    data = {name: np.concatenate([np.empty(0), *(part.data[name] for part in parts)]) for name in wanted}
    return Columns(data, tuple(f for part in parts for f in part.findings), parts[0].rows if parts else RowNumbers())


def shown(path: Path) -> str:
    """The path as errors show it: printable, on one line.

    >>> shown(Path("a\\nb.csv"))
    'a\\\\nb.csv'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(path))
