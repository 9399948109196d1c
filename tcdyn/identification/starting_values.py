"""Starting values of the search: one-lag correlation scan, then SRIVC.

The user need not give any. The scan finds the lags and dead times by which the input explains most
of the output. ``tcdyn.identification.search`` and ``tcdyn.identification.causality`` use it.

SRIVC (simplified refined instrumental variables for continuous time; Young and Jakeman) in the
terms of this package: with the current denominator A, both records are filtered by s^j/A. The
regression A y_f = B u_f is solved with instruments that are free of noise. The instruments are the
output-error Jacobian of the current model, so the same realisation serves both.

Only the start depends on this module: better values save time, worse ones miss the optimum.
``tests/identify/test_identify_starts.py`` checks each function,
``tests/identify/test_identify_fit.py`` that every structure is found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
from scipy import signal

from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.core import Array
from tcdyn.identification.models import Model, base_name, several
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.segments import Segment

# How one lag is shared among the parameters of a process model: ratio of a lag to the one before,
# zero and Tw over the lag, Zeta (chosen by judgement).
LAG_PATTERNS = ((0.25, 0.3, 1.0, 0.7), (0.5, -0.2, 0.5, 0.9), (0.1, 1.5, 0.3, 0.3))
N_LAGS = 12  # lags of the correlation scan, from one sample to half the longest segment
PROCESS_ITERATIONS = 4  # of SRIVC for a process model
TRANSFER_ITERATIONS = 8  # of SRIVC for a transfer function


def remove_run_slopes(problem: IdentificationProblem) -> IdentificationProblem:
    """Remove the least-squares slope of each run's output; its level stays."""
    segments: list[Segment] = []
    for run in sorted(problem.run_start_s):
        run_segments = [s for s in problem.segments if s.run == run]
        times = [s.start_s + problem.dt_s * np.arange(len(s.y)) for s in run_segments]
        t = np.concatenate([v[s.measured] for v, s in zip(times, run_segments)])
        y = np.concatenate([s.y[s.measured] for s in run_segments])
        centred = t - t.mean()
        slope = float(centred @ y) / max(float(np.sum(centred**2)), 1e-300)
        for v, s in zip(times, run_segments):
            segments.append(replace(s, y=s.y - slope * (v - t.mean())))
    return replace(problem, segments=tuple(segments))


def stabilise(den: Array) -> Array:
    """Mirror the right-half-plane roots of a denominator into the left half plane.

    Parameters
    ----------
    den
        Denominator 1 + a1 s + .., ascending (n + 1,).

    Returns
    -------
    array
        Stable denominator with the constant term one (n + 1,). Roots on the imaginary axis are
        moved off it.
    """
    roots = np.roots(den[::-1])
    roots = np.where(roots.real > 0, -roots.conj(), roots)
    floor = 1e-6 * np.max(np.abs(roots), initial=0.0)  # a constant has no roots
    roots = np.where(np.abs(roots.real) < floor, roots - floor, roots)
    polynomial = np.atleast_1d(np.poly(roots)).real[::-1]
    return polynomial / polynomial[0]


