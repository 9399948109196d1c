"""Block means of a disk's readings over a window of a test, and its rim model in the same blocks.

The rim forgets in some seconds (its slowest mode decays at about 1 1/s), so nothing before the last
minutes under load matters, and one filter bank over the window serves every heat transfer
coefficient, share and material. Steady lines, cooling fit, joint fit, sensor check, model-form
alternatives and :mod:`tcdyn.campaign` use it. The steady window of 150 s is that of section 4.3;
all other lengths are chosen by judgement. Guarded by ``tests/partition/test_power.py``,
``tests/partition/test_stretch.py`` and ``tests/partition/test_slowing.py`` (study, against a whole
disk).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from tcdyn.chain import Chain, equalise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.flux import track_flux
from tcdyn.heat.modal import RimGains
from tcdyn.heat.nonuniform import cached_rim_gains
from tcdyn.heat.rim import (
    InputJump,
    Mesh,
    Point,
    Profile,
    Rim,
    basis_rates,
    lag_basis,
    lag_basis_means,
)
from tcdyn.partition.events import EhlTest
from tcdyn.rig.disk import DiskSetup
from tcdyn.smoothing.traces import DiskTraces

# Steady window of a short test: share of the time under load, and least length [s]; by judgement.
STEADY_SHARE = 0.3
MIN_STEADY_S = 10.0
STEADY_S = 150.0  # length of the steady window before the unloading [s], section 4.3
# Lengths chosen by judgement: record before the steady window, for the filter bank to settle, and
# record after the loading that is not used [s].
FORGET_S = 20.0
AFTER_LOADING_S = 5.0
# Blocks, chosen by judgement.
STEADY_BLOCK_S = 1.0  # length of a block under steady load [s]
BEFORE_UNLOADING_S = 0.5  # single samples from this long before the unloading [s]
SINGLE_SAMPLES_S = 3.0  # single samples this long after the unloading, then blocks [s]
COARSE_BLOCK_S = 0.1  # length of those blocks [s]
# Step of the difference quotient by radius at the inner row [m]. Chosen by judgement.
GRADIENT_STEP_M = 0.25e-3
# Least fraction of a block's samples that counts as observed. Interpolated samples get next to no
# weight; this keeps the weight above zero.
MIN_OBSERVED_FRACTION = 1e-4
# Meshes of the rim in all fits, and of a rim that reaches to the bore. The error of the first is
# in ``tcdyn.partition.nuisance.RIM_MODEL_U_K`` and ``tcdyn.partition.crosscheck.MODEL_FORM_REL``.
FIT_MESH = Mesh(33, 53)
BORE_MESH = Mesh(49, 41)
# Longest lag of the filter bank of a rim that reaches to the bore [s]; its slowest mode is faster.
BORE_LAG_S = 50.0
POWER = slice(0, 1)  # index of the power among the rim's inputs


@dataclass(frozen=True)
class Perturbation:
    """Departure of a disk from its nominal values.

    Parameters
    ----------
    conductivity, heat_capacity, washer, half_width
        Relative changes of conductivity, specific heat, washer conductance and half-width of the
        flux.
    depth_shift_m
        How much deeper each junction of the disk's ``rows`` lies [m]; empty for none. The rim
        begins at its nominal edge whatever the depths of the inner row are.
    shift_m
        Shift of the centre of the flux along z [m].
    h_profile
        Tilt and crown of h along the track, relative to its mean; see
        ``tcdyn.heat.nonuniform.h_along``.
    """

    conductivity: float = 0.0
    heat_capacity: float = 0.0
    washer: float = 0.0
    half_width: float = 0.0
    depth_shift_m: tuple[float, ...] = ()
    shift_m: float = 0.0
    h_profile: tuple[float, float] = (0.0, 0.0)


# No departure.
NOMINAL = Perturbation()


@dataclass(frozen=True)
class RimMeans:
    """The rim model of one disk with its inputs as means over R blocks.

    Parameters
    ----------
    setup
        The disk.
    half_width_m
        Half-width of the flux.
    rates_1_s
        Rates of the filter bank, (K,).
    inputs
        Block means of the inputs, (R, I): power [W, for a share of one], inner row, ambient. Where
        the speeds change, two more follow: the offset of the air at the running surface, and its
        change by a standard uncertainty of the speed exponent (see
        :func:`tcdyn.partition.cooling.with_slowing_air_offset`).
    banks
        The inputs through the lags of the filter bank, (I, R, K).
    profile
        Profile of the inner boundary along z.
    both_rows
        Whether the inner row is predicted, too. Then the k junctions of the inner row follow the P
        of the outer row (and the additional points) in every response.

    Notes
    -----
    The model is linear in its inputs: response = inputs @ direct + sum over inputs and lags of gain
    times bank. The order of the inputs must be that of ``tcdyn.heat.modal.RimGains``.

    The inner row is predicted by a rim down to the bore, from power and surface air only. This
    holds for changes in the first seconds after an event, which the bore does not feel yet;
    ``tcdyn.partition.sensor_window.BORE_DELAY_S`` decides how long.
    """

    setup: DiskSetup
    half_width_m: float
    rates_1_s: Array
    inputs: Array
    banks: Array
    profile: Profile = "modal"
    both_rows: bool = False

    @property
    def ambient_index(self) -> int:
        """Index of the ambient among the inputs."""
        return len(self.setup.inner) + 1

    @property
    def inner_inputs(self) -> slice:
        """Slice of the inputs that are junctions of the inner row; input 0 is the power."""
        return slice(1, self.ambient_index)

    @property
    def boundary_inputs(self) -> slice:
        """All inputs but the power, and the offset of the surface air where speeds change."""
        return slice(1, self.ambient_index + 2)

    @property
    def surface_air_inputs(self) -> tuple[slice, slice]:
        """Inputs of the surface air's offset and of its change by the speed exponent.

        Returns
        -------
        offset, by_exponent
            One input each. Both are beyond the end of ``inputs`` where no offset is used; a
            response to them is then zero.
        """
        first = self.ambient_index + 1
        return slice(first, first + 1), slice(first + 1, first + 2)

    @cached_property
    def _gains_cache(self) -> dict[tuple[float, Perturbation, tuple[Point, ...]], RimGains]:
        """Gains by h, perturbation and additional points."""
        return {}

    def gains(
        self, h_W_m2K: float, perturbation: Perturbation = NOMINAL, extra: tuple[Point, ...] = ()
    ) -> RimGains:
        """Gains of the rim, cached.

        Parameters
        ----------
        h_W_m2K
            Heat transfer coefficient of the running surface.
        perturbation
            Departure from the nominal disk.
        extra
            Points beside the outer row, (depth, z) [m].

        Returns
        -------
        RimGains
            Gains at the outer row, at the points of ``extra``, and with ``both_rows`` at the inner
            row.
        """
        key = h_W_m2K, perturbation, extra
        if key not in self._gains_cache:
            self._gains_cache[key] = self._gains(*key)
        return self._gains_cache[key]

    def _gains(
        self, h_W_m2K: float, perturbation: Perturbation, extra: tuple[Point, ...]
    ) -> RimGains:
        """Compute the gains that :meth:`gains` caches; the parameters are the same.

        A depth shift moves junctions, not the rim's edge. The inner row, with ``both_rows``, is
        predicted from the bore; it does not depend on the inputs of the inner row.
        """
        setup = self.setup
        depth_shifts = zip_longest(setup.rows, perturbation.depth_shift_m, fillvalue=0.0)
        positions = [
            (setup.junctions[str(c)].depth_m + float(shift), setup.junctions[str(c)].z_m)
            for c, shift in depth_shifts
        ]
        n_outer = len(setup.outer)
        points = (*positions[:n_outer], *extra)
        outer = self._rim_gains(Rim.from_setup(setup), points, FIT_MESH, h_W_m2K, perturbation)
        if not self.both_rows:
            return outer
        to_bore = Rim.from_setup(setup, inner_radius_m=setup.bore_radius_m)
        inner = self._rim_gains(
            to_bore, tuple(positions[n_outer:]), BORE_MESH, h_W_m2K, perturbation
        )
        both = {}
        for name in ("gains", "direct", "static"):
            of_inner = getattr(inner, name).copy()
            of_inner[1 : self.ambient_index + 1] = 0.0
            both[name] = np.concatenate([getattr(outer, name), of_inner], axis=1)
        return replace(outer, points=(*outer.points, *inner.points), **both)

    def _rim_gains(
        self,
        rim: Rim,
        points: tuple[Point, ...],
        mesh: Mesh,
        h_W_m2K: float,
        perturbation: Perturbation,
    ) -> RimGains:
        """Gains of a rim at some points.

        Parameters
        ----------
        rim
            Nominal rim.
        points
            Points, (depth, z) [m].
        mesh
            Mesh of the rim.
        h_W_m2K
            Heat transfer coefficient of the running surface.
        perturbation
            Departure from the nominal rim, its flux and h.
        """
        rim = replace(
            rim,
            conductivity_W_mK=rim.conductivity_W_mK * (1 + perturbation.conductivity),
            specific_heat_J_kgK=rim.specific_heat_J_kgK * (1 + perturbation.heat_capacity),
            washer_W_m2K=rim.washer_W_m2K * (1 + perturbation.washer),
        )
        width = self.half_width_m * (1 + perturbation.half_width)
        flux = track_flux(self.setup.flux, width, perturbation.shift_m, 1 + perturbation.half_width)
        has_surface_air = len(self.banks) > self.ambient_index + 1
        return cached_rim_gains(
            rim,
            h_W_m2K,
            points,
            width,
            tuple(self.rates_1_s),
            self.profile,
            flux,
            mesh,
            has_surface_air,
            perturbation.h_profile,
        )

    def input_response(
        self,
        inputs: slice,
        h_W_m2K: ArrayLike,
        perturbation: Perturbation = NOMINAL,
        extra: tuple[Point, ...] = (),
    ) -> Array:
        """Response to some inputs, (..., R, P) for h of shape (...) [K].

        Parameters
        ----------
        inputs
            Indices of the inputs.
        h_W_m2K
            Heat transfer coefficients of the running surface.
        perturbation, extra
            As of :meth:`gains`.
        """
        gains_of_h = [self.gains(float(h), perturbation, extra) for h in np.ravel(h_W_m2K)]
        direct = np.concatenate([g.direct[inputs] for g in gains_of_h], axis=1)
        gains = np.concatenate([g.gains[inputs] for g in gains_of_h], axis=1)
        out = self.inputs[:, inputs] @ direct
        for bank, gain in zip(self.banks[inputs], gains):
            out += bank @ gain.T
        n_blocks = len(out)
        by_h = np.moveaxis(out.reshape(n_blocks, len(gains_of_h), -1), 1, 0)
        return by_h.reshape(*np.shape(h_W_m2K), n_blocks, -1)

    def with_power(self, power_W: Array, bank: Array) -> RimMeans:
        """The same rim and gains with another power.

        Parameters
        ----------
        power_W
            Block means of the power, (R,).
        bank
            The power through the filter bank, (R, K).

        Notes
        -----
        The inputs are then power and ``boundary_inputs``; the change by the speed exponent is
        dropped.
        """
        inputs = np.column_stack([power_W, self.inputs[:, self.boundary_inputs]])
        banks = np.concatenate([bank[None], self.banks[self.boundary_inputs]])
        return self.with_inputs(inputs, banks)

    def with_inputs(self, inputs: Array, banks: Array) -> RimMeans:
        """The same rim and gains with other inputs, for example other means of the same record.

        Parameters
        ----------
        inputs, banks
            As of the class.

        Notes
        -----
        The gains do not depend on the inputs, so both objects share one cache.
        """
        out = replace(self, inputs=inputs, banks=banks)
        out.__dict__["_gains_cache"] = self._gains_cache
        return out

    def response(
        self,
        h_W_m2K: ArrayLike,
        perturbation: Perturbation = NOMINAL,
        extra: tuple[Point, ...] = (),
    ) -> tuple[Array, Array]:
        """Response without frictional heat, and to a share of one; (..., R, P) each.

        P counts the points of ``extra``, too.

        Parameters
        ----------
        h_W_m2K, perturbation, extra
            As of :meth:`input_response`.

        Returns
        -------
        boundary, power
            The readings of the model are ``boundary + share * power`` [degC, K].
        """
        boundary = self.input_response(self.boundary_inputs, h_W_m2K, perturbation, extra)
        return boundary, self.input_response(POWER, h_W_m2K, perturbation, extra)

    @property
    def points_inside(self) -> tuple[Point, ...]:
        """Points ``GRADIENT_STEP_M`` inside the rim's edge, at the z of the inner row."""
        depth = self.setup.edge_m - GRADIENT_STEP_M
        return tuple((depth, self.setup.junctions[c].z_m) for c in self.setup.inner)

    def gradient(
        self, h_W_m2K: ArrayLike, perturbation: Perturbation = NOMINAL
    ) -> tuple[Array, Array]:
        """Radial gradient at the inner row without heat, and per share, (..., R, k) [K/m].

        Parameters
        ----------
        h_W_m2K, perturbation
            As of :meth:`input_response`.

        Returns
        -------
        boundary, power
            The gradient is ``boundary + share * power``, positive where it is hotter towards the
            surface.
        """
        boundary, power = self.response(h_W_m2K, perturbation, self.points_inside)
        first = len(self.setup.outer)
        inside = slice(first, first + len(self.setup.inner))
        rise = boundary[..., inside] - self.inputs[:, self.inner_inputs]
        return rise / GRADIENT_STEP_M, power[..., inside] / GRADIENT_STEP_M


