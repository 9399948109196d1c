"""When the disks met and parted, from contact switch, friction and load together, and the force between the two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from calibration import Array
from calibration.errors import InputError
from calibration.finding import Finding, look
from calibration.noise import SPIKES, find_spikes, white_noise_sd
from tcdyn.partition.uneven import Unevenness
from tcdyn.traces import DiskTraces

SETTLE_S = 0.1  # samples this near to a switching instant may belong to either side
SHORTEST_CONTACT_S = 20.0  # a shorter contact is a touch, not a test
BOUNCE_S = 0.5
AGREE_S = 0.1
MISSING = 3.5  # sampling intervals: a wider gap at the fall leaves its instant open
NEAR_S = 1.0  # from the switch: nearer than this the force's fall is looked for about the switch
STEP_REACH_S = 60.0  # as far from the switch as the force's step is looked for
INDICATOR_U_S = 0.05 / 12**0.5  # section 5.3: the signals differ by 0.05 s
STRAIGHT_FALL = 0.8  # the 90-10 % time of a straight fall over the whole of it
TWO_KINKS_S = 0.5  # a shorter fall is one kink: behind a lag its two ends are not told apart
SMOOTH_S = 4.0  # straight line of this length; longer where the noise asks for it, up to
LONGEST_SMOOTH_S = 40.0
NOISE_LEFT = 0.002  # of the force at the parting: a fifth of the transducer's own uncertainty
LEAST_ZERO = 10  # samples of an unloaded stretch that give a zero


@dataclass(frozen=True)
class Events:
    """Loading and unloading of one EHL test.

    ``load_on_s`` and ``unload_s`` are in the log's own time [s]; ``unload_u_s`` is the standard uncertainty of the
    instant at which the frictional heat ended; ``parting_s`` is how long the friction took to fall from 90 to 10 %;
    ``kinks_s``: where the temperatures bend at the parting [s], its middle, or both ends of a slow one.
    """

    load_on_s: float
    unload_s: float
    unload_u_s: float
    parting_s: float
    kinks_s: tuple[float, ...]
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class FrictionAdded:
    """What the transducer does not see of the contact's friction, its standard uncertainty, and what to say of it."""

    value_N: float
    u_N: float
    findings: tuple[Finding, ...] = ()


NOTHING_ADDED = FrictionAdded(0.0, 0.0)


