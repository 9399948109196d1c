"""Finite volumes for a whole disk with its shaft: mesh, conductances, junction interpolation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tcdyn.rig.truth import DiskTruth

Array = NDArray[np.float64]
SHAFT_LENGTH_m = 0.12  # free length to the bearing on each side (assumed)
SHAFT_SECTION = 0.85  # share of a solid section: the shaft is bored for its wires (assumed)


@dataclass(frozen=True)
class DiskMesh:
    """Cells in r (bore to surface) and z (face d to face f), finer towards the surface; shaft cells along z."""

    radial: int = 64
    axial: int = 80
    surface_cell_m: float = 0.06e-3
    shaft_side: int = 40


@dataclass(frozen=True)
class DiskSystem:
    """C dT/dt = -S T + source_power P + source_ambient T_A + source_const; readings are ``sample @ T``.

    ``P`` [W] is the heat that enters the running track; the unknowns are the disk's cells (r slow, z fast), then the
    shaft's. ``capacity`` [J/K], ``conductance`` S [W/K], ``sample`` (channels, unknowns) in the order of ``channels``.
    """

    capacity: Array
    conductance: sparse.csc_matrix
    source_power: Array
    source_ambient: Array
    source_const: Array
    sample: sparse.csr_matrix
    channels: tuple[str, ...]


def graded_edges(start: float, end: float, first: float, count: int) -> Array:
    """``count`` cells from ``start`` to ``end`` whose size grows geometrically from ``first`` at the start."""
    length = abs(end - start)
    first = min(first, length / count)
    low, high = 1.0, 3.0
    for _ in range(80):
        ratio = 0.5 * (low + high)
        total = first * (ratio**count - 1) / (ratio - 1) if ratio > 1 + 1e-12 else first * count
        low, high = (ratio, high) if total < length else (low, ratio)
    steps = ratio ** np.arange(count)
    return start + np.sign(end - start) * length * np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])


def hertz_shares(edges: Array, half_width_m: float) -> Array:
    """Share of a parabolic track's heat that falls into each cell, by its exact integral; sums to one."""
    x = np.clip((edges - 0.5 * (edges[0] + edges[-1])) / half_width_m, -1.0, 1.0)
    return np.asarray(np.diff(0.75 * (x - x**3 / 3.0)))


def build_system(disk: DiskTruth, h_W_m2K: float, half_width_m: float, mesh: DiskMesh) -> DiskSystem:
    """Assemble the whole disk, bore to running surface, with washers, shaft and cooled running surface.

    ``half_width_m`` is half the width of the running track; conduction between neighbouring cells uses the exact
    logarithmic resistance in r. Washer faces and the running surface lose heat to ambient through half a cell of steel.
    """
    s = disk.setup
    k, rho_c = s.conductivity_W_mK, s.density_kg_m3 * s.specific_heat_J_kgK
    r_edges = graded_edges(s.outer_radius_m, s.bore_radius_m, mesh.surface_cell_m, mesh.radial)[::-1]
    z_edges = np.linspace(0.0, s.width_m, mesh.axial + 1)
    r, z = 0.5 * (r_edges[1:] + r_edges[:-1]), 0.5 * (z_edges[1:] + z_edges[:-1])
    dr, dz = np.diff(r_edges), np.diff(z_edges)
    nr, nz = len(r), len(z)
    face_area = np.pi * np.diff(r_edges**2)  # of one cell, seen along z
    zs_edges, first = _shaft_edges(s.width_m, z_edges, mesh.shaft_side)
    ns = len(zs_edges) - 1
    n = nr * nz + ns
    index = np.arange(nr * nz).reshape(nr, nz)
    shaft = nr * nz + np.arange(ns)

    links: list[tuple[Array, Array, Array]] = []
    g_r = 2 * np.pi * k * dz[None, :] / np.log(r[1:] / r[:-1])[:, None]
    links.append((index[:-1], index[1:], g_r))
    g_z = k * face_area[:, None] / (0.5 * (dz[1:] + dz[:-1]))[None, :]
    links.append((index[:, :-1], index[:, 1:], g_z))
    bore_area = 2 * np.pi * s.bore_radius_m * dz
    bore_resistance = 1 / (disk.bore_conductance_W_m2K * bore_area) + np.log(r[0] / s.bore_radius_m) / (
        2 * np.pi * k * dz
    )
    under = shaft[first : first + nz]
    links.append((index[0], under, 1 / bore_resistance))
    section = SHAFT_SECTION * np.pi * s.bore_radius_m**2
    dzs = np.diff(zs_edges)
    links.append((shaft[:-1], shaft[1:], k * section / (0.5 * (dzs[1:] + dzs[:-1]))))

    ambient = np.zeros(n)
    surface = 1 / (1 / h_W_m2K + np.log(s.outer_radius_m / r[-1]) * s.outer_radius_m / k) if h_W_m2K > 0 else 0.0
    ambient[index[-1]] += surface * 2 * np.pi * s.outer_radius_m * dz
    if s.washer_W_m2K > 0:
        ambient[index[:, 0]] += face_area / (1 / s.washer_W_m2K + 0.5 * dz[0] / k)
        ambient[index[:, -1]] += face_area / (1 / s.washer_W_m2K + 0.5 * dz[-1] / k)
    outside = np.ones(ns, dtype=bool)
    outside[first : first + nz] = False
    ambient[shaft[outside]] += disk.shaft_W_m2K * 2 * np.pi * s.bore_radius_m * dzs[outside]
    ends = np.zeros(n)
    ends[[shaft[0], shaft[-1]]] = k * section / (0.5 * dzs[[0, -1]])
    constant = np.zeros(n)
    constant[[shaft[0], shaft[-1]]] = ends[[shaft[0], shaft[-1]]] * np.asarray(disk.bearing_offset_K)

    power = np.zeros(n)
    power[index[-1]] = hertz_shares(z_edges, half_width_m)
    # Heat enters at the surface itself; half a cell of steel lets part of it leave again to ambient.
    if h_W_m2K > 0:
        power *= 1 - surface * np.log(s.outer_radius_m / r[-1]) * s.outer_radius_m / k
    capacity = np.concatenate([rho_c * (face_area[:, None] * dz[None, :]).ravel(), rho_c * section * dzs])
    return DiskSystem(
        capacity=capacity,
        conductance=_laplacian(links, ambient + ends, n),
        source_power=power,
        source_ambient=ambient + ends,
        source_const=constant,
        sample=_sampler(disk, r, z, n),
        channels=tuple(sorted(s.junctions)),
    )


