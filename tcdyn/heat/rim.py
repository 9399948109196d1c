"""The rim model: geometry and material (``Rim``), mesh, boundary conditions, and the basis of lags.

A record is filtered once by a basis of first-order lags (``lag_basis``); every output of every rim
is a weighted sum of the basis.

The fits of ``tcdyn.partition``, ``tcdyn.design.plans`` and all other modules of ``tcdyn.heat`` use
it. Geometry follows chapter 3 of the thesis; the constants below give the source of each threshold.
The basis is guarded by ``tests/heat/test_rim_bank.py``, meshes by
``tests/heat/test_rim_reference.py``, and the inner row by
``tests/partition/test_any_junctions.py``.
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
# Shape of the temperature along r = R_i, see ``modal.profile_basis``.
Profile = Literal["quadratic", "quartic", "modal"]
# Heat flux across the track, see ``modal.flux_density``; a function takes z from the centre [m].
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

# Fewest nodes of a mesh each way. The quintic splines of ``modal.reading_weights`` need six; the
# value was chosen by judgement.
MIN_NODES = 7


@dataclass(frozen=True)
class Mesh:
    """Numbers of nodes in r (R_i to running surface, both included) and z (face to face).

    The default is mesh IV of table 3.1. At least ``MIN_NODES`` each way.

    Parameters
    ----------
    nr
        Nodes in r.
    nz
        Nodes in z.

    Raises
    ------
    InputError
        Fewer than ``MIN_NODES`` in either direction.
    """

    nr: int = 65
    nz: int = 105

    def __post_init__(self) -> None:
        """Check the numbers of nodes."""
        if min(self.nr, self.nz) < MIN_NODES:
            raise InputError(
                f"Mesh: at least {MIN_NODES} nodes each way are needed; got {self.nr} x {self.nz}"
            )


# Mesh IV of table 3.1, the default of all functions.
MESH_IV = Mesh()
# The four meshes of the thesis (table 3.1), by name.
MESHES = {"I": Mesh(9, 13), "II": Mesh(17, 27), "III": Mesh(33, 53), "IV": MESH_IV}


@dataclass(frozen=True)
class Rim:
    """The rim ``R_i <= r <= R_o``, ``0 <= z <= w``, its material and its inner row of junctions.

    Parameters
    ----------
    inner_radius_m, outer_radius_m, width_m
        R_i, R_o and w [m].
    conductivity_W_mK, density_kg_m3, specific_heat_J_kgK
        Of the material [W/mK, kg/m3, J/kgK].
    washer_W_m2K
        Conductance K_c / w_c of the washers (section 3.4.4.3) [W/m2K].
    boundary_z_m
        Axial positions of the k junctions of the inner row, from one face [m].
    thickness_m, diffusivity_m2_s
        Computed: R_o - R_i [m] and alpha = K / (rho c) [m2/s].

    Raises
    ------
    InputError
        Radii, positions or material constants that are impossible.

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
        """Check the values, and compute the thickness and the diffusivity."""
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
        """The rim of a disk: all of it outside the inner row; ``changes`` replace any field.

        Parameters
        ----------
        setup
            The disk of the rig file.
        **changes
            Fields of ``Rim`` that replace those of the disk.

        Notes
        -----
        The inner radius is rounded to 1e-12 m, so that R_o - edge has no rounding error of the
        subtraction.
        """
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

    Parameters
    ----------
    z_m
        Axial positions of the junctions [m].
    width_m
        Width of the rim [m].

    Returns
    -------
    Indices n of the shapes; 0 is always one of them.

    Notes
    -----
    The first set of ``SHAPE_SETS`` that has no more shapes than readings and a condition number
    below ``MAX_SHAPE_CONDITION``. The order of ``SHAPE_SETS`` may be changed: it decides which
    shape is dropped first. ``tests/partition/test_any_junctions.py`` fits inner rows of fewer
    junctions.

    Examples
    --------
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
    """(depth, z) of named junctions [m].

    Parameters
    ----------
    setup
        The disk of the rig file.
    names
        Names of the junctions, e.g. "ace".

    Returns
    -------
    One point for each name, in the same sequence.
    """
    return tuple((setup.junctions[n].depth_m, setup.junctions[n].z_m) for n in names)


