"""Cross-check of the estimators of beta, uncertainty budget, and contradicted nominal values.

The budget is a Monte Carlo simulation by source over all estimators and both disks (GUM Supplement
1). Its samples hold every quantity with its correlations, by which the estimators are compared:
errors common to both cancel. :mod:`tcdyn.partition.analyse` calls it last. The thresholds of
contradictions are set by their rate of false alarms. Guarded by
``tests/partition/test_crosscheck.py``, ``tests/partition/test_depths.py`` and
``tests/partition/test_coverage.py`` (study).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtr

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.partition.cooling import CoolingFit, CoolingSensitivity
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import MIN_LAG_U_S, CombinedFit, DiskFit
from tcdyn.partition.model_forms import ModelForms, is_undetermined
from tcdyn.partition.sensor_check import SensorCheck
from tcdyn.partition.sensor_faults import DepthTest
from tcdyn.partition.steady import DiskLine, FitSensitivity, speed_law_beta
from tcdyn.rig.disk import DISKS

# Probability below which a tension is a contradiction. With the pairs of estimators beyond
# ``SUSPECT_Z``, these give a false alarm in fewer than 7 % of sound tests.
DEPTH_THRESHOLD = 0.03
OTHER_THRESHOLD = 0.01
MIN_PROBABILITY = 1e-12  # smaller probabilities are reported as this
SUSPECT_Z = 3.0  # two estimators disagree beyond this many standard deviations of their difference
# The largest tension is reported if at most half of all sound tests have as large a one.
REPORT_PROBABILITY = 0.5
# Monte Carlo samples: a standard uncertainty is then known to 1 %; and samples of the largest pull.
N_SAMPLES = 4000
N_PULL_SAMPLES = 20_000
# Least number of samples that give a probability; below, the normal tail does. Chosen by judgement.
MIN_COUNT = 20
# Least standard deviation of prior less posterior lag, relative to the prior's: keeps it above
# zero. Chosen by judgement.
MIN_PRIOR_PART = 0.3
# Standard uncertainty of the rim's form (inner profile and mesh), relative to the share; 0.03 % by
# comparison with the whole disk.
MODEL_FORM_REL = 0.002
N_QUANTITIES = 7  # intercept, slope; share, h of the cooling fit; share, h, lag of the joint fit


@dataclass(frozen=True)
class BudgetRow:
    """One source, and its standard uncertainty of beta.

    Parameters
    ----------
    source
        Line of the budget.
    u_beta_steady
        By the speed law; None with one disk.
    u_beta_transient
        By the cooling fit of the worse disk.
    """

    source: str
    u_beta_steady: float | None
    u_beta_transient: float


@dataclass(frozen=True)
class Budget:
    """Uncertainty budget of a test.

    Parameters
    ----------
    rows
        The sources, the largest first.
    samples
        Samples of every quantity by key, all sources together, (N_SAMPLES,) each.
    """

    rows: tuple[BudgetRow, ...]
    samples: dict[str, Array]

    @property
    def total(self) -> BudgetRow:
        """Total of the budget: standard uncertainty of beta by all sources together."""
        return _budget_row("all together", self.samples)


def _budget_row(source: str, samples: Mapping[str, Array]) -> BudgetRow:
    """The row of a source by samples of the quantities in which only this source is uncertain."""
    u_by_key = {
        key: float(np.std(values))
        for key, values in samples.items()
        if key == "speed law" or key.startswith("cooling ")
    }
    steady = u_by_key.pop("speed law", None)
    return BudgetRow(source, steady, max(u_by_key.values()))


def monte_carlo(
    test: EhlTest,
    lines: Mapping[str, DiskLine],
    cooling: Mapping[str, CoolingFit],
    cooling_sensitivities: Mapping[str, CoolingSensitivity],
    joint: Mapping[str, DiskFit],
    seed: int = 0,
) -> Budget:
    """Sample all sources, and propagate them through lines, speed law and transient fits.

    Parameters
    ----------
    test
        The test.
    lines, cooling, cooling_sensitivities, joint
        Steady line, cooling fit with its sensitivity, and joint fit of each disk.
    seed
        Of the random numbers.

    Notes
    -----
    Each source is simulated with all others fixed, then all together. Sources that both disks share
    affect both together. The exponent n is uniform over its range; everything else is normal. The
    fits are linear in their errors; only the speed law is evaluated for each sample.

    ``N_SAMPLES`` may grow: 4000 give a standard uncertainty to 1 %. A new source needs a nuisance
    parameter only. The behaviour suite (``tests/behaviour/test_behaviour.py``) fails if the samples
    change.
    """
    sampler = _Sampler(test, lines, cooling, cooling_sensitivities, joint, seed)
    sources = {
        parameter.source for fit in joint.values() for parameter in fit.sensitivity.parameters
    }
    sources |= {"noise", "rim model form"}
    if len(joint) == len(DISKS):
        sources.add("speed exponent")
    rows = [_budget_row(source, sampler.samples(source)) for source in sorted(sources)]
    rows.sort(key=lambda row: -max(row.u_beta_steady or 0.0, row.u_beta_transient))
    return Budget(tuple(rows), sampler.samples(None))


class _Sampler:
    """Random numbers of all sources, and the quantities that they give.

    Notes
    -----
    The random numbers of each nuisance parameter are drawn once, in the order of the sorted names,
    and serve every call of :meth:`samples`. A name that changes its place in that order changes
    results by their sampling error.
    """

    def __init__(
        self,
        test: EhlTest,
        lines: Mapping[str, DiskLine],
        cooling: Mapping[str, CoolingFit],
        cooling_sensitivities: Mapping[str, CoolingSensitivity],
        joint: Mapping[str, DiskFit],
        seed: int,
    ) -> None:
        """Draw the random numbers; parameters as of :func:`monte_carlo`."""
        self.test = test
        self.lines = lines
        self.cooling = cooling
        self.joint = joint
        self.sensitivity = {
            d: stacked_sensitivity(
                lines[d].sensitivity, cooling_sensitivities[d], joint[d].sensitivity
            )
            for d in joint
        }
        keys = {
            d: [("both" if q.shared else d, q.name) for q in fit.sensitivity.parameters]
            for d, fit in joint.items()
        }
        of_one_disk = [
            (d, name) for d in joint for name in ("common lag", "lag shape", "model form")
        ]
        all_keys = {key for d in joint for key in keys[d]}
        rng = np.random.default_rng(seed)
        names = [*sorted(all_keys - {*of_one_disk}), *of_one_disk]
        normal = {key: rng.standard_normal(N_SAMPLES) for key in names}
        n = test.speed_exponent
        half = test.exponent_half_range
        self.exponent = rng.uniform(n - half, n + half, N_SAMPLES)
        self.noise = {d: rng.standard_normal((N_SAMPLES, N_QUANTITIES)) for d in joint}
        self.parameters = {d: np.column_stack([normal[key] for key in keys[d]]) for d in joint}
        self.model_form = {d: normal[d, "model form"] for d in joint}

    def samples(self, active: str | None) -> dict[str, Array]:
        """Samples of every quantity if only one source is uncertain.

        Parameters
        ----------
        active
            The source; None for all.

        Returns
        -------
        dict
            (N_SAMPLES,) by key; the keys are those of
            ``tcdyn.partition.analyse.Partition.estimates`` without the surface temperatures, and
            the deviation of each lag [s].
        """
        out = dict[str, Array]()
        for d in self.joint:
            out |= self._disk_samples(d, active)
        if len(self.joint) < len(DISKS):
            return out
        exponent = np.full(N_SAMPLES, self.test.speed_exponent)
        if active in (None, "speed exponent"):
            exponent = self.exponent
        a = out["fast intercept"]
        b = out["fast slope"]
        c = out["slow intercept"]
        slope = out["slow slope"]
        chi = self.test.speed_ratio**exponent
        beta = speed_law_beta(a, b, c, slope, chi)
        h_slow = (1 - beta - c) / slope
        return out | {
            "exponent": exponent,
            "speed law": beta,
            "h_fast": (beta - a) / b,
            "h_slow": h_slow,
        }

    def _disk_samples(self, disk: str, active: str | None) -> dict[str, Array]:
        """Samples of the quantities of one disk.

        Parameters
        ----------
        disk
            Name of the disk.
        active
            As of :meth:`samples`.
        """
        per_sd, root = self.sensitivity[disk]
        parameters = self.joint[disk].sensitivity.parameters
        uncertain = np.array([active in (None, q.source) for q in parameters])
        deviation = self.parameters[disk][:, uncertain] @ per_sd[uncertain]
        deviation += (active in (None, "noise")) * self.noise[disk] @ root.T
        intercept, slope, *others = deviation.T
        cooling_share, cooling_h, joint_share, joint_h, lag = others
        form = MODEL_FORM_REL * self.model_form[disk] * (active in (None, "rim model form"))
        scale = 1 + form
        line = self.lines[disk].line
        out = {
            f"{disk} intercept": (line.intercept + intercept) * scale,
            f"{disk} slope": (line.slope + slope) * scale,
            f"lag {disk}": lag,
        }
        transient_fits: tuple[tuple[str, CoolingFit | DiskFit, Array, Array], ...] = (
            ("cooling", self.cooling[disk], cooling_share, cooling_h),
            ("joint", self.joint[disk], joint_share, joint_h),
        )
        for kind, fit, share_deviation, h_deviation in transient_fits:
            share = fit.share * scale + share_deviation
            out[f"{kind} {disk}"] = share if disk == "fast" else 1 - share
            out[f"h {kind} {disk}"] = fit.h_W_m2K + h_deviation
        return out


def stacked_sensitivity(
    line: FitSensitivity, cooling: CoolingSensitivity, joint: FitSensitivity
) -> tuple[Array, Array]:
    """Sensitivity of line, cooling and joint fit of a disk together.

    Parameters
    ----------
    line, cooling, joint
        Sensitivity of (intercept, slope), of (share, h) and of (share, h, lag).

    Returns
    -------
    per_sd
        Errors by one standard uncertainty of each nuisance parameter of the joint fit, (Q, 7).
    root
        A root of the covariance of their noise, (7, 7).

    Notes
    -----
    The compensated lag, which is the joint fit's, changes the cooling fit. The parameters of line
    and cooling fit must be the first of those of the joint fit, in the same order. The order of the
    seven numbers must be that in ``_Sampler._disk_samples``. The behaviour suite
    (``tests/behaviour/test_behaviour.py``) fails if they differ.
    """
    per_sd = np.zeros((len(joint.parameters), N_QUANTITIES))
    per_sd[: len(line.parameters), :2] = line.per_sd
    per_sd[: len(cooling.parameters), 2:4] = cooling.per_sd
    per_sd[:, 4:] = joint.per_sd
    by_lag = np.eye(N_QUANTITIES)
    by_lag[2:4, 6] = cooling.by_lag
    root = block_diag(*(covariance_root(fit.noise) for fit in (line, cooling, joint)))
    return per_sd @ by_lag.T, by_lag @ root


@dataclass(frozen=True)
class Tension:
    """A nominal value, and how far the data would change it.

    Parameters
    ----------
    nominal
        The nominal value, as a finding.
    z
        By how many standard deviations the data would change it.
    probability
        Probability that a sound test has as large a tension among the values of this kind.
    threshold
        The probability below which it is a contradiction.
    """

    nominal: Finding
    z: float
    probability: float
    threshold: float

    @property
    def contradicts(self) -> bool:
        """Whether so large a tension is too improbable for a sound test."""
        return self.probability < self.threshold

    def to_dict(self) -> dict[str, Any]:
        """The entry of ``beta.json``."""
        return {"what": self.nominal.sentence, "z": self.z, "chance": self.probability}


@dataclass(frozen=True)
class CrossCheck:
    """Agreement of the estimators of beta, and of the nominal values with the data.

    Parameters
    ----------
    z
        Largest disagreement of two estimators in standard deviations of their difference; NaN if
        fewer than two are determined.
    finding
        The conclusion: "ways.agree", "ways.apart", "ways.contradicted" or "ways.undetermined".
    p_value
        Probability of so large a disagreement among so many pairs; NaN as ``z``.
    pairs
        Both estimators, their difference, and its z, for each pair.
    suspects
        Nominal values that the data contradict (a depth, a lag, the exponent), worst first.
    largest_tension
        The largest tension, where at most half of all sound tests have as large a one.
    """

    z: float
    finding: Finding
    p_value: float
    pairs: tuple[tuple[str, str, float, float], ...]
    suspects: tuple[Tension, ...]
    largest_tension: Tension | None

    @property
    def agree(self) -> bool:
        """Whether the estimators agree and nothing contradicts the nominal values."""
        return self.finding.code == "ways.agree"

    @property
    def sentence(self) -> str:
        """The conclusion as a sentence."""
        return self.finding.sentence

    def to_dict(self) -> dict[str, Any]:
        """The entry of ``beta.json``."""
        largest = self.largest_tension
        return {
            "z": self.z,
            "agree": self.agree,
            "sentence": self.sentence,
            "p_value": self.p_value,
            "suspects": [t.to_dict() for t in self.suspects],
            "strained": None if largest is None else largest.to_dict(),
            "pairs": [
                {"one": first, "other": second, "difference": difference, "z": z}
                for first, second, difference, z in self.pairs
            ],
        }


def cross_check(
    estimates: Mapping[str, Estimate],
    samples_by_estimator: Mapping[str, Array],
    tensions: Sequence[Tension] = (),
    both: ModelForms | None = None,
) -> CrossCheck:
    """Compare the estimators of beta.

    Parameters
    ----------
    estimates
        beta by each estimator.
    samples_by_estimator
        Monte Carlo samples of each, which share their common errors.
    tensions
        Nominal values and how far the data pull them.
    both
        The fit of both disks under all model-form alternatives; None if it is impossible.

    Notes
    -----
    The difference of two estimators is compared with the spread of the difference of their samples,
    so errors common to both cancel. An estimator whose uncertainty says that beta may be anything
    (``tcdyn.partition.model_forms.is_undetermined``) agrees with all others, which means nothing:
    it is left out. With several pairs, the largest z is judged by the probability
    that any of so many is as large (``p_value``, from the samples themselves). The estimators agree
    if no tension is a contradiction and no pair is beyond ``SUSPECT_Z``.

    ``SUSPECT_Z``, ``DEPTH_THRESHOLD`` and ``OTHER_THRESHOLD`` together set the rate of false
    alarms, below 7 % of sound tests. ``tests/partition/test_crosscheck.py`` tests the rate of the
    pairs.
    """
    estimates = {name: beta for name, beta in estimates.items() if not is_undetermined(beta)}
    if len(estimates) < 2:
        finding = warning("ways.undetermined", determined=list(estimates))
        return CrossCheck(np.nan, finding, np.nan, (), (), None)
    pairs = []
    sampled_z = []
    for first, second in combinations(estimates, 2):
        difference = estimates[first].value - estimates[second].value
        samples = samples_by_estimator[first] - samples_by_estimator[second]
        spread = max(float(np.std(samples)), 1e-12)
        pairs.append((first, second, difference, abs(difference) / spread))
        sampled_z.append(np.abs(samples - samples.mean()) / spread)
    worst = max(pairs, key=lambda pair: pair[3])
    largest = np.max(np.stack(sampled_z), axis=0)
    z = worst[3]
    p = float(np.mean(largest >= z))
    if z > largest.max():  # beyond the samples: the normal tail, for so many pairs
        p = min(1.0, 2 * len(pairs) * float(ndtr(-z)))
    contradictions = [t for t in tensions if t.contradicts]
    suspects = tuple(sorted(contradictions, key=lambda t: -abs(t.z)))
    largest_tension = min(tensions, key=lambda t: t.probability, default=None)
    if largest_tension is not None and largest_tension.probability >= REPORT_PROBABILITY:
        largest_tension = None
    finding = _conclusion(estimates, worst, suspects, largest_tension, both)
    return CrossCheck(z, finding, p, tuple(pairs), suspects, largest_tension)


def _conclusion(
    estimates: Mapping[str, Estimate],
    worst: tuple[str, str, float, float],
    suspects: Sequence[Tension],
    largest_tension: Tension | None,
    both: ModelForms | None,
) -> Finding:
    """The finding of :func:`cross_check`.

    Parameters
    ----------
    estimates, both
        As of :func:`cross_check`.
    worst
        The pair that disagrees most: both names, difference, and z.
    suspects
        Contradictions, the largest first.
    largest_tension
        The largest tension, if it is reported.

    Notes
    -----
    A pair that disagrees comes first, then contradictions, then agreement. The numbers must be
    those of the messages in ``tcdyn/core/messages/partition.py``. The estimate is said to hold only
    where every contradicted value belongs to one disk, as a depth does: the fit of both disks
    allows for it. A friction, an ambient or a bearing correction that the data contradict, or a
    disagreement without a cause, allows no such statement.
    """
    first, second, difference, z = worst
    values = [estimate.value for estimate in estimates.values()]
    numbers: dict[str, Any] = {
        "one": first,
        "other": second,
        "apart": abs(difference),
        "z": z,
        "low": min(values),
        "high": max(values),
        "suspects": [t.nominal.sentence for t in suspects[:3]],
        "suspects_z": [abs(t.z) for t in suspects[:3]],
        "holds": False,
    }
    steady = estimates.get("speed law")
    if steady is not None:
        numbers |= {"steady": steady.value, "steady_u": steady.u}
    # of a value that both disks share it is not known what else depends on it
    all_of_one_disk = all(t.nominal.subject for t in suspects)
    if both is not None:
        numbers |= {
            "holds": both.estimate_holds and bool(suspects) and all_of_one_disk,
            "both": both.assumed.beta.value,
            "both_u": both.assumed.beta.u,
            "low95": both.low95,
            "high95": both.high95,
        }
    if z >= SUSPECT_Z:
        return warning("ways.apart", **numbers)
    if suspects:
        return warning("ways.contradicted", **numbers)
    if largest_tension is not None:
        numbers |= {
            "strained": largest_tension.nominal.sentence,
            "strained_z": abs(largest_tension.z),
            "chance": largest_tension.probability,
        }
    return info("ways.agree", **numbers)


def tensions(
    test: EhlTest,
    joint: Mapping[str, DiskFit],
    combined: CombinedFit,
    sensors: SensorCheck | None = None,
) -> tuple[Tension, ...]:
    """Every nominal value, and by how many standard deviations the data would change it.

    Parameters
    ----------
    test, joint, combined
        The test and its joint fits.
    sensors
        The sensor check; None if it was not made.

    Notes
    -----
    Depths are taken from the sensor check, or without it from the joint fit; other nuisance
    parameters are pulls of the combined fit. Prior and posterior lag differ with variance
    u_prior^2 - u_posterior^2. An exponent within the range about the assumed one is no tension;
    outside it counts from the nearer end. A suspected sensor fault has the normal deviate of its
    odds.

    Each kind is judged by the probability of the largest of its number: depths with their
    correlation, all others as independent. ``tests/partition/test_depths.py`` (study) checks that
    every value is judged once.
    """
    depth_tests = {} if sensors is None else sensors.depths
    depths = _depth_pulls(depth_tests)
    others = _nuisance_pulls(test, combined, depth_tests)
    others += [_lag_pull(test, name, fit) for name, fit in joint.items()]
    if "exponent" in combined.estimates:
        others.append(_exponent_pull(test, combined.estimates["exponent"]))
    largest = sample_largest_pulls([*depth_tests.values()])
    out = [
        Tension(nominal, z, probability_of_pull(z, largest, len(depths)), DEPTH_THRESHOLD)
        for nominal, z in depths
    ]
    for nominal, z in others:
        # how often the largest of so many independent normal deviates is at least |z|
        single = min(2 * float(ndtr(-abs(z))), 1 - 1e-9)
        probability = float(-np.expm1(len(others) * np.log1p(-single)))
        out.append(Tension(nominal, z, probability, OTHER_THRESHOLD))
    for suspect in () if sensors is None else sensors.suspects:
        fault = info(
            "stated.sensors", subject=suspect.disk, kind=suspect.kind, columns=suspect.columns
        )
        z = float(np.sqrt(2.0 * max(suspect.log_odds, 0.0)))
        out.append(Tension(fault, z, MIN_PROBABILITY, OTHER_THRESHOLD))
    return tuple(replace(t, probability=max(t.probability, MIN_PROBABILITY)) for t in out)


def _depth_pulls(depth_tests: Mapping[str, DepthTest]) -> list[tuple[Finding, float]]:
    """Each depth that the sensor check estimates, as a finding, and its pull."""
    pulls = []
    for disk, depth_test in depth_tests.items():
        for (channel, deeper), z in zip(depth_test.deeper_m.items(), depth_test.pull):
            nominal = info(
                "stated.depth",
                subject=disk,
                channel=channel,
                deeper_mm=1e3 * deeper.value,
                u_mm=1e3 * deeper.u,
            )
            pulls.append((nominal, float(z)))
    return pulls


def _nuisance_pulls(
    test: EhlTest, combined: CombinedFit, depth_tests: Mapping[str, DepthTest]
) -> list[tuple[Finding, float]]:
    """Each nuisance parameter of the combined fit, as a finding, and its pull.

    Without depths that the sensor check estimates, and without excluded channels.

    Parameters
    ----------
    test, combined
        The test, and the fit of all its disks.
    depth_tests
        Depth test of each disk that has one.
    """
    pulls = []
    for parameter, disk, z in combined.pulls:
        in_sensor_check = parameter.source == "junction depth" and disk in depth_tests
        channel = parameter.name.rpartition(" ")[2]
        excluded = disk and channel in test.disks[disk].excluded
        if not in_sensor_check and not excluded:
            nominal = info(
                "stated.value", subject=disk, name=parameter.name, source=parameter.source
            )
            pulls.append((nominal, z))
    return pulls


def _lag_pull(test: EhlTest, name: str, fit: DiskFit) -> tuple[Finding, float]:
    """The common lag of the record, as a finding, and its pull by the joint fit of the disk.

    Parameters
    ----------
    test
        The test.
    name
        Name of the disk.
    fit
        Its joint fit.

    Notes
    -----
    ``MIN_PRIOR_PART`` keeps the standard deviation of the difference above zero where the data
    hardly sharpen the lag. The prior must have the least uncertainty of
    ``tcdyn.partition.joint.disk_block``.
    """
    disk = test.disks[name]
    lag = fit.estimates["lag_s"]
    prior_u = max(disk.common_lag_u_s, MIN_LAG_U_S)
    difference_u = np.sqrt(max(prior_u**2 - lag.u**2, (MIN_PRIOR_PART * prior_u) ** 2))
    nominal = info("stated.lag", subject=name, record_s=disk.common_lag_s, unloading_s=lag.value)
    return nominal, float((lag.value - disk.common_lag_s) / difference_u)


def _exponent_pull(test: EhlTest, n: Estimate) -> tuple[Finding, float]:
    """The exponent of the speed law, as a finding, and its pull by the fit of both disks.

    The pull is the distance of the fitted exponent ``n`` from the specified range, over its u.
    """
    assumed = test.speed_exponent
    half = test.exponent_half_range
    outside = n.value - float(np.clip(n.value, assumed - half, assumed + half))
    return info("stated.exponent", assumed=assumed, implied=n.value, u=n.u), outside / n.u


def covariance_root(covariance: Array) -> Array:
    """A square root of a covariance that may be singular, (n, n)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


def sample_largest_pulls(tests: Sequence[DepthTest], seed: int = 0) -> Array:
    """Samples of the largest pull of all depth tests on sound disks, (N_PULL_SAMPLES,).

    Parameters
    ----------
    tests
        The depth tests, with the correlation of their pulls.
    seed
        Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    pulls = [
        rng.standard_normal((N_PULL_SAMPLES, len(t.pull))) @ covariance_root(t.correlation).T
        for t in tests
    ]
    return np.abs(np.hstack([np.zeros((N_PULL_SAMPLES, 1)), *pulls])).max(axis=1)


def probability_of_pull(pull: float, largest: Array, count: int) -> float:
    """Probability that the largest of several pulls is at least as large as a given one.

    Beyond the samples it is that of the normal tail.

    Parameters
    ----------
    pull
        The given pull.
    largest
        Samples of the largest pull, by :func:`sample_largest_pulls`.
    count
        Number of pulls, for the normal tail.
    """
    fraction = float(np.mean(largest >= abs(pull)))
    if fraction * len(largest) >= MIN_COUNT:
        return fraction
    return min(1.0, 2.0 * count * float(ndtr(-abs(pull))))
