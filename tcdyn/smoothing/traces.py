"""From a log and a record to the traces of one disk: static lines, spikes, noise and chains.

Used by the partition, the campaign and the workflows of ``beta`` and ``compensate``. The noise
model is that of :mod:`tcdyn.chain.logger_noise`, the rule for spikes
``tcdyn.estimation.trace_noise.SPIKES["traces"]``. Guarded by ``tests/smoothing/test_traces.py``;
the channels that are left out by ``tests/partition/test_left_out.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.bursts import estimate_and_whiten_noise
from tcdyn.chain.logger_noise import TYPICAL_LAG_S, UNEXPLAINED, LoggerNoise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import SPIKES, interpolate_gaps, rounding_sd, white_noise_sd
from tcdyn.io.checksum import ALTERED_CODE
from tcdyn.rig.columns import junction_columns
from tcdyn.rig.disk import DiskSetup, channels_left_out
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig, UncertaintyTable
from tcdyn.rig.static_line import StaticLine, apply_static, extrapolation_warnings, static_u
from tcdyn.series.clock import mean_interval_s

Rows = slice | NDArray[np.bool_]
# chain without a lag, for readings whose lag does not matter
NO_CHAIN = Chain((), conditioning=NO_CONDITIONING)
# order of the differences from which the noise of a trace is estimated: a higher one suppresses a
# faster signal, see tcdyn.estimation.trace_noise.white_noise_sd
DIFFERENCE_ORDER = 3
# share of missing samples of a channel beyond which a warning comes; chosen by judgement
MANY_MISSING = 0.05
# standard uncertainty of a surrogate channel (for d, b or f left out): a constant error [K], and
# one in proportion to the radial heat flux, as a depth [m]; chosen by judgement
SURROGATE_U_K = 1.0
SURROGATE_DEPTH_U_M = 0.3e-3
# rounding error [K] below which it is neglected: a sixth of the noise of a usual channel
FINE_ROUNDING_K = 0.02


@dataclass(frozen=True)
class DiskChannels:
    """The C thermocouples of a disk as its record describes them.

    Parameters
    ----------
    columns
        Columns of the log.
    lines
        Static lines.
    chains
        Chains.
    lag_covariance_s2
        Covariance of the lags (C, C) [s2].
    split_u_s
        Standard uncertainty (C,) [s] of how much of each lag is its largest lag.
    """

    columns: tuple[str, ...]
    lines: tuple[StaticLine, ...]
    chains: tuple[Chain, ...]
    lag_covariance_s2: Array
    split_u_s: Array

    def static_u(self, temperature_degC: Array) -> Array:
        """Standard uncertainty [K] of each line at temperatures (N, C) or (C,) [degC]."""
        t = np.asarray(temperature_degC, dtype=float)
        return np.stack([static_u(line, t[..., i]) for i, line in enumerate(self.lines)], axis=-1)


@dataclass(frozen=True)
class DiskTraces(DiskChannels):
    """The traces of one disk in one log: readings after the static lines, and their noise.

    Noise that the conditioning filter coloured is whitened, see :mod:`tcdyn.chain.logger_noise`:
    readings and ``chains`` went through the same filter A/N.

    Parameters
    ----------
    name, setup
        Name and setup of the disk.
    readings_degC
        Readings (N, C) [degC], interpolated where ``missing``.
    missing
        Where a spike or a gap was interpolated linearly (N, C).
    noise
        The noise.
    rounding_K
        Rounding error (C,) [K] of a logger whose step hides the noise, else zero.
    static_u_K
        Standard uncertainty (C,) [K] of line and rounding at the mean of the rows of the call.
    uncertainty
        Type B standard uncertainties (nuisance parameters) of rig.toml for this disk.
    inner_offset_K
        What the inner row would read more at the edge of the rim (N, k) [K].
    findings
        Findings about the traces.
    excluded
        Channels that are not used. Surrogates replace them here and in ``setup``, known to
        ``SURROGATE_U_K`` and to ``SURROGATE_DEPTH_U_M`` times the radial gradient.
    common_lag_s, common_lag_u_s
        Mean of the lags of the channels and its standard uncertainty [s].
    """

    name: str
    setup: DiskSetup
    readings_degC: Array
    missing: NDArray[np.bool_]
    noise: LoggerNoise
    rounding_K: Array
    static_u_K: Array
    uncertainty: UncertaintyTable
    inner_offset_K: Array
    findings: tuple[Finding, ...] = ()
    excluded: tuple[str, ...] = ()
    common_lag_s: float = field(init=False)
    common_lag_u_s: float = field(init=False)

    def __post_init__(self) -> None:
        """Set mean lag and its uncertainty from the chains and the covariance of the lags.

        Notes
        -----
        u is that of ``immersion.plunge_parameters.common_and_differential_u_s``.
        """
        lag = np.mean([c.lag_s for c in self.chains])
        u = np.sqrt(max(self.lag_covariance_s2.mean(), 0.0))
        object.__setattr__(self, "common_lag_s", float(lag))
        object.__setattr__(self, "common_lag_u_s", float(u))

    @property
    def excluded_mask(self) -> NDArray[np.bool_]:
        """Mask of the channels that are left out (C,)."""
        return np.isin(self.setup.channels, self.excluded)

    @property
    def depth_u_m(self) -> Array:
        """Standard uncertainty (C,) [m] of the depths of the thermocouples.

        For an inner channel that is left out it is ``SURROGATE_DEPTH_U_M``, that of its surrogate.
        """
        inner = np.isin(self.setup.channels, self.setup.inner) & self.excluded_mask
        return np.where(inner, SURROGATE_DEPTH_U_M, self.uncertainty.depth_mm * 1e-3)

    @property
    def inner_row_weights(self) -> Array:
        """Error of each channel of the inner row per error of its readings, (k, k).

        It is its own error, and through surrogates that of others. A row is the source of the
        error, a column the channel that it affects.
        """
        inner = self.setup.channel_indices(self.setup.inner)
        weights = self.setup.surrogate_matrix(self.excluded)[np.ix_(inner, inner)]
        return np.asarray(weights.T + np.diag(self.excluded_mask[inner]))

    @property
    def noise_K(self) -> Array:
        """Standard deviation (C,) [K] of the white noise of a sample."""
        return self.noise.level_K

    @property
    def measured_degC(self) -> Array:
        """Readings (N, C) with NaN where they are missing."""
        return np.where(self.missing, np.nan, self.readings_degC)

    @property
    def mean_chain(self) -> Chain:
        """The chain with the mean of the channels' parameters."""
        return average_chains(self.chains, self.name)

    def static_u(self, temperature_degC: Array) -> Array:
        """Standard uncertainty [K] of line, rounding of the logger and aliased hum.

        Parameters
        ----------
        temperature_degC
            Temperatures (N, C) or (C,) [degC].
        """
        return np.hypot(
            super().static_u(temperature_degC), np.hypot(self.rounding_K, self.noise.aliasing_u_K)
        )

    def extrapolation_findings(self, where: str, rows: Rows = slice(None)) -> tuple[Finding, ...]:
        """Findings for channels that are far outside the range of their static lines.

        Parameters
        ----------
        where
            Prefix of the messages.
        rows
            Rows that are examined.
        """
        channels = self.setup.channels
        readings = dict(zip(channels, self.measured_degC[rows].T))
        for channel in self.excluded:
            readings.pop(channel, None)
        return tuple(extrapolation_warnings(where, readings, dict(zip(channels, self.lines))))


