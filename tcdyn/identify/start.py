"""Where the search begins: lags and dead times read off a bank of lags, then SRIVC; no start is asked for.

SRIVC (simplified refined instrumental variables for continuous time) is Young and Jakeman's idea in this package's own
terms: with the current denominator A, both records are filtered by s^j/A; the regression A y_f = B u_f is solved with
instruments that are free of noise. Those instruments are exactly the output-error Jacobian of the current model, so the
same realisation serves both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product

import numpy as np

from calibration.arrays import Array
from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.identify.data import Segment
from tcdyn.identify.models import Model
from tcdyn.identify.problem import Posed


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


def output_terms(problem: Posed, segment: Segment, den: Array) -> Array:
    """s^j/A of the measured output, j = 0..n, shape (n + 1, N), started in equilibrium at its first level."""
    n = len(den) - 1
    y = filled(segment)
    level = float(np.mean(y[: max(1, min(5, len(y) // 20))]))
    model = Rational(np.eye(n + 1)[0], (Factor(tuple(den), free=False),))
    rows = simulate_rows(realise(model), y - level, problem.dt_s, 0.0, "foh", "zero")[1 : n + 2]
    rows[0] += level
    return rows


def regression(problem: Posed, den: Array, num: Array, delay_s: float) -> tuple[Array, Array, Array]:
    """Target, regressors and instruments of one SRIVC step over all segments; the last column is the offset."""
    targets, regressors, instruments = [], [], []
    q = len(num)
    factors = (*problem.model.known.factors, Factor(tuple(den)))
    for segment in problem.segments:
        yf = output_terms(problem, segment, den)
        model = Rational(num, factors, delay_s, problem.model.integrators)
        rows = simulate_rows(realise(model), segment.u, problem.dt_s, delay_s, problem.hold, problem.begun)
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


def simulated_cost(problem: Posed, num: Array, den: Array, delay_s: float, offset: float) -> float:
    """Sum of squared simulation errors."""
    own = problem.model
    factors = (Factor(tuple(den)), *own.known.factors)
    model = Rational(np.asarray(np.convolve(num, own.known.num), dtype=float), factors, delay_s, own.integrators)
    system = realise(model, sensitivities=False)
    total = 0.0
    for s in problem.segments:
        y = simulate_rows(system, s.u, problem.dt_s, delay_s, problem.hold, problem.begun)[0] + offset
        total += float(np.sum((y - s.y)[s.seen] ** 2))
    return total if np.isfinite(total) else np.inf


def srivc(
    problem: Posed, zeros: int, poles: int, delay_s: float, rates: Iterable[float], iterations: int = 8
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


def prefilter_rates(problem: Posed, count: int = 6) -> Array:
    """Prefilter corner rates [rad/s], evenly spread in logarithm between the record's length and its sampling."""
    length = max(len(s.u) for s in problem.segments) * problem.dt_s
    return np.geomspace(6.0 / length, 0.6 / problem.dt_s, count)


def transfer_starts(problem: Posed, delays_s: Sequence[float]) -> list[dict[str, float]]:
    """Starts for a general transfer function, best first: SRIVC over prefilters and candidate dead times."""
    model = problem.model
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


def lag_bank(problem: Posed, taus_s: Array) -> list[Array]:
    """Per segment the input through 1/(1 + tau s) (and integrators, known part), shape (len(taus), N)."""
    known = problem.model.known
    banks = []
    for s in problem.segments:
        rows = []
        for tau in taus_s:
            factors = (Factor((1.0, tau)), *known.factors)
            system = realise(Rational(np.array(known.num), factors, 0.0, problem.model.integrators), False)
            rows.append(simulate_rows(system, s.u, problem.dt_s, 0.0, problem.hold, problem.begun)[0])
        banks.append(np.array(rows))
    return banks


def best_shift(problem: Posed, bank: list[Array], k: int, limit: int) -> tuple[int, float]:
    """The whole-sample dead time at which lag ``k`` of the bank correlates best with the output, and that r^2."""
    score = np.zeros(limit + 1)
    floor = 0.0 if problem.model.fixed.get("Kp", -1.0) > 0 else -np.inf  # a gain of either sign unless it is known
    xx = yy = 0.0
    for s, rows in zip(problem.segments, bank):
        x, y = rows[k], filled(s)
        x, y = x - x[0], y - y.mean()
        n = len(x)
        size = 2 ** int(np.ceil(np.log2(2 * n)))
        cross = np.fft.irfft(np.fft.rfft(y, size) * np.conj(np.fft.rfft(x, size)), size)
        reach = min(limit, n - 1)
        head = np.concatenate([[0.0], np.cumsum(x)])
        squares = np.concatenate([[0.0], np.cumsum(x**2)])
        left = n - np.arange(reach + 1)
        spread = squares[left] - head[left] ** 2 / n
        value = np.zeros(limit + 1)
        value[: reach + 1] = np.maximum(cross[: reach + 1], floor) ** 2 / np.maximum(
            spread, 1e-12 * squares[-1] + 1e-300
        )
        score += value
        xx, yy = xx + 1.0, yy + float(y @ y)
    best = int(np.argmax(score))
    return best, float(score[best] / max(yy, 1e-300))


