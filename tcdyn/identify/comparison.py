"""Comparison of models on one record: AICc, BIC and held-out error in one table, and all fits.

``tcdyn identify`` and ``tcdyn.plots.pick`` use it. The candidates come from
``tcdyn.identify.forward_selection``, the choice among them from ``tcdyn.identify.recommendation``.
``tests/identify/test_identify_choose.py``, ``test_identify_advice.py`` and
``test_identify_results.py`` in that folder guard it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import pandas as pd

from tcdyn.chain import NO_CONDITIONING
from tcdyn.core.errors import InputError, Spelling, as_argument
from tcdyn.core.findings import Finding, Severity, info
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.identify.closed_loop import check_closed_loop, closed_loop
from tcdyn.identify.fit import add_findings, fit
from tcdyn.identify.forward_selection import (
    Candidates,
    Entry,
    list_candidates,
    off_equilibrium,
    refit_from_simpler,
)
from tcdyn.identify.heldout import SCORING_OPTIONS, Progress, Task
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import Model, process
from tcdyn.identify.recommendation import (
    TABLE_LEGEND,
    chain_advice,
    comparison_table,
    conclude,
    recommend,
    responds_at_once,
)
from tcdyn.identify.search import Fit
from tcdyn.identify.shared_poles import best_common_pole_fit
from tcdyn.identify.validate import (
    Validation,
    has_clean_residuals,
    has_coloured_residuals,
    validate,
)
from tcdyn.rig.disk import Conditioning

# Usual models: the default of ``tcdyn response``, and the examples of an error message.
CANDIDATES = ("P1", "P1D", "P2", "P2D", "P2Z", "P2DZ", "P2U", "P2DU", "P3", "P3D")
# Models that the advice names where none of the models compared is good enough.
ADVISED_MODELS = (*CANDIDATES, "P1I", "P1DI")
# Held-out error over that without a noise model, above which the noise model has absorbed dynamics
# (chosen by judgement).
MAX_HELD_OUT_RATIO = 1.2


@dataclass(frozen=True)
class Comparison(Result):
    """The result of :func:`compare`.

    Parameters
    ----------
    table
        One row for each model, best BIC first.
    fits
        Fits to all data, by name.
    recommended
        Name of the recommended model.
    reason
        Why it is recommended.
    is_forward_selection
        Whether the models are those of a forward selection, which leaves none to be tried.
    """

    table: pd.DataFrame
    fits: Mapping[str, Fit]
    recommended: str
    reason: Finding
    is_forward_selection: bool = False

    @property
    def reason_text(self) -> str:
        """The reason as text."""
        return self.reason.sentence

    @property
    def best_row(self) -> Mapping[str, Any]:
        """The recommended model's row of the table."""
        return dict(self.table[self.table["model"] == self.recommended].iloc[0])

    @property
    def best(self) -> Fit:
        """The fit of the recommended model."""
        return self.fits[self.recommended]

    def summary(self, spelling: Spelling = as_argument) -> str:
        """The conclusion, the recommended model and the table, as text.

        Parameters
        ----------
        spelling
            Spelling of the parameters that the advice and the findings name.
        """
        advice = self.conclusion.message(spelling)
        best = replace(self.best.identified, sentence=self.validation.message(spelling))
        table = comparison_table(self.table, best.output_unit).to_string(index=False)
        return "\n".join([advice, "", best.summary(spelling), "", table, "", TABLE_LEGEND])

    @cached_property
    def validation(self) -> Validation:
        """Residual tests of the recommended model."""
        return validate(self.best)

    @property
    def conclusion(self) -> Finding:
        """Which model to use and why, or that none of them is good enough and what to try."""
        untried = []
        if not self.is_forward_selection:
            compared = set(self.table["model"])
            untried = [name for name in ADVISED_MODELS if name not in compared]
        troubles = [f.code for f in self.best.findings if f.code == "record.closed_loop"]
        if not troubles and responds_at_once(self.best):
            troubles = ["model.at_once"]
        has_closed_loop = bool(troubles)
        for code in self.validation.record_problems:
            # feedback says the same as a closed loop
            if not (has_closed_loop and code == "record.feedback"):
                troubles.append(code)
        return conclude(self.table, self.recommended, self.reason, untried, troubles)

    def lag_removal_advice(self, conditioning: Conditioning = NO_CONDITIONING) -> str:
        """How to remove the lag from other traces; empty where no model can be used.

        See :func:`tcdyn.identify.recommendation.chain_advice`.
        """
        if self.conclusion.severity is Severity.ERROR:
            return ""
        return chain_advice(self.best.identified, conditioning)

    @property
    def advice(self) -> str:
        """The conclusion as text."""
        return self.conclusion.sentence

    def to_dict(self) -> dict[str, Any]:
        """The recommended model as in its JSON file, the reason, and the table."""
        return {
            **self.best.to_dict(),
            "recommended": self.recommended,
            "why": self.reason_text,
            "comparison": jsonable(self.table),
        }

    def card(self) -> pd.DataFrame:
        """The table without remarks."""
        return self.table.drop(columns=["remark", "determined", "refused"])


