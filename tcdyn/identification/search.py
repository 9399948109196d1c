"""Search for the prediction-error estimate: multi-start Levenberg-Marquardt, and the result `Fit`.

A few short descents start from the best starting values; the best of them is continued until
convergence. ``tcdyn.identification.fit`` and ``tcdyn.identification.disturbance`` use it.
``tests/identify/test_identify_fit.py`` finds every structure without a start;
``tests/identify/test_identify_starts.py`` checks the choice of starts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, warning
from tcdyn.core.result import Result
from tcdyn.estimation import (
    Loss,
    NoiseModel,
    Optimum,
    Problem,
    Status,
    is_full_rank,
    lowest_cost,
    minimise,
)
from tcdyn.identification.identified import Identified
from tcdyn.identification.iodata import IOData
from tcdyn.identification.models import Model, base_name, input_suffix, same_input
from tcdyn.identification.problem import IdentificationProblem, Initial
from tcdyn.identification.segments import MIN_SEGMENT_SAMPLES, input_noise_sd, split_segments
from tcdyn.identification.starting_values import starts
from tcdyn.tuning import Tuning

# Settings of the search, chosen by judgement.
N_STARTS = 4  # short descents
MIN_START_DISTANCE = 0.15  # largest difference of a time, over the sum of all times
MAX_ZERO_SHARE = 0.02  # zero over lag, below which the other sign is searched too
ZERO_STEP = 0.15  # of the lag: zero and dead time from which the other sign is searched


@dataclass(frozen=True, repr=False)
class Fit(Result):
    """A finished fit: the identified model and what is needed to judge it.

    Parameters
    ----------
    identified
        The identified model.
    problem
        The identification problem.
    optimum
        Optimum of the innovations, without the robust ``weights``.
    residual
        Measured minus simulated output at the measured samples (N,).
    covariance_x
        Covariance of the complete vector x (size, size).
    noise
        The noise model.
    loss
        The loss function.
    weights
        Robust weights (N,), or None.
    """

    identified: Identified
    problem: IdentificationProblem
    optimum: Optimum
    residual: Array
    covariance_x: Array
    noise: NoiseModel
    loss: Loss = "linear"
    weights: Array | None = None

    @property
    def x(self) -> Array:
        """Fitted vector (size,): parameters (positive ones as logarithms), offsets, states."""
        return self.optimum.theta

    @property
    def innovation(self) -> Array:
        """Residuals whitened by the noise model, times the roots of the robust weights (N,)."""
        return -self.optimum.residual * sqrt_weights(self.optimum.weights)

    @cached_property
    def jacobian(self) -> Array:
        """d(minus innovation)/dx (N, size)."""
        return (self.optimum.jacobian.T * sqrt_weights(self.optimum.weights)).T

    @property
    def sqrt_weights(self) -> Array:
        """Roots of the robust weights (N,); ones where there are none."""
        return np.broadcast_to(sqrt_weights(self.weights), self.residual.shape)

    @property
    def lag_s(self) -> Estimate:
        """The lag (first moment of the impulse response) [s], see ``Identified.lag_s``."""
        return self.identified.lag_s

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """The free parameters with their intervals."""
        return self.identified.estimates

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the record and the model."""
        return self.identified.findings

    def simulate_segments(self) -> list[Array]:
        """Return the model's output over every segment of the data, arrays (N,)."""
        outputs = self.problem.outputs(self.x)
        assert outputs is not None
        return [y for y, _ in outputs]

    def summary(self) -> str:
        """The result as text."""
        return self.identified.summary()

    def to_dict(self) -> dict[str, Any]:
        """The identified model as in its JSON file."""
        return self.identified.to_dict()

    def write(self, path: str | Path) -> Path:
        """Write the identified model as a JSON file, see :meth:`Identified.write`."""
        return self.identified.write(path)

    def tune(self, input: str | None = None, **options: Any) -> Tuning:
        """Settings of a controller for the model, see :func:`tcdyn.identification.tune`.

        Parameters
        ----------
        input
            Name of the input that the controller sets; needed for several.
        **options
            The fields of :class:`tcdyn.tuning.TuneOptions`.
        """
        return self.identified.tune(input, **options)

    def to_frame(self) -> pd.DataFrame:
        """Parameters, lag and percent times, see :meth:`Identified.to_frame`."""
        return self.identified.to_frame()


