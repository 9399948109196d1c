"""Static lines: the truth is inside the intervals as often as they say, and the tests see what they should."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calibration.static_lines import error_histogram, error_statistics, fit_static_lines
from tcdyn.core.errors import InputError
from tcdyn.estimation.line_fit import fit_line, lack_of_fit_p, outliers, quadratic_p, repeat_shift
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.log import read_log, write_log
from tcdyn.rig.oven_log import steady_minutes
from tcdyn.rig.static_line import StaticLine, apply_static, outside_range, static_u
from tcdyn.rig.tables import PRT_U_DEGC
from tcdyn.simulate.measure import simulate_oven
from tests.rig.log_cases import oven_frame, oven_truth

DATA = Path(os.environ.get("TCDYN_DATA", Path(__file__).parents[2] / "../shared/data"))
OVENS = 200


def test_the_line_agrees_with_nists_norris_to_ten_digits():
    file = DATA / "strd" / "norris.csv"
    if not file.exists():
        pytest.skip(f"reference data not at {file}")
    data = pd.read_csv(file)
    fit = fit_line(data["x"], data["y"])
    u = np.sqrt(np.diag(fit.covariance))
    certified = (
        1.00211681802045,
        -0.262323073774029,
        0.429796848199937e-03,
        0.232818234301152,
        0.884796396144373,
    )
    for own, theirs in zip((fit.slope, fit.intercept, u[0], u[1], fit.sd), certified):
        assert own == pytest.approx(theirs, rel=1e-10)
    assert fit.r_squared == pytest.approx(0.999993745883712, rel=1e-10)


def left_over(columns, y) -> float:
    """Sum of squares that least squares on these columns leaves of y."""
    return float(np.sum((y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) ** 2))


def nested_p(small, large, y) -> float:
    """p of the F test of the columns that the larger model has beside those of the smaller."""
    n = len(y)
    few = small.shape[1]
    many = large.shape[1]
    free = left_over(small, y)
    rest = left_over(large, y)
    return float(
        stats.f.sf((free - rest) / (many - few) / (rest / (n - many)), many - few, n - many)
    )


def repeats_of_a_line() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place (N,), noisy y (N,) and repeat (N,) of five places in four repeats, unevenly spread."""
    x = np.tile([20.0, 30.0, 80.0, 100.0, 160.0], 4)
    return (
        x,
        1.02 * x - 0.3 + np.random.default_rng(8).normal(0, 0.2, 20),
        np.repeat([0, 1, 2, 3], 5),
    )


def test_an_outlying_point_is_one_that_the_line_through_the_others_refuses():
    """Each point left out in turn, and asked whether the line through the rest foretells it: the same p for each."""
    x, y, _ = repeats_of_a_line()
    x, y = np.append(x, 400.0), np.append(y, 410.0)  # one far away, too, which holds the line
    n = len(x)
    p = np.empty(len(x))
    for i in range(n):
        rest = np.arange(n) != i
        slope, intercept, *_ = stats.linregress(x[rest], y[rest])
        s = np.sqrt(np.sum((y[rest] - slope * x[rest] - intercept) ** 2) / (n - 3))
        dx = x[rest] - x[rest].mean()
        u = s * np.sqrt(1 + 1 / (n - 1) + (x[i] - x[rest].mean()) ** 2 / np.sum(dx**2))
        p[i] = 2 * stats.t.sf(abs(y[i] - slope * x[i] - intercept) / u, n - 3)
    order = np.argsort(p)
    for many in (1, 5, 12, 20):
        between = np.sqrt(p[order[many - 1]] * p[order[many]])
        assert outliers(fit_line(x, y), n * between) == sorted(order[:many].tolist())


