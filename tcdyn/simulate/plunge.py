"""Simulation of plunge tests: a disk in a bath, and the comparison of holes (section 5.4).

``tcdyn.simulate.campaign``, ``tcdyn simulate`` and the tests use it. The disk is solved by
``tcdyn.simulate.bath`` and logged by ``tcdyn.simulate.measure``. Spreads of the drawn values are
chosen by judgement. ``tests/simulate/test_plunge.py`` guards it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.rig.disk import Conditioning, DiskSetup
from tcdyn.simulate.bath import FluidName, Heating, heat_radially, natural_h_W_m2K
from tcdyn.simulate.measure import (
    OVERSAMPLING,
    RATE_Hz,
    chain_responses,
    fine_times,
    log_disk,
    quantise,
    sample_times,
)
from tcdyn.simulate.truth import Imperfections, RigTruth, draw_truth, rng_for


@dataclass(frozen=True)
class PlungeOptions:
    """Settings of a plunge; None leaves a value to the random draw.

    Parameters
    ----------
    entry_s
        Nominal instant of the entry [s].
    after_s
        Length of the record after the nominal entry [s].
    initial_degC
        Nominal temperature of the disk before the entry [degC].
    h_scale
        Factor on natural convection; drawn as 1 +- 0.06 (normal).
    burst
        Factor on h at the entry; drawn from 2 to 3.5.
    burst_decay_s
        Time constant of that factor [s]; drawn from 0.8 to 1.6 s.
    """

    entry_s: float = 20.0
    after_s: float = 140.0
    initial_degC: float = 26.0
    h_scale: float | None = None  # normal, 1 +- 0.06
    burst: float | None = None  # h multiplier at entry, 2 to 3.5
    burst_decay_s: float | None = None  # 0.8 to 1.6 s


@dataclass(frozen=True)
class PlungeTruth:
    """True values of one plunge; the field names are keys of the truth file.

    Parameters
    ----------
    fluid
        Fluid of the bath.
    bath_degC
        Temperature of the bath at the entry [degC].
    initial_degC
        Temperature of the disk before the entry [degC].
    entry_s
        Instant of the entry [s].
    duration_s
        Length of the record [s].
    h_scale, burst, burst_decay_s
        As in ``PlungeOptions``.
    bath_drift_K_s
        Rate of the bath temperature [K/s].
    bath_dip_K
        Fall of the bath temperature by the cold disk [K].
    fluid_bias_K
        Error of the bath thermometer [K].
    switch_s
        Instant at which the switch is pressed [s].
    switch_held
        Whether it stays pressed; otherwise it is released after 0.6 s.
    bounces
        Number of times that the switch opens for 20 ms.
    probe_entry_s, probe_lag_s
        Entry of the free probe and its lag [s].
    """

    fluid: FluidName
    bath_degC: float
    initial_degC: float
    entry_s: float
    duration_s: float
    h_scale: float
    burst: float
    burst_decay_s: float
    bath_drift_K_s: float
    bath_dip_K: float
    fluid_bias_K: float
    switch_s: float
    switch_held: bool
    bounces: int
    probe_entry_s: float
    probe_lag_s: float

    def bath_at(self, since_entry_s: Array | float) -> Array:
        """Return the bath temperature [degC]: steady drift, and a dip after the cold disk enters.

        Parameters
        ----------
        since_entry_s
            Times since the entry (N,) [s].

        Returns
        -------
        array
            Temperature (N,) [degC]. The dip has a time constant of 25 s.
        """
        after_entry_s = np.clip(since_entry_s, 0, None)
        dip = self.bath_dip_K * (1 - np.exp(-after_entry_s / 25.0))
        return np.asarray(self.bath_degC + self.bath_drift_K_s * np.asarray(since_entry_s) - dip)

    def h_at(self, since_entry_s: float, wall_degC: float, height_m: float) -> float:
        """Return h [W/m2K]: natural convection times its scale and the burst of the entry.

        Parameters
        ----------
        since_entry_s
            Time since the entry [s].
        wall_degC
            Temperature of the running surface [degC].
        height_m
            Height of the wall, the width of the disk [m].

        Returns
        -------
        float
            Heat transfer coefficient [W/m2K].

        Notes
        -----
        h = h_scale (1 + (burst - 1) exp(-t/burst_decay_s)) h_natural. The fit has the same form
        with its own correlation (``immersion``); another form here tests the fit against a wrong
        model.
        """
        bath_degC = float(self.bath_at(since_entry_s))
        natural = natural_h_W_m2K(self.fluid, wall_degC, bath_degC, height_m)
        burst = 1 + (self.burst - 1) * np.exp(-since_entry_s / self.burst_decay_s)
        return float(self.h_scale * burst * natural)


def draw_plunge(
    rng: np.random.Generator,
    fluid: FluidName,
    bath_degC: float,
    options: PlungeOptions,
    imperfections: Imperfections,
) -> PlungeTruth:
    """Draw the true values of one plunge.

    Parameters
    ----------
    rng
        Random numbers.
    fluid
        Fluid of the bath.
    bath_degC
        Temperature of the bath [degC].
    options
        Times and fixed values.
    imperfections
        Errors to simulate: ``timing``, ``drift`` and ``static`` are used.

    Returns
    -------
    PlungeTruth
        The values. The entry is off the sample grid by up to 0.5 s. The switch is pressed by hand,
        with a standard deviation of 0.15 s, and bounces in three of ten plunges.

    Notes
    -----
    All numbers are drawn at once, so that one option or error does not change the others. A new
    value takes a spare element of ``u`` (0 to 11, of which 10 and 11 are free); a longer array
    changes all logs of ``tests/behaviour``.
    """
    z = np.clip(rng.standard_normal(4), -2.5, 2.5)
    u = rng.uniform(0, 1, 12)
    entry = options.entry_s + (u[0] - 0.5)
    timing = 1.0 if imperfections.timing else 0.0
    drift = 1.0 if imperfections.drift else 0.0
    has_bounces = imperfections.timing and u[8] < 0.3
    return PlungeTruth(
        fluid=fluid,
        bath_degC=bath_degC,
        initial_degC=options.initial_degC + 2.0 * drift * (u[1] - 0.5),
        entry_s=float(entry),
        duration_s=options.entry_s + options.after_s,
        h_scale=options.h_scale if options.h_scale is not None else float(1 + 0.06 * z[0]),
        burst=options.burst if options.burst is not None else float(2.0 + 1.5 * u[2]),
        burst_decay_s=options.burst_decay_s
        if options.burst_decay_s is not None
        else float(0.8 + 0.8 * u[3]),
        bath_drift_K_s=float(drift * (-0.5 + 0.7 * u[4]) / 60.0),
        bath_dip_K=float(drift * 0.4 * u[5]),
        fluid_bias_K=float((0.6 * (u[6] - 0.5)) if imperfections.static else 0.0),
        switch_s=float(entry + timing * 0.15 * z[1]),
        switch_held=bool(u[7] < 0.5),
        bounces=int(1 + 3 * u[9]) if has_bounces else 0,
        probe_entry_s=float(entry + timing * 0.03 * z[2]),
        probe_lag_s=float(0.3 * (1 + 0.1 * z[3])),
    )


def simulate_plunge(
    disk: str = "fast",
    seed: int = 0,
    fluid: FluidName = "mobil-jet-ii",
    bath_degC: float = 110.0,
    run: int = 1,
    truth: RigTruth | None = None,
    options: PlungeOptions | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Simulate a plunge of one disk into a hot bath, insulated but for its running surface.

    Parameters
    ----------
    disk
        "fast" or "slow".
    seed
        Seed; the draws depend on it, the disk and ``run``.
    fluid
        Fluid of the bath.
    bath_degC
        Temperature of the bath [degC].
    run
        Number of the plunge.
    truth
        True values of the rig; None draws them from the seed.
    options
        Times and fixed values of the plunge; None for the defaults.

    Returns
    -------
    frame
        The log: canonical immersion columns, 75 Hz.
    truth
        True values (entry_s, h_scale, burst, lags, ...) and ``"traces"``, the true junction
        temperatures and bath in the columns of the log.
    """
    rig = truth or draw_truth(seed)
    disk_truth = rig.disk(disk)
    setup = disk_truth.setup
    errors = rig.imperfections
    rng = rng_for(seed, "plunge", disk, str(run))
    plunge_truth = draw_plunge(rng, fluid, bath_degC, options or PlungeOptions(), errors)
    names = sorted(setup.junctions)
    depths = np.array([setup.junctions[c].depth_m for c in names])
    heating = immersed_disk(setup, depths, plunge_truth)

    def truth_at(t: Array) -> Array:
        """Return the true junction temperatures (M, channels) [degC] at times ``t`` (M,) [s]."""
        return heating.at(t - plunge_truth.entry_s)

    log, true = log_disk(truth_at, plunge_truth.duration_s, disk_truth, rng, errors, spikes=False)
    columns = bath_columns(plunge_truth, errors, rng)
    traces: dict[str, Array] = {"time_s": columns["time_s"], "switch": columns["switch"]}
    traces["fluid_degC"] = plunge_truth.bath_at(columns["time_s"] - plunge_truth.entry_s)
    for k, channel in enumerate(names):
        columns[f"{channel}_degC"] = log[:, k]
        traces[f"{channel}_degC"] = true[:, k]
    values = vars(plunge_truth) | {
        "disk": disk,
        "run": run,
        "lag_s": disk_truth.lags_s,
        "common_lag_s": disk_truth.common_lag_s,
    }
    return pd.DataFrame(columns), {**values, "traces": pd.DataFrame(traces)}


