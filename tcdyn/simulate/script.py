"""What happens in one EHL test: its draw, and friction and ambient temperature as functions of time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tcdyn.contact import half_width_m
from tcdyn.simulate.implicit import Stepping
from tcdyn.simulate.mesh import DiskMesh
from tcdyn.simulate.programme import EhlCondition
from tcdyn.simulate.truth import RigTruth, rng_for

Array = NDArray[np.float64]
STUDY_MESH = DiskMesh(radial=32, axial=40)  # three times faster than the default, 0.02 K from it


@dataclass(frozen=True)
class EhlOptions:
    """Times of a test [s] and what to hold fixed; None leaves a value to the draw."""

    load_on_s: float = 50.0
    unload_s: float = 1050.0
    duration_s: float = 1400.0
    parting_s: float = 0.02  # friction falls over this time, centred at the unloading
    loading_s: float = 0.3
    ambient_degC: float = 60.5
    beta: float | None = None
    h_fast_W_m2K: float | None = None
    friction_N: float | None = None
    mesh: DiskMesh = field(default_factory=DiskMesh)
    stepping: Stepping = field(default_factory=Stepping)


@dataclass(frozen=True)
class EhlTruth:
    """What one test really did."""

    test: str
    beta: float
    h_fast_W_m2K: float
    h_slow_W_m2K: float
    half_width_m: float
    load_N: float
    friction_N: float  # nominal level, before drift
    sliding_speed_m_s: float
    entraining_speed_m_s: float
    load_on_s: float
    unload_s: float
    parting_s: float
    loading_s: float
    ambient_degC: float
    phases: tuple[float, ...]

    @property
    def breaks_s(self) -> tuple[float, float, float, float]:
        """Instants at which the friction has a kink."""
        return (
            self.load_on_s,
            self.load_on_s + self.loading_s,
            self.unload_s - 0.5 * self.parting_s,
            self.unload_s + 0.5 * self.parting_s,
        )

    def contact_share(self, t: Array) -> Array:
        """1 while loaded, 0 while apart, straight lines between; ``t`` (N,) in s."""
        on, up, off, apart = self.breaks_s
        rise = np.clip((t - on) / max(up - on, 1e-12), 0, 1)
        return np.asarray(rise * (1 - np.clip((t - off) / max(apart - off, 1e-12), 0, 1)))

    def friction_at(self, t: Array, drift: bool) -> Array:
        """True friction [N]: running-in over some minutes, then a slow wander of half a percent."""
        level = np.full_like(t, self.friction_N)
        if drift:
            p = self.phases
            run_in = 0.04 * np.exp(-np.clip(t - self.load_on_s, 0, None) / 150.0)
            wander = 0.004 * np.sin(2 * np.pi * (t / 310.0 + p[0])) + 0.003 * np.sin(2 * np.pi * (t / 97.0 + p[1]))
            level = level * (1 + run_in + wander)
        return level * self.contact_share(t)

    def ambient_at(self, t: Array, drift: bool) -> Array:
        """True temperature of the enclosure [degC]: slow drift, and a little warming by the loaded disks."""
        out = np.full_like(t, self.ambient_degC)
        if drift:
            p = self.phases
            out = out + 0.3 * np.sin(2 * np.pi * (t / 900.0 + p[2])) + 0.1 * np.sin(2 * np.pi * (t / 333.0 + p[3]))
            out = out + 0.005 * self.friction_N * self.sliding_speed_m_s * _first_order(
                t, self.load_on_s, self.unload_s, 260.0
            )
        return out


def draw_test(truth: RigTruth, test: EhlCondition, seed: int, options: EhlOptions | None = None) -> EhlTruth:
    """Draw one test of the programme: beta and h about table 7.1, instants off the sample grid."""
    o = options or EhlOptions()
    rng = rng_for(seed, "test", test.name)
    beta = float(np.clip(test.beta + 0.01 * rng.standard_normal(), 0.64, 0.78))
    h_fast = float(test.h_fast_W_m2K * (1 + 0.04 * np.clip(rng.standard_normal(), -2, 2)))
    on, off = rng.uniform(-0.5, 0.5, 2)
    friction = float(test.friction_N * (1 + 0.01 * rng.standard_normal()))
    ambient = o.ambient_degC + float(rng.uniform(-0.7, 0.7))
    phases = tuple(float(p) for p in rng.uniform(0, 1, 6))
    h_fast = o.h_fast_W_m2K if o.h_fast_W_m2K is not None else h_fast
    width = half_width_m(test.load_N, truth.fast.setup.outer_radius_m, truth.fast.setup.crown_radius_m)
    return EhlTruth(
        test=test.name,
        beta=o.beta if o.beta is not None else beta,
        h_fast_W_m2K=h_fast,
        h_slow_W_m2K=h_fast / truth.gear_ratio**truth.speed_exponent,
        half_width_m=width * truth.half_width_scale,
        load_N=test.load_N,
        friction_N=o.friction_N if o.friction_N is not None else friction,
        sliding_speed_m_s=test.sliding_speed_m_s,
        entraining_speed_m_s=test.entraining_speed_m_s,
        load_on_s=o.load_on_s + float(on),
        unload_s=o.unload_s + float(off),
        parting_s=o.parting_s,
        loading_s=o.loading_s,
        ambient_degC=ambient,
        phases=phases,
    )


def _first_order(t: Array, on_s: float, off_s: float, tau_s: float) -> Array:
    up = 1 - np.exp(-np.clip(t - on_s, 0, None) / tau_s)
    down = 1 - np.exp(-np.clip(t - off_s, 0, None) / tau_s)
    return np.asarray(up - down)
