"""Features of a disk for the sensor check: window means of its readings, and their model.

The windows are the steady level and some seconds after each event. The model predicts them for any
order of the columns, and the effects of the nuisance parameters. A few dozen numbers replace the
log, so that all faults can be compared. Used by :mod:`tcdyn.partition.sensor_faults` and
:mod:`tcdyn.partition.sensor_check`. The windows and steps are chosen by judgement. Guarded by
``tests/partition/test_sensors.py`` and ``tests/partition/test_depths.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import equalise
from tcdyn.core import Array
from tcdyn.heat.rim import basis_rates, lag_basis
from tcdyn.partition.angular_harmonic import window_harmonic_effects
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import (
    nominal_effects,
    nominal_perturbations,
    steady_input_response,
)
from tcdyn.partition.specified import SHIFT_STEP_M, unresolved_edge_effect
from tcdyn.partition.window import (
    GRADIENT_STEP_M,
    NOMINAL,
    Perturbation,
    RimMeans,
    lagged_power,
    lagged_surface_air,
    rows_between,
)
from tcdyn.rig.disk import DiskSetup
from tcdyn.smoothing.traces import SURROGATE_U_K, DiskTraces

Order = tuple[int, ...]  # for each position, the column that reads it
Case = tuple[float, Perturbation]  # h [W/m2K], and the departure from the nominal disk
# "inside": just inside the inner row; "inner row": this row, of a rim to the bore.
Target = Literal["outer row", "inside", "inner row"]
Window = tuple[str, float, float]  # event that it follows, start, stop [s]
# Windows, chosen by judgement [s].
STEADY_S = 100.0  # length of the steady window before the unloading
STEADY_GAP_S = 0.5  # its end before the unloading
BASE_S = 8.0  # length of the base before an event
UNLOADING_BASE_GAP_S = 0.3  # end of the base before the unloading
LOADING_BASE_GAP_S = 0.5  # end of the base before the loading
BEFORE_S = 12.0  # record before the loading that the filter bank needs
FORGET_S = 20.0  # record before the steady window that the filter bank needs
AFTER_UNLOADING_S = ((0.3, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0))
AFTER_LOADING_S = ((1.0, 2.5), (2.5, 5.0), (5.0, 10.0))
LAG_STEP_S = 0.05  # step of the difference quotient by the common lag [s]
SLOWEST_PER_S = 0.02  # slowest rate of the filter bank [1/s]
WARMUP_TIME_CONSTANT_S = 40.0  # a disk under load warms up with about this time constant [s]
# The bore has no effect within this of an event [s]: heat needs ten seconds to the bore and back.
BORE_DELAY_S = 5.0
FEATURE_DEPTH_M = 0.1e-3  # step of the difference quotient by depth [m]


@dataclass(frozen=True)
class _SegmentMeans:
    """Window means of one segment of the record: W windows, I columns, C of them channels.

    Parameters
    ----------
    inputs, banks
        Means of the columns, (W, I), and of these through the lags of the filter bank, (W, I, K).
    slope, noise, trend_u_K
        As of ``DiskFeatures``, (W, C), (W,) and (W, C).
    """

    inputs: Array
    banks: Array
    slope: Array
    noise: Array
    trend_u_K: Array


@dataclass(frozen=True)
class _OrderFree:
    """Effects at one h that do not depend on which column reads which position.

    Parameters
    ----------
    steady
        ``steady_input_response`` of the rim, (3 k + 1, P).
    harmonic
        Effects of the circumferential harmonic and of an unresolved edge, (.., W, C).
    common_lag
        Effect of a second of common lag for a share of one, (W, C).
    speed_exponent
        Effect of the speed exponent, (W, C).
    """

    steady: Array
    harmonic: Array
    common_lag: Array
    speed_exponent: Array


@dataclass(frozen=True)
class DiskFeatures:
    """Window means of one disk; W windows.

    The outer row is predicted from the inner row; the inner row itself only in the first seconds
    after an event, when the bore has no effect yet, by a rim that reaches to the bore.

    Parameters
    ----------
    disk, setup
        Name and set-up of the disk.
    half_width_m
        Half-width of the flux.
    rates_1_s
        Rates of the filter bank, (K,).
    event
        Event before each window, (W,): "steady", "unloading" or "loading".
    after_s
        Middle of each window since its event, (W,).
    inputs
        Means of the ``columns``, (W, C + 3): power [W], C channels, ambient [degC], and the power
        through a chain that is ``LAG_STEP_S`` slower; where speeds change, two more for the offset
        of the surface air.
    banks
        The same through the lags of the filter bank, (C + 3, W, K).
    slope
        Mean rate of each channel less that of the base, (W, C) [K/s].
    noise
        Standard deviation of a mean by white noise of unit variance, (W,).
    trend_u_K
        How far a trend before the event may have curved since, (W, C).
    observed
        Which data are used, (W, C), in the order of the disk's rows.
    inner_row_weights
        As of ``tcdyn.smoothing.traces.DiskTraces``, (k, k).
    shift_u_m
        Standard uncertainty of the position of the flux.

    Notes
    -----
    Results that do not depend on the hypothesis are cached in the object, so it must not be
    changed; use ``dataclasses.replace``, which starts with empty caches.
    """

    disk: str
    setup: DiskSetup
    half_width_m: float
    rates_1_s: Array
    event: NDArray[np.str_]
    after_s: Array
    inputs: Array
    banks: Array
    slope: Array
    noise: Array
    trend_u_K: Array
    observed: NDArray[np.bool_]
    inner_row_weights: Array
    shift_u_m: float = 0.0
    _responses: dict[tuple[tuple[Case, ...], Target], Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _effects: dict[tuple[Order, float], tuple[Array, Array]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _order_free: dict[float, _OrderFree] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the inputs; the last two only where speeds change."""
        return (
            "power",
            *self.setup.channels,
            "ambient",
            "slower power",
            "surface air",
            "surface air by exponent",
        )

    @property
    def as_wired(self) -> Order:
        """Every position read by its own column."""
        return tuple(range(len(self.setup.channels)))

    @property
    def levels(self) -> Array:
        """The channels' level or change since the base, (W, C)."""
        return self.inputs[:, 1 : 1 + len(self.setup.channels)]

    @cached_property
    def rim(self) -> RimMeans:
        """The rim driven by power, inner row as wired, ambient, and surface air if any."""
        ambient = 1 + len(self.setup.channels)
        inner = (1 + i for i in self._inner_row)
        surface_air = range(ambient + 2, self.inputs.shape[1])
        index = [0, *inner, ambient, *surface_air]
        return RimMeans(
            self.setup, self.half_width_m, self.rates_1_s, self.inputs[:, index], self.banks[index]
        )

    @cached_property
    def _outer_row(self) -> list[int]:
        """Indices of the outer row among the channels, (P,)."""
        return self.setup.channel_indices(self.setup.outer)

    @cached_property
    def _inner_row(self) -> list[int]:
        """Indices of the inner row among the channels, (k,)."""
        return self.setup.channel_indices(self.setup.inner)

    @cached_property
    def _perturbations(self) -> tuple[tuple[Perturbation, ...], Array]:
        """Perturbations of ``nominal_effects``, and their sizes."""
        perturbations, sizes = zip(*nominal_perturbations(self.setup, FEATURE_DEPTH_M))
        return perturbations, np.array(sizes)

    def target_responses(self, cases: tuple[Case, ...], target: Target = "outer row") -> Array:
        """Response of the points of ``target`` to every column as every input of the rim.

        Cached, since all hypotheses need it.

        Parameters
        ----------
        cases
            h [W/m2K] and departure from the nominal disk.
        target
            The points: outer row, inner row, or points just inside the inner row.

        Returns
        -------
        Array
            (cases, C + 3, I, W, points).
        """
        if (cases, target) not in self._responses:
            self._responses[cases, target] = self._target_responses(cases, target)
        return self._responses[cases, target]

    def _target_responses(self, cases: tuple[Case, ...], target: Target) -> Array:
        """Compute ``target_responses``: gains of each case, applied to every column."""
        inside = target == "inside"
        extra = self.rim.points_inside if inside else ()
        first_point = len(self.setup.outer) if inside else 0
        gains_of_cases = [self.rim.gains(h, p, extra, target == "inner row") for h, p in cases]
        direct = np.stack([g.direct[:, first_point:] for g in gains_of_cases])
        gains = np.stack([g.gains[:, first_point:] for g in gains_of_cases])
        responses = np.tensordot(gains, self.banks, (3, 2))
        responses += direct[..., None, None] * self.inputs.T
        return np.ascontiguousarray(responses.transpose(0, 3, 1, 4, 2))

    def column_response(
        self, column: str, input_index: int, cases: tuple[Case, ...], target: Target = "outer row"
    ) -> Array:
        """Response of the points of ``target`` to a column as one input, (cases, W, points).

        Zero for a column that does not exist.

        Parameters
        ----------
        column
            One of ``columns``.
        input_index
            Input of the rim to which it is applied.
        cases, target
            As of :meth:`target_responses`.
        """
        k = self.columns.index(column)
        responses = self.target_responses(cases, target)
        if k < responses.shape[1]:
            return responses[:, k, input_index]
        return np.zeros_like(responses[:, 0, 0])

    def _rim_response(
        self, order: Order, cases: tuple[Case, ...], target: Target = "outer row"
    ) -> tuple[Array, Array]:
        """Response without heat, and to a share of one, at ``target``.

        Parameters
        ----------
        order
            For each position of the channels, the column that reads it.
        cases, target
            As of :meth:`target_responses`.

        Returns
        -------
        boundary, power
            (cases, W, points) each.
        """
        ambient = self.rim.ambient_index
        responses = self.target_responses(cases, target)
        columns = [1 + order[i] for i in self._inner_row]
        boundary = responses[:, columns, range(1, ambient)].sum(axis=1)
        boundary += self.column_response("ambient", ambient, cases, target) + self.column_response(
            "surface air", ambient + 1, cases, target
        )
        return boundary, responses[:, 0, 0]

    def gradient(self, order: Order, cases: tuple[Case, ...]) -> tuple[Array, Array]:
        """Rise of temperature with radius at the inner row, without heat, and for a share of one.

        Parameters
        ----------
        order, cases
            As of :meth:`response`.

        Returns
        -------
        boundary, power
            (cases, W, k) each [K/m].
        """
        boundary, power = self._rim_response(order, cases, "inside")
        readings = self.levels[:, [order[i] for i in self._inner_row]]
        return (boundary - readings) / GRADIENT_STEP_M, power / GRADIENT_STEP_M

    def response(self, order: Order, cases: tuple[Case, ...]) -> tuple[Array, Array]:
        """Model of both rows without heat, and per share of one.

        Parameters
        ----------
        order
            For each position of the channels, the column that reads it.
        cases
            h [W/m2K] and departure from the nominal disk.

        Returns
        -------
        boundary, power
            (cases, W, C) each, in the order of the disk's rows [K].

        Notes
        -----
        An inner row at several depths is corrected by the gradient to first order, as in
        ``tcdyn.partition.steady.with_inner_row_at_one_radius``.
        ``tests/partition/test_inner_row.py`` (study) tests it.
        """
        boundary, power = self._rim_response(order, cases)
        deeper_m = self.setup.depth_below_edge_m
        if np.any(deeper_m):
            inner = self.rim.inner_inputs
            static = deeper_m[:, None] * [self.rim.gains(h, p).static[inner] for h, p in cases]
            boundary_gradient, power_gradient = self.gradient(order, cases)
            boundary = boundary + boundary_gradient @ static
            power = power + power_gradient @ static
        surface_air = self.rim.ambient_index + 1
        inner_boundary = self.column_response("surface air", surface_air, cases, "inner row")
        inner_power = self.column_response("power", 0, cases, "inner row")
        return (
            np.concatenate([boundary, inner_boundary], axis=2),
            np.concatenate([power, inner_power], axis=2),
        )

    def effects(self, order: Order, h_W_m2K: float, share: float) -> Array:
        """Effects on the ``observed`` data about a point, (Q, D).

        Of a unit of each of ``nominal_parameters`` and of the circumferential harmonic, then of a
        standard uncertainty of the flux's position and of the speed exponent, of a second of common
        lag, of a second of later load, and of the share. They are linear in the share.

        Parameters
        ----------
        order
            For each position of the channels, the column that reads it.
        h_W_m2K, share
            The point to linearise at.

        Notes
        -----
        The order must be that of the uncertainties in ``tcdyn.partition.sensor_faults.covariance``;
        the share must be last. ``tests/partition/test_sensors.py`` compares the last five with
        differences.
        """
        if (order, h_W_m2K) not in self._effects:
            self._effects[order, h_W_m2K] = self._effects_by_share(order, h_W_m2K)
        without_heat, per_share = self._effects[order, h_W_m2K]
        return np.asarray(without_heat + share * per_share)

    def _effects_by_share(self, order: Order, h_W_m2K: float) -> tuple[Array, Array]:
        """``effects`` for a share of zero, and their increase by a share of one.

        Parameters
        ----------
        order, h_W_m2K
            As of :meth:`effects`.

        Returns
        -------
        without_heat, per_share
            (Q, D) each.
        """
        perturbations, sizes = self._perturbations
        fixed = self._order_free_effects(h_W_m2K)
        cases = tuple((h_W_m2K, p) for p in (NOMINAL, *perturbations))
        boundary, power = self.response(order, cases)
        boundary_gradient, power_gradient = self.gradient(order, ((h_W_m2K, NOMINAL),))
        boundary_shift, power_shift = self._flux_shift_effects(order, h_W_m2K)
        steady = (self.event == "steady").astype(float)
        loading = (self.event == "loading")[:, None]
        rates = self.slope[:, [order[i] for i in (*self._outer_row, *self._inner_row)]]
        zero = np.zeros_like(fixed.common_lag)

        def assemble(
            response: Array,
            gradient: Array,
            constant: Array,
            rates: Array,
            harmonic: Array,
            others: list[Array],
        ) -> Array:
            """All effects of one of the two parts, (Q, D).

            Parameters
            ----------
            response
                Response of the nominal disk, then of each perturbation, (1 + perturbations, W, C).
            gradient
                Radial gradient at the inner row, (1, W, k).
            constant
                How much of a constant error each mean shows, (W,).
            rates
                Rates of the channels, (W, C).
            harmonic, others
                Effects that do not depend on the order, and the last five effects.
            """
            perturbed = (response[1:] - response[0]) / sizes[:, None, None]
            nominal = self._nominal_effects(perturbed, gradient[0], constant, rates, fixed.steady)
            return np.concatenate([nominal, harmonic, others])[:, self.observed]

        without_heat = assemble(
            boundary,
            boundary_gradient,
            steady,
            rates,
            fixed.harmonic,
            [boundary_shift, fixed.speed_exponent, zero, zero, power[0]],
        )
        per_share = assemble(
            power,
            power_gradient,
            zero[:, 0],
            zero,
            np.zeros_like(fixed.harmonic),
            [power_shift, zero, fixed.common_lag, fixed.common_lag * loading, zero],
        )
        return without_heat, per_share

    def _nominal_effects(
        self, perturbed: Array, gradient: Array, constant: Array, rates: Array, steady: Array
    ) -> Array:
        """``nominal_effects`` of the windows; the rim follows the inner row at once.

        Parameters
        ----------
        perturbed, constant, rates
            As of :func:`tcdyn.partition.nuisance.nominal_effects`.
        gradient
            Radial gradient at the inner row, (W, k) [K/m].
        steady
            ``steady_input_response`` of the rim, (3 k + 1, P).
        """
        n_inner = len(self.setup.inner)
        inner_rates = rates.T[len(self.setup.outer) :]
        errors = np.array([*[constant] * n_inner, *gradient.T, *inner_rates, constant])
        input_responses = errors[:, :, None] * steady[:, None]
        return nominal_effects(perturbed, input_responses, constant, rates, self.inner_row_weights)

    def _flux_shift_effects(self, order: Order, h_W_m2K: float) -> tuple[Array, Array]:
        """Effect of a standard uncertainty of the flux's position, without heat and per share.

        Parameters
        ----------
        order, h_W_m2K
            As of :meth:`effects`.

        Returns
        -------
        boundary, power
            (W, C) each [K].
        """
        if not self.shift_u_m:
            zero = np.zeros(self.observed.shape)
            return zero, zero
        steps = (SHIFT_STEP_M, -SHIFT_STEP_M)
        cases = tuple((h_W_m2K, Perturbation(shift_m=step)) for step in steps)
        scale = self.shift_u_m / (2 * SHIFT_STEP_M)
        boundary, power = self.response(order, cases)
        return (boundary[0] - boundary[1]) * scale, (power[0] - power[1]) * scale

    def _order_free_effects(self, h_W_m2K: float) -> _OrderFree:
        """Effects at one h that do not depend on which column reads which position, cached."""
        if h_W_m2K not in self._order_free:
            self._order_free[h_W_m2K] = self._compute_order_free(h_W_m2K)
        return self._order_free[h_W_m2K]

    def _compute_order_free(self, h_W_m2K: float) -> _OrderFree:
        """Compute the effects of :meth:`_order_free_effects`."""
        cases: tuple[Case, ...] = ((h_W_m2K, NOMINAL),)
        static = self.rim.gains(h_W_m2K).static

        def both_rows(column: str, which: int) -> Array:
            """Response of both rows to a column as input ``which``, (W, C)."""
            outer = self.column_response(column, which, cases, "outer row")[0]
            inner = self.column_response(column, which, cases, "inner row")[0]
            return np.hstack([outer, inner])

        slower = both_rows("slower power", 0)
        power = both_rows("power", 0)
        speed_exponent = both_rows("surface air by exponent", self.rim.ambient_index + 2)
        inner_static = static[self.rim.inner_inputs]
        harmonic = window_harmonic_effects(
            self.setup, h_W_m2K, inner_static, self.event, self.after_s
        )
        edge = unresolved_edge_effect(self.rim, h_W_m2K)
        if edge is not None:
            edge_effect = np.zeros_like(power)
            steady = (self.event == "steady")[:, None]
            edge_effect[:, : len(edge)] = SURROGATE_U_K * steady * edge
            harmonic = np.concatenate([harmonic, edge_effect[None]])
        common_lag = (slower - power) / LAG_STEP_S
        return _OrderFree(
            steady_input_response(self.setup, static), harmonic, common_lag, speed_exponent
        )


