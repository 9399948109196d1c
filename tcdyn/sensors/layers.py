"""Conduction along the radius of layered cylinders by finite elements: time constants and shares.

Many cylinders of one arrangement are solved at once. ``tcdyn.sensors.construction`` draws them.
``tests/sensors/test_predict.py`` compares with the series of a homogeneous cylinder, with the order
of convergence, and with finite volumes that share no code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array

BISECTIONS = 50  # of the search for a time: to rounding error


@dataclass(frozen=True)
class Layer:
    """One material of many cylinders (B,).

    Attributes
    ----------
    outer_m
        Outer radius [m].
    k_W_mK
        Conductivity [W/mK].
    heat_J_m3K
        Volumetric heat capacity [J/m3K].
    elements
        Number of elements along the radius.
    contact_m2K_W
        Resistance between this layer and the next one, per area of its outer surface [m2K/W].
    inner_m
        Inner radius [m], where it is not the outer radius of the layer before.
    """

    outer_m: Array
    k_W_mK: Array
    heat_J_m3K: Array
    elements: int
    contact_m2K_W: Array | None = None
    inner_m: Array | None = None


@dataclass(frozen=True)
class Responses:
    """Responses of many sensors to a step of the medium: sums of first-order lags.

    Attributes
    ----------
    taus_s
        Time constants (B, M) [s].
    shares
        Shares (B, M) of the step, with sum one.
    film_s
        Part of the lag (B,) that the surface coefficient makes: heat capacity over h and area [s].
    """

    taus_s: Array
    shares: Array
    film_s: Array

    @property
    def lags_s(self) -> Array:
        """First moments (B,) of the responses [s]."""
        return np.asarray(np.sum(self.shares * self.taus_s, axis=1))

    def step(self, time_s: Array) -> Array:
        """Responses (B,), each at its time (B,) [s] after the step."""
        remaining = np.exp(-time_s[:, None] / self.taus_s)
        return np.asarray(1 - np.sum(self.shares * remaining, axis=1))

    def times_s(self, share: float) -> Array:
        """Times (B,) at which the responses pass a share of the step [s]."""
        low = np.zeros(len(self.taus_s))
        high = 20 * self.taus_s.max(axis=1)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            is_below = self.step(middle) < share
            low = np.where(is_below, middle, low)
            high = np.where(is_below, high, middle)
        return 0.5 * (low + high)

    def at_Hz(self, frequency_Hz: float) -> NDArray[np.complex128]:
        """Complex amplitudes (B,) of the reading over that of the medium."""
        factor = 1 / (1 + 2j * np.pi * frequency_Hz * self.taus_s)
        return np.asarray(np.sum(self.shares * factor, axis=1))


def layered_responses(
    layers: Sequence[Layer], h_W_m2K: Array, core_share: Array | float = 1.0
) -> Responses:
    """Responses of cylinders of some layers, from the axis outward, in a medium.

    Parameters
    ----------
    layers
        The layers; the first is the core.
    h_W_m2K
        Coefficient (B,) at the outermost surface.
    core_share
        Share of the mean of the core in the reading; the rest is the inner surface of the third
        layer, the sheath.

    Returns
    -------
    Responses
        Time constants and shares.

    Notes
    -----
    rho c dT/dt = (1/r) d/dr (k r dT/dr), with h (T_medium - T) at the surface, by Galerkin's method
    with linear elements in r: M dT/dt + K T = b T_medium. The matrices are exact integrals over the
    elements. Modes are those of K v = lambda M v. A contact is a resistance between two nodes of
    one radius.

    Heat that enters all of the sensor passes the surface: the part of the lag by h is the heat
    capacity over h and the area, wherever the temperature is read.

    Examples
    --------
    >>> one = np.ones(1)
    >>> wire = Layer(1e-3 * one, 30.0 * one, 3.8e6 * one, 6)
    >>> layered_responses([wire], 10.0 * one).lags_s.round(1)  # rho c r / (2 h) and the inside
    array([190.])
    """
    count = len(h_W_m2K)
    nodes = sum(layer.elements + 1 for layer in layers)
    mass = np.zeros((count, nodes, nodes))
    stiffness = np.zeros((count, nodes, nodes))
    core = np.zeros((count, nodes))
    inner = np.zeros(count)
    first = 0
    sheath_node = 0
    for number, layer in enumerate(layers):
        if layer.inner_m is not None:
            inner = layer.inner_m
        width = (layer.outer_m - inner) / layer.elements
        if number == 2:
            sheath_node = first
        for i in range(first, first + layer.elements):
            low = inner + (i - first) * width
            high = low + width
            area = width / 12 * np.stack([3 * low + high, low + high, low + 3 * high])
            flow = layer.k_W_mK * 0.5 * (low + high) / width
            for matrix, values in (
                (mass, layer.heat_J_m3K * area),
                (stiffness, np.stack([flow, -flow, flow])),
            ):
                matrix[:, i, i] += values[0]
                matrix[:, i, i + 1] += values[1]
                matrix[:, i + 1, i] += values[1]
                matrix[:, i + 1, i + 1] += values[2]
            if number == 0:
                core[:, i] += area[0] + area[1]
                core[:, i + 1] += area[1] + area[2]
        last = first + layer.elements
        if number < len(layers) - 1:
            contact = layer.contact_m2K_W
            resistance = 1e-9 if contact is None else np.maximum(contact, 1e-9)  # 0: no jump
            flow = layer.outer_m / resistance
            stiffness[:, last, last] += flow
            stiffness[:, last, last + 1] -= flow
            stiffness[:, last + 1, last] -= flow
            stiffness[:, last + 1, last + 1] += flow
        inner = layer.outer_m
        first = last + 1
    stiffness[:, -1, -1] += h_W_m2K * inner
    read = core / core.sum(axis=1, keepdims=True)
    if len(layers) > 2:
        share = np.broadcast_to(core_share, (count,))
        read *= share[:, None]
        read[:, sheath_node] += 1 - share
    factor = np.linalg.cholesky(mass)
    half = np.linalg.solve(factor, stiffness)
    symmetric = np.linalg.solve(factor, np.swapaxes(half, 1, 2))
    rates, vectors = np.linalg.eigh(0.5 * (symmetric + np.swapaxes(symmetric, 1, 2)))
    modes = np.linalg.solve(np.swapaxes(factor, 1, 2), vectors)
    stored = np.sum(mass, axis=2)
    shares = np.einsum("bn,bnm->bm", read, modes) * np.einsum("bn,bnm->bm", stored, modes)
    film_s = stored.sum(axis=1) / (h_W_m2K * inner)
    return Responses(1 / rates, shares, film_s)