def average_chains(chains: Sequence[Chain], disk: str) -> Chain:
    """The chain with the mean parameters of several chains of one disk.

    Parameters
    ----------
    chains
        Chains; lags are sorted, and missing ones count as zero.
    disk
        Name of the disk, for the message.

    Raises
    ------
    InputError
        If some chains have a complex pair and some have none.

    Notes
    -----
    The conditioning filter is that of the first chain. A new parameter of
    ``tcdyn.chain.chain.Chain`` must be averaged here, too; otherwise that of the first chain is
    used.
    """
    n_lags = max(1, *(len(c.taus_s) for c in chains))
    padded = [(*c.taus_s, *[0.0] * n_lags)[:n_lags] for c in chains]
    taus = np.mean([sorted(lags, reverse=True) for lags in padded], axis=0)
    pairs = [c.pair for c in chains if c.pair is not None]
    if pairs and len(pairs) < len(chains):
        raise InputError(f"channels of the {disk} disk differ: some have a complex pair, some none")
    mean_pair = None
    if pairs:
        tw, zeta = np.mean(pairs, axis=0).tolist()
        mean_pair = (tw, zeta)
    return replace(
        chains[0],
        taus_s=tuple(float(x) for x in taus),
        pair=mean_pair,
        cement_s=float(np.mean([c.cement_s for c in chains])),
        zero_s=float(np.mean([c.zero_s for c in chains])),
        delay_s=float(np.mean([c.delay_s for c in chains])),
    )


