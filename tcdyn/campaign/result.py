"""The answer of a whole campaign: every test by one posterior, n, trends, junctions, and who does not belong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tcdyn.campaign.exponent import SpeedLaw, speed_law
from tcdyn.campaign.outliers import Stranger, strangers
from tcdyn.campaign.posterior import Posterior, solve
from tcdyn.campaign.sufficient_statistics import AGAIN, KeptTest
from tcdyn.campaign.trends import BetaTrend, Curve, CurveTest, curve_test, trends
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import GRADES_OF_0_2, Finding, info, warning
from tcdyn.core.result import jsonable
from tcdyn.partition.steady import speed_law_beta, speed_ratio_power
from tcdyn.rig.disk import DISKS

SCHEMA = "tcdyn.campaign/1"
FAR_Z = 2.0  # n of the campaign this far from rig.toml's is told
BENT_P = 0.01  # chance below which a power law is not enough
MOVED_Z = 4.0  # a junction's pull that is told: the largest in 17 sound drawn campaigns was 3.7
LEAST_TOLD = 0.02  # of a depth's variance: below it a pull means nothing


@dataclass(frozen=True)
class JoinedCampaign:
    """All tests of a rig together.

    ``posterior``: answers and covariance; ``law``: the exponent n; ``trends`` of beta; ``strangers``: tests that do not
    belong, and are not in the posterior; ``curves``: models laid over the tests; ``deeper_mm``: by disk and
    channel, how much deeper than stated the campaign places a junction; ``pulls``: that in what the data alone would
    move it by; ``single``: beta of each test alone; ``by_law``: beta by each test's steady lines and the campaign's n;
    ``status`` and ``delta_T_us`` [K m/s] of each test; ``apart``: tests that could not be joined, and why.
    """

    posterior: Posterior
    law: SpeedLaw
    trends: tuple[BetaTrend, ...]
    strangers: tuple[Stranger, ...]
    curves: tuple[CurveTest, ...]
    deeper_mm: Mapping[str, Mapping[str, Estimate]]
    pulls: Mapping[str, Mapping[str, float]]
    single: Mapping[str, Estimate]
    by_law: Mapping[str, float | None]
    status: Mapping[str, str]
    delta_T_us: Mapping[str, Estimate]
    apart: Mapping[str, str] = field(default_factory=dict)

    @property
    def trend(self) -> BetaTrend | None:
        """The trend that the thesis draws: over delta T u_s; else the first that the tests tell."""
        return self.trends[0] if self.trends else None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What the campaign shows that no test alone does."""
        found = [
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
                explained=s.explained,
            )
            for s in self.strangers
        ]
        n = self.law.exponent
        assumed = self.posterior.tests[0].conditions["speed_exponent"]
        tests = len(self.posterior.tests)
        if tests > 1 and abs(n.value - assumed) > FAR_Z * n.u:
            found.append(info("campaign.exponent", n=n.value, u=n.u, assumed=assumed, tests=tests))
        if (
            self.law.by_speed is not None
            and self.law.p_value is not None
            and self.law.p_value < BENT_P
        ):
            by = self.law.by_speed
            found.append(
                warning("campaign.power_law", per_doubled=by.value, u=by.u, p=self.law.p_value)
            )
        for d, pulls in self.pulls.items():
            for c, z in pulls.items():
                if abs(z) > MOVED_Z:
                    e = self.deeper_mm[d][c]
                    found.append(
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
                found.append(shape)
        found += [info("campaign.apart", subject=name, why=why) for name, why in self.apart.items()]
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """The content of ``campaign.json`` (design, section 8)."""
        posterior = self.posterior
        trends = [t.to_dict() for t in self.trends]
        kept = {
            "schema": SCHEMA,
            "rig_sha256": posterior.tests[0].rig,
            "tests": {
                name: {
                    **one,
                    "beta_alone": self.single[name],
                    "beta_by_speed_law": self.by_law[name],
                    "delta_T_us": self.delta_T_us[name],
                    "status": self.status[name],
                }
                for name, one in zip(posterior.order, posterior.estimates)
            },
            "exponent": self.law.exponent,
            "speed_law": self.law.to_dict(),
            "order": posterior.order,
            "covariance": posterior.beta[1],
            "trend": trends[0] if trends else None,
            "trends": trends,
            "models": [c.to_dict() for c in self.curves],
            "do_not_belong": [s.to_dict() for s in self.strangers],
            "junctions": {
                d: {c: {"deeper_mm": e, "z": self.pulls[d][c]} for c, e in own.items()}
                for d, own in self.deeper_mm.items()
            },
            "apart": self.apart,
            "findings": self.findings,
        }
        return jsonable(kept)


def kept_test(name: str, data: Mapping[str, Any]) -> KeptTest:
    """What the content of a beta.json keeps for its campaign. Raises InputError where that is nothing."""
    if not data.get("kept"):
        raise InputError(
            "keeps nothing for a campaign: its joint fit of both disks was withheld", where=name
        )
    return KeptTest.from_dict(name, data["kept"])


def joined(
    answers: Mapping[str, Mapping[str, Any]], curves: Sequence[Curve] = ()
) -> JoinedCampaign | None:
    """One posterior of the contents of beta.json by test; None where none can be joined.

    A test whose answer is withheld stands apart, and so does one that does not belong. Raises InputError for tests of
    different rigs, by name, for a kept block of another schema, and for a curve that the tests do not reach.
    """
    apart = {
        name: "its answer is withheld"
        for name, data in answers.items()
        if data.get("status") == "withheld"
    }
    used = {name: data for name, data in answers.items() if name not in apart}
    if not used:
        return None
    if missing := [name for name, data in used.items() if "kept" not in data]:
        raise InputError("keeps nothing for a campaign", where=missing[0], remedy=AGAIN)
    posterior = solve([kept_test(name, data) for name, data in used.items()])
    odd = strangers(posterior)
    if odd:
        names = {s.name for s in odd}
        own = [(t, r) for t, r in zip(posterior.tests, posterior.reduced) if t.name not in names]
        posterior = solve([t for t, _ in own], [r for _, r in own])
        used = {name: data for name, data in used.items() if name not in names}
    law = speed_law(posterior)
    deeper, pulls = junctions(posterior)
    return JoinedCampaign(
        posterior=posterior,
        law=law,
        trends=trends(posterior),
        strangers=odd,
        curves=tuple(curve_test(posterior, c) for c in curves),
        deeper_mm=deeper,
        pulls=pulls,
        single={name: Estimate(**data["joint"]["both"]["beta"]) for name, data in used.items()},
        by_law={t.name: _by_law(used[t.name], t, law.exponent.value) for t in posterior.tests},
        status={
            name: GRADES_OF_0_2.get(data["status"], data["status"]) for name, data in used.items()
        },
        delta_T_us={name: Estimate(**data["surface"]["delta_T_us"]) for name, data in used.items()},
        apart=apart,
    )


def _by_law(data: Mapping[str, Any], test: KeptTest, exponent: float) -> float | None:
    lines = [
        data["steady"][f"{d}_line"][key]["value"] for d in DISKS for key in ("intercept", "slope")
    ]
    chi = speed_ratio_power(test.conditions["speed_ratio"], exponent)
    if None in lines:
        return None
    a, b, c, d = lines
    return float(speed_law_beta(a, b, c, d, chi))


def junctions(
    posterior: Posterior,
) -> tuple[dict[str, dict[str, Estimate]], dict[str, dict[str, float]]]:
    """How much deeper than stated each junction lies [mm], by disk and channel, and its pull on the statement."""
    deeper: dict[str, dict[str, Estimate]] = {d: {} for d in DISKS}
    pulls: dict[str, dict[str, float]] = {d: {} for d in DISKS}
    units = {n: size for t in posterior.tests for n, size in t.units.items()}
    wider = float(np.sqrt(posterior.widened))
    told = zip(posterior.shared, posterior.found, np.diag(posterior.shared_covariance))
    for name, x, variance in sorted(told, key=lambda one: one[0]):
        match name.split(" "):
            case "depth", c, d if name in units:
                mm = 1e3 * units[name]
                deeper[d][c] = Estimate.normal(x * mm, np.sqrt(variance) * mm * wider)
                pulls[d][c] = float(x / np.sqrt(max(1 - variance, LEAST_TOLD)) / wider)
    return deeper, pulls
