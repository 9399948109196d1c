"""Generalised least squares with a known covariance and an additional independent scatter.

``tcdyn.campaign.exponent`` and ``tcdyn.campaign.trends`` use it. For calibration points with
independent errors there is ``tcdyn.estimation.line_fit``. Guarded by
``tests/campaign/test_lines.py`` and ``tests/campaign/test_curve_offset.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize
from scipy.linalg import cholesky, solve_triangular
from scipy.special import chdtrc, ndtr, ndtri, stdtr, stdtrit

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate


@dataclass(frozen=True)
class Line:
    """Result of a fit y = columns @ coefficients + error of known covariance + independent scatter.

    Parameters
    ----------
    coefficients
        Estimates, (P,).
    covariance
        Their covariance, (P, P).
    scatter
        Standard deviation of the points about the line beyond their stated covariance: the least
        that brings chi-squared to its degrees of freedom.
    chi2
        Chi-squared without the scatter.
    freedom
        Degrees of freedom.
    operator
        (P, N): coefficients = operator @ y.
    total_covariance
        Covariance of the points with the scatter in it, (N, N).
    independent_var
        Variance of a point about the line, mean over the points: what the residuals estimate.
    """

    coefficients: Array
    covariance: Array
    scatter: float
    chi2: float
    freedom: int
    operator: Array = field(repr=False)
    total_covariance: Array = field(repr=False)
    independent_var: float = 0.0

    @property
    def p_value(self) -> float:
        """Probability of a chi-squared as large as this if there were no scatter.

        A small value means that the line is not enough.
        """
        return float(chdtrc(self.freedom, self.chi2)) if self.freedom > 0 else 1.0

    def effective_freedom(self, k: int) -> float:
        """Degrees of freedom of the variance of coefficient ``k``; infinite if all of it is known.

        Notes
        -----
        Where a scatter was added, the residuals estimate the variance of the points about the line,
        from ``freedom`` degrees of freedom; the rest is known. The formula is that of Welch and
        Satterthwaite (JCGM 100:2008, G.4.1).
        """
        if self.scatter == 0:
            return np.inf
        estimated = self.independent_var * float(self.operator[k] @ self.operator[k])
        return max(self.freedom, 1) * float(self.covariance[k, k] / estimated) ** 2

    def estimate(self, k: int) -> Estimate:
        """Coefficient ``k`` with its 95 % interval.

        It is Student's interval where the scatter was estimated from the points.
        """
        value = float(self.coefficients[k])
        u = float(np.sqrt(self.covariance[k, k]))
        freedom = self.effective_freedom(k)
        reach = u * float(ndtri(0.975) if np.isinf(freedom) else stdtrit(freedom, 0.975))
        return Estimate(value=value, u=u, low95=value - reach, high95=value + reach)

    def p_value_of_zero(self, k: int) -> float:
        """Probability of a coefficient ``k`` as far from zero if it were zero."""
        z = abs(float(self.coefficients[k])) / float(np.sqrt(self.covariance[k, k]))
        freedom = self.effective_freedom(k)
        return float(2 * (ndtr(-z) if np.isinf(freedom) else stdtr(freedom, -z)))


def fit_generalised_line(columns: Array, y: Array, covariance: Array) -> Line:
    """Generalised least squares with a known covariance, and a scatter where the residuals need it.

    Parameters
    ----------
    columns
        Columns of the model, (N, P).
    y
        Values, (N,).
    covariance
        Covariance of the errors of ``y``, (N, N).

    Notes
    -----
    c = (X' V^-1 X)^-1 X' V^-1 y, V the covariance and, where the residuals ask for more than it,
    the scatter that brings r' V^-1 r to N - P (Mandel and Paule 1970). Without the scatter the
    slopes of a line that does not describe the tests would have uncertainties that are too small.

    Examples
    --------
    >>> x = np.column_stack([np.ones(4), np.arange(4.0)])
    >>> covariance = 0.01 * (np.ones((4, 4)) + 0.01 * np.eye(4))
    >>> line = fit_generalised_line(x, np.array([1.0, 3.0, 5.0, 7.0]), covariance)
    >>> u = np.sqrt(np.diag(line.covariance))
    >>> line.coefficients.round(6).tolist(), u.round(4).tolist(), line.scatter
    ([1.0, 2.0], [0.1003, 0.0045], 0.0)
    """
    freedom = len(y) - columns.shape[1]

    def solve(scatter: float) -> Line:
        """The line with an independent scatter of this standard deviation in the covariance."""
        used = covariance + scatter**2 * np.eye(len(y))
        size = np.sqrt(np.diag(used))
        weight = np.linalg.inv(used / np.outer(size, size)) / np.outer(size, size)
        spread = np.abs(columns).max(axis=0)
        scaled = columns / spread
        inverse_information = np.linalg.inv(scaled.T @ weight @ scaled)
        operator = inverse_information @ scaled.T @ weight / spread[:, None]
        residual = y - columns @ (operator @ y)
        inverse_information = inverse_information / np.outer(spread, spread)
        chi2 = float(residual @ weight @ residual)
        projection = np.eye(len(y)) - columns @ np.linalg.pinv(columns)
        independent_var = float(np.trace(projection @ used @ projection)) / max(freedom, 1)
        return Line(
            operator @ y,
            inverse_information,
            scatter,
            chi2,
            freedom,
            operator,
            used,
            independent_var,
        )

    line = solve(0.0)
    if freedom > 0 and line.chi2 > freedom:
        distances = np.abs(y - columns @ line.coefficients)
        largest_scatter = 10.0 * float(distances.max() + np.sqrt(np.diag(covariance)).max())
        scatter = float(
            optimize.brentq(lambda s: solve(s).chi2 - freedom, 0.0, largest_scatter, rtol=1e-6)
        )
        line = replace(solve(scatter), chi2=line.chi2)
    return line


def level_inside_points(y: Array, line: Line) -> Line:
    """The common level of points that lies inside their range.

    Parameters
    ----------
    y
        Values, shape (N,), N at least 2.
    line
        Generalised least squares fit of one common level to them, for its ``total_covariance``.

    Returns
    -------
    Line
        ``line`` with the level, its variance and its weights in place of those of generalised least
        squares.

    Notes
    -----
    With V the covariance of the points, the level is w' y, where w minimises w' V w subject to
    sum(w) = 1 and w >= 0; its variance is w' V w. Where the weights of generalised least squares
    are positive, w is equal to them.

    Strongly correlated errors of different size give negative weights (Peelle's pertinent puzzle;
    Burr et al. 2011, Algorithms 4, 28-39). Such weights extrapolate the systematic errors from the
    differences of the points, and the level leaves their range. That is optimal if every entry of V
    is correct; an error of V, or a misfit, then changes the level by a multiple of the differences.

    Up to a factor, w solves min |L' w - L^-1 1|^2, w >= 0, with V = L L' (Lawson and Hanson 1974,
    chapter 23).
    """
    lower = cholesky(line.total_covariance, lower=True)
    weights, _ = optimize.nnls(lower.T, solve_triangular(lower, np.ones(len(y)), lower=True))
    weights = weights / weights.sum()
    variance = float(weights @ line.total_covariance @ weights)
    return replace(
        line,
        coefficients=np.array([weights @ y]),
        covariance=np.array([[variance]]),
        operator=weights[None, :],
    )
