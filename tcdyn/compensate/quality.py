"""Samples that are no measurement: missing, spikes, a channel that is stuck or against its stop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.finding import Finding, look
from tcdyn.compensate.result import MISSING, SATURATED, SPIKE, STUCK

SPIKE_SD = 6.0  # one sample in 5e8 of normal noise
COARSE = 0.5  # share of repeats in short runs: beyond it the logger's step hides the noise
NEIGHBOURS = 9  # a spike of up to four samples stands out of the median of nine


def flags_of(y: Array, noise_sd: Array) -> NDArray[np.uint8]:
    """Bits MISSING, SPIKE, STUCK, SATURATED for each sample of ``y (N, M)`` with noise ``noise_sd (M,)`` [K].

    A spike lies more than six standard deviations (of noise and of the local wiggle) from the median of its nine
    neighbours. Stuck and saturated are runs of one value longer than chance repeats of this record's resolution.
    """
    flags = np.zeros(y.shape, dtype=np.uint8)
    for c in range(y.shape[1]):
        bad = ~np.isfinite(y[:, c])
        flags[bad, c] |= MISSING
        good = np.flatnonzero(~bad)
        if len(good) < NEIGHBOURS:
            continue
        trace = y[good, c]
        runs = _long_runs(trace)
        stop = (trace == trace.max()) | (trace == trace.min())
        flags[good[runs & stop], c] |= SATURATED
        flags[good[runs & ~stop], c] |= STUCK
        away = np.abs(trace - median_filter(trace, NEIGHBOURS, mode="nearest"))
        wiggle = 1.4826 * median_filter(away, 8 * NEIGHBOURS + 1, mode="nearest")
        flags[good[away > SPIKE_SD * np.maximum(noise_sd[c], wiggle)], c] |= SPIKE
    return flags


def _long_runs(trace: Array) -> NDArray[np.bool_]:
    """Where one value repeats for longer than chance allows: p^length N < 0.001, p the share of repeats elsewhere.

    Where most neighbours are equal anyway, the logger's step is coarser than the noise, and a long rest on one step
    says nothing: no run is called long.
    """
    n = len(trace)
    change = np.flatnonzero(np.diff(trace)) + 1
    if len(change) == 0:
        return np.ones(n, dtype=bool)
    starts, ends = np.concatenate([[0], change]), np.concatenate([change, [n]])
    lengths = ends - starts
    usual = lengths <= np.quantile(lengths, 0.99)
    repeats = float(np.sum(lengths[usual] - 1)) / max(float(np.sum(lengths[usual])), 1.0)
    if repeats > COARSE:
        return np.zeros(n, dtype=bool)
    longest = 8 + np.log(1000.0 * n) / -np.log(np.clip(repeats, 0.05, 0.98))
    long = lengths > longest
    return np.repeat(long, lengths)


def spoken(names: Sequence[str] | None, channels: int) -> list[str]:
    """What each channel is called in sentences; without names ``channel 1`` is the first column.

    >>> spoken(None, 2), spoken(["fast_e", "fast_f"], 2)
    (['channel 1', 'channel 2'], ['fast_e', 'fast_f'])
    """
    if names is None:
        return [f"channel {c + 1}" for c in range(channels)]
    if len(names) != channels:
        raise InputError(f"smooth: {channels} channels but {len(names)} names", expected="one name per channel")
    return list(names)


def judged(flags: NDArray[np.uint8], names: Sequence[str] | None = None) -> tuple[Finding, ...]:
    """Channels of ``flags (N, M)`` that suffer; InputError when a channel is mostly not measuring.

    ``names`` (M,): what the sentences call the channels; ``channel 1`` and so on when left out.
    """
    found = []
    for c, name in enumerate(spoken(names, flags.shape[1])):
        still = flags[:, c] & (STUCK | SATURATED) != 0
        stuck, bad = 100 * float(np.mean(still)), 100 * float(np.mean(flags[:, c] != 0))
        if stuck > 50:
            raise InputError(
                f"{name}: {stuck:.0f} % of the samples repeat one value",
                expected="a trace with noise on it",
                remedy="check the wiring and the range of this channel, or leave it out",
            )
        if stuck > 0:
            found.append(look("trace.stuck", subject=name, percent=stuck, first_sample=int(np.argmax(still))))
        elif bad > 1:
            found.append(look("trace.bad", subject=name, percent=bad))
    return tuple(found)
