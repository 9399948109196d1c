"""The least-squares core against closed forms, limits and repeated simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from tcdyn.core import Array
from tcdyn.estimation import (
    Evaluate,
    Problem,
    Status,
    autocorrelation_factor,
    covariance_from_rows,
    eliminate_linear,
    first_crossing,
    free_directions,
    inverse,
    is_full_rank,
    minimise,
    minimise_constrained,
    profile,
    sandwich_covariance,
    slow_variance_factor,
)
from tcdyn.estimation.noise_average import (
    GRID,
    ZOOMS,
    LinearisedProblem,
    NoiseGrid,
    NoiseNode,
    full_box,
)


def linear_residuals(design: Array, y: Array) -> Evaluate:
    """Residuals of a linear model."""
    return lambda theta: (design @ theta - y, design)


def decay_residuals(t: Array, y: Array, sd: float) -> Evaluate:
    """Residuals of an exponential decay with amplitude theta[0] and time constant theta[1]."""

    def evaluate(theta: Array) -> tuple[Array, Array]:
        e = np.exp(-t / theta[1])
        return (theta[0] * e - y) / sd, np.column_stack([e, theta[0] * e * t / theta[1] ** 2]) / sd

    return evaluate


def test_linear_problem_with_priors_has_the_bayesian_posterior() -> None:
    """Bishop, Pattern Recognition and Machine Learning (2006), eq. 3.50, 3.51; scales over twelve
    decades."""
    rng = np.random.default_rng(0)
    scale = np.array([1e-6, 1.0, 1e6])
    design = rng.standard_normal((40, 3)) * scale
    true_theta = np.array([1.0, -2.0, 0.5]) / scale
    y = design @ true_theta + rng.standard_normal(40)
    mean = np.array([0.5, 0.0, 0.0]) / scale
    sd = np.array([0.1, np.inf, np.inf]) / scale
    best = minimise(Problem(("a", "b", "c"), linear_residuals(design, y), mean, sd), np.zeros(3))
    precision = np.diag([1 / sd[0] ** 2, 0.0, 0.0])
    covariance = np.linalg.inv((design.T @ design + precision) * np.outer(1 / scale, 1 / scale))
    expected = covariance @ ((design.T @ y + precision @ mean) / scale)
    # linear: the minimum is exact to rounding
    assert best.theta * scale == pytest.approx(expected, rel=1e-9)
    assert best.covariance * np.outer(scale, scale) == pytest.approx(covariance, rel=1e-9)
    assert best.u("b") == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-9)
    assert set(best.pulls) == {"a"}


def test_pulls_are_standard_normal_for_a_correct_prior() -> None:
    rng = np.random.default_rng(1)
    design = np.column_stack([np.ones(30), np.linspace(-1, 1, 30)])
    pulls = []
    for _ in range(400):
        a = rng.normal(2.0, 0.3)
        y = design @ [a, 1.0] + rng.standard_normal(30)
        problem = Problem(
            ("a", "b"), linear_residuals(design, y), np.array([2.0, 0.0]), np.array([0.3, np.inf])
        )
        pulls.append(minimise(problem, np.zeros(2)).pulls["a"])
    assert abs(np.mean(pulls)) < 0.15  # three standard errors of 400
    assert np.std(pulls) == pytest.approx(1.0, abs=0.11)


def test_active_bound_is_reported_and_other_parameters_are_fitted_with_it() -> None:
    design = np.column_stack([np.ones(20), np.arange(20.0)])
    y = design @ [-1.0, 0.5]
    best = minimise(
        Problem(("a", "b"), linear_residuals(design, y), lower=np.array([0.0, -np.inf])),
        np.array([3.0, 3.0]),
    )
    assert best.status is Status.AT_BOUND
    assert best.theta[0] == 0.0
    assert best.theta[1] == pytest.approx(
        float(design[:, 1] @ y / (design[:, 1] @ design[:, 1])), rel=1e-9
    )


def test_fixed_combinations_stay_fixed_and_reduce_the_covariance() -> None:
    """Two shares that add to one are one parameter fewer; compared with constrained least squares
    of the textbook."""
    rng = np.random.default_rng(2)
    design = rng.standard_normal((25, 3))
    y = design @ [0.3, 0.7, 2.0] + 0.1 * rng.standard_normal(25)
    problem = Problem(
        ("a", "b", "c"), linear_residuals(design, y), fixed=np.array([[1.0, 1.0, 0.0]])
    )
    best = minimise(problem, np.array([0.5, 0.5, 0.0]))
    reduced = np.column_stack([design[:, 0] - design[:, 1], design[:, 2]])
    expected = np.linalg.lstsq(reduced, y - design[:, 1], rcond=None)[0]
    assert best.theta == pytest.approx([expected[0], 1 - expected[0], expected[1]], rel=1e-9)
    assert best.covariance[0, 0] == pytest.approx(
        np.linalg.inv(reduced.T @ reduced)[0, 0], rel=1e-9
    )
    assert best.covariance[0, 1] == pytest.approx(-best.covariance[0, 0], rel=1e-9)
    assert best.u(np.array([1.0, 1.0, 0.0])) == pytest.approx(0.0, abs=1e-9)
    assert minimise_constrained(best, "c", 1.0).theta[:2].sum() == pytest.approx(1.0, abs=1e-12)


def test_free_parameters_keep_their_own_directions() -> None:
    d = free_directions(np.array([[0.0, 1.0, 1.0, 0.0]]))
    assert np.array_equal(d[[0, 3], :2], np.eye(2))
    assert d[[0, 3], 2] == pytest.approx(0.0)
    assert d[1, 2] == pytest.approx(-d[2, 2])


def test_search_stops_at_the_edge_of_the_domain_of_the_model() -> None:
    t = np.linspace(0, 1, 30)
    residuals = decay_residuals(t, 2 * np.exp(-t / 0.3), 1.0)
    optimum = minimise(
        Problem(("size", "tau"), lambda x: residuals(x) if x[1] > 0.5 else None),
        np.array([1.0, 1.0]),
    )
    assert optimum.status is Status.EDGE
    assert 0.5 < optimum.theta[1] < 0.51
    nowhere = minimise(Problem(("size", "tau"), lambda x: None), np.array([1.0, 1.0]))
    assert nowhere.status is Status.NOWHERE
    assert not nowhere.converged


def test_steps_do_not_exceed_the_maximum() -> None:
    evaluated: list[Array] = []
    residuals = decay_residuals(np.linspace(0, 1, 30), np.full(30, 1.0), 1.0)

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        evaluated.append(x.copy())
        return residuals(x)

    minimise(
        Problem(("size", "tau"), evaluate, max_step=np.array([np.inf, 0.1])),
        np.array([1.0, 0.3]),
        limit=5,
    )
    tau = [x[1] for x in evaluated]
    assert max(abs(np.array(tau) - 0.3)) <= 0.5 + 1e-12  # five steps
    assert len(evaluated) >= 5


@pytest.mark.parametrize("loss", ["huber", "bisquare"])
def test_robust_losses_are_insensitive_to_spikes(loss: str) -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0, 3, 400)
    y = 2 * np.exp(-t / 0.7) + 0.01 * rng.standard_normal(400)
    y[::20] += 1.0
    problem = Problem(("size", "tau"), decay_residuals(t, y, 1.0))
    plain = minimise(problem, np.array([1.0, 1.0]))
    best = minimise(problem, np.array([1.0, 1.0]), loss=loss)  # type: ignore[arg-type]
    assert abs(plain.theta[1] - 0.7) > 0.02
    assert best.theta[1] == pytest.approx(0.7, abs=0.006)
    assert best.weights is not None
    assert best.weights[::20].max() < 0.03


def test_profile_of_a_linear_problem_is_the_normal_parabola() -> None:
    rng = np.random.default_rng(4)
    design = rng.standard_normal((50, 3))
    y = design @ [1.0, 2.0, 3.0] + rng.standard_normal(50)
    best = minimise(Problem(("a", "b", "c"), linear_residuals(design, y)), np.zeros(3))
    interval_profile = profile(best, "b", step=0.3)
    z = (interval_profile.value - best.value("b")) / best.u("b")
    assert interval_profile.deviance == pytest.approx(z**2, rel=1e-6, abs=1e-8)
    assert interval_profile.low95 == pytest.approx(
        best.value("b") - 1.96 * best.u("b"), abs=1e-4 * best.u("b")
    )
    assert interval_profile.high95 == pytest.approx(
        best.value("b") + 1.96 * best.u("b"), abs=1e-4 * best.u("b")
    )


@pytest.mark.study
def test_profile_intervals_of_a_skewed_likelihood_have_nominal_coverage() -> None:
    """A lag known to 25 %: profile intervals cover in 95 %, symmetric ones fail at the upper
    end."""
    rng = np.random.default_rng(5)
    t = np.linspace(0, 3, 60)
    covered = []
    for _ in range(300):
        y = np.exp(-t / 0.7) + 0.25 * rng.standard_normal(60)
        best = minimise(
            Problem(("size", "tau"), decay_residuals(t, y, 0.25), lower=np.array([-9.0, 1e-2])),
            np.array([1.0, 0.7]),
        )
        interval_profile = profile(best, "tau", step=1.0, refine=0.02, max_deviance=4.0)
        covered.append((interval_profile.low95 or 0.0) < 0.7 < (interval_profile.high95 or np.inf))
    assert np.mean(covered) == pytest.approx(0.95, abs=0.038)  # three standard errors of 300


def test_interval_that_reaches_a_bound_is_open() -> None:
    t = np.linspace(0, 3, 60)
    y = 0.3 * np.exp(-t / 0.7)
    problem = Problem(
        ("size", "tau"),
        decay_residuals(t, y, 0.25),
        lower=np.array([0.0, 0.1]),
        upper=np.array([2.0, 2.0]),
    )
    interval_profile = profile(minimise(problem, np.array([0.3, 0.7])), "tau")
    assert interval_profile.high95 is None
    assert interval_profile.value[-1] == 2.0


@pytest.mark.parametrize("floor", [0.0, -9.0])
def test_profile_of_a_mean_equals_constrained_least_squares_at_bounds(
    floor: float,
) -> None:
    """Each point against least squares with this mean and these bounds, solved by quadratic
    programming (SLSQP)."""
    rng = np.random.default_rng(8)
    design = rng.standard_normal((40, 4)) * [1.0, 3.0, 0.3, 1.0]
    y = design @ [0.1, 0.6, 0.9, 2.0] + 0.3 * rng.standard_normal(40)
    lower = np.array([floor, floor, floor, -9.0])
    best = minimise(
        Problem(("a", "b", "c", "d"), linear_residuals(design, y), lower=lower), np.ones(4)
    )
    mean = np.array([1.0, 1.0, 1.0, 0.0]) / 3
    interval_profile = profile(best, mean, u=0.1, step=1.0, max_deviance=1e6, max_distance=8.0)
    for value, optimum in zip(interval_profile.value, interval_profile.optima):
        reference = minimize(
            lambda x: float(np.sum((design @ x - y) ** 2)),
            optimum.theta,
            jac=lambda x: 2 * design.T @ (design @ x - y),
            bounds=[(low, None) for low in lower],
            options={"ftol": 1e-14},
            method="SLSQP",
            constraints={
                "type": "eq",
                "fun": lambda x, v: mean @ x - v,
                "args": (value,),
                "jac": lambda x, v: mean,
            },
        )
        assert optimum.value(mean) == pytest.approx(value, rel=1e-9)
        assert optimum.converged
        assert np.all(optimum.theta >= lower)
        assert optimum.cost == pytest.approx(reference.fun, rel=1e-6)
    lower_end = 0.0 if floor == 0.0 else -np.inf
    # a mean of non-negative values is not followed below zero
    assert interval_profile.value[0] > lower_end
    if floor == 0.0:
        # a bound is active
        assert np.count_nonzero(interval_profile.optima[0].theta[:3] == 0.0) >= 1


def test_profile_of_a_function_of_a_parameter_equals_the_direct_profile() -> None:
    t = np.linspace(0, 3, 200)
    y = np.exp(-t / 0.7) + 0.05 * np.random.default_rng(6).standard_normal(200)

    def evaluate(theta: Array) -> tuple[Array, Array]:
        r, j = decay_residuals(t, y, 0.05)(np.array([theta[0], np.exp(theta[1])]))
        return r, j * [1.0, np.exp(theta[1])]

    direct = minimise(Problem(("size", "tau"), decay_residuals(t, y, 0.05)), np.array([1.0, 0.5]))
    best = minimise(Problem(("size", "log_tau"), evaluate), np.array([1.0, np.log(0.5)]))
    interval_profile = profile(
        best,
        "log_tau",
        u=direct.u("tau"),
        value=lambda x: float(np.exp(x)),
        at=lambda v: float(np.log(v)),
    )
    direct_profile = profile(direct, "tau")
    assert interval_profile.value == pytest.approx(direct_profile.value, rel=1e-6)
    assert interval_profile.deviance == pytest.approx(direct_profile.deviance, rel=1e-5, abs=1e-6)


def test_crossing_is_none_if_the_level_is_never_reached() -> None:
    assert first_crossing(np.arange(3.0), np.array([0.0, 0.1, 0.2])) is None


def test_rank_deficient_information_is_detected() -> None:
    rows = np.column_stack([np.ones(9), 2 * np.ones(9)])
    assert not is_full_rank(rows.T @ rows)
    assert covariance_from_rows(rows)[1] < 1e-12
    full_rank = np.column_stack([1e-9 * np.ones(9), 1e9 * np.arange(9.0)])
    assert is_full_rank(full_rank.T @ full_rank)
    assert covariance_from_rows(full_rank)[0] == pytest.approx(
        inverse(full_rank.T @ full_rank), rel=1e-9
    )


def test_information_about_no_parameter_has_full_rank() -> None:
    assert is_full_rank(np.zeros((0, 0)))
    assert inverse(np.zeros((0, 0))).shape == (0, 0)


def test_coloured_residuals_widen_the_mean_by_their_long_run_variance() -> None:
    """AR(1) with a: the variance of a mean grows by (1 + a)/(1 - a). Sandwich and correlation
    length must agree with it."""
    rng = np.random.default_rng(7)
    a = 0.6
    n = 20000
    e = np.zeros(n)
    for k, w in enumerate(rng.standard_normal(n)):
        e[k] = a * e[k - 1] + w
    factor = (1 + a) / (1 - a)
    design = np.ones((n, 1))
    ratio = sandwich_covariance(design, e, [slice(0, n)])[0, 0] / (np.var(e) / n)
    assert ratio == pytest.approx(factor, rel=0.06)
    # tolerance: short-memory estimate of a sum over lags
    assert autocorrelation_factor(e) == pytest.approx(factor, rel=0.15)
    white = rng.standard_normal((5000, 3))
    assert slow_variance_factor(white) < 1.6  # 3 x 24 squares: 1 + 3 sqrt(2/72)
    assert slow_variance_factor(white + np.sin(np.arange(5000) / 800)[:, None]) > 50


@pytest.mark.parametrize("width", [0.5, 0.05, 0.0005])
def test_box_of_a_noise_grid_matches_its_nodes_after_any_refinement(width):
    class Peaked(LinearisedProblem):
        """Log-likelihood that falls by 0.5 within ``width`` of one noise model."""

        def marginal_likelihoods(self, noise):
            a = noise.ar[0]
            c = noise.ma[0]
            evaluated.append((a, c))
            log_likelihood = -0.5 * ((a + 0.8) ** 2 + (c + 0.3) ** 2) / width**2
            return [NoiseNode(log_likelihood, np.zeros(1), np.eye(1))]

    evaluated: list[tuple[float, float]] = []
    n = 2000
    slopes = Peaked(np.zeros(n), np.ones((n, 1)), np.ones(1), np.zeros((0, 2)), [slice(0, n)])
    grid = NoiseGrid.build(slopes, full_box(n))
    step = np.ptp(grid.box, axis=1) / GRID
    assert np.allclose(grid.points.min(axis=0), grid.box[:, 0] + 0.5 * step)
    assert np.allclose(grid.points.max(axis=0), grid.box[:, 1] - 0.5 * step)
    assert len(grid.points) == len(grid.nodes) == GRID[0] * GRID[1]
    assert (len(evaluated) == ZOOMS * len(grid.nodes)) == (width < 0.001)


@pytest.mark.parametrize("curvature", [-0.9, 0.5, 0.9])
def test_secant_steps_converge_faster_for_large_residuals(curvature: float) -> None:
    """r = (x + 1, c x^2 + x - 1), least at zero. Gauss-Newton steps leave c of the error (Fletcher
    1987, 6.1)."""
    n_evaluations = {}
    for secant in (False, True):
        evaluated: list[float] = []

        def residuals(
            x: np.ndarray, evaluated: list[float] = evaluated
        ) -> tuple[np.ndarray, np.ndarray]:
            evaluated.append(float(x[0]))
            return np.array([x[0] + 1, curvature * x[0] ** 2 + x[0] - 1]), np.array(
                [[1.0], [2 * curvature * x[0] + 1]]
            )

        optimum = minimise(
            Problem(("x",), residuals),
            np.array([0.1]),
            tolerance=1e-14,
            relative=0.0,
            damping=1e-6,
            secant=secant,
        )
        n_evaluations[secant] = len(evaluated)
    assert optimum.converged
    assert abs(optimum.theta[0]) < 1e-6  # a step that gains 1e-14 is 1e-7 long or less
    assert 2 * n_evaluations[True] < n_evaluations[False]


def test_steps_that_follow_a_curved_valley_are_fewer() -> None:
    """A valley y = x^3 with steep walls, along which the cost falls slowly to (1, 1)."""

    def residual(theta: Array) -> Array:
        x, y = theta
        return np.array([30.0 * (y - x**3), x - 1.0])

    def evaluate(theta: Array) -> tuple[Array, Array]:
        return residual(theta), np.array([[-90.0 * theta[0] ** 2, 30.0], [1.0, 0.0]])

    start = np.array([-1.2, 1.0])
    straight = minimise(Problem(("x", "y"), evaluate), start, limit=1000)
    bent = minimise(Problem(("x", "y"), evaluate, residual=residual), start, limit=1000)
    assert straight.converged
    assert bent.converged
    assert np.allclose(bent.theta, 1.0, atol=1e-6)
    assert bent.steps < 0.5 * straight.steps


def test_steps_that_bend_stay_in_the_box() -> None:
    """The residual is not computed outside, where the model may have no value."""

    def residual(theta: Array) -> Array:
        assert theta[0] >= 0
        return np.array([np.sqrt(theta[0]) - 2.0, 0.1 * (theta[0] - 4.0)])

    def evaluate(theta: Array) -> tuple[Array, Array]:
        return residual(theta), np.array([[0.5 / np.sqrt(max(theta[0], 1e-12))], [0.1]])

    problem = Problem(("x",), evaluate, lower=np.zeros(1), residual=residual)
    optimum = minimise(problem, np.array([30.0]))
    assert optimum.converged
    assert abs(optimum.theta[0] - 4.0) < 1e-3


def test_eliminated_linear_parameters_are_optimal_at_every_point() -> None:
    """The least cost over ten linear parameters with priors by their normal equations; its slope
    by differences."""
    rng = np.random.default_rng(3)
    linear = rng.normal(size=(30, 10))
    nonlinear = rng.normal(size=(30, 2))
    prior_sd = rng.uniform(0.2, 3.0, 10)
    prior = rng.normal(size=10)

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        transformed = np.sin(theta[:2])
        return nonlinear @ transformed + linear @ theta[2:] - 1.0, np.column_stack(
            [nonlinear * np.cos(theta[:2]), linear]
        )

    full_problem = Problem(
        tuple(f"p{k}" for k in range(12)),
        evaluate,
        prior_mean=np.r_[0.0, 0.0, prior],
        prior_sd=np.r_[np.inf, np.inf, prior_sd],
    )
    reduced = eliminate_linear(full_problem, 2, rng.normal(size=12))

    def cost(theta: np.ndarray) -> float:
        rows = np.vstack([linear, np.diag(1 / prior_sd)])
        base = np.r_[nonlinear @ np.sin(theta) - 1.0, -prior / prior_sd]
        return float(np.linalg.lstsq(rows, -base)[1][0])

    for theta in rng.normal(size=(5, 2)):
        evaluation = reduced.evaluate(theta)
        assert evaluation is not None
        residual, slope = evaluation
        assert residual @ residual == pytest.approx(cost(theta), rel=1e-9)
        difference = [(cost(theta + h) - cost(theta - h)) / 2e-6 for h in 1e-6 * np.eye(2)]
        assert 2 * residual @ slope == pytest.approx(difference, rel=1e-5)
