"""Residual tests whose bounds are right: whiteness and residual-input correlation, corrected for what the fit
took.

The residuals of a fit are (I - H) times the noise, H = J (J'J)^-1 J'. Whiteness: the expectation -s^2 tr(H S_k)
that the fit itself puts into the k-th autocovariance is subtracted before Ljung and Box's sum. Input correlation:
the vector of correlations with lagged inputs U has covariance s^2 U'(I - H)U exactly, so the test is an F test in
the directions of U that the fit has not used up already.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from calibration.arrays import Array
from tcdyn.identify.noise import Noise, autocovariance, coarse_step, fit_ar, orthonormal, stretches
from tcdyn.identify.problem import Problem

if TYPE_CHECKING:
    from tcdyn.identify.fit import Fit

DRIFT = 0.5  # correlation of residuals with time from which a drift is told: a quarter of their variance
ALARM = 0.01  # p below which the sentence speaks up; the bounds themselves are at 5 %


@dataclass(frozen=True)
class Correlation:
    """Normalised correlations at ``lags_s``, the pointwise 95 % bound of each, and the joint test."""

    lags_s: Array
    value: Array
    bound95: Array
    statistic: float
    degrees: int
    p: float


@dataclass(frozen=True)
class Validation:
    """What the residuals say about a model; ``troubles`` of the record are put as what to do about them."""

    whiteness: Correlation
    input: Correlation
    fit_percent: float
    rms: float
    spikes: int
    largest_spike: float
    coloured: bool
    sentence: str
    troubles: tuple[str, ...] = ()

    @property
    def dynamics_missing(self) -> bool:
        """Whether the residuals still follow the input (1 % level)."""
        return self.input.p < ALARM


def validate(fit: Fit, lags: int = 20) -> Validation:
    """Test the residuals of ``fit`` (its innovations where it has a noise model) at ``lags`` lags."""
    problem, parts = fit.problem, stretches(fit.problem)
    e, j = fit.innovation, fit.weighted_jacobian
    white = whiteness(e, j, parts, problem.dt_s, lags)
    coloured = white.p < ALARM
    extra = fit_ar(e, parts) if coloured else Noise()
    u, taus = lagged_inputs(problem, fit.identified.lag_s.value if not problem.model.integrators else 0.0, lags)
    u = extra.whiten(fit.noise.whiten(u, parts), parts)
    ew, jw = extra.whiten(e, parts), extra.whiten(j, parts)
    cross = input_correlation(ew, jw, u, taus)
    ahead = extra.whiten(fit.noise.whiten(coming_inputs(problem, lags // 2), parts), parts)
    if explained_by_rounding(fit):
        white, cross, coloured = replace(white, p=1.0), replace(cross, p=1.0), False
    r = fit.residual
    raw = r if fit.noise.white else e
    scale = 1.4826 * float(np.median(np.abs(raw - np.median(raw)))) or 1.0
    limit = float(stats.norm.isf(0.005 / len(raw)))
    standard = np.abs(raw) / scale
    spikes, largest = int(np.sum(standard > limit)), float(standard.max())
    percent = fit_percent(problem, r)
    unsettled = start_advice(fit)
    troubles = {
        "let the runs start off equilibrium (--initial estimated)": unsettled,
        "take the drift out of the output": drift_advice(problem, r) if coloured else "",
    }
    doubts = {
        "log the output in finer steps": rounding_advice(fit),
        "see whether the input answers the output (a closed loop)": feedback_advice(ew, jw, ahead, u[:, 1:]),
    }
    told = troubles | doubts
    counted = told if cross.p < ALARM else troubles
    said = sentence(fit, white, cross, coloured, 0 if unsettled else spikes, percent)
    return Validation(
        whiteness=white,
        input=cross,
        fit_percent=percent,
        rms=float(np.sqrt(np.mean(r**2))),
        spikes=spikes,
        largest_spike=largest,
        coloured=coloured,
        sentence=said + "".join(told.values()),
        troubles=tuple(what for what, why in counted.items() if why),
    )


def whiteness(e: Array, jacobian: Array, parts: list[slice], dt_s: float, lags: int) -> Correlation:
    """Ljung and Box's test on ``e`` (N,), the fit's own contribution to each autocovariance taken out."""
    n = len(e)
    lags = max(1, min(lags, n // 4, max(s.stop - s.start for s in parts) - 1))
    q = orthonormal(jacobian)
    variance = float(e @ e) / (n - q.shape[1])
    total, pairs = autocovariance(e, parts, lags)
    taken = np.zeros(lags + 1)
    for s in parts:
        for k in range(1, min(lags, s.stop - s.start - 1) + 1):
            taken[k] += float(np.sum(q[s][k:] * q[s][:-k]))
    z = (total[1:] / variance + taken[1:]) / np.sqrt(np.maximum(pairs[1:], 1.0))
    value = total[1:] / total[0]
    statistic = float(np.sum(z**2))
    return Correlation(
        lags_s=np.asarray(dt_s * np.arange(1, lags + 1)),
        value=value,
        bound95=1.96 * np.sqrt(pairs[1:]) / n,
        statistic=statistic,
        degrees=lags,
        p=float(stats.chi2.sf(statistic, lags)),
    )


def lagged_inputs(problem: Problem, lag_s: float, lags: int) -> tuple[Array, Array]:
    """Input delayed by 0, 1, 2 .. samples, then ever further apart up to three times the model's lag, (N,
    lags)."""
    shortest = max(len(s.u) for s in problem.segments)
    lags = max(2, min(lags, shortest // 8))
    reach = int(min(max(3 * lag_s / problem.dt_s, lags), shortest // 3))
    shifts = np.unique(
        np.concatenate([np.arange(lags // 2), np.geomspace(lags // 2, max(reach, lags), lags - lags // 2)])
    )
    shifts = np.unique(np.round(shifts).astype(int))
    tables = []
    for s in problem.segments:
        past = s.history(int(shifts[-1]))
        before = 0.0 if problem.initial == "zero" and not s.resumed else past[0]
        padded = np.concatenate([past if s.resumed else np.full(shifts[-1], before), s.u]) - before
        n = len(s.u)
        tables.append(np.array([padded[shifts[-1] - k : shifts[-1] - k + n] for k in shifts]).T[s.seen])
    return np.vstack(tables), problem.dt_s * shifts


def coming_inputs(problem: Problem, count: int) -> Array:
    """Input of the present sample and of the next ones, (N, count); after the end of a segment it stays."""
    tables = []
    for s in problem.segments:
        padded = np.concatenate([s.u, np.full(count, s.u[-1])]) - s.u[0]
        tables.append(np.array([padded[k : k + len(s.u)] for k in range(count)]).T[s.seen])
    return np.vstack(tables)


def input_correlation(e: Array, jacobian: Array, u: Array, lags_s: Array) -> Correlation:
    """F test of ``e`` against the columns of ``u`` (N, M) beyond what ``jacobian`` explains, and each
    correlation."""
    q = orthonormal(jacobian)
    size = np.linalg.norm(u, axis=0)
    size = np.where(size > 0, size, 1.0)
    left = u / size
    left = left - q @ (q.T @ left)
    left = left - q @ (q.T @ left)
    n, p = len(e), q.shape[1]
    total = float(e @ e)
    variance = total / (n - p)
    alive = np.linalg.norm(left, axis=0) > 1e-6
    basis = orthonormal(left[:, alive])
    rank = basis.shape[1]
    explained = float(np.sum((basis.T @ e) ** 2))
    statistic, tail = 0.0, 1.0
    if rank and n - p - rank > 0:
        statistic = (explained / rank) / max((total - explained) / (n - p - rank), 1e-300)
        tail = float(stats.f.sf(statistic, rank, n - p - rank))
    value = (left.T @ e) / np.sqrt(total)
    bound = 1.96 * np.linalg.norm(left, axis=0) * np.sqrt(variance / total)
    return Correlation(lags_s=lags_s, value=value, bound95=bound, statistic=statistic, degrees=rank, p=tail)


def fit_percent(problem: Problem, residual: Array) -> float:
    """100 (1 - |residual| / |y - mean|) per run as in MATLAB's compare, runs pooled."""
    top = float(residual @ residual)
    spread = sum(float(np.sum((s.y[s.seen] - s.y[s.seen].mean()) ** 2)) for s in problem.segments)
    return 100.0 * (1.0 - float(np.sqrt(top / spread))) if spread > 0 else 0.0