def regression(
    problem: IdentificationProblem, den: Array, num: Array, delay_s: float
) -> tuple[Array, Array, Array]:
    """Target, regressors and instruments of one SRIVC step over all segments.

    Parameters
    ----------
    problem
        The identification problem of one input.
    den, num
        Current denominator A and numerator B, ascending in s.
    delay_s
        Dead time [s].

    Returns
    -------
    tuple of array
        Target (N,), regressors and instruments (N, M); the last column is the offset.

    Notes
    -----
    The target is y/A, the regressors s^j/A of the input and -s^j/A of the output. The instruments
    of the output are the same of the model's own output. Filters start in equilibrium at the
    output's first level.
    """
    n = len(den) - 1
    q = len(num)
    factor = Factor(tuple(den))
    prefilter = realise(Rational(np.eye(n + 1)[0], (Factor(factor.coefs, free=False),)))
    factors = (*problem.model.known.factors, factor)
    model = realise(Rational(num, factors, delay_s, problem.model.integrators))
    tables = []
    for segment in problem.segments:
        y = segment.filled_y
        n_first = max(1, min(5, len(y) // 20))
        level = float(np.mean(y[:n_first]))
        filtered = simulate_rows(prefilter, y - level, problem.dt_s, 0.0, "foh", "zero")
        measured = filtered[1 : n + 2]
        measured[0] += level
        rows = simulate_rows(model, segment.u, problem.dt_s, delay_s, problem.hold, problem.start)[
            1:-1
        ]
        table = np.vstack([measured[:1], rows[:q], -measured[1:], rows, np.ones(len(y))])
        tables.append(table[:, segment.measured])
    table = np.hstack(tables).T
    edges = [1, 1 + q, 1 + q + n, 1 + 2 * q + 2 * n]
    target, inputs, outputs, instruments, offset = np.split(table, edges, axis=1)
    regressors = np.hstack([inputs, outputs, offset])
    return target[:, 0], regressors, np.hstack([instruments, offset])


def srivc(
    problem: IdentificationProblem,
    zeros: int,
    poles: int,
    delay_s: float,
    rate: float,
    iterations: int,
) -> tuple[Array, Array] | None:
    """Return numerator and denominator by SRIVC; None where it fails.

    Parameters
    ----------
    problem
        The identification problem of one input.
    zeros, poles
        Degrees of numerator and denominator.
    delay_s
        Dead time [s].
    rate
        Corner of the first prefilter (1 + s/rate)^poles [1/s].
    iterations
        Largest number of iterations; it ends where the denominator changes by less than 1e-3.

    Returns
    -------
    num, den
        Coefficients (zeros + 1,) and (poles + 1,), ascending in s.
    """
    den = np.asarray(np.poly1d([1.0 / rate, 1.0]) ** poles, dtype=float)[::-1]
    num = np.eye(zeros + 1)[0]
    for k in range(iterations):
        target, regressors, instruments = regression(problem, den, num, delay_s)
        if k == 0:
            instruments = regressors
        instruments = instruments / (np.linalg.norm(instruments, axis=0) + 1e-300)
        scale = np.linalg.norm(regressors, axis=0) + 1e-300
        normal = instruments.T @ (regressors / scale)
        x = np.linalg.lstsq(normal, instruments.T @ target, rcond=1e-12)[0] / scale
        if not np.all(np.isfinite(x)) or x[-2] == 0:
            return None
        previous = den
        num = x[: zeros + 1]
        den = stabilise(np.concatenate([[1.0], x[zeros + 1 : -1]]))
        if np.allclose(den, previous, rtol=1e-3, atol=0):
            break
    return num, den


def lagged_input(problem: IdentificationProblem, u: Array, tau_s: float) -> Array:
    """Return the input (N,) behind a lag, the integrators and the known factor, less its start."""
    known = problem.model.known
    factors = (Factor((1.0, tau_s)), *known.factors)
    lag = Rational(np.array(known.num), factors, 0.0, problem.model.integrators)
    x = simulate_rows(realise(lag, False), u, problem.dt_s, 0.0, problem.hold, problem.start)[0]
    return x - x[0]


def lag_correlation(
    problem: IdentificationProblem, taus_s: Array, delay: int, lead: int = 0
) -> Array:
    """r^2 of the output with the input behind each lag, for each shift by whole samples.

    Parameters
    ----------
    problem
        The identification problem of one input.
    taus_s
        Lags (T,) [s].
    delay, lead
        Largest shift behind and ahead of the input, in samples.

    Returns
    -------
    array
        r^2 (T, lead + 1 + delay) over all segments, shifts from -lead to delay; negative where
        the gain would be.

    Notes
    -----
    Integrators and the known factor are included. Before its first sample a segment's lagged input
    is constant; samples after its last are left out.
    """
    n_shifts = lead + 1 + delay
    explained = np.zeros((len(taus_s), n_shifts))
    total = np.full(n_shifts, 1e-300)
    for s in problem.segments:
        y = s.filled_y - s.filled_y.mean()
        # number of samples that both shifted records have
        count = np.clip(len(y) - np.arange(lead, -delay - 1, -1), 1, len(y))
        cumulative = np.cumsum([np.append(0.0, y), np.append(0.0, y**2)], axis=1)
        sum_y, sum_yy = cumulative[:, count]
        total += sum_yy - sum_y**2 / count
        for row, tau in zip(explained, taus_s):
            x = lagged_input(problem, s.u, float(tau))
            x = np.concatenate([np.zeros(delay + 1), x, np.zeros(lead)])
            sums = np.cumsum([x, x**2], axis=1)
            sum_x, sum_xx = (sums[:, len(y) :] - sums[:, : -len(y)])[:, ::-1]
            products = signal.correlate(x[1:], y, "valid", "fft")[::-1]
            covariance = products - sum_x * sum_y / count
            variance = np.maximum(sum_xx - sum_x**2 / count, 1e-12 * sums[1, -1] + 1e-300)
            row += np.sign(covariance) * covariance**2 / variance
    return explained / total


def free_start_correlation(problem: IdentificationProblem, taus_s: Array, delay: int) -> Array:
    """r^2 of the output with the input behind each lag and a decay from any initial state.

    Parameters
    ----------
    problem
        The identification problem of one input.
    taus_s
        Lags (T,) [s].
    delay
        Largest shift behind the input, in samples.

    Returns
    -------
    array
        r^2 (T, 1 + delay) over all segments, shifts from 0 to delay; negative where the gain would
        be.

    Notes
    -----
    Regression on the lagged input, a constant and exp(-t/tau) for each segment. The last two are
    projected out of both records. :func:`lag_correlation` has no decay: with it the response to the
    input may be hidden by that of an initial state.
    """
    explained = np.zeros((len(taus_s), delay + 1))
    total = 1e-300
    for s in problem.segments:
        n = len(s.y)
        y = s.filled_y - s.filled_y.mean()
        total += float(y @ y)
        for row, tau in zip(explained, taus_s):
            decay = np.exp(-problem.dt_s * np.arange(n) / tau)
            basis = np.linalg.qr(np.column_stack([np.ones(n), decay]))[0]
            y_left = y - basis @ (basis.T @ y)
            x = np.concatenate([np.zeros(delay), lagged_input(problem, s.u, float(tau))])
            covariance = signal.correlate(x, y_left, "valid", "fft")[::-1]
            squares = np.cumsum(np.append(0.0, x**2))
            sum_xx = (squares[n:] - squares[:-n])[::-1]
            variance = sum_xx
            for column in basis.T:
                variance = variance - signal.correlate(x, column, "valid", "fft")[::-1] ** 2
            variance = np.maximum(variance, 1e-9 * squares[-1] + 1e-300)
            by_decay = float(y @ y - y_left @ y_left)
            row += np.sign(covariance) * (covariance**2 / variance + by_decay)
    return explained / total


def one_lag_starts(problem: IdentificationProblem) -> list[tuple[float, float]]:
    """Return time constant and dead time [s] of one-lag models, best first.

    Parameters
    ----------
    problem
        The identification problem of one input.

    Returns
    -------
    list of tuple
        One pair for each of ``N_LAGS`` lags; the dead time is a whole number of samples.
    """
    model = problem.model
    taus = np.geomspace(problem.dt_s, 0.5 * problem.longest_segment_s, N_LAGS)
    max_delay_s = model.fixed.get("Td", problem.delay_max_s)
    n_delays = int(max_delay_s / problem.dt_s) if model.has_delay else 0
    if problem.initial in ("level", "estimated"):
        score = free_start_correlation(problem, taus, n_delays)
    else:
        score = lag_correlation(problem, taus, n_delays)
    if not model.fixed.get("Kp", -1.0) > 0:
        score = np.abs(score)  # the gain may have either sign
    best = np.argsort(-score.max(axis=1), kind="stable")
    return [(float(taus[k]), float(np.argmax(score[k])) * problem.dt_s) for k in best]


def share_lag(model: Model, tau: float, delay: float, pattern: int) -> dict[str, float]:
    """Share one lag among the parameters of a process model.

    Parameters
    ----------
    model
        The process model.
    tau
        The lag [s].
    delay
        The dead time [s].
    pattern
        Index in ``LAG_PATTERNS``.

    Returns
    -------
    dict
        Parameters by name, times in s; more than the model may have.

    Notes
    -----
    Without a pair of poles the first pattern keeps the longest lag, the other two the sum of the
    lags. The second takes half of the dead time into the lags, because several lags look like one
    with a dead time. ``tests/identify/test_identify_starts.py`` checks the sum.
    """
    lags = [n for n in model.names if n in ("Tp1", "Tp2", "Tp3", "Tc")]
    has_pair = "Tw" in model.names
    ratio, zero, wave, damping = LAG_PATTERNS[pattern]
    from_delay = 0.0
    if pattern == 1 and len(lags) + 2 * has_pair > 1:
        from_delay = 0.5 * delay
    total = tau + from_delay
    theta: dict[str, float] = {"Kp": 1.0, "Tz": zero * tau, "Td": delay - from_delay}
    shares = ratio ** np.arange(max(len(lags), 1))
    if pattern:
        shares = shares / shares.sum()
    for name, share in zip(lags, shares):
        lag = float(total * share)
        theta[name] = 2.0 * lag if name == "Tc" else lag
    if has_pair:
        theta["Tw"] = total * wave
        theta["Zeta"] = damping
        if "Tp3" in model.names:
            theta["Tp3"] = 0.3 * total
    return theta


def solve_linear_parameters(
    problem: IdentificationProblem, theta: Mapping[str, float]
) -> tuple[float, Array]:
    """Fit the linear parameters at given values of the others.

    Linear are gain, zero, offset, initial states and input levels.

    Parameters
    ----------
    problem
        The identification problem.
    theta
        Parameters by name; missing ones are zero.

    Returns
    -------
    cost
        Sum of squares of the output errors and of the deviations from priors; infinite for an
        unstable model.
    x
        The vector (size,) with fitted gain, numerator, offset, states and levels.

    Notes
    -----
    One step of linear least squares is exact, but for an input level that is estimated: it is
    multiplied by the gain. There the gain starts at one, because a level has no effect on the
    output at a gain of zero, and a second step is taken.

    Singular values below 1e-10 of the largest count as zero (``rcond``): in a combination of
    parameters that the data do not determine, the step is zero.
    """
    model = problem.model
    x = problem.vector({**dict.fromkeys(model.names, 0.0), **theta, **model.fixed})
    gains = [i for i, n in enumerate(model.free) if base_name(n) in ("Kp", "b0")]
    linear = [i for i, n in enumerate(model.free) if base_name(n) == "Kp" or n.startswith("b")]
    linear += list(range(problem.n_model, problem.size))
    has_level = problem.initial == "level"
    if has_level:
        x[gains] = np.where(x[gains] == 0, 1.0, x[gains])
    has_prior = np.flatnonzero(problem.prior_precision)  # each prior is one more row
    prior_rows = np.diag(np.sqrt(problem.prior_precision))[has_prior]
    cost = np.inf
    for _ in range(2 if has_level else 1):
        rows = problem.evaluate(x)
        if rows is None:
            return np.inf, x
        if not linear:
            return float(rows[0] @ rows[0]), x
        residual = np.append(rows[0], prior_rows @ (x - problem.prior_mean))
        jacobian = np.vstack([rows[1], prior_rows])[:, linear]
        step = np.linalg.lstsq(jacobian, -residual, rcond=1e-10)[0]
        x[linear] += step
        residual = residual + jacobian @ step
        cost = float(residual @ residual)
    return cost, x


def from_poles(model: Model, num: Array, den: Array, delay_s: float) -> dict[str, float]:
    """Return the parameters of a model nearest to a transfer function num/den.

    In a process model without U, complex poles become two equal lags.

    Parameters
    ----------
    model
        The model.
    num, den
        Coefficients, ascending in s.
    delay_s
        Dead time [s].

    Returns
    -------
    dict
        Parameters by name.

    Notes
    -----
    The second and third lag are changed by 0.1 and 0.2 %, since equal lags have equal derivatives.
    """
    if model.kind != "process":
        theta = {"Td": delay_s}
        theta |= {f"b{i}": float(v) for i, v in enumerate(num)}
        theta |= {f"a{i}": float(v) for i, v in enumerate(den)}
        return theta
    poles = np.roots(den[::-1])
    has_zero = len(num) > 1 and num[0]
    theta = {
        "Kp": float(num[0]),
        "Td": delay_s,
        "Tz": float(num[1] / num[0]) if has_zero else 0.0,
    }
    if "Tw" in model.names:
        by_oscillation = poles[np.argsort(-np.abs(poles.imag))]
        pair = by_oscillation[:2]
        w = float(np.sqrt(abs(pair[0] * pair[1])))
        theta["Tw"] = 1 / w
        theta["Zeta"] = float(np.clip(-pair.sum().real / (2 * w), 0.02, 5.0))
        if len(poles) > 2:
            theta["Tp3"] = float(1 / abs(by_oscillation[2]))
        return theta
    taus = sorted((1 / np.abs(poles)).tolist(), reverse=True)
    for i, tau in enumerate(taus):
        theta[f"Tp{i + 1}"] = float(tau) * (1.0 + 1e-3 * i)
    return theta


def single_input_problem(
    problem: IdentificationProblem, theta: Mapping[str, float], k: int
) -> IdentificationProblem:
    """Return the problem of one input, with the response to the others subtracted.

    The response to the other inputs at ``theta`` is subtracted from the output.

    Parameters
    ----------
    problem
        The identification problem of several inputs.
    theta
        Parameters by name.
    k
        Number of the input.

    Returns
    -------
    IdentificationProblem
        The problem.
    """
    model, names, _ = problem.branches[k]
    no_gain = {full: 0.0 for n, full in names.items() if n == "Kp" or n.startswith("b")}
    others = replace(problem, model=replace(problem.model, fixed={**theta, **no_gain}))
    x = solve_linear_parameters(problem, theta)[1]
    outputs = others.outputs(x[problem.n_model :])
    assert outputs is not None
    segments = tuple(
        replace(s.with_input(k), y=s.y - y) for s, (y, _) in zip(problem.segments, outputs)
    )
    model = replace(model, offset=problem.model.offset, delay_max_s=problem.model.delay_max_s)
    return replace(
        problem,
        model=model,
        segments=segments,
        holds=(problem.holds[k],),
        input_sds=(problem.input_sds[k],),
    )


def one_lag_problem(
    problem: IdentificationProblem,
) -> tuple[IdentificationProblem, dict[str, float]]:
    """Return the problem with one lag behind each input, and its best equal lags.

    Parameters
    ----------
    problem
        The identification problem of several inputs.

    Returns
    -------
    problem
        The problem.
    theta
        Its parameters by name.
    """
    m = problem.model
    model = several(["P1"] * len(m.inputs), m.inputs, known=m.known, offset=m.offset)
    one_lag = replace(problem, model=model)
    candidates = []
    for tau in np.geomspace(problem.dt_s, 0.5 * problem.longest_segment_s, N_LAGS):
        theta = dict.fromkeys(model.names, 0.0)
        theta |= {n: float(tau) for n in model.names if n[:2] == "Tp"}
        candidates.append(solve_linear_parameters(one_lag, theta))
    best = min(candidates, key=lambda candidate: candidate[0])
    return one_lag, one_lag.theta(best[1])


def single_input_problems(problem: IdentificationProblem) -> list[IdentificationProblem]:
    """Return the problem of each input, with the one-lag response to the others subtracted."""
    if not problem.model.submodels:
        return [problem]
    one_lag, theta = one_lag_problem(problem)
    return [single_input_problem(one_lag, theta, k) for k in range(len(one_lag.branches))]


def multi_input_starts(problem: IdentificationProblem) -> list[Array]:
    """Return starts for several inputs by two rounds of backfitting.

    Each input gets its best start, with the response to the others subtracted.

    Parameters
    ----------
    problem
        The identification problem of several inputs.

    Returns
    -------
    list of array
        Vectors x (size,), best first.
    """
    current, current_theta = one_lag_problem(problem)
    candidates: list[tuple[float, Array]] = []
    theta: dict[str, float] = {}
    for _ in range(2):
        for k, (model, names, _) in enumerate(problem.branches):
            single = single_input_problem(current, current_theta, k)
            single = replace(single, model=replace(model, offset=problem.model.offset))
            start = single.theta(starts(single)[0])
            theta |= {names[n]: v for n, v in start.items()}
        candidates.append(solve_linear_parameters(problem, theta))
        current = problem
        current_theta = problem.theta(candidates[-1][1])
    return _best_first(candidates)


def starts(problem: IdentificationProblem) -> list[Array]:
    """Return starting values x for any model, best first.

    Parameters
    ----------
    problem
        The identification problem.

    Returns
    -------
    list of array
        Vectors x (size,) of finite cost.

    Notes
    -----
    For a process model one lag's total is shared among its lags. SRIVC is used where the poles of
    a process model may be complex, and for transfer functions: over candidate dead times and
    prefilters from the record's length to its sampling interval.
    """
    if problem.model.submodels:
        return multi_input_starts(problem)
    may_drift = problem.trend or problem.n_waves > 0
    level = remove_run_slopes(problem) if may_drift else problem
    scan = one_lag_starts(level)[:4]
    if problem.model.kind == "process":
        candidates = _process_starts(level, scan)
    else:
        candidates = _transfer_starts(level, scan)
    return _best_first([solve_linear_parameters(problem, theta) for theta in candidates])


def _process_starts(
    problem: IdentificationProblem, scan: list[tuple[float, float]]
) -> list[dict[str, float]]:
    """Return starting parameters of a process model from the one-lag scan.

    Parameters
    ----------
    problem
        The identification problem of one input.
    scan
        (time constant, dead time) [s], best first.

    Returns
    -------
    list of dict
        Parameters by name.
    """
    model = problem.model
    if model.order == 0:
        return [{"Kp": 1.0, "Td": delay} for _, delay in scan[:3]]
    candidates = [
        share_lag(model, tau, delay, pattern)
        for (tau, delay), pattern in product(scan, range(len(LAG_PATTERNS)))
    ]
    may_oscillate = bool({"Tw", "Tz"} & set(model.names))
    if model.order in (2, 3) and may_oscillate and "Tc" not in model.names:
        tau, delay = scan[0]
        n_zeros = int("Tz" in model.names)
        candidates += _srivc_starts(
            problem, n_zeros, [delay, 0.5 * delay], [1.0 / tau, 4.0 / tau], PROCESS_ITERATIONS
        )
    return candidates


def _transfer_starts(
    problem: IdentificationProblem, scan: list[tuple[float, float]]
) -> list[dict[str, float]]:
    """Return starting parameters of a transfer function by SRIVC, from the one-lag scan.

    Parameters
    ----------
    problem
        The identification problem of one input.
    scan
        (time constant, dead time) [s], best first.

    Returns
    -------
    list of dict
        Parameters by name.
    """
    model = problem.model
    n_zeros = sum(n.startswith("b") for n in model.names) - 1
    if model.has_delay:
        delays = sorted({share * delay for _, delay in scan[:2] for share in (0.0, 0.5, 1.0)})
    else:
        delays = [model.fixed.get("Td", 0.0)]
    rates = np.geomspace(6.0 / problem.longest_segment_s, 0.6 / problem.dt_s, 6).tolist()
    return _srivc_starts(problem, n_zeros, delays, rates, TRANSFER_ITERATIONS)


def _srivc_starts(
    problem: IdentificationProblem,
    zeros: int,
    delays: list[float],
    rates: list[float],
    iterations: int,
) -> list[dict[str, float]]:
    """Return starting parameters by SRIVC over dead times and prefilters.

    Parameters
    ----------
    problem
        The identification problem of one input.
    zeros
        Degree of the numerator.
    delays
        Dead times [s].
    rates
        Corners of the first prefilter [1/s].
    iterations
        Iterations of SRIVC.

    Returns
    -------
    list of dict
        Parameters by name.
    """
    model = problem.model
    candidates = []
    for delay, rate in product(delays, rates):
        ratio = srivc(problem, zeros, model.order, delay, rate, iterations)
        if ratio is not None:
            candidates.append(from_poles(model, *ratio, delay))
    return candidates


def _best_first(candidates: list[tuple[float, Array]]) -> list[Array]:
    """Return the x of (cost, x) pairs of finite cost, least cost first."""
    ranked = sorted(candidates, key=lambda candidate: candidate[0])
    return [x for cost, x in ranked if np.isfinite(cost)]
