"""Fit a continuous-time model to sampled data: the output-error / prediction-error estimate with its
uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pandas as pd

from calibration.arrays import Array
from calibration.estimate import Estimate, rounded
from calibration.result import Result
from tcdyn.identify.causality import check_causality
from tcdyn.identify.data import IOData
from tcdyn.identify.identified import Identified
from tcdyn.identify.models import Model, as_model
from tcdyn.identify.noise import Noise, coarse_step, fit_arma, inverse, rounding_covariance, sandwich, stretches
from tcdyn.identify.optimise import Optimum, Status
from tcdyn.identify.problem import Initial, Problem, pose
from tcdyn.identify.robust import Loss, reweight, robust_covariance
from tcdyn.identify.search import search
from tcdyn.identify.validate import ALARM, Validation, validate, whiteness

Covariance = Literal["auto", "classical", "robust"]
Intervals = Literal["auto", "quadratic", "profile"]


@dataclass(frozen=True)
class Fit(Result):
    """A finished fit: the identified model and everything needed to judge it.

    ``residual`` (N,) is measured minus simulated at the measured samples; ``innovation`` the same after the noise
    model and the robust weights; ``weighted_jacobian`` (N, size) goes with it; ``covariance_x`` is that of the
    whole vector x.
    """

    identified: Identified
    problem: Problem
    x: Array
    residual: Array
    innovation: Array
    weighted_jacobian: Array
    covariance_x: Array
    noise: Noise
    status: Status
    iterations: int
    loss: Loss = "linear"

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """The free parameters with their intervals."""
        return self.identified.estimates

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know."""
        return self.identified.warnings

    @cached_property
    def validation(self) -> Validation:
        """The residual tests (:func:`tcdyn.identify.validate.validate`)."""
        return validate(self)

    def simulated(self) -> list[Array]:
        """The model's output over every segment of the data (N,)."""
        answers = self.problem.outputs(self.x, jacobian=False)
        assert answers is not None
        return [y for y, _ in answers]

    def summary(self) -> str:
        """The table people read."""
        m, s = self.identified, self.identified.statistics
        lines = [f"{m.model.name}: {m.input_name} -> {m.output_name}, {m.hold.upper()}, dt = {m.dt_s:g} s"]
        for name in m.model.names:
            unit = m.model.unit(name)
            if name in self.estimates:
                e = self.estimates[name]
                value, u = rounded(e.value, e.u)
                interval = f"[{rounded(e.low95, e.u)[0]}, {rounded(e.high95, e.u)[0]}]"
                lines.append(f"  {name:5s} {value:>12s} +- {u:<9s} {interval} {unit}")
            else:
                lines.append(f"  {name:5s} {m.theta[name]:12.5g} (fixed) {unit}")
        lines.append(f"  fit {s['fit_percent']:.2f} %, rms {s['rms']:.4g}, AICc {s['aicc']:.1f}, BIC {s['bic']:.1f}")
        lines += [f"  {m.sentence}", *(f"  warning: {w}" for w in self.warnings)]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The identified model as its file holds it."""
        return self.identified.to_dict()

    def card(self) -> pd.DataFrame:
        """Parameters with their standard uncertainties and intervals."""
        return self.identified.card()


def fit(
    data: IOData,
    model: Model | str = "P1D",
    *,
    initial: Initial = "equilibrium",
    noise: tuple[int, int] | Literal["white"] = "white",
    loss: Loss = "linear",
    covariance: Covariance = "auto",
    intervals: Intervals = "auto",
    start: Mapping[str, float] | None = None,
    check: bool = True,
) -> Fit:
    """The least-squares simulation fit of ``model`` to ``data``, start-free, with uncertainties.

    Minimises sum (y - offset - G u)^2 with G exact under the data's hold, dead time continuous. ``initial``: the
    record starts in equilibrium with its first input, from zero, or from a state that is estimated. ``noise=(p,
    q)`` adds an ARMA model of the disturbance (then the prediction error is minimised). ``loss``: "huber" or
    "bisquare" against spikes. ``covariance``: "auto" takes the robust (sandwich) one where residuals are coloured.
    ``intervals``: "auto" takes profile likelihood where the quadratic one is poor. ``start`` gives parameters to
    begin at. ``check=False`` skips the question whether the output moves first. Raises InputError for data nothing
    can be learnt from.

    >>> u = np.repeat([0.0, 1.0, 0.0, 1.0], 25)
    >>> from tcdyn.chain.rational import simulate
    >>> truth = as_model("P1D").rational({"Kp": 2.0, "Tp1": 0.8, "Td": 0.13})
    >>> data = IOData.from_arrays(u, simulate(truth, u, 0.1, "zoh"), 0.1, hold="zoh")
    >>> round(fit(data, "P1D").identified.theta["Td"], 6)
    0.13
    """
    structure = as_model(model)
    problem = pose(data, structure, initial)
    if check:
        check_causality(problem, data.name or "identify")
    x0 = None
    if start is not None:
        from tcdyn.identify.start import polished

        x0 = polished(problem, {**dict.fromkeys(structure.names, 0.0), **start})[1]
    optimum = search(problem, start=x0)
    problem = replace(problem, time_scale_s=max(problem.dt_s, abs(first_moment(problem, optimum.x))))
    if problem.loose:
        optimum = search(problem, start=rescaled(problem, optimum.x))
    parts = stretches(problem)
    weights = np.ones(problem.n_seen)
    if loss != "linear":
        optimum, weights = reweight(problem, optimum, loss)
    model_noise = Noise()
    if noise != "white":
        optimum, model_noise = with_noise(problem, optimum, noise, weights)
    evaluated = problem.evaluate(optimum.x)
    assert evaluated is not None
    r, j = evaluated
    root = np.sqrt(weights)
    innovation = model_noise.whiten(-r * root, parts)
    jacobian = model_noise.whiten(j * root[:, None], parts)
    result = assemble(data, problem, optimum, -r, innovation, jacobian, model_noise, loss, covariance)
    if intervals != "quadratic":
        from tcdyn.identify.likelihood import with_profiles

        result = with_profiles(result, everything=intervals == "profile")
    return result


def first_moment(problem: Problem, x: Array) -> float:
    """Total lag of the model at x [s], a time scale for its initial state."""
    g = problem.model.rational(problem.theta(x))
    return float(sum(abs(f.coefs[1]) for f in g.factors)) or problem.dt_s


def rescaled(problem: Problem, x: Array) -> Array:
    """x with the initial states back at zero, for a problem whose time scale has changed, linear ones solved
    anew."""
    from tcdyn.identify.start import polished

    return polished(problem, problem.theta(x))[1]


def with_noise(problem: Problem, optimum: Optimum, order: tuple[int, int], weights: Array) -> tuple[Optimum, Noise]:
    """Alternate the dynamics given the noise and the noise given the dynamics; both lower the same prediction
    error."""
    parts, root = stretches(problem), np.sqrt(weights)
    model = Noise()
    cost = np.inf
    for _ in range(12):
        found = problem.evaluate(optimum.x)
        assert found is not None
        model = fit_arma(found[0] * root, parts, *order)

        def evaluate(x: Array, model: Noise = model) -> tuple[Array, Array] | None:
            answer = problem.evaluate(x)
            if answer is None:
                return None
            return model.whiten(answer[0] * root, parts), model.whiten(answer[1] * root[:, None], parts)

        optimum = search(problem, evaluate, start=optimum.x)
        if cost - optimum.cost < 1e-7 * optimum.cost:
            break
        cost = optimum.cost
    return optimum, model


def assemble(
    data: IOData,
    problem: Problem,
    optimum: Optimum,
    residual: Array,
    innovation: Array,
    jacobian: Array,
    noise: Noise,
    loss: Loss,
    covariance: Covariance,
) -> Fit:
    """Covariance, estimates, statistics, validation and warnings around an optimum."""
    n, k = problem.n_seen, problem.size
    model, x = problem.model, optimum.x
    parts = stretches(problem)
    variance = float(innovation @ innovation) / (n - k)
    bread, full_rank = inverse(jacobian)
    cov_x, kind = variance * bread, 0.0
    coloured = covariance == "auto" and whiteness(innovation, jacobian, parts, problem.dt_s, 20).p < ALARM
    if covariance == "robust" or coloured:
        cov_x, kind = sandwich(jacobian, innovation, parts), 1.0
    if loss != "linear" and noise.white:
        found = problem.evaluate(x)
        assert found is not None
        cov_x = robust_covariance(found[0], found[1], loss)
    step = coarse_step(problem)
    if np.sqrt(np.mean(residual**2)) < step:
        cov_x, kind = cov_x + rounding_covariance(problem, jacobian, step), 1.0
    scale = problem.natural_scale(x)[: problem.n_model]
    cov = cov_x[: problem.n_model, : problem.n_model] * np.outer(scale, scale)
    theta = problem.theta(x)
    u = np.sqrt(np.maximum(np.diag(cov), 0.0))
    warnings = []
    lower, upper = problem.bounds()
    for i, name in enumerate(model.free):
        if x[i] <= lower[i] or x[i] >= upper[i]:
            end = "lower" if x[i] <= lower[i] else "upper"
            warnings.append(f"{name} ended on its {end} bound ({theta[name]:.3g}): the data do not ask for it")
        elif twin(model, theta, name):
            warnings.append(
                f"{name} equals another lag: only their sum is determined; complex poles (U) may fit better"
            )
        elif undetermined(model, name, theta, u[i]):
            warnings.append(f"{name} is hardly determined by these data (u = {u[i]:.2g} for {theta[name]:.2g})")
    if not full_rank:
        warnings.append(f"the data cannot tell all parameters of {model.name} apart: some intervals are meaningless")
    if optimum.status is Status.STALLED:
        warnings.append(optimum.status.value)
    sse = float(innovation @ innovation)
    count = k + 1 + len(noise.ar) + len(noise.ma)
    likelihood = n * np.log(max(sse, 1e-300) / n)
    offset = float(np.mean(x[problem.n_model : problem.n_model + problem.n_offsets])) if problem.n_offsets else 0.0
    identified = Identified(
        model=model,
        theta=theta,
        covariance=cov,
        estimates={name: Estimate.normal(theta[name], s) for name, s in zip(model.free, u)},
        offset=offset,
        noise_sd=float(np.sqrt(variance)),
        hold=problem.hold,
        dt_s=problem.dt_s,
        input_name=data.input_names[0],
        output_name=data.output_names[0],
        input_unit=data.input_units[0],
        output_unit=data.output_units[0],
        warnings=tuple(warnings),
    )
    result = Fit(
        identified,
        problem,
        x,
        residual,
        innovation,
        jacobian,
        cov_x,
        noise,
        optimum.status,
        optimum.iterations,
        loss,
    )
    checked = validate(result)
    statistics = {
        "n": float(n),
        "parameters": float(count - 1),
        "fit_percent": checked.fit_percent,
        "rms": checked.rms,
        "aicc": likelihood + 2 * count + 2 * count * (count + 1) / max(n - count - 1, 1),
        "bic": likelihood + count * float(np.log(n)),
        "p_white": checked.whiteness.p,
        "p_input": checked.input.p,
        "robust_covariance": kind,
    }
    return replace(result, identified=replace(identified, statistics=statistics, sentence=checked.sentence))


def undetermined(model: Model, name: str, theta: Mapping[str, float], u: float) -> bool:
    """Whether the uncertainty is more than half of a parameter's size; a zero may be nought, and is measured by the
    lags beside it."""
    size = abs(theta[name])
    if name == "Tz":
        size = max(size, sum(v for n, v in theta.items() if n[:2] in ("Tp", "Tw", "Tc")))
    elif name != "Kp" and not model.positive(name):
        return False
    return u > 0.5 * size


def twin(model: Model, theta: Mapping[str, float], name: str) -> bool:
    """Whether a lag coincides with another one, where the cost is flat in their difference."""
    lags = [n for n in ("Tp1", "Tp2", "Tp3") if n in model.free and n != name]
    return name in ("Tp1", "Tp2", "Tp3") and any(abs(theta[n] / theta[name] - 1) < 1e-2 for n in lags)


__all__ = ["Fit", "fit"]
