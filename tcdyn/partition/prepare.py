"""From an EHL log and two disk records to what the heat-partition fits need, in SI units and checked."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from calibration.compare import changed_keys
from calibration.disk import CHANNELS, DISKS, INNER_ROW, Conditioning, DiskSetup
from calibration.errors import InputError
from calibration.lines.static import apply_static, extrapolated, static_u
from calibration.log import COMPENSATED, Log
from calibration.noise import rounding_sd, white_noise_sd
from calibration.record import DiskRecord
from calibration.rig import Rig, UncertaintyTable
from tcdyn.chain import Chain
from tcdyn.contact import equal_radius_m, half_width_m, surface_speed_m_s
from tcdyn.partition.events import SETTLE_S, Events, find_events
from tcdyn.partition.friction import LEAST_ZERO, NOTHING_ADDED, FrictionAdded, contact_force

SPIKE_SAMPLES = 11  # 0.15 s: longer than a slip-ring spike, short against every lag
SPIKE_SIGMA = 6.0
MADE_OF = {"disk", "washer", "thermocouples"}  # tables of rig.toml that tell what a disk is
FINE_ROUNDING_K = 0.02  # rounding below a sixth of a usual channel's noise is left unsaid
SPIKES = re.compile(r"column (\w+), row .*?: (\d+) spike")


@dataclass(frozen=True)
class DiskTraces:
    """One disk in one test: static-corrected readings (N, 6) in the order a..f [degC], and how they were measured.

    ``missing`` (N, 6): where a spike or a gap was bridged by a straight line; ``noise_K`` (6,): white noise of each
    channel; ``static_u_K`` (6,): standard uncertainty of the static lines at the steady temperature;
    ``lag_covariance_s2`` (6, 6); ``uncertainty``: of what nobody measured, rig.toml's for this disk; ``inner_K``
    (N, 3): what d, b and f would read more if they lay as deep as b (see :mod:`tcdyn.partition.inner_row`).
    """

    name: str
    setup: DiskSetup
    readings_degC: NDArray[np.float64]
    missing: NDArray[np.bool_]
    chains: tuple[Chain, ...]
    noise_K: NDArray[np.float64]
    static_u_K: NDArray[np.float64]
    lag_covariance_s2: NDArray[np.float64]
    uncertainty: UncertaintyTable
    inner_K: NDArray[np.float64]

    @property
    def measured_degC(self) -> NDArray[np.float64]:
        """Readings (N, 6) with NaN where they are missing."""
        return np.where(self.missing, np.nan, self.readings_degC)

    @property
    def common_lag_s(self) -> float:
        """Mean of the channels' lags [s]."""
        return float(np.mean([c.lag_s for c in self.chains]))

    @property
    def common_lag_u_s(self) -> float:
        """Standard uncertainty of that mean [s]."""
        return float(np.sqrt(max(self.lag_covariance_s2.mean(), 0.0)))

    @property
    def mean_chain(self) -> Chain:
        """The chain with the mean of the channels' parameters."""
        taus = np.mean([sorted(c.taus_s, reverse=True) for c in self.chains], axis=0)
        return replace(
            self.chains[0],
            taus_s=tuple(float(x) for x in taus),
            zero_s=float(np.mean([c.zero_s for c in self.chains])),
            delay_s=float(np.mean([c.delay_s for c in self.chains])),
        )


