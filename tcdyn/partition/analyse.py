"""Analysis of one EHL test: all estimators of beta and their cross-check.

``analyse`` runs the stages in order: preparation, sensor check, steady lines, joint fits (repeated
with what they show), compensation and cooling fits, model-form alternatives, Monte Carlo budget,
cross-check. The physics of each stage is in its own module of :mod:`tcdyn.partition`. Used by
:mod:`tcdyn.workflows`, :mod:`tcdyn.report`, :mod:`tcdyn.plots` and :mod:`tcdyn.campaign.compress`.
Thresholds are chosen by judgement. Guarded by the behaviour suite
(``tests/behaviour/test_behaviour.py``) and by all of ``tests/partition``.
"""

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
from tcdyn.partition.angular_harmonic import AngularHarmonic, harmonic_K
from tcdyn.partition.at_rest import cables_exchanged, disks_differ
from tcdyn.partition.cooling import (
    CoolingFit,
    CoolingSensitivity,
    SingleDiskFit,
    compensate_disk,
    cooling_effects,
    cooling_fit,
    cooling_sensitivity,
    refined_chains,
    require_window_longer_than_lag,
    single_disk_fits,
    smooth_traces,
    surface_temperatures,
    with_slowing_air_offset,
)
from tcdyn.partition.crosscheck import Budget, CrossCheck, cross_check, monte_carlo, tensions
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import JOINT_WINDOW_S, BothFit, DiskFit, joint_fits
from tcdyn.partition.model_forms import (
    ESTIMATORS,
    POWER_SCALE_TOLERANCE,
    ModelForms,
    compare_model_forms,
    impossibility_findings,
    impossible_keys,
    power_scale,
)
from tcdyn.partition.press_fit import press_fit_priors
from tcdyn.partition.profile import joint_profiles
from tcdyn.partition.sensor_check import SensorCheck, check_sensors
from tcdyn.partition.specified import log_h_prior, with_surface_air
from tcdyn.partition.steady import (
    DiskLine,
    SpeedLawPoint,
    steady_lines,
    with_inner_row_at_one_radius,
    with_linear_steel,
)
from tcdyn.partition.window import DiskWindow, fit_rows
from tcdyn.rig.disk import DISKS
from tcdyn.smoothing.record import Compensated

WINDOW_S = 5.0  # length of the cooling of the cooling fit [s]; chosen by judgement
# A channel whose offset at rest is larger measures something else, and stops the run [K].
# Chosen by judgement.
MAX_OFFSET_K = 20.0
# Default of functions that take harmonics by disk.
NO_HARMONICS: Mapping[str, AngularHarmonic] = {}
# The disks' cables look exchanged if the exponent is this far from the speed law's, and its
# opposite this near, in standard uncertainties. Chosen by judgement.
EXCHANGED_Z = 5.0
OPPOSITE_Z = 3.0


