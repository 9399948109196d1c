"""Other structures than the fits assume: what the data ask for, whether the headline holds, and what cannot be true."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from statistics import NormalDist

import numpy as np
import pytest

from tcdyn.core.estimate import Estimate, mixture_interval95
from tcdyn.core.findings import Severity
from tcdyn.estimation import minimise
from tcdyn.partition.analyse import Partition
from tcdyn.partition.departures import MODEL_FORMS, STEM_SD, DiskAtFit, model_form_columns
from tcdyn.partition.joint import joint_problem
from tcdyn.partition.model_forms import ESTIMATORS, NAMED_LOG_ODDS, SPEED_LAW_Z, compare_model_forms
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
def sound() -> tuple[StudyRig, Partition]:
    made = study_rig(SEED)
    return made, made.analyse()


@lru_cache
def of_world(name: str) -> tuple[StudyRig, Partition]:
    """One rig whose disks break one assumption, by a solver that is neither the fits' nor the synthetic rig's."""
    made = world_rig(SEED, name)
    return made, made.analyse()


@pytest.mark.study
def test_a_sound_test_keeps_its_structure(sound: tuple[StudyRig, Partition]) -> None:
    made, p = sound
    s = p.model_forms
    assert s.forms[0].name == "as assumed"
    assert s.forms[0].beta == p.both.estimates["beta"]
    assert s.preferred is None
    assert s.estimate_holds
    assert s.low95 <= made.told["beta"] <= s.high95
    assert sum(s.probability) == pytest.approx(1.0)
    assert len(s.forms) == 1 + len(MODEL_FORMS) + 12  # and the lag of each junction


def test_half_of_the_prior_is_for_what_was_assumed_and_the_rest_shared(
    sound: tuple[StudyRig, Partition],
) -> None:
    p = sound[1]
    s, law_u = p.model_forms, p.test.exponent_half_range / 3**0.5
    weight = {}
    for a in s.forms:
        referee = np.exp(-(a.speed_law_z**2) / 2) / np.hypot(a.exponent.u, law_u)
        prior = 0.5 if a.name == "as assumed" else 0.5 / (len(s.forms) - 1)
        weight[a.name] = prior * np.exp(a.log_odds) * referee
    shares = np.array([weight[a.name] for a in s.forms]) / sum(weight.values())
    assert np.asarray(s.probability) == pytest.approx(shares, rel=1e-9)


@pytest.mark.study
@pytest.mark.parametrize(
    ("world", "structure"),
    [
        ("flux 1 mm", "flux_shift"),
        pytest.param("15 % elsewhere", "elsewhere", marks=pytest.mark.study),
    ],
)
def test_the_structure_that_is_there_is_named(world: str, structure: str) -> None:
    _, p = of_world(world)
    best = p.model_forms.preferred
    assert best is not None
    assert best.name == structure
    assert best.log_odds > NAMED_LOG_ODDS
    assert abs(best.speed_law_z) < SPEED_LAW_Z
    assert p.status == "warning"
    assert "structures.other" in [f.code for f in p.findings]


@pytest.mark.study
def test_what_wires_take_away_is_within_what_the_test_tells_of_it() -> None:
    _, p = of_world("stem 3 %")
    (stem,) = (a for a in p.model_forms.forms if a.name == "stem")
    (size,) = stem.size
    assert abs(STEM_SD * size.value - 0.03) < 3 * STEM_SD * size.u


@pytest.mark.study
def test_the_range_follows_a_structure_that_moves_the_answer() -> None:
    """A bubble that doubles a junction's lag moves both disks by some 5 of their u; what is printed must say so."""
    made, p = of_world("bubble x2")
    both, s = p.both.estimates["beta"], p.model_forms
    assert abs(both.value - made.told["beta"]) > 3 * both.u
    assert s.preferred is not None
    assert s.preferred.name == "lag of fast_e"
    # a lag twice as long is no longer linear: most of the error goes, what is left lies within some 2 u of the refitted
    assert abs(s.forms[0].beta.value - made.told["beta"]) < 0.6 * abs(
        both.value - made.told["beta"]
    )
    assert not s.estimate_holds
    assert "Do NOT trust" in p.crosscheck.sentence


def test_one_linear_step_is_the_fit_with_one_unknown_more(
    sound: tuple[StudyRig, Partition],
) -> None:
    _, p = sound
    name = "faces"
    columns = model_form_columns(p.test, p.joint, p.both.theta)[name]
    parts = np.split(columns, [len(p.joint["fast"].block.y)])
    extra = (NuisanceParameter(name, name, True),)
    sides = [
        replace(
            p.joint[d].block,
            parameters=(*p.joint[d].block.parameters, *extra),
            effects=np.hstack([p.joint[d].block.effects, x]),
        )
        for d, x in zip(DISKS, parts)
    ]
    problem = joint_problem(sides)
    start = np.zeros(len(problem.names))
    start[:8] = p.both.theta
    slow = minimise(problem, start, tolerance=1e-7)
    quick = next(a for a in p.model_forms.forms if a.name == name)
    # the fit is not quite linear, and the step weighs slow waves of the residuals a little otherwise
    assert quick.beta.value == pytest.approx(slow.theta[0], abs=0.1 * quick.beta.u)
    assert quick.size[0].value == pytest.approx(slow.value(name), abs=0.1)


