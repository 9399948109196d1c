"""Monte Carlo studies of bias, coverage, convergence and false alarms; ``--full`` runs the sizes
quoted in the manual."""

from __future__ import annotations

import time

import numpy as np
import pytest
from identify_cases import CASE_A, PLAIN, RAO_GARNIER, case_a, rao_garnier
from scipy import stats

from tcdyn.identification import fit, transfer

pytestmark = pytest.mark.study


def study_case_a(kind: str, seeds: range) -> dict[str, np.ndarray]:
    """Errors (R, 4), covered (R, 4), p values (R, 2) and seconds (R,) of default P2D fits."""
    errors = []
    covered = []
    p = []
    seconds = []
    for seed in seeds:
        data = case_a(kind, seed)
        t_start_s = time.perf_counter()
        result = fit(data, "P2D")
        seconds.append(time.perf_counter() - t_start_s)
        errors.append([result.estimates[n].value - v for n, v in CASE_A.items()])
        covered.append([result.estimates[n].contains(v) for n, v in CASE_A.items()])
        p.append([result.identified.statistics[k] for k in ("p_white", "p_input")])
    return {
        k: np.array(v)
        for k, v in zip(("errors", "covered", "p", "seconds"), (errors, covered, p, seconds))
    }


@pytest.mark.parametrize("kind", ["plunge", pytest.param("PRBS", marks=pytest.mark.long)])
def test_case_a_is_unbiased_and_covered_over_200_seeds(kind, draws):
    n = draws(200)
    s = study_case_a(kind, range(n))
    bias = s["errors"].mean(axis=0) / (s["errors"].std(axis=0, ddof=1) / np.sqrt(n))
    assert np.all(np.abs(bias) < 2.5), bias
    # 93 to 97 %, within the scatter of so many samples
    n_covered = s["covered"].sum(axis=0)
    assert np.all(
        (n_covered >= stats.binom.ppf(0.01, n, 0.93))
        & (n_covered <= stats.binom.ppf(0.999, n, 0.97))
    ), n_covered / n
    # no run lost: every error within six standard deviations of the others
    assert np.all(np.abs(s["errors"]) < 6 * s["errors"].std(axis=0))


def test_rao_garnier_is_unbiased_over_100_runs_at_10_dB(draws):
    errors = []
    for seed in range(draws(100)):
        result = fit(
            rao_garnier(seed),
            transfer(1, 4),
            initial="zero",
            intervals="quadratic",
            check=False,
            noise="white",
            baseline="none",
        )
        errors.append([result.estimates[n].value - v for n, v in RAO_GARNIER.items()])
    errors = np.array(errors)
    spread = 1.4826 * np.median(np.abs(errors), axis=0)
    is_converged = np.all(np.abs(errors) < 6 * spread, axis=1)
    assert (~is_converged).sum() <= 0.02 * len(is_converged)
    converged = errors[is_converged]
    bias = converged.mean(axis=0) / (converged.std(axis=0, ddof=1) / np.sqrt(len(converged)))
    assert np.all(np.abs(bias) < 2.5), bias


def test_false_alarm_rates_are_nominal_over_2000_runs(draws):
    p = []
    for kind in ("plunge", "PRBS"):
        for seed in range(draws(1000)):
            data = case_a(kind, 10_000 + seed)
            # start at the true values: the study is of the tests; starts are studied above
            s = fit(
                data, "P2D", start=CASE_A, intervals="quadratic", check=False, **PLAIN
            ).identified.statistics
            p.append((s["p_white"], s["p_input"]))
    alarms = np.sum(np.array(p) < 0.05, axis=0)
    low, high = stats.binom.ppf([0.02, 0.98], len(p), 0.05)  # 4 to 6 % of 2000
    assert np.all((alarms >= low) & (alarms <= high)), alarms / len(p)


@pytest.mark.parametrize("noise", ["white", (1, 0)])
def test_coverage_under_coloured_noise_is_at_least_93_percent(noise, draws):
    # autoregressive noise of 0.9: white-noise intervals would cover about 40 % for the slow
    # parameters
    covered = []
    for seed in range(draws(100)):
        result = fit(
            case_a("PRBS", seed, colour=0.9),
            "P2D",
            start=CASE_A,
            noise=noise,
            check=False,
            baseline="none",
            initial="equilibrium",
        )
        covered.append([result.estimates[n].contains(v) for n, v in CASE_A.items()])
    # the sandwich uses an estimated spectrum: 93 %, within the scatter of so many runs
    n_covered = np.sum(covered, axis=0)
    assert np.all(n_covered >= stats.binom.ppf(0.005, len(covered), 0.93)), n_covered / len(covered)
