"""One plunge as data of the fit: despiked, cut, averaged in blocks of growing length; its noise.

:func:`run_from_log` and :func:`make_blocks` prepare a log for the plunge fit; ``RunNoise`` holds
the noise with which the fit weights the blocks. Also used by :mod:`immersion.hole` and the design
of plunges. Short blocks near the entry keep the information about the lag; long blocks later save
time. Thresholds are chosen by judgement where no other reason is given. Tests:
``tests/immersion/test_plunge_run.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from immersion.entry import EntryEvent, find_entry, useful_end
from immersion.fluids import Fluid, fluid
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation import autocorrelation_factor
from tcdyn.estimation.trace_noise import SPIKES, find_spikes, white_noise_sd
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.log import Log
from tcdyn.rig.static_line import StaticLine, smallest_uncertainty
from tcdyn.series.clock import mean_interval_s

# Least record before the entry and after it [s]; chosen by judgement.
MIN_BEFORE_S = 0.5
MIN_AFTER_S = 10.0
SHORTEST_BLOCK_S = 0.02  # shortest block, from samples at 100 Hz or faster; chosen by judgement
# Around the entry blocks are short from this long before it, and until this long after it; earlier
# ones have the second length [s]. Chosen by judgement.
SHORT_BLOCKS_S = 1.0
EARLY_BLOCK_S = 1.0
BLOCK_GROWTH = 0.03  # growth of the block length over the time since the entry; chosen by judgement
HUBER_LIMIT = 4.0  # standardised residual beyond which a block loses weight (Huber); by judgement
MIN_FACTOR = 0.25  # least variance factor; chosen by judgement
# Parameters of the fit that the residuals of one run determine: common ones, and differential ones
# per channel.
COMMON_PARAMETERS = 9
PARAMETERS_PER_CHANNEL = 3


@dataclass(frozen=True)
class PlungeRun:
    """One immersion log after the static lines.

    Attributes
    ----------
    time_s
        Times (N,) [s].
    readings_degC
        Readings (N, C) in the order of ``channels``.
    channels
        Names of the channels.
    fluid
        Fluid of the bath.
    fluid_degC
        Bath temperature (N,).
    entry
        Entry of the disk.
    name
        Name of the log, for messages.
    lines
        Static lines that were applied, with their covariance.
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
        """Temperature of least uncertainty of each static line (C,), about which its slope errs.

        0 for a channel without a line.
        """
        pivots = [
            smallest_uncertainty(self.lines[c])[0] if c in self.lines else 0.0
            for c in self.channels
        ]
        return np.array(pivots)

    @property
    def dt_s(self) -> float:
        """Sampling interval [s]."""
        return mean_interval_s(self.time_s)


@dataclass(frozen=True)
class PlungeBlocks:
    """Block means of a plunge.

    Attributes
    ----------
    time_s
        Mean times after the nominal entry (B,) [s].
    readings_degC
        Mean readings (B, C).
    count
        Samples in each mean (B, C).
    noise_sd_K
        White noise of one sample (C,) [K].
    bath_time_s, bath_degC
        Bath temperature, to be interpolated linearly (W,).
    duration_s
        Last time after the entry [s].
    spikes
        Number of spikes that were removed.
    """

    time_s: Array
    readings_degC: Array
    count: Array
    noise_sd_K: Array
    bath_time_s: Array
    bath_degC: Array
    duration_s: float
    spikes: int


def with_filled_bath(log: Log) -> pd.DataFrame:
    """The frame of a log with gaps of the bath and the free probe interpolated linearly.

    Gaps of the junctions stay NaN: an interpolation across the first seconds of a plunge is no
    reading, and block means leave missing samples out.
    """
    return log.interpolate_missing().assign(**{name: log.frame[name] for name in log.channels})


