"""Profiles of the joint fits: the parabola where all is normal, skewed or open where not, and their coverage."""

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
from tcdyn.partition.joint import BothFit, DiskFit, joint_fits, joint_problem
from tcdyn.partition.profile import intervals, joint_profiles, profiles_file, rim_table
from tcdyn.partition.steady import steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.rig.disk import DISKS
from tcdyn.workflows.beta_tables import interval_table
from tests.partition.study_rigs import StudyRig, study_rig

Array = NDArray[np.float64]
Fitted = tuple[dict[str, DiskFit], BothFit]


def fitted(made: StudyRig, window_s: float = 10.0, test: EhlTest | None = None) -> Fitted:
    """Joint fits of a study rig from the speed law's point."""
    _, speed = steady_lines(made.test, fit_rows(made.test, window_s))
    test = made.test if test is None else test
    return joint_fits(test, speed.starts, window_s)


def without_lag_prior(test: EhlTest) -> EhlTest:
    """The test with records that know the common lag to 2 s only, three times itself."""
    disks = {
        k: replace(d, lag_covariance_s2=d.lag_covariance_s2 + 4.0) for k, d in test.disks.items()
    }
    return replace(test, disks=disks)


@pytest.fixture(scope="module")
def rig() -> StudyRig:
    return study_rig(5, "B3")


@pytest.fixture(scope="module")
def sound(rig: StudyRig) -> Fitted:
    return fitted(rig)


@pytest.fixture(scope="module")
def table(sound: Fitted) -> pd.DataFrame:
    return joint_profiles(*sound)


def problems_of(fit: DiskFit) -> tuple[Problem, Problem]:
    """The posterior of one disk by the rim model, and by its table."""
    e = fit.estimates
    table = rim_table(fit.block, [fit.theta], e["h"].u, e["lag_s"].u)
    return joint_problem([fit.block]), joint_problem([table])


def cost(problem: Problem, main: Array) -> float:
    """Sum of squares at ``main`` (4,), what nobody measured at its best: one linear step, which is exact."""
    theta = np.concatenate([main, np.zeros(problem.size - 4)])
    done = problem.evaluate(theta)
    assert done is not None
    residual, free = done[0], done[1][:, 4:]
    known = problem.precision[4:]
    best = -np.linalg.solve(free.T @ free + np.diag(known), free.T @ residual)
    prior = problem.precision[:4] @ (theta - problem.prior_mean)[:4] ** 2
    return float(np.sum((residual + free @ best) ** 2) + known @ best**2 + prior)


@pytest.mark.study
def test_table_stands_for_the_rim_model(sound: Fitted) -> None:
    """Sum of squares of table and of rim model, nuisances at their best, at points up to two sigma off: to 0.01.

    A hundredth of the 3.84 that bounds an interval would move its end by 0.13 % of itself. What the table leaves out
    of the data's own directions is the same everywhere.
    """
    joint, _ = sound
    rng = np.random.default_rng(1)
    for fit in joint.values():
        rim, table = problems_of(fit)
        e = fit.estimates
        for _ in range(4):
            p = fit.theta + rng.uniform(-2, 2, 4) * [e["beta"].u, e["h"].u / fit.h_W_m2K, 0.02, 0.3]
            assert cost(table, p) == pytest.approx(cost(rim, p), abs=0.01)


@pytest.mark.parametrize("kind", ["rim", "table"])
def test_slopes_are_differences_of_the_residuals(sound: Fitted, kind: str) -> None:
    """Central differences of 1e-5: their own error is 1e-10 by curvature and 1e-8 by rounding of thousands of sigma.

    Of the rim itself the slope by log h is a forward difference of 1e-5, good to 5e-6 by curvature and as much by
    rounding, and that by a lag is the bank's, good to 1e-6 as the bank is.
    """
    joint, _ = sound
    problem = problems_of(joint["slow"])[kind == "table"]
    theta = np.concatenate([joint["slow"].theta, np.zeros(problem.size - 4)])
    here = problem.evaluate(theta)
    assert here is not None
    for k, e in enumerate(1e-5 * np.eye(problem.size)[:4]):
        up, down = problem.evaluate(theta + e), problem.evaluate(theta - e)
        assert up is not None
        assert down is not None
        slope = here[1][:, k]
        own = (1e-5 if kind == "rim" else 1e-7) * np.abs(slope).max()
        np.testing.assert_allclose((up[0] - down[0]) / 2e-5, slope, atol=own)


def test_nothing_is_found_outside_the_table(sound: Fitted) -> None:
    fit = sound[0]["fast"]
    far = np.concatenate([fit.theta, np.zeros(problems_of(fit)[1].size - 4)])
    far[1] += np.log(100.0)
    assert problems_of(fit)[1].evaluate(far) is None


def test_profiles_begin_at_the_joint_fit_and_rise_from_it(
    sound: Fitted, table: pd.DataFrame
) -> None:
    """The minimum is the joint fit to 0.02 u: the table's 0.01 of the sum of squares."""
    joint, both = sound
    known = {
        "fast": joint["fast"].estimates,
        "slow": joint["slow"].estimates,
        "both": both.estimates,
    }
    assert {(f, p) for f, p in zip(table["fit"], table["parameter"])} == {
        (f, p) for f in known for p in known[f]
    }
    assert (table["deviance"] >= 0).all()
    for (fit, parameter), own in table.groupby(["fit", "parameter"]):
        e = known[fit][parameter]
        deviance = own["deviance"].to_numpy()
        k = int(np.argmin(deviance))
        assert abs(own["value"].to_numpy()[k] - e.value) < 0.02 * e.u
        assert (np.diff(deviance[k:]) > 0).all()  # one valley
        assert (np.diff(deviance[: k + 1]) < 0).all()


