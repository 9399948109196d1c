"""The joint fit against rigs of known truth, and the linear errors that its budget is made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.estimation import minimise
from tcdyn.partition import joint as of_one
from tcdyn.partition.joint import joint_fits, joint_problem, main_covariance
from tcdyn.partition.profile import rim_table
from tcdyn.partition.steady import steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.simulate.truth import RigTruth, draw_truth
from tests.partition.study_rigs import QUICK, study_rig
from tests.partition.world_study import world_rig


@pytest.mark.study
def test_joint_fit_finds_beta_h_and_lag_without_a_speed_law() -> None:
    """From a start that is 0.06 and 40 % off, with a record whose lag is 0.1 s off."""
    made = study_rig(5, "D4", uncertain=False, lag_error_s=0.1)
    start = {
        "fast": (made.told["beta"] + 0.06, 1000.0),
        "slow": (1 - made.told["beta"] + 0.06, 400.0),
    }
    fits, both = joint_fits(made.test, start)
    for disk, fit in fits.items():
        lag, beta = fit.estimates["lag_s"], fit.estimates["beta"]
        assert (
            abs(beta.value - made.told["beta"]) < 3 * beta.u
        )  # one rig: three standard uncertainties
        assert abs(lag.value - made.truth.disk(disk).common_lag_s) < 3 * lag.u
        assert lag.u < 0.03  # the record's 0.05 s, sharpened by the unloading
    assert both.estimates["beta"].u < fits["fast"].estimates["beta"].u


@pytest.mark.study
def test_a_third_lag_of_the_record_stays_in_the_joint_fit() -> None:
    """Of two lags the smaller is written as two: their sum, and the lag found, stays what it was."""
    made = study_rig(5, "D4", uncertain=False)
    least = 0.02
    chains = {
        name: tuple(
            replace(c, taus_s=(c.taus_s[0], c.taus_s[1] - least, least)) for c in disk.chains
        )
        for name, disk in made.test.disks.items()
    }
    disks = {name: replace(disk, chains=chains[name]) for name, disk in made.test.disks.items()}
    start = {"fast": (made.told["beta"], 700.0), "slow": (1 - made.told["beta"], 300.0)}
    two, three = (
        joint_fits(test, start)[0] for test in (made.test, replace(made.test, disks=disks))
    )
    for name, fit in three.items():
        assert len(fit.chain.taus_s) == 3
        assert fit.chain.taus_s[2] == pytest.approx(least)
        lag = two[name].estimates["lag_s"]
        # by less than its uncertainty: what is expected of the second lag's share follows the record's second lag
        assert abs(fit.estimates["lag_s"].value - lag.value) < lag.u


@pytest.mark.study
def test_joint_fit_of_a_short_cooling_ends_at_the_least_sum_of_squares() -> None:
    """A fifth of a second, where whole Gauss-Newton steps of the second lag go to and fro without end.

    The sum of squares is within 0.05 of its least by another minimiser on a table of the model (that of the table is
    0.01): a twentieth of a standard uncertainty squared.
    """
    fits, _ = joint_fits(*_started(), 0.2)
    for fit in fits.values():
        e = fit.estimates
        table = rim_table(fit.block, [fit.theta], e["h"].u, e["lag_s"].u)
        problem = joint_problem([table])
        nothing = np.zeros(problem.size - 4)
        here = minimise(
            problem, np.concatenate([fit.theta, nothing]), fixed=np.eye(problem.size)[:4]
        )
        best = minimise(problem, np.concatenate([fit.theta, nothing]))
        assert here.cost < best.cost + 0.05


@pytest.mark.study
def test_a_fit_that_cannot_tell_share_from_h_is_refused_in_words() -> None:
    """Without friction power the share does nothing: its column is another's."""
    fit = joint_fits(*_started())[0]["fast"]
    problem = joint_problem([fit.block])
    best = minimise(problem, np.concatenate([fit.theta, np.zeros(problem.size - 4)]), limit=0)
    jacobian = best.jacobian.copy()
    jacobian[:, 0] = jacobian[:, 1]
    with pytest.raises(
        InputError, match="do not separate heat partition from heat transfer coefficient"
    ):
        main_covariance(replace(best, jacobian=jacobian), [fit.block])


def _started() -> Any:
    made = study_rig(1002, "D4")
    return made.test, steady_lines(made.test, fit_rows(made.test, 10.0))[1].starts


