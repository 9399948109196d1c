"""The rim model: geometry and material (``Rim``), mesh, boundary conditions, and the basis of lags.

A record is filtered once by a basis of first-order lags (``lag_basis``); every output of every rim
is a weighted sum of the basis.
"""

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
# Largest radius [m]; a larger one is in another unit.
MAX_RADIUS_M = 10.0
# Slowest rate of the basis [1/s], below the slowest mode of a 6 mm rim of steel (0.7 1/s).
SLOWEST_PER_S = 0.3
# Number of lags in the basis: over four decades of rates the error is 1e-6.
N_LAGS = 40
# Axial shapes, of the three along R_i, that an inner row may determine, most first.
SHAPE_SETS = ((0, 1, 2), (0, 2), (0, 1), (0,))
# Largest condition number of the readings of these shapes; 1.4 for b, d and f. Chosen by judgement.
MAX_SHAPE_CONDITION = 15.0


MIN_NODES = 7  # each way; chosen by judgement


@dataclass(frozen=True)
class Mesh:
    """Numbers of nodes in r (R_i to running surface, both included) and z (face to face).

    The default is mesh IV of table 3.1. At least ``MIN_NODES`` each way.
    """

    nr: int = 65
    nz: int = 105

    def __post_init__(self) -> None:
        if min(self.nr, self.nz) < MIN_NODES:
            raise InputError(
                f"Mesh: at least {MIN_NODES} nodes each way are needed; got {self.nr} x {self.nz}"
            )


MESH_IV = Mesh()
# the four meshes of the thesis
MESHES = {"I": Mesh(9, 13), "II": Mesh(17, 27), "III": Mesh(33, 53), "IV": MESH_IV}


