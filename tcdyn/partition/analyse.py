"""One EHL test from prepared traces to all ways to beta and their cross-check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, Severity, info, messages, warning, warnings_and_errors
from tcdyn.heat.rim import Profile
from tcdyn.partition.angular_harmonic import Unevenness, harmonic_K
from tcdyn.partition.at_rest import cables_exchanged
from tcdyn.partition.cooling import (
    Alone,
    CoolingFit,
    CoolingSensitivity,
    compensated,
    cooling_errors,
    cooling_fit,
    cooling_shift,
    refined_chains,
    require_window_longer_than_lag,
    single_disk_fits,
    smoothed,
    surface_temperatures,
    with_slowing_air_offset,
)
from tcdyn.partition.crosscheck import Budget, CrossCheck, cross_check, monte_carlo, tensions
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import JOINT_WINDOW_S, BothFit, DiskFit, joint_fits
from tcdyn.partition.model_forms import (
    ESTIMATORS,
    POWER_SCALE_TOLERANCE,
    Alternatives,
    compare_model_forms,
    impossibility_findings,
    impossible_keys,
    power_scale,
)
from tcdyn.partition.press_fit import press_fit_priors
from tcdyn.partition.profile import joint_profiles
from tcdyn.partition.sensor_check import SensorCheck, check_sensors
from tcdyn.partition.steady import (
    DiskLine,
    SpeedLawPoint,
    at_one_radius,
    at_own_temperature,
    steady_lines,
)
from tcdyn.partition.surface_flux import log_h_prior, with_surfaces
from tcdyn.partition.window import DiskWindow, stretch_of
from tcdyn.rig.disk import DISKS
from tcdyn.smoothing.record import Compensated

# of the cooling fit; a channel at rest that is off by more reads something else
WINDOW_S = 5.0
MAX_OFFSET_K = 20.0
NO_HARMONICS: Mapping[str, Unevenness] = {}
# the exponent this far from the speed law's, and its opposite this near
EXCHANGED_Z = 5.0
OPPOSITE_Z = 3.0


@dataclass(frozen=True)
class Partition:
    """All ways to the heat partition of one test.

    ``compensated``: each disk's traces over ``rows`` of the test, smoothed with ``chains`` (the record's, their common
    lag refined by the joint fit); ``answers``: every quantity with the uncertainty of the budget's draws, which hold
    their correlations; ``model_form_columns``: the fit of both disks if the test were built otherwise; ``noticed``: what was
    found on the way, before the cross-check's verdict.
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
    structures: Alternatives
    noticed: tuple[Finding, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All that was noticed, the cross-check's verdict last."""
        return (*self.noticed, self.crosscheck.finding)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed in words; the verdict's stand in ``crosscheck.sentence``."""
        return messages(self.noticed)

    @property
    def ways(self) -> dict[str, Estimate]:
        """beta of the fast disk by each way."""
        return {way: self.answers[way] for way in ESTIMATORS}

    @property
    def withheld(self) -> frozenset[str]:
        """Keys of ``answers`` that cannot be true, and of both disks' estimates as "both beta"; not to be shown."""
        return impossible_keys(self.answers, self.both.estimates)

    @property
    def status(self) -> str:
        """ "sound", "warning" with at least one warning, "withheld" for a physically impossible estimate."""
        if "both beta" in self.withheld:
            return "withheld"
        return "warning" if warnings_and_errors(self.findings) else "sound"

    @property
    def headline(self) -> Finding:
        """The recommended answer and why, in words: the joint fit of both disks."""
        if "both beta" in self.withheld:
            return warning("headline.withheld")
        e = self.both.estimates
        s = self.structures
        numbers: dict[str, Any] = (
            {}
            if s.preferred is None
            else {"named": s.preferred.name, "named_beta": s.preferred.beta.value}
        )
        return info(
            "headline.both",
            beta=e["beta"].value,
            u=e["beta"].u,
            exponent=e["exponent"].value,
            exponent_u=e["exponent"].u,
            assumed=self.test.speed_exponent,
            z=s.assumed.speed_law_z,
            count=len(s.tried) - 1,
            low95=s.low95,
            high95=s.high95,
            **numbers,
        )

    @cached_property
    def profiles(self) -> pd.DataFrame:
        """How much worse the joint fits become away from their best numbers; see ``tcdyn.partition.profile``."""
        return joint_profiles(self.joint, self.both)


def analyse(
    test: EhlTest,
    *,
    window_s: float = WINDOW_S,
    profile: Profile = "modal",
    weights: NDArray[np.float64] | None = None,
    seed: int = 0,
    sensor_check: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> Partition:
    """Steady lines, speed law, joint fits, compensation, cooling fits, budget and cross-check of one test.

    ``window_s``: cooling used by the h-only fit; ``sensor_check``: look for dead, swapped and misplaced junctions
    first. Raises InputError when the log ends too early, the window is shorter than the lag, a channel is dead or
    swapped, or the data contradict the model.
    """
    require_window_longer_than_lag(test, window_s)
    logged = test = with_slowing_by_speed_law(
        at_one_radius(at_own_temperature(with_surfaces(test)))
    )
    joint_s = float(
        min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s)
    )  # of cooling, or what the log holds
    rows = stretch_of(test, max(window_s, joint_s))
    findings = list(test.findings)
    sensors = None
    if sensor_check:
        progress("sensor map")
        sensors = _check_sensors(test, rows, joint_s, profile)
        findings += check_suspects(sensors)
    progress("steady lines")
    lines, speed = steady_lines(test, rows, profile, weights)
    progress("joint fits")
    joint, both = joint_fits(test, speed.starts, joint_s, profile)
    if test.slowing:
        test = with_slowing_air_offset(
            test, {d: (fit.share, fit.h_W_m2K) for d, fit in joint.items()}
        )
        joint, both = joint_fits(test, speed.starts, joint_s, profile)
    fitted = test
    (test, again) = remove_and_expect_harmonics(test, both.uneven)
    lines, speed = steady_lines(test, rows, profile, weights)
    stated, contradicted = press_fit_priors(test, both.estimates, both.uneven)
    findings += contradicted
    if stated:
        again = remove_and_expect_harmonics(fitted, both.uneven, stated)[1]
    if again is not None:
        fitted = remove_harmonics(again, again.uneven) if stated else again
        joint, both = joint_fits(fitted, speed.starts, joint_s, profile)
        test, _ = remove_and_expect_harmonics(again, both.uneven, stated)
        lines, speed = steady_lines(test, rows, profile, weights)
    findings += [told for d in DISKS if (told := both.uneven[d].finding(d)) is not None]
    progress("other structures, compensation and cooling fits")
    chains = {d: refined_chains(test.disks[d].chains, joint[d].chain) for d in DISKS}
    windows: dict[str, DiskWindow] = {}
    shown: dict[str, Compensated] = {}
    cooling: dict[str, CoolingFit] = {}
    shifts: dict[str, CoolingSensitivity] = {}
    for d in DISKS:
        disk = test.disks[d]
        line = lines[d]
        junctions = smoothed(test, disk, rows, chains[d], joint[d].estimates["lag_s"].u)
        traces = compensated(test, disk, rows, junctions, profile)
        prior = log_h_prior(disk.setup.surface)
        fit = cooling_fit(
            traces.window, line.line, test.events.unload_s, window_s, traces.noise_K, prior
        )
        errors = cooling_errors(traces, fit.share, fit.h_W_m2K)
        windows[d] = traces.window
        shown[d] = traces.shown
        cooling[d] = fit
        shifts[d] = cooling_shift(fit, *errors, line)
    structures = compare_model_forms(fitted, joint, both)
    budget = monte_carlo(test, lines, cooling, shifts, joint, seed)
    values = {
        "speed law": speed.beta,
        "h_fast": speed.h_fast,
        "h_slow": speed.h_slow,
        "exponent": test.speed_exponent,
    }
    for d in DISKS:
        values |= {f"{d} intercept": lines[d].line.intercept, f"{d} slope": lines[d].line.slope}
        values |= {f"cooling {d}": cooling[d].beta, f"h cooling {d}": cooling[d].h_W_m2K}
        values |= {f"joint {d}": joint[d].beta, f"h joint {d}": joint[d].h_W_m2K}
    surface, drawn = surface_temperatures(test, speed, windows, budget.draws)
    draws = {**budget.draws, **drawn}
    answers = {
        k: Estimate.normal(value, float(np.std(draws[k])))
        for k, value in (values | surface).items()
    }
    held = structures if "both beta" not in impossible_keys(answers, both.estimates) else None
    causes = impossibility_findings(answers, both.estimates, draws)
    units = [f for f in causes if f.numbers.get("units")]  # they explain all the rest
    findings = [
        *_exchanged(logged, both),
        *units,
        *findings,
        *(f for f in causes if f not in units),
    ]
    findings += held.findings if held else ()
    checked = cross_check(
        {way: answers[way] for way in ESTIMATORS}, draws, tensions(test, joint, both, sensors), held
    )
    return Partition(
        test,
        rows,
        lines,
        speed,
        cooling,
        joint,
        both,
        replace(budget, draws=draws),
        checked,
        answers,
        chains,
        shown,
        windows,
        sensors,
        structures,
        tuple(findings),
    )


def check_suspects(found: SensorCheck) -> list[Finding]:
    """What the sensor map suspects. Raises InputError where a channel is dead, swapped or off by ``MAX_OFFSET_K``."""
    suspected = [suspect.finding for suspect in found.suspects]
    for finding in suspected:
        n = finding.numbers
        lost = n["kind"] == "dead" or (
            n["kind"] == "offset" and abs(n["size"] or 0.0) > MAX_OFFSET_K
        )
        if lost or finding.severity is Severity.ERROR:
            raise InputError(
                finding.sentence,
                expected="living junctions where rig.toml says",
                remedy="map the columns in rig.toml [columns], or go on at your own risk with {sensor_check}",
                parameters={"sensor_check": False},
                column=n["columns"][0] if lost else "",
            )
    return suspected


def _exchanged(test: EhlTest, both: BothFit) -> list[Finding]:
    """Whether the disks' cables look exchanged: the exponent its opposite, or readings at rest each other's."""
    n = both.estimates["exponent"]
    assumed = test.speed_exponent
    law_u = test.exponent_half_range / 3**0.5
    away, opposite = (
        abs(assumed - sign * n.value) / float(np.hypot(n.u, law_u)) for sign in (1, -1)
    )
    at_rest = away >= EXCHANGED_Z and cables_exchanged(test)
    if away < EXCHANGED_Z or (opposite > OPPOSITE_Z and not at_rest):
        return []
    numbers: dict[str, Any] = {
        "exponent": n.value,
        "u": n.u,
        "assumed": assumed,
        "beta": both.estimates["beta"].value,
    }
    return [warning("cables.exchanged", **numbers, at_rest=at_rest)]


def _check_sensors(test: EhlTest, rows: slice, joint_s: float, profile: Profile) -> SensorCheck:
    """The sensor map; where it suspects anything, that with the power that the disks show, if this explains it all."""
    found = check_sensors(test)
    if found.sound:
        return found
    try:
        _, speed = steady_lines(test, rows, profile)
        joint = single_disk_fits(test, speed.starts, joint_s, profile)
    except InputError:
        return found
    scale = power_scale(*(joint[d].estimates["beta"].value for d in DISKS))
    if scale <= 0 or abs(scale - 1) < POWER_SCALE_TOLERANCE:
        return found
    return (
        again
        if (again := check_sensors(replace(test, power_W=test.power_W * scale))).sound
        else found
    )


def with_slowing_by_speed_law(test: EhlTest) -> EhlTest:
    """The test with the film of slowing disks, by the speed law."""
    length = float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))
    return (
        with_slowing_air_offset(test, steady_lines(test, stretch_of(test, length))[1].starts)
        if test.slowing
        else test
    )


