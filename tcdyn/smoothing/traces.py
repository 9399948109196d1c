"""Log and record to the traces of one disk: static lines, spikes, noise and chains, made once and for everybody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.bursts import noise_and_white
from tcdyn.chain.logger_noise import TYPICAL_LAG_S, UNEXPLAINED, LoggerNoise
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import SPIKES, bridged, rounding_sd, white_noise_sd
from tcdyn.io.checksum import ALTERED
from tcdyn.rig.check_clock import interval_s
from tcdyn.rig.columns import couples
from tcdyn.rig.disk import DiskSetup, left_out_of
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig, UncertaintyTable
from tcdyn.rig.static_line import StaticLine, apply_static, extrapolated, static_u

Array = NDArray[np.float64]
Rows = slice | NDArray[np.bool_]
NO_CHAIN = Chain((), conditioning=NO_CONDITIONING)
NOISE_ORDER = 3  # of the differences that tell the noise of a trace
MANY_MISSING = 0.05  # share of a channel beyond which its gaps are told
# d, b or f left out: what reads in its place may be off, steadily and by heat
STAND_IN_K = 1.0
STAND_IN_M = 0.3e-3
FINE_ROUNDING_K = 0.02  # rounding below a sixth of a usual channel's noise is left unsaid


@dataclass(frozen=True)
class DiskChannels:
    """How the C thermocouples of a disk are read, as its record knows it.

    ``columns`` of the log; static ``lines``; ``chains``; ``lag_covariance_s2`` (C, C), of the lags; ``split_u_s`` (C,):
    standard uncertainty of how much of each is its largest lag's.
    """

    columns: tuple[str, ...]
    lines: tuple[StaticLine, ...]
    chains: tuple[Chain, ...]
    lag_covariance_s2: Array
    split_u_s: Array

    def static_u(self, temperature_degC: Array) -> Array:
        """Standard uncertainty [K] of each line at temperatures (N, C) or (C,) [degC], same shape."""
        t = np.asarray(temperature_degC, dtype=float)
        return np.stack([static_u(line, t[..., i]) for i, line in enumerate(self.lines)], axis=-1)


@dataclass(frozen=True)
class DiskTraces(DiskChannels):
    """One disk in one log: static-corrected readings (N, C) of its channels [degC], and how they were measured.

    Noise that the conditioning filter coloured was made white, see
    :mod:`tcdyn.chain.logger_noise`: readings and ``chains``
    went through the same A/N. ``missing`` (N, C): where a spike or a gap was bridged by a straight line; ``noise``:
    what it was; ``rounding_K`` (C,): error of a logger whose step hides the noise, else zero; ``static_u_K`` (C,):
    standard uncertainty of line and rounding at the mean of the rows asked for; ``uncertainty``: of what nobody
    measured, rig.toml's for this disk; ``inner_K`` (N, k): what the inner row would read more at the rim's edge;
    ``findings``: what was noticed; ``common_lag_s``: mean of the channels' lags, with its standard uncertainty
    ``common_lag_u_s`` [s]; ``left_out``: channels in whose columns, here and in ``setup``, others stand in, known to
    ``STAND_IN_K`` and ``STAND_IN_M`` times the radial gradient.
    """

    name: str
    setup: DiskSetup
    readings_degC: Array
    missing: NDArray[np.bool_]
    noise: LoggerNoise
    rounding_K: Array
    static_u_K: Array
    uncertainty: UncertaintyTable
    inner_K: Array
    findings: tuple[Finding, ...] = ()
    left_out: tuple[str, ...] = ()
    common_lag_s: float = field(init=False)
    common_lag_u_s: float = field(init=False)

    def __post_init__(self) -> None:
        lag = np.mean([c.lag_s for c in self.chains])
        u = np.sqrt(max(self.lag_covariance_s2.mean(), 0.0))
        object.__setattr__(self, "common_lag_s", float(lag))
        object.__setattr__(self, "common_lag_u_s", float(u))

    @property
    def out(self) -> NDArray[np.bool_]:
        """Which channels are left out (C,)."""
        return np.isin(self.setup.channels, self.left_out)

    @property
    def depth_u_m(self) -> Array:
        """Standard uncertainty (C,) of the depths [m], for an inner channel left out of its stand-in."""
        inner = np.isin(self.setup.channels, self.setup.inner) & self.out
        return np.where(inner, STAND_IN_M, self.uncertainty.depth_mm * 1e-3)

    @property
    def drives(self) -> Array:
        """By how much each of the inner row errs with its readings, (k, k): with its own, and where it stands in."""
        inner = self.setup.places(self.setup.inner)
        return np.asarray(
            self.setup.made_of(self.left_out)[np.ix_(inner, inner)].T + np.diag(self.out[inner])
        )

    @property
    def noise_K(self) -> Array:
        """Standard deviation (C,) of a sample's noise, which is white [K]."""
        return self.noise.level_K

    @property
    def measured_degC(self) -> Array:
        """Readings (N, C) with NaN where they are missing."""
        return np.where(self.missing, np.nan, self.readings_degC)

    @property
    def mean_chain(self) -> Chain:
        """The chain with the mean of the channels' parameters."""
        return mean_of(self.chains, self.name)

    def static_u(self, temperature_degC: Array) -> Array:
        """As of the lines alone, with the logger's rounding and what its sampling folds upon the temperature."""
        return np.hypot(
            super().static_u(temperature_degC), np.hypot(self.rounding_K, self.noise.folded_u_K)
        )

    def outside_lines(self, where: str, rows: Rows = slice(None)) -> tuple[Finding, ...]:
        """Channels that left the range of their static lines by far, in ``rows``; ``where`` is put in front."""
        named = {
            c: y
            for c, y in zip(self.setup.channels, self.measured_degC[rows].T)
            if c not in self.left_out
        }
        return tuple(extrapolated(where, named, dict(zip(self.setup.channels, self.lines))))


