"""Loading and unloading of an EHL test, from contact switch, friction and load; the test itself.

The contact interval is decided by majority from contact switch, load and friction; the instant of
unloading is refined by :mod:`tcdyn.partition.unloading`. ``EhlTest`` holds a prepared test and is
the input of all of :mod:`tcdyn.partition`. ``find_events`` is used by :mod:`tcdyn.workflows` and
:mod:`tcdyn.campaign.stages`. Thresholds are chosen by judgement. Guarded by
``tests/partition/test_events.py`` and ``tests/partition/test_as_logged.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import fast_nanmedian, interpolate_gaps
from tcdyn.partition.angular_harmonic import AngularHarmonic
from tcdyn.partition.unloading import NEAR_S, unloading_instant
from tcdyn.rig.contact import (
    LINEAR_FALL_SHARE,
    MIN_ZERO_SAMPLES,
    NO_FRICTION_CORRECTION,
    Events,
    FrictionCorrection,
)
from tcdyn.smoothing.traces import DiskTraces

# Durations [s], chosen by judgement.
SHORTEST_CONTACT_S = 20.0  # a shorter contact is a touch, not a test
BOUNCE_S = 0.5  # longest interruption of the contact that counts as a bounce
RELOADED_S = 5.0  # a bounce must be followed by a contact of this length
LOADING_AGREE_S = 0.2  # the switch is believed within this of the forces, plus the following
LOADING_AGREE_REL = 0.1  # the same, relative to the time in which the force rises
TOUCH_S = 0.04  # shortest later touch
# A shorter fall is one change of slope: behind a lag its two ends cannot be separated.
MIN_TWO_SLOPE_CHANGES_S = 0.5
# A force is used if its two levels differ by this many standard deviations of its noise.
MIN_FORCE_SNR = 6.0
HYSTERESIS = 0.1  # about the middle between the levels, relative to their difference
# The switch is inverted if it disagrees in this fraction of the samples in which the forces agree.
INVERTED_FRACTION = 0.8
# Levels at which a later touch begins, and that it must reach, relative to the difference.
TOUCH_START = 0.05
TOUCH_MIN_PEAK = 0.15
NOISE_WIDTH = 5  # of the median filter that removes the noise of a force [samples]
LEVEL_WIDTH = 51  # of the median filter that gives its levels [samples]
LEVEL_ITERATIONS = 5  # of the levels; chosen by judgement


@dataclass(frozen=True)
class DiskAir:
    """Air temperature T_A of one disk.

    Parameters
    ----------
    faces, surface
        Temperature at its faces and at its running surface, (N,) [degC].
    own_u_K
        Standard uncertainty of their means, by how the disk's channels differ [K].
    """

    faces: Array
    surface: Array
    own_u_K: float = 0.0


@dataclass(frozen=True)
class EhlTest:
    """An EHL test ready for the fits; arrays of shape (N,) at even times.

    Parameters
    ----------
    time_s, dt_s
        Times, and their interval.
    events
        Loading and unloading.
    power_W
        Total frictional power F u_s.
    ambient_degC
        Ambient temperature.
    load_N, friction_N
        Means under load.
    speed_ratio
        u_f / u_s of the surface speeds under load.
    sliding_speed_m_s
        u_f - u_s, (2.1).
    entraining_speed_m_s
        Mean of both speeds, (2.2).
    half_width_m
        Half-width of the flux.
    speed_exponent, exponent_half_range
        Exponent n of the speed law, and how far n may lie from it.
    disks
        Traces of each disk.
    findings
        Findings of the preparation.
    added_friction
        The part of ``friction_N`` that the transducer did not measure.
    relative_speed
        Surface speed of each disk that did not keep it after the unloading, relative to that under
        load, (N,).
    surface_air_offset_K
        Offset of the air at the running surface, and its change by the speed exponent, (N, 2); see
        :func:`tcdyn.partition.cooling.with_slowing_air_offset`.
    harmonics
        First circumferential harmonic of each disk, where it is not the default prior.
    friction_noise_N
        White noise of a logged sample of the friction, before it was smoothed.
    air
        Air temperatures of each disk that has channels for them, in place of ``ambient_degC``.
    constants_u
        The part of the disks' ``friction_rel``, ``half_width_rel`` and ``ambient_K`` that
        ``[constants]`` states: the uncertainty of this log, not of the rig.
    """

    time_s: Array
    dt_s: float
    events: Events
    power_W: Array
    ambient_degC: Array
    load_N: float
    friction_N: float
    speed_ratio: float
    sliding_speed_m_s: float
    entraining_speed_m_s: float
    half_width_m: float
    speed_exponent: float
    exponent_half_range: float
    disks: Mapping[str, DiskTraces]
    findings: tuple[Finding, ...]
    added_friction: FrictionCorrection = NO_FRICTION_CORRECTION
    relative_speed: Mapping[str, Array] = field(default_factory=dict)
    surface_air_offset_K: Mapping[str, Array] = field(default_factory=dict)
    harmonics: Mapping[str, AngularHarmonic] = field(default_factory=dict)
    friction_noise_N: float = 0.0
    air: Mapping[str, DiskAir] = field(default_factory=dict)
    constants_u: Mapping[str, float] = field(default_factory=dict)

    @property
    def conditions(self) -> dict[str, float]:
        """Operating conditions and times, as in ``beta.json``."""
        return {
            "load_N": self.load_N,
            "friction_N": self.friction_N,
            "sliding_speed_m_s": self.sliding_speed_m_s,
            "entraining_speed_m_s": self.entraining_speed_m_s,
            "half_width_m": self.half_width_m,
            "load_on_s": self.events.load_on_s,
            "unload_s": self.events.unload_s,
        }

    def ambient_of(self, disk: str) -> Array:
        """Air temperature at a disk's faces, (N,) [degC]: its own channels, else ambient.

        Without both it is the air of its channels at the running surface.
        """
        return self.air[disk].faces if disk in self.air else self.ambient_degC


def find_events(frame: pd.DataFrame, where: str = "the log") -> Events:
    """Find loading and unloading of an EHL log, to better than a sample where possible.

    Parameters
    ----------
    frame
        Columns ``time_s`` and, as far as they were logged, ``contact``, ``load_N``, ``friction_N``.
    where
        Name of the log in error messages.

    Raises
    ------
    InputError
        If there is no contact, or no unloading.

    Notes
    -----
    The contact interval is decided by majority from contact switch, load and friction. The
    friction's fall through half its level gives the end of the heat between the samples, averaged
    with switch and load cell where they agree.

    The thresholds of this module may change; ``tests/partition/test_events.py`` has late, inverted,
    bouncing and stuck switches, noisy forces and later touches. A slow unloading has two slope
    changes; ``tcdyn.partition.cooling.smooth_traces`` takes them as known.
    """
    t = frame["time_s"].to_numpy(dtype=float)
    switch = _switch_state(frame)
    levels = {
        c: _scaled_force(frame[c].to_numpy(dtype=float))
        for c in ("load_N", "friction_N")
        if c in frame
    }
    force_votes = sum(
        (np.sign(_above(x, 0.5, HYSTERESIS) - 0.5) for x in levels.values() if x is not None),
        np.zeros(len(t)),
    )
    contact = force_votes > 0 if switch is None else switch
    if not contact.any():
        raise InputError(
            "neither load nor friction shows a loaded stretch and an unloading",
            where=where,
            expected="a log of the whole test, through the cooling",
            remedy="is this a log of an unloaded run, or does it end under load?",
        )
    findings: list[Finding] = []
    forces_agree = np.abs(force_votes) > 1.5
    if forces_agree.any():
        disagreement = np.mean(contact[forces_agree] != (force_votes[forces_agree] > 0))
        if disagreement > INVERTED_FRACTION:
            contact = ~contact
            findings.append(warning("contact.inverted", subject="contact"))
    first, last = _contact_interval(t, contact, force_votes, switch is not None, where)
    if switch is not None:
        findings += _switch_findings(t, contact, first, last)
    force = levels.get("friction_N")
    if force is None:
        force = levels.get("load_N")
    load_on_s, switch_off, late_s = _loading_instant(
        t, None if switch is None else contact, force, first, last
    )
    if late_s is not None:
        findings.append(warning("loading.disagree", subject="contact", late_s=late_s))
    touches = _later_touches(t, contact, levels, last)
    switch_s = _between_samples(t, switch_off)
    vote_s = _between_samples(t, last)
    about_s = switch_s if abs(switch_s - vote_s) <= NEAR_S else vote_s
    unload, u, fall_s, unloading_findings = unloading_instant(
        t,
        _without_touches(frame, [*levels], touches),
        None if switch is None else switch_s,
        about_s,
        float(load_on_s),
    )
    findings += unloading_findings
    half_s = 0.5 * fall_s / LINEAR_FALL_SHARE  # of a straight fall
    unloading_ends_s = (
        [unload] if 2 * half_s < MIN_TWO_SLOPE_CHANGES_S else [unload - half_s, unload + half_s]
    )
    unload_end_s = unloading_ends_s[-1]
    again = tuple(
        (float(max(t[a], unload_end_s)), float(t[b])) for a, b in touches if t[b] > unload_end_s
    )
    if again:
        findings.append(
            info(
                "contact.again",
                count=len(again),
                after_s=again[0][0] - unload,
                length_s=sum(b - a for a, b in again),
            )
        )
    slope_changes_s = tuple(
        float(x) for x in (*unloading_ends_s, *(x for touch in again for x in touch))
    )
    return Events(
        float(load_on_s),
        float(unload),
        float(u),
        float(fall_s),
        slope_changes_s,
        tuple(findings),
        again,
    )


def _between_samples(t: Array, row: int) -> float:
    """Time halfway from a row to the next one."""
    return 0.5 * float(t[row] + t[min(row + 1, len(t) - 1)])


def _contact_interval(
    t: Array, contact: NDArray[np.bool_], force_votes: Array, has_switch: bool, where: str
) -> tuple[int, int]:
    """First and last row of the longest contact, by majority.

    Parameters
    ----------
    t
        Times, (N,) [s].
    contact
        State of the switch, or of the forces without one, (N,).
    force_votes
        Sum of the votes of the forces, -1 or 1 each, (N,).
    has_switch
        Whether there is a switch, for the error message.
    where
        Name of the log in error messages.

    Returns
    -------
    first, last
        Rows.

    Raises
    ------
    InputError
        If the log ends under load, or the contact is shorter than ``SHORTEST_CONTACT_S``.
    """
    intervals = _intervals(t, force_votes + (contact - 0.5) > 0)
    first, last = max(intervals, key=lambda rows: t[rows[1]] - t[rows[0]], default=(0, 0))
    if last == len(t) - 1 or contact.all():
        still = "contact is still 1" if has_switch else "the disks still touch"
        raise InputError(
            f"no unloading: {still} at the last row (time_s {t[-1]:.3f})",
            where=where,
            expected="a log that goes on for some seconds after the disks part",
            remedy="only the steady lines could be had from it",
        )
    if t[last] - t[first] < SHORTEST_CONTACT_S:
        raise InputError(
            f"the longest contact lasts {t[last] - t[first]:.2f} s (from time_s {t[first]:.3f})",
            where=where,
            expected=f"at least {SHORTEST_CONTACT_S:g} s under load",
        )
    return first, last


def _loading_instant(
    t: Array, contact: NDArray[np.bool_] | None, force: Array | None, first: int, last: int
) -> tuple[float, int, float | None]:
    """Time of loading, row in which the switch opens, and delay of a switch that disagrees.

    Parameters
    ----------
    t, contact
        Times and state of the switch, (N,); None without a switch.
    force
        Friction, or else load, (N,); None without both.
    first, last
        First and last row of the contact by majority.

    Returns
    -------
    load_on_s
        By the switch if it agrees with the start of the force, else that start.
    switch_off
        Last row of the switch's contact.
    late_s
        By how much the switch is late, None if it agrees.

    Notes
    -----
    The majority changes when half of the load is there. A load that is applied slowly starts long
    before, and what is taken for unloaded time gives the zeros of the forces: so the start counts.
    ``tests/partition/test_events.py`` has loads applied in 0.3 to 300 s.
    """
    by_majority_s = 0.5 * float(t[first - 1] + t[first]) if first else float(t[0])
    start_s = by_majority_s
    if force is not None:
        start_s = min(by_majority_s, _rise_start(t, force, first))
    if contact is None:
        return start_s, last, None
    overlapping = [rows for rows in _intervals(t, contact) if rows[1] >= first and rows[0] <= last]
    intervals = overlapping or [(first, last)]
    switch_on = intervals[0][0]
    switch_off = intervals[-1][1]
    by_switch_s = 0.5 * float(t[switch_on - 1] + t[switch_on]) if switch_on else float(t[0])
    tolerance_s = LOADING_AGREE_S + LOADING_AGREE_REL * (by_majority_s - start_s)
    if abs(by_switch_s - start_s) <= tolerance_s:
        return by_switch_s, switch_off, None
    return start_s, switch_off, by_switch_s - start_s


def _rise_start(t: Array, force: Array, row: int) -> float:
    """Start of the rise of a force to its value in a row [s].

    It is where the straight line through a tenth and half of the rise meets the force before.

    Parameters
    ----------
    t, force
        Times and force, (N,).
    row
        A row in which the force has risen.
    """
    # a median filter does not change a signal that only rises
    smooth = median_filter(force[: row + LEVEL_WIDTH], LEVEL_WIDTH)[: row + 1]
    rise = smooth - smooth.min()
    below = [np.flatnonzero(rise <= share * rise[-1]) for share in (0.1, 0.5)]
    tenth_s, half_s = (_between_samples(t, int(rows[-1])) for rows in below)
    return tenth_s - 0.25 * (half_s - tenth_s)


def _switch_state(frame: pd.DataFrame) -> NDArray[np.bool_] | None:
    """State of the contact switch (N,), gaps filled; None if it was not logged or never moves."""
    if "contact" not in frame:
        return None
    state = np.asarray(frame["contact"].ffill().bfill().to_numpy(dtype=float) > 0.5)
    return None if state.all() or not state.any() else state


def _scaled_force(force: Array) -> Array | None:
    """Scale a force (N,) to 0 without contact and 1 under load.

    The levels are the medians of the samples below and above their middle, found by iteration. None
    where they differ by less than ``MIN_FORCE_SNR`` times the noise, or have the wrong sign.
    """
    if np.isfinite(force).sum() < MIN_ZERO_SAMPLES:
        return None
    filled = interpolate_gaps(force, np.isfinite(force))
    denoised = median_filter(filled, NOISE_WIDTH)
    slow = median_filter(filled, LEVEL_WIDTH)
    low = float(slow.min())
    high = float(slow.max())
    for _ in range(LEVEL_ITERATIONS):
        upper = slow > 0.5 * (low + high)
        if upper.all() or not upper.any():
            return None
        low = float(fast_nanmedian(slow[~upper]))
        high = float(fast_nanmedian(slow[upper]))
    noise = 1.4826 * float(fast_nanmedian(np.abs(filled - denoised)))
    too_small = high - low < MIN_FORCE_SNR * noise
    wrong_sign = high <= abs(low)
    if too_small or wrong_sign:
        return None
    return (denoised - low) / (high - low)


def _above(level: Array, at: float, by: float) -> NDArray[np.bool_]:
    """Whether a level is above a threshold, with hysteresis to both sides, (N,).

    Parameters
    ----------
    level
        The level, (N,).
    at, by
        Threshold, and half-width of the hysteresis.
    """
    state = np.full(len(level), np.nan)
    state[level < at - by] = 0.0
    state[level > at + by] = 1.0
    return np.asarray(pd.Series(state).ffill().fillna(0.0) > 0.5)


def _intervals(
    t: Array, state: NDArray[np.bool_], gap_s: float = BOUNCE_S
) -> list[tuple[int, int]]:
    """First and last rows of each interval in which a state is true.

    An interval longer than ``RELOADED_S`` is joined to the one before over a gap below ``gap_s``.

    Parameters
    ----------
    t, state
        Times and state, (N,).
    gap_s
        Longest gap that is joined [s].

    Returns
    -------
    list
        (first, last) of each interval.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], state.astype(int), [0]])))
    intervals: list[tuple[int, int]] = []
    for start, end in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist()):
        first = start
        if intervals and t[start] - t[intervals[-1][1]] < gap_s and t[end] - t[start] > RELOADED_S:
            first = intervals.pop()[0]
        intervals.append((first, end))
    return intervals


