"""The heat that leaves a running surface against its temperature, measured with a heated spot (figure 8.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ConfigDict, Field

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.strict import STRICT

LEAST_POINTS = 4


@dataclass(frozen=True)
class SurfaceFlux:
    """[surface] of a rig file: q = h (T - T_a), as measured, in place of the h and the ambient of a running surface.

    ``heat_transfer_W_m2K``: the relation's slope h, zero where nothing was measured; ``air_degC``: T_a, at which no
    heat leaves, minus intercept over slope; ``heat_transfer_u_W_m2K`` and ``air_u_K`` their standard uncertainties.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    heat_transfer_W_m2K: Annotated[float, Field(ge=0, lt=8000)] = 0.0
    heat_transfer_u_W_m2K: Annotated[float, Field(ge=0, lt=8000)] = 0.0
    air_degC: Annotated[float, Field(ge=-50, le=400)] = 0.0
    air_u_K: Annotated[float, Field(ge=0, le=100)] = 0.0

    def __post_init__(self) -> None:
        if not self.heat_transfer_W_m2K and (
            self.air_degC or self.air_u_K or self.heat_transfer_u_W_m2K
        ):
            raise InputError(
                "[surface] has no heat_transfer_W_m2K",
                expected="the slope of the relation, with its T_a",
            )

    @property
    def measured(self) -> bool:
        """Whether there is such a relation."""
        return self.heat_transfer_W_m2K > 0


NO_FLUX = SurfaceFlux()


def fit_surface_flux(
    temperature_degC: Array, flux_W_m2: Array, power_rel: float = 0.0
) -> SurfaceFlux:
    """The straight line through fluxes (N,) [W/m2] of a heated spot at temperatures (N,) [degC].

    ``power_rel``: relative standard uncertainty that all fluxes have in common (heater's power, spot's area): it
    moves h and leaves T_a where it is. The scatter moves both; that a steeper line ends at a warmer T_a is not used
    later, and what leaves a hot surface is then known better than it is taken to be. Raises InputError for fewer than
    four points, one temperature only, or a flux that falls.

    >>> t = np.array([80.0, 100.0, 120.0, 140.0])
    >>> found = fit_surface_flux(t, 700.0 * (t - 62.0))
    >>> round(found.heat_transfer_W_m2K), round(found.air_degC, 2)
    (700, 62.0)
    """
    t = np.asarray(temperature_degC, dtype=float)
    q = np.asarray(flux_W_m2, dtype=float)
    if len(t) < LEAST_POINTS or not np.ptp(t) > 0:
        raise InputError(
            f"{len(t)} points of a surface's flux",
            expected="four or more at different temperatures",
        )
    about = t - t.mean()
    h = float(about @ q / (about @ about))
    if not h > 0:
        raise InputError(
            f"the flux falls with temperature (slope {h:.3g} W/m2K)",
            expected="a loss that rises with it",
        )
    left = q - q.mean() - h * about
    air = float(t.mean() - q.mean() / h)
    sd = float(np.sqrt(left @ left / (len(t) - 2)))
    if not (-50 <= air <= 400 and h < 8000):
        raise InputError(
            f"the flux would be zero at {air:.4g} degC, with a slope of {h:.4g} W/m2K",
            expected="-50 to 400 degC and less than 8000 W/m2K",
            remedy="measure the flux over a wider range of temperature, or look at the units",
        )
    u = sd / float(np.sqrt(about @ about))
    air_u = float(np.hypot(sd / len(t) ** 0.5, (t.mean() - air) * u)) / h
    return SurfaceFlux(h, float(np.hypot(u, power_rel * h)), air, air_u)
