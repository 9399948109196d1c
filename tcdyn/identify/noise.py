"""Coloured residuals: AR and ARMA models of the noise, whitening, and covariances that do not believe in white
noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from calibration.arrays import Array
from calibration.noise import rounding_sd
from tcdyn.identify.optimise import least_squares
from tcdyn.identify.problem import Problem


@dataclass(frozen=True)
class Noise:
    """n_t = C(q)/D(q) e_t with D = 1 + d_1 q^-1 + .. (AR) and C = 1 + c_1 q^-1 + .. (MA)."""

    ar: tuple[float, ...] = ()
    ma: tuple[float, ...] = ()

    @property
    def white(self) -> bool:
        """Whether this is no colour at all."""
        return not self.ar and not self.ma

    def whiten(self, table: Array, stretches: Sequence[slice]) -> Array:
        """D/C applied down the rows of ``table`` (N,) or (N, P), afresh in every stretch; the first rows of a
        stretch, for which no past is known, are set to zero."""
        if self.white:
            return table
        out = np.zeros_like(table)
        skip = max(len(self.ar), len(self.ma))
        for s in stretches:
            filtered = lfilter([1.0, *self.ar], [1.0, *self.ma], table[s], axis=0)
            filtered[:skip] = 0.0
            out[s] = filtered
        return out


def stretches(problem: Problem) -> list[slice]:
    """Slices of the residual vector within which samples follow each other without a gap."""
    found, at = [], 0
    for segment in problem.segments:
        index = np.flatnonzero(segment.seen)
        breaks = np.flatnonzero(np.diff(index) > 1) + 1
        for part in np.split(index, breaks):
            found.append(slice(at, at + len(part)))
            at += len(part)
    return found


def autocovariance(e: Array, parts: Sequence[slice], lags: int) -> tuple[Array, Array]:
    """Sums of e_t e_{t-k} over pairs within a stretch, k = 0..lags, and the number of pairs."""
    total, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for s in parts:
        x = e[s]
        for k in range(min(lags, len(x) - 1) + 1):
            total[k] += x[k:] @ x[: len(x) - k]
            pairs[k] += len(x) - k
    return total, pairs


def fit_ar(e: Array, parts: Sequence[slice], max_order: int = 20) -> Noise:
    """The autoregression of ``e`` with the lowest AICc up to ``max_order`` (Yule-Walker)."""
    n = len(e)
    max_order = int(min(max_order, n // 10))
    total, _ = autocovariance(e, parts, max_order)
    r = total / n
    best, choice = n * np.log(max(r[0], 1e-300)), Noise()
    for p in range(1, max_order + 1):
        a = solve_toeplitz(r[:p], r[1 : p + 1])
        variance = r[0] - a @ r[1 : p + 1]
        if variance <= 0:
            break
        score = n * np.log(variance) + 2 * p * n / (n - p - 1)
        if score < best:
            best, choice = score, Noise(ar=tuple((-a).tolist()))
    return choice


def fit_arma(e: Array, parts: Sequence[slice], p: int, q: int) -> Noise:
    """ARMA(p, q) of ``e`` by conditional least squares, started by Hannan and Rissanen's two regressions."""
    if p == 0 and q == 0:
        return Noise()
    long = fit_ar(e, parts)
    innovation = long.whiten(e, parts)
    rows, targets = [], []
    m = max(p, q)
    for s in parts:
        x, w = e[s], innovation[s]
        for t in range(m, len(x)):
            rows.append([*(-x[t - i - 1] for i in range(p)), *(w[t - i - 1] for i in range(q))])
            targets.append(x[t])
    start = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0]

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        d, c = np.concatenate([[1.0], x[:p]]), np.concatenate([[1.0], x[p:]])
        if (p and np.max(np.abs(np.roots(d))) >= 1) or (q and np.max(np.abs(np.roots(c))) >= 1):
            return None
        r, j = np.zeros(len(e)), np.zeros((len(e), p + q))
        for s in parts:
            w = lfilter(d, c, e[s])
            past_e, past_w = lfilter([1.0], c, e[s]), lfilter([1.0], c, w)
            r[s] = w
            for i in range(p):
                j[s, i] = np.concatenate([np.zeros(i + 1), past_e[: -i - 1]])
            for i in range(q):
                j[s, p + i] = -np.concatenate([np.zeros(i + 1), past_w[: -i - 1]])
            j[s.start : s.start + m] = 0.0
            r[s.start : s.start + m] = 0.0
        return r, j

    for shrink in (1.0, 0.7, 0.3, 0.0):
        powers = shrink ** np.concatenate([np.arange(1, p + 1), np.arange(1, q + 1)])
        answer = least_squares(evaluate, start * powers, np.full(p + q, -np.inf), np.full(p + q, np.inf))
        if answer is not None:
            return Noise(tuple(answer.x[:p].tolist()), tuple(answer.x[p:].tolist()))
    return Noise()


