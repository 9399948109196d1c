"""Whether there is anything to find: an output that moves before its input is refused, a lead is not."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.core.errors import InputError
from tcdyn.identify.models import process
from tcdyn.identify.problem import Posed
from tcdyn.identify.segments import REPEATED
from tcdyn.identify.starting_values import explained, filled

LEADS = 12  # lags of which two make a lead
REFINED = 4  # times the row of lags is narrowed to its cube root and less: from a factor 3 to 1 %


def check_causality(problem: Posed, where: str) -> None:
    """Raise InputError when a lag with a *negative* dead time explains the output far better than any real one.

    Far better means: more than two samples ahead, r^2 above 0.3, and less than 0.7 of the variance that the best
    dead time from zero upwards leaves unexplained. In trials every causal system, leads and integrators included,
    stayed above 0.97, exchanged or shifted columns below 0.63. On a record of little noise a trial lag a factor off
    leaves more than the right one early; so what a coarse row of lags suspects is judged by lags refined on both sides.
    What it still suspects may be a lead: a zero slower than the poles, of which one lag knows nothing. A lead explains
    nothing before its input moves; so where one with two lags does nearly as well as any of them early, it stands. An
    output that was set and not measured is no sensor's: there the columns are exchanged, though a lead would fit too.
    """
    if problem.model.integrators or sum(len(s.u) for s in problem.segments) < 40:
        return
    plain = replace(problem, model=process("P1D", known=problem.model.known))
    n = max(len(s.u) for s in problem.segments)
    reach = n // 4
    taus = [np.geomspace(problem.dt_s, 0.3 * n * problem.dt_s, 8)]
    # r^2, place, lag: ahead of the input, behind it
    ratio = float(taus[0][1] / taus[0][0])
    best = [(-1.0, 0, 0.0)] * 2
    for _ in range(REFINED + 1):
        for row in taus:
            score = np.abs(explained(plain, row, reach, reach))
            for side, part in enumerate((score[:, : reach - 2], score[:, reach - 2 :])):
                k, place = map(int, np.unravel_index(int(np.argmax(part)), part.shape))
                best[side] = max(best[side], (float(part[k, place]), place, float(row[k])))
        (early, at, _), (late, _, _) = best
        if not (early > 0.3 and 1 - early < 0.7 * (1 - late)):
            return
        taus = [tau * np.geomspace(1 / ratio, ratio, 9) for _, _, tau in best]
        ratio = ratio**0.3
    if not held_output(problem):
        left = 1 - leading(plain)
        trials = np.unique(np.geomspace(3, max(reach - at, 3), 6).astype(int))
        if all(1 - leading(plain, int(k)) >= 0.7 * left for k in trials):
            return
    raise InputError(
        f"the output moves about {(reach - at) * problem.dt_s:.3g} s before the input",
        where=where,
        expected="an output that follows its input",
        remedy="check that the columns are not exchanged and that both clocks agree; in a closed loop the input "
        "answers the output: use a record with the loop open, or {check}",
        parameters={"check": False},
    )


def held_output(problem: Posed) -> bool:
    """Whether the output mostly repeats the sample before, as what a computer sets, and the input does not."""
    repeats = [
        np.mean(np.diff(np.concatenate(x)) == 0)
        for x in zip(*((filled(s), s.u) for s in problem.segments))
    ]
    return bool(repeats[0] > REPEATED > repeats[1])


def leading(problem: Posed, ahead: int = 0) -> float:
    """The largest r^2 of the output, ``ahead`` samples later, with the input and what any two of a row of lags make of
    it.

    Two lags with two zeros, a lead among them. Segments begin in equilibrium and share the constant.
    """
    taus = np.geomspace(2 * problem.dt_s, 0.3 * problem.longest_s, LEADS)
    rows = []
    for s in problem.segments:
        lagged = [
            simulate_rows(
                realise(
                    Rational(np.array(problem.model.known.num), (*f, *problem.model.known.factors)),
                    False,
                ),
                s.u,
                problem.dt_s,
                0.0,
                problem.hold,
                problem.begun,
            )[0]
            for f in ((), *((Factor((1.0, float(tau))),) for tau in taus))
        ]
        rows.append(
            np.vstack([filled(s)[: max(len(s.u) - ahead, 0)], *(x[ahead:] for x in lagged)])
        )
    table = np.hstack(rows)
    table = table - table.mean(axis=1, keepdims=True)
    whole = float(table[0] @ table[0])
    best = 0.0
    for pair in combinations(range(2, len(table)), 2):
        basis = table[[1, *pair]]
        fitted = basis.T @ np.linalg.lstsq(basis @ basis.T, basis @ table[0], rcond=1e-12)[0]
        best = max(best, 1 - float(np.sum((table[0] - fitted) ** 2)) / whole)
    return best
