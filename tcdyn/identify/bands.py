"""Step response, Bode diagram and percent times of an identified model, each with its 95 % band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.estimate import Z95, Estimate
from tcdyn.chain.rational import realise, simulate_rows
from tcdyn.identify.identified import Identified

PERCENT_TIMES = {"t50": 0.5, "t63.2": 1 - float(np.exp(-1)), "t90": 0.9}


@dataclass(frozen=True)
class Band:
    """``value`` over ``x`` with standard uncertainty ``u``; the 95 % band is value -+ 1.96 u."""

    x: Array
    value: Array
    u: Array

    @property
    def low95(self) -> Array:
        """Lower edge."""
        return np.asarray(self.value - Z95 * self.u)

    @property
    def high95(self) -> Array:
        """Upper edge."""
        return np.asarray(self.value + Z95 * self.u)


@dataclass(frozen=True)
class BodeBand:
    """Magnitude [dB] and phase [deg] over frequency [Hz]."""

    magnitude_dB: Band
    phase_deg: Band


def step_rows(model: Identified, time_s: Array) -> tuple[Array, Array]:
    """Unit step response (N,) at the even times ``time_s`` from 0 and its derivatives by the free parameters (P,
    N)."""
    g = model.rational
    dt = float(time_s[1] - time_s[0])
    rows = simulate_rows(realise(g), np.ones(len(time_s)), dt, g.delay_s, "zoh", "zero")
    return rows[0], model.model.chain_rule(model.theta).T @ rows[1:]


def step_times(model: Identified, count: int = 1200) -> Array:
    """An even time grid [s] that holds the whole step response."""
    g = model.rational
    slowest = max((float(1 / np.min(np.abs(f.poles.real))) for f in g.factors), default=1.0)
    return np.linspace(0.0, g.delay_s + 8 * slowest, count + 1)


def step_band(model: Identified, time_s: Array | None = None) -> Band:
    """The unit step response with its band, by first-order propagation of the covariance."""
    t = step_times(model, 400) if time_s is None else np.asarray(time_s, dtype=float)
    y, j = step_rows(model, t)
    return Band(t, y, deviation(j, model.covariance))


def deviation(j: Array, covariance: Array) -> Array:
    """sqrt(diag(J' C J)) for J (P, N)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("pn,pq,qn->n", j, covariance, j), 0.0)))


def percent_times(model: Identified) -> dict[str, Estimate]:
    """t50, t63.2 and t90 [s]: when the unit step response first passes that share of its final value (VDI/VDE
    3522).

    dt_q = -d(y/K)/dtheta / slope at the crossing. Raises InputError for an integrating model, which has no final
    value.
    """
    if model.model.integrators:
        raise InputError(f"{model.model.name} integrates: its step response has no final value")
    t = step_times(model, 4000)
    y, j = step_rows(model, t)
    k = model.gain
    rule = model.model.chain_rule(model.theta)[0]
    share, derivative = y / k, (j - np.outer(rule, y / k)) / k
    slope = np.gradient(share, t)
    out = {}
    for name, q in PERCENT_TIMES.items():
        above = np.flatnonzero(share >= q)
        i = max(int(above[0]), 1)
        rise = share[i] - share[i - 1]
        part = (q - share[i - 1]) / rise if rise > 0 else 1.0
        at = t[i - 1] + part * (t[i] - t[i - 1])
        steep = max(float((1 - part) * slope[i - 1] + part * slope[i]), 1e-12)
        gradient = -((1 - part) * derivative[:, i - 1] + part * derivative[:, i]) / steep
        out[name] = Estimate.normal(at, float(np.sqrt(max(model.propagate(gradient), 0.0))))
    return out


def bode_band(model: Identified, frequency_Hz: Array | None = None) -> BodeBand:
    """Magnitude and phase with their bands; by default two decades either side of the slowest corner.

    d(20 lg|G|) = 20/ln 10 Re(dG/G), d(phase) = Im(dG/G).
    """
    g = model.rational
    if frequency_Hz is None:
        corner = 1 / (2 * np.pi * max(model.lag_at(model.theta), model.dt_s)) if not g.integrators else 0.1 / model.dt_s
        frequency_Hz = np.geomspace(corner / 100, min(corner * 100, 0.5 / model.dt_s), 200)
    f = np.asarray(frequency_Hz, dtype=float)
    value = g.frequency_response(f)
    relative = model.model.chain_rule(model.theta).T @ (g.frequency_sensitivity(f) / value)
    magnitude = deviation(20 / np.log(10) * relative.real, model.covariance)
    phase = deviation(np.degrees(relative.imag), model.covariance)
    return BodeBand(
        Band(f, 20 * np.log10(np.abs(value)), magnitude), Band(f, np.degrees(np.unwrap(np.angle(value))), phase)
    )