@dataclass(frozen=True)
class Partition:
    """All estimates of the heat partition of one test.

    Parameters
    ----------
    test
        The test without the circumferential harmonics.
    rows
        Rows of the test that the fits use.
    lines, speed
        Steady line of each disk, and the speed law's point on both.
    cooling, joint, both
        Cooling fit and joint fit of each disk, and the joint fit of both.
    budget
        Uncertainty budget with samples of every quantity.
    crosscheck
        Agreement of the estimators.
    estimates
        Every quantity with the uncertainty of the budget's samples, which hold their correlations.
    chains
        Chains of each disk: the record's, their common lag refined by the joint fit.
    compensated
        Traces of each disk over ``rows``, smoothed with ``chains``.
    windows
        Window of each disk's compensated traces.
    sensors
        The sensor check; None if it was not made.
    model_forms
        The fit of both disks under all model-form alternatives.
    analysis_findings
        Findings of the analysis, without the cross-check's conclusion.
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
    estimates: Mapping[str, Estimate]
    chains: Mapping[str, tuple[Chain, ...]]
    compensated: Mapping[str, Compensated]
    windows: Mapping[str, DiskWindow]
    sensors: SensorCheck | None
    model_forms: ModelForms
    analysis_findings: tuple[Finding, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings, the cross-check's conclusion last."""
        return (*self.analysis_findings, self.crosscheck.finding)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as text, without the conclusion, which is ``crosscheck.sentence``."""
        return messages(self.analysis_findings)

    @property
    def beta_by_estimator(self) -> dict[str, Estimate]:
        """beta of the fast disk by each estimator."""
        return {estimator: self.estimates[estimator] for estimator in ESTIMATORS}

    @property
    def impossible(self) -> frozenset[str]:
        """Keys of impossible estimates, of both disks as "both beta"; these are not reported."""
        return impossible_keys(self.estimates, self.both.estimates)

    @property
    def status(self) -> str:
        """ "sound", "warning" with at least one warning, "withheld" for an impossible estimate."""
        if "both beta" in self.impossible:
            return "withheld"
        return "warning" if warnings_and_errors(self.findings) else "sound"

    @property
    def recommendation(self) -> Finding:
        """The recommended estimate, the joint fit of both disks, and the reason."""
        if "both beta" in self.impossible:
            return warning("headline.withheld")
        beta = self.both.estimates["beta"]
        exponent = self.both.estimates["exponent"]
        forms = self.model_forms
        numbers: dict[str, Any] = {}
        if forms.preferred is not None:
            numbers["named"] = forms.preferred.name
            numbers["named_beta"] = forms.preferred.beta.value
        return info(
            "headline.both",
            beta=beta.value,
            u=beta.u,
            exponent=exponent.value,
            exponent_u=exponent.u,
            assumed=self.test.speed_exponent,
            z=forms.assumed.speed_law_z,
            count=len(forms.forms) - 1,
            low95=forms.low95,
            high95=forms.high95,
            **numbers,
        )

    @cached_property
    def profiles(self) -> pd.DataFrame:
        """Profiles of the joint fits, see ``tcdyn.partition.profile``; computed on first use."""
        return joint_profiles(self.joint, self.both)


@dataclass(frozen=True)
class _MainFits:
    """Results of steady lines and joint fits.

    Parameters
    ----------
    test
        The test without the estimated harmonics, with their remaining uncertainty.
    fitted
        The test of the joint fits: only the nominal harmonics of a stated press fit are subtracted.
    lines, speed
        Steady line of each disk, and the speed law's point.
    joint, both
        Joint fit of each disk, and of both.
    findings
        Findings of the fits.
    """

    test: EhlTest
    fitted: EhlTest
    lines: Mapping[str, DiskLine]
    speed: SpeedLawPoint
    joint: Mapping[str, DiskFit]
    both: BothFit
    findings: list[Finding]


@dataclass(frozen=True)
class _CoolingFits:
    """Compensated traces, their windows, and the cooling fit with its sensitivity, by disk."""

    compensated: Mapping[str, Compensated]
    windows: Mapping[str, DiskWindow]
    fits: Mapping[str, CoolingFit]
    sensitivities: Mapping[str, CoolingSensitivity]


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
    """Steady lines, joint fits, compensation, cooling fits, budget and cross-check of one test.

    Parameters
    ----------
    test
        The test, with both disks.
    window_s
        Length of the cooling of the cooling fit [s].
    profile
        Profile of the inner boundary along z.
    weights
        Weights of the outer row for the steady lines, (P,); equal unless given.
    seed
        Of the Monte Carlo simulation.
    sensor_check
        Whether to look for dead, swapped and misplaced junctions first.
    progress
        Called with the name of each stage.

    Raises
    ------
    InputError
        If the log ends too early, the window is shorter than the lag, a channel is dead or swapped,
        or the data contradict the model.

    Notes
    -----
    The order of the stages matters: the joint fits give the chains by which the traces are
    compensated, and the harmonics that are subtracted before. A finding on wrong units comes before
    all others, because it explains them.
    """
    require_window_longer_than_lag(test, window_s)
    prepared = prepare_test(test)
    joint_s = joint_window_s(prepared)
    rows = fit_rows(prepared, max(window_s, joint_s))
    findings = list(prepared.findings)
    sensors = None
    if sensor_check:
        progress("sensor map")
        sensors = _check_sensors(prepared, rows, joint_s, profile)
        findings += check_suspects(sensors)
    main = _main_fits(prepared, rows, joint_s, profile, weights, progress)
    test = main.test
    joint = main.joint
    both = main.both
    findings += main.findings
    progress("other structures, compensation and cooling fits")
    chains = {d: refined_chains(test.disks[d].chains, joint[d].chain) for d in DISKS}
    cooling = _cooling_fits(main, rows, chains, window_s, profile)
    forms = compare_model_forms(main.fitted, joint, both)
    budget = monte_carlo(test, main.lines, cooling.fits, cooling.sensitivities, joint, seed)
    surface, surface_samples = surface_temperatures(
        test, main.speed, cooling.windows, budget.samples
    )
    samples = {**budget.samples, **surface_samples}
    values = _values(main, cooling.fits) | surface
    estimates = {
        key: Estimate.normal(value, float(np.std(samples[key]))) for key, value in values.items()
    }
    impossible = "both beta" in impossible_keys(estimates, both.estimates)
    possible_forms = None if impossible else forms
    causes = impossibility_findings(estimates, both.estimates, samples)
    wrong_units = [f for f in causes if f.numbers.get("units")]  # they explain all other findings
    findings = [
        *_exchanged_cables(prepared, both),
        *disks_differ(prepared),
        *wrong_units,
        *findings,
        *(f for f in causes if f not in wrong_units),
    ]
    if possible_forms is not None:
        findings += possible_forms.findings
    checked = cross_check(
        {estimator: estimates[estimator] for estimator in ESTIMATORS},
        samples,
        tensions(test, joint, both, sensors),
        possible_forms,
    )
    return Partition(
        test=test,
        rows=rows,
        lines=main.lines,
        speed=main.speed,
        cooling=cooling.fits,
        joint=joint,
        both=both,
        budget=replace(budget, samples=samples),
        crosscheck=checked,
        estimates=estimates,
        chains=chains,
        compensated=cooling.compensated,
        windows=cooling.windows,
        sensors=sensors,
        model_forms=forms,
        analysis_findings=tuple(findings),
    )


def prepare_test(test: EhlTest) -> EhlTest:
    """The test with all corrections that the fits need.

    Notes
    -----
    Surface air, linear steel, inner row at one radius, air of slowing disks, in this order: each
    uses the ones before. ``tcdyn.partition.single_disk.analyse_one_disk`` calls this function, too;
    ``refine_lags`` applies the same corrections except the inner row's.
    """
    test = with_surface_air(test)
    test = with_linear_steel(test)
    test = with_inner_row_at_one_radius(test)
    return with_slowing_by_speed_law(test)


def joint_window_s(test: EhlTest) -> float:
    """Length of the cooling of the joint fits: the default, or what the log holds [s]."""
    return float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))


def _main_fits(
    test: EhlTest,
    rows: slice,
    joint_s: float,
    profile: Profile,
    weights: NDArray[np.float64] | None,
    progress: Callable[[str], None],
) -> _MainFits:
    """Steady lines and joint fits, repeated with what the joint fits show.

    These are the air of slowing disks at the fitted share and h, and the circumferential harmonics:
    where one is significant, or a press fit is stated, the joint fits are repeated with its prior.

    Parameters
    ----------
    test
        The prepared test.
    rows
        Rows for the steady lines.
    joint_s
        Length of the cooling of the joint fits [s].
    profile, weights, progress
        As of :func:`analyse`.

    Notes
    -----
    ``tcdyn.partition.single_disk._joint_result`` has the same steps for one disk.
    ``tests/partition/test_uneven.py`` and ``tests/partition/test_stated_fit.py`` (studies) test the
    repeated fits.
    """
    progress("steady lines")
    _, speed = steady_lines(test, rows, profile, weights)
    progress("joint fits")
    joint, both = joint_fits(test, speed.starts, joint_s, profile)
    if test.relative_speed:
        points = {d: (fit.share, fit.h_W_m2K) for d, fit in joint.items()}
        test = with_slowing_air_offset(test, points)
        joint, both = joint_fits(test, speed.starts, joint_s, profile)
    fitted = test
    expected = expected_harmonics(both.harmonics)
    corrected = without_harmonics(fitted, both.harmonics, expected)
    lines, speed = steady_lines(corrected, rows, profile, weights)
    stated, findings = press_fit_priors(corrected, both.estimates, both.harmonics)
    if stated:
        expected = expected_harmonics(both.harmonics, stated)
    if stated or any_significant(expected):
        again = replace(fitted, harmonics=expected)
        fitted = remove_harmonics(again, expected) if stated else again
        joint, both = joint_fits(fitted, speed.starts, joint_s, profile)
        corrected = without_harmonics(
            again, both.harmonics, expected_harmonics(both.harmonics, stated)
        )
        lines, speed = steady_lines(corrected, rows, profile, weights)
    for d in DISKS:
        finding = both.harmonics[d].finding(d)
        if finding is not None:
            findings.append(finding)
    return _MainFits(corrected, fitted, lines, speed, joint, both, findings)


def _cooling_fits(
    main: _MainFits,
    rows: slice,
    chains: Mapping[str, tuple[Chain, ...]],
    window_s: float,
    profile: Profile,
) -> _CoolingFits:
    """Compensate the traces of each disk and fit its h to the cooling.

    Parameters
    ----------
    main
        Results of steady lines and joint fits.
    rows
        Rows of the test to compensate.
    chains
        Chains of each disk.
    window_s
        Length of the cooling [s].
    profile
        Profile of the inner boundary along z.
    """
    test = main.test
    traces: dict[str, Compensated] = {}
    windows: dict[str, DiskWindow] = {}
    fits: dict[str, CoolingFit] = {}
    sensitivities: dict[str, CoolingSensitivity] = {}
    for d in DISKS:
        disk = test.disks[d]
        line = main.lines[d]
        lag_u_s = main.joint[d].estimates["lag_s"].u
        smooth = smooth_traces(test, disk, rows, chains[d], lag_u_s)
        cooled = compensate_disk(test, disk, rows, smooth, profile)
        fit = cooling_fit(
            cooled.window,
            line.line,
            test.events.unload_s,
            window_s,
            cooled.noise_K,
            log_h_prior(disk.setup.surface),
        )
        effects, by_lag = cooling_effects(cooled, fit.share, fit.h_W_m2K)
        traces[d] = cooled.used_traces
        windows[d] = cooled.window
        fits[d] = fit
        sensitivities[d] = cooling_sensitivity(fit, effects, by_lag, line)
    return _CoolingFits(traces, windows, fits, sensitivities)


def _values(main: _MainFits, cooling: Mapping[str, CoolingFit]) -> dict[str, float]:
    """Values of all quantities but the surface temperatures, by key of ``Partition.estimates``.

    The keys must be those of ``tcdyn.partition.crosscheck._Sampler.samples``.
    """
    values = {
        "speed law": main.speed.beta,
        "h_fast": main.speed.h_fast,
        "h_slow": main.speed.h_slow,
        "exponent": main.test.speed_exponent,
    }
    for d in DISKS:
        line = main.lines[d].line
        values |= {
            f"{d} intercept": line.intercept,
            f"{d} slope": line.slope,
            f"cooling {d}": cooling[d].beta,
            f"h cooling {d}": cooling[d].h_W_m2K,
            f"joint {d}": main.joint[d].beta,
            f"h joint {d}": main.joint[d].h_W_m2K,
        }
    return values


def check_suspects(sensors: SensorCheck) -> list[Finding]:
    """The findings on suspected sensors; an error if a channel makes the test unusable.

    Parameters
    ----------
    sensors
        The sensor check.

    Raises
    ------
    InputError
        If a channel is dead, swapped, or has an offset above ``MAX_OFFSET_K``.
    """
    findings = [suspect.finding for suspect in sensors.suspects]
    for finding in findings:
        numbers = finding.numbers
        is_dead = numbers["kind"] == "dead"
        large_offset = numbers["kind"] == "offset" and abs(numbers["size"] or 0.0) > MAX_OFFSET_K
        unusable = is_dead or large_offset
        if unusable or finding.severity is Severity.ERROR:
            raise InputError(
                finding.sentence,
                expected="living junctions where rig.toml says",
                remedy="map the columns in rig.toml [columns], or go on at your own risk "
                "with {sensor_check}",
                parameters={"sensor_check": False},
                column=numbers["columns"][0] if unusable else "",
            )
    return findings


def _exchanged_cables(test: EhlTest, both: BothFit) -> list[Finding]:
    """A warning if the disks' cables look exchanged.

    Then the exponent is the opposite of the speed law's, or the readings at rest are each other's.

    Parameters
    ----------
    test
        The prepared test.
    both
        The fit of both disks.

    Notes
    -----
    ``EXCHANGED_Z`` and ``OPPOSITE_Z`` only decide on the warning.
    ``tests/partition/test_sensors.py`` (study) tests it.
    """
    n = both.estimates["exponent"]
    assumed = test.speed_exponent
    law_u = test.exponent_half_range / 3**0.5
    u = float(np.hypot(n.u, law_u))
    distance_z = abs(assumed - n.value) / u
    opposite_z = abs(assumed + n.value) / u
    if distance_z < EXCHANGED_Z:
        return []
    at_rest = cables_exchanged(test)
    if opposite_z > OPPOSITE_Z and not at_rest:
        return []
    return [
        warning(
            "cables.exchanged",
            exponent=n.value,
            u=n.u,
            assumed=assumed,
            beta=both.estimates["beta"].value,
            at_rest=at_rest,
        )
    ]


def _check_sensors(test: EhlTest, rows: slice, joint_s: float, profile: Profile) -> SensorCheck:
    """The sensor check, with the power that the disks show if that explains all suspects.

    Parameters
    ----------
    test
        The prepared test.
    rows
        Rows for the steady lines.
    joint_s
        Length of the cooling of the joint fits [s].
    profile
        Profile of the inner boundary along z.

    Notes
    -----
    A frictional power in a wrong unit can make sound channels look faulty. If the check with the
    scaled power is sound, that is its result; otherwise the first one stands.
    """
    sensors = check_sensors(test)
    if sensors.sound:
        return sensors
    try:
        _, speed = steady_lines(test, rows, profile)
        joint = single_disk_fits(test, speed.starts, joint_s, profile)
    except InputError:
        return sensors
    scale = power_scale(*(joint[d].estimates["beta"].value for d in DISKS))
    if scale <= 0 or abs(scale - 1) < POWER_SCALE_TOLERANCE:
        return sensors
    scaled = check_sensors(replace(test, power_W=test.power_W * scale))
    return scaled if scaled.sound else sensors


def with_slowing_by_speed_law(test: EhlTest) -> EhlTest:
    """The test with the air offset of slowing disks at the speed law's share and h."""
    if not test.relative_speed:
        return test
    _, speed = steady_lines(test, fit_rows(test, joint_window_s(test)))
    return with_slowing_air_offset(test, speed.starts)


