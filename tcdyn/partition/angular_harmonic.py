"""Uneven contact round the bore: the first harmonic of a disk's temperature, and what it does to the readings.

Disk, shaft and junctions turn together, so a press fit that conducts better on one side leaves a pattern that stands in
the disk's frame, cos and sin of the angle. In the rim T1(r) obeys T1'' + T1'/r - (1/r^2 + kappa^2) T1 = 0, heat leaving
through the washers by kappa^2 = 2 h_washer/(K w), with K T1' = -h T1 at the running surface: it is slow, for it is made
at the bore. Of each of cos and sin a level, its drift and bend over the steady window, and its fall after the parting
are not measured; the unseen second harmonic is nearly the same for two groups of junctions that lie opposite.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.findings import Finding, info
from tcdyn.rig.disk import DiskSetup

SHAPES = {
    "level": 4.0,
    "drift": 0.3,
    "bend": 0.15,
    "fall": 0.5,
}  # priors [K] at the rim's edge, the depth of b
HARMONIC_PRIOR_REL = {
    "level": 1.0,
    "drift": 0.3,
    "bend": 0.15,
    "fall": 0.5,
}  # at least this share of the level, once it was found
DRIFT_LASTS_S = 10.0  # as long after the parting drift and bend go on: the bore does not feel it yet
HALF_FALL_S = 25.0  # by then half of what falls has fallen: a fiftieth after ten seconds, against whole-disk solutions
SECOND_HARMONIC_REL = 0.07  # of the first harmonic: what the same contact makes of the second, against whole-disk solutions
ANGLE_U_DEG = 3.0  # of each junction: what stands in the rig file is assumed (design, section 12)
SIGNIFICANT_Z = 3.0
LEAST_KAPPA_R = 1e-2
LARGEST_ANGLE_U_DEG = 180.0 / 3**0.5  # of an angle that nobody knows


@dataclass(frozen=True)
class Unmeasured:
    """Something not measured: ``source`` is its line of the budget; ``shared``: both disks have it in common."""

    name: str
    source: str
    shared: bool = False


COMPONENTS = ("cos", "sin")
FIRST_HARMONIC = tuple(
    Unmeasured(f"uneven {shape}, {side}", "uneven bore contact")
    for shape in SHAPES
    for side in COMPONENTS
)
SECOND_HARMONIC = tuple(
    Unmeasured(f"second harmonic, {side}", "second harmonic round the bore") for side in COMPONENTS
)
ANGLE_SOURCE = "angles of the junctions"
HARMONIC_SOURCES = {
    ANGLE_SOURCE,
    *(what.source for what in (*SECOND_HARMONIC, *FIRST_HARMONIC)),
}  # sources of what has to do with the bore


@dataclass(frozen=True)
class Unevenness:
    """What is known of the first harmonic of one disk: nothing but its prior, or what a joint fit found.

    ``found`` (8,): of ``FIRST_HARMONIC``, in standard uncertainties of the prior; ``covariance`` (8, 8) of what it leaves, in
    all; ``by_others``: how that moves with a standard uncertainty of what else nobody measured, (8,) each; ``h_W_m2K``:
    the film that it was found with; ``prior_K`` (4,): that prior, of ``SHAPES``; ``second_K``: standard uncertainty of
    the second harmonic at the depth of b; ``about_K`` (2,): the level, cos and sin, about which angles may be wrong;
    ``span_s``: length of the steady window, over which drift and bend are told; ``stated_K`` and ``stated_second_K``
    (2,): the level that a stated press fit makes, about which the prior is, and its second harmonic.
    """

    prior_K: Array = field(default_factory=lambda: np.array(list(SHAPES.values())))
    found: Array = field(default_factory=lambda: np.zeros(len(FIRST_HARMONIC)))
    covariance: Array = field(default_factory=lambda: np.eye(len(FIRST_HARMONIC)))
    by_others: Mapping[Unmeasured, Array] = field(default_factory=dict)
    h_W_m2K: float = 0.0
    second_K: float = 0.0
    about_K: Array = field(default_factory=lambda: np.zeros(2))
    span_s: float = 150.0
    stated_K: Array = field(default_factory=lambda: np.zeros(2))
    stated_second_K: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def _level(self) -> tuple[Array, Array]:
        return self.stated_K + self.prior_K[0] * self.found[:2], self.prior_K[
            0
        ] ** 2 * self.covariance[:2, :2]

    def level_z(self, off_K: Array) -> float:
        """Length of a departure (2,) of the level, cos and sin [K], in standard uncertainties of what was found."""
        return float(np.sqrt(off_K @ np.linalg.solve(self._level[1], off_K)))

    @property
    def level_K(self) -> Array:
        """The level at the depth of b, (2,), cos and sin [K]."""
        return np.asarray(self._level[0])

    @property
    def level_covariance_K2(self) -> Array:
        """Covariance (2, 2) of the level at the depth of b, cos and sin [K2]."""
        return np.asarray(self._level[1])

    @property
    def significance(self) -> float:
        """Distance of the level from zero in standard uncertainties: below 3 in 99 of 100 even disks."""
        return self.level_z(self._level[0])

    @property
    def amplitude_K(self) -> Estimate:
        """Half the difference between the hottest and the coldest side at the depth of b, at the parting [K]."""
        level, covariance = self._level
        size = float(np.hypot(*level))
        toward = level / size if size else np.array([1.0, 0.0])
        u = float(np.sqrt(toward @ covariance @ toward))
        return Estimate(value=size, u=u, low95=max(size - Z95 * u, 0.0), high95=size + Z95 * u)

    @property
    def angle_deg(self) -> Estimate:
        """Where the hottest side is, in the frame of the junctions' ``angle_deg`` [deg]; it may be anywhere."""
        level, covariance = self._level
        size = float(np.hypot(*level))
        across = np.array([-level[1], level[0]]) / size if size else np.array([0.0, 1.0])
        u = np.rad2deg(float(np.sqrt(across @ covariance @ across)) / max(size, 1e-12))
        known = self.significance > SIGNIFICANT_Z and u < LARGEST_ANGLE_U_DEG
        at = float(np.rad2deg(np.arctan2(level[1], level[0])) % 360.0)
        half = Z95 * u if known else 180.0
        return Estimate(value=at, u=min(u, LARGEST_ANGLE_U_DEG), low95=at - half, high95=at + half)

    def finding(self, disk: str) -> Finding | None:
        """A note where the disk is uneven beyond doubt."""
        if self.significance < SIGNIFICANT_Z:
            return None
        size = self.amplitude_K
        at = self.angle_deg
        return info(
            "unevenness",
            subject=disk,
            amplitude_K=size.value,
            u_K=size.u,
            angle_deg=at.value,
            angle_u_deg=at.u,
        )

    def to_dict(self) -> dict[str, dict[str, float]]:
        """As ``beta.json`` keeps it."""
        return {
            "amplitude_K": self.amplitude_K.model_dump(),
            "angle_deg": self.angle_deg.model_dump(),
        }

    @property
    def expected(self) -> Unevenness:
        """The prior of a disk of which this was found: where it is beyond doubt, its change and its second harmonic may
        be shares of it, and the junctions' angles matter."""
        if self.significance < SIGNIFICANT_Z:
            return Unevenness(span_s=self.span_s)
        size = self.amplitude_K.value
        return Unevenness(
            prior_K=harmonic_prior_K(size),
            second_K=SECOND_HARMONIC_REL * size,
            about_K=self._level[0],
            span_s=self.span_s,
        )


