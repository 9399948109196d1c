"""Tests of drawn rigs in worlds that each break one assumption of the fits, by an independent
solver.

The disk from bore to running surface, finite volumes in (r, z), a two-stage L-stable step. The
solver shares nothing with the fits or the synthetic rig. `python -m tests.partition.world_study
COUNT SEED [WORLD ...]` prints for each world whether the range over the model forms contains the
truth, its width, the best form and the messages.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from scipy.interpolate import CubicSpline
from scipy.sparse import coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.measure import log_disk
from tcdyn.simulate.truth import DiskTruth, draw_truth, rng_for
from tests.partition.study_rigs import QUICK, StudyRig, study_rig

RADIAL = 44
AXIAL = 36
GAMMA = 1 - 2**-0.5
SHAFT_W_m2K = 260.0  # heat transfer coefficient from the bore to a shaft that stays near ambient
REFRESH_S = 0.4  # interval at which temperature-dependent coefficients are updated


@dataclass(frozen=True)
class World:
    """Deviations from the assumptions of the fits.

    ``later_s`` is added to the first lag of one channel, ``film`` multiplies h in equal strips
    across the running surface. ``h_after_of`` multiplies h of one disk after the unloading,
    ``gain_of`` the readings of all its channels. ``loading_s`` is the time in which the load is
    applied.
    """

    h_after: float = 1.0
    h_after_of: dict[str, float] = field(default_factory=dict)
    gain_of: dict[str, float] = field(default_factory=dict)
    h_per_K: float = 0.0
    shift_m: float = 0.0
    wider: float = 1.0
    faces: float = 1.0
    oil_K: float = 0.0
    stem: float = 0.0
    later_s: dict[str, float] = field(default_factory=dict)
    loading_s: float = 0.3
    k_per_K: float = 0.0
    elsewhere: float = 0.0
    film: tuple[float, ...] = (1.0,)

    @property
    def follows(self) -> bool:
        """Whether a coefficient depends on the temperature."""
        return bool(self.h_per_K or self.k_per_K)


WORLDS: dict[str, tuple[World, str]] = {
    "as assumed": (World(), "as assumed"),
    "h -5 %": (World(h_after=0.95), "h_step"),
    "h -25 %": (World(h_after=0.75), "h_step"),
    "h of the slow disk -25 %": (World(h_after_of={"slow": 0.75}), "h_step"),
    "h of the fast disk -25 %": (World(h_after_of={"fast": 0.75}), "h_step"),
    "gains +3 and -3 %": (World(gain_of={"fast": 1.03, "slow": 0.97}), "gain"),
    "h +0.4 %/K": (World(h_per_K=0.004), "h_of_T"),
    "flux 0.5 mm": (World(shift_m=0.5e-3), "flux_shift"),
    "flux 1 mm": (World(shift_m=1e-3), "flux_shift"),
    "flux x2": (World(wider=2.0), "flux_wider"),
    "faces x3": (World(faces=3.0), "faces"),
    "oil +8 K": (World(oil_K=8.0), "film_air"),
    "oil -8 K": (World(oil_K=-8.0), "film_air"),
    "stem 3 %": (World(stem=0.03), "stem"),
    "bubble 0.15 s": (World(later_s={"fast_e": 0.15}), "lag of fast_e"),
    "bubble 0.6 s": (World(later_s={"fast_e": 0.6}), "lag of fast_e"),
    "bubble 0.6 s of a": (World(later_s={"slow_a": 0.6}), "lag of slow_a"),
    "bubble 0.6 s of b": (World(later_s={"slow_b": 0.6}), "lag of slow_b"),
    "loaded in 10 s": (World(loading_s=10.0), "as assumed"),
    "loaded in 100 s": (World(loading_s=100.0), "as assumed"),
    "loaded in 300 s": (World(loading_s=300.0), "as assumed"),
    "k -10 %": (World(k_per_K=-0.001), "k_of_T"),
    "15 % elsewhere": (World(elsewhere=0.15), "elsewhere"),
    "film 1.5 | 0.5": (World(film=(1.5, 0.5)), "as assumed"),
    "film at the track": (World(film=(0.75, 1.5, 0.75)), "as assumed"),
    "film off the track": (World(film=(1.25, 0.5, 1.25)), "as assumed"),
}


def temperatures(
    disk: DiskTruth,
    world: World,
    time_s: Array,
    power_W: Array,
    ambient: Array,
    h: float,
    half_width_m: float,
    unload_s: float,
) -> Callable[[Array], Array]:
    """True junction temperatures of a disk, as a function of times (M,) -> (M, 6).

    ``power_W`` (N,) heats the disk up to the unloading at ``unload_s``. The last full value is held
    until then.
    """
    s = disk.setup
    # a few cells of equal area are sufficient inside
    r = np.linspace(s.bore_radius_m**2, s.outer_radius_m**2, 6)
    edges_r = np.unique(
        np.concatenate([np.sqrt(r[:3]), np.linspace(np.sqrt(r[2]), s.outer_radius_m, RADIAL)])
    )
    edges_z = np.linspace(0.0, s.width_m, AXIAL + 1)
    at_r = 0.5 * (edges_r[1:] + edges_r[:-1])
    at_z = 0.5 * (edges_z[1:] + edges_z[:-1])
    dz = np.diff(edges_z)
    n_r = len(at_r)
    cells = np.arange(n_r * AXIAL).reshape(n_r, AXIAL)
    area = np.pi * np.diff(edges_r**2)
    capacity = (s.density_kg_m3 * s.specific_heat_J_kgK * np.outer(area, dz)).ravel()
    x = np.clip((edges_z - s.width_m / 2 - world.shift_m) / (half_width_m * world.wider), -1, 1)
    heat = np.zeros(cells.size)
    heat[cells[-1]] = np.diff(0.75 * (x - x**3 / 3))
    strip = np.asarray(world.film)[
        np.minimum((at_z / s.width_m * len(world.film)).astype(int), len(world.film) - 1)
    ]
    film_area = 2 * np.pi * s.outer_radius_m * dz
    washer = world.faces * s.washer_conductivity_W_mK / s.washer_thickness_m

    def assembled(h_now: float, k: float) -> tuple[csc_matrix, Array, Array]:
        """Conductances (n, n), conductances to the ambient and to the air at the surface (n,)."""
        in_r = np.outer(2 * np.pi * k / np.log(at_r[1:] / at_r[:-1]), dz)
        in_z = np.outer(k * area, 2 / (dz[1:] + dz[:-1]))
        ij = [(cells[:-1], cells[1:], in_r), (cells[:, :-1], cells[:, 1:], in_z)]
        i, j, g = (np.concatenate([np.ravel(part[q]) for part in ij]) for q in range(3))
        ground = np.zeros(cells.size)
        film = np.zeros(cells.size)
        film[cells[-1]] = film_area / (1 / (h_now * strip) + (s.outer_radius_m - at_r[-1]) / k)
        for face in (0, -1):
            ground[cells[:, face]] += area / (1 / washer + 0.5 * dz[0] / k)
        to_shaft = 2 * np.pi * s.bore_radius_m * dz
        ground[cells[0]] += to_shaft / (1 / SHAFT_W_m2K + (at_r[0] - s.bore_radius_m) / k)
        diagonal = np.arange(cells.size)
        matrix = coo_matrix(
            (
                np.concatenate([-g, -g, g, g, ground + film]),
                (np.concatenate([i, j, i, j, diagonal]), np.concatenate([j, i, i, j, diagonal])),
            ),
        ).tocsc()
        return matrix, ground, film

    oil_offset_K = world.oil_K
    k0 = s.conductivity_W_mK
    reference: list[float] = []

    def state_of(y: Array, after: bool) -> tuple[float, float]:
        surface = float(y[cells[-1]].mean())
        mean = float(y[cells].mean())
        h_now = h * (world.h_after if after else 1.0)
        if world.h_per_K and reference:
            h_now *= max(1 + world.h_per_K * (surface - reference[0]), 0.2)
        return h_now, k0 * (1 + world.k_per_K * (mean - 20.0))

    def load(t: Array | float, ground: Array, film: Array, on: bool) -> Array:
        air = np.interp(t, time_s, ambient)
        power = np.interp(t, time_s, held_power_W) if on else 0.0
        return heat * power * (1 - world.elsewhere) + ground * air + film * (air + oil_offset_K)

    # the power just before unloading is replaced by its last full value
    loaded = time_s < unload_s - 0.05
    held_power_W = np.where(loaded, power_W, power_W[loaded][-1])
    on_s = float(time_s[np.flatnonzero(power_W > 0)[0]])
    segments_of_time = [
        (0.0, on_s, 5.0, False),
        (on_s, on_s + 20, 0.1, True),
        (on_s + 20, unload_s - 8, 1.0, True),
        (unload_s - 8, unload_s, 0.05, True),
        (unload_s, unload_s + 1.5, 1 / 200, False),
        (unload_s + 1.5, float(time_s[-1]), 1 / 40, False),
    ]
    y = np.full(cells.size, float(ambient[0]))
    read_junctions = _reader(disk, at_r, at_z)
    times_by_segment = []
    readings_by_segment = []
    for start, stop, step, on in segments_of_time:
        after = start >= unload_s
        count = max(int(np.ceil((stop - start) / step)), 1)
        dt = (stop - start) / count
        since_refresh_s = 0.0
        segment_t = [start]
        segment = [read_junctions(y)]
        for n in range(count):
            if n == 0 or (world.follows and since_refresh_s >= REFRESH_S):
                matrix, ground, film = assembled(*state_of(y, after))
                solver = splu((diags(capacity) + GAMMA * dt * matrix).tocsc())
                since_refresh_s = 0.0
            t = start + n * dt
            first = solver.solve(load(t + GAMMA * dt, ground, film, on) - matrix @ y)
            mid = y + (1 - GAMMA) * dt * first
            second = solver.solve(load(t + dt, ground, film, on) - matrix @ mid)
            y = mid + GAMMA * dt * second
            since_refresh_s += dt
            segment_t.append(t + dt)
            segment.append(read_junctions(y))
        if world.h_per_K and start < unload_s <= stop + 1e-9:
            reference.append(float(y[cells[-1]].mean()))
        times_by_segment.append(np.array(segment_t))
        readings_by_segment.append(np.array(segment))

    def at(times: Array) -> Array:
        out = np.empty((len(times), len(CHANNELS)))
        for segment_t, segment in zip(times_by_segment, readings_by_segment):
            inside = (times >= segment_t[0] - 1e-9) & (times <= segment_t[-1] + 1e-9)
            out[inside] = CubicSpline(segment_t, segment)(times[inside])
        air = np.interp(times, time_s, ambient)[:, None]
        return out - world.stem * (out - air)

    return at


def _reader(disk: DiskTruth, at_r: Array, at_z: Array) -> Callable[[Array], Array]:
    """Function that interpolates a field (n,) at the six junctions a to f by cubic splines."""
    s = disk.setup
    positions = [(s.outer_radius_m - s.junctions[c].depth_m, s.junctions[c].z_m) for c in CHANNELS]
    weights = []
    eye_r = np.eye(len(at_r))
    eye_z = np.eye(len(at_z))
    for rho, z in positions:
        weights.append(np.outer(CubicSpline(at_r, eye_r)(rho), CubicSpline(at_z, eye_z)(z)).ravel())
    weight_matrix = np.array(weights)
    return lambda y: weight_matrix @ y


def world_rig(seed: int, name: str, test: str = "B3") -> StudyRig:
    """Rig ``seed`` in the world ``name``: a log with the temperatures of that world and the
    calibrated records."""
    world, _ = WORLDS[name]
    options = replace(QUICK, loading_ramp_s=world.loading_s)
    true = draw_truth(seed, load_rig(), uncertain=True)
    true_values: dict[str, Any] = {}

    def with_world_temperatures(frame: pd.DataFrame) -> pd.DataFrame:
        traces = true_values["traces"]
        t = traces["time_s"].to_numpy()
        columns = {}
        for d in DISKS:
            share = true_values["beta"] if d == "fast" else 1 - true_values["beta"]
            power = share * true_values["sliding_speed_m_s"] * traces["friction_N"].to_numpy()
            disk = true.disk(d)
            junction_temperatures = temperatures(
                disk,
                replace(world, h_after=world.h_after * world.h_after_of.get(d, 1.0)),
                t,
                power,
                traces["ambient_degC"].to_numpy(),
                true_values[f"h_{d}"],
                true_values["half_width_m"],
                true_values["unload_s"],
            )
            channels = {
                c: replace(channel, tau1_s=channel.tau1_s + world.later_s.get(f"{d}_{c}", 0.0))
                for c, channel in disk.channels.items()
            }
            lagged_disk = replace(disk, channels=channels)
            log, _ = log_disk(
                junction_temperatures,
                options.duration_s,
                lagged_disk,
                rng_for(seed, "world", d),
                true.imperfections,
                True,
            )
            gain = world.gain_of.get(d, 1.0)
            columns |= {
                f"{d}_{c}_degC": gain * log[:, k] for k, c in enumerate(sorted(disk.channels))
            }
        return frame.assign(**columns)

    return study_rig(
        seed,
        test,
        truth=true,
        options=options,
        log_change=with_world_temperatures,
        on_truth=true_values.update,
    )


def run_case(seed: int, name: str) -> dict[str, Any]:
    """Result of one rig in one world."""
    warnings.simplefilter("ignore")
    row: dict[str, Any] = {"seed": seed, "world": name}
    try:
        study = world_rig(seed, name)
        analysis = study.analyse()
    except InputError as problem:
        return row | {"refused": str(problem)}
    forms = analysis.model_forms
    both = analysis.combined.estimates["beta"]
    error = both.value - study.true_values["beta"]
    best = max(forms.forms, key=lambda form: form.log_odds)
    return row | {
        "error": error,
        "z": error / both.u,
        "covered": forms.low95 <= study.true_values["beta"] <= forms.high95,
        "half_width": 0.5 * (forms.high95 - forms.low95),
        "best": best.name,
        "log_odds": best.log_odds,
        "correct": best.name == WORLDS[name][1] or best.name == "as assumed" == WORLDS[name][1],
        "preferred": forms.preferred.name if forms.preferred else "",
        "status": analysis.status,
        "estimate_holds": forms.estimate_holds,
        "suspects": ", ".join(
            f"{s.disk} {s.kind} {'-'.join(s.channels)} {s.size.value if s.size else 0.0:.3g}"
            for s in (analysis.sensors.suspects if analysis.sensors else ())
        ),
        "codes": " ".join(f.code for f in analysis.findings if f.severity.value != "info"),
        "speed_law_z": forms.forms[0].speed_law_z,
    }


def run_study(count: int, first: int, names: list[str], n_jobs: int = 2) -> pd.DataFrame:
    """A row for each rig in each world."""
    jobs = [(seed, name) for name in names for seed in range(first, first + count)]
    return pd.DataFrame(Parallel(n_jobs=n_jobs)(delayed(run_case)(*job) for job in jobs))


if __name__ == "__main__":
    table = run_study(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:] or list(WORLDS))
    print(table.drop(columns=["seed"]).round(4).to_string())
    print("covered", table["covered"].mean(), "of", table["covered"].count())