def test_the_tests_of_a_line_are_f_tests_of_a_model_with_more_columns():
    x, y, repeat = repeats_of_a_line()
    fit = fit_line(x, y)
    line = np.column_stack([np.ones(20), x])
    assert quadratic_p(fit) == pytest.approx(
        nested_p(line, np.column_stack([line, x**2]), y), rel=1e-9
    )
    places = (x[:, None] == np.unique(x)).astype(float)
    assert lack_of_fit_p(fit, x) == pytest.approx(nested_p(line, places, y), rel=1e-9)
    own = np.column_stack([(repeat[:, None] == np.arange(4)).astype(float), x])
    within, _, p = repeat_shift(fit, repeat)
    assert p == pytest.approx(nested_p(line, own, y), rel=1e-9)
    assert within == pytest.approx(np.sqrt(left_over(own, y) / 15), rel=1e-9)
    # repeats that lie at -3, -1, 1 and 3 of 10 kelvin each, hardly any noise: their mean is good to sd/sqrt(4)
    shifted = fit_line(x, y + 10.0 * (2 * repeat - 3))
    assert repeat_shift(shifted, repeat)[1] == pytest.approx(
        10 * np.std([-3, -1, 1, 3], ddof=1) / 2, rel=0.02
    )


def test_repeats_that_are_the_same_shift_by_nothing():
    x, y, repeat = repeats_of_a_line()
    within, u, p = repeat_shift(fit_line(x, np.tile(y[:5], 4)), repeat)
    assert within > 0.1
    assert (u, p) == (0.0, pytest.approx(1.0))


def test_noise_of_the_logged_side_is_what_the_known_error_leaves_unexplained():
    x, y, _ = repeats_of_a_line()
    plain = fit_line(x, y)
    assert fit_line(x, y, u_y=plain.sd).slope == plain.slope  # it explains all
    freed = fit_line(x, y, u_y=plain.sd / 2)
    # 3/4 of the residuals' variance is then x's: slope^2 u_x^2
    u_x2 = 0.75 * plain.sd**2 / plain.slope**2
    assert freed.slope == pytest.approx(plain.slope / (1 - u_x2 / np.var(x)), rel=1e-12)
    in_mV = fit_line(x, 40 * y, u_y=20 * plain.sd)
    assert in_mV.slope == pytest.approx(40 * freed.slope, rel=1e-12)


def test_places_that_differ_by_rounding_are_one_place():
    with pytest.raises(InputError, match="one place"):
        fit_line([1e3 * (0.1 + 0.2), 300.0, 300.0], [1.0, 2.0, 3.0])
    assert fit_line([300.001, 300.0, 300.0], [2.0, 1.0, 1.0]).slope == pytest.approx(1000.0)


def test_too_few_points_are_asked_nothing():
    x = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    y = x + np.array([0.1, -0.1, 0.05, 0.1, -0.1])
    four = fit_line(x[:4], y[:4])
    five = fit_line(x, y)
    assert quadratic_p(four) is None
    assert quadratic_p(five) is not None
    assert lack_of_fit_p(five, [0, 0, 1, 1, 1]) is None  # a line goes through two means
    assert lack_of_fit_p(five, [0, 1, 2, 3, 3]) is None  # one difference tells no scatter
    assert lack_of_fit_p(five, [0, 0, 1, 1, 2]) is not None
    assert repeat_shift(five, [0, 0, 0, 0, 0]) == (None, 0.0, None)
    assert repeat_shift(four, [0, 0, 1, 1]) == (None, 0.0, None)
    assert repeat_shift(five, [0, 0, 1, 1, 1])[0] is not None
    assert outliers(four, 1e9) == []  # one degree of freedom is left without a point
    assert outliers(five, 1e9) == [0, 1, 2, 3, 4]


def coverage(ovens) -> dict[str, float]:
    """How often the 95 % intervals of gain, offset and the corrected reading at 90 degC hold the truth."""
    hits = {"gain": [], "offset": [], "at 90 degC": []}
    for frame, gain, offset in ovens:
        fit = fit_static_lines(frame)
        for k, channel in enumerate(CHANNELS):
            line = fit.lines[channel]
            hits["gain"].append(line.gain_estimate.contains(gain[k]))
            hits["offset"].append(line.offset_estimate.contains(offset[k]))
            error = apply_static((90.0 - offset[k]) / gain[k], line) - 90.0
            hits["at 90 degC"].append(abs(error) < 1.96 * static_u(line, 90.0))
    return {name: float(np.mean(hit)) for name, hit in hits.items()}


