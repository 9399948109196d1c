"""The cooling fit against the length of its window, and compensated against commuted readings."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95
from tcdyn.partition.analyse import Partition
from tcdyn.partition.cooling_checks import cooling_by_window, reference_table
from tcdyn.plots.style import figure
from tcdyn.plots.transient import draw_inverse_check, draw_junctions, draw_window_study
from tests.conftest import Campaign
from tests.pictures import bars

LENGTHS = (0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 60.0)


@pytest.fixture(scope="module")
def by_window(partition: Partition) -> pd.DataFrame:
    return cooling_by_window(partition, LENGTHS)


def test_window_of_five_seconds_reproduces_the_cooling_fit(
    partition: Partition, by_window: pd.DataFrame
) -> None:
    for disk in ("fast", "slow"):
        row = by_window.query("disk == @disk and window_s == 5.0").iloc[0]
        # the smoother has a longer trace, which changes the estimate by less than a tenth of its
        # uncertainty
        assert row["beta"] == pytest.approx(partition.cooling[disk].beta, abs=0.1 * row["u_beta"])
        # the budget samples the lag with the correlations of the joint fit, the table as
        # independent
        u = float(np.std(partition.budget.samples[f"cooling {disk}"]))
        assert row["u_beta"] == pytest.approx(u, rel=0.2)


def test_every_window_length_is_within_3_u_of_the_truth(
    by_window: pd.DataFrame, campaign: Campaign
) -> None:
    truth = campaign.truth["tests"]["B3"]["beta"]
    assert ((by_window["beta"] - truth).abs() < 3 * by_window["u_beta"]).all()


def test_longer_windows_have_a_smaller_u_of_h(by_window: pd.DataFrame) -> None:
    for _, windows in by_window.groupby("disk"):
        u = windows["u_h_W_m2K"].to_numpy()
        # beyond about ten seconds a longer window adds no information, and the nuisance weights
        # differ slightly
        assert (np.diff(u) < 0.02 * u[:-1]).all()
        assert u[-1] < 0.6 * u[0]


def test_windows_within_the_lag_are_marked_and_those_beyond_the_log_omitted(
    by_window: pd.DataFrame,
) -> None:
    assert set(by_window["window_s"]) == {0.5, 1.0, 2.0, 5.0, 10.0, 15.0}
    assert by_window.query("window_s == 0.5")["within_lag"].all()
    assert not by_window.query("window_s >= 1.0")["within_lag"].any()


def test_invalid_window_lengths_raise(partition: Partition) -> None:
    with pytest.raises(InputError, match="above zero"):
        cooling_by_window(partition, (0.0, 1.0))
    with pytest.raises(InputError, match="of cooling"):
        cooling_by_window(partition, (600.0,))


def test_compensated_and_commuted_forms_agree(partition: Partition) -> None:
    table = reference_table(partition)
    assert len(table) == 4
    assert (table["z"].abs() < 3).all()
    combined_u = np.hypot(table["u_compensated"], table["u_commuted"])
    # depth, steel and static lines shift both alike
    assert (table["u_difference"] < combined_u).all()
    assert (table["difference"] == table["compensated"] - table["commuted"]).all()


def test_windows_are_drawn_side_by_side_with_95_percent_bars(by_window: pd.DataFrame) -> None:
    marks, low, high = bars(draw_window_study(by_window, figure()[1][0]))
    table = by_window.sort_values("disk", kind="stable")
    assert (low + high) / 2 == pytest.approx(table["beta"])
    assert high - low == pytest.approx(2 * Z95 * table["u_beta"])
    position = marks[:, 0] / table["window_s"]
    assert set(position[table["disk"] == "fast"].round(6)) == {1.0}
    assert set(position[table["disk"] == "slow"].round(6)) == {1.03}


def test_junctions_are_drawn_at_their_estimated_depths(partition: Partition) -> None:
    assert partition.sensors is not None
    tests = partition.sensors.depths
    ax = draw_junctions(tests, figure()[1][0])
    marks, low, high = bars(ax)
    depths = [e for test in tests.values() for e in test.deeper_m.values()]
    assert marks[:, 1] == pytest.approx([1e3 * e.value for e in depths])
    assert low == pytest.approx([1e3 * e.low95 for e in depths])
    assert high == pytest.approx([1e3 * e.high95 for e in depths])
    # left and right of the tick
    assert sorted({round(x % 1, 2) for x in marks[:, 0]}) == [
        0.12,
        0.88,
    ]
    (band,) = ax.patches
    nominal_mm = 1e3 * Z95 * max(t.nominal_u_m for t in tests.values())
    assert band.get_extents().transformed(ax.transData.inverted()).intervaly == pytest.approx(
        [-nominal_mm, nominal_mm]
    )


def test_plots_show_both_disks(by_window: pd.DataFrame, partition: Partition) -> None:
    fig, axes = figure(1, 2)
    draw_window_study(by_window, axes[0])
    draw_inverse_check(reference_table(partition), axes[1])
    legend = " ".join(t.get_text() for t in axes[0].get_legend().get_texts())
    assert "fast disk" in legend
    assert "shorter than the lag" in legend
    assert len(axes[1].get_yticks()) == 4
    fig.canvas.draw()
