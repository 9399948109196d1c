"""Steady line of each disk in the plane of share and h, and the speed law on both lines.

Under steady load the outer row determines one combination of share and h: share = A + B h,
equations (4.1) and (4.2). The speed law h_f/h_s = (u_f/u_s)^n, (4.6), selects a point on both
lines, (4.7). The lines start all transient fits, and the cooling fit stays on them. The module also
holds the corrections of a test that need a share and an h: an inner row at several depths, and
steel that depends on temperature. Used by :mod:`tcdyn.partition.analyse`,
:mod:`tcdyn.partition.cooling`, :mod:`tcdyn.verify` and :mod:`tcdyn.plots.partition`. Guarded by
``tests/partition/test_steady.py`` (the thesis's own numbers) and
``tests/partition/test_inner_row.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.heat.rim import Profile
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import inner_gradient, nuisance_effects
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.partition.specified import depends_on_temperature, linear_about
from tcdyn.partition.window import DiskWindow, fit_rows, lagged_window
from tcdyn.rig.disk import DISKS, DiskSetup
from tcdyn.smoothing.traces import DiskTraces

# The grid of the maps, h in W/m2K; section 4.3.
H_GRID_W_M2K: Array = np.asarray(np.arange(100.0, 1201.0, 100.0), dtype=np.float64)
SHARE_GRID: Array = np.asarray(np.arange(0.1, 1.01, 0.1), dtype=np.float64)
# Nodes of ``H_GRID_W_M2K`` between which the sensitivity of a line is taken.
LOW_NODE = 2
HIGH_NODE = len(H_GRID_W_M2K) - 3
# Steady means end this long before the unloading, which is known less well than a sample [s].
# Chosen by judgement.
END_GAP_S = 0.2
# Start of the transient fits: least and largest h, and h for one disk [W/m2K]. Chosen by
# judgement. The largest matters where the logged power is several times the true power.
MIN_START_H_W_M2K = 50.0
MAX_START_H_W_M2K = 2000.0
START_H_W_M2K = 400.0
# Chosen by judgement: longest cooling for which corrections are computed [s]; length of the
# means before the unloading that give temperatures there [s]; number of points across the running
# surface.
MAX_COOLING_S = 20.0
SURFACE_MEAN_S = 10.0
N_SURFACE_POINTS = 12
SURFACE_DEPTH_M = 0.0  # the running surface [m]
# Iterations of corrections that need share and h. The second changes them by a hundredth of what
# the first does.
N_ITERATIONS = 2


@dataclass(frozen=True)
class SteadyLine:
    """share = intercept + slope h, by the steady temperatures of one disk; (4.1), (4.2).

    Parameters
    ----------
    intercept
        Share at h = 0. The share is beta for the fast disk and 1 - beta for the slow one.
    slope
        Change of the share with h [1/(W/m2K)].
    """

    intercept: float
    slope: float

    def at(self, h_W_m2K: float) -> float:
        """The share that fits the steady temperatures at ``h_W_m2K``."""
        return self.intercept + self.slope * h_W_m2K


@dataclass(frozen=True)
class SteadyMap:
    """Misfit of one disk over a grid of shares and h, and the line of least misfit.

    Parameters
    ----------
    h_W_m2K, share
        The grid, (n_h,) and (n_share,).
    mean_abs_K
        Mean absolute misfit, (n_h, n_share).
    best_share
        For each h, the share of least squares, (n_h,).
    line
        Straight line through ``best_share``.
    """

    h_W_m2K: Array
    share: Array
    mean_abs_K: Array
    best_share: Array
    line: SteadyLine


@dataclass(frozen=True)
class SpeedLawPoint:
    """beta and both heat transfer coefficients [W/m2K] where the lines have h_fast / h_slow = chi.

    Parameters
    ----------
    beta, h_fast, h_slow, chi
        The point; NaN for a test with one disk.
    starts
        Share and h [W/m2K] of each disk, for a transient fit to start from.
    """

    beta: float
    h_fast: float
    h_slow: float
    chi: float
    starts: Mapping[str, tuple[float, float]]


def speed_ratio_power(speed_ratio: float, exponent: float) -> float:
    """chi = (u_f / u_s)^n, eq. (4.6).

    Parameters
    ----------
    speed_ratio
        u_f/u_s of the surface speeds.
    exponent
        Exponent n of the speed law.

    Examples
    --------
    >>> round(speed_ratio_power(4.24, 0.667), 2)
    2.62
    """
    return float(speed_ratio**exponent)


def speed_law_beta(A: Any, B: Any, C: Any, D: Any, chi: Any) -> Any:
    """beta by the speed law from both steady lines, eq. (4.7) corrected.

    Parameters
    ----------
    A, B
        Intercept and slope of the fast line beta = A + B h_f.
    C, D
        Intercept and slope of the slow line 1 - beta = C + D h_s.
    chi
        h_f / h_s.

    Notes
    -----
    beta = (A D + chi B (1 - C)) / (D + chi B): eq. (4.7) as it must read with (4.1), (4.2) and
    (4.6). The thesis prints (4.7) for a slow line written for beta. Numbers or arrays; the Monte
    Carlo simulation of ``tcdyn.partition.crosscheck`` calls it with samples.
    ``tests/partition/test_steady.py`` compares it with the thesis's beta.

    Examples
    --------
    >>> B, D = (0.83 - 0.37) / 1100, (0.48 - 0.20) / 1100
    >>> round(speed_law_beta(0.37 - 100 * B, B, 0.20 - 100 * D, D, 4.24**0.667), 2)
    0.73
    """
    return (A * D + chi * B * (1 - C)) / (D + chi * B)


def speed_law(
    fast: SteadyLine, slow: SteadyLine, speed_ratio: float, exponent: float
) -> SpeedLawPoint:
    """The point of both lines that obeys h_fast = (u_f/u_s)^n h_slow.

    Parameters
    ----------
    fast, slow
        The steady lines.
    speed_ratio
        u_f/u_s of the surface speeds.
    exponent
        Exponent n of the speed law.

    Raises
    ------
    InputError
        If a line does not rise with h: then the data contradict the model.

    Notes
    -----
    ``MIN_START_H_W_M2K`` and ``MAX_START_H_W_M2K`` limit only the starts of the transient fits, not
    the point. The share of a start is that of its line at the limited h.
    """
    chi = speed_ratio_power(speed_ratio, exponent)
    if fast.slope <= 0 or slow.slope <= 0:
        raise InputError(
            f"a steady line falls with h (slopes {fast.slope:.3g} and {slow.slope:.3g})",
            expected="more loss to need more heat",
            remedy="check that no channels are swapped and that depths in rig.toml are those of "
            "this disk",
        )
    beta = speed_law_beta(fast.intercept, fast.slope, slow.intercept, slow.slope, chi)
    h_fast = (beta - fast.intercept) / fast.slope
    h_slow = h_fast / chi
    starts = {}
    for disk, line, h in (("fast", fast, h_fast), ("slow", slow, h_slow)):
        start_h = min(max(h, MIN_START_H_W_M2K), MAX_START_H_W_M2K)
        starts[disk] = (line.at(start_h), start_h)
    return SpeedLawPoint(beta, h_fast, h_slow, chi, starts)


def exponent_sensitivity(
    fast: SteadyLine, slow: SteadyLine, speed_ratio: float, exponents: Array
) -> Array:
    """beta by the speed law for each exponent n (figure 4.17), shape of ``exponents``.

    Parameters
    ----------
    fast, slow
        The steady lines.
    speed_ratio
        u_f/u_s of the surface speeds.
    exponents
        Exponents n.

    Examples
    --------
    >>> B, D = 0.46 / 1100, 0.28 / 1100
    >>> lines = SteadyLine(0.37 - 100 * B, B), SteadyLine(0.20 - 100 * D, D)
    >>> exponent_sensitivity(*lines, 4.24, np.array([0.571, 0.667, 0.8])).round(2)
    array([0.72, 0.73, 0.75])
    """
    chi = speed_ratio ** np.asarray(exponents, dtype=float)
    return np.asarray(speed_law_beta(fast.intercept, fast.slope, slow.intercept, slow.slope, chi))


def steady_map(
    y: Array,
    boundary: Array,
    per_share: Array,
    h_W_m2K: Array = H_GRID_W_M2K,
    share: Array = SHARE_GRID,
    weights: Array | None = None,
) -> SteadyMap:
    """Misfit over (h, share) and the line of least misfit.

    Parameters
    ----------
    y
        Measured outer row, (rows, P) [degC].
    boundary
        Model without frictional heat, (n_h, rows, P) [degC].
    per_share
        Response of the model to a share of one, (n_h, rows, P) [K].
    h_W_m2K, share
        The grid, (n_h,) and (n_share,).
    weights
        Weights of the P junctions: (7.1) gives each the same, (7.2) a double one to ``a``.

    Notes
    -----
    The model is linear in the share, so for each h the best share is one division, and the map
    needs no further run of the model. (The thesis fits a parabola to the error along each h, figure
    4.10, and then a straight line through the minima.) ``share`` affects only the map, not the
    line. ``tests/partition/test_steady.py`` recovers an exact line, and tests the weights.
    """
    w = np.ones(y.shape[1]) if weights is None else np.asarray(weights, dtype=float)
    w = w / w.sum()
    excess = y[None] - boundary
    projection = np.einsum("hrp,hrp,p->h", excess, per_share, w)
    best_share = projection / np.einsum("hrp,hrp,p->h", per_share, per_share, w)
    misfit = excess[:, None] - share[None, :, None, None] * per_share[:, None]
    mean_abs = np.einsum("hsrp,p->hs", np.abs(misfit), w) / y.shape[0]
    slope, intercept = np.polyfit(h_W_m2K, best_share, 1)
    line = SteadyLine(float(intercept), float(slope))
    return SteadyMap(h_W_m2K, share, mean_abs, best_share, line)


@dataclass(frozen=True)
class FitSensitivity:
    """Sensitivity of k fitted numbers to the nuisance parameters, and their noise.

    The fitted numbers are (intercept, slope) of a steady line, (share, h [W/m2K]) of a cooling fit,
    or (share, h, lag [s]) of a joint fit.

    Parameters
    ----------
    parameters
        The Q nuisance parameters.
    per_sd
        Error of the fit when the true disk departs by one standard uncertainty from the nominal
        one, (Q, k).
    noise
        Covariance by noise, (k, k).
    """

    parameters: tuple[NuisanceParameter, ...]
    per_sd: Array
    noise: Array


@dataclass(frozen=True)
class DiskLine:
    """Map and line of one disk; the sensitivity is computed when it is needed.

    Parameters
    ----------
    map
        The misfit over shares and h.
    line
        The steady line.
    compute_sensitivity
        Computes :attr:`sensitivity`.
    """

    map: SteadyMap
    line: SteadyLine
    compute_sensitivity: Callable[[], FitSensitivity] = field(repr=False)

    @cached_property
    def sensitivity(self) -> FitSensitivity:
        """Sensitivity of (intercept, slope) to the nuisance parameters."""
        return self.compute_sensitivity()


def disk_line(
    test: EhlTest,
    disk: DiskTraces,
    rows: slice,
    profile: Profile = "modal",
    weights: Array | None = None,
) -> DiskLine:
    """Line of least misfit over the steady blocks of the uncompensated readings.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    rows
        Rows of the test, by :func:`tcdyn.partition.window.fit_rows`.
    profile
        Profile of the inner boundary along z.
    weights
        Weights of the outer row, (P,): equal (7.1) unless given; (7.2) doubles that of a.

    Notes
    -----
    Steady blocks end ``END_GAP_S`` before the unloading. Under steady load compensation changes
    nothing, so the readings are used as logged. Excluded channels have no weight;
    ``tests/partition/test_left_out.py`` tests the line without one (study).
    """
    window = lagged_window(test, disk, rows, profile)
    used = window.used_channels.astype(float)
    channel_weights = used if weights is None else weights * used
    steady = window.block_time_s < test.events.unload_s - END_GAP_S
    boundary, power = (x[:, steady] for x in window.rim.response(H_GRID_W_M2K))
    steady_fit = steady_map(window.y[steady], boundary, power, weights=channel_weights)
    line = steady_fit.line
    compute = partial(_line_sensitivity, test, disk, window, line, power, channel_weights, steady)
    return DiskLine(steady_fit, line, compute)


def _line_sensitivity(
    test: EhlTest,
    disk: DiskTraces,
    window: DiskWindow,
    line: SteadyLine,
    power: Array,
    weights: Array,
    steady: Flags,
) -> FitSensitivity:
    """Sensitivity of (intercept, slope) of a line to the nuisance parameters, and its noise.

    Parameters
    ----------
    test, disk, window, line
        The test, the traces of the disk, its window and its line.
    power
        Response to a share of one at the ``steady`` blocks, (n_h, r, P) [K].
    weights
        Weights of the outer row, (P,).
    steady
        Mask of the steady blocks, (R,).

    Notes
    -----
    The error of the share at two nodes of h gives that of intercept and slope. The noise is that of
    the share at the lower node, and is assigned to the intercept. ``LOW_NODE`` and ``HIGH_NODE``
    may change: the error is nearly a straight line in h. ``tests/partition/test_joint.py`` (study)
    compares the result with a simulated whole disk.
    """
    w = weights / weights.sum()
    share_errors = []
    for k in (LOW_NODE, HIGH_NODE):
        h = float(H_GRID_W_M2K[k])
        nuisances = nuisance_effects(test, disk, window, line.at(h), h)
        size = np.einsum("rp,rp,p->", power[k], power[k], w)
        projection = np.einsum("qrp,rp,p->q", nuisances.change[:, steady], power[k], w)
        share_errors.append(projection / size)
    at_low, at_high = share_errors
    h_low = float(H_GRID_W_M2K[LOW_NODE])
    h_high = float(H_GRID_W_M2K[HIGH_NODE])
    slope = (at_high - at_low) / (h_high - h_low)
    used = window.used_channels
    weighted_power = power[LOW_NODE] * w
    noise_terms = weighted_power[:, used] / window.weight[steady][:, used]
    variance = 2.0 * (noise_terms**2).sum()  # twice: the boundary readings have the same noise
    noise = float(np.sqrt(variance)) / (weighted_power * power[LOW_NODE]).sum()
    per_sd = np.column_stack([at_low - slope * h_low, slope])
    return FitSensitivity(nuisances.parameters, per_sd, np.diag([noise**2, 0.0]))


def steady_lines(
    test: EhlTest, rows: slice, profile: Profile = "modal", weights: Array | None = None
) -> tuple[dict[str, DiskLine], SpeedLawPoint]:
    """Steady line of each disk from the uncompensated readings, and the speed law's point.

    For a test with one disk the point has only the start of its transient fit.

    Parameters
    ----------
    test
        The test, with one or both disks.
    rows, profile, weights
        As of :func:`disk_line`.

    Returns
    -------
    lines
        The line of each disk.
    point
        The point of both lines by the speed law.

    Raises
    ------
    InputError
        If a line does not rise with h.
    """
    lines = {
        name: disk_line(test, disk, rows, profile, weights) for name, disk in test.disks.items()
    }
    if len(lines) < len(DISKS):
        starts = {d: (fit.line.at(START_H_W_M2K), START_H_W_M2K) for d, fit in lines.items()}
        return lines, SpeedLawPoint(np.nan, np.nan, np.nan, np.nan, starts)
    fast = lines["fast"].line
    slow = lines["slow"].line
    return lines, speed_law(fast, slow, test.speed_ratio, test.speed_exponent)


def _cooling_rows(test: EhlTest) -> slice:
    """Rows up to the longest cooling that any fit uses, or the end of the log."""
    return fit_rows(test, min(MAX_COOLING_S, float(test.time_s[-1] - test.events.unload_s)))


def with_inner_row_at_one_radius(test: EhlTest) -> EhlTest:
    """The test with ``inner_offset_K``, the correction of the inner row to one radius.

    Notes
    -----
    The correction is the radial gradient times how much deeper than the rim's edge a junction lies.
    The rim begins at its edge, the depth of b, and d and f are taken to read the temperature there
    (eq. 3.34). Where rig.toml states another depth, the gradient of the model itself, at the speed
    law's share and h, gives what they would read there. First order in the difference: good for
    some tenths of a millimetre. A test whose disks have an inner row of one depth is returned as it
    is.

    Fits and sensor check add the correction to the inputs of the rim, in
    ``tcdyn.partition.window.disk_window``. ``tests/partition/test_inner_row.py`` fails without it.
    """
    depth_differences = {
        name: disk.setup.depth_below_edge_m
        for name, disk in test.disks.items()
        if np.any(disk.setup.depth_below_edge_m)
    }
    if not depth_differences:
        return test
    rows = _cooling_rows(test)
    for _ in range(N_ITERATIONS):
        _, speed = steady_lines(test, rows)
        corrected = {
            d: _at_one_radius(test, test.disks[d], rows, deeper_m, *speed.starts[d])
            for d, deeper_m in depth_differences.items()
        }
        test = replace(test, disks={**test.disks, **corrected})
    return test


def _at_one_radius(
    test: EhlTest, disk: DiskTraces, rows: slice, deeper_m: Array, share: float, h_W_m2K: float
) -> DiskTraces:
    """The traces with ``inner_offset_K`` by the gradient at (share, h).

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    rows
        Rows in which the gradient is computed; later rows take its last value.
    deeper_m
        How much deeper than the edge each junction of the inner row lies, (k,) [m].
    share, h_W_m2K
        Share and heat transfer coefficient of the model.
    """
    correction = np.zeros_like(disk.inner_offset_K)
    gradient = inner_gradient(lagged_window(test, disk, rows), share, h_W_m2K)
    correction[rows] = gradient * deeper_m
    correction[rows.stop :] = correction[rows.stop - 1]
    return replace(disk, inner_offset_K=correction)


def with_linear_steel(test: EhlTest) -> EhlTest:
    """The test with steel that depends on temperature linearised about air and running surface.

    Both temperatures are means over the last seconds under load, the surface's by the model itself
    at the speed law's share and h. The first iteration takes the steel at the temperature of the
    readings. A test whose steel does not depend on temperature is returned as it is.

    Notes
    -----
    Must come before ``with_inner_row_at_one_radius`` (see
    ``tcdyn.partition.analyse.apply_corrections``), because the gradient depends on the steel.
    ``tests/partition/test_statement.py`` (study) fails if the bias of a stated slope remains.
    """
    names = [
        name
        for name, disk in test.disks.items()
        if depends_on_temperature(disk.setup, disk.uncertainty)
    ]
    if not names:
        return test
    rows = _cooling_rows(test)
    nominal = test.disks
    starts: Mapping[str, tuple[float, float] | None] = dict.fromkeys(DISKS)
    for k in range(N_ITERATIONS + 1):
        if k:
            starts = steady_lines(test, rows)[1].starts
        linear = {
            d: replace(nominal[d], setup=_linear_steel(test, nominal[d].setup, d, rows, starts[d]))
            for d in names
        }
        test = replace(test, disks={**nominal, **linear})
    return test


def _linear_steel(
    test: EhlTest, setup: DiskSetup, disk: str, rows: slice, point: tuple[float, float] | None
) -> DiskSetup:
    """The set-up of a disk linearised about its temperatures under load.

    Parameters
    ----------
    test
        The test.
    setup
        The nominal set-up of the disk.
    disk
        Name of the disk.
    rows
        Rows of the test.
    point
        Share and h [W/m2K] that give the surface; None to take the rim's temperature instead.
    """
    window = lagged_window(test, test.disks[disk], rows)
    rim = window.rim
    since_s = window.block_time_s - test.events.unload_s
    last = (since_s >= -SURFACE_MEAN_S) & (since_s < -END_GAP_S)
    air_degC = float(rim.inputs[last, rim.ambient_index].mean())
    rim_degC = float(rim.inputs[last, rim.inner_inputs].mean())
    if point is None:
        return linear_about(setup, air_degC, rim_degC, rim_degC)
    at_surface_degC = float(surface_degC(window, *point)[last].mean())
    return linear_about(setup, air_degC, at_surface_degC, rim_degC)


def surface_degC(window: DiskWindow, share: float, h_W_m2K: float) -> Array:
    """Mean temperature of the running surface by the model, (R,) [degC].

    Parameters
    ----------
    window
        Window of the disk, R blocks.
    share, h_W_m2K
        Share and heat transfer coefficient of the model.

    Notes
    -----
    The mean over ``N_SURFACE_POINTS`` points across the width. In a lagged window the temperature
    lags, too.
    """
    setup = window.rim.setup
    z_m = (np.arange(N_SURFACE_POINTS) + 0.5) / N_SURFACE_POINTS * setup.width_m
    points = tuple((SURFACE_DEPTH_M, float(z)) for z in z_m)
    boundary, power = (
        x[:, len(setup.outer) :].mean(axis=1) for x in window.rim.response(h_W_m2K, extra=points)
    )
    return np.asarray(boundary + share * power)
