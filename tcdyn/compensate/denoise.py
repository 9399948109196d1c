"""Noise removal as the thesis did it (section 4.2), for comparison: segments, curves, smoothing spline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import minimize_scalar

from calibration.errors import InputError
from calibration.result import Result, jsonable
from tcdyn.compensate.separable import CArray, Curve, CurveFit, fit_curve

Array = NDArray[np.float64]
MOST_POINTS, EVALUATIONS = 800, 60  # enough for a dozen parameters; more changes nothing that is seen
WEIGHT_DECADES = (-10.0, 2.0)  # of the spline's roughness, time scaled to -1 .. 1: from every sample to a straight line
METHODS = ("rational", "gaussians", "spline")


def rational(degree: int, over: int) -> Curve:
    """p(x) / (1 + q_1 x + ... + q_over x^over), p of ``degree``; amplitude p_0.., shape q_1.."""

    def basis(x: Array, shape: CArray) -> CArray:
        powers = x[:, None] ** np.arange(1, over + 1)
        bottom = 1.0 + powers @ shape
        return np.asarray(x[:, None] ** np.arange(degree + 1) / bottom[:, None])

    return Curve(basis, f"rational ({degree},{over})")


def gaussians(count: int, decay: bool = False) -> Curve:
    """sum a_i exp(-((x - b_i)/c_i)^2), shape b_1, c_1, b_2, ...; ``decay`` adds a exp(-g x), g first in the shape."""

    def basis(x: Array, shape: CArray) -> CArray:
        columns = [np.exp(-shape[0] * x)] if decay else []
        rest = shape[1:] if decay else shape
        columns += [np.exp(-(((x - rest[2 * k]) / rest[2 * k + 1]) ** 2)) for k in range(count)]
        return np.stack(columns, axis=1)

    return Curve(basis, f"{count} Gaussians" + (" and a decay" if decay else ""))


@dataclass(frozen=True)
class Denoised(Result):
    """A trace without its noise: ``temperature`` (N,) [degC], and per segment the method, its cross-validated rms [K]

    and what every candidate scored there.
    """

    temperature: Array
    methods: tuple[str, ...]
    cv_rms: tuple[float, ...]
    scores: tuple[dict[str, float], ...]

    def summary(self) -> str:
        """One line a segment."""
        return "\n".join(
            f"segment {k}: {m}, cross-validated {s:.3g} K" for k, (m, s) in enumerate(zip(self.methods, self.cv_rms))
        )

    def to_dict(self) -> dict[str, Any]:
        """Method and scores of each segment [K]; the samples are in ``temperature``."""
        parts = zip(self.methods, self.cv_rms, self.scores)
        return {"segments": jsonable([{"method": m, "cv_rms_K": s, "scores_K": all_} for m, s, all_ in parts])}


def remove_noise(
    time_s: ArrayLike,
    y: ArrayLike,
    events_s: Sequence[float] = (),
    methods: Sequence[str] = METHODS,
    folds: int = 5,
) -> Denoised:
    """Fit each stretch between events with the curve that predicts best what it has not seen.

    Candidates: a rational function (5,5), three Gaussians, a smoothing spline whose weight is chosen on the same
    blocks; choice by cross-validation over ``folds`` interleaved blocks. The lag of the thermocouple stays in: this
    removes noise only.

    Args:
        time_s, y: (N,) [s], [degC], NaN where missing.
        events_s: times at which the trace is split [s].
        methods: names among "rational", "gaussians", "spline".
        folds: number of parts, each left out once.
    """
    t, data = np.asarray(time_s, dtype=float), np.asarray(y, dtype=float)
    unknown = set(methods) - set(METHODS)
    if unknown:
        raise InputError(f"remove_noise: no method {sorted(unknown)}", expected=f"any of {METHODS}")
    cuts = [-np.inf, *sorted(e for e in events_s if t[0] < e < t[-1]), np.inf]
    out = np.empty_like(data)
    names, best, scores = [], [], []
    for low, high in pairwise(cuts):
        part = np.flatnonzero((t >= low) & (t < high))
        good = part[np.isfinite(data[part])]
        if len(good) < 40:
            raise InputError(
                f"remove_noise: only {len(good)} good samples between {max(low, t[0]):g} and {min(high, t[-1]):g} s",
                expected="at least 40",
                remedy="merge the events",
            )
        weight = _spline_weight(t[good], data[good], folds) if "spline" in methods else 0.0
        score = {m: _cross_validated(m, t[good], data[good], folds, weight) for m in methods}
        name = min(score, key=lambda m: score[m])
        out[part] = _fit(name, t[good], data[good], t[part], weight)
        names.append(name)
        best.append(score[name])
        scores.append(score)
    return Denoised(out, tuple(names), tuple(best), tuple(scores))


def _spline_weight(t: Array, y: Array, folds: int) -> float:
    """Weight of the spline's roughness (time scaled to -1 .. 1) that predicts the blocks left out best."""

    def score(decades: float) -> float:
        return _cross_validated("spline", t, y, folds, 10.0**decades)

    found = minimize_scalar(score, bounds=WEIGHT_DECADES, method="bounded", options={"xatol": 0.2, "maxiter": 20})
    return float(10.0**found.x)


