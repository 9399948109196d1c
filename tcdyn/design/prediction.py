"""Predicted covariance of the lags from a planned test: inverse of Fisher information plus prior.

The information comes from the Jacobian of the readings by all parameters (``jacobian``). Nothing
is simulated or fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from immersion.plunge_parameters import lag_u_s
from tcdyn.core import Array
from tcdyn.estimation import inverse


@dataclass(frozen=True)
class PredictedTest:
    """Expected standard uncertainties of one planned test; ``covariance`` (C, C) is of the
    channels' lags [s2].

    ``low_s`` and ``high_s`` are the 10 and 90 % points of u of the common lag over what cannot be
    planned (the burst of the entry, the scale of h), equal to ``u_common_s`` where nothing varies.
    """

    name: str
    kind: str
    u_common_s: float
    u_differential_s: float
    covariance: Array
    low_s: float
    high_s: float
    other_u: dict[str, float] = field(default_factory=dict)

    def row(self) -> dict[str, float | str]:
        """As a row of the table."""
        return {
            "test": self.name,
            "kind": self.kind,
            "u_common_s": self.u_common_s,
            "u_common_10_s": self.low_s,
            "u_common_90_s": self.high_s,
            "u_differential_s": self.u_differential_s,
            **self.other_u,
        }


def from_covariances(
    name: str, kind: str, covariances: Sequence[Array], others: dict[str, float] | None = None
) -> PredictedTest:
    """A prediction from lag covariances under several draws of what cannot be planned: their mean
    is what counts.
    """
    mean = np.mean(np.array(covariances), axis=0)
    low, high = np.quantile([lag_u_s(c)[0] for c in covariances], [0.1, 0.9])
    return PredictedTest(name, kind, *lag_u_s(mean), mean, float(low), float(high), others or {})


def combine_tests(name: str, parts: Sequence[PredictedTest]) -> PredictedTest:
    """Several tests of the same channels taken together: their lag information (inverse
    covariances) adds up.
    """
    total = np.sum([np.linalg.inv(p.covariance) for p in parts], axis=0)
    return from_covariances(name, "together", [np.linalg.inv(total)])


def jacobian(readings: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Jacobian (N, P) of ``readings(parameters (P,)) -> (N,)`` by central differences of ``steps``
    (P,).
    """
    return np.column_stack(
        [(readings(at + e) - readings(at - e)) / (2 * e.sum()) for e in np.diag(steps)]
    )


def posterior_covariance(rows: Array, prior_sd: Array) -> Array:
    """Posterior covariance (P, P): ``rows`` (N, P) are slopes over noise, prior standard deviations
    may be inf.
    """
    return inverse(rows.T @ rows + np.diag(1 / np.asarray(prior_sd) ** 2))