@dataclass(frozen=True)
class DiskWindow:
    """Readings of one disk over a window, and its rim model, as means over the same R blocks.

    Parameters
    ----------
    disk
        Name of the disk.
    readings
        Readings of the C channels in the N samples, (N, C) [degC].
    time_s
        Times of the samples, (N,).
    blocks
        Averaging matrix, (R, N).
    block_time_s
        Mean time of each block, (R,).
    counts
        Number of samples in each block, (R,).
    y
        Block means of the P outer junctions, (R, P), in Kirchhoff's temperature [degC]; with
        ``rim.both_rows`` those of the inner row follow.
    weight
        One over the standard deviation of the noise of a block mean, (R, P) [1/K]; zero for an
        excluded channel.
    rim
        The rim model.
    chain
        The chain that the readings lag by; None for compensated temperatures.
    """

    disk: str
    readings: Array
    time_s: Array
    blocks: sparse.csr_array
    block_time_s: Array
    counts: NDArray[np.int64]
    y: Array
    weight: Array
    rim: RimMeans
    chain: Chain | None

    @property
    def used_channels(self) -> NDArray[np.bool_]:
        """Mask of the outer junctions that are used, (P,)."""
        return np.asarray(self.weight.any(axis=0))


def rows_between(time_s: Array, start_s: float, stop_s: float) -> slice:
    """The samples from ``start_s`` to before ``stop_s``.

    Parameters
    ----------
    time_s
        Ascending times, (N,) [s].
    start_s, stop_s
        Ends of the interval [s].

    Examples
    --------
    >>> rows_between(np.arange(5.0), 1.5, 3.0)
    slice(2, 3, None)
    """
    first, last = np.searchsorted(time_s, [start_s, stop_s])
    return slice(int(first), int(last))


