"""Where the search begins: time constants and dead times read off a bank of lags, then SRIVC; no start is asked
for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from calibration.arrays import Array
from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.identify.models import Model
from tcdyn.identify.problem import Problem
from tcdyn.identify.srivc import filled, srivc, transfer_starts


def lag_bank(problem: Problem, taus_s: Array) -> list[Array]:
    """Per segment the input through 1/(1 + tau s) (and integrators, known part), shape (len(taus), N)."""
    start = "zero" if problem.initial == "zero" else "equilibrium"
    known = problem.model.known
    banks = []
    for s in problem.segments:
        rows = []
        for tau in taus_s:
            factors = (Factor((1.0, tau)), *known.factors)
            system = realise(Rational(np.array(known.num), factors, 0.0, problem.model.integrators), False)
            rows.append(simulate_rows(system, s.u, problem.dt_s, 0.0, problem.hold, start)[0])  # type: ignore
        banks.append(np.array(rows))
    return banks


def best_shift(problem: Problem, bank: list[Array], k: int, limit: int) -> tuple[int, float]:
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


def one_lag_starts(problem: Problem) -> list[tuple[float, float]]:
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


def polished(problem: Problem, theta: Mapping[str, float]) -> tuple[float, Array]:
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


def process_starts(problem: Problem) -> list[Array]:
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


def starts(problem: Problem) -> list[Array]:
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
        lead = one_lag_starts(replace(problem, model=model))[:2]
        delays = sorted({f * d for _, d in lead for f in (0.0, 0.5, 1.0)})
    return [polished(problem, theta)[1] for theta in transfer_starts(problem, delays)]
