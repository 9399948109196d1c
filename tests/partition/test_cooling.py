"""Linear sensitivity of the cooling fit to a model error, against a second fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tcdyn.partition.cooling import compensate_disk, cooling_fit, smooth_traces
from tcdyn.partition.steady import SteadyLine, steady_lines
from tcdyn.partition.window import fit_rows
from tests.partition.study_rigs import QUICK, study_rig


@dataclass(frozen=True)
class Lumped:
    """A window whose rim is three lumped masses that cool as exp(-rate h t) from a level
    proportional to the share."""

    block_time_s: np.ndarray
    counts: np.ndarray
    y: np.ndarray
    disk: str = "fast"
    used_channels: tuple[bool, bool, bool] = (True, True, True)

    @property
    def rim(self) -> Lumped:
        return self

    def response(self, h: float) -> tuple[Any, np.ndarray]:
        after = np.maximum(self.block_time_s, 0.0)[:, None]
        power = 40.0 * np.exp(-after * h * np.array([2e-4, 3e-4, 5e-4]))
        return np.zeros_like(power), power


def test_h_per_effect_matches_the_change_of_a_second_fit() -> None:
    """Single samples to 3 s, then blocks of eight: the sensitivity must use the weights of the
    fit."""
    t = np.concatenate([np.arange(-12, 0, 1.0), np.arange(0, 3, 1 / 75), np.arange(3, 8, 8 / 75)])
    counts = np.where(t < 0, 75, np.where(t < 3, 1, 8))
    line = SteadyLine(0.2, 7e-4)
    window = Lumped(t, counts, np.zeros((len(t), 3)))
    data = replace(window, y=line.at(700.0) * window.rim.response(700.0)[1])
    # grows with time, where the blocks are long
    effect = 0.02 * np.maximum(t, 0.0)[:, None] * np.array([1.0, 2.0, 0.5])
    fit = cooling_fit(data, line, 0.0, 7.0, 0.1)  # type: ignore[arg-type]
    refit = cooling_fit(replace(data, y=data.y - effect), line, 0.0, 7.0, 0.1)  # type: ignore[arg-type]
    assert fit.h_W_m2K == pytest.approx(700.0, rel=1e-5)  # tolerance of the search
    # tolerance: curvature over a step of 0.5 % of h; without the weights the error is 25 %
    assert (fit.h_per_effect * effect).sum() == pytest.approx(
        refit.h_W_m2K - fit.h_W_m2K, rel=0.005
    )


@pytest.mark.study
def test_unloading_of_1_5_s_does_not_bias_the_cooling_fit() -> None:
    """Figure 4.20: as one slope change in its middle, such a ramp shifts h by a fifth and the share
    by 0.05."""
    study = study_rig(1, uncertain=False, lag_error_s=0.0, options=replace(QUICK, parting_s=1.5))
    test = study.test
    rows = fit_rows(test, 5.0)
    lines, _ = steady_lines(test, rows)
    disk = test.disks["fast"]
    window = compensate_disk(
        test, disk, rows, smooth_traces(test, disk, rows, disk.chains, 0.01)
    ).window
    fit = cooling_fit(window, lines["fast"].line, test.events.unload_s, 5.0, 0.03)
    # the standard uncertainty of h in the budget
    assert fit.h_W_m2K == pytest.approx(study.true_values["h_fast"], rel=0.05)