def p_text(p: float) -> str:
    """A p value as people read it."""
    return f"p = {p:.2f}" if p >= 0.01 else f"p = {p:.0e}" if p > 1e-99 else "p < 1e-99"


def colour_advice(fit: Fit) -> str:
    """What to do about coloured residuals, given what was done already."""
    if not fit.noise.white:
        return "Try a noise model of higher order, or one lag more."
    return "Intervals are the robust ones; try one lag more, and if the colour stays, noise=(2, 1) from Python."


def sentence(fit: Fit, white: Correlation, cross: Correlation, coloured: bool, spikes: int, percent: float) -> str:
    """One or two sentences: what is wrong with the model, or that the record holds nothing against it."""
    name = fit.problem.model.name
    if explained_by_rounding(fit):
        said = f"{name} repeats every reading to within half a step of the output's rounding: no test can say more."
    elif cross.p < ALARM:
        worst = float(cross.lags_s[int(np.argmax(np.abs(cross.value) / np.maximum(cross.bound95, 1e-300)))])
        said = (
            f"{name} misses dynamics although it fits {percent:.1f} %: its residuals still follow the input "
            f"({p_text(cross.p)}, most at a lag of {worst:.3g} s); try another lag, a zero or a dead time."
        )
    elif coloured:
        said = (
            f"Residuals of {name} are coloured (Ljung-Box {p_text(white.p)}), by disturbances or by dynamics; whatever "
            f"of the input lies beneath that colour, the test cannot see ({p_text(cross.p)}). {colour_advice(fit)}"
        )
    else:
        said = (
            f"Residuals of {name} are white (Ljung-Box {p_text(white.p)}) and unrelated to the input "
            f"({p_text(cross.p)}): this record holds nothing against the model."
        )
    if spikes and cross.p >= ALARM and not explained_by_rounding(fit):
        advice = "; fit with --robust (loss='huber')" if fit.loss == "linear" else ", held down by the robust loss"
        said += f" {spikes} sample{'s stand' if spikes > 1 else ' stands'} out as spikes{advice}."
    resumed = sum(s.resumed for s in fit.problem.segments)
    if resumed:
        said += f" After {resumed} gap{'s' if resumed > 1 else ''} of the input the state was estimated anew."
    return said


