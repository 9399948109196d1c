"""Finite volumes for a disk with its shaft: mesh, conductances, junctions, flux profile.

``tcdyn.simulate.implicit`` integrates the equations and ``tcdyn.simulate.harmonics`` adds the
circumferential harmonics. Cells exchange heat through exact radial (logarithmic) and plane
resistances. ``tests/simulate/test_disk.py`` checks heat balances, the closed form under a Hertzian
flux, and the error of the default mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.tables import FluxProfile
from tcdyn.simulate.steel import Steel
from tcdyn.simulate.truth import DiskTruth

# First cells, second cells, conductances between them [W/K].
Conductances = tuple[NDArray[np.int64], NDArray[np.int64], Array]
# Strips across the track, and along rolling, over which a flux profile is summed; chosen by
# judgement.
N_STRIPS = 2001
SHAFT_LENGTH_m = 0.12  # free length to the bearing on each side (assumed)
SHAFT_SECTION = 0.85  # share of a solid section: the shaft is bored for its wires (assumed)


@dataclass(frozen=True)
class DiskMesh:
    """Numbers of cells of the disk and its shaft.

    The cells are finer towards the surface.

    Parameters
    ----------
    radial
        Cells from bore to running surface; they are finer towards the surface.
    axial
        Equal cells across the width, from face d to face f.
    surface_cell_m
        Depth of the cells at the running surface [m].
    shaft_side
        Cells of the shaft on each side of the disk.

    Notes
    -----
    The default is within 5 mK of a refined mesh (``tests/simulate/test_disk.py``). Fewer cells save
    time; ``tcdyn.simulate.ehl.STUDY_MESH`` is 0.02 K from it.
    """

    radial: int = 80
    axial: int = 84
    surface_cell_m: float = 0.06e-3
    shaft_side: int = 80


@dataclass(frozen=True)
class DiskSystem:
    """Equations of a disk: C dT/dt = -S T + source_power P + source_ambient T_A + source_const.

    ``P`` [W] is the heat that enters the running track. The unknowns are the disk's cells (r slow,
    z fast), then those of the shaft. They may also be circumferential harmonics.

    The readings are ``sample @ T``.

    Parameters
    ----------
    capacity
        C (n,) [J/K].
    conductance
        S (n, n) [W/K], for the heat transfer coefficient ``h_W_m2K``.
    source_power
        Share of P that warms each cell (n,).
    source_ambient
        Conductance of each cell to the ambient (n,) [W/K].
    source_const
        Constant heat into each cell (n,) [W].
    sample
        Weights (channels, n) of the readings, in the order of ``channels``.
    channels
        Names of the readings.
    h_W_m2K
        Heat transfer coefficient of the running surface [W/m2K].
    surface_m2
        Area of the running surface in each cell (n,) [m2].
    surface_air_m2
        The same for its exchange with the ambient, zero for harmonics (n,).
    skin_m2K_W
        Resistance of the half cell of steel below the surface [m2K/W].
    track
        Distribution of P over the cells (n,).
    steel
        Temperature dependence of the disk's conduction and capacity.
    film_air_K
        Temperature of the fluid at the running surface above the ambient [K].
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

    def surface_conductance_change(self, share: Array) -> Array:
        """Return the change of the surface conductance [W/m2K] where h changes.

        Parameters
        ----------
        share
            h over ``h_W_m2K`` (M,).

        Returns
        -------
        array
            Change (M,) [W/m2K].
        """
        nominal = self._surface_conductance(self.h_W_m2K)
        return np.asarray(self._surface_conductance(self.h_W_m2K * share) - nominal)

    def _surface_conductance(self, h_W_m2K: float | Array) -> float | Array:
        """Return the conductance of half a surface cell of steel in series with h [W/m2K]."""
        return h_W_m2K / (1 + h_W_m2K * self.skin_m2K_W)


