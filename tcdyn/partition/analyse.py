"""Analysis of one EHL test with one or both disks: all estimators of beta and their cross-check.

``analyse`` runs the stages in order: corrections, sensor check, steady lines and joint fits
(:mod:`tcdyn.partition.fit_rounds`), compensation and cooling fits, model-form alternatives, Monte
Carlo budget, cross-check. The physics of each stage is in its own module of
:mod:`tcdyn.partition`. With one disk there is no speed law, no sum of shares and no comparison of
model forms. Used by :mod:`tcdyn.workflows`, :mod:`tcdyn.report`, :mod:`tcdyn.plots` and
:mod:`tcdyn.campaign.compress`. Thresholds are chosen by judgement. Guarded by the behaviour suite
(``tests/behaviour/test_behaviour.py``) and by all of ``tests/partition``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import (
    Finding,
    Severity,
    error,
    info,
    messages,
    warning,
    warnings_and_errors,
)
from tcdyn.core.progress import Progress, no_progress
from tcdyn.heat.rim import Profile
from tcdyn.partition.at_rest import cables_exchanged, disks_differ
from tcdyn.partition.cooling import (
    CoolingFit,
    CoolingSensitivity,
    compensate_disk,
    cooling_effects,
    cooling_fit,
    cooling_sensitivity,
    refined_chains,
    require_window_longer_than_lag,
    smooth_traces,
    surface_temperatures,
    with_slowing_air_offset,
)
from tcdyn.partition.crosscheck import Budget, CrossCheck, cross_check, monte_carlo, tensions
from tcdyn.partition.events import EhlTest
from tcdyn.partition.fit_rounds import MainFits, fit_in_rounds
from tcdyn.partition.joint import JOINT_WINDOW_S, CombinedFit, DiskFit, disk_fit
from tcdyn.partition.model_forms import (
    ESTIMATORS,
    POWER_SCALE_TOLERANCE,
    ModelForms,
    best_determined,
    compare_model_forms,
    impossibility_findings,
    impossible_keys,
    is_undetermined,
    power_scale,
)
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
    cooling, joint, combined
        Cooling fit and joint fit of each disk, and the joint fit of all disks.
    budget
        Uncertainty budget with samples of every quantity.
    crosscheck
        Agreement of the estimators.
    estimates
        Every quantity with the uncertainty of the budget's samples, which hold their correlations.
        For each disk d: "d intercept" and "d slope" of its steady line, "cooling d" and "joint d"
        (beta), "h cooling d" and "h joint d" [W/m2K], "surface d" [degC]. With both disks also
        "speed law" (beta), "h_fast" and "h_slow" [W/m2K], "exponent" and "delta_T_us" [K m/s].
    chains
        Chains of each disk: the record's, their common lag refined by the joint fit.
    compensated
        Traces of each disk over ``rows``, smoothed with ``chains``.
    windows
        Window of each disk's compensated traces.
    sensors
        The sensor check; None if it was not made.
    model_forms
        The fit of both disks under all model-form alternatives; None with one disk.
    analysis_findings
        Findings of the analysis, without the cross-check's conclusion.
    """

    test: EhlTest
    rows: slice
    lines: Mapping[str, DiskLine]
    speed: SpeedLawPoint
    cooling: Mapping[str, CoolingFit]
    joint: Mapping[str, DiskFit]
    combined: CombinedFit
    budget: Budget
    crosscheck: CrossCheck
    estimates: Mapping[str, Estimate]
    chains: Mapping[str, tuple[Chain, ...]]
    compensated: Mapping[str, Compensated]
    windows: Mapping[str, DiskWindow]
    sensors: SensorCheck | None
    model_forms: ModelForms | None
    analysis_findings: tuple[Finding, ...]

    @property
    def disks(self) -> tuple[str, ...]:
        """Names of the disks of the test, the fast disk first."""
        return tuple(self.joint)

    @property
    def single_disk(self) -> str:
        """Name of the disk of a test with one disk; empty for a test with both."""
        return "" if len(self.disks) == len(DISKS) else self.disks[0]

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
        return _beta_by_estimator(self.estimates)

    @property
    def impossible(self) -> frozenset[str]:
        """Keys of estimates that are impossible or not determined, and so not reported.

        "both beta" is that of the combined fit.
        """
        return impossible_keys(self.estimates, self.combined.estimates)

    @property
    def status(self) -> str:
        """ "sound", "warning" with at least one warning, "withheld" without a recommendation."""
        if "both beta" in self.impossible:
            return "withheld"
        return "warning" if warnings_and_errors(self.findings) else "sound"

    @property
    def recommendation(self) -> Finding:
        """The recommended estimate, that of the combined fit, and the reason."""
        beta = self.combined.estimates["beta"]
        if "both beta" in self.impossible:
            return error("headline.withheld", subject=self.single_disk, **self._withheld_numbers())
        forms = self.model_forms
        if forms is None:
            return info("one_disk.headline", subject=self.single_disk, beta=beta.value, u=beta.u)
        numbers: dict[str, Any] = {}
        if "both exponent" not in self.impossible:
            exponent = self.combined.estimates["exponent"]
            numbers |= {"exponent": exponent.value, "exponent_u": exponent.u}
        if forms.preferred is not None:
            numbers["named"] = forms.preferred.name
            numbers["named_beta"] = forms.preferred.beta.value
        return info(
            "headline.both",
            beta=beta.value,
            u=beta.u,
            assumed=self.test.speed_exponent,
            z=forms.assumed.speed_law_z,
            count=len(forms.forms) - 1,
            low95=forms.low95,
            high95=forms.high95,
            **numbers,
        )

    def _withheld_numbers(self) -> dict[str, Any]:
        """Fields of ``headline.withheld``: why, and the best estimate that is still determined."""
        beta = self.combined.estimates["beta"]
        numbers: dict[str, Any] = {}
        if is_undetermined(beta):
            numbers |= {"low95": beta.low95, "high95": beta.high95}
        best = best_determined(self.estimates, self.combined.estimates)
        if best is not None:
            remaining = self.estimates[best]
            numbers |= {"determined": best, "beta": remaining.value, "u": remaining.u}
        return numbers

    @cached_property
    def profiles(self) -> pd.DataFrame:
        """Profiles of the joint fits, see ``tcdyn.partition.profile``; computed on first use."""
        return joint_profiles(self.joint, self.combined)


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
    weights: Array | None = None,
    seed: int = 0,
    sensor_check: bool = True,
    progress: Progress = no_progress,
) -> Partition:
    """Steady lines, joint fits, compensation, cooling fits, budget and cross-check of one test.

    Parameters
    ----------
    test
        The test, with one or both disks.
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
    """
    corrected = apply_corrections(test)
    sensors = None
    if sensor_check:
        progress("sensor map")
        sensors = check_sensors_or_power(corrected, profile)
        problem = unusable_channel(sensors)
        if problem is not None:
            raise problem
    return analyse_corrected(
        corrected,
        sensors,
        window_s=window_s,
        profile=profile,
        weights=weights,
        seed=seed,
        progress=progress,
    )


