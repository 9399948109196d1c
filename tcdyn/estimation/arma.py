"""Coloured residuals: AR and ARMA models, whitening, and covariances that do not believe in white noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import signal
from scipy.linalg import solve_toeplitz

from tcdyn.core import Array
from tcdyn.estimation.levenberg_marquardt import minimise
from tcdyn.estimation.problem import Problem, Status, inverse


@dataclass(frozen=True)
class Noise:
    """n_t = C(q)/D(q) e_t with D = 1 + d_1 q^-1 + .. (AR) and C = 1 + c_1 q^-1 + .. (MA).

    ``rest``: it begins from nothing with the record, as a random walk (D(1) = 0) does whose first level is the offset;
    else it has gone on for ever. ``fitted`` of its coefficients were found from the residuals (all where None).
    ``averaged``: these are the likeliest of those over which an estimate was averaged.
    """

    ar: tuple[float, ...] = ()
    ma: tuple[float, ...] = ()
    rest: bool = False
    fitted: int | None = None
    averaged: bool = False

    @property
    def parameters(self) -> int:
        """How many of its coefficients were found from the residuals."""
        return len(self.ar) + len(self.ma) if self.fitted is None else self.fitted

    @property
    def white(self) -> bool:
        """Whether this is no colour at all."""
        return not self.ar and not self.ma

    @property
    def order(self) -> tuple[int, int]:
        """How many of its AR coefficients, a random walk's own left out, and of its MA coefficients were fitted."""
        return (len(self.ar) - self.walks, len(self.ma)) if self.parameters else (0, 0)

    @property
    def walks(self) -> bool:
        """Whether it has no level to come back to."""
        return abs(1.0 + sum(self.ar)) < 1e-9

    @property
    def memory(self) -> float:
        """Time constant of its slowest part [samples]; infinite for a random walk."""
        slowest = max(np.abs(np.roots([1.0, *self.ar])), default=0.0)
        return (
            0.0
            if slowest == 0
            else float("inf")
            if slowest >= 1 - 1e-9
            else float(-1 / np.log(slowest))
        )

    def independent(self, n: int) -> float:
        """How many of ``n`` samples are independent: their variance over that of n times their mean; 2 at least."""
        if self.white:
            return float(n)
        pulse = signal.lfilter([1.0, *self.ma], [1.0, *self.ar], np.eye(1, n)[0])
        return max(n * float(pulse @ pulse) * ((1 + sum(self.ar)) / (1 + sum(self.ma))) ** 2, 2.0)

    def whiten(self, table: Array, parts: Sequence[slice]) -> Array:
        """D/C applied down the rows of ``table`` (N,) or (N, P), afresh in every part (a stretch without a gap).

        What the noise was before a part is as uncertain as noise that has gone on for ever makes it (exact likelihood).
        Not where it begins from rest; after a gap it has a level that nobody knows, whose whitened form, C's own
        response, is taken out of the rows.
        """
        if self.white:
            return table
        out = np.zeros_like(table)
        for k, s in enumerate(parts):
            filtered = signal.lfilter([1.0, *self.ar], [1.0, *self.ma], table[s], axis=0)
            if self.rest and k:
                level = signal.lfilter([1.0, *self.ar], [1.0, *self.ma], np.ones(len(filtered)))
                shape = level[:, None] / (np.linalg.norm(level) or 1.0)
                shrink = np.ones(1)
            else:
                shape, spread = self._begun(len(filtered))
                shrink = 1 - 1 / np.sqrt(1 + spread)
            out[s] = filtered - (shape * shrink) @ (shape.T @ filtered)
        return out

    def log_spread(self, parts: Sequence[slice]) -> float:
        """ln of the determinant of the noise's covariance over that of its innovations: what ``whiten`` leaves out."""
        return float(sum(np.sum(np.log1p(self._begun(s.stop - s.start)[1])) for s in parts))

    def _begun(self, n: int) -> tuple[Array, Array]:
        """What the state before a part of n samples does to their innovations (:func:`begun`); nothing from rest."""
        return (
            (np.zeros((n, 0)), np.zeros(0))
            if self.rest or self.white
            else begun(self.ar, self.ma, n)
        )


