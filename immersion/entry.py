"""When the disk entered the bath: the hand-pressed switch and the free thermocouple, reconciled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import median_filter, uniform_filter1d

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning

SWITCH_U_S = 0.10  # a person pressing a switch as the disk goes in
APART = 4.0  # standard uncertainties
PROBE_U_S = 0.05  # the free thermocouple's own delay and the place it is fixed at
RISEN = (
    0.004  # of a junction's way to the bath: 0.3 K of 80, five noises of a mean of six over 0.2 s
)
HEAD_S = 1.0  # of the log, for the level before the entry: junctions that rise within it tell none
# how long after the entry that is, behind a lag of 0.3 to 1.5 s
LATE_S = 0.7
LATE_U_S = 0.5
EARLY = 0.0882  # of the time from 5 to 50 %: how early a line through a first-order answer meets the level before
EARLY_U = 0.05  # the same for probes of another order: uncertainty


@dataclass(frozen=True)
class EntryEvent:
    """The instant of entry [s] on the record's clock, its standard uncertainty, and what it rests on."""

    time_s: float
    u_s: float
    switch_s: float | None
    probe_s: float | None
    source: str
    findings: tuple[Finding, ...] = ()


def switch_time(
    time_s: ArrayLike, switch: ArrayLike, hold_off_s: float = 1.0
) -> tuple[float | None, bool]:
    """First closing of a switch [s] and whether it bounced; None when it never moved.

    Held or momentary alike: the event is the first rise through one half. Further rises within ``hold_off_s`` are
    bounce. A rise seen in a sample happened, on the average, half a sample earlier: that is the time given back.
    """
    t = np.asarray(time_s, dtype=float)
    on = np.nan_to_num(np.asarray(switch, dtype=float), nan=0.0) > 0.5
    rises = np.flatnonzero(on[1:] & ~on[:-1]) + 1
    if rises.size == 0:
        return None, False
    first = int(rises[0])
    bounced = bool(np.any(t[rises[1:]] - t[first] < hold_off_s))
    return float((t[first - 1] + t[first]) / 2), bounced


