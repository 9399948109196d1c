"""A whole log through static lines and chains: the temperatures at the junctions, with a standard deviation each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from calibration.columns import KNOWN, recognise
from calibration.disk import CHANNELS, DISKS
from calibration.errors import InputError
from calibration.estimate import with_u
from calibration.files import open_table, shown
from calibration.finding import look, sentences
from calibration.log import COMPENSATED, Log, read_log
from calibration.record import DiskRecord
from calibration.result import Result
from calibration.rig import Rig
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth
from tcdyn.partition.effects import with_common_u
from tcdyn.partition.events import find_events
from tcdyn.partition.joint import DiskFit, refine_lags, refined_chains
from tcdyn.partition.prepare import prepare
from tcdyn.partition.steady import at_one_radius
from tcdyn.pipeline.records import rig_of
from tcdyn.traces import DiskTraces, disk_traces, gathered, white_noise

DECIMALS = 5  # 0.01 mK: far below what any sample is known to


@dataclass(frozen=True)
class CompensatedLog(Result):
    """The log with junction temperatures in place of readings, a column ``<channel>_u_K`` for each, and its notes."""

    frame: pd.DataFrame
    metadata: dict[str, str]
    warnings: tuple[str, ...]
    disks: Mapping[str, Compensated]
    raw: Log

    def __repr__(self) -> str:
        return f"<CompensatedLog of {self.raw.path.name}, {len(self.frame)} rows; summary() says it in words>"

    def summary(self) -> str:
        """The lag removed and what is left uncertain, a few lines a disk."""
        lines = []
        for disk, done in self.disks.items():
            lines.append(f"{disk}: common lag {self.metadata[f'{disk}_common_lag_s']}")
            lines += done.summary(CHANNELS).splitlines()
        return "\n".join(dict.fromkeys([*lines, *(f"warning: {w}" for w in self.warnings)]))

    def to_dict(self) -> dict[str, Any]:
        """Metadata, warnings and what each channel is worth; the samples are in ``frame``."""
        disks = {disk: done.to_dict() for disk, done in self.disks.items()}
        return {"metadata": dict(self.metadata), "disks": disks, "warnings": list(self.warnings)}

    def as_log(self) -> Log:
        """The compensated log as :func:`calibration.log.read_log` would give it, standard deviations left out."""
        frame = self.frame[[c for c in self.frame.columns if not c.endswith("_u_K")]]
        return replace(
            self.raw,
            frame=frame,
            metadata=dict(self.metadata),
            findings=tuple(look("said", text=w) for w in self.warnings),
        )

    def card(self) -> pd.DataFrame:
        """Noise and standard deviation of every channel."""
        return pd.concat([d.card().assign(disk=disk) for disk, d in self.disks.items()], ignore_index=True)


def compensate_log(
    log: str | Path,
    records: Mapping[str, DiskRecord],
    rig: Rig | None = None,
    *,
    refine: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> CompensatedLog:
    """Compensate every channel of an EHL log that a record covers, or of an immersion log, which takes one record.

    The log's own metadata is carried over.
    ``refine``: where the log holds an unloading and both records are given, the lag common to a disk's channels, which
    a plunge knows loosely, is taken from the unloading with the record as prior; otherwise the record's own is used.
    Raises InputError for a log that is compensated already, or one that no record covers.
    """
    if not records:
        raise InputError("no record was given", remedy="add --record DISK.disk.json")
    rig = rig or rig_of(records)
    progress("reading the log")
    kind, own = log_kind(log, rig, records)
    table = read_log(log, kind, rig, own)
    frame = table.frame.copy()
    time = frame["time_s"].to_numpy(dtype=float)
    dt = float(np.median(np.diff(time)))
    warnings = list(sentences(gathered(table.findings)))
    notes = {**table.metadata, "tcdyn": COMPENSATED, "source": table.path.name, "source_sha256": table.sha256}
    known: dict[float, float] = {}
    if kind == "ehl":
        events = find_events(frame, table.path.name)
        known = {events.load_on_s: 0.0} | dict.fromkeys(events.kinks_s, events.unload_u_s)
        for disk in (d for d in DISKS if d not in records):
            other = next(iter(records))
            warnings.append(
                f"no record of the {disk} disk was given: its columns are as logged, and the lag common to the {other} "
                f"disk is the record's, which an unloading would tell better; add --record {disk}.disk.json"
            )
    traces: Mapping[str, DiskTraces] = {}
    fits: Mapping[str, DiskFit] = {}
    if refine and kind == "ehl" and {"fast", "slow"} <= set(records):
        progress("common lags from the unloading")
        traces, fits, said = _refined(table, rig, records)
        warnings += said
    done = {}
    prefixes = {disk: f"{disk}_" if kind == "ehl" else "" for disk in records}
    for disk, record in records.items():
        progress(f"{disk} disk")
        one = traces.get(disk) or disk_traces(frame, disk, rig, record, prefix=prefixes[disk], where=table.path.name)
        if disk in fits:
            lag = fits[disk].estimates["lag_s"]
            chains = refined_chains(one.chains, fits[disk].chain)
            one = replace(one, chains=chains, lag_covariance_s2=with_common_u(one.lag_covariance_s2, lag.u))
            notes[f"{disk}_common_lag_s"] = f"{with_u(lag.value, lag.u)} s, from the unloading, record as prior"
        else:
            assert record.chain is not None
            common = record.chain.common_lag_s
            notes[f"{disk}_common_lag_s"] = f"{with_u(common.value, common.u)} s, from the record"
        done[disk] = _one_disk(one, dt, known, float(time[0]))
        for i, column in enumerate(one.columns):
            frame[column] = np.round(done[disk].temperature[:, i], DECIMALS)
            frame[column.replace("_degC", "_u_K")] = np.round(done[disk].sd[:, i], DECIMALS)
        warnings += done[disk].warnings
    return CompensatedLog(frame, notes, tuple(warnings), done, table)


def log_kind(
    log: str | Path, rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[Literal["ehl", "immersion"], str | None]:
    """Whether the columns make an EHL log or an immersion log, and for the latter the disk that was plunged.

    Raises InputError when several records are given for an immersion log; other kinds are refused by the reader.
    """
    mapped = rig.columns(next(iter(records))).values()
    return kind_of_columns(open_table(log, (*KNOWN, *mapped)).names, rig, records, shown(Path(log)))


def kind_of_columns(
    names: Collection[str], rig: Rig, records: Mapping[str, DiskRecord], where: str
) -> tuple[Literal["ehl", "immersion"], str | None]:
    """``log_kind`` for names that are read already."""
    disk = next(iter(records))
    mapped = {canonical for canonical, name in rig.columns(disk).items() if name in names}
    if recognise({*names, *mapped}) != "immersion":
        return "ehl", None
    if len(records) > 1:
        raise InputError(
            f"is an immersion log of one disk, and records of {len(records)} disks were given",
            where=where,
            remedy="give the record of the disk that was plunged",
        )
    return "immersion", disk


def _one_disk(traces: DiskTraces, dt: float, events: Mapping[float, float], start_s: float) -> Compensated:
    """One disk's traces; ``events``: time [s] of each and its uncertainty [s]."""
    y = traces.measured_degC
    done = smooth(
        y,
        dt,
        traces.chains,
        noise_sd=white_noise(y),
        events_s=tuple(float(e - start_s) for e in events),
        event_u_s=tuple(events.values()),
        lag_covariance=traces.lag_covariance_s2,
        static_u=np.hypot(traces.static_u(traces.readings_degC), traces.rounding_K),
        names=[c.removesuffix("_degC") for c in traces.columns],
    )
    said = [f"{traces.name}: {w}" for w in (*done.warnings, *traces.outside_lines("the log"))]
    return replace(done, warnings=(*said, *(f.sentence for f in traces.findings)))


def _refined(
    table: Log, rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[Mapping[str, DiskTraces], Mapping[str, DiskFit], list[str]]:
    """Traces of both disks and joint fits for their lags; what could not be had is empty, and why is said."""
    traces: Mapping[str, DiskTraces] = {}
    try:
        test = prepare(table, rig, records)
        traces = test.disks
        return traces, refine_lags(at_one_radius(test)), []
    except InputError as problem:
        return traces, {}, [f"the common lags are the records': the unloading could not be used ({problem})"]