def expected_harmonics(
    estimated: Mapping[str, AngularHarmonic], stated: Mapping[str, AngularHarmonic] = NO_HARMONICS
) -> dict[str, AngularHarmonic]:
    """Priors of the harmonics for a second fit: by stated press fits, else by the first fit.

    Parameters
    ----------
    estimated
        Harmonic of each disk by the first fit.
    stated
        Prior of each disk with a stated press fit.
    """
    return {d: stated.get(d, harmonic.expected) for d, harmonic in estimated.items()}


def any_significant(expected: Mapping[str, AngularHarmonic]) -> bool:
    """Whether a harmonic is significant, so that a second fit is needed.

    Parameters
    ----------
    expected
        Result of :func:`expected_harmonics`: only a significant harmonic has a second one.
    """
    return any(harmonic.second_harmonic_u_K > 0 for harmonic in expected.values())


def without_harmonics(
    test: EhlTest, estimated: Mapping[str, AngularHarmonic], expected: Mapping[str, AngularHarmonic]
) -> EhlTest:
    """The test without the estimated harmonics, and with their remaining uncertainty.

    Parameters
    ----------
    test
        The test.
    estimated
        Harmonics by the joint fit.
    expected
        Their priors, which hold the uncertainty of second harmonic and angles.
    """
    remaining = {
        d: replace(
            estimated[d],
            second_harmonic_u_K=harmonic.second_harmonic_u_K,
            angle_level_K=harmonic.angle_level_K,
        )
        for d, harmonic in expected.items()
    }
    return remove_harmonics(test, remaining)


