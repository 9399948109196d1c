"""A predicted test: the lag covariance it would give, in common and differential parts, and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Expected standard uncertainties of one planned test; ``covariance`` (C, C) is of the channels' lags [s2].

    ``low_s`` and ``high_s`` are the 10 and 90 % points of u of the common lag over what cannot be planned (the
    burst of the entry, the scale of h), equal to ``u_common_s`` where nothing varies.
    """

    name: str
    kind: str
    u_common_s: float
    u_differential_s: float
    covariance: Array
    low_s: float
    high_s: float
    others: dict[str, float] = field(default_factory=dict)

    def row(self) -> dict[str, float | str]:
        """As a row of the table."""
        return {
            "test": self.name,
            "kind": self.kind,
            "u_common_s": self.u_common_s,
            "u_common_10_s": self.low_s,
            "u_common_90_s": self.high_s,
            "u_differential_s": self.u_differential_s,
            **self.others,
        }


def from_covariances(
    name: str, kind: str, covariances: Sequence[Array], others: dict[str, float] | None = None
) -> Prediction:
    """A prediction from lag covariances under several draws of what cannot be planned: their mean is what counts."""
    common = np.sqrt([max(float(c.mean()), 0.0) for c in covariances])
    mean = np.mean(np.array(covariances), axis=0)
    n = len(mean)
    project = np.eye(n) - 1 / n
    differential = float(np.sqrt(np.trace(project @ mean @ project) / n))
    low, high = np.quantile(common, [0.1, 0.9])
    return Prediction(
        name, kind, float(np.sqrt(max(mean.mean(), 0.0))), differential, mean, float(low), float(high), others or {}
    )


def combined(name: str, parts: Sequence[Prediction]) -> Prediction:
    """Several tests of the same channels taken together: their lag information (inverse covariances) adds up."""
    total = np.sum([np.linalg.inv(p.covariance) for p in parts], axis=0)
    return from_covariances(name, "together", [np.linalg.inv(total)])


def table(predictions: Sequence[Prediction]) -> pd.DataFrame:
    """One row a planned test."""
    return pd.DataFrame([p.row() for p in predictions])


def information(
    jacobians: Sequence[Array], noise_K: float, own: int, shared: int, own_prior_sd: Array, shared_prior_sd: Array
) -> Array:
    """Posterior covariance of all parameters when each record has ``own`` parameters and all share the last ``shared``.

    ``jacobians`` are (N, own + shared) per record; prior standard deviations may be inf. The order of the answer is
    record by record, then the shared ones.
    """
    records = len(jacobians)
    size = records * own + shared
    info = np.zeros((size, size))
    for r, j in enumerate(jacobians):
        at = np.concatenate([np.arange(r * own, (r + 1) * own), np.arange(records * own, size)])
        info[np.ix_(at, at)] += j.T @ j / noise_K**2
    sd = np.concatenate([np.tile(own_prior_sd, records), shared_prior_sd])
    info[np.diag_indices(size)] += np.where(np.isfinite(sd), 1 / sd**2, 0.0)
    scale = 1 / np.sqrt(np.diag(info))
    return np.asarray(np.linalg.inv(info * scale[:, None] * scale) * scale[:, None] * scale)
