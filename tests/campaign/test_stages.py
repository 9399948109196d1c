"""Several loadings in one log are several tests, each with the result of a log of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tcdyn.campaign import solve_campaign
from tcdyn.campaign.stages import loading_events, split_stages, stage_of
from tcdyn.core.errors import InputError
from tcdyn.partition.joint import joint_fits
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.steady import steady_lines, with_inner_row_at_one_radius
from tcdyn.partition.window import fit_rows
from tcdyn.rig.log import Log
from tests.campaign.rigs import compressed_joint_fit
from tests.partition.study_rigs import StudyRig, study_rig


@pytest.fixture(scope="module")
def two_studies() -> tuple[StudyRig, StudyRig]:
    """Two tests of one rig."""
    first = study_rig(5, "D4")
    return first, study_rig(5, "D2", truth=first.truth)


@pytest.fixture(scope="module")
def joined_log(two_studies: tuple[StudyRig, StudyRig]) -> Log:
    """Both logs, one after the other, in one file."""
    first, second = (study.log.frame for study in two_studies)
    later = second.assign(time_s=second["time_s"] + first["time_s"].iloc[-1] + 1 / 75)
    frame = pd.concat([first, later], ignore_index=True)
    return replace(two_studies[0].log, frame=frame)


@pytest.mark.study
def test_loadings_are_found_in_order(
    two_studies: tuple[StudyRig, StudyRig], joined_log: Log
) -> None:
    length = float(two_studies[0].log.frame["time_s"].iloc[-1]) + 1 / 75
    expected = [
        (study.true_values["load_on_s"] + k * length, study.true_values["unload_s"] + k * length)
        for k, study in enumerate(two_studies)
    ]
    # tolerance: loading takes 0.3 s
    assert np.array(
        [(e.load_on_s, e.unload_s) for e in loading_events(joined_log.frame)]
    ) == pytest.approx(np.array(expected), abs=0.3)
    first, second = split_stages(joined_log)
    assert (first.path.stem, second.path.stem) == ("EHL_D4.1", "EHL_D4.2")
    assert first.frame["time_s"].iloc[-1] < expected[1][0]
    assert second.frame["time_s"].iloc[0] > expected[0][1]


@pytest.mark.e2e
def test_log_with_one_loading_keeps_its_name(two_studies: tuple[StudyRig, StudyRig]) -> None:
    assert split_stages(two_studies[0].log) == (two_studies[0].log,)
    assert stage_of(two_studies[0].log, 1) == (two_studies[0].log, 1)
    with pytest.raises(InputError, match="no loading number 2"):
        stage_of(two_studies[0].log, 2)
    unloaded = replace(
        two_studies[0].log,
        frame=two_studies[0].log.frame.assign(contact=0.0, friction_N=0.0, load_N=0.0),
    )
    assert split_stages(unloaded) == (unloaded,)  # find_events reports what is missing


@pytest.mark.study
def test_stage_has_the_result_of_its_own_log(
    two_studies: tuple[StudyRig, StudyRig], joined_log: Log
) -> None:
    """Force zeros and noise level come from other segments: beta changes by a small part of its u
    of 0.004."""
    for study, stage in zip(two_studies, split_stages(joined_log)):
        estimates = []
        for log in (study.log, stage):
            prepared = with_inner_row_at_one_radius(prepare_test(log, study.rig, study.records))
            _, both = joint_fits(
                prepared, steady_lines(prepared, fit_rows(prepared, 10.0))[1].starts
            )
            estimates.append(both.estimates["beta"])
        assert abs(estimates[1].value - estimates[0].value) < 0.2 * estimates[0].u


@pytest.mark.study
def test_second_unloading_reduces_u_of_lag_and_h(
    two_studies: tuple[StudyRig, StudyRig], joined_log: Log
) -> None:
    tests = [
        compressed_joint_fit(stage.path.stem, prepare_test(stage, study.rig, study.records))[0]
        for study, stage in zip(two_studies, split_stages(joined_log))
    ]
    first_only = solve_campaign(tests[:1]).estimates[0]
    both = solve_campaign(tests).estimates[0]
    for key in ("beta", "h_fast", "h_slow", "lag_fast_s", "lag_slow_s"):
        assert both[key].u / both[key].value < first_only[key].u / first_only[key].value
    lags = {d: two_studies[0].truth.disk(d).common_lag_s for d in ("fast", "slow")}
    for d, expected in lags.items():
        assert abs(both[f"lag_{d}_s"].value - expected) < 4 * both[f"lag_{d}_s"].u
