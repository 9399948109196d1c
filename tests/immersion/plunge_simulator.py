"""An independent simulation of many plunges at once: explicit finite volumes, with its own fluid
and correlation.

Independent of the code of the fit: Heun steps in time, 45 cells from bore to surface, the chain
step by step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

CELLS = 45
STEPS_PER_SAMPLE = 3
RATE_Hz = 75.0
DEPTHS_m = np.array([3.0, 6.0, 3.0, 6.0, 1.25, 6.0]) * 1e-3
R_IN = 0.0205
R_OUT = 0.0381
WIDTH = 0.00953
RHO_C = 7850.0 * 470.0
K_STEEL = 41.0


def oil_h(wall: np.ndarray, bulk: np.ndarray) -> np.ndarray:
    """Churchill and Chu (5.4) in Mobil Jet Oil II; Walther's constants as printed in ANCHORS.md."""
    film_degC = (wall + bulk) / 2
    nu = (10**10 ** (9.31259 - 3.66650 * np.log10(film_degC + 273.15)) - 0.7) * 1e-6
    rho = 1003.5 - 0.7 * (film_degC - 15)
    k = 0.14868 - 2.2275e-4 * (film_degC + 273.15 - 366.67)
    diffusivity = k / (rho * 2000.0)
    ra = 9.80665 * (0.7 / rho) * np.abs(bulk - wall) * WIDTH**3 / (nu * diffusivity)
    return (
        k
        / WIDTH
        * (0.68 + 0.670 * ra**0.25 / (1 + (0.492 * diffusivity / nu) ** (9 / 16)) ** (4 / 9))
    )


@dataclass
class Draws:
    """True values of M plunges; arrays (M,) or, per channel, (M, 6)."""

    bath: np.ndarray
    initial: np.ndarray
    h_scale: np.ndarray
    exponent: np.ndarray
    burst: np.ndarray
    burst_time: np.ndarray
    burst_shape: np.ndarray
    conductivity: np.ndarray
    depth: np.ndarray
    tau1: np.ndarray
    tau2: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    noise: float = 0.12


def draw_pairs(
    rng: np.random.Generator, pairs: int, baths: tuple[float, float] = (110.0, 138.0)
) -> Draws:
    """Pairs of plunges of one disk each, sampled from the priors of ``PlungePriors()``; lags of
    0.3 to 1 s."""
    m = 2 * pairs

    def per_disk(values: np.ndarray) -> np.ndarray:
        return np.repeat(values, 2, axis=0)

    lag = per_disk(rng.uniform(0.3, 1.0, pairs)[:, None] + 0.04 * rng.standard_normal((pairs, 6)))
    logit = 1.5 * rng.standard_normal((pairs, 1)) + 0.7 * rng.standard_normal((pairs, 6))
    root = np.sqrt(1 - 1 / (1 + np.exp(-per_disk(logit))))
    return Draws(
        bath=np.tile(baths, pairs).astype(float),
        initial=26 + rng.standard_normal(m),
        h_scale=np.exp(0.10 * rng.standard_normal(m)),
        exponent=0.02 * rng.standard_normal(m),
        burst=1.5 * np.exp(0.7 * rng.standard_normal(m)),
        burst_time=1.2 * np.exp(0.5 * rng.standard_normal(m)),
        burst_shape=np.exp(0.3 * rng.standard_normal(m)),
        conductivity=per_disk(K_STEEL * np.exp(0.03 * rng.standard_normal(pairs))),
        depth=per_disk(DEPTHS_m + 1e-4 * rng.standard_normal((pairs, 6))),
        tau1=lag * (1 + root) / 2,
        tau2=lag * (1 - root) / 2,
        offset=per_disk(0.05 * rng.standard_normal((pairs, 6))),
        gain=per_disk(1 + 5e-4 * rng.standard_normal((pairs, 6))),
    )


def same_pairs(pairs: int, lag: float = 0.65, baths: tuple[float, float] = (110.0, 138.0)) -> Draws:
    """Identical pairs at the middle of the priors; they differ only by noise."""
    m = 2 * pairs
    ones = np.ones(m)
    channel_ones = np.ones((m, 6))
    root = np.sqrt(0.5)
    return Draws(
        np.tile(baths, pairs).astype(float),
        26 * ones,
        ones,
        0 * ones,
        1.5 * ones,
        1.2 * ones,
        ones,
        K_STEEL * ones,
        DEPTHS_m * channel_ones,
        lag * (1 + root) / 2 * channel_ones,
        lag * (1 - root) / 2 * channel_ones,
        0 * channel_ones,
        channel_ones,
    )


