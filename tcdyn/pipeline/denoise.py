"""Noise taken off a whole log as the thesis did it (section 4.2): static lines and smooth curves, the lag left in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calibration.disk import CHANNELS
from calibration.errors import InputError
from calibration.finding import sentences
from calibration.lines.static import apply_static, extrapolated
from calibration.log import COMPENSATED, Log, read_log
from calibration.record import DiskRecord
from calibration.result import Result
from calibration.rig import Rig
from immersion.events import find_entry
from tcdyn.compensate.denoise import METHODS, Denoised, remove_noise
from tcdyn.partition.events import find_events
from tcdyn.pipeline.compensate import DECIMALS, log_kind
from tcdyn.pipeline.records import rig_of
from tcdyn.traces import despiked, gathered

METHOD = "noise removed (section 4.2), static lines applied, lag left in"
Progress = Callable[[str, int, int], None]  # (channel, channels done, channels in all)


@dataclass(frozen=True)
class DenoisedLog(Result):
    """The log with smooth curves in place of readings, and how each channel's curves were chosen."""

    frame: pd.DataFrame
    metadata: dict[str, str]
    warnings: tuple[str, ...]
    channels: Mapping[str, Denoised]
    raw: Log

    def summary(self) -> str:
        """A line for each stretch of each channel."""
        lines = [f"{self.raw.path.name}: {METHOD}"]
        for name, found in self.channels.items():
            lines += [f"  {name}: {line}" for line in found.summary().splitlines()]
        return "\n".join([*lines, *(f"warning: {w}" for w in self.warnings)])

    def to_dict(self) -> dict[str, Any]:
        """Metadata, warnings and the choice on every stretch; the samples are in ``frame``."""
        channels = {name: found.to_dict()["segments"] for name, found in self.channels.items()}
        return {"metadata": dict(self.metadata), "channels": channels, "warnings": list(self.warnings)}


def denoise_log(
    log: str | Path,
    records: Mapping[str, DiskRecord],
    rig: Rig | None = None,
    *,
    methods: Sequence[str] = METHODS,
    progress: Progress = lambda *_: None,
) -> DenoisedLog:
    """Static lines, then the curves of :func:`tcdyn.compensate.remove_noise` between the log's events.

    An EHL log is split at loading and unloading, an immersion log at the entry. The lag stays in, and no standard
    deviation is given: for temperatures at the junctions use :func:`tcdyn.compensate_log`. The output is marked as
    compensated, since its static lines are applied. Raises InputError as ``compensate_log`` does.
    """
    if not records:
        raise InputError("no record was given", remedy="add --record DISK.disk.json")
    rig = rig or rig_of(records)
    kind, own = log_kind(log, rig, records)
    table = read_log(log, kind, rig, own)
    frame = table.frame.copy()
    time = frame["time_s"].to_numpy(dtype=float)
    if kind == "ehl":
        found = find_events(frame, table.path.name)
        events: tuple[float, ...] = (found.load_on_s, found.unload_s)
    else:
        filled = table.filled()
        columns = ("switch", "probe_degC", "fluid_degC")
        switch, probe, fluid = (filled[c].to_numpy(dtype=float) if c in filled else None for c in columns)
        events = (find_entry(time, switch, probe, fluid, table.path.name).time_s,)
    names = [(f"{d}_{c}" if kind == "ehl" else c, records[d].static[c]) for d in records for c in CHANNELS]
    done: dict[str, Denoised] = {}
    said = list(sentences(gathered(table.findings)))
    for k, (name, line) in enumerate(names):
        logged = frame[f"{name}_degC"].to_numpy(dtype=float)
        clean, missing = despiked(np.asarray(apply_static(logged, line)))
        done[name] = remove_noise(time, np.where(missing, np.nan, clean), events, methods)
        said += [f.sentence for f in extrapolated(table.path.name, {name: clean}, {name: line})]
        frame[f"{name}_degC"] = np.round(done[name].temperature, DECIMALS)
        progress(name, k + 1, len(names))
    notes = {
        **table.metadata, "tcdyn": COMPENSATED, "method": METHOD, "source": table.path.name,
        "source_sha256": table.sha256,
    }  # fmt: skip
    return DenoisedLog(frame, notes, tuple(said), done, table)
