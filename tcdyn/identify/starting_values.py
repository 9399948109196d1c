"""Where the search begins: lags and dead times by which the input explains most of the output, then SRIVC; no start is
asked for.

SRIVC (simplified refined instrumental variables for continuous time) is Young and Jakeman's idea in this package's own
terms: with the current denominator A, both records are filtered by s^j/A; the regression A y_f = B u_f is solved with
instruments that are free of noise. Those instruments are exactly the output-error Jacobian of the current model, so the
same realisation serves both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
from scipy import signal

from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.core import Array
from tcdyn.identify.models import Model, bare, several
from tcdyn.identify.problem import Posed
from tcdyn.identify.segments import Segment

# ways to share out one lag: ratio of a lag to the one before, zero and Tw in lags, Zeta
PATTERNS = ((0.25, 0.3, 1.0, 0.7), (0.5, -0.2, 0.5, 0.9), (0.1, 1.5, 0.3, 0.3))


def filled(segment: Segment) -> Array:
    """The output with its gaps bridged by straight lines; only starts use it."""
    t = np.arange(len(segment.y))
    return np.interp(t, t[segment.seen], segment.y[segment.seen])


def level_runs(problem: Posed) -> Posed:
    """The problem with the straight line that fits each run's output best taken out, its level left."""
    segments = []
    for run in sorted(problem.begun_s):
        own = [s for s in problem.segments if s.run == run]
        times = [s.start_s + problem.dt_s * np.arange(len(s.y)) for s in own]
        t, y = (
            np.concatenate([v[s.seen] for v, s in zip(each, own)])
            for each in (times, [s.y for s in own])
        )
        slope = float((t - t.mean()) @ y) / max(float(np.sum((t - t.mean()) ** 2)), 1e-300)
        segments += [replace(s, y=s.y - slope * (v - t.mean())) for v, s in zip(times, own)]
    return replace(problem, segments=tuple(segments))


def stabilised(den: Array) -> Array:
    """Ascending denominator 1 + a1 s + .. with right-half-plane roots mirrored into the left."""
    roots = np.roots(den[::-1])
    roots = np.where(roots.real > 0, -roots.conj(), roots)
    floor = 1e-6 * np.max(np.abs(roots))
    roots = np.where(np.abs(roots.real) < floor, roots - floor, roots)
    poly = np.poly(roots).real[::-1]
    return poly / poly[0]


