"""Trends of beta over the test conditions by generalised least squares; comparison with a curve.

``tcdyn.campaign.result`` uses it. Guarded by ``tests/campaign/test_lines.py``,
``tests/campaign/test_posterior.py`` and ``tests/campaign/test_curve_offset.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc

from tcdyn.campaign.line_fit import Line, fit_generalised_line, level_inside_points
from tcdyn.campaign.posterior import Posterior
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import jsonable
from tcdyn.io.read import read_numbers

# Conditions of a test over which beta may have a line, or a curve its x.
TREND_VARIABLES = ("delta_T_us_K_m_s", "load_N", "sliding_speed_m_s", "entraining_speed_m_s")
# Conditions of the line over two of them. Entraining speed is proportional to sliding speed at one
# gear ratio, so that it adds nothing.
JOINT_TREND_VARIABLES = ("load_N", "sliding_speed_m_s")
# Set points closer than this share of the largest value are one. Chosen by judgement.
SET_POINT_SEPARATION_REL = 0.01
# Fewest tests, and fewest set points, for a trend; chosen by judgement.
MIN_TESTS = 3
# p-value of the tests' departures below which a curve's shape is rejected. The usual level of 5 %:
# of 2000 simulated campaigns with a curve of the correct shape, 4.7 % were rejected
# (tests/campaign/curve_study.py).
SHAPE_REJECTED_P = 0.05


@dataclass(frozen=True)
class BetaTrend:
    """beta = level + sum slope_k (x_k - mean of x_k); slopes per unit of x.

    ``against``: names of the x; ``slopes`` in that order; ``p_value`` of each being zero;
    ``scatter`` of the tests about the line beyond their uncertainties; ``line_p_value``: chance of
    their departures if there were none.

    Parameters
    ----------
    against
        Names of the x.
    slopes
        Slope over each.
    p_value
        Probability of each slope if it were zero.
    scatter
        Standard deviation of the tests about the line beyond their uncertainties.
    line_p_value
        Probability of their departures if there were no scatter.
    mean
        Mean of each x over the tests.
    line
        The fit.
    """

    against: tuple[str, ...]
    slopes: tuple[Estimate, ...]
    p_value: tuple[float, ...]
    scatter: float
    line_p_value: float
    mean: Array = field(repr=False)
    line: Line = field(repr=False)

    def evaluate(self, x: Array) -> tuple[Array, Array]:
        """beta on a trend over one x, and its standard uncertainty within the campaign.

        Parameters
        ----------
        x
            Values of x, (M,).

        Returns
        -------
        beta, u
            (M,) each; ``u`` is against the mean of beta of the tests.
        """
        n = self.line.operator.shape[1]
        columns = np.column_stack([np.ones(len(x)), x - self.mean[0]])
        difference = columns @ self.line.operator - 1.0 / n
        return columns @ self.line.coefficients, np.sqrt(
            np.clip(np.diag(difference @ self.line.total_covariance @ difference.T), 0.0, None)
        )

    def to_dict(self) -> dict[str, Any]:
        """The entry of ``campaign.json``; a trend over several x has lists."""
        data: dict[str, Any] = {
            "against": self.against,
            "slope": self.slopes,
            "p_value": self.p_value,
        }
        if len(self.against) == 1:
            data = {k: v[0] for k, v in data.items()}
        return jsonable({**data, "scatter": self.scatter, "p_value_of_line": self.line_p_value})


def set_points(x: Array) -> int:
    """Number of values that differ by more than 1 % of the largest (``SET_POINT_SEPARATION_REL``).

    >>> set_points(np.array([850.2, 1459.0, 849.7, 1461.0]))
    2
    """
    ordered = np.sort(x)
    return 1 + int(np.sum(np.diff(ordered) > SET_POINT_SEPARATION_REL * np.abs(x).max()))


def trend(posterior: Posterior, *against: str) -> BetaTrend | None:
    """The line of beta over one or more conditions; None where the tests do not determine it.

    Parameters
    ----------
    posterior
        Posterior of the campaign.
    *against
        One or more of ``TREND_VARIABLES``.

    Notes
    -----
    It needs ``MIN_TESTS`` tests, one more for each further condition, and ``MIN_TESTS`` set points
    of each.
    """
    conditions = [t.conditions for t in posterior.tests]
    if len(conditions) < MIN_TESTS + len(against) - 1 or any(
        a not in c for a in against for c in conditions
    ):
        return None
    x = np.array([[c[a] for a in against] for c in conditions])
    if not np.isfinite(x).all() or min(set_points(column) for column in x.T) < MIN_TESTS:
        return None
    mean = x.mean(axis=0)
    line = fit_generalised_line(np.column_stack([np.ones(len(x)), x - mean]), *posterior.beta)
    ks = range(1, 1 + len(against))
    return BetaTrend(
        against,
        tuple(line.estimate(k) for k in ks),
        tuple(line.p_value_of_zero(k) for k in ks),
        line.scatter,
        line.p_value,
        mean,
        line,
    )


def trends(posterior: Posterior) -> tuple[BetaTrend, ...]:
    """Lines over each of ``TREND_VARIABLES``, then over ``JOINT_TREND_VARIABLES`` together.

    Parameters
    ----------
    posterior
        Posterior of the campaign.

    Returns
    -------
    Those lines that the tests determine.
    """
    variable_sets = [*((a,) for a in TREND_VARIABLES), JOINT_TREND_VARIABLES]
    return tuple(t for names in variable_sets if (t := trend(posterior, *names)) is not None)


@dataclass(frozen=True)
class Curve:
    """beta of a user's model over one condition.

    Parameters
    ----------
    file
        Name of the file.
    against
        One of ``TREND_VARIABLES``.
    x
        Its values, rising, (M,).
    beta
        beta at each, (M,).
    u
        Standard uncertainty of beta, (M,); zero where it is not given.
    """

    file: str
    against: str
    x: Array
    beta: Array
    u: Array


@dataclass(frozen=True)
class CurveTest:
    """A model's curve against the tests that lie in its range.

    ``chi2`` with the full covariance on ``freedom`` degrees, and ``p_value``; ``shape_chi2`` and
    ``shape_p_value`` with the curve's level free; ``offset``: tests less curve. ``inside``: names
    of those tests. ``scatter``: standard deviation of the independent scatter added to every test
    for ``offset`` where the shape is rejected, else zero.

    Parameters
    ----------
    curve
        The curve.
    inside
        Names of the tests in its range.
    chi2, p_value
        Chi-squared with the full covariance and one degree of freedom for each test, and its p
        value.
    shape_chi2, shape_p_value
        The same with the level of the curve free.
    offset
        Tests minus curve.
    scatter
        Standard deviation of the independent scatter added to every test for ``offset`` where the
        shape is rejected, else zero.
    """

    curve: Curve
    inside: tuple[str, ...]
    chi2: float
    p_value: float
    shape_chi2: float
    shape_p_value: float
    offset: Estimate
    scatter: float = 0.0

    @property
    def shape_rejected(self) -> bool:
        """Whether the tests depart from the curve by more than a level and their uncertainties."""
        return self.shape_p_value < SHAPE_REJECTED_P

    def to_dict(self) -> dict[str, Any]:
        """The entry of ``campaign.json``."""
        return {
            "file": self.curve.file,
            "against": self.curve.against,
            "tests": list(self.inside),
            "chi2": self.chi2,
            "freedom": len(self.inside),
            "p_value": self.p_value,
            "shape_chi2": self.shape_chi2,
            "shape_p_value": self.shape_p_value,
            "offset": self.offset.model_dump(),
            "scatter": self.scatter,
        }


def read_curve(path: str | Path) -> Curve:
    """Read a model's curve.

    Parameters
    ----------
    path
        Table with one column of ``TREND_VARIABLES``, the column beta, and u_beta if it is known.

    Raises
    ------
    InputError
        A missing column, fewer than two points, values of x that do not rise, or beta that is no
        share.
    """
    values = read_numbers(path, ("beta",), (*TREND_VARIABLES, "u_beta"))
    x_names = [a for a in TREND_VARIABLES if a in values]
    if len(x_names) != 1:
        raise InputError(
            f"it holds {' and '.join(x_names) or 'nothing'} to lay beta over",
            where=str(path),
            expected=f"one of {', '.join(TREND_VARIABLES)}",
        )
    x = values[x_names[0]]
    beta = values["beta"]
    u = values.get("u_beta", np.zeros(len(x)))
    if len(x) < 2 or not (np.diff(x) > 0).all():
        raise InputError(
            f"{x_names[0]} does not rise from row to row",
            where=str(path),
            expected="two rows or more",
        )
    if not ((beta > 0) & (beta < 1)).all() or (u < 0).any():
        raise InputError(
            "beta is not a share",
            where=str(path),
            expected="beta between 0 and 1, u_beta not below 0",
        )
    return Curve(Path(path).name, x_names[0], x, beta, u)


def curve_test(posterior: Posterior, curve: Curve) -> CurveTest:
    """Chi-squared of the tests about a curve, with straight lines between its points.

    Parameters
    ----------
    posterior
        Posterior of the campaign.
    curve
        The curve.

    Raises
    ------
    InputError
        Fewer than two tests lie within its range.

    Notes
    -----
    The uncertainty of the curve is taken as one error common to all of it. The offset is that of
    :func:`~tcdyn.campaign.line_fit.level_inside_points`; where the shape is rejected, the scatter
    that explains the departures is part of the covariance.
    ``tests/campaign/test_curve_offset.py`` guards both cases.
    """
    x = np.array([t.conditions.get(curve.against, np.nan) for t in posterior.tests])
    inside = np.flatnonzero((x >= curve.x[0]) & (x <= curve.x[-1]))
    if len(inside) < 2:
        raise InputError(
            f"{len(inside)} tests lie within its {curve.against} of {curve.x[0]:g} to "
            f"{curve.x[-1]:g}",
            where=curve.file,
            expected="two or more",
            remedy="carry the curve on as far as the tests go",
        )
    u = np.interp(x[inside], curve.x, curve.u)
    beta, covariance = posterior.beta
    residual = beta[inside] - np.interp(x[inside], curve.x, curve.beta)
    combined = covariance[np.ix_(inside, inside)] + np.outer(u, u)
    chi2 = float(residual @ np.linalg.solve(combined, residual))
    line = fit_generalised_line(np.ones((len(residual), 1)), residual, combined)
    if line.p_value >= SHAPE_REJECTED_P:
        line = replace(line, scatter=0.0, total_covariance=combined)
    level = level_inside_points(residual, line)
    return CurveTest(
        curve=curve,
        inside=tuple(posterior.test_names[i] for i in inside),
        chi2=chi2,
        p_value=float(chdtrc(len(residual), chi2)),
        shape_chi2=line.chi2,
        shape_p_value=line.p_value,
        offset=level.estimate(0),
        scatter=line.scatter,
    )