def disk_channels(
    record: DiskRecord, setup: DiskSetup, disk: str = "", lag: bool = True
) -> DiskChannels:
    """Lines and chains of a record, for the columns of a log.

    Parameters
    ----------
    record
        Calibration record of the disk.
    setup
        Setup of the disk in rig.toml, whose channels are used.
    disk
        Name of the disk in the columns; empty if the columns contain none.
    lag
        False for readings whose lag does not matter: the chains are then empty.

    Returns
    -------
    DiskChannels
        Lines and chains in the order of ``setup.channels``.

    Raises
    ------
    InputError
        For a record without one of the channels of the disk. With ``lag`` also for a record without
        a chain, and where ``setup`` (rig.toml) has another filter than the record, whose lags were
        determined with its filter.

    Notes
    -----
    The covariance of the lags in the record is in the alphabetical order of its channels; it is put
    in the order of ``setup`` here.
    """
    if lag and record.chain is None:
        raise InputError(
            f"the record of the {record.disk} disk holds no chain",
            remedy="calibrate it with plunge logs",
        )
    names = setup.channels
    chain = record.chain if lag else None
    for c in names:
        if c not in record.static or (chain is not None and c not in chain.channels):
            raise InputError(
                f"the record of the {record.disk} disk lacks channel {c}",
                remedy=f"calibrate all {len(names)}, or take it out of rig.toml [thermocouples]",
            )
    columns = junction_columns(names, disk)
    lines = tuple(record.static[c] for c in names)
    if chain is None:
        count = len(names)
        no_chains = (NO_CHAIN,) * count
        return DiskChannels(columns, lines, no_chains, np.zeros((count, count)), np.zeros(count))
    index = [sorted(chain.channels).index(c) for c in names]
    return DiskChannels(
        columns,
        lines,
        record_chains(record, setup),
        np.array(chain.covariance)[np.ix_(index, index)],
        np.array([chain.channels[c].split_u_s for c in names]),
    )


