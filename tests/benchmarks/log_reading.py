"""Reading and checking a 2000 s EHL log, against pandas reading the same numbers without checks.

Run with ``python -m tests.benchmarks.log_reading``.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from tcdyn.rig.log import iter_log, read_log, write_log
from tests.rig.log_cases import ehl_frame


def best_s(work: Callable[[], object], times: int = 3) -> float:
    """The shortest of several runs [s]."""
    spans = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        spans.append(time.perf_counter() - start)
    return min(spans)


def main() -> None:
    """Print times and ratios."""
    frame = ehl_frame(150_000)
    with tempfile.TemporaryDirectory() as folder:
        path = write_log(frame, Path(folder) / "log.csv")
        plain = best_s(lambda: pd.read_csv(path))
        print(f"pandas.read_csv {plain:.2f} s ({path.stat().st_size / 1e6:.0f} MB)")
        for ending in ("csv", "parquet", "tdms"):
            path_of_kind = write_log(frame, Path(folder) / f"own.{ending}")
            span = best_s(lambda path_of_kind=path_of_kind: read_log(path_of_kind, "ehl"))
            print(
                f"read_log {ending:8s} {span:.2f} s with every check: {span / plain:.1f} x "
                "pandas on CSV"
            )
            span = best_s(
                lambda path_of_kind=path_of_kind: sum(
                    len(chunk.frame) for chunk in iter_log(path_of_kind, "ehl")
                )
            )
            print(
                f"iter_log {ending:8s} {span:.2f} s in chunks: {span / plain:.1f} x pandas on CSV"
            )


if __name__ == "__main__":
    main()
