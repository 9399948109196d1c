"""Models compared on one record: AICc, BIC and held-out simulation error in one table, and all their fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import pandas as pd

from tcdyn.chain import NO_CONDITIONING
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, Severity, info
from tcdyn.core.result import Result, jsonable
from tcdyn.core.spelling import Spelling, as_argument
from tcdyn.core.threads import one_blas_thread
from tcdyn.identify.closed_loop import check_closed_loop, closed_loop
from tcdyn.identify.fit import fit, noted
from tcdyn.identify.forward_selection import Entry, Way, listed, not_worse, off_equilibrium
from tcdyn.identify.heldout import QUICK, Progress, Task
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import Model, process
from tcdyn.identify.recommendation import (
    COLUMNS,
    answers_at_once,
    as_chain,
    order_table,
    recommend,
    verdict,
)
from tcdyn.identify.search import Fit
from tcdyn.identify.shared_poles import rival
from tcdyn.identify.validate import Validation, clean, coloured, validate
from tcdyn.rig.disk import Conditioning

CANDIDATES = ("P1", "P1D", "P2", "P2D", "P2Z", "P2DZ", "P2U", "P2DU", "P3", "P3D")
OFFERED = (
    *CANDIDATES,
    "P1I",
    "P1DI",
)  # by the advice, where none of the models compared is good enough
WORSE = 1.2  # times the held-out error, from which a disturbance in the fit has taken dynamics for noise


@dataclass(frozen=True)
class Comparison(Result):
    """``table`` one row a model, best BIC first; ``fits`` on all data by name; ``recommended`` with its ``reason``;
    ``grown``: its models are the way of a search that grew, and none is left to be tried."""

    table: pd.DataFrame
    fits: Mapping[str, Fit]
    recommended: str
    reason: Finding
    grown: bool = False

    @property
    def why(self) -> str:
        """The reason in words."""
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
        """Which model to use and why, or that none will do; the recommended model; the order table.

        ``spelling``: of the parameters that the advice and the findings name.
        """
        advice = self.verdict.message(spelling)
        best = replace(self.best.identified, sentence=self.validation.message(spelling))
        table = order_table(self.table, best.output_unit).to_string(index=False)
        return "\n".join([advice, "", best.summary(spelling), "", table, "", COLUMNS])

    @cached_property
    def validation(self) -> Validation:
        """What the residuals of the recommended model say."""
        return validate(self.best)

    @property
    def verdict(self) -> Finding:
        """Which model to use and why, or that none of them is good enough and what to try."""
        untried = [
            name for name in OFFERED if name not in set(self.table["model"]) and not self.grown
        ]
        troubles = [f.code for f in self.best.findings if f.code == "record.closed_loop"]
        if not troubles and answers_at_once(self.best):
            troubles = ["model.at_once"]
        troubles += [
            code
            for code in self.validation.troubles
            if not (troubles and code == "record.feedback")
        ]
        return verdict(self.table, self.recommended, self.reason, untried, troubles)

    def removal(self, conditioning: Conditioning = NO_CONDITIONING) -> str:
        """How to remove the lag from other traces (:func:`as_chain`); nothing where no model may be trusted."""
        refused = self.verdict.severity is Severity.ERROR
        return "" if refused else as_chain(self.best.identified, conditioning)

    @property
    def advice(self) -> str:
        """The verdict in words."""
        return self.verdict.sentence

    def to_dict(self) -> dict[str, Any]:
        """The recommended model as its file holds it, why, and the order table."""
        table = jsonable(self.table)
        return {
            **self.best.to_dict(),
            "recommended": self.recommended,
            "why": self.why,
            "comparison": table,
        }

    def card(self) -> pd.DataFrame:
        """The order table, remarks left out."""
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
    """Fit every model to all of ``data`` and score it on data it has not seen.

    ``models``, or one list of them, are models to be fitted by name or value, or those that are (a :class:`Fit`, an
    :class:`Identified`, also of :func:`tcdyn.identify.from_control`), which are compared as they stand but for their
    offset; two of one name are numbered. Without any they are the way of a search that grows from one lag on
    (:func:`tcdyn.identify.forward_selection.grown`), each with the known part, the offset and the fixed gain of
    ``like``; of
    several inputs it finds those that matter.
    ``held_out`` is another IOData, or the last share of the record (of several runs: the last run). Held-out
    scores come from a second fit to the rest. ``options``, no ``start``, go to :func:`fit`; without ``initial`` the
    runs begin in equilibrium, unless the recommended fit tells that one does not and all models fit better, by BIC,
    with their initial states estimated. Without ``noise`` and ``baseline`` the noise is white, unless the residuals of
    the recommended fit are coloured and not by the input: then the data choose both, for all models alike. How the
    recommendation is made: :func:`recommend`. ``progress`` is told each model before it is fitted.
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
    found = compared(task, listed(task, entries, like))
    at_once = "record.off_equilibrium" in found.validation.troubles
    if "initial" not in options and (at_once or off_equilibrium(data, found.best, options)):
        with_state = task.but("initial state estimated", initial="estimated")
        freed = compared(with_state, listed(with_state, entries, like))
        if freed.table["BIC"].min() < found.table["BIC"].min():
            why = replace(freed.reason, numbers={**freed.reason.numbers, "freed": True})
            found = replace(freed, reason=why)
            task = replace(task, options=with_state.options)
    found = with_disturbance(task, found)
    return with_rival(task, found, like) if found.grown else found


