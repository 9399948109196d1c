"""Speed of the plunge model and fit against simple alternatives: ``python -m
tests.benchmarks.plunge``."""

from __future__ import annotations

import sys
from pathlib import Path
from time import process_time

import numpy as np
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).parents[1] / "immersion"))

from plunge_simulator import same_pairs, simulate
from plunge_study import make_runs

from immersion.correlations import Bath, correlation
from immersion.cylinder import Cylinder
from immersion.fluids import fluid
from immersion.plunge_data import make_blocks
from immersion.plunge_fit import identify_plunges
from immersion.plunge_model import build_run_models, predict
from immersion.plunge_parameters import PlungeParameters, PlungePriors
from immersion.radial import simulate_plunge_model
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.rigfile import load_rig

SETUP = load_rig().disk_setup("fast")
DEPTHS = np.array([1.25e-3, 3e-3, 6e-3])


def baseline(cells: int = 60, duration_s: float = 300.0) -> np.ndarray:
    """The same plunge by finite volumes and scipy's BDF: temperature at the three depths at the
    end."""
    disk = Cylinder.from_setup(SETUP)
    bath = Bath(fluid("mobil-jet-ii"), correlation("5.4"), SETUP.width_m, 2 * SETUP.outer_radius_m)
    faces = np.linspace(disk.inner_radius_m, disk.outer_radius_m, cells + 1)
    centres = (faces[1:] + faces[:-1]) / 2
    dr = faces[1] - faces[0]
    volume = (faces[1:] ** 2 - faces[:-1] ** 2) / 2 * disk.heat_capacity_J_m3K
    k = disk.conductivity_W_mK

    def rate(t: float, T: np.ndarray) -> np.ndarray:
        h = float(bath.h_W_m2K(T[-1], 110.0))
        flow = np.zeros(cells + 1)
        flow[1:-1] = k * faces[1:-1] / dr * (T[:-1] - T[1:])
        flow[-1] = -disk.outer_radius_m * (110.0 - T[-1]) / (1 / h + dr / (2 * k))
        return (flow[:-1] - flow[1:]) / volume

    out = solve_ivp(rate, (0, duration_s), np.full(cells, 26.0), "BDF", rtol=1e-7, atol=1e-6)
    return np.interp(disk.outer_radius_m - DEPTHS, centres, out.y[:, -1])


def time_fit_model(baseline_s: float) -> None:
    """One evaluation as in the fit, readings of six channels and their 40 derivatives, against
    differences."""
    rng = np.random.default_rng(2)
    times, readings = simulate(same_pairs(1), 60.0, rng)
    run = make_runs(same_pairs(1), times, readings, rng)[0]
    layout = PlungeParameters(1, CHANNELS, "P2")
    theta, _ = layout.prior(PlungePriors(), [0.05], [26.0])
    theta[layout.at("lag")] = 0.6
    models = build_run_models([run], [make_blocks(run)], SETUP, layout, correlation("5.4"), theta)
    predict(models, layout, theta)
    t0 = process_time()
    for _ in range(10):
        predict(models, layout, theta)
    evaluation_s = (process_time() - t0) / 10
    print(
        f"model and {layout.size} derivatives: {1e3 * evaluation_s:.1f} ms; {layout.size + 1} "
        f"baseline runs would take {(layout.size + 1) * baseline_s:.2f} s, ratio "
        f"{(layout.size + 1) * baseline_s / evaluation_s:.0f}"
    )


def main() -> None:
    """Print seconds of processor time and ratios."""
    disk = Cylinder.from_setup(SETUP)
    bath = Bath(fluid("mobil-jet-ii"), correlation("5.4"), SETUP.width_m, 2 * SETUP.outer_radius_m)

    def model_temperature() -> np.ndarray:
        out = simulate_plunge_model(
            disk, DEPTHS, lambda T, F, t: bath.h_W_m2K(T, F), 26.0, 110.0, 300.0
        )
        return out.at(np.array([300.0]), 0.0)[0]

    model_temperature()
    t0 = process_time()
    a = model_temperature()
    fast = process_time() - t0
    t0 = process_time()
    b = baseline()
    slow = process_time() - t0
    print(
        f"300 s plunge: {fast:.3f} s; finite volumes with BDF {slow:.2f} s, ratio {slow / fast:.0f}"
    )
    print(f"largest difference at 300 s: {np.max(np.abs(a - b)):.4f} K")
    time_fit_model(slow)
    rng = np.random.default_rng(1)
    d = same_pairs(1)
    times, readings = simulate(d, 140.0, rng)
    runs = make_runs(d, times, readings, rng)
    t0 = process_time()
    fit = identify_plunges(runs, SETUP)
    print(
        f"two plunges, six channels, three correlations: {process_time() - t0:.2f} s (limit 10 s)"
    )
    print(fit.summary())
    assert np.max(np.abs(a - b)) < 0.02


if __name__ == "__main__":
    main()
