"""Several loadings in one log are several tests, each as if it had been logged alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tcdyn.campaign import solve_campaign
from tcdyn.campaign.stages import loading_events, split_stages, stage_of
from tcdyn.core.errors import InputError
from tcdyn.partition.joint import joint_fits
from tcdyn.partition.steady import steady_lines, with_inner_row_at_one_radius
from tcdyn.partition.window import fit_rows
from tcdyn.rig.log import Log
from tcdyn.workflows.beta import prepare_test
from tests.campaign.rigs import kept_of
from tests.partition.study_rigs import StudyRig, study_rig


@pytest.fixture(scope="module")
def made() -> tuple[StudyRig, StudyRig]:
    """One rig, two tests."""
    one = study_rig(5, "D4")
    return one, study_rig(5, "D2", truth=one.truth)


@pytest.fixture(scope="module")
def joined_log(made: tuple[StudyRig, StudyRig]) -> Log:
    """Both logs, one behind the other, in one file."""
    one, other = (m.log.frame for m in made)
    later = other.assign(time_s=other["time_s"] + one["time_s"].iloc[-1] + 1 / 75)
    frame = pd.concat([one, later], ignore_index=True)
    return replace(made[0].log, frame=frame)


@pytest.mark.study
def test_each_loading_is_found_in_order(made: tuple[StudyRig, StudyRig], joined_log: Log) -> None:
    length = float(made[0].log.frame["time_s"].iloc[-1]) + 1 / 75
    wanted = [
        (m.told["load_on_s"] + k * length, m.told["unload_s"] + k * length)
        for k, m in enumerate(made)
    ]
    assert np.array(
        [(e.load_on_s, e.unload_s) for e in loading_events(joined_log.frame)]
    ) == pytest.approx(np.array(wanted), abs=0.3)  # loading takes 0.3 s
    first, second = split_stages(joined_log)
    assert (first.path.stem, second.path.stem) == ("EHL_D4.1", "EHL_D4.2")
    assert first.frame["time_s"].iloc[-1] < wanted[1][0]
    assert second.frame["time_s"].iloc[0] > wanted[0][1]


def test_a_log_with_one_loading_keeps_its_name(made: tuple[StudyRig, StudyRig]) -> None:
    assert split_stages(made[0].log) == (made[0].log,)
    assert stage_of(made[0].log, 1) == (made[0].log, 1)
    with pytest.raises(InputError, match="no loading number 2"):
        stage_of(made[0].log, 2)
    warm = replace(
        made[0].log, frame=made[0].log.frame.assign(contact=0.0, friction_N=0.0, load_N=0.0)
    )
    assert split_stages(warm) == (warm,)  # the reader of events says what is missing


@pytest.mark.study
def test_a_stage_gives_the_answer_of_its_own_log(
    made: tuple[StudyRig, StudyRig], joined_log: Log
) -> None:
    """Zero of the forces and noise level come from other stretches: beta moves by a small part of its u, 0.004."""
    for m, stage in zip(made, split_stages(joined_log)):
        found = []
        for log in (m.log, stage):
            at = with_inner_row_at_one_radius(prepare_test(log, m.rig, m.records))
            _, both = joint_fits(at, steady_lines(at, fit_rows(at, 10.0))[1].starts)
            found.append(both.estimates["beta"])
        assert abs(found[1].value - found[0].value) < 0.2 * found[0].u


@pytest.mark.study
def test_a_second_unloading_tightens_lag_and_h(
    made: tuple[StudyRig, StudyRig], joined_log: Log
) -> None:
    kept = [
        kept_of(stage.path.stem, prepare_test(stage, m.rig, m.records))[0]
        for m, stage in zip(made, split_stages(joined_log))
    ]
    alone, both = solve_campaign(kept[:1]).estimates[0], solve_campaign(kept).estimates[0]
    for key in ("beta", "h_fast", "h_slow", "lag_fast_s", "lag_slow_s"):
        assert both[key].u / both[key].value < alone[key].u / alone[key].value
    lags = {d: made[0].truth.disk(d).common_lag_s for d in ("fast", "slow")}
    for d, true in lags.items():
        assert abs(both[f"lag_{d}_s"].value - true) < 4 * both[f"lag_{d}_s"].u