def with_rival(task: Task, found: Comparison, like: Model) -> Comparison:
    """``found``, or where the residuals of its best model are coloured or follow the input, and a transfer function
    whose inputs share their poles foresees better, that one beside the others (:func:`rival`)."""
    best = found.best
    row = found.best_row
    options = task.options
    if clean(best) or options.get("loss", "linear") != "linear":
        return found
    task.progress("common poles", len(found.table) + 1, len(found.table) + 1)
    better = rival(task, best, row["held_out_rms"], like)
    if better is None:
        return found
    other = better[0].problem.model
    if other.name in found.fits:
        other = replace(other, name=f"{other.name}, 2")
    same = {**options, "initial": better[0].problem.initial}
    alone = compared(replace(task, options=same), [(other, better[0].identified.theta, False)])
    table = pd.concat([alone.table, found.table], ignore_index=True)
    freed = found.reason.numbers.get("freed", False) or same["initial"] != options.get(
        "initial", "equilibrium"
    )
    told: dict[str, Any] = {"other": found.recommended, "ratio": better[1], "freed": freed}
    reason = info("models.foresees", subject=other.name, white=not coloured(alone.best), **told)
    return Comparison(table, {**alone.fits, **found.fits}, other.name, reason, grown=True)


def with_disturbance(task: Task, found: Comparison) -> Comparison:
    """``found``, or the comparison anew with the noise and the baseline that the residuals of its best model ask for.

    Only where they are coloured and, but for a drift, do not follow the input. Where the disturbance is modelled all
    models get the same, and where that costs held-out error none.
    """
    best = found.best
    options = task.options
    if (
        {"noise", "baseline"} & set(options)
        or options.get("loss", "linear") != "linear"
        or not coloured(best)
    ):
        return found
    asked = {**options, **QUICK, "noise": "auto", "baseline": "auto"}
    if found.grown:
        asked["start"] = best.identified.theta
    given = fit(task.data, best.problem.model, **asked).disturbance
    if given == best.disturbance:
        return found

    way = [
        (f.problem.model, f.identified.theta if found.grown else None, False)
        for f in found.fits.values()
    ]
    anew = compared(task.but("disturbance modelled", **given), way)
    worse = anew.best_row["held_out_rms"] > WORSE * found.best_row["held_out_rms"]
    if worse or anew.table["BIC"].min() >= found.table["BIC"].min():
        return found
    anew = replace(anew, grown=found.grown)
    noise = anew.best.noise
    told: dict[str, Any] = {"order": list(noise.order), "baseline": given["baseline"]}
    told["freed"] = found.reason.numbers.get("freed", False)
    if noise.averaged:
        told["memory_s"] = (
            noise.memory * task.data.dt_s if noise.memory < len(anew.best.residual) else None
        )
        told["p_walk"] = anew.best.identified.statistics["p_walk"]
    return replace(anew, reason=replace(anew.reason, numbers={**anew.reason.numbers, **told}))


def compared(task: Task, models: Way) -> Comparison:
    """:func:`compare` with the fit's options as they are."""
    rows: list[dict[str, Any]] = []
    fits: dict[str, Fit] = {}
    first: InputError | None = None
    noticed = task.data.findings
    data = replace(task.data, findings=())
    options = task.options
    for number, (model, start, refused) in enumerate(models, 1):
        task.progress(model.name, number, len(models))
        try:
            first_to_check = {} if not fits or start is None else {"check": False}
            whole = fit(data, model, **{**options, "start": start, **first_to_check})
            whole = whole if start is not None else not_worse(whole, fits, data, options)
            rms, percent, p_held_out = task.unseen(whole, start=start)
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
                "p_held_out": p_held_out,
                "p_white": s["p_white"],
                "p_input": s["p_input"],
                "remark": "; ".join(whole.warnings),
                "determined": not whole.findings,
                "refused": refused,
            }
        )
    if not fits:
        raise first or InputError(
            "no model to compare", expected=f"names such as {', '.join(CANDIDATES)}"
        )
    table = pd.DataFrame(rows).sort_values(
        "BIC", key=lambda b: b.round(6), kind="stable", ignore_index=True
    )
    chosen = recommend(table, overdamped(fits))
    fits = {name: noted(found, noticed) for name, found in fits.items()}
    return Comparison(table, fits, *chosen, grown=any(refused for *_, refused in models))


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


def joint_table(comparisons: Mapping[str, Comparison]) -> pd.DataFrame:
    """The recommended model of each output, its lags and what is to be said of it: one row an output and input."""
    rows = []
    for output, c in comparisons.items():
        for name, part in c.best.identified.parts.items():
            lag = (
                "" if c.best.identified.model.integrators or not part.gain else part.lag_s.text("s")
            )
            fits = {
                f"{what} [%]": f"{c.best_row[f'{key}_percent']:.2f}"
                for what, key in (("fit", "fit"), ("held out", "held_out"))
            }
            rows.append(
                {
                    "output": output,
                    "input": name,
                    "model": part.model.name,
                    "gain": f"{part.gain:.4g}",
                    "lag": lag,
                    **fits,
                    "grade": c.verdict.severity.name.lower(),
                }
            )
    return pd.DataFrame(rows)
