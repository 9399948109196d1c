"""Straight-line fit of calibration points: estimate, covariance, and tests of the straight line.

``calibration.static_lines`` and ``calibration.transducers`` fit their lines with it;
``tcdyn.rig.oven_log`` and ``tcdyn.campaign.summary_table`` use ``fit_line``.
``tcdyn.campaign.line_fit`` is another function: it has a full covariance of the points. Guarded by
``tests/calibration/test_static_lines.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtrc, stdtr, stdtrit

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95


@dataclass(frozen=True)
class LineFit:
    """Result of a straight-line fit y = slope * x + intercept.

    One slope, and one intercept or an intercept for each of k groups.

    Parameters
    ----------
    x, y
        Points (N,).
    slope, intercepts
        Estimates; one intercept for each group (k,).
    covariance
        Covariance (1 + k, 1 + k) of (slope, intercepts), from the residual variance with N - 1 - k
        degrees of freedom, or from the known error of y where that is larger.
    covariance_95
        ``covariance`` times (t / 1.96)^2, so that 1.96 u is the 95 % interval.
    residuals
        Residuals (N,).
    sd
        Residual standard deviation.
    dof
        Degrees of freedom.
    r_squared
        Coefficient of determination.
    """

    x: Array
    y: Array
    slope: float
    intercepts: Array
    covariance: Array
    covariance_95: Array
    residuals: Array
    sd: float
    dof: int
    r_squared: float

    @property
    def intercept(self) -> float:
        """The intercept; of the first group where there are several."""
        return float(self.intercepts[0])


def fit_line(
    x: ArrayLike, y: ArrayLike, *, u_y: float = 0.0, groups: ArrayLike | None = None
) -> LineFit:
    """Least-squares line of y on x, both of shape (N,), N >= 3.

    Parameters
    ----------
    x, y
        Points (N,), N >= 3.
    u_y
        Known standard error of y. If given, the residual variance beyond it is taken as noise of x,
        and the slope is corrected for the attenuation by such noise: slope / (1 - u_x^2 / var(x))
        (errors in variables by moments).
    groups
        Group of each point (N,), numbers 0 .. k - 1.

    Raises
    ------
    InputError
        For fewer than 3 points or x without spread.

    Notes
    -----
    Computed about the means: NIST's Norris data to 13 digits.

    The correction is limited to a factor of two. The covariance uses ``u_y`` where it exceeds the
    residual standard deviation.

    Examples
    --------
    >>> fit = fit_line([0, 1, 2, 3], [1, 3, 5, 7])
    >>> round(fit.slope, 12), round(fit.intercept, 12)
    (2.0, 1.0)
    """
    x = np.asarray(x, dtype=float)
    y = np.asarray(y, dtype=float)
    n = len(x)
    if n < 3:
        raise InputError(f"{n} points", expected="at least 3 for a line with its uncertainty")
    group = np.zeros(n, dtype=int) if groups is None else np.asarray(groups)
    count = np.bincount(group)
    mean_x = np.array([x[group == j].mean() for j in range(len(count))])
    mean_y = np.array([y[group == j].mean() for j in range(len(count))])
    dx = x - mean_x[group]
    dy = y - mean_y[group]
    sxx = float(dx @ dx)
    syy = float(dy @ dy)
    dof = n - 1 - len(count)
    if sxx <= 1e-24 * max(float(x @ x), 1e-300):
        raise InputError(
            "the points of a calibration line all lie at one place", expected="a spread of inputs"
        )
    slope = float(dx @ dy) / sxx
    if u_y > 0.0:
        residual = dy - slope * dx
        u_x2 = max(float(residual @ residual) / dof - u_y**2, 0.0) / slope**2 if slope else 0.0
        slope /= 1.0 - min(u_x2 * n / sxx, 0.5)
    residuals = dy - slope * dx
    rss = float(residuals @ residuals)
    sd = float(np.sqrt(rss / dof))
    centre = np.array([1.0, *-mean_x])
    unit_covariance = np.outer(centre, centre) / sxx + np.diag([0.0, *1 / count])
    t_factor = (float(stdtrit(dof, 0.975)) / Z95) ** 2
    r_squared = min(max(1.0 - rss / syy, 0.0), 1.0) if syy > 0 else 1.0
    within = unit_covariance * max(sd**2, u_y**2)
    within_95 = unit_covariance * max(t_factor * sd**2, u_y**2)
    return LineFit(
        x, y, slope, mean_y - slope * mean_x, within, within_95, residuals, sd, dof, r_squared
    )


def lack_of_fit_p(fit: LineFit, groups: ArrayLike) -> float | None:
    """p of the F test for lack of fit; None without enough repeats.

    Parameters
    ----------
    fit
        The line.
    groups
        Group of each point, (N,): repeats at one input.

    Notes
    -----
    The variance of the group means of the residuals over that within groups, with k - 2 and N - k
    degrees of freedom. It needs three groups and two repeats more than groups.
    """
    k, n, between, within = _sums_of_squares(fit, groups)
    if k < 3 or n - k < 2 or within <= 0:
        return None
    return float(fdtrc(k - 2, n - k, between / (k - 2) / (within / (n - k))))


def quadratic_p(fit: LineFit) -> float | None:
    """p of the t test of a quadratic term; None with fewer than 5 points."""
    n = len(fit.x)
    if n < 5 or len(np.unique(fit.x)) < 4:
        return None
    z = (fit.x - fit.x.mean()) / np.std(fit.x)
    coefficients, covariance = np.polyfit(z, fit.y, 2, cov=True)
    variance = float(covariance[0, 0])
    if variance <= 0:
        return None
    t = abs(coefficients[0]) / np.sqrt(variance)
    return float(2 * stdtr(n - 3, -t))


def repeat_shift(fit: LineFit, repeats: ArrayLike) -> tuple[float | None, float, float | None]:
    """Shifts between repeats of a calibration.

    Parameters
    ----------
    fit
        The line through all repeats.
    repeats
        Repeat of each point, (N,).

    Returns
    -------
    scatter
        Standard deviation within repeats [y]; None with one repeat or too few points.
    u_shift
        Standard error of the mean due to the shifts between repeats [y].
    p
        p value of these shifts; None where it cannot be tested.

    Notes
    -----
    Analysis of variance of the residuals, with r - 1 and N - r - 1 degrees of freedom. For repeats
    of different size the mean size N/r is used.
    """
    r, n, between, within = _sums_of_squares(fit, repeats)
    if r < 2 or n - r - 1 < 2:
        return None, 0.0, None
    if within <= 0:
        return 0.0, 0.0, None
    between2 = between / (r - 1)
    within2 = within / (n - r - 1)
    shift2 = max(between2 - within2, 0.0) / (n / r)
    p = float(fdtrc(r - 1, n - r - 1, between2 / within2))
    return float(np.sqrt(within2)), float(np.sqrt(shift2 / r)), p


def _sums_of_squares(fit: LineFit, groups: ArrayLike) -> tuple[int, int, float, float]:
    """Sums of squares of the residuals between and within groups.

    Parameters
    ----------
    fit
        The line.
    groups
        Group of each point, (N,).

    Returns
    -------
    n_groups, n_points
        Numbers of groups and of points.
    between, within
        Sums of squares [y^2].
    """
    group = np.unique(np.asarray(groups), return_inverse=True)[1]
    count = np.bincount(group)
    mean = np.bincount(group, weights=fit.residuals) / count
    between = float(count @ mean**2)
    within = float(np.sum((fit.residuals - mean[group]) ** 2))
    return len(count), len(group), between, within


def outliers(fit: LineFit, level: float = 0.01) -> list[int]:
    """Outliers: points whose deleted Student residual exceeds the Bonferroni bound.

    Parameters
    ----------
    fit
        The line.
    level
        Probability that a line without outliers reports one.

    Returns
    -------
    Indices of the points; empty with fewer than two degrees of freedom.
    """
    n = len(fit.x)
    dof = fit.dof - 1
    if dof < 2 or fit.sd == 0.0:
        return []
    dx = fit.x - fit.x.mean()
    leverage = 1.0 / n + dx**2 / float(dx @ dx)
    rss = fit.sd**2 * fit.dof
    deleted_var = np.maximum(rss - fit.residuals**2 / (1 - leverage), 1e-300) / dof
    t = np.abs(fit.residuals) / np.sqrt(deleted_var * (1 - leverage))
    return [int(i) for i in np.flatnonzero(2 * stdtr(dof, -t) < level / n)]
