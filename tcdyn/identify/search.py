"""The problem that data pose; the prediction-error search: a few short descents from the best starts, the winner taken
to convergence; and the finished fit that comes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding
from tcdyn.core.result import Result
from tcdyn.estimation import Loss, Noise, Optimum, Problem, least, minimise
from tcdyn.identify.identified import Identified
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import Model, bare, beside, suffix
from tcdyn.identify.problem import Initial, Posed
from tcdyn.identify.segments import SHORTEST, cut, input_noise_sd
from tcdyn.identify.starting_values import starts


@dataclass(frozen=True)
class Fit(Result):
    """A finished fit: the identified model and everything needed to judge it.

    ``residual`` (N,) is measured minus simulated at the measured samples, ``innovation`` (N,) the same after the noise
    model and the robust loss's weights, ``slopes`` (N, size) its negative Jacobian by x; ``optimum`` is that of the
    innovation without those ``weights`` (N,); ``covariance_x`` is that of the whole vector x.
    """

    identified: Identified
    problem: Posed
    optimum: Optimum
    residual: Array
    innovation: Array
    slopes: Array
    covariance_x: Array
    noise: Noise
    loss: Loss = "linear"
    weights: Array | None = None

    @property
    def x(self) -> Array:
        """All that was fitted: model parameters (positive ones as logarithms), offsets, initial states."""
        return self.optimum.theta

    @property
    def root(self) -> Array:
        """The roots (N,) of the robust weights, ones where there are none."""
        return np.broadcast_to(root_of(self.weights), self.residual.shape)

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """The free parameters with their intervals."""
        return self.identified.estimates

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was noticed."""
        return self.identified.findings

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know."""
        return self.identified.warnings

    @property
    def disturbance(self) -> dict[str, Any]:
        """The options ``noise`` and ``baseline`` that ask :func:`tcdyn.identify.fit` for this noise again."""
        if self.noise.averaged:
            return {"noise": "slow", "baseline": "auto"}
        walks = self.noise.walks
        order = self.noise.order
        kind = "walk" if walks else "trend" if self.problem.trend else "none"
        return {"noise": order if any(order) or walks else "white", "baseline": kind}

    def simulated(self) -> list[Array]:
        """The model's output over every segment of the data (N,)."""
        answers = self.problem.outputs(self.x)
        assert answers is not None
        return [y for y, _ in answers]

    def summary(self) -> str:
        """The table people read."""
        return self.identified.summary()

    def to_dict(self) -> dict[str, Any]:
        """The identified model as its file holds it."""
        return self.identified.to_dict()

    def card(self) -> pd.DataFrame:
        """Parameters with their standard uncertainties and intervals."""
        return self.identified.card()


def nothing_left(data: IOData) -> str:
    """Which column is to blame where no stretch of the data can be used."""
    every = [(n, [r.u[:, k] for r in data.runs]) for k, n in enumerate(data.input_names)]
    for name, columns in (*every, (data.output_names[0], [r.y[:, 0] for r in data.runs])):
        if not any(np.isfinite(c).any() for c in columns):
            return f"column {name} holds no number at all (NaN everywhere)"
    names = ", ".join(data.input_names)
    have = "has" if len(data.input_names) == 1 else "have"
    return f"column {names} {have} no {SHORTEST} samples in a row, with the output measured, without a gap"


def pose(
    data: IOData, model: Model, initial: Initial, input_noise: float | Literal["auto"] = 0.0
) -> Posed:
    """The problem of fitting ``model`` to the data of one output and as many inputs as the model has; refuses data
    nothing can be learnt from. ``input_noise`` is its sd, in the input's unit."""
    where = data.name or "identify"
    inputs = max(len(model.parts), 1)
    if len(data.output_names) != 1:
        raise InputError(
            f"the data hold {len(data.output_names)} outputs ({', '.join(data.output_names)})",
            where=where,
            remedy="fit them one by one: data.select(output=..), or compare_outputs(data)",
        )
    if len(data.input_names) != inputs or model.inputs not in ((), data.input_names):
        raise InputError(
            f"the data hold {len(data.input_names)} inputs ({', '.join(data.input_names)}), {model.name} has "
            f"{', '.join(model.inputs) or 'one'}",
            where=where,
            remedy='choose one: data.select(input=..), or give a model to each: several(["P1D", ..], data.input_names)',
        )
    segments = cut(data)
    if not segments:
        raise InputError(
            nothing_left(data), where=where, remedy="see whether the right column was taken"
        )
    for k, name in enumerate(data.input_names):
        if np.ptp(np.concatenate([s.inputs[:, k] for s in segments])) == 0:
            raise InputError(
                f"input {name} is constant ({segments[0].inputs[0, k]:g})",
                where=where,
                expected="an input that moves: without a change there is no dynamics to see",
            )
    for part in model.parts or (model,):
        if (
            data.hold == "zoh"
            and "Td" in part.names
            and part.order + part.integrators + len(part.known.den) == 1
        ):
            raise InputError(
                f"{part.name} cannot find a dead time under a held input: nothing moves until it passes a whole sample",
                remedy="add a lag (P1D)",
            )
    if input_noise != "auto" and not 0 <= input_noise < np.inf:
        raise InputError(
            f"the input's noise is {input_noise}",
            where=where,
            expected="a standard deviation in the input's unit",
        )
    alone = [[s.of(k) for s in segments] for k in range(inputs)]
    sds = tuple(
        input_noise_sd(each) if input_noise == "auto" else float(input_noise) for each in alone
    )
    problem = Posed(model, segments, data.dt_s, data.hold, initial, input_sds=sds)
    problem = replace(
        problem, noise_sd=float(np.std(np.diff(problem.measured))) / np.sqrt(2) or 1.0
    )
    if problem.n_seen < max(2 * problem.size, 8):
        raise InputError(
            f"{problem.n_seen} measured samples for {problem.size} unknowns of {model.name}",
            where=where,
            expected=f"at least {max(2 * problem.size, 8)}",
            remedy="record longer or choose a smaller model",
        )
    if all(np.nanstd(s.y) == 0 for s in segments):
        raise InputError(
            f"output {data.output_names[0]} never moves", where=where, remedy="check the channel"
        )
    return problem


