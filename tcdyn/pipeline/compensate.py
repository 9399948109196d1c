"""A whole log through static lines and chains: the temperatures at the junctions, with a standard deviation each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd

from calibration.columns import EHL_RUNNING, TORQUES, couples
from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.estimate import with_u
from calibration.finding import Finding, graded, look, note, sentences
from calibration.lines.static import shared_u_K
from calibration.log import COMPENSATED, Log, read_log
from calibration.noise import white_noise_sd
from calibration.opened import columns_not_there, log_kind, refuse_spare_records
from calibration.record import DiskRecord
from calibration.result import Result
from calibration.rig import Rig
from tcdyn.compensate.intensity import Criterion
from tcdyn.compensate.inverse import BeforeUse, before_use, invert, proper_inverse
from tcdyn.compensate.record import Compensated
from tcdyn.compensate.smoother import deconvolve, smooth
from tcdyn.compensate.windows import over_window
from tcdyn.partition.analyse import refine_lags
from tcdyn.partition.cooling import refined_chains, with_common_u
from tcdyn.partition.events import find_events
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.steady import at_one_radius
from tcdyn.pipeline.beta import prepare
from tcdyn.traces import NOISE_ORDER, DiskTraces, disk_traces, gathered, rig_of

DECIMALS = 5  # 0.01 mK: far below what any sample is known to
NOISE_ONLY = "noise removed (smoother), static lines applied, lag left in"
Method = Literal["smoother", "deconvolve", "inverse", "noise-only"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True)
class Way:
    """How a log is compensated.

    ``method``: "smoother"; "deconvolve" with its ``criterion``; "inverse" of ``bandwidth_Hz``; or "noise-only", the
    smoother with an empty chain, which leaves the lag in.
    """

    method: Method = "smoother"
    criterion: Criterion = "gcv"
    bandwidth_Hz: float = 0.5

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method {self.method!r}", expected=" or ".join(METHODS))

    @property
    def removes_lag(self) -> bool:
        """Whether the answer is the temperature at the junction."""
        return self.method != "noise-only"


@dataclass(frozen=True)
class CompensatedLog(Result):
    """The log with junction temperatures in place of readings, a column ``<channel>_u_K`` for each, and its notes.

    Where the parts were asked for, ``<channel>_noise_u_K`` is what differs from sample to sample, and
    ``<channel>_common_u_K`` what moves all channels of a disk together: the common lag and the oven's reference.

    ``traces``: what went into the compensator, chains as they were used; ``events_s``: when slopes may jump [s after
    the first sample], the last the unloading. Where only noise was removed there is no column ``_u_K``.
    """

    frame: pd.DataFrame
    metadata: dict[str, str]
    findings: tuple[Finding, ...]
    disks: Mapping[str, Compensated]
    traces: Mapping[str, DiskTraces]
    events_s: tuple[float, ...]
    raw: Log
    way: Way

    def __repr__(self) -> str:
        return f"<CompensatedLog of {self.raw.path.name}, {len(self.frame)} rows; summary() says it in words>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed, in words."""
        return sentences(self.findings)

    def summary(self) -> str:
        """The lag removed and what is left uncertain, a few lines a disk."""
        lines = []
        for disk, done in self.disks.items():
            lines += [f"{disk}: common lag {self.metadata[f'{disk}_common_lag_s']}"] if self.way.removes_lag else []
            lines += done.lines(self.traces[disk].setup.channels)
        return "\n".join([*lines, *graded(self.findings)])

    def to_dict(self) -> dict[str, Any]:
        """Metadata, warnings and what each channel is worth; the samples are in ``frame``."""
        disks = {disk: done.to_dict() for disk, done in self.disks.items()}
        return {"metadata": dict(self.metadata), "disks": disks, "warnings": list(self.warnings)}

    def as_log(self) -> Log:
        """The compensated log as :func:`calibration.log.read_log` would give it, standard deviations left out."""
        frame = self.frame[[c for c in self.frame.columns if not c.endswith("_u_K")]]
        return replace(self.raw, frame=frame, metadata=dict(self.metadata), findings=self.findings)

    def card(self) -> pd.DataFrame:
        """Noise and standard deviation of every channel."""
        return pd.concat([d.card().assign(disk=disk) for disk, d in self.disks.items()], ignore_index=True)

    def channels(self, disk: str) -> list[str]:
        """What the channels of ``disk`` are called in the log, without their unit."""
        return [name.removesuffix("_degC") for name in self.traces[disk].columns]

    def before_use(self, disk: str) -> BeforeUse:
        """The report on the proper inverse of this log's bandwidth, for the noisiest channel of ``disk``."""
        noise, dt = self.disks[disk].noise_sd, self._dt_s
        inverses = [proper_inverse(chain, dt, self.way.bandwidth_Hz) for chain in self.traces[disk].chains]
        worst = int(np.argmax([f.noise_gain * sd for f, sd in zip(inverses, noise)]))
        return before_use(inverses[worst], float(noise[worst]))

    def covariance(self, length_s: float, start_s: float | None = None) -> dict[str, Any]:
        """Covariance between samples, and between the channels' means: see ``tcdyn.compensate.windows.over_window``."""
        time_s = self.frame["time_s"].to_numpy(dtype=float)
        return over_window(self.raw.path.name, time_s, self.events_s, self.traces, self.disks, length_s, start_s)

    @property
    def _dt_s(self) -> float:
        return float(np.median(np.diff(self.frame["time_s"].to_numpy(dtype=float))))


