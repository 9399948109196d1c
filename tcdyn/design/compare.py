"""The comparison people want before a campaign: plunges, touches, loading, unloading, and plunges with unloading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import pandas as pd

from calibration.disk import DiskSetup
from tcdyn.design.plunge_plan import PlungePlan, predict_plunges
from tcdyn.design.prediction import Prediction, combined, table, verdict
from tcdyn.design.step_plan import StepPlan, predict_step
from tcdyn.design.touch_plan import TouchPlan, predict_touches


@dataclass(frozen=True)
class Design:
    """Predictions of several planned tests side by side, and one sentence each."""

    predictions: tuple[Prediction, ...]
    lag_s: float

    def table(self) -> pd.DataFrame:
        """One row a test."""
        return table(self.predictions)

    def sentences(self) -> tuple[str, ...]:
        """One sentence a test, then the advice."""
        best = min(self.predictions, key=lambda p: p.u_common_s)
        alike = min(self.predictions, key=lambda p: p.u_differential_s)
        advice = (
            f"The common lag is told best by: {best.name} (+- {best.u_common_s:.3f} s); the differences by: "
            f"{alike.name} (+- {alike.u_differential_s:.3f} s)."
        )
        return (*(verdict(p, self.lag_s) for p in self.predictions), advice)


def compare_tests(
    setup: DiskSetup,
    plunges: Sequence[PlungePlan],
    *,
    step: StepPlan | None = None,
    touch: TouchPlan | None = None,
    lag_s: float = 0.73,
    draws: int = 24,
) -> Design:
    """Predict the planned plunges singly and together, a touch, a loading, an unloading, and plunges with unloading.

    ``lag_s`` is the whole lag expected, conditioning included. Noise and rate of touch and steps are the plunges'.
    """
    own = max(lag_s - setup.conditioning.lag_s, 0.01)
    first = plunges[0]
    step = step or StepPlan(rate_Hz=first.rate_Hz, noise_K=first.noise_K)
    touch = touch or TouchPlan(rate_Hz=first.rate_Hz, noise_K=first.noise_K)
    out = [predict_plunges([p], setup, lag_s=own, draws=draws) for p in plunges]
    if len(plunges) > 1:
        out.append(predict_plunges(plunges, setup, lag_s=own, draws=draws))
    together = out[-1]
    unloading = predict_step(replace(step, kind="unloading"), setup, lag_s=own)
    out += [
        predict_touches(touch, setup, lag_s=own),
        predict_step(replace(step, kind="loading"), setup, lag_s=own),
        unloading,
        combined("plunges and unloading", [together, unloading]),
    ]
    return Design(tuple(out), lag_s)