def fit_rows(test: EhlTest, after_s: float) -> slice:
    """Rows of the fits, from before the steady window to some seconds after the unloading.

    Parameters
    ----------
    test
        The test.
    after_s
        Length of the cooling [s].

    Raises
    ------
    InputError
        If the log ends before.

    Notes
    -----
    The rows begin ``FORGET_S`` before the steady window, so that the filter bank has settled, but
    not within ``AFTER_LOADING_S`` of the loading. ``tests/partition/test_stretch.py`` tests the
    error.
    """
    unload_s = test.events.unload_s
    cooling_s = test.time_s[-1] - unload_s
    if test.time_s[-1] < unload_s + after_s:
        available_s = max(np.floor(10 * cooling_s) / 10, 0.0)
        raise InputError(
            f"the log ends {cooling_s:.2f} s after the disks part",
            expected=f"at least {after_s:g} s of cooling",
            remedy="ask for a shorter window, {window_s}, or log more of the cooling",
            parameters={"window_s": f"{available_s:g}"},
        )
    start_s = max(unload_s - STEADY_S - FORGET_S, test.events.load_on_s + AFTER_LOADING_S)
    return rows_between(test.time_s, start_s, unload_s + after_s)


def steady_start_s(test: EhlTest) -> float:
    """Start of the steady window [s]: the last ``STEADY_S`` under load, or less in a short test.

    Notes
    -----
    A short test uses ``STEADY_SHARE`` of its time under load, at least ``MIN_STEADY_S``. The start
    of the first block, ``tcdyn.partition.nuisance.harmonic_prior`` and
    :mod:`tcdyn.campaign.compress` rely on it.
    """
    loaded_s = test.events.unload_s - test.events.load_on_s
    return test.events.unload_s - min(STEADY_S, max(STEADY_SHARE * loaded_s, MIN_STEADY_S))