def sandwich(jacobian: Array, residual: Array, parts: Sequence[slice]) -> Array:
    """Covariance (P, P) of a least-squares estimate whose residuals are coloured.

    (J'J)^-1 J' V J (J'J)^-1 with V the covariance of the autoregression fitted to the residuals: J'VJ is s^2 times
    the product of J filtered backwards in time by the noise filter.
    """
    n, p = jacobian.shape
    noise = fit_ar(residual, parts)
    innovation = noise.whiten(residual, parts)
    variance = float(innovation @ innovation) / (n - p)
    shaped = np.zeros_like(jacobian)
    for s in parts:
        shaped[s] = lfilter([1.0], [1.0, *noise.ar], jacobian[s][::-1], axis=0)[::-1]
    bread, _ = inverse(jacobian)
    half = shaped @ bread  # squared as a whole: between lags that nearly coincide the product of three loses all digits
    return np.asarray(variance * half.T @ half)


def coarse_step(problem: Problem) -> float:
    """The step in which the output's logger counts, where neighbours are often equal; else zero."""
    y = np.concatenate([s.y[s.seen] for s in problem.segments])
    if rounding_sd(y) == 0:
        return 0.0
    moved = np.abs(np.diff(y))
    return float(moved[moved > 1e-9 * moved.max()].min())


def rounding_covariance(problem: Problem, jacobian: Array, step: float) -> Array:
    """Covariance (P, P) that rounding to ``step`` leaves where no noise shakes it: readings in a row that are equal
    share one error of variance step^2/12.

    ``jacobian`` (N, P) is that of the measured samples.
    """
    y = np.concatenate([s.y[s.seen] for s in problem.segments])
    edges = [part.start for part in stretches(problem)]
    new = np.union1d(edges, np.flatnonzero(np.abs(np.diff(y)) > 0.5 * step) + 1).astype(int)
    half = np.add.reduceat(jacobian, new, axis=0) @ inverse(jacobian)[0]
    return np.asarray(step**2 / 12 * half.T @ half)


def inverse(jacobian: Array) -> tuple[Array, bool]:
    """(J'J)^-1 in a balanced scale, and whether every direction was seen by the data."""
    scale = np.linalg.norm(jacobian, axis=0)
    dead = scale == 0
    scale = np.where(dead, 1.0, scale)
    w, v = np.linalg.eigh((jacobian.T @ jacobian) / np.outer(scale, scale))
    keep = w > 1e-14 * w[-1]
    half = v[:, keep] / np.sqrt(w[keep])
    return np.asarray((half @ half.T) / np.outer(scale, scale)), bool(w[0] > 1e-13 * w[-1] and not dead.any())


def orthonormal(table: Array, tolerance: float = 1e-10) -> Array:
    """Orthonormal basis (N, rank) of the columns of ``table`` (N, P); ``tolerance`` on squared singular values.

    By the eigenvectors of the Gram matrix, twice, which for tall tables is far quicker than a full factorisation.
    """
    if table.shape[1] == 0:
        return table
    scale = np.linalg.norm(table, axis=0)
    q = table[:, scale > 0] / scale[scale > 0]
    for limit in (tolerance, 1e-3):
        if q.shape[1] == 0:
            return q
        w, v = np.linalg.eigh(q.T @ q)
        keep = w > limit * w[-1]
        q = q @ (v[:, keep] / np.sqrt(w[keep]))
    return np.asarray(q)