def moved(truth: RigTruth, what: str) -> RigTruth:
    """The rig with one property changed by one standard uncertainty of the default rig file."""
    kind, _, channel = what.partition(" ")

    def on_both(change: Any) -> RigTruth:
        return replace(
            truth,
            fast=replace(truth.fast, setup=change(truth.fast.setup)),
            slow=replace(truth.slow, setup=change(truth.slow.setup)),
        )

    if kind == "depth":

        def deeper(setup: Any) -> Any:
            joint = dict(setup.junctions)
            joint[channel] = replace(joint[channel], depth_m=joint[channel].depth_m + 1e-4)
            return replace(setup, junctions=joint)

        return on_both(deeper)
    return {
        "conductivity": lambda: on_both(
            lambda s: replace(s, conductivity_W_mK=1.03 * s.conductivity_W_mK)
        ),
        "heat capacity": lambda: on_both(
            lambda s: replace(s, specific_heat_J_kgK=1.02 * s.specific_heat_J_kgK)
        ),
        "washer": lambda: on_both(
            lambda s: replace(s, washer_conductivity_W_mK=1.2 * s.washer_conductivity_W_mK)
        ),
        "half-width": lambda: replace(truth, half_width_scale=1.03),
        "friction": lambda: replace(truth, friction_scale=1 / 1.01),
        "ambient": lambda: replace(truth, ambient_bias_K=-1.0),
    }[what]()


@pytest.mark.study
def test_errors_of_the_budget_are_those_that_the_whole_disk_makes() -> None:
    """Each nuisance, moved in the simulated rig, moves lines and joint fits as their linear shifts say.

    The rig is the whole disk with a solver of its own. Tolerance: a fifth of the shift (curvature of a three-sigma
    model in one sigma) plus 0.0006 in share, the repeatability of the same noise through another disk.
    """
    truth = draw_truth(1, exponent=0.667)
    options = replace(QUICK, beta=0.7, h_fast_W_m2K=720.0)

    def fitted(true: RigTruth) -> Any:
        made = study_rig(1, "B3", truth=true, options=options, lag_error_s=0.0)
        lines, speed = steady_lines(made.test, fit_rows(made.test, 10.0))
        return lines, joint_fits(made.test, speed.starts)[0]

    base_lines, base = fitted(truth)
    for what in (
        "depth a",
        "depth e",
        "depth b",
        "conductivity",
        "heat capacity",
        "washer",
        "friction",
        "ambient",
    ):
        lines, fits = fitted(moved(truth, what))
        for disk in ("fast", "slow"):
            h = base[disk].h_W_m2K
            k = [o.name for o in base_lines[disk].sensitivity.parameters].index(what)
            said = base_lines[disk].sensitivity.per_sd[k] @ np.array([1.0, h])
            assert lines[disk].line.at(h) - base_lines[disk].line.at(h) == pytest.approx(
                said, rel=0.2, abs=6e-4
            )
            k = [o.name for o in base[disk].sensitivity.parameters].index(what)
            said = base[disk].sensitivity.per_sd[k][0]
            assert fits[disk].share - base[disk].share == pytest.approx(said, rel=0.2, abs=6e-4)


@pytest.mark.study
def test_a_film_that_is_weak_where_the_track_is_moves_h_within_what_is_said_and_beta_hardly() -> (
    None
):
    """Strips of 1.25, 0.5 and 1.25 h across the surface, by a solver of its own."""
    made = world_rig(7202, "film off the track")
    _, speed = steady_lines(made.test, fit_rows(made.test, 10.0))
    _, both = joint_fits(made.test, speed.starts)
    for name, largest in (("beta", 2.0), ("h_fast", 2.5), ("h_slow", 2.5)):
        found = both.estimates[name]
        assert abs(found.value - made.told[name]) < largest * found.u, name
    known = {
        d: replace(x, uncertainty=x.uncertainty.model_copy(update={"film_along_rel": 0.0}))
        for d, x in made.test.disks.items()
    }
    _, sure = joint_fits(replace(made.test, disks=known), speed.starts)
    assert sure.estimates["h_fast"].u < 0.92 * both.estimates["h_fast"].u
    assert sure.estimates["beta"].u > 0.93 * both.estimates["beta"].u


@pytest.mark.study
def test_a_fit_that_a_pass_no_longer_moves_stays_where_more_passes_would_leave_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From a record whose lag is half a standard uncertainty off, and a start about as far off as the speed law's."""
    made = study_rig(5, "D4", uncertain=False, lag_error_s=0.025)
    passes: list[str] = []
    made_side = of_one.disk_block

    def counted(test: Any, disk: Any, *rest: Any) -> Any:
        passes.append(disk.name)
        return made_side(test, disk, *rest)

    monkeypatch.setattr(of_one, "disk_block", counted)
    fits = {}
    for settled in (of_one.CONVERGED_U, 0.0):
        monkeypatch.setattr(of_one, "CONVERGED_U", settled)
        for d, share, h in (
            ("fast", made.told["beta"] + 0.01, 750.0),
            ("slow", 0.99 - made.told["beta"], 300.0),
        ):
            fits[d, settled] = of_one.disk_fit(
                made.test, made.test.disks[d], share, h, 10.0, "modal"
            )
    assert len(passes) < 12  # of three for each fit
    for d in ("fast", "slow"):
        one, other = (fits[d, settled].estimates for settled in (0.1, 0.0))
        for name, e in one.items():
            assert abs(e.value - other[name].value) < 0.01 * e.u
            assert e.u == pytest.approx(other[name].u, rel=0.01)
