"""Where the search begins: lags and dead times read off a bank of lags, then SRIVC; no start is asked for.

SRIVC (simplified refined instrumental variables for continuous time) is Young and Jakeman's idea in this package's own
terms: with the current denominator A, both records are filtered by s^j/A; the regression A y_f = B u_f is solved with
instruments that are free of noise. Those instruments are exactly the output-error Jacobian of the current model, so the
same realisation serves both.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import product

import numpy as np

from calibration import Array
from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.identify.data import Segment
from tcdyn.identify.models import Model
from tcdyn.identify.problem import Posed

Pool = Iterator[tuple[float, Array]]  # costs and the x that they belong to


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


def regression(problem: Posed, den: Array, num: Array, delay_s: float) -> tuple[Array, Array, Array]:
    """Target, regressors and instruments of one SRIVC step over all segments; the last column is the offset.

    The target is y/A, the regressors s^j/A of the input and -s^j/A of the output; the output's instruments are
    the same of the model's own output. Filters begin in equilibrium at the output's first level.
    """
    n, q = len(den) - 1, len(num)
    own = Factor(tuple(den))
    prefilter = realise(Rational(np.eye(n + 1)[0], (Factor(own.coefs, free=False),)))
    model = Rational(num, (*problem.model.known.factors, own), delay_s, problem.model.integrators)
    tables = []
    for segment in problem.segments:
        y = filled(segment)
        level = float(np.mean(y[: max(1, min(5, len(y) // 20))]))
        measured = simulate_rows(prefilter, y - level, problem.dt_s, 0.0, "foh", "zero")[1 : n + 2]
        measured[0] += level
        rows = simulate_rows(realise(model), segment.u, problem.dt_s, delay_s, problem.hold, problem.begun)[1:-1]
        tables.append(np.vstack([measured[:1], rows[:q], -measured[1:], rows, np.ones(len(y))])[:, segment.seen])
    table = np.hstack(tables).T
    target, inputs, outputs, instruments, one = np.split(table, [1, 1 + q, 1 + q + n, 1 + 2 * q + 2 * n], axis=1)
    return target[:, 0], np.hstack([inputs, outputs, one]), np.hstack([instruments, one])


def srivc(
    problem: Posed, zeros: int, poles: int, delay_s: float, rate: float, iterations: int = 8
) -> tuple[Array, Array] | None:
    """Numerator and denominator, ascending, iterated from the prefilter (1 + s/rate)^poles; None where it fails."""
    a, num = np.asarray(np.poly1d([1.0 / rate, 1.0]) ** poles, dtype=float)[::-1], np.eye(zeros + 1)[0]
    for k in range(iterations):
        target, phi, z = regression(problem, a, num, delay_s)
        z = (phi if k == 0 else z) / (np.linalg.norm(phi if k == 0 else z, axis=0) + 1e-300)
        scale = np.linalg.norm(phi, axis=0) + 1e-300
        x = np.linalg.lstsq(z.T @ (phi / scale), z.T @ target, rcond=1e-12)[0] / scale
        if not np.all(np.isfinite(x)) or x[-2] == 0:
            return None
        before, num, a = a, x[: zeros + 1], stabilised(np.concatenate([[1.0], x[zeros + 1 : -1]]))
        if np.allclose(a, before, rtol=1e-3, atol=0):
            break
    return num, a


def transfer_starts(problem: Posed, delays_s: Iterable[float]) -> Pool:
    """Starts for a general transfer function: SRIVC over prefilters, from the record's length to its sampling, and
    candidate dead times."""
    model = problem.model
    zeros = sum(n.startswith("b") for n in model.names) - 1
    for delay, rate in product(delays_s, np.geomspace(6.0 / problem.longest_s, 0.6 / problem.dt_s, 6)):
        if (answer := srivc(problem, zeros, model.order, delay, float(rate))) is not None:
            num, den = ({f"{c}{i}": float(v) for i, v in enumerate(part)} for c, part in zip("ba", answer))
            yield polished(problem, {**num, **den, "Td": delay})


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
    score, yy = np.zeros(limit + 1), 0.0
    floor = 0.0 if problem.model.fixed.get("Kp", -1.0) > 0 else -np.inf  # a gain of either sign unless it is known
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
        score[: reach + 1] += np.maximum(cross[: reach + 1], floor) ** 2 / np.maximum(
            spread, 1e-12 * squares[-1] + 1e-300
        )
        yy += float(y @ y)
    best = int(np.argmax(score))
    return best, float(score[best] / max(yy, 1e-300))


def one_lag_starts(problem: Posed) -> list[tuple[float, float]]:
    """(time constant, dead time) [s] of one-lag approximations, best first: every whole-sample shift is tried."""
    model = problem.model
    taus = np.geomspace(problem.dt_s, 0.5 * problem.longest_s, 12)
    longest = model.fixed.get("Td", problem.longest_delay_s)
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


def process_starts(problem: Posed) -> Pool:
    """Starts for a process model: total lag and dead time shared out, and SRIVC where poles may be complex."""
    model = problem.model
    seen = one_lag_starts(problem)[:4]
    if model.order == 0:
        for _, delay in seen[:3]:
            yield polished(problem, {"Kp": 1.0, "Td": delay})
        return
    for (tau, delay), pattern in product(seen, range(3)):
        yield polished(problem, spread(model, tau, delay, pattern))
    if model.order in (2, 3) and {"Tw", "Tz"} & set(model.names) and "Tc" not in model.names:
        tau, delay = seen[0]
        for share, rate in product((1.0, 0.5), (1.0 / tau, 4.0 / tau)):
            answer = srivc(problem, int("Tz" in model.names), model.order, share * delay, rate, iterations=4)
            if answer is not None:
                yield polished(problem, from_poles(model, *answer, share * delay))


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
        pool = process_starts(problem)
    elif model.has_delay:
        pool = transfer_starts(
            problem, sorted({f * d for _, d in one_lag_starts(problem)[:2] for f in (0.0, 0.5, 1.0)})
        )
    else:
        pool = transfer_starts(problem, [model.fixed.get("Td", 0.0)])
    return [x for cost, x in sorted(pool, key=lambda item: item[0]) if np.isfinite(cost)]