def _shaft_edges(width: float, z_edges: Array, side: int) -> tuple[Array, int]:
    first = float(z_edges[1] - z_edges[0])
    right = graded_edges(width, width + SHAFT_LENGTH_m, first, side)
    left = (width - right)[::-1]
    return np.concatenate([left[:-1], z_edges, right[1:]]), side


def _laplacian(links: list[tuple[Array, Array, Array]], to_ground: Array, n: int) -> sparse.csc_matrix:
    i = np.concatenate([np.ravel(a) for a, _, _ in links]).astype(int)
    j = np.concatenate([np.ravel(b) for _, b, _ in links]).astype(int)
    g = np.concatenate([np.ravel(c) for _, _, c in links])
    own = np.arange(n)
    rows = np.concatenate([i, j, i, j, own])
    cols = np.concatenate([j, i, i, j, own])
    return sparse.csc_matrix((np.concatenate([-g, -g, g, g, to_ground]), (rows, cols)), shape=(n, n))


def _sampler(disk: DiskTruth, r: Array, z: Array, n: int) -> sparse.csr_matrix:
    """Cubic interpolation in r and z from cell centres to each junction."""
    rows, cols, values = [], [], []
    for row, name in enumerate(sorted(disk.setup.junctions)):
        junction = disk.setup.junctions[name]
        ir, wr = cubic_weights(r, disk.setup.outer_radius_m - junction.depth_m)
        iz, wz = cubic_weights(z, junction.z_m)
        for a, weight_r in zip(ir, wr):
            for b, weight_z in zip(iz, wz):
                rows.append(row)
                cols.append(a * len(z) + b)
                values.append(weight_r * weight_z)
    return sparse.csr_matrix((values, (rows, cols)), shape=(len(disk.setup.junctions), n))


def cubic_weights(x: Array, at: float) -> tuple[NDArray[np.int64], Array]:
    """Indices of the four nearest nodes and Lagrange's weights of their values at ``at``."""
    start = int(np.clip(np.searchsorted(x, at) - 2, 0, len(x) - 4))
    nodes = x[start : start + 4]
    weights = [np.prod([(at - nodes[j]) / (nodes[i] - nodes[j]) for j in range(4) if j != i]) for i in range(4)]
    return np.arange(start, start + 4), np.array(weights)
