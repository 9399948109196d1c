"""Everything the synthetic rig knows and the fits do not: drawn once per rig, frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from zlib import crc32

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.result import jsonable
from tcdyn.rig.contact import press_fit
from tcdyn.rig.disk import DISKS, Conditioning, DiskSetup, Junction
from tcdyn.rig.flux_profile import FluxProfile
from tcdyn.rig.press_fit import Sectors, amplitude_and_angle, harmonics, mean_shares
from tcdyn.rig.rigfile import Rig, UncertaintyTable, load_rig


@dataclass(frozen=True)
class Imperfections:
    """What the rig does to the truth before it reaches the file; ``CLEAN`` switches all of it off but the chain.

    ``static``: gain and offset errors; ``drift``: wander of friction, ambient, oil and bath; ``timing``: switches
    and load cell that miss the instant of contact by up to 0.02 s, and the hand by more.
    """

    noise: bool = True
    spikes: bool = True
    quantise: bool = True
    static: bool = True
    drift: bool = True
    timing: bool = True
    chain: bool = True


CLEAN = Imperfections(
    noise=False, spikes=False, quantise=False, static=False, drift=False, timing=False
)


@dataclass(frozen=True)
class ChannelTruth:
    """One channel: two lags [s], the line T = gain * logged + offset, white noise [K], spikes per second."""

    tau1_s: float
    tau2_s: float
    gain: float
    offset_degC: float
    noise_K: float
    spikes_per_s: float

    def lag_s(self, conditioning: Conditioning) -> float:
        """First moment of the chain's impulse response, the conditioning filter included [s]."""
        return self.tau1_s + self.tau2_s + conditioning.lag_s


@dataclass(frozen=True)
class BoreContact:
    """The press fit conducts 1 + ``amplitude`` cos(angle - ``angle_deg``) of its mean round the bore.

    ``sectors``: what rig.toml states of keyways and patches; all of it conducts, and the other two are its first
    harmonic.
    """

    amplitude: float = 0.0
    angle_deg: float = 0.0
    sectors: Sectors = ()

    def __post_init__(self) -> None:
        if not (0 <= self.amplitude <= (2 if self.sectors else 1) and abs(self.angle_deg) <= 360):
            raise InputError(
                f"uneven contact {self.amplitude:g}@{self.angle_deg:g}",
                expected="an amplitude of 0 (even) to 1 (no contact on one side) at -360 to 360 degrees",
            )

    @property
    def even(self) -> bool:
        """Whether it conducts alike all round."""
        return not (self.amplitude or self.sectors)

    def relative(self, psi_rad: Array) -> Array:
        """Conductance over its mean at ``psi_rad`` (N,), evenly round from ``angle_deg``, (N,)."""
        if not self.sectors:
            return 1 + self.amplitude * np.cos(psi_rad)
        half = 180.0 / len(psi_rad)
        edges = (
            np.append(np.rad2deg(psi_rad) - half, np.rad2deg(psi_rad[-1]) + half) + self.angle_deg
        )
        return mean_shares(self.sectors, edges) / harmonics(self.sectors, 0)[0].real


@dataclass(frozen=True)
class DiskTruth:
    """One disk as it really is (``setup`` may differ from ``rig.toml``), its shaft and its channels."""

    setup: DiskSetup
    channels: Mapping[str, ChannelTruth]
    bore_conductance_W_m2K: float  # press fit, section 6.4.3
    shaft_W_m2K: float  # shaft surface to the enclosure
    bearing_offset_K: tuple[float, float]  # shaft ends against ambient, at z < 0 and z > width
    uneven: BoreContact = BoreContact()
    film_air_K: float = 0.0  # of what the running surface loses heat to, above the ambient

    @property
    def lags_s(self) -> dict[str, float]:
        """Lag of each channel [s]."""
        return {name: c.lag_s(self.setup.conditioning) for name, c in self.channels.items()}

    @property
    def common_lag_s(self) -> float:
        """Mean lag of the disk's channels [s]."""
        return float(np.mean(list(self.lags_s.values())))


