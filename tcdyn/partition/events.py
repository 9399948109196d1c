"""When the disks met and parted, from contact switch, friction and load together."""

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
from tcdyn.estimation.trace_noise import bridged, middle
from tcdyn.partition.angular_harmonic import Unevenness
from tcdyn.partition.unloading import NEAR_S, unloading_instant
from tcdyn.rig.contact import LEAST_ZERO, NOTHING_ADDED, STRAIGHT_FALL, Events, FrictionAdded
from tcdyn.smoothing.traces import DiskTraces

SHORTEST_CONTACT_S = 20.0  # a shorter contact is a touch, not a test
BOUNCE_S = 0.5
RELOADED_S = 5.0  # disks that part for less than a bounce and then touch for this long had not parted
LOADING_AGREE_S = 0.5
MIN_FORCE_SNR = 6.0  # noises of a force between its two levels: below it is no witness
HYSTERESIS = 0.1  # of the way between the levels, about its middle
INVERTED_FRACTION = 0.8  # of the samples in which load and friction agree
TOUCH_S = 0.04
# of the way between the levels: where a later touch begins, and what it reaches
TOUCH_START = 0.05
TOUCH_MIN_PEAK = 0.15
MIN_TWO_KINKS_S = 0.5  # a shorter fall is one kink: behind a lag its two ends are not told apart


@dataclass(frozen=True)
class DiskAir:
    """T_A of one disk: behind its ``faces`` and at its running ``surface``, (N,) [degC] each.

    ``own_u_K``: standard uncertainty of their means by how their channels differ.
    """

    faces: Array
    surface: Array
    own_u_K: float = 0.0


@dataclass(frozen=True)
class EhlTest:
    """An EHL test ready for the fits; arrays of shape (N,) on an even time base.

    ``power_W`` is the whole frictional power F u_s; surface speeds under load: u_f / u_s their ratio, u_f - u_s sliding
    (2.1), their mean entraining (2.2); ``added`` the part of ``friction_N`` that the transducer did not see;
    ``exponent_half_range`` how far n may lie from ``speed_exponent``. ``slowing``: surface speed of each disk that did
    not keep it after the parting, as a share of that under load (N,); ``film`` (N, 2): what its changed film comes to,
    see :func:`tcdyn.partition.cooling.with_slowing_air_offset`; ``uneven``: what is known of each disk round its bore;
    ``friction_noise_N``: white noise of a logged sample of the friction, before it was smoothed; ``air``: of each disk,
    where channels of its own tell it, in place of ``ambient_degC``; ``nominal_u``: the part of the disks'
    ``friction_rel``, ``half_width_rel`` and ``ambient_K`` that ``[constants]`` states, this log's and not the rig's.
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
    slowing: Mapping[str, Array] = field(default_factory=dict)
    film: Mapping[str, Array] = field(default_factory=dict)
    uneven: Mapping[str, Unevenness] = field(default_factory=dict)
    friction_noise_N: float = 0.0
    air: Mapping[str, DiskAir] = field(default_factory=dict)
    stated_u: Mapping[str, float] = field(default_factory=dict)

    @property
    def conditions(self) -> dict[str, float]:
        """What ran, and when, as ``beta.json`` keeps it."""
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
        """Temperature of the air behind a disk's faces, and at its surface where nothing else is known, (N,) [degC]."""
        return self.air[disk].faces if disk in self.air else self.ambient_degC


def find_events(frame: pd.DataFrame, where: str = "the log") -> Events:
    """Find the loaded stretch of an EHL log and the instant of parting, to better than a sample where possible.

    Contact switch, load and friction, as far as they were logged, vote on when the disks touched; the friction's fall
    through half its level places the end of the heat between the samples, averaged with switch and load cell where they
    agree. Raises InputError without a contact or without an unloading.
    """
    t, switch = frame["time_s"].to_numpy(dtype=float), _switch(frame)
    levels = {
        c: _levels(frame[c].to_numpy(dtype=float)) for c in ("load_N", "friction_N") if c in frame
    }
    force = sum(
        (np.sign(_above(x, 0.5, HYSTERESIS) - 0.5) for x in levels.values() if x is not None),
        np.zeros(len(t)),
    )
    contact = force > 0 if switch is None else switch
    if not contact.any():
        raise InputError(
            "contact never goes to 1"
            if switch is not None
            else "neither load nor friction shows a loaded stretch",
            where=where,
            expected="a loaded stretch",
            remedy="is this a log of an unloaded run?",
        )
    found: list[Finding] = []
    voting = np.abs(force) > 1.5
    if voting.any() and np.mean(contact[voting] != (force[voting] > 0)) > INVERTED_FRACTION:
        contact = ~contact
        found.append(warning("contact.inverted", subject="contact"))
    touching = _runs(t, force + (contact - 0.5) > 0)
    first, last = max(touching, key=lambda run: t[run[1]] - t[run[0]], default=(0, 0))
    if last == len(t) - 1 or contact.all():
        still = "contact is still 1" if switch is not None else "the disks still touch"
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
    found += [] if switch is None else _failures(t, contact, first, last)
    own = [run for run in _runs(t, contact) if run[1] >= first and run[0] <= last] or [
        (first, last)
    ]
    (on, _) = own[0]
    (_, off) = own[-1]
    load_on, by_switch = (0.5 * (t[k - 1] + t[k]) if k else t[0] for k in (first, on))
    if abs(by_switch - load_on) <= LOADING_AGREE_S:
        load_on = by_switch
    else:
        found.append(warning("loading.disagree", subject="contact", late_s=by_switch - load_on))
    again = _again(t, contact, levels, last)
    switch_s, vote_s = (0.5 * float(t[k] + t[min(k + 1, len(t) - 1)]) for k in (off, last))
    about_s = switch_s if abs(switch_s - vote_s) <= NEAR_S else vote_s
    seen = _alone(frame, [*levels], again)
    unload, u, parting, said = unloading_instant(
        t, seen, None if switch is None else switch_s, about_s, float(load_on)
    )
    found += said
    half_s = 0.5 * parting / STRAIGHT_FALL  # of a straight fall
    kinks = [unload] if 2 * half_s < MIN_TWO_KINKS_S else [unload - half_s, unload + half_s]
    touches = tuple(
        (float(max(t[a], kinks[-1])), float(t[b])) for a, b in again if t[b] > kinks[-1]
    )
    if touches:
        length = sum(b - a for a, b in touches)
        found.append(
            info(
                "contact.again", count=len(touches), after_s=touches[0][0] - unload, length_s=length
            )
        )
    kinks = [float(x) for x in (*kinks, *(x for touch in touches for x in touch))]
    return Events(
        float(load_on), float(unload), float(u), float(parting), tuple(kinks), tuple(found), touches
    )


