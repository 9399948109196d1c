"""Fit a continuous-time model to sampled data: the output-error / prediction-error estimate with its
uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import Loss, Noise, Optimum, Status, determined, minimise
from tcdyn.identify.causality import check_causality
from tcdyn.identify.closed_loop import check_closed_loop
from tcdyn.identify.disturbance import (
    DECISIVE,
    Baseline,
    NoiseName,
    alternate,
    averaged,
    estimate,
    mixed,
    through_model,
    unspiked,
)
from tcdyn.identify.identified import Identified
from tcdyn.identify.intervals import Covariance, covariance_of, profiled
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import Model, as_model, bare, beside, suffix
from tcdyn.identify.problem import Initial, Posed
from tcdyn.identify.search import (
    Fit,
    beyond,
    criteria,
    diverse,
    first_moment,
    ordered,
    pose,
    rms,
    search,
)
from tcdyn.identify.segments import SHORTEST
from tcdyn.identify.starting_values import alone, polished, starts
from tcdyn.identify.validate import coloured, disturbed, undriven, validate

Intervals = Literal["auto", "quadratic", "profile"]


def fit(
    data: IOData,
    model: Model | str = "P1D",
    *,
    initial: Initial = "equilibrium",
    noise: tuple[int, int] | NoiseName = "white",
    baseline: Baseline = "none",
    loss: Loss = "linear",
    covariance: Covariance = "auto",
    intervals: Intervals = "auto",
    start: Mapping[str, float] | Sequence[Mapping[str, float]] | None = None,
    check: bool = True,
    input_noise: float | Literal["auto"] = "auto",
) -> Fit:
    """The least-squares simulation fit of ``model`` to ``data``, start-free, with uncertainties.

    Minimises sum (y - offset - G u)^2 with G exact under the data's hold, dead time continuous. ``initial``: the
    record starts in equilibrium with its first input, from zero, or from a state that is estimated. ``noise=(p, q)``
    adds an ARMA model of the disturbance (then the prediction error is minimised), "ar" and "arma" one whose order
    the data choose, ``baseline`` a straight drift ("trend") or a random walk ("walk") beneath the output; "auto" lets
    the data choose where the residuals of white noise are coloured and do not follow the input. ``loss``: "huber" or
    "bisquare" against spikes. ``covariance``: "auto" takes the robust (sandwich) one where residuals are coloured.
    ``intervals``: "auto" takes profile likelihood where the quadratic one is poor. ``start`` gives parameters to begin
    at, or several sets, of which the most promising is taken. ``check=False`` skips whether the output moves first and
    whether the input is computed from the output (a closed loop).
    ``input_noise`` is the sd of a measured input, 0 for one that is known; "auto" takes it from its own samples. With
    noise the input's level before a run in equilibrium is estimated, of which the first sample is but one reading.
    Raises InputError for data nothing can be learnt from.

    >>> u = np.repeat([0.0, 1.0, 0.0, 1.0], 25)
    >>> from tcdyn.chain.rational import simulate
    >>> truth = as_model("P1D").rational({"Kp": 2.0, "Tp1": 0.8, "Td": 0.13})
    >>> data = IOData.from_arrays(u, simulate(truth, u, 0.1, "zoh"), 0.1, hold="zoh")
    >>> round(fit(data, "P1D").identified.theta["Td"], 6)
    0.13
    """
    with one_blas_thread:
        return _fitted(
            data,
            as_model(model),
            initial,
            noise,
            baseline,
            loss,
            covariance,
            intervals,
            start,
            check,
            input_noise,
        )


def _fitted(
    data: IOData,
    structure: Model,
    initial: Initial,
    noise: tuple[int, int] | NoiseName,
    baseline: Baseline,
    loss: Loss,
    covariance: Covariance,
    intervals: Intervals,
    start: Mapping[str, float] | Sequence[Mapping[str, float]] | None,
    check: bool,
    input_noise: float | Literal["auto"],
) -> Fit:
    """The fit, with the arguments of ``fit``."""
    problem = pose(data, structure, initial, input_noise)
    if structure.arx and (noise not in ("white", "auto") or baseline not in ("none", "auto")):
        raise InputError(
            f"{structure.name} has the noise of its own poles",
            remedy="leave noise and baseline out",
        )
    if check:
        check_closed_loop(data, data.name or "identify")
        for one in alone(problem):
            check_causality(one, data.name or "identify")
    asked = [] if start is None else [start] if isinstance(start, Mapping) else start
    optimum = search(
        problem,
        start=[polished(problem, {**dict.fromkeys(structure.names, 0.0), **s})[1] for s in asked],
    )
    if any(
        problem.loose
    ):  # initial states are best searched in the time scale of the model, linear ones solved anew
        problem = replace(problem, time_scale_s=first_moment(problem, optimum.theta))
        optimum = search(problem, start=polished(problem, problem.theta(optimum.theta))[1])
    if problem.precision.any():  # how much the first sample tells of them is known by now
        problem = replace(problem, noise_sd=rms(optimum, problem))
        optimum = search(problem, start=optimum.theta)
    model_noise = (
        Noise(tuple(problem.colour(optimum.theta).tolist()), fitted=0) if structure.arx else Noise()
    )
    if loss != "linear":
        optimum = ordered(
            problem, minimise(optimum.problem, optimum.theta, loss=loss, tolerance=0.0)
        )
    elif problem.input_sd and not structure.arx:
        problem, optimum, model_noise = alternate(problem, optimum, through_model)
    found = assemble(data, problem, optimum, model_noise, loss, covariance)
    if (noise, baseline) != ("white", "none") and not structure.arx:
        found = with_noise(data, found, optimum, noise, baseline, covariance)
    plain = intervals == "quadratic" or loss != "linear" or found.noise.averaged
    return noted(found if plain else profiled(found, intervals == "profile"), data.findings)


def noted(found: Fit, findings: tuple[Finding, ...]) -> Fit:
    """``found`` with what was noticed in its data."""
    told = replace(found.identified, findings=(*found.identified.findings, *findings))
    return replace(found, identified=told) if findings else found


def with_noise(
    data: IOData,
    found: Fit,
    optimum: Optimum,
    noise: tuple[int, int] | NoiseName,
    baseline: Baseline,
    covariance: Covariance,
) -> Fit:
    """``found`` with the disturbance that is asked for, or where the data choose that the residuals ask for.

    First-order disturbances of any time constant are averaged over (:mod:`tcdyn.estimation.noise_average`); only
    what leaves
    coloured innovations is sought among those of higher order, by BIC. What is asked for by name is never left out.
    Where noise may be slow a robust loss stands for the samples that :func:`unspiked` moves.
    """
    slow = (
        baseline == "walk" or noise == "slow" or ("auto" in (noise, baseline) and coloured(found))
    )
    if found.loss != "linear" and slow:
        problem = unspiked(found.problem, found.residual)
        optimum = search(problem, start=optimum.theta)
        level = assemble(data, problem, optimum, Noise(), "linear", covariance)
        return replace(
            with_noise(data, level, optimum, noise, baseline, covariance), loss=found.loss
        )
    auto = "auto" in (noise, baseline) and noise != "slow"
    named = noise not in ("auto", "slow")
    least = baseline if baseline != "auto" else "none"
    begun = [(found.problem, optimum)]
    if baseline == "trend" or (baseline == "auto" and (coloured(found) or not auto)):
        begun.append(drifting(found.problem, optimum, found.loss))
    weights = begun[-1][1].weights  # to a fit without it a drift is what stands out
    spared = [(begun[0][0], replace(optimum, weights=weights)), *begun[1:]]

    def given(kind: Baseline, name: tuple[int, int] | NoiseName) -> Fit:
        own = spared[0] if kind == "walk" else begun[kind == "trend"]
        answer = alternate(*own, estimate(name, kind))
        return assemble(data, *answer, found.loss, covariance, weights=own[1].weights)

    base = found if not named and least == "none" else given(least, noise if named else "white")
    seen = found if named else base
    if (named and baseline != "auto") or (auto and not coloured(seen)):
        return base
    if auto and not disturbed(
        seen
    ):  # of what the residuals have of the input only a drift may be the reason
        line = [assemble(data, *each, Noise(), found.loss, covariance) for each in begun[1:]]
        if not any(map(undriven, line)):
            return base
    tried = [base] if auto else []
    if not named and baseline != "walk":
        kinds = spared[1:] if baseline == "trend" else spared
        mean = mixed([averaged(*each) for each in kinds])
        problem, best, model_noise, cov_x = mean.found(weights)
        spread = assemble(data, problem, best, model_noise, found.loss, covariance, cov_x, weights)
        told = replace(
            spread.identified, statistics={**spread.identified.statistics, "p_walk": mean.walks}
        )
        spread = replace(spread, identified=told)
        if noise == "slow" or not coloured(spread):
            return spread
        tried.append(spread)
    left: tuple[Baseline, ...] = ("none", "trend", "walk") if baseline == "auto" else (baseline,)
    tried += [given(kind, "auto" if noise == "slow" else noise) for kind in left[named:]]
    return chosen(tried)


def drifting(problem: Posed, optimum: Optimum, loss: Loss) -> tuple[Posed, Optimum]:
    """``problem`` with a drift of each run and its optimum, sought from that without a drift and from its own starts,
    with robust weights of its own."""
    trended = replace(problem, trend=True)
    longer = np.append(optimum.theta, np.zeros(trended.size - problem.size))
    best = search(trended, start=[longer, *diverse(trended, starts(trended))])
    if loss != "linear":
        best = ordered(trended, minimise(best.problem, best.theta, loss=loss, tolerance=0.0))
    return trended, best


def chosen(fits: Sequence[Fit]) -> Fit:
    """The least BIC within stretches; a random walk unless another is decisively better, for it claims less."""
    scores = [within(f) for f in fits]
    best = int(np.argmin(scores))
    return next(
        (f for f, score in zip(fits, scores) if f.noise.walks and score < scores[best] + DECISIVE),
        fits[best],
    )


def within(found: Fit) -> float:
    """BIC of what the stretches without a gap tell beside the level of each after the first, which a random walk leaves
    free: (n - L) ln |w|^2 + sum ln |l|^2 with l the whitened level of each of L stretches, w free of it."""
    noise = found.noise
    parts = found.problem.parts
    e = found.innovation.copy()
    volume = 0.0
    for s in parts[1:]:
        level = noise.whiten(found.root[s], [slice(0, s.stop - s.start)])
        e[s] -= level * (level @ e[s]) / (level @ level)
        volume += float(np.log(level @ level))
    left = len(e) - len(parts) + 1
    deviance = left * np.log(max(float(e @ e), 1e-300) / left) + volume + noise.log_spread(parts)
    return float(deviance + found.identified.statistics["parameters"] * np.log(left))


def assemble(
    data: IOData,
    problem: Posed,
    optimum: Optimum,
    noise: Noise,
    loss: Loss,
    covariance: Covariance,
    cov_x: Array | None = None,
    weights: Array | None = None,
) -> Fit:
    """Covariance, unless it is known, estimates, findings, validation and statistics around an optimum, whose rows hold
    the roots of the robust ``weights`` (N,) already where it has none of its own."""
    n = problem.n_seen
    x = optimum.theta
    answer = problem.evaluate(x)
    assert answer is not None
    root = np.ones(n) if optimum.weights is None else np.sqrt(optimum.weights)
    e = -optimum.residual * root
    j = optimum.jacobian * root[:, None]
    robust = cov_x is not None
    if cov_x is None:
        loss_of = loss if optimum.weights is not None else "linear"
        cov_x, robust = covariance_of(problem, optimum, answer[0], e, j, covariance, loss_of)
    scale = problem.natural_scale(x)
    cov = (cov_x * np.outer(scale, scale))[: problem.n_model, : problem.n_model]
    sse = float(e @ e)
    identified = Identified.of(
        problem.model,
        problem.theta(x),
        cov,
        offset=last_level(problem, x, -answer[0], noise),
        noise_sd=float(np.sqrt(sse / (n - problem.size))),
        hold=problem.hold,
        dt_s=problem.dt_s,
        input_name=", ".join(data.input_names),
        output_name=data.output_names[0],
        input_unit=", ".join(filter(None, dict.fromkeys(data.input_units))),
        output_unit=data.output_units[0],
    )
    used = weights if optimum.weights is None else optimum.weights
    result = Fit(identified, problem, optimum, -answer[0], e, j, cov_x, noise, loss, used)
    checked = validate(result)
    count = problem.size + 1 + noise.parameters
    left = max(
        n - (len(problem.parts) - 1) * noise.walks, 1
    )  # after each gap one sample goes into its level
    likelihood = n * np.log(max(sse, 1e-300) / left) + noise.log_spread(problem.parts)
    statistics = {
        "n": float(n),
        "parameters": float(count - 1),
        "fit_percent": checked.fit_percent,
        "rms": checked.rms,
        **criteria(likelihood, count, n),
        "p_white": checked.whiteness.p,
        "p_input": checked.input.p,
        "robust_covariance": float(robust),
    }
    told = (*noticed(optimum, identified), *unbounded_lags(identified, problem.longest_s))
    return replace(
        result,
        identified=replace(
            identified, statistics=statistics, sentence=checked.sentence, findings=told
        ),
    )


def last_level(problem: Posed, x: Array, residual: Array, noise: Noise) -> float:
    """The offset with which the model goes on where the data end: a drift is not believed beyond them, a random walk
    (``residual`` (N,) are measured less model) stays where it is."""
    offsets = x[problem.n_model : problem.places[0][1].start]
    runs = len(problem.begun_s)
    level = float(np.mean(offsets)) if len(offsets) else 0.0
    if problem.trend:
        ends = {s.run: s.start_s + len(s.y) * problem.dt_s for s in problem.segments}
        spans = [ends[run] - problem.begun_s[run] for run in sorted(ends)]
        level += float(np.mean(x[-runs:] * spans)) / problem.longest_s
    return level + (float(np.mean(residual[-SHORTEST:])) if noise.walks else 0.0)


def unbounded_lags(identified: Identified, longest_s: float) -> list[Finding]:
    """A warning for each input whose lag has a standard uncertainty larger than the record is long."""
    if identified.model.integrators:
        return []
    lags = {name: part.lag_s for name, part in identified.parts.items()}
    one = len(lags) == 1
    return [
        warning(
            "fit.lag_unbounded",
            subject="the lag" if one else f"the lag behind {name}",
            u=lag.u,
            longest_s=longest_s,
        )
        for name, lag in lags.items()
        if lag.u > longest_s
    ]


def noticed(optimum: Optimum, identified: Identified) -> tuple[Finding, ...]:
    """What is wrong with the parameters: on a bound, twins, undetermined, not to be told apart."""
    found = []
    model = identified.model
    theta = identified.theta
    lags = [n for n in model.free if n[:2] == "Tp"]
    for i, (name, e) in enumerate(identified.estimates.items()):
        size = abs(e.value)
        if bare(name) == "Tz":  # it may be nought, and is measured by the lags beside it
            size = max(
                size,
                sum(v for n, v in theta.items() if n[:2] in ("Tp", "Tw", "Tc") and beside(n, name)),
            )
        twins = [n for n in lags if n != name and suffix(n) == suffix(name)] if name in lags else []
        if end := beyond(optimum, i):
            found.append(warning("fit.bound", subject=name, end=end, value=e.value))
        elif any(abs(theta[n] / e.value - 1) < 1e-2 for n in twins):
            found.append(warning("fit.twin", subject=name))  # the cost is flat in their difference
        elif (bare(name) in ("Kp", "Tz") or model.positive(name)) and e.u > 0.5 * size:
            found.append(warning("fit.undetermined", subject=name, u=e.u, value=e.value))
    if not determined(optimum.information):
        found.append(warning("fit.indistinct", subject=model.name))
    if optimum.status is Status.STALLED:
        found.append(warning("fit.stalled"))
    return tuple(found)
