"""Dips as people make them: the film settles, the stem conducts, the bath relaxes.

`python -m tests.sensors.hand_study [RECORDS] [SEED] [KIND ...]` prints for each kind of dip how
often lag, t50, t63.2 and t90 are inside their 95 % intervals, rms error over the median u of the
lag, and rms error of t63.2 beside that of the crossing in the readings, by someone who takes the
entry where the reading leaves its level, and the mean of the last readings. Layered sensors in
water or oil by finite volumes, see ``tests.sensors.layered_world``, and exposed junctions, see
``tests.sensors.fin_world``; readings with steps of 0.01 K.

Kinds: steady; from half, from twice (the film coefficient settles within a second after the entry;
the lag is that of the settled flow, the times are those of the dip); fin in water, fin in air (the
stem of an exposed junction conducts; lag and times are those of its own final reading); relaxes
(the bath falls or rises by 2 to 6 % of the step; the times are those of a step); wide (a specified
lag of the medium of 0.3 +- 0.3 s where it is 0.02 s); stopwatch (11 to 20 readings by eye).
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.sensors.file import SHARES
from tcdyn.sensors.plunge import plunge_sensor
from tests.sensors.fin_world import drawn_junction
from tests.sensors.layered_world import (
    MEDIA,
    LayeredSensor,
    drawn,
    layered,
    rings,
    step_with_changing_film,
    surface_h,
)

FINE = 10
STEP_K = 60.0


@dataclass(frozen=True)
class Dip:
    """A dip without noise: times from the entry (N,), response in steps (N,), and the truth [s].

    Of the rows those of ``is_read`` are known; ``step_K`` is the step of the readings.
    """

    since_s: Array
    response: Array
    lag_s: float
    times_s: Array
    is_read: Array | None = None
    noise_K: float | None = None
    step_K: float = 0.01
    options: dict[str, object] = field(default_factory=dict)


def crossings(time_s: Array, response: Array) -> Array:
    """When a response passes each of the shares of its step."""
    out = []
    for share in SHARES.values():
        k = int(np.argmax(response >= share))
        rise = response[k] - response[k - 1]
        step_s = time_s[k] - time_s[k - 1]
        out.append(time_s[k - 1] + (share - response[k - 1]) / rise * step_s)
    return np.array(out)


def crossing_by_hand(time_s: Array, reading: Array) -> float:
    """Time to 63.2 % as people read it [s]: entry where the reading leaves its level, last rows."""
    known = np.isfinite(reading)
    t, y = time_s[known], reading[known]
    final = float(np.mean(y[-max(len(y) // 20, 3) :]))
    share = (y - y[0]) / (final - y[0])
    scatter = float(np.std(share[-max(len(y) // 10, 3) :]))
    left = int(np.argmax(share > max(5 * scatter, 0.02)))
    entry_s = float(t[max(left - 1, 0)])
    k = int(np.argmax(share >= 1 - np.exp(-1)))
    return float(np.interp(1 - np.exp(-1), share[k - 1 : k + 1], t[k - 1 : k + 1])) - entry_s


def times_of_rows(rng: np.random.Generator, rise_s: float, after_s: float) -> Array:
    """Times of the rows from the entry (N,) [s]: 20 to 60 rows in ``rise_s``."""
    dt_s = rise_s / rng.integers(20, 60)
    first_s = -rng.uniform(1.0, 2.0) * rise_s
    return np.arange(first_s, after_s, dt_s)


def with_changing_film(rng: np.random.Generator, low: float, high: float) -> Dip:
    """A layered sensor whose film coefficient changes from 1 + (low to high) to 1."""
    change = rng.uniform(low, high)
    settling_s = rng.uniform(0.2, 0.8)
    medium = str(rng.choice(["water", "oil"]))
    d = float(np.exp(rng.uniform(np.log(1e-3), np.log(8e-3))))
    speed = float(np.exp(rng.uniform(*np.log(MEDIA[medium][3:]))))
    gap_m = float(min(rng.uniform(10e-6, 60e-6), d / 40)) if rng.random() < 0.5 else 0.0
    core, wall, k = rng.uniform(0.15, 0.35), rng.uniform(0.10, 0.16), rng.uniform(1.5, 5.0)
    h = surface_h(medium, d, speed)
    lag_s = layered(d, core, wall, k, h, gap_m).lag_s
    rows_s = times_of_rows(rng, lag_s, 9 * lag_s)
    step_s = float(rows_s[1] - rows_s[0]) / FINE
    since_s = rows_s[0] + step_s * np.arange(len(rows_s) * FINE)
    settling = 1 + change * np.exp(-np.maximum(since_s, 0.0) / settling_s)
    film = np.where(since_s > 0, h * settling, 0.0)
    response = step_with_changing_film(*rings(d, core, wall, k, gap_m), d / 2, film, step_s)
    return Dip(rows_s, response[::FINE], lag_s, crossings(since_s, response))


def of_sensor(rng: np.random.Generator, sensor: LayeredSensor) -> Dip:
    """A sharp step of a sensor, until it has settled."""
    _, rise_s, slow_s = sensor.times_s()
    rows_s = times_of_rows(rng, rise_s, max(9 * rise_s, 4 * slow_s))
    return Dip(rows_s, sensor.step(rows_s), sensor.lag_s, np.array(sensor.times_s()))


def with_fin(rng: np.random.Generator, medium: str) -> Dip:
    """An exposed junction on a stem that conducts."""
    return of_sensor(rng, drawn_junction(rng, medium)[0])


def in_relaxing_bath(rng: np.random.Generator) -> Dip:
    """A layered sensor in a bath that changes exponentially by 2 to 6 % of the step."""
    sensor = drawn(rng, str(rng.choice(["water", "oil"])))
    dip = of_sensor(rng, sensor)
    share = rng.uniform(0.02, 0.06) * rng.choice([-1.0, 1.0], p=[0.25, 0.75])
    bath_s = float(np.exp(rng.uniform(np.log(1.0), np.log(8.0)))) * sensor.lag_s
    since_s = np.maximum(dip.since_s, 0.0)
    # of the sensor's modes each follows the exponential bath exactly
    taus = sensor.taus_s
    followed = (
        bath_s * np.exp(-since_s[:, None] / bath_s) - taus * np.exp(-since_s[:, None] / taus)
    ) / (bath_s - taus)
    relaxed = (1 - followed) @ sensor.shares
    return Dip(dip.since_s, dip.response - share * relaxed, dip.lag_s, dip.times_s)


def with_wide_prior(rng: np.random.Generator) -> Dip:
    """A layered sensor, of which the lag of the medium is specified as uncertain."""
    dip = of_sensor(rng, drawn(rng, str(rng.choice(["water", "oil"]))))
    return Dip(dip.since_s, dip.response, dip.lag_s, dip.times_s, options={"medium_s": (0.3, 0.3)})


def by_stopwatch(rng: np.random.Generator) -> Dip:
    """A slow layered sensor, read by eye: 11 to 20 readings, at rows that become rarer.

    A reading is taken 0.3 s (standard deviation) before or after its time, and rounded to 0.1 K;
    the first one is the level before the entry. The steps are 5 s, later 10 to 60 s.
    """
    while True:
        sensor = drawn(rng, str(rng.choice(["water", "oil", "air"])))
        if 10 < sensor.lag_s < 40:
            break
    shift_s = rng.uniform(-0.3, 0.3)
    ends = [0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 30, 36, 48, 60, 72]
    last = int(np.argmax(np.array(ends) * 5.0 > 5 * sensor.times_s()[1]))
    rows_s = 5.0 * np.arange(ends[last] + 1)
    is_read = np.isin(np.arange(len(rows_s)), ends)
    taken_s = rows_s - shift_s + 0.3 * rng.standard_normal(len(rows_s))
    taken_s[0] = -1.0
    truth = np.array(sensor.times_s())
    return Dip(
        rows_s - shift_s, sensor.step(taken_s), sensor.lag_s, truth, is_read, 0.1, step_K=0.1
    )


KINDS: dict[str, Callable[[np.random.Generator], Dip]] = {
    "steady": lambda rng: with_changing_film(rng, 0.0, 0.0),
    "half": lambda rng: with_changing_film(rng, -0.5, -0.5),
    "twice": lambda rng: with_changing_film(rng, 1.0, 1.0),
    "fin-water": lambda rng: with_fin(rng, "water"),
    "fin-air": lambda rng: with_fin(rng, "air"),
    "relaxes": in_relaxing_bath,
    "wide": with_wide_prior,
    "stopwatch": by_stopwatch,
}


def judge(kind: str, index: int, seed: int) -> tuple[tuple[float, ...], list[str]] | str:
    """Departures over u of lag and times, errors and u of lag and t63.2, of the crossing; codes."""
    rng = np.random.default_rng([seed, index])
    dip = KINDS[kind](rng)
    noise_K = dip.noise_K or float(np.exp(rng.uniform(np.log(0.02), np.log(0.2))))
    noise = noise_K * rng.standard_normal(len(dip.since_s))
    exact = 20 + STEP_K * dip.response + noise
    reading = dip.step_K * np.round(exact / dip.step_K)
    if dip.is_read is not None:
        reading = np.where(dip.is_read, reading, np.nan)
    by_hand = crossing_by_hand(dip.since_s, reading)
    rows_s = dip.since_s - dip.since_s[0]
    try:
        found = plunge_sensor(rows_s, reading, "T", **dip.options)
    except InputError as problem:
        return str(problem)
    lag = found.chain.channels["T"].lag_s
    times = list(found.times["T"].values())
    errors = [lag.value - dip.lag_s, *(e.value - v for e, v in zip(times, dip.times_s))]
    us = [lag.u, *(e.u for e in times)]
    rise_s = dip.times_s[1]
    numbers = (
        *np.divide(errors, us),
        errors[0] / dip.lag_s,
        us[0] / dip.lag_s,
        errors[2] / rise_s,
        us[2] / rise_s,
        by_hand / rise_s - 1,
    )
    return numbers, [f.code for f in found.findings if f.severity.value == "warning"]


def report(records: int, seed: int, kinds: list[str]) -> None:
    """Print the table."""
    for kind in kinds or KINDS:
        with ProcessPoolExecutor(2) as pool:
            count = range(records)
            results = list(pool.map(judge, [kind] * records, count, [seed] * records))
        refused = Counter(result for result in results if isinstance(result, str))
        judged = [result for result in results if not isinstance(result, str)]
        table = np.array([numbers for numbers, _ in judged])
        codes = [set(found) for _, found in judged]
        held = 100 * np.mean(np.abs(table[:, :4]) < 1.96, axis=0)
        rms, rms_time, rms_hand = 100 * np.sqrt(np.mean(table[:, [4, 6, 8]] ** 2, axis=0))
        u, time_u = 100 * np.median(table[:, [5, 7]], axis=0)
        far = np.abs(table[:, :4]).max(axis=1) > 3
        silent = sum(is_far and not found for is_far, found in zip(far, codes))
        print(
            f"{kind:10s} covered: lag {held[0]:5.1f} %, t50 {held[1]:5.1f}, t63.2 {held[2]:5.1f}, "
            f"t90 {held[3]:5.1f} %; lag: rms error {rms:.1f} %, median u {u:.1f} %; t63.2: rms "
            f"{rms_time:.2f} %, u {time_u:.2f} %, by hand {rms_hand:.2f} %; beyond 3 u "
            f"{far.sum()}, silent {silent} of {len(table)}",
            flush=True,
        )
        print("          ", dict(Counter(code for found in codes for code in found)), flush=True)
        for message, times in refused.items():
            print(f"           refused {times} x {message[:150]}", flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    numbers = [int(word) for word in words[:2]]
    report(*[*numbers, *(40, 95501)[len(numbers) :]], words[2:])
