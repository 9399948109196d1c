"""An EHL test of the synthetic rig: its draw, then warm running, loading, unloading and cooling of both disks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.rig.contact import hertz_contact
from tcdyn.rig.disk import DISKS
from tcdyn.simulate.implicit import Solution, Stepping, integrate, steady_state
from tcdyn.simulate.measure import log_disk, quantised, sample_times
from tcdyn.simulate.mesh import DiskMesh, DiskSystem
from tcdyn.simulate.programme import EhlCondition, ehl_test
from tcdyn.simulate.round import seen_round, uneven_system
from tcdyn.simulate.truth import DiskTruth, RigTruth, draw_truth, rng_for

AGAIN_RISE_S = 0.01  # a contact after the parting comes and goes in this time
STUDY_MESH = DiskMesh(radial=32, axial=40)  # three times faster than the default, 0.02 K from it


@dataclass(frozen=True)
class EhlOptions:
    """Times of a test [s] and what to hold fixed; None leaves a value to the draw.

    ``brake_s``: from the parting both speeds fall to 1/e in this time; ``again_s``: (length, time after the parting) of
    contacts after it.
    """

    load_on_s: float = 50.0
    unload_s: float = 1050.0
    duration_s: float = 1400.0
    parting_s: float = 0.02  # friction falls over this time, centred at the unloading
    loading_s: float = 0.3
    ambient_degC: float = 60.5
    brake_s: float | None = None
    again_s: tuple[tuple[float, float], ...] = ()
    beta: float | None = None
    h_fast_W_m2K: float | None = None
    friction_N: float | None = None
    mesh: DiskMesh = field(default_factory=DiskMesh)
    stepping: Stepping = field(default_factory=Stepping)


@dataclass(frozen=True)
class EhlTruth:
    """What one test really did; ``drift`` says whether friction, ambient and oil wander."""

    test: EhlCondition
    beta: float
    h_fast_W_m2K: float
    h_slow_W_m2K: float
    half_width_m: float
    pressure_Pa: float  # greatest of the contact
    friction_N: float  # nominal level, before drift
    load_on_s: float
    unload_s: float
    parting_s: float
    loading_s: float
    ambient_degC: float
    phases: tuple[float, ...]
    drift: bool
    speed_exponent: float
    brake_s: float | None = None
    again_s: tuple[tuple[float, float], ...] = ()

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which friction or speed has a kink, those of loading and parting first."""
        touched = [
            b
            for on, off in self.touches_s
            for b in (on, on + AGAIN_RISE_S, off - AGAIN_RISE_S, off)
        ]
        return (
            self.load_on_s,
            self.load_on_s + self.loading_s,
            self.unload_s - 0.5 * self.parting_s,
            self.unload_s + 0.5 * self.parting_s,
            *([] if self.brake_s is None else [self.unload_s]),
            *touched,
        )

    @property
    def touches_s(self) -> tuple[tuple[float, float], ...]:
        """Begin and end of the contacts after the parting [s]."""
        return tuple(
            (self.unload_s + after, self.unload_s + after + length)
            for length, after in self.again_s
        )

    def contact_share(self, t: Array) -> Array:
        """1 while loaded, 0 while apart, straight lines between; ``t`` (N,) in s."""
        on, up, off, apart = self.breaks_s[:4]
        rise = np.clip((t - on) / max(up - on, 1e-12), 0, 1)
        share = rise * (1 - np.clip((t - off) / max(apart - off, 1e-12), 0, 1))
        for on, off in self.touches_s:
            share = np.maximum(share, np.clip(np.minimum(t - on, off - t) / AGAIN_RISE_S, 0, 1))
        return np.asarray(share)

    def speed_share(self, t: Array) -> Array:
        """Both speeds as a share of what they were under load: one until the parting; ``t`` (N,) in s."""
        if self.brake_s is None:
            return np.ones_like(t)
        return np.exp(-np.clip(t - self.unload_s, 0, None) / self.brake_s)

    def film_share(self, t: Array) -> Array:
        """h of either disk as a share of what it was under load, h ~ u^n; ``t`` (N,) in s."""
        return self.speed_share(t) ** self.speed_exponent

    def friction_at(self, t: Array) -> Array:
        """True friction [N]: running-in over some minutes, then a slow wander of half a percent."""
        level = np.full_like(t, self.friction_N)
        if self.drift:
            p = self.phases
            run_in = 0.04 * np.exp(-np.clip(t - self.load_on_s, 0, None) / 150.0)
            wander = 0.004 * np.sin(2 * np.pi * (t / 310.0 + p[0])) + 0.003 * np.sin(
                2 * np.pi * (t / 97.0 + p[1])
            )
            level = level * (1 + run_in + wander)
        return level * self.contact_share(t)

    def ambient_at(self, t: Array) -> Array:
        """True temperature of the enclosure [degC]: slow drift, and a little warming by the loaded disks."""
        out = np.full_like(t, self.ambient_degC)
        if self.drift:
            p = self.phases
            out = (
                out
                + 0.3 * np.sin(2 * np.pi * (t / 900.0 + p[2]))
                + 0.1 * np.sin(2 * np.pi * (t / 333.0 + p[3]))
            )
            out = out + 0.005 * self.friction_N * self.test.sliding_speed_m_s * _first_order(
                t, self.load_on_s, self.unload_s, 260.0
            )
        return out