def compensate_log(
    log: str | Path,
    records: Mapping[str, DiskRecord],
    rig: Rig | None = None,
    *,
    refine: bool = True,
    way: Way | None = None,
    parts: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> CompensatedLog:
    """Compensate every channel of an EHL log that a record covers, or of an immersion log, which takes one record.

    The log's own metadata is carried over.
    ``refine``: where the log holds an unloading and the records of all its disks are given, the lag common to a disk's
    channels, which a plunge knows loosely, is taken from the unloading with the record as prior; else the record's own.
    ``way``: the compensator, the smoother unless told; ``parts``: columns of what each uncertainty is made of, too.
    Raises InputError for a log that is compensated already, or one that no record covers.
    """
    if not records:
        raise InputError(
            "no record was given", remedy="add records=DISK.disk.json", parameters=("records=DISK.disk.json",)
        )
    rig, way = rig or rig_of(records), way or Way()
    progress("reading the log")
    kind, own = log_kind(log, rig, records)
    if kind == "ehl":
        refuse_spare_records(log, rig, records)
    gone, unused = _not_there(log, rig, records) if kind == "ehl" else ([], [])
    table = read_log(log, kind, rig, own, parted=False, without=gone)
    here = {d for d in DISKS if any(n.startswith(f"{d}_") for n in table.channels)}
    notes = {**table.metadata, "tcdyn": COMPENSATED, "source": table.path.name, "source_sha256": table.sha256}
    notes |= {} if way.removes_lag else {"method": NOISE_ONLY}
    findings, known = [*gathered(table.findings)], dict[float, float]()
    if refine and unused and way.removes_lag:
        refine = False
        findings.append(look("compensate.unrefined", problem=f"the log holds no {', '.join(unused)}"))
    if kind == "ehl":
        try:
            events = find_events(table.frame, table.path.name)
            known = {events.load_on_s: 0.0} | dict.fromkeys(events.kinks_s, events.unload_u_s)
        except InputError as problem:  # slopes that jump are found by the smoother
            findings += [look("compensate.unrefined", problem=str(problem))] if way.removes_lag and refine else []
            refine = False
        other = next(iter(records))
        findings += [
            note("compensate.one_disk", subject=d, other=other) for d in DISKS if d in here and d not in records
        ]
    traces: dict[str, DiskTraces] = {}
    fits: Mapping[str, DiskFit] = {}
    if refine and way.removes_lag and kind == "ehl" and here <= set(records):
        progress("common lags from the unloading")
        traces, fits, said = _refined(table, rig, records)
        findings += said
    frame, done = table.frame.copy(), {}
    for disk, record in records.items():
        progress(f"{disk} disk")
        one = traces.get(disk) or disk_traces(
            frame, disk, rig, record, named=kind == "ehl", where=table.path.name, lag=way.removes_lag
        )
        if way.removes_lag:
            one, notes[f"{disk}_common_lag_s"] = _with_lag(one, record, fits.get(disk))
        for name, sd in one.noise.to_dict().items():
            notes[f"{disk}_noise_{name}"] = f"{sd:.3g}"
        traces[disk], done[disk] = one, _one_disk(one, table, known, way)
        for i, column in enumerate(one.columns):
            frame[column] = np.round(done[disk].temperature[:, i], DECIMALS)
            if way.removes_lag:
                frame[column.replace("_degC", "_u_K")] = np.round(done[disk].sd[:, i], DECIMALS)
            if way.removes_lag and parts:
                common = np.hypot(done[disk].common_sd()[:, i], shared_u_K(one.lines)[i])
                frame[column.replace("_degC", "_noise_u_K")] = np.round(done[disk].sd_noise[:, i], DECIMALS)
                frame[column.replace("_degC", "_common_u_K")] = np.round(common, DECIMALS)
        findings += [f.at(disk) for f in (*done[disk].findings, *one.outside_lines("the log"))]
        findings += one.findings
    begun = float(frame["time_s"].iloc[0])
    events_s = sorted(t - begun for t in known if t > begun) or [t for t, _ in next(iter(done.values())).events_s]
    return CompensatedLog(frame, notes, tuple(findings), done, traces, tuple(events_s), table, way)


def _not_there(log: str | Path, rig: Rig, records: Mapping[str, DiskRecord]) -> tuple[list[str], list[str]]:
    """Columns of an EHL log that are neither there nor needed: of a disk without a record, and of what the unloading
    alone would be fitted with; these once more."""
    lone = [couples(rig.disk_setup(d).channels, d) for d in DISKS if d not in records]
    junctions = [c for columns in lone if len(columns_not_there(log, rig, columns)) == len(columns) for c in columns]
    running = columns_not_there(log, rig, [*EHL_RUNNING, *TORQUES, "ambient_degC", *rig.air_columns()])
    torque = not set(TORQUES) <= set(running)
    needless = {"contact", *TORQUES, *rig.stated(), *(["friction_N"] if torque else [])}
    unused = columns_not_there(log, rig, [c for c in running if c not in needless], alike=True)
    return [*junctions, *unused], unused


def _refined(
    table: Log, rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[dict[str, DiskTraces], Mapping[str, DiskFit], list[Finding]]:
    """Traces of both disks and joint fits for their lags; what could not be had is empty, and why is said."""
    traces: dict[str, DiskTraces] = {}
    try:
        test = prepare(table, rig, records)
        traces = dict(test.disks)
        return traces, refine_lags(at_one_radius(test)), []
    except InputError as problem:
        return traces, {}, [look("compensate.unrefined", problem=str(problem))]


def _with_lag(traces: DiskTraces, record: DiskRecord, fit: DiskFit | None) -> tuple[DiskTraces, str]:
    """The traces with the common lag of the fit, if there is one, and what to note of it."""
    if fit is not None:
        lag = fit.estimates["lag_s"]
        chains = refined_chains(traces.chains, fit.chain)
        traces = replace(traces, chains=chains, lag_covariance_s2=with_common_u(traces.lag_covariance_s2, lag.u))
        return traces, f"{with_u(lag.value, lag.u)} s, from the unloading, record as prior"
    assert record.chain is not None
    common = record.chain.common_lag_s
    return traces, f"{with_u(common.value, common.u)} s, from the record"


def _one_disk(traces: DiskTraces, table: Log, events: Mapping[float, float], way: Way) -> Compensated:
    """One disk's traces; ``events``: time [s] of each and its uncertainty [s]."""
    time = table.frame["time_s"].to_numpy(dtype=float)
    y, dt = traces.measured_degC, float(np.median(np.diff(time)))
    given: dict[str, Any] = {
        "noise_sd": traces.noise_K if traces.noise.coloured or traces.noise.lines else white_noise_sd(y, NOISE_ORDER),
        "lag_covariance": traces.lag_covariance_s2,
        "static_u": np.hypot(traces.static_u(traces.readings_degC), shared_u_K(traces.lines)),
        "names": [c.removesuffix("_degC") for c in traces.columns],
    }
    if way.method != "inverse":
        given["split_u_s"] = traces.split_u_s
    if way.method == "deconvolve":
        return deconvolve(y, dt, traces.chains, criterion=way.criterion, **given)[0]
    if way.method == "inverse":
        return invert(y, dt, traces.chains, way.bandwidth_Hz, **given)
    known = tuple(float(e - time[0]) for e in events)
    return smooth(y, dt, traces.chains, events_s=known, event_u_s=tuple(events.values()), **given)