def _cross_validated(method: str, t: Array, y: Array, folds: int, weight: float) -> float:
    """Root mean square error [K] on blocks left out in turn; blocks of about a hundredth of the segment."""
    block = max(len(t) // (20 * folds), 1)
    fold = (np.arange(len(t)) // block) % folds
    squares = 0.0
    for k in range(folds):
        out = fold == k
        with np.errstate(all="ignore"):
            squares += float(np.sum((y[out] - _fit(method, t[~out], y[~out], t[out], weight)) ** 2))
    rms = float(np.sqrt(squares / len(t)))
    return rms if np.isfinite(rms) else np.inf


def _fit(method: str, t: Array, y: Array, at: Array, weight: float) -> Array:
    """The method fitted to (t, y), at other times; time is centred and scaled first.

    ``weight``: of the spline's roughness against the sum of squares over all samples, not over their means.
    """
    middle, half = 0.5 * (t[0] + t[-1]), 0.5 * (t[-1] - t[0])
    x, to = np.asarray((t - middle) / half), np.asarray((at - middle) / half)
    if method == "spline":
        few = _thinned(x, y, 4000)
        return np.asarray(make_smoothing_spline(*few, lam=weight * len(few[0]) / len(x))(to))
    few = _thinned(x, y)
    fit = fit_rational if method == "rational" else fit_gaussians
    return fit(*few)(to)


def _thinned(x: Array, y: Array, most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Means of neighbours when there are more points than a curve of a dozen parameters can use."""
    step = len(x) // most + 1
    if step == 1:
        return x, y
    n = len(x) // step * step
    return x[:n].reshape(-1, step).mean(axis=1), y[:n].reshape(-1, step).mean(axis=1)


def fit_rational(x: ArrayLike, y: ArrayLike, degree: int = 5, over: int = 5) -> CurveFit:
    """Rational fit without a start: Sanathanan-Koerner iterations, then least squares; poles kept out of the data.

    Lower degrees of the denominator are tried too, since a superfluous pole wanders into the record.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    fits = []
    for q in sorted({0, over // 2, over}):
        curve = rational(degree, q)
        fit = fit_curve(curve, x, y, _sanathanan_koerner(x, y, degree, q), EVALUATIONS)
        bottom = 1.0 + x[:, None] ** np.arange(1, q + 1) @ fit.shape
        if np.isfinite(fit.rss) and np.min(bottom) > 1e-3 * np.max(bottom):
            fits.append(fit)
    return min(fits, key=lambda f: len(x) * np.log(f.rss + 1e-300) + np.log(len(x)) * len(f.sd))


def _sanathanan_koerner(x: Array, y: Array, degree: int, over: int, rounds: int = 12) -> Array:
    top, powers = x[:, None] ** np.arange(degree + 1), x[:, None] ** np.arange(1, over + 1)
    q: Array = np.zeros(over)
    weight: Array = np.ones(len(x))
    for _ in range(rounds if over else 0):
        matrix = np.column_stack([top, -y[:, None] * powers]) * weight[:, None]
        q = np.asarray(np.linalg.lstsq(matrix, y * weight, rcond=1e-10)[0][degree + 1 :], dtype=np.float64)
        weight = np.asarray(1.0 / np.maximum(np.abs(1.0 + powers @ q), 1e-2), dtype=np.float64)
    return q


def fit_gaussians(x: ArrayLike, y: ArrayLike, count: int = 3) -> CurveFit:
    """Sum of Gaussians without a start: the best of a few spreads of centres and widths over the record."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    low, span = float(x.min()), float(np.ptp(x))
    fits = []
    for reach, width in ((0.0, 0.4), (0.3, 0.6), (0.6, 1.0)):
        centres = low + span * np.linspace(-reach, 1 + reach, count)
        start = np.column_stack([centres, np.full(count, width * span)]).ravel()
        fits.append(fit_curve(gaussians(count), x, y, start, EVALUATIONS))
    return min(fits, key=lambda f: f.rss if np.isfinite(f.rss) else np.inf)