def _switch_findings(t: Array, contact: NDArray[np.bool_], first: int, last: int) -> list[Finding]:
    """Findings on times at which the switch was off between two rows under load.

    Parameters
    ----------
    t, contact
        Times and state of the switch, (N,).
    first, last
        First and last row of the contact.
    """
    off = [(a, b) for a, b in _intervals(t, ~contact, 0.0) if a > first and b < last]
    dropouts = [a for a, b in off if t[b] - t[a] >= BOUNCE_S]
    n_bounces = len(off) - len(dropouts)
    findings: list[Finding] = []
    if dropouts:
        findings.append(
            warning(
                "contact.dropout",
                subject="contact",
                first_s=float(t[dropouts[0]]),
                count=len(dropouts),
            )
        )
    if n_bounces:
        findings.append(
            info("contact.bounced", subject="contact", count=n_bounces, shorter_s=BOUNCE_S)
        )
    return findings


def _later_touches(
    t: Array, contact: NDArray[np.bool_], levels: Mapping[str, Array | None], last: int
) -> list[tuple[int, int]]:
    """First and last rows of each touch after the unloading: two of friction, load, switch rise.

    Parameters
    ----------
    t, contact
        Times and state of the switch, (N,).
    levels
        Scaled forces; None for a force without a level.
    last
        Last row of the contact.

    Returns
    -------
    list
        (first, last) of each touch, two samples wider than it on either side.

    Notes
    -----
    A touch must last ``TOUCH_S``, and the switch or a force above ``TOUCH_MIN_PEAK`` must confirm
    it. ``tests/partition/test_events.py`` tests touches with and without the switch.
    """
    forces = [x for x in levels.values() if x is not None]
    rising = (_above(x, TOUCH_START, 0.0).astype(int) for x in forces)
    votes = contact.astype(int) + sum(rising, np.zeros(len(t), int))
    clear = contact.copy()
    for x in forces:
        clear |= x > TOUCH_MIN_PEAK
    touching = votes >= 2
    apart = np.flatnonzero(~touching[last + 1 :])
    first_apart = int(apart[0]) if len(apart) else len(t)
    touching[: last + 1 + first_apart] = False
    touches = []
    for a, b in _intervals(t, touching):
        if t[b] - t[a] >= TOUCH_S and clear[a : b + 1].any():
            touches.append((max(a - 2, last + 1), min(b + 2, len(t) - 1)))
    return touches


def _without_touches(
    frame: pd.DataFrame, columns: list[str], touches: list[tuple[int, int]]
) -> pd.DataFrame:
    """The log with the forces linearly interpolated over later touches.

    Parameters
    ----------
    frame
        The log.
    columns
        Columns of the forces.
    touches
        First and last rows of each touch.
    """
    if not touches:
        return frame
    rows = np.concatenate([np.arange(a, b + 1) for a, b in touches])
    out = frame.reset_index(drop=True)
    interpolated = out[columns].drop(rows).reindex(out.index).interpolate()
    for column in columns:  # pandas 3.0.0 cannot set several columns if there is only one
        out.loc[rows, column] = interpolated.loc[rows, column]
    return out
