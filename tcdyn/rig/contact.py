"""Contact of two crowned disks (Hertz), contact force and speeds of a test, and the press fit.

The contact force is smoothed by running straight lines; speeds by local polynomials.

The mechanics (Hertz, press fit) is used by the workflows, the simulator and ``tcdyn verify``; the
force and the speeds by :mod:`tcdyn.partition.events` and the workflows. Sources: Johnson, Contact
Mechanics (1985); sections 2.9, 5.6 and 6.4.3 of the thesis. Tests:
``tests/simulate/test_contact.py``, ``tests/partition/test_events.py`` and
``tests/partition/test_slowing.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.signal import savgol_filter
from scipy.special import ellipe, ellipk

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding
from tcdyn.estimation.trace_noise import (
    SPIKES,
    fast_nanmedian,
    find_spikes,
    white_noise_sd,
)
from tcdyn.rig.disk import DiskSetup

YOUNG_Pa = 207e9
POISSON = 0.3
# Length of the running straight line through the force [s], and the largest length that noise may
# require. Chosen by judgement.
SMOOTH_S = 4.0
MAX_SMOOTH_S = 40.0
# Noise of the smoothed force at the unloading, as a share of the force: a fifth of the uncertainty
# of the transducer.
FORCE_NOISE = 0.002
# Samples this near to a switching instant [s] may belong to either side. Chosen by judgement.
SWITCHING_MARGIN_S = 0.1
# Time of a linear fall from 90 to 10 %, as a share of the complete fall.
LINEAR_FALL_SHARE = 0.8
# Samples of an unloaded segment that determine a zero. Chosen by judgement.
MIN_ZERO_SAMPLES = 10
# Unloaded time after the unloading that is used for the zero [s]. Chosen by judgement.
ZERO_WINDOW_S = 60.0
# Window of the local polynomial through a speed [s]. Chosen by judgement.
SPEED_WINDOW_S = 1.0
# Share of the speed below which a shaft stands; samples after which the speed exceeds the second
# share are dropouts. Chosen by judgement.
STOPPED = 0.02
RUNS_AGAIN = 5 * STOPPED
# Fewest samples after the unloading, and share of them that must be there. Chosen by judgement.
MIN_SPEED_SAMPLES = 5
MIN_SPEED_SHARE = 0.5
SPIKE_FILTER_SAMPLES = 5  # width of the median filter that removes spikes; chosen by judgement
# Smallest relative change of a speed, and the time after the unloading in which it counts [s].
MIN_SPEED_CHANGE = 0.02
SPEED_CHANGE_WITHIN_S = 20.0


@dataclass(frozen=True)
class Events:
    """Loading and unloading of one EHL test, in the time of the log.

    Parameters
    ----------
    load_on_s, unload_s
        Loading and unloading.
    unload_u_s
        Standard uncertainty of the instant at which the frictional heat ended.
    fall_time_s
        Time in which the friction fell from 90 to 10 %.
    slope_changes_s
        Slope changes of the temperatures: at the middle of the unloading, or at both ends of a slow
        one, and at the ends of ``later_contacts``.
    findings
        Findings about the events.
    later_contacts
        (start, stop) of each later contact.
    """

    load_on_s: float
    unload_s: float
    unload_u_s: float
    fall_time_s: float
    slope_changes_s: tuple[float, ...]
    findings: tuple[Finding, ...] = ()
    later_contacts: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class FrictionCorrection:
    """Friction that the transducer does not measure, with its standard uncertainty.

    Attributes
    ----------
    value_N, u_N
        Correction to add to the measured friction, and its standard uncertainty.
    findings
        Findings about the correction.
    """

    value_N: float
    u_N: float
    findings: tuple[Finding, ...] = ()


# No correction, without uncertainty.
NO_FRICTION_CORRECTION = FrictionCorrection(0.0, 0.0)


@dataclass(frozen=True)
class HertzContact:
    """Semi-axes of the contact ellipse [m] and its maximum pressure [Pa].

    ``minor_m`` (a) is along rolling, ``major_m`` (b) across the running track: the half-width of
    the heat flux.
    """

    minor_m: float
    major_m: float
    pressure_Pa: float

    @property
    def yield_depth_m(self) -> float:
        """Depth of the maximum shear stress, z = a (0.7929 - 0.3207 a/b) [m] (5.1)."""
        return self.minor_m * (0.7929 - 0.3207 * self.minor_m / self.major_m)


def hertz_contact(
    load_N: float,
    radius_m: float = 0.0381,
    crown_radius_m: float = 0.3048,
    young_Pa: float = YOUNG_Pa,
    poisson: float = POISSON,
) -> HertzContact:
    """Contact of two equal crowned disks under ``load_N``.

    Valid for crown radius > rolling radius and elastic contact.

    Parameters
    ----------
    load_N
        Normal load.
    radius_m, crown_radius_m
        Radius of rolling, and of the crown across the running surface.
    young_Pa, poisson
        Elastic constants of both disks.

    Returns
    -------
    contact
        Semi-axes and maximum pressure.

    Raises
    ------
    InputError
        A load that is not positive, or radii in the wrong order.

    Notes
    -----
    With E* = E / (2 (1 - nu^2)), relative curvatures 1/R + 1/R (rolling) and 1/R_c + 1/R_c (axial),
    e^2 = 1 - (a/b)^2 and complete elliptic integrals K, E of e::

        R_c / R = ((b/a)^2 E - K) / (K - E)
        1 / R_c = (p0 / E*) (a / (b^2 e^2)) (K - E),   p0 = 3 W / (2 pi a b)

    Source: Johnson, Contact Mechanics (1985), eqs. 4.26. Table 6.1 gives the pressures, table 3.4
    the half-widths.

    Examples
    --------
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
    # p0 inserted into the second equation: b^3 = 3 W R_c (K - E) / (2 pi E* e^2)
    cube = 1.5 * load_N * crown_radius_m * (ellipk(m) - ellipe(m)) / (np.pi * modulus * m)
    major = cube ** (1 / 3)
    minor = major / ratio
    return HertzContact(float(minor), float(major), float(1.5 * load_N / (np.pi * minor * major)))