def correction_factor(half_width_m: float, nz: int, width_m: float) -> float:
    """Factor for point values of the parabola (3.32) that conserves the total heat (table 3.4).

    N = 2 round(b/dz) intervals lie across the track. The trapezoidal rule loses 1/N^2 of the
    parabola, so the factor is N^2/(N^2 - 1). The modal engine needs no factor: each cell gets its
    exact integral.

    Parameters
    ----------
    half_width_m
        Half-width b of the contact [m].
    nz
        Number of z nodes.
    width_m
        Width of the rim [m].

    Notes
    -----
    N = 2 round(b/dz) intervals lie across the track. The trapezoidal rule loses 1/N^2 of the
    parabola, so the factor is N^2/(N^2 - 1). The modal engine needs no factor: each cell gets its
    exact integral. Only ``tcdyn.verify`` uses it; ``tests/heat/test_rim_reference.py`` checks table
    3.4.

    Examples
    --------
    >>> [round(correction_factor(1.50e-3, nz, 9.53e-3), 4) for nz in (13, 27, 53, 105)]
    [1.0667, 1.0159, 1.0039, 1.001]
    """
    n = 2 * round(half_width_m / (width_m / (nz - 1)))
    return n**2 / (n**2 - 1)


@dataclass(frozen=True)
class InputJump:
    """A jump of a zero-order-hold input in ``[t_index, t_index+1)``.

    The input is ``before`` for ``fraction`` of the interval, then ``after``.

    Parameters
    ----------
    index
        Sample at the start of the interval.
    fraction
        Share of the interval before the jump, 0 to 1.
    before, after
        Input before and after the jump, in its unit.
    """

    index: int
    fraction: float
    before: float
    after: float


def log_nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev nodes (second kind) in the logarithm, for ``lag_weights``.

    Parameters
    ----------
    low, high
        Logarithms of the lowest and the highest node.
    count
        Number of nodes.

    Returns
    -------
    Nodes, (count,), ascending from e^low to e^high.

    Notes
    -----
    ``_chebyshev_nodes`` has the weights that belong to these nodes; change both together.
    ``tests/heat/test_rim_bank.py`` fails otherwise.
    """
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

    Returns
    -------
    Rates, (K,) [1/s], ascending, Chebyshev nodes in the logarithm.

    Raises
    ------
    InputError
        ``dt_s`` is not positive.

    Notes
    -----
    The highest rate, 40/dt, is a lag of a fortieth of a sample interval (chosen by judgement). More
    rates are more exact and slower. A lower ``slowest_per_s`` at the same ``count`` is less exact;
    the rim's slowest mode must lie above it, otherwise ``tcdyn.heat.modal.rim_gains`` raises.

    Examples
    --------
    >>> basis_rates(1 / 75)[[0, -1]].round(6)
    array([3.e-01, 3.e+03])
    """
    if not dt_s > 0:
        raise InputError(f"basis_rates: dt_s must be positive; got {dt_s}")
    longest_lag_s = max(1 / slowest_per_s, longest_s)
    return log_nodes(-float(np.log(longest_lag_s)), float(np.log(40.0 / dt_s)), count)


