"""Faults of readings and events of temperatures: named right, and in the band.

`python -m tests.smoothing.event_fault_study [RECORDS] [SEED] [NAMES]` prints one line a row of the
table on the page "Validation": records named right, records with a false name, coverage of the
95 % band (mean and worst record), largest error in standard deviations over the records without a
warning, rms error, median u, and CPU time a record. A row has one fault or event, or none, in a
record of a temperature that is constant, a ramp, a slow wave, an Ornstein-Uhlenbeck process or a
heating.

The readings come from a recursion over a grid 20 times finer than the samples. Where the reading
itself steps, the true temperature has no step: one side of the step is wrong, and only the rows
before it are judged.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.smoothing.record import SPIKE, Compensated
from tcdyn.smoothing.smoother import smooth

DT_S = 0.1
ROWS = 600
FINE = 20
NOISE_K = 0.05
BESIDE_S = 0.55  # readings beside an edge
LAGS_S = ((2.0,), (1.6, 0.4))


@dataclass
class World:
    """A record: true temperature on the fine grid, changes of the readings, and the truth.

    ``at_s`` is the time of the event, ``columns`` the other columns of the log, ``judged`` the
    number of rows whose temperature is known.
    """

    temperature: Array
    reading: Array
    at_s: float = 0.0
    columns: dict[str, Array] = field(default_factory=dict)
    judged: int = ROWS
    step_K: float = 0.0
    noise_K: float = NOISE_K


def plain(rng: np.random.Generator, kinds: tuple[int, ...] = (0, 1, 2, 3, 4)) -> World:
    """A temperature without an event, and readings without a fault."""
    t = DT_S / FINE * np.arange(ROWS * FINE)
    kind = rng.choice(kinds)
    if kind == 0:
        x = np.full(len(t), rng.uniform(20, 80))
    elif kind == 1:
        x = 40 + rng.uniform(-0.5, 0.5) * t
    elif kind == 2:
        x = 60 + 5 * np.sin(2 * np.pi * t / rng.uniform(30, 80) + rng.uniform(0, 6))
    elif kind == 3:
        keep = np.exp(-DT_S / FINE / 5.0)
        white = rng.standard_normal(len(t)) * np.sqrt(1 - keep**2)
        x = np.empty(len(t))
        x[0] = white[0] / np.sqrt(1 - keep**2)
        for k in range(1, len(t)):
            x[k] = keep * x[k - 1] + white[k]
        x = 50 + 2 * x
    else:
        x = 20 - 40 * np.expm1(-t / rng.uniform(15, 60))
    return World(x, np.zeros(ROWS))


def spike(rng: np.random.Generator) -> World:
    """One reading off by 1 to 20 K."""
    world = plain(rng)
    row = int(rng.integers(100, ROWS - 100))
    world.reading[row] = rng.choice([-1, 1]) * rng.uniform(1, 20)
    world.at_s = row * DT_S
    return world


def reading_step(rng: np.random.Generator) -> World:
    """The reading steps by 1 to 8 K."""
    world = plain(rng)
    row = int(rng.integers(100, ROWS - 100))
    world.reading[row:] = rng.choice([-1, 1]) * rng.uniform(1, 8)
    world.at_s = row * DT_S
    world.judged = row
    return world


def jump(rng: np.random.Generator) -> World:
    """The temperature jumps by 5 to 40 K."""
    world = plain(rng)
    first = int(rng.integers(100 * FINE, (ROWS - 100) * FINE))
    world.temperature[first:] += rng.choice([-1, 1]) * rng.uniform(5, 40)
    world.at_s = first * DT_S / FINE
    return world


def kink(rng: np.random.Generator) -> World:
    """The slope of the temperature changes by 1 to 5 K/s; no rough one, whose slope always does."""
    world = plain(rng, (0, 1, 2, 4))
    first = int(rng.integers(100 * FINE, (ROWS - 100) * FINE))
    since_s = np.maximum(np.arange(ROWS * FINE) - first, 0) * DT_S / FINE
    world.temperature += rng.choice([-1, 1]) * rng.uniform(1, 5) * since_s
    world.at_s = first * DT_S / FINE
    return world


def pick_up(rng: np.random.Generator) -> World:
    """The reading rises by 0.5 to 3 K while a relay is on; the relay also heats."""
    world = plain(rng)
    period = int(rng.integers(60, 200))
    duty = rng.uniform(0.2, 0.8)
    phase = rng.integers(period)
    on = ((np.arange(ROWS) + phase) % period < duty * period).astype(float)
    world.reading += rng.uniform(0.5, 3) * on
    heat = np.repeat(on - on.mean(), FINE)
    world.temperature += 0.1 * np.cumsum(heat) * DT_S / FINE
    world.columns["relay"] = on
    return world


def idle_relay(rng: np.random.Generator) -> World:
    """A relay that heats, without any interference."""
    world = pick_up(rng)
    world.reading[:] = 0.0
    return world


def quantised(rng: np.random.Generator) -> World:
    """Steps of 0.25 K over noise of 0.02 K; a constant temperature has one reading only."""
    world = plain(rng, (1, 2, 3, 4))
    world.step_K = 0.25
    world.noise_K = 0.02
    return world


def names_in(result: Compensated, edge_s: float | None = None) -> set[str]:
    """What the result names; a reading beside an edge at ``edge_s`` may count as a spike."""
    names = {event.kind() for event in result.detected}
    codes = {finding.code for finding in result.findings}
    names |= {code for code in codes if code in ("trace.pick_up", "trace.steps", "noise.wave")}
    spikes_s = DT_S * np.flatnonzero(result.flags[:, 0] & SPIKE)
    if edge_s is not None:
        spikes_s = spikes_s[np.abs(spikes_s - edge_s) > BESIDE_S]
    if len(spikes_s):
        names.add("spike")
    return names


def is_at(result: Compensated, at_s: float, kind: str) -> bool:
    """Whether an event of a kind was found at its time, within three standard uncertainties."""
    found = [event for event in result.detected if event.kind() == kind]
    return any(abs(e.at_s - at_s) < 3 * e.u_s + DT_S for e in found)


@dataclass(frozen=True)
class Row:
    """A row of the table: how its records are made, and what has to be named."""

    name: str
    make: Callable[[np.random.Generator], World]
    named: str = ""


ROWS_OF_TABLE = (
    Row("none", plain),
    Row("spike", spike, "spike"),
    Row("step of the reading", reading_step, "step of the reading"),
    Row("jump", jump, "jump"),
    Row("kink", kink, "kink"),
    Row("pick-up", pick_up, "trace.pick_up"),
    Row("relay without pick-up", idle_relay),
    Row("quantised", quantised),
)


def readings_of(world: World, lags_s: tuple[float, ...], rng: np.random.Generator) -> Array:
    """Readings every ``FINE`` points; before the record the temperature followed its first line."""
    x = world.temperature
    step_s = DT_S / FINE
    rate = (x[1] - x[0]) / step_s
    for lag_s in lags_s:
        keep = np.exp(-step_s / lag_s)
        y = np.empty(len(x))
        y[0] = x[0] - lag_s * rate
        for k in range(1, len(x)):
            y[k] = keep * y[k - 1] + (1 - keep) * 0.5 * (x[k - 1] + x[k])
        x = y
    out = x[::FINE] + world.reading + world.noise_K * rng.standard_normal(ROWS)
    return np.round(out / world.step_K) * world.step_K if world.step_K else out


def judge(row: Row, index: int, seed: int) -> tuple[float, ...]:
    """Named right, false name, coverage, largest error [sd], mean square error, u, warned, CPU."""
    rng = np.random.default_rng([seed, index])
    world = row.make(rng)
    lags_s = LAGS_S[index % len(LAGS_S)]
    y = readings_of(world, lags_s, rng)
    start = time.process_time()
    result = smooth(y, DT_S, Chain(lags_s), switched=world.columns)
    spent = time.process_time() - start
    names = names_in(result, world.at_s if row.named == "step of the reading" else None)
    if row.named == "spike":
        at_row = round(world.at_s / DT_S)
        is_right = np.flatnonzero(result.flags[:, 0] & SPIKE).tolist() == [at_row]
    elif row.named in ("", "trace.pick_up"):
        is_right = names == {row.named} - {""}
    else:
        is_right = is_at(result, world.at_s, row.named)
    error = np.abs(result.temperature[:, 0] - world.temperature[::FINE])[: world.judged]
    sd = result.sd[: world.judged, 0]
    return (
        float(is_right),
        float(bool(names - {row.named})),
        float(np.mean(error < 1.96 * sd)),
        float(np.max(error / sd)),
        float(np.mean(error**2)),
        float(np.median(sd)),
        float(len(result.warnings) > 0),
        spent,
    )


def report(records: int, seed: int, words: list[str], verbose: bool) -> None:
    """Print the table."""
    print(
        f"{'row':24s} right  false  cover %  worst  max |e|/u, no warning   rms K  median u  CPU s"
    )
    for row in ROWS_OF_TABLE:
        if words and row.name not in words:
            continue
        with ProcessPoolExecutor(2) as pool:
            results = list(pool.map(judge, [row] * records, range(records), [seed] * records))
        if verbose:
            for index, r in enumerate(results):
                print(f"   {index:3d}", *(f"{value:9.4f}" for value in r))
        right, false, cover, worst, square, u, warned, spent = np.array(results).T
        silent = worst[warned == 0]
        print(
            f"{row.name:24s} {int(right.sum()):5d}  {int(false.sum()):5d}  "
            f"{100 * cover.mean():7.1f}  {100 * cover.min():5.1f} "
            f"{silent.max() if len(silent) else 0.0:23.1f}  {np.sqrt(square.mean()):6.3f}  "
            f"{np.median(u):8.3f}  {spent.mean():5.2f}",
            flush=True,
        )


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    listed = [a for a in sys.argv[1:] if not a.isdigit() and not a.startswith("-")]
    records_, seed_ = [*numbers, *(50, 31)[len(numbers) :]]
    report(records_, seed_, listed, "-v" in sys.argv)
