"""Rational transfer functions with dead time, realised so that every parameter's sensitivity is exact.

A model is written ``G(s) = exp(-Td s) N(s) / (s^k prod_i f_i(s))`` with ``f_i(0) = 1``. One pass of first-order
filters, all poles in a row, gives the output; a short side branch per factor gives ``s^j/f_i`` of the output,
which is minus its derivative with respect to the j-th coefficient of ``f_i``. Nothing is ever expanded into a
high-order polynomial, so equal, close and far-apart poles are all handled at full precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Factor:
    """One denominator factor f(s) = 1 + a_1 s + .. + a_d s^d; ``coefs`` ascending, ``poles`` its roots [1/s]."""

    coefs: Array
    poles: Complex
    free: bool = True

    @classmethod
    def lag(cls, tau_s: float, free: bool = True) -> Factor:
        """1 + tau s."""
        return cls(np.array([1.0, tau_s]), np.array([-1.0 / tau_s + 0j]), free)

    @classmethod
    def polynomial(cls, coefs: Array, free: bool = True) -> Factor:
        """1 + a_1 s + .. from ascending ``coefs`` with ``coefs[0] == 1``."""
        return cls(coefs, np.asarray(np.roots(coefs[::-1]), dtype=complex), free)


@dataclass(frozen=True)
class Rational:
    """exp(-delay s) N(s) / (s^integrators prod f_i(s)); ``num`` ascending in s."""

    num: Array
    factors: tuple[Factor, ...]
    delay_s: float = 0.0
    integrators: int = 0

    @property
    def stable(self) -> bool:
        """Whether every factor's poles lie in the open left half plane."""
        return all(bool(np.all(f.poles.real < 0)) for f in self.factors)

    def frequency_response(self, frequency_Hz: Array) -> Complex:
        """G(2 pi i f), dead time exact."""
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        value = np.polynomial.polynomial.polyval(s, self.num) * np.exp(-self.delay_s * s)
        for f in self.factors:
            value = value / np.polynomial.polynomial.polyval(s, f.coefs)
        return np.asarray(value / s**self.integrators)

    def frequency_sensitivity(self, frequency_Hz: Array, num_count: int | None = None) -> Complex:
        """dG/dcoef, shape (rows, F), in the row order of ``Realisation``: numerator, free factors, dead time."""
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        value = self.frequency_response(frequency_Hz)
        unit = Rational(np.array([1.0]), self.factors, self.delay_s, self.integrators).frequency_response(frequency_Hz)
        rows = [s**i * unit for i in range(len(self.num) if num_count is None else num_count)]
        for f in self.factors:
            if f.free:
                inverse = value / np.polynomial.polynomial.polyval(s, f.coefs)
                rows += [-(s**j) * inverse for j in range(1, len(f.coefs))]
        return np.asarray([*rows, -s * value])


@dataclass(frozen=True)
class Realisation:
    """State space whose outputs are y and its sensitivities.

    dx/dt = A x + B u with A lower triangular (poles on its diagonal); row r of the outputs is
    ``C[r] x + D[r] u + E[r] du/dt``. Row 0 is y; then dy/dnum_i; dy/da_j of the free factors; dy/ddelay last.
    """

    A: NDArray
    B: NDArray
    C: NDArray
    D: NDArray
    E: NDArray
    integrators: int


def newton(poly: NDArray, poles: NDArray) -> tuple[NDArray, NDArray]:
    """Coefficients of poly/prod(phi_i) on the cascade 1, 1/phi_1, 1/(phi_1 phi_2), ..

    phi_i = 1 - s/p_i, or s for a pole at zero. ``poly`` (R, q+1) ascending, one row a polynomial. Returns the
    state coefficients (R, m) and the polynomial part (R, 2): what multiplies u and du/dt.
    """
    rows, m = poly.shape[0], len(poles)
    c = np.zeros((rows, m), dtype=np.result_type(poly, poles))
    rest = np.asarray(poly, dtype=c.dtype)
    for k in range(m - 1, -1, -1):
        if rest.shape[1] == 0:
            break
        p = poles[k]
        quotient = np.empty((rows, max(rest.shape[1] - 1, 0)), dtype=c.dtype)
        carry = rest[:, -1]
        for i in range(rest.shape[1] - 2, -1, -1):
            quotient[:, i] = carry
            carry = rest[:, i] + p * carry
        c[:, k] = carry
        rest = quotient if p == 0 else -p * quotient
    direct = np.zeros((rows, 2), dtype=c.dtype)
    direct[:, : rest.shape[1]] = rest[:, :2]
    return c, direct


def realise(model: Rational, sensitivities: bool = True) -> Realisation:
    """The triangular state space of ``model``; with ``sensitivities`` also the side branches and their rows."""
    factors = model.factors
    poles = np.concatenate([np.zeros(model.integrators), *(f.poles for f in factors)]) + 0j
    if np.all(poles.imag == 0):
        poles = poles.real
    m, q = len(poles), len(model.num)
    free = [f for f in factors if f.free] if sensitivities else []
    size = m + sum(len(f.poles) for f in free)
    kind = poles.dtype
    A, B = np.zeros((size, size), dtype=kind), np.zeros(size, dtype=kind)
    weights = np.where(poles == 0, 1.0, -poles)
    A[np.arange(m), np.arange(m)] = poles
    A[np.arange(1, m), np.arange(m - 1)] = weights[1:]
    if m:
        B[0] = weights[0]

    polys = np.zeros((q + 2 if sensitivities else 1, q + 1))
    polys[0, :q] = model.num
    if sensitivities:
        polys[1 : q + 1, :q] = np.eye(q)
        polys[q + 1, 1:] = -model.num
    c, direct = newton(polys, poles)
    rows = 1 + q + sum(len(f.poles) for f in free) + 1 if sensitivities else 1
    C = np.zeros((rows, size), dtype=kind)
    D, E = np.zeros(rows, dtype=kind), np.zeros(rows, dtype=kind)
    head = q + 1 if sensitivities else 1
    C[:head, :m], D[:head], E[:head] = c[:head], direct[:head, 0], direct[:head, 1]
    if not sensitivities:
        return Realisation(A, B, C, D, E, model.integrators)
    C[-1, :m], D[-1], E[-1] = c[-1], direct[-1, 0], direct[-1, 1]

    state, row = m, head
    for f in free:
        d = len(f.poles)
        p = f.poles if kind.kind == "c" else f.poles.real
        span = np.arange(state, state + d)
        A[span, span] = p
        A[span[1:], span[:-1]] = -p[1:]
        A[state] += -p[0] * C[0]
        B[state] = -p[0] * D[0]
        monomials = np.eye(d + 1)[1:]
        cb, db = newton(monomials, p)
        C[row : row + d] = -db[:, :1] * C[0]
        C[row : row + d, state : state + d] = -cb
        D[row : row + d] = -db[:, 0] * D[0]
        state, row = state + d, row + d
    return Realisation(A, B, C, D, E, model.integrators)
