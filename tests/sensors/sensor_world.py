"""Sensors made by recursions of their own: lags as fine first-order steps, sheaths as shells of
heat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

Array = NDArray[np.float64]
FINE = 20  # steps of the simulation in a sample


def lagged(x: Array, taus_s: tuple[float, ...], dt_s: float) -> Array:
    """What lags one after the other make of ``x`` (N,), which is sampled every ``dt_s``; they begin
    in balance."""
    y = x
    for tau in taus_s:
        keep = np.exp(-dt_s / tau)
        half = (1 - keep) / 2
        y = lfilter([half, half], [1, -keep], y, zi=[(1 - half) * y[0]])[0]
    return y


def fluid(t: Array, rise_K: float = 30.0) -> Array:
    """A temperature [degC] that swings, and bends at a third of the time."""
    third = t[0] + (t[-1] - t[0]) / 3
    return 200 + 20 * np.sin(t / 7) + rise_K * (1 - np.exp(-np.clip(t - third, 0, None) / 3.0))


def logged(
    taus_s: tuple[float, ...], dt_s: float, n: int, noise_K: float, seed: int, rise_K: float = 30.0
) -> tuple[Array, Array, Array]:
    """Time (N,) [s], fluid and reading (N,) [degC]."""
    fine = np.arange(n * FINE) * (dt_s / FINE)
    x = fluid(fine, rise_K)
    y = lagged(x, taus_s, dt_s / FINE)[::FINE] + noise_K * np.random.default_rng(
        seed
    ).standard_normal(n)
    return fine[::FINE], x[::FINE], y


def write(path: Path, **columns: Array) -> Path:
    """A CSV of these columns."""
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def written(path: Path) -> pd.DataFrame:
    """A table that was written."""
    return pd.read_csv(path)


def varying(x: Array, tau_s: Array, dt_s: float) -> Array:
    """One lag that changes: each step exact for its own lag and a straight line of ``x``'s
    middle."""
    keep = np.exp(-dt_s / tau_s)
    y = np.empty_like(x)
    y[0] = x[0]
    for k in range(1, len(x)):
        y[k] = keep[k] * y[k - 1] + (1 - keep[k]) * 0.5 * (x[k] + x[k - 1])
    return y


def two_in_a_gas(
    seed: int,
    taus_s: tuple[float, float],
    dt_s: float,
    n: int,
    noise_K: tuple[float, float],
    step: float = 1.0,
    slow_s: tuple[float, ...] = (0.1, 1.0),
    fine: int = 4,
) -> tuple[Array, Array, Array, Array]:
    """Time (N,) [s], two readings [degC] and the speed, which steps from 1 to ``step`` half way;
    lags go as its root.

    The gas swings at random with these time constants.
    """
    rng = np.random.default_rng(seed)
    h = dt_s / fine
    x = np.full(n * fine, 300.0)
    for tau, size in zip(slow_s, (6.0, 20.0)):
        keep = np.exp(-h / tau)
        x += lfilter([size * np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(n * fine))
    x = lagged(x, (0.02,), h)
    speed = np.where(np.arange(n * fine) < n * fine // 2, 1.0, step)
    read = [
        varying(x, tau / np.sqrt(speed), h)[::fine] + sd * rng.standard_normal(n)
        for tau, sd in zip(taus_s, noise_K)
    ]
    return np.arange(n) * dt_s, read[0], read[1], speed[::fine]


def fluctuating(
    seed: int, taus_s: tuple[float, ...], dt_s: float, n: int, logger_K: float
) -> tuple[Array, Array]:
    """Time and reading of a sensor in a fluid whose fluctuations are white; ``logger_K`` over the
    reading's own 1 K."""
    rng = np.random.default_rng(seed)
    lead = int(20 * sum(taus_s) / dt_s) * FINE
    x = lagged(rng.standard_normal(lead + n * FINE), taus_s, dt_s / FINE)[lead::FINE]
    return np.arange(n) * dt_s, 50 + x / np.std(x) + logger_K * rng.standard_normal(len(x))[:n]


SHELLS = 60


@dataclass(frozen=True)
class Sheath:
    """A round sensor of shells: powder inside a metal wall, a film outside; heat by a current in
    the innermost part.

    ``step`` (n, n): what one ``dt_s`` makes of the shells' temperatures over the fluid's;
    ``warmed`` (n,): what one of full current adds. Dimensionless: the powder's conductivity and
    heat capacity and the radius are 1.
    """

    step: Array
    warmed: Array
    dt_s: float
    lag_s: float
    read: int

    @classmethod
    def drawn(cls, rng: np.random.Generator, gap: float = 0.0) -> Sheath:
        """Wall 10 to 25 % of the radius, 5 to 20 times the conductivity; Bi 0.5 to 10; heater
        within 5 to 30 %.

        ``gap``: a thermal resistance between powder and wall, in radii over the powder's
        conductivity.
        """
        edge = np.linspace(0, 1, SHELLS + 1)
        middle, wall = 0.5 * (edge[1:] + edge[:-1]), 1 - rng.uniform(0.1, 0.25)
        k = np.where(middle > wall, rng.uniform(5, 20), 1.0)
        heat = np.where(middle > wall, rng.uniform(1.0, 1.6), 1.0) * (
            edge[1:] ** 2 - edge[:-1] ** 2
        )
        between = 2 * edge[1:-1] / (np.diff(edge)[1:] / k[1:] / 2 + np.diff(edge)[:-1] / k[:-1] / 2)
        at = int(np.argmax(middle > wall)) - 1
        between[at] = 1 / (1 / between[at] + gap / (2 * edge[at + 1]))
        out = 2.0 / (
            1 / np.exp(rng.uniform(np.log(0.5), np.log(10.0))) + np.diff(edge)[-1] / k[-1] / 2
        )
        a = np.zeros((SHELLS, SHELLS))
        for i, g in enumerate(between):
            a[i, i] -= g
            a[i + 1, i + 1] -= g
            a[i, i + 1] += g
            a[i + 1, i] += g
        a[-1, -1] -= out
        a /= heat[:, None]
        made = np.where(middle < rng.uniform(0.05, 0.3), edge[1:] ** 2 - edge[:-1] ** 2, 0.0) / heat
        lag = float(
            np.linalg.solve(-a, np.ones(SHELLS))[0]
        )  # integral of what a plunge leaves at the middle
        dt = lag / 60
        step = expm(a * dt)
        return cls(step, np.linalg.solve(a, (step - np.eye(SHELLS)) @ made), dt, lag, 0)

    def heated(self, rng: np.random.Generator, noise: float) -> tuple[Array, Array, Array]:
        """Time, reading [K over the fluid] and heating of a current switched on and off; noise over
        the heating."""
        n = 1200
        power = np.where((np.arange(n) > 60) & (np.arange(n) < 620), 1.0, 0.0)
        x, y = np.zeros(SHELLS), np.zeros(n)
        for i in range(1, n):
            x = self.step @ x + self.warmed * power[i - 1]
            y[i] = x[self.read]
        y = 10 * y / y.max()
        return np.arange(n) * self.dt_s, y + 10 * noise * rng.standard_normal(n), power
