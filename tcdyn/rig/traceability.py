"""Traceability: reference thermometer, instruments and item of a calibration ([traceability])."""

from __future__ import annotations

from datetime import date
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, model_validator

from tcdyn.rig.strict import STRICT

YEAR_DAYS = 365.25
# Standard uncertainty of the PRT: an error of at most 0.1 degC, uniformly distributed (section
# 2.6).
PRT_U_DEGC = 0.1 / np.sqrt(3.0)


def _day(text: str) -> str:
    """Check that a text is a date, or empty."""
    if text:
        date.fromisoformat(text)
    return text


Text = Annotated[str, Field(max_length=200)]
Day = Annotated[str, Field(max_length=10), AfterValidator(_day)]


class TraceabilityTable(BaseModel):
    """[traceability]: laboratory, reference and instruments of a calibration; dates as YYYY-MM-DD.

    Parameters
    ----------
    reference_u_K
        Standard uncertainty of the oven's PRT by its certificate, common to all readings.
    reference_drift_K_per_year
        Half-range of its drift since ``reference_date``.
    valid_days
        Longest time until the next calibration.
    limit_K
        Drift of a channel that requires an earlier calibration.
    """

    model_config = STRICT

    laboratory: Text = ""
    address: Text = ""
    customer: Text = ""
    place: Text = ""
    procedure: Text = ""
    certificate: Text = ""
    authorised_by: Text = ""
    received: Day = ""
    reference: Text = ""
    reference_certificate: Text = ""
    reference_date: Day = ""
    reference_u_K: float = Field(default=float(PRT_U_DEGC), ge=0, lt=5)
    reference_drift_K_per_year: float = Field(default=0.0, ge=0, lt=5)
    logger: Text = ""
    logger_certificate: Text = ""
    logger_date: Day = ""
    valid_days: int = Field(default=365, ge=1, le=3653)
    limit_K: float = Field(default=0.5, gt=0, lt=20)

    @model_validator(mode="after")
    def _check_drift(self) -> Self:
        if self.reference_drift_K_per_year and not self.reference_date:
            raise ValueError(
                "traceability: reference_drift_K_per_year needs reference_date, "
                "the start of the drift"
            )
        return self

    def drift_u_K(self, on: date) -> float:
        """Standard uncertainty [K] of the reference's drift until ``on``, uniformly distributed.

        >>> table = TraceabilityTable(reference_date="2025-01-01", reference_drift_K_per_year=0.02)
        >>> round(table.drift_u_K(date(2027, 1, 1)), 4)
        0.0231
        """
        if not self.reference_date:
            return 0.0
        years = max((on - date.fromisoformat(self.reference_date)).days, 0) / YEAR_DAYS
        return self.reference_drift_K_per_year * years / 3**0.5

    def shared_u_K(self, on: date) -> float:
        """Standard uncertainty [K] common to all channels calibrated on that day."""
        return float(np.hypot(self.reference_u_K, self.drift_u_K(on)))
