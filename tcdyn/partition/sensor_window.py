"""Window of the sensor check: few means of a disk's readings, and the effects of all parameters.

The means are the steady level and some seconds after each event, less the straight line through a
base before it. They are means of the blocks of a :class:`tcdyn.partition.window.DiskWindow` that
holds loading, steady state and unloading, so readings and rim model are those of the joint fit,
averaged once more. A few dozen numbers replace the log, so that all faults can be compared. Used by
:mod:`tcdyn.partition.sensor_faults` and :mod:`tcdyn.partition.sensor_check`. The windows are chosen
by judgement. Guarded by ``tests/partition/test_sensors.py`` and
``tests/partition/test_depths.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.heat.rim import lag_basis_means
from tcdyn.partition.angular_harmonic import (
    HARMONIC_PRIOR_K,
    add_harmonic_effects,
    fall_fraction,
    harmonic_effect,
)
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import (
    add_lag,
    harmonic_prior,
    nominal_effects,
    nominal_parameters,
    nominal_u,
    perturbed_changes,
    steady_input_response,
)
from tcdyn.partition.specified import specified_effects
from tcdyn.partition.window import (
    POWER,
    DiskWindow,
    RimMeans,
    lagged_window,
    rows_between,
)
from tcdyn.smoothing.traces import DiskTraces

# Windows, chosen by judgement: start and stop from the event [s]. The steady window begins at half
# of the time under load in a short test.
STEADY_S = (-100.0, -0.5)
AFTER_UNLOADING_S = ((0.3, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0))
AFTER_LOADING_S = ((1.0, 2.5), (2.5, 5.0), (5.0, 10.0))
BASE_S = 8.0  # length of the base before an event [s]
BASE_GAP_S = {"unloading": 0.3, "loading": 0.5}  # its end before the event [s]
MIN_LOADED_S = 20.0  # least time under load at which the loading is used [s]
FORGET_S = 4.0  # record before the windows that the filter bank needs
# Blocks of which the windows are means: their starts about an event, and their length elsewhere
# [s]. The straight line of a base is fitted to its blocks; longer ones change its noise.
BLOCK_STARTS_S = np.arange(-BASE_S, 10.0, 0.1)
LONG_BLOCK_S = 10.0
WARMUP_TIME_CONSTANT_S = 40.0  # a disk under load warms up with about this time constant [s]
# The bore has no effect within this of an event [s]: heat needs ten seconds to the bore and back.
BORE_DELAY_S = 5.0
LAG_STEP_S = 0.05  # step of the secant by the common lag [s]
# Prior standard deviations of the parameters that only the sensor check has.
SHARE_SD = 0.12  # of the share about the point of the effects
# Standard uncertainty of the model relative to the effect of the frictional heat: rim against whole
# disk, and the same for the inner row, predicted as if the bore did not feel the first seconds; and
# constant, by comparison with whole-disk solutions [K].
MODEL_REL = 0.005
INNER_MODEL_REL = 0.015
MODEL_K = 0.03
LEAST_LAG_U_S = 0.05  # least standard uncertainty of the common lag [s]
LOADING_U_S = 0.5  # of the duration of loading, which is not known [s]
RISE_SD_K = 2 * HARMONIC_PRIOR_K["level"]  # of the angular harmonic's rise after loading [K]
OWN_PARAMETERS = ("rise, cos", "rise, sin", "speed exponent", "common lag", "loading", "share")


@dataclass(frozen=True)
class EffectTable:
    """Effects of Q parameters on the D data of a sensor window.

    Parameters
    ----------
    names
        Names of the parameters; the last is the share.
    u
        Their prior standard deviations, (Q,).
    change
        Readings less prediction by a unit of each, (Q, D).
    independent_var_K2
        Variance of each datum by white noise, model errors and trends, (D,).
    """

    names: tuple[str, ...]
    u: Array
    change: Array
    independent_var_K2: Array

    def covariance(self, further_sd: Mapping[str, float]) -> Array:
        """Covariance of the data, (D, D) [K2].

        Parameters
        ----------
        further_sd
            By name, a further prior standard deviation of some parameters.
        """
        sd = np.hypot(self.u, [further_sd.get(name, 0.0) for name in self.names])
        scaled = sd[:, None] * self.change
        return np.asarray(scaled.T @ scaled + np.diag(self.independent_var_K2))


Sources = Mapping[str, tuple["SensorWindow", str]]  # by channel, the one that is read instead


@dataclass(frozen=True)
class SensorWindow:
    """Window means of one disk; W windows, R blocks, C channels in the order of the disk's rows.

    The outer row is predicted from the inner row; the inner row itself only in the first seconds
    after an event, when the bore has no effect yet, by a rim that reaches to the bore.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    blocks
        The disk from before the loading to some seconds after the unloading.
    means
        Averaging matrix of the blocks, (W, R).
    event
        Event before each window, (W,): first "steady", then "unloading", then "loading".
    after_s
        Middle of each window since its event, (W,).
    levels
        Level of each channel, or its change since the base, (W, C).
    banks
        The same through the lags of the filter bank, (C, W, K).
    slopes
        Mean rate of each channel less that of the base, (W, C) [K/s].
    noise_var
        Variance of a mean by white noise of unit variance, (W,).
    independent_var_K2
        Variance of each datum by white noise and trends, (W, C).
    rim
        The rim model in the windows.
    observed
        Which data are used, (W, C).
    """

    test: EhlTest
    disk: DiskTraces
    blocks: DiskWindow
    means: Array
    event: NDArray[np.str_]
    after_s: Array
    levels: Array
    banks: Array
    slopes: Array
    noise_var: Array
    independent_var_K2: Array
    rim: RimMeans
    observed: NDArray[np.bool_]

    @property
    def used_channels(self) -> list[str]:
        """The channels that are not excluded."""
        return [c for c in self.disk.setup.channels if c not in self.disk.excluded]

    def by_channel(self, x: Array) -> Array:
        """Values of the disk's rows, (..., C), in the order of its channels."""
        setup = self.disk.setup
        return np.asarray(x[..., [setup.rows.index(c) for c in setup.channels]])

    def rewire(self, sources: Sources) -> tuple[Array, RimMeans]:
        """Levels (W, C) and rim model with other channels in place of some of the disk's own.

        Parameters
        ----------
        sources
            By channel, the window and the channel that is read in its place.
        """
        levels = self.levels.copy()
        inputs = self.rim.inputs.copy()
        banks = self.rim.banks.copy()
        setup = self.disk.setup
        first_inner = len(setup.outer)
        for channel, (source, other) in sources.items():
            k = setup.rows.index(channel)
            j = source.disk.setup.rows.index(other)
            levels[:, k] = source.levels[:, j]
            if k >= first_inner:
                i = 1 + k - first_inner
                inputs[:, i] += levels[:, k] - self.levels[:, k]
                banks[i] += source.banks[j] - self.banks[k]
        return levels, self.rim.with_inputs(inputs, banks)

    @cached_property
    def effects(self) -> Callable[[float, float], EffectTable]:
        """Effects of all parameters on the ``observed`` data, by share and h [W/m2K], cached."""
        return cache(self._effects)

    def _effects(self, share: float, h_W_m2K: float) -> EffectTable:
        """Compute the effects of :attr:`effects`.

        Notes
        -----
        The parameters are ``nominal_parameters``, what rig.toml specifies and the angular harmonic,
        with the priors of the fits; common lag and share are free in the fits. Two things are
        simpler than there: the shape of h along the track is not varied, and the rim is taken to
        follow errors of the inner row at once. Each changes a depth by less than a tenth of its
        standard uncertainty (test B3 and D4 of the behaviour suite).

        If a lag tau of the power P becomes tau', P changes by (1 - tau/tau') (L - 1) P with the lag
        L of tau'. ``tests/partition/test_sensors.py`` compares the last effects with differences.
        """
        disk = self.disk
        setup = disk.setup
        rim = self.rim
        boundary, power = rim.response(h_W_m2K)
        perturbed = perturbed_changes(rim, boundary + share * power, share, h_W_m2K)
        boundary_gradient, power_gradient = rim.gradient(h_W_m2K)
        gradient = boundary_gradient + share * power_gradient
        constant = self.means.sum(axis=1)
        inner_slopes = self.slopes[:, len(setup.outer) :]
        errors = np.array([*[constant] * len(setup.inner), *gradient.T, *inner_slopes.T, constant])
        static = rim.gains(h_W_m2K).static
        at_once = errors[:, :, None] * steady_input_response(setup, static)[:, None]
        nominal = nominal_effects(perturbed, at_once, constant, self.slopes, disk.inner_row_weights)
        by_inner = static[rim.inner_inputs]
        uniform_h = disk.uncertainty.model_copy(update={"film_along_rel": 0.0})
        others, change_by_u = add_harmonic_effects(
            *specified_effects(replace(disk, uncertainty=uniform_h), self.blocks, share, h_W_m2K),
            harmonic_prior(self.test, disk.name),
            setup,
            h_W_m2K,
            by_inner,
            self.blocks.block_time_s - self.test.events.unload_s,
        )
        loading = (self.event == "loading")[:, None]
        risen = loading * fall_fraction(self.after_s)[:, None]
        by_rise = risen * harmonic_effect(setup, h_W_m2K, by_inner)[:, None]
        by_exponent = rim.input_response(rim.surface_air_inputs[1], h_W_m2K)
        tau_s = max(disk.mean_chain.taus_s) + LAG_STEP_S
        slower = rim.with_power(*add_lag(rim.inputs[:, 0], rim.banks[0], rim.rates_1_s, tau_s))
        by_lag = share / tau_s * (slower.input_response(POWER, h_W_m2K) - power)
        own = [*by_rise, by_exponent, by_lag, loading * by_lag, power]
        lag_u_s = max(disk.common_lag_u_s, LEAST_LAG_U_S)
        own_u = [RISE_SD_K, RISE_SD_K, 1.0, lag_u_s, LOADING_U_S, SHARE_SD]
        parameters = (*nominal_parameters(setup), *others)
        model_rel = np.repeat([MODEL_REL, INNER_MODEL_REL], [len(setup.outer), len(setup.inner)])
        independent = self.independent_var_K2 + MODEL_K**2 + (model_rel * power) ** 2
        return EffectTable(
            names=(*(parameter.name for parameter in parameters), *OWN_PARAMETERS),
            u=np.concatenate([nominal_u(disk, disk.static_u_K), np.ones(len(others)), own_u]),
            change=np.concatenate([nominal, self.means @ change_by_u, own])[:, self.observed],
            independent_var_K2=independent[self.observed],
        )