def immersed_disk(setup: DiskSetup, depths: Array, plunge_truth: PlungeTruth) -> Heating:
    """Return the true temperatures of an immersed disk over the time since its entry.

    Parameters
    ----------
    setup
        Geometry and steel of the disk; its width is the height of the convecting wall.
    depths
        Depths below the running surface (D,) [m].
    plunge_truth
        True values of the plunge.

    Returns
    -------
    Heating
        Temperatures until the end of the record.
    """
    return heat_radially(
        setup,
        depths,
        plunge_truth.initial_degC,
        lambda t: float(plunge_truth.bath_at(t)),
        lambda t, wall: plunge_truth.h_at(t, wall, setup.width_m),
        plunge_truth.duration_s - plunge_truth.entry_s,
    )


def bath_columns(
    plunge_truth: PlungeTruth, imperfections: Imperfections, rng: np.random.Generator
) -> dict[str, Array]:
    """Return time, switch, free probe and bath thermometer as logged.

    Parameters
    ----------
    plunge_truth
        True values of the plunge.
    imperfections
        Errors to simulate: ``noise`` and ``quantise`` are used.
    rng
        Random numbers of the noise.

    Returns
    -------
    dict
        Columns (N,): time_s, switch, probe_degC, fluid_degC.
    """
    t = sample_times(plunge_truth.duration_s)
    noise = rng.standard_normal((2, len(t))) * (1.0 if imperfections.noise else 0.0)
    since_probe_entry = np.clip(t - plunge_truth.probe_entry_s, 0, None)
    response = 1 - np.exp(-since_probe_entry / plunge_truth.probe_lag_s)
    air = plunge_truth.initial_degC + 1.5
    bath = plunge_truth.bath_at(t - plunge_truth.entry_s)
    probe = air + (bath - air) * response + 0.1 * noise[0]
    fluid = bath + plunge_truth.fluid_bias_K + 0.05 * noise[1]
    if imperfections.quantise:
        probe = quantise(probe)
        fluid = quantise(fluid)
    return {
        "time_s": t,
        "switch": _switch_signal(t, plunge_truth),
        "probe_degC": probe,
        "fluid_degC": fluid,
    }


