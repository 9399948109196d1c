"""Static lines: coverage of the intervals, and sensitivity of the tests."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calibration.static_lines import error_statistics, fit_static_lines
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


def test_line_agrees_with_the_nist_norris_data_to_ten_digits():
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
    for value, certified_value in zip((fit.slope, fit.intercept, u[0], u[1], fit.sd), certified):
        assert value == pytest.approx(certified_value, rel=1e-10)
    assert fit.r_squared == pytest.approx(0.999993745883712, rel=1e-10)


def residual_sum_of_squares(columns, y) -> float:
    """Residual sum of squares of y on these columns."""
    return float(np.sum((y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) ** 2))


def nested_p(small, large, y) -> float:
    """p of the F test of the additional columns of the larger model."""
    n = len(y)
    n_small = small.shape[1]
    n_large = large.shape[1]
    sse_small = residual_sum_of_squares(small, y)
    sse_large = residual_sum_of_squares(large, y)
    return float(
        stats.f.sf(
            (sse_small - sse_large) / (n_large - n_small) / (sse_large / (n - n_large)),
            n_large - n_small,
            n - n_large,
        )
    )


def repeats_of_a_line() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Set point (N,), noisy y (N,) and repeat (N,) of five unevenly spaced set points in four
    repeats."""
    x = np.tile([20.0, 30.0, 80.0, 100.0, 160.0], 4)
    return (
        x,
        1.02 * x - 0.3 + np.random.default_rng(8).normal(0, 0.2, 20),
        np.repeat([0, 1, 2, 3], 5),
    )


def test_outlier_test_equals_leave_one_out_prediction():
    """Each point is left out in turn and compared with the prediction of the line through the
    others: the same p for each."""
    x, y, _ = repeats_of_a_line()
    x = np.append(x, 400.0)  # one remote point with high leverage
    y = np.append(y, 410.0)
    n = len(x)
    p = np.empty(len(x))
    for i in range(n):
        others = np.arange(n) != i
        slope, intercept, *_ = stats.linregress(x[others], y[others])
        s = np.sqrt(np.sum((y[others] - slope * x[others] - intercept) ** 2) / (n - 3))
        dx = x[others] - x[others].mean()
        u = s * np.sqrt(1 + 1 / (n - 1) + (x[i] - x[others].mean()) ** 2 / np.sum(dx**2))
        p[i] = 2 * stats.t.sf(abs(y[i] - slope * x[i] - intercept) / u, n - 3)
    order = np.argsort(p)
    for n_outliers in (1, 5, 12, 20):
        p_between = np.sqrt(p[order[n_outliers - 1]] * p[order[n_outliers]])
        assert outliers(fit_line(x, y), n * p_between) == sorted(order[:n_outliers].tolist())


def test_line_tests_are_f_tests_of_a_model_with_more_columns():
    x, y, repeat = repeats_of_a_line()
    fit = fit_line(x, y)
    line = np.column_stack([np.ones(20), x])
    assert quadratic_p(fit) == pytest.approx(
        nested_p(line, np.column_stack([line, x**2]), y), rel=1e-9
    )
    set_point_columns = (x[:, None] == np.unique(x)).astype(float)
    assert lack_of_fit_p(fit, x) == pytest.approx(nested_p(line, set_point_columns, y), rel=1e-9)
    repeat_columns = np.column_stack([(repeat[:, None] == np.arange(4)).astype(float), x])
    within, _, p = repeat_shift(fit, repeat)
    assert p == pytest.approx(nested_p(line, repeat_columns, y), rel=1e-9)
    assert within == pytest.approx(
        np.sqrt(residual_sum_of_squares(repeat_columns, y) / 15), rel=1e-9
    )
    # repeats at -3, -1, 1 and 3 times 10 kelvin with almost no noise: their mean has an uncertainty
    # of sd/sqrt(4)
    shifted = fit_line(x, y + 10.0 * (2 * repeat - 3))
    assert repeat_shift(shifted, repeat)[1] == pytest.approx(
        10 * np.std([-3, -1, 1, 3], ddof=1) / 2, rel=0.02
    )


def test_identical_repeats_have_no_shift():
    x, y, repeat = repeats_of_a_line()
    within, u, p = repeat_shift(fit_line(x, np.tile(y[:5], 4)), repeat)
    assert within > 0.1
    assert (u, p) == (0.0, pytest.approx(1.0))


def test_noise_of_the_logged_side_is_the_scatter_unexplained_by_the_known_error():
    x, y, _ = repeats_of_a_line()
    plain = fit_line(x, y)
    assert fit_line(x, y, u_y=plain.sd).slope == plain.slope  # it explains all of the scatter
    with_x_noise = fit_line(x, y, u_y=plain.sd / 2)
    # the remaining 3/4 of the residual variance is that of x: slope^2 u_x^2
    u_x2 = 0.75 * plain.sd**2 / plain.slope**2
    assert with_x_noise.slope == pytest.approx(plain.slope / (1 - u_x2 / np.var(x)), rel=1e-12)
    in_mV = fit_line(x, 40 * y, u_y=20 * plain.sd)
    assert in_mV.slope == pytest.approx(40 * with_x_noise.slope, rel=1e-12)


