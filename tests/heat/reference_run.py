"""Simulations of the rim by the engine, or by the Crank-Nicolson reference with independent steps
and interpolation."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from tcdyn.heat.engine import RimInputs, temperature_map
from tcdyn.heat.modal import RimGains, spectrum
from tcdyn.heat.reference import CrankNicolson, Scheme, steady_field
from tcdyn.heat.rim import Mesh, Point, Rim


def hertz_cells(rim: Rim, half_width_m: float, nz: int) -> np.ndarray:
    """Flux of one watt on the z nodes [W/m2], by numerical integration over the cells."""
    dz = rim.width_m / (nz - 1)
    fine = (np.arange(2000 * (nz - 1)) + 0.5) * dz / 2000
    x = (fine - rim.width_m / 2) / half_width_m
    density = np.where(np.abs(x) < 1, 0.75 / half_width_m * (1 - x**2), 0.0)
    node = np.rint(fine / dz).astype(int)
    return (
        np.bincount(node, density, nz)
        / np.bincount(node, minlength=nz)
        / (2 * np.pi * rim.outer_radius_m)
    )


def simulate_rim(
    rim: Rim,
    drive: RimInputs,
    h: float,
    points: list[Point],
    half_width_m: float,
    share=1.0,
    **options,
):
    """Temperatures (N, P) of one share and one h."""
    return temperature_map(rim, drive, share, h, points, half_width_m, **options)[0, 0].T


def respond(gains: RimGains, bases: list[np.ndarray], inputs: np.ndarray) -> np.ndarray:
    """Temperatures (N, P) from the lag bases (N, K) of all inputs and the inputs (N, I)."""
    return inputs @ gains.direct + sum(
        basis @ gain.T for basis, gain in zip(bases, gains.gains, strict=True)
    )


def run_reference(
    rim: Rim,
    s: Scheme,
    drive: RimInputs,
    shapes: np.ndarray,
    flux: np.ndarray,
    points: list[Point],
    substeps: int,
    extra_at_jumps: int = 1,
) -> np.ndarray:
    """Temperatures (N, P) with ``substeps`` steps per sample.

    For 60 samples after a jump of the heat, there are ``extra_at_jumps`` times as many. ``shapes``
    (4, nz): boundary temperature for a unit of d, b, f and ambient; ``flux`` (nz,) for a watt.
    """
    m = s.mesh.nr
    n = s.mesh.nz
    u = drive.inputs
    air = s.film + s.face_d + s.face_f
    columns = np.column_stack(
        [s.outer @ flux, *(s.inner @ shape for shape in shapes[:3]), s.inner @ shapes[3] + air]
    )
    r = np.linspace(rim.inner_radius_m, rim.outer_radius_m, m)
    z = np.linspace(0, rim.width_m, n)
    in_r = make_interp_spline(r, np.eye(m), k=5)(
        rim.outer_radius_m - np.array([d for d, _ in points])
    )
    in_z = make_interp_spline(z, np.eye(n), k=5)(np.array([at for _, at in points]))

    def read_points(field: np.ndarray, now: np.ndarray) -> np.ndarray:
        full_field = np.vstack([now[1:] @ shapes, field.reshape(m - 1, n)])
        return np.einsum("pr,rz,pz->p", in_r, full_field, in_z)

    steppers = {
        k: CrankNicolson.prepare(s, drive.dt_s / k) for k in {substeps, substeps * extra_at_jumps}
    }
    field = steady_field(s, columns @ u[0])
    temperatures = [read_points(field, u[0])]
    samples_since_jump = 10**9
    for k in range(len(u) - 1):
        samples_since_jump = 0 if k and u[k, 0] != u[k - 1, 0] else samples_since_jump + 1
        count = substeps * extra_at_jumps if samples_since_jump < 60 else substeps
        stepper = steppers[count]
        for j in range(count):
            a, b = (u[k] + (u[k + 1] - u[k]) * x / count for x in (j, j + 1))
            a[0] = b[0] = u[k, 0]  # the heat is constant over a sample
            field = stepper.step(
                field, columns @ a, columns @ b, damped=samples_since_jump == 0 and j < 2
            )
        temperatures.append(read_points(field, u[k + 1]))
    return np.array(temperatures)


def heating_and_cooling(
    duration_s: float, on_s: float, off_s: float, power: float = 260.0, dt: float = 1 / 75
) -> RimInputs:
    """A test like B3: the inner row follows the heat slowly, its junctions differ, the enclosure
    warms up."""
    t = np.arange(round(duration_s / dt)) * dt
    heat = np.where((t >= on_s - 1e-9) & (t < off_s - 1e-9), power, 0.0)

    def follow(rise: float, tau: float) -> np.ndarray:
        on = np.clip(t - on_s, 0, None)
        off = np.clip(t - off_s, 0, None)
        return rise * ((1 - np.exp(-on / tau)) - (1 - np.exp(-off / tau)))

    return RimInputs(
        dt, heat, 60 + follow(31, 9), 60 + follow(34, 8), 60 + follow(30, 10), 55 + follow(5, 60)
    )


def boundary_shapes(rim: Rim, mesh: Mesh) -> np.ndarray:
    """Boundary temperature (4, nz) of the modal profile for a unit of d, b, f and ambient."""
    basis = spectrum(rim, 0.0, 1.6e-3, "modal", "hertz", mesh).profile
    return np.vstack([basis[:3], basis[3:].sum(axis=0)])