def no_segment_error(data: IOData) -> InputError:
    """Return the error for data of which no segment can be used: the column, and what to do."""
    where = data.name or "identify"
    columns = [(n, [r.u[:, k] for r in data.runs]) for k, n in enumerate(data.input_names)]
    columns.append((data.output_names[0], [r.y[:, 0] for r in data.runs]))
    for name, values in columns:
        if not any(np.isfinite(v).any() for v in values):
            return InputError(
                f"column {name} holds no number at all (NaN everywhere)",
                where=where,
                remedy="check that the right column was taken",
            )
    names = ", ".join(data.input_names)
    have = "has" if len(data.input_names) == 1 else "have"
    return InputError(
        f"column {names} {have} no {MIN_SEGMENT_SAMPLES} samples in a row, with the output "
        "measured, without a gap",
        where=where,
        remedy="check that the right column was taken; if an input is logged only when it changes, "
        "fill its blank cells with the value before (in pandas: ffill)",
    )


def make_problem(
    data: IOData, model: Model, initial: Initial, input_noise: float | Literal["auto"] = 0.0
) -> IdentificationProblem:
    """The identification problem of ``model`` and ``data``.

    Parameters
    ----------
    data
        One output, and as many inputs as the model has.
    model
        The model structure.
    initial
        State in which the runs start.
    input_noise
        Standard deviation of the input's noise, in the input's unit; "auto" estimates it.

    Returns
    -------
    IdentificationProblem
        The problem; its noise is estimated from the differences of the output.

    Raises
    ------
    InputError
        For data from which the model cannot be identified.
    """
    where = data.name or "identify"
    n_inputs = max(len(model.submodels), 1)
    if len(data.output_names) != 1:
        raise InputError(
            f"the data hold {len(data.output_names)} outputs ({', '.join(data.output_names)})",
            where=where,
            remedy="fit them one by one: data.select(output=...)",
        )
    if len(data.input_names) != n_inputs or model.inputs not in ((), data.input_names):
        raise InputError(
            f"the data hold {len(data.input_names)} inputs ({', '.join(data.input_names)}), "
            f"{model.name} has {', '.join(model.inputs) or 'one'}",
            where=where,
            remedy="choose one: data.select(input=..), or give a model to each: "
            'several(["P1D", ..], data.input_names)',
        )
    segments = split_segments(data)
    if not segments:
        raise no_segment_error(data)
    for k, name in enumerate(data.input_names):
        if np.ptp(np.concatenate([s.inputs[:, k] for s in segments])) == 0:
            raise InputError(
                f"input {name} is constant ({segments[0].inputs[0, k]:g})",
                where=where,
                expected="an input that moves: a constant input does not show the dynamics",
                remedy="record also with another value of the input, before or after: for a heater "
                "that is on from the first row, one row with the heater off is enough",
            )
    for submodel, hold in zip(model.submodels or (model,), data.holds):
        _check_delay_has_lag(submodel, hold)
    if input_noise != "auto" and not 0 <= input_noise < np.inf:
        raise InputError(
            f"the input's noise is {input_noise}",
            where=where,
            expected="a standard deviation in the input's unit",
        )
    if input_noise == "auto":
        single = [[s.with_input(k) for s in segments] for k in range(n_inputs)]
        sds = tuple(input_noise_sd(each) for each in single)
    else:
        sds = (float(input_noise),) * n_inputs
    problem = IdentificationProblem(model, segments, data.dt_s, data.holds, initial, input_sds=sds)
    noise_sd = float(np.std(np.diff(problem.measured_output))) / np.sqrt(2)
    problem = replace(problem, noise_sd=noise_sd or 1.0)
    min_samples = max(2 * problem.size, 8)
    if problem.n_measured < min_samples:
        raise InputError(
            f"{problem.n_measured} measured samples for {problem.size} unknowns of {model.name}",
            where=where,
            expected=f"at least {min_samples}",
            remedy="record longer or choose a smaller model",
        )
    if all(np.nanstd(s.y) == 0 for s in segments):
        raise InputError(
            f"output {data.output_names[0]} never moves", where=where, remedy="check the channel"
        )
    return problem


