"""Simulation of the logger (chain, static errors, noise, spikes, 16 bits) and of the oven.

``tcdyn.simulate.ehl``, ``tcdyn.simulate.plunge`` and ``tcdyn.simulate.campaign`` use it. The
response of a chain is computed by a matrix exponential here and by another method in
``tcdyn.chain``; ``tests/simulate/test_measure.py`` compares the two. Its other tests recover noise,
static lines, spikes and quantisation from the logs.
"""

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

RATE_Hz = 75.0  # sampling rate of the EHL and plunge logs [Hz]
OVERSAMPLING = 4  # samples of the true temperature for each logged one; chosen by judgement
RANGE_degC = (-100.0, 760.0)  # of a type-J module (assumed)
BITS = 16  # resolution of the logger (assumed)
SETPOINTS_degC = tuple(range(20, 161, 20))  # default setpoints of the oven [degC]


def chain_poles(tau1_s: float, tau2_s: float, conditioning: Conditioning) -> Array:
    """Return the poles of a measurement chain: two lags and the conditioning filter.

    The transfer function is that of the filter over (1 + tau1 s)(1 + tau2 s).

    Parameters
    ----------
    tau1_s, tau2_s
        Lags [s]; zero for none.
    conditioning
        The filter: Butterworth, or a cascade of equal lags.

    Returns
    -------
    array
        Poles (n,) [1/s], complex for a Butterworth filter.

    Raises
    ------
    InputError
        If the synthetic rig has no filter of that shape.

    Notes
    -----
    Another shape of filter needs a case here, and one in ``tcdyn.rig.disk.Conditioning``, which the
    estimators use. ``tests/simulate/test_measure.py`` compares the two.
    """
    poles = [-1 / tau for tau in (tau1_s, tau2_s) if tau > 0]
    cutoff_rad_s = 2 * np.pi * conditioning.cutoff_Hz
    match conditioning.shape:
        case "butterworth":
            poles += list(cutoff_rad_s * buttap(conditioning.poles)[1])
        case "cascade":
            poles += [-cutoff_rad_s] * conditioning.poles
        case shape:
            raise InputError(f"the synthetic rig has no filter of the shape {shape!r}")
    return np.array(poles)


def chain_responses(
    fine: Array, dt_s: float, every: int, chains: Sequence[tuple[float, float, Conditioning]]
) -> Array:
    """Return the responses of several chains, decimated to the logger's rate.

    The input is linear between fine samples, and the response is exact for that. Each chain starts
    at rest with its first sample.

    Parameters
    ----------
    fine
        Inputs (M, channels), sampled every ``dt_s``.
    dt_s
        Sampling interval of ``fine`` [s].
    every
        Number of fine samples for each returned one.
    chains
        (tau1, tau2, conditioning) of each channel [s].

    Returns
    -------
    array
        Responses (M/every rounded up, channels) [degC].
    """
    out = [
        _lag_response(u, dt_s, chain_poles(*chain))[::every]
        for u, chain in zip(fine.T, chains, strict=True)
    ]
    return np.stack(out, axis=1)


def _lag_response(u: Array, dt_s: float, poles: Array) -> Array:
    """Return the response of lags of unit gain in series to a sampled input.

    x_i' = p_i (x_i - x_{i-1}) with x_0 = u; the last x is returned. For x' = A x + B u, u' = du/dt,
    one matrix exponential of [x, u, du] gives the exact step of a linear input.

    Parameters
    ----------
    u
        Input (M,), linear between samples; at rest before the first one.
    dt_s
        Sampling interval [s].
    poles
        Poles (n,) [1/s]; complex ones in conjugate pairs.

    Returns
    -------
    array
        Output of the last lag (M,).
    """
    n = len(poles)
    generator = np.zeros((n + 2, n + 2), dtype=poles.dtype)
    generator[:n, :n] = (np.diag(poles) - np.diag(poles[1:], -1)) * dt_s
    generator[:1, n] = -poles[:1] * dt_s
    generator[n, n + 1] = 1.0
    step = expm(generator)
    states = [u]
    for i in range(n):
        drive = (step[i, n] - step[i, n + 1]) * u[:-1] + step[i, n + 1] * u[1:]
        for j in range(i):
            drive = drive + step[i, j] * states[j + 1][:-1]
        states.append(lfilter([1.0], [1.0, -step[i, i]], np.append(u[:1], drive)))
    return np.asarray(states[-1].real)


