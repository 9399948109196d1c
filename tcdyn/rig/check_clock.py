"""Check the time stamps of a log, and resample temperatures where the stamps jitter.

The checks cover repeated, missing and rounded stamps, gaps, lost samples, and stamps that scatter
about an even grid (timing jitter).

:func:`check_time` is used by :mod:`tcdyn.rig.log`; :func:`sample_interval_s` by most users of a
log. Thresholds are chosen by judgement where no other reason is given. Tests:
``tests/rig/test_check_clock.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, info_or_warning, warning
from tcdyn.series import MIN_STRAY, Clock, at_grid_times, fit_clock, real_share

# Longest gap [s] that is bridged; the content of a longer one is unknown. Chosen by judgement.
MAX_GAP_S = 0.5
# Longest sample interval [s]: slower traces hold no information about lags. Chosen by judgement.
MAX_INTERVAL_S = 1.0
# Slowest sampling [s] that gives no warning (20 Hz). Chosen by judgement.
SLOW_INTERVAL_S = 0.05
# Share of steps that are not one grid interval long above which there is no common rate. Chosen by
# judgement: half a log at a third of the rate of the other half has more.
MAX_UNEVEN_SHARE = 0.2
MIN_ROWS = 10  # of a log; chosen by judgement
# Scatter of rounded stamps, in sample intervals, from which a finding says that the clock has few
# decimals. No result depends on it.
COARSE_ROUNDING = 0.1


@dataclass(frozen=True)
class Sampling:
    """Times of a log and their even grid.

    Parameters
    ----------
    time_s
        Time of each row, (N,) [s].
    dt_s
        Sample interval [s].
    grid
        Index of each row on the even grid, (N,). Rows may share an index where stamps jitter.
    findings
        Findings about the time column.
    clock
        The clock of the rows.
    late_s
        How much later than its grid time each sample was taken, (N,) [s]; None where the stamps do
        not stray.
    """

    time_s: Array
    dt_s: float
    grid: NDArray[np.int32]
    findings: tuple[Finding, ...]
    clock: Clock
    late_s: Array | None = None


def check_time(time: Array, location: SampleLocation) -> Sampling:
    """Check the time column of a log and find its sampling.

    Single missing values are interpolated. Stamps that stray by more than ``MIN_STRAY``, or are
    rounded (0.013, 0.027, 0.040 at 75 Hz), are replaced by the times of the grid.

    Parameters
    ----------
    time
        Time as logged, (N,) [s].
    location
        Position of the rows in the file, for messages.

    Returns
    -------
    sampling
        Times, sample interval, grid and findings.

    Raises
    ------
    InputError
        Time repeats or runs backward (row, time), a gap above 0.5 s, uneven sampling, milliseconds,
        or too few rows.

    Notes
    -----
    ``tcdyn.series.fit_clock`` finds interval and grid; this function says what a log of the rig
    may not have. Test: ``tests/rig/test_check_clock.py``.
    """
    where = location.where
    if len(time) < MIN_ROWS:
        raise InputError(
            f"only {len(time)} rows", where=where, expected=f"at least {MIN_ROWS} samples in time"
        )
    time, findings = _fill_missing(time, location)
    step = np.diff(time)
    _check_rising(time, step, location)
    clock = fit_clock(time)
    dt = clock.interval_s
    _check_rate_and_gaps(time, step, dt, location)
    intervals = np.diff(clock.index)
    is_uneven = intervals != 1
    if is_uneven.mean() > MAX_UNEVEN_SHARE:
        raise InputError(
            f"column time_s, row {location.row(int(np.argmax(is_uneven)) + 1)}: sampling is uneven "
            f"({step.min():.4g} to {step.max():.4g} s)",
            where=where,
            expected="one sampling rate",
            remedy="log at one rate, or resample first",
        )
    if not clock.strays and clock.stray_s > COARSE_ROUNDING * dt:
        findings.append(info("time.few_decimals", subject="time_s", rate_Hz=1 / dt))
    findings += _lost_samples(time, intervals, location)
    if dt > SLOW_INTERVAL_S:
        findings.append(warning("time.slow", subject="time_s", rate_Hz=1 / dt, lost_s=2 * dt))
    late_s = clock.jitter_s if clock.strays else None
    grid = clock.index.astype(np.int32)
    if clock.stray_s > MIN_STRAY * dt:
        time = clock.even_s
    return Sampling(time, dt, grid, tuple(findings), clock, late_s)


def _check_rising(time: Array, step: Array, location: SampleLocation) -> None:
    """Raise InputError where time repeats or runs backward.

    Parameters
    ----------
    time, step
        Times (N,) [s] and their steps (N - 1,) [s].
    location
        Position of the rows in the file, for messages.
    """
    is_wrong = ~(step > 0)
    if not is_wrong.any():
        return
    i = int(np.argmax(step <= 0))
    repeats = step[i] == 0
    count = int((step <= 0).sum())
    verb = "repeats" if repeats else "runs backward"
    what = (
        f"column time_s, row {location.row(i + 1)}: time {verb} "
        f"({time[i]:.6g} s, then {time[i + 1]:.6g} s)"
    )
    if count > 1:
        what += f", and in {count - 1} more rows"
    remedy = "sort the rows, or give the clock more decimals" if repeats else "repair the rows"
    raise InputError(
        what, where=location.where, expected="time that rises from row to row", remedy=remedy
    )


def _check_rate_and_gaps(time: Array, step: Array, dt: float, location: SampleLocation) -> None:
    """Raise InputError for sampling slower than 1 Hz and for gaps.

    Parameters
    ----------
    time, step
        Times (N,) [s] and their steps (N - 1,) [s].
    dt
        Sample interval [s].
    location
        Position of the rows in the file, for messages.

    Notes
    -----
    Change ``MAX_GAP_S`` together with ``tcdyn.rig.check_columns.MAX_MISSING_RUN_S``, the longest
    run of missing values. A step of three intervals is always allowed.
    """
    if dt > MAX_INTERVAL_S:
        is_milliseconds = dt * 1e-3 < 0.2
        hint = "; this looks like milliseconds" if is_milliseconds else ""
        raise InputError(
            f"column time_s: the sample interval is {dt:.4g} s{hint}",
            where=location.where,
            expected="seconds, sampled faster than 1 Hz (75 Hz on the rig)",
        )
    gap = int(np.argmax(step))
    if step[gap] > max(MAX_GAP_S, 3 * dt):
        raise InputError(
            f"column time_s, row {location.row(gap + 1)}: {step[gap]:.4g} s are missing at "
            f"{time[gap]:.6g} s",
            where=location.where,
            expected=f"gaps of at most {MAX_GAP_S} s",
            remedy="cut the log there and use one part",
        )


def _lost_samples(
    time: Array, intervals: NDArray[np.int32], location: SampleLocation
) -> list[Finding]:
    """A finding about samples missing from the grid, or none.

    Parameters
    ----------
    time
        Times (N,) [s].
    intervals
        Steps on the grid (N - 1,).
    location
        Position of the rows in the file, for messages.
    """
    is_gap = intervals > 1
    lost = int((intervals[is_gap] - 1).sum())
    if not lost:
        return []
    first = int(np.argmax(is_gap))
    finding = info_or_warning(
        lost / len(time),
        "time.lost",
        subject="time_s",
        row=location.row(first + 1),
        count=lost,
        places=int(is_gap.sum()),
        first_s=float(time[first]),
    )
    return [finding]


def resample_to_grid(name: str, values: Array, sampling: Sampling, rows: slice) -> Array:
    """Temperatures at the even times; other columns, and logs without jitter, come back unchanged.

    Each sample is shifted along the slope of a straight line through its neighbours, missing ones
    left out. This keeps white noise white and increases it by 1 %.

    Parameters
    ----------
    name
        Name of the column.
    values
        Samples of the column at ``rows``, (N,).
    sampling
        Sampling of the log, with the jitter.
    rows
        Rows of the file that ``values`` hold.

    Returns
    -------
    values
        (N,), at the even times.

    Notes
    -----
    Test: ``tests/rig/test_check_clock.py`` (compensation loses little).
    """
    if sampling.late_s is None or not name.endswith("_degC"):
        return values
    return at_grid_times(values, sampling.time_s[rows], sampling.late_s[rows])


def scale_jitter(sampling: Sampling, sample: pd.DataFrame) -> Sampling:
    """Keep that share of the jitter that the temperatures confirm, and report it.

    The remaining share belongs to the stamps only, not to the samples.

    Parameters
    ----------
    sampling
        Sampling of the log.
    sample
        Cleaned columns; the index holds the rows of the file.
    """
    if sampling.late_s is None:
        return sampling
    names = [name for name in sample if str(name).endswith("_degC")]
    rows = sample.index.to_numpy()
    columns = [sample[name].to_numpy() for name in names]
    share = real_share(sampling.clock, columns, rows).value
    finding = info(
        "time.strays",
        subject="time_s",
        stray_s=float(np.std(sampling.late_s)),
        percent=100 * share,
        rate_Hz=1 / sampling.dt_s,
    )
    return replace(sampling, late_s=share * sampling.late_s, findings=(*sampling.findings, finding))


def sample_interval_s(time_s: Array) -> float:
    """Sampling interval [s] of even times (N,).

    The mean step is used: stamps may be rounded, and then the median of the steps is rounded, too.

    >>> round(75 * sample_interval_s(np.round(np.arange(10.0) / 75, 3)), 9)
    1.0
    """
    return float(time_s[-1] - time_s[0]) / (len(time_s) - 1)


def _fill_missing(time: Array, location: SampleLocation) -> tuple[Array, list[Finding]]:
    """Interpolate up to three single missing stamps; InputError for more, or for two in a row.

    Parameters
    ----------
    time
        Times as logged (N,) [s].
    location
        Position of the rows in the file, for messages.

    Returns
    -------
    time
        (N,) without missing values.
    findings
        An info if a stamp was interpolated.
    """
    missing = ~np.isfinite(time)
    if not missing.any():
        return time, []
    first = int(np.argmax(missing))
    count = int(missing.sum())
    at_an_end = missing[0] or missing[-1]
    if count > 3 or at_an_end or (missing[1:] & missing[:-1]).any():
        raise InputError(
            f"{location.at('time_s', first)}: {count} times are missing",
            where=location.where,
            expected="a time in each row",
        )
    index = np.arange(len(time))
    time = np.interp(index, index[~missing], time[~missing])
    return time, [info("time.filled", subject="time_s", row=location.row(first), count=count)]