def test_a_loss_that_is_higher_throughout_is_the_slope_of_the_answer_by_h(
    sound: tuple[StudyRig, Partition],
) -> None:
    """Two ways of one thing: an air colder by (T - T_A) at the surface, and the rim's gains at another h."""
    _, p = sound
    for k, d in enumerate(DISKS):
        a = DiskAtFit.of(p.test, p.joint[d], p.both.theta[4 * k : 4 * k + 4])
        high, low = (
            rest + a.share * power
            for rest, power in map(a.rim.response, a.h_W_m2K * np.exp([1e-3, -1e-3]))
        )
        slope = (high - low) / 2e-3
        assert a.h_change_effect(np.ones(len(a.base))) == pytest.approx(
            slope, abs=0.03 * np.abs(slope).max()
        )
        assert not a.perturbation_effect(Perturbation()).any()


def test_a_lag_and_a_flux_moved_a_little_do_what_their_slopes_say(
    sound: tuple[StudyRig, Partition],
) -> None:
    """A junction slower by a straight line, not by the readings' slope; the flux moved one way, and to both sides."""
    _, p = sound
    for k, d in enumerate(DISKS):
        a = DiskAtFit.of(p.test, p.joint[d], p.both.theta[4 * k : 4 * k + 4])
        slopes, lines = a.lag_effects()[0], a.lag_effects(0.05)[0]
        assert np.std(lines - slopes) < 0.5 * np.std(slopes)  # most of it where the slope jumps
        moved = a.perturbation_effect(Perturbation(shift_m=1e-5)) / 1e-5
        assert flux_shift_effect(a.rim, a.share, a.h_W_m2K) == pytest.approx(
            moved, abs=0.02 * np.abs(moved).max()
        )


def test_a_mixture_has_the_share_below_and_above_that_its_range_says() -> None:
    parts, weights = [Estimate.normal(0.7, 0.004), Estimate.normal(0.75, 0.02)], [0.8, 0.2]
    low, high = mixture_interval95(parts, weights)
    below = [
        sum(w * NormalDist(e.value, e.u).cdf(x) for w, e in zip(weights, parts))
        for x in (low, high)
    ]
    assert below == pytest.approx([0.025, 0.975], abs=1e-9)


@pytest.mark.study
def test_friction_in_pounds_is_found_by_the_heat_and_impossible_numbers_are_withheld() -> None:
    """Before, beta 3.14 and h -728 came with exit code 0, or sound wiring was called swapped."""
    made = study_rig(SEED, disturbed=lambda log: log.assign(friction_N=log["friction_N"] / 4.448))
    p = made.analyse()
    scale = next(f for f in p.findings if f.code == "power.scale")
    assert scale.numbers["units"][0] == "friction in pounds-force"
    assert scale.numbers["scale"] == pytest.approx(
        4.448, rel=0.1
    )  # 3 % of steel, 1 % of friction, twice
    assert p.status == "withheld"  # two shares of a power that is off by four tell nothing
    assert {"joint fast", "joint slow", "both beta"} <= p.impossible
    kept, said = beta_tables.beta_file(p, {}), summary_of(p)
    for d in DISKS:
        assert kept["joint"][d]["beta"] == dict.fromkeys(("value", "u", "low95", "high95"))
    assert said.count("withheld") >= 2
    assert not any(f.code == "sensors.suspect" and f.severity is Severity.ERROR for f in p.findings)


def test_the_headline_stands_first_in_words_tables_and_files(
    sound: tuple[StudyRig, Partition],
) -> None:
    _, p = sound
    both = p.both.estimates["beta"]
    kept = beta_tables.beta_file(p, {})
    assert kept["headline"]["beta"] == both.model_dump()
    assert kept["headline"]["way"] == "joint both"
    assert kept["status"] == p.status == "sound"
    assert [a["name"] for a in kept["alternatives"]] == [a.name for a in p.model_forms.forms]
    assert summary_of(p).startswith(f"beta = {both} by the joint fit of both disks")
    assert beta_tables.estimates_table(p)["way"].iloc[0].startswith("joint fit of both")
    assert set(ESTIMATORS) & p.impossible == set()


def test_the_picture_shows_every_structure_and_the_range(sound: tuple[StudyRig, Partition]) -> None:
    _, p = sound
    _, (ax,) = figure()
    draw_model_forms(p.model_forms, ax)
    assert len(ax.get_yticklabels()) == len(p.model_forms.forms)
    assert "β" in ax.get_xlabel()


def test_every_point_on_the_steady_lines_has_bars_of_95_percent(
    sound: tuple[StudyRig, Partition],
) -> None:
    _, p = sound
    _, (ax,) = figure()
    draw_lines(p, ax)
    told = {e.value: 1.96 * e.u for e in p.estimates.values()}
    assert len(ax.containers) == 6
    for container in ax.containers:
        point, _, bars = container.lines  # type: ignore[attr-defined]
        for at, along, segments in zip(point.get_xydata()[0], (0, 1), bars):
            assert np.abs(segments.get_segments()[0][:, along] - at) == pytest.approx(
                [told[at]] * 2, rel=1e-3
            )


def test_alternatives_are_the_same_when_asked_again(sound: tuple[StudyRig, Partition]) -> None:
    made, p = sound  # an even disk: the test that was fitted is the one that was prepared
    again = compare_model_forms(made.test, p.joint, p.both)
    assert (again.low95, again.high95) == (p.model_forms.low95, p.model_forms.high95)