@dataclass(frozen=True)
class RigTruth:
    """Both disks and what belongs to the rig as a whole."""

    fast: DiskTruth
    slow: DiskTruth
    gear_ratio: float
    speed_exponent: float  # h_fast / h_slow = gear_ratio ** speed_exponent
    half_width_scale: float = 1.0
    friction_scale: float = 1.0  # logged friction over true friction
    ambient_bias_K: float = 0.0  # logged ambient minus true ambient
    imperfections: Imperfections = field(default_factory=Imperfections)

    def disk(self, name: str) -> DiskTruth:
        """The disk called "fast" or "slow"."""
        return {"fast": self.fast, "slow": self.slow}[name]

    def with_uneven(self, contact: Mapping[str, BoreContact]) -> RigTruth:
        """The same rig with the bore contact of the named disks uneven."""
        return replace(self, **{d: replace(self.disk(d), uneven=own) for d, own in contact.items()})  # type: ignore[arg-type]

    def with_film_air(self, warmer_K: float) -> RigTruth:
        """The same rig whose running surfaces lose heat to what is ``warmer_K`` warmer than the ambient."""
        disks: Any = {name: replace(self.disk(name), film_air_K=warmer_K) for name in DISKS}
        return replace(self, **disks)

    def with_imperfections(self, imperfections: Imperfections) -> RigTruth:
        """The same rig, measured differently."""
        return replace(self, imperfections=imperfections)


def rng_for(seed: int, *keys: str) -> np.random.Generator:
    """A generator that depends on the seed and on what it is for, never on what else was drawn before."""
    return np.random.default_rng([seed, *(crc32(key.encode()) for key in keys)])


def draw_truth(
    seed: int, rig: Rig | None = None, *, uncertain: bool = False, exponent: float | None = None
) -> RigTruth:
    """Draw a rig.

    Chains, static lines and noise always differ from rig to rig. ``uncertain=False`` leaves steel, washers,
    depths, track width, friction transducer and ambient sensor as ``rig`` states them; True draws them from rig's
    [uncertainty] table (normal; steel and washers common to both disks, depths one by one) and n uniformly from
    its stated range. Otherwise n is normal, rig's own +- 0.02; ``exponent`` sets it exactly.

    >>> a, b = draw_truth(3), draw_truth(3)
    >>> a == b, 0.6 < a.fast.common_lag_s < 0.9
    (True, True)
    """
    rig = rig or load_rig()
    rng = rng_for(seed, "rig")
    table = rig.common.uncertainty
    contact = rig.common.contact
    factors = _draw_factors(rng, table)
    n_uncertain = rng.uniform(table.speed_exponent_low, table.speed_exponent_high)
    n_usual = contact.speed_exponent + float(np.clip(rng.normal(0, 0.02), -0.05, 0.05))
    disks = {}
    for name in DISKS:
        own = rng_for(seed, "disk", name)
        setup = rig.disk_setup(name)
        moved = _draw_setup(own, setup, factors, rig.tables(name).uncertainty)
        if uncertain:
            moved = replace(
                moved,
                flux=_draw_flux(rng_for(seed, "flux", name), setup, rig, factors["half_width"]),
            )
        disks[name] = _fitted(_draw_disk(own, name, moved if uncertain else setup), setup)
    return RigTruth(
        fast=disks["fast"],
        slow=disks["slow"],
        gear_ratio=contact.gear_ratio,
        speed_exponent=float(
            exponent if exponent is not None else n_uncertain if uncertain else n_usual
        ),
        half_width_scale=factors["half_width"] if uncertain else 1.0,
        friction_scale=factors["friction"] if uncertain else 1.0,
        ambient_bias_K=factors["ambient"] if uncertain else 0.0,
    )


def _draw_factors(rng: np.random.Generator, table: UncertaintyTable) -> dict[str, float]:
    z = np.clip(rng.standard_normal(6), -3, 3)
    return {
        "conductivity": float(1 + table.conductivity_rel * z[0]),
        "heat_capacity": float(1 + table.heat_capacity_rel * z[1]),
        "washer": float(max(1 + table.washer_rel * z[2], 0.1)),
        "half_width": float(1 + table.half_width_rel * z[3]),
        "friction": float(1 + table.friction_rel * z[4]),
        "ambient": float(table.ambient_K * z[5]),
    }