def remove_harmonics(test: EhlTest, harmonics: Mapping[str, AngularHarmonic]) -> EhlTest:
    """The test with circumferential harmonics subtracted from the readings.

    Parameters
    ----------
    test
        The test.
    harmonics
        The harmonic of each disk; the returned test holds them.

    Notes
    -----
    The harmonic is late by the common lag of the disk. ``tests/partition/test_stated_fit.py`` and
    ``tests/partition/test_uneven.py`` (studies) check what was subtracted.
    """
    disks = {}
    for d, disk in test.disks.items():
        since_s = test.time_s - test.events.unload_s - disk.common_lag_s
        corrected = disk.readings_degC - harmonic_K(harmonics[d], disk.setup, since_s)
        disks[d] = replace(disk, readings_degC=corrected)
    return replace(test, disks=disks, harmonics=harmonics)


def refine_lags(test: EhlTest) -> Mapping[str, SingleDiskFit]:
    """Joint fits of the logged disks, for their chains.

    Parameters
    ----------
    test
        The test, with one or both disks.

    Notes
    -----
    ``compensate`` uses it (:mod:`tcdyn.workflows.compensate`). An inner row at several depths is
    not corrected.
    """
    test = with_slowing_by_speed_law(with_linear_steel(with_surface_air(test)))
    length_s = joint_window_s(test)
    _, speed = steady_lines(test, fit_rows(test, length_s))
    return single_disk_fits(test, speed.starts, length_s)
