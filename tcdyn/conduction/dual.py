"""Forward differentiation of the modal form: arrays that carry their derivatives in Q directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh_tridiagonal

from tcdyn.conduction.bank import cardinal, cardinal_slope

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Dual:
    """value (S) and its derivatives (Q, S) in Q directions; arithmetic follows the product and quotient rules."""

    value: Array
    slope: Array
    __array_ufunc__ = None  # numpy arrays on the left leave the operation to us

    def _lifted(self, ndim: int) -> Array:
        q, *shape = self.slope.shape
        return np.reshape(self.slope, (q, *(1,) * (ndim - len(shape)), *shape))

    def _combine(self, other: Any, value: Array, mine: Any, theirs: Any) -> Dual:
        n = np.ndim(value)
        slope = self._lifted(n) * mine
        if isinstance(other, Dual):
            slope = slope + other._lifted(n) * theirs
        return Dual(value, np.broadcast_to(slope, (len(slope), *np.shape(value))))

    def __add__(self, other: Any) -> Dual:
        return self._combine(other, self.value + plain(other), 1.0, 1.0)

    def __mul__(self, other: Any) -> Dual:
        return self._combine(other, self.value * plain(other), plain(other), self.value)

    def __truediv__(self, other: Any) -> Dual:
        v = plain(other)
        return self._combine(other, self.value / v, 1 / v, -self.value / v**2)

    def __rtruediv__(self, other: Any) -> Dual:
        v = np.asarray(other / self.value)
        return Dual(v, self._lifted(v.ndim) * (-v / self.value))

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> Dual:
        return self + (-other)

    def __rsub__(self, other: Any) -> Dual:
        return (-self) + other

    __radd__ = __add__
    __rmul__ = __mul__

    def __getitem__(self, key: Any) -> Dual:
        parts = key if isinstance(key, tuple) else (key,)
        return Dual(self.value[key], self.slope[(slice(None), *parts)])

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the value."""
        return np.shape(self.value)


def plain(x: Any) -> Any:
    """The value without its derivatives."""
    return x.value if isinstance(x, Dual) else x


def sqrt(x: Any) -> Any:
    """Elementwise square root."""
    if not isinstance(x, Dual):
        return np.sqrt(x)
    root = np.sqrt(x.value)
    return Dual(root, x.slope / (2 * root))


def einsum(spec: str, *args: Any) -> Any:
    """``np.einsum`` of plain arrays and duals, each argument linear (subscripts a-z without q)."""
    if not any(isinstance(a, Dual) for a in args):
        return np.einsum(spec, *args)
    values = [plain(a) for a in args]
    inputs, output = spec.split("->")
    names = inputs.split(",")
    slope: Any = 0.0
    for k, a in enumerate(args):
        if isinstance(a, Dual):
            tagged = ",".join("q" + n if i == k else n for i, n in enumerate(names))
            slope = slope + np.einsum(f"{tagged}->q{output}", *values[:k], a.slope, *values[k + 1 :])
    return Dual(np.einsum(spec, *values), slope)


def matmul(a: Any, b: Any) -> Any:
    """``a @ b`` for a of any rank and b a matrix or a vector."""
    if not isinstance(a, Dual) and not isinstance(b, Dual):
        return a @ b
    value = plain(a) @ plain(b)
    slope: Any = a.slope @ plain(b) if isinstance(a, Dual) else 0.0
    if isinstance(b, Dual):
        lifted = b.slope.reshape(len(b.slope), *(1,) * (np.ndim(plain(a)) - 2), *b.shape)
        slope = slope + (plain(a) @ lifted if len(b.shape) == 2 else np.einsum("...n,qn->q...", plain(a), b.slope))
    return Dual(value, slope)


def stack(items: list[Any]) -> Any:
    """``np.stack`` along a new first axis."""
    if not any(isinstance(a, Dual) for a in items):
        return np.stack(items)
    q = next(len(a.slope) for a in items if isinstance(a, Dual))
    slopes = [a.slope if isinstance(a, Dual) else np.zeros((q, *np.shape(a))) for a in items]
    return Dual(np.stack([plain(a) for a in items]), np.stack(slopes, axis=1))


def inverse(a: Any) -> Any:
    """Matrix inverse; d(A^-1) = -A^-1 dA A^-1."""
    if not isinstance(a, Dual):
        return np.linalg.inv(a)
    inv = np.asarray(np.linalg.inv(a.value), dtype=np.float64)
    return Dual(inv, -inv @ a.slope @ inv)


def eigen_tridiagonal(diagonal: Any, off: Any) -> tuple[Any, Any]:
    """Eigenvalues (n,) ascending and orthonormal vectors (n, n, columns) of a symmetric tridiagonal matrix.

    d(lambda_m) = v_m' dS v_m and dv_m = sum_l v_l (v_l' dS v_m)/(lambda_m - lambda_l); the eigenvalues of a
    tridiagonal matrix without zero off-diagonals are always distinct.
    """
    lam, v = eigh_tridiagonal(plain(diagonal), plain(off), lapack_driver="stemr")
    if not isinstance(diagonal, Dual) and not isinstance(off, Dual):
        return lam, v
    zero = np.zeros((1, 1))
    d = diagonal.slope if isinstance(diagonal, Dual) else zero
    e = off.slope if isinstance(off, Dual) else zero
    moved = d[:, :, None] * v + 0 * e[:, :1, None]
    moved[:, :-1] += e[:, :, None] * v[1:]
    moved[:, 1:] += e[:, :, None] * v[:-1]
    inner = v.T @ moved
    gap = lam[None, :] - lam[:, None]
    np.fill_diagonal(gap, np.inf)
    return Dual(lam, np.einsum("qmm->qm", inner)), Dual(v, v @ (inner / gap))


def node_weights(rates: Array, lam: Any) -> Any:
    """``cardinal`` of the bank at rates ``lam`` (M,) that may carry derivatives."""
    weights = cardinal(rates, np.log(plain(lam)))
    if not isinstance(lam, Dual):
        return weights
    slope = cardinal_slope(rates, weights)
    return Dual(weights, (lam.slope / lam.value)[:, :, None] * slope)
