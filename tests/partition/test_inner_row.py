"""An inner row with different depths: d and f are specified at another depth than b."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.partition.sensor_check import check_sensors
from tcdyn.partition.steady import steady_lines, with_inner_row_at_one_radius
from tcdyn.partition.window import fit_rows
from tcdyn.rig.rigfile import load_rig
from tests.partition.study_rigs import study_rig

RAISED = """
[thermocouples]
d = { depth_mm = 5.4, z_mm = 2.0 }
f = { depth_mm = 5.4, z_mm = 7.53 }
"""


@pytest.mark.study
def test_specified_depths_of_d_and_f_are_used(tmp_path: Path) -> None:
    """Both are 0.6 mm nearer the surface. With the depth of b, beta shifts by 0.010 and h by a
    tenth."""
    (tmp_path / "rig.toml").write_text(RAISED)
    study = study_rig(1, uncertain=False, lag_error_s=0.0, rig=load_rig(tmp_path / "rig.toml"))
    rows = fit_rows(study.test, 10.0)
    _, level_speed_law = steady_lines(study.test, rows)
    _, speed_law_fit = steady_lines(with_inner_row_at_one_radius(study.test), rows)
    truth = study.true_values["beta"]
    assert abs(level_speed_law.beta - truth) > 0.008
    # static lines and noise of this rig; 0.001 for a level row
    assert speed_law_fit.beta == pytest.approx(truth, abs=0.003)
    assert speed_law_fit.h_fast == pytest.approx(study.true_values["h_fast"], rel=0.03)
    check = check_sensors(with_inner_row_at_one_radius(study.test))
    assert check.sound
    assert all(np.abs(t.pull).max() < 2.0 for t in check.depths.values())


def test_level_inner_row_is_returned_unchanged() -> None:
    study = study_rig(1, uncertain=False)
    assert with_inner_row_at_one_radius(study.test) is study.test
