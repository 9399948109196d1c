"""One EHL test from prepared traces to all ways to beta and their cross-check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.estimate import Estimate
from calibration.finding import Finding, Grade, sentences
from tcdyn.chain import Chain
from tcdyn.compensate.record import Compensated
from tcdyn.conduction.rim import Profile
from tcdyn.partition.cooling import (
    CoolingFit,
    compensated,
    cooling_errors,
    cooling_fit,
    cooling_shift,
    refined_chains,
)
from tcdyn.partition.crosscheck import Budget, CrossCheck, cross_check, monte_carlo, tensions
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import JOINT_WINDOW_S, BothFit, DiskFit, joint_fits
from tcdyn.partition.profile import joint_profiles, profiles_file
from tcdyn.partition.sensors import SensorCheck, check_sensors
from tcdyn.partition.steady import (
    EQUAL_WEIGHTS,
    DiskLine,
    SpeedLawPoint,
    at_one_radius,
    steady_lines,
    surface_temperatures,
)
from tcdyn.partition.uneven import Unevenness, harmonic_K
from tcdyn.partition.window import DiskWindow, stretch_of

SCHEMA = "tcdyn.beta/1"
WINDOW_S = 5.0
WAYS = ("speed law", *(f"{kind} {d}" for kind in ("cooling", "joint") for d in DISKS))


@dataclass(frozen=True)
class Partition:
    """All ways to the heat partition of one test.

    ``compensated``: each disk's traces over ``rows`` of the test, smoothed with ``chains`` (the record's, their common
    lag refined by the joint fit); ``answers``: every quantity with the uncertainty of the budget's draws, which hold
    their correlations; ``noticed``: what was found on the way, before the cross-check's verdict.
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
    answers: Mapping[str, Estimate]
    chains: Mapping[str, tuple[Chain, ...]]
    compensated: Mapping[str, Compensated]
    windows: Mapping[str, DiskWindow]
    sensors: SensorCheck | None
    noticed: tuple[Finding, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All that was noticed, the cross-check's verdict last."""
        return (*self.noticed, self.crosscheck.finding)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed in words; the verdict's stand in ``crosscheck.sentence``."""
        return sentences(self.noticed)

    @property
    def ways(self) -> dict[str, Estimate]:
        """beta of the fast disk by each way."""
        return {way: self.answers[way] for way in WAYS}

    @cached_property
    def profiles(self) -> pd.DataFrame:
        """How much worse the joint fits become away from their best numbers; see ``tcdyn.partition.profile``."""
        return joint_profiles(self.joint, self.both)


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
    joint_s = float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))  # of cooling, or what the log holds
    rows = stretch_of(test, max(window_s, joint_s))
    findings = list(test.findings)
    sensors = None
    if sensor_check:
        progress("sensor map")
        sensors = check_sensors(test)
        suspected = [suspect.finding for suspect in sensors.suspects]
        for finding in suspected:
            if finding.grade is Grade.REFUSE:
                raise InputError(
                    finding.sentence,
                    expected="six living junctions where rig.toml says",
                    remedy="map the columns in rig.toml [columns], or go on at your own risk with sensor_check=False",
                    parameters=("sensor_check=False",),
                )
        findings += suspected
    progress("steady lines")
    lines, speed = steady_lines(test, rows, profile, weights)
    progress("joint fits")
    joint, both = joint_fits(test, speed.starts, joint_s, profile)
    test, again = evened(test, both.uneven)
    lines, speed = steady_lines(test, rows, profile, weights)
    if again is not None:
        joint, both = joint_fits(again, speed.starts, joint_s, profile)
        test, _ = evened(again, both.uneven)
        lines, speed = steady_lines(test, rows, profile, weights)
    findings += [told for d in DISKS if (told := both.uneven[d].finding(d)) is not None]
    progress("compensation")
    chains = {d: refined_chains(test.disks[d].chains, joint[d].chain) for d in DISKS}
    cooled, cooling, shifts = {}, {}, {}
    for d in DISKS:
        one = cooled[d] = compensated(test, test.disks[d], rows, chains[d], joint[d].estimates["lag_s"].u, profile)
        progress(f"cooling fit, {d} disk")
        fit = cooling[d] = cooling_fit(one.window, lines[d].line, test.events.unload_s, window_s, one.noise_K)
        shifts[d] = cooling_shift(fit, *cooling_errors(one, fit.share, fit.h_W_m2K), lines[d])
    windows = {d: one.window for d, one in cooled.items()}
    budget = monte_carlo(test, lines, cooling, shifts, joint, seed)
    values = {"speed law": speed.beta, "h_fast": speed.h_fast, "h_slow": speed.h_slow, "exponent": test.speed_exponent}
    for d in DISKS:
        values |= {f"{d} intercept": lines[d].line.intercept, f"{d} slope": lines[d].line.slope}
        values |= {f"cooling {d}": cooling[d].beta, f"h cooling {d}": cooling[d].h_W_m2K}
        values |= {f"joint {d}": joint[d].beta, f"h joint {d}": joint[d].h_W_m2K}
    surface, drawn = surface_temperatures(test, speed, windows, budget.draws)
    draws = {**budget.draws, **drawn}
    answers = {k: Estimate.normal(value, float(np.std(draws[k]))) for k, value in (values | surface).items()}
    checked = cross_check({way: answers[way] for way in WAYS}, draws, tensions(test, joint, both, sensors))
    return Partition(
        test, rows, lines, speed, cooling, joint, both, replace(budget, draws=draws), checked, answers, chains,
        {d: one.done for d, one in cooled.items()}, windows, sensors, tuple(findings),
    )  # fmt: skip


