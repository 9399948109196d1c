"""True values of the synthetic rig, which no fit may use: drawn once for each rig, frozen.

All other modules of ``tcdyn.simulate`` and many tests use them; estimators never do. Distributions
are chosen by judgement, or are those of the table [uncertainty] of rig.toml.
``tests/simulate/test_ehl.py`` checks the spread of uncertain rigs.
"""

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
    """Errors between the true temperatures and the log.

    ``CLEAN`` switches off all but the chain.

    Parameters
    ----------
    noise
        White noise of all channels.
    spikes
        Spikes of the slip rings.
    quantise
        16-bit converter.
    static
        Gain, offset and zero errors.
    drift
        Drift of friction, ambient, oil and bath.
    timing
        Switches and load cell that miss the instant of contact by up to 0.02 s, and the switch of a
        plunge, which is pressed by hand, by more.
    chain
        Lags of the measurement chain.
    """

    noise: bool = True
    spikes: bool = True
    quantise: bool = True
    static: bool = True
    drift: bool = True
    timing: bool = True
    chain: bool = True


# No errors but the lags of the chain.
CLEAN = Imperfections(
    noise=False, spikes=False, quantise=False, static=False, drift=False, timing=False
)


@dataclass(frozen=True)
class ChannelTruth:
    """True values of one channel.

    Parameters
    ----------
    tau1_s, tau2_s
        Lags of the sensor [s].
    gain, offset_degC
        Static line T = gain * logged + offset [degC].
    noise_K
        Standard deviation of the noise [K].
    spikes_per_s
        Mean number of spikes per second.
    """

    tau1_s: float
    tau2_s: float
    gain: float
    offset_degC: float
    noise_K: float
    spikes_per_s: float

    def lag_s(self, conditioning: Conditioning) -> float:
        """Return the lag [s]: first moment of the impulse response, filter included."""
        return self.tau1_s + self.tau2_s + conditioning.lag_s


@dataclass(frozen=True)
class BoreContact:
    """Conductance of the press fit: 1 + ``amplitude`` cos(angle - ``angle_deg``) times its mean.

    Parameters
    ----------
    amplitude
        Relative amplitude of the first harmonic of the conductance, from 0 (even) to 1.
    angle_deg
        Angle at which the conductance is largest [deg].
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
        """Check amplitude and angle.

        Raises
        ------
        InputError
            If amplitude or angle are out of range.
        """
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

    def relative_conductance(self, psi_rad: Array) -> Array:
        """Return the conductance over its mean.

        Parameters
        ----------
        psi_rad
            Equidistant angles from ``angle_deg`` (N,) [rad]. With sectors each value is the mean
            over one step.

        Returns
        -------
        array
            Relative conductance (N,).
        """
        if not self.sectors:
            return 1 + self.amplitude * np.cos(psi_rad)
        half_step_deg = 180.0 / len(psi_rad)
        psi_deg = np.rad2deg(psi_rad)
        edges = np.append(psi_deg - half_step_deg, psi_deg[-1] + half_step_deg) + self.angle_deg
        return mean_shares(self.sectors, edges) / harmonics(self.sectors, 0)[0].real


@dataclass(frozen=True)
class DiskTruth:
    """The true disk, its shaft and its channels.

    Parameters
    ----------
    setup
        Geometry and steel; they may differ from those of ``rig.toml``.
    channels
        Channels by name.
    bore_conductance_W_m2K
        Mean conductance of the press fit, section 6.4.3.
    shaft_W_m2K
        Heat transfer coefficient from the shaft to the enclosure [W/m2K].
    bearing_offset_K
        Temperatures of the shaft ends above ambient, at z < 0 and z > width [K].
    uneven
        Variation of that conductance around the bore.
    film_air_K
        Temperature above ambient of the fluid that the running surface loses heat to [K].
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
    fast, slow
        The disks.
    gear_ratio
        Speed of the fast disk over that of the slow one.
    speed_exponent
        n of h_fast / h_slow = gear_ratio ** n.
    half_width_scale
        True over nominal half width of the track.
    friction_scale
        Logged over true friction.
    ambient_bias_K
        Logged minus true ambient temperature [K].
    imperfections
        Errors of the logs.
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
    """Return a generator that depends on the seed and its purpose, never on earlier draws.

    Parameters
    ----------
    seed
        Seed of the rig or campaign.
    keys
        Purpose of the draws, such as "plunge", "fast", "1".

    Notes
    -----
    A new purpose needs new keys. Other keys for an old purpose change all logs of
    ``tests/behaviour``.
    """
    return np.random.default_rng([seed, *(crc32(key.encode()) for key in keys)])


