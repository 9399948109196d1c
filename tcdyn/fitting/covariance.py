"""Covariances from badly scaled information matrices and Jacobians."""

from __future__ import annotations

import numpy as np

from calibration.arrays import Array

CUT = 1e-14  # of the largest eigenvalue, in a scale of unit diagonal: below it a direction was not seen


def inverse(information: Array) -> Array:
    """Inverse (P, P) of a positive semidefinite matrix of very unequal scales; unseen directions are left out.

    In the scale that makes the diagonal one, by eigenvalues, those below 1e-14 of the largest cut off.

    >>> inverse(np.diag([1e-20, 4.0])).diagonal()
    array([1.0e+20, 2.5e-01])
    """
    return _inverse(information)[0]


def determined(information: Array) -> bool:
    """Whether every direction of parameter space was seen.

    >>> determined(np.array([[1.0, 1.0], [1.0, 1.0]]))
    False
    """
    return _inverse(information)[1]


def _inverse(information: Array) -> tuple[Array, bool]:
    size = np.sqrt(np.diag(information))
    seen = size > 0
    scale = np.where(seen, size, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    keep = values > CUT * values[-1]
    half = vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None]
    return np.asarray(half @ half.T), bool(values[0] > 10 * CUT * values[-1] and seen.all())


def from_rows(rows: Array) -> tuple[Array, float]:
    """(rows' rows)^-1 by the triangular factor of ``rows`` (N, P), so that the condition number is never squared.

    Also gives the least part of a column, of its length, that the others leave: near zero where two columns are one,
    and then the covariance means nothing.
    """
    size = np.linalg.norm(rows, axis=0)
    scale = np.where(size > 0, size, 1.0)
    factor = np.linalg.qr(rows / scale, mode="r")
    left = float(np.abs(np.diag(factor)).min())
    if left == 0:
        return np.full((rows.shape[1], rows.shape[1]), np.inf), 0.0
    half = np.linalg.solve(factor, np.eye(len(factor))) / scale[:, None]
    return np.asarray(half @ half.T), left


def orthonormal(table: Array, tolerance: float = 1e-10) -> Array:
    """Orthonormal basis (N, rank) of the columns of ``table`` (N, P); ``tolerance`` on squared singular values.

    By the eigenvectors of the Gram matrix, twice, which for tall tables is far quicker than a full factorisation.
    """
    scale = np.linalg.norm(table, axis=0)
    q = table[:, scale > 0] / scale[scale > 0]
    for limit in (tolerance, 1e-3):
        if q.shape[1] == 0:
            return q
        w, v = np.linalg.eigh(q.T @ q)
        keep = w > limit * w[-1]
        q = q @ (v[:, keep] / np.sqrt(w[keep]))
    return np.asarray(q)
