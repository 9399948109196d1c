"""Logs of which everything is known: samples, stamps, readings, and why a cell holds no reading.

No function of the package makes them, and none writes them: ``tests.series.corpus`` writes each of
them as one logger or another does.

The process is the same in all: a heater ``u`` is switched on once, the fluid follows at once and
varies smoothly, and two sensors of one lag each, a fine and a coarse one, are in it. So every
command has what it needs: a step for a dip, one fluid for a pair, an input for an identification.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

START_DEGC = 20.0
STEP_K = 30.0
HEATER_PERCENT = 50.0
NOISE_K = 0.03
# The heater is switched on at this share of the record.
STEP_AT = 0.2
# Lags [s]: at least these, and so many rows.
FINE_S, FINE_ROWS = 0.5, 4.0
COARSE_S, COARSE_ROWS = 1.5, 12.0
# Smooth variation of the fluid: amplitude [K], and waves in the record.
WAVES = ((0.4, 2.3), (0.25, 5.7), (0.15, 11.1))
# Errors of a fitted interval that are allowed, in standard deviations of that of a straight line.
INTERVAL_SIGMAS = 6.0
# Relative error of an interval of stamps without any error: rounding in the file.
INTERVAL_RTOL = 1e-6
# Amplitude of a wave of the clock, in intervals, from which rows pass those of an even grid.
LARGEST_WAVE = 0.5
# Standard deviations of jitter that occur.
LARGEST_JITTER = 2.5


@dataclass(frozen=True)
class Log:
    """A log before it is written.

    Attributes
    ----------
    interval_s
        True sampling interval [s].
    interval_rtol
        Relative error of an interval that a fit to the stamps may have.
    sample
        Number of the sample that each row is (N,), 0 for the first row.
    stamp_s
        Stamp of each row (N,) [s], 0 for the true time of the first row.
    cells
        Text of each cell by column: "fine", "coarse", "u"; a number has a decimal point.
    reasons
        Why a cell is no reading, by column of temperature: "" (it is one), "empty", "word", "code",
        "range" or "repeat".
    unit
        Unit of the temperatures.
    knows_samples
        Whether there is a true sample of each row; not for a clock without a grid.
    tick_s
        Step of the clock [s]; 0: none.
    """

    interval_s: float
    interval_rtol: float
    sample: NDArray[np.intp]
    stamp_s: Array
    cells: dict[str, tuple[str, ...]]
    reasons: dict[str, tuple[str, ...]]
    unit: str = "degC"
    knows_samples: bool = True
    tick_s: float = 0.0

    @property
    def rows(self) -> int:
        """Rows of the file."""
        return len(self.sample)

    def values(self, column: str) -> Array:
        """The cells of a column as numbers, NaN for a blank one."""
        return np.array([float(cell) if cell else np.nan for cell in self.cells[column]])


def make_log(
    samples: int,
    interval_s: float,
    seed: int,
    *,
    jitter: float = 0.0,
    stamp_jitter: float = 0.0,
    lost: float = 0.0,
    gaps: Sequence[tuple[int, int]] = (),
    wander: float = 0.0,
    loop: float = 0.0,
    tick_s: float = 0.0,
    cut: bool = True,
    unit: str = "degC",
    digits: int = 2,
) -> Log:
    """A log of the process.

    Parameters
    ----------
    samples, interval_s
        Samples before any is lost, and their interval [s].
    seed
        Seed of the random numbers.
    jitter, stamp_jitter
        Standard deviations, in intervals, of the instants of sampling, and of the stamps only.
    lost
        Share of the samples that are lost, one by one.
    gaps
        First sample and number of the samples of each gap.
    wander
        Amplitude of a slow wave of the clock, in intervals.
    loop
        Scatter of the steps of a loop that waits and then reads, in intervals: rows leave any grid.
    tick_s
        Step of the clock [s]; 0: none.
    cut
        Whether stamps are cut to the step of the clock, or rounded.
    unit
        Unit of the temperatures: degC, K or degF.
    digits
        Decimals of the temperatures.
    """
    rng = np.random.default_rng(seed)
    is_kept = rng.random(samples) >= lost
    is_kept[[0, 1, -2, -1]] = True
    for first, count in gaps:
        is_kept[first : first + count] = False
    sample = np.flatnonzero(is_kept)
    n = len(sample)
    taken_s = interval_s * sample
    taken_s = taken_s + jitter * interval_s * _deviates(rng, n)
    if loop:
        steps = rng.gamma(1 / loop**2, loop**2, n - 1)
        steps *= (samples - 1) / steps.sum()
        taken_s = np.append(0.0, interval_s * np.cumsum(steps))
    wave = np.sin(6 * np.pi * sample / samples)
    stamp_s = taken_s + interval_s * (stamp_jitter * _deviates(rng, n) + wander * wave)
    stamp_s = np.sort(stamp_s)
    if tick_s and cut:
        stamp_s = tick_s * np.floor(stamp_s / tick_s + 1e-9)
    elif tick_s:
        stamp_s = tick_s * np.rint(stamp_s / tick_s)
    deviation = np.hypot(jitter, stamp_jitter)
    rtol = INTERVAL_RTOL + INTERVAL_SIGMAS * deviation * np.sqrt(12) / n**1.5
    # both ends of the line may be off by a step of the clock, or by the wave
    rtol += (tick_s / interval_s + wander) / n
    fine, coarse, on = _process(taken_s, samples * interval_s, interval_s)
    cells = {}
    for column, degC in (("fine", fine), ("coarse", coarse)):
        noisy = degC + NOISE_K * rng.normal(size=n)
        cells[column] = tuple(f"{value:.{digits}f}" for value in in_unit(noisy, unit))
    cells["u"] = tuple(f"{HEATER_PERCENT:.1f}" if is_on else "0.0" for is_on in on)
    has_grid = not loop and wander < LARGEST_WAVE
    reasons = dict.fromkeys(("fine", "coarse"), ("",) * n)
    return Log(interval_s, float(rtol), sample, stamp_s, cells, reasons, unit, has_grid, tick_s)


def _deviates(rng: np.random.Generator, count: int) -> Array:
    """Standard normal numbers without the rare large ones, which would exchange rows; 0 first."""
    deviates = np.clip(rng.normal(size=count), -LARGEST_JITTER, LARGEST_JITTER)
    deviates[0] = 0.0
    return deviates


def _process(t: Array, duration_s: float, interval_s: float) -> tuple[Array, Array, Any]:
    """Temperatures of both sensors [degC] and the state of the heater at times ``t`` (N,) [s]."""
    # the switch is half an interval off the samples, so that jitter leaves its row as it is
    switched_s = (np.floor(STEP_AT * duration_s / interval_s) + 0.5) * interval_s
    since_s = np.maximum(t - switched_s, 0.0)
    readings = []
    for least_s, rows in ((FINE_S, FINE_ROWS), (COARSE_S, COARSE_ROWS)):
        lag_s = max(least_s, rows * interval_s)
        degC = START_DEGC - STEP_K * np.expm1(-since_s / lag_s)
        for amplitude_K, waves in WAVES:
            omega = 2 * np.pi * waves / duration_s
            gain = amplitude_K / np.hypot(1.0, omega * lag_s)
            degC = degC + gain * np.sin(omega * t - np.arctan(omega * lag_s) + waves)
        readings.append(degC)
    return readings[0], readings[1], t > switched_s


def in_unit(degC: Array, unit: str) -> Array:
    """Temperatures in degC, K or degF."""
    if unit == "K":
        return degC + 273.15
    if unit == "degF":
        return 1.8 * degC + 32
    return degC


def put(log: Log, column: str, rows: Sequence[int], text: str, reason: str) -> Log:
    """The log with other text in some rows (from 0) of a column, which is no reading."""
    cells = list(log.cells[column])
    reasons = list(log.reasons[column])
    for row in rows:
        cells[row] = text
        reasons[row] = reason
    return replace(
        log,
        cells={**log.cells, column: tuple(cells)},
        reasons={**log.reasons, column: tuple(reasons)},
    )


def slow(log: Log, column: str, every: int, held: bool) -> Log:
    """The log with a new value of a column every so many samples: held, or blank between."""
    cells = list(log.cells[column])
    reasons = list(log.reasons[column])
    latest = cells[0]
    for row, sample in enumerate(log.sample):
        if sample % every == 0:
            latest = cells[row]
            continue
        cells[row] = latest if held else ""
        reasons[row] = "repeat" if held else "empty"
    return replace(
        log,
        cells={**log.cells, column: tuple(cells)},
        reasons={**log.reasons, column: tuple(reasons)},
    )


def repeated(log: Log, rows: Sequence[int]) -> Log:
    """The log with some rows (from 0) twice, the second time behind the first."""
    order = np.sort(np.append(np.arange(log.rows), np.asarray(rows, dtype=int)))
    return replace(
        log,
        sample=log.sample[order],
        stamp_s=log.stamp_s[order],
        cells={name: tuple(cells[k] for k in order) for name, cells in log.cells.items()},
        reasons={name: tuple(texts[k] for k in order) for name, texts in log.reasons.items()},
    )


def some_rows(log: Log, share: float, seed: int) -> list[int]:
    """Rows at random, away from both ends of the log and from each other's neighbours."""
    rng = np.random.default_rng(seed)
    count = max(round(share * log.rows), 1)
    candidates = np.arange(10, log.rows - 10, 2)
    return sorted(rng.choice(candidates, count, replace=False).tolist())


