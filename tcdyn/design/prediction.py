"""Predicted covariance of the lags from a planned test: inverse of Fisher information plus prior.

The information comes from the Jacobian of the readings by all parameters (``jacobian``). Nothing is
simulated or fitted.

Used by ``tcdyn.design.plans`` and ``tcdyn.design.compare``. Guarded by
``tests/immersion/test_design_predictions.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from immersion.plunge_parameters import common_and_differential_u_s
from tcdyn.core import Array
from tcdyn.estimation import inverse


@dataclass(frozen=True)
class PredictedTest:
    """Expected standard uncertainties of one planned test.

    Parameters
    ----------
    name
        Description of the test.
    kind
        "plunge", "unloading", "loading", "touch" or "together".
    u_common_s
        Standard uncertainty of the lag that the channels share.
    u_differential_s
        Standard uncertainty of the differences between channels.
    covariance
        Covariance of the channels' lags, (C, C) [s2].
    low_s, high_s
        10 and 90 % points of ``u_common_s`` over what cannot be planned (the burst of the entry,
        the scale of h); equal to it where nothing varies.
    other_u
        Standard uncertainties of other parameters, by name.
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
        """The prediction as a row of a table."""
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
    name: str, kind: str, covariances: Sequence[Array], other_u: dict[str, float] | None = None
) -> PredictedTest:
    """A prediction from lag covariances under several samples of what cannot be planned.

    Parameters
    ----------
    name, kind
        As in ``PredictedTest``.
    covariances
        Covariance of the lags for each sample, (C, C) each [s2]. Their mean gives the
        uncertainties.
    other_u
        Standard uncertainties of other parameters, by name.

    Notes
    -----
    Common and differential parts are those of
    ``immersion.plunge_parameters.common_and_differential_u_s``.
    """
    mean = np.mean(np.array(covariances), axis=0)
    low, high = np.quantile([common_and_differential_u_s(c)[0] for c in covariances], [0.1, 0.9])
    return PredictedTest(
        name, kind, *common_and_differential_u_s(mean), mean, float(low), float(high), other_u or {}
    )


def combine_tests(name: str, tests: Sequence[PredictedTest]) -> PredictedTest:
    """Several tests of the same channels taken together.

    Parameters
    ----------
    name
        Description of the combination.
    tests
        Predictions of the tests.

    Notes
    -----
    The inverse covariances of the lags add up. The tests are taken as independent; a shared error,
    such as that of a depth, is counted as if it were another one in each test.
    """
    total = np.sum([np.linalg.inv(p.covariance) for p in tests], axis=0)
    return from_covariances(name, "together", [np.linalg.inv(total)])


def jacobian(readings: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Jacobian by central differences.

    Parameters
    ----------
    readings
        Function of the parameters (P,) that gives the readings (N,).
    at
        Parameters, (P,).
    steps
        Step of each parameter, (P,).

    Returns
    -------
    Jacobian, (N, P).
    """
    return np.column_stack(
        [(readings(at + e) - readings(at - e)) / (2 * e.sum()) for e in np.diag(steps)]
    )


def posterior_covariance(rows: Array, prior_sd: Array) -> Array:
    """Covariance of the parameters from Fisher information and priors.

    Parameters
    ----------
    rows
        Jacobian over the noise, (N, P).
    prior_sd
        Prior standard deviations, (P,); infinite where there is no prior.

    Returns
    -------
    Covariance, (P, P).
    """
    return inverse(rows.T @ rows + np.diag(1 / np.asarray(prior_sd) ** 2))
