"""Models of coloured residuals against closed forms: memory, independent samples, what a flat likelihood leaves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.special import expit

from tcdyn.core import Array
from tcdyn.estimation import (
    NoiseModel,
    Problem,
    autocovariance,
    correlation_length,
    fit_ar,
    fit_arma,
    inverse,
    minimise,
    orthonormal_basis,
    robust_covariance,
    sandwich_covariance,
    slow_variance_factor,
)
from tcdyn.estimation.levenberg_marquardt import robust_weights
from tcdyn.estimation.noise_average import (
    GAIN,
    RANDOM_WALK_PROBABILITY,
    LinearisedProblem,
    NoiseGrid,
    first_order_noise,
    full_box,
)


def test_a_first_order_noise_forgets_in_its_time_constant_and_counts_for_so_many_independent_samples() -> (
    None
):
    """AR(1): n (1 - a)/(1 + a); MA(1): n (1 + c^2)/(1 + c)^2; a walk beneath white noise never forgets."""
    slow = NoiseModel(ar=(-0.8,))
    assert slow.time_constant == pytest.approx(-1 / np.log(0.8))
    assert slow.effective_samples(1000) == pytest.approx(1000 * 0.2 / 1.8)
    assert NoiseModel(ma=(0.5,)).effective_samples(1000) == pytest.approx(1000 * 1.25 / 2.25)
    assert NoiseModel(ma=(0.5,)).time_constant == 0.0
    assert (NoiseModel().effective_samples(7), NoiseModel().time_constant) == (7.0, 0.0)
    assert NoiseModel(ar=(-0.999,)).effective_samples(100) == 2.0
    walk = NoiseModel((-1.0,), (-0.6,), True)
    assert walk.time_constant == np.inf
    assert walk.is_random_walk
    assert walk.order == (0, 1)
    both = NoiseModel((-1.3, 0.4), (0.2,))  # poles 0.8 and 0.5
    assert both.time_constant == pytest.approx(-1 / np.log(0.8))
    assert (both.order, both.n_parameters, both.is_random_walk) == ((2, 1), 3, False)


def test_a_disturbance_of_a_time_constant_beneath_white_noise_is_its_kalman_filter() -> None:
    """Of an infinite gain nothing but it, AR(1); of gain K: the innovations of v + w have C = 1 - a (1 - K) q^-1."""
    a = np.exp(-1 / 5.0)
    assert first_order_noise(np.log(5.0), 40.0).ar == pytest.approx((-a,))
    assert first_order_noise(np.log(5.0), 40.0).ma == pytest.approx((0.0,), abs=1e-15)
    p = 1.0  # steady Riccati: variance of v before a sample, white noise 1, steps q
    for _ in range(500):
        p = a**2 * p / (p + 1) + 0.3
    k = p / (p + 1)
    assert first_order_noise(np.log(5.0), np.log(k / (1 - k))).ma == pytest.approx((-a * (1 - k),))
    lag = np.arange(40)
    cov = toeplitz(0.3 / (1 - a**2) * a**lag + (lag == 0))
    told = first_order_noise(np.log(5.0), np.log(k / (1 - k)))
    white = told.whiten(np.linalg.cholesky(cov), [slice(0, 40)]) / np.sqrt(p + 1)
    assert white @ white.T == pytest.approx(np.eye(40), abs=1e-9)
    assert told.log_determinant([slice(0, 40)]) == pytest.approx(
        np.linalg.slogdet(cov)[1] - 40 * np.log(p + 1)
    )


class Flat(LinearisedProblem):
    """Data that tell noises nothing: one step of x, of variance one, whatever the noise."""

    def marginal(self, noise: NoiseModel) -> tuple[float, Array, Array]:
        return 3.0, np.array([0.25]), np.eye(1)


def test_where_all_noises_are_as_likely_their_prior_is_left() -> None:
    """Gains from 0 to 1 alike; four fifths of time constants beyond the record; white noise as much as all of them."""
    n = 1000
    slopes = Flat(np.zeros(n), np.ones((n, 1)), np.ones(1), np.zeros((0, 2)), [slice(0, n)], 0)
    grid = NoiseGrid.build(slopes, full_box(n))
    evidence, walks, _, step, covariance = grid.average(slopes, [NoiseModel()])
    of_gains = expit(GAIN[1]) - expit(GAIN[0])
    assert np.exp(evidence - 3.0) == pytest.approx(
        1 + of_gains, rel=0.08
    )  # 12 x 8 nodes, edges of the record between
    assert walks == pytest.approx(RANDOM_WALK_PROBABILITY * of_gains / (1 + of_gains), rel=0.12)
    assert step == pytest.approx([0.25])
    assert covariance[0, 0] == pytest.approx(1.0)


def test_regressions_find_the_noise_across_a_gap_and_no_pair_reaches_over_it() -> None:
    sums, pairs = autocovariance(
        np.array([1.0, 2.0, 3.0, 10.0, 20.0]), [slice(0, 3), slice(3, 5)], lags=3
    )
    assert sums.tolist() == [514.0, 2.0 + 6.0 + 200.0, 3.0, 0.0]
    assert pairs.tolist() == [5.0, 3.0, 1.0, 0.0]
    rng = np.random.default_rng(0)
    parts = [slice(0, 1500), slice(1500, 4000)]
    e = np.concatenate(
        [lfilter([1.0, 0.5], [1.0, -1.2, 0.52], rng.normal(size=4500))[k:] for k in (3000, 2000)]
    )
    found = fit_arma(e, parts, 2, 1)
    truth = (-1.2, 0.52, 0.5)
    assert (*found.ar, *found.ma) == pytest.approx(
        truth, abs=4 * 1 / np.sqrt(4000)
    )  # four standard errors, about
    w = found.whiten(e, parts)
    assert np.std(w) == pytest.approx(1.0, abs=0.05)
    assert correlation_length(w) < 1.2
    long = fit_ar(lfilter([1.0], [1.0, -1.2, 0.52], rng.normal(size=4000)), [slice(0, 4000)])
    assert long.ar[:2] == pytest.approx((-1.2, 0.52), abs=0.07)
    white = fit_ar(rng.normal(size=4000), [slice(0, 4000)], max_order=3)
    assert np.all(np.abs(white.ar) < 0.07)


def test_of_white_residuals_the_sandwich_is_the_plain_covariance_with_its_prior() -> None:
    """s^2 (J'J + K)^-1, J'J of the residuals' variance, K of the prior in units of it."""
    rng = np.random.default_rng(3)
    j = rng.normal(size=(20, 2))
    known = np.array([0.0, 30.0])
    e = np.where(np.arange(20) % 2, 1.0, -1.0) * np.repeat([1.0, -1.0, 1.0, 1.0, -1.0], 4)
    e = rng.permutation(e)
    assert fit_ar(e, [slice(0, 20)]).white
    plain = float(e @ e) / 18 * np.linalg.inv(j.T @ j + np.diag(known))
    assert sandwich_covariance(j, e, [slice(0, 20)], known) == pytest.approx(plain)


def test_huber_s_covariance_of_a_mean_is_his_formula() -> None:
    """[sum psi^2/(n - 1)] / mean(psi')^2 / n, scale from the median; bisquare weights end at its constant."""
    r = np.r_[np.linspace(-1, 1, 21), 8.0, -9.0]
    c = 1.345 * 1.4826 * np.median(np.abs(r))
    psi = np.clip(r, -c, c)
    inside = np.abs(r) < c
    expected = float(psi @ psi) / 22 / inside.mean() ** 2 / 23
    assert robust_covariance(r, np.ones((23, 1)), "huber")[0, 0] == pytest.approx(expected)
    z = r / (4.685 * 1.4826 * np.median(np.abs(r)))
    weights = np.where(np.abs(z) < 1, (1 - z**2) ** 2, 0.0)
    assert robust_weights(r, "bisquare") == pytest.approx(weights)
    h = 1e-6  # psi' of the bisquare by differences
    slope = ((z + h) * (1 - (z + h) ** 2) ** 2 - (z - h) * (1 - (z - h) ** 2) ** 2) / (2 * h)
    slope[np.abs(z) > 1] = 0.0
    psi = weights * r
    expected = float(psi @ psi) / 22 / slope.mean() ** 2 / 23
    assert robust_covariance(r, np.ones((23, 1)), "bisquare")[0, 0] == pytest.approx(
        expected, rel=1e-6
    )


def test_slow_waves_count_by_the_sums_they_fill() -> None:
    """Of ones, sums over m = N/25 samples have the mean square m; a channel that holds nothing does not count."""
    assert slow_variance_factor(np.ones((1000, 1))) == pytest.approx(40.0)
    assert slow_variance_factor(np.column_stack([np.ones(1000), np.zeros(1000)])) == pytest.approx(
        40.0
    )
    assert slow_variance_factor(np.tile([1.0, -1.0], 500)[:, None]) == 1.0
    assert slow_variance_factor(np.ones((1010, 1)), sums=10) == pytest.approx(101.0)


def test_directions_that_are_one_are_left_out() -> None:
    table = np.column_stack([np.arange(5.0), 1e6 * np.arange(5.0), np.ones(5), np.zeros(5)])
    q = orthonormal_basis(table)
    assert q.T @ q == pytest.approx(np.eye(2), abs=1e-12)
    assert q @ (q.T @ table) == pytest.approx(table, rel=1e-9, abs=1e-9)
    known = np.array([[2.0, 1.0], [1.0, 3.0]])
    assert inverse(known * np.outer([1e-6, 1e6], [1e-6, 1e6])) == pytest.approx(
        np.linalg.inv(known) * np.outer([1e6, 1e-6], [1e6, 1e-6])
    )


def test_volume_and_pull_of_one_number_with_a_prior() -> None:
    """n samples of variance one about 3, prior 1 +- 0.5: told is n/(n + 4), the pull that of 3 against 1."""
    n = 12
    problem = Problem(
        ("a",),
        lambda x: (np.full(n, x[0] - 3.0), np.ones((n, 1))),
        np.array([1.0]),
        np.array([0.5]),
    )
    best = minimise(problem, np.zeros(1))
    assert best.theta[0] == pytest.approx((3 * n + 1 * 4) / (n + 4))
    assert best.cost == pytest.approx(n * (3 - best.theta[0]) ** 2 + 4 * (best.theta[0] - 1) ** 2)
    assert best.log_volume == pytest.approx(0.5 * np.log(n + 4))
    assert best.u("a") == pytest.approx(1 / np.sqrt(n + 4))
    assert best.pulls["a"] == pytest.approx(
        2.0 / np.sqrt(0.25 + 1 / n)
    )  # the data's own mean is as far off


def test_correlations_are_summed_up_to_the_first_that_chance_explains() -> None:
    """Eight ones and eight minus ones: 13, 10 and 7 of 16, of which 2/sqrt(16) leaves the first two."""
    z = np.repeat([1.0, -1.0], 8)
    assert correlation_length(z) == pytest.approx(1 + 2 * (13 + 10) / 16)
    assert correlation_length(np.full(16, 3.0)) == 1.0
    assert correlation_length(z[6:10]) == 1.0  # too few to tell


def test_the_scale_of_robust_weights_is_about_the_median_and_the_weights_are_about_nought() -> None:
    r = np.linspace(-1, 1, 21) + 0.3
    limit = 1.345 * 1.4826 * 0.5
    assert robust_weights(r, "huber") == pytest.approx(
        np.minimum(1.0, limit / np.maximum(np.abs(r), 1e-12))
    )