def equivalent_radius_m(one_m: float, other_m: float) -> float:
    """Radius of equal disks with the relative curvature of two unequal ones, 2 / (1/R1 + 1/R2) [m].

    Parameters
    ----------
    one_m, other_m
        Radii of the two disks [m].

    Examples
    --------
    >>> round(equivalent_radius_m(0.03, 0.06), 3)
    0.04
    """
    return 2.0 / (1.0 / one_m + 1.0 / other_m)


def half_width_m(load_N: float, radius_m: float = 0.0381, crown_radius_m: float = 0.3048) -> float:
    """Half-width b of the running track [m], the major semi-axis of the contact.

    Parameters
    ----------
    load_N
        Normal load.
    radius_m, crown_radius_m
        Radius of rolling, and of the crown across the running surface.

    Examples
    --------
    Table 3.4 gives 1.25, 1.50, 1.62 and 1.75 mm:

    >>> [round(half_width_m(load) * 1e3, 2) for load in (850, 1460, 1850, 2320)]
    [1.26, 1.5, 1.63, 1.76]
    """
    return hertz_contact(load_N, radius_m, crown_radius_m).major_m


def _axis_ratio(curvature_ratio: float) -> float:
    """b/a for a ratio of the relative curvatures above one.

    Parameters
    ----------
    curvature_ratio
        R_c / R, above one.
    """

    def excess(log_ratio: float) -> float:
        """Curvature ratio that belongs to an axis ratio, minus the wanted one."""
        squared = np.exp(2 * log_ratio)
        m = 1 - 1 / squared
        return float((squared * ellipe(m) - ellipk(m)) / (ellipk(m) - ellipe(m)) - curvature_ratio)

    log_curvature = np.log(curvature_ratio)
    return float(np.exp(brentq(excess, 0.3 * log_curvature, log_curvature + 1.0, xtol=1e-13)))


