"""True values of the synthetic rig, which no fit may use: drawn once for each rig, frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from zlib import crc32

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.result import jsonable
from tcdyn.rig.contact import press_fit_conductance
from tcdyn.rig.disk import DISKS, Conditioning, DiskSetup, Junction
from tcdyn.rig.press_fit import Sectors, amplitude_and_angle, harmonics, mean_shares
from tcdyn.rig.rigfile import Rig, UncertaintyTable, load_rig
from tcdyn.rig.tables import FluxProfile


@dataclass(frozen=True)
class Imperfections:
    """Errors between the true temperatures and the log; ``CLEAN`` switches off all but the chain.

    ``static``: gain and offset errors. ``drift``: drift of friction, ambient, oil and bath.
    ``timing``: switches and load cell that miss the instant of contact by up to 0.02 s, and the
    switch pressed by hand by more.
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
    """One channel: two lags [s], line T = gain * logged + offset, noise [K], spikes per second."""

    tau1_s: float
    tau2_s: float
    gain: float
    offset_degC: float
    noise_K: float
    spikes_per_s: float

    def lag_s(self, conditioning: Conditioning) -> float:
        """Return first moment of the chain's impulse response, with the conditioning filter [s]."""
        return self.tau1_s + self.tau2_s + conditioning.lag_s


@dataclass(frozen=True)
class BoreContact:
    """Conductance of the press fit: 1 + ``amplitude`` cos(angle - ``angle_deg``) times its mean.

    Parameters
    ----------
    sectors
        Keyways and patches of rig.toml. With them, they are the conductance, and ``amplitude`` and
        ``angle_deg`` are its first harmonic.

    Raises
    ------
    InputError
        If amplitude or angle are out of range.
    """

    amplitude: float = 0.0
    angle_deg: float = 0.0
    sectors: Sectors = ()

    def __post_init__(self) -> None:
        """Check amplitude and angle."""
        max_amplitude = 2 if self.sectors else 1
        if not (0 <= self.amplitude <= max_amplitude and abs(self.angle_deg) <= 360):
            raise InputError(
                f"uneven contact {self.amplitude:g}@{self.angle_deg:g}",
                expected="an amplitude of 0 (even) to 1 (no contact on one side) at -360 to 360 "
                "degrees",
            )

    @property
    def even(self) -> bool:
        """Whether the conductance is the same at all angles."""
        return not (self.amplitude or self.sectors)

    def relative(self, psi_rad: Array) -> Array:
        """Return conductance over its mean (N,) at equidistant angles from ``angle_deg`` (N,)."""
        if not self.sectors:
            return 1 + self.amplitude * np.cos(psi_rad)
        half_step_deg = 180.0 / len(psi_rad)
        psi_deg = np.rad2deg(psi_rad)
        edges = np.append(psi_deg - half_step_deg, psi_deg[-1] + half_step_deg) + self.angle_deg
        return mean_shares(self.sectors, edges) / harmonics(self.sectors, 0)[0].real