def graded_edges(start: float, end: float, first: float, count: int) -> Array:
    """Return the edges of cells that grow geometrically.

    Their size grows geometrically from ``first`` at the start.

    Parameters
    ----------
    start, end
        Ends of the range [m], in either order.
    first
        Size of the cell at ``start`` [m]; all cells are equal where it is larger than their mean.
    count
        Number of cells.

    Returns
    -------
    array
        Edges (count + 1,) [m] from ``start`` to ``end``.
    """
    length = abs(end - start)
    first = min(first, length / count)
    low = 1.0
    high = 3.0
    for _ in range(80):  # bisection of the ratio of neighbouring cells
        ratio = 0.5 * (low + high)
        total = first * count
        if ratio > 1 + 1e-12:
            total = first * (ratio**count - 1) / (ratio - 1)
        if total < length:
            low = ratio
        else:
            high = ratio
    sizes = ratio ** np.arange(count)
    shares = np.concatenate([[0.0], np.cumsum(sizes) / sizes.sum()])
    return start + np.sign(end - start) * length * shares


def build_system(
    disk: DiskTruth, h_W_m2K: float, half_width_m: float, mesh: DiskMesh
) -> DiskSystem:
    """Assemble the complete disk, bore to running surface, with washers, shaft and cooled surface.

    Parameters
    ----------
    disk
        True values of the disk.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    half_width_m
        Half the width of the running track.
    mesh
        Numbers of cells.

    Returns
    -------
    DiskSystem
        The equations with steel of constant properties, and the steel's dependence on temperature.

    Raises
    ------
    InputError
        If the disk has no bore.

    Notes
    -----
    Conduction between neighbouring cells uses the exact logarithmic resistance in r. Washer faces
    and the running surface lose heat to ambient through half a cell of steel. The heat of the track
    enters at the surface itself, so a part of it leaves through h at once.

    A new heat path belongs in ``_conductances`` (between cells) or ``to_ambient_W_K`` (to ambient);
    ``tcdyn.simulate.harmonics._harmonic_block`` must get it too where it acts on harmonics.
    ``tests/simulate/test_disk.py`` fails where steady heat in is not heat out.
    """
    s = disk.setup
    if not s.bore_radius_m > 0.5e-3:
        raise InputError(
            f"bore_radius_mm {s.bore_radius_m * 1e3:g}",
            expected="a bore of more than 0.5 mm for the shaft",
        )
    g = grid_of(disk, mesh)
    surface = g.cells[-1]
    conductance_W_m2K = surface_conductance_W_m2K(disk, g, h_W_m2K)
    skin = skin_m2K_W(disk, g)
    area = np.zeros(g.size)
    area[surface] = 2 * np.pi * s.outer_radius_m * g.dz
    track = np.zeros(g.size)
    track[surface] = track_shares(g.z_edges, half_width_m, s.flux)

    ends = g.shaft[[0, -1]]
    shaft_dz = np.diff(g.shaft_edges)
    to_bearing = np.zeros(g.size)
    to_bearing[ends] = g.shaft_conductance / (0.5 * shaft_dz[[0, -1]])
    constant = np.zeros(g.size)
    constant[ends] = to_bearing[ends] * np.asarray(disk.bearing_offset_K)
    constant[surface] += conductance_W_m2K * area[surface] * disk.film_air_K
    to_ground = to_ambient_W_K(disk, g, h_W_m2K) + to_bearing

    disk_volume = np.outer(g.face_area, g.dz).ravel()
    shaft_volume = g.shaft_conductance / s.conductivity_W_mK * shaft_dz
    rho_c = s.density_kg_m3 * s.specific_heat_J_kgK
    disk_conduction = laplacian(disk_conductances(disk, g), np.zeros(g.size), g.size)
    return DiskSystem(
        capacity=rho_c * np.concatenate([disk_volume, shaft_volume]),
        conductance=laplacian(_conductances(disk, g), to_ground, g.size),
        source_power=track * (1 - conductance_W_m2K * skin),
        source_ambient=to_ground,
        source_const=constant,
        sample=_junction_weights(disk, g.r, g.z, g.size),
        channels=tuple(sorted(s.junctions)),
        h_W_m2K=h_W_m2K,
        surface_m2=area,
        surface_air_m2=area,
        skin_m2K_W=skin,
        track=track,
        steel=Steel(s.steel, disk_conduction, g.cells.ravel()[None]),
        film_air_K=disk.film_air_K,
    )


