"""How often report on change is recognised, and how honest the values are that were not written.

``python -m tests.series.on_change_study find 300 1`` makes so many logs of each sort with this
seed. ``python -m tests.series.on_change_study fill 50 1`` makes so many logs of each signal, and
prints the errors of the values that were not written over their standard uncertainties. ``python -m
tests.series.on_change_study lags 20 1`` makes so many dips for each lag, dead band and noise, and
prints how often the interval of the lag contains it, as ``tcdyn sensor plunge`` reads such a file.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95
from tcdyn.sensors.measure import sensor_from_dip
from tcdyn.series import fit_clock
from tcdyn.series.on_change import DeadBand, find_dead_band, unchanged_values

Rng = np.random.Generator
POLLS_S = (0.1, 0.5, 1.0, 2.0, 10.0, 60.0)
SIGNALS = ("dips", "steps of lags", "ramps", "sines", "random walk", "smooth random", "rest")
ORDINARY = (
    "lost rows",
    "many lost rows",
    "gaps",
    "bursts",
    "slow column",
    "slow column, lost",
    "hand readings",
    "faster in events",
    "wandering clock",
    "random rows",
)


def signal(rng: Rng, kind: str, n: int) -> Array:
    """A temperature at n polls that ranges over 5 to 100 K, without noise."""
    i = np.arange(n)
    size = 10 ** rng.uniform(0.7, 2)
    if kind == "dips":
        entry = n * rng.uniform(0.05, 0.3)
        lag = n * 10 ** rng.uniform(-2.5, -0.7)
        return np.asarray(20 + size * np.where(i > entry, 1 - np.exp(-(i - entry) / lag), 0))
    if kind == "steps of lags":
        places = np.sort(rng.integers(0, n, int(rng.integers(2, 10))))
        levels = rng.uniform(-0.5, 0.5, len(places) + 1) * size
        lag = n * 10 ** rng.uniform(-3.0, -1.5)
        x = levels[np.searchsorted(places, i, side="right")]
        y = np.empty(n)
        y[0] = x[0]
        gain = 1 - np.exp(-1 / lag)
        for k in range(1, n):
            y[k] = y[k - 1] + gain * (x[k] - y[k - 1])
        return 20 + y
    if kind == "ramps":
        knots = np.sort(np.append(rng.uniform(0, n, int(rng.integers(2, 8))), [0, n]))
        return 20 + np.interp(i, knots, rng.uniform(-0.5, 0.5, len(knots)) * size)
    if kind == "sines":
        phase = 2 * np.pi * (rng.uniform(1, 8) * i / n + rng.random())
        return np.asarray(20 + 0.5 * size * np.sin(phase))
    if kind == "random walk":
        return np.asarray(20 + size * np.cumsum(rng.normal(0, 1, n)) / np.sqrt(n))
    if kind == "smooth random":
        n_terms = int(rng.integers(3, 12))
        phases = 2 * np.pi * rng.random(n_terms)
        weights = rng.normal(0, 1, n_terms) / np.sqrt(n_terms)
        orders = rng.uniform(0.3, 15, n_terms)
        terms = np.sin(2 * np.pi * np.outer(i / n, orders) + phases)
        return np.asarray(20 + 0.5 * size * terms @ weights)
    return np.full(n, 20.0)


def written_rows(reading: Array, dead_band: float, heartbeat: int) -> NDArray[np.intp]:
    """Polls at which a logger with a dead band writes a row; heartbeat in polls, 0: none."""
    rows = [0]
    for k in range(1, len(reading)):
        has_changed = abs(reading[k] - reading[rows[-1]]) >= dead_band - 1e-9
        if has_changed or (heartbeat and k - rows[-1] >= heartbeat):
            rows.append(k)
    return np.array(rows)


def ordinary_rows(rng: Rng, kind: str, x: Array) -> NDArray[np.intp]:
    """Rows of an ordinary log of the signal x (N,), whose gaps have no part in its values."""
    n = len(x)
    places = np.arange(n)
    if kind == "lost rows":
        return places[rng.random(n) > rng.uniform(0.01, 0.3)]
    if kind == "many lost rows":
        return places[rng.random(n) > rng.uniform(0.4, 0.9)]
    if kind == "gaps":
        keep = np.ones(n, dtype=bool)
        for _ in range(int(rng.integers(1, 20))):
            start = int(rng.integers(n))
            keep[start : start + int(rng.integers(2, n // 10))] = False
        return places[keep]
    if kind == "bursts":
        return places[places % int(rng.integers(20, 100)) < int(rng.integers(2, 10))]
    period = int(rng.integers(2, 30))
    if kind == "slow column":
        return places[::period]
    if kind == "slow column, lost":
        rows = places[::period]
        return rows[rng.random(len(rows)) > rng.uniform(0.05, 0.5)]
    if kind == "hand readings":
        steps = 1 + rng.gamma(rng.uniform(0.5, 5), n / 400, n // 5).astype(int)
        rows = np.cumsum(steps)
        return rows[rows < n]
    if kind == "faster in events":
        rate = np.abs(np.gradient(x))
        is_event = rate > np.quantile(rate, rng.uniform(0.5, 0.95))
        is_event = np.convolve(is_event, np.ones(int(rng.integers(1, n // 20))), "same") > 0
        return places[is_event | (places % period == 0)]
    if kind == "wandering clock":
        rows = np.cumsum(np.maximum(np.rint(rng.normal(6, rng.uniform(0.5, 2), n // 4)), 1))
        return rows[rows < n].astype(np.intp)
    return np.unique(rng.integers(0, n, n // int(rng.integers(2, 20))))


def make_log(rng: Rng) -> tuple[str, float, Array]:
    """Signal, poll interval [s], and the rounded readings at all polls."""
    kind = str(rng.choice(SIGNALS))
    n = int(rng.choice([500, 2000, 6000]))
    x = signal(rng, kind, n)
    noise = 10 ** rng.uniform(-3, -0.5) if rng.random() < 0.8 else 0.0
    resolution = float(rng.choice([0.001, 0.01, 0.0625, 0.1]))
    y = np.round((x + rng.normal(0, 1, n) * noise) / resolution) * resolution
    return kind, float(rng.choice(POLLS_S)), y


def in_table(rng: Rng, rows: NDArray[np.intp], y: Array, dt_s: float) -> tuple[Array, Array]:
    """Stamps and values of a table; one in two has other rows, in which the column is blank."""
    values = np.full(len(y), np.nan)
    values[rows] = y[rows]
    kept = rows
    if rng.random() < 0.5:
        other = rng.random(len(y)) < rng.uniform(0.05, 1.0)
        other[rows] = True
        kept = np.flatnonzero(other)
    jitter = rng.choice([0.0, 0.0, 0.02]) * rng.uniform(-0.5, 0.5, len(kept))
    return dt_s * (kept + jitter), values[kept]


def ordinary(rng: Rng) -> tuple[str, DeadBand | None]:
    """Kind of an ordinary log and what is found; none should be."""
    name, dt_s, y = make_log(rng)
    kind = str(rng.choice(ORDINARY))
    rows = ordinary_rows(rng, kind, y)
    stamps_s, values = in_table(rng, rows, y, dt_s)
    return f"{kind}, {name}", find_dead_band(values, fit_clock(stamps_s))


def on_change(rng: Rng) -> tuple[str, float, int, DeadBand | None]:
    """Kind of a log on change, dead band, readings, and what is found."""
    while True:
        name, dt_s, y = make_log(rng)
        resolution = float(np.min(np.diff(np.unique(y)), initial=1.0))
        dead_band = float(rng.choice([0.1, 0.2, 0.3, 0.5, 1.0]))
        dead_band = max(round(dead_band / resolution), 1) * resolution
        heartbeat = int(rng.choice([0, 0, len(y) // 20, len(y) // 5]))
        rows = written_rows(y, dead_band, heartbeat)
        n_changes = np.count_nonzero(np.abs(np.diff(y[rows])) >= dead_band - 1e-9)
        if n_changes >= 20 and len(rows) <= 0.7 * len(y):
            break
    stamps_s, values = in_table(rng, rows, y, dt_s)
    return name, dead_band, len(rows), find_dead_band(values, fit_clock(stamps_s))


def held(rng: Rng) -> tuple[bool, DeadBand | None]:
    """Whether an input of two or three levels is written when it is switched, and what is found."""
    n = int(rng.choice([500, 2000, 6000]))
    is_on_change = bool(rng.random() < 0.5)
    levels = np.arange(float(rng.integers(2, 4))) * rng.choice([1.0, 25.0])
    places = np.unique(rng.integers(0, n, int(rng.integers(3, 60))))
    steps = rng.integers(1, len(levels), len(places) + 1)
    x = levels[np.cumsum(steps)[np.searchsorted(places, np.arange(n), side="right")] % len(levels)]
    if is_on_change:
        rows = written_rows(x, 0.5, 0)
    else:
        rows = ordinary_rows(rng, str(rng.choice(ORDINARY)), x)
    values = np.full(n, np.nan)
    values[rows] = x[rows]
    return is_on_change, find_dead_band(values, fit_clock(np.arange(n, dtype=float)))


FILLED = ("random walk", "ramps", "dips", "rest", "sines", "smooth random")


def filled_log(rng: Rng, kind: str) -> tuple[Array, NDArray[np.intp], float]:
    """Readings at all polls in units of the dead band, rows that are written, and the noise."""
    while True:
        n = int(rng.choice([600, 2000, 6000]))
        x = signal(rng, kind, n)
        if kind != "rest":
            x *= 10 ** rng.uniform(0.5, 2.3) / np.ptp(x)
        noise = (
            rng.uniform(0.22, 0.4) if kind == "rest" else float(rng.choice([0, 0.05, 0.1, 0.25]))
        )
        y = np.round(x + noise * rng.normal(0, 1, n), 2)
        rows = written_rows(y, 1.0, int(rng.choice([0, 0, n // 20])))
        if 10 <= len(rows) <= 0.7 * n:
            return y, rows, noise


def filled_errors(rng: Rng, kind: str, most: int = 400) -> tuple[Array, Array, float]:
    """Errors of some of the values that were not written, over their u and as they are; noise."""
    y, rows, noise = filled_log(rng, kind)
    poll_s = float(rng.choice(POLLS_S))
    clock = fit_clock(np.asarray(poll_s * rows, dtype=np.float64), interval_s=poll_s)
    filled = unchanged_values(y[rows], clock, DeadBand(1.0))
    places = np.flatnonzero(filled.is_filled)
    if len(places) > most:
        places = rng.choice(places, most, replace=False)
    error = filled.values[places] - y[places]
    return error / filled.u[places], error, noise


def study_fill(n_logs: int, seed: int) -> None:
    """Print how honest the uncertainties of the values are that were not written."""
    print("signal: mean square of error over u, share within 1.96 u, rms error in dead bands,")
    print("mean square with noise of 0, 0.05, 0.1, 0.25 dead bands")
    pooled = []
    for number, kind in enumerate(FILLED):
        logs = [
            filled_errors(np.random.default_rng([seed, number, k]), kind) for k in range(n_logs)
        ]
        z = np.concatenate([log[0] for log in logs])
        error = np.concatenate([log[1] for log in logs])
        pooled.append(z)
        by_noise = []
        for noise in (0.0, 0.05, 0.1, 0.25):
            chosen = [log[0] for log in logs if log[2] == noise]
            by_noise.append(float(np.mean(np.concatenate(chosen) ** 2)) if chosen else np.nan)
        print(
            f"{kind:14s} {np.mean(z**2):.2f} {100 * np.mean(np.abs(z) < 1.96):.1f} % "
            f"{np.sqrt(np.mean(error**2)):.3f}",
            *(f"{value:.2f}" for value in by_noise),
        )
    z = np.concatenate(pooled)
    print(f"pooled         {np.mean(z**2):.2f} {100 * np.mean(np.abs(z) < 1.96):.1f} %")


def study_find(n_logs: int, seed: int) -> None:
    """Print counts of false alarms and of detections.

    Parameters
    ----------
    n_logs
        Logs of each sort.
    seed
        Seed of the random numbers.
    """
    alarms: list[str] = []
    for k in range(n_logs):
        name, found = ordinary(np.random.default_rng([seed, 0, k]))
        if found is not None:
            alarms.append(f"{name}: {found}")
    print(f"ordinary logs: {len(alarms)} of {n_logs} are taken for report on change")
    print("\n".join(alarms))
    counts: dict[str, list[int]] = {}
    for k in range(n_logs):
        name, dead_band, _, found_band = on_change(np.random.default_rng([seed, 1, k]))
        count = counts.setdefault(name, [0, 0, 0])
        count[0] += 1
        if found_band is not None:
            count[1] += 1
            count[2] += abs(found_band.value / dead_band - 1) < 0.1
    print("on change: logs, recognised, dead band within 10 %")
    for name, count in sorted(counts.items()):
        print(f"{name:16s}", *count)
    print("all", *np.sum(list(counts.values()), axis=0))
    inputs = [held(np.random.default_rng([seed, 2, k])) for k in range(n_logs)]
    for is_on_change, label in ((True, "written when switched"), (False, "ordinary")):
        chosen = [found for each, found in inputs if each == is_on_change]
        n_held = sum(found is not None and found.is_held for found in chosen)
        print(f"inputs of two or three levels, {label}: {n_held} of {len(chosen)} are held")


LAGS_S = (30.0, 120.0, 400.0)
DEAD_BANDS_K = (0.2, 0.5, 1.0)
NOISES_K = (0.0, 0.05)
STEP_K = 60.0


def dip_errors(rng: Rng, lag_s: float, dead_band: float, noise_K: float) -> tuple[float, float]:
    """Error of the lag of a dip that was written on change [s], and its standard uncertainty [s].

    The sensor rests for 300 polls of one second, and follows the step with one lag.
    """
    time_s = np.arange(300 + 8 * lag_s)
    since_s = np.maximum(time_s - 300 - rng.uniform(), 0.0)
    reading = 20 + STEP_K * -np.expm1(-since_s / lag_s) + rng.normal(0, noise_K, len(time_s))
    reading = np.round(reading, 2)
    rows = written_rows(reading, dead_band, 0)
    lag = sensor_from_dip((time_s[rows], reading[rows]), "T1").chain.channels["T1"].lag_s
    return lag.value - lag_s, lag.u


def study_lags(n_dips: int, seed: int) -> None:
    """Print the coverage of the 95 % interval of the lag (1.96 u), and errors over u.

    Parameters
    ----------
    n_dips
        Dips for each lag, dead band and noise.
    seed
        Seed of the random numbers.
    """
    print("lag [s], dead band [K], noise [K]: covered, rms error [s], median u [s], refused")
    for cell in product(LAGS_S, DEAD_BANDS_K, NOISES_K):
        results = []
        for k in range(n_dips):
            rng = np.random.default_rng([seed, 3, k])
            with suppress(InputError):
                results.append(dip_errors(rng, *cell))
        if not results:
            print(*cell, "all refused", flush=True)
            continue
        errors_s, u_s = np.array(results).T
        n_covered = int(np.count_nonzero(np.abs(errors_s) < Z95 * u_s))
        rms_s = float(np.sqrt(np.mean(errors_s**2)))
        n_refused = n_dips - len(results)
        print(*cell, n_covered, f"{rms_s:.3g} {np.median(u_s):.3g}", n_refused, flush=True)


if __name__ == "__main__":
    study = {"find": study_find, "fill": study_fill, "lags": study_lags}[sys.argv[1]]
    study(int(sys.argv[2]), int(sys.argv[3]))