def lag_update(
    state: np.ndarray, old: np.ndarray, new: np.ndarray, tau: np.ndarray, dt: float
) -> np.ndarray:
    """One step of a first-order lag whose input is linear."""
    e = np.exp(-dt / tau)
    slope = (new - old) / dt
    return new - slope * tau + (state - old + slope * tau) * e


def simulate(
    d: Draws,
    after_s: float,
    rng: np.random.Generator,
    before_s: float = 8.0,
    h_of: Callable = oil_h,
) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) after entry and readings (N, M, 6) of every plunge, noise added; entry at time 0.

    ``h_of(wall, bulk)`` [degC] is h of natural convection [W/m2K] of every plunge (M,).
    """
    m = len(d.bath)
    dt = 1 / (RATE_Hz * STEPS_PER_SAMPLE)
    faces = np.linspace(R_IN, R_OUT, CELLS + 1)
    centres = (faces[1:] + faces[:-1]) / 2
    dr = faces[1] - faces[0]
    volume = (faces[1:] ** 2 - faces[:-1] ** 2)[:, None] / 2
    conductance = faces[1:-1, None] / dr * d.conductivity
    gap0 = np.abs(d.bath - d.initial)

    def surface_flux(outer: np.ndarray, t: float) -> np.ndarray:
        wall = outer
        for _ in range(2):
            gap = d.bath - wall
            h = h_of(wall, d.bath) * d.h_scale * (np.abs(gap) / gap0) ** d.exponent
            h = h * (1 + d.burst * np.exp(-((t / d.burst_time) ** d.burst_shape)))
            wall = (outer + h * d.bath * dr / (2 * d.conductivity)) / (
                1 + h * dr / (2 * d.conductivity)
            )
        return h * (d.bath - wall)

    def rate(T: np.ndarray, t: float) -> np.ndarray:
        flow = np.zeros((CELLS + 1, m))
        flow[1:-1] = conductance * (T[:-1] - T[1:])
        flow[-1] = -R_OUT * surface_flux(T[-1], t)
        return (flow[:-1] - flow[1:]) / (RHO_C * volume)

    position = (R_OUT - d.depth - centres[0]) / dr
    index = np.clip(position.astype(int), 0, CELLS - 2)
    weight = position - index
    rows = np.arange(m)[:, None]
    T = np.tile(d.initial, (CELLS, 1))
    x = np.repeat(d.initial[:, None], 6, axis=1)
    a = x.copy()
    b = x.copy()
    c1 = x.copy()
    c2 = x.copy()
    wc = np.full((m, 6), 1 / (2 * np.pi * 4.0))
    steps = int(after_s * RATE_Hz) * STEPS_PER_SAMPLE
    out = np.empty(
        (int(before_s * RATE_Hz) + steps // STEPS_PER_SAMPLE + 1, m, 6), dtype=np.float32
    )
    first = int(before_s * RATE_Hz)
    out[: first + 1] = c2
    for k in range(steps):
        t = k * dt
        k1 = rate(T, t)
        T = T + dt / 2 * (k1 + rate(T + dt * k1, t + dt))
        new = (1 - weight) * T[index, rows] + weight * T[index + 1, rows]
        old_a = a
        old_b = b
        old_c1 = c1
        a = lag_update(a, x, new, d.tau1, dt)
        b = lag_update(b, old_a, a, np.maximum(d.tau2, 1e-5), dt)
        c1 = lag_update(c1, old_b, b, wc, dt)
        c2 = lag_update(c2, old_c1, c1, wc, dt)
        x = new
        if (k + 1) % STEPS_PER_SAMPLE == 0:
            out[first + (k + 1) // STEPS_PER_SAMPLE] = c2
    times = (np.arange(len(out)) - first) / RATE_Hz
    readings = (out - d.offset) / d.gain if np.any(d.gain != 1) or np.any(d.offset) else out
    return times, readings + d.noise * rng.standard_normal(out.shape)
