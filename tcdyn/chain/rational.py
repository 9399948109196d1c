"""Rational transfer functions with dead time, and their exact simulation on sampled input.

A model is G(s) = exp(-Td s) N(s) / (s^k prod_i f_i(s)) with f_i(0) = 1. One cascade of first-order
filters, over all poles, gives the output. A short side branch for each factor gives s^j/f_i of the
output, which is minus its derivative with respect to the j-th coefficient of f_i. Nothing is
expanded into a polynomial of high order, so equal, close and distant poles all have full precision.
Between samples the input is constant (ZOH) or a straight line (FOH).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.polynomial.polynomial import polymul, polyroots
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from tcdyn.core import Array

if TYPE_CHECKING:
    import control

Complex = NDArray[np.complex128]
Hold = Literal["foh", "zoh"]
InitialState = Literal["equilibrium", "zero"]


def polynomial_product(factors: Iterable[ArrayLike]) -> Array:
    """Ascending coefficients of the product of polynomials with ascending coefficients."""
    out: Array = np.ones(1)
    for f in factors:
        out = np.convolve(out, np.asarray(f, dtype=float))
    return out


@dataclass(frozen=True)
class Factor:
    """One denominator factor f(s) = 1 + a_1 s + .. + a_d s^d.

    Parameters
    ----------
    coefs
        Ascending coefficients.
    free
        Whether its sensitivities are computed.
    """

    coefs: tuple[float, ...]
    free: bool = True

    @cached_property
    def poles(self) -> Complex:
        """Roots of f [1/s]."""
        if len(self.coefs) == 2:
            return np.array([-1.0 / self.coefs[1] + 0j])
        return np.asarray(np.roots(self.coefs[::-1]), dtype=complex)


@dataclass(frozen=True)
class Rational:
    """The transfer function exp(-delay s) N(s) / (s^integrators prod f_i(s)); ``num`` is ascending
    in s.
    """

    num: Array
    factors: tuple[Factor, ...]
    delay_s: float = 0.0
    integrators: int = 0

    @property
    def stable(self) -> bool:
        """Whether the poles of every factor lie in the open left half plane."""
        return all(bool(np.all(f.poles.real < 0)) for f in self.factors)

    @property
    def lag_s(self) -> float:
        """First moment of the impulse response [s] over its gain, without integrators: delay + sum
        a_1 - n_1/n_0.
        """
        lead = float(self.num[1] / self.num[0]) if len(self.num) > 1 else 0.0
        return self.delay_s + sum(float(f.coefs[1]) for f in self.factors) - lead

    def polynomials(self) -> tuple[Array, Array]:
        """Numerator and denominator in descending powers of s, without the dead time."""
        den = polynomial_product(f.coefs for f in self.factors)
        return np.asarray(self.num[::-1]), np.append(den[::-1], np.zeros(self.integrators))

    def transfer_function(self, pade_order: int = 3, **names: str) -> control.TransferFunction:
        """As a ``control.TransferFunction``; a dead time enters by its Pade approximation of
        ``pade_order``.

        ``names`` of its signals may be given as ``inputs`` and ``outputs``.
        """
        import control

        num, den = self.polynomials()
        if self.delay_s and pade_order:
            pade_num, pade_den = control.pade(self.delay_s, pade_order)
            num = np.polymul(num, pade_num)
            den = np.polymul(den, pade_den)
        return control.TransferFunction(num, den, **names)

    def frequency_response(self, frequency_Hz: ArrayLike) -> Complex:
        """G(2 pi i f), dead time exact."""
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        value = np.polynomial.polynomial.polyval(s, self.num) * np.exp(-self.delay_s * s)
        for f in self.factors:
            value = value / np.polynomial.polynomial.polyval(s, f.coefs)
        return np.asarray(value / s**self.integrators)

    def frequency_sensitivity(self, frequency_Hz: Array, num_count: int | None = None) -> Complex:
        """dG/dcoef, shape (rows, F), in the order of the rows of ``Realisation``: numerator, free
        factors, dead time.
        """
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        value = self.frequency_response(frequency_Hz)
        without_num = replace(self, num=np.array([1.0])).frequency_response(frequency_Hz)
        rows = [
            s**i * without_num for i in range(len(self.num) if num_count is None else num_count)
        ]
        for f in self.factors:
            if f.free:
                inverse = value / np.polynomial.polynomial.polyval(s, f.coefs)
                rows += [-(s**j) * inverse for j in range(1, len(f.coefs))]
        return np.asarray([*rows, -s * value])


@dataclass(frozen=True)
class Realisation:
    """State space whose outputs are y and its sensitivities.

    dx/dt = A x + B u with A lower triangular (poles on its diagonal). Row r of the outputs is
    ``C[r] x + D[r] u + E[r] du/dt``. Row 0 is y; then follow dy/dnum_i; dy/da_j of the free
    factors; dy/ddelay is last.
    """

    A: NDArray
    B: NDArray
    C: NDArray
    D: NDArray
    E: NDArray
    integrators: int


def newton_form(poly: NDArray, poles: NDArray) -> tuple[NDArray, NDArray]:
    """Newton form: coefficients of poly/prod(phi_i) on the cascade 1, 1/phi_1, 1/(phi_1 phi_2), ..

    Parameters
    ----------
    poly
        Polynomials (R, q+1) in ascending powers, one a row.
    poles
        Poles p_i; phi_i = 1 - s/p_i, or s for a pole at zero.

    Returns
    -------
    state, direct
        Coefficients of the states (R, m), and the polynomial part (R, 2), which multiplies u and
        du/dt.
    """
    rows = poly.shape[0]
    m = len(poles)
    c = np.zeros((rows, m), dtype=np.result_type(poly, poles))
    remainder = np.asarray(poly, dtype=c.dtype)
    for k in range(m - 1, -1, -1):
        if remainder.shape[1] == 0:
            break
        horner = remainder[:, ::-1].copy()  # division by s - p: quotient, then remainder
        for j in range(1, horner.shape[1]):
            horner[:, j] += poles[k] * horner[:, j - 1]
        c[:, k] = horner[:, -1]
        remainder = horner[:, -2::-1] * (1.0 if poles[k] == 0 else -poles[k])
    direct = np.zeros((rows, 2), dtype=c.dtype)
    direct[:, : remainder.shape[1]] = remainder[:, :2]
    return c, direct


def realise(model: Rational, sensitivities: bool = True) -> Realisation:
    """The triangular state space of ``model``; with ``sensitivities`` also the side branches and
    their rows.
    """
    poles = np.concatenate([np.zeros(model.integrators), *(f.poles for f in model.factors)]) + 0j
    if np.all(poles.imag == 0):
        poles = poles.real
    free = [f for f in model.factors if f.free and sensitivities]
    m = len(poles)
    q = len(model.num)
    size = m + sum(len(f.poles) for f in free)
    A = np.zeros((size, size), dtype=poles.dtype)
    B = np.zeros(size, dtype=poles.dtype)
    weights = np.where(poles == 0, 1.0, -poles)
    main = np.arange(m)
    A[main, main] = poles
    A[main[1:], main[:-1]] = weights[1:]
    B[:1] = weights[:1]

    # rows: N, each power of s of N, -s N
    polys = np.zeros((q + 2 if sensitivities else 1, q + 1))
    polys[0, :q] = model.num
    if sensitivities:
        polys[1:-1, :q] = np.eye(q)
        polys[-1, 1:] = -model.num
    c, direct = newton_form(polys, poles)
    C = np.zeros((len(c), size), dtype=c.dtype)
    D, E = direct.T
    C[:, :m] = c
    branches = [C[:0]]
    through = [D[:0]]
    for f in free:
        d = len(f.poles)
        p = f.poles if np.iscomplexobj(A) else f.poles.real
        span = np.arange(m, m + d)
        A[span, span] = p
        A[span[1:], span[:-1]] = -p[1:]
        A[m] += -p[0] * C[0]
        B[m] = -p[0] * D[0]
        state_coefs, direct_coefs = newton_form(np.eye(d + 1)[1:], p)
        branch = -direct_coefs[:, :1] * C[0]
        branch[:, span] = -state_coefs
        branches.append(branch)
        through.append(-direct_coefs[:, 0] * D[0])
        m += d
    C = np.vstack([C[:-1], *branches, C[-1:]])
    branch_direct = np.concatenate(through)
    D = np.concatenate([D[:-1], branch_direct, D[-1:]])
    E = np.concatenate([E[:-1], 0 * branch_direct, E[-1:]])
    return Realisation(A, B, C, D, E, model.integrators)


def step_matrices(system: Realisation, dt_s: float) -> tuple[NDArray, NDArray, NDArray]:
    """Phi, Gamma_u, Gamma_v with x(dt) = Phi x(0) + Gamma_u u(0) + Gamma_v du/dt, exact for a
    linear input.
    """
    n = len(system.B)
    block = np.zeros((n + 2, n + 2), dtype=system.A.dtype)
    block[:n, :n] = system.A
    block[:n, n] = system.B
    block[n, n + 1] = 1.0
    e = expm(block * dt_s)
    return e[:n, :n], e[:n, n], e[:n, n + 1]


def steady_state(system: Realisation, u0: float) -> tuple[NDArray, NDArray]:
    """State x = xa + xb t under an input ``u0`` that has always been constant; ``xb`` is zero
    without integrator.

    An integrator passes through zero at t = 0; the lags after it follow its ramp.
    """
    n = len(system.B)
    k = system.integrators
    xa = np.zeros(n, dtype=system.A.dtype)
    xb = np.zeros(n, dtype=system.A.dtype)
    if n == 0:
        return xa, xb
    if k == 0:
        return np.linalg.solve(system.A, -system.B * u0), xb
    xb[0] = u0 * system.B[0]
    inner = system.A[1:, 1:]
    xb[1:] = np.linalg.solve(inner, -system.A[1:, 0] * xb[0])
    xa[1:] = np.linalg.solve(inner, xb[1:] - system.B[1:] * u0)
    return xa, xb


def states(phi: NDArray, forcing: NDArray, x0: NDArray) -> NDArray:
    """x_{k+1} = phi x_k + forcing_k for lower triangular ``phi``, one first-order filter a state;
    shape (n, N).
    """
    n, steps = forcing.shape
    x = np.empty((n, steps + 1), dtype=np.result_type(phi, forcing))
    x[:, 0] = x0
    x[:, 1:] = forcing
    for k in range(n):
        lower = np.flatnonzero(phi[k, :k])
        if len(lower):
            x[k, 1:] += phi[k, lower] @ x[lower, :-1]
        x[k] = lfilter([1.0], [1.0, -phi[k, k]], x[k])
    return x


def simulate_rows(
    system: Realisation, u: Array, dt_s: float, delay_s: float, hold: Hold, start: InitialState
) -> Array:
    """All output rows (R, N) for the input ``u`` (N,), delayed by ``delay_s``, exact under
    ``hold``.

    Before the record the input was ``u[0]`` (``equilibrium``) or zero (``zero``).
    """
    n = len(u)
    u0 = float(u[0]) if start == "equilibrium" else 0.0
    # delay by an integer number of samples, then a lead by the excess
    delay_samples = int(np.ceil(delay_s / dt_s - 1e-9))
    lead_s = max(delay_samples * dt_s - delay_s, 0.0)
    v = np.concatenate([np.full(delay_samples, u0), u])
    slope = np.append(np.diff(v) / dt_s, 0.0)[:n] if hold == "foh" else np.zeros(n)
    slope[:delay_samples] = 0.0  # the record starts with a step
    v = v[:n]
    phi, gu, gv = step_matrices(system, dt_s)
    xa, xb = steady_state(system, u0)
    x = states(phi, np.outer(gu, v[:-1]) + np.outer(gv, slope[:-1]), xa - xb * delay_samples * dt_s)
    c = system.C
    cu = system.D
    cv = system.E
    if lead_s > 1e-9 * dt_s:
        phi, gu, gv = step_matrices(system, lead_s)
        cv = c @ gv + cu * lead_s + cv
        cu = c @ gu + cu
        c = c @ phi
    out = c @ x + np.outer(cu, v)
    if hold == "foh":
        out += np.outer(cv, slope)
    return np.ascontiguousarray(out.real)


def impulse_rows(system: Realisation, n_samples: int, dt_s: float) -> Array:
    """All output rows (R, N) of the impulse response: the effect of an initial state."""
    phi = expm(system.A * dt_s)
    x = states(phi, np.zeros((len(system.B), n_samples - 1)), system.B)
    return np.ascontiguousarray((system.C @ x).real)


def simulate(
    model: Rational, u: Array, dt_s: float, hold: Hold = "foh", start: InitialState = "equilibrium"
) -> Array:
    """Output (N,) of ``model`` for the input ``u`` (N,), sampled every ``dt_s`` seconds."""
    system = realise(model, sensitivities=False)
    return simulate_rows(system, np.asarray(u, dtype=float), dt_s, model.delay_s, hold, start)[0]


def spectral_factor(
    before: float, after: float, ladder: Array, quickest: float
) -> tuple[tuple[float, ...], ...]:
    """Factors of N, |N(iw)|^2 = before + after |A(iw)|^2, with stable roots; N(0) = 1 for levels
    that sum to one.

    A root faster than ``quickest`` [1/s] is put there: the samples show nothing of it.
    """
    even = after * polymul(ladder, ladder * (-1.0) ** np.arange(len(ladder)))
    even[0] += before
    roots = polyroots(np.trim_zeros(even, "b")) if after > 0 else np.array([])
    roots = roots[roots.real < 0]
    missing = len(ladder) - 1 - len(roots)  # without noise after the filter there are no roots
    roots = np.concatenate([roots, np.full(missing, -quickest)])
    roots = roots * np.minimum(quickest / np.abs(roots), 1.0)
    real = [(1.0, float(-1.0 / r.real)) for r in roots if abs(r.imag) < 1e-9 * abs(r)]
    pairs = [
        (1.0, float(-2 * r.real / abs(r) ** 2), float(abs(r) ** -2))
        for r in roots
        if r.imag >= 1e-9 * abs(r)
    ]
    return (*real, *pairs)
