"""Test of a constant lag: one lag that depends on the output level, fitted by simulation.

``tcdyn.identification.narx.temperature_dependence`` uses it. The linear fit is the special case
without dependence, so the dependence has an estimate with an uncertainty.
``tests/identify/test_identify_level.py`` checks a lag that rises and one that is constant;
``tests/identify/test_identify_residuals.py`` the simulation.
"""

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
from tcdyn.identification.fitting import fit
from tcdyn.identification.intervals import innovation_covariance
from tcdyn.identification.iodata import IOData
from tcdyn.identification.search import Fit, criteria

MODELS = ("P1", "P1D", "P2", "P2D")  # models whose longest lag may depend on the level
DEPENDENCE_SDS = 2.5758  # standard uncertainties of a dependence (99 % of a normal distribution)
STEP = 1e-5  # of a parameter, for numerical derivatives; chosen by judgement
MAX_BEND = 2.0  # bound of the logarithm of the lag's change over half the range; by judgement
MAX_LEVEL = 5.0  # bound of that logarithm at any level in the simulation; chosen by judgement


@dataclass(frozen=True)
class LevelLag:
    """Lag at a low and a high level of the output.

    Parameters
    ----------
    model
        Name of the model.
    levels
        The two levels, in the output's unit.
    low, high
        Total lag at each level [s].
    bend
        ln(tau_high/tau_low)/2 of the longest lag.
    """

    model: str
    levels: tuple[float, float]
    low: Estimate
    high: Estimate
    bend: Estimate

    @property
    def depends(self) -> bool:
        """Whether the bend of the lag differs from zero by more than ``DEPENDENCE_SDS`` u.

        Also the key ``depends`` of the result.
        """
        return abs(self.bend.value) > DEPENDENCE_SDS * self.bend.u


def level_lag(data: IOData) -> LevelLag:
    """How the longest lag depends on the level y of the output.

    Parameters
    ----------
    data
        One input and one output.

    Returns
    -------
    LevelLag
        The lag at a low and a high level, with its dependence.

    Raises
    ------
    InputError
        Where no linear model can be fitted.

    Notes
    -----
    tau(y) = Tp1 exp(a (y - middle)/half range), over the range from the 10 to the 90 % quantile of
    the output. All parameters of a linear model are fitted together with a, by simulation. Of the
    ``MODELS`` that of least BIC is used. The uncertainty is the robust one where residuals are
    coloured. Valid where the lag hardly changes within one sample.

    More ``MODELS`` cost time; their longest lag must be Tp1, which is the one that varies. Other
    forms of tau(y) go to ``LevelLagProblem.simulate_lag`` and ``LevelLagProblem.lag_s`` alike.
    """
    candidates: list[tuple[float, LevelLagProblem, Optimum]] = []
    first_error: InputError | None = None
    for name in MODELS:
        try:
            linear_fit = fit(data, name, intervals="quadratic", check=False)
        except InputError as error:
            first_error = first_error or error
            continue
        low, high = np.quantile(linear_fit.problem.measured_output, [0.1, 0.9]).tolist()
        half_range = max(0.5 * (high - low), 1e-300)
        candidate = LevelLagProblem(linear_fit, 0.5 * (low + high), half_range)
        start = np.append(linear_fit.x, 0.0)
        optimum = minimise(candidate.problem, start, tolerance=0.0, relative=1e-9)
        n = len(optimum.residual)
        noise = linear_fit.noise
        deviance = n * float(np.log(max(optimum.cost, 1e-300) / n))
        deviance += noise.log_determinant(linear_fit.problem.residual_slices)
        bic = criteria(deviance, len(optimum.theta), n)["bic"]
        candidates.append((bic, candidate, optimum))
    if not candidates:
        raise first_error or InputError("no model to bend", where=data.name)
    _, best, optimum = min(candidates, key=lambda candidate: candidate[0])
    problem = best.linear_fit.problem
    covariance, _ = innovation_covariance(
        -optimum.residual,
        optimum.jacobian,
        problem.residual_slices,
        problem.dt_s,
        np.append(problem.prior_precision, 0.0),
    )

    def lag_estimate(side: float) -> Estimate:
        """Return the total lag at ``side`` half ranges above the middle, with its uncertainty."""
        gradient = approx_fprime(optimum.theta, best.lag_s, STEP, side)
        variance = max(gradient @ covariance @ gradient, 0.0)
        return Estimate.normal(best.lag_s(optimum.theta, side), np.sqrt(variance))

    return LevelLag(
        model=problem.model.name,
        levels=(best.middle - best.half_range, best.middle + best.half_range),
        low=lag_estimate(-1.0),
        high=lag_estimate(1.0),
        bend=Estimate.normal(optimum.theta[-1], np.sqrt(max(covariance[-1, -1], 0.0))),
    )


