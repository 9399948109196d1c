"""How well a fit simulates what it has not seen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from tcdyn.core.errors import InputError
from tcdyn.estimation import correlation_length
from tcdyn.identify.fit import fit
from tcdyn.identify.iodata import IOData
from tcdyn.identify.search import Fit
from tcdyn.identify.segments import SHORTEST, cut
from tcdyn.identify.starting_values import polished

LASTING = 0.3  # of the held-out part: a disturbance that lasts so long is foreseen from the level it has reached
QUICK: dict[str, Any] = {
    "intervals": "quadratic",
    "check": False,
}  # options of fits that only a score is asked of
Progress = Callable[[str, int, int], None]  # name of the model, its number, how many there are


def divide(data: IOData, held_out: IOData | float) -> tuple[IOData | None, IOData, float]:
    """Training data, data to simulate, and the time from which their error counts [s]."""
    if isinstance(held_out, IOData):
        return None, held_out, -np.inf
    if not 0 < held_out < 1:
        raise InputError(f"held_out is {held_out}", expected="a share between 0 and 1, or IOData")
    if len(data.runs) > 1:
        return replace(data, runs=data.runs[:-1]), data.run(len(data.runs) - 1), -np.inf
    run = data.runs[0]
    edge = run.start_s + (run.n - 1) * data.dt_s * (1 - held_out)
    train = data.between(None, edge)
    return train, data, edge + 0.5 * data.dt_s


def held_out_score(result: Fit, test: IOData, from_s: float = -np.inf) -> tuple[float, float]:
    """Simulation rms and NRMSE fit percent of ``result`` on ``test`` from time ``from_s`` on (:func:`judged`)."""
    return judged(result, test, from_s)[:2]


@dataclass(frozen=True)
class Task:
    """What is asked of every model of a comparison: to be fitted to ``data`` with the ``options``, and to foresee what
    is ``held_out``; ``progress`` is told."""

    data: IOData
    held_out: IOData | float
    progress: Progress
    options: Mapping[str, Any]

    def __post_init__(self) -> None:
        divide(self.data, self.held_out)  # refuses at once what cannot be held out

    def but(self, what: str, **options: Any) -> Task:
        """With other options; ``progress`` is told with each name ``what`` is done to it."""

        def told(name: str, number: int, count: int) -> None:
            self.progress(f"{name}, {what}", number, count)

        return replace(self, progress=told, options={**self.options, **options})

    def unseen(self, found: Fit, **options: Any) -> tuple[float, float, float]:
        """:func:`judged` of the model of ``found``, fitted anew where a part of the data is held out.

        Raises InputError where too little is left of the record.
        """
        train, test, from_s = divide(self.data, self.held_out)
        if train is not None:
            found = fit(train, found.problem.model, **{**self.options, **options, **QUICK})
        return judged(found, test, from_s)


def judged(result: Fit, test: IOData, from_s: float = -np.inf) -> tuple[float, float, float]:
    """Simulation rms and NRMSE fit percent of ``result`` on ``test`` from time ``from_s`` on, and the chance of an
    error no smaller from the noise of the fit alone.

    Nothing is re-estimated but the states that are free (after a gap, or all with "estimated"); a drift goes on, from
    what it was at the end of the fit's data, with a slope of its own. A record that is scored from some time on is
    continued from the state that suits what came before, any other gets the state that suits it.
    The chance is that of the innovations' variance over that of the fit's (F test; coloured ones count for fewer).
    """
    model = result.identified
    cuts = [replace(s, y=s.y - model.offset) for s in cut(test)]
    scored = [s.seen & (s.start_s + np.arange(len(s.y)) * test.dt_s >= from_s) for s in cuts]
    before = [s.seen & ~late for s, late in zip(cuts, scored)]
    begun = tuple(
        replace(s, seen=seen) if seen.sum() >= SHORTEST else s for s, seen in zip(cuts, before)
    )
    known = replace(model.model, fixed=model.theta, offset="none")
    posed = replace(
        result.problem, model=known, segments=begun, dt_s=test.dt_s, hold=test.hold, trend=False
    )
    answers = posed.outputs(polished(posed, {})[1])
    assert answers is not None
    all_of_it = np.concatenate([(s.y - y)[s.seen] for s, (y, _) in zip(cuts, answers)])
    late = np.concatenate([late[s.seen] for s, late in zip(cuts, scored)])
    whole = replace(posed, segments=tuple(cuts)).parts
    if result.problem.trend and not late.all():
        since = np.cumsum(late)[late]
        all_of_it[late] -= since * (since @ all_of_it[late]) / (since @ since)
    error = all_of_it[late]
    innovation = result.noise.whiten(all_of_it, whole)[late]
    if (
        result.noise.memory > LASTING * len(error) and not late.all()
    ):  # from the level at which a walk is by then
        error = error - np.mean(all_of_it[~late][-SHORTEST:])
    spread = np.concatenate(
        [s.y[late] - np.mean(s.y[late]) for s, late in zip(cuts, scored) if late.any()] or [error]
    )
    if len(error) == 0:
        return np.nan, np.nan, np.nan
    top = float(np.sqrt(np.mean(error**2)))
    base = float(np.sqrt(np.mean(spread**2)))
    ratio = float(np.mean(innovation**2)) / max(model.noise_sd**2, 1e-300)
    freedom = [max(len(e) / correlation_length(e), 1.0) for e in (innovation, result.innovation)]
    return top, 100 * (1 - top / base) if base > 0 else np.nan, float(fdtrc(*freedom, ratio))


def blocks_out(found: Fit, count: int = 6) -> float:
    """Simulation rms over ``count`` - 1 blocks of the record, each left out of the fit in turn; the first never is,
    for it tells the state at the start.

    Leaving block b out moves the parameters by (J'J - J_b'J_b)^-1 J_b' w_b, J the slopes of the innovations w, and what
    is simulated there by its own slopes times that: exact where the problem is linear.
    """
    answer = found.problem.evaluate(found.x)
    w = found.optimum.residual
    j = found.optimum.jacobian
    assert answer is not None
    w = w * found.root
    j = j * found.root[:, None]
    size = np.linalg.norm(j, axis=0)
    size[size == 0] = np.inf
    a = j / size
    whole = a.T @ a + np.diag(found.problem.precision / size**2)
    errors = []
    for b in np.array_split(np.arange(len(w)), count)[1:]:
        step = np.linalg.lstsq(whole - a[b].T @ a[b], a[b].T @ w[b], rcond=1e-10)[0] / size
        errors.append(answer[0][b] + answer[1][b] @ step)
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
