"""Simplified refined instrumental variables for continuous time (SRIVC): starts that need no start.

Young and Jakeman's idea in this package's own terms: with the current denominator A, both records are filtered by
s^j/A; the regression A y_f = B u_f is solved with instruments that are free of noise. Those instruments are
exactly the output-error Jacobian of the current model, so the same realisation serves both.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from calibration.arrays import Array
from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.identify.models import Model
from tcdyn.identify.problem import Problem, Segment


def filled(segment: Segment) -> Array:
    """The output with its gaps bridged by straight lines; only starts use it."""
    t = np.arange(len(segment.y))
    return np.interp(t, t[segment.seen], segment.y[segment.seen])


def stabilised(den: Array) -> Array:
    """Ascending denominator 1 + a1 s + .. with right-half-plane roots mirrored into the left."""
    roots = np.roots(den[::-1])
    roots = np.where(roots.real > 0, -roots.conj(), roots)
    floor = 1e-6 * np.max(np.abs(roots))
    roots = np.where(np.abs(roots.real) < floor, roots - floor, roots)
    poly = np.poly(roots).real[::-1]
    return np.asarray(poly / poly[0])


def output_terms(problem: Problem, segment: Segment, den: Array) -> Array:
    """s^j/A of the measured output, j = 0..n, shape (n + 1, N), started in equilibrium at its first level."""
    n = len(den) - 1
    y = filled(segment)
    level = float(np.mean(y[: max(1, min(5, len(y) // 20))]))
    model = Rational(np.eye(n + 1)[0], (Factor(tuple(den), free=False),))
    rows = simulate_rows(realise(model), y - level, problem.dt_s, 0.0, "foh", "zero")[1 : n + 2]
    rows[0] += level
    return rows


def regression(problem: Problem, den: Array, num: Array, delay_s: float) -> tuple[Array, Array, Array]:
    """Target, regressors and instruments of one SRIVC step over all segments; the last column is the offset."""
    targets, regressors, instruments = [], [], []
    q = len(num)
    for segment in problem.segments:
        yf = output_terms(problem, segment, den)
        factors = (*problem.model.known.factors, Factor(tuple(den)))
        model = Rational(num, factors, delay_s, problem.model.integrators)
        start = "zero" if problem.initial == "zero" else "equilibrium"
        rows = simulate_rows(realise(model), segment.u, problem.dt_s, delay_s, problem.hold, start)  # type: ignore
        inputs, noise_free = rows[1 : q + 1], rows[q + 1 : -1]
        one = np.ones(len(segment.u))
        keep = segment.seen
        targets.append(yf[0][keep])
        regressors.append(np.vstack([inputs, -yf[1:], one])[:, keep].T)
        instruments.append(np.vstack([inputs, noise_free, one])[:, keep].T)
    return np.concatenate(targets), np.vstack(regressors), np.vstack(instruments)


def solve(target: Array, regressors: Array, instruments: Array) -> Array:
    """(Z'Phi)^-1 Z'y in a balanced scale."""
    sz = np.linalg.norm(instruments, axis=0) + 1e-300
    sp = np.linalg.norm(regressors, axis=0) + 1e-300
    z = instruments / sz
    matrix = z.T @ (regressors / sp)
    return np.asarray(np.linalg.lstsq(matrix, z.T @ target, rcond=1e-12)[0] / sp)


def simulated_cost(problem: Problem, num: Array, den: Array, delay_s: float, offset: float) -> float:
    """Sum of squared simulation errors."""
    known = problem.model.known
    factors = (Factor(tuple(den)), *known.factors)
    model = Rational(np.asarray(np.convolve(num, known.num), dtype=float), factors, delay_s, problem.model.integrators)
    system = realise(model, sensitivities=False)
    start = "zero" if problem.initial == "zero" else "equilibrium"
    total = 0.0
    for s in problem.segments:
        y = simulate_rows(system, s.u, problem.dt_s, delay_s, problem.hold, start)[0] + offset  # type: ignore
        total += float(np.sum((y - s.y)[s.seen] ** 2))
    return total if np.isfinite(total) else np.inf


def srivc(
    problem: Problem, zeros: int, poles: int, delay_s: float, rates: Iterable[float], iterations: int = 8
) -> tuple[float, Array, Array] | None:
    """The best (cost, numerator, denominator) over prefilters (1 + s/rate)^poles, each iterated ``iterations``
    times."""
    best: tuple[float, Array, Array] | None = None
    for rate in rates:
        den = np.poly1d([1.0 / rate, 1.0]) ** poles
        a = np.asarray(den.coeffs[::-1], dtype=float)
        num = np.zeros(zeros + 1)
        num[0] = 1.0
        last = np.inf
        for k in range(iterations):
            target, phi, z = regression(problem, a, num, delay_s)
            x = solve(target, phi, phi if k == 0 else z)
            if not np.all(np.isfinite(x)) or np.all(x[zeros + 1 : -1] == 0):
                break
            num, a = x[: zeros + 1], np.concatenate([[1.0], x[zeros + 1 : -1]])
            if a[-1] == 0:
                break
            a = stabilised(a)
            cost = simulated_cost(problem, num, a, delay_s, x[-1])
            if best is None or cost < best[0]:
                best = (cost, num, a)
            if abs(last - cost) < 1e-4 * cost:
                break
            last = cost
    return best


def prefilter_rates(problem: Problem, count: int = 6) -> Array:
    """Prefilter corner rates [rad/s], evenly spread in logarithm between the record's length and its sampling."""
    length = max(len(s.u) for s in problem.segments) * problem.dt_s
    return np.geomspace(6.0 / length, 0.6 / problem.dt_s, count)


def transfer_starts(problem: Problem, delays_s: Sequence[float]) -> list[dict[str, float]]:
    """Starts for a general transfer function, best first: SRIVC over prefilters and candidate dead times."""
    model: Model = problem.model
    zeros = sum(n.startswith("b") for n in model.names) - 1
    found = []
    for delay in delays_s:
        answer = srivc(problem, zeros, model.order, delay, prefilter_rates(problem))
        if answer is not None:
            cost, num, den = answer
            theta = {f"b{i}": float(v) for i, v in enumerate(num)}
            theta |= {f"a{j}": float(v) for j, v in enumerate(den) if j > 0}
            found.append((cost, {**theta, "Td": float(delay)}))
    return [model.full(theta) for _, theta in sorted(found, key=lambda item: item[0])]


__all__ = ["prefilter_rates", "srivc", "transfer_starts"]
