"""Figures of a plunge plot the result and return their axes; the design command writes table and
page."""

from __future__ import annotations

import json
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.axes import Axes
from plunge_simulator import same_pairs, simulate
from plunge_study import make_runs

from immersion.hole import compare_holes
from immersion.plunge_fit import identify_plunges, published_degC
from immersion.plunge_result import PlungeFit
from tcdyn.cli.design import design
from tcdyn.core.errors import InputError
from tcdyn.design.compare import Design, compare_tests
from tcdyn.design.plans import PlungePlan
from tcdyn.plots import plunge as pictures
from tcdyn.plots.style import figure
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.plunge import simulate_hole
from tests.pictures import bars

pytestmark = pytest.mark.study  # they share simulated and fitted plunges

SETUP = load_rig().disk_setup("fast")


@cache
def fit() -> PlungeFit:
    """The fit of one simulated plunge."""
    rng = np.random.default_rng(8)
    d = same_pairs(1)
    times, readings = simulate(d, 60.0, rng)
    return identify_plunges(
        make_runs(d, times, readings, rng)[:1], SETUP, alternatives=("mcadams",)
    )


@cache
def planned() -> Design:
    """The design of two plunges."""
    return compare_tests(SETUP, [PlungePlan(duration_s=40.0), PlungePlan(duration_s=80.0)], draws=4)


def test_figures_of_a_fit_have_axes_with_units() -> None:
    drawings = [
        lambda ax: pictures.draw_common_lag(fit(), ax),
        lambda ax: pictures.draw_holes(compare_holes(simulate_hole(1)[0]), ax),
        lambda ax: pictures.draw_design(planned(), ax),
    ]
    for draw in drawings:
        fig, (ax,) = figure()
        assert draw(ax) is ax
        fig.canvas.draw()
        assert "[" in ax.get_xlabel() + ax.get_ylabel()
        assert ax.lines or ax.collections or ax.containers


def test_bar_of_a_planned_test_ends_at_the_10_and_90_percent_quantiles() -> None:
    table = planned().table()
    marks, low, high = bars(pictures.draw_design(planned(), figure()[1][0]))
    assert marks[:, 0] == pytest.approx(table["u_common_s"])
    assert low == pytest.approx(np.minimum(table["u_common_10_s"], table["u_common_s"]))
    assert high == pytest.approx(np.maximum(table["u_common_90_s"], table["u_common_s"]))
    assert (high > low).any()


@pytest.mark.e2e
def test_interval_of_the_common_lag_is_plotted_over_its_posterior() -> None:
    ax = pictures.draw_common_lag(fit(), figure()[1][0])
    lag = fit().common_lag_s
    posterior, profile, *correlation_marks = [np.transpose(line.get_data()) for line in ax.lines]
    (band,) = ax.patches
    assert band.get_x() == pytest.approx(lag.low95)  # type: ignore[attr-defined]
    assert band.get_x() + band.get_width() == pytest.approx(lag.high95)  # type: ignore[attr-defined]
    mean = np.average(posterior[:, 0], weights=posterior[:, 1] * np.gradient(posterior[:, 0]))
    assert mean == pytest.approx(lag.value, abs=0.05 * lag.u)
    assert posterior[:, 1].max() == pytest.approx(1.0)
    assert profile[:, 1].max() == pytest.approx(1.0)
    top = profile[np.argmax(profile[:, 1]), 0]
    assert abs(top - lag.value) < lag.u
    assert [line[0, 0] for line in correlation_marks] == pytest.approx(
        list(fit().model_form.common_lag_s.values())
    )


def test_first_seconds_of_a_plunge_are_plotted_for_the_shallowest_and_deepest_junction() -> None:
    blocks = fit().optimum.problem.models[0].blocks
    predicted = fit().optimum.predictions_degC[0]
    ax = pictures.draw_plunge(fit(), 0, figure()[1][0], until_s=6.0)
    in_window = (blocks.time_s > -2.0) & (blocks.time_s < 6.0)
    dots = ax.lines[:4:2]
    lines = ax.lines[1:4:2]
    depth_mm = {c: 1e3 * SETUP.junctions[c].depth_m for c in fit().channels}
    end_channels = min(depth_mm, key=depth_mm.__getitem__), max(depth_mm, key=depth_mm.__getitem__)
    for c, readings, model in zip(end_channels, dots, lines, strict=True):
        j = fit().channels.index(c)
        assert np.array_equal(np.transpose(readings.get_data())[:, 0], blocks.time_s[in_window])
        np.testing.assert_array_equal(readings.get_ydata(), blocks.readings_degC[in_window, j])
        np.testing.assert_array_equal(model.get_ydata(), predicted[in_window, j])
        assert model.get_label() == f"{c}, {depth_mm[c]:g} mm deep"
    assert 0.5 < depth_mm[end_channels[0]] < depth_mm[end_channels[1]] < 10  # a disk of 20 mm


