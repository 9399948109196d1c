"""One posterior for all tests of a rig: equal to the dense normal equations, with correct coverage,
and fast."""

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
    join_results,
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
from tcdyn.core.findings import Finding
from tcdyn.io.checksum import with_checksum
from tcdyn.rig.disk import DISKS
from tcdyn.rig.record import DiskRecord, now_utc
from tcdyn.rig.rigfile import load_rig, parse_rig
from tcdyn.simulate.measure import simulate_oven
from tests.campaign.toy import EXPONENT, PER_M_S, PER_N, Toy, beta_json, toy

FALSE_FAILURE_P = 1e-4  # probability of a false failure of a count below


def dense_solution(tests: tuple[SufficientStatistics, ...]) -> tuple[Array, Array]:
    """Estimates (5 N,) and covariance by one least-squares problem in all parameters, without
    elimination."""
    names = []
    for t in tests:
        for name in t.names[N_QUANTITIES:]:
            names += t.loading.get(name, Loading({name: 1.0})).shared
    names += [f"common lag {d}" for d in DISKS]
    shared = list(dict.fromkeys(names))
    n_specific = sum(len(t.names) - N_QUANTITIES for t in tests)
    size = N_QUANTITIES * len(tests) + n_specific + len(shared)
    column = N_QUANTITIES * len(tests)
    rows = []
    rhs = []
    for i, t in enumerate(tests):
        nuisance_names = t.names[N_QUANTITIES:]
        block = np.zeros((len(t.rows), size))
        block[:, N_QUANTITIES * i : N_QUANTITIES * (i + 1)] = t.rows[:, :N_QUANTITIES]
        for k, name in enumerate(nuisance_names):
            loading = t.loading.get(name, Loading({name: 1.0}))
            block[:, column + k] = loading.specific * t.rows[:, N_QUANTITIES + k]
            for s, x in loading.shared.items():
                block[:, N_QUANTITIES * len(tests) + n_specific + shared.index(s)] += (
                    x * t.rows[:, N_QUANTITIES + k]
                )
        column += len(nuisance_names)
        rows.append(block)
        rhs.append(t.rhs + t.rows @ t.centre)
        for k, d in enumerate(DISKS):  # lag - prior = sqrt(u^2 - specific^2) s + specific e
            row = np.zeros(size)
            row[N_QUANTITIES * i + 3 + k] = 1 / LAG_TEST_SD_S
            row[N_QUANTITIES * len(tests) + n_specific + shared.index(f"common lag {d}")] = (
                -np.sqrt(t.lag_u_s[d] ** 2 - LAG_TEST_SD_S**2) / LAG_TEST_SD_S
            )
            rows.append(row[None])
            rhs.append(np.array([t.lag_prior_s[d] / LAG_TEST_SD_S]))
    priors = np.eye(size)[N_QUANTITIES * len(tests) :]
    design = np.vstack([*rows, priors])
    targets = np.concatenate([*rhs, np.zeros(len(priors))])
    scale = np.abs(design).max(axis=0)
    covariance = np.linalg.inv((design / scale).T @ (design / scale)) / np.outer(scale, scale)
    n = N_QUANTITIES * len(tests)
    return (covariance @ (design.T @ targets))[:n], covariance[:n, :n]


def test_elimination_test_by_test_matches_the_dense_solution() -> None:
    campaign = toy(1, 5)
    result = solve_campaign(campaign.tests)
    expected, covariance = dense_solution(campaign.tests)
    assert result.values.ravel() == pytest.approx(expected, abs=1e-8)
    assert result.covariance == pytest.approx(covariance, rel=1e-5, abs=1e-12)


def squared_errors(campaign: Toy, posterior: Posterior) -> tuple[float, float]:
    """Squared lengths of the errors of all beta, and of their differences from the mean, by their
    covariance."""
    error = posterior.beta[0] - campaign.true_values[:, 0]
    covariance = posterior.beta[1]
    centring = np.eye(len(error)) - 1 / len(error)
    difference = centring @ error
    return float(error @ np.linalg.solve(covariance, error)), float(
        difference @ np.linalg.pinv(centring @ covariance @ centring) @ difference
    )


def test_absolute_and_within_campaign_intervals_have_the_stated_coverage() -> None:
    """Chi-squared of both over forty rigs drawn from their uncertainties: 16 and 15 degrees of
    freedom each."""
    absolute, within = np.sum(
        [
            squared_errors(campaign, solve_campaign(campaign.tests))
            for campaign in map(toy, range(40))
        ],
        axis=0,
    )
    for total, freedom in ((absolute, 640), (within, 600)):
        low, high = stats.chi2.ppf([0.5 * FALSE_FAILURE_P, 1 - 0.5 * FALSE_FAILURE_P], freedom)
        assert low < total < high