def probe_time(
    time_s: ArrayLike, probe_degC: ArrayLike, fluid_degC: ArrayLike | None = None
) -> tuple[float, float] | None:
    """Instant at which the free thermocouple began its jump into the bath, and its standard uncertainty [s].

    None when it never jumps. The jump is found where the probe has covered half of its way; a straight line through
    the samples from 5 to 50 % of the way is carried back to the level before. For a first-order probe the line meets
    the level 0.0882 of that time too early, 0.056 of its time constant, which is put right.
    """
    t = np.asarray(time_s, dtype=float)
    y = np.asarray(probe_degC, dtype=float)
    good = np.isfinite(y)
    if good.sum() < 20:
        return None
    t = t[good]
    y = y[good]
    smooth = median_filter(y, 3, mode="nearest")
    edge = max(len(y) // 50, 5)
    low = float(np.median(smooth[:edge]))
    if fluid_degC is None:
        high = float(np.median(smooth[-edge:]))
    else:
        high = float(np.nanmedian(np.asarray(fluid_degC, dtype=float)))
    step = high - low
    if abs(step) < 3.0:
        return None
    way = (smooth - low) / step
    half = np.flatnonzero((way[:-1] >= 0.5) & (way[1:] >= 0.5))
    if half.size == 0:
        return None
    top = int(half[0])
    below = np.flatnonzero(way[:top] < 0.05)
    if below.size == 0:
        return None
    start = int(below[-1])
    before = t >= t[start] - 10.0
    before &= t < t[start] - 2 * (t[1] - t[0])
    level = float(np.median(y[before])) if before.sum() >= 5 else low
    if top - start < 2:
        return float((t[start] + t[min(start + 1, len(t) - 1)]) / 2), PROBE_U_S
    rows = slice(start, top + 1)
    slope, intercept = np.polyfit(t[rows] - t[start], smooth[rows], 1)
    rise = float(t[top] - t[start])
    u = float(np.hypot(PROBE_U_S, EARLY_U * rise))
    if slope * step <= 0:
        return float(t[start]), u
    met = t[start] + (level - intercept) / slope + EARLY * rise
    return float(np.clip(met, t[start] - max(1.0, rise), t[top])), u


def rise_time(time_s: ArrayLike, readings_degC: ArrayLike, fluid_degC: ArrayLike) -> float | None:
    """Instant at which the junctions (N, C) have come ``RISEN`` of their way to the bath [s]; None where they do not.

    The median of all, as means over a fifth of a second, was below that for the last time before a tenth of the way.
    The level before is that of the first ``HEAD_S``; None, too, where the junctions come half of ``RISEN`` within it.
    """
    t = np.asarray(time_s, dtype=float)
    y = np.asarray(readings_degC, dtype=float)
    dt = float(np.median(np.diff(t)))
    head = slice(0, max(int(round(HEAD_S / dt)), 5))
    level = np.nanmedian(y[head], axis=0)
    rise = np.nanmedian(y - level, axis=1)
    good = np.isfinite(rise)
    whole = np.interp(t, t[good], rise[good])
    step = float(np.nanmedian(np.asarray(fluid_degC, dtype=float))) - float(np.nanmedian(level))
    if abs(np.polyfit(t[head], whole[head], 1)[0]) * HEAD_S > 0.5 * RISEN * abs(step):
        return None
    way = uniform_filter1d(whole, max(int(round(0.2 / dt)), 1)) / step
    above = np.flatnonzero(way > 0.1)
    below = np.flatnonzero(way[: above[0]] < RISEN) if above.size else above
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
    """One instant from two witnesses, weighted by their variances; the uncertainty is widened when they disagree.

    With d the difference and u_d its standard uncertainty: beyond 2 u_d the result's u grows by |d|/(2 u_d), which is
    noted, and beyond ``APART`` u_d to be looked at; beyond 3 s (and 6 u_d) they contradict each other and InputError is
    raised. One witness alone serves, with a warning.
    """
    su = float(np.hypot(switch_u_s, sample_s / np.sqrt(12)))
    pu = float(np.hypot(probe_u_s, sample_s / np.sqrt(12)))
    found = [info("entry.bounced", subject="switch")] if bounced else []
    if switch_s is None and probe_s is None:
        raise InputError(
            "no entry found: the switch never closes and the probe never jumps",
            where=where,
            expected="column switch to go to 1, or probe_degC to rise by 3 K or more, at entry",
            remedy="give the entry time by hand",
        )
    if switch_s is None:
        assert probe_s is not None
        found.append(warning("entry.no_switch", subject="switch"))
        return EntryEvent(probe_s, 2 * pu, None, probe_s, "probe", tuple(found))
    if probe_s is None:
        found.append(warning("entry.no_probe", subject="probe_degC"))
        return EntryEvent(switch_s, 1.5 * su, switch_s, None, "switch", tuple(found))
    difference = abs(switch_s - probe_s)
    u_difference = float(np.hypot(su, pu))
    if difference > max(3.0, 6 * u_difference):
        raise InputError(
            f"switch and free thermocouple put the entry at {switch_s:.2f} s and {probe_s:.2f} s",
            where=where,
            expected="agreement within 3 s",
            remedy="see which one is wrong: leave out the probe's column, or write the switch's (1 from the entry on)",
        )
    weight = su**-2 / (su**-2 + pu**-2)
    u = (su**-2 + pu**-2) ** -0.5
    if difference > 2 * u_difference:
        u *= difference / (2 * u_difference)
        far = difference > APART * u_difference
        found.append(
            (warning if far else info)(
                "entry.apart", subject="switch", difference_s=difference, u_s=u
            )
        )
    time = weight * switch_s + (1 - weight) * probe_s
    return EntryEvent(float(time), float(u), switch_s, probe_s, "switch and probe", tuple(found))


def find_entry(
    time_s: ArrayLike,
    switch: ArrayLike | None,
    probe_degC: ArrayLike | None,
    fluid_degC: ArrayLike | None = None,
    where: str = "",
    readings_degC: ArrayLike | None = None,
) -> EntryEvent:
    """The entry event of a log; either witness may be missing (None or all NaN), or both where readings tell it."""
    t = np.asarray(time_s, dtype=float)
    moved, bounced = (None, False) if switch is None else switch_time(t, switch)
    jumped = None if probe_degC is None else probe_time(t, probe_degC, fluid_degC)
    probe_s, probe_u_s = jumped or (None, PROBE_U_S)
    sample_s = float(np.median(np.diff(t)))
    if moved is None and jumped is None and readings_degC is not None and fluid_degC is not None:
        begun = rise_time(t, readings_degC, fluid_degC)
        if begun is not None:
            said = warning("entry.by_junctions", subject="switch", u_s=LATE_U_S)
            return EntryEvent(begun - LATE_S, LATE_U_S, None, None, "junctions", (said,))
    return reconcile_entry(
        moved, probe_s, bounced=bounced, probe_u_s=probe_u_s, sample_s=sample_s, where=where
    )


def useful_end(
    time_s: ArrayLike, readings_degC: ArrayLike, fluid_degC: ArrayLike, entry_s: float
) -> float:
    """End of the useful record [s]: the disk within 2 % of the bath, or taken out of it, or the record's last sample.

    ``readings_degC`` (N, C). Taken out: the mean reading falls away from the bath by more than 2 % of the initial
    difference after having come nearer; noise is put down by one-second means.
    """
    t = np.asarray(time_s, dtype=float)
    y = np.nanmean(np.atleast_2d(np.asarray(readings_degC, dtype=float).T), axis=0)
    gap = np.asarray(fluid_degC, dtype=float) - y
    after = t >= entry_s
    if after.sum() < 2:
        return float(t[-1])
    window = max(int(round(1.0 / float(np.median(np.diff(t))))), 1)
    kernel = np.ones(window) / window
    smooth = np.convolve(gap[after], kernel, mode="valid")
    times = t[after][: len(smooth)] + 0.5
    if smooth.size < 2:
        return float(t[-1])
    start = float(smooth[0])
    share = smooth / start if start else smooth
    reached = np.flatnonzero(share < 0.02)
    best = np.minimum.accumulate(share)
    left = np.flatnonzero(share > best + 0.02)
    ends = [float(t[-1])]
    if reached.size:
        ends.append(float(times[reached[0]]))
    if left.size:
        ends.append(float(times[int(np.argmin(share[: left[0]]))]))
    return min(ends)
