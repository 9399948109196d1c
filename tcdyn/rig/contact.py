"""Two crowned disks in contact: Hertz's ellipse, when they touch, the force between them and their speeds; and the
press fit that holds each on its shaft."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding
from tcdyn.estimation.trace_noise import (
    SPIKES,
    find_spikes,
    local_polynomial,
    middle,
    white_noise_sd,
)
from tcdyn.rig.disk import DiskSetup

YOUNG_Pa = 207e9
POISSON = 0.3
SMOOTH_S = 4.0  # straight line of this length; longer where the noise asks for it, up to
LONGEST_SMOOTH_S = 40.0
NOISE_LEFT = 0.002  # of the force at the parting: a fifth of the transducer's own uncertainty
SETTLE_S = 0.1  # samples this near to a switching instant may belong to either side
STRAIGHT_FALL = 0.8  # the 90-10 % time of a straight fall over the whole of it
LEAST_ZERO = 10  # samples of an unloaded stretch that give a zero
SPEED_WINDOW_S = 1.0
STOPPED = 0.02  # of the speed before: what comes back from below it had not stopped
LEAST_CHANGE = 0.02  # of a speed
CHANGE_WITHIN_S = 20.0


@dataclass(frozen=True)
class Events:
    """Loading and unloading of one EHL test.

    ``load_on_s`` and ``unload_s`` are in the log's own time [s]; ``unload_u_s`` is the standard uncertainty of the
    instant at which the frictional heat ended; ``parting_s`` is how long the friction took to fall from 90 to 10 %;
    ``kinks_s``: where the temperatures bend [s]: at the parting's middle, or both ends of a slow one, and at the ends
    of ``again``, (start, stop) of each time that the disks touched after it.
    """

    load_on_s: float
    unload_s: float
    unload_u_s: float
    parting_s: float
    kinks_s: tuple[float, ...]
    findings: tuple[Finding, ...] = ()
    again: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class FrictionAdded:
    """What the transducer does not see of the contact's friction, its standard uncertainty, and what to say of it."""

    value_N: float
    u_N: float
    findings: tuple[Finding, ...] = ()


NOTHING_ADDED = FrictionAdded(0.0, 0.0)


@dataclass(frozen=True)
class HertzContact:
    """Semi-axes of the contact ellipse [m] and its greatest pressure [Pa].

    ``minor_m`` (a) lies along rolling, ``major_m`` (b) across the running track: the half width of the heat flux.
    """

    minor_m: float
    major_m: float
    pressure_Pa: float

    @property
    def yield_depth_m(self) -> float:
        """Depth of the greatest shear stress, z = a (0.7929 - 0.3207 a/b) [m] (5.1)."""
        return self.minor_m * (0.7929 - 0.3207 * self.minor_m / self.major_m)


def hertz_contact(
    load_N: float,
    radius_m: float = 0.0381,
    crown_radius_m: float = 0.3048,
    young_Pa: float = YOUNG_Pa,
    poisson: float = POISSON,
) -> HertzContact:
    """Contact of two equal crowned disks under ``load_N``.

    With E* = E / (2 (1 - nu^2)), relative curvatures 1/R + 1/R (rolling) and 1/R_c + 1/R_c (axial),
    e^2 = 1 - (a/b)^2 and complete elliptic integrals K, E of e::

        R_c / R = ((b/a)^2 E - K) / (K - E)
        1 / R_c = (p0 / E*) (a / (b^2 e^2)) (K - E),   p0 = 3 W / (2 pi a b)

    Valid for crown radius > rolling radius, elastic contact. Raises InputError for a load that is not positive.
    Source: Johnson, Contact Mechanics (1985), eqs. 4.26; table 6.1 gives the pressures, table 3.4 the half widths.

    >>> c = hertz_contact(2320.0)
    >>> round(c.minor_m * 1e3, 2), round(c.major_m * 1e3, 2), round(c.pressure_Pa / 1e9, 1)
    (0.45, 1.76, 1.4)
    """
    if not load_N > 0:
        raise InputError(f"hertz_contact: load_N must be positive; got {load_N} N")
    if not crown_radius_m > radius_m > 0:
        raise InputError("hertz_contact: needs crown_radius_m > radius_m > 0")
    ratio = _axis_ratio(crown_radius_m / radius_m)
    m = 1.0 - ratio**-2
    modulus = young_Pa / (2.0 * (1.0 - poisson**2))
    # p0 put into the second equation: b^3 = 3 W R_c (K - E) / (2 pi E* e^2)
    major = (1.5 * load_N * crown_radius_m * (ellipk(m) - ellipe(m)) / (np.pi * modulus * m)) ** (
        1 / 3
    )
    minor = major / ratio
    return HertzContact(float(minor), float(major), float(1.5 * load_N / (np.pi * minor * major)))


def equal_radius_m(one_m: float, other_m: float) -> float:
    """Radius of two equal disks whose relative curvature is that of two unequal ones, 2 / (1/R1 + 1/R2) [m].

    >>> round(equal_radius_m(0.03, 0.06), 3)
    0.04
    """
    return 2.0 / (1.0 / one_m + 1.0 / other_m)