def sensor_window(test: EhlTest, disk: DiskTraces) -> SensorWindow:
    """Window of one disk; windows that the log does not hold are omitted.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.

    Notes
    -----
    Windows after the loading need a record before it and a test that is long enough. The windows
    may change; ``BORE_DELAY_S`` decides in which of them the inner row counts.
    ``tests/partition/test_sensors.py`` tests a log that ends soon after the unloading.

    From the mean of a window after an event, the straight line through the base is subtracted, so
    that a disk that still warms up, or an ambient that drifts, is not taken for a response to the
    event. A base of slope s may curve: with the time constant tau of the warm-up the error after a
    time t is s t^2/(2 tau). The outer row follows the inner row's trend, so this counts for the
    inner row only. ``tests/partition/test_depths.py`` (study) tests a disk that still warms up. The
    noise counts twice: the inner row that predicts a datum has as much.
    """
    load_on_s = test.events.load_on_s
    unload_s = test.events.unload_s
    loaded_s = unload_s - load_on_s
    event = np.repeat(
        ["steady", "unloading", "loading"], [1, len(AFTER_UNLOADING_S), len(AFTER_LOADING_S)]
    )
    after_s = np.array([STEADY_S, *AFTER_UNLOADING_S, *AFTER_LOADING_S])
    event_s = np.where(event == "loading", load_on_s, unload_s)
    start_s, stop_s = after_s.T + event_s
    start_s[0] = max(start_s[0], unload_s - 0.5 * loaded_s)
    has_loading = load_on_s - test.time_s[0] >= BASE_S and loaded_s > MIN_LOADED_S
    held = (stop_s <= test.time_s[-1] + test.dt_s) & ((event != "loading") | has_loading)
    event, event_s, start_s, stop_s = (x[held] for x in (event, event_s, start_s, stop_s))
    first_s = min(start_s[0], event_s.min() - BASE_S)
    rows = rows_between(test.time_s, first_s - FORGET_S, stop_s.max())
    near_s = (event_s[:, None] + BLOCK_STARTS_S).ravel()
    far_s = np.arange(first_s, unload_s, LONG_BLOCK_S)
    block_s = np.concatenate([far_s, near_s, start_s, stop_s])
    block_s = np.clip(block_s, *test.time_s[[rows.start, rows.stop - 1]])
    blocks = lagged_window(test, disk, rows, block_starts_s=block_s)
    setup = disk.setup
    order = setup.channel_indices(setup.rows)
    readings = setup.steel.kirchhoff_temperature(blocks.readings)[:, order]
    counts = blocks.counts
    time_s = blocks.block_time_s
    first_samples = len(readings) - np.cumsum(counts[::-1])[::-1]
    first_sample_s = blocks.time_s[first_samples]
    means = np.zeros((len(event), len(counts)))
    slopes = np.zeros((len(event), len(order)))
    curvature_K = np.zeros_like(slopes)
    for k, (start, stop) in enumerate(zip(start_s, stop_s)):
        inside = rows_between(first_sample_s, start, stop)
        if inside.start >= inside.stop:  # a slow log: the next block, or the last
            next_block = min(inside.start, len(counts) - 1)
            inside = slice(next_block, next_block + 1)
        means[k, inside] = counts[inside] / counts[inside].sum()
        if event[k] == "steady":
            continue
        base_stop_s = event_s[k] - BASE_GAP_S[event[k]]
        base = rows_between(first_sample_s, event_s[k] - BASE_S, base_stop_s)
        level = counts[base] / counts[base].sum()
        centred_s = time_s[base] - level @ time_s[base]
        trend = level * centred_s / (level @ centred_s**2)
        base_rate = trend @ blocks.y[base]
        distance_s = means[k] @ time_s - level @ time_s[base]
        means[k, base] -= level + distance_s * trend
        first = first_samples[inside.start]
        last = first + max(counts[inside].sum(), 2) - 1
        change = readings[last] - readings[first]
        slopes[k] = change / (blocks.time_s[last] - blocks.time_s[first]) - base_rate
        curvature_K[k] = 0.5 * base_rate * distance_s**2 / WARMUP_TIME_CONSTANT_S
    rim = blocks.rim.with_inputs(means @ blocks.rim.inputs, means @ blocks.rim.banks)
    banks = [means @ lag_basis_means(y, test.dt_s, rim.rates_1_s, counts) for y in readings.T]
    noise_var = means**2 @ (1.0 / counts)
    independent_var_K2 = 2 * noise_var[:, None] * disk.noise_K[order] ** 2
    independent_var_K2[:, len(setup.outer) :] += curvature_K[:, len(setup.outer) :] ** 2
    is_outer = np.arange(len(order)) < len(setup.outer)
    before_bore = (event != "steady") & (stop_s - event_s <= BORE_DELAY_S)
    return SensorWindow(
        test=test,
        disk=disk,
        blocks=blocks,
        means=means,
        event=event,
        after_s=0.5 * (start_s + stop_s) - event_s,
        levels=means @ blocks.y,
        banks=np.array(banks),
        slopes=slopes,
        noise_var=noise_var,
        independent_var_K2=independent_var_K2,
        rim=rim,
        observed=(is_outer | before_bore[:, None]) & ~disk.excluded_mask[order],
    )