@dataclass(frozen=True)
class Grid:
    """Cells of a disk and its shaft, and the indices of their unknowns.

    Parameters
    ----------
    r, z
        Centres of the disk's cells, from bore to surface (nr,) and across the width (nz,) [m].
    r_edges, z_edges
        Edges of these cells [m].
    shaft_edges
        Edges of the shaft's cells along z [m].
    cells
        Indices of the disk's cells (nr, nz).
    shaft
        Indices of the shaft's cells.
    first_under
        Index of the first shaft cell under the disk.
    face_area
        Area of each cell seen along z (nr,) [m2].
    shaft_conductance
        Conductivity times cross-section of the shaft [W m/K].
    """

    r: Array
    r_edges: Array
    z: Array
    z_edges: Array
    shaft_edges: Array
    cells: NDArray[np.int64]
    shaft: NDArray[np.int64]
    first_under: int
    face_area: Array
    shaft_conductance: float

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
        """Indices of the shaft's cells under the disk (nz,)."""
        return self.shaft[self.first_under : self.first_under + len(self.z)]


def grid_of(disk: DiskTruth, mesh: DiskMesh) -> Grid:
    """Return the cells of a disk and of its shaft.

    Parameters
    ----------
    disk
        True values of the disk.
    mesh
        Numbers of cells.

    Returns
    -------
    Grid
        Cells; the shaft has the axial cells of the disk under it.
    """
    s = disk.setup
    inwards = graded_edges(s.outer_radius_m, s.bore_radius_m, mesh.surface_cell_m, mesh.radial)
    r_edges = inwards[::-1]
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


def _conductances(disk: DiskTruth, grid: Grid) -> list[Conductances]:
    """Return all conduction: in r, in z, through the press fit into the shaft, along the shaft."""
    s = disk.setup
    shaft_dz = np.diff(grid.shaft_edges)
    fit_resistance = 1 / (disk.bore_conductance_W_m2K * s.bore_radius_m)
    fit_resistance += np.log(grid.r[0] / s.bore_radius_m) / s.conductivity_W_mK
    along_shaft = grid.shaft_conductance * 2 / (shaft_dz[1:] + shaft_dz[:-1])
    return [
        *disk_conductances(disk, grid),
        (grid.cells[0], grid.under, 2 * np.pi * grid.dz / fit_resistance),
        (grid.shaft[:-1], grid.shaft[1:], along_shaft),
    ]


def ring_conductances(
    cells: NDArray[np.int64], r: Array, face_area: Array, dz: Array, conductivity_W_mK: float
) -> list[Conductances]:
    """Return the conduction in r and in z between the cells of a ring.

    Parameters
    ----------
    cells
        Indices of the cells (nr, nz).
    r
        Centres of the cells (nr,) [m].
    face_area
        Area of each cell seen along z (nr,) [m2].
    dz
        Widths of the cells (nz,) [m].
    conductivity_W_mK
        Conductivity [W/mK].

    Returns
    -------
    list of Conductances
        Pairs of neighbouring cells and their conductances [W/K].

    Notes
    -----
    In r, through a hollow cylinder between the centres: 2 pi k dz / ln(r_2 / r_1). In z, between
    the centres of cells of widths dz_1 and dz_2: k A / ((dz_1 + dz_2) / 2).
    """
    k = conductivity_W_mK
    radial: Array = np.multiply.outer(2 * np.pi * k / np.log(r[1:] / r[:-1]), dz)
    axial: Array = np.multiply.outer(k * face_area, 2 / (dz[1:] + dz[:-1]))
    return [(cells[:-1], cells[1:], radial), (cells[:, :-1], cells[:, 1:], axial)]


def disk_conductances(disk: DiskTruth, grid: Grid) -> list[Conductances]:
    """Return the conduction in r and in z within the disk."""
    return ring_conductances(
        grid.cells, grid.r, grid.face_area, grid.dz, disk.setup.conductivity_W_mK
    )


