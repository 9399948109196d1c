"""Channels of the disks of a rig that are compensated, by their records; and their readings.

``record_channels`` are raw columns of a log that is compensated with a fixed delay or followed.
``DiskColumns`` takes a checked log (``compensate_log``), whose noise is estimated for all channels
of a disk together. Guarded by ``tests/cli/test_compensate_command.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.estimate import text_with_u
from tcdyn.core.findings import Finding
from tcdyn.io.checksum import ALTERED_CODE
from tcdyn.partition.cooling import lag_covariance_with_common_u, refined_chains
from tcdyn.partition.joint import DiskFit
from tcdyn.rig.columns import junction_columns
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.rig.static_line import shared_u_K
from tcdyn.sensors.channels import Channel, ChannelGroup, TableChannels
from tcdyn.sensors.readings import ChannelReadings
from tcdyn.sensors.segments import TableSegment
from tcdyn.series.clock import mean_interval_s
from tcdyn.series.series import Context
from tcdyn.series.units import Unit
from tcdyn.smoothing.traces import DiskTraces, disk_channels, disk_traces, summarise_spikes


def record_channels(
    records: Mapping[str, DiskRecord], rig: Rig, prefixed: bool, context: Context
) -> tuple[TableChannels, list[Finding]]:
    """The channels of the disks that have a record; those of a disk are smoothed together.

    Parameters
    ----------
    records
        Record of each disk.
    rig
        Gives the setups of the disks.
    prefixed
        Whether the columns contain the name of the disk.
    context
        The log.

    Returns
    -------
    channels
        The channels.
    findings
        Whether a record was altered.
    """
    groups = []
    findings = []
    for disk, record in records.items():
        findings += [f for f in record.findings if f.code == ALTERED_CODE]
        setup = rig.disk_setup(disk)
        described = disk_channels(record, setup, disk if prefixed else "")
        assert record.chain is not None  # disk_channels refuses a record without a chain
        channels = tuple(
            Channel(column, Unit(), chain, record.chain.channels[name].lag_s, line, disk)
            for name, column, chain, line in zip(
                setup.channels, described.columns, described.chains, described.lines
            )
        )
        groups.append(
            ChannelGroup(channels, described.lag_covariance_s2, described.split_u_s, disk)
        )
    return TableChannels(tuple(groups), context), findings


def with_common_lag(
    traces: DiskTraces, record: DiskRecord, fit: DiskFit | None
) -> tuple[DiskTraces, str]:
    """Return the traces with the common lag of the fit, if there is one.

    Parameters
    ----------
    traces
        Traces of a disk, with the chains of its record.
    record
        The record.
    fit
        Joint fit of the disk; None: the lag stays that of the record.

    Returns
    -------
    traces
        The traces with refined chains and the covariance of their lags.
    note
        The lag and its source, as text.
    """
    if fit is not None:
        lag = fit.estimates["lag_s"]
        chains = refined_chains(traces.chains, fit.chain)
        traces = replace(
            traces,
            chains=chains,
            lag_covariance_s2=lag_covariance_with_common_u(traces.lag_covariance_s2, lag.u),
        )
        return traces, f"{text_with_u(lag.value, lag.u)} s, from the unloading, record as prior"
    assert record.chain is not None
    common = record.chain.common_lag_s
    return traces, f"{text_with_u(common.value, common.u)} s, from the record"


def disk_readings(traces: DiskTraces, time_s: Array) -> ChannelReadings:
    """The traces of a disk as readings, one for each of the even times ``time_s`` (N,) [s]."""
    shared_K = shared_u_K(traces.lines)
    return ChannelReadings(
        traces.columns,
        (Unit(),) * len(traces.columns),
        traces.measured_degC,
        float(time_s[0]),
        mean_interval_s(time_s),
        np.arange(len(time_s)),
        traces.chains,
        traces.lag_covariance_s2,
        traces.split_u_s,
        np.hypot(traces.static_u(traces.readings_degC), shared_K),
        shared_K,
        np.array([line.gain_u_rel for line in traces.lines]),
        traces.noise_K,
        traces.name,
    )


@dataclass(frozen=True)
class DiskColumns:
    """Channels of the disks in a checked log of the rig, on even times.

    Noise is estimated in each segment. Lags are those of the unloading (``fits``) or of the
    records.

    Attributes
    ----------
    rig, records, fits
        Rig; records by disk; joint fits by disk, for their common lags.
    prefixed
        Whether the columns contain the name of the disk.
    removes_lag
        Whether the lag is removed.
    where
        The log, in messages.
    """

    rig: Rig
    records: Mapping[str, DiskRecord]
    fits: Mapping[str, DiskFit]
    prefixed: bool
    removes_lag: bool
    where: str

    @property
    def units(self) -> dict[str, Unit]:
        """Columns of the junctions, in degrees Celsius."""
        names: list[str] = []
        for disk in self.records:
            channels = self.rig.disk_setup(disk).channels
            names += junction_columns(channels, disk if self.prefixed else "")
        return dict.fromkeys(names, Unit())

    @property
    def lag_s(self) -> float:
        """The largest lag [s]."""
        lags = [
            channel.lag_s.value
            for record in self.records.values()
            if record.chain
            for channel in record.chain.channels.values()
        ]
        return max(lags, default=0.0)

    def readings(self, segment: TableSegment) -> tuple[list[ChannelReadings], list[Finding]]:
        """Prepare the readings of each disk in a segment of the log; with findings about them."""
        prepared = []
        findings: list[Finding] = []
        frame = pd.DataFrame(segment.data)
        for disk, record in self.records.items():
            traces = disk_traces(
                frame,
                disk,
                self.rig,
                record,
                prefixed=self.prefixed,
                where=self.where,
                lag=self.removes_lag,
            )
            if self.removes_lag:
                traces = with_common_lag(traces, record, self.fits.get(disk))[0]
            prepared.append(disk_readings(traces, segment.time_s))
            findings += [f.at(disk) for f in traces.extrapolation_findings("the log")]
            findings += traces.findings
        return prepared, summarise_spikes(findings)
