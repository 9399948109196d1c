"""Circumferential temperature of a disk from a measured test, against the synthetic disk in (r, z,
angle)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from tcdyn.partition.analyse import Partition
from tcdyn.partition.circumferential import circumferential_temperature
from tcdyn.plots.circumferential import draw_middle_plane, draw_running_surface
from tcdyn.plots.style import figure
from tcdyn.rig.circumferential import CircumferentialTemperature
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.field import _middle_plane, disk_fields
from tcdyn.simulate.truth import BoreContact, draw_truth
from tests.partition.study_rigs import QUICK, study_rig

SEED = 7000


@lru_cache
def analysis_and_true_fields() -> tuple[Partition, dict[str, CircumferentialTemperature]]:
    """Analysis of a rig with an uneven slow disk, and the true fields of its disks."""
    truth = draw_truth(SEED, load_rig(), uncertain=True).with_uneven(
        {"slow": BoreContact(0.7, 30.0)}
    )
    return study_rig(SEED, truth=truth).analyse(), disk_fields("B3", SEED, truth, QUICK)


@pytest.mark.study
@pytest.mark.parametrize("disk", [pytest.param("fast", marks=pytest.mark.long), "slow"])
def test_surface_temperature_matches_the_truth_within_its_band(disk: str) -> None:
    analysis, true_fields = analysis_and_true_fields()
    estimate = circumferential_temperature(analysis, disk)
    expected = true_fields[disk]
    error = estimate.surface_degC - expected.surface_degC
    assert np.abs(error / estimate.surface_u_K).max() < 2.5
    assert estimate.surface_u_K.max() < 0.6
    # circumferential range; the second harmonic, which is not observed, is 0.25 K
    assert np.ptp(estimate.surface_degC) == pytest.approx(np.ptp(expected.surface_degC), abs=0.7)


@pytest.mark.e2e
@pytest.mark.parametrize("disk", DISKS)
def test_middle_plane_contains_the_junction_readings(disk: str) -> None:
    """a, b and e lie in it. Depths of the drawn rig are about 0.1 mm off, up to 0.5 K near the
    surface."""
    analysis, true_fields = analysis_and_true_fields()
    for field, tolerance in (
        (circumferential_temperature(analysis, disk), 0.7),
        (true_fields[disk], 0.05),
    ):
        for c in "abe":
            j = field.setup.junctions[c]
            column = field.middle_degC[:, int(round(j.angle_deg / 3.0)) % 120]
            assert np.interp(j.depth_m, field.depth_m, column) == pytest.approx(
                field.reading_degC[c], abs=tolerance
            ), c


@pytest.mark.e2e
def test_plots_show_the_disk_and_its_junctions() -> None:
    analysis, true_fields = analysis_and_true_fields()
    for field in (circumferential_temperature(analysis, "slow"), true_fields["slow"]):
        _, (disk_axes, surface_axes) = figure(1, 2)
        draw_middle_plane(field, disk_axes)
        draw_running_surface(field, surface_axes)
        assert {t.get_text()[0] for t in disk_axes.texts if t.get_text()[0].isalpha()} == set(
            "abcdef"
        )
        assert disk_axes.get_ylim()[0] == pytest.approx(1.02e3 * field.depth_m.max())
        assert "K over the angle" in surface_axes.get_title(loc="left")


@pytest.mark.parametrize("rows", [4, 7])
def test_middle_plane_is_interpolated_between_its_neighbouring_rows(rows: int) -> None:
    """The field is linear across the disk, on rows that are not symmetric."""
    z = np.linspace(0.0, 1.0, rows) ** 1.3 * 0.01
    field = np.array([[[20.0 + 500 * x] * 3 for x in z]] * 2)
    assert _middle_plane(field, z) == pytest.approx(
        np.full((2, 3), 20.0 + 500 * 0.5 * (z[0] + z[-1]))
    )