def regression(
    problem: Posed, den: Array, num: Array, delay_s: float
) -> tuple[Array, Array, Array]:
    """Target, regressors and instruments of one SRIVC step over all segments; the last column is the offset.

    The target is y/A, the regressors s^j/A of the input and -s^j/A of the output; the output's instruments are
    the same of the model's own output. Filters begin in equilibrium at the output's first level.
    """
    n = len(den) - 1
    q = len(num)
    own = Factor(tuple(den))
    prefilter = realise(Rational(np.eye(n + 1)[0], (Factor(own.coefs, free=False),)))
    model = Rational(num, (*problem.model.known.factors, own), delay_s, problem.model.integrators)
    tables = []
    for segment in problem.segments:
        y = filled(segment)
        level = float(np.mean(y[: max(1, min(5, len(y) // 20))]))
        measured = simulate_rows(prefilter, y - level, problem.dt_s, 0.0, "foh", "zero")[1 : n + 2]
        measured[0] += level
        rows = simulate_rows(
            realise(model), segment.u, problem.dt_s, delay_s, problem.hold, problem.begun
        )[1:-1]
        tables.append(
            np.vstack([measured[:1], rows[:q], -measured[1:], rows, np.ones(len(y))])[
                :, segment.seen
            ]
        )
    table = np.hstack(tables).T
    target, inputs, outputs, instruments, one = np.split(
        table, [1, 1 + q, 1 + q + n, 1 + 2 * q + 2 * n], axis=1
    )
    return target[:, 0], np.hstack([inputs, outputs, one]), np.hstack([instruments, one])


def srivc(
    problem: Posed, zeros: int, poles: int, delay_s: float, rate: float, iterations: int
) -> tuple[Array, Array] | None:
    """Numerator and denominator, ascending, iterated from the prefilter (1 + s/rate)^poles; None where it fails."""
    a = np.asarray(np.poly1d([1.0 / rate, 1.0]) ** poles, dtype=float)[::-1]
    num = np.eye(zeros + 1)[0]
    for k in range(iterations):
        target, phi, z = regression(problem, a, num, delay_s)
        z = (phi if k == 0 else z) / (np.linalg.norm(phi if k == 0 else z, axis=0) + 1e-300)
        scale = np.linalg.norm(phi, axis=0) + 1e-300
        x = np.linalg.lstsq(z.T @ (phi / scale), z.T @ target, rcond=1e-12)[0] / scale
        if not np.all(np.isfinite(x)) or x[-2] == 0:
            return None
        before = a
        num = x[: zeros + 1]
        a = stabilised(np.concatenate([[1.0], x[zeros + 1 : -1]]))
        if np.allclose(a, before, rtol=1e-3, atol=0):
            break
    return num, a


def explained(problem: Posed, taus_s: Array, behind: int, ahead: int = 0) -> Array:
    """r^2 of the output with the input behind each lag ``taus_s`` (T,) and shifted by -ahead..behind samples.

    (T, ahead + 1 + behind), over all segments, negative where the gain would be. The integrators and the known part are
    in it; before its first sample a segment's lagged input is as there, after its last it is not known.
    """
    known = problem.model.known
    integrators = problem.model.integrators
    total = np.zeros((len(taus_s), ahead + 1 + behind))
    whole = np.full(ahead + 1 + behind, 1e-300)
    for s in problem.segments:
        y = filled(s) - filled(s).mean()
        count = np.clip(
            len(y) - np.arange(ahead, -behind - 1, -1), 1, len(y)
        )  # samples that have both
        of_y = np.cumsum([np.append(0.0, y), np.append(0.0, y**2)], axis=1)[:, count]
        whole += of_y[1] - of_y[0] ** 2 / count
        for row, tau in zip(total, taus_s):
            lag = realise(
                Rational(
                    np.array(known.num), (Factor((1.0, tau)), *known.factors), 0.0, integrators
                ),
                False,
            )
            x = simulate_rows(lag, s.u, problem.dt_s, 0.0, problem.hold, problem.begun)[0]
            x = np.concatenate([np.zeros(behind + 1), x - x[0], np.zeros(ahead)])
            sums = np.cumsum([x, x**2], axis=1)
            first, second = (sums[:, len(y) :] - sums[:, : -len(y)])[:, ::-1]
            along = signal.correlate(x[1:], y, "valid", "fft")[::-1] - first * of_y[0] / count
            row += (
                np.sign(along)
                * along**2
                / np.maximum(second - first**2 / count, 1e-12 * sums[1, -1] + 1e-300)
            )
    return total / whole


def one_lag_starts(problem: Posed) -> list[tuple[float, float]]:
    """(time constant, dead time) [s] of one-lag approximations, best first: every whole-sample shift is tried."""
    model = problem.model
    taus = np.geomspace(problem.dt_s, 0.5 * problem.longest_s, 12)
    longest = model.fixed.get("Td", problem.longest_delay_s)
    score = explained(problem, taus, int(longest / problem.dt_s) if model.has_delay else 0)
    score = (
        score if model.fixed.get("Kp", -1.0) > 0 else np.abs(score)
    )  # a gain of either sign unless it is known
    best = np.argsort(-score.max(axis=1), kind="stable")
    return [(float(taus[k]), float(np.argmax(score[k])) * problem.dt_s) for k in best]


def spread(model: Model, tau: float, delay: float, pattern: int) -> dict[str, float]:
    """Process parameters whose total lag is that of one lag ``tau`` behind ``delay``, shared out by
    ``pattern``."""
    lags = [n for n in model.names if n in ("Tp1", "Tp2", "Tp3", "Tc")]
    ratio, zero, wave, damping = PATTERNS[pattern]
    theta: dict[str, float] = {"Kp": 1.0, "Tz": zero * tau}
    borrowed = 0.5 * delay if pattern == 1 and len(lags) + 2 * ("Tw" in model.names) > 1 else 0.0
    theta["Td"] = delay - borrowed
    total = tau + borrowed
    shares = ratio ** np.arange(max(len(lags), 1))
    if pattern:
        shares = shares / shares.sum()
    theta |= {n: float(total * s) * (2.0 if n == "Tc" else 1.0) for n, s in zip(lags, shares)}
    if "Tw" in model.names:
        theta["Tw"] = total * wave
        theta["Zeta"] = damping
        if "Tp3" in model.names:
            theta["Tp3"] = 0.3 * total
    return theta


def polished(problem: Posed, theta: Mapping[str, float]) -> tuple[float, Array]:
    """x with gain, zero, offset and initial states from linear least squares at ``theta``, and the cost there."""
    model = problem.model
    x = problem.vector({**dict.fromkeys(model.names, 0.0), **theta, **model.fixed})
    linear = [i for i, n in enumerate(model.free) if bare(n) == "Kp" or n.startswith("b")]
    linear += list(range(problem.n_model, problem.size))
    answer = problem.evaluate(x)
    if answer is None:
        return np.inf, x
    if not linear:
        return float(answer[0] @ answer[0]), x
    told = np.flatnonzero(problem.precision)  # what is known beforehand: samples of its own
    r = np.append(answer[0], np.zeros(len(told)))
    j = np.vstack([answer[1], np.diag(np.sqrt(problem.precision))[told]])
    step = np.linalg.lstsq(j[:, linear], -r, rcond=1e-10)[0]
    x[linear] += step
    rest = r + j[:, linear] @ step
    return float(rest @ rest), x


def from_poles(model: Model, num: Array, den: Array, delay_s: float) -> dict[str, float]:
    """Parameters nearest to a general transfer function; complex poles are two equal lags in a process without U."""
    if model.kind != "process":
        return {"Td": delay_s} | {
            f"{c}{i}": float(v) for c, part in (("b", num), ("a", den)) for i, v in enumerate(part)
        }
    poles = np.roots(den[::-1])
    theta = {
        "Kp": float(num[0]),
        "Td": delay_s,
        "Tz": float(num[1] / num[0]) if len(num) > 1 and num[0] else 0.0,
    }
    if "Tw" in model.names:
        pair = poles[np.argsort(-np.abs(poles.imag))][:2]
        w = float(np.sqrt(abs(pair[0] * pair[1])))
        theta |= {"Tw": 1 / w, "Zeta": float(np.clip(-pair.sum().real / (2 * w), 0.02, 5.0))}
        rest = poles[np.argsort(-np.abs(poles.imag))][2:]
        return theta | ({"Tp3": float(1 / abs(rest[0]))} if len(rest) else {})
    taus = sorted((1 / np.abs(poles)).tolist(), reverse=True)
    return theta | {f"Tp{i + 1}": float(t) * (1.0 + 1e-3 * i) for i, t in enumerate(taus)}


def rest(problem: Posed, theta: Mapping[str, float], k: int) -> Posed:
    """The problem of the ``k``-th input alone, with what the other inputs do at ``theta`` taken out of the output."""
    part, names, _ = problem.branches[k]
    silent = {w: 0.0 for n, w in names.items() if n == "Kp" or n.startswith("b")}
    fixed = replace(problem, model=replace(problem.model, fixed={**theta, **silent}))
    answers = fixed.outputs(polished(problem, theta)[1][problem.n_model :])
    assert answers is not None
    segments = tuple(replace(s.of(k), y=s.y - y) for s, (y, _) in zip(problem.segments, answers))
    model = replace(part, offset=problem.model.offset, delay_max_s=problem.model.delay_max_s)
    return replace(problem, model=model, segments=segments, input_sds=(problem.input_sds[k],))


def one_lag_each(problem: Posed) -> tuple[Posed, dict[str, float]]:
    """The problem with one lag behind each input, and where it explains most with the same lag behind all of them."""
    m = problem.model
    plain = several(["P1"] * len(m.inputs), m.inputs, known=m.known, offset=m.offset)
    posed = replace(problem, model=plain)
    pool = [
        polished(
            posed,
            {
                **dict.fromkeys(plain.names, 0.0),
                **{n: float(tau) for n in plain.names if n[:2] == "Tp"},
            },
        )
        for tau in np.geomspace(problem.dt_s, 0.5 * problem.longest_s, 12)
    ]
    return posed, posed.theta(min(pool, key=lambda item: item[0])[1])


def alone(problem: Posed) -> list[Posed]:
    """The problem of each input by itself, with what one lag behind each of the others explains taken out."""
    if not problem.model.parts:
        return [problem]
    posed, theta = one_lag_each(problem)
    return [rest(posed, theta, k) for k in range(len(posed.branches))]


def starts_of_several(problem: Posed) -> list[Array]:
    """Starts for several inputs: each input's own best start with what the others do taken out, in turns, twice."""
    posed, known = one_lag_each(problem)
    found: list[tuple[float, Array]] = []
    theta: dict[str, float] = {}
    for _ in range(2):
        for k, (part, names, _) in enumerate(problem.branches):
            sub = replace(rest(posed, known, k), model=replace(part, offset=problem.model.offset))
            begun = sub.theta(starts(sub)[0])
            theta |= {names[n]: v for n, v in begun.items()}
        found.append(polished(problem, theta))
        posed = problem
        known = problem.theta(found[-1][1])
    return [x for cost, x in sorted(found, key=lambda item: item[0]) if np.isfinite(cost)]


def starts(problem: Posed) -> list[Array]:
    """Starts for any model, best first.

    One lag's total shared out over those of a process model; SRIVC where its poles may be complex, and for a general
    transfer function over prefilters from the record's length to its sampling and candidate dead times.
    """
    if problem.model.parts:
        return starts_of_several(problem)
    whole = problem
    problem = level_runs(problem) if problem.trend else problem
    model = problem.model
    seen = one_lag_starts(problem)[:4]
    (tau, delay) = seen[0]
    process = model.kind == "process"
    begun: list[dict[str, float]] = []
    if process and model.order == 0:
        begun = [{"Kp": 1.0, "Td": d} for _, d in seen[:3]]
    elif process:
        begun = [spread(model, *one, pattern) for one, pattern in product(seen, range(3))]
    zeros = int("Tz" in model.names)
    delays = [delay, 0.5 * delay]
    rates = [1.0 / tau, 4.0 / tau]
    iterations = 4
    if not process:
        zeros = sum(n.startswith("b") for n in model.names) - 1
        iterations = 8
        delays = sorted({f * d for _, d in seen[:2] for f in (0.0, 0.5, 1.0)})
        delays = delays if model.has_delay else [model.fixed.get("Td", 0.0)]
        rates = np.geomspace(6.0 / problem.longest_s, 0.6 / problem.dt_s, 6).tolist()
    if not process or (
        model.order in (2, 3) and {"Tw", "Tz"} & set(model.names) and "Tc" not in model.names
    ):
        for d, rate in product(delays, rates):
            if (answer := srivc(problem, zeros, model.order, d, rate, iterations)) is not None:
                begun.append(from_poles(model, *answer, d))
    pool = [polished(whole, theta) for theta in begun]
    return [x for cost, x in sorted(pool, key=lambda item: item[0]) if np.isfinite(cost)]