def _check_delay_has_lag(model: Model, hold: str) -> None:
    """Raise InputError for a dead time without a lag where the input is held between samples.

    Raises
    ------
    InputError
        Where a dead time has no lag and the input is held.
    """
    n_states = model.order + model.integrators + len(model.known.den) - 1
    if hold == "zoh" and "Td" in model.names and n_states == 0:
        raise InputError(
            f"{model.name} cannot find a dead time under a held input: nothing moves until it "
            "passes a whole sample",
            remedy="add a lag (P1D)",
        )


def search(
    problem: IdentificationProblem,
    core: Problem | None = None,
    start: Array | Sequence[Array] = (),
) -> Optimum:
    """The least-squares optimum of an identification problem.

    Parameters
    ----------
    problem
        The identification problem.
    core
        Least-squares problem in place of that of ``problem``: filtered or weighted residuals.
    start
        One or several x to start from; by default those of
        :func:`tcdyn.identification.starting_values.starts`.

    Returns
    -------
    Optimum
        The optimum, with lags in descending order.

    Raises
    ------
    InputError
        Where no start leads to a stable model.

    Notes
    -----
    The numbers of starts and iterations may be increased; that costs time only. With fewer starts
    some structures are not found: ``tests/identify/test_identify_fit.py``.
    """
    core = core or problem.least_squares_problem()
    if len(start):
        candidates = list(np.atleast_2d(start))
    else:
        candidates = distinct_starts(problem, starts(problem))
    if len(candidates) > 1:
        short = [minimise(core, x, limit=6, tolerance=0.0, relative=1e-4) for x in candidates]
        candidates = [lowest_cost(short).theta]
    # the noise is unknown: whether a decrease is small can be judged by the cost only
    optimum = minimise(core, candidates[0], limit=80, tolerance=0.0) if candidates else None
    if optimum is None or not np.isfinite(optimum.cost):
        raise InputError(
            f"no stable {problem.model.name} was found from any start",
            expected="data in which the output follows the input",
            remedy="plot the record, check that input and output are not exchanged, or give "
            "start= from Python",
        )
    return sort_lags(problem, search_across_zero(problem, optimum))


def distinct_starts(problem: IdentificationProblem, ranked: list[Array]) -> list[Array]:
    """Return the best starts that are not near copies of a better one.

    They differ in some lag or dead time by 15 % of the sum of all times.

    Parameters
    ----------
    problem
        The identification problem.
    ranked
        Vectors x, best first.

    Returns
    -------
    list of array
        At most ``N_STARTS`` of them, at least one if there is any.
    """
    accepted: list[Array] = []
    for x in ranked:
        times = time_parameters(problem, x)
        size = np.abs(times).sum() + problem.dt_s
        distances = [np.max(np.abs(times - time_parameters(problem, c))) for c in accepted]
        if all(distance > MIN_START_DISTANCE * size for distance in distances):
            accepted.append(x)
    return accepted[:N_STARTS] or ranked[:1]


def time_parameters(problem: IdentificationProblem, x: Array) -> Array:
    """Return the times among the parameters [s]; a single zero where there are none."""
    times = [v for n, v in problem.theta(x).items() if n.startswith("T")]
    return np.array(times or [0.0])


def search_across_zero(problem: IdentificationProblem, optimum: Optimum) -> Optimum:
    """Search on both sides of Tz = 0, where the optimum is near it.

    Near Tz = 0 the zero and the dead time have the same effect.

    The cost may have a minimum on either side.

    Parameters
    ----------
    problem
        The identification problem.
    optimum
        The optimum.

    Returns
    -------
    Optimum
        The best of all descents.
    """
    free = list(problem.model.free)
    for zero in free:
        delay = "Td" + input_suffix(zero)
        if base_name(zero) != "Tz" or delay not in free:
            continue
        index = [free.index(zero), free.index(delay)]
        theta = problem.theta(optimum.theta)
        lags = [v for n, v in theta.items() if n[:2] == "Tp" and same_input(n, zero)]
        lag = max(sum(lags), problem.dt_s)
        if abs(optimum.theta[index[0]]) > MAX_ZERO_SHARE * lag:
            continue
        candidates = [optimum]
        for step in (ZERO_STEP * lag, -ZERO_STEP * lag):
            x = optimum.theta.copy()
            x[index] += step
            candidates.append(minimise(optimum.problem, x, limit=40, tolerance=0.0))
        optimum = lowest_cost(candidates)
    return optimum