def mean_of(chains: Sequence[Chain], disk: str) -> Chain:
    """The chain with the mean of the parameters of ``chains``, which are those of one ``disk``."""
    most = max(1, *(len(c.taus_s) for c in chains))
    taus = np.mean(
        [sorted((*c.taus_s, *[0.0] * most)[:most], reverse=True) for c in chains], axis=0
    )
    pairs = [c.pair for c in chains if c.pair is not None]
    if pairs and len(pairs) < len(chains):
        raise InputError(f"channels of the {disk} disk differ: some have a complex pair, some none")
    return replace(
        chains[0],
        taus_s=tuple(float(x) for x in taus),
        pair=(float(np.mean([w for w, _ in pairs])), float(np.mean([z for _, z in pairs])))
        if pairs
        else None,
        cement_s=float(np.mean([c.cement_s for c in chains])),
        zero_s=float(np.mean([c.zero_s for c in chains])),
        delay_s=float(np.mean([c.delay_s for c in chains])),
    )


def disk_channels(
    record: DiskRecord, setup: DiskSetup, disk: str = "", lag: bool = True
) -> DiskChannels:
    """Lines and chains of the record for the columns of a log in which ``disk`` is named; empty chains if no ``lag``.

    Raises InputError for a record without one of the disk's channels; where the lag is asked for, also for one without
    a chain, and when ``setup`` (rig.toml) states another filter than the record, whose lags were found with its own.
    """
    if lag and record.chain is None:
        raise InputError(
            f"the record of the {record.disk} disk holds no chain",
            remedy="calibrate it with plunge logs",
        )
    names = setup.channels
    chain = record.chain if lag else None
    if absent := [
        c for c in names if c not in record.static or not (chain is None or c in chain.channels)
    ]:
        remedy = f"calibrate all {len(names)}, or take it out of rig.toml [thermocouples]"
        raise InputError(
            f"the record of the {record.disk} disk lacks channel {absent[0]}", remedy=remedy
        )
    kept = [sorted(chain.channels).index(c) for c in names] if chain else []
    return DiskChannels(
        couples(names, disk),
        tuple(record.static[c] for c in names),
        record_chains(record, setup) if lag else (NO_CHAIN,) * len(names),
        np.array(chain.covariance)[np.ix_(kept, kept)]
        if chain
        else np.zeros((len(names), len(names))),
        np.array([chain.channels[c].split_u_s if chain else 0.0 for c in names]),
    )


def record_chains(record: DiskRecord, setup: DiskSetup) -> tuple[Chain, ...]:
    """The chains of a disk's channels as the record states them, conditioning filter included.

    Raises InputError when ``setup`` (rig.toml) states another filter: the record's lags were found with its own.
    """
    assert record.chain is not None
    own = record.conditioning
    stated = setup.conditioning
    if stated.poles != own.poles or (own.poles > 0 and stated != own):
        said = [f"of {b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape})" for b in (own, stated)]
        raise InputError(
            f"the record of disk {record.disk!r} was made with conditioning {said[0]}, rig.toml states {said[1]}",
            expected="the filter that the disk was calibrated with",
            remedy="give the rig file of the calibration, {rig}, or calibrate again",
            parameters={"rig": "rig.toml"},
        )
    kept = record.chain.channels
    return tuple(
        Chain(**kept[c].model_dump(exclude={"lag_s", "split_u_s"}), conditioning=own)
        for c in setup.channels
    )


