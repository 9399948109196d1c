"""Elimination of parameters that enter linearly: variable projection with priors.

``tcdyn.partition.profile`` eliminates nuisance parameters with it, so that each fit of a likelihood
profile has few parameters. Guarded by ``tests/estimation/test_fitting.py``.
"""

from __future__ import annotations

import numpy as np

from tcdyn.core import Array
from tcdyn.estimation.problem import Problem


def eliminate_linear(problem: Problem, keep: int, at: Array) -> Problem:
    """The problem in its first ``keep`` parameters; its cost is the minimum over all others.

    Parameters
    ----------
    problem
        The full problem. The other parameters, z (Q,), have a prior each, no bounds, and are in no
        fixed combination.
    keep
        Number of parameters that remain.
    at
        Point (P,) where the sensitivity E (N, Q) of the residual to z is taken; E must be the same
        everywhere.

    Returns
    -------
    A problem with ``keep`` parameters and the priors, bounds and fixed combinations of them.

    Notes
    -----
    The residual is r + E z. With z in standard uncertainties from its prior, min_z |r + E z|^2 +
    |z|^2 = r'(I + E E')^-1 r = |W r|^2 with W = I - U (1 - (1 + s^2)^-1/2) U' for the singular
    vectors U and values s of E (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10
    (1973), with priors). Costs, optima and profiles of the first ``keep`` parameters are those of
    the full problem.

    A parameter whose effect is only nearly linear must not be eliminated: the cost is then not its
    minimum.

    Examples
    --------
    >>> import numpy as np
    >>> from tcdyn.estimation import Problem, minimise
    >>> def off(x):
    ...     residual = np.array([x[0] ** 2 + x[1] - 3.0, x[1]])
    ...     return residual, np.array([[2 * x[0], 1.0], [0.0, 1.0]])
    >>> priors = {"prior_mean": np.array([0.0, 1.0]), "prior_sd": np.array([np.inf, 0.5])}
    >>> full = Problem(("x", "shift"), off, **priors)
    >>> few = eliminate_linear(full, 1, np.array([1.0, 1.0]))
    >>> [round(float(minimise(p, np.ones(p.size)).theta[0]), 4) for p in (full, few)]
    [1.4832, 1.4832]
    """
    mean = problem.prior_mean[keep:]
    sd = problem.prior_sd[keep:]
    evaluated = problem.evaluate(at)
    assert evaluated is not None, "the model cannot be computed there"
    assert np.isfinite(sd).all(), "a linear parameter without a prior"
    vectors, values, _ = np.linalg.svd(evaluated[1][:, keep:] * sd, full_matrices=False)
    reduction = (1 - 1 / np.sqrt(1 + values**2))[:, None] * vectors.T

    def evaluate(theta: Array) -> tuple[Array, Array] | None:
        """Residual and Jacobian of the ``keep`` parameters, with the others at their minimum."""
        evaluated = problem.evaluate(np.append(theta, mean))
        if evaluated is None:
            return None
        columns = np.column_stack([evaluated[0], evaluated[1][:, :keep]])
        columns -= vectors @ (reduction @ columns)
        return columns[:, 0], columns[:, 1:]

    remaining = slice(0, keep)
    return Problem(
        problem.names[remaining],
        evaluate,
        problem.prior_mean[remaining],
        problem.prior_sd[remaining],
        problem.lower[remaining],
        problem.upper[remaining],
        problem.max_step[remaining],
        problem.fixed[:, remaining],
    )
