"""Finite volumes for a whole disk with its shaft: mesh, conductances, junctions, and the heat across the track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.flux_profile import FluxProfile
from tcdyn.simulate.steel import Steel
from tcdyn.simulate.truth import DiskTruth

Link = tuple[NDArray[np.int64], NDArray[np.int64], Array]  # one end, other end, conductance [W/K]
FINE = 2001  # cells across the track and along rolling
SHAFT_LENGTH_m = 0.12  # free length to the bearing on each side (assumed)
SHAFT_SECTION = 0.85  # share of a solid section: the shaft is bored for its wires (assumed)


@dataclass(frozen=True)
class DiskMesh:
    """Cells in r (bore to surface) and z (face d to face f), finer towards the surface; shaft cells along z."""

    radial: int = 80
    axial: int = 84
    surface_cell_m: float = 0.06e-3
    shaft_side: int = 80


@dataclass(frozen=True)
class DiskSystem:
    """C dT/dt = -S T + source_power P + source_ambient T_A + source_const; readings are ``sample @ T``.

    ``P`` [W] is the heat that enters the running track; the unknowns are the disk's cells (r slow, z fast), then
    the shaft's. ``capacity`` [J/K], ``conductance`` S [W/K], ``sample`` (channels, unknowns) in the order of
    ``channels``. All this is for the film of ``h_W_m2K``; where another wets the running surface, ``surface_m2`` (n,)
    is its area by cell, ``surface_air_m2`` (n,) that against air which is not zero (unknowns may be harmonics),
    ``skin_m2K_W`` the half cell of steel below it, ``track`` (n,) how P falls upon it. ``steel``: how the disk's own
    conduction and capacity follow temperature; ``film_air_K``: how much warmer than ambient is what wets the surface.
    """

    capacity: Array
    conductance: sparse.csc_matrix
    source_power: Array
    source_ambient: Array
    source_const: Array
    sample: sparse.csr_matrix
    channels: tuple[str, ...]
    h_W_m2K: float
    surface_m2: Array
    surface_air_m2: Array
    skin_m2K_W: float
    track: Array
    steel: Steel
    film_air_K: float = 0.0

    def film_change(self, share: Array) -> Array:
        """How much more a square metre of running surface conducts to ambient when h is ``share`` of its own."""
        one, other = (h / (1 + h * self.skin_m2K_W) for h in (self.h_W_m2K, self.h_W_m2K * share))
        return np.asarray(other - one)


def graded_edges(start: float, end: float, first: float, count: int) -> Array:
    """``count`` cells from ``start`` to ``end`` whose size grows geometrically from ``first`` at the start."""
    length = abs(end - start)
    first = min(first, length / count)
    low = 1.0
    high = 3.0
    for _ in range(80):
        ratio = 0.5 * (low + high)
        total = first * (ratio**count - 1) / (ratio - 1) if ratio > 1 + 1e-12 else first * count
        low, high = (ratio, high) if total < length else (low, ratio)
    steps = ratio ** np.arange(count)
    return start + np.sign(end - start) * length * np.concatenate(
        [[0.0], np.cumsum(steps) / steps.sum()]
    )


def build_system(
    disk: DiskTruth, h_W_m2K: float, half_width_m: float, mesh: DiskMesh
) -> DiskSystem:
    """Assemble the whole disk, bore to running surface, with washers, shaft and cooled running surface.

    ``half_width_m`` is half the width of the running track; conduction between neighbouring cells uses the exact
    logarithmic resistance in r. Washer faces and the running surface lose heat to ambient through half a cell of
    steel; the heat of the track enters at the surface itself, so a part of it leaves again through h at once. Raises
    InputError for a disk without a bore.
    """
    s = disk.setup
    if not s.bore_radius_m > 0.5e-3:
        raise InputError(
            f"bore_radius_mm {s.bore_radius_m * 1e3:g}",
            expected="a bore of more than 0.5 mm for the shaft",
        )
    g = grid_of(disk, mesh)
    to_ambient = to_ambient_W_K(disk, g, h_W_m2K)
    skin = skin_m2K_W(disk, g)
    area = np.zeros(g.size)
    track = np.zeros(g.size)
    area[g.cells[-1]] = 2 * np.pi * s.outer_radius_m * g.dz
    track[g.cells[-1]] = track_shares(g.z_edges, half_width_m, s.flux)

    ends = g.shaft[[0, -1]]
    to_bearing = np.zeros(g.size)
    to_bearing[ends] = g.shaft_conductance / (0.5 * np.diff(g.shaft_edges)[[0, -1]])
    constant = np.zeros(g.size)
    constant[ends] = to_bearing[ends] * np.asarray(disk.bearing_offset_K)

    constant[g.cells[-1]] += film_W_m2K(disk, g, h_W_m2K) * area[g.cells[-1]] * disk.film_air_K

    rho_c = s.density_kg_m3 * s.specific_heat_J_kgK
    return DiskSystem(
        capacity=rho_c
        * np.concatenate(
            [
                np.outer(g.face_area, g.dz).ravel(),
                g.shaft_conductance / s.conductivity_W_mK * np.diff(g.shaft_edges),
            ]
        ),
        conductance=laplacian(_links(disk, g), to_ambient + to_bearing, g.size),
        source_power=track * (1 - film_W_m2K(disk, g, h_W_m2K) * skin),
        source_ambient=to_ambient + to_bearing,
        source_const=constant,
        sample=_sampler(disk, g.r, g.z, g.size),
        channels=tuple(sorted(s.junctions)),
        h_W_m2K=h_W_m2K,
        surface_m2=area,
        surface_air_m2=area,
        skin_m2K_W=skin,
        track=track,
        steel=Steel(
            s.steel, laplacian(disk_links(disk, g), np.zeros(g.size), g.size), g.cells.ravel()[None]
        ),
        film_air_K=disk.film_air_K,
    )


@dataclass(frozen=True)
class Grid:
    """Cell centres and edges [m], and the numbers of the unknowns in the disk (r, z) and along the shaft."""

    r: Array
    r_edges: Array
    z: Array
    z_edges: Array
    shaft_edges: Array
    cells: NDArray[np.int64]
    shaft: NDArray[np.int64]
    first_under: int  # of the shaft cells under the disk
    face_area: Array  # of one cell, seen along z [m2]
    shaft_conductance: float  # conductivity times section [W m/K]

    @property
    def dz(self) -> Array:
        """Widths of the disk's cells (nz,) [m]."""
        return np.diff(self.z_edges)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.cells.size + self.shaft.size

    @property
    def under(self) -> NDArray[np.int64]:
        """The shaft's cells under the disk, (nz,)."""
        return self.shaft[self.first_under : self.first_under + len(self.z)]


