"""Comparisons of section 3.6: closed forms, orders of convergence, meshing study.

Used by :mod:`tcdyn.verify.rim_rows`, :mod:`tcdyn.verify.steady_rows` and the figures of
:mod:`tcdyn.plots.conduction`. Tests: ``tests/heat/test_rim_plots.py`` and, through the rows,
``tests/cli/test_verify.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import interp1d

from tcdyn.core import Array
from tcdyn.heat.engine import RimInputs, fields_at, free_decay, step_fields
from tcdyn.heat.modal import flux_density, spectrum, steady_amplitudes
from tcdyn.heat.reference import (
    CrankNicolson,
    product_decay_K,
    ring_steady_degC,
    ring_transient_degC,
    scheme,
    semi_infinite,
    steady_field,
)
from tcdyn.heat.rim import Mesh, Rim, correction_factor
from tcdyn.rig.rigfile import load_rig

H_W_m2K = 700.0
POWER_W = 250.0  # heat into one disk, about that of test B3
# Mesh I has 14 nodes in z here, so that its nodes are nodes of the others, as in section 3.6.1.
SETS = {"I": Mesh(9, 14), "II": Mesh(17, 27), "III": Mesh(33, 53), "IV": Mesh(65, 105)}
STEP_S = {"I": 0.04, "II": 0.01, "III": 0.005, "IV": 0.001}  # table 3.1
NODES = (9, 17, 33, 65)  # in r, of meshes whose cells halve
# Times of tables 3.2 and 3.3 [s].
IDEAL_TIMES_S = (2.0, 4.0, 8.0, 15.0)
HALF_WIDTH_D4_m = 1.75e-3


@dataclass(frozen=True)
class ClosedForm:
    """A closed form and the numerical scheme at the same x (N,).

    ``title`` names the case with its figure, ``x_label`` is x with its unit.

    Attributes
    ----------
    title
        The case, with its figure.
    x_label
        x with its unit.
    x, exact, scheme
        Each (N,).
    """

    title: str
    x_label: str
    x: Array
    exact: Array
    scheme: Array

    @property
    def error_percent(self) -> Array:
        """(exact - scheme)/exact in percent, (3.33) of section 3.6.2.

        Returns
        -------
        error
            (N,) [%].
        """
        return (self.exact - self.scheme) / self.exact * 100


@dataclass(frozen=True)
class Convergence:
    """Largest error [K] on meshes with halved cells, and the fitted order of convergence.

    Attributes
    ----------
    title
        The case.
    nodes
        Nodes in r of each mesh; the cells are halved from mesh to mesh.
    error_K
        Largest error on each mesh.
    """

    title: str
    nodes: tuple[int, ...]
    error_K: tuple[float, ...]

    @property
    def order(self) -> float:
        """Slope of log error against log cell size."""
        return float(-np.polyfit(np.arange(len(self.nodes)), np.log2(self.error_K), 1)[0])


def default_rim(washer: bool = True) -> Rim:
    """Return the rim of the default rig file, with its washers or with ideal ones.

    Parameters
    ----------
    washer
        Whether the washers conduct; otherwise they are ideal insulators.
    """
    rim = Rim.from_setup(load_rig().disk_setup("fast"))
    return rim if washer else replace(rim, washer_W_m2K=0.0)


def transient_check() -> ClosedForm:
    """Compare a 2 m disk whose surface jumps from 20 to 160 degC, up to 93 s (figure 3.15)."""
    rim = replace(default_rim(False), outer_radius_m=2.0)
    depth_m = 3e-3
    time = np.linspace(2.0, 93.0, 92)
    mesh = Mesh(1313, 7)
    before = [0.0, 20.0, 20.0, 20.0, 20.0]
    after = [0.0, 20.0, 20.0, 20.0, 160.0]
    fields = step_fields(rim, 1e9, rim.width_m / 2, before, after, time, flux="uniform", mesh=mesh)
    r = np.linspace(rim.inner_radius_m, 2.0, mesh.nr)
    computed = interp1d(r, fields[:, :, 3])(2.0 - depth_m)
    exact = semi_infinite(depth_m, time, 20.0, 160.0, rim.diffusivity_m2_s)
    title = "3 mm below a surface that jumps (figure 3.15)"
    return ClosedForm(title, "time [s]", time, exact, computed)


def steady_check() -> ClosedForm:
    """Compare the steady ring with (3.36) as corrected and (3.37) (figure 3.16).

    Uniform flux on the complete track, ideal washers.
    """
    rim = default_rim(False)
    mesh = Mesh()
    inputs = [POWER_W, 85.0, 85.0, 85.0, 60.0]
    half_width = rim.width_m / 2
    field = step_fields(rim, H_W_m2K, half_width, inputs, inputs, [0.0], flux="uniform", mesh=mesh)[
        0
    ]
    r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, mesh.nr)
    flux = POWER_W / (2 * np.pi * rim.outer_radius_m * rim.width_m)
    exact = ring_steady_degC(rim, r, H_W_m2K, flux, 85.0, 60.0)
    computed = field[:, mesh.nz // 2]
    return ClosedForm("steady ring (figure 3.16)", "radius [mm]", r * 1e3, exact, computed)


def series_convergence() -> Convergence:
    """Compare a hollow cylinder with its Bessel series at 0.3 and 2 s.

    Fixed temperature inside; flux and heat transfer outside.
    """
    rim = default_rim(False)
    times = [0.3, 2.0]
    before = [0.0, 20, 20, 20, 20]
    after = [POWER_W, 20.0, 20.0, 20.0, 10.0]
    w = rim.width_m
    flux = POWER_W / (2 * np.pi * rim.outer_radius_m * w)
    errors = []
    for n in NODES:
        mesh = Mesh(n, 9)
        r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, n)
        computed = step_fields(rim, H_W_m2K, w / 2, before, after, times, flux="uniform", mesh=mesh)
        exact = ring_transient_degC(rim, r, times, H_W_m2K, flux, 20.0, 10.0, 20.0)
        errors.append(float(np.abs(computed[:, :, 4] - exact).max()))
    return Convergence("hollow cylinder series", NODES, tuple(errors))


def product_convergence() -> Convergence:
    """Compare a field that varies in z, after 1 s of decay from one kelvin.

    Leaky washers make the variation large.
    """
    rim = replace(default_rim(), washer_W_m2K=5000.0)
    errors = []
    for n in NODES:
        mesh = Mesh(n, int(1.625 * (n - 1)) + 1)
        r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, mesh.nr)
        z = np.linspace(0, rim.width_m, mesh.nz)
        start = product_decay_K(rim, r, z, 0.0, H_W_m2K)
        exact = product_decay_K(rim, r, z, 1.0, H_W_m2K)
        computed = free_decay(rim, H_W_m2K, start, 1.0, mesh)
        errors.append(float(np.abs(computed - exact).max()))
    return Convergence("product solution, varies in z", NODES, tuple(errors))


@dataclass(frozen=True)
class MeshErrors:
    """Largest and mean error of a mesh against mesh IV, in percent, at the compared times.

    Attributes
    ----------
    maximum, mean
        One number for each time [%].
    """

    maximum: tuple[float, ...]
    mean: tuple[float, ...]


def crank_nicolson_field(
    rim: Rim, mesh: Mesh, dt_s: float, time_s: float, late_steps: int = 0
) -> Array:
    """Return the field (nr, nz) of Crank-Nicolson at ``time_s`` after a uniform flux starts.

    The field is 20 degC before. ``late_steps`` starts the heat so many steps late.

    Parameters
    ----------
    rim
        The rim.
    mesh
        Its mesh.
    dt_s
        Time step.
    time_s
        Time after the start of the flux.
    late_steps
        Number of steps by which the heat is late.

    Returns
    -------
    field
        (nr, nz) [degC].

    Notes
    -----
    A step multiplies each mode by (1 - lambda dt/2)/(1 + lambda dt/2), so no stepping is needed.
    """
    s = spectrum(rim, 0.0, rim.width_m / 2, "modal", "uniform", mesh)
    unit = steady_amplitudes(s)
    before = np.tensordot([0.0, 20.0, 20.0, 20.0, 20.0], unit, axes=1)
    after = np.tensordot([POWER_W, 20.0, 20.0, 20.0, 20.0], unit, axes=1)
    half = s.rates * dt_s / 2
    ratio = (1 - half) / (1 + half)
    n_steps = round(time_s / dt_s) - late_steps
    amplitude = after + (before - after) * ratio**n_steps
    return np.vstack([np.full(mesh.nz, 20.0), s.shape_r @ amplitude @ s.shape_z.T])


def ideal_study(late_steps: int = 0) -> dict[str, MeshErrors]:
    """Compute tables 3.2 and 3.3 with the time steps of table 3.1.

    Constant flux on the complete track, ideal washers, 20 degC inside.

    Parameters
    ----------
    late_steps
        As of :func:`crank_nicolson_field`.

    Returns
    -------
    errors
        By name of the mesh.
    """
    rim = default_rim(washer=False)
    fields = {}
    for name, mesh in SETS.items():
        fields[name] = [
            crank_nicolson_field(rim, mesh, STEP_S[name], t, late_steps) for t in IDEAL_TIMES_S
        ]
    return _mesh_errors(fields)


def time_step_error_percent() -> dict[str, float]:
    """Return the largest change [%] of the field at 2 s when the time step is ten times smaller.

    Returns
    -------
    dict
        Change by name of the mesh in ``SETS``, for its step in ``STEP_S``; "I at 1 s" compares the
        step of 1 s of figure 3.10 with a tenth of that of mesh I.
    """
    rim = default_rim(washer=False)
    cases = [(name, name, step) for name, step in STEP_S.items()]
    cases.append(("I at 1 s", "I", 1.0))
    out = {}
    for key, name, dt in cases:
        coarse = crank_nicolson_field(rim, SETS[name], dt, 2.0)
        fine = crank_nicolson_field(rim, SETS[name], STEP_S[name] / 10, 2.0)
        out[key] = float((np.abs(coarse - fine) / fine).max() * 100)
    return out


def mesh_study_of_test_D4(inner_degC: float, ambient_degC: float) -> dict[str, MeshErrors]:
    """Mesh errors of tables 3.5 and 3.6, from quasi-steady fields of test D4 on every mesh.

    As in the thesis the flux is a nodal parabola times the factor of table 3.4.

    Parameters
    ----------
    inner_degC
        Inner row at mid width.
    ambient_degC
        Air at the running surface and at the faces.

    Returns
    -------
    errors
        By name of the mesh.
    """
    rim = default_rim()
    power = 0.65 * 22.0 * 20.0  # beta F u_s of test D4 (tables 6.1, 7.1 and 7.2)
    h_W_m2K = 721.0  # of test D4, table 7.2
    fields = {}
    for name, mesh in SETS.items():
        s = scheme(rim, h_W_m2K, mesh)
        z_from_middle = np.linspace(-1, 1, mesh.nz) * rim.width_m / 2
        # d and f are about 3 K below b, as in figure 3.8.
        inner = inner_degC - 3.0 * (z_from_middle / 2.765e-3) ** 2
        heat = power * nodal_parabola(rim, mesh, name)
        air = (s.film + s.face_d + s.face_f) * ambient_degC
        field = steady_field(s, s.outer @ heat + s.inner @ inner + air)
        fields[name] = [np.vstack([inner, field.reshape(mesh.nr - 1, mesh.nz)])]
    return _mesh_errors(fields)


def nodal_parabola(rim: Rim, mesh: Mesh, name: str) -> Array:
    """Return point values of the flux profile (3.32) for one watt [1/m2].

    The factor of mesh I is that for 13 nodes.

    They are raised by the factor of table 3.4.

    Parameters
    ----------
    rim
        The rim.
    mesh
        The mesh.
    name
        Name of the mesh.

    Returns
    -------
    flux
        (nz,) [1/m2].
    """
    b = HALF_WIDTH_D4_m
    z = np.linspace(-1, 1, mesh.nz) * rim.width_m / 2
    density = np.where(np.abs(z) <= b, 0.75 / b * (1 - (z / b) ** 2), 0.0)
    n_nodes = 13 if name == "I" else mesh.nz
    factor = correction_factor(b, n_nodes, rim.width_m)
    return density * factor / (2 * np.pi * rim.outer_radius_m)


def _mesh_errors(fields: dict[str, list[Array]]) -> dict[str, MeshErrors]:
    """Return the errors of each mesh against the finest, at the nodes (9, 14) that all four share.

    ``fields``: of each mesh, at each time.
    """
    shared = {}
    for name, values in fields.items():
        step_r = (SETS[name].nr - 1) // 8
        step_z = (SETS[name].nz - 1) // 13
        shared[name] = np.stack(values)[:, ::step_r, ::step_z]
    finest = shared.pop("IV")
    out = {}
    for name, field in shared.items():
        error = np.abs(field - finest)
        maximum = 100 * (error / finest).max(axis=(1, 2))
        mean = 100 * (error.sum(axis=(1, 2)) / finest.sum(axis=(1, 2)))
        out[name] = MeshErrors(tuple(maximum.tolist()), tuple(mean.tolist()))
    return out


def stepped_difference_K(h: float, share: float) -> float:
    """Return the largest difference [K] between the modal engine and Crank-Nicolson on mesh II.

    The heat starts at once; 150 steps of 20 ms.

    Parameters
    ----------
    h
        Heat transfer coefficient [W/m2K].
    share
        Share of the heat that enters the disk.

    Notes
    -----
    The first three steps are damped, because Crank-Nicolson rings after a jump of the heat.
    """
    rim = default_rim()
    mesh = SETS["II"]
    b = HALF_WIDTH_D4_m
    dt = 0.02
    steps = 150
    levels = np.tile([360.0, 84.0, 86.0, 85.0, 60.0], (steps, 1))
    levels[0, 0] = 0.0
    s = scheme(rim, h, mesh)
    inner = spectrum(rim, h, b, "modal", "hertz", mesh).boundary
    columns = s.inner @ inner.T
    flux = flux_density("hertz", b, rim.width_m, mesh.nz)
    columns[:, 0] = s.outer @ flux * share / (2 * np.pi * rim.outer_radius_m)
    columns[:, 4] += s.film + s.face_d + s.face_f
    stepper = CrankNicolson.prepare(s, dt)
    field = steady_field(s, columns @ levels[0])
    for k, u in enumerate(levels[:-1]):
        load = columns @ u
        field = stepper.step(field, load, load, damped=k < 3)
    stepped = np.vstack([levels[-1] @ inner, field.reshape(mesh.nr - 1, mesh.nz)])
    drive = RimInputs(dt, *levels.T)
    modal = fields_at(rim, drive, h, b, [steps - 1], share=share, mesh=mesh)[0]
    return float(np.abs(modal - stepped).max())