def surface_speed_m_s(speed_rpm: float, radius_m: float = 0.0381) -> float:
    """Speed of the running surface, u = 2 pi n R / 60 [m/s].

    Parameters
    ----------
    speed_rpm
        Speed of rotation [rpm].
    radius_m
        Radius of the running surface.
    """
    return 2.0 * np.pi * speed_rpm / 60.0 * radius_m


def contact_force(t: Array, raw_N: Array, events: Events) -> Array:
    """Force while the disks touch [N], zero elsewhere.

    Parameters
    ----------
    t
        Time [s], (N,).
    raw_N
        Force as logged, (N,).
    events
        Loading and unloading.

    Returns
    -------
    force
        (N,) [N].

    Notes
    -----
    The zero is the median before loading and after unloading, interpolated linearly between the two
    (section 2.9). Under load the force is a running straight line without spikes that never extends
    across a switching instant: an average across the edge of the unloading would change beta in
    proportion, and so does noise at that edge. The length of the line follows from ``FORCE_NOISE``,
    since the end of a line scatters by 2 sd / sqrt(samples). In later contacts the force is the
    logged one, the mean of each two samples between which it is constant.

    ``SMOOTH_S``, ``MAX_SMOOTH_S`` and ``FORCE_NOISE`` decide how much noise remains at the edge of
    the unloading, which changes beta in proportion. The noise that remains is in
    ``tcdyn.partition.nuisance.friction_noise_effects``, which must smooth in the same way
    (``tests/partition/test_friction_noise.py``). The function must not smooth across a switching
    instant: ``tests/partition/test_events.py``.
    """
    on = events.load_on_s
    off = events.unload_s
    settling_s = events.fall_time_s + SWITCHING_MARGIN_S
    nowhere = np.zeros(len(t), dtype=bool)
    near = [
        (t >= start - SWITCHING_MARGIN_S) & (t <= stop + SWITCHING_MARGIN_S)
        for start, stop in events.later_contacts
    ]
    is_near_contact = np.any([nowhere, *near], axis=0)
    unloaded = np.where(is_near_contact, np.nan, raw_N)
    force_N = raw_N - _zero_of_force(t, unloaded, on - SWITCHING_MARGIN_S, off + settling_s)
    inside = (t > on + SWITCHING_MARGIN_S) & (t < off - settling_s)
    dt_s = float(fast_nanmedian(np.diff(t)))
    smooth = np.interp(t, t[inside], _smooth_force(force_N[inside], dt_s))
    ramp_s = events.fall_time_s / LINEAR_FALL_SHARE
    if ramp_s > 4 * dt_s:
        share = np.clip((off + 0.5 * ramp_s - t) / ramp_s, 0.0, 1.0)
    else:
        share = (t < off).astype(float)
    filled = pd.Series(force_N).interpolate(limit_direction="both")
    means = filled.rolling(2).mean().shift(-1).to_numpy()
    again = [(t >= start) & (t < stop) for start, stop in events.later_contacts]
    is_contact_again = np.any([nowhere, *again], axis=0)
    return np.where(is_contact_again, means, np.where(t >= on, smooth * share, 0.0))


def _smooth_force(raw: Array, dt_s: float) -> Array:
    """A force (N,) without noise, spikes and missing samples; linear up to its ends.

    Parameters
    ----------
    raw
        Force under load (N,) [N], NaN where missing.
    dt_s
        Sample interval [s].

    Returns
    -------
    force
        (N,) [N].
    """
    rule = replace(SPIKES["force"], width=max(int(round(0.5 * SMOOTH_S / dt_s)), 3))
    without_spikes = pd.Series(raw).mask(find_spikes(raw, rule))
    filled = without_spikes.interpolate(limit_direction="both").to_numpy()
    noise_N = float(white_noise_sd(filled))
    window = smoothing_samples(noise_N, float(fast_nanmedian(filled)), dt_s, len(filled))
    return running_line(np.asarray(filled, dtype=float), window)


