"""The one least-squares core against closed forms, limits and repeated simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from tcdyn.core import Array
from tcdyn.estimation import (
    Evaluate,
    Problem,
    Status,
    correlation_length,
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
from tcdyn.estimation.noise_average import GRID, ZOOMS, LinearisedProblem, NoiseGrid, full_box


def line(design: Array, y: Array) -> Evaluate:
    return lambda theta: (design @ theta - y, design)


def decay(t: Array, y: Array, sd: float) -> Evaluate:
    def evaluate(theta: Array) -> tuple[Array, Array]:
        e = np.exp(-t / theta[1])
        return (theta[0] * e - y) / sd, np.column_stack([e, theta[0] * e * t / theta[1] ** 2]) / sd

    return evaluate


def test_a_linear_problem_with_priors_has_the_posterior_of_the_textbook() -> None:
    """Bishop, Pattern Recognition and Machine Learning (2006), eq. 3.50, 3.51; scales over twelve decades."""
    rng = np.random.default_rng(0)
    scale = np.array([1e-6, 1.0, 1e6])
    design = rng.standard_normal((40, 3)) * scale
    truth = np.array([1.0, -2.0, 0.5]) / scale
    y = design @ truth + rng.standard_normal(40)
    mean = np.array([0.5, 0.0, 0.0]) / scale
    sd = np.array([0.1, np.inf, np.inf]) / scale
    best = minimise(Problem(("a", "b", "c"), line(design, y), mean, sd), np.zeros(3))
    precision = np.diag([1 / sd[0] ** 2, 0.0, 0.0])
    covariance = np.linalg.inv((design.T @ design + precision) * np.outer(1 / scale, 1 / scale))
    expected = covariance @ ((design.T @ y + precision @ mean) / scale)
    assert best.theta * scale == pytest.approx(
        expected, rel=1e-9
    )  # linear: the minimum but for rounding
    assert best.covariance * np.outer(scale, scale) == pytest.approx(covariance, rel=1e-9)
    assert best.u("b") == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-9)
    assert set(best.pulls) == {"a"}


def test_a_pull_is_normal_where_the_prior_is_right() -> None:
    rng = np.random.default_rng(1)
    design = np.column_stack([np.ones(30), np.linspace(-1, 1, 30)])
    pulls = []
    for _ in range(400):
        a = rng.normal(2.0, 0.3)
        y = design @ [a, 1.0] + rng.standard_normal(30)
        problem = Problem(
            ("a", "b"), line(design, y), np.array([2.0, 0.0]), np.array([0.3, np.inf])
        )
        pulls.append(minimise(problem, np.zeros(2)).pulls["a"])
    assert abs(np.mean(pulls)) < 0.15  # three standard errors of 400
    assert np.std(pulls) == pytest.approx(1.0, abs=0.11)


def test_a_held_bound_is_reported_and_the_rest_is_fitted_with_it() -> None:
    design = np.column_stack([np.ones(20), np.arange(20.0)])
    y = design @ [-1.0, 0.5]
    best = minimise(
        Problem(("a", "b"), line(design, y), lower=np.array([0.0, -np.inf])), np.array([3.0, 3.0])
    )
    assert best.status is Status.AT_BOUND
    assert best.theta[0] == 0.0
    assert best.theta[1] == pytest.approx(
        float(design[:, 1] @ y / (design[:, 1] @ design[:, 1])), rel=1e-9
    )


def test_fixed_combinations_stay_and_narrow_the_covariance() -> None:
    """Two shares that add to one are one parameter fewer: the constrained least squares of the textbook."""
    rng = np.random.default_rng(2)
    design = rng.standard_normal((25, 3))
    y = design @ [0.3, 0.7, 2.0] + 0.1 * rng.standard_normal(25)
    problem = Problem(("a", "b", "c"), line(design, y), fixed=np.array([[1.0, 1.0, 0.0]]))
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


def test_free_parameters_keep_their_own_axes() -> None:
    d = free_directions(np.array([[0.0, 1.0, 1.0, 0.0]]))
    assert np.array_equal(d[[0, 3], :2], np.eye(2))
    assert d[[0, 3], 2] == pytest.approx(0.0)
    assert d[1, 2] == pytest.approx(-d[2, 2])


def test_a_model_that_ends_somewhere_stops_the_search_at_its_edge() -> None:
    t = np.linspace(0, 1, 30)
    whole = decay(t, 2 * np.exp(-t / 0.3), 1.0)
    found = minimise(
        Problem(("size", "tau"), lambda x: whole(x) if x[1] > 0.5 else None), np.array([1.0, 1.0])
    )
    assert found.status is Status.EDGE
    assert 0.5 < found.theta[1] < 0.51
    nowhere = minimise(Problem(("size", "tau"), lambda x: None), np.array([1.0, 1.0]))
    assert nowhere.status is Status.NOWHERE
    assert not nowhere.converged


def test_no_step_is_larger_than_allowed() -> None:
    seen: list[Array] = []
    whole = decay(np.linspace(0, 1, 30), np.full(30, 1.0), 1.0)

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        seen.append(x.copy())
        return whole(x)

    minimise(
        Problem(("size", "tau"), evaluate, max_step=np.array([np.inf, 0.1])),
        np.array([1.0, 0.3]),
        limit=5,
    )
    tau = [x[1] for x in seen]
    assert max(abs(np.array(tau) - 0.3)) <= 0.5 + 1e-12  # five steps
    assert len(seen) >= 5


@pytest.mark.parametrize("loss", ["huber", "bisquare"])
def test_spikes_do_not_sway_robust_losses(loss: str) -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0, 3, 400)
    y = 2 * np.exp(-t / 0.7) + 0.01 * rng.standard_normal(400)
    y[::20] += 1.0
    problem = Problem(("size", "tau"), decay(t, y, 1.0))
    plain = minimise(problem, np.array([1.0, 1.0]))
    best = minimise(problem, np.array([1.0, 1.0]), loss=loss)  # type: ignore[arg-type]
    assert abs(plain.theta[1] - 0.7) > 0.02
    assert best.theta[1] == pytest.approx(0.7, abs=0.006)
    assert best.weights is not None
    assert best.weights[::20].max() < 0.03


def test_a_linear_profile_is_the_normal_parabola_with_its_interval() -> None:
    rng = np.random.default_rng(4)
    design = rng.standard_normal((50, 3))
    y = design @ [1.0, 2.0, 3.0] + rng.standard_normal(50)
    best = minimise(Problem(("a", "b", "c"), line(design, y)), np.zeros(3))
    walk = profile(best, "b", step=0.3)
    z = (walk.value - best.value("b")) / best.u("b")
    assert walk.deviance == pytest.approx(z**2, rel=1e-6, abs=1e-8)
    assert walk.low95 == pytest.approx(best.value("b") - 1.96 * best.u("b"), abs=1e-4 * best.u("b"))
    assert walk.high95 == pytest.approx(
        best.value("b") + 1.96 * best.u("b"), abs=1e-4 * best.u("b")
    )


@pytest.mark.study
def test_a_skewed_profile_covers_as_often_as_it_says() -> None:
    """A lag told to 25 %: intervals by profile hold the truth 95 times in a hundred, the symmetric ones fail above."""
    rng = np.random.default_rng(5)
    t = np.linspace(0, 3, 60)
    inside = []
    for _ in range(300):
        y = np.exp(-t / 0.7) + 0.25 * rng.standard_normal(60)
        best = minimise(
            Problem(("size", "tau"), decay(t, y, 0.25), lower=np.array([-9.0, 1e-2])),
            np.array([1.0, 0.7]),
        )
        walk = profile(best, "tau", step=1.0, refine=0.02, max_deviance=4.0)
        inside.append((walk.low95 or 0.0) < 0.7 < (walk.high95 or np.inf))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.038)  # three standard errors of 300


def test_an_interval_that_meets_the_bound_is_open() -> None:
    t = np.linspace(0, 3, 60)
    y = 0.3 * np.exp(-t / 0.7)
    problem = Problem(
        ("size", "tau"), decay(t, y, 0.25), lower=np.array([0.0, 0.1]), upper=np.array([2.0, 2.0])
    )
    walk = profile(minimise(problem, np.array([0.3, 0.7])), "tau")
    assert walk.high95 is None
    assert walk.value[-1] == 2.0


@pytest.mark.parametrize("floor", [0.0, -9.0])
def test_the_profile_of_a_mean_is_that_of_the_value_it_says_where_parts_of_it_reach_their_bounds(
    floor: float,
) -> None:
    """Each point against the least squares with that mean and that box, found by quadratic programming (SLSQP)."""
    rng = np.random.default_rng(8)
    design = rng.standard_normal((40, 4)) * [1.0, 3.0, 0.3, 1.0]
    y = design @ [0.1, 0.6, 0.9, 2.0] + 0.3 * rng.standard_normal(40)
    lower = np.array([floor, floor, floor, -9.0])
    best = minimise(Problem(("a", "b", "c", "d"), line(design, y), lower=lower), np.ones(4))
    mean = np.array([1.0, 1.0, 1.0, 0.0]) / 3
    walk = profile(best, mean, u=0.1, step=1.0, max_deviance=1e6, max_distance=8.0)
    for value, at in zip(walk.value, walk.optima):
        referee = minimize(
            lambda x: float(np.sum((design @ x - y) ** 2)),
            at.theta,
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
        assert at.value(mean) == pytest.approx(value, rel=1e-9)
        assert at.converged
        assert np.all(at.theta >= lower)
        assert at.cost == pytest.approx(referee.fun, rel=1e-6)
    least = 0.0 if floor == 0.0 else -np.inf
    assert walk.value[0] > least  # a mean of what is never negative is not followed below zero
    if floor == 0.0:
        assert np.count_nonzero(walk.optima[0].theta[:3] == 0.0) >= 1  # what this is about


def test_a_profile_of_a_function_of_a_parameter_steps_in_the_function() -> None:
    t = np.linspace(0, 3, 200)
    y = np.exp(-t / 0.7) + 0.05 * np.random.default_rng(6).standard_normal(200)

    def evaluate(theta: Array) -> tuple[Array, Array]:
        r, j = decay(t, y, 0.05)(np.array([theta[0], np.exp(theta[1])]))
        return r, j * [1.0, np.exp(theta[1])]

    straight = minimise(Problem(("size", "tau"), decay(t, y, 0.05)), np.array([1.0, 0.5]))
    best = minimise(Problem(("size", "log_tau"), evaluate), np.array([1.0, np.log(0.5)]))
    walk = profile(
        best,
        "log_tau",
        u=straight.u("tau"),
        value=lambda x: float(np.exp(x)),
        at=lambda v: float(np.log(v)),
    )
    other = profile(straight, "tau")
    assert walk.value == pytest.approx(other.value, rel=1e-6)
    assert walk.deviance == pytest.approx(other.deviance, rel=1e-5, abs=1e-6)


def test_crossing_is_none_where_the_level_is_never_reached() -> None:
    assert first_crossing(np.arange(3.0), np.array([0.0, 0.1, 0.2])) is None


def test_unseen_directions_are_told() -> None:
    rows = np.column_stack([np.ones(9), 2 * np.ones(9)])
    assert not is_full_rank(rows.T @ rows)
    assert covariance_from_rows(rows)[1] < 1e-12
    seen = np.column_stack([1e-9 * np.ones(9), 1e9 * np.arange(9.0)])
    assert is_full_rank(seen.T @ seen)
    assert covariance_from_rows(seen)[0] == pytest.approx(inverse(seen.T @ seen), rel=1e-9)


def test_coloured_residuals_widen_the_mean_by_their_long_run_variance() -> None:
    """AR(1) with a: the variance of a mean grows by (1 + a)/(1 - a); sandwich and correlation length know it."""
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
    assert correlation_length(e) == pytest.approx(
        factor, rel=0.15
    )  # short-memory estimate of a sum over lags
    white = rng.standard_normal((5000, 3))
    assert slow_variance_factor(white) < 1.6  # 3 x 24 squares: 1 + 3 sqrt(2/72)
    assert slow_variance_factor(white + np.sin(np.arange(5000) / 800)[:, None]) > 50


@pytest.mark.parametrize("width", [0.5, 0.05, 0.0005])
def test_the_box_of_a_noise_grid_is_that_of_its_nodes_however_often_it_is_drawn_closer(width):
    class Peaked(LinearisedProblem):
        """ln likelihood that falls by 0.5 within ``width`` of one noise."""

        def marginal(self, noise):
            a = noise.ar[0]
            c = noise.ma[0]
            asked.append((a, c))
            return -0.5 * ((a + 0.8) ** 2 + (c + 0.3) ** 2) / width**2, np.zeros(1), np.eye(1)

    asked: list[tuple[float, float]] = []
    n = 2000
    slopes = Peaked(np.zeros(n), np.ones((n, 1)), np.ones(1), np.zeros((0, 2)), [slice(0, n)], 0)
    grid = NoiseGrid.build(slopes, full_box(n))
    step = np.ptp(grid.box, axis=1) / GRID
    assert np.allclose(grid.points.min(axis=0), grid.box[:, 0] + 0.5 * step)
    assert np.allclose(grid.points.max(axis=0), grid.box[:, 1] - 0.5 * step)
    assert len(grid.points) == len(grid.nodes) == GRID[0] * GRID[1]
    assert (len(asked) == ZOOMS * len(grid.nodes)) == (width < 0.001)


@pytest.mark.parametrize("curvature", [-0.9, 0.5, 0.9])
def test_secant_steps_learn_the_curvature_of_residuals_that_stay_large(curvature: float) -> None:
    """r = (x + 1, c x^2 + x - 1), least at zero; steps by the information alone leave c of x (Fletcher 1987, 6.1)."""
    asked = {}
    for secant in (False, True):
        places: list[float] = []

        def large(x: np.ndarray, places: list[float] = places) -> tuple[np.ndarray, np.ndarray]:
            places.append(float(x[0]))
            return np.array([x[0] + 1, curvature * x[0] ** 2 + x[0] - 1]), np.array(
                [[1.0], [2 * curvature * x[0] + 1]]
            )

        found = minimise(
            Problem(("x",), large),
            np.array([0.1]),
            tolerance=1e-14,
            relative=0.0,
            damping=1e-6,
            secant=secant,
        )
        asked[secant] = len(places)
    assert found.converged
    assert abs(found.theta[0]) < 1e-6  # a step that gains 1e-14 is 1e-7 long or less
    assert 2 * asked[True] < asked[False]


def test_what_enters_linearly_is_at_its_best_wherever_the_others_are() -> None:
    """The least cost over ten linear parameters with priors by their normal equations, its slope by differences."""
    rng = np.random.default_rng(3)
    linear = rng.normal(size=(30, 10))
    other = rng.normal(size=(30, 2))
    prior_sd = rng.uniform(0.2, 3.0, 10)
    prior = rng.normal(size=10)

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        bend = np.sin(theta[:2])
        return other @ bend + linear @ theta[2:] - 1.0, np.column_stack(
            [other * np.cos(theta[:2]), linear]
        )

    whole = Problem(
        tuple(f"p{k}" for k in range(12)),
        evaluate,
        prior_mean=np.r_[0.0, 0.0, prior],
        prior_sd=np.r_[np.inf, np.inf, prior_sd],
    )
    few = eliminate_linear(whole, 2, rng.normal(size=12))

    def cost(theta: np.ndarray) -> float:
        rows = np.vstack([linear, np.diag(1 / prior_sd)])
        left = np.r_[other @ np.sin(theta) - 1.0, -prior / prior_sd]
        return float(np.linalg.lstsq(rows, -left)[1][0])

    for theta in rng.normal(size=(5, 2)):
        answer = few.evaluate(theta)
        assert answer is not None
        residual, slope = answer
        assert residual @ residual == pytest.approx(cost(theta), rel=1e-9)
        by = [(cost(theta + h) - cost(theta - h)) / 2e-6 for h in 1e-6 * np.eye(2)]
        assert 2 * residual @ slope == pytest.approx(by, rel=1e-5)
