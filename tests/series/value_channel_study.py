"""False alarms and detection of several channels in one column of values.

``python -m tests.series.value_channel_study 300 1`` makes so many tables of one channel with
columns of modes, states and notes, and so many of two to eight channels, with this seed, and
prints how many of each kind are refused.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pandas as pd

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.series import open_source
from tcdyn.series.long_tables import check_one_channel

Rng = np.random.Generator


def reading(rng: Rng, time_s: Array, lag_s: float, signal: str) -> Array:
    """A reading of one sensor: after a step, of a slow wave, of steps, or of noise alone."""
    dt_s = float(np.median(np.diff(time_s)))
    grid = np.arange(time_s[0], time_s[-1] + dt_s, dt_s / 2)
    level = rng.uniform(15, 60)
    span = grid[-1] - grid[0]
    surroundings = np.full(len(grid), level)
    if signal == "step":
        surroundings = level + rng.uniform(20, 80) * (grid > grid[0] + rng.uniform(0.1, 0.4) * span)
    elif signal == "wave":
        surroundings = level + 10 * np.sin(2 * np.pi * grid / (span / rng.uniform(1, 6)))
    elif signal == "steps":
        index = (len(grid) * rng.random(8)).astype(int)
        surroundings = level + np.cumsum(np.isin(np.arange(len(grid)), index) * rng.normal(0, 20))
    y = Chain(lag_s).response(surroundings, dt_s / 2)
    noise = rng.normal(0, 10 ** rng.uniform(-2, 0), len(time_s))
    return np.asarray(np.interp(time_s, grid, y) + noise)


def blocks(rng: Rng, rows: int, names: list[str], in_order: bool) -> list[str]:
    """Modes that last for several rows."""
    labels: list[str] = []
    k = 0
    while len(labels) < rows:
        k = k + 1 if in_order else int(rng.integers(len(names)))
        labels += [names[k % len(names)]] * int(rng.integers(4, max(rows // 6, 6)))
    return labels[:rows]


def mode_column(rng: Rng, kind: str, time_s: Array, y: Array) -> tuple[Array, list[object]]:
    """Readings and labels of a table of one channel; faults change the readings."""
    rows = len(y)
    chance = rng.random(rows)
    if kind == "mode":
        return y, list(blocks(rng, rows, ["heating", "idle"], True))
    if kind == "phase":
        return y, list(blocks(rng, rows, ["heat", "hold", "cool"], True))
    if kind == "state":
        return y, list(blocks(rng, rows, ["init", "run", "pause", "purge", "stop"], False))
    if kind == "switch":
        return y, [int(word == "on") for word in blocks(rng, rows, ["on", "off"], True)]
    if kind == "random numbers":
        return y, [int(k) for k in rng.integers(0, 4, rows)]
    if kind == "counter":
        return y, [k % 10 for k in range(rows)]
    if kind == "quality":
        return y, list(np.where(chance < 0.05, "ERR", np.where(chance < 0.2, "WARN", "OK")))
    if kind == "faults as codes":
        is_fault = chance < 0.3
        return np.where(is_fault, 9999.0, y), list(np.where(is_fault, "ERR", "OK"))
    if kind == "faults at ambient":
        is_fault = chance < 0.1
        ambient = 900 + 0.01 * np.arange(rows)
        return np.where(is_fault, ambient, y), list(np.where(is_fault, "FAULT", "GOOD"))
    if kind == "alarm of a limit":
        return y, list(np.where(y > np.median(y), "HIGH", "LOW"))
    if kind == "classes":
        edges = np.quantile(y, [0.2, 0.4, 0.6, 0.8])
        return y, [["cold", "cool", "mild", "warm", "hot"][k] for k in np.searchsorted(edges, y)]
    if kind == "day":
        hours = ((time_s - time_s[0]) / (time_s[-1] - time_s[0]) * 14 * 24).astype(int)
        days = ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"]
        return y, [days[h // 24 % 7] for h in hours]
    if kind == "unit":
        return y, ["degC"] * rows
    notes: list[object] = [""] * rows
    for k in rng.integers(0, rows, 6):
        notes[k] = f"note {k}"
    return y, notes


MODES = (
    (
        "mode phase state switch/random numbers/counter/quality/faults as codes/faults at ambient/"
        "alarm of a limit/classes/day/unit/notes"
    )
    .replace("mode phase state switch", "mode/phase/state/switch")
    .split("/")
)
CLOCKS = ("even", "straying", "whole seconds")
NAMES: tuple[Callable[[int], object], ...] = (
    lambda k: f"CH{k + 1}",
    lambda k: f"28-0000{7211 + 37 * k:06d}",
    lambda k: f"sensor.room_{k}",
    lambda k: k + 1,
    lambda k: f"192.168.0.{10 + k}",
)


def one_channel(rng: Rng, kind: str, clock: str) -> pd.DataFrame:
    """A table of one channel with a column of this kind."""
    rows = int(rng.integers(120, 900))
    dt_s = float(rng.choice([0.1, 0.5, 1.0, 2.0]))
    time_s = dt_s * np.arange(rows)
    signal = str(rng.choice(["step", "wave", "steps", "noise"]))
    y = reading(rng, time_s, 10 ** rng.uniform(-0.5, 1.5), signal)
    if clock == "straying":
        time_s = time_s + rng.uniform(-0.3, 0.3, rows) * dt_s
    elif clock == "whole seconds":
        time_s = np.floor(0.4 * np.arange(rows))
    y, labels = mode_column(rng, kind, time_s, y)
    return pd.DataFrame({"time_s": time_s, "column": labels, "value": y})


ORDERS = ("cycle at one stamp", "cycle", "blocks", "random order at one stamp", "random order")


def several_channels(rng: Rng, order: str, count: int) -> pd.DataFrame:
    """A table of several channels of one step, with other lags and offsets, in one column."""
    rows = int(rng.integers(60, 300))
    dt_s = float(rng.choice([0.5, 1.0, 2.0]))
    name = NAMES[int(rng.integers(len(NAMES)))]
    start_s = rng.uniform(0.2, 0.4) * rows * dt_s
    parts = []
    for k in range(count):
        shift_s = 0.0
        if order == "cycle":
            shift_s = k * dt_s / count
        elif order == "random order":
            shift_s = dt_s * k / count + 0.0
        time_s = dt_s * np.arange(rows) + shift_s
        if order == "random order":
            time_s = time_s + rng.uniform(-0.5, 0.5, rows) * dt_s
        lag_s = rng.uniform(2, 30)
        step = np.where(time_s > start_s, 1 - np.exp(-(time_s - start_s) / lag_s), 0.0)
        y = 20 + rng.normal(0, 2) + 60 * step + rng.normal(0, 0.05, rows)
        parts.append(pd.DataFrame({"time_s": time_s, "sensor_id": name(k), "value": y}))
    table = pd.concat(parts, ignore_index=True)
    if order == "random order at one stamp":
        table = table.sample(frac=1, random_state=int(rng.integers(1 << 30)))
    if order != "blocks":
        table = table.sort_values("time_s", kind="stable", ignore_index=True)
    return table


def is_refused(table: pd.DataFrame) -> bool:
    """Whether the table is refused."""
    try:
        check_one_channel(open_source(table).table, "time_s", ["value"])
    except InputError:
        return True
    return False


def false_alarms(count: int, seed: int) -> dict[str, tuple[int, int]]:
    """Tables of one channel: number and refused ones, by kind of the column."""
    found = {}
    per_kind = -(-count // (len(MODES) * len(CLOCKS)))
    for kind in MODES:
        rng = np.random.default_rng([seed, MODES.index(kind)])
        tables = [one_channel(rng, kind, clock) for clock in CLOCKS for _ in range(per_kind)]
        found[kind] = (len(tables), sum(map(is_refused, tables)))
    return found


def detections(count: int, seed: int) -> dict[str, tuple[int, int]]:
    """Tables of two to eight channels: number and refused ones, by order of the rows."""
    found = {}
    per_case = -(-count // (len(ORDERS) * 7))
    for order in ORDERS:
        rng = np.random.default_rng([seed, ORDERS.index(order)])
        tables = [several_channels(rng, order, n) for n in range(2, 9) for _ in range(per_case)]
        found[order] = (len(tables), sum(map(is_refused, tables)))
    return found


if __name__ == "__main__":
    number, seed_of_study = int(sys.argv[1]), int(sys.argv[2])
    for title, results in (
        ("one channel", false_alarms(number, seed_of_study)),
        ("several channels", detections(number, seed_of_study)),
    ):
        for case, (tables, refused) in results.items():
            print(f"{title:17} {case:28} {tables:5} tables {refused:5} refused")
        total = sum(n for n, _ in results.values())
        print(f"{title:17} {'all':28} {total:5} tables {sum(r for _, r in results.values()):5}")
