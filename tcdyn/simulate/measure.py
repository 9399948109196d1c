"""From true junction temperatures to what the logger writes: chain, static errors, noise, spikes, 16 bits; the oven."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import expm
from scipy.signal import buttap, lfilter

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.simulate.truth import DiskTruth, Imperfections, RigTruth, draw_truth, rng_for

RATE_Hz = 75.0
OVERSAMPLING = 4
RANGE_degC = (-100.0, 760.0)  # of a type-J module (assumed)
BITS = 16
SETPOINTS_degC = tuple(range(20, 161, 20))


def chain_poles(tau1_s: float, tau2_s: float, conditioning: Conditioning) -> Array:
    """Poles (n,) [1/s] of 1 / ((1 + tau1 s)(1 + tau2 s)) times the conditioning filter; complex where that is so."""
    poles = [-1 / tau for tau in (tau1_s, tau2_s) if tau > 0]
    cut = 2 * np.pi * conditioning.cutoff_Hz
    match conditioning.shape:
        case "butterworth":
            poles += list(cut * buttap(conditioning.poles)[1])
        case "cascade":
            poles += [-cut] * conditioning.poles
        case other:
            raise InputError(f"the synthetic rig has no filter of the shape {other!r}")
    return np.array(poles)


def through_chains(
    fine: Array, dt_s: float, every: int, chains: Sequence[tuple[float, float, Conditioning]]
) -> Array:
    """What the chains make of ``fine`` (M, channels), sampled every ``dt_s``; each ``every``-th sample comes back.

    The input is a straight line between fine samples and the answer is exact for that; each chain starts at rest
    with its first sample. ``chains`` holds (tau1, tau2, conditioning) per channel.
    """
    out = [
        _through(u, dt_s, chain_poles(*chain))[::every]
        for u, chain in zip(fine.T, chains, strict=True)
    ]
    return np.stack(out, axis=1)


def _through(u: Array, dt_s: float, poles: Array) -> Array:
    """``u`` (M,) through lags of unit gain, one after the other: x_i' = p_i (x_i - x_{i-1}), x_0 = u. The last one."""
    n = len(poles)
    # [x, u, du] under x' = A x + B u, u' = du/dt: one exponential gives the exact straight-line step
    big = np.zeros((n + 2, n + 2), dtype=poles.dtype)
    big[:n, :n] = (np.diag(poles) - np.diag(poles[1:], -1)) * dt_s
    big[:1, n] = -poles[:1] * dt_s
    big[n, n + 1] = 1.0
    step = expm(big)
    states = [u]
    for i in range(n):
        drive = (step[i, n] - step[i, n + 1]) * u[:-1] + step[i, n + 1] * u[1:]
        for j in range(i):
            drive = drive + step[i, j] * states[j + 1][:-1]
        states.append(lfilter([1.0], [1.0, -step[i, i]], np.append(u[:1], drive)))
    return np.asarray(states[-1].real)


def sample_times(duration_s: float) -> Array:
    """Times of a 75 Hz record of ``duration_s`` [s], from 0."""
    return np.arange(int(np.floor(duration_s * RATE_Hz + 1e-6)) + 1) / RATE_Hz


def log_disk(
    truth_at: Callable[[Array], Array],
    duration_s: float,
    disk: DiskTruth,
    rng: np.random.Generator,
    how: Imperfections,
    spikes: bool,
) -> tuple[Array, Array]:
    """Log all channels of a disk for ``duration_s`` at 75 Hz.

    ``truth_at`` maps times (M,) to the true temperatures (M, channels). Returns what is logged and
    what was true, both (N, channels).
    ``spikes``: whether the signals pass slip rings (EHL tests).
    """
    names = sorted(disk.channels)
    times = sample_times(duration_s)
    fine_t = np.arange((len(times) - 1) * OVERSAMPLING + 1) / (RATE_Hz * OVERSAMPLING)
    fine = truth_at(fine_t)
    true = fine[::OVERSAMPLING]
    read = true
    if how.chain:
        chains = [
            (disk.channels[c].tau1_s, disk.channels[c].tau2_s, disk.setup.conditioning)
            for c in names
        ]
        read = through_chains(fine, 1 / (RATE_Hz * OVERSAMPLING), OVERSAMPLING, chains)
    return logged(read, disk, rng, how, spikes), true


