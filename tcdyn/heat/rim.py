"""What the rim model is made of: geometry and steel (``Rim``), nodes (``Mesh``), what is imposed on its borders, and
the bank of lags that a record is filtered by once: every rim's output is a weighted sum of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dtbtrs
from scipy.signal import lfilter

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.flux import TrackFlux
from tcdyn.rig.disk import DiskSetup

Point = tuple[float, float]  # (depth below the running surface, z from one face), both in m
Profile = Literal["quadratic", "quartic", "modal"]
Flux = Literal["hertz", "uniform"] | TrackFlux | Callable[[Array], Array]
MAX_LENGTH_M = 10.0
SLOWEST_PER_S = 0.3  # below the slowest mode of a 6 mm rim of steel (0.7 1/s)
NODES = 40  # of the bank
SHAPES_TOLD = (
    (0, 1, 2),
    (0, 2),
    (0, 1),
    (0,),
)  # of the three along R_i: the most that an inner row tells apart
WORST_TOLD = 15.0  # condition of its readings; 1.4 of d, b, f


@dataclass(frozen=True)
class Mesh:
    """Nodes in r (R_i to running surface, both counted) and z (face to face); default: mesh IV of table 3.1."""

    nr: int = 65
    nz: int = 105

    def __post_init__(self) -> None:
        if self.nr < 7 or self.nz < 7:
            raise InputError(
                f"Mesh: at least 7 nodes each way are needed; got {self.nr} x {self.nz}"
            )


MESH_IV = Mesh()
MESHES = {
    "I": Mesh(9, 13),
    "II": Mesh(17, 27),
    "III": Mesh(33, 53),
    "IV": MESH_IV,
}  # the thesis's four


@dataclass(frozen=True)
class Rim:
    """The rim ``R_i <= r <= R_o``, ``0 <= z <= w``, its steel, and where along z the junctions of the inner row sit.

    ``washer_W_m2K`` is K_c / w_c, the washers' conductance (section 3.4.4.3); ``thickness_m`` R_o - R_i and
    ``diffusivity_m2_s`` alpha = K / (rho c) follow.

    >>> from tcdyn.rig.rigfile import load_rig
    >>> Rim.from_setup(load_rig().disk_setup("fast")).inner_radius_m
    0.0321
    """

    inner_radius_m: float
    outer_radius_m: float
    width_m: float
    conductivity_W_mK: float
    density_kg_m3: float
    specific_heat_J_kgK: float
    washer_W_m2K: float
    boundary_z_m: tuple[float, ...]
    thickness_m: float = field(init=False)
    diffusivity_m2_s: float = field(init=False)

    def __post_init__(self) -> None:
        if not 0 <= self.inner_radius_m < self.outer_radius_m <= MAX_LENGTH_M:
            raise InputError(
                f"Rim: the inner radius {self.inner_radius_m} m must be below the outer {self.outer_radius_m} m"
            )
        if (
            not self.boundary_z_m
            or not 0 <= min(self.boundary_z_m) <= max(self.boundary_z_m) <= self.width_m
        ):
            raise InputError(
                f"Rim: the inner row must lie within the width {self.width_m} m; got {self.boundary_z_m}"
            )
        for name in ("conductivity_W_mK", "density_kg_m3", "specific_heat_J_kgK"):
            if not getattr(self, name) > 0:
                raise InputError(f"Rim: {name} must be positive; got {getattr(self, name)}")
        if self.washer_W_m2K < 0:
            raise InputError(f"Rim: washer_W_m2K must not be negative; got {self.washer_W_m2K}")
        heat = self.density_kg_m3 * self.specific_heat_J_kgK
        object.__setattr__(self, "thickness_m", self.outer_radius_m - self.inner_radius_m)
        object.__setattr__(self, "diffusivity_m2_s", self.conductivity_W_mK / heat)

    @property
    def unseen_z_m(self) -> float | None:
        """Where a further junction would tell what the inner row leaves open along z; None where it tells all [m]."""
        w = self.width_m
        at = np.array(self.boundary_z_m)
        if len(told_by(self.boundary_z_m, w)) == 3:
            return None
        return float(max((0.5 * w, *(w - at)), key=lambda z: np.abs(at - z).min()))

    @classmethod
    def from_setup(cls, setup: DiskSetup, **changes: Any) -> Rim:
        """The rim of a disk: everything outside its inner row; ``changes`` override any field."""
        fields: dict[str, Any] = {
            "inner_radius_m": round(setup.outer_radius_m - setup.edge_m, 12),
            "outer_radius_m": setup.outer_radius_m,
            "width_m": setup.width_m,
            "conductivity_W_mK": setup.conductivity_W_mK,
            "density_kg_m3": setup.density_kg_m3,
            "specific_heat_J_kgK": setup.specific_heat_J_kgK,
            "washer_W_m2K": setup.washer_conductivity_W_mK / setup.washer_thickness_m,
            "boundary_z_m": tuple(setup.junctions[c].z_m for c in setup.inner),
        }
        return cls(**{**fields, **changes})


def told_by(at_m: tuple[float, ...], width_m: float) -> tuple[int, ...]:
    """Which of the slab's three lowest shapes, cos(n pi z/w), the readings at these places tell apart.

    >>> [told_by(z, 9.53) for z in ((2.0, 4.765, 7.53), (2.0, 4.765), (2.0, 7.53), (4.0, 4.0))]
    [(0, 1, 2), (0, 2), (0, 1), (0,)]
    """
    seen = np.cos(np.pi / width_m * np.outer(at_m, range(3)))
    return next(
        s for s in SHAPES_TOLD if len(s) <= len(seen) and np.linalg.cond(seen[:, s]) < WORST_TOLD
    )


def points_of(setup: DiskSetup, names: Iterable[str]) -> tuple[Point, ...]:
    """(depth, z) of the named junctions, e.g. ``points_of(setup, "ace")`` [m]."""
    return tuple((setup.junctions[n].depth_m, setup.junctions[n].z_m) for n in names)


def correction_factor(half_width_m: float, nz: int, width_m: float) -> float:
    """Factor by which point values of the parabola (3.32) must be raised to carry the whole heat (table 3.4).

    N = 2 round(b/dz) intervals lie across the track; the trapezoidal rule then loses 1/N^2 of the parabola, so the
    factor is N^2/(N^2 - 1). The engine needs none: it gives every cell its exact integral.

    >>> [round(correction_factor(1.50e-3, nz, 9.53e-3), 4) for nz in (13, 27, 53, 105)]
    [1.0667, 1.0159, 1.0039, 1.001]
    """
    n = 2 * round(half_width_m / (width_m / (nz - 1)))
    return n**2 / (n**2 - 1)


@dataclass(frozen=True)
class Switch:
    """A held input that jumps in ``[t_index, t_index+1)``: ``before`` for ``fraction`` of it, then ``after``."""

    index: int
    fraction: float
    before: float
    after: float


def log_nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev nodes (second kind) in the logarithm, e^``low`` to e^``high`` ascending, as ``cardinal`` takes them."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray(np.exp(low + (high - low) * (x + 1) / 2))


def node_rates(
    dt_s: float, count: int = NODES, slowest_per_s: float = SLOWEST_PER_S, longest_s: float = 0.0
) -> Array:
    """Rates of the bank: nodes from ``slowest_per_s``, or that of a lag of ``longest_s``, to 40/dt, (K,) [1/s].

    >>> node_rates(1 / 75)[[0, -1]].round(6)
    array([3.e-01, 3.e+03])
    """
    if not dt_s > 0:
        raise InputError(f"node_rates: dt_s must be positive; got {dt_s}")
    return log_nodes(
        -float(np.log(max(1 / slowest_per_s, longest_s))), float(np.log(40.0 / dt_s)), count
    )


@lru_cache(maxsize=16)
def _barycentric(count: int) -> tuple[Array, Array, Array]:
    """Nodes on [-1, 1], barycentric weights and the differentiation matrix D (l_k' = sum_j l_j D_jk)."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    w: Array = np.where(np.arange(count) % 2, -1.0, 1.0)
    w[[0, -1]] /= 2
    gap = x[:, None] - x[None, :] + np.eye(count)
    d = (w[None, :] / w[:, None]) / gap
    np.fill_diagonal(d, 0.0)
    np.fill_diagonal(d, -d.sum(axis=1))
    return x, w, np.asarray(d)


def cardinal(rates_per_s: Array, log_lambda: Array) -> Array:
    """Weights (M, K) of the bank's lags that make up lags of log-rates ``log_lambda`` (M,); rows sum to one.

    Barycentric interpolation in log(rate): exp(-e^x t) is entire in x, so 40 nodes over four decades leave 1e-6.
    """
    weights, total = unscaled_cardinal(rates_per_s, log_lambda)
    return np.asarray(weights / total[:, None])


def unscaled_cardinal(rates_per_s: Array, log_lambda: Array) -> tuple[Array, Array]:
    """The weights (M, K) of ``cardinal`` before they are divided by (M,): for many M rather divide what they weigh."""
    x, w, _ = _barycentric(len(rates_per_s))
    low, high = np.log(rates_per_s[[0, -1]])
    scaled = (2 * log_lambda - low - high) / (high - low)
    weights = scaled[:, None] - x
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(w, weights, out=weights)
        total = weights @ np.ones(len(x))
    for row in np.flatnonzero(~np.isfinite(total)):  # exactly on a node
        weights[row] = np.arange(len(x)) == np.argmin(np.abs(scaled[row] - x))
        total[row] = 1.0
    return weights, total


def cardinal_slope(rates_per_s: Array, weights: Array) -> Array:
    """d(weights)/d(log lambda) for the ``weights`` (M, K) that ``cardinal`` returned."""
    d = _barycentric(len(rates_per_s))[2]
    return np.asarray(weights @ d * (2 / np.log(rates_per_s[-1] / rates_per_s[0])))


def lag_bank(
    u: ArrayLike,
    dt_s: float,
    rates: Array,
    hold: Literal["foh", "zoh"] = "foh",
    switches: Sequence[Switch] = (),
    initial: Array | None = None,
) -> Array:
    """Exact response (N, K) of the lags 1/(1 + s/rate_k) to ``u`` (N,) sampled every ``dt_s``.

    Between samples ``u`` is a straight line ("foh") or held at its earlier sample ("zoh"), where ``switches`` say
    when inside a sample a held input jumps. ``initial``: the K states at the first sample, by default in
    equilibrium with it. The state at sample k knows nothing of what a held input does from then on.

    >>> lag_bank([0.0, 0.0, 1.0, 1.0], 1.0, np.array([2.0]), "zoh").round(4).ravel()
    array([0.    , 0.    , 0.    , 0.8647])
    """
    u = np.asarray(u, dtype=float)
    if u.ndim != 1 or not len(u) or not np.isfinite(u).all():
        raise InputError(f"lag_bank: u must be a row of finite numbers; got shape {u.shape}")
    start = np.full(len(rates), u[0]) if initial is None else np.asarray(initial, dtype=float)
    out = np.empty((len(rates), len(u)))
    whole = -np.expm1(-rates * dt_s)
    extra = []  # what a jump inside a sample adds to the plain hold
    for s in switches:
        if not (0 <= s.index < len(u) - 1 and 0 <= s.fraction <= 1):
            raise InputError(f"lag_bank: {s} lies outside a record of {len(u)} samples")
        late = -np.expm1(-rates * dt_s * (1 - s.fraction))
        extra.append(s.before * (whole - late) + s.after * late - u[s.index] * whole)
    rises, ramps = hold_weights(rates * dt_s)
    for k, (decay, rise, ramp) in enumerate(zip(np.exp(-rates * dt_s), rises, ramps)):
        if hold == "foh":
            drive = ramp * u[1:] + (rise - ramp) * u[:-1]
        else:
            drive = rise * u[:-1]
            for s, add in zip(switches, extra):
                drive[s.index] += add[k]
        out[k] = lfilter([1.0], [1.0, -decay], np.append(start[k], drive))
    return out.T


def bank_means(
    u: ArrayLike, dt_s: float, rates: Array, counts: Sequence[int] | NDArray[np.int64]
) -> Array:
    """Means (R, K) of ``lag_bank(u, dt_s, rates)`` over the record's last sum(counts) samples, in blocks of ``counts``
    (R,) samples one after the other; nothing else of the bank is worked out.

    The states where blocks begin follow from one to the next; summing x_(n+1) = d x_n + r (u_(n+1) - u_n) + (1 - d) u_n
    over a block gives its mean from the states at its two ends.

    >>> u = np.array([0.0, 1.0, 4.0, 2.0, 2.0])
    >>> np.allclose(bank_means(u, 0.1, np.array([2.0]), [1, 2]), [[lag_bank(u, 0.1, np.array([2.0]))[2, 0]],
    ...     [lag_bank(u, 0.1, np.array([2.0]))[3:, 0].mean()]])
    True
    """
    u = np.asarray(u, dtype=float)
    lengths = np.array([len(u) - int(np.sum(counts)), *counts])
    at = np.cumsum(lengths) - lengths
    u = np.append(u, u[-1])
    rise, ramp = hold_weights(rates * dt_s)
    driven, decay = np.empty((2, len(lengths) + 1, len(rates)))
    driven[0] = u[0]
    decay[0] = 0.0
    for m in np.unique(lengths).tolist():
        same = np.flatnonzero(lengths == m)
        driven[same + 1] = u[at[same, None] + np.arange(m + 1)] @ _driving(m, dt_s, rates.tobytes())
        decay[same + 1] = np.exp(-rates * dt_s * m)
    band = np.ones(
        (driven.size, 2)
    ).T  # states[k + 1] - decay[k] states[k] = driven[k], rate after rate
    band[1, :-1] = -decay.T.ravel()[1:]
    states = dtbtrs(band, driven.T.reshape(-1, 1), uplo="L", diag="U")[0].reshape(len(rates), -1).T
    whole = np.add.reduceat(u[:-1], at[1:])[:, None]
    ends = (
        states[1:-1] - states[2:] + ramp * (u[np.append(at[2:], len(u) - 1)] - u[at[1:]])[:, None]
    )
    return np.asarray((whole + ends / rise) / lengths[1:, None])


def hold_weights(x: Array) -> tuple[Array, Array]:
    """Shares of a step that lags of ``x`` = rate dt take up within a sample: of one held, and of a ramp to it."""
    rise = -np.expm1(-x)
    with np.errstate(divide="ignore", invalid="ignore"):
        return rise, np.where(x > 1e-4, 1 - rise / x, x / 2 - x * x / 6)


@lru_cache(maxsize=64)
def _driving(m: int, dt_s: float, rates: bytes) -> Array:
    """What samples 0 to ``m`` of a block add to the states at its end, (m + 1, K)."""
    x = np.frombuffer(rates) * dt_s
    rise, ramp = hold_weights(x)
    left = np.exp(-x * np.arange(m - 1, -1, -1)[:, None])
    weights = np.zeros((m + 1, len(x)))
    weights[1:] = ramp * left
    weights[:-1] += (rise - ramp) * left
    weights.setflags(write=False)
    return weights
