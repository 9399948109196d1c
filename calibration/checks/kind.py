"""What must hold for each kind of log: switches that move, loads in newtons, channels of a disk that agree."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from calibration import Array, Flags
from calibration.checks.temperature import Place
from calibration.columns import ROOM_AND_BATH
from calibration.disk import CHANNELS, DISKS
from calibration.errors import InputError
from calibration.finding import Finding, look, note
from calibration.noise import white_noise_sd
from calibration.rig import Rig, load_rig

BOUNCE_S = 0.2


def two_level(values: Array, name: str, place: Place) -> tuple[Array, list[Finding]]:
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
                f"{place.at(name, first)}: {100 * missing.mean():.0f} % of it is missing", where=place.where
            )
        found.append(look("switch.filled", subject=name, count=int(missing.sum()), **place.of(first)))
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
    if len(levels) == 2:
        found.append(note("switch.levels", subject=name, low=float(levels[0]), high=float(levels[1])))
        return (values == levels[1]).astype(float), found
    raise InputError(f"column {name} is {levels[0]:g} in every row", where=place.where, expected="0 and 1")


def check_edges(values: Array, name: str, kind: str, place: Place) -> list[Finding]:
    """Whether a switch (N,) of 0 and 1 moves as this kind of log must have it."""
    if kind == "ehl":
        return check_contact(values, place)
    return check_switch(values, name, place) if name == "switch" else []


def check_switch(values: Array, name: str, place: Place) -> list[Finding]:
    """An entry switch: must go from 0 to 1; held or momentary both are fine, bounces are noted."""
    up = np.flatnonzero(np.diff(values) > 0) + 1
    if len(up) == 0:
        held = "goes from 1 to 0 only" if np.ptp(values) else f"is {values[0]:g} in every row"
        raise InputError(
            f"column {name} {held}: the switch never moves to 1",
            where=place.where,
            expected="0 before the entry, 1 at the entry",
            remedy="give the log of the whole plunge",
        )
    return _bounces(values, name, place)


def check_contact(contact: Array, place: Place) -> list[Finding]:
    """The contact switch of an EHL log (N,): must fall; bounces and a missing loading or cooling are noted."""
    down = np.flatnonzero(np.diff(contact) < 0) + 1
    if len(down) == 0:
        state = "rises but never falls" if np.ptp(contact) else f"is {contact[0]:g} in every row"
        raise InputError(
            f"column contact {state}: no unloading",
            where=place.where,
            expected="1 while the disks touch, then 0",
            remedy="give the log of the whole test, through the cooling",
        )
    found = _bounces(contact, "contact", place)
    if contact[0] > 0.5:
        found.append(look("contact.from_start", subject="contact"))
    cooling_s = np.inf if place.dt_s is None else float((len(contact) - down[-1]) * place.dt_s)
    if cooling_s < 5.0:
        found.append(look("contact.short_cooling", subject="contact", cooling_s=cooling_s))
    return found


def check_loads(frame: Mapping[str, Array], where: str) -> list[Finding]:
    """Load, friction and speeds of an EHL log while ``contact`` is 1. Raises InputError where they cannot be used."""
    contact, load = frame["contact"], frame["load_N"]
    on, off = float(np.nanmedian(load[contact > 0.5])), float(np.nanmedian(load[contact < 0.5]))
    if abs(on - off) < 10.0:
        raise InputError(
            f"column load_N is {on:.4g} in contact and {off:.4g} without: a dead cell, kilonewtons or volts",
            where=where,
            expected="newtons that rise by 10 or more in contact",
        )
    if on < off:
        apart = load < 0.5 * (np.nanmin(load) + np.nanmax(load))
        inverted = not apart.any() or contact[apart].mean() > 0.5
        raise InputError(
            f"column contact: the load is {on:.4g} N where contact is 1 and {off:.4g} N where it is 0",
            where=where,
            expected="contact 1 while the disks touch",
            remedy="the switch looks inverted: log 1 - contact"
            if inverted
            else "the switch looks momentary: hold it at 1 from touching to parting, as the load shows it",
        )
    found: list[Finding] = []
    friction = float(np.nanmedian(frame["friction_N"][contact > 0.5]))
    if friction < 0:
        found.append(look("friction.negative", subject="friction_N", friction_N=friction))
    elif friction > 0.3 * on:
        found.append(look("friction.high", subject="friction_N", friction_N=friction, load_N=on))
    return found + _speeds(frame, contact, where)


def check_course(checked: Mapping[str, Array], kind: str, place: Place) -> list[Finding]:
    """What the columns show together, over the whole test (or rows picked from all of it)."""
    bath = [float(np.nanmedian(checked[n])) for n in ROOM_AND_BATH if n in checked]
    if kind != "ehl":
        channels = {n: v for n, v in checked.items() if n.endswith("_degC") and n not in ROOM_AND_BATH}
        return check_group(channels, place, max(bath) if bath else None)
    room = float(np.nanmedian(checked["ambient_degC"]))
    if room > 120.0:
        raise InputError(
            f"column ambient_degC is about {room:.3g}: no enclosure is that warm; degrees Fahrenheit?",
            where=place.where,
            expected="degrees Celsius",
        )
    groups = ({n: v for n, v in checked.items() if n.startswith(f"{disk}_")} for disk in DISKS)
    found = [finding for group in groups for finding in check_group(group, place, room)]
    return found + check_loads(checked, place.where)


def check_group(columns: Mapping[str, Array], place: Place, reference_degC: float | None) -> list[Finding]:
    """Channels of one disk against one another: millivolts, and one that does not follow the rest.

    ``reference_degC`` is the median of a bath or room temperature known to be in degC. Raises InputError.
    """
    high = {n: float(np.nanquantile(v, 0.99)) for n, v in columns.items()}
    low = {n: float(np.nanquantile(v, 0.01)) for n, v in columns.items()}
    warm = _middle(high.values())
    for name, value in high.items():
        others = max(warm, reference_degC if reference_degC is not None else 0.0)
        if value < 16.0 and low[name] > -5.0 and (others > value + 8.0 or warm < 16.0):
            raise InputError(
                f"column {name} stays between {low[name]:.3g} and {value:.3g}: this looks like millivolts",
                where=place.where,
                expected="degrees Celsius",
                remedy="for type J write millivolts = true into rig.toml [logger]",
            )
    rise = {n: high[n] - low[n] for n in columns}
    usual = _middle(rise.values())
    for name, value in rise.items():
        if usual > 10.0 and value < 0.1 * usual:
            raise InputError(
                f"column {name} changes by {value:.3g} degC, the others by {usual:.3g}: a dead channel",
                where=place.where,
                remedy="check its wiring, or leave the channel out by repairing the disk",
            )
    if place.dt_s is None:
        return []
    noise = {n: _noise_K(v) for n, v in columns.items()}
    calm = _middle(noise.values())
    return [
        look("noise.high", subject=name, noise_K=value, others_K=calm)
        for name, value in noise.items()
        if value > 4.0 * calm + 0.1
    ]


def check_places(frame: pd.DataFrame, kind: str, rig: Rig | None, disk: str | None) -> list[Finding]:
    """Channels that look swapped, by the depths of their junctions in ``rig``."""
    used = rig or load_rig()
    if kind == "ehl":
        contact = frame["contact"].to_numpy() > 0.5
        first = int(np.argmax(contact))
        late = contact & (np.arange(len(contact)) > first + 0.2 * contact.sum())
        return [f for name in DISKS for f in check_swapped(frame, f"{name}_", _depths(used, name), late)]
    if kind == "immersion":
        mean = frame[[f"{c}_degC" for c in CHANNELS]].mean(axis=1).to_numpy()
        start, end = float(np.nanmean(mean[:30])), float(np.nanmean(mean[-30:]))
        if end - start > 10.0:
            rise = (mean - start) / (end - start)
            return check_swapped(frame, "", _depths(used, disk or ""), (rise > 0.05) & (rise < 0.35))
    return []


def check_swapped(frame: pd.DataFrame, prefix: str, depth_mm: Mapping[str, float], hot: Flags) -> list[Finding]:
    """Junctions nearer a heated surface must be warmer: the pair that most stands the other way round is named.

    ``hot`` marks the samples where heat flows in; the start of the record takes out static offsets.
    """
    if hot.sum() < 20:
        return []
    names = {c: f"{prefix}{c}_degC" for c in CHANNELS if f"{prefix}{c}_degC" in frame}
    head = frame.iloc[: max(10, min(len(frame) // 20, 400))]
    lead = {c: float(np.nanmean(frame[n].to_numpy()[hot]) - np.nanmean(head[n].to_numpy())) for c, n in names.items()}
    pairs = [(s, d) for s in lead for d in lead if depth_mm[d] - depth_mm[s] >= 2.5]
    wrong = [(s, d) for s, d in pairs if lead[s] < lead[d] - max(0.5, 0.02 * abs(lead[d]))]
    if not wrong:
        return []
    shallow, deep = min(wrong, key=lambda p: lead[p[0]] - lead[p[1]])
    found = look(
        "junctions.swapped",
        subject=names[shallow],
        other=names[deep],
        behind_K=lead[deep] - lead[shallow],
        depth_mm=depth_mm[shallow],
        other_depth_mm=depth_mm[deep],
    )
    return [found]


def _depths(rig: Rig, disk: str) -> dict[str, float]:
    junctions = rig.tables(disk).thermocouples
    return {c: junctions[c].depth_mm for c in CHANNELS}


def _middle(values: Iterable[float]) -> float:
    """The middle one, or the upper one of two."""
    ordered = sorted(values)
    return ordered[len(ordered) // 2]


def _noise_K(values: Array) -> float:
    """White noise of a trace from its second differences (median, so that events do not count)."""
    x = values[np.isfinite(values)]
    return float(white_noise_sd(x, 2, centred=False)) if len(x) >= 10 else 0.0


def _speeds(frame: Mapping[str, Array], contact: Array, where: str) -> list[Finding]:
    speed = {d: float(np.nanmedian(frame[f"speed_{d}_rpm"][contact > 0.5])) for d in DISKS}
    for disk, value in speed.items():
        if not np.isfinite(value) or value <= 0:
            raise InputError(
                f"column speed_{disk}_rpm is {value:.3g} in contact", where=where, expected="rotation in rpm"
            )
    if speed["fast"] < 0.98 * speed["slow"]:
        raise InputError(
            f"column speed_fast_rpm ({speed['fast']:.4g}) is below speed_slow_rpm ({speed['slow']:.4g})",
            where=where,
            expected="the fast disk to turn faster",
            remedy="the columns look swapped",
        )
    if speed["slow"] < 60.0:
        return [look("speed.slow", subject="speed_slow_rpm", speed_rpm=speed["slow"])]
    return []


def _bounces(values: Array, name: str, place: Place) -> list[Finding]:
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    if len(edges) < 3 or place.dt_s is None:
        return []
    close = np.flatnonzero(np.diff(edges) * place.dt_s < BOUNCE_S)
    if len(close) >= 2 or (len(close) == 1 and len(edges) > 2):
        return [look("switch.bounces", subject=name, count=len(edges), **place.of(int(edges[close[0]])))]
    return []
