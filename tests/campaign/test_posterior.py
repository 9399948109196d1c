"""One posterior for all tests of a rig: as the dense normal equations have it, honest, quick, and of one rig only."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from scipy import stats

from calibration.static_lines import fit_static_lines
from tcdyn.campaign import (
    SufficientStatistics,
    joined,
    rig_fingerprint,
    solve_campaign,
    verify_checksum,
)
from tcdyn.campaign.exponent import speed_law
from tcdyn.campaign.line_fit import fit_generalised_line
from tcdyn.campaign.outliers import outlying_tests
from tcdyn.campaign.posterior import LAG_TEST_SD_S, N_QUANTITIES, Posterior, u_if_known
from tcdyn.campaign.result import junction_depths
from tcdyn.campaign.sufficient_statistics import Loading
from tcdyn.campaign.tables import paper_csv, paper_latex, paper_table
from tcdyn.campaign.trends import Curve, curve_test, read_curve, trend
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.checksum import with_checksum
from tcdyn.rig.disk import DISKS
from tcdyn.rig.record import DiskRecord, now_utc
from tcdyn.rig.rigfile import load_rig, parse_rig
from tcdyn.simulate.measure import simulate_oven
from tests.campaign.toy import EXPONENT, PER_M_S, PER_N, Toy, answer_of, toy

CHANCE = 1e-4  # of a false failure of a count below


def dense(tests: tuple[SufficientStatistics, ...]) -> tuple[Array, Array]:
    """Answers (5 N,) and covariance by one least-squares problem in all unknowns, nothing eliminated."""
    shared = list(
        dict.fromkeys(
            [
                *(
                    s
                    for t in tests
                    for n in t.names[N_QUANTITIES:]
                    for s in t.loading.get(n, Loading({n: 1.0})).shared
                ),
                *(f"common lag {d}" for d in DISKS),
            ]
        )
    )
    own = sum(len(t.names) - N_QUANTITIES for t in tests)
    size, at = N_QUANTITIES * len(tests) + own + len(shared), N_QUANTITIES * len(tests)
    rows, right = [], []
    for i, t in enumerate(tests):
        q = t.names[N_QUANTITIES:]
        block = np.zeros((len(t.rows), size))
        block[:, N_QUANTITIES * i : N_QUANTITIES * (i + 1)] = t.rows[:, :N_QUANTITIES]
        for k, name in enumerate(q):
            each = t.loading.get(name, Loading({name: 1.0}))
            block[:, at + k] = each.specific * t.rows[:, N_QUANTITIES + k]
            for s, x in each.shared.items():
                block[:, N_QUANTITIES * len(tests) + own + shared.index(s)] += (
                    x * t.rows[:, N_QUANTITIES + k]
                )
        at += len(q)
        rows.append(block)
        right.append(t.rhs + t.rows @ t.centre)
        for k, d in enumerate(DISKS):  # lag - prior = sqrt(u^2 - own^2) s + own e
            line = np.zeros(size)
            line[N_QUANTITIES * i + 3 + k] = 1 / LAG_TEST_SD_S
            line[N_QUANTITIES * len(tests) + own + shared.index(f"common lag {d}")] = (
                -np.sqrt(t.lag_u_s[d] ** 2 - LAG_TEST_SD_S**2) / LAG_TEST_SD_S
            )
            rows.append(line[None])
            right.append(np.array([t.lag_prior_s[d] / LAG_TEST_SD_S]))
    priors = np.eye(size)[N_QUANTITIES * len(tests) :]
    table, values = np.vstack([*rows, priors]), np.concatenate([*right, np.zeros(len(priors))])
    scale = np.abs(table).max(axis=0)
    covariance = np.linalg.inv((table / scale).T @ (table / scale)) / np.outer(scale, scale)
    n = N_QUANTITIES * len(tests)
    return (covariance @ (table.T @ values))[:n], covariance[:n, :n]


def test_eliminating_test_by_test_gives_what_all_unknowns_at_once_give() -> None:
    made = toy(1, 5)
    found = solve_campaign(made.kept)
    answers, covariance = dense(made.kept)
    assert found.values.ravel() == pytest.approx(answers, abs=1e-8)
    assert found.covariance == pytest.approx(covariance, rel=1e-5, abs=1e-12)


def errors(made: Toy, found: Posterior) -> tuple[float, float]:
    """Squared lengths of the errors of all beta, and of their differences from the mean, by their own covariance."""
    off, c = found.beta[0] - made.answers[:, 0], found.beta[1]
    h = np.eye(len(off)) - 1 / len(off)
    apart = h @ off
    return float(off @ np.linalg.solve(c, off)), float(apart @ np.linalg.pinv(h @ c @ h) @ apart)


def test_intervals_hold_absolute_and_within_the_campaign() -> None:
    """Chi-squared of both over forty rigs drawn from what they state: 16 and 15 degrees of freedom each."""
    whole, inside = np.sum(
        [errors(made, solve_campaign(made.kept)) for made in map(toy, range(40))], axis=0
    )
    for total, freedom in ((whole, 640), (inside, 600)):
        low, high = stats.chi2.ppf([0.5 * CHANCE, 1 - 0.5 * CHANCE], freedom)
        assert low < total < high


def test_junctions_lie_as_much_deeper_as_is_said_in_millimetres_and_their_pulls_are_standard() -> (
    None
):
    """Of 40 standard deviates the rms is within 0.35 of one, three sigma, their 0.1 mm being the statement's own u."""
    off, pull = [], []
    for seed in range(20):
        made = toy(seed, 8)
        deeper, pulls = junction_depths(solve_campaign(made.kept))
        for d in DISKS:
            assert set(deeper[d]) == {"e"}
            off.append(
                (deeper[d]["e"].value - 0.1 * made.shared[f"depth e {d}"]) / deeper[d]["e"].u
            )
            pull.append(pulls[d]["e"])
    assert np.sqrt(np.mean(np.square([off, pull]), axis=1)) == pytest.approx([1.0, 1.0], abs=0.35)


