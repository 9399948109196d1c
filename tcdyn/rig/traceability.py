"""What a laboratory states about its reference thermometer, its instruments and the item under calibration."""

from __future__ import annotations

from datetime import date
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, model_validator

from tcdyn.rig.strict import STRICT

YEAR_DAYS = 365.25
PRT_U_DEGC = 0.1 / np.sqrt(3.0)  # a largest error of 0.1 degC, taken as uniform (section 2.6)


def _day(text: str) -> str:
    if text:
        date.fromisoformat(text)
    return text


Text = Annotated[str, Field(max_length=200)]
Day = Annotated[str, Field(max_length=10), AfterValidator(_day)]


class TraceabilityTable(BaseModel):
    """[traceability]: who calibrated what, against which reference, and how well that is known.

    ``reference_u_K``: standard uncertainty of the oven's PRT by its certificate, common to all readings;
    ``reference_drift_K_per_year``: half-range of its drift since ``reference_date``; ``valid_days`` until the next
    calibration at the latest, sooner where a channel drifts by ``limit_K`` before. Days as YYYY-MM-DD.
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
    def _since_when(self) -> Self:
        if self.reference_drift_K_per_year and not self.reference_date:
            raise ValueError(
                "traceability: reference_drift_K_per_year asks for reference_date, since when it drifts"
            )
        return self

    def drift_u_K(self, on: date) -> float:
        """Standard uncertainty [K] of the reference's drift up to ``on``: uniform within its half-range.

        >>> table = TraceabilityTable(reference_date="2025-01-01", reference_drift_K_per_year=0.02)
        >>> round(table.drift_u_K(date(2027, 1, 1)), 4)
        0.0231
        """
        if not self.reference_date:
            return 0.0
        years = max((on - date.fromisoformat(self.reference_date)).days, 0) / YEAR_DAYS
        return self.reference_drift_K_per_year * years / 3**0.5

    def shared_u_K(self, on: date) -> float:
        """Standard uncertainty [K] that all channels calibrated against the reference on that day have in common."""
        return float(np.hypot(self.reference_u_K, self.drift_u_K(on)))