@dataclass(frozen=True)
class EhlTest:
    """An EHL test ready for the fits; arrays of shape (N,) on an even time base.

    ``power_W`` is the whole frictional power F u_s; surface speeds under load: u_f / u_s their ratio, u_f - u_s sliding
    (2.1), their mean entraining (2.2); ``added`` the part of ``friction_N`` that the transducer did not see;
    ``exponent_half_range`` how far n may lie from ``speed_exponent``; ``uneven``: what is known of each disk round its
    bore.
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
    added: FrictionAdded = NOTHING_ADDED
    uneven: Mapping[str, Unevenness] = field(default_factory=dict)


def find_events(frame: pd.DataFrame, where: str = "the log") -> Events:
    """Find the loaded stretch of an EHL log and the instant of parting, to better than a sample where possible.

    The contact switch names the samples; the friction's fall through half its level places the end of the heat
    between them, averaged with switch and load cell where they agree. Raises InputError without a contact or
    without an unloading.
    """
    t = frame["time_s"].to_numpy(dtype=float)
    contact = frame["contact"].ffill().bfill().to_numpy(dtype=float) > 0.5
    starts, stops, bounced = _stretches(t, contact)
    found: list[Finding] = []
    starts, stops, dropped_s = _through_dropouts(t, frame["load_N"].to_numpy(dtype=float), contact, starts, stops)
    if dropped_s:
        found.append(look("contact.dropout", subject="contact", first_s=dropped_s[0], count=len(dropped_s)))
    if not len(starts):
        raise InputError(
            "contact never goes to 1",
            where=where,
            expected="a loaded stretch",
            remedy="is this a log of an unloaded run?",
        )
    longest = int(np.argmax([t[b] - t[a] for a, b in zip(starts, stops)]))
    first, last = starts[longest], stops[longest]
    if last == len(t) - 1:
        raise InputError(
            f"no unloading: contact is still 1 at the last row (time_s {t[-1]:.3f})",
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
    if bounced:
        found.append(look("contact.bounced", subject="contact", count=bounced, shorter_s=BOUNCE_S))
    unload, u, parting, said = _parting(t, frame, 0.5 * float(t[last] + t[last + 1]), float(t[first]))
    found += said
    load_on = 0.5 * (t[first - 1] + t[first]) if first else t[0]
    half_s = 0.5 * parting / STRAIGHT_FALL  # of a straight fall
    kinks = (float(unload),) if 2 * half_s < TWO_KINKS_S else (float(unload - half_s), float(unload + half_s))
    return Events(float(load_on), float(unload), float(u), float(parting), kinks, tuple(found))


def _parting(
    t: Array, frame: pd.DataFrame, switch_s: float, contact_s: float
) -> tuple[float, float, float, list[Finding]]:
    """Instant of parting, its standard uncertainty, the friction's 90-10 % time, and what was noticed.

    Contact switch, friction and load cell each miss the instant by up to 0.05 s (section 5.3); those that agree are
    averaged. A switch that differs from the friction by more is not believed: the friction is the heat. A friction too
    noisy to show its fall leaves the word to the load cell. ``contact_s``: when the contact began, by the switch.
    """
    dt = float(np.median(np.diff(t)))
    falls = [_far_fall(t, frame[c].to_numpy(dtype=float), switch_s, contact_s) for c in ("friction_N", "load_N")]
    named = [(name, fall) for name, fall in zip(("friction", "load cell"), falls) if fall is not None]
    if not named:
        return switch_s, INDICATOR_U_S, 0.0, [look("parting.switch_alone")]
    said: list[Finding] = []
    if falls[0] is None:
        said.append(look("parting.no_friction"))
    (witness, (at, parting)), *others = named
    instants_of_others = (switch_s, *(fall[0] for _, fall in others))
    near = [x for x in instants_of_others if abs(x - at) <= max(AGREE_S, 0.5 * parting)]
    if switch_s not in near:
        said.append(look("parting.disagree", subject=witness, late_s=at - switch_s))
    if parting > AGREE_S:  # a slow fall: switch and load cell do not say when the heat was half gone
        return at, float(np.hypot(INDICATOR_U_S, 0.05 * parting)), parting, said
    instants = [at, *near]
    spread = max(INDICATOR_U_S, float(np.std(instants)))
    return float(np.mean(instants)), float(np.hypot(spread, dt / np.sqrt(12)) / np.sqrt(len(instants))), parting, said


def _stretches(t: Array, contact: NDArray[np.bool_]) -> tuple[list[int], list[int], int]:
    """First and last rows of each contact, short changes bridged."""
    edges = np.flatnonzero(np.diff(contact.astype(int))) + 1
    bounds = [0, *edges.tolist(), len(t)]
    state = contact.copy()
    bounced = 0
    for a, b in pairwise(bounds[1:-1]):
        if t[b - 1] - t[a] < BOUNCE_S and not state[a]:
            state[a:b] = True
            bounced += 1
    edges = np.flatnonzero(np.diff(np.concatenate([[0], state.astype(int), [0]])))
    return edges[::2].tolist(), (edges[1::2] - 1).tolist(), bounced


def _through_dropouts(
    t: Array, load: Array, contact: NDArray[np.bool_], starts: list[int], stops: list[int]
) -> tuple[list[int], list[int], list[float]]:
    """The contacts with those joined between which the load never went, and the instants [s] of such dropouts."""
    if len(starts) < 2:
        return starts, stops, []
    on, off = float(np.nanmedian(load[contact])), float(np.nanmedian(load[~contact]))
    gaps = [np.nanmedian(load[stop + 1 : start]) for stop, start in zip(stops, starts[1:])]
    held = [bool(on - off > 0 and gap > off + 0.8 * (on - off)) for gap in gaps]
    joined_starts = [starts[0], *(b for b, h in zip(starts[1:], held) if not h)]
    joined_stops = [*(a for a, h in zip(stops, held) if not h), stops[-1]]
    return joined_starts, joined_stops, [float(t[a + 1]) for a, h in zip(stops, held) if h]


def _far_fall(t: Array, force: Array, switch_s: float, contact_s: float) -> tuple[float, float] | None:
    """``_fall`` about the switch, or about the force's own step where that lies too far from the switch."""
    step = _step(t, force, max(switch_s - STEP_REACH_S, contact_s), switch_s + STEP_REACH_S)
    if step is not None and abs(step - switch_s) > NEAR_S and (far := _fall(t, force, step)) is not None:
        return far
    return _fall(t, force, switch_s)


def _step(t: Array, force: Array, start_s: float, stop_s: float) -> float | None:
    """Where the force steps down in (start, stop): the cut whose two levels explain most, or None if it never falls."""
    rows = np.flatnonzero((t > start_s) & (t < stop_s) & np.isfinite(force))
    if len(rows) < 20:
        return None
    x = force[rows]
    before = np.arange(1, len(x))
    sums = np.cumsum(x)[:-1]
    fall = sums / before - (x.sum() - sums) / (len(x) - before)
    explained = np.where(fall > 0, before * (len(x) - before) * fall**2, 0.0)
    cut = int(np.argmax(explained))
    return 0.5 * float(t[rows[cut]] + t[rows[cut + 1]]) if explained[cut] > 0 else None


