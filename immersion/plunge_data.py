"""One plunge as the fit takes it: despiked, cut to its useful part, averaged in blocks that widen; and its noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from immersion.entry import EntryEvent, find_entry, useful_end
from immersion.fluids import Fluid, fluid
from tcdyn.core.errors import InputError
from tcdyn.estimation import correlation_length
from tcdyn.estimation.trace_noise import SPIKES, find_spikes, white_noise_sd
from tcdyn.rig.check_clock import interval_s
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.log import Log
from tcdyn.rig.static_line import StaticLine, best_known

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlungeRun:
    """One immersion log after the static lines: ``readings_degC`` (N, C) in the order of ``channels``.

    ``fluid_degC`` (N,) is the bath; ``lines`` are those that were applied, with what is known of them.
    """

    time_s: Array
    readings_degC: Array
    channels: tuple[str, ...]
    fluid: Fluid
    fluid_degC: Array
    entry: EntryEvent
    name: str = "plunge"
    lines: Mapping[str, StaticLine] = field(default_factory=dict)

    @property
    def pivot_degC(self) -> Array:
        """Where the static line of each channel (C,) is best known, and its slope turns; 0 without a line."""
        return np.array(
            [best_known(self.lines[c])[0] if c in self.lines else 0.0 for c in self.channels]
        )

    @property
    def dt_s(self) -> float:
        """Sampling interval [s]."""
        return interval_s(self.time_s)


@dataclass(frozen=True)
class PlungeBlocks:
    """A plunge in blocks: mean time after the nominal entry (B,), mean readings (B, C), samples in each (B, C)."""

    time_s: Array
    readings_degC: Array
    count: Array
    noise_sd_K: Array
    bath_time_s: Array
    bath_degC: Array
    duration_s: float
    spikes: int


def bath_filled(log: Log) -> pd.DataFrame:
    """The log's frame, its bath and free probe bridged by straight lines; junctions keep their gaps as NaN.

    A line across the first seconds of a plunge is no reading: block means leave out what is missing.
    """
    return log.filled().assign(**{name: log.frame[name] for name in log.channels})


def run_from_log(
    frame: pd.DataFrame,
    fluid_name: str | Fluid,
    lines: Mapping[str, StaticLine] | None = None,
    *,
    channels: tuple[str, ...] = CHANNELS,
    entry: EntryEvent | None = None,
    name: str = "plunge",
) -> PlungeRun:
    """A run from an immersion log's canonical columns (time_s, switch, probe_degC, fluid_degC, a_degC .. f_degC).

    NaN is a missing sample, left out of the block means. Static ``lines`` are applied to the channels that have one.
    The entry is found from switch and probe, or where both are missing from the readings, unless given.
    Raises InputError for missing columns, no entry, or a bath and disk of one temperature.
    """
    missing = [
        c
        for c in ("time_s", "fluid_degC", *(f"{k}_degC" for k in channels))
        if c not in frame.columns
    ]
    if missing:
        raise InputError(f"column {missing[0]} is missing", where=name, expected="an immersion log")
    t = frame["time_s"].to_numpy(dtype=float)
    readings = np.column_stack([frame[f"{k}_degC"].to_numpy(dtype=float) for k in channels])
    for j, k in enumerate(channels):
        if lines is not None and k in lines:
            readings[:, j] = lines[k].gain * readings[:, j] + lines[k].offset
    bath = frame["fluid_degC"].to_numpy(dtype=float)
    if entry is None:
        switch = frame["switch"].to_numpy(dtype=float) if "switch" in frame.columns else None
        probe = frame["probe_degC"].to_numpy(dtype=float) if "probe_degC" in frame.columns else None
        entry = find_entry(t, switch, probe, bath, name, readings)
    substance = fluid(fluid_name) if isinstance(fluid_name, str) else fluid_name
    return PlungeRun(t, readings, channels, substance, bath, entry, name, lines or {})


def make_blocks(run: PlungeRun, before_s: float = 5.0, longest_s: float = 2.0) -> PlungeBlocks:
    """Despike, cut and average a run.

    Blocks are two samples long near entry (0.02 s at least), then 3 % of the time since longer, at most
    ``longest_s``. Raises InputError when there is too little before or after the entry.
    """
    t = run.time_s - run.entry.time_s
    bridged = pd.DataFrame(run.readings_degC).interpolate(limit_direction="both").to_numpy()
    end = useful_end(run.time_s, bridged, run.fluid_degC, run.entry.time_s) - run.entry.time_s
    if t[0] > -0.5 or end < 10.0:
        raise InputError(
            f"the record runs from {t[0]:.1f} s to {end:.1f} s around the entry",
            where=run.name,
            expected="half a second before it and 10 s after it, at least",
            remedy="log from before the disk goes in until it is warm, or leave this plunge out",
        )
    keep = (t >= max(-before_s, t[0])) & (t <= end)
    times = t[keep]
    values = run.readings_degC[keep]
    clean, spikes = without_spikes(values)
    centre, mean, count = make_averages(times, clean, run.dt_s, longest_s)
    bath_t, bath = smooth_bath(t, run.fluid_degC, end)
    return PlungeBlocks(
        centre, mean, count, white_noise_sd(clean), bath_t, bath, float(times[-1]), spikes
    )


def make_averages(
    times: Array, values: Array, dt_s: float, longest_s: float
) -> tuple[Array, Array, Array]:
    """Block means of ``values`` (N, C), NaN left out: mean time (B,), mean (B, C), samples in each (B, C).

    A block without a sample of a channel counts 0 there, and its mean is only a line between its neighbours.
    """
    short = max(2 * dt_s, 0.02)
    edges = [float(times[0]) - dt_s / 2]
    while edges[-1] < -1.0:
        edges.append(min(edges[-1] + 1.0, -1.0) if edges[-1] < -1.5 else -1.0)
    while edges[-1] < times[-1] + dt_s / 2:
        edges.append(edges[-1] + min(short + 0.03 * max(edges[-1] - 1.0, 0.0), longest_s))
    index = np.searchsorted(edges, times, side="right")
    blocks = pd.DataFrame(values).groupby(index)
    centre = pd.Series(times).groupby(index).mean().to_numpy()
    mean = blocks.mean().set_axis(centre).interpolate("index", limit_direction="both")
    return np.asarray(centre), np.asarray(mean), np.asarray(blocks.count(), dtype=float)


def without_spikes(values: Array) -> tuple[Array, int]:
    """Readings (N, C) with NaN for spikes, and how many there were."""
    noise = np.maximum(white_noise_sd(values), 1e-9)
    bad = np.stack([find_spikes(y, SPIKES["plunge"], sd) for y, sd in zip(values.T, noise)], axis=1)
    return np.where(bad, np.nan, values), int(np.count_nonzero(bad))


def smooth_bath(t: Array, bath: Array, end_s: float, window_s: float = 10.0) -> tuple[Array, Array]:
    """The bath's temperature [degC] after entry, to be joined by straight lines: times (W,) [s] and means (W,).

    ``t`` (N,) is the time after entry [s]; each mean is over ``window_s``, its lowest and highest fifth left out.
    """
    after = (t >= 0) & (t <= end_s) & np.isfinite(bath)
    if not np.any(after):
        raise InputError(
            "fluid_degC holds no value after the entry", remedy="log the bath's temperature"
        )
    bins = pd.DataFrame({"t": t[after], "bath": bath[after]}).groupby(np.floor(t[after] / window_s))
    middle = bins["bath"].agg(lambda x: np.sort(x)[(cut := len(x) // 5) : len(x) - cut].mean())
    return bins["t"].mean().to_numpy(), middle.to_numpy()


@dataclass(frozen=True)
class RunNoise:
    """Noise of one plunge: of a sample (C,) [K], weights (B, C), 1 or less for outlying blocks, and variance factors.

    ``common`` and ``differential`` widen the variance of the residuals' mean over channels and of their deviations
    from it, for residuals that are coloured; 1 for white noise.
    """

    sd_K: Array
    weight: Array
    common: float = 1.0
    differential: float = 1.0

    @classmethod
    def white(cls, blocks: PlungeBlocks) -> RunNoise:
        """As the samples scatter about their neighbours."""
        return cls(blocks.noise_sd_K, np.ones(blocks.readings_degC.shape))

    @classmethod
    def judged(cls, residual_K: Array, count: Array) -> RunNoise:
        """From what a fit leaves of block means (B, C) of ``count`` samples.

        The sd of a channel is robust, then scaled to a mean square. Blocks further off than 4 standard deviations lose
        weight (Huber).
        """
        c = residual_K.shape[1]
        scaled = residual_K * np.sqrt(count)
        sd = 1.4826 * np.median(np.abs(scaled), axis=0)
        inside = np.abs(scaled) < 4 * np.maximum(sd, 1e-12)
        square = np.sum(np.where(inside, scaled**2, 0.0), axis=0) / np.maximum(
            inside.sum(axis=0), 1
        )
        sd = np.sqrt(np.maximum(square, 1e-12) / max(1 - (9 + 3 * c) / residual_K.size, 0.5))
        z = residual_K / block_sd(sd, count)
        weight = np.minimum(1.0, 4.0 / np.maximum(np.abs(z), 1e-12))
        return cls(sd, weight, *inflation(z * np.sqrt(weight), 9, 3 * c))


def block_sd(noise_sd_K: Array, count: Array) -> Array:
    """Standard deviation of block means (B, C) for white noise; infinite where a block holds no sample."""
    return np.where(count > 0, noise_sd_K / np.sqrt(np.maximum(count, 1)), np.inf)


def inflation(
    standardised: Array, parameters_common: int, parameters_differential: int
) -> tuple[float, float]:
    """Variance factors, common and differential, of standardised residuals (B, C) of one run; at least one quarter.

    The mean over channels and the deviations from it are judged apart, because an error of the bath or of h moves
    all channels together and noise does not. Each factor is a mean square times a correlation length.
    """
    b, c = standardised.shape
    mean = np.mean(standardised, axis=1)
    rest = standardised - mean[:, None]
    common = c * float(np.sum(mean**2)) / max(b - parameters_common, 1) * correlation_length(mean)
    if c == 1:
        return max(common, 0.25), 1.0
    freedom = max((b * (c - 1)) - parameters_differential, 1)
    lengths = float(np.mean([correlation_length(column) for column in rest.T]))
    return max(common, 0.25), max(float(np.sum(rest**2)) / freedom * lengths, 0.25)
