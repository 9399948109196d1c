"""Small valid logs of each kind, for tests that read, reshape and damage them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from tcdyn.rig.disk import CHANNELS, DISKS

RATE_HZ = 75.0
DEPTHS = dict(zip(CHANNELS, (3.0, 6.0, 3.0, 6.0, 1.25, 6.0)))


def ehl_frame(n: int = 3000, seed: int = 0) -> pd.DataFrame:
    """40 s of an EHL test: loading at 5 s, unloading at 30 s, first-order warming, 0.15 degC
    noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / RATE_HZ
    contact = ((t > 5.0) & (t < 0.75 * t[-1])).astype(float)
    pole = float(np.exp(-1 / RATE_HZ / 4.0))
    warm = lfilter([1 - pole], [1, -pole], contact)
    columns = {
        "time_s": t,
        "load_N": 2000 * contact + rng.normal(5, 3, n),
        "friction_N": 60 * contact + rng.normal(0, 0.5, n),
        "contact": contact,
        "speed_fast_rpm": rng.normal(4000, 2, n),
        "speed_slow_rpm": rng.normal(4000 / 4.24, 1, n),
    }
    for disk, rise in zip(DISKS, (80.0, 60.0)):
        for channel, depth in DEPTHS.items():
            columns[f"{disk}_{channel}_degC"] = (
                25 + rise * (1 - 0.03 * depth) * warm + rng.normal(0, 0.15, n)
            )
    columns["ambient_degC"] = 22 + rng.normal(0, 0.1, n)
    columns["oil_degC"] = 60 + rng.normal(0, 0.1, n)
    return pd.DataFrame(columns)


def immersion_frame(n: int = 3000, seed: int = 0, momentary: bool = False) -> pd.DataFrame:
    """40 s of a plunge into oil at 100 degC, entry at 5 s."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / RATE_HZ
    time_since_entry = np.maximum(t - 5.0, 0.0)
    switch = (t >= 5.0) & ((t < 5.3) | (not momentary))
    columns = {"time_s": t, "switch": switch.astype(float)}
    columns["probe_degC"] = 20 + 80 * (1 - np.exp(-time_since_entry / 0.3)) + rng.normal(0, 0.12, n)
    columns["fluid_degC"] = 100 + rng.normal(0, 0.05, n)
    for channel, depth in DEPTHS.items():
        rise = 80 * (1 - np.exp(-np.maximum(time_since_entry - 0.2 - 0.02 * depth, 0) / 15.0))
        columns[f"{channel}_degC"] = 20 + rise + rng.normal(0, 0.12, n)
    return pd.DataFrame(columns)


def oven_truth(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """True gain and offset of six channels."""
    rng = np.random.default_rng([seed, 1])
    return rng.normal(1.0, 0.01, 6), rng.normal(0.0, 0.5, 6)


def oven_frame(seed: int = 0, noise: float = 0.05) -> pd.DataFrame:
    """Three repeats of 20..160 degC in 20 degC steps; the PRT errs uniformly by up to 0.1 degC."""
    rng = np.random.default_rng([seed, 2])
    gain, offset = oven_truth(seed)
    rows = []
    for repeat in (1, 2, 3):
        for setpoint in range(20, 161, 20):
            true_degC = setpoint + rng.normal(0, 0.5)
            logged = (true_degC - offset) / gain + rng.normal(0, noise, 6)
            rows.append([repeat, setpoint, true_degC + rng.uniform(-0.1, 0.1), *logged])
    names = ["repeat", "setpoint_degC", "prt_degC", *(f"{c}_degC" for c in CHANNELS)]
    return pd.DataFrame(rows, columns=names).astype(float)


def hole_frame(n: int = 1500, seed: int = 0) -> pd.DataFrame:
    """Five thermocouples at one depth, in water at 80 degC."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / RATE_HZ
    lags = {"ideal_1": 0.1, "ideal_2": 0.1, "hole_13": 0.3, "hole_22": 0.35, "hole_30": 0.8}
    columns = {"time_s": t}
    for name, lag in lags.items():
        rise = 64 * (1 - np.exp(-np.maximum(t - 3 - lag, 0) / 2.0))
        columns[f"{name}_degC"] = 16 + rise + rng.normal(0, 0.1, n)
    return pd.DataFrame(columns)


FRAMES = {"ehl": ehl_frame, "immersion": immersion_frame, "oven": oven_frame, "hole": hole_frame}


def csv_text(
    frame: pd.DataFrame, separator: str = ",", decimal: str = ".", head: str = "", units: str = ""
) -> str:
    """The frame as text, with numbers that read back exactly."""
    rows = [
        separator.join(repr(float(v)).replace(".", decimal) for v in row)
        for row in frame.to_numpy()
    ]
    header = separator.join(frame.columns) + "\n" + (units + "\n" if units else "")
    return head + header + "\n".join(rows) + "\n"


def lvm_text(
    frame: pd.DataFrame, separator: str = "\t", decimal: str = ".", comment: bool = True
) -> str:
    """The frame as LabVIEW writes it: one X column, and a comment in the first row."""
    separator_name = {"\t": "Tab", ",": "Comma", ";": "Semicolon"}[separator]
    names = [c for c in frame.columns if c != "time_s"]
    head = [
        "LabVIEW Measurement",
        f"Writer_Version{separator}2",
        f"Separator{separator}{separator_name}",
    ]
    head += [
        f"Decimal_Separator{separator}{decimal}",
        f"X_Columns{separator}One",
        "***End_of_Header***",
        "",
    ]
    head += [
        f"Channels{separator}{len(names)}",
        f"Samples{separator}{separator.join([str(len(frame))] * len(names))}",
    ]
    head += ["***End_of_Header***", separator.join(["X_Value", *names, "Comment"])]
    rows = [
        separator.join(repr(float(v)).replace(".", decimal) for v in row)
        for row in frame.to_numpy()
    ]
    if comment:
        rows[0] += separator + "first note"
    return "\n".join(head + rows) + "\n"


def write(folder: Path, name: str, text: str | bytes) -> Path:
    """Write and return the path."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path
