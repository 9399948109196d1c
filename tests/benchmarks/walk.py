"""The walk from a log to beta as data: how many files it crosses, and how often it comes back to one it had left.

Run: ``python -m tests.benchmarks.walk [order]``. Functions are taken in the order of their first calls, for the short
campaign of ``tests/conftest.py``; ``order`` prints them all.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

from tcdyn.workflows import estimate_beta
from tests.conftest import small_campaign

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("calibration", "immersion", "tcdyn")


def walk(job: Callable[[], Any]) -> list[tuple[str, str]]:
    """(file, function) of the library in the order of first calls during ``job``; no lambdas, no comprehensions."""
    seen: dict[tuple[str, str, int], None] = {}

    def see(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        path = Path(code.co_filename)
        if event != "call" or code.co_name.startswith("<") or ROOT not in path.parents:
            return
        inside = path.relative_to(ROOT)
        if inside.parts[0] in ROOMS:
            seen.setdefault((str(inside), code.co_qualname, code.co_firstlineno))

    sys.setprofile(see)
    try:
        job()
    finally:
        sys.setprofile(None)
    return [(file, function) for file, function, _ in seen]


def figures(steps: list[tuple[str, str]]) -> dict[str, int]:
    """Functions, files, changes of file, and returns to a file already left."""
    left: set[str] = set()
    changes = returns = 0
    for (before, _), (now, _) in pairwise(steps):
        if now != before:
            left.add(before)
            changes += 1
            returns += now in left
    return {
        "functions": len(steps),
        "files": len({f for f, _ in steps}),
        "changes": changes,
        "returns": returns,
    }


def main() -> None:
    """Print the figures, and functions by file or in order."""
    with tempfile.TemporaryDirectory() as folder:
        made = small_campaign(Path(folder))
        steps = walk(lambda: estimate_beta(made.files.ehl["B3"], made.rig, made.records))
    print(figures(steps))
    if "order" in sys.argv:
        print(*(f"{file} {function}" for file, function in steps), sep="\n")
    else:
        print(
            *(f"{n:4d} {file}" for file, n in Counter(f for f, _ in steps).most_common()), sep="\n"
        )


if __name__ == "__main__":
    main()
