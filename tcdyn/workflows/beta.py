"""Heat partition: from an EHL log and two records to beta by all methods, and beta.json.

``prepare_test`` is the first step of every analysis of a test (also of one disk, of a campaign and
of the refinement of lags in ``compensate``); ``estimate_beta`` is the command ``tcdyn beta``.
Limits of plausible conditions were chosen by judgement. Guarded by
``tests/partition/test_left_out.py``, ``tests/partition/test_as_logged.py`` and ``tests/behaviour``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn import campaign
from tcdyn.campaign.stages import read_stage
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.io.checksum import with_checksum
from tcdyn.partition.analyse import (
    WINDOW_S,
    Partition,
    analyse_corrected,
    apply_corrections,
    check_corrected,
    unusable_channel,
)
from tcdyn.partition.events import EhlTest, find_events
from tcdyn.rig.check_clock import sample_interval_s
from tcdyn.rig.columns import junction_columns
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
from tcdyn.rig.log import COMPENSATED, Log, iter_log
from tcdyn.rig.opened_log import missing_columns, rig_from_records
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig, changed_keys
from tcdyn.smoothing.traces import DiskTraces, disk_traces, summarise_spikes
from tcdyn.workflows.beta_tables import beta_file, estimates_table
from tcdyn.workflows.operating_conditions import (
    BearingFile,
    check_no_copies,
    constants_rel_u,
    disk_air,
    forces_N,
    rig_constants,
    speeds_rpm,
)

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


@dataclass(frozen=True)
class BetaRun(Result):
    """Result of one analysed test, with the log and the records that it came from.

    Parameters
    ----------
    log
        The log.
    partition
        The estimates.
    rig_sha256
        Fingerprint of rig and records; tests of a campaign must have the same.
    stages
        Number of tests in the log.
    records
        Record of each disk.
    with_profiles
        Whether beta.json holds the likelihood profiles of the joint fits, some 200 constrained
        fits.
    """

    log: Log
    partition: Partition
    rig_sha256: str
    stages: int = 1
    records: Mapping[str, DiskRecord] = field(default_factory=dict, repr=False)
    with_profiles: bool = False

    def __repr__(self) -> str:
        """Name of the log."""
        return f"<BetaRun of {self.log.path.name}; summary() says it in words>"

    @one_blas_thread
    def to_dict(self) -> dict[str, Any]:
        """The content of ``beta.json``, with its checksum.

        Its keys are those of ``tcdyn.workflows.beta_tables.beta_file`` and ``kept``, the sufficient
        statistics that a campaign combines, which needs both disks.
        """
        source = {"file": self.log.path.name, "sha256": self.log.sha256}
        data = beta_file(self.partition, source, self.with_profiles)
        data["kept"] = None
        if not self.partition.single_disk:
            data["kept"] = campaign.sufficient_statistics_of(
                self.log.path.stem, self.rig_sha256, self.partition
            )
        return with_checksum(data)

    def summary(self) -> str:
        """The recommended estimate and those by every method, in a few lines."""
        return summary_of(self.partition)

    def card(self) -> pd.DataFrame:
        """Table of the estimates of beta by every method."""
        return estimates_table(self.partition)


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
    Rows under load are from 5 s after loading to 0.5 s before unloading. Steady rows are those of
    them from 150 s to 1 s before unloading; load, friction and air are their means. The ratio of the
    surface speeds may differ by 5 % from the gear ratio without a warning. These numbers were chosen
    by judgement. The heat is friction times the difference of the surface speeds, each with its
    change after unloading. Constants of rig.toml that replace a column widen the uncertainties of
    friction, half-width (by W^(1/3)) and speed exponent.

    The steady rows of the fits are others: ``tcdyn.partition.window.steady_start_s``. Guarded by
    ``tests/partition/test_as_logged.py`` and ``tests/behaviour``.
    """
    where = log.path.name
    if log.metadata.get("tcdyn") == COMPENSATED:
        remedy = "give the log as it was recorded: the fits compensate it"
        raise InputError("this log is already compensated", where=where, remedy=remedy)
    measured_disks = [d for d in DISKS if any(n.startswith(f"{d}_") for n in log.channels)]
    if missing := [d for d in measured_disks or DISKS if d not in records]:
        raise InputError(
            f"no record of the {missing[0]} disk",
            remedy="add {records}",
            parameters={"records": f"{missing[0]}.disk.json"},
        )
    frame = log.frame
    t = log.frame["time_s"].to_numpy(dtype=float)
    dt = sample_interval_s(t)
    events = events or find_events(frame, where)
    constants, constant_findings = rig_constants(frame, rig)
    under_load = (t > events.load_on_s + 5) & (t < events.unload_s - 0.5)
    steady = (t > events.unload_s - 150) & (t < events.unload_s - 1) & under_load
    load, friction = forces_N(frame, events, steady, constants)
    left_out_by_disk = channels_left_out(left_out := left_out or {}, rig.setups)
    check_no_copies(frame, left_out, where)
    findings = [
        *summarise_spikes(log.findings),
        *(_left_out_finding(rig, name, why, left_out_by_disk) for name, why in left_out.items()),
    ]
    findings += [*events.findings, *constant_findings]
    radius, crown = zip(*((s.outer_radius_m, s.crown_radius_m) for s in map(rig.disk_setup, DISKS)))
    rpm, rpm_u = speeds_rpm(frame, under_load, constants)
    speeds = (surface_speed_m_s(rpm[0], radius[0]), surface_speed_m_s(rpm[1], radius[1]))
    if not speeds[0] > speeds[1] > 0:
        raise InputError(
            f"surface speeds {speeds[0]:.2f} (fast) and {speeds[1]:.2f} m/s (slow)",
            where=where,
            expected="a fast disk that is faster than the slow one",
            remedy="check speed_fast_rpm and speed_slow_rpm, or the [columns] of rig.toml",
        )
    ratio = speeds[0] / speeds[1]
    nominal = rig.common.contact.gear_ratio
    if abs(ratio / nominal - 1) > 0.05:
        findings.append(warning("speeds.ratio", ratio=ratio, stated=nominal))
    if np.sum(t < events.load_on_s - SWITCHING_MARGIN_S) < MIN_ZERO_SAMPLES:
        findings.append(warning("forces.one_zero"))
    load_N = float(np.mean(load[steady]))
    friction_N = float(np.mean(friction[steady]))
    if not 0 < friction_N < load_N:
        raise InputError(
            f"load {load_N:.1f} N and friction {friction_N:.2f} N under contact",
            where=where,
            expected="both above zero, and less friction than load",
            remedy="is a sign turned round, a unit another, or are load_N and friction_N exchanged?",
        )
    added = NO_FRICTION_CORRECTION if friction_added is None else friction_added(load_N, rpm[1])
    friction = friction + added.value_N * load / load_N
    friction_N = friction_N + added.value_N
    findings += added.findings
    speed_profiles = {}
    for d, level in zip(DISKS, rpm):
        if f"speed_{d}_rpm" in constants:
            continue
        profile = relative_speed(
            t, frame[f"speed_{d}_rpm"].to_numpy(dtype=float), events.unload_s, level
        )
        if profile is None:
            findings.append(warning("speeds.missing", subject=d))
        elif np.any(profile != 1):
            speed_profiles[d] = profile
            at = float(min(SPEED_CHANGE_AT_S, t[-1] - events.unload_s))
            percent = 100 * float(np.interp(events.unload_s + at, t, profile))
            n = rig.common.contact.speed_exponent
            findings.append(
                info("speeds.change", subject=d, percent=percent, after_s=at, exponent=n)
            )
    if not 0.002 < friction_N / load_N < 0.2:
        findings.append(warning("friction.coefficient", coefficient=friction_N / load_N))
    contact = hertz_contact(load_N, equivalent_radius_m(*radius), equivalent_radius_m(*crown))
    u = rig.common.uncertainty
    (load_rel, sliding_rel, ratio_rel) = constants_rel_u(rpm, rpm_u, constants)
    air_and_findings = {d: disk_air(frame, d, rig, steady, constants) for d in measured_disks}
    disks = dict[str, DiskTraces]()
    air = {d: a for d, (a, _) in air_and_findings.items()}
    stated_u = {"friction_rel": sliding_rel, "half_width_rel": load_rel / 3}  # b ~ W^(1/3)
    stated_u["ambient_K"] = constants["ambient_degC"].u if "ambient_degC" in constants else 0.0

    traces_by_disk = {
        d: disk_traces(
            frame, d, rig, records[d], rows=steady, where=where, excluded=left_out_by_disk[d]
        )
        for d in measured_disks
    }
    for d, traces in traces_by_disk.items():
        rig.disk_setup(d).check_junction_rows()
        findings += [
            *_changed_disk_findings(rig, d, records[d]),
            *traces.findings,
            *traces.extrapolation_findings(f"{d} disk", steady),
        ]
        findings += air_and_findings[d][1]
        widened_u = {
            key: math.hypot(getattr(traces.uncertainty, key), extra_u)
            for key, extra_u in stated_u.items()
        }
        widened_u["friction_rel"] = math.hypot(widened_u["friction_rel"], added.u_N / friction_N)
        setup = replace(traces.setup, flux=traces.setup.flux.at_pressure(contact.pressure_Pa))
        disks[d] = replace(
            traces, uncertainty=traces.uncertainty.model_copy(update=widened_u), setup=setup
        )
    return EhlTest(
        time_s=t,
        dt_s=dt,
        events=events,
        power_W=friction
        * (
            speeds[0] * speed_profiles.get("fast", 1.0)
            - speeds[1] * speed_profiles.get("slow", 1.0)
        ),
        ambient_degC=air[measured_disks[0]].faces,
        air=air if rig.air_columns() else {},
        constants_u=stated_u,
        load_N=load_N,
        friction_N=friction_N,
        speed_ratio=ratio,
        sliding_speed_m_s=speeds[0] - speeds[1],
        entraining_speed_m_s=0.5 * (speeds[0] + speeds[1]),
        half_width_m=contact.major_m,
        speed_exponent=rig.common.contact.speed_exponent,
        exponent_half_range=math.hypot(
            0.5 * (u.speed_exponent_high - u.speed_exponent_low),
            3**0.5
            * rig.common.contact.speed_exponent
            * ratio_rel
            / math.log(ratio),  # chi = ratio^n
        ),
        disks=disks,
        findings=tuple(findings),
        added_friction=added,
        relative_speed=speed_profiles,
        friction_noise_N=float(white_noise_sd(frame["friction_N"].to_numpy(dtype=float)[steady])),
    )


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