def run_from_log(
    frame: pd.DataFrame,
    fluid_name: str | Fluid,
    lines: Mapping[str, StaticLine] | None = None,
    *,
    channels: tuple[str, ...] = CHANNELS,
    entry: EntryEvent | None = None,
    name: str = "plunge",
) -> PlungeRun:
    """A run from an immersion log.

    Parameters
    ----------
    frame
        Canonical columns time_s, switch, probe_degC, fluid_degC, a_degC .. f_degC. NaN is a missing
        sample, which the block means leave out.
    fluid_name
        Fluid of the bath, or its name.
    lines
        Static lines by channel, applied to the channels that have one.
    channels
        Channels to use.
    entry
        Entry; None: found from switch and probe, or from the readings where both are missing.
    name
        Name of the log, for messages.

    Raises
    ------
    InputError
        For missing columns, no entry, or a bath and disk of one temperature.
    """
    required = ["time_s", "fluid_degC", *(f"{c}_degC" for c in channels)]
    missing = [column for column in required if column not in frame.columns]
    if missing:
        raise InputError(f"column {missing[0]} is missing", where=name, expected="an immersion log")
    lines = lines or {}
    numbers = {c: frame[c].to_numpy(dtype=float) for c in frame.columns if c in required}
    t = numbers["time_s"]
    bath = numbers["fluid_degC"]
    readings = np.column_stack([numbers[f"{c}_degC"] for c in channels])
    for j, channel in enumerate(channels):
        if channel in lines:
            readings[:, j] = lines[channel].gain * readings[:, j] + lines[channel].offset
    if entry is None:
        switch = frame["switch"].to_numpy(dtype=float) if "switch" in frame.columns else None
        probe = frame["probe_degC"].to_numpy(dtype=float) if "probe_degC" in frame.columns else None
        entry = find_entry(t, switch, probe, bath, name, readings)
    substance = fluid(fluid_name) if isinstance(fluid_name, str) else fluid_name
    return PlungeRun(t, readings, channels, substance, bath, entry, name, lines)


def make_blocks(run: PlungeRun, before_s: float = 5.0, longest_s: float = 2.0) -> PlungeBlocks:
    """Despike, cut and average a run.

    Parameters
    ----------
    run
        The run.
    before_s
        Time before the entry that is used [s].
    longest_s
        Longest block [s]. Blocks near the entry are two samples long (at least 0.02 s); their
        length grows by 3 % of the time since.

    Returns
    -------
    blocks
        Block means of readings and bath.

    Raises
    ------
    InputError
        When there is too little before or after the entry.

    Notes
    -----
    ``before_s`` and ``longest_s`` may be changed; longer blocks lose information about fast
    changes. The model of a run covers the record of its blocks
    (:func:`immersion.plunge_model.build_run_models`). Test: ``tests/immersion/test_plunge_run.py``.
    """
    t = run.time_s - run.entry.time_s
    filled = pd.DataFrame(run.readings_degC).interpolate(limit_direction="both").to_numpy()
    end = useful_end(run.time_s, filled, run.fluid_degC, run.entry.time_s) - run.entry.time_s
    if t[0] > -MIN_BEFORE_S or end < MIN_AFTER_S:
        raise InputError(
            f"the record runs from {t[0]:.1f} s to {end:.1f} s around the entry",
            where=run.name,
            expected="half a second before it and 10 s after it, at least",
            remedy="log from before the disk goes in until it is warm, or leave this plunge out",
        )
    used = (t >= max(-before_s, t[0])) & (t <= end)
    times = t[used]
    clean, spikes = without_spikes(run.readings_degC[used])
    centre, mean, count = make_averages(times, clean, run.dt_s, longest_s)
    bath_time, bath = smooth_bath(t, run.fluid_degC, end)
    return PlungeBlocks(
        centre, mean, count, white_noise_sd(clean), bath_time, bath, float(times[-1]), spikes
    )


