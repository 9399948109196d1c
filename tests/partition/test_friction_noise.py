"""Noise of the logged friction: its effect on the fits, and no false change of h at the
unloading."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tcdyn.partition.analyse import analyse
from tcdyn.partition.nuisance import FRICTION_SEGMENTS_S, friction_noise_effects
from tcdyn.partition.window import fit_rows, lagged_window
from tests.partition.study_rigs import StudyRig, study_rig

NOISE_N = 0.5


def noisy(seed: int) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """A log with more noise of the friction: the heat is that of the friction without it."""

    def change(frame: pd.DataFrame) -> pd.DataFrame:
        noise_N = NOISE_N * np.random.default_rng(seed).standard_normal(len(frame))
        return frame.assign(friction_N=frame["friction_N"] + noise_N)

    return change


@pytest.fixture(scope="module")
def study() -> StudyRig:
    return study_rig(0, log_change=noisy(0))


def test_equal_errors_of_all_segments_are_an_error_of_the_friction(study: StudyRig) -> None:
    test = study.test
    disk = test.disks["fast"]
    window = lagged_window(test, disk, fit_rows(test, 10.0))
    _, change = friction_noise_effects(test, window, 0.7, 700.0)
    before_s = test.events.unload_s - window.time_s
    edges = [*FRICTION_SEGMENTS_S, np.inf]
    settled = (before_s > test.events.fall_time_s + 0.1) & (window.time_s >= test.events.load_on_s)
    counts = np.histogram(before_s[settled], edges)[0]
    counts = counts[counts > 0]
    assert len(change) == len(counts)
    total = np.tensordot(np.sqrt(counts), change, 1)
    power = window.rim.response(700.0)[1]
    expected = test.friction_noise_N / test.friction_N * 0.7 * power
    assert total[20:] == pytest.approx(expected[20:], abs=1e-3 * expected.max())


def test_a_friction_without_noise_has_no_such_parameters(study: StudyRig) -> None:
    test = replace(study.test, friction_noise_N=0.0)
    window = lagged_window(test, test.disks["slow"], fit_rows(test, 10.0))
    parameters, change = friction_noise_effects(test, window, 0.3, 250.0)
    assert parameters == ()
    assert len(change) == 0


@pytest.mark.e2e
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.long) for k in (2, 3))])
def test_noise_of_the_friction_is_no_change_of_h_at_the_unloading(seed: int) -> None:
    """Without its nuisance parameters, log-odds up to 17 for a change of h in sound tests."""
    study = study_rig(seed, "D4", log_change=noisy(seed))
    result = analyse(study.test)
    forms = result.model_forms
    h_step = next(form for form in forms.forms if form.name == "h_step")
    assert h_step.log_odds < 5.0
    assert forms.preferred is None
    assert result.combined.inflation < 1.6
    truth = study.true_values["beta"]
    assert (
        abs(result.combined.estimates["beta"].value - truth)
        < 3 * result.combined.estimates["beta"].u
    )
