"""Time and peak memory of `tcdyn compensate TABLE --sensor` against the number of rows, and the
slope of their logs.

Run: ``python -m tests.benchmarks.tables [ROWS ...] [--columns 3] [--rate-Hz 75] [--parquet]``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from tcdyn.io.write import log_writer
from tcdyn.sensors import specified_sensor, write_sensor

LAG_S = 0.5
BLOCK = 200_000
RUN = """
import sys
from tcdyn.cli.app import main
try:
    main()
finally:
    status = open("/proc/self/status")
    peaks = [line.split()[1] for line in status if line.startswith("VmHWM")]
    print("peak", *peaks, file=sys.stderr)
"""


def write_table(path: Path, rows: int, columns: int, rate_Hz: float, seed: int = 1) -> Path:
    """A table of sensors with one lag in fluids with random temperature, written in blocks."""
    rng = np.random.default_rng(seed)
    names = ["time_s", *(f"T{k}_degC" for k in range(columns))]
    poles = [np.exp(-1 / rate_Hz / tau) for tau in (5.0, 2.0, 2.0, LAG_S)]
    states = [np.zeros((1, columns)) for _ in poles]
    with log_writer(path, names, {}) as write:
        for start in range(0, rows, BLOCK):
            t = np.arange(start, min(start + BLOCK, rows)) / rate_Hz
            y = 50 * np.sqrt(rate_Hz / 75) * rng.standard_normal((len(t), columns))
            for k, a in enumerate(poles):
                y, states[k] = lfilter([1 - a], [1, -a], y, axis=0, zi=states[k])
            y = np.round(100 + y + 0.1 * rng.standard_normal(y.shape), 4)
            write(pd.DataFrame(np.column_stack([np.round(t, 7), y]), columns=names))
    return path


def run(*args: str | Path) -> tuple[int, float, float]:
    """Exit code of a command in its own process, its time [s] and its peak memory [MB]."""
    start = time.perf_counter()
    process = subprocess.run(
        [sys.executable, "-c", RUN, *map(str, args)], capture_output=True, text=True, check=False
    )
    peak = [line for line in process.stderr.splitlines() if line.startswith("peak ")]
    return (
        process.returncode,
        time.perf_counter() - start,
        float(peak[-1].split()[1]) / 1024 if peak else np.nan,
    )


def run_compensate(
    folder: Path, rows: int, columns: int, rate_Hz: float, ending: str
) -> tuple[int, float, float]:
    """Exit code, time [s] and peak memory [MB] for one table of this size."""
    sensor = write_sensor(specified_sensor("s", ["T*"], [(LAG_S, 0.02)]), folder / "s.sensor.json")
    table = write_table(folder / f"table{ending}", rows, columns, rate_Hz)
    return run("compensate", table, "--sensor", sensor, "--out", folder / f"out{ending}", "--quiet")


def main() -> None:
    """Print a line for each number of rows, then the slopes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", type=float, default=[1e4, 1e5, 1e6, 1e7])
    parser.add_argument("--columns", type=int, default=3)
    parser.add_argument("--rate-Hz", type=float, default=75.0)
    parser.add_argument("--parquet", action="store_true")
    args = parser.parse_args()
    measurements = []
    for rows in map(int, args.rows):
        with tempfile.TemporaryDirectory() as folder:
            code, span, peak = run_compensate(
                Path(folder),
                rows,
                args.columns,
                args.rate_Hz,
                ".parquet" if args.parquet else ".csv",
            )
        measurements.append((rows, span, peak))
        print(
            f"{rows:9d} rows x {args.columns}: {span:7.1f} s, peak {peak:5.0f} MB, exit code "
            f"{code}",
            flush=True,
        )
    if len(measurements) > 1:
        logs = np.log(measurements)
        for what, column in (("time", logs[:, 1]), ("peak memory", logs[:, 2])):
            print(f"{what}: slope {np.polyfit(logs[:, 0], column, 1)[0]:.2f}")


if __name__ == "__main__":
    main()