@one_blas_thread
def compare(
    data: IOData,
    *models: Entry | Sequence[Entry],
    like: Model | None = None,
    held_out: IOData | float = 0.3,
    progress: Progress = lambda name, number, count: None,
    **options: Any,
) -> Comparison:
    """Fit every model to all of the data, and score it on data that it has not used.

    Parameters
    ----------
    data
        One output, one or several inputs.
    models
        Models, or one list of them: names or models to fit, or existing ones (a :class:`Fit` or an
        :class:`Identified`, also from :func:`tcdyn.identify.from_control`), of which only the
        offset is fitted. Two of one name are numbered. Without any, forward selection chooses them
        (:func:`tcdyn.identify.forward_selection.forward_select`), and with several inputs the
        inputs that matter.
    like
        Model whose known factor, offset and fixed gain all models of a forward selection have.
    held_out
        Another record, or the last share of this one (with several runs: the last run). Held-out
        scores come from a second fit to the rest.
    progress
        Called with each model before it is fitted.
    options
        Options of :func:`fit`, without ``start``.

    Returns
    -------
    Comparison
        Table, fits, and the recommended model with its reason.

    Raises
    ------
    InputError
        For data from which no model can be identified.

    Notes
    -----
    Without ``initial`` the runs start in equilibrium, unless the recommended fit shows that one
    does not and all models fit better, by BIC, with estimated initial states. Without ``noise``
    and ``baseline`` the noise is white, unless the residuals of the recommended fit are coloured
    and do not follow the input: then both are selected from the data, for all models alike. For
    the recommendation see :func:`tcdyn.identify.recommendation.recommend`.

    The order matters: initial states first, then the disturbance, then common poles. Each step
    keeps the earlier result unless the new one is better by its own criterion.
    ``tests/identify/test_identify_advice.py`` checks the first step,
    ``tests/identify/test_identify_disturbance.py`` the second,
    ``tests/identify/test_identify_equation.py`` the third.
    """
    if "start" in options:
        raise InputError(
            "start is given, but each search begins where a simpler model ended",
            where="compare",
            remedy="pass fit(data, model, start=..) as a model: it is compared as it stands",
        )
    entries: list[Entry] = []
    for m in models:
        entries += [m] if isinstance(m, Entry) else m

    if options.get("check", True):
        check_closed_loop(data, data.name or "identify")
    else:
        data = replace(data, findings=(*data.findings, *closed_loop(data)))
    task = Task(data, held_out, progress, options)
    like = like or process("P1")
    result = compare_candidates(task, list_candidates(task, entries, like))
    if "initial" not in options and _needs_free_state(data, result, options):
        free_task = task.with_options("initial state estimated", initial="estimated")
        freed = compare_candidates(free_task, list_candidates(free_task, entries, like))
        if freed.table["BIC"].min() < result.table["BIC"].min():
            reason = replace(freed.reason, numbers={**freed.reason.numbers, "freed": True})
            result = replace(freed, reason=reason)
            task = replace(task, options=free_task.options)
    result = refit_with_disturbance(task, result)
    if result.is_forward_selection:
        result = add_common_pole_model(task, result, like)
    return result


def _needs_free_state(data: IOData, result: Comparison, options: Mapping[str, Any]) -> bool:
    """Whether a run of the data does not start in equilibrium."""
    if "record.off_equilibrium" in result.validation.record_problems:
        return True
    return off_equilibrium(data, result.best, options)


