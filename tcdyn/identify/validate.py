"""Residual tests whose bounds are right: whiteness and residual-input correlation, corrected for what the fit
took.

The residuals of a fit are (I - H) times the noise, H = J (J'J)^-1 J'. Whiteness: the expectation -s^2 tr(H S_k)
that the fit itself puts into the k-th autocovariance is subtracted before Ljung and Box's sum. Input correlation:
the vector of correlations with lagged inputs U has covariance s^2 U'(I - H)U exactly, so the test is an F test in
the directions of U that the fit has not used up already.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc, ndtri

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.spelling import Spelling, as_argument
from tcdyn.estimation import Noise, autocovariance, fit_ar, inverse, orthonormal, sandwich
from tcdyn.identify.iodata import IOData
from tcdyn.identify.problem import Posed
from tcdyn.identify.search import Fit, pose
from tcdyn.identify.segments import Segment

DRIFT = 0.5  # correlation of residuals with time from which a drift is told: a quarter of their variance
DRIVEN = 1e-3  # p of the input's test below which dynamics are missed, and no disturbance is sought
FEEDBACK = 1e-3  # p of the test with inputs still to come, below which no model is recommended
ALARM = 0.01  # p below which the findings speak up; the bounds themselves are at 5 %


@dataclass(frozen=True)
class ResidualTest:
    """Normalised correlations at ``lags_s``, the pointwise 95 % bound of each, and p of the joint test."""

    lags_s: Array
    value: Array
    bound95: Array
    p: float


@dataclass(frozen=True)
class Validation:
    """What the residuals say about a model: a verdict first, then what else was noticed."""

    whiteness: ResidualTest
    input: ResidualTest
    fit_percent: float
    rms: float
    findings: tuple[Finding, ...]

    @property
    def sentence(self) -> str:
        """The findings in words."""
        return self.message()

    def message(self, spelling: Spelling = as_argument) -> str:
        """The findings in words, parameters in the given spelling."""
        return " ".join(f.message(spelling) for f in self.findings)

    @property
    def dynamics_missing(self) -> bool:
        """Whether the residuals still follow the input (1 % level)."""
        return self.input.p < ALARM

    @property
    def troubles(self) -> tuple[str, ...]:
        """Codes of what is wrong with the record; of what only excuses the residuals, where they need an excuse."""
        counted = ["record.off_equilibrium", "record.drift"]
        counted += ["record.coarse"] if self.dynamics_missing else []
        clear = [f.numbers["p"] < FEEDBACK for f in self.findings if f.code == "record.feedback"]
        counted += ["record.feedback"] if self.dynamics_missing or any(clear) else []
        return tuple(f.code for f in self.findings if f.code in counted)


def validate(fit: Fit, lags: int = 20) -> Validation:
    """Test the residuals of ``fit`` (its innovations where it has a noise model) at ``lags`` lags.

    Of a robust loss the scores psi = w r are tested, which at its optimum are free of the slopes themselves (a test by
    them holds its level whatever the spikes).
    """
    problem = fit.problem
    parts = fit.problem.parts
    e = fit.innovation
    j = fit.slopes
    r = fit.residual
    if fit.optimum.weights is not None:
        e = -fit.optimum.weights * fit.optimum.residual
        j = fit.optimum.jacobian
    white = whiteness(e, j, parts, problem.dt_s, lags)
    coloured = white.p < ALARM
    extra = fit_ar(e, parts) if coloured else Noise()
    behind = shifts(problem, fit.identified.longest_lag_s, lags)
    root = fit.root[:, None] if fit.optimum.weights is None else 1.0  # scores are free of it
    u, ahead = (
        extra.whiten(fit.noise.whiten(shifted_inputs(problem, k) * root, parts), parts)
        for k in (behind, -np.arange(lags // 2))
    )
    ew = extra.whiten(e, parts)
    jw = extra.whiten(j, parts)
    cross = input_correlation(
        ew, jw, u, np.tile(problem.dt_s * behind, len(problem.branches)).astype(float)
    )
    rounding = bool(
        np.max(np.abs(r)) <= 0.5 * problem.rounding_step
    )  # which alone could leave these residuals
    if rounding:
        white = replace(white, p=1.0)
        cross = replace(cross, p=1.0)
        coloured = False
    raw = r if fit.noise.white else e
    scale = 1.4826 * float(np.median(np.abs(raw - np.median(raw)))) or 1.0
    spikes = int(np.sum(np.abs(raw) > scale * float(-ndtri(0.005 / len(raw)))))
    percent = fit_percent(problem, r)
    unsettled = off_equilibrium(fit)
    found = [_verdict(fit, white, cross, coloured, rounding, percent)]
    if spikes and cross.p >= ALARM and not rounding and not unsettled:
        found.append(warning("residuals.spikes", count=spikes, robust=fit.loss != "linear"))
    if resumed := sum(s.resumed for s in problem.segments):
        found.append(info("record.gaps", count=resumed))
    found += unsettled
    found += drift(problem, r) if coloured else ()
    if (rms := float(np.sqrt(np.mean(r**2)))) < problem.rounding_step:
        found.append(warning("record.coarse", step=problem.rounding_step, rms=rms))
    found += feedback(
        ew, jw, ahead, np.delete(u, np.arange(len(problem.branches)) * len(behind), axis=1)
    )
    return Validation(
        whiteness=white,
        input=cross,
        fit_percent=percent,
        rms=rms,
        findings=tuple(found),
    )


def confirm(fit: Fit, data: IOData, lags: int = 20) -> Validation:
    """The residual tests of ``fit`` on ``data`` that it has not seen, and whether those ask for other parameters.

    Offsets and initial states are the record's own; the parameters stay. Beside the tests, whose input correlation is
    beyond what errors of the parameters explain, the step d that the new data would take them, of covariance C, is
    held against that of the fit, C_0: d'(C + C_0)^-1 d, chi-squared with as many degrees as there are parameters.
    C is robust where residuals are coloured. Raises InputError for data that cannot be used, or whose sampling is not
    that of a noise model.
    """
    old = fit.problem
    model_noise = fit.noise
    if not model_noise.white and abs(data.dt_s / old.dt_s - 1) > 1e-6:
        raise InputError(
            f"sampled every {data.dt_s:g} s, and the noise model every {old.dt_s:g} s",
            where=data.name or "confirm",
        )
    same = {name: getattr(old, name) for name in ("input_sds", "time_scale_s", "noise_sd", "trend")}
    problem = replace(pose(data, old.model, old.initial), **same)
    k = problem.n_model
    x = np.concatenate([fit.x[: old.n_model], np.zeros(problem.size - old.n_model)])
    core = problem.core(model_noise)
    answer = core.evaluate(x)
    assert answer is not None  # the model is stable, it was fitted
    x[k:] -= np.linalg.lstsq(answer[1][:, k:], answer[0], rcond=None)[0]
    (e, j) = core.evaluate(x) or answer
    raw = problem.evaluate(x)
    assert raw is not None
    seen = replace(fit.optimum, theta=x, residual=e, jacobian=j, weights=None)
    there = replace(
        fit,
        problem=problem,
        optimum=seen,
        residual=-raw[0],
        innovation=-e,
        slopes=j,
        loss="linear",
        weights=None,
    )
    tested = validate(there, lags)
    if k == 0:
        return tested
    unit = inverse(j.T @ j)
    white = tested.whiteness.p >= ALARM
    own = float(e @ e) / (len(e) - problem.size) * unit if white else sandwich(j, e, problem.parts)
    step = (unit @ (j.T @ e))[:k]
    covariance = own[:k, :k] + fit.covariance_x[:k, :k]
    p = float(chdtrc(k, step @ inverse(covariance) @ step))
    moved = (warning("validation.moved", subject=old.model.name, p=p),) if p < ALARM else ()
    return replace(tested, findings=tested.findings + moved)


def _verdict(
    fit: Fit,
    white: ResidualTest,
    cross: ResidualTest,
    coloured: bool,
    rounding: bool,
    percent: float,
) -> Finding:
    """What is wrong with the model, or that the record holds nothing against it."""
    name = fit.problem.model.name
    if rounding:
        return info("residuals.rounding", subject=name)
    if cross.p < ALARM:
        worst = int(np.argmax(np.abs(cross.value) / np.maximum(cross.bound95, 1e-300)))
        inputs = fit.problem.model.inputs
        which = inputs[worst * len(inputs) // len(cross.value)] if inputs else ""
        lag = float(cross.lags_s[worst])
        return warning(
            "residuals.follow_input",
            subject=name,
            fit_percent=percent,
            p_input=cross.p,
            lag_s=lag,
            input=which,
        )
    if coloured:
        return warning(
            "residuals.coloured",
            subject=name,
            noise_model=not fit.noise.white,
            p_white=white.p,
            p_input=cross.p,
        )
    return info("residuals.white", subject=name, p_white=white.p, p_input=cross.p)


def whiteness(
    e: Array, jacobian: Array, parts: list[slice], dt_s: float, lags: int
) -> ResidualTest:
    """Ljung and Box's test on ``e`` (N,), the fit's own contribution to each autocovariance taken out."""
    n = len(e)
    lags = max(1, min(lags, n // 4, max(s.stop - s.start for s in parts) - 1))
    q = orthonormal(jacobian)
    variance = max(float(e @ e), 1e-300) / (n - q.shape[1])
    total, pairs = autocovariance(e, parts, lags)
    taken = np.zeros(lags + 1)
    for s in parts:
        for k in range(1, min(lags, s.stop - s.start - 1) + 1):
            taken[k] += float(np.sum(q[s][k:] * q[s][:-k]))
    z = (total[1:] / variance + taken[1:]) / np.sqrt(np.maximum(pairs[1:], 1.0))
    value = total[1:] / max(total[0], 1e-300)
    bound = 1.96 * np.sqrt(pairs[1:]) / n
    return ResidualTest(
        np.asarray(dt_s * np.arange(1.0, lags + 1)), value, bound, float(chdtrc(lags, np.sum(z**2)))
    )


def shifts(problem: Posed, lag_s: float, lags: int) -> NDArray[np.int_]:
    """Shifts of 0, 1, 2 .. samples, then ever further apart up to three times the model's lag, (lags,)."""
    longest = max(len(s.u) for s in problem.segments)
    lags = max(2, min(lags, longest // 8))
    reach = max(int(min(max(3 * lag_s / problem.dt_s, lags), longest // 3)), lags)
    near = np.arange(lags // 2)
    far = np.geomspace(lags // 2, reach, lags - lags // 2)
    return np.unique(np.round(np.unique(np.concatenate([near, far]))).astype(int))


def shifted_inputs(problem: Posed, behind: NDArray[np.int_]) -> Array:
    """The input so many samples before each measured one, (N, lags), over its level at the start of its segment; a
    negative shift looks ahead, and after its end a segment's input stays. Several inputs stand side by side."""
    most, ahead = max(int(behind.max()), 0), max(-int(behind.min()), 0)

    def shifted(s: Segment) -> Array:
        past = s.history(most + 1)
        level = 0.0 if problem.initial == "zero" and not s.resumed else past[0]
        padded = (
            np.concatenate(
                [past[1:] if s.resumed else np.full(most, level), s.u, np.full(ahead, s.u[-1])]
            )
            - level
        )
        return np.array([padded[most - k : most - k + len(s.u)] for k in behind]).T[s.seen]

    each = [[shifted(s.of(k)) for k in range(len(problem.branches))] for s in problem.segments]
    return np.block(each)


def input_correlation(e: Array, jacobian: Array, u: Array, lags_s: Array) -> ResidualTest:
    """F test of ``e`` against the columns of ``u`` (N, M) beyond what ``jacobian`` explains, and each
    correlation."""
    q = orthonormal(jacobian)
    size = np.linalg.norm(u, axis=0)
    size = np.where(size > 0, size, 1.0)
    left = u / size
    left = left - q @ (q.T @ left)
    left = left - q @ (q.T @ left)
    n = len(e)
    p = q.shape[1]
    total = max(float(e @ e), 1e-300)
    variance = total / (n - p)
    alive = np.linalg.norm(left, axis=0) > 1e-6
    basis = orthonormal(left[:, alive])
    rank = basis.shape[1]
    explained = float(np.sum((basis.T @ e) ** 2))
    left_over = n - p - rank
    tail = 1.0
    if rank and left_over > 0:
        ratio = (explained / rank) / max((total - explained) / left_over, 1e-300)
        tail = float(fdtrc(rank, left_over, ratio))
    value = (left.T @ e) / np.sqrt(total)
    bound = 1.96 * np.linalg.norm(left, axis=0) * np.sqrt(variance / total)
    return ResidualTest(lags_s, value, bound, tail)


def fit_percent(problem: Posed, residual: Array) -> float:
    """100 (1 - |residual| / |y - mean|) per run as in MATLAB's compare, runs pooled."""
    top = float(residual @ residual)
    spread = sum(float(np.sum((s.y[s.seen] - s.y[s.seen].mean()) ** 2)) for s in problem.segments)
    return 100.0 * (1.0 - float(np.sqrt(top / spread))) if spread > 0 else 0.0


def off_equilibrium(fit: Fit) -> tuple[Finding, ...]:
    """Whether a run begins 4 rms or more off the equilibrium that was assumed (median of 3 samples)."""
    problem = fit.problem
    if problem.initial != "equilibrium":
        return ()
    rms = float(np.sqrt(np.mean(fit.residual**2)))
    at = np.cumsum([0, *(s.seen.sum() for s in problem.segments)])
    starts = [
        fit.residual[at[k] :][:3] for k in range(len(problem.segments)) if not problem.loose[k]
    ]
    first = abs(max((float(np.median(r)) for r in starts), key=abs, default=0.0))
    return (
        (warning("record.off_equilibrium", off=first, times_rms=first / rms),)
        if first > 4 * rms
        else ()
    )


def drift(problem: Posed, residual: Array) -> tuple[Finding, ...]:
    """Whether more than a quarter of the residual's variance is a straight line in time."""
    pairs = []
    at = 0
    for s in problem.segments:
        t = np.flatnonzero(s.seen).astype(float)
        r = residual[at : at + len(t)]
        at += len(t)
        pairs.append(np.stack([t - t.mean(), r - r.mean()]))
    t, r = np.hstack(pairs)
    correlation = float(r @ t) / float(np.sqrt(max((r @ r) * (t @ t), 1e-300)))
    return (warning("record.drift", correlation=correlation),) if abs(correlation) > DRIFT else ()


def feedback(e: Array, jacobian: Array, ahead: Array, behind: Array) -> tuple[Finding, ...]:
    """Whether the residuals tell of the input still to come and not of the past one (1 % level)."""
    future, past = (
        input_correlation(e, jacobian, u, np.zeros(u.shape[1])).p for u in (ahead, behind)
    )
    return (warning("record.feedback", p=future),) if past >= ALARM > future else ()


def coloured(found: Fit) -> bool:
    """Whether the residuals are."""
    return found.identified.statistics["p_white"] < ALARM


def clean(found: Fit) -> bool:
    """Whether the residuals are white and do not follow the input."""
    return not coloured(found) and found.identified.statistics["p_input"] >= ALARM


def undriven(found: Fit) -> bool:
    """Whether the residuals do not clearly follow the input: slow disturbances do a little, by chance."""
    return found.identified.statistics["p_input"] >= DRIVEN


def disturbed(found: Fit) -> bool:
    """Whether the residuals are coloured, and not by dynamics that the model misses."""
    return coloured(found) and undriven(found)