def draw_test(
    truth: RigTruth, test: EhlCondition, seed: int, options: EhlOptions | None = None
) -> EhlTruth:
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
    contact = hertz_contact(
        test.load_N, truth.fast.setup.outer_radius_m, truth.fast.setup.crown_radius_m
    )
    return EhlTruth(
        test=test,
        beta=o.beta if o.beta is not None else beta,
        h_fast_W_m2K=h_fast,
        h_slow_W_m2K=h_fast / truth.gear_ratio**truth.speed_exponent,
        half_width_m=contact.major_m * truth.half_width_scale,
        pressure_Pa=contact.pressure_Pa,
        friction_N=o.friction_N if o.friction_N is not None else friction,
        load_on_s=o.load_on_s + float(on),
        unload_s=o.unload_s + float(off),
        parting_s=o.parting_s,
        loading_s=o.loading_s,
        ambient_degC=ambient,
        phases=phases,
        drift=truth.imperfections.drift,
        speed_exponent=truth.speed_exponent,
        brake_s=o.brake_s,
        again_s=o.again_s,
    )


def _first_order(t: Array, on_s: float, off_s: float, tau_s: float) -> Array:
    up = 1 - np.exp(-np.clip(t - on_s, 0, None) / tau_s)
    down = 1 - np.exp(-np.clip(t - off_s, 0, None) / tau_s)
    return up - down


