"""Profile likelihood: one number held here and there, everything else fitted again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tcdyn.core import Array
from tcdyn.core.estimate import Z95
from tcdyn.estimation.levenberg_marquardt import held
from tcdyn.estimation.problem import Optimum, Status

LEAST_STEP = 1 / 6  # of the first one: shorter steps toward an end are not tried
SLOW = (
    2 / 9
)  # of the normal deviance: below it, beyond three standard uncertainties, strides grow by half


@dataclass(frozen=True)
class Profile:
    """``deviance`` (K,) of ``value`` (K,), in rising order: the cost above that of the optimum, all else refitted.

    ``low95`` and ``high95`` are where the deviance passes ``level``; None where it never does, as far as it was
    followed. ``optima`` are the fits, one a value.
    """

    value: Array
    deviance: Array
    level: float
    optima: tuple[Optimum, ...] = field(repr=False)

    @property
    def low95(self) -> float | None:
        """Lower end of the interval."""
        return crossing(self.value[::-1], self.deviance[::-1], self.level)

    @property
    def high95(self) -> float | None:
        """Upper end of the interval."""
        return crossing(self.value, self.deviance, self.level)


def profile(
    optimum: Optimum,
    toward: str | Array,
    *,
    u: float | None = None,
    scale: float = 1.0,
    level: float = Z95**2,
    step: float = 0.5,
    drop: float = 9.0,
    reach: float = 6.0,
    refine: float = 0.0,
    value: Callable[[float], float] = float,
    at: Callable[[float], float] = float,
    within: tuple[float, float] = (-np.inf, np.inf),
    cost: Callable[[Optimum], float] = lambda o: o.cost,
    **search: float,
) -> Profile:
    """Walk a parameter, or the combination ``toward`` @ theta, both ways from ``optimum``.

    Steps of ``step`` standard uncertainties ``u`` (that of the optimum by default), each fit begun at its neighbour's,
    until the deviance (cost - least)/``scale`` passes ``drop``, or ``reach`` uncertainties, or the box, or an end of
    the open interval ``within``; steps that the model does not allow are halved. ``scale`` is the variance of
    residuals that were not whitened, times any inflation. ``refine`` > 0 puts more fits where the deviance passes
    ``level``, until its root is within this share of the level's. To profile a number that is a function of the
    coordinate, such as tau = exp(theta), give ``value`` (coordinate to number) and ``at`` (back); u, steps and
    ``within`` are then the number's. ``cost`` may add to the cost: o.cost + 2 o.log_volume makes it a marginal one.
    Other keywords are those of ``minimise``.

    The root of the deviance is nearly straight; ends are found by straight lines in it.
    """
    problem = optimum.problem
    row = problem.toward(toward)
    width = optimum.u(row) * np.sqrt(scale) if u is None else u
    centre = value(float(row @ optimum.theta))
    low, high = _box(optimum, row)

    def walked(side: float) -> list[_Point]:
        points = [_Point(centre, cost(optimum), optimum)]

        def add(number: float, near: Optimum) -> bool:
            done = held(near, row, at(number), **search)
            if done.status in (Status.EDGE, Status.NOWHERE):
                return False
            points.append(_Point(number, cost(done), done))
            return True

        offset = 0.0
        stride = step
        while stride >= LEAST_STEP * step and offset < reach - 1e-9:
            number = centre + side * (offset + stride) * width
            inside = within[0] < number < within[1]
            at_end = inside and not low < at(number) < high
            if at_end:
                number = value(low if at(number) <= low else high)
            if not inside or not add(number, points[-1].fit):
                stride /= 2
                continue
            offset += stride
            deviance = (points[-1].cost - min(p.cost for p in points)) / scale
            if deviance > drop or at_end:
                break
            if offset > 3.0 and deviance < SLOW * offset**2:
                stride *= 1.5
        for _ in range(8 if refine else 0):
            outward = sorted(points, key=lambda p: side * p.number)
            numbers = np.array([p.number for p in outward])
            end = crossing(
                numbers, np.array([(p.cost - points[0].cost) / scale for p in outward]), level
            )
            if end is None or not add(end, outward[int(np.argmin(np.abs(numbers - end)))].fit):
                break
            if (
                abs(np.sqrt(max(points[-1].cost - points[0].cost, 0.0) / scale / level) - 1)
                < refine
            ):
                break
        return points[1:]

    below = walked(-1.0)
    above = walked(1.0)
    every = sorted([_Point(centre, cost(optimum), optimum), *below, *above], key=lambda p: p.number)
    deviances = np.array([(p.cost - cost(optimum)) / scale for p in every])
    fits = tuple(p.fit for p in every)
    return Profile(np.array([p.number for p in every]), deviances, level, fits)


@dataclass(frozen=True)
class _Point:
    number: float
    cost: float
    fit: Optimum


def crossing(value: Array, deviance: Array, level: float = Z95**2) -> float | None:
    """Where the deviance first reaches ``level`` beyond its least, going along ``value``; None when it never does.

    Linear in the root of the deviance, exact for a parabola.

    >>> crossing(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 4.0]), 2.25)
    1.5
    """
    k = int(np.argmin(deviance))
    root = np.sqrt(np.maximum(deviance[k:], 0.0))
    wanted = np.sqrt(level)
    beyond = np.flatnonzero(root >= wanted)
    if not len(beyond):
        return None
    j = int(beyond[0])
    part = (wanted - root[j - 1]) / (root[j] - root[j - 1])
    return float(value[k + j - 1] + part * (value[k + j] - value[k + j - 1]))


def _box(optimum: Optimum, row: Array) -> tuple[float, float]:
    """Ends of what the box allows a single parameter; a combination has none of its own."""
    at = np.flatnonzero(row)
    if len(at) != 1:
        return -np.inf, np.inf
    ends = sorted(
        float(b[at[0]] * row[at[0]]) for b in (optimum.problem.lower, optimum.problem.upper)
    )
    return ends[0], ends[1]