def analyse_corrected(
    test: EhlTest,
    sensors: SensorCheck | None,
    *,
    window_s: float = WINDOW_S,
    profile: Profile = "modal",
    weights: Array | None = None,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Partition:
    """The stages of :func:`analyse` after the sensor check.

    Parameters
    ----------
    test
        Result of :func:`apply_corrections`.
    sensors
        Its sensor check; None if it was not made.
    window_s, profile, weights, seed, progress
        As of :func:`analyse`.

    Raises
    ------
    InputError
        If the data contradict the model.

    Notes
    -----
    The order of the stages matters: the joint fits give the chains by which the traces are
    compensated, and the harmonics that are subtracted before. A finding on wrong units comes before
    all others, because it explains them.
    """
    require_window_longer_than_lag(test, window_s)
    joint_s = joint_window_s(test)
    rows = fit_rows(test, max(window_s, joint_s))
    progress("steady lines and joint fits")
    main = fit_in_rounds(test, rows, joint_s, profile, weights)
    joint = main.joint
    combined = main.combined
    progress("other structures, compensation and cooling fits")
    chains = {d: refined_chains(main.test.disks[d].chains, fit.chain) for d, fit in joint.items()}
    cooling = _fit_cooling(main, rows, chains, window_s, profile)
    budget = monte_carlo(main.test, main.lines, cooling.fits, cooling.sensitivities, joint, seed)
    values = _estimated_values(main, cooling.fits)
    surface, surface_samples = surface_temperatures(
        main.test, values, cooling.windows, budget.samples
    )
    values |= surface
    samples = {**budget.samples, **surface_samples}
    forms = None
    if len(joint) == len(DISKS):
        forms = compare_model_forms(main.fitted_test, joint, combined)
    estimates = {
        key: Estimate.normal(value, float(np.std(samples[key]))) for key, value in values.items()
    }
    possible_forms = forms
    if "both beta" in impossible_keys(estimates, combined.estimates):
        possible_forms = None
    findings = [
        *test.findings,
        *_findings_of_number_of_disks(test),
        *_suspect_findings(sensors),
        *main.findings,
    ]
    causes = impossibility_findings(estimates, combined.estimates, samples)
    wrong_units = [f for f in causes if f.numbers.get("units")]  # they explain all other findings
    findings = [
        *_exchanged_cables(test, combined),
        *disks_differ(test),
        *wrong_units,
        *findings,
        *(f for f in causes if f not in wrong_units),
    ]
    if possible_forms is not None:
        findings += possible_forms.findings
    checked = cross_check(
        _beta_by_estimator(estimates),
        samples,
        tensions(main.test, joint, combined, sensors),
        possible_forms,
    )
    return Partition(
        test=main.test,
        rows=rows,
        lines=main.lines,
        speed=main.speed,
        cooling=cooling.fits,
        joint=joint,
        combined=combined,
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


def _beta_by_estimator(estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Those of the estimates that are beta of the fast disk, by estimator."""
    return {key: estimates[key] for key in ESTIMATORS if key in estimates}


def _suspect_findings(sensors: SensorCheck | None) -> list[Finding]:
    """The findings on suspected sensors; none without a sensor check."""
    return [] if sensors is None else [suspect.finding for suspect in sensors.suspects]


def _findings_of_number_of_disks(test: EhlTest) -> list[Finding]:
    """What is missing in a test with one disk."""
    if len(test.disks) == len(DISKS):
        return []
    (disk,) = test.disks
    return [info("one_disk.only", subject=disk)]


def apply_corrections(test: EhlTest) -> EhlTest:
    """The test with all corrections that the fits need.

    Notes
    -----
    Surface air, linear steel, inner row at one radius, air of slowing disks, in this order: each
    uses the ones before. ``refine_lags`` applies the same corrections except the inner row's.
    """
    test = with_surface_air(test)
    test = with_linear_steel(test)
    test = with_inner_row_at_one_radius(test)
    return with_slowing_by_speed_law(test)


def joint_window_s(test: EhlTest) -> float:
    """Length of the cooling of the joint fits: the default, or what the log holds [s]."""
    return float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))


def _fit_cooling(
    main: MainFits,
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

    Returns
    -------
    _CoolingFits
        Traces, window, fit and sensitivity of each disk.
    """
    test = main.test
    traces: dict[str, Compensated] = {}
    windows: dict[str, DiskWindow] = {}
    fits: dict[str, CoolingFit] = {}
    sensitivities: dict[str, CoolingSensitivity] = {}
    for d, disk in test.disks.items():
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


def _estimated_values(main: MainFits, cooling: Mapping[str, CoolingFit]) -> dict[str, float]:
    """Values of all quantities but the surface temperatures, by key of ``Partition.estimates``.

    The keys must be those of ``tcdyn.partition.crosscheck._Sampler.samples``.
    """
    values = {}
    if len(main.joint) == len(DISKS):
        values = {
            "speed law": main.speed.beta,
            "h_fast": main.speed.h_fast,
            "h_slow": main.speed.h_slow,
            "exponent": main.test.speed_exponent,
        }
    for d, fit in main.joint.items():
        line = main.lines[d].line
        values |= {
            f"{d} intercept": line.intercept,
            f"{d} slope": line.slope,
            f"cooling {d}": cooling[d].beta,
            f"h cooling {d}": cooling[d].h_W_m2K,
            f"joint {d}": fit.beta,
            f"h joint {d}": fit.h_W_m2K,
        }
    return values


def unusable_channel(sensors: SensorCheck) -> InputError | None:
    """The error of a channel that makes the test unusable; None if there is none.

    Parameters
    ----------
    sensors
        The sensor check.

    Returns
    -------
    InputError or None
        For a dead or swapped channel, or one with an offset above ``MAX_OFFSET_K``. It names the
        channel where the test is usable without it.
    """
    for finding in _suspect_findings(sensors):
        numbers = finding.numbers
        is_dead = numbers["kind"] == "dead"
        large_offset = numbers["kind"] == "offset" and abs(numbers["size"] or 0.0) > MAX_OFFSET_K
        replaceable = is_dead or large_offset
        if replaceable or finding.severity is Severity.ERROR:
            return InputError(
                finding.sentence,
                expected="living junctions where rig.toml says",
                remedy="map the columns in rig.toml [columns], or go on at your own risk "
                "with {sensor_check}",
                parameters={"sensor_check": False},
                column=numbers["columns"][0] if replaceable else "",
            )
    return None


def _exchanged_cables(test: EhlTest, combined: CombinedFit) -> list[Finding]:
    """A warning if the disks' cables look exchanged; none with one disk.

    Then the exponent is the opposite of the speed law's, or the readings at rest are each other's.

    Parameters
    ----------
    test
        The corrected test.
    combined
        The fit of all disks.

    Notes
    -----
    ``EXCHANGED_Z`` and ``OPPOSITE_Z`` only decide on the warning.
    ``tests/partition/test_sensors.py`` (study) tests it.
    """
    n = combined.estimates.get("exponent")
    if n is None:
        return []
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
            beta=combined.estimates["beta"].value,
            at_rest=at_rest,
        )
    ]


def check_sensors_or_power(test: EhlTest, profile: Profile = "modal") -> SensorCheck:
    """Check the sensors; repeat the check with a scaled power if it suspects a channel.

    Parameters
    ----------
    test
        The corrected test.
    profile
        Profile of the inner boundary along z.

    Returns
    -------
    check
        The check with the scaled power if that one is sound, else the first check. Also the first
        check with one disk, whose scale is not known, and where an InputError stops the fits that
        determine the scale.

    Notes
    -----
    A frictional power in a wrong unit can make sound channels look faulty. The scale is the
    heat of both disks over the logged power. ``POWER_SCALE_TOLERANCE`` only decides whether the
    second check is made. A power that is several times too large may give a wrong scale, since the
    joint fits can then end in another minimum. Test: ``tests/partition/test_sensors.py``.
    """
    sensors = check_sensors(test)
    if sensors.sound or len(test.disks) < len(DISKS):
        return sensors
    joint_s = joint_window_s(test)
    try:
        _, speed = steady_lines(test, fit_rows(test, joint_s), profile)
        beta = {
            d: disk_fit(test, test.disks[d], *point, joint_s, profile).beta
            for d, point in speed.starts.items()
        }
    except InputError:
        return sensors
    scale = power_scale(beta["fast"], beta["slow"])
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


def refine_lags(test: EhlTest) -> Mapping[str, DiskFit]:
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
    return {
        d: disk_fit(test, test.disks[d], *point, length_s, "modal")
        for d, point in speed.starts.items()
    }
