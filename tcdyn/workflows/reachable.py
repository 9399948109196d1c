"""Readings that a chain of lags cannot have produced from any physical temperature.

A reading that jumps further than the largest lag of its chain allows is no temperature: an open or
unplugged thermocouple, or the value that a logger writes for an overload. It is treated as missing.

Used by the live compensation (:mod:`tcdyn.workflows.live`, :mod:`tcdyn.workflows.warm_up`). A log
that is complete is examined by ``tcdyn.rig.plausible.impossible_changes``, which has the same
bound. Limits without a source were chosen by judgement. Guarded by
``tests/smoothing/test_follow_invalid.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.findings import Finding, warning
from tcdyn.rig.plausible import HIGHEST_DEGC, LOWEST_DEGC
from tcdyn.smoothing.live import BURST_SD_RATIO

# Offsets that the live smoother itself takes for a burst of the slip rings are left to it: four standard deviations.
MARGIN_NOISES = 4.0 * BURST_SD_RATIO
# Two steps of the coarsest usual logger (1 K): the first seconds may not show the step.
MIN_MARGIN_K = 2.0
# The shortest possible lag is so many standard uncertainties below the stated lag.
LAG_SIGMAS = 3.0
# A Butterworth filter overshoots. The impulse response of order 6 has the L1 norm 1.35, so its output can leave the
# range of its input by 0.18 of that range on each side.
OVERSHOOT_SHARE = 0.2
# A channel that has had no acceptable reading for so long starts anew with what it reads: as after a gap of the log,
# but not before the lag has forgotten where it began (exp(-10) = 5e-5).
START_ANEW_S = 60.0
START_ANEW_LAGS = 10.0
# So many readings at the start are tried as the first valid one.
START_CANDIDATES = 16
QUARTILE_OF_DIFFERENCES = 0.3186 * np.sqrt(
    2.0
)  # 25 % of the |differences| of white noise with sd 1 are smaller


@dataclass(frozen=True)
class ReadingTrack:
    """The levels of M channels.

    Parameters
    ----------
    value
        Last accepted reading (M,) [degC].
    age
        Number of samples since then (M,).
    count
        Number of accepted readings (M,).
    rival, rival_age, rival_count
        The same of the last rejected readings that agree with each other.
    """

    value: Array
    age: Array
    count: Array
    rival: Array
    rival_age: Array
    rival_count: Array

    @classmethod
    def begin(cls, value: Array, count: float = 0.0) -> ReadingTrack:
        """The track of channels before their first reading.

        Parameters
        ----------
        value
            Level (M,) [degC].
        count
            Number of readings that it comes from: so many rejected readings must agree to replace
            it.
        """
        nothing = np.zeros(len(value))
        no_value = np.full(len(value), np.nan)
        return cls(
            np.array(value, dtype=float), nothing, nothing + count, no_value, nothing, nothing
        )

    def to_json(self) -> dict[str, Any]:
        """The fields as lists."""
        return {f.name: getattr(self, f.name).tolist() for f in fields(self)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> ReadingTrack:
        """The track from the result of ``to_json``."""
        return cls(**{name: np.array(values, dtype=float) for name, values in data.items()})


@dataclass
class _Channel:
    """The track of one channel while its readings are examined one by one."""

    value: float
    age: float
    count: float
    rival: float = np.nan
    rival_age: float = 0.0
    rival_count: float = 0.0


@dataclass(frozen=True)
class Reach:
    """How far the readings of M channels can move.

    Parameters
    ----------
    remaining_share
        Share (M,) of a deviation that remains after one sample; 0 where the chain sets no bound.
    margin_K
        Margin (M,) for the noise [K].
    low_degC, high_degC
        Range (M,) of the input of the largest lag [degC].
    patience
        Number of samples (M,) without an acceptable reading after which a channel starts anew.

    Notes
    -----
    A lag tau obeys tau dy/dt = w - y. With low <= w <= high, after n samples of dt

        low + (y0 - low) k <= y <= high + (y0 - high) k,    k = exp(-n dt / tau).

    The other lags of the chain have positive impulse responses, so w stays in the physical range of
    the temperature. A conditioning filter that overshoots widens the range by ``OVERSHOOT_SHARE``.
    ``tests/smoothing/test_follow_invalid.py`` checks that no physical input is rejected.
    """

    remaining_share: Array
    margin_K: Array
    low_degC: Array
    high_degC: Array
    patience: Array

    @classmethod
    def create(
        cls, chains: Sequence[Chain], lag_u_s: Array, split_u_s: Array, noise_K: Array, dt_s: float
    ) -> Reach:
        """The bounds of some channels.

        Parameters
        ----------
        chains
            Chain of each channel (M,).
        lag_u_s, split_u_s
            Standard uncertainties (M,) of the lags and of their division [s].
        noise_K
            Standard deviation of the noise (M,) [K].
        dt_s
            Sampling interval [s].

        Notes
        -----
        A zero or a complex pair makes a chain quicker than its largest lag: no bound is set for it.
        The lag is taken ``LAG_SIGMAS`` standard uncertainties shorter, and the margin is
        ``MARGIN_NOISES`` times the noise. With smaller values valid readings may be rejected, with
        larger ones fewer faults are noticed. ``MARGIN_NOISES`` follows
        ``tcdyn.smoothing.live.BURST_SD_RATIO``.
        """
        keep = np.zeros(len(chains))
        patience = np.zeros(len(chains))
        overshoot = np.zeros(len(chains))
        for i, chain in enumerate(chains):
            lags_s = [factor[1] for factor in chain.factors() if len(factor) == 2]
            shortest_s = max(lags_s, default=0.0) - LAG_SIGMAS * float(
                np.hypot(lag_u_s[i], split_u_s[i])
            )
            patience[i] = max(START_ANEW_S, START_ANEW_LAGS * max(lags_s, default=0.0)) / dt_s
            if shortest_s > 0 and not chain.zero_s and chain.pair is None:
                keep[i] = np.exp(-dt_s / shortest_s)
            if any(len(factor) > 2 for factor in chain.conditioning.factors):
                overshoot[i] = OVERSHOOT_SHARE * (HIGHEST_DEGC - LOWEST_DEGC)
        margin_K = np.maximum(MARGIN_NOISES * np.asarray(noise_K), MIN_MARGIN_K)
        return cls(keep, margin_K, LOWEST_DEGC - overshoot, HIGHEST_DEGC + overshoot, patience)

    def possible(self, i: int, before: Any, after: Any, samples: Any) -> Any:
        """Whether a channel can have one reading some samples after another.

        Parameters
        ----------
        i
            Index of the channel.
        before, after
            The readings [degC].
        samples
            Number of samples between them. Arrays of these three are allowed.
        """
        if self.remaining_share[i] == 0:
            return np.isfinite(after)
        kept = self.remaining_share[i] ** samples
        low = self.low_degC[i] + (before - self.low_degC[i]) * kept - self.margin_K[i]
        high = self.high_degC[i] + (before - self.high_degC[i]) * kept + self.margin_K[i]
        return (low <= after) & (after <= high)

    def examine(
        self, track: ReadingTrack, y: Array
    ) -> tuple[ReadingTrack, NDArray[np.bool_], NDArray[np.bool_]]:
        """Continue a track with new readings.

        Parameters
        ----------
        track
            The track so far.
        y
            Readings (N, M) [degC], NaN where missing.

        Returns
        -------
        track
            The track after them.
        rejected
            Readings that are rejected (N, M).
        anew
            Where a channel starts anew (N, M): rejected readings that agree with each other
            outnumber the accepted ones, or none was accepted for too long.

        Notes
        -----
        The result does not depend on how the readings are divided into calls;
        ``tests/smoothing/test_follow_invalid.py`` checks this.
        """
        rejected = np.zeros(y.shape, dtype=bool)
        anew = np.zeros(y.shape, dtype=bool)
        after = {f.name: np.array(getattr(track, f.name)) for f in fields(track)}
        for i in range(y.shape[1]):
            channel = _Channel(**{name: float(values[i]) for name, values in after.items()})
            if not self._all_follow(i, channel, y[:, i]):
                for k, reading in enumerate(y[:, i].tolist()):
                    rejected[k, i], anew[k, i] = self._step(i, channel, reading)
            for name, values in after.items():
                values[i] = getattr(channel, name)
        return replace(track, **after), rejected, anew

    def _all_follow(self, i: int, channel: _Channel, y: Array) -> bool:
        """Whether each reading can follow from the one before; the channel is then moved on.

        Parameters
        ----------
        i
            Index of the channel.
        channel
            Its track, changed if the result is True.
        y
            Readings (N,) [degC], NaN where missing.

        Notes
        -----
        It must give the same track as ``_step`` for every reading: it exists for speed.
        """
        at = np.flatnonzero(np.isfinite(y))
        rival_is_newer = np.isfinite(channel.rival) and channel.rival_age < channel.age
        if len(at) and rival_is_newer:
            return False
        readings = y[at]
        samples = np.diff(at, prepend=-1.0 - channel.age)
        before = np.concatenate([[channel.value], readings])[:-1]
        if not np.all(self.possible(i, before, readings, samples)):
            return False
        channel.age = float(len(y) - 1 - at[-1]) if len(at) else channel.age + len(y)
        channel.value = float(readings[-1]) if len(at) else channel.value
        channel.count += len(at)
        channel.rival_age += len(y)
        return True

    def _step(self, i: int, channel: _Channel, reading: float) -> tuple[bool, bool]:
        """Continue the track of one channel with one reading.

        Parameters
        ----------
        i
            Index of the channel.
        channel
            Its track, which is changed.
        reading
            The reading [degC], NaN if missing.

        Returns
        -------
        rejected
            Whether the reading is rejected.
        anew
            Whether the channel starts anew with it.
        """
        channel.age += 1.0
        channel.rival_age += 1.0
        if not np.isfinite(reading):
            return False, False
        accepted = bool(self.possible(i, channel.value, reading, channel.age))
        agrees = bool(np.isfinite(channel.rival)) and bool(
            self.possible(i, channel.rival, reading, channel.rival_age)
        )
        # The bound widens with time. A run of rejected readings that goes on at its level stays rejected all the same.
        rival_is_newer = channel.rival_age < channel.age
        if (
            agrees
            and rival_is_newer
            and abs(reading - channel.rival) < abs(reading - channel.value)
        ):
            accepted = False
        if accepted:
            channel.value = reading
            channel.age = 0.0
            channel.count += 1.0
            return False, False
        channel.rival_count = channel.rival_count + 1.0 if agrees else 1.0
        channel.rival = reading
        channel.rival_age = 0.0
        too_long = channel.age > self.patience[i]
        if too_long or channel.rival_count > channel.count:
            channel.value = reading
            channel.age = 0.0
            channel.count = 1.0 if too_long else channel.rival_count
            channel.rival = np.nan
            return False, True
        return True, False

    def rejected_at_start(self, i: int, y: Array) -> NDArray[np.bool_]:
        """Which of the first readings of a channel are rejected.

        The first valid one is the one that most of the others can follow from. ``START_CANDIDATES``
        are tried.

        Parameters
        ----------
        i
            Index of the channel.
        y
            Readings (N,) [degC], NaN where missing.
        """
        finite = np.flatnonzero(np.isfinite(y))
        best = np.zeros(len(y), dtype=bool)
        least = len(y) + 1
        for at in finite[:START_CANDIDATES].tolist():
            channel = _Channel(float(y[at]), 0.0, float(len(y)))
            rejected = np.isfinite(y)
            rejected[at] = False
            if self._all_follow(i, channel, y[at + 1 :]):
                rejected[at + 1 :] = False
            else:
                rejected[at + 1 :] = [
                    self._step(i, channel, reading)[0] for reading in y[at + 1 :].tolist()
                ]
            if np.count_nonzero(rejected) < least:
                least = int(np.count_nonzero(rejected))
                best = rejected
            if least == 0:
                break
        return best


@dataclass(frozen=True)
class Screening:
    """What was treated as missing so far in M channels, and their track.

    Parameters
    ----------
    track
        The track.
    impossible, unreachable
        Number of readings (M,) outside the physical range, and beyond what the chain allows.
    restarts
        Number of times (M,) that a channel started anew.
    blank
        Number of results (M,) left empty because they lie outside the physical range.
    first_s
        Time of the first reading that was treated as missing [s]; NaN without one.
    """

    track: ReadingTrack
    impossible: Array
    unreachable: Array
    restarts: Array
    blank: Array
    first_s: float = np.nan

    @classmethod
    def begin(cls, track: ReadingTrack) -> Screening:
        """Nothing was treated as missing yet."""
        none = np.zeros(len(track.value))
        return cls(track, none, none, none, none)

    def to_json(self) -> dict[str, Any]:
        """The fields as lists and numbers."""
        counts = {
            name: getattr(self, name).tolist()
            for name in ("impossible", "unreachable", "restarts", "blank")
        }
        return {"track": self.track.to_json(), **counts, "first_s": self.first_s}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Screening:
        """The screening from the result of ``to_json``."""
        counts = {
            n: np.array(data[n], dtype=float)
            for n in ("impossible", "unreachable", "restarts", "blank")
        }
        return cls(ReadingTrack.from_json(data["track"]), first_s=float(data["first_s"]), **counts)

    def examined(
        self, reach: Reach, time_s: Array, y: Array, outside: NDArray[np.bool_]
    ) -> tuple[Screening, Array, NDArray[np.bool_]]:
        """Continue with new readings.

        Parameters
        ----------
        reach
            Bounds of the channels.
        time_s
            Times (N,) [s].
        y
            Readings (N, M) [degC].
        outside
            Readings (N, M) outside the physical range.

        Returns
        -------
        screening
            The screening after them.
        readings
            Readings (N, M) with NaN for what is treated as missing.
        anew
            Where a channel starts anew (N, M).
        """
        valid = np.where(outside, np.nan, y)
        track, rejected, anew = reach.examine(self.track, valid)
        times_s = time_s[np.any(rejected | outside, axis=1)]
        first_s = self.first_s
        if np.isnan(first_s) and len(times_s):
            first_s = float(times_s[0])
        after = replace(
            self,
            track=track,
            impossible=self.impossible + np.count_nonzero(outside, axis=0),
            unreachable=self.unreachable + np.count_nonzero(rejected, axis=0),
            restarts=self.restarts + np.count_nonzero(anew, axis=0),
            first_s=first_s,
        )
        return after, np.where(rejected, np.nan, valid), anew

    def blanked(self, bad: NDArray[np.bool_]) -> Screening:
        """The same with the results ``bad`` (N, M) counted as left empty."""
        return replace(self, blank=self.blank + np.count_nonzero(bad, axis=0))

    def findings(self, names: Sequence[str]) -> tuple[Finding, ...]:
        """The warnings; ``names`` of the channels."""
        findings: list[Finding] = []
        count = int(self.impossible.sum())
        if count:
            subject = _listed(names, self.impossible)
            limits: dict[str, Any] = {
                "low_degC": LOWEST_DEGC,
                "high_degC": HIGHEST_DEGC,
                "first_s": self.first_s,
            }
            findings.append(warning("follow.impossible", subject=subject, count=count, **limits))
        count = int(self.unreachable.sum())
        if count:
            subject = _listed(names, self.unreachable)
            findings.append(
                warning("follow.unreachable", subject=subject, count=count, first_s=self.first_s)
            )
        count = int(self.restarts.sum())
        if count:
            subject = _listed(names, self.restarts)
            findings.append(warning("follow.restarted", subject=subject, count=count))
        count = int(self.blank.sum())
        if count:
            subject = _listed(names, self.blank)
            limits = {"low_degC": LOWEST_DEGC, "high_degC": HIGHEST_DEGC}
            findings.append(warning("follow.blank", subject=subject, count=count, **limits))
        return tuple(findings)


def _listed(names: Sequence[str], counts: Array) -> str:
    """The names of the channels whose count is not zero."""
    return ", ".join(name for name, count in zip(names, counts) if count)


def noise_bound_K(y: Array) -> float:
    """Noise [K] of a trace (N,) that hardly changes if up to half of the readings are invalid.

    The lower quartile of the differences between readings one, two and three samples apart,
    whichever is smallest; at least the rounding error of the logger.
    """
    readings = y[np.isfinite(y)]
    estimates_K: list[float] = []
    for separation in (1, 2, 3):
        differences = np.abs(readings[separation:] - readings[:-separation])
        if len(differences):
            estimates_K.append(float(np.quantile(differences, 0.25)) / QUARTILE_OF_DIFFERENCES)
    smallest_step = float(np.min(np.diff(np.unique(readings)), initial=np.inf))
    rounding = smallest_step / np.sqrt(12.0) if np.isfinite(smallest_step) else 0.0
    return max(min(estimates_K, default=0.0), rounding)