def test_junction_depths_match_the_truth_and_pulls_are_standard_normal() -> None:
    """The rms of 40 standard deviates is within 0.35 of one, three sigma. Their 0.1 mm is the
    nominal u."""
    z = []
    pull = []
    for seed in range(20):
        campaign = toy(seed, 8)
        deeper, pulls = junction_depths(solve_campaign(campaign.tests))
        for d in DISKS:
            assert set(deeper[d]) == {"e"}
            z.append(
                (deeper[d]["e"].value - 0.1 * campaign.shared[f"depth e {d}"]) / deeper[d]["e"].u
            )
            pull.append(pulls[d]["e"])
    assert np.sqrt(np.mean(np.square([z, pull]), axis=1)) == pytest.approx([1.0, 1.0], abs=0.35)


def test_differences_have_smaller_u_than_levels_and_a_campaign_than_one_test() -> None:
    campaign = toy(2)
    of_one_test = solve_campaign(campaign.tests[:1]).estimates[0]
    of_all_tests = solve_campaign(campaign.tests).estimates[0]
    assert of_all_tests["beta"].u < of_one_test["beta"].u
    assert of_all_tests["beta_within"].u < 0.5 * of_all_tests["beta"].u
    assert of_one_test["beta_within"].u == of_one_test["beta"].u  # a single test has no differences


def test_hundred_tests_take_less_than_two_seconds_and_one_more_a_tenth() -> None:
    """Processor time of this process, minimum of three runs, because other programs may use the
    machine."""
    campaign = toy(3, 101)
    solved, seconds = best_of_three(lambda: solve_campaign(campaign.tests[:100]))
    assert seconds < 2.0
    extended, seconds = best_of_three(lambda: solve_campaign(campaign.tests, solved.reduced_tests))
    assert seconds < 0.1
    assert extended.values == pytest.approx(solve_campaign(campaign.tests).values)


def best_of_three(job: Callable[[], Posterior]) -> tuple[Posterior, float]:
    """Result of ``job`` and the minimum processor time [s] of three calls."""
    seconds = []
    for _ in range(3):
        start = process_time()
        result = job()
        seconds.append(process_time() - start)
    return result, min(seconds)


def test_statistics_survive_a_json_round_trip() -> None:
    statistics = toy(4, 2).tests[0]
    restored = SufficientStatistics.from_dict(
        statistics.name, json.loads(json.dumps(statistics.to_dict()))
    )
    assert restored.names == statistics.names
    assert restored.rows == pytest.approx(statistics.rows, rel=1e-7)
    assert restored.loading.keys() == statistics.loading.keys()
    for invalid in ({"schema": "tcdyn.kept/9"}, {"rows": [[1.0]]}, {"centre": None}, {"names": []}):
        with pytest.raises(InputError, match=r"EHL_A1: .*tcdyn rig beta"):
            SufficientStatistics.from_dict(statistics.name, {**statistics.to_dict(), **invalid})


def test_file_altered_by_one_digit_raises_with_its_name() -> None:
    data = with_checksum(beta_json(toy(5, 1).tests[0]))
    text = json.dumps(data)
    assert verify_checksum(json.loads(text), "D4.beta.json") == data
    digits = [k for k, c in enumerate(text) if c.isdigit()]
    rng = np.random.default_rng(0)
    for k in rng.choice(digits, 200, replace=False):
        altered = text[:k] + str((int(text[k]) + 1) % 10) + text[k + 1 :]
        if json.loads(altered) == data:
            continue  # the last digit of a number may be beyond double precision
        with pytest.raises(InputError, match=r"^D4\.beta\.json: "):
            verify_checksum(json.loads(altered), "D4.beta.json")
    with pytest.raises(InputError, match="no checksum"):
        verify_checksum({"beta": 1}, "old.beta.json")


def test_tests_of_two_rigs_raise() -> None:
    first = toy(6, 2).tests
    second = toy(7, 3, rig="another").tests
    with pytest.raises(InputError, match=r"EHL_A3 was analysed with another rig\.toml"):
        solve_campaign([*first, second[2]])


def test_fingerprint_depends_on_the_physics_only() -> None:
    default = load_rig()
    with_column_names = parse_rig({"columns": {"fast_a_degC": "TC 1"}}, "rig.toml")
    deeper = parse_rig({"thermocouples": {"e": {"depth_mm": 1.3, "z_mm": 4.765}}}, "rig.toml")
    records = {d: _record(d) for d in DISKS}
    assert rig_fingerprint(default, records) == rig_fingerprint(with_column_names, records)
    assert rig_fingerprint(default, records) != rig_fingerprint(deeper, records)
    later_records = {
        d: r.model_copy(update={"created": "2030-01-01T00:00:00Z"}) for d, r in records.items()
    }
    assert rig_fingerprint(default, records) == rig_fingerprint(default, later_records)


