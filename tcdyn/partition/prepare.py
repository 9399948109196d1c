"""Prepare a test: from a log, the rig and records to the input of all fits.

``prepare_test`` is the first step of every analysis of a test: of ``beta``, of a campaign, and of
the refinement of lags in ``compensate``. Limits of plausible conditions were chosen by judgement.
Guarded by ``tests/partition/test_left_out.py``, ``tests/partition/test_as_logged.py`` and
``tests/behaviour``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.partition.events import EhlTest, find_events
from tcdyn.partition.operating_conditions import (
    RowMask,
    check_no_copies,
    constants_rel_u,
    disk_air,
    forces_N,
    rig_constants,
    speeds_rpm,
)
from tcdyn.rig.contact import (
    MIN_ZERO_SAMPLES,
    NO_FRICTION_CORRECTION,
    SWITCHING_MARGIN_S,
    Events,
    FrictionCorrection,
    equivalent_radius_m,
    hertz_contact,
    relative_speed,
    surface_speed_m_s,
)
from tcdyn.rig.disk import DISKS, channels_left_out
from tcdyn.rig.log import COMPENSATED, Log, simulated_findings
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig, changed_keys
from tcdyn.rig.tables import Constant
from tcdyn.series.clock import mean_interval_s
from tcdyn.smoothing.traces import DiskTraces, disk_traces, summarise_spikes

# Tables of rig.toml that describe a disk: a change of them after the calibration gives a warning.
DISK_TABLES = {"disk", "washer", "thermocouples"}
# Ends of the keys of these tables that do not affect the lags.
LAG_INDEPENDENT_KEYS = (
    "angle_deg",
    "slope_per_K",
    "reference_degC",
)
# A change of speed after unloading is reported at this time [s]. Chosen by judgement.
SPEED_CHANGE_AT_S = 3.0
# Rows under load begin and end so long after the loading and before the unloading [s]; the steady
# rows are those of them in this time before the unloading [s]. Chosen by judgement.
AFTER_LOADING_S = 5.0
BEFORE_UNLOADING_S = 0.5
STEADY_S = (150.0, 1.0)
# The ratio of the surface speeds may differ from the gear ratio by this without a warning, and the
# friction coefficient may lie between these. Chosen by judgement.
MAX_RATIO_DIFFERENCE = 0.05
USUAL_FRICTION_COEFFICIENT = (0.002, 0.2)


def prepare_test(
    log: Log,
    rig: Rig,
    records: Mapping[str, DiskRecord],
    friction_added: Callable[[float, float], FrictionCorrection] | None = None,
    left_out: Mapping[str, str] | None = None,
    events: Events | None = None,
) -> EhlTest:
    """Turn a log into a test: static lines, spikes removed, events, friction and speeds to power.

    Parameters
    ----------
    log, rig, records
        The EHL log, the rig and the record of each disk in the log.
    friction_added
        Function of load [N] and slow shaft speed [rpm] that returns half of the bearings' friction
        (section 2.10). The transducer on the slow shaft does not see it; it is added here.
    left_out
        Channels to leave out, such as "fast_c", with the reason; empty where the user requested it.
    events
        Loading and unloading, if they are known already.

    Returns
    -------
    EhlTest
        Conditions of the test, heat flow and traces of each disk.

    Raises
    ------
    InputError
        For a log without unloading, a compensated log, a missing record, or impossible forces.

    Notes
    -----
    Load, friction and air are means of the steady rows. The heat is friction times the difference
    of the surface speeds, each with its change after unloading. Constants of rig.toml that replace
    a column widen the uncertainties of friction, half-width (by W^(1/3)) and speed exponent.

    The steady rows of the fits are others: ``tcdyn.partition.window.steady_start_s``. Guarded by
    ``tests/partition/test_as_logged.py`` and ``tests/behaviour``.
    """
    where = log.path.name
    frame = log.frame
    time_s = frame["time_s"].to_numpy(dtype=float)
    logged_disks = _logged_disks(log, records)
    events = events or find_events(frame, where)
    constants, constant_findings = rig_constants(frame, rig)
    under_load = time_s > events.load_on_s + AFTER_LOADING_S
    under_load &= time_s < events.unload_s - BEFORE_UNLOADING_S
    before_s = events.unload_s - time_s
    steady = (before_s < STEADY_S[0]) & (before_s > STEADY_S[1]) & under_load
    left_out = left_out or {}
    left_out_by_disk = channels_left_out(left_out, rig.setups)
    check_no_copies(frame, left_out, where)
    rpm, rpm_u = speeds_rpm(frame, under_load, constants)
    speeds = _speeds(frame, rig, constants, events, rpm, where)
    forces = _forces(frame, constants, events, steady, rpm[1], friction_added, where)
    load_rel, sliding_rel, ratio_rel = constants_rel_u(rpm, rpm_u, constants)
    ambient_u = constants["ambient_degC"].u if "ambient_degC" in constants else 0.0
    stated_u = {
        "friction_rel": sliding_rel,
        "half_width_rel": load_rel / 3,  # b ~ W^(1/3)
        "ambient_K": ambient_u,
    }
    setups = [rig.disk_setup(d) for d in DISKS]
    contact = hertz_contact(
        forces.load_N,
        equivalent_radius_m(*(setup.outer_radius_m for setup in setups)),
        equivalent_radius_m(*(setup.crown_radius_m for setup in setups)),
    )
    disks = {}
    air = {}
    disk_findings: list[Finding] = []
    for d in logged_disks:
        rig.disk_setup(d).check_junction_rows()
        traces = disk_traces(
            frame, d, rig, records[d], rows=steady, where=where, excluded=left_out_by_disk[d]
        )
        air[d], air_findings = disk_air(frame, d, rig, steady, constants)
        added_rel = forces.added.u_N / forces.friction_N
        disks[d] = replace(
            _with_wider_uncertainties(traces, stated_u, added_rel),
            setup=replace(traces.setup, flux=traces.setup.flux.at_pressure(contact.pressure_Pa)),
        )
        disk_findings += [
            *_changed_disk_findings(rig, d, records[d]),
            *traces.findings,
            *traces.extrapolation_findings(f"{d} disk", steady),
            *air_findings,
        ]
    fast_m_s = speeds.surface_m_s["fast"] * speeds.relative.get("fast", 1.0)
    slow_m_s = speeds.surface_m_s["slow"] * speeds.relative.get("slow", 1.0)
    exponent = rig.common.contact.speed_exponent
    uncertainty = rig.common.uncertainty
    half_range = 0.5 * (uncertainty.speed_exponent_high - uncertainty.speed_exponent_low)
    # of chi = ratio^n; the half-range of a uniform distribution is sqrt(3) standard uncertainties
    half_range_by_ratio = 3**0.5 * exponent * ratio_rel / math.log(speeds.ratio)
    return EhlTest(
        time_s=time_s,
        dt_s=mean_interval_s(time_s),
        events=events,
        power_W=forces.traction_N * (fast_m_s - slow_m_s),
        ambient_degC=air[logged_disks[0]].faces,
        air=air if rig.air_columns() else {},
        constants_u=stated_u,
        load_N=forces.load_N,
        friction_N=forces.friction_N,
        speed_ratio=speeds.ratio,
        sliding_speed_m_s=speeds.surface_m_s["fast"] - speeds.surface_m_s["slow"],
        entraining_speed_m_s=0.5 * (speeds.surface_m_s["fast"] + speeds.surface_m_s["slow"]),
        half_width_m=contact.major_m,
        speed_exponent=exponent,
        exponent_half_range=math.hypot(half_range, half_range_by_ratio),
        disks=disks,
        findings=(
            *simulated_findings(log),
            *summarise_spikes(log.findings),
            *(_left_out_finding(rig, c, why, left_out_by_disk) for c, why in left_out.items()),
            *events.findings,
            *constant_findings,
            *speeds.findings,
            *forces.findings,
            *disk_findings,
        ),
        added_friction=forces.added,
        relative_speed=speeds.relative,
        friction_noise_N=float(white_noise_sd(frame["friction_N"].to_numpy(dtype=float)[steady])),
    )


def _logged_disks(log: Log, records: Mapping[str, DiskRecord]) -> list[str]:
    """Names of the disks with channels in the log.

    Parameters
    ----------
    log, records
        As for :func:`prepare_test`.

    Raises
    ------
    InputError
        For a compensated log, or a disk without a record.
    """
    if log.metadata.get("tcdyn") == COMPENSATED:
        raise InputError(
            "this log is already compensated",
            where=log.path.name,
            remedy="give the log as it was recorded: the fits compensate it",
        )
    logged_disks = [d for d in DISKS if any(n.startswith(f"{d}_") for n in log.channels)]
    for d in logged_disks or DISKS:
        if d not in records:
            raise InputError(
                f"no record of the {d} disk",
                remedy="add {records}",
                parameters={"records": f"{d}.disk.json"},
            )
    return logged_disks


@dataclass(frozen=True)
class _Speeds:
    """Speeds of a test.

    Parameters
    ----------
    surface_m_s
        Surface speed of each disk under load.
    ratio
        Their ratio, fast to slow.
    relative
        Speed relative to that under load, (N,), of a disk whose speed changes.
    findings
        Findings about the speeds.
    """

    surface_m_s: Mapping[str, float]
    ratio: float
    relative: Mapping[str, Array]
    findings: tuple[Finding, ...]


def _speeds(
    frame: pd.DataFrame,
    rig: Rig,
    constants: Mapping[str, Constant],
    events: Events,
    rpm: Sequence[float],
    where: str,
) -> _Speeds:
    """Surface speeds under load and after it.

    Parameters
    ----------
    frame, rig
        Table of the log, and the rig.
    constants
        Constants of rig.toml that replace columns.
    events
        Loading and unloading.
    rpm
        Speed of both shafts under load [rpm], the fast shaft's first.
    where
        Location in messages.

    Raises
    ------
    InputError
        Where the fast disk is not the faster one.
    """
    findings = []
    surface_m_s = {
        d: surface_speed_m_s(level, rig.disk_setup(d).outer_radius_m)
        for d, level in zip(DISKS, rpm)
    }
    if not surface_m_s["fast"] > surface_m_s["slow"] > 0:
        raise InputError(
            f"surface speeds {surface_m_s['fast']:.2f} (fast) and {surface_m_s['slow']:.2f} m/s "
            "(slow)",
            where=where,
            expected="a fast disk that is faster than the slow one",
            remedy="check speed_fast_rpm and speed_slow_rpm, or the [columns] of rig.toml",
        )
    ratio = surface_m_s["fast"] / surface_m_s["slow"]
    nominal = rig.common.contact.gear_ratio
    if abs(ratio / nominal - 1) > MAX_RATIO_DIFFERENCE:
        findings.append(warning("speeds.ratio", ratio=ratio, stated=nominal))
    time_s = frame["time_s"].to_numpy(dtype=float)
    relative = {}
    for d, level in zip(DISKS, rpm):
        if f"speed_{d}_rpm" in constants:
            continue
        logged_rpm = frame[f"speed_{d}_rpm"].to_numpy(dtype=float)
        course = relative_speed(time_s, logged_rpm, events.unload_s, level)
        if course is None:
            findings.append(warning("speeds.missing", subject=d))
        elif np.any(course != 1):
            relative[d] = course
            after_s = float(min(SPEED_CHANGE_AT_S, time_s[-1] - events.unload_s))
            percent = 100 * float(np.interp(events.unload_s + after_s, time_s, course))
            n = rig.common.contact.speed_exponent
            findings.append(
                info("speeds.change", subject=d, percent=percent, after_s=after_s, exponent=n)
            )
    return _Speeds(surface_m_s, ratio, relative, tuple(findings))


@dataclass(frozen=True)
class _Forces:
    """Forces of a test.

    Parameters
    ----------
    load_N, friction_N
        Means of the steady rows, the friction with the correction.
    traction_N
        Friction with the correction, (N,), zero without contact.
    added
        The correction.
    findings
        Findings about the forces.
    """

    load_N: float
    friction_N: float
    traction_N: Array
    added: FrictionCorrection
    findings: tuple[Finding, ...]


def _forces(
    frame: pd.DataFrame,
    constants: Mapping[str, Constant],
    events: Events,
    steady: RowMask,
    slow_rpm: float,
    friction_added: Callable[[float, float], FrictionCorrection] | None,
    where: str,
) -> _Forces:
    """Load and friction, with the friction of the bearings.

    Parameters
    ----------
    frame
        Table of the log.
    constants
        Constants of rig.toml that replace columns.
    events
        Loading and unloading.
    steady
        Mask (N,) of the steady rows.
    slow_rpm
        Speed of the slow shaft [rpm].
    friction_added
        As for :func:`prepare_test`.
    where
        Location in messages.

    Raises
    ------
    InputError
        For forces that are not above zero, or more friction than load.
    """
    findings = []
    load, friction = forces_N(frame, events, steady, constants)
    time_s = frame["time_s"].to_numpy(dtype=float)
    if np.sum(time_s < events.load_on_s - SWITCHING_MARGIN_S) < MIN_ZERO_SAMPLES:
        findings.append(warning("forces.one_zero"))
    load_N = float(np.mean(load[steady]))
    friction_N = float(np.mean(friction[steady]))
    if not 0 < friction_N < load_N:
        raise InputError(
            f"load {load_N:.1f} N and friction {friction_N:.2f} N under contact",
            where=where,
            expected="both above zero, and less friction than load",
            remedy="is a sign turned round, a unit another, or are load_N and friction_N "
            "exchanged?",
        )
    added = NO_FRICTION_CORRECTION
    if friction_added is not None:
        added = friction_added(load_N, slow_rpm)
    findings += added.findings
    friction_N += added.value_N
    coefficient = friction_N / load_N
    lowest, highest = USUAL_FRICTION_COEFFICIENT
    if not lowest < coefficient < highest:
        findings.append(warning("friction.coefficient", coefficient=coefficient))
    traction_N = friction + added.value_N * load / load_N
    return _Forces(load_N, friction_N, traction_N, added, tuple(findings))


def _with_wider_uncertainties(
    traces: DiskTraces, stated_u: Mapping[str, float], added_friction_rel: float
) -> DiskTraces:
    """The traces with the uncertainties of stated constants and of the added friction.

    Parameters
    ----------
    traces
        Traces of the disk.
    stated_u
        Standard uncertainty by constants of rig.toml, by key of its [uncertainty].
    added_friction_rel
        Relative standard uncertainty by the friction of the bearings.
    """
    widened_u = {
        key: math.hypot(getattr(traces.uncertainty, key), extra_u)
        for key, extra_u in stated_u.items()
    }
    widened_u["friction_rel"] = math.hypot(widened_u["friction_rel"], added_friction_rel)
    return replace(traces, uncertainty=traces.uncertainty.model_copy(update=widened_u))


def _changed_disk_findings(rig: Rig, disk: str, record: DiskRecord) -> list[Finding]:
    """Warn if rig.toml describes another disk than the record: its lags hold for other numbers.

    Parameters
    ----------
    rig
        The rig.
    disk
        Name of the disk.
    record
        Its calibration record.

    Notes
    -----
    Only ``DISK_TABLES`` are compared, without ``LAG_INDEPENDENT_KEYS``. A new key of rig.toml that
    does not affect the lags must be added there.
    """
    if "setup" not in record.model_fields_set:
        return []
    recorded, current = (
        tables.model_dump(include=DISK_TABLES) for tables in (record.setup, rig.tables(disk))
    )
    if recorded == current or not (
        changed := [
            key
            for key in changed_keys(recorded, current)
            if not key[0].endswith(LAG_INDEPENDENT_KEYS)
        ]
    ):
        return []
    keys, recorded_values, current_values = ([str(x) for x in column] for column in zip(*changed))
    return [
        warning(
            "record.other_disk", subject=disk, keys=keys, record=recorded_values, rig=current_values
        )
    ]


def _left_out_finding(
    rig: Rig, name: str, why: str, left_out_by_disk: Mapping[str, Sequence[str]]
) -> Finding:
    """Report a channel that is left out, and what replaces it.

    Parameters
    ----------
    rig
        The rig.
    name
        The channel, such as "fast_c".
    why
        The reason; empty where the user requested it, which gives an info and not a warning.
    left_out_by_disk
        All channels left out, by disk.
    """
    disk, _, channel = name.rpartition("_")
    setup = rig.disk_setup(disk)
    names = setup.surrogate_weights(left_out_by_disk[disk]).get(channel, ())
    outer_channels = [c for c in setup.outer if c not in left_out_by_disk[disk]]
    details: dict[str, Any] = {
        "stand_ins": [*names] if channel in setup.inner else [],
        "kept": outer_channels,
    }
    return (warning if why else info)(
        "channel.left_out", subject=name, why=why or "as asked for", **details
    )