def add_common_pole_model(task: Task, result: Comparison, like: Model) -> Comparison:
    """Add a transfer function whose inputs share their poles, if it is better.

    It is tried only where the residuals of the best model are coloured or follow the input. See
    :func:`tcdyn.identify.shared_poles.best_common_pole_fit`.

    Parameters
    ----------
    task
        The comparison and its options.
    result
        The comparison so far.
    like
        What all models have: known factor, offset, fixed gain.

    Returns
    -------
    Comparison
        With that model as the recommended one, or ``result`` unchanged.
    """
    best = result.best
    options = task.options
    if has_clean_residuals(best) or options.get("loss", "linear") != "linear":
        return result
    number = len(result.table) + 1
    task.progress("common poles", number, number)
    better = best_common_pole_fit(task, best, result.best_row["held_out_rms"], like)
    if better is None:
        return result
    better_fit, ratio = better
    model = better_fit.problem.model
    if model.name in result.fits:
        model = replace(model, name=f"{model.name}, 2")
    initial = better_fit.problem.initial
    single_task = replace(task, options={**options, "initial": initial})
    single = compare_candidates(single_task, [(model, better_fit.identified.theta, False)])
    table = pd.concat([single.table, result.table], ignore_index=True)
    has_free_state = initial != options.get("initial", "equilibrium")
    reason = info(
        "models.foresees",
        subject=model.name,
        white=not has_coloured_residuals(single.best),
        other=result.recommended,
        ratio=ratio,
        freed=result.reason.numbers.get("freed", False) or has_free_state,
    )
    fits = {**single.fits, **result.fits}
    return Comparison(table, fits, model.name, reason, is_forward_selection=True)


def refit_with_disturbance(task: Task, result: Comparison) -> Comparison:
    """Refit all models with a noise model selected from the best model's residuals.

    Only where the residuals are coloured and, apart from a drift, do not follow the input. All
    models get the same noise, and only where the held-out error does not rise.

    Parameters
    ----------
    task
        The comparison and its options.
    result
        The comparison with white noise.

    Returns
    -------
    Comparison
        The new comparison, or ``result`` where it is not better: where BIC does not fall, or the
        held-out error rises by more than ``MAX_HELD_OUT_RATIO``.

    Notes
    -----
    A noise model can absorb missing dynamics: then BIC falls and the held-out error rises. A larger
    ``MAX_HELD_OUT_RATIO`` permits more of that. ``tests/identify/test_identify_disturbance.py``
    checks that the disturbance is modelled where there is one.
    """
    best = result.best
    options = task.options
    is_requested = bool({"noise", "baseline"} & set(options))
    is_robust = options.get("loss", "linear") != "linear"
    if is_requested or is_robust or not has_coloured_residuals(best):
        return result
    selection = {**options, **SCORING_OPTIONS, "noise": "auto", "baseline": "auto"}
    if result.is_forward_selection:
        selection["start"] = best.identified.theta
    disturbance = fit(task.data, best.problem.model, **selection).disturbance
    if disturbance == best.disturbance:
        return result

    candidates: list[tuple[Model, Mapping[str, float] | None, bool]] = []
    for f in result.fits.values():
        start = f.identified.theta if result.is_forward_selection else None
        candidates.append((f.problem.model, start, False))
    noise_task = task.with_options("disturbance modelled", **disturbance)
    refit = compare_candidates(noise_task, candidates)
    max_held_out = MAX_HELD_OUT_RATIO * result.best_row["held_out_rms"]
    is_worse = refit.best_row["held_out_rms"] > max_held_out
    if is_worse or refit.table["BIC"].min() >= result.table["BIC"].min():
        return result
    noise = refit.best.noise
    numbers: dict[str, Any] = {
        **refit.reason.numbers,
        "order": list(noise.order),
        "baseline": disturbance["baseline"],
        "freed": result.reason.numbers.get("freed", False),
    }
    if noise.averaged:
        is_finite = noise.time_constant < len(refit.best.residual)
        numbers["memory_s"] = noise.time_constant * task.data.dt_s if is_finite else None
        numbers["p_walk"] = refit.best.identified.statistics["p_walk"]
    reason = replace(refit.reason, numbers=numbers)
    return replace(refit, reason=reason, is_forward_selection=result.is_forward_selection)


