"""Forward selection of the model: orders, zeros, dead times and inputs are added one at a time.

The search starts with one lag and stops where BIC and held-out error no longer improve.
``tcdyn.identify.comparison.compare`` uses it where no models are given.
``tests/identify/test_identify_several.py`` checks that it ends at the true model,
``tests/identify/test_identify_choose.py`` the discount for correlated residuals,
``tests/identify/test_identify_starts.py`` the starting values.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from tcdyn.chain.rational import polynomial_product
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation import correlation_length
from tcdyn.identify.fit import fit
from tcdyn.identify.heldout import SCORING_OPTIONS, Task
from tcdyn.identify.identified import Identified
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import (
    NO_MODEL,
    Model,
    as_model,
    as_template,
    base_name,
    process,
    several,
    transfer,
)
from tcdyn.identify.recommendation import DECISIVE_BIC
from tcdyn.identify.search import Fit
from tcdyn.identify.starting_values import single_input_problem, starts
from tcdyn.identify.validate import has_clean_residuals

MIN_BIC_GAIN = 2.0  # BIC gain of a step, above which it is taken
MAX_HELD_OUT_RATIO = 1.05  # held-out error after over before a step; above, the step is overfitting
# Held-out error after over before a step, below which the step counts though its BIC gain may come
# from coloured residuals.
HELD_OUT_GAIN_RATIO = 0.97
MAX_POLES = 6  # largest order of a transfer function
MAX_STEPS = 24  # limit of the number of steps
MAX_REJECTED_ROWS = 3  # best rejected models that the table lists
NEW_LAG_RATIOS = (0.1, 1.0, 10.0)  # starting values of a new lag, over the lag of the model before

Score = Callable[[Fit], float]  # held-out error of a fit
Entry = Model | str | Fit | Identified  # what a caller may compare
# models, starting parameters, and whether the search has rejected them
Candidates = Sequence[tuple[Model, Mapping[str, float] | None, bool]]


def forward_select(
    data: IOData, template: Model, score: Score, options: Mapping[str, Any]
) -> list[tuple[Model, Mapping[str, float], bool]]:
    """Models from one lag to the model that no step improves.

    Parameters
    ----------
    data
        The record.
    template
        What all models have: the known factor, the offset, a fixed gain.
    score
        Held-out error of a fit.
    options
        Options of :func:`tcdyn.identify.fit`.

    Returns
    -------
    list of tuple
        Model, its parameters, and whether it was rejected: the best steps that were not taken come
        last.

    Notes
    -----
    The first lag is behind the input that explains most. A step adds to one branch a dead time, a
    zero, a pole, a pole with a zero, or makes two poles complex; beyond three poles the models are
    general transfer functions. With several inputs a step may also add the first lag of another
    input. The candidates are tried in the order of BIC. A step is taken if its BIC gain
    (:func:`bic_gain`) is above 2 and the held-out error does not rise by more than 5 %, or if it
    would gain 10 for white residuals and the held-out error falls by 3 % or more.

    Larger thresholds give smaller models. ``DECISIVE_BIC`` is that of
    ``tcdyn.identify.recommendation.recommend``, so that search and recommendation agree.
    ``tests/identify/test_identify_several.py`` fails where the search stops too early or adds an
    input without effect.
    """
    scoring_options = {**options, **SCORING_OPTIONS}
    candidates = [
        fit_candidate(data, m, None, scoring_options) for m in first_candidates(data, template)
    ]
    current = lowest_bic(candidates)
    error = score(current)
    path = [current]
    names = {current.problem.model.name}
    rejected: list[Fit] = []
    for _ in range(MAX_STEPS):
        models = [m for m in larger_models(current.problem.model, data) if m.name not in names]
        names |= {m.name for m in models}
        candidates = [fit_candidate(data, m, current, scoring_options) for m in models]
        ranked = sorted((f for f in candidates if f is not None), key=bic)
        step = _best_step(current, error, ranked, score)
        if step is None:
            rejected = ranked[:MAX_REJECTED_ROWS]
            break
        current, error = step
        path.append(current)
    return [(f.problem.model, f.identified.theta, False) for f in path] + [
        (f.problem.model, f.identified.theta, True) for f in rejected
    ]


def _best_step(
    current: Fit, error: float, ranked: Sequence[Fit], score: Score
) -> tuple[Fit, float] | None:
    """Return the first candidate that improves on the current model.

    Parameters
    ----------
    current
        The current fit.
    error
        Its held-out error.
    ranked
        Candidates, lowest BIC first.
    score
        Held-out error of a fit.

    Returns
    -------
    tuple or None
        The candidate and its held-out error; None where none improves.
    """
    for candidate in ranked:
        gains = bic_gain(current, candidate) > MIN_BIC_GAIN
        if not gains and bic(candidate) > bic(current) - DECISIVE_BIC:
            continue
        candidate_error = score(candidate)
        max_ratio = MAX_HELD_OUT_RATIO if gains else HELD_OUT_GAIN_RATIO
        if candidate_error <= max_ratio * error:
            return candidate, candidate_error
    return None


def bic(result: Fit) -> float:
    """BIC for white residuals."""
    return float(result.identified.statistics["bic"])


def bic_gain(smaller: Fit, larger: Fit) -> float:
    """BIC gain of the larger model, discounted for correlated residuals.

    Parameters
    ----------
    smaller, larger
        Fits of two models to the same data.

    Returns
    -------
    float
        The gain; positive where the larger model is better.

    Notes
    -----
    m ln(S/S') - (k' - k) ln m, with m = N/(1 + 2 sum of the autocorrelations of the larger model's
    residuals), the number of independent residuals.
    """
    cost_smaller = float(smaller.innovation @ smaller.innovation)
    cost_larger = float(larger.innovation @ larger.innovation)
    n_smaller = smaller.identified.statistics["parameters"]
    n_added = larger.identified.statistics["parameters"] - n_smaller
    n_independent = max(len(larger.innovation) / correlation_length(larger.innovation), 2.0)
    decrease = np.log(cost_smaller / max(cost_larger, 1e-300))
    return float(n_independent * decrease - n_added * np.log(n_independent))


def off_equilibrium(data: IOData, result: Fit, options: Mapping[str, Any]) -> bool:
    """Whether free initial states improve a fit in equilibrium decisively.

    Only for residuals that are coloured or follow the input. The first residuals need not show it:
    an oscillating output may pass through its equilibrium at the start.

    Parameters
    ----------
    data
        The record.
    result
        The fit that starts in equilibrium.
    options
        Options of that fit.

    Returns
    -------
    bool
        Whether the BIC gain is above ``DECISIVE_BIC``.
    """
    if has_clean_residuals(result) or result.problem.initial != "equilibrium":
        return False
    free_state = {
        **options,
        **SCORING_OPTIONS,
        "initial": "estimated",
        "start": result.identified.theta,
    }
    try:
        freed = fit(data, result.problem.model, **free_state)
    except InputError:  # too few samples for so many unknowns
        return False
    return bic_gain(result, freed) > DECISIVE_BIC


def lowest_bic(fits: list[Fit | None]) -> Fit:
    """Return the fit of least BIC.

    Raises
    ------
    InputError
        Where no model could be fitted.
    """
    good = [f for f in fits if f is not None]
    if not good:
        raise InputError("no first lag could be fitted", expected="an output that follows an input")
    return min(good, key=bic)


def fit_candidate(
    data: IOData, model: Model, smaller: Fit | None, options: Mapping[str, Any]
) -> Fit | None:
    """Fit a larger model from the parameters of a smaller one.

    With one input also from the model's own starting values.

    Parameters
    ----------
    data
        The record.
    model
        The larger model.
    smaller
        Fit of the smaller model; None for the starting values of ``model`` itself.
    options
        Options of :func:`tcdyn.identify.fit`.

    Returns
    -------
    Fit or None
        The fit of least BIC; None where all fail. With one input, the starting values of ``model``
        itself are tried too.
    """
    starting: list[Any] = [] if smaller is None else [warm_starts(smaller, model)]
    if not (model.submodels and starting):
        starting.append(None)
    fits = []
    for start in starting:
        try:
            fits.append(fit(data, model, **options, start=start))
        except InputError:
            continue
    return min(fits, key=bic, default=None)


def refit_from_simpler(
    result: Fit, others: Mapping[str, Fit], data: IOData, options: Mapping[str, Any]
) -> Fit:
    """Fit again from the parameters of a simpler model that fits better.

    The simpler model is a special case, so it can fit better only where the search has failed.

    Parameters
    ----------
    result
        The fit.
    others
        Fits of the other models.
    data
        The record.
    options
        Options of :func:`tcdyn.identify.fit`.

    Returns
    -------
    Fit
        The better of both.

    Notes
    -----
    Additional parameters start at 2 % of the simpler model's longest lag, so that they hardly
    change it. The relative 1e-6 keeps equal fits from being repeated.
    ``tests/identify/test_identify_choose.py`` checks both.
    """
    model = result.problem.model
    for other in others.values():
        other_model = other.problem.model
        is_nested = set(other_model.names) < set(model.names) and other_model.kind == model.kind
        rms = result.identified.statistics["rms"]
        if not is_nested or other.identified.statistics["rms"] >= rms * (1 - 1e-6):
            continue
        size = 0.02 * (abs(other.identified.longest_lag_s) or data.dt_s)
        extra = {n: size for n in model.names if base_name(n) not in ("Tz", "Td")}
        start = {**extra, **other.identified.theta}
        refit = fit(data, model, **{**options, "start": start})
        if refit.identified.statistics["rms"] < rms:
            result = refit
    return result


def first_candidates(data: IOData, template: Model) -> list[Model]:
    """Return the models of one lag: behind the input, or behind each of several inputs in turn.

    Parameters
    ----------
    data
        The record.
    template
        What all models have.

    Returns
    -------
    list of Model
        The models.
    """
    inputs = data.input_names
    if len(inputs) == 1:
        return [as_template(process("P1"), template), as_template(process("P1D"), template)]
    candidates = []
    for k in range(len(inputs)):
        names = [NO_MODEL] * len(inputs)
        names[k] = "P1D"
        candidates.append(as_template(several(names, inputs, known=template.known), template))
    return candidates


def larger_models(model: Model, data: IOData) -> list[Model]:
    """Return all models that are one step larger."""
    if not model.submodels:
        return [as_template(m, model) for m in successors(model)]
    models = []
    for k in range(len(model.submodels)):
        for larger in successors(model.submodels[k]):
            submodels = [*model.submodels[:k], larger, *model.submodels[k + 1 :]]
            joined = several(submodels, model.inputs, known=model.known)
            models.append(as_template(joined, model))
    return models


def successors(model: Model) -> list[Model]:
    """The models one step larger behind one input.

    >>> [m.name for m in successors(process("P1D"))]
    ['P1DZ', 'P2D', 'P2DZ', 'P2DU']
    >>> [m.name for m in successors(transfer(1, 3))]
    ['TF(1,3)D', 'TF(2,3)', 'TF(1,4)', 'TF(2,4)', 'TF(3,5)']
    """
    if model.name == NO_MODEL:
        return [process("P1"), process("P1D")]
    if model.kind == "tf":
        return _transfer_successors(model)
    return _process_successors(model)


def _transfer_successors(model: Model) -> list[Model]:
    """The transfer functions one step larger."""
    has_delay = "Td" in model.names
    poles = model.order
    zeros = len([n for n in model.names if n[0] == "b"]) - 1
    models = [] if has_delay else [transfer(zeros, poles, delay=True)]
    sizes = [(1, 0), (0, 1), (1, 1), (2, 2)]
    for added_zeros, added_poles in sizes:
        z = zeros + added_zeros
        p = poles + added_poles
        if z <= p <= MAX_POLES:
            models.append(transfer(z, p, delay=has_delay))
    return models


def _process_successors(model: Model) -> list[Model]:
    """The process models one step larger; after three poles, transfer functions."""
    has_delay = "Td" in model.names
    poles = model.order
    letters = set(re.sub(r"[P\d]", "", model.name))
    has_zero = "Z" in letters
    larger = []
    if not has_delay:
        larger.append((poles, letters | {"D"}))
    if poles and not has_zero:
        larger.append((poles, letters | {"Z"}))
    if poles < 3:
        larger.append((poles + 1, letters))
        if not has_zero:
            larger.append((poles + 1, letters | {"Z"}))
    if poles and "U" not in letters:
        larger.append((max(poles, 2), letters | {"U"}))
    models = [process(f"P{p}{''.join(c for c in 'DUZ' if c in used)}") for p, used in larger]
    zeros = int(has_zero)
    if poles >= 2 and zeros:
        models.append(transfer(2, poles, delay=has_delay))
    if poles == 3:
        models.append(transfer(zeros, 4, delay=has_delay))
        models.append(transfer(zeros + 1, 4, delay=has_delay))
    return models


def warm_starts(smaller: Fit, model: Model) -> list[dict[str, float]]:
    """Return starting parameters of a larger model from those of a smaller fit.

    The new lag has three sizes. With several inputs the starting values of the larger branch are
    added.

    Parameters
    ----------
    smaller
        The smaller fit.
    model
        The larger model; it differs behind one input.

    Returns
    -------
    list of dict
        Parameters by name, one set for each of ``NEW_LAG_RATIOS``, and with several inputs those of
        the larger branch.
    """
    problem = smaller.problem
    theta = smaller.identified.theta
    old_model = problem.model
    k = _changed_branch(old_model, model, len(problem.branches))
    branch, names = model.branch(k)
    old_branch, old_names = old_model.branch(k)
    old_theta = {n: theta[full] for n, full in old_names.items()}
    other_theta = {full: v for full, v in theta.items() if full not in old_names.values()}
    is_new_input = old_branch.name == NO_MODEL
    if is_new_input:
        lag = smaller.identified.longest_lag_s
    else:
        lag = abs(old_branch.rational(old_theta).lag_s)
    lag = max(lag, problem.dt_s)
    candidates = [warm_start(old_branch, old_theta, branch, r * lag) for r in NEW_LAG_RATIOS]
    if model.submodels:
        single = single_input_problem(problem, theta, k)
        branch = replace(branch, offset=old_model.offset, delay_max_s=old_model.delay_max_s)
        single = replace(single, model=branch)
        if is_new_input:
            candidates = []
        candidates += [single.theta(x) for x in starts(single)[:2]]
    return [other_theta | {names[n]: v for n, v in c.items()} for c in candidates]


def _changed_branch(old_model: Model, model: Model, n_branches: int) -> int:
    """Return the number of the input whose model differs.

    Raises
    ------
    ValueError
        Where no input has another model.
    """
    for k in range(n_branches):
        if model.branch(k)[0].name != old_model.branch(k)[0].name:
            return k
    raise ValueError(f"{model.name} and {old_model.name} have the same branches")


def warm_start(
    old_model: Model, old_theta: Mapping[str, float], model: Model, tau: float
) -> dict[str, float]:
    """Return the parameters of a larger model from those of a smaller one.

    Parameters
    ----------
    old_model
        The smaller model.
    old_theta
        Its parameters by name.
    model
        The larger model.
    tau
        Value of a new lag [s].

    Returns
    -------
    dict
        All parameters of ``model``.

    Notes
    -----
    A new parameter changes the response little: a new zero cancels its pole. Only the start depends
    on these values. ``tests/identify/test_identify_starts.py`` checks them in several units.
    """
    delay = {"Td": old_theta.get("Td", 0.1 * tau)} if "Td" in model.names else {}
    if model.kind == "tf":
        num, factors = old_model.coefficients(old_theta)
        above: Array = np.asarray(num, dtype=float)
        below: Array = polynomial_product(factors)
        n_above = sum(n[0] == "b" for n in model.names)
        while len(below) < model.order + 1:
            below = polynomial_product([below, [1.0, tau]])
            if len(above) < n_above:
                above = polynomial_product([above, [1.0, tau]])
        values = {f"b{i}": float(v) for i, v in enumerate(above)}
        values |= {f"a{i}": float(v) for i, v in enumerate(below)}
        return {n: values.get(n, 0.0) for n in model.names} | delay
    added = [n for n in model.names if n not in old_theta]
    theta = dict(old_theta) | dict.fromkeys(added, tau) | delay
    if "Tw" in added:
        theta["Tw"] = float(np.sqrt(old_theta["Tp1"] * old_theta.get("Tp2", tau)))
        theta["Zeta"] = min(tau / theta["Tw"], 1.0)
        theta["Tp3"] = old_theta.get("Tp3", tau)
    if "Tz" in added and not any(n[:2] == "Tp" for n in added):
        theta["Tz"] = 0.1 * tau
    return {n: theta[n] for n in model.names}


def resolve_entry(given: Entry, data: IOData) -> Model:
    """The model to compare: by name or value, or with all parameters fixed to an existing model.

    With several inputs a model of one input is taken for each of them.

    Parameters
    ----------
    given
        Name, model, fit or identified model.
    data
        The record, for the names of its inputs.

    Returns
    -------
    Model
        The model; that of a fit has all its parameters fixed and the name "... as given".
    """
    identified = given.identified if isinstance(given, Fit) else given
    inputs = data.input_names
    if isinstance(identified, Identified):
        model = identified.model
        theta = identified.theta
        default_labels = tuple(f"u[{k}]" for k in range(len(inputs)))
        if model.inputs == default_labels:  # of the control package: inputs by their position
            model = several(model.submodels, inputs)
            theta = {}
            for k, name in enumerate(inputs):
                for n, full in identified.model.branch(k)[1].items():
                    theta[f"{n}.{name}"] = identified.theta[full]
        return replace(model, name=f"{model.name} as given", fixed=theta)
    model = as_model(identified)
    if model.submodels or len(inputs) == 1:
        return model
    return several([model] * len(inputs), inputs)


def list_candidates(task: Task, models: Sequence[Entry], like: Model) -> Candidates:
    """Return the models to compare: the given ones, or those of a forward selection.

    Parameters
    ----------
    task
        The comparison and its options.
    models
        The given models, may be none.
    like
        What all models of a forward selection have.

    Returns
    -------
    sequence of tuple
        Models under distinct names, starting parameters, and whether the selection has rejected
        them.
    """
    if models:
        return _distinct_models([resolve_entry(m, task.data) for m in models])
    number = count(1)

    def score(result: Fit) -> float:
        """Return the held-out error of a fit; infinite where the training data are too short."""
        k = next(number)
        task.progress(result.problem.model.name, k, k)
        try:
            return task.held_out_error(result, start=result.identified.theta)[0]
        except InputError:  # the training data are too short
            return np.inf

    return forward_select(task.data, like, score, task.options)


def _distinct_models(models: Sequence[Model]) -> Candidates:
    """The models without repeats; different ones of the same name are numbered."""
    named: dict[str, Model] = {}
    for model in models:
        pattern = re.escape(model.name) + r"(, \d+)?"
        same_name = [n for n in named if re.fullmatch(pattern, n)]
        if any(replace(named[n], name=model.name) == model for n in same_name):
            continue
        name = f"{model.name}, {len(same_name) + 1}" if same_name else model.name
        named[name] = replace(model, name=name)
    return [(m, None if m.free else {}, False) for m in named.values()]