def _switch(frame: pd.DataFrame) -> NDArray[np.bool_] | None:
    return (
        None
        if "contact" not in frame
        else np.asarray(frame["contact"].ffill().bfill().to_numpy(dtype=float) > 0.5)
    )


def _levels(force: Array) -> Array | None:
    """A force (N,) on a scale where zero is apart and one is loaded; None where it hardly rises above its noise."""
    if np.isfinite(force).sum() < LEAST_ZERO:
        return None
    filled = bridged(force, np.isfinite(force))
    calm, slow = (median_filter(filled, width) for width in (5, 51))
    low = float(slow.min())
    high = float(slow.max())
    for _ in range(5):
        upper = slow > 0.5 * (low + high)
        if upper.all() or not upper.any():
            return None
        low = float(middle(slow[~upper]))
        high = float(middle(slow[upper]))
    noise = 1.4826 * float(middle(np.abs(filled - calm)))
    if high - low < MIN_FORCE_SNR * noise or high <= abs(low):  # or its sign is turned
        return None
    return (calm - low) / (high - low)


def _above(level: Array, at: float, by: float) -> NDArray[np.bool_]:
    """Whether ``level`` (N,) is above ``at``: it has come above ``at + by`` and not fallen below ``at - by`` since."""
    state = pd.Series(np.where(level > at + by, 1.0, np.where(level < at - by, 0.0, np.nan)))
    return np.asarray(state.ffill().fillna(0.0) > 0.5)


def _runs(t: Array, state: NDArray[np.bool_], bridged_s: float = BOUNCE_S) -> list[tuple[int, int]]:
    """First and last rows of each stretch of ``state``, joined over a short gap that a long stretch follows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], state.astype(int), [0]])))
    runs: list[tuple[int, int]] = []
    for a, b in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist()):
        if runs and t[a] - t[runs[-1][1]] < bridged_s and t[b] - t[a] > RELOADED_S:
            a = runs.pop()[0]
        runs.append((a, b))
    return runs


def _failures(t: Array, contact: NDArray[np.bool_], first: int, last: int) -> list[Finding]:
    """Times at which the switch was off between two rows under load."""
    off = [(a, b) for a, b in _runs(t, ~contact, 0.0) if a > first and b < last]
    dropped = [a for a, b in off if t[b] - t[a] >= BOUNCE_S]
    found = list[Finding]()
    if dropped:
        found.append(
            warning(
                "contact.dropout",
                subject="contact",
                first_s=float(t[dropped[0]]),
                count=len(dropped),
            )
        )
    if bounced := len(off) - len(dropped):
        found.append(info("contact.bounced", subject="contact", count=bounced, shorter_s=BOUNCE_S))
    return found


def _again(
    t: Array, contact: NDArray[np.bool_], levels: Mapping[str, Array | None], last: int
) -> list[tuple[int, int]]:
    """First and last rows of each touch after row ``last``, in which two of friction, load and switch rise again."""
    forces = [x for x in levels.values() if x is not None]
    votes = contact.astype(int) + sum(
        (_above(x, TOUCH_START, 0.0).astype(int) for x in forces), np.zeros(len(t), int)
    )
    clear = contact | np.any([x > TOUCH_MIN_PEAK for x in forces] or [contact], axis=0)
    later = votes >= 2
    apart = np.flatnonzero(~later[last + 1 :])
    later[: last + 1 + (int(apart[0]) if len(apart) else len(t))] = False
    runs = [(a, b) for a, b in _runs(t, later) if t[b] - t[a] >= TOUCH_S and clear[a : b + 1].any()]
    return [(max(a - 2, last + 1), min(b + 2, len(t) - 1)) for a, b in runs]


def _alone(frame: pd.DataFrame, columns: list[str], again: list[tuple[int, int]]) -> pd.DataFrame:
    """The forces as if the disks had not touched again: straight lines in their place."""
    if not again:
        return frame
    rows = np.concatenate([np.arange(a, b + 1) for a, b in again])
    out = frame.reset_index(drop=True)
    out.loc[rows, columns] = out[columns].drop(rows).reindex(out.index).interpolate().loc[rows]
    return out
