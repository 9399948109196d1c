"""A slow record that is compensated, beside a fast one of the same quantity.

`python -m tests.smoothing.public_pair_study FILE LAG_S U_S [UNIT]` reads a CSV file with columns
time_s, fast and slow, at even times, and prints one line for each way of compensation: rms
difference to the fast record, coverage of the 95 % band, median u, and R2 of means over 0.05, 0.1,
0.25, 0.5 and 1 lag. Gain and offset of the fast record are fitted, through the lag, to the slow
one. `docs/pairs.md` names the files and states the results.

Least squares with nodes, for comparison: the input is linear between nodes, whose distance is
chosen with the fast record.
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.smoothing import Compensated, smooth

WINDOWS_LAGS = (0.05, 0.1, 0.25, 0.5, 1.0)
NODES_LAGS = np.geomspace(0.05, 3.0, 15)


def lagged(x: Array, lag_s: float, dt_s: float) -> Array:
    """Response of a lag to an input that is linear between samples, settled before the first."""
    keep = np.exp(-dt_s / lag_s)
    share = (1 - keep) * lag_s / dt_s
    return np.asarray(lfilter([1 - share, share - keep], [1, -keep], x - x[0])) + x[0]


def matched(fast: Array, slow: Array, time_s: Array, lag_s: float) -> tuple[Array, Array]:
    """The fast record with the gain and offset of the slow one, and the difference that remains."""
    response = lagged(fast, lag_s, time_s[1] - time_s[0])
    start = np.exp(-(time_s - time_s[0]) / lag_s)
    columns = np.column_stack([response, np.ones_like(response), start])
    (gain, offset, settling), *_ = np.linalg.lstsq(columns, slow)
    print(f"gain {gain:.3f}, offset {offset:.4g}")
    remains = slow - columns @ np.array([gain, offset, settling])
    return gain * fast + offset, remains


def with_nodes(slow: Array, time_s: Array, lag_s: float, apart_s: float) -> Array:
    """Least squares with an input that is linear between nodes so many seconds apart."""
    count = max(round(float(time_s[-1] - time_s[0]) / apart_s), 1) + 1
    node_s = np.linspace(time_s[0], time_s[-1], count)
    inputs = np.stack([np.interp(time_s, node_s, unit) for unit in np.eye(count)], axis=1)
    dt_s = time_s[1] - time_s[0]
    responses = np.stack([lagged(column, lag_s, dt_s) for column in inputs.T], axis=1)
    start = np.exp(-(time_s - time_s[0]) / lag_s)
    columns = np.column_stack([responses, start])
    solution, *_ = np.linalg.lstsq(columns, slow, rcond=1e-12)
    return np.asarray(inputs @ solution[:-1])


def r_squared(estimate: Array, truth: Array, rows: int) -> float:
    """R2 of the means over so many rows."""
    count = len(truth) // rows * rows
    means, of_truth = (x[:count].reshape(-1, rows).mean(axis=1) for x in (estimate, truth))
    return float(1 - np.sum((means - of_truth) ** 2) / np.sum((of_truth - of_truth.mean()) ** 2))


def line(name: str, estimate: Array, truth: Array, windows: list[int]) -> str:
    """One line without a band."""
    rms = np.sqrt(np.mean((estimate - truth) ** 2))
    shares = " ".join(f"{r_squared(estimate, truth, rows):6.3f}" for rows in windows)
    return f"{name:28s} rms {rms:8.4g}  R2 {shares}"


def line_of(name: str, result: Compensated, truth: Array, windows: list[int]) -> str:
    """One line with the band; coverage over the rows that are reported."""
    temperature = result.temperature[:, 0]
    sd = result.sd[:, 0]
    is_reported = np.ones(len(sd), dtype=bool)
    if result.undetermined is not None:
        is_reported = ~result.undetermined[:, 0]
    held = np.mean((np.abs(temperature - truth) < 1.96 * sd)[is_reported])
    return (
        f"{line(name, temperature, truth, windows)}  coverage {100 * held:5.1f} %  "
        f"median u {np.median(sd[is_reported]):.4g}  reported {100 * is_reported.mean():.0f} %"
    )


def report(path: str, lag_s: float, u_s: float, unit: str) -> None:
    """Print the table of one pair."""
    table = pd.read_csv(path)
    time_s, fast, slow = (table[name].to_numpy(float) for name in ("time_s", "fast", "slow"))
    dt_s = float(time_s[1] - time_s[0])
    windows = [max(round(share * lag_s / dt_s), 1) for share in WINDOWS_LAGS]
    truth, remains = matched(fast, slow, time_s, lag_s)
    remains_sd = float(np.std(remains))
    noise_sd = float(np.std(np.diff(slow, 2)) / np.sqrt(6))
    print(f"difference that remains {remains_sd:.4g}, noise of the slow record {noise_sd:.4g}")
    chain = Chain((lag_s,), conditioning=NO_CONDITIONING)
    u2 = [[u_s**2]]
    units = [unit]
    print(line("slow record", slow, truth, windows))
    known = smooth(slow, dt_s, chain, lag_covariance=u2, units=units)
    print(line_of("known lag", known, truth, windows))
    wide = smooth(slow, dt_s, chain, lag_covariance=u2, static_u=remains_sd, units=units)
    print(line_of("known lag, static u", wide, truth, windows))
    stated = smooth(slow, dt_s, lag_s, lag_covariance=u2, units=units)
    print(line_of("stated lag", stated, truth, windows))
    both = smooth(slow, dt_s, lag_s, lag_covariance=u2, static_u=remains_sd, units=units)
    print(line_of("stated lag, static u", both, truth, windows))
    rng = np.random.default_rng(1)
    alike = lagged(truth, lag_s, dt_s) + noise_sd * rng.standard_normal(len(slow))
    control = smooth(alike, dt_s, chain, lag_covariance=u2, units=units)
    print(line_of("fast record, lagged", control, truth, windows))
    nodes = [with_nodes(slow, time_s, lag_s, share * lag_s) for share in NODES_LAGS]
    best = int(np.argmin([np.mean((x - truth) ** 2) for x in nodes]))
    print(line(f"nodes {NODES_LAGS[best]:.2f} lags apart", nodes[best], truth, windows))


if __name__ == "__main__":
    path_, lag_, u_, *rest_ = sys.argv[1:]
    report(path_, float(lag_), float(u_), rest_[0] if rest_ else "degC")
