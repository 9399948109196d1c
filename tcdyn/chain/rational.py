"""Rational transfer functions with dead time, and their exact simulation on sampled input.

A model is G(s) = exp(-Td s) N(s) / (s^k prod_i f_i(s)) with f_i(0) = 1. One cascade of first-order
filters, over all poles, gives the output. A short side branch for each factor gives s^j/f_i of the
output, which is minus its derivative with respect to the j-th coefficient of f_i. Nothing is
expanded into a polynomial of high order, so equal, close and distant poles all have full precision.
Between samples the input is constant (ZOH) or a straight line (FOH).

``tcdyn.chain.chain``, ``tcdyn.identification`` and ``tcdyn.partition.nuisance`` simulate with it.
Guarded by ``tests/identify/test_identify_simulation.py``, ``tests/smoothing/test_noise_parts.py``
and ``tests/chain/test_chain.py``.
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
from tcdyn.core.arguments import with_named_arguments

if TYPE_CHECKING:
    import control

# Array of complex numbers.
Complex = NDArray[np.complex128]
# input between samples: a straight line (first-order hold) or constant (zero-order hold)
Hold = Literal["foh", "zoh"]
# input before the record: its first sample, or zero
InitialState = Literal["equilibrium", "zero"]


def polynomial_product(factors: Iterable[ArrayLike]) -> Array:
    """Product of polynomials.

    Parameters
    ----------
    factors
        Ascending coefficients of each polynomial.

    Returns
    -------
    Ascending coefficients of the product; [1] for no factors.
    """
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
    """The transfer function exp(-delay s) N(s) / (s^integrators prod f_i(s)).

    Parameters
    ----------
    num
        Ascending coefficients of N.
    factors
        Denominator factors f_i.
    delay_s
        Dead time [s].
    integrators
        Number of poles at zero.
    """

    num: Array
    factors: tuple[Factor, ...]
    delay_s: float = 0.0
    integrators: int = 0

    @property
    def is_stable(self) -> bool:
        """Whether the poles of every factor lie in the open left half plane."""
        return all(bool(np.all(f.poles.real < 0)) for f in self.factors)

    @property
    def lag_s(self) -> float:
        """First moment of the impulse response over its gain [s], without integrators.

        Notes
        -----
        delay + sum a_1 - n_1/n_0
        """
        lead = float(self.num[1] / self.num[0]) if len(self.num) > 1 else 0.0
        return self.delay_s + sum(float(f.coefs[1]) for f in self.factors) - lead

    def polynomials(self) -> tuple[Array, Array]:
        """Numerator and denominator in descending powers of s, without the dead time.

        Returns
        -------
        num, den
            Coefficients in descending powers of s.

        Notes
        -----
        Expansion of many or distant poles loses digits; simulate with ``realise``.
        """
        den = polynomial_product(f.coefs for f in self.factors)
        return np.asarray(self.num[::-1]), np.append(den[::-1], np.zeros(self.integrators))

    def transfer_function(self, pade_order: int = 3, **names: str) -> control.TransferFunction:
        """The model as a ``control.TransferFunction``.

        Parameters
        ----------
        pade_order
            Order of the Pade approximation of the dead time; 0 leaves the dead time out.
        **names
            Names of the signals, ``inputs`` and ``outputs``.
        """
        import control

        num, den = self.polynomials()
        if self.delay_s and pade_order:
            pade_num, pade_den = control.pade(self.delay_s, pade_order)
            num = np.polymul(num, pade_num)
            den = np.polymul(den, pade_den)
        return control.TransferFunction(num, den, **names)

    def frequency_response(self, frequency_Hz: ArrayLike) -> Complex:
        """G(2 pi i f), dead time exact, in the shape of ``frequency_Hz`` [Hz]."""
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        value = np.polynomial.polynomial.polyval(s, self.num) * np.exp(-self.delay_s * s)
        for f in self.factors:
            value = value / np.polynomial.polynomial.polyval(s, f.coefs)
        return np.asarray(value / s**self.integrators)

    def frequency_sensitivity(self, frequency_Hz: Array, num_count: int | None = None) -> Complex:
        """Derivatives of the frequency response with respect to the coefficients.

        Parameters
        ----------
        frequency_Hz
            Frequencies, (F,) [Hz].
        num_count
            Number of numerator coefficients; all of ``num`` if None.

        Returns
        -------
        dG/dcoef, (rows, F): numerator, free factors, dead time.

        Notes
        -----
        The order is that of the rows of ``Realisation`` after the first; change both together.
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

    Parameters
    ----------
    A
        System matrix, (n, n); complex where a pole is.
    B
        Input column, (n,).
    C
        Output rows, (R, n).
    D, E
        Direct terms of the input and of its slope, (R,).
    integrators
        Number of poles at zero, which are the first states.
    """

    A: NDArray
    B: NDArray
    C: NDArray
    D: NDArray
    E: NDArray
    integrators: int


def newton_form(poly: NDArray, poles: NDArray) -> tuple[NDArray, NDArray]:
    """Coefficients of polynomials on a cascade of first-order filters (Newton form).

    Parameters
    ----------
    poly
        Polynomials (R, q+1) in ascending powers, one a row.
    poles
        Poles p_i, (m,); phi_i = 1 - s/p_i, or s for a pole at zero.

    Returns
    -------
    state
        Coefficients of the states, (R, m).
    direct
        Polynomial part, (R, 2), which multiplies u and du/dt.

    Notes
    -----
    poly/prod(phi_i) = sum_k state_k/(phi_1 .. phi_k) + direct. Division by one pole after another
    (Horner) gives full precision for equal and close poles. ``tests/smoothing/test_noise_parts.py``
    compares with the division itself.
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
    """The triangular state space of a model.

    Parameters
    ----------
    model
        The transfer function.
    sensitivities
        Whether to add the side branches and their rows, described at ``Realisation``.

    Notes
    -----
    Complex arithmetic is used only where a pole is complex. The rows must have the order of
    ``Rational.frequency_sensitivity``; ``tests/identify/test_identify_simulation.py`` guards it.
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
    # States of the side branches are of the size of the main ones: the exponential of a matrix with
    # couplings of any size loses its small elements. A power of two changes no digit of the others.
    coupling = float(np.max(np.abs(c[0]), initial=float(np.abs(direct[0]).max())))
    unit = 2.0 ** np.round(np.log2(coupling)) if 0 < coupling < np.inf else 1.0
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
        A[m] += -p[0] * C[0] / unit
        B[m] = -p[0] * D[0] / unit
        state_coefs, direct_coefs = newton_form(np.eye(d + 1)[1:], p)
        branch = -direct_coefs[:, :1] * C[0]
        branch[:, span] = -unit * state_coefs
        branches.append(branch)
        through.append(-direct_coefs[:, 0] * D[0])
        m += d
    C = np.vstack([C[:-1], *branches, C[-1:]])
    branch_direct = np.concatenate(through)
    D = np.concatenate([D[:-1], branch_direct, D[-1:]])
    E = np.concatenate([E[:-1], 0 * branch_direct, E[-1:]])
    return Realisation(A, B, C, D, E, model.integrators)


def step_matrices(system: Realisation, dt_s: float) -> tuple[NDArray, NDArray, NDArray]:
    """Matrices of one step of the state space, exact for a linear input.

    Parameters
    ----------
    system
        State space with n states.
    dt_s
        Step [s].

    Returns
    -------
    phi, gamma_u, gamma_v
        x(dt) = phi x(0) + gamma_u u(0) + gamma_v du/dt; (n, n), (n,) and (n,).
    """
    n = len(system.B)
    block = np.zeros((n + 2, n + 2), dtype=system.A.dtype)
    block[:n, :n] = system.A
    block[:n, n] = system.B
    block[n, n + 1] = 1.0
    e = expm(block * dt_s)
    return e[:n, :n], e[:n, n], e[:n, n + 1]


def steady_state(system: Realisation, u0: float) -> tuple[NDArray, NDArray]:
    """State under an input that has always been constant.

    Parameters
    ----------
    system
        State space with n states.
    u0
        The input.

    Returns
    -------
    xa, xb
        x = xa + xb t, (n,) each; ``xb`` is zero without integrator.

    Notes
    -----
    An integrator passes through zero at t = 0; the lags after it follow its ramp. One integrator is
    supported.
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