def half_width_m(load_N: float, radius_m: float = 0.0381, crown_radius_m: float = 0.3048) -> float:
    """Half width b of the running track [m], the major semi-axis of the contact.

    >>> [round(half_width_m(load) * 1e3, 2) for load in (850, 1460, 1850, 2320)]  # table 3.4: 1.25 1.50 1.62 1.75
    [1.26, 1.5, 1.63, 1.76]
    """
    return hertz_contact(load_N, radius_m, crown_radius_m).major_m


def _axis_ratio(curvature_ratio: float) -> float:
    """b/a for a ratio of relative curvatures above one."""

    def excess(log_ratio: float) -> float:
        squared = np.exp(2 * log_ratio)
        m = 1 - 1 / squared
        return float((squared * ellipe(m) - ellipk(m)) / (ellipk(m) - ellipe(m)) - curvature_ratio)

    return float(
        np.exp(
            brentq(excess, 0.3 * np.log(curvature_ratio), np.log(curvature_ratio) + 1.0, xtol=1e-13)
        )
    )


def surface_speed_m_s(speed_rpm: float, radius_m: float = 0.0381) -> float:
    """Speed of the running surface, u = 2 pi n R / 60 [m/s]."""
    return 2.0 * np.pi * speed_rpm / 60.0 * radius_m


def contact_force(t: Array, raw_N: Array, events: Events) -> Array:
    """Force while the disks touch [N], zero elsewhere; ``raw_N`` as logged, both of shape (N,).

    When they touch again it is the logged force, the mean of each two samples between which it is held. The zero is
    the median before loading and after unloading, drifting straight between the two (section 2.9). Under load the force
    is a running straight line, spikes left out, that never looks across a switching instant: an average smeared over
    the parting edge would scale beta one to one, and so does noise left at that edge. The line is as long as
    ``NOISE_LEFT`` asks, since its end scatters by 2 sd / sqrt(samples).
    """
    on = events.load_on_s
    off = events.unload_s
    quiet = events.parting_s + SETTLE_S
    touched = np.any(
        [(t >= a - SETTLE_S) & (t <= b + SETTLE_S) for a, b in events.again] or [t < t[0]], axis=0
    )
    zero = _zero(t, np.where(touched, np.nan, raw_N), on - SETTLE_S, off + quiet)
    inside = (t > on + SETTLE_S) & (t < off - quiet)
    level = _line_through((raw_N - zero)[inside], dt_s := float(middle(np.diff(t))))
    force = np.interp(t, t[inside], level)
    ramp_s = events.parting_s / STRAIGHT_FALL
    if ramp_s > 4 * dt_s:
        share = np.clip((off + 0.5 * ramp_s - t) / ramp_s, 0.0, 1.0)
    else:
        share = (t < off).astype(float)
    logged = (
        pd.Series(raw_N - zero)
        .interpolate(limit_direction="both")
        .rolling(2)
        .mean()
        .shift(-1)
        .to_numpy()
    )
    touching = np.any([(t >= a) & (t < b) for a, b in events.again] or [t < t[0]], axis=0)
    return np.where(touching, logged, np.where(t >= on, force * share, 0.0))


def _line_through(raw: Array, dt_s: float) -> Array:
    """The slow course of a force (N,) with noise, spikes and missing samples, straight to its very ends."""
    rule = replace(SPIKES["force"], width=max(int(round(0.5 * SMOOTH_S / dt_s)), 3))
    filled = (
        pd.Series(raw).mask(find_spikes(raw, rule)).interpolate(limit_direction="both").to_numpy()
    )
    window = line_length(float(white_noise_sd(filled)), float(middle(filled)), dt_s, len(filled))
    return local_polynomial(filled, window, min(1, window - 1))


