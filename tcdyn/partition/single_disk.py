"""A test of which one disk was logged: the ways to beta that it allows, and how far they agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning, warnings_and_errors
from tcdyn.estimation import Optimum, minimise
from tcdyn.partition.analyse import (
    WINDOW_S,
    check_suspects,
    remove_and_expect_harmonics,
    with_slowing_by_speed_law,
)
from tcdyn.partition.angular_harmonic import Unevenness, harmonic_from_fit
from tcdyn.partition.cooling import (
    CoolingFit,
    compensated,
    cooling_errors,
    cooling_fit,
    cooling_shift,
    refined_chains,
    require_window_longer_than_lag,
    smoothed,
    with_slowing_air_offset,
)
from tcdyn.partition.crosscheck import MODEL_FORM_REL, SUSPECT_Z, stacked_sensitivity
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import (
    JOINT_WINDOW_S,
    LOG_H,
    TOLERANCE,
    DiskFit,
    disk_fit,
    joint_problem,
    unknowns,
)
from tcdyn.partition.model_forms import is_impossible
from tcdyn.partition.nuisance import harmonic_prior
from tcdyn.partition.sensor_check import SensorCheck, check_sensors
from tcdyn.partition.steady import DiskLine, at_one_radius, at_own_temperature, steady_lines
from tcdyn.partition.surface_flux import log_h_prior, with_surfaces
from tcdyn.partition.window import stretch_of
from tcdyn.smoothing.record import Compensated

QUANTITIES = ("intercept", "slope", "cooling", "h cooling", "joint", "h joint", "lag_s")
SHARES = np.array([1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0])  # which of them the rim's form scales
WAYS = ("joint", "cooling")
COOLING, JOINT = QUANTITIES.index("cooling"), QUANTITIES.index("joint")


@dataclass(frozen=True)
class OneDisk:
    """Steady line, cooling fit and joint fit of the only ``disk`` of a test.

    ``answers``: ``QUANTITIES`` with their uncertainties; "cooling" and "joint" are beta of the fast disk, h in W/m2K;
    ``z``: of the difference of those two in standard uncertainties of it; ``budget``: of beta, by
    source, by the joint fit and by the cooling fit. ``optimum``: where the joint fit ended; ``compensated``: by disk,
    the traces of ``rows`` of the log.
    """

    test: EhlTest
    disk: str
    rows: slice
    line: DiskLine
    joint: DiskFit
    optimum: Optimum
    cooling: CoolingFit
    uneven: Unevenness
    sensors: SensorCheck | None
    compensated: Mapping[str, Compensated]
    answers: Mapping[str, Estimate]
    z: float
    budget: Mapping[str, tuple[float, float]]
    noticed: tuple[Finding, ...]

    @property
    def withheld(self) -> frozenset[str]:
        """Ways that cannot be true, "joint" or "cooling": beta outside 0 to 1, or h not above zero; not to be shown."""
        return frozenset(
            way for way in WAYS if is_impossible(self.answers[way], self.answers[f"h {way}"])
        )

    @property
    def crosscheck(self) -> Finding:
        """Whether the two ways agree; where one is withheld, which."""
        if self.withheld:
            return warning(
                "answers.impossible",
                ways=[f"{way} {self.disk}" for way in WAYS if way in self.withheld],
            )
        joint, cooling = (self.answers[way] for way in WAYS)
        return (warning if self.z > SUSPECT_Z else info)(
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
        """All that was noticed, whether the ways agree last."""
        return (*self.noticed, self.crosscheck)

    @property
    def status(self) -> str:
        """ "sound", "warning" with at least one warning, "withheld" for a physically impossible estimate."""
        if "joint" in self.withheld:
            return "withheld"
        return "warning" if warnings_and_errors(self.findings) else "sound"

    @property
    def headline(self) -> Finding:
        """Beta by the joint fit of the disk, and what it rests on."""
        if self.status == "withheld":
            return warning("headline.withheld", subject=self.disk)
        beta = self.answers["joint"]
        return info("one_disk.headline", subject=self.disk, beta=beta.value, u=beta.u)


def analyse_one(
    test: EhlTest,
    *,
    window_s: float = WINDOW_S,
    sensor_check: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> OneDisk:
    """Steady line, joint fit and cooling fit of a test with one disk.

    With no second disk there is no speed law and no sum of shares: beta goes one to one with the scale of the friction,
    and what is wrong with steel or depths shows in no cross-check. Arguments and errors as of
    :func:`tcdyn.partition.analyse.analyse`.
    """
    (name,) = test.disks
    require_window_longer_than_lag(test, window_s)
    test = with_slowing_by_speed_law(at_one_radius(at_own_temperature(with_surfaces(test))))
    joint_s = float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))
    rows = stretch_of(test, max(window_s, joint_s))
    sensors = None
    findings = [*test.findings]
    findings.append(info("one_disk.only", subject=name))
    if test.disks[name].setup.fit.stated:
        findings.append(warning("one_disk.fit_unused", subject=name))
    if sensor_check:
        progress("sensor map")
        sensors = check_sensors(test)
        findings += check_suspects(sensors)
    progress("joint fit")
    share, h = steady_lines(test, rows)[1].starts[name]
    fit = disk_fit(test, test.disks[name], share, h, joint_s, "modal")
    if test.slowing:
        test = with_slowing_air_offset(test, {name: (fit.share, fit.h_W_m2K)})
        fit = disk_fit(test, test.disks[name], fit.share, fit.h_W_m2K, joint_s, "modal")
    found, best = _round(test, fit)
    even, again = remove_and_expect_harmonics(test, {name: found})
    if again is not None:
        fit = disk_fit(again, again.disks[name], fit.share, fit.h_W_m2K, joint_s, "modal")
        found, best = _round(again, fit)
        even, _ = remove_and_expect_harmonics(again, {name: found})
        findings += [told for told in (found.finding(name),) if told is not None]
    progress("cooling fit")
    disk = even.disks[name]
    line = steady_lines(even, rows)[0][name]
    chains = refined_chains(disk.chains, fit.chain)
    cooled = compensated(
        even, disk, rows, smoothed(even, disk, rows, chains, fit.estimates["lag_s"].u)
    )
    prior = log_h_prior(disk.setup.surface)
    cooling = cooling_fit(
        cooled.window, line.line, test.events.unload_s, window_s, cooled.noise_K, prior
    )
    shift = cooling_shift(cooling, *cooling_errors(cooled, cooling.share, cooling.h_W_m2K), line)
    per_sd, root = stacked_sensitivity(line.sensitivity, shift, fit.sensitivity)
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
    apart = np.eye(len(QUANTITIES))[JOINT] - np.eye(len(QUANTITIES))[COOLING]
    z = float(abs(apart @ values) / np.sqrt(apart @ covariance @ apart))
    of_fast = (
        values
        if name == "fast"
        else np.where(np.isin(QUANTITIES, ("cooling", "joint")), 1 - values, values)
    )
    u = np.sqrt(np.diag(covariance))
    answers = {n: Estimate.normal(float(x), float(s)) for n, x, s in zip(QUANTITIES, of_fast, u)}
    budget = _budget(
        [q.source for q in fit.sensitivity.parameters], per_sd, root, float(form[JOINT])
    )
    return OneDisk(
        even,
        name,
        rows,
        line,
        fit,
        best,
        cooling,
        found,
        sensors,
        {name: cooled.shown},
        answers,
        z,
        budget,
        tuple(findings),
    )


def _round(test: EhlTest, fit: DiskFit) -> tuple[Unevenness, Optimum]:
    """The harmonic round the bore of the disk, by its joint fit, and where that ended."""
    problem = joint_problem([fit.side])
    unknown = unknowns([fit.side])
    start = np.append(fit.theta, np.zeros(len(problem.names) - len(fit.theta)))
    best = minimise(problem, start, tolerance=TOLERANCE)
    left = best.theta[4:], best.covariance[4:, 4:], unknown
    return harmonic_from_fit(
        *left, fit.disk, float(np.exp(best.theta[LOG_H])), harmonic_prior(test, fit.disk)
    ), best


def _budget(
    sources: list[str], per_sd: Array, root: Array, form: float
) -> dict[str, tuple[float, float]]:
    """Standard uncertainty of beta by source, by the joint fit and by the cooling fit; the largest first."""
    on = {source: np.array([s == source for s in sources]) for source in sources}
    parts = {
        source: [float(np.hypot.reduce(per_sd[rows, k])) for k in (JOINT, COOLING)]
        for source, rows in on.items()
    }
    parts |= {
        "noise": [float(np.hypot.reduce(root[k])) for k in (JOINT, COOLING)],
        "rim model form": [form, form],
    }
    return {
        source: (u[0], u[1]) for source, u in sorted(parts.items(), key=lambda part: -part[1][0])
    }
