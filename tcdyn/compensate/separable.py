"""Curves that are linear in some of their parameters, fitted by variable projection to the last digit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from calibration.errors import InputError

Array = NDArray[np.float64]
CArray = NDArray[np.complex128]
STEP = 1e-30  # of the complex-step derivative: no cancellation, so as small as one likes


@dataclass(frozen=True)
class Curve:
    """f(x) = basis(x, shape) @ amplitude; ``basis`` takes x (N,) and shape (S,), real or complex, and gives (N, A)."""

    basis: Callable[[Array, CArray], CArray]
    name: str


@dataclass(frozen=True)
class CurveFit:
    """A fitted curve: parameters, residual sum of squares, their standard deviations (amplitude first)."""

    curve: Curve
    shape: Array
    amplitude: Array
    rss: float
    sd: Array
    samples: int

    def __call__(self, x: ArrayLike) -> Array:
        """The curve at ``x`` (N,)."""
        return np.asarray(
            (self.curve.basis(np.asarray(x, dtype=float), self.shape.astype(np.complex128)) @ self.amplitude).real
        )


def fit_curve(curve: Curve, x: ArrayLike, y: ArrayLike, start: ArrayLike, max_evaluations: int = 2000) -> CurveFit:
    """Least squares for ``y`` (N,) at ``x`` (N,) from the shape ``start`` (S,); amplitudes need no start.

    The amplitudes are eliminated (Golub & Pereyra 1973, with Kaufman's Jacobian), the shape found by
    Levenberg-Marquardt, then all parameters are polished together by Gauss-Newton.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    shape = np.asarray(start, dtype=float)
    if len(x) != len(y) or len(x) <= len(shape):
        raise InputError(f"{curve.name}: {len(x)} points for {len(shape)} shape parameters", expected="more points")
    if len(shape):
        scale = np.where(shape == 0, 1.0, np.abs(shape))
        found = least_squares(
            lambda p: _projected(curve, x, y, p * scale)[0],
            shape / scale,
            jac=lambda p: _projected(curve, x, y, p * scale)[1] * scale,
            method="lm",
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=max_evaluations,
        )
        shape = found.x * scale
    amplitude = _amplitude(curve.basis(x, shape.astype(np.complex128)).real, y)
    return _polished(curve, x, y, shape, amplitude)


def _amplitude(basis: Array, y: Array) -> Array:
    norms = np.linalg.norm(basis, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    return np.asarray(np.linalg.lstsq(basis / norms, y, rcond=None)[0] / norms)


def _slopes(curve: Curve, x: Array, shape: Array, amplitude: Array) -> Array:
    """d f / d shape (N, S), by complex steps."""
    columns = []
    for k in range(len(shape)):
        moved = shape.astype(complex)
        h = STEP * max(abs(shape[k]), 1e-3)
        moved[k] += 1j * h
        columns.append((curve.basis(x, moved) @ amplitude).imag / h)
    return np.stack(columns, axis=1) if columns else np.zeros((len(x), 0))


def _projected(curve: Curve, x: Array, y: Array, shape: Array) -> tuple[Array, Array]:
    """Residual with the best amplitudes (N,), and its Jacobian (N, S) after Kaufman; both large where undefined."""
    with np.errstate(all="ignore"):
        basis = curve.basis(x, shape.astype(np.complex128)).real
        if not np.all(np.isfinite(basis)):
            return np.full(len(y), 1e6 * (np.ptp(y) + 1.0)), np.zeros((len(y), len(shape)))
        amplitude = _amplitude(basis, y)
        slopes = _slopes(curve, x, shape, amplitude)
    norms = np.linalg.norm(basis, axis=0)
    q, _ = np.linalg.qr(basis / np.where(norms > 0, norms, 1.0))
    slopes = np.nan_to_num(slopes)
    return basis @ amplitude - y, slopes - q @ (q.T @ slopes)


def _polished(curve: Curve, x: Array, y: Array, shape: Array, amplitude: Array) -> CurveFit:
    """Gauss-Newton on all parameters together, as long as it gains, with the covariance of the result."""
    count = len(amplitude)
    theta = np.concatenate([amplitude, shape])
    best, r = np.inf, y
    jacobian = np.zeros((len(x), len(theta)))
    for _ in range(30):
        basis = curve.basis(x, theta[count:].astype(np.complex128)).real
        r = y - basis @ theta[:count]
        rss = float(r @ r)
        jacobian = np.column_stack([basis, _slopes(curve, x, theta[count:], theta[:count])])
        norms = np.linalg.norm(jacobian, axis=0)
        norms = np.where(norms > 0, norms, 1.0)
        move = np.linalg.lstsq(jacobian / norms, r, rcond=None)[0] / norms
        if not rss < best * (1 + 1e-12) or np.all(np.abs(move) <= 1e-14 * np.abs(theta)):
            break
        best = min(best, rss)
        theta = theta + move
    basis = curve.basis(x, theta[count:].astype(np.complex128)).real
    rss = float(np.sum((y - basis @ theta[:count]) ** 2))
    scaled = jacobian / norms
    cov = np.linalg.pinv(scaled.T @ scaled, rcond=1e-15) / np.outer(norms, norms)
    sd = np.sqrt(np.maximum(np.diag(cov), 0.0) * rss / max(len(x) - len(theta), 1))
    return CurveFit(curve, theta[count:], theta[:count], rss, sd, len(x))