def _switch_signal(t: Array, plunge_truth: PlungeTruth) -> Array:
    """Return the switch signal (N,): 1 while pressed, with bounces of 20 ms."""
    pressed = t >= plunge_truth.switch_s
    if not plunge_truth.switch_held:
        pressed &= t < plunge_truth.switch_s + 0.6
    for bounce in range(plunge_truth.bounces):
        start = plunge_truth.switch_s + 0.04 * (bounce + 1)
        pressed &= ~((t >= start) & (t < start + 0.02))
    return pressed.astype(float)


# Columns of the hole comparison: two clamped junctions, then holes of 1.3, 2.2 and 3.0 mm.
HOLE_COLUMNS = ("ideal_1_degC", "ideal_2_degC", "d1p3_degC", "d2p2_degC", "d3p0_degC")


def simulate_hole(
    seed: int = 0,
    truth: RigTruth | None = None,
    bath_degC: float = 80.0,
    initial_degC: float = 16.0,
    after_s: float = 60.0,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Simulate the plunge of the two-part disk of section 5.4 into hot water.

    Five junctions are 3 mm deep, two clamped, three cemented. A hole of 3 mm lags clearly, those of
    1.3 and 2.2 mm hardly.

    Parameters
    ----------
    seed
        Seed of the random draws.
    truth
        True values of the rig, of which the fast disk is used; None draws them from the seed.
    bath_degC
        Temperature of the water [degC].
    initial_degC
        Temperature before the entry [degC].
    after_s
        Length of the record after the entry [s].

    Returns
    -------
    frame
        Columns time_s, switch, probe_degC, fluid_degC and ``HOLE_COLUMNS``.
    truth
        True values with lag_s of each chain, and ``"traces"``.

    Notes
    -----
    The cement adds 0.04, 0.10 and 0.90 s to the lags of the three holes. These lags are the truth
    that ``tests/simulate/test_plunge.py`` and ``tests/immersion/test_plunge_hole.py`` recover.
    """
    rig = truth or draw_truth(seed)
    errors = rig.imperfections
    rng = rng_for(seed, "hole")
    options = PlungeOptions(entry_s=10.0, after_s=after_s, initial_degC=initial_degC)
    plunge_truth = draw_plunge(rng, "water", bath_degC, options, errors)
    setup = rig.fast.setup
    heating = immersed_disk(setup, np.array([3e-3]), plunge_truth)
    cement_lag_s = {"ideal_1": 0.0, "ideal_2": 0.0, "d1p3": 0.04, "d2p2": 0.10, "d3p0": 0.90}
    base_lag_s = 0.25 + 0.01 * rng.standard_normal(5)
    chains: list[tuple[float, float, Conditioning]] = []
    lags = {}
    for base, (name, cement) in zip(base_lag_s, cement_lag_s.items()):
        tau1 = float(base + cement * (1 + 0.1 * rng.uniform(-1, 1)))
        tau2 = 0.06
        chains.append((tau1, tau2, setup.conditioning))
        lags[name] = tau1 + tau2 + setup.conditioning.lag_s
    columns = bath_columns(plunge_truth, errors, rng)
    fine_t = fine_times(len(columns["time_s"]))
    fine = np.repeat(heating.at(fine_t - plunge_truth.entry_s), 5, axis=1)
    readings = chain_responses(fine, 1 / (RATE_Hz * OVERSAMPLING), OVERSAMPLING, chains)
    if errors.static:
        readings = readings + rng.uniform(-0.1, 0.1, 5)
    if errors.noise:
        readings = readings + 0.13 * rng.standard_normal(readings.shape)
    if errors.quantise:
        readings = quantise(readings)
    columns |= dict(zip(HOLE_COLUMNS, readings.T))
    traces = pd.DataFrame({"time_s": columns["time_s"], "true_degC": fine[::OVERSAMPLING, 0]})
    return pd.DataFrame(columns), {
        **vars(plunge_truth),
        "lag_s": lags,
        "depth_m": 3e-3,
        "traces": traces,
    }
