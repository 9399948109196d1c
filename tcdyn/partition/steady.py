"""The steady line of each disk in the (share, h) plane, and the speed law that picks a point on both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.heat.rim import Profile
from tcdyn.partition.angular_harmonic import Unmeasured
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import nuisance_effects, inner_gradient
from tcdyn.partition.steel import depends_on_temperature, linear_about
from tcdyn.partition.window import DiskWindow, lagged_window, stretch_of
from tcdyn.rig.disk import DISKS, DiskSetup
from tcdyn.smoothing.traces import DiskTraces

H_GRID_W_M2K: Array = np.asarray(np.arange(100.0, 1201.0, 100.0), dtype=np.float64)  # section 4.3
SHARE_GRID: Array = np.asarray(np.arange(0.1, 1.01, 0.1), dtype=np.float64)
END_GAP_S = 0.2  # the last fraction of a second may already hold the parting
MIN_START_H_W_M2K = 50.0
START_H_W_M2K = 400.0
MAX_COOLING_S = 20.0  # of cooling that any fit looks at
LAST_S = 10.0
SURFACE_DEPTH_M = 0.0
N_SURFACE_POINTS = 12  # across the running surface
N_ITERATIONS = 2  # what moves share and h in the second is a hundredth of what moved them in the first


@dataclass(frozen=True)
class SteadyLine:
    """share = intercept + slope h: what the steady running of one disk leaves free; (4.1), (4.2).

    ``share`` is beta for the fast disk and 1 - beta for the slow one; ``slope`` in 1/(W/m2K).
    """

    intercept: float
    slope: float

    def at(self, h_W_m2K: float) -> float:
        """The share that fits the steady temperatures if the heat transfer coefficient is ``h_W_m2K``."""
        return self.intercept + self.slope * h_W_m2K


@dataclass(frozen=True)
class SteadyMap:
    """Misfit of one disk over a grid of shares and h, and the line of least misfit.

    ``mean_abs_K`` has shape (n_h, n_share); ``best_share`` is, for each h, the share of least squares.
    """

    h_W_m2K: Array
    share: Array
    mean_abs_K: Array
    best_share: Array
    line: SteadyLine


@dataclass(frozen=True)
class SpeedLawPoint:
    """beta and both heat transfer coefficients [W/m2K] where the lines meet h_fast / h_slow = chi.

    ``starts``: share and h [W/m2K] of each disk, for a transient fit to begin from.
    """

    beta: float
    h_fast: float
    h_slow: float
    chi: float
    starts: Mapping[str, tuple[float, float]]


def speed_ratio_power(speed_ratio: float, exponent: float) -> float:
    """chi = (u_f / u_s)^n, eq. (4.6).

    >>> round(speed_ratio_power(4.24, 0.667), 2)
    2.62
    """
    return float(speed_ratio**exponent)


def speed_law_beta(A: Any, B: Any, C: Any, D: Any, chi: Any) -> Any:
    """beta = (A D + chi B (1 - C)) / (D + chi B): eq. (4.7) as it must read with (4.1), (4.2) and (4.6).

    ``A``, ``B``: intercept and slope of the fast line beta = A + B h_f; ``C``, ``D``: of the slow line
    1 - beta = C + D h_s. The thesis prints (4.7) for a slow line written for beta.

    >>> B, D = (0.83 - 0.37) / 1100, (0.48 - 0.20) / 1100
    >>> round(speed_law_beta(0.37 - 100 * B, B, 0.20 - 100 * D, D, 4.24**0.667), 2)
    0.73
    """
    return (A * D + chi * B * (1 - C)) / (D + chi * B)


def speed_law(
    fast: SteadyLine, slow: SteadyLine, speed_ratio: float, exponent: float
) -> SpeedLawPoint:
    """The point of both lines that obeys h_fast = (u_f/u_s)^n h_slow.

    Raises InputError when the lines do not rise with h or meet at a negative h: then the data contradict the model.
    """
    chi = speed_ratio_power(speed_ratio, exponent)
    if fast.slope <= 0 or slow.slope <= 0:
        raise InputError(
            f"a steady line falls with h (slopes {fast.slope:.3g} and {slow.slope:.3g})",
            expected="more loss to need more heat",
            remedy="check that no channels are swapped and that depths in rig.toml are those of this disk",
        )
    beta = speed_law_beta(fast.intercept, fast.slope, slow.intercept, slow.slope, chi)
    h_fast = (beta - fast.intercept) / fast.slope
    least = MIN_START_H_W_M2K
    starts = {"fast": (beta, max(h_fast, least)), "slow": (1 - beta, max(h_fast / chi, least))}
    return SpeedLawPoint(beta, h_fast, h_fast / chi, chi, starts)


def exponent_sensitivity(
    fast: SteadyLine, slow: SteadyLine, speed_ratio: float, exponents: Array
) -> Array:
    """beta by the speed law for each exponent n (figure 4.17), shape of ``exponents``.

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

    ``y``: measured outer row, (rows, P) [degC]; ``boundary``: model with no frictional heat, (n_h, rows, P) [degC];
    ``per_share``: model response to a share of one, (n_h, rows, P) [K]; ``weights``: of the P junctions, (7.1) gives
    each the same, (7.2) a double one to ``a``. The model is linear in the share, so for each h the best share is one
    division, and the map costs no further model run. (The thesis fits a parabola to the error along each h, figure
    4.10, and then a straight line through the minima.)
    """
    w = np.ones(y.shape[1]) if weights is None else np.asarray(weights, dtype=float)
    w = w / w.sum()
    gap = y[None] - boundary
    best = np.einsum("hrp,hrp,p->h", gap, per_share, w) / np.einsum(
        "hrp,hrp,p->h", per_share, per_share, w
    )
    misfit = gap[:, None] - share[None, :, None, None] * per_share[:, None]
    mean_abs = np.einsum("hsrp,p->hs", np.abs(misfit), w) / y.shape[0]
    slope, intercept = np.polyfit(h_W_m2K, best, 1)
    return SteadyMap(h_W_m2K, share, mean_abs, best, SteadyLine(float(intercept), float(slope)))


@dataclass(frozen=True)
class FitSensitivity:
    """Error of fitted numbers by one standard uncertainty of what nobody measured, and their noise.

    ``per_sd`` (Q, k): how far the fit is off when the true disk departs by one standard uncertainty from the stated
    one, in the units of the fitted numbers: (intercept, slope) of a steady line, (share, h [W/m2K]) of a cooling fit,
    (share, h, lag [s]) of a joint fit; ``noise`` (k, k) covariance.
    """

    of: tuple[Unmeasured, ...]
    per_sd: Array
    noise: Array


@dataclass(frozen=True)
class DiskLine:
    """Map and line of one disk; ``errors`` works out the ``shift`` of (intercept, slope), which not everybody asks."""

    map: SteadyMap
    line: SteadyLine
    errors: Callable[[], FitSensitivity] = field(repr=False)

    @cached_property
    def shift(self) -> FitSensitivity:
        """Error of (intercept, slope) per standard uncertainty of what nobody measured."""
        return self.errors()


def disk_line(
    test: EhlTest,
    disk: DiskTraces,
    rows: slice,
    profile: Profile = "modal",
    weights: Array | None = None,
) -> DiskLine:
    """Line of least misfit over the steady blocks of the lagged readings; ``weights`` (P,) of the outer row, equal
    (7.1) unless given; (7.2) doubles that of a."""
    window = lagged_window(test, disk, rows, profile)
    weights = (1.0 if weights is None else weights) * window.used.astype(float)
    steady = window.at_s < test.events.unload_s - END_GAP_S
    rest, power = (x[:, steady] for x in window.rim.answer(H_GRID_W_M2K))
    found = steady_map(window.y[steady], rest, power, weights=weights)
    return DiskLine(
        found,
        found.line,
        partial(_line_shift, test, disk, window, found.line, power, weights, steady),
    )


def _line_shift(
    test: EhlTest,
    disk: DiskTraces,
    window: DiskWindow,
    line: SteadyLine,
    power: Array,
    weights: Array,
    steady: Flags,
) -> FitSensitivity:
    """What is to be feared of a line through the ``steady`` (R,) means of its window; ``power`` (n_h, r, P) theirs."""
    w = weights / weights.sum()
    moved = []
    low = 2
    high = len(H_GRID_W_M2K) - 3
    for k in (low, high):
        h = float(H_GRID_W_M2K[k])
        known = nuisance_effects(test, disk, window, line.at(h), h)
        size = np.einsum("rp,rp,p->", power[k], power[k], w)
        moved.append(np.einsum("qrp,rp,p->q", known.change[:, steady], power[k], w) / size)
    h_low = float(H_GRID_W_M2K[low])
    h_high = float(H_GRID_W_M2K[high])
    slope = (moved[1] - moved[0]) / (h_high - h_low)
    s = power[low] * w
    spread = (
        2.0 * ((s[:, window.used] / window.weight[steady][:, window.used]) ** 2).sum()
    )  # twice: so is the boundary
    noise = float(np.sqrt(spread) / (s * power[low]).sum())
    per_sd = np.column_stack([moved[0] - slope * h_low, slope])
    return FitSensitivity(known.of, per_sd, np.diag([noise**2, 0.0]))


def steady_lines(
    test: EhlTest, rows: slice, profile: Profile = "modal", weights: Array | None = None
) -> tuple[dict[str, DiskLine], SpeedLawPoint]:
    """Steady line of each disk from the lagged readings, and the speed law's point on both; of one disk a start."""
    each = [disk_line(test, disk, rows, profile, weights) for disk in test.disks.values()]
    lines = dict(zip(test.disks, each))
    if len(lines) < len(DISKS):
        starts = {d: (one.line.at(START_H_W_M2K), START_H_W_M2K) for d, one in lines.items()}
        return lines, SpeedLawPoint(np.nan, np.nan, np.nan, np.nan, starts)
    return lines, speed_law(
        lines["fast"].line, lines["slow"].line, test.speed_ratio, test.speed_exponent
    )


