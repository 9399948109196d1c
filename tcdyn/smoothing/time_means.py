"""Means of the temperature over some time, with the covariance between its samples.

Where single rows are not determined behind a slow sensor, means over a longer time are. Used by
:func:`tcdyn.smoothing.smooth`. Guarded by ``tests/smoothing/test_time_means.py``, which compares
with dense algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain.chain import integral_index, with_integral
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation.kalman import smooth_points
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.mean_values import FEWEST_ROWS, SAME_LENGTH, TimeMeans, even_rows_s
from tcdyn.smoothing.noise_levels import level_noise_at
from tcdyn.smoothing.record import Compensated, FollowedLag, Record
from tcdyn.smoothing.state_space import Smoothed, channel_ranges, point_models

# The shortest time whose means are determined, in place of a number of seconds
AUTO: Literal["auto"] = "auto"


@dataclass(frozen=True)
class MeanTimes:
    """Times over which means are wanted.

    Parameters
    ----------
    length_s
        Length of each [s]; ``AUTO``: the shortest that is determined in all channels.
    start_s
        Start of the first one on the clock of the record [s].
    rows
        Samples (R,) that have a row; None: all. A mean stands at the row next to its middle.
    """

    length_s: float | Literal["auto"]
    start_s: float = 0.0
    rows: NDArray[np.intp] | None = None

    @classmethod
    def of(cls, means: float | str | MeanTimes) -> MeanTimes:
        """From what a caller gives: a number of seconds, or auto.

        Raises
        ------
        InputError
            For anything else.

        Examples
        --------
        >>> MeanTimes.of("60").length_s
        60.0
        """
        if isinstance(means, MeanTimes):
            return means
        if means == AUTO:
            return cls(AUTO)
        try:
            length_s = float(means)
        except ValueError:
            length_s = np.nan
        if not 0 < length_s < np.inf:
            raise InputError(
                f"means over {means!r}",
                expected=f"a number of seconds, or {AUTO}",
                parameters={"means": "60"},
            )
        return cls(length_s)

    def length_in(self, record: Record, resolution_s: Array | None) -> float:
        """Length of each time [s] in a record.

        Parameters
        ----------
        record
            The record.
        resolution_s
            Shortest time (M,) [s] whose means are determined, of each channel.

        Raises
        ------
        InputError
            If it is asked for, and no mean of any channel is determined.
        """
        if self.length_s != AUTO:
            return self.length_s
        determined_s = [] if resolution_s is None else resolution_s[np.isfinite(resolution_s)]
        return length_of_rows(determined_s, record.dt_s)


def length_of_rows(resolutions_s: Sequence[float] | Array, dt_s: float) -> float:
    """Length [s] of an even number of rows in which the means of all channels are determined.

    Parameters
    ----------
    resolutions_s
        Shortest times whose means are determined, of the channels that have one [s].
    dt_s
        Time from row to row [s].

    Raises
    ------
    InputError
        Where no channel has one.

    Examples
    --------
    >>> length_of_rows([2.0, 4.5], 1.0)
    6.0
    """
    if not len(resolutions_s):
        raise InputError(
            "no mean over a third of the record or less is determined",
            expected="a number of seconds, or a longer record",
            parameters={"means": AUTO},
        )
    return even_rows_s(max(resolutions_s), dt_s)


def check_length(length_s: float, dt_s: float) -> None:
    """Raise InputError for means over less than ``FEWEST_ROWS`` rows, ``dt_s`` [s] apart."""
    if round(0.5 * length_s / dt_s) < 1:
        raise InputError(
            f"means over {length_s:.4g} s, but rows are {dt_s:.4g} s apart",
            expected=f"{FEWEST_ROWS * dt_s:.4g} s or more",
            parameters={"means": "SECONDS"},
        )


def middles_of(
    times: MeanTimes, length_s: float, record: Record
) -> tuple[NDArray[np.intp], NDArray[np.intp], int]:
    """Samples in the middle of the times that fit into a record, and half of their length.

    Parameters
    ----------
    times
        Which times are wanted.
    length_s
        Their length [s].
    record
        The record of N samples.

    Returns
    -------
    middle
        Index (W,) of the samples in the middle, ``2 half`` apart.
    row
        Index (W,) of the sample with a row that is next to each. Times without any row, and those
        whose middle is not between two rows, are left out.
    half
        Number of samples from the middle to each end.

    Raises
    ------
    InputError
        For a time that is too short.
    """
    dt_s = record.dt_s
    count = len(record.y)
    check_length(length_s, dt_s)
    half = round(0.5 * length_s / dt_s)
    first = times.start_s / dt_s
    first_number = np.ceil(-first / (2 * half) - SAME_LENGTH)
    number = np.arange(first_number, (count - first) / (2 * half))
    middle = np.round(first + (2 * number + 1) * half).astype(np.intp)
    middle = middle[(middle >= half) & (middle + half < count)]
    rows = np.arange(count) if times.rows is None else np.unique(times.rows)
    middle = middle[(middle >= rows[0]) & (middle <= rows[-1])]
    after = np.clip(np.searchsorted(rows, middle), 1, len(rows) - 1)
    is_before = middle - rows[after - 1] <= rows[after] - middle
    row = np.where(is_before, rows[after - 1], rows[after])
    has_row = np.abs(row - middle) < half
    return middle[has_row], row[has_row], half


def time_means(
    fit: Smoothed,
    result: Compensated,
    times: MeanTimes,
    length_s: float,
    above_corner_var: Array | float = 0.0,
) -> TimeMeans:
    """Means of a smoothed record, with their standard deviation.

    Parameters
    ----------
    fit
        The smoothed record.
    result
        The result that was made from it, with all contributions to its uncertainty.
    times
        Which times are wanted.
    length_s
        Their length [s].
    above_corner_var
        The part (N, M) of the variance of ``result`` [K2] from frequencies above the corner of the
        smoother: see ``tcdyn.smoothing.unresolved.unresolved_var``, and
        ``tcdyn.smoothing.roughness.intensity_var``, since an intensity decides where the corner is.

    Notes
    -----
    The integral of the temperature is one more state of the model, so that the variance of a mean
    is exact for the noise and the intensities. Errors above the corner frequency w remain in a mean
    over the time L with the share 2 / (w L)^2 of their variance, the mean of sin^2(x) / x^2 with
    x = w L / 2. What else ``result`` adds to the variance of its samples is taken as correlated in
    time like their error by noise. Errors that are one for the whole record
    (lag, its division, times of events, static line) are averaged with their sign.
    """
    middle, row, half = middles_of(times, length_s, fit.record)
    edges = np.unique(np.concatenate([middle - half, middle + half]))
    start = np.searchsorted(edges, middle - half)
    levels, of_fit, covariance_next = _integrals(fit, edges, start)

    def mean_of(values: Array) -> Array:
        """Means (W, M) of values at the samples (N, M): half of the first and the last one."""
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        whole = total[middle + half + 1] - total[middle - half]
        ends = 0.5 * (values[middle - half] + values[middle + half])
        return np.asarray((whole - ends) / (2 * half))

    # results are those at the times of the readings, integrals those between even times
    mean = levels + mean_of(result.temperature - fit.level[fit.own])
    above_corner = np.broadcast_to(above_corner_var, result.sd.shape)
    sample_var = np.maximum(result.noise_sd_of_rows() ** 2 - above_corner, 0.0)
    fit_var = fit.var[0, fit.own]
    scale = mean_of(sample_var) / np.maximum(mean_of(fit_var), 1e-300)
    remaining = np.minimum(2 / (_corners_rad_s(fit) * 2 * half * fit.record.dt_s) ** 2, 1.0)
    noise_var = of_fit * scale + mean_of(above_corner * remaining)
    lag_sensitivity = mean_of(result.lag_sensitivity)
    lag_var = lag_sensitivity**2 * np.diag(result.lag_covariance)
    record_var = lag_var + mean_of(result.lag_split_K) ** 2 + mean_of(result.static_u) ** 2
    record_var = record_var + sum(mean_of(shift) ** 2 for shift in result.shift_K)
    return TimeMeans(
        2 * half * fit.record.dt_s,
        middle,
        row,
        mean,
        np.sqrt(noise_var + record_var),
        np.sqrt(noise_var),
        covariance_next * np.sqrt(scale[:-1] * scale[1:]),
        lag_sensitivity,
    )


def _corners_rad_s(fit: Smoothed) -> Array:
    """Corner frequency (N, M) [rad/s] of the smoother for level noise, at the samples."""
    time_s = fit.times_s[fit.sample]
    columns = []
    for chain, noise_var, q in zip(fit.record.chains, fit.noise_var.tolist(), fit.intensities):
        (level_noise,) = level_noise_at([q], time_s)
        ratio = level_noise / (noise_var * fit.record.dt_s)
        columns.append(corner_rad_s(chain, np.maximum(ratio, 1e-300), order=1))
    return np.stack(columns, axis=1)


def _integrals(
    fit: Smoothed, edges: NDArray[np.intp], start: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Means of the smoothed temperature between some samples.

    Parameters
    ----------
    fit
        The smoothed record.
    edges
        Samples (E,) at which times start or end.
    start
        Index (W,) in ``edges`` of the start of each; it ends at the next one.

    Returns
    -------
    mean, var
        Mean (W, M) [degC] and its variance [K2].
    covariance_next
        Covariance (W - 1, M) [K2] with the next mean; NaN where that does not follow at once.
    """
    record = fit.record
    integrated = replace(
        record,
        sensors=tuple(with_integral(sensor) for sensor in record.sensors),
        followed=tuple(None if lag is None else _with_integral(lag) for lag in record.followed),
        start=None,
    )
    span = channel_ranges(record)
    shape = (len(start), len(fit.intensities))
    mean, var = np.empty((2, *shape))
    covariance_next = np.full((max(shape[0] - 1, 0), shape[1]), np.nan)
    follows = np.diff(start) == 1
    for c, q in enumerate(fit.intensities):
        noise_var = float(fit.noise_var[c])
        points, (model,) = point_models(integrated, c, noise_var, [q], float(span[c]))
        is_edge = np.zeros(len(points.time_s), dtype=bool)
        is_edge[points.sample[edges]] = True
        row = np.zeros(len(model.mean))
        row[integral_index(record.sensors[c])] = 1.0
        smoothed = smooth_points(model._replace(is_mark=is_edge), row[None], change_row=row)
        length_s = np.diff(points.time_s[is_edge])
        mean[:, c] = (np.diff(smoothed.extra[is_edge, 0]) / length_s)[start]
        change_var = smoothed.change_var[is_edge]
        one_var = change_var[:-1, 0] / length_s**2
        var[:, c] = one_var[start]
        both_s = length_s[:-1] * length_s[1:]
        both_independent = change_var[:-2, 0] + change_var[1:-1, 0]
        covariance = 0.5 * (change_var[:-2, 1] - both_independent) / both_s
        covariance_next[follows, c] = covariance[start[:-1][follows]]
    return mean, var, covariance_next


def _with_integral(followed: FollowedLag) -> FollowedLag:
    """A lag that follows another column, with the integral of the temperature as a state."""
    return replace(followed, sensors=tuple(with_integral(each) for each in followed.sensors))
