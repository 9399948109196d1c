"""What an identified model answers: step response, percent times and Bode diagram with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tcdyn.chain.rational import Rational, realise, simulate_rows
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.identify.models import Known, Model

PERCENT_TIMES = {"t50": 0.5, "t63.2": 1 - float(np.exp(-1)), "t90": 0.9}


class Dynamics:
    """A linear model of one input with the covariance of its free parameters: what every response is drawn from."""

    model: Model
    theta: Mapping[str, float]
    covariance: Array
    dt_s: float

    @property
    def rational(self) -> Rational:
        """The transfer function as factors, the known part included; InputError where each input has its own."""
        if self.model.inputs:
            raise InputError(
                f"{self.model.name} has {len(self.model.inputs)} inputs",
                remedy=f"ask parts[{self.model.inputs[0]!r}]",
            )
        return self.model.rational(self.theta)

    @property
    def gain(self) -> float:
        """Static gain (of the part before the integrator)."""
        return float(self.rational.num[0])

    @cached_property
    def lag_s(self) -> Estimate:
        """First moment of the impulse response [s], the known part's own included, with its interval.

        Td + sum of a_1 - b_1/b_0, and by the chain rule of the coefficients its derivatives with the free parameters.
        """
        g = self.rational
        row = [g.num[1] / g.num[0] ** 2, -1.0 / g.num[0]] if len(g.num) > 1 else []
        row += [0.0] * (len(g.num) - len(row))
        for f in g.factors:
            row += [1.0, *[0.0] * (len(f.coefs) - 2)] if f.free else []
        slopes = [*row, 1.0] @ self.model.chain_rule(self.theta)
        return Estimate.normal(g.lag_s, self.u_of(slopes[:, None])[0])

    def u_of(self, slopes: Array) -> Array:
        """Standard uncertainties (N,) of quantities with these ``slopes`` (P, N) by the free parameters."""
        return np.sqrt(np.maximum(np.einsum("pn,pq,qn->n", slopes, self.covariance, slopes), 0.0))


@dataclass(frozen=True)
class Band:
    """``value`` over ``x`` with standard uncertainty ``u``; the 95 % band is value -+ 1.96 u."""

    x: Array
    value: Array
    u: Array

    @property
    def low95(self) -> Array:
        """Lower edge."""
        return self.value - Z95 * self.u

    @property
    def high95(self) -> Array:
        """Upper edge."""
        return self.value + Z95 * self.u


@dataclass(frozen=True)
class BodeBand:
    """Magnitude [dB] and phase [deg] over frequency [Hz]."""

    magnitude_dB: Band
    phase_deg: Band


def step_rows(model: Dynamics, time_s: Array) -> tuple[Array, Array]:
    """Unit step response (N,) at the even times ``time_s`` from 0 and its derivatives by the free parameters (P,
    N)."""
    g = model.rational
    dt = float(time_s[1] - time_s[0])
    rows = simulate_rows(realise(g), np.ones(len(time_s)), dt, g.delay_s, "zoh", "zero")
    return rows[0], model.model.chain_rule(model.theta).T @ rows[1:]


def step_times(model: Dynamics, count: int = 1200) -> Array:
    """An even time grid [s] that holds the whole step response."""
    g = model.rational
    return np.linspace(0.0, g.delay_s + 8 * slowest_s(g), count + 1)


def slowest_s(g: Rational) -> float:
    """Time constant of the slowest pole [s]; 1 where there is none."""
    return max((float(1 / np.min(np.abs(f.poles.real))) for f in g.factors), default=1.0)


def step_band(model: Dynamics, time_s: Array | None = None) -> Band:
    """The unit step response with its band, by first-order propagation of the covariance."""
    t = step_times(model, 400) if time_s is None else np.asarray(time_s, dtype=float)
    y, j = step_rows(model, t)
    return Band(t, y, model.u_of(j))


def percent_times(model: Dynamics) -> dict[str, Estimate]:
    """t50, t63.2 and t90 [s]: when the unit step response first passes that share of its final value (VDI/VDE
    3522).

    dt_q = -d(y/K)/dtheta / slope at the crossing. Raises InputError for an integrating model, which has no final
    value.
    """
    if model.model.integrators:
        raise InputError(f"{model.model.name} integrates: its step response has no final value")
    t = step_times(model, 4000)
    y, j = step_rows(model, t)
    share = y / model.gain
    derivative = (j - np.outer(model.model.chain_rule(model.theta)[0], share)) / model.gain
    slope = np.gradient(share, t)
    out = {}
    for name, q in PERCENT_TIMES.items():
        i = max(int(np.argmax(share >= q)), 1)
        at = float(np.interp(q, share[i - 1 : i + 1], t[i - 1 : i + 1]))
        steep = max(float(np.interp(at, t, slope)), 1e-12)
        slopes = -np.array([[np.interp(at, t, row)] for row in derivative]) / steep
        out[name] = Estimate.normal(at, model.u_of(slopes)[0])
    return out


def bode_band(model: Dynamics, frequency_Hz: Array | None = None) -> BodeBand:
    """Magnitude and phase with their bands; by default two decades either side of the slowest corner, and of a
    model of a record to half its sampling rate.

    d(20 lg|G|) = 20/ln 10 Re(dG/G), d(phase) = Im(dG/G).
    """
    g = model.rational
    if frequency_Hz is None:
        scale_s, top_Hz = (g.lag_s, 0.5 / model.dt_s) if model.dt_s else (slowest_s(g), np.inf)
        corner = (
            0.1 / model.dt_s
            if g.integrators and model.dt_s
            else 1 / (2 * np.pi * max(scale_s, model.dt_s))
        )
        frequency_Hz = np.geomspace(corner / 100, min(corner * 100, top_Hz), 200)
    f = np.asarray(frequency_Hz, dtype=float)
    value = g.frequency_response(f)
    relative = model.model.chain_rule(model.theta).T @ (g.frequency_sensitivity(f) / value)
    magnitude = model.u_of(20 / np.log(10) * relative.real)
    phase = model.u_of(np.degrees(relative.imag))
    return BodeBand(
        Band(f, 20 * np.log10(np.abs(value)), magnitude),
        Band(f, np.degrees(np.unwrap(np.angle(value))), phase),
    )


@dataclass(frozen=True)
class Root:
    """A pole or zero of the model [1/s] with the ``covariance`` (2, 2) of its real and imaginary part."""

    kind: str
    value: complex
    covariance: Array


def roots_of(model: Dynamics) -> list[Root]:
    """Poles and zeros of what was identified, the known part left out, with their covariances.

    A root r of p(s) = sum c_k s^k moves by dr = -(sum r^k dc_k)/p'(r): valid for roots that are apart. Those at zero,
    of an integrator, are certain.
    """
    m = model.model
    found = [Root("pole", 0j, np.zeros((2, 2)))] * model.model.integrators
    rule = replace(m, known=Known()).chain_rule(model.theta)
    known = 0
    above, below = m.coefficients(m.full(model.theta))
    for kind, coefficients in (("zero", above), *(("pole", f) for f in below)):
        c = np.asarray(coefficients, dtype=float)
        first = int(kind == "pole")
        rows = np.zeros((len(c), rule.shape[1]))
        rows[first:] = rule[known : known + len(c) - first]
        known += len(c) - first
        slope = np.polynomial.polynomial.polyder(c)
        for r in np.polynomial.polynomial.polyroots(c) if len(c) > 1 else ():
            moved = -(r ** np.arange(len(c)) @ rows) / np.polynomial.polynomial.polyval(r, slope)
            j = np.array([np.real(moved), np.imag(moved)])
            found.append(Root(kind, complex(r), j @ model.covariance @ j.T))
    return found