def at_one_radius(test: EhlTest) -> EhlTest:
    """The test with ``inner_K`` of both disks set: radial gradient times how much deeper than its edge a junction lies.

    The rim begins at its edge, the depth of b, and d and f are taken to read the temperature there (eq. 3.34). Where
    rig.toml states another depth, the gradient of the model itself, at the speed law's share and h, tells what they
    would read. First order in the difference: good for some tenths of a millimetre. Disks whose inner row is level stay
    untouched."""
    if not (
        off := {d: o for d, x in test.disks.items() if np.any(o := x.setup.deeper_than_edge_m)}
    ):
        return test
    rows = stretch_of(test, min(MAX_COOLING_S, float(test.time_s[-1] - test.events.unload_s)))
    for _ in range(N_ITERATIONS):
        _, speed = steady_lines(test, rows)
        moved = {d: _levelled(test, test.disks[d], rows, off[d], *speed.starts[d]) for d in off}
        test = replace(test, disks={**test.disks, **moved})
    return test


def at_own_temperature(test: EhlTest) -> EhlTest:
    """The test with each disk whose steel follows temperature made linear about its air and running surface.

    Both are means over the last seconds under load, the surface's by the model itself at the speed law's share and h.
    """
    asked = [
        d for d in test.disks if depends_on_temperature(test.disks[d].setup, test.disks[d].uncertainty)
    ]
    if not asked:
        return test
    rows = stretch_of(test, min(MAX_COOLING_S, float(test.time_s[-1] - test.events.unload_s)))
    stated = test.disks
    for k in range(
        N_ITERATIONS + 1
    ):  # the first with the steel as it is at the readings' own temperature
        starts = steady_lines(test, rows)[1].starts if k else dict.fromkeys(DISKS, None)
        moved = {
            d: replace(stated[d], setup=_linear(test, stated[d].setup, d, rows, starts[d]))
            for d in asked
        }
        test = replace(test, disks={**stated, **moved})
    return test