def make_averages(
    times: Array, values: Array, dt_s: float, longest_s: float
) -> tuple[Array, Array, Array]:
    """Block means of ``values`` (N, C), NaN left out.

    Parameters
    ----------
    times
        Times (N,) [s], rising, 0 at the entry.
    values
        Values (N, C).
    dt_s
        Sampling interval [s].
    longest_s
        Longest block [s].

    Returns
    -------
    centre, mean, count
        Mean time (B,), mean (B, C) and number of samples (B, C). Where a channel has no sample in a
        block, the count is 0 and the mean is interpolated between the blocks next to it.

    Notes
    -----
    Blocks have ``EARLY_BLOCK_S`` until ``SHORT_BLOCKS_S`` before the entry, then two samples, at
    least ``SHORTEST_BLOCK_S``; from ``SHORT_BLOCKS_S`` after the entry they grow by
    ``BLOCK_GROWTH`` of the time since. A larger growth gives fewer blocks.
    """
    shortest_s = max(2 * dt_s, SHORTEST_BLOCK_S)
    edges = [float(times[0]) - dt_s / 2]
    while edges[-1] < -SHORT_BLOCKS_S:
        is_last = edges[-1] >= -SHORT_BLOCKS_S - 0.5 * EARLY_BLOCK_S
        length_s = np.inf if is_last else EARLY_BLOCK_S
        edges.append(min(edges[-1] + length_s, -SHORT_BLOCKS_S))
    while edges[-1] < times[-1] + dt_s / 2:
        length_s = shortest_s + BLOCK_GROWTH * max(edges[-1] - SHORT_BLOCKS_S, 0.0)
        edges.append(edges[-1] + min(length_s, longest_s))
    index = np.searchsorted(edges, times, side="right")
    blocks = pd.DataFrame(values).groupby(index)
    centre = pd.Series(times).groupby(index).mean().to_numpy()
    mean = blocks.mean().set_axis(centre).interpolate("index", limit_direction="both")
    return np.asarray(centre), np.asarray(mean), np.asarray(blocks.count(), dtype=float)


def without_spikes(values: Array) -> tuple[Array, int]:
    """Readings (N, C) with NaN in place of spikes, and the number of spikes.

    Parameters
    ----------
    values
        Readings (N, C) [degC].

    Returns
    -------
    readings
        (N, C), with NaN in place of spikes.
    spikes
        Number of spikes.

    Notes
    -----
    The limits are ``SPIKES["plunge"]`` of :mod:`tcdyn.estimation.trace_noise`. A lower limit can
    remove steps of a coarse logger: ``tests/immersion/test_plunge_run.py``.
    """
    noise = np.maximum(white_noise_sd(values), 1e-9)
    spikes = [find_spikes(y, SPIKES["plunge"], sd) for y, sd in zip(values.T, noise)]
    mask = np.stack(spikes, axis=1)
    return np.where(mask, np.nan, values), int(np.count_nonzero(mask))


def smooth_bath(t: Array, bath: Array, end_s: float, window_s: float = 10.0) -> tuple[Array, Array]:
    """Bath temperature after the entry, to be interpolated linearly.

    Parameters
    ----------
    t
        Times after the entry (N,) [s].
    bath
        Bath temperature (N,) [degC].
    end_s
        End of the useful record [s].
    window_s
        Length of each mean [s]; its lowest and highest fifth are left out.

    Returns
    -------
    times, means
        (W,) each, [s] and [degC].

    Raises
    ------
    InputError
        Without a bath temperature after the entry.
    """
    after = (t >= 0) & (t <= end_s) & np.isfinite(bath)
    if not np.any(after):
        raise InputError(
            "fluid_degC holds no value after the entry", remedy="log the bath's temperature"
        )
    frame = pd.DataFrame({"t": t[after], "bath": bath[after]})
    windows = frame.groupby(np.floor(t[after] / window_s))
    means = windows["bath"].agg(_trimmed_mean)
    return windows["t"].mean().to_numpy(), means.to_numpy()


def _trimmed_mean(x: pd.Series) -> float:
    """Mean without the lowest and the highest fifth."""
    cut = len(x) // 5
    return float(np.sort(x)[cut : len(x) - cut].mean())


