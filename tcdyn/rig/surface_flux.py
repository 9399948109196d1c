"""Measured heat loss of a running surface against its temperature (heated spot, figure 8.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ConfigDict, Field

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.strict import STRICT

# Fewest points of the straight line. Chosen by judgement.
MIN_POINTS = 4


@dataclass(frozen=True)
class SurfaceFlux:
    """[surface] of a rig file: the measured heat loss q = h (T - T_a) of a running surface.

    It replaces h and the ambient of a running surface.

    Parameters
    ----------
    heat_transfer_W_m2K
        Slope h; zero where nothing was measured.
    air_degC
        T_a, at which the heat loss is zero: minus intercept over slope.
    heat_transfer_u_W_m2K, air_u_K
        Their standard uncertainties.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    heat_transfer_W_m2K: Annotated[float, Field(ge=0, lt=8000)] = 0.0
    heat_transfer_u_W_m2K: Annotated[float, Field(ge=0, lt=8000)] = 0.0
    air_degC: Annotated[float, Field(ge=-50, le=400)] = 0.0
    air_u_K: Annotated[float, Field(ge=0, le=100)] = 0.0

    def __post_init__(self) -> None:
        has_other_keys = self.air_degC or self.air_u_K or self.heat_transfer_u_W_m2K
        if not self.heat_transfer_W_m2K and has_other_keys:
            raise InputError(
                "[surface] has no heat_transfer_W_m2K",
                expected="the slope of the relation, with its T_a",
            )

    @property
    def is_measured(self) -> bool:
        """Whether there is such a relation."""
        return self.heat_transfer_W_m2K > 0


NO_FLUX = SurfaceFlux()


def fit_surface_flux(
    temperature_degC: Array, flux_W_m2: Array, power_rel: float = 0.0
) -> SurfaceFlux:
    """Fit the straight line through measured heat fluxes of a heated spot.

    Parameters
    ----------
    temperature_degC
        Temperatures of the spot, (N,).
    flux_W_m2
        Heat fluxes, (N,).
    power_rel
        Relative standard uncertainty common to all fluxes (power of the heater, area of the spot).
        It affects h, but not T_a.

    Raises
    ------
    InputError
        Fewer than four points, one temperature only, or a flux that falls with temperature.

    Notes
    -----
    The scatter affects both h and T_a. Their positive correlation is not used later, so the
    uncertainty of the heat loss of a hot surface is overestimated.

    Examples
    --------
    >>> t = np.array([80.0, 100.0, 120.0, 140.0])
    >>> surface = fit_surface_flux(t, 700.0 * (t - 62.0))
    >>> round(surface.heat_transfer_W_m2K), round(surface.air_degC, 2)
    (700, 62.0)
    """
    t = np.asarray(temperature_degC, dtype=float)
    q = np.asarray(flux_W_m2, dtype=float)
    if len(t) < MIN_POINTS or not np.ptp(t) > 0:
        raise InputError(
            f"{len(t)} points of a surface's flux",
            expected="four or more at different temperatures",
        )
    centred = t - t.mean()
    square = centred @ centred
    h = float(centred @ q / square)
    if not h > 0:
        raise InputError(
            f"the flux falls with temperature (slope {h:.3g} W/m2K)",
            expected="a loss that rises with it",
        )
    residual = q - q.mean() - h * centred
    air = float(t.mean() - q.mean() / h)
    sd = float(np.sqrt(residual @ residual / (len(t) - 2)))
    if not (-50 <= air <= 400 and h < 8000):
        raise InputError(
            f"the flux would be zero at {air:.4g} degC, with a slope of {h:.4g} W/m2K",
            expected="-50 to 400 degC and less than 8000 W/m2K",
            remedy="measure the flux over a wider range of temperature, or look at the units",
        )
    h_u = sd / float(np.sqrt(square))
    air_u = float(np.hypot(sd / len(t) ** 0.5, (t.mean() - air) * h_u)) / h
    return SurfaceFlux(h, float(np.hypot(h_u, power_rel * h)), air, air_u)
