"""Profile likelihood: intervals that follow the data where the quadratic ones are poor."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from calibration.arrays import Array
from calibration.estimate import Z95, Estimate
from tcdyn.identify.optimise import least_squares
from tcdyn.identify.problem import Problem

if TYPE_CHECKING:
    from tcdyn.identify.fit import Fit


def constrained_cost(fit: Fit, index: int, value: float, guess: Array) -> tuple[float, Array]:
    """Least cost with entry ``index`` of x held at ``value``, searched from ``guess``; and the x there."""
    from tcdyn.identify.noise import stretches

    problem: Problem = fit.problem
    parts = stretches(problem)
    lower, upper = problem.bounds()
    rest = np.delete(np.arange(problem.size), index)

    def evaluate(z: Array) -> tuple[Array, Array] | None:
        x = np.empty(problem.size)
        x[rest], x[index] = z, value
        answer = problem.evaluate(x)
        if answer is None:
            return None
        return fit.noise.whiten(answer[0], parts), fit.noise.whiten(answer[1][:, rest], parts)

    found = least_squares(evaluate, guess[rest], lower[rest], upper[rest], max_iterations=25, tolerance=1e-7)
    if found is None:
        return np.inf, guess
    x = np.empty(problem.size)
    x[rest], x[index] = found.x, value
    return found.cost, x


def profile_end(fit: Fit, index: int, side: int, level: float = 0.95) -> tuple[float, bool]:
    """x of one end of the profile interval of entry ``index``, and whether it was found inside the box.

    The signed root z = sqrt((S(x) - S_min)/s^2) is nearly straight in x; it is followed to the t quantile by
    secant steps.
    """
    n, k = fit.problem.n_seen, fit.problem.size
    target = float(stats.t.ppf(0.5 + level / 2, n - k))
    best = float(fit.innovation @ fit.innovation)
    classical = best / (n - k)
    lower, upper = fit.problem.bounds()
    centre = float(fit.x[index])
    u = float(np.sqrt(max(fit.covariance_x[index, index], 1e-30)))
    u = min(u, 1.5) if fit.problem.model.positive(fit.problem.model.free[index]) else u
    inflate = robust_ratio(fit, index)
    low, high, z_low, z_high = centre, np.nan, 0.0, np.nan
    guess, step = fit.x, target * u
    trial = centre + side * step
    for _ in range(14):
        edge = bool(trial <= lower[index] or trial >= upper[index])
        trial = float(np.clip(trial, lower[index], upper[index]))
        cost, x = constrained_cost(fit, index, trial, guess)
        z = float(np.sqrt(max(cost - best, 0.0) / (classical * inflate))) if np.isfinite(cost) else np.inf
        if abs(z - target) < 0.01 * target:
            return trial, True
        if z < target:
            low, z_low, guess = trial, z, x
            if edge:
                return trial, False
        else:
            high, z_high = trial, z
        if np.isnan(high):
            slope = (z_low / abs(low - centre)) if low != centre else 1 / u
            ahead = (target - z_low) / max(slope, 1e-12)
            trial = low + side * float(np.clip(1.2 * ahead, 0.2 * step, 4 * step))
        elif np.isfinite(z_high):
            trial = low + (high - low) * float(np.clip((target - z_low) / (z_high - z_low), 0.05, 0.95))
        else:
            trial = 0.5 * (low + high)
    return trial, True


def robust_ratio(fit: Fit, index: int) -> float:
    """Variance of the reported covariance relative to the white-noise one, for one entry of x."""
    from tcdyn.identify.noise import inverse

    if not fit.identified.statistics["robust_covariance"] and fit.loss == "linear":
        return 1.0
    bread, _ = inverse(fit.weighted_jacobian)
    white = float(fit.innovation @ fit.innovation) / (fit.problem.n_seen - fit.problem.size) * bread[index, index]
    return float(fit.covariance_x[index, index] / white) if white > 0 else 1.0


def profile(fit: Fit, name: str) -> tuple[Estimate, bool]:
    """The estimate of ``name`` with its 95 % profile-likelihood interval, and whether both ends were found."""
    model = fit.problem.model
    index = model.free.index(name)
    ends, inside = [], []
    for side in (-1, 1):
        end, found = profile_end(fit, index, side)
        ends.append(float(np.exp(end)) if model.positive(name) else end)
        inside.append(found)
    old = fit.estimates[name]
    u = min(old.u, (ends[1] - ends[0]) / (2 * Z95))
    return Estimate(value=old.value, u=u, low95=ends[0], high95=ends[1]), all(inside)


def poor(fit: Fit, name: str) -> bool:
    """Whether the quadratic interval of ``name`` cannot be trusted: wide for its size, or over the edge."""
    e, model = fit.estimates[name], fit.problem.model
    if model.positive(name):
        return e.u > 0.2 * e.value
    if name in ("Tz", "Td") and {"Tz", "Td"} <= set(model.free):
        return abs(fit.estimates["Tz"].value) < 0.1 * fit.problem.time_scale_s  # there zero and dead time act alike
    return name == "Td" and e.low95 < 0


def with_profiles(fit: Fit, everything: bool = False) -> Fit:
    """``fit`` with profile intervals in place of the poor quadratic ones (or of all)."""
    if fit.loss != "linear":
        return fit
    names = [n for n in fit.problem.model.free if everything or poor(fit, n)]
    if not names:
        return fit
    estimates, warnings = dict(fit.estimates), list(fit.warnings)
    for name in names:
        estimates[name], inside = profile(fit, name)
        if not inside:
            e = estimates[name]
            warnings.append(
                f"the interval of {name} is open: it reaches the search bound ({e.low95:.3g}..{e.high95:.3g})"
            )
    return replace(fit, identified=replace(fit.identified, estimates=estimates, warnings=tuple(warnings)))
