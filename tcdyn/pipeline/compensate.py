"""A whole log through static lines and chains: the temperatures at the junctions, with a standard deviation each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from calibration.columns import KNOWN, recognise
from calibration.disk import CHANNELS
from calibration.errors import InputError
from calibration.logs import COMPENSATED, Log, read_log
from calibration.record import DiskRecord
from calibration.rigfile import Rig, load_rig
from calibration.static import apply_static, static_u
from calibration.table import open_table, shown
from tcdyn.chain import Chain
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth
from tcdyn.partition.events import find_events
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.prepare import despiked, gathered, prepare, record_chains, white_noise
from tcdyn.partition.refine import refine_lags, refined_chains

DECIMALS = 5  # 0.01 mK: far below what any sample is known to


@dataclass(frozen=True)
class CompensatedLog:
    """The log with junction temperatures in place of readings, a column ``<channel>_u_K`` for each, and its notes."""

    frame: pd.DataFrame
    metadata: dict[str, str]
    warnings: tuple[str, ...]
    disks: Mapping[str, Compensated]
    raw: Log


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
    known: tuple[float, ...] = ()
    if kind == "ehl":
        events = find_events(frame, table.path.name)
        known = (events.load_on_s, events.unload_s)
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
            m = len(covariance)
            centre = np.eye(m) - 1.0 / m
            covariance = centre @ covariance @ centre.T + lag.u**2
            notes[f"{disk}_common_lag_s"] = f"{lag.value:.4f} +- {lag.u:.4f}, from the unloading, record as prior"
        else:
            common = record.chain.common_lag_s
            notes[f"{disk}_common_lag_s"] = f"{common.value:.4f} +- {common.u:.4f}, from the record"
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
    mapped = rig.tables(next(iter(records))).columns.values()
    return kind_of_columns(open_table(log, (*KNOWN, *mapped)).names, rig, records, shown(Path(log)))


def kind_of_columns(
    names: Collection[str], rig: Rig, records: Mapping[str, DiskRecord], where: str
) -> tuple[Literal["ehl", "immersion"], str | None]:
    """``log_kind`` for names that are read already."""
    disk = next(iter(records))
    mapped = {canonical for canonical, name in rig.tables(disk).columns.items() if name in names}
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
    events: tuple[float, ...],
    time: np.ndarray,
) -> Compensated:
    readings, uncertain = [], []
    for ch in CHANNELS:
        y = np.asarray(apply_static(frame[f"{prefix}{ch}_degC"].to_numpy(dtype=float), record.static[ch]))
        clean, _ = despiked(y)
        readings.append(clean)
        uncertain.append(np.asarray(static_u(record.static[ch], clean)))
    y = np.column_stack(readings)
    return smooth(
        y,
        dt,
        chains,
        noise_sd=white_noise(y),
        events_s=tuple(float(e - time[0]) for e in events),
        lag_covariance=covariance,
        static_u=np.column_stack(uncertain),
    )


def _refined(table: Log, rig: Rig, records: Mapping[str, DiskRecord]) -> tuple[Mapping[str, DiskFit], list[str]]:
    """Joint fits of both disks, or nothing and why."""
    try:
        test = prepare(table, rig, records)
        return refine_lags(test, rig.common.uncertainty), []
    except InputError as problem:
        return {}, [f"the common lags are the records': the unloading could not be used ({problem})"]


def rig_of(records: Mapping[str, DiskRecord]) -> Rig:
    """The rig as the records remember it."""
    default = load_rig()
    tables = {d: (records[d].setup if d in records else default.common) for d in ("fast", "slow")}
    return Rig(common=tables["fast"], fast=tables["fast"], slow=tables["slow"])
