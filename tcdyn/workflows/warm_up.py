"""Warm-up of the live compensation: sample interval, noise and initial level of each channel.

Used by :mod:`tcdyn.workflows.follow`. The noise model is that of :mod:`tcdyn.chain.logger_noise`.
Limits without a source were chosen by judgement. Guarded by ``tests/smoothing/test_follow.py`` and
``tests/smoothing/test_follow_invalid.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tcdyn.chain.logger_noise import estimate_logger_noise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation.trace_noise import SPIKES, find_spikes, trace_noise_sd
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.plausible import out_of_range
from tcdyn.rig.static_line import apply_static
from tcdyn.smoothing.traces import DiskChannels
from tcdyn.workflows.live import LiveCompensator, LiveCompensatorState, LiveSettings
from tcdyn.workflows.reachable import Reach, noise_bound_K

# fewest steps of the clock, and fewest valid readings of a channel
MIN_SAMPLES = 16
# smallest noise [K], for a channel whose readings do not scatter
MIN_NOISE_K = 1e-3
# readings whose median is the first level: a single one may be a spike
N_LEVEL_SAMPLES = 5
# smallest noise after the filter, as a share of that before it: samples do not show less
MIN_NOISE_RATIO = 0.03


def warm_up(
    names: Sequence[str],
    rows: Array,
    channels: Sequence[DiskChannels],
    level_K2_s3: float | None,
    settings: LiveSettings,
) -> tuple[LiveCompensator, LiveCompensatorState]:
    """Compensator and its first state from the first seconds of a log.

    Parameters
    ----------
    names
        Names of the columns.
    rows
        The first rows (n, columns).
    channels
        Thermocouples of each disk.
    level_K2_s3
        Process-noise intensity for a log of this kind [K2/s3]; None where it is unknown.
    settings
        Settings of the live compensation.

    Returns
    -------
    compensator
        The compensator.
    state
        Its first state.

    Raises
    ------
    InputError
        If there are fewer than ``MIN_SAMPLES`` steps, or no channel shows a temperature.

    Notes
    -----
    Rows are put on even times first. Readings that cannot be temperatures are left out, see
    ``tcdyn.workflows.reachable.Reach.rejected_at_start``. The first level is the median of
    ``N_LEVEL_SAMPLES`` readings.
    """
    time = rows[:, list(names).index("time_s")]
    steps = np.diff(time[np.isfinite(time)])
    steps = steps[steps > 0]
    if len(steps) < MIN_SAMPLES:
        raise InputError(
            f"{len(steps) + 1} samples in the first {settings.learn_s:g} s",
            expected=f"at least {MIN_SAMPLES + 1}",
            remedy="raise {learn_s}",
            parameters={"learn_s": None},
        )
    dt = float(np.median(steps))
    positions = np.round((time - np.nanmin(time)) / dt)
    regular_rows = np.full((int(np.nanmax(positions)) + 1, rows.shape[1]), np.nan)
    regular_rows[positions[np.isfinite(positions)].astype(int)] = rows[np.isfinite(positions)]
    alive = {}
    dead = []
    screened: set[str] = set()
    for disk in channels:
        lag_u_s = np.sqrt(np.maximum(np.diag(disk.lag_covariance_s2), 0.0))
        for i, (name, line, chain) in enumerate(zip(disk.columns, disk.lines, disk.chains)):
            logged = regular_rows[:, list(names).index(name)]
            y = apply_static(np.where(out_of_range(logged), np.nan, logged), line)
            noise_K = np.array([settings.noise_K or noise_bound_K(y)])
            reach = Reach.create(
                [chain], lag_u_s[i : i + 1], disk.split_u_s[i : i + 1], noise_K, dt
            )
            rejected = reach.rejected_at_start(0, y)
            y = np.where(rejected, np.nan, y)
            if rejected.any():
                screened.add(name)
            if np.count_nonzero(np.isfinite(y)) < MIN_SAMPLES:
                dead.append(name)
            else:
                alive[name] = y, chain.conditioning
    if not alive:
        raise InputError("no channel shows a temperature", remedy="check the log's columns")
    statistics = {"dt_s": dt, "dead": dead} | _noise(alive, screened, dt, settings.noise_K)
    plan = LiveCompensator.create(names, channels, level_K2_s3, settings, statistics)
    first = np.array([np.median(y[np.isfinite(y)][:N_LEVEL_SAMPLES]) for y, _ in alive.values()])
    count = min(int(np.count_nonzero(np.isfinite(y))) for y, _ in alive.values())
    return plan, plan.start(first, count)


def _noise(
    traces: Mapping[str, tuple[Array, Conditioning]],
    screened: Collection[str],
    dt_s: float,
    given_K: float | None,
) -> dict[str, Any]:
    """Noise of each trace behind and before its filter.

    Parameters
    ----------
    traces
        Trace (N,) [degC] and conditioning filter by name.
    screened
        Names of traces with invalid readings. So many may be missing that only the remaining ones,
        one after the other, show the noise.
    dt_s
        Sampling interval [s].
    given_K
        Standard deviation of the noise of all traces [K]; None to estimate it.

    Returns
    -------
    dict
        ``noise_K``: white noise after the filter [K] by name; ``before_K``: white noise before it.

    Notes
    -----
    Where the noise is coloured by another shape than that of the filter, it is taken as white noise
    of the same level at low frequency, because the states of the live smoother are those of the
    filter.
    """
    valid = {name: y[np.isfinite(y)] if name in screened else y for name, (y, _) in traces.items()}
    after = {name: given_K or max(trace_noise_sd(y), MIN_NOISE_K) for name, y in valid.items()}
    before = dict.fromkeys(traces, 0.0)
    for filter_ in {f for _, f in traces.values()} if given_K is None else set():
        names = [name for name, (_, f) in traces.items() if f == filter_]
        white = np.array([after[n] for n in names])
        spiky = [find_spikes(traces[n][0], SPIKES["compensator"], after[n]) for n in names]
        clean = np.stack(
            [np.where(bad, np.nan, traces[n][0]) for n, bad in zip(names, spiky)], axis=1
        )
        logger_noise = estimate_logger_noise([clean], dt_s, filter_, white)
        if (
            logger_noise.coloured and logger_noise.shaping != filter_
        ):  # the smoother's states are the filter's: as strong at low frequency
            after |= dict(zip(names, logger_noise.level_K.tolist()))
        elif logger_noise.coloured:
            before |= dict(zip(names, logger_noise.before_filter_K.tolist()))
            least = np.maximum(MIN_NOISE_K, MIN_NOISE_RATIO * logger_noise.before_filter_K)
            after |= dict(zip(names, np.maximum(logger_noise.after_filter_K, least).tolist()))
    return {"noise_K": after, "before_K": before}