def _linear(
    test: EhlTest, setup: DiskSetup, d: str, rows: slice, at: tuple[float, float] | None
) -> DiskSetup:
    window = lagged_window(test, test.disks[d], rows)
    to_parting = window.at_s - test.events.unload_s
    last = (to_parting >= -LAST_S) & (to_parting < -END_GAP_S)
    air, rim = (
        float(window.rim.inputs[last, k].mean()) for k in (window.rim.ambient, window.rim.inner)
    )
    surface = rim if at is None else float(surface_degC(window, *at)[last].mean())
    return linear_about(setup, air, surface, rim)


def surface_degC(window: DiskWindow, share: float, h_W_m2K: float) -> Array:
    """Mean temperature of the running surface by the model, (R,) [degC]."""
    places = tuple(
        (SURFACE_DEPTH_M, float(x))
        for x in (np.arange(N_SURFACE_POINTS) + 0.5) / N_SURFACE_POINTS * window.rim.setup.width_m
    )
    rest, power = (
        x[:, len(window.rim.setup.outer) :].mean(axis=1)
        for x in window.rim.answer(h_W_m2K, extra=places)
    )
    return np.asarray(rest + share * power)


def _levelled(
    test: EhlTest, disk: DiskTraces, rows: slice, deeper_m: Array, share: float, h_W_m2K: float
) -> DiskTraces:
    whole = np.zeros_like(disk.inner_K)
    whole[rows] = inner_gradient(lagged_window(test, disk, rows), share, h_W_m2K) * deeper_m
    whole[rows.stop :] = whole[rows.stop - 1]
    return replace(disk, inner_K=whole)
