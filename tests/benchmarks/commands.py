"""Times of the commands relative to pandas reading and writing the same log, and their growth with
the rows of a log.

Run: ``python -m tests.benchmarks.commands FOLDER [ROWS ...]``. FOLDER stores the campaign of test
D4 and is made if missing; each of ROWS, such as 10000 1000000, is a log of this length made from
it; with ROWS, only these logs are measured. Times are CPU seconds. Baseline: pandas reads and
pyarrow writes the same log, in the same run.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv
from pyarrow import parquet as pq

from tcdyn.campaign import solve_campaign
from tcdyn.smoothing.smoother import smooth
from tests.benchmarks.log_reading import best_s
from tests.campaign.toy import toy

COMMANDS = (
    "rig",
    "calibrate",
    "beta",
    "compensate",
    "identify",
    "campaign",
    "follow",
    "design",
    "sensor",
    "verify",
)
SMOOTHED = (12, 105_000)
BASELINE = (
    "import sys, pandas as pd, pyarrow as pa; from pyarrow import csv; "
    "csv.write_csv(pa.Table.from_pandas(pd.read_csv(sys.argv[1])), sys.argv[2])"
)


def process(*words: object) -> tuple[float, float]:
    """CPU seconds and peak memory [MB] of a program of Python."""
    run = subprocess.Popen([sys.executable, *map(str, words)], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(run.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 1):
        raise SystemExit(f"{words} failed")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def command(*arguments: object) -> tuple[float, float]:
    """CPU seconds and peak memory [MB] of one command in its own process."""
    return process("-m", "tcdyn", *arguments)


def baseline(log: Path, out: Path) -> tuple[float, float]:
    """CPU seconds and peak memory [MB] of pandas reading and pyarrow writing a log."""
    return process("-c", BASELINE, log, out)


def as_parquet(log: Path) -> Path:
    """The log as Parquet, made in bounded memory."""
    out = log.with_suffix(".parquet")
    with csv.open_csv(log) as batches, pq.ParquetWriter(out, batches.schema) as writer:
        for batch in batches:
            writer.write_batch(batch)
    return out


def extended_log(log: Path, rows: int, out: Path) -> Path:
    """A log of ``rows`` rows: steady parts before loading, under load and at the end are repeated
    forwards and backwards.
    For fewer rows than the log has, a section around unloading."""
    frame = pd.read_csv(log)
    on, off = np.flatnonzero(frame["contact"] > 0.5)[[0, -1]]
    sections = [np.arange(on), np.arange(on, off - 5000), np.arange(off - 5000, len(frame) - 2000)]
    if rows < len(frame):
        sections = [
            np.arange(max(off - int(0.7 * rows), 0), min(off + int(0.3 * rows), len(frame)))
        ]
    repeated_rows = [
        np.arange(50, on - 50),
        np.arange(off - 9000, off - 5000),
        np.arange(len(frame) - 4000, len(frame) - 2000),
    ]
    order = []
    for section, steady in zip(
        sections, repeated_rows if len(sections) > 1 else [repeated_rows[0]]
    ):
        times = max(rows - len(frame), 0) / (len(repeated_rows) * 2 * len(steady))
        order += [section, *[steady[::-1], steady] * round(times)]
    index = np.concatenate(order)
    rng = np.random.default_rng(0)
    dt = float(frame["time_s"].iloc[-1]) / (len(frame) - 1)
    noisy = [c for c in frame if c.endswith(("_degC", "_N"))]
    writer = None
    for first in range(0, len(index), 200_000):
        block = frame.iloc[index[first : first + 200_000]].copy()
        block["time_s"] = np.round(dt * np.arange(first, first + len(block)), 6)
        block[noisy] = (block[noisy] + 1e-4 * rng.standard_normal((len(block), len(noisy)))).round(
            4
        )
        table = pa.Table.from_pandas(block, preserve_index=False)
        writer = writer or csv.CSVWriter(out, table.schema)
        writer.write_table(table)
    if writer is not None:
        writer.close()
    return out


def main(folder: Path, lengths: list[int]) -> None:
    """Print a row for each command, or for each command and length."""
    log = folder / "EHL_D4.csv"
    if not log.is_file():
        command("demo", "--out", folder, "--test", "D4", "--quiet")
    records = [word for d in ("fast", "slow") for word in ("--record", folder / f"{d}.disk.json")]
    if lengths:
        compare_lengths(log, lengths, records)
    else:
        compare_commands(log, records)


def compare_commands(log: Path, records: list[object]) -> None:
    """One row for each command: seconds, and the ratio to the baseline."""
    folder = log.parent
    plunges = [word for k in (1, 2) for word in ("--immersion", folder / f"plunge_fast_{k}.csv")]
    base, _ = min(baseline(log, folder / "copy.csv") for _ in range(3))
    print(f"baseline for {log.name} ({log.stat().st_size / 1e6:.0f} MB): {base:.2f} s; times that:")
    jobs: dict[str, tuple[object, ...]] = {
        "compensate": ("compensate", log, *records, "--out", folder / "out.csv", "-q"),
        "beta": ("rig", "beta", log, *records, "--out", folder / "out.json", "-q"),
        "rig beta --report": ("rig", "beta", log, *records, "--report", folder / "out.html", "-q"),
        "calibrate": (
            "rig",
            "calibrate",
            "--disk",
            "fast",
            "--rig",
            folder / "rig.toml",
            "--oven",
            folder / "oven_fast.csv",
            *plunges,
            "--out",
            folder / "out.disk.json",
            "-q",
        ),
        "demo": ("demo", "--out", folder / "demo", "--seed", "2", "--quiet"),
    }
    for name, arguments in jobs.items():
        took, memory = min(command(*arguments) for _ in range(3))  # as for the baseline
        print(f"{name:14} {took:6.2f} s {took / base:6.2f} {memory:6.0f} MB", flush=True)
    took = max(min(command(name, "--help")[0] for _ in range(3)) for name in COMMANDS)
    print(f"{'slowest --help':14} {took:6.2f} s {took / base:6.2f}")
    rng = np.random.default_rng(0)
    columns, rows = SMOOTHED
    y = (
        60
        + np.cumsum(0.01 * rng.standard_normal((rows, columns)), axis=0)
        + 0.15 * rng.standard_normal((rows, columns))
    )
    took = best_s(lambda: smooth(y, 1 / 75, 0.7, events_s=[rows / 100], noise_sd=0.15), 2)
    print(f"{'smoother alone':14} {took:6.2f} s {took / base:6.2f}")
    counts = np.array([1, 5, 20, 100, 500])
    statistics = toy(1, 500).tests
    spans = [best_s(lambda n=n: solve_campaign(statistics[:n])) for n in counts.tolist()]
    times_text = ", ".join(f"{s:.2g} s of {n}" for n, s in zip(counts, spans))
    slope = np.polyfit(np.log(counts[2:]), np.log(spans[2:]), 1)[0]
    print(f"campaign from stored statistics: {times_text} tests; slope from 20 on {slope:.2f}")


def compare_lengths(log: Path, lengths: list[int], records: list[object]) -> None:
    """One row for each length and command, and the growth of their times."""
    folder = log.parent
    measurements = []
    for rows in lengths:
        long_log = extended_log(log, rows, folder / "longer.csv")
        parquet = as_parquet(long_log)
        jobs: dict[str, Callable[[], tuple[float, float]]] = {
            "baseline": partial(baseline, long_log, folder / "longer.out.csv")
        }
        for name, source, out in (
            ("compensate", long_log, "longer.out.csv"),
            ("compensate, Parquet", parquet, "longer.out.parquet"),
            ("rig beta", long_log, "longer.json"),
        ):
            words = name.partition(",")[0].split()
            options = ("--out", folder / out, "--overwrite", "-q")
            jobs[name] = partial(command, *words, source, *records, *options)
        for name, job in jobs.items():
            took, memory = job()
            measurements.append((name, rows, took))
            print(f"{name:20} {rows:9} rows {took:7.1f} s {memory:6.0f} MB", flush=True)
    for name in jobs if len(lengths) > 1 else ():
        log_rows, seconds = np.log([(r, s) for n, r, s in measurements if n == name]).T
        slope = np.polyfit(log_rows, seconds, 1)[0]
        print(f"{name}: slope of log seconds over log rows {slope:.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), [int(float(x)) for x in sys.argv[2:]])