def propagate_states(phi: NDArray, forcing: NDArray, x0: NDArray) -> NDArray:
    """States x_{k+1} = phi x_k + forcing_k for lower triangular ``phi``.

    Parameters
    ----------
    phi
        Lower triangular matrix, (n, n).
    forcing
        Forcing of each step, (n, N - 1).
    x0
        State at the first sample, (n,).

    Returns
    -------
    States, (n, N).

    Notes
    -----
    One first-order filter for each state, from the first to the last.
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
    """All output rows for an input, exact under ``hold``.

    Parameters
    ----------
    system
        State space with R output rows.
    u
        Input, (N,).
    dt_s
        Sampling interval [s].
    delay_s
        Dead time [s].
    hold
        Input between samples: a straight line (``foh``) or constant (``zoh``).
    start
        Before the record the input was ``u[0]`` (``equilibrium``) or zero (``zero``).

    Returns
    -------
    Outputs, (R, N).

    Notes
    -----
    A dead time of a fraction of a sample is exact too: the input is delayed by whole samples, and
    the outputs are evaluated within the interval. Guarded by ``tests/chain/test_chain.py`` and
    ``tests/identify/test_identify_simulation.py``.
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
    x = propagate_states(
        phi, np.outer(gu, v[:-1]) + np.outer(gv, slope[:-1]), xa - xb * delay_samples * dt_s
    )
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
    """All output rows of the impulse response: the effect of an initial state.

    Parameters
    ----------
    system
        State space with R output rows.
    n_samples
        Number of samples N.
    dt_s
        Sampling interval [s].

    Returns
    -------
    Outputs, (R, N); direct terms are left out.
    """
    phi = expm(system.A * dt_s)
    x = propagate_states(phi, np.zeros((len(system.B), n_samples - 1)), system.B)
    return np.ascontiguousarray((system.C @ x).real)


