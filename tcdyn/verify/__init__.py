"""Verification: the published numbers of the thesis that can be checked, recomputed.

Used by ``tcdyn verify`` (``tcdyn.cli.verify``). Each chapter is a generator of rows in one of
the ``..._rows`` modules; ``CHAPTERS`` gives the order. Tolerances stand in the text of each row.
Tests: ``tests/cli/test_verify.py``; ``tests/verify/test_mutations.py`` checks that wrong physics
makes rows differ.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Literal, get_args

from tcdyn.core.errors import InputError
from tcdyn.core.threads import one_blas_thread

HALF_WIDTHS_mm = (1.25, 1.50, 1.62, 1.75)  # of the tracks at 850, 1460, 1850, 2320 N (table 3.4)
Verdict = Literal["agrees", "same trend", "misprint", "differs", "not checkable"]
Kind = Literal["physics", "trend", "rule", "arithmetic"]
# Kinds of rows, with their text in the summary.
KINDS: dict[Kind, str] = {
    "physics": "physics against a published figure",
    "trend": "trend, where sizes cannot be compared",
    "rule": "rule or constant fitted to the table it is compared with",
    "arithmetic": "arithmetic of printed numbers",
}


@dataclass(frozen=True)
class VerifyRow:
    """A published number and the computed one.

    Parameters
    ----------
    quantity, source
        What is compared, and where it is published.
    published, ours
        Both numbers as text.
    verdict
        "misprint": the computed number contradicts the published one, and so do the thesis's own
        other numbers.
    why
        What the verdict means here, or why no better statement is possible.
    kind
        What the row is evidence of. Only "physics" and, in sign, "trend" distinguish a right model
        from a wrong one.
    """

    quantity: str
    source: str
    published: str
    ours: str
    verdict: Verdict
    why: str
    kind: Kind

    @property
    def failed(self) -> bool:
        """Whether this row must stop a release."""
        return self.verdict == "differs"


def row(
    kind: Kind,
    quantity: str,
    source: str,
    published: str,
    ours: str,
    ok: bool,
    why: str,
    good: Verdict | None = None,
) -> VerifyRow:
    """Return a row whose verdict follows from the truth value ``ok``.

    Parameters
    ----------
    kind
        What the row is evidence of.
    quantity, source
        What is compared, and where it is published.
    published, ours
        Both numbers as text.
    ok
        Whether they agree.
    why
        What the verdict means here.
    good
        Verdict if ``ok``; None: that of the kind.
    """
    verdict: Verdict = "differs"
    if ok:
        verdict = good or ("same trend" if kind == "trend" else "agrees")
    return VerifyRow(quantity, source, published, ours, verdict, why, kind)


def within(
    ours: Sequence[float], published: Sequence[float], relative: float = 0.0, absolute: float = 0.0
) -> bool:
    """Return whether both have the same length, and every pair agrees within the tolerance.

    The tolerance is ``relative`` times the published number plus ``absolute``.

    Parameters
    ----------
    ours, published
        The numbers.
    relative, absolute
        Tolerance.

    Examples
    --------
    >>> within([1.0667], [1.067], absolute=5e-4), within([1.0667], [1.067, 1.067], absolute=5e-4)
    (True, False)
    """
    if len(ours) != len(published):
        return False
    return all(
        abs(a - b) <= relative * abs(b) + absolute for a, b in zip(ours, published, strict=True)
    )


def close(
    kind: Kind,
    quantity: str,
    source: str,
    published: str,
    ours: Sequence[float],
    digits: int,
    why: str,
    *,
    relative: float = 0.0,
    absolute: float = 0.0,
) -> VerifyRow:
    """Return a row of numbers that must agree within a tolerance.

    Parameters
    ----------
    kind
        What the row is evidence of.
    quantity, source
        What is compared, and where it is published.
    published
        Numbers as text, separated by ", ".
    ours
        Computed numbers.
    digits
        Decimals with which ``ours`` are written.
    why
        What the verdict means here.
    relative, absolute
        Tolerance as of :func:`within`.

    Examples
    --------
    >>> close("physics", "order", "(3.22)", "2, 2", [2.0, 2.03], 2, "", absolute=0.05).verdict
    'agrees'
    """
    printed = [float(text) for text in published.split(", ")]
    ok = within(ours, printed, relative, absolute)
    return row(kind, quantity, source, published, numbers(ours, digits), ok, why)


def numbers(values: Iterable[float], digits: int) -> str:
    """Return numbers with so many decimals, separated by commas.

    Parameters
    ----------
    values
        The numbers.
    digits
        Number of decimals.
    """
    return ", ".join(f"{v:.{digits}f}" for v in values)


# Files and functions in the order of the thesis. These files import this one, so they are imported
# when they are used.
CHAPTERS = (
    ("contact_rows", "speed_law_rows"),
    ("contact_rows", "oven_rows"),
    ("sensor_rows", "sensor_rows"),
    ("rim_rows", "closed_form_rows"),
    ("rim_rows", "field_rows"),
    ("rim_rows", "mesh_rows"),
    ("disk_rows", "fictitious_rows"),
    ("sensor_rows", "bath_rows"),
    ("contact_rows", "contact_rows"),
    ("table_rows", "table_rows"),
    ("steady_rows", "steady_rows"),
    ("disk_rows", "table_7_2_rows"),
)


@one_blas_thread
def verify_rows() -> list[VerifyRow]:
    """Compute all rows in the order of the thesis's chapters; some seconds.

    Where numbers are so wrong that a chapter fails, its last row differs and states the error.

    Notes
    -----
    A chapter that raises does not stop the others. To add a chapter, add its module and function to
    ``CHAPTERS``.
    """
    rows: list[VerifyRow] = []
    for file, function in CHAPTERS:
        module = import_module(f"tcdyn.verify.{file}")
        chapter = function.replace("_", " ")
        try:
            rows.extend(getattr(module, function)())
        except (ArithmeticError, ValueError, InputError) as error:
            quantity = f"remaining rows of {chapter}"
            why = f"{chapter} stopped: {error}"
            rows.append(VerifyRow(quantity, file, "", "", "differs", why, "physics"))
    return rows


def count_by_kind(rows: Sequence[VerifyRow]) -> dict[str, int]:
    """Number of rows of each kind."""
    return {kind: sum(row.kind == kind for row in rows) for kind in KINDS}


def summary_text(rows: Sequence[VerifyRow]) -> str:
    """Summary in two sentences: number of rows by verdict, and by kind."""
    count = {v: sum(row.verdict == v for row in rows) for v in get_args(Verdict)}
    counts = count_by_kind(rows)
    classes = "; ".join(f"{counts[kind]} {text}" for kind, text in KINDS.items())
    return (
        f"{len(rows)} published numbers checked: {count['agrees']} agree, {count['same trend']} "
        f"show the same trend, {count['misprint']} are misprints there, {count['differs']} differ, "
        f"{count['not checkable']} cannot be checked in size. By class: {classes}."
    )
