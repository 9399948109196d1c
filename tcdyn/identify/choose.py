"""Choice of order and structure: AICc, BIC and held-out simulation error in one table, a recommended row and
why."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from calibration import Array
from calibration.errors import InputError
from calibration.finding import Finding
from calibration.result import Result, jsonable
from tcdyn.chain.rational import realise
from tcdyn.identify.advice import COLUMNS, order_table, verdict
from tcdyn.identify.data import IOData, Segment, cut
from tcdyn.identify.fit import fit
from tcdyn.identify.identified import percent_times
from tcdyn.identify.models import Model, as_model
from tcdyn.identify.search import Fit
from tcdyn.identify.validate import ALARM, off_equilibrium, validate

CANDIDATES = ("P1", "P1D", "P2", "P2D", "P2Z", "P2DZ", "P2U", "P2DU", "P3", "P3D")
OFFERED = (*CANDIDATES, "P1I", "P1DI")  # by the advice, where none of the models compared is good enough
DECISIVE = 10.0  # difference of BIC from which nothing else makes up for it
Progress = Callable[[str, int, int], None]  # name of the model, its number, how many there are


@dataclass(frozen=True)
class Comparison(Result):
    """``table`` one row a model, best BIC first; ``fits`` on all data by name; ``recommended`` with ``why``."""

    table: pd.DataFrame
    fits: Mapping[str, Fit]
    recommended: str
    why: str

    @property
    def best(self) -> Fit:
        """The fit of the recommended model."""
        return self.fits[self.recommended]

    def summary(self) -> str:
        """Which model to use and why, or that none will do; the recommended model; the order table."""
        lines = [self.advice, "", self.best.summary()]
        model = self.best.identified
        if not model.model.integrators:
            times = ", ".join(f"{k} = {v.text('s')}" for k, v in percent_times(model).items())
            lines.append(f"  lag (first moment) {model.lag_s.text('s')}; step response {times}")
        shown = order_table(self.table, model.output_unit).to_string(index=False)
        return "\n".join([*lines, "", shown, "", COLUMNS])

    @cached_property
    def verdict(self) -> Finding:
        """Which model to use and why, or that none of them is good enough and what to try."""
        untried = [name for name in OFFERED if name not in set(self.table["model"])]
        return verdict(self.table, self.recommended, self.why, untried, validate(self.best).troubles)

    @property
    def advice(self) -> str:
        """The verdict in words."""
        return self.verdict.sentence

    def to_dict(self) -> dict[str, Any]:
        """The recommended model as its file holds it, why, and the order table."""
        table = jsonable(self.table)
        return {**self.best.to_dict(), "recommended": self.recommended, "why": self.why, "comparison": table}

    def card(self) -> pd.DataFrame:
        """The order table, remarks left out."""
        return self.table.drop(columns=["remark", "determined"])


def compare(
    data: IOData,
    models: Sequence[Model | str] = CANDIDATES,
    *,
    held_out: IOData | float = 0.3,
    progress: Progress = lambda name, number, count: None,
    **options: Any,
) -> Comparison:
    """Fit every model to all of ``data`` and score it on data it has not seen.

    ``held_out`` is another IOData, or the last share of the record (of several runs: the last run). Held-out
    scores come from a second fit to the rest. ``options`` go to :func:`tcdyn.identify.fit`; without ``initial`` the
    runs begin in equilibrium, unless the recommended fit tells that one does not and all models fit better, by BIC,
    with their initial states estimated. How the recommendation is made: :func:`recommend`. ``progress`` is told
    each model before it is fitted.
    """
    found = compared(data, models, held_out, progress, options)
    if "initial" in options or not off_equilibrium(found.best):
        return found

    def again(name: str, number: int, count: int) -> None:
        progress(f"{name}, initial state estimated", number, count)

    freed = compared(data, models, held_out, again, {**options, "initial": "estimated"})
    if freed.table["BIC"].min() >= found.table["BIC"].min():
        return found
    why = f"{freed.why} As a run starts off the equilibrium, the state at each start was estimated."
    return replace(freed, why=why)


def compared(
    data: IOData,
    models: Sequence[Model | str],
    held_out: IOData | float,
    progress: Progress,
    options: Mapping[str, Any],
) -> Comparison:
    """:func:`compare` with the fit's ``options`` as they are."""
    rows: list[dict[str, Any]] = []
    fits: dict[str, Fit] = {}
    first: InputError | None = None
    train, test, from_s = divide(data, held_out)
    for number, entry in enumerate(models, 1):
        model = as_model(entry)
        progress(model.name, number, len(models))
        try:
            whole = not_worse(fit(data, model, **options), fits, data, options)
            quick = {**options, "intervals": "quadratic", "check": False}  # the score needs no profile intervals
            score = whole if train is None else fit(train, model, **quick)
            rms, percent = held_out_score(score, test, from_s)
        except InputError as error:
            first = first or error
            rows.append({"model": model.name, "remark": str(error), "determined": False})
            continue
        fits[model.name] = whole
        s = whole.identified.statistics
        rows.append(
            {
                "model": model.name,
                "parameters": int(s["parameters"]),
                **{column: s[column.lower()] for column in ("fit_percent", "rms", "AICc", "BIC")},
                "held_out_rms": rms,
                "held_out_percent": percent,
                "p_white": s["p_white"],
                "p_input": s["p_input"],
                "remark": "; ".join(whole.warnings),
                "determined": not whole.findings,
            }
        )
    if not fits:
        raise first or InputError("no model to compare", expected=f"names such as {', '.join(CANDIDATES)}")
    table = pd.DataFrame(rows).sort_values("BIC", key=lambda b: b.round(6), kind="stable", ignore_index=True)
    name, why = recommend(table, overdamped(fits))
    return Comparison(table, fits, name, why)


