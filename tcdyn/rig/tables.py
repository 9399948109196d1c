"""The tables of ``rig.toml``, in the units of the file.

Flux profile, measured surface flux, layout of the thermocouples, logger, traceability, disk,
washer, contact and uncertainties. Merged and checked by :mod:`tcdyn.rig.rigfile`. Defaults of the
thesis where it states them; assumed ones are named as such. A new key also needs a row on the page
of the manual on keys. Tests: ``tests/rig/test_rigfile.py``, ``tests/heat/test_rim_flux.py`` and
``tests/partition/test_statement.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from scipy.special import ndtri, stdtrit

from tcdyn.core import Array
from tcdyn.core.errors import InputError

# Tables are immutable; unknown keys, infinite numbers and NaN are errors.
STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


FluxKind = Literal["hertz", "flat", "barus", "table"]


@dataclass(frozen=True)
class FluxProfile:
    """Profile of the heat flux across the track; the default is the thesis's (3.32).

    Parameters
    ----------
    kind
        "hertz": the parabola of Hertz's pressure; "flat": constant over the width of the contact;
        "barus": proportional to the viscosity of the lubricant under Hertz's pressure p, exp(alpha
        p), summed along rolling; "table": linear interpolation of ``weight``, zero outside.
    shift_m
        Distance of the centre of the flux from the centre plane, positive away from the face at z =
        0.
    viscosity_per_Pa
        alpha [1/Pa].
    pressure_Pa
        Maximum pressure of the contact; it follows from the load of a test.
    at_m, weight
        Positions from the centre plane and weights of a table.
    """

    kind: FluxKind = "hertz"
    shift_m: float = 0.0
    viscosity_per_Pa: float = 0.0
    pressure_Pa: float = 0.0
    at_m: tuple[float, ...] = ()
    weight: tuple[float, ...] = ()

    @property
    def exponent(self) -> float:
        """alpha p_0: logarithm of the relative viscosity of the oil at the maximum pressure [1]."""
        return self.viscosity_per_Pa * self.pressure_Pa

    def at_pressure(self, pressure_Pa: float) -> FluxProfile:
        """The profile at the maximum pressure of a contact [Pa]; only "barus" depends on it.

        >>> FluxProfile("barus", viscosity_per_Pa=1e-8).at_pressure(1e9).exponent
        10.0
        """
        return replace(self, pressure_Pa=pressure_Pa) if self.kind == "barus" else self


# The default profile.
HERTZ_FLUX = FluxProfile()


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
        """Raise InputError for other keys without a slope."""
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


# A rig file without [surface].
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

    Returns
    -------
    surface
        h, T_a and their uncertainties.

    Raises
    ------
    InputError
        Fewer than four points, one temperature only, or a flux that falls with temperature.

    Notes
    -----
    The scatter affects both h and T_a. Their positive correlation is not used later, so the
    uncertainty of the heat loss of a hot surface is overestimated. The scatter of a few points is
    itself uncertain. The uncertainties are larger by the ratio of the 97.5 % quantiles of Student's
    t and of the normal distribution, so that 1.96 of them to either side contain the true value in
    95 % of cases.

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
    freedom = len(t) - 2
    sd = float(np.sqrt(residual @ residual / freedom) * stdtrit(freedom, 0.975) / ndtri(0.975))
    if not (-50 <= air <= 400 and h < 8000):
        raise InputError(
            f"the flux would be zero at {air:.4g} degC, with a slope of {h:.4g} W/m2K",
            expected="-50 to 400 degC and less than 8000 W/m2K",
            remedy="measure the flux over a wider range of temperature, or look at the units",
        )
    h_u = sd / float(np.sqrt(square))
    air_u = float(np.hypot(sd / len(t) ** 0.5, (t.mean() - air) * h_u)) / h
    return SurfaceFlux(h, float(np.hypot(h_u, power_rel * h)), air, air_u)


# (depth_mm, z_mm) of the junctions
_POSITIONS_MM = {
    "a": (3.0, 4.765),
    "b": (6.0, 4.765),
    "c": (3.0, 2.0),
    "d": (6.0, 2.0),
    "e": (1.25, 4.765),
    "f": (6.0, 7.53),
}
# angle_deg of the junctions: two opposite groups, 15 degrees between neighbours (assumed)
_CLARKE_AND_VOLLER = {"a": 0.0, "c": 15.0, "d": 345.0, "b": 180.0, "e": 195.0, "f": 165.0}
ANGLES_DEG = {
    "table 6.2": {"a": 0.0, "e": 15.0, "f": 345.0, "b": 180.0, "c": 195.0, "d": 165.0},
    "clarke": _CLARKE_AND_VOLLER,
    "voller": _CLARKE_AND_VOLLER,
}
# junctions of a layout whose positions differ from the table above
_OTHER_POSITIONS_MM = {"clarke": {"e": (3.0, 7.53)}}
# Channels of the thesis's disks; those of any disk are ``DiskSetup.channels``.
CHANNELS = tuple(_POSITIONS_MM)
DEFAULT_LAYOUT = "table 6.2"  # of this rig's disks; tables 6.3 and 6.4 are Clarke's and Voller's
OWN_LAYOUT = "own"  # only the junctions that the rig file lists
# Junctions nearer the surface than the deepest one by this [m] are not in its row. By judgement.
ROW_DEPTH_M = 1e-3


def layout_junctions(layout: str) -> dict[str, dict[str, float]]:
    """Positions of the junctions a..f of a layout; empty for the layout "own".

    Parameters
    ----------
    layout
        Name of a layout, or "own".

    Returns
    -------
    positions
        depth_mm, z_mm and angle_deg by junction.

    Raises
    ------
    ValueError
        For an unknown layout.

    Examples
    --------
    >>> layout_junctions("voller")["c"]
    {'depth_mm': 3.0, 'z_mm': 2.0, 'angle_deg': 15.0}
    """
    if layout == OWN_LAYOUT:
        return {}
    if not isinstance(layout, str) or layout not in ANGLES_DEG:
        raise ValueError(
            f"thermocouples.layout is {layout!r}; expected one of "
            f"{', '.join((*ANGLES_DEG, OWN_LAYOUT))}"
        )
    positions = _POSITIONS_MM | _OTHER_POSITIONS_MM.get(layout, {})
    return {
        name: {"depth_mm": depth_mm, "z_mm": z_mm, "angle_deg": ANGLES_DEG[layout][name]}
        for name, (depth_mm, z_mm) in positions.items()
    }


def inner_row(depth_m: Mapping[str, float], z_m: Mapping[str, float]) -> tuple[str, ...]:
    """The junctions about as deep as the deepest, in the order of z.

    They give the boundary temperature of the rim model.

    Parameters
    ----------
    depth_m, z_m
        Depth and distance from one face, by junction [m].

    Returns
    -------
    names
        In the order of z.

    Notes
    -----
    ``ROW_DEPTH_M`` decides which junctions are the boundary and which are compared with the model.
    Test: ``tests/partition/test_inner_row.py``.

    Examples
    --------
    >>> depth_m = {"a": 3e-3, "b": 6e-3, "d": 5.8e-3, "e": 1e-3}
    >>> inner_row(depth_m, {"a": 5e-3, "b": 5e-3, "d": 2e-3, "e": 5e-3})
    ('d', 'b')
    """
    deepest = max(depth_m.values())
    row = [name for name in sorted(depth_m) if round(deepest - depth_m[name], 9) < ROW_DEPTH_M]
    return tuple(sorted(row, key=lambda name: z_m[name]))


ConstantName = Literal["load_N", "speed_fast_rpm", "speed_slow_rpm", "ambient_degC"]


@dataclass(frozen=True)
class Constant:
    """[constants] load_N = { value = 2320, u = 20 }: replaces a column that is not in the log.

    ``value`` under load, over the last 150 s before the unloading, with its standard uncertainty
    ``u``, both in the unit in which the name ends.

    Attributes
    ----------
    value
        Value of the column.
    u
        Its standard uncertainty.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    value: float
    u: Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class LoggerTable:
    """[logger]: unit of the columns of the junctions.

    Attributes
    ----------
    millivolts
        Whether they hold the emf of type ``couple`` and not degC.
    couple
        Type of the thermocouples.
    cold_junction_degC
        Temperature of the reference junction.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    millivolts: bool = False
    couple: Literal["E", "J", "K", "N", "T"] = "J"
    cold_junction_degC: Annotated[float, Field(ge=-50, le=100)] = 0.0


@dataclass(frozen=True)
class AmbientChannels:
    """[ambient]: columns of the air temperature T_A.

    Attributes
    ----------
    surface
        Air at the running surface.
    faces
        Air behind the faces.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    surface: tuple[str, ...] = ()
    faces: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns, without repeats.

        Returns
        -------
        columns
            Names in the file.
        """
        return tuple(dict.fromkeys((*self.surface, *self.faces)))


def air_name(column: str) -> str:
    """The name of a column of ``[ambient]`` after reading.

    >>> air_name("Oil jet 2"), air_name("air_3_degC")
    ('ambient_Oil jet 2_degC', 'ambient_air_3_degC')
    """
    return f"ambient_{column.removesuffix('_degC').removeprefix('ambient_')}_degC"


def air_columns(channels: Sequence[AmbientChannels]) -> dict[str, str]:
    """Columns of the air of all disks: name after reading to name in the file.

    Parameters
    ----------
    channels
        ``[ambient]`` of each disk.
    """
    return {air_name(column): column for table in channels for column in table.columns}


# Mean length of a year [days].
YEAR_DAYS = 365.25
# Standard uncertainty of the PRT: an error of at most 0.1 degC, uniformly distributed (section
# 2.6).
PRT_U_DEGC = 0.1 / np.sqrt(3.0)


def _text_of_day(day: Any) -> Any:
    """A date of TOML as text; other values as they are."""
    return day.isoformat() if isinstance(day, date) else day


def _check_date(text: str) -> str:
    """Return a text that is empty or an ISO date (2026-01-31); ValueError for any other."""
    if text:
        date.fromisoformat(text)
    return text


# Entries of [traceability] without which a certificate is a draft: who calibrated, against what,
# with which instruments (ISO/IEC 17025:2017, 7.8.2.1 and 7.8.4.1).
REQUIRED_ENTRIES = (
    "laboratory",
    "certificate",
    "calibrated_by",
    "reference",
    "reference_serial",
    "reference_certificate",
    "reference_date",
    "logger",
    "logger_serial",
)
Text = Annotated[str, Field(max_length=200)]
Day = Annotated[
    str, BeforeValidator(_text_of_day), Field(max_length=10), AfterValidator(_check_date)
]


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
    tolerance_K, lag_tolerance_s
        Largest error of a corrected reading at rest, and of a lag, of a thermocouple that is fit to
        use. The defaults are chosen by judgement; 1 K is twice the standard uncertainty from which
        on ``tcdyn rig record check`` warns about a static line.
    """

    model_config = STRICT

    laboratory: Text = ""
    address: Text = ""
    customer: Text = ""
    place: Text = ""
    procedure: Text = ""
    certificate: Text = ""
    calibrated_by: Text = ""
    authorised_by: Text = ""
    received: Day = ""
    reference: Text = ""
    reference_serial: Text = ""
    reference_certificate: Text = ""
    reference_date: Day = ""
    reference_u_K: float = Field(default=float(PRT_U_DEGC), ge=0, lt=5)
    reference_drift_K_per_year: float = Field(default=0.0, ge=0, lt=5)
    logger: Text = ""
    logger_serial: Text = ""
    logger_certificate: Text = ""
    logger_date: Day = ""
    valid_days: int = Field(default=365, ge=1, le=3653)
    limit_K: float = Field(default=0.5, gt=0, lt=20)
    tolerance_K: float = Field(default=1.0, gt=0, lt=20)
    lag_tolerance_s: float = Field(default=0.5, gt=0, lt=1e7)

    @model_validator(mode="after")
    def _check_drift(self) -> Self:
        """Check that a drift has a start."""
        if self.reference_drift_K_per_year and not self.reference_date:
            raise ValueError(
                "traceability: reference_drift_K_per_year needs reference_date, "
                "the start of the drift"
            )
        return self

    @property
    def missing_entries(self) -> tuple[str, ...]:
        """Keys of ``REQUIRED_ENTRIES`` that are not stated.

        Examples
        --------
        >>> stated = dict.fromkeys(REQUIRED_ENTRIES, "x") | {"reference_date": "2026-01-01"}
        >>> TraceabilityTable(**(stated | {"laboratory": " "})).missing_entries
        ('laboratory',)
        """
        return tuple(key for key in REQUIRED_ENTRIES if not getattr(self, key).strip())

    def drift_u_K(self, on: date) -> float:
        """Standard uncertainty [K] of the reference's drift until ``on``, uniformly distributed.

        Parameters
        ----------
        on
            Day of the calibration.

        Notes
        -----
        Rectangular distribution: half-range over sqrt(3).

        Examples
        --------
        >>> table = TraceabilityTable(reference_date="2025-01-01", reference_drift_K_per_year=0.02)
        >>> round(table.drift_u_K(date(2027, 1, 1)), 4)
        0.0231
        """
        if not self.reference_date:
            return 0.0
        years = max((on - date.fromisoformat(self.reference_date)).days, 0) / YEAR_DAYS
        return self.reference_drift_K_per_year * years / 3**0.5

    def shared_u_K(self, on: date) -> float:
        """Standard uncertainty [K] common to all channels calibrated on that day.

        Parameters
        ----------
        on
            Day of the calibration.
        """
        return float(np.hypot(self.reference_u_K, self.drift_u_K(on)))


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
        """Check that bore, outer and crown radius are possible together."""
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
        """Check that a flux table is complete and rises."""
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
    steel_of_one_disk_rel: float = Field(default=0.005, ge=0, lt=0.5)
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
        """Check that the range of the exponent is in order."""
        low = self.speed_exponent_low
        high = self.speed_exponent_high
        if low > high:
            raise ValueError(
                f"speed_exponent_low {low:g} lies above speed_exponent_high {high:g}; exchange them"
            )
        return self