@pytest.mark.study
@pytest.mark.parametrize(
    "noise", [0.05, *(pytest.param(n, marks=pytest.mark.study) for n in (0.01, 0.2))]
)
def test_95_percent_intervals_hold_the_truth_at_that_rate_over_200_ovens(noise):
    found = coverage((oven_frame(s, noise), *oven_truth(s)) for s in range(OVENS))
    # six channels share the PRT, so in effect between 200 and 1200 independent ovens: three sigma of 200 is 4.6 %
    assert all(0.904 <= rate <= 0.996 for rate in found.values()), found


@pytest.mark.study
def test_intervals_hold_the_truth_for_the_rigs_ovens_whose_minutes_share_an_error():
    def ovens():
        for seed in range(100):
            frame, truth = simulate_oven("fast", seed=seed)
            yield (
                frame,
                np.array([truth["gain"][c] for c in CHANNELS]),
                np.array([truth["offset_degC"][c] for c in CHANNELS]),
            )

    found = coverage(ovens())
    assert all(0.88 <= rate <= 1.0 for rate in found.values()), found  # three sigma of 100 is 6.5 %


def test_noise_of_the_logged_side_does_not_flatten_the_line():
    rng = np.random.default_rng(0)
    slopes = []
    plain = []
    for _ in range(400):
        true = np.linspace(20, 160, 24)
        logged = true + rng.normal(0, 8.0, 24)
        prt = true + rng.uniform(-0.1, 0.1, 24)
        slopes.append(fit_line(logged, prt, u_y=PRT_U_DEGC).slope)
        plain.append(fit_line(logged, prt).slope)
    # 8 degC of noise on a spread of 42 degC pulls the plain slope down by 3.5 %
    assert np.mean(plain) == pytest.approx(1 / (1 + 64 / 42.2**2), abs=0.01)
    assert np.mean(slopes) == pytest.approx(1.0, abs=3 * np.std(slopes) / 20 + 2e-3)


def test_a_shared_prt_error_is_kept_beside_the_lines():
    frame = oven_frame()
    without = fit_static_lines(frame)
    with_shared = fit_static_lines(frame, prt_shared_u_degC=0.05)
    for c in CHANNELS:
        assert with_shared.lines[c].covariance == without.lines[c].covariance
        assert (without.lines[c].shared_u_K, with_shared.lines[c].shared_u_K) == (0.0, 0.05)


def test_curvature_is_noticed():
    frame = oven_frame()
    frame["b_degC"] += 2e-4 * (frame["b_degC"] - 90) ** 2  # up to 1 degC
    fit = fit_static_lines(frame)
    assert any("channel b: a quadratic term" in w for w in fit.warnings)
    assert any("channel b: the line does not fit" in w for w in fit.warnings)
    assert fit.lines["b"].quadratic_p < 1e-6


def test_false_alarms_are_as_rare_as_the_tests_say():
    alarms = [w for s in range(100) for w in fit_static_lines(oven_frame(s)).warnings]
    # 600 channels and four tests at 1 %: 24 expected, in clusters because channels share the PRT
    assert 2 <= len(alarms) <= 70


def test_an_outlying_row_is_named_by_repeat_and_set_point():
    frame = oven_frame()
    row = frame.index[(frame["repeat"] == 2) & (frame["setpoint_degC"] == 80)][0]
    frame.loc[row, "d_degC"] += 1.0
    notes = fit_static_lines(frame).warnings
    assert any("channel d: repeat 2 at 80 degC lies" in w for w in notes)


