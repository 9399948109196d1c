"""What a compensator is given: traces whose bad samples are known, their noise and chains, the times of events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration import Array, Flags
from calibration.errors import InputError
from calibration.finding import Finding, look
from calibration.noise import SPIKES, find_spikes, white_noise_sd
from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.traces import bridged

GOOD, MISSING, SPIKE, STUCK, SATURATED = 0, 1, 2, 4, 8  # bits of ``flags``
COARSE = 0.5  # share of repeats in short runs: beyond it the logger's step hides the noise
LEAST_GOOD = 8  # samples


@dataclass(frozen=True)
class Stretch:
    """Samples ``y (N, M)`` (finite; weight 0 where bad) every ``dt_s``, their chains and the times of events [s].

    ``noise_sd (M,)`` [K]; ``flags (N, M)``: bits MISSING, SPIKE, STUCK, SATURATED; ``findings``: channels that suffer.
    """

    y: Array
    weight: Array
    dt_s: float
    chains: tuple[Chain, ...]
    sensors: tuple[Sensor, ...]
    events_s: tuple[float, ...]
    noise_sd: Array
    flags: NDArray[np.uint8]
    findings: tuple[Finding, ...] = ()


def stretch_of(
    y: ArrayLike,
    dt_s: float,
    chains: Chain | Sequence[Chain],
    events_s: Sequence[float] = (),
    noise_sd: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> Stretch:
    """The record ``y``, (N,) or (N, M), as a stretch whose bad samples carry no weight; arguments as of ``smooth``.

    Raises InputError for shapes that do not agree, for a channel that mostly repeats one value, or hardly measures.
    """
    data = np.asarray(y, dtype=float)
    data = data[:, None] if data.ndim == 1 else data
    n, m = data.shape
    listed = [chains] * m if isinstance(chains, Chain) else list(chains)
    if len(listed) != m:
        raise InputError(f"smooth: {m} channels but {len(listed)} chains", expected="one chain, or one per channel")
    if n < LEAST_GOOD or not dt_s > 0:
        raise InputError(
            f"smooth: {n} samples every {dt_s:g} s", expected=f"at least {LEAST_GOOD} samples and a positive interval"
        )
    called = [f"channel {c + 1}" for c in range(m)] if names is None else list(names)
    if len(called) != m:
        raise InputError(f"smooth: {m} channels but {len(called)} names", expected="one name per channel")
    noise: Array = np.full(m, [trace_noise_sd(x) for x in data.T] if noise_sd is None else noise_sd, dtype=float)
    flags, found = np.zeros(data.shape, dtype=np.uint8), []
    for c, (x, name) in enumerate(zip(data.T, called)):
        flags[:, c] = _flags(x, noise[c])
        still, bad = flags[:, c] & (STUCK | SATURATED) != 0, flags[:, c] != 0
        if np.mean(still) > 0.5:
            raise InputError(
                f"{name}: {100 * np.mean(still):.0f} % of the samples repeat one value",
                expected="a trace with noise on it",
                remedy="check the wiring and the range of this channel, or leave it out",
            )
        if still.any():
            percent, first = 100 * float(np.mean(still)), int(np.argmax(still))
            found.append(look("trace.stuck", subject=name, percent=percent, first_sample=first))
        elif np.mean(bad) > 0.01:
            found.append(look("trace.bad", subject=name, percent=100 * float(np.mean(bad))))
    good = flags == GOOD
    if (few := good.sum(axis=0) < LEAST_GOOD).any():
        name = called[int(np.argmax(few))]
        raise InputError(f"smooth: {name} has fewer than {LEAST_GOOD} good samples", remedy="leave this channel out")
    filled = np.stack([bridged(data[:, c], good[:, c]) for c in range(m)], axis=1)
    events = tuple(sorted({float(e) for e in events_s if 0 < e < (n - 1) * dt_s}))
    return Stretch(
        filled, good.astype(float), dt_s, tuple(listed), tuple(sensors(listed)), events, noise, flags, tuple(found)
    )


def trace_noise_sd(y: Array, fallback: float = 1e-6) -> float:
    """Standard deviation [same unit] of white noise on a smooth trace ``y (N,)``, NaN for missing.

    sd = 1.4826 median |fourth difference| / sqrt(70); a signal slower than a tenth of the sampling rate leaves less
    than 2 % of its amplitude. A trace that rests on one step of its logger gets a quarter of that step.
    """
    if np.count_nonzero(np.isfinite(np.diff(y, n=4))) < 8:
        return fallback
    sd = float(white_noise_sd(y, 4, centred=False))
    if sd > 0:
        return sd
    steps = np.abs(np.diff(y[np.isfinite(y)]))
    steps = steps[steps > 0]
    return float(np.min(steps)) / 4 if len(steps) else fallback


def _flags(y: Array, noise_sd: float) -> NDArray[np.uint8]:
    """Bits MISSING, SPIKE, STUCK, SATURATED for each sample of ``y (N,)``.

    Stuck and saturated are runs of one value longer than chance repeats of this record's resolution.
    """
    flags = np.where(np.isfinite(y), GOOD, MISSING).astype(np.uint8)
    index = np.flatnonzero(flags == GOOD)
    if len(index) >= SPIKES["compensator"].width:
        trace = y[index]
        runs, stop = _long_runs(trace), (trace == trace.max()) | (trace == trace.min())
        flags[index] = np.where(runs, np.where(stop, SATURATED, STUCK), GOOD)
        flags[index[find_spikes(trace, SPIKES["compensator"], noise_sd)]] |= SPIKE
    return flags


def _long_runs(trace: Array) -> Flags:
    """Where one value repeats for longer than chance allows: p^length N < 0.001, p the share of repeats elsewhere.

    Where most neighbours are equal anyway, the logger's step is coarser than the noise, and a long rest on one step
    says nothing: no run is called long.
    """
    n = len(trace)
    change = np.flatnonzero(np.diff(trace)) + 1
    if len(change) == 0:
        return np.ones(n, dtype=bool)
    lengths = np.diff(np.concatenate([[0], change, [n]]))
    usual = lengths <= np.quantile(lengths, 0.99)
    repeats = float(np.sum(lengths[usual] - 1)) / max(float(np.sum(lengths[usual])), 1.0)
    if repeats > COARSE:
        return np.zeros(n, dtype=bool)
    longest = 8 + np.log(1000.0 * n) / -np.log(np.clip(repeats, 0.05, 0.98))
    return np.repeat(lengths > longest, lengths)