@dataclass(frozen=True)
class EhlTest:
    """An EHL test ready for the fits; arrays of shape (N,) on an even time base.

    ``power_W`` is the whole frictional power F u_s; ``speeds_m_s`` (fast, slow) are the surface speeds under load;
    ``added`` the part of ``friction_N`` that the transducer did not see; ``exponent_half_range`` how
    far n may lie from ``speed_exponent``.
    """

    time_s: NDArray[np.float64]
    dt_s: float
    events: Events
    power_W: NDArray[np.float64]
    ambient_degC: NDArray[np.float64]
    load_N: float
    friction_N: float
    speeds_m_s: tuple[float, float]
    half_width_m: float
    speed_exponent: float
    exponent_half_range: float
    disks: Mapping[str, DiskTraces]
    warnings: tuple[str, ...]
    added: FrictionAdded = NOTHING_ADDED

    @property
    def sliding_speed_m_s(self) -> float:
        """u_s = u_f - u_s, eq. (2.1)."""
        return self.speeds_m_s[0] - self.speeds_m_s[1]

    @property
    def entraining_speed_m_s(self) -> float:
        """Mean of the surface speeds, eq. (2.2)."""
        return 0.5 * sum(self.speeds_m_s)

    @property
    def exponent_range(self) -> tuple[float, float]:
        """Where n may lie: as wide as [uncertainty] says, about the exponent in use."""
        return self.speed_exponent - self.exponent_half_range, self.speed_exponent + self.exponent_half_range

    @property
    def speed_ratio(self) -> float:
        """u_f / u_s of the surface speeds under load."""
        return self.speeds_m_s[0] / self.speeds_m_s[1]

    def rows(self, start_s: float, stop_s: float) -> slice:
        """The samples from ``start_s`` to before ``stop_s``."""
        return slice(int(np.searchsorted(self.time_s, start_s)), int(np.searchsorted(self.time_s, stop_s)))


def prepare(
    log: Log,
    rig: Rig,
    records: Mapping[str, DiskRecord],
    friction_added: Callable[[float, float], FrictionAdded] | None = None,
) -> EhlTest:
    """Apply static lines, take out spikes, find the events, and turn friction and speeds into power.

    ``friction_added`` (load [N], slow shaft [rpm]) is added to the friction of the contact: half of the bearings'
    friction (section 2.10), which the transducer on the slow shaft does not see.
    Raises InputError for a log without unloading, a compensated log, a missing record or a load that is not one.
    """
    where = log.path.name
    if log.metadata.get("tcdyn") == COMPENSATED:
        raise InputError(
            "this log is already compensated",
            where=where,
            remedy="give the log as it was recorded: the fits compensate it",
        )
    missing = [d for d in DISKS if d not in records]
    if missing:
        raise InputError(f"no record of the {missing[0]} disk", remedy=f"add --record {missing[0]}.disk.json")
    frame = log.frame
    t = frame["time_s"].to_numpy(dtype=float)
    dt = float(np.median(np.diff(t)))
    events = find_events(frame, where)
    warnings = [*gathered(log.warnings), *events.warnings]
    under_load = (t > events.load_on_s + 5) & (t < events.unload_s - 0.5)
    radius = [rig.disk_setup(d).outer_radius_m for d in DISKS]
    rpm = [float(np.nanmedian(frame[f"speed_{d}_rpm"].to_numpy(dtype=float)[under_load])) for d in DISKS]
    speeds = (surface_speed_m_s(rpm[0], radius[0]), surface_speed_m_s(rpm[1], radius[1]))
    if not speeds[0] > speeds[1] > 0:
        raise InputError(
            f"surface speeds {speeds[0]:.2f} (fast) and {speeds[1]:.2f} m/s (slow)",
            where=where,
            expected="a fast disk that is faster than the slow one",
            remedy="check speed_fast_rpm and speed_slow_rpm, or the [columns] of rig.toml",
        )
    ratio, nominal = speeds[0] / speeds[1], rig.common.contact.gear_ratio
    if abs(ratio / nominal - 1) > 0.05:
        warnings.append(
            f"the logged speeds have ratio {ratio:.3f}, rig.toml says gear_ratio = {nominal:.3f}: the log is used"
        )
    load = contact_force(t, frame["load_N"].to_numpy(dtype=float), events)
    friction = contact_force(t, frame["friction_N"].to_numpy(dtype=float), events)
    if np.sum(t < events.load_on_s - SETTLE_S) < LEAST_ZERO:
        warnings.append("the zeros of load cell and friction rest on the unloaded end alone: their drift is not seen")
    steady = (t > events.unload_s - 150) & (t < events.unload_s - 1) & under_load
    load_N, friction_N = float(np.mean(load[steady])), float(np.mean(friction[steady]))
    if load_N <= 0 or friction_N <= 0:
        raise InputError(
            f"load {load_N:.1f} N and friction {friction_N:.2f} N under contact",
            where=where,
            expected="both above zero",
        )
    added = NOTHING_ADDED if friction_added is None else friction_added(load_N, rpm[1])
    friction, friction_N = friction + added.value_N * load / load_N, friction_N + added.value_N
    warnings += added.warnings
    if not 0.002 < friction_N / load_N < 0.2:
        warnings.append(f"the friction coefficient {friction_N / load_N:.4f} is unlike an EHL contact: check units")
    crown = [rig.disk_setup(d).crown_radius_m for d in DISKS]
    half_width = half_width_m(load_N, equal_radius_m(*radius), equal_radius_m(*crown))
    unseen, u = added.u_N / friction_N, rig.common.uncertainty
    return EhlTest(
        time_s=t,
        dt_s=dt,
        events=events,
        power_W=friction * (speeds[0] - speeds[1]),
        ambient_degC=_filled(frame["ambient_degC"].to_numpy(dtype=float)),
        load_N=load_N,
        friction_N=friction_N,
        speeds_m_s=speeds,
        half_width_m=half_width,
        speed_exponent=rig.common.contact.speed_exponent,
        exponent_half_range=0.5 * (u.speed_exponent_high - u.speed_exponent_low),
        disks={d: disk_traces(frame, d, rig, records[d], steady, unseen, warnings, where) for d in DISKS},
        warnings=tuple(warnings),
        added=added,
    )


