"""Noise models for correlated residuals: AR and ARMA models, whitening, covariance of estimates.

``tcdyn.identification`` and ``tcdyn.sensors`` whiten residuals with them;
``autocorrelation_factor`` is also used by ``immersion.plunge_data``. Guarded by
``tests/estimation/test_noise_models.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import signal
from scipy.linalg import schur, solve_toeplitz

from tcdyn.core import Array
from tcdyn.estimation.levenberg_marquardt import minimise
from tcdyn.estimation.problem import Problem, Status, inverse

# factors on the roots of a start that cannot be used, tried in this order; chosen by judgement
ROOT_FACTORS = (1.0, 0.7, 0.3, 0.0)
# Samples over which the variance of stationary noise is summed, as a power of two. Its memory is
# longer than any record, and a root that is nearer to one is rounded to it.
DOUBLINGS = 30
# Variance over that of the innovation at which the sum ends: the noise before a segment is then
# unknown, and more would only overflow in its square.
MAX_PRESAMPLE_VARIANCE = 1e100


@dataclass(frozen=True)
class NoiseModel:
    """ARMA noise model n_t = C(q)/D(q) e_t, with white e.

    Parameters
    ----------
    ar
        Coefficients d of D = 1 + d_1 q^-1 + .. (autoregressive).
    ma
        Coefficients c of C = 1 + c_1 q^-1 + .. (moving average).
    starts_at_rest
        The noise starts at zero with the record, as a random walk (D(1) = 0) does whose first level
        is the offset; otherwise it is stationary, as it is after a gap.
    n_fitted
        Number of coefficients that were estimated from the residuals (all where None).
    averaged
        The model is the most likely one of those over which an estimate was averaged.
    """

    ar: tuple[float, ...] = ()
    ma: tuple[float, ...] = ()
    starts_at_rest: bool = False
    n_fitted: int | None = None
    averaged: bool = False

    @property
    def n_parameters(self) -> int:
        """Number of coefficients that were estimated from the residuals."""
        return len(self.ar) + len(self.ma) if self.n_fitted is None else self.n_fitted

    @property
    def white(self) -> bool:
        """Whether the noise is white."""
        return not self.ar and not self.ma

    @property
    def order(self) -> tuple[int, int]:
        """Numbers of fitted AR and MA coefficients, without that of a random walk.

        Returns
        -------
        (p, q); (0, 0) where nothing was fitted.
        """
        return (len(self.ar) - self.is_random_walk, len(self.ma)) if self.n_parameters else (0, 0)

    @property
    def is_random_walk(self) -> bool:
        """Whether it is a random walk, without a level to return to: D(1) = 0."""
        return abs(1.0 + sum(self.ar)) < 1e-9

    @property
    def time_constant(self) -> float:
        """Time constant of its slowest component [samples]; infinite for a random walk."""
        slowest = max(np.abs(np.roots([1.0, *self.ar])), default=0.0)
        if slowest == 0:
            return 0.0
        if slowest >= 1 - 1e-9:
            return float("inf")
        return float(-1 / np.log(slowest))

    def effective_samples(self, n: int) -> float:
        """Effective number of independent samples among ``n``; at least 2.

        The variance of the samples over the variance of their mean.
        """
        if self.white:
            return float(n)
        pulse = signal.lfilter([1.0, *self.ma], [1.0, *self.ar], np.eye(1, n)[0])
        inverse_gain = (1 + sum(self.ar)) / (1 + sum(self.ma))
        return max(n * float(pulse @ pulse) * inverse_gain**2, 2.0)

    def whiten(self, table: Array, segments: Sequence[slice]) -> Array:
        """Whiten: apply D/C down the rows of ``table``, which makes innovations of residuals.

        Parameters
        ----------
        table
            Rows by time, (N,) or (N, P).
        segments
            Segments without gaps; each is filtered separately.

        Returns
        -------
        Whitened table, in the shape of ``table``; zero outside the segments.

        Notes
        -----
        The noise before a segment has the uncertainty of stationary noise (exact likelihood), but
        not before the first segment of noise that starts at rest. After a gap a random walk has an
        unknown level, whose whitened form, the response of D/C, is projected out of the rows.
        ``log_determinant`` has the matching normalisation; change both together.
        """
        if self.white:
            return table
        out = np.zeros_like(table)
        for k, s in enumerate(segments):
            filtered = signal.lfilter([1.0, *self.ar], [1.0, *self.ma], table[s], axis=0)
            if self.is_random_walk and k:
                level = signal.lfilter([1.0, *self.ar], [1.0, *self.ma], np.ones(len(filtered)))
                shape = level[:, None] / (np.linalg.norm(level) or 1.0)
                factor = np.ones(1)
            else:
                shape, spread = self._presample(len(filtered), is_first=k == 0)
                factor = 1 - 1 / np.sqrt(1 + spread)
            out[s] = filtered - (shape * factor) @ (shape.T @ filtered)
        return out

    def log_determinant(self, segments: Sequence[slice]) -> float:
        """Log determinant of the noise covariance, relative to that of the innovations.

        ``whiten`` leaves it out; a likelihood needs it.

        Parameters
        ----------
        segments
            Segments without gaps.
        """
        return float(
            sum(
                np.sum(np.log1p(self._presample(s.stop - s.start, is_first=k == 0)[1]))
                for k, s in enumerate(segments)
            )
        )

    def _presample(self, n: int, is_first: bool) -> tuple[Array, Array]:
        """Effect of the state before a segment of ``n`` samples.

        Parameters
        ----------
        n
            Samples of the segment.
        is_first
            Whether it is the first of the record.

        Returns
        -------
        shapes, variances
            As ``presample_effect`` returns them; (n, 0) and (0,) at rest, and for a random walk.
        """
        if self.white or self.is_random_walk or (self.starts_at_rest and is_first):
            return np.zeros((n, 0)), np.zeros(0)
        return presample_effect(self.ar, self.ma, n)


@lru_cache(maxsize=4)
def presample_effect(ar: tuple[float, ...], ma: tuple[float, ...], n: int) -> tuple[Array, Array]:
    """Effect of the unknown state before n samples of ARMA noise on their innovations; cached.

    Parameters
    ----------
    ar, ma
        Coefficients of the noise model.
    n
        Number of samples.

    Returns
    -------
    basis
        Orthonormal shapes, (n, F).
    variances
        Their variances over that of the innovation, (F,).

    Notes
    -----
    The state z of the filter C/D, z' = A z + B e, has the covariance P = A P A' + B B', summed by
    doubling for 10^9 samples (that of a random walk would never converge). A is in the Schur form,
    whose powers keep the roots: the powers of A itself grow without limit from rounding where two
    roots are near to one, as in noise of long memory. The state of D/C is its negative.
    """
    m = max(len(ar), len(ma))
    d = np.zeros(m)
    c = np.zeros(m)
    d[: len(ar)] = ar
    c[: len(ma)] = ma
    a = np.eye(m, k=1)
    a[:, 0] = -d
    power, basis = schur(a, output="complex")
    roots = np.diag(power)
    longest = 1 - 0.5**DOUBLINGS
    np.fill_diagonal(power, roots * np.minimum(1.0, longest / np.maximum(np.abs(roots), longest)))
    first = basis.conj().T @ (c - d)
    total = np.outer(first, first.conj())
    for _ in range(DOUBLINGS):
        longer = total + power @ total @ power.conj().T
        if not np.max(np.abs(longer)) < MAX_PRESAMPLE_VARIANCE:
            break
        total = longer
        power = power @ power
    p = np.real(basis @ total @ basis.conj().T)
    shape = signal.lfilter([1.0, *d], [1.0, *c], np.zeros((n, m)), axis=0, zi=np.eye(m))[0]
    eigenvalues, eigenvectors = np.linalg.eigh(p)
    scaled = shape @ (eigenvectors * np.sqrt(np.maximum(eigenvalues, 0.0)))
    basis, singular_values, _ = np.linalg.svd(scaled, full_matrices=False)
    return basis, singular_values**2


def autocovariance(e: Array, segments: Sequence[slice], lags: int) -> tuple[Array, Array]:
    """Sums of e_t e_{t-k} over pairs within a segment, and the number of pairs.

    Parameters
    ----------
    e
        Residuals, (N,).
    segments
        Segments without gaps.
    lags
        Largest lag k.

    Returns
    -------
    total, pairs
        Sums and numbers of pairs, (lags + 1,) each, for k = 0..lags.

    Examples
    --------
    >>> sums, pairs = autocovariance(np.array([1.0, -1.0, 1.0, -1.0]), [slice(0, 4)], lags=1)
    >>> sums.tolist(), pairs.tolist()
    ([4.0, -3.0], [4.0, 3.0])
    """
    total = np.zeros(lags + 1)
    pairs = np.zeros(lags + 1)
    for s in segments:
        x = e[s]
        for k in range(min(lags, len(x) - 1) + 1):
            total[k] += x[k:] @ x[: len(x) - k]
            pairs[k] += len(x) - k
    return total, pairs


def fit_ar(e: Array, segments: Sequence[slice], max_order: int = 20) -> NoiseModel:
    """The autoregressive model of ``e`` with the lowest AICc (Yule-Walker).

    Parameters
    ----------
    e
        Residuals, (N,).
    segments
        Segments without gaps.
    max_order
        Largest order; at most a tenth of N is tried.

    Notes
    -----
    AICc = n ln(variance) + 2 p n/(n - p - 1). Another criterion may be used.
    ``sandwich_covariance`` relies on an order that is high enough; a criterion that prefers smaller
    models may make its uncertainties too small.

    Examples
    --------
    >>> e = signal.lfilter([1.0], [1.0, -0.8], np.random.default_rng(0).standard_normal(2000))
    >>> fit_ar(e, [slice(0, 2000)], max_order=1).ar[0].__round__(1)
    -0.8
    """
    n = len(e)
    max_order = int(min(max_order, n // 10))
    r = autocovariance(e, segments, max_order)[0] / n
    best = n * np.log(max(r[0], 1e-300))
    choice = NoiseModel()
    for p in range(1, max_order + 1):
        try:
            a = solve_toeplitz(r[:p], r[1 : p + 1])
        except np.linalg.LinAlgError:  # the samples follow from fewer before them exactly
            break
        variance = r[0] - a @ r[1 : p + 1]
        if variance <= 0:
            break
        score = n * np.log(variance) + 2 * p * n / (n - p - 1)
        if score < best:
            best = score
            choice = NoiseModel(ar=tuple((-a).tolist()))
    return choice


def fit_arma(e: Array, segments: Sequence[slice], p: int, q: int) -> NoiseModel:
    """The ARMA(p, q) model of ``e`` by conditional least squares.

    Parameters
    ----------
    e
        Residuals, (N,).
    segments
        Segments without gaps.
    p, q
        Numbers of AR and MA coefficients.

    Notes
    -----
    The search starts at the regressions of Hannan and Rissanen. Where that model is unstable or not
    invertible, its roots are drawn towards zero by ``ROOT_FACTORS``. The first max(p, q) samples of
    each segment have no residual.

    Examples
    --------
    >>> e = signal.lfilter([1.0, 0.5], [1.0, -0.8], np.random.default_rng(0).standard_normal(4000))
    >>> noise = fit_arma(e, [slice(0, 4000)], 1, 1)
    >>> round(noise.ar[0], 1), round(noise.ma[0], 1)
    (-0.8, 0.5)
    """
    if p == 0 and q == 0:
        return NoiseModel()
    innovation = fit_ar(e, segments).whiten(e, segments)
    m = max(p, q)
    x = np.concatenate([e[s][m:] for s in segments])
    columns = [np.concatenate([-e[s][m - i : -i] for s in segments]) for i in range(1, p + 1)]
    columns += [
        np.concatenate([innovation[s][m - i : -i] for s in segments]) for i in range(1, q + 1)
    ]
    start = np.linalg.lstsq(np.column_stack(columns), x, rcond=None)[0]

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        """Innovations (N,) and their Jacobian (N, p + q) at x = (ar, ma).

        None for a model that is unstable or not invertible.
        """
        d = np.concatenate([[1.0], x[:p]])
        c = np.concatenate([[1.0], x[p:]])
        unstable = p and np.max(np.abs(np.roots(d))) >= 1
        not_invertible = q and np.max(np.abs(np.roots(c))) >= 1
        if unstable or not_invertible:
            return None
        r = np.zeros(len(e))
        j = np.zeros((len(e), p + q))
        for s in segments:
            w = signal.lfilter(d, c, e[s])
            past_e = signal.lfilter([1.0], c, e[s])
            past_w = signal.lfilter([1.0], c, w)
            r[s] = w
            for i in range(p):
                j[s.start + i + 1 : s.stop, i] = past_e[: -i - 1]
            for i in range(q):
                j[s.start + i + 1 : s.stop, p + i] = -past_w[: -i - 1]
            j[s.start : s.start + m] = 0.0
            r[s.start : s.start + m] = 0.0
        return r, j

    names = [*(f"d_{i + 1}" for i in range(p)), *(f"c_{i + 1}" for i in range(q))]
    problem = Problem(tuple(names), evaluate)
    for factor in ROOT_FACTORS:
        powers = factor ** np.concatenate([np.arange(1, p + 1), np.arange(1, q + 1)])
        fit = minimise(problem, start * powers, tolerance=0.0)
        if fit.status is not Status.NOWHERE:
            return NoiseModel(tuple(fit.theta[:p].tolist()), tuple(fit.theta[p:].tolist()))
    return NoiseModel()


def coefficients_from_partial(partial: Array) -> Array:
    """Polynomial coefficients from partial correlations: Levinson's recursion.

    Parameters
    ----------
    partial
        Partial correlations, (p,).

    Returns
    -------
    Coefficients d of 1 + d_1 q^-1 + .., (p,). The polynomial is stable if all partial correlations
    lie between -1 and 1.
    """
    d = np.zeros(0)
    for k in partial:
        d = np.append(d - k * d[::-1], -k)
    return d


def partial_correlations(d: Array) -> Array:
    """Partial correlations of a polynomial: Levinson's recursion backwards.

    Parameters
    ----------
    d
        Coefficients of 1 + d_1 q^-1 + .., (p,).

    Returns
    -------
    Partial correlations, (p,). The inverse of ``coefficients_from_partial``.
    """
    values = []
    while len(d):
        k = -d[-1]
        values.append(k)
        if len(d) == 1:
            break
        d = (d[:-1] + k * d[-2::-1]) / max(1 - k**2, 1e-9)
    return np.array(values[::-1])


def equation_error(
    colour: Callable[[Array], Array],
    x: Array,
    colour_index: Sequence[int],
    segments: Sequence[slice],
    r: Array,
    j: Array,
    free: Sequence[bool] = (),
) -> tuple[Array, Array]:
    """The equation error A(q) r of residuals, and its Jacobian.

    Parameters
    ----------
    colour
        Gives the coefficients of A after the first at ``x``, so that the noise carries information
        on the poles, as in an ARX regression.
    x
        Parameters (P,).
    colour_index
        Indices of the parameters that A depends on.
    segments
        Segments without gaps. The equation error is zero where a segment lacks the samples before.
    r, j
        Residuals (N,) and their Jacobian (N, P).
    free
        Whether the initial state of each segment is free. Then the first samples are the residuals,
        which determine that state.

    Returns
    -------
    error, table
        Equation error (N,) and its Jacobian (N, P).

    Notes
    -----
    The slopes of the coefficients are forward differences with a step of 1e-6 of the parameter.
    Guarded by ``tests/identify/test_identify_equation.py``.
    """
    coefs = colour(x)
    step = 1e-6 * np.maximum(np.abs(x), 1e-9)
    slopes = [(colour(x + step * (np.arange(len(x)) == i)) - coefs) / step[i] for i in colour_index]
    error = np.zeros_like(r)
    table = np.zeros_like(j)
    p = len(coefs)
    for k, s in enumerate(segments):
        if k < len(free) and free[k]:
            first = slice(s.start, min(s.start + p, s.stop))
            error[first] = r[first]
            table[first] = j[first]
        lagged = np.array(
            [r[s.start + p - k : s.stop - k] for k in range(1, p + 1) if s.stop - s.start > p]
        )
        if len(lagged):
            error[s.start + p : s.stop] = r[s.start + p : s.stop] + coefs @ lagged
            table[s.start + p : s.stop] = signal.lfilter([1.0, *coefs], [1.0], j[s], axis=0)[p:]
            table[s.start + p : s.stop, colour_index] += (np.array(slopes) @ lagged).T
    return error, table


def sandwich_covariance(
    jacobian: Array, residual: Array, segments: Sequence[slice], precision: Array | None = None
) -> Array:
    """Covariance (P, P) of a least-squares estimate with correlated residuals (sandwich estimator).

    Parameters
    ----------
    jacobian, residual
        Jacobian (N, P) and residuals (N,).
    segments
        Segments without gaps.
    precision
        Precision (P,) of normal priors, in units of the variance of the residuals; it is added to
        J'J, and times that variance to J'VJ.

    Returns
    -------
    Covariance, (P, P).

    Notes
    -----
    (J'J)^-1 J' V J (J'J)^-1 with V the covariance of the autoregressive model fitted to the
    residuals. J'VJ is s^2 times the product of J filtered backwards in time by the noise filter.

    The order of the noise model is that of ``fit_ar``. ``tests/estimation/test_noise_models.py``
    checks that white residuals give the plain covariance.

    Examples
    --------
    >>> e = signal.lfilter([1.0], [1.0, -0.8], np.random.default_rng(0).standard_normal(2000))
    >>> covariance_of_mean = sandwich_covariance(np.ones((2000, 1)), e, [slice(0, 2000)])
    >>> u = float(covariance_of_mean[0, 0]) ** 0.5
    >>> round(u / (np.std(e) / 2000**0.5))  # in units of that for white noise
    3
    """
    n, p = jacobian.shape
    noise = fit_ar(residual, segments)
    innovation = noise.whiten(residual, segments)
    variance = float(innovation @ innovation) / (n - p)
    filtered = np.zeros_like(jacobian)
    for s in segments:
        filtered[s] = signal.lfilter([1.0], [1.0, *noise.ar], jacobian[s][::-1], axis=0)[::-1]
    prior_precision = np.zeros(p) if precision is None else precision
    bread = inverse(jacobian.T @ jacobian + np.diag(prior_precision))
    root = filtered @ bread  # formed before squaring: a product of three matrices loses all digits
    residual_var = float(residual @ residual) / (n - p)
    return np.asarray(variance * root.T @ root + residual_var * (bread * prior_precision) @ bread)


def autocorrelation_factor(z: Array, longest: int = 40) -> float:
    """Variance factor of correlated residuals: 1 + 2 sum of their autocorrelations.

    Parameters
    ----------
    z
        Residuals, (N,).
    longest
        Largest lag of the sum; at most a quarter of N.

    Returns
    -------
    float
        Factor by which the variance of a mean of ``z`` exceeds that of as many independent samples;
        1 for white noise.

    Notes
    -----
    The sum ends at the first autocorrelation below 2/sqrt(N), which is not significant (95 %).
    Autocorrelations that are negative from the start give 1, so an uncertainty is never made
    smaller. Fewer than 8 samples give 1.

    Examples
    --------
    >>> autocorrelation_factor(np.random.default_rng(0).standard_normal(1000)).__round__(1)
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
