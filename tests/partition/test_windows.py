"""The cooling fit against the length of its window, and compensated against commuted."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95
from tcdyn.partition.analyse import Partition
from tcdyn.plots.style import figure
from tcdyn.plots.transient import draw_inverse_check, draw_junctions, draw_window_study
from tcdyn.workflows.beta_tables import cooling_by_window, reference_table
from tests.conftest import Campaign
from tests.pictures import bars

LENGTHS = (0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 60.0)


@pytest.fixture(scope="module")
def by_window(partition: Partition) -> pd.DataFrame:
    return cooling_by_window(partition, LENGTHS)


def test_five_seconds_give_the_cooling_fit_s_own_answer(
    partition: Partition, by_window: pd.DataFrame
) -> None:
    for disk in ("fast", "slow"):
        row = by_window.query("disk == @disk and window_s == 5.0").iloc[0]
        # the smoother sees a longer trace, which moves the answer by less than a tenth of its uncertainty
        assert row["beta"] == pytest.approx(partition.cooling[disk].beta, abs=0.1 * row["u_beta"])
        # the budget draws the lag with the joint fit's correlations, the table as if independent
        u = float(np.std(partition.budget.samples[f"cooling {disk}"]))
        assert row["u_beta"] == pytest.approx(u, rel=0.2)


def test_every_window_length_holds_the_truth(by_window: pd.DataFrame, campaign: Campaign) -> None:
    truth = campaign.truth["tests"]["B3"]["beta"]
    assert ((by_window["beta"] - truth).abs() < 3 * by_window["u_beta"]).all()


def test_longer_windows_know_h_better_and_fit_the_mean_better(by_window: pd.DataFrame) -> None:
    for _, own in by_window.groupby("disk"):
        u = own["u_h_W_m2K"].to_numpy()
        # beyond some ten seconds a longer window tells nothing new, and the nuisances weigh a little differently
        assert (np.diff(u) < 0.02 * u[:-1]).all()
        assert u[-1] < 0.6 * u[0]


def test_windows_within_the_lag_are_marked_and_those_beyond_the_log_left_out(
    by_window: pd.DataFrame,
) -> None:
    assert set(by_window["window_s"]) == {0.5, 1.0, 2.0, 5.0, 10.0, 15.0}
    assert by_window.query("window_s == 0.5")["within_lag"].all()
    assert not by_window.query("window_s >= 1.0")["within_lag"].any()


def test_bad_lengths_get_one_sentence(partition: Partition) -> None:
    with pytest.raises(InputError, match="above zero"):
        cooling_by_window(partition, (0.0, 1.0))
    with pytest.raises(InputError, match="of cooling"):
        cooling_by_window(partition, (600.0,))


def test_compensated_and_commuted_forms_agree(partition: Partition) -> None:
    table = reference_table(partition)
    assert len(table) == 4
    assert (table["z"].abs() < 3).all()
    apart = np.hypot(table["u_compensated"], table["u_commuted"])
    assert (table["u_difference"] < apart).all()  # depth, steel and static lines move both alike
    assert (table["difference"] == table["compensated"] - table["commuted"]).all()


@pytest.mark.parametrize("quantity", ["beta", "h_W_m2K"])
def test_windows_are_drawn_with_bars_of_95_percent_side_by_side(
    by_window: pd.DataFrame, quantity: str
) -> None:
    marks, low, high = bars(draw_window_study(by_window, figure()[1][0], quantity))
    table = by_window.sort_values("disk", kind="stable")
    assert (low + high) / 2 == pytest.approx(table[quantity])
    assert high - low == pytest.approx(2 * Z95 * table[f"u_{quantity}"])
    beside = marks[:, 0] / table["window_s"]
    assert set(beside[table["disk"] == "fast"].round(6)) == {1.0}
    assert set(beside[table["disk"] == "slow"].round(6)) == {1.03}


def test_junctions_are_drawn_where_the_test_places_them(partition: Partition) -> None:
    assert partition.sensors is not None
    tests = partition.sensors.depths
    ax = draw_junctions(tests, figure()[1][0])
    marks, low, high = bars(ax)
    places = [e for test in tests.values() for e in test.deeper_m.values()]
    assert marks[:, 1] == pytest.approx([1e3 * e.value for e in places])
    assert low == pytest.approx([1e3 * e.low95 for e in places])
    assert high == pytest.approx([1e3 * e.high95 for e in places])
    assert sorted({round(x % 1, 2) for x in marks[:, 0]}) == [
        0.12,
        0.88,
    ]  # to the left and to the right of the tick
    (band,) = ax.patches
    stated = 1e3 * Z95 * max(t.nominal_u_m for t in tests.values())
    assert band.get_extents().transformed(ax.transData.inverted()).intervaly == pytest.approx(
        [-stated, stated]
    )


def test_pictures_show_both_disks(by_window: pd.DataFrame, partition: Partition) -> None:
    fig, axes = figure(1, 2)
    draw_window_study(by_window, axes[0], truth=0.7)
    draw_inverse_check(reference_table(partition), axes[1])
    words = " ".join(t.get_text() for t in axes[0].get_legend().get_texts())
    assert "fast disk" in words
    assert "shorter than the lag" in words
    assert len(axes[1].get_yticks()) == 4
    fig.canvas.draw()
