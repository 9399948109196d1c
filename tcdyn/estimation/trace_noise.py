"""How noisy a trace is, whatever it does slowly and however many spikes stand in it, and which samples cannot be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import comb, prod
from typing import Literal

import numpy as np
import scipy  # scipy.ndimage with its first use: who reads a log need not wait for it
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation

MAD_TO_SD = 1.482602218505602  # standard deviation of a normal distribution over its median absolute deviation
# type J's range at the hot end
COLDEST_DEGC = -60.0
HOTTEST_DEGC = 760.0
MOST_MISSING = 0.05  # fraction of a channel
COARSE = 0.5  # share of repeats in short runs: beyond it the logger's step hides the noise
NOT_TOLD = 1e-6  # noise of a trace that does not tell its own
LEAST_TOLD = 15  # samples that tell the noise
MOSTLY_MOVING = 0.7  # share of samples that differ from the one before, where the noise is about one step of the logger


@dataclass(frozen=True)
class SpikeRule:
    """A spike lies more than ``sigmas`` standard deviations of the noise, and more than ``floor``, off its neighbours.

    Off the median of the ``width`` samples around it, of which less than half may be spikes. ``floor`` in the trace's
    unit. ``local``: the usual distance from that median over so many samples stands for the noise where it is larger.
    """

    sigmas: float
    width: int
    floor: float = 0.0
    local: int = 0

    @property
    def longest(self) -> int:
        """How many samples in a row may be a spike."""
        return self.width // 2

    def behind(self, lag_samples: float) -> SpikeRule:
        """The rule for readings of a chain whose lag is so many samples: what passes it lasts for half the lag.

        >>> [SPIKES["compensator"].behind(lag).width for lag in (0.0, 5.0, 50.0)]
        [3, 3, 9]
        """
        return replace(self, width=int(np.clip(2 * int(lag_samples / 4) + 1, 3, self.width)))


SpikeUse = Literal["reading", "traces", "plunge", "force", "compensator", "answer"]

# every limit there is for spikes, by its use, at the usual 75 Hz
SPIKES: Mapping[SpikeUse, SpikeRule] = {
    "reading": SpikeRule(
        8.0, 7, floor=0.5
    ),  # any temperature column of a log: one clean sample in 1e15 lies so far
    "traces": SpikeRule(
        6.0, 11
    ),  # of a disk, after the static lines: 0.15 s, more than a slip ring's spike
    "plunge": SpikeRule(7.8, 5),  # a plunge's readings before they are averaged
    "force": SpikeRule(
        6.0, 151
    ),  # load and friction: 2 s about the sample (at other rates, too), of their scatter
    "compensator": SpikeRule(6.0, 9, local=73),  # traces of any origin, given to a compensator
    "answer": SpikeRule(
        6.0, 7
    ),  # those samples again, against what the smoother's answer would have been read as
}


def white_noise_sd(values: ArrayLike, order: int = 2, *, centred: bool = True) -> Array:
    """Standard deviation of the white noise of a trace, from its differences and their median.

    sd = 1.4826 median |d - median d| / sqrt(C(2k, k)), d the differences of order k, whose variance is C(2k, k) times
    that of white noise; not less than the rounding of a logger whose step is coarser than the noise. A higher order
    forgives a quicker signal and a logger's drift; a lower one wastes fewer neighbours of a missing sample.

    Args:
        values: (N,) or (N, M), any unit, NaN where missing.
        order: of the differences, k >= 1.
        centred: False where the differences are known to be zero on the average, and ``median d`` is left out.

    Returns one number, or one for each of M columns, in the unit of ``values``.

    >>> noise = np.random.default_rng(0).normal(0.0, 0.2, 4000)
    >>> ramp = 0.01 * np.arange(4000)
    >>> [round(float(white_noise_sd(ramp + noise, k)), 2) for k in (1, 2, 3, 4)]
    [0.2, 0.2, 0.2, 0.2]
    """
    x = np.asarray(values, dtype=float)
    told = []
    for column in np.ascontiguousarray(
        x.reshape(len(x), -1).T
    ):  # one by one: what is looked at stays near the core
        d = np.diff(column, n=order)
        away = middle(np.abs(d - middle(d) if centred else d))
        told.append(
            np.maximum(MAD_TO_SD * away / np.sqrt(comb(2 * order, order)), rounding_sd(column))
        )
    return np.array(told).reshape(x.shape[1:])


def middle(values: NDArray[np.floating]) -> Array:
    """``np.nanmedian(values, axis=-1)``, NaN where there is nothing, of long traces in a tenth of its time.

    By itself, because numpy partitions by one place far quicker than by the two that its own median asks for.

    >>> middle(np.array([[3.0, 1.0, np.nan, 2.0], [4.0, 1.0, 2.0, 3.0]]))
    array([2. , 2.5])
    """
    rows = np.ascontiguousarray(values).reshape(prod(values.shape[:-1]), values.shape[-1])
    counts = np.count_nonzero(~np.isnan(rows), axis=-1)
    out = np.full(len(rows), np.nan)
    for count in np.unique(counts[counts > 0]).tolist():
        alike = counts == count
        k = count // 2
        parted = np.partition(rows[alike], k, axis=-1)  # what is missing comes last
        out[alike] = (
            parted[:, k] if count % 2 else 0.5 * (parted[:, :k].max(axis=-1) + parted[:, k])
        )
    return out.reshape(values.shape[:-1])


def trace_noise_sd(y: Array) -> float:
    """Standard deviation [same unit] of white noise on a smooth trace ``y (N,)``, NaN for missing.

    sd = 1.4826 median |fourth difference| / sqrt(70); a signal slower than a tenth of the sampling rate leaves less
    than 2 % of its amplitude. A trace that rests on one step of its logger gets a quarter of that step.
    """
    if np.count_nonzero(np.isfinite(np.diff(y, n=4))) < 8:
        return NOT_TOLD
    sd = float(white_noise_sd(y, 4, centred=False))
    if sd > 0:
        return sd
    steps = np.abs(np.diff(y[np.isfinite(y)]))
    steps = steps[steps > 0]
    return float(np.min(steps)) / 4 if len(steps) else NOT_TOLD


def rounding_sd(x: Array) -> float:
    """Rounding error of a trace (N,) whose neighbours are often equal: its logger's step over sqrt(12); else zero.

    Differences that take few values have a median that says nothing, and is zero where most of them are zero.

    >>> round(float(rounding_sd(np.array([20.0, 20.0, 20.5, 20.5, 20.5, 20.0, 20.0]))), 3)  # steps of 0.5
    0.144
    """
    step = np.abs(np.diff(x))
    step = step[np.isfinite(step)]
    moved = step[step > 1e-9 * max(float(np.max(step, initial=0.0)), 1e-300)]
    if not len(moved) or len(moved) > MOSTLY_MOVING * len(step):
        return 0.0
    return float(np.median(moved) / np.sqrt(12))


def find_spikes(values: Array, rule: SpikeRule, noise_sd: float | None = None) -> Flags:
    """Samples of ``values (N,)`` that are spikes by ``rule``, given the standard deviation of their noise.

    A ramp or a clean step is no spike: the median follows both. NaN is never one. Without ``noise_sd`` the usual
    distance from the median, over the whole trace, stands for it.

    >>> find_spikes(np.array([20.0, 20.1, 20.2, 25.0, 20.4, 20.5, 20.6]), SPIKES["reading"], 0.1).nonzero()[0]
    array([3])
    """
    index = np.flatnonzero(np.isfinite(values))
    out = np.zeros(len(values), dtype=bool)
    x = values[index]
    if len(x) < 2:
        return out
    limit = max(rule.sigmas * (noise_sd or 0.0), rule.floor)
    apart = np.zeros(
        len(x), dtype=bool
    )  # of the majority that stands far away, one is at most so many samples off
    for k in range(1, min((rule.longest + 1) // 2, len(x) - 1) + 1 if noise_sd is not None else 1):
        jumps = np.abs(x[k:] - x[:-k]) > limit
        apart[k:] |= jumps
        apart[:-k] |= jumps
    few = noise_sd is not None and np.count_nonzero(apart) * rule.width < len(x)
    away = (
        np.zeros(len(x))
        if few
        else np.abs(x - scipy.ndimage.median_filter(x, rule.width, mode="nearest"))
    )
    windows = sliding_window_view(np.pad(x, rule.longest, mode="edge"), rule.width)

    def far_of(at: NDArray[np.intp]) -> NDArray[np.intp]:
        if few:
            away[at] = np.abs(x[at] - middle(windows[at]))
        return at[away[at] > limit]

    far = far_of(np.flatnonzero(apart) if few else np.arange(len(x)))
    usual = np.zeros(1)
    if rule.local:
        beside = rule.local // 2
        if few:
            far_of(np.unique(np.clip(far[:, None] + np.arange(-beside, beside + 1), 0, len(x) - 1)))
        usual = middle(sliding_window_view(np.pad(away, beside, mode="edge"), rule.local)[far])
    elif noise_sd is None:
        usual = middle(away[None])
    out[index[far[away[far] > rule.sigmas * MAD_TO_SD * usual]]] = True
    return out


def bridged(y: Array, good: Flags) -> Array:
    """Straight lines across the samples of ``y`` (N,) that are not ``good``."""
    gone = np.flatnonzero(~good)
    kept = np.flatnonzero(good)
    if not len(gone):
        return y
    out = np.array(y, dtype=float)
    out[gone] = np.interp(gone, kept, out[kept])
    return out


def local_polynomial(y: NDArray[np.floating], window: int, order: int) -> Array:
    """``scipy.signal.savgol_filter(y, window, order)``: at each sample of ``y`` (N,) the polynomial of ``order`` below
    ``window``, an odd number up to N, through the ``window`` samples about it; near an end, through those at that end.

    By itself, because scipy.signal takes as long to import as some commands compute.

    >>> local_polynomial(np.array([1.0, 2.0, 5.0, 10.0, 17.0]), 3, 2).round(9)
    array([ 1.,  2.,  5., 10., 17.])
    """
    half = window // 2
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, window), order + 1))[0]
    out = np.asarray(scipy.ndimage.correlate1d(y, basis @ basis[half], mode="nearest"))
    out[:half] = (basis @ (basis.T @ y[:window]))[:half]
    out[len(y) - half :] = (basis @ (basis.T @ y[-window:]))[window - half :]
    return out


def long_runs(trace: Array) -> Flags:
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


def clean(name: str, values: Array, noise_K: float = np.inf) -> Array:
    """The samples (N,) with what cannot be as NaN: beyond a million or, in a temperature, beyond type J, and spikes.

    ``noise_K`` tells a spike, see ``course_noise_K``.
    """
    if not name.endswith("_degC"):
        with np.errstate(invalid="ignore"):
            return np.where(np.abs(values) <= 1e6, values, np.nan)
    out = np.where(impossible(values), np.nan, values)
    out[find_spikes(out, SPIKES["reading"], noise_K)] = np.nan
    return out


def course_noise_K(
    name: str, sample: Array, rows: NDArray[np.int64], place: SampleLocation
) -> float:
    """Noise [K] that a spike of this column must stand out of, from its course ``sample`` (M,), found in ``rows`` (M,).

    Infinite where no spikes are sought, or too few samples tell it. Raises InputError for a temperature without
    numbers, for kelvin and for values that no thermocouple gives.
    """
    if not name.endswith("_degC"):
        return np.inf
    finite = sample[np.isfinite(sample)]
    if not len(finite):
        raise InputError(
            f"column {name} holds no numbers",
            where=place.where,
            expected="degrees Celsius",
            column=name,
        )
    low, high = np.quantile(finite, [0.02, 0.98])
    if low > 250.0 and high < 800.0:
        raise InputError(
            f"column {name} lies between {low:.4g} and {high:.4g}: this looks like kelvin",
            where=place.where,
            expected="degrees Celsius",
            remedy=f"call it {name.removesuffix('degC')}K, in the file or in rig.toml [columns]",
        )
    wild = impossible(sample)
    if wild.mean() > MOST_MISSING:
        i = int(np.argmax(wild))
        more = int(wild.sum()) - 1
        raise InputError(
            f"{place.at(name, int(rows[i]))}: {sample[i]:.4g} and {more} more values that no junction has",
            where=place.where,
            expected=f"{COLDEST_DEGC:g} to {HOTTEST_DEGC:g} degC",
            remedy="check the unit and the wiring of this channel",
            column=name,
        )
    told = sample[np.isfinite(sample) & ~wild]
    return (
        float(white_noise_sd(told, 1))
        if place.dt_s is not None and len(told) >= LEAST_TOLD
        else np.inf
    )


def impossible(x: Array) -> Flags:
    """Temperatures (N,) [degC] that no junction has."""
    with np.errstate(invalid="ignore"):
        return np.asarray((x < COLDEST_DEGC) | (x > HOTTEST_DEGC))
