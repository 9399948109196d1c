"""From an EHL log and two disk records to what the heat-partition fits need, in SI units and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from calibration import Array
from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.finding import Finding, look
from calibration.log import COMPENSATED, Log
from calibration.record import DiskRecord
from calibration.rig import Rig, changed_keys
from tcdyn.contact import equal_radius_m, half_width_m, surface_speed_m_s
from tcdyn.partition.events import LEAST_ZERO, SETTLE_S, Events, contact_force, find_events
from tcdyn.traces import DiskTraces, bridged, disk_traces, gathered

MADE_OF = {"disk", "washer", "thermocouples"}  # tables of rig.toml that tell what a disk is


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
    ``exponent_half_range`` how far n may lie from ``speed_exponent``.
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


def prepare(
    log: Log,
    rig: Rig,
    records: Mapping[str, DiskRecord],
    friction_added: Callable[[float, float], FrictionAdded] | None = None,
) -> EhlTest:
    """Apply static lines, take out spikes, find the events, and turn friction and speeds into power.

    ``friction_added`` (load [N], slow shaft [rpm]) is added to the friction of the contact: half of the bearings'
    friction (section 2.10), which the transducer on the slow shaft does not see.
    Raises InputError for a log without unloading, a compensated log, a missing record or a load that is not one.
    """
    where = log.path.name
    if log.metadata.get("tcdyn") == COMPENSATED:
        raise InputError(
            "this log is already compensated",
            where=where,
            remedy="give the log as it was recorded: the fits compensate it",
        )
    missing = [d for d in DISKS if d not in records]
    if missing:
        wanted = f"records={missing[0]}.disk.json"
        raise InputError(f"no record of the {missing[0]} disk", remedy=f"add {wanted}", parameters=(wanted,))
    others = {d: _other_disk(rig, d, records[d]) for d in DISKS}
    frame = log.frame
    t = frame["time_s"].to_numpy(dtype=float)
    dt = float(np.median(np.diff(t)))
    events = find_events(frame, where)
    load, friction = (
        contact_force(t, frame[f"{force}_N"].to_numpy(dtype=float), events) for force in ("load", "friction")
    )
    found = [*gathered(log.findings), *events.findings]
    under_load = (t > events.load_on_s + 5) & (t < events.unload_s - 0.5)
    radius = [rig.disk_setup(d).outer_radius_m for d in DISKS]
    rpm = [float(np.nanmedian(frame[f"speed_{d}_rpm"].to_numpy(dtype=float)[under_load])) for d in DISKS]
    speeds = (surface_speed_m_s(rpm[0], radius[0]), surface_speed_m_s(rpm[1], radius[1]))
    if not speeds[0] > speeds[1] > 0:
        raise InputError(
            f"surface speeds {speeds[0]:.2f} (fast) and {speeds[1]:.2f} m/s (slow)",
            where=where,
            expected="a fast disk that is faster than the slow one",
            remedy="check speed_fast_rpm and speed_slow_rpm, or the [columns] of rig.toml",
        )
    ratio, nominal = speeds[0] / speeds[1], rig.common.contact.gear_ratio
    if abs(ratio / nominal - 1) > 0.05:
        found.append(look("speeds.ratio", ratio=ratio, stated=nominal))
    if np.sum(t < events.load_on_s - SETTLE_S) < LEAST_ZERO:
        found.append(look("forces.one_zero"))
    steady = (t > events.unload_s - 150) & (t < events.unload_s - 1) & under_load
    load_N, friction_N = float(np.mean(load[steady])), float(np.mean(friction[steady]))
    if load_N <= 0 or friction_N <= 0:
        raise InputError(
            f"load {load_N:.1f} N and friction {friction_N:.2f} N under contact",
            where=where,
            expected="both above zero",
        )
    added = NOTHING_ADDED if friction_added is None else friction_added(load_N, rpm[1])
    friction, friction_N = friction + added.value_N * load / load_N, friction_N + added.value_N
    found += added.findings
    if not 0.002 < friction_N / load_N < 0.2:
        found.append(look("friction.coefficient", coefficient=friction_N / load_N))
    crown = [rig.disk_setup(d).crown_radius_m for d in DISKS]
    half_width = half_width_m(load_N, equal_radius_m(*radius), equal_radius_m(*crown))
    ambient, u = frame["ambient_degC"].to_numpy(dtype=float), rig.common.uncertainty
    disks = {}
    for d in DISKS:
        found += others[d]
        traces = disk_traces(frame, d, rig, records[d], rows=steady, where=where)
        found += [*traces.findings, *traces.outside_lines(f"{d} disk", steady)]
        friction_rel = float(np.hypot(traces.uncertainty.friction_rel, added.u_N / friction_N))
        disks[d] = replace(traces, uncertainty=traces.uncertainty.model_copy(update={"friction_rel": friction_rel}))
    return EhlTest(
        time_s=t,
        dt_s=dt,
        events=events,
        power_W=friction * (speeds[0] - speeds[1]),
        ambient_degC=bridged(ambient, np.isfinite(ambient)),
        load_N=load_N,
        friction_N=friction_N,
        speed_ratio=ratio,
        sliding_speed_m_s=speeds[0] - speeds[1],
        entraining_speed_m_s=0.5 * (speeds[0] + speeds[1]),
        half_width_m=half_width,
        speed_exponent=rig.common.contact.speed_exponent,
        exponent_half_range=0.5 * (u.speed_exponent_high - u.speed_exponent_low),
        disks=disks,
        findings=tuple(found),
        added=added,
    )


def _other_disk(rig: Rig, disk: str, record: DiskRecord) -> list[Finding]:
    """What rig.toml says of the disk that the record was not made with: its lags were found with other numbers."""
    if "setup" not in record.model_fields_set:
        return []
    own, stated = (tables.model_dump(include=MADE_OF) for tables in (record.setup, rig.tables(disk)))
    if own == stated:
        return []
    changed = changed_keys(own, stated)
    keys, was, now = ([str(x) for x in column] for column in zip(*changed))
    return [look("record.other_disk", subject=disk, keys=keys, record=was, rig=now)]
