"""Least-squares lines over the conditions of tests, with the uncertainty of the scatter about them.

``tcdyn.campaign.summary_table`` and ``tcdyn.plots.campaign`` draw them through quantities without
a joint covariance, such as temperatures. Beta has one: its lines are in ``tcdyn.campaign.trends``.
Guarded by ``tests/cli/test_campaign_command.py`` and ``tests/report/test_campaign_page.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tcdyn.core import Array
from tcdyn.core.estimate import Z95
from tcdyn.estimation.line_fit import fit_line

# Set points differ by more than this share of the largest value; chosen by judgement.
SAME_SET_POINT = 0.01
# A line needs as many set points: through two, nothing shows whether it is straight.
MIN_SET_POINTS = 3


def count_set_points(x: Array) -> int:
    """Number of values that differ by more than 1 % of the largest: set points, not their scatter.

    Parameters
    ----------
    x
        Values (N,).

    Returns
    -------
    int
        Number of set points.

    Examples
    --------
    >>> count_set_points(np.array([850.2, 1459.0, 849.7, 1461.0]))
    2
    """
    set_points: list[float] = []
    for value in np.sort(x):
        if not set_points or value - set_points[-1] > SAME_SET_POINT * np.abs(x).max():
            set_points.append(float(value))
    return len(set_points)


class LineTrend(NamedTuple):
    """A least-squares line with the uncertainty of its slope.

    Parameters
    ----------
    intercept, slope
        Coefficients of the line.
    rms
        Root mean square of the residuals.
    u_slope
        Standard uncertainty of the slope.
    low95_slope, high95_slope
        95 % interval of the slope.
    """

    intercept: float
    slope: float
    rms: float
    u_slope: float
    low95_slope: float
    high95_slope: float


def least_squares_trend(x: Array, y: Array) -> LineTrend | None:
    """Least-squares line through points; None if fewer than three x differ by more than 1 %.

    Parameters
    ----------
    x, y
        Points (N,).

    Returns
    -------
    LineTrend or None
        The line; None if fewer than three x differ by more than 1 % of the largest.

    Notes
    -----
    The standard uncertainty of the slope is that of the scatter about the line. Its interval is
    Student's with N - 2 degrees of freedom.

    Examples
    --------
    >>> line = least_squares_trend(np.arange(4.0), np.array([1.0, 3.0, 5.0, 7.4]))
    >>> round(line.intercept, 2), round(line.slope, 2), round(line.u_slope, 3)
    (0.92, 2.12, 0.069)
    >>> round(line.high95_slope, 2)
    2.42
    >>> least_squares_trend(np.array([1.0, 2.0]), np.array([1.0, 3.0])) is None
    True
    """
    if count_set_points(x) < MIN_SET_POINTS:
        return None
    line = fit_line(x, y)
    u = np.sqrt(line.covariance[0, 0])
    half_width = Z95 * np.sqrt(line.covariance_95[0, 0])
    return LineTrend(
        intercept=float(line.intercept),
        slope=float(line.slope),
        rms=float(np.sqrt(np.mean(line.residuals**2))),
        u_slope=float(u),
        low95_slope=float(line.slope - half_width),
        high95_slope=float(line.slope + half_width),
    )
