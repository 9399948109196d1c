"""Every published number that the thesis lets us check, computed and put beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Literal

from tcdyn.core.errors import InputError
from tcdyn.core.threads import one_blas_thread

HALF_WIDTHS_mm = (1.25, 1.50, 1.62, 1.75)  # of the tracks at 850, 1460, 1850, 2320 N (table 3.4)
Verdict = Literal["agrees", "same trend", "misprint", "differs", "not checkable"]
Kind = Literal["physics", "trend", "rule", "arithmetic"]
KINDS: dict[Kind, str] = {
    "physics": "physics against a published figure",
    "trend": "trend, where sizes cannot be compared",
    "rule": "rule or constant found from the table it is compared with",
    "arithmetic": "arithmetic of printed numbers",
}


@dataclass(frozen=True)
class VerifyRow:
    """A published number beside ours. ``why`` says what the verdict means here, or why nothing more can be said.

    ``kind`` says what the row is evidence of: only "physics" and, in sign, "trend" tell a right model from a wrong one.
    "misprint": ours contradicts the published number, and so do the thesis's own other numbers.
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
    """A row whose verdict is a computed truth value; ``good`` is what to call it when true, if not what its kind is."""
    right: Verdict = good or ("same trend" if kind == "trend" else "agrees")
    return VerifyRow(quantity, source, published, ours, right if ok else "differs", why, kind)


def within(
    ours: Sequence[float], published: Sequence[float], relative: float = 0.0, absolute: float = 0.0
) -> bool:
    """Whether every number of ours is as close to its published one as told, and there are as many of them.

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
    """A row of ``ours`` with so many digits, each of which must be as close as told to that in the text ``published``.

    >>> close("physics", "order", "(3.22)", "2, 2", [2.0, 2.03], 2, "", absolute=0.05).verdict
    'agrees'
    """
    printed = [float(text) for text in published.split(", ")]
    ok = within(ours, printed, relative, absolute)
    return row(kind, quantity, source, published, numbers(ours, digits), ok, why)


def numbers(values: Iterable[float], digits: int) -> str:
    """Numbers with so many decimals, separated by commas."""
    return ", ".join(f"{v:.{digits}f}" for v in values)


CHAPTERS = (  # in the thesis's order; their files need this one, so they are imported when they are asked
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
    """All rows, each computed on the spot, in the order of the thesis's chapters; some seconds.

    Where numbers are so far off that a chapter cannot go on, a last row of it differs and says why.
    """
    rows: list[VerifyRow] = []
    for file, chapter in CHAPTERS:
        try:
            rows.extend(getattr(import_module(f"tcdyn.verify.{file}"), chapter)())
        except (ArithmeticError, ValueError, InputError) as problem:
            why = f"{chapter.replace('_', ' ')} cannot go on: {problem}"
            rows.append(
                VerifyRow(
                    f"what {chapter.replace('_', ' ')} still had",
                    file,
                    "",
                    "",
                    "differs",
                    why,
                    "physics",
                )
            )
    return rows
