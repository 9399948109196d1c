"""Model forms other than the assumed one: probabilities, range of beta, and withheld impossible
results."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest

from tcdyn.core.estimate import Estimate, mixture_interval95
from tcdyn.core.findings import Severity
from tcdyn.estimation import minimise
from tcdyn.partition.analyse import Partition
from tcdyn.partition.beta_file import beta_file
from tcdyn.partition.departures import (
    MODEL_FORMS,
    STEM_SD,
    UNLOADING_MEAN_S,
    DiskAtFit,
    LinearisedFit,
    model_form_columns,
)
from tcdyn.partition.joint import LOG_H, joint_problem
from tcdyn.partition.model_forms import (
    ESTIMATORS,
    NAMED_LOG_ODDS,
    SPEED_LAW_Z,
    _nonlinear_refit,
    compare_model_forms,
)
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.partition.specified import flux_shift_effect
from tcdyn.partition.window import Perturbation
from tcdyn.plots.partition import draw_lines
from tcdyn.plots.style import figure
from tcdyn.plots.transient import draw_model_forms
from tcdyn.rig.disk import DISKS
from tcdyn.workflows import beta_tables
from tcdyn.workflows.beta import summary_of
from tests.partition.study_rigs import StudyRig, study_rig
from tests.partition.world_study import world_rig

SEED = 7000


@pytest.fixture(scope="module")
def baseline() -> tuple[StudyRig, Partition]:
    study = study_rig(SEED)
    return study, study.analyse()


@lru_cache
def analysis_in_world(name: str) -> tuple[StudyRig, Partition]:
    """Rig whose disks break one assumption, simulated by a solver independent of the fits and of
    the synthetic rig."""
    study = world_rig(SEED, name)
    return study, study.analyse()


@pytest.mark.long
@pytest.mark.study
def test_intact_test_prefers_the_assumed_model_form(baseline: tuple[StudyRig, Partition]) -> None:
    study, p = baseline
    forms = p.model_forms
    assert forms.forms[0].name == "as assumed"
    assert forms.forms[0].beta == p.combined.estimates["beta"]
    assert forms.preferred is None
    assert forms.estimate_holds
    assert forms.low95 <= study.true_values["beta"] <= forms.high95
    assert sum(forms.probability) == pytest.approx(1.0)
    # and one form for the lag of each junction
    assert len(forms.forms) == 1 + len(MODEL_FORMS) + 12


@pytest.mark.long
@pytest.mark.study
def test_prior_is_half_for_the_assumed_form_and_the_rest_shared(
    baseline: tuple[StudyRig, Partition],
) -> None:
    p = baseline[1]
    forms = p.model_forms
    exponent_u = p.test.exponent_half_range / 3**0.5
    weights = {}
    for form in forms.forms:
        likelihood = np.exp(-(form.speed_law_z**2) / 2) / np.hypot(form.exponent.u, exponent_u)
        prior = 0.5 if form.name == "as assumed" else 0.5 / (len(forms.forms) - 1)
        weights[form.name] = prior * np.exp(form.log_odds) * likelihood
    shares = np.array([weights[form.name] for form in forms.forms]) / sum(weights.values())
    assert np.asarray(forms.probability) == pytest.approx(shares, rel=1e-9)


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(
    ("world", "model_form"),
    [
        ("flux 1 mm", "flux_shift"),
        pytest.param("15 % elsewhere", "elsewhere", marks=pytest.mark.long),
    ],
)
def test_true_model_form_is_identified(world: str, model_form: str) -> None:
    _, p = analysis_in_world(world)
    best = p.model_forms.preferred
    assert best is not None
    assert best.name == model_form
    assert best.log_odds > NAMED_LOG_ODDS
    assert abs(best.speed_law_z) < SPEED_LAW_Z
    assert p.status == "warning"
    assert "structures.other" in [f.code for f in p.findings]


@pytest.mark.long
@pytest.mark.study
def test_stem_conduction_is_within_its_uncertainty() -> None:
    _, p = analysis_in_world("stem 3 %")
    (stem,) = (form for form in p.model_forms.forms if form.name == "stem")
    (size,) = stem.size
    assert abs(STEM_SD * size.value - 0.03) < 3 * STEM_SD * size.u


@pytest.mark.long
@pytest.mark.study
def test_range_follows_a_model_form_that_changes_beta() -> None:
    """A bubble that about doubles the lag of a junction changes beta of both by about 5 u; a
    message reports it."""
    study, p = analysis_in_world("bubble 0.6 s")
    both = p.combined.estimates["beta"]
    forms = p.model_forms
    assert abs(both.value - study.true_values["beta"]) > 3 * both.u
    assert forms.preferred is not None
    assert forms.preferred.name == "lag of fast_e"
    # a doubled lag is not linear: most of the error vanishes, the remainder is within about 2 u of
    # the refit
    assert abs(forms.forms[0].beta.value - study.true_values["beta"]) < 0.6 * abs(
        both.value - study.true_values["beta"]
    )
    assert not forms.estimate_holds
    assert "Do NOT trust" in p.crosscheck.sentence


@pytest.mark.long
@pytest.mark.study
def test_alternative_that_leaves_the_range_of_the_model_explains_nothing(
    baseline: tuple[StudyRig, Partition],
) -> None:
    """As in an unloading of 15 s, where the linear step gives an h of 1e300 W/m2K."""
    p = baseline[1]
    ends = np.cumsum([len(fit.block.y) for fit in p.joint.values()])
    points = tuple(fit.block.window.y.shape[1] for fit in p.joint.values())
    linear = LinearisedFit.at(p.combined.optimum, ends, points)
    columns = model_form_columns(p.test, p.joint, p.combined.theta, "h_step")["h_step"]
    first = linear(columns, 1.0)
    step = first.step.copy()
    step[LOG_H] = 700.0
    refit = _nonlinear_refit(
        p.test, p.joint, p.combined, "h_step", replace(first, step=step), linear, 1.0
    )
    assert not refit.step.any()
    assert refit.log_odds == -first.volume


@pytest.mark.long
@pytest.mark.study
def test_one_linear_step_matches_the_fit_with_one_more_parameter(
    baseline: tuple[StudyRig, Partition],
) -> None:
    _, p = baseline
    name = "faces"
    columns = model_form_columns(p.test, p.joint, p.combined.theta)[name]
    columns_by_disk = np.split(columns, [len(p.joint["fast"].block.y)])
    extra_parameter = (NuisanceParameter(name, name, True),)
    blocks = [
        replace(
            p.joint[d].block,
            parameters=(*p.joint[d].block.parameters, *extra_parameter),
            effects=np.hstack([p.joint[d].block.effects, effect]),
        )
        for d, effect in zip(DISKS, columns_by_disk)
    ]
    problem = joint_problem(blocks)
    start = np.zeros(len(problem.names))
    start[:8] = p.combined.theta
    fit = minimise(problem, start, tolerance=1e-7)
    linear_step = next(a for a in p.model_forms.forms if a.name == name)
    # the fit is not quite linear, and the step weights slow waves of the residuals slightly
    # differently
    assert linear_step.beta.value == pytest.approx(fit.theta[0], abs=0.1 * linear_step.beta.u)
    assert linear_step.size[0].value == pytest.approx(fit.value(name), abs=0.1)


@pytest.mark.long
@pytest.mark.study
def test_constant_h_change_effect_matches_the_slope_by_h(
    baseline: tuple[StudyRig, Partition],
) -> None:
    """Two formulations of one effect: air colder by (T - T_A) at the surface, and the gains of the
    rim at another h."""
    _, p = baseline
    for k, d in enumerate(DISKS):
        disk_at_fit = DiskAtFit.of(p.test, p.joint[d], p.combined.theta[4 * k : 4 * k + 4])
        h_W_m2K = disk_at_fit.h_W_m2K * np.exp([1e-3, -1e-3])
        high, low = (
            base + disk_at_fit.share * power
            for base, power in map(disk_at_fit.rim.response, h_W_m2K)
        )
        slope = (high - low) / 2e-3
        assert disk_at_fit.h_change_effect(np.ones(len(disk_at_fit.base))) == pytest.approx(
            slope, abs=0.03 * np.abs(slope).max()
        )
        assert not disk_at_fit.perturbation_effect(Perturbation()).any()


@pytest.mark.long
@pytest.mark.study
def test_lag_and_flux_shift_effects_match_finite_changes(
    baseline: tuple[StudyRig, Partition],
) -> None:
    """The lag effect over 0.05 s uses straight lines, not slopes; the flux shift effect is that of
    a finite shift."""
    _, p = baseline
    for k, d in enumerate(DISKS):
        disk_at_fit = DiskAtFit.of(p.test, p.joint[d], p.combined.theta[4 * k : 4 * k + 4])
        slopes = disk_at_fit.lag_effects()[0]
        lines = disk_at_fit.lag_effects(0.05)[0]
        # they differ most where the slope jumps
        assert np.std(lines - slopes) < 0.5 * np.std(slopes)
        expected = disk_at_fit.perturbation_effect(Perturbation(shift_m=1e-5)) / 1e-5
        assert flux_shift_effect(
            disk_at_fit.rim, disk_at_fit.share, disk_at_fit.h_W_m2K
        ) == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


def test_mean_before_unloading_is_over_the_last_ten_seconds_under_load() -> None:
    """Blocks of 1 s about the unloading at 100 s; the blocks from 90.5 to 99.5 s count."""
    block_time_s = np.arange(60.5, 140.0)
    disk = SimpleNamespace(
        fit=SimpleNamespace(
            block=SimpleNamespace(window=SimpleNamespace(block_time_s=block_time_s))
        ),
        test=SimpleNamespace(events=SimpleNamespace(unload_s=100.0)),
    )
    mean = partial(DiskAtFit.mean_before_unloading, disk)
    assert mean(block_time_s) == pytest.approx(95.0)
    before = (block_time_s > 100.0 - UNLOADING_MEAN_S) & (block_time_s < 100.0)
    assert before.sum() == 10
    # other samples do not count
    assert mean(np.where(before, 7.0, np.nan)) == 7.0


def test_mixture_interval_has_2_5_percent_below_and_above() -> None:
    components = [Estimate.normal(0.7, 0.004), Estimate.normal(0.75, 0.02)]
    weights = [0.8, 0.2]
    low, high = mixture_interval95(components, weights)
    below = [
        sum(w * NormalDist(e.value, e.u).cdf(x) for w, e in zip(weights, components))
        for x in (low, high)
    ]
    assert below == pytest.approx([0.025, 0.975], abs=1e-9)


@pytest.mark.long
@pytest.mark.study
def test_friction_in_pounds_is_identified_and_impossible_numbers_are_withheld() -> None:
    """Without this check, beta = 3.14 and h = -728 have exit code 0, or correct wiring is called
    swapped."""
    study = study_rig(SEED, log_change=lambda log: log.assign(friction_N=log["friction_N"] / 4.448))
    p = study.analyse()
    scale = next(f for f in p.findings if f.code == "power.scale")
    assert scale.numbers["units"][0] == "friction in pounds-force"
    # twice the 3 % of the steel and 1 % of the friction
    assert scale.numbers["scale"] == pytest.approx(4.448, rel=0.1)
    # shares of a power that is off by a factor of four carry no information
    assert p.status == "withheld"
    assert {"joint fast", "joint slow", "both beta"} <= p.impossible
    data = beta_file(p, {})
    text = summary_of(p)
    for d in DISKS:
        assert data["joint"][d]["beta"] == dict.fromkeys(("value", "u", "low95", "high95"))
    assert text.count("withheld") >= 2
    assert not any(f.code == "sensors.suspect" and f.severity is Severity.ERROR for f in p.findings)


@pytest.mark.long
@pytest.mark.study
def test_recommended_estimate_comes_first_in_summary_tables_and_files(
    baseline: tuple[StudyRig, Partition],
) -> None:
    _, p = baseline
    both = p.combined.estimates["beta"]
    data = beta_file(p, {})
    assert data["headline"]["beta"] == both.model_dump()
    assert data["headline"]["way"] == "joint both"
    assert data["status"] == p.status == "sound"
    assert [a["name"] for a in data["alternatives"]] == [a.name for a in p.model_forms.forms]
    assert summary_of(p).startswith(f"beta = {both} by the joint fit of both disks")
    assert beta_tables.estimates_table(p)["way"].iloc[0].startswith("joint fit of both")
    assert set(ESTIMATORS) & p.impossible == set()


@pytest.mark.long
@pytest.mark.study
def test_plot_shows_every_model_form_and_the_range(baseline: tuple[StudyRig, Partition]) -> None:
    _, p = baseline
    _, (ax,) = figure()
    draw_model_forms(p.model_forms, ax)
    assert len(ax.get_yticklabels()) == len(p.model_forms.forms)
    assert "β" in ax.get_xlabel()


@pytest.mark.long
@pytest.mark.study
def test_steady_line_points_have_95_percent_error_bars(
    baseline: tuple[StudyRig, Partition],
) -> None:
    _, p = baseline
    _, (ax,) = figure()
    draw_lines(p, ax)
    half_width = {e.value: 1.96 * e.u for e in p.estimates.values()}
    assert len(ax.containers) == 6
    for container in ax.containers:
        point, _, bars = container.lines  # type: ignore[attr-defined]
        for value, axis, segments in zip(point.get_xydata()[0], (0, 1), bars):
            assert np.abs(segments.get_segments()[0][:, axis] - value) == pytest.approx(
                [half_width[value]] * 2, rel=1e-3
            )


@pytest.mark.long
@pytest.mark.study
def test_comparison_of_model_forms_is_deterministic(baseline: tuple[StudyRig, Partition]) -> None:
    study, p = baseline  # no angular harmonic: the fitted test is the prepared one
    repeated = compare_model_forms(study.test, p.joint, p.combined)
    assert (repeated.low95, repeated.high95) == (p.model_forms.low95, p.model_forms.high95)