def overdamped(fits: Mapping[str, Fit]) -> list[str]:
    """Models with a complex pair (U) whose poles are real, where the two lags that it is were fitted no worse: the data
    determine them, or do not determine the pair either."""
    return [
        name
        for name, found in fits.items()
        if found.identified.theta.get("Zeta", 0.0) >= 1
        and (plain := fits.get(name.replace("U", ""))) is not None
        and (found.findings or not plain.findings)
    ]


def not_worse(found: Fit, others: Mapping[str, Fit], data: IOData, options: Mapping[str, Any]) -> Fit:
    """``found``, or the fit begun at a simpler model's answer where that one, a special case of it, fits
    better."""
    model = found.problem.model
    for other in others.values():
        inside = set(other.problem.model.names) < set(model.names) and other.problem.model.kind == model.kind
        if inside and other.identified.statistics["rms"] < found.identified.statistics["rms"] * (1 - 1e-6):
            extra = {n: 0.02 * abs(other.identified.lag_s.value) for n in model.names if n not in ("Tz", "Td")}
            start = {**extra, **other.identified.theta}
            again = fit(data, model, **{**options, "start": start})
            if again.identified.statistics["rms"] < found.identified.statistics["rms"]:
                found = again
    return found


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
    """Simulation rms and NRMSE fit percent of ``result`` on ``test`` from time ``from_s`` on.

    Nothing is re-estimated but a state: a record that the fit has begun is continued from the state it found; any
    other whose state is free (after a gap, or all with "estimated") gets the state that suits it best.
    """
    model, problem = result.identified, replace(result.problem, dt_s=test.dt_s, hold=test.hold)
    rational = model.rational
    system = realise(rational, sensitivities=False)
    errors, spreads = [], []
    for k, run in enumerate(test.runs):
        for s in cut(run, k, test.dt_s):
            y = problem.driven(system, s, rational.delay_s)[0] + model.offset
            if s.resumed or problem.initial == "estimated":
                y = y + free_response(result, s, s.y - y)
            late = s.seen & (s.start_s + np.arange(len(y)) * test.dt_s >= from_s)
            errors.append((s.y - y)[late])
            spreads.append(s.y[late] - np.mean(s.y[late]) if late.any() else s.y[late])
    e, spread = np.concatenate(errors), np.concatenate(spreads)
    if len(e) == 0:
        return np.nan, np.nan
    top, base = float(np.sqrt(np.mean(e**2))), float(np.sqrt(np.mean(spread**2)))
    return top, 100 * (1 - top / base) if base > 0 else np.nan