def test_set_points_that_differ_by_rounding_are_one_set_point():
    with pytest.raises(InputError, match="one place"):
        fit_line([1e3 * (0.1 + 0.2), 300.0, 300.0], [1.0, 2.0, 3.0])
    assert fit_line([300.001, 300.0, 300.0], [2.0, 1.0, 1.0]).slope == pytest.approx(1000.0)


def test_too_few_points_give_no_test():
    x = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    y = x + np.array([0.1, -0.1, 0.05, 0.1, -0.1])
    four = fit_line(x[:4], y[:4])
    five = fit_line(x, y)
    assert quadratic_p(four) is None
    assert quadratic_p(five) is not None
    assert lack_of_fit_p(five, [0, 0, 1, 1, 1]) is None  # a line goes through two means
    assert lack_of_fit_p(five, [0, 1, 2, 3, 3]) is None  # one difference gives no scatter
    assert lack_of_fit_p(five, [0, 0, 1, 1, 2]) is not None
    assert repeat_shift(five, [0, 0, 0, 0, 0]) == (None, 0.0, None)
    assert repeat_shift(four, [0, 0, 1, 1]) == (None, 0.0, None)
    assert repeat_shift(five, [0, 0, 1, 1, 1])[0] is not None
    assert outliers(four, 1e9) == []  # one degree of freedom remains without a point
    assert outliers(five, 1e9) == [0, 1, 2, 3, 4]


def coverage(simulated_ovens) -> dict[str, float]:
    """Coverage of the 95 % intervals of gain, offset and the corrected reading at 90 degC."""
    covered = {"gain": [], "offset": [], "at 90 degC": []}
    for frame, gain, offset in simulated_ovens:
        fit = fit_static_lines(frame)
        for k, channel in enumerate(CHANNELS):
            line = fit.lines[channel]
            covered["gain"].append(line.gain_estimate.contains(gain[k]))
            covered["offset"].append(line.offset_estimate.contains(offset[k]))
            error = apply_static((90.0 - offset[k]) / gain[k], line) - 90.0
            covered["at 90 degC"].append(abs(error) < 1.96 * static_u(line, 90.0))
    return {name: float(np.mean(hit)) for name, hit in covered.items()}


@pytest.mark.study
@pytest.mark.parametrize(
    "noise", [0.05, *(pytest.param(n, marks=pytest.mark.study) for n in (0.01, 0.2))]
)
def test_intervals_cover_in_95_percent_of_200_ovens(noise):
    rates = coverage((oven_frame(s, noise), *oven_truth(s)) for s in range(OVENS))
    # six channels share the PRT, so there are effectively between 200 and 1200 independent ovens:
    # three sigma of 200 is 4.6 %
    assert all(0.904 <= rate <= 0.996 for rate in rates.values()), rates


@pytest.mark.study
def test_intervals_cover_for_simulated_ovens_whose_minutes_share_an_error():
    def simulated_ovens():
        for seed in range(100):
            frame, true_values = simulate_oven("fast", seed=seed)
            yield (
                frame,
                np.array([true_values["gain"][c] for c in CHANNELS]),
                np.array([true_values["offset_degC"][c] for c in CHANNELS]),
            )

    rates = coverage(simulated_ovens())
    assert all(0.88 <= rate <= 1.0 for rate in rates.values()), rates  # three sigma of 100 is 6.5 %


def test_noise_of_the_logged_side_does_not_flatten_the_line():
    rng = np.random.default_rng(0)
    slopes = []
    plain = []
    for _ in range(400):
        true_degC = np.linspace(20, 160, 24)
        logged = true_degC + rng.normal(0, 8.0, 24)
        prt = true_degC + rng.uniform(-0.1, 0.1, 24)
        slopes.append(fit_line(logged, prt, u_y=PRT_U_DEGC).slope)
        plain.append(fit_line(logged, prt).slope)
    # 8 degC of noise on a spread of 42 degC reduces the plain slope by 3.5 %
    assert np.mean(plain) == pytest.approx(1 / (1 + 64 / 42.2**2), abs=0.01)
    assert np.mean(slopes) == pytest.approx(1.0, abs=3 * np.std(slopes) / 20 + 2e-3)


def test_shared_prt_error_is_stored_beside_the_lines():
    frame = oven_frame()
    without = fit_static_lines(frame)
    with_shared = fit_static_lines(frame, prt_shared_u_degC=0.05)
    for c in CHANNELS:
        assert with_shared.lines[c].covariance == without.lines[c].covariance
        assert (without.lines[c].shared_u_K, with_shared.lines[c].shared_u_K) == (0.0, 0.05)


