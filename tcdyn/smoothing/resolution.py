"""The shortest time whose mean a smoothed record determines.

Used by :mod:`tcdyn.smoothing.smoother`. Guarded by ``tests/smoothing/test_time_means.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.smoothing.noise_levels import Intensity, level_noise_at
from tcdyn.smoothing.record import MIN_RANGE_SD, Record
from tcdyn.smoothing.state_space import channel_ranges

# Share of the variance of the difference between a mean and its neighbours that the readings must
# explain: then a usual difference is twice its standard uncertainty (coverage factor 2, GUM 6.2).
DETERMINED = 0.8
# Share of the record in which means of that time are determined
OF_RECORD = 0.95
# Numbers of frequencies, lengths and times: a finer grid changes the result by less than 1 %.
FREQUENCIES = 1500
LENGTHS = 80
TIMES = 300
# Lowest and highest frequency [rad/s], over the longest and the shortest length: beyond them an
# error hardly contributes to means and their changes.
SLOWEST = 0.01
FASTEST = 100.0
# Intensities that differ by less than this logarithm are taken as one: a time changes by less than
# 7 % with them, because it goes with the fourth root at most.
SAME_INTENSITY = 0.25


def resolved_s(
    record: Record, noise_var: Array, intensities: tuple[Intensity, ...], variance_ratio: Array
) -> Array:
    """Shortest time (M,) [s] whose means are determined in nearly all of a smoothed record.

    Parameters
    ----------
    record
        The record of N samples.
    noise_var
        Noise variance of each channel (M,) [K2].
    intensities
        Intensity of each channel.
    variance_ratio
        Variance of a row over that by noise and intensities alone (M,), typically.

    Returns
    -------
    Array
        At least the time from row to row; infinite where no mean of a third of the record is
        determined.

    Notes
    -----
    A mean over the time L is determined if the readings explain ``DETERMINED`` of the variance
    that its difference from the average of its two neighbours has by the intensities alone, or if
    its standard deviation is below that of the noise of a reading; and as a row, if its standard
    deviation is not above the range of the readings. See ``MeanSpectra.explained_share``.
    """
    duration_s = record.dt_s * (len(record.y) - 1)
    time_s = np.linspace(0.0, duration_s, min(TIMES, len(record.y)))
    lengths_s = np.geomspace(record.dt_s, max(duration_s / 3, 2 * record.dt_s), LENGTHS)
    means = MeanSpectra.of(lengths_s)
    noise_sd = np.sqrt(noise_var)
    largest_var = np.maximum(channel_ranges(record), MIN_RANGE_SD * noise_sd) ** 2
    shortest_s = np.empty(len(intensities))
    for c, (chain, intensity) in enumerate(zip(record.chains, intensities)):
        slope_noise = np.asarray(intensity.at(time_s), dtype=float)
        (level_noise,) = level_noise_at([intensity], time_s)
        pairs, counts = _distinct(slope_noise, level_noise)
        density = float(noise_var[c]) * record.dt_s
        share, mean_var = means.explained_share(chain, density, pairs)
        is_determined = (share >= DETERMINED) | (variance_ratio[c] * mean_var <= noise_var[c])
        is_determined &= mean_var <= largest_var[c]
        first_s = lengths_s[np.argmax(is_determined, axis=1)]
        of_pairs = np.where(is_determined.any(axis=1), first_s, np.inf)
        order = np.argsort(of_pairs)
        reached = np.cumsum(counts[order]) >= OF_RECORD * counts.sum()
        shortest_s[c] = of_pairs[order][np.argmax(reached)]
    return shortest_s


def _distinct(slope_noise: Array, level_noise: Array) -> tuple[Array, Array]:
    """Pairs (K, 2) of intensities (T,) that differ, and how often each occurs (K,)."""
    both = np.stack([slope_noise, level_noise], axis=1)
    is_zero = both <= 0
    steps = np.round(np.log(np.where(is_zero, 1.0, both)) / SAME_INTENSITY)
    rounded = np.where(is_zero, 0.0, np.exp(steps * SAME_INTENSITY))
    pairs, counts = np.unique(rounded, axis=0, return_counts=True)
    return pairs, counts.astype(float)


@dataclass(frozen=True)
class MeanSpectra:
    """Responses of means over some times at some frequencies.

    Parameters
    ----------
    lengths_s
        Lengths L (L,) of the means [s].
    w
        Angular frequencies (W,) [rad/s].
    of_mean, of_change
        Squares (L, W) of the response of a mean, and of m1 - 2 m2 + m3 of three neighbouring ones,
        times the width of each frequency over pi.
    """

    lengths_s: Array
    w: Array
    of_mean: Array
    of_change: Array

    @classmethod
    def of(cls, lengths_s: Array) -> MeanSpectra:
        """The responses of means over some times (L,) [s]."""
        w = np.geomspace(SLOWEST / lengths_s.max(), FASTEST / lengths_s.min(), FREQUENCIES)
        half_turn = 0.5 * w * lengths_s[:, None]
        width = np.gradient(w) / np.pi
        of_mean = np.sinc(half_turn / np.pi) ** 2 * width
        return cls(lengths_s, w, of_mean, of_mean * 16 * np.sin(half_turn) ** 4)

    def explained_share(
        self, chain: Chain, density: float, intensities: Array
    ) -> tuple[Array, Array]:
        """What readings tell about means over the times.

        Parameters
        ----------
        chain
            The chain, with frequency response G.
        density
            Spectral density R of the noise: its variance times the time from row to row [K2 s].
        intensities
            Pairs (K, 2) of the intensities q [K2/s3] and p [K2/s] of the noise that drives slope
            and level.

        Returns
        -------
        share
            Share (K, L) of the prior variance of m1 - 2 m2 + m3 that the readings explain, for
            three neighbouring means.
        mean_var
            Variance (K, L) of the error of a mean [K2].

        Notes
        -----
        The temperature has the spectrum S = q / w^4 + p / w^2, and its error given all readings
        S R / (S |G|^2 + R). A mean has the response sinc(w L / 2), and the difference of three of
        them 4 sin^2(w L / 2) more. The prior variance is 11/20 q L^3 + p L in closed form.

        Examples
        --------
        >>> means = MeanSpectra.of(np.array([0.1, 10.0]))
        >>> share, _ = means.explained_share(Chain(10.0), 0.01, np.array([[0.0, 1.0]]))
        >>> share.round(2).tolist()
        [[0.0, 0.99]]
        """
        slope_noise, level_noise = intensities.T[:, :, None]
        w = self.w
        gain = np.abs(chain.frequency_response(w / (2 * np.pi))) ** 2
        signal = slope_noise / w**4 + level_noise / w**2
        error = signal * density / (signal * gain + density)
        mean_var = error @ self.of_mean.T
        change_var = error @ self.of_change.T
        prior_var = 11 / 20 * slope_noise * self.lengths_s**3 + level_noise * self.lengths_s
        share = 1 - change_var / np.maximum(prior_var, 1e-300)
        return np.maximum(share, 0.0), mean_var