def one_lag_starts(problem: Posed) -> list[tuple[float, float]]:
    """(time constant, dead time) [s] of one-lag approximations, best first: every whole-sample shift is tried."""
    model = problem.model
    length = max(len(s.u) for s in problem.segments) * problem.dt_s
    taus = np.geomspace(problem.dt_s, 0.5 * length, 12)
    longest = model.fixed["Td"] if "Td" in model.fixed else model.delay_max_s or 0.5 * length
    limit = int(longest / problem.dt_s) if model.has_delay else 0
    bank = lag_bank(problem, taus)
    found = []
    for k, tau in enumerate(taus):
        shift, score = best_shift(problem, bank, k, limit)
        found.append((score, float(tau), shift * problem.dt_s))
    found.sort(reverse=True)
    return [(tau, delay) for _, tau, delay in found]


def spread(model: Model, tau: float, delay: float, pattern: int) -> dict[str, float]:
    """Process parameters whose total lag is that of one lag ``tau`` behind ``delay``, shared out by
    ``pattern``."""
    lags = [n for n in model.names if n in ("Tp1", "Tp2", "Tp3", "Tc")]
    theta: dict[str, float] = {"Kp": 1.0, "Tz": (0.3, -0.2, 1.5)[pattern % 3] * tau}
    borrowed = 0.5 * delay if pattern == 1 and len(lags) + 2 * ("Tw" in model.names) > 1 else 0.0
    theta["Td"] = delay - borrowed
    total = tau + borrowed
    ratio = (0.25, 0.5, 0.1)[pattern % 3]
    shares = ratio ** np.arange(max(len(lags), 1))
    if pattern == 0:
        shares = shares / shares[0]
    else:
        shares = shares / shares.sum()
    theta |= {n: float(total * s) * (2.0 if n == "Tc" else 1.0) for n, s in zip(lags, shares)}
    if "Tw" in model.names:
        theta["Tw"], theta["Zeta"] = total * (1.0, 0.5, 0.3)[pattern % 3], (0.7, 0.9, 0.3)[pattern % 3]
        if "Tp3" in model.names:
            theta["Tp3"] = 0.3 * total
    return theta


def polished(problem: Posed, theta: Mapping[str, float]) -> tuple[float, Array]:
    """x with gain, zero, offset and initial states from linear least squares at ``theta``, and the cost there."""
    model = problem.model
    x = problem.vector({**dict.fromkeys(model.names, 0.0), **theta, **model.fixed})
    linear = [i for i, n in enumerate(model.free) if n == "Kp" or n.startswith("b")]
    linear += list(range(problem.n_model, problem.size))
    answer = problem.evaluate(x)
    if answer is None:
        return np.inf, x
    if not linear:
        return float(answer[0] @ answer[0]), x
    r, j = answer
    step = np.linalg.lstsq(j[:, linear], -r, rcond=1e-10)[0]
    x[linear] += step
    rest = r + j[:, linear] @ step
    return float(rest @ rest), x


def process_starts(problem: Posed) -> list[Array]:
    """Starts x for a process model, best first."""
    pool: list[tuple[float, Array]] = []
    seen = one_lag_starts(problem)[:4]
    for (tau, delay), pattern in product(seen, range(3)):
        pool.append(polished(problem, spread(problem.model, tau, delay, pattern)))
    poles = problem.model.order
    if poles in (2, 3) and {"Tw", "Tz"} & set(problem.model.names) and "Tc" not in problem.model.names:
        tau, delay = seen[0]
        zeros = int("Tz" in problem.model.names)
        for share in (1.0, 0.5):
            answer = srivc(problem, zeros, poles, share * delay, [1.0 / tau, 4.0 / tau], iterations=4)
            if answer is not None:
                pool.append(polished(problem, from_poles(problem.model, answer[1], answer[2], share * delay)))
    pool = [p for p in pool if np.isfinite(p[0])]
    pool.sort(key=lambda item: item[0])
    return [x for _, x in pool]


def from_poles(model: Model, num: Array, den: Array, delay_s: float) -> dict[str, float]:
    """Process parameters nearest to a general transfer function: complex poles become two equal lags unless U."""
    poles = np.roots(den[::-1])
    theta = {"Kp": float(num[0]), "Td": delay_s, "Tz": float(num[1] / num[0]) if len(num) > 1 and num[0] else 0.0}
    if "Tw" in model.names:
        pair = poles[np.argsort(-np.abs(poles.imag))][:2]
        w = float(np.sqrt(abs(pair[0] * pair[1])))
        theta |= {"Tw": 1 / w, "Zeta": float(np.clip(-pair.sum().real / (2 * w), 0.02, 5.0))}
        rest = poles[np.argsort(-np.abs(poles.imag))][2:]
        return theta | ({"Tp3": float(1 / abs(rest[0]))} if len(rest) else {})
    taus = sorted((1 / np.abs(poles)).tolist(), reverse=True)
    return theta | {f"Tp{i + 1}": float(t) * (1.0 + 1e-3 * i) for i, t in enumerate(taus)}


def starts(problem: Posed) -> list[Array]:
    """Starts for any model, best first."""
    model = problem.model
    if model.kind == "process":
        if model.order == 0:
            base = dict.fromkeys(model.names, 0.0) | {"Kp": 1.0}
            delays = [d for _, d in one_lag_starts(problem)[:3]] if model.has_delay else [0.0]
            return [polished(problem, {**base, "Td": d})[1] for d in delays]
        return process_starts(problem)
    if not model.has_delay:
        delays = [model.fixed.get("Td", 0.0)]
    else:
        lead = one_lag_starts(problem)[:2]
        delays = sorted({f * d for _, d in lead for f in (0.0, 0.5, 1.0)})
    return [polished(problem, theta)[1] for theta in transfer_starts(problem, delays)]