def test_curvature_is_detected():
    frame = oven_frame()
    frame["b_degC"] += 2e-4 * (frame["b_degC"] - 90) ** 2  # up to 1 degC
    fit = fit_static_lines(frame)
    assert any("channel b: a quadratic term" in w for w in fit.warnings)
    assert any("channel b: the line does not fit" in w for w in fit.warnings)
    assert fit.lines["b"].quadratic_p < 1e-6


@pytest.mark.e2e
def test_false_alarms_have_the_nominal_rate():
    alarms = [w for s in range(100) for w in fit_static_lines(oven_frame(s)).warnings]
    # 600 channels and four tests at 1 %: 24 expected, in clusters because channels share the PRT
    assert 2 <= len(alarms) <= 70


def test_outlying_row_is_named_by_repeat_and_set_point():
    frame = oven_frame()
    row = frame.index[(frame["repeat"] == 2) & (frame["setpoint_degC"] == 80)][0]
    frame.loc[row, "d_degC"] += 1.0
    messages = fit_static_lines(frame).warnings
    assert any("channel d: repeat 2 at 80 degC lies" in w for w in messages)


def test_shift_between_repeats_is_detected_and_widens_the_offset():
    frame = oven_frame()
    shifted = frame.copy()
    shifted["c_degC"] += 0.5 * (frame["repeat"] - 2)
    fit = fit_static_lines(shifted)
    assert any("channel c: the repeats shift" in w for w in fit.warnings)
    # shifts of -0.5, 0 and 0.5 degC have a mean with an uncertainty of 0.5/sqrt(3) = 0.29 degC
    assert fit.lines["c"].offset_estimate.u > 0.25


def test_minutes_of_one_hold_count_as_one_point():
    frame = oven_frame()
    repeated = fit_static_lines(frame.loc[frame.index.repeat(6)])
    single = fit_static_lines(frame)
    for c in CHANNELS:
        assert repeated.lines[c].gain == pytest.approx(single.lines[c].gain, rel=1e-12)
        assert repeated.lines[c].offset_estimate.u == pytest.approx(
            single.lines[c].offset_estimate.u, rel=1e-9
        )


def test_table_2_6_describes_errors_before_and_after_calibration():
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


def test_steady_minutes_of_a_continuous_log_become_the_oven_rows(tmp_path):
    rng = np.random.default_rng(3)
    t = np.arange(0, 6 * 3600.0, 2.0)
    level = np.select([t < 7200, t < 14400], [40.0, 80.0], 120.0)
    prt = np.empty_like(t)
    prt[0] = 20.0
    for i in range(1, len(t)):  # an oven with a time constant of 8 minutes
        prt[i] = prt[i - 1] + (level[i] - prt[i - 1]) * 2.0 / 480.0
    frame = pd.DataFrame({"time_s": t, "prt_degC": prt + rng.normal(0, 0.01, len(t))})
    for c in CHANNELS:
        frame[f"{c}_degC"] = (prt - 0.3) / 1.01 + rng.normal(0, 0.1, len(t))
    rows = steady_minutes(frame)
    assert list(rows["setpoint_degC"]) == [40.0, 80.0, 120.0]
    assert rows["prt_degC"].to_numpy() == pytest.approx([40, 80, 120], abs=0.1)
    line = fit_static_lines(rows).lines["a"]
    # three means with u of 0.02 degC over 80 degC
    assert line.gain == pytest.approx(1.01, abs=0.002)
    with pytest.raises(InputError, match="no steady stretch"):
        steady_minutes(frame[t < 1200])
    log = read_log(write_log(frame, tmp_path / "oven.csv"), "oven")
    assert len(log.frame) == 3
    assert "3 steady minutes" in log.warnings[0]


def test_line_marks_readings_outside_its_range():
    line = StaticLine(
        gain=1.01, offset=-0.2, covariance=((1e-6, -9e-5), (-9e-5, 0.01)), range_degC=(20.0, 160.0)
    )
    assert outside_range(line, [10.0, 100.0, 170.0]).tolist() == [True, False, True]
    assert apply_static([100.0, np.nan], line) == pytest.approx([100.8, np.nan], nan_ok=True)


def test_uncertainty_of_a_reading_is_smallest_in_the_middle_of_the_range():
    line = fit_static_lines(oven_frame()).lines["a"]
    low, middle, high = static_u(line, [20.0, 90.0, 160.0])
    assert middle < low
    assert middle < high
    # s/sqrt(n), t(22)/1.96
    assert middle == pytest.approx(line.residual_sd_degC / np.sqrt(24) * 1.06, rel=0.02)


def test_two_rows_are_too_few():
    with pytest.raises(InputError, match="at least 3"):
        fit_static_lines(oven_frame().iloc[:2])
