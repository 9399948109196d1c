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
from calibration.files.table import open_table, shown
from calibration.lines.static import apply_static, extrapolated, static_u
from calibration.log import COMPENSATED, Log, read_log
from calibration.record import DiskRecord
from calibration.result import Result
from calibration.rig import Rig
from tcdyn.chain import Chain
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth
from tcdyn.partition.events import find_events
from tcdyn.partition.inner_row import at_one_radius
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.nuisance import with_common_u
from tcdyn.partition.prepare import (
    coarse_sentence,
    coarse_step_K,
    despiked,
    gathered,
    prepare,
    record_chains,
    white_noise,
)
from tcdyn.partition.refine import refine_lags, refined_chains
from tcdyn.pipeline.records import rig_of

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
        return replace(self.raw, frame=frame, metadata=dict(self.metadata), warnings=self.warnings)

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
    warnings = gathered(table.warnings)
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
    fits: Mapping[str, DiskFit] = {}
    if refine and kind == "ehl" and {"fast", "slow"} <= set(records):
        progress("common lags from the unloading")
        fits, said = _refined(table, rig, records)
        warnings += said
    done = {}
    for disk, record in records.items():
        progress(f"{disk} disk")
        if record.chain is None:
            raise InputError(f"the record of the {disk} disk holds no chain", remedy="calibrate it with plunge logs")
        setup = rig.disk_setup(disk)
        chains: tuple[Chain, ...] = record_chains(record, setup)
        covariance = record.chain.lag_covariance()
        if disk in fits:
            lag = fits[disk].estimates["lag_s"]
            chains = refined_chains(chains, fits[disk].chain)
            covariance = with_common_u(covariance, lag.u)
            notes[f"{disk}_common_lag_s"] = f"{with_u(lag.value, lag.u)} s, from the unloading, record as prior"
        else:
            common = record.chain.common_lag_s
            notes[f"{disk}_common_lag_s"] = f"{with_u(common.value, common.u)} s, from the record"
        prefix = f"{disk}_" if kind == "ehl" else ""
        done[disk] = _one_disk(frame, prefix, record, chains, covariance, dt, known, time)
        for i, ch in enumerate(CHANNELS):
            frame[f"{prefix}{ch}_degC"] = np.round(done[disk].temperature[:, i], DECIMALS)
            frame[f"{prefix}{ch}_u_K"] = np.round(done[disk].sd[:, i], DECIMALS)
        warnings += [f"{disk}: {w}" for w in done[disk].warnings]
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


def _one_disk(
    frame: pd.DataFrame,
    prefix: str,
    record: DiskRecord,
    chains: tuple[Chain, ...],
    covariance: np.ndarray,
    dt: float,
    events: Mapping[float, float],
    time: np.ndarray,
) -> Compensated:
    """One disk's traces; ``events``: time [s] of each and its uncertainty [s]."""
    readings, uncertain, coarse = [], [], []
    for ch in CHANNELS:
        raw = frame[f"{prefix}{ch}_degC"].to_numpy(dtype=float)
        clean, missing = despiked(np.asarray(apply_static(raw, record.static[ch])))
        step = coarse_step_K(raw)
        if step > 0:
            coarse.append((step, ch))
        readings.append(np.where(missing, np.nan, clean))
        uncertain.append(np.hypot(static_u(record.static[ch], clean), step / 12**0.5))
    y = np.column_stack(readings)
    done = smooth(
        y,
        dt,
        chains,
        noise_sd=white_noise(y),
        events_s=tuple(float(e - time[0]) for e in events),
        event_u_s=tuple(events.values()),
        lag_covariance=covariance,
        static_u=np.column_stack(uncertain),
        names=[f"{prefix}{ch}" for ch in CHANNELS],
    )
    said = extrapolated("the log", dict(zip(CHANNELS, y.T)), record.static)
    if coarse:
        said.append(coarse_sentence(coarse))
    return replace(done, warnings=(*done.warnings, *said))


def _refined(table: Log, rig: Rig, records: Mapping[str, DiskRecord]) -> tuple[Mapping[str, DiskFit], list[str]]:
    """Joint fits of both disks, or nothing and why."""
    try:
        test = prepare(table, rig, records)
        return refine_lags(at_one_radius(test)), []
    except InputError as problem:
        return {}, [f"the common lags are the records': the unloading could not be used ({problem})"]
