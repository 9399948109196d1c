"""Is the lag constant? One lag that follows the level of the output, fitted by simulation, with its interval."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, expm1

import numpy as np
from scipy.optimize import approx_fprime

from tcdyn.chain.rational import realise, simulate_rows
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.estimation import Optimum, Problem, minimise
from tcdyn.identify.fit import fit
from tcdyn.identify.intervals import by_colour
from tcdyn.identify.iodata import IOData
from tcdyn.identify.search import Fit, criteria

MODELS = ("P1", "P1D", "P2", "P2D")  # that are bent
CERTAIN = 2.5758  # standard uncertainties (99 %) from which a dependence is claimed
STEP = 1e-5


@dataclass(frozen=True)
class LevelLag:
    """Total lag [s] at a low and a high ``levels`` of the output, and ``bend`` = ln(tau_high/tau_low)/2 of its longest
    lag, each with its interval."""

    model: str
    levels: tuple[float, float]
    low: Estimate
    high: Estimate
    bend: Estimate

    @property
    def depends(self) -> bool:
        """Whether the lag changes with the level (99 %)."""
        return abs(self.bend.value) > CERTAIN * self.bend.u


def level_lag(data: IOData) -> LevelLag:
    """How the longest lag changes with the level y of the output: tau(y) = Tp1 exp(a (y - middle)/half range).

    The range is that from the 10 to the 90 % quantile of the output. All parameters of a linear model are fitted anew
    beside a, by simulation; of the models so bent that with the least BIC is taken. The uncertainty is the robust one
    where residuals are coloured. Valid where the lag hardly changes within one sample. Raises InputError where no
    linear model can be fitted.
    """
    tried: list[tuple[float, Bent, Optimum]] = []
    first: InputError | None = None
    for name in MODELS:
        try:
            base = fit(data, name, intervals="quadratic", check=False)
        except InputError as error:
            first = first or error
            continue
        low, high = (float(q) for q in np.quantile(base.problem.measured, [0.1, 0.9]))
        bent = Bent(base, 0.5 * (low + high), max(0.5 * (high - low), 1e-300))
        best = minimise(bent.problem, np.append(base.x, 0.0), tolerance=0.0, relative=1e-9)
        n = len(best.residual)
        deviance = n * float(np.log(max(best.cost, 1e-300) / n))
        tried.append((criteria(deviance, len(best.theta), n)["bic"], bent, best))
    if not tried:
        raise first or InputError("no model to bend", where=data.name)
    _, bent, found = min(tried, key=lambda item: item[0])
    posed = bent.base.problem
    known = np.append(bent.base.problem.precision, 0.0)
    covariance, _ = by_colour(-found.residual, found.jacobian, posed.parts, posed.dt_s, known)

    def estimate(side: float) -> Estimate:
        slopes = approx_fprime(found.theta, bent.lag_s, STEP, side)
        return Estimate.normal(
            bent.lag_s(found.theta, side), np.sqrt(max(slopes @ covariance @ slopes, 0.0))
        )

    bend = Estimate.normal(found.theta[-1], np.sqrt(max(covariance[-1, -1], 0.0)))
    levels = (bent.middle - bent.half, bent.middle + bent.half)
    return LevelLag(posed.model.name, levels, estimate(-1.0), estimate(1.0), bend)


@dataclass(frozen=True)
class Bent:
    """A linear fit with one parameter more, a: what its longest lag does about ``middle`` +- ``half`` of the output."""

    base: Fit
    middle: float
    half: float

    @property
    def problem(self) -> Problem:
        """Its least-squares problem, begun at the linear fit with a = 0."""
        core = self.base.problem.core(self.base.noise)
        lower = np.append(core.lower, -2.0)
        upper = np.append(core.upper, 2.0)
        sd = np.append(core.prior_sd, np.inf)
        return Problem((*core.names, "bend"), self.evaluate, lower=lower, upper=upper, prior_sd=sd)

    def lag_s(self, x: Array, side: float) -> float:
        """Total lag [s] at ``side`` half ranges above the middle."""
        theta = self.base.problem.theta(x[:-1])
        return self.base.problem.model.rational(theta).lag_s + theta["Tp1"] * float(
            np.exp(side * x[-1]) - 1
        )

    def evaluate(self, x: Array) -> tuple[Array, Array] | None:
        """Whitened residuals and Jacobian: the linear model's, exact, and what the bend adds to it by differences."""
        posed = self.base.problem
        answer = posed.evaluate(x[:-1])
        if answer is None:
            return None
        added = self.added(x)
        if not np.isfinite(added).all():
            return None
        slopes = np.array([self.added(x + d) - added for d in STEP * np.eye(len(x))]).T / STEP
        whiten = self.base.noise.whiten
        table = np.column_stack([answer[1], np.zeros(len(added))]) + slopes
        return whiten(answer[0] + added, posed.parts), whiten(table, posed.parts)

    def added(self, x: Array) -> Array:
        """Output with the bend less that without, both by the same recursion over samples (N,)."""
        posed = self.base.problem
        theta = posed.theta(x[:-1])
        rational = posed.model.rational(theta)
        own = len(
            posed.model.known.factors
        )  # the longest lag's own factor comes first after the known ones
        rest = replace(rational, factors=rational.factors[:own] + rational.factors[own + 1 :])
        rows = []
        for s, (offset, _) in zip(posed.segments, posed.places):
            v = simulate_rows(
                realise(rest, False), s.u, posed.dt_s, rational.delay_s, posed.hold, posed.begun
            )[0]
            v = v + x[:-1][offset].sum()
            drive = v[:-1] if posed.hold == "zoh" else 0.5 * (v[1:] + v[:-1])
            rate = posed.dt_s / theta["Tp1"]
            bent, plain = (self.recursion(v[0], drive, rate, a) for a in (float(x[-1]), 0.0))
            rows.append((bent - plain)[s.seen])
        return np.concatenate(rows)

    def recursion(self, y: float, drive: Array, rate: float, bend: float) -> Array:
        """y of dy/dt = (drive - y)/tau(y), tau frozen over each sample, ``rate`` = dt/tau at the middle (N,)."""
        out = [float(y)]
        scale = bend / self.half
        for v in drive.tolist():
            level = min(max((y - self.middle) * scale, -5.0), 5.0)
            y = y + (v - y) * -expm1(-rate * exp(-level))
            out.append(float(y))
        return np.array(out)
