"""The history of a lag: false alarms, changes that are noticed, coverage of the change.

`python -m tests.sensors.history_study [HISTORIES] [SEED]` prints for each kind of history how often
a change is reported (a steady sensor: the rate of false alarms), how often the 95 % interval
contains the true change over the record, its median half width, and the median probability of a
step. `python -m tests.sensors.history_study logs [SEED]` measures twelve simulated logs of a sensor
that slows by 20 %, and of a steady one, with `tcdyn sensor noise`, and prints both histories. The
measurements are drawn by code of their own.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.sensors.change import find_change
from tcdyn.sensors.history import FALSE_ALARM_RATE
from tcdyn.workflows.history import history_of_logs
from tests.sensors.sensor_world import fluctuating

YEAR_DAYS = 365.0


@dataclass(frozen=True)
class Kind:
    """A kind of history.

    ``u``: relative standard uncertainty of each measurement; ``spread``: between them; ``slope``:
    relative change in a year; ``step``: in mid-year; ``wave``: amplitude of a wave of one year;
    ``heavy``: errors and spread are Student t of 4 degrees of freedom with these scales.
    """

    name: str
    count: int = 52
    irregular: bool = False
    u: float = 0.02
    spread: float = 0.02
    slope: float = 0.0
    step: float = 0.0
    wave: float = 0.0
    heavy: bool = False


SHAPES = (("steady", {}), ("slope 10 %", {"slope": 0.1}), ("step 10 %", {"step": 0.1}))


def kinds() -> list[Kind]:
    """All kinds of the study."""
    listed = []
    for count, irregular in ((52, False), (12, True), (5, True)):
        for u in (0.02, 0.05):
            for name, shape in SHAPES:
                listed.append(replace(Kind(name, count, irregular, u), **shape))
    for spread in (0.001, 0.1):
        listed += [Kind("steady", count, count < 52, spread=spread) for count in (52, 5)]
    for count in (52, 5):
        listed += [
            Kind("steady, heavy tails", count, count < 52, heavy=True),
            Kind("slope 10 %, heavy tails", count, count < 52, slope=0.1, heavy=True),
            Kind("steady, wave 3 %", count, count < 52, wave=0.03),
            Kind("slope 10 %, wave 3 %", count, count < 52, slope=0.1, wave=0.03),
        ]
    return listed


def drawn(kind: Kind, rng: np.random.Generator) -> tuple[Array, Array, float]:
    """Days, logarithms of the lags, and the true relative change over the record."""
    days = np.linspace(0, YEAR_DAYS * (1 - 1 / kind.count), kind.count)
    if kind.irregular:
        days = np.sort(rng.uniform(0, YEAR_DAYS, kind.count))
    drift = np.log1p(kind.slope) * days / YEAR_DAYS
    drift += np.log1p(kind.step) * (days > YEAR_DAYS / 2)
    wave = kind.wave * np.cos(2 * np.pi * days / YEAR_DAYS)
    errors = rng.standard_t(4, (2, kind.count)) if kind.heavy else rng.normal(size=(2, kind.count))
    log_lag = drift + wave + kind.u * errors[0] + kind.spread * errors[1]
    return days, log_lag, float(np.expm1(drift[-1] - drift[0]))


def judge(kind: Kind, histories: int, seed: int) -> Array:
    """Of each history: noticed, covered, half width of the interval, probability of a step."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(histories):
        days, log_lag, truth = drawn(kind, rng)
        change = find_change(days, log_lag, np.full(kind.count, kind.u**2))
        half = 0.5 * (change.total.high95 - change.total.low95)
        is_noticed = change.p_value <= FALSE_ALARM_RATE
        rows.append((is_noticed, change.total.contains(truth), half, change.step_probability))
    return np.array(rows, dtype=float)


def report(histories: int, seed: int) -> None:
    """Print the table."""
    for kind in kinds():
        table = judge(kind, histories, seed)
        noticed, covered = 100 * table[:, :2].mean(axis=0)
        half, step = np.median(table[:, 2:], axis=0)
        dates = "irregular" if kind.irregular else "even"
        print(
            f"{kind.count:3d} {dates:9s} u {kind.u:.3f} spread {kind.spread:.3f} {kind.name:24s} "
            f"noticed {noticed:5.1f} %, covered {covered:5.1f} %, half width {100 * half:5.1f} %, "
            f"probability of a step {step:.2f}",
            flush=True,
        )


def write_log(path: Path, date: pd.Timestamp, lag_s: float, seed: int) -> Path:
    """A log of 6000 rows at constant conditions, by a sensor of two lags."""
    time_s, reading_degC = fluctuating(seed, (0.85 * lag_s, 0.15 * lag_s), 0.1, 6000, 0.02)
    stamps = date + pd.to_timedelta(time_s, unit="s")
    pd.DataFrame({"time": stamps, "T1_degC": reading_degC.round(4)}).to_csv(path, index=False)
    return path


def report_logs(seed: int) -> None:
    """Print the history of a sensor that slows, and of a steady one, from twelve logs each."""
    months = pd.date_range("2025-01-15", periods=12, freq="MS")
    for total in (0.2, 0.0):
        with TemporaryDirectory() as folder:
            logs = [
                write_log(Path(folder, f"{k:02d}.csv"), month, 1 + total * k / 11, seed + k)
                for k, month in enumerate(months)
            ]
            history = history_of_logs(logs, "noise", "T1")
        print(f"true change {100 * total:.0f} %", history.summary(), sep="\n", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["logs"]:
        report_logs(int(sys.argv[2]) if len(sys.argv) > 2 else 7)
    else:
        numbers = [int(a) for a in sys.argv[1:]]
        report(*[*numbers, *(200, 97001)[len(numbers) :]])