def skin_m2K_W(disk: DiskTruth, grid: Grid) -> float:
    """Return the resistance of half a cell of steel at the running surface [m2K/W]."""
    s = disk.setup
    return float(s.outer_radius_m * np.log(s.outer_radius_m / grid.r[-1]) / s.conductivity_W_mK)


def surface_conductance_W_m2K(disk: DiskTruth, grid: Grid, h_W_m2K: float) -> float:
    """Return the conductance of half a surface cell of steel in series with h [W/m2K]."""
    return h_W_m2K / (1 + h_W_m2K * skin_m2K_W(disk, grid))


def to_ambient_W_K(disk: DiskTruth, grid: Grid, h_W_m2K: float) -> Array:
    """Return the conductances to ambient of running surface, washer faces and shaft.

    The shaft loses heat outside the disk only.

    Parameters
    ----------
    disk
        True values of the disk.
    grid
        Its cells.
    h_W_m2K
        Heat transfer coefficient of the running surface [W/m2K].

    Returns
    -------
    array
        Conductances (n,) [W/K].
    """
    s = disk.setup
    out = np.zeros(grid.size)
    washer_W_m2K = s.washer_conductivity_W_mK / s.washer_thickness_m
    if washer_W_m2K > 0:
        for face, half_cell in ((0, grid.z[0]), (-1, s.width_m - grid.z[-1])):
            resistance = 1 / washer_W_m2K + half_cell / s.conductivity_W_mK
            out[grid.cells[:, face]] += grid.face_area / resistance
    shaft = disk.shaft_W_m2K * 2 * np.pi * s.bore_radius_m * np.diff(grid.shaft_edges)
    shaft[grid.first_under : grid.first_under + len(grid.z)] = 0.0
    out[grid.shaft] += shaft
    conductance = surface_conductance_W_m2K(disk, grid, h_W_m2K)
    out[grid.cells[-1]] += conductance * 2 * np.pi * s.outer_radius_m * grid.dz
    return out


def laplacian(conductances: list[Conductances], to_ground: Array, n: int) -> sparse.csc_matrix:
    """Return the conductance matrix of cells.

    Parameters
    ----------
    conductances
        Pairs of cells and their conductances [W/K].
    to_ground
        Conductance of each cell to a fixed temperature (n,) [W/K].
    n
        Number of unknowns.

    Returns
    -------
    sparse matrix
        Symmetric matrix (n, n) [W/K]: heat that leaves each cell per kelvin.
    """
    i = np.concatenate([np.ravel(first) for first, _, _ in conductances]).astype(int)
    j = np.concatenate([np.ravel(second) for _, second, _ in conductances]).astype(int)
    g = np.concatenate([np.ravel(conductance) for _, _, conductance in conductances])
    diagonal = np.arange(n)
    rows = np.concatenate([i, j, i, j, diagonal])
    cols = np.concatenate([j, i, i, j, diagonal])
    values = np.concatenate([-g, -g, g, g, to_ground])
    return sparse.csc_matrix((values, (rows, cols)), shape=(n, n))


def _junction_weights(disk: DiskTruth, r: Array, z: Array, n: int) -> sparse.csr_matrix:
    """Return the weights of the cubic interpolation in r and z at each junction.

    Parameters
    ----------
    disk
        True values of the disk with its junctions.
    r, z
        Centres of the cells (nr,), (nz,) [m].
    n
        Number of unknowns.

    Returns
    -------
    sparse matrix
        Weights (channels, n), channels in alphabetical order.
    """
    cols = []
    values = []
    for _, junction in sorted(disk.setup.junctions.items()):
        i_r, weight_r = cubic_weights(r, disk.setup.outer_radius_m - junction.depth_m)
        i_z, weight_z = cubic_weights(z, junction.z_m)
        cols.append(np.add.outer(i_r * len(z), i_z).ravel())
        values.append(np.outer(weight_r, weight_z).ravel())
    rows = np.repeat(np.arange(len(cols)), 16)
    entries = (np.concatenate(values), (rows, np.concatenate(cols)))
    return sparse.csr_matrix(entries, shape=(len(cols), n))


