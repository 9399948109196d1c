"""The synthetic disk round its bore: where the press fit conducts unevenly, harmonics of the angle, coupled there.

With the bore's conductance h0 (1 + a cos(psi)), psi the angle from where the fit is best, the temperature is
T0 + T1 cos(psi) + T2 cos(2 psi); where keyways and patches are stated, sines come to it. Each T_n obeys conduction in
(r, z) with -n^2 T/r^2 added, in the disk and in the shaft under and beside it; they exchange heat where the conductance
makes products of their angles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tcdyn.core import Array
from tcdyn.simulate.mesh import (
    SHAFT_SECTION,
    DiskMesh,
    DiskSystem,
    Grid,
    build_system,
    disk_links,
    graded_edges,
    grid_of,
    laplacian,
    ring_links,
    to_ambient_W_K,
)
from tcdyn.simulate.steel import Steel
from tcdyn.simulate.truth import DiskTruth

Wall = tuple[NDArray[np.int64], NDArray[np.int64]]
Wave = tuple[int, Callable[[Array], Array]]

HARMONICS = (1, 2)
COSINES: tuple[Wave, ...] = tuple((n, np.cos) for n in HARMONICS)
SINES: tuple[Wave, ...] = tuple((n, np.sin) for n in HARMONICS)
SHAFT_CELLS = 8  # across the wall of the bored shaft, where the temperature differs round it
THIN_M = 0.2e-3  # its outermost cell, whose half counts as nothing
BESIDE = 10  # cells of the shaft on each side of the disk: what differs round it fades over half a radius
ROUND = 720  # angles of the means round the bore


def uneven_system(
    disk: DiskTruth, h_W_m2K: float, half_width_m: float, mesh: DiskMesh
) -> DiskSystem:
    """The disk of ``build_system``, with its harmonics where its bore contact is uneven.

    Rows of ``sample``: what each junction sees, in the order of ``channels``; then for an uneven disk the part of that
    by the first harmonic, by the second, and last the amplitude of the first at the depth and place of the rim's edge,
    of its cosine and, where keyways or patches are stated, of its sine."""
    even = build_system(disk, h_W_m2K, half_width_m, mesh)
    if disk.uneven.even:
        return even
    g = grid_of(disk, mesh)
    waves = waves_of(disk)
    size = g.size
    parts = [_harmonic(disk, g, n, h_W_m2K) for n, _ in waves]
    starts = np.cumsum([0, size, *(len(capacity) for capacity, _, _ in parts)])
    own = sparse.block_diag(
        [even.conductance, *(conductance for _, conductance, _ in parts)], format="csc"
    )
    walls = [(g.cells[0], g.under)] + [
        (at + g.cells[0], at + faces) for at, (_, _, faces) in zip(starts[1:], parts)
    ]
    whole = own + _coupling(disk, g, walls, int(starts[-1]))
    angles = np.deg2rad(
        [disk.setup.junctions[c].angle_deg - disk.uneven.angle_deg for c in even.channels]
    )
    at_cells = even.sample[:, : g.cells.size]
    seen = [sparse.csr_matrix(at_cells.multiply(wave(n * angles)[:, None])) for n, wave in waves]
    amplitude = at_cells[[even.channels.index(disk.setup.edge)]]
    rows = [[(0, even.sample), *enumerate(seen, start=1)]]
    rows += [[(k + 1, seen[k]) for k, (of, _) in enumerate(waves) if of == n] for n in HARMONICS]
    rows += [[(k + 1, amplitude)] for k, (of, _) in enumerate(waves) if of == 1]
    zeros = np.zeros(starts[-1] - size)
    return replace(
        even,
        capacity=np.concatenate([even.capacity, *(capacity for capacity, _, _ in parts)]),
        conductance=sparse.csc_matrix(whole),
        source_power=np.append(even.source_power, zeros),
        source_ambient=np.append(even.source_ambient, zeros),
        source_const=np.append(even.source_const, zeros),
        sample=sparse.vstack([_spread(row, starts) for row in rows], format="csr"),
        surface_m2=np.concatenate(
            [even.surface_m2, *(_half_surface(even, len(c)) for c, _, _ in parts)]
        ),
        surface_air_m2=np.append(even.surface_air_m2, zeros),
        track=np.append(even.track, zeros),
        steel=_steel_round(disk, g, even.steel, starts),
    )


def waves_of(disk: DiskTruth) -> tuple[Wave, ...]:
    """Number and shape of the disk's harmonics, about its fit's best angle, in the order of the unknowns."""
    if disk.uneven.even:
        return ()
    return COSINES + SINES if disk.uneven.sectors else COSINES


def _steel_round(disk: DiskTruth, g: Grid, even: Steel, starts: Array) -> Steel:
    """The steel of the disk in all unknowns: a harmonic conducts as the even part's temperature has it."""
    size = g.cells.size
    blocks = [even.conduction]
    for (n, _), (first, beyond) in zip(waves_of(disk), pairwise(starts[1:])):
        block = np.zeros(beyond - first)
        block[:size] = _round_W_K(disk.setup.conductivity_W_mK, n, g.r_edges, g.dz).ravel()
        blocks.append(0.5 * laplacian(disk_links(disk, g), block, len(block)))
    cells = np.stack([start + g.cells.ravel() for start in starts[:-1]])
    return Steel(even.slopes, sparse.csc_matrix(sparse.block_diag(blocks, format="csc")), cells)