def running_line(values: Array, samples: int) -> Array:
    """Running straight line through ``samples`` (odd) of ``values`` (N, ...); linear at its ends.

    Examples
    --------
    >>> running_line(np.array([0.0, 0.0, 3.0, 0.0, 0.0]), 3).round(6).tolist()
    [-0.5, 1.0, 1.0, 1.0, -0.5]
    """
    return np.asarray(savgol_filter(values, samples, min(1, samples - 1), axis=0))


def smoothing_samples(noise_N: float, level_N: float, dt_s: float, most: int) -> int:
    """Length in samples (odd) of the running straight line through a noisy force.

    Parameters
    ----------
    noise_N
        Standard deviation of the white noise.
    level_N
        The force.
    dt_s
        Sample interval [s].
    most
        Largest length in samples.

    Returns
    -------
    count
        Odd, at least one.

    Notes
    -----
    Test: ``tests/partition/test_friction_noise.py``.
    """
    noise_ratio = 2 * noise_N / max(FORCE_NOISE * abs(level_N), 1e-12)
    count = min(max(SMOOTH_S / dt_s, noise_ratio**2), MAX_SMOOTH_S / dt_s, most)
    return max(2 * int((count - 1) // 2) + 1, 1)


def _zero_of_force(t: Array, raw: Array, before_s: float, after_s: float) -> Array:
    """Zero of the transducer at each time, from the unloaded segments before and after the test.

    Parameters
    ----------
    t
        Times (N,) [s].
    raw
        Force (N,) [N], NaN in later contacts.
    before_s, after_s
        End of the unloaded time before the test, and start of that after it [s].

    Returns
    -------
    zero
        (N,) [N]; zero where no segment has enough samples.
    """
    ok = np.isfinite(raw)
    before = ok & (t < before_s)
    after = ok & (t > after_s) & (t < after_s + ZERO_WINDOW_S)
    segments = [segment for segment in (before, after) if segment.sum() >= MIN_ZERO_SAMPLES]
    if not segments:
        return np.zeros_like(t)
    times = [float(np.mean(t[segment])) for segment in segments]
    zeros = [float(np.median(raw[segment])) for segment in segments]
    return np.interp(t, times, zeros)


def relative_speed(
    time_s: Array, speed_rpm: Array, from_s: float, level_rpm: float
) -> Array | None:
    """A logged speed after ``from_s`` as a share of ``level_rpm``, (N,); one before ``from_s``.

    Noise, spikes and dropouts are removed. The result is one everywhere if the speed changes by
    less than ``MIN_SPEED_CHANGE`` within ``SPEED_CHANGE_WITHIN_S``.

    Parameters
    ----------
    time_s
        Times (N,) [s].
    speed_rpm
        Speed as logged (N,) [rpm].
    from_s
        Start of the change [s]; usually the unloading.
    level_rpm
        Speed before it [rpm].

    Returns
    -------
    share
        (N,); None if most samples in that time are missing.

    Notes
    -----
    ``MIN_SPEED_CHANGE`` decides whether a change of the speed is used at all. Tests:
    ``tests/partition/test_slowing.py`` and ``tests/partition/test_events.py``.

    Examples
    --------
    >>> t = np.arange(0.0, 60.0, 1 / 75)
    >>> slowing = 3000.0 * np.exp(-np.clip(t - 30.0, 0, None) / 3.0)
    >>> slowing[2500] = 0.0  # a dropout
    >>> relative_speed(t, slowing, 30.0, 3000.0)[[2000, 2475]].round(3)  # 3 s later: to 1/e
    array([1.   , 0.368])
    """
    result = np.ones_like(time_s)
    after = np.flatnonzero(time_s >= from_s)
    share = pd.Series(speed_rpm[after] / level_rpm)
    later_maximum = share[::-1].fillna(0.0).cummax()[::-1]
    is_dropout = (share < STOPPED) & (later_maximum > RUNS_AGAIN)
    share = share.mask(is_dropout)
    near = time_s[after] < from_s + SPEED_CHANGE_WITHIN_S
    if len(after) < MIN_SPEED_SAMPLES or share[near].notna().mean() < MIN_SPEED_SHARE:
        return None
    filled = share.interpolate(limit_direction="both")
    smooth = filled.rolling(SPIKE_FILTER_SAMPLES, center=True, min_periods=1).median().to_numpy()
    dt_s = float(np.median(np.diff(time_s)))
    window = min(2 * int(0.5 * SPEED_WINDOW_S / dt_s) + 1, 2 * ((len(smooth) - 1) // 2) + 1)
    if window > 3:
        smooth = savgol_filter(smooth, window, 2)
    if np.abs(smooth[near] - 1).max() >= MIN_SPEED_CHANGE:
        result[after] = np.clip(smooth, 0.0, None)
    return result


def sliding_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Sliding speed u_s = u_fast - u_slow [m/s] (table 6.1).

    Parameters
    ----------
    fast_rpm, slow_rpm
        Speeds of the shafts [rpm].
    radius_m
        Radius of both running surfaces.

    Examples
    --------
    >>> round(sliding_speed_m_s(6555, 1546), 1)
    20.0
    """
    return surface_speed_m_s(fast_rpm, radius_m) - surface_speed_m_s(slow_rpm, radius_m)


def entraining_speed_m_s(fast_rpm: float, slow_rpm: float, radius_m: float = 0.0381) -> float:
    """Entraining (mean) speed u_m = (u_fast + u_slow) / 2 [m/s] (table 6.1).

    Parameters
    ----------
    fast_rpm, slow_rpm
        Speeds of the shafts [rpm].
    radius_m
        Radius of both running surfaces.

    Examples
    --------
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

    Parameters
    ----------
    radial_interference_m
        Radial interference delta: half of the diametral one.
    fit_radius_m
        Radius R of the fit.
    outer_radius_m, inner_radius_m
        Outer radius of the disk, and inner radius of the shaft.
    young_Pa
        Modulus of both parts.

    Examples
    --------
    Section 6.4.3 gives 27.3 and 45.6 MPa:

    >>> [round(interference_pressure_Pa(d / 2) / 1e6, 1) for d in (15.2e-6, 25.4e-6)]
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

    Source: Leung et al. (1998) as quoted by the thesis; measured in vacuum.

    Parameters
    ----------
    pressure_Pa
        Contact pressure P.
    hardness_Pa
        Micro-hardness H.
    roughness_m
        Standard deviation sigma of the roughness.
    slope
        Asperity slope m [-].
    conductivity_W_mK
        Conductivity k of the joint.

    Examples
    --------
    >>> low, high = (contact_conductance_W_m2K(p, 2.7e9, 1e-6, 0.1, 16) for p in (1e6, 45.6e6))
    >>> round(high / low, 1)  # table 6.6: about 14
    14.1
    """
    return 0.170 * (pressure_Pa / hardness_Pa) ** 0.693 * slope * conductivity_W_mK / roughness_m


def press_fit_conductance(setup: DiskSetup) -> tuple[float, float]:
    """Pressure of the press fit of a disk (6.1), and its conductance in contact (6.2).

    Parameters
    ----------
    setup
        A disk with a press fit.

    Returns
    -------
    pressure_Pa
        Pressure.
    conductance_W_m2K
        Conductance where the surfaces touch.

    Raises
    ------
    InputError
        The rig file has no press fit, or the disk has no bore.
    """
    fit = setup.press_fit
    bore_m = setup.bore_radius_m
    if not (fit.is_specified and bore_m > 0):
        raise InputError(
            f"rig.toml states no press fit of the {setup.name} disk",
            expected="[fit] with an interference_um above zero, and a bore",
            remedy="`tcdyn rig check` lists every key with its default",
        )
    pressure = interference_pressure_Pa(0.5e-6 * fit.interference_um, bore_m, setup.outer_radius_m)
    conductance = contact_conductance_W_m2K(
        pressure,
        hardness_Pa=1e9 * fit.hardness_GPa,
        roughness_m=1e-6 * fit.roughness_um,
        slope=fit.slope,
        conductivity_W_mK=fit.conductivity_W_mK,
    )
    return pressure, conductance