def search(
    posed: Posed, core: Problem | None = None, start: Array | Sequence[Array] = ()
) -> Optimum:
    """The least-squares optimum of ``posed``; ``core`` replaces its residuals by filtered or weighted ones."""
    core = core or posed.core()
    tried = list(np.atleast_2d(start)) if len(start) else diverse(posed, starts(posed))
    if len(tried) > 1:
        tried = [
            least([minimise(core, x0, limit=6, tolerance=0.0, relative=1e-4) for x0 in tried]).theta
        ]
    # the noise is not known: only the cost itself says what is little of it
    found = minimise(core, tried[0], limit=80, tolerance=0.0) if tried else None
    if found is None or not np.isfinite(found.cost):
        raise InputError(
            f"no stable {posed.model.name} was found from any start",
            expected="data in which the output follows the input",
            remedy="plot the record, check that input and output are not exchanged, or give start= from Python",
        )
    return ordered(posed, kicked(posed, found))


def diverse(posed: Posed, ranked: list[Array]) -> list[Array]:
    """The four best starts that are not near copies of a better one: 30 % apart in some lag or dead time."""
    chosen: list[Array] = []
    for x in ranked:
        times = spans(posed, x)
        size = np.abs(times).sum() + posed.dt_s
        if all(np.max(np.abs(times - spans(posed, c))) > 0.15 * size for c in chosen):
            chosen.append(x)
    return chosen[:4] or ranked[:1]


def spans(posed: Posed, x: Array) -> Array:
    """The times among the parameters [s]."""
    return np.array([v for n, v in posed.theta(x).items() if n.startswith("T")] or [0.0])


def kicked(posed: Posed, optimum: Optimum) -> Optimum:
    """The better of ``optimum`` and descents from either side of Tz = 0, where zero and dead time act alike."""
    free = list(posed.model.free)
    for zero in (n for n in free if bare(n) == "Tz" and "Td" + n[2:] in free):
        both = [free.index(zero), free.index("Td" + zero[2:])]
        theta = posed.theta(optimum.theta)
        lag = max(sum(v for n, v in theta.items() if n[:2] == "Tp" and beside(n, zero)), posed.dt_s)
        if abs(optimum.theta[both[0]]) > 0.02 * lag:
            continue
        found = [optimum]
        for size in (0.15 * lag, -0.15 * lag):
            x0 = optimum.theta.copy()
            x0[both] += size
            found.append(minimise(optimum.problem, x0, limit=40, tolerance=0.0))
        optimum = least(found)
    return optimum


def ordered(posed: Posed, optimum: Optimum) -> Optimum:
    """The same optimum with Tp1 >= Tp2 >= Tp3."""
    free = list(posed.model.free)
    index = np.arange(len(optimum.theta))
    for end in {suffix(n) for n in free}:
        lags = [free.index(n + end) for n in ("Tp1", "Tp2", "Tp3") if n + end in free]
        if "Tw" + end not in free:
            index[lags] = [lags[i] for i in np.argsort(-optimum.theta[lags], kind="stable")]
    return replace(
        optimum,
        theta=optimum.theta[index],
        jacobian=optimum.jacobian[:, index],
        information=optimum.information[np.ix_(index, index)],
    )


def root_of(weights: Array | None) -> Array | float:
    """What robust ``weights`` (N,) multiply the rows of a problem by: their roots, or one where there are none."""
    return 1.0 if weights is None else np.sqrt(weights)


def beyond(optimum: Optimum, k: int) -> str:
    """On which end of its box the ``k``-th parameter stands, "lower" or "upper"; empty where it is free."""
    x = optimum.theta[k]
    box = optimum.problem
    return "lower" if x <= box.lower[k] else "upper" if x >= box.upper[k] else ""


def criteria(deviance: float, count: int, n: int) -> dict[str, float]:
    """AICc and BIC of ``n`` samples and ``count`` unknowns, from -2 ln of the likelihood."""
    more = 2 * count + 2 * count * (count + 1) / max(n - count - 1, 1)
    return {"aicc": deviance + more, "bic": deviance + count * float(np.log(n))}


def rms(optimum: Optimum, posed: Posed) -> float:
    """Standard deviation of the noise that ``optimum`` leaves, above zero."""
    r = optimum.residual * root_of(optimum.weights)
    return float(np.sqrt(r @ r / max(posed.n_seen - posed.size, 1))) or 1e-300


def first_moment(problem: Posed, x: Array) -> float:
    """Total lag of the model at x [s], a time scale for its initial state; at least a sample."""
    return max(
        problem.dt_s,
        *(float(sum(abs(f.coefs[1]) for f in g.factors)) for g in problem.rationals(x)),
    )