def test_differences_are_known_better_than_levels_and_a_campaign_better_than_one_test() -> None:
    made = toy(2)
    one, many = solve_campaign(made.kept[:1]).estimates[0], solve_campaign(made.kept).estimates[0]
    assert many["beta"].u < one["beta"].u
    assert many["beta_within"].u < 0.5 * many["beta"].u
    assert one["beta_within"].u == one["beta"].u  # alone there is nothing to differ from


def test_a_hundred_tests_take_less_than_two_seconds_and_one_more_a_tenth() -> None:
    """Processor time of this process, the least of three: other programs may use the machine."""
    made = toy(3, 101)
    solved, seconds = best_of_three(lambda: solve_campaign(made.kept[:100]))
    assert seconds < 2.0
    more, seconds = best_of_three(lambda: solve_campaign(made.kept, solved.reduced_tests))
    assert seconds < 0.1
    assert more.values == pytest.approx(solve_campaign(made.kept).values)


def best_of_three(job: Callable[[], Posterior]) -> tuple[Posterior, float]:
    """Result of ``job``, and the least processor time [s] of three calls."""
    seconds = []
    for _ in range(3):
        begin = process_time()
        result = job()
        seconds.append(process_time() - begin)
    return result, min(seconds)


def test_what_was_kept_reads_back() -> None:
    kept = toy(4, 2).kept[0]
    again = SufficientStatistics.from_dict(kept.name, json.loads(json.dumps(kept.to_dict())))
    assert again.names == kept.names
    assert again.rows == pytest.approx(kept.rows, rel=1e-7)
    assert again.loading.keys() == kept.loading.keys()
    for spoilt in ({"schema": "tcdyn.kept/9"}, {"rows": [[1.0]]}, {"centre": None}, {"names": []}):
        with pytest.raises(InputError, match=r"EHL_A1: .*tcdyn beta"):
            SufficientStatistics.from_dict(kept.name, {**kept.to_dict(), **spoilt})


def test_an_answer_altered_by_one_digit_is_refused_by_name() -> None:
    answer = with_checksum(answer_of(toy(5, 1).kept[0]))
    text = json.dumps(answer)
    assert verify_checksum(json.loads(text), "D4.beta.json") == answer
    digits = [k for k, c in enumerate(text) if c.isdigit()]
    rng = np.random.default_rng(0)
    for k in rng.choice(digits, 200, replace=False):
        other = text[:k] + str((int(text[k]) + 1) % 10) + text[k + 1 :]
        if json.loads(other) == answer:
            continue  # the last digit of a number that a double cannot tell apart
        with pytest.raises(InputError, match=r"^D4\.beta\.json: "):
            verify_checksum(json.loads(other), "D4.beta.json")
    with pytest.raises(InputError, match="no checksum"):
        verify_checksum({"beta": 1}, "old.beta.json")


def test_tests_of_two_rigs_are_not_mixed() -> None:
    one, other = toy(6, 2).kept, toy(7, 3, rig="another").kept
    with pytest.raises(InputError, match=r"EHL_A3 was analysed with another rig\.toml"):
        solve_campaign([*one, other[2]])


