"""The synthetic disk with an uneven press fit: circumferential harmonics of its temperature.

With the conductance of the bore h0 (1 + a cos(psi)), psi the angle from where the fit is best, the
temperature is T0 + T1 cos(psi) + T2 cos(2 psi). Where rig.toml has keyways and patches, sines are
added, and psi = 0 is the maximum of the first harmonic of the conductance. Each T_n obeys
conduction in (r, z) with -n^2 T/r^2 added, in the disk and in the shaft under and beside it. The
harmonics exchange heat where the conductance makes products of their angles.

``tcdyn.simulate.ehl`` and ``tcdyn.simulate.field`` use it. Harmonics above the second are left out.
``tests/simulate/test_disk.py`` checks balances, symmetry and the radial equation;
``tests/partition/test_stated_fit.py`` the fit of rig.toml.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
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
    disk_conductances,
    graded_edges,
    grid_of,
    laplacian,
    ring_conductances,
    to_ambient_W_K,
)
from tcdyn.simulate.steel import Steel
from tcdyn.simulate.truth import DiskTruth

# Cells of the disk and of the shaft on either side of the press fit.
Wall = tuple[NDArray[np.int64], NDArray[np.int64]]
# Order n of a harmonic, and its shape: cos or sin of n psi.
Wave = tuple[int, Callable[[Array], Array]]

HARMONICS = (1, 2)  # orders that are solved; ``unevenness_effects`` assumes these two
# Shapes that every uneven disk has.
COSINES: tuple[Wave, ...] = tuple((n, np.cos) for n in HARMONICS)
# Shapes that a disk with keyways or patches has in addition.
SINES: tuple[Wave, ...] = tuple((n, np.sin) for n in HARMONICS)
N_SHAFT_CELLS = 8  # across the wall of the bored shaft; chosen by judgement
# outermost cell of the shaft [m]; its half cell is neglected; by judgement
OUTER_SHAFT_CELL_M = 0.2e-3
N_BESIDE = 10  # shaft cells on each side of the disk: harmonics fade over half a radius
N_ANGLES = 720  # angles of the means around the bore; chosen by judgement


@dataclass(frozen=True)
class _HarmonicBlock:
    """Equations of one circumferential harmonic.

    Parameters
    ----------
    capacity
        Capacities (M,) [J/K].
    conductance
        Conductances (M, M) [W/K].
    shaft_faces
        Indices of the shaft cells at the press fit (nz,).
    """

    capacity: Array
    conductance: sparse.csc_matrix
    shaft_faces: NDArray[np.int64]


def harmonic_system(
    disk: DiskTruth, h_W_m2K: float, half_width_m: float, mesh: DiskMesh
) -> DiskSystem:
    """Return the disk of ``build_system``, with its harmonics if its bore contact is uneven.

    Rows of ``sample``: the reading of each junction, in the order of ``channels``. For an uneven
    disk these follow: the contribution of the first harmonic to each reading, that of the second,
    and the amplitude of the first at the depth and z of the rim's edge, of its cosine and, where
    there are keyways or patches, of its sine.

    Parameters
    ----------
    disk
        True values of the disk.
    h_W_m2K
        Heat transfer coefficient of the running surface [W/m2K].
    half_width_m
        Half the width of the running track [m].
    mesh
        Numbers of cells.

    Returns
    -------
    DiskSystem
        The equations. The harmonics follow the unknowns of the even disk, in the order of
        ``harmonic_shapes``.

    Notes
    -----
    The order of the rows of ``sample`` is read by ``tcdyn.simulate.harmonics.unevenness_effects``
    and by ``tcdyn.simulate.ehl._simulate_disk``. ``tests/simulate/test_disk.py`` fails where they
    disagree.
    """
    even = build_system(disk, h_W_m2K, half_width_m, mesh)
    if disk.uneven.even:
        return even
    g = grid_of(disk, mesh)
    waves = harmonic_shapes(disk)
    blocks = [_harmonic_block(disk, g, n, h_W_m2K) for n, _ in waves]
    sizes = [len(block.capacity) for block in blocks]
    starts = np.cumsum([0, g.size, *sizes])
    conductances = [even.conductance, *(block.conductance for block in blocks)]
    uncoupled = sparse.block_diag(conductances, format="csc")
    walls: list[Wall] = [(g.cells[0], g.under)]
    for start, block in zip(starts[1:], blocks):
        walls.append((start + g.cells[0], start + block.shaft_faces))
    coupled = uncoupled + _press_fit_matrix(disk, g, walls, int(starts[-1]))
    zeros = np.zeros(starts[-1] - g.size)
    half_surfaces = [_half_surface(even, size) for size in sizes]
    return replace(
        even,
        capacity=np.concatenate([even.capacity, *(block.capacity for block in blocks)]),
        conductance=sparse.csc_matrix(coupled),
        source_power=np.append(even.source_power, zeros),
        source_ambient=np.append(even.source_ambient, zeros),
        source_const=np.append(even.source_const, zeros),
        sample=_sample_rows(disk, g, even, starts),
        surface_m2=np.concatenate([even.surface_m2, *half_surfaces]),
        surface_air_m2=np.append(even.surface_air_m2, zeros),
        track=np.append(even.track, zeros),
        steel=_steel_with_harmonics(disk, g, even.steel, starts),
    )


def harmonic_shapes(disk: DiskTruth) -> tuple[Wave, ...]:
    """Return order and shape of the disk's harmonics, in the order of the unknowns.

    Parameters
    ----------
    disk
        True values of the disk.

    Returns
    -------
    tuple
        (n, cos or sin) for each harmonic; the argument of cos and sin is n psi [rad]. Empty for an
        even disk. psi counts from ``disk.uneven.angle_deg``: where the fit is best, or with sectors
        from rig.toml the maximum of the first harmonic of the conductance.

    Notes
    -----
    The order must be that of the blocks of :func:`harmonic_system` and is read by
    ``tcdyn.simulate.field``. That cos comes before sin is read by :func:`unevenness_effects`.
    Guarded by ``tests/simulate/test_disk.py``, the sines by
    ``test_sectors_following_a_cosine_conduct_as_the_cosine_at_any_angle``.
    """
    if disk.uneven.even:
        return ()
    return COSINES + SINES if disk.uneven.sectors else COSINES


def _sample_rows(disk: DiskTruth, grid: Grid, even: DiskSystem, starts: Array) -> sparse.csr_matrix:
    """Return the matrix that gives the readings of an uneven disk from its n unknowns.

    Parameters
    ----------
    disk
        True values of the disk.
    grid
        Its cells.
    even
        System of the disk without harmonics.
    starts
        First unknown of the even system and of each harmonic, then the number of unknowns.

    Returns
    -------
    sparse matrix
        ``sample`` of :func:`harmonic_system`, (R, n). A block of rows for all channels at their
        temperature, one for the part of each order of harmonics in it, then the amplitudes of the
        first harmonic at the edge, one row each.
    """
    waves = harmonic_shapes(disk)
    junctions = disk.setup.junctions
    angles_deg = [junctions[c].angle_deg - disk.uneven.angle_deg for c in even.channels]
    angles = np.deg2rad(angles_deg)
    at_cells = even.sample[:, : grid.cells.size]
    by_wave = [sparse.csr_matrix(at_cells.multiply(wave(n * angles)[:, None])) for n, wave in waves]
    amplitude = at_cells[[even.channels.index(disk.setup.edge)]]
    rows = [[(0, even.sample), *enumerate(by_wave, start=1)]]
    for order in HARMONICS:
        rows.append([(k + 1, by_wave[k]) for k, (n, _) in enumerate(waves) if n == order])
    rows += [[(k + 1, amplitude)] for k, (n, _) in enumerate(waves) if n == 1]
    return sparse.vstack([_spread(row, starts) for row in rows], format="csr")


def _steel_with_harmonics(disk: DiskTruth, grid: Grid, even: Steel, starts: Array) -> Steel:
    """Extend the steel of the even disk by one block of unknowns for each harmonic.

    A harmonic conducts as at the temperature of the even part; its conduction is halved (mean of
    cos^2). In every block the cells of the disk come first; only they depend on temperature.

    Parameters
    ----------
    disk
        True values of the disk.
    grid
        Its cells.
    even
        Steel of the even system.
    starts
        First unknown of the even system and of each harmonic, then the number of unknowns.

    Returns
    -------
    Steel
        Steel with the unknowns of all harmonics.
    """
    size = grid.cells.size
    k = disk.setup.conductivity_W_mK
    blocks = [even.conduction]
    for (n, _), (first, end) in zip(harmonic_shapes(disk), pairwise(starts[1:])):
        to_ground = np.zeros(end - first)
        to_ground[:size] = _circumferential_W_K(k, n, grid.r_edges, grid.dz).ravel()
        blocks.append(0.5 * laplacian(disk_conductances(disk, grid), to_ground, len(to_ground)))
    cells = np.stack([start + grid.cells.ravel() for start in starts[:-1]])
    conduction = sparse.csc_matrix(sparse.block_diag(blocks, format="csc"))
    return Steel(even.slopes, conduction, cells)


def _circumferential_W_K(conductivity_W_mK: float, n: int, edges: Array, dz: Array) -> Array:
    """Return the conductance that the term -n^2 T/r^2 gives each cell of a ring.

    Parameters
    ----------
    conductivity_W_mK
        Conductivity [W/mK].
    n
        Order of the harmonic.
    edges
        Edges of the cells in r (nr + 1,) [m].
    dz
        Widths of the cells (nz,) [m].

    Returns
    -------
    array
        Conductances (nr, nz) [W/K] of the full ring, before the mean of cos^2.
    """
    return 2 * np.pi * conductivity_W_mK * n**2 * np.outer(np.log(edges[1:] / edges[:-1]), dz)


def _half_surface(even: DiskSystem, count: int) -> Array:
    """Return half the running surface in the unknowns of a harmonic (count,).

    Every term of a harmonic is halved, as the mean of cos^2 is a half. Disk cells come first.

    Parameters
    ----------
    even
        The even system.
    count
        Number of unknowns of the harmonic.

    Returns
    -------
    array
        Areas (count,) [m2].
    """
    n_shared = min(count, len(even.surface_m2))
    return np.append(0.5 * even.surface_m2[:n_shared], np.zeros(count - n_shared))


def unevenness_effects(disk: DiskTruth, readings: Array) -> dict[str, Any]:
    """Return the effect of the uneven contact on the junctions.

    Parameters
    ----------
    disk
        True values of the disk.
    readings
        One row of readings of ``harmonic_system`` [degC].

    Returns
    -------
    dict
        ``contact``: amplitude and angle of the conductance. ``amplitude_K`` of the first harmonic
        at the depth of b, and ``angle_deg`` of its hottest side. ``first_K`` and ``second_K``:
        contribution of either harmonic to each junction. Zeros for an even disk.
    """
    names = sorted(disk.channels)
    n = len(names)
    contact = disk.uneven
    harmonics = np.zeros(2 * n + 1) if contact.even else readings[n:]
    first, second, (cos, *sines) = np.split(harmonics, [n, 2 * n])
    sin = sum(sines)
    turned_deg = np.rad2deg(np.arctan2(sin, cos))
    return {
        "contact": {"amplitude": contact.amplitude, "angle_deg": contact.angle_deg},
        "amplitude_K": float(np.hypot(cos, sin)),
        "angle_deg": float(contact.angle_deg + turned_deg) % 360.0,
        "first_K": dict(zip(names, first.tolist())),
        "second_K": dict(zip(names, second.tolist())),
    }


def _spread(blocks: list[tuple[int, sparse.csr_matrix]], starts: Array) -> sparse.csr_matrix:
    """Return rows over all unknowns, each block at the first unknown of its harmonic.

    Parameters
    ----------
    blocks
        Number of a harmonic (0 for the even part) and its rows.
    starts
        First unknown of the even system and of each harmonic, then the number of unknowns.

    Returns
    -------
    sparse matrix
        The sum of the blocks, over all unknowns.
    """
    n_unknowns = int(starts[-1])
    total = 0
    for n, block in blocks:
        entries = block.tocoo()
        columns = entries.col + int(starts[n])
        shape = (entries.shape[0], n_unknowns)
        total = total + sparse.csr_matrix((entries.data, (entries.row, columns)), shape=shape)
    return sparse.csr_matrix(total)


def _harmonic_block(disk: DiskTruth, grid: Grid, n: int, h_W_m2K: float) -> _HarmonicBlock:
    """Return the equations of harmonic ``n``.

    The mean of cos^2 around the disk is a half, so all terms are half of those of the full ring.

    Parameters
    ----------
    disk
        True values of the disk.
    grid
        Its cells.
    n
        Order of the harmonic.
    h_W_m2K
        Heat transfer coefficient of the running surface [W/m2K].

    Returns
    -------
    _HarmonicBlock
        The equations without the exchange through the press fit.

    Notes
    -----
    A harmonic loses heat to the ambient as the even part does and has no source.
    """
    s = disk.setup
    k = s.conductivity_W_mK
    first = grid.first_under - N_BESIDE
    end = grid.first_under + len(grid.z) + N_BESIDE
    hollow_radius = s.bore_radius_m * np.sqrt(1 - SHAFT_SECTION)
    inwards = graded_edges(s.bore_radius_m, hollow_radius, OUTER_SHAFT_CELL_M, N_SHAFT_CELLS)
    r_edges = inwards[::-1]
    z_edges = grid.shaft_edges[first : end + 1]
    dz = np.diff(z_edges)
    n_cells = N_SHAFT_CELLS * (end - first)
    cells = grid.cells.size + np.arange(n_cells).reshape(N_SHAFT_CELLS, -1)
    r = 0.5 * (r_edges[1:] + r_edges[:-1])
    area = np.pi * np.diff(r_edges**2)
    conductances = disk_conductances(disk, grid) + ring_conductances(cells, r, area, dz, k)

    even_to_ambient = to_ambient_W_K(disk, grid, h_W_m2K)
    to_ground = np.append(even_to_ambient[: grid.cells.size], np.zeros(cells.size))
    to_ground[cells[-1]] += even_to_ambient[grid.shaft[first:end]]  # the shaft outside the disk
    to_ground[grid.cells] += _circumferential_W_K(k, n, grid.r_edges, grid.dz)
    to_ground[cells] += _circumferential_W_K(k, n, r_edges, dz)

    disk_volume = np.outer(grid.face_area, grid.dz).ravel()
    shaft_volume = np.outer(area, dz).ravel()
    rho_c = s.density_kg_m3 * s.specific_heat_J_kgK
    return _HarmonicBlock(
        capacity=0.5 * (rho_c * np.concatenate([disk_volume, shaft_volume])),
        conductance=0.5 * laplacian(conductances, to_ground, len(to_ground)),
        shaft_faces=cells[-1, N_BESIDE : N_BESIDE + len(grid.z)],
    )


def _press_fit_matrix(
    disk: DiskTruth, grid: Grid, walls: list[Wall], size: int
) -> sparse.csc_matrix:
    """Return the conduction of the press fit beyond that of the even system, (size, size) [W/K].

    The flux at an angle is h(psi) times the difference across the fit, half a cell of steel counted
    in h, as in the even system.

    Parameters
    ----------
    disk
        True values of the disk.
    grid
        Its cells.
    walls
        Cells of disk and shaft beside the fit, of each harmonic; the even part comes first.
    size
        Number of unknowns.

    Returns
    -------
    sparse matrix
        Symmetric conductances (size, size) [W/K].
    """
    s = disk.setup
    skin = s.bore_radius_m * np.log(grid.r[0] / s.bore_radius_m) / s.conductivity_W_mK
    psi = 2 * np.pi * (np.arange(N_ANGLES) + 0.5) / N_ANGLES
    mean_W_m2K = disk.bore_conductance_W_m2K
    contact_W_m2K = mean_W_m2K * disk.uneven.relative_conductance(psi)
    shapes = np.stack([np.ones(N_ANGLES), *(wave(n * psi) for n, wave in harmonic_shapes(disk))])
    pairs = shapes * (contact_W_m2K / (1 + contact_W_m2K * skin)) @ shapes.T / N_ANGLES
    pairs[0, 0] -= mean_W_m2K / (1 + mean_W_m2K * skin)
    area = 2 * np.pi * s.bore_radius_m * grid.dz
    rows = []
    cols = []
    values = []
    for i, (disk_i, shaft_i) in enumerate(walls):
        for j, (disk_j, shaft_j) in enumerate(walls):
            conductance = pairs[i, j] * area
            rows += [disk_i, disk_i, shaft_i, shaft_i]
            cols += [disk_j, shaft_j, disk_j, shaft_j]
            values += [conductance, -conductance, -conductance, conductance]
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
    return sparse.csc_matrix(entries, shape=(size, size))