def logged(
    read: Array,
    disk: DiskTruth,
    rng: np.random.Generator,
    how: Imperfections,
    spikes: bool,
    averaged: int = 1,
) -> Array:
    """Static errors, noise, spikes and quantisation upon chain outputs (N, channels) of one disk.

    ``averaged``: how many readings went into one row (oven rows are means); noise falls with its root.
    """
    out = read.copy()
    for k, name in enumerate(sorted(disk.channels)):
        channel = disk.channels[name]
        noise = rng.standard_normal(len(out)) * channel.noise_K / np.sqrt(averaged)
        bursts = spike_train(rng, len(out), channel.spikes_per_s) if spikes else 0.0
        if how.static:
            out[:, k] = (out[:, k] - channel.offset_degC) / channel.gain
        if how.noise:
            out[:, k] += noise
        if how.spikes:
            out[:, k] += bursts
    return quantised(out) if how.quantise and averaged == 1 else out


def spike_train(rng: np.random.Generator, count: int, per_s: float) -> Array:
    """Slip-ring spikes [K]: Poisson in time, one to three samples long, 1.5 K and more, of either sign."""
    out = np.zeros(count)
    number = rng.poisson(per_s * count / RATE_Hz)
    starts = rng.integers(0, max(count, 1), number)
    lengths = rng.integers(1, 4, number)
    heights = rng.choice([-1.0, 1.0], number) * (1.5 + rng.exponential(4.0, number))
    for start, length, height in zip(starts, lengths, heights):
        out[start : start + length] += height
    return out


def quantised(values: Array, low: float = RANGE_degC[0], high: float = RANGE_degC[1]) -> Array:
    """Round to the nearest of 2^16 levels between ``low`` and ``high`` and clip to them."""
    step = (high - low) / (2**BITS - 1)
    return np.asarray(low + step * np.round((np.clip(values, low, high) - low) / step))


def simulate_oven(
    disk: str = "fast",
    seed: int = 0,
    truth: RigTruth | None = None,
    setpoints_degC: Sequence[float] = SETPOINTS_degC,
    repeats: int = 3,
    minutes: int = 6,
    prt_limit_K: float = 0.1,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Hold one disk at each setpoint, in ``repeats`` runs, and write a row for each steady minute.

    The PRT is wrong by up to ``prt_limit_K`` at each hold (uniform, the same for the minutes of that hold); the
    channels' rows are means of one second. Returns the log (canonical oven columns) and its truth: gain,
    offset_degC per channel with T = gain * logged + offset, ``prt_error_K`` per hold and ``"traces"``, the true
    temperature of each row.
    """
    rig = truth or draw_truth(seed)
    how = rig.imperfections
    own = rig.disk(disk)
    rng = rng_for(seed, "oven", disk)
    rows = []
    errors = []
    for repeat in range(1, repeats + 1):
        for setpoint in setpoints_degC:
            level = setpoint + rng.normal(0, 0.5)
            error = float(rng.uniform(-prt_limit_K, prt_limit_K)) if how.static else 0.0
            errors.append(error)
            wander = (
                0.03 * np.cumsum(rng.standard_normal(minutes)) if how.drift else np.zeros(minutes)
            )
            for minute in range(minutes):
                true = level + wander[minute]
                rows.append(
                    (
                        repeat,
                        float(setpoint),
                        true + error + 0.005 * rng.standard_normal() * how.noise,
                        true,
                    )
                )
    table = np.array(rows)
    names = sorted(own.channels)
    read = logged(
        np.repeat(table[:, 3:], len(names), axis=1), own, rng, how, spikes=False, averaged=75
    )
    frame = pd.DataFrame(table[:, :3], columns=["repeat", "setpoint_degC", "prt_degC"])
    frame["repeat"] = frame["repeat"].astype(int)
    for k, channel in enumerate(names):
        frame[f"{channel}_degC"] = read[:, k]
    truth_out = {
        "disk": disk,
        "gain": {c: own.channels[c].gain if how.static else 1.0 for c in names},
        "offset_degC": {c: own.channels[c].offset_degC if how.static else 0.0 for c in names},
        "prt_error_K": errors,
        "traces": pd.DataFrame({"repeat": frame["repeat"], "true_degC": table[:, 3]}),
    }
    return frame, truth_out
