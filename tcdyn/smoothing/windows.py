"""Means of a compensated log over a record of time, with the covariance between all channels of both disks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.check_clock import interval_s
from tcdyn.rig.static_line import shared_u_K
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import window_covariance
from tcdyn.smoothing.traces import DiskTraces

LONGEST_COVARIANCE = 600  # samples: a matrix of 360 000 numbers for each channel


def over_window(
    log: str,
    time: Array,
    events: tuple[float, ...],
    disks: Mapping[str, DiskTraces],
    compensated: Mapping[str, Compensated],
    length_s: float,
    start_s: float | None = None,
) -> dict[str, Any]:
    """Covariance between samples, and means with that between channels, over ``length_s`` [s], as plain lists.

    ``start_s``: on the clock of ``time_s``; the last event, an unloading say, when left out. ``covariance_K2``: by
    channel, (n, n) for the samples at ``time_s`` (n,); noise, regularisation, lag and the instants of events are in it;
    the static line's uncertainty, one error for all samples, is not. ``mean_degC`` (M,) of
    ``channels`` (M,), ``mean_covariance_K2`` (M, M): noise of each channel, lags (of a disk move together), static
    lines, the reference that lines have in common, and the instants of events, common to both disks. u of the
    difference of two means is sqrt(C_ii + C_jj - 2 C_ij), in ``difference_u_K`` (M, M).
    Raises InputError where nothing was smoothed, there is no event to begin at, or the record is too long.
    """
    if start_s is None and not events:
        raise InputError(
            "the covariance begins at the last event, and there is none",
            where=log,
            remedy="say from when on: {start_s}",
            parameters={"start_s": None},
        )
    dt_s = interval_s(time)
    begin = events[-1] if start_s is None else start_s - time[0]
    first = max(int(np.ceil(begin / dt_s - 1e-6)), 0)
    last = min(first + round(length_s / dt_s), len(time))
    if not 1 < last - first <= LONGEST_COVARIANCE:
        raise InputError(
            f"a covariance over {last - first} samples",
            expected=f"2 to {LONGEST_COVARIANCE}, {LONGEST_COVARIANCE * dt_s:.3g} s",
            remedy="ask for another length",
        )
    between: dict[str, list[list[float]]] = {}
    names = list[str]()
    means = list[float]()
    blocks = []
    shared = []
    by_event = []
    rows = slice(first, last)
    for disk, traces in disks.items():
        found = compensated[disk]
        shared.append(shared_u_K(traces.lines))
        rate = found.lag_sensitivity[rows].mean(axis=0)
        divided = found.split_K[rows].mean(axis=0)
        block = np.outer(rate, rate) * found.lag_covariance
        for i, name in enumerate(traces.columns):
            own = window_covariance(
                traces.measured_degC[:, i], dt_s, traces.chains[i], found, i, first, last
            )
            instants = np.array([moved[rows, i] for moved in found.by_event_K]).reshape(
                -1, last - first
            )
            between[name.removesuffix("_degC")] = (own + instants.T @ instants).tolist()
            by_event.append(instants.mean(axis=1))
            noise = max(float(own.mean()) - block[i, i] - divided[i] ** 2, 0.0)
            line = max(float(np.mean(found.static_u[rows, i] ** 2)) - shared[-1][i] ** 2, 0.0)
            block[i, i] += noise + divided[i] ** 2 + line
        names += [name.removesuffix("_degC") for name in traces.columns]
        means += found.temperature[rows].mean(axis=0).tolist()
        blocks.append(block)
    common = np.concatenate(shared)
    moved_K = np.array(by_event)  # channels, events
    whole = block_diag(*blocks) + np.outer(common, common) + moved_K @ moved_K.T
    variance = np.diag(whole)
    return {
        "log": log,
        "time_s": time[rows].tolist(),
        "covariance_K2": between,
        "channels": names,
        "mean_degC": means,
        "mean_covariance_K2": whole.tolist(),
        "difference_u_K": np.sqrt(
            np.maximum(variance[:, None] + variance - 2 * whole, 0.0)
        ).tolist(),
    }
