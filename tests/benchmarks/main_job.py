"""The main job on several rigs and tests: errors against the true values (python -m
tests.benchmarks.main_job).

`python -m tests.benchmarks.main_job 1 2 3 4 5 --tests A1 B3 D4` simulates the campaign of each
seed, runs every stage on its files and prints, for each test, the error of every estimator of beta
and how much closer compensation brings `e` to the true temperature.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.workflows import run_demo


def one_campaign(seed: int, tests: tuple[str, ...]) -> pd.DataFrame:
    """Errors of the campaign of one seed; one row for each test."""
    with tempfile.TemporaryDirectory() as folder:
        run = run_demo(Path(folder), seed, tests)
    table = run.comparison.set_index("quantity")
    rows = []
    for test in tests:
        row: dict[str, float | str | int] = {"seed": seed, "test": test}
        for estimator in ("speed law", "cooling fast", "cooling slow", "joint fast", "joint slow"):
            comparison_row = table.loc[f"{test} beta, {estimator}"]
            row[estimator] = comparison_row["estimate"] - comparison_row["truth"]
            row[f"z {estimator}"] = (
                comparison_row["estimate"] - comparison_row["truth"]
            ) / comparison_row["u"]
        for disk in ("fast", "slow"):
            comparison_row = table.loc[f"{test} {disk} common lag, unloading"]
            row[f"lag {disk}"] = comparison_row["estimate"] - comparison_row["truth"]
            comparison_row = table.loc[f"{test} h {disk}, speed law"]
            row[f"h {disk}"] = comparison_row["estimate"] / comparison_row["truth"] - 1
            raw = table.loc[f"{test} {disk} e, rms error raw, 5 s after unloading", "estimate"]
            new = table.loc[f"{test} {disk} e, rms error compensated", "estimate"]
            row[f"closer {disk}"] = raw / new
        row["z check"] = run.tests[test].partition.crosscheck.z
        rows.append(row)
    return pd.DataFrame(rows)


def main() -> None:
    """Print the table, then rms and largest value of every column."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seeds", nargs="*", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--tests", nargs="+", default=["A1", "B3", "D4"])
    args = parser.parse_args()
    start = time.perf_counter()
    tables = []
    for seed in args.seeds:
        tables.append(one_campaign(seed, tuple(args.tests)))
        print(tables[-1].round(4).to_string(header=seed == args.seeds[0], index=False), flush=True)
    table = pd.concat(tables)
    numbers = table.drop(columns=["seed", "test"])
    closer = [c for c in numbers if c.startswith("closer")]
    print("\nrms    ", np.sqrt((numbers**2).mean()).drop(closer).round(4).to_dict())
    print("largest", numbers.abs().max().drop(closer).round(4).to_dict())
    print("least closer", numbers[closer].min().round(1).to_dict())
    print(f"{len(table)} tests in {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