def grid_of(disk: DiskTruth, mesh: DiskMesh) -> Grid:
    """The cells of a disk and of its shaft."""
    s = disk.setup
    r_edges = graded_edges(s.outer_radius_m, s.bore_radius_m, mesh.surface_cell_m, mesh.radial)[
        ::-1
    ]
    z_edges = np.linspace(0.0, s.width_m, mesh.axial + 1)
    right = graded_edges(s.width_m, s.width_m + SHAFT_LENGTH_m, float(z_edges[1]), mesh.shaft_side)
    shaft_edges = np.concatenate([(s.width_m - right)[:0:-1], z_edges, right[1:]])
    cells = np.arange(mesh.radial * mesh.axial).reshape(mesh.radial, mesh.axial)
    return Grid(
        r=0.5 * (r_edges[1:] + r_edges[:-1]),
        r_edges=r_edges,
        z=0.5 * (z_edges[1:] + z_edges[:-1]),
        z_edges=z_edges,
        shaft_edges=shaft_edges,
        cells=cells,
        shaft=cells.size + np.arange(len(shaft_edges) - 1),
        first_under=mesh.shaft_side,
        face_area=np.pi * np.diff(r_edges**2),
        shaft_conductance=s.conductivity_W_mK * SHAFT_SECTION * np.pi * s.bore_radius_m**2,
    )


def _links(disk: DiskTruth, g: Grid) -> list[Link]:
    """Conduction in r, in z, through the press fit into the shaft, and along the shaft."""
    s = disk.setup
    dzs = np.diff(g.shaft_edges)
    fit = 1 / (disk.bore_conductance_W_m2K * s.bore_radius_m)
    fit += np.log(g.r[0] / s.bore_radius_m) / s.conductivity_W_mK
    return [
        *disk_links(disk, g),
        (g.cells[0], g.under, 2 * np.pi * g.dz / fit),
        (g.shaft[:-1], g.shaft[1:], g.shaft_conductance * 2 / (dzs[1:] + dzs[:-1])),
    ]


def ring_links(
    cells: NDArray[np.int64], r: Array, face_area: Array, dz: Array, conductivity_W_mK: float
) -> list[Link]:
    """Conduction in r and in z between the ``cells`` (nr, nz) of a ring, ``r`` (nr,) their centres [m]."""
    k = conductivity_W_mK
    return [
        (cells[:-1], cells[1:], np.asarray(np.outer(2 * np.pi * k / np.log(r[1:] / r[:-1]), dz))),
        (cells[:, :-1], cells[:, 1:], np.asarray(np.outer(k * face_area, 2 / (dz[1:] + dz[:-1])))),
    ]


def disk_links(disk: DiskTruth, g: Grid) -> list[Link]:
    """Conduction in r and in z within the disk."""
    return ring_links(g.cells, g.r, g.face_area, g.dz, disk.setup.conductivity_W_mK)


def skin_m2K_W(disk: DiskTruth, g: Grid) -> float:
    """Resistance of half a cell of steel at the running surface."""
    s = disk.setup
    return float(s.outer_radius_m * np.log(s.outer_radius_m / g.r[-1]) / s.conductivity_W_mK)


def film_W_m2K(disk: DiskTruth, g: Grid, h_W_m2K: float) -> float:
    """Conductance from the centres of the surface cells to ambient: half a cell of steel, then h."""
    return h_W_m2K / (1 + h_W_m2K * skin_m2K_W(disk, g))


