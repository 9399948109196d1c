"""What a stated press fit makes of a disk's temperature round the bore: the prior of its harmonics.

The mean heat through the bore is that of the rim's own balance; round it q_n = sum of H_(n-m) D_m, with H_n the
Fourier coefficients of the stated conductance and D_n = T_disk - T_shaft at the bore. A wave of flux q_n that enters
the shaft warms it by q_n / Y_shaft and cools the disk by q_n / Y_disk, so D_n = -q_n (1/Y_disk + 1/Y_shaft) for n other
than zero, Y_disk of the rim's Bessel functions, Y_shaft of a long solid cylinder heated over the disk's width.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, warning
from tcdyn.partition.angular_harmonic import (
    SECOND_HARMONIC_REL,
    SIGNIFICANT_Z,
    Unevenness,
    harmonic_prior_K,
    radial_shape,
    washer_kappa,
)
from tcdyn.partition.events import DiskTraces, EhlTest
from tcdyn.rig.contact import press_fit
from tcdyn.rig.disk import DISKS, DiskSetup
from tcdyn.rig.press_fit import harmonics

N_HARMONICS = 8  # harmonics that couple; more change the first two by less than a hundredth
STEP_M = 1e-5
MODEL_REL = 0.3  # of the predicted harmonic: a bored shaft, short runs, a rim taken as thin; whole-disk runs: to 0.28
MIN_FLUX_U = (
    0.5  # of the flux through the bore: below it all that is known is that some heat goes there
)
ANGLE_REL = 0.1  # of the harmonic: across it, by the model; whole-disk runs: 5 degrees
FLUX_SCALES = np.linspace(0.0, 8.0, 161)  # of the heat through the bore, tried
WINDOW_S = 20.0  # before the parting


@dataclass(frozen=True)
class PressFitHarmonics:
    """Harmonics at the depth of b for a kW/m2 through the bore: ``first_K`` and ``second_K`` (2,), cos and sin;
    ``per_share_K``: size of the first for each unit of a small first harmonic of the conductance, as a share of its
    mean."""

    first_K: Array
    second_K: Array
    per_share_K: float

    def scaled(self, flux_kW_m2: float) -> PressFitHarmonics:
        """The same for another flux."""
        return PressFitHarmonics(
            flux_kW_m2 * self.first_K, flux_kW_m2 * self.second_K, flux_kW_m2 * self.per_share_K
        )

    def distance_z(self, uneven_rel: float, flux_rel: float, found: Unevenness) -> float:
        """Least distance of what was ``found`` from the statement, in standard uncertainties, whatever heat goes
        through the bore: this is known to ``flux_rel``, and goes outward."""
        size = float(np.hypot(*self.first_K))
        rel = float(np.hypot(flux_rel, MODEL_REL))
        least = np.inf
        for scale in FLUX_SCALES:
            other_K = np.hypot(
                uneven_rel * self.per_share_K * max(scale, 1.0), ANGLE_REL * scale * size
            )
            off = found.level_K - scale * self.first_K
            z2 = off @ np.linalg.solve(found.level_covariance_K2 + other_K**2 * np.eye(2), off)
            least = min(least, float(z2) + ((scale - 1) / rel) ** 2)
        return float(np.sqrt(least))

    def prior(self, uneven_rel: float, flux_rel: float, found: Unevenness) -> Unevenness:
        """What is to be expected of such a disk, the stated conductance known to ``uneven_rel`` of its mean, the heat
        through the bore to ``flux_rel``.

        What a fit ``found`` of the first harmonic, without the statement, tells how much heat goes through the bore,
        and so how large the second is, which no fit tells.
        """
        size = float(np.hypot(*self.first_K))
        rel = float(np.hypot(flux_rel, MODEL_REL))
        toward = self.first_K / max(size, 1e-9)
        other_K = uneven_rel * self.per_share_K
        seen = float(found.level_K @ toward)
        seen_u = float(np.sqrt(toward @ found.level_covariance_K2 @ toward + other_K**2))
        trust = (rel * size) ** 2 / ((rel * size) ** 2 + seen_u**2)
        scale = max(1 + trust * (seen / size - 1), 0.0) if size > 0 else 1.0
        second_rel = float(np.hypot(rel * np.sqrt(1 - trust), MODEL_REL))
        second_K = scale * self.second_K
        prior = harmonic_prior_K(size)
        prior[0] = np.hypot(other_K, rel * size)
        return Unevenness(
            prior,
            h_W_m2K=found.h_W_m2K,
            steady_window_s=found.steady_window_s,
            angle_level_K=found.level_K,
            nominal_K=self.first_K,
            second_harmonic_u_K=float(
                np.hypot(second_rel * np.hypot(*second_K), SECOND_HARMONIC_REL * scale * size)
            ),
            nominal_second_K=second_K,
        )


def disk_admittance(setup: DiskSetup, h_W_m2K: float, n: int) -> tuple[float, float]:
    """Y = -K T_n'/T_n at the bore [W/m2K], and T_n there over T_n at the depth of b."""
    wall = setup.outer_radius_m - setup.bore_radius_m
    out, at = radial_shape(setup, h_W_m2K, np.array([wall - STEP_M, wall]), n)
    return float(-setup.conductivity_W_mK * (out - at) / STEP_M / at), float(at)