def _record(disk: str) -> DiskRecord:
    return DiskRecord(
        disk=disk, created=now_utc(), static=fit_static_lines(simulate_oven(disk, 1)[0]).lines
    )


def test_exponent_is_recovered_from_all_tests() -> None:
    z = []
    for seed in range(30):
        law = speed_law(solve_campaign(toy(seed).tests))
        z.append((law.exponent.value - EXPONENT) / law.exponent.u)
        assert law.by_speed is not None
    assert stats.chi2.cdf(sum(x * x for x in z), len(z)) == pytest.approx(
        0.5, abs=0.5 - FALSE_FAILURE_P
    )


def test_u_if_known_matches_a_campaign_with_known_parameters() -> None:
    campaign = toy(0)
    known_depths = [
        replace(
            t,
            loading={
                **t.loading,
                **{n: Loading({}, 0.0) for n in t.names if n.startswith("depth")},
            },
        )
        for t in campaign.tests
    ]
    before = solve_campaign(campaign.tests)
    after = solve_campaign(known_depths)
    assert before.inflation == after.inflation == 1.0
    mean_weights = np.zeros(before.values.size)
    mean_weights[::N_QUANTITIES] = 1 / len(campaign.tests)
    u_known = float(np.sqrt(mean_weights @ after.covariance @ mean_weights))
    assert u_if_known(before, mean_weights)["depth"] == pytest.approx(u_known, rel=1e-9)
    assert u_known < 0.9 * np.sqrt(mean_weights @ before.covariance @ mean_weights)
    limits = speed_law(before).u_if_known
    assert min(limits.values()) == next(iter(limits.values())) < speed_law(before).exponent.u


def test_insufficient_power_law_is_detected() -> None:
    """h_slow increases faster with speed than by one power: n decreases by 0.2 while the speed
    doubles."""
    campaign = toy(8, noise=0.3)
    tests = []
    for t in campaign.tests:
        centre = t.centre.copy()
        doubled = np.log2(t.conditions["entraining_speed_m_s"] / 11.0)
        centre[2] += 0.2 * doubled * np.log(t.conditions["speed_ratio"])
        tests.append(replace(t, centre=centre))
    law = speed_law(solve_campaign(tests))
    assert law.by_speed is not None
    assert law.p_value is not None
    assert law.by_speed.low95 < -0.2 < law.by_speed.high95
    assert law.p_value < 0.01


def test_trend_over_load_and_speed_recovers_the_truth() -> None:
    z = []
    for seed in range(30):
        result = trend(solve_campaign(toy(seed).tests), "load_N", "sliding_speed_m_s")
        assert result is not None
        z += [(s.value - true) / s.u for s, true in zip(result.slopes, (PER_N, PER_M_S))]
    assert stats.chi2.cdf(sum(x * x for x in z), len(z)) == pytest.approx(
        0.5, abs=0.5 - FALSE_FAILURE_P
    )


def test_trend_that_omits_a_condition_has_scatter_and_a_small_p_value() -> None:
    result = trend(solve_campaign(toy(9).tests), "load_N")
    assert result is not None
    # contribution of the sliding speed: 3e-3 times the spread of speeds, 3.7 m/s rms
    assert result.scatter > 0.005
    assert result.line_p_value < 1e-6
    assert trend(solve_campaign(toy(9).tests[:2]), "load_N") is None


def test_generalised_line_removes_a_common_error_from_the_slope() -> None:
    """A common level error of 0.1 does not affect the slope, whose u is that of the noise."""
    x = np.column_stack([np.ones(5), np.arange(5.0) - 2.0])
    line = fit_generalised_line(
        x, 0.5 + 0.02 * x[:, 1], 0.1**2 * np.ones((5, 5)) + 0.001**2 * np.eye(5)
    )
    assert line.estimate(1).u == pytest.approx(0.001 / np.sqrt(10), rel=1e-4)
    assert line.estimate(0).u == pytest.approx(0.1, rel=0.01)
    assert line.scatter == 0


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_friction_error_of_one_test_is_an_outlier_with_its_size(factor: float) -> None:
    """The logged friction is ``factor`` times the true one: the friction gain of that test is off
    by 1/factor - 1."""
    campaign = toy(10)
    statistics = campaign.tests[6]
    k = statistics.names.index("friction")
    offset = (1 / factor - 1) / statistics.units["friction"]
    outlier = replace(statistics, rhs=statistics.rhs + statistics.rows[:, k] * offset)
    tests = [outlier if t is statistics else t for t in campaign.tests]
    outliers = outlying_tests(solve_campaign(tests))
    assert [(s.name, s.cause) for s in outliers] == [(statistics.name, "friction")]
    assert abs(outliers[0].size.value - (1 / factor - 1)) < 4 * outliers[0].size.u
    assert outliers[0].is_explained
    result = join_results({t.name: beta_json(t) for t in tests})
    assert result is not None
    message = next(f.sentence for f in result.findings if f.code == "campaign.stranger")
    assert f"{statistics.name} does not agree with the other tests" in message
    assert ("% low" in message) == (factor < 1)
    assert statistics.name not in result.to_dict()["order"]
    assert result.to_dict()["do_not_belong"][0]["test"] == statistics.name