def truth_of(log: Log, names: dict[str, str], start_s: float = 0.0) -> dict[str, Any]:
    """What the maker of a log knows of its file.

    Parameters
    ----------
    log
        The log.
    names
        Names of its columns "fine" and "coarse" in the file.
    start_s
        Time of the first sample in the file [s]; 0 for stamps with a date.

    Returns
    -------
    dict
        ``interval_s`` with ``interval_rtol``, ``rows``, ``samples``, ``rows_lost``,
        ``repeated_rows``, ``gaps`` (each place without a row: ``after_row``, the row before it;
        ``start_s``, the instant of that row, within ``instant_tolerance_s``; ``rows``) and
        ``columns``; and whether it ``has_equal_stamps``.

        Rows are counted from 1. A row that stands twice counts twice in
        the columns, so the readings, the empty cells and those left out are all rows. Of a clock
        without a grid only the interval, the rows and the columns are known.
    """
    truth: dict[str, Any] = {
        "interval_s": log.interval_s,
        "interval_rtol": log.interval_rtol,
        "instant_tolerance_s": 2 * log.interval_s + log.tick_s,
        "has_equal_stamps": bool(np.any(np.diff(log.stamp_s) == 0)),
        "rows": log.rows,
    }
    if log.knows_samples:
        steps = np.diff(log.sample)
        truth["samples"] = int(log.sample[-1]) + 1
        truth["rows_lost"] = int(np.sum(steps[steps > 1] - 1))
        truth["repeated_rows"] = int(np.count_nonzero(steps == 0))
        truth["gaps"] = [
            {
                "after_row": int(row) + 1,
                "start_s": start_s + float(log.stamp_s[row]),
                "rows": int(steps[row]) - 1,
            }
            for row in np.flatnonzero(steps > 1)
        ]
    truth["columns"] = {names[column]: _column_truth(log, column) for column in names}
    return truth


