"""Oven calibration of the synthetic rig's channels against a platinum resistance thermometer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.simulate.measure import logged
from tcdyn.simulate.truth import RigTruth, draw_truth, rng_for

SETPOINTS_degC = tuple(range(20, 161, 20))


def simulate_oven(
    disk: str = "fast",
    seed: int = 0,
    truth: RigTruth | None = None,
    setpoints_degC: Sequence[float] = SETPOINTS_degC,
    repeats: int = 3,
    minutes: int = 6,
    prt_limit_K: float = 0.1,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Hold one disk at each setpoint, in ``repeats`` runs, and write a row for each steady minute.

    The PRT is wrong by up to ``prt_limit_K`` at each hold (uniform, the same for the minutes of that hold); the
    channels' rows are means of one second. Returns the log (canonical oven columns) and its truth: gain,
    offset_degC per channel with T = gain * logged + offset, ``prt_error_K`` per hold and ``"traces"``, the true
    temperature of each row.
    """
    rig = truth or draw_truth(seed)
    how = rig.imperfections
    own = rig.disk(disk)
    rng = rng_for(seed, "oven", disk)
    rows, errors = [], []
    for repeat in range(1, repeats + 1):
        for setpoint in setpoints_degC:
            level = setpoint + rng.normal(0, 0.5)
            error = float(rng.uniform(-prt_limit_K, prt_limit_K)) if how.static else 0.0
            errors.append(error)
            wander = 0.03 * np.cumsum(rng.standard_normal(minutes)) if how.drift else np.zeros(minutes)
            for minute in range(minutes):
                true = level + wander[minute]
                rows.append((repeat, float(setpoint), true + error + 0.005 * rng.standard_normal() * how.noise, true))
    table = np.array(rows)
    names = sorted(own.channels)
    read = logged(np.repeat(table[:, 3:], len(names), axis=1), own, rng, how, spikes=False, averaged=75)
    frame = pd.DataFrame(table[:, :3], columns=["repeat", "setpoint_degC", "prt_degC"])
    frame["repeat"] = frame["repeat"].astype(int)
    for k, channel in enumerate(names):
        frame[f"{channel}_degC"] = read[:, k]
    truth_out = {
        "disk": disk,
        "gain": {c: own.channels[c].gain if how.static else 1.0 for c in names},
        "offset_degC": {c: own.channels[c].offset_degC if how.static else 0.0 for c in names},
        "prt_error_K": errors,
        "traces": pd.DataFrame({"repeat": frame["repeat"], "true_degC": table[:, 3]}),
    }
    return frame, truth_out
