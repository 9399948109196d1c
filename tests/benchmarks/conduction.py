# ruff: noqa: E402  the thread limits must stand before numpy is loaded
"""The (beta, h) map of the thesis against a factorised Crank-Nicolson: ``python -m
tests.benchmarks.conduction``.

12 heat transfer coefficients x 10 shares, 65 x 105 nodes, 1050 s at 75 Hz, junctions a, c, e, on
one core. The baseline is not the 100 s per pair of the thesis but the best simple form of its
scheme: SuperLU factorised once per h, one right-hand side per step (linear in beta: 12 passes give
120 pairs), timed over a number of steps and extrapolated.
"""

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import resource
import time
from dataclasses import dataclass

import numpy as np

from tcdyn.heat.engine import RimInputs, temperature_map
from tcdyn.heat.modal import rim_gains, spectrum
from tcdyn.heat.reference import CrankNicolson, scheme
from tcdyn.heat.rim import Mesh, Rim, basis_rates, junction_points
from tcdyn.rig.rigfile import load_rig

DT_S = 1 / 75
DURATION_S = 1050.0
HALF_WIDTH_M = 1.62e-3
SURFACE_H = np.linspace(100, 1200, 12)
SHARES = np.linspace(0.1, 1.0, 10)
STEPS = 1000  # steps of the baseline that are timed; its fastest fifth counts
SEGMENTS = 5


@dataclass(frozen=True)
class MapTiming:
    """Seconds of the complete map, of the extrapolated baseline, their ratio, and the peak memory
    of the map [MB]."""

    ours_s: float
    baseline_s: float
    ratio: float
    peak_MB: float


def simulated_inputs(duration_s: float) -> RimInputs:
    """A test of this length: heat throughout, junctions that rise and have noise."""
    n = round(duration_s / DT_S)
    t = np.arange(n) * DT_S
    rise = 1 - np.exp(-t / 40)
    noise = np.random.default_rng(0).standard_normal((5, n))
    return RimInputs(
        DT_S,
        240 + 2 * noise[0],
        55 + 31 * rise + 0.1 * noise[1],
        55 + 34 * rise + 0.1 * noise[2],
        55 + 30 * rise + 0.1 * noise[3],
        50 + 3 * rise + 0.1 * noise[4],
    )


def time_map(duration_s: float, mesh: Mesh) -> float:
    """Seconds for the complete map on this mesh and record length, gains included."""
    setup = load_rig().disk_setup("fast")
    rim = Rim.from_setup(setup)
    record = simulated_inputs(duration_s)
    start = time.perf_counter()
    out = temperature_map(
        rim, record, SHARES, SURFACE_H, junction_points(setup, "ace"), HALF_WIDTH_M, mesh=mesh
    )
    took = time.perf_counter() - start
    assert np.isfinite(out[-1, -1, -1, -1])
    return took


def time_baseline(mesh: Mesh, steps: int = STEPS) -> tuple[float, float]:
    """(least seconds per step, seconds to factorise) of Crank-Nicolson with its input, one
    right-hand side."""
    rim = Rim.from_setup(load_rig().disk_setup("fast"))
    s = scheme(rim, 700.0, mesh)
    basis = spectrum(rim, 700.0, HALF_WIDTH_M, "modal", "hertz", mesh).profile
    flux = np.zeros(mesh.nz)
    flux[mesh.nz // 3 : 2 * mesh.nz // 3] = 100.0
    air = s.inner @ basis[3:].sum(axis=0) + s.film + s.face_d + s.face_f
    columns = np.column_stack([s.outer @ flux, *(s.inner @ b for b in basis[:3]), air])
    u = simulated_inputs(steps * DT_S + 1).inputs
    start = time.perf_counter()
    stepper = CrankNicolson.prepare(s, DT_S)
    factorised = time.perf_counter() - start
    field = np.full(len(air), 55.0)
    now = columns @ u[0]
    best = np.inf
    for first in range(0, steps, steps // SEGMENTS):
        start = time.perf_counter()
        for k in range(first, first + steps // SEGMENTS):
            following = columns @ u[k + 1]
            field = stepper.step(field, now, following)
            now = following
        best = min(best, (time.perf_counter() - start) / (steps // SEGMENTS))
    return best, factorised


def compare(mesh: Mesh | None = None) -> MapTiming:
    """The ratio for the mesh IV by default."""
    mesh = mesh or Mesh()
    per_step, factorise = time_baseline(mesh)
    baseline = len(SURFACE_H) * (factorise + per_step * DURATION_S / DT_S)
    ours = min(time_map(DURATION_S, mesh) for _ in range(3))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return MapTiming(ours, baseline, baseline / ours, peak)


def time_gains(mesh: Mesh, repeat: int = 20) -> float:
    """Seconds of one ``rim_gains`` with new steel each time (nothing cached)."""
    setup = load_rig().disk_setup("fast")
    points = junction_points(setup, "ace")
    rates = basis_rates(DT_S)
    start = time.perf_counter()
    for k in range(repeat):
        rim_gains(
            Rim.from_setup(setup, conductivity_W_mK=41 + k / 10),
            700.0,
            points,
            HALF_WIDTH_M,
            rates,
            mesh=mesh,
        )
    return (time.perf_counter() - start) / repeat


def main() -> None:
    """Print the ratios."""
    m = compare()
    print(f"map 12 h x 10 beta, 65 x 105, {DURATION_S:g} s at 75 Hz, junctions a, c, e, one core")
    print(f"  modal engine                     {m.ours_s:8.2f} s   peak memory {m.peak_MB:.0f} MB")
    print(
        f"  Crank-Nicolson, 12 passes        {m.baseline_s:8.1f} s   extrapolated from the "
        f"best of {SEGMENTS} segments"
    )
    print(f"  ratio                            {m.ratio:8.0f}")
    print(
        "cost per doubling of the mesh (both ways): complete map, one set of gains, one "
        "Crank-Nicolson step"
    )
    for mesh in (Mesh(17, 27), Mesh(33, 53), Mesh(65, 105), Mesh(129, 209)):
        step = time_baseline(mesh, 60)[0]
        print(
            f"  {mesh.nr:4d} x {mesh.nz:<4d} {time_map(DURATION_S, mesh):6.2f} s  "
            f"{time_gains(mesh, 5) * 1e3:7.2f} ms  {step * 1e3:7.3f} ms"
        )
    print("cost per doubling of the record: complete map on 65 x 105")
    for duration in (262.5, 525.0, 1050.0, 2100.0):
        print(f"  {duration:7.1f} s {time_map(duration, Mesh()):6.2f} s")
    assert m.ratio >= 200, f"the map is only {m.ratio:.0f} times faster than the baseline"
    assert m.peak_MB < 500, f"the map took {m.peak_MB:.0f} MB"


if __name__ == "__main__":
    main()
