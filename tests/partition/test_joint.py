"""The joint fit against rigs of known truth, and the linear error propagation of its budget."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.estimation import minimise
from tcdyn.partition import joint
from tcdyn.partition.joint import joint_fits, joint_problem, main_covariance
from tcdyn.partition.profile import rim_table
from tcdyn.partition.steady import steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.simulate.truth import RigTruth, draw_truth
from tests.partition.study_rigs import QUICK, study_rig
from tests.partition.world_study import world_rig


@pytest.mark.study
def test_joint_fit_recovers_beta_h_and_lag_without_a_speed_law() -> None:
    """The start is off by 0.06 and 40 %, the lag of the record by 0.1 s."""
    study = study_rig(5, "D4", uncertain=False, lag_error_s=0.1)
    start = {
        "fast": (study.true_values["beta"] + 0.06, 1000.0),
        "slow": (1 - study.true_values["beta"] + 0.06, 400.0),
    }
    fits, both = joint_fits(study.test, start)
    for disk, fit in fits.items():
        lag = fit.estimates["lag_s"]
        beta = fit.estimates["beta"]
        # one rig: three standard uncertainties
        assert abs(beta.value - study.true_values["beta"]) < 3 * beta.u
        assert abs(lag.value - study.truth.disk(disk).common_lag_s) < 3 * lag.u
        assert lag.u < 0.03  # the 0.05 s of the record, improved by the unloading
    assert both.estimates["beta"].u < fits["fast"].estimates["beta"].u


@pytest.mark.study
def test_third_lag_of_the_record_is_kept_in_the_joint_fit() -> None:
    """The smaller of two lags is written as two: their sum and the fitted common lag stay the
    same."""
    study = study_rig(5, "D4", uncertain=False)
    third_lag_s = 0.02
    chains = {
        name: tuple(
            replace(c, taus_s=(c.taus_s[0], c.taus_s[1] - third_lag_s, third_lag_s))
            for c in disk.chains
        )
        for name, disk in study.test.disks.items()
    }
    disks = {name: replace(disk, chains=chains[name]) for name, disk in study.test.disks.items()}
    start = {
        "fast": (study.true_values["beta"], 700.0),
        "slow": (1 - study.true_values["beta"], 300.0),
    }
    two_lags, three_lags = (
        joint_fits(test, start)[0] for test in (study.test, replace(study.test, disks=disks))
    )
    for name, fit in three_lags.items():
        assert len(fit.chain.taus_s) == 3
        assert fit.chain.taus_s[2] == pytest.approx(third_lag_s)
        expected = two_lags[name].estimates["lag_s"]
        # within its uncertainty: the prior of the second lag follows the second lag of the record
        assert abs(fit.estimates["lag_s"].value - expected.value) < expected.u


@pytest.mark.study
def test_joint_fit_of_a_short_cooling_reaches_the_minimum() -> None:
    """With 0.2 s of cooling, full Gauss-Newton steps of the second lag oscillate.

    The sum of squares is within 0.05 of the minimum of another minimiser on a table of the model
    (accurate to 0.01): a twentieth of a squared standard uncertainty.
    """
    fits, _ = joint_fits(*study_with_start(), 0.2)
    for fit in fits.values():
        estimates = fit.estimates
        table = rim_table(fit.block, [fit.theta], estimates["h"].u, estimates["lag_s"].u)
        problem = joint_problem([table])
        zeros = np.zeros(problem.size - 4)
        at_fit = minimise(
            problem, np.concatenate([fit.theta, zeros]), fixed=np.eye(problem.size)[:4]
        )
        best = minimise(problem, np.concatenate([fit.theta, zeros]))
        assert at_fit.cost < best.cost + 0.05


@pytest.mark.study
def test_fit_that_cannot_separate_beta_from_h_raises() -> None:
    """Without friction power the share has no effect; here its column equals that of h."""
    fit = joint_fits(*study_with_start())[0]["fast"]
    problem = joint_problem([fit.block])
    best = minimise(problem, np.concatenate([fit.theta, np.zeros(problem.size - 4)]), limit=0)
    jacobian = best.jacobian.copy()
    jacobian[:, 0] = jacobian[:, 1]
    with pytest.raises(
        InputError, match="do not separate heat partition from heat transfer coefficient"
    ):
        main_covariance(replace(best, jacobian=jacobian), [fit.block])


def study_with_start() -> Any:
    study = study_rig(1002, "D4")
    return study.test, steady_lines(study.test, fit_rows(study.test, 10.0))[1].starts


def with_one_sigma_change(truth: RigTruth, name: str) -> RigTruth:
    """Return the rig with one property changed by one standard uncertainty of the default rig
    file."""
    kind, _, channel = name.partition(" ")

    def on_both(change: Any) -> RigTruth:
        return replace(
            truth,
            fast=replace(truth.fast, setup=change(truth.fast.setup)),
            slow=replace(truth.slow, setup=change(truth.slow.setup)),
        )

    if kind == "depth":

        def deeper(setup: Any) -> Any:
            junctions = dict(setup.junctions)
            depth_m = junctions[channel].depth_m + 1e-4
            junctions[channel] = replace(junctions[channel], depth_m=depth_m)
            return replace(setup, junctions=junctions)

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
    }[name]()


@pytest.mark.long
@pytest.mark.study
def test_budget_shifts_match_those_of_the_simulated_disk() -> None:
    """A change of each nuisance parameter in the simulated rig shifts lines and joint fits by the
    linear prediction.

    The rig is the full disk with an independent solver. Tolerance: a fifth of the shift (curvature
    of a three-sigma model at one sigma) plus 0.0006 in share, the repeatability of the same noise
    through another disk.
    """
    truth = draw_truth(1, exponent=0.667)
    options = replace(QUICK, beta=0.7, h_fast_W_m2K=720.0)

    def fits_of(true: RigTruth) -> Any:
        study = study_rig(1, "B3", truth=true, options=options, lag_error_s=0.0)
        lines, speed = steady_lines(study.test, fit_rows(study.test, 10.0))
        return lines, joint_fits(study.test, speed.starts)[0]

    base_lines, base = fits_of(truth)
    for name in (
        "depth a",
        "depth e",
        "depth b",
        "conductivity",
        "heat capacity",
        "washer",
        "friction",
        "ambient",
    ):
        lines, fits = fits_of(with_one_sigma_change(truth, name))
        for disk in ("fast", "slow"):
            h = base[disk].h_W_m2K
            k = [parameter.name for parameter in base_lines[disk].sensitivity.parameters].index(
                name
            )
            predicted = base_lines[disk].sensitivity.per_sd[k] @ np.array([1.0, h])
            assert lines[disk].line.at(h) - base_lines[disk].line.at(h) == pytest.approx(
                predicted, rel=0.2, abs=6e-4
            )
            k = [parameter.name for parameter in base[disk].sensitivity.parameters].index(name)
            predicted = base[disk].sensitivity.per_sd[k][0]
            assert fits[disk].share - base[disk].share == pytest.approx(
                predicted, rel=0.2, abs=6e-4
            )


@pytest.mark.study
def test_nonuniform_surface_h_changes_h_within_its_u_and_beta_little() -> None:
    """Strips of 1.25, 0.5 and 1.25 h across the surface, by an independent solver."""
    study = world_rig(7202, "film off the track")
    _, speed = steady_lines(study.test, fit_rows(study.test, 10.0))
    _, both = joint_fits(study.test, speed.starts)
    for name, largest in (("beta", 2.0), ("h_fast", 2.5), ("h_slow", 2.5)):
        estimate = both.estimates[name]
        assert abs(estimate.value - study.true_values[name]) < largest * estimate.u, name
    disks = {
        d: replace(
            traces, uncertainty=traces.uncertainty.model_copy(update={"film_along_rel": 0.0})
        )
        for d, traces in study.test.disks.items()
    }
    _, without_nonuniformity = joint_fits(replace(study.test, disks=disks), speed.starts)
    assert without_nonuniformity.estimates["h_fast"].u < 0.92 * both.estimates["h_fast"].u
    assert without_nonuniformity.estimates["beta"].u > 0.93 * both.estimates["beta"].u


@pytest.mark.study
def test_converged_fit_agrees_with_one_of_more_passes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The lag of the record is half a standard uncertainty off, the start about as far as that of
    the speed law."""
    study = study_rig(5, "D4", uncertain=False, lag_error_s=0.025)
    passes: list[str] = []
    original_block = joint.disk_block

    def counting_block(test: Any, disk: Any, *rest: Any) -> Any:
        passes.append(disk.name)
        return original_block(test, disk, *rest)

    monkeypatch.setattr(joint, "disk_block", counting_block)
    fits = {}
    for tolerance in (joint.CONVERGED_U, 0.0):
        monkeypatch.setattr(joint, "CONVERGED_U", tolerance)
        for disk, share, h in (
            ("fast", study.true_values["beta"] + 0.01, 750.0),
            ("slow", 0.99 - study.true_values["beta"], 300.0),
        ):
            fits[disk, tolerance] = joint.disk_fit(
                study.test, study.test.disks[disk], share, h, 10.0, "modal"
            )
    assert len(passes) < 12  # of three passes for each fit
    for disk in ("fast", "slow"):
        converged, reference = (fits[disk, tolerance].estimates for tolerance in (0.1, 0.0))
        for name, estimate in converged.items():
            assert abs(estimate.value - reference[name].value) < 0.01 * estimate.u
            assert estimate.u == pytest.approx(reference[name].u, rel=0.01)
