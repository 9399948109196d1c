"""Load cell, friction transducer and bearing friction."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calibration.transducers import fit_bearing_friction, fit_transducer
from tcdyn.core.errors import InputError
from tcdyn.plots.calibration import draw_bearing
from tcdyn.plots.style import figure

LOADS = np.linspace(0, 2400, 9)


def sessions(seed, slope=240.0, shifts=(0.0, 40.0, 100.0), sd_V=8.3e-4, twist=0.0):
    """Three sessions as in figure 2.21: the zero shifts by 100 N between them."""
    rng = np.random.default_rng(seed)
    force = np.tile(LOADS, len(shifts))
    session = np.repeat(np.arange(len(shifts)), len(LOADS))
    session_slope = slope * (1 + twist * session)
    volts = (force - np.array(shifts)[session]) / session_slope + rng.normal(0, sd_V, len(force))
    return volts, force, session


def test_intervals_of_slope_and_shift_have_nominal_coverage():
    slope = []
    shift = []
    alarms = []
    for seed in range(400):
        line = fit_transducer(*sessions(seed))
        slope.append(line.slope_N_V.contains(240.0))
        shift.append(line.intercept_N["2"].contains(100.0))
        alarms.append(line.slopes_differ_p < 0.05)
    # three sigma of a 95 % (5 %) rate over 400 samples is 3.3 %
    assert 0.917 <= np.mean(slope) <= 0.983
    assert 0.917 <= np.mean(shift) <= 0.983
    assert np.mean(alarms) <= 0.083


def test_shift_between_sessions_is_that_of_figure_2_21():
    line = fit_transducer(*sessions(0))
    assert line.shift_N.value == pytest.approx(100.0, abs=3 * line.shift_N.u)
    assert line.r_squared > 0.999
    assert line.residual_sd_V == pytest.approx(8.3e-4, rel=0.5)
    assert line.findings == ()
    assert line.force_N(1.0 + 0.25, zero_V=0.25) == pytest.approx(240.0, rel=1e-3)


def test_changed_slope_is_detected():
    line = fit_transducer(*sessions(0, twist=0.002))
    assert line.slopes_differ_p < 1e-4
    assert [f.code for f in line.findings] == ["transducer.slopes_differ"]


def test_too_few_points_for_the_sessions_raise():
    with pytest.raises(InputError, match="2 a session"):
        fit_transducer([1.0, 2.0, 3.0], [0.0, 1.0, 2.0], [1, 1, 2])


def bearing_data(seed=0, noise=0.0):
    """Figure 2.25: four speeds, 800 to 2320 N, in pure rolling."""
    rng = np.random.default_rng(seed)
    speeds = np.array([774.0, 1005.0, 1238.0, 1546.0])
    loads = np.linspace(800, 2320, 6)
    rpm, load = (g.ravel() for g in np.meshgrid(speeds, loads, indexing="ij"))
    friction = 2.0 + 0.004 * rpm + 0.002 * load
    return load, friction + rng.normal(0, noise, len(load)), rpm + rng.normal(0, 1, len(load))


def test_half_of_the_measured_bearing_friction_is_added():
    fitted = fit_bearing_friction(*bearing_data())
    assert len(fitted.lines) == 4
    value, u = fitted.correction_N([800.0, 2000.0], [774.0, 1120.0])
    assert value == pytest.approx(
        0.5 * (2.0 + 0.004 * np.array([774.0, 1120.0]) + 0.002 * np.array([800, 2000])), abs=0.01
    )
    assert (u < 1e-6).all()
    assert fitted.outside([1000.0, 3000.0, 1000.0], [774.0, 774.0, 400.0]).tolist() == [
        False,
        True,
        True,
    ]


def test_each_family_of_bearing_friction_is_plotted_with_its_line():
    ax = draw_bearing(fit_bearing_friction(*bearing_data()), figure()[1][0])
    for rpm, dots, line in zip((774, 1005, 1238, 1546), ax.lines[::2], ax.lines[1::2]):
        assert float(dots.get_label().removesuffix(" rpm")) == pytest.approx(rpm, abs=3.0)
        assert line.get_xdata().tolist() == [800.0, 2320.0]
        assert line.get_ydata() == pytest.approx(
            2.0 + 0.004 * rpm + 0.002 * np.array([800.0, 2320.0]), abs=0.02
        )


def test_uncertainty_of_the_bearing_friction_follows_from_the_lines_with_student_factor():
    """On a line s^2 (1/n + (x - mean)^2/Sxx); half way between two speeds a quarter of the
    variance of each line."""
    load, friction, _ = bearing_data(1, 0.2)
    fit = fit_bearing_friction(load, friction, np.repeat([774.0, 1005.0, 1238.0, 1546.0], 6))
    x = load[:6]
    load_points = np.array([900.0, x.mean(), 2300.0])
    student_factor = stats.t.ppf(0.975, 4) / stats.norm.ppf(0.975)
    variance = []
    for y in (friction[:6], friction[6:12]):
        s2 = np.sum((y - np.polyval(np.polyfit(x, y, 1), x)) ** 2) / 4
        variance.append(
            student_factor**2
            * s2
            * (1 / 6 + (load_points - x.mean()) ** 2 / np.sum((x - x.mean()) ** 2))
        )
    assert fit.correction_N(load_points, 774.0)[1] == pytest.approx(
        0.5 * np.sqrt(variance[0]), rel=1e-6
    )
    assert fit.correction_N(load_points, 889.5)[1] == pytest.approx(
        0.5 * np.sqrt(sum(variance) / 4), rel=1e-6
    )


def test_bearing_intervals_have_nominal_coverage():
    covered = []
    for seed in range(300):
        value, u = fit_bearing_friction(*bearing_data(seed, 0.2)).correction_N(1500.0, 1005.0)
        covered.append(abs(value - 0.5 * (2.0 + 0.004 * 1005 + 3.0)) < 1.96 * u)
    # three sigma of 300 is 3.8 %; the Student factor is exact for one family only, so the upper
    # side is open
    assert np.mean(covered) > 0.912