def test_a_fingerprint_is_of_the_physics() -> None:
    plain, named = load_rig(), parse_rig({"columns": {"fast_a_degC": "TC 1"}}, "rig.toml")
    deeper = parse_rig({"thermocouples": {"e": {"depth_mm": 1.3, "z_mm": 4.765}}}, "rig.toml")
    records = {d: _record(d) for d in DISKS}
    assert rig_fingerprint(plain, records) == rig_fingerprint(named, records)
    assert rig_fingerprint(plain, records) != rig_fingerprint(deeper, records)
    later = {
        d: r.model_copy(update={"created": "2030-01-01T00:00:00Z"}) for d, r in records.items()
    }
    assert rig_fingerprint(plain, records) == rig_fingerprint(plain, later)


def _record(disk: str) -> DiskRecord:
    return DiskRecord(
        disk=disk, created=now_utc(), static=fit_static_lines(simulate_oven(disk, 1)[0]).lines
    )


def test_the_exponent_is_found_from_all_tests() -> None:
    z = []
    for seed in range(30):
        law = speed_law(solve_campaign(toy(seed).kept))
        z.append((law.exponent.value - EXPONENT) / law.exponent.u)
        assert law.by_speed is not None
    assert stats.chi2.cdf(sum(x * x for x in z), len(z)) == pytest.approx(0.5, abs=0.5 - CHANCE)


def test_what_would_be_left_if_a_kind_were_known_is_what_is_left_when_it_is_known() -> None:
    made = toy(0)
    known = [
        replace(
            t,
            loading={
                **t.loading,
                **{n: Loading({}, 0.0) for n in t.names if n.startswith("depth")},
            },
        )
        for t in made.kept
    ]
    before, after = solve_campaign(made.kept), solve_campaign(known)
    assert before.inflation == after.inflation == 1.0
    toward = np.zeros(before.values.size)
    toward[::N_QUANTITIES] = 1 / len(made.kept)
    left = float(np.sqrt(toward @ after.covariance @ toward))
    assert u_if_known(before, toward)["depth"] == pytest.approx(left, rel=1e-9)
    assert left < 0.9 * np.sqrt(toward @ before.covariance @ toward)
    limits = speed_law(before).u_if_known
    assert min(limits.values()) == next(iter(limits.values())) < speed_law(before).exponent.u


def test_a_power_law_that_is_not_enough_is_seen() -> None:
    """h_slow made to rise with the speed faster than by one power: n falls by 0.2 while the speed doubles."""
    made = toy(8, noise=0.3)
    bent = []
    for t in made.kept:
        centre = t.centre.copy()
        doubled = np.log2(t.conditions["entraining_speed_m_s"] / 11.0)
        centre[2] += 0.2 * doubled * np.log(t.conditions["speed_ratio"])
        bent.append(replace(t, centre=centre))
    law = speed_law(solve_campaign(bent))
    assert law.by_speed is not None
    assert law.p_value is not None
    assert law.by_speed.low95 < -0.2 < law.by_speed.high95
    assert law.p_value < 0.01


def test_a_trend_over_load_and_speed_together_is_that_of_the_truth() -> None:
    z = []
    for seed in range(30):
        found = trend(solve_campaign(toy(seed).kept), "load_N", "sliding_speed_m_s")
        assert found is not None
        z += [(s.value - true) / s.u for s, true in zip(found.slopes, (PER_N, PER_M_S))]
    assert stats.chi2.cdf(sum(x * x for x in z), len(z)) == pytest.approx(0.5, abs=0.5 - CHANCE)


def test_a_line_that_leaves_something_out_says_so() -> None:
    found = trend(solve_campaign(toy(9).kept), "load_N")
    assert found is not None
    assert (
        found.scatter > 0.005
    )  # the sliding speed's part: 3e-3 times the spread of speeds, 3.7 m/s rms
    assert found.line_p_value < 1e-6
    assert trend(solve_campaign(toy(9).kept[:2]), "load_N") is None


def test_a_known_covariance_beats_equal_weights_where_errors_are_common() -> None:
    """A level error of 0.1 common to all leaves the slope as it is; with it unknown the slope's u is that of noise."""
    x = np.column_stack([np.ones(5), np.arange(5.0) - 2.0])
    line = fit_generalised_line(
        x, 0.5 + 0.02 * x[:, 1], 0.1**2 * np.ones((5, 5)) + 0.001**2 * np.eye(5)
    )
    assert line.estimate(1).u == pytest.approx(0.001 / np.sqrt(10), rel=1e-4)
    assert line.estimate(0).u == pytest.approx(0.1, rel=0.01)
    assert line.scatter == 0


