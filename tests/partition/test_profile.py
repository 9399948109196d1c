"""Profiles of the joint fits: parabolic if all is normal, skewed or open otherwise, and their
coverage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy import stats

from tcdyn.core.estimate import Z95
from tcdyn.estimation import Problem
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import CombinedFit, DiskFit, joint_fits, joint_problem
from tcdyn.partition.profile import intervals, joint_profiles, profiles_file, rim_table
from tcdyn.partition.steady import steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.rig.disk import DISKS
from tcdyn.workflows.beta_tables import interval_table
from tests.partition.study_rigs import StudyRig, study_rig

Array = NDArray[np.float64]
JointFits = tuple[dict[str, DiskFit], CombinedFit]


def joint_fits_of(
    study: StudyRig, window_s: float = 10.0, test: EhlTest | None = None
) -> JointFits:
    """Joint fits of a study rig, started from the speed law."""
    _, speed = steady_lines(study.test, fit_rows(study.test, window_s))
    test = study.test if test is None else test
    return joint_fits(test, speed.starts, window_s)


def without_lag_prior(test: EhlTest) -> EhlTest:
    """Return the test with a common lag known to 2 s only, three times its value."""
    disks = {
        k: replace(d, lag_covariance_s2=d.lag_covariance_s2 + 4.0) for k, d in test.disks.items()
    }
    return replace(test, disks=disks)


@pytest.fixture(scope="module")
def rig() -> StudyRig:
    return study_rig(5, "B3")


@pytest.fixture(scope="module")
def fits(rig: StudyRig) -> JointFits:
    return joint_fits_of(rig)


@pytest.fixture(scope="module")
def table(fits: JointFits) -> pd.DataFrame:
    return joint_profiles(*fits)


def disk_problems(fit: DiskFit) -> tuple[Problem, Problem]:
    """Posterior of one disk by the rim model and by its table."""
    e = fit.estimates
    table = rim_table(fit.block, [fit.theta], e["h"].u, e["lag_s"].u)
    return joint_problem([fit.block]), joint_problem([table])


def cost(problem: Problem, main: Array) -> float:
    """Sum of squares at ``main`` (4,), minimised over the nuisance parameters by one linear step,
    which is exact."""
    theta = np.concatenate([main, np.zeros(problem.size - 4)])
    evaluated = problem.evaluate(theta)
    assert evaluated is not None
    residual = evaluated[0]
    nuisance_jacobian = evaluated[1][:, 4:]
    nuisance_precision = problem.precision[4:]
    best = -np.linalg.solve(
        nuisance_jacobian.T @ nuisance_jacobian + np.diag(nuisance_precision),
        nuisance_jacobian.T @ residual,
    )
    prior = problem.precision[:4] @ (theta - problem.prior_mean)[:4] ** 2
    return float(
        np.sum((residual + nuisance_jacobian @ best) ** 2) + nuisance_precision @ best**2 + prior
    )


@pytest.mark.study
def test_table_reproduces_the_sum_of_squares_of_the_rim_model(fits: JointFits) -> None:
    """Sum of squares of table and rim model, minimised over the nuisance parameters, within two
    sigma: to 0.01.

    A hundredth of the 3.84 that bounds an interval moves its end by 0.13 %. The part of the data
    outside the table's directions is constant.
    """
    joint, _ = fits
    rng = np.random.default_rng(1)
    for fit in joint.values():
        rim, table = disk_problems(fit)
        e = fit.estimates
        for _ in range(4):
            p = fit.theta + rng.uniform(-2, 2, 4) * [e["beta"].u, e["h"].u / fit.h_W_m2K, 0.02, 0.3]
            assert cost(table, p) == pytest.approx(cost(rim, p), abs=0.01)


@pytest.mark.parametrize("kind", ["rim", "table"])
def test_jacobian_matches_central_differences(fits: JointFits, kind: str) -> None:
    """Central differences of 1e-5: errors of 1e-10 by curvature and 1e-8 by rounding of thousands
    of sigma.

    The derivative of the rim model by log h is a forward difference of 1e-5, accurate to 5e-6 by
    curvature and as much by rounding. Its derivative by a lag comes from the lag basis, accurate to
    1e-6.
    """
    joint, _ = fits
    problem = disk_problems(joint["slow"])[kind == "table"]
    theta = np.concatenate([joint["slow"].theta, np.zeros(problem.size - 4)])
    evaluated = problem.evaluate(theta)
    assert evaluated is not None
    for k, step in enumerate(1e-5 * np.eye(problem.size)[:4]):
        up = problem.evaluate(theta + step)
        down = problem.evaluate(theta - step)
        assert up is not None
        assert down is not None
        slope = evaluated[1][:, k]
        tolerance = (1e-5 if kind == "rim" else 1e-7) * np.abs(slope).max()
        np.testing.assert_allclose((up[0] - down[0]) / 2e-5, slope, atol=tolerance)


def test_evaluation_outside_the_table_returns_none(fits: JointFits) -> None:
    fit = fits[0]["fast"]
    far = np.concatenate([fit.theta, np.zeros(disk_problems(fit)[1].size - 4)])
    far[1] += np.log(100.0)
    assert disk_problems(fit)[1].evaluate(far) is None


def test_profiles_have_one_minimum_at_the_joint_fit(fits: JointFits, table: pd.DataFrame) -> None:
    """The minimum agrees with the joint fit within 0.02 u, from the accuracy of 0.01 of the
    table."""
    joint, both = fits
    estimates_by_fit = {
        "fast": joint["fast"].estimates,
        "slow": joint["slow"].estimates,
        "both": both.estimates,
    }
    expected = {(fit, name) for fit, estimates in estimates_by_fit.items() for name in estimates}
    assert set(zip(table["fit"], table["parameter"])) == expected
    assert (table["deviance"] >= 0).all()
    for (fit, parameter), profile in table.groupby(["fit", "parameter"]):
        e = estimates_by_fit[fit][parameter]
        deviance = profile["deviance"].to_numpy()
        k = int(np.argmin(deviance))
        assert abs(profile["value"].to_numpy()[k] - e.value) < 0.02 * e.u
        assert (np.diff(deviance[k:]) > 0).all()  # a single minimum
        assert (np.diff(deviance[: k + 1]) < 0).all()


def test_profile_intervals_of_a_normal_test_match_the_covariance(table: pd.DataFrame) -> None:
    """Half-widths within 6 %, for the model's curvature over two sigma, 8 to 16 % of h.

    Each end within a tenth; twice that for the exponent, whose quotient of two h is skewed by two
    sigma times u(h)/h of the slow disk, 8 %.
    """
    for interval in intervals(table):
        estimate = interval.estimate
        assert interval.low95 is not None
        assert interval.high95 is not None
        assert 0.5 * (interval.high95 - interval.low95) == pytest.approx(Z95 * estimate.u, rel=0.06)
        allowed = 0.2 if interval.parameter == "exponent" else 0.1
        assert (
            max(abs(interval.low95 - estimate.low95), abs(interval.high95 - estimate.high95))
            < allowed * Z95 * estimate.u
        )
        assert interval.sentence == ""


@pytest.mark.study
def test_slow_waves_widen_profile_and_covariance_alike(rig: StudyRig) -> None:
    """Waves of 0.1 K and 3 s on a, c, e: the profile uses the same inflation as the covariance.

    Half-widths within 6 %, as without waves. Without the inflation, the widths governed by noise,
    here the lag, would be too small by its square root.
    """
    disks = {}
    for name, traces in rig.test.disks.items():
        t = rig.test.time_s[:, None]
        wave = 0.1 * np.sin(2 * np.pi * t / 3.0 + np.arange(6)) * np.isin(np.arange(6), [0, 2, 4])
        disks[name] = replace(traces, readings_degC=traces.readings_degC + wave)
    joint, both = joint_fits_of(rig, test=replace(rig.test, disks=disks))
    assert joint["slow"].inflation > 2.0
    for interval in intervals(joint_profiles(joint, both)):
        assert interval.low95 is not None
        assert interval.high95 is not None
        if interval.parameter != "exponent":
            assert 0.5 * (interval.high95 - interval.low95) == pytest.approx(
                Z95 * interval.estimate.u, rel=0.06
            )


@pytest.mark.study
def test_weakly_determined_lag_has_a_skewed_profile_and_a_message(rig: StudyRig) -> None:
    """0.3 s of cooling, lags of 0.7 s, no prior: the data exclude a shorter lag but not a longer
    one."""
    joint, both = joint_fits_of(rig, 0.3, without_lag_prior(rig.test))
    profile_intervals = {(i.fit, i.parameter): i for i in intervals(joint_profiles(joint, both))}
    lag = profile_intervals["slow", "lag_s"]
    assert lag.low95 is not None
    assert lag.high95 is not None
    above = lag.high95 - lag.estimate.value
    below = lag.estimate.value - lag.low95
    assert above > 2 * below
    assert "the lag" in lag.sentence
    assert "by its profile" in lag.sentence
    truth = rig.truth.disk("slow").common_lag_s
    assert lag.low95 < truth < lag.high95


@pytest.mark.study
def test_undetermined_lag_is_reported_as_unbounded(rig: StudyRig) -> None:
    """Four samples of cooling and no prior: any lag fits. Message and file (null) report it."""
    joint, both = joint_fits_of(rig, 0.05, without_lag_prior(rig.test))
    profiles = joint_profiles(joint, both)
    lag = next(i for i in intervals(profiles) if (i.fit, i.parameter) == ("slow", "lag_s"))
    assert lag.low95 is None
    assert "the data do not bound the lag from below" in lag.sentence
    assert profiles_file(profiles)["slow"]["lag_s"]["low95"] is None
    cells = interval_table(profiles).set_index(["joint fit", "number"])
    assert cells.loc[("slow disk", "lag [s]"), "95 %, profile"].startswith("open")


@pytest.mark.long
@pytest.mark.study
def test_profile_intervals_have_the_stated_coverage(draws: Callable[[int], int]) -> None:
    """Ten quantities on 24 drawn rigs; each count is at least the 0.1 % point of the binomial law
    for 93 %."""
    count = draws(24)
    min_covered = stats.binom.ppf(0.001, count, 0.93)
    covered: dict[tuple[str, str], int] = {}
    for seed in range(2000, 2000 + count):
        study = study_rig(seed, "B3")
        values = study.true_values
        truth = {("both", "beta"): values["beta"], ("both", "exponent"): study.truth.speed_exponent}
        for d in DISKS:
            truth |= {
                (d, "beta"): values["beta"],
                (d, "h"): values[f"h_{d}"],
                ("both", f"h_{d}"): values[f"h_{d}"],
            }
            truth[d, "lag_s"] = study.truth.disk(d).common_lag_s
        for interval in intervals(joint_profiles(*joint_fits_of(study))):
            low = -np.inf if interval.low95 is None else interval.low95
            high = np.inf if interval.high95 is None else interval.high95
            key = (interval.fit, interval.parameter)
            covered[key] = covered.get(key, 0) + int(low <= truth[key] <= high)
    assert min(covered.values()) >= min_covered, covered
