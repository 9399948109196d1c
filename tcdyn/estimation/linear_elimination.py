"""Parameters that enter linearly, put at their best for every value of the others: a search in few dimensions."""

from __future__ import annotations

import numpy as np

from tcdyn.core import Array
from tcdyn.estimation.problem import Problem


def eliminated(problem: Problem, keep: int, at: Array) -> Problem:
    """The problem in its first ``keep`` parameters: its cost is the least over all others.

    The others, z (Q,), enter the residual r + E z with an E (N, Q) that is the same everywhere, here taken at ``at``
    (P,), have a prior each and no bounds, and stand in no combination that is held. With z in standard uncertainties
    off its prior, min_z |r + E z|^2 + |z|^2 = r'(I + E E')^-1 r = |W r|^2 with W = I - U (1 - (1 + s^2)^-1/2) U' for
    the singular vectors U and values s of E (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973), with
    priors). Costs, optima and profiles of the first ``keep`` are those of the whole problem.

    >>> import numpy as np
    >>> from tcdyn.estimation import Problem, minimise
    >>> def off(x): return np.array([x[0] ** 2 + x[1] - 3.0, x[1]]), np.array([[2 * x[0], 1.0], [0.0, 1.0]])
    >>> whole = Problem(("x", "shift"), off, prior_mean=np.array([0.0, 1.0]), prior_sd=np.array([np.inf, 0.5]))
    >>> few = eliminated(whole, 1, np.array([1.0, 1.0]))
    >>> [round(float(minimise(p, s).theta[0]), 4) for p, s in ((whole, np.ones(2)), (few, np.ones(1)))]
    [1.4832, 1.4832]
    """
    mean, sd = problem.prior_mean[keep:], problem.prior_sd[keep:]
    answer = problem.evaluate(at)
    assert answer is not None, "the model cannot be computed there"
    assert np.isfinite(sd).all(), "a linear parameter without a prior"
    vectors, values, _ = np.linalg.svd(answer[1][:, keep:] * sd, full_matrices=False)
    less = (1 - 1 / np.sqrt(1 + values**2))[:, None] * vectors.T

    def evaluate(theta: Array) -> tuple[Array, Array] | None:
        answer = problem.evaluate(np.append(theta, mean))
        if answer is None:
            return None
        both = np.column_stack([answer[0], answer[1][:, :keep]])
        both -= vectors @ (less @ both)
        return both[:, 0], both[:, 1:]

    own = slice(0, keep)
    return Problem(
        problem.names[own],
        evaluate,
        problem.prior_mean[own],
        problem.prior_sd[own],
        problem.lower[own],
        problem.upper[own],
        problem.largest[own],
        problem.fixed[:, own],
    )
