"""Fits of many simulated pairs, with errors against stated uncertainties; used by the study tests
and by hand."""

from __future__ import annotations

import numpy as np
from plunge_simulator import Draws, simulate

from immersion.entry import EntryEvent
from immersion.fluids import fluid
from immersion.plunge_data import PlungeRun
from immersion.plunge_fit import identify_plunges
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.rigfile import load_rig

OWN_LAG_S = 2 / (2 * np.pi * 4.0)


def make_runs(
    d: Draws,
    times: np.ndarray,
    readings: np.ndarray,
    rng: np.random.Generator,
    entry_u_s: float = 0.05,
    fluid_name: str = "mobil-jet-ii",
) -> list[PlungeRun]:
    """One PlungeRun per plunge; the entry event has an error of its own u, the bath thermometer of
    0.5 K (1 sigma)."""
    runs = []
    substance = fluid(fluid_name)
    for k in range(len(d.bath)):
        event = EntryEvent(100 + entry_u_s * rng.standard_normal(), entry_u_s, None, None, "drawn")
        bath = d.bath[k] + 0.5 * rng.standard_normal() + 0.05 * rng.standard_normal(len(times))
        runs.append(
            PlungeRun(times + 100, readings[:, k].astype(float), CHANNELS, substance, bath, event)
        )
    return runs


def study(
    d: Draws, after_s: float, rng: np.random.Generator, alternatives: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """Errors and stated u of the common lag (pairs,) and of the differential lags (pairs, 6)."""
    times, readings = simulate(d, after_s, rng)
    runs = make_runs(d, times, readings, rng)
    setup = load_rig().disk_setup("fast")
    rows: dict[str, list] = {"common": [], "u_common": [], "differential": [], "u_differential": []}
    for pair in range(len(d.bath) // 2):
        fit = identify_plunges(runs[2 * pair : 2 * pair + 2], setup, alternatives=alternatives)
        true_lags = d.tau1[2 * pair] + d.tau2[2 * pair] + OWN_LAG_S
        rows["common"].append(fit.common_lag_s.value - true_lags.mean())
        rows["u_common"].append(fit.common_lag_s.u)
        rows["differential"].append(
            [fit.differential_lag_s[c].value for c in CHANNELS] - (true_lags - true_lags.mean())
        )
        rows["u_differential"].append([fit.differential_lag_s[c].u for c in CHANNELS])
    return {k: np.array(v) for k, v in rows.items()}


def describe(result: dict[str, np.ndarray]) -> str:
    """Summary in one line."""
    zc = result["common"] / result["u_common"]
    zd = result["differential"] / result["u_differential"]
    return (
        f"{len(zc)} pairs: common lag {np.mean(result['common']):+.3f} +- "
        f"{np.std(result['common']):.3f} s, stated u "
        f"{np.sqrt(np.mean(result['u_common'] ** 2)):.3f}, covered "
        f"{100 * np.mean(np.abs(zc) < 1.96):.0f} %; differential rms "
        f"{np.sqrt(np.mean(result['differential'] ** 2)):.4f} s, stated u "
        f"{np.sqrt(np.mean(result['u_differential'] ** 2)):.4f}, covered "
        f"{100 * np.mean(np.abs(zd) < 1.96):.0f} %"
    )
