"""Bias of the boundary profiles: rim fits of (beta, h) to noise-free junctions of the full-disk
model.

``python -m tests.heat.profile_study`` prints the bias of each profile and disk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from tcdyn.heat.engine import RimInputs
from tcdyn.heat.modal import rim_gains
from tcdyn.heat.rim import InputJump, Mesh, Profile, Rim, basis_rates, junction_points
from tcdyn.simulate.implicit import Stepping, integrate, steady_state
from tcdyn.simulate.mesh import DiskMesh, build_system
from tcdyn.simulate.truth import DiskTruth, draw_truth
from tests.heat.reference_run import respond

DT_S = 1 / 75
UNLOAD_S = 400.0
AMBIENT = 55.0


@dataclass(frozen=True)
class ProfileBias:
    """Bias of a rim fit: beta relative, h relative, and the rms misfit of the three outer junctions
    [K]."""

    disk: str
    profile: Profile
    beta_rel: float
    h_rel: float
    rms_K: float


def simulated_record(
    disk: DiskTruth, h: float, power_W: float, half_width_m: float, mesh: DiskMesh
) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) and true junction temperatures (N, 6) around the unloading at ``UNLOAD_S``; heat
    is on from zero."""
    system = build_system(disk, h, half_width_m, mesh)
    start = steady_state(system, 0.0, AMBIENT)
    stepping = Stepping(first_s=1 / 300, largest_s=1.0, growth=0.05)
    solution = integrate(
        system,
        lambda t: np.where(t < UNLOAD_S, power_W, 0.0),
        lambda t: np.full(np.shape(t), AMBIENT),
        (0.0, UNLOAD_S, UNLOAD_S + 15.0),
        start,
        stepping,
    )
    time = UNLOAD_S - 20.0 + DT_S * np.arange(int(32 / DT_S))
    return time, solution.at(time)


@dataclass(frozen=True)
class Case:
    """A noise-free record of one disk and its true parameters."""

    disk: DiskTruth
    h: float
    power_W: float
    half_width_m: float
    time_s: np.ndarray
    traces: np.ndarray  # (N, 6), channels a to f

    def read(self, channels: str) -> list[np.ndarray]:
        """Traces of these channels."""
        return [self.traces[:, "abcdef".index(c)] for c in channels]


def bias(case: Case, profile: Profile, mesh: Mesh) -> ProfileBias:
    """Fit share and h to the outer row from 10 s before to 10 s after unloading, and compare with
    the truth."""
    n = len(case.time_s)
    steps = (UNLOAD_S - case.time_s[0]) / DT_S
    index = int(steps)
    heat = np.where(np.arange(n) <= index, case.power_W, 0.0)
    unloading = InputJump(index, steps - index, case.power_W, 0.0)
    drive = RimInputs(DT_S, heat, *case.read("dbf"), np.full(n, AMBIENT), jumps=(unloading,))
    rates = basis_rates(DT_S)
    window = slice(int(10 / DT_S), int(30 / DT_S))
    bases = [drive.lag_responses(k, rates)[window] for k in range(5)]
    inputs = drive.inputs[window]
    observed = np.stack(case.read("ace"), axis=1)[window]
    rim = Rim.from_setup(case.disk.setup)
    points = junction_points(case.disk.setup, "ace")

    def misfit(p: np.ndarray) -> np.ndarray:
        gains = rim_gains(
            rim, p[1] * case.h, points, case.half_width_m, rates, profile=profile, mesh=mesh
        )
        scaled = replace(gains, gains=gains.gains * np.array([p[0], 1, 1, 1, 1])[:, None, None])
        return (respond(scaled, bases, inputs) - observed).ravel()

    fit = least_squares(misfit, [1.0, 1.0])
    rms = float(np.sqrt(np.mean(fit.fun**2)))
    return ProfileBias(case.disk.setup.name, profile, float(fit.x[0] - 1), float(fit.x[1] - 1), rms)


def cases(mesh: DiskMesh | None = None) -> list[Case]:
    """Both disks of a rig similar to test B3: half-width 1.63 mm, 230 W and 100 W."""
    truth = draw_truth(3, exponent=0.667)
    result = []
    for name, h, power in (("fast", 740.0, 230.0), ("slow", 282.0, 100.0)):
        disk = truth.disk(name)
        time, traces = simulated_record(disk, h, power, 1.63e-3, mesh or DiskMesh())
        result.append(Case(disk, h, power, 1.63e-3, time, traces))
    return result


if __name__ == "__main__":
    for case in cases():
        for kind in ("quadratic", "quartic", "modal"):
            row = bias(case, kind, Mesh())
            print(
                f"{row.disk:5s} {row.profile:10s} beta {row.beta_rel:+.4%}  h {row.h_rel:+.3%} "
                f" rms {row.rms_K:.4f} K"
            )
