"""Analysis of a test with one disk: its estimators of beta, and how far they agree.

With no second disk there is no speed law and no fit of both disks. The recommended estimate is the
joint fit; the cooling fit is compared with it. The stages are those of
:mod:`tcdyn.partition.analyse`, and the uncertainties are linear instead of sampled. Used by
:mod:`tcdyn.workflows.single_disk`, the reports and the plots. Guarded by
``tests/partition/test_one_disk.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning, warnings_and_errors
from tcdyn.estimation import Optimum, minimise
from tcdyn.partition.analyse import (
    WINDOW_S,
    any_significant,
    check_suspects,
    expected_harmonics,
    joint_window_s,
    prepare_test,
    without_harmonics,
)
from tcdyn.partition.angular_harmonic import AngularHarmonic, harmonic_from_fit
from tcdyn.partition.cooling import (
    CoolingFit,
    compensate_disk,
    cooling_effects,
    cooling_fit,
    cooling_sensitivity,
    refined_chains,
    require_window_longer_than_lag,
    smooth_traces,
    with_slowing_air_offset,
)
from tcdyn.partition.crosscheck import MODEL_FORM_REL, SUSPECT_Z, stacked_sensitivity
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import (
    LOG_H,
    TOLERANCE,
    DiskFit,
    disk_fit,
    joint_problem,
    nuisance_parameters,
)
from tcdyn.partition.model_forms import is_impossible
from tcdyn.partition.nuisance import harmonic_prior
from tcdyn.partition.sensor_check import SensorCheck, check_sensors
from tcdyn.partition.specified import log_h_prior
from tcdyn.partition.steady import DiskLine, steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.smoothing.record import Compensated

# Numbers of the three fits, in the order of ``tcdyn.partition.crosscheck.stacked_sensitivity``.
QUANTITIES = ("intercept", "slope", "cooling", "h cooling", "joint", "h joint", "lag_s")
# Which of them the form of the rim scales: shares, and the line of shares.
SHARES = np.array([1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0])
# Estimators of beta, the recommended one first.
ESTIMATORS = ("joint", "cooling")
COOLING = QUANTITIES.index("cooling")
JOINT = QUANTITIES.index("joint")


@dataclass(frozen=True)
class OneDisk:
    """Steady line, cooling fit and joint fit of the only disk of a test.

    Parameters
    ----------
    test
        The test without the circumferential harmonic.
    disk
        Name of the disk.
    rows
        Rows of the test that the fits use.
    line, joint, cooling
        The fits.
    optimum
        Optimum of the joint fit.
    harmonic
        First circumferential harmonic by the joint fit.
    sensors
        The sensor check; None if it was not made.
    compensated
        Traces of ``rows``, by disk.
    estimates
        ``QUANTITIES`` with their uncertainties; "cooling" and "joint" are beta of the fast disk, h
        in W/m2K.
    z
        Difference of those two in standard uncertainties of it.
    budget
        Standard uncertainty of beta by source, by the joint fit and by the cooling fit.
    analysis_findings
        Findings of the analysis, without the cross-check's conclusion.
    """

    test: EhlTest
    disk: str
    rows: slice
    line: DiskLine
    joint: DiskFit
    optimum: Optimum
    cooling: CoolingFit
    harmonic: AngularHarmonic
    sensors: SensorCheck | None
    compensated: Mapping[str, Compensated]
    estimates: Mapping[str, Estimate]
    z: float
    budget: Mapping[str, tuple[float, float]]
    analysis_findings: tuple[Finding, ...]

    @property
    def impossible(self) -> frozenset[str]:
        """Estimators with impossible results, "joint" or "cooling"; these are not reported."""
        return frozenset(
            estimator
            for estimator in ESTIMATORS
            if is_impossible(self.estimates[estimator], self.estimates[f"h {estimator}"])
        )

    @property
    def crosscheck(self) -> Finding:
        """Whether the two estimators agree, or which of them is impossible."""
        if self.impossible:
            ways = [
                f"{estimator} {self.disk}"
                for estimator in ESTIMATORS
                if estimator in self.impossible
            ]
            return warning("answers.impossible", ways=ways)
        joint, cooling = (self.estimates[estimator] for estimator in ESTIMATORS)
        severity = warning if self.z > SUSPECT_Z else info
        return severity(
            "one_disk.ways",
            subject=self.disk,
            z=self.z,
            joint=joint.value,
            joint_u=joint.u,
            cooling=cooling.value,
            cooling_u=cooling.u,
        )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings, whether the estimators agree last."""
        return (*self.analysis_findings, self.crosscheck)

    @property
    def status(self) -> str:
        """ "sound", "warning" with at least one warning, "withheld" for an impossible estimate."""
        if "joint" in self.impossible:
            return "withheld"
        return "warning" if warnings_and_errors(self.findings) else "sound"

    @property
    def recommendation(self) -> Finding:
        """The recommended estimate: beta by the joint fit of the disk."""
        if self.status == "withheld":
            return warning("headline.withheld", subject=self.disk)
        beta = self.estimates["joint"]
        return info("one_disk.headline", subject=self.disk, beta=beta.value, u=beta.u)