def draw_truth(
    seed: int, rig: Rig | None = None, *, uncertain: bool = False, exponent: float | None = None
) -> RigTruth:
    """Draw the true values of a rig.

    Chains, static lines and noise always differ from rig to rig.

    Parameters
    ----------
    seed
        Seed of the random draws.
    rig
        Nominal rig.
    uncertain
        False: steel, washers, depths, track width, friction transducer and ambient sensor are those
        of ``rig``, and n is normal, that of ``rig`` +- 0.02. True: they are drawn from its
        [uncertainty] table (normal; steel and washers common to both disks, depths one by one), and
        n uniformly from its range.
    exponent
        The exact n.

    Returns
    -------
    RigTruth
        The true values, with all imperfections.

    Notes
    -----
    Keep the order of the draws: another order changes every rig, and all logs of
    ``tests/behaviour``.

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
    """Draw the factors on nominal values, and the bias of the ambient sensor [K].

    Parameters
    ----------
    rng
        Random numbers.
    table
        Relative standard uncertainties.

    Returns
    -------
    dict
        Factors by quantity, and "ambient", the bias [K]. Normal, clipped at 3 standard deviations.
    """
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
    """Draw the true setup of a disk from its nominal one.

    Parameters
    ----------
    rng
        Random numbers of the disk.
    setup
        Nominal setup.
    factors
        Factors of steel and washers, common to both disks.
    table
        Standard uncertainty of the depths.

    Returns
    -------
    DiskSetup
        The true setup; no depth is below 0.2 mm.
    """
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
    """Draw the true flux profile of a disk: shifted, and a table of it wider.

    Parameters
    ----------
    rng
        Random numbers of the profile.
    setup
        Nominal setup.
    rig
        Nominal rig with the uncertainty of the shift.
    width_factor
        Factor on the half width.

    Returns
    -------
    FluxProfile
        The true profile.
    """
    z = float(np.clip(rng.standard_normal(), -3, 3))
    shift_m = z * 1e-3 * rig.tables(setup.name).uncertainty.flux_shift_mm
    flux = setup.flux
    at_m = tuple(width_factor * x for x in flux.at_m)
    return replace(flux, shift_m=flux.shift_m + shift_m, at_m=at_m)


def _draw_disk(rng: np.random.Generator, name: str, setup: DiskSetup) -> DiskTruth:
    """Draw the channels of a disk, its press fit and its shaft.

    Parameters
    ----------
    rng
        Random numbers of the disk.
    name
        "fast" or "slow".
    setup
        True setup.

    Returns
    -------
    DiskTruth
        The true disk with an even press fit.

    Notes
    -----
    Chosen by judgement around the thesis: mean lags of 0.75 and 0.72 s with the filter, press fits
    of 900 and 1600 W/m2K, a shaft of 60 W/m2K. ``draw_truth`` shows the range of the lags in its
    example.
    """
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
    """Return the disk with conductance and unevenness of the press fit of ``rig.toml``, if any.

    Parameters
    ----------
    disk
        True values of the disk.
    nominal
        Nominal setup.

    Returns
    -------
    DiskTruth
        The disk; unchanged where rig.toml specifies no press fit.
    """
    if not nominal.press_fit.is_specified:
        return disk
    sectors = nominal.press_fit.sectors(1e3 * nominal.bore_radius_m)
    _, bearing = press_fit_conductance(nominal)
    shares = harmonics(sectors, 1)
    contact = BoreContact(*amplitude_and_angle(shares, 1), sectors)
    return replace(disk, bore_conductance_W_m2K=bearing * float(shares[0].real), uneven=contact)


def truth_as_dict(truth: RigTruth) -> dict[str, Any]:
    """Return the rig as plain numbers with its lags, as ``truth/truth.json`` holds it.

    Parameters
    ----------
    truth
        True values of the rig.

    Returns
    -------
    dict
        Values by the keys of the file.
    """
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
