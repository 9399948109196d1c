"""The path from a log to beta through the code: how many files it crosses, and how often it returns
to a file.

Run: ``python -m tests.benchmarks.walk [order]``. Functions are taken in the order of their first
calls, for the short campaign of ``tests/conftest.py``; ``order`` prints them all.
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

from tcdyn.sensors import specified_sensor
from tcdyn.workflows import compensate_log, estimate_beta
from tcdyn.workflows.compensate_table import compensate_table
from tests.conftest import small_campaign

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("calibration", "immersion", "tcdyn")


def walk(job: Callable[[], Any]) -> list[tuple[str, str]]:
    """(file, function) of the library in the order of first calls during ``job``; no lambdas, no
    comprehensions."""
    calls: dict[tuple[str, str, int], None] = {}

    def record_call(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        path = Path(code.co_filename)
        if event != "call" or code.co_name.startswith("<") or ROOT not in path.parents:
            return
        relative_path = path.relative_to(ROOT)
        if relative_path.parts[0] in PACKAGES:
            calls.setdefault((str(relative_path), code.co_qualname, code.co_firstlineno))

    sys.setprofile(record_call)
    try:
        job()
    finally:
        sys.setprofile(None)
    return [(file, function) for file, function, _ in calls]


def figures(steps: list[tuple[str, str]]) -> dict[str, int]:
    """Functions, files, changes of file, and returns to a file already left."""
    left_files: set[str] = set()
    changes = returns = 0
    for (before, _), (after, _) in pairwise(steps):
        if after != before:
            left_files.add(before)
            changes += 1
            returns += after in left_files
    return {
        "functions": len(steps),
        "files": len({f for f, _ in steps}),
        "changes": changes,
        "returns": returns,
    }


def main() -> None:
    """Print the figures of each job, and its functions by file or in order."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        campaign = small_campaign(folder)
        log = campaign.files.ehl["B3"]
        sensor = specified_sensor("probe", ["fast_e_degC"], [(1.5, 0.05)])
        jobs: dict[str, Callable[[], Any]] = {
            "beta": lambda: estimate_beta(log, campaign.rig, campaign.records),
            "compensate, rig": lambda: compensate_log(log, campaign.records).write(
                folder / "rig.csv"
            ),
            "compensate, rig, lags of the records": lambda: compensate_log(
                log, campaign.records, refine=False
            ).write(folder / "plain.csv"),
            "compensate, table": lambda: compensate_table(log, [sensor], folder / "table.csv"),
        }
        traces = {job: walk(run) for job, run in jobs.items()}
    for job, steps in traces.items():
        print(job, figures(steps))
        if "order" in sys.argv:
            print(*(f"{file} {function}" for file, function in steps), sep="\n")
            continue
        functions_by_file = Counter(file for file, _ in steps)
        print(*(f"{n:4d} {file}" for file, n in functions_by_file.most_common()), sep="\n")


if __name__ == "__main__":
    main()