def disk_window(
    test: EhlTest,
    disk: DiskTraces,
    temperatures: Array,
    rows: slice,
    noise_K: Array,
    profile: Profile = "modal",
    chain: Chain | None = None,
    block_starts_s: Array | None = None,
) -> DiskWindow:
    """Build the window of one disk.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    temperatures
        Temperatures of the channels over ``rows``, (N, C) [degC].
    rows
        Rows of the test.
    noise_K
        Standard deviation of the noise of each channel, (C,) [K].
    profile
        Profile of the inner boundary along z.
    chain
        The chain that the temperatures still lag by; None for compensated temperatures.
    block_starts_s
        For the sensor check: starts of other blocks [s], the last of which ends with ``rows``. Both
        rows of junctions are then predicted.

    Returns
    -------
    DiskWindow
        Blocks of one second under steady load, single samples about the unloading, and blocks of a
        tenth of a second later.

    Notes
    -----
    Power and surface air pass ``chain``, because the temperatures did. Ambient is used as logged:
    it is taken as slow. The lengths of the blocks may change freely; longer blocks lose resolution
    in time, shorter ones cost time. The lowest rate of the bank must hold twice the longest lag,
    because ``tcdyn.partition.nuisance.LaggedRim`` takes derivatives by a lag with that lag twice;
    ``tests/partition/test_profile.py`` compares these derivatives with differences.
    """
    dt = test.dt_s
    time_s = test.time_s[rows]
    steel_K = disk.setup.steel.kirchhoff_temperature(temperatures)
    inner_row = disk.setup.channel_indices(disk.setup.inner)
    both_rows = block_starts_s is not None
    predicted = disk.setup.channel_indices(disk.setup.rows if both_rows else disk.setup.outer)
    if block_starts_s is None:
        starts = _fit_block_starts(test, time_s)
    else:
        starts = np.unique(np.searchsorted(time_s, block_starts_s))
    blocks, counts = _averaging_matrix(starts, len(time_s))
    missing = disk.missing[rows][:, predicted].astype(float)
    observed = np.maximum(1.0 - blocks @ missing, MIN_OBSERVED_FRACTION)
    # a fit also makes of the bank the longest lag of the chain, and twice that lag
    longest_s = 2 * max(chain.taus_s, default=0.0) if chain else 0.0
    rates = basis_rates(dt, longest_s=max(longest_s, BORE_LAG_S * both_rows))
    power, power_bank = power_means(test, rows, chain, blocks, counts, rates)
    inner = steel_K[:, inner_row] + disk.inner_offset_K[rows]
    ambient = test.ambient_of(disk.name)[rows]
    boundary = [*inner.T, ambient, *lagged_surface_air(test, disk, rows, chain)]
    inputs = np.column_stack([power, blocks @ np.column_stack(boundary)])
    banks = np.stack([power_bank, *(lag_basis_means(u, dt, rates, counts) for u in boundary)])
    weight = np.sqrt(counts[:, None] * observed) / noise_K[None, predicted]
    return DiskWindow(
        disk=disk.name,
        readings=disk.readings_degC[rows] if chain is None else temperatures,
        time_s=time_s,
        blocks=blocks,
        block_time_s=blocks @ time_s,
        counts=counts,
        y=blocks @ steel_K[:, predicted],
        weight=weight * ~disk.excluded_mask[predicted],
        rim=RimMeans(disk.setup, test.half_width_m, rates, inputs, banks, profile, both_rows),
        chain=chain,
    )