def evened(test: EhlTest, found: Mapping[str, Unevenness]) -> tuple[EhlTest, EhlTest | None]:
    """The test without the harmonics round the bore that were ``found``; and where one is beyond doubt the test with
    them, to be fitted again with what is to be expected of such a disk."""
    expected = {d: found[d].expected for d in DISKS}
    known = {d: replace(found[d], second_K=e.second_K, about_K=e.about_K) for d, e in expected.items()}
    disks = {}
    for d, disk in test.disks.items():
        since_s = test.time_s - test.events.unload_s - disk.common_lag_s
        disks[d] = replace(disk, readings_degC=disk.readings_degC - harmonic_K(known[d], disk.setup, since_s))
    uneven = any(known[d].second_K > 0 for d in DISKS)
    return replace(test, disks=disks, uneven=known), replace(test, uneven=expected) if uneven else None


def refine_lags(test: EhlTest) -> Mapping[str, DiskFit]:
    """Joint fits of both disks, for their chains."""
    length = float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))
    _, speed = steady_lines(test, stretch_of(test, length))
    return joint_fits(test, speed.starts, length)[0]


def beta_file(p: Partition, source: dict[str, str]) -> dict[str, Any]:
    """The content of ``beta.json``; every estimate is {value, u, low95, high95}, h in W/m2K, lags in s.

    A junction tells how much deeper this test alone places it than rig.toml [mm], and its pull on the stated depth.
    """
    test = p.test
    a = {key: estimate.model_dump() for key, estimate in p.answers.items()}
    both = {key: estimate.model_dump() for key, estimate in p.both.estimates.items()}
    depths = {} if p.sensors is None else p.sensors.depths
    return {
        "schema": SCHEMA,
        "source": source,
        "test": {
            "load_N": test.load_N,
            "friction_N": test.friction_N,
            "sliding_speed_m_s": test.sliding_speed_m_s,
            "entraining_speed_m_s": test.entraining_speed_m_s,
            "half_width_m": test.half_width_m,
            "load_on_s": test.events.load_on_s,
            "unload_s": test.events.unload_s,
        },
        "steady": {
            "beta": a["speed law"],
            "h_fast": a["h_fast"],
            "h_slow": a["h_slow"],
            **{f"{d}_line": {"intercept": a[f"{d} intercept"], "slope": a[f"{d} slope"]} for d in DISKS},
            "exponent": a["exponent"],
        },
        "transient": {
            d: {"beta": a[f"cooling {d}"], "h": a[f"h cooling {d}"], "window_s": p.cooling[d].window_s} for d in DISKS
        },
        "joint": {
            **{
                d: {
                    "beta": a[f"joint {d}"],
                    "h": a[f"h joint {d}"],
                    "lag_s": p.joint[d].estimates["lag_s"].model_dump(),
                }
                for d in DISKS
            },
            "both": both,
            "profiles": profiles_file(p.profiles),
        },
        "crosscheck": p.crosscheck.to_dict(),
        "budget": [asdict(row) for row in p.budget.rows],
        "surface": {
            "fast_max_degC": a["surface fast"],
            "slow_max_degC": a["surface slow"],
            "delta_T_us": a["delta_T_us"],
        },
        "noise": {d: test.disks[d].noise.to_dict() for d in DISKS},
        "unevenness": {d: p.both.uneven[d].to_dict() for d in DISKS},
        "sensors": {} if p.sensors is None else p.sensors.said,
        "junctions": {
            d: {
                c: {"deeper_mm": Estimate.normal(1e3 * e.value, 1e3 * e.u).model_dump(), "z": float(z)}
                for (c, e), z in zip(t.deeper_m.items(), t.pull)
            }
            for d, t in depths.items()
        },
        "findings": [found.to_dict() for found in p.findings],
        "warnings": list(p.warnings),
    }
