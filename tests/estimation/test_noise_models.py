"""Models of coloured residuals against closed forms: memory, independent samples, and averages
over a flat likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.special import expit

from tcdyn.estimation import (
    NoiseModel,
    Problem,
    autocorrelation_factor,
    autocovariance,
    fit_ar,
    fit_arma,
    inverse,
    minimise,
    orthonormal_basis,
    robust_covariance,
    sandwich_covariance,
    slow_variance_factor,
)
from tcdyn.estimation.arma import presample_effect
from tcdyn.estimation.levenberg_marquardt import robust_weights
from tcdyn.estimation.noise_average import (
    GAIN,
    RANDOM_WALK_PROBABILITY,
    LinearisedProblem,
    NoiseGrid,
    NoiseNode,
    first_order_noise,
    full_box,
)


def test_time_constant_and_effective_samples_match_the_closed_forms() -> None:
    """AR(1): n (1 - a)/(1 + a); MA(1): n (1 + c^2)/(1 + c)^2; a random walk plus white noise never
    forgets."""
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
    two_poles = NoiseModel((-1.3, 0.4), (0.2,))  # poles 0.8 and 0.5
    assert two_poles.time_constant == pytest.approx(-1 / np.log(0.8))
    assert (two_poles.order, two_poles.n_parameters, two_poles.is_random_walk) == ((2, 1), 3, False)


def test_first_order_disturbance_with_white_noise_is_its_kalman_filter() -> None:
    """With infinite gain it is AR(1). With gain K the innovations of v + w have C = 1 - a (1 - K)
    q^-1."""
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
    noise = first_order_noise(np.log(5.0), np.log(k / (1 - k)))
    whitened = noise.whiten(np.linalg.cholesky(cov), [slice(0, 40)]) / np.sqrt(p + 1)
    assert whitened @ whitened.T == pytest.approx(np.eye(40), abs=1e-9)
    assert noise.log_determinant([slice(0, 40)]) == pytest.approx(
        np.linalg.slogdet(cov)[1] - 40 * np.log(p + 1)
    )


class Flat(LinearisedProblem):
    """Data without information on the noise: one step of x, of variance one, for every noise
    model."""

    def marginal_likelihoods(self, noise: NoiseModel) -> list[NoiseNode]:
        return [NoiseNode(3.0, np.array([0.25]), np.eye(1))]


def test_flat_likelihood_leaves_the_prior_of_the_noise_models() -> None:
    """Gains from 0 to 1 are equally likely; four fifths of the time constants exceed the record;
    white noise counts as much as all of them."""
    n = 1000
    slopes = Flat(np.zeros(n), np.ones((n, 1)), np.ones(1), np.zeros((0, 2)), [slice(0, n)])
    grid = NoiseGrid.build(slopes, full_box(n))
    mixture = grid.average(slopes, [NoiseModel()])
    gain_range = expit(GAIN[1]) - expit(GAIN[0])
    # tolerance: 12 x 8 nodes, and the length of the record lies between nodes
    assert np.exp(mixture.evidence - 3.0) == pytest.approx(1 + gain_range, rel=0.08)
    assert mixture.walk_share == pytest.approx(
        RANDOM_WALK_PROBABILITY * gain_range / (1 + gain_range), rel=0.12
    )
    assert mixture.step == pytest.approx([0.25])
    assert mixture.covariance[0, 0] == pytest.approx(1.0)


def test_likelihood_of_slow_waves_is_that_of_their_covariance() -> None:
    """Level and slope unknown, white noise, two waves: the level of the noise is integrated out.

    Compared with the restricted likelihood of the dense covariance 1 + B S B', and with its
    generalised least squares.
    """
    rng = np.random.default_rng(4)
    n = 60
    t = np.linspace(0, 1, n)
    fixed = np.column_stack([np.ones(n), np.sin(9 * t)])
    waves = np.cos(np.pi * t[:, None] * [1, 2])
    y = fixed @ [1.0, 2.0] + waves @ [0.4, 0.1] + 0.3 * rng.normal(size=n)
    shares = np.array([1.0, 0.25])
    sizes = np.array([0.3, 1.0, 3.0])
    x = np.array([0.1, 0.2, 0.3, 0.4])
    design = np.column_stack([fixed, waves])
    problem = LinearisedProblem(
        design @ x - y,
        design,
        np.ones(4),
        np.zeros((0, 5)),
        [slice(0, n)],
        waves=x[2:],
        wave_shares=shares,
        wave_sds=sizes,
    )
    nodes = problem.marginal_likelihoods(NoiseModel())
    assert [node.wave_sd for node in nodes] == sizes.tolist()
    expected = []
    for size, node in zip(sizes, nodes):
        spread = np.eye(n) + waves @ np.diag((size * shares) ** 2) @ waves.T
        weight = np.linalg.inv(spread)
        information = fixed.T @ weight @ fixed
        best = np.linalg.solve(information, fixed.T @ weight @ y)
        residual = y - fixed @ best
        square = residual @ weight @ residual
        volume = np.linalg.slogdet(spread)[1] + np.linalg.slogdet(information)[1]
        expected.append(-0.5 * ((n - 2) * np.log(square) + volume))
        assert x[:2] + node.step[:2] == pytest.approx(best, rel=1e-9)
        covariance = square / (n - 2) * np.linalg.inv(information)
        assert node.covariance[:2, :2] == pytest.approx(covariance, rel=1e-9)
    found = np.array([node.log_likelihood for node in nodes])
    assert found - found[0] == pytest.approx(np.array(expected) - expected[0], abs=1e-9)


def test_autoregressions_recover_the_noise_and_use_no_pair_across_a_gap() -> None:
    sums, pairs = autocovariance(
        np.array([1.0, 2.0, 3.0, 10.0, 20.0]), [slice(0, 3), slice(3, 5)], lags=3
    )
    assert sums.tolist() == [514.0, 2.0 + 6.0 + 200.0, 3.0, 0.0]
    assert pairs.tolist() == [5.0, 3.0, 1.0, 0.0]
    rng = np.random.default_rng(0)
    segments = [slice(0, 1500), slice(1500, 4000)]
    e = np.concatenate(
        [lfilter([1.0, 0.5], [1.0, -1.2, 0.52], rng.normal(size=4500))[k:] for k in (3000, 2000)]
    )
    noise = fit_arma(e, segments, 2, 1)
    true_coefficients = (-1.2, 0.52, 0.5)
    # about four standard errors
    assert (*noise.ar, *noise.ma) == pytest.approx(true_coefficients, abs=4 * 1 / np.sqrt(4000))
    w = noise.whiten(e, segments)
    assert np.std(w) == pytest.approx(1.0, abs=0.05)
    assert autocorrelation_factor(w) < 1.2
    long = fit_ar(lfilter([1.0], [1.0, -1.2, 0.52], rng.normal(size=4000)), [slice(0, 4000)])
    assert long.ar[:2] == pytest.approx((-1.2, 0.52), abs=0.07)
    white = fit_ar(rng.normal(size=4000), [slice(0, 4000)], max_order=3)
    assert np.all(np.abs(white.ar) < 0.07)


def test_the_order_of_an_autoregression_has_the_least_aicc_of_a_short_record() -> None:
    """By regressions on the record's autocovariance, which the function does not use."""
    for seed in range(60):
        e = lfilter([1.0], [1.0, -0.5], np.random.default_rng(seed).normal(size=40))
        n = len(e)
        r = np.array([e[k:] @ e[: n - k] for k in range(5)]) / n
        scores = [n * np.log(r[0])]
        for p in range(1, 5):
            covariance = r[np.abs(np.subtract.outer(np.arange(p), np.arange(p)))]
            variance = r[0] - r[1 : p + 1] @ np.linalg.solve(covariance, r[1 : p + 1])
            scores.append(n * np.log(variance) + 2 * p * (1 + (p + 1) / (n - p - 1)))
        assert len(fit_ar(e, [slice(0, n)]).ar) == np.argmin(scores)


