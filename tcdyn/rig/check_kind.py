"""What must hold for each kind of log: switches that move, loads in newtons, channels of a disk that agree."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, info_or_warning, warning
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.rig.columns import ROOM_AND_BATH, couples_in
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import Rig, RigTables

BOUNCE_S = 0.2


def check_kind(
    kind: str,
    course: pd.DataFrame,
    switches: Mapping[str, Array],
    place: SampleLocation,
    rig: Rig,
    disk: str | None,
    *,
    parted: bool = True,
) -> tuple[dict[str, Flags], list[Finding]]:
    """The ``switches`` (N,) of a log as off and on, and what all columns show together over the whole test.

    ``course``: cleaned columns, at the rows of the file that its index names (all of them, or some picked from all the
    test); ``parted``: whether the disks must part. Raises InputError where a log of this ``kind`` cannot be.
    """
    found: list[Finding] = []
    states: dict[str, Flags] = {}
    for name, values in switches.items():
        levels, said = _two_level(values, name, place)
        if name == "contact" and _inverted(course, levels[course.index] > 0.5):
            levels = 1.0 - levels
            said = [*said, warning("contact.inverted", subject="contact")]
        found += said + _edges(levels, name, place, parted)
        states[name] = levels > 0.5
    bath = [float(course[n].median()) for n in ROOM_AND_BATH if n in course]
    couples = couples_in(course)
    if kind != "ehl":
        found += _group(course[couples], place, max(bath) if bath else None)
    if kind == "immersion":
        mean = course[couples].mean(axis=1).to_numpy()
        start = float(np.nanmean(mean[:30]))
        end = float(np.nanmean(mean[-30:]))
        if end - start > 10.0:
            rise = (mean - start) / (end - start)
            found += _swapped(course, "", rig.tables(disk or ""), (rise > 0.05) & (rise < 0.35))
    if kind != "ehl":
        return states, found
    known = rig.common.constants.get("ambient_degC")
    rooms = [float(course[n].median()) for n in course if str(n).startswith("ambient_")]
    room = max(rooms, default=known.value if known else 20.0)
    if rooms and room > 120.0:
        raise InputError(
            f"column {_hottest(course)} is about {room:.3g}: no enclosure is that warm; degrees Fahrenheit?",
            where=place.where,
            expected="degrees Celsius",
        )
    for own in DISKS:
        if logged := [n for n in couples if n.startswith(f"{own}_")]:
            found += _group(course[logged], place, room)
    contact = states["contact"][course.index] if "contact" in states else _touching(course)
    found += _loads(course, contact, place.where) if contact.any() else []
    late = (
        contact
        & ~contact[0]
        & (np.arange(len(contact)) > int(np.argmax(contact)) + 0.2 * contact.sum())
    )
    for own in DISKS:
        found += _swapped(course, f"{own}_", rig.tables(own), late)
    return states, found


def _hottest(course: pd.DataFrame) -> str:
    """The column of the air that is warmest."""
    return str(course[[n for n in course if str(n).startswith("ambient_")]].median().idxmax())


def _touching(course: pd.DataFrame) -> Flags:
    """Whether load, or friction where none was logged, stands at its upper level (N,), where no switch says so."""
    name = next((n for n in ("load_N", "friction_N") if n in course), None)
    if name is None:
        return np.zeros(len(course), dtype=bool)
    calm = course[name].rolling(51, center=True, min_periods=1).median()
    return np.asarray(calm > 0.5 * (calm.min() + calm.max()))


def _two_level(values: Array, name: str, place: SampleLocation) -> tuple[Array, list[Finding]]:
    """A switch (N,) as 0 and 1; missing samples keep the state before them.

    Other pairs of levels (0 and 5 V) are read as off and on, with a note. Raises InputError for more levels.
    """
    missing = ~np.isfinite(values)
    if missing.all():
        raise InputError(f"column {name} holds no numbers", where=place.where, expected="0 and 1")
    found: list[Finding] = []
    if missing.any():
        first = int(np.argmax(missing))
        if missing.mean() > 0.05:
            raise InputError(
                f"{place.at(name, first)}: {100 * missing.mean():.0f} % of it is missing",
                where=place.where,
            )
        count = int(missing.sum())
        found.append(
            info_or_warning(
                count / len(values), "switch.filled", subject=name, count=count, **place.of(first)
            )
        )
        values = np.array(pd.Series(values).where(~missing).ffill().bfill(), dtype=np.float64)
    levels = np.sort(pd.unique(values))
    if len(levels) > 2:
        i = int(np.argmax((values != levels[0]) & (values != levels[-1])))
        raise InputError(
            f"{place.at(name, i)}: {values[i]:.4g}; the column takes {len(levels)} different values",
            where=place.where,
            expected="0 and 1",
        )
    if set(levels) <= {0.0, 1.0}:
        return values, found
    if len(levels) == 1:
        raise InputError(
            f"column {name} is {levels[0]:g} in every row", where=place.where, expected="0 and 1"
        )
    found.append(info("switch.levels", subject=name, low=float(levels[0]), high=float(levels[1])))
    return (values == levels[1]).astype(float), found


def _inverted(course: pd.DataFrame, contact: Flags) -> bool:
    """Whether load and friction both stand at their upper level where ``contact`` (N,) is off, and only there."""
    if contact.all() or not contact.any():
        return False
    against = []
    for name in ("load_N", "friction_N"):
        if name not in course:
            return False
        force = course[name].to_numpy(dtype=float)
        low, high = (float(np.nanmedian(force[contact == state])) for state in (True, False))
        upper = force > 0.5 * (low + high)
        apart = float(np.mean(upper[~contact])) - float(np.mean(upper[contact]))
        against.append(
            high > abs(low) and apart > 0.8
        )  # of a force with its sign turned the larger level is negative
    return all(against)


def _edges(values: Array, name: str, place: SampleLocation, parted: bool) -> list[Finding]:
    """Whether a switch (N,) of 0 and 1 moves as it must: up at an entry, down where the disks part.

    Held or momentary both are fine for an entry; bounces and a missing loading or cooling are noted.
    """
    steps = np.diff(values)
    falls = np.flatnonzero(steps < 0)
    if name == "switch" and not (steps > 0).any():
        held = "goes from 1 to 0 only" if steps.any() else f"is {values[0]:g} in every row"
        raise InputError(
            f"column {name} {held}: the switch never moves to 1",
            where=place.where,
            expected="0 before the entry, 1 at the entry",
            remedy="give the log of the whole plunge",
        )
    if name == "contact" and parted and not len(falls):
        state = "rises but never falls" if steps.any() else f"is {values[0]:g} in every row"
        raise InputError(
            f"column contact {state}: no unloading",
            where=place.where,
            expected="1 while the disks touch, then 0",
            remedy="give the log of the whole test, through the cooling",
        )
    assert place.dt_s is not None
    found = list[Finding]()
    edges = np.flatnonzero(steps) + 1
    close = np.flatnonzero(np.diff(edges) * place.dt_s < BOUNCE_S)
    if len(edges) > 2 and len(close):
        found.append(
            info("switch.bounces", subject=name, count=len(edges), **place.of(int(edges[close[0]])))
        )
    if name == "contact" and values[0] > 0.5:
        found.append(warning("contact.from_start", subject="contact"))
    cooling_s = float(len(values) - 1 - falls[-1]) * place.dt_s if len(falls) else np.inf
    if name == "contact" and cooling_s < 5.0:
        found.append(warning("contact.short_cooling", subject="contact", cooling_s=cooling_s))
    return found


def _group(
    columns: pd.DataFrame, place: SampleLocation, reference_degC: float | None
) -> list[Finding]:
    """Channels of one disk against one another: millivolts, and one that does not follow the rest.

    ``reference_degC`` is the median of a bath or room temperature known to be in degC. Raises InputError.
    """
    low = columns.quantile(0.01)
    high = columns.quantile(0.99)
    warm = _upper_median(high)
    for name, least, value in zip(columns, low, high):
        others = max(warm, reference_degC if reference_degC is not None else 0.0)
        if value < 16.0 and least > -5.0 and (others > value + 8.0 or warm < 16.0):
            raise InputError(
                f"column {name} stays between {least:.3g} and {value:.3g}: this looks like millivolts",
                where=place.where,
                expected="degrees Celsius",
                remedy="for type J write millivolts = true into rig.toml [logger]",
                column=str(name) if warm >= 16.0 else "",
            )
    rise = high - low
    usual = _upper_median(rise)
    for name, value in rise.items():
        if usual > 10.0 and value < 0.1 * usual:
            raise InputError(
                f"column {name} changes by {value:.3g} degC, the others by {usual:.3g}: a dead channel",
                where=place.where,
                remedy="check its wiring, or leave the channel out by repairing the disk",
                column=str(name),
            )
    # white noise from second differences and their median, so that events do not count
    noise = columns.apply(
        lambda x: float(white_noise_sd(x.dropna(), 2, centred=False)) if x.count() >= 10 else 0.0
    )
    calm = _upper_median(noise)
    loud = noise[noise > 4.0 * calm + 0.1]
    return [
        warning("noise.high", subject=str(name), noise_K=value, others_K=calm)
        for name, value in loud.items()
    ]


def _upper_median(values: pd.Series[float]) -> float:
    """The middle one, or the upper one of two."""
    return float(values.quantile(0.5, interpolation="higher"))


def _loads(course: pd.DataFrame, contact: Flags, where: str) -> list[Finding]:
    """Load, friction and speeds of an EHL log while ``contact`` is on. Raises InputError where they cannot be used."""
    touching = course[contact].median()
    apart = course[~contact].median()
    on, off = (float(x.get("load_N", np.nan)) for x in (touching, apart))
    if abs(on - off) < 10.0:
        raise InputError(
            f"column load_N is {on:.4g} in contact and {off:.4g} without: a dead cell, kilonewtons or volts",
            where=where,
            expected="newtons that rise by 10 or more in contact",
        )
    if on < off:
        load = course["load_N"]
        lower = load < 0.5 * (load.min() + load.max())
        inverted = not lower.any() or contact[lower].mean() > 0.5
        raise InputError(
            f"column contact: the load is {on:.4g} N where contact is 1 and {off:.4g} N where it is 0",
            where=where,
            expected="contact 1 while the disks touch",
            remedy="the switch looks inverted: log 1 - contact"
            if inverted
            else "the switch looks momentary: hold it at 1 from touching to parting, as the load shows it",
        )
    found: list[Finding] = []
    friction = float(touching.get("friction_N", np.nan))
    if friction < 0:
        found.append(warning("friction.negative", subject="friction_N", friction_N=friction))
    elif friction > 0.3 * on:
        found.append(warning("friction.high", subject="friction_N", friction_N=friction, load_N=on))
    fast, slow = (float(touching.get(f"speed_{disk}_rpm", np.nan)) for disk in DISKS)
    for disk, value in zip(DISKS, (fast, slow)):
        if not value > 0 and f"speed_{disk}_rpm" in course:
            raise InputError(
                f"column speed_{disk}_rpm is {value:.3g} in contact",
                where=where,
                expected="rotation in rpm",
            )
    if fast < 0.98 * slow:
        raise InputError(
            f"column speed_fast_rpm ({fast:.4g}) is below speed_slow_rpm ({slow:.4g})",
            where=where,
            expected="the fast disk to turn faster",
            remedy="the columns look swapped",
        )
    if slow < 60.0:
        found.append(warning("speed.slow", subject="speed_slow_rpm", speed_rpm=slow))
    return found


def _swapped(course: pd.DataFrame, prefix: str, tables: RigTables, hot: Flags) -> list[Finding]:
    """Channels that look swapped: junctions nearer a heated surface must be warmer.

    The pair that most stands the other way round is named. ``tables`` of the disk tell the depths; ``hot`` marks the
    samples where heat flows in; the start of the record takes out static offsets.
    """
    if hot.sum() < 20:
        return []
    there = [c for c in sorted(tables.thermocouples) if f"{prefix}{c}_degC" in course]
    depth_mm = {c: tables.thermocouples[c].depth_mm for c in there}
    readings = course[[f"{prefix}{c}_degC" for c in there]].set_axis(there, axis=1)
    lead = (
        readings[hot].mean() - readings.iloc[: max(10, min(len(course) // 20, 400))].mean()
    ).to_dict()
    pairs = [(s, d) for s in there for d in there if depth_mm[d] - depth_mm[s] >= 2.5]
    wrong = [(s, d) for s, d in pairs if lead[s] < lead[d] - max(0.5, 0.02 * abs(lead[d]))]
    if not wrong:
        return []
    shallow, deep = min(wrong, key=lambda p: lead[p[0]] - lead[p[1]])
    found = warning(
        "junctions.swapped",
        subject=f"{prefix}{shallow}_degC",
        other=f"{prefix}{deep}_degC",
        behind_K=lead[deep] - lead[shallow],
        depth_mm=depth_mm[shallow],
        other_depth_mm=depth_mm[deep],
    )
    return [found]