@dataclass(frozen=True)
class LevelLagProblem:
    """A linear fit with one more parameter: the dependence of its longest lag on the level.

    The level is relative to ``middle`` in units of ``half_range``.

    Parameters
    ----------
    linear_fit
        The linear fit.
    middle, half_range
        Middle and half width of the range of the output, in its unit.
    """

    linear_fit: Fit
    middle: float
    half_range: float

    @property
    def problem(self) -> Problem:
        """The least-squares problem; the linear fit is its case a = 0."""
        core = self.linear_fit.problem.least_squares_problem(self.linear_fit.noise)
        return Problem(
            (*core.names, "bend"),
            self.evaluate,
            lower=np.append(core.lower, -MAX_BEND),
            upper=np.append(core.upper, MAX_BEND),
            prior_mean=np.append(core.prior_mean, 0.0),
            prior_sd=np.append(core.prior_sd, np.inf),
        )

    def lag_s(self, x: Array, side: float) -> float:
        """Return the total lag [s] at a level.

        Parameters
        ----------
        x
            Vector of the linear problem, then the dependence a (P + 1,).
        side
            Level above the middle, in half ranges.

        Returns
        -------
        float
            Total lag [s].
        """
        problem = self.linear_fit.problem
        theta = problem.theta(x[:-1])
        change = theta["Tp1"] * float(np.exp(side * x[-1]) - 1)
        return problem.model.rational(theta).lag_s + change

    def evaluate(self, x: Array) -> tuple[Array, Array] | None:
        """Return whitened residuals and Jacobian.

        Those of the linear model are exact; the change by a is differentiated numerically.

        Parameters
        ----------
        x
            Vector of the linear problem, then a (P + 1,).

        Returns
        -------
        residual, jacobian
            Residuals (N,) and Jacobian (N, P + 1); None where the model is unstable.
        """
        problem = self.linear_fit.problem
        rows = problem.evaluate(x[:-1])
        if rows is None:
            return None
        change = self.output_change(x)
        if not np.isfinite(change).all():
            return None
        gradient = approx_fprime(x, self.output_change, STEP)
        jacobian = np.column_stack([rows[1], np.zeros(len(change))]) + gradient
        whiten = self.linear_fit.noise.whiten
        slices = problem.residual_slices
        return whiten(rows[0] + change, slices), whiten(jacobian, slices)

    def output_change(self, x: Array) -> Array:
        """Return the output with the level-dependent lag less that with a constant lag.

        Both are computed by the same recursion over samples.

        Parameters
        ----------
        x
            Vector of the linear problem, then a (P + 1,).

        Returns
        -------
        array
            Change at the measured samples (N,).
        """
        problem = self.linear_fit.problem
        theta = problem.theta(x[:-1])
        rational = problem.model.rational(theta)
        # the factor of the longest lag is the first after the known ones
        n_known = len(problem.model.known.factors)
        other_factors = rational.factors[:n_known] + rational.factors[n_known + 1 :]
        others = realise(replace(rational, factors=other_factors), False)
        rate = problem.dt_s / theta["Tp1"]
        changes = []
        for s, (offset, _) in zip(problem.segments, problem.offset_and_state_slices):
            v = simulate_rows(
                others, s.u, problem.dt_s, rational.delay_s, problem.hold, problem.start
            )[0]
            v = v + x[:-1][offset].sum()
            drive = v[:-1] if problem.hold == "zoh" else 0.5 * (v[1:] + v[:-1])
            varying = self.simulate_lag(v[0], drive, rate, float(x[-1]))
            constant = self.simulate_lag(v[0], drive, rate, 0.0)
            changes.append((varying - constant)[s.measured])
        return np.concatenate(changes)

    def simulate_lag(self, y: float, drive: Array, rate: float, bend: float) -> Array:
        """Return y of dy/dt = (drive - y)/tau(y), with tau constant over each sample.

        Parameters
        ----------
        y
            Output at the first sample.
        drive
            Input of the lag over each interval (N - 1,).
        rate
            Sampling interval over the lag at the middle level.
        bend
            ln(tau_high/tau_low)/2.

        Returns
        -------
        array
            Output (N,).

        Notes
        -----
        tau follows the output at the start of each interval. This is first order in the interval,
        so the lag must hardly change within one sample.
        """
        output = [float(y)]
        scale = bend / self.half_range
        for v in drive.tolist():
            level = min(max((y - self.middle) * scale, -MAX_LEVEL), MAX_LEVEL)
            y = y + (v - y) * -expm1(-rate * exp(-level))
            output.append(float(y))
        return np.array(output)
