"""Every picture of a plunge draws from a result and returns its axes; the design command writes what it says."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from plunge_simulator import same_pairs, simulate
from plunge_study import make_runs

from calibration.errors import InputError
from calibration.rig import load_rig
from tcdyn.cli.design import design
from tcdyn.design.compare import compare_tests
from tcdyn.design.plans import PlungePlan
from tcdyn.plots import plunge as pictures
from tcdyn.plots.style import figure
from tcdyn.plunge.fit import identify_plunges, published_degC
from tcdyn.plunge.hole import compare_holes
from tcdyn.plunge.result import PlungeFit
from tcdyn.simulate.plunge import simulate_hole
from tests.pictures import bars

SETUP = load_rig().disk_setup("fast")


@cache
def fit() -> PlungeFit:
    rng = np.random.default_rng(8)
    d = same_pairs(1)
    times, readings = simulate(d, 60.0, rng)
    return identify_plunges(make_runs(d, times, readings, rng)[:1], SETUP, alternatives=("mcadams",))


def test_pictures_of_a_fit_have_axes_with_units() -> None:
    run = fit().runs[0]
    models = {**published_degC(run, SETUP), "fitted": fit().junction_degC(0)}
    design_ = compare_tests(SETUP, [PlungePlan(duration_s=40.0)], draws=2)
    drawings = [
        lambda ax: pictures.draw_record(run, ax),
        lambda ax: pictures.draw_record(run, ax, until_s=20.0),
        lambda ax: pictures.draw_entry(run, models, ax),
        lambda ax: pictures.draw_heat_transfer(fit(), 0, ax),
        lambda ax: pictures.draw_common_lag(fit(), ax),
        lambda ax: pictures.draw_differential_lags(fit(), ax),
        lambda ax: pictures.draw_holes(compare_holes(simulate_hole(1)[0]), ax),
        lambda ax: pictures.draw_design(design_, ax),
    ]
    for draw in drawings:
        fig, (ax,) = figure()
        assert draw(ax) is ax
        fig.canvas.draw()
        assert "[" in ax.get_xlabel() + ax.get_ylabel()
        assert ax.lines or ax.collections or ax.containers


def test_a_planned_test_s_bar_ends_where_a_tenth_of_the_draws_lies_beyond() -> None:
    design_ = compare_tests(SETUP, [PlungePlan(duration_s=40.0), PlungePlan(duration_s=80.0)], draws=4)
    table = design_.table()
    marks, low, high = bars(pictures.draw_design(design_, figure()[1][0]))
    assert marks[:, 0] == pytest.approx(table["u_common_s"])
    assert low == pytest.approx(np.minimum(table["u_common_10_s"], table["u_common_s"]))
    assert high == pytest.approx(np.maximum(table["u_common_90_s"], table["u_common_s"]))
    assert (high > low).any()


def test_the_interval_of_the_common_lag_stands_over_its_posterior() -> None:
    ax = pictures.draw_common_lag(fit(), figure()[1][0])
    lag = fit().common_lag_s
    posterior, profile, *others = [np.transpose(line.get_data()) for line in ax.lines]
    (band,) = ax.patches
    assert band.get_x() == pytest.approx(lag.low95)  # type: ignore[attr-defined]
    assert band.get_x() + band.get_width() == pytest.approx(lag.high95)  # type: ignore[attr-defined]
    mean = np.average(posterior[:, 0], weights=posterior[:, 1] * np.gradient(posterior[:, 0]))
    assert mean == pytest.approx(lag.value, abs=0.05 * lag.u)
    assert posterior[:, 1].max() == pytest.approx(1.0)
    assert profile[:, 1].max() == pytest.approx(1.0)
    top = profile[np.argmax(profile[:, 1]), 0]
    assert abs(top - lag.value) < lag.u
    assert [line[0, 0] for line in others] == pytest.approx(list(fit().model_form.common_lag_s.values()))


def test_differences_of_the_lags_have_bars_of_95_percent() -> None:
    marks, low, high = bars(pictures.draw_differential_lags(fit(), figure()[1][0]))
    found = [fit().differential_lag_s[c] for c in fit().channels]
    assert marks[:, 1] == pytest.approx([e.value for e in found])
    assert low == pytest.approx([e.low95 for e in found])
    assert high == pytest.approx([e.high95 for e in found])


def test_what_is_left_of_a_plunge_is_drawn_in_units_of_the_noise() -> None:
    left = pictures.standardised(fit(), 0)
    assert np.nanstd(left) == pytest.approx(1.0, abs=0.3)
    ax = pictures.draw_plunge_residuals(fit(), 0, figure()[1][0])
    inside = np.abs(left[np.isfinite(left)]) < 1.96
    told = float(ax.get_title().split(": ")[1].split(" %")[0])
    assert told == pytest.approx(100 * inside.mean(), abs=1.5)  # the title leaves out the first 0.02 s
    mean = ax.lines[1].get_ydata()
    blocks = fit().optimum.problem.models[0].blocks
    assert mean == pytest.approx(np.nanmean(left[blocks.time_s > 0.02], axis=1), nan_ok=True)


def test_the_junction_leads_its_reading_by_the_lag_on_the_slow_part() -> None:
    seen, run = fit().junction_degC(0), fit().runs[0]
    t = run.time_s - run.entry.time_s
    inside = (t > 20) & (t < 50)
    for j, c in enumerate(fit().channels):
        behind = t[inside] - np.interp(run.readings_degC[inside, j], seen[c], seen.index)
        # static remainders of some hundredths of a kelvin at 0.4 K/s are 0.1 s
        assert np.mean(behind) == pytest.approx(fit().lag_s[c].value, abs=0.15)


def test_published_correlations_disagree_by_far_more_than_the_lag() -> None:
    run = fit().runs[0]
    at_30_s = [table[table.index > 30].iloc[0].mean() for table in published_degC(run, SETUP).values()]
    assert np.ptp(at_30_s) > 0.5  # and it is why h must be free


def test_the_design_command_writes_a_table_and_a_page(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    design(bath_degC=[110.0], duration_s=40.0, out=tmp_path / "plan.html", json_=True)
    told = json.loads(capsys.readouterr().out)
    assert len(told["tests"]) == 5
    assert "data:image/png" in (tmp_path / "plan.html").read_text(encoding="utf-8")
    design(bath_degC=[110.0], duration_s=40.0, out=tmp_path / "plan.csv", quiet=True)
    assert (tmp_path / "plan.csv").read_text(encoding="utf-8").startswith("test,")
    with pytest.raises(InputError, match="within 5 K"):
        design(bath_degC=[26.0])
    with pytest.raises(InputError, match="unknown kind"):
        design(bath_degC=[110.0], duration_s=40.0, out=tmp_path / "plan.doc", quiet=True)
