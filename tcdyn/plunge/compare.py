"""Plunges as the thesis compared them: what the junction saw, and what the correlations say with nothing fitted.

For figures 5.26 and 5.27 from one's own data, in Python: ``tcdyn.plots.draw_entry(run, traces, ax)`` draws them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.disk import DiskSetup
from immersion.correlations import THESIS_THREE, Bath
from immersion.correlations import correlation as find_correlation
from immersion.cylinder import Cylinder
from immersion.radial import simulate_plunge_model
from tcdyn.plunge.result import PlungeFit
from tcdyn.plunge.run import PlungeRun, make_blocks

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JunctionTraces:
    """Temperatures (n, C) at the junctions against time after entry (n,), in the order of ``channels``."""

    name: str
    channels: tuple[str, ...]
    time_s: Array
    temperature_degC: Array


def junction_traces(fit: PlungeFit, run: int) -> JunctionTraces:
    """What the junctions of one plunge really saw by the fit: conduction without the chain."""
    best, lay = fit.optimum, fit.optimum.problem.layout
    model, surface = best.problem.models[run], best.surfaces[run]
    own = best.theta[lay.run(run)]
    q = surface.flux_W_m2
    shift = best.theta[lay.depth] - model.depth_shift_m
    rise = model.junction @ q + (best.theta[lay.ln_k] - model.ln_k) * (model.junction_k @ q)
    rise = rise + shift[:, None] * (model.junction_depth @ q)
    return JunctionTraces("fitted, at the junction", fit.channels, model.grid_s + own[5], (own[6] + rise).T)


def uncalibrated_traces(
    run: PlungeRun, setup: DiskSetup, correlations: Sequence[str] = THESIS_THREE
) -> tuple[JunctionTraces, ...]:
    """Junction temperatures by each correlation as published: h scale one, no burst, no lag (figures 5.26, 5.27)."""
    blocks = make_blocks(run)
    depths = [setup.junctions[c].depth_m for c in run.channels]
    initial = float(np.mean(blocks.readings_degC[blocks.time_s < 0]))
    disk = Cylinder.from_setup(setup)
    out = []
    for name in correlations:
        chosen = find_correlation(name)
        bath = Bath(run.fluid, chosen, setup.width_m, 2 * setup.outer_radius_m)
        plunge = simulate_plunge_model(
            disk,
            depths,
            lambda T, F, t, bath=bath: bath.h_W_m2K(T, F),  # type: ignore[misc]
            initial,
            lambda t: np.interp(t, blocks.bath_time_s, blocks.bath_degC),
            blocks.duration_s,
        )
        out.append(JunctionTraces(f"{name} {chosen.title}", run.channels, plunge.t_s, plunge.junction_degC))
    return tuple(out)
