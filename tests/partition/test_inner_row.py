"""An inner row that is not level: d and f stated at another depth than b."""

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
def test_stated_depths_of_d_and_f_are_honoured(tmp_path: Path) -> None:
    """Both 0.6 mm nearer the surface, and stated so: taken as level with b, they moved beta by 0.010, h by a tenth."""
    (tmp_path / "rig.toml").write_text(RAISED)
    made = study_rig(1, uncertain=False, lag_error_s=0.0, rig=load_rig(tmp_path / "rig.toml"))
    rows = fit_rows(made.test, 10.0)
    _, taken_as_level = steady_lines(made.test, rows)
    _, speed = steady_lines(with_inner_row_at_one_radius(made.test), rows)
    truth = made.told["beta"]
    assert abs(taken_as_level.beta - truth) > 0.008
    assert speed.beta == pytest.approx(
        truth, abs=0.003
    )  # static lines and noise of this rig; 0.001 with a level row
    assert speed.h_fast == pytest.approx(made.told["h_fast"], rel=0.03)
    check = check_sensors(made.test)
    assert check.sound
    assert all(np.abs(t.pull).max() < 2.0 for t in check.depths.values())


def test_a_level_inner_row_is_left_alone() -> None:
    made = study_rig(1, uncertain=False)
    assert with_inner_row_at_one_radius(made.test) is made.test