@dataclass(frozen=True)
class DiskTruth:
    """The true disk (``setup`` may differ from ``rig.toml``), its shaft and its channels.

    Parameters
    ----------
    bore_conductance_W_m2K
        Mean conductance of the press fit, section 6.4.3.
    shaft_W_m2K
        Heat transfer coefficient from the shaft to the enclosure.
    bearing_offset_K
        Temperatures of the shaft ends above ambient, at z < 0 and z > width.
    film_air_K
        Temperature above ambient of the fluid that the running surface loses heat to.
    """

    setup: DiskSetup
    channels: Mapping[str, ChannelTruth]
    bore_conductance_W_m2K: float
    shaft_W_m2K: float
    bearing_offset_K: tuple[float, float]
    uneven: BoreContact = BoreContact()
    film_air_K: float = 0.0

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
    """Both disks and the values of the complete rig.

    Parameters
    ----------
    speed_exponent
        n of h_fast / h_slow = gear_ratio ** n.
    friction_scale
        Logged over true friction.
    ambient_bias_K
        Logged minus true ambient temperature.
    """

    fast: DiskTruth
    slow: DiskTruth
    gear_ratio: float
    speed_exponent: float
    half_width_scale: float = 1.0
    friction_scale: float = 1.0
    ambient_bias_K: float = 0.0
    imperfections: Imperfections = field(default_factory=Imperfections)

    def disk(self, name: str) -> DiskTruth:
        """Return the disk "fast" or "slow"."""
        return {"fast": self.fast, "slow": self.slow}[name]

    def with_uneven(self, contact: Mapping[str, BoreContact]) -> RigTruth:
        """Return the same rig with other bore contacts of the named disks."""
        disks: Any = {name: replace(self.disk(name), uneven=c) for name, c in contact.items()}
        return replace(self, **disks)

    def with_film_air(self, warmer_K: float) -> RigTruth:
        """Return the same rig whose surfaces lose heat to a fluid ``warmer_K`` above ambient."""
        disks: Any = {name: replace(self.disk(name), film_air_K=warmer_K) for name in DISKS}
        return replace(self, **disks)

    def with_imperfections(self, imperfections: Imperfections) -> RigTruth:
        """Return the same rig with other errors of measurement."""
        return replace(self, imperfections=imperfections)


def rng_for(seed: int, *keys: str) -> np.random.Generator:
    """Return a generator that depends on the seed and its purpose, never on earlier draws."""
    return np.random.default_rng([seed, *(crc32(key.encode()) for key in keys)])