def line_length(noise_N: float, level_N: float, dt_s: float, most: int) -> int:
    """Samples, an odd number, of the running straight line through a force of ``level_N`` with noise, of ``most``."""
    left = 2 * noise_N / max(NOISE_LEFT * abs(level_N), 1e-12)
    count = min(max(SMOOTH_S / dt_s, left**2), LONGEST_SMOOTH_S / dt_s, most)
    return max(2 * int((count - 1) // 2) + 1, 1)


def _zero(t: Array, raw: Array, before_s: float, after_s: float) -> Array:
    """The transducer's zero at each instant, from the unloaded stretches."""
    seen = np.isfinite(raw)
    early = seen & (t < before_s)
    late = seen & (t > after_s) & (t < after_s + 60.0)
    points = [
        (float(np.mean(t[m])), float(np.nanmedian(raw[m])))
        for m in (early, late)
        if m.sum() >= LEAST_ZERO
    ]
    if not points:
        return np.zeros_like(t)
    return np.asarray(np.interp(t, [p[0] for p in points], [p[1] for p in points]))


def speed_course(time_s: Array, speed_rpm: Array, from_s: float, level_rpm: float) -> Array | None:
    """A logged speed after ``from_s`` as a share of ``level_rpm``, one before; arrays (N,).

    Noise, spikes and dropouts taken out; all one where it changes by less than two per cent in the first 20 s; None
    where most of them are missing.

    >>> t = np.arange(0.0, 60.0, 1 / 75)
    >>> slowing = 3000.0 * np.exp(-np.clip(t - 30.0, 0, None) / 3.0)
    >>> slowing[2500] = 0.0  # a dropout
    >>> speed_course(t, slowing, 30.0, 3000.0)[[2000, 2475]].round(3)  # 3 s later: to 1/e
    array([1.   , 0.368])
    """
    out = np.ones_like(time_s)
    after = np.flatnonzero(time_s >= from_s)
    x = pd.Series(speed_rpm[after] / level_rpm)
    comes_back = x[::-1].fillna(0.0).cummax()[::-1] > 5 * STOPPED
    x = x.mask((x < STOPPED) & comes_back)
    near = time_s[after] < from_s + CHANGE_WITHIN_S
    if len(after) < 5 or x[near].notna().mean() < 0.5:
        return None
    calm = (
        x.interpolate(limit_direction="both")
        .rolling(5, center=True, min_periods=1)
        .median()
        .to_numpy()
    )
    dt_s = float(np.median(np.diff(time_s)))
    window = min(2 * int(0.5 * SPEED_WINDOW_S / dt_s) + 1, 2 * ((len(calm) - 1) // 2) + 1)
    smooth = local_polynomial(calm, window, 2) if window > 3 else calm
    if np.abs(smooth[near] - 1).max() >= LEAST_CHANGE:
        out[after] = np.clip(smooth, 0.0, None)
    return out


def sliding_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Sliding speed u_s = u_fast - u_slow [m/s] (table 6.1).

    >>> round(sliding_speed_m_s(6555, 1546), 1)
    20.0
    """
    return surface_speed_m_s(fast_rpm, radius_m) - surface_speed_m_s(slow_rpm, radius_m)


def entraining_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Entraining (mean) speed u_m = (u_fast + u_slow) / 2 [m/s] (table 6.1).

    >>> round(entraining_speed_m_s(3282, 774), 2)
    8.09
    """
    return 0.5 * (surface_speed_m_s(fast_rpm, radius_m) + surface_speed_m_s(slow_rpm, radius_m))


def interference_pressure_Pa(
    radial_interference_m: float,
    fit_radius_m: float = 0.0205,
    outer_radius_m: float = 0.0381,
    inner_radius_m: float = 0.0,
    young_Pa: float = YOUNG_Pa,
) -> float:
    """Pressure of a press fit of equal materials [Pa] (6.1).

    ``P = (E delta / R) (r_o^2 - R^2) (R^2 - r_i^2) / (2 R^2 (r_o^2 - r_i^2))``

    >>> [round(interference_pressure_Pa(d / 2) / 1e6, 1) for d in (15.2e-6, 25.4e-6)]  # section 6.4.3: 27.3, 45.6
    [27.3, 45.6]
    """
    square = fit_radius_m**2
    outer = outer_radius_m**2
    inner = inner_radius_m**2
    shape = (outer - square) * (square - inner) / (2 * square * (outer - inner))
    return young_Pa * radial_interference_m / fit_radius_m * shape


def contact_conductance_W_m2K(
    pressure_Pa: float,
    hardness_Pa: float,
    roughness_m: float,
    slope: float,
    conductivity_W_mK: float,
) -> float:
    """Conductance of a pressed joint, h = 0.170 (P/H)^0.693 m k / sigma [W/m2K] (6.2).

    ``hardness_Pa`` is the micro-hardness H, ``roughness_m`` the standard deviation sigma of the roughness,
    ``slope`` the asperity slope m [-]. Source: Leung et al. (1998) as quoted by the thesis; measured in vacuum.

    >>> low, high = (contact_conductance_W_m2K(p, 2.7e9, 1e-6, 0.1, 16) for p in (1e6, 45.6e6))
    >>> round(high / low, 1)  # table 6.6: about 14
    14.1
    """
    return 0.170 * (pressure_Pa / hardness_Pa) ** 0.693 * slope * conductivity_W_mK / roughness_m


def press_fit(setup: DiskSetup) -> tuple[float, float]:
    """Pressure [Pa] of the stated press fit of a disk (6.1), and its conductance where it bears [W/m2K] (6.2).

    Raises InputError where the rig states none, or the disk has no bore.
    """
    fit = setup.fit
    bore_m = setup.bore_radius_m
    if not (fit.stated and bore_m > 0):
        raise InputError(
            f"rig.toml states no press fit of the {setup.name} disk",
            expected="[fit] with an interference_um above zero, and a bore",
            remedy="`tcdyn rig --show` lists every key with its default",
        )
    pressure = interference_pressure_Pa(0.5e-6 * fit.interference_um, bore_m, setup.outer_radius_m)
    surfaces = 1e9 * fit.hardness_GPa, 1e-6 * fit.roughness_um, fit.slope, fit.conductivity_W_mK
    return pressure, contact_conductance_W_m2K(pressure, *surfaces)