@pytest.mark.parametrize("low", [0.95, 1.05])
def test_a_test_with_friction_off_is_named_with_its_size(low: float) -> None:
    """The log's friction is ``low`` times what it was: the friction gain of that test is 1/low - 1 off all others'."""
    made = toy(10)
    at = made.kept[6]
    k = at.names.index("friction")
    off = (1 / low - 1) / at.units["friction"]
    odd = replace(at, rhs=at.rhs + at.rows[:, k] * off)
    tests = [odd if t is at else t for t in made.kept]
    found = outlying_tests(solve_campaign(tests))
    assert [(s.name, s.cause) for s in found] == [(at.name, "friction")]
    assert abs(found[0].size.value - (1 / low - 1)) < 4 * found[0].size.u
    assert found[0].explained
    whole = joined({t.name: answer_of(t) for t in tests})
    assert whole is not None
    said = next(f.sentence for f in whole.findings if f.code == "campaign.stranger")
    assert f"{at.name} does not agree with the other tests" in said
    assert ("% low" in said) == (low < 1)
    assert at.name not in whole.to_dict()["order"]
    assert whole.to_dict()["do_not_belong"][0]["test"] == at.name


def test_sound_campaigns_name_no_test() -> None:
    named = sum(bool(outlying_tests(solve_campaign(toy(seed).kept))) for seed in range(60))
    assert named <= stats.binom.ppf(1 - CHANCE, 60, 0.05)


def test_a_model_s_curve_is_laid_over_the_tests(tmp_path: Path) -> None:
    found = solve_campaign(toy(11).kept)
    load = np.array([800.0, 2400.0])
    speed = np.array([t.conditions["sliding_speed_m_s"] for t in found.tests])
    at_one_speed = solve_campaign([t for t, u in zip(found.tests, speed) if u == 13.0])
    line = 0.70 + PER_N * (load - 1620.0) + PER_M_S * (13.0 - 15.0)
    right = curve_test(at_one_speed, Curve("m.csv", "load_N", load, line, np.zeros(2)))
    wrong = curve_test(at_one_speed, Curve("m.csv", "load_N", load, line[::-1], np.zeros(2)))
    higher = curve_test(at_one_speed, Curve("m.csv", "load_N", load, line + 0.2, np.zeros(2)))
    assert right.p_value > 1e-3
    assert wrong.shape_p_value < 1e-6
    assert higher.p_value < 1e-6 < higher.shape_p_value
    assert higher.offset.value == pytest.approx(-0.2, abs=0.05)
    with pytest.raises(InputError, match="0 tests lie within"):
        curve_test(found, Curve("m.csv", "load_N", load * 10, line, np.zeros(2)))
    path = tmp_path / "model.csv"
    path.write_text("load_N,beta\n800,0.72\n2400,0.68\n", encoding="utf-8")
    assert read_curve(path).against == "load_N"
    for text, said in (
        ("load,beta\n800,0.7\n", "nothing to lay beta over"),
        ("load_N,share\n800,1\n", "column beta is missing"),
        ("load_N,beta\n900,0.7\n800,0.7\n", "does not rise"),
        ("load_N,beta\n800,70\n900,71\n", "not a share"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=said):
            read_curve(path)


def test_the_answer_of_a_campaign_is_data_and_tables() -> None:
    made = toy(12)
    whole = joined(
        {t.name: answer_of(t) for t in made.kept} | {"EHL_X": {"status": "withheld", "kept": None}}
    )
    assert whole is not None
    data = whole.to_dict()
    assert list(data["tests"]) == data["order"] == [t.name for t in made.kept]
    assert np.array(data["covariance"]).shape == (16, 16)
    assert data["apart"] == {"EHL_X": "its answer is withheld"}
    assert data["trend"]["against"] == "delta_T_us_K_m_s"
    table = paper_table(whole)
    assert (table["u_beta_within"] < table["u_beta"]).all()
    assert paper_csv(whole).count("\n") == 17
    text = paper_latex(whole)
    assert text.count(r" \\") == 18
    assert text.count("{") == text.count("}")
    assert joined({"EHL_X": {"status": "withheld", "kept": None}}) is None
    deeper = whole.deeper_mm["fast"]["e"]
    assert abs(deeper.value - 0.1 * made.shared["depth e fast"]) < 4 * deeper.u