@lru_cache(maxsize=16)
def _chebyshev_nodes(count: int) -> tuple[Array, Array, Array]:
    """Barycentric interpolation on Chebyshev nodes of the second kind; cached.

    Parameters
    ----------
    count
        Number of nodes n.

    Returns
    -------
    x
        Nodes on [-1, 1], (n,), ascending.
    weights
        Barycentric weights, (n,).
    d
        Differentiation matrix D, (n, n): l_k' = sum_j l_j D_jk for the cardinal functions l.
    """
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
        Rates of the basis, (K,), from ``basis_rates`` or ``log_nodes``.
    log_lambda
        Logarithms of the rates of the wanted lags, (M,), within the range of the basis.

    Returns
    -------
    Weights, (M, K).

    Notes
    -----
    Barycentric interpolation in log(rate): exp(-e^x t) is entire in x, so 40 nodes over four
    decades have an error of 1e-6.

    Outside the range of the basis this is extrapolation, with large errors; callers limit the rates
    first. ``tests/heat/test_rim_bank.py`` checks the error.
    """
    weights, total = unscaled_cardinal(rates_per_s, log_lambda)
    return weights / total[:, None]


def unscaled_cardinal(rates_per_s: Array, log_lambda: Array) -> tuple[Array, Array]:
    """The weights of ``lag_weights`` before the division by their sums, and the sums.

    For large M it is faster to divide the values that the weights multiply.

    Parameters
    ----------
    rates_per_s
        Rates of the basis, (K,) [1/s].
    log_lambda
        Logarithms of the rates of the wanted lags, (M,).

    Returns
    -------
    weights
        Weights, (M, K).
    total
        Their sums, (M,).
    """
    x, node_weights, _ = _chebyshev_nodes(len(rates_per_s))
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
    """Derivative of ``lag_weights`` with respect to log lambda.

    Parameters
    ----------
    rates_per_s
        Rates of the basis, (K,) [1/s].
    weights
        Weights that ``lag_weights`` returned, (M, K).

    Returns
    -------
    Derivatives, (M, K).
    """
    d = _chebyshev_nodes(len(rates_per_s))[2]
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

    Returns
    -------
    Responses, (N, K), in the unit of the input.

    Raises
    ------
    InputError
        An input that is no row of finite numbers, or a jump outside the record.

    Notes
    -----
    ``jumps`` change nothing with ``hold`` "foh". The recursion is exact for the stated hold, so any
    other method must agree to rounding: ``tests/heat/test_rim_bank.py``.

    Examples
    --------
    >>> lag_basis([0.0, 0.0, 1.0, 1.0], 1.0, np.array([2.0]), "zoh").round(4).ravel()
    array([0.    , 0.    , 0.    , 0.8647])
    """
    u = np.asarray(u, dtype=float)
    if u.ndim != 1 or not len(u) or not np.isfinite(u).all():
        raise InputError(f"lag_basis: u must be a row of finite numbers; got shape {u.shape}")
    start = np.full(len(rates), u[0]) if initial is None else np.asarray(initial, dtype=float)
    out = np.empty((len(rates), len(u)))
    full_rise = -np.expm1(-rates * dt_s)
    corrections = []  # difference of a jump inside an interval from the plain hold
    for s in jumps:
        if not (0 <= s.index < len(u) - 1 and 0 <= s.fraction <= 1):
            raise InputError(f"lag_basis: {s} lies outside a record of {len(u)} samples")
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
    """Means of ``lag_basis(u, dt_s, rates)`` over blocks of samples at the end of the record.

    Only the means are computed, not the responses.

    Parameters
    ----------
    u
        Input, (N,), sampled every ``dt_s``; linear between samples.
    dt_s
        Sample interval [s].
    rates
        Rates of the lags, (K,) [1/s].
    counts
        Lengths of the R consecutive blocks, which end with the record [samples].

    Returns
    -------
    Means, (R, K), in the unit of the input.

    Notes
    -----
    The states at the starts of the blocks follow from one block to the next. Summing x_(n+1) = d
    x_n + r (u_(n+1) - u_n) + (1 - d) u_n over a block gives its mean from the states at its two
    ends.

    It must agree with ``lag_basis`` for "foh" and an equilibrium start;
    ``tests/heat/test_rim_bank.py`` checks that.

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
    """Response of lags after one interval to a unit step and to a unit ramp.

    Parameters
    ----------
    x
        Rate times sample interval.

    Returns
    -------
    rise
        Response to a unit step, 1 - exp(-x).
    ramp
        Response to a ramp from 0 to 1 over the interval, 1 - rise/x.

    Notes
    -----
    Below x = 1e-4 the ramp uses its series x/2 - x^2/6, because the difference would lose digits.
    """
    rise = -np.expm1(-x)
    with np.errstate(divide="ignore", invalid="ignore"):
        return rise, np.where(x > 1e-4, 1 - rise / x, x / 2 - x * x / 6)


@lru_cache(maxsize=64)
def _block_response(length: int, dt_s: float, rates: bytes) -> Array:
    """Contribution of the samples of a block to the states at its end; cached.

    Parameters
    ----------
    length
        Intervals of the block.
    dt_s
        Sample interval [s].
    rates
        Rates of the lags, (K,) floats as bytes, so that the cache can hash them.

    Returns
    -------
    Weights of the samples, (length + 1, K), read-only.
    """
    x = np.frombuffer(rates) * dt_s
    rise, ramp = hold_weights(x)
    decay = np.exp(-x * np.arange(length - 1, -1, -1)[:, None])
    weights = np.zeros((length + 1, len(x)))
    weights[1:] = ramp * decay
    weights[:-1] += (rise - ramp) * decay
    weights.setflags(write=False)
    return weights