def record_chains(record: DiskRecord, setup: DiskSetup) -> tuple[Chain, ...]:
    """The chains of the channels of a disk, conditioning filter included, from its record.

    Parameters
    ----------
    record
        Calibration record with a chain.
    setup
        Setup of the disk in rig.toml.

    Raises
    ------
    InputError
        Where ``setup`` (rig.toml) has another filter than the record, whose lags were determined
        with its filter.

    Notes
    -----
    ``tests/smoothing/test_traces.py`` checks the lags and the refusal of another filter.
    """
    assert record.chain is not None
    recorded = record.conditioning
    nominal = setup.conditioning
    if nominal.poles != recorded.poles or (recorded.poles > 0 and nominal != recorded):
        texts = [
            f"of {b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape})" for b in (recorded, nominal)
        ]
        raise InputError(
            f"the record of disk {record.disk!r} was made with conditioning {texts[0]}, "
            f"rig.toml states {texts[1]}",
            expected="the filter that the disk was calibrated with",
            remedy="give the rig file of the calibration, {rig}, or calibrate again",
            parameters={"rig": "rig.toml"},
        )
    chains = []
    for c in setup.channels:
        parameters = record.chain.channels[c].model_dump(exclude={"lag_s", "split_u_s"})
        chains.append(Chain(**parameters, conditioning=recorded))
    return tuple(chains)