UNKNOWN = Unevenness()


def harmonic_prior_K(size_K: float) -> Array:
    """Standard uncertainties (4,) of ``SHAPES`` [K] in a disk whose level is known to be of ``size_K``."""
    return np.maximum(list(SHAPES.values()), size_K * np.array(list(HARMONIC_PRIOR_REL.values())))


def washer_kappa(setup: DiskSetup) -> float:
    """kappa of heat leaving through the washers [1/m]."""
    washer = setup.washer_conductivity_W_mK / setup.washer_thickness_m
    k = setup.conductivity_W_mK
    return float(
        max(np.sqrt(2 * washer / (k * setup.width_m)), LEAST_KAPPA_R / setup.outer_radius_m)
    )


def radial_shape(setup: DiskSetup, h_W_m2K: float, depth_m: Array, n: int = 1) -> Array:
    """T_n at depths below the running surface over T_n at the depth of b, same shape: I_n(kappa r) + C K_n(kappa r).

    C from K dT_n/dr = -h T_n at the running surface; n is the number of the harmonic.

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


def harmonic_at_junctions(setup: DiskSetup, h_W_m2K: float, channels: Sequence[str], n: int = 1) -> Array:
    """What each of ``channels`` reads more by a kelvin of harmonic ``n`` at the depth of b, (2, C) for cos and sin."""
    places = [setup.junctions[c] for c in channels]
    angle = n * np.deg2rad([p.angle_deg for p in places])
    return radial_shape(setup, h_W_m2K, np.array([p.depth_m for p in places]), n) * np.stack(
        [np.cos(angle), np.sin(angle)]
    )


def time_shapes(since_s: Array, span_s: float) -> Array:
    """``SHAPES`` of a kelvin at times since the parting, (4, N) [K]: level at it, drift, bend, and fall after it.

    Before the steady window, which lasts ``span_s``, as at its start; what was under way goes on for ``DRIFT_LASTS_S`` after
    the parting. The fall begins with the third power of time: the bore is far.

    >>> time_shapes(np.array([-200.0, -50.0, 0.0, 25.0]), 100.0).tolist()
    [[1.0, 1.0, 1.0, 1.0], [-1.0, -0.5, 0.0, 0.1], [1.0, 0.25, 0.0, 0.010000000000000002], [0.0, 0.0, 0.0, 0.5]]
    """
    x = np.clip(np.asarray(since_s, dtype=float), -span_s, DRIFT_LASTS_S) / span_s
    return np.stack([np.ones_like(x), x, x * x, fall_fraction(since_s)])


def fall_fraction(since_s: Array) -> Array:
    """Share, of all that falls, that fell within a time since the parting."""
    cube = (np.clip(np.asarray(since_s, dtype=float), 0.0, None) / HALF_FALL_S) ** 3
    return np.asarray(cube / (1 + cube))


def outer_row_effect(setup: DiskSetup, h_W_m2K: float, static: Array, n: int = 1) -> Array:
    """What the outer row shows more than predicted by a kelvin of harmonic ``n`` at the edge, (2, P) for cos and sin.

    ``static`` (k, P): its answer to a lasting kelvin at each of the inner row, whose own part drives the rim.
    """
    outer, inner = (harmonic_at_junctions(setup, h_W_m2K, row, n) for row in (setup.outer, setup.inner))
    return np.asarray(outer - inner @ static)


def add_harmonic_effects(
    of: tuple[Unmeasured, ...],
    change: Array,
    known: Unevenness,
    setup: DiskSetup,
    h_W_m2K: float,
    static: Array,
    since_s: Array,
) -> tuple[tuple[Unmeasured, ...], Array]:
    """``change`` (Q, R, P) of everything else unmeasured, with what has to do with the bore added [K].

    Where a harmonic was found and subtracted, its remainder moves with what else nobody measured, and the rest of it
    has the covariance that is left.
    """
    first = (known.prior_K[:, None] * time_shapes(since_s, known.span_s))[:, None, :, None] * outer_row_effect(
        setup, h_W_m2K, static
    )[None, :, None, :]
    first = first.reshape(len(FIRST_HARMONIC), *change.shape[1:])
    constant = [
        known.second_K * outer_row_effect(setup, h_W_m2K, static, 2),
        angle_error_effect(setup, h_W_m2K, static, known.about_K),
    ]
    change = np.concatenate(
        [change, np.concatenate(constant)[:, None] * np.ones((1, *change.shape[1:]))]
    )
    of = (*of, *SECOND_HARMONIC, *(Unmeasured(f"angle {c}", ANGLE_SOURCE) for c in setup.rows))
    others = np.array([known.by_others.get(q, np.zeros(len(FIRST_HARMONIC))) for q in of])
    values, vectors = np.linalg.eigh(known.covariance - others.T @ others)
    root = (
        vectors * np.sqrt(np.clip(values, 0.0, None))
    ) @ vectors.T  # near the prior, the prior's own directions
    moved = change + np.tensordot(others, first, axes=1)
    return (*of, *FIRST_HARMONIC), np.concatenate([moved, np.tensordot(root, first, axes=1)])


def angle_error_effect(setup: DiskSetup, h_W_m2K: float, static: Array, about_K: Array) -> Array:
    """What the outer row shows more if one of the rows sits ``ANGLE_U_DEG`` further round the harmonic ``about_K``,
    (P + k, P)."""
    (cos, sin) = harmonic_at_junctions(setup, h_W_m2K, setup.rows)
    p = len(setup.outer)
    more = np.diag(np.deg2rad(ANGLE_U_DEG) * (about_K[1] * cos - about_K[0] * sin))
    return np.asarray(more[:, :p] - more[:, p:] @ static)


def window_harmonic_effects(
    setup: DiskSetup, h_W_m2K: float, static: Array, event: NDArray[np.str_], after_s: Array
) -> Array:
    """What both rows show more in windows by a prior's standard uncertainty of the harmonic, (6, W, P + k) [K].

    Of cos and sin: its level when steady, its fall after unloading, its rise after loading, ``after_s`` (W,) since the
    ``event`` (W,); the inner row's first seconds after an event are predicted without the bore.
    """
    whole = np.hstack([outer_row_effect(setup, h_W_m2K, static), harmonic_at_junctions(setup, h_W_m2K, setup.inner)])
    sizes = [
        (event == name) * size
        for name, size in (
            ("steady", SHAPES["level"]),
            ("unloading", SHAPES["fall"] * fall_fraction(after_s)),
            ("loading", 2 * SHAPES["level"] * fall_fraction(after_s)),
        )
    ]
    return np.array([size[:, None] * side for size in sizes for side in whole])


def harmonic_from_fit(
    theta: Array,
    covariance: Array,
    unknown: Sequence[tuple[Unmeasured, str]],
    disk: str,
    h_W_m2K: float,
    prior: Unevenness,
) -> Unevenness:
    """The harmonic of ``disk`` by a fit of what was ``unknown`` (Q), at ``theta`` (Q,) with ``covariance`` (Q, Q).

    With priors of unit variance the truth departs from what a fit found by covariance times what nobody measured
    departs from its statement, and by the noise.
    """
    rows = [unknown.index((what, disk)) for what in FIRST_HARMONIC]
    own = [k for k, (what, of) in enumerate(unknown) if of in ("", disk) and what not in FIRST_HARMONIC]
    by_others = {unknown[k][0]: covariance[rows, k] for k in own}
    return replace(
        prior,
        found=theta[rows],
        covariance=covariance[np.ix_(rows, rows)],
        by_others=by_others,
        h_W_m2K=h_W_m2K,
    )


def harmonic_K(known: Unevenness, setup: DiskSetup, since_s: Array) -> Array:
    """What the channels read more, (N, C), by the harmonic that was found, at times since the parting."""
    size_K = known.prior_K[:, None] * known.found.reshape(len(SHAPES), len(COMPONENTS))
    size_K[0] += known.stated_K
    second = known.stated_second_K @ harmonic_at_junctions(setup, known.h_W_m2K, setup.channels, 2)
    return np.asarray(
        time_shapes(since_s, known.span_s).T
        @ size_K
        @ harmonic_at_junctions(setup, known.h_W_m2K, setup.channels)
        + second
    )