def cubic_weights(x: Array, at: float) -> tuple[NDArray[np.int64], Array]:
    """Return the four nodes nearest to a point, and the Lagrange weights of their values.

    Parameters
    ----------
    x
        Nodes (N,) in ascending order, at least four.
    at
        The point; beyond the nodes it is extrapolated.

    Returns
    -------
    indices
        Indices of the nodes (4,).
    weights
        Their weights (4,), of sum one.
    """
    start = int(np.clip(np.searchsorted(x, at) - 2, 0, len(x) - 4))
    nodes = x[start : start + 4]
    weights = np.ones(4)
    for i in range(4):
        for j in range(4):
            if j != i:
                weights[i] *= (at - nodes[j]) / (nodes[i] - nodes[j])
    return np.arange(start, start + 4), weights


def hertz_shares(edges: Array, half_width_m: float) -> Array:
    """Return the share of the heat of a parabolic (Hertzian) track in each cell.

    Parameters
    ----------
    edges
        Edges of the cells (n + 1,) [m].
    half_width_m
        Half the width of the track [m], centred between the first and the last edge.

    Returns
    -------
    array
        Shares (n,) by the exact integral of the parabola; their sum is 1 where the track is within
        the edges.
    """
    x = np.clip((edges - 0.5 * (edges[0] + edges[-1])) / half_width_m, -1.0, 1.0)
    return np.diff(0.75 * (x - x**3 / 3.0))


def track_shares(edges: Array, half_width_m: float, flux: FluxProfile) -> Array:
    """Return the share of the track's heat in each cell.

    All profiles but the centred parabola are sums over ``N_STRIPS`` strips across the track, each
    in one cell or divided between two. A viscosity by Barus's law is summed over the ellipse, cell
    by cell.

    Parameters
    ----------
    edges
        Edges of the cells (n + 1,) [m].
    half_width_m
        Half the width of the track [m].
    flux
        Profile of the flux across the track.

    Returns
    -------
    array
        Shares (n,); their sum is 1 where the track is within the edges.

    Notes
    -----
    The estimators have their own profile in ``tcdyn.heat``; ``tests/heat/test_rim_flux.py``
    compares the two.
    """
    if flux == FluxProfile():
        return hertz_shares(edges, half_width_m)
    half_track_m = half_width_m
    if flux.kind == "table":
        half_track_m = max(abs(x) for x in flux.at_m)
    strip_edges = np.linspace(-half_track_m, half_track_m, N_STRIPS + 1)
    middle = 0.5 * (strip_edges[1:] + strip_edges[:-1])
    heat = _strip_heat(middle, half_width_m, flux)
    cumulative = np.concatenate([[0.0], np.cumsum(heat)]) / heat.sum()
    centre = 0.5 * (edges[0] + edges[-1]) + flux.shift_m
    return np.diff(np.interp(edges - centre, strip_edges, cumulative))


def _strip_heat(middle_m: Array, half_width_m: float, flux: FluxProfile) -> Array:
    """Return the relative heat of each strip across the track, (N_STRIPS,).

    Parameters
    ----------
    middle_m
        Middles of the strips from the centre of the track (N_STRIPS,) [m].
    half_width_m
        Half the width of the track [m].
    flux
        Profile of the flux.

    Returns
    -------
    array
        Relative heat (N_STRIPS,), not normalised.
    """
    x = middle_m / half_width_m
    if flux.kind == "table":
        return np.interp(middle_m, flux.at_m, flux.weight, left=0.0, right=0.0)
    if flux.kind == "flat":
        return np.ones(N_STRIPS)
    if flux.kind == "hertz":
        return 1 - x**2
    # Relative pressure squared in the contact ellipse; along rolling in the second axis.
    pressure_squared = 1 - x[:, None] ** 2 - x[None, :] ** 2
    inside = pressure_squared > 0
    pressure = np.sqrt(np.where(inside, pressure_squared, 0.0))
    return np.where(inside, np.exp(flux.exponent * (pressure - 1)), 0.0).sum(axis=1)