@dataclass(frozen=True)
class _JointResult:
    """Joint fit of the disk, and what follows from it.

    Parameters
    ----------
    fit, harmonic, optimum
        The joint fit, its angular harmonic, and its optimum.
    corrected
        The test without the harmonic.
    findings
        Findings of the fit.
    """

    fit: DiskFit
    harmonic: AngularHarmonic
    optimum: Optimum
    corrected: EhlTest
    findings: list[Finding]


def analyse_one_disk(
    test: EhlTest,
    *,
    window_s: float = WINDOW_S,
    sensor_check: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> OneDisk:
    """Steady line, joint fit and cooling fit of a test with one disk.

    With no second disk there is no speed law and no sum of shares: beta is proportional to the
    scale of the friction, and no cross-check shows errors of steel or depths.

    Parameters
    ----------
    test
        The test, with one disk.
    window_s
        Length of the cooling of the cooling fit [s].
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
    The covariance is that of the nuisance parameters, of noise, and of the rim's form, fully
    correlated. The order of ``values`` must be that of ``QUANTITIES``, which is that of
    ``tcdyn.partition.crosscheck.stacked_sensitivity``. ``tests/partition/test_one_disk.py``
    compares the joint fit with that of the full test.
    """
    (name,) = test.disks
    require_window_longer_than_lag(test, window_s)
    test = prepare_test(test)
    rows = fit_rows(test, max(window_s, joint_window_s(test)))
    sensors = None
    findings = [*test.findings, info("one_disk.only", subject=name)]
    if test.disks[name].setup.press_fit.is_specified:
        findings.append(warning("one_disk.fit_unused", subject=name))
    if sensor_check:
        progress("sensor map")
        sensors = check_sensors(test)
        findings += check_suspects(sensors)
    progress("joint fit")
    result = _joint_result(test, name, rows)
    fit = result.fit
    corrected = result.corrected
    findings += result.findings
    progress("cooling fit")
    disk = corrected.disks[name]
    line = steady_lines(corrected, rows)[0][name]
    chains = refined_chains(disk.chains, fit.chain)
    smooth = smooth_traces(corrected, disk, rows, chains, fit.estimates["lag_s"].u)
    cooled = compensate_disk(corrected, disk, rows, smooth)
    cooling = cooling_fit(
        cooled.window,
        line.line,
        test.events.unload_s,
        window_s,
        cooled.noise_K,
        log_h_prior(disk.setup.surface),
    )
    effects, by_lag = cooling_effects(cooled, cooling.share, cooling.h_W_m2K)
    sensitivity = cooling_sensitivity(cooling, effects, by_lag, line)
    per_sd, root = stacked_sensitivity(line.sensitivity, sensitivity, fit.sensitivity)
    values = np.array(
        [
            line.line.intercept,
            line.line.slope,
            cooling.share,
            cooling.h_W_m2K,
            fit.share,
            fit.h_W_m2K,
            fit.chain.lag_s,
        ]
    )
    form = MODEL_FORM_REL * SHARES * values
    covariance = per_sd.T @ per_sd + root @ root.T + np.outer(form, form)
    difference = np.zeros(len(QUANTITIES))
    difference[JOINT] = 1.0
    difference[COOLING] = -1.0
    z = float(abs(difference @ values) / np.sqrt(difference @ covariance @ difference))
    if name != "fast":
        values[[COOLING, JOINT]] = 1 - values[[COOLING, JOINT]]
    u = np.sqrt(np.diag(covariance))
    estimates = {
        key: Estimate.normal(float(x), float(s)) for key, x, s in zip(QUANTITIES, values, u)
    }
    sources = [parameter.source for parameter in fit.sensitivity.parameters]
    return OneDisk(
        test=corrected,
        disk=name,
        rows=rows,
        line=line,
        joint=fit,
        optimum=result.optimum,
        cooling=cooling,
        harmonic=result.harmonic,
        sensors=sensors,
        compensated={name: cooled.used_traces},
        estimates=estimates,
        z=z,
        budget=_budget(sources, per_sd, root, float(form[JOINT])),
        analysis_findings=tuple(findings),
    )


def _joint_result(test: EhlTest, name: str, rows: slice) -> _JointResult:
    """Joint fit, repeated with the air of a slowing disk, and with a significant harmonic.

    Parameters
    ----------
    test
        The prepared test.
    name
        Name of the disk.
    rows
        Rows for the steady line that starts the fit.

    Notes
    -----
    The same steps as ``tcdyn.partition.analyse._main_fits``; a change there should be made here.
    """
    joint_s = joint_window_s(test)
    share, h = steady_lines(test, rows)[1].starts[name]
    fit = disk_fit(test, test.disks[name], share, h, joint_s, "modal")
    if test.relative_speed:
        test = with_slowing_air_offset(test, {name: (fit.share, fit.h_W_m2K)})
        fit = disk_fit(test, test.disks[name], fit.share, fit.h_W_m2K, joint_s, "modal")
    harmonic, optimum = _harmonic(test, fit)
    expected = expected_harmonics({name: harmonic})
    corrected = without_harmonics(test, {name: harmonic}, expected)
    findings = []
    if any_significant(expected):
        again = replace(test, harmonics=expected)
        fit = disk_fit(again, again.disks[name], fit.share, fit.h_W_m2K, joint_s, "modal")
        harmonic, optimum = _harmonic(again, fit)
        corrected = without_harmonics(again, {name: harmonic}, expected_harmonics({name: harmonic}))
        finding = harmonic.finding(name)
        if finding is not None:
            findings.append(finding)
    return _JointResult(fit, harmonic, optimum, corrected, findings)


def _harmonic(test: EhlTest, fit: DiskFit) -> tuple[AngularHarmonic, Optimum]:
    """First circumferential harmonic of the disk by its joint fit.

    Parameters
    ----------
    test
        The test of the fit, with the prior of the harmonic.
    fit
        The joint fit.

    Returns
    -------
    harmonic, optimum
        The harmonic, and the optimum of the fit from its own result.
    """
    problem = joint_problem([fit.block])
    start = np.append(fit.theta, np.zeros(len(problem.names) - len(fit.theta)))
    best = minimise(problem, start, tolerance=TOLERANCE)
    harmonic = harmonic_from_fit(
        best.theta[4:],
        best.covariance[4:, 4:],
        nuisance_parameters([fit.block]),
        fit.disk,
        float(np.exp(best.theta[LOG_H])),
        harmonic_prior(test, fit.disk),
    )
    return harmonic, best


def _budget(
    sources: list[str], per_sd: Array, root: Array, form: float
) -> dict[str, tuple[float, float]]:
    """Standard uncertainty of beta by source, by joint and by cooling fit; the largest first.

    Parameters
    ----------
    sources
        Source of each nuisance parameter, (Q,).
    per_sd, root
        As of :func:`tcdyn.partition.crosscheck.stacked_sensitivity`.
    form
        Standard uncertainty by the form of the rim.
    """
    budget = {}
    for source in sources:
        rows = np.array([s == source for s in sources])
        joint = float(np.hypot.reduce(per_sd[rows, JOINT]))
        budget[source] = joint, float(np.hypot.reduce(per_sd[rows, COOLING]))
    budget["noise"] = float(np.hypot.reduce(root[JOINT])), float(np.hypot.reduce(root[COOLING]))
    budget["rim model form"] = form, form
    return dict(sorted(budget.items(), key=lambda item: -item[1][0]))