def gathered(warnings: Sequence[str]) -> list[str]:
    """The reader's warnings, those about spikes in one sentence: every slip ring has some."""
    spiky = [(int(found[2]), found[1]) for w in warnings if (found := SPIKES.search(w))]
    rest = [w for w in warnings if not SPIKES.search(w)]
    if not spiky:
        return rest
    total, (most, column) = sum(n for n, _ in spiky), max(spiky)
    return [f"{total} spikes in {len(spiky)} channels were taken as missing, most in {column} ({most})", *rest]


def disk_traces(
    frame: pd.DataFrame,
    disk: str,
    rig: Rig,
    record: DiskRecord,
    steady: NDArray[np.bool_],
    friction_u_rel: float,
    warnings: list[str],
    where: str,
) -> DiskTraces:
    """Static lines, spikes and noise of one disk; adds to ``warnings`` what a user should know.

    ``friction_u_rel``: relative uncertainty of friction besides rig.toml's.
    """
    setup, u = rig.disk_setup(disk), rig.tables(disk).uncertainty
    warnings += _other_disk(rig, disk, record)
    if record.disk not in (disk, setup.name):
        raise InputError(f"the record is of disk {record.disk!r}", where=where, expected=f"a record of {disk!r}")
    if record.chain is None:
        raise InputError(f"the record of the {disk} disk holds no chain", remedy="calibrate it with plunge logs")
    absent = [ch for ch in CHANNELS if ch not in record.static or ch not in record.chain.channels]
    if absent:
        raise InputError(f"the record of the {disk} disk lacks channel {absent[0]}", remedy="calibrate all six")
    columns, missing, static, coarse = [], [], [], []
    for ch in CHANNELS:
        line = record.static[ch]
        raw = frame[f"{disk}_{ch}_degC"].to_numpy(dtype=float)
        if (step := coarse_step_K(raw)) > 0:
            coarse.append((step, ch))
        values, marked = despiked(np.asarray(apply_static(raw, line), dtype=float))
        if np.mean(marked) > 0.05:
            warnings.append(f"{disk}_{ch}: {100 * np.mean(marked):.1f} % of the samples are spikes or missing")
        mean = float(np.mean(values[steady]))
        columns.append(values)
        missing.append(marked)
        static.append(float(np.hypot(static_u(line, mean), step / 12**0.5)))
    if coarse:
        warnings.append(f"{disk} disk: {coarse_sentence(coarse)}")
    y = np.column_stack(columns)
    warnings += extrapolated(f"{disk} disk", dict(zip(CHANNELS, y[steady].T)), record.static)
    return DiskTraces(
        name=disk,
        setup=setup,
        readings_degC=y,
        missing=np.column_stack(missing),
        chains=record_chains(record, setup),
        noise_K=white_noise(y),
        static_u_K=np.array(static),
        lag_covariance_s2=record.chain.lag_covariance(),
        uncertainty=u.model_copy(update={"friction_rel": float(np.hypot(u.friction_rel, friction_u_rel))}),
        inner_K=np.zeros((len(y), len(INNER_ROW))),
    )