@lru_cache(maxsize=4)
def begun(ar: tuple[float, ...], ma: tuple[float, ...], n: int) -> tuple[Array, Array]:
    """What the unknown state before n samples of an ARMA noise does to their innovations: its shapes (n, F),
    orthonormal, and their variances (F,) over that of the innovation.

    The state z of the filter C/D, z' = A z + B e, has the covariance P = A P A' + B B', summed by doubling for 10^9
    samples (a random walk's would never end); that of D/C is its negative.
    """
    m = max(len(ar), len(ma))
    d = np.zeros(m)
    c = np.zeros(m)
    d[: len(ar)] = ar
    c[: len(ma)] = ma
    a = np.eye(m, k=1)
    a[:, 0] = -d
    p = np.outer(c - d, c - d)
    for _ in range(30):
        p = p + a @ p @ a.T
        a = a @ a
    shape = signal.lfilter([1.0, *d], [1.0, *c], np.zeros((n, m)), axis=0, zi=np.eye(m))[0]
    value, vector = np.linalg.eigh(p)
    left, size, _ = np.linalg.svd(
        shape @ (vector * np.sqrt(np.maximum(value, 0.0))), full_matrices=False
    )
    return left, size**2


def autocovariance(e: Array, parts: Sequence[slice], lags: int) -> tuple[Array, Array]:
    """Sums of e_t e_{t-k} over pairs within a part, k = 0..lags, and the number of pairs.

    >>> sums, pairs = autocovariance(np.array([1.0, -1.0, 1.0, -1.0]), [slice(0, 4)], lags=1)
    >>> sums.tolist(), pairs.tolist()
    ([4.0, -3.0], [4.0, 3.0])
    """
    total = np.zeros(lags + 1)
    pairs = np.zeros(lags + 1)
    for s in parts:
        x = e[s]
        for k in range(min(lags, len(x) - 1) + 1):
            total[k] += x[k:] @ x[: len(x) - k]
            pairs[k] += len(x) - k
    return total, pairs


