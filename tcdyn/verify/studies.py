"""The comparisons of section 3.6 as data, closed forms and meshes: what the rows judge and the pictures draw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import interp1d

from tcdyn.core import Array
from tcdyn.heat.engine import Drive, fields_at, free_decay, step_fields
from tcdyn.heat.modal import flux_density, forcing, spectrum
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

FILM_W_m2K = 700.0
POWER_W = 250.0  # heat into one disk, about that of test B3
# mesh I has 14 nodes in z here, so that its nodes are nodes of the others, as section 3.6.1 did
SETS = {"I": Mesh(9, 14), "II": Mesh(17, 27), "III": Mesh(33, 53), "IV": Mesh(65, 105)}
STEP_S = {"I": 0.04, "II": 0.01, "III": 0.005, "IV": 0.001}  # table 3.1
NODES = (9, 17, 33, 65)  # in r, of meshes whose cells halve
IDEAL_TIMES_S = (2.0, 4.0, 8.0, 15.0)
HALF_WIDTH_D4_m = 1.75e-3


@dataclass(frozen=True)
class ClosedForm:
    """A closed form and the scheme at the same x (N,), with what x is and where the picture stands."""

    title: str
    x_label: str
    x: Array
    exact: Array
    scheme: Array

    @property
    def error_percent(self) -> Array:
        """(exact - scheme)/exact in percent, as (3.33) of section 3.6.2."""
        return (self.exact - self.scheme) / self.exact * 100


@dataclass(frozen=True)
class Convergence:
    """Largest error [K] on meshes whose cells halve, and the fitted order."""

    title: str
    nodes: tuple[int, ...]
    error_K: tuple[float, ...]

    @property
    def order(self) -> float:
        """Slope of log error against log cell size."""
        return float(-np.polyfit(np.arange(len(self.nodes)), np.log2(self.error_K), 1)[0])


def default_rim(washer: bool = True) -> Rim:
    """The rim of the default rig file, with its washers or with ideal ones."""
    rim = Rim.from_setup(load_rig().disk_setup("fast"))
    return rim if washer else replace(rim, washer_W_m2K=0.0)


def transient_check() -> ClosedForm:
    """Figure 3.15: a 2 m disk whose surface jumps from 20 to 160 degC, 3 mm below it, up to 93 s."""
    rim = replace(default_rim(False), outer_radius_m=2.0)
    time = np.linspace(2.0, 93.0, 92)
    mesh = Mesh(1313, 7)
    jump = [0.0, 20.0, 20.0, 20.0, 160.0]
    fields = step_fields(
        rim, 1e9, rim.width_m / 2, [0.0, 20, 20, 20, 20], jump, time, flux="uniform", mesh=mesh
    )
    ours = interp1d(np.linspace(rim.inner_radius_m, 2.0, mesh.nr), fields[:, :, 3])(2.0 - 3e-3)
    exact = semi_infinite(3e-3, time, 20.0, 160.0, rim.diffusivity_m2_s)
    return ClosedForm(
        "3 mm below a surface that jumps (figure 3.15)", "time [s]", time, exact, ours
    )


def steady_check() -> ClosedForm:
    """Figure 3.16: uniform flux on the whole track, ideal washers, against (3.36) as corrected and (3.37)."""
    rim = default_rim(False)
    mesh = Mesh()
    inputs = [POWER_W, 85.0, 85.0, 85.0, 60.0]
    field = step_fields(
        rim, FILM_W_m2K, rim.width_m / 2, inputs, inputs, [0.0], flux="uniform", mesh=mesh
    )[0]
    r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, mesh.nr)
    flux = POWER_W / (2 * np.pi * rim.outer_radius_m * rim.width_m)
    exact = ring_steady_degC(rim, r, FILM_W_m2K, flux, 85.0, 60.0)
    return ClosedForm(
        "steady ring (figure 3.16)", "radius [mm]", r * 1e3, exact, field[:, mesh.nz // 2]
    )


def series_convergence() -> Convergence:
    """Hollow cylinder, fixed inside, flux and film outside, against its Bessel series at 0.3 and 2 s."""
    rim = default_rim(False)
    times = [0.3, 2.0]
    errors = []
    ri = rim.inner_radius_m
    ro = rim.outer_radius_m
    w = rim.width_m
    before = [0.0, 20, 20, 20, 20]
    after = [POWER_W, 20.0, 20.0, 20.0, 10.0]
    flux = POWER_W / (2 * np.pi * ro * w)
    for n in NODES:
        mesh = Mesh(n, 9)
        ours = step_fields(rim, FILM_W_m2K, w / 2, before, after, times, flux="uniform", mesh=mesh)
        exact = ring_transient_degC(
            rim, np.linspace(ri, ro, n), times, FILM_W_m2K, flux, 20.0, 10.0, 20.0
        )
        errors.append(float(np.abs(ours[:, :, 4] - exact).max()))
    return Convergence("hollow cylinder series", NODES, tuple(errors))


def product_convergence() -> Convergence:
    """A field that varies in z, after 1 s of decay from one kelvin; leaky washers make the variation large."""
    rim = replace(default_rim(), washer_W_m2K=5000.0)
    errors = []
    for n in NODES:
        mesh = Mesh(n, int(1.625 * (n - 1)) + 1)
        r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, mesh.nr)
        z = np.linspace(0, rim.width_m, mesh.nz)
        start, later = (product_decay_K(rim, r, z, t, FILM_W_m2K) for t in (0.0, 1.0))
        errors.append(float(np.abs(free_decay(rim, FILM_W_m2K, start, 1.0, mesh) - later).max()))
    return Convergence("product solution, varies in z", NODES, tuple(errors))


@dataclass(frozen=True)
class MeshErrors:
    """Largest and mean error of a mesh against mesh IV, in percent, at the compared times."""

    maximum: tuple[float, ...]
    mean: tuple[float, ...]


def crank_nicolson_field(
    rim: Rim, mesh: Mesh, dt_s: float, time_s: float, late_steps: int = 0
) -> Array:
    """Field (nr, nz) that Crank-Nicolson gives at ``time_s`` after a uniform flux starts, from 20 degC throughout.

    Mode by mode a step multiplies by (1 - lambda dt/2)/(1 + lambda dt/2), so no stepping is needed; ``late_steps``
    starts the heat so many steps late.
    """
    s = spectrum(rim, 0.0, rim.width_m / 2, "modal", "uniform", mesh)
    unit = forcing(s)
    old, new = (np.tensordot([p, 20.0, 20.0, 20.0, 20.0], unit, axes=1) for p in (0.0, POWER_W))
    half = s.rates * dt_s / 2
    ratio = (1 - half) / (1 + half)
    amplitude = new + (old - new) * ratio ** (round(time_s / dt_s) - late_steps)
    return np.vstack([np.full(mesh.nz, 20.0), s.shape_r @ amplitude @ s.shape_z.T])


def ideal_study(late_steps: int = 0) -> dict[str, MeshErrors]:
    """Tables 3.2 and 3.3: constant flux on the whole track, ideal washers, 20 degC inside, steps of table 3.1."""
    rim = default_rim(washer=False)
    return _errors(
        {
            k: [crank_nicolson_field(rim, m, STEP_S[k], t, late_steps) for t in IDEAL_TIMES_S]
            for k, m in SETS.items()
        }
    )


def time_step_error_percent() -> dict[str, float]:
    """Largest change [%] at 2 s when table 3.1's step is made ten times smaller; "I at 1 s": that of figure 3.10."""
    rim = default_rim(washer=False)
    out = {}
    for key, name, dt in [*((k, k, STEP_S[k]) for k in SETS), ("I at 1 s", "I", 1.0)]:
        coarse, fine = (
            crank_nicolson_field(rim, SETS[name], d, 2.0) for d in (dt, STEP_S[name] / 10)
        )
        out[key] = float((np.abs(coarse - fine) / fine).max() * 100)
    return out


