"""Processor time and memory of ``compare(data)`` on large records.

``python -m tests.benchmarks.large_records`` prints a row for 10^4, 10^5 and 10^6 rows of case A
(0.05 s, levels of 1 s), with white noise and with AR(1) noise of coefficient 0.9, both of 0.5 K.
Each row is a process of its own, ``python -m tests.benchmarks.large_records ROWS NOISE``.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time

import numpy as np

from tcdyn.identification import compare
from tests.identify.bare_cases import NOISE_K, as_record, levels, response, slow_noise

ROWS = (10_000, 100_000, 1_000_000)
NOISES = ("white", "AR 0.9")
SEED = 1


def measure(n: int, noise: str) -> str:
    """One row of the table: time, peak memory, model, and errors over standard uncertainties."""
    rng = np.random.default_rng(SEED)
    u = levels(rng, n)
    e = rng.normal(size=n) if noise == "white" else slow_noise(rng, 0.9, n)
    data = as_record(u, response(u) + NOISE_K * e)
    start_s = time.process_time()
    result = compare(data)
    cpu_s = time.process_time() - start_s
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    estimates = result.averaged["heater"]
    z_gain = (estimates["gain"].value - 1.0) / estimates["gain"].u
    z_lag = (estimates["lag_s"].value - 2.87) / estimates["lag_s"].u
    return (
        f"{n:8d} {noise:8s}{cpu_s:7.1f}{peak_mb:9.0f}  {result.recommended:6s}{z_gain:8.2f}"
        f"{z_lag:8.2f}"
    )


def main() -> None:
    """Print the table."""
    print("    rows noise     CPU s  peak MB  model  z gain   z lag")
    for n in ROWS:
        for noise in NOISES:
            command = [sys.executable, "-m", "tests.benchmarks.large_records", str(n), noise]
            print(
                subprocess.run(command, capture_output=True, text=True).stdout, end="", flush=True
            )


if __name__ == "__main__":
    if len(sys.argv) > 2:
        print(measure(int(sys.argv[1]), sys.argv[2]))
    else:
        main()
