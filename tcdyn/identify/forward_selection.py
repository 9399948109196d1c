"""A search that grows: from one lag on, orders, zeros, dead times and inputs are added until the criterion stops."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from tcdyn.chain.rational import product
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation import correlation_length
from tcdyn.identify.fit import fit
from tcdyn.identify.heldout import QUICK, Task
from tcdyn.identify.identified import Identified
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import (
    SILENT,
    Model,
    as_model,
    as_template,
    bare,
    process,
    several,
    transfer,
)
from tcdyn.identify.recommendation import DECISIVE
from tcdyn.identify.search import Fit
from tcdyn.identify.starting_values import rest, starts
from tcdyn.identify.validate import clean

WORTH = 2.0  # BIC that a step must gain
UNSEEN = (
    1.05  # times the held-out error, beyond which a step has learnt the record and not the system
)
SEEN = 0.97  # times the held-out error, below which a step counts though the colour of the residuals could explain it
MOST_POLES = 6
MOST_STEPS = 24
MOST_SHOWN = 3
SIZES = (0.1, 1.0, 10.0)  # of what is new, in lags of what was there
Score = Callable[[Fit], float]
Entry = Model | str | Fit | Identified
Way = Sequence[
    tuple[Model, Mapping[str, float] | None, bool]
]  # models, where their searches begin, whether refused


def grown(
    data: IOData, template: Model, score: Score, options: Mapping[str, Any]
) -> list[tuple[Model, Mapping[str, float], bool]]:
    """The way from one lag (behind the input that explains most) to the model from which no step is worth its while.

    A step adds to one branch a dead time, a zero, a pole, a pole with a zero, or lets two poles be complex; beyond
    three poles it goes on with general transfer functions. Where there are several inputs it also gives one that had
    none its first lag. Of all steps that with the least BIC is taken, if it gains 2 (:func:`gain`) and the error that
    ``score`` finds in data kept from the fit does not rise by more than 5 %, or if it would gain 10 were the residuals
    white and that error falls by 3 % or more; else the next best that does. Each model comes with its parameters and
    whether it was refused: last come the best steps that were not taken. ``template`` holds what all have: the known
    part, the offset, a fixed gain. ``options`` go to :func:`tcdyn.identify.fit`.
    """
    quick = {**options, **QUICK}
    now = best_of([fitted(data, m, None, quick) for m in first_steps(data, template)])
    error = score(now)
    way = [now]
    seen = {now.problem.model.name}
    refused: list[Fit] = []
    for _ in range(MOST_STEPS):
        fresh = [m for m in steps(now.problem.model, data) if m.name not in seen]
        seen |= {m.name for m in fresh}
        tried = [f for f in (fitted(data, m, now, quick) for m in fresh) if f is not None]
        tried.sort(key=bic)
        for found in tried:
            sure = gain(now, found) > WORTH
            if not sure and bic(found) > bic(now) - DECISIVE:
                continue
            unseen = score(found)
            if unseen <= (UNSEEN if sure else SEEN) * error:
                break
        else:
            refused = tried[:MOST_SHOWN]
            break
        now = found
        error = unseen
        way.append(found)
    return [
        (f.problem.model, f.identified.theta, any(f is r for r in refused))
        for f in (*way, *refused)
    ]


def bic(found: Fit) -> float:
    """The criterion of white residuals."""
    return float(found.identified.statistics["bic"])


def gain(smaller: Fit, larger: Fit) -> float:
    """What the larger model gains in BIC where residuals that are coloured count for as many as are independent.

    m ln(S/S') - (k' - k) ln m, m = N/(1 + 2 sum of the autocorrelations of the larger model's residuals).
    """
    before, after = (float(f.innovation @ f.innovation) for f in (smaller, larger))
    more = larger.identified.statistics["parameters"] - smaller.identified.statistics["parameters"]
    independent = max(len(larger.innovation) / correlation_length(larger.innovation), 2.0)
    return float(independent * np.log(before / max(after, 1e-300)) - more * np.log(independent))


def off_equilibrium(data: IOData, found: Fit, options: Mapping[str, Any]) -> bool:
    """Whether residuals that are coloured or follow the input decisively ask for an initial state other than the
    equilibrium of ``found``; the first ones alone need not tell: what rings may pass through its level just then."""
    if clean(found) or found.problem.initial != "equilibrium":
        return False
    free = {**options, **QUICK, "initial": "estimated", "start": found.identified.theta}
    try:
        return gain(found, fit(data, found.problem.model, **free)) > DECISIVE
    except InputError:  # too few samples for so many unknowns
        return False


def best_of(tried: list[Fit | None]) -> Fit:
    """The least BIC; InputError of the first model where none could be fitted."""
    good = [f for f in tried if f is not None]
    if not good:
        raise InputError("no first lag could be fitted", expected="an output that follows an input")
    return min(good, key=bic)


def fitted(
    data: IOData, model: Model, before: Fit | None, options: Mapping[str, Any]
) -> Fit | None:
    """The better of the fit begun at the simpler model's answer and, of one input, of that begun nowhere; None where
    there is none."""
    begun: list[Any] = [] if before is None else [onward(before, model)]
    tried = []
    for start in begun if model.parts and begun else [*begun, None]:
        try:
            tried.append(fit(data, model, **options, start=start))
        except InputError:
            continue
    return min(tried, key=bic, default=None)


def not_worse(
    found: Fit, others: Mapping[str, Fit], data: IOData, options: Mapping[str, Any]
) -> Fit:
    """``found``, or the fit begun at a simpler model's answer where that one, a special case of it, fits
    better."""
    model = found.problem.model
    for other in others.values():
        inside = (
            set(other.problem.model.names) < set(model.names)
            and other.problem.model.kind == model.kind
        )
        if inside and other.identified.statistics["rms"] < found.identified.statistics["rms"] * (
            1 - 1e-6
        ):
            size = 0.02 * (abs(other.identified.longest_lag_s) or data.dt_s)
            extra = {n: size for n in model.names if bare(n) not in ("Tz", "Td")}
            start = {**extra, **other.identified.theta}
            again = fit(data, model, **{**options, "start": start})
            if again.identified.statistics["rms"] < found.identified.statistics["rms"]:
                found = again
    return found


def first_steps(data: IOData, template: Model) -> list[Model]:
    """One lag behind the input; of several inputs behind each alone."""
    names = data.input_names
    if len(names) == 1:
        return [as_template(process("P1"), template), as_template(process("P1D"), template)]
    kinds = [["P1D" if j == k else SILENT for j in range(len(names))] for k in range(len(names))]
    return [as_template(several(kind, names, known=template.known), template) for kind in kinds]


def steps(model: Model, data: IOData) -> list[Model]:
    """All models that are one step larger."""
    if not model.parts:
        return [as_template(m, model) for m in successors(model)]
    found = []
    for k in range(len(model.parts)):
        for part in successors(model.parts[k]):
            parts = [*model.parts[:k], part, *model.parts[k + 1 :]]
            found.append(as_template(several(parts, model.inputs, known=model.known), model))
    return found


def successors(model: Model) -> list[Model]:
    """The models one step larger behind one input.

    >>> [m.name for m in successors(process("P1D"))]
    ['P1DZ', 'P2D', 'P2DZ', 'P2DU']
    >>> [m.name for m in successors(transfer(1, 3))]
    ['TF(1,3)D', 'TF(2,3)', 'TF(1,4)', 'TF(2,4)', 'TF(3,5)']
    """
    if model.name == SILENT:
        return [process("P1"), process("P1D")]
    delay = "Td" in model.names
    poles = model.order
    zeros = len([n for n in model.names if n[0] == "b"]) - 1
    if model.kind == "tf":
        larger = [
            (zeros + 1, poles),
            (zeros, poles + 1),
            (zeros + 1, poles + 1),
            (zeros + 2, poles + 2),
        ]
        found = [] if delay else [transfer(zeros, poles, delay=True)]
        return found + [transfer(z, p, delay=delay) for z, p in larger if z <= p <= MOST_POLES]
    letters = set(re.sub(r"[P\d]", "", model.name))
    named = [] if delay else [(poles, letters | {"D"})]
    named += [(poles, letters | {"Z"})] if poles and "Z" not in letters else []
    if poles < 3:
        named += [(poles + 1, letters)]
        named += [(poles + 1, letters | {"Z"})] if "Z" not in letters else []
    named += [(max(poles, 2), letters | {"U"})] if poles and "U" not in letters else []
    found = [process(f"P{p}{''.join(c for c in 'DUZ' if c in kept)}") for p, kept in named]
    zeros = int("Z" in letters)
    if poles >= 2 and zeros:
        found.append(transfer(2, poles, delay=delay))
    if poles == 3:
        found += [transfer(zeros, 4, delay=delay), transfer(zeros + 1, 4, delay=delay)]
    return found


def onward(found: Fit, model: Model) -> list[dict[str, float]]:
    """Parameters of ``model`` to begin at: what the smaller one ``found`` did with what is new of three sizes, and the
    starts that the larger branch has by itself."""
    posed = found.problem
    theta = found.identified.theta
    old = found.problem.model
    k = next(
        k for k in range(len(posed.branches)) if model.branch(k)[0].name != old.branch(k)[0].name
    )
    (part, names) = model.branch(k)
    (was, own) = old.branch(k)
    have = {n: theta[w] for n, w in own.items()}
    kept = {w: v for w, v in theta.items() if w not in own.values()}
    lag = found.identified.longest_lag_s if was.name == SILENT else abs(was.rational(have).lag_s)
    fresh = [begin(was, have, part, size * max(lag, posed.dt_s)) for size in SIZES]
    if model.parts:
        alone = rest(posed, theta, k)
        sub = replace(alone, model=replace(part, offset=old.offset, delay_max_s=old.delay_max_s))
        fresh = ([] if was.name == SILENT else fresh) + [sub.theta(x) for x in starts(sub)[:2]]
    return [kept | {names[n]: v for n, v in one.items()} for one in fresh]


def begin(was: Model, have: Mapping[str, float], part: Model, tau: float) -> dict[str, float]:
    """The parameters of ``part`` from those of ``was``, what is new of the size ``tau`` [s]; a zero on its pole."""
    delay = {"Td": have.get("Td", 0.1 * tau)} if "Td" in part.names else {}
    if part.kind == "tf":
        first, factors = was.coefficients(have)
        above: Array = np.asarray(first, dtype=float)
        below: Array = product(factors)
        for _ in range(part.order + 1 - len(below)):
            below = product([below, [1.0, tau]])
            if len(above) < sum(n[0] == "b" for n in part.names):
                above = product([above, [1.0, tau]])
        values = {f"b{i}": float(v) for i, v in enumerate(above)} | {
            f"a{i}": float(v) for i, v in enumerate(below)
        }
        return {n: values.get(n, 0.0) for n in part.names} | delay
    new = [n for n in part.names if n not in have]
    begun = dict(have) | dict.fromkeys(new, tau) | delay
    if "Tw" in new:
        begun["Tw"] = float(np.sqrt(have["Tp1"] * have.get("Tp2", tau)))
        begun["Zeta"] = min(tau / begun["Tw"], 1.0)
        begun["Tp3"] = have.get("Tp3", tau)
    if "Tz" in new and not any(n[:2] == "Tp" for n in new):
        begun["Tz"] = 0.1 * tau
    return {n: begun[n] for n in part.names}


def entry(given: Entry, data: IOData) -> Model:
    """The model to be fitted: the one that was named, behind each input where there are several, or one that stands."""
    found = given.identified if isinstance(given, Fit) else given
    names = data.input_names
    if isinstance(found, Identified):
        model = found.model
        theta = found.theta
        if model.inputs == tuple(
            f"u[{k}]" for k in range(len(names))
        ):  # control's own labels: by their place
            model = several(model.parts, names)
            own = (found.model.branch(k)[1] for k in range(len(names)))
            theta = {f"{n}.{u}": theta[w] for u, named in zip(names, own) for n, w in named.items()}
        return replace(model, name=f"{model.name} as given", fixed=theta)
    model = as_model(found)
    return model if model.parts or len(names) == 1 else several([model] * len(names), names)


def listed(task: Task, models: Sequence[Entry], like: Model) -> Way:
    """The ``models`` under a name each, begun nowhere, or where there are none those of the way from one lag on."""
    if models:
        named: dict[str, Model] = {}
        for model in (entry(m, task.data) for m in models):
            like_it = [n for n in named if re.fullmatch(re.escape(model.name) + r"(, \d+)?", n)]
            if all(replace(named[n], name=model.name) != model for n in like_it):
                name = f"{model.name}, {len(like_it) + 1}" if like_it else model.name
                named[name] = replace(model, name=name)
        return [(m, None if m.free else {}, False) for m in named.values()]
    number = count(1)

    def score(found: Fit) -> float:
        task.progress(found.problem.model.name, k := next(number), k)
        try:
            return task.unseen(found, start=found.identified.theta)[0]
        except InputError:  # too little is left of the record
            return np.inf

    return grown(task.data, like, score, task.options)
