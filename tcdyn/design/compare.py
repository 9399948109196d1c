"""Comparison of planned tests (plunges, touches, loading, unloading), with a recommendation.

``tcdyn rig design`` calls ``compare_tests``. Grades and effort are conventions; they decide the
wording, not the numbers. Guarded by ``tests/immersion/test_design_predictions.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from immersion.plunge_parameters import PlungePriors
from tcdyn.core.errors import InputError
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.design.plans import (
    PlungePlan,
    StepPlan,
    TouchPlan,
    predict_plunges,
    predict_step,
    predict_touches,
)
from tcdyn.design.prediction import PredictedTest, combine_tests
from tcdyn.rig.disk import DiskSetup
from tcdyn.rig.rigfile import UncertaintyTable

# Least lag of the chain without conditioning [s]; chosen by judgement.
MIN_CHAIN_LAG_S = 0.01
# Standard uncertainty of the common lag over the lag: below the first limit the lag is determined
# well, below the second roughly; chosen by judgement.
COMMON_LAG_LIMITS = (0.05, 0.15)
# The same of the differences between channels; chosen by judgement.
DIFFERENCE_LIMITS = (0.03, 0.10)
# Grades below the first limit, below the second, and above; and their definition for readers.
GRADES = ("well", "roughly", "poorly")
GRADE_DEFINITIONS = (
    f"Well: the standard uncertainty is below {100 * COMMON_LAG_LIMITS[0]:.0f} % of the lag "
    f"for the common lag, {100 * DIFFERENCE_LIMITS[0]:.0f} % for the differences; roughly: below "
    f"{100 * COMMON_LAG_LIMITS[1]:.0f} % and {100 * DIFFERENCE_LIMITS[1]:.0f} %; poorly: more."
)
# Effort of each kind of test, as a rank; an EHL test has both steps of load without any effort.
EFFORT = {"unloading": 0, "loading": 0, "plunge": 1, "touch": 2, "together": 3}


def grade(u_s: float, lag_s: float, limits: tuple[float, float]) -> str:
    """Grade how well a planned test determines a lag, by its standard uncertainty over the lag.

    Parameters
    ----------
    u_s
        Expected standard uncertainty of the common lag, or of the differences of lags [s].
    lag_s
        Expected lag [s].
    limits
        Relative limits of "well" and "roughly".

    Returns
    -------
    str
        "well", "roughly" or "poorly". ``tests/immersion/test_design_predictions.py`` guards it.

    Examples
    --------
    >>> [grade(u_s, 0.73, COMMON_LAG_LIMITS) for u_s in (0.03, 0.06, 0.2)]
    ['well', 'roughly', 'poorly']
    """
    return GRADES[sum(u_s >= limit * lag_s for limit in limits)]


def common_lag_grade(predicted: PredictedTest, lag_s: float) -> str:
    """Grade of the lag that all channels share, relative to ``lag_s`` [s]."""
    return grade(predicted.u_common_s, lag_s, COMMON_LAG_LIMITS)


def differences_grade(predicted: PredictedTest, lag_s: float) -> str:
    """Grade of the differences between the channels' lags, relative to ``lag_s`` [s]."""
    return grade(predicted.u_differential_s, lag_s, DIFFERENCE_LIMITS)


def sentence(predicted: PredictedTest, lag_s: float) -> str:
    """One sentence: how well the test determines the common lag and the differences.

    Parameters
    ----------
    predicted
        The prediction.
    lag_s
        Expected lag [s].
    """
    return (
        f"{predicted.name}: tells the common lag {common_lag_grade(predicted, lag_s)}, to "
        f"{_u_text(predicted.u_common_s, lag_s)}, and the differences "
        f"between channels {differences_grade(predicted, lag_s)}, to "
        f"{_u_text(predicted.u_differential_s, lag_s)}."
    )