def disk_features(test: EhlTest, disk: DiskTraces) -> DiskFeatures:
    """Features of one disk; windows that the log does not hold are omitted.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.

    Notes
    -----
    Windows after the loading need a record before it and a test that is long enough. The windows
    may change; ``BORE_DELAY_S`` decides in which of them the inner row counts.
    ``tests/partition/test_sensors.py`` tests a log that ends soon after the unloading.
    """
    load_on_s = test.events.load_on_s
    unload_s = test.events.unload_s
    end_s = test.time_s[-1]
    loaded_s = unload_s - load_on_s
    steady_start = max(unload_s - STEADY_S, load_on_s + 0.5 * loaded_s)
    windows: list[Window] = [("steady", steady_start, unload_s - STEADY_GAP_S)]
    windows += [
        ("unloading", unload_s + start, unload_s + stop)
        for start, stop in AFTER_UNLOADING_S
        if unload_s + stop <= end_s + test.dt_s
    ]
    base = (unload_s - BASE_S, unload_s - UNLOADING_BASE_GAP_S)
    segments = [_segment_means(test, disk, windows, steady_start - FORGET_S, base)]
    if load_on_s - test.time_s[0] >= BASE_S and loaded_s > 2 * AFTER_LOADING_S[-1][1]:
        loading: list[Window] = [
            ("loading", load_on_s + start, load_on_s + stop) for start, stop in AFTER_LOADING_S
        ]
        base = (load_on_s - BASE_S, load_on_s - LOADING_BASE_GAP_S)
        segments.append(_segment_means(test, disk, loading, load_on_s - BEFORE_S, base))
        windows += loading
    event_s = {"steady": unload_s, "unloading": unload_s, "loading": load_on_s}
    setup = disk.setup
    before_bore = [
        event != "steady" and stop - event_s[event] <= BORE_DELAY_S for event, _, stop in windows
    ]
    by_row = np.column_stack([np.full(len(windows), True), before_bore])
    observed = np.repeat(by_row, [len(setup.outer), len(setup.inner)], axis=1)
    return DiskFeatures(
        disk=disk.name,
        setup=setup,
        half_width_m=test.half_width_m,
        rates_1_s=basis_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S),
        event=np.array([event for event, _, _ in windows]),
        after_s=np.array([0.5 * (start + stop) - event_s[event] for event, start, stop in windows]),
        inputs=np.concatenate([s.inputs for s in segments]),
        banks=np.concatenate([s.banks for s in segments]).transpose(1, 0, 2),
        slope=np.concatenate([s.slope for s in segments]),
        noise=np.concatenate([s.noise for s in segments]),
        trend_u_K=np.concatenate([s.trend_u_K for s in segments]),
        observed=observed & ~disk.excluded_mask[setup.channel_indices(setup.rows)],
        inner_row_weights=disk.inner_row_weights,
        shift_u_m=1e-3 * disk.uncertainty.flux_shift_mm,
    )


