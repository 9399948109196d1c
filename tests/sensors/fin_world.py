"""An exposed junction whose stem conducts heat along itself, by finite volumes along the axis.

A bead at the end of two wires, which after a free length may end in a thicker stem. All is in the
medium up to the depth of immersion, and beyond it in still air at the temperature of the start. The
response is the exact sum of the modes of the discretised rod, independent of the package.
Conduction across the rod is not modelled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.sensors.layered_world import MEDIA, LayeredSensor, surface_h

Array = NDArray[np.float64]
CELLS = 160
# Conductivity [W/mK] and heat capacity [J/m3K] of chromel, alumel, constantan, iron: the range
CONDUCTIVITY = (18.0, 60.0)
CAPACITY = (3.5e6, 4.3e6)
OUTSIDE_H = (15.0, 60.0)  # of a thin wire in still air [W/m2K]


def exposed_junction(
    bead_m: float,
    width: Array,
    diameter_m: Array,
    h: Array,
    is_immersed: Array,
    h_bead: float,
    conductivity: float,
    capacity: float,
) -> tuple[LayeredSensor, float]:
    """The sensor, normalised to its own final reading, and the share of the step that it reads.

    Cells along the two wires (C,): width [m], diameter of each wire [m], surface coefficient
    [W/m2K], and whether it is in the medium.
    """
    section = 2 * np.pi * diameter_m**2 / 4
    surface = 2 * np.pi * diameter_m * width
    stored = np.r_[capacity * np.pi / 6 * bead_m**3, capacity * section * width]
    film = np.r_[h_bead * np.pi * bead_m**2, surface * h]
    driven = film * np.r_[1.0, is_immersed]
    half = 0.5 * width / (conductivity * section)
    along = 1 / (half + np.append(0.0, half[:-1]))
    matrix = np.diag(film + np.append(along, 0.0) + np.append(0.0, along))
    matrix -= np.diag(along, 1) + np.diag(along, -1)
    root = np.sqrt(stored)
    rates, modes = np.linalg.eigh(matrix / np.outer(root, root))
    shares = modes[0] / root[0] * ((driven / root) @ modes) / rates
    gain = float(shares.sum())
    return LayeredSensor(1 / rates, shares / gain, np.zeros_like(shares)), gain


def drawn_junction(rng: np.random.Generator, medium: str) -> tuple[LayeredSensor, float]:
    """Wires of 0.2 to 1.5 mm, immersed by 8 to 60 mm; half of them end in a thicker stem.

    The free length is 4 to 15 diameters of the wire, the stem 2.5 to 5 times as thick.
    """
    wire_m = float(np.exp(rng.uniform(np.log(0.2e-3), np.log(1.5e-3))))
    bead_m = wire_m * rng.uniform(1.2, 2.5)
    speed = float(np.exp(rng.uniform(*np.log(MEDIA[medium][3:]))))
    depth_m = float(np.exp(rng.uniform(np.log(8e-3), np.log(60e-3))))
    outside_m = rng.uniform(0.05, 0.2)
    ends_m = np.r_[np.linspace(0, depth_m, CELLS + 1), depth_m + np.linspace(0, outside_m, CELLS)]
    edges = np.unique(ends_m)
    width = np.diff(edges)
    middle = edges[1:] - width / 2
    free_m = wire_m * rng.uniform(4, 15)
    stem_m = wire_m * rng.uniform(2.5, 5) if rng.random() < 0.5 else wire_m
    diameter_m = np.where(middle < free_m, wire_m, stem_m)
    is_immersed = middle < depth_m
    h_of = {d: surface_h(medium, d, speed) for d in (wire_m, stem_m)}
    h_inside = np.where(middle < free_m, h_of[wire_m], h_of[stem_m])
    h = np.where(is_immersed, h_inside, rng.uniform(*OUTSIDE_H))
    h_bead = surface_h(medium, bead_m, speed)
    conductivity = rng.uniform(*CONDUCTIVITY)
    capacity = rng.uniform(*CAPACITY)
    return exposed_junction(
        bead_m, width, diameter_m, h, is_immersed, h_bead, conductivity, capacity
    )
