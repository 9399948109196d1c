"""Discrete-time ARX and output-error models, for comparison with what other tools give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.estimate import with_u
from calibration.result import Result
from tcdyn.identify.data import IOData, Run
from tcdyn.identify.noise import inverse
from tcdyn.identify.optimise import least_squares


@dataclass(frozen=True)
class DiscreteFit(Result):
    """y = q^-nk B(q)/A(q) u + offset; ``a`` = (1, a1, ..), ``b`` = (b0, ..); covariance of (a1.., b0..,
    offset)."""

    kind: str
    a: Array
    b: Array
    nk: int
    offset: float
    covariance: Array
    dt_s: float
    fit_percent: float
    rms: float

    @property
    def gain(self) -> float:
        """Static gain B(1)/A(1)."""
        return float(self.b.sum() / self.a.sum())

    @property
    def poles(self) -> Array:
        """Poles in the z plane."""
        return np.asarray(np.roots(self.a))

    @property
    def time_constants_s(self) -> Array:
        """-dt/ln|p| of every pole [s]."""
        with np.errstate(divide="ignore"):
            return np.asarray(-self.dt_s / np.log(np.abs(self.poles)))

    def summary(self) -> str:
        """Coefficients with their standard uncertainties, gain, time constants and the simulated fit."""
        names = [*(f"a{i + 1}" for i in range(len(self.a) - 1)), *(f"b{i}" for i in range(len(self.b)))]
        values = [*self.a[1:], *self.b]
        lines = [f"{self.kind}, {self.nk} samples of dead time, dt = {self.dt_s:g} s"]
        lines += [f"  {n} {with_u(v, u)}" for n, v, u in zip(names, values, np.sqrt(np.diag(self.covariance)))]
        lines.append(f"  offset {self.offset:.4g}, gain {self.gain:.4g}")
        lines.append(f"  time constants {', '.join(f'{t:.4g}' for t in self.time_constants_s)} s")
        return "\n".join([*lines, f"  fit {self.fit_percent:.2f} % (simulated), rms {self.rms:.4g}"])

    def to_dict(self) -> dict[str, Any]:
        """The fields, the gain and the time constants."""
        return {**super().to_dict(), "gain": self.gain, "time_constants_s": self.time_constants_s.tolist()}

    def simulate(self, u: Array) -> Array:
        """Output from the input alone, started in equilibrium with ``u[0]``."""
        return response(self.a, self.b, self.nk, np.asarray(u, dtype=float)) + self.offset


def response(a: Array, b: Array, nk: int, u: Array) -> Array:
    """q^-nk B/A u from equilibrium at u[0]."""
    x = np.concatenate([np.full(nk, u[0]), u[: len(u) - nk]]) - u[0]
    return np.asarray(lfilter(b, a, x) + u[0] * b.sum() / a.sum())


def complete(data: IOData) -> tuple[Run, ...]:
    """The runs, refused when values are missing: discrete-time regressions cannot skip samples."""
    for run in data.runs:
        if np.isnan(run.u).any() or np.isnan(run.y).any():
            raise InputError(
                "arx/oe: samples are missing",
                where=data.name or "IOData",
                remedy="use fit(), which tolerates gaps",
            )
    return data.runs


def arx(data: IOData, na: int, nb: int, nk: int = 1) -> DiscreteFit:
    """Least-squares A(q) y = q^-nk B(q) u + c: one-step prediction, hence biased where noise is not of that shape.

    The reported fit is of the *simulated* output.
    """
    rows, targets = [], []
    for run in complete(data):
        u, y = run.u[:, 0], run.y[:, 0]
        first = max(na, nb + nk - 1)
        t = np.arange(first, len(y))
        past = [-y[t - i - 1] for i in range(na)] + [u[t - nk - i] for i in range(nb)]
        rows.append(np.array([*past, np.ones(len(t))]).T)
        targets.append(y[t])
    phi, target = np.vstack(rows), np.concatenate(targets)
    x = np.linalg.lstsq(phi, target, rcond=None)[0]
    e = target - phi @ x
    a, b = np.concatenate([[1.0], x[:na]]), x[na : na + nb]
    covariance = float(e @ e) / max(len(target) - len(x), 1) * inverse(phi)[0]
    return scored("ARX", a, b, nk, float(x[-1] / a.sum()), covariance, data)


def oe(data: IOData, nb: int, nf: int, nk: int = 1) -> DiscreteFit:
    """Output error y = q^-nk B/F u + c + e by least squares with exact gradients, started from ARX."""
    runs = complete(data)
    start = arx(data, nf, nb, nk)
    roots = start.poles
    stable = np.poly(np.where(np.abs(roots) >= 0.999, 0.98 * roots / np.maximum(np.abs(roots), 1e-9), roots)).real

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        f, b = np.concatenate([[1.0], x[:nf]]), x[nf : nf + nb]
        if np.max(np.abs(np.roots(f)), initial=0.0) >= 1:
            return None
        r, j = [], []
        for run in runs:
            u = run.u[:, 0]
            w = response(f, b, nk, u)
            columns = [-response(f, np.eye(nf + 1)[i + 1], 0, w) for i in range(nf)]
            columns += [response(f, np.eye(nb)[i], nk, u) for i in range(nb)]
            r.append(w + x[-1] - run.y[:, 0])
            j.append(np.array([*columns, np.ones(len(u))]).T)
        return np.concatenate(r), np.vstack(j)

    x0 = np.concatenate([stable[1:], start.b, [start.offset]])
    free = np.full(len(x0), np.inf)
    best = least_squares(evaluate, x0, -free, free, max_iterations=100)
    if best is None:
        raise InputError("oe: no stable start was found", where=data.name, remedy="use fit(), which starts itself")
    covariance = best.cost / max(len(best.residual) - len(x0), 1) * inverse(best.jacobian)[0]
    a, b = np.concatenate([[1.0], best.x[:nf]]), best.x[nf : nf + nb]
    return scored("OE", a, b, nk, float(best.x[-1]), covariance, data)


def scored(kind: str, a: Array, b: Array, nk: int, offset: float, covariance: Array, data: IOData) -> DiscreteFit:
    """The model with its simulated score on ``data``."""
    error = spread = 0.0
    n = 0
    for run in data.runs:
        y = run.y[:, 0]
        with np.errstate(all="ignore"):
            e = response(a, b, nk, run.u[:, 0]) + offset - y
        error += float(e @ e) if np.all(np.isfinite(e)) else np.inf
        spread += float(np.sum((y - y.mean()) ** 2))
        n += len(y)
    percent = 100 * (1 - float(np.sqrt(error / spread))) if spread > 0 else 0.0
    return DiscreteFit(kind, a, b, nk, offset, covariance, data.dt_s, percent, float(np.sqrt(error / n)))