def _segment_means(
    test: EhlTest,
    disk: DiskTraces,
    windows: Sequence[Window],
    start_s: float,
    base_s: tuple[float, float],
) -> _SegmentMeans:
    """Window means of one segment of the record.

    From the mean of a window after an event, the straight line through the base is subtracted, so
    that a disk that still warms up, or an ambient that drifts, is not taken for a response to the
    event.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    windows
        Event, start and stop [s] of each window, ascending.
    start_s
        Start of the segment [s], early enough for the filter bank to settle.
    base_s
        Start and stop of the base before the event [s].

    Notes
    -----
    All means are one linear map of the samples, so power, ambient and filter bank are treated as
    the readings are. A base of slope s may curve: with the time constant tau of the warm-up the
    error after a time t is s t^2/(2 tau), which is ``trend_u_K``.
    ``tests/partition/test_depths.py`` (study) tests a disk that still warms up.
    """
    rows = rows_between(test.time_s, start_s, windows[-1][2] + test.dt_s)
    t = test.time_s[rows]
    chain = disk.mean_chain
    slower_chain = chain.with_lag_shift(LAG_STEP_S)
    readings = equalise(disk.readings_degC[rows], test.dt_s, disk.chains, chain)
    y = disk.setup.steel.kirchhoff_temperature(readings)
    power, _ = lagged_power(test, rows, chain)
    slower_power, _ = lagged_power(test, rows, slower_chain)
    surface_air = lagged_surface_air(test, disk, rows, chain)
    ambient = test.ambient_of(disk.name)[rows]
    columns = np.stack([power, *y.T, ambient, slower_power, *surface_air], axis=1)
    n_windows = len(windows)
    weights = np.zeros((n_windows, len(t)))
    distance_s = np.zeros((n_windows, 1))
    base_rate = np.zeros((n_windows, y.shape[1]))
    slope = np.zeros((n_windows, y.shape[1]))
    base = rows_between(t, *base_s)
    for k, (event, start, stop) in enumerate(windows):
        inside = rows_between(t, start, stop)
        first = inside.start
        last = max(inside.stop, inside.start + 2) - 1
        weights[k, first : last + 1] = 1.0 / (last + 1 - first)
        if event == "steady":
            continue
        centred = t[base] - t[base].mean()
        trend = centred / (centred**2).sum()
        distance_s[k] = t[first : last + 1].mean() - t[base].mean()
        weights[k, base] -= 1.0 / len(centred) + distance_s[k] * trend
        base_rate[k] = trend @ y[base]
        slope[k] = (y[last] - y[first]) / (t[last] - t[first]) - base_rate[k]
    rates = basis_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S)
    banks = [weights @ lag_basis(u, test.dt_s, rates) for u in columns.T]
    return _SegmentMeans(
        inputs=weights @ columns,
        banks=np.stack(banks, axis=1),
        slope=slope,
        noise=np.sqrt((weights**2).sum(axis=1)),
        trend_u_K=0.5 * np.abs(base_rate) * distance_s**2 / WARMUP_TIME_CONSTANT_S,
    )