def sort_lags(problem: IdentificationProblem, optimum: Optimum) -> Optimum:
    """Return the same optimum with Tp1 >= Tp2 >= Tp3 behind each input.

    Parameters
    ----------
    problem
        The identification problem.
    optimum
        The optimum.

    Returns
    -------
    Optimum
        With vector, Jacobian and information in the new order.

    Notes
    -----
    With bounds or priors of parameters the order stays, because they belong to the parameter's
    name. It also stays for the lags of an input that has a pair of poles (Tw).

    ``Optimum.directions`` is not reordered: the identification problem fixes no combination of
    parameters, so it is the identity. A new field of ``Optimum`` with P columns must be reordered
    here. Test: ``tests/identify/test_identify_residuals.py``.
    """
    if problem.limits or problem.priors:
        return optimum
    free = list(problem.model.free)
    order = np.arange(len(optimum.theta))
    for suffix in {input_suffix(n) for n in free}:
        if "Tw" + suffix in free:
            continue
        names = [n + suffix for n in ("Tp1", "Tp2", "Tp3")]
        lags = [free.index(n) for n in names if n in free]
        descending = np.argsort(-optimum.theta[lags], kind="stable")
        order[lags] = [lags[i] for i in descending]
    return replace(
        optimum,
        theta=optimum.theta[order],
        jacobian=optimum.jacobian[:, order],
        information=optimum.information[np.ix_(order, order)],
    )


def sqrt_weights(weights: Array | None) -> Array | float:
    """Return the roots of the robust weights (N,), or one where there are none."""
    return 1.0 if weights is None else np.sqrt(weights)


def active_bound(optimum: Optimum, k: int) -> str:
    """Return the bound at which the ``k``-th parameter is: "lower", "upper", or "" for none."""
    x = optimum.theta[k]
    # the average over noise leaves a parameter on its bound but for rounding errors
    for end in ("lower", "upper"):
        if np.isclose(x, getattr(optimum.problem, end)[k], rtol=1e-9, atol=1e-12):
            return end
    return ""


def search_findings(
    optimum: Optimum,
    estimates: Mapping[str, Estimate],
    subject: str,
    judge: Callable[[str, Estimate], Finding | None] = lambda name, estimate: None,
) -> tuple[Finding, ...]:
    """Return warnings about an optimum: parameters at a bound, indistinct ones, a stalled search.

    Parameters
    ----------
    optimum
        The optimum.
    estimates
        Its first parameters by name.
    subject
        Name of the model.
    judge
        Finding about a parameter that is at no bound, from its name and estimate, or None.

    Returns
    -------
    tuple of Finding
        At most one warning for each parameter, and those of the complete model.
    """
    findings = []
    for k, (name, estimate) in enumerate(estimates.items()):
        bound = active_bound(optimum, k)
        finding = judge(name, estimate)
        if bound:
            finding = warning("fit.bound", subject=name, end=bound, value=estimate.value)
        if finding is not None:
            findings.append(finding)
    if not is_full_rank(optimum.information):
        findings.append(warning("fit.indistinct", subject=subject))
    if optimum.status is Status.STALLED:
        findings.append(warning("fit.stalled"))
    return tuple(findings)


def criteria(deviance: float, count: int, n: int) -> dict[str, float]:
    """Return AICc and BIC.

    Parameters
    ----------
    deviance
        -2 ln likelihood, up to a constant that all compared models share.
    count
        Number of unknowns, the variance of the noise included.
    n
        Number of samples.

    Returns
    -------
    dict
        "aicc" and "bic".

    Notes
    -----
    ``tests/identify/test_identify_fit.py`` compares them with the textbook.
    """
    penalty = 2 * count + 2 * count * (count + 1) / max(n - count - 1, 1)
    return {"aicc": deviance + penalty, "bic": deviance + count * float(np.log(n))}


def residual_sd(optimum: Optimum, problem: IdentificationProblem) -> float:
    """Return the standard deviation of the noise after a fit, above zero."""
    r = optimum.residual * sqrt_weights(optimum.weights)
    dof = max(problem.n_measured - problem.size, 1)
    return float(np.sqrt(r @ r / dof)) or 1e-300


def first_moment(problem: IdentificationProblem, x: Array) -> float:
    """Return the total lag of the model at x [s], at least one sampling interval."""
    lags = [
        float(sum(abs(f.coefs[1]) for f in rational.factors)) for rational in problem.rationals(x)
    ]
    return max(problem.dt_s, *lags)
