"""Losses that spikes do not sway: weights, and the covariance that goes with them."""

from __future__ import annotations

import numpy as np

from calibration.arrays import Array
from tcdyn.fitting.covariance import inverse

TUNING = {"huber": 1.345, "bisquare": 4.685}  # 95 % efficiency for normal noise


def weights_of(residual: Array, loss: str) -> Array:
    """psi(r)/r (N,) of "huber" or "bisquare", with the scale from the median absolute deviation."""
    z = _standardised(residual, loss)
    if loss == "huber":
        return np.asarray(np.minimum(1.0, 1.0 / np.maximum(z, 1e-300)))
    return np.asarray(np.where(z < 1, (1 - z**2) ** 2, 0.0))


def robust_covariance(residual: Array, jacobian: Array, loss: str) -> Array:
    """Huber's covariance of an M-estimate: [sum psi^2/(n - p)] / mean(psi')^2 (J'J)^-1 (Huber 1981, eq. 7.6.5)."""
    n, p = jacobian.shape
    z = _standardised(residual, loss)
    psi = weights_of(residual, loss) * residual
    inside = z < 1
    slope = inside if loss == "huber" else np.where(inside, (1 - z**2) * (1 - 5 * z**2), 0.0)
    variance = float(psi @ psi) / (n - p) / float(np.mean(slope)) ** 2
    return np.asarray(variance * inverse(jacobian.T @ jacobian))


def _standardised(residual: Array, loss: str) -> Array:
    """|r| in units of the tuning constant times the scale from the median absolute deviation."""
    scale = 1.4826 * float(np.median(np.abs(residual - np.median(residual)))) + 1e-300
    return np.asarray(np.abs(residual) / (TUNING[loss] * scale))