def _fall(t: Array, friction: Array, about_s: float) -> tuple[float, float] | None:
    """Instant at which the friction passes half its level and its 90-10 % time, or None where it is not clear."""
    before = friction[(t > about_s - 3.0) & (t < about_s - 1.6)]
    after = friction[(t > about_s + 1.6) & (t < about_s + 3.0)]
    if len(before) < 10 or len(after) < 10:
        return None
    high, low = np.nanmedian(before), np.nanmedian(after)
    noise = 1.4826 * np.nanmedian(np.abs(np.concatenate([before - high, after - low])))
    if high - low < 10 * noise or high <= low:
        return None
    near = np.flatnonzero((t > about_s - 1.6) & (t < about_s + 1.6) & np.isfinite(friction))
    level = (friction[near] - low) / (high - low)
    if len(level) < 10:
        return None
    instants = [_crossing(t[near], level, at) for at in (0.9, 0.5, 0.1)]
    if any(x is None for x in instants):
        return None
    start, middle, end = (float(x) for x in instants if x is not None)
    return middle, max(end - start, 0.0)


def _crossing(t: Array, level: Array, at: float) -> float | None:
    """Where ``level`` falls through ``at``: the cut that misplaces the fewest samples, then a straight line.

    None where that is not clear, or where samples are missing at that place.
    """
    above = level > at
    misplaced = np.cumsum(~above) + (above.sum() - np.cumsum(above))
    cut = int(np.argmin(misplaced))
    if cut + 1 >= len(t) or misplaced[cut] > 0.2 * len(t):
        return None
    if t[cut + 1] - t[cut] > MISSING * float(np.median(np.diff(t))):
        return None
    a, b = level[cut], level[cut + 1]
    part = np.clip((a - at) / (a - b), 0.0, 1.0) if a != b else 0.5
    return float(t[cut] + part * (t[cut + 1] - t[cut]))


def contact_force(t: Array, raw_N: Array, events: Events) -> Array:
    """Force while the disks touch [N], zero elsewhere; ``raw_N`` as logged, both of shape (N,).

    The zero is the median before loading and after unloading, drifting straight between the two (section 2.9). Under
    load the force is a running straight line, spikes left out, that never looks across a switching instant: an average
    smeared over the parting edge would scale beta one to one, and so does noise left at that edge. The line is as long
    as ``NOISE_LEFT`` asks, since its end scatters by 2 sd / sqrt(samples).
    """
    on, off = events.load_on_s, events.unload_s
    quiet = events.parting_s + SETTLE_S
    zero = _zero(t, raw_N, on - SETTLE_S, off + quiet)
    inside = (t > on + SETTLE_S) & (t < off - quiet)
    level = _line_through((raw_N - zero)[inside], float(np.median(np.diff(t))))
    force = np.interp(t, t[inside], level)
    ramp_s = events.parting_s / STRAIGHT_FALL
    if ramp_s > 4 * float(np.median(np.diff(t))):
        share = np.clip((off + 0.5 * ramp_s - t) / ramp_s, 0.0, 1.0)
    else:
        share = (t < off).astype(float)
    return np.where(t >= on, force * share, 0.0)


def _line_through(raw: Array, dt_s: float) -> Array:
    """The slow course of a force (N,) with noise, spikes and missing samples, straight to its very ends."""
    rule = replace(SPIKES["force"], width=max(int(round(0.5 * SMOOTH_S / dt_s)), 3))
    filled = pd.Series(raw).mask(find_spikes(raw, rule)).interpolate(limit_direction="both").to_numpy()
    left = 2 * float(white_noise_sd(filled)) / max(NOISE_LEFT * abs(float(np.median(filled))), 1e-12)
    count = min(max(SMOOTH_S / dt_s, left**2), LONGEST_SMOOTH_S / dt_s, len(filled))
    window = max(2 * int((count - 1) // 2) + 1, 1)
    return np.asarray(savgol_filter(filled, window, min(1, window - 1), mode="interp"))


def _zero(t: Array, raw: Array, before_s: float, after_s: float) -> Array:
    """The transducer's zero at each instant, from the unloaded stretches."""
    early, late = t < before_s, (t > after_s) & (t < after_s + 60.0)
    points = [(float(np.mean(t[m])), float(np.nanmedian(raw[m]))) for m in (early, late) if m.sum() >= LEAST_ZERO]
    if not points:
        return np.zeros_like(t)
    return np.asarray(np.interp(t, [p[0] for p in points], [p[1] for p in points]))
