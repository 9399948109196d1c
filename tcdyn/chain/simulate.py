"""Exact simulation of a realised model on sampled input, held (ZOH) or joined by straight lines (FOH)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tcdyn.chain.factors import Array, Rational, Realisation, realise

Hold = Literal["zoh", "foh"]
Start = Literal["equilibrium", "zero"]


TAYLOR = 1.0 / np.cumprod(np.concatenate([[1.0], np.arange(1.0, 16.0)]))


def expm(a: NDArray) -> NDArray:
    """exp(a) of a small matrix: Taylor's series to a^15 after scaling below 1/2 (error below rounding), then
    squaring.

    For the matrices here (at most some twenty rows) this takes a tenth of the general routine's time, and it never
    wakes a linear-algebra thread pool.
    """
    norm = float(np.max(np.sum(np.abs(a), axis=0), initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(norm / 0.5)))) if norm > 0.5 else 0
    x = a / 2.0**squarings
    one = np.eye(len(a))
    x2 = x @ x
    x3 = x2 @ x
    x4 = x2 @ x2
    c = TAYLOR
    rows = [c[k] * one + c[k + 1] * x + c[k + 2] * x2 + c[k + 3] * x3 for k in (0, 4, 8, 12)]
    e = rows[0] + x4 @ (rows[1] + x4 @ (rows[2] + x4 @ rows[3]))
    for _ in range(squarings):
        e = e @ e
    return np.asarray(e)


def step_matrices(system: Realisation, dt_s: float) -> tuple[NDArray, NDArray, NDArray]:
    """Phi, Gamma_u, Gamma_v with x(dt) = Phi x(0) + Gamma_u u(0) + Gamma_v du/dt, exact for a straight-line
    input."""
    n = len(system.B)
    block = np.zeros((n + 2, n + 2), dtype=system.A.dtype)
    block[:n, :n] = system.A
    block[:n, n] = system.B
    block[n, n + 1] = 1.0
    e = expm(block * dt_s)
    return e[:n, :n], e[:n, n], e[:n, n + 1]


def stationary(system: Realisation, u0: float) -> tuple[NDArray, NDArray]:
    """State x = xa + xb t that a constant input ``u0`` has kept up for ever; ``xb`` is zero without integrator.

    An integrator passes through zero at t = 0; the lags behind it follow its ramp.
    """
    n, k = len(system.B), system.integrators
    xa, xb = np.zeros(n, dtype=system.A.dtype), np.zeros(n, dtype=system.A.dtype)
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
    """x_{k+1} = phi x_k + forcing_k for lower triangular ``phi``: one first-order filter a state; (n, N)."""
    n, steps = forcing.shape
    x = np.empty((n, steps + 1), dtype=np.result_type(phi, forcing))
    x[:, 0] = x0
    for k in range(n):
        g = forcing[k]
        lower = np.flatnonzero(phi[k, :k])
        if len(lower):
            g = g + phi[k, lower] @ x[lower, :-1]
        x[k, 1:] = lfilter([1.0], np.array([1.0, -phi[k, k]]), g, zi=np.array([phi[k, k] * x0[k]]))[0]
    return x


def simulate_rows(system: Realisation, u: Array, dt_s: float, delay_s: float, hold: Hold, start: Start) -> Array:
    """All output rows (R, N) for the input ``u`` (N,), delayed by ``delay_s``, exact under ``hold``.

    Before the record the input was ``u[0]`` for ever (``equilibrium``) or nothing at all (``zero``).
    """
    n_samples = len(u)
    u0 = float(u[0]) if start == "equilibrium" else 0.0
    rise = np.diff(u) if hold == "foh" else np.zeros(n_samples - 1)
    phi, gu, gv = step_matrices(system, dt_s)
    xa, xb = stationary(system, u0)
    x = states(phi, np.outer(gu, u[:-1]) + np.outer(gv, rise / dt_s), xa)
    whole = int(np.floor(delay_s / dt_s))
    part = delay_s / dt_s - whole
    if part < 1e-9:
        behind, ahead_s = whole, 0.0
    else:
        behind, ahead_s = whole + 1, (1.0 - part) * dt_s
    behind = min(behind, n_samples)
    slope = np.append(rise / dt_s, 0.0)
    if behind:
        past = np.arange(-behind, 0) * dt_s
        keep = n_samples - behind
        x = np.hstack([xa[:, None] + xb[:, None] * past, x[:, :keep]])
        v = np.concatenate([np.full(behind, u0), u[:keep]])
        slope = np.concatenate([np.zeros(behind), slope[:keep]])
    else:
        v = u
    c, cu, cv = system.C, system.D, system.E
    if ahead_s > 0:
        phi_a, gu_a, gv_a = step_matrices(system, ahead_s)
        cu = c @ gu_a + system.D
        cv = c @ gv_a + system.D * ahead_s + system.E
        c = c @ phi_a
    out = c @ x + np.outer(cu, v)
    if hold == "foh":
        out += np.outer(cv, slope)
    return np.ascontiguousarray(out.real)


def free_rows(system: Realisation, n_samples: int, dt_s: float) -> Array:
    """All output rows (R, N) of the response to a unit impulse at t = 0: what an initial state leaves behind."""
    phi = expm(system.A * dt_s)
    x = states(phi, np.zeros((len(system.B), n_samples - 1)), system.B)
    return np.ascontiguousarray((system.C @ x).real)


def simulate(model: Rational, u: Array, dt_s: float, hold: Hold = "foh", start: Start = "equilibrium") -> Array:
    """What ``model`` makes of ``u`` (N,) sampled every ``dt_s`` seconds: shape (N,)."""
    system = realise(model, sensitivities=False)
    return simulate_rows(system, np.asarray(u, dtype=float), dt_s, model.delay_s, hold, start)[0]