def _fit_block_starts(test: EhlTest, time_s: Array) -> NDArray[np.int64]:
    """First sample (R,) of each block of the fits, in the order of time.

    Blocks last ``STEADY_BLOCK_S`` under load, one sample about the unloading, from
    ``BEFORE_UNLOADING_S`` before to ``SINGLE_SAMPLES_S`` after it, and ``COARSE_BLOCK_S`` later.
    ``time_s`` (N,) are the times of the samples. Those before the steady window are in no block:
    they only settle the bank.
    """
    unload_s = test.events.unload_s
    boundaries_s = [
        steady_start_s(test),
        unload_s - BEFORE_UNLOADING_S,
        unload_s + SINGLE_SAMPLES_S,
    ]
    first, single, coarse = np.searchsorted(time_s, boundaries_s)
    steady_length = max(int(round(STEADY_BLOCK_S / test.dt_s)), 1)
    coarse_length = max(int(round(COARSE_BLOCK_S / test.dt_s)), 1)
    return np.concatenate(
        [
            np.arange(first, single, steady_length),
            np.arange(single, coarse),
            np.arange(coarse, len(time_s), coarse_length),
        ]
    )


def _averaging_matrix(
    starts: NDArray[np.int64], n_samples: int
) -> tuple[sparse.csr_array, NDArray[np.int64]]:
    """Averaging matrix of the blocks, (R, N), and the number of samples in each, (R,).

    Parameters
    ----------
    starts
        First sample of each block, (R,); the last block ends with the record.
    n_samples
        Number of samples, N.
    """
    edges = np.append(starts, n_samples)
    counts = np.diff(edges)
    weights = np.repeat(1.0 / counts, counts)
    columns = np.arange(edges[0], n_samples)
    shape = (len(starts), n_samples)
    return sparse.csr_array((weights, columns, edges - edges[0]), shape=shape), counts


