"""Result of a campaign: posterior, exponent n, trends, junction depths, outlying tests, findings.

``tcdyn.workflows.campaign`` calls ``join_results``; ``tcdyn.plots``, ``tcdyn.report`` and
``tcdyn.campaign.tables`` show the result. Guarded by ``tests/campaign/test_posterior.py`` and
``tests/campaign/test_lines.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import chdtrc

from tcdyn.campaign.exponent import SpeedLaw, speed_law
from tcdyn.campaign.outliers import OutlyingTest, outlying_tests
from tcdyn.campaign.posterior import Posterior, determined_dof, solve_campaign
from tcdyn.campaign.sufficient_statistics import ANALYSE_AGAIN, SufficientStatistics
from tcdyn.campaign.trends import BetaTrend, Curve, CurveTest, curve_test, trends
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import jsonable
from tcdyn.io.stored import CAMPAIGN
from tcdyn.partition.model_forms import is_impossible, is_undetermined
from tcdyn.partition.steady import speed_law_beta, speed_ratio_power
from tcdyn.rig.disk import DISKS

# A finding reports n if it differs from rig.toml's by more standard uncertainties. By judgement.
EXPONENT_DEVIATION_Z = 2.0
# p-value below which the power law is rejected. Chosen by judgement.
POWER_LAW_REJECTED_P = 0.01
# Pull of a junction depth above which it is reported: the largest in 17 simulated campaigns
# without errors was 3.7.
DEPTH_PULL_Z = 4.0
# p-value below which the shared quantities contradict what is stated about them. By judgement.
CONTRADICTED_P = 0.01
# Largest departures that this message names. Chosen by judgement.
N_NAMED = 3
# Least reduction of the variance of a depth by the data: below it a pull has no meaning.
# Chosen by judgement.
MIN_VARIANCE_REDUCTION = 0.02


@dataclass(frozen=True)
class JoinedCampaign:
    """Joint result of all tests of a rig.

    Attributes
    ----------
    posterior, speed_law, trends
        Quantities with covariance, exponent n, trends of beta.
    outlying_tests
        Tests that do not agree with the others; they are not in the posterior.
    curves
        Curves of a model compared with the tests.
    deeper_mm, pulls
        By disk and channel: estimated depth minus stated depth of a junction, and this difference
        in the standard deviations that the data alone would cause.
    single_beta
        beta of each test by its own joint fit.
    speed_law_beta
        beta by each test's steady lines and the campaign's n.
    status, delta_T_us
        Of each test; delta_T_us in K m/s.
    excluded
        Tests that could not be used, and why.
    """

    posterior: Posterior
    speed_law: SpeedLaw
    trends: tuple[BetaTrend, ...]
    outlying_tests: tuple[OutlyingTest, ...]
    curves: tuple[CurveTest, ...]
    deeper_mm: Mapping[str, Mapping[str, Estimate]]
    pulls: Mapping[str, Mapping[str, float]]
    single_beta: Mapping[str, Estimate]
    speed_law_beta: Mapping[str, float | None]
    status: Mapping[str, str]
    delta_T_us: Mapping[str, Estimate]
    excluded: Mapping[str, str] = field(default_factory=dict)

    @property
    def trend(self) -> BetaTrend | None:
        """The trend over delta T u_s, which the thesis has; else the first that there is."""
        return self.trends[0] if self.trends else None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What the campaign shows that no single test does.

        Returns
        -------
        Findings on outlying tests, exponent, power law, junction depths, curves and excluded tests.

        Notes
        -----
        The thresholds of this module decide only what is reported.
        ``tcdyn.campaign.trends.SHAPE_REJECTED_P`` also decides how the offset from a curve is
        computed. A new code needs a message in ``tcdyn/core/messages/campaign.py``.
        """
        findings = [
            warning(
                "campaign.stranger",
                subject=s.name,
                cause=s.cause,
                size=s.size.value,
                u=s.size.u,
                z=s.z,
                chi2=s.chi2,
                left=s.left,
                freedom=s.freedom,
                explained=s.is_explained,
            )
            for s in self.outlying_tests
        ]
        n = self.speed_law.exponent
        assumed = self.posterior.tests[0].conditions["speed_exponent"]
        tests = len(self.posterior.tests)
        if tests > 1 and abs(n.value - assumed) > EXPONENT_DEVIATION_Z * n.u:
            findings.append(
                info("campaign.exponent", n=n.value, u=n.u, assumed=assumed, tests=tests)
            )
        if (
            self.speed_law.by_speed is not None
            and self.speed_law.p_value is not None
            and self.speed_law.p_value < POWER_LAW_REJECTED_P
        ):
            by = self.speed_law.by_speed
            findings.append(
                warning(
                    "campaign.power_law", per_doubled=by.value, u=by.u, p=self.speed_law.p_value
                )
            )
        freedom = determined_dof(self.posterior.shared_covariance)
        chi2 = float(self.posterior.shared_mean @ self.posterior.shared_mean)
        p_value = float(chdtrc(freedom, chi2))
        if p_value < CONTRADICTED_P:
            largest = np.argsort(-np.abs(self.posterior.shared_mean))[:N_NAMED]
            contradicted = warning(
                "campaign.contradicted",
                chi2=chi2,
                freedom=freedom,
                p=p_value,
                factor=float(np.sqrt(self.posterior.inflation)),
                names=[self.posterior.shared[k] for k in largest],
                sizes=[float(self.posterior.shared_mean[k]) for k in largest],
            )
            findings.append(contradicted)
        for d, pulls in self.pulls.items():
            for c, z in pulls.items():
                if abs(z) > DEPTH_PULL_Z:
                    e = self.deeper_mm[d][c]
                    findings.append(
                        warning(
                            "campaign.junction",
                            subject=f"{d}_{c}",
                            deeper_mm=e.value,
                            u_mm=e.u,
                            z=z,
                        )
                    )
        for test in self.curves:
            if test.shape_rejected:
                shape = warning(
                    "campaign.curve_shape",
                    subject=test.curve.file,
                    chi2=test.shape_chi2,
                    freedom=len(test.inside) - 1,
                    p=test.shape_p_value,
                    scatter=test.scatter,
                    offset=test.offset.value,
                    u=test.offset.u,
                )
                findings.append(shape)
        findings += [
            info("campaign.apart", subject=name, why=why) for name, why in self.excluded.items()
        ]
        return tuple(findings)

    def to_dict(self) -> dict[str, Any]:
        """The content of ``campaign.json``."""
        posterior = self.posterior
        trends = [t.to_dict() for t in self.trends]
        data = {
            "schema": CAMPAIGN.schema,
            "rig_sha256": posterior.tests[0].rig,
            "tests": {
                name: {
                    **estimate,
                    "beta_alone": self.single_beta[name],
                    "beta_by_speed_law": self.speed_law_beta[name],
                    "delta_T_us": self.delta_T_us[name],
                    "status": self.status[name],
                }
                for name, estimate in zip(posterior.test_names, posterior.estimates)
            },
            "exponent": self.speed_law.exponent,
            "speed_law": self.speed_law.to_dict(),
            "order": posterior.test_names,
            "covariance": posterior.beta[1],
            "trend": trends[0] if trends else None,
            "trends": trends,
            "models": [c.to_dict() for c in self.curves],
            "do_not_belong": [s.to_dict() for s in self.outlying_tests],
            "junctions": {
                d: {c: {"deeper_mm": e, "z": self.pulls[d][c]} for c, e in depths.items()}
                for d, depths in self.deeper_mm.items()
            },
            "apart": self.excluded,
            "findings": self.findings,
        }
        return jsonable(data)


