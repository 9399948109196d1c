"""When the disks met and when they parted, from contact switch, friction and load together."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.errors import InputError

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


@dataclass(frozen=True)
class Events:
    """Loading and unloading of one EHL test.

    ``load_on_s`` and ``unload_s`` are in the log's own time [s]; ``unload_u_s`` is the standard uncertainty of the
    instant at which the frictional heat ended; ``parting_s`` is how long the friction took to fall from 90 to 10 %.
    """

    load_on_s: float
    unload_s: float
    unload_u_s: float
    parting_s: float
    warnings: tuple[str, ...] = ()

    @property
    def fall_s(self) -> float:
        """The whole of a straight fall of the friction [s]."""
        return self.parting_s / STRAIGHT_FALL

    @property
    def kinks_s(self) -> tuple[float, ...]:
        """Instants at which the temperatures bend at the parting [s]: its middle, or both ends of a slow one."""
        if self.fall_s < TWO_KINKS_S:
            return (self.unload_s,)
        return (self.unload_s - 0.5 * self.fall_s, self.unload_s + 0.5 * self.fall_s)


def find_events(frame: pd.DataFrame, where: str = "the log") -> Events:
    """Find the loaded stretch of an EHL log and the instant of parting, to better than a sample where possible.

    The contact switch names the samples; the friction's fall through half its level places the end of the heat
    between them, averaged with switch and load cell where they agree. Raises InputError without a contact or
    without an unloading.
    """
    t = frame["time_s"].to_numpy(dtype=float)
    contact = frame["contact"].ffill().bfill().to_numpy(dtype=float) > 0.5
    starts, stops, bounced = _stretches(t, contact)
    warnings: list[str] = []
    starts, stops, dropped_s = _through_dropouts(t, frame["load_N"].to_numpy(dtype=float), contact, starts, stops)
    if dropped_s:
        warnings.append(
            f"contact goes to 0 under load (first at time_s {dropped_s[0]:.3f}, {len(dropped_s)} time(s)): taken as a "
            "switch that fails, not as an unloading"
        )
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
        warnings.append(f"the contact switch bounced ({bounced} changes shorter than {BOUNCE_S} s were bridged)")
    unload, u, parting, said = _parting(t, frame, 0.5 * float(t[last] + t[last + 1]), float(t[first]))
    warnings += said
    load_on = 0.5 * (t[first - 1] + t[first]) if first else t[0]
    return Events(float(load_on), float(unload), float(u), float(parting), tuple(warnings))


def _parting(
    t: NDArray[np.float64], frame: pd.DataFrame, switch_s: float, contact_s: float
) -> tuple[float, float, float, list[str]]:
    """Instant of parting, its standard uncertainty, the friction's 90-10 % time, and warnings.

    Contact switch, friction and load cell each miss the instant by up to 0.05 s (section 5.3); those that agree are
    averaged. A switch that differs from the friction by more is not believed: the friction is the heat. A friction too
    noisy to show its fall leaves the word to the load cell. ``contact_s``: when the contact began, by the switch.
    """
    dt = float(np.median(np.diff(t)))
    falls = [_far_fall(t, frame[c].to_numpy(dtype=float), switch_s, contact_s) for c in ("friction_N", "load_N")]
    named = [(name, fall) for name, fall in zip(("friction", "load cell"), falls) if fall is not None]
    if not named:
        unclear = (
            "neither friction nor load shows a clear fall at unloading: the contact switch alone gives the instant"
        )
        return switch_s, INDICATOR_U_S, 0.0, [unclear]
    said: list[str] = []
    if falls[0] is None:
        said.append("the friction shows no clear fall at unloading: load cell and contact switch give the instant")
    (witness, (at, parting)), *others = named
    instants_of_others = (switch_s, *(fall[0] for _, fall in others))
    near = [x for x in instants_of_others if abs(x - at) <= max(AGREE_S, 0.5 * parting)]
    if switch_s not in near:
        said.append(
            f"contact switch and {witness} disagree on the parting by {at - switch_s:+.3f} s; the {witness} is used"
        )
    if parting > AGREE_S:  # a slow fall: switch and load cell do not say when the heat was half gone
        return at, float(np.hypot(INDICATOR_U_S, 0.05 * parting)), parting, said
    instants = [at, *near]
    spread = max(INDICATOR_U_S, float(np.std(instants)))
    return float(np.mean(instants)), float(np.hypot(spread, dt / np.sqrt(12)) / np.sqrt(len(instants))), parting, said


def _stretches(t: NDArray[np.float64], contact: NDArray[np.bool_]) -> tuple[list[int], list[int], int]:
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
    t: NDArray[np.float64], load: NDArray[np.float64], contact: NDArray[np.bool_], starts: list[int], stops: list[int]
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


def _far_fall(
    t: NDArray[np.float64], force: NDArray[np.float64], switch_s: float, contact_s: float
) -> tuple[float, float] | None:
    """``_fall`` about the switch, or about the force's own step where that lies too far from the switch."""
    step = _step(t, force, max(switch_s - STEP_REACH_S, contact_s), switch_s + STEP_REACH_S)
    if step is not None and abs(step - switch_s) > NEAR_S and (far := _fall(t, force, step)) is not None:
        return far
    return _fall(t, force, switch_s)


def _step(t: NDArray[np.float64], force: NDArray[np.float64], start_s: float, stop_s: float) -> float | None:
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


def _fall(t: NDArray[np.float64], friction: NDArray[np.float64], about_s: float) -> tuple[float, float] | None:
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


def _crossing(t: NDArray[np.float64], level: NDArray[np.float64], at: float) -> float | None:
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
