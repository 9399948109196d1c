"""Checks that depend on the kind of log.

Switches must change, loads must be in newtons, speeds in rpm, and the channels of a disk must
agree.

Used by :mod:`tcdyn.rig.log` after the file was read once. Errors stop the analysis; warnings do
not. Thresholds are chosen by judgement where no other reason is given. Tests:
``tests/rig/test_long_log_chunks.py``, ``tests/partition/test_events.py``,
``tests/rig/test_junction_order.py`` and ``tests/cli/test_compensate_command.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations

import numpy as np
import pandas as pd

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, info_or_warning, warning
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.rig.columns import ROOM_AND_BATH, junction_columns_in
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import Rig, RigTables

# Two edges of a switch that are closer than this are a bounce [s]. Chosen by judgement.
MAX_BOUNCE_S = 0.2
# Shorter cooling after the unloading gives a warning [s]. Chosen by judgement.
MIN_COOLING_S = 5.0
# A plunge heats the disk by more than this [K] before the order of the junctions is checked.
MIN_PLUNGE_RISE_K = 10.0
# No enclosure is warmer [degC]: the column is in degrees Fahrenheit. Chosen by judgement.
MAX_ROOM_DEGC = 120.0
# Beside a dead channel, a room that rises by more than this part of the usual rise of the channels
# is taken for the junction. Chosen by judgement.
MAX_ROOM_RISE = 0.5
# The load rises by at least this much in contact [N]; less is another unit or a dead cell.
MIN_LOAD_STEP_N = 10.0
# Standard deviations of its noise by which a force must fall to show unloaded time. By judgement.
MIN_FALL_NOISE = 5.0
# Coefficient of friction above which the unit or the zero is doubtful. Chosen by judgement.
MAX_FRICTION_COEFFICIENT = 0.3
# Slower slow shafts give a warning [rpm]. Chosen by judgement.
MIN_SPEED_RPM = 60.0
# Junctions are compared if their depths differ by at least this [mm]. Chosen by judgement.
MIN_DEPTH_DIFFERENCE_MM = 2.5
# They are equally deep if their depths differ by less than this [mm]. Chosen by judgement.
SAME_DEPTH_MM = 0.5
# Samples at both ends of a plunge whose means give its rise, and the shares of the rise between
# which the disk heats: later its junctions approach each other again. Chosen by judgement.
PLUNGE_END_SAMPLES = 30
HEATING_SHARES = (0.05, 0.35)
MIN_HEATING_SAMPLES = 20  # fewer give no order of the junctions; chosen by judgement
# Samples of the start of a record, a twentieth of it within these bounds. Chosen by judgement.
START_SAMPLES = (10, 400)
# Differences of the rise that do not contradict an order: in K, and over the rise, the larger one.
ORDER_LIMIT_K = 0.5
ORDER_LIMIT_SHARE = 0.02
# Share of a switch that may be missing. Chosen by judgement.
MAX_MISSING_SWITCH = 0.05
# Difference of the shares of samples at the upper level of a force, without and in contact, above
# which the force contradicts the switch. Chosen by judgement.
MIN_INVERTED_DIFFERENCE = 0.8
# Readings within these limits may be emfs [mV]: all of type J up to about 290 degC lie within.
EMF_RANGE_MV = (-5.0, 16.0)
# Distance of an emf from the warmest other reading [K]. Chosen by judgement.
MIN_EMF_DISTANCE_K = 8.0
# A channel is dead if it changes by less than this share of the usual change, where that is at
# least so many K. Chosen by judgement.
DEAD_RISE_SHARE = 0.1
MIN_USUAL_RISE_K = 10.0
# A channel is noisy above this many times the usual noise plus so many K. Chosen by judgement.
NOISY_RATIO = 4.0
NOISY_K = 0.1
# Speed of the fast shaft over that of the slow one, below which the columns look swapped: pure
# rolling is allowed, with an error of the readings. Chosen by judgement.
MIN_SPEED_RATIO = 0.98
# Cosine of the largest angle, 60 degrees, between junctions at one side. Chosen by judgement.
SAME_SIDE_COS = 0.5


def check_kind(
    kind: str,
    sample: pd.DataFrame,
    switches: Mapping[str, Array],
    location: SampleLocation,
    rig: Rig,
    disk: str | None,
    *,
    needs_unloading: bool = True,
) -> tuple[dict[str, Flags], list[Finding]]:
    """Check what the columns of a log show together over the complete test.

    Parameters
    ----------
    kind
        Kind of log.
    sample
        Cleaned columns, all rows or some from the complete test; the index is the row of the file.
    switches
        All rows of the switches, (N,) each.
    location
        Position of the rows in the file, for messages.
    rig
        The rig, for depths and constants.
    disk
        Disk of an oven or immersion log; None: the common tables.
    needs_unloading
        Whether the log must contain the unloading.

    Returns
    -------
    The switches as off and on, (N,) each, and the findings.

    Raises
    ------
    InputError
        A log of this kind cannot look like this.
    """
    states, findings = _check_switches(sample, switches, location, needs_unloading)
    baths = [float(sample[name].median()) for name in ROOM_AND_BATH if name in sample]
    junctions = junction_columns_in(sample)
    if kind == "ehl":
        findings += _check_ehl(sample, junctions, states, location, rig)
        return states, findings
    findings += _check_channels(sample[junctions], location, max(baths) if baths else None)
    if kind == "immersion":
        mean = sample[junctions].mean(axis=1).to_numpy()
        start = float(np.nanmean(mean[:PLUNGE_END_SAMPLES]))
        end = float(np.nanmean(mean[-PLUNGE_END_SAMPLES:]))
        if end - start > MIN_PLUNGE_RISE_K:
            rise = (mean - start) / (end - start)
            is_heating = (rise > HEATING_SHARES[0]) & (rise < HEATING_SHARES[1])
            tables = rig.tables(disk or "")
            findings += _junction_order(sample, "", tables, is_heating, compare_sides=True)
    return states, findings


def _check_switches(
    sample: pd.DataFrame,
    switches: Mapping[str, Array],
    location: SampleLocation,
    needs_unloading: bool,
) -> tuple[dict[str, Flags], list[Finding]]:
    """Each switch as off and on; an inverted contact switch is corrected, with a warning.

    Parameters
    ----------
    sample
        Cleaned columns; the index is the row of the file.
    switches
        All rows of the switches, (N,) each.
    location
        Position of the rows in the file, for messages.
    needs_unloading
        Whether the log must contain the unloading.

    Returns
    -------
    states
        Off and on, (N,) each.
    findings
        Of all switches.
    """
    findings: list[Finding] = []
    states: dict[str, Flags] = {}
    for name, values in switches.items():
        levels, level_findings = _two_levels(values, name, location)
        findings += level_findings
        if name == "contact" and _is_inverted(sample, levels[sample.index] > 0.5):
            levels = 1.0 - levels
            findings.append(warning("contact.inverted", subject="contact"))
        findings += _check_edges(levels, name, location, needs_unloading)
        states[name] = levels > 0.5
    return states, findings


def _check_ehl(
    sample: pd.DataFrame,
    junctions: list[str],
    states: Mapping[str, Flags],
    location: SampleLocation,
    rig: Rig,
) -> list[Finding]:
    """Room temperature, channels, loads and speeds of an EHL log.

    Parameters
    ----------
    sample
        Cleaned columns; the index is the row of the file.
    junctions
        Columns of the junctions.
    states
        The switches as off and on, (N,) each.
    location
        Position of the rows in the file, for messages.
    rig
        The rig.

    Raises
    ------
    InputError
        A room above ``MAX_ROOM_DEGC``, or unusable channels, loads or speeds.
    """
    _check_exchanged_room(sample, junctions, location.where)
    constant = rig.common.constants.get("ambient_degC")
    air = sample[[name for name in sample if str(name).startswith("ambient_")]].median()
    if len(air):
        room_degC = float(air.max())
    else:
        room_degC = constant.value if constant else 20.0
    if len(air) and room_degC > MAX_ROOM_DEGC:
        raise InputError(
            f"column {air.idxmax()} is about {room_degC:.3g}: no enclosure is that warm; "
            "degrees Fahrenheit?",
            where=location.where,
            expected="degrees Celsius",
        )
    findings: list[Finding] = []
    for disk in DISKS:
        disk_junctions = [name for name in junctions if name.startswith(f"{disk}_")]
        if disk_junctions:
            findings += _check_channels(sample[disk_junctions], location, room_degC)
    contact = states["contact"][sample.index] if "contact" in states else _contact_by_force(sample)
    if len(np.unique(contact)) == 1 and _shows_unloaded_time(sample):
        contact = _contact_by_force(sample)  # a switch that never moves
    if contact.any():
        findings += _check_loads(sample, contact, location.where)
    # the first fifth of the contact is left out: the heat has not reached all junctions yet
    heat_starts = int(np.argmax(contact)) + 0.2 * contact.sum()
    is_heating = contact & ~contact[0] & (np.arange(len(contact)) > heat_starts)
    for disk in DISKS:
        findings += _junction_order(sample, f"{disk}_", rig.tables(disk), is_heating)
    return findings


def _contact_by_force(sample: pd.DataFrame) -> Flags:
    """Contact by the load, or the friction if no load was logged: at its upper level, (N,)."""
    force_N = _smooth_force(sample)
    if force_N is None:
        return np.zeros(len(sample), dtype=bool)
    return (force_N > 0.5 * (force_N.min() + force_N.max())).to_numpy()


def _shows_unloaded_time(sample: pd.DataFrame) -> bool:
    """Whether the log has loaded and unloaded time: the force falls below half its maximum."""
    force_N = _smooth_force(sample)
    if force_N is None:
        return False
    noise_N = float((sample[force_N.name] - force_N).std())
    fall_N = force_N.max() - force_N.min()
    return bool(force_N.min() < 0.5 * force_N.max() and fall_N > MIN_FALL_NOISE * noise_N)


def _smooth_force(sample: pd.DataFrame) -> pd.Series | None:
    """Running median of the load, or of the friction if no load was logged (N,) [N]."""
    name = next((n for n in ("load_N", "friction_N") if n in sample), None)
    if name is None:
        return None
    return sample[name].rolling(51, center=True, min_periods=1).median()


def _two_levels(values: Array, name: str, location: SampleLocation) -> tuple[Array, list[Finding]]:
    """A switch (N,) as 0 and 1; missing samples take the state before them.

    Other pairs of levels (0 and 5 V) are read as off and on, with an information. Raises InputError
    for more than two levels.

    Parameters
    ----------
    values
        Values as logged (N,).
    name
        Name of the switch.
    location
        Position of the rows in the file, for messages.

    Returns
    -------
    values
        0 and 1 (N,).
    findings
        About filled samples and other levels.
    """
    missing = ~np.isfinite(values)
    if missing.all():
        raise InputError(
            f"column {name} holds no numbers", where=location.where, expected="0 and 1"
        )
    findings: list[Finding] = []
    if missing.any():
        first = int(np.argmax(missing))
        count = int(missing.sum())
        share = count / len(values)
        if share > MAX_MISSING_SWITCH:
            raise InputError(
                f"{location.at(name, first)}: {100 * share:.0f} % of it is missing",
                where=location.where,
            )
        numbers = {"count": count, **location.numbers_at(first)}
        findings.append(info_or_warning(share, "switch.filled", subject=name, **numbers))
        values = np.array(pd.Series(values).where(~missing).ffill().bfill(), dtype=np.float64)
    levels = np.sort(pd.unique(values))
    if len(levels) > 2:
        i = int(np.argmax((values != levels[0]) & (values != levels[-1])))
        raise InputError(
            f"{location.at(name, i)}: {values[i]:.4g}; the column takes {len(levels)} different "
            "values",
            where=location.where,
            expected="0 and 1",
        )
    if set(levels) <= {0.0, 1.0}:
        return values, findings
    if len(levels) == 1 and name == "contact":
        return (values > 0).astype(float), findings  # a switch that never moves is not used
    if len(levels) == 1:
        raise InputError(
            f"column {name} is {levels[0]:g} in every row",
            where=location.where,
            expected="0 and 1",
        )
    low, high = levels.tolist()
    findings.append(info("switch.levels", subject=name, low=low, high=high))
    return (values == high).astype(float), findings


def _is_inverted(sample: pd.DataFrame, contact: Flags) -> bool:
    """Whether load and friction are at their upper level only where ``contact`` (N,) is off.

    Parameters
    ----------
    sample
        Cleaned columns.
    contact
        The switch at these rows (N,).

    Notes
    -----
    Both load and friction must contradict the switch (``MIN_INVERTED_DIFFERENCE``), so that one
    sensor with the wrong sign does not invert it. Test:
    ``tests/partition/test_events.py``.
    """
    if contact.all() or not contact.any():
        return False
    for name in ("load_N", "friction_N"):
        if name not in sample:
            return False
        force = sample[name].to_numpy(dtype=float)
        in_contact = float(np.nanmedian(force[contact]))
        without = float(np.nanmedian(force[~contact]))
        is_upper = force > 0.5 * (in_contact + without)
        difference = float(np.mean(is_upper[~contact])) - float(np.mean(is_upper[contact]))
        # of a force with the wrong sign the larger level is negative
        if not (without > abs(in_contact) and difference > MIN_INVERTED_DIFFERENCE):
            return False
    return True


def _check_edges(
    values: Array, name: str, location: SampleLocation, needs_unloading: bool
) -> list[Finding]:
    """Check that a switch changes as it must: up at an entry, down at the unloading.

    At an entry it may stay on or be momentary. Bounces, a missing loading or cooling and a contact
    switch that does not move are reported: load and friction show the contact, too
    (``tcdyn.partition.events.find_events``).

    Parameters
    ----------
    values
        0 and 1 (N,).
    name
        Name of the switch.
    location
        Position of the rows in the file, for messages.
    needs_unloading
        Whether the log must contain the unloading.

    Raises
    ------
    InputError
        A switch that never closes, or a contact that begins and never ends.
    """
    steps = np.diff(values)
    falls = np.flatnonzero(steps < 0)
    constant = f"is {values[0]:g} in every row"
    if name == "switch" and not (steps > 0).any():
        state = "goes from 1 to 0 only" if steps.any() else constant
        raise InputError(
            f"column {name} {state}: the switch never moves to 1",
            where=location.where,
            expected="0 before the entry, 1 at the entry",
            remedy="give the log of the whole plunge",
        )
    assert location.dt_s is not None
    findings: list[Finding] = []
    if name == "contact" and needs_unloading and not len(falls):
        if not steps.any():
            return [warning("contact.stuck", subject="contact", level=int(values[0]))]
        raise InputError(
            "column contact rises but never falls: no unloading",
            where=location.where,
            expected="1 while the disks touch, then 0",
            remedy="give the log of the whole test, through the cooling",
        )
    edges = np.flatnonzero(steps) + 1
    bounces = np.flatnonzero(np.diff(edges) * location.dt_s < MAX_BOUNCE_S)
    if len(edges) > 2 and len(bounces):
        numbers = {"count": len(edges), **location.numbers_at(int(edges[bounces[0]]))}
        findings.append(info("switch.bounces", subject=name, **numbers))
    if name != "contact":
        return findings
    if values[0] > 0.5:
        findings.append(warning("contact.from_start", subject="contact"))
    cooling_s = float(len(values) - 1 - falls[-1]) * location.dt_s if len(falls) else np.inf
    if cooling_s < MIN_COOLING_S:
        findings.append(warning("contact.short_cooling", subject="contact", cooling_s=cooling_s))
    return findings


def _check_exchanged_room(sample: pd.DataFrame, junctions: list[str], where: str) -> None:
    """Compare the changes of room temperatures with those of the junctions.

    Parameters
    ----------
    sample
        Cleaned columns.
    junctions
        Columns of the junctions.
    where
        Name of the file, for messages.

    Raises
    ------
    InputError
        A room temperature that changes as the junctions do, beside a junction that does not.
    """
    rooms = [str(name) for name in sample if str(name).startswith("ambient_")]
    columns = sample[[*junctions, *rooms]]
    rise = columns.quantile(0.99) - columns.quantile(0.01)
    if not junctions or not rooms:
        return
    usual_rise = _upper_median(rise[junctions])
    junction = str(rise[junctions].idxmin())
    room = str(rise[rooms].idxmax())
    is_dead = rise[junction] < DEAD_RISE_SHARE * usual_rise
    if usual_rise > MIN_USUAL_RISE_K and is_dead and rise[room] > MAX_ROOM_RISE * usual_rise:
        raise InputError(
            f"column {room} changes by {rise[room]:.3g} degC as the junctions do, and {junction} "
            f"by {rise[junction]:.3g}: they look exchanged",
            where=where,
            remedy="map the columns in rig.toml [columns]",
        )


def _check_channels(
    columns: pd.DataFrame, location: SampleLocation, reference_degC: float | None
) -> list[Finding]:
    """Compare the channels of one disk: millivolts, a dead channel, excessive noise.

    Parameters
    ----------
    columns
        Channels of one disk [degC].
    location
        Position of the rows in the file, for messages.
    reference_degC
        Median of a bath or room temperature; None: not known.

    Raises
    ------
    InputError
        Millivolts, or a dead channel.

    Notes
    -----
    The upper median is "usual", so that half of the channels may be faulty.
    """
    low = columns.quantile(0.01)
    high = columns.quantile(0.99)
    usual_high = _upper_median(high)
    warmest = max(usual_high, reference_degC if reference_degC is not None else 0.0)
    for name, lower, upper in zip(columns, low, high):
        is_small = upper < EMF_RANGE_MV[1] and lower > EMF_RANGE_MV[0]
        if is_small and (warmest > upper + MIN_EMF_DISTANCE_K or usual_high < EMF_RANGE_MV[1]):
            raise InputError(
                f"column {name} stays between {lower:.3g} and {upper:.3g}: this looks like "
                "millivolts",
                where=location.where,
                expected="degrees Celsius",
                remedy="for type J write millivolts = true into rig.toml [logger]",
                column=str(name) if usual_high >= EMF_RANGE_MV[1] else "",
            )
    rise = high - low
    usual_rise = _upper_median(rise)
    for name, value in rise.items():
        if usual_rise > MIN_USUAL_RISE_K and value < DEAD_RISE_SHARE * usual_rise:
            raise InputError(
                f"column {name} changes by {value:.3g} degC, the others by {usual_rise:.3g}: "
                "a dead channel",
                where=location.where,
                remedy="check its wiring, or leave the channel out by repairing the disk",
                column=str(name),
            )
    noise_K = columns.apply(_noise_K)
    usual_noise_K = _upper_median(noise_K)
    noisy = noise_K[noise_K > NOISY_RATIO * usual_noise_K + NOISY_K]
    return [
        warning("noise.high", subject=str(name), noise_K=value, others_K=usual_noise_K)
        for name, value in noisy.items()
    ]


def _noise_K(column: pd.Series[float]) -> float:
    """White noise [K] by the median of the second differences, which events do not affect."""
    if column.count() < 10:
        return 0.0
    return float(white_noise_sd(column.dropna(), 2, centred=False))


def _upper_median(values: pd.Series[float]) -> float:
    """The median, or the upper one of the two middle values."""
    return float(values.quantile(0.5, interpolation="higher"))


def _check_loads(sample: pd.DataFrame, contact: Flags, where: str) -> list[Finding]:
    """Load, friction and speeds of an EHL log in contact. Raises InputError for unusable ones.

    Parameters
    ----------
    sample
        Cleaned columns.
    contact
        Contact at these rows (N,).
    where
        Name of the file, for messages.
    """
    in_contact = sample[contact].median()
    without = sample[~contact].median()
    load_on = float(in_contact.get("load_N", np.nan))
    load_off = float(without.get("load_N", np.nan))
    if abs(load_on - load_off) < MIN_LOAD_STEP_N:
        raise InputError(
            f"column load_N is {load_on:.4g} in contact and {load_off:.4g} without: a dead cell, "
            "kilonewtons or volts",
            where=where,
            expected="newtons that rise by 10 or more in contact",
        )
    if load_on < load_off:
        load = sample["load_N"]
        is_lower = load < 0.5 * (load.min() + load.max())
        remedy = (
            "the switch looks momentary: hold it at 1 from loading to unloading, "
            "as the load shows it"
        )
        if not is_lower.any() or contact[is_lower].mean() > 0.5:
            remedy = "the switch looks inverted: log 1 - contact"
        raise InputError(
            f"column contact: the load is {load_on:.4g} N where contact is 1 and {load_off:.4g} N "
            "where it is 0",
            where=where,
            expected="contact 1 while the disks touch",
            remedy=remedy,
        )
    findings: list[Finding] = []
    friction = float(in_contact.get("friction_N", np.nan))
    if friction < 0:
        findings.append(warning("friction.negative", subject="friction_N", friction_N=friction))
    elif friction > MAX_FRICTION_COEFFICIENT * load_on:
        findings.append(
            warning("friction.high", subject="friction_N", friction_N=friction, load_N=load_on)
        )
    return findings + _check_speeds(sample, in_contact, where)


def _check_speeds(sample: pd.DataFrame, in_contact: pd.Series[float], where: str) -> list[Finding]:
    """Speeds in contact. Raises InputError where a shaft stands, or the slow one is faster.

    Parameters
    ----------
    sample
        Cleaned columns.
    in_contact
        Median of each column in contact.
    where
        Name of the file, for messages.
    """
    speeds = {disk: float(in_contact.get(f"speed_{disk}_rpm", np.nan)) for disk in DISKS}
    for disk, speed in speeds.items():
        if not speed > 0 and f"speed_{disk}_rpm" in sample:
            raise InputError(
                f"column speed_{disk}_rpm is {speed:.3g} in contact",
                where=where,
                expected="rotation in rpm",
            )
    fast = speeds["fast"]
    slow = speeds["slow"]
    if fast < MIN_SPEED_RATIO * slow:
        raise InputError(
            f"column speed_fast_rpm ({fast:.4g}) is below speed_slow_rpm ({slow:.4g})",
            where=where,
            expected="the fast disk to turn faster",
            remedy="the columns look swapped",
        )
    if slow < MIN_SPEED_RPM:
        return [warning("speed.slow", subject="speed_slow_rpm", speed_rpm=slow)]
    return []


def _junction_order(
    sample: pd.DataFrame,
    prefix: str,
    tables: RigTables,
    is_heating: Flags,
    *,
    compare_sides: bool = False,
) -> list[Finding]:
    """Channels in another order than their depths: junctions nearer a heated surface are warmer.

    The start of the record is subtracted, so that static offsets cancel.

    Parameters
    ----------
    sample
        Cleaned columns; its first rows are the start of the record.
    prefix
        Of the columns of the disk, such as "fast_".
    tables
        Of the disk; they give the depths and the angles.
    is_heating
        Samples in which heat flows in, (N,).
    compare_sides
        Whether a disk that warms unevenly is reported although the order is right.

    Returns
    -------
    findings
        One warning, or none, with the pair that contradicts most.

    Notes
    -----
    Three causes are distinguished. Where all junctions at one side warm more than those of equal
    depth at the other, and each side is in order, the disk warms unevenly; of two channels that are
    swapped, at least one is not in order with its neighbours. Where the readings themselves are in
    order, the disk was not at one temperature at the start. Otherwise channels look swapped.

    The limits are chosen by judgement. In 12 simulated plunges of rigs drawn from their
    uncertainties, equally deep junctions warmed alike within 0.2 K. Tests:
    ``tests/rig/test_junction_order.py``.
    """
    if is_heating.sum() < MIN_HEATING_SAMPLES:
        return []
    names = [c for c in sorted(tables.thermocouples) if f"{prefix}{c}_degC" in sample]
    junction = {c: tables.thermocouples[c] for c in names}
    readings = sample[[f"{prefix}{c}_degC" for c in names]].set_axis(names, axis=1)
    start_rows = int(np.clip(len(sample) // 20, *START_SAMPLES))
    heated = readings[is_heating].mean()
    start = readings.iloc[:start_rows].mean()
    rise = (heated - start).to_dict()
    limit_K = {c: max(ORDER_LIMIT_K, ORDER_LIMIT_SHARE * abs(rise[c])) for c in names}

    def deeper_mm(first: str, second: str) -> float:
        """How much deeper the second junction lies [mm]."""
        return float(junction[second].depth_mm - junction[first].depth_mm)

    def same_side(first: str, second: str) -> float:
        """Cosine of the angle between two junctions: 1 at one side, -1 at opposite sides."""
        angle_deg = junction[first].angle_deg - junction[second].angle_deg
        return float(np.cos(np.deg2rad(angle_deg)))

    pairs = list(permutations(names, 2))
    ordered = [(s, d) for s, d in pairs if deeper_mm(s, d) >= MIN_DEPTH_DIFFERENCE_MM]
    wrong = [(s, d) for s, d in ordered if rise[s] < rise[d] - limit_K[d]]
    opposite = [
        (c, w)
        for c, w in pairs
        if abs(deeper_mm(c, w)) < SAME_DEPTH_MM
        and same_side(c, w) < -SAME_SIDE_COS
        and rise[c] < rise[w]
    ]
    colder = [c for c, _ in opposite]
    is_uneven = (
        len(opposite) > 1
        and all(rise[c] < rise[w] - limit_K[w] and heated[c] < heated[w] for c, w in opposite)
        and all(same_side(c, colder[0]) > SAME_SIDE_COS for c in colder)
        and all(
            rise[s] > rise[d] + limit_K[d] for s, d in ordered if same_side(s, d) > SAME_SIDE_COS
        )
    )
    if is_uneven and (wrong or compare_sides):
        code = "junctions.uneven_disk"
        wrong = opposite
    elif not wrong:
        return []
    elif all(heated[s] > heated[d] - limit_K[d] for s, d in wrong):
        code = "junctions.uneven_start"
    else:
        code = "junctions.swapped"
    first, second = min(wrong, key=lambda pair: rise[pair[0]] - rise[pair[1]])
    finding = warning(
        code,
        subject=f"{prefix}{first}_degC",
        other=f"{prefix}{second}_degC",
        behind_K=rise[second] - rise[first],
        start_K=float(start[first] - start[second]),
        depth_mm=junction[first].depth_mm,
        other_depth_mm=junction[second].depth_mm,
    )
    return [finding]
