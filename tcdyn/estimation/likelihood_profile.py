"""Profile likelihood: one number fixed at several values, all other parameters fitted again.

``tcdyn.identification.intervals``, ``immersion.plunge_posterior`` and ``tcdyn.partition.profile``
use it for intervals that are not symmetric. Guarded by ``tests/estimation/test_fitting.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tcdyn.core import Array
from tcdyn.core.estimate import Z95
from tcdyn.estimation.levenberg_marquardt import minimise_constrained
from tcdyn.estimation.problem import Optimum, Status

# shortest step, as a share of the first; chosen by judgement
MIN_STEP = 1 / 6
# share of the normal deviance below which steps grow by this factor, beyond this offset in standard
# uncertainties; chosen by judgement
SLOW_DEVIANCE = 2 / 9
SLOW_OFFSET = 3.0
SLOW_GROWTH = 1.5
# further fits at each end of the interval at most; chosen by judgement
MAX_REFINEMENTS = 8


@dataclass(frozen=True)
class Profile:
    """Deviance as a function of one number: the cost above that of the optimum.

    Parameters
    ----------
    value
        Values of the number, (K,), in rising order.
    deviance
        Deviance at each, (K,), with all other parameters fitted again.
    level
        Deviance at the ends of the 95 % interval.
    optima
        The fits, one a value.
    """

    value: Array
    deviance: Array
    level: float
    optima: tuple[Optimum, ...] = field(repr=False)

    @property
    def low95(self) -> float | None:
        """Lower end of the 95 % interval; None where the deviance does not reach ``level``."""
        return first_crossing(self.value[::-1], self.deviance[::-1], self.level)

    @property
    def high95(self) -> float | None:
        """Upper end of the 95 % interval; None where the deviance does not reach ``level``."""
        return first_crossing(self.value, self.deviance, self.level)


def profile(
    optimum: Optimum,
    toward: str | Array,
    *,
    u: float | None = None,
    scale: float = 1.0,
    level: float = Z95**2,
    step: float = 0.5,
    max_deviance: float = 9.0,
    max_distance: float = 6.0,
    refine: float = 0.0,
    value: Callable[[float], float] = float,
    at: Callable[[float], float] = float,
    bounds: tuple[float, float] = (-np.inf, np.inf),
    cost: Callable[[Optimum], float] = lambda o: o.cost,
    **search: float,
) -> Profile:
    """Profile a parameter, or a combination of parameters, in both directions from the optimum.

    The walk goes in steps, each fit started at its neighbour's, until the deviance (cost -
    least)/``scale`` exceeds ``max_deviance``, or to ``max_distance``, the box, or an end of the
    open interval ``bounds``. Steps for which the model cannot be computed are halved. The square
    root of the deviance is nearly straight; the ends of the interval are found by linear
    interpolation in it.

    Parameters
    ----------
    optimum
        The optimum.
    toward
        Name of a parameter, or a combination (P,).
    u
        Standard uncertainty, the unit of ``step`` and ``max_distance``; that of the optimum by
        default.
    scale
        Variance of residuals that were not whitened, times any inflation.
    level
        Deviance at the ends of the interval.
    step
        First step.
    max_deviance
        Deviance at which the walk ends.
    max_distance
        Largest distance.
    refine
        If positive, more fits are made where the deviance passes ``level``, until its root is
        within this share of the root of the level.
    value, at
        To profile a function of the coordinate, such as tau = exp(theta): coordinate to number, and
        number to coordinate. ``u``, steps and ``bounds`` are then in the number's unit.
    bounds
        Open interval of the number.
    cost
        Cost of a fit; o.cost + 2 o.log_volume makes it a marginal likelihood.
    search
        Keywords of ``minimise``.

    Notes
    -----
    ``step`` changes cost and accuracy of the interpolation, not the interval; ``refine`` makes the
    ends exact. ``max_deviance`` must exceed ``level``, otherwise an end of the interval may be
    missing.
    """
    problem = optimum.problem
    row = problem.direction(toward)
    width = optimum.u(row) * np.sqrt(scale) if u is None else u
    centre = value(float(row @ optimum.theta))
    low, high = _box_ends(optimum, row)

    def walk(side: float) -> list[_Point]:
        """Points of the profile on one side of the optimum, ``side`` -1 or 1."""
        points = [_Point(centre, cost(optimum), optimum)]

        def add(number: float, near: Optimum) -> bool:
            """Add the fit with the number fixed; False where the model cannot be computed."""
            fit = minimise_constrained(near, row, at(number), **search)
            if fit.status in (Status.EDGE, Status.NOWHERE):
                return False
            points.append(_Point(number, cost(fit), fit))
            return True

        offset = 0.0
        stride = step
        while stride >= MIN_STEP * step and offset < max_distance - 1e-9:
            number = centre + side * (offset + stride) * width
            inside = bounds[0] < number < bounds[1]
            at_end = inside and not low < at(number) < high
            if at_end:
                number = value(low if at(number) <= low else high)
            if not inside or not add(number, points[-1].fit):
                stride /= 2
                continue
            offset += stride
            deviance = (points[-1].cost - min(p.cost for p in points)) / scale
            if deviance > max_deviance or at_end:
                break
            if offset > SLOW_OFFSET and deviance < SLOW_DEVIANCE * offset**2:
                stride *= SLOW_GROWTH
        for _ in range(MAX_REFINEMENTS if refine else 0):
            outward = sorted(points, key=lambda p: side * p.number)
            numbers = np.array([p.number for p in outward])
            deviances = np.array([(p.cost - points[0].cost) / scale for p in outward])
            end = first_crossing(numbers, deviances, level)
            if end is None:
                break
            nearest = outward[int(np.argmin(np.abs(numbers - end)))]
            if not add(end, nearest.fit):
                break
            end_deviance = max(points[-1].cost - points[0].cost, 0.0) / scale
            if abs(np.sqrt(end_deviance / level) - 1) < refine:
                break
        return points[1:]

    below = walk(-1.0)
    above = walk(1.0)
    points_sorted = sorted(
        [_Point(centre, cost(optimum), optimum), *below, *above], key=lambda p: p.number
    )
    deviances = np.array([(p.cost - cost(optimum)) / scale for p in points_sorted])
    fits = tuple(p.fit for p in points_sorted)
    return Profile(np.array([p.number for p in points_sorted]), deviances, level, fits)


@dataclass(frozen=True)
class _Point:
    """One point of a profile: the number, the cost of its fit, and the fit."""

    number: float
    cost: float
    fit: Optimum


def first_crossing(value: Array, deviance: Array, level: float = Z95**2) -> float | None:
    """Where the deviance first reaches ``level`` beyond its minimum; None if it never does.

    Linear in the root of the deviance, exact for a parabola.

    Parameters
    ----------
    value
        Values, (K,), rising or falling away from the minimum.
    deviance
        Deviance at each, (K,).
    level
        Deviance of the crossing; 1.96^2 for a 95 % interval.

    Examples
    --------
    >>> first_crossing(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 4.0]), 2.25)
    1.5
    """
    k = int(np.argmin(deviance))
    root = np.sqrt(np.maximum(deviance[k:], 0.0))
    root_level = np.sqrt(level)
    beyond = np.flatnonzero(root >= root_level)
    if not len(beyond):
        return None
    j = int(beyond[0])
    share = (root_level - root[j - 1]) / (root[j] - root[j - 1])
    return float(value[k + j - 1] + share * (value[k + j] - value[k + j - 1]))


def _box_ends(optimum: Optimum, row: Array) -> tuple[float, float]:
    """Ends of the box for a single parameter; infinite for a combination.

    Parameters
    ----------
    optimum
        Its problem has the box.
    row
        Weights of the combination, (P,).

    Returns
    -------
    Lower and upper end of ``row @ theta``.
    """
    index = np.flatnonzero(row)
    if len(index) != 1:
        return -np.inf, np.inf
    k = int(index[0])
    ends = [float(b[k] * row[k]) for b in (optimum.problem.lower, optimum.problem.upper)]
    return min(ends), max(ends)