def read_statistics(name: str, data: Mapping[str, Any]) -> SufficientStatistics:
    """Sufficient statistics from the content of a ``beta.json``.

    Parameters
    ----------
    name
        Name of the test.
    data
        Content of the file.

    Raises
    ------
    InputError
        It has none, or of another schema.
    """
    if not data.get("kept"):
        raise InputError(
            "keeps nothing for a campaign: its joint fit of both disks was withheld", where=name
        )
    return SufficientStatistics.from_dict(name, data["kept"])


def _is_beta_reported(data: Mapping[str, Any]) -> bool:
    """Whether beta of both disks is possible and determined, also in a file of an older version.

    Parameters
    ----------
    data
        Content of ``beta.json``.
    """
    stored = data["joint"]["both"]["beta"]
    if stored["value"] is None:
        return False
    beta = Estimate(**stored)
    return not (is_impossible(beta) or is_undetermined(beta))


@with_named_arguments
def join_results(
    answers: Mapping[str, Mapping[str, Any]], curves: Sequence[Curve] = ()
) -> JoinedCampaign | None:
    """Solve all tests of a campaign together; None where no test can be used.

    A test whose result is withheld is left out, also where an older version did not withhold it,
    and so is an outlying test.

    Parameters
    ----------
    answers
        Content of ``beta.json`` of each test, by name.
    curves
        Curves of a model that are compared with the tests.

    Raises
    ------
    InputError
        Tests of different rigs, by name; a block "kept" of another schema; or a curve that the
        tests do not reach.

    Notes
    -----
    The order matters: outliers are searched first, and exponent, trends, depths and curves are
    those of the remaining tests.
    """
    excluded = {
        name: "its answer is withheld"
        for name, data in answers.items()
        if data.get("status") == "withheld" or not _is_beta_reported(data)
    }
    included = {name: data for name, data in answers.items() if name not in excluded}
    if not included:
        return None
    if missing := [name for name, data in included.items() if "kept" not in data]:
        raise InputError("keeps nothing for a campaign", where=missing[0], remedy=ANALYSE_AGAIN)
    posterior = solve_campaign([read_statistics(name, data) for name, data in included.items()])
    outliers = outlying_tests(posterior)
    if outliers:
        names = {s.name for s in outliers}
        remaining = [
            (t, r) for t, r in zip(posterior.tests, posterior.reduced_tests) if t.name not in names
        ]
        posterior = solve_campaign([t for t, _ in remaining], [r for _, r in remaining])
        included = {name: data for name, data in included.items() if name not in names}
    law = speed_law(posterior)
    deeper, pulls = junction_depths(posterior)
    return JoinedCampaign(
        posterior=posterior,
        speed_law=law,
        trends=trends(posterior),
        outlying_tests=outliers,
        curves=tuple(curve_test(posterior, c) for c in curves),
        deeper_mm=deeper,
        pulls=pulls,
        single_beta={
            name: Estimate(**data["joint"]["both"]["beta"]) for name, data in included.items()
        },
        speed_law_beta={
            t.name: _speed_law_beta(included[t.name], t, law.exponent.value)
            for t in posterior.tests
        },
        status={name: data["status"] for name, data in included.items()},
        delta_T_us={
            name: Estimate(**data["surface"]["delta_T_us"]) for name, data in included.items()
        },
        excluded=excluded,
    )


