"""False refusals of words for no reading, and false acceptances of text and of other notations.

``python -m tests.io.word_study 400 1`` writes columns of readings with words for no reading, which
must be read, and columns of text or of numbers in another notation, which must be refused. It
prints the share of wrong decisions of each kind.

Of 2400 columns of readings that command finds 18 refused: all have one word in 80 % of their cells,
and fewer than ten different numbers. Of 10,000 columns of text and of other notations it finds none
accepted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation
from tcdyn.io.cells import TextColumn

Rng: TypeAlias = np.random.Generator
Cells: TypeAlias = list[str]

# What Home Assistant, PI, spreadsheets, databases, controllers and hand-held meters write
WORDS = (
    "unavailable",
    "unknown",
    "Bad Input",
    "I/O Timeout",
    "Pt Created",
    "\\N",
    "O.L",
    "<null>",
    "Err:502",
    "#DIV/0!",
    "#REF!",
    "-----",
    "1.#INF",
    "sensor lost",
    "Kein Signal",
    "déconnecté",
    "断线",
    "No Data",
    "+OVER",
    "E05",
)
NOTATIONS: dict[str, Callable[[float], str]] = {
    "flag behind": lambda t: f"{t}*",
    "sign before": lambda t: f"~{t}",
    "unit": lambda t: f"{t} °C",
    "letter for a digit": lambda t: f"{t:.2f}".replace(".", "O."),
    "two points": lambda t: f"{t:.2f}.0",
    "hexadecimal": lambda t: hex(int(100 * t)),
    "name before": lambda t: f"T={t:.2f}",
    "clock": lambda t: f"{int(t)}:{int(100 * t) % 60:02}",
    "fraction": lambda t: f"{int(t)}/{int(100 * t) % 100}",
    "bracket": lambda t: f"({t})",
}


def column_of(rng: Rng, rows: int) -> Cells:
    """Readings after a step, with one to three decimals."""
    decimals = int(rng.integers(1, 4))
    tau = rng.uniform(3, rows / 5)
    entry = rng.uniform(0.1, 0.5) * rows
    step = rng.uniform(5, 500)
    reading = rng.uniform(-20, 100) + step * -np.expm1(
        -np.maximum(np.arange(rows) - entry, 0) / tau
    )
    reading += rng.normal(0, 10 ** rng.uniform(-2, 0), rows)
    return [f"{value:.{decimals}f}" for value in reading]


def _lost_rows(rng: Rng, rows: int, share: float) -> Array:
    """Rows without a reading: single ones, or one block."""
    count = max(1, int(share * rows))
    if rng.random() < 0.5:
        return np.sort(rng.choice(rows, count, replace=False))
    start = int(rng.integers(0, rows - count + 1))
    return np.arange(start, start + count)


def with_words(rng: Rng, rows: int, n_words: int, share: float) -> Cells:
    """Readings with some words for no reading."""
    cells = column_of(rng, rows)
    words = rng.choice(WORDS, n_words, replace=False)
    for k in _lost_rows(rng, rows, share):
        cells[k] = str(rng.choice(words))
    return cells


def in_notation(rng: Rng, rows: int, notation: str, share: float) -> Cells:
    """Readings of which some are in another notation."""
    cells = column_of(rng, rows)
    for k in _lost_rows(rng, rows, share):
        cells[k] = NOTATIONS[notation](abs(float(cells[k])))
    return cells


def _notes(rng: Rng, rows: int) -> Cells:
    """Notes of an operator, of which some are numbers."""
    return [
        f"door {k} open" if rng.random() < 0.6 else str(rng.integers(0, 9)) for k in range(rows)
    ]


def _labels(rng: Rng, rows: int) -> Cells:
    """Names of samples: some are numbers."""
    names = [*(str(k) for k in range(1, 9)), *(f"A{k}" for k in range(1, 9)), "blank", "ref"]
    return [str(name) for name in rng.choice(names, rows)]


def _codes(rng: Rng, rows: int) -> Cells:
    """States of a program: a word mostly, else the number of a step."""
    return ["idle" if rng.random() < 0.7 else str(rng.integers(1, 4)) for _ in range(rows)]


def _addresses(rng: Rng, rows: int) -> Cells:
    """Bytes in hexadecimal digits; some look like numbers."""
    return [f"{value:02X}" for value in rng.integers(0, 256, rows)]


def _events(rng: Rng, rows: int) -> Cells:
    """A log of events in which one text of five is a count."""
    events = [f"user{k}" for k in range(20)]
    return [
        str(rng.choice(events)) if rng.random() < 0.8 else str(rng.integers(0, 100))
        for _ in range(rows)
    ]


TEXTS: dict[str, Callable[[Rng, int], Cells]] = {
    "notes": _notes,
    "labels": _labels,
    "codes of states": _codes,
    "hexadecimal bytes": _addresses,
    "events": _events,
}


def accepts(cells: Cells) -> bool:
    """Whether a column of cells is read as numbers."""
    column = TextColumn("x", ".", SampleLocation("study.csv"))
    try:
        values = column.numbers(cells, 0)
        column.findings(len(cells))
    except InputError:
        return False
    return not column.words and not column.clock and bool(np.isfinite(values).any())


def rates(count: int, seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """Share of readings that are refused, and of text and other notations that are accepted.

    Parameters
    ----------
    count
        Columns of each kind.
    seed
        Seed of the random numbers.
    """
    refused = {}
    for n_words, share in ((1, 0.04), (1, 0.3), (1, 0.8), (3, 0.04), (3, 0.3), (8, 0.04)):
        rng = np.random.default_rng([seed, n_words, int(100 * share)])
        wrong = 0
        for _ in range(count):
            wrong += not accepts(with_words(rng, int(rng.integers(200, 3000)), n_words, share))
        refused[f"{n_words} word(s) in {100 * share:.0f} % of the cells"] = wrong / count
    accepted = {}
    for notation in NOTATIONS:
        for share in (0.04, 0.5):
            rng = np.random.default_rng([seed, len(notation), int(100 * share)])
            wrong = 0
            for _ in range(count):
                wrong += accepts(in_notation(rng, int(rng.integers(200, 3000)), notation, share))
            accepted[f"{notation}, {100 * share:.0f} % of the cells"] = wrong / count
    for kind, make in TEXTS.items():
        rng = np.random.default_rng([seed, len(kind)])
        wrong = sum(accepts(make(rng, int(rng.integers(200, 3000)))) for _ in range(count))
        accepted[kind] = wrong / count
    return refused, accepted


if __name__ == "__main__":
    for title, shares in zip(
        ("refused", "accepted"), rates(int(sys.argv[1]), int(sys.argv[2])), strict=True
    ):
        for kind, share_wrong in shares.items():
            print(f"{kind:40} {title} {100 * share_wrong:6.2f} %")
