"""How often thermostats are named, and how often open-loop on/off inputs are named falsely.

``python -m tests.identify.thermostat_study [RECORDS] [SEED]`` prints a row for each kind of record:
records that are named by ``closed_loop``, and quantiles of the evidence (log likelihood ratio).
Records of a thermostat have a fifth of ``RECORDS``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))  # the folder of the cases, as pytest has it

from thermostat_cases import OPEN_KINDS, Noise, on_off_record, thermostat_record

from tcdyn.identification import IOData
from tcdyn.identification.closed_loop import closed_loop
from tcdyn.identification.thermostat import find_thermostat

SOUND = Noise(noise_K=0.05, rounding_K=0.1, own_sensor=False)
NOISY = Noise(noise_K=0.1, rounding_K=0.1, own_sensor=True)
THERMOSTATS: dict[str, dict[str, Any]] = {
    "load changes, 15 cycles": {},
    "the same, from cold": {"from_cold": True},
    "the same, from the limit": {"from_cold": False},
    "the same, rounded to 0.1 K": {"noise": SOUND},
    "hysteresis 0.5 K, noise 0.1 K, own sensor": {"hysteresis_K": 0.5, "noise": NOISY},
    "hysteresis 5 K": {"hysteresis_K": 5.0},
    "cooler": {"cooler": True},
    "noise of 3 % on the input": {"input_noise": 3.0},
    "log of every fifth row, 30 cycles": {"every": 5, "n_cycles": 30},
    "5 cycles": {"n_cycles": 5},
    "3 cycles": {"n_cycles": 3},
    "constant load, from cold": {"load": "constant", "from_cold": True},
    "constant load, from the limit": {"load": "constant", "from_cold": False},
}


def outcome(data: IOData) -> tuple[bool, float]:
    """Whether the record is named as a closed loop, and the evidence of a thermostat."""
    run = data.runs[0]
    found = find_thermostat([(run.u[:, 0], run.y[:, 0])])
    return bool(closed_loop(data)), 0.0 if found is None else found.evidence


def print_row(name: str, outcomes: list[tuple[bool, float]]) -> None:
    """Print how many are named, and the 5 %, 50 %, 95 % quantiles and largest evidence."""
    n_named = sum(named for named, _ in outcomes)
    quantiles = np.quantile([evidence for _, evidence in outcomes], [0.05, 0.5, 0.95, 1.0])
    figures = " ".join(f"{q:7.1f}" for q in quantiles)
    print(f"{name:44s} {n_named:4d} of {len(outcomes):4d}  {figures}", flush=True)


def main(n_records: int = 200, seed: int = 0) -> None:
    """Print the table."""
    n_thermostats = max(n_records // 5, 1)
    for name, options in THERMOSTATS.items():
        seeds = range(seed, seed + n_thermostats)
        print_row(name, [outcome(thermostat_record(s, **options)) for s in seeds])
    for kind in OPEN_KINDS:
        seeds = range(seed, seed + n_records)
        print_row(kind, [outcome(on_off_record(kind, s)) for s in seeds])


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