def compare_candidates(task: Task, models: Candidates) -> Comparison:
    """Fit and score each model with the options of the task.

    Parameters
    ----------
    task
        The comparison and its options.
    models
        Models, starting parameters, and whether the forward selection has rejected them.

    Returns
    -------
    Comparison
        Table, fits and recommendation. A model that cannot be fitted has a row with a remark.

    Raises
    ------
    InputError
        Where no model could be fitted.
    """
    rows: list[dict[str, Any]] = []
    fits: dict[str, Fit] = {}
    first_error: InputError | None = None
    data = replace(task.data, findings=())
    for number, (model, start, refused) in enumerate(models, 1):
        task.progress(model.name, number, len(models))
        options = {**task.options, "start": start}
        if fits and start is not None:
            options["check"] = False  # the first fit has checked the record
        try:
            full = fit(data, model, **options)
            if start is None:
                full = refit_from_simpler(full, fits, data, task.options)
            held_out = task.held_out_error(full, start=start)
        except InputError as error:
            first_error = first_error or error
            rows.append({"model": model.name, "remark": str(error), "determined": False})
            continue
        fits[model.name] = full
        rows.append(_table_row(full, held_out, refused))
    if not fits:
        raise first_error or InputError(
            "no model to compare", expected=f"names such as {', '.join(CANDIDATES)}"
        )
    table = pd.DataFrame(rows).sort_values(
        "BIC", key=lambda b: b.round(6), kind="stable", ignore_index=True
    )
    recommended, reason = recommend(table, overdamped(fits))
    fits = {name: add_findings(f, task.data.findings) for name, f in fits.items()}
    is_forward_selection = any(refused for *_, refused in models)
    return Comparison(table, fits, recommended, reason, is_forward_selection)


def _table_row(full: Fit, held_out: tuple[float, float, float], refused: bool) -> dict[str, Any]:
    """Return the row of a model: statistics of the fit and of the held-out simulation.

    Parameters
    ----------
    full
        Fit to all of the data.
    held_out
        Rms error, fit percent and p value of the held-out simulation.
    refused
        Whether the forward selection has rejected the model.

    Returns
    -------
    dict
        Values by column. ``tcdyn.identify.recommendation`` reads these names.
    """
    statistics = full.identified.statistics
    held_out_rms, held_out_percent, p_held_out = held_out
    return {
        "model": full.problem.model.name,
        "parameters": int(statistics["parameters"]),
        "fit_percent": statistics["fit_percent"],
        "rms": statistics["rms"],
        "AICc": statistics["aicc"],
        "BIC": statistics["bic"],
        "held_out_rms": held_out_rms,
        "held_out_percent": held_out_percent,
        "p_held_out": p_held_out,
        "p_white": statistics["p_white"],
        "p_input": statistics["p_input"],
        "remark": "; ".join(full.warnings),
        "determined": not full.findings,
        "refused": refused,
    }


def overdamped(fits: Mapping[str, Fit]) -> list[str]:
    """Models with a pair of poles (U) that are real, where two lags fit no worse.

    The data determine the two lags, or do not determine the pair either.

    Parameters
    ----------
    fits
        Fits by the name of the model.

    Returns
    -------
    list of str
        Names of those models.
    """
    names = []
    for name, result in fits.items():
        two_lags = fits.get(name.replace("U", ""))
        if result.identified.theta.get("Zeta", 0.0) < 1 or two_lags is None:
            continue
        if result.findings or not two_lags.findings:
            names.append(name)
    return names


def joint_table(comparisons: Mapping[str, Comparison]) -> pd.DataFrame:
    """Return the recommended models of several outputs: a row for each output and input.

    Parameters
    ----------
    comparisons
        Comparison of each output.

    Returns
    -------
    DataFrame
        Model, gain, lag, scores and severity of the conclusion, as texts.
    """
    rows = []
    for output, comparison in comparisons.items():
        best = comparison.best.identified
        for name, model in best.by_input.items():
            has_lag = model.gain and not best.model.integrators
            rows.append(
                {
                    "output": output,
                    "input": name,
                    "model": model.model.name,
                    "gain": f"{model.gain:.4g}",
                    "lag": model.lag_s.text("s") if has_lag else "",
                    "fit [%]": f"{comparison.best_row['fit_percent']:.2f}",
                    "held out [%]": f"{comparison.best_row['held_out_percent']:.2f}",
                    "grade": comparison.conclusion.severity.name.lower(),
                }
            )
    return pd.DataFrame(rows)
