"""Sheathed thermocouples by finite volumes along the radius, independent of the package.

A core (wires and junction, whose mean temperature is the reading), mineral insulation, a gas gap in
half of the sensors, a steel sheath, and a medium with a surface coefficient. The response is the
exact sum of the modes of the discretised sensor; an optional stem adds one slow mode. The heated
core has the same modes with other shares. Axial conduction is not modelled.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.optimize import brentq
from scipy.signal import lfilter

Array = NDArray[np.float64]
SHARES = (0.5, 1 - np.exp(-1), 0.9)
MEDIUM_S = (0.02, 0.02)  # documented prior of the time in which the medium passes the sensor
# Volumetric heat capacities [J/m3K] and conductivities [W/mK] of core, insulation and sheath.
CAPACITY = (3.8e6, 2.7e6, 3.9e6)
CORE_K, SHEATH_K, AIR_K = 30.0, 15.0, 0.03
CELLS = (8, 32, 12)
# Conductivity [W/mK], viscosity [m2/s], Prandtl number, least and largest speed [m/s].
MEDIA = {
    "water": (0.60, 1.0e-6, 7.0, 0.02, 2.0),
    "oil": (0.13, 2.0e-5, 250.0, 0.005, 0.5),
    "air": (0.026, 1.6e-5, 0.7, 0.2, 10.0),
}
# Hilpert's cylinder in cross flow, Nu = C Re^m Pr^(1/3): upper limit of Re, C, m.
HILPERT = (
    (4.0, 0.989, 0.330),
    (40.0, 0.911, 0.385),
    (4e3, 0.683, 0.466),
    (4e4, 0.193, 0.618),
    (np.inf, 0.027, 0.805),
)


def surface_h(medium: str, diameter_m: float, speed_m_s: float) -> float:
    """Return the surface coefficient [W/m2K] of a cylinder in cross flow."""
    k, viscosity, prandtl, _, _ = MEDIA[medium]
    reynolds = speed_m_s * diameter_m / viscosity
    factor, power = next((c, m) for limit, c, m in HILPERT if reynolds < limit)
    return float(factor * reynolds**power * prandtl ** (1 / 3) * k / diameter_m)


@dataclass(frozen=True)
class LayeredSensor:
    """A sensor as a sum of modes.

    ``taus_s``, ``shares`` and ``heated`` (M,): time constants, and shares of each mode in the
    response to a step of the medium and to heating of the core, each of sum one.
    """

    taus_s: Array = field(repr=False)
    shares: Array = field(repr=False)
    heated: Array = field(repr=False)
    medium: str = ""
    diameter_m: float = 0.0
    speed_m_s: float = 0.0
    gap_m: float = 0.0
    biot: float = 0.0

    @property
    def lag_s(self) -> float:
        """First moment of the response to a step of the medium [s]."""
        return float(self.shares @ self.taus_s)

    def step(self, time_s: Array | float, medium_s: float = 0.0) -> Array:
        """Response (N,) to a medium that goes from zero to one with its own time constant."""
        t = np.maximum(np.atleast_1d(time_s), 0.0)[:, None]
        remaining = np.exp(-t / self.taus_s)
        if medium_s > 0:
            medium = medium_s * np.exp(-t / medium_s)
            remaining = (self.taus_s * remaining - medium) / (self.taus_s - medium_s)
        return 1 - remaining @ self.shares

    def times_s(self) -> list[float]:
        """Times to 50, 63.2 and 90 % of a step [s]."""
        end = 20 * float(self.taus_s.max())
        return [brentq(lambda t, q=q: self.step(t)[0] - q, 0.0, end) for q in SHARES]

    def truth(self) -> list[float]:
        """Lag, t50, t63.2 and t90 [s]."""
        return [self.lag_s, *self.times_s()]

    def follow(self, x: Array, dt_s: float) -> Array:
        """Reading (N,) in a medium of temperature ``x`` (N,), linear between rows, in balance at
        first."""
        y = np.zeros_like(x)
        for tau, share in zip(self.taus_s, self.shares):
            ratio = dt_s / tau
            keep = np.exp(-ratio)
            mean = (1 - keep) / ratio  # of the decay over a row
            coefficients = [1 - mean, mean - keep]
            y += share * lfilter(coefficients, [1, -keep], x, zi=[x[0] * mean])[0]
        return y

    def heat(self, power: Array, dt_s: float) -> Array:
        """Rise (N,) of the reading by heating ``power`` (N,), constant from each row to the next.

        It is steady at first, and ``power`` where the heating is steady.
        """
        y = np.zeros_like(power)
        for tau, share in zip(self.taus_s, self.heated):
            keep = np.exp(-dt_s / tau)
            y += share * lfilter([0, 1 - keep], [1, -keep], power, zi=[power[0]])[0]
        return y

    def with_stem(self, share: float, tau_s: float) -> LayeredSensor:
        """The sensor with a slow path alongside, which carries this share of a step."""
        return replace(
            self,
            taus_s=np.append(self.taus_s, tau_s),
            shares=np.append((1 - share) * self.shares, share),
            heated=np.append(self.heated, 0.0),
        )


def layered(
    diameter_m: float,
    core: float,
    wall: float,
    k_insulation: float,
    h_W_m2K: float,
    gap_m: float = 0.0,
    *,
    k_core: float = CORE_K,
    k_sheath: float = SHEATH_K,
    capacity: tuple[float, float, float] = CAPACITY,
    refine: int = 1,
    at_sheath: bool = False,
) -> LayeredSensor:
    """Sensor of a core and a wall of these shares of the diameter; ``refine``: factor of the cells.

    The core is read, or ``at_sheath`` the innermost quarter of the sheath.

    See ``rings``; the resistance of the surface is 1/(h R).
    """
    stored, resistance, area = rings(
        diameter_m, core, wall, k_insulation, gap_m, k_core, k_sheath, capacity, refine
    )
    resistance[-1] += 1 / (h_W_m2K * diameter_m / 2)
    flow = 1 / resistance
    matrix = np.diag(flow + np.append(0.0, flow[:-1]))
    matrix -= np.diag(flow[:-1], 1) + np.diag(flow[:-1], -1)
    root = np.sqrt(stored)
    rates, modes = np.linalg.eigh(matrix / np.outer(root, root))
    in_core = np.arange(len(area)) < refine * CELLS[0]
    core_area = np.where(in_core, area, 0.0)
    is_read = in_core
    if at_sheath:
        ring = np.arange(len(area)) // refine - CELLS[0] - CELLS[1]
        is_read = (ring >= 0) & (ring < CELLS[2] // 4)
    read_area = np.where(is_read, area, 0.0)
    read = (read_area / read_area.sum() / root) @ modes
    shares = read * (root @ modes)
    heated = read * ((core_area / root) @ modes) / rates
    return LayeredSensor(1 / rates, shares, heated / heated.sum())


def rings(
    diameter_m: float,
    core: float,
    wall: float,
    k_insulation: float,
    gap_m: float = 0.0,
    k_core: float = CORE_K,
    k_sheath: float = SHEATH_K,
    capacity: tuple[float, float, float] = CAPACITY,
    refine: int = 1,
) -> tuple[Array, Array, Array]:
    """Capacity, resistance to the next ring, and area of each ring (C,); the last to the surface.

    Per radian and metre: the capacity of a ring is rho c (r2^2 - r1^2)/2, its resistance
    ln(r2/r1)/k, that of the gap gap/(k r).
    """
    radius = diameter_m / 2
    limits = (0.0, core * radius, (1 - 2 * wall) * radius, radius)
    edge, k, heat = [0.0], [], []
    for i, (cells, conductivity) in enumerate(zip(CELLS, (k_core, k_insulation, k_sheath))):
        cells = cells * refine
        edge += np.linspace(limits[i], limits[i + 1], cells + 1)[1:].tolist()
        k += [conductivity] * cells
        heat += [capacity[i]] * cells
    edges, conductivities = np.array(edge), np.array(k)
    area = np.diff(edges**2) / 2
    stored = np.array(heat) * area
    middle = (edges[1:] + edges[:-1]) / 2
    outer = np.log(edges[1:] / middle) / conductivities
    inner = np.log(middle[1:] / edges[1:-1]) / conductivities[1:]
    resistance = outer + np.append(inner, 0.0)
    at_wall = refine * (CELLS[0] + CELLS[1])
    resistance[at_wall - 1] += gap_m / (AIR_K * limits[2])
    return stored, resistance, area


def step_with_changing_film(
    stored: Array, resistance: Array, area: Array, radius_m: float, h: Array, dt_s: float
) -> Array:
    """Reading (N,) of the core after a step of the medium, by the trapezoidal rule in time.

    Parameters
    ----------
    stored, resistance, area
        As of ``rings``.
    radius_m
        Radius of the sensor [m].
    h
        Surface coefficient (N,) at the times [W/m2K]; zero before the step.
    dt_s
        Time step [s].
    """
    inside = 1 / resistance[:-1]
    inside_sum = np.append(inside, 0.0) + np.append(0.0, inside)
    is_core = np.arange(len(area)) < CELLS[0]
    weight = np.where(is_core, area, 0.0) / area[is_core].sum()
    temperature = np.zeros(len(stored))
    reading = np.zeros(len(h))
    rate = stored / dt_s
    for k in range(1, len(h)):
        middle_h = 0.5 * (h[k] + h[k - 1])
        outer = 1 / (resistance[-1] + 1 / (middle_h * radius_m)) if middle_h > 0 else 0.0
        loss = inside_sum.copy()
        loss[-1] += outer
        right = (rate - 0.5 * loss) * temperature
        right[:-1] += 0.5 * inside * temperature[1:]
        right[1:] += 0.5 * inside * temperature[:-1]
        right[-1] += outer
        bands = np.zeros((3, len(stored)))
        bands[0, 1:] = -0.5 * inside
        bands[1] = rate + 0.5 * loss
        bands[2, :-1] = -0.5 * inside
        temperature = solve_banded((1, 1), bands, right)
        reading[k] = weight @ temperature
    return reading


def drawn(
    rng: np.random.Generator,
    medium: str,
    *,
    diameter_m: float | None = None,
    speed_m_s: float | None = None,
    at_sheath: bool = False,
) -> LayeredSensor:
    """Sensor of 0.5 to 8 mm in this medium, drawn at random; half of them have a gap.

    The gap is 10 to 60 um, and no more than a fortieth of the diameter.
    """
    log_diameter = rng.uniform(np.log(0.5e-3), np.log(8e-3))
    d = float(np.exp(log_diameter)) if diameter_m is None else diameter_m
    log_speed = rng.uniform(*np.log(MEDIA[medium][3:]))
    speed = float(np.exp(log_speed)) if speed_m_s is None else speed_m_s
    gap = float(min(rng.uniform(10e-6, 60e-6), d / 40)) if rng.random() < 0.5 else 0.0
    h = surface_h(medium, d, speed)
    core, wall, k = rng.uniform(0.15, 0.35), rng.uniform(0.10, 0.16), rng.uniform(1.5, 5.0)
    made = layered(d, core, wall, k, h, gap, at_sheath=at_sheath)
    biot = h * d / 2 / k
    return replace(made, medium=medium, diameter_m=d, speed_m_s=speed, gap_m=gap, biot=biot)


@dataclass(frozen=True)
class PlungeRecord:
    """Record of a plunge: rows, the true entry and medium's lag, and the entry as the user knows
    it."""

    time_s: Array = field(repr=False)
    y_degC: Array = field(repr=False)
    true_entry_s: float
    true_medium_s: float
    entry_s: tuple[float, float] | None
    noise_K: float
    step_K: float


def plunge_record(
    sensor: LayeredSensor,
    rng: np.random.Generator,
    *,
    entry_known: bool = False,
    noise_K: float | None = None,
    least_dt_s: float = 0.01,
) -> PlungeRecord:
    """Record of a plunge in up to 100 Hz: 15 to 50 rows in t63.2, 6 to 12 t63.2 after the entry.

    The noise is 0.05 to 0.5 K, the step 50 to 80 K up or down. A known entry is known to 0.2 to one
    row.
    """
    rise_s = sensor.times_s()[1]
    dt = max(rise_s / rng.uniform(15, 50), least_dt_s)
    before_s = max(rng.uniform(0.5, 2.0) * rise_s, 20 * dt)
    entry = before_s + rng.uniform(0, dt)
    medium_s = abs(MEDIUM_S[0] + MEDIUM_S[1] * rng.standard_normal())
    n = int((entry + rng.uniform(6, 12) * rise_s) / dt)
    n = max(n, int(entry / dt) + 40)
    size = rng.uniform(50, 80) * rng.choice([-1.0, 1.0])
    sd = float(np.exp(rng.uniform(np.log(0.05), np.log(0.5)))) if noise_K is None else noise_K
    t = np.arange(n) * dt
    y = 60 + size * sensor.step(t - entry, medium_s) + sd * rng.standard_normal(n)
    u = rng.uniform(0.2, 1.0) * dt
    stated = (float(entry + u * rng.standard_normal()), float(u)) if entry_known else None
    return PlungeRecord(t, y, float(entry), medium_s, stated, sd, size)
