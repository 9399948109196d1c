"""Entry of the disk into the bath: instants of switch, thermocouple, junctions; mean.

Used by :mod:`immersion.plunge_data`, :mod:`immersion.hole` and the workflow of
``tcdyn rig calibrate``. An error of the entry shifts the common lag of all channels, so each source
has a standard uncertainty, and sources that disagree widen it. Thresholds are chosen by judgement
where no other reason is given. Tests: ``tests/immersion/test_immersion_events.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import median_filter, uniform_filter1d

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning

# Standard uncertainties [s], chosen by judgement.
SWITCH_U_S = 0.10  # reaction of the person who presses the switch as the disk enters
PROBE_U_S = 0.05  # delay and position of the free thermocouple
# Differences between switch and probe, over their standard uncertainty; chosen by judgement.
WIDENED_DIFFERENCE_U = 2.0  # beyond: the uncertainty of the entry is widened, with an info
WARNING_DIFFERENCE_U = 4.0  # beyond: a warning
ERROR_DIFFERENCE_U = 6.0  # beyond, and beyond ERROR_DIFFERENCE_S: an error
# Least difference [s] for that error; chosen by judgement.
ERROR_DIFFERENCE_S = 3.0
# Factors on the standard uncertainty of a single source; chosen by judgement.
PROBE_ONLY_FACTOR = 2.0
SWITCH_ONLY_FACTOR = 1.5
# Least readings of the probe; shares of its way where the straight line begins and ends (see
# ``EARLY_SHARE``); time before the jump whose median is the level before [s], and its least
# samples. Chosen by judgement.
MIN_PROBE_SAMPLES = 20
LINE_SHARES = (0.05, 0.5)
LEVEL_BEFORE_S = 10.0
MIN_LEVEL_SAMPLES = 5
# Rows at the ends of the record that give its levels: a 50th of it, and at least so many.
END_PARTS = 50
MIN_END_SAMPLES = 5
MIN_JUMP_K = 3.0  # least change of the free thermocouple at the entry [K]; chosen by judgement
# Share of the way of the junctions to the bath: 0.3 K of 80 K, five standard deviations of a mean
# of six channels over 0.2 s.
RISE_SHARE = 0.004
# Chosen by judgement: a share of the way that noise and drift do not reach. The entry is looked for
# before the first sample above it.
TOP_SHARE = 0.1
SMOOTHING_S = 0.2  # moving average of the junctions' rise [s], the length in RISE_SHARE's comment
# Chosen by judgement: junctions that move by more than this share of RISE_SHARE within the first
# BASELINE_S were already moving, and give no entry.
MAX_DRIFT_SHARE = 0.5
BASELINE_S = (
    1.0  # start of the log [s] for the level before the entry; no entry by a rise within it
)
# Delay of the rise after the entry, and its standard uncertainty [s]: for a chain lag of 0.3 to 1.5
# s.
RISE_DELAY_S = 0.7
RISE_DELAY_U_S = 0.5
# A line through a first-order response meets the level before too early by this share of the time
# from 5 to 50 %.
EARLY_SHARE = 0.0882
EARLY_SHARE_U = 0.05  # its standard uncertainty, for probes of another order; chosen by judgement
BATH_SHARE = (
    0.02  # of the initial difference to the bath: end of the useful record; chosen by judgement
)


@dataclass(frozen=True)
class EntryEvent:
    """Instant of the entry, its standard uncertainty [s], the two instants, and their source.

    Attributes
    ----------
    time_s
        Instant of the entry, in the time of the log [s].
    u_s
        Its standard uncertainty [s].
    switch_s, probe_s
        Instants by the switch and by the free thermocouple [s]; None: none.
    source
        Which sources were used.
    findings
        Warnings and infos about the entry.
    """

    time_s: float
    u_s: float
    switch_s: float | None
    probe_s: float | None
    source: str
    findings: tuple[Finding, ...] = ()


def switch_time(
    time_s: ArrayLike, switch: ArrayLike, hold_off_s: float = 1.0
) -> tuple[float | None, bool]:
    """First closing of a switch.

    Parameters
    ----------
    time_s, switch
        Times (N,) [s], and the switch (N,): 0 open, 1 closed.
    hold_off_s
        Further rises within this time are bounce [s].

    Returns
    -------
    time_s
        Instant [s]; None when the switch never closes.
    bounced
        Whether the switch bounced.

    Notes
    -----
    The event is the first rise through one half, for a switch that stays closed and for a momentary
    one. A rise in a sample happened, on average, half a sample earlier; the function returns that
    time.

    ``hold_off_s`` decides the info about bounce only, not the instant.
    """
    t = np.asarray(time_s, dtype=float)
    closed = np.nan_to_num(np.asarray(switch, dtype=float), nan=0.0) > 0.5
    rises = np.flatnonzero(closed[1:] & ~closed[:-1]) + 1
    if rises.size == 0:
        return None, False
    first = int(rises[0])
    bounced = bool(np.any(t[rises[1:]] - t[first] < hold_off_s))
    return float((t[first - 1] + t[first]) / 2), bounced


def probe_time(
    time_s: ArrayLike, probe_degC: ArrayLike, fluid_degC: ArrayLike | None = None
) -> tuple[float, float] | None:
    """Instant at which the free thermocouple starts its jump into the bath.

    None when it does not jump.

    Parameters
    ----------
    time_s, probe_degC
        Times (N,) [s] and readings (N,) [degC]; NaN is left out.
    fluid_degC
        Bath temperature (N,) [degC]; None: the end of the probe's own record.

    Returns
    -------
    time_s, u_s
        Instant and standard uncertainty [s]; None where the probe does not jump.

    Notes
    -----
    The jump is where the probe passes half of its way. A straight line through the samples from 5
    to 50 % of the way is extrapolated back to the level before. For a first-order probe the line
    meets that level too early, by 0.0882 of the time from 5 to 50 % (0.056 of the time constant);
    this is corrected.

    The level before is the median of ``LEVEL_BEFORE_S`` before the jump. ``EARLY_SHARE`` follows
    from ``LINE_SHARES``; change them together. A probe that moves by less than
    ``MIN_JUMP_K`` gives no instant. Test: ``tests/immersion/test_immersion_events.py``.
    """
    t = np.asarray(time_s, dtype=float)
    y = np.asarray(probe_degC, dtype=float)
    finite = np.isfinite(y)
    if finite.sum() < MIN_PROBE_SAMPLES:
        return None
    t = t[finite]
    y = y[finite]
    smooth = median_filter(y, 3, mode="nearest")
    edge = max(len(y) // END_PARTS, MIN_END_SAMPLES)
    low = float(np.median(smooth[:edge]))
    if fluid_degC is None:
        high = float(np.median(smooth[-edge:]))
    else:
        high = float(np.nanmedian(np.asarray(fluid_degC, dtype=float)))
    step = high - low
    if abs(step) < MIN_JUMP_K:
        return None
    share = (smooth - low) / step
    above_half = np.flatnonzero((share[:-1] >= LINE_SHARES[1]) & (share[1:] >= LINE_SHARES[1]))
    if above_half.size == 0:
        return None
    top = int(above_half[0])
    below = np.flatnonzero(share[:top] < LINE_SHARES[0])
    if below.size == 0:
        return None
    start = int(below[-1])
    before = (t >= t[start] - LEVEL_BEFORE_S) & (t < t[start] - 2 * (t[1] - t[0]))
    level = float(np.median(y[before])) if before.sum() >= MIN_LEVEL_SAMPLES else low
    if top - start < 2:
        return float((t[start] + t[min(start + 1, len(t) - 1)]) / 2), PROBE_U_S
    rows = slice(start, top + 1)
    slope, intercept = np.polyfit(t[rows] - t[start], smooth[rows], 1)
    duration = float(t[top] - t[start])
    u = float(np.hypot(PROBE_U_S, EARLY_SHARE_U * duration))
    if slope * step <= 0:
        return float(t[start]), u
    crossing = t[start] + (level - intercept) / slope + EARLY_SHARE * duration
    return float(np.clip(crossing, t[start] - max(1.0, duration), t[top])), u


def junction_time(
    time_s: ArrayLike, readings_degC: ArrayLike, fluid_degC: ArrayLike
) -> float | None:
    """Instant [s] at which the junctions have moved by ``RISE_SHARE`` toward the bath.

    Parameters
    ----------
    time_s
        Times (N,) [s].
    readings_degC
        Readings of the junctions (N, C).
    fluid_degC
        Bath temperature (N,).

    Returns
    -------
    time_s
        Instant [s]. None if the junctions do not move by ``TOP_SHARE`` of the way, if no sample
        before that is below ``RISE_SHARE``, or if they move by ``MAX_DRIFT_SHARE`` of
        ``RISE_SHARE`` within the first ``BASELINE_S``.

    Notes
    -----
    It is the last time before ``TOP_SHARE`` of the way at which the median over channels, averaged
    over ``SMOOTHING_S``, is below ``RISE_SHARE``. The level before is that of the first
    ``BASELINE_S``.

    :func:`find_entry` subtracts ``RISE_DELAY_S``. If ``RISE_SHARE`` changes, ``RISE_DELAY_S`` must
    change with it: ``tests/immersion/test_immersion_events.py`` and
    ``tests/calibration/test_without_oven.py``.
    """
    t = np.asarray(time_s, dtype=float)
    y = np.asarray(readings_degC, dtype=float)
    dt = float(np.median(np.diff(t)))
    baseline = slice(0, max(int(round(BASELINE_S / dt)), 5))
    level = np.nanmedian(y[baseline], axis=0)
    rise = np.nanmedian(y - level, axis=1)
    finite = np.isfinite(rise)
    filled = np.interp(t, t[finite], rise[finite])
    step = float(np.nanmedian(np.asarray(fluid_degC, dtype=float))) - float(np.nanmedian(level))
    drift = abs(np.polyfit(t[baseline], filled[baseline], 1)[0]) * BASELINE_S
    if drift > MAX_DRIFT_SHARE * RISE_SHARE * abs(step):
        return None
    share = uniform_filter1d(filled, max(int(round(SMOOTHING_S / dt)), 1)) / step
    above = np.flatnonzero(share > TOP_SHARE)
    if above.size == 0:
        return None
    below = np.flatnonzero(share[: above[0]] < RISE_SHARE)
    return float(t[below[-1]]) if below.size else None


def reconcile_entry(
    switch_s: float | None,
    probe_s: float | None,
    *,
    bounced: bool = False,
    switch_u_s: float = SWITCH_U_S,
    probe_u_s: float = PROBE_U_S,
    sample_s: float = 1 / 75,
    where: str = "",
) -> EntryEvent:
    """Mean of two instants, weighted by variance; its u is widened when they disagree.

    Parameters
    ----------
    switch_s, probe_s
        Instants from the switch and from the free thermocouple [s]; None: none.
    bounced
        Whether the switch bounced.
    switch_u_s, probe_u_s
        Their standard uncertainties [s].
    sample_s
        Sampling interval [s].
    where
        File, for messages.

    Returns
    -------
    event
        Entry with its standard uncertainty and the findings.

    Raises
    ------
    InputError
        Without any instant, or when the two contradict each other: beyond 3 s and 6 u_d.

    Notes
    -----
    With d the difference and u_d its standard uncertainty: beyond 2 u_d the u of the result grows
    by |d|/(2 u_d), with an info; beyond ``WARNING_DIFFERENCE_U`` u_d with a warning. One instant
    only gives a warning.

    The quantisation of the sampling interval, dt/sqrt(12), is part of both uncertainties.
    """
    switch_u = float(np.hypot(switch_u_s, sample_s / np.sqrt(12)))
    probe_u = float(np.hypot(probe_u_s, sample_s / np.sqrt(12)))
    findings = [info("entry.bounced", subject="switch")] if bounced else []
    if switch_s is None and probe_s is None:
        raise InputError(
            "no entry found: the switch never closes and the probe never jumps",
            where=where,
            expected="column switch to go to 1, or probe_degC to rise by 3 K or more, at entry",
            remedy="give the entry time by hand",
        )
    if switch_s is None:
        assert probe_s is not None
        findings.append(warning("entry.no_switch", subject="switch"))
        u = PROBE_ONLY_FACTOR * probe_u
        return EntryEvent(probe_s, u, None, probe_s, "probe", tuple(findings))
    if probe_s is None:
        findings.append(warning("entry.no_probe", subject="probe_degC"))
        u = SWITCH_ONLY_FACTOR * switch_u
        return EntryEvent(switch_s, u, switch_s, None, "switch", tuple(findings))
    difference = abs(switch_s - probe_s)
    difference_u = float(np.hypot(switch_u, probe_u))
    if difference > max(ERROR_DIFFERENCE_S, ERROR_DIFFERENCE_U * difference_u):
        raise InputError(
            f"switch and free thermocouple put the entry at {switch_s:.2f} s and {probe_s:.2f} s",
            where=where,
            expected="agreement within 3 s",
            remedy="check which one is wrong: leave out the probe's column, or correct the "
            "switch's (1 from the entry on)",
        )
    weight = switch_u**-2 / (switch_u**-2 + probe_u**-2)
    u = (switch_u**-2 + probe_u**-2) ** -0.5
    if difference > WIDENED_DIFFERENCE_U * difference_u:
        u *= difference / (WIDENED_DIFFERENCE_U * difference_u)
        severity = warning if difference > WARNING_DIFFERENCE_U * difference_u else info
        findings.append(severity("entry.apart", subject="switch", difference_s=difference, u_s=u))
    time = weight * switch_s + (1 - weight) * probe_s
    return EntryEvent(float(time), float(u), switch_s, probe_s, "switch and probe", tuple(findings))


def find_entry(
    time_s: ArrayLike,
    switch: ArrayLike | None,
    probe_degC: ArrayLike | None,
    fluid_degC: ArrayLike | None = None,
    where: str = "",
    readings_degC: ArrayLike | None = None,
) -> EntryEvent:
    """Entry event of a log.

    Switch or probe may be missing (None or all NaN). Without both, the rise of the junctions
    ``readings_degC`` (N, C) gives the entry.

    Parameters
    ----------
    time_s
        Times (N,) [s].
    switch
        Switch (N,), 1 in the bath; None: none.
    probe_degC
        Free thermocouple (N,) [degC]; None: none.
    fluid_degC
        Bath temperature (N,) [degC]; None: not known.
    where
        File, for messages.
    readings_degC
        Readings of the junctions (N, C); None: they are not used.

    Raises
    ------
    InputError
        No source gives an instant, or two contradict each other.
    """
    t = np.asarray(time_s, dtype=float)
    switch_s = None
    bounced = False
    if switch is not None:
        switch_s, bounced = switch_time(t, switch)
    probe = None if probe_degC is None else probe_time(t, probe_degC, fluid_degC)
    probe_s, probe_u_s = probe or (None, PROBE_U_S)
    no_instant = switch_s is None and probe_s is None
    if no_instant and readings_degC is not None and fluid_degC is not None:
        rise_s = junction_time(t, readings_degC, fluid_degC)
        if rise_s is not None:
            by_junctions = warning("entry.by_junctions", subject="switch", u_s=RISE_DELAY_U_S)
            entry_s = rise_s - RISE_DELAY_S
            return EntryEvent(entry_s, RISE_DELAY_U_S, None, None, "junctions", (by_junctions,))
    return reconcile_entry(
        switch_s,
        probe_s,
        bounced=bounced,
        probe_u_s=probe_u_s,
        sample_s=float(np.median(np.diff(t))),
        where=where,
    )


def useful_end(
    time_s: ArrayLike, readings_degC: ArrayLike, fluid_degC: ArrayLike, entry_s: float
) -> float:
    """End of the useful record [s]: disk within 2 % of the bath, removed from it, or last sample.

    Parameters
    ----------
    time_s, readings_degC, fluid_degC
        Times (N,) [s], readings (N, C) and bath temperature (N,) [degC].
    entry_s
        Instant of the entry [s].

    Returns
    -------
    end_s
        End of the useful record [s].

    Notes
    -----
    Removed: the mean reading moves away from the bath by more than 2 % of the initial difference,
    after it was nearer. One-second means reduce the noise.

    A larger ``BATH_SHARE`` shortens the record that is fitted; later samples carry little about the
    lag. Test: ``tests/immersion/test_immersion_events.py``.
    """
    t = np.asarray(time_s, dtype=float)
    y = np.nanmean(np.atleast_2d(np.asarray(readings_degC, dtype=float).T), axis=0)
    difference = np.asarray(fluid_degC, dtype=float) - y
    after = t >= entry_s
    last_s = float(t[-1])
    if after.sum() < 2:
        return last_s
    window = max(int(round(1.0 / float(np.median(np.diff(t))))), 1)
    smooth: Array = np.convolve(difference[after], np.ones(window) / window, mode="valid")
    times = t[after][: len(smooth)] + 0.5
    if smooth.size < 2:
        return last_s
    initial = float(smooth[0])
    share = smooth / initial if initial else smooth
    ends = [last_s]
    within = np.flatnonzero(share < BATH_SHARE)
    if within.size:
        ends.append(float(times[within[0]]))
    least = np.minimum.accumulate(share)
    removed = np.flatnonzero(share > least + BATH_SHARE)
    if removed.size:
        ends.append(float(times[int(np.argmin(share[: removed[0]]))]))
    return min(ends)