@one_blas_thread
def estimate_beta(
    log: str | Path,
    rig: Rig | None,
    records: Mapping[str, DiskRecord],
    *,
    without: Sequence[str] = (),
    window_s: float = WINDOW_S,
    seed: int = 0,
    sensor_check: bool = True,
    bearing: BearingFile | None = None,
    stage: int | None = None,
    profiles: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> BetaRun:
    """Read one EHL log and estimate beta by the speed law, the cooling fits and the joint fits.

    Parameters
    ----------
    log, rig, records
        The log, the rig (None: the one that the records were made with) and a record of each disk.
        For a log of one disk give its record only; speed law and fit of both disks are then
        missing.
    without
        Channels to leave out, such as "fast_c".
    window_s
        Length of cooling that the h-only fit uses [s].
    seed
        Seed of the Monte Carlo samples.
    sensor_check
        Whether to run the sensor check.
    bearing
        Pure-rolling test whose friction is added (section 2.10).
    stage
        Which of several loadings in the log, from 1; None for the longest.
    profiles
        Whether beta.json holds the likelihood profiles of the joint fits.
    progress
        Called with the name of each stage.

    Raises
    ------
    InputError
        For a log, rig or record that does not fit. The message names the log.

    Notes
    -----
    A channel that is dead, missing or lost for long is left out too, with a finding, as long as the
    remaining channels determine beta. Both speeds are needed for one disk, too: the heat is
    friction times sliding speed.
    """
    rig = rig or rig_from_records(records)
    skipped = _columns_without_record(log, rig, records)
    left_out = LeftOut.by_user(without, rig)
    progress("reading the log")
    table, count, left_out = _read_without_lost_channels(log, rig, stage, skipped, left_out)

    def corrected_test() -> EhlTest:
        """The test without the channels left out, ready for the fits."""
        added = bearing.friction_added if bearing else None
        return apply_corrections(prepare_test(table, rig, records, added, left_out.reasons))

    test = corrected_test()
    sensors = None
    try:
        if sensor_check:
            progress("sensor map")
            sensors = check_corrected(test)
            problem = unusable_channel(sensors)
            while problem is not None:
                left_out = left_out.with_channel_of(problem, rig)
                test = corrected_test()
                sensors = check_corrected(test)
                problem = unusable_channel(sensors)
        partition = analyse_corrected(
            test, sensors, window_s=window_s, seed=seed, progress=progress
        )
    except InputError as problem:
        raise problem.at(table.path.name) from None
    logged_disks = [d for d in DISKS if d in records]
    fingerprint = campaign.rig_fingerprint(rig, records, logged_disks)
    return BetaRun(table, partition, fingerprint, count, records, profiles)


def estimate_one_disk(
    log: str | Path, rig: Rig | None, records: Mapping[str, DiskRecord], **options: Any
) -> BetaRun:
    """:func:`estimate_beta` of a log of one disk, as version 0.2 called it.

    Parameters
    ----------
    log, rig, options
        As for :func:`estimate_beta`.
    records
        The record of one disk.
    """
    return estimate_beta(log, rig, records, **options)


def _columns_without_record(
    log: str | Path, rig: Rig, records: Mapping[str, DiskRecord]
) -> list[str]:
    """Channels of the disk without a record, which a log of one disk must not have.

    Parameters
    ----------
    log, rig, records
        As for :func:`estimate_beta`.

    Raises
    ------
    InputError
        If the log has such a column.
    """
    others = [d for d in DISKS if d not in records]
    if len(others) != 1:
        return []
    (other,) = others
    columns = [*junction_columns(rig.disk_setup(other).channels, other)]
    if missing_columns(log, rig, columns) != columns:
        raise InputError(
            f"no record of the {other} disk, whose columns the log holds",
            where=Path(log).name,
            remedy="add {records}",
            parameters={"records": f"{other}.disk.json"},
        )
    return columns


@dataclass(frozen=True)
class LeftOut:
    """Channels that an analysis does not use.

    Parameters
    ----------
    reasons
        Reason for each channel such as "fast_c"; empty where the user asked for it.
    first_problem
        The error of the first channel that was lost.
    """

    reasons: Mapping[str, str]
    first_problem: InputError | None = None

    @classmethod
    def by_user(cls, without: Sequence[str], rig: Rig) -> LeftOut:
        """The channels that the user does not want.

        Parameters
        ----------
        without
            Channels such as "fast_c" or "fast_c_degC".
        rig
            The rig.

        Raises
        ------
        InputError
            For a channel that does not exist, or too few channels left.
        """
        channels_left_out(without, rig.setups)
        return cls(dict.fromkeys((name.removesuffix("_degC") for name in without), ""))

    def with_channel_of(self, problem: InputError, rig: Rig) -> LeftOut:
        """Leave out the channel that an error names, too.

        Parameters
        ----------
        problem
            The error.
        rig
            The rig.

        Raises
        ------
        InputError
            If it names no channel, or if the others do not determine beta: then the first error,
            which names the cause best.
        """
        lost_channel = problem.column.removesuffix("_degC")
        disk, _, channel = lost_channel.rpartition("_")
        first_problem = self.first_problem or problem
        if not problem.column:
            raise problem
        if lost_channel in self.reasons or disk not in DISKS:
            raise first_problem
        missing = (*channels_left_out(self.reasons, rig.setups).get(disk, ()), channel)
        if not rig.disk_setup(disk).determines_beta(missing):
            raise first_problem
        return LeftOut({**self.reasons, lost_channel: problem.what}, first_problem)


def _read_without_lost_channels(
    log: str | Path, rig: Rig, stage: int | None, skipped: Sequence[str], left_out: LeftOut
) -> tuple[Log, int, LeftOut]:
    """Read a log, without each channel that the reader cannot use.

    Parameters
    ----------
    log, rig, stage
        As for :func:`estimate_beta`.
    skipped
        Columns that are not read.
    left_out
        Channels that the user leaves out.

    Returns
    -------
    log, count
        The test, and the number of tests in the log.
    left_out
        The channels left out.

    Raises
    ------
    InputError
        As the reader does, if the error names no channel, or too many are lost.

    Notes
    -----
    The reader checks a log while it reads it, and stops at the first channel that is missing, dead
    or lost for long. Guarded by ``tests/partition/test_left_out.py``.
    """
    while True:
        columns = [f"{name}_degC" for name in left_out.reasons]
        try:
            table, count = read_stage(
                iter_log(log, "ehl", rig, without=[*skipped, *columns]), stage
            )
        except InputError as problem:
            left_out = left_out.with_channel_of(problem, rig)
        else:
            return table, count, left_out


def estimate_stages(
    log: str | Path, rig: Rig | None, records: Mapping[str, DiskRecord], **options: Any
) -> tuple[BetaRun, ...]:
    """Analyse every loading of one log that an unloading follows, in order.

    Parameters
    ----------
    log, rig, records
        As for ``estimate_beta``.
    options
        Further arguments of ``estimate_beta``.

    Returns
    -------
    tuple
        One run for each test in the log.
    """
    first = estimate_beta(log, rig, records, stage=1, **options)
    report = options.pop("progress", lambda _: None)
    runs = [first]
    for k in range(2, first.stages + 1):
        prefix = f"test {k} of {first.stages}"

        def progress(what: str, prefix: str = prefix) -> None:
            """Report a stage with the number of its test in front."""
            report(f"{prefix}: {what}")

        runs.append(estimate_beta(log, rig, records, stage=k, progress=progress, **options))
    return tuple(runs)


def summary_of(p: Partition) -> str:
    """Recommended estimate, beta, h and lag by every method, and the cross-check, as text."""
    lines = {}
    if not p.single_disk:
        pair = "beta {}   h_fast {}   h_slow {} W/m2K"
        combined = p.combined.estimates
        lines["both beta"] = (
            "both disks",
            pair.format(combined["beta"], combined["h_fast"], combined["h_slow"]),
        )
        lines["speed law"] = (
            "speed law",
            pair.format(p.estimates["speed law"], p.estimates["h_fast"], p.estimates["h_slow"]),
        )
    for kind in ("cooling", "joint"):
        for d, fit in p.joint.items():
            key = f"{kind} {d}"
            text = f"beta {p.estimates[key]}   h {p.estimates[f'h {key}']} W/m2K"
            if kind == "joint":
                text += f"   lag {fit.estimates['lag_s']} s"
            lines[key] = (key, text)
    rows = [
        f"{word:14}{'withheld' if key in p.impossible else text}"
        for key, (word, text) in lines.items()
    ]
    return "\n".join([p.recommendation.sentence, *rows, p.crosscheck.sentence])
