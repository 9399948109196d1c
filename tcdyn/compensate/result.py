"""What a compensator asks of its samples, and returns: temperature, a standard deviation made of named parts, flags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from calibration import Array
from calibration.errors import InputError
from calibration.estimate import with_u
from calibration.finding import Finding, look, sentences
from calibration.noise import SPIKES, find_spikes, white_noise_sd
from calibration.result import Result, jsonable
from tcdyn.compensate.grid import Intensity

GOOD, MISSING, SPIKE, STUCK, SATURATED = 0, 1, 2, 4, 8  # bits of ``flags``
COARSE = 0.5  # share of repeats in short runs: beyond it the logger's step hides the noise


@dataclass(frozen=True)
class Compensated(Result):
    """A compensated record; all arrays (N, M), one column a channel.

    ``temperature`` [degC] at the junction at ``time_s``; ``sd`` [K] its standard deviation, from ``sd_noise`` (noise
    and regularisation), ``lag_sensitivity`` [K/s] times the uncertainty of each lag, and ``static_u`` [K].
    ``slope`` [K/s]; ``noise_sd (M,)`` [K]; ``intensity (M,)`` [K2/s3], the median over the record; ``flags``: bits
    MISSING, SPIKE, STUCK, SATURATED; ``method`` in words; ``events_s``: pairs of time and its standard uncertainty [s];
    ``intensities``: as functions of time, one a channel (smoother only).
    """

    temperature: Array
    sd: Array
    sd_noise: Array
    slope: Array
    lag_sensitivity: Array
    static_u: Array
    lag_covariance: Array
    noise_sd: Array
    intensity: Array
    flags: NDArray[np.uint8]
    time_s: Array
    method: str
    findings: tuple[Finding, ...] = ()
    events_s: tuple[tuple[float, float], ...] = ()
    intensities: tuple[Intensity, ...] = ()

    @classmethod
    def of(
        cls,
        temperature: Array,
        sd_noise: Array,
        slope: Array,
        lag_sensitivity: Array,
        lag_covariance: ArrayLike | None,
        static_u: ArrayLike | None,
        dt_s: float,
        **rest: Any,
    ) -> Compensated:
        """With the whole standard deviation, sd^2 = sd_noise^2 + (lag_sensitivity u(lag))^2 + static_u^2.

        ``lag_covariance`` (M, M) and ``static_u`` (a number, (M,) or (N, M)) are zero when left out; ``rest``: the
        fields that are left.
        """
        n, m = temperature.shape
        lags: Array = np.zeros((m, m)) if lag_covariance is None else np.asarray(lag_covariance, dtype=np.float64)
        line = np.broadcast_to(np.asarray(0.0 if static_u is None else static_u, dtype=np.float64), (n, m))
        total = np.asarray(np.sqrt(sd_noise**2 + lag_sensitivity**2 * np.diag(lags) + line**2), dtype=np.float64)
        time = np.asarray(np.arange(n) * dt_s, dtype=np.float64)
        return cls(temperature, total, sd_noise, slope, lag_sensitivity, line, lags, time_s=time, **rest)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed, in words."""
        return sentences(self.findings)

    def common_sd(self) -> Array:
        """Part of ``sd`` (N, M) that comes from the lag common to all channels, hence moves them together [K]."""
        m = len(self.lag_covariance)
        mean_u = float(np.sqrt(max(np.sum(self.lag_covariance), 0.0))) / m
        return np.abs(self.lag_sensitivity) * mean_u

    def summary(self, names: Sequence[str] = ()) -> str:
        """A few lines for people; ``names`` of the channels, their numbers from 1 without."""
        return "\n".join([*self.lines(names), *self.warnings])

    def lines(self, names: Sequence[str] = ()) -> list[str]:
        """The summary without its warnings."""
        lines = [f"{self.method}: {self.temperature.shape[0]} samples, {self.temperature.shape[1]} channels"]
        for c in range(self.temperature.shape[1]):
            flagged = int(np.count_nonzero(self.flags[:, c]))
            lines.append(
                f"  channel {names[c] if names else c + 1}: noise {self.noise_sd[c]:.3g} K, "
                f"standard deviation {np.median(self.sd[:, c]):.3g} K typical, {np.max(self.sd[:, c]):.3g} K at most, "
                f"{flagged} samples flagged"
            )
        common = float(np.max(self.common_sd()))
        if common > 0:
            lines.append(f"  the lag common to all channels moves them together by up to {common:.2g} K (1 sd)")
        return [*lines, *(f"  slope free to jump at {with_u(t, u, 's')}" for t, u in self.events_s)]

    def to_dict(self) -> dict[str, Any]:
        """What the answer is worth, channel by channel; the samples are in the arrays."""
        return {
            "method": self.method,
            "samples": len(self.time_s),
            "channels": jsonable(self.card()),
            "common_sd_max_K": float(np.max(self.common_sd())),
            "events_s": [{"value": t, "u": u} for t, u in self.events_s],
            "warnings": list(self.warnings),
        }

    def card(self) -> pd.DataFrame:
        """Noise, typical and largest standard deviation and flagged samples of each channel."""
        return pd.DataFrame(
            {
                "channel": range(self.temperature.shape[1]),
                "noise_sd_K": self.noise_sd,
                "sd_median_K": np.median(self.sd, axis=0),
                "sd_max_K": np.max(self.sd, axis=0),
                "flagged": np.count_nonzero(self.flags, axis=0),
            }
        )


def columns_of(y: ArrayLike) -> Array:
    """One trace or several as columns (N, M)."""
    data = np.asarray(y, dtype=float)
    return data[:, None] if data.ndim == 1 else data


def channel_noise_sd(data: Array, given: ArrayLike | None) -> Array:
    """Noise (M,) of the channels of ``data (N, M)``: as ``given``, one number for all allowed, or estimated."""
    m = data.shape[1]
    if given is None:
        return np.array([noise_sd(data[:, c]) for c in range(m)])
    return np.broadcast_to(np.asarray(given, dtype=np.float64), (m,)).copy()


def noise_sd(y: Array, fallback: float = 1e-6) -> float:
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


def flags_of(y: Array, noise_sd: Array) -> NDArray[np.uint8]:
    """Bits MISSING, SPIKE, STUCK, SATURATED for each sample of ``y (N, M)`` with noise ``noise_sd (M,)`` [K].

    Spikes by their rule in ``calibration.noise``. Stuck and saturated are runs of one value longer than chance
    repeats of this record's resolution.
    """
    flags = np.zeros(y.shape, dtype=np.uint8)
    for c in range(y.shape[1]):
        bad = ~np.isfinite(y[:, c])
        flags[bad, c] |= MISSING
        good = np.flatnonzero(~bad)
        if len(good) < SPIKES["compensator"].width:
            continue
        trace = y[good, c]
        runs = _long_runs(trace)
        stop = (trace == trace.max()) | (trace == trace.min())
        flags[good[runs & stop], c] |= SATURATED
        flags[good[runs & ~stop], c] |= STUCK
        flags[good[find_spikes(trace, SPIKES["compensator"], noise_sd[c])], c] |= SPIKE
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