def simulate_ehl(
    test: str | EhlCondition = "B3",
    seed: int = 0,
    truth: RigTruth | None = None,
    options: EhlOptions | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Run one EHL test on the synthetic rig.

    Returns the log (canonical EHL columns, 75 Hz) and its truth: scalars (beta, h_fast, h_slow, load_on_s,
    unload_s, friction_N, steady temperatures, ...) and ``"traces"``, a DataFrame of the true junction
    temperatures, ambient, oil, friction and contact in the log's columns. ``truth`` is the rig (default
    ``draw_truth(seed)``).
    """
    condition = ehl_test(test) if isinstance(test, str) else test
    rig = truth or draw_truth(seed)
    o = options or EhlOptions()
    drawn = draw_test(rig, condition, seed, o)
    t = sample_times(o.duration_s)
    columns, traces = _conditions(t, drawn, rig, rng_for(seed, "conditions", condition.name))
    shares = {
        "fast": (drawn.beta, drawn.h_fast_W_m2K),
        "slow": (1 - drawn.beta, drawn.h_slow_W_m2K),
    }

    def logged(name: str) -> tuple[Array, Array, dict[str, Any]]:
        disk, rng = rig.disk(name), rng_for(seed, "measure", condition.name, name)
        at = disk_run(disk, drawn, *shares[name], o, o.duration_s)[1].at
        log, true = log_disk(
            lambda t: at(t)[:, : len(disk.channels)],
            o.duration_s,
            disk,
            rng,
            rig.imperfections,
            spikes=True,
        )
        return log, true, seen_round(disk, at(np.array([drawn.breaks_s[2]]))[0])

    uneven: dict[str, Any] = {}
    for name in shares:
        disk = rig.disk(name)
        log, true, uneven[name] = logged(name)
        for k, channel in enumerate(sorted(disk.channels)):
            columns[f"{name}_{channel}_degC"] = log[:, k]
            traces[f"{name}_{channel}_degC"] = true[:, k]
    last = ["ambient_degC", "oil_degC"]
    order = [c for c in columns if c not in last] + last
    frame = pd.DataFrame(columns)[order]
    trace_frame = pd.DataFrame(traces)[order]
    return frame, {**_scalars(drawn, rig, trace_frame), "unevenness": uneven, "traces": trace_frame}


def disk_run(
    disk: DiskTruth, drawn: EhlTruth, share: float, h: float, o: EhlOptions, until_s: float
) -> tuple[DiskSystem, Solution]:
    """One disk from the start of its test ``until_s``, at the film coefficient ``h`` [W/m2K]."""
    under = replace(disk.setup, flux=disk.setup.flux.under(drawn.pressure_Pa))
    system = uneven_system(replace(disk, setup=under), h, drawn.half_width_m, o.mesh)

    def power(t: Array) -> Array:
        return share * drawn.test.sliding_speed_m_s * drawn.speed_share(t) * drawn.friction_at(t)

    start = steady_state(system, 0.0, float(drawn.ambient_at(np.zeros(1))[0]))
    edges = 0.0, *sorted({b for b in drawn.breaks_s if 0 < b < until_s}), until_s
    return system, integrate(
        system, power, drawn.ambient_at, edges, start, o.stepping, drawn.film_share
    )


def _conditions(
    t: Array, drawn: EhlTruth, rig: RigTruth, rng: np.random.Generator
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Time, load, friction, contact, speeds, ambient and oil, as they are logged and as they were."""
    how, n = rig.imperfections, len(t)
    late = rng.uniform(-0.02, 0.02, 4) if how.timing else np.zeros(4)
    noise = rng.standard_normal((6, n)) * (1.0 if how.noise else 0.0)
    zero_load, zero_friction = rng.uniform(-1, 1, 2) * ([4.0, 0.08] if how.static else [0.0, 0.0])
    oil = np.full(n, 60.0)
    if how.drift:
        oil = (
            oil
            + 0.4 * np.sin(2 * np.pi * (t / 700.0 + drawn.phases[4]))
            + 0.2 * drawn.contact_share(t)
        )

    def rows(
        load: Array, friction: Array, on_s: float, off_s: float, ambient: Array
    ) -> dict[str, Array]:
        """Columns in the log's order; speeds and oil as they were."""
        return {
            "time_s": t,
            "load_N": load,
            "friction_N": friction,
            "contact": _within(t, [(on_s, off_s), *drawn.touches_s]),
            "speed_fast_rpm": drawn.test.speed_fast_rpm * drawn.speed_share(t),
            "speed_slow_rpm": drawn.test.speed_slow_rpm * drawn.speed_share(t),
            "ambient_degC": ambient,
            "oil_degC": oil,
        }

    def digitised(values: Array, full_scale: float) -> Array:
        return quantised(values, -full_scale, full_scale) if how.quantise else values

    ambient, load_N = drawn.ambient_at(t), drawn.test.load_N
    true = rows(
        load_N * drawn.contact_share(t),
        drawn.friction_at(t),
        drawn.load_on_s,
        drawn.unload_s,
        ambient,
    )
    logged = rows(
        digitised(load_N * drawn.contact_share(t - late[0]) + zero_load + 6.0 * noise[0], 5000.0),
        digitised(
            rig.friction_scale * drawn.friction_at(t - late[1]) + zero_friction + 0.15 * noise[1],
            100.0,
        ),
        drawn.load_on_s + 0.5 * abs(late[2]),
        drawn.unload_s + late[3],
        ambient + rig.ambient_bias_K + 0.1 * noise[4],
    )
    for column, size, k in (("speed_fast_rpm", 1.5, 2), ("speed_slow_rpm", 0.5, 3)):
        logged[column] = np.round(logged[column] + size * noise[k], 1)
    logged["oil_degC"] = oil + 0.1 * noise[5]
    return logged, true


def _within(t: Array, stretches: Sequence[tuple[float, float]]) -> Array:
    """1 inside any of the stretches, else 0; (N,)."""
    return np.any([(t >= start) & (t < stop) for start, stop in stretches], axis=0).astype(float)


def _scalars(drawn: EhlTruth, rig: RigTruth, traces: pd.DataFrame) -> dict[str, Any]:
    t = traces["time_s"].to_numpy()
    last = (t < drawn.unload_s - drawn.parting_s) & (t >= drawn.unload_s - 5.0)
    mean = {c.removesuffix("_degC"): float(traces.loc[last, c].mean()) for c in traces.columns}
    return {
        "test": drawn.test.name,
        "beta": drawn.beta,
        "h_fast": drawn.h_fast_W_m2K,
        "h_slow": drawn.h_slow_W_m2K,
        "exponent": rig.speed_exponent,
        "half_width_m": drawn.half_width_m,
        "load_N": drawn.test.load_N,
        "friction_N": mean["friction_N"],
        "friction_at_unloading_N": float(drawn.friction_at(np.array([drawn.breaks_s[2]]))[0]),
        "sliding_speed_m_s": drawn.test.sliding_speed_m_s,
        "entraining_speed_m_s": drawn.test.entraining_speed_m_s,
        "load_on_s": drawn.load_on_s,
        "unload_s": drawn.unload_s,
        "parting_s": drawn.parting_s,
        "brake_s": drawn.brake_s,
        "again_s": drawn.again_s,
        "ambient_degC": mean["ambient"],
        "steady_degC": {c: value for c, value in mean.items() if c.startswith(("fast_", "slow_"))},
        "common_lag_s": {d: rig.disk(d).common_lag_s for d in DISKS},
        "lag_s": {d: rig.disk(d).lags_s for d in DISKS},
    }