def sample_times(duration_s: float) -> Array:
    """Return the times (N,) [s] of a 75 Hz record from 0 to ``duration_s`` [s]."""
    return np.arange(int(np.floor(duration_s * RATE_Hz + 1e-6)) + 1) / RATE_Hz


def fine_times(n_samples: int) -> Array:
    """Return the times (M,) [s] of the oversampled record behind ``n_samples`` samples."""
    return np.arange((n_samples - 1) * OVERSAMPLING + 1) / (RATE_Hz * OVERSAMPLING)


def log_disk(
    truth_at: Callable[[Array], Array],
    duration_s: float,
    disk: DiskTruth,
    rng: np.random.Generator,
    imperfections: Imperfections,
    spikes: bool,
) -> tuple[Array, Array]:
    """Log all channels of a disk for ``duration_s`` at 75 Hz.

    Parameters
    ----------
    truth_at
        Function that returns the true temperatures (M, channels) [degC] at times (M,) [s]; channels
        in alphabetical order.
    duration_s
        Length of the record [s].
    disk
        True values of the disk; its channels are logged in alphabetical order.
    rng
        Random numbers of noise and spikes.
    imperfections
        Errors to simulate; without ``chain`` the true temperatures are logged directly.
    spikes
        Whether the signals pass slip rings (EHL tests).

    Returns
    -------
    logged, true
        Logged and true temperatures, both (N, channels).

    Notes
    -----
    The response starts at rest at the first sample, so the disk must be in a steady state there.
    """
    fine = truth_at(fine_times(len(sample_times(duration_s))))
    true = fine[::OVERSAMPLING]
    if not imperfections.chain:
        return add_logger_errors(true, disk, rng, imperfections, spikes), true
    chains = []
    for name in sorted(disk.channels):
        channel = disk.channels[name]
        chains.append((channel.tau1_s, channel.tau2_s, disk.setup.conditioning))
    output = chain_responses(fine, 1 / (RATE_Hz * OVERSAMPLING), OVERSAMPLING, chains)
    return add_logger_errors(output, disk, rng, imperfections, spikes), true


def add_logger_errors(
    outputs: Array,
    disk: DiskTruth,
    rng: np.random.Generator,
    imperfections: Imperfections,
    spikes: bool,
    averaged: int = 1,
) -> Array:
    """Add static errors, noise, spikes and quantisation to the chain outputs of one disk.

    Parameters
    ----------
    outputs
        Chain outputs (N, channels) [degC].
    disk
        True values of the disk.
    rng
        Random numbers of noise and spikes.
    imperfections
        Errors to simulate.
    spikes
        Whether the signals pass slip rings, which add spikes.
    averaged
        Number of readings in one row (oven rows are means); the noise falls with its square root.

    Returns
    -------
    array
        Logged temperatures (N, channels) [degC].

    Notes
    -----
    The order is static line, noise, spikes, quantisation: noise and spikes are those of the log. A
    mean of several readings is not quantised. Random numbers are drawn even where an error is
    switched off, so that the other errors stay the same. ``tests/simulate/test_measure.py`` checks
    each error.
    """
    out = outputs.copy()
    for k, name in enumerate(sorted(disk.channels)):
        channel = disk.channels[name]
        noise = rng.standard_normal(len(out)) * channel.noise_K / np.sqrt(averaged)
        bursts = spike_train(rng, len(out), channel.spikes_per_s) if spikes else 0.0
        if imperfections.static:
            out[:, k] = (out[:, k] - channel.offset_degC) / channel.gain
        if imperfections.noise:
            out[:, k] += noise
        if imperfections.spikes:
            out[:, k] += bursts
    if imperfections.quantise and averaged == 1:
        return quantise(out)
    return out