def free_response(result: Fit, piece: Segment, left: Array) -> Array:
    """What the initial state of ``piece`` leaves in its output (N,): that of the fitted segment with which it begins,
    else the one that explains most of ``left`` (N,), its output less the response to its input."""
    problem, rational = result.problem, result.identified.rational
    for k in problem.loose:
        s = problem.segments[k]
        m = min(len(s.y), len(piece.y))
        if s.start_s == piece.start_s and np.array_equal(s.y[:m], piece.y[:m], equal_nan=True):
            return np.asarray(problem.free_response(rational, result.x[problem.state_slice(k)], len(left))[0])
    rows = problem.state_rows(problem.free_response(rational, np.ones(problem.n_states), len(left)))
    state = np.linalg.lstsq(rows[:, piece.seen].T, left[piece.seen], rcond=1e-10)[0]
    return np.asarray(state @ rows)


def recommend(table: pd.DataFrame, left_out: Collection[str] = ()) -> tuple[str, str]:
    """The row to use and a sentence why.

    The lowest BIC among models without complaint (no parameter on a bound or undetermined) whose residuals do not
    follow the input; failing that, among those that the data do not determine but whose residuals do not follow the
    input; then among those without complaint. A model is passed over for another kind only where that one's BIC is
    less than 10 above it: what explains decisively less of the output passes the tests for want of power. Within a
    kind the best gives way to a smaller model whose BIC is within 2, and to one whose BIC is within 10 and whose
    held-out error is better by more than 5 %. ``left_out`` are names that are not considered.
    """
    good = table[table["BIC"].notna() & ~table["model"].isin(list(left_out))]
    sound = good[good["determined"]]
    following = good.get("p_input", pd.Series(1.0, good.index)) < ALARM
    passing, explaining = sound[~following[sound.index]], good[~following]
    limit = (sound if len(sound) else good)["BIC"].min() + DECISIVE
    pool = next(p for p in (passing, explaining, sound, good) if len(p) and p["BIC"].min() <= limit)
    best = pool.iloc[0]
    near = pool[(pool["BIC"] < best["BIC"] + 2) & (pool["parameters"] < best["parameters"])]
    lowest = "the lowest BIC" if best["BIC"] == good["BIC"].min() else "the lowest BIC of those that qualify"
    reason = f"{best['model']} has {lowest}"
    if len(near):
        best = near.sort_values("parameters").iloc[0]
        reason = f"{best['model']} has fewer parameters than {pool.iloc[0]['model']} and a BIC within 2 of it"
    rival = pool[pool["BIC"] < pool["BIC"].min() + DECISIVE].sort_values("held_out_rms").iloc[0]
    if rival["held_out_rms"] < 0.95 * best["held_out_rms"]:
        reason = (
            f"{rival['model']} simulates the held-out part better ({rival['held_out_rms']:.4g} against "
            f"{best['held_out_rms']:.4g} rms) than {best['model']}, which has the lower BIC"
        )
        best = rival
    elif len(pool) > 1:
        reason += f" and simulates the held-out part to {best['held_out_rms']:.4g} rms"
        if not best["held_out_rms"] > pool["held_out_rms"].min():
            reason += ", the least of all"
    ties = pool[(abs(pool["BIC"] - best["BIC"]) < 2) & (pool["model"] != best["model"])]
    if len(ties) and not len(near):
        reason += f"; {' and '.join(ties['model'])} within 2 of its BIC would do as well"
    skipped, left = good[~good["determined"]], sound[~sound["model"].isin(pool["model"])]
    asides = (
        (skipped[skipped["BIC"] < best["BIC"]], "would score better but", "is are", "not determined by these data"),
        (left[left["BIC"] < best["BIC"]], "would score better but", "misses miss", "dynamics"),
        (
            table[table["model"].isin(list(left_out)) & (table["BIC"] < best["BIC"] + 2)],
            "", "is are", "left out, for the pair does not oscillate and is two lags",
        ),
    )  # fmt: skip
    for rows, before, verbs, after in asides:
        if len(rows):
            words = (", ".join(rows["model"]), before, verbs.split()[len(rows) > 1], after)
            reason += "; " + " ".join(filter(None, words))
    return str(best["model"]), reason + "."


__all__ = ["CANDIDATES", "Comparison", "compare", "held_out_score", "recommend"]
