"""What a compensator is given, a record of traces whose bad samples are known; and what it returns, with its doubt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from tcdyn.chain import Chain, Sensor, chains_for, sensors
from tcdyn.chain.bursts import made_white, noise_and_white
from tcdyn.chain.logger_noise import LoggerNoise
from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import with_u
from tcdyn.core.findings import Finding, info_or_warning, messages, warning
from tcdyn.core.result import Result, jsonable
from tcdyn.estimation.trace_noise import SPIKES, bridged, long_runs, rounding_sd, trace_noise_sd
from tcdyn.rig.plausible import HIGHEST_DEGC, LOWEST_DEGC, dropout_codes, impossible, unreachable
from tcdyn.smoothing.noise_levels import Intensity

# bits of ``flags``
GOOD = 0
MISSING = 1
SPIKE = 2
STUCK = 4
SATURATED = 8
IMPLAUSIBLE = 16
LEAST_GOOD = 8  # samples
STEADY_NOISES = 10.0  # standard deviations of the noise that a steady record ranges over at least
FEW_IMPLAUSIBLE = 0.01  # share of a trace that the rule for spikes finds by itself


@dataclass(frozen=True)
class Stretch:
    """Samples ``y (N, M)`` (finite; weight 0 where bad) every ``dt_s``, their chains and the times of events [s].

    ``noise_sd (M,)`` [K]; ``flags (N, M)``: bits MISSING, SPIKE, STUCK, SATURATED, IMPLAUSIBLE; ``noise_known``:
    whether the level of the noise was given, or is that of noise made white; ``folded_u_K`` (M,): see ``LoggerNoise``,
    with the rounding of a logger whose steps are coarser than its noise; ``findings``: channels that suffer.
    """

    y: Array
    weight: Array
    dt_s: float
    chains: tuple[Chain, ...]
    sensors: tuple[Sensor, ...]
    events_s: tuple[float, ...]
    noise_sd: Array
    flags: NDArray[np.uint8]
    noise_known: bool
    folded_u_K: Array
    findings: tuple[Finding, ...] = ()


def stretch_of(
    y: ArrayLike,
    dt_s: float,
    chains: float | Chain | Sequence[Chain],
    events_s: Sequence[float] = (),
    noise_sd: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> Stretch:
    """The record ``y``, (N,) or (N, M), as a record whose bad samples carry no weight; arguments as of ``smooth``.

    Raises InputError for shapes that do not agree, for a channel that mostly repeats one value, or hardly measures.
    """
    data = (data := np.array(y, dtype=float)).reshape(len(data), -1)
    n, m = data.shape
    listed = chains_for(chains, m)
    if n < LEAST_GOOD or not dt_s > 0:
        raise InputError(
            f"smooth: {n} samples every {dt_s:g} s",
            expected=f"at least {LEAST_GOOD} samples and a positive interval",
        )
    called = [f"channel {c + 1}" for c in range(m)] if names is None else list(names)
    if len(called) != m:
        raise InputError(
            f"smooth: {m} channels but {len(called)} names", expected="one name per channel"
        )
    implausible, found = _implausible(data, dt_s, listed, called)
    data[implausible] = np.nan
    each = np.ascontiguousarray(data.T)
    noise: Array = np.full(
        m, [trace_noise_sd(x) for x in each] if noise_sd is None else noise_sd, dtype=float
    )
    flags = np.stack([_flags(x) for x in each], axis=1)
    folded_u = np.zeros(m)
    coloured = False
    flags[implausible] = IMPLAUSIBLE
    step = np.array([rounding_sd(x) for x in each])
    rounded = np.where((step >= noise) & (noise_sd is None), step, 0.0)
    for flag, name in zip(flags.T, called):
        if np.mean(flag & (STUCK | SATURATED) != 0) > 0.5:
            raise InputError(
                f"{name}: more than half of the samples repeat one value",
                expected="a trace with noise on it",
                remedy="check the wiring and the range of this channel, or leave it out",
            )
        if np.count_nonzero(flag == GOOD) < LEAST_GOOD:
            raise InputError(
                f"smooth: {name} has fewer than {LEAST_GOOD} good samples",
                remedy="leave this channel out",
            )
    for filter_ in dict.fromkeys(c.conditioning for c in listed):
        own = [c for c in range(m) if listed[c].conditioning == filter_]
        good = flags[:, own] == GOOD
        group = [listed[c] for c in own]
        rule = SPIKES["compensator"].behind(min(c.lag_s for c in group) / dt_s)
        x = np.where(good, data[:, own], np.nan)
        if noise_sd is None:
            told, [(data[:, own], moved)] = noise_and_white(
                [x], [dt_s], filter_, noise[own], group, rule
            )
        else:
            told = LoggerNoise(np.zeros(len(own)), noise[own], noise[own], filter_)
            data[:, own], moved = made_white(told, x, good, dt_s, group, rule, pulses=False)
        flags[:, own] |= np.where(moved, SPIKE, 0).astype(np.uint8)
        noise[own], folded_u[own], coloured = (
            told.level_K,
            told.folded_u_K,
            coloured or told.coloured,
        )
        found += told.findings(called[own[0]] if len(own) == 1 else f"{len(own)} channels")
        for c in own:
            listed[c] = told.behind(listed[c])
    for flag, name in zip(flags.T, called):
        if (still := flag & (STUCK | SATURATED) != 0).any():
            percent = 100 * float(np.mean(still))
            first = int(np.argmax(still))
            found.append(warning("trace.stuck", subject=name, percent=percent, first_sample=first))
        elif (bad := float(np.mean(flag != GOOD))) > 0.01:
            found.append(info_or_warning(bad, "trace.bad", subject=name, percent=100 * bad))
    good = flags == GOOD
    filled = np.stack([bridged(x, g) for x, g in zip(data.T, good.T)], axis=1)
    events = tuple(sorted({float(e) for e in events_s if 0 < e < (n - 1) * dt_s}))
    return Stretch(
        filled,
        good.astype(float),
        dt_s,
        tuple(listed),
        tuple(sensors(listed)),
        events,
        noise,
        flags,
        noise_sd is not None or coloured,
        np.hypot(folded_u, rounded),
        tuple(found),
    )


def _implausible(
    data: Array, dt_s: float, chains: Sequence[Chain], names: Sequence[str]
) -> tuple[Flags, list[Finding]]:
    """Which readings (N, M) no temperature can have produced through the chains, and what to report about them."""
    out = np.zeros(data.shape, dtype=bool)
    findings = []
    for c, (chain, name) in enumerate(zip(chains, names)):
        y = data[:, c]
        outside = impossible(y)
        inside = np.where(outside, np.nan, y)
        lag_s = max(chain.taus_s, default=0.0)
        codes = dropout_codes(inside)
        rest = np.where(codes, np.nan, inside)
        directly = min(max(chain.zero_s, 0.0) / lag_s, 1.0) if lag_s > 0 else 1.0
        unreached = unreachable(rest, dt_s, lag_s, directly)
        wrong = codes | unreached
        edges = np.flatnonzero(np.diff(np.concatenate([[False], wrong, [False]])))
        longest = int(np.max(np.diff(edges)[::2], initial=0))
        if wrong.mean() <= FEW_IMPLAUSIBLE and longest <= SPIKES["compensator"].longest:
            wrong[:] = False
            codes[:] = False
            unreached[:] = False
        out[:, c] = outside | wrong
        if outside.any():
            numbers = _first_of(outside, y)
            findings.append(
                info_or_warning(float(outside.mean()), "trace.outside", subject=name, **numbers)
            )
        if codes.any():
            findings.append(warning("trace.codes", subject=name, **_first_of(codes, y)))
        if unreached.any():
            findings.append(warning("trace.unreachable", subject=name, **_first_of(unreached, y)))
    return out, findings


def _first_of(bad: Flags, y: Array) -> dict[str, Any]:
    """How many of the readings ``y`` (N,) are ``bad`` (N,), and the first of them."""
    first = int(np.argmax(bad))
    return {"count": int(bad.sum()), "first_sample": first, "value": float(y[first])}


def _flags(y: Array) -> NDArray[np.uint8]:
    """Bits MISSING, STUCK, SATURATED for each sample of ``y (N,)``.

    Stuck and saturated are runs of one value longer than chance repeats of this record's resolution.
    """
    flags = np.where(np.isfinite(y), GOOD, MISSING).astype(np.uint8)
    index = np.flatnonzero(flags == GOOD)
    if len(index) >= SPIKES["compensator"].width:
        trace = y[index]
        runs = long_runs(trace)
        stop = (trace == trace.max()) | (trace == trace.min())
        flags[index] = np.where(runs, np.where(stop, SATURATED, STUCK), GOOD)
    return flags


@dataclass(frozen=True)
class Compensated(Result):
    """A compensated record; all arrays (N, M), one column a channel.

    ``temperature`` [degC] at the junction at ``time_s``; ``sd`` [K] its standard deviation, from ``sd_noise`` (noise
    and regularisation), ``lag_sensitivity`` [K/s] times the uncertainty of each lag, ``split_K`` (what one standard
    uncertainty of how a lag divides into its parts moves) and ``static_u`` [K].
    ``slope`` [K/s]; ``noise_sd (M,)`` [K]; ``intensity (M,)`` [K2/s3], the median over the record; ``flags``: bits
    MISSING, SPIKE, STUCK, SATURATED, IMPLAUSIBLE; ``method`` in words; ``events_s``: pairs of time and its standard
    uncertainty [s]; ``intensities``: as functions of time, one a channel (smoother only); ``by_event_K``: what one
    standard uncertainty of each event's instant moves (N, M) [K], its square being in that of ``sd_noise``;
    ``undetermined`` (N, M): where the record does not determine the temperature, see ``checked``.
    """

    temperature: Array
    sd: Array
    sd_noise: Array
    slope: Array
    lag_sensitivity: Array
    static_u: Array
    lag_covariance: Array
    split_K: Array
    noise_sd: Array
    intensity: Array
    flags: NDArray[np.uint8]
    time_s: Array
    method: str
    findings: tuple[Finding, ...] = ()
    events_s: tuple[tuple[float, float], ...] = ()
    intensities: tuple[Intensity, ...] = ()
    by_event_K: tuple[Array, ...] = ()
    undetermined: Flags | None = None

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
        split_K: ArrayLike = 0.0,
        **rest: Any,
    ) -> Compensated:
        """With the whole standard deviation, sd^2 = sd_noise^2 + (lag_sensitivity u(lag))^2 + split_K^2 + static_u^2.

        ``lag_covariance`` (M, M), ``static_u`` and ``split_K`` (a number, (M,) or (N, M)) are zero when left out;
        ``rest``: the fields that are left.
        """
        n, m = temperature.shape
        lags: Array = (
            np.zeros((m, m))
            if lag_covariance is None
            else np.asarray(lag_covariance, dtype=np.float64)
        )
        line = np.broadcast_to(
            np.asarray(0.0 if static_u is None else static_u, dtype=np.float64), (n, m)
        )
        split = np.broadcast_to(np.asarray(split_K, dtype=np.float64), (n, m))
        variance = sd_noise**2 + lag_sensitivity**2 * np.diag(lags) + split**2 + line**2
        total, time = (
            np.asarray(a, dtype=np.float64) for a in (np.sqrt(variance), np.arange(n) * dt_s)
        )
        return cls(
            temperature,
            total,
            sd_noise,
            slope,
            lag_sensitivity,
            line,
            lags,
            split,
            time_s=time,
            **rest,
        )

    def checked(self, y: Array, names: Sequence[str]) -> Compensated:
        """The same with ``undetermined`` and a warning for each channel that has such samples.

        A sample is undetermined where its standard uncertainty, without that of the static line, exceeds the range of
        the channel's readings ``y`` (N, M) [degC, NaN or flagged where bad], or its temperature is no possible one.
        """
        readings = np.where(self.flags == GOOD, y, np.nan)
        range_K = np.nanmax(readings, axis=0) - np.nanmin(readings, axis=0)
        variance = np.maximum(self.sd**2 - self.static_u**2, 0.0)
        wide = np.sqrt(variance) > np.maximum(range_K, STEADY_NOISES * self.noise_sd)
        unphysical = (self.temperature < LOWEST_DEGC) | (self.temperature > HIGHEST_DEGC)
        undetermined = wide | unphysical
        findings = list(self.findings)
        for c in np.flatnonzero(undetermined.any(axis=0)):
            column = undetermined[:, c]
            numbers: dict[str, Any] = {
                "percent": 100 * float(column.mean()),
                "first_sample": int(np.argmax(column)),
            }
            findings.append(
                warning(
                    "trace.undetermined", subject=names[c], range_K=float(range_K[c]), **numbers
                )
            )
        return replace(self, undetermined=undetermined, findings=tuple(findings))

    def answers(self) -> tuple[Array, Array]:
        """Temperature [degC] and standard uncertainty [K] (N, M), NaN where the record does not determine them."""
        if self.undetermined is None or not self.undetermined.any():
            return self.temperature, self.sd
        return np.where(self.undetermined, np.nan, self.temperature), np.where(
            self.undetermined, np.nan, self.sd
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed, in words."""
        return messages(self.findings)

    def common_sd(self) -> Array:
        """Part of ``sd`` (N, M) that comes from the lag common to all channels, hence moves them together [K]."""
        mean_u = float(np.sqrt(max(np.sum(self.lag_covariance), 0.0))) / len(self.lag_covariance)
        return np.abs(self.lag_sensitivity) * mean_u

    def summary(self, names: Sequence[str] = ()) -> str:
        """A few lines for people; ``names`` of the channels, their numbers from 1 without."""
        return "\n".join([*self.lines(names), *self.warnings])

    def lines(self, names: Sequence[str] = ()) -> list[str]:
        """The summary without its warnings."""
        lines = [
            f"{self.method}: {self.temperature.shape[0]} samples, {self.temperature.shape[1]} channels"
        ]
        for c in range(self.temperature.shape[1]):
            lines.append(
                f"  channel {names[c] if names else c + 1}: noise {self.noise_sd[c]:.3g} K, "
                f"standard deviation {np.median(self.sd[:, c]):.3g} K typical, {np.max(self.sd[:, c]):.3g} K at most, "
                f"{np.count_nonzero(self.flags[:, c])} samples flagged"
            )
        if (common := float(np.max(self.common_sd()))) > 0:
            lines.append(
                f"  the lag common to all channels moves them together by up to {common:.2g} K (1 sd)"
            )
        return [*lines, *(f"  event at {with_u(t, u, 's')}" for t, u in self.events_s)]

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
