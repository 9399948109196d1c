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
INDICATOR_U_S = 0.05 / 12**0.5  # section 5.3: the signals differ by 0.05 s


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
    unload, u, parting, said = _parting(t, frame, 0.5 * float(t[last] + t[last + 1]))
    warnings += said
    load_on = 0.5 * (t[first - 1] + t[first]) if first else t[0]
    return Events(float(load_on), float(unload), float(u), float(parting), tuple(warnings))


def _parting(t: NDArray[np.float64], frame: pd.DataFrame, switch_s: float) -> tuple[float, float, float, list[str]]:
    """Instant of parting, its standard uncertainty, the friction's 90-10 % time, and warnings.

    Contact switch, friction and load cell each miss the instant by up to 0.05 s (section 5.3); those that agree are
    averaged. A switch that differs from the friction by more is not believed: the friction is the heat.
    """
    dt = float(np.median(np.diff(t)))
    friction = _fall(t, frame["friction_N"].to_numpy(dtype=float), switch_s)
    if friction is None:
        unclear = "the friction shows no clear fall at unloading: the contact switch alone gives the instant"
        return switch_s, INDICATOR_U_S, 0.0, [unclear]
    at, parting = friction
    load = _fall(t, frame["load_N"].to_numpy(dtype=float), switch_s)
    near = [x for x in (switch_s, *([load[0]] if load else [])) if abs(x - at) <= max(AGREE_S, 0.5 * parting)]
    said: list[str] = []
    if switch_s not in near:
        said = [f"contact switch and friction disagree on the parting by {at - switch_s:+.3f} s; the friction is used"]
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
    """Where ``level`` falls through ``at``: the cut that misplaces the fewest samples, then a straight line."""
    above = level > at
    misplaced = np.cumsum(~above) + (above.sum() - np.cumsum(above))
    cut = int(np.argmin(misplaced))
    if cut + 1 >= len(t) or misplaced[cut] > 0.2 * len(t):
        return None
    a, b = level[cut], level[cut + 1]
    part = np.clip((a - at) / (a - b), 0.0, 1.0) if a != b else 0.5
    return float(t[cut] + part * (t[cut + 1] - t[cut]))
