"""The prediction-error search: a few short descents from the best starts, the winner taken to convergence; and the
finished fit that comes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from calibration import Array
from calibration.errors import InputError
from calibration.estimate import Estimate
from calibration.finding import Finding
from calibration.result import Result
from tcdyn.fitting import Loss, Noise, Optimum, Problem, least, minimise
from tcdyn.identify.identified import Identified
from tcdyn.identify.problem import Posed
from tcdyn.identify.start import starts


@dataclass(frozen=True)
class Fit(Result):
    """A finished fit: the identified model and everything needed to judge it.

    ``residual`` (N,) is measured minus simulated at the measured samples, ``innovation`` (N,) the same after the noise
    model and the robust loss's weights, ``slopes`` (N, size) its negative Jacobian by x; ``optimum`` is that of the
    innovation without those weights; ``covariance_x`` is that of the whole vector x.
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

    @property
    def x(self) -> Array:
        """All that was fitted: model parameters (positive ones as logarithms), offsets, initial states."""
        return self.optimum.theta

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
        walks, order = self.noise.walks, self.noise.order
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


def search(posed: Posed, core: Problem | None = None, start: Array | None = None) -> Optimum:
    """The least-squares optimum of ``posed``; ``core`` replaces its residuals by filtered or weighted ones."""
    core = core or posed.core()
    tried = [start] if start is not None else diverse(posed, starts(posed))
    if len(tried) > 1:
        tried = [least([minimise(core, x0, limit=6, tolerance=0.0, relative=1e-4) for x0 in tried]).theta]
    # the noise is not known: only the cost itself says what is little of it
    found = minimise(core, tried[0], limit=80, tolerance=0.0) if tried else None
    if found is None or not np.isfinite(found.cost):
        raise InputError(
            f"no stable {posed.model.name} was found from any start",
            expected="data in which the output follows the input",
            remedy="plot the record, check that input and output are not exchanged, or give start= from Python",
        )
    return ordered(posed, kicked(posed, found))


def diverse(posed: Posed, ranked: list[Array], count: int = 4) -> list[Array]:
    """The best starts that are not near copies of a better one: 30 % apart in some lag or dead time."""
    chosen: list[Array] = []
    for x in ranked:
        times = spans(posed, x)
        size = np.abs(times).sum() + posed.dt_s
        if all(np.max(np.abs(times - spans(posed, c))) > 0.15 * size for c in chosen):
            chosen.append(x)
        if len(chosen) == count:
            break
    return chosen or ranked[:1]


def spans(posed: Posed, x: Array) -> Array:
    """The times among the parameters [s]."""
    return np.array([v for n, v in posed.theta(x).items() if n.startswith("T")] or [0.0])


def kicked(posed: Posed, optimum: Optimum) -> Optimum:
    """The better of ``optimum`` and descents from either side of Tz = 0, where zero and dead time act alike."""
    free = list(posed.model.free)
    if "Tz" not in free or "Td" not in free:
        return optimum
    both = [free.index("Tz"), free.index("Td")]
    lag = max(sum(v for n, v in posed.theta(optimum.theta).items() if n.startswith("Tp")), posed.dt_s)
    if abs(optimum.theta[both[0]]) > 0.02 * lag:
        return optimum
    found = [optimum]
    for size in (0.15 * lag, -0.15 * lag):
        x0 = optimum.theta.copy()
        x0[both] += size
        found.append(minimise(optimum.problem, x0, limit=40, tolerance=0.0))
    return least(found)


def ordered(posed: Posed, optimum: Optimum) -> Optimum:
    """The same optimum with Tp1 >= Tp2 >= Tp3."""
    free = list(posed.model.free)
    lags = [free.index(n) for n in ("Tp1", "Tp2", "Tp3") if n in free]
    if "Tw" in free or len(lags) < 2:
        return optimum
    index = np.arange(len(optimum.theta))
    index[lags] = [lags[i] for i in np.argsort(-optimum.theta[lags], kind="stable")]
    return replace(
        optimum,
        theta=optimum.theta[index],
        jacobian=optimum.jacobian[:, index],
        information=optimum.information[np.ix_(index, index)],
    )


def rms(optimum: Optimum, posed: Posed) -> float:
    """Standard deviation of the noise that ``optimum`` leaves, above zero."""
    r = optimum.residual * (1.0 if optimum.weights is None else np.sqrt(optimum.weights))
    return float(np.sqrt(r @ r / max(posed.n_seen - posed.size, 1))) or 1e-300