def test_sandwich_of_white_residuals_is_the_classical_covariance_with_prior() -> None:
    """s^2 (J'J + K)^-1, with J'J in units of the residual variance and K of the prior in the same
    units."""
    rng = np.random.default_rng(3)
    j = rng.normal(size=(20, 2))
    prior_precision = np.array([0.0, 30.0])
    e = np.where(np.arange(20) % 2, 1.0, -1.0) * np.repeat([1.0, -1.0, 1.0, 1.0, -1.0], 4)
    e = rng.permutation(e)
    assert fit_ar(e, [slice(0, 20)]).white
    expected = float(e @ e) / 18 * np.linalg.inv(j.T @ j + np.diag(prior_precision))
    assert sandwich_covariance(j, e, [slice(0, 20)], prior_precision) == pytest.approx(expected)


def test_robust_covariance_of_a_mean_is_hubers_formula() -> None:
    """[sum psi^2/(n - 1)] / mean(psi')^2 / n, with the scale from the median; bisquare weights
    vanish at its constant."""
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


def test_slow_variance_factor_of_constant_and_alternating_residuals() -> None:
    """Of ones, sums over m = N/25 samples have the mean square m. A channel of zeros does not
    count."""
    assert slow_variance_factor(np.ones((1000, 1))) == pytest.approx(40.0)
    assert slow_variance_factor(np.column_stack([np.ones(1000), np.zeros(1000)])) == pytest.approx(
        40.0
    )
    assert slow_variance_factor(np.tile([1.0, -1.0], 500)[:, None]) == 1.0
    assert slow_variance_factor(np.ones((1010, 1)), n_chunks=10) == pytest.approx(101.0)