def shaft_admittance(setup: DiskSetup, n: int) -> float:
    """Even flux over the disk's width w over the mean of T_n there, on a long solid shaft [W/m2K].

    1/Y = (w/pi) integral of sinc^2(l w/2) / (K l I_n'(l R)/I_n(l R)) dl.
    """
    k = setup.conductivity_W_mK
    radius = setup.bore_radius_m
    w = setup.width_m
    wave = np.linspace(0.0, 80.0 / w, 8001)[1:] - 40.0 / w / 8000
    bessel = special.ive(n, wave * radius)
    slope = 0.5 * (special.ive(n - 1, wave * radius) + special.ive(n + 1, wave * radius))
    hindrance = np.sinc(0.5 * wave * w / np.pi) ** 2 * bessel / (k * wave * slope)
    return float(np.pi / (w * hindrance.sum() * (wave[1] - wave[0])))


def bore_flux_W_m2(
    setup: DiskSetup, power_W: float, h_W_m2K: float, inner_K: float, air_K: float = 0.0
) -> float:
    """Mean flux out of the disk through its bore [W/m2].

    From T'' + T'/r - kappa^2 T = 0 with ``power_W`` entering the running surface, whose film is ``h_W_m2K``, and
    ``inner_K`` above the ambient at the depth of b; ``air_K``: of what the film loses to, above the ambient.
    """
    k = setup.conductivity_W_mK
    outer = setup.outer_radius_m
    bore = setup.bore_radius_m
    kappa = washer_kappa(setup)
    inner = outer - setup.edge_m

    def waves(r: float) -> Array:
        return np.array([special.i0(kappa * r), special.k0(kappa * r)])

    def slopes(r: float) -> Array:
        return kappa * np.array([special.i1(kappa * r), -special.k1(kappa * r)])

    flux = power_W / (2 * np.pi * outer * setup.width_m)
    of = np.linalg.solve(
        [waves(inner), k * slopes(outer) + h_W_m2K * waves(outer)],
        [inner_K, flux + h_W_m2K * air_K],
    )
    return float(k * slopes(bore) @ of)


def bore_flux_with_u(
    disk: DiskTraces,
    power: tuple[float, float],
    h: tuple[float, float],
    inner_K: float,
    air_K: float = 0.0,
) -> tuple[float, float]:
    """Mean flux through the bore [W/m2] and its standard uncertainty, by those of power, film, washers, steel and
    ambient: what the disk takes less most of itself, which is poorly known."""
    s = disk.setup
    u = disk.uncertainty
    washer = replace(s, washer_conductivity_W_mK=s.washer_conductivity_W_mK * (1 + u.washer_rel))
    steel = replace(s, conductivity_W_mK=s.conductivity_W_mK * (1 + u.conductivity_rel))
    at = bore_flux_W_m2(s, power[0], h[0], inner_K, air_K)
    moved = [
        bore_flux_W_m2(washer, power[0], h[0], inner_K, air_K),
        bore_flux_W_m2(steel, power[0], h[0], inner_K, air_K),
        bore_flux_W_m2(s, power[0] + power[1], h[0], inner_K, air_K),
        bore_flux_W_m2(s, power[0], h[0] + h[1], inner_K, air_K),
        bore_flux_W_m2(s, power[0], h[0], inner_K + u.ambient_K, air_K),
        bore_flux_W_m2(s, power[0], h[0], inner_K, air_K + s.surface.air_u_K),
    ]
    return at, float(np.linalg.norm(np.array(moved) - at))