def _other_disk(rig: Rig, disk: str, record: DiskRecord) -> list[str]:
    """What rig.toml says of the disk that the record was not made with: its lags were found with other numbers."""
    if "setup" not in record.model_fields_set:
        return []
    stated = rig.tables(disk).model_dump(include=MADE_OF)
    changed = changed_keys(record.setup.model_dump(include=MADE_OF), stated)
    differs = [f"{key} = {now} (record: {was})" for key, was, now in changed]
    if not differs:
        return []
    words = ", ".join(differs[:3]) + (f" and {len(differs) - 3} more" if len(differs) > 3 else "")
    return [f"{disk} disk: rig.toml is used, and is not what the record was made with: {words}"]


def record_chains(record: DiskRecord, setup: DiskSetup) -> tuple[Chain, ...]:
    """The chains of channels a..f as the record states them, conditioning filter included.

    Raises InputError when ``setup`` (rig.toml) states another filter: the record's lags were found with its own.
    """
    assert record.chain is not None
    own = record.conditioning.conditioning()
    if setup.conditioning.poles != own.poles or (own.poles > 0 and setup.conditioning != own):
        raise InputError(
            f"the record of disk {record.disk!r} was made with conditioning {_filter_text(own)}, "
            f"rig.toml states {_filter_text(setup.conditioning)}",
            expected="the filter that the disk was calibrated with",
            remedy="give --rig the rig file of the calibration, or calibrate again",
        )
    return tuple(
        Chain(
            taus_s=(c.tau1_s, c.tau2_s),
            zero_s=c.zero_s,
            delay_s=c.delay_s,
            conditioning=own,
        )
        for c in (record.chain.channels[ch] for ch in CHANNELS)
    )


def _filter_text(b: Conditioning) -> str:
    return f"of {b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape})" if b.poles else "of no pole"


def despiked(y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Trace with isolated spikes and missing samples bridged by straight lines, and where that was done; (N,)."""
    missing = ~np.isfinite(y)
    filled = _filled(y)
    away = np.abs(filled - median_filter(filled, SPIKE_SAMPLES, mode="nearest"))
    noise = float(white_noise(filled[:, None])[0])
    marked = missing | (away > SPIKE_SIGMA * max(noise, 1e-6))
    if not marked.any():
        return filled, marked
    rows = np.arange(len(y))
    return np.interp(rows, rows[~marked], filled[~marked]), marked


def white_noise(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviation of the white noise of each column, from third differences and their median; (N, M) -> (M,)."""
    return white_noise_sd(y, 3)


def coarse_sentence(coarse: Sequence[tuple[float, str]]) -> str:
    """What to say of channels, each with the step [K] that hides its noise."""
    return (
        f"the logger writes in steps of {max(coarse)[0]:.2g} K, coarser than the noise, in "
        f"{', '.join(ch for _, ch in coarse)}: such rounding is no white noise, and lags and transient fits may be "
        "further off than they say"
    )


def coarse_step_K(raw: NDArray[np.float64]) -> float:
    """Step of a logger that hides the noise of a trace (N,), zero where the noise is seen or the step is fine [K]."""
    rounding = rounding_sd(raw)
    hidden = rounding > FINE_ROUNDING_K and rounding >= float(white_noise(raw[:, None])[0])
    return rounding * 12**0.5 if hidden else 0.0


def _filled(y: NDArray[np.float64]) -> NDArray[np.float64]:
    good = np.isfinite(y)
    if good.all():
        return y
    rows = np.arange(len(y))
    return np.interp(rows, rows[good], y[good])