@dataclass(frozen=True)
class RunNoise:
    """Noise of one plunge.

    Attributes
    ----------
    sd_K
        Standard deviation of one sample (C,) [K].
    weight
        Weight of each block (B, C): 1, or less for outliers.
    common, differential
        Factors on the variance of the mean over channels and of the deviations from it, for
        coloured residuals; 1 for white noise.
    """

    sd_K: Array
    weight: Array
    common: float = 1.0
    differential: float = 1.0

    @classmethod
    def white(cls, blocks: PlungeBlocks) -> RunNoise:
        """White noise, from the scatter of neighbouring samples."""
        return cls(blocks.noise_sd_K, np.ones(blocks.readings_degC.shape))

    @classmethod
    def from_residuals(cls, residual_K: Array, count: Array) -> RunNoise:
        """Noise estimated from the residuals of a fit.

        Parameters
        ----------
        residual_K
            Residuals of the block means (B, C) [K].
        count
            Samples in each block (B, C).

        Notes
        -----
        The standard deviation of a channel is a robust one (median absolute deviation), then the
        root mean square of the residuals within 4 of it. Blocks beyond 4 standard deviations lose
        weight (Huber).

        ``COMMON_PARAMETERS`` and ``PARAMETERS_PER_CHANNEL`` set the degrees of freedom; change them
        with the parameters of :mod:`immersion.plunge_parameters`. ``HUBER_LIMIT`` decides which
        blocks lose weight. Test: ``tests/immersion/test_plunge_run.py``.
        """
        c = residual_K.shape[1]
        scaled = residual_K * np.sqrt(count)
        robust_sd = 1.4826 * np.median(np.abs(scaled), axis=0)
        inside = np.abs(scaled) < HUBER_LIMIT * np.maximum(robust_sd, 1e-12)
        total = np.sum(np.where(inside, scaled**2, 0.0), axis=0)
        mean_square = total / np.maximum(inside.sum(axis=0), 1)
        n_parameters = COMMON_PARAMETERS + PARAMETERS_PER_CHANNEL * c
        freedom_share = max(1 - n_parameters / residual_K.size, 0.5)
        sd = np.sqrt(np.maximum(mean_square, 1e-12) / freedom_share)
        z = residual_K / block_sd(sd, count)
        weight = np.minimum(1.0, HUBER_LIMIT / np.maximum(np.abs(z), 1e-12))
        common, differential = variance_factors(
            z * np.sqrt(weight), COMMON_PARAMETERS, PARAMETERS_PER_CHANNEL * c
        )
        return cls(sd, weight, common, differential)


def block_sd(noise_sd_K: Array, count: Array) -> Array:
    """Standard deviation of block means (B, C) for white noise; infinite without samples.

    Parameters
    ----------
    noise_sd_K
        White noise of one sample (C,) [K].
    count
        Samples in each block (B, C).

    Returns
    -------
    sd
        (B, C) [K].
    """
    return np.where(count > 0, noise_sd_K / np.sqrt(np.maximum(count, 1)), np.inf)


def variance_factors(
    standardised: Array, parameters_common: int, parameters_differential: int
) -> tuple[float, float]:
    """Variance factors of coloured residuals: of the mean over channels and of the deviations.

    Parameters
    ----------
    standardised
        Standardised residuals (B, C) of one run.
    parameters_common, parameters_differential
        Numbers of parameters that each part determines.

    Returns
    -------
    common, differential
        Factors on the variance of the mean over channels, and of the deviations from it; the second
        is one for one channel.

    Notes
    -----
    The two factors are separate because an error of the bath or of h moves all channels together,
    and noise does not. Each factor is the mean square times the correlation length; at least one
    quarter.

    ``MIN_FACTOR`` keeps a lucky fit from giving an uncertainty that is too small. Test:
    ``tests/immersion/test_plunge_run.py``.
    """
    b, c = standardised.shape
    mean = np.mean(standardised, axis=1)
    deviation = standardised - mean[:, None]
    common = (
        c * float(np.sum(mean**2)) / max(b - parameters_common, 1) * autocorrelation_factor(mean)
    )
    if c == 1:
        return max(common, MIN_FACTOR), 1.0
    freedom = max((b * (c - 1)) - parameters_differential, 1)
    length = float(np.mean([autocorrelation_factor(column) for column in deviation.T]))
    differential = float(np.sum(deviation**2)) / freedom * length
    return max(common, MIN_FACTOR), max(differential, MIN_FACTOR)
