"""The tables of ``rig.toml`` that describe one disk, in the units of the file."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import BaseModel, Field, model_validator

from tcdyn.rig.flux_profile import FluxKind, FluxProfile
from tcdyn.rig.strict import STRICT


class RigTable(BaseModel):
    """A table of ``rig.toml``; unknown keys and numbers out of range are errors."""

    model_config = STRICT


class DiskTable(RigTable):
    """[disk]; bore radius and steel are assumed, not from the thesis (section 3 of the design)."""

    outer_radius_mm: float = Field(default=38.1, gt=5, lt=500)
    bore_radius_mm: float = Field(default=20.5, ge=0, lt=500)
    width_mm: float = Field(default=9.53, gt=1, lt=200)
    crown_radius_mm: float = Field(default=304.8, gt=1, lt=1e5)
    conductivity_W_mK: float = Field(default=41.0, gt=0.1, lt=2500)
    density_kg_m3: float = Field(default=7850.0, gt=100, lt=25000)
    specific_heat_J_kgK: float = Field(default=470.0, gt=50, lt=6000)
    conductivity_slope_per_K: float = Field(default=0.0, gt=-0.002, lt=0.005)
    specific_heat_slope_per_K: float = Field(default=0.0, gt=-0.002, lt=0.005)
    reference_degC: float = Field(default=20.0, ge=-100, le=400)

    @model_validator(mode="after")
    def _check_radii(self) -> DiskTable:
        if 0.0 < self.bore_radius_mm < 0.5:
            raise ValueError(
                f"bore_radius_mm: {self.bore_radius_mm} mm is no bore; is it in metres?"
            )
        if self.bore_radius_mm >= self.outer_radius_mm:
            raise ValueError("bore_radius_mm must be below outer_radius_mm")
        if self.crown_radius_mm <= self.outer_radius_mm:
            raise ValueError(
                f"crown_radius_mm is {self.crown_radius_mm:g}; expected more than outer_radius_mm, "
                f"{self.outer_radius_mm:g}: give the radius across the running surface, "
                "which is nearly flat"
            )
        return self


class WasherTable(RigTable):
    """[washer]; the thickness is assumed."""

    conductivity_W_mK: float = Field(default=1.46, ge=0, lt=500)
    thickness_mm: float = Field(default=8.0, gt=0.1, lt=200)


class JunctionTable(RigTable):
    """[thermocouples] a = { depth_mm, z_mm, angle_deg }."""

    depth_mm: float = Field(gt=0.05, lt=100)  # below 50 um it is in metres
    z_mm: float = Field(gt=0.05, lt=200)
    angle_deg: float = Field(default=0.0, ge=-360, le=360)


class ContactTable(RigTable):
    """[contact]; ``flux_...``: profile of the heat flux across the track (section 8.3).

    See :class:`FluxProfile`.
    """

    gear_ratio: float = Field(default=4.24, ge=1, lt=100)
    speed_exponent: float = Field(default=0.667, ge=0, le=2)
    flux_profile: FluxKind = "hertz"
    flux_shift_mm: float = Field(default=0.0, gt=-100, lt=100)
    flux_barus_per_GPa: float = Field(default=11.0, ge=0, le=60)
    flux_table_mm: tuple[float, ...] = ()
    flux_table_weight: tuple[Annotated[float, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _check_flux_table(self) -> ContactTable:
        positions = self.flux_table_mm
        weights = self.flux_table_weight
        if (self.flux_profile == "table") != (len(positions) > 1):
            raise ValueError(
                f"flux_table_mm has {len(positions)} places; expected two or more, "
                'and flux_profile = "table"'
            )
        if len(positions) != len(weights):
            raise ValueError(
                f"flux_table_mm has {len(positions)} places, flux_table_weight {len(weights)}; "
                "expected as many"
            )
        is_rising = all(a < b for a, b in pairwise(positions))
        if not is_rising or (positions and not sum(weights) > 0):
            raise ValueError("flux_table_mm must rise, and some flux_table_weight be above zero")
        return self

    @property
    def flux(self) -> FluxProfile:
        """Profile of the heat flux across the track, in SI units."""
        kind = self.flux_profile
        shift_m = 1e-3 * self.flux_shift_mm
        if kind == "barus":
            return FluxProfile(kind, shift_m, viscosity_per_Pa=1e-9 * self.flux_barus_per_GPa)
        if kind == "table":
            at = tuple(1e-3 * x for x in self.flux_table_mm)
            return FluxProfile(kind, shift_m, at_m=at, weight=self.flux_table_weight)
        return FluxProfile(kind, shift_m)


class UncertaintyTable(RigTable):
    """[uncertainty]: standard uncertainties of nuisance parameters (type B) for the budget.

    ``bath_...`` belong to a plunge: its thermometer, and scale and form of h, see
    :class:`immersion.plunge_parameters.PlungePriors`.
    """

    depth_mm: float = Field(default=0.1, ge=0, lt=5)
    conductivity_rel: float = Field(default=0.03, ge=0, lt=0.5)
    heat_capacity_rel: float = Field(default=0.02, ge=0, lt=0.5)
    washer_rel: float = Field(default=0.20, ge=0, lt=1)
    half_width_rel: float = Field(default=0.03, ge=0, lt=0.5)
    flux_shift_mm: float = Field(default=0.0, ge=0, lt=10)
    conductivity_slope_per_K: float = Field(default=0.0, ge=0, lt=0.005)
    specific_heat_slope_per_K: float = Field(default=0.0, ge=0, lt=0.005)
    friction_rel: float = Field(default=0.01, ge=0, lt=0.5)
    ambient_K: float = Field(default=1.0, ge=0, lt=50)
    film_along_rel: float = Field(default=0.15, ge=0, lt=1)
    bath_K: float = Field(default=0.5, ge=0, lt=50)
    bath_h_rel: float = Field(default=0.30, ge=0, lt=2)
    bath_h_exponent: float = Field(default=0.06, ge=0, lt=1)
    bath_h_viscosity: float = Field(default=0.10, ge=0, lt=1)
    speed_exponent_low: float = Field(default=0.571, ge=0, le=2)
    speed_exponent_high: float = Field(default=0.8, ge=0, le=2)

    @model_validator(mode="after")
    def _check_exponents(self) -> UncertaintyTable:
        low = self.speed_exponent_low
        high = self.speed_exponent_high
        if low > high:
            raise ValueError(
                f"speed_exponent_low {low:g} lies above speed_exponent_high {high:g}; exchange them"
            )
        return self