def predict_harmonics(setup: DiskSetup, h_W_m2K: float) -> PressFitHarmonics:
    """Harmonics of a disk with its stated fit for a mean flux of 1 kW/m2 out of the disk through its bore."""
    c = press_fit(setup)[1] * harmonics(
        setup.fit.sectors(1e3 * setup.bore_radius_m), 2 * N_HARMONICS
    )
    disk = [disk_admittance(setup, h_W_m2K, n) for n in range(1, N_HARMONICS + 1)]
    hindered = np.array(
        [1 / y + 1 / shaft_admittance(setup, n) for n, (y, _) in enumerate(disk, start=1)]
    )
    orders = np.array([n for n in range(-N_HARMONICS, N_HARMONICS + 1) if n])
    z = hindered[np.abs(orders) - 1]

    def at(n: NDArray[np.int64]) -> NDArray[np.complex128]:
        return np.where(n < 0, c[np.abs(n)].conj(), c[np.abs(n)])

    apart = np.linalg.solve(
        np.diag(1 / z) + at(orders[:, None] - orders), -at(orders)
    )  # D_n over D_0
    mean = float((c[0] + at(-orders) @ apart).real)
    waves = {
        n: complex(apart[orders == n][0] / (z[orders == n][0] * disk[n - 1][0] * disk[n - 1][1]))
        for n in (1, 2)
    }
    first, second = (2e3 / mean * waves[n] for n in (1, 2))
    y, bore = disk[0]
    per_share = 1e3 / (y * (1 + c[0].real * hindered[0]) * bore)
    return PressFitHarmonics(
        np.array([first.real, -first.imag]), np.array([second.real, -second.imag]), float(per_share)
    )


def press_fit_priors(
    test: EhlTest, estimates: Mapping[str, Estimate], uneven: Mapping[str, Unevenness]
) -> tuple[dict[str, Unevenness], list[Finding]]:
    """What is to be expected of each disk with a stated fit, by ``estimates`` and what was found ``uneven`` by the fit
    of both disks that did not know it.

    A disk in which that fit found another harmonic, beyond three standard uncertainties, is left as without a
    statement, and a finding says so. ``test``: without the harmonics that were found.
    """
    stated: dict[str, Unevenness] = {}
    findings = []
    near = (test.time_s > test.events.unload_s - WINDOW_S) & (
        test.time_s < test.events.unload_s - 1.0
    )
    beta = estimates["beta"]
    shares = {"fast": beta.value, "slow": 1 - beta.value}
    for d in DISKS:
        disk = test.disks[d]
        found = uneven[d]
        if not disk.setup.fit.stated:
            continue
        inner = (
            disk.readings_degC[near][:, disk.setup.places(disk.setup.inner)]
            - test.ambient_of(d)[near, None]
        )
        whole = float(np.mean(test.power_W[near]))
        film = estimates[f"h_{d}"]
        u = whole * float(np.hypot(beta.u, shares[d] * disk.uncertainty.friction_rel))
        air = (
            float(test.surface_air_offset_K[d][near, 0].mean())
            if d in test.surface_air_offset_K
            else 0.0
        )
        flux, flux_u = bore_flux_with_u(
            disk, (shares[d] * whole, u), (film.value, film.u), float(np.nanmean(inner)), air
        )
        least = max(flux, MIN_FLUX_U * flux_u)  # heat leaves through the bore
        told = predict_harmonics(disk.setup, film.value).scaled(1e-3 * least)
        known = disk.setup.fit.uneven_rel, flux_u / least, found
        if (z := told.distance_z(*known)) < SIGNIFICANT_Z:
            stated[d] = told.prior(*known)
            continue
        seen_K, seen_deg = _polar(found.level_K)
        told_K, told_deg = _polar(told.first_K)
        findings.append(
            warning(
                "fit.contradicted",
                subject=d,
                seen_K=seen_K,
                seen_deg=seen_deg,
                told_K=told_K,
                told_deg=told_deg,
                z=z,
            )
        )
    return stated, findings


def _polar(level_K: Array) -> tuple[float, float]:
    return float(np.hypot(*level_K)), float(np.rad2deg(np.arctan2(level_K[1], level_K[0])) % 360.0)
