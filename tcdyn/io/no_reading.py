"""Cells of a column of readings that are no number: words for no reading, or damage.

Loggers write many words where they have no reading, and no list holds them all. A word is told by
its rarity: the column holds numbers, and few texts stand between them. Texts that are a number in
another notation, such as "1,5" between 1.5 and 1.6, are no words. Used by
:mod:`tcdyn.io.cells`; guarded by ``tests/io/test_words.py``. False refusals and false acceptances:
``python -m tests.io.word_study``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, warning

# Damaged numbers that are taken as missing with a warning: this share of the rows, or this number
# in a short column. More are another notation. By judgement.
DAMAGED_SHARE = 0.01
DAMAGED_CELLS = 3
# Different texts that may stand for no reading in any number, and different texts with digits that
# may stand for it at all. A logger writes one or two, Home Assistant and PI four. At 6 the study
# (``python -m tests.io.word_study 400 1``) refuses no readings that are half of the cells or more,
# and accepts no text.
FEW_TEXTS = 6
# Share of the filled cells up to which words without digits may all differ. By judgement: notes of
# an operator between readings are no readings either.
RARE_SHARE = 0.1
# A column with more words than numbers holds readings if it has at least so many different numbers
# for each word: a sensor that is open for most of the record. Labels such as 1, 2, A3, OK have
# about one, codes of states in the study up to three.
NUMBERS_PER_WORD = 10
LIMIT_SIGNS = "<>≤≥"
LEVELS = NUMBERS_PER_WORD * FEW_TEXTS  # different numbers of a column that are enough
CELLS_OF_LEVELS = 1000  # numbers of a chunk in which they are looked for; time
MAX_TEXTS = 1000  # different texts that are kept; memory
SHOWN_TEXTS = 5  # in a message
LONGEST_SHOWN = 40  # characters of a text in a message
# Text that begins with a number, or has one with a decimal mark: "<0.5", "20.1*", "12:30", "T=2.5".
# Of "1.#INF" (C library of Windows) the digit is no number.
_NUMBER_LIKE = re.compile(r"[^\w]*\d(?!\.#)|.*\d[.,]\d", re.DOTALL)
_FIRST_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)?")


def is_number_like(text: str) -> bool:
    """Whether a cell that is no number shows one in another notation.

    >>> [is_number_like(text) for text in ("1,5", "<0.5", "T=21.3", "20.1*", "12:30")]
    [True, True, True, True, True]
    >>> [is_number_like(text) for text in ("unavailable", "Err 12", "#DIV/0!", "1.#INF", "---")]
    [False, False, False, False, False]
    """
    return _NUMBER_LIKE.match(text) is not None


def are_mostly_numbers(n_words: int, n_numbers: int, different: Mapping[str, int]) -> bool:
    """Whether a column with words holds readings, by its numbers.

    Parameters
    ----------
    n_words, n_numbers
        Number of its cells that are words, and that are numbers.
    different
        Number of different texts and of different numbers: "words" and "numbers".

    Examples
    --------
    >>> are_mostly_numbers(12, 288, {"words": 1, "numbers": 80})
    True
    >>> are_mostly_numbers(200, 100, {"words": 1, "numbers": 80})
    True
    >>> are_mostly_numbers(200, 100, {"words": 2, "numbers": 3})
    False
    """
    if n_words <= n_numbers:
        return True
    return different["numbers"] >= NUMBERS_PER_WORD * different["words"]


@dataclass
class OtherCells:
    """The cells of a column of readings that are no number, in one chunk or in many.

    Attributes
    ----------
    name, decimal, location
        Name of the column, decimal mark, and location of its samples, for messages.
    counts
        Number of cells by text; of more than ``MAX_TEXTS`` texts the rest is left out.
    first_rows
        Index of the first of them in the file, by text.
    more
        Number of cells whose text is left out.
    absent
        Number of cells without a value.
    levels
        Different numbers of the column, ``LEVELS`` or more if there are so many.
    low, high
        Range of its numbers.
    """

    name: str
    decimal: str
    location: SampleLocation
    counts: Counter[str] = field(default_factory=Counter)
    first_rows: dict[str, int] = field(default_factory=dict)
    more: int = 0
    absent: int = 0
    levels: set[float] = field(default_factory=set)
    low: float = np.inf
    high: float = -np.inf

    def add(self, text: str, index: int) -> None:
        """Count a cell that is no number, by its text and its index in the file."""
        if text in self.counts:
            self.counts[text] += 1
        elif len(self.counts) < MAX_TEXTS:
            self.counts[text] = 1
            self.first_rows[text] = index
        else:
            self.more += 1

    def add_numbers(self, values: Array) -> None:
        """Note the range and the different values of the numbers of a chunk (N,)."""
        numbers = values[np.isfinite(values)]
        if not len(numbers):
            return
        self.low = min(self.low, float(numbers.min()))
        self.high = max(self.high, float(numbers.max()))
        if len(self.levels) < LEVELS:
            every = -(-len(numbers) // CELLS_OF_LEVELS)
            self.levels.update(numbers[::every].tolist())

    def findings(self, cells: int, is_complete: bool) -> list[Finding]:
        """Warnings about words and damaged numbers.

        Parameters
        ----------
        cells
            Number of all cells of the column.
        is_complete
            Whether a column that holds no readings is an error and not a warning.

        Raises
        ------
        InputError
            For numbers in another notation, and for a column of text.
        """
        damaged = self._damaged()
        words = {text: n for text, n in self.counts.items() if text not in damaged}
        n_damaged = sum(damaged.values())
        n_words = sum(words.values()) + self.more
        if is_complete:
            self._check_notation(damaged, cells)
            n_numbers = cells - self.absent - n_damaged - n_words
            self._check_words(words, n_words, n_numbers)
        findings = []
        if words:
            first = min(words, key=lambda text: self.first_rows[text])
            findings.append(
                warning(
                    "text.error_word",
                    subject=self.name,
                    count=n_words,
                    row=self.location.row(self.first_rows[first]),
                    table_row=self.first_rows[first] + 1,
                    text=first[:LONGEST_SHOWN],
                    words=_with_counts(words),
                )
            )
        if damaged:
            first = min(damaged, key=lambda text: self.first_rows[text])
            findings.append(
                warning(
                    "text.no_number",
                    subject=self.name,
                    count=n_damaged,
                    row=self.location.row(self.first_rows[first]),
                    table_row=self.first_rows[first] + 1,
                    text=first[:LONGEST_SHOWN],
                )
            )
        return findings

    def _damaged(self) -> dict[str, int]:
        """The texts that are numbers in another notation, with their counts.

        A code is none: one text that repeats, and that is a limit, such as ">1372", or whose number
        is far outside of the numbers of the column, such as "9999 E". No reading is written so.
        """
        found = {text: count for text, count in self.counts.items() if is_number_like(text)}
        if len(found) != 1:
            return found
        text, count = next(iter(found.items()))
        match = _FIRST_NUMBER.search(text)
        if match is None or count == 1:
            return found
        value = float(match[0].replace(",", "."))
        far = max(self.high - self.low, abs(self.low), abs(self.high))
        is_outside = not self.low - far <= value <= self.high + far
        return {} if is_outside or text[0] in LIMIT_SIGNS else found

    def _check_notation(self, damaged: Mapping[str, int], cells: int) -> None:
        """Raise InputError where many cells are numbers in another notation."""
        count = sum(damaged.values())
        if count <= max(DAMAGED_CELLS, DAMAGED_SHARE * cells):
            return
        first = min(damaged, key=lambda text: self.first_rows[text])
        row = self.location.row(self.first_rows[first])
        mark = "comma" if self.decimal == "," else "point"
        raise InputError(
            f"column {self.name}, row {row}: {first[:LONGEST_SHOWN]!r} is no "
            f"number ({count} of {cells} cells)",
            where=self.location.where,
            expected=f"numbers with decimal {mark}",
            remedy="write all numbers of the column in one notation",
        )

    def _check_words(self, words: Mapping[str, int], n_words: int, n_numbers: int) -> None:
        """Raise InputError where the words are not rare, so that the column holds text."""
        different = {"words": len(words), "numbers": len(self.levels)}
        n_codes = sum(re.search(r"\d", text) is not None for text in words) + self.more
        n_filled = n_words + n_numbers
        is_rare = n_words <= RARE_SHARE * n_filled and n_codes <= FEW_TEXTS
        are_few = len(words) <= FEW_TEXTS or is_rare
        is_short = n_words <= DAMAGED_CELLS < n_numbers
        is_dead = n_numbers == 0  # a column of text is not read as numbers, see ``read.TextReader``
        if is_short or (are_few and is_dead):
            return
        if are_few and are_mostly_numbers(n_words, n_numbers, different):
            return
        first = min(words, key=lambda text: self.first_rows[text])
        row = self.location.row(self.first_rows[first])
        raise InputError(
            f"column {self.name}, row {row}: {n_words} of {n_filled} filled "
            f"cells are no numbers but text, such as {', '.join(_with_counts(words))}",
            where=self.location.where,
            expected="numbers, and few words for no reading",
            remedy="choose a column of numbers, or empty these cells",
        )


def _with_counts(words: Mapping[str, int]) -> list[str]:
    """The most frequent words with their counts, for a message."""
    ordered = sorted(words.items(), key=lambda item: -item[1])
    return [f"{text[:LONGEST_SHOWN]!r} ({count})" for text, count in ordered[:SHOWN_TEXTS]]