def to_ambient_W_K(disk: DiskTruth, g: Grid, h_W_m2K: float) -> Array:
    """Conductances to ambient [W/K] of the running surface, the washer faces and the shaft outside the disk."""
    s = disk.setup
    out = np.zeros(g.size)
    washer = s.washer_conductivity_W_mK / s.washer_thickness_m
    if washer > 0:
        for face, step in ((0, g.z[0]), (-1, s.width_m - g.z[-1])):
            out[g.cells[:, face]] += g.face_area / (1 / washer + step / s.conductivity_W_mK)
    per_cell = disk.shaft_W_m2K * 2 * np.pi * s.bore_radius_m * np.diff(g.shaft_edges)
    per_cell[g.first_under : g.first_under + len(g.z)] = 0.0
    out[g.shaft] += per_cell
    out[g.cells[-1]] += film_W_m2K(disk, g, h_W_m2K) * 2 * np.pi * s.outer_radius_m * g.dz
    return out


def laplacian(links: list[Link], to_ground: Array, n: int) -> sparse.csc_matrix:
    """Conductance matrix (n, n) [W/K] of cells that are linked to each other, and to ground by ``to_ground`` (n,)."""
    i = np.concatenate([np.ravel(a) for a, _, _ in links]).astype(int)
    j = np.concatenate([np.ravel(b) for _, b, _ in links]).astype(int)
    g = np.concatenate([np.ravel(c) for _, _, c in links])
    own = np.arange(n)
    rows = np.concatenate([i, j, i, j, own])
    cols = np.concatenate([j, i, i, j, own])
    return sparse.csc_matrix(
        (np.concatenate([-g, -g, g, g, to_ground]), (rows, cols)), shape=(n, n)
    )


def _sampler(disk: DiskTruth, r: Array, z: Array, n: int) -> sparse.csr_matrix:
    """Cubic interpolation in r and z from cell centres to each junction."""
    cols = []
    values = []
    for _, junction in sorted(disk.setup.junctions.items()):
        ir, wr = cubic_weights(r, disk.setup.outer_radius_m - junction.depth_m)
        iz, wz = cubic_weights(z, junction.z_m)
        cols.append(np.add.outer(ir * len(z), iz).ravel())
        values.append(np.outer(wr, wz).ravel())
    rows = np.repeat(np.arange(len(cols)), 16)
    return sparse.csr_matrix(
        (np.concatenate(values), (rows, np.concatenate(cols))), shape=(len(cols), n)
    )


def cubic_weights(x: Array, at: float) -> tuple[NDArray[np.int64], Array]:
    """Indices of the four nearest nodes and Lagrange's weights of their values at ``at``."""
    start = int(np.clip(np.searchsorted(x, at) - 2, 0, len(x) - 4))
    nodes = x[start : start + 4]
    weights = [
        np.prod([(at - nodes[j]) / (nodes[i] - nodes[j]) for j in range(4) if j != i])
        for i in range(4)
    ]
    return np.arange(start, start + 4), np.array(weights)


def hertz_shares(edges: Array, half_width_m: float) -> Array:
    """Share of a parabolic track's heat that falls into each cell, by its exact integral; sums to one."""
    x = np.clip((edges - 0.5 * (edges[0] + edges[-1])) / half_width_m, -1.0, 1.0)
    return np.diff(0.75 * (x - x**3 / 3.0))


def track_shares(edges: Array, half_width_m: float, flux: FluxProfile) -> Array:
    """Share of the heat of a track like ``flux`` that falls into each cell between ``edges`` (n + 1,) [m].

    All but the centred parabola are added up from ``FINE`` strips across the track, each whole in one cell or parted
    between two: a viscosity by Barus's law is added up over the ellipse, cell by cell.
    """
    if flux == FluxProfile():
        return hertz_shares(edges, half_width_m)
    reach = half_width_m if flux.kind != "table" else max(abs(x) for x in flux.at_m)
    strips = np.linspace(-reach, reach, FINE + 1)
    middle = 0.5 * (strips[1:] + strips[:-1])
    x = middle / half_width_m
    if flux.kind == "table":
        heat = np.interp(middle, flux.at_m, flux.weight, left=0.0, right=0.0)
    elif flux.kind == "flat":
        heat = np.ones(FINE)
    elif flux.kind == "hertz":
        heat = 1 - x**2
    else:
        left = (
            1 - x[:, None] ** 2 - x[None, :] ** 2
        )  # of the squared pressure, along rolling in the second axis
        inside = left > 0
        heat = np.where(
            inside, np.exp(flux.exponent * (np.sqrt(np.where(inside, left, 0.0)) - 1)), 0.0
        ).sum(axis=1)
    below = np.concatenate([[0.0], np.cumsum(heat)]) / heat.sum()
    centre = 0.5 * (edges[0] + edges[-1]) + flux.shift_m
    return np.diff(np.interp(edges - centre, strips, below))
