"""Prior of a disk's circumferential harmonics from a press fit that rig.toml states.

The mean heat through the bore is that of the rim's own balance; round it q_n = sum of H_(n-m) D_m,
with H_n the Fourier coefficients of the stated conductance and D_n = T_disk - T_shaft at the bore.
A wave of flux q_n that enters the shaft warms it by q_n / Y_shaft and cools the disk by q_n /
Y_disk, so D_n = -q_n (1/Y_disk + 1/Y_shaft) for n other than zero, Y_disk of the rim's Bessel
functions, Y_shaft of a long solid cylinder heated over the disk's width.

Used by :mod:`tcdyn.partition.analyse`. The uncertainties of the model are by comparison with
whole-disk runs. Guarded by ``tests/partition/test_stated_fit.py``.
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
    AngularHarmonic,
    harmonic_prior_K,
    radial_shape,
    washer_kappa,
)
from tcdyn.partition.events import DiskTraces, EhlTest
from tcdyn.rig.contact import press_fit_conductance
from tcdyn.rig.disk import DiskSetup
from tcdyn.rig.press_fit import harmonics

N_HARMONICS = 8  # that couple; more change the first two by less than a hundredth
STEP_M = 1e-5  # step of the difference quotient by radius at the bore [m]
# Standard uncertainty of a predicted harmonic, relative to it: a bored shaft, short runs, a rim
# taken as thin. Whole-disk runs differ by up to 0.28.
MODEL_REL = 0.3
# Least flux through the bore in its standard uncertainties: below, only its direction is known.
MIN_FLUX_U = 0.5
# Standard uncertainty across the harmonic, relative to it, of the model; whole-disk runs differ by
# up to 5 degrees.
ANGLE_REL = 0.1
FLUX_SCALES = np.linspace(0.0, 8.0, 161)  # trial scales of the heat through the bore
# Chosen by judgement.
WINDOW_S = 20.0  # length of the means before the unloading [s]
WINDOW_GAP_S = 1.0  # their end before the unloading [s]


@dataclass(frozen=True)
class PressFitHarmonics:
    """Harmonics at the depth of b that a press fit makes.

    Parameters
    ----------
    first_K, second_K
        First and second harmonic, cos and sin, (2,) [K].
    per_share_K
        Size of the first per unit of a small first harmonic of the conductance, relative to its
        mean [K].
    """

    first_K: Array
    second_K: Array
    per_share_K: float

    def scaled(self, flux_kW_m2: float) -> PressFitHarmonics:
        """The harmonics of another flux; all are proportional to it.

        Parameters
        ----------
        flux_kW_m2
            Mean flux through the bore, if the present harmonics are those of 1 kW/m2.
        """
        return PressFitHarmonics(
            flux_kW_m2 * self.first_K, flux_kW_m2 * self.second_K, flux_kW_m2 * self.per_share_K
        )

    def distance_z(self, uneven_rel: float, flux_rel: float, estimated: AngularHarmonic) -> float:
        """Least distance of an estimated harmonic from the prediction, in standard uncertainties.

        The least over all scales of the heat through the bore, which goes outward.

        Parameters
        ----------
        uneven_rel
            Standard uncertainty of the stated conductance's first harmonic, relative to its mean.
        flux_rel
            Relative standard uncertainty of the heat through the bore.
        estimated
            The harmonic by a fit that did not use the press fit.

        Notes
        -----
        ``FLUX_SCALES`` must go well beyond 1; a finer grid changes the result little.
        ``tests/partition/test_stated_fit.py`` (study) fails if a press fit stated at a wrong angle
        is accepted.
        """
        size = float(np.hypot(*self.first_K))
        scale_u = float(np.hypot(flux_rel, MODEL_REL))
        least = np.inf
        for scale in FLUX_SCALES:
            conductance_u_K = uneven_rel * self.per_share_K * max(scale, 1.0)
            other_u_K = np.hypot(conductance_u_K, ANGLE_REL * scale * size)
            deviation = estimated.level_K - scale * self.first_K
            covariance = estimated.level_covariance_K2 + other_u_K**2 * np.eye(2)
            z2 = float(deviation @ np.linalg.solve(covariance, deviation))
            least = min(least, z2 + ((scale - 1) / scale_u) ** 2)
        return float(np.sqrt(least))

    def prior(
        self, uneven_rel: float, flux_rel: float, estimated: AngularHarmonic
    ) -> AngularHarmonic:
        """The prior of the harmonics of such a disk.

        Parameters
        ----------
        uneven_rel, flux_rel, estimated
            As of :meth:`distance_z`.

        Notes
        -----
        The first harmonic by a fit without the press fit determines how much heat goes through the
        bore, and so how large the second harmonic is, which no fit determines. The estimated first
        harmonic is used for that scale and for errors of the angles, not as the prior's mean: the
        joint fit that follows determines it again from the same data.
        """
        size = float(np.hypot(*self.first_K))
        scale_u = float(np.hypot(flux_rel, MODEL_REL))
        direction = self.first_K / max(size, 1e-9)
        conductance_u_K = uneven_rel * self.per_share_K
        level = float(estimated.level_K @ direction)
        level_variance = direction @ estimated.level_covariance_K2 @ direction + conductance_u_K**2
        level_u = float(np.sqrt(level_variance))
        prior_variance = (scale_u * size) ** 2
        gain = prior_variance / (prior_variance + level_u**2)
        scale = max(1 + gain * (level / size - 1), 0.0) if size > 0 else 1.0
        second_rel = float(np.hypot(scale_u * np.sqrt(1 - gain), MODEL_REL))
        second_K = scale * self.second_K
        second_u_K = np.hypot(second_rel * np.hypot(*second_K), SECOND_HARMONIC_REL * scale * size)
        prior = harmonic_prior_K(size)
        prior[0] = np.hypot(conductance_u_K, scale_u * size)
        return AngularHarmonic(
            prior,
            h_W_m2K=estimated.h_W_m2K,
            steady_window_s=estimated.steady_window_s,
            angle_level_K=estimated.level_K,
            nominal_K=self.first_K,
            second_harmonic_u_K=float(second_u_K),
            nominal_second_K=second_K,
        )


def disk_admittance(setup: DiskSetup, h_W_m2K: float, n: int) -> tuple[float, float]:
    """Y = -K T_n'/T_n at the bore [W/m2K], and T_n there over T_n at the depth of b.

    Parameters
    ----------
    setup
        The disk.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    n
        Number of the harmonic.

    Returns
    -------
    admittance, at_bore
        Flux into the disk per kelvin at the bore, by a difference quotient of ``STEP_M``, and the
        shape.
    """
    wall = setup.outer_radius_m - setup.bore_radius_m
    outside, at_bore = radial_shape(setup, h_W_m2K, np.array([wall - STEP_M, wall]), n)
    slope = (outside - at_bore) / STEP_M
    return float(-setup.conductivity_W_mK * slope / at_bore), float(at_bore)


def shaft_admittance(setup: DiskSetup, n: int) -> float:
    """Uniform flux over a disk's width w over the mean of T_n there, long solid shaft [W/m2K].

    Parameters
    ----------
    setup
        The disk.
    n
        Number of the harmonic.

    Notes
    -----
    1/Y = (w/pi) integral of sinc^2(l w/2) / (K l I_n'(l R)/I_n(l R)) dl, by the midpoint rule up to
    l = 80/w. ``tests/partition/test_stated_fit.py`` compares a wide disk with the endless shaft, K
    n/R.
    """
    k = setup.conductivity_W_mK
    radius = setup.bore_radius_m
    w = setup.width_m
    wave = np.linspace(0.0, 80.0 / w, 8001)[1:] - 40.0 / w / 8000
    bessel = special.ive(n, wave * radius)
    slope = 0.5 * (special.ive(n - 1, wave * radius) + special.ive(n + 1, wave * radius))
    integrand = np.sinc(0.5 * wave * w / np.pi) ** 2 * bessel / (k * wave * slope)
    return float(np.pi / (w * integrand.sum() * (wave[1] - wave[0])))


def bore_flux_W_m2(
    setup: DiskSetup, power_W: float, h_W_m2K: float, inner_K: float, air_K: float = 0.0
) -> float:
    """Mean flux out of the disk through its bore [W/m2], from T'' + T'/r - kappa^2 T = 0.

    Parameters
    ----------
    setup
        The disk.
    power_W
        Heat that enters the running surface.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    inner_K
        Temperature at the depth of b above the ambient.
    air_K
        Temperature of the air at the running surface above the ambient.
    """
    k = setup.conductivity_W_mK
    outer = setup.outer_radius_m
    kappa = washer_kappa(setup)
    inner = outer - setup.edge_m

    def values(r: float) -> Array:
        """I_0 and K_0 of kappa r, (2,)."""
        return np.array([special.i0(kappa * r), special.k0(kappa * r)])

    def slopes(r: float) -> Array:
        """Their derivatives by r, (2,) [1/m]."""
        return kappa * np.array([special.i1(kappa * r), -special.k1(kappa * r)])

    flux = power_W / (2 * np.pi * outer * setup.width_m)
    coefficients = np.linalg.solve(
        [values(inner), k * slopes(outer) + h_W_m2K * values(outer)],
        [inner_K, flux + h_W_m2K * air_K],
    )
    return float(k * slopes(setup.bore_radius_m) @ coefficients)


def bore_flux_with_u(
    disk: DiskTraces,
    power: tuple[float, float],
    h: tuple[float, float],
    inner_K: float,
    air_K: float = 0.0,
) -> tuple[float, float]:
    """Mean flux through the bore [W/m2] and its standard uncertainty.

    The uncertainty is that of power, h, washers, steel, ambient and surface air. The flux is the
    heat that the disk takes less most of itself, so it is poorly known.

    Parameters
    ----------
    disk
        The traces of the disk.
    power, h
        Heat that enters the disk [W] and heat transfer coefficient [W/m2K], each with its standard
        uncertainty.
    inner_K, air_K
        As of :func:`bore_flux_W_m2`.

    Returns
    -------
    flux, u
        Both in W/m2, positive outward.
    """
    s = disk.setup
    u = disk.uncertainty
    power_W, power_u_W = power
    h_W_m2K, h_u_W_m2K = h
    washer = replace(s, washer_conductivity_W_mK=s.washer_conductivity_W_mK * (1 + u.washer_rel))
    steel = replace(s, conductivity_W_mK=s.conductivity_W_mK * (1 + u.conductivity_rel))
    flux = bore_flux_W_m2(s, power_W, h_W_m2K, inner_K, air_K)
    perturbed = [
        bore_flux_W_m2(washer, power_W, h_W_m2K, inner_K, air_K),
        bore_flux_W_m2(steel, power_W, h_W_m2K, inner_K, air_K),
        bore_flux_W_m2(s, power_W + power_u_W, h_W_m2K, inner_K, air_K),
        bore_flux_W_m2(s, power_W, h_W_m2K + h_u_W_m2K, inner_K, air_K),
        bore_flux_W_m2(s, power_W, h_W_m2K, inner_K + u.ambient_K, air_K),
        bore_flux_W_m2(s, power_W, h_W_m2K, inner_K, air_K + s.surface.air_u_K),
    ]
    return flux, float(np.linalg.norm(np.array(perturbed) - flux))


def predict_harmonics(setup: DiskSetup, h_W_m2K: float) -> PressFitHarmonics:
    """Harmonics by the stated press fit for a mean flux of 1 kW/m2 out through the bore.

    Parameters
    ----------
    setup
        The disk, with its press fit.
    h_W_m2K
        Heat transfer coefficient of the running surface.

    Notes
    -----
    ``N_HARMONICS`` may grow. ``tests/partition/test_stated_fit.py`` compares sizes and angle with a
    simulated whole disk, within ``MODEL_REL`` and 5 degrees.
    """
    sectors = setup.press_fit.sectors(1e3 * setup.bore_radius_m)
    conductance = press_fit_conductance(setup)[1] * harmonics(sectors, 2 * N_HARMONICS)
    admittances = [disk_admittance(setup, h_W_m2K, n) for n in range(1, N_HARMONICS + 1)]
    resistances = np.array(
        [1 / y + 1 / shaft_admittance(setup, n) for n, (y, _) in enumerate(admittances, start=1)]
    )
    orders = np.array([n for n in range(-N_HARMONICS, N_HARMONICS + 1) if n])
    z = resistances[np.abs(orders) - 1]

    def coefficient(n: NDArray[np.int64]) -> NDArray[np.complex128]:
        """Fourier coefficients of the conductance for orders of both signs."""
        c = conductance[np.abs(n)]
        return np.where(n < 0, c.conj(), c)

    coupling = coefficient(orders[:, None] - orders)
    # D_n over D_0
    differences = np.linalg.solve(np.diag(1 / z) + coupling, -coefficient(orders))
    mean_flux = float((conductance[0] + coefficient(-orders) @ differences).real)

    def wave(n: int) -> complex:
        """Harmonic ``n`` at the depth of b for a mean flux of 1 kW/m2."""
        at = orders == n
        y, at_bore = admittances[n - 1]
        amplitude = complex(differences[at][0] / (z[at][0] * y * at_bore))
        return 2e3 / mean_flux * amplitude

    first = wave(1)
    second = wave(2)
    y, at_bore = admittances[0]
    per_share = 1e3 / (y * (1 + conductance[0].real * resistances[0]) * at_bore)
    return PressFitHarmonics(
        np.array([first.real, -first.imag]), np.array([second.real, -second.imag]), float(per_share)
    )


def press_fit_priors(
    test: EhlTest, estimates: Mapping[str, Estimate], estimated: Mapping[str, AngularHarmonic]
) -> tuple[dict[str, AngularHarmonic], list[Finding]]:
    """Prior of the harmonics of each disk with a stated press fit.

    Parameters
    ----------
    test
        The test without the estimated harmonics.
    estimates, estimated
        Estimates and harmonics by the combined fit that did not use the press fit.

    Returns
    -------
    priors, findings
        A disk in which that fit shows another harmonic, beyond three standard uncertainties, has no
        prior but a finding.

    Notes
    -----
    A flux that is small or inward is replaced by ``MIN_FLUX_U`` of its standard uncertainty.
    ``tests/partition/test_stated_fit.py`` tests this limit and the finding.
    """
    priors: dict[str, AngularHarmonic] = {}
    findings = []
    beta = estimates["beta"]
    shares = {"fast": beta.value, "slow": 1 - beta.value}
    for d, disk in test.disks.items():
        if not disk.setup.press_fit.is_specified:
            continue
        h = estimates[f"h_{d}"]
        flux, flux_u = _bore_flux_of_test(test, disk, shares[d], beta.u, h)
        outward_flux = max(flux, MIN_FLUX_U * flux_u)  # heat leaves through the bore
        predicted = predict_harmonics(disk.setup, h.value).scaled(1e-3 * outward_flux)
        evidence = disk.setup.press_fit.uneven_rel, flux_u / outward_flux, estimated[d]
        z = predicted.distance_z(*evidence)
        if z < SIGNIFICANT_Z:
            priors[d] = predicted.prior(*evidence)
            continue
        estimated_K, estimated_deg = _amplitude_and_angle(estimated[d].level_K)
        predicted_K, predicted_deg = _amplitude_and_angle(predicted.first_K)
        findings.append(
            warning(
                "fit.contradicted",
                subject=d,
                seen_K=estimated_K,
                seen_deg=estimated_deg,
                told_K=predicted_K,
                told_deg=predicted_deg,
                z=z,
            )
        )
    return priors, findings


def _bore_flux_of_test(
    test: EhlTest, disk: DiskTraces, share: float, share_u: float, h: Estimate
) -> tuple[float, float]:
    """Mean flux through the bore before the unloading and its standard uncertainty [W/m2].

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    share, share_u
        Share of the disk and its standard uncertainty.
    h
        Heat transfer coefficient [W/m2K].

    Returns
    -------
    flux, u
        Positive outward.
    """
    unload_s = test.events.unload_s
    last = (test.time_s > unload_s - WINDOW_S) & (test.time_s < unload_s - WINDOW_GAP_S)
    readings = disk.readings_degC[last][:, disk.setup.channel_indices(disk.setup.inner)]
    inner_K = float(np.nanmean(readings - test.ambient_of(disk.name)[last, None]))
    power_W = float(np.mean(test.power_W[last]))
    power_u_W = power_W * float(np.hypot(share_u, share * disk.uncertainty.friction_rel))
    air_K = 0.0
    if disk.name in test.surface_air_offset_K:
        air_K = float(test.surface_air_offset_K[disk.name][last, 0].mean())
    return bore_flux_with_u(disk, (share * power_W, power_u_W), (h.value, h.u), inner_K, air_K)


def _amplitude_and_angle(level_K: Array) -> tuple[float, float]:
    """Amplitude [K] and angle [deg] of a level, cos and sin."""
    angle_deg = float(np.rad2deg(np.arctan2(level_K[1], level_K[0])) % 360.0)
    return float(np.hypot(*level_K)), angle_deg
