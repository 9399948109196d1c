"""Angular harmonic: first circumferential harmonic of a disk by uneven contact round its bore.

Disk, shaft and junctions turn together, so a press fit that conducts better on one side makes a
pattern that is constant in the disk's frame, cos and sin of the angle (section 6.4.3). In the rim
T1(r) obeys T1'' + T1'/r - (1/r^2 + kappa^2) T1 = 0, heat leaving through the washers by kappa^2 = 2
h_washer/(K w), with K T1' = -h T1 at the running surface. The pattern is slow, because it is made
at the bore. For each of cos and sin there are four nuisance parameters: level, linear change
(drift) and quadratic change (curvature) over the steady window, and fall after the unloading. The
junctions do not determine the second harmonic: for two groups of junctions that lie opposite it is
nearly the same in both.

The joint fits estimate the harmonic, :mod:`tcdyn.partition.analyse` subtracts it, and
:mod:`tcdyn.partition.circumferential` draws it. Guarded by ``tests/partition/test_uneven.py`` and
``tests/partition/test_stated_fit.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.findings import Finding, info
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.rig.disk import DiskSetup

# Shapes in time, and prior standard deviations [K] at the rim's edge, the depth of b. Chosen by
# judgement. The order is that of ``harmonic_time_shapes``.
HARMONIC_PRIOR_K = {"level": 4.0, "drift": 0.3, "curvature": 0.15, "fall": 0.5}
# Least prior standard deviations relative to the level, once that is significant [1]. Chosen by
# judgement.
HARMONIC_PRIOR_REL = {"level": 1.0, "drift": 0.3, "curvature": 0.15, "fall": 0.5}
# Drift and curvature continue this long after the unloading [s]: the bore does not feel it yet.
DRIFT_LASTS_S = 10.0
# Half of what falls has fallen by then [s]; a fiftieth after ten seconds. By whole-disk solutions.
HALF_FALL_S = 25.0
# Second harmonic that the same contact makes, relative to the first. By whole-disk solutions.
SECOND_HARMONIC_REL = 0.07
# Standard uncertainty of each junction's angle [deg]: that of the rig file is assumed
# (design, section 12).
ANGLE_U_DEG = 3.0
# The harmonic is significant beyond this many standard uncertainties: one even disk in 90.
SIGNIFICANT_Z = 3.0
LEAST_KAPPA_R = 1e-2  # least kappa times the outer radius, for the Bessel functions
UNKNOWN_ANGLE_U_DEG = 180.0 / 3**0.5  # standard uncertainty of a completely unknown angle [deg]

# Components of a harmonic. The parameters are ordered by shape, then by component.
COMPONENTS = ("cos", "sin")
FIRST_HARMONIC = tuple(
    NuisanceParameter(f"uneven {shape}, {component}", "uneven bore contact")
    for shape in HARMONIC_PRIOR_K
    for component in COMPONENTS
)
SECOND_HARMONIC = tuple(
    NuisanceParameter(f"second harmonic, {component}", "second harmonic round the bore")
    for component in COMPONENTS
)
ANGLE_SOURCE = "angles of the junctions"
# Sources of the budget that belong to the circumferential harmonics.
HARMONIC_SOURCES = {
    ANGLE_SOURCE,
    *(parameter.source for parameter in (*SECOND_HARMONIC, *FIRST_HARMONIC)),
}


@dataclass(frozen=True)
class AngularHarmonic:
    """First circumferential harmonic of one disk: its prior, or the result of a joint fit.

    Parameters
    ----------
    prior_K
        Prior standard deviations of level, drift, curvature and fall at the depth of b, (4,) [K].
    estimate
        Estimate of ``FIRST_HARMONIC`` in prior standard deviations, (8,): cos and sin of each
        shape.
    covariance
        Total covariance of the estimate, (8, 8), in the same unit.
    sensitivities
        Change of the estimate by one standard uncertainty of each other nuisance parameter, (8,)
        each.
    h_W_m2K
        Heat transfer coefficient of the fit.
    second_harmonic_u_K
        Standard uncertainty of the second harmonic at the depth of b [K]; positive only where the
        first is significant or a press fit is stated.
    angle_level_K
        Level, cos and sin, by which errors of the junctions' angles count, (2,) [K].
    steady_window_s
        Length of the steady window [s], over which drift and curvature are defined.
    nominal_K
        Level that a press fit stated in rig.toml makes, about which the prior is, (2,) [K].
    nominal_second_K
        Second harmonic of that press fit, (2,) [K].

    Notes
    -----
    Without arguments it is the prior of a disk about which nothing is known: no estimate, unit
    covariance in prior standard deviations.
    """

    prior_K: Array = field(default_factory=lambda: np.array(list(HARMONIC_PRIOR_K.values())))
    estimate: Array = field(default_factory=lambda: np.zeros(len(FIRST_HARMONIC)))
    covariance: Array = field(default_factory=lambda: np.eye(len(FIRST_HARMONIC)))
    sensitivities: Mapping[NuisanceParameter, Array] = field(default_factory=dict)
    h_W_m2K: float = 0.0
    second_harmonic_u_K: float = 0.0
    angle_level_K: Array = field(default_factory=lambda: np.zeros(2))
    steady_window_s: float = 150.0
    nominal_K: Array = field(default_factory=lambda: np.zeros(2))
    nominal_second_K: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def level_K(self) -> Array:
        """The level at the depth of b, (2,), cos and sin [K]."""
        return np.asarray(self.nominal_K + self.prior_K[0] * self.estimate[:2])

    @property
    def level_covariance_K2(self) -> Array:
        """Covariance (2, 2) of the level at the depth of b, cos and sin [K2]."""
        return np.asarray(self.prior_K[0] ** 2 * self.covariance[:2, :2])

    def level_z(self, departure_K: Array) -> float:
        """Length of a departure of the level in standard uncertainties.

        Parameters
        ----------
        departure_K
            The departure, cos and sin, (2,) [K].
        """
        return float(np.sqrt(departure_K @ np.linalg.solve(self.level_covariance_K2, departure_K)))

    @property
    def significance(self) -> float:
        """Level in standard uncertainties; below ``SIGNIFICANT_Z`` = 3 in 99 of 100 even disks.

        Notes
        -----
        For a level of zero its square is chi-squared with two degrees of freedom: P(> 9) = 0.011.
        """
        return self.level_z(self.level_K)

    @property
    def amplitude_K(self) -> Estimate:
        """Half the difference of hottest and coldest side at the unloading, depth of b [K]."""
        level = self.level_K
        size = float(np.hypot(*level))
        direction = level / size if size else np.array([1.0, 0.0])
        u = float(np.sqrt(direction @ self.level_covariance_K2 @ direction))
        return Estimate(value=size, u=u, low95=max(size - Z95 * u, 0.0), high95=size + Z95 * u)

    @property
    def hottest_angle_deg(self) -> Estimate:
        """Angle of the hottest side in the frame of the junctions' ``angle_deg`` [deg].

        Where the harmonic is not significant, or its angle is as uncertain as an unknown one, the
        interval is the full circle.

        Returns
        -------
        Estimate
            Value from 0 to 360. The limits are not wrapped: they may be negative or above 360.

        Notes
        -----
        u = sqrt(n'Cn) / |level|, to first order, for the covariance C of the level and the unit
        vector n at right angles to it. u is at most ``UNKNOWN_ANGLE_U_DEG``. Where the harmonic is
        not significant only the interval is widened, not u.

        ``SIGNIFICANT_Z`` may change; it must stay the limit of :meth:`finding`. The key of
        ``beta.json`` is ``angle_deg``, which must stay.
        ``test_amplitude_and_angle_are_recovered_within_their_interval`` in
        ``tests/partition/test_uneven.py`` (marked study) compares amplitude and angle with the
        truth.
        """
        level = self.level_K
        size = float(np.hypot(*level))
        normal = np.array([-level[1], level[0]]) / size if size else np.array([0.0, 1.0])
        across_u_K = float(np.sqrt(normal @ self.level_covariance_K2 @ normal))
        u = np.rad2deg(across_u_K / max(size, 1e-12))
        determined = self.significance > SIGNIFICANT_Z and u < UNKNOWN_ANGLE_U_DEG
        angle = float(np.rad2deg(np.arctan2(level[1], level[0])) % 360.0)
        half = Z95 * u if determined else 180.0
        return Estimate(
            value=angle, u=min(u, UNKNOWN_ANGLE_U_DEG), low95=angle - half, high95=angle + half
        )

    def finding(self, disk: str) -> Finding | None:
        """An info where the harmonic is significant, else None.

        Parameters
        ----------
        disk
            Name of the disk, the subject of the finding.
        """
        if self.significance < SIGNIFICANT_Z:
            return None
        size = self.amplitude_K
        angle = self.hottest_angle_deg
        return info(
            "unevenness",
            subject=disk,
            amplitude_K=size.value,
            u_K=size.u,
            angle_deg=angle.value,
            angle_u_deg=angle.u,
        )

    def to_dict(self) -> dict[str, dict[str, float]]:
        """The entry of ``beta.json``."""
        return {
            "amplitude_K": self.amplitude_K.model_dump(),
            "angle_deg": self.hottest_angle_deg.model_dump(),
        }

    @property
    def prior_for_refit(self) -> AngularHarmonic:
        """The prior for a second fit of this disk.

        Where the harmonic is significant, its changes and its second harmonic may be proportional
        to it, and errors of the junctions' angles count. Otherwise it is the default prior.
        """
        if self.significance < SIGNIFICANT_Z:
            return AngularHarmonic(steady_window_s=self.steady_window_s)
        size = self.amplitude_K.value
        return AngularHarmonic(
            prior_K=harmonic_prior_K(size),
            second_harmonic_u_K=SECOND_HARMONIC_REL * size,
            angle_level_K=self.level_K,
            steady_window_s=self.steady_window_s,
        )


# The default prior, with the default length of the steady window.
UNKNOWN_HARMONIC = AngularHarmonic()


def harmonic_prior_K(size_K: float) -> Array:
    """Prior standard deviations of level, drift, curvature and fall, (4,) [K].

    Parameters
    ----------
    size_K
        Amplitude of the level of the disk [K].

    Notes
    -----
    The larger of ``HARMONIC_PRIOR_K`` and ``HARMONIC_PRIOR_REL`` times the level. Both may change;
    their keys and their order must stay those of ``harmonic_time_shapes``.
    """
    relative = np.array(list(HARMONIC_PRIOR_REL.values()))
    return np.maximum(list(HARMONIC_PRIOR_K.values()), size_K * relative)


def washer_kappa(setup: DiskSetup) -> float:
    """kappa of the heat that leaves through the washers [1/m].

    Notes
    -----
    kappa^2 = 2 h_washer/(K w): two faces, on a disk of width w. ``LEAST_KAPPA_R`` keeps the Bessel
    functions finite; ``tests/partition/test_uneven.py`` uses the same least value.
    """
    washer = setup.washer_conductivity_W_mK / setup.washer_thickness_m
    kappa = np.sqrt(2 * washer / (setup.conductivity_W_mK * setup.width_m))
    return float(max(kappa, LEAST_KAPPA_R / setup.outer_radius_m))


def radial_shape(setup: DiskSetup, h_W_m2K: float, depth_m: Array, n: int = 1) -> Array:
    """T_n at depths below the running surface over T_n at the depth of b, shape of ``depth_m``.

    Parameters
    ----------
    setup
        The disk.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    depth_m
        Depths below the running surface [m].
    n
        Number of the harmonic.

    Notes
    -----
    T_n = I_n(kappa r) + C K_n(kappa r), with C from K dT_n/dr = -h T_n at the running surface. The
    rim is taken as thin across its width, and steady. ``tests/partition/test_uneven.py`` checks the
    equation and the boundary condition by differences, and (study) the shape by a whole disk.

    Examples
    --------
    >>> from tcdyn.rig.rigfile import load_rig
    >>> radial_shape(load_rig().disk_setup("fast"), 0.0, np.array([0.006, 0.0])).round(2)
    array([1.  , 0.97])
    """
    k = setup.conductivity_W_mK
    outer = setup.outer_radius_m
    kappa = washer_kappa(setup)
    edge = kappa * outer
    lost_i = k * kappa * special.ivp(n, edge) + h_W_m2K * special.iv(n, edge)
    lost_k = k * kappa * special.kvp(n, edge) + h_W_m2K * special.kv(n, edge)
    depths = np.append(np.ravel(depth_m), setup.edge_m)
    x = kappa * (outer - depths)
    shape = special.iv(n, x) - lost_i / lost_k * special.kv(n, x)
    return np.asarray((shape[:-1] / shape[-1]).reshape(np.shape(depth_m)))


def harmonic_at_junctions(
    setup: DiskSetup, h_W_m2K: float, channels: Sequence[str], n: int = 1
) -> Array:
    """Reading of channels by a kelvin of a harmonic at the depth of b, (2, C) for cos and sin.

    Parameters
    ----------
    setup
        The disk.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    channels
        The C channels.
    n
        Number of the harmonic.
    """
    junctions = [setup.junctions[c] for c in channels]
    angle = n * np.deg2rad([j.angle_deg for j in junctions])
    shape = radial_shape(setup, h_W_m2K, np.array([j.depth_m for j in junctions]), n)
    return shape * np.stack([np.cos(angle), np.sin(angle)])


def harmonic_time_shapes(since_s: Array, steady_window_s: float) -> Array:
    """Time courses (4, N) of the angular harmonic for unit amplitude.

    Rows in the order of ``HARMONIC_PRIOR_K``: level 1, drift t/window, curvature (t/window)^2, and
    the fall after the unloading. The parameters of the harmonic in the fits have the same order.

    Parameters
    ----------
    since_s
        Times since the unloading, (N,) [s].
    steady_window_s
        Length of the steady window [s]. Before it the shapes are as at its start; drift and
        curvature continue for ``DRIFT_LASTS_S`` after the unloading.

    Notes
    -----
    The form of the shapes may change; ``FIRST_HARMONIC``, ``HARMONIC_PRIOR_K`` and
    ``HARMONIC_PRIOR_REL`` must keep the same order and number. The doctest fails on a change.

    Examples
    --------
    >>> harmonic_time_shapes(np.array([-200.0, -50.0, 0.0, 25.0]), 100.0).round(2)
    array([[ 1.  ,  1.  ,  1.  ,  1.  ],
           [-1.  , -0.5 ,  0.  ,  0.1 ],
           [ 1.  ,  0.25,  0.  ,  0.01],
           [ 0.  ,  0.  ,  0.  ,  0.5 ]])
    """
    x = np.clip(np.asarray(since_s, dtype=float), -steady_window_s, DRIFT_LASTS_S) / steady_window_s
    return np.stack([np.ones_like(x), x, x * x, fall_fraction(since_s)])


def fall_fraction(since_s: Array) -> Array:
    """Fraction of the whole fall that has happened within a time since the unloading.

    Parameters
    ----------
    since_s
        Times since the unloading, any shape [s]; before it the fraction is zero.

    Notes
    -----
    x/(1 + x) with x = (t / HALF_FALL_S)^3. It begins with the third power of time, because the bore
    is far. The form approximates whole-disk solutions.
    """
    cube = (np.clip(np.asarray(since_s, dtype=float), 0.0, None) / HALF_FALL_S) ** 3
    return np.asarray(cube / (1 + cube))


def harmonic_effect(setup: DiskSetup, h_W_m2K: float, static: Array, n: int = 1) -> Array:
    """Readings less prediction by a kelvin of a harmonic at the depth of b, (2, m).

    The two rows are cos and sin.

    Parameters
    ----------
    setup
        The disk.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    static
        Response of the m predicted junctions, the first of the disk's ``rows``, to a constant
        kelvin at each of the inner row, (k, m).
    n
        Number of the harmonic.

    Notes
    -----
    The inner row reads the harmonic too, and drives the rim model with it; that part is subtracted.
    So only a difference between the rows is seen, and the full harmonic where the inner row itself
    is predicted without its readings.
    """
    rows = harmonic_at_junctions(setup, h_W_m2K, setup.rows, n)
    inner = rows[:, len(setup.outer) :]
    return np.asarray(rows[:, : static.shape[1]] - inner @ static)


def add_harmonic_effects(
    parameters: tuple[NuisanceParameter, ...],
    change: Array,
    harmonic: AngularHarmonic,
    setup: DiskSetup,
    h_W_m2K: float,
    static: Array,
    since_s: Array,
) -> tuple[tuple[NuisanceParameter, ...], Array]:
    """Append the nuisance parameters of the circumferential harmonics.

    Parameters
    ----------
    parameters, change
        All other nuisance parameters, (Q,), and their effects, (Q, R, m) [K].
    harmonic
        The harmonic of the disk.
    setup, h_W_m2K
        The disk, and the heat transfer coefficient of its running surface.
    static
        As of :func:`harmonic_effect`.
    since_s
        Times of the R blocks since the unloading, (R,) [s].

    Returns
    -------
    parameters, change
        The given parameters, then second harmonic (2), angle of each junction, first harmonic (8);
        and the effects of all, (Q + 10 + C, R, m) [K].

    Notes
    -----
    Where a harmonic was estimated and removed, its remainder changes with the other nuisance
    parameters; these effects are added to theirs. The part of the remainder that is independent of
    them has the remaining covariance, ``harmonic.covariance`` less the sum of s s' over the
    sensitivities s. For the prior that is the identity.

    The first harmonic must stay last, in the order of ``FIRST_HARMONIC``.
    ``tests/partition/test_uneven.py`` fails if the remaining covariance has another effect.
    """
    blocks = change.shape[1:]
    in_time = harmonic.prior_K[:, None] * harmonic_time_shapes(since_s, harmonic.steady_window_s)
    at_outer_row = harmonic_effect(setup, h_W_m2K, static)
    first = in_time[:, None, :, None] * at_outer_row[None, :, None, :]
    first = first.reshape(len(FIRST_HARMONIC), *blocks)
    second = harmonic.second_harmonic_u_K * harmonic_effect(setup, h_W_m2K, static, 2)
    angles = angle_error_effect(setup, h_W_m2K, static, harmonic.angle_level_K)
    constant = np.concatenate([second, angles])[:, None] * np.ones((1, *blocks))
    change = np.concatenate([change, constant])
    angle_parameters = (NuisanceParameter(f"angle {c}", ANGLE_SOURCE) for c in setup.rows)
    parameters = (*parameters, *SECOND_HARMONIC, *angle_parameters)
    zero = np.zeros(len(FIRST_HARMONIC))
    by_others = np.array([harmonic.sensitivities.get(parameter, zero) for parameter in parameters])
    remaining = harmonic.covariance - by_others.T @ by_others
    values, vectors = np.linalg.eigh(remaining)
    # the symmetric root: near the prior it has the prior's own directions
    root = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ vectors.T
    change = change + np.tensordot(by_others, first, axes=1)
    return (*parameters, *FIRST_HARMONIC), np.concatenate(
        [change, np.tensordot(root, first, axes=1)]
    )


def angle_error_effect(setup: DiskSetup, h_W_m2K: float, static: Array, level_K: Array) -> Array:
    """Readings less prediction if one junction lies ``ANGLE_U_DEG`` further round, (P + k, n) [K].

    Parameters
    ----------
    setup
        The disk.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    static
        As of :func:`harmonic_effect`.
    level_K
        Level of the harmonic, cos and sin, (2,) [K].
    """
    cos, sin = harmonic_at_junctions(setup, h_W_m2K, setup.rows)
    p = len(setup.outer)
    change = np.diag(np.deg2rad(ANGLE_U_DEG) * (level_K[1] * cos - level_K[0] * sin))
    return np.asarray(change[:, : static.shape[1]] - change[:, p:] @ static)


def harmonic_from_fit(
    estimate: Array,
    covariance: Array,
    parameters: Sequence[tuple[NuisanceParameter, str]],
    disk: str,
    h_W_m2K: float,
    prior: AngularHarmonic,
) -> AngularHarmonic:
    """The harmonic of one disk by a joint fit.

    Parameters
    ----------
    estimate, covariance
        Estimate (Q,) and covariance (Q, Q) of the nuisance parameters, in standard uncertainties.
    parameters
        The Q nuisance parameters, each with its disk, or "" if common to both.
    disk, h_W_m2K
        Name of the disk, and its fitted heat transfer coefficient.
    prior
        Prior of the harmonic that the fit used.

    Notes
    -----
    With priors of unit variance, the truth departs from the estimate by the covariance times the
    departure of the other nuisance parameters from their nominal values, and by the noise.
    """
    rows = [parameters.index((parameter, disk)) for parameter in FIRST_HARMONIC]
    sensitivities = {
        parameter: covariance[rows, k]
        for k, (parameter, of_disk) in enumerate(parameters)
        if of_disk in ("", disk) and parameter not in FIRST_HARMONIC
    }
    return replace(
        prior,
        estimate=estimate[rows],
        covariance=covariance[np.ix_(rows, rows)],
        sensitivities=sensitivities,
        h_W_m2K=h_W_m2K,
    )


def harmonic_K(harmonic: AngularHarmonic, setup: DiskSetup, since_s: Array) -> Array:
    """The part of the readings by the estimated harmonic, (N, C) [K].

    Parameters
    ----------
    harmonic
        The harmonic of the disk.
    setup
        The disk, with C channels.
    since_s
        Times since the unloading, (N,) [s].

    Notes
    -----
    The first harmonic, and the second of a stated press fit, which is constant in time.
    ``tcdyn.partition.fit_rounds.remove_harmonics`` subtracts it;
    ``tests/partition/test_stated_fit.py`` and ``tests/partition/test_uneven.py`` check that
    readings and harmonic add up.
    """
    size_K = harmonic.prior_K[:, None] * harmonic.estimate.reshape(
        len(HARMONIC_PRIOR_K), len(COMPONENTS)
    )
    size_K[0] += harmonic.nominal_K
    first = harmonic_at_junctions(setup, harmonic.h_W_m2K, setup.channels)
    second = harmonic_at_junctions(setup, harmonic.h_W_m2K, setup.channels, 2)
    in_time = harmonic_time_shapes(since_s, harmonic.steady_window_s)
    return np.asarray(in_time.T @ size_K @ first + harmonic.nominal_second_K @ second)