def lagged_window(
    test: EhlTest,
    disk: DiskTraces,
    rows: slice,
    profile: Profile = "modal",
    block_starts_s: Array | None = None,
) -> DiskWindow:
    """Window of the uncompensated readings, all channels brought to the mean chain.

    Parameters
    ----------
    test, disk, rows, profile, block_starts_s
        As of :func:`disk_window`.
    """
    chain = disk.mean_chain
    readings = equalise(disk.readings_degC[rows], test.dt_s, disk.chains, chain)
    return disk_window(test, disk, readings, rows, disk.noise_K, profile, chain, block_starts_s)


def interpolate_blocks(window: DiskWindow, of_blocks: Array) -> Array:
    """Block means (R, M) linearly interpolated to the samples, (N, M)."""
    return np.column_stack(
        [np.interp(window.time_s, window.block_time_s, column) for column in of_blocks.T]
    )


def lagged_surface_air(
    test: EhlTest, disk: DiskTraces, rows: slice, chain: Chain | None
) -> list[Array]:
    """Offset of the surface air through a chain, and its change by the speed exponent.

    Parameters
    ----------
    test, disk, rows
        As of :func:`disk_window`.
    chain
        The chain, None for none.

    Returns
    -------
    list
        Empty, or two arrays (N,) [K].
    """
    if disk.name not in test.surface_air_offset_K:
        return []
    offsets = test.surface_air_offset_K[disk.name][rows].T
    if chain is None:
        return list(offsets)
    return [chain.response(offset, test.dt_s) for offset in offsets]


def power_means(
    test: EhlTest,
    rows: slice,
    chain: Chain | None,
    blocks: sparse.csr_array,
    counts: NDArray[np.int64],
    rates_1_s: Array,
) -> tuple[Array, Array]:
    """Block means of the frictional power, and of the power through the filter bank.

    Parameters
    ----------
    test, rows, chain
        As of :func:`disk_window`.
    blocks, counts
        Averaging matrix (R, N), and number of samples in each block (R,).
    rates_1_s
        Rates of the bank, (K,) [1/s].

    Returns
    -------
    power, bank
        (R,) and (R, K) [W].
    """
    power, hold = lagged_power(test, rows, chain)
    if hold:
        bank = blocks @ lag_basis(power, test.dt_s, rates_1_s, **hold)
    else:
        bank = lag_basis_means(power, test.dt_s, rates_1_s, counts)
    return blocks @ power, bank


def lagged_power(test: EhlTest, rows: slice, chain: Chain | None) -> tuple[Array, dict[str, Any]]:
    """Frictional power through a chain, and the arguments of ``lag_basis`` for it.

    Parameters
    ----------
    test, rows
        The test and its rows, N of them.
    chain
        The chain, None for compensated readings.

    Returns
    -------
    power
        Total frictional power F u_s, (N,) [W].
    arguments
        Keywords of ``tcdyn.heat.rim.lag_basis``: with a chain none, without one a zero-order hold
        with its jump inside a sample.

    Notes
    -----
    The power is held between samples and ends at an instant inside a sample. Through a chain, for
    uncompensated readings, the sample in which it ends carries its average, which keeps the energy
    and places the step to second order in dt. ``tests/partition/test_power.py`` fails if the power
    ends on the wrong side of the sample.
    """
    power = test.power_W[rows]
    time_s = test.time_s[rows]
    unload_s = test.events.unload_s
    k = int(np.searchsorted(time_s, unload_s)) - 1
    ends = 0 <= k < len(time_s) - 1 and power[k] != 0 and power[k + 1] == 0
    fraction = float((unload_s - time_s[k]) / test.dt_s) if ends else 1.0
    if chain is None:
        jumps = (InputJump(k, fraction, float(power[k]), 0.0),) if ends else ()
        return power, {"hold": "zoh", "jumps": jumps}
    averaged = power.copy()
    averaged[max(k, 0)] *= fraction
    return chain.response(averaged, test.dt_s, hold="zoh"), {}