def test_widths_of_a_sound_test_are_those_of_the_covariance(table: pd.DataFrame) -> None:
    """Half-widths within 6 %: all they differ by is the model's curvature over two sigma, 8 to 16 % of h.

    For an end it is a tenth, but for the exponent, whose quotient of two h leans to the right by u(h)/h of the slow
    disk, 8 %, times two sigma.
    """
    for i in intervals(table):
        e = i.estimate
        assert i.low95 is not None
        assert i.high95 is not None
        assert 0.5 * (i.high95 - i.low95) == pytest.approx(Z95 * e.u, rel=0.06)
        allowed = 0.2 if i.parameter == "exponent" else 0.1
        assert max(abs(i.low95 - e.low95), abs(i.high95 - e.high95)) < allowed * Z95 * e.u
        assert i.sentence == ""


@pytest.mark.study
def test_slow_waves_widen_profile_and_covariance_alike(rig: StudyRig) -> None:
    """Waves of 0.1 K and 3 s on a, c, e: the profile is then told of its inflation and stays the covariance's.

    Half-widths within 6 %, as without waves; left out, the inflation would be missed by the root of it in whatever
    noise rules, here the lag.
    """
    disks = {}
    for name, d in rig.test.disks.items():
        t = rig.test.time_s[:, None]
        wave = 0.1 * np.sin(2 * np.pi * t / 3.0 + np.arange(6)) * np.isin(np.arange(6), [0, 2, 4])
        disks[name] = replace(d, readings_degC=d.readings_degC + wave)
    joint, both = fitted(rig, test=replace(rig.test, disks=disks))
    assert joint["slow"].inflation > 2.0
    for i in intervals(joint_profiles(joint, both)):
        assert i.low95 is not None
        assert i.high95 is not None
        if i.parameter != "exponent":
            assert 0.5 * (i.high95 - i.low95) == pytest.approx(Z95 * i.estimate.u, rel=0.06)


@pytest.mark.study
def test_lag_that_the_data_hardly_tell_has_a_skewed_profile_and_a_sentence(rig: StudyRig) -> None:
    """0.3 s of cooling, lags of 0.7 s, no prior: a longer lag hides in what is not seen, a shorter one would show."""
    joint, both = fitted(rig, 0.3, without_lag_prior(rig.test))
    found = {(i.fit, i.parameter): i for i in intervals(joint_profiles(joint, both))}
    lag = found["slow", "lag_s"]
    assert lag.low95 is not None
    assert lag.high95 is not None
    above, below = lag.high95 - lag.estimate.value, lag.estimate.value - lag.low95
    assert above > 2 * below
    assert "the lag" in lag.sentence
    assert "by its profile" in lag.sentence
    truth = rig.truth.disk("slow").common_lag_s
    assert lag.low95 < truth < lag.high95


@pytest.mark.study
def test_lag_that_the_data_do_not_tell_is_called_unbounded(rig: StudyRig) -> None:
    """Four samples of cooling and no prior: any lag fits, and the sentence and the null in the file say so."""
    joint, both = fitted(rig, 0.05, without_lag_prior(rig.test))
    profiles = joint_profiles(joint, both)
    lag = next(i for i in intervals(profiles) if (i.fit, i.parameter) == ("slow", "lag_s"))
    assert lag.low95 is None
    assert "the data do not bound the lag from below" in lag.sentence
    assert profiles_file(profiles)["slow"]["lag_s"]["low95"] is None
    words = interval_table(profiles).set_index(["joint fit", "number"])
    assert words.loc[("slow disk", "lag [s]"), "95 %, profile"].startswith("open")


@pytest.mark.study
def test_profiles_hold_the_truth_as_often_as_they_say(draws: Callable[[int], int]) -> None:
    """Ten numbers on each of 24 drawn rigs: each is held at least as often as the 0.1 % point of the law for 93 %."""
    count = draws(24)
    least = stats.binom.ppf(0.001, count, 0.93)
    held: dict[tuple[str, str], int] = {}
    for seed in range(2000, 2000 + count):
        made = study_rig(seed, "B3")
        told = made.told
        truth = {("both", "beta"): told["beta"], ("both", "exponent"): made.truth.speed_exponent}
        for d in DISKS:
            truth |= {
                (d, "beta"): told["beta"],
                (d, "h"): told[f"h_{d}"],
                ("both", f"h_{d}"): told[f"h_{d}"],
            }
            truth[d, "lag_s"] = made.truth.disk(d).common_lag_s
        for i in intervals(joint_profiles(*fitted(made))):
            low = -np.inf if i.low95 is None else i.low95
            high = np.inf if i.high95 is None else i.high95
            key = (i.fit, i.parameter)
            held[key] = held.get(key, 0) + int(low <= truth[key] <= high)
    assert min(held.values()) >= least, held