def disk_traces(
    frame: pd.DataFrame,
    disk: str,
    rig: Rig,
    record: DiskRecord,
    *,
    prefixed: bool = True,
    rows: Rows = slice(None),
    where: str = "",
    lag: bool = True,
    excluded: Sequence[str] = (),
) -> DiskTraces:
    """Traces of one disk in the table of a log: static lines, spikes interpolated, noise.

    Parameters
    ----------
    frame
        Table of the log.
    disk
        Name of the disk.
    rig
        The rig file.
    record
        Calibration record of the disk.
    prefixed
        Whether the columns contain the name of the disk.
    rows
        Rows where the uncertainty of the static lines is evaluated.
    where
        Location in messages.
    lag
        False for readings whose lag does not matter; chain and filter of the record are then not
        needed.
    excluded
        Channels whose columns are not used and need not exist.

    Returns
    -------
    DiskTraces
        The traces; surrogates replace the excluded channels.

    Raises
    ------
    InputError
        For the record of another disk, as :func:`disk_channels`, and as
        :func:`tcdyn.rig.disk.channels_left_out` for an excluded channel that does not exist or too
        few channels left.

    Notes
    -----
    Steps: static lines, gaps interpolated, noise estimated, bursts and spikes interpolated,
    whitening where the noise is coloured, surrogates. The static line comes first, because noise
    and spikes are in kelvin. Without colour, hum or unexplained noise the noise is taken as white,
    from differences of the order ``DIFFERENCE_ORDER``.

    What may be changed: ``FINE_ROUNDING_K`` and ``MANY_MISSING`` (messages and a contribution to
    the uncertainty). ``DIFFERENCE_ORDER`` is also that of ``tcdyn.partition.joint`` and
    ``tcdyn.campaign.input_noise``, ``SURROGATE_U_K`` that of
    ``tcdyn.partition.specified``.
    """
    disk_setup = rig.disk_setup(disk)
    excluded = channels_left_out((f"{disk}_{c}" for c in excluded), {disk: disk_setup})[disk]
    setup = disk_setup.with_surrogates(excluded)
    if record.disk not in (disk, setup.name):
        raise InputError(
            f"the record is of disk {record.disk!r}", where=where, expected=f"a record of {disk!r}"
        )
    channels = disk_channels(record, setup, disk if prefixed else "", lag)
    findings = [f for f in record.findings if f.code == ALTERED_CODE]
    used = ~np.isin(setup.channels, excluded)
    names = [*compress(channels.columns, used)]
    columns = []
    bad = []
    rounding = []
    for name, line in zip(names, compress(channels.lines, used)):
        raw = frame[name].to_numpy(dtype=float)
        step_u = rounding_sd(raw)
        # the rounding counts only where it hides the noise of the trace
        hides_noise = step_u >= float(white_noise_sd(raw, DIFFERENCE_ORDER))
        rounding.append(step_u if step_u > FINE_ROUNDING_K and hides_noise else 0.0)
        values = apply_static(raw, line)
        missing_column = ~np.isfinite(values)
        columns.append(interpolate_gaps(values, ~missing_column))
        bad.append(missing_column)
    coarse = [ch for ch, error in zip(compress(setup.channels, used), rounding) if error > 0]
    if coarse:
        step_K = max(rounding) * 12**0.5
        findings.append(warning("traces.coarse", subject=disk, step_K=step_K, channels=coarse))
    y = np.column_stack(columns)
    missing = np.column_stack(bad)
    dt_s = mean_interval_s(frame["time_s"].to_numpy(float))
    white_K = np.maximum(white_noise_sd(y, DIFFERENCE_ORDER), 1e-6)
    chains = channels.chains
    if not lag:
        chains = (Chain((TYPICAL_LAG_S,), conditioning=setup.conditioning),) * len(used)
    noise, [(y, outliers)] = estimate_and_whiten_noise(
        [np.where(missing, np.nan, y)],
        [dt_s],
        setup.conditioning,
        white_K,
        [*compress(chains, used)],
        SPIKES["traces"],
    )
    missing |= outliers
    has_lines = bool(noise.hum_lines or noise.waves)
    if not (noise.is_coloured or has_lines or noise.unexplained > UNEXPLAINED):
        noise = noise.white(white_noise_sd(y, DIFFERENCE_ORDER))
    for name, share in zip(names, missing.mean(axis=0)):
        percent = 100 * float(share)
        if percent > 100 * MANY_MISSING:
            subject = name.removesuffix("_degC")
            findings.append(warning("traces.gaps", subject=subject, percent=percent))
    findings += noise.findings(disk)
    weights = setup.surrogate_matrix(excluded)
    if excluded:  # surrogates: weighted means of other channels
        shares = weights[:, used]
        y = y @ shares.T
        missing = missing @ (shares.T > 0)
        rounding = list(shares @ rounding)
        noise = noise.with_channels(used, np.sqrt(shares**2 @ noise.level_K**2))
        covariance = weights @ channels.lag_covariance_s2 @ weights.T
        chains = tuple(
            average_chains([*compress(channels.chains, row > 0)], disk) for row in weights
        )
        channels = replace(channels, chains=chains, lag_covariance_s2=covariance)
    line_u_K = channels.static_u(y[rows].mean(axis=0))
    static_u_K = np.hypot(line_u_K, np.hypot(rounding, noise.aliasing_u_K))
    return DiskTraces(
        columns=channels.columns,
        lines=channels.lines,
        chains=tuple(noise.whitened_chain(c) for c in channels.chains),
        lag_covariance_s2=channels.lag_covariance_s2,
        split_u_s=channels.split_u_s,
        name=disk,
        setup=setup,
        readings_degC=y,
        missing=missing,
        noise=noise,
        rounding_K=np.array(rounding),
        static_u_K=np.where(used, static_u_K, SURROGATE_U_K),
        uncertainty=rig.tables(disk).uncertainty,
        inner_offset_K=np.zeros((len(y), len(setup.inner))),
        findings=tuple(findings),
        excluded=excluded,
    )


def summarise_spikes(findings: Sequence[Finding]) -> list[Finding]:
    """Findings of the reader, with the spikes of all columns in one finding.

    Every slip ring has some, and one message a column would hide the others.

    Examples
    --------
    >>> counts = (("fast_a_degC", 3), ("fast_c_degC", 5))
    >>> spiky = [info("spikes.removed", subject=name, count=n) for name, n in counts]
    >>> [f.sentence for f in summarise_spikes(spiky)]
    ['8 spikes in 2 channels were taken as missing, most in fast_c_degC (5)']
    """
    spiky = [f for f in findings if f.code == "spikes.removed"]
    if not spiky:
        return list(findings)
    most = max(spiky, key=lambda f: f.numbers["count"])
    counts = [f.numbers["count"] for f in spiky]
    summary = info(
        "spikes.gathered",
        subject=most.subject,
        count=sum(counts),
        columns=len(spiky),
        of_most=max(counts),
    )
    return [summary, *(f for f in findings if f.code != "spikes.removed")]
