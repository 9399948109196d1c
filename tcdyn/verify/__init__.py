"""Every published number that the thesis lets us check, computed and put beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Literal

LOADS_N = (850, 1460, 1850, 2320)  # of the programme (table 6.1), and the half widths of their tracks (table 3.4)
HALF_WIDTHS_mm = (1.25, 1.50, 1.62, 1.75)
Verdict = Literal["agrees", "same trend", "differs", "not checkable"]


@dataclass(frozen=True)
class VerifyRow:
    """A published number beside ours. ``why`` says what the verdict means here, or why nothing more can be said."""

    quantity: str
    source: str
    published: str
    ours: str
    verdict: Verdict
    why: str

    @property
    def failed(self) -> bool:
        """Whether this row must stop a release."""
        return self.verdict == "differs"


def row(
    quantity: str, source: str, published: str, ours: str, ok: bool, why: str, good: Verdict = "agrees"
) -> VerifyRow:
    """A row whose verdict is a computed truth value; ``good`` is what to call it when true."""
    return VerifyRow(quantity, source, published, ours, good if ok else "differs", why)


def within(ours: Sequence[float], published: Sequence[float], relative: float = 0.0, absolute: float = 0.0) -> bool:
    """Whether every number of ours is as close to its published one as told.

    >>> within([1.0667], [1.067], absolute=5e-4)
    True
    """
    pairs = zip(ours, published, strict=True)
    return all(abs(a - b) <= relative * abs(b) + absolute for a, b in pairs)


def numbers(values: Iterable[float], digits: int) -> str:
    """Numbers with so many decimals, separated by commas."""
    return ", ".join(f"{v:.{digits}f}" for v in values)


CHAPTERS = (  # in the thesis's order; their files need this one, so they are imported when they are asked
    ("contact_rows", "speed_law_rows"),
    ("contact_rows", "oven_rows"),
    ("rim_rows", "closed_form_rows"),
    ("rim_rows", "field_rows"),
    ("rim_rows", "mesh_rows"),
    ("contact_rows", "contact_rows"),
)


def verify_rows() -> list[VerifyRow]:
    """All rows, each computed on the spot, in the order of the thesis's chapters; a few seconds."""
    chapters = [getattr(import_module(f"tcdyn.verify.{file}"), chapter) for file, chapter in CHAPTERS]
    return [row for chapter in chapters for row in chapter()]
