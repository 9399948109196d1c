"""Cooling fit: without power, h is the one unknown of a disk on its steady line (4.4 and 7.5).

After the unloading h alone determines how fast the compensated temperatures fall; the share follows
the steady line. The module also compensates the traces of a disk, follows the heat transfer
coefficient of disks that slow down, and gives the temperatures of the running tracks. Used by
:mod:`tcdyn.partition.analyse`, :mod:`tcdyn.partition.fit_rounds` and :mod:`tcdyn.workflows`.
Thresholds are chosen by judgement. Guarded by ``tests/partition/test_cooling.py``,
``tests/partition/test_windows.py`` and ``tests/partition/test_slowing.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.rim import Profile
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import NuisanceEffects, nuisance_effects
from tcdyn.partition.specified import constant_speed_air_offset
from tcdyn.partition.steady import (
    END_GAP_S,
    MAX_COOLING_S,
    N_ITERATIONS,
    SURFACE_DEPTH_M,
    SURFACE_MEAN_S,
    DiskLine,
    FitSensitivity,
    SteadyLine,
    surface_degC,
)
from tcdyn.partition.window import DiskWindow, disk_window, fit_rows, lagged_window
from tcdyn.rig.disk import DISKS
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import smooth
from tcdyn.smoothing.traces import DiskTraces

# Chosen by judgement.
H_RANGE_W_M2K = (5.0, 8000.0)  # range of the search for h; a fit at its ends is an error
MATCH_S = 10.0  # the model is matched to the readings over this long before the unloading [s]
MATCH_GAP_S = 0.1  # and up to this long before it [s]
LAG_STEP_S = 0.01  # step of the difference quotient by the compensated lag [s]
MIN_SPEED_RATIO = 0.01  # least surface speed, relative to that under load, in the speed law of h
TRACK_POINTS = np.linspace(0.3, 0.7, 9)  # across the running track, relative to the width
MIN_TAU_S = 1e-3  # least largest lag of a refined chain [s]
# Least lag of the others [s], far below a sample. Rates of 1e6 1/s leave ten digits in the
# eigenvalues of the smoother, rates of 1e16 1/s none.
MIN_OTHER_TAU_S = 1e-6


def require_window_longer_than_lag(test: EhlTest, window_s: float) -> None:
    """Raise InputError for a cooling window that is shorter than the lag of a disk.

    Parameters
    ----------
    test
        The test.
    window_s
        Length of the cooling [s].

    Raises
    ------
    InputError
        If it is shorter than the largest common lag of the disks.

    Notes
    -----
    The limit of one lag is chosen by judgement.
    """
    lag_s = max(disk.common_lag_s for disk in test.disks.values())
    if window_s < lag_s:
        raise InputError(
            f"the cooling window of {window_s:g} s is shorter than the lag of {lag_s:.2f} s",
            expected=f"at least {lag_s:.2f} s",
            remedy="ask for a longer window",
        )


def with_slowing_air_offset(test: EhlTest, points: Mapping[str, tuple[float, float]]) -> EhlTest:
    """The test with the surface air offset of disks that did not keep their speed.

    Parameters
    ----------
    test
        The test; one at constant speeds is returned as it is.
    points
        Share and h [W/m2K] of each disk.

    Notes
    -----
    The surface loses h (u/u_0)^n (T_s - T_A). That is the loss under load with air at the running
    surface, and only there, that is ((u/u_0)^n - 1)(T_s - T_A) colder. T_s is the mean temperature
    of the running surface by the model itself, so air and surface are computed in turn. The second
    column is the change by a standard uncertainty of n, which is uniform over its range.

    ``N_ITERATIONS`` may grow. The columns must be those of
    ``tcdyn.partition.specified.constant_speed_air_offset``. ``tests/partition/test_slowing.py``
    (study) compares the model with a simulated whole disk.
    """
    if not test.relative_speed:
        return test
    rows = fit_rows(test, min(MAX_COOLING_S, float(test.time_s[-1] - test.events.unload_s)))
    for _ in range(N_ITERATIONS):
        offsets = {
            d: _slowing_air_offset(test, test.disks[d], rows, *points[d])
            for d in test.relative_speed
            if d in test.disks
        }
        test = replace(test, surface_air_offset_K={**test.surface_air_offset_K, **offsets})
    return test


def _slowing_air_offset(
    test: EhlTest, disk: DiskTraces, rows: slice, share: float, h_W_m2K: float
) -> Array:
    """``surface_air_offset_K`` of one slowing disk, (N, 2) [K].

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    rows
        Rows in which the surface temperature is computed.
    share, h_W_m2K
        Share and heat transfer coefficient of the model.

    Notes
    -----
    The surface temperature of a lagged window is late by the lag of the mean chain; the times are
    shifted back by it.
    """
    window = lagged_window(test, disk, rows)
    speed = np.maximum(test.relative_speed[disk.name], MIN_SPEED_RATIO)
    at_constant_speed = constant_speed_air_offset(test, disk)
    superheat_of_blocks = (
        surface_degC(window, share, h_W_m2K)
        - window.rim.inputs[:, window.rim.ambient_index]
        - window.blocks @ at_constant_speed[rows, 0]
    )
    lag_s = disk.mean_chain.lag_s
    superheat = np.interp(test.time_s + lag_s, window.block_time_s, superheat_of_blocks)
    h_ratio = speed**test.speed_exponent
    exponent_u = test.exponent_half_range / np.sqrt(3)
    by_exponent = -exponent_u * h_ratio * np.log(speed) * superheat
    return at_constant_speed + np.column_stack([(1 - h_ratio) * superheat, by_exponent])


@dataclass(frozen=True)
class CompensatedDisk:
    """One disk's compensated traces over some rows of a test, and the windows made of them.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    compensated
        The compensated traces.
    window
        The window of the compensated traces.
    longer_lag_window
        The same with ``LAG_STEP_S`` more lag removed.
    noise_K
        Standard deviation of the noise that compensation leaves in a trace of the outer row.
    """

    test: EhlTest
    disk: DiskTraces
    compensated: Compensated
    window: DiskWindow
    longer_lag_window: DiskWindow
    noise_K: float

    @property
    def used_traces(self) -> Compensated:
        """The compensated traces, NaN for an excluded channel."""
        mask = np.where(self.disk.excluded_mask, np.nan, 0.0)
        traces = self.compensated
        return replace(traces, temperature=traces.temperature + mask, sd=traces.sd + mask)


@dataclass(frozen=True)
class CoolingFit:
    """h [W/m2K] and share of one disk from its cooling.

    Parameters
    ----------
    disk
        Name of the disk.
    h_W_m2K, share, beta
        The fitted h, the share on the steady line, and beta of the fast disk.
    window_s
        Length of the cooling used.
    misfit_K
        Root mean square of the residuals over the window.
    h_per_effect
        Change of the fitted h by a change of the prediction of each mean, (R, P) [W/m2K per K].
    power
        Response of the model to a share of one, (R, P) [K].
    h_noise
        Standard uncertainty of h by the noise of the compensated traces only [W/m2K].
    """

    disk: str
    h_W_m2K: float
    share: float
    beta: float
    window_s: float
    misfit_K: float
    h_per_effect: Array
    power: Array
    h_noise: float


@dataclass(frozen=True)
class CoolingSensitivity(FitSensitivity):
    """Sensitivity of (share, h) of a cooling fit.

    Parameters
    ----------
    parameters, per_sd, noise
        As of :class:`tcdyn.partition.steady.FitSensitivity`.
    by_lag
        Change of (share, h) per second by which the compensated lag is too long, (2,).
    """

    by_lag: Array


def lag_covariance_with_common_u(covariance_s2: Array, common_u_s: float) -> Array:
    """Covariance of lags with given differences and another uncertainty of their mean, (M, M) [s2].

    Parameters
    ----------
    covariance_s2
        Covariance of the lags, (M, M) [s2], of which only the differences from the mean are kept.
    common_u_s
        Standard uncertainty of their mean [s].

    Examples
    --------
    >>> lag_covariance_with_common_u(np.full((2, 2), 0.25), 0.1).round(4)
    array([[0.01, 0.01],
           [0.01, 0.01]])
    """
    n_channels = len(covariance_s2)
    centre = np.eye(n_channels) - 1.0 / n_channels
    return np.asarray(centre @ covariance_s2 @ centre.T + common_u_s**2)


def refined_chains(chains: Sequence[Chain], common: Chain) -> tuple[Chain, ...]:
    """The common chain for every channel, its largest lag shifted by the channel's own difference.

    That is the difference of the channel's lag from the mean of ``chains``.

    Parameters
    ----------
    chains
        Chains of the channels by the record.
    common
        Common chain by the joint fit.

    Notes
    -----
    The joint fit determines only the common lag; differences between channels are the record's.
    ``MIN_TAU_S`` and ``MIN_OTHER_TAU_S`` keep the lags positive: a second lag that the data do not
    determine may be 1e-17 s.
    """
    mean_s = float(np.mean([chain.lag_s for chain in chains]))
    longest, *others = sorted(common.taus_s, reverse=True)
    others = [max(tau, MIN_OTHER_TAU_S) for tau in others]
    return tuple(
        replace(common, taus_s=(max(longest + chain.lag_s - mean_s, MIN_TAU_S), *others))
        for chain in chains
    )


def smooth_traces(
    test: EhlTest,
    disk: DiskTraces,
    rows: slice,
    chains: tuple[Chain, ...],
    lag_u_s: float,
    like: Compensated | None = None,
) -> Compensated:
    """Compensate the traces of a disk by the fixed-interval smoother, with known slope changes.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    rows
        Rows of the test to smooth.
    chains
        Chain of each channel.
    lag_u_s
        Standard uncertainty of their common lag [s].
    like
        Traces from the same first row on whose process-noise intensities are used; without it these
        are estimated by their likelihood.

    Notes
    -----
    A slow unloading is two known slope changes, at its start and at its end: as one in the middle
    it would bias h, which ``tests/partition/test_cooling.py`` (study) tests.
    """
    start_s = test.time_s[rows][0]
    end_s = test.time_s[rows][-1]
    return smooth(
        disk.measured_degC[rows],
        test.dt_s,
        chains,
        noise_sd=disk.noise_K,
        intensity=None if like is None else like.intensities,
        events_s=tuple(
            float(time_s - start_s) for time_s in test.events.slope_changes_s if time_s < end_s
        ),
        event_u_s=test.events.unload_u_s,
        lag_covariance=lag_covariance_with_common_u(disk.lag_covariance_s2, lag_u_s),
        static_u=disk.static_u_K,
    )


def compensate_disk(
    test: EhlTest, disk: DiskTraces, rows: slice, traces: Compensated, profile: Profile = "modal"
) -> CompensatedDisk:
    """Windows of one disk's compensated traces.

    Parameters
    ----------
    test, disk, rows
        As of :func:`smooth_traces`.
    traces
        The traces by :func:`smooth_traces`.
    profile
        Profile of the inner boundary along z.
    """

    def window_with(longer_s: float) -> DiskWindow:
        """The window with ``longer_s`` seconds more lag removed, to first order."""
        temperature = traces.temperature + longer_s * traces.lag_sensitivity
        return disk_window(test, disk, temperature, rows, disk.noise_K, profile)

    outer = disk.setup.channel_indices(disk.setup.outer)
    noise_K = float(np.median(traces.sd_noise[:, outer]))
    return CompensatedDisk(test, disk, traces, window_with(0.0), window_with(LAG_STEP_S), noise_K)


def cooling_effects(
    cooled: CompensatedDisk, share: float, h_W_m2K: float
) -> tuple[NuisanceEffects, Array]:
    """Effects of all errors on a compensated window, linearised at (share, h).

    Parameters
    ----------
    cooled
        The compensated disk, R blocks.
    share, h_W_m2K
        The cooling fit.

    Returns
    -------
    effects
        Effects of the nuisance parameters.
    by_lag
        Predicted less compensated outer row per second by which the compensated lag is too long,
        (R, P) [K/s].
    """
    window = cooled.window
    longer = cooled.longer_lag_window
    boundary = window.rim.boundary_inputs
    predicted = longer.rim.input_response(boundary, h_W_m2K)
    predicted -= window.rim.input_response(boundary, h_W_m2K)
    by_lag = (predicted - (longer.y - window.y)) / LAG_STEP_S
    return nuisance_effects(cooled.test, cooled.disk, window, share, h_W_m2K), by_lag


def cooling_sensitivity(
    fit: CoolingFit, effects: NuisanceEffects, lag_effect: Array, line: DiskLine
) -> CoolingSensitivity:
    """Sensitivity of (share, h), through the traces and through the line.

    Parameters
    ----------
    fit
        The cooling fit.
    effects, lag_effect
        The two results of :func:`cooling_effects`.
    line
        Steady line of the disk, with its sensitivity.

    Notes
    -----
    An error changes the line, so that the share on it changes at given h, and the readings, so that
    h changes; the share then follows h along the line. The nuisance parameters of ``effects`` and
    of the line must be the same, in the same order. The noise of the line is added to the share's
    own.
    """
    slope = line.line.slope
    share_errors = line.sensitivity.per_sd @ np.array([1.0, fit.h_W_m2K])
    prediction_errors = share_errors[:, None, None] * fit.power - effects.change
    h_errors = np.einsum("rp,qrp->q", fit.h_per_effect, prediction_errors)
    along_line = np.array([slope, 1.0])
    noise = fit.h_noise**2 * np.outer(along_line, along_line)
    noise[0, 0] += line.sensitivity.noise[0, 0]
    per_sd = np.column_stack([share_errors + slope * h_errors, h_errors])
    by_lag = along_line * float((fit.h_per_effect * lag_effect).sum())
    return CoolingSensitivity(effects.parameters, per_sd, noise, by_lag)


def cooling_fit(
    window: DiskWindow,
    line: SteadyLine,
    unload_s: float,
    window_s: float,
    noise_K: float,
    log_h_prior: tuple[float, float] = (0.0, np.inf),
) -> CoolingFit:
    """Fit h to compensated traces; the share follows the steady line.

    Parameters
    ----------
    window
        Window of the compensated traces.
    line
        Steady line of the disk.
    unload_s
        Instant of unloading [s].
    window_s
        Length of the cooling used [s].
    noise_K
        Standard deviation of the noise that compensation leaves in a trace [K].
    log_h_prior
        Prior mean and standard deviation of log h (h in W/m2K).

    Raises
    ------
    InputError
        If the best h is at an end of ``H_RANGE_W_M2K``.

    Notes
    -----
    Each outer junction is compared with the model after both are matched over the last ``MATCH_S``
    seconds under load, so that static errors, which the steady line already holds, do not enter
    twice. ``MATCH_S``, ``MATCH_GAP_S`` and ``H_RANGE_W_M2K`` may change. ``h_per_effect`` must have
    the weights and the matching of the cost: ``tests/partition/test_cooling.py`` compares it with a
    second fit.
    """
    since_s = window.block_time_s - unload_s
    inside = (since_s >= 0) & (since_s < window_s)
    before = (since_s >= -MATCH_S) & (since_s < -MATCH_GAP_S)
    weight = window.counts[inside][:, None].astype(float) * window.used_channels
    prior_mean, prior_sd = log_h_prior

    def model(h: float) -> tuple[Array, Array]:
        """Prediction of the outer row on the steady line, and the response to a share of one."""
        boundary, power = window.rim.response(h)
        return boundary + line.at(h) * power, power

    def matched(x: Array) -> Array:
        """Departure from the mean over the last seconds under load."""
        return np.asarray(x - x[before].mean(axis=0))

    target = matched(window.y)

    def cost(log_h: float) -> float:
        """Weighted sum of squares plus the prior of log h times the noise variance [K2]."""
        predicted, _ = model(float(np.exp(log_h)))
        residual = (target - matched(predicted))[inside]
        prior = (noise_K * (log_h - prior_mean) / prior_sd) ** 2
        return float((weight * residual**2).sum()) + prior

    low, high = np.log(H_RANGE_W_M2K)
    best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
    if min(best.x - low, high - best.x) < 1e-2:
        raise InputError(
            f"the cooling fit of the {window.disk} disk runs to h = {np.exp(best.x):.3g} W/m2K",
            expected=f"an h between {H_RANGE_W_M2K[0]:g} and {H_RANGE_W_M2K[1]:g} W/m2K",
            remedy="the lag or the instant of unloading may be wrong; compare with the joint fit",
        )
    h = float(np.exp(best.x))
    predicted, power = model(h)
    step = 1e-3 * h
    h_slope = matched((model(h + step)[0] - model(h - step)[0]) / (2 * step))[inside]
    residual = (target - matched(predicted))[inside]
    information = (weight * h_slope * h_slope).sum() + (noise_K / (h * prior_sd)) ** 2
    h_per_effect = np.zeros_like(power)
    h_per_effect[inside] = -weight * h_slope / information
    h_per_effect[before] -= h_per_effect[inside].sum(axis=0) / before.sum()
    share = line.at(h)
    return CoolingFit(
        disk=window.disk,
        h_W_m2K=h,
        share=share,
        beta=share if window.disk == "fast" else 1.0 - share,
        window_s=window_s,
        misfit_K=float(np.sqrt((weight * residual**2).sum() / weight.sum())),
        h_per_effect=h_per_effect,
        power=power,
        h_noise=float(np.sqrt(information) * noise_K / information),
    )


def surface_temperatures(
    test: EhlTest,
    estimated: Mapping[str, float],
    windows: Mapping[str, DiskWindow],
    estimate_samples: Mapping[str, Array],
) -> tuple[dict[str, float], dict[str, Array]]:
    """Maximum temperature of each running track before unloading, with Monte Carlo samples.

    Parameters
    ----------
    test
        The test.
    estimated
        "speed law", "h_fast" and "h_slow"; with one disk "joint fast" and "h joint fast", or those
        of the slow disk.
    windows
        Window of each disk.
    estimate_samples
        Monte Carlo samples of ``estimated``.

    Returns
    -------
    values, samples
        "surface fast" and "surface slow" [degC], and with both disks (T_fast - T_slow) u_s [K m/s]
        as "delta_T_us" (figure 7.18).

    Notes
    -----
    Temperatures are means over the last seconds under load; the maximum is that of the points
    ``TRACK_POINTS`` across the track. The samples are linear in beta and h.
    """
    values = dict[str, float]()
    samples = dict[str, Array]()
    for d, window in windows.items():
        beta_key = "speed law"
        h_key = f"h_{d}"
        if beta_key not in estimated:
            beta_key = f"joint {d}"
            h_key = f"h joint {d}"
        beta = estimated[beta_key]
        h = estimated[h_key]
        share = beta if d == "fast" else 1 - beta
        sign = 1 if d == "fast" else -1
        setup = window.rim.setup
        since_s = window.block_time_s - test.events.unload_s
        last = (since_s >= -SURFACE_MEAN_S) & (since_s < -END_GAP_S)
        points = tuple((SURFACE_DEPTH_M, float(z)) for z in TRACK_POINTS * setup.width_m)
        step = 0.01 * max(h, 10.0)
        responses = window.rim.response(max(h, 0.0) + np.array([0.0, step]), extra=points)
        boundary, power = (x[:, last, len(setup.outer) :].mean(axis=1) for x in responses)
        track = boundary + share * power  # (2, 9)
        # back from Kirchhoff's temperature, to first order
        track -= setup.steel.kirchhoff_temperature(track) - track
        hottest = int(np.argmax(track[0]))
        temperature = track[0, hottest]
        by_h = (track[1, hottest] - temperature) / step
        by_beta = sign * power[0, hottest]
        deviation = by_beta * (estimate_samples[beta_key] - beta)
        deviation = deviation + by_h * (estimate_samples[h_key] - h)
        values[f"surface {d}"] = float(temperature)
        samples[f"surface {d}"] = temperature + deviation
    if len(windows) == len(DISKS):
        difference = values["surface fast"] - values["surface slow"]
        sampled_difference = samples["surface fast"] - samples["surface slow"]
        values["delta_T_us"] = difference * test.sliding_speed_m_s
        samples["delta_T_us"] = sampled_difference * test.sliding_speed_m_s
    return values, samples
