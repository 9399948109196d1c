"""Means of a compensated log over a window, with the covariance between all channels of both disks.

Used by ``tcdyn.workflows.compensate.CompensatedLog.covariance``. The covariance of one channel is
that of ``tcdyn.smoothing.smoother.window_covariance``; here the errors that channels share are
added. Guarded by ``tests/smoothing/test_smoother.py`` (uncertain events).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.static_line import shared_u_K
from tcdyn.series.clock import mean_interval_s
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import window_covariance
from tcdyn.smoothing.traces import DiskTraces

# samples of a window at most: a matrix of 360 000 numbers for each channel
MAX_SAMPLES = 600


def window_means(
    log: str,
    time: Array,
    events: tuple[float, ...],
    disks: Mapping[str, DiskTraces],
    compensated: Mapping[str, Compensated],
    length_s: float,
    start_s: float | None = None,
) -> dict[str, Any]:
    """Covariance between samples, and means with the covariance between channels, over a window.

    Parameters
    ----------
    log
        Name of the log.
    time
        Times of the samples (N,) [s].
    events
        Event times [s].
    disks, compensated
        Traces and compensated record of each disk.
    length_s
        Length of the window [s].
    start_s
        Start on the clock of ``time``; the last event, such as an unloading, when left out.

    Returns
    -------
    dict
        As plain lists. ``covariance_K2``: for each channel, (n, n) for the samples at ``time_s``
        (n,); it includes noise, regularisation, lag and event times, but not the uncertainty of the
        static line, which is one error for all samples. ``mean_degC`` (M,) of ``channels`` (M,),
        and ``mean_covariance_K2`` (M, M): noise of each channel, lags (those of a disk are
        correlated), static lines, the reference that lines have in common, and the event times,
        common to both disks. ``difference_u_K`` (M, M): u of the difference of two means, sqrt(C_ii
        + C_jj - 2 C_ij).

    Raises
    ------
    InputError
        If nothing was smoothed, if there is no event to start at, or if the window is too long.

    Notes
    -----
    The noise of the mean of a channel is the mean of its covariance, less the lag and split
    contributions, which are added again with their correlation between channels. What lines have in
    common (``tcdyn.rig.static_line.shared_u_K``) is taken out of each line and added as one error
    of all channels.

    What may be changed: ``MAX_SAMPLES`` (memory and time). The contributions must be those of
    ``tcdyn.smoothing.record.Compensated.from_components``.
    """
    if start_s is None and not events:
        raise InputError(
            "the covariance begins at the last event, and there is none",
            where=log,
            remedy="say from when on: {start_s}",
            parameters={"start_s": None},
        )
    dt_s = mean_interval_s(time)
    start = events[-1] if start_s is None else start_s - time[0]
    first = max(int(np.ceil(start / dt_s - 1e-6)), 0)
    last = min(first + round(length_s / dt_s), len(time))
    if not 1 < last - first <= MAX_SAMPLES:
        raise InputError(
            f"a covariance over {last - first} samples",
            expected=f"2 to {MAX_SAMPLES}, {MAX_SAMPLES * dt_s:.3g} s",
            remedy="ask for another length",
        )
    sample_covariance: dict[str, list[list[float]]] = {}
    names: list[str] = []
    means: list[float] = []
    blocks = []
    shared = []
    event_means = []
    rows = slice(first, last)
    for disk, traces in disks.items():
        result = compensated[disk]
        shared.append(shared_u_K(traces.lines))
        lag_rate = result.lag_sensitivity[rows].mean(axis=0)
        split = result.lag_split_K[rows].mean(axis=0)
        block = np.outer(lag_rate, lag_rate) * result.lag_covariance
        for i, name in enumerate(traces.columns):
            channel_covariance = window_covariance(
                traces.measured_degC[:, i], dt_s, traces.chains[i], result, i, first, last
            )
            event_shifts = np.array([shift[rows, i] for shift in result.shift_K]).reshape(
                -1, last - first
            )
            sample_covariance[name.removesuffix("_degC")] = (
                channel_covariance + event_shifts.T @ event_shifts
            ).tolist()
            event_means.append(event_shifts.mean(axis=1))
            noise_var = max(float(channel_covariance.mean()) - block[i, i] - split[i] ** 2, 0.0)
            line_var = max(float(np.mean(result.static_u[rows, i] ** 2)) - shared[-1][i] ** 2, 0.0)
            block[i, i] += noise_var + split[i] ** 2 + line_var
        names += [name.removesuffix("_degC") for name in traces.columns]
        means += result.temperature[rows].mean(axis=0).tolist()
        blocks.append(block)
    common = np.concatenate(shared)
    event_shift_K = np.array(event_means)  # channels, events
    covariance = block_diag(*blocks) + np.outer(common, common) + event_shift_K @ event_shift_K.T
    variance = np.diag(covariance)
    return {
        "log": log,
        "time_s": time[rows].tolist(),
        "covariance_K2": sample_covariance,
        "channels": names,
        "mean_degC": means,
        "mean_covariance_K2": covariance.tolist(),
        "difference_u_K": np.sqrt(
            np.maximum(variance[:, None] + variance - 2 * covariance, 0.0)
        ).tolist(),
    }