def test_dependent_directions_are_left_out_of_the_basis() -> None:
    table = np.column_stack([np.arange(5.0), 1e6 * np.arange(5.0), np.ones(5), np.zeros(5)])
    q = orthonormal_basis(table)
    assert q.T @ q == pytest.approx(np.eye(2), abs=1e-12)
    assert q @ (q.T @ table) == pytest.approx(table, rel=1e-9, abs=1e-9)
    matrix = np.array([[2.0, 1.0], [1.0, 3.0]])
    assert inverse(matrix * np.outer([1e-6, 1e6], [1e-6, 1e6])) == pytest.approx(
        np.linalg.inv(matrix) * np.outer([1e6, 1e-6], [1e6, 1e-6])
    )


def test_log_volume_and_pull_of_one_parameter_with_a_prior() -> None:
    """n samples of variance one about 3, prior 1 +- 0.5: the share of the data is n/(n + 4), the
    pull that of 3 against 1."""
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
    # the mean of the data deviates by 2 from the prior mean
    assert best.pulls["a"] == pytest.approx(2.0 / np.sqrt(0.25 + 1 / n))


def test_autocorrelation_factor_sums_up_to_the_first_insignificant_lag() -> None:
    """Eight ones and eight minus ones: 13, 10 and 7 of 16; the bound 2/sqrt(16) keeps the first
    two."""
    z = np.repeat([1.0, -1.0], 8)
    assert autocorrelation_factor(z) == pytest.approx(1 + 2 * (13 + 10) / 16)
    assert autocorrelation_factor(np.full(16, 3.0)) == 1.0
    assert autocorrelation_factor(z[6:10]) == 1.0  # too few samples


def test_robust_scale_is_about_the_median_and_weights_are_about_zero() -> None:
    r = np.linspace(-1, 1, 21) + 0.3
    limit = 1.345 * 1.4826 * 0.5
    assert robust_weights(r, "huber") == pytest.approx(
        np.minimum(1.0, limit / np.maximum(np.abs(r), 1e-12))
    )


@pytest.mark.parametrize("roots", [[0.9], [0.99, 0.5], [0.97, 0.97], [0.9 + 0.3j, 0.9 - 0.3j]])
def test_the_determinant_of_stationary_noise_is_that_of_its_covariance(roots):
    """Closed form: the autocovariance of AR noise as the sum of its impulse response."""
    ar = np.real(np.poly(roots))
    n = 40
    pulse = lfilter([1.0], ar, np.eye(1, 20_000)[0])
    autocovariance = [pulse[: len(pulse) - k] @ pulse[k:] for k in range(n)]
    expected = np.linalg.slogdet(toeplitz(autocovariance))[1]
    noise = NoiseModel(tuple(ar[1:].tolist()))
    assert noise.log_determinant([slice(0, n)]) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("memory", [1e3, 1e6, 1e9, 1e12])
@pytest.mark.parametrize("n_roots", [1, 2, 3, 8])
def test_noise_of_any_memory_is_whitened_without_an_overflow(memory, n_roots):
    """Powers of the companion matrix grow without limit by rounding, where roots are equal."""
    ar = np.poly([1 - 1 / memory] * n_roots)
    noise = NoiseModel(tuple(ar[1:].tolist()), (-0.5,))
    e = np.cumsum(np.random.default_rng(0).normal(size=50))
    with np.errstate(all="raise", under="ignore"):
        shapes, variances = presample_effect(noise.ar, noise.ma, 50)
        whitened = noise.whiten(e, [slice(0, 50)])
    assert np.isfinite(shapes).all()
    assert np.isfinite(variances).all()
    assert np.isfinite(whitened).all()


@pytest.mark.parametrize("e", [np.zeros(60), np.ones(60), (-1.0) ** np.arange(60)])
def test_residuals_that_follow_from_those_before_have_a_noise_model(e):
    for segments in ([slice(0, 60)], [slice(0, 58), slice(58, 59), slice(59, 60)]):
        assert np.isfinite(fit_ar(e, segments).whiten(e, segments)).all()
        for order in ((1, 1), (2, 1), (2, 2)):
            noise = fit_arma(e, segments, *order)
            assert np.isfinite(noise.whiten(e, segments)).all()
