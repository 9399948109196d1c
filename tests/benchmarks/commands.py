"""The commands against pandas reading and writing the same log once, and how they grow with the rows of a log.

Run: ``python -m tests.benchmarks.commands FOLDER [ROWS ...]``: FOLDER keeps the campaign of test D4, made if not there;
each of ROWS, such as 10000 1000000, is a log of so many, made of that one. Baseline: pandas, in the same run.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.campaign import solve_campaign
from tcdyn.smoothing.smoother import smooth
from tests.benchmarks.log_reading import best_s
from tests.campaign.toy import toy

COMMANDS = (
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


def command(*words: object) -> tuple[float, float]:
    """Seconds and largest memory [MB] of one command in a process of its own."""
    start = time.perf_counter()
    run = subprocess.Popen(
        [sys.executable, "-m", "tcdyn.cli.app", *map(str, words)], stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(run.pid, 0)
    if os.waitstatus_to_exitcode(status) == 2:
        raise SystemExit(f"{words} failed")
    return time.perf_counter() - start, used.ru_maxrss / 1024


def longer(log: Path, rows: int, out: Path) -> Path:
    """A log of so many rows: to and fro through what is quiet before loading, under load and at the end, or a part."""
    frame = pd.read_csv(log, comment="#")
    on, off = np.flatnonzero(frame["contact"] > 0.5)[[0, -1]]
    parts = [np.arange(on), np.arange(on, off - 5000), np.arange(off - 5000, len(frame) - 2000)]
    if rows < len(frame):
        parts = [np.arange(max(off - int(0.7 * rows), 0), min(off + int(0.3 * rows), len(frame)))]
    turns = [
        np.arange(50, on - 50),
        np.arange(off - 9000, off - 5000),
        np.arange(len(frame) - 4000, len(frame) - 2000),
    ]
    order = []
    for part, turn in zip(parts, turns if len(parts) > 1 else [turns[0]]):
        times = max(rows - len(frame), 0) / (len(turns) * 2 * len(turn))
        order += [part, *[turn[::-1], turn] * round(times)]
    index = np.concatenate(order)
    rng = np.random.default_rng(0)
    dt = float(frame["time_s"].iloc[-1]) / (len(frame) - 1)
    noisy = [c for c in frame if c.endswith(("_degC", "_N"))]
    with out.open("w", encoding="utf-8") as stream:
        for first in range(0, len(index), 200_000):
            piece = frame.iloc[index[first : first + 200_000]].copy()
            piece["time_s"] = np.round(dt * np.arange(first, first + len(piece)), 6)
            piece[noisy] = (
                piece[noisy] + 1e-4 * rng.standard_normal((len(piece), len(noisy)))
            ).round(4)
            piece.to_csv(stream, index=False, header=first == 0)
    return out


def main(folder: Path, lengths: list[int]) -> None:
    """A row for each command: seconds, and how many times pandas' reading and writing; then a row for each length."""
    log = folder / "EHL_D4.csv"
    if not log.is_file():
        command("demo", "--out", folder, "--test", "D4", "--quiet")
    records = [word for d in ("fast", "slow") for word in ("--record", folder / f"{d}.disk.json")]
    plunges = [word for k in (1, 2) for word in ("--immersion", folder / f"plunge_fast_{k}.csv")]
    base = best_s(lambda: pd.read_csv(log, comment="#").to_csv(folder / "copy.csv", index=False))
    print(
        f"pandas reads and writes {log.name} ({log.stat().st_size / 1e6:.0f} MB) in {base:.2f} s; times that:"
    )
    jobs: dict[str, tuple[object, ...]] = {
        "compensate": ("compensate", log, *records, "--out", folder / "out.csv", "-q"),
        "beta": ("beta", log, *records, "--out", folder / "out.json", "-q"),
        "beta --report": ("beta", log, *records, "--report", folder / "out.html", "-q"),
        "calibrate": (
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
    for name, words in jobs.items():
        took, memory = min(command(*words) for _ in range(3))  # as of the baseline
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
    kept = toy(1, 500).tests
    spans = [best_s(lambda n=n: solve_campaign(kept[:n])) for n in counts.tolist()]
    said = ", ".join(f"{s:.2g} s of {n}" for n, s in zip(counts, spans))
    slope = np.polyfit(np.log(counts[2:]), np.log(spans[2:]), 1)[0]
    print(f"campaign from kept answers: {said} tests; slope from 20 on {slope:.2f}")
    told = []
    for rows in lengths:
        made = longer(log, rows, folder / "longer.csv")
        for name, out in (("compensate", "longer.out.csv"), ("beta", "longer.json")):
            took, memory = command(name, made, *records, "--out", folder / out, "-q")
            told.append((name, rows, took, memory))
            print(
                f"{name:11} {rows:9} rows {made.stat().st_size / 1e6:6.0f} MB: {took:7.1f} s {memory:6.0f} MB",
                flush=True,
            )
    for name in ("compensate", "beta") if len(lengths) > 1 else ():
        at, seconds = np.log([(r, s) for n, r, s, _ in told if n == name]).T
        print(f"{name}: slope of log seconds over log rows {np.polyfit(at, seconds, 1)[0]:.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), [int(float(x)) for x in sys.argv[2:]])
