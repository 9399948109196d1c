"""Unloading: the instant at which the frictional heat ended, to better than a sample.

The friction is the heat, so its fall through half its level is the instant; contact switch and load
cell are averaged with it where they agree. The uncertainties are those of section 5.3. Used by
:mod:`tcdyn.partition.events`. Guarded by ``tests/partition/test_events.py``.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.findings import Finding, warning

# The signals agree, and the fall is fast, within this [s]. Chosen by judgement.
AGREE_S = 0.1
# A gap wider than this many sampling intervals at the fall leaves its instant undetermined.
MAX_GAP = 3.5
# If the force's step is nearer to the switch than this [s], its fall is searched about the switch.
NEAR_S = 1.0
STEP_REACH_S = 60.0  # the force's step is searched this far from the switch [s]
# Standard uncertainty of each signal [s]: they differ by 0.05 s (section 5.3).
INDICATOR_U_S = 0.05 / 12**0.5
# Of a force without a switch, which may be that far from it on either side [s].
NO_SWITCH_U_S = 0.05 / 3**0.5
SLOW_FALL_REL_U = 0.05  # standard uncertainty of the instant of a slow fall, relative to its length
# Limits of the search, chosen by judgement.
FALL_REACH_S = 1.6  # the fall lies within this of its expected time [s]
LEVEL_REACH_S = 3.0  # the levels are taken from there to this [s]
MIN_SAMPLES = 10  # least number of samples of a level, and of the fall
MIN_STEP_SAMPLES = 20  # least number of samples in which a step is searched
MIN_FALL_SNR = 10.0  # least fall in standard deviations of the noise
MAX_MISPLACED = 0.2  # largest fraction of samples on the wrong side of a level
# Forces in the order in which they are trusted, with their names in messages.
SIGNAL_NAMES = {"friction_N": "friction", "load_N": "load cell"}


def unloading_instant(
    t: Array, frame: pd.DataFrame, switch_s: float | None, about_s: float, contact_s: float
) -> tuple[float, float, float, list[Finding]]:
    """Instant of unloading, from friction, load cell and contact switch.

    Parameters
    ----------
    t, frame
        Times, (N,) [s], and the log.
    switch_s
        Instant of the contact switch, or None [s].
    about_s
        Unloading by majority of switch and forces [s].
    contact_s
        Start of the contact [s].

    Returns
    -------
    unload_s, u_s, fall_s, findings
        The instant, its standard uncertainty, the friction's 90-10 % time, and findings.

    Notes
    -----
    Contact switch, friction and load cell each miss the instant by up to 0.05 s (section 5.3);
    those that agree are averaged. A switch that differs from the friction by more is not used,
    because the friction is the heat. Where the friction is too noisy to show its fall, the load
    cell is used.

    ``AGREE_S`` decides what is averaged and what is a slow fall. The result's ``u_s`` is the
    standard uncertainty of the parameter "parting" in
    ``tcdyn.partition.nuisance.nuisance_effects``. ``tests/partition/test_events.py`` tests steps,
    ramps, noise and gaps.
    """
    dt = float(np.median(np.diff(t)))
    indicator_u_s = NO_SWITCH_U_S if switch_s is None else INDICATOR_U_S
    falls = {
        c: _fall_in_reach(t, frame[c].to_numpy(dtype=float), about_s, contact_s)
        for c in SIGNAL_NAMES
        if c in frame
    }
    clear = [(SIGNAL_NAMES[c], fall) for c, fall in falls.items() if fall is not None]
    if not clear:
        if switch_s is None:
            return about_s, AGREE_S, 0.0, [warning("parting.unclear")]
        return switch_s, indicator_u_s, 0.0, [warning("parting.switch_alone")]
    findings: list[Finding] = []
    if falls.get("friction_N") is None:
        findings.append(warning("parting.no_friction"))
    (signal, (fall_at_s, fall_s)), *others = clear
    other_instants = [fall[0] for _, fall in others]
    if switch_s is not None:
        other_instants.insert(0, switch_s)
    near = [x for x in other_instants if abs(x - fall_at_s) <= max(AGREE_S, 0.5 * fall_s)]
    if switch_s is not None and switch_s not in near:
        findings.append(warning("parting.disagree", subject=signal, late_s=fall_at_s - switch_s))
    if fall_s > AGREE_S:  # switch and load cell do not show when the heat was half gone
        u_s = float(np.hypot(indicator_u_s, SLOW_FALL_REL_U * fall_s))
        return fall_at_s, u_s, fall_s, findings
    instants = [fall_at_s, *near]
    spread = max(indicator_u_s, float(np.std(instants)))
    u_s = float(np.hypot(spread, dt / np.sqrt(12)) / np.sqrt(len(instants)))
    return float(np.mean(instants)), u_s, fall_s, findings


def _fall_in_reach(
    t: Array, force: Array, about_s: float, contact_s: float
) -> tuple[float, float] | None:
    """Fall of a force near an expected time, or at its own step where that is too far from it.

    Parameters
    ----------
    t, force
        Times and force, (N,).
    about_s
        Expected time [s].
    contact_s
        Start of the contact [s].

    Returns
    -------
    instant, fall_time
        As of :func:`_fall`; None where unclear.
    """
    step_s = _step(t, force, max(about_s - STEP_REACH_S, contact_s), about_s + STEP_REACH_S)
    if step_s is not None and abs(step_s - about_s) > NEAR_S:
        fall = _fall(t, force, step_s)
        if fall is not None:
            return fall
    return _fall(t, force, about_s)


def _step(t: Array, force: Array, start_s: float, stop_s: float) -> float | None:
    """Instant in (start, stop) where two levels explain most of the force; None without a fall.

    Parameters
    ----------
    t, force
        Times and force, (N,).
    start_s, stop_s
        Interval of the search [s].

    Notes
    -----
    The cut with the largest variance between the two levels, of those at which the force falls.
    """
    rows = np.flatnonzero((t > start_s) & (t < stop_s) & np.isfinite(force))
    if len(rows) < MIN_STEP_SAMPLES:
        return None
    x = force[rows]
    n_before = np.arange(1, len(x))
    n_after = len(x) - n_before
    sums = np.cumsum(x)[:-1]
    fall = sums / n_before - (x.sum() - sums) / n_after
    explained = np.where(fall > 0, n_before * n_after * fall**2, 0.0)
    cut = int(np.argmax(explained))
    if explained[cut] <= 0:
        return None
    return 0.5 * float(t[rows[cut]] + t[rows[cut + 1]])


def _fall(t: Array, force: Array, about_s: float) -> tuple[float, float] | None:
    """Instant at which a force passes half its level, and its 90-10 % time.

    Parameters
    ----------
    t, force
        Times and force, (N,).
    about_s
        Expected instant [s].

    Returns
    -------
    instant, fall_time
        [s]; None where the fall is not clear of the noise, or samples are missing.
    """
    start_s = about_s - FALL_REACH_S
    end_s = about_s + FALL_REACH_S
    before = force[(t > about_s - LEVEL_REACH_S) & (t < start_s)]
    after = force[(t > end_s) & (t < about_s + LEVEL_REACH_S)]
    if len(before) < MIN_SAMPLES or len(after) < MIN_SAMPLES:
        return None
    high = np.nanmedian(before)
    low = np.nanmedian(after)
    noise = 1.4826 * np.nanmedian(np.abs(np.concatenate([before - high, after - low])))
    if high - low < MIN_FALL_SNR * noise or high <= low:
        return None
    near = np.flatnonzero((t > start_s) & (t < end_s) & np.isfinite(force))
    level = (force[near] - low) / (high - low)
    if len(level) < MIN_SAMPLES:
        return None
    start, middle, end = (_falling_crossing_s(t[near], level, at) for at in (0.9, 0.5, 0.1))
    if start is None or middle is None or end is None:
        return None
    return middle, max(end - start, 0.0)


def _falling_crossing_s(t: Array, level: Array, at: float) -> float | None:
    """Instant at which a level falls through a threshold.

    That is the cut that misplaces the fewest samples, then a straight line. None where that is not
    clear, or where samples are missing there.

    Parameters
    ----------
    t, level
        Times and level, (N,).
    at
        The threshold.
    """
    above = level > at
    misplaced = np.cumsum(~above) + (above.sum() - np.cumsum(above))
    cut = int(np.argmin(misplaced))
    if cut + 1 >= len(t) or misplaced[cut] > MAX_MISPLACED * len(t):
        return None
    if t[cut + 1] - t[cut] > MAX_GAP * float(np.median(np.diff(t))):
        return None
    a = level[cut]
    b = level[cut + 1]
    fraction = np.clip((a - at) / (a - b), 0.0, 1.0) if a != b else 0.5
    return float(t[cut] + fraction * (t[cut + 1] - t[cut]))