def draw_truth(
    seed: int, rig: Rig | None = None, *, uncertain: bool = False, exponent: float | None = None
) -> RigTruth:
    """Draw a rig. Chains, static lines and noise always differ from rig to rig.

    Parameters
    ----------
    rig
        Nominal rig.
    uncertain
        False: steel, washers, depths, track width, friction transducer and ambient sensor are those
        of ``rig``, and n is normal, that of ``rig`` +- 0.02. True: they are drawn from its
        [uncertainty] table (normal; steel and washers common to both disks, depths one by one), and
        n uniformly from its range.
    exponent
        The exact n.

    Examples
    --------
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
    n_nominal = contact.speed_exponent + float(np.clip(rng.normal(0, 0.02), -0.05, 0.05))
    if exponent is None:
        exponent = n_uncertain if uncertain else n_nominal
    disks = {}
    for name in DISKS:
        nominal = rig.disk_setup(name)
        disk_rng = rng_for(seed, "disk", name)
        # Drawn in any case, so that the draws of the channels do not depend on ``uncertain``.
        setup = _draw_setup(disk_rng, nominal, factors, rig.tables(name).uncertainty)
        if uncertain:
            flux_rng = rng_for(seed, "flux", name)
            setup = replace(setup, flux=_draw_flux(flux_rng, nominal, rig, factors["half_width"]))
        else:
            setup = nominal
        disks[name] = _with_nominal_fit(_draw_disk(disk_rng, name, setup), nominal)
    return RigTruth(
        fast=disks["fast"],
        slow=disks["slow"],
        gear_ratio=contact.gear_ratio,
        speed_exponent=float(exponent),
        half_width_scale=factors["half_width"] if uncertain else 1.0,
        friction_scale=factors["friction"] if uncertain else 1.0,
        ambient_bias_K=factors["ambient"] if uncertain else 0.0,
    )


def _draw_factors(rng: np.random.Generator, table: UncertaintyTable) -> dict[str, float]:
    """Draw the factors on nominal values, and the bias of the ambient sensor [K]."""
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
    """Draw the true setup of a disk from its nominal one."""
    shifts = np.clip(rng.standard_normal(len(setup.junctions)), -3, 3) * table.depth_mm * 1e-3
    junctions = {
        name: Junction(max(j.depth_m + shift, 0.2e-3), j.z_m, j.angle_deg)
        for (name, j), shift in zip(sorted(setup.junctions.items()), shifts)
    }
    return replace(
        setup,
        conductivity_W_mK=setup.conductivity_W_mK * factors["conductivity"],
        specific_heat_J_kgK=setup.specific_heat_J_kgK * factors["heat_capacity"],
        washer_conductivity_W_mK=setup.washer_conductivity_W_mK * factors["washer"],
        junctions=junctions,
    )


def _draw_flux(
    rng: np.random.Generator, setup: DiskSetup, rig: Rig, width_factor: float
) -> FluxProfile:
    """Draw the true flux profile of a disk: shifted, and a table of it wider."""
    z = float(np.clip(rng.standard_normal(), -3, 3))
    shift_m = z * 1e-3 * rig.tables(setup.name).uncertainty.flux_shift_mm
    flux = setup.flux
    at_m = tuple(width_factor * x for x in flux.at_m)
    return replace(flux, shift_m=flux.shift_m + shift_m, at_m=at_m)


def _draw_disk(rng: np.random.Generator, name: str, setup: DiskSetup) -> DiskTruth:
    """Draw the channels of a disk, its press fit and its shaft."""
    is_fast = name == "fast"
    common_lag = (0.75 if is_fast else 0.72) + 0.03 * rng.uniform(-1, 1)
    spread = 0.04 * np.clip(rng.standard_normal(len(setup.junctions)), -2, 2)
    sensor_lag = max(common_lag - setup.conditioning.lag_s, 0.3)
    channels = {}
    for shift, channel in zip(spread - spread.mean(), sorted(setup.junctions)):
        tau2 = rng.uniform(0.08, 0.16)
        channels[channel] = ChannelTruth(
            tau1_s=float(sensor_lag + shift - tau2),
            tau2_s=float(tau2),
            gain=float(1 + rng.uniform(-0.005, 0.005)),
            offset_degC=float(rng.uniform(-0.5, 0.5)),
            noise_K=float(rng.uniform(0.12, 0.15)),
            spikes_per_s=float((0.03 if is_fast else 0.008) * rng.uniform(0.5, 1.5)),
        )
    conductance = (900.0 if is_fast else 1600.0) * rng.uniform(0.8, 1.25)
    return DiskTruth(
        setup=setup,
        channels=channels,
        bore_conductance_W_m2K=float(conductance),
        shaft_W_m2K=float(60.0 * rng.uniform(0.85, 1.15)),
        bearing_offset_K=(float(rng.uniform(0, 6)), float(rng.uniform(-3, 3))),
    )


def _with_nominal_fit(disk: DiskTruth, nominal: DiskSetup) -> DiskTruth:
    """Return the disk with conductance and unevenness of the press fit of ``rig.toml``, if any."""
    if not nominal.press_fit.is_specified:
        return disk
    sectors = nominal.press_fit.sectors(1e3 * nominal.bore_radius_m)
    _, bearing = press_fit_conductance(nominal)
    shares = harmonics(sectors, 1)
    contact = BoreContact(*amplitude_and_angle(shares, 1), sectors)
    return replace(disk, bore_conductance_W_m2K=bearing * float(shares[0].real), uneven=contact)


def truth_as_dict(truth: RigTruth) -> dict[str, Any]:
    """Return the rig as plain numbers with its lags, as ``truth/truth.json`` holds it."""
    out: dict[str, Any] = jsonable(truth)
    for name in DISKS:
        disk = truth.disk(name)
        setup = out[name]["setup"]
        setup["fit"] = setup.pop("press_fit")  # the key of this file since version 0.2
        out[name]["common_lag_s"] = disk.common_lag_s
        for channel, lag in disk.lags_s.items():
            out[name]["channels"][channel] |= {
                "lag_s": lag,
                "differential_lag_s": lag - disk.common_lag_s,
            }
    return out