@dataclass(frozen=True)
class Rim:
    """The rim ``R_i <= r <= R_o``, ``0 <= z <= w``, its material and its inner row of junctions.

    Parameters
    ----------
    inner_radius_m, outer_radius_m, width_m
        R_i, R_o and w [m].
    conductivity_W_mK, density_kg_m3, specific_heat_J_kgK
        Of the material.
    washer_W_m2K
        Conductance K_c / w_c of the washers (section 3.4.4.3).
    boundary_z_m
        Axial positions of the junctions of the inner row.
    thickness_m, diffusivity_m2_s
        Computed: R_o - R_i and alpha = K / (rho c).

    Examples
    --------
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
        if not 0 <= self.inner_radius_m < self.outer_radius_m <= MAX_RADIUS_M:
            raise InputError(
                f"Rim: the inner radius {self.inner_radius_m} m must be below the outer "
                f"{self.outer_radius_m} m"
            )
        z = self.boundary_z_m
        if not z or not 0 <= min(z) <= max(z) <= self.width_m:
            raise InputError(
                f"Rim: the inner row must lie within the width {self.width_m} m; got {z}"
            )
        for name in ("conductivity_W_mK", "density_kg_m3", "specific_heat_J_kgK"):
            if not getattr(self, name) > 0:
                raise InputError(f"Rim: {name} must be positive; got {getattr(self, name)}")
        if self.washer_W_m2K < 0:
            raise InputError(f"Rim: washer_W_m2K must not be negative; got {self.washer_W_m2K}")
        heat_capacity = self.density_kg_m3 * self.specific_heat_J_kgK
        object.__setattr__(self, "thickness_m", self.outer_radius_m - self.inner_radius_m)
        object.__setattr__(self, "diffusivity_m2_s", self.conductivity_W_mK / heat_capacity)

    @property
    def undetermined_z_m(self) -> float | None:
        """Axial position [m] of a further junction with which the inner row determines all shapes.

        None where the inner row determines them all.
        """
        z = np.array(self.boundary_z_m)
        if len(determined_shapes(self.boundary_z_m, self.width_m)) == 3:
            return None
        candidates = (0.5 * self.width_m, *(self.width_m - z))
        return float(max(candidates, key=lambda candidate: np.abs(z - candidate).min()))

    @classmethod
    def from_setup(cls, setup: DiskSetup, **changes: Any) -> Rim:
        """The rim of a disk: all of it outside the inner row; ``changes`` replace any field."""
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


def determined_shapes(z_m: tuple[float, ...], width_m: float) -> tuple[int, ...]:
    """Which of the three lowest shapes of the slab, cos(n pi z/w), readings at ``z_m`` determine.

    >>> rows = ((2.0, 4.765, 7.53), (2.0, 4.765), (2.0, 7.53), (4.0, 4.0))
    >>> [determined_shapes(z_m, 9.53) for z_m in rows]
    [(0, 1, 2), (0, 2), (0, 1), (0,)]
    """
    readings = np.cos(np.pi / width_m * np.outer(z_m, range(3)))
    return next(
        shapes
        for shapes in SHAPE_SETS
        if len(shapes) <= len(readings)
        and np.linalg.cond(readings[:, shapes]) < MAX_SHAPE_CONDITION
    )


def junction_points(setup: DiskSetup, names: Iterable[str]) -> tuple[Point, ...]:
    """(depth, z) of the named junctions, e.g. ``junction_points(setup, "ace")`` [m]."""
    return tuple((setup.junctions[n].depth_m, setup.junctions[n].z_m) for n in names)


def correction_factor(half_width_m: float, nz: int, width_m: float) -> float:
    """Factor for point values of the parabola (3.32) that conserves the total heat (table 3.4).

    N = 2 round(b/dz) intervals lie across the track. The trapezoidal rule loses 1/N^2 of the
    parabola, so the factor is N^2/(N^2 - 1). The modal engine needs no factor: each cell gets its
    exact integral.

    >>> [round(correction_factor(1.50e-3, nz, 9.53e-3), 4) for nz in (13, 27, 53, 105)]
    [1.0667, 1.0159, 1.0039, 1.001]
    """
    n = 2 * round(half_width_m / (width_m / (nz - 1)))
    return n**2 / (n**2 - 1)


@dataclass(frozen=True)
class InputJump:
    """A jump of a zero-order-hold input in ``[t_index, t_index+1)``.

    The input is ``before`` for ``fraction`` of the interval, then ``after``.
    """

    index: int
    fraction: float
    before: float
    after: float


def log_nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev nodes (second kind) in the logarithm, from e^low to e^high, for ``lag_weights``."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    return np.exp(low + (high - low) * (x + 1) / 2)


def basis_rates(
    dt_s: float, count: int = N_LAGS, slowest_per_s: float = SLOWEST_PER_S, longest_s: float = 0.0
) -> Array:
    """Rates of the basis of lags, (K,) [1/s], up to 40/dt.

    Parameters
    ----------
    dt_s
        Sample interval [s].
    count
        Number of rates K.
    slowest_per_s
        Lowest rate [1/s].
    longest_s
        Longest lag [s], if the lowest rate must be below its rate.

    Examples
    --------
    >>> basis_rates(1 / 75)[[0, -1]].round(6)
    array([3.e-01, 3.e+03])
    """
    if not dt_s > 0:
        raise InputError(f"node_rates: dt_s must be positive; got {dt_s}")
    longest_lag_s = max(1 / slowest_per_s, longest_s)
    return log_nodes(-float(np.log(longest_lag_s)), float(np.log(40.0 / dt_s)), count)


@lru_cache(maxsize=16)
def _barycentric(count: int) -> tuple[Array, Array, Array]:
    """Nodes on [-1, 1], barycentric weights, differentiation matrix D (l_k' = sum_j l_j D_jk)."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    weights: Array = np.where(np.arange(count) % 2, -1.0, 1.0)
    weights[[0, -1]] /= 2
    gap = x[:, None] - x[None, :] + np.eye(count)
    d = (weights[None, :] / weights[:, None]) / gap
    np.fill_diagonal(d, 0.0)
    np.fill_diagonal(d, -d.sum(axis=1))
    return x, weights, np.asarray(d)


def lag_weights(rates_per_s: Array, log_lambda: Array) -> Array:
    """Weights of the basis that interpolate other lags, (M, K); each row sums to one.

    Parameters
    ----------
    rates_per_s
        Rates of the basis, (K,).
    log_lambda
        Logarithms of the rates of the wanted lags, (M,).

    Notes
    -----
    Barycentric interpolation in log(rate): exp(-e^x t) is entire in x, so 40 nodes over four
    decades have an error of 1e-6.
    """
    weights, total = unscaled_cardinal(rates_per_s, log_lambda)
    return weights / total[:, None]


def unscaled_cardinal(rates_per_s: Array, log_lambda: Array) -> tuple[Array, Array]:
    """The weights (M, K) of ``lag_weights`` before the division by their sums, and the sums (M,).

    For large M it is faster to divide the values that the weights multiply.
    """
    x, node_weights, _ = _barycentric(len(rates_per_s))
    low, high = np.log(rates_per_s[[0, -1]])
    scaled = (2 * log_lambda - low - high) / (high - low)
    weights = scaled[:, None] - x
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(node_weights, weights, out=weights)
        total = weights @ np.ones(len(x))
    for row in np.flatnonzero(~np.isfinite(total)):  # exactly on a node
        weights[row] = np.arange(len(x)) == np.argmin(np.abs(scaled[row] - x))
        total[row] = 1.0
    return weights, total


def lag_weights_slope(rates_per_s: Array, weights: Array) -> Array:
    """d(weights)/d(log lambda) for the ``weights`` (M, K) that ``lag_weights`` returned."""
    d = _barycentric(len(rates_per_s))[2]
    return weights @ d * (2 / np.log(rates_per_s[-1] / rates_per_s[0]))


def lag_basis(
    u: ArrayLike,
    dt_s: float,
    rates: Array,
    hold: Literal["foh", "zoh"] = "foh",
    jumps: Sequence[InputJump] = (),
    initial: Array | None = None,
) -> Array:
    """Exact response (N, K) of the lags 1/(1 + s/rate_k) to an input.

    Parameters
    ----------
    u
        Input, (N,), sampled every ``dt_s``.
    dt_s
        Sample interval [s].
    rates
        Rates of the lags, (K,) [1/s].
    hold
        Between samples the input is linear ("foh", first-order hold) or equal to the earlier sample
        ("zoh", zero-order hold).
    jumps
        Jumps of a zero-order-hold input inside a sample interval.
    initial
        States at the first sample, (K,); by default in equilibrium with it. The state at sample k
        does not depend on a zero-order-hold input from there on.

    Examples
    --------
    >>> lag_basis([0.0, 0.0, 1.0, 1.0], 1.0, np.array([2.0]), "zoh").round(4).ravel()
    array([0.    , 0.    , 0.    , 0.8647])
    """
    u = np.asarray(u, dtype=float)
    if u.ndim != 1 or not len(u) or not np.isfinite(u).all():
        raise InputError(f"lag_bank: u must be a row of finite numbers; got shape {u.shape}")
    start = np.full(len(rates), u[0]) if initial is None else np.asarray(initial, dtype=float)
    out = np.empty((len(rates), len(u)))
    full_rise = -np.expm1(-rates * dt_s)
    corrections = []  # difference of a jump inside an interval from the plain hold
    for s in jumps:
        if not (0 <= s.index < len(u) - 1 and 0 <= s.fraction <= 1):
            raise InputError(f"lag_bank: {s} lies outside a record of {len(u)} samples")
        rise_after = -np.expm1(-rates * dt_s * (1 - s.fraction))
        response = s.before * (full_rise - rise_after) + s.after * rise_after
        corrections.append(response - u[s.index] * full_rise)
    rises, ramps = hold_weights(rates * dt_s)
    for k, (decay, rise, ramp) in enumerate(zip(np.exp(-rates * dt_s), rises, ramps)):
        if hold == "foh":
            drive = ramp * u[1:] + (rise - ramp) * u[:-1]
        else:
            drive = rise * u[:-1]
            for s, correction in zip(jumps, corrections):
                drive[s.index] += correction[k]
        out[k] = lfilter([1.0], [1.0, -decay], np.append(start[k], drive))
    return out.T


def lag_basis_means(
    u: ArrayLike, dt_s: float, rates: Array, counts: Sequence[int] | NDArray[np.int64]
) -> Array:
    """Means (R, K) of ``lag_basis(u, dt_s, rates)`` over blocks of samples at the end of the record.

    Only the means are computed, not the responses.

    Parameters
    ----------
    counts
        Lengths of the R consecutive blocks, which end with the record.

    Notes
    -----
    The states at the starts of the blocks follow from one block to the next. Summing x_(n+1) = d
    x_n + r (u_(n+1) - u_n) + (1 - d) u_n over a block gives its mean from the states at its two
    ends.

    Examples
    --------
    >>> u = np.array([0.0, 1.0, 4.0, 2.0, 2.0])
    >>> rates = np.array([2.0])
    >>> x = lag_basis(u, 0.1, rates)
    >>> np.allclose(lag_basis_means(u, 0.1, rates, [1, 2]), [[x[2, 0]], [x[3:, 0].mean()]])
    True
    """
    u = np.asarray(u, dtype=float)
    lengths = np.array([len(u) - int(np.sum(counts)), *counts])
    starts = np.cumsum(lengths) - lengths
    u = np.append(u, u[-1])
    rise, ramp = hold_weights(rates * dt_s)
    driven, decay = np.empty((2, len(lengths) + 1, len(rates)))
    driven[0] = u[0]
    decay[0] = 0.0
    for length in np.unique(lengths).tolist():
        blocks = np.flatnonzero(lengths == length)
        inputs = u[starts[blocks, None] + np.arange(length + 1)]
        driven[blocks + 1] = inputs @ _block_response(length, dt_s, rates.tobytes())
        decay[blocks + 1] = np.exp(-rates * dt_s * length)
    # bidiagonal system states[k + 1] - decay[k] states[k] = driven[k], one rate after another
    band = np.ones((driven.size, 2)).T
    band[1, :-1] = -decay.T.ravel()[1:]
    solution = dtbtrs(band, driven.T.reshape(-1, 1), uplo="L", diag="U")[0]
    states = solution.reshape(len(rates), -1).T
    input_sums = np.add.reduceat(u[:-1], starts[1:])[:, None]
    block_ends = np.append(starts[2:], len(u) - 1)
    input_change = (u[block_ends] - u[starts[1:]])[:, None]
    end_terms = states[1:-1] - states[2:] + ramp * input_change
    return (input_sums + end_terms / rise) / lengths[1:, None]


def hold_weights(x: Array) -> tuple[Array, Array]:
    """Response of lags of ``x`` = rate dt after one interval, to a unit step and a unit ramp."""
    rise = -np.expm1(-x)
    with np.errstate(divide="ignore", invalid="ignore"):
        return rise, np.where(x > 1e-4, 1 - rise / x, x / 2 - x * x / 6)


@lru_cache(maxsize=64)
def _block_response(length: int, dt_s: float, rates: bytes) -> Array:
    """Contribution of the samples of a block to the states at its end, (length + 1, K)."""
    x = np.frombuffer(rates) * dt_s
    rise, ramp = hold_weights(x)
    decay = np.exp(-x * np.arange(length - 1, -1, -1)[:, None])
    weights = np.zeros((length + 1, len(x)))
    weights[1:] = ramp * decay
    weights[:-1] += (rise - ramp) * decay
    weights.setflags(write=False)
    return weights
