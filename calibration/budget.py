"""What a calibrated channel's reading at rest is uncertain by, source by source, and its expanded uncertainty.

Source: Guide to the Expression of Uncertainty in Measurement (JCGM 100:2008), 5.1.2, G.4 and annex H.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date

from scipy.special import stdtrit

from tcdyn.core.estimate import Z95
from tcdyn.rig.static_line import StaticLine, static_u
from tcdyn.rig.traceability import TraceabilityTable


@dataclass(frozen=True)
class Contribution:
    """One line of a budget: standard uncertainty ``u`` of an estimate, its distribution, sensitivity, and freedom.

    ``freedom``: degrees of freedom, infinite where u was stated and not found from scatter.
    """

    name: str
    estimate: float
    u: float
    distribution: str
    sensitivity: float
    freedom: float

    @property
    def contribution(self) -> float:
        """|sensitivity| u."""
        return abs(self.sensitivity) * self.u


@dataclass(frozen=True)
class RestBudget:
    """Sources of a result and what they add up to."""

    sources: tuple[Contribution, ...]

    @property
    def u(self) -> float:
        """Combined standard uncertainty: contributions in squares."""
        return math.hypot(*(s.contribution for s in self.sources))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom u^4 / sum(u_i^4 / v_i) (Welch and Satterthwaite; GUM G.2b)."""
        total = sum(s.contribution**4 / s.freedom for s in self.sources)
        return self.u**4 / total if total > 0 else math.inf

    @property
    def coverage(self) -> float:
        """Coverage factor k for 95 %: Student's at the effective degrees of freedom, rounded down."""
        return (
            float(stdtrit(math.floor(max(self.freedom, 1.0)), 0.975)) if self.freedom < 1e6 else Z95
        )

    @property
    def expanded(self) -> float:
        """U = k u, for 95 %."""
        return self.coverage * self.u


def rest_budget(
    line: StaticLine, stated: TraceabilityTable, on: date, temperature_degC: float
) -> RestBudget:
    """The reading of a channel at rest at ``temperature_degC``, calibrated ``on`` that day.

    A line's covariance was widened by t/1.96 for its few holds; here its own standard uncertainty stands beside its
    degrees of freedom. What the line's ``shared_u_K`` holds is divided into certificate and drift as ``stated``.

    >>> line = StaticLine(gain=1.0, offset=0.1, covariance=((0, 0), (0, 0.0016)), range_degC=(20, 160), n=6,
    ...                   shared_u_K=0.06)
    >>> found = rest_budget(line, TraceabilityTable(), date(2026, 1, 1), 90.0)
    >>> round(found.u, 3), round(found.freedom), round(found.coverage, 2), round(found.expanded, 3)
    (0.066, 122, 1.98, 0.131)
    """
    freedom = line.n - 2
    narrow = Z95 / float(stdtrit(freedom, 0.975)) if freedom > 0 else 1.0
    drift = min(stated.drift_u_K(on), line.shared_u_K)
    certificate = math.sqrt(line.shared_u_K**2 - drift**2)
    own = narrow * float(static_u(line, temperature_degC))
    sources = [
        Contribution("line through the holds", temperature_degC, own, "Student", 1.0, freedom)
        if freedom > 0
        else Contribution(
            "readings as logged, as stated", temperature_degC, own, "normal", 1.0, math.inf
        ),
        Contribution("reference's certificate", 0.0, certificate, "normal", 1.0, math.inf),
        Contribution("reference's drift since", 0.0, drift, "uniform", 1.0, math.inf),
    ]
    return RestBudget(tuple(s for s in sources if s.u > 0) or tuple(sources[:1]))
