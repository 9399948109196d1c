"""The temperature round a disk, drawn from a measured test, against the synthetic disk in (r, z, angle)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from tcdyn.partition.analyse import Partition
from tcdyn.plots.circumferential import draw_middle_plane, draw_running_surface
from tcdyn.plots.style import figure
from tcdyn.rig.circumferential import CircumferentialTemperature
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.field import _middle, disk_fields
from tcdyn.simulate.truth import BoreContact, draw_truth
from tcdyn.workflows.circumferential import circumferential_temperature
from tests.partition.study_rigs import QUICK, study_rig

SEED = 7000


@lru_cache
def found_and_true() -> tuple[Partition, dict[str, CircumferentialTemperature]]:
    """A rig whose slow disk sits uneven, and its disks as they were."""
    truth = draw_truth(SEED, load_rig(), uncertain=True).with_uneven(
        {"slow": BoreContact(0.7, 30.0)}
    )
    return study_rig(SEED, truth=truth).analyse(), disk_fields("B3", SEED, truth, QUICK)


@pytest.mark.study
@pytest.mark.parametrize("disk", DISKS)
def test_the_surface_round_the_disk_is_the_true_one_within_its_band(disk: str) -> None:
    p, true = found_and_true()
    found, there = circumferential_temperature(p, disk), true[disk]
    off = found.surface_degC - there.surface_degC
    assert np.abs(off / found.surface_u_K).max() < 2.5
    assert found.surface_u_K.max() < 0.6
    # what goes round it: the second harmonic, which nobody sees, is 0.25 K
    turn = np.ptp(found.surface_degC), np.ptp(there.surface_degC)
    assert turn[0] == pytest.approx(turn[1], abs=0.7)


@pytest.mark.parametrize("disk", DISKS)
def test_the_middle_plane_holds_what_its_junctions_read(disk: str) -> None:
    """a, b and e lie in it; depths of the drawn rig are some 0.1 mm off, up to 0.5 K near the surface."""
    p, true = found_and_true()
    for around, tolerance in ((circumferential_temperature(p, disk), 0.7), (true[disk], 0.05)):
        for c in "abe":
            j = around.setup.junctions[c]
            column = around.middle_degC[:, int(round(j.angle_deg / 3.0)) % 120]
            assert np.interp(j.depth_m, around.depth_m, column) == pytest.approx(
                around.reading_degC[c], abs=tolerance
            ), c


def test_pictures_show_the_disk_and_its_junctions() -> None:
    p, true = found_and_true()
    for around in (circumferential_temperature(p, "slow"), true["slow"]):
        _, (whole, surface) = figure(1, 2)
        draw_middle_plane(around, whole)
        draw_running_surface(around, surface)
        assert {t.get_text()[0] for t in whole.texts if t.get_text()[0].isalpha()} == set("abcdef")
        assert whole.get_ylim()[0] == pytest.approx(1.02e3 * around.depth_m.max())
        assert "K over the angle" in surface.get_title(loc="left")


@pytest.mark.parametrize("rows", [4, 7])
def test_the_middle_plane_lies_between_the_rows_beside_it(rows: int) -> None:
    """A field that is a straight line across the disk, on rows that are no mirror images."""
    z = np.linspace(0.0, 1.0, rows) ** 1.3 * 0.01
    field = np.array([[[20.0 + 500 * x] * 3 for x in z]] * 2)
    assert _middle(field, z) == pytest.approx(np.full((2, 3), 20.0 + 500 * 0.5 * (z[0] + z[-1])))