def _column_truth(log: Log, column: str) -> dict[str, Any]:
    """Unit, readings, blank cells and cells left out by reason, of one column."""
    reasons = log.reasons[column]
    left_out = {
        reason: {"count": reasons.count(reason), "first_row": reasons.index(reason) + 1}
        for reason in sorted(set(reasons) - {"", "empty"})
    }
    return {
        "unit": log.unit,
        "readings": reasons.count(""),
        "empty": reasons.count("empty"),
        "left_out": left_out,
    }


def seconds(log: Log, digits: int = 3, start_s: float = 0.0, unit_s: float = 1.0) -> list[str]:
    """Stamps as numbers in a unit of so many seconds."""
    return [f"{(start_s + stamp) / unit_s:.{digits}f}" for stamp in log.stamp_s]


def clock(
    log: Log, form: str | Callable[[datetime], str], start: str = "2024-03-11 09:59:50"
) -> list[str]:
    """Stamps in a form of strftime, in which ``{ms}`` is the milliseconds, or by a function."""
    texts = []
    for stamp in log.stamp_s:
        moment = datetime.fromisoformat(start) + timedelta(microseconds=round(1e6 * stamp))
        if callable(form):
            texts.append(form(moment))
            continue
        text = moment.strftime(form)
        texts.append(text.replace("{ms}", f"{moment.microsecond // 1000:03}"))
    return texts