@with_named_arguments
def simulate(
    model: Rational, u: Array, dt_s: float, hold: Hold = "foh", start: InitialState = "equilibrium"
) -> Array:
    """Output of a model for a sampled input.

    Parameters
    ----------
    model
        The transfer function.
    u
        Input, (N,).
    dt_s
        Sampling interval [s].
    hold
        Input between samples: a straight line (``foh``) or constant (``zoh``).
    start
        Before the record the input was ``u[0]`` (``equilibrium``) or zero (``zero``).

    Returns
    -------
    Output, (N,).

    Examples
    --------
    >>> from tcdyn.chain import Chain
    >>> simulate(Chain(1.0).rational, np.array([0.0, 1.0, 1.0, 1.0]), 1.0, "zoh").round(3)
    array([0.   , 0.   , 0.632, 0.865])
    """
    system = realise(model, sensitivities=False)
    return simulate_rows(system, np.asarray(u, dtype=float), dt_s, model.delay_s, hold, start)[0]


def spectral_factor(
    before: float, after: float, ladder: Array, quickest: float
) -> tuple[tuple[float, ...], ...]:
    """Stable factors of N with |N(iw)|^2 = before + after |A(iw)|^2.

    Parameters
    ----------
    before, after
        Levels of the noise before and after the filter; N(0) = 1 where they sum to one.
    ladder
        Ascending coefficients of A, the denominator of the filter.
    quickest
        Largest rate of a root [1/s]. A faster root is put there: the samples show nothing of it.

    Returns
    -------
    Ascending coefficients of each factor, real roots first, then pairs.

    Notes
    -----
    Spectral factorisation: the roots of the even polynomial in the left half plane. Guarded by
    ``tests/smoothing/test_noise_parts.py``.
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
