"""Uncertainty budget (GUM) of a calibrated channel at rest, and its expanded uncertainty.

Source: Guide to the Expression of Uncertainty in Measurement (JCGM 100:2008), 5.1.2, G.4 and annex
H.

Used by the formal part of the certificate (:mod:`tcdyn.report.formal`). Tests:
``tests/calibration/test_budget.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date

from scipy.special import stdtrit

from tcdyn.core.estimate import Z95, Estimate
from tcdyn.rig.static_line import StaticLine, static_u
from tcdyn.rig.tables import TraceabilityTable

# From these degrees of freedom on the coverage factor is that of the normal distribution.
MANY_DEGREES_OF_FREEDOM = 1e6


@dataclass(frozen=True)
class Contribution:
    """One component of an uncertainty budget.

    Parameters
    ----------
    name
        The source of uncertainty.
    estimate
        Estimate of the input quantity.
    u
        Its standard uncertainty.
    distribution
        Its probability distribution.
    sensitivity
        Sensitivity coefficient of the result.
    dof
        Degrees of freedom; infinite where u is not from scatter (type B).
    """

    name: str
    estimate: float
    u: float
    distribution: str
    sensitivity: float
    dof: float

    @property
    def contribution(self) -> float:
        """|sensitivity| u."""
        return abs(self.sensitivity) * self.u


@dataclass(frozen=True)
class UncertaintyBudget:
    """Uncertainty budget of a reading at rest.

    Attributes
    ----------
    sources
        The components.
    """

    sources: tuple[Contribution, ...]

    @property
    def u(self) -> float:
        """Combined standard uncertainty: root sum of squares of the contributions."""
        return math.hypot(*(s.contribution for s in self.sources))

    @property
    def dof(self) -> float:
        """Effective degrees of freedom u^4 / sum(u_i^4 / v_i) (Welch-Satterthwaite, GUM G.2b)."""
        total = sum(s.contribution**4 / s.dof for s in self.sources)
        return self.u**4 / total if total > 0 else math.inf

    @property
    def coverage(self) -> float:
        """Coverage factor k for 95 %: Student's t at ``dof``, rounded down.

        Notes
        -----
        The sources are taken as independent. Rounding down follows GUM G.4.1.
        """
        if self.dof >= MANY_DEGREES_OF_FREEDOM:
            return Z95
        return float(stdtrit(math.floor(max(self.dof, 1.0)), 0.975))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k u for 95 %."""
        return self.coverage * self.u


def expanded_of_skewed(estimate: Estimate) -> tuple[float, float]:
    """Expanded uncertainty U = k u of an estimate whose distribution may be skewed.

    Parameters
    ----------
    estimate
        Value, standard uncertainty and 95 % interval.

    Returns
    -------
    expanded
        U: the distance from the value to the farther end of the interval, so that value -+ U
        contains the interval, and covers with a probability of at least 95 %.
    coverage
        Coverage factor k = U / u.

    Notes
    -----
    Of a normal distribution k is 1.96 (GUM, 6.3.3). JCGM 101:2008, 5.3.3, allows intervals that
    are not symmetric; U is for users who need one number.

    Examples
    --------
    >>> expanded, k = expanded_of_skewed(Estimate(value=0.7, u=0.1, low95=0.55, high95=0.93))
    >>> round(expanded, 3), round(k, 2)
    (0.23, 2.3)
    """
    above = estimate.high95 - estimate.value
    below = estimate.value - estimate.low95
    expanded = max(above, below)
    if estimate.u == 0.0:
        return expanded, Z95
    return expanded, expanded / estimate.u


def uncertainty_budget(
    line: StaticLine, traceability: TraceabilityTable, on: date, temperature_degC: float
) -> UncertaintyBudget:
    """Budget of the reading of a channel at rest.

    The covariance of a line is widened by t/1.96 for its few holds. The budget uses the line's
    unwidened standard uncertainty with its degrees of freedom. ``shared_u_K`` of the line is
    divided into the certificate and the drift of the reference.

    Parameters
    ----------
    line
        Static line of the channel.
    traceability
        [traceability] of the rig file.
    on
        Date of the calibration.
    temperature_degC
        Temperature of the reading.

    Returns
    -------
    budget
        Without components of zero uncertainty.

    Notes
    -----
    The certificate component and the drift must add up (root sum of squares) to ``shared_u_K``
    of the line, as :func:`calibration.static_lines.fit_static_lines` stores it. Test:
    ``tests/calibration/test_budget.py``.

    Examples
    --------
    >>> covariance = ((0, 0), (0, 0.0016))
    >>> line = StaticLine(gain=1.0, offset=0.1, covariance=covariance, range_degC=(20, 160), n=6,
    ...                   shared_u_K=0.06)
    >>> budget = uncertainty_budget(line, TraceabilityTable(), date(2026, 1, 1), 90.0)
    >>> round(budget.u, 3), round(budget.dof)
    (0.066, 122)
    >>> round(budget.coverage, 2), round(budget.expanded, 3)
    (1.98, 0.131)
    """
    drift = min(traceability.drift_u_K(on), line.shared_u_K)
    certificate = math.sqrt(line.shared_u_K**2 - drift**2)
    u = float(static_u(line, temperature_degC))
    dof = line.n - 2
    if dof > 0:
        u *= Z95 / float(stdtrit(dof, 0.975))
        channel = Contribution("line through the holds", temperature_degC, u, "Student", 1.0, dof)
    else:
        name = "readings as logged, as stated"
        channel = Contribution(name, temperature_degC, u, "normal", 1.0, math.inf)
    sources = (
        channel,
        Contribution("reference's certificate", 0.0, certificate, "normal", 1.0, math.inf),
        Contribution("reference's drift since", 0.0, drift, "uniform", 1.0, math.inf),
    )
    return UncertaintyBudget(tuple(s for s in sources if s.u > 0) or (channel,))