def test_a_shift_between_repeats_is_noticed_and_widens_the_offset():
    frame = oven_frame()
    moved = frame.copy()
    moved["c_degC"] += 0.5 * (frame["repeat"] - 2)
    fit = fit_static_lines(moved)
    assert any("channel c: the repeats shift" in w for w in fit.warnings)
    # shifts of -0.5, 0 and 0.5 degC have a mean good to 0.5/sqrt(3) = 0.29 degC
    assert fit.lines["c"].offset_estimate.u > 0.25


def test_minutes_of_one_hold_count_as_one_point():
    frame = oven_frame()
    often = fit_static_lines(frame.loc[frame.index.repeat(6)])
    once = fit_static_lines(frame)
    for c in CHANNELS:
        assert often.lines[c].gain == pytest.approx(once.lines[c].gain, rel=1e-12)
        assert often.lines[c].offset_estimate.u == pytest.approx(
            once.lines[c].offset_estimate.u, rel=1e-9
        )


def test_table_2_6_describes_errors_before_and_after():
    fit = fit_static_lines(oven_frame())
    table = fit.statistics
    assert list(table.index) == [
        "Maximum error",
        "Summation of the absolute error",
        "Average of the absolute error",
        "Standard deviation",
    ]
    assert (table["calibrated"] < table["raw"]).all()
    assert error_statistics([-1.0, 1.0, 3.0])["Maximum error"] == 3.0
    counts, edges = error_histogram(fit.raw_errors_K)
    assert counts.sum() == 144
    assert edges[0] < fit.raw_errors_K.min()
    assert edges[-1] > fit.raw_errors_K.max()


def test_steady_minutes_of_a_continuous_log_make_the_oven_rows(tmp_path):
    rng = np.random.default_rng(3)
    t = np.arange(0, 6 * 3600.0, 2.0)
    level = np.select([t < 7200, t < 14400], [40.0, 80.0], 120.0)
    prt = np.empty_like(t)
    prt[0] = 20.0
    for i in range(1, len(t)):  # an oven of 8 minutes
        prt[i] = prt[i - 1] + (level[i] - prt[i - 1]) * 2.0 / 480.0
    frame = pd.DataFrame({"time_s": t, "prt_degC": prt + rng.normal(0, 0.01, len(t))})
    for c in CHANNELS:
        frame[f"{c}_degC"] = (prt - 0.3) / 1.01 + rng.normal(0, 0.1, len(t))
    rows = steady_minutes(frame)
    assert list(rows["setpoint_degC"]) == [40.0, 80.0, 120.0]
    assert rows["prt_degC"].to_numpy() == pytest.approx([40, 80, 120], abs=0.1)
    line = fit_static_lines(rows).lines["a"]
    assert line.gain == pytest.approx(1.01, abs=0.002)  # three means good to 0.02 degC over 80 degC
    with pytest.raises(InputError, match="no steady stretch"):
        steady_minutes(frame[t < 1200])
    log = read_log(write_log(frame, tmp_path / "oven.csv"), "oven")
    assert len(log.frame) == 3
    assert "3 steady minutes" in log.warnings[0]


def test_a_line_knows_where_it_extrapolates():
    line = StaticLine(
        gain=1.01, offset=-0.2, covariance=((1e-6, -9e-5), (-9e-5, 0.01)), range_degC=(20.0, 160.0)
    )
    assert outside_range(line, [10.0, 100.0, 170.0]).tolist() == [True, False, True]
    assert apply_static([100.0, np.nan], line) == pytest.approx([100.8, np.nan], nan_ok=True)


def test_uncertainty_of_a_reading_is_smallest_in_the_middle_of_the_oven():
    line = fit_static_lines(oven_frame()).lines["a"]
    low, middle, high = static_u(line, [20.0, 90.0, 160.0])
    assert middle < low
    assert middle < high
    assert middle == pytest.approx(
        line.residual_sd_degC / np.sqrt(24) * 1.06, rel=0.02
    )  # s/sqrt(n), t(22)/1.96


def test_two_rows_are_too_few():
    with pytest.raises(InputError, match="at least 3"):
        fit_static_lines(oven_frame().iloc[:2])