def real_study(inner_degC: float, ambient_degC: float) -> dict[str, MeshErrors]:
    """Tables 3.5 and 3.6 by quasi-steady fields of test D4: nodal parabola times table 3.4's factor, as the thesis."""
    rim = default_rim()
    power = 0.65 * 22.0 * 20.0  # beta F u_s of test D4 (tables 6.1, 7.1 and 7.2)
    fields = {}
    for k, mesh in SETS.items():
        s = scheme(rim, 721.0, mesh)
        across = np.linspace(-1, 1, mesh.nz) * rim.width_m / 2
        inner = (
            inner_degC - 3.0 * (across / 2.765e-3) ** 2
        )  # d and f about 3 K below b, as figure 3.8
        heat = power * nodal_parabola(rim, mesh, k)
        air = (s.film + s.face_d + s.face_f) * ambient_degC
        field = steady_field(s, s.outer @ heat + s.inner @ inner + air).reshape(
            mesh.nr - 1, mesh.nz
        )
        fields[k] = [np.vstack([inner, field])]
    return _errors(fields)


def nodal_parabola(rim: Rim, mesh: Mesh, name: str) -> Array:
    """Point values of (3.32) for one watt [1/m2], raised by the factor of table 3.4 (mesh I: for 13 nodes)."""
    b = HALF_WIDTH_D4_m
    z = np.linspace(-1, 1, mesh.nz) * rim.width_m / 2
    density = np.where(np.abs(z) <= b, 0.75 / b * (1 - (z / b) ** 2), 0.0)
    factor = correction_factor(b, 13 if name == "I" else mesh.nz, rim.width_m)
    return density * factor / (2 * np.pi * rim.outer_radius_m)


def _errors(fields: dict[str, list[Array]]) -> dict[str, MeshErrors]:
    """Of each mesh but the finest, against it, at the nodes (9, 14) that all four share; ``fields`` at each time."""
    common = {
        k: np.stack(f)[:, :: (SETS[k].nr - 1) // 8, :: (SETS[k].nz - 1) // 13]
        for k, f in fields.items()
    }
    finest = common.pop("IV")
    out = {}
    for k, field in common.items():
        gap = np.abs(field - finest)
        mean = gap.sum(axis=(1, 2)) / finest.sum(axis=(1, 2))
        out[k] = MeshErrors(
            *(tuple((100 * e).tolist()) for e in ((gap / finest).max(axis=(1, 2)), mean))
        )
    return out


def stepped_gap_K(h: float, share: float) -> float:
    """Largest difference [K] of the engine's field from Crank-Nicolson stepped on mesh II, heat that comes at once."""
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
    columns[:, 0] = (
        s.outer
        @ flux_density("hertz", b, rim.width_m, mesh.nz)
        * share
        / (2 * np.pi * rim.outer_radius_m)
    )
    columns[:, 4] += s.film + s.face_d + s.face_f
    stepper = CrankNicolson.prepare(s, dt)
    field = steady_field(s, columns @ levels[0])
    for k, u in enumerate(levels[:-1]):
        field = stepper.step(field, columns @ u, columns @ u, damped=k < 3)
    last = np.vstack([levels[-1] @ inner, field.reshape(mesh.nr - 1, mesh.nz)])
    ours = fields_at(rim, Drive(dt, *levels.T), h, b, [steps - 1], share=share, mesh=mesh)[0]
    return float(np.abs(ours - last).max())