def _draw_setup(
    rng: np.random.Generator, setup: DiskSetup, factors: dict[str, float], table: UncertaintyTable
) -> DiskSetup:
    shifts = np.clip(rng.standard_normal(len(setup.junctions)), -3, 3) * table.depth_mm * 1e-3
    junctions = {
        name: Junction(max(j.depth_m + dz, 0.2e-3), j.z_m, j.angle_deg)
        for (name, j), dz in zip(sorted(setup.junctions.items()), shifts)
    }
    return replace(
        setup,
        conductivity_W_mK=setup.conductivity_W_mK * factors["conductivity"],
        specific_heat_J_kgK=setup.specific_heat_J_kgK * factors["heat_capacity"],
        washer_conductivity_W_mK=setup.washer_conductivity_W_mK * factors["washer"],
        junctions=junctions,
    )


def _draw_flux(rng: np.random.Generator, setup: DiskSetup, rig: Rig, wider: float) -> FluxProfile:
    off = (
        float(np.clip(rng.standard_normal(), -3, 3))
        * 1e-3
        * rig.tables(setup.name).uncertainty.flux_shift_mm
    )
    return replace(
        setup.flux, shift_m=setup.flux.shift_m + off, at_m=tuple(wider * x for x in setup.flux.at_m)
    )


def _draw_disk(rng: np.random.Generator, name: str, setup: DiskSetup) -> DiskTruth:
    common = (0.75 if name == "fast" else 0.72) + 0.03 * rng.uniform(-1, 1)
    spread = 0.04 * np.clip(rng.standard_normal(len(setup.junctions)), -2, 2)
    own = max(common - setup.conditioning.lag_s, 0.3)
    channels = {}
    for shift, channel in zip(spread - spread.mean(), sorted(setup.junctions)):
        tau2 = rng.uniform(0.08, 0.16)
        channels[channel] = ChannelTruth(
            tau1_s=float(own + shift - tau2),
            tau2_s=float(tau2),
            gain=float(1 + rng.uniform(-0.005, 0.005)),
            offset_degC=float(rng.uniform(-0.5, 0.5)),
            noise_K=float(rng.uniform(0.12, 0.15)),
            spikes_per_s=float((0.03 if name == "fast" else 0.008) * rng.uniform(0.5, 1.5)),
        )
    return DiskTruth(
        setup=setup,
        channels=channels,
        bore_conductance_W_m2K=float(
            (900.0 if name == "fast" else 1600.0) * rng.uniform(0.8, 1.25)
        ),
        shaft_W_m2K=float(60.0 * rng.uniform(0.85, 1.15)),
        bearing_offset_K=(float(rng.uniform(0, 6)), float(rng.uniform(-3, 3))),
    )


def _fitted(disk: DiskTruth, stated: DiskSetup) -> DiskTruth:
    """The disk with the mean conductance and the unevenness of the press fit that the rig states, if any."""
    if not stated.fit.stated:
        return disk
    sectors = stated.fit.sectors(1e3 * stated.bore_radius_m)
    (_, bearing) = press_fit(stated)
    shares = harmonics(sectors, 1)
    contact = BoreContact(*amplitude_and_angle(shares, 1), sectors)
    return replace(disk, bore_conductance_W_m2K=bearing * float(shares[0].real), uneven=contact)


def truth_as_dict(truth: RigTruth) -> dict[str, Any]:
    """The rig as plain numbers, with the derived lags beside them: what ``truth/truth.json`` holds."""
    out: dict[str, Any] = jsonable(truth)
    for name in DISKS:
        disk = truth.disk(name)
        out[name]["common_lag_s"] = disk.common_lag_s
        for c, lag in disk.lags_s.items():
            out[name]["channels"][c] |= {
                "lag_s": lag,
                "differential_lag_s": lag - disk.common_lag_s,
            }
    return out
