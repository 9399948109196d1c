"""The comparison people want before a campaign: plunges, touches, loading, unloading, and plunges with unloading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from calibration.disk import DiskSetup
from calibration.errors import InputError
from calibration.result import Result, jsonable
from calibration.rig import UncertaintyTable
from tcdyn.design.advice import MEANING, common, differences, headline, sentence
from tcdyn.design.plunge_plan import PlungePlan, predict_plunges
from tcdyn.design.prediction import Prediction, combined, table
from tcdyn.design.step_plan import StepPlan, predict_step
from tcdyn.design.touch_plan import TouchPlan, predict_touches
from tcdyn.plunge.parameters import PlungePriors

LEAST_OWN_LAG_S = 0.01


@dataclass(frozen=True)
class Design(Result):
    """Predictions of several planned tests side by side, and one sentence each."""

    predictions: tuple[Prediction, ...]
    lag_s: float

    def table(self) -> pd.DataFrame:
        """One row a test."""
        return table(self.predictions)

    def sentences(self) -> tuple[str, ...]:
        """One sentence a test, then what to do."""
        return (*(sentence(p, self.lag_s) for p in self.predictions), headline(self.predictions, self.lag_s))

    def summary(self) -> str:
        """What to do, every test with the standard uncertainties to expect, and what the grades mean."""
        rows = [
            {
                "test": p.name,
                "common lag [s]": f"{p.u_common_s:.3f} {common(p, self.lag_s)}",
                "differences [s]": f"{p.u_differential_s:.3f} {differences(p, self.lag_s)}",
            }
            for p in self.predictions
        ]
        shown = pd.DataFrame(rows).to_string(index=False)
        return "\n".join([headline(self.predictions, self.lag_s), "", shown, "", MEANING])

    def to_dict(self) -> dict[str, Any]:
        """The table, numbers that a test does not have left out, and the sentences."""
        rows = [{k: v for k, v in row.items() if v is not None} for row in jsonable(self.table())]
        return {"tests": rows, "sentences": list(self.sentences())}

    def card(self) -> pd.DataFrame:
        """Test, and what it will tell of the common lag and of the differences [s]."""
        return self.table()[["test", "u_common_s", "u_differential_s"]]


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
    """Predict the planned plunges singly and together, a touch, a loading, an unloading, and plunges with unloading.

    ``lag_s`` is the whole lag expected, conditioning included. Noise and rate of touch and steps are the plunges'
    where none are given; depths and conductivity of all tests are as uncertain as the rig's ``uncertainty`` table
    says, or its defaults. Raises InputError for a lag that the conditioning alone exceeds.
    """
    known = setup.conditioning.lag_s
    own = lag_s - known
    if own < LEAST_OWN_LAG_S:
        raise InputError(
            f"an expected lag of {lag_s:g} s, conditioning included",
            where="design",
            expected=f"at least {known + LEAST_OWN_LAG_S:.3g} s, since the conditioning alone lags by {known:.3g} s",
        )
    first = plunges[0]
    priors = PlungePriors.for_rig(uncertainty or UncertaintyTable.model_validate({}))
    depth, steel = priors.depth_m, priors.conductivity_log
    step = step or StepPlan(rate_Hz=first.rate_Hz, noise_K=first.noise_K)
    step = replace(step, depth_u_m=depth, conductivity_log_u=steel)
    touch = touch or TouchPlan(rate_Hz=first.rate_Hz, noise_K=first.noise_K)
    touch = replace(touch, depth_u_m=depth, conductivity_log_u=steel)
    out = [predict_plunges([p], setup, lag_s=own, priors=priors, draws=draws) for p in plunges]
    if len(plunges) > 1:
        out.append(predict_plunges(plunges, setup, lag_s=own, priors=priors, draws=draws))
    together = out[-1]
    unloading = predict_step(replace(step, kind="unloading"), setup, lag_s=own)
    out += [
        predict_touches(touch, setup, lag_s=own),
        predict_step(replace(step, kind="loading"), setup, lag_s=own),
        unloading,
        combined("plunges and unloading", [together, unloading]),
    ]
    return Design(tuple(out), lag_s)
