"""The comparisons of section 3.6 as data: what the rows judge and the pictures draw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.rig import load_rig
from tcdyn.conduction.closed_forms import product_decay_K, ring_steady_degC, ring_transient_degC, semi_infinite
from tcdyn.conduction.engine import free_decay, step_fields
from tcdyn.conduction.rim import Mesh, Rim

Array = NDArray[np.float64]
FILM_W_m2K = 700.0
POWER_W = 250.0  # heat into one disk, about that of test B3


@dataclass(frozen=True)
class Comparison:
    """A closed form and the scheme at the same x (N,), with what x is and where the picture stands."""

    title: str
    x_label: str
    x: Array
    exact: Array
    scheme: Array

    @property
    def error_percent(self) -> Array:
        """(exact - scheme)/exact in percent, as (3.33) of section 3.6.2."""
        return np.asarray((self.exact - self.scheme) / self.exact * 100)


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


def transient_check(nodes: int = 1313) -> Comparison:
    """Figure 3.15: a 2 m disk whose surface jumps from 20 to 160 degC, 3 mm below it, up to 93 s."""
    rim = replace(default_rim(False), outer_radius_m=2.0)
    time = np.linspace(2.0, 93.0, 92)
    mesh = Mesh(nodes, 7)
    jump = [0.0, 20.0, 20.0, 20.0, 160.0]
    fields = step_fields(rim, 1e9, rim.width_m / 2, [0.0, 20, 20, 20, 20], jump, time, flux="uniform", mesh=mesh)
    r = np.linspace(rim.inner_radius_m, 2.0, nodes)
    at = 2.0 - 3e-3
    k = int(np.searchsorted(r, at))
    part = (at - r[k - 1]) / (r[k] - r[k - 1])
    ours = (1 - part) * fields[:, k - 1, 3] + part * fields[:, k, 3]
    exact = semi_infinite(3e-3, time, 20.0, 160.0, rim.diffusivity_m2_s)
    return Comparison("3 mm below a surface that jumps (figure 3.15)", "time [s]", time, exact, ours)


def steady_check(mesh: Mesh | None = None) -> Comparison:
    """Figure 3.16: uniform flux on the whole track, ideal washers, against (3.36) as corrected and (3.37)."""
    rim, mesh = default_rim(False), mesh or Mesh()
    inputs = [POWER_W, 85.0, 85.0, 85.0, 60.0]
    field = step_fields(rim, FILM_W_m2K, rim.width_m / 2, inputs, inputs, [0.0], flux="uniform", mesh=mesh)[0]
    r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, mesh.nr)
    flux = POWER_W / (2 * np.pi * rim.outer_radius_m * rim.width_m)
    exact = ring_steady_degC(
        r, rim.inner_radius_m, rim.outer_radius_m, rim.conductivity_W_mK, FILM_W_m2K, flux, 85.0, 60.0
    )
    return Comparison("steady ring (figure 3.16)", "radius [mm]", r * 1e3, exact, field[:, mesh.nz // 2])


def series_convergence(nodes: tuple[int, ...] = (9, 17, 33, 65)) -> Convergence:
    """Hollow cylinder, fixed inside, flux and film outside, against its Bessel series at 0.3 and 2 s."""
    rim = default_rim(False)
    ri, ro, w = rim.inner_radius_m, rim.outer_radius_m, rim.width_m
    times, errors = [0.3, 2.0], []
    before, after = [0.0, 20, 20, 20, 20], [POWER_W, 20.0, 20.0, 20.0, 10.0]
    flux = POWER_W / (2 * np.pi * ro * w)
    for n in nodes:
        mesh = Mesh(n, 9)
        ours = step_fields(rim, FILM_W_m2K, w / 2, before, after, times, flux="uniform", mesh=mesh)
        exact = ring_transient_degC(
            np.linspace(ri, ro, n), times, ri, ro, rim.conductivity_W_mK, rim.diffusivity_m2_s, FILM_W_m2K, flux,
            20.0, 10.0, 20.0,
        )  # fmt: skip
        errors.append(float(np.abs(ours[:, :, 4] - exact).max()))
    return Convergence("hollow cylinder series", nodes, tuple(errors))


def product_convergence(nodes: tuple[int, ...] = (9, 17, 33, 65), washer_W_m2K: float = 5000.0) -> Convergence:
    """A field that varies in z, after 1 s of decay from one kelvin; leaky washers make the variation large."""
    rim = replace(default_rim(), washer_W_m2K=washer_W_m2K)
    ri, ro, w, errors = rim.inner_radius_m, rim.outer_radius_m, rim.width_m, []
    for n in nodes:
        mesh = Mesh(n, int(1.625 * (n - 1)) + 1)
        r, z = np.linspace(ri, ro, mesh.nr), np.linspace(0, w, mesh.nz)
        args = (ri, ro, w, rim.conductivity_W_mK, rim.diffusivity_m2_s, FILM_W_m2K, washer_W_m2K)
        start, later = (product_decay_K(r, z, t, *args) for t in (0.0, 1.0))
        errors.append(float(np.abs(free_decay(rim, FILM_W_m2K, start, 1.0, mesh) - later).max()))
    return Convergence("product solution, varies in z", nodes, tuple(errors))