def test_holes_are_plotted_from_one_second_before_entry_with_all_readings_visible() -> None:
    result = compare_holes(simulate_hole(1)[0])
    ax = pictures.draw_holes(result, figure()[1][0])
    assert ax.get_xlim() == (-1.0, pytest.approx(min(10.0, result.block_time_s[-1])))
    in_window = result.readings_degC[result.block_time_s <= 10.0]
    assert ax.get_ylim() == pytest.approx((np.nanmin(in_window) - 1, np.nanmax(in_window) + 1))
    tones = [line.get_color() for line in ax.lines[::2]]
    n_ideal = sum(n.startswith("ideal") for n in result.names)
    assert len(set(tones)) == len(result.names) - n_ideal + 1


def test_marks_of_a_planned_test_are_side_by_side_within_the_ticks() -> None:
    ax = pictures.draw_design(planned(), figure()[1][0])
    table = planned().table()
    marks, _, _ = bars(ax)
    (differential,) = [
        line for line in ax.lines if line.get_label() == "differences between channels"
    ]
    rows = np.arange(len(table))[::-1]  # the first row is on top
    assert marks[:, 1] == pytest.approx(rows + 0.12)
    assert np.transpose(differential.get_data()) == pytest.approx(
        np.column_stack([table["u_differential_s"], rows - 0.12])
    )
    levels = {str(line.get_label()): np.unique(line.get_xdata()) for line in ax.lines}
    limits = {label: position for label, position in levels.items() if "determined well" in label}
    assert len(limits) == 2
    for label, position in limits.items():
        assert position == pytest.approx(float(label.split(" %")[0]) / 100 * planned().lag_s)
    low = table["u_differential_s"].min()
    high = table["u_common_90_s"].max()
    ticks = ax.get_xticks()
    assert ticks.min() <= 1.25 * low  # steps of 1, 2, 5
    assert 0.8 * high <= ticks.max()
    assert (np.diff(np.log10(ticks)) < 0.4).all()
    assert [t.get_text() for t in ax.get_xticklabels()] == [f"{t:g}" for t in ticks]


@pytest.mark.parametrize("n_plunges", [1, 2, 3])
def test_plunges_are_plotted_two_in_a_row(n_plunges: int) -> None:
    plotted_runs: list[int] = []

    def draw(_: PlungeFit, run: int, ax: Axes) -> Axes:
        plotted_runs.append(run)
        return ax

    repeated_fit = SimpleNamespace(runs=fit().runs * n_plunges)
    picture = pictures._figure_with_panels(repeated_fit, draw, 3.0)  # type: ignore[arg-type]
    assert plotted_runs == list(range(n_plunges))
    assert len(picture.axes) == n_plunges
    assert picture.get_figheight() == 3.0 * (2 if n_plunges == 3 else 1)
    assert len({round(ax.get_position().x0, 3) for ax in picture.axes}) == min(n_plunges, 2)


def test_residuals_of_a_plunge_are_plotted_in_units_of_the_noise() -> None:
    residuals = fit().standardised_residuals(0)
    assert np.nanstd(residuals) == pytest.approx(1.0, abs=0.3)
    ax = pictures.draw_plunge_residuals(fit(), 0, figure()[1][0])
    inside = np.abs(residuals[np.isfinite(residuals)]) < 1.96
    percent_in_title = float(ax.get_title("left").split(": ")[1].split(" %")[0])
    # the title leaves out the first 0.02 s
    assert percent_in_title == pytest.approx(100 * inside.mean(), abs=1.5)
    mean = ax.lines[1].get_ydata()
    blocks = fit().optimum.problem.models[0].blocks
    assert mean == pytest.approx(np.nanmean(residuals[blocks.time_s > 0.02], axis=1), nan_ok=True)


def test_junction_leads_its_reading_by_the_lag_in_the_slow_part() -> None:
    junction = fit().junction_degC(0)
    run = fit().runs[0]
    t = run.time_s - run.entry.time_s
    in_slow_part = (t > 20) & (t < 50)
    for j, c in enumerate(fit().channels):
        lag_s = t[in_slow_part] - np.interp(
            run.readings_degC[in_slow_part, j], junction[c], junction.index
        )
        # static errors of some hundredths of a kelvin at 0.4 K/s are 0.1 s
        assert np.mean(lag_s) == pytest.approx(fit().lag_s[c].value, abs=0.15)


def test_published_correlations_differ_by_far_more_than_the_effect_of_the_lag() -> None:
    run = fit().runs[0]
    at_30_s = [
        table[table.index > 30].iloc[0].mean() for table in published_degC(run, SETUP).values()
    ]
    assert np.ptp(at_30_s) > 0.5  # therefore h must be a free parameter


@pytest.mark.e2e
def test_design_command_writes_a_table_and_a_page(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    design(bath_degC=[110.0], duration_s=40.0, out=tmp_path / "plan.html", json_=True)
    plan = json.loads(capsys.readouterr().out)
    assert len(plan["tests"]) == 5
    assert "data:image/png" in (tmp_path / "plan.html").read_text(encoding="utf-8")
    design(bath_degC=[110.0], duration_s=40.0, out=tmp_path / "plan.csv", quiet=True)
    assert (tmp_path / "plan.csv").read_text(encoding="utf-8").startswith("test,")
    with pytest.raises(InputError, match="within 5 K"):
        design(bath_degC=[26.0])
    with pytest.raises(InputError, match="cannot have the ending"):
        design(bath_degC=[110.0], duration_s=40.0, out=tmp_path / "plan.doc", quiet=True)