def recommendation(predictions: Sequence[PredictedTest], lag_s: float) -> str:
    """Recommend the least laborious test that determines common lag and differences well.

    If there is none, the text names the best test and what it lacks.

    Parameters
    ----------
    predictions
        The predictions.
    lag_s
        Expected lag [s].

    Notes
    -----
    Tests are ordered by ``EFFORT``, then by the number of plunges, then by the uncertainty of the
    common lag.
    """
    sufficient = [
        p
        for p in predictions
        if common_lag_grade(p, lag_s) == differences_grade(p, lag_s) == "well"
    ]
    if not sufficient:
        best = min(predictions, key=lambda p: p.u_common_s + p.u_differential_s)
        return (
            f"No test of this plan tells the lags well. The best, {best.name}, leaves the common "
            f"lag at {_u_text(best.u_common_s, lag_s)} and the differences at "
            f"{_u_text(best.u_differential_s, lag_s)}: plan more plunges, less noise or more power "
            "before the unloading."
        )
    recommended = min(
        sufficient, key=lambda p: (EFFORT.get(p.kind, 2), p.name.count(","), p.u_common_s)
    )
    uncertainties = (
        f"the common lag to {_u_text(recommended.u_common_s, lag_s)} and the differences "
        f"between channels to {_u_text(recommended.u_differential_s, lag_s)}."
    )
    if recommended.kind != "together":
        return f"Do this: {recommended.name}. It tells {uncertainties}"
    plunges = [p.name for p in predictions if p.kind == "plunge"][-1:]
    return (
        f"Do this: {plunges[0] if plunges else 'the plunges'}, and log an unloading. Together "
        f"they tell {uncertainties}" + _why_both(predictions, lag_s)
    )


def _why_both(predictions: Sequence[PredictedTest], lag_s: float) -> str:
    """Why both tests are needed: what the best test of each kind leaves uncertain.

    Parameters
    ----------
    predictions
        The predictions.
    lag_s
        Expected lag [s].
    """
    reasons = []
    for kind, word in (("plunge", "plunges"), ("unloading", "an unloading")):
        candidates = [p for p in predictions if p.kind == kind]
        if candidates:
            p = min(candidates, key=lambda q: q.u_common_s)
            weak = common_lag_grade(p, lag_s) != "well"
            u, what = (p.u_common_s, "common lag") if weak else (p.u_differential_s, "differences")
            reasons.append(
                f"{word} alone leave{'s' if kind == 'unloading' else ''} the {what} at "
                f"{_u_text(u, lag_s)}"
            )
    return f" Less is not enough: {', '.join(reasons)}." if reasons else ""


def _u_text(u_s: float, lag_s: float) -> str:
    """A standard uncertainty in seconds and in percent of the lag.

    Parameters
    ----------
    u_s
        Standard uncertainty [s].
    lag_s
        Lag [s].

    Examples
    --------
    >>> _u_text(0.0181, 0.73)
    '+- 0.018 s (2.5 % of the lag)'
    """
    return f"+- {u_s:.3f} s ({100 * u_s / lag_s:.2g} % of the lag)"