def disk_traces(
    frame: pd.DataFrame,
    disk: str,
    rig: Rig,
    record: DiskRecord,
    *,
    named: bool = True,
    rows: Rows = slice(None),
    where: str = "",
    lag: bool = True,
    left_out: Sequence[str] = (),
) -> DiskTraces:
    """Readings of one disk in ``frame`` (a log's) through static lines, spikes bridged, with their noise.

    ``named``: whether the disk's name stands in its columns; ``rows``: where the static lines' uncertainty is stated;
    ``lag``: False for readings whose lag does not matter, the record's chain and filter with it; ``left_out``: channels
    whose columns are not looked at and need not be there.
    Raises InputError for the record of another disk, and as :func:`disk_channels` does.
    """
    setup = rig.disk_setup(disk)
    setup = setup.with_stand_ins(
        left_out := left_out_of((f"{disk}_{c}" for c in left_out), {disk: setup})[disk]
    )
    if record.disk not in (disk, setup.name):
        raise InputError(
            f"the record is of disk {record.disk!r}", where=where, expected=f"a record of {disk!r}"
        )
    channels = disk_channels(record, setup, disk if named else "", lag)
    found = [f for f in record.findings if f.code == ALTERED]
    columns = []
    marks = []
    rounding = []
    used = ~np.isin(setup.channels, left_out)
    names = [*compress(channels.columns, used)]
    for name, line in zip(names, compress(channels.lines, used)):
        raw = frame[name].to_numpy(dtype=float)
        step = rounding_sd(
            raw
        )  # of a logger that hides the noise of a trace; zero where the noise is seen
        rounding.append(
            step * (step > FINE_ROUNDING_K and step >= float(white_noise_sd(raw, NOISE_ORDER)))
        )
        values = apply_static(raw, line)
        marked = ~np.isfinite(values)
        columns.append(bridged(values, ~marked))
        marks.append(marked)
    coarse = [ch for ch, error in zip(compress(setup.channels, used), rounding) if error > 0]
    found += (
        [warning("traces.coarse", subject=disk, step_K=max(rounding) * 12**0.5, channels=coarse)]
        if coarse
        else []
    )
    y = np.column_stack(columns)
    missing = np.column_stack(marks)
    dt_s = interval_s(frame["time_s"].to_numpy(float))
    white_K = np.maximum(white_noise_sd(y, NOISE_ORDER), 1e-6)
    chains = (
        channels.chains
        if lag
        else (Chain((TYPICAL_LAG_S,), conditioning=setup.conditioning),) * len(used)
    )
    noise, [(y, moved)] = noise_and_white(
        [np.where(missing, np.nan, y)],
        [dt_s],
        setup.conditioning,
        white_K,
        [*compress(chains, used)],
        SPIKES["traces"],
    )
    missing |= moved
    if not (noise.coloured or noise.lines or noise.unexplained > UNEXPLAINED):
        noise = noise.white(white_noise_sd(y, NOISE_ORDER))
    lost = {
        name.removesuffix("_degC"): 100 * float(share)
        for name, share in zip(names, missing.mean(axis=0))
    }
    found += [
        warning("traces.gaps", subject=name, percent=x)
        for name, x in lost.items()
        if x > 100 * MANY_MISSING
    ]
    found += noise.findings(disk)
    weights = setup.made_of(left_out)
    if left_out:  # others stand in
        shares = weights[:, used]
        y = y @ shares.T
        missing = missing @ (shares.T > 0)
        rounding = list(shares @ rounding)
        noise = noise.for_more(used, np.sqrt(shares**2 @ noise.level_K**2))
        covariance = weights @ channels.lag_covariance_s2 @ weights.T
        chains = tuple(mean_of([*compress(channels.chains, row > 0)], disk) for row in weights)
        channels = replace(channels, chains=chains, lag_covariance_s2=covariance)
    static_u_K = np.hypot(
        channels.static_u(y[rows].mean(axis=0)), np.hypot(rounding, noise.folded_u_K)
    )
    return DiskTraces(
        **vars(channels) | {"chains": tuple(noise.behind(c) for c in channels.chains)},
        name=disk,
        setup=setup,
        readings_degC=y,
        missing=missing,
        noise=noise,
        rounding_K=np.array(rounding),
        static_u_K=np.where(used, static_u_K, STAND_IN_K),
        uncertainty=rig.tables(disk).uncertainty,
        inner_K=np.zeros((len(y), len(setup.inner))),
        findings=tuple(found),
        left_out=left_out,
    )


def gathered(findings: Sequence[Finding]) -> list[Finding]:
    """What the reader noticed, the spikes of all columns as one note: every slip ring has some.

    >>> spiky = [info("spikes.removed", subject=f"fast_{c}_degC", count=n) for c, n in (("a", 3), ("c", 5))]
    >>> [f.sentence for f in gathered(spiky)]
    ['8 spikes in 2 channels were taken as missing, most in fast_c_degC (5)']
    """
    spiky = [f for f in findings if f.code == "spikes.removed"]
    if not spiky:
        return list(findings)
    most = max(spiky, key=lambda f: f.numbers["count"])
    counts = [f.numbers["count"] for f in spiky]
    told = info(
        "spikes.gathered",
        subject=most.subject,
        count=sum(counts),
        columns=len(spiky),
        of_most=max(counts),
    )
    return [told, *(f for f in findings if f.code != "spikes.removed")]