def fit_ar(e: Array, parts: Sequence[slice], max_order: int = 20) -> Noise:
    """The autoregression of ``e`` with the lowest AICc up to ``max_order`` (Yule-Walker).

    >>> e = signal.lfilter([1.0], [1.0, -0.8], np.random.default_rng(0).standard_normal(2000))
    >>> fit_ar(e, [slice(0, 2000)], max_order=1).ar[0].__round__(1)
    -0.8
    """
    n = len(e)
    max_order = int(min(max_order, n // 10))
    r = autocovariance(e, parts, max_order)[0] / n
    best = n * np.log(max(r[0], 1e-300))
    choice = Noise()
    for p in range(1, max_order + 1):
        a = solve_toeplitz(r[:p], r[1 : p + 1])
        variance = r[0] - a @ r[1 : p + 1]
        if variance <= 0:
            break
        score = n * np.log(variance) + 2 * p * n / (n - p - 1)
        if score < best:
            best = score
            choice = Noise(ar=tuple((-a).tolist()))
    return choice


def fit_arma(e: Array, parts: Sequence[slice], p: int, q: int) -> Noise:
    """ARMA(p, q) of ``e`` by conditional least squares, started by Hannan and Rissanen's two regressions.

    >>> e = signal.lfilter([1.0, 0.5], [1.0, -0.8], np.random.default_rng(0).standard_normal(4000))
    >>> found = fit_arma(e, [slice(0, 4000)], 1, 1)
    >>> round(found.ar[0], 1), round(found.ma[0], 1)
    (-0.8, 0.5)
    """
    if p == 0 and q == 0:
        return Noise()
    innovation = fit_ar(e, parts).whiten(e, parts)
    rows = []
    targets = []
    m = max(p, q)
    for s in parts:
        x, w = e[s], innovation[s]
        for t in range(m, len(x)):
            rows.append([*(-x[t - i - 1] for i in range(p)), *(w[t - i - 1] for i in range(q))])
            targets.append(x[t])
    start = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0]

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        d = np.concatenate([[1.0], x[:p]])
        c = np.concatenate([[1.0], x[p:]])
        if (p and np.max(np.abs(np.roots(d))) >= 1) or (q and np.max(np.abs(np.roots(c))) >= 1):
            return None
        r = np.zeros(len(e))
        j = np.zeros((len(e), p + q))
        for s in parts:
            w = signal.lfilter(d, c, e[s])
            past_e = signal.lfilter([1.0], c, e[s])
            past_w = signal.lfilter([1.0], c, w)
            r[s] = w
            for i in range(p):
                j[s, i] = np.concatenate([np.zeros(i + 1), past_e[: -i - 1]])
            for i in range(q):
                j[s, p + i] = -np.concatenate([np.zeros(i + 1), past_w[: -i - 1]])
            j[s.start : s.start + m] = 0.0
            r[s.start : s.start + m] = 0.0
        return r, j

    problem = Problem(
        (*(f"d_{i + 1}" for i in range(p)), *(f"c_{i + 1}" for i in range(q))), evaluate
    )
    for shrink in (1.0, 0.7, 0.3, 0.0):
        powers = shrink ** np.concatenate([np.arange(1, p + 1), np.arange(1, q + 1)])
        found = minimise(problem, start * powers, tolerance=0.0)
        if found.status is not Status.NOWHERE:
            return Noise(tuple(found.theta[:p].tolist()), tuple(found.theta[p:].tolist()))
    return Noise()


def coefficients(partial: Array) -> Array:
    """Of the polynomial 1 + d_1 q^-1 + .. whose partial correlations are ``partial``: Levinson's recursion."""
    d = np.zeros(0)
    for k in partial:
        d = np.append(d - k * d[::-1], -k)
    return d


def partials(d: Array) -> Array:
    """Partial correlations of 1 + d_1 q^-1 + .., the recursion backwards."""
    found = []
    while len(d):
        k = -d[-1]
        found.append(k)
        d = (d[:-1] + k * d[-2::-1]) / max(1 - k**2, 1e-9) if len(d) > 1 else d[:0]
    return np.array(found[::-1])


def equation_error(
    colour: Callable[[Array], Array],
    x: Array,
    moved: Sequence[int],
    parts: Sequence[slice],
    r: Array,
    j: Array,
    free: Sequence[bool] = (),
) -> tuple[Array, Array]:
    """The equation error A(q) r of residuals ``r`` (N,), and its Jacobian from theirs, ``j``.

    ``colour`` gives the coefficients of A behind its first at ``x``, of which ``moved`` are the places that A depends
    on, so that the noise tells of the poles as in an ARX regression. Nought where a part (a stretch without a gap)
    lacks the samples before; where its initial state is ``free`` the residuals themselves, which determine that state.
    """
    own = colour(x)
    step = 1e-6 * np.maximum(np.abs(x), 1e-9)
    slopes = [(colour(x + step * (np.arange(len(x)) == i)) - own) / step[i] for i in moved]
    w = np.zeros_like(r)
    table = np.zeros_like(j)
    p = len(own)
    for k, s in enumerate(parts):
        if k < len(free) and free[k]:
            first = slice(s.start, min(s.start + p, s.stop))
            w[first], table[first] = r[first], j[first]
        late = np.array(
            [r[s.start + p - k : s.stop - k] for k in range(1, p + 1) if s.stop - s.start > p]
        )
        if len(late):
            w[s.start + p : s.stop] = r[s.start + p : s.stop] + own @ late
            table[s.start + p : s.stop] = signal.lfilter([1.0, *own], [1.0], j[s], axis=0)[p:]
            table[s.start + p : s.stop, moved] += (np.array(slopes) @ late).T
    return w, table


def sandwich(
    jacobian: Array, residual: Array, parts: Sequence[slice], precision: Array | None = None
) -> Array:
    """Covariance (P, P) of a least-squares estimate whose residuals are coloured.

    (J'J)^-1 J' V J (J'J)^-1 with V the covariance of the autoregression fitted to the residuals: J'VJ is s^2 times
    the product of J filtered backwards in time by the noise filter. ``precision`` (P,) of normal priors, in units of
    the residuals' variance, is added to J'J, and times that variance to J'VJ.

    >>> e = signal.lfilter([1.0], [1.0, -0.8], np.random.default_rng(0).standard_normal(2000))
    >>> u = float(sandwich(np.ones((2000, 1)), e, [slice(0, 2000)])[0, 0]) ** 0.5  # of the mean of coloured noise
    >>> round(u / (np.std(e) / 2000**0.5))  # times as large as if it were white
    3
    """
    n, p = jacobian.shape
    noise = fit_ar(residual, parts)
    innovation = noise.whiten(residual, parts)
    variance = float(innovation @ innovation) / (n - p)
    shaped = np.zeros_like(jacobian)
    for s in parts:
        shaped[s] = signal.lfilter([1.0], [1.0, *noise.ar], jacobian[s][::-1], axis=0)[::-1]
    known = np.zeros(p) if precision is None else precision
    bread = inverse(jacobian.T @ jacobian + np.diag(known))
    half = shaped @ bread  # squared as a whole: a product of three loses all digits
    spread = float(residual @ residual) / (n - p)
    return np.asarray(variance * half.T @ half + spread * (bread * known) @ bread)


def correlation_length(z: Array, longest: int = 40) -> float:
    """1 + 2 sum of the autocorrelations of ``z`` (N,) up to the first that is not significant; 1 for white noise.

    The factor by which the variance of a mean of ``z`` exceeds that of as many independent samples.

    >>> correlation_length(np.random.default_rng(0).standard_normal(1000)).__round__(1)
    1.0
    """
    z = z - np.mean(z)
    n = len(z)
    power = float(z @ z)
    if power == 0 or n < 8:
        return 1.0
    total = 1.0
    for k in range(1, min(longest, n // 4)):
        rho = float(z[k:] @ z[:-k]) / power
        if rho < 2 / np.sqrt(n):
            break
        total += 2 * rho
    return total