def test_consistent_campaigns_have_outliers_at_the_stated_rate() -> None:
    n_with_outliers = sum(
        bool(outlying_tests(solve_campaign(toy(seed).tests))) for seed in range(60)
    )
    assert n_with_outliers <= stats.binom.ppf(1 - FALSE_FAILURE_P, 60, 0.05)


def contradictions(departure: float, seeds: range) -> list[Finding]:
    """Findings that the tests contradict the statements about the rig, over drawn campaigns."""
    findings = []
    for seed in seeds:
        campaign = join_results(
            {t.name: beta_json(t) for t in toy(seed, 8, departure=departure).tests}
        )
        assert campaign is not None
        findings += [f for f in campaign.findings if f.code == "campaign.contradicted"]
    return findings


def test_wider_uncertainties_by_contradicted_statements_are_reported() -> None:
    """Shared parameters drawn four times as wide as stated are found, and consistent ones seldom (1
    %)."""
    found = contradictions(4.0, range(10))
    # chi-squared is then 16 times the 8.6 degrees of freedom on average, and the limit 21
    assert len(found) >= 8
    for finding in found:
        assert finding.numbers["factor"] > (21.0 / 8.6) ** 0.5 * 0.95
        assert abs(finding.numbers["sizes"][0]) > 2.0
    # probability of more than two among 20 at 1 %: 0.1 %
    assert len(contradictions(1.0, range(500, 520))) <= 2


def test_model_curve_is_compared_with_the_tests(tmp_path: Path) -> None:
    posterior = solve_campaign(toy(11).tests)
    load = np.array([800.0, 2400.0])
    speed = np.array([t.conditions["sliding_speed_m_s"] for t in posterior.tests])
    at_one_speed = solve_campaign([t for t, u in zip(posterior.tests, speed) if u == 13.0])
    line = 0.70 + PER_N * (load - 1620.0) + PER_M_S * (13.0 - 15.0)
    correct = curve_test(at_one_speed, Curve("m.csv", "load_N", load, line, np.zeros(2)))
    wrong = curve_test(at_one_speed, Curve("m.csv", "load_N", load, line[::-1], np.zeros(2)))
    higher = curve_test(at_one_speed, Curve("m.csv", "load_N", load, line + 0.2, np.zeros(2)))
    assert correct.p_value > 1e-3
    assert wrong.shape_p_value < 1e-6
    assert higher.p_value < 1e-6 < higher.shape_p_value
    assert higher.offset.value == pytest.approx(-0.2, abs=0.05)
    with pytest.raises(InputError, match="0 tests lie within"):
        curve_test(posterior, Curve("m.csv", "load_N", load * 10, line, np.zeros(2)))
    path = tmp_path / "model.csv"
    path.write_text("load_N,beta\n800,0.72\n2400,0.68\n", encoding="utf-8")
    assert read_curve(path).against == "load_N"
    for text, message in (
        ("load,beta\n800,0.7\n", "nothing to lay beta over"),
        ("load_N,share\n800,1\n", "column beta is missing"),
        ("load_N,beta\n900,0.7\n800,0.7\n", "does not rise"),
        ("load_N,beta\n800,70\n900,71\n", "not a share"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=message):
            read_curve(path)


def test_campaign_result_is_data_and_tables() -> None:
    campaign = toy(12)
    result = join_results(
        {t.name: beta_json(t) for t in campaign.tests}
        | {"EHL_X": {"status": "withheld", "kept": None}}
    )
    assert result is not None
    data = result.to_dict()
    assert list(data["tests"]) == data["order"] == [t.name for t in campaign.tests]
    assert np.array(data["covariance"]).shape == (16, 16)
    assert data["apart"] == {"EHL_X": "its answer is withheld"}
    assert data["trend"]["against"] == "delta_T_us_K_m_s"
    table = paper_table(result)
    assert (table["u_beta_within"] < table["u_beta"]).all()
    assert paper_csv(result).count("\n") == 17
    text = paper_latex(result)
    assert text.count(r" \\") == 18
    assert text.count("{") == text.count("}")
    assert join_results({"EHL_X": {"status": "withheld", "kept": None}}) is None
    deeper = result.deeper_mm["fast"]["e"]
    assert abs(deeper.value - 0.1 * campaign.shared["depth e fast"]) < 4 * deeper.u