def _speed_law_beta(
    data: Mapping[str, Any], test: SufficientStatistics, exponent: float
) -> float | None:
    """beta of a test by its steady lines and an exponent; None where a line is missing.

    Parameters
    ----------
    data
        Content of ``beta.json``.
    test
        Its sufficient statistics, which have the speed ratio.
    exponent
        Exponent n of the speed law.
    """
    lines = [
        data["steady"][f"{d}_line"][key]["value"] for d in DISKS for key in ("intercept", "slope")
    ]
    chi = speed_ratio_power(test.conditions["speed_ratio"], exponent)
    if None in lines:
        return None
    a, b, c, d = lines
    return float(speed_law_beta(a, b, c, d, chi))


def junction_depths(
    posterior: Posterior,
) -> tuple[dict[str, dict[str, Estimate]], dict[str, dict[str, float]]]:
    """Difference of each junction's depth from the stated one, and its pull on the statement.

    Parameters
    ----------
    posterior
        Posterior of the campaign.

    Returns
    -------
    deeper
        Estimated minus stated depth [mm], by disk and channel.
    pulls
        The same in the standard deviations that the data alone would cause.

    Notes
    -----
    Birge's ratio widens the uncertainties and divides the pulls.
    ``tests/campaign/test_posterior.py`` checks that pulls are standard normal.
    """
    deeper: dict[str, dict[str, Estimate]] = {d: {} for d in DISKS}
    pulls: dict[str, dict[str, float]] = {d: {} for d in DISKS}
    units = {n: size for t in posterior.tests for n, size in t.units.items()}
    u_factor = float(np.sqrt(posterior.inflation))
    shared_estimates = zip(
        posterior.shared, posterior.shared_mean, np.diag(posterior.shared_covariance)
    )
    for name, x, variance in sorted(shared_estimates, key=lambda one: one[0]):
        match name.split(" "):
            case "depth", c, d if name in units:
                mm = 1e3 * units[name]
                deeper[d][c] = Estimate.normal(x * mm, np.sqrt(variance) * mm * u_factor)
                pulls[d][c] = float(
                    x / np.sqrt(max(1 - variance, MIN_VARIANCE_REDUCTION)) / u_factor
                )
    return deeper, pulls
