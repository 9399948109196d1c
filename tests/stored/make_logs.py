"""The small logs from which the stored files were made: `python -m tests.stored.make_logs FOLDER`.

Closed forms and recursions with fixed seeds; `tests/stored/files/README.md` names the commands that
made files of them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from tests.sensors.sensor_world import Sheath, fluctuating, two_in_a_gas


def dip(rng: np.random.Generator) -> pd.DataFrame:
    """Lags of 1.5 and 0.2 s, from 20 to 80 degC at 2 s."""
    t = np.arange(400) * 0.05
    after_s = np.clip(t - 2.0, 0, None)
    rest = (1.5 * np.exp(-after_s / 1.5) - 0.2 * np.exp(-after_s / 0.2)) / 1.3
    reading = 20 + 60 * (1 - rest) + 0.05 * rng.standard_normal(t.size)
    return pd.DataFrame({"time_s": t, "T1_degC": np.round(reading, 3)})


def input_and_output(rng: np.random.Generator) -> pd.DataFrame:
    """Gain 2, lag 0.8 s, dead time 0.3 s, by steps of 0.01 s."""
    n = 600
    power = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    late = np.concatenate([np.zeros(30), np.repeat(power, 10)[:-30]])
    keep = np.exp(-0.01 / 0.8)
    y = np.zeros(n * 10)
    for i in range(1, y.size):
        y[i] = keep * y[i - 1] + (1 - keep) * 2.0 * late[i - 1]
    reading = np.round(20 + y[::10] + 0.02 * rng.standard_normal(n), 4)
    return pd.DataFrame({"time_s": np.arange(n) * 0.1, "power_W": power, "T_degC": reading})


def bode(rng: np.random.Generator) -> pd.DataFrame:
    """The frequency response of the same."""
    f = np.logspace(-2, 0.5, 20)
    g = 2.0 * np.exp(-2j * np.pi * f * 0.3) / (1 + 2j * np.pi * f * 0.8)
    g = g + 0.01 * (rng.standard_normal(20) + 1j * rng.standard_normal(20))
    columns = {
        "frequency_Hz": f,
        "gain": np.abs(g),
        "phase_deg": np.degrees(np.unwrap(np.angle(g))),
    }
    return pd.DataFrame({**columns, "u": np.full(20, 0.01)}).round(6)


def run(rng: np.random.Generator) -> pd.DataFrame:
    """A log to follow."""
    t = np.arange(1200) * 0.05
    reading = 50 + 10 * np.sin(t / 4) + 0.05 * rng.standard_normal(t.size)
    return pd.DataFrame({"time_s": t, "T1_degC": np.round(reading, 3)})


def two_inputs() -> pd.DataFrame:
    """Gains 2 and 0.5, lags 0.8 and 2 s, one for each input."""
    rng = np.random.default_rng(31)
    n = 500
    a = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
    b = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    keep_a, keep_b = np.exp(-0.1 / np.array([0.8, 2.0]))
    by_a = lfilter([0.0, 1 - keep_a], [1.0, -keep_a], a)
    by_b = lfilter([0.0, 1 - keep_b], [1.0, -keep_b], b)
    y = 20 + 2.0 * by_a + 0.5 * by_b + 0.02 * rng.standard_normal(n)
    return pd.DataFrame({"time_s": np.arange(n) * 0.1, "a": a, "b": b, "T_degC": y}).round(4)


def logs() -> dict[str, pd.DataFrame]:
    """All logs by the names of their files."""
    rng = np.random.default_rng(29)
    tables = {
        "dip.csv": dip(rng),
        "io.csv": input_and_output(rng),
        "bode.csv": bode(rng),
    }
    t, first, second, _ = two_in_a_gas(3, (0.15, 0.5), 0.02, 3000, (0.3, 0.3))
    pair = pd.DataFrame({"time_s": t, "T1_degC": first, "T2_degC": second})
    tables["pair.csv"] = pair.round(4)
    t, reading = fluctuating(5, (1.0, 0.2), 0.05, 20_000, 0.05)
    tables["noise.csv"] = pd.DataFrame({"time_s": t, "T1_degC": reading}).round(4)
    tables["run.csv"] = run(rng)
    draws = np.random.default_rng(2)
    t, reading, power = Sheath.drawn(draws).heated(draws, 0.003)
    heated = pd.DataFrame({"time_s": t, "T1_degC": 50 + reading, "current_A": power})
    tables["lcsr.csv"] = heated.round(5)
    tables["two.csv"] = two_inputs()
    return tables


def main(folder: Path) -> None:
    """Write all logs into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in logs().items():
        table.to_csv(folder / name, index=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
