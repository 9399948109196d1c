"""A number with its uncertainty, as it stands in every JSON file of the project."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict

Z95 = 1.959963984540054  # two-sided 95 % point of the normal distribution


class Estimate(BaseModel):
    """A value, its standard uncertainty ``u`` and its 95 % interval, all in the unit of the key that holds it.

    >>> print(Estimate.normal(0.66, 0.01))
    0.66 +- 0.01
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    value: float
    u: float
    low95: float
    high95: float

    @classmethod
    def normal(cls, value: float, u: float) -> Estimate:
        """The estimate of a normally distributed quantity: value -+ 1.96 u."""
        value, u = float(value), float(u)
        return cls(value=value, u=u, low95=value - Z95 * u, high95=value + Z95 * u)

    @classmethod
    def from_samples(cls, samples: ArrayLike, value: float | None = None) -> Estimate:
        """The estimate from Monte Carlo draws (GUM Supplement 1): their spread and 2.5 and 97.5 % quantiles."""
        draws = np.asarray(samples, dtype=float)
        low, high = np.quantile(draws, [0.025, 0.975])
        centre = float(np.mean(draws)) if value is None else float(value)
        return cls(value=centre, u=float(np.std(draws, ddof=1)), low95=float(low), high95=float(high))

    def covers(self, truth: float) -> bool:
        """Whether the 95 % interval holds ``truth``."""
        return self.low95 <= truth <= self.high95

    def __str__(self) -> str:
        return f"{self.value:.4g} +- {self.u:.2g}"