def remove_and_expect_harmonics(
    test: EhlTest, found: Mapping[str, Unevenness], stated: Mapping[str, Unevenness] = NO_HARMONICS
) -> tuple[EhlTest, EhlTest | None]:
    """The test without the harmonics round the bore that were ``found``; and where one is beyond doubt, or ``stated``,
    the test with them, to be fitted again with what is to be expected of such a disk."""
    expected = {d: stated.get(d, one.expected) for d, one in found.items()}
    known = {
        d: replace(
            found[d], second_harmonic_u_K=e.second_harmonic_u_K, angle_level_K=e.angle_level_K
        )
        for d, e in expected.items()
    }
    uneven = bool(stated) or any(one.second_harmonic_u_K > 0 for one in known.values())
    return remove_harmonics(test, known), replace(test, uneven=expected) if uneven else None


def remove_harmonics(test: EhlTest, known: Mapping[str, Unevenness]) -> EhlTest:
    """The test without the harmonics round the bore that are ``known``."""
    disks = {}
    for d, disk in test.disks.items():
        since_s = test.time_s - test.events.unload_s - disk.common_lag_s
        disks[d] = replace(
            disk, readings_degC=disk.readings_degC - harmonic_K(known[d], disk.setup, since_s)
        )
    return replace(test, disks=disks, uneven=known)


def refine_lags(test: EhlTest) -> Mapping[str, Alone]:
    """Joint fits of the disks that were logged, for their chains."""
    test = with_slowing_by_speed_law(at_own_temperature(with_surfaces(test)))
    length = float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))
    return single_disk_fits(test, steady_lines(test, stretch_of(test, length))[1].starts, length)