def explained_by_rounding(fit: Fit) -> bool:
    """Whether the output's rounding alone could leave these residuals."""
    return bool(np.max(np.abs(fit.residual)) <= 0.5 * coarse_step(fit.problem))


def rounding_advice(fit: Fit) -> str:
    """A sentence when the residuals are smaller than the steps in which the output is rounded, else ""."""
    step, rms = coarse_step(fit.problem), float(np.sqrt(np.mean(fit.residual**2)))
    if rms >= step:
        return ""
    return (
        f" The output moves in steps of {step:.3g}, the residuals' rms is {rms:.2g}: the intervals include the "
        "rounding, which the tests cannot tell from dynamics."
    )


def start_advice(fit: Fit) -> str:
    """A sentence when a run begins 4 rms or more off the assumed equilibrium (median of 3 samples), else ""."""
    problem = fit.problem
    if problem.initial != "equilibrium":
        return ""
    rms = float(np.sqrt(np.mean(fit.residual**2)))
    at = np.cumsum([0, *(s.seen.sum() for s in problem.segments)])
    starts = [fit.residual[at[k] :][:3] for k in range(len(problem.segments)) if k not in problem.loose]
    first = max((float(np.median(r)) for r in starts), key=abs, default=0.0)
    if abs(first) <= 4 * rms:
        return ""
    return (
        f" A run starts {abs(first):.3g} off the equilibrium that was assumed, {abs(first) / rms:.0f} times the "
        "rms: fit with --initial estimated (initial='estimated')."
    )


def drift_advice(problem: Problem, residual: Array) -> str:
    """A sentence when more than a quarter of the residual's variance is a straight line in time, else ""."""
    rt = rr = tt = 0.0
    at = 0
    for s in problem.segments:
        t = np.flatnonzero(s.seen).astype(float)
        r = residual[at : at + len(t)]
        at += len(t)
        t, r = t - t.mean(), r - r.mean()
        rt, rr, tt = rt + float(r @ t), rr + float(r @ r), tt + float(t @ t)
    correlation = rt / np.sqrt(max(rr * tt, 1e-300))
    if abs(correlation) <= DRIFT:
        return ""
    return f" The residuals drift (correlation with time {correlation:.2f}): take the trend out of the output first."


def feedback_advice(e: Array, jacobian: Array, ahead: Array, behind: Array) -> str:
    """A sentence when the residuals tell of the input still to come and not of the past one (1 % level), else ""."""
    future, past = (input_correlation(e, jacobian, u, np.zeros(u.shape[1])).p for u in (ahead, behind))
    if past < ALARM or future >= ALARM:
        return ""
    return (
        f" They tell of the input still to come ({p_text(future)}) and not of the past one: the input answers the "
        "output (feedback, a closed loop, which biases the fit), or the two are not sampled at the same instants."
    )
