"""Causality check: an output that moves before its input is an error; a lead is accepted.

``tcdyn.identification.fitting.fit`` calls it for each input. It compares the best lag with a
negative dead time with the best causal one. The thresholds come from trials on simulated records;
``tests/identify/test_identify_causality.py`` checks that leads pass and that shifted or exchanged
columns do not.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.core.errors import InputError
from tcdyn.identification.excitation import is_periodic, period_of_sine
from tcdyn.identification.holds import MIN_REPEATED_SHARE
from tcdyn.identification.models import process
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.starting_values import lag_correlation

N_LEAD_LAGS = 12  # lags of the grid, of which two make a lead; chosen by judgement
MAX_REFINEMENTS = 4  # refinements of the grid of lags, from a factor 3 to 1 %
MIN_SAMPLES = 40  # of a record that is checked (chosen by judgement)
# Unexplained variance of a lag ahead of the input over that of the best causal lag, below which the
# output moves first. In trials every causal system, leads and integrators included, stayed above
# 0.97, exchanged or shifted columns below 0.63.
MAX_UNEXPLAINED_RATIO = 0.7
MIN_R2 = 0.3  # of a lag ahead of the input (from the same trials)


def check_causality(
    problem: IdentificationProblem, where: str, has_other_inputs: bool = False
) -> None:
    """Raise InputError where a lag with a *negative* dead time explains the output far better.

    Parameters
    ----------
    problem
        The identification problem of one input.
    where
        The file or function that the error names.
    has_other_inputs
        Whether other inputs move the output too. Then a shift at the end of the search does not
        count: a slow input may resemble what another one causes.

    Raises
    ------
    InputError
        Where the output moves before the input.

    Notes
    -----
    Far better means: more than two samples ahead, r^2 above 0.3, and less than 0.7 of the variance
    that the best dead time from zero upwards leaves unexplained. In trials every causal system,
    leads and integrators included, stayed above 0.97, exchanged or shifted columns below 0.63.

    On a record of little noise, a trial lag that is wrong by a factor leaves more unexplained than
    the right lag at a wrong time. A suspicion on the coarse grid of lags is therefore checked with
    refined lags on both sides. What remains may be a lead: a zero slower than the poles, which one
    lag cannot represent, or an integral with a drift. They explain nothing before their input
    moves. The record is accepted where a lead of two lags, or an integral, explains the output
    nearly as well as a lead explains any later output. So is one whose input and output are
    periodic from the first sample on, or whose input is a sine: a lead cannot be told from a delay
    of a period less.
    An output that was set by a computer and not measured is not that of a sensor: then the columns
    are exchanged, although a lead would fit too.

    A larger ``MAX_UNEXPLAINED_RATIO`` or a smaller ``MIN_R2`` finds more shifted columns and
    refuses more causal records. ``tests/identify/test_identify_causality.py`` and
    ``tests/identify/test_identify_data.py`` fail in either direction.
    """
    n_samples = sum(len(s.u) for s in problem.segments)
    if problem.model.integrators or n_samples < MIN_SAMPLES:
        return
    problem = replace(problem, model=process("P1D", known=problem.model.known))
    n = max(len(s.u) for s in problem.segments)
    reach = n // 4
    shift = _best_negative_shift(problem, n, reach)
    if shift is None or is_periodic(problem.segments):
        return
    if period_of_sine(problem.segments, problem.dt_s) is not None:
        return
    if has_other_inputs and shift == 0:
        return
    if not output_is_setpoint(problem):
        unexplained = 1 - max(lead_correlation(problem), integral_correlation(problem))
        trials = np.unique(np.geomspace(3, max(reach - shift, 3), 6).astype(int))
        limit = MAX_UNEXPLAINED_RATIO * unexplained
        if all(1 - lead_correlation(problem, int(k)) >= limit for k in trials):
            return
    raise InputError(
        f"the output moves about {(reach - shift) * problem.dt_s:.3g} s before the input",
        where=where,
        expected="an output that follows its input",
        remedy="check that the columns are not exchanged and that both clocks agree; in a closed "
        "loop the input answers the output: use a record with the loop open, or {check}",
        parameters={"check": False},
    )


def _best_negative_shift(problem: IdentificationProblem, n: int, reach: int) -> int | None:
    """Position of the best shift ahead of the input where it is far better than any causal one.

    None where a causal dead time is good enough.

    Parameters
    ----------
    problem
        The identification problem of one input, with one lag.
    n
        Samples of the longest segment.
    reach
        Largest shift ahead of the input and behind it, in samples.

    Returns
    -------
    int or None
        Position of the shift, counted from -``reach`` samples.
    """
    taus = np.geomspace(problem.dt_s, 0.3 * n * problem.dt_s, 8)
    ratio = float(taus[1] / taus[0])
    grids = [taus]
    # r^2, position, lag: ahead of the input and behind it
    best = [(-1.0, 0, 0.0), (-1.0, 0, 0.0)]
    for _ in range(MAX_REFINEMENTS + 1):
        for grid in grids:
            score = np.abs(lag_correlation(problem, grid, reach, reach))
            for side, part in enumerate((score[:, : reach - 2], score[:, reach - 2 :])):
                k, position = np.unravel_index(int(np.argmax(part)), part.shape)
                candidate = (float(part[k, position]), int(position), float(grid[k]))
                best[side] = max(best[side], candidate)
        r2_ahead, shift, _ = best[0]
        r2_causal = best[1][0]
        is_better = 1 - r2_ahead < MAX_UNEXPLAINED_RATIO * (1 - r2_causal)
        if not (r2_ahead > MIN_R2 and is_better):
            return None
        grids = [tau * np.geomspace(1 / ratio, ratio, 9) for _, _, tau in best]
        ratio = ratio**0.3
    return shift


def output_is_setpoint(problem: IdentificationProblem) -> bool:
    """Whether the output mostly repeats the sample before, as if set by a computer.

    False where the input does too.
    """
    outputs = np.concatenate([s.filled_y for s in problem.segments])
    inputs = np.concatenate([s.u for s in problem.segments])
    output_repeats = np.mean(np.diff(outputs) == 0)
    input_repeats = np.mean(np.diff(inputs) == 0)
    return bool(output_repeats > MIN_REPEATED_SHARE > input_repeats)


def integral_correlation(problem: IdentificationProblem) -> float:
    """Return r^2 of the output with the integral of the input, a constant and a slope.

    The slope is that of a plant whose input at rest is not zero. Each segment has its own.
    """
    unexplained = 0.0
    total = 0.0
    for s in problem.segments:
        y = s.filled_y
        integral = np.cumsum(s.u - s.u.mean())
        table = np.column_stack([np.ones(len(y)), np.linspace(-1, 1, len(y)), integral])
        residual = y - table @ np.linalg.lstsq(table, y, rcond=1e-12)[0]
        unexplained += float(residual @ residual)
        total += float(np.sum((y - y.mean()) ** 2))
    return 1 - unexplained / max(total, 1e-300)


def lead_correlation(problem: IdentificationProblem, ahead: int = 0) -> float:
    """Return the largest r^2 of the output with the input and two of its lags.

    Two lags with two zeros include a lead. Segments start in equilibrium and share the constant.

    Parameters
    ----------
    problem
        The identification problem of one input.
    ahead
        Samples by which the output is shifted to later times.

    Returns
    -------
    float
        The coefficient of determination, from 0 to 1.
    """
    taus = np.geomspace(2 * problem.dt_s, 0.3 * problem.longest_segment_s, N_LEAD_LAGS)
    known = problem.model.known
    systems = []
    for factors in ((), *((Factor((1.0, float(tau))),) for tau in taus)):
        rational = Rational(np.array(known.num), (*factors, *known.factors))
        systems.append(realise(rational, False))
    rows = []
    for s in problem.segments:
        lagged = [
            simulate_rows(system, s.u, problem.dt_s, 0.0, problem.hold, problem.start)[0][ahead:]
            for system in systems
        ]
        output = s.filled_y[: max(len(s.u) - ahead, 0)]
        rows.append(np.vstack([output, *lagged]))
    table = np.hstack(rows)
    table = table - table.mean(axis=1, keepdims=True)
    output = table[0]
    total = float(output @ output)
    best = 0.0
    for pair in combinations(range(2, len(table)), 2):
        basis = table[[1, *pair]]
        weights = np.linalg.lstsq(basis @ basis.T, basis @ output, rcond=1e-12)[0]
        best = max(best, 1 - float(np.sum((output - basis.T @ weights) ** 2)) / total)
    return best
