"""One EHL test from prepared traces to all ways to beta and their cross-check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.estimate import Estimate
from tcdyn.chain import Chain
from tcdyn.compensate.result import Compensated
from tcdyn.conduction.rim import Profile
from tcdyn.partition.budget import Budget, monte_carlo
from tcdyn.partition.compensated import (
    compensate_stretch,
    compensated_window,
    cooling_by_lag,
    cooling_shift,
    lag_effect,
)
from tcdyn.partition.cooling import CoolingFit, cooling_fit
from tcdyn.partition.crosscheck import CrossCheck, cross_check
from tcdyn.partition.inner_row import at_one_radius
from tcdyn.partition.joint import BothFit, DiskFit, joint_fits
from tcdyn.partition.lines import DiskLine
from tcdyn.partition.nuisance import nuisances
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.profile import joint_profiles
from tcdyn.partition.refine import EQUAL_WEIGHTS, joint_length_s, joint_start, refined_chains, steady_lines
from tcdyn.partition.sensors.check import SensorCheck, check_sensors
from tcdyn.partition.steady import SpeedLawPoint
from tcdyn.partition.surface import Surface, surface_temperatures
from tcdyn.partition.tension import tensions
from tcdyn.partition.window import OUTER, DiskWindow, stretch_of

WINDOW_S = 5.0
FATAL_FAULTS = ("dead", "swapped")


@dataclass(frozen=True)
class Partition:
    """All ways to the heat partition of one test.

    ``compensated``: each disk's traces over ``rows`` of the test, smoothed with ``chains`` (the record's, their common
    lag refined by the joint fit); ``draws`` of the budget hold every quantity with its correlations.
    """

    test: EhlTest
    rows: slice
    lines: Mapping[str, DiskLine]
    speed: SpeedLawPoint
    cooling: Mapping[str, CoolingFit]
    joint: Mapping[str, DiskFit]
    both: BothFit
    budget: Budget
    crosscheck: CrossCheck
    surface: Surface
    chains: Mapping[str, tuple[Chain, ...]]
    compensated: Mapping[str, Compensated]
    windows: Mapping[str, DiskWindow]
    sensors: SensorCheck | None
    warnings: tuple[str, ...]

    @property
    def ways(self) -> dict[str, float]:
        """beta of the fast disk by each way."""
        out = {"speed law": self.speed.beta}
        out |= {f"cooling {d}": self.cooling[d].beta for d in DISKS}
        return out | {f"joint {d}": self.joint[d].beta for d in DISKS}

    @cached_property
    def profiles(self) -> pd.DataFrame:
        """How much worse the joint fits become away from their best numbers; see ``tcdyn.partition.profile``."""
        return joint_profiles(self.test, self.joint, self.both)

    def estimate(self, key: str, value: float) -> Estimate:
        """``value`` with the uncertainty of the budget's draws of ``key``."""
        return Estimate.normal(value, float(np.std(self.budget.draws[key])))


def analyse(
    test: EhlTest,
    *,
    window_s: float = WINDOW_S,
    profile: Profile = "modal",
    weights: NDArray[np.float64] = EQUAL_WEIGHTS,
    seed: int = 0,
    sensor_check: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> Partition:
    """Steady lines, speed law, joint fits, compensation, cooling fits, budget and cross-check of one test.

    ``window_s``: cooling used by the h-only fit; ``sensor_check``: look for dead, swapped and misplaced junctions
    first. Raises InputError when the log ends too early, the window is shorter than the lag, a channel is dead or
    swapped, or the data contradict the model.
    """
    lag = max(d.common_lag_s for d in test.disks.values())
    if window_s < lag:
        raise InputError(
            f"the cooling window of {window_s:g} s is shorter than the lag of {lag:.2f} s",
            expected=f"at least {lag:.2f} s",
            remedy="ask for a longer window",
        )
    test = at_one_radius(test)
    rows = stretch_of(test, max(window_s, joint_length_s(test)))
    warnings = list(test.warnings)
    sensors = None
    if sensor_check:
        progress("sensor map")
        sensors = check_sensors(test)
        warnings += _sensor_warnings(sensors)
    progress("steady lines")
    lines, speed = steady_lines(test, rows, profile, weights)
    progress("joint fits")
    joint, both = joint_fits(test, joint_start(speed), joint_length_s(test), profile)
    progress("compensation")
    chains = {d: refined_chains(test.disks[d].chains, joint[d].chain) for d in DISKS}
    compensated, windows, cooling, shifts, by_lag = {}, {}, {}, {}, {}
    for d in DISKS:
        disk = test.disks[d]
        compensated[d] = compensate_stretch(test, disk, rows, chains[d], joint[d].estimates["lag_s"].u)
        windows[d] = compensated_window(test, disk, rows, compensated[d], profile)
        noise = float(np.median(compensated[d].sd_noise[:, OUTER]))
        cooling[d] = cooling_fit(windows[d], lines[d].line, test.events.unload_s, window_s, noise)
        progress(f"cooling fit, {d} disk")
        at = (cooling[d].share, cooling[d].h_W_m2K)
        nuis = nuisances(windows[d], disk, disk.readings_degC[rows], test.dt_s, *at, test.events.unload_u_s)
        shifts[d] = cooling_shift(nuis, lines[d], cooling[d])
        late = lag_effect(test, disk, rows, compensated[d], windows[d], at[1])
        by_lag[d] = cooling_by_lag(late, lines[d], cooling[d])
    budget = monte_carlo(
        {d: lines[d].line for d in DISKS},
        {d: lines[d].shift for d in DISKS},
        {d: (cooling[d].share, cooling[d].h_W_m2K) for d in DISKS},
        shifts,
        by_lag,
        {d: (joint[d].share, joint[d].h_W_m2K) for d in DISKS},
        {d: joint[d].shift for d in DISKS},
        test.speed_ratio,
        test.speed_exponent,
        test.exponent_range,
        seed,
    )
    ways = {"speed law": speed.beta}
    ways |= {f"cooling {d}": cooling[d].beta for d in DISKS}
    ways |= {f"joint {d}": joint[d].beta for d in DISKS}
    steady = Estimate.normal(speed.beta, float(np.std(budget.draws["speed law"])))
    checked = cross_check(ways, {k: budget.draws[k] for k in ways}, steady, tensions(test, joint, both, sensors))
    surface = surface_temperatures(test, speed, windows)
    budget = replace(budget, draws={**budget.draws, **surface.draws(speed, budget.draws, test.sliding_speed_m_s)})
    return Partition(
        test, rows, lines, speed, cooling, joint, both, budget, checked, surface, chains, compensated, windows, sensors,
        tuple(warnings),
    )  # fmt: skip


def _sensor_warnings(check: SensorCheck) -> list[str]:
    """Sentences for what the sensor map suspects; a dead or swapped channel stops the analysis by name."""
    for suspect in check.suspects:
        if suspect.kind in FATAL_FAULTS:
            raise InputError(
                suspect.sentence,
                expected="six living junctions where rig.toml says",
                remedy="map the columns in rig.toml [columns], or go on at your own risk with --no-sensor-check",
            )
    return list(check.warnings)