def _round_W_K(conductivity_W_mK: float, n: int, edges: Array, dz: Array) -> Array:
    """What a cell's harmonic ``n`` loses to the cells beside it round the ring, (nr, nz) [W/K]."""
    return 2 * np.pi * conductivity_W_mK * n**2 * np.outer(np.log(edges[1:] / edges[:-1]), dz)


def _half_surface(even: DiskSystem, count: int) -> Array:
    """The running surface in the unknowns of a harmonic (count,), halved as all of it is; disk cells come first."""
    first = min(count, len(even.surface_m2))
    return np.append(0.5 * even.surface_m2[:first], np.zeros(count - first))


def seen_round(disk: DiskTruth, readings: Array) -> dict[str, Any]:
    """What the uneven contact of a disk makes of its junctions, from a row of ``uneven_system``'s readings [degC].

    ``amplitude_K`` of the first harmonic at the depth of b and ``angle_deg`` of its hottest side; ``first_K`` and
    ``second_K``: what each junction reads more by either harmonic. Zeros for an even disk.
    """
    names = sorted(disk.channels)
    contact = disk.uneven
    parts = readings[len(names) :] if not contact.even else np.zeros(2 * len(names) + 1)
    first, second, (cos, *sin) = np.split(parts, [len(names), 2 * len(names)])
    turned = np.rad2deg(np.arctan2(sum(sin), cos))
    return {
        "contact": {"amplitude": contact.amplitude, "angle_deg": contact.angle_deg},
        "amplitude_K": float(np.hypot(cos, sum(sin))),
        "angle_deg": float(contact.angle_deg + turned) % 360.0,
        "first_K": dict(zip(names, map(float, first))),
        "second_K": dict(zip(names, map(float, second))),
    }


def _spread(parts: list[tuple[int, sparse.csr_matrix]], starts: Array) -> sparse.csr_matrix:
    """Rows over all unknowns, each part at the first unknown of its harmonic."""
    total = 0
    for n, part in parts:
        part = part.tocoo()
        shape = (part.shape[0], int(starts[-1]))
        total = total + sparse.csr_matrix(
            (part.data, (part.row, part.col + int(starts[n]))), shape=shape
        )
    return sparse.csr_matrix(total)


def _harmonic(
    disk: DiskTruth, g: Grid, n: int, h_W_m2K: float
) -> tuple[Array, sparse.csc_matrix, NDArray[np.int64]]:
    """Capacity (M,) [J/K], conductance (M, M) [W/K] and the shaft's outer cells (nz,) of harmonic ``n``.

    The mean of cos^2 round the disk is a half, so all of it is half of what the whole ring would be.
    """
    s = disk.setup
    first = g.first_under - BESIDE
    beyond = g.first_under + len(g.z) + BESIDE
    k = s.conductivity_W_mK
    hollow = s.bore_radius_m * np.sqrt(1 - SHAFT_SECTION)
    r_edges = graded_edges(s.bore_radius_m, hollow, THIN_M, SHAFT_CELLS)[::-1]
    z_edges = g.shaft_edges[first : beyond + 1]
    cells = g.cells.size + np.arange(SHAFT_CELLS * (beyond - first)).reshape(SHAFT_CELLS, -1)
    r = 0.5 * (r_edges[1:] + r_edges[:-1])
    area = np.pi * np.diff(r_edges**2)
    links = disk_links(disk, g) + ring_links(cells, r, area, np.diff(z_edges), k)
    even = to_ambient_W_K(disk, g, h_W_m2K)
    ground = np.append(even[: g.cells.size], np.zeros(cells.size))
    ground[cells[-1]] += even[g.shaft[first:beyond]]  # the shaft outside the disk
    for own, edges, along in ((g.cells, g.r_edges, g.z_edges), (cells, r_edges, z_edges)):
        ground[own] += _round_W_K(k, n, edges, np.diff(along))
    volume = [np.outer(g.face_area, g.dz).ravel(), np.outer(area, np.diff(z_edges)).ravel()]
    capacity = s.density_kg_m3 * s.specific_heat_J_kgK * np.concatenate(volume)
    return (
        0.5 * capacity,
        0.5 * laplacian(links, ground, len(ground)),
        cells[-1, BESIDE : BESIDE + len(g.z)],
    )


def _coupling(disk: DiskTruth, g: Grid, walls: list[Wall], size: int) -> sparse.csc_matrix:
    """What the press fit conducts between disk and shaft beyond the even system's part, (size, size) [W/K].

    ``walls``: cells of disk and shaft beside the fit, of each harmonic. The flux at an angle is h(psi) times the
    difference across the fit, half a cell of steel counted in h, as in the even system.
    """
    s = disk.setup
    radius = s.bore_radius_m
    steel = s.bore_radius_m * np.log(g.r[0] / s.bore_radius_m) / s.conductivity_W_mK
    psi = 2 * np.pi * (np.arange(ROUND) + 0.5) / ROUND
    even = disk.bore_conductance_W_m2K
    contact = even * disk.uneven.relative(psi)
    shapes = np.stack([np.ones(ROUND), *(wave(n * psi) for n, wave in waves_of(disk))])
    pairs = shapes * (contact / (1 + contact * steel)) @ shapes.T / ROUND
    pairs[0, 0] -= even / (1 + even * steel)
    area = 2 * np.pi * radius * g.dz
    rows = []
    cols = []
    values = []
    for (i, one), (j, other) in product(enumerate(walls), repeat=2):
        for a, b, sign in zip((0, 0, 1, 1), (0, 1, 0, 1), (1, -1, -1, 1)):
            rows.append(one[a])
            cols.append(other[b])
            values.append(sign * pairs[i, j] * area)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
    return sparse.csc_matrix(entries, shape=(size, size))