def spike_train(rng: np.random.Generator, count: int, per_s: float) -> Array:
    """Return slip-ring spikes (count,) [K].

    They are Poisson in time, one to three samples long, 1.5 K and more, of either sign.

    Parameters
    ----------
    rng
        Random numbers.
    count
        Number of samples.
    per_s
        Mean number of spikes per second.

    Returns
    -------
    array
        Spikes (count,) [K], zero between them.

    Notes
    -----
    Length, least height (1.5 K) and the exponential tail (4 K) are chosen by judgement. They
    test the outlier limits in ``tcdyn.estimation.trace_noise``: lower spikes are harder to find.
    ``tests/simulate/test_measure.py`` checks that spikes are rare, short and high.
    """
    out = np.zeros(count)
    n_spikes = rng.poisson(per_s * count / RATE_Hz)
    starts = rng.integers(0, max(count, 1), n_spikes)
    lengths = rng.integers(1, 4, n_spikes)
    signs = rng.choice([-1.0, 1.0], n_spikes)
    heights = signs * (1.5 + rng.exponential(4.0, n_spikes))
    for start, length, height in zip(starts, lengths, heights):
        out[start : start + length] += height
    return out


def quantise(values: Array, low: float = RANGE_degC[0], high: float = RANGE_degC[1]) -> Array:
    """Round to the levels of the 16-bit converter, and clip to its range.

    Parameters
    ----------
    values
        Values of any shape, in any unit.
    low, high
        Ends of the range, in that unit.

    Returns
    -------
    array
        Values of the same shape, multiples of (high - low)/(2^16 - 1) above ``low``.
    """
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
    """Simulate the oven calibration of one disk.

    The disk is held at each setpoint, in ``repeats`` runs, with one row for each steady minute. The
    rows of the channels are means of one second.

    Parameters
    ----------
    disk
        "fast" or "slow".
    seed
        Seed; the draws depend on it and on the disk.
    truth
        True values of the rig; None draws them from the seed.
    setpoints_degC
        Setpoints of the oven [degC].
    repeats
        Number of runs over all setpoints.
    minutes
        Number of rows at each setpoint, one for each minute.
    prt_limit_K
        Largest error of the platinum thermometer [K]; it is uniform and constant within a hold.

    Returns
    -------
    frame
        The log: canonical oven columns.
    truth
        Gain and offset_degC of each channel with T = gain * logged + offset, ``prt_error_K`` of
        each hold, and ``"traces"``, the true temperature of each row.

    Notes
    -----
    A hold differs from its setpoint by 0.5 K (standard deviation), drifts by 0.03 K from minute to
    minute, and the thermometer has 5 mK of noise. These numbers are chosen by judgement. The
    columns are those that ``calibration`` reads; ``tests/simulate/test_plunge.py`` recovers the
    static lines from them.
    """
    rig = truth or draw_truth(seed)
    errors = rig.imperfections
    disk_truth = rig.disk(disk)
    rng = rng_for(seed, "oven", disk)
    rows = []
    prt_errors = []
    for repeat in range(1, repeats + 1):
        for setpoint in setpoints_degC:
            level = setpoint + rng.normal(0, 0.5)
            prt_error = float(rng.uniform(-prt_limit_K, prt_limit_K)) if errors.static else 0.0
            prt_errors.append(prt_error)
            drift = np.zeros(minutes)
            if errors.drift:
                drift = 0.03 * np.cumsum(rng.standard_normal(minutes))
            for minute in range(minutes):
                true = level + drift[minute]
                prt = true + prt_error + 0.005 * rng.standard_normal() * errors.noise
                rows.append((repeat, float(setpoint), prt, true))
    table = np.array(rows)
    names = sorted(disk_truth.channels)
    true_channels = np.repeat(table[:, 3:], len(names), axis=1)
    readings = add_logger_errors(true_channels, disk_truth, rng, errors, spikes=False, averaged=75)
    frame = pd.DataFrame(table[:, :3], columns=["repeat", "setpoint_degC", "prt_degC"])
    frame["repeat"] = frame["repeat"].astype(int)
    gain = {}
    offset_degC = {}
    for k, name in enumerate(names):
        channel = disk_truth.channels[name]
        frame[f"{name}_degC"] = readings[:, k]
        gain[name] = channel.gain if errors.static else 1.0
        offset_degC[name] = channel.offset_degC if errors.static else 0.0
    traces = pd.DataFrame({"repeat": frame["repeat"], "true_degC": table[:, 3]})
    truth_out = {
        "disk": disk,
        "gain": gain,
        "offset_degC": offset_degC,
        "prt_error_K": prt_errors,
        "traces": traces,
    }
    return frame, truth_out