@dataclass(frozen=True, repr=False)
class Design(Result):
    """Predictions of several planned tests.

    Parameters
    ----------
    predictions
        The predictions.
    lag_s
        Expected lag, conditioning included [s].
    """

    predictions: tuple[PredictedTest, ...]
    lag_s: float

    def table(self) -> pd.DataFrame:
        """One row a test."""
        return pd.DataFrame([p.row() for p in self.predictions])

    def sentences(self) -> tuple[str, ...]:
        """One sentence a test, then the recommendation.

        Returns
        -------
        The sentences.
        """
        return (
            *(sentence(p, self.lag_s) for p in self.predictions),
            recommendation(self.predictions, self.lag_s),
        )

    def summary(self) -> str:
        """The recommendation, the standard uncertainties to expect, and what the grades mean."""
        table = (
            self.grade_table()
            .drop(columns=["10 to 90 % of bursts [s]", "of the lag", "of the lag "])
            .to_string(index=False)
        )
        return "\n".join(
            [recommendation(self.predictions, self.lag_s), "", table, "", GRADE_DEFINITIONS]
        )

    def grade_table(self) -> pd.DataFrame:
        """Table with one row a test, as text.

        Expected standard uncertainties in seconds and percent of the lag, and their grades.
        """
        lag = self.lag_s
        return pd.DataFrame(
            {
                "test": p.name,
                "common lag, u [s]": f"{p.u_common_s:.3f}",
                "10 to 90 % of bursts [s]": f"{p.low_s:.3f} to {p.high_s:.3f}"
                if p.high_s > p.low_s
                else "",
                "of the lag": f"{100 * p.u_common_s / lag:.2g} %",
                "determined": common_lag_grade(p, lag),
                "differences, u [s]": f"{p.u_differential_s:.3f}",
                "of the lag ": f"{100 * p.u_differential_s / lag:.2g} %",
                "determined ": differences_grade(p, lag),
            }
            for p in self.predictions
        )

    def to_dict(self) -> dict[str, Any]:
        """The table and the sentences; numbers that a test does not have are left out."""
        rows = [{k: v for k, v in row.items() if v is not None} for row in jsonable(self.table())]
        return {"tests": rows, "sentences": list(self.sentences())}

    def to_frame(self) -> pd.DataFrame:
        """The table by test."""
        return self.table().set_index("test")

    def card(self) -> pd.DataFrame:
        """Table of the standard uncertainties of the common lag and of the differences [s]."""
        return self.table()[["test", "u_common_s", "u_differential_s"]]


@one_blas_thread
def compare_tests(
    setup: DiskSetup,
    plunges: Sequence[PlungePlan],
    *,
    step: StepPlan | None = None,
    touch: TouchPlan | None = None,
    uncertainty: UncertaintyTable | None = None,
    lag_s: float = 0.73,
    draws: int = 24,
) -> Design:
    """Predict plunges singly and together, a touch, both load steps, and plunges with an unloading.

    Parameters
    ----------
    setup
        The disk.
    plunges
        The planned plunges.
    step, touch
        Planned load step and touch. By default with the rate and noise of the first plunge.
    uncertainty
        The rig's ``uncertainty`` table, for depths and conductivity; its defaults if None.
    lag_s
        Expected total lag, conditioning included [s].
    draws
        Number of Monte Carlo samples of the unknown conditions.

    Raises
    ------
    InputError
        For a lag below that of the conditioning.

    Notes
    -----
    Priors of depths and conductivity are the same in all tests, those of the rig. They replace the
    values in ``step`` and ``touch``.
    """
    conditioning_lag_s = setup.conditioning.lag_s
    chain_lag_s = lag_s - conditioning_lag_s
    if chain_lag_s < MIN_CHAIN_LAG_S:
        raise InputError(
            f"an expected lag of {lag_s:g} s, conditioning included",
            where="design",
            expected=f"at least {conditioning_lag_s + MIN_CHAIN_LAG_S:.3g} s, since the "
            f"conditioning alone lags by {conditioning_lag_s:.3g} s",
        )
    first = plunges[0]
    priors = PlungePriors.for_rig(uncertainty or UncertaintyTable.model_validate({}))
    logging: dict[str, Any] = {"rate_Hz": first.rate_Hz, "noise_K": first.noise_K}
    prior_u: dict[str, Any] = {
        "depth_u_m": priors.depth_m,
        "conductivity_log_u": priors.conductivity_log,
    }
    step = replace(step or StepPlan(**logging), **prior_u)
    touch = replace(touch or TouchPlan(**logging), **prior_u)
    predictions = [
        predict_plunges([p], setup, lag_s=chain_lag_s, priors=priors, draws=draws) for p in plunges
    ]
    if len(plunges) > 1:
        predictions.append(
            predict_plunges(plunges, setup, lag_s=chain_lag_s, priors=priors, draws=draws)
        )
    all_plunges = predictions[-1]
    unloading = predict_step(replace(step, kind="unloading"), setup, lag_s=chain_lag_s)
    predictions += [
        predict_touches(touch, setup, lag_s=chain_lag_s),
        predict_step(replace(step, kind="loading"), setup, lag_s=chain_lag_s),
        unloading,
        combine_tests("plunges and unloading", [all_plunges, unloading]),
    ]
    return Design(tuple(predictions), lag_s)
